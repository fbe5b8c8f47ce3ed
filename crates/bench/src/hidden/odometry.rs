use locsim_core::{Drive, Pose2};

use super::Altered;

impl Altered<'_> {
    /// The nominal drive whose odometry is that of `delay_secs` before.
    pub fn with_late_odometry(&self, delay_secs: f64) -> Drive {
        let nominal = self.truth.with_poses(self.odometry());
        let secs = nominal.secs();
        let odometry = secs.iter().map(|secs| nominal.pose_at((secs - delay_secs).max(nominal.secs()[0])));
        self.drive(&self.readings_along(self.truth), odometry.collect())
    }

    /// The nominal drive whose odometry reads an increment otherwise: `change(i, step, secs)` gives what it reads too
    /// much of distance, as a share, and of turn \[rad\] where the robot really moved by `step` in `secs` to scan `i`.
    pub fn with_odometry(&self, change: impl Fn(usize, &Pose2, f64) -> [f64; 2]) -> Drive {
        let truth = self.truth;
        let nominal = self.odometry();
        let changes: Vec<[f64; 2]> = (1..self.scans())
            .map(|i| {
                let step = truth.poses()[i].relative_to(&truth.poses()[i - 1]);
                change(i, &step, truth.secs()[i] - truth.secs()[i - 1])
            })
            .collect();
        let readings = self.readings_along(truth);
        // Taken apart and put together again a track is the same up to rounding only.
        if changes.iter().flatten().all(|&change| change == 0.0) {
            return self.drive(&readings, nominal);
        }
        let mut odom_from_base = nominal[0];
        let mut track = vec![odom_from_base];
        for (pair, [stretch, turn]) in nominal.windows(2).zip(changes) {
            let read = pair[1].relative_to(&pair[0]);
            let step = Pose2::new((1.0 + stretch) * read.x, (1.0 + stretch) * read.y, read.theta + turn);
            odom_from_base = odom_from_base.compose(&step);
            track.push(odom_from_base);
        }
        self.drive(&readings, track)
    }
}
