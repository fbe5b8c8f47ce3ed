use std::f64::consts::{FRAC_PI_3, PI, TAU};

use glam::DVec2;
use locsim_core::{Drive, wrap_angle};
use locsim_world::effect::EffectKind;
use rand::{Rng, RngExt};
use rand_distr::{Distribution, Exp1, StandardNormal};
use serde::Serialize;

use super::beam::{Beam, Change, is_in_sector};
use super::{Altered, WHOLE_SCAN};

/// A beam ends on a stretch of wall if it ends no farther from it than this \[m\].
const NEAR_PLACE_M: f64 = 0.1;
/// A slanted wall counts as slanted by no more than this \[rad\], 80 deg.
const GRAZING_RAD: f64 = 80.0 * PI / 180.0;
/// Noise grows from this range on \[m\], and by this much per metre in units of the library's growth \[m\].
const NOISE_FROM_M: f64 = 2.0;
const NOISE_PER_M: f64 = 8.0;
/// Mean duration of a burst of crosstalk \[s\].
const BURST_SECS: f64 = 1.0;
/// Share of the sector between the two fingers in front of it.
const BETWEEN_FINGERS: f64 = 0.2;
/// Wheels that differ turn a robot by no more than at this speed \[m/s\].
const SATURATION_M_S: f64 = 1.0;
/// Spread of a scan's delay in units of the delay.
const JITTER: f64 = 0.3;

/// An effect of the library that acts in another way than there.
///
/// Its numbers are the library's, and about as strong as there: `b`, `c`, `k`, `p` are what the library's formula
/// ([`EffectKind::formula`]) has, r is the range, R the maximum range, alpha the incidence.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum OtherForm {
    /// b 2 (1 / cos(alpha) - 1).
    IncidenceBias,
    /// With p noise of a Student t distribution with 3 degrees of freedom, of the same variance, on top.
    HeavyTail,
    /// With p beyond the angle, never below it.
    IncidenceDropout,
    /// A linear ramp from a range on up to p at R, that loses as many returns of evenly spread ranges.
    RangeDropout,
    /// b (1 - t / (2 tau)), and 0 from 2 tau on.
    WarmupDrift,
    /// The stretch bulges, as half a sine from end to end whose mean is the distance.
    MovedWall,
    /// A square of the disc's area, askew.
    MissingObject,
    /// sigma + 8 m c (r - 2 m) beyond 2 m.
    RangeNoise,
    /// sigma (1 + c 2 (1 / cos(alpha) - 1)).
    IncidenceNoise,
    /// Below an incidence of 60 deg alone.
    Glass,
    /// A triangular distribution between the two surfaces.
    MixedPixels,
    /// Two fingers, at 0.9 and at 1.1 times the range, with a gap between them.
    SectorOcclusion,
    /// Bursts that begin at any time and last an exponential time; readings of a triangular distribution.
    Crosstalk,
    /// A mirror that turns unevenly, fastest at the back: T sin(beta / 2) / 2.
    MotionSkew,
    /// k r (0.7 + 0.6 r / R).
    RangeScale,
    /// 1.2 b for even beams, 0.8 b for odd ones.
    RangeBias,
    /// Each scan has a delay of its own, normal with a standard deviation of 30 % of the delay.
    TimeOffset,
    /// Forward alone.
    OdomDistanceScale,
    /// The turn saturates with speed v: tanh(v / (1 m/s)) for v.
    OdomImbalance,
    /// The share of a slip is Student t with 3 degrees of freedom, without its sign, of the same mean.
    WheelSlip,
    /// The library's formula of one of [`OtherForm::COURSES`], times a course over what it depends on that is drawn at random for each
    /// log.
    Course(EffectKind, Course),
}

/// A course over a covariate, of factors from a fifth to nine fifths, which are 1 in the mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Course {
    /// A cubic spline through knots.
    Spline,
    /// A table: constant from one level to the next.
    Table,
}

/// Knots of a course.
const KNOTS: usize = 6;

impl Course {
    /// The factors at evenly spaced knots.
    fn knots(chance: &mut dyn Rng) -> [f64; KNOTS] {
        std::array::from_fn(|_| 0.2 + 1.6 * chance.random::<f64>())
    }

