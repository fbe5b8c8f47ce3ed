//! A reference in a frame that is turned and shifted against the map's.

use glam::DVec2;
use locsim_core::{Pose2, TurnedFrame};
use locsim_world::effect::Effects;

use super::Misalignment;
use crate::hypothesis::{Comparison, Fitted};
use crate::null::REFIT;
use crate::statistics::{Covariate, Deviation};
use crate::{GapError, Recorded};

/// Errors of the reference of which a turn and a shift are less than this share have another cause.
const LEAST_SHARE: f64 = 1.0 / 3.0;
/// A smaller turn \[rad\] is none: 4 mm at 10 m. Errors are then those of a shift.
const LEAST_TURN: f64 = 4e-4;
/// Steps in which a turn is found.
const STEPS: usize = 4;

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
    let nuisances = &fitted.nuisances;
    let frame_of = |recorded: &Recorded, fitted: &Fitted| {
        let frame = nuisances.pose_error.turned_frame(&recorded.track, &fitted.corrections);
        (frame.share > LEAST_SHARE).then_some(frame)
    };
    let Some(mut frame) = frame_of(comparison.recorded, fitted) else { return Ok(None) };
    let (mut recorded, mut turn) = (comparison.recorded.clone(), 0.0);
    let mut with: Vec<f64> = Vec::new();
    let gain = |scans: &[f64]| scans.iter().sum::<f64>();
    // Errors are found smaller than they are, as most errors of a reference come and go.
    for _ in 0..STEPS {
        let TurnedFrame { center, shift, .. } = frame;
        recorded = recorded.with_reference(|pose| {
            let position = center + shift + DVec2::from_angle(frame.turn).rotate(pose.position() - center);
            Pose2::new(position.x, position.y, pose.theta + frame.turn)
        });
        let aligned = Comparison::new(comparison.nominal, &recorded)?.in_world(effects)?;
        let fitted = aligned.fit_nuisances_with(effects, nuisances, REFIT);
        if !with.is_empty() && gain(&fitted.scans) < gain(&with) {
            break;
        }
        turn += frame.turn;
        let left = frame_of(&recorded, &fitted);
        with = fitted.scans;
        match left {
            Some(left) => frame = left,
            None => break,
        }
    }
    let without = comparison.evaluate_views(&comparison.views, effects, fitted, 0).scans;
    let folds = comparison.recorded.folds;
    let gains =
        folds.sums(&with).iter().zip(folds.sums(&without)).map(|(with, without)| with - without).collect();
    let (deviation, covariate) = (Deviation::Frame, Covariate::Place);
    let estimate = [-turn, frame.information.sqrt().recip()];
    let found = Misalignment { deviation, covariate, estimate, gains };
    Ok((turn.abs() >= LEAST_TURN).then_some(found))
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
