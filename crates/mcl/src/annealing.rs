use locsim_core::{Draw, Particles, Poses, RangeMap, Stage, WeightError, Weights};
use rand::RngExt;
use rayon::prelude::*;
use serde::Serialize;

use crate::error::{check, check_sigma};
use crate::resampling::Resampler;
use crate::{Estimate, FilterError, Spread, Systematic};

/// Annealed updates for global localization: a scan is taken in by small powers of its likelihood, with resampling and
/// Metropolis moves between them (the sequential Monte Carlo sampler of Del Moral, Doucet and Jasra, J. Royal
/// Statistical Society B 68(3), 2006; resample-move of Gilks and Berzuini, same journal 63(1), 2001).
///
/// When particles are spread over a map, a sharp likelihood has its peaks between them. Which of several similar places
/// survives then depends on the distance of its nearest particle. In small steps, particles climb to the peaks before
/// the peaks are compared. Each scan costs some hundred weighings of the set, until the set has gathered.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AnnealingOptions {
    /// Particles of a global start. The first scan that distinguishes them resamples the set to the filter's count.
    pub candidates: usize,
    /// Each power is the largest that leaves this share of the count as effective sample size, above 0 and below 1.
    pub effective_share: f64,
    /// Metropolis moves of each particle after each power.
    pub moves: usize,
    /// Standard deviations of a move under the whole likelihood: about those of a posterior from one scan. Under smaller
    /// powers moves are larger, up to 0.3 m and 0.3 rad.
    pub step: Spread,
    /// Scans are annealed until the weighted positions have this standard deviation (m), and again from five times it.
    pub gathered_m: f64,
}

impl Default for AnnealingOptions {
    /// 20,000 candidates, nine tenths, 12 moves of 1 cm and 5 mrad, until within 0.2 m: for a laser of some tens of beams with
    /// noise of one to some centimetres.
    fn default() -> Self {
        Self {
            candidates: 20_000,
            effective_share: 0.9,
            moves: 12,
            step: Spread { sigma_m: 0.01, sigma_rad: 0.005 },
            gathered_m: 0.2,
        }
    }
}

/// Moves are scaled by these in turn: to refine, to climb, to cross.
const SCALES: [f64; 3] = [1.0, 0.3, 2.0];
/// Largest move (m, rad).
const LARGEST_MOVE: f64 = 0.3;
/// Smallest step of the power, so that a set without information about the scan makes headway.
const LEAST_STEP: f64 = 1e-5;
/// Halvings in search of a power: 2^-30 is far below [`LEAST_STEP`].
const HALVINGS: usize = 30;

/// Anneals scans; its buffers live on between steps.
#[derive(Clone, Debug)]
pub(crate) struct Annealer {
    options: AnnealingOptions,
    gathered: bool,
    /// Number of resamplings and moves so far, for their draws.
    round: u32,
    /// Which particle of the set before the scan each one descends from.
    origins: Vec<u32>,
    ancestors: Vec<u32>,
    moved: Particles,
    moved_log_likelihood: Vec<f64>,
    scaled: Vec<f64>,
}

/// The particle set that is annealed, with its weights and buffers.
pub(crate) struct Set<'a> {
    pub particles: &'a mut Particles,
    pub weights: &'a mut Weights,
    /// Log likelihood of the scan for each particle (nats); kept up to date.
    pub log_likelihood: &'a mut Vec<f64>,
}

impl Annealer {
    pub fn new(options: AnnealingOptions) -> Result<Self, FilterError> {
        let share = options.effective_share;
        check("annealing effective share", share, share > 0.0 && share < 1.0, "above 0 and below 1")?;
        options.step.check(["annealing sigma_m", "annealing sigma_rad"])?;
        check_sigma("annealing gathered_m", options.gathered_m)?;
        Ok(Self {
            options,
            gathered: false,
            round: 0,
            origins: Vec::new(),
            ancestors: Vec::new(),
            moved: Particles::default(),
            moved_log_likelihood: Vec::new(),
            scaled: Vec::new(),
        })
    }

    /// Whether the next scan is to be annealed.
    pub fn is_due(&self) -> bool {
        !self.gathered
    }

    /// Which particle of the set before the scan each one descends from.
    pub fn origins(&self) -> &[u32] {
        &self.origins
    }

    /// Updates the decision for the next scan by the estimate of this step.
    pub fn observe(&mut self, estimate: &Estimate) {
        let deviation = (estimate.covariance[0][0] + estimate.covariance[1][1]).sqrt();
        let bound = self.options.gathered_m * if self.gathered { 5.0 } else { 1.0 };
        self.gathered = deviation <= bound;
    }

