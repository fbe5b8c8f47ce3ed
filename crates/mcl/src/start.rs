use std::f64::consts::PI;

use locsim_core::{Draw, Particles, Pose2, RangeMap, Stage};
use rand::{Rng, RngExt};

use crate::{FilterError, Spread};

/// The robot's pose before the first step: unknown, or known with an uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Start {
    /// Pose tracking: Gaussian around a pose.
    Tracking {
        /// Mean, `map_from_base`.
        pose: Pose2,
        /// Standard deviations about it.
        spread: Spread,
    },
    /// Global localization: uniform over the map's free space and all headings.
    Global,
}

impl Start {
    /// Draws `n` particles; particle `i` from item `i` of [`Stage::Initial`].
    pub(crate) fn particles(
        &self,
        n: usize,
        map: &dyn RangeMap,
        seed: u64,
    ) -> Result<Particles, FilterError> {
        let draw = Draw::new(seed, Stage::Initial, 0);
        match *self {
            Self::Tracking { pose, spread } => {
                spread.check(["start sigma_m", "start sigma_rad"])?;
                let mut particles = Particles::zeros(n);
                (0..n).for_each(|i| particles.set(i, pose));
                spread.add_to(&mut particles, &draw);
                Ok(particles)
            }
            Self::Global => {
                let mut particles = Particles::zeros(n);
                for i in 0..n {
                    particles.set(i, free_pose(map, &mut draw.item(i as u32))?);
                }
                Ok(particles)
            }
        }
    }
}

/// A map whose free space is a smaller share of its bounds than about one in this many is refused.
const ATTEMPTS: u32 = 100_000;

/// A pose uniform over the map's free space and all headings, by rejection from its bounds.
pub(crate) fn free_pose(map: &dyn RangeMap, rng: &mut impl Rng) -> Result<Pose2, FilterError> {
    let [x0, y0, x1, y1] = map.bounds();
    for _ in 0..ATTEMPTS {
        let x = x0 + (x1 - x0) * rng.random::<f64>();
        let y = y0 + (y1 - y0) * rng.random::<f64>();
        if map.is_free(x, y) {
            return Ok(Pose2::new(x, y, PI * (1.0 - 2.0 * rng.random::<f64>())));
        }
    }
    Err(FilterError::NoFreeSpace { attempts: ATTEMPTS })
}
