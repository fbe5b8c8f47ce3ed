//! Effects that read what isn't there.

use locsim_core::{Draw, Stage};
use rand::RngExt;

use super::effect_type::EffectType;
use super::reading::{Hit, Return};
use super::statistic::{Score, TYPICAL};
use super::{
    Alternative, Bursts, Description, Effect, EffectKind, Fit, Needs, Parameter, Prior, Replacement,
    Statistic,
};

/// Length of the windows that bursts of crosstalk fall on \[s\].
pub(super) const BURST_SECS: f64 = 1.0;

/// Returns between the two surfaces of an edge.
pub(super) struct MixedPixels;

impl EffectType for MixedPixels {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "mixed_pixels",
                parameters: &[Parameter::probability(0.3)],
                formula: "with p: U(near, far) where the nominal range jumps by more than 0.3 m to a neighbouring beam",
                sentence: "At an edge a beam lights up two surfaces and reads something in between.",
                signature: "readings between near and far at jumps of the range",
                confused_with: &[EffectKind::Crosstalk],
                statistics: &[Statistic::Edge],
                replaces: Some(Replacement::Edge),
                needs: Needs { map: true, jump: true, behind: false },
                is_as_map_errors: true,
                ..Description::DEFAULT
            }
        }
    }

    fn reading(&self, effect: &Effect, hit: &Hit<'_>, reading: &mut Return<'_>) {
        let [p] = effect.numbers();
        if hit.mapped
            && let Some([lo, hi]) = hit.view.jump
        {
            reading.or(p, Alternative::Between { lo, hi });
        }
    }
}

/// Bursts of random readings.
pub(super) struct Crosstalk;

impl EffectType for Crosstalk {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "crosstalk",
                parameters: &[
                    Parameter::probability(0.3),
                    Parameter::shape("share", "1", [0.0, 1.0], 0.2)
                        .prior(Prior::LogNormal { offset: 0.0, sd: 1.0 }),
                ],
                formula: "with p: U(0, R), in those windows of 1 s that a burst falls on, each with probability share",
                sentence: "Another sensor's light disturbs the laser for seconds at a time: some readings are random.",
                signature: "random readings at all bearings, in clusters of time",
                confused_with: &[EffectKind::MixedPixels, EffectKind::HeavyTail],
                statistics: &[Statistic::Score {
                    score: Score::Uniform,
                    weight: |_, _| 1.0,
                    directions: TYPICAL,
                }],
                fit: Fit::WithClutter,
                replaces: Some(Replacement::Interference),
                ..Description::DEFAULT
            }
        }
    }

    fn reading(&self, effect: &Effect, hit: &Hit<'_>, reading: &mut Return<'_>) {
        let [p, share] = effect.numbers();
        reading.or(p * hit.burst(share), Alternative::Between { lo: 0.0, hi: hit.max });
    }

    fn bursts(&self, effect: &Effect) -> Option<Bursts> {
        let [p, share] = effect.numbers();
        let with = |p| Effect { values: vec![p, 1.0], ..effect.clone() };
        Some(Bursts { share, on: with(p), off: with(0.0), spread: with(p * share) })
    }
}

/// The window of bursts, of 1 s each, that a time \[s\] falls into. Times before the start, of beams that are early, fall
/// into the first.
pub fn burst_window(secs: f64) -> u32 {
    (secs / BURST_SECS) as u32
}

/// Whether bursts fall on a window, for [`Effects::reading_of`](super::Effects::reading_of): 1 or 0, by a draw for each
/// window.
pub(crate) fn burst(seed: u64, window: u32) -> impl Fn(usize, f64) -> f64 {
    let draw = Draw::new(seed, Stage::Effect, window);
    // Items from the last downwards, which no beam uses; the very last is that of the odometry.
    move |i, share| f64::from(draw.item(u32::MAX - 1 - i as u32).random::<f64>() < share)
}
