//! The influence of the gap on a particle filter, which localizes on the measured log with sensor models learnt from the
//! nominal simulator and from the one with the named effects.

use std::path::Path;
use std::sync::Arc;

use locsim_core::{Drive, DriveStep, Estimate, Laser, Pose2, RangeMap, RecordedError, Scan, Track};
use locsim_dataset::OdometryError;
use locsim_gap::{FilterError, FilterGap, GapError, Outcome, Purpose};
use locsim_mcl::{
    Filter, FilterOptions, OdometryMotion, ParticleCount, RandomWalk, Spread, Start, StepInput,
};
use locsim_world::effect::{Effect, Effects, OdometryErrors};
use locsim_world::simulation::Simulator;
use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::GapStudy;
use crate::LabError;
use crate::run::filter_options;
use crate::run::{MapSet, free_poses};
use crate::run::{ScanData, Surroundings, TrainedModel, train};
use locsim_core::{Control, Progress};
use locsim_scenario::{self as scenario, Model, ModelName, Motion, RayCast, Source};
use locsim_sensor::ModelKind;

/// Particles: the least number that Nav2's AMCL tracks with by default.
const PARTICLES: usize = 500;
/// Seeds of the filter, the same for both sides. With half as many, Student's quantile would be 3.2 instead of 2.4.
const SEEDS: u32 = 8;
/// Training poses, observations of each and beams of an observation, at the most: enough for a sensor model.
const TRAINING: (u32, u32, usize) = (120, 60, 36);
/// Beams that the filter uses where the scenario doesn't say.
const FILTER_BEAMS: usize = 24;
/// Where a scenario starts globally, its filter starts here all the same: what is compared is tracking.
const START: Spread = Spread { sigma_m: 0.1, sigma_rad: 0.05 };

/// A log as a filter gets it, and how its estimates become poses at the scans' stamps.
struct Corrected {
    drive: Drive,
    /// `base_at_estimate_from_base_at_stamp` of each scan.
    to_stamp: Vec<Pose2>,
}

/// A filter that localizes on a study's log, with a sensor model learnt from one simulator or another.
pub struct FilterOnLog<'a> {
    study: &'a GapStudy,
    control: Control<'a>,
    maps: MapSet,
    /// Learnt from the nominal simulator.
    nominal: TrainedModel,
}

impl<'a> FilterOnLog<'a> {
    /// Learns the nominal simulator's sensor model.
    ///
    /// # Errors
    /// [`LabError`] for a map that cannot be read and a model that cannot be fitted.
    pub fn new(study: &'a GapStudy, cache: Option<&Path>, control: Control<'a>) -> Result<Self, LabError> {
        let map = study.map.geometry().clone();
        let unusable = |source| LabError::Map { path: study.scenario.file.clone(), source };
        let maps =
            MapSet::new(map, study.scenario.ray_cast, None, cache, control.progress).map_err(unusable)?;
        let nominal = trained(study, &maps, &[], control.progress)?;
        Ok(Self { study, control, maps, nominal })
    }

    /// Position error \[m\] of each seed of the filter under the simulator with these effects.
    ///
    /// Effects of mount, odometry, stamps and a drift of the readings are corrected, as a person would. All others are
    /// learnt, from scans that are simulated with them.
    ///
    /// # Errors
    /// [`LabError`] for effects that cannot be simulated, and after an interruption.
    pub fn errors(&self, effects: Vec<Effect>) -> Result<Vec<f64>, LabError> {
        let (correctable, learnt): (Vec<Effect>, Vec<Effect>) =
            effects.into_iter().partition(|e| e.kind.description().is_correctable);
        // The same simulator gives the same model.
        let model = if learnt.is_empty() {
            None
        } else {
            Some(trained(self.study, &self.maps, &learnt, self.control.progress)?)
        };
        let model = model.as_ref().unwrap_or(&self.nominal);
        let steps = self.study.usable_steps().take(self.study.settings.scans);
        let drive = Drive { laser: self.study.drive.laser.clone(), steps: steps.cloned().collect() };
        let effects = Effects::new(correctable).map_err(GapError::from)?;
        let log = corrected(&drive, &effects, filter_beams(self.study))?;
        self.control.progress.stage("localizing on the log", u64::from(SEEDS));
        let errors = (0..SEEDS).into_par_iter().map(|seed| {
            if self.control.is_interrupted() {
                return Err(GapError::Interrupted.into());
            }
            let seed = Purpose::Filter.draw(self.study.scenario.seed).seed(seed);
            let error = rmse(self.study, &log, model, &*self.maps.ranges, seed);
            self.control.progress.advance(1);
            error
        });
        errors.collect()
    }
}