    /// The factor at a share of the covariate's range; a spline is Catmull's and Rom's.
    pub(super) fn at(self, knots: &[f64; KNOTS], share: f64) -> f64 {
        let share = share.clamp(0.0, 1.0);
        match self {
            Self::Table => knots[((share * KNOTS as f64) as usize).min(KNOTS - 1)],
            Self::Spline => {
                let x = share * (KNOTS - 1) as f64;
                let i = (x as usize).min(KNOTS - 2);
                let t = x - i as f64;
                let knot = |i: i64| knots[i.clamp(0, KNOTS as i64 - 1) as usize];
                let [a, b, c, d] = [-1, 0, 1, 2].map(|off| knot(i as i64 + off));
                let cubic = 3.0 * (b - c) + d - a;
                let square = 2.0 * a - 5.0 * b + 4.0 * c - d;
                (b + 0.5 * t * (c - a + t * (square + t * cubic))).max(0.0)
            }
        }
    }
}

impl OtherForm {
    /// All of them.
    pub const ALL: [Self; 20] = [
        Self::IncidenceBias,
        Self::HeavyTail,
        Self::IncidenceDropout,
        Self::RangeDropout,
        Self::WarmupDrift,
        Self::MovedWall,
        Self::MissingObject,
        Self::RangeNoise,
        Self::IncidenceNoise,
        Self::Glass,
        Self::MixedPixels,
        Self::SectorOcclusion,
        Self::Crosstalk,
        Self::MotionSkew,
        Self::RangeScale,
        Self::RangeBias,
        Self::TimeOffset,
        Self::OdomDistanceScale,
        Self::OdomImbalance,
        Self::WheelSlip,
    ];

    /// Effects over one covariate, each with a course that is nobody's: a spline, and a table.
    pub const COURSES: [Self; 14] = {
        let kinds = [
            EffectKind::RangeScale,
            EffectKind::IncidenceBias,
            EffectKind::WarmupDrift,
            EffectKind::RangeNoise,
            EffectKind::IncidenceNoise,
            EffectKind::IncidenceDropout,
            EffectKind::RangeDropout,
        ];
        let mut all = [Self::RangeBias; 14];
        let mut i = 0;
        while i < all.len() {
            all[i] = Self::Course(kinds[i / 2], if i % 2 == 0 { Course::Spline } else { Course::Table });
            i += 1;
        }
        all
    };

    /// The effect of the library that it should be taken for.
    pub fn kind(self) -> EffectKind {
        match self {
            Self::Course(kind, _) => kind,
            Self::IncidenceBias => EffectKind::IncidenceBias,
            Self::HeavyTail => EffectKind::HeavyTail,
            Self::IncidenceDropout => EffectKind::IncidenceDropout,
            Self::RangeDropout => EffectKind::RangeDropout,
            Self::WarmupDrift => EffectKind::WarmupDrift,
            Self::MovedWall => EffectKind::MovedWall,
            Self::MissingObject => EffectKind::MissingObject,
            Self::RangeNoise => EffectKind::RangeNoise,
            Self::IncidenceNoise => EffectKind::IncidenceNoise,
            Self::Glass => EffectKind::Glass,
            Self::MixedPixels => EffectKind::MixedPixels,
            Self::SectorOcclusion => EffectKind::SectorOcclusion,
            Self::Crosstalk => EffectKind::Crosstalk,
            Self::MotionSkew => EffectKind::MotionSkew,
            Self::RangeScale => EffectKind::RangeScale,
            Self::RangeBias => EffectKind::RangeBias,
            Self::TimeOffset => EffectKind::TimeOffset,
            Self::OdomDistanceScale => EffectKind::OdomDistanceScale,
            Self::OdomImbalance => EffectKind::OdomImbalance,
            Self::WheelSlip => EffectKind::WheelSlip,
        }
    }
}

