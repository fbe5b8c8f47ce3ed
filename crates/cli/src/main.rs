//! A laboratory for particle-filter localization with range sensors.
mod recording;
fn main() {}
