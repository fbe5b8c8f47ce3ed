//! The laboratory's commands: [`run`] localizes under every model of a scenario and writes a results folder; [`gap`]
//! searches for the effects that a simulation lacks beside a measured log and writes its findings; [`inspect`] says what a
//! log holds.

mod error;
pub mod gap;
pub mod inspect;
pub mod run;

pub use error::LabError;
