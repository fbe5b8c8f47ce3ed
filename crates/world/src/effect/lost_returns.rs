//! Effects that lose returns.

use std::f64::consts::FRAC_PI_2;

use super::effect_type::EffectType;
use super::reading::{Hit, Return};
use super::statistic::Score;
use super::{
    Alternative, Description, Effect, EffectKind, Experiment, HitKind, Needs, Parameter, Prior, Replacement,
    Statistic,
};

/// No return from slanted walls.
pub(super) struct IncidenceDropout;

/// Width of the onset in the directions of the search \[rad\]: that of the steep onsets which are sought, and of the
/// width of a bin of incidence or so.
const ONSET_RAD: f64 = 0.07;

/// P(no return) of a wall: p (1 + exp(-(alpha - angle) / width))^-1.
fn onset(incidence: f64, angle: f64, width: f64) -> f64 {
    1.0 / (1.0 + (-(incidence - angle) / width).exp())
}

impl EffectType for IncidenceDropout {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "incidence_dropout",
                parameters: &[
                    Parameter::probability(0.5),
                    Parameter::shape("angle_rad", "rad", [0.0, FRAC_PI_2], 1.2)
                        .key("angle_deg")
                        .prior(Prior::Normal { sd: 0.25 }),
                    Parameter::shape("width_rad", "rad", [0.001, 1.0], 0.05)
                        .key("width_deg")
                        .default(3.0)
                        .prior(Prior::LogNormal { offset: 0.0, sd: 0.7 }),
                ],
                formula: "P(no return) = p / (1 + exp(-(alpha - angle_rad) / width_rad)), on walls",
                sentence: "Slanted walls often send nothing back.",
                signature: "missing returns that set in at an incidence",
                confused_with: &[EffectKind::RangeDropout, EffectKind::Glass],
                experiments: &[Experiment::RangeAndIncidence],
                statistics: &[Statistic::Score {
                    score: Score::NoReturn,
                    weight: |beam, values| onset(beam.incidence, values[1], ONSET_RAD),
                    directions: &[
                        &[(1, 30.0_f64.to_radians())],
                        &[(1, 45.0_f64.to_radians())],
                        &[(1, 60.0_f64.to_radians())],
                        &[(1, 70.0_f64.to_radians())],
                        &[(1, 80.0_f64.to_radians())],
                    ],
                }],
                replaces: Some(Replacement::Surface),
                needs: Needs::MAP,
                ..Description::DEFAULT
            }
        }
    }

    fn reading(&self, effect: &Effect, hit: &Hit<'_>, reading: &mut Return<'_>) {
        let [p, angle_rad, width_rad] = effect.numbers();
        if hit.is_in_range() && hit.met == HitKind::Wall {
            reading.or(p * onset(hit.view.incidence, angle_rad, width_rad), Alternative::NoReturn);
        }
    }
}

/// Losses with a smaller exponent hardly grow with range.
const EVEN: f64 = 0.5;

/// No return from far away.
pub(super) struct RangeDropout;

impl EffectType for RangeDropout {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "range_dropout",
                parameters: &[
                    Parameter::probability(0.2),
                    Parameter::shape("exponent", "1", [0.0, 20.0], 4.0)
                        .default(4.0)
                        .prior(Prior::LogNormal { offset: 1.0, sd: 0.7 }),
                ],
                formula: "P(no return) = p (r / R)^exponent, R the maximum range",
                sentence: "Far surfaces often send nothing back.",
                sentence_of: |values| {
                    (values[1] < EVEN).then_some("Returns get lost, from near and far alike.")
                },
                signature: "missing returns that grow with range",
                confused_with: &[EffectKind::IncidenceDropout],
                experiments: &[Experiment::RangeAndIncidence],
                statistics: &[Statistic::Score {
                    score: Score::NoReturn,
                    weight: |beam, values| (beam.range / beam.max_range).min(1.0).powf(values[1]),
                    // From losses at any range to losses at the maximum range alone.
                    directions: &[&[(1, 0.0)], &[(1, 1.0)], &[(1, 2.0)], &[(1, 4.0)], &[(1, 8.0)]],
                }],
                replaces: Some(Replacement::Distance),
                ..Description::DEFAULT
            }
        }
    }

    fn reading(&self, effect: &Effect, hit: &Hit<'_>, reading: &mut Return<'_>) {
        let [p, exponent] = effect.numbers();
        if hit.is_in_range() {
            reading.or(p * (hit.range / hit.max).powf(exponent), Alternative::NoReturn);
        }
    }
}
