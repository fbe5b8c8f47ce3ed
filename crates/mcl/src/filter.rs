use std::f64::consts::PI;
use std::fmt;
use std::sync::Arc;

use locsim_core::{Draw, Laser, Particles, Pose2, RangeMap, Scan, SensorModel, Stage, WeightError, Weights};
use rand::RngExt;
use serde::Serialize;

use crate::adaptive::{KldOptions, KldSampler, Lots};
use crate::ancestry::{Ancestry, NO_PARENT};
use crate::annealing::{Annealer, AnnealingOptions, LEAST_EFFECTIVE, Set, largest_step};
use crate::augmented::{Augmented, InjectionOptions};
use crate::bins::PoseBins;
use crate::error::{FilterError, check};
use crate::estimate::{Cluster, Clusters, Estimate, max_weight, weighted_mean};
use crate::motion::MotionModel;
use crate::resampling::Resampler;
use crate::spread::Spread;
use crate::start::{Start, free_pose};
use crate::update_threshold::UpdateThreshold;
use crate::weigh::Weigher;

/// How many particles a filter has.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum ParticleCount {
    /// Always the same number, at least 1.
    Fixed(usize),
    /// As many as the spread of the posterior asks for, chosen anew at each resampling.
    Kld(KldOptions),
}

/// When a filter resamples. A step that injects random particles always resamples.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum ResampleTrigger {
    /// At the end of each step.
    EachStep,
    /// When the effective sample size is below this share of the particle count, from 0 to 1.
    EffectiveShareBelow(f64),
}

/// Bins and error by which a filter with a fixed number of particles has more while scans are annealed: AMCL's.
const SPREAD: KldOptions =
    KldOptions { min: 1, max: 20_000, error: 0.05, quantile: 0.99, bin_m: 0.5, bin_rad: PI / 18.0 };

/// Options of a filter.
#[derive(Clone, Debug)]
pub struct FilterOptions {
    /// Number of particles.
    pub particles: ParticleCount,
    /// How the robot moves.
    pub motion: Arc<dyn MotionModel>,
    /// How far the robot moves before [`Filter::step`] takes another scan in; `None` takes every scan in. [`Filter::update`] takes in
    /// whatever it is given.
    pub update: Option<UpdateThreshold>,
    /// Chooses the particles that survive.
    pub resampler: Arc<dyn Resampler>,
    /// When to resample.
    pub trigger: ResampleTrigger,
    /// Random particles for recovery, `None` for none.
    pub injection: Option<InjectionOptions>,
    /// Gaussian jitter of the resampled particles, which keeps copies of one ancestor apart (the regularized particle
    /// filter of Musso, Oudjane and Le Gland 2001, with a bandwidth of the user's choice); `None` for none.
    pub regularization: Option<Spread>,
    /// A scan that would leave fewer effective particles than this share of their count is taken in by the largest power of its
    /// likelihood that leaves as many, above 0 and below 1; `None` takes every scan in whole that isn't annealed. A handful of
    /// particles has hardly a covariance, and where the motion noise or the map is wrong, a few scans would leave no more.
    pub least_effective_share: Option<f64>,
    /// Bins for the cluster estimate, `None` to do without it.
    pub clusters: Option<PoseBins>,
    /// Annealed updates while the particles are spread, `None` for plain ones.
    pub annealing: Option<AnnealingOptions>,
    /// Whether to keep the history that the most likely trajectory is read from.
    pub ancestry: bool,
}

/// The inputs of a filter step.
#[derive(Clone, Copy, Debug)]
pub struct StepInput<'a> {
    /// Motion since the last step by odometry, `base_prev_from_base_now`; the identity at the first step.
    pub odometry: Pose2,
    /// The sensor.
    pub laser: &'a Laser,
    /// Its sweep at the end of that motion. NaN readings are ignored.
    pub scan: &'a Scan,
}

