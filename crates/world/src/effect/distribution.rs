use std::f64::consts::TAU;

use arrayvec::ArrayVec;
use locsim_core::normal;
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

use super::EffectError;
use crate::options::LaserOptions;

/// How much wider than the base the tail of a reading is.
pub const TAIL_FACTOR: f64 = 5.0;

/// Steps of at most this share of a standard deviation are fine: the density hardly bends within one; see
/// [`ReadingDistribution::density_parts`].
const FINE_STEP: f64 = 0.5;

/// A normal number is hardly this many standard deviations below its mean: once in 10^19 draws.
const SURELY: f64 = 9.0;

/// The most alternatives of a distribution.
const MAX_ALTERNATIVES: usize = 12;

/// The distribution of a reading, given what the beam met: the one definition that [`ReadingDistribution::sample`] draws from
/// and [`ReadingDistribution::log_density`] tells the density of.
///
/// 1. The alternatives are tried in their order, each with its probability; the first that comes true is what is
///    read.
/// 2. Where none does, the reading is normal around `mean`, with a standard deviation of `sigma`, or with
///    probability `tail[0]` of `tail[1]` times that.
/// 3. With a step, the reading is rounded to the nearest multiple of it.
/// 4. At or beyond the maximum range it is exactly the maximum range; below the minimum it is NaN, not usable.
///
/// A reading that isn't usable tells nothing, so density and distribution function are those of a usable one:
/// conditioned on not being below the minimum range.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadingDistribution {
    /// Mean of the return \[m\]; infinite where nothing is met.
    pub mean: f64,
    /// Standard deviation of the return \[m\].
    pub sigma: f64,
    /// Probability of the tail, and its standard deviation in units of `sigma`.
    pub tail: [f64; 2],
    /// Alternatives to the return.
    pub alternatives: Alternatives,
    /// Readings are multiples of this \[m\]; 0 for readings that aren't quantized.
    pub step_m: f64,
    /// Minimum range \[m\], as the laser's f32 has it.
    pub min_m: f64,
    /// Maximum range \[m\], as the laser's f32 has it.
    pub max_m: f64,
}

/// Alternatives to the return.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Alternative {
    /// The maximum range.
    NoReturn,
    /// The return of something else.
    Near {
        /// Its mean \[m\].
        mean: f64,
        /// Its standard deviation \[m\].
        sigma: f64,
    },
    /// Uniform.
    Between {
        /// From here \[m\].
        lo: f64,
        /// To here \[m\].
        hi: f64,
    },
}

/// Alternatives with their probabilities, in the order in which they are tried; a list of fixed capacity.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Alternatives(ArrayVec<(f64, Alternative), MAX_ALTERNATIVES>);

impl Alternatives {
    /// Refuses more alternatives than there is room for beside `reserved` ones.
    pub(super) fn check(count: usize, reserved: usize) -> Result<(), EffectError> {
        let max = MAX_ALTERNATIVES - reserved;
        if count <= max { Ok(()) } else { Err(EffectError::TooMany { count, max }) }
    }

    /// Adds what is tried after all others; nothing for a probability of 0.
    pub(super) fn push(&mut self, probability: f64, alternative: Alternative) {
        if probability > 0.0 {
            self.0.push((probability, alternative));
        }
    }

    /// Probability of each, given that none before it came true, and what it is.
    pub fn as_slice(&self) -> &[(f64, Alternative)] {
        &self.0
    }
}

/// A part of the distribution's mixture.
#[derive(Clone, Copy)]
enum Component {
    NoReturn,
    Normal { mean: f64, sigma: f64 },
    Between { lo: f64, hi: f64 },
}

/// The density or the probability of a reading, by what was read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Parts {
    /// Of the return.
    pub returned: f64,
    /// Of the alternatives.
    pub alternatives: f64,
    /// Probability that none of the alternatives is read.
    pub rest: f64,
}

impl Parts {
    /// Of whatever was read.
    pub fn total(&self) -> f64 {
        self.alternatives + self.returned
    }
}

impl ReadingDistribution {
    /// That of a beam which meets nothing.
    pub(crate) fn nothing(laser: &LaserOptions) -> Self {
        Self {
            mean: f64::INFINITY,
            sigma: 0.0,
            tail: [0.0, TAIL_FACTOR],
            alternatives: Alternatives::default(),
            step_m: laser.resolution_m,
            min_m: f64::from(laser.min_range_m as f32),
            max_m: f64::from(laser.max_range_m as f32),
        }
    }

