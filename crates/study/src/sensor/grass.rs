use locsim_core::{Draw, Stage};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

use super::{Sensor, Values};

/// A laser on a rail that looks across it into grass; its state is its place on the rail \[m\].
///
/// The blades stand where they stand, at random but for good; wind pushes all of them along the rail and the beam has a
/// width, so that an observation meets one of a few blades. A few millimetres further along the rail these are others.
pub(crate) struct Grass {
    /// Length of the rail \[m\].
    rail: f64,
    /// (place along the rail, distance from it, half width) of each blade \[m\], by the first.
    blades: Vec<[f64; 3]>,
    /// Half the width of the widest \[m\].
    widest: f64,
    /// The wall behind the grass \[m\].
    wall: f64,
    noise: Noise,
    values: Values,
}

/// The random part of an observation \[m\].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Noise {
    /// Standard deviation of the wind's push.
    pub wind: f64,
    /// Half the width of the beam.
    pub beam: f64,
    /// Standard deviation of a reading.
    pub sigma: f64,
}

impl Grass {
    /// Grass with `per_square_metre` blades of half widths `blade` between the distances `depth` from a rail, placed by
    /// `seed`.
    pub fn new(
        seed: u64,
        rail: f64,
        depth: [f64; 2],
        per_square_metre: f64,
        blade: [f64; 2],
        noise: Noise,
        values: Values,
    ) -> Self {
        let margin = Self::margin(blade, noise);
        let draw = Draw::new(seed, Stage::Blocks, 0);
        let mut blades: Vec<[f64; 3]> = (0..Self::blades(rail, depth, per_square_metre, blade, noise) as u32)
            .map(|i| {
                let mut random = draw.item(i);
                let mut within = |lo: f64, hi: f64| lo + (hi - lo) * random.random::<f64>();
                [within(-margin, rail + margin), within(depth[0], depth[1]), within(blade[0], blade[1])]
            })
            .collect();
        blades.sort_by(|a, b| a[0].total_cmp(&b[0]));
        Self { rail, blades, widest: blade[1], wall: depth[1], noise, values }
    }

    /// How many blades [`Grass::new`] makes.
    pub fn blades(rail: f64, depth: [f64; 2], per_square_metre: f64, blade: [f64; 2], noise: Noise) -> f64 {
        let area = (rail + 2.0 * Self::margin(blade, noise)) * (depth[1] - depth[0]);
        (per_square_metre * area).round()
    }

    /// Blades so far beyond the rail's ends are seen in wind.
    fn margin(blade: [f64; 2], noise: Noise) -> f64 {
        blade[1] + 6.0 * noise.wind + noise.beam
    }

    /// Distance to the first blade in front of `place`.
    fn distance(&self, place: f64) -> f64 {
        let first = self.blades.partition_point(|blade| blade[0] < place - self.widest);
        self.blades[first..]
            .iter()
            .take_while(|blade| blade[0] <= place + self.widest)
            .filter(|[x, _, half]| (x - place).abs() <= *half)
            .fold(self.wall, |nearest, blade| nearest.min(blade[1]))
    }
}

impl Sensor for Grass {
    fn state(&self, random: &mut dyn Rng) -> Vec<f64> {
        vec![self.rail * random.random::<f64>()]
    }

    fn observe(&self, state: &[f64], random: &mut dyn Rng) -> f64 {
        let within_beam = 2.0 * random.random::<f64>() - 1.0;
        let mut normal = || -> f64 { StandardNormal.sample(random) };
        let place = state[0] + self.noise.beam * within_beam - self.noise.wind * normal();
        self.values.nearest(self.distance(place) + self.noise.sigma * normal())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_blade_in_the_way_is_met() {
        let still = Noise { wind: 0.0, beam: 0.0, sigma: 0.0 };
        let values = Values { resolution: 1e-3, last: 4.5 };
        let mut grass = Grass::new(1, 2.0, [1.0, 1.5], 0.0, [0.002, 0.004], still, values);
        grass.blades = vec![[0.500, 1.3, 0.003], [0.501, 1.1, 0.001], [0.9, 1.2, 0.004]];
        for (place, distance) in
            [(0.5005, 1.1), (0.4975, 1.3), (0.4971, 1.3), (0.4969, 1.5), (0.9039, 1.2), (0.7, 1.5)]
        {
            assert_eq!(grass.distance(place), distance, "{place}");
        }
    }
}
