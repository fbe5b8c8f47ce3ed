//! Effects on when beams are taken.

use std::f64::consts::{PI, TAU};

use locsim_core::wrap_angle;

use super::beam::BEARING_MARGIN;
use super::effect_type::EffectType;
use super::statistic::{Score, TYPICAL};
use super::{Description, Effect, EffectKind, Experiment, Moves, Parameter, Site, Statistic};

/// Stamps that are early or late.
pub(super) struct TimeOffset;

impl EffectType for TimeOffset {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "time_offset",
                site: Site::Clock,
                parameters: &[Parameter::strength("delay_secs", "s", 0.0, [-1.0, 1.0], 0.05)],
                formula: "beams are taken delay_secs after their stamps",
                sentence: "The stamps of the scans are early or late: the robot has moved on when the beams are \
                           taken.",
                sides: Some([
                    "The stamps of the scans are late: the beams are taken before the robot is there.",
                    "The stamps of the scans are early: the robot has moved on when the beams are taken.",
                ]),
                signature: "residuals in proportion to speed and turn rate, reversed with the motion",
                confused_with: &[EffectKind::MountOffset, EffectKind::MountYaw],
                experiments: &[Experiment::Reverse],
                statistics: &[
                    Statistic::Score {
                        score: Score::Location,
                        weight: |beam, _| beam.range_rate(),
                        directions: TYPICAL,
                    },
                    Statistic::Pose { pattern: |robot, _| robot.velocity, directions: TYPICAL },
                ],
                moves: Moves::Scans,
                is_correctable: true,
                ..Description::DEFAULT
            }
        }
    }

    fn beam_secs(&self, effect: &Effect, _: f64, secs: f64) -> f64 {
        let [delay_secs] = effect.numbers();
        secs + delay_secs
    }
}

/// A sweep that takes another time than its beams' stamps say.
pub(super) struct MotionSkew;

impl EffectType for MotionSkew {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "motion_skew",
                site: Site::Clock,
                parameters: &[Parameter::strength("sweep_secs", "s", 0.0, [-1.0, 1.0], 0.05)],
                formula: "beams are taken sweep_secs (bearing / 2 pi) after their stamps, bearing in (-pi, pi]",
                sentence: "A sweep takes longer or shorter than the beams' stamps say.",
                sides: Some([
                    "A sweep takes less time than the beams' stamps say, or goes the other way round.",
                    "A sweep takes more time than the beams' stamps say.",
                ]),
                signature: "residuals in proportion to bearing times turn rate or speed",
                confused_with: &[EffectKind::TimeOffset, EffectKind::MountYaw],
                experiments: &[Experiment::Reverse],
                statistics: &[Statistic::Score {
                    score: Score::Location,
                    weight: |beam, _| beam.range_rate() * (wrap_angle(beam.bearing) / TAU),
                    directions: TYPICAL,
                }],
                moves: Moves::Scans,
                ..Description::DEFAULT
            }
        }
    }

    fn beam_secs(&self, effect: &Effect, bearing: f64, secs: f64) -> f64 {
        let [sweep_secs] = effect.numbers();
        secs + sweep_secs * in_half_turns(bearing) / TAU
    }
}

/// A bearing in (-pi, pi] \[rad\].
fn in_half_turns(bearing: f64) -> f64 {
    if bearing.abs() <= PI + BEARING_MARGIN { bearing } else { wrap_angle(bearing) }
}
