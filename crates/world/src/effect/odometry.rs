use locsim_core::{Pose2, normal};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

/// What the odometry reads of a motion, before the noise of [`OdometryNoise`](crate::simulation::OdometryNoise).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OdometryDistribution {
    /// The increment where no wheel slips.
    pub mean: Pose2,
    /// How wheels slip.
    pub slip: Slip,
}

/// Wheels that slip with probability `p`, and then turn farther than the robot gets by the share |N(0, `share`^2)|.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Slip {
    /// Probability that an increment slips.
    pub p: f64,
    /// Standard deviation of the share, before its sign is dropped.
    pub share: f64,
}

impl OdometryDistribution {
    /// A draw of the increment: that of a slip reads a distance longer by the slip's share.
    pub fn sample(&self, chance: &mut impl Rng) -> Pose2 {
        let stretch = 1.0 + self.slip.sample(chance);
        Pose2 { x: stretch * self.mean.x, y: stretch * self.mean.y, ..self.mean }
    }
}

impl Slip {
    /// A draw of the share by which the distance is read too long, 0 where nothing slips.
    pub fn sample(&self, chance: &mut impl Rng) -> f64 {
        if self.p > 0.0 && chance.random::<f64>() < self.p {
            let normal: f64 = StandardNormal.sample(chance);
            self.share * normal.abs()
        } else {
            0.0
        }
    }

    /// P(share <= s): with the probability of no slip at 0.
    pub fn cdf(&self, s: f64) -> f64 {
        if s < 0.0 {
            0.0
        } else if self.p == 0.0 || self.share == 0.0 {
            1.0
        } else {
            1.0 - 2.0 * self.p * normal::tail(s / self.share)
        }
    }

    /// Density of the share above 0; `1 - p` is the probability of no slip at all.
    pub fn density(&self, s: f64) -> f64 {
        if s <= 0.0 || self.p == 0.0 || self.share == 0.0 {
            return 0.0;
        }
        let t = s / self.share;
        2.0 * self.p / self.share * (-0.5 * t * t).exp() / std::f64::consts::TAU.sqrt()
    }
}
