//! Readings as points of surfaces.

use glam::{DMat2, DVec2};

use crate::beams::Scan;

/// Where a beam ended.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hit {
    /// \[m\].
    pub at: DVec2,
    /// Unit normal of the surface, on the side that the laser stood on.
    pub normal: DVec2,
    /// Whether neighbouring readings gave the normal; it points to the laser otherwise.
    pub has_normal: bool,
    /// Number of the scan.
    pub scan: u32,
    /// Whether the next hit of the scan is of the same surface.
    pub linked: bool,
}

/// Readings of one scan are of one surface as far as this from each other \[m\]: half of the narrowest wall that gets a
/// direction from one scan alone.
const NEIGHBOURHOOD_M: f64 = 0.15;

/// Ends of neighbouring beams this near are of one surface whatever the beams' distance \[m\]: the noise of a laser.
const NOISE_M: f64 = 0.05;

/// Neighbouring beams end on one surface when their ends are nearer than this many times the distance between the beams
/// there, that is, up to an incidence of 75 degrees.
const JUMP: f64 = 4.0;

/// As [`JUMP`], when the next end on either side lies on the same line: up to 86 degrees.
const JUMP_ON_LINE: f64 = 14.0;

/// A surface that is seen at a smaller angle than this \[rad\] is no surface: readings between a near and a far surface
/// lie along the beam.
const GRAZING: f64 = 0.07;

/// The hits of a scan. Normals come from neighbouring readings by total least squares; a reading without neighbours
/// faces the laser.
pub(crate) fn hits_of(number: u32, scan: &Scan) -> Vec<Hit> {
    let beams = &scan.beams;
    let links: Vec<bool> = (0..beams.len()).map(|i| is_linked(scan, i)).collect();
    let hit = |i: usize| {
        let at = beams[i].end;
        let back = (scan.origin - at).normalize_or_zero();
        if !beams[i].hit || back == DVec2::ZERO {
            return None;
        }
        let mut near = vec![at];
        // One neighbour on each side at least, far as it may be.
        let is_near = |j: usize| i.abs_diff(j) == 1 || beams[j].end.distance(at) <= NEIGHBOURHOOD_M;
        near.extend((i + 1..beams.len()).take_while(|&j| links[j - 1] && is_near(j)).map(|j| beams[j].end));
        near.extend((0..i).rev().take_while(|&j| links[j] && is_near(j)).map(|j| beams[j].end));
        let normal = if near.len() >= 3 { principal_normal(&near) } else { back };
        let normal = if normal.dot(back) < 0.0 { -normal } else { normal };
        let has_normal = near.len() >= 3 && normal.dot(back) >= GRAZING;
        let normal = if has_normal { normal } else { back };
        Some(Hit { at, normal, has_normal, scan: number, linked: links[i] })
    };
    (0..beams.len()).filter_map(hit).collect()
}

/// Whether a beam and the next end on one surface.
fn is_linked(scan: &Scan, i: usize) -> bool {
    let Some([a, b]) = scan.beams.get(i..i + 2) else { return false };
    if !(a.hit && b.hit) {
        return false;
    }
    let (u, v) = (a.end - scan.origin, b.end - scan.origin);
    let across = u.perp_dot(v).abs() / u.length().max(v.length()).max(1e-9);
    let apart = a.end.distance(b.end);
    let continues = |j: Option<usize>, from: DVec2, to: DVec2| {
        j.and_then(|j| scan.beams.get(j)).is_some_and(|beam| {
            let line = (to - from).normalize_or_zero();
            beam.hit && line.perp_dot(beam.end - from).abs() <= NOISE_M
        })
    };
    apart <= NOISE_M + JUMP * across
        || apart <= JUMP_ON_LINE * across
            && (continues(i.checked_sub(1), a.end, b.end) || continues(Some(i + 2), a.end, b.end))
}

/// Direction in which points scatter least.
fn principal_normal(points: &[DVec2]) -> DVec2 {
    let mean = points.iter().sum::<DVec2>() / points.len() as f64;
    let mut scatter = DMat2::ZERO;
    for point in points {
        let d = *point - mean;
        scatter += DMat2::from_cols(d * d.x, d * d.y);
    }
    least_direction(scatter)
}

/// Unit eigenvector of the smaller eigenvalue of a symmetric matrix.
pub(crate) fn least_direction(scatter: DMat2) -> DVec2 {
    let (xx, xy, yy) = (scatter.x_axis.x, scatter.x_axis.y, scatter.y_axis.y);
    let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
    DVec2::from_angle(angle).perp()
}