/// Recovery from a scan that Bayes' rule can't use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Recovery {
    /// Every particle had likelihood zero. The observation was dropped and the weights were made equal; the
    /// step does not resample, unless it injects random particles.
    WeightsReset,
}

impl fmt::Display for Recovery {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::WeightsReset => f.write_str("every particle had likelihood zero: weights made equal"),
        }
    }
}

/// The filter's answers to "where is the robot?" from one weighted particle set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimates {
    /// Weighted mean, circular for the heading, and covariance.
    pub weighted_mean: Estimate,
    /// The particle of the greatest weight.
    pub max_weight: Pose2,
    /// The heaviest cluster, if the options ask for it.
    pub densest_cluster: Option<Cluster>,
}

/// The outcome of a filter step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepOutcome {
    /// `ln p(z_t | z_1..t-1)` (nats), the log of the weighted mean likelihood of the whole scan, whatever power of it was taken in;
    /// minus infinity if all were zero, 0 of a scan that was left out.
    pub log_evidence: f64,
    /// 1 / sum of squared weights, after weighting and before resampling.
    pub effective_sample_size: f64,
    /// Power of the scan's likelihood that was taken in: 1 of a whole scan, less where
    /// [`FilterOptions::least_effective_share`] or [`FilterOptions::annealing`] cut it, 0 of one that
    /// [`FilterOptions::update`] left out, or that has no usable reading.
    pub likelihood_power: f64,
    /// Number of particles that were weighted.
    pub particle_count: usize,
    /// Whether the step ended with a resampling.
    pub resampled: bool,
    /// Number of random particles in the next step's set.
    pub injected: usize,
    /// A recovery, where one was needed.
    pub recovered: Option<Recovery>,
    /// Estimates from the weighted set, before resampling.
    pub estimates: Estimates,
}

/// The outcome of an update.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Update {
    /// `ln p(z_t | z_1..t-1)` (nats), as in [`StepOutcome`].
    pub log_evidence: f64,
    /// Power of the scan's likelihood that was taken in, as in [`StepOutcome`].
    pub likelihood_power: f64,
    /// A recovery, where one was needed.
    pub recovered: Option<Recovery>,
    /// Estimates from the weighted set.
    pub estimates: Estimates,
}

/// A particle filter that localizes a robot with a planar range sensor in a known map (Probabilistic Robotics,
/// table 8.2).
///
/// [`Filter::step`] is [`Filter::predict`], [`Filter::update`] and a resampling by the options' rules.
/// Between steps [`Filter::particles`] and [`Filter::weights`] are the posterior as it was weighted; a resampling
/// that the step decided on takes effect when the next step begins. Callers who decide themselves call these one by one, and
/// [`Filter::resample`].
#[derive(Clone, Debug)]
pub struct Filter {
    options: FilterOptions,
    seeds: Seeds,
    step: u32,
    phase: Phase,
    particles: Arc<Particles>,
    weights: Arc<Weights>,
    /// The resampled set, valid if `pending`.
    next: Arc<Particles>,
    ancestors: Vec<u32>,
    /// Whether the last decision was to resample.
    resampled: bool,
    /// `next` waits to take the place of `particles`.
    pending: bool,
    /// `particles` descend from `ancestors` of the generation that was last weighted.
    descended: bool,
    /// Motion by odometry since a scan was taken in; `None` where the next one is due.
    moved: Option<Pose2>,
    /// Share of random particles in the next set, by the last update.
    random_share: f64,
    log_likelihood: Arc<Vec<f64>>,
    weigher: Weigher,
    /// Number of particles, the greatest where it varies.
    count: usize,
    kld: Option<KldSampler>,
    /// For KLD sampling.
    lots: Lots,
    augmented: Option<Augmented>,
    annealer: Option<Annealer>,
    clusters: Option<Clusters>,
    ancestry: Option<Ancestry>,
    /// Parents of annealed particles, for the history.
    parents: Vec<u32>,
}

