use std::f64::consts::TAU;

use glam::DVec2;
use locsim_core::Pose2;
use locsim_world::raycast::{BEHIND_M, RayHit};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

use super::Altered;

/// A reading within this many standard deviations of the wall is the wall's.
const OF_WALL_SIGMAS: f64 = 5.0;

/// Neighbouring ranges differ by more than this at an edge \[m\].
const EDGE_M: f64 = 0.3;

/// Fate of a reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Change {
    /// It stays.
    None,
    /// A return is off by so much \[m\].
    Shift(f64),
    /// Something at this range is read instead \[m\], with the laser's noise.
    Return(f64),
    /// This is read instead \[m\].
    Value(f64),
    /// Nothing returns.
    Lost,
}

/// The beams of one scan from where the robot really was.
pub(super) struct Sweep<'a> {
    hidden: &'a Altered<'a>,
    scan: usize,
    rays: Vec<Ray>,
}

struct Ray {
    secs: f64,
    origin: DVec2,
    direction: DVec2,
    hit: Option<RayHit>,
}

/// A reading and what the map has in front of its beam.
pub(super) struct Beam<'a> {
    sweep: &'a Sweep<'a>,
    /// Index of the scan.
    pub scan: usize,
    /// Index among the beams of the scan.
    pub index: usize,
    /// Time since the first scan \[s\].
    pub secs: f64,
    /// In the laser frame \[rad\].
    pub bearing: f64,
    /// Where the ray starts, in the map frame \[m\].
    pub origin: DVec2,
    /// Unit vector along the ray, in the map frame.
    pub direction: DVec2,
    /// To the map's wall \[m\]; infinite where none is within reach.
    pub range: f64,
    /// Angle between the ray and the wall's normal \[rad\], 0 to pi/2.
    pub incidence: f64,
    /// The map's surface there.
    pub surface: Option<u32>,
    /// The nominal reading \[m\].
    pub reading: f64,
}

impl<'a> Sweep<'a> {
    pub fn new(hidden: &'a Altered<'a>, scan: usize) -> Self {
        let laser = hidden.simulator.laser().laser();
        let stamp = hidden.truth.secs()[scan];
        let beams = laser.bearings().iter().zip(laser.beam_times_secs());
        let ray = |(&bearing, &offset): (&f32, &f32)| {
            let secs = stamp + f64::from(offset);
            let (origin, direction) = hidden.ray(&hidden.truth.pose_at(secs), f64::from(bearing));
            Ray { secs, origin, direction, hit: hidden.cast(origin, direction) }
        };
        Self { hidden, scan, rays: beams.map(ray).collect() }
    }

    pub fn beam(&'a self, index: usize, reading: f32) -> Beam<'a> {
        let Ray { secs, origin, direction, hit } = self.rays[index];
        Beam {
            sweep: self,
            scan: self.scan,
            index,
            secs,
            bearing: f64::from(self.hidden.simulator.laser().laser().bearings()[index]),
            origin,
            direction,
            range: hit.map_or(f64::INFINITY, |hit| hit.range),
            incidence: hit.map_or(0.0, |hit| hit.incidence),
            surface: hit.map(|hit| hit.surface),
            reading: f64::from(reading),
        }
    }

    /// Ranges of the neighbours of a beam \[m\].
    fn neighbours(&self, index: usize) -> impl Iterator<Item = f64> {
        let n = self.rays.len();
        let closed = self.hidden.nominal.laser.field_of_view_rad >= TAU - 1e-6;
        let wrapped = |other: usize, at_end: bool| (closed || !at_end).then_some(other % n);
        let both = [wrapped(index + n - 1, index == 0), wrapped(index + 1, index == n - 1)];
        let reach = f64::from(self.hidden.simulator.laser().laser().cast_range());
        both.into_iter().flatten().map(move |i| self.rays[i].hit.map_or(reach, |hit| hit.range))
    }
}

impl Altered<'_> {
    /// Origin \[m\] and unit vector of a beam in the map frame, of a robot at `map_from_base`.
    pub fn ray(&self, map_from_base: &Pose2, bearing: f64) -> (DVec2, DVec2) {
        let map_from_laser = map_from_base.compose(&self.nominal.laser.mount);
        (map_from_laser.position(), DVec2::from_angle(map_from_laser.theta + bearing))
    }

    pub fn cast(&self, origin: DVec2, direction: DVec2) -> Option<RayHit> {
        let reach = f64::from(self.simulator.laser().laser().cast_range());
        self.nominal.map.cast_ray(origin, direction, reach)
    }

    /// The laser's maximum range \[m\].
    pub fn max_range(&self) -> f64 {
        f64::from(self.simulator.laser().laser().max_range())
    }

    /// Standard deviation of a return \[m\].
    pub fn sigma(&self, range: f64) -> f64 {
        self.nominal.laser.sigma_m + self.nominal.laser.sigma_per_m * range
    }
}