/// Localizes on the log under both simulators; `None` where no effect was named.
pub(super) fn filter_gap(
    study: &GapStudy,
    outcome: &Outcome,
    cache: Option<&Path>,
    control: Control<'_>,
) -> Result<Option<FilterGap>, LabError> {
    if outcome.effects.is_empty() {
        return Ok(None);
    }
    let filter = FilterOnLog::new(study, cache, control)?;
    let before = filter.errors(Vec::new())?;
    let after = filter.errors(outcome.effects.iter().map(|named| named.effect.clone()).collect())?;
    let change: Vec<f64> = after.iter().zip(&before).map(|(after, before)| after - before).collect();
    Ok(Some(FilterGap {
        before: FilterError { position_rmse_m: mean(&before) },
        after: FilterError { position_rmse_m: mean(&after) },
        change_m: mean(&change),
    }))
}

/// `np_reg_registered`, learnt from scans that are simulated with more effects.
fn trained(
    study: &GapStudy,
    maps: &MapSet,
    more: &[Effect],
    progress: &dyn Progress,
) -> Result<TrainedModel, LabError> {
    let nominal = &study.simulator;
    let training = &study.scenario.training;
    let effects = nominal.effects().and_then(|effects| effects.replaced([effects.list(), more].concat()));
    let effects = effects.map_err(GapError::from)?;
    let simulator = Simulator::new(Arc::clone(&maps.exact), nominal.blocks, nominal.laser, effects)
        .map_err(GapError::from)?;
    let (most_poses, most_observations, most_beams) = TRAINING;
    let seed = Purpose::FilterTraining.draw(study.scenario.seed).seed(0);
    let poses = free_poses(maps, training.poses.min(most_poses), seed);
    // The training data are simulated, also beside a log, which has one observation of each state.
    let observations = match study.scenario.source {
        Source::Simulation(_) => training.observations.min(most_observations),
        Source::Log(_) => most_observations,
    };
    progress.stage("simulating training scans", 1);
    let readings = simulator.observe_many(poses.as_poses(), observations, seed);
    progress.advance(1);
    let laser = simulator.laser().laser();
    let beams = training.beams.map_or(most_beams, |beams| (beams as usize).min(most_beams));
    let data = ScanData::simulated(laser, beams, &poses, observations, &readings);
    let surroundings = Surroundings {
        map: Arc::<_>::clone(&maps.exact) as Arc<dyn RangeMap>,
        distance: Arc::clone(&maps.distance),
        oracle: None,
        tables: (study.scenario.ray_cast != RayCast::Exact).then(|| maps.endpoints()),
        rehearsal: None,
    };
    let name = ModelName::Fitted(ModelKind::NpRegRegistered);
    let model = Model { name, label: name.to_string(), floor: None, exponent: None, file: None };
    let share = training.held_out_share;
    let beams = Some(filter_beams(study));
    let mut models = train(&[model], &data, &surroundings, share, beams, seed, progress)?;
    // One model in, one out.
    Ok(models.remove(0))
}

fn filter_beams(study: &GapStudy) -> usize {
    let beams = study.scenario.filter.beams.map_or(FILTER_BEAMS, |beams| beams as usize);
    beams.min(study.drive.laser.beam_count())
}

