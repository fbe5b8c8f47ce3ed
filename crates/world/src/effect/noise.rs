//! Effects on the spread of returns.

use super::beam::tan_squared;
use super::effect_type::EffectType;
use super::reading::{Hit, Return};
use super::statistic::{Score, TYPICAL};
use super::{Description, Effect, EffectKind, Needs, Parameter, Statistic};

/// Noise that grows faster with range.
pub(super) struct RangeNoise;

impl EffectType for RangeNoise {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "range_noise",
                parameters: &[Parameter::strength("growth", "1/m", 0.0, [0.0, 0.1], 0.001)],
                formula: "sigma = sigma(r) + growth r^2",
                sentence: "Far returns are noisier than the nominal sensor's.",
                signature: "residuals that spread with range",
                confused_with: &[EffectKind::IncidenceNoise, EffectKind::HeavyTail],
                statistics: &[Statistic::Score {
                    score: Score::Scale,
                    weight: |beam, _| beam.range * beam.range / beam.sigma,
                    directions: TYPICAL,
                }],
                is_as_map_errors: true,
                ..Description::DEFAULT
            }
        }
    }

    fn reading(&self, effect: &Effect, _: &Hit<'_>, reading: &mut Return<'_>) {
        let [growth] = effect.numbers();
        reading.growth += growth;
    }
}

/// Noise that grows with the slant of a wall.
pub(super) struct IncidenceNoise;

impl EffectType for IncidenceNoise {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "incidence_noise",
                parameters: &[Parameter::strength("growth", "1", 0.0, [0.0, 50.0], 1.0)],
                formula: "sigma = sigma(r) (1 + growth tan^2(alpha)), alpha at most 80 deg, on walls",
                sentence: "Returns of slanted walls are noisier than the nominal sensor's.",
                signature: "residuals that spread with incidence",
                confused_with: &[EffectKind::RangeNoise, EffectKind::HeavyTail],
                statistics: &[Statistic::Score {
                    score: Score::Scale,
                    weight: |beam, _| tan_squared(beam.incidence),
                    directions: TYPICAL,
                }],
                needs: Needs::MAP,
                is_as_map_errors: true,
                ..Description::DEFAULT
            }
        }
    }

    fn reading(&self, effect: &Effect, hit: &Hit<'_>, reading: &mut Return<'_>) {
        let [growth] = effect.numbers();
        reading.wall_sigma += growth * hit.tan_squared();
    }
}

/// A share of the returns with [`TAIL_FACTOR`](super::TAIL_FACTOR) times the noise.
pub(super) struct HeavyTail;

impl EffectType for HeavyTail {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "heavy_tail",
                parameters: &[Parameter::probability(0.05)],
                formula: "(1 - p) N(mean, sigma) + p N(mean, 5 sigma)",
                sentence: "Some returns, anywhere, have five times the usual noise.",
                signature: "both ends of the residuals, everywhere alike",
                confused_with: &[EffectKind::RangeNoise, EffectKind::IncidenceNoise],
                statistics: &[Statistic::Score {
                    score: Score::Tail,
                    weight: |_, _| 1.0,
                    directions: TYPICAL,
                }],
                is_as_map_errors: true,
                ..Description::DEFAULT
            }
        }
    }

    fn reading(&self, effect: &Effect, _: &Hit<'_>, reading: &mut Return<'_>) {
        let [p] = effect.numbers();
        // One or the other, or both.
        reading.tail += p - reading.tail * p;
    }
}
