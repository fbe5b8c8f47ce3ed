//! What the other readings of a scan say of one.

use statrs::statistics::{Data, OrderStatistics};

/// Standard deviation of normal numbers over their median absolute deviation.
const SIGMA_OVER_MAD: f64 = 1.4826;
/// Fewer other readings of a scan say nothing of it.
const FEWEST_OTHERS: f64 = 8.0;

/// For each reading, by the number of its scan and what it is more than expected, the mean of that of its scan's others; `None` of few.
pub fn mean_of_others(excess: impl Iterator<Item = (usize, f64)>) -> impl Iterator<Item = Option<f64>> {
    let excess: Vec<(usize, f64)> = excess.collect();
    let mut sums = vec![[0.0; 2]; excess.last().map_or(0, |(scan, _)| scan + 1)];
    for &(scan, more) in &excess {
        sums[scan][0] += 1.0;
        sums[scan][1] += more;
    }
    excess.into_iter().map(move |(scan, own)| {
        let [count, sum] = sums[scan];
        (count > FEWEST_OTHERS).then(|| (sum - own) / (count - 1.0))
    })
}

/// For each reading, by the number of its scan and its error, the variance of the errors of its scan's others, by their median absolute deviation;
/// `None` of few. Clutter just before a wall makes a mean square large, and hardly changes a median.
pub fn variances_of_others(
    errors: impl Iterator<Item = (usize, Option<f64>)>,
) -> impl Iterator<Item = Option<f64>> {
    let errors: Vec<(usize, Option<f64>)> = errors.collect();
    let mut deviations: Vec<Vec<f64>> = vec![Vec::new(); errors.last().map_or(0, |(scan, _)| scan + 1)];
    for &(scan, error) in &errors {
        deviations[scan].extend(error);
    }
    let medians: Vec<f64> = deviations
        .iter_mut()
        .map(|errors| {
            let middle = Data::new(&mut errors[..]).median();
            for error in errors.iter_mut() {
                *error = (*error - middle).abs();
            }
            errors.sort_by(f64::total_cmp);
            middle
        })
        .collect();
    errors.into_iter().map(move |(scan, error)| {
        let sorted = &deviations[scan];
        let own = error.map(|error| sorted.partition_point(|other| *other < (error - medians[scan]).abs()));
        let count = sorted.len() - usize::from(own.is_some());
        let at = |rank: usize| sorted[rank + usize::from(own.is_some_and(|own| own <= rank))];
        let middle = || 0.5 * (at((count - 1) / 2) + at(count / 2));
        (count as f64 >= FEWEST_OTHERS).then(|| (SIGMA_OVER_MAD * middle()).powi(2))
    })
}

#[cfg(test)]
mod tests {
    use statrs::distribution::{ContinuousCDF, Normal};

    use super::*;

    fn median(values: Vec<f64>) -> f64 {
        Data::new(values).median()
    }

    /// Ten readings in one scan, nine in the next, three in the last: too few.
    #[test]
    fn a_reading_does_not_count_for_itself() {
        let scans = [0, 1, 2]
            .into_iter()
            .zip([10, 9, 3])
            .flat_map(|(scan, count)| (0..count).map(move |i| (scan, i)));
        let values: Vec<(usize, f64)> = scans.map(|(scan, i)| (scan, f64::from(i))).collect();
        let means: Vec<_> = mean_of_others(values.iter().copied()).collect();
        let variances: Vec<_> =
            variances_of_others(values.iter().map(|&(scan, value)| (scan, Some(value)))).collect();
        for (k, &(scan, own)) in values.iter().enumerate() {
            let others: Vec<f64> =
                values.iter().enumerate().filter(|(j, v)| *j != k && v.0 == scan).map(|(_, v)| v.1).collect();
            let mean = others.iter().sum::<f64>() / others.len() as f64;
            // The middle is that of all of the scan's.
            let of_scan = |v: &&(usize, f64)| v.0 == scan;
            let middle = median(values.iter().filter(of_scan).map(|v| v.1).collect());
            let deviation = median(others.iter().map(|v| (v - middle).abs()).collect());
            let variance = (SIGMA_OVER_MAD * deviation).powi(2);
            let near = |found: Option<f64>, expected: f64| {
                found.is_some_and(|found| (found - expected).abs() < 1e-9)
            };
            match scan {
                2 => assert_eq!((means[k], variances[k]), (None, None)),
                _ => assert!(
                    near(means[k], mean) && near(variances[k], variance),
                    "{own}: {:?} {:?}",
                    means[k],
                    variances[k]
                ),
            }
        }
    }

    /// A fifth of a scan's readings is of clutter, seven standard deviations in front.
    #[test]
    fn clutter_is_no_noise_of_a_scan() {
        let normal = Normal::standard();
        let error = |i| if i % 5 == 0 { -7.0 } else { normal.inverse_cdf((f64::from(i) + 0.5) / 60.0) };
        let errors = (0..60).map(|i| (0, Some(error(i))));
        let variances: Vec<f64> = variances_of_others(errors).flatten().collect();
        assert!(variances.len() == 60 && variances.iter().all(|v| (0.7..2.0).contains(v)), "{variances:?}");
    }
}
