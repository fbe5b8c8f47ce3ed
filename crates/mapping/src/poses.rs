//! Small corrections of the poses that scans were taken from.

use glam::{DMat3, DVec2, DVec3};

use crate::beams::Scan;
use crate::hits::Hit;
use crate::surface::Surface;

/// Standard deviations of a reference pose \[m, rad\]: 5 cm and half a degree. They decide only where the walls don't, as
/// along a corridor.
const REFERENCE_SIGMA: (f64, f64) = (0.05, 0.0087);

/// A reading that is farther from its wall than this counts less \[m\].
const NEAR_M: f64 = 0.03;

/// Standard deviation of a reading, with what neighbouring readings have in common \[m\].
const READING_SIGMA_M: f64 = 0.1;

/// Moves each scan so that its hits come nearer to their surfaces, given with the hits' numbers: one step of Gauss and Newton with Cauchy's weights.
pub(crate) fn correct_poses<'a>(
    scans: &mut [Scan],
    hits: &mut [Hit],
    surfaces: impl Iterator<Item = (&'a Surface, &'a [u32])>,
) {
    let mut sums = vec![(DMat3::ZERO, DVec3::ZERO); scans.len()];
    for (surface, members) in surfaces {
        for hit in members.iter().map(|&i| &hits[i as usize]) {
            let distance = surface.distance(hit.at);
            let arm = hit.at - scans[hit.scan as usize].origin;
            let gradient = surface.normal.extend(surface.normal.dot(arm.perp()));
            let weight = 1.0 / ((1.0 + (distance / NEAR_M).powi(2)) * READING_SIGMA_M.powi(2));
            let (information, pull) = &mut sums[hit.scan as usize];
            *information += weight
                * DMat3::from_cols(gradient * gradient.x, gradient * gradient.y, gradient * gradient.z);
            *pull -= weight * distance * gradient;
        }
    }
    let (sigma_m, sigma_rad) = REFERENCE_SIGMA;
    let prior = DVec3::new(sigma_m.powi(-2), sigma_m.powi(-2), sigma_rad.powi(-2));
    for (scan, (information, pull)) in scans.iter_mut().zip(&mut sums) {
        *information += DMat3::from_diagonal(prior);
        *pull -= prior * scan.correction;
    }
    let steps: Vec<(DVec2, DVec3)> = scans
        .iter()
        .zip(&sums)
        .map(|(scan, (information, pull))| (scan.origin, information.inverse() * *pull))
        .collect();
    let moved = |(origin, step): (DVec2, DVec3), point: DVec2| {
        origin + step.truncate() + DVec2::from_angle(step.z).rotate(point - origin)
    };
    for hit in hits.iter_mut() {
        let step = steps[hit.scan as usize];
        hit.at = moved(step, hit.at);
        hit.normal = DVec2::from_angle(step.1.z).rotate(hit.normal);
    }
    for (scan, &step) in scans.iter_mut().zip(&steps) {
        scan.beams.iter_mut().for_each(|beam| beam.end = moved(step, beam.end));
        scan.origin = moved(step, scan.origin);
        scan.correction += step.1;
    }
}
