//! Reductions over long slices in a fixed order that suits vector instructions: [`LANES`] interleaved partial results,
//! combined at the end. Compilers must not reorder a plain sum, and would add one number at a time.

/// Number of partial results.
const LANES: usize = 4;

/// Sums of `K` functions of each value.
#[inline]
pub(crate) fn lane_sums<const K: usize>(values: &[f64], f: impl Fn(f64) -> [f64; K]) -> [f64; K] {
    let mut lanes = [[0.0; LANES]; K];
    let mut add = |lane: usize, value: f64| {
        for (lanes, term) in lanes.iter_mut().zip(f(value)) {
            lanes[lane] += term;
        }
    };
    let blocks = values.chunks_exact(LANES);
    let rest = blocks.remainder();
    for block in blocks {
        for (lane, value) in block.iter().enumerate() {
            add(lane, *value);
        }
    }
    for (lane, value) in rest.iter().enumerate() {
        add(lane, *value);
    }
    lanes.map(|[a, b, c, d]| (a + c) + (b + d))
}

/// The greatest `a[i] + b[i]`, minus infinity for none. NaN counts as nothing.
#[inline]
pub(crate) fn greatest_sum(a: &[f64], b: &[f64]) -> f64 {
    let greater = |best: f64, value: f64| if value > best { value } else { best };
    let mut lanes = [f64::NEG_INFINITY; LANES];
    let (a_blocks, b_blocks) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest = a_blocks.remainder().iter().zip(b_blocks.remainder());
    for (a, b) in a_blocks.zip(b_blocks) {
        for (best, (a, b)) in lanes.iter_mut().zip(a.iter().zip(b)) {
            *best = greater(*best, a + b);
        }
    }
    for (best, (a, b)) in lanes.iter_mut().zip(rest) {
        *best = greater(*best, a + b);
    }
    lanes.into_iter().fold(f64::NEG_INFINITY, greater)
}

/// Whether all values are numbers below infinity, minus infinity included.
#[inline]
pub(crate) fn all_below_infinity(values: &[f64]) -> bool {
    // Counting has no branches; `all` stops at the first.
    values.iter().filter(|value| **value < f64::INFINITY).count() == values.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_counts_once_at_any_length() {
        for n in 0..40_u32 {
            let values: Vec<f64> = (0..n).map(f64::from).collect();
            let [sum, squares] = lane_sums(&values, |v| [v, v * v]);
            let n = f64::from(n);
            assert_eq!((sum, squares), (n * (n - 1.0) / 2.0, (n - 1.0) * n * (2.0 * n - 1.0) / 6.0));
        }
    }

    #[test]
    fn the_greatest_sum_is_found_at_any_place() {
        for n in 1..40 {
            for best in 0..n {
                let mut a = vec![-1.0; n];
                a[best] = 2.0;
                assert_eq!(greatest_sum(&a, &vec![0.5; n]), 2.5);
            }
        }
        assert_eq!(greatest_sum(&[], &[]), f64::NEG_INFINITY);
        assert_eq!(greatest_sum(&[f64::NEG_INFINITY; 9], &[0.0; 9]), f64::NEG_INFINITY);
    }

    #[test]
    fn a_single_value_that_is_not_below_infinity_shows() {
        for n in 1..20 {
            let mut values = vec![f64::NEG_INFINITY; n];
            assert!(all_below_infinity(&values));
            for bad in [f64::NAN, f64::INFINITY] {
                values[n - 1] = bad;
                assert!(!all_below_infinity(&values));
            }
        }
    }
}
