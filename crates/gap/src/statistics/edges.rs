//! Readings between the two surfaces of an edge.

use distreg::contamination::{detectable_share, score};
use locsim_comparison::kinds_shown_by;
use locsim_world::effect::{self, Alternative, EffectKind};

use super::survey::Survey;
use super::{Family, Form, Group, Halves, Readings, Statistic};

/// The score of an effect by which beams at edges read anything between the edge's two surfaces.
pub(super) struct Edges {
    kind: EffectKind,
    /// The two ranges of the edge that a beam is at.
    jumps: Vec<Option<[f64; 2]>>,
    /// The share at which the score is taken.
    share: f64,
}

impl Edges {
    pub fn all(survey: &Survey<'_>) -> Vec<Self> {
        let share = detectable_share(survey.jumps().iter().flatten().count() as f64);
        kinds_shown_by(|statistic| matches!(statistic, effect::Statistic::Edge))
            .map(|kind| Self { kind, jumps: survey.jumps().to_vec(), share })
            .collect()
    }
}

impl Family for Edges {
    fn statistics(&self) -> Vec<Statistic> {
        vec![Statistic::of_effect(self.kind, Group::Shares, Form::Other).with_one_reading(1.0 / self.share)]
    }

    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        let mut sum = [0.0; 2];
        for reading in &log.all {
            if let Some([near, far]) = self.jumps[reading.index] {
                // Beyond the maximum range nothing is returned.
                let between = Alternative::Between { lo: near, hi: far };
                let ratio = reading.contamination(between.density(reading.z, log.max_range()));
                sum[reading.half] += score(ratio, self.share);
            }
        }
        vec![sum]
    }
}
