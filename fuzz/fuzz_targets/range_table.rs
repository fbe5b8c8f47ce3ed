//! `cargo fuzz run range_table`
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| drop(locsim_fuzz::range_table(data)));