    /// Takes a scan in and leaves `count` particles. Returns the scan's log evidence (nats).
    ///
    /// `score` fills in the log likelihoods of poses.
    pub fn weigh(
        &mut self,
        set: Set<'_>,
        count: usize,
        map: &dyn RangeMap,
        seed: u64,
        mut score: impl FnMut(Poses<'_>, &mut [f64]),
    ) -> Result<f64, WeightError> {
        let Set { particles, weights, log_likelihood } = set;
        self.origins.clear();
        self.origins.extend(0..particles.len() as u32);
        let least = self.options.effective_share * count as f64;
        let (mut power, mut log_evidence) = (0.0, 0.0);
        while power < 1.0 {
            let step =
                largest_step(weights, log_likelihood, 1.0 - power, least).max(LEAST_STEP).min(1.0 - power);
            self.scaled.clear();
            self.scaled.extend(log_likelihood.iter().map(|l| step * l));
            log_evidence += weights.update(&self.scaled)?;
            power = if step >= 1.0 - power { 1.0 } else { power + step };
            let enough = weights.effective_sample_size() >= least;
            if power >= 1.0 && enough && particles.len() == count {
                break;
            }
            self.resample(particles, weights, log_likelihood, count, seed);
            for kind in 0..self.options.moves {
                let scale = SCALES[kind % SCALES.len()] / power.sqrt();
                self.move_all(particles, log_likelihood, power, scale, map, seed, &mut score);
            }
        }
        Ok(log_evidence)
    }

    fn resample(
        &mut self,
        particles: &mut Particles,
        weights: &mut Weights,
        log_likelihood: &mut Vec<f64>,
        count: usize,
        seed: u64,
    ) {
        self.round += 1;
        Systematic.ancestors(
            weights,
            count,
            &Draw::new(seed, Stage::Annealing, self.round),
            &mut self.ancestors,
        );
        self.moved.gather(particles, &self.ancestors);
        std::mem::swap(particles, &mut self.moved);
        let of = |ancestor: &u32| *ancestor as usize;
        *log_likelihood = self.ancestors.iter().map(|a| log_likelihood[of(a)]).collect();
        self.origins = self.ancestors.iter().map(|a| self.origins[of(a)]).collect();
        weights.reset(count);
    }

    /// A Metropolis move of each particle. The likelihood's power, restricted to free space, is its stationary
    /// distribution.
    #[expect(clippy::too_many_arguments, reason = "the parts of one set and of one move")]
    fn move_all(
        &mut self,
        particles: &mut Particles,
        log_likelihood: &mut [f64],
        power: f64,
        scale: f64,
        map: &dyn RangeMap,
        seed: u64,
        score: &mut impl FnMut(Poses<'_>, &mut [f64]),
    ) {
        self.round += 1;
        let draw = Draw::new(seed, Stage::Annealing, self.round);
        let largest = |sigma: f64| (scale * sigma).min(LARGEST_MOVE);
        self.moved.clone_from(particles);
        let Spread { sigma_m, sigma_rad } = self.options.step;
        let step = Spread { sigma_m: largest(sigma_m), sigma_rad: largest(sigma_rad) };
        step.add_to(&mut self.moved, &draw);
        self.moved_log_likelihood.resize(particles.len(), 0.0);
        score(self.moved.as_poses(), &mut self.moved_log_likelihood);
        let decide = Draw::new(draw.seed(u32::MAX), Stage::Annealing, self.round);
        let (moved, there) = (&self.moved, &self.moved_log_likelihood);
        let Particles { x, y, theta } = particles;
        (x, y, theta, log_likelihood).into_par_iter().enumerate().for_each(|(i, (x, y, theta, here))| {
            let u: f64 = decide.item(i as u32).random();
            // False where neither place is possible.
            let accepted = u.ln() < power * (there[i] - *here) && map.is_free(moved.x[i], moved.y[i]);
            if accepted {
                (*x, *y, *theta, *here) = (moved.x[i], moved.y[i], moved.theta[i], there[i]);
            }
        });
    }
}

/// The largest step of the power, up to `most`, that leaves an effective sample size of `least`.
pub(crate) fn largest_step(weights: &Weights, log_likelihood: &[f64], most: f64, least: f64) -> f64 {
    let effective = |step: f64| {
        let log = || weights.log().zip(log_likelihood).map(|(w, l)| w + step * l);
        let highest = log().fold(f64::NEG_INFINITY, f64::max);
        let (sum, squares) = log().fold((0.0, 0.0), |(sum, squares), l| {
            let w = (l - highest).exp();
            (sum + w, squares + w * w)
        });
        sum * sum / squares
    };
    if effective(most) >= least {
        return most;
    }
    let (mut lower, mut upper) = (0.0, most);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (lower + upper);
        if effective(middle) >= least { lower = middle } else { upper = middle }
    }
    lower
}
