//! Errors of the reference poses in the patterns of a displaced or turned laser and of a late stamp.

use locsim_comparison::PosePattern;

use super::{Family, Form, Group, Halves, Readings, Statistic};

/// The scores of all patterns, for hypotheses with errors of the reference poses.
pub(super) struct Poses {
    patterns: Vec<PosePattern>,
}

impl Poses {
    pub fn new() -> Self {
        Self { patterns: PosePattern::all() }
    }
}

impl Family for Poses {
    fn statistics(&self) -> Vec<Statistic> {
        let statistic = |pattern: &PosePattern| {
            Statistic::along(pattern.kind, pattern.direction, Group::Wide, Form::Other)
        };
        self.patterns.iter().map(statistic).collect()
    }

    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        let scores = log.fitted.pattern_scores.iter().filter(|_| log.has_pose_errors);
        let mut halves = vec![[0.0; 2]; self.patterns.len()];
        for (halves, score) in halves.iter_mut().zip(scores) {
            // A score is of the log as a whole.
            *halves = [0.5 * score; 2];
        }
        halves
    }
}

#[cfg(test)]
mod tests {
    use locsim_comparison::fixtures::{NOMINAL, TRUTH};
    use locsim_comparison::hidden::{Regime, record_library};
    use locsim_comparison::{Comparison, Nuisances};
    use locsim_world::effect::EffectKind;

    use crate::statistics::{Dictionary, Readings, pit_draw};
    use crate::{PoseError, Recorded};

    /// Whether a displaced laser is looked for in the readings or in the errors of the reference is the same for a log and
    /// for all replicates, whatever errors are found in each.
    #[test]
    fn the_hypothesis_says_where_a_displaced_laser_is_looked_for() {
        let drive = record_library(&NOMINAL, &TRUTH, &[], Regime::default(), 2).unwrap();
        let recorded = Recorded::new(&drive, 60, 24, |_| true).unwrap();
        let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
        let dictionary = Dictionary::new(&comparison);
        let looked_at = |found: PoseError, has_pose_errors: bool| {
            let mut fitted = comparison.start(&Nuisances { pose_error: found, ..Nuisances::default() });
            fitted.pattern_scores = vec![3.0; 4];
            let log = Readings::new(&comparison, &NOMINAL.effects, &fitted, has_pose_errors, &pit_draw(1));
            let all = dictionary.measure(&log);
            let of_offset = dictionary
                .statistics
                .iter()
                .zip(all)
                .filter(|(statistic, _)| statistic.effect() == Some(EffectKind::MountOffset));
            of_offset.map(|(_, halves)| halves != [0.0; 2]).collect::<Vec<_>>()
        };
        for found in [PoseError::NONE, Regime::POSE_ERROR] {
            // Along x and along y: in the readings, then in the errors.
            assert_eq!(looked_at(found, false), [true, true, false, false]);
            assert_eq!(looked_at(found, true), [false, false, true, true]);
        }
    }
}
