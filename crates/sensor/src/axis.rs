//! The bins of an observation.

use serde::{Deserialize, Serialize};

/// An axis has at most this many quanta, half a millimetre each over 10 km either way and as much again.
const MOST_QUANTA: u32 = 1 << 26;

/// Bins of different widths, each a whole number of quanta, found through a table in constant time.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(try_from = "Parts", into = "Parts")]
pub(crate) struct Axis {
    parts: Parts,
    /// Bin of each quantum.
    bin_of: Vec<u16>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Parts {
    /// Lower end \[m\].
    origin: f32,
    /// Width of a quantum \[m\].
    quantum: f32,
    /// Upper end of each bin in quanta from the origin, ascending.
    ends: Vec<u32>,
}

impl From<Axis> for Parts {
    fn from(axis: Axis) -> Self {
        axis.parts
    }
}

impl TryFrom<Parts> for Axis {
    type Error = String;

    fn try_from(parts: Parts) -> Result<Self, Self::Error> {
        let Parts { origin, quantum, ends } = &parts;
        if !(origin.is_finite() && quantum.is_finite() && *quantum > 0.0) {
            return Err(format!("bins from {origin} m on in quanta of {quantum} m are not allowed"));
        }
        if u16::try_from(ends.len()).is_err() {
            return Err(format!("{} bins are not allowed; at most {}", ends.len(), u16::MAX));
        }
        if !(ends.first().is_some_and(|&e| e > 0) && ends.is_sorted_by(|a, b| a < b)) {
            return Err("bins are out of order".to_owned());
        }
        if let Some(last) = ends.last().filter(|last| **last > MOST_QUANTA) {
            return Err(format!("bins up to quantum {last} are not allowed; at most {MOST_QUANTA}"));
        }
        let mut bin_of = Vec::new();
        for (bin, &end) in parts.ends.iter().enumerate() {
            bin_of.resize(end as usize, bin as u16);
        }
        let axis = Self { parts, bin_of };
        // Ends are sums in f32, which may swallow a quantum.
        let lengthy = |bin: usize| axis.width(bin) > 0.0 && axis.width(bin).is_finite();
        match (0..axis.bins()).find(|&bin| !lengthy(bin)) {
            Some(bin) => Err(format!("bin {bin} is {} m wide, which is not allowed", axis.width(bin))),
            None => Ok(axis),
        }
    }
}

impl Axis {
    /// `bins` bins of equal width over \[0, max) \[m\], for readings themselves.
    pub fn uniform(max: f32, bins: usize) -> Self {
        Self::build(0.0, max / bins as f32, (1..=bins as u32).collect())
    }

    /// Bins over \[-max, max\] \[m\] for offsets from the nominal range: of one quantum within 24 quanta of 0,
    /// where the sensor's own noise lies, further away about an eighth of their distance from 0 wide, at most
    /// `widest` \[m\].
    pub fn around_zero(max: f32, quantum: f32, widest: f32) -> Self {
        let most = (max / quantum).ceil() as u32;
        let widest = ((widest / quantum).round() as u32).max(1);
        let mut upper = Vec::new();
        let mut end = 0;
        while end < most {
            end = (end + (end / 8).saturating_sub(1).clamp(1, widest)).min(most);
            upper.push(end);
        }
        let lower = upper.iter().rev().skip(1).map(|end| most - end);
        let ends = lower.chain([most]).chain(upper.iter().map(|end| most + end)).collect();
        Self::build(-(most as f32) * quantum, quantum, ends)
    }

    /// Bins over \[0, max\] \[m\] for distances: of one quantum near 0, further away about a quarter of their distance wide.
    pub fn from_zero(max: f32, quantum: f32) -> Self {
        let most = (max / quantum).ceil() as u32;
        let mut ends = Vec::new();
        let mut end = 0;
        while end < most {
            end = (end + (end / 4).max(1)).min(most);
            ends.push(end);
        }
        Self::build(0.0, quantum, ends)
    }

    fn build(origin: f32, quantum: f32, ends: Vec<u32>) -> Self {
        Self::try_from(Parts { origin, quantum, ends }).expect("ends ascend by construction")
    }

    /// Number of bins.
    pub fn bins(&self) -> usize {
        self.parts.ends.len()
    }

    /// The bin of a value \[m\]; values outside fall into the first or the last bin.
    #[inline]
    pub fn bin(&self, value: f32) -> usize {
        let quantum = ((value - self.parts.origin) * (1.0 / self.parts.quantum)) as usize;
        usize::from(self.bin_of[quantum.min(self.bin_of.len() - 1)])
    }

    /// Lower end of a bin \[m\].
    pub fn lower(&self, bin: usize) -> f32 {
        let quanta = if bin == 0 { 0 } else { self.parts.ends[bin - 1] };
        self.parts.origin + quanta as f32 * self.parts.quantum
    }

    /// Upper end of a bin \[m\].
    pub fn upper(&self, bin: usize) -> f32 {
        self.parts.origin + self.parts.ends[bin] as f32 * self.parts.quantum
    }

    /// Width of a bin \[m\].
    pub fn width(&self, bin: usize) -> f32 {
        self.upper(bin) - self.lower(bin)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_value_lies_in_its_bin(value in -4.5f32..4.5, quantum in 0.0005f32..0.02) {
            for axis in [Axis::around_zero(4.5, quantum, 0.03), Axis::uniform(4.5, 450)] {
                let bin = axis.bin(value);
                // both ends are rounded to f32
                prop_assert!(axis.lower(bin) <= value.max(axis.lower(0)) + 2e-6);
                prop_assert!(axis.upper(bin) >= value - 2e-6);
            }
        }
    }

    #[test]
    fn bins_are_fine_around_zero_and_symmetric() {
        let axis = Axis::around_zero(4.5, 0.002, 0.03);
        assert!((axis.width(axis.bin(0.01)) - 0.002).abs() < 1e-6);
        assert!((axis.width(axis.bin(2.0)) - 0.03).abs() < 1e-6);
        assert!((axis.lower(0) + axis.upper(axis.bins() - 1)).abs() < 1e-6);
        assert!(axis.upper(axis.bins() - 1) >= 4.5);
        for bin in 0..axis.bins() {
            assert!((axis.lower(bin) + axis.upper(axis.bins() - 1 - bin)).abs() < 1e-5);
        }
    }
}