/// The largest power of a likelihood, at most 1, that leaves `share` of the particles effective; half of those that already are,
/// where these are too few.
fn bearable_power(weights: &Weights, log_likelihood: &[f64], share: f64) -> f64 {
    let least = (share * log_likelihood.len() as f64).min(0.5 * weights.effective_sample_size());
    largest_step(weights, log_likelihood, 1.0, least)
}

/// Scales log likelihoods by a power below 1.
fn temper(log_likelihood: &mut [f64], power: f64) {
    if power < 1.0 {
        // A power of 0 would make a number of what is impossible.
        log_likelihood.iter_mut().filter(|l| l.is_finite()).for_each(|l| *l *= power);
    }
}

/// How far a step has come: what it draws next must not be what it has drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// It has drawn nothing.
    Begun,
    /// It has drawn its motion.
    Predicted,
    /// It has decided whether to resample.
    Decided,
}

/// The stage [`Stage::Resample`] serves three purposes, each with a seed of its own.
#[derive(Clone, Copy, Debug)]
struct Seeds {
    filter: u64,
    ancestors: u64,
    sample_size: u64,
    jitter: u64,
}

impl Seeds {
    fn new(seed: u64) -> Self {
        let resample = Draw::new(seed, Stage::Resample, 0);
        Self {
            filter: seed,
            ancestors: resample.seed(0),
            sample_size: resample.seed(1),
            jitter: resample.seed(2),
        }
    }
}

impl Filter {
    /// A filter before its first step. Its particles are drawn from the free space of `map`; all random numbers follow
    /// from `seed`.
    ///
    /// # Errors
    /// [`FilterError::Option`] for options out of range, [`FilterError::NoFreeSpace`] for a global start in a
    /// map without free space.
    pub fn new(
        options: FilterOptions,
        start: &Start,
        map: &dyn RangeMap,
        seed: u64,
    ) -> Result<Self, FilterError> {
        let (count, kld) = match options.particles {
            ParticleCount::Fixed(n) => (n, None),
            ParticleCount::Kld(kld) => (kld.max, Some(KldSampler::new(kld)?)),
        };
        let most = u32::MAX - 1;
        check("particle count", count as f64, (1..=most as usize).contains(&count), "from 1 to 2^32 - 2")?;
        if let ResampleTrigger::EffectiveShareBelow(share) = options.trigger {
            check("effective share", share, (0.0..=1.0).contains(&share), "from 0 to 1")?;
        }
        if let Some(spread) = options.regularization {
            spread.check(["regularization sigma_m", "regularization sigma_rad"])?;
        }
        if let Some(threshold) = options.update {
            threshold.check()?;
        }
        if let Some(share) = options.least_effective_share {
            check("least effective share", share, share > 0.0 && share < 1.0, "above 0 and below 1")?;
        }
        let annealer = options
            .annealing
            .map(|annealing| {
                let size = match options.particles {
                    ParticleCount::Fixed(min) => {
                        KldOptions { min, max: SPREAD.max.min(annealing.candidates).max(min), ..SPREAD }
                    }
                    ParticleCount::Kld(kld) => kld,
                };
                Annealer::new(annealing, size, *start == Start::Global)
            })
            .transpose()?;
        let first = match (start, options.annealing) {
            (Start::Global, Some(annealing)) => count.max(annealing.candidates),
            _ => count,
        };
        Ok(Self {
            seeds: Seeds::new(seed),
            step: 0,
            phase: Phase::Begun,
            particles: Arc::new(start.particles(first, map, seed)?),
            weights: Arc::new(Weights::uniform(first)),
            next: Arc::default(),
            ancestors: Vec::new(),
            resampled: false,
            pending: false,
            descended: false,
            moved: None,
            random_share: 0.0,
            log_likelihood: Arc::default(),
            weigher: Weigher::default(),
            kld,
            lots: Lots::default(),
            augmented: options.injection.map(Augmented::new).transpose()?,
            annealer,
            count,
            clusters: options.clusters.map(Clusters::new),
            ancestry: options.ancestry.then(Ancestry::default),
            parents: Vec::new(),
            options,
        })
    }

