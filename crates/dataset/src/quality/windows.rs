//! Parts of a drive, over which odometry and reference are compared.

use std::ops::Range;

use locsim_core::{Drive, Pose2, wrap_angle};

/// Odometry and reference are compared over windows of this length \[m\] or turn \[rad\]: in shorter ones the reference's own
/// error of some centimetres hides the odometry's.
const WINDOW: (f64, f64) = (1.0, 1.5);
/// A part of the drive, as odometry and reference have it.
#[derive(Default)]
pub struct Window {
    /// Sums over the steps by odometry: distance \[m\] and turn \[rad\], and their squares.
    pub distance: f64,
    pub turn: f64,
    pub distance_squares: f64,
    pub turn_squares: f64,
    /// The steps whose increments are its motion.
    pub steps: Range<usize>,
    /// From its first step to its last.
    pub odometry: Pose2,
    pub reference: Pose2,
}

/// The windows of the steps whose scans have reference poses.
pub fn windows(drive: &Drive) -> Vec<Window> {
    let mut windows = Vec::new();
    let mut first = 0;
    let mut open = Window::default();
    for (i, pair) in drive.steps.windows(2).enumerate() {
        let (Some(from), Some(to)) = (drive.steps[first].reference, pair[1].reference) else {
            (first, open) = (i + 1, Window::default());
            continue;
        };
        let step = pair[1].odometry.relative_to(&pair[0].odometry);
        let (distance, turn) = (step.position().length(), wrap_angle(step.theta).abs());
        open.distance += distance;
        open.turn += turn;
        open.distance_squares += distance * distance;
        open.turn_squares += turn * turn;
        if open.distance >= WINDOW.0 || open.turn >= WINDOW.1 {
            open.steps = first + 1..i + 2;
            open.odometry = pair[1].odometry.relative_to(&drive.steps[first].odometry);
            open.reference = to.relative_to(&from);
            windows.push(std::mem::take(&mut open));
            first = i + 1;
        }
    }
    windows
}
