use std::io::IsTerminal;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::Result;
use locsim_core::Control;

use crate::interrupt::Interrupt;
use crate::progress::Bars;

/// Long work at a terminal: a clock, progress bars, and Ctrl-C.
pub struct Session {
    clock: Box<dyn Fn() -> Duration + Sync>,
    bars: Bars,
    interrupt: Interrupt,
}

impl Session {
    /// Begins to time and to listen for Ctrl-C. Bars are drawn on a terminal, unless `quiet`.
    ///
    /// # Errors
    /// The system refuses a handler of Ctrl-C.
    pub fn begin(quiet: bool) -> Result<Self> {
        #[expect(clippy::disallowed_methods, reason = "programs are where time is taken")]
        let start = Instant::now();
        Ok(Self {
            clock: Box::new(move || start.elapsed()),
            bars: Bars::new(quiet || !std::io::stderr().is_terminal()),
            interrupt: Interrupt::listen()?,
        })
    }

    /// Clock, progress and interruption for the work.
    pub fn control(&self) -> Control<'_> {
        Control { clock: &*self.clock, progress: &self.bars, interrupted: self.interrupt.flag() }
    }

    /// Names the results folder of the work that begins, and its parts, which an interruption keeps.
    pub fn work_on(&self, out: &Path, parts: &'static str) {
        self.interrupt.work_on(out, parts);
    }
}
