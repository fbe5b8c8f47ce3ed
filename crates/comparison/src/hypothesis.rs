//! The log likelihood of a log under a hypothesis, with the reference's errors and the density of blocks profiled out.

use std::borrow::Cow;
use std::sync::Arc;

use distreg::random_effects;
use glam::DVec3;
use locsim_core::{
    Pose2, PoseError, PoseInformation, Recorded, are_errors, fit_pose_error, longest_lasting, most_change,
    no_larger_than_told, pattern_score, smooth_pose_errors, without_patterns,
};
use locsim_world::effect::{BurstStates, Effect, Effects, InBurst};
use locsim_world::simulation::{OdometrySpread, ReadingSources, log_likelihoods};

use crate::likelihood::{Density, Terms};
use crate::pose_pattern::{PosePattern, errors_beyond_patterns};
use crate::views::{PieceView, Views};
use crate::wall_error::{self, LEAST_M, OFF_M, Pull};
use crate::{ComparisonError, Nominal};

/// Nuisance parameters: the parameters of a simulation besides the scenario, fitted to the log.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Nuisances {
    /// Factor on the density of clutter.
    pub block_density: f64,
    /// How the reference poses err.
    pub pose_error: PoseError,
    /// How increments of the odometry err.
    pub odometry_error: OdometrySpread,
    /// Standard deviation of the offsets of a measured map's walls beyond what the map says \[m\]; `None` of a map that is taken
    /// for exact.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wall_error_m: Option<f64>,
}

impl Default for Nuisances {
    fn default() -> Self {
        Self {
            block_density: 1.0,
            pose_error: PoseError::NONE,
            odometry_error: OdometrySpread::default(),
            wall_error_m: None,
        }
    }
}

/// A log against a hypothesis.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// What was fitted.
    pub nuisances: Nuisances,
    /// To be added to each reference pose, x, y \[m\] and heading \[rad\]: it takes the fitted error off.
    pub corrections: Vec<DVec3>,
    /// What the scans say of these errors; empty where the process isn't fitted.
    pub information: Vec<PoseInformation>,
    /// Offset of each piece of a measured map's walls \[m\]; empty of a map that is taken for exact.
    pub offsets: Vec<f64>,
    /// Offset and standard deviation of each piece that has readings, about the middle of all \[m\].
    pub known_offsets: Vec<[f64; 2]>,
    /// Log likelihood of each scan with the odometry since the one before (nats).
    pub scans: Vec<f64>,
    /// How surely the poses err in each [`PosePattern`] (standard deviations), see [`pattern_score`]; empty where they don't
    /// err at all.
    pub pattern_scores: Vec<f64>,
}

impl Fitted {
    /// Log likelihood of the log (nats).
    pub fn total(&self) -> f64 {
        self.scans.iter().sum()
    }

    /// Whether an effect explains the errors of the poses: they take up a part of it, and aren't what they seem.
    fn is_in_pattern(&self) -> bool {
        self.pattern_scores.iter().any(|score| score.abs() > MOST_IN_PATTERN)
    }
}

/// Views of a log, for hypotheses that see the world alike.
#[derive(Clone)]
pub struct Comparison<'a> {
    /// The simulator.
    pub nominal: &'a Nominal,
    /// The log.
    pub recorded: Cow<'a, Recorded>,
    /// Views of its beams in the world that hypotheses change: the nominal one, or one with effects that are named
    /// already.
    pub views: Arc<Views>,
}

/// The most steps in which errors of the reference are found, as readings depend on them linearly in each; they end where
/// no error changes by more than this \[m\], a radian counting as 3 m.
pub const CORRECTIONS: usize = 8;
const CORRECTED_M: f64 = 0.001;
/// The most times that beams are cast anew.
const RECASTS: usize = 2;
/// Such steps in which readings that are far off count, and by how much the first of them changes errors where such readings say something \[m\].
const FAR_CORRECTIONS: usize = 4;
const FAR_M: f64 = 0.002;
/// Errors that lie more surely than this in one pattern of an effect (standard deviations) are the effect's.
const MOST_IN_PATTERN: f64 = 10.0;
/// Squares of errors exceed the variance of the noise by more than this factor where there is more noise than is simulated.
const LEAST_EXCESS: f64 = 1.3;
/// Standard deviation of walls' offsets from which fits start \[m\].
const FIRST_WALL_ERROR_M: f64 = 0.02;

