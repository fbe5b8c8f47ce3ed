//! The beams of a log by its reference poses and the map. Statistics are laid out over these, and never over readings: a
//! log and its replicates have the same statistics.

use std::sync::OnceLock;

use locsim_comparison::{Comparison, jumps};
use locsim_world::effect::BeamState;
use rayon::prelude::*;

use super::wall_cells::WallCells;

/// The beams of a log, before any reading is looked at.
pub(crate) struct Survey<'a> {
    pub comparison: &'a Comparison<'a>,
    /// Velocity of the robot at each scan, in the map frame \[m/s, m/s, rad/s\].
    pub velocities: Vec<[f64; 3]>,
    jumps: OnceLock<Vec<Option<[f64; 2]>>>,
    walls: OnceLock<WallCells>,
    /// The laser's maximum range \[m\].
    pub max_range: f64,
}

impl<'a> Survey<'a> {
    pub fn new(comparison: &'a Comparison<'a>) -> Self {
        let (nominal, recorded) = (comparison.nominal, &*comparison.recorded);
        Self {
            comparison,
            velocities: recorded.velocities(),
            jumps: OnceLock::new(),
            walls: OnceLock::new(),
            max_range: nominal.laser.max_range_m,
        }
    }

    /// The two ranges of the edge that a beam is at.
    pub fn jumps(&self) -> &[Option<[f64; 2]>] {
        let Comparison { nominal, recorded, views } = self.comparison;
        let of_scan = |scan| jumps(nominal, recorded, scan);
        self.jumps.get_or_init(|| (0..views.scans()).into_par_iter().flat_map_iter(of_scan).collect())
    }

    /// The cells of the map's walls.
    pub(super) fn walls(&self) -> &WallCells {
        self.walls.get_or_init(|| WallCells::new(&self.comparison.views, self.max_range))
    }

    /// The number of beams.
    pub fn beams(&self) -> usize {
        self.comparison.views.beams.len()
    }

    /// The scan of a beam.
    pub fn scan(&self, beam: usize) -> usize {
        beam / self.comparison.views.per_scan
    }

    /// Bearings of a scan's beams \[rad\].
    pub fn bearings(&self) -> Vec<f64> {
        self.comparison.recorded.laser.bearings().iter().map(|&bearing| f64::from(bearing)).collect()
    }

    /// A beam, as weights of scores see it.
    pub fn beam_state(&self, index: usize) -> BeamState {
        let (beam, scan) = (&self.comparison.views.beams[index], self.scan(index));
        let (laser, recorded) = (&self.comparison.nominal.laser, &*self.comparison.recorded);
        let range = beam.range();
        BeamState {
            secs: recorded.track.secs()[scan],
            bearing: beam.view.bearing,
            range,
            incidence: beam.view.incidence,
            sigma: laser.sigma_m + laser.sigma_per_m * range,
            max_range: self.max_range,
            jacobian: beam.jacobian,
            heading: recorded.track.poses()[scan].theta,
            velocity: self.velocities[scan],
        }
    }
}
