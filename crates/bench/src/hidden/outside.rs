use std::f64::consts::TAU;

use glam::DVec2;
use locsim_core::{Drive, Pose2, wrap_angle};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use serde::Serialize;
use strum::VariantArray;

use super::beam::Change;
use super::{Altered, WHOLE_SCAN};
use locsim_gap::Covariate;

/// Period of the bias \[s\].
const PERIOD_SECS: f64 = 7.0;
/// Radius of the sunlit region \[m\].
const SUNLIT_M: f64 = 2.5;
/// Height of the laser over the floor \[m\].
const HEIGHT_M: f64 = 0.25;
/// How far ahead it meets the floor at a steady speed, as a share of the maximum range.
const FLOOR_SHARE: f64 = 0.6;
/// Share by which its pitch grows and shrinks, at the acceleration from which on it does so no further \[m/s^2\].
const PITCHING: (f64, f64) = (0.3, 2.0);

/// Change of the floor's distance to the side, and nearer left of straight ahead, as shares.
const BENT: (f64, f64) = (0.4, 0.1);
/// Period of a thermal wave, as a share of the drive.
const THERMAL_SHARE: f64 = 0.7;

/// Length of a stripe and the next \[m\].
const STRIPE_M: f64 = 3.0;
/// Correlation of the noise that neighbouring beams have in common.
const CORRELATION: f64 = 0.9;
/// Walls are mirrors from this incidence on \[rad\], 50 deg.
const MIRROR_RAD: f64 = 50.0 * TAU / 360.0;
/// Nearer walls are too near \[m\].
const NEAR_M: f64 = 1.5;

/// An effect that no stage of the library describes, and what its strength is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, strum::IntoStaticStr, VariantArray)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Outside {
    /// All returns are off by A sin(2 pi t / 7 s); A \[m\].
    PeriodicBias,
    /// Returns are off by A sin(2 beta) at bearing beta, as by a mirror that wobbles; A \[m\].
    BearingBias,
    /// Sunlight on one part of the map, around where the robot is halfway: noise of a standard deviation that grows from
    /// 0 at 2.5 m from there to A in the middle is added; A \[m\].
    BackgroundLight,
    /// One kind of surface (those called `door...`; without any, every third) reads short by A; A \[m\].
    SurfaceBias,
    /// All returns of a scan are off alike, by a normal of standard deviation A; A \[m\].
    SharedScanJitter,
    /// The noise is lognormal, shifted and scaled to the same mean and variance; the shape s \[1\], the standard
    /// deviation of the logarithm.
    LogNormalNoise,
    /// With p a return is read at twice its range, where that isn't beyond the maximum range; p \[1\].
    DoubleReturn,
    /// The laser looks at the floor ahead: with p a beam that gets there returns from it. The robot pitches as it
    /// brakes and speeds up, and the floor gets nearer and farther; p \[1\].
    FloorHit,
    /// Returns are off by A sin(6 beta) at bearing beta, as by an encoder; A \[m\].
    BearingRipple,
    /// Returns are off by A sin(2 pi x / 3 m) where they end at x in the map, as by paint; A \[m\].
    Stripes,
    /// A share s of the noise's variance is of a noise that neighbouring beams have in common, with a correlation of 0.9; s \[1\].
    NeighbourNoise,
    /// With p a beam that meets a wall at more than 50 deg goes on as in a mirror, and returns from what it meets then, or from
    /// nothing; p \[1\].
    SecondReflection,
    /// With p a wall nearer than 1.5 m sends nothing back; p \[1\].
    NearLoss,
    /// The odometry is that of A seconds before; A \[s\].
    OdometryLag,
    /// Returns are off by A sin(2 pi t / (0.7 T)) in a drive of duration T, as the laser warms up and cools down; A \[m\].
    ThermalWave,
    /// As [`Outside::FloorHit`] of a laser that is tilted sideways as well, on a floor with a ridge: the line on it is bent; p \[1\].
    BentFloor,
    /// The reference's frame is turned by A about the middle of the drive; A \[rad\].
    FrameTurned,
}

impl Outside {
    /// All of them.
    pub const ALL: &[Self] = Self::VARIANTS;

    /// The name used in files.
    pub fn name(self) -> &'static str {
        self.into()
    }
}