impl<'a> Comparison<'a> {
    /// # Errors
    /// As [`Views::new`].
    pub fn new(nominal: &'a Nominal, recorded: &'a Recorded) -> Result<Self, ComparisonError> {
        let views = Arc::new(Views::new(nominal, recorded, &nominal.effects)?);
        Ok(Self { nominal, recorded: Cow::Borrowed(recorded), views })
    }

    /// The same views for another log of the same poses.
    pub fn of<'b>(&'b self, recorded: &'b Recorded) -> Comparison<'b> {
        let views = Arc::clone(&self.views);
        Comparison { nominal: self.nominal, recorded: Cow::Borrowed(recorded), views }
    }

    /// The log's views in a world with these effects, while they are fitted; see [`Views::with`].
    ///
    /// # Errors
    /// As [`Views::new`].
    pub fn views_with(&self, effects: &Effects) -> Result<Arc<Views>, ComparisonError> {
        if self.views.are_of(effects) {
            Ok(Arc::clone(&self.views))
        } else {
            Ok(Arc::new(self.views.with(self.nominal, &self.recorded, effects)?))
        }
    }

    /// The log against a world with these effects.
    ///
    /// # Errors
    /// As [`Views::new`].
    pub fn in_world(&self, effects: &Effects) -> Result<Self, ComparisonError> {
        let views = if self.views.are_of(effects) {
            Arc::clone(&self.views)
        } else {
            Arc::new(self.views.anew(self.nominal, &self.recorded, effects)?)
        };
        Ok(Self { views, ..self.clone() })
    }

    /// The same world seen from the reference poses without the errors that were fitted, with the nuisances fitted anew. Ranges are
    /// linear in errors only as far as no beam passes an edge. The errors on a measured map stay as they are: which of its beams count is known.
    ///
    /// # Errors
    /// As [`Views::new`].
    pub fn recast(
        mut self,
        effects: &Effects,
        mut fitted: Fitted,
    ) -> Result<(Self, Fitted), ComparisonError> {
        for _ in 0..RECASTS {
            let process = &fitted.nuisances.pose_error;
            if process.is_none() || self.nominal.pieces.is_some() || fitted.is_in_pattern() {
                break;
            }
            let errors = errors_beyond_patterns(process, &self.recorded, &fitted.information);
            if most_change(&errors, &self.recorded.corrections) < CORRECTED_M {
                break;
            }
            let recorded = self.recorded.corrected(errors);
            let views = Arc::new(Views::new(self.nominal, &recorded, effects)?);
            let after = Self { nominal: self.nominal, recorded: Cow::Owned(recorded), views };
            let refitted = after.fit_nuisances_with(effects, &fitted.nuisances, 20);
            if refitted.nuisances.pose_error.is_none() {
                break;
            }
            (self, fitted) = (after, refitted);
        }
        Ok((self, fitted))
    }

    /// Effects of the nominal world and more.
    ///
    /// # Errors
    /// As [`Nominal::effects_with`].
    pub fn effects(&self, more: &[Effect]) -> Result<Effects, ComparisonError> {
        self.nominal.effects_with(more)
    }

    /// Where an evaluation with these nuisances begins.
    pub fn start(&self, nuisances: &Nuisances) -> Fitted {
        let n = self.recorded.scans();
        let is_exact = nuisances.pose_error.is_none();
        let corrections = if is_exact { vec![DVec3::ZERO; n] } else { self.recorded.corrections.clone() };
        let pieces = self.nominal.pieces.as_ref();
        let wall_error_m = pieces.map(|_| nuisances.wall_error_m.unwrap_or(FIRST_WALL_ERROR_M));
        Fitted {
            nuisances: Nuisances { wall_error_m, ..*nuisances },
            corrections,
            information: Vec::new(),
            offsets: vec![0.0; pieces.map_or(0, |pieces| pieces.sigmas().len())],
            known_offsets: Vec::new(),
            scans: vec![0.0; n],
            pattern_scores: Vec::new(),
        }
    }

    /// Where an evaluation with an exact reference begins; `None` where these nuisances have none but that.
    pub fn start_exact(&self, nuisances: &Nuisances) -> Option<Fitted> {
        let exact = Nuisances { pose_error: PoseError::NONE, ..*nuisances };
        (!nuisances.pose_error.is_none()).then(|| self.start(&exact))
    }

