//! Tests of the crate as its users see it, on a simulated world whose density is known.

mod amcl;
mod densities;
mod files;
mod hostile;
mod learning;
mod prepared;
pub(crate) mod simulated;
mod tempering;
mod training;
