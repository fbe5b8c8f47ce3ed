//! Edges of bins.

use crate::sorted;

/// Values this near to each other are one edge.
const SAME: f64 = 1e-9;

/// Edges of bins of the same width, from the first to the last.
pub fn even_edges(lo: f64, hi: f64, bins: usize) -> Vec<f64> {
    (0..=bins).map(|i| lo + (hi - lo) * i as f64 / bins as f64).collect()
}

/// Edges between which equally many of the values lie, from the least value to the greatest; half below and above a single value. None of no
/// values.
pub fn quantile_edges(values: &[f64], bins: usize) -> Vec<f64> {
    let sorted = sorted(values.iter().copied());
    let Some(last) = sorted.len().checked_sub(1) else { return Vec::new() };
    let mut edges: Vec<f64> = (0..=bins).map(|i| sorted[(i * last) / bins]).collect();
    edges.dedup_by(|a, b| (*a - *b).abs() < SAME);
    if edges.len() < 2 {
        edges = vec![edges[0] - 0.5, edges[0] + 0.5];
    }
    edges
}

/// Inner edges between which about equally many of the values lie, and further ones at the shares `ends` from both ends. None of no values.
pub fn inner_quantile_edges(values: &[f64], bins: usize, ends: &[f64]) -> Vec<f64> {
    let sorted = sorted(values.iter().copied());
    let Some(last) = sorted.len().checked_sub(1) else { return Vec::new() };
    let even = (1..bins).map(|i| i as f64 / bins as f64);
    let shares = ends.iter().copied().chain(even).chain(ends.iter().rev().map(|share| 1.0 - share));
    let mut edges: Vec<f64> = shares.map(|share| sorted[(share * last as f64) as usize]).collect();
    edges.dedup_by(|a, b| (*a - *b).abs() < SAME);
    edges
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_are_even_or_between_as_many_values() {
        assert_eq!(even_edges(1.0, 2.0, 4), [1.0, 1.25, 1.5, 1.75, 2.0]);
        let values: Vec<f64> = (0..=8).map(|i| f64::from(i * i)).collect();
        assert_eq!(quantile_edges(&values, 4), [0.0, 4.0, 16.0, 36.0, 64.0]);
        assert_eq!(quantile_edges(&[3.0, 3.0], 4), [2.5, 3.5]);
        assert_eq!(inner_quantile_edges(&values, 2, &[0.125]), [1.0, 16.0, 49.0]);
        assert!(quantile_edges(&[], 3).is_empty() && inner_quantile_edges(&[], 3, &[0.1]).is_empty());
    }
}
