//! Maps, ray casts, dynamic blocks, effects, the simulated robot and its laser

pub mod effect;
pub mod map;
pub mod mapping;
pub mod raycast;
pub mod simulation;
