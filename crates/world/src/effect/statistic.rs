//! Which statistics of a log show an effect.

use glam::DVec2;

/// A family of statistics that shows an effect in a log.
///
/// Each statistic looks in a direction: an effect of typical values, but for those that the direction gives.
#[derive(Clone, Copy, Debug)]
pub enum Statistic {
    /// The sum over all beams of a weight times a score of the reading.
    Score {
        /// The score.
        score: Score,
        /// Weight of a beam for an effect of these values.
        weight: fn(&BeamState, &[f64]) -> f64,
        /// One statistic for each.
        directions: &'static [Direction],
    },
    /// Errors of the reference poses that follow a pattern over the scans.
    Pose {
        /// Error of a pose \[m, m, rad\] in the map frame that an effect of these values looks like, up to a factor.
        pattern: fn(&PoseState, &[f64]) -> [f64; 3],
        /// One statistic for each.
        directions: &'static [Direction],
    },
    /// Readings against the nominal ranges of other beams of their scan, for a laser that is turned: where a fit of a large turn starts.
    Turn,
    /// Location scores at each stretch of wall, for walls that are displaced along their normals.
    WallShift,
    /// Readings at each stretch of wall that are missing or of something behind it.
    WallLoss,
    /// Readings between the two surfaces of an edge.
    Edge,
    /// Readings in front of the walls, counted where they lie in the map.
    Object,
    /// Readings in front of the walls, counted by bearing and range.
    Sector,
    /// Phases of the readings modulo a step.
    Step,
    /// How deep readings of clutter lie in front of the walls.
    ClutterDepth,
    /// How many readings are of clutter.
    ClutterDensity,
    /// Correlation of the odometry's errors with the motion.
    Odometry {
        /// Which error.
        error: Axis,
        /// Which motion it is in proportion to.
        motion: Axis,
    },
    /// The likelihood ratio of increments in which wheels slip by these shares.
    Slip {
        /// The effect's second value, one statistic for each.
        shares: &'static [f64],
    },
}

/// Values of parameters, by index, that a direction has instead of the typical ones.
pub type Direction = &'static [(usize, f64)];

/// A direction in which all values are typical.
pub(super) const TYPICAL: &[Direction] = &[&[]];

/// Derivative of the log density of a reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Score {
    /// By its mean.
    Location,
    /// By the logarithm of its standard deviation.
    Scale,
    /// By the share of returns that are lost.
    NoReturn,
    /// By the share of readings that are uniform over all ranges.
    Uniform,
    /// By the share of returns with the noise of the tail.
    Tail,
}

/// Distance or turn of an odometry increment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Axis {
    /// The distance \[m\], negative backward.
    Distance,
    /// The turn \[rad\].
    Turn,
}

/// A beam of a log, by its reference pose and the map.
#[derive(Clone, Copy, Debug)]
pub struct BeamState {
    /// Time of its scan since the first one \[s\].
    pub secs: f64,
    /// In the laser frame \[rad\].
    pub bearing: f64,
    /// Range of what stands there by the map and the known objects \[m\].
    pub range: f64,
    /// Incidence there \[rad\].
    pub incidence: f64,
    /// Nominal standard deviation of the return \[m\].
    pub sigma: f64,
    /// The laser's maximum range \[m\].
    pub max_range: f64,
    /// Change of the range with the robot's pose in the map frame \[m/m, m/m, m/rad\].
    pub jacobian: [f64; 3],
    /// The robot's heading \[rad\].
    pub heading: f64,
    /// The robot's velocity in the map frame \[m/s, m/s, rad/s\].
    pub velocity: [f64; 3],
}

/// The robot at a scan of a log, by the reference.
#[derive(Clone, Copy, Debug)]
pub struct PoseState {
    /// Heading \[rad\].
    pub heading: f64,
    /// Velocity in the map frame \[m/s, m/s, rad/s\].
    pub velocity: [f64; 3],
    /// Position of the laser on the robot \[m\].
    pub mount: DVec2,
}

impl BeamState {
    /// Change of the range with time, as the robot drives on \[m/s\].
    pub(super) fn range_rate(&self) -> f64 {
        let (j, v) = (self.jacobian, self.velocity);
        j[0] * v[0] + j[1] * v[1] + j[2] * v[2]
    }

    /// Change of the range with a shift of the robot in the direction `angle` \[rad\] from its heading \[m/m\].
    pub(super) fn range_along(&self, angle: f64) -> f64 {
        let (j, heading) = (self.jacobian, self.heading + angle);
        j[0] * heading.cos() + j[1] * heading.sin()
    }
}