impl Beam<'_> {
    /// Whether something returned.
    pub fn is_return(&self) -> bool {
        self.reading < self.sweep.hidden.max_range()
    }

    /// Whether the reading is the wall's.
    pub fn is_wall(&self) -> bool {
        let options = &self.sweep.hidden.nominal.laser;
        let near = OF_WALL_SIGMAS * self.sweep.hidden.sigma(self.range) + options.resolution_m;
        self.is_return() && (self.reading - self.range).abs() <= near
    }

    /// Where the reading is, in the map frame \[m\].
    pub fn endpoint(&self) -> DVec2 {
        self.origin + self.reading * self.direction
    }

    /// Where the map's wall is met \[m\].
    pub fn wall_point(&self) -> DVec2 {
        self.origin + self.range * self.direction
    }

    /// Ranges of this beam and of the neighbour that it differs from most, if that is an edge \[m\].
    pub fn edge(&self) -> Option<[f64; 2]> {
        let other = self
            .sweep
            .neighbours(self.index)
            .max_by(|a, b| (a - self.range).abs().total_cmp(&(b - self.range).abs()))?;
        ((other - self.range).abs() > EDGE_M).then(|| [self.range.min(other), self.range.max(other)])
    }

    /// Range of the next wall behind the first within the maximum range \[m\].
    pub fn behind(&self) -> Option<f64> {
        let hidden = self.sweep.hidden;
        hidden.nominal.map.cast_behind(self.origin, self.direction, self.range, hidden.max_range())
    }

    /// From the wall to what the ray meets as in a mirror there \[m\].
    pub fn mirrored(&self) -> Option<f64> {
        /// A second ray beside it shows the wall's direction \[rad\].
        const ASIDE_RAD: f64 = 1e-5;
        let hidden = self.sweep.hidden;
        let aside = DVec2::from_angle(ASIDE_RAD).rotate(self.direction);
        let beside = self.origin + hidden.cast(self.origin, aside)?.range * aside;
        let at = self.wall_point();
        let along = (beside - at).try_normalize()?;
        let onward = 2.0 * self.direction.dot(along) * along - self.direction;
        let start = at + BEHIND_M * onward;
        hidden.cast(start, onward).map(|hit| BEHIND_M + hit.range)
    }

    /// The change where the wall, or something before it, stands at `range` \[m\] instead; what stands before both, and
    /// what was lost on the way, stays.
    pub fn standing_at(&self, range: f64) -> Change {
        let max = self.sweep.hidden.max_range();
        if range == self.range {
            Change::None
        } else if self.is_wall() {
            if range < max { Change::Shift(range - self.range) } else { Change::Lost }
        } else if self.is_return() {
            // A block is hidden by what now stands before it.
            let hides = range < self.reading && self.reading < self.range;
            if hides { Change::Return(range) } else { Change::None }
        } else {
            let was_beyond = self.range >= max;
            if was_beyond && range < max { Change::Return(range) } else { Change::None }
        }
    }

    /// The reading after a change.
    ///
    /// A nominal reading is a multiple of the laser's resolution, and a shift far below it would be lost. So a shift
    /// starts from anywhere within the step: from where the reading was before it was rounded, as far as one can know.
    pub fn read(&self, change: Change, chance: &mut impl Rng) -> f32 {
        let hidden = self.sweep.hidden;
        let laser = hidden.simulator.laser().laser();
        let (min, max) = (laser.min_range(), laser.max_range());
        let step = hidden.nominal.laser.resolution_m;
        let noisy = match change {
            Change::None => return self.reading as f32,
            _ if self.reading.is_nan() => return f32::NAN,
            Change::Shift(_) if !self.is_return() => return max,
            Change::Shift(0.0) => return self.reading as f32,
            Change::Shift(shift) => {
                let within = step * 0.998 * (chance.random::<f64>() - 0.5);
                self.reading + within + shift
            }
            Change::Return(range) => {
                let normal: f64 = StandardNormal.sample(chance);
                range + hidden.sigma(range) * normal
            }
            Change::Value(value) => value,
            Change::Lost => return max,
        };
        let rounded = if step > 0.0 { (noisy / step).round() * step } else { noisy } as f32;
        if rounded >= max {
            max
        } else if rounded < min {
            f32::NAN
        } else {
            rounded
        }
    }
}

/// Whether a bearing lies in a sector that starts at `from` and is `width` wide, counter-clockwise \[rad\]; both ends
/// belong to it, also as f32.
pub(super) fn is_in_sector(bearing: f64, from: f64, width: f64) -> bool {
    const MARGIN: f64 = 1e-6;
    (bearing - from + MARGIN).rem_euclid(TAU) <= width + 2.0 * MARGIN
}
