//! Wall times of short pieces of work.

use std::time::Duration;

use locsim_core::Clock;
use serde::Serialize;

use locsim_report::statistics::quantile;

/// A piece of work is done once to warm up, then until both bounds are reached: this often ...
const LEAST_REPEATS: usize = 7;

/// ... and for this long, ...
const LEAST_TIME: Duration = Duration::from_millis(150);

/// ... or, where it takes long, until it has been done once for this long.
const ENOUGH_TIME: Duration = Duration::from_secs(3);

/// Wall times of one piece of work.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Timing {
    /// Median over repeats after a warm-up, per unit of work \[ns\].
    pub median_ns: f64,
    /// The fastest of them, which other work on the machine disturbs least, per unit of work \[ns\].
    pub fastest_ns: f64,
    /// Number of repeats.
    pub repeats: usize,
}

impl Timing {
    /// Of each of `units` parts of the unit.
    #[must_use]
    pub fn per(self, units: usize) -> Self {
        let units = units as f64;
        Self { median_ns: self.median_ns / units, fastest_ns: self.fastest_ns / units, ..self }
    }
}

/// Times `work`, which does `units` units at a call.
pub fn time(clock: Clock<'_>, units: usize, mut work: impl FnMut()) -> Timing {
    work();
    let mut times = Vec::new();
    let start = clock();
    loop {
        let before = clock();
        work();
        let now = clock();
        times.push(now.saturating_sub(before).as_secs_f64() * 1e9 / units as f64);
        let spent = now.saturating_sub(start);
        if (times.len() >= LEAST_REPEATS && spent >= LEAST_TIME) || spent >= ENOUGH_TIME {
            break;
        }
    }
    times.sort_by(f64::total_cmp);
    Timing { median_ns: quantile(&times, 0.5), fastest_ns: times[0], repeats: times.len() }
}
