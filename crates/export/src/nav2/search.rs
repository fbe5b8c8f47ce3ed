//! The search for AMCL's parameters on drives that no trial localizes on.
//!
//! A random search: sets of parameters drawn evenly over the logarithms of their ranges, then around the best so far, closer and
//! closer. All sets localize with the same draws (common random numbers), so that their differences are those of the parameters.
//! The best few are compared once more with other draws, because the least of many noisy numbers is too small.

use locsim_core::{Control, Draw, Drive, Stage};
use locsim_sensor::{AmclKind, AmclParameters};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

use super::amcl::{Localizer, Settings};
use locsim_lab::LabError;
use locsim_lab::inspect::rounded;

/// Significant digits of a parameter: what is written is what was tried.
const DIGITS: i32 = 3;
/// Localizations of each set of parameters in a search, and of each finalist, at the least.
const LOCALIZATIONS: [usize; 2] = [6, 24];
/// Half of the sets are drawn from everywhere; then come rounds around the best ones with these deviations, in shares of the ranges.
const ROUNDS: [f64; 4] = [0.2, 0.12, 0.07, 0.04];
/// The best ones, which the next are drawn around, and the finalists.
const ELITES: usize = 8;
/// A localization that is this many times as far off as a lost robot is given up.
const GIVEN_UP: f64 = 2.0;
/// Least noise of an odometry that looks perfect: a filter without any can't follow the errors of its map.
pub(super) const LEAST_ALPHA: f64 = 5e-4;

/// A searched quantity, by its logarithm.
struct Coordinate {
    least: f64,
    most: f64,
}

const fn between(least: f64, most: f64) -> Coordinate {
    Coordinate { least, most }
}

/// In order: `z_hit`, `z_rand`, `sigma_hit`, the number of beams (the most is the laser's), `laser_likelihood_max_dist`, the factor on the
/// odometry's noise, `z_short`, `z_max`, `lambda_short`.
const COORDINATES: [Coordinate; 9] = [
    between(0.02, 1.0),
    between(0.005, 1.0),
    between(0.02, 0.5),
    between(8.0, 1e6),
    between(0.1, 2.0),
    between(0.5, 50.0),
    between(0.005, 1.0),
    between(0.005, 1.0),
    between(0.05, 5.0),
];

/// A set of parameters as a point of the unit cube.
#[derive(Clone, Copy, Debug)]
struct Point {
    kind: AmclKind,
    at: [f64; COORDINATES.len()],
}

/// A set that was tried.
#[derive(Clone, Copy, Debug)]
struct Tried {
    point: Point,
    error_m: f64,
}

/// What the search found.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found {
    pub settings: Settings,
    /// The factor on the odometry's noise; `None` for nav2's alphas.
    pub noise_factor: Option<f64>,
    /// Mean error of the finalists' localizations on the training drives \[m\], and that of nav2's defaults.
    pub error_m: f64,
    pub defaults_error_m: f64,
}

/// The grounds of a search.
pub(super) struct Search<'a> {
    pub localizer: &'a Localizer,
    /// AMCL's updates of the training drives.
    pub drives: &'a [Drive],
    /// The odometry's noise.
    pub alpha: [f64; 4],
    pub seed: u64,
    pub evaluations: u32,
    pub control: Control<'a>,
}

