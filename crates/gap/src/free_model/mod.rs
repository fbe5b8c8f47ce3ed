//! A model of the readings that may take any shape: distribution regression of their PITs over what a beam is.
//!
//! It is the judge of the named effects. A simulator lacks nothing that can be learnt if no such model, fitted on some
//! stretches of the drive, predicts the readings of the others better. The model is additive: each of a few moments of a
//! reading ([`MOMENTS`]) is a sum of free curves, each over one covariate. Curves are added greedily, the one that gains most on
//! held-out folds first (componentwise boosting; Buehlmann and Yu 2003), until none gains. Of covariates that can't be told from
//! the one that gains most the simplest is taken ([`simplest`]).
//!
//! | step | code |
//! | --- | --- |
//! | the reading as an outcome of a few classes and bins, with its probabilities under the hypothesis | [`outcomes`] |
//! | levels of the covariates | [`covariates`] |
//! | curves that are added one by one | [`boosting`] |
//! | one smooth curve, fitted without each fold | [`distreg::curve`] |

mod boosting;
mod covariates;
mod frame;
mod lag;
mod large;
mod outcomes;

use locsim_core::{Draw, Folds};
use locsim_world::effect::Effects;

pub(crate) use covariates::{Axis, Covariates};
pub(crate) use frame::misaligned_frame;
pub(crate) use lag::lag;

use crate::null::REFIT;
use crate::statistics::{Covariate, Deviation};
use large::{Change, Large};
use locsim_comparison::{Comparison, Fitted};
use outcomes::Outcomes;
pub(crate) use outcomes::is_share;

/// A log on which the curves gain more than this (nats) is looked at for a bias or a spread of many standard deviations.
const STRONG_NATS: f64 = 200.0;
/// Mean and spread among the moments.
const MEAN: usize = 0;
const SPREAD: usize = 1;

/// The folds of a log that a model is learnt from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// All of them.
    Whole,
    /// Every other one, of which this is the first: 0 or 1.
    Half(usize),
}

impl Part {
    fn includes(self, fold: usize) -> bool {
        match self {
            Self::Whole => true,
            Self::Half(first) => fold % 2 == first,
        }
    }
}

/// One moment of a reading as a curve over one covariate.
#[derive(Clone, Debug)]
pub(crate) struct Component {
    pub moment: Deviation,
    pub covariate: Covariate,
    /// The covariate's index among [`Covariates`].
    pub axis: usize,
    /// Its value at each level, with its standard error: the mean of a reading of the surface \[m\], its spread (a factor,
    /// less 1), its skewness, or the share of readings of a kind. `None` where no reading is.
    pub curve: Vec<Option<[f64; 2]>>,
    /// Log score gained on held-out folds (nats).
    pub gains: Vec<f64>,
}

impl Component {
    pub fn gain(&self) -> f64 {
        self.gains.iter().sum()
    }
}

/// By how much odometry or reference are off as a whole.
#[derive(Clone, Debug)]
pub(crate) struct Misalignment {
    pub deviation: Deviation,
    pub covariate: Covariate,
    /// Fitted to a log, SI unit, each with its standard error.
    pub estimates: Vec<[f64; 2]>,
    /// Log score gained on folds (nats).
    pub gains: Vec<f64>,
}

impl Misalignment {
    pub fn gain(&self) -> f64 {
        self.gains.iter().sum()
    }
}

/// The free model of a log on top of a hypothesis.
#[derive(Clone, Debug)]
pub(crate) struct FreeModel {
    /// Its curves, in the order in which they were added.
    pub components: Vec<Component>,
    /// Correlation of neighbouring beams' readings of the surface, beyond the model.
    pub neighbour_correlation: f64,
    folds: Folds,
}

