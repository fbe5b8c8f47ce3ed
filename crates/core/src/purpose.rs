use crate::{Draw, Stage};

/// Purposes for which a search draws random numbers. Each purpose has a seed of its own, so that no two share a draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Purpose {
    /// The simulated logs that say what chance does to a statistic.
    Replicates = 7,
    /// The simulated logs that tell how long blocks stay.
    Persistence = 8,
    /// One round of the search: the item is its number of effects.
    Round = 9,
    /// The simulated logs whose distance to the measured one is reported.
    Distance = 10,
    /// The simulated logs by which the strength of a hidden effect is set.
    Strength = 11,
    /// The simulated logs that intervals come from.
    Intervals = 12,
    /// The simulated logs that tell how far off the fitted density of blocks is.
    BlockDensity = 13,
    /// The simulated logs that tell what a free model gains where nothing is off.
    FreeModel = 17,
    /// Prior draws of parameters that a log hardly constrains, for their intervals.
    Prior = 14,
    /// The simulated logs that say what noise fits of poses and walls leave.
    Calibration = 19,
    /// The simulated scans that tell how much there is in the open.
    InTheOpen = 20,
    /// Permutations of the stretches of two logs.
    Permutations = 18,
    /// The filter on the measured log.
    Filter = 15,
    /// The scans that the filter's sensor model is learnt from.
    FilterTraining = 16,
}

impl Purpose {
    /// Seeds, or generators, for this purpose.
    pub fn draw(self, seed: u64) -> Draw {
        Draw::new(seed, Stage::Trial, self as u32)
    }
}
