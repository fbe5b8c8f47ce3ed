use glam::{DMat3, DVec3};

use super::information::PoseInformation;
use super::process::PoseError;

impl PoseError {
    /// The log density of errors of poses at these times \[s\], scan by scan, with the volume of what they may be by what the scans say (Laplace's
    /// method), so that processes can be compared (nats).
    pub fn log_prior(&self, secs: &[f64], errors: &[DVec3], scans: &[PoseInformation]) -> Vec<f64> {
        if self.is_none() {
            return vec![0.0; scans.len()];
        }
        let mut log_prior = smooth_pose_errors(self, secs, scans).log_volume;
        let inverse = self.covariance().inverse();
        let white = self.white_information();
        // What is likeliest to be of the process.
        let errors = white.map_or_else(
            || errors.to_vec(),
            |matrix| {
                let known = |e: &DVec3| PoseInformation { matrix, vector: matrix * *e };
                let slow = smooth_process(self, secs, &errors.iter().map(known).collect::<Vec<_>>()).mean;
                for ((log_prior, e), slow) in log_prior.iter_mut().zip(errors).zip(&slow) {
                    *log_prior -= 0.5 * (*e - *slow).dot(matrix * (*e - *slow));
                }
                slow
            },
        );
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
}

/// Mean, covariance and covariance with the scan before of each scan's error, given all scans.
pub struct SmoothedPoseErrors {
    /// Mean of each scan's error.
    pub mean: Vec<DVec3>,
    /// Its covariance.
    pub covariance: Vec<DMat3>,
    pub(super) with_previous: Vec<DMat3>,
    /// Log evidence of the scans (nats), up to what doesn't depend on the process.
    pub log_evidence: f64,
    /// Part of it that is the volume of each scan's errors after the scan in that before it (nats).
    pub log_volume: Vec<f64>,
}

/// Kalman filter and Rauch-Tung-Striebel smoother, and then the white noise of each pose.
pub fn smooth_pose_errors(
    process: &PoseError,
    secs: &[f64],
    scans: &[PoseInformation],
) -> SmoothedPoseErrors {
    let Some(((of_process, of_white), white)) = process.without_white(scans).zip(process.white_information())
    else {
        return smooth_process(process, secs, scans);
    };
    let mut smoothed = smooth_process(process, secs, &of_process);
    for (i, (scan, own)) in scans.iter().zip(of_white).enumerate() {
        let volume = 0.5 * (own.determinant() * white.determinant()).ln();
        smoothed.log_evidence += volume + 0.5 * scan.vector.dot(own * scan.vector);
        smoothed.log_volume[i] += volume;
        let kept = DMat3::IDENTITY - own * scan.matrix;
        smoothed.mean[i] = kept * smoothed.mean[i] + own * scan.vector;
        smoothed.covariance[i] = own + kept * smoothed.covariance[i] * kept.transpose();
    }
    smoothed
}

/// The errors of the process alone.
pub(super) fn smooth_process(
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
pub(super) fn predictive_gain(
    process: &PoseError,
    secs: &[f64],
    others: &[PoseInformation],
    scans: &[PoseInformation],
) -> f64 {
    let errors = smooth_pose_errors(process, secs, others).mean;
    scans.iter().zip(errors).map(|(scan, e)| scan.vector.dot(e) - 0.5 * e.dot(scan.matrix * e)).sum()
}
