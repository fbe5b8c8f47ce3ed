//! `cargo fuzz run vector_map`
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| drop(locsim_fuzz::vector_map(data)));
