//! The systematic part of an odometry's error: wheels of another size, a wider track, a base that isn't where the robot turns about.

use std::fmt;

use glam::{DMat2, DVec3};
use locsim_core::{Drive, Pose2, median, wrap_angle};
use nalgebra::{SMatrix, SVector};
use serde::Serialize;

use super::windows::windows;

/// Fewer windows say nothing.
const LEAST_WINDOWS: usize = 30;
/// The windows are cut into so many stretches, each of which is predicted from the others.
const FOLDS: usize = 5;
/// An error beyond this many times the usual one counts as this: the reference has jumped.
const CUT: f64 = 4.0;
/// Standard deviation of the coefficients that is expected: wheels differ by some per cent.
const EXPECTED: f64 = 0.1;
/// That of a coefficient that is held.
const HELD: f64 = 1e-6;
/// Errors of windows that weren't fitted to have to shrink by this many standard errors.
const LEAST_SIGMA: f64 = 3.0;
/// Gauss-Newton steps. The error is nearly linear in the coefficients.
const ROUNDS: usize = 3;
/// Errors beyond this many standard deviations weigh less (Huber; 95 % efficient for normal ones).
const HUBER: f64 = 1.345;
/// The standard deviation of normal errors, as a multiple of the median of their sizes.
const OF_MEDIAN: f64 = 1.4826;

/// Coefficients that are fitted together, row by row of a matrix: the length of the way; the three of two wheels and their track; those of
/// a base that is elsewhere on the robot; all.
const FORMS: [&[usize]; 4] = [&[0], &[0, 6, 8], &[0, 2, 3, 5, 6, 8], &[0, 1, 2, 3, 4, 5, 6, 7, 8]];

type Coefficients = SVector<f64, 9>;

/// The systematic error of an odometry: the true increment (forward, left, turn) is linear in the odometry's.
///
/// Wheels of unequal size, or a track of another width, make errors that go with the way and the turn (Borenstein and Feng,
/// "Measurement and Correction of Systematic Odometry Errors in Mobile Robots", 1996).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct OdometryCalibration {
    /// Rows: forward \[m\], left \[m\], turn \[rad\] of the true increment; columns: those of the odometry's.
    pub matrix: [[f64; 3]; 3],
    /// Number of windows of about a metre that it was fitted to.
    pub windows: usize,
    /// Root mean square errors (forward, left, turn) of windows that weren't fitted to \[m, m, rad\]: as they are, and calibrated.
    pub errors: [[f64; 3]; 2],
}

impl OdometryCalibration {
    /// Fitted to the steps whose scans have reference poses; `None` with too few of them, and where windows that aren't fitted to
    /// gain nothing by it.
    pub fn of(drive: &Drive) -> Option<Self> {
        let windows = windows(drive).into_iter().map(|window| Motion {
            steps: window.steps.map(|i| drive.odometry_increment(i)).collect(),
            reference: window.reference,
        });
        let windows: Vec<Motion> = windows.collect();
        if windows.len() < LEAST_WINDOWS {
            return None;
        }
        let before: Vec<DVec3> = windows.iter().map(|window| window.error(&Coefficients::zeros())).collect();
        let all: Vec<&Motion> = windows.iter().collect();
        // What isn't systematic is the unit: by that of the errors as they are, a large one would hide itself.
        let rest = fit(&all, FORMS[FORMS.len() - 1]);
        let usual = usual(&windows.iter().map(|window| window.error(&rest)).collect::<Vec<_>>());
        let size = |error: DVec3| (error / usual).abs().min(DVec3::splat(CUT)).length_squared();
        let mut best: Option<(f64, &[usize], Vec<DVec3>)> = None;
        for free in FORMS {
            let after = predicted(&windows, free);
            let gains: Vec<f64> = before.iter().zip(&after).map(|(&a, &b)| size(a) - size(b)).collect();
            let (mean, standard_error) = mean_and_error(&gains);
            let is_better = best.as_ref().is_none_or(|(most, ..)| mean > *most);
            if mean > LEAST_SIGMA * standard_error && is_better {
                best = Some((mean, free, after));
            }
        }
        let (_, free, after) = best?;
        let matrix = matrix(&fit(&all, free));
        let errors = [before, after].map(|errors| {
            let mean = errors.iter().map(|&error| error * error).sum::<DVec3>() / errors.len() as f64;
            mean.map(f64::sqrt).to_array()
        });
        Some(Self { matrix, windows: windows.len(), errors })
    }

    /// Replaces the odometry of a drive, from its first pose on.
    pub fn apply(&self, drive: &mut Drive) {
        let increments: Vec<Pose2> = (0..drive.steps.len())
            .map(|i| true_increment(&self.matrix, drive.odometry_increment(i)))
            .collect();
        let Some(mut pose) = drive.steps.first().map(|step| step.odometry) else { return };
        for (step, increment) in drive.steps.iter_mut().zip(increments) {
            pose = pose.compose(&increment);
            step.odometry = pose;
        }
    }
}

