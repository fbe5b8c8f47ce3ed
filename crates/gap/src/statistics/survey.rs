//! The beams of a log by its reference poses and the map. Statistics are laid out over these, and never over readings: a
//! log and its replicates have the same statistics.

use locsim_comparison::{Comparison, jumps};
use locsim_world::effect::BeamState;

use super::wall_cells::WallCells;

/// The beams of a log, before any reading is looked at.
pub(crate) struct Survey<'a> {
    pub comparison: &'a Comparison<'a>,
    /// Velocity of the robot at each scan, in the map frame \[m/s, m/s, rad/s\].
    pub velocities: Vec<[f64; 3]>,
    /// The two ranges of the edge that a beam is at.
    pub jumps: Vec<Option<[f64; 2]>>,
    pub(super) walls: WallCells,
    /// The laser's maximum range \[m\].
    pub max_range: f64,
}

impl<'a> Survey<'a> {
    pub fn new(comparison: &'a Comparison<'a>) -> Self {
        let (nominal, recorded) = (comparison.nominal, &*comparison.recorded);
        let max_range = nominal.laser.max_range_m;
        let scans = 0..comparison.views.scans();
        Self {
            comparison,
            velocities: recorded.velocities(),
            jumps: scans.flat_map(|scan| jumps(nominal, recorded, scan)).collect(),
            walls: WallCells::new(&comparison.views, max_range),
            max_range,
        }
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
