//! Curves that are added one by one, the one that gains most on held-out folds first.

use distreg::curve::{LARGEST_TILT, Shape, Sums, crossfit, curves_without, fit};
use distreg::others::{mean_of_others, variances_of_others};
use locsim_core::tilt::{Class, Looks, Outcome, Tilt};
use locsim_core::{Folds, differences, simplest};
use rayon::prelude::*;

use super::covariates::{Axis, Covariates, LOSSES_OF_SCANS, NOISE_OF_SCANS};
use super::large::Large;
use super::outcomes::{self, MOMENTS, Outcomes};
use super::{Component, FreeModel, MEAN, SPREAD};
use crate::statistics::{Covariate, Deviation};

/// The most curves that are added. A log of several strong effects takes a dozen.
const MOST_STEPS: usize = 40;
/// A curve has to gain this on held-out folds (nats): as an effect that is named.
const LEAST_GAIN_NATS: f64 = 2.0;
/// A level says nothing of a kind of reading that fewer than this share of its readings could become. Beams that meet nothing within
/// reach have no return to lose.
const LEAST_SHARE: f64 = 0.2;
/// How often a step of a curve is halved at most, for as long as a half gains more: the promise of a step is a parabola, and a log
/// score isn't one.
const HALVINGS: u32 = 4;
/// Curves are as smooth as one of these says that gains most on held-out folds: information at which a step between two
/// neighbouring levels of one standard deviation of the noise is one standard deviation of the prior.
const STIFFNESSES: [f64; 3] = [1.0, 30.0, 1000.0];

impl FreeModel {
    /// Adds curves for as long as they gain.
    pub(super) fn of(
        outcomes: &Outcomes,
        covariates: &Covariates,
        folds: Folds,
        large: Option<Large>,
    ) -> Self {
        let mut state = State::new(outcomes, covariates, folds);
        let mut components: Vec<Draft> = Vec::new();
        if let Some(Large { moment, axis, levels, errors, gains, .. }) = large {
            let tilts = vec![0.0; levels.len()];
            // A tilt of the mean is in standard deviations, too, and one of the spread the logarithm of a factor, where it is small.
            components.push(Draft { moment, axis, large: levels, tilts, errors, gains });
        }
        let mut score = state.looks.score(&state.fold_of, folds.count());
        let mut correlation = None;
        for _ in 0..MOST_STEPS {
            let Some(step) = state.best_step() else { break };
            if covariates.axes[step.axis].covariate == Covariate::Neighbour {
                // The correlation of neighbours is its own covariate.
                correlation.get_or_insert_with(|| state.looks.neighbour_correlation(&outcomes.all));
            }
            let before = (state.tilts.clone(), state.looks.clone());
            let (share, after) = state.apply(&step);
            let gains = differences(&after, &score);
            if gains.iter().sum::<f64>() < LEAST_GAIN_NATS {
                // The quadratic approximation promised more than there is.
                ((state.tilts, state.looks), state.moved) = (before, [false; 2]);
                state.spent[step.axis][step.moment] = true;
                continue;
            }
            score = after;
            let Step { axis, moment, levels, curve, errors, .. } = step;
            // What is left of a large bias would be taken for a spread.
            let is_cut = moment == MEAN && curve.iter().any(|tilt| tilt.abs() >= LARGEST_TILT);
            state.on = is_cut.then_some((axis, moment));
            let curve: Vec<f64> = curve.into_iter().map(|tilt| share * tilt).collect();
            let whole = state.whole.iter_mut().zip(levels);
            whole.for_each(|(tilt, level)| tilt.0[moment] += curve[level as usize]);
            if let Some(known) = components.iter_mut().find(|c| c.axis == axis && c.moment == moment) {
                known.tilts.iter_mut().zip(curve).for_each(|(sum, more)| *sum += more);
                known.gains.iter_mut().zip(gains).for_each(|(sum, more)| *sum += more);
                known.errors = errors;
            } else {
                let large = vec![0.0; curve.len()];
                components.push(Draft { moment, axis, large, tilts: curve, errors, gains });
            }
        }
        let neighbour_correlation =
            correlation.unwrap_or_else(|| state.looks.neighbour_correlation(&outcomes.all));
        let components = components.into_iter().map(|draft| state.finish(draft)).collect();
        Self { components, neighbour_correlation, folds }
    }
}

