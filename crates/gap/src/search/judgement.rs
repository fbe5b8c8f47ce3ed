//! A hypothesis judged by a free model: the dependence by which it gains, and the effects that act on it.

use glam::DVec2;
use locsim_core::{differences, gains_beyond, gains_surely, is_of_wall};
use locsim_world::effect::{Effect, EffectKind, Score, Statistic};

use crate::fit::Candidate;
use crate::free_model::{Component, Covariates, FreeModel, Misalignment};
use crate::statistics::{Covariate, Deviation, Survey};

/// Standard errors by which a noise is beyond what neighbours leave.
const LEAST_ERRORS: f64 = 2.0;
/// Neighbours that err alike no more than this beyond simulated ones have nothing in common.
const LEAST_CORRELATION: f64 = 0.02;
/// Neighbours that err alike so much more than simulated ones have most of their error in common.
const ALIKE: f64 = 0.3;
/// A dependence that gains less than this share of the one that gains most is left out: it is what that one's curve leaves.
const LEAST_SHARE: f64 = 0.05;
/// The share of the variance of an effect's weights that a covariate explains, where the effect acts on it.
const OWN_COVARIATE: f64 = 0.9;

/// A dependence, with the gain of knowing it.
pub struct Dependence<'j> {
    pub deviation: Deviation,
    pub covariate: Covariate,
    /// Gain on held-out folds beyond that on simulated logs (nats).
    pub gains: Vec<f64>,
    /// Its curve, of the readings.
    pub component: Option<&'j Component>,
    /// The same of odometry or reference.
    pub misalignment: Option<&'j Misalignment>,
}

impl Dependence<'_> {
    pub fn gain(&self) -> f64 {
        self.gains.iter().sum()
    }

    /// Whether it is over places, and most of it at the wall of an effect.
    fn is_at(&self, effect: &Effect, covariates: &Covariates) -> bool {
        let Some(component) = self.component.filter(|_| self.covariate == Covariate::Place) else {
            return false;
        };
        let cells = covariates.axes[component.axis].cells.iter().zip(&component.curve).skip(1);
        let mut sums = [0.0; 2];
        // A value at a limit has no error.
        let known = cells.filter_map(|(cell, point)| Some((cell, point.filter(|[_, error]| *error > 0.0)?)));
        for (&[x, y, side], [value, error]) in known {
            let middle = DVec2::new(x + 0.5 * side, y + 0.5 * side);
            // Half a diagonal: the wall runs through the cell.
            let reach = side * std::f64::consts::FRAC_1_SQRT_2;
            let is_at_wall = effect.place.iter().any(|stretch| is_of_wall(stretch, middle, reach));
            // Twice what the cell gains, beyond chance.
            sums[usize::from(is_at_wall)] += (value / error).powi(2) - 1.0;
        }
        sums[1] > sums[0]
    }

    /// Whether it is the noise that is left of every beam once the error of its neighbour is known: of numbers with this correlation
    /// the rest is narrower.
    fn is_left_by_neighbours(&self, correlation: f64) -> bool {
        let Some(&Component {
            moment: Deviation::Spread, covariate: Covariate::Everywhere, ref curve, ..
        }) = self.component
        else {
            return false;
        };
        let narrowest = (1.0 - correlation * correlation).max(0.0).sqrt() - 1.0;
        matches!(curve[..], [Some([change, error])] if (narrowest - LEAST_ERRORS * error..0.0).contains(&change))
    }

    /// Whether it surely gains more than an effect.
    pub fn beats(&self, candidate: &Candidate) -> bool {
        gains_surely(&differences(&self.gains, &candidate.fitted_gains))
    }

    /// Whether an effect surely gains more.
    pub fn is_beaten_by(&self, candidate: &Candidate) -> bool {
        gains_surely(&differences(&candidate.fitted_gains, &self.gains))
    }
}

/// The free model of a log on top of a round's hypothesis, and those of logs that are simulated by it.
pub struct Judgement {
    pub model: FreeModel,
    pub covariates: Covariates,
    pub misalignments: Vec<Misalignment>,
    /// Of logs that are simulated by the hypothesis.
    pub simulated: Vec<(FreeModel, Vec<Misalignment>)>,
}

impl Judgement {
    /// The held-out gain of the free model of the readings beyond the most that it gains on a simulated log (nats): with
    /// four of them, a log without anything left gains something in one of five.
    pub fn gains(&self) -> Vec<f64> {
        let total = |model: &FreeModel| model.gains().iter().sum::<f64>();
        let floor = self.simulated.iter().map(|(model, _)| total(model)).fold(0.0, f64::max);
        gains_beyond(&self.model.gains(), floor)
    }

