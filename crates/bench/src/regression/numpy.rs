//! The random numbers of NumPy's `default_rng(seed)`, bit for bit but for the last bit of a normal draw, so that the
//! task has the same data here as there: `SeedSequence` (O'Neill 2015), PCG64 (O'Neill 2014), uniform numbers of 53
//! bits, and normal ones by the ziggurat of Marsaglia and Tsang 2000 with 256 layers.

use rand::Rng;
use rand_pcg::Lcg128Xsl64;
use statrs::function::erf::erfc;

const LAYERS: usize = 256;
/// Right end of the ziggurat's base.
const END: f64 = 3.654_152_885_361_009;
/// 2^52: a layer's coordinate has 52 bits.
const UNIT: f64 = 4_503_599_627_370_496.0;

/// NumPy's default generator.
pub struct Generator {
    bits: Lcg128Xsl64,
    /// Width of each layer over 2^52.
    scale: [f64; LAYERS],
    /// Coordinates below this lie under the density for sure.
    inside: [u64; LAYERS],
    /// Density at each layer's right end, without its factor.
    height: [f64; LAYERS],
}

impl Generator {
    /// `numpy.random.default_rng(seed)`.
    pub fn new(seed: u32) -> Self {
        let [a, b, c, d] = seed_words(seed);
        let join = |high: u64, low: u64| (u128::from(high) << 64) | u128::from(low);
        let density = |x: f64| (-0.5 * x * x).exp();
        let tail = (0.5 * std::f64::consts::PI).sqrt() * erfc(END / std::f64::consts::SQRT_2);
        let area = END * density(END) + tail;
        let (mut scale, mut inside, mut height) = ([0.0; LAYERS], [0; LAYERS], [0.0; LAYERS]);
        let last = LAYERS - 1;
        // Layer 0 is the base strip with the tail, as wide as its area asks at the height of the lowest edge.
        scale[0] = area / density(END) / UNIT;
        inside[0] = (END * density(END) / area * UNIT) as u64;
        height[0] = 1.0;
        let mut x = END;
        (scale[last], height[last]) = (x / UNIT, density(x));
        for layer in (1..last).rev() {
            let next = (-2.0 * (area / x + density(x)).ln()).sqrt();
            inside[layer + 1] = (next / x * UNIT) as u64;
            (scale[layer], height[layer]) = (next / UNIT, density(next));
            x = next;
        }
        Self { bits: Lcg128Xsl64::new(join(a, b), join(c, d)), scale, inside, height }
    }

    /// Uniform in 0..1.
    fn unit(&mut self) -> f64 {
        (self.bits.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in `lo`..`hi`.
    pub fn uniform(&mut self, lo: f64, hi: f64) -> f64 {
        lo + (hi - lo) * self.unit()
    }

    /// Standard normal.
    pub fn normal(&mut self) -> f64 {
        loop {
            // From the low end: 8 bits of layer, the sign, 52 bits of coordinate.
            let bits = self.bits.next_u64();
            let layer = (bits & 0xff) as usize;
            let sign = if bits & 0x100 == 0 { 1.0 } else { -1.0 };
            let coordinate = (bits >> 9) & ((1 << 52) - 1);
            let x = coordinate as f64 * self.scale[layer];
            if coordinate < self.inside[layer] {
                return sign * x;
            }
            if layer == 0 {
                // The tail, whose sign is another bit.
                loop {
                    let beyond = -(-self.unit()).ln_1p() / END;
                    let y = -(-self.unit()).ln_1p();
                    if y + y > beyond * beyond {
                        let sign = if (coordinate >> 8) & 1 == 0 { 1.0 } else { -1.0 };
                        return sign * (END + beyond);
                    }
                }
            }
            let (low, high) = (self.height[layer], self.height[layer - 1]);
            if (high - low) * self.unit() + low < (-0.5 * x * x).exp() {
                return sign * x;
            }
        }
    }
}

/// The four words that `SeedSequence(seed)` gives to PCG64.
fn seed_words(seed: u32) -> [u64; 4] {
    let spread = |value: u32| value ^ (value >> 16);
    let mut multiplier: u32 = 0x43b0_d7e5;
    let mut hash = |value: u32| {
        let value = value ^ multiplier;
        multiplier = multiplier.wrapping_mul(0x931e_8875);
        spread(value.wrapping_mul(multiplier))
    };
    let mut pool = [seed, 0, 0, 0].map(&mut hash);
    for from in 0..4 {
        for to in (0..4).filter(|&to| to != from) {
            let (x, y) = (pool[to].wrapping_mul(0xca01_f9dd), hash(pool[from]).wrapping_mul(0x4973_f715));
            pool[to] = spread(x.wrapping_sub(y));
        }
    }
    let mut multiplier: u32 = 0x8b51_f9dd;
    let words: [u32; 8] = std::array::from_fn(|k| {
        let value = pool[k % 4] ^ multiplier;
        multiplier = multiplier.wrapping_mul(0x58f3_8ded);
        spread(value.wrapping_mul(multiplier))
    });
    std::array::from_fn(|k| u64::from(words[2 * k]) | (u64::from(words[2 * k + 1]) << 32))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Expected numbers are NumPy's.
    #[test]
    fn uniform_numbers_are_those_of_numpy() {
        let mut random = Generator::new(12345);
        assert_eq!(
            [random.uniform(0.0, 1.0), random.uniform(0.0, 1.0)],
            [0.227_336_022_467_169_66, 0.316_758_339_709_752_87]
        );
    }

    /// A million draws, of which some 260 are from the tail and 15,000 from the ziggurat's edges: their sums and the
    /// largest are NumPy's.
    #[test]
    fn normal_numbers_are_those_of_numpy() {
        let mut random = Generator::new(1);
        let (mut sum, mut largest, mut fourth) = (0.0, 0.0f64, 0.0);
        for _ in 0..1_000_000 {
            let z = random.normal();
            sum += z;
            largest = largest.max(z.abs());
            fourth += z.powi(4);
        }
        assert!((sum + 208.998_171_294_567_33).abs() < 1e-6, "{sum}");
        assert!((largest - 5.040_434_135_971_221).abs() < 1e-12, "{largest}");
        assert!((fourth - 2_995_353.292_255_763).abs() < 1e-3, "{fourth}");
    }
}