/// A model as far as it was built: each reading by the curves that were fitted without its fold.
struct State<'a> {
    outcomes: &'a Outcomes,
    covariates: &'a Covariates,
    folds: Folds,
    fold_of: Vec<usize>,
    tilts: Vec<Tilt>,
    looks: Looks,
    /// The same by curves that were fitted to all folds, which are those that are told.
    whole: Vec<Tilt>,
    /// Curves that gain nothing, by axis and moment.
    spent: Vec<[bool; MOMENTS.len()]>,
    axes: Vec<OfAxis>,
    /// Curves that may be added.
    tried: Vec<Tried>,
    /// Axis and moment of a curve that went as far as a step goes, and goes on first.
    on: Option<(usize, usize)>,
    /// Whether tilts have moved since, of the surface's moments and of shares: what readings say of the ones doesn't depend on the others.
    moved: [bool; 2],
}

/// A curve that is being built: tilts of a moment at the levels of an axis.
struct Draft {
    moment: usize,
    axis: usize,
    /// A change at each level beside the tilts; see [`Large::levels`].
    large: Vec<f64>,
    tilts: Vec<f64>,
    errors: Vec<f64>,
    gains: Vec<f64>,
}

/// The level of each reading on an axis, and what readings say of each moment that is asked there, by fold and level.
#[derive(Clone, Default)]
struct OfAxis {
    levels: Vec<u16>,
    sums: [Vec<Vec<Sums>>; MOMENTS.len()],
}

impl OfAxis {
    /// Takes in the tilts that have moved.
    fn follow(&mut self, state: &State<'_>, axis: usize) {
        let Axis { covariate, levels, .. } = &state.covariates.axes[axis];
        let is_of_errors = matches!(covariate, Covariate::Neighbour | Covariate::Scan);
        if self.levels.is_empty() || (is_of_errors && state.moved[0]) {
            self.levels = state.levels(axis);
        }
        for moment in (0..MOMENTS.len()).filter(|&moment| state.is_new(axis, moment)) {
            let mut sums = vec![vec![Sums::default(); levels.len()]; state.folds.count()];
            for ((pull, &level), &fold) in state.looks.pulls(moment).zip(&self.levels).zip(&state.fold_of) {
                sums[fold][level as usize].add(pull);
            }
            self.sums[moment] = sums;
        }
    }
}

/// The moments that depend on each other: 0 for those of the surface's readings, 1 for shares.
fn block_of(moment: usize) -> usize {
    usize::from(outcomes::is_share(MOMENTS[moment]))
}

/// A curve that may be added.
struct Tried {
    axis: usize,
    moment: usize,
    shape: Shape,
    /// Held-out gain on each fold, as far as the log score is a parabola (nats).
    gains: Vec<f64>,
}

impl Tried {
    fn gain(&self) -> f64 {
        self.gains.iter().sum()
    }
}

/// A curve to be added.
struct Step {
    axis: usize,
    moment: usize,
    /// Fitted without each fold.
    without: Vec<Vec<f64>>,
    /// Level of each reading.
    levels: Vec<u16>,
    curve: Vec<f64>,
    errors: Vec<f64>,
}

impl<'a> State<'a> {
    fn new(outcomes: &'a Outcomes, covariates: &'a Covariates, folds: Folds) -> Self {
        let plain = vec![Tilt::default(); outcomes.all.len()];
        Self {
            outcomes,
            covariates,
            folds,
            fold_of: outcomes.all.iter().map(|outcome| folds.of_scan(outcome.scan as usize)).collect(),
            looks: Looks::new(&outcomes.all, &plain),
            whole: plain.clone(),
            tilts: plain,
            axes: vec![OfAxis::default(); covariates.axes.len()],
            spent: vec![[false; MOMENTS.len()]; covariates.axes.len()],
            tried: Vec::new(),
            on: None,
            moved: [true; 2],
        }
    }