    /// A draw. `noise` gives the standard normal number of the return, as its first and only draw; `chance` decides
    /// everything else.
    pub fn sample(&self, noise: &mut impl Rng, chance: &mut impl Rng) -> f32 {
        let value = match self.replacement(noise, chance) {
            Some(replacement) => replacement,
            None => self.mean + self.spread(chance) * standard_normal(noise),
        };
        self.read(value)
    }

    /// A draw for a beam that was read before: `reading` has noise of standard deviation `sigma` \[m\] and steps of `step_m`, and
    /// the mean is that reading as effects shift it. The noise that it lacks is added. What nothing changes stays as it is, bit for
    /// bit. `noise` and `chance` are as in [`ReadingDistribution::sample`].
    pub(crate) fn sample_again(
        &self,
        (reading, sigma, step_m): (f32, f64, f64),
        noise: &mut impl Rng,
        chance: &mut impl Rng,
    ) -> f32 {
        if let Some(replacement) = self.replacement(noise, chance) {
            return self.read(replacement);
        }
        let spread = self.spread(chance);
        let lacking = (spread * spread - sigma * sigma).max(0.0).sqrt();
        let value = self.mean + lacking * standard_normal(noise);
        if value == f64::from(reading) && self.step_m <= step_m { reading } else { self.read(value) }
    }

    /// The value of the first alternative that comes true.
    fn replacement(&self, noise: &mut impl Rng, chance: &mut impl Rng) -> Option<f64> {
        for &(probability, alternative) in self.alternatives.as_slice() {
            if chance.random::<f64>() < probability {
                return Some(match alternative {
                    Alternative::NoReturn => f64::INFINITY,
                    Alternative::Near { mean, sigma } => mean + sigma * standard_normal(noise),
                    Alternative::Between { lo, hi } => lo + (hi - lo) * chance.random::<f64>(),
                });
            }
        }
        None
    }

    /// The standard deviation of the return, in the tail or not.
    fn spread(&self, chance: &mut impl Rng) -> f64 {
        let [p, factor] = self.tail;
        let wide = p > 0.0 && chance.random::<f64>() < p;
        if wide { factor * self.sigma } else { self.sigma }
    }

    fn read(&self, noisy: f64) -> f32 {
        as_read(noisy, self.step_m, self.min_m as f32, self.max_m as f32)
    }

    /// Natural log of the density of a usable reading: per metre below the maximum range, a probability at it; 0 for
    /// NaN, which tells nothing.
    ///
    /// Quantized readings have, at the multiples of the step, the probability of that multiple over the step, and
    /// everywhere else a density of 0. Where a standard deviation is 0 and readings aren't quantized there is no
    /// density: it is infinite at the mean.
    pub fn log_density(&self, z: f32) -> f64 {
        if z.is_nan() {
            return 0.0;
        }
        if z < self.min_m as f32 {
            return f64::NEG_INFINITY;
        }
        let [lo, hi] = self.limits();
        let usable = self.ln_interval(lo, f64::INFINITY);
        if usable == f64::NEG_INFINITY {
            return usable;
        }
        let ln = if z >= self.max_m as f32 {
            self.ln_interval(hi, f64::INFINITY)
        } else if self.step_m > 0.0 {
            let Some(k) = self.multiple(z) else { return f64::NEG_INFINITY };
            self.ln_interval((k - 0.5) * self.step_m, (k + 0.5) * self.step_m) - self.step_m.ln()
        } else {
            self.ln_sum(|component| component.ln_density(f64::from(z)))
        };
        ln - usable
    }

    /// The density of a usable reading, see [`ReadingDistribution::log_density`]; 1 for NaN.
    pub fn density(&self, z: f32) -> f64 {
        self.log_density(z).exp()
    }