/// `a metre of it is 0.957 m forward, +0.026 m to the left and +3.58 deg, 90 deg of it are 87.20 deg. ...`.
impl fmt::Display for OdometryCalibration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [forward, left, turn] = self.matrix;
        let [before, after] = self.errors.map(|[x, y, theta]| {
            format!("{:.1} cm forward, {:.1} cm left, {:.2} deg", 100.0 * x, 100.0 * y, theta.to_degrees())
        });
        write!(
            f,
            "a metre of it is {:.3} m forward, {:+.3} m to the left and {:+.2} deg, 90 deg of it are {:.2} deg. Root mean square error over \
             a metre that isn't fitted to: {before} as it is; {after} calibrated ({} windows)",
            forward[0],
            left[0],
            turn[0].to_degrees(),
            90.0 * turn[2],
            self.windows,
        )
    }
}

/// A window: the increments of its steps by odometry, and its motion by the reference.
struct Motion {
    steps: Vec<Pose2>,
    reference: Pose2,
}

impl Motion {
    /// The reference's motion less the odometry's (forward, left, turn), in the frame of the window's begin.
    fn error(&self, fitted: &Coefficients) -> DVec3 {
        let matrix = matrix(fitted);
        let (mut pose, mut turn) = (Pose2::IDENTITY, 0.0);
        for &step in &self.steps {
            let step = true_increment(&matrix, step);
            pose = pose.compose(&step);
            turn += step.theta;
        }
        let position = self.reference.position() - pose.position();
        position.extend(wrap_angle(self.reference.theta - turn))
    }

    /// The derivatives of the odometry's motion (forward, left, turn) by the coefficients.
    fn derivatives(&self, fitted: &Coefficients) -> [Coefficients; 3] {
        let matrix = matrix(fitted);
        let mut pose = Pose2::IDENTITY;
        let path: Vec<(f64, _)> = self
            .steps
            .iter()
            .map(|&step| {
                let heading = pose.theta;
                pose = pose.compose(&true_increment(&matrix, step));
                (heading, pose.position())
            })
            .collect();
        let mut rows = [Coefficients::zeros(); 3];
        for (step, (heading, position)) in self.steps.iter().zip(path) {
            let axes = DMat2::from_angle(heading);
            // A turn swings what comes after it.
            let swing = (pose.position() - position).perp();
            for (column, length) in [step.x, step.y, wrap_angle(step.theta)].into_iter().enumerate() {
                for (row, moved) in [axes.x_axis, axes.y_axis, swing].into_iter().enumerate() {
                    rows[0][3 * row + column] += moved.x * length;
                    rows[1][3 * row + column] += moved.y * length;
                }
                rows[2][6 + column] += length;
            }
        }
        rows
    }
}

/// The matrix of coefficients, which are 0 for an odometry that is right.
fn matrix(fitted: &Coefficients) -> [[f64; 3]; 3] {
    std::array::from_fn(|row| {
        std::array::from_fn(|column| f64::from(row == column) + fitted[3 * row + column])
    })
}

/// The true increment of one by odometry.
fn true_increment(matrix: &[[f64; 3]; 3], step: Pose2) -> Pose2 {
    let [x, y, theta] = matrix.map(|row| row[0] * step.x + row[1] * step.y + row[2] * wrap_angle(step.theta));
    Pose2::new(x, y, theta)
}

/// The errors of all windows, each predicted from the stretches that it isn't in.
fn predicted(windows: &[Motion], free: &[usize]) -> Vec<DVec3> {
    (0..FOLDS)
        .flat_map(|fold| {
            let [begin, end] = [fold, fold + 1].map(|fold| fold * windows.len() / FOLDS);
            let others: Vec<&Motion> = windows[..begin].iter().chain(&windows[end..]).collect();
            let fitted = fit(&others, free);
            windows[begin..end].iter().map(move |window| window.error(&fitted))
        })
        .collect()
}

/// The `free` coefficients under which the reference is likeliest, by Gauss-Newton steps with reweighted least squares.
fn fit(windows: &[&Motion], free: &[usize]) -> Coefficients {
    let prior = SMatrix::from_diagonal(&Coefficients::from_fn(|i, _| {
        if free.contains(&i) { EXPECTED.powi(-2) } else { HELD.powi(-2) }
    }));
    let mut fitted = Coefficients::zeros();
    for _ in 0..ROUNDS {
        let errors: Vec<DVec3> = windows.iter().map(|window| window.error(&fitted)).collect();
        let usual = usual(&errors);
        let mut information = prior;
        let mut right = -prior * fitted;
        for (window, error) in windows.iter().zip(errors) {
            for (axis, row) in window.derivatives(&fitted).iter().enumerate() {
                let weight = (HUBER * usual[axis] / error[axis].abs()).min(1.0) / usual[axis].powi(2);
                information += weight * row * row.transpose();
                right += weight * error[axis] * row;
            }
        }
        let Some(factors) = information.cholesky() else { break };
        fitted += factors.solve(&right);
    }
    fitted
}

