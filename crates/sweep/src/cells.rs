//! Figures of each cell and model, gathered from the rows of their trials as they stream by.

use indexmap::IndexSet;
use locsim_core::Interval;
use locsim_report::statistics::{Moments, share_interval};
use locsim_report::trial_set::Measured;
use rayon::prelude::*;

/// The trials of one model, in one cell or in several.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    /// Mean squared position errors of the trials \[m^2\].
    squares: Moments,
    /// Mean numbers of particles of the trials.
    particles: Moments,
    /// Particles times beams of the trials.
    casts: Moments,
    /// Lost trials.
    pub lost: u32,
}

impl Tally {
    fn of(row: &Measured<'_>) -> Self {
        let once = |value: f64| std::iter::once(value).collect::<Moments>();
        Self {
            squares: once(row.position_rmse_m.powi(2)),
            particles: once(row.particles_mean),
            casts: once(row.particles_mean * f64::from(row.beams)),
            lost: u32::from(row.lost),
        }
    }

    /// Adds other trials.
    pub fn add(&mut self, other: &Self) {
        let sum = |a: &Moments, b: &Moments| Moments::pooled([(a, 1), (b, 1)]);
        self.squares = sum(&self.squares, &other.squares);
        self.particles = sum(&self.particles, &other.particles);
        self.casts = sum(&self.casts, &other.casts);
        self.lost += other.lost;
    }

    /// Number of trials.
    pub fn trials(&self) -> u32 {
        self.squares.count() as u32
    }

    /// Root of the mean over trials of the mean squared position error \[m\].
    pub fn rmse_m(&self) -> f64 {
        self.squares.mean().sqrt()
    }

    /// Its 95 % interval: that of the mean by Student's t, under the root.
    pub fn rmse_interval(&self) -> Option<Interval> {
        let interval = self.squares.mean_interval()?;
        Some(Interval { lo: interval.lo.max(0.0).sqrt(), hi: interval.hi.sqrt() })
    }

    /// Share of lost trials.
    pub fn lost_share(&self) -> f64 {
        f64::from(self.lost) / self.squares.count()
    }

    /// Its exact 95 % interval.
    pub fn lost_interval(&self) -> Interval {
        share_interval(self.lost, self.trials())
    }

    /// Mean number of particles.
    pub fn particles(&self) -> f64 {
        self.particles.mean()
    }

    /// Mean number of beams that a step casts, one for each particle and beam of the scan.
    pub fn casts(&self) -> f64 {
        self.casts.mean()
    }
}

/// A model beside the others of the same cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Its RMSE is the lowest.
    Best,
    /// Its interval meets that of the lowest.
    Tied,
    /// Neither.
    Worse,
}

impl Place {
    /// As `cells.csv` has it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Best => "best",
            Self::Tied => "tied",
            Self::Worse => "",
        }
    }
}

/// The place of each model.
pub fn places(tallies: &[Tally]) -> Vec<Place> {
    let rmse = |tally: &Tally| tally.rmse_m();
    let best = (0..tallies.len()).min_by(|a, b| rmse(&tallies[*a]).total_cmp(&rmse(&tallies[*b])));
    let interval = |tally: &Tally| {
        let rmse = tally.rmse_m();
        tally.rmse_interval().unwrap_or(Interval { lo: rmse, hi: rmse })
    };
    let place = |(i, tally): (usize, &Tally)| match best {
        Some(best) if best == i => Place::Best,
        Some(best) if interval(tally).lo <= interval(&tallies[best]).hi => Place::Tied,
        _ => Place::Worse,
    };
    tallies.iter().enumerate().map(place).collect()
}

/// One cell.
#[derive(Clone, Debug)]
pub struct CellFigures {
    /// Its number.
    pub cell: u32,
    /// Beams of a scan.
    pub beams: u32,
    /// Index of each model in [`Figures::models`], and its trials.
    pub models: Vec<(usize, Tally)>,
}

/// All cells.
#[derive(Clone, Debug, Default)]
pub struct Figures {
    /// Labels of all models, in the order in which they come first.
    pub models: IndexSet<String>,
    /// The cells in their order.
    pub cells: Vec<CellFigures>,
}

impl Figures {
    /// Takes in a row. The rows of a cell come together.
    pub fn add(&mut self, row: &Measured<'_>) {
        let model = match self.models.get_index_of(row.model) {
            Some(model) => model,
            None => self.models.insert_full(row.model.to_owned()).0,
        };
        if self.cells.last().is_none_or(|last| last.cell != row.cell) {
            self.cells.push(CellFigures { cell: row.cell, beams: row.beams, models: Vec::new() });
        }
        let Some(cell) = self.cells.last_mut() else { return };
        let tally = Tally::of(row);
        match cell.models.iter_mut().find(|(known, _)| *known == model) {
            Some((_, known)) => known.add(&tally),
            None => cell.models.push((model, tally)),
        }
    }

    /// The trials of a model in all cells.
    pub fn total(&self, model: usize) -> Tally {
        let mut total = Tally::default();
        for (_, tally) in self.cells.iter().flat_map(|cell| &cell.models).filter(|(other, _)| *other == model)
        {
            total.add(tally);
        }
        total
    }

    /// The place of each model in each cell.
    pub fn places(&self) -> Vec<Vec<Place>> {
        let of_cell = |cell: &CellFigures| {
            let tallies: Vec<Tally> = cell.models.iter().map(|(_, tally)| *tally).collect();
            places(&tallies)
        };
        self.cells.par_iter().map(of_cell).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(model: &str, rmse: f64, lost: bool) -> Measured<'_> {
        Measured { cell: 0, model, steps: 3, lost, position_rmse_m: rmse, particles_mean: 100.0, beams: 12 }
    }

    #[test]
    fn a_cell_s_figures_are_those_of_its_trials() {
        let mut figures = Figures::default();
        for (rmse, lost) in [(0.3, false), (0.4, true)] {
            figures.add(&row("a", rmse, lost));
            figures.add(&row("b", 10.0 * rmse, false));
        }
        figures.add(&Measured { cell: 1, ..row("b", 1.0, false) });
        assert_eq!(figures.cells.len(), 2);
        let (_, tally) = figures.cells[0].models[0];
        assert!((tally.rmse_m() - 0.125_f64.sqrt()).abs() < 1e-12);
        assert_eq!((tally.trials(), tally.lost_share(), tally.casts()), (2, 0.5, 1200.0));
        assert!(tally.rmse_interval().unwrap().contains(tally.rmse_m()));
        assert_eq!(figures.total(1).trials(), 3);
        assert_eq!(figures.cells[1].models[0].1.rmse_interval(), None);
    }

    #[test]
    fn models_that_cannot_be_told_apart_are_tied() {
        let tally = |values: &[f64]| {
            let mut tally = Tally::default();
            for rmse in values {
                tally.add(&Tally::of(&row("a", *rmse, false)));
            }
            tally
        };
        let tallies = [tally(&[0.2, 0.3, 0.25]), tally(&[0.21, 0.31, 0.22]), tally(&[0.9, 0.91, 0.92])];
        assert_eq!(places(&tallies), [Place::Tied, Place::Best, Place::Worse]);
        assert_eq!(places(&[]), []);
    }
}
