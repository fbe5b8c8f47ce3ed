//! Effects on what the odometry reads.

use locsim_core::{Draw, Pose2, Stage, normal};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

use super::effect_type::EffectType;
use super::statistic::Axis;
use super::{Description, Effect, EffectKind, Experiment, Moves, Parameter, Prior, Site, Statistic};

/// Odometry that reads distances too long or too short.
pub(super) struct OdomDistanceScale;

impl EffectType for OdomDistanceScale {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "odom_distance_scale",
                site: Site::Odometry,
                parameters: &[Parameter::strength("k", "1", 0.0, [-0.5, 0.5], 0.02)],
                formula: "ds (1 + k)",
                sentence: "The odometry reads every distance too long or too short by the same share: a wheel's \
                           diameter is off.",
                sides: Some([
                    "The odometry reads every distance too short by the same share: a wheel's diameter is off.",
                    "The odometry reads every distance too long by the same share: a wheel's diameter is off.",
                ]),
                signature: "increments of distance in proportion to the true ones",
                confused_with: &[EffectKind::WheelSlip],
                statistics: &[Statistic::Odometry { error: Axis::Distance, motion: Axis::Distance }],
                moves: Moves::Odometry,
                is_correctable: true,
                ..Description::DEFAULT
            }
        }
    }

    fn odometry(&self, effect: &Effect, errors: &mut OdometryErrors) {
        let [k] = effect.numbers();
        errors.distance_scale += k;
    }
}

/// Odometry that reads turns too wide or too narrow.
pub(super) struct OdomTurnScale;

impl EffectType for OdomTurnScale {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "odom_turn_scale",
                site: Site::Odometry,
                parameters: &[Parameter::strength("k", "1", 0.0, [-0.5, 0.5], 0.02)],
                formula: "dtheta (1 + k)",
                sentence: "The odometry reads every turn too wide or too narrow by the same share: the wheel base is \
                           off.",
                sides: Some([
                    "The odometry reads every turn too narrow by the same share: the wheel base is off.",
                    "The odometry reads every turn too wide by the same share: the wheel base is off.",
                ]),
                signature: "increments of heading in proportion to the true ones",
                confused_with: &[EffectKind::OdomImbalance],
                experiments: &[Experiment::TurnsAndLines],
                statistics: &[Statistic::Odometry { error: Axis::Turn, motion: Axis::Turn }],
                moves: Moves::Odometry,
                is_correctable: true,
                ..Description::DEFAULT
            }
        }
    }

    fn odometry(&self, effect: &Effect, errors: &mut OdometryErrors) {
        let [k] = effect.numbers();
        errors.turn_scale += k;
    }
}

/// Odometry that reads a turn where there is none: wheels that differ.
pub(super) struct OdomImbalance;

impl EffectType for OdomImbalance {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "odom_imbalance",
                site: Site::Odometry,
                parameters: &[
                    Parameter::strength("turn_per_m", "rad/m", 0.0, [-1.0, 1.0], 0.02).key("turn_deg_per_m")
                ],
                formula: "dtheta + turn_per_m ds",
                sentence: "The odometry reads a turn while the robot drives straight: one wheel is larger than the \
                           other.",
                sides: Some([
                    "The odometry reads a turn to the right while the robot drives straight: one wheel is larger than the other.",
                    "The odometry reads a turn to the left while the robot drives straight: one wheel is larger than the other.",
                ]),
                signature: "increments of heading in proportion to distance",
                confused_with: &[EffectKind::OdomTurnScale, EffectKind::MountYaw],
                experiments: &[Experiment::TurnsAndLines],
                statistics: &[Statistic::Odometry { error: Axis::Turn, motion: Axis::Distance }],
                moves: Moves::Odometry,
                is_correctable: true,
                ..Description::DEFAULT
            }
        }
    }

    fn odometry(&self, effect: &Effect, errors: &mut OdometryErrors) {
        let [turn_per_m] = effect.numbers();
        errors.turn_per_m += turn_per_m;
    }
}

/// Wheels that now and then turn without getting on.
pub(super) struct WheelSlip;

impl EffectType for WheelSlip {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "wheel_slip",
                site: Site::Odometry,
                parameters: &[
                    Parameter::probability(0.1),
                    Parameter::shape("share", "1", [0.0, 5.0], 0.2)
                        .prior(Prior::LogNormal { offset: 0.0, sd: 1.0 }),
                ],
                formula: "with p: ds (1 + |N(0, share^2)|)",
                sentence: "Now and then the wheels turn without getting on, and the odometry reads too long a \
                           distance.",
                signature: "a long upper tail of the increments of distance",
                confused_with: &[EffectKind::OdomDistanceScale],
                statistics: &[Statistic::Slip { shares: &[0.2, 0.5] }],
                moves: Moves::Odometry,
                is_single: true,
                ..Description::DEFAULT
            }
        }
    }

    fn odometry(&self, effect: &Effect, errors: &mut OdometryErrors) {
        let [p, share] = effect.numbers();
        errors.slip = Slip { p, share };
    }
}

/// The draws that decide whether increment `step` of the odometry slips, and by how much.
pub(crate) fn slip_draw(seed: u64, step: u32) -> impl Rng {
    Draw::new(seed, Stage::Effect, step).item(u32::MAX)
}

/// The errors of an odometry, before its noise.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OdometryErrors {
    /// Distances are read longer by this share.
    pub distance_scale: f64,
    /// Turns are read wider by this share.
    pub turn_scale: f64,
    /// Turn that is read per metre \[rad/m\].
    pub turn_per_m: f64,
    /// How wheels slip.
    pub slip: Slip,
}

impl OdometryErrors {
    /// Odometry of a true motion `base_prev_from_base_now`.
    pub fn distribution(&self, increment: &Pose2) -> OdometryDistribution {
        let scale = 1.0 + self.distance_scale;
        let distance = increment.x.hypot(increment.y).copysign(increment.x);
        let turn = (1.0 + self.turn_scale) * increment.theta + self.turn_per_m * distance;
        OdometryDistribution {
            mean: Pose2::new(scale * increment.x, scale * increment.y, turn),
            slip: self.slip,
        }
    }

    /// The true motion, for what is read where no wheel slips.
    #[must_use]
    pub fn corrected(&self, read: &Pose2) -> Pose2 {
        let scale = 1.0 + self.distance_scale;
        let (x, y) = (read.x / scale, read.y / scale);
        let distance = x.hypot(y).copysign(x);
        Pose2::new(x, y, (read.theta - self.turn_per_m * distance) / (1.0 + self.turn_scale))
    }
}

/// Odometry of a motion, before the noise of [`OdometryNoise`](crate::simulation::OdometryNoise).
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
