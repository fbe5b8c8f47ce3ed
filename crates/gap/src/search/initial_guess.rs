//! Which effects are fitted, and where the fits start, by the statistics that are farthest off.

use locsim_world::effect::{EffectKind, Fit, Moves};

use super::{Round, State};
use crate::GapError;
use crate::statistics::{Readings, Start, pit_draw};

/// The statistics of an effect: z and index of each.
type Directions = Vec<(f64, usize)>;

/// Where fits start.
pub struct Guesses {
    pub starts: Vec<(EffectKind, Vec<Start>)>,
    /// The effects that most readings are moved by.
    pub moving: Vec<EffectKind>,
}

impl<'a> State<'a> {
    /// At most `count` effects with where their fits start, the most promising one first: those with a statistic as far off
    /// as some statistic is in the share `chance` of logs without any fault. Further ones come after them.
    pub fn first_guesses(
        &self,
        round: &Round<'a>,
        count: usize,
        chance: f64,
        further: &[EffectKind],
    ) -> Result<Guesses, GapError> {
        let effects = round.comparison.effects(&round.effects)?;
        // Starts don't depend on PITs, nor on whether poses err.
        let pit = pit_draw(self.options.seed);
        let log = Readings::new(&round.comparison, &effects, &round.fitted, false, &pit);
        // Errors of the reference that were fitted without a moved wall follow a part of it.
        let exact = round.comparison.start_exact(&round.fitted.nuisances);
        let exact =
            exact.as_ref().map(|fitted| Readings::new(&round.comparison, &effects, fitted, false, &pit));
        // Errors of reference and walls that were fitted without an effect that moves most readings follow a part of it.
        let mut moving = round.dictionary.moving(&log);
        for (kind, start) in exact.iter().flat_map(|log| round.dictionary.moving(log)) {
            if moving.iter().all(|(known, _)| *known != kind) {
                moving.push((kind, start));
            }
        }
        let further: Vec<EffectKind> =
            further.iter().copied().chain(moving.iter().map(|(kind, _)| *kind)).collect();
        let guesses =
            self.promising(round, count, chance, &further).into_iter().map(|(kind, mut directions)| {
                directions.sort_by(|a, b| round.says(b.1, a.1));
                // Clutter that stays looks like missing objects in every log: places where it can stand are no starts where
                // other places say more.
                let group = |index: usize| round.dictionary.statistics[index].group;
                let most_telling = group(directions[0].1);
                directions.retain(|&(_, index)| group(index) == most_telling);
                let exact = exact.as_ref().filter(|_| kind.moves() == Moves::Walls);
                let logs = [Some(&log), exact].into_iter().flatten();
                let starts = logs.flat_map(|log| round.dictionary.first_guesses(log, &directions));
                let far = moving.iter().filter(|(moved, _)| *moved == kind).map(|(_, start)| start.clone());
                (kind, starts.chain(far).collect())
            });
        let starts = guesses.filter(|(_, starts): &(EffectKind, Vec<Start>)| !starts.is_empty()).collect();
        Ok(Guesses { starts, moving: moving.iter().map(|(kind, _)| *kind).collect() })
    }

    /// The effects whose statistics are farthest off, and further ones.
    fn promising(
        &self,
        round: &Round<'a>,
        count: usize,
        chance: f64,
        further: &[EffectKind],
    ) -> Vec<(EffectKind, Directions)> {
        let mut all: Vec<(EffectKind, f64, Directions)> = Vec::new();
        for (i, statistic) in round.dictionary.statistics.iter().enumerate() {
            let Some(kind) = statistic.effect().filter(|kind| self.may_be_added(round, *kind)) else {
                continue;
            };
            let (weight, direction) = (round.null.weight[i], (round.null.z[i], i));
            match all.iter_mut().find(|(known, ..)| *known == kind) {
                Some((_, largest, directions)) => {
                    *largest = largest.max(weight);
                    directions.push(direction);
                }
                None => all.push((kind, weight, vec![direction])),
            }
        }
        all.sort_by(|a, b| b.1.total_cmp(&a.1));
        let least = round.null.weight_at(chance);
        let is_asked =
            |i: usize, kind: EffectKind, weight: f64| i < count && weight >= least || further.contains(&kind);
        let asked = all.into_iter().enumerate().filter(|(i, (kind, weight, _))| is_asked(*i, *kind, *weight));
        asked.map(|(_, (kind, _, directions))| (kind, directions)).collect()
    }

    /// Whether the search may add an effect to a round's.
    fn may_be_added(&self, round: &Round<'a>, kind: EffectKind) -> bool {
        let description = kind.description();
        let mut present = self.nominal.effects.list().iter().chain(&round.effects);
        !self.options.without.contains(&kind)
            && description.fit != Fit::Nuisance
            && !(description.is_single && present.any(|effect| effect.kind == kind))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use locsim_comparison::fixtures::{NOMINAL, TRUTH};
    use locsim_comparison::hidden::{Regime, record_library};
    use locsim_comparison::{Comparison, Nuisances, fit_persistence};
    use locsim_world::effect::Effect;

    use super::*;
    use crate::{GapOptions, Recorded};

    /// Errors of the reference have followed a laser that is turned by 1.7 degrees: it moves no reading any more but with an exact reference.
    #[test]
    fn what_the_reference_has_followed_moves_readings_all_the_same() {
        let yaw = Effect::new(EffectKind::MountYaw, vec![0.03], Vec::new()).unwrap();
        let regime = Regime { pose_error: Some(Regime::POSE_ERROR), ..Regime::default() };
        let drive = record_library(&NOMINAL, &TRUTH, &[yaw], regime, 3).unwrap();
        let recorded = Recorded::new(&drive, 100, 72, |_| true).unwrap();
        let options = GapOptions { replicates: 19, seed: 5, ..GapOptions::default() };
        let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
        let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
        let blocks = fit_persistence(&comparison, &[], &fitted, options.seed).unwrap();
        let (nominal, recorded, stop) = (&NOMINAL, &recorded, AtomicBool::new(false));
        let state =
            State { nominal, recorded, comparison, options: &options, progress: &(), stop: &stop, blocks };
        let round = state.round(Vec::new(), fitted.nuisances, options.replicates).unwrap();
        let log =
            Readings::new(&round.comparison, &NOMINAL.effects, &round.fitted, false, &pit_draw(options.seed));
        assert!(round.dictionary.moving(&log).iter().all(|(kind, _)| *kind != EffectKind::MountYaw));
        let Guesses { starts, moving } = state.first_guesses(&round, 1, 0.01, &[]).unwrap();
        assert!(moving.contains(&EffectKind::MountYaw), "{moving:?}");
        assert!(starts.iter().any(|(kind, _)| *kind == EffectKind::MountYaw));
    }
}
