//! Errors of the reference poses: a correction for each scan, smooth in time.
//!
//! Beams of one scan share the error of its pose, and neighbouring scans share some of it. The error of x, y (one
//! standard deviation for both) and of the heading is a first-order autoregressive process, in the map frame.

use glam::{DMat3, DVec2, DVec3};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::{Pose2, Track};

/// A first-order autoregressive process for the error of a pose.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct PoseError {
    /// Standard deviation of x and of y \[m\].
    pub sigma_m: f64,
    /// Standard deviation of the heading \[rad\].
    pub sigma_rad: f64,
    /// Time in which the correlation falls to 1/e \[s\].
    pub correlation_secs: f64,
}

impl PoseError {
    /// Exact reference poses.
    pub const NONE: Self = Self { sigma_m: 0.0, sigma_rad: 0.0, correlation_secs: 1.0 };

    /// No error to speak of.
    pub fn is_none(&self) -> bool {
        self.sigma_m <= 0.0 && self.sigma_rad <= 0.0
    }

    /// Covariance of the error of a pose: x, y, heading.
    pub fn covariance(&self) -> DMat3 {
        let (xy, heading) = (self.sigma_m.max(1e-6).powi(2), self.sigma_rad.max(1e-7).powi(2));
        DMat3::from_diagonal(DVec3::new(xy, xy, heading))
    }

    /// Correlation of two errors so far apart \[s\], below 1.
    pub fn correlation(&self, secs: f64) -> f64 {
        (-secs.max(0.0) / self.correlation_secs).exp().min(0.9999)
    }

    /// The log density of errors of poses at these times \[s\], scan by scan, with the volume of what they may be by what the scans say (Laplace's
    /// method), so that processes can be compared (nats).
    pub fn log_prior(&self, secs: &[f64], errors: &[DVec3], scans: &[PoseInformation]) -> Vec<f64> {
        if self.is_none() {
            return vec![0.0; scans.len()];
        }
        let mut log_prior = smooth_pose_errors(self, secs, scans).log_volume;
        let inverse = self.covariance().inverse();
        for i in 0..log_prior.len() {
            let (innovation, share) = if i == 0 {
                (errors[0], 1.0)
            } else {
                let phi = self.correlation(secs[i] - secs[i - 1]);
                (errors[i] - phi * errors[i - 1], 1.0 - phi * phi)
            };
            log_prior[i] -= 0.5 * innovation.dot(inverse * innovation) / share;
        }
        log_prior
    }

    /// Variance of the mean of `n` errors, `secs` apart, over that of an error.
    fn variance_of_mean(&self, secs: f64, n: usize) -> f64 {
        let (phi, n) = (self.correlation(secs), n as f64);
        ((1.0 + phi) / (1.0 - phi) - 2.0 * phi * (1.0 - phi.powf(n)) / (n * (1.0 - phi).powi(2))) / n
    }

    /// Simulated errors of poses at these times \[s\]; the error at pose `i` is drawn from `draw(i)`.
    pub fn simulate<R: Rng>(&self, secs: &[f64], draw: impl Fn(u32) -> R) -> Vec<DVec3> {
        let mut error = DVec3::ZERO;
        let errors = (0..secs.len()).map(|i| {
            if self.is_none() {
                return error;
            }
            let phi = if i == 0 { 0.0 } else { self.correlation(secs[i] - secs[i - 1]) };
            let sigma = DVec3::new(self.sigma_m, self.sigma_m, self.sigma_rad);
            error = phi * error + (1.0 - phi * phi).sqrt() * sigma * normals(&mut draw(i as u32));
            error
        });
        errors.collect()
    }

    /// The poses of a track, each with a simulated error of the process; the error at pose `i` is drawn from `draw(i)`.
    pub fn perturb<R: Rng>(&self, track: &Track, draw: impl Fn(u32) -> R) -> Vec<Pose2> {
        track.poses().iter().zip(self.simulate(track.secs(), draw)).map(|(pose, e)| pose.moved(e)).collect()
    }
}

/// Three draws of a standard normal variable.
fn normals(rng: &mut impl Rng) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| StandardNormal.sample(rng)))
}

