//! Maps from simulated scans of rooms whose walls are known.

#[allow(dead_code, reason = "the corridor isn't mapped here")]
#[path = "../../../world/tests/maps_and_rays/common.rs"]
mod common;
mod occupancy;
mod walls;
