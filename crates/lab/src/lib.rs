//! The laboratory's two commands: [`run`] localizes under every model of a scenario and writes a results folder; [`gap`]
//! searches for the effects that a simulation lacks beside a measured log and writes its findings.

mod error;
pub mod gap;
pub mod run;

pub use error::LabError;
