//! What a user asks for: [`run`] localizes under every model of a scenario and writes a results folder; [`gap`] searches
//! for what a simulation lacks beside a measured log and writes what it found.

mod error;
pub mod gap;
pub mod run;

pub use error::LabError;
