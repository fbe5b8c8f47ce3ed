//! What the other readings of a scan say of one.

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

/// For each reading, by the number of its scan and its error, the variance of the errors of its scan's others about their mean; `None` of few.
pub fn variances_of_others(
    errors: impl Iterator<Item = (usize, Option<f64>)>,
) -> impl Iterator<Item = Option<f64>> {
    let errors: Vec<(usize, Option<f64>)> = errors.collect();
    let moments = |error: Option<f64>| error.map_or([0.0; 3], |error| [1.0, error, error * error]);
    let mut sums = vec![[0.0; 3]; errors.last().map_or(0, |(scan, _)| scan + 1)];
    for &(scan, error) in &errors {
        sums[scan].iter_mut().zip(moments(error)).for_each(|(sum, more)| *sum += more);
    }
    errors.into_iter().map(move |(scan, own)| {
        let own = moments(own);
        let [count, sum, squares] = [0, 1, 2].map(|i| sums[scan][i] - own[i]);
        (count >= FEWEST_OTHERS).then(|| ((squares - sum * sum / count) / (count - 1.0)).max(0.0))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

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
            let variance =
                others.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (others.len() as f64 - 1.0);
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
}