    /// Correlation of neighbouring beams beyond that of simulated logs.
    pub fn neighbour_correlation(&self) -> f64 {
        let simulated = self.simulated.iter().map(|(model, _)| model.neighbour_correlation).sum::<f64>();
        self.model.neighbour_correlation - simulated / self.simulated.len() as f64
    }

    /// Whether neighbouring beams surely err alike, and much so: what they share is no noise, which each beam has for itself.
    pub fn neighbours_err_alike(&self) -> bool {
        self.neighbour_correlation() > ALIKE
            && self.dependences().iter().any(|found| found.covariate == Covariate::Neighbour)
    }

    /// The dependences that surely gain more than those of the same moment on any simulated log, the one that gains most first.
    pub fn dependences(&self) -> Vec<Dependence<'_>> {
        let of_readings = self.model.components.iter().map(|component| {
            let Component { moment, covariate, ref gains, .. } = *component;
            let floors = self.simulated.iter().map(|(model, _)| model.gain_of(moment, covariate));
            let most = floors.fold(0.0, f64::max) * chance_of_places(moment, covariate);
            (moment, covariate, gains, most, Some(component), None)
        });
        let others = self.misalignments.iter().map(|misalignment| {
            let simulated = self.simulated.iter().flat_map(|(_, misalignments)| misalignments);
            let floors =
                simulated.filter(|other| other.deviation == misalignment.deviation).map(Misalignment::gain);
            let Misalignment { deviation, covariate, ref gains, .. } = *misalignment;
            (deviation, covariate, gains, floors.fold(0.0, f64::max), None, Some(misalignment))
        });
        let mut all: Vec<Dependence<'_>> = of_readings
            .chain(others)
            .map(|(deviation, covariate, gains, floor, component, misalignment)| Dependence {
                deviation,
                covariate,
                gains: gains_beyond(gains, floor),
                component,
                misalignment,
            })
            .filter(|found| gains_surely(&found.gains))
            .collect();
        let correlation = self.neighbour_correlation();
        all.retain(|found| found.covariate != Covariate::Neighbour || correlation > LEAST_CORRELATION);
        if all.iter().any(|found| found.covariate == Covariate::Neighbour) {
            all.retain(|found| !found.is_left_by_neighbours(correlation));
        }
        all.sort_by(|a, b| b.gain().total_cmp(&a.gain()));
        // Readings in front are of two classes, and are told once.
        let mut told = Vec::new();
        all.retain(|found| {
            let of = (found.deviation, found.covariate);
            let is_new = !told.contains(&of);
            told.push(of);
            is_new
        });
        let least = all.first().map_or(0.0, |first| LEAST_SHARE * first.gain());
        all.retain(|found| found.gain() >= least);
        all
    }
}

/// The factor on the most that a dependence gains on four simulated logs, up to which it is chance. Clutter that stands makes readings in
/// front depend on place in every log, as it happens to stand: logs of one kind differ by a half.
fn chance_of_places(moment: Deviation, covariate: Covariate) -> f64 {
    if (moment, covariate) == (Deviation::Short, Covariate::Place) { 2.0 } else { 1.0 }
}

/// Whether an effect acts on what a dependence is of: on its moment, over its covariate.
pub fn acts_on(
    effect: &Effect,
    dependence: &Dependence<'_>,
    covariates: &Covariates,
    survey: &Survey<'_>,
) -> bool {
    use Covariate as C;
    use Deviation as D;
    let Dependence { deviation, covariate, .. } = *dependence;
    effect.kind.description().statistics.iter().any(|statistic| match statistic {
        Statistic::Score { score, weight, .. } => {
            moments(*score).contains(&deviation) && {
                let weight = |beam: usize| weight(&survey.beam_state(beam), &effect.values);
                covariates.explained(covariate, (0..survey.beams()).map(weight)) >= OWN_COVARIATE
            }
        }
        Statistic::WallShift => {
            // Beams that meet it at several incidences err by several lengths.
            matches!(deviation, D::Mean | D::Spread | D::Short | D::Long)
                && dependence.is_at(effect, covariates)
        }
        Statistic::WallLoss => {
            matches!(deviation, D::NoReturn | D::Long) && dependence.is_at(effect, covariates)
        }
        Statistic::Edge => covariate == C::Jump && deviation != D::NoReturn,
        Statistic::Sector => covariate == C::Bearing && deviation == D::Short,
        _ => false,
    })
}

