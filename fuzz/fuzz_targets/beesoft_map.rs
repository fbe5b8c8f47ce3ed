//! `cargo fuzz run beesoft_map`
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| drop(locsim_fuzz::beesoft_map(data)));
