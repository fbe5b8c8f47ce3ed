//! `cargo fuzz run db3`
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| drop(locsim_fuzz::db3(data)));