    /// The log likelihood with `more` effects. `start` gives the nuisances and the reference's errors to begin with;
    /// the density of blocks and the errors are profiled, `iterations` times.
    ///
    /// # Errors
    /// As [`Nominal::effects_with`], and as [`Views::new`].
    pub fn evaluate(
        &self,
        more: &[Effect],
        start: &Fitted,
        iterations: usize,
    ) -> Result<Fitted, ComparisonError> {
        let effects = self.effects(more)?;
        Ok(self.evaluate_views(&*self.views_with(&effects)?, &effects, start, iterations))
    }

    /// The same by views that were cast before, of a world with these effects.
    pub fn evaluate_views(
        &self,
        views: &Views,
        effects: &Effects,
        start: &Fitted,
        iterations: usize,
    ) -> Fitted {
        let mut fitted = start.clone();
        // Without errors of poses and walls only the density of clutter changes from pass to pass.
        let stays = fitted.nuisances.pose_error.is_none() && fitted.offsets.is_empty();
        let bursts = BurstStates::of(effects);
        let sources_of =
            |effects: &Effects| (iterations > 0 && stays).then(|| self.sources(views, effects, &fitted));
        let sources = match &bursts {
            Some(BurstStates { on, off, .. }) => [sources_of(on), sources_of(off)],
            None => [sources_of(effects), None],
        };
        let pass_with = |effects: &Effects, fitted: &Fitted, state: usize| match &sources[state] {
            Some(sources) => self.pass_again(views, effects, fitted, sources),
            None => self.pass(views, effects, fitted, near_weight),
        };
        let pass_of = |fitted: &Fitted| match &bursts {
            Some(bursts) => {
                self.mixed(bursts, [pass_with(&bursts.on, fitted, 0), pass_with(&bursts.off, fitted, 1)])
            }
            None => pass_with(effects, fitted, 0),
        };
        for _ in 0..iterations {
            let pass = pass_of(&fitted);
            self.update(&mut fitted, &pass);
            self.update_walls(views, &mut fitted, &pass);
        }
        let pass = pass_of(&fitted);
        let (process, secs) = (&fitted.nuisances.pose_error, self.recorded.track.secs());
        fitted.scans = process.log_prior(secs, &fitted.corrections, &pass.information());
        self.add_prior_of_walls(views, &mut fitted, &pass);
        for (scan, likelihood) in fitted.scans.iter_mut().zip(&pass.log_likelihood) {
            *scan += likelihood;
        }
        let track = self.corrected(&fitted.corrections);
        let odometry =
            log_likelihoods(effects, &fitted.nuisances.odometry_error, &track, &self.recorded.odometry);
        for (scan, odometry) in fitted.scans.iter_mut().skip(1).zip(odometry) {
            *scan += odometry;
        }
        fitted
    }

    /// Fits all nuisances to the log without more effects.
    pub fn fit_nuisances(&self, start: &Nuisances, iterations: usize) -> Fitted {
        self.fit_nuisances_with(&self.nominal.effects, start, iterations)
    }

    /// Fits all nuisances to the log under these effects, which this comparison's views are of.
    pub fn fit_nuisances_with(&self, effects: &Effects, start: &Nuisances, iterations: usize) -> Fitted {
        self.evaluate_views(&self.views, effects, &self.find_nuisances(effects, start, iterations), 0)
    }

    /// The same without the log likelihood of the scans, which takes one more look at all readings.
    pub fn find_nuisances(&self, effects: &Effects, start: &Nuisances, iterations: usize) -> Fitted {
        let near = self.converge(effects, self.start(start), iterations, 0);
        if near.nuisances.pose_error.is_none() || !self.views.pieces.is_empty() {
            return near;
        }
        // A reference that errs may err by more for a while; an exact one is not made to.
        let far = self.converge(effects, near.clone(), iterations, FAR_CORRECTIONS);
        let total = |fitted: &Fitted| self.evaluate_views(&self.views, effects, fitted, 0).total();
        let is_better = |far: &Fitted| !far.is_in_pattern() && total(far) > total(&near);
        if most_change(&near.corrections, &far.corrections) < FAR_M || !is_better(&far) { near } else { far }
    }

