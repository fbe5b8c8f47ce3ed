//! Whether errors that last have a mean, or a slope, beyond what they have by chance.

/// Errors that last for up to this share of the series are known for what they are.
const BANDWIDTH: f64 = 0.5;
/// The 99 % quantile of a mean in its standard errors, where those are estimated with Bartlett's weights over that share of the series
/// (Kiefer and Vogelsang 2005, table 1): 2.3263 + 4.1618 b + .5368 b^2 - .9060 b^3. It is 2.33 where they are known.
pub const QUANTILE_99: f64 = 4.428;
/// The same of 97.5 %: 1.9600 + 2.9694 b + .4160 b^2 - .5324 b^3.
pub const QUANTILE_975: f64 = 3.482;

/// Errors are seen to last where their autocorrelations over this share of the series, from the second on, sum to more than independent ones'
/// do in 95 of 100 series.
const SEEN_OVER: f64 = 0.1;
const QUANTILE_95: f64 = 1.645;
/// Standard errors are larger by this where errors are seen to last: those that last for a fifth of the series have too few turns in it for
/// Bartlett's weights. By simulation of such errors, 4 % of series without a mean are beyond [`QUANTILE_99`] with it and 13 % without.
const SEEN: f64 = 1.8;

/// The slope through the origin of errors on something else, pairs in the order of time, in standard errors that know that errors last
/// (Newey and West 1987); 0 of fewer than ten pairs.
pub fn slope(pairs: &[[f64; 2]]) -> f64 {
    let squares: f64 = pairs.iter().map(|[_, x]| x * x).sum();
    if pairs.len() < 10 || squares <= 0.0 {
        return 0.0;
    }
    let slope = pairs.iter().map(|[error, x]| error * x).sum::<f64>() / squares;
    let scores: Vec<f64> = pairs.iter().map(|[error, x]| x * (error - slope * x)).collect();
    let seen = if are_seen_to_last(&scores) { SEEN } else { 1.0 };
    slope * squares / (seen * error_of_sum(&scores)).max(1e-300)
}

/// The mean of values in the order of time, and its standard error, which knows that errors last. [`QUANTILE_975`] of these make half of a
/// 95 % interval. NaN of no values.
pub fn mean(values: &[f64]) -> [f64; 2] {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let scores: Vec<f64> = values.iter().map(|value| value - mean).collect();
    [mean, error_of_sum(&scores) / count]
}

/// Standard error of the sum of scores whose mean is 0.
fn error_of_sum(scores: &[f64]) -> f64 {
    let products = |lag: usize| scores.iter().zip(&scores[lag..]).map(|(a, b)| a * b).sum::<f64>();
    let most = (BANDWIDTH * scores.len() as f64) as usize;
    let weight = |lag: usize| 2.0 * (1.0 - lag as f64 / (most + 1) as f64);
    let together: f64 = (1..=most).map(|lag| weight(lag) * products(lag)).sum();
    (products(0) + together.max(0.0)).sqrt()
}

/// Whether scores are surely correlated in time. The first lag is left out: an error of a position makes two steps err the opposite way.
fn are_seen_to_last(scores: &[f64]) -> bool {
    let most = (SEEN_OVER * scores.len() as f64) as usize;
    let (mut sum, mut squares) = (0.0, 0.0);
    let all: f64 = scores.iter().map(|score| score * score).sum();
    for lag in 2..=most {
        let weight = 1.0 - lag as f64 / (most + 1) as f64;
        let products: f64 = scores.iter().zip(&scores[lag..]).map(|(a, b)| a * b).sum();
        // Less their mean, scores are correlated by so much the other way.
        sum += weight * (products / all + 1.0 / scores.len() as f64);
        squares += weight * weight;
    }
    all > 0.0 && sum > QUANTILE_95 * (squares / scores.len() as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Uniform errors from -1 to 1 about a mean (a linear congruential generator, Numerical Recipes), each of which lasts for so many steps, on
    /// what is 1 everywhere.
    fn errors(mean: f64, lasts: usize) -> Vec<[f64; 2]> {
        errors_of(7, mean, lasts)
    }

    fn errors_of(seed: u32, mean: f64, lasts: usize) -> Vec<[f64; 2]> {
        let mut state = seed;
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

    /// The interval of the mean of 400 independent errors of .58 is .2 wide, as a bandwidth of half the series asks for much. It holds the
    /// true mean in some 19 of 20 series, and so does that of errors which last for twenty steps.
    #[test]
    fn an_interval_of_a_mean_holds_it() {
        for (lasts, widths) in [(1, 0.07..0.15), (20, 0.3..0.6)] {
            let intervals = (0..200).map(|seed| {
                let values: Vec<f64> =
                    errors_of(7_919 * seed + 1, 0.4, lasts).into_iter().map(|[value, _]| value).collect();
                let [mean, error] = mean(&values);
                (((mean - 0.4).abs() <= QUANTILE_975 * error), QUANTILE_975 * error)
            });
            let (held, half): (Vec<bool>, Vec<f64>) = intervals.unzip();
            // Of 200 with a share of .95 fewer than 180 hold it once in a thousand; lasting ones hold it a little more rarely.
            assert!(held.iter().filter(|held| **held).count() >= 176, "{lasts}");
            let half = half.iter().sum::<f64>() / 200.0;
            assert!(widths.contains(&half), "{lasts}: {half}");
        }
    }

    /// Of series of five errors without a mean, one in thirty has one by chance; independent errors are hardly ever seen to last.
    #[test]
    fn few_series_have_a_mean_by_chance() {
        let count = |lasts: usize, is: &dyn Fn(&[[f64; 2]]) -> bool| {
            (0..400).filter(|seed| is(&errors_of(7_919 * seed + 1, 0.0, lasts))).count()
        };
        let has_mean = |errors: &[[f64; 2]]| slope(errors).abs() > QUANTILE_99;
        let lasts = |errors: &[[f64; 2]]| {
            are_seen_to_last(&errors.iter().map(|[error, _]| *error).collect::<Vec<_>>())
        };
        let (few, none, seen) = (count(80, &has_mean), count(1, &has_mean), count(1, &lasts));
        assert!(few <= 24 && none <= 16 && seen <= 36, "{few} {none} {seen}");
        assert!(count(80, &lasts) > 390);
    }

    /// By ordinary least squares, where no error has to do with the next.
    #[test]
    fn a_slope_is_that_of_least_squares() {
        let pairs: Vec<[f64; 2]> = errors(0.0, 1)
            .iter()
            .take(40)
            .zip(0..)
            .map(|([e, _], i)| [e + 0.2 * f64::from(i), f64::from(i)])
            .collect();
        let squares: f64 = pairs.iter().map(|[_, x]| x * x).sum();
        let k = pairs.iter().map(|[e, x]| e * x).sum::<f64>() / squares;
        let variance: f64 = pairs.iter().map(|[e, x]| (x * (e - k * x)).powi(2)).sum();
        assert!((slope(&pairs) - k * squares / variance.sqrt()).abs() < 1e-9);
        assert_eq!(slope(&pairs[..9]), 0.0);
    }
}
