//! Elementary functions for loops over many particles.
//!
//! They have no branches, no calls and no tables, so that the compiler turns such loops into vector instructions. They
//! use only operations that IEEE 754 rounds the same way everywhere, so that results have the same bits on every machine;
//! the system's own functions do not promise that.
//!
//! Each function reduces its argument to a short interval about 0, by subtracting multiples of a constant in two parts
//! (Cody and Waite 1980). There it evaluates a polynomial that interpolates the function at Chebyshev nodes (Muller 2016).

use std::f64::consts::{FRAC_2_PI, LOG2_E};

/// A number of magnitude below 2^51 plus this, minus this, is that number rounded to a whole one: doubles of this
/// size, 1.5 * 2^52, have no fraction. The low bits of the sum are those of the whole number.
pub(crate) const ROUND: f64 = 6_755_399_441_055_744.0;

/// `polynomial!(x; c0, c1, c2, ...)` is c0 + c1 x + c2 x^2 + ... by Estrin's scheme: neighbours are paired,
/// (c0 + c1 x) + (c2 + c3 x) x^2 + ..., and the pairs are a polynomial in x^2. Horner's scheme is one long chain of
/// operations that wait for each other.
macro_rules! polynomial {
    ($x:expr; $last:expr) => { $last };
    ($x:expr; $($c:expr),+) => {{ let x = $x; polynomial!(@pair x; []; $($c),+) }};
    (@pair $x:ident; [$($pair:expr),*]; $a:expr, $b:expr, $($rest:expr),+) => {
        polynomial!(@pair $x; [$($pair,)* $a + $b * $x]; $($rest),+)
    };
    (@pair $x:ident; [$($pair:expr),*]; $a:expr, $b:expr) => { polynomial!($x * $x; $($pair,)* $a + $b * $x) };
    (@pair $x:ident; [$($pair:expr),*]; $a:expr) => { polynomial!($x * $x; $($pair,)* $a) };
}
pub(crate) use polynomial;

/// Sine and cosine of an angle (rad), each to within 3e-16 up to a million radians. Beyond that they lose
/// precision as the angle itself does; from 1e15 on they are finite numbers without meaning.
#[inline]
pub fn sin_cos(angle: f64) -> (f64, f64) {
    // pi / 2 in two parts; the first has 33 bits, so that its products with up to 2^20 quarter turns are exact.
    const QUARTER: f64 = 1.570_796_326_734_125_6;
    const QUARTER_REST: f64 = 6.077_100_506_506_192e-11;
    let rounded = angle * FRAC_2_PI + ROUND;
    let quarters = rounded - ROUND;
    let rest = (angle - quarters * QUARTER) - quarters * QUARTER_REST;
    let (sin, cos) = sin_cos_near_zero(rest.clamp(-1.0, 1.0));

    // Each quarter turn makes a sine of a cosine and a negative cosine of a sine.
    let quarter = rounded.to_bits();
    let (sin, cos) = (sin.to_bits(), cos.to_bits());
    let swap = (sin ^ cos) & 0_u64.wrapping_sub(quarter & 1);
    let sin_sign = (quarter & 2) << 62;
    let cos_sign = (quarter.wrapping_add(1) & 2) << 62;
    (f64::from_bits(sin ^ swap ^ sin_sign), f64::from_bits(cos ^ swap ^ cos_sign))
}

/// [`sin_cos`] of an angle (rad) from -pi/4 to pi/4, at half the cost.
#[inline]
pub fn sin_cos_near_zero(angle: f64) -> (f64, f64) {
    let sq = angle * angle;
    let sin = polynomial!(
        sq;
        -0.166_666_666_666_666_66,
        0.008_333_333_333_330_946,
        -0.000_198_412_698_367_549_7,
        2.755_731_610_068_303e-6,
        -2.505_113_145_542_795e-8,
        1.591_810_123_027_412e-10
    );
    let cos = polynomial!(
        sq;
        0.041_666_666_666_666_664,
        -0.001_388_888_888_888_739_5,
        2.480_158_729_876_343_3e-5,
        -2.755_731_727_056_032_6e-7,
        2.087_614_602_468_974_7e-9,
        -1.138_261_486_855_632_5e-11
    );
    (angle + (angle * sq) * sin, (1.0 - 0.5 * sq) + (sq * sq) * cos)
}

