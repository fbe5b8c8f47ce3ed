//! Output on the terminal. A closed stream is neither an error nor a panic.

use std::io::{ErrorKind, Write};

use anyhow::{Context, Result};
use locsim_core::limits::visible;

/// Prints a line on standard output. A reader that closes the pipe early (`| head`) is no error.
///
/// # Errors
/// The system refuses to write.
pub fn say(text: &str) -> Result<()> {
    let mut out = std::io::stdout().lock();
    match writeln!(out, "{}", text.trim_end()).and_then(|()| out.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        other => other.context("standard output"),
    }
}

/// Columns of the terminal: `COLUMNS`, or else those of the terminal that standard output goes to; `None` where it goes
/// elsewhere.
pub fn columns() -> Option<usize> {
    let told =
        std::env::var("COLUMNS").ok().and_then(|columns| columns.parse().ok()).filter(|&columns| columns > 0);
    told.or_else(|| console::Term::stdout().size_checked().map(|(_, columns)| usize::from(columns)))
}

/// Prints lines on standard error, if that can be done. A name in them may hold what a terminal obeys, which is escaped.
pub fn complain(text: &str) {
    let lines: Vec<String> = text.split('\n').map(|line| visible(line, usize::MAX)).collect();
    let _ = writeln!(std::io::stderr().lock(), "{}", lines.join("\n"));
}
