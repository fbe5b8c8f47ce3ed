//! A reference in a frame that is turned and shifted against the map's.

use glam::{DVec2, DVec3};
use locsim_comparison::{Comparison, Fitted};
use locsim_core::differences;
use locsim_world::effect::Effects;

use super::Misalignment;
use crate::null::REFIT;
use crate::statistics::{Covariate, Deviation};
use crate::{GapError, Recorded};

/// Errors of the reference of which a turn and a shift are less than this share have another cause.
const LEAST_SHARE: f64 = 1.0 / 3.0;
/// A smaller turn \[rad\] is none: 4 mm at 10 m. Errors are then those of a shift.
const LEAST_TURN: f64 = 4e-4;
/// A smaller shift is none \[m\].
const LEAST_SHIFT_M: f64 = 0.004;
/// Steps in which a frame is found.
const STEPS: usize = 4;

/// The turn of the reference's frame \[rad\], positive counter-clockwise, with the shift that goes with it, or its shift along x and y \[m\] where
/// it isn't turned, and what the log gains by poses in the map's frame. Turn and shift are those of the errors that were fitted to the
/// reference; `None` where it has none, or where most of them are others.
///
/// # Errors
/// As [`Comparison::in_world`].
pub(crate) fn misaligned_frame(
    comparison: &Comparison<'_>,
    effects: &Effects,
    fitted: &Fitted,
) -> Result<Option<Misalignment>, GapError> {
    let nuisances = &fitted.nuisances;
    let frame_of = |recorded: &Recorded, fitted: &Fitted| {
        let frame = nuisances.pose_error.turned_frame(&recorded.track, &fitted.corrections);
        (frame.share > LEAST_SHARE).then_some(frame)
    };
    let Some(mut frame) = frame_of(&comparison.recorded, fitted) else { return Ok(None) };
    let (mut recorded, mut turn, mut moved) = (comparison.recorded.clone().into_owned(), 0.0, DVec2::ZERO);
    let mut with: Vec<f64> = Vec::new();
    // Errors are found smaller than they are, as most errors of a reference come and go.
    for _ in 0..STEPS {
        recorded = recorded.with_reference(|pose| frame.put_right(pose));
        recorded = recorded.corrected(vec![DVec3::ZERO; recorded.scans()]);
        let aligned = Comparison::new(comparison.nominal, &recorded)?.in_world(effects)?;
        let fitted = aligned.fit_nuisances_with(effects, nuisances, REFIT);
        if !with.is_empty() && fitted.total() < with.iter().sum() {
            break;
        }
        (turn, moved) = (turn + frame.turn, moved + frame.shift);
        let left = frame_of(&recorded, &fitted);
        with = fitted.scans;
        match left {
            Some(left) => frame = left,
            None => break,
        }
    }
    let without = comparison.evaluate_views(&comparison.views, effects, fitted, 0).scans;
    let folds = comparison.recorded.folds;
    let gains = differences(&folds.sums(&with), &folds.sums(&without));
    let found = |deviation, estimates| {
        Some(Misalignment { deviation, covariate: Covariate::Place, estimates, gains })
    };
    Ok(if turn.abs() >= LEAST_TURN {
        found(Deviation::FrameTurn, vec![[-turn, frame.information.sqrt().recip()]])
    } else if moved.length() >= LEAST_SHIFT_M {
        found(Deviation::FrameShift, [-moved.x, -moved.y].map(|by| [by, frame.shift_error_m]).to_vec())
    } else {
        None
    })
}

#[cfg(test)]
mod tests {
    use locsim_comparison::Nuisances;
    use locsim_comparison::fixtures::{DRIVE, NOMINAL};
    use locsim_core::Pose2;

    use super::*;
    use crate::Recorded;

    /// A reference that is turned by 7 mrad about the map's origin, and one that is shifted by 40 mm.
    #[test]
    fn a_turned_frame_is_found_and_a_shifted_one() {
        let frames = [Pose2::IDENTITY, Pose2::new(0.0, 0.0, 0.007), Pose2::new(0.034, -0.021, 0.0)];
        let [none, turned, shifted] = frames.map(|frame| {
            let recorded = Recorded::new(&DRIVE, 400, 24, |_| true).unwrap();
            let recorded = recorded.with_reference(|pose| frame.compose(pose));
            let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
            let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
            misaligned_frame(&comparison, &NOMINAL.effects, &fitted).unwrap()
        });
        assert!(none.is_none_or(|none| none.gain() < 5.0));
        for (found, deviation, truth) in [
            (turned, Deviation::FrameTurn, vec![0.007]),
            (shifted, Deviation::FrameShift, vec![0.034, -0.021]),
        ] {
            let found = found.unwrap();
            let is_right =
                |(estimate, truth): (&[f64; 2], &f64)| (estimate[0] - truth).abs() < 0.15 * truth.abs();
            assert!(found.estimates.iter().zip(&truth).all(is_right), "{found:?}");
            assert!(
                (found.deviation, found.estimates.len()) == (deviation, truth.len()) && found.gain() > 50.0
            );
        }
    }
}
