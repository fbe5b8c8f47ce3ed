//! Benchmarks for developers: [`speed`] on fixed files, and a [`suite`] of logs with hidden effects that the search has to
//! find.

pub mod speed;
pub mod suite;
