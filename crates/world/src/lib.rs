//! Maps, ray casts, dynamic blocks, effects, the simulated robot and its laser

pub mod effect;
pub mod map;
mod options;
pub mod raycast;
pub mod simulation;