    /// Whether a curve is asked for, and may differ from what it was.
    fn is_new(&self, axis: usize, moment: usize) -> bool {
        // The beams of a scan are behind the same clutter; what is asked for is whether readings of the surface err alike.
        let is_asked = match self.covariates.axes[axis].covariate {
            Covariate::Neighbour => moment == MEAN,
            Covariate::Scan => moment == SPREAD,
            Covariate::Losses => MOMENTS[moment] == Deviation::NoReturn,
            _ => true,
        };
        self.moved[block_of(moment)] && !self.spent[axis][moment] && is_asked
    }

    /// The curve that gains most on held-out folds, over the simplest covariate that gains as much.
    fn best_step(&mut self) -> Option<Step> {
        let mut axes = std::mem::take(&mut self.axes);
        axes.par_iter_mut().enumerate().for_each(|(axis, of_axis)| of_axis.follow(self, axis));
        self.axes = axes;
        let of_axes = self.axes.par_iter().enumerate();
        let moved: Vec<Tried> =
            of_axes.flat_map_iter(|(axis, of_axis)| self.try_curves(axis, of_axis)).collect();
        self.tried
            .retain(|tried| !self.moved[block_of(tried.moment)] && !self.spent[tried.axis][tried.moment]);
        self.tried.extend(moved);
        self.moved = [false; 2];
        let on = self.on.take();
        let is_on = |tried: &&Tried| on == Some((tried.axis, tried.moment)) && tried.gain() > LEAST_GAIN_NATS;
        let chosen = self.tried.iter().find(is_on).or_else(|| self.simplest_of_best())?;
        let &Tried { axis, moment, shape, .. } = chosen;
        let OfAxis { levels, sums } = &self.axes[axis];
        let without = curves_without(&sums[moment], shape);
        let mut whole = vec![Sums::default(); sums[moment][0].len()];
        let readings = self.outcomes.all.par_iter().zip(&self.whole);
        let pulls: Vec<_> = readings.map(|(outcome, tilt)| outcome.pull(tilt, moment)).collect();
        for (pull, &level) in pulls.into_iter().zip(levels) {
            whole[level as usize].add(pull);
        }
        let (curve, errors) = fit(&[whole], shape);
        Some(Step { axis, moment, without, levels: levels.clone(), curve, errors })
    }

    /// The simplest of the curves that can't be told from the one that gains most.
    fn simplest_of_best(&self) -> Option<&Tried> {
        let tried = &self.tried;
        let is_of_scans = |tried: &&Tried| {
            matches!(self.covariates.axes[tried.axis].covariate, Covariate::Scan | Covariate::Losses)
        };
        let most = |a: &&Tried, b: &&Tried| a.gain().total_cmp(&b.gain());
        let of_moment = |found: &&Tried| -> f64 {
            let others = tried.iter().filter(|other| other.moment == found.moment && !is_of_scans(other));
            others.map(Tried::gain).fold(0.0, f64::max)
        };
        // A scan's other beams tell noise and losses of any cause, a little less well than the cause.
        let beyond = |found: &&Tried| {
            let factor = if found.moment == SPREAD { NOISE_OF_SCANS } else { LOSSES_OF_SCANS };
            found.gain() > factor * of_moment(found)
        };
        let of_scans = tried.iter().filter(is_of_scans).filter(beyond).max_by(most);
        let best = tried.iter().filter(|tried| !is_of_scans(tried)).max_by(most);
        if let Some(found) = of_scans.filter(|found| best.is_none_or(|best| found.gain() > best.gain())) {
            return (found.gain() > LEAST_GAIN_NATS).then_some(found);
        }
        let best = best?;
        let count = |tried: &Tried| self.covariates.axes[tried.axis].levels.len();
        let is_neighbour = |tried: &Tried| self.covariates.axes[tried.axis].covariate == Covariate::Neighbour;
        // Whether neighbours err alike is no simpler or finer form of what beams have in common.
        let alike: Vec<&Tried> = tried
            .iter()
            .filter(|tried| tried.moment == best.moment && is_neighbour(tried) == is_neighbour(best))
            .filter(|tried| !is_of_scans(tried))
            .collect();
        Some(alike[simplest(alike.iter().map(|tried| (count(tried), &tried.gains[..])))?])
    }

