//! Long work: done in a thread of its own without the interpreter, while the calling thread listens for Ctrl-C and draws the
//! progress.

use std::panic::resume_unwind;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use locsim_core::{Control, Progress};
use pyo3::prelude::*;

use crate::error::{Error, refused};

/// How often the calling thread looks for signals: often enough to seem immediate.
const TICK: Duration = Duration::from_millis(100);

/// How a call reports its progress and how many threads it may use.
pub struct Work {
    bars: Py<PyAny>,
    threads: Option<usize>,
}

/// Something to draw.
enum Event {
    Stage(String, u64),
    Advance(u64),
    Finish,
    Note(String),
    Warn(String),
}

/// Events that wait to be drawn.
#[derive(Default)]
struct Events(Mutex<Vec<Event>>);

impl Events {
    fn push(&self, event: Event) {
        let mut events = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        match (events.last_mut(), &event) {
            (Some(Event::Advance(all)), Event::Advance(n)) => *all += n,
            _ => events.push(event),
        }
    }

    /// Hands the events to the Python object that draws them.
    fn draw(&self, bars: &Bound<'_, PyAny>) -> PyResult<()> {
        let events = std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner));
        for event in events {
            match event {
                Event::Stage(name, total) => bars.call_method1("stage", (name, total))?,
                Event::Advance(n) => bars.call_method1("advance", (n,))?,
                Event::Finish => bars.call_method0("finish")?,
                Event::Note(text) => bars.call_method1("note", (text,))?,
                Event::Warn(text) => bars.call_method1("warn", (text,))?,
            };
        }
        Ok(())
    }
}

impl Progress for Events {
    fn stage(&self, name: &str, total: u64) {
        self.push(Event::Stage(name.to_owned(), total));
    }

    fn advance(&self, n: u64) {
        self.push(Event::Advance(n));
    }

    fn finish(&self) {
        self.push(Event::Finish);
    }

    fn note(&self, text: &str) {
        self.push(Event::Note(text.to_owned()));
    }

    fn warn(&self, text: &str) {
        self.push(Event::Warn(text.to_owned()));
    }
}

impl Work {
    /// `progress` of `None` draws bars where standard error is a terminal.
    pub fn new(py: Python<'_>, progress: Option<bool>, threads: Option<usize>) -> Result<Self, Error> {
        if threads == Some(0) {
            return Err(refused("threads: 0 is not allowed; a whole number from 1"));
        }
        let bars = py.import("locsim._support")?.call_method1("Bars", (progress,))?;
        Ok(Self { bars: bars.unbind(), threads })
    }

    /// Does the work. After Ctrl-C it is asked to stop, and the `KeyboardInterrupt` is raised once it has.
    pub fn run<T, E>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(Control<'_>) -> Result<T, E> + Send,
    ) -> Result<T, Error>
    where
        T: Send,
        E: Into<Error> + Send,
    {
        let (events, interrupted) = (Events::default(), AtomicBool::new(false));
        #[expect(clippy::disallowed_methods, reason = "a caller is where time is taken")]
        let start = Instant::now();
        let done = py.detach(|| {
            thread::scope(|scope| {
                let (finished, tick) = channel();
                let worker = scope.spawn(|| {
                    let _finished = finished;
                    let clock = || start.elapsed();
                    let control = Control { clock: &clock, progress: &events, interrupted: &interrupted };
                    let work = move || work(control).map_err(Into::into);
                    match self.threads {
                        None => work(),
                        Some(threads) => rayon::ThreadPoolBuilder::new()
                            .num_threads(threads)
                            .build()
                            .map_err(|error| Error::Other(error.to_string()))?
                            .install(work),
                    }
                });
                let mut signal = None;
                while tick.recv_timeout(TICK) == Err::<(), _>(RecvTimeoutError::Timeout) {
                    if let Err(error) = Python::attach(|py| {
                        events.draw(self.bars.bind(py))?;
                        py.check_signals()
                    }) {
                        interrupted.store(true, Ordering::Relaxed);
                        signal.get_or_insert(error);
                    }
                }
                let done = worker.join().unwrap_or_else(|panic| resume_unwind(panic));
                signal.map_or(done, |signal| Err(Error::Python(signal)))
            })
        });
        let drawn = events.draw(self.bars.bind(py));
        self.bars.bind(py).call_method0("finish")?;
        let done = done?;
        drawn?;
        Ok(done)
    }
}