impl FreeModel {
    /// Learns the model from a log under a hypothesis, which the comparison's views are of.
    pub fn new(
        comparison: &Comparison<'_>,
        effects: &Effects,
        fitted: &Fitted,
        covariates: &Covariates,
        draw: &Draw,
        part: Part,
    ) -> Self {
        let folds = comparison.recorded.folds;
        let outcomes_of = |fitted: &Fitted, changes: Option<&[Change]>| {
            let mut outcomes = Outcomes::new(comparison, effects, fitted, draw, changes);
            outcomes.all.retain(|outcome| part.includes(folds.of_scan(outcome.scan as usize)));
            outcomes
        };
        let plain = Self::of(&outcomes_of(fitted, None), covariates, folds, None);
        let gain = |model: &Self| model.gains().iter().sum::<f64>();
        if gain(&plain) < STRONG_NATS {
            return plain;
        }
        let of_folds = |fitted: &Fitted| -> Vec<f64> {
            folds.sums(&comparison.evaluate_views(&comparison.views, effects, fitted, 0).scans)
        };
        let own = of_folds(fitted);
        let look = |other: &Fitted| {
            // What each fold gains by other errors of the reference alone.
            let gains = of_folds(other).into_iter().zip(&own).enumerate();
            let of_part = |(fold, (other, own))| if part.includes(fold) { other - own } else { 0.0 };
            let before: Vec<f64> = gains.map(of_part).collect();
            let with_before = |mut large: Large| {
                large.gains.iter_mut().zip(&before).for_each(|(gain, before)| *gain += before);
                (other.clone(), large)
            };
            let (best, bias) = Large::of_moments(comparison, effects, other, covariates, folds, part);
            (best.into_iter().map(with_before).collect::<Vec<_>>(), bias)
        };
        // Beside a strong bias errors of the reference can't be fitted: they absorb some of it, so that what is left looks like a spread, or seem
        // to be none. So the bias is looked for with an exact reference, and again with the errors that are found once it is taken off.
        let exact = comparison.start_exact(&fitted.nuisances);
        let start = exact.as_ref().unwrap_or(fitted);
        let (mut large, bias) = look(start);
        if exact.is_some() {
            large.extend(look(fitted).0);
        }
        if let Some(bias) = bias.filter(|bias| bias.gain() > STRONG_NATS) {
            let rest = bias.taken_off(comparison, start);
            let other = comparison.of(&rest).find_nuisances(effects, &fitted.nuisances, REFIT);
            large.extend(look(&other).0);
        }
        let changed =
            large.into_iter().max_by(|a, b| a.1.gain().total_cmp(&b.1.gain())).map(|(fitted, large)| {
                let outcomes = outcomes_of(&fitted, Some(&large.of_readings));
                Self::of(&outcomes, covariates, folds, Some(large))
            });
        changed.filter(|changed| gain(changed) > gain(&plain)).unwrap_or(plain)
    }

    /// Log score gained on held-out folds (nats).
    pub fn gains(&self) -> Vec<f64> {
        let of_fold = |fold: usize| self.components.iter().map(|component| component.gains[fold]).sum();
        (0..self.folds.count()).map(of_fold).collect()
    }

    /// The gain of a moment over the neighbouring beam, or over all other covariates together (nats): which of those a log's curves
    /// are over is chance where they can't be told from each other.
    pub fn gain_of(&self, moment: Deviation, covariate: Covariate) -> f64 {
        let is_neighbour = |covariate| covariate == Covariate::Neighbour;
        let alike =
            |c: &&Component| c.moment == moment && is_neighbour(c.covariate) == is_neighbour(covariate);
        self.components.iter().filter(alike).map(Component::gain).sum()
    }
}

#[cfg(test)]
mod tests {
    use locsim_comparison::Nuisances;
    use locsim_comparison::fixtures::{self, NOMINAL, TRUTH};
    use locsim_comparison::hidden::{Regime, record_library};

    use super::*;
    use crate::statistics::pit_draw;
    use crate::{PoseError, Recorded};
    use locsim_core::Drive;
    use locsim_world::effect::{Effect, EffectKind};
    use rand_distr::{Distribution, StandardNormal};

    fn learnt(drive: &Drive, check: impl FnOnce(&FreeModel, &Covariates)) {
        let recorded = Recorded::new(drive, 400, 72, |_| true).unwrap();
        let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
        let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
        let covariates = Covariates::new(&comparison);
        let model =
            FreeModel::new(&comparison, &NOMINAL.effects, &fitted, &covariates, &pit_draw(1), Part::Whole);
        check(&model, &covariates);
    }

