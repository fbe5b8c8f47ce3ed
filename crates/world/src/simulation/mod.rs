//! The simulated robot: unmapped blocks along the walls, a path through the map, odometry that errs, a laser.
//!
//! A [`Simulator`] puts them together. [`simulate_drive`] records a drive; [`Simulator::observe_many`]
//! gathers repeated readings at given poses, to learn sensor models from; [`Simulator::scan_along`] repeats the scans of
//! a recorded drive; [`ScanFilter`] and its neighbours apply effects to a recording;
//! [`ObstructionTable`] knows how likely a block stands in a beam's way, for the oracle, and
//! [`BlockIntegral`] for any ray.
//!
//! Every draw is keyed by (seed, stage, step, item), see [`locsim_core::Draw`]: the same seed gives the same
//! drive on any number of threads.

#[cfg(test)]
mod affected_tests;
mod block_integral;
mod blocks;
mod cast_scan;
mod caster;
mod drive;
mod error;
mod faces;
#[cfg(test)]
pub(crate) mod fixtures;
mod increments;
mod laser;
mod mixture;
mod observe;
mod obstruction;
mod odometry;
mod odometry_filter;
mod path;
mod rectangle;
mod scan_filter;
mod survival;
mod wall_pieces;

pub use block_integral::BlockIntegral;
pub use blocks::{Block, BlockModel};
pub use caster::{BeamCaster, CastBeam, Ray, Surface};
pub use drive::{Robot, SimulatedDrive, odometry_along, simulate_drive};
pub use error::SimulationError;
pub use increments::{Increment, OdometryModel, OdometrySpread, lagging, log_likelihoods, standardized};
pub use laser::LaserSimulator;
pub use mixture::{ClutteredBeam, MixtureDensity, ReadingMixture, ReadingSources};
pub use observe::Simulator;
pub use obstruction::{ObstructionOptions, ObstructionTable};
pub use odometry::OdometryNoise;
pub use odometry_filter::{MountFilter, OdometryFilter};
pub use path::{RobotPath, Trajectory, VelocitySegment};
pub use scan_filter::ScanFilter;
pub use survival::ClutterSurvival;
pub use wall_pieces::{MovedWalls, WallPieces};

pub use crate::options::{BlockOptions, BlockResampling, LaserOptions};
