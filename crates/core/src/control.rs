use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Receives the progress of long work; `()` ignores it.
pub trait Progress: Sync {
    /// A stage of `total` units of work begins.
    fn stage(&self, _name: &str, _total: u64) {}
    /// `n` units of the stage are done.
    fn advance(&self, _n: u64) {}
    /// All stages are done.
    fn finish(&self) {}
    /// Something that the user may want to know and that changes no result.
    fn note(&self, _text: &str) {}
    /// Something that the user should know, asked for or not.
    fn warn(&self, _text: &str) {}
}

impl Progress for () {}

/// Monotonic time since any fixed moment.
pub type Clock<'a> = &'a (dyn Fn() -> Duration + Sync);

/// How the caller of long work times it, follows it and stops it.
#[derive(Clone, Copy)]
pub struct Control<'a> {
    /// The time. It is reported and decides no result.
    pub clock: Clock<'a>,
    /// Receives the progress.
    pub progress: &'a dyn Progress,
    /// Set by the caller to stop the work.
    pub interrupted: &'a AtomicBool,
}

impl Control<'_> {
    /// Whether the work should stop.
    pub fn is_interrupted(&self) -> bool {
        self.interrupted.load(Ordering::Relaxed)
    }

    /// Time since `began`, a reading of the clock \[s\].
    pub fn seconds_since(&self, began: Duration) -> f64 {
        (self.clock)().saturating_sub(began).as_secs_f64()
    }
}
