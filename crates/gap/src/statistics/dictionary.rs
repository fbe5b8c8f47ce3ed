//! All statistics of a log.

use locsim_comparison::Comparison;
use locsim_world::effect::EffectKind;

use super::bins::Bins;
use super::clutter::{ClutterDensity, ClutterDepth};
use super::displaced_walls::DisplacedWalls;
use super::edges::Edges;
use super::frame::Frame;
use super::neighbours::Neighbours;
use super::objects::Objects;
use super::odometry::{OdometryCorrelation, OdometryLag, Slips};
use super::pit::PitHistogram;
use super::poses::Poses;
use super::ratios::Ratios;
use super::scans::Scans;
use super::scores::Scores;
use super::sectors::Sectors;
use super::steps::Steps;
use super::survey::Survey;
use super::vacated_walls::VacatedWalls;
use super::walls::{WallLoss, WallShift};
use super::{Cell, Family, Found, Halves, Readings, Start, Statistic};

/// The families of statistics that are looked at in a log.
pub(crate) struct Dictionary {
    /// The statistics of all families, one family after the other.
    pub statistics: Vec<Statistic>,
    families: Vec<Box<dyn Family>>,
    /// Index of the first statistic of each family.
    firsts: Vec<usize>,
}

/// Families of one type as any families.
fn boxed<F: Family + 'static>(
    families: impl IntoIterator<Item = F>,
) -> impl Iterator<Item = Box<dyn Family>> {
    families.into_iter().map(|family| Box::new(family) as Box<dyn Family>)
}

impl Dictionary {
    /// The statistics of a log. They are laid out over the log's poses and the nominal world, and never over its readings.
    pub fn new(comparison: &Comparison<'_>) -> Self {
        let survey = Survey::new(comparison);
        let families: Vec<Box<dyn Family>> = boxed(Scores::all(&survey))
            .chain(boxed(WallShift::all(&survey)))
            .chain(boxed(DisplacedWalls::all(&survey)))
            .chain(boxed(VacatedWalls::all(&survey)))
            .chain(boxed(WallLoss::all(&survey)))
            .chain(boxed(Edges::all(&survey)))
            .chain(boxed(Steps::all()))
            .chain(boxed(ClutterDepth::all(&survey)))
            .chain(boxed(ClutterDensity::all(&survey)))
            .chain(boxed(OdometryCorrelation::all()))
            .chain(boxed(Slips::all()))
            .chain(boxed([Poses::new()]))
            .chain(boxed(Objects::all(&survey)))
            .chain(boxed(Sectors::all(&survey)))
            .chain(boxed([Bins::new(&survey)]))
            .chain(boxed([Scans]))
            .chain(boxed([PitHistogram]))
            .chain(boxed([Ratios]))
            .chain(boxed([Neighbours]))
            .chain(boxed([OdometryLag]))
            .chain(boxed([Frame]))
            .collect();
        let (mut statistics, mut firsts) = (Vec::new(), Vec::new());
        for family in &families {
            firsts.push(statistics.len());
            statistics.extend(family.statistics());
        }
        Self { statistics, families, firsts }
    }

    /// The values of all statistics for a log.
    pub fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        self.families.iter().flat_map(|family| family.measure(log)).collect()
    }

    /// Where fits of an effect start, by its statistics that are farthest off, the most telling one first: z and index. The
    /// family of the first one says where.
    pub fn first_guesses(&self, log: &Readings<'_>, found: &[(f64, usize)]) -> Vec<Start> {
        let Some(&(_, most_telling)) = found.first() else { return Vec::new() };
        let (family, first) = self.family(most_telling);
        let own: Vec<Found<'_>> = found
            .iter()
            .filter(|(_, index)| self.family(*index).1 == first)
            .map(|&(z, index)| Found { z, index: index - first, statistic: &self.statistics[index] })
            .collect();
        family.first_guesses(log, &own)
    }

    /// The effects that most of a log's readings are moved by, with where fits of them start.
    pub fn moving(&self, log: &Readings<'_>) -> Vec<(EffectKind, Start)> {
        self.families.iter().filter_map(|family| family.moves_most(log)).collect()
    }

    /// The family of a statistic, and the index of its first one.
    fn family(&self, statistic: usize) -> (&dyn Family, usize) {
        let family = self.firsts.partition_point(|&first| first <= statistic) - 1;
        (&*self.families[family], self.firsts[family])
    }

    /// The omnibus cells, with the indices of their statistics.
    pub fn cells(&self) -> impl Iterator<Item = (usize, &Cell)> {
        let statistics = self.statistics.iter().enumerate();
        statistics.filter_map(|(i, statistic)| Some((i, statistic.cell()?)))
    }

    /// Whether a statistic counts the readings of a beam, both by index.
    pub fn includes(&self, statistic: usize, beam: usize) -> bool {
        let (family, first) = self.family(statistic);
        family.includes(statistic - first, beam)
    }
}

#[cfg(test)]
mod tests {
    use locsim_comparison::Nuisances;
    use locsim_comparison::fixtures::{DRIVE, NOMINAL};

    use super::*;
    use crate::Recorded;
    use crate::statistics::{Form, pit_draw};

    /// Each effect of the library has a statistic, and each statistic a value.
    #[test]
    fn every_effect_is_looked_for() {
        let recorded = Recorded::new(&DRIVE, 60, 24, |_| true).unwrap();
        let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
        let dictionary = Dictionary::new(&comparison);
        for kind in EffectKind::ALL {
            let is_shown = dictionary.statistics.iter().any(|statistic| statistic.effect() == Some(kind));
            assert!(is_shown, "{kind}");
        }
        // What shows in a few stray readings says what one of them changes.
        for statistic in &dictionary.statistics {
            let is_of_stray = matches!(statistic.effect(), Some(EffectKind::Glass | EffectKind::Crosstalk))
                || statistic.effect() == Some(EffectKind::MovedWall) && statistic.form == Form::Share;
            assert!(!is_of_stray || statistic.by_one_reading > 0.0, "{statistic:?}");
        }
        let fitted = comparison.start(&Nuisances::default());
        let log = Readings::new(&comparison, &NOMINAL.effects, &fitted, false, &pit_draw(1));
        for (family, first) in dictionary.families.iter().zip(&dictionary.firsts) {
            assert_eq!(family.statistics().len(), family.measure(&log).len(), "family at {first}");
        }
    }
}
