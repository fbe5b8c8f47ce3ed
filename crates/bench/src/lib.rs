//! What a developer measures: [`speed`] on fixed files, [`suite`] of logs with hidden effects that the search has to find.

pub mod speed;
pub mod suite;