    /// The fixture's drive with a change of each return \[m\], of its scan and a normal number of its own.
    fn changed(change: impl Fn(usize, f64) -> f64) -> Drive {
        let mut drive = record_library(&NOMINAL, &TRUTH, &[], Regime::default(), 7).unwrap();
        let max = drive.laser.max_range();
        for (scan, step) in drive.steps.iter_mut().enumerate() {
            let draw = Draw::new(5, locsim_core::Stage::Bootstrap, scan as u32);
            for (beam, range) in step.scan.ranges.iter_mut().enumerate().filter(|(_, r)| **r < max) {
                let normal = StandardNormal.sample(&mut draw.item(beam as u32));
                *range = (*range + change(scan, normal) as f32).min(max);
            }
        }
        drive
    }

    fn with(kind: EffectKind, values: &[f64]) -> Drive {
        let effect = Effect::new(kind, values.to_vec(), Vec::new()).unwrap();
        record_library(&NOMINAL, &TRUTH, &[effect], Regime::default(), fixtures::SEED).unwrap()
    }

    #[test]
    fn nothing_is_learnt_where_the_simulator_is_right() {
        learnt(&record_library(&NOMINAL, &TRUTH, &[], Regime::default(), 7).unwrap(), |model, _| {
            assert!(model.gains().iter().sum::<f64>() < 10.0, "{:?}", model.components);
        });
    }

    /// Biases that grow with range up to a limit. The reference turns by more than the noise at the far walls: beside the bias none of its errors can
    /// be fitted, and the readings seem to spread.
    #[test]
    fn a_bias_beside_a_reference_that_errs_is_no_spread() {
        for (sigma_rad, growth, most) in [(0.01, 0.02, 0.06), (0.03, 0.04, 0.1)] {
            let pose_error =
                Some(PoseError { sigma_m: 0.01, sigma_rad, correlation_secs: 2.0, ..PoseError::NONE });
            let regime = Regime { pose_error, ..Regime::default() };
            let mut drive = record_library(&NOMINAL, &TRUTH, &[], regime, 7).unwrap();
            for step in &mut drive.steps {
                for range in step.scan.ranges.iter_mut().filter(|range| **range < fixtures::MAX_M as f32) {
                    *range += (growth * *range).min(most);
                }
            }
            learnt(&drive, |model, _| {
                let first = &model.components[0];
                assert_eq!((first.moment, first.covariate), (Deviation::Mean, Covariate::Range));
            });
        }
    }

    /// One reading in 30 of six neighbouring beams is 30 cm from the laser, where no clutter stands: far fewer than clutter makes, and told first, and by bearing.
    #[test]
    fn few_readings_in_the_open_stand_out() {
        let mut drive = record_library(&NOMINAL, &TRUTH, &[], Regime::default(), 7).unwrap();
        for (scan, step) in drive.steps.iter_mut().enumerate() {
            for beam in (20..26).filter(|beam| (scan + 5 * beam) % 30 == 0) {
                step.scan.ranges[beam] = 0.3;
            }
        }
        learnt(&drive, |model, _| {
            let of = |c: &Component| (c.moment, c.covariate);
            let all: Vec<_> = model.components.iter().map(of).collect();
            assert_eq!(all[0].0, Deviation::Short, "{all:?}");
            assert!(all.contains(&(Deviation::Short, Covariate::Bearing)), "{all:?}");
        });
    }

    /// The hypothesis loses nearly all far returns, the log loses none: the share of readings that isn't lost is no more than all.
    #[test]
    fn a_share_falls_by_no_more_than_all() {
        let drive = record_library(&NOMINAL, &TRUTH, &[], Regime::default(), 7).unwrap();
        let recorded = Recorded::new(&drive, 400, 72, |_| true).unwrap();
        let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
        let lost = Effect::new(EffectKind::RangeDropout, vec![1.0, 0.3], Vec::new()).unwrap();
        let effects = NOMINAL.effects_with(&[lost]).unwrap();
        let fitted = comparison.start(&Nuisances::default());
        let covariates = Covariates::new(&comparison);
        let model = FreeModel::new(&comparison, &effects, &fitted, &covariates, &pit_draw(1), Part::Whole);
        let lost = |c: &&Component| c.moment == Deviation::NoReturn;
        let values: Vec<f64> = model
            .components
            .iter()
            .filter(lost)
            .flat_map(|c| &c.curve)
            .flatten()
            .map(|[value, _]| *value)
            .collect();
        let least = values.iter().copied().fold(0.0, f64::min);
        assert!((-1.0..-0.5).contains(&least), "{least} {values:?}");
    }

