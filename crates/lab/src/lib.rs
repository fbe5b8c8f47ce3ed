//! YAML scenarios, runs, tables, figures and reports.

pub mod palette;
pub mod results;
pub mod scenario;
pub mod yaml;