/// So many beams of a drive's scans, with these effects taken out of mount, odometry, stamps and readings, and each scan as it was from one place.
fn corrected(drive: &Drive, effects: &Effects, beams: usize) -> Result<Corrected, GapError> {
    let laser = &drive.laser;
    let mount = effects.laser_mount(laser.base_from_laser());
    let laser = Laser::new(
        laser.bearings().to_vec(),
        laser.beam_times_secs().to_vec(),
        laser.min_range(),
        laser.max_range(),
        mount,
    )
    .unwrap_or_else(|_| laser.clone());
    let odometry = corrected_odometry(&drive.steps, &effects.odometry_errors());
    let stamps = drive.steps.iter().map(|step| step.stamp_secs);
    let track = Track::new(stamps.zip(odometry)).map_err(RecordedError::from).map_err(GapError::from)?;
    let delay = effects.beam_secs(0.0, 0.0);
    let max = laser.max_range();
    let (steps, to_stamp) = drive
        .steps
        .iter()
        .enumerate()
        .map(|(i, step)| {
            let (secs, pose) = (track.secs()[i], track.poses()[i]);
            let odometry = if delay == 0.0 { pose } else { track.pose_at(secs + delay) };
            let drift = effects.drift_m(secs) as f32;
            let mend = |range: &f32| if *range < max { (range - drift).clamp(0.0, max) } else { *range };
            let ranges = step.scan.ranges.iter().map(mend).collect();
            let step = DriveStep { odometry, scan: Scan { ranges }, ..step.clone() };
            (step, pose.relative_to(&odometry))
        })
        .unzip();
    let drive = Drive { laser, steps };
    let drive = drive.deskewed().unwrap_or(drive);
    Ok(Corrected { drive: drive.with_beams(beams), to_stamp })
}

/// The odometry without these errors of its increments.
fn corrected_odometry(steps: &[DriveStep], errors: &OdometryErrors) -> Vec<Pose2> {
    let mut track: Vec<Pose2> = Vec::with_capacity(steps.len());
    for (i, step) in steps.iter().enumerate() {
        let pose = match track.last() {
            None => step.odometry,
            // The same bits where nothing has to be corrected.
            Some(_) if *errors == OdometryErrors::default() => step.odometry,
            Some(last) => last.compose(&errors.corrected(&step.odometry.relative_to(&steps[i - 1].odometry))),
        };
        track.push(pose);
    }
    track
}

/// Root mean square distance between a filter's weighted mean and the reference \[m\].
fn rmse(
    study: &GapStudy,
    log: &Corrected,
    model: &TrainedModel,
    map: &dyn RangeMap,
    seed: u64,
) -> Result<f64, LabError> {
    let settings = &study.scenario.filter;
    let alpha = match (study.simulator.odometry_noise.alpha(), settings.motion) {
        // Odometry without any noise is a simulation's; a filter needs some.
        (alpha, Motion::Odometry(own)) if alpha == [0.0; 4] => own.unwrap_or(OdometryError::USUAL_ALPHA),
        (alpha, _) => alpha,
    };
    let spread = match settings.start {
        scenario::Start::Tracking(spread) | scenario::Start::Around(_, spread) => spread,
        scenario::Start::Global => START,
    };
    let options = FilterOptions {
        particles: ParticleCount::Fixed(PARTICLES),
        motion: Arc::new(RandomWalk::new(Arc::new(OdometryMotion::new(alpha)?), settings.random_walk_m)?),
        ..filter_options(settings, false)?
    };
    let reference = |step: &DriveStep| step.reference.unwrap_or(Pose2::IDENTITY);
    let pose = reference(&log.drive.steps[0]).compose(&log.to_stamp[0].inverse());
    let start = Start::Tracking { pose, spread };
    let mut filter = Filter::new(options, &start, map, seed)?;
    let mut squares = 0.0;
    for (i, step) in log.drive.steps.iter().enumerate() {
        let odometry = log.drive.odometry_increment(i);
        let input = StepInput { odometry, laser: &log.drive.laser, scan: &step.scan };
        let outcome = filter.step(&input, map, &*model.tempered)?;
        let estimate = outcome.estimates.weighted_mean.pose.compose(&log.to_stamp[i]);
        squares += estimate.position().distance_squared(reference(step).position());
    }
    Ok((squares / log.drive.steps.len() as f64).sqrt())
}

/// A mean with the 95 % interval of Student's t.
fn mean(values: &[f64]) -> Estimate {
    let n = values.len() as f64;
    let value = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - value).powi(2)).sum::<f64>() / (n - 1.0);
    let quantile = StudentsT::new(0.0, 1.0, n - 1.0).map_or(f64::NAN, |t| t.inverse_cdf(0.975));
    Estimate::around(value, quantile * (variance / n).sqrt())
}

#[cfg(test)]
mod tests {
    use locsim_world::effect::EffectKind;

    use super::*;

