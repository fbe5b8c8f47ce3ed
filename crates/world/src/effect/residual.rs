//! Residuals: curves that a free model has learnt of a log, whose cause nobody knows.

use serde::Serialize;
use thiserror::Error;

use super::reading::{Hit, Return};
use super::{Alternative, BeamView, HitKind, Needs};

/// The most values of a curve.
pub const MOST_VALUES: usize = 1000;

/// What of a reading a residual changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, strum::Display, strum::IntoStaticStr)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Moment {
    /// The mean of a return: values are added to it \[m\].
    Bias,
    /// The standard deviation of a return: it is multiplied by 1 + value.
    Spread,
    /// The share of readings without a return: values are probabilities.
    NoReturn,
    /// The share of readings somewhere in front of what is met: values are probabilities.
    Short,
    /// The share of readings somewhere behind what is met: values are probabilities.
    Long,
}

impl Moment {
    /// The least and the most that a value may be.
    pub fn limits(self) -> [f64; 2] {
        match self {
            Self::Bias => [-10.0, 10.0],
            Self::Spread => [-0.99, 100.0],
            Self::NoReturn | Self::Short | Self::Long => [0.0, 1.0],
        }
    }
}

/// A covariate of a beam, as the map has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum BeamCovariate {
    /// Nominal range \[m\].
    Range,
    /// Incidence \[rad\].
    Incidence,
    /// Bearing in the laser frame \[rad\].
    Bearing,
    /// Time since the drive's first scan \[s\].
    Time,
}

impl BeamCovariate {
    fn of(self, view: &BeamView, max: f64) -> f64 {
        match self {
            Self::Range => view.range.min(max),
            Self::Incidence => view.incidence,
            Self::Bearing => view.bearing,
            Self::Time => view.secs,
        }
    }
}

/// Where a residual has its values.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Levels {
    /// One value for every beam.
    Everywhere,
    /// Values at points of a covariate in ascending order: linear between them, constant beyond them.
    Over(BeamCovariate, Vec<f64>),
    /// Values in cells of the map, `[x_min, y_min, x_max, y_max]` each \[m\], by where the nominal ray ends; 0 outside.
    Cells(Vec<[f64; 4]>),
}

impl Levels {
    /// How many values a curve has.
    pub fn count(&self) -> usize {
        match self {
            Self::Everywhere => 1,
            Self::Over(_, at) => at.len(),
            Self::Cells(cells) => cells.len(),
        }
    }
}

/// A curve over a covariate of a beam by which readings differ from the simulator's.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Residual {
    moment: Moment,
    levels: Levels,
    values: Vec<f64>,
}

/// Why a residual is refused.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ResidualError {
    /// A curve has one value for each level.
    #[error("there are {values} values for {levels} levels; allowed: as many, from 1 to {MOST_VALUES}")]
    Count {
        /// How many levels there are.
        levels: usize,
        /// How many values there are.
        values: usize,
    },
    /// Levels ascend.
    #[error(
        "level {index} is not allowed; levels are finite and ascend, cells have a lower and an upper corner"
    )]
    Level {
        /// The first that doesn't.
        index: usize,
    },
    /// A value is out of range or not finite.
    #[error("value {index}, {value}, is not allowed; from {lo} to {hi}")]
    Value {
        /// Which.
        index: usize,
        /// The value.
        value: f64,
        /// The least that is allowed.
        lo: f64,
        /// The most that is allowed.
        hi: f64,
    },
}