/// The standard deviation of each component, from the median of the sizes.
fn usual(errors: &[DVec3]) -> DVec3 {
    let of = |axis: usize| {
        let mut sizes: Vec<f64> = errors.iter().map(|error| error[axis].abs()).collect();
        (OF_MEDIAN * median(&mut sizes)).max(1e-6)
    };
    DVec3::new(of(0), of(1), of(2))
}

fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
    (mean, (variance / count).sqrt())
}

#[cfg(test)]
mod tests {
    use locsim_core::{Draw, DriveStep, Laser, Scan, Stage};
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    /// Errors of the odometry, in the same form as [`OdometryCalibration::matrix`].
    const WORN: [[f64; 3]; 3] = [[0.96, 0.0, 0.0], [0.03, 1.0, 0.06], [0.05, 0.0, 0.97]];
    const RIGHT: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

    /// A drive of 0.2 m and 0.1 rad a step, in curves; reference poses err by 1 cm and half a degree, and jump once.
    fn drive(matrix: [[f64; 3]; 3], steps: u32, seed: u64) -> Drive {
        let draw = Draw::new(seed, Stage::Motion, 1);
        let (mut truth, mut odometry) = (Pose2::IDENTITY, Pose2::IDENTITY);
        let steps = (0..steps).map(|i| {
            let mut rng = draw.item(i);
            let mut normal = |sigma: f64| {
                let unit: f64 = StandardNormal.sample(&mut rng);
                sigma * unit
            };
            let turn = [0.1, 0.0, -0.1, 0.05][i as usize / 10 % 4];
            let step = [0.2, 0.0, turn];
            let [x, y, theta] = matrix.map(|row| (0..3).map(|i| row[i] * step[i]).sum::<f64>());
            truth = truth.compose(&Pose2::new(x + normal(2e-3), y + normal(2e-3), theta + normal(5e-3)));
            odometry = odometry.compose(&Pose2::new(step[0], step[1], step[2]));
            let jump = if i == 200 { 3.0 } else { 0.0 };
            let reference = Pose2::new(
                truth.x + normal(0.01) + jump,
                truth.y + normal(0.01),
                truth.theta + normal(0.009),
            );
            DriveStep {
                stamp_secs: f64::from(i),
                odometry,
                reference: Some(reference),
                scan: Scan { ranges: vec![1.0] },
            }
        });
        let steps = steps.collect();
        Drive { steps, laser: Laser::new(vec![0.0], vec![0.0], 0.0, 10.0, Pose2::IDENTITY).unwrap() }
    }

    /// 400 windows of 1 m and about 0.3 rad: with errors of 2 cm and 1.5 degrees a coefficient of the way is known to 0.001 m and 0.0013 rad, one of
    /// turns to a third of that per radian. Bounds are five of these.
    #[test]
    fn worn_wheels_are_found_and_taken_out() {
        let mut worn = drive(WORN, 2000, 1);
        let found = OdometryCalibration::of(&worn).unwrap();
        for (row, [found, hidden]) in found.matrix.iter().zip(&WORN).map(|(a, b)| [a, b]).enumerate() {
            for column in [0, 2] {
                let [found, hidden] = [found[column], hidden[column]];
                assert!((found - hidden).abs() < 0.015, "row {row}, column {column}: {found} for {hidden}");
            }
        }
        let [before, after] = found.errors;
        assert!(after[2] < 0.6 * before[2], "{found}");
        found.apply(&mut worn);
        assert_eq!(OdometryCalibration::of(&worn), None, "nothing is left");
        assert_eq!(worn.steps[0].odometry, drive(WORN, 1, 1).steps[0].odometry);
    }

    /// Without a systematic error, none is found on 200 drives. Each of four forms passes three standard errors once in 740 if its gain were 0 in the
    /// mean, and fits lose in the mean on windows that they don't know: at most 1.1 of 200 are expected, and 7 have a probability below 1e-4.
    #[test]
    fn an_odometry_that_is_right_is_left_alone() {
        let found = (0..200)
            .filter(|&seed| OdometryCalibration::of(&drive(RIGHT, 300, 100 + seed)).is_some())
            .count();
        assert!(found < 7, "{found} of 200");
        assert_eq!(OdometryCalibration::of(&drive(WORN, 100, 1)), None, "too few windows");
    }

    /// Three degrees in each metre are found on 40 m. A window's heading errs by 1 degree, the mean of 38 by 0.16; the bound is five of these.
    #[test]
    fn a_short_drive_tells_an_imbalance() {
        let imbalance = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [3_f64.to_radians(), 0.0, 1.0]];
        for seed in 0..20 {
            let found = OdometryCalibration::of(&drive(imbalance, 190, 10 + seed)).unwrap();
            let turn_deg = found.matrix[2][0].to_degrees();
            assert!((turn_deg - 3.0).abs() < 0.8, "{found}");
        }
    }

    #[test]
    fn a_drive_without_references_has_no_calibration() {
        let mut blind = drive(WORN, 400, 1);
        for step in &mut blind.steps {
            step.reference = None;
        }
        assert_eq!(OdometryCalibration::of(&blind), None);
    }
}