    /// Fits the nuisances step by step, from those of `fitted`. In the first `far` steps readings that are far off count as well; where the first of
    /// these changes next to nothing, it is the last.
    fn converge(&self, effects: &Effects, mut fitted: Fitted, iterations: usize, far: usize) -> Fitted {
        let mut process = fitted.nuisances.pose_error;
        // Where walls err as well, they and the noise of single poses take from each other.
        let has_exact_walls = self.views.pieces.is_empty();
        if process.is_none() {
            // One to start from, that may be found to be none.
            let [white_m, white_rad] = if has_exact_walls { [0.001, 3e-4] } else { [0.0; 2] };
            process =
                PoseError { sigma_m: 0.01, sigma_rad: 0.003, correlation_secs: 2.0, white_m, white_rad };
        }
        let patterns = PosePattern::all_over(&self.recorded);
        let bursts = BurstStates::of(effects);
        for round in 0..far + CORRECTIONS {
            let weight = if round < far { wall_error::weight } else { near_weight };
            let pass_of = |effects: &Effects| self.pass(&self.views, effects, &fitted, weight);
            let pass = match &bursts {
                Some(bursts) => self.mixed(bursts, [&bursts.on, &bursts.off].map(pass_of)),
                None => pass_of(effects),
            };
            fitted.nuisances.pose_error = PoseError::NONE;
            self.update(&mut fitted, &pass);
            let (secs, information) = (self.recorded.track.secs(), pass.information());
            // A constant pattern is a displaced laser or a late stamp rather than an error of the reference.
            let rest = without_patterns(&information, &patterns);
            process = fit_pose_error(process, secs, &rest, iterations);
            let halves = pass.halves.each_ref().map(|half| without_patterns(half, &patterns));
            let corrections = if are_errors(&process, secs, &rest, &halves) {
                fitted.nuisances.pose_error = process;
                smooth_pose_errors(&process, secs, &information).mean
            } else {
                vec![DVec3::ZERO; fitted.corrections.len()]
            };
            let before = std::mem::replace(&mut fitted.corrections, corrections);
            let moved = self.fit_walls(&mut fitted, &pass, iterations);
            let changed = moved.max(most_change(&before, &fitted.corrections));
            let is_last = round + 1 == far + CORRECTIONS
                || round > far && changed < CORRECTED_M
                || round == 0 && far > 0 && changed < FAR_M;
            if is_last && !fitted.nuisances.pose_error.is_none() {
                let error = if has_exact_walls {
                    let longest = longest_lasting(process, secs, &information, &patterns);
                    no_larger_than_told(longest, secs, &information)
                } else {
                    process
                };
                fitted.nuisances.pose_error = error;
                fitted.corrections = smooth_pose_errors(&error, secs, &information).mean;
                fitted.pattern_scores = patterns
                    .iter()
                    .map(|pattern| pattern_score(&error, secs, &information, pattern))
                    .collect();
            }
            if is_last {
                fitted.information = information;
                break;
            }
        }
        fitted.nuisances.odometry_error =
            OdometrySpread::fit(effects, &self.corrected(&fitted.corrections), &self.recorded.odometry);
        fitted
    }

    /// Fits the nuisances anew with more effects, in the views that the numbers of these are fitted in.
    ///
    /// # Errors
    /// As [`Comparison::evaluate`].
    pub fn refit(
        &self,
        more: &[Effect],
        start: &Fitted,
        iterations: usize,
    ) -> Result<Fitted, ComparisonError> {
        let effects = self.effects(more)?;
        let views = self.views_with(&effects)?;
        let comparison = Self { views, ..self.clone() };
        Ok(comparison.fit_nuisances_with(&effects, &start.nuisances, iterations))
    }

    /// Reference poses with their errors taken off.
    pub fn corrected(&self, corrections: &[DVec3]) -> Vec<Pose2> {
        let corrections = corrections.iter().zip(&self.recorded.corrections);
        let poses = self.recorded.track.poses().iter().zip(corrections);
        poses.map(|(pose, (c, known))| pose.moved(*c - *known)).collect()
    }

