//! The body that a reference is of, where that isn't the robot's base.

use glam::DVec2;
use locsim_core::{Pose2, wrap_angle};

use super::windows::Window;

/// A body is told where it makes the differences of odometry and reference so many times smaller \[their squares\].
const LEAST_GAIN: f64 = 9.0;
/// Nearer to the base \[m\] and \[rad\] it is the base: a reference is no better.
const LEAST: (f64, f64) = (0.04, 0.015);
/// Fewer windows tell none.
const LEAST_WINDOWS: usize = 10;
/// Windows turn by this much in all, at least \[rad^2\]: a robot that drives straight on doesn't show where a body sits.
const LEAST_TURNS: f64 = 5.0;
/// Heading and place of a body are fitted in turn so many times. Both change by less than 1 % of their error in the last.
const ROUNDS: usize = 50;

/// The pose `base_from_body` that explains most of what odometry and reference differ by; `None` where none does.
///
/// If the base moves by `M`, a body at `X` moves by `X^-1 M X` (hand-eye calibration in the plane): its displacement, turned as the body is,
/// is that of the base, and the sweep of its lever arm beside. Distances of the odometry may be off by a factor.
pub(super) fn base_from_body(windows: &[Window]) -> Option<Pose2> {
    let turns: f64 = windows.iter().map(|w| 2.0 - 2.0 * w.reference.theta.cos()).sum();
    if windows.len() < LEAST_WINDOWS || turns < LEAST_TURNS {
        return None;
    }
    // Displacements of the base and of the body. What wheels turn too far they have turned on the way: half of it shows in the direction.
    let pairs: Vec<(&Window, DVec2, DVec2)> = windows
        .iter()
        .map(|w| {
            let turned = 0.5 * wrap_angle(w.odometry.theta - w.reference.theta);
            let base = DVec2::from_angle(-turned).rotate(w.odometry.position());
            (w, base, w.reference.position())
        })
        .collect();
    let swept = |turn: f64, place: DVec2| DVec2::from_angle(turn).rotate(place) - place;
    // The heading, as a vector whose length is the factor of distances.
    let mut heading = DVec2::X;
    let mut place = DVec2::ZERO;
    let squares = |heading: DVec2, place: DVec2| -> f64 {
        pairs
            .iter()
            .map(|(w, base, body)| {
                (heading.rotate(*body) - *base - swept(w.reference.theta, place)).length_squared()
            })
            .sum()
    };
    let length: f64 = pairs.iter().map(|(.., body)| body.length_squared()).sum();
    let along: f64 = pairs.iter().map(|(_, base, body)| base.dot(*body)).sum();
    let before = squares(DVec2::new(along / length.max(1e-12), 0.0), DVec2::ZERO);
    for _ in 0..ROUNDS {
        let sum: DVec2 = pairs
            .iter()
            .map(|(w, base, body)| {
                let base = *base + swept(w.reference.theta, place);
                DVec2::new(body.dot(base), body.perp_dot(base))
            })
            .sum();
        heading = sum / length.max(1e-12);
        let sum: DVec2 = pairs
            .iter()
            .map(|(w, base, body)| swept(-w.reference.theta, heading.rotate(*body) - *base))
            .sum();
        place = sum / turns;
    }
    let body = Pose2::new(place.x, place.y, heading.to_angle());
    let is_elsewhere = place.length() > LEAST.0 || body.theta.abs() > LEAST.1;
    (is_elsewhere && LEAST_GAIN * squares(heading, place) < before).then_some(body)
}
