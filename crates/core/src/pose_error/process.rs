use glam::{DMat3, DVec3};
use rand::Rng;

use super::information::{PoseInformation, normals};
use crate::{Pose2, Track};

/// A first-order autoregressive process with white noise for the error of a pose.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct PoseError {
    /// Standard deviation of x and of y \[m\].
    pub sigma_m: f64,
    /// Standard deviation of the heading \[rad\].
    pub sigma_rad: f64,
    /// Time in which the correlation falls to 1/e \[s\].
    pub correlation_secs: f64,
    /// Standard deviation of the white noise of x and of y \[m\].
    pub white_m: f64,
    /// Standard deviation of the white noise of the heading \[rad\].
    pub white_rad: f64,
}

impl PoseError {
    /// Exact reference poses.
    pub const NONE: Self =
        Self { sigma_m: 0.0, sigma_rad: 0.0, correlation_secs: 1.0, white_m: 0.0, white_rad: 0.0 };

    /// No error to speak of.
    pub fn is_none(&self) -> bool {
        self.sigma_m <= 0.0 && self.sigma_rad <= 0.0
    }

    /// Covariance of the process: x, y, heading.
    pub fn covariance(&self) -> DMat3 {
        let (xy, heading) = (self.sigma_m.max(1e-6).powi(2), self.sigma_rad.max(1e-7).powi(2));
        DMat3::from_diagonal(DVec3::new(xy, xy, heading))
    }

    /// Correlation of two errors so far apart \[s\], below 1.
    pub fn correlation(&self, secs: f64) -> f64 {
        (-secs.max(0.0) / self.correlation_secs).exp().min(0.9999)
    }

    /// Variance of the mean of `n` errors, `secs` apart, over that of an error.
    pub(super) fn variance_of_mean(&self, secs: f64, n: usize) -> f64 {
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
            let mut rng = draw(i as u32);
            let phi = if i == 0 { 0.0 } else { self.correlation(secs[i] - secs[i - 1]) };
            let sigma = DVec3::new(self.sigma_m, self.sigma_m, self.sigma_rad);
            error = phi * error + (1.0 - phi * phi).sqrt() * sigma * normals(&mut rng);
            error + DVec3::new(self.white_m, self.white_m, self.white_rad) * normals(&mut rng)
        });
        errors.collect()
    }

    /// Information of a pose's white noise; `None` where there is none to speak of.
    pub(super) fn white_information(&self) -> Option<DMat3> {
        let [of_position, of_heading] =
            [self.white_m.max(1e-7), self.white_rad.max(1e-8)].map(|sigma| sigma.powi(-2));
        let information = DMat3::from_diagonal(DVec3::new(of_position, of_position, of_heading));
        (self.white_m > 1e-7 || self.white_rad > 1e-8).then_some(information)
    }

    /// What scans say of the process alone, with the covariance of each scan's white noise given the process.
    pub(super) fn without_white(
        &self,
        scans: &[PoseInformation],
    ) -> Option<(Vec<PoseInformation>, Vec<DMat3>)> {
        let white = self.white_information()?;
        let of_process = scans.iter().map(|scan| {
            let covariance = (white + scan.matrix).inverse();
            let less = |vector: DVec3| scan.matrix * (covariance * vector);
            let matrix = scan.matrix - scan.matrix * covariance * scan.matrix;
            (PoseInformation { matrix, vector: scan.vector - less(scan.vector) }, covariance)
        });
        Some(of_process.unzip())
    }

    /// The poses of a track, each with a simulated error of the process; the error at pose `i` is drawn from `draw(i)`.
    pub fn perturb<R: Rng>(&self, track: &Track, draw: impl Fn(u32) -> R) -> Vec<Pose2> {
        track.poses().iter().zip(self.simulate(track.secs(), draw)).map(|(pose, e)| pose.moved(e)).collect()
    }
}