    /// A bias of 1 cm that comes around twice.
    #[test]
    fn a_bias_over_bearing_is_learnt_as_it_is() {
        let mut drive = record_library(&NOMINAL, &TRUTH, &[], Regime::default(), 3).unwrap();
        let (max, bearings) = (drive.laser.max_range(), drive.laser.bearings().to_vec());
        for step in &mut drive.steps {
            for (range, bearing) in step.scan.ranges.iter_mut().zip(&bearings).filter(|(r, _)| **r < max) {
                *range = (*range + 0.01 * (2.0 * bearing).sin()).min(max);
            }
        }
        learnt(&drive, |model, covariates| {
            let first = &model.components[0];
            assert_eq!((first.moment, first.covariate), (Deviation::Mean, Covariate::Bearing));
            let levels = &covariates.axes[first.axis].levels;
            let errors = levels
                .iter()
                .zip(&first.curve)
                .map(|(bearing, point)| (point.unwrap()[0] - 0.01 * (2.0 * bearing).sin()).abs());
            let mean = errors.sum::<f64>() / levels.len() as f64;
            assert!(mean < 0.002, "{mean} {:?}", first.curve);
            let share = first.gain() / model.gains().iter().sum::<f64>();
            assert!(share > 0.9, "{:?}", model.components);
        });
    }

    #[test]
    fn biases_are_told_by_what_they_depend_on() {
        let cases = [
            (EffectKind::RangeBias, vec![0.005], Deviation::Mean, Covariate::Everywhere),
            (EffectKind::RangeScale, vec![0.02], Deviation::Mean, Covariate::Range),
        ];
        for (kind, values, moment, covariate) in cases {
            learnt(&with(kind, &values), |model, _| {
                let first = &model.components[0];
                assert_eq!((first.moment, first.covariate), (moment, covariate), "{kind}");
            });
        }
    }

    #[test]
    fn a_spread_is_told_as_a_spread() {
        for growth in [0.002, 0.01] {
            learnt(&with(EffectKind::RangeNoise, &[growth]), |model, _| {
                let first = &model.components[0];
                assert_eq!(
                    (first.moment, first.covariate),
                    (Deviation::Spread, Covariate::Range),
                    "{growth}"
                );
            });
        }
    }

    /// Twelve millimetres of noise where the simulator has ten, and three times the noise.
    #[test]
    fn noise_of_every_beam_depends_on_nothing() {
        for factor in [1.2_f64, 3.0] {
            let sigma = NOMINAL.laser.sigma_m * (factor * factor - 1.0).sqrt();
            learnt(&changed(|_, normal| sigma * normal), |model, _| {
                let first = &model.components[0];
                assert_eq!((first.moment, first.covariate), (Deviation::Spread, Covariate::Everywhere));
                let [value, _] = first.curve[0].unwrap();
                assert!((value - (factor - 1.0)).abs() < 0.05 * factor, "{value} for {factor}");
            });
        }
    }

    /// Two scans in seven have three times the noise, at no time, place or speed of its own.
    #[test]
    fn scans_that_are_noisier_than_others_are_told_as_that() {
        let sigma = NOMINAL.laser.sigma_m * 8.0_f64.sqrt();
        let drive = changed(|scan, normal| if scan * scan % 7 == 2 { sigma * normal } else { 0.0 });
        learnt(&drive, |model, _| {
            let first = &model.components[0];
            assert_eq!((first.moment, first.covariate), (Deviation::Spread, Covariate::Scan));
            // Of the noisiest scans; the last level is of those of few readings.
            let [.., Some([value, _]), None] = first.curve[..] else { panic!("{:?}", first.curve) };
            assert!((value - 2.0).abs() < 0.4, "{value}");
        });
    }