    /// One step: predict, weight, estimate, and resample if it is time to. Where the robot hasn't moved far enough for the scan to
    /// be taken in ([`FilterOptions::update`]), it is a prediction and its estimates.
    ///
    /// # Errors
    /// [`FilterError::Odometry`] and [`FilterError::ScanLength`] for input that makes no sense, which leaves the
    /// filter as it was; [`FilterError::SensorModel`] for a model that returns NaN or plus infinity, and
    /// [`FilterError::NoFreeSpace`] where a random particle finds no place, after which the filter cannot go on.
    pub fn step(
        &mut self,
        input: &StepInput<'_>,
        map: &dyn RangeMap,
        model: &dyn SensorModel,
    ) -> Result<StepOutcome, FilterError> {
        // Both are refused before anything moves.
        self.check_odometry(&input.odometry)?;
        check_scan(self.next_step(), input.laser, input.scan)?;
        self.predict(&input.odometry)?;
        let is_due = self.is_due(input.scan);
        let Update { log_evidence, likelihood_power, recovered, estimates } =
            if is_due { self.update(input.laser, input.scan, map, model)? } else { self.leave_out() };
        let effective_sample_size = self.weights.effective_sample_size();
        let particle_count = self.particles.len();
        let triggered = is_due
            && recovered.is_none()
            && match self.options.trigger {
                ResampleTrigger::EachStep => true,
                ResampleTrigger::EffectiveShareBelow(share) => {
                    effective_sample_size < share * particle_count as f64
                }
            };
        let injected = self.draw_next(triggered, map)?;
        Ok(StepOutcome {
            log_evidence,
            effective_sample_size,
            likelihood_power,
            particle_count,
            resampled: self.resampled,
            injected,
            recovered,
            estimates,
        })
    }

    /// Moves the particles by draws from the motion model, given the motion since the last prediction by odometry,
    /// `base_prev_from_base_now`. Every prediction draws numbers of its own.
    ///
    /// # Errors
    /// [`FilterError::Odometry`] for motion that is not finite, which leaves the filter as it was.
    pub fn predict(&mut self, odometry: &Pose2) -> Result<(), FilterError> {
        self.check_odometry(odometry)?;
        self.step = self.next_step();
        self.phase = Phase::Predicted;
        self.take_next();
        let draw = Draw::new(self.seeds.filter, Stage::Motion, self.step);
        self.options.motion.propagate(odometry, &draw, Arc::make_mut(&mut self.particles));
        if let Some(moved) = &mut self.moved {
            *moved = moved.compose(odometry);
        }
        Ok(())
    }

    /// Whether a scan is to be taken in: after enough motion, and until then where none since could be used, but none without a usable
    /// reading. One that a power of its likelihood was taken in of counts: without motion between them, the particles that it leaves are all that later ones choose from.
    fn is_due(&mut self, scan: &Scan) -> bool {
        let moved_enough = self.options.update.is_none_or(|threshold| {
            self.moved = self.moved.filter(|moved| !threshold.is_reached(moved));
            self.moved.is_none()
        });
        moved_enough && scan.usable() > 0
    }

    /// The estimates of a step whose scan isn't taken in.
    fn leave_out(&mut self) -> Update {
        let log_likelihood = overwritten(&mut self.log_likelihood);
        log_likelihood.clear();
        log_likelihood.resize(self.particles.len(), 0.0);
        let descended = std::mem::take(&mut self.descended);
        if let Some(ancestry) = &mut self.ancestry {
            let parents = descended.then_some(self.ancestors.as_slice());
            ancestry.record(&self.particles, parents, Some((&self.log_likelihood, 0.0)));
        }
        Update { log_evidence: 0.0, likelihood_power: 0.0, recovered: None, estimates: self.estimates() }
    }

