//! The world that the sensor models are trained in: a simulation of the benchmark's, never its recordings.

use std::f64::consts::TAU;
use std::sync::Arc;

use locsim_core::{Draw, Pose2, Stage};
use locsim_world::effect::Effects;
use locsim_world::simulation::{BlockOptions, BlockResampling, LaserOptions, Simulator};
use rand::RngExt;
use serde::Serialize;

use super::Workload;
use crate::BenchError;
use locsim_core::Progress;
use locsim_lab::run::{MapSet, free_poses};
use locsim_lab::run::{ScanData, Surroundings, TrainedModel, train};
use locsim_scenario::{Model, ModelName};
use locsim_sensor::ModelKind;

/// The models that are compared.
pub const MODELS: [ModelName; 6] = [
    ModelName::Fitted(ModelKind::Classic),
    ModelName::Fitted(ModelKind::BeamMixture),
    ModelName::Fitted(ModelKind::PReg),
    ModelName::Fitted(ModelKind::NpReg),
    ModelName::Fitted(ModelKind::NpRegRegistered),
    ModelName::Fitted(ModelKind::LikelihoodField),
];

/// The training world; map, beams and maximum range are the workload's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TrainingWorld {
    /// Seed of everything random in training.
    pub seed: u64,
    /// Standard deviation of a reading \[m\].
    pub laser_sigma_m: f64,
    /// Share of readings without return, whatever stands there.
    pub dropout_share: f64,
    /// Share of readings that are uniform over the sensor's range.
    pub random_share: f64,
    /// Unmapped blocks per metre of wall \[1/m\].
    pub blocks_per_metre_of_wall: f64,
    /// Length and width of a block, the ends of a uniform distribution \[m\].
    pub block_side_m: [f64; 2],
    /// Gap between a block and its wall, the ends of a uniform distribution \[m\]: anywhere in the corridor.
    pub block_gap_m: [f64; 2],
    /// No block comes closer to the robot's centre \[m\].
    pub clearance_m: f64,
    /// Scan poses, uniform over free space.
    pub poses: u32,
    /// Scans at each, with blocks of their own.
    pub observations: u32,
    /// Share of the poses that bandwidths, floors and exponents are chosen on.
    pub held_out_share: f64,
}

/// The benchmark's world, as known without its recordings: the laser's noise, and that some 14
/// boxes of 0.2 to 0.6 m stand or move within 4 m of the robot, which is one for each metre of wall or a little less.
pub const TRAINING_WORLD: TrainingWorld = TrainingWorld {
    seed: 2016,
    laser_sigma_m: 0.02,
    dropout_share: 0.01,
    random_share: 0.005,
    blocks_per_metre_of_wall: 0.8,
    block_side_m: [0.2, 0.6],
    block_gap_m: [0.0, 3.4],
    clearance_m: 0.1,
    poses: 200,
    observations: 60,
    held_out_share: 0.25,
};

/// Trains every model of [`MODELS`] in the simulated world; none is made a table.
pub fn train_models(
    workload: &Workload,
    maps: &MapSet,
    world: &TrainingWorld,
    progress: &dyn Progress,
) -> Result<Vec<TrainedModel>, BenchError> {
    let laser = LaserOptions {
        rate_hz: 10.0,
        beams: workload.laser.beam_count() as u32,
        field_of_view_rad: TAU,
        first_bearing_rad: None,
        min_range_m: 0.0,
        max_range_m: f64::from(workload.laser.max_range()),
        resolution_m: 0.0,
        sigma_m: world.laser_sigma_m,
        sigma_per_m: 0.0,
        mount: Pose2::IDENTITY,
        scan_secs: 0.0,
    };
    let blocks = BlockOptions {
        per_metre_of_wall: world.blocks_per_metre_of_wall,
        length_m: world.block_side_m,
        width_m: world.block_side_m,
        yaw_rad: [0.0, 0.0],
        wall_distance_m: world.block_gap_m,
        resample: BlockResampling::EachObservation,
        speed_m_s: [0.0, 0.0],
        clearance_m: world.clearance_m,
    };
    let simulator = Simulator::new(Arc::clone(&maps.exact), Some(blocks), laser, Effects::none())?;
    let poses = free_poses(maps, world.poses, world.seed);
    progress.stage("simulating training scans", 1);
    let mut readings = simulator.observe_many(poses.as_poses(), world.observations, world.seed);
    spoil(&mut readings, world, workload.laser.max_range());
    progress.advance(1);
    let laser = simulator.laser().laser();
    let data = ScanData::simulated(laser, laser.beam_count(), &poses, world.observations, &readings);
    let surroundings = Surroundings {
        map: Arc::<_>::clone(&maps.exact) as Arc<_>,
        distance: Arc::clone(&maps.distance),
        oracle: None,
        tables: None,
        rehearsal: None,
    };
    let models =
        MODELS.map(|name| Model { name, label: name.to_string(), floor: None, exponent: None, file: None });
    Ok(train(&models, &data, &surroundings, world.held_out_share, None, world.seed, progress)?)
}

/// Readings that fail: no return, or anything.
fn spoil(readings: &mut [f32], world: &TrainingWorld, max_range: f32) {
    let draw = Draw::new(world.seed, Stage::Sensor, 0);
    for (i, reading) in readings.iter_mut().enumerate() {
        let mut rng = draw.item(i as u32);
        let fate: f64 = rng.random();
        if fate < world.dropout_share {
            *reading = max_range;
        } else if fate < world.dropout_share + world.random_share {
            *reading = max_range * rng.random::<f32>();
        }
    }
}