    /// Three scans in seven lose a quarter of their returns, at no time, place or speed of their own.
    #[test]
    fn scans_that_lose_more_returns_than_others_are_told_as_that() {
        let is_lost = |scan: usize, normal: f64| scan * scan % 7 < 2 && normal < -0.6745;
        let drive = changed(|scan, normal| if is_lost(scan, normal) { f64::INFINITY } else { 0.0 });
        learnt(&drive, |model, covariates| {
            let most = model.components.iter().max_by(|a, b| a.gain().total_cmp(&b.gain())).unwrap();
            assert_eq!((most.moment, most.covariate), (Deviation::NoReturn, Covariate::Losses));
            let of_many = covariates.axes[most.axis].levels.iter().zip(&most.curve);
            let of_many = of_many.filter(|(share, _)| (0.2..0.35).contains(*share));
            assert!(of_many.clone().count() > 0);
            for (share, value) in of_many {
                // A curve of every beam's may have a part of it.
                assert!((0.15..0.3).contains(&value.unwrap()[0]), "{share}: {value:?}");
            }
        });
    }

    /// The robot of the fixture drives back in reverse.
    #[test]
    fn the_speed_of_a_robot_in_reverse_is_below_zero() {
        let drive = record_library(&NOMINAL, &TRUTH, &[], Regime::default(), 7).unwrap();
        let recorded = Recorded::new(&drive, 400, 72, |_| true).unwrap();
        let axes = Covariates::new(&Comparison::new(&NOMINAL, &recorded).unwrap()).axes;
        let speeds = axes.into_iter().find(|axis| axis.covariate == Covariate::Speed).unwrap();
        let velocities = recorded.velocities();
        let of_scans = velocities.iter().enumerate().filter(|(_, v)| v[0].abs() > 0.3);
        for (scan, velocity) in of_scans {
            let level = usize::from(speeds.of_beams[scan * 72]);
            assert_eq!(speeds.levels[level] < 0.0, velocity[0] < 0.0, "{velocity:?} {:?}", speeds.levels);
        }
    }

    /// A bias of 15 mm beside a noise of 10 that comes around three times in the drive, and a noise that grows from once to 2.5 times. Each
    /// stretch of time is held out once, and is between those before and after it.
    #[test]
    fn what_changes_with_time_is_learnt_as_it_is() {
        let last = 399.0;
        let swing = |at: f64| 0.015 * (3.0 * std::f64::consts::TAU * at).sin();
        for is_bias in [true, false] {
            let drive = changed(|scan, normal| {
                let at = scan as f64 / last;
                let more = NOMINAL.laser.sigma_m * ((1.0 + 1.5 * at).powi(2) - 1.0).sqrt();
                if is_bias { swing(at) } else { more * normal }
            });
            learnt(&drive, |model, covariates| {
                let first = &model.components[0];
                let moment = if is_bias { Deviation::Mean } else { Deviation::Spread };
                assert_eq!((first.moment, first.covariate), (moment, Covariate::Time));
                let levels = &covariates.axes[first.axis].levels;
                let errors = levels.iter().zip(&first.curve).map(|(secs, point)| {
                    // Ten scans a second.
                    let at = 10.0 * secs / last;
                    let expected = if is_bias { swing(at) / 0.015 } else { 1.5 * at };
                    let scale = if is_bias { 0.015 } else { 1.0 };
                    (point.unwrap()[0] / scale - expected).powi(2)
                });
                let error = (errors.sum::<f64>() / levels.len() as f64).sqrt();
                assert!(error < 0.2, "{error} {:?}", first.curve);
                let is_noise = |c: &&Component| c.moment == Deviation::Spread && is_bias;
                assert!(model.components.iter().filter(is_noise).all(|c| c.gain() < 0.02 * first.gain()));
            });
        }
    }

    /// The weights of an effect over incidence are explained by incidence; those of a bias by nothing but every beam.
    #[test]
    fn a_covariate_explains_what_depends_on_it() {
        let drive = record_library(&NOMINAL, &TRUTH, &[], Regime::default(), 7).unwrap();
        let recorded = Recorded::new(&drive, 60, 72, |_| true).unwrap();
        let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
        let covariates = Covariates::new(&comparison);
        let beams = &comparison.views.beams;
        let explained =
            |covariate| covariates.explained(covariate, beams.iter().map(|beam| beam.view.incidence.sin()));
        assert!(explained(Covariate::Incidence) > 0.98);
        assert!(explained(Covariate::Bearing) < 0.8 && explained(Covariate::Everywhere) == 0.0);
        let constant = |covariate| covariates.explained(covariate, beams.iter().map(|_| 0.3));
        assert!(constant(Covariate::Everywhere) == 1.0 && constant(Covariate::Range) == 0.0);
    }
}
