//! Curves without a name as a part of the simulator.

use locsim_comparison::{Comparison, Nuisances, Replay};
use locsim_world::effect::{BeamCovariate, Levels, Moment, Residual};
use rayon::prelude::*;

use super::unnamed::unnamed;
use super::{Round, State};
use crate::free_model::{Axis, Component, Covariates, FreeModel, Part};
use crate::outcome::{ResidualStage, Unnamed};
use crate::regions::{distance, distance_in_halves};
use crate::statistics::{Covariate, Deviation, Survey, pit_draw};
use crate::{GapError, Purpose, Recorded};

/// Simulated logs that the measured one's distance is taken to.
pub(super) const LOGS: usize = 8;

/// Passes in which curves are learnt, each beside the clutter and the errors of the reference that the curves before leave.
const PASSES: usize = 3;

/// What is off without a name.
pub struct Nameless {
    pub unnamed: Vec<Unnamed>,
    /// Its curves, as far as a simulator can carry them.
    pub curves: Vec<Residual>,
}

impl<'a> State<'a> {
    /// The dependences beyond a round's effects; none where nothing is off.
    pub fn nameless(&self, round: &Round<'a>) -> Result<Nameless, GapError> {
        if round.null.p > self.options.false_alarm {
            return Ok(Nameless { unnamed: Vec::new(), curves: Vec::new() });
        }
        let judgement = self.judge(round)?;
        let survey = Survey::new(&round.comparison);
        let unnamed = unnamed(judgement, &round.effects, &survey, round.null.p);
        let curves = self.curves(round, &unnamed, Part::Whole)?;
        Ok(Nameless { unnamed, curves })
    }

    /// The curves of the dependences that a simulator can carry, learnt from a part of the log. A bias looks like clutter and
    /// errors of the reference, which take a part of it: these are fitted again beside the curves, and what is left is learnt.
    fn curves(&self, round: &Round<'a>, unnamed: &[Unnamed], part: Part) -> Result<Vec<Residual>, GapError> {
        let own = pit_draw(self.options.seed);
        let judgement = self.judge(round)?;
        let covariates = &judgement.covariates;
        let mut curves: Vec<Residual> = Vec::new();
        for pass in 0..PASSES {
            let nominal = self.nominal.with_residuals(&curves)?;
            let comparison =
                Comparison { nominal: &nominal, ..round.comparison.of(&round.comparison.recorded) };
            let effects = comparison.effects(&round.effects)?;
            let fitted = if pass == 0 {
                round.fitted.clone()
            } else {
                comparison.fit_nuisances_with(&effects, &Nuisances::default(), 20)
            };
            let model = FreeModel::new(&comparison, &effects, &fitted, covariates, &own, part);
            let more = curves_of(&model, unnamed, covariates);
            if more.is_empty() {
                break;
            }
            for curve in more {
                let known = curves.iter_mut().find_map(|known| Some((known.and(&curve)?, known)));
                match known {
                    Some((both, known)) => *known = both,
                    None => curves.push(curve),
                }
            }
        }
        Ok(curves)
    }

    /// Curves as a part of the simulator, with what they do to its ranges; `None` without curves. `simulated` are logs of the
    /// round.
    pub fn residual_stage(
        &self,
        round: &Round<'a>,
        unnamed: &[Unnamed],
        curves: Vec<Residual>,
        simulated: &[Recorded],
    ) -> Result<Option<ResidualStage>, GapError> {
        if curves.is_empty() {
            return Ok(None);
        }
        let Round { comparison, .. } = round;
        let draw = Purpose::Distance.draw(self.options.seed);
        let halves = (0..2).map(|half| {
            // Of the other half.
            let nominal =
                self.nominal.with_residuals(&self.curves(round, unnamed, Part::Half(1 - half))?)?;
            let comparison = Comparison { nominal: &nominal, ..comparison.of(&comparison.recorded) };
            let effects = comparison.effects(&round.effects)?;
            let nuisances = comparison.find_nuisances(&effects, &Nuisances::default(), 20).nuisances;
            let replay = Replay { nominal: &nominal, nuisances, ..round.replay() };
            (0..LOGS as u32).into_par_iter().map(|i| Ok(replay.simulate(draw.seed(i))?)).collect()
        });
        let halves: Vec<Vec<Recorded>> = halves.collect::<Result<_, GapError>>()?;
        let views = &comparison.views;
        Ok(Some(ResidualStage {
            curves,
            w1_without_mm: distance(views, self.recorded, simulated),
            w1_mm: distance_in_halves(views, self.recorded, [&halves[0], &halves[1]]),
        }))
    }
}

/// The curves of a free model that are told and that a simulator can carry.
fn curves_of(model: &FreeModel, unnamed: &[Unnamed], covariates: &Covariates) -> Vec<Residual> {
    let is_told = |component: &&Component| {
        let Component { moment, covariate, .. } = **component;
        unnamed.iter().any(|found| found.deviation == moment && found.covariate == covariate)
    };
    model.components.iter().filter(is_told).filter_map(|component| curve(component, covariates)).collect()
}

/// A curve as a simulator carries it; `None` of a moment or over a covariate that it doesn't know.
fn curve(component: &Component, covariates: &Covariates) -> Option<Residual> {
    let moment = match component.moment {
        Deviation::Mean => Moment::Bias,
        Deviation::Spread => Moment::Spread,
        Deviation::NoReturn => Moment::NoReturn,
        Deviation::Short => Moment::Short,
        Deviation::Long => Moment::Long,
        _ => return None,
    };
    let axis: &Axis = &covariates.axes[component.axis];
    let known =
        || component.curve.iter().enumerate().filter_map(|(level, point)| Some((level, (*point)?[0])));
    let over = |covariate| Levels::Over(covariate, known().map(|(level, _)| axis.levels[level]).collect());
    // The first cell is no place: it has the beams that end nowhere.
    let cells = || known().skip_while(|(level, _)| *level == 0);
    let levels = match component.covariate {
        Covariate::Everywhere => Levels::Everywhere,
        Covariate::Range => over(BeamCovariate::Range),
        Covariate::Incidence => over(BeamCovariate::Incidence),
        Covariate::Bearing => over(BeamCovariate::Bearing),
        Covariate::Time => over(BeamCovariate::Time),
        Covariate::Place => {
            let corners = cells().map(|(level, _)| axis.cells[level]);
            Levels::Cells(corners.map(|[x, y, side]| [x, y, x + side, y + side]).collect())
        }
        _ => return None,
    };
    let is_of_cells = component.covariate == Covariate::Place;
    let values = known().skip_while(|(level, _)| is_of_cells && *level == 0).map(|(_, value)| value);
    let [lo, hi] = moment.limits();
    Residual::new(moment, levels, values.map(|value| value.clamp(lo, hi)).collect()).ok()
}
