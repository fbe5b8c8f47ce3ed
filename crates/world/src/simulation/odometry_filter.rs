use locsim_core::{Draw, Pose2, Stage, Track};

use crate::effect::{Effect, Effects, OdometryErrors, slip_draw};

use super::SimulationError;

/// The effects of a world applied to the odometry of a recording.
///
/// The increments from scan to scan err as those of a simulated robot: each slips by a draw of its own, whatever the rate at
/// which the odometry was recorded. Between scans the error grows with the motion.
pub struct OdometryFilter {
    errors: OdometryErrors,
    /// `odom_from_base` at each scan, as recorded and with the effects.
    recorded: Track,
    affected: Vec<Pose2>,
    /// Share by which the increment that ends at a scan slips.
    slips: Vec<f64>,
}

impl OdometryFilter {
    /// A filter of an odometry that read `recorded` (`odom_from_base`) at the scans of a recording.
    ///
    /// # Errors
    /// [`SimulationError::Effect`] for more effects than a world can have.
    pub fn new(effects: &[Effect], recorded: Track, seed: u64) -> Result<Self, SimulationError> {
        let errors = Effects::new(effects.to_vec())?.odometry_errors();
        let seed = Draw::new(seed, Stage::Recording, 0).seed(0);
        let slips: Vec<f64> =
            (0..recorded.len()).map(|i| errors.slip.sample(&mut slip_draw(seed, i as u32))).collect();
        let mut filter = Self { errors, affected: vec![recorded.poses()[0]], recorded, slips };
        for i in 1..filter.recorded.len() {
            let pose = filter.since(i - 1, i, &filter.recorded.poses()[i]);
            filter.affected.push(pose);
        }
        Ok(filter)
    }

    /// The pose `odom_from_base` that the odometry reads `secs` after the first scan instead of `pose`.
    pub fn pose(&self, secs: f64, pose: &Pose2) -> Pose2 {
        let next = self.recorded.secs().partition_point(|&time| time < secs);
        // Before the first scan, the motion until then; after the last one, the motion since.
        self.since(next.saturating_sub(1), next, pose)
    }

    /// The transform that takes the place of `map_from_odom` `secs` after the first scan, so that the robot stays where it is in
    /// the map.
    pub fn correction(&self, secs: f64, map_from_odom: &Pose2) -> Pose2 {
        let recorded = self.recorded.pose_at(secs);
        let affected = self.pose(secs, &recorded);
        map_from_odom.compose(&recorded).compose(&Pose2::IDENTITY.relative_to(&affected))
    }

    /// The velocity that the odometry reads `secs` after the first scan instead of `velocity` \[m/s, m/s, rad/s\].
    pub fn velocity(&self, secs: f64, velocity: &Pose2) -> Pose2 {
        self.increment(self.recorded.secs().partition_point(|&time| time < secs), velocity)
    }

    /// The pose that is read instead of `pose`, which the robot reaches from scan `from` on, at the latest at scan `to`.
    fn since(&self, from: usize, to: usize, pose: &Pose2) -> Pose2 {
        self.affected[from].compose(&self.increment(to, &pose.relative_to(&self.recorded.poses()[from])))
    }

    /// The increment that is read instead of one that ends at scan `to` or before.
    fn increment(&self, to: usize, increment: &Pose2) -> Pose2 {
        let read = self.errors.distribution(increment).mean;
        // The first scan ends no increment.
        let slip = if to == 0 { 0.0 } else { self.slips.get(to).copied().unwrap_or(0.0) };
        Pose2 { x: (1.0 + slip) * read.x, y: (1.0 + slip) * read.y, ..read }
    }
}

/// The effects of a world applied to what a recording says of its laser: where it is mounted, and when beams are taken.
///
/// Readings stay: the recording then says of them what a robot of a wrong description would.
#[derive(Clone, Debug, Default)]
pub struct MountFilter {
    effects: Effects,
}

impl MountFilter {
    /// A filter of the effects of a list.
    ///
    /// # Errors
    /// [`SimulationError::Effect`] for more effects than a world can have.
    pub fn new(effects: &[Effect]) -> Result<Self, SimulationError> {
        Ok(Self { effects: Effects::new(effects.to_vec())? })
    }

    /// The `base_from_laser` that a recording has to say for the laser to sit elsewhere, by the effects, than it says.
    pub fn mount(&self, base_from_laser: &Pose2) -> Pose2 {
        let moved = self.effects.laser_mount(Pose2::IDENTITY);
        Pose2::new(
            base_from_laser.x - moved.x,
            base_from_laser.y - moved.y,
            base_from_laser.theta - moved.theta,
        )
    }

    /// How much later than its stamp the beam of a bearing \[rad\] is taken \[s\].
    pub fn delay_secs(&self, bearing: f64) -> f64 {
        self.effects.beam_secs(bearing, 0.0)
    }
}
