//! Inverse and quadratic form of a small information matrix.

use nalgebra::{Cholesky, DMatrix};

/// The least pivot of a matrix with ones on its diagonal: below it a row is as good as a combination of the others.
const LEAST_PIVOT: f64 = 1e-6;

/// The first ridge that makes a matrix positive definite; it doubles until it does.
const FIRST_RIDGE: f64 = 0.01;

/// Inverse of a small positive definite matrix; of one that isn't, with a ridge.
/// Of a matrix that is not finite, all entries are NaN.
pub fn invert(matrix: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let n = matrix.len();
    // Scaled to ones on the diagonal, so that units don't matter.
    let scale: Vec<f64> = (0..n).map(|i| matrix[i][i].max(1e-300).sqrt()).collect();
    let scaled = DMatrix::from_fn(n, n, |i, j| matrix[i][j] / (scale[i] * scale[j]));
    if scaled.iter().any(|value| !value.is_finite()) {
        return vec![vec![f64::NAN; n]; n];
    }
    let mut ridge = 0.0;
    loop {
        let ridged = &scaled + DMatrix::from_diagonal_element(n, n, ridge);
        let factors = Cholesky::new(ridged)
            .filter(|factors| factors.l_dirty().diagonal().iter().all(|pivot| pivot * pivot >= LEAST_PIVOT));
        if let Some(factors) = factors {
            let inverse = factors.inverse();
            return (0..n)
                .map(|i| (0..n).map(|j| inverse[(i, j)] / (scale[i] * scale[j])).collect())
                .collect();
        }
        ridge = if ridge == 0.0 { FIRST_RIDGE } else { 2.0 * ridge };
    }
}

/// The quadratic form of a square matrix at a vector of as many numbers.
pub fn quadratic(matrix: &[Vec<f64>], v: &[f64]) -> f64 {
    matrix.iter().zip(v).map(|(row, a)| a * row.iter().zip(v).map(|(m, b)| m * b).sum::<f64>()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_times_the_matrix_is_the_identity() {
        let matrix = [[4.0e6, 1.0e2, 5.0], [1.0e2, 3.0e-2, 1.0e-4], [5.0, 1.0e-4, 2.0e-5]].map(Vec::from);
        let inverse = invert(&matrix);
        for i in 0..3 {
            for j in 0..3 {
                let product: f64 = (0..3).map(|k| inverse[i][k] * matrix[k][j]).sum();
                let unit = (matrix[j][j] / matrix[i][i]).sqrt();
                assert!(
                    (product - f64::from(u8::from(i == j))).abs() < 1e-12 * unit.max(1.0),
                    "{i} {j}: {product}"
                );
            }
        }
    }

    #[test]
    fn what_is_not_finite_has_no_inverse_and_ends() {
        for wrong in [f64::NAN, f64::INFINITY] {
            let inverse = invert(&[vec![1.0, wrong], vec![wrong, 2.0]]);
            assert!(inverse.iter().flatten().all(|value| value.is_nan()));
        }
    }

    /// Two rows that are the same but for their units: the ridge shares the information between them.
    #[test]
    fn a_singular_matrix_gets_a_ridge() {
        let inverse = invert(&[vec![4.0, 2.0], vec![2.0, 1.0]]);
        let expected = |i: f64, j: f64, same: bool| {
            let (a, b) = (1.0 + FIRST_RIDGE, 1.0);
            (if same { a } else { -b }) / (a * a - b * b) / (i * j)
        };
        for (found, expected) in [
            (inverse[0][0], expected(2.0, 2.0, true)),
            (inverse[0][1], expected(2.0, 1.0, false)),
            (inverse[1][1], expected(1.0, 1.0, true)),
        ] {
            assert!((found / expected - 1.0).abs() < 1e-9, "{found} {expected}");
        }
    }
}