    /// The terms of every usable reading under the effects, with beam index.
    pub fn for_each_reading(
        &self,
        views: &Views,
        effects: &Effects,
        fitted: &Fitted,
        mut visit: impl FnMut(usize, usize, &Density<'_>, f64, f64, Terms),
    ) {
        let density = self.density(effects, fitted);
        self.for_each_usable(views, fitted, |Usable { scan, beam, shift, z }| {
            visit(scan, beam, &density, shift, z, density.terms(&views.beams[beam], shift, z));
        });
    }

    fn density<'d>(&'d self, effects: &'d Effects, fitted: &Fitted) -> Density<'d> {
        Density::new(&self.nominal.laser, effects, fitted.nuisances.block_density)
    }

    /// Visits each reading that tells poses or walls something.
    pub fn for_each_usable(&self, views: &Views, fitted: &Fitted, mut visit: impl FnMut(Usable)) {
        let max = self.nominal.laser.max_range_m;
        for scan in 0..views.scans() {
            let correction = fitted.corrections[scan] - self.recorded.corrections[scan];
            let first = scan * views.per_scan;
            for (i, beam) in views.scan(scan).iter().enumerate() {
                let reading = f64::from(self.recorded.readings[first + i]);
                // A reading that the simulator can't have is as little usable as NaN.
                if reading.is_nan() || reading < self.nominal.laser.min_range_m {
                    continue;
                }
                if views.is_unsure(first + i) {
                    continue;
                }
                let mut shift = DVec3::from_array(beam.jacobian).dot(correction);
                if let Some(PieceView { piece, lean }) = views.pieces.get(first + i).copied().flatten() {
                    shift += lean * fitted.offsets[piece as usize];
                }
                visit(Usable { scan, beam: first + i, shift, z: reading.min(max) });
            }
        }
    }

    /// What every usable reading may be of, whatever the density of clutter is.
    fn sources(&self, views: &Views, effects: &Effects, fitted: &Fitted) -> Vec<(Usable, ReadingSources)> {
        let density = self.density(effects, fitted);
        let mut sources = Vec::with_capacity(views.beams.len());
        self.for_each_usable(views, fitted, |usable| {
            sources.push((usable, density.sources(&views.beams[usable.beam], usable.shift, usable.z)));
        });
        sources
    }

    fn pass(&self, views: &Views, effects: &Effects, fitted: &Fitted, weight: Weight) -> Pass {
        let mut pass = Pass::new(views.scans());
        let density = self.density(effects, fitted);
        self.for_each_usable(views, fitted, |usable| {
            let terms = density.terms(&views.beams[usable.beam], usable.shift, usable.z);
            pass.add(views, fitted, &usable, &terms, weight);
        });
        if !views.pieces.is_empty() {
            self.fill_in(views, &mut pass.log_likelihood);
        }
        pass.admit_noise();
        pass
    }

    /// One look at all readings of two, with a burst and without: each scan's by the probability that a burst falls on it.
    fn mixed(&self, bursts: &BurstStates, [mut with, without]: [Pass; 2]) -> Pass {
        let scans = bursts.scans(self.recorded.track.secs(), &with.log_likelihood, &without.log_likelihood);
        with.mix(&without, &scans, self.views.per_scan);
        with
    }

    /// As [`Comparison::pass`] over a map that is taken for exact, by what readings may be of.
    fn pass_again(
        &self,
        views: &Views,
        effects: &Effects,
        fitted: &Fitted,
        sources: &[(Usable, ReadingSources)],
    ) -> Pass {
        let mut pass = Pass::new(views.scans());
        let density = self.density(effects, fitted);
        for (usable, sources) in sources {
            pass.add(views, fitted, usable, &density.terms_of(sources, usable.z), near_weight);
        }
        pass
    }

    /// Counts the readings of a scan that have no nominal range in a measured map, seen from where an effect has the laser, as the
    /// scan's others: an effect is neither worse nor better for the beams that it leads into what the map doesn't know.
    fn fill_in(&self, views: &Views, log_likelihood: &mut [f64]) {
        for (scan, sum) in log_likelihood.iter_mut().enumerate() {
            let beams = scan * views.per_scan..(scan + 1) * views.per_scan;
            let is_usable =
                |&beam: &usize| f64::from(self.recorded.readings[beam]) >= self.nominal.laser.min_range_m;
            let (unsure, sure): (Vec<usize>, Vec<usize>) =
                beams.filter(is_usable).partition(|&beam| views.is_unsure(beam));
            if !sure.is_empty() {
                *sum *= 1.0 + unsure.len() as f64 / sure.len() as f64;
            }
        }
    }

    /// A step of expectation maximization for the density of blocks, and the errors of the poses.
    fn update(&self, fitted: &mut Fitted, pass: &Pass) {
        let [shorts, exposure] =
            pass.clutter.iter().fold([0.0; 2], |sum, scan| [sum[0] + scan[0], sum[1] + scan[1]]);
        if exposure > 0.0 {
            // As if one block more had been seen in as much as the nominal density expects.
            fitted.nuisances.block_density = ((shorts + 1.0) / (exposure + 1.0)).clamp(0.01, 20.0);
        }
        if !fitted.nuisances.pose_error.is_none() {
            let process = &fitted.nuisances.pose_error;
            fitted.corrections =
                smooth_pose_errors(process, self.recorded.track.secs(), &pass.information()).mean;
        }
    }

    /// The offsets of a measured map's walls, given the corrections of the poses.
    fn update_walls(&self, views: &Views, fitted: &mut Fitted, pass: &Pass) {
        let (Some(pieces), Some(error_m)) = (&self.nominal.pieces, fitted.nuisances.wall_error_m) else {
            return;
        };
        let data = wall_error::gather(views, &fitted.corrections, &pass.pulls, fitted.offsets.len());
        fitted.offsets = random_effects::most_likely(pieces.sigmas(), error_m, &data);
    }

    /// Fits how far walls stand off, and each one's offset. Returns the largest change of an offset \[m\].
    fn fit_walls(&self, fitted: &mut Fitted, pass: &Pass, iterations: usize) -> f64 {
        let (Some(pieces), Some(error_m)) = (&self.nominal.pieces, fitted.nuisances.wall_error_m) else {
            return 0.0;
        };
        let data = wall_error::gather(&self.views, &fitted.corrections, &pass.pulls, fitted.offsets.len());
        // An offset of all walls is no error of the map, but of the ranges.
        let error_m = random_effects::common_deviation(pieces.sigmas(), error_m, &data, iterations, OFF_M);
        let error_m = error_m.max(LEAST_M);
        let offsets = random_effects::most_likely(pieces.sigmas(), error_m, &data);
        let changes = offsets.iter().zip(&fitted.offsets).map(|(a, b)| (a - b).abs());
        let changed = changes.fold(0.0, f64::max);
        fitted.nuisances.wall_error_m = Some(error_m);
        fitted.known_offsets = random_effects::posteriors(pieces.sigmas(), error_m, &data);
        fitted.offsets = offsets;
        changed
    }

    /// The log density of the walls' offsets with the volume of what they may be, shared out among scans by what each says.
    fn add_prior_of_walls(&self, views: &Views, fitted: &mut Fitted, pass: &Pass) {
        let (Some(pieces), Some(error_m)) = (&self.nominal.pieces, fitted.nuisances.wall_error_m) else {
            return;
        };
        let data = wall_error::gather(views, &fitted.corrections, &pass.pulls, fitted.offsets.len());
        let priors = random_effects::log_priors(pieces.sigmas(), error_m, &data, &fitted.offsets);
        for pull in &pass.pulls {
            if let Some(PieceView { piece, lean }) = views.pieces[pull.beam] {
                let share = pull.weight * lean * lean / data[piece as usize].information;
                fitted.scans[pull.beam / views.per_scan] += share * priors[piece as usize];
            }
        }
    }
}

/// A usable reading of a beam.
#[derive(Clone, Copy)]
pub struct Usable {
    /// Number of its scan.
    pub scan: usize,
    /// Number of its beam in the log.
    pub beam: usize,
    /// Change of the beam's range by errors of pose and wall \[m\].
    pub shift: f64,
    /// The reading \[m\].
    pub z: f64,
}

/// The weight of a reading in a fit of poses on a map that is taken for exact \[1/m^2\]: as far as noise moves a reading of the wall.
/// [`wall_error::weight`] reaches farther: from a reference that is off by ten standard deviations no reading looks like one of the wall.
fn near_weight(terms: &Terms) -> f64 {
    if terms.hit > 1e-3 { terms.hit / terms.sigma.powi(2) } else { 0.0 }
}

/// The weight of a reading in a fit of poses.
type Weight = fn(&Terms) -> f64;

/// One look at all readings.
struct Pass {
    log_likelihood: Vec<f64>,
    /// What beams of even and of odd number say of the errors of each scan's pose.
    halves: [Vec<PoseInformation>; 2],
    /// Of each scan, the expected number of readings of blocks, and how many the nominal density expects where beams could
    /// have met one.
    clutter: Vec<[f64; 2]>,
    /// What readings say of a measured map's walls.
    pulls: Vec<Pull>,
    /// Squares of errors at walls of an exact map, each over the variance of the noise, and how many they are.
    squares: [f64; 2],
}

impl Pass {
    fn new(scans: usize) -> Self {
        Self {
            log_likelihood: vec![0.0; scans],
            halves: [vec![PoseInformation::default(); scans], vec![PoseInformation::default(); scans]],
            clutter: vec![[0.0; 2]; scans],
            pulls: Vec::new(),
            squares: [0.0; 2],
        }
    }