    /// Weights the particles by a scan of the laser; NaN readings are ignored.
    ///
    /// # Errors
    /// As [`Filter::step`], but for the odometry.
    pub fn update(
        &mut self,
        laser: &Laser,
        scan: &Scan,
        map: &dyn RangeMap,
        model: &dyn SensorModel,
    ) -> Result<Update, FilterError> {
        let step = self.step;
        check_scan(step, laser, scan)?;
        self.take_next();
        let log_likelihood = overwritten(&mut self.log_likelihood);
        log_likelihood.resize(self.particles.len(), 0.0);
        self.weigher.log_likelihoods(self.particles.as_poses(), laser, scan, map, model, log_likelihood);
        let usable_beams = scan.usable();
        let annealing = self.annealer.as_mut().filter(|annealer| annealer.is_due() && usable_beams > 0);
        let annealed = annealing.is_some();
        let share = self.options.least_effective_share.or(annealed.then_some(LEAST_EFFECTIVE));
        let mut likelihood_power =
            share.map_or(1.0, |share| bearable_power(&self.weights, log_likelihood, share));
        // That of the whole scan. Weights and ancestry go on with what is taken in of it.
        let whole_log_evidence = (likelihood_power < 1.0).then(|| self.weights.log_mean(log_likelihood));
        let weighed = match annealing {
            None => {
                temper(log_likelihood, likelihood_power);
                Arc::make_mut(&mut self.weights).update(log_likelihood)
            }
            Some(annealer) => {
                let most = likelihood_power;
                let weigher = &mut self.weigher;
                let set = Set {
                    particles: Arc::make_mut(&mut self.particles),
                    weights: Arc::make_mut(&mut self.weights),
                    log_likelihood,
                };
                let weighed = annealer.weigh(set, most, map, self.seeds.filter, |poses, out| {
                    weigher.log_likelihoods(poses, laser, scan, map, model, out);
                });
                weighed.map(|(log_evidence, power)| {
                    likelihood_power = power;
                    log_evidence
                })
            }
        };
        // 0 is the power of a scan that was left out.
        likelihood_power = likelihood_power.max(f64::MIN_POSITIVE);
        let (tempered_log_evidence, recovered) = match weighed {
            Ok(log_evidence) => (log_evidence, None),
            Err(WeightError::AllZero) => {
                self.equal_weights();
                (f64::NEG_INFINITY, Some(Recovery::WeightsReset))
            }
            Err(WeightError::NotANumber { particle }) => {
                return Err(FilterError::SensorModel { model: model.name().to_owned(), step, particle });
            }
            Err(WeightError::Length { .. }) => unreachable!("one log likelihood per particle"),
        };
        if recovered.is_none() {
            self.moved = Some(Pose2::IDENTITY);
        }
        let log_evidence =
            whole_log_evidence.filter(|_| recovered.is_none()).unwrap_or(tempered_log_evidence);
        let descended = std::mem::take(&mut self.descended);
        if let Some(ancestry) = &mut self.ancestry {
            let parents = match &self.annealer {
                // The particles of the first step have no parents.
                Some(annealer) if annealed && step > 0 => {
                    self.parents.clear();
                    self.parents.extend(
                        annealer
                            .origins()
                            .iter()
                            .map(|&origin| if descended { self.ancestors[origin as usize] } else { origin }),
                    );
                    Some(self.parents.as_slice())
                }
                _ => descended.then_some(self.ancestors.as_slice()),
            };
            let likelihoods =
                recovered.is_none().then_some((self.log_likelihood.as_slice(), tempered_log_evidence));
            ancestry.record(&self.particles, parents, likelihoods);
        }
        let estimates = self.estimates();
        if let Some(annealer) = &mut self.annealer {
            annealer.observe(&estimates.weighted_mean);
        }
        // A set that is spread over the map expects scans less than one that has gathered.
        let augmented = self.augmented.as_mut().filter(|_| !annealed);
        self.random_share = augmented.map_or(0.0, |augmented| augmented.update(log_evidence, usable_beams));
        Ok(Update { log_evidence, likelihood_power, recovered, estimates })
    }