/// A turn about the middle of all poses and a shift of them: what the errors of poses in a turned frame have in common.
#[derive(Clone, Copy, Debug)]
pub struct TurnedFrame {
    /// The middle \[m\].
    pub center: DVec2,
    /// The shift \[m\].
    pub shift: DVec2,
    /// Standard error of the shift along each axis, of errors that are as large and last as long as the process says \[m\].
    pub shift_error_m: f64,
    /// The turn \[rad\], positive counter-clockwise.
    pub turn: f64,
    /// Information of the turn \[1/rad^2\].
    pub information: f64,
    /// Share of the errors' squares, each over its variance, that turn and shift make.
    pub share: f64,
    /// Share that the turn makes of what the shift leaves.
    pub share_of_turn: f64,
    /// Share that the shift makes of what the turn leaves.
    pub share_of_shift: f64,
}

impl TurnedFrame {
    /// A pose of the turned frame, turned and shifted.
    pub fn put_right(&self, pose: &Pose2) -> Pose2 {
        let arm = pose.position() - self.center;
        let position = self.center + self.shift + DVec2::from_angle(self.turn).rotate(arm);
        Pose2::new(position.x, position.y, pose.theta + self.turn)
    }
}

impl PoseError {
    /// The turn and the shift that fit corrections of the poses of a track (x and y \[m\], heading \[rad\]) best.
    pub fn turned_frame(&self, track: &Track, corrections: &[DVec3]) -> TurnedFrame {
        let count = track.len() as f64;
        let center = track.poses().iter().map(Pose2::position).sum::<DVec2>() / count;
        let shift = corrections.iter().map(|c| c.truncate()).sum::<DVec2>() / count;
        let [of_position, of_heading] = [self.sigma_m, self.sigma_rad].map(|sigma| sigma.max(1e-6).powi(-2));
        let [mut turned, mut information, mut all] = [0.0; 3];
        for (pose, c) in track.poses().iter().zip(corrections) {
            let arm = pose.position() - center;
            turned += of_position * arm.perp_dot(c.truncate()) + of_heading * c.z;
            information += of_position * arm.length_squared() + of_heading;
            all += of_position * c.truncate().length_squared() + of_heading * c.z * c.z;
        }
        let turn = turned / information;
        let secs = track.secs().last().unwrap_or(&0.0) - track.secs().first().unwrap_or(&0.0);
        let (by_turn, by_shift) = (turn * turned, of_position * count * shift.length_squared());
        let share = |part: f64, of: f64| if of > 0.0 { part / of } else { 0.0 };
        TurnedFrame {
            center,
            shift,
            shift_error_m: self.sigma_m * self.variance_of_mean(secs / count, track.len()).sqrt(),
            turn,
            information,
            share: share(by_turn + by_shift, all),
            share_of_turn: share(by_turn, all - by_shift),
            share_of_shift: share(by_shift, all - by_turn),
        }
    }
}

/// Likelihood of the error of a scan's pose, from its beams: information matrix and vector about zero.
#[derive(Clone, Copy, Debug)]
pub struct PoseInformation {
    /// Information matrix.
    pub matrix: DMat3,
    /// Information vector.
    pub vector: DVec3,
}

impl Default for PoseInformation {
    fn default() -> Self {
        Self { matrix: DMat3::ZERO, vector: DVec3::ZERO }
    }
}

impl std::ops::Add for PoseInformation {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { matrix: self.matrix + other.matrix, vector: self.vector + other.vector }
    }
}

impl std::ops::Mul<f64> for PoseInformation {
    type Output = Self;

    fn mul(self, factor: f64) -> Self {
        Self { matrix: self.matrix * factor, vector: self.vector * factor }
    }
}

impl PoseInformation {
    /// Adds a beam of weight 1 / variance, whose error falls by its jacobian times that of the pose.
    pub fn add_beam(&mut self, weight: f64, jacobian: [f64; 3], error: f64) {
        let j = DVec3::from_array(jacobian);
        self.matrix += DMat3::from_cols(weight * j * j.x, weight * j * j.y, weight * j * j.z);
        self.vector += weight * error * j;
    }