impl Search<'_> {
    /// The best parameters of all, and the best of the likelihood fields, which Beluga has too.
    ///
    /// # Errors
    /// [`LabError`] of a filter; an interruption.
    pub fn run(&self) -> Result<[Found; 2], LabError> {
        self.control.progress.stage("searching AMCL's parameters", u64::from(self.evaluations));
        let draw = Draw::new(self.seed, Stage::Search, 0);
        let everywhere = self.evaluations.div_ceil(2);
        let points: Vec<Point> = (0..everywhere).map(|i| anywhere(i, &draw)).collect();
        let mut tried = self.trials_of(&points)?;
        let mut drawn = everywhere;
        for (round, deviation) in (1..).zip(ROUNDS) {
            let count = (self.evaluations - everywhere) / ROUNDS.len() as u32;
            let best = best_of(&tried, |_| true);
            let points: Vec<Point> = (0..count).map(|i| near(&best, deviation, i, &draw.at(round))).collect();
            tried.extend(self.trials_of(&points)?);
            drawn += count;
        }
        self.control.progress.advance(u64::from(self.evaluations - drawn));
        let is_field = |kind| kind != AmclKind::AmclBeam;
        let all = self.decide(&tried, |_| true)?;
        let field = if is_field(all.settings.laser.kind) { all } else { self.decide(&tried, is_field)? };
        Ok([all, field])
    }

    /// The best of the finalists of some kinds, with draws that the search hasn't had.
    fn decide(&self, tried: &[Tried], kinds: impl Fn(AmclKind) -> bool) -> Result<Found, LabError> {
        let best = best_of(tried, kinds);
        // Around an optimum the mean of the best is nearer to it than the one that chance favours.
        let first = best[0].kind;
        let alike: Vec<&Point> = best.iter().filter(|point| point.kind == first).collect();
        let mean =
            std::array::from_fn(|i| alike.iter().map(|point| point.at[i]).sum::<f64>() / alike.len() as f64);
        let points = best.iter().copied().chain([Point { kind: first, at: mean }]);
        let candidates: Vec<(Settings, Option<f64>)> = points
            .map(|point| {
                let (settings, factor) = self.settings(&point);
                (settings, Some(factor))
            })
            .chain([(Settings::DEFAULTS, None)])
            .collect();
        self.control.progress.stage("comparing the best", candidates.len() as u64);
        let settings: Vec<Settings> = candidates.iter().map(|(settings, _)| *settings).collect();
        let errors = self.errors_of(&settings, LOCALIZATIONS[1], 1)?;
        let defaults_error_m = errors[errors.len() - 1];
        let least = (0..errors.len()).min_by(|a, b| errors[*a].total_cmp(&errors[*b])).unwrap_or(0);
        let (settings, noise_factor) = candidates[least];
        Ok(Found { settings, noise_factor, error_m: errors[least], defaults_error_m })
    }

    fn trials_of(&self, points: &[Point]) -> Result<Vec<Tried>, LabError> {
        let settings: Vec<Settings> = points.iter().map(|point| self.settings(point).0).collect();
        let errors = self.errors_of(&settings, LOCALIZATIONS[0], 0)?;
        Ok(points.iter().zip(errors).map(|(&point, error_m)| Tried { point, error_m }).collect())
    }

    /// Mean position error \[m\] of each set over the training drives, all with the same draws; a lost robot counts as far as it may
    /// be.
    fn errors_of(&self, settings: &[Settings], localizations: usize, set: u32) -> Result<Vec<f64>, LabError> {
        let draw = Draw::new(self.seed, Stage::Search, u32::MAX - set);
        let repeats = localizations.div_ceil(self.drives.len()) as u32;
        let seeds: Vec<u64> = (0..repeats).map(|repeat| draw.seed(repeat)).collect();
        settings
            .par_iter()
            .map(|settings| {
                if self.control.is_interrupted() {
                    return Err(LabError::Stopped);
                }
                let lost_m = self.localizer.lost_m;
                let mut sum = 0.0;
                for drive in self.drives {
                    for &seed in &seeds {
                        let errors = self.localizer.errors(settings, drive, seed, GIVEN_UP * lost_m)?;
                        sum += if errors.is_lost { lost_m } else { errors.position_m().min(lost_m) };
                    }
                }
                self.control.progress.advance(1);
                Ok(sum / (self.drives.len() * seeds.len()) as f64)
            })
            .collect()
    }

    /// The parameters at a point, rounded, and the factor on the odometry's noise.
    fn settings(&self, point: &Point) -> (Settings, f64) {
        let beams = self.drives[0].laser.beam_count();
        let [z_hit, z_rand, sigma_hit, count, max_dist, factor, z_short, z_max, lambda_short] =
            std::array::from_fn(|i| {
                let Coordinate { least, mut most } = COORDINATES[i];
                if i == 3 {
                    most = beams as f64;
                }
                least.min(most) * (most / least.min(most)).powf(point.at[i])
            });
        let usual = AmclParameters::defaults(point.kind);
        let is_beam = point.kind == AmclKind::AmclBeam;
        let laser = if is_beam {
            AmclParameters { z_hit, z_rand, sigma_hit, z_short, z_max, lambda_short, ..usual }
        } else {
            let laser_likelihood_max_dist = rounded(max_dist, DIGITS);
            AmclParameters { z_hit, z_rand, sigma_hit, laser_likelihood_max_dist, ..usual }
        };
        let max_range = f64::from(self.drives[0].laser.max_range());
        let laser = AmclParameters {
            max_beams: whole_stride(point.kind, beams, count),
            ..below_one(laser, max_range)
        };
        let factor = rounded(factor, DIGITS);
        let alpha = self.alpha.map(|alpha| rounded(factor * alpha.max(LEAST_ALPHA), DIGITS));
        (Settings { laser, alpha }, factor)
    }
}