    /// The curves over an axis, one for each moment that has moved, each as smooth as gains most.
    fn try_curves(&self, axis: usize, of_axis: &OfAxis) -> Vec<Tried> {
        let covariate = &self.covariates.axes[axis];
        let moments = (0..MOMENTS.len()).filter(|&moment| self.is_new(axis, moment));
        let stiffnesses = if covariate.levels.len() == 1 { &STIFFNESSES[..1] } else { &STIFFNESSES };
        let tried = moments.filter_map(|moment| {
            let (sums, is_share) = (&of_axis.sums[moment], outcomes::is_share(MOMENTS[moment]));
            let tried = stiffnesses.iter().map(|&stiffness| {
                let shape = Shape { stiffness, is_ordered: covariate.is_ordered, is_share };
                Tried { axis, moment, shape, gains: crossfit(sums, shape) }
            });
            tried.max_by(|a, b| a.gain().total_cmp(&b.gain()))
        });
        tried.collect()
    }

    /// Adds a step, or the half or less of it that gains more. Gives that share and the score with it.
    fn apply(&mut self, step: &Step) -> (f64, Vec<f64>) {
        self.moved[block_of(step.moment)] = true;
        let before = self.tilts.clone();
        let total = |score: &[f64]| score.iter().sum::<f64>();
        let mut with = |share: f64| {
            for (i, (tilt, before)) in self.tilts.iter_mut().zip(&before).enumerate() {
                let more = step.without[self.fold_of[i]][step.levels[i] as usize];
                tilt.0[step.moment] = before.0[step.moment] + share * more;
            }
            let looks = self.looks.with(step.moment, &self.outcomes.all, &self.tilts);
            (looks.score(&self.fold_of, self.folds.count()), looks, self.tilts.clone())
        };
        let (mut share, mut best) = (1.0, with(1.0));
        for _ in 0..HALVINGS {
            let half = with(0.5 * share);
            if total(&half.0) <= total(&best.0) {
                break;
            }
            (share, best) = (0.5 * share, half);
        }
        let score;
        (score, self.looks, self.tilts) = best;
        (share, score)
    }

    /// Level of each reading on an axis.
    fn levels(&self, axis: usize) -> Vec<u16> {
        let axis = &self.covariates.axes[axis];
        let of = |value: Option<f64>| axis.level_of(value.unwrap_or(f64::NAN));
        match axis.covariate {
            Covariate::Neighbour => {
                return self.looks.errors_before(&self.outcomes.all).into_iter().map(of).collect();
            }
            Covariate::Scan => {
                let readings = self.outcomes.all.iter().zip(self.looks.errors(&self.outcomes.all));
                let errors = readings.map(|(outcome, error)| (outcome.scan as usize, error));
                return variances_of_others(errors).map(of).collect();
            }
            Covariate::Losses => {
                let is_lost = |outcome: &Outcome| f64::from(u8::from(outcome.class == Class::NoReturn));
                let excess = self.outcomes.all.iter().map(|outcome| {
                    let expected = outcome.probabilities[Class::NoReturn.index()];
                    (outcome.scan as usize, is_lost(outcome) - expected)
                });
                return mean_of_others(excess).map(of).collect();
            }
            _ => {}
        }
        self.outcomes.all.iter().map(|outcome| axis.of_beams[outcome.beam as usize]).collect()
    }

