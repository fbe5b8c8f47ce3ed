//! Newton steps by differences of log likelihoods.

use crate::matrix::invert;

/// How far each number is from the maximum of each log likelihood, as \[number\]\[log\]. `totals` are log likelihoods as \[log\]\[at the numbers
/// themselves, with each a step up and down, with each two up\]; the information is the mean of all. `None` where there is no maximum.
pub fn newton_steps(totals: &[Vec<f64>], steps: &[f64]) -> Option<Vec<Vec<f64>>> {
    let n = steps.len();
    let mean = |of: &dyn Fn(&Vec<f64>) -> f64| totals.iter().map(of).sum::<f64>() / totals.len() as f64;
    let (up, down) = (|i: usize| 1 + 2 * i, |i: usize| 2 + 2 * i);
    let mut information = vec![vec![0.0; n]; n];
    let mut both = 1 + 2 * n;
    for i in 0..n {
        information[i][i] = mean(&|t| 2.0 * t[0] - t[up(i)] - t[down(i)]) / steps[i].powi(2);
        if !(information[i][i] > 0.0 && information[i][i].is_finite()) {
            return None;
        }
        for j in 0..i {
            let mixed = mean(&|t| t[both] - t[up(i)] - t[up(j)] + t[0]) / (steps[i] * steps[j]);
            let most = 0.98 * (information[i][i] * information[j][j]).sqrt();
            information[i][j] = (-mixed).clamp(-most, most);
            information[j][i] = information[i][j];
            both += 1;
        }
    }
    if information.iter().flatten().any(|value| !value.is_finite()) {
        return None;
    }
    let inverse = invert(&information);
    let gradient = |t: &Vec<f64>, i: usize| (t[up(i)] - t[down(i)]) / (2.0 * steps[i]);
    let step = |row: &Vec<f64>, t: &Vec<f64>| {
        row.iter().enumerate().map(|(i, inverse)| inverse * gradient(t, i)).sum::<f64>()
    };
    Some(inverse.iter().map(|row| totals.iter().map(|t| step(row, t)).collect()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of a quadratic log likelihood the step leads to the maximum.
    #[test]
    fn a_newton_step_finds_the_maximum_of_a_parabola() {
        let likelihood = |x: f64, y: f64, at: [f64; 2]| {
            let (dx, dy) = (x - at[0], y - at[1]);
            -0.5 * (4.0 * dx * dx + 2.0 * 1.5 * dx * dy + 9.0 * dy * dy)
        };
        let (sx, sy) = (0.1, 0.2);
        let maxima = [[0.3, -0.2], [-0.1, 0.4], [0.05, 0.1]];
        let totals: Vec<Vec<f64>> = maxima
            .iter()
            .map(|&at| {
                [(0.0, 0.0), (sx, 0.0), (-sx, 0.0), (0.0, sy), (0.0, -sy), (sx, sy)]
                    .map(|(x, y)| likelihood(x, y, at))
                    .to_vec()
            })
            .collect();
        let shifts = newton_steps(&totals, &[sx, sy]).unwrap();
        for (log, at) in maxima.iter().enumerate() {
            for axis in 0..2 {
                assert!((shifts[axis][log] - at[axis]).abs() < 1e-9, "{axis} {log}");
            }
        }
        let upside_down: Vec<Vec<f64>> =
            totals.iter().map(|t| t.iter().map(|value| -value).collect()).collect();
        assert!(newton_steps(&upside_down, &[sx, sy]).is_none());
    }
}
