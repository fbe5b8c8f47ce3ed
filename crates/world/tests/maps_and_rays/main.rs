//! Maps and ray casts, through the crate's public interface.

mod common;
mod map;
mod raycast;