impl Residual {
    /// A curve with a value for each level.
    ///
    /// # Errors
    /// [`ResidualError`] for another number of values, levels that don't ascend, and values beyond [`Moment::limits`].
    pub fn new(moment: Moment, levels: Levels, values: Vec<f64>) -> Result<Self, ResidualError> {
        let count = levels.count();
        if count != values.len() || values.is_empty() || count > MOST_VALUES {
            return Err(ResidualError::Count { levels: count, values: values.len() });
        }
        let wrong = match &levels {
            Levels::Everywhere => None,
            Levels::Over(_, at) => (0..count).find(|&i| !at[i].is_finite() || (i > 0 && at[i - 1] >= at[i])),
            Levels::Cells(cells) => cells
                .iter()
                .position(|[x0, y0, x1, y1]| !(x0 < x1 && y0 < y1 && (x1 - x0 + y1 - y0).is_finite())),
        };
        if let Some(index) = wrong {
            return Err(ResidualError::Level { index });
        }
        let [lo, hi] = moment.limits();
        if let Some(index) = values.iter().position(|value| !(lo..=hi).contains(value)) {
            return Err(ResidualError::Value { index, value: values[index], lo, hi });
        }
        Ok(Self { moment, levels, values })
    }

    /// What it changes.
    pub fn moment(&self) -> Moment {
        self.moment
    }

    /// Where it has its values.
    pub fn levels(&self) -> &Levels {
        &self.levels
    }

    /// One value for each level, in the unit of the moment.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// This curve and another of the same moment at the same levels as one; `None` of any other. Values stay within
    /// [`Moment::limits`].
    #[must_use]
    pub fn and(&self, other: &Self) -> Option<Self> {
        let Self { moment, ref levels, ref values } = *self;
        let [lo, hi] = moment.limits();
        let both = |(a, b): (&f64, &f64)| {
            let sum = if moment == Moment::Spread { (1.0 + a) * (1.0 + b) - 1.0 } else { a + b };
            sum.clamp(lo, hi)
        };
        let is_same = moment == other.moment && *levels == other.levels;
        let values = || values.iter().zip(&other.values).map(both).collect();
        is_same.then(|| Self { moment, levels: levels.clone(), values: values() })
    }

    /// The parts of a beam that it needs.
    pub(super) fn needs(&self) -> Needs {
        use BeamCovariate::{Bearing, Time};
        let without_map = matches!(self.levels, Levels::Everywhere | Levels::Over(Bearing | Time, _));
        Needs { map: !without_map, ..Needs::default() }
    }

    /// The curve's value for a beam.
    fn at(&self, view: &BeamView, max: f64) -> f64 {
        match &self.levels {
            Levels::Everywhere => self.values[0],
            Levels::Over(covariate, at) => {
                let x = covariate.of(view, max);
                let above = at.partition_point(|&level| level <= x);
                if above == 0 || above == at.len() {
                    return self.values[above.saturating_sub(1)];
                }
                let share = (x - at[above - 1]) / (at[above] - at[above - 1]);
                self.values[above - 1] + share * (self.values[above] - self.values[above - 1])
            }
            Levels::Cells(cells) => {
                let end = view.endpoint;
                let holds = |[x0, y0, x1, y1]: &[f64; 4]| {
                    (*x0..*x1).contains(&end.x) && (*y0..*y1).contains(&end.y) && view.range < max
                };
                cells.iter().position(holds).map_or(0.0, |cell| self.values[cell])
            }
        }
    }
}

/// What all residuals make of a reading: biases, logarithms of spreads, and shares add up.
pub(super) fn act(residuals: &[Residual], hit: &Hit<'_>, reading: &mut Return<'_>) {
    let mut shares = [0.0; 3];
    for residual in residuals {
        let value = residual.at(hit.view, hit.max);
        match residual.moment {
            Moment::Bias => reading.bias += value,
            Moment::Spread => reading.wall_sigma *= 1.0 + value,
            Moment::NoReturn => shares[0] += value,
            Moment::Short => shares[1] += value,
            Moment::Long => shares[2] += value,
        }
    }
    let [min, max] = [hit.laser.min_range_m, hit.max];
    let range = hit.range.min(max);
    reading.or(shares[0].min(1.0), Alternative::NoReturn);
    // "In front" and "behind" are of the wall, and not of a block before it.
    if hit.met == HitKind::Wall {
        if range > min {
            reading.or(shares[1].min(1.0), Alternative::Between { lo: min, hi: range });
        }
        if hit.is_in_range() {
            reading.or(shares[2].min(1.0), Alternative::Between { lo: range, hi: max });
        }
    }
}

