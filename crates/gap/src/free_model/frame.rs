//! A reference in a frame that is turned and shifted against the map's.

use glam::DVec2;
use locsim_core::Pose2;
use locsim_world::effect::Effects;

use super::Misalignment;
use crate::GapError;
use crate::hypothesis::{Comparison, Fitted};
use crate::null::REFIT;
use crate::statistics::{Covariate, Deviation};

/// Errors of the reference of which a turn and a shift are less than this share have another cause.
const LEAST_SHARE: f64 = 1.0 / 3.0;

/// The turn of the reference's frame \[rad\], positive counter-clockwise, with the shift that goes with it, and what the log gains by poses in
/// the map's frame. Turn and shift are those of the errors that were fitted to the reference; `None` where it has none, or where most of
/// them are others.
///
/// # Errors
/// As [`Comparison::in_world`].
pub(crate) fn turned_frame(
    comparison: &Comparison<'_>,
    effects: &Effects,
    fitted: &Fitted,
) -> Result<Option<Misalignment>, GapError> {
    let error = &fitted.nuisances.pose_error;
    let track = &comparison.recorded.track;
    let count = track.len() as f64;
    let center = track.poses().iter().map(Pose2::position).sum::<DVec2>() / count;
    let shift = fitted.corrections.iter().map(|c| c.truncate()).sum::<DVec2>() / count;
    let [of_position, of_heading] = [error.sigma_m, error.sigma_rad].map(|sigma| sigma.max(1e-6).powi(-2));
    let [mut turned, mut information, mut all] = [0.0; 3];
    for (pose, c) in track.poses().iter().zip(&fitted.corrections) {
        let arm = pose.position() - center;
        turned += of_position * arm.perp_dot(c.truncate()) + of_heading * c.z;
        information += of_position * arm.length_squared() + of_heading;
        all += of_position * c.truncate().length_squared() + of_heading * c.z * c.z;
    }
    let turn = turned / information;
    if turn * turned + of_position * count * shift.length_squared() <= LEAST_SHARE * all {
        return Ok(None);
    }
    let aligned = comparison.recorded.with_reference(|pose| {
        let position = center + shift + DVec2::from_angle(turn).rotate(pose.position() - center);
        Pose2::new(position.x, position.y, pose.theta + turn)
    });
    let aligned = Comparison::new(comparison.nominal, &aligned)?.in_world(effects)?;
    let with = aligned.fit_nuisances_with(effects, &fitted.nuisances, REFIT).scans;
    let without = comparison.evaluate_views(&comparison.views, effects, fitted, 0).scans;
    let folds = comparison.recorded.folds;
    let gains =
        folds.sums(&with).iter().zip(folds.sums(&without)).map(|(with, without)| with - without).collect();
    let (deviation, covariate) = (Deviation::Frame, Covariate::Place);
    Ok(Some(Misalignment { deviation, covariate, estimate: [-turn, information.sqrt().recip()], gains }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Recorded;
    use crate::fixtures::{DRIVE, NOMINAL};
    use crate::hypothesis::Nuisances;

    /// A reference that is turned by 7 mrad about the map's origin.
    #[test]
    fn a_turned_frame_is_found() {
        let found = [0.0, 0.007].map(|turn| {
            let recorded = Recorded::new(&DRIVE, 400, 24, |_| true).unwrap();
            let recorded = recorded.with_reference(|pose| Pose2::new(0.0, 0.0, turn).compose(pose));
            let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
            let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
            turned_frame(&comparison, &NOMINAL.effects, &fitted).unwrap()
        });
        let [none, turned] = found;
        assert!(none.is_none_or(|none| none.gain() < 5.0));
        let turned = turned.unwrap();
        assert!((turned.estimate[0] - 0.007).abs() < 0.001 && turned.gain() > 50.0, "{turned:?}");
    }
}