    /// P(reading <= `z`) of a usable reading, 1 at the maximum range; NaN for NaN.
    pub fn cdf(&self, z: f32) -> f64 {
        if z.is_nan() {
            return f64::NAN;
        }
        if z >= self.max_m as f32 {
            return 1.0;
        }
        if z < self.min_m as f32 {
            return 0.0;
        }
        let [lo, hi] = self.limits();
        let to = if self.step_m > 0.0 {
            let k = self.multiple(z).unwrap_or_else(|| (f64::from(z) / self.step_m).floor());
            (k + 0.5) * self.step_m
        } else {
            f64::from(z)
        }
        .min(hi);
        if to <= lo {
            return 0.0;
        }
        // Between adds up to 1 only up to rounding.
        (self.ln_interval(lo, to) - self.ln_interval(lo, f64::INFINITY)).exp().clamp(0.0, 1.0)
    }

    /// The density of a reading `z` \[m\] from the minimum range on, before it is known to be usable, and the probability that it
    /// is usable, both by their parts: the first total over the second is the fast form of [`ReadingDistribution::density`].
    ///
    /// A quantized reading has to be a multiple of the step. Steps of at most [`FINE_STEP`] standard deviations have the normal
    /// density at their middle instead of their probability over the step: at t standard deviations that is too little by a
    /// relative (t^2 - 1) / 24 times the square of the step in standard deviations.
    ///
    /// `limits` are [`ReadingDistribution::limits`].
    #[inline]
    pub(crate) fn density_parts(&self, limits: [f64; 2], z: f64) -> [Parts; 2] {
        let (step, [min, max]) = (self.step_m, limits);
        if z >= self.max_m {
            self.parts(|component| [component.at_least(max), component.at_least(min)])
        } else if step > 0.0 {
            self.parts(|component| [component.over_step(z, step), component.at_least(min)])
        } else {
            self.parts(|component| [component.density(z), component.at_least(min)])
        }
    }

    /// P(value before rounding < `x`), the same for every step and also of values that aren't usable, and the probability that a
    /// reading is usable, both by their parts. `limits` are [`ReadingDistribution::limits`].
    #[inline]
    pub(crate) fn below(&self, [min, _]: [f64; 2], x: f64) -> [Parts; 2] {
        self.parts(|component| [component.below(x), component.at_least(min)])
    }

    /// The factor that turns a density of `z` \[m\] per metre into one that can be compared with that of a distribution with
    /// steps of `grid_m`: a coarser step gathers the probability of several. Readings at the maximum range are no multiples.
    #[inline]
    pub(crate) fn on_grid(&self, z: f64, grid_m: f64) -> f64 {
        // Rounded up: the same step from text is the same step.
        if self.step_m <= 1.000_001 * grid_m || z >= self.max_m {
            return 1.0;
        }
        let steps = z / self.step_m;
        let is_multiple = (steps - steps.round()).abs() * self.step_m < 0.5 * grid_m;
        if is_multiple { self.step_m / grid_m } else { 0.0 }
    }

    /// Sums over the mixture of weight times each value of `of`.
    #[inline]
    fn parts(&self, of: impl Fn(Component) -> [f64; 2]) -> [Parts; 2] {
        let (mut alternatives, mut rest) = ([0.0; 2], 1.0);
        for &(probability, alternative) in self.alternatives.as_slice() {
            let weight = rest * probability;
            let values = of(alternative.into());
            alternatives = [0, 1].map(|i| alternatives[i] + weight * values[i]);
            rest -= weight;
        }
        let [tail, factor] = self.tail;
        let of_return = |sigma| of(Component::Normal { mean: self.mean, sigma });
        let mut returned = of_return(self.sigma);
        if tail > 0.0 {
            let wide = of_return(factor * self.sigma);
            returned = [0, 1].map(|i| (1.0 - tail) * returned[i] + tail * wide[i]);
        }
        [0, 1].map(|i| Parts { returned: rest * returned[i], alternatives: alternatives[i], rest })
    }

    /// Which multiple of the step a reading is; `None` for one between two of them. Readings may be a few units in
    /// the last place off, as those that have been text.
    fn multiple(&self, z: f32) -> Option<f64> {
        let z = f64::from(z);
        let k = (z / self.step_m).round();
        ((k * self.step_m - z).abs() <= 4.0 * f64::from(f32::EPSILON) * z).then_some(k)
    }

    /// Before rounding: from where on a reading is usable, and from where on it is the maximum range \[m\].
    pub(crate) fn limits(&self) -> [f64; 2] {
        [self.min_m, self.max_m].map(|limit| least_value(limit, self.step_m))
    }