/// Alternatives to the return that residuals need, at most.
pub(super) const MOST_ALTERNATIVES: usize = 3;

#[cfg(test)]
mod tests {
    use glam::DVec2;

    use super::*;
    use crate::effect::{Effect, EffectKind, Effects, ReadingDistribution};
    use crate::options::LaserOptions;
    use crate::simulation::fixtures::laser_options;

    fn laser() -> LaserOptions {
        LaserOptions { sigma_m: 0.01, ..laser_options() }
    }

    fn view() -> BeamView {
        BeamView {
            secs: 1.0,
            bearing: 0.4,
            range: 3.0,
            incidence: 0.7,
            endpoint: DVec2::new(2.5, 1.5),
            direction: DVec2::X,
            normal: DVec2::ZERO,
            jump: None,
            behind: None,
        }
    }

    fn curve(moment: Moment, levels: Levels, values: &[f64]) -> Residual {
        Residual::new(moment, levels, values.to_vec()).unwrap()
    }

    fn reading(residuals: Vec<Residual>, view: &BeamView) -> ReadingDistribution {
        let effects = Effects::none().with_residuals(residuals).unwrap();
        effects.reading(&laser(), view, HitKind::Wall, view.range)
    }

    #[test]
    fn a_curve_is_linear_between_its_levels_and_constant_beyond() {
        let bearings = Levels::Over(BeamCovariate::Bearing, vec![-1.0, 0.0, 2.0]);
        let bias = curve(Moment::Bias, bearings, &[0.1, 0.3, -0.1]);
        for (bearing, expected) in
            [(-3.0, 0.1), (-1.0, 0.1), (-0.5, 0.2), (0.0, 0.3), (1.0, 0.1), (2.0, -0.1), (3.0, -0.1)]
        {
            let view = BeamView { bearing, ..view() };
            let mean = reading(vec![bias.clone()], &view).mean;
            assert!((mean - view.range - expected).abs() < 1e-12, "{bearing}: {mean}");
        }
    }

    #[test]
    fn each_covariate_and_cell_is_that_of_the_nominal_beam() {
        let at = |covariate, level: f64| Levels::Over(covariate, vec![level - 0.01, level, level + 0.01]);
        let view = BeamView { secs: 7.0, ..view() };
        let DVec2 { x, y } = view.endpoint;
        for levels in [
            at(BeamCovariate::Range, view.range),
            at(BeamCovariate::Incidence, view.incidence),
            at(BeamCovariate::Bearing, view.bearing),
            at(BeamCovariate::Time, 7.0),
            Levels::Cells(vec![
                [x - 2.0, y, x - 1.0, y + 1.0],
                [x, y, x + 1.0, y + 1.0],
                [x, y - 1.0, x + 1.0, y],
            ]),
        ] {
            let mean = reading(vec![curve(Moment::Bias, levels.clone(), &[0.0, 0.25, 0.0])], &view).mean;
            assert_eq!(mean, view.range + 0.25, "{levels:?}");
        }
        let elsewhere = Levels::Cells(vec![[x + 1.0, y, x + 2.0, y + 1.0]]);
        assert_eq!(reading(vec![curve(Moment::Bias, elsewhere, &[0.25])], &view).mean, view.range);
    }

    /// Curves of one moment add up; shares are probabilities of what is read, by the distribution function.
    #[test]
    fn each_moment_is_what_it_says() {
        let view = view();
        let all = |moment, value: f64| curve(moment, Levels::Everywhere, &[value]);
        let both = reading(vec![all(Moment::Spread, 0.5), all(Moment::Spread, 1.0)], &view);
        assert!((both.sigma / reading(Vec::new(), &view).sigma - 3.0).abs() < 1e-12);
        let laser = laser();
        let max = f64::from(laser.max_range_m as f32);
        let mass = |residual: Residual, lo: f64, hi: f64| {
            let reading = reading(vec![residual], &view);
            let below = |x: f64| reading.cdf(x as f32);
            below(hi) - below(lo)
        };
        let near = view.range - 0.5;
        let far = view.range + 0.5;
        let min = laser.min_range_m;
        let lost = mass(all(Moment::NoReturn, 0.2), min, max - 1e-3);
        assert!((lost - 0.8).abs() < 1e-6, "{lost}");
        let short = mass(all(Moment::Short, 0.2), min, near);
        assert!((short - 0.2 * (near - min) / (view.range - min)).abs() < 1e-6, "{short}");
        let long = mass(all(Moment::Long, 0.2), far, max);
        assert!((long - 0.2 * (max - far) / (max - view.range)).abs() < 1e-6, "{long}");
    }

