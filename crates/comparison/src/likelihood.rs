//! The density of a reading under a hypothesis: nominal world, effects, clutter, an error of the reference pose.

pub use locsim_core::normal::density as normal_density;
use locsim_world::effect::{Alternative, Effects};
use locsim_world::simulation::{LaserOptions, ReadingMixture, ReadingSources};

use crate::views::Beam;

/// Share of a uniform density under everything, so that no single reading can rule a hypothesis out.
const FLOOR: f64 = 1e-6;

/// Log likelihood of one reading, and its parts.
#[derive(Clone, Copy, Debug, Default)]
pub struct Terms {
    /// Density \[1/m\], a probability at the maximum range.
    pub density: f64,
    /// Probability that the reading is of the surface itself, given the reading.
    pub hit: f64,
    /// Density of the distribution of the unobstructed beam.
    pub clear_density: f64,
    /// Probability that no clutter stands before the surface.
    pub clear: f64,
    /// Probability that a reading is of the surface, times `measure`: the density of its error is multiplied by it.
    pub returned: f64,
    /// Probability and factor of the tail of a reading of the surface.
    pub tail: [f64; 2],
    /// Probability that the reading is of clutter, given the reading.
    pub short: f64,
    /// Factor from a density per metre to one in the measure of these; see [`locsim_world::simulation::MixtureDensity`].
    pub measure: f64,
    /// Reading less the expected one \[m\], and its deviation \[m\]; 0 and infinity for no return.
    pub error: f64,
    /// Standard deviation of the noise \[m\].
    pub sigma: f64,
}

/// A hypothesis about the world, for single readings.
#[derive(Clone, Copy)]
pub struct Density<'a> {
    /// The laser.
    pub laser: &'a LaserOptions,
    mixture: ReadingMixture<'a>,
}

impl<'a> Density<'a> {
    /// `blocks` is a factor on the density of clutter.
    pub fn new(laser: &'a LaserOptions, effects: &'a Effects, blocks: f64) -> Self {
        Self { laser, mixture: ReadingMixture::new(laser, effects, blocks) }
    }

    /// Log likelihood of a reading `z`; `shift` is added to the range of what stands there \[m\].
    pub fn terms(&self, beam: &Beam, shift: f64, z: f64) -> Terms {
        self.terms_of(&self.sources(beam, shift, z), z)
    }

    /// What a reading `z` may be of, whatever the density of clutter is.
    pub fn sources(&self, beam: &Beam, shift: f64, z: f64) -> ReadingSources {
        self.mixture.sources(beam, shift, z)
    }

    /// Log likelihood of a reading `z` by what it may be of.
    pub fn terms_of(&self, sources: &ReadingSources, z: f64) -> Terms {
        let max = self.laser.max_range_m;
        let parts = self.mixture.density_of(sources);
        let density = (1.0 - FLOOR) * parts.total + FLOOR / max;
        let is_return = z < max && parts.mean < max;
        Terms {
            density,
            hit: if is_return { (parts.surface / density).min(1.0) } else { 0.0 },
            clear_density: parts.unobstructed,
            clear: parts.clear,
            returned: parts.returned,
            tail: parts.tail,
            short: parts.clutter / density,
            measure: parts.measure,
            error: if is_return { z - parts.mean } else { 0.0 },
            sigma: if is_return { parts.sigma } else { f64::INFINITY },
        }
    }

    /// P(reading <= z), for z below the maximum range.
    pub fn cdf(&self, beam: &Beam, shift: f64, z: f64) -> f64 {
        self.mixture.cdf(beam, shift, z)
    }

    /// Density of a reading in which a beam that is not blocked reads by `other` \[1/m\] instead, relative to that by the
    /// hypothesis, less 1: the score of a contamination.
    pub fn contamination(terms: &Terms, other: f64) -> f64 {
        terms.clear * (terms.measure * other - terms.clear_density) / terms.density
    }
}

/// Density of a normal reading of what stands at `mean`.
pub fn near_density(z: f64, mean: f64, sigma: f64, max: f64) -> f64 {
    Alternative::Near { mean, sigma }.density(z, max)
}

#[cfg(test)]
mod tests {
    use glam::DVec2;
    use locsim_core::{Draw, Stage};
    use locsim_world::effect::{Effect, EffectKind};
    use rand::RngExt;

    use super::*;
    use crate::Nominal;
    use crate::fixtures::{NOMINAL, TRUTH};
    use crate::hidden::{Regime, record_library};
    use crate::views::Views;
    use locsim_core::Recorded;

    /// False-alarm rate of each comparison below; there are about 350.
    const FALSE_ALARM: f64 = 1e-6;

