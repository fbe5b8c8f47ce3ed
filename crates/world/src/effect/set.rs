use std::f64::consts::{PI, TAU};

use glam::DVec2;
use locsim_core::{Draw, Pose2, Stage, wrap_angle};
use rand::RngExt;

use super::distribution::TAIL_FACTOR;
use super::{
    Alternative, Alternatives, Disc, Effect, EffectError, EffectKind, OdometryDistribution,
    ReadingDistribution, Slip,
};
use crate::raycast::distance_to;
use crate::simulation::{BlockOptions, LaserOptions};

/// A range jumps where a neighbouring beam's differs by more than this \[m\].
pub const JUMP_M: f64 = 0.3;

/// A beam ends on a stretch of wall if its nominal endpoint is no farther from it than this \[m\].
pub const PLACE_REACH_M: f64 = 0.1;

/// 1 / cos and tan^2 of the incidence grow without bound towards grazing rays; beyond this incidence \[rad\], 80 deg,
/// they are as here.
const MAX_INCIDENCE_RAD: f64 = 80.0 * PI / 180.0;

/// Length of the windows that bursts of crosstalk fall on \[s\].
const BURST_SECS: f64 = 1.0;

/// Kinds that replace readings, in the order in which they are tried: what is nearest to the sensor first. They come
/// after those that shape the return.
const REPLACING: [EffectKind; 6] = [
    EffectKind::SectorOcclusion,
    EffectKind::Crosstalk,
    EffectKind::RangeDropout,
    EffectKind::IncidenceDropout,
    EffectKind::Glass,
    EffectKind::MixedPixels,
];

/// All effects of a world; the default is the nominal world.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Effects {
    list: Vec<Effect>,
    /// Indices into the list, in the order in which they act on a reading.
    order: Vec<usize>,
    objects: Vec<Disc>,
    needs: Needs,
}

/// What [`BeamView`] has to hold for the effects at hand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Needs {
    /// [`BeamView::jump`].
    pub jump: bool,
    /// [`BeamView::behind`].
    pub behind: bool,
}

/// What a map says of a beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BeamView {
    /// Time since the drive's first scan \[s\].
    pub secs: f64,
    /// In the laser frame \[rad\].
    pub bearing: f64,
    /// Nominal range \[m\]: to the map's surface; how far the ray was cast where there is none, no less than the
    /// maximum range.
    pub range: f64,
    /// Angle between the beam and the normal of what it meets \[rad\], 0 to pi/2.
    pub incidence: f64,
    /// Where the nominal ray ends, in the map frame \[m\].
    pub endpoint: DVec2,
    /// Nominal ranges of this beam and of the neighbour that it differs from most, the nearer first \[m\]; `None` if
    /// neither differs by more than [`JUMP_M`]. Also see [`jump_at`].
    pub jump: Option<[f64; 2]>,
    /// Range of the next mapped surface behind the first \[m\], `None` without one within the maximum range.
    pub behind: Option<f64>,
}

/// What stands in front of a beam.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HitKind {
    /// A wall of the map or a missing object: something with an incidence. Effects of walls act on it.
    Wall,
    /// A block.
    Object,
}

impl Effects {
    /// The nominal world.
    pub fn none() -> Self {
        Self::default()
    }

    /// A world with these effects, all at once.
    ///
    /// # Errors
    /// [`EffectError`] for an effect that [`Effect::new`] refuses, `wheel_slip` twice, and more than 12 effects that
    /// replace readings.
    pub fn new(list: Vec<Effect>) -> Result<Self, EffectError> {
        let list = list
            .into_iter()
            .map(|Effect { kind, values, place }| Effect::new(kind, values, place))
            .collect::<Result<Vec<_>, _>>()?;
        let has = |kind| list.iter().any(|effect| effect.kind == kind);
        Alternatives::check(list.iter().filter(|effect| REPLACING.contains(&effect.kind)).count())?;
        if list.iter().filter(|effect| effect.kind == EffectKind::WheelSlip).count() > 1 {
            return Err(EffectError::Twice { kind: EffectKind::WheelSlip });
        }
        let rank = |&i: &usize| REPLACING.iter().position(|kind| *kind == list[i].kind);
        let mut order: Vec<usize> = (0..list.len()).collect();
        order.sort_by_key(rank);
        let needs = Needs { jump: has(EffectKind::MixedPixels), behind: has(EffectKind::Glass) };
        let objects = list
            .iter()
            .filter(|effect| effect.kind == EffectKind::MissingObject && effect.values[2] > 0.0)
            .map(|effect| Disc {
                center: DVec2::new(effect.values[0], effect.values[1]),
                radius_m: effect.values[2],
            })
            .collect();
        Ok(Self { list, order, objects, needs })
    }