/// exp(x) for x <= 0, to within a relative 4e-16; 0 below -708, where results would soon be denormal.
#[inline]
pub(crate) fn exp_nonpositive(x: f64) -> f64 {
    const LOWEST: f64 = -708.0;
    // ln 2 in two parts; the first has 33 bits.
    const LN_2: f64 = 0.693_147_180_485_539_1;
    const LN_2_REST: f64 = 7.440_617_110_012_397e-11;
    let clamped = if x > LOWEST { x } else { LOWEST };
    let rounded = clamped * LOG2_E + ROUND;
    let doublings = rounded - ROUND;
    let r = (clamped - doublings * LN_2) - doublings * LN_2_REST;
    let second = polynomial!(
        r;
        0.5,
        0.166_666_666_666_666_69,
        0.041_666_666_666_624_13,
        0.008_333_333_333_330_062,
        0.001_388_888_891_721_371_7,
        0.000_198_412_698_630_536_18,
        2.480_152_129_595_437_6e-5,
        2.755_726_845_999_706_4e-6,
        2.762_008_844_540_974_6e-7,
        2.510_038_549_551_032e-8
    );
    let exp = 1.0 + (r + (r * r) * second);
    // exp is in [0.7, 1.42]: adding to its exponent multiplies it by a power of two.
    let scaled = f64::from_bits(exp.to_bits().wrapping_add(rounded.to_bits() << 52));
    if x >= LOWEST { scaled } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The reference, the system's, is itself within 0.6 units in the last place.
    #[test]
    fn sines_and_cosines_are_within_their_bound() {
        for (step, count) in [(1e-5, 1_000_000), (0.9, 1_000_000), (std::f64::consts::FRAC_PI_4, 100_000)] {
            for i in -count..=count {
                let angle = step * f64::from(i);
                let (sin, cos) = sin_cos(angle);
                assert!((sin - angle.sin()).abs() <= 3e-16, "sin {angle}: {sin}");
                assert!((cos - angle.cos()).abs() <= 3e-16, "cos {angle}: {cos}");
            }
        }
        // Near 0 a sine keeps its relative precision.
        for angle in [1e-300_f64, -1e-9, 1e-3] {
            assert!((sin_cos(angle).0 / angle.sin() - 1.0).abs() < 3e-16);
        }
    }

    #[test]
    fn near_zero_they_are_the_same_function() {
        for i in -1000..=1000 {
            let angle = f64::from(i) / 1000.0 * std::f64::consts::FRAC_PI_4;
            assert_eq!(sin_cos_near_zero(angle), sin_cos(angle));
        }
    }

    #[test]
    fn sines_and_cosines_of_absurd_angles_are_finite() {
        for angle in [1e12, -1e16, 1e300, f64::MAX] {
            let (sin, cos) = sin_cos(angle);
            assert!(sin.abs() <= 1.0 && cos.abs() <= 1.0, "{angle}: {sin}, {cos}");
        }
        assert!(sin_cos(f64::NAN).0.is_nan() && sin_cos(f64::INFINITY).1.is_nan());
    }

    #[test]
    fn exponentials_are_within_their_bound() {
        for i in 0..=1_000_000 {
            let x = -707.9 * (f64::from(i) / 1e6).powi(3);
            let (got, expected) = (exp_nonpositive(x), x.exp());
            assert!((got / expected - 1.0).abs() <= 4e-16, "exp {x}: {got}, expected {expected}");
        }
        assert_eq!(exp_nonpositive(0.0), 1.0);
        assert!(exp_nonpositive(-708.0) > 0.0);
        for x in [-708.1, -1e4, -1e300, f64::NEG_INFINITY] {
            assert_eq!(exp_nonpositive(x), 0.0);
        }
    }
}
