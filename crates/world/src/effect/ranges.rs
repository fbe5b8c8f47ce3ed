//! Effects on the mean of returns, and on the steps of readings.

use super::beam::tan_squared;
use super::effect_type::EffectType;
use super::reading::{Hit, Return};
use super::statistic::{Score, TYPICAL};
use super::{Description, Effect, EffectKind, Experiment, Moves, Needs, Parameter, Prior, Statistic};

/// Every return is off by the same length.
pub(super) struct RangeBias;

impl EffectType for RangeBias {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "range_bias",
                parameters: &[Parameter::strength("bias_m", "m", 0.0, [-1.0, 1.0], 0.02)],
                formula: "mean = r + bias_m",
                sentence: "Every return is too long or too short by the same length.",
                sides: Some([
                    "Every return is too short by the same length.",
                    "Every return is too long by the same length.",
                ]),
                signature: "a flat shift of the residuals over range, incidence, bearing and time",
                confused_with: &[EffectKind::RangeScale, EffectKind::WarmupDrift],
                experiments: &[Experiment::Ranges, Experiment::WarmedUp],
                statistics: &[Statistic::Score {
                    score: Score::Location,
                    weight: |_, _| 1.0,
                    directions: TYPICAL,
                }],
                moves: Moves::Readings,
                ..Description::DEFAULT
            }
        }
    }

    fn reading(&self, effect: &Effect, _: &Hit<'_>, reading: &mut Return<'_>) {
        let [bias_m] = effect.numbers();
        reading.bias += bias_m;
    }
}

/// Every return is off by the same share of its range.
pub(super) struct RangeScale;

impl EffectType for RangeScale {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "range_scale",
                parameters: &[Parameter::strength("k", "1", 0.0, [-0.2, 0.2], 0.01)],
                formula: "mean = r (1 + k)",
                sentence: "Every return is too long or too short by the same share of its range.",
                sides: Some([
                    "Every return is too short by the same share of its range.",
                    "Every return is too long by the same share of its range.",
                ]),
                signature: "a shift of the residuals that is linear in range",
                confused_with: &[EffectKind::RangeBias, EffectKind::WarmupDrift],
                experiments: &[Experiment::Ranges],
                statistics: &[Statistic::Score {
                    score: Score::Location,
                    weight: |beam, _| beam.range,
                    directions: TYPICAL,
                }],
                moves: Moves::Readings,
                ..Description::DEFAULT
            }
        }
    }

    fn reading(&self, effect: &Effect, _: &Hit<'_>, reading: &mut Return<'_>) {
        let [k] = effect.numbers();
        reading.scale += k;
    }
}

/// Returns of slanted walls are off.
pub(super) struct IncidenceBias;

impl EffectType for IncidenceBias {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "incidence_bias",
                parameters: &[Parameter::strength("bias_m", "m", 0.0, [-0.5, 0.5], 0.01)],
                formula: "mean = r + bias_m tan^2(alpha), alpha at most 80 deg, on walls",
                sentence: "Returns of slanted walls are too long or too short: the spot that a beam lights up is \
                           stretched.",
                sides: Some([
                    "Returns of slanted walls are too short: the spot that a beam lights up is stretched.",
                    "Returns of slanted walls are too long: the spot that a beam lights up is stretched.",
                ]),
                signature: "a shift of the residuals that depends on incidence alone",
                confused_with: &[EffectKind::MovedWall, EffectKind::RangeScale],
                statistics: &[Statistic::Score {
                    score: Score::Location,
                    weight: |beam, _| tan_squared(beam.incidence),
                    directions: TYPICAL,
                }],
                moves: Moves::Readings,
                needs: Needs::MAP,
                ..Description::DEFAULT
            }
        }
    }

    fn reading(&self, effect: &Effect, hit: &Hit<'_>, reading: &mut Return<'_>) {
        let [bias_m] = effect.numbers();
        reading.wall_bias += bias_m * hit.tan_squared();
    }
}

/// A bias that dies away after the start.
pub(super) struct WarmupDrift;

impl EffectType for WarmupDrift {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "warmup_drift",
                parameters: &[
                    Parameter::strength("bias_m", "m", 0.0, [-1.0, 1.0], 0.03),
                    Parameter::shape("tau_secs", "s", [0.1, 1e5], 60.0)
                        .default(60.0)
                        .prior(Prior::LogNormal { offset: 0.0, sd: 1.5 }),
                ],
                formula: "mean = r + bias_m exp(-t / tau_secs), t since the first scan",
                sentence: "Just after the start returns are off; the shift dies away as the sensor warms up.",
                sides: Some([
                    "Just after the start returns are too short; the shift dies away as the sensor warms up.",
                    "Just after the start returns are too long; the shift dies away as the sensor warms up.",
                ]),
                signature: "a shift that fades with time",
                confused_with: &[EffectKind::RangeBias, EffectKind::RangeScale],
                experiments: &[Experiment::WarmedUp],
                statistics: &[Statistic::Score {
                    score: Score::Location,
                    weight: |beam, values| (-beam.secs / values[1]).exp(),
                    // Seconds to minutes, as sensors warm up.
                    directions: &[&[(1, 5.0)], &[(1, 20.0)], &[(1, 60.0)], &[(1, 150.0)]],
                }],
                moves: Moves::Readings,
                is_correctable: true,
                ..Description::DEFAULT
            }
        }
    }

    fn reading(&self, effect: &Effect, hit: &Hit<'_>, reading: &mut Return<'_>) {
        reading.bias += self.drift_m(effect, hit.view.secs);
    }

    fn drift_m(&self, effect: &Effect, secs: f64) -> f64 {
        let [bias_m, tau_secs] = effect.numbers();
        bias_m * (-secs / tau_secs).exp()
    }
}

/// Readings in steps.
pub(super) struct Quantization;

impl EffectType for Quantization {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "quantization",
                parameters: &[Parameter::step("step_m", "m", [0.0, 1.0], 0.05)],
                formula: "round(z / step_m) step_m",
                sentence: "Readings come in coarse steps.",
                signature: "what is left of readings modulo the step",
                confused_with: &[EffectKind::RangeNoise],
                statistics: &[Statistic::Step],
                ..Description::DEFAULT
            }
        }
    }

    fn reading(&self, effect: &Effect, _: &Hit<'_>, reading: &mut Return<'_>) {
        let [step_m] = effect.numbers();
        reading.step_m = step_m.max(reading.step_m);
    }
}
