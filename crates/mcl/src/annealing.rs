use std::convert::Infallible;

use locsim_core::{Draw, Particles, Poses, RangeMap, Stage, WeightError, Weights, wrap_angle};
use rand::RngExt;
use rayon::prelude::*;
use serde::Serialize;

use crate::adaptive::{KldOptions, KldSampler, Lots};
use crate::error::{check, check_sigma};
use crate::resampling::Resampler;
use crate::{Estimate, FilterError, Spread, Systematic};

/// Annealed updates for global localization: a scan is taken in by small powers of its likelihood, with resampling and
/// Metropolis moves between them (the sequential Monte Carlo sampler of Del Moral, Doucet and Jasra, J. Royal
/// Statistical Society B 68(3), 2006; resample-move of Gilks and Berzuini, same journal 63(1), 2001).
///
/// When particles are spread over a map, a sharp likelihood has its peaks between them. Which of several similar places
/// survives then depends on the distance of its nearest particle. In small steps, particles climb to the peaks before
/// the peaks are compared. A scan is taken in by the power that the set bears before the moves; the scans that follow compare
/// the peaks further. Until the set has gathered, it is as large as its spread asks for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AnnealingOptions {
    /// Particles of a global start. The first scan that distinguishes them resamples the set.
    pub candidates: usize,
    /// Each power is the largest that leaves this share of the particles effective, above 0 and below 1.
    pub effective_share: f64,
    /// Metropolis moves of each particle after each power.
    pub moves: usize,
    /// Standard deviations of the smallest moves: about those of a posterior from one scan. The others are 3, 10 and 30 times as
    /// large, up to 0.3 m and 0.3 rad.
    pub step: Spread,
    /// Scans are annealed until the weighted positions have this standard deviation (m), and again from five times it.
    pub gathered_m: f64,
}

impl Default for AnnealingOptions {
    /// 20,000 candidates, half, 4 moves from 1 cm and 5 mrad on, until within 0.2 m: for a laser of some tens of beams with
    /// noise of one to some centimetres.
    fn default() -> Self {
        Self {
            candidates: 20_000,
            effective_share: 0.5,
            moves: 4,
            step: Spread { sigma_m: 0.01, sigma_rad: 0.005 },
            gathered_m: 0.2,
        }
    }
}

/// Least share of the particles that an annealed scan leaves effective, where the filter's options have none: a scan has a say
/// that is as fine as particles are dense.
pub(crate) const LEAST_EFFECTIVE: f64 = 0.02;

/// Moves are scaled by these in turn: to refine, to climb, to cross. How wide a likelihood's peaks are differs by a factor of
/// thirty between sensor models.
const SCALES: [f64; 4] = [1.0, 3.0, 10.0, 30.0];
/// Largest move (m, rad).
const LARGEST_MOVE: f64 = 0.3;
/// Smallest step of the power, so that a set without information about the scan makes headway.
const LEAST_STEP: f64 = 1e-5;
/// Halvings in search of a power: 2^-30 is far below [`LEAST_STEP`].
const HALVINGS: usize = 30;

/// A particle stands for a normal density about it, which is what earlier scans said of its surroundings: about the distance of
/// neighbours where KLD sampling with AMCL's bins leaves ten of them in each.
const KERNEL: Spread = Spread { sigma_m: 0.1, sigma_rad: 0.05 };

/// Anneals scans; its buffers live on between steps.
#[derive(Clone, Debug)]
pub(crate) struct Annealer {
    options: AnnealingOptions,
    /// Number of particles after each power.
    size: KldSampler,
    /// Nothing is known of the robot's pose.
    is_uniform: bool,
    gathered: bool,
    /// Number of resamplings and moves so far, for their draws.
    round: u32,
    /// Number of moves so far, for their scales.
    moves: usize,
    lots: Lots,
    /// Which particle of the set before the scan each one descends from.
    origins: Vec<u32>,
    ancestors: Vec<u32>,
    /// Where each particle was before the scan.
    anchors: Particles,
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
    /// `is_uniform` of a set that is spread evenly over free space; `size` of the set while it is spread.
    pub fn new(options: AnnealingOptions, size: KldOptions, is_uniform: bool) -> Result<Self, FilterError> {
        let share = options.effective_share;
        check("annealing effective share", share, share > 0.0 && share < 1.0, "above 0 and below 1")?;
        options.step.check(["annealing sigma_m", "annealing sigma_rad"])?;
        check_sigma("annealing gathered_m", options.gathered_m)?;
        Ok(Self {
            options,
            size: KldSampler::new(size)?,
            is_uniform,
            gathered: false,
            round: 0,
            moves: 0,
            lots: Lots::default(),
            origins: Vec::new(),
            ancestors: Vec::new(),
            anchors: Particles::default(),
            moved: Particles::default(),
            moved_log_likelihood: Vec::new(),
            scaled: Vec::new(),
        })
    }

    /// The set is spread evenly over free space again.
    pub fn restart(&mut self) {
        self.is_uniform = true;
        self.gathered = false;
    }

