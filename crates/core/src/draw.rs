use rand_philox::{Philox, philox4x32_10, splitmix64};

use crate::normals::normal_triple;

/// The purpose of a random number. Each stage has streams of its own, so that adding draws to one stage never changes
/// another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u64)]
pub enum Stage {
    /// Where unmapped blocks stand.
    Blocks = 1,
    /// Noise of the simulated laser.
    Laser = 2,
    /// Noise of the simulated odometry.
    Odometry = 3,
    /// The simulated robot's path, where it is random.
    Path = 4,
    /// The filter's first particles.
    Initial = 5,
    /// The filter's motion model.
    Motion = 6,
    /// The filter's resampling.
    Resample = 7,
    /// Random particles injected by the filter.
    Injection = 8,
    /// Choosing training states and held-out splits.
    Training = 9,
    /// Draws from a fitted sensor model.
    Sensor = 10,
    /// Bootstrap intervals.
    Bootstrap = 11,
    /// Seeds of trials, derived from a scenario's seed.
    Trial = 13,
    /// The filter's moves and resamplings within one scan.
    Annealing = 14,
    /// The random parts of effects, the ways in which a world differs from the nominal one.
    Effect = 15,
    /// Seeds of cells, derived from a sweep's seed.
    Sweep = 16,
    /// The seed of effects that are applied to a recording, so that none of their draws are those of the simulation that may
    /// have made it.
    Recording = 17,
    /// The search for the parameters of a filter.
    Search = 18,
}

/// Number of items that [`Draw::normals`] serves at once.
pub const BATCH: usize = 64;

/// Every random draw of locsim is a pure function of (seed, stage, step, item), so the number of threads or
/// the order of work cannot change a result. Philox4x32-10 (Salmon et al., SC 2011).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Draw {
    seed: u64,
    stage: Stage,
    step: u32,
}

impl Draw {
    /// Draws of `stage` at time step `step`.
    pub fn new(seed: u64, stage: Stage, step: u32) -> Self {
        Self { seed, stage, step }
    }

    /// The generator of item `item` (a particle, a beam, a block) of this stage and step.
    pub fn item(&self, item: u32) -> Philox {
        let key = self.seed ^ splitmix64(0x6c6f_6373_696d_0000 ^ self.stage as u64);
        Philox::from_u64_seed_stream(key, (u64::from(self.step) << 32) | u64::from(item))
    }

    /// Three independent standard normal numbers for each of the [`BATCH`] items from `first` on; `[k][i]` is number
    /// k of item `first + i`.
    ///
    /// An item's numbers come from the first block of its generator [`Draw::item`]: use either for an item, never both.
    /// The method is that of Box and Muller (1958), in f32 with 31 random bits for each radius and 32 for each angle. No
    /// number is beyond 6.67, which leaves out 3e-11 of the distribution.
    #[inline]
    pub fn normals(&self, first: u32) -> [[f32; BATCH]; 3] {
        let key = self.item(0).key();
        let mut words = [[0; BATCH]; 4];
        let [a, b, c, d] = &mut words;
        for (i, (((a, b), c), d)) in a.iter_mut().zip(b).zip(c).zip(d).enumerate() {
            [*a, *b, *c, *d] = philox4x32_10([0, 0, first.wrapping_add(i as u32), self.step], key);
        }
        let mut normals = [[0.0; BATCH]; 3];
        let [x, y, z] = &mut normals;
        for (i, ((x, y), z)) in x.iter_mut().zip(y).zip(z).enumerate() {
            [*x, *y, *z] = normal_triple(words.each_ref().map(|word| word[i]));
        }
        normals
    }

    /// A seed of its own for item `item`, for example of one trial of an experiment.
    pub fn seed(&self, item: u32) -> u64 {
        self.item(item).next_u64()
    }

    /// The same seed and stage at another step.
    #[must_use]
    pub fn at(&self, step: u32) -> Self {
        Self { step, ..*self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_depend_on_every_key_and_on_nothing_else() {
        let base = Draw::new(1, Stage::Laser, 2).seed(3);
        assert_eq!(base, Draw::new(1, Stage::Laser, 0).at(2).seed(3));
        for other in [
            Draw::new(2, Stage::Laser, 2).seed(3),
            Draw::new(1, Stage::Blocks, 2).seed(3),
            Draw::new(1, Stage::Laser, 3).seed(3),
            Draw::new(1, Stage::Laser, 2).seed(4),
        ] {
            assert_ne!(base, other);
        }
    }

    /// The known answers of Salmon et al.'s own library, Random123.
    #[test]
    fn philox_gives_its_known_answers() {
        let answers = [
            ([0; 4], [0; 2], [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]),
            ([u32::MAX; 4], [u32::MAX; 2], [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]),
            (
                [0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344],
                [0xa409_3822, 0x299f_31d0],
                [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1],
            ),
        ];
        for (counter, key, words) in answers {
            assert_eq!(philox4x32_10(counter, key), words);
        }
    }

    /// The bits of batched normal numbers, which must be the same on every machine and in every version.
    #[test]
    fn normal_numbers_keep_their_bits() {
        let normals = Draw::new(1, Stage::Motion, 2).normals(3);
        let bits =
            normals.as_flattened().iter().fold(0_u64, |hash, n| splitmix64(hash ^ u64::from(n.to_bits())));
        assert_eq!(bits, 8_744_548_917_208_058_889);
    }

    /// Mean of 100,000 uniforms over items: standard error 0.289/sqrt(1e5) = 9.1e-4; 4.9 of them have a
    /// false-alarm probability of 1e-6.
    #[test]
    fn neighbouring_items_are_uniform_together() {
        let draw = Draw::new(7, Stage::Motion, 11);
        let n = 100_000;
        let mean =
            (0..n).map(|i| rand_philox::u32_to_unit_f64(draw.item(i).next_u32())).sum::<f64>() / f64::from(n);
        assert!((mean - 0.5).abs() < 4.9 * 9.13e-4, "mean {mean}");
    }
}