    /// Resamples at once where `wanted`, or where random particles are due by the options' injection: the new particles, equally
    /// weighted, take the place of the old ones. Returns how many of them are random; `None` where it didn't resample.
    ///
    /// # Errors
    /// [`FilterError::NoFreeSpace`] where a random particle finds no place, after which the filter cannot go on.
    pub fn resample(&mut self, wanted: bool, map: &dyn RangeMap) -> Result<Option<usize>, FilterError> {
        self.take_next();
        if self.phase == Phase::Decided {
            // A second decision without a motion between them draws numbers of its own.
            self.step = self.next_step();
        }
        let injected = self.draw_next(wanted, map)?;
        self.take_next();
        Ok(self.resampled.then_some(injected))
    }

    /// Starts again anywhere in free space, as [`Start::Global`] does: the particles of the last step are given up, and the next step
    /// begins with new ones, whose scans are annealed where the options have it. For a robot that is lost.
    ///
    /// # Errors
    /// [`FilterError::NoFreeSpace`] where a particle finds no place, after which the filter cannot go on.
    pub fn restart(&mut self, map: &dyn RangeMap) -> Result<(), FilterError> {
        let count = match &mut self.annealer {
            None => self.count,
            Some(annealer) => {
                annealer.restart();
                self.count.max(annealer.candidates())
            }
        };
        let seed = Draw::new(self.seeds.filter, Stage::Initial, self.step).seed(0);
        let particles = Start::Global.particles(count, map, seed)?;
        *overwritten(&mut self.next) = particles;
        self.ancestors.clear();
        self.ancestors.resize(count, NO_PARENT);
        self.random_share = 0.0;
        if let Some(augmented) = &mut self.augmented {
            augmented.restart();
        }
        self.moved = None;
        (self.resampled, self.pending) = (true, true);
        Ok(())
    }

    /// The step that a prediction belongs to: the one at hand until it has moved or resampled.
    fn next_step(&self) -> u32 {
        self.step + u32::from(self.phase != Phase::Begun)
    }

    fn check_odometry(&self, odometry: &Pose2) -> Result<(), FilterError> {
        if odometry.is_finite() { Ok(()) } else { Err(FilterError::Odometry { step: self.next_step() }) }
    }

    /// Goes on with the resampled set, if one waits.
    fn take_next(&mut self) {
        if std::mem::take(&mut self.pending) {
            std::mem::swap(&mut self.particles, &mut self.next);
            self.equal_weights();
            self.descended = true;
        }
    }

    fn equal_weights(&mut self) {
        let count = self.particles.len();
        match Arc::get_mut(&mut self.weights) {
            Some(weights) => weights.reset(count),
            None => self.weights = Arc::new(Weights::uniform(count)),
        }
    }

    /// The particles: those that were last weighted, moved or resampled, or the start set before the first step. What a step
    /// resamples takes their place when the next step begins.
    ///
    /// A clone of the `Arc` keeps them as they are, without a copy; the filter then goes on in other memory. The same holds for
    /// [`Filter::weights`] and [`Filter::log_likelihood`].
    pub fn particles(&self) -> &Arc<Particles> {
        &self.particles
    }

    /// The particles' weights at the last step, before its resampling.
    pub fn weights(&self) -> &Arc<Weights> {
        &self.weights
    }

    /// Log likelihood of the last scan for each particle (nats), 0 of a scan that was left out; empty before the first step.
    pub fn log_likelihood(&self) -> &Arc<Vec<f64>> {
        &self.log_likelihood
    }

    /// Which particle each of the next step's particles descends from, [`NO_PARENT`] for a random one; `None` if
    /// the last step did not resample.
    pub fn ancestors(&self) -> Option<&[u32]> {
        self.resampled.then_some(self.ancestors.as_slice())
    }