    /// What beams as informative as these say of a pose that errs so, with noise of theirs.
    #[must_use]
    pub fn simulate(&self, error: DVec3, rng: &mut impl Rng) -> Self {
        // Beams along a corridor say nothing of one direction.
        let ridge = 1e-9 * (self.matrix.x_axis.x + self.matrix.y_axis.y + self.matrix.z_axis.z);
        let matrix = Matrix3::from(self.matrix.to_cols_array_2d()) + Matrix3::from_diagonal_element(ridge);
        let normal = Vector3::from(normals(rng).to_array());
        let noise = matrix.cholesky().map_or(Vector3::zeros(), |factor| factor.l() * normal);
        let noise = DVec3::from_array(noise.into());
        Self { matrix: self.matrix, vector: self.matrix * error + noise }
    }
}

/// Mean, covariance and covariance with the scan before of each scan's error, given all scans.
pub struct SmoothedPoseErrors {
    /// Mean of each scan's error.
    pub mean: Vec<DVec3>,
    /// Its covariance.
    pub covariance: Vec<DMat3>,
    with_previous: Vec<DMat3>,
    /// Log evidence of the scans (nats), up to what doesn't depend on the process.
    pub log_evidence: f64,
    /// Part of it that is the volume of each scan's errors after the scan in that before it (nats).
    pub log_volume: Vec<f64>,
}

/// Kalman filter and Rauch-Tung-Striebel smoother.
pub fn smooth_pose_errors(
    process: &PoseError,
    secs: &[f64],
    scans: &[PoseInformation],
) -> SmoothedPoseErrors {
    let n = scans.len();
    let stationary = process.covariance();
    let (mut predicted_mean, mut predicted) = (vec![DVec3::ZERO; n], vec![stationary; n]);
    let (mut mean, mut covariance) = (vec![DVec3::ZERO; n], vec![stationary; n]);
    let (mut log_evidence, mut log_volume) = (0.0, vec![0.0; n]);
    for i in 0..n {
        if i > 0 {
            let phi = process.correlation(secs[i] - secs[i - 1]);
            predicted_mean[i] = phi * mean[i - 1];
            predicted[i] = covariance[i - 1] * (phi * phi) + stationary * (1.0 - phi * phi);
        }
        let prior = predicted[i].inverse();
        let posterior = prior + scans[i].matrix;
        covariance[i] = posterior.inverse();
        let vector = prior * predicted_mean[i] + scans[i].vector;
        mean[i] = covariance[i] * vector;
        log_volume[i] =
            0.5 * (covariance[i].determinant().max(1e-300) / predicted[i].determinant().max(1e-300)).ln();
        log_evidence +=
            log_volume[i] + 0.5 * (vector.dot(mean[i]) - predicted_mean[i].dot(prior * predicted_mean[i]));
    }
    let mut with_previous = vec![DMat3::ZERO; n];
    for i in (0..n.saturating_sub(1)).rev() {
        let phi = process.correlation(secs[i + 1] - secs[i]);
        let gain = covariance[i] * phi * predicted[i + 1].inverse();
        let (later_mean, later) = (mean[i + 1], covariance[i + 1]);
        with_previous[i + 1] = later * gain.transpose();
        mean[i] += gain * (later_mean - predicted_mean[i + 1]);
        covariance[i] += gain * (later - predicted[i + 1]) * gain.transpose();
    }
    SmoothedPoseErrors { mean, covariance, with_previous, log_evidence, log_volume }
}

/// How much likelier `scans` are with the errors that other beams of the same scans say they have (nats): an error of a pose is in all
/// beams of its scan, noise is not. Below 0 where it isn't.
pub fn predictive_gain(
    process: &PoseError,
    secs: &[f64],
    others: &[PoseInformation],
    scans: &[PoseInformation],
) -> f64 {
    let errors = smooth_pose_errors(process, secs, others).mean;
    scans.iter().zip(errors).map(|(scan, e)| scan.vector.dot(e) - 0.5 * e.dot(scan.matrix * e)).sum()
}

/// Whether scans tell errors of a process, by all beams and by two halves of them. Its three parameters have to earn their keep (nats); noise of
/// some beams gains, too, but not on the others.
pub fn are_errors(
    process: &PoseError,
    secs: &[f64],
    scans: &[PoseInformation],
    [a, b]: &[Vec<PoseInformation>; 2],
) -> bool {
    const LEAST_EVIDENCE: f64 = 6.0;
    smooth_pose_errors(process, secs, scans).log_evidence > LEAST_EVIDENCE
        && predictive_gain(process, secs, a, b) + predictive_gain(process, secs, b, a) > 0.0
}

