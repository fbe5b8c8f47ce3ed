//! YAML scenarios, runs, tables, figures and reports.

pub mod bench;
pub mod effects;
pub mod gap;
pub mod gap_bench;
mod limited;
pub mod palette;
pub mod report;
pub mod results;
pub mod run;
pub mod scenario;
pub mod statistics;
pub mod store;
pub mod study;
pub mod summary;
mod yaml;