    /// The history, if the options ask for it.
    pub fn ancestry(&self) -> Option<&Ancestry> {
        self.ancestry.as_ref()
    }

    /// Estimates from the weighted particles.
    ///
    /// # Panics
    /// Never: a filter has particles.
    pub fn estimates(&mut self) -> Estimates {
        let (particles, weights) = (&self.particles, &self.weights);
        Estimates {
            weighted_mean: weighted_mean(particles, weights).expect("a filter has particles"),
            max_weight: max_weight(particles, weights).expect("a filter has particles"),
            densest_cluster: self.clusters.as_mut().and_then(|c| c.heaviest(particles, weights)),
        }
    }

    /// Draws the next step's particles if `triggered`, or if random ones are due, whose share on average is that of the
    /// last update. Returns how many are random.
    fn draw_next(&mut self, triggered: bool, map: &dyn RangeMap) -> Result<usize, FilterError> {
        let share = std::mem::take(&mut self.random_share);
        self.phase = Phase::Decided;
        let injection = Draw::new(self.seeds.filter, Stage::Injection, self.step);
        // The share is rounded to whole particles up or down at random, so that small shares count, too.
        let rounding: f64 = injection.item(u32::MAX).random();
        let random_of = |count: usize| (share * count as f64 + rounding) as usize;
        self.resampled = triggered || random_of(self.particles.len()) > 0;
        self.pending = self.resampled;
        if !self.resampled {
            return Ok(0);
        }
        let count = self.sample_size(share, map)?;
        let injected = random_of(count).min(count);
        self.options.resampler.ancestors(
            &self.weights,
            count - injected,
            &Draw::new(self.seeds.ancestors, Stage::Resample, self.step),
            &mut self.ancestors,
        );
        // Random particles are appended; without room for them the first one would double the set's memory.
        self.ancestors.reserve_exact(injected);
        let next = overwritten(&mut self.next);
        next.reserve(count);
        next.gather(&self.particles, &self.ancestors);
        if let Some(spread) = self.options.regularization {
            let draw = Draw::new(self.seeds.jitter, Stage::Resample, self.step);
            spread.add_to(next, &draw);
        }
        for i in 0..injected {
            next.push(free_pose(map, &mut injection.item(i as u32))?);
            self.ancestors.push(NO_PARENT);
        }
        Ok(injected)
    }

    /// Number of particles of the next set. KLD sampling draws from the distribution that will be resampled: the weighted
    /// particles with a `share` of random ones.
    fn sample_size(&mut self, share: f64, map: &dyn RangeMap) -> Result<usize, FilterError> {
        let Some(kld) = &mut self.kld else {
            let is_spread = self.annealer.as_ref().is_some_and(Annealer::is_due);
            return Ok(if is_spread { self.particles.len() } else { self.count });
        };
        let mut rng = Draw::new(self.seeds.sample_size, Stage::Resample, self.step).item(0);
        self.lots.prepare(&self.weights);
        kld.draw(|| {
            if rng.random::<f64>() < share {
                return free_pose(map, &mut rng);
            }
            Ok(self.particles.get(self.lots.draw(&mut rng)))
        })
    }
}

/// Memory whose values don't matter any more: other memory, empty, where someone else keeps these.
fn overwritten<T: Clone + Default>(shared: &mut Arc<T>) -> &mut T {
    if Arc::get_mut(shared).is_none() {
        *shared = Arc::default();
    }
    Arc::make_mut(shared)
}

/// A scan has a reading for each beam.
fn check_scan(step: u32, laser: &Laser, scan: &Scan) -> Result<(), FilterError> {
    let (ranges, beams) = (scan.ranges.len(), laser.beam_count());
    if ranges == beams { Ok(()) } else { Err(FilterError::ScanLength { step, ranges, beams }) }
}