/// Rounds the weights, and scales them such that no term is above 1, which AMCL asserts.
fn below_one(laser: AmclParameters, max_range: f64) -> AmclParameters {
    let random = laser.z_rand / max_range;
    let greatest = if laser.kind == AmclKind::AmclBeam {
        laser.z_hit + laser.z_short * laser.lambda_short + random.max(laser.z_max)
    } else {
        laser.z_hit + random
    };
    // Rounding may go up by half a unit of the last digit.
    let scale = 0.99 / greatest.max(0.99);
    let weight = |value: f64| rounded(scale * value, DIGITS);
    let is_beam = laser.kind == AmclKind::AmclBeam;
    AmclParameters {
        z_hit: weight(laser.z_hit),
        z_rand: weight(laser.z_rand),
        z_short: if is_beam { weight(laser.z_short) } else { laser.z_short },
        z_max: if is_beam { weight(laser.z_max) } else { laser.z_max },
        sigma_hit: rounded(laser.sigma_hit, DIGITS),
        lambda_short: rounded(laser.lambda_short, DIGITS),
        ..laser
    }
}

/// The number of beams near `count` that AMCL then takes, as far as it is one of every so manieth beam.
fn whole_stride(kind: AmclKind, beams: usize, count: f64) -> usize {
    let stride = ((beams as f64 / count).round() as usize).clamp(1, beams.div_ceil(2).max(1));
    let taken = match kind {
        AmclKind::AmclLikelihoodFieldProb => beams.div_ceil(stride),
        AmclKind::AmclBeam | AmclKind::AmclLikelihoodField => beams.saturating_sub(1) / stride + 1,
    };
    taken.max(2)
}

/// A point drawn evenly; kinds take turns.
fn anywhere(i: u32, draw: &Draw) -> Point {
    let mut rng = draw.item(i);
    let kind = AmclKind::ALL[i as usize % AmclKind::ALL.len()];
    Point { kind, at: std::array::from_fn(|_| rng.random()) }
}

/// A point near one of the best; they take turns.
fn near(best: &[Point], deviation: f64, i: u32, draw: &Draw) -> Point {
    let mut rng = draw.item(i);
    let centre = best[i as usize % best.len()];
    let at = centre.at.map(|at| {
        let unit: f64 = StandardNormal.sample(&mut rng);
        (at + deviation * unit).clamp(0.0, 1.0)
    });
    Point { at, ..centre }
}

/// The best points of some kinds, the best first.
fn best_of(tried: &[Tried], kinds: impl Fn(AmclKind) -> bool) -> Vec<Point> {
    let mut best: Vec<&Tried> = tried.iter().filter(|tried| kinds(tried.point.kind)).collect();
    best.sort_by(|a, b| a.error_m.total_cmp(&b.error_m));
    best.iter().take(ELITES).map(|tried| tried.point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn amcl_takes_as_many_beams_as_max_beams_says() {
        for kind in AmclKind::ALL.iter().copied() {
            for beams in [24, 54, 180, 181, 360, 1081] {
                for count in [8.0, 20.0, 61.0, 180.0, 1e6] {
                    let max_beams = whole_stride(kind, beams, count);
                    let laser = AmclParameters { max_beams, ..AmclParameters::defaults(kind) };
                    let taken = (0..beams).step_by(laser.stride(beams)).count();
                    let is_near = (taken as f64 / max_beams as f64 - 1.0).abs() < 0.07;
                    assert!(is_near, "{kind} {beams} {count}: {max_beams}, but {taken}");
                }
            }
        }
    }

    #[test]
    fn no_term_is_above_one() {
        let usual = AmclParameters::defaults(AmclKind::AmclBeam);
        let wide = AmclParameters { z_hit: 0.9, z_short: 1.0, lambda_short: 4.0, z_max: 0.7, ..usual };
        let scaled = below_one(wide, 10.0);
        assert!(scaled.z_hit + scaled.z_short * 4.0 + scaled.z_max <= 1.0, "{scaled:?}");
        assert!((scaled.z_hit / scaled.z_max - 9.0 / 7.0).abs() < 0.02, "{scaled:?}");
        let field = AmclParameters { z_hit: 0.3, ..AmclParameters::defaults(AmclKind::AmclLikelihoodField) };
        assert_eq!(below_one(field, 10.0), field);
    }
}
