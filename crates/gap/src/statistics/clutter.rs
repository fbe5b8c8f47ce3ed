//! Clutter: how deep it reaches into the room, and how much there is.

use locsim_comparison::kinds_shown_by;
use locsim_world::effect::{self, EffectKind};

use super::survey::Survey;
use super::{Family, Form, Group, Halves, Readings, Statistic};

/// Readings farther in front of a wall are hardly of clutter \[m\].
const DEEPEST_M: f64 = 1.5;

/// The effects that show in a statistic of clutter: none where the scenario has no clutter. The density is at its limit then, and the depth that
/// of a few readings past edges, each of which would stand out from all.
fn all_of(survey: &Survey<'_>, shows: fn(&effect::Statistic) -> bool) -> impl Iterator<Item = EffectKind> {
    let has_clutter = survey.comparison.nominal.blocks.is_some();
    kinds_shown_by(shows).filter(move |_| has_clutter)
}

/// The mean distance to the wall of readings in front of it. Whether clutter can stand there by the hypothesis is not asked:
/// that is the question.
pub(super) struct ClutterDepth {
    kind: EffectKind,
}

impl ClutterDepth {
    pub fn all(survey: &Survey<'_>) -> Vec<Self> {
        all_of(survey, |statistic| matches!(statistic, effect::Statistic::ClutterDepth))
            .map(|kind| Self { kind })
            .collect()
    }
}

impl Family for ClutterDepth {
    fn statistics(&self) -> Vec<Statistic> {
        vec![Statistic::of_effect(self.kind, Group::Shares, Form::Other)]
    }

    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        let (mut depth, mut count) = ([0.0; 2], [0.0; 2]);
        for reading in log.in_front() {
            depth[reading.half] += (reading.beam.range() - reading.z).min(DEEPEST_M);
            count[reading.half] += 1.0;
        }
        // One reading more at the wall: a mean of no readings is 0.
        vec![std::array::from_fn(|half| depth[half] / (count[half] + 1.0))]
    }
}

/// The fitted density of clutter. The search fits it in every hypothesis, so that it is no part of a log's halves.
pub(super) struct ClutterDensity {
    kind: EffectKind,
}

impl ClutterDensity {
    pub fn all(survey: &Survey<'_>) -> Vec<Self> {
        all_of(survey, |statistic| matches!(statistic, effect::Statistic::ClutterDensity))
            .map(|kind| Self { kind })
            .collect()
    }
}

impl Family for ClutterDensity {
    fn statistics(&self) -> Vec<Statistic> {
        vec![Statistic::of_effect(self.kind, Group::Places, Form::Other)]
    }

    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        vec![[0.5 * log.fitted.nuisances.block_density.ln(); 2]]
    }
}

#[cfg(test)]
mod tests {
    use locsim_comparison::fixtures::{NOMINAL, TRUTH};
    use locsim_comparison::hidden::{Regime, record_library};
    use locsim_comparison::{Comparison, Nuisances};
    use locsim_world::effect::Effect;

    use super::*;
    use crate::Recorded;
    use crate::statistics::pit_draw;

    /// A beam that passes an edge ends far in front of where it should. Without clutter that says nothing of its depth.
    #[test]
    fn a_scenario_without_clutter_has_no_statistic_of_it() {
        let nominal = NOMINAL.without_blocks().unwrap();
        let drive = record_library(&nominal, &TRUTH, &[], Regime::default(), 2).unwrap();
        let recorded = Recorded::new(&drive, 200, 72, |_| true).unwrap();
        for (nominal, has_any) in [(&nominal, false), (&*NOMINAL, true)] {
            let comparison = Comparison::new(nominal, &recorded).unwrap();
            let survey = Survey::new(&comparison);
            assert_eq!(
                [ClutterDepth::all(&survey).is_empty(), ClutterDensity::all(&survey).is_empty()],
                [!has_any; 2]
            );
        }
    }

    /// Clutter three times as deep seems more than twice as deep, though nominal clutter can't stand where most of it is
    /// seen.
    #[test]
    fn deep_clutter_is_seen_where_nominal_clutter_cannot_stand() {
        let depth = |factor: f64| {
            let deeper = Effect::new(EffectKind::BlockDepth, vec![factor], Vec::new()).unwrap();
            let drive = record_library(&NOMINAL, &TRUTH, &[deeper], Regime::default(), 2).unwrap();
            let recorded = Recorded::new(&drive, 200, 72, |_| true).unwrap();
            let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
            let fitted = comparison.start(&Nuisances::default());
            let log = Readings::new(&comparison, &NOMINAL.effects, &fitted, false, &pit_draw(1));
            ClutterDepth::all(&Survey::new(&comparison))[0].measure(&log)[0].iter().sum::<f64>()
        };
        let (nominal, deep) = (depth(1.0), depth(3.0));
        assert!(deep > 2.0 * nominal, "{nominal} {deep}");
    }
}
