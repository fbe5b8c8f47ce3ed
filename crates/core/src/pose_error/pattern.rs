use glam::DVec3;
use nalgebra::{DMatrix, DVector};

use super::information::PoseInformation;
use super::process::PoseError;
use super::smoother::smooth_pose_errors;

/// Data of scans after the least-squares fit of errors in these patterns is subtracted. Each pattern has an error for each scan.
pub fn without_patterns(scans: &[PoseInformation], patterns: &[Vec<DVec3>]) -> Vec<PoseInformation> {
    let sum = |of: &dyn Fn(usize) -> f64| (0..scans.len()).map(of).sum::<f64>();
    let count = patterns.len();
    let normal = DMatrix::from_fn(count, count, |row, column| {
        sum(&|i| patterns[row][i].dot(scans[i].matrix * patterns[column][i]))
    });
    let data = DVector::from_fn(count, |row, _| sum(&|i| patterns[row][i].dot(scans[i].vector)));
    // Each in its own scale. Patterns that scans can't tell apart share what they have in common.
    let scale = DVector::from_fn(count, |i, _| normal[(i, i)].max(f64::MIN_POSITIVE).sqrt().recip());
    let scaled = DMatrix::from_fn(count, count, |i, j| normal[(i, j)] * scale[i] * scale[j]);
    let numbers = scaled.svd(true, true).solve(&data.component_mul(&scale), 1e-12);
    let numbers = numbers.map_or_else(|_| DVector::zeros(count), |numbers| numbers.component_mul(&scale));
    let shift = |i: usize| patterns.iter().zip(&numbers).map(|(p, number)| *number * p[i]).sum::<DVec3>();
    let left = scans.iter().enumerate().map(|(i, scan)| PoseInformation {
        matrix: scan.matrix,
        vector: scan.vector - scan.matrix * shift(i),
    });
    left.collect()
}

/// The greatest change of an error \[m\], a radian counting as 3 m.
pub fn most_change(a: &[DVec3], b: &[DVec3]) -> f64 {
    let changes = a.iter().zip(b).map(|(a, b)| ((*a - *b) * DVec3::new(1.0, 1.0, 3.0)).length());
    changes.fold(0.0, f64::max)
}

/// How surely the reference's poses are off along a known pattern, `pattern[scan]` times a constant, on top of errors of
/// the process: the score of that constant in its own standard deviations.
///
/// A displaced laser, a turned one and a late stamp all move whole scans; errors that are fitted first would take them in.
pub fn pattern_score(process: &PoseError, secs: &[f64], scans: &[PoseInformation], pattern: &[DVec3]) -> f64 {
    // The part of a vector of data that the process doesn't explain.
    let left = |vectors: &dyn Fn(usize) -> DVec3| -> Vec<DVec3> {
        let as_data: Vec<PoseInformation> = scans
            .iter()
            .enumerate()
            .map(|(i, s)| PoseInformation { matrix: s.matrix, vector: vectors(i) })
            .collect();
        if process.is_none() {
            return as_data.iter().map(|s| s.vector).collect();
        }
        let mean = smooth_pose_errors(process, secs, &as_data).mean;
        as_data.iter().zip(mean).map(|(s, mean)| s.vector - s.matrix * mean).collect()
    };
    let along = |left: Vec<DVec3>| pattern.iter().zip(left).map(|(p, l)| p.dot(l)).sum::<f64>();
    along(left(&|i| scans[i].vector)) / along(left(&|i| scans[i].matrix * pattern[i])).max(1e-300).sqrt()
}
