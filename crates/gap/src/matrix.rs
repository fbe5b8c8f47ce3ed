//! Small matrices.

/// Inverse of a small positive definite matrix (Gauss and Jordan); a ridge where it isn't.
pub(crate) fn invert(matrix: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let n = matrix.len();
    // Scaled to ones on the diagonal, so that units don't matter.
    let scale: Vec<f64> = (0..n).map(|i| matrix[i][i].max(1e-300).sqrt()).collect();
    let mut ridge = 0.0;
    loop {
        let mut left: Vec<Vec<f64>> = (0..n)
            .map(|i| {
                (0..n)
                    .map(|j| matrix[i][j] / (scale[i] * scale[j]) + if i == j { ridge } else { 0.0 })
                    .collect()
            })
            .collect();
        let mut right: Vec<Vec<f64>> =
            (0..n).map(|i| (0..n).map(|j| f64::from(u8::from(i == j))).collect()).collect();
        let mut positive = true;
        for i in 0..n {
            let pivot = left[i][i];
            if pivot < 1e-6 {
                positive = false;
                break;
            }
            for j in 0..n {
                left[i][j] /= pivot;
                right[i][j] /= pivot;
            }
            for row in 0..n {
                if row != i {
                    let factor = left[row][i];
                    for j in 0..n {
                        left[row][j] -= factor * left[i][j];
                        right[row][j] -= factor * right[i][j];
                    }
                }
            }
        }
        if positive {
            for i in 0..n {
                for j in 0..n {
                    right[i][j] /= scale[i] * scale[j];
                }
            }
            return right;
        }
        ridge = if ridge == 0.0 { 0.01 } else { 2.0 * ridge };
    }
}
