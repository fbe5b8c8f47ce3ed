//! Gathers the data that every sensor model is trained on, fits the models, and makes them fit for a filter.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use locsim_core::{
    DependsOn, DistanceMap, Draw, EndpointGrid, Hits, Laser, LikelihoodGrid, Obstructions, Particles, Pose2,
    RangeMap, SensorModel, Stage,
};
use locsim_mcl::Spread;
use locsim_sensor::{
    Amcl, AmclKind, AmclParameters, BeamState, CalibrationScan, FitOptions, FittedModel, ModelKind, Oracle,
    Prepared, SensorError, Tempered, Tempering, TemperingGrid, TrainingSet, choose_tempering, evaluate, fit,
};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::rehearsal::Rehearsal;
use crate::LabError;
use locsim_core::Progress;
use locsim_report::results::{TrainingRow, USUAL_SCAN};
use locsim_scenario::{Model, ModelName, load_amcl};

/// Candidate poses per calibration scan, the true one not counted.
const CANDIDATES: u32 = 256;

/// Calibration scans at the most.
const CALIBRATION_SCANS: usize = 200;

/// Largest scale of the candidates' distance from the true pose \[m\] and \[rad\]; the smallest is a hundredth of it.
const CANDIDATE_SPREAD: (f64, f64) = (0.2, 0.1);

/// Floor under every model's density in the reported log loss.
const LOG_LOSS_FLOOR: f64 = 1e-3;

/// Scans taken from known poses: what training data are made of.
pub struct ScanData {
    /// The sensor (with the beams that become states).
    pub laser: Laser,
    /// `map_from_base` of each scan pose.
    pub poses: Vec<Pose2>,
    /// Scans of each pose, all with the laser's beams.
    pub scans: Vec<Vec<Vec<f32>>>,
    /// Poses in a run that is held out or trained on as a whole: 1 where poses are independent.
    pub run: u32,
}

impl ScanData {
    /// Simulated scans from independent poses: `readings` of a whole `laser` \[m\] in \[pose\]\[observation\]\[beam\]
    /// order, of which at most `beams` beams per scan are kept, evenly spread.
    pub fn simulated(
        laser: &Laser,
        beams: usize,
        poses: &Particles,
        observations: u32,
        readings: &[f32],
    ) -> Self {
        let all = laser.beam_count();
        let (laser, kept) = laser.thinned(beams);
        let scans = readings
            .chunks(observations as usize * all)
            .map(|pose| pose.chunks(all).map(|scan| kept.iter().map(|&beam| scan[beam]).collect()).collect())
            .collect();
        Self { laser, poses: poses.iter().collect(), scans, run: 1 }
    }
}

/// A sensor model as the filter uses it, with what is known of it.
pub struct TrainedModel {
    /// The scenario's label.
    pub label: String,
    /// The model alone.
    pub bare: Arc<dyn SensorModel>,
    /// With floor and exponent, and as a table if it can be one: as the filter uses it.
    pub tempered: Arc<dyn SensorModel>,
    /// With a small floor, so that one odd reading doesn't decide on a scan: as scans are judged by it.
    pub floored: Arc<dyn SensorModel>,
    /// Deviations of the errors that scans of a log share: those of map and reference, which the filter's covariance doesn't have.
    pub shared: Spread,
    /// The fitted model, which can be saved; `None` for the oracle, which isn't fitted.
    pub fitted: Option<FittedModel>,
    /// Held-out quality and what was chosen.
    pub row: TrainingRow,
}

/// Parts of the world for models that need more than the training data.
pub struct Surroundings<'a> {
    /// Exact ray casts.
    pub map: Arc<dyn RangeMap>,
    /// For the likelihood field.
    pub distance: Arc<dyn DistanceMap>,
    /// For the oracle, with the laser's noise (sigma at range 0 \[m\], growth per metre).
    pub oracle: Option<(Arc<dyn Obstructions>, [f64; 2])>,
    /// Cells of the models' tables over where readings end; `None` if the filter is to do without tables.
    pub tables: Option<EndpointGrid>,
    /// For exponents of models that are tempered by the drive; `None` where there is none.
    pub rehearsal: Option<Rehearsal<'a>>,
}

