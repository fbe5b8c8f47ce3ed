use glam::{DMat3, DVec3};
use nalgebra::{Matrix3, Vector3};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

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

/// Three draws of a standard normal variable.
pub(super) fn normals(rng: &mut impl Rng) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| StandardNormal.sample(rng)))
}
