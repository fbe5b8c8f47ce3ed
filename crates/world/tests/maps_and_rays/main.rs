//! Maps, ray casts and mapping, through the crate's public interface.

mod common;
mod map;
mod mapping;
mod raycast;
mod walls;