    /// Particles of a global start.
    pub fn candidates(&self) -> usize {
        self.options.candidates
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

    /// Takes a scan in by the power `most` of its likelihood, or a little where that is nothing, and leaves as many particles
    /// as their spread asks for. Returns the scan's log evidence (nats) and that power.
    ///
    /// `score` fills in the log likelihoods of poses; at the end they are those of that power.
    pub fn weigh(
        &mut self,
        set: Set<'_>,
        most: f64,
        map: &dyn RangeMap,
        seed: u64,
        mut score: impl FnMut(Poses<'_>, &mut [f64]),
    ) -> Result<(f64, f64), WeightError> {
        let Set { particles, weights, log_likelihood } = set;
        self.origins.clear();
        self.origins.extend(0..particles.len() as u32);
        self.anchors.clone_from(particles);
        let most = most.max(LEAST_STEP);
        let (mut power, mut log_evidence) = (0.0, 0.0);
        while power < most {
            let least = self.options.effective_share * particles.len() as f64;
            let step =
                largest_step(weights, log_likelihood, most - power, least).max(LEAST_STEP).min(most - power);
            self.scaled.clear();
            self.scaled.extend(log_likelihood.iter().map(|l| step * l));
            log_evidence += weights.update(&self.scaled)?;
            power = if step >= most - power { most } else { power + step };
            let enough = weights.effective_sample_size() >= least;
            if power >= most && enough && particles.len() == self.size.least() {
                break;
            }
            self.resample(particles, weights, log_likelihood, seed);
            for _ in 0..self.options.moves {
                self.move_all(particles, log_likelihood, power, map, seed, &mut score);
            }
        }
        self.is_uniform = false;
        for l in log_likelihood.iter_mut() {
            *l *= most;
        }
        Ok((log_evidence, most))
    }

    fn resample(
        &mut self,
        particles: &mut Particles,
        weights: &mut Weights,
        log_likelihood: &mut Vec<f64>,
        seed: u64,
    ) {
        self.round += 1;
        let draw = Draw::new(seed, Stage::Annealing, self.round);
        let count = self.sample_size(particles, weights, &draw);
        Systematic.ancestors(weights, count, &draw, &mut self.ancestors);
        for set in [particles, &mut self.anchors] {
            self.moved.gather(set, &self.ancestors);
            std::mem::swap(set, &mut self.moved);
        }
        let of = |ancestor: &u32| *ancestor as usize;
        *log_likelihood = self.ancestors.iter().map(|a| log_likelihood[of(a)]).collect();
        self.origins = self.ancestors.iter().map(|a| self.origins[of(a)]).collect();
        weights.reset(count);
    }

    /// As many particles as the spread of the weighted ones asks for.
    fn sample_size(&mut self, particles: &Particles, weights: &Weights, draw: &Draw) -> usize {
        self.lots.prepare(weights);
        let mut rng = Draw::new(draw.seed(u32::MAX), Stage::Annealing, self.round).item(0);
        let lots = &self.lots;
        let count: Result<usize, Infallible> = self.size.draw(|| Ok(particles.get(lots.draw(&mut rng))));
        count.unwrap_or_else(|never| match never {})
    }

    /// A Metropolis move of each particle. The stationary distribution is the likelihood's power, restricted to free space,
    /// times what is known from before: nothing, or a normal density about the particle's pose before the scan.
    fn move_all(
        &mut self,
        particles: &mut Particles,
        log_likelihood: &mut [f64],
        power: f64,
        map: &dyn RangeMap,
        seed: u64,
        score: &mut impl FnMut(Poses<'_>, &mut [f64]),
    ) {
        self.round += 1;
        let draw = Draw::new(seed, Stage::Annealing, self.round);
        self.moved.clone_from(particles);
        self.propose(&draw);
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

    /// Proposes a pose for each particle of `moved`.
    fn propose(&mut self, draw: &Draw) {
        let scale = SCALES[self.moves % SCALES.len()];
        self.moves += 1;
        let [sigma_m, sigma_rad] = [self.options.step.sigma_m, self.options.step.sigma_rad]
            .map(|sigma| (scale * sigma).min(LARGEST_MOVE));
        let noise = if self.is_uniform {
            Spread { sigma_m, sigma_rad }
        } else {
            // The preconditioned Crank-Nicolson algorithm (Cotter, Roberts, Stuart and White, Statistical Science 28(3),
            // 2013): drawn towards its anchor by as much as noise moves it away, a particle keeps the normal density.
            let Particles { x, y, theta } = &mut self.moved;
            let [away_m, away_rad] =
                [sigma_m / KERNEL.sigma_m, sigma_rad / KERNEL.sigma_rad].map(|away| away.min(1.0));
            let [keep_m, keep_rad] = [away_m, away_rad].map(|away| (1.0 - away * away).sqrt());
            for (values, anchors) in [(x, &self.anchors.x), (y, &self.anchors.y)] {
                for (value, anchor) in values.iter_mut().zip(anchors) {
                    *value = anchor + keep_m * (*value - anchor);
                }
            }
            for (value, anchor) in theta.iter_mut().zip(&self.anchors.theta) {
                *value = wrap_angle(anchor + keep_rad * wrap_angle(*value - anchor));
            }
            Spread { sigma_m: away_m * KERNEL.sigma_m, sigma_rad: away_rad * KERNEL.sigma_rad }
        };
        noise.add_to(&mut self.moved, draw);
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
