//! Scans as beams in the map frame.

use glam::{DVec2, DVec3};
use locsim_core::{Drive, Pose2};

/// The beams of a scan, from right to left, with those that have no reading.
pub(crate) struct Scan {
    /// Where the laser was \[m\].
    pub origin: DVec2,
    pub beams: Vec<Beam>,
    /// How far it has been moved from its reference pose \[m, m, rad\].
    pub correction: DVec3,
}

/// Where a beam ends \[m\].
pub(crate) struct Beam {
    pub end: DVec2,
    /// Whether it ends at a surface.
    pub hit: bool,
}

/// The scan of a step, relative to a point of the map \[m\]; `None` without a reference pose.
pub(crate) fn scan_of(drive: &Drive, step: usize, centre: DVec2, usable_range_m: f64) -> Option<Scan> {
    let laser = &drive.laser;
    let step = &drive.steps[step];
    let map_from_base = step.reference.filter(Pose2::is_finite)?;
    let map_from_laser = map_from_base.compose(&laser.base_from_laser());
    let origin = map_from_laser.position() - centre;
    let beams = step
        .scan
        .ranges
        .iter()
        .zip(laser.bearings())
        .map(|(&range, &bearing)| {
            let returned = range.is_finite() && range >= 0.0 && range < laser.max_range();
            let hit = returned && f64::from(range) <= usable_range_m;
            let length = if returned { f64::from(range).min(usable_range_m) } else { 0.0 };
            Beam { end: origin + length * DVec2::from_angle(map_from_laser.theta + f64::from(bearing)), hit }
        })
        .collect();
    Some(Scan { origin, beams, correction: DVec3::ZERO })
}