    /// A curve in units that people know: the mean over the readings of each level. A share that grows is of the readings that weren't of
    /// its kind before: the probability by which an effect makes them so. One that shrinks is of all readings.
    fn finish(&self, draft: Draft) -> Component {
        let Draft { moment, axis, large, tilts, errors, gains } = draft;
        let covariate = self.covariates.axes[axis].covariate;
        let mut sums = vec![[0.0; 5]; tilts.len()];
        let mut add = |outcome: &Outcome, level: usize| {
            let [at, up, down] =
                [0.0, 1.0, -1.0].map(|side| outcome.change(moment, tilts[level] + side * errors[level]));
            if let (Some(at), Some(up), Some(down)) = (at, up, down) {
                let both = |at: f64| match moment {
                    MEAN => large[level] * outcome.sigma + at,
                    SPREAD => large[level].exp() * (1.0 + at) - 1.0,
                    _ => at,
                };
                let more = [outcome.weight(moment), both(at), both(up), both(down), 1.0];
                sums[level].iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
            }
        };
        if covariate == Covariate::Scan {
            // With the curve scans are as noisy as others: each level is told of all readings.
            let levels = (0..tilts.len()).flat_map(|level| self.outcomes.all.iter().map(move |o| (o, level)));
            levels.for_each(|(outcome, level)| add(outcome, level));
        } else {
            let levels = self.levels(axis);
            self.outcomes.all.iter().zip(levels).for_each(|(outcome, level)| add(outcome, level.into()));
        }
        let mean = |[count, at, up, down, readings]: [f64; 5]| {
            let of = if at < 0.0 { readings } else { count };
            (count > LEAST_SHARE * readings).then(|| [at / of, 0.5 * (up - down).abs() / of])
        };
        let mut curve: Vec<_> = sums.into_iter().map(mean).collect();
        if self.covariates.axes[axis].is_of_readings()
            && let Some(nothing_is_said) = curve.last_mut()
        {
            *nothing_is_said = None;
        }
        Component { moment: MOMENTS[moment], covariate, axis, curve, gains }
    }
}

#[cfg(test)]
mod tests {
    use locsim_comparison::fixtures::{self, NOMINAL, TRUTH};
    use locsim_comparison::hidden::{Regime, record_library};
    use locsim_comparison::{Comparison, Nuisances};
    use locsim_world::effect::{Effect, EffectKind};

    use super::*;
    use crate::Recorded;
    use crate::statistics::pit_draw;

    /// A curve that was tried before a step of other moments is what it would be after it.
    #[test]
    fn a_curve_that_is_kept_is_what_a_new_look_gives() {
        let effect = Effect::new(EffectKind::IncidenceNoise, vec![1.5], Vec::new()).unwrap();
        let drive = record_library(&NOMINAL, &TRUTH, &[effect], Regime::default(), fixtures::SEED).unwrap();
        let recorded = Recorded::new(&drive, 120, 36, |_| true).unwrap();
        let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
        let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
        let covariates = Covariates::new(&comparison);
        let outcomes = Outcomes::new(&comparison, &NOMINAL.effects, &fitted, &pit_draw(1), None);
        let mut state = State::new(&outcomes, &covariates, recorded.folds);
        let mut blocks = [0; 2];
        while let Some(step) = state.best_step() {
            let mut anew = State::new(&outcomes, &covariates, recorded.folds);
            (anew.tilts, anew.spent) = (state.tilts.clone(), state.spent.clone());
            anew.looks = Looks::new(&outcomes.all, &anew.tilts);
            let other = anew.best_step().unwrap();
            assert_eq!((step.axis, step.moment, &step.curve), (other.axis, other.moment, &other.curve));
            let gains = |state: &State<'_>| {
                let mut all: Vec<_> =
                    state.tried.iter().map(|t| (t.axis, t.moment, t.gains.clone())).collect();
                all.sort_by_key(|(axis, moment, _)| (*axis, *moment));
                all
            };
            assert_eq!(gains(&state), gains(&anew));
            state.apply(&step);
            blocks[block_of(step.moment)] += 1;
            if blocks.iter().sum::<usize>() > 8 {
                // As a step that gains nothing: another curve comes next, of the other moments at last.
                (0..covariates.axes.len()).for_each(|axis| state.spent[axis][step.moment] = true);
            }
        }
        assert!(blocks.iter().all(|count| *count > 0), "{blocks:?}");
    }
}
