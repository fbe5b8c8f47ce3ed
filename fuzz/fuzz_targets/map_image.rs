//! `cargo fuzz run map_image`
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| drop(locsim_fuzz::map_image(data)));