/// The moments of a reading that a score is of.
fn moments(score: Score) -> &'static [Deviation] {
    use Deviation as D;
    match score {
        Score::Location => &[D::Mean],
        Score::Scale => &[D::Spread],
        Score::NoReturn => &[D::NoReturn],
        Score::Uniform => &[D::Short, D::Long],
        Score::Tail => &[D::Spread, D::Short, D::Long],
    }
}

/// Whether two effects change the same moment of readings other than the mean. What a strong one leaves, where its form isn't quite
/// right, is of the same moment: losses beside losses, noise beside noise. Biases add up, and are told apart by their covariates.
pub fn share_a_moment(a: EffectKind, b: EffectKind) -> bool {
    let of = |kind: EffectKind| {
        let statistics = kind.description().statistics.iter();
        statistics.flat_map(|statistic| match statistic {
            Statistic::Score { score, .. } => moments(*score),
            Statistic::Edge => &[Deviation::Short, Deviation::Long],
            Statistic::Sector => &[Deviation::Short],
            _ => &[],
        })
    };
    of(a).any(|moment| *moment != Deviation::Mean && of(b).any(|other| other == moment))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::free_model::Axis;

    #[test]
    fn losses_share_a_moment_with_losses_and_noise_with_noise() {
        use EffectKind as E;
        assert!(share_a_moment(E::IncidenceDropout, E::RangeDropout));
        assert!(share_a_moment(E::HeavyTail, E::RangeNoise) && share_a_moment(E::MixedPixels, E::HeavyTail));
        assert!(!share_a_moment(E::IncidenceDropout, E::HeavyTail));
        assert!(!share_a_moment(E::RangeBias, E::RangeScale) && !share_a_moment(E::MountYaw, E::RangeBias));
    }

    /// A wall of 6 m at x = 0 through cells of a metre, whose middles are half a metre off: what is off there is at the wall, what is off in
    /// the whole hall isn't.
    #[test]
    fn a_loss_all_over_the_hall_is_at_no_wall() {
        let place = vec![[DVec2::new(0.0, 0.0), DVec2::new(0.0, 6.0)]];
        let pane = Effect::new(EffectKind::Glass, vec![0.5, 0.0], place).unwrap();
        let of_wall = (0..6).map(|y| [0.0, f64::from(y), 1.0]);
        let others = (0..20).map(|i| [4.0 + f64::from(i), 9.0, 1.0]);
        let cells: Vec<[f64; 3]> = std::iter::once([0.0; 3]).chain(of_wall).chain(others).collect();
        let is_at = |elsewhere: f64| {
            let levels = (0..cells.len()).map(|i| i as f64).collect();
            let mut axis = Axis::of_levels(Covariate::Place, levels);
            axis.cells.clone_from(&cells);
            let curve = (0..cells.len()).map(|i| Some([if i < 7 { 0.2 } else { elsewhere }, 0.02])).collect();
            let (moment, covariate) = (Deviation::NoReturn, Covariate::Place);
            let component = Component { moment, covariate, axis: 0, curve, gains: vec![10.0; 4] };
            let (deviation, gains) = (moment, component.gains.clone());
            Dependence { deviation, covariate, gains, component: Some(&component), misalignment: None }
                .is_at(&pane, &Covariates { axes: vec![axis] })
        };
        assert!(is_at(0.02) && !is_at(0.15));
    }

    /// Neighbours that err alike with a correlation of 0.6 leave 0.8 of the noise.
    #[test]
    fn noise_that_neighbours_explain_is_no_dependence_of_its_own() {
        let left = |covariate, change: f64| {
            let component = Component {
                moment: Deviation::Spread,
                covariate,
                axis: 0,
                curve: vec![Some([change, 0.01])],
                gains: vec![10.0; 4],
            };
            let deviation = Deviation::Spread;
            let gains = component.gains.clone();
            Dependence { deviation, covariate, gains, component: Some(&component), misalignment: None }
                .is_left_by_neighbours(0.6)
        };
        assert!(left(Covariate::Everywhere, -0.19) && left(Covariate::Everywhere, -0.21));
        assert!(!left(Covariate::Everywhere, -0.3) && !left(Covariate::Everywhere, 0.2));
        assert!(!left(Covariate::Range, -0.19));
    }
}