    /// ln P(`from` <= reading before rounding < `to`).
    fn ln_interval(&self, from: f64, to: f64) -> f64 {
        self.ln_sum(|component| component.ln_interval(from, to))
    }

    /// ln of the sum over the mixture of weight times exp(`ln`).
    fn ln_sum(&self, ln: impl Fn(Component) -> f64) -> f64 {
        let mut terms = [f64::NEG_INFINITY; MAX_ALTERNATIVES + 2];
        let mut len = 0;
        let mut add = |weight: f64, component: Component| {
            if weight > 0.0 {
                terms[len] = weight.ln() + ln(component);
                len += 1;
            }
        };
        let mut left = 1.0;
        for &(probability, alternative) in self.alternatives.as_slice() {
            add(left * probability, alternative.into());
            left *= 1.0 - probability;
        }
        let [p, factor] = self.tail;
        add(left * (1.0 - p), Component::Normal { mean: self.mean, sigma: self.sigma });
        add(left * p, Component::Normal { mean: self.mean, sigma: factor * self.sigma });
        let terms = &terms[..len];
        let greatest = terms.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if greatest.is_infinite() {
            return greatest;
        }
        greatest + terms.iter().map(|term| (term - greatest).exp()).sum::<f64>().ln()
    }
}

impl Alternative {
    /// Density of a reading `z` \[m\] that isn't quantized \[1/m\], a probability at the maximum range `max` \[m\].
    pub fn density(self, z: f64, max: f64) -> f64 {
        let component = Component::from(self);
        if z >= max { component.at_least(max) } else { component.density(z) }
    }
}

impl From<Alternative> for Component {
    #[inline]
    fn from(alternative: Alternative) -> Self {
        match alternative {
            Alternative::NoReturn => Self::NoReturn,
            Alternative::Near { mean, sigma } => Self::Normal { mean, sigma },
            Alternative::Between { lo, hi } if hi <= lo => Self::Normal { mean: lo, sigma: 0.0 },
            Alternative::Between { lo, hi } => Self::Between { lo, hi },
        }
    }
}

impl Component {
    /// P(value >= `x`).
    #[inline]
    fn at_least(self, x: f64) -> f64 {
        match self {
            Self::NoReturn => 1.0,
            Self::Normal { mean, sigma } if mean - SURELY * sigma > x => 1.0,
            Self::Normal { mean, sigma: 0.0 } => f64::from(u8::from(mean >= x)),
            Self::Normal { mean, sigma } => normal::tail((x - mean) / sigma),
            Self::Between { lo, hi } => ((hi - x) / (hi - lo)).clamp(0.0, 1.0),
        }
    }

    /// Density at `z` \[1/m\].
    #[inline]
    fn density(self, z: f64) -> f64 {
        match self {
            Self::NoReturn => 0.0,
            Self::Normal { mean, sigma: 0.0 } => {
                if z == mean {
                    f64::INFINITY
                } else {
                    0.0
                }
            }
            // 0 where the mean is infinite.
            Self::Normal { mean, sigma } => normal::density((z - mean) / sigma) / sigma,
            Self::Between { lo, hi } => {
                if (lo..hi).contains(&z) {
                    1.0 / (hi - lo)
                } else {
                    0.0
                }
            }
        }
    }

    /// Probability of the values that are rounded to `middle`, a multiple of `step`, over the step \[1/m\].
    #[inline]
    fn over_step(self, middle: f64, step: f64) -> f64 {
        let around = || {
            let multiple = (middle / step).round() * step;
            [multiple - 0.5 * step, multiple + 0.5 * step]
        };
        match self {
            Self::Normal { mean, sigma } if step > FINE_STEP * sigma && mean.is_finite() => {
                let [from, to] = around();
                if sigma == 0.0 {
                    f64::from(u8::from((from..to).contains(&mean))) / step
                } else {
                    normal_interval((from - mean) / sigma, (to - mean) / sigma) / step
                }
            }
            Self::NoReturn | Self::Normal { .. } => self.density(middle),
            Self::Between { lo, hi } => {
                let half = 0.5 * step;
                if middle - half >= lo && middle + half <= hi {
                    return 1.0 / (hi - lo);
                }
                let [from, to] = around();
                (to.min(hi) - from.max(lo)).max(0.0) / (step * (hi - lo))
            }
        }
    }

