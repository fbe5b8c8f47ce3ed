//! Standard normal numbers from random words, written like [`crate::elementary`]: no branches, the same bits
//! everywhere, but in f32, four to a vector register. The noise of a particle needs no more.

use std::f32::consts::LN_2;
use std::f64::consts::FRAC_PI_2;

use crate::elementary::polynomial;

/// Three standard normal numbers from a block of random words: a pair and half a pair of Box and Muller's.
#[inline]
pub(crate) fn normal_triple([radius1, angle1, radius2, angle2]: [u32; 4]) -> [f32; 3] {
    let (sin, cos) = sin_cos_of_word(angle1);
    let (r1, r2) = (radius(radius1), radius(radius2));
    [r1 * cos, r1 * sin, r2 * sin_cos_of_word(angle2).1]
}

/// sqrt(-2 ln u) for the uniform number u = (word + 1) / 2^32, of which 31 bits count.
#[inline]
fn radius(word: u32) -> f32 {
    const SPACING: f32 = 1.0 / (1_u32 << 31) as f32;
    // A signed conversion is one instruction. A sum that rounds to 1 gives radius 0.
    let u = (word >> 1) as i32 as f32 * SPACING + 0.5 * SPACING;
    (-2.0 * ln(u)).sqrt()
}

/// ln u for 2^-126 <= u <= 1, to within 6e-8 + 1.2e-7 |ln u|, with relative precision near 1.
#[inline]
fn ln(u: f32) -> f32 {
    // u = (1 + f) 2^e with 1 + f in [sqrt(1/2), sqrt 2).
    const SQRT_HALF: i32 = 0x3f35_04f3;
    let bits = u.to_bits() as i32;
    let e = (bits - SQRT_HALF) >> 23;
    let f = f32::from_bits((bits - (e << 23)) as u32) - 1.0;
    let second = polynomial!(
        f;
        -0.499_999_97,
        0.333_336_7,
        -0.250_011_47,
        0.199_720_5,
        -0.165_884_88,
        0.148_347_87,
        -0.141_596_47,
        0.087_872_654
    );
    e as f32 * LN_2 + (f + (f * f) * second)
}

/// Sine and cosine of the angle `word` * 2 pi / 2^32, each to within 1.2e-7.
#[inline]
fn sin_cos_of_word(word: u32) -> (f32, f32) {
    const STEP: f32 = (FRAC_PI_2 / (1_u32 << 30) as f64) as f32;
    // The nearest quarter turn and the remainder, exactly.
    let quarter = word.wrapping_add(1 << 29) >> 30;
    let x = word.wrapping_sub(quarter << 30) as i32 as f32 * STEP;
    let sq = x * x;
    let sin = x + (x * sq) * polynomial!(sq; -0.166_666_64, 0.008_332_748, -0.000_195_878_41);
    let cos = (1.0 - 0.5 * sq) + (sq * sq) * polynomial!(sq; 0.041_666_664, -0.001_388_830_2, 2.454_789_1e-5);
    let (sin, cos) = (sin.to_bits(), cos.to_bits());
    let swap = (sin ^ cos) & 0_u32.wrapping_sub(quarter & 1);
    let sin_sign = (quarter & 2) << 30;
    let cos_sign = (quarter.wrapping_add(1) & 2) << 30;
    (f32::from_bits(sin ^ swap ^ sin_sign), f32::from_bits(cos ^ swap ^ cos_sign))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    /// Words spread over the whole range, its ends among them.
    fn words() -> impl Iterator<Item = u32> {
        (0..=1_000_000_u32).map(|i| i.wrapping_mul(4295)).chain([1, 2, u32::MAX - 1, u32::MAX, 1 << 31])
    }

    #[test]
    fn angles_of_words_are_within_their_bound() {
        for word in words() {
            let angle = f64::from(word) / 2_f64.powi(32) * TAU;
            let (sin, cos) = sin_cos_of_word(word);
            assert!((f64::from(sin) - angle.sin()).abs() < 1.2e-7, "sin of {word}: {sin}");
            assert!((f64::from(cos) - angle.cos()).abs() < 1.2e-7, "cos of {word}: {cos}");
        }
    }

    #[test]
    fn logarithms_are_within_their_bound() {
        let near_one = (0..1000_u32).map(|i| 1.0 - i as f32 * f32::EPSILON / 2.0);
        let spread = (0..100_000_u32).map(|i| 2_f32.powf(-32.0 * i as f32 / 1e5));
        for u in near_one.chain(spread) {
            let expected = f64::from(u).ln();
            let error = (f64::from(ln(u)) - expected).abs();
            assert!(
                error <= 6e-8 * f64::min(1.0, expected.abs()) + 1.2e-7 * expected.abs(),
                "ln {u}: off by {error}"
            );
        }
    }

    #[test]
    fn radii_end_where_the_words_do() {
        assert_eq!(radius(u32::MAX), 0.0);
        let most = radius(0);
        assert!(most > 6.66 && most < 6.67, "{most}");
        assert!(words().all(|word| radius(word).is_finite()));
    }
}
