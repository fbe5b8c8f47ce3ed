//! The numbers of the simulated laser and of the unmapped blocks, which effects change and the simulation follows.

use std::f64::consts::TAU;

use locsim_core::Pose2;
use serde::Serialize;

/// Unmapped rectangular blocks along the walls. Each `[lo, hi]` is the interval of a uniform distribution.
///
/// Blocks are a Poisson process over the wall faces, the sides of walls that border free space: their number
/// is Poisson with mean `per_metre_of_wall` times the faces' length, each stands at a uniform place,
/// independent of the others. A block is put on the free side of its wall; where it reaches into another
/// wall, the wall hides it.
///
/// Where a block comes closer than `clearance_m` to the robot's centre, it is left out of that scan. A
/// thinned Poisson process is Poisson, so the probability that nothing stands on a ray is exactly
/// exp(-expected number of blocks on it).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct BlockOptions {
    /// Blocks per metre of wall face \[1/m\], at least 0.
    pub per_metre_of_wall: f64,
    /// Length of a block, along the wall before it is turned \[m\], above 0.
    pub length_m: [f64; 2],
    /// Width of a block \[m\], above 0.
    pub width_m: [f64; 2],
    /// Yaw relative to the wall \[rad\].
    pub yaw_rad: [f64; 2],
    /// Gap between the wall and the block's nearest corner \[m\], at least 0.
    pub wall_distance_m: [f64; 2],
    /// When blocks take new places.
    pub resample: BlockResampling,
    /// Speed along the wall \[m/s\], at least 0, either way; blocks turn back where their centre reaches the
    /// end of the wall face. 0 for blocks that are resampled at each observation.
    pub speed_m_s: [f64; 2],
    /// No block comes closer than this to the robot's centre \[m\], at least 0.
    pub clearance_m: f64,
}

/// Speeds of people \[m/s\].
const WALKING_M_S: [f64; 2] = [0.5, 1.5];

impl BlockOptions {
    /// Scans after which those that walk are elsewhere.
    pub const PASSING_SCANS: u32 = 40;

    /// Times as many.
    #[must_use]
    pub fn times(self, factor: f64) -> Self {
        Self { per_metre_of_wall: factor * self.per_metre_of_wall, ..self }
    }

    /// The same blocks, which take new places when `resample` says. Those that do at every scan don't move.
    #[must_use]
    pub fn resampled(self, resample: BlockResampling) -> Self {
        let stand = resample == BlockResampling::EachObservation;
        Self { resample, speed_m_s: if stand { [0.0; 2] } else { self.speed_m_s }, ..self }
    }

    /// The same blocks as people who walk along the walls, each for some tens of scans.
    #[must_use]
    pub fn walking(self) -> Self {
        Self { resample: BlockResampling::EachScanN(Self::PASSING_SCANS), speed_m_s: WALKING_M_S, ..self }
    }

    /// The greatest distance of a part of a block from its wall \[m\].
    pub fn reach_m(&self) -> f64 {
        let [length, width] = [self.length_m[1], self.width_m[1]];
        let [from, to] = self.yaw_rad;
        let depth = |yaw: f64| length * yaw.sin().abs() + width * yaw.cos().abs();
        // It is deepest with a diagonal across, twice in each half-turn.
        let across = length.atan2(width);
        let has = |yaw: f64| (yaw - from).rem_euclid(std::f64::consts::PI) <= to - from;
        let depth = if has(across) || has(-across) { self.diameter_m() } else { depth(from).max(depth(to)) };
        self.wall_distance_m[1] + depth
    }

    /// The greatest distance between two parts of a block \[m\].
    pub fn diameter_m(&self) -> f64 {
        self.length_m[1].hypot(self.width_m[1])
    }
}

/// When blocks take new places.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum BlockResampling {
    /// At every scan.
    EachObservation,
    /// The number of scans between two draws, at least 1.
    EachScanN(u32),
    /// Never: the blocks of a drive stay, or move at their speed.
    Never,
}

impl std::fmt::Display for BlockResampling {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::EachObservation => f.write_str("each observation"),
            Self::EachScanN(scans) => write!(f, "every {scans} scans"),
            Self::Never => f.write_str("never"),
        }
    }
}

/// A simulated planar laser.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LaserOptions {
    /// Scans per second \[Hz\], above 0.
    pub rate_hz: f64,
    /// Beams per scan, at least 1.
    pub beams: u32,
    /// Field of view \[rad\], above 0, at most 2 pi. At 2 pi beams are spread evenly, the last at bearing pi;
    /// below it both ends carry a beam. A single beam looks ahead.
    pub field_of_view_rad: f64,
    /// Bearing of the first beam \[rad\], -pi to pi. `None`: the middle of the field of view is ahead, or, of a full
    /// circle, the last beam is at pi.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub first_bearing_rad: Option<f64>,
    /// Minimum range \[m\], at least 0.
    pub min_range_m: f64,
    /// Maximum range \[m\], above the minimum.
    pub max_range_m: f64,
    /// Readings are multiples of this \[m\]; 0 for readings that aren't quantized.
    pub resolution_m: f64,
    /// Standard deviation of a reading at range 0 \[m\], at least 0.
    pub sigma_m: f64,
    /// Its growth per metre of range, at least 0: sigma(r) = `sigma_m` + `sigma_per_m` * r.
    pub sigma_per_m: f64,
    /// Where the laser sits, `base_from_laser`.
    pub mount: Pose2,
    /// Time that a sweep over the field of view takes \[s\]: at least 0, at most the time between two scans.
    /// A beam's time after the scan's stamp is its share of the field of view swept before it.
    pub scan_secs: f64,
}

impl LaserOptions {
    /// Whether the field of view is a full circle, so that the first and the last beam are neighbours.
    pub fn is_closed(&self) -> bool {
        is_full_circle(self.field_of_view_rad)
    }
}

pub(crate) fn is_full_circle(field_of_view: f64) -> bool {
    field_of_view >= TAU - 1e-9
}