    /// Readings say less of the poses where they err by more than the noise that is simulated: poses would follow what is noise.
    fn admit_noise(&mut self) {
        let excess = self.squares[0] / self.squares[1].max(1.0);
        if excess > LEAST_EXCESS {
            self.halves.iter_mut().flatten().for_each(|scan| *scan = *scan * excess.recip());
        }
    }

    /// What all beams say of the errors of each scan's pose.
    fn information(&self) -> Vec<PoseInformation> {
        let [even, odd] = &self.halves;
        even.iter().zip(odd).map(|(&even, &odd)| even + odd).collect()
    }

    #[inline]
    fn add(&mut self, views: &Views, fitted: &Fitted, usable: &Usable, terms: &Terms, weight: Weight) {
        let &Usable { scan, beam: number, shift, z } = usable;
        let beam = &views.beams[number];
        self.log_likelihood[scan] += terms.density.ln();
        let is_exact = views.pieces.is_empty();
        if is_exact {
            let near = near_weight(terms);
            self.squares[0] += near * terms.error.powi(2);
            self.squares[1] += if near > 0.0 { terms.hit } else { 0.0 };
        }
        let weight = if is_exact { weight(terms) } else { wall_error::weight(terms) };
        if weight > 0.0 {
            // Linear in the correction: as seen from the reference pose.
            let pose = DVec3::from_array(beam.jacobian).dot(fitted.corrections[scan]);
            self.halves[number % 2][scan].add_beam(weight, beam.jacobian, terms.error + pose);
            if !is_exact {
                self.pulls.push(Pull { beam: number, weight, error: terms.error + shift });
            }
        }
        let [shorts, exposure] = &mut self.clutter[scan];
        *shorts += terms.short;
        *exposure -= if terms.short > 0.5 { beam.survival_at(z).0.max(1e-12).ln() } else { beam.log_clear };
    }

