//! Measured logs in and out: CARMEN logs and TUM trajectories
