//! `locsim export`: what a scenario says of a robot, in the formats of other programs. [`sensor`] writes a simulator's laser;
//! [`nav2`] searches parameters for AMCL and Beluga and writes them.

mod nav2;
mod sensor;

pub use nav2::{Nav2Export, Nav2Options, nav2, nav2_scenario};
pub use sensor::{Exported, SimulatorFormat, sensor};