    /// Takes in the same readings without a burst, each scan by the probability that none falls on it. Log likelihoods are those of
    /// `scans`.
    fn mix(&mut self, without: &Self, scans: &[InBurst], per_scan: usize) {
        for (scan, &InBurst { log_likelihood, probability }) in scans.iter().enumerate() {
            self.log_likelihood[scan] = log_likelihood;
            let clutter = [self.clutter[scan], without.clutter[scan]];
            self.clutter[scan] =
                [0, 1].map(|i| probability * clutter[0][i] + (1.0 - probability) * clutter[1][i]);
            for (with, without) in self.halves.iter_mut().zip(&without.halves) {
                with[scan] = with[scan] * probability + without[scan] * (1.0 - probability);
            }
        }
        for pull in &mut self.pulls {
            pull.weight *= scans[pull.beam / per_scan].probability;
        }
        self.pulls.extend(without.pulls.iter().map(|pull| Pull {
            weight: pull.weight * (1.0 - scans[pull.beam / per_scan].probability),
            ..*pull
        }));
    }
}

#[cfg(test)]
mod tests {
    use locsim_world::effect::EffectKind;
    use locsim_world::simulation::BlockResampling;

    use super::*;
    use crate::fixtures::{NOMINAL, TRUTH};
    use crate::hidden::{Regime, record_library};
    use crate::nominal::BlockPolicy;
    use crate::replay::{BlockTruth, Replay};