    /// P(value < `x`).
    #[inline]
    fn below(self, x: f64) -> f64 {
        match self {
            Self::NoReturn => 0.0,
            Self::Normal { mean, .. } if mean.is_infinite() => 0.0,
            Self::Normal { mean, sigma } if mean - SURELY * sigma > x => 0.0,
            Self::Normal { mean, sigma: 0.0 } => f64::from(u8::from(mean < x)),
            Self::Normal { mean, sigma } => normal::cdf((x - mean) / sigma),
            Self::Between { lo, hi } => ((x - lo) / (hi - lo)).clamp(0.0, 1.0),
        }
    }

    fn ln_density(self, z: f64) -> f64 {
        match self {
            Self::NoReturn => f64::NEG_INFINITY,
            Self::Normal { mean, sigma } => {
                if sigma == 0.0 {
                    return if z == mean { f64::INFINITY } else { f64::NEG_INFINITY };
                }
                let t = (z - mean) / sigma;
                -0.5 * t * t - (sigma * TAU.sqrt()).ln()
            }
            Self::Between { lo, hi } => {
                if (lo..hi).contains(&z) {
                    -(hi - lo).ln()
                } else {
                    f64::NEG_INFINITY
                }
            }
        }
    }

    /// ln P(`from` <= value < `to`).
    fn ln_interval(self, from: f64, to: f64) -> f64 {
        let certain = |inside: bool| if inside { 0.0 } else { f64::NEG_INFINITY };
        match self {
            Self::NoReturn => certain(to == f64::INFINITY),
            Self::Normal { mean, .. } if mean.is_infinite() => certain(to == f64::INFINITY),
            Self::Normal { mean, sigma: 0.0 } => certain((from..to).contains(&mean)),
            Self::Normal { mean, sigma } => ln_normal_interval((from - mean) / sigma, (to - mean) / sigma),
            Self::Between { lo, hi } => ((to.clamp(lo, hi) - from.clamp(lo, hi)) / (hi - lo)).ln(),
        }
    }
}

/// The least value before rounding to multiples of `step` (0: not rounded) whose reading is at least `limit` \[m\], an f32.
pub(crate) fn least_value(limit: f64, step: f64) -> f64 {
    if step == 0.0 {
        return limit;
    }
    // A multiple is read as an f32, which may be the limit itself where the multiple is a little below it.
    let next = (limit / step).ceil();
    let reaches = |k: f64| (k * step) as f32 >= limit as f32;
    let multiple = [next - 1.0, next].into_iter().find(|&k| reaches(k)).unwrap_or(next + 1.0);
    (multiple - 0.5) * step
}

/// Value that a sensor reports for a return: rounded to a multiple of `step` (0: not rounded), exactly the maximum range at or
/// beyond it, NaN below the minimum.
pub(crate) fn as_read(noisy: f64, step: f64, min: f32, max: f32) -> f32 {
    let reading = (if step > 0.0 { (noisy / step).round() * step } else { noisy }) as f32;
    if reading < min { f32::NAN } else { reading.min(max) }
}

fn standard_normal(noise: &mut impl Rng) -> f64 {
    StandardNormal.sample(noise)
}

/// P(`a` <= N(0, 1) < `b`), exact in both tails.
fn normal_interval(a: f64, b: f64) -> f64 {
    // By symmetry on the side where tails are small numbers, whose difference is exact.
    let (a, b) = if b <= 0.0 { (-b, -a) } else { (a, b) };
    normal::tail(a) - normal::tail(b)
}

/// ln P(`a` <= N(0, 1) < `b`), also where the probability itself would vanish.
fn ln_normal_interval(a: f64, b: f64) -> f64 {
    let (a, b) = if b <= 0.0 { (-b, -a) } else { (a, b) };
    if a < 30.0 {
        return normal_interval(a, b).ln();
    }
    // Q(a) = phi(a) / a up to a relative 1 / a^2; towards b the density falls as exp(-a t - t^2 / 2).
    let width = b - a;
    let share = -(-width * (a + 0.5 * width)).exp_m1();
    -0.5 * a * a - (a * TAU.sqrt()).ln() + share.ln()
}
