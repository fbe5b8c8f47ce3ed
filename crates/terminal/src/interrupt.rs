//! Ctrl-C: work is asked to stop, and the program ends within a second in any case.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::sleep;
use std::time::Duration;

use anyhow::Result;
use locsim_report::store::kept;

use crate::{INTERRUPTED, complain};

/// How long work may take to stop by itself. What it hasn't finished by then is lost, as with a kill; what is kept is
/// whole at any moment.
const PATIENCE: Duration = Duration::from_millis(700);

/// Set by the first Ctrl-C.
pub struct Interrupt {
    flag: Arc<AtomicBool>,
    /// The results folder of the work at hand, and what its parts are called.
    work: Arc<Mutex<Option<(PathBuf, &'static str)>>>,
}

impl Interrupt {
    /// Listens from now on.
    pub fn listen() -> Result<Self> {
        let listener = Self { flag: Arc::default(), work: Arc::default() };
        let (flag, work) = (Arc::clone(&listener.flag), Arc::clone(&listener.work));
        ctrlc::set_handler(move || {
            flag.store(true, Ordering::Relaxed);
            sleep(PATIENCE);
            let work = work.lock().unwrap_or_else(PoisonError::into_inner).take();
            complain(&format!("error: interrupted; {}", left(work.as_ref())));
            std::process::exit(i32::from(INTERRUPTED));
        })?;
        Ok(listener)
    }

    /// The flag that work looks at.
    pub fn flag(&self) -> &AtomicBool {
        &self.flag
    }

    /// Says what is under way: results at `out`, made of `parts`.
    pub fn work_on(&self, out: &Path, parts: &'static str) {
        *self.work.lock().unwrap_or_else(PoisonError::into_inner) = Some((out.to_owned(), parts));
    }
}

/// A sentence on the parts that interrupted work keeps.
fn left(work: Option<&(PathBuf, &str)>) -> String {
    match work.map(|(out, parts)| (kept(out).unwrap_or(0), parts)) {
        None | Some((0, _)) => "nothing is kept".to_owned(),
        Some((count, parts)) => format!("{count} {parts} are kept; add --resume to go on"),
    }
}
