//! Progress bars on standard error: silent when it isn't a terminal.

use std::sync::Mutex;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use locsim_core::Progress;

use crate::complain;

/// One bar, made anew for each stage of a run.
pub struct Bars {
    quiet: bool,
    bar: Mutex<ProgressBar>,
}

impl Bars {
    /// Bars that draw nothing when `quiet`.
    pub fn new(quiet: bool) -> Self {
        Self { quiet, bar: Mutex::new(ProgressBar::hidden()) }
    }

    fn with_bar(&self, action: impl FnOnce(&mut ProgressBar)) {
        // A poisoned bar is still a bar.
        action(&mut self.bar.lock().unwrap_or_else(std::sync::PoisonError::into_inner));
    }
}

impl Progress for Bars {
    fn stage(&self, name: &str, total: u64) {
        let bar = if self.quiet {
            ProgressBar::hidden()
        } else {
            ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr())
        };
        let style = ProgressStyle::with_template("{msg:26} [{bar:40}] {pos}/{len} {elapsed} (eta {eta})")
            .unwrap_or_else(|_| ProgressStyle::default_bar())
            .progress_chars("=> ");
        bar.set_style(style);
        bar.set_message(name.to_owned());
        self.with_bar(|current| {
            current.finish_and_clear();
            *current = bar;
        });
    }

    fn advance(&self, n: u64) {
        self.with_bar(|bar| bar.inc(n));
    }

    fn finish(&self) {
        self.with_bar(|bar| bar.finish_and_clear());
    }

    fn note(&self, text: &str) {
        if !self.quiet {
            self.with_bar(|bar| bar.suspend(|| complain(text)));
        }
    }

    fn warn(&self, text: &str) {
        self.with_bar(|bar| bar.suspend(|| complain(&format!("note: {text}"))));
    }
}