impl Outside {
    /// The covariates that readings depend on with it: each is a right answer.
    pub fn covariates(self) -> &'static [Covariate] {
        match self {
            Self::PeriodicBias | Self::ThermalWave => &[Covariate::Time],
            Self::BearingBias | Self::FloorHit | Self::BearingRipple | Self::BentFloor => {
                &[Covariate::Bearing]
            }
            Self::BackgroundLight | Self::SurfaceBias | Self::Stripes | Self::FrameTurned => {
                &[Covariate::Place]
            }
            Self::SharedScanJitter | Self::NeighbourNoise => &[Covariate::Neighbour],
            Self::SecondReflection => &[Covariate::Incidence],
            Self::NearLoss => &[Covariate::Range],
            Self::OdometryLag => &[Covariate::Odometry],
            Self::LogNormalNoise => &[Covariate::Everywhere],
            Self::DoubleReturn => &[Covariate::Everywhere, Covariate::Range],
        }
    }
}

/// The drive with an effect of this strength in it.
pub(super) fn record(hidden: &Altered<'_>, kind: Outside, strength: f64) -> Drive {
    match kind {
        Outside::PeriodicBias => {
            hidden.with_readings(|beam, _| Change::Shift(strength * (TAU * beam.secs / PERIOD_SECS).sin()))
        }
        Outside::BearingRipple => {
            hidden.with_readings(|beam, _| Change::Shift(strength * (6.0 * beam.bearing).sin()))
        }
        Outside::Stripes => hidden
            .with_readings(|beam, _| Change::Shift(strength * (TAU * beam.endpoint().x / STRIPE_M).sin())),
        Outside::NeighbourNoise => {
            let shared = shared_noise(hidden);
            hidden.with_readings(|beam, _| {
                if !beam.is_wall() {
                    return Change::None;
                }
                let own = beam.reading - beam.range;
                let both = strength.sqrt() * hidden.sigma(beam.range) * shared[beam.scan][beam.index];
                Change::Shift((1.0 - strength).sqrt() * own + both - own)
            })
        }
        Outside::SecondReflection => hidden.with_readings(|beam, chance| {
            let goes_on = chance.random::<f64>() < strength;
            if !goes_on || !beam.is_wall() || beam.incidence < MIRROR_RAD {
                return Change::None;
            }
            beam.mirrored().map_or(Change::Lost, |range| Change::Return(beam.range + range))
        }),
        Outside::NearLoss => hidden.with_readings(|beam, chance| {
            let lost = chance.random::<f64>() < strength && beam.is_wall() && beam.range < NEAR_M;
            if lost { Change::Lost } else { Change::None }
        }),
        Outside::OdometryLag => hidden.with_late_odometry(strength),
        Outside::ThermalWave => {
            let period = THERMAL_SHARE * hidden.truth.secs()[hidden.scans() - 1];
            hidden.with_readings(|beam, _| Change::Shift(strength * (TAU * beam.secs / period).sin()))
        }
        Outside::FrameTurned => {
            let poses = hidden.truth.poses();
            let middle = poses.iter().map(Pose2::position).sum::<DVec2>() / poses.len() as f64;
            let mut drive = hidden.with_readings(|_, _| Change::None);
            if strength > 0.0 {
                for reference in drive.steps.iter_mut().filter_map(|step| step.reference.as_mut()) {
                    let at = middle + DVec2::from_angle(strength).rotate(reference.position() - middle);
                    *reference = Pose2::new(at.x, at.y, wrap_angle(reference.theta + strength));
                }
            }
            drive
        }
        Outside::BearingBias => {
            hidden.with_readings(|beam, _| Change::Shift(strength * (2.0 * beam.bearing).sin()))
        }
        Outside::BackgroundLight => {
            let center = hidden.truth.poses()[hidden.scans() / 2].position();
            hidden.with_readings(|beam, chance| {
                let share = (1.0 - beam.endpoint().distance(center) / SUNLIT_M).max(0.0);
                let normal: f64 = StandardNormal.sample(chance);
                Change::Shift(strength * share * normal)
            })
        }
        Outside::SurfaceBias => {
            let names = hidden.nominal.map.geometry().surface_names();
            let is_door = |name: &String| name.starts_with("door");
            let any_door = names.iter().any(is_door);
            let short: Vec<bool> = names
                .iter()
                .enumerate()
                .map(|(i, name)| if any_door { is_door(name) } else { i.is_multiple_of(3) })
                .collect();
            hidden.with_readings(|beam, _| {
                let is_short = beam.is_wall() && beam.surface.is_some_and(|surface| short[surface as usize]);
                if is_short { Change::Shift(-strength) } else { Change::None }
            })
        }
        Outside::SharedScanJitter => {
            let offsets: Vec<f64> = (0..hidden.scans()).map(|scan| strength * hidden.normal(scan)).collect();
            hidden.with_readings(|beam, _| Change::Shift(offsets[beam.scan]))
        }
        Outside::LogNormalNoise => hidden.with_readings(|beam, _| {
            if !beam.is_wall() || strength == 0.0 {
                return Change::None;
            }
            let sigma = hidden.sigma(beam.range);
            let normal = (beam.reading - beam.range) / sigma;
            // exp(s n) less its mean exp(s^2 / 2), over its standard deviation.
            let square = strength * strength;
            let skewed = (strength * normal - 0.5 * square).exp_m1() / square.exp_m1().sqrt();
            Change::Shift(sigma * (skewed - normal))
        }),
        Outside::DoubleReturn => {
            let max = hidden.max_range();
            hidden.with_readings(move |beam, chance| {
                let twice = chance.random::<f64>() < strength && 2.0 * beam.reading < max;
                if twice { Change::Value(2.0 * beam.reading) } else { Change::None }
            })
        }
        Outside::FloorHit => hits_floor(hidden, strength, |_| 1.0),
        Outside::BentFloor => hits_floor(hidden, strength, |bearing| {
            let (sideways, ridge) = BENT;
            1.0 + sideways * bearing.sin() - if bearing > 0.0 { ridge } else { 0.0 }
        }),
    }
}

