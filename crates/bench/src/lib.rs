//! Benchmarks for developers: [`speed`] on fixed files, the [`suite`] of logs with hidden effects that the search has to find,
//! [`hidden`] makes them; [`real`] logs with known edits, and [`regression`] on a fixed task. The program `locsim-bench` runs them.

mod error;
pub mod hidden;
pub mod real;
pub mod regression;
pub mod speed;
pub mod suite;

pub use error::BenchError;
