use serde::{Deserialize, Serialize};

/// A 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Lower end.
    pub lo: f64,
    /// Upper end.
    pub hi: f64,
}

impl Interval {
    /// From `half` below `value` to `half` above it.
    pub fn around(value: f64, half: f64) -> Self {
        Self { lo: value - half, hi: value + half }
    }

    /// Half of its width.
    pub fn half(&self) -> f64 {
        0.5 * (self.hi - self.lo)
    }

    /// Whether it covers `value`, ends included.
    pub fn contains(&self, value: f64) -> bool {
        self.lo <= value && value <= self.hi
    }

    /// The interval of a function of the value that keeps its order.
    #[must_use]
    pub fn map(self, of: impl Fn(f64) -> f64) -> Self {
        Self { lo: of(self.lo), hi: of(self.hi) }
    }
}

/// A value with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its interval.
    #[serde(flatten)]
    pub interval: Interval,
}

impl Estimate {
    /// The interval from `half` below the value to `half` above it.
    pub fn around(value: f64, half: f64) -> Self {
        Self { value, interval: Interval::around(value, half) }
    }

    /// An estimate with a normally distributed error of this standard deviation.
    pub fn normal(value: f64, error: f64) -> Self {
        Self::around(value, crate::normal::QUANTILE_975 * error)
    }

    /// The estimate of a function of the value that keeps its order.
    #[must_use]
    pub fn map(self, of: impl Fn(f64) -> f64) -> Self {
        Self { value: of(self.value), interval: self.interval.map(of) }
    }
}