/// The drive with beams that return from the floor, whose distance at a bearing is the plane's times a factor.
fn hits_floor(hidden: &Altered<'_>, strength: f64, factor: impl Fn(f64) -> f64 + Sync) -> Drive {
    let level = (HEIGHT_M / (FLOOR_SHARE * hidden.max_range())).atan();
    let pitches: Vec<f64> = accelerations(hidden)
        .into_iter()
        .map(|acceleration| {
            let (share, most) = PITCHING;
            level * (1.0 - share * (acceleration / most).clamp(-1.0, 1.0))
        })
        .collect();
    let mount = hidden.nominal.laser.mount.theta;
    hidden.with_readings(move |beam, chance| {
        let bearing = beam.bearing + mount;
        let floor = factor(bearing) * HEIGHT_M / (pitches[beam.scan] * bearing.cos()).tan();
        let hit = chance.random::<f64>() < strength && floor > 0.0 && floor < beam.reading;
        if hit { Change::Return(floor) } else { Change::None }
    })
}

/// Standard normal noise of each scan that neighbouring beams have in common.
fn shared_noise(hidden: &Altered<'_>) -> Vec<Vec<f64>> {
    let beams = hidden.simulator.laser().laser().beam_count();
    let of_scan = |scan: usize| {
        let mut chance = hidden.chance(scan, WHOLE_SCAN);
        let mut normal: f64 = StandardNormal.sample(&mut chance);
        let normals = (0..beams).map(|_| {
            let own: f64 = StandardNormal.sample(&mut chance);
            normal = CORRELATION * normal + (1.0 - CORRELATION * CORRELATION).sqrt() * own;
            normal
        });
        normals.collect()
    };
    (0..hidden.scans()).map(of_scan).collect()
}

/// Acceleration forward at each scan \[m/s^2\].
fn accelerations(hidden: &Altered<'_>) -> Vec<f64> {
    let (secs, speeds) = (hidden.truth.secs(), hidden.speeds());
    let at = |i: usize| match i {
        0 => 0.0,
        i if i < speeds.len() => 2.0 * (speeds[i] - speeds[i - 1]) / (secs[i + 1] - secs[i - 1]),
        _ => 0.0,
    };
    (0..hidden.scans()).map(at).collect()
}
