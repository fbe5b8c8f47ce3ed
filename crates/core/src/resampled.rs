//! Readings of a scan at other bearings than they were taken at.

use std::f64::consts::TAU;

/// Readings at neighbouring bearings are of one surface where they differ by no more than this \[m\], and than a wall does that is slanted
/// by 80 degrees: the tangent of that.
const ONE_SURFACE_M: f64 = 0.05;
const STEEPEST: f64 = 5.67;
/// A bearing has a reading where one lies within this share of a beam of it.
const NEAR_BEAMS: f64 = 0.9;

/// Readings \[m\] with their bearings \[rad\], in any order, at evenly spaced `bearings` \[rad\]: on the line between two neighbours of one surface, the
/// nearest one elsewhere, and NaN where none is near. Only where `is_return` holds a reading is of a surface. Readings that are NaN, or at a bearing
/// that isn't finite, don't count.
pub fn resampled(
    readings: impl IntoIterator<Item = (f64, f32)>,
    is_return: impl Fn(f32) -> bool,
    bearings: &[f32],
) -> Vec<f32> {
    let (Some(first), Some(last)) = (bearings.first().map(|b| f64::from(*b)), bearings.last()) else {
        return Vec::new();
    };
    let step = (f64::from(*last) - first) / (bearings.len() - 1).max(1) as f64;
    // From the first bearing on, in the direction of the others.
    let along = |bearing: f64| (step.signum() * (bearing - first)).rem_euclid(TAU);
    let known = readings.into_iter().filter(|(bearing, range)| bearing.is_finite() && !range.is_nan());
    let mut seen: Vec<(f64, f32)> = known.map(|(bearing, range)| (along(bearing), range)).collect();
    seen.sort_by(|a, b| a.0.total_cmp(&b.0));
    bearings.iter().map(|bearing| at(&seen, along(f64::from(*bearing)), step.abs(), &is_return)).collect()
}

/// The reading at a bearing, between those to both sides.
fn at(seen: &[(f64, f32)], along: f64, beam_rad: f64, is_return: &impl Fn(f32) -> bool) -> f32 {
    let Some(last) = seen.len().checked_sub(1) else { return f32::NAN };
    let next = seen.partition_point(|seen| seen.0 < along);
    let before = seen[if next == 0 { last } else { next - 1 }];
    let after = seen[if next > last { 0 } else { next }];
    let to_before = (along - before.0).rem_euclid(TAU);
    let to_after = (after.0 - along).rem_euclid(TAU);
    let (nearest, apart) = if to_before < to_after { (before.1, to_before) } else { (after.1, to_after) };
    if apart > NEAR_BEAMS * beam_rad {
        return f32::NAN;
    }
    let between = to_before + to_after;
    let [a, b] = [before.1, after.1].map(f64::from);
    let are_one = is_return(before.1)
        && is_return(after.1)
        && between < 2.0 * NEAR_BEAMS * beam_rad
        && (a - b).abs() < ONE_SURFACE_M + STEEPEST * between * f64::from(nearest);
    // Where the line through both meets the bearing.
    let across = a * to_before.sin() + b * to_after.sin();
    if are_one && across > 0.0 { (a * b * between.sin() / across) as f32 } else { nearest }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall at x = 2 m, and nothing beside it.
    fn wall(bearing: f64) -> f32 {
        if bearing.abs() < 0.6 { (2.0 / bearing.cos()) as f32 } else { f32::INFINITY }
    }

    #[test]
    fn a_wall_stays_where_it_is() {
        let bearings: Vec<f32> = (0..100_u8).map(|i| 0.02 * f32::from(i) - 1.0).collect();
        let others = (0..93_u8).map(|i| 0.0215 * f64::from(i) - 1.0).map(|bearing| (bearing, wall(bearing)));
        for direction in [1.0, -1.0] {
            let bearings: Vec<f32> = bearings.iter().map(|bearing| direction * bearing).collect();
            let found = resampled(others.clone(), f32::is_finite, &bearings);
            for (bearing, range) in bearings.iter().zip(found) {
                let bearing = f64::from(*bearing);
                // And beyond the last of the others.
                let is_at_border = (bearing.abs() - 0.6).abs() < 0.0215 || bearing > 0.98;
                let expected = wall(bearing);
                assert!(
                    is_at_border || range == expected || (range - expected).abs() < 1e-5,
                    "{bearing} {range}"
                );
            }
        }
    }

    /// A gap of three beams has nothing in it, and a jump isn't bridged.
    #[test]
    fn what_is_not_seen_is_not_made_up() {
        let bearings: Vec<f32> = (0..20_u8).map(|i| 0.02 * f32::from(i)).collect();
        let reading = |i: u8| (0.02 * f64::from(i) + 0.008, if i < 10 { 1.0 } else { 4.0 });
        let found = resampled((0..20_u8).filter(|i| !(4..8).contains(i)).map(reading), |_| true, &bearings);
        assert!(found[6].is_nan() && !found[3].is_nan(), "{found:?}");
        assert!(
            found
                .iter()
                .all(|range| range.is_nan() || (range - 1.0).abs() < 1e-3 || (range - 4.0).abs() < 1e-2),
            "{found:?}"
        );
        assert!(resampled([], |_| true, &bearings).iter().all(|range| range.is_nan()));
        assert!(resampled([(0.0, 1.0)], |_| true, &[]).is_empty());
    }
}
