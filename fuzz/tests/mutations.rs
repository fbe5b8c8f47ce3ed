//! Mutated inputs, as many as the time allows: nothing brings the readers down.

use std::process::Command;

/// Variables `LOCSIM_FUZZ_SECONDS` and `LOCSIM_FUZZ_SEED` ask for more inputs and for others.
#[test]
fn no_mutated_input_brings_a_reader_down() {
    let variable = |name, default: &str| std::env::var(name).unwrap_or_else(|_| default.to_owned());
    let call = Command::new(env!("CARGO_BIN_EXE_locsim-fuzz"))
        .args(["try", "--seconds", &variable("LOCSIM_FUZZ_SECONDS", "0")])
        .args(["--seed", &variable("LOCSIM_FUZZ_SEED", "1")])
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&call.stdout);
    eprintln!("{text}{}", String::from_utf8_lossy(&call.stderr));
    assert!(call.status.success());
}