/// The drive with a form in it, whose values [`EffectKind`] has accepted.
#[expect(clippy::too_many_lines, reason = "one match with a short arm for each form; the arms share nothing")]
pub(super) fn record(hidden: &Altered<'_>, form: OtherForm, values: &[f64], place: &[[DVec2; 2]]) -> Drive {
    let max = hidden.max_range();
    let value = |i: usize| values[i];
    let theta = value(0);
    match form {
        OtherForm::RangeBias => hidden.with_readings(|beam, _| {
            Change::Shift(theta * if beam.index.is_multiple_of(2) { 1.2 } else { 0.8 })
        }),
        OtherForm::RangeScale => hidden
            .with_readings(|beam, _| Change::Shift(theta * beam.reading * (0.7 + 0.6 * beam.reading / max))),
        OtherForm::IncidenceBias => hidden.with_readings(|beam, _| {
            if beam.is_wall() { Change::Shift(theta * slant(beam)) } else { Change::None }
        }),
        OtherForm::WarmupDrift => hidden
            .with_readings(|beam, _| Change::Shift(theta * (1.0 - beam.secs / (2.0 * value(1))).max(0.0))),
        OtherForm::RangeNoise => hidden.with_readings(|beam, chance| {
            let growth = theta * NOISE_PER_M * (beam.reading - NOISE_FROM_M).max(0.0);
            widened(hidden.sigma(beam.reading), growth, chance)
        }),
        OtherForm::IncidenceNoise => hidden.with_readings(|beam, chance| {
            let sigma = hidden.sigma(beam.reading);
            let growth = if beam.is_wall() { sigma * theta * slant(beam) } else { 0.0 };
            widened(sigma, growth, chance)
        }),
        OtherForm::HeavyTail => hidden.with_readings(|beam, chance| {
            let t = student_t(chance);
            let shift = 5.0 / 3_f64.sqrt() * hidden.sigma(beam.reading) * t;
            if chance.random::<f64>() < theta { Change::Shift(shift) } else { Change::None }
        }),
        OtherForm::IncidenceDropout => hidden.with_readings(|beam, chance| {
            let lost = beam.is_wall() && beam.incidence > value(1) && chance.random::<f64>() < theta;
            if lost { Change::Lost } else { Change::None }
        }),
        OtherForm::RangeDropout => {
            // Over r from 0 to R, the integral of (r / R)^k is 1 / (k + 1), that of a ramp half its base.
            let from = (1.0 - 2.0 / (value(1) + 1.0)).max(0.0);
            hidden.with_readings(move |beam, chance| {
                let ramp = ((beam.reading / max - from) / (1.0 - from)).max(0.0);
                let lost = beam.is_return() && chance.random::<f64>() < theta * ramp;
                if lost { Change::Lost } else { Change::None }
            })
        }
        OtherForm::MovedWall => hidden.with_readings(|beam, _| match stretch_at(beam, place) {
            Some(stretch) => beam.standing_at(range_to_bulge(beam, stretch, theta)),
            None => Change::None,
        }),
        OtherForm::MissingObject => {
            let edges = square(DVec2::new(theta, value(1)), value(2));
            hidden.with_readings(move |beam, _| {
                let ranges = edges.iter().filter_map(|edge| crossing(beam.origin, beam.direction, *edge));
                let nearest = ranges.reduce(f64::min).filter(|&range| range < beam.range);
                nearest.map_or(Change::None, |range| beam.standing_at(range))
            })
        }
        OtherForm::Glass => hidden.with_readings(|beam, chance| {
            let through = chance.random::<f64>() < theta
                && beam.is_wall()
                && beam.incidence < FRAC_PI_3
                && stretch_at(beam, place).is_some();
            match (through, beam.behind()) {
                (false, _) => Change::None,
                (true, Some(range)) => Change::Return(range),
                (true, None) => Change::Lost,
            }
        }),
        OtherForm::MixedPixels => hidden.with_readings(|beam, chance| match beam.edge() {
            Some([near, far]) if beam.is_wall() && chance.random::<f64>() < theta => {
                Change::Value(near + (far - near) * triangular(chance))
            }
            _ => Change::None,
        }),
        OtherForm::SectorOcclusion => {
            let (from, to, range, p) = (theta, value(1), value(2), value(3));
            let width = if to >= from { to - from } else { to - from + TAU };
            let finger = 0.5 * (1.0 - BETWEEN_FINGERS) * width;
            hidden.with_readings(move |beam, chance| {
                let at = if is_in_sector(beam.bearing, from, finger) {
                    0.9 * range
                } else if is_in_sector(beam.bearing, to - finger, finger) {
                    1.1 * range
                } else {
                    return Change::None;
                };
                let hit = at < beam.reading && chance.random::<f64>() < p;
                if hit { Change::Return(at) } else { Change::None }
            })
        }
        OtherForm::Crosstalk => {
            let bursts = bursts(hidden, value(1));
            hidden.with_readings(|beam, chance| {
                let begun = bursts.partition_point(|[begin, _]| *begin <= beam.secs);
                let is_on = begun > 0 && beam.secs < bursts[begun - 1][1];
                let disturbed = is_on && chance.random::<f64>() < theta;
                if disturbed { Change::Value(max * triangular(chance)) } else { Change::None }
            })
        }
        OtherForm::MotionSkew => hidden.with_readings(|beam, _| {
            let secs = beam.secs + theta * 0.5 * (0.5 * wrap_angle(beam.bearing)).sin();
            let (origin, direction) = hidden.ray(&hidden.truth.pose_at(secs), beam.bearing);
            beam.standing_at(hidden.cast(origin, direction).map_or(f64::INFINITY, |hit| hit.range))
        }),
        OtherForm::TimeOffset => {
            let delay = |scan: usize| theta * (1.0 + JITTER * hidden.normal(scan));
            let secs = hidden.truth.secs().iter().enumerate();
            let poses = secs.map(|(i, secs)| hidden.truth.pose_at(secs + delay(i))).collect();
            hidden.drive(&hidden.readings_along(&hidden.truth.with_poses(poses)), hidden.odometry())
        }
        OtherForm::OdomDistanceScale => {
            hidden.with_odometry(|_, step, _| [if step.x > 0.0 { theta } else { 0.0 }, 0.0])
        }
        OtherForm::OdomImbalance => hidden.with_odometry(|_, step, secs| {
            let speed = step.position().length().copysign(step.x) / secs;
            [0.0, theta * secs * SATURATION_M_S * (speed / SATURATION_M_S).tanh()]
        }),
        OtherForm::WheelSlip => hidden.with_odometry(|i, _, _| {
            let mut chance = hidden.chance(i, WHOLE_SCAN);
            let slips = chance.random::<f64>() < theta;
            // Means without signs: sqrt(2 / pi) of a normal, 2 sqrt(3) / pi of a t with 3 degrees of freedom.
            let scale = value(1) * (2.0 / PI).sqrt() / (2.0 * 3_f64.sqrt() / PI);
            [if slips { scale * student_t(&mut chance).abs() } else { 0.0 }, 0.0]
        }),
        OtherForm::Course(kind, course) => record_course(hidden, kind, course, values),
    }
}

