use glam::DVec2;
use locsim_core::limits::MOST_SCANS;
use locsim_core::{Pose2, wrap_angle};
use serde::Serialize;

use super::SimulationError;
use super::error::{check, check_count};

/// The path of a robot.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum RobotPath {
    /// Straight legs between points, turning in place at each. The robot starts facing the second point.
    Waypoints {
        /// At least two points \[m\], no two in a row the same.
        points_m: Vec<[f64; 2]>,
        /// Speed on a leg \[m/s\], above 0.
        speed_m_s: f64,
        /// Turn rate at a point \[rad/s\], above 0.
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
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct VelocitySegment {
    /// How long it lasts \[s\], above 0.
    pub secs: f64,
    /// Forward speed \[m/s\].
    pub speed_m_s: f64,
    /// Turn rate, counter-clockwise positive \[rad/s\].
    pub turn_rate_rad_s: f64,
}

impl RobotPath {
    /// The same path with its start moved by `offset` \[m\]: of waypoints the first alone, of a velocity
    /// profile the whole.
    #[must_use]
    pub fn with_start_moved(&self, offset: DVec2) -> Self {
        let mut path = self.clone();
        match &mut path {
            Self::Waypoints { points_m, .. } => {
                if let Some([x, y]) = points_m.first_mut() {
                    *x += offset.x;
                    *y += offset.y;
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
    /// [`SimulationError`] for fewer than two waypoints, two in a row that coincide, no segments, a segment
    /// that does not last, speeds of waypoints that are not positive, anything not finite.
    pub fn new(path: &RobotPath) -> Result<Self, SimulationError> {
        match path {
            RobotPath::Waypoints { points_m, speed_m_s, turn_rate_rad_s } => {
                let points: Vec<DVec2> = points_m.iter().copied().map(DVec2::from_array).collect();
                Self::through(&points, *speed_m_s, *turn_rate_rad_s)
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

    /// How long the motion lasts \[s\], above 0.
    pub fn duration_secs(&self) -> f64 {
        self.duration_secs
    }

    /// How many scans a laser of `rate_hz` takes on the way, at the start and every so often until the end.
    ///
    /// # Errors
    /// [`SimulationError::TooMany`] for more than a million.
    pub fn scan_count(&self, rate_hz: f64) -> Result<usize, SimulationError> {
        let count = (self.duration_secs * rate_hz + 1e-9).floor() + 1.0;
        check_count("scans", count, MOST_SCANS.into())?;
        Ok(count as usize)
    }

    /// `map_from_base` at `secs` after the start. Before the start the robot stands at the start, after the
    /// end at the end.
    pub fn pose_at(&self, secs: f64) -> Pose2 {
        let secs = secs.clamp(0.0, self.duration_secs);
        let arc = self.arcs.partition_point(|arc| arc.start_secs <= secs) - 1;
        self.arcs[arc].pose_after(secs - self.arcs[arc].start_secs)
    }
}

fn check_duration(secs: f64) -> Result<f64, SimulationError> {
    check("duration of the path [s]", secs, "finite", |_| true)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use proptest::prelude::*;

    use super::*;

    fn waypoints(points: &[[f64; 2]]) -> RobotPath {
        RobotPath::Waypoints { points_m: points.to_vec(), speed_m_s: 0.5, turn_rate_rad_s: 0.5 }
    }

    fn profile(segments: &[[f64; 3]]) -> RobotPath {
        let segments = segments
            .iter()
            .map(|&[secs, speed_m_s, turn_rate_rad_s]| VelocitySegment { secs, speed_m_s, turn_rate_rad_s })
            .collect();
        RobotPath::VelocityProfile { start: Pose2::new(1.0, 2.0, 0.0), segments }
    }

    fn assert_near(pose: Pose2, x: f64, y: f64, theta: f64) {
        let error = pose.relative_to(&Pose2::new(x, y, theta));
        assert!(error.position().length() < 1e-9 && error.theta.abs() < 1e-9, "{pose:?}");
    }

    #[test]
    fn waypoints_are_driven_straight_with_turns_in_place() {
        let path = Trajectory::new(&waypoints(&[[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]])).unwrap();
        let turned = 4.0 + FRAC_PI_2 / 0.5;
        assert!((path.duration_secs() - (turned + 2.0)).abs() < 1e-12);
        assert_near(path.pose_at(-1.0), 0.0, 0.0, 0.0);
        assert_near(path.pose_at(1.0), 0.5, 0.0, 0.0);
        assert_near(path.pose_at(5.0), 2.0, 0.0, 0.5);
        assert_near(path.pose_at(turned + 1.0), 2.0, 0.5, FRAC_PI_2);
        assert_near(path.pose_at(99.0), 2.0, 1.0, FRAC_PI_2);
    }

    #[test]
    fn a_path_back_turns_by_half_a_turn() {
        let path = Trajectory::new(&waypoints(&[[0.0, 0.0], [1.0, 0.0], [0.0, 0.0]])).unwrap();
        assert!((path.duration_secs() - (2.0 + PI / 0.5 + 2.0)).abs() < 1e-12);
        assert_near(path.pose_at(path.duration_secs()), 0.0, 0.0, PI);
    }

    /// A quarter circle of radius 2 m to the left, back along it, a stop, a turn in place.
    #[test]
    fn a_profile_drives_arcs_reverses_stops_and_turns_in_place() {
        let quarter = FRAC_PI_2 / 0.25;
        let path = profile(&[
            [quarter, 0.5, 0.25],
            [quarter, -0.5, -0.25],
            [3.0, 0.0, 0.0],
            [2.0, 0.0, -0.5],
            [1.0, -1.0, 0.0],
        ]);
        let path = Trajectory::new(&path).unwrap();
        assert_near(path.pose_at(quarter), 3.0, 4.0, FRAC_PI_2);
        assert_near(path.pose_at(0.5 * quarter), 1.0 + 2.0_f64.sqrt(), 4.0 - 2.0_f64.sqrt(), 0.5 * FRAC_PI_2);
        for secs in [0.0, 1.5, 3.0] {
            assert_near(path.pose_at(2.0 * quarter + secs), 1.0, 2.0, 0.0);
        }
        assert_near(path.pose_at(2.0 * quarter + 5.0), 1.0, 2.0, -1.0);
        assert_near(path.pose_at(99.0), 1.0 - 1.0_f64.cos(), 2.0 + 1.0_f64.sin(), -1.0);
    }

    fn any_path() -> impl Strategy<Value = RobotPath> {
        let waypoints = prop::collection::vec((-5.0..5.0, -5.0..5.0), 2..6)
            .prop_map(|points| waypoints(&points.iter().map(|&(x, y)| [x, y]).collect::<Vec<_>>()));
        let profile = prop::collection::vec((0.1..3.0, -1.0..1.0, -1.5..1.5), 1..6)
            .prop_map(|arcs| profile(&arcs.iter().map(|&(t, v, w)| [t, v, w]).collect::<Vec<_>>()));
        prop_oneof![waypoints, profile]
    }

    proptest! {
        /// No jump: within dt a robot moves at most by its speed (1 m/s) and turns at most by its rate (1.5
        /// rad/s).
        #[test]
        fn paths_are_continuous(path in any_path(), share in 0.0..1.0f64, dt in 0.0..0.5f64) {
            let path = Trajectory::new(&path).unwrap();
            let secs = share * path.duration_secs();
            let motion = path.pose_at(secs + dt).relative_to(&path.pose_at(secs));
            prop_assert!(motion.position().length() <= dt + 1e-9);
            prop_assert!(motion.theta.abs() <= 1.5 * dt + 1e-9);
        }

        /// Wheels don't slip sideways: over 2 h the motion seen from its middle heading is straight up to
        /// O(h^2).
        #[test]
        fn motion_is_along_the_heading(path in any_path(), share in 0.0..1.0f64) {
            let path = Trajectory::new(&path).unwrap();
            let (secs, h) = (share * path.duration_secs(), 1e-5);
            let motion = path.pose_at(secs + h).position() - path.pose_at(secs - h).position();
            let sideways = DVec2::from_angle(path.pose_at(secs).theta).perp_dot(motion);
            prop_assert!(sideways.abs() < 1e-9, "{}", sideways);
        }

        #[test]
        fn a_nearly_straight_arc_is_the_limit_of_arcs(rate in -1e-3..1e-3f64) {
            let straight = Trajectory::new(&profile(&[[1.0, 1.0, 0.0]])).unwrap().pose_at(1.0);
            let arc = Trajectory::new(&profile(&[[1.0, 1.0, rate]])).unwrap().pose_at(1.0);
            // The circle leaves its tangent by rate/2 sideways and by rate^2/6 lengthways.
            prop_assert!((arc.y - straight.y - 0.5 * rate).abs() < 1e-10);
            prop_assert!((arc.x - straight.x).abs() < 0.2 * rate * rate + 1e-15);
        }
    }

    #[test]
    fn the_start_moves_alone_in_waypoints_and_with_the_path_in_a_profile() {
        let offset = DVec2::new(0.0, 0.5);
        let points = Trajectory::new(&waypoints(&[[0.0, 0.0], [2.0, 0.5]]).with_start_moved(offset)).unwrap();
        assert_near(points.pose_at(0.0), 0.0, 0.5, 0.0);
        assert_near(points.pose_at(99.0), 2.0, 0.5, 0.0);
        let arcs = Trajectory::new(&profile(&[[1.0, 1.0, 0.0]]).with_start_moved(offset)).unwrap();
        assert_near(arcs.pose_at(1.0), 2.0, 2.5, 0.0);
    }

    #[test]
    fn degenerate_paths_are_refused() {
        let nan = f64::NAN;
        let with_speed = |speed_m_s, turn_rate_rad_s| RobotPath::Waypoints {
            points_m: vec![[0.0, 0.0], [1.0, 0.0]],
            speed_m_s,
            turn_rate_rad_s,
        };
        for (path, message) in [
            (waypoints(&[]), "at least 2 waypoints; got 0"),
            (waypoints(&[[1.0, 1.0]]), "at least 2 waypoints; got 1"),
            (waypoints(&[[1.0, 1.0], [nan, 0.0]]), "point 1 of the path is not finite"),
            (waypoints(&[[0.0, 1.0], [1.0, 1.0], [1.0, 1.0]]), "waypoint 2 coincides"),
            (with_speed(0.0, 1.0), "speed on a leg [m/s] must be above 0; got 0"),
            (with_speed(1.0, -1.0), "turn rate at a waypoint [rad/s] must be above 0; got -1"),
            (profile(&[]), "at least one segment"),
            (profile(&[[1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]), "segment 1 of the velocity profile"),
            (profile(&[[1.0, nan, 0.0]]), "segment 0 of the velocity profile"),
            (profile(&[[1e308, 0.0, 0.0], [1e308, 0.0, 0.0]]), "duration of the path [s] must be finite"),
        ] {
            let error = Trajectory::new(&path).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }
}