    /// A reference that is up to 20 cm off, where noise moves a reading by 1 cm.
    #[test]
    fn a_reference_is_followed_beyond_the_noise_of_readings() {
        let error = PoseError { sigma_m: 0.06, sigma_rad: 0.006, correlation_secs: 5.0, ..PoseError::NONE };
        let regime = Regime { pose_error: Some(error), ..Regime::default() };
        let drive = record_library(&NOMINAL, &TRUTH, &[], regime, 2).unwrap();
        let recorded = Recorded::new(&drive, 400, 72, |_| true).unwrap();
        let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
        let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
        let corrected = comparison.corrected(&fitted.corrections);
        let rms = |poses: &[Pose2]| {
            let apart =
                poses.iter().zip(TRUTH.poses()).map(|(a, b)| a.position().distance_squared(b.position()));
            (apart.sum::<f64>() / poses.len() as f64).sqrt()
        };
        let [before, after] = [recorded.track.poses(), &corrected].map(rms);
        assert!(before > 0.05 && after < 0.02, "{before} {after}");
    }

    /// Beams that pass an edge only because the reference is off are at walls again once they are cast from where the robot was: the log is
    /// likelier, and its likelihood is that of simulated logs. The errors themselves are as large as before.
    #[test]
    fn a_log_is_as_likely_as_simulated_ones_once_its_beams_are_cast_anew() {
        let error = PoseError { sigma_m: 0.015, sigma_rad: 0.004, correlation_secs: 4.0, ..PoseError::NONE };
        let regime = Regime { pose_error: Some(error), ..Regime::default() };
        let [mut gained, mut off] = [Vec::new(), Vec::new()];
        for seed in 1..=3 {
            let drive = record_library(&NOMINAL, &TRUTH, &[], regime, seed).unwrap();
            let recorded = Recorded::new(&drive, 400, 72, |_| true).unwrap();
            let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
            let before = comparison.fit_nuisances(&Nuisances::default(), 20);
            let (comparison, after) = comparison.recast(&NOMINAL.effects, before.clone()).unwrap();
            gained.push(after.total() - before.total());
            assert!(most_change(&before.corrections, &after.corrections) < 0.03);
            let blocks = BlockTruth::of(BlockPolicy::of(BlockResampling::EachObservation));
            let replay = Replay::new(&comparison, &[], &after, blocks);
            let of_simulated = (0..16).map(|i| {
                let log = replay.simulate(i).unwrap();
                assert!(log.is_corrected());
                comparison.of(&log).fit_nuisances(&after.nuisances, 4).total()
            });
            let moments = distreg::moments::Moments::of(of_simulated);
            off.push((after.total() - moments.mean()) / moments.variance().sqrt());
        }
        assert!(gained.iter().all(|gained| *gained > 100.0), "{gained:?}");
        // Of three each within 4 standard deviations of 16: a false alarm in 300.
        assert!(off.iter().all(|off| off.abs() < 4.0), "{off:?}");
    }

    /// Noise of grazing beams moves no scan; small errors of the poses do, and are found beside it.
    #[test]
    fn noise_of_grazing_beams_is_no_error_of_the_reference() {
        let small =
            PoseError { sigma_m: 0.0015, sigma_rad: 0.0005, correlation_secs: 2.0, ..PoseError::NONE };
        let noise = |slope| Effect::new(EffectKind::IncidenceNoise, vec![slope], vec![]).unwrap();
        // In how many of ten logs errors are found, before and after the noise has its name.
        let found = |pose_error: Option<PoseError>, slope: f64| {
            let regime = Regime { pose_error, ..Regime::default() };
            let errs = |seed: u64| {
                let drive = record_library(&NOMINAL, &TRUTH, &[noise(slope)], regime, seed).unwrap();
                let recorded = Recorded::new(&drive, 400, 72, |_| true).unwrap();
                let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
                let named = comparison.effects(&[noise(slope)]).unwrap();
                [&NOMINAL.effects, &named].map(|effects| {
                    let fitted = comparison.find_nuisances(effects, &Nuisances::default(), 20);
                    usize::from(!fitted.nuisances.pose_error.is_none())
                })
            };
            (1..=10).map(errs).fold([0; 2], |sum, errs| [sum[0] + errs[0], sum[1] + errs[1]])
        };
        assert_eq!([found(None, 0.1), found(None, 0.5), found(Some(small), 0.1)], [[0, 0], [0, 0], [10, 10]]);
        let [_, after] = found(Some(small), 0.5);
        assert_eq!(after, 10);
    }
}
