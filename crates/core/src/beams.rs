use crate::Poses;

/// The surface id of a beam that hit nothing within the maximum range.
pub const NO_SURFACE: u32 = u32::MAX;

/// Nominal ranges are cast to this multiple of the maximum range. A wall just beyond the maximum range matters: objects
/// stand in front of it within range.
pub const CAST_REACH: f32 = 1.5;

/// Results of ray casts into the map for n laser poses x k bearings. Every array has n*k entries, pose-major: entry
/// `i * k + j` is beam `j` from pose `i`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Hits {
    /// Nominal range r \[m\]: distance to the nearest mapped surface; how far the ray was cast where there is none.
    pub range: Vec<f32>,
    /// Incidence angle alpha \[rad\] in [0, pi/2]: between the beam and the surface's normal; 0 without a hit.
    pub incidence: Vec<f32>,
    /// Id of the surface that was hit, [`NO_SURFACE`] without a hit.
    pub surface: Vec<u32>,
}

impl Hits {
    /// Makes room for `n` beams; keeps capacity.
    pub fn resize(&mut self, n: usize) {
        self.range.resize(n, 0.0);
        self.incidence.resize(n, 0.0);
        self.surface.resize(n, NO_SURFACE);
    }

    /// Number of beams.
    pub fn len(&self) -> usize {
        self.range.len()
    }

    /// No beams at all.
    pub fn is_empty(&self) -> bool {
        self.range.is_empty()
    }

    /// Borrows these hits as the beams of `laser` x `bearings`.
    ///
    /// # Panics
    /// If the number of hits is not `laser.len() * bearings.len()`.
    pub fn beams<'a>(&'a self, laser: Poses<'a>, bearings: &'a [f32], max_range: f32) -> Beams<'a> {
        assert_eq!(self.len(), laser.len() * bearings.len(), "hits do not match poses x bearings");
        Beams {
            laser,
            bearings,
            range: &self.range,
            incidence: &self.incidence,
            surface: &self.surface,
            max_range,
        }
    }
}

/// A batch of beams as sensor models see it: n laser poses x k bearings with their nominal ray casts.
/// The `[n*k]` arrays are pose-major.
#[derive(Clone, Copy, Debug)]
pub struct Beams<'a> {
    /// n laser poses in the map frame.
    pub laser: Poses<'a>,
    /// k bearings \[rad\] in the laser frame.
    pub bearings: &'a [f32],
    /// Nominal range r of each beam \[m\], from casts of at least `max_range`, at most [`CAST_REACH`] times that; no
    /// less than `max_range` where the map has no surface that the sensor could see. \[n*k\]
    pub range: &'a [f32],
    /// Incidence angle alpha of each beam \[rad\], 0 to pi/2. \[n*k\]
    pub incidence: &'a [f32],
    /// Surface id of each beam. \[n*k\]
    pub surface: &'a [u32],
    /// The sensor's maximum range \[m\]; a reading equal to it means "no return".
    pub max_range: f32,
}

impl<'a> Beams<'a> {
    /// Number of beams, n*k.
    pub fn len(&self) -> usize {
        self.range.len()
    }

    /// No beams at all.
    pub fn is_empty(&self) -> bool {
        self.range.is_empty()
    }

    /// Beams per pose, k.
    pub fn per_pose(&self) -> usize {
        self.bearings.len()
    }

    /// Number of poses, n.
    pub fn poses(&self) -> usize {
        self.laser.len()
    }

    /// The beams of poses `start..end` only.
    #[must_use]
    pub fn slice_poses(&self, start: usize, end: usize) -> Beams<'a> {
        let k = self.per_pose();
        Beams {
            laser: self.laser.slice(start, end),
            bearings: self.bearings,
            range: &self.range[start * k..end * k],
            incidence: &self.incidence[start * k..end * k],
            surface: &self.surface[start * k..end * k],
            max_range: self.max_range,
        }
    }

    /// Direction of beam `i` (pose-major index) in the map frame \[rad\], not wrapped.
    pub fn heading(&self, i: usize) -> f64 {
        let k = self.per_pose();
        self.laser.theta[i / k] + f64::from(self.bearings[i % k])
    }
}