    #[test]
    fn two_curves_as_one_are_both() {
        let over = |at: [f64; 2]| Levels::Over(BeamCovariate::Range, at.to_vec());
        for moment in [Moment::Bias, Moment::Spread] {
            let [a, b] = [[0.1, 0.5], [-0.2, 0.7]].map(|values| curve(moment, over([1.0, 4.0]), &values));
            let one = a.and(&b).unwrap();
            let [both, one] = [vec![a, b], vec![one]].map(|residuals| reading(residuals, &view()));
            // Exact at the levels; a product of lines isn't one.
            assert!((both.mean - one.mean).abs() < 1e-12 && (both.sigma / one.sigma - 1.0).abs() < 0.05);
        }
        let plain = curve(Moment::Bias, over([1.0, 4.0]), &[0.1, 0.5]);
        assert_eq!(plain.and(&curve(Moment::Bias, over([1.0, 5.0]), &[0.1, 0.5])), None);
        assert_eq!(plain.and(&curve(Moment::Short, over([1.0, 4.0]), &[0.1, 0.5])), None);
    }

    #[test]
    fn a_curve_of_zeros_is_the_identity() {
        let effect = Effect::new(EffectKind::HeavyTail, vec![0.1], Vec::new()).unwrap();
        let plain = Effects::new(vec![effect]).unwrap();
        let moments = [Moment::Bias, Moment::Spread, Moment::NoReturn, Moment::Short, Moment::Long];
        let zeros = moments.map(|moment| curve(moment, Levels::Everywhere, &[0.0])).to_vec();
        let same = plain.clone().with_residuals(zeros).unwrap();
        for met in [HitKind::Wall, HitKind::Object] {
            let of = |effects: &Effects| effects.reading(&laser(), &view(), met, view().range);
            assert_eq!(of(&plain), of(&same));
        }
    }

    #[test]
    fn tables_that_make_no_sense_are_refused() {
        let new =
            |levels, values: &[f64]| Residual::new(Moment::NoReturn, levels, values.to_vec()).unwrap_err();
        let over = |at: &[f64]| Levels::Over(BeamCovariate::Range, at.to_vec());
        assert_eq!(new(over(&[1.0, 2.0]), &[0.1]), ResidualError::Count { levels: 2, values: 1 });
        assert_eq!(new(over(&[]), &[]), ResidualError::Count { levels: 0, values: 0 });
        assert_eq!(new(over(&[1.0, 1.0]), &[0.1, 0.1]), ResidualError::Level { index: 1 });
        assert_eq!(new(over(&[f64::NAN]), &[0.1]), ResidualError::Level { index: 0 });
        assert_eq!(new(Levels::Cells(vec![[0.0, 0.0, 0.0, 1.0]]), &[0.1]), ResidualError::Level { index: 0 });
        let out = ResidualError::Value { index: 0, value: 1.5, lo: 0.0, hi: 1.0 };
        assert_eq!(new(Levels::Everywhere, &[1.5]), out);
        // Residuals need room for three ways to be read otherwise.
        let glass: Vec<Effect> = (0..10)
            .map(|_| Effect::new(EffectKind::RangeDropout, vec![0.1, 1.0], Vec::new()).unwrap())
            .collect();
        let crowded = Effects::new(glass).unwrap();
        let one = || vec![curve(Moment::Bias, Levels::Everywhere, &[0.1])];
        assert!(matches!(crowded.with_residuals(one()), Err(crate::effect::EffectError::TooMany { .. })));
    }
}