/// Estimates the process by expectation maximization, about the mean of the errors: a constant error is no
/// fluctuation, and can't be told from a laser mounted otherwise.
pub fn fit_pose_error(
    start: PoseError,
    secs: &[f64],
    scans: &[PoseInformation],
    iterations: usize,
) -> PoseError {
    let n = scans.len() as f64;
    let step_secs = (secs.last().unwrap_or(&1.0) / (n - 1.0).max(1.0)).max(1e-6);
    let mut process = start;
    for _ in 0..iterations {
        let smoothed = smooth_pose_errors(&process, secs, scans);
        let center = smoothed.mean.iter().sum::<DVec3>() / n;
        let (mut square, mut product) = (DVec3::ZERO, DVec3::ZERO);
        for i in 0..scans.len() {
            let mean = smoothed.mean[i] - center;
            let diagonal = |m: &DMat3| DVec3::new(m.x_axis.x, m.y_axis.y, m.z_axis.z);
            square += mean * mean + diagonal(&smoothed.covariance[i]);
            if i > 0 {
                product += mean * (smoothed.mean[i - 1] - center) + diagonal(&smoothed.with_previous[i]);
            }
        }
        let prior = process.covariance();
        // The errors' own mean is off zero, too, by more in a short log.
        let of_mean = process.variance_of_mean(step_secs, scans.len())
            * DVec3::new(prior.x_axis.x, prior.y_axis.y, prior.z_axis.z);
        square += n * of_mean;
        product += (n - 1.0) * of_mean;
        // Each component counts by its own scale.
        let scaled = |v: DVec3| 0.5 * (v.x + v.y) / prior.x_axis.x + v.z / prior.z_axis.z;
        let phi = (scaled(product) / scaled(square) * n / (n - 1.0)).clamp(0.01, 0.999);
        process = PoseError {
            sigma_m: (0.5 * (square.x + square.y) / n).sqrt(),
            sigma_rad: (square.z / n).sqrt(),
            correlation_secs: -step_secs / phi.ln(),
        };
    }
    process
}

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

#[cfg(test)]
mod tests {
    use super::*;

    /// What simulated scans say of an error has its mean and their own spread, also where they say nothing of one direction.
    #[test]
    fn scans_tell_an_error_as_surely_as_their_beams_are_many() {
        let mut scan = PoseInformation::default();
        for (weight, jacobian) in [(1e4, [1.0, 0.5, -2.0]), (4e4, [1.0, 0.5, 1.0])] {
            scan.add_beam(weight, jacobian, 0.0);
        }
        let error = DVec3::new(0.01, -0.02, 0.003);
        let draw = crate::Draw::new(5, crate::Stage::Path, 0);
        let (mut mean, mut square) = (DVec3::ZERO, DMat3::ZERO);
        let count = 20_000;
        for i in 0..count {
            let told = scan.simulate(error, &mut draw.item(i));
            let noise = told.vector - scan.matrix * error;
            mean += noise / f64::from(count);
            square += DMat3::from_cols(noise * noise.x, noise * noise.y, noise * noise.z)
                * f64::from(count).recip();
        }
        for i in 0..3 {
            let variance = scan.matrix.col(i)[i];
            // Five standard errors.
            assert!(mean[i].abs() < 5.0 * (variance / f64::from(count)).sqrt(), "{mean}");
            for j in 0..3 {
                let scale = (variance * scan.matrix.col(j)[j]).sqrt();
                let off = square.col(i)[j] - scan.matrix.col(i)[j];
                assert!(
                    off.abs() < 5.0 * scale * (2.0 / f64::from(count)).sqrt(),
                    "{i} {j}: {off} of {scale}"
                );
            }
        }
        let nothing = PoseInformation::default().simulate(error, &mut draw.item(0));
        assert_eq!(nothing.vector, DVec3::ZERO);
    }

