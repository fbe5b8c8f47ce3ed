//! Runs the crate's fixed benchmark and prints its report as JSON.

use std::time::Instant;

use distreg::benchmark::{BenchmarkError, run};

fn main() -> Result<(), BenchmarkError> {
    #[expect(
        clippy::disallowed_methods,
        reason = "a program may look at the clock; the library is handed it"
    )]
    let start = Instant::now();
    let report = run(&|| start.elapsed())?;
    println!("{}", serde_json::to_string_pretty(&report).expect("a report of plain numbers"));
    Ok(())
}
