//! Errors of a measured map's walls: each piece of a wall stands off by a length of its own, across.
//!
//! All beams that meet a piece share its offset, in all scans. Offsets are normal, with a variance that is the map's own and one
//! that is fitted to the log: what the map doesn't know of its errors.

use distreg::random_effects::GroupEvidence;
use glam::DVec3;

use crate::likelihood::Terms;
use crate::views::{PieceView, Views};

/// Readings this many standard deviations, or this many metres, from where they are expected count for a half and less: of a
/// map that is off by more than the noise, the first readings are far off, and those of other things farther.
const NEAR_SIGMAS: f64 = 3.0;
const NEAR_M: f64 = 0.05;
/// Farther away they don't count \[m\].
const FAR_M: f64 = 0.5;
/// Pieces that are farther off than this are errors of the map that are told one by one; how far the others are off is fitted
/// without them \[m\].
pub const OFF_M: f64 = 0.1;
/// The least standard deviation of the offsets \[m\].
pub const LEAST_M: f64 = 1e-4;

/// What a reading says of poses and walls.
#[derive(Clone, Copy, Debug)]
pub struct Pull {
    /// Index of its beam.
    pub beam: usize,
    /// Its information \[1/m^2\].
    pub weight: f64,
    /// The reading less the range in the map from the reference pose \[m\].
    pub error: f64,
}

/// The weight of a reading in a fit of poses and walls \[1/m^2\] (a redescending estimator: its influence vanishes far away).
pub fn weight(terms: &Terms) -> f64 {
    if !terms.sigma.is_finite() || terms.error.abs() > FAR_M {
        return 0.0;
    }
    let near = (NEAR_SIGMAS * terms.sigma).max(NEAR_M).powi(2);
    (near / (near + terms.error.powi(2))).powi(2) / terms.sigma.powi(2)
}

/// What readings say of each piece, given the corrections of the poses.
pub fn gather(views: &Views, corrections: &[DVec3], pulls: &[Pull], pieces: usize) -> Vec<GroupEvidence> {
    let mut data = vec![GroupEvidence::default(); pieces];
    for &Pull { beam, weight, error } in pulls {
        if let Some(PieceView { piece, lean }) = views.pieces[beam] {
            let jacobian = DVec3::from_array(views.beams[beam].jacobian);
            let error = error - jacobian.dot(corrections[beam / views.per_scan]);
            let data = &mut data[piece as usize];
            data.information += weight * lean * lean;
            data.vector += weight * lean * error;
        }
    }
    data
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use locsim_world::effect::{Effect, EffectKind};
    use locsim_world::simulation::{MovedWalls, odometry_along};

    use crate::fixtures::{DRIVE, MEASURED, TRUTH};
    use crate::hypothesis::{Comparison, Nuisances};
    use crate::nominal::BlockPolicy;
    use locsim_core::Recorded;

    /// A log in a world whose walls stand this far off, with a bias of all ranges.
    fn log(offsets: &[f64], bias_m: f64) -> Recorded {
        let bias = Effect::new(EffectKind::RangeBias, vec![bias_m], Vec::new()).unwrap();
        let effects =
            MEASURED.effects_with(if bias_m == 0.0 { &[] } else { std::slice::from_ref(&bias) }).unwrap();
        let policy = BlockPolicy::of_scenario(&MEASURED.blocks.unwrap());
        let pieces = Arc::clone(MEASURED.pieces.as_ref().unwrap());
        let simulator = MEASURED.simulator(&effects, 1.0, policy).unwrap();
        let simulator = simulator.with_moved_walls(MovedWalls { pieces, offsets: offsets.to_vec() });
        let recorded = Recorded::new(&DRIVE, 400, 72, |_| true).unwrap();
        let poses = TRUTH.poses()[..recorded.scans()].to_vec();
        let odometry = odometry_along(&poses, &MEASURED.odometry, &effects, 3);
        let track = recorded.track.with_poses(poses);
        let readings = simulator.scan_along(track.secs(), |scan, secs| track.pose_during(scan, secs), 3);
        Recorded { track, ..recorded }.with(readings, odometry)
    }

    /// Offsets of walls are found to some millimetres, and how large they are; without any there are hardly some.
    #[test]
    fn walls_are_found_where_they_stand() {
        let count = MEASURED.pieces.as_ref().unwrap().sigmas().len();
        let truth: Vec<f64> = (0..count).map(|i| 0.03 * (f64::from(i as u32) * 2.4).sin()).collect();
        for (truth, size) in [(truth, 0.03 / 2.0_f64.sqrt()), (vec![0.0; count], 0.0)] {
            let recorded = log(&truth, 0.0);
            let comparison = Comparison::new(&MEASURED, &recorded).unwrap();
            let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
            let error_m = fitted.nuisances.wall_error_m.unwrap();
            assert!((error_m - size).abs() < 0.008, "{error_m} for {size}");
            let mut seen = vec![0; count];
            for view in comparison.views.pieces.iter().flatten() {
                seen[view.piece as usize] += 1;
            }
            let often = (0..count).filter(|&i| seen[i] > 100);
            let errors: Vec<f64> = often.map(|i| (fitted.offsets[i] - truth[i]).abs()).collect();
            assert!(errors.len() > 10 && errors.iter().all(|error| *error < 0.008), "{errors:?}");
        }
    }

    /// A bias of all ranges is an error of no wall.
    #[test]
    fn a_bias_is_no_error_of_walls() {
        let recorded = log(&vec![0.0; MEASURED.pieces.as_ref().unwrap().sigmas().len()], 0.05);
        let comparison = Comparison::new(&MEASURED, &recorded).unwrap();
        let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
        assert!(fitted.nuisances.wall_error_m.unwrap() < 0.015, "{:?}", fitted.nuisances);
    }
}
