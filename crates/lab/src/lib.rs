//! YAML scenarios, runs, tables, figures and reports
