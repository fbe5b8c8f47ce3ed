use glam::DVec2;
use locsim_core::{Pose2, wrap_angle};

use super::SimulationError;
use super::error::check;

/// What a robot drives.
#[derive(Clone, Debug, PartialEq)]
pub enum RobotPath {
    /// Straight legs between points, turning in place at each. The robot starts facing the second point.
    Waypoints {
        /// At least two points [m], no two in a row the same.
        points: Vec<DVec2>,
        /// Speed on a leg [m/s], above 0.
        speed_m_s: f64,
        /// Turn rate at a point [rad/s], above 0.
        turn_rate_rad_s: f64,
    },
    /// Arcs of constant speed and turn rate, one after the other.
    VelocityProfile {
        /// First pose, `map_from_base`.
        start: Pose2,
        /// At least one.
        segments: Vec<VelocitySegment>,
    },
}

/// An arc of constant speed and turn rate; negative speeds reverse, zero speeds turn in place or stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VelocitySegment {
    /// How long it lasts [s], above 0.
    pub secs: f64,
    /// Forward speed [m/s].
    pub speed_m_s: f64,
    /// Turn rate, counter-clockwise positive [rad/s].
    pub turn_rate_rad_s: f64,
}

impl RobotPath {
    /// The same path with its start moved by `offset` [m]: of waypoints the first alone, of a velocity profile the
    /// whole.
    #[must_use]
    pub fn with_start_moved(&self, offset: DVec2) -> Self {
        let mut path = self.clone();
        match &mut path {
            Self::Waypoints { points, .. } => {
                if let Some(first) = points.first_mut() {
                    *first += offset;
                }
            }
            Self::VelocityProfile { start, .. } => {
                *start = Pose2::new(start.x + offset.x, start.y + offset.y, start.theta);
            }
        }
        path
    }
}

/// The pose of a robot at any time: circular arcs, straight lines and turns in place, joined without a jump.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    arcs: Vec<Arc>,
    duration_secs: f64,
}

/// Motion at constant speed and turn rate from `start` on.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Arc {
    start_secs: f64,
    start: Pose2,
    speed: f64,
    turn_rate: f64,
}

impl Arc {
    /// The pose `secs` after the arc's start. The chord of an arc through angle a has the arc's length times
    /// sin(a/2) / (a/2), in the direction halfway through the turn.
    fn pose_after(&self, secs: f64) -> Pose2 {
        let half_turn = 0.5 * self.turn_rate * secs;
        // Below 1e-4 the series sin(h)/h = 1 - h^2/6 is exact to 1e-18.
        let shortening = if half_turn.abs() < 1e-4 {
            1.0 - half_turn * half_turn / 6.0
        } else {
            half_turn.sin() / half_turn
        };
        let chord = self.speed * secs * shortening;
        let position = self.start.position() + chord * DVec2::from_angle(self.start.theta + half_turn);
        Pose2::new(position.x, position.y, self.start.theta + 2.0 * half_turn)
    }
}

impl Trajectory {
    /// The motion along `path`.
    ///
    /// # Errors
    /// [`SimulationError`] for fewer than two waypoints, two in a row that coincide, no segments, a segment that
    /// does not last, speeds of waypoints that are not positive, anything not finite.
    pub fn new(path: &RobotPath) -> Result<Self, SimulationError> {
        match path {
            RobotPath::Waypoints { points, speed_m_s, turn_rate_rad_s } => {
                Self::through(points, *speed_m_s, *turn_rate_rad_s)
            }
            RobotPath::VelocityProfile { start, segments } => Self::along(*start, segments),
        }
    }

    fn through(points: &[DVec2], speed: f64, turn_rate: f64) -> Result<Self, SimulationError> {
        check("speed on a leg [m/s]", speed, "above 0", |speed| speed > 0.0)?;
        check("turn rate at a waypoint [rad/s]", turn_rate, "above 0", |rate| rate > 0.0)?;
        if points.len() < 2 {
            return Err(SimulationError::TooFewWaypoints { points: points.len() });
        }
        if let Some(index) = points.iter().position(|point| !point.is_finite()) {
            return Err(SimulationError::NotFinite { index });
        }
        if let Some(index) = points.windows(2).position(|pair| pair[0] == pair[1]) {
            return Err(SimulationError::RepeatedWaypoint { index: index + 1 });
        }
        let mut arcs = Vec::with_capacity(2 * points.len());
        let mut secs = 0.0;
        let mut heading = (points[1] - points[0]).to_angle();
        for pair in points.windows(2) {
            let (from, leg) = (pair[0], pair[1] - pair[0]);
            let turn = wrap_angle(leg.to_angle() - heading);
            if turn != 0.0 {
                let start = Pose2::new(from.x, from.y, heading);
                arcs.push(Arc { start_secs: secs, start, speed: 0.0, turn_rate: turn_rate * turn.signum() });
                secs += turn.abs() / turn_rate;
                heading = leg.to_angle();
            }
            let start = Pose2::new(from.x, from.y, heading);
            arcs.push(Arc { start_secs: secs, start, speed, turn_rate: 0.0 });
            secs += leg.length() / speed;
        }
        Ok(Self { arcs, duration_secs: check_duration(secs)? })
    }

    fn along(start: Pose2, segments: &[VelocitySegment]) -> Result<Self, SimulationError> {
        if !start.is_finite() {
            return Err(SimulationError::NotFinite { index: 0 });
        }
        if segments.is_empty() {
            return Err(SimulationError::NoSegments);
        }
        let mut arcs = Vec::with_capacity(segments.len());
        let (mut secs, mut pose) = (0.0, start);
        for (index, segment) in segments.iter().enumerate() {
            let velocities_are_finite = segment.speed_m_s.is_finite() && segment.turn_rate_rad_s.is_finite();
            if !(segment.secs > 0.0 && segment.secs.is_finite() && velocities_are_finite) {
                return Err(SimulationError::Segment { index });
            }
            let arc = Arc {
                start_secs: secs,
                start: pose,
                speed: segment.speed_m_s,
                turn_rate: segment.turn_rate_rad_s,
            };
            arcs.push(arc);
            secs += segment.secs;
            pose = arc.pose_after(segment.secs);
        }
        Ok(Self { arcs, duration_secs: check_duration(secs)? })
    }

    /// How long the motion lasts [s], above 0.
    pub fn duration_secs(&self) -> f64 {
        self.duration_secs
    }

    /// `map_from_base` at `secs` after the start. Before the start the robot stands at the start, after the end at
    /// the end.
    pub fn pose_at(&self, secs: f64) -> Pose2 {
        let secs = secs.clamp(0.0, self.duration_secs);
        let arc = self.arcs.partition_point(|arc| arc.start_secs <= secs) - 1;
        self.arcs[arc].pose_after(secs - self.arcs[arc].start_secs)
    }
}

fn check_duration(secs: f64) -> Result<f64, SimulationError> {
    check("duration of the path [s]", secs, "finite", |_| true)
}