/// Fits every model of a scenario on the same data. `filter_beams` is how many beams of a scan the filter uses (`None`:
/// all), for which exponents are chosen.
///
/// # Errors
/// [`LabError::TrainingData`] for data that are refused, [`LabError::Sensor`] for data that a model can't be fitted
/// to, [`LabError::ModelFile`] for files that can't be used.
pub fn train(
    models: &[Model],
    data: &ScanData,
    surroundings: &Surroundings<'_>,
    held_out_share: f64,
    filter_beams: Option<usize>,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Vec<TrainedModel>, LabError> {
    let failed = |source| LabError::TrainingData { source };
    let set = training_set(data, &*surroundings.map).map_err(failed)?;
    let (train, held_out) = set.split_runs(held_out_share, seed, data.run).map_err(failed)?;
    let beams = filter_beams.unwrap_or(data.laser.beam_count());
    let calibration = calibration_scans(data, &held_out, &*surroundings.map, beams, seed);
    progress.stage("training sensor models", models.len() as u64);
    models
        .iter()
        .map(|model| {
            let trained = train_one(model, &train, &held_out, &calibration, surroundings, &data.laser)?;
            progress.advance(1);
            Ok(trained)
        })
        .collect()
}

fn train_one(
    model: &Model,
    train: &TrainingSet,
    held_out: &TrainingSet,
    calibration: &[CalibrationScan],
    surroundings: &Surroundings<'_>,
    laser: &Laser,
) -> Result<TrainedModel, LabError> {
    let failed = |source| LabError::Sensor { label: model.label.clone(), source };
    if let ModelName::Amcl(kind) = model.name {
        return amcl(model, kind, &surroundings.distance);
    }
    let distance_map = Some(Arc::clone(&surroundings.distance));
    let fitted = match (&model.file, model.name) {
        (_, ModelName::Oracle | ModelName::Amcl(_)) => None,
        (Some(file), ModelName::Fitted(kind)) => Some(load(file, kind, train.max_range())?),
        (None, ModelName::Fitted(kind)) => {
            let options = FitOptions { distance_map: distance_map.clone() };
            Some(fit(kind, train, held_out, &options).map_err(failed)?)
        }
    };
    let bare: Arc<dyn SensorModel> = match (&fitted, &surroundings.oracle) {
        (Some(fitted), _) => fitted.clone().into_model(distance_map).map_err(failed)?,
        (None, Some((obstructions, [sigma_m, sigma_per_m]))) => {
            let oracle = Oracle::new(Arc::clone(obstructions), *sigma_m as f32, *sigma_per_m as f32);
            Arc::new(oracle.map_err(failed)?)
        }
        (None, None) => unreachable!("a validated scenario has an oracle in simulation only"),
    };
    let mut grid = TemperingGrid::default();
    let is_field = model.name == ModelName::Fitted(ModelKind::NpRegField);
    if is_field {
        // It leans on coarser densities by itself, so that no reading is impossible.
        grid.floors = vec![LOG_LOSS_FLOOR];
    }
    if let Some(floor) = model.floor {
        grid.floors = vec![floor];
    }
    if let Some(exponent) = model.exponent {
        grid.exponents = vec![exponent];
    }
    let tempering = choose_tempering(&*bare, calibration, &grid).map_err(failed)?;
    let tables = surroundings.tables.as_ref().map(|endpoints| (LikelihoodGrid::for_laser(laser), endpoints));
    let rehearsal = surroundings.rehearsal.as_ref().filter(|_| model.exponent.is_none());
    // The same small floor for all: without one, a single odd reading makes the log loss infinite.
    let floored = Tempered::new(Arc::clone(&bare), LOG_LOSS_FLOOR, 1.0).map_err(failed)?;
    let (rehearsed, prepared) = rehearsal
        .map(|rehearsal| rehearsal.choose(&bare, &floored, tempering.floor, tables))
        .transpose()?
        .unzip();
    let exponent = rehearsed.map_or(tempering.exponent, |rehearsed| rehearsed.exponent);
    let tempered = Tempered::new(Arc::clone(&bare), tempering.floor, exponent).map_err(failed)?;
    let mut tempered: Arc<dyn SensorModel> = Arc::new(tempered);
    if let Some(prepared) = prepared.flatten() {
        tempered = Arc::new(prepared);
    } else if let Some((states, endpoints)) =
        tables.filter(|_| tempered.depends_on() != DependsOn::Everything)
    {
        tempered = Arc::new(Prepared::new(tempered, states, endpoints).map_err(failed)?);
    }
    let normalized = !matches!(model.name, ModelName::Fitted(kind) if !kind.is_normalized());
    let log_loss_nats = normalized.then(|| evaluate(&floored, held_out).log_loss_nats);
    // One reading of a state, which is what a log has, is no distribution to be matched.
    let has_distributions = normalized && held_out.reading_count() > held_out.len();
    let histogram_match_m = has_distributions.then(|| evaluate(&*bare, held_out).histogram_match_m);
    let mut chosen = fitted.as_ref().map_or_else(BTreeMap::new, |fitted| fitted.chosen().clone());
    chosen.insert("floor".to_owned(), tempering.floor);
    chosen.insert("exponent".to_owned(), exponent);
    if let Some(rehearsed) = rehearsed {
        chosen.insert("training_drive_nees".to_owned(), rehearsed.nees);
        chosen.insert("shared_error_m".to_owned(), rehearsed.shared.sigma_m);
        chosen.insert("shared_error_rad".to_owned(), rehearsed.shared.sigma_rad);
        chosen.insert(USUAL_SCAN.to_owned(), rehearsed.scan_log_density_nats);
    }
    chosen.insert("pose_log_score_nats".to_owned(), tempering.score);
    Ok(TrainedModel {
        label: model.label.clone(),
        tempered,
        floored: Arc::new(floored),
        shared: rehearsed.map_or_else(Spread::default, |rehearsed| rehearsed.shared),
        bare,
        fitted,
        row: TrainingRow { log_loss_nats, histogram_match_m, chosen },
    })
}

/// The parameters of one of AMCL's laser models: nav2's, or those of the model's file.
///
/// # Errors
/// [`LabError::Scenario`] for a file that isn't AMCL's, [`LabError::ModelFile`] for one of another model.
pub fn amcl_parameters(model: &Model, kind: AmclKind) -> Result<AmclParameters, LabError> {
    let Some(file) = &model.file else { return Ok(AmclParameters::defaults(kind)) };
    let parameters = load_amcl(file)?;
    if parameters.kind == kind {
        return Ok(parameters);
    }
    let found = parameters.kind.laser_model_type();
    let what = format!("has laser_model_type `{found}`, the scenario asks for {kind}");
    Err(LabError::ModelFile { path: file.clone(), what })
}

/// A laser model of AMCL, which has its parameters from a file or nav2, and neither floor nor exponent: as it is, and without a
/// table, because its weight of a scan is no product.
fn amcl(model: &Model, kind: AmclKind, distance: &Arc<dyn DistanceMap>) -> Result<TrainedModel, LabError> {
    let parameters = amcl_parameters(model, kind)?;
    let failed = |source| LabError::Sensor { label: model.label.clone(), source };
    let bare: Arc<dyn SensorModel> = Arc::new(Amcl::new(parameters, Arc::clone(distance)).map_err(failed)?);
    let chosen = [
        ("z_hit", parameters.z_hit),
        ("z_rand", parameters.z_rand),
        ("sigma_hit", parameters.sigma_hit),
        ("max_beams", parameters.max_beams as f64),
    ];
    let chosen = chosen.map(|(name, value)| (name.to_owned(), value)).into();
    Ok(TrainedModel {
        label: model.label.clone(),
        tempered: Arc::clone(&bare),
        floored: Arc::clone(&bare),
        shared: Spread::default(),
        bare,
        fitted: None,
        row: TrainingRow { log_loss_nats: None, histogram_match_m: None, chosen },
    })
}

/// Chooses floor and exponent of a model for a filter that uses all beams of `data`, which the model must not have been fitted to:
/// those under which the pose that a scan was taken from is likeliest among poses around it.
///
/// # Errors
/// [`SensorError`] for data that are refused.
pub fn temper(
    model: &dyn SensorModel,
    data: &ScanData,
    map: &dyn RangeMap,
    seed: u64,
) -> Result<Tempering, SensorError> {
    let set = training_set(data, map)?;
    let calibration = calibration_scans(data, &set, map, data.laser.beam_count(), seed);
    choose_tempering(model, &calibration, &TemperingGrid::default())
}

/// Whether every model that comes from a file can be loaded for a sensor of this maximum range \[m\].
///
/// # Errors
/// [`LabError::ModelFile`].
pub fn check_files(models: &[Model], max_range: f32) -> Result<(), LabError> {
    for model in models {
        if let (Some(file), ModelName::Fitted(kind)) = (&model.file, model.name) {
            load(file, kind, max_range)?;
        }
    }
    Ok(())
}

/// A model from a file, if it is of the right kind and for the same sensor.
fn load(file: &Path, kind: ModelKind, max_range: f32) -> Result<FittedModel, LabError> {
    let refuse = |what| LabError::ModelFile { path: file.to_owned(), what };
    let fitted = FittedModel::load(file).map_err(|source| refuse(source.to_string()))?;
    if fitted.kind() != kind {
        return Err(refuse(format!("holds a {} model, the scenario asks for {kind}", fitted.kind())));
    }
    if fitted.max_range() != max_range {
        return Err(refuse(format!(
            "was fitted to a sensor of {} m maximum range, the scenario's reaches {max_range} m",
            fitted.max_range()
        )));
    }
    Ok(fitted)
}

/// D = {(`x_i`, `z_ij`)}: one state per scan pose and beam, with the nominal ray cast from it.
fn training_set(data: &ScanData, map: &dyn RangeMap) -> Result<TrainingSet, SensorError> {
    let laser = &data.laser;
    let poses: Particles = data.poses.iter().map(|pose| pose.compose(&laser.base_from_laser())).collect();
    let mut hits = Hits::default();
    map.cast(poses.as_poses(), laser.bearings(), laser.cast_range(), &mut hits);
    let mut set = TrainingSet::new(laser.max_range())?;
    let beams = laser.beam_count();
    let mut readings = Vec::new();
    for (scan, laser_pose) in poses.iter().enumerate() {
        for (beam, &bearing) in laser.bearings().iter().enumerate() {
            let hit = scan * beams + beam;
            let state = BeamState {
                laser: laser_pose,
                bearing,
                range: hits.range[hit],
                incidence: hits.incidence[hit],
                surface: hits.surface[hit],
                scan: scan as u32,
            };
            readings.clear();
            readings.extend(data.scans[scan].iter().map(|ranges| ranges[beam]));
            set.push(state, &readings)?;
        }
    }
    Ok(set)
}

/// Held-out scans, each with candidates for the pose it was taken from, as seen with `beams` of its beams.
///
/// Truth and candidates are drawn alike around a centre that is itself off the truth, so that nothing but the scan
/// tells them apart: with candidates centred on the truth, a model that is as sure as it should be would be
/// taken for too sure. Scales are spread evenly over two decades, so that some candidates lie as close together as
/// any model's posterior is wide.
fn calibration_scans(
    data: &ScanData,
    held_out: &TrainingSet,
    map: &dyn RangeMap,
    beams: usize,
    seed: u64,
) -> Vec<CalibrationScan> {
    let poses: BTreeSet<u32> = (0..held_out.len()).map(|i| held_out.state(i).scan).collect();
    let scans: Vec<(usize, usize)> = poses
        .iter()
        .flat_map(|&pose| (0..data.scans[pose as usize].len()).map(move |scan| (pose as usize, scan)))
        .collect();
    let stride = scans.len().div_ceil(CALIBRATION_SCANS).max(1);
    let draw = Draw::new(seed, Stage::Training, 1);
    let (laser, kept) = data.laser.thinned(beams);
    scans
        .iter()
        .step_by(stride)
        .enumerate()
        .map(|(i, &(pose, scan))| {
            let truth = data.poses[pose];
            let mut rng = draw.item(i as u32);
            let scale = 100.0_f64.powf(-rng.random::<f64>());
            let mut around = |centre: Pose2| {
                let mut normal = |sigma: f64| {
                    let unit: f64 = StandardNormal.sample(&mut rng);
                    scale * sigma * unit
                };
                let (x, y) = (normal(CANDIDATE_SPREAD.0), normal(CANDIDATE_SPREAD.0));
                Pose2::new(centre.x + x, centre.y + y, centre.theta + normal(CANDIDATE_SPREAD.1))
            };
            let centre = around(truth);
            let poses: Particles = std::iter::once(truth)
                .chain((0..CANDIDATES).map(|_| around(centre)))
                .map(|pose| pose.compose(&laser.base_from_laser()))
                .collect();
            let mut hits = Hits::default();
            map.cast(poses.as_poses(), laser.bearings(), laser.cast_range(), &mut hits);
            CalibrationScan {
                z: kept.iter().map(|&beam| data.scans[pose][scan][beam]).collect(),
                laser: poses,
                bearings: laser.bearings().to_vec(),
                hits,
                max_range: laser.max_range(),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use locsim_core::Poses;

    use super::*;

    /// Free space without end.
    struct Nothing;

    impl RangeMap for Nothing {
        fn cast(&self, laser: Poses<'_>, bearings: &[f32], max_range: f32, out: &mut Hits) {
            out.resize(laser.len() * bearings.len());
            out.range.fill(max_range);
        }

        fn is_free(&self, _x: f64, _y: f64) -> bool {
            true
        }

        fn bounds(&self) -> [f64; 4] {
            [0.0, 0.0, 1.0, 1.0]
        }
    }

    /// If truth and candidates are drawn alike, the truth's rank among them along x is uniform: it lies in the
    /// middle half of the candidates on half of the scans. Of 200 scans that is 100 +- 7.07; 4.9 standard deviations
    /// have a false-alarm probability of 1e-6. Candidates centred on the truth would put it there on all 200, and
    /// a model that is exactly right would be taken for too sure of itself.
    #[test]
    fn calibration_candidates_are_exchangeable_with_the_truth() {
        let laser = Laser::new(vec![0.0], vec![0.0], 0.0, 4.5, Pose2::IDENTITY).unwrap();
        let poses: Vec<Pose2> = (0..200).map(|i| Pose2::new(f64::from(i), 0.0, 0.0)).collect();
        let data = ScanData { laser, scans: vec![vec![vec![1.0]]; poses.len()], poses, run: 1 };
        let set = training_set(&data, &Nothing).unwrap();
        let scans = calibration_scans(&data, &set, &Nothing, 1, 7);
        assert_eq!(scans.len(), 200);
        let in_the_middle_half = |scan: &&CalibrationScan| {
            let (truth, candidates) = scan.laser.x.split_first().unwrap();
            let below = candidates.iter().filter(|x| *x < truth).count();
            (candidates.len() / 4..3 * candidates.len() / 4).contains(&below)
        };
        let count = scans.iter().filter(in_the_middle_half).count();
        assert!((count as f64 - 100.0).abs() < 4.9 * 7.07, "{count} of 200");
    }
}
