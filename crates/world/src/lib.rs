//! Maps, ray casts, dynamic blocks, the simulated robot and its laser

pub mod map;
pub mod mapping;
pub mod raycast;
pub mod simulation;