    /// Data along the patterns are subtracted to the last bit; data orthogonal to them stay.
    #[test]
    fn patterns_are_taken_off() {
        let matrix = DMat3::from_diagonal(DVec3::new(4.0, 9.0, 100.0));
        let pattern: Vec<DVec3> = (0..6).map(|i| DVec3::new(1.0, 0.5 * f64::from(i), 0.1)).collect();
        let other: Vec<DVec3> = (0..6).map(|i| DVec3::new(0.0, 0.0, f64::from(i % 2))).collect();
        let along = |i: usize| 0.03 * pattern[i] - 0.2 * other[i];
        let scans: Vec<PoseInformation> =
            (0..6).map(|i| PoseInformation { matrix, vector: matrix * along(i) }).collect();
        for rest in without_patterns(&scans, &[pattern.clone(), other.clone()]) {
            assert!(rest.vector.length() < 1e-9, "{}", rest.vector);
        }
        let rest = without_patterns(&scans, std::slice::from_ref(&pattern));
        let score: f64 = pattern.iter().zip(&rest).map(|(p, rest)| p.dot(rest.vector)).sum();
        assert!(score.abs() < 1e-9 && rest[1].vector.length() > 1.0, "{score}");
    }

    /// Logs of three correlation times, whose mean is taken off, have errors as large as they were drawn in the mean.
    #[test]
    fn errors_of_a_short_log_are_as_large_as_they_are() {
        let process = PoseError { sigma_m: 0.01, sigma_rad: 0.003, correlation_secs: 2.0 };
        let secs: Vec<f64> = (0..60).map(|i| 0.1 * f64::from(i)).collect();
        let track = Track::new(secs.iter().map(|&secs| (secs, Pose2::IDENTITY))).unwrap();
        let matrix = DMat3::from_diagonal(DVec3::new(1e7, 1e7, 1e8));
        let fitted = (0..300).map(|log| {
            let draw = |scan| crate::Draw::new(log, crate::Stage::Path, scan).item(0);
            let errors = process.perturb(&track, draw);
            let scans = errors
                .iter()
                .map(|e| PoseInformation { matrix, vector: matrix * DVec3::new(e.x, e.y, e.theta) });
            fit_pose_error(process, &secs, &scans.collect::<Vec<_>>(), 8)
        });
        let of =
            |fitted: &PoseError| [fitted.sigma_m / 0.01, fitted.sigma_rad / 0.003].map(|ratio| ratio * ratio);
        let ratios: Vec<[f64; 2]> = fitted.map(|fitted| of(&fitted)).collect();
        for axis in 0..2 {
            let mean = ratios.iter().map(|ratio| ratio[axis]).sum::<f64>() / ratios.len() as f64;
            assert!((0.8..1.2).contains(&mean), "{mean}");
        }
    }

    /// The mean maximizes the joint log density of errors and scans: its gradient, written out, vanishes.
    #[test]
    fn the_smoothed_errors_are_the_most_likely_ones() {
        let process = PoseError { sigma_m: 0.02, sigma_rad: 0.005, correlation_secs: 0.7 };
        let secs: Vec<f64> = (0..9).map(|i| 0.1 * f64::from(i) + 0.02 * f64::from(i % 3)).collect();
        let scans: Vec<PoseInformation> = (0..9)
            .map(|i| {
                let mut information = PoseInformation::default();
                for beam in 0..4 {
                    let angle = f64::from(i) + 1.3 * f64::from(beam);
                    let error = 0.01 * (3.0 * angle).sin();
                    information.add_beam(1e4, [angle.cos(), angle.sin(), 2.0 * (2.0 * angle).cos()], error);
                }
                information
            })
            .collect();
        let mean = smooth_pose_errors(&process, &secs, &scans).mean;
        let inverse = process.covariance().inverse();
        let phi = |i: usize| process.correlation(secs[i] - secs[i - 1]);
        let innovation = |i: usize| {
            if i == 0 { mean[0] } else { (mean[i] - phi(i) * mean[i - 1]) / (1.0 - phi(i) * phi(i)) }
        };
        for i in 0..scans.len() {
            let later = if i + 1 < scans.len() { phi(i + 1) * innovation(i + 1) } else { DVec3::ZERO };
            let data = scans[i].vector - scans[i].matrix * mean[i];
            let gradient = data - inverse * (innovation(i) - later);
            assert!(gradient.length() < 1e-6 * scans[i].vector.length(), "{i}: {gradient}");
        }
    }
}
