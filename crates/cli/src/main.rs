//! A laboratory for particle-filter localization with range sensors
fn main() {}