/// The drive with the library's formula of an effect times a course.
fn record_course(hidden: &Altered<'_>, kind: EffectKind, course: Course, values: &[f64]) -> Drive {
    let max = hidden.max_range();
    let whole_secs = hidden.truth.secs()[hidden.scans() - 1].max(1e-9);
    let knots = Course::knots(&mut hidden.chance(0, WHOLE_SCAN));
    let theta = values[0];
    hidden.with_readings(|beam, chance| {
        let over = |share: f64| theta * course.at(&knots, share);
        let incidence = beam.incidence.min(GRAZING_RAD);
        let of_incidence = || over(incidence / GRAZING_RAD);
        let mut lost = |p: f64| if chance.random::<f64>() < p { Change::Lost } else { Change::None };
        match kind {
            EffectKind::WarmupDrift => {
                Change::Shift(over(beam.secs / whole_secs) * (-beam.secs / values[1]).exp())
            }
            EffectKind::RangeScale => Change::Shift(over(beam.reading / max) * beam.reading),
            EffectKind::RangeNoise => {
                widened(hidden.sigma(beam.reading), over(beam.reading / max) * beam.reading, chance)
            }
            EffectKind::RangeDropout if beam.is_return() => {
                lost(over(beam.reading / max) * (beam.reading / max).powf(values[1]))
            }
            _ if !beam.is_wall() => Change::None,
            EffectKind::IncidenceBias => Change::Shift(of_incidence() * incidence.tan().powi(2)),
            EffectKind::IncidenceNoise => {
                let sigma = hidden.sigma(beam.reading);
                widened(sigma, sigma * of_incidence() * incidence.tan().powi(2), chance)
            }
            EffectKind::IncidenceDropout => {
                lost(of_incidence() / (1.0 + ((values[1] - incidence) / values[2]).exp()))
            }
            _ => Change::None,
        }
    })
}

