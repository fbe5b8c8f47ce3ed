//! The laboratory's commands: [`run`] localizes under every model of a scenario and writes a results folder; [`gap`]
//! searches for the effects that a simulation lacks beside a measured log and writes its findings; [`inspect`] says what a
//! log holds; [`apply`] applies a scenario's effects to a recording; [`convert`] reads what older programs wrote.

pub mod apply;
pub mod convert;
mod error;
pub mod gap;
pub mod inspect;
pub mod run;

pub use error::LabError;
pub use locsim_world::effect::EffectKind;