    /// Each effect at a value that shows in the room of the fixtures. Bursts of crosstalk never end: one that comes and goes
    /// falls on too few seconds of a drive.
    fn strong(kind: EffectKind) -> Effect {
        use EffectKind as E;
        let south =
            vec![[DVec2::new(0.0, 0.0), DVec2::new(2.0, 0.0)], [DVec2::new(3.0, 0.0), DVec2::new(6.0, 0.0)]];
        let values: &[f64] = match kind {
            E::RangeBias | E::Quantization => &[0.05],
            E::RangeScale => &[0.03],
            E::IncidenceBias => &[0.02],
            E::RangeNoise => &[0.01],
            E::IncidenceNoise | E::BlockDensity | E::BlockDepth => &[2.0],
            E::HeavyTail => &[0.4],
            E::IncidenceDropout => &[0.8, 0.6, 0.2],
            E::RangeDropout => &[0.9, 0.7],
            E::MixedPixels => &[0.8],
            E::Glass => &[0.6, 0.3],
            E::MovedWall => &[-0.3, 0.0],
            E::MissingObject => &[2.6, 2.0, 0.4],
            E::MountYaw | E::TimeOffset | E::OdomDistanceScale | E::OdomTurnScale => &[0.1],
            E::MountOffset => &[0.1, -0.05],
            E::MotionSkew | E::OdomImbalance => &[0.2],
            E::WarmupDrift => &[0.1, 5.0],
            E::SectorOcclusion => &[3.0, -2.0, 0.4, 0.7],
            E::Crosstalk => &[0.3, 1.0],
            E::WheelSlip => &[0.5, 0.3],
        };
        let place = if kind.has_place() { south } else { Vec::new() };
        Effect::new(kind, values.to_vec(), place).unwrap()
    }

    /// A laser that turns while the robot moves, with an edge of its range near the walls.
    fn nominal() -> Nominal {
        let laser = LaserOptions { scan_secs: 0.08, min_range_m: 0.3, max_range_m: 4.6, ..NOMINAL.laser };
        Nominal::new(NOMINAL.map.clone(), laser, NOMINAL.blocks, NOMINAL.odometry, NOMINAL.effects.clone())
            .unwrap()
    }

    /// Logs of several seeds in a world with these effects: `beams` beams of each scan.
    fn logs(nominal: &Nominal, effects: &[Effect], beams: usize, seeds: u64) -> Vec<Recorded> {
        let record = |seed| record_library(nominal, &TRUTH, effects, Regime::default(), seed).unwrap();
        (0..seeds).map(|seed| Recorded::new(&record(seed), 600, beams, |_| true).unwrap()).collect()
    }

    /// Kolmogorov-Smirnov distance of the PITs of all usable readings from the uniform distribution, in units of its critical
    /// value. A PIT is spread evenly over the probability of the reading's step, or of the maximum range.
    fn pit_distance(nominal: &Nominal, effects: &[Effect], logs: &[Recorded]) -> f64 {
        let step = effects.iter().filter(|effect| effect.kind == EffectKind::Quantization);
        let step = step.map(|effect| effect.values[0]).fold(nominal.laser.resolution_m, f64::max);
        let all = nominal.effects_with(effects).unwrap();
        let views = Views::new(nominal, &logs[0], &all).unwrap();
        let density = Density::new(&nominal.laser, &all, 1.0);
        let spread = Draw::new(9, Stage::Bootstrap, 0);
        let mut pits: Vec<f64> = Vec::new();
        for (seed, log) in logs.iter().enumerate() {
            for (i, (&z, beam)) in log.readings.iter().zip(&views.beams).enumerate() {
                let z = f64::from(z);
                if z.is_nan() {
                    continue;
                }
                let below = density.cdf(beam, 0.0, z - 0.5 * step);
                let up_to =
                    if z < nominal.laser.max_range_m { density.cdf(beam, 0.0, z + 0.5 * step) } else { 1.0 };
                let share: f64 = spread.at(seed as u32).item(i as u32).random();
                pits.push(below + share * (up_to - below));
            }
        }
        pits.sort_unstable_by(f64::total_cmp);
        let n = pits.len() as f64;
        let away = |(i, u): (usize, &f64)| (u - i as f64 / n).max((i + 1) as f64 / n - u);
        let distance = pits.iter().enumerate().map(away).fold(0.0, f64::max);
        // P(D > d) <= 2 exp(-2 n d^2) (Massart 1990).
        distance / ((2.0 / FALSE_ALARM).ln() / (2.0 * n)).sqrt()
    }

    /// The simulator draws from the density that the search asks: with clutter, from moving poses, under each effect. Under the
    /// world without the effect it doesn't.
    #[test]
    fn simulated_readings_have_the_distribution_of_the_search() {
        let nominal = nominal();
        assert!(pit_distance(&nominal, &[], &logs(&nominal, &[], 12, 8)) < 1.0);
        for kind in EffectKind::ALL {
            let effects = [strong(kind)];
            let logs = logs(&nominal, &effects, 12, 8);
            let own = pit_distance(&nominal, &effects, &logs);
            assert!(own < 1.0, "{kind}: {own}");
            let without = pit_distance(&nominal, &[], &logs);
            let of_scans = kind.description().moves != locsim_world::effect::Moves::Odometry;
            assert_eq!(without > 1.0, of_scans, "{kind}: {without}");
        }
    }

    #[test]
    fn readings_of_two_effects_have_the_distribution_of_the_search() {
        let nominal = nominal();
        for (i, a) in EffectKind::ALL.into_iter().enumerate() {
            for b in &EffectKind::ALL[..i] {
                let effects = [strong(a), strong(*b)];
                let distance = pit_distance(&nominal, &effects, &logs(&nominal, &effects, 6, 2));
                assert!(distance < 1.0, "{a}, {b}: {distance}");
            }
        }
    }
}
