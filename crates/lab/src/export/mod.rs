//! `locsim export`: what a scenario says of a robot, in the formats of other programs.

mod sensor;

pub use sensor::{Exported, SimulatorFormat, sensor};
