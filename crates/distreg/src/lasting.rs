//! Whether errors that last have a mean, or a slope, beyond what they have by chance.

/// Errors that last for up to this share of the series are known for what they are.
const BANDWIDTH: f64 = 0.5;
/// The 99 % quantile of a mean in its standard errors, where those are estimated with Bartlett's weights over that share of the series
/// (Kiefer and Vogelsang 2005, table 1): 2.3263 + 4.1618 b + .5368 b^2 - .9060 b^3. It is 2.33 where they are known.
pub const QUANTILE_99: f64 = 4.428;
/// The same of 97.5 %: 1.9600 + 2.9694 b + .4160 b^2 - .5324 b^3.
pub const QUANTILE_975: f64 = 3.482;

/// The slope through the origin of errors on something else, pairs in the order of time, in standard errors that know that errors last
/// (Newey and West 1987); 0 of fewer than ten pairs.
pub fn slope(pairs: &[[f64; 2]]) -> f64 {
    let squares: f64 = pairs.iter().map(|[_, x]| x * x).sum();
    if pairs.len() < 10 || squares <= 0.0 {
        return 0.0;
    }
    let slope = pairs.iter().map(|[error, x]| error * x).sum::<f64>() / squares;
    let scores: Vec<f64> = pairs.iter().map(|[error, x]| x * (error - slope * x)).collect();
    let products = |lag: usize| scores.iter().zip(&scores[lag..]).map(|(a, b)| a * b).sum::<f64>();
    let most = (BANDWIDTH * scores.len() as f64) as usize;
    let weight = |lag: usize| 2.0 * (1.0 - lag as f64 / (most + 1) as f64);
    let together: f64 = (1..=most).map(|lag| weight(lag) * products(lag)).sum();
    let variance = products(0) + together.max(0.0);
    slope * squares / variance.sqrt().max(1e-300)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Uniform errors from -1 to 1 about a mean (a linear congruential generator, Numerical Recipes), each of which lasts for so many steps, on
    /// what is 1 everywhere.
    fn errors(mean: f64, lasts: usize) -> Vec<[f64; 2]> {
        let mut state = 7_u32;
        let mut draw = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            2.0 * f64::from(state) / f64::from(u32::MAX) - 1.0
        };
        (0..400 / lasts).map(|_| mean + draw()).flat_map(|error| vec![[error, 1.0]; lasts]).collect()
    }

    /// Independent errors of .58 have a mean to .029; those that last for forty steps are ten errors, with a mean to .18.
    #[test]
    fn what_lasts_tells_less() {
        let [alone, lasting] = [1, 40].map(|lasts| slope(&errors(0.25, lasts)).abs());
        assert!((QUANTILE_99..12.0).contains(&alone), "{alone}");
        assert!(lasting < QUANTILE_975, "{lasting}");
    }

    /// By ordinary least squares, where no error has to do with the next.
    #[test]
    fn a_slope_is_that_of_least_squares() {
        let pairs: Vec<[f64; 2]> =
            (0..40).map(|i| [f64::from(i % 2) - 0.5 + 0.2 * f64::from(i), f64::from(i)]).collect();
        let squares: f64 = pairs.iter().map(|[_, x]| x * x).sum();
        let k = pairs.iter().map(|[e, x]| e * x).sum::<f64>() / squares;
        let variance: f64 = pairs.iter().map(|[e, x]| (x * (e - k * x)).powi(2)).sum();
        assert!((slope(&pairs) - k * squares / variance.sqrt()).abs() < 1e-9);
        assert_eq!(slope(&pairs[..9]), 0.0);
    }
}
