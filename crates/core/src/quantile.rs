//! Quantiles of samples by nearest rank: each is a value of the sample.

/// The quantile of values in any order, which this reorders; NaN of none.
pub fn quantile(values: &mut [f64], share: f64) -> f64 {
    if values.is_empty() {
        return f64::NAN;
    }
    let index = ((values.len() - 1) as f64 * share).round() as usize;
    *values.select_nth_unstable_by(index, f64::total_cmp).1
}

/// The median of values in any order, which this reorders: the upper one of an even number of values, NaN of none.
pub fn median(values: &mut [f64]) -> f64 {
    quantile(values, 0.5)
}

/// Items in at most `most` bins by a covariate, of as many items each and at least `least`: the mean covariate of each bin, and its items.
pub fn equal_bins(mut items: Vec<(f64, usize)>, most: usize, least: usize) -> Vec<(f64, Vec<usize>)> {
    items.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let count = most.min(items.len() / least);
    let bin = |bin: usize| {
        let part = &items[bin * items.len() / count..(bin + 1) * items.len() / count];
        let at = part.iter().map(|(at, _)| at).sum::<f64>() / part.len() as f64;
        (at, part.iter().map(|(_, item)| *item).collect())
    };
    (0..count).map(bin).collect()
}

/// Values in increasing order.
pub fn sorted(values: impl IntoIterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_by(f64::total_cmp);
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_values_of_the_sample() {
        assert_eq!(sorted([3.0, -1.0, 2.0]), [-1.0, 2.0, 3.0]);
        assert!(median(&mut []).is_nan());
        assert_eq!(median(&mut [3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&mut [4.0, 1.0, 3.0, 2.0]), 3.0, "the upper one of two");
        assert_eq!(quantile(&mut [4.0, 1.0, 3.0, 2.0, 0.0], 0.0), 0.0);
        assert_eq!(quantile(&mut [4.0, 1.0, 3.0, 2.0, 0.0], 0.3), 1.0);
        assert_eq!(quantile(&mut [4.0, 1.0, 3.0, 2.0, 0.0], 1.0), 4.0);
    }
}
