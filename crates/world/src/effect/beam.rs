//! A beam as the map has it.

use std::f64::consts::PI;

use glam::DVec2;

/// A range jumps where a neighbouring beam's differs by more than this \[m\].
pub const JUMP_M: f64 = 0.3;

/// 1 / cos and tan^2 of the incidence grow without bound towards grazing rays; beyond this incidence \[rad\], 80 deg,
/// they are as here.
pub(super) const MAX_INCIDENCE_RAD: f64 = 80.0 * PI / 180.0;

/// More than bearings are off by, as f32 \[rad\]: pi as f32 lies beyond pi.
pub(super) const BEARING_MARGIN: f64 = 1e-6;

/// A beam of the nominal laser in the map.
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
    /// Direction of the nominal ray in the map frame, of length 1.
    pub direction: DVec2,
    /// Normal of the wall that the nominal ray meets, to the laser's side, of length 1; zero where there is none.
    pub normal: DVec2,
    /// Nominal ranges of this beam and of the neighbour that it differs from most, the nearer first \[m\]; `None` if
    /// neither differs by more than [`JUMP_M`]. Also see [`jump_at`].
    pub jump: Option<[f64; 2]>,
    /// Range of the next mapped surface behind the first \[m\], `None` without one within the maximum range.
    pub behind: Option<f64>,
}

impl BeamView {
    /// Where a reading of `range_m` lies in the map \[m\].
    pub fn point_at(&self, range_m: f64) -> DVec2 {
        self.endpoint - (self.range - range_m) * self.direction
    }
}

/// Surface that a beam meets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HitKind {
    /// A wall of the map or a missing object: something with an incidence. Effects of walls act on it.
    Wall,
    /// A block.
    Object,
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

/// tan^2 of an incidence \[rad\], of 80 deg beyond.
pub(super) fn tan_squared(incidence: f64) -> f64 {
    incidence.min(MAX_INCIDENCE_RAD).tan().powi(2)
}