    #[test]
    fn effects_on_the_odometry_are_corrected() {
        let kinds = [
            (EffectKind::OdomDistanceScale, 0.05),
            (EffectKind::OdomTurnScale, -0.03),
            (EffectKind::OdomImbalance, 0.1),
        ];
        let list = kinds.map(|(kind, value)| Effect::new(kind, vec![value], Vec::new()).unwrap());
        let effects = Effects::new(list.to_vec()).unwrap();
        let motions = [Pose2::new(0.2, 0.01, 0.1), Pose2::new(-0.1, 0.0, -0.4), Pose2::new(0.0, 0.0, 0.3)];
        let (mut truth, mut read) = (vec![Pose2::IDENTITY], vec![Pose2::IDENTITY]);
        for motion in &motions {
            truth.push(truth[truth.len() - 1].compose(motion));
            read.push(read[read.len() - 1].compose(&effects.odometry(motion).mean));
        }
        let step = |odometry: &Pose2| DriveStep {
            stamp_secs: 0.0,
            odometry: *odometry,
            reference: None,
            scan: Scan::default(),
        };
        let steps: Vec<DriveStep> = read.iter().map(step).collect();
        let mended = corrected_odometry(&steps, &effects.odometry_errors());
        for (a, b) in mended.iter().zip(&truth) {
            assert!(
                a.position().distance(b.position()) < 1e-12 && (a.theta - b.theta).abs() < 1e-12,
                "{a:?} {b:?}"
            );
        }
        assert!(read[3].position().distance(truth[3].position()) > 1e-3, "the control");
    }

    /// A robot drives at 1 m/s towards a wall 5 m away. Its laser sweeps for 0.1 s from 60 ms before the stamp on.
    #[test]
    fn scans_are_as_from_where_their_first_beam_was_taken() {
        let bearings: Vec<f32> = (-10..=10_i8).map(|i| 0.01 * f32::from(i)).collect();
        let times: Vec<f32> = (0..=20_u8).map(|i| 0.005 * f32::from(i)).collect();
        let laser = Laser::new(bearings.clone(), times.clone(), 0.1, 20.0, Pose2::IDENTITY).unwrap();
        let delay = -0.06;
        let step = |i: u32| {
            let stamp_secs = 0.2 * f64::from(i);
            let beam = |(bearing, secs): (&f32, &f32)| {
                let x = stamp_secs + delay + f64::from(*secs);
                ((5.0 - x) / f64::from(*bearing).cos()) as f32
            };
            let ranges = bearings.iter().zip(&times).map(beam).collect();
            let odometry = Pose2::new(stamp_secs, 0.0, 0.0);
            DriveStep { stamp_secs, odometry, reference: None, scan: Scan { ranges } }
        };
        let drive = Drive { laser, steps: (0..10).map(step).collect() };
        let late = Effect::new(EffectKind::TimeOffset, vec![delay], Vec::new()).unwrap();
        for effects in [vec![late], Vec::new()] {
            // Without the delay a scan is taken for one at the stamp: the wall is as much farther away.
            let log = corrected(&drive, &Effects::new(effects.clone()).unwrap(), 5).unwrap();
            assert_eq!(log.drive.laser.beam_count(), 5);
            for (step, to_stamp) in log.drive.steps.iter().zip(&log.to_stamp).skip(1).take(8) {
                let known = if effects.is_empty() { 0.0 } else { 1.0 };
                assert!((to_stamp.x + known * delay).abs() < 1e-9, "{to_stamp:?}");
                for (range, bearing) in step.scan.ranges.iter().zip(log.drive.laser.bearings()) {
                    let expected = (5.0 - step.stamp_secs - delay) / f64::from(*bearing).cos();
                    assert!((f64::from(*range) - expected).abs() < 1e-3, "{range} {expected}");
                }
            }
        }
    }

    /// Of 1, 2, 3: mean 2, standard error 1 / sqrt(3), and Student's t of two degrees of freedom 4.3027.
    #[test]
    fn a_mean_has_the_interval_of_student() {
        let mean = mean(&[1.0, 2.0, 3.0]);
        assert!((mean.value - 2.0).abs() < 1e-12);
        let hi = mean.interval.hi;
        assert!((hi - 2.0 - 4.302_653 / 3.0_f64.sqrt()).abs() < 1e-5, "{hi}");
    }
}