/// 2 (1 / cos(alpha) - 1): about tan^2(alpha) where alpha is small.
fn slant(beam: &Beam<'_>) -> f64 {
    2.0 * (beam.incidence.min(GRAZING_RAD).cos().recip() - 1.0)
}

/// A standard deviation that is larger by `growth` \[m\].
fn widened(sigma: f64, growth: f64, chance: &mut dyn Rng) -> Change {
    let normal: f64 = StandardNormal.sample(chance);
    Change::Shift(((sigma + growth).powi(2) - sigma * sigma).sqrt() * normal)
}

/// Student t with 3 degrees of freedom: of variance 3.
fn student_t(chance: &mut dyn Rng) -> f64 {
    let [a, b, c, d]: [f64; 4] = std::array::from_fn(|_| StandardNormal.sample(&mut *chance));
    a / ((b * b + c * c + d * d) / 3.0).sqrt()
}

/// The symmetric triangular distribution on \[0, 1\].
fn triangular(chance: &mut dyn Rng) -> f64 {
    0.5 * (chance.random::<f64>() + chance.random::<f64>())
}

/// When bursts begin and end \[s\], one after the other, so that they take `share` of the time on average.
fn bursts(hidden: &Altered<'_>, share: f64) -> Vec<[f64; 2]> {
    // Beams of the last scan are later than its stamp.
    let end = hidden.truth.secs()[hidden.scans() - 1] + 1.0;
    if share <= 0.0 {
        return vec![];
    }
    if share >= 1.0 {
        return vec![[0.0, end]];
    }
    let mut chance = hidden.chance(0, WHOLE_SCAN);
    let mut lasting = |mean: f64| -> f64 {
        let lasting: f64 = Exp1.sample(&mut chance);
        mean * lasting
    };
    let gap = BURST_SECS * (1.0 - share) / share;
    let mut bursts = vec![];
    let mut time = lasting(gap);
    while time < end {
        let stop = time + lasting(BURST_SECS);
        bursts.push([time, stop]);
        time = stop + lasting(gap);
    }
    bursts
}

/// The stretch that the nominal ray ends on.
fn stretch_at(beam: &Beam<'_>, place: &[[DVec2; 2]]) -> Option<[DVec2; 2]> {
    let point = beam.wall_point();
    place.iter().copied().find(|[a, b]| {
        let along = *b - *a;
        let share = ((point - *a).dot(along) / along.length_squared()).clamp(0.0, 1.0);
        point.is_finite() && point.distance(*a + share * along) <= NEAR_PLACE_M
    })
}

/// Range of the wall along a stretch that bulges away from the laser by `distance` on average \[m\].
fn range_to_bulge(beam: &Beam<'_>, [a, b]: [DVec2; 2], distance: f64) -> f64 {
    let share = (beam.wall_point() - a).dot(b - a) / (b - a).length_squared();
    let away = 0.5 * PI * distance * (PI * share.clamp(0.0, 1.0)).sin();
    beam.range + away / beam.incidence.cos().max(0.1)
}

/// The edges of a square of the area of a disc, turned by half a radian.
fn square(center: DVec2, radius: f64) -> [[DVec2; 2]; 4] {
    let half = 0.5 * PI.sqrt() * radius;
    let corner = |i: usize| center + DVec2::from_angle(0.5 + 0.5 * PI * i as f64).rotate(DVec2::splat(half));
    std::array::from_fn(|i| [corner(i), corner((i + 1) % 4)])
}

/// Where a ray crosses an edge \[m\].
fn crossing(origin: DVec2, direction: DVec2, [a, b]: [DVec2; 2]) -> Option<f64> {
    let edge = b - a;
    let range = (a - origin).perp_dot(edge) / direction.perp_dot(edge);
    let share = (a - origin).perp_dot(direction) / direction.perp_dot(edge);
    (range >= 0.0 && (0.0..=1.0).contains(&share)).then_some(range)
}