    /// The effects as they were given.
    pub fn list(&self) -> &[Effect] {
        &self.list
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// What a [`BeamView`] has to hold.
    pub fn needs(&self) -> Needs {
        self.needs
    }

    /// Values of all effects of a kind.
    fn of(&self, kind: EffectKind) -> impl Iterator<Item = &[f64]> {
        self.list.iter().filter(move |effect| effect.kind == kind).map(|effect| effect.values.as_slice())
    }

    /// Sum of the first value of all effects of a kind.
    fn sum(&self, kind: EffectKind) -> f64 {
        self.of(kind).map(|values| values[0]).sum()
    }

    /// Where the laser really sits (`mount_yaw`, `mount_offset`), for where it is said to sit.
    pub fn laser_mount(&self, base_from_laser: Pose2) -> Pose2 {
        let mut mount = base_from_laser;
        for effect in &self.list {
            match (effect.kind, effect.values.as_slice()) {
                (EffectKind::MountYaw, &[yaw]) => mount.theta = wrap_angle(mount.theta + yaw),
                (EffectKind::MountOffset, &[x, y]) => (mount.x, mount.y) = (mount.x + x, mount.y + y),
                _ => {}
            }
        }
        mount
    }

    /// When a beam is really taken \[s\] (`time_offset`, `motion_skew`), which by its stamp is taken at `secs`. Bearing
    /// \[rad\] in the laser frame.
    pub fn beam_secs(&self, bearing: f64, secs: f64) -> f64 {
        let mut secs = secs;
        for effect in &self.list {
            match (effect.kind, effect.values.as_slice()) {
                (EffectKind::TimeOffset, &[delay]) => secs += delay,
                (EffectKind::MotionSkew, &[sweep]) => {
                    secs += sweep * in_half_turns(bearing) / TAU;
                }
                _ => {}
            }
        }
        secs
    }

    /// What stands in the world and isn't in the map (`missing_object`).
    pub fn objects(&self) -> &[Disc] {
        &self.objects
    }

    /// The unmapped blocks as they really are (`block_density`, `block_depth`).
    #[must_use]
    pub fn blocks(&self, nominal: BlockOptions) -> BlockOptions {
        let mut blocks = nominal;
        for effect in &self.list {
            match (effect.kind, effect.values.as_slice()) {
                (EffectKind::BlockDensity, &[factor]) => blocks.per_metre_of_wall *= factor,
                (EffectKind::BlockDepth, &[factor]) => {
                    blocks.width_m = blocks.width_m.map(|width| factor * width);
                    blocks.wall_distance_m = blocks.wall_distance_m.map(|gap| factor * gap);
                }
                _ => {}
            }
        }
        blocks
    }

    /// What the odometry reads of a true motion `base_prev_from_base_now`, before its noise.
    pub fn odometry(&self, increment: &Pose2) -> OdometryDistribution {
        let scale = 1.0 + self.sum(EffectKind::OdomDistanceScale);
        let distance = increment.x.hypot(increment.y).copysign(increment.x);
        let turn = (1.0 + self.sum(EffectKind::OdomTurnScale)) * increment.theta
            + self.sum(EffectKind::OdomImbalance) * distance;
        let slip = match self.of(EffectKind::WheelSlip).next() {
            Some(&[p, share]) => Slip { p, share },
            _ => Slip::default(),
        };
        OdometryDistribution { mean: Pose2::new(scale * increment.x, scale * increment.y, turn), slip }
    }

    /// Range of the wall that a beam ends on \[m\], where it really stands (`moved_wall`).
    pub fn wall_range(&self, view: &BeamView) -> f64 {
        let mut range = view.range;
        for effect in &self.list {
            if effect.kind == EffectKind::MovedWall && is_at(&effect.place, view.endpoint) {
                range += effect.values[0] / view.incidence.min(MAX_INCIDENCE_RAD).cos();
            }
        }
        range.max(0.0)
    }

    /// The distribution of a reading of a beam that meets something at `range` \[m\].
    ///
    /// `met` at `view.range` is the wall of the map, which `moved_wall` may have moved, `glass` let through, and
    /// `mixed_pixels` mixed up with its neighbour. A `range` below it is of a missing object (a wall, whose incidence
    /// the view has to hold) or of a block. Where nothing is met within the maximum range, nothing is returned.
    ///
    /// Bursts of `crosstalk` come and go, and here it isn't known when: their probability is that of a reading at an
    /// unknown time, `p * share`.
    pub fn reading(
        &self,
        laser: &LaserOptions,
        view: &BeamView,
        met: HitKind,
        range: f64,
    ) -> ReadingDistribution {
        let mapped = met == HitKind::Wall && range >= view.range;
        let range = if mapped { self.wall_range(view) } else { range };
        self.reading_of(laser, view, met, range, mapped, |_, share| share)
    }

    /// As [`Effects::reading`], where it is known whether it is the wall of the map that was met, moved as it may be, and
    /// when bursts come: that of the crosstalk which is number `i` of the list and has this share falls on the beam
    /// with probability `burst(i, share)`.
    pub(crate) fn reading_of(
        &self,
        laser: &LaserOptions,
        view: &BeamView,
        met: HitKind,
        range: f64,
        mapped: bool,
        burst: impl Fn(usize, f64) -> f64,
    ) -> ReadingDistribution {
        let max = f64::from(laser.max_range_m as f32);
        let returns = range < max;
        let tan_squared =
            || if met == HitKind::Wall { view.incidence.min(MAX_INCIDENCE_RAD).tan().powi(2) } else { 0.0 };

        let (mut scale, mut bias) = (1.0, 0.0);
        let (mut wall_bias, mut wall_sigma) = (0.0, 1.0);
        let (mut growth, mut tail, mut step_m) = (0.0, 0.0, laser.resolution_m);
        let mut reading = ReadingDistribution {
            mean: f64::INFINITY,
            sigma: 0.0,
            tail: [0.0, TAIL_FACTOR],
            alternatives: Alternatives::default(),
            step_m: laser.resolution_m,
            min_m: f64::from(laser.min_range_m as f32),
            max_m: max,
        };
        let alternatives = &mut reading.alternatives;
        let nominal_sigma = |r: f64| laser.sigma_m + laser.sigma_per_m * r;
        for &i in &self.order {
            let Effect { kind, values, place } = &self.list[i];
            match (kind, values.as_slice()) {
                (EffectKind::RangeBias, &[b]) => bias += b,
                (EffectKind::RangeScale, &[k]) => scale += k,
                (EffectKind::WarmupDrift, &[b, tau]) => bias += b * (-view.secs / tau).exp(),
                (EffectKind::IncidenceBias, &[b]) => wall_bias += b * tan_squared(),
                (EffectKind::RangeNoise, &[c]) => growth += c,
                (EffectKind::IncidenceNoise, &[c]) => wall_sigma += c * tan_squared(),
                // One or the other, or both.
                (EffectKind::HeavyTail, &[p]) => tail += p - tail * p,
                (EffectKind::Quantization, &[step]) => step_m = step.max(step_m),
                (EffectKind::SectorOcclusion, &[from, to, at, p])
                    if at < range && is_between(view.bearing, from, to) =>
                {
                    alternatives.push(p, Alternative::Near { mean: at, sigma: nominal_sigma(at) });
                }
                (EffectKind::Crosstalk, &[p, share]) => {
                    alternatives.push(p * burst(i, share), Alternative::Between { lo: 0.0, hi: max });
                }
                (EffectKind::RangeDropout, &[p, exponent]) if returns => {
                    alternatives.push(p * (range / max).powf(exponent), Alternative::NoReturn);
                }
                (EffectKind::IncidenceDropout, &[p, angle, width]) if returns && met == HitKind::Wall => {
                    let share = 1.0 / (1.0 + (-(view.incidence - angle) / width).exp());
                    alternatives.push(p * share, Alternative::NoReturn);
                }
                (EffectKind::Glass, &[p]) if returns && mapped && is_at(place, view.endpoint) => {
                    let behind = view.behind.filter(|&behind| behind < max);
                    let alternative = behind.map_or(Alternative::NoReturn, |r| Alternative::Near {
                        mean: scale * r + bias,
                        sigma: nominal_sigma(r) + growth * r * r,
                    });
                    alternatives.push(p, alternative);
                }
                (EffectKind::MixedPixels, &[p]) if mapped => {
                    if let Some([lo, hi]) = view.jump {
                        alternatives.push(p, Alternative::Between { lo, hi });
                    }
                }
                _ => {}
            }
        }
        if returns {
            reading.mean = scale * range + (bias + wall_bias);
            reading.sigma = (nominal_sigma(range) + growth * range * range) * wall_sigma;
        }
        reading.tail[0] = tail;
        reading.step_m = step_m;
        reading
    }
}

/// Which window of bursts, of 1 s each, a time \[s\] falls into; times before the start, of beams that are early, into the first.
pub fn burst_window(secs: f64) -> u32 {
    (secs / BURST_SECS) as u32
}

/// Whether bursts fall on a window, for [`Effects::reading_of`]: 1 or 0, by a draw for each window.
pub(crate) fn burst(seed: u64, window: u32) -> impl Fn(usize, f64) -> f64 {
    let draw = Draw::new(seed, Stage::Effect, window);
    // Items from the last downwards, which no beam uses; the very last is that of the odometry.
    move |i, share| f64::from(draw.item(u32::MAX - 1 - i as u32).random::<f64>() < share)
}

/// The draws by which increment `step` of the odometry slips or doesn't.
pub(crate) fn slip_draw(seed: u64, step: u32) -> impl rand::Rng {
    Draw::new(seed, Stage::Effect, step).item(u32::MAX)
}

/// Nominal ranges \[m\] of beam `beam` and of the neighbour that it differs from most, the nearer first; `None` if
/// neither differs by more than [`JUMP_M`]. The first and the last beam of a `closed` scan, a full circle, are
/// neighbours.
pub fn jump_at(nominal: &[f64], beam: usize, closed: bool) -> Option<[f64; 2]> {
    let last = nominal.len() - 1;
    let own = nominal[beam];
    let before = if beam > 0 { Some(beam - 1) } else { closed.then_some(last) };
    let after = if beam < last { Some(beam + 1) } else { closed.then_some(0) };
    let other = [before, after]
        .into_iter()
        .flatten()
        .map(|neighbour| nominal[neighbour])
        .max_by(|a, b| (a - own).abs().total_cmp(&(b - own).abs()))?;
    ((other - own).abs() > JUMP_M).then(|| [own.min(other), own.max(other)])
}

/// Whether a point \[m\] is on a stretch of wall.
fn is_at(place: &[[DVec2; 2]], point: DVec2) -> bool {
    place.iter().any(|stretch| distance_to(stretch, point) <= PLACE_REACH_M)
}

/// More than bearings are off by, as f32 \[rad\]: pi as f32 lies beyond pi.
const BEARING_MARGIN: f64 = 1e-6;

/// A bearing in (-pi, pi] \[rad\].
fn in_half_turns(bearing: f64) -> f64 {
    if bearing.abs() <= PI + BEARING_MARGIN { bearing } else { wrap_angle(bearing) }
}

/// Whether a bearing lies between two others, counter-clockwise from the first \[rad\].
fn is_between(bearing: f64, from: f64, to: f64) -> bool {
    let width = if to >= from { to - from } else { to - from + TAU };
    (bearing - from + BEARING_MARGIN).rem_euclid(TAU) <= width + 2.0 * BEARING_MARGIN
}
