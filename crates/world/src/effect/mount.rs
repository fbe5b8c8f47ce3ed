//! Effects on where the laser sits on the robot.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::DVec2;
use locsim_core::{Pose2, wrap_angle};

use super::effect_type::EffectType;
use super::statistic::{Direction, Score, TYPICAL};
use super::{Description, Effect, EffectKind, Experiment, Moves, Parameter, Statistic};

/// The laser is turned.
pub(super) struct MountYaw;

impl EffectType for MountYaw {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "mount_yaw",
                parameters: &[Parameter::strength("yaw_rad", "rad", 0.0, [-PI, PI], 0.02).key("yaw_deg")],
                formula: "the laser's heading on the robot + yaw_rad",
                sentence: "The laser sits on the robot at another angle than the description says.",
                sides: Some([
                    "The laser sits on the robot turned to the right of what the description says.",
                    "The laser sits on the robot turned to the left of what the description says.",
                ]),
                signature: "residuals signed by the slant of the wall, the same wherever the robot is",
                confused_with: &[EffectKind::OdomImbalance, EffectKind::MotionSkew, EffectKind::TimeOffset],
                experiments: &[Experiment::TurnsAndLines],
                statistics: &[
                    Statistic::Score {
                        score: Score::Location,
                        weight: |beam, _| beam.jacobian[2],
                        directions: TYPICAL,
                    },
                    Statistic::Pose {
                        // The laser turns about itself, the robot about its centre.
                        pattern: |robot, _| {
                            let turned = DVec2::from_angle(robot.heading).rotate(robot.mount);
                            (-turned.perp()).extend(1.0).to_array()
                        },
                        directions: TYPICAL,
                    },
                    Statistic::Turn,
                ],
                moves: Moves::Scans,
                is_correctable: true,
                ..Description::DEFAULT
            }
        }
    }

    fn laser_mount(&self, effect: &Effect, mount: Pose2) -> Pose2 {
        let [yaw_rad] = effect.numbers();
        Pose2 { theta: wrap_angle(mount.theta + yaw_rad), ..mount }
    }
}

/// The laser is displaced.
pub(super) struct MountOffset;

/// A laser displaced to the front, and one displaced to the left.
const FRONT_AND_LEFT: &[Direction] = &[&[(0, 0.02), (1, 0.0)], &[(0, 0.0), (1, 0.02)]];

/// The angle from the robot's heading in which one of [`FRONT_AND_LEFT`] displaces the laser \[rad\].
fn angle(values: &[f64]) -> f64 {
    if values[0] == 0.0 { FRAC_PI_2 } else { 0.0 }
}

impl EffectType for MountOffset {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "mount_offset",
                parameters: &[
                    Parameter::strength("x_m", "m", 0.0, [-2.0, 2.0], 0.03).default(0.0),
                    Parameter::strength("y_m", "m", 0.0, [-2.0, 2.0], 0.03).default(0.0),
                ],
                formula: "the laser's position on the robot + (x_m, y_m), x forward, y left",
                sentence: "The laser sits elsewhere on the robot than the description says.",
                signature: "residuals signed by bearing, turning with the robot",
                confused_with: &[EffectKind::TimeOffset],
                experiments: &[Experiment::Reverse],
                statistics: &[
                    Statistic::Score {
                        score: Score::Location,
                        weight: |beam, values| beam.range_along(angle(values)),
                        directions: FRONT_AND_LEFT,
                    },
                    Statistic::Pose {
                        pattern: |robot, values| {
                            DVec2::from_angle(robot.heading + angle(values)).extend(0.0).to_array()
                        },
                        directions: FRONT_AND_LEFT,
                    },
                ],
                moves: Moves::Scans,
                is_correctable: true,
                ..Description::DEFAULT
            }
        }
    }

    fn laser_mount(&self, effect: &Effect, mount: Pose2) -> Pose2 {
        let [x_m, y_m] = effect.numbers();
        Pose2 { x: mount.x + x_m, y: mount.y + y_m, ..mount }
    }
}
