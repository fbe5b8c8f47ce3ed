//! The particle filter against a histogram filter (Probabilistic Robotics, table 8.1) of the same model.

use std::sync::Arc;

use locsim_core::{Hits, Laser, Particles, Pose2, RangeMap, Scan, SensorModel, wrap_angle};
use locsim_mcl::{
    Filter, FilterOptions, Multinomial, OdometryMotion, ResampleTrigger, Resampler, Residual, Spread, Start,
    StepInput, Stratified, Systematic,
};
use statrs::distribution::{ContinuousCDF, StudentsT};

use crate::toy::{Gaussian, Room};
use crate::{laser, options, scan};

const ROOM: Room = Room { width: 4.0, depth: 3.0 };
const MODEL: Gaussian = Gaussian { sigma_m: 0.3 };
const START: Pose2 = Pose2 { x: 1.2, y: 1.1, theta: 0.2 };
const SIGMA: f64 = 0.15;
const ALPHA: [f64; 4] = [0.05, 0.03, 0.06, 0.02];
const INCREMENTS: [Pose2; 4] = [
    Pose2 { x: 0.0, y: 0.0, theta: 0.0 },
    Pose2 { x: 0.25, y: 0.05, theta: 0.3 },
    Pose2 { x: 0.25, y: 0.06, theta: -0.1 },
    Pose2 { x: 0.3, y: -0.02, theta: 0.2 },
];

/// Cells of 4 cm and 0.04 rad, which is 2 to 4 to a standard deviation of the posterior.
const CELL: f64 = 0.04;
const ORIGIN: [f64; 3] = [-0.2, -0.2, -1.4];
const SIZE: [usize; 3] = [90, 80, 85];

/// The posterior as a mass per cell of a grid over x, y and heading.
struct Histogram {
    mass: Vec<f64>,
}

impl Histogram {
    fn start() -> Self {
        let square = |d: f64| (d / SIGMA).powi(2);
        let mass = (0..SIZE.iter().product()).map(|cell| {
            let pose = centre(cell);
            let distance =
                square(pose.x - START.x) + square(pose.y - START.y) + square(pose.theta - START.theta);
            (-0.5 * distance).exp()
        });
        let mut histogram = Self { mass: mass.collect() };
        histogram.normalize();
        histogram
    }

    fn normalize(&mut self) -> f64 {
        let sum: f64 = self.mass.iter().sum();
        self.mass.iter_mut().for_each(|m| *m /= sum);
        sum
    }

    /// Moves the mass of each cell through the model of table 5.6. Each of the three normal noises is replaced by
    /// its five-point Gauss-Hermite quadrature, which has the same first nine moments, and mass between cell
    /// centres goes to the 27 cells around it with the weights of quadratic interpolation, which keep its mean
    /// and variance: neither discretization spreads the posterior.
    fn predict(&mut self, increment: &Pose2) {
        let trans = increment.x.hypot(increment.y);
        if trans == 0.0 {
            return;
        }
        let rot1 = increment.y.atan2(increment.x);
        let rot2 = increment.theta - rot1;
        let [a1, a2, a3, a4] = ALPHA;
        let sigma = [
            (a1 * rot1.powi(2) + a2 * trans.powi(2)).sqrt(),
            (a3 * trans.powi(2) + a4 * (rot1.powi(2) + rot2.powi(2))).sqrt(),
            (a1 * rot2.powi(2) + a2 * trans.powi(2)).sqrt(),
        ];
        let root = 10.0_f64.sqrt();
        let [near, far] = [(5.0 - root).sqrt(), (5.0 + root).sqrt()];
        let [near_weight, far_weight] = [(7.0 + 2.0 * root) / 60.0, (7.0 - 2.0 * root) / 60.0];
        let nodes = [
            (-far, far_weight),
            (-near, near_weight),
            (0.0, 8.0 / 15.0),
            (near, near_weight),
            (far, far_weight),
        ];
        let mut moved = vec![0.0; self.mass.len()];
        for (cell, &mass) in self.mass.iter().enumerate().filter(|(_, m)| m.abs() > 1e-11) {
            let from = centre(cell);
            for (n1, w1) in nodes {
                for (n2, w2) in nodes {
                    let direction = from.theta + rot1 + sigma[0] * n1;
                    let trans = trans + sigma[1] * n2;
                    for (n3, w3) in nodes {
                        let to = [
                            from.x + trans * direction.cos(),
                            from.y + trans * direction.sin(),
                            direction + rot2 + sigma[2] * n3,
                        ];
                        splat(&mut moved, to, mass * w1 * w2 * w3);
                    }
                }
            }
        }
        self.mass = moved;
    }

    /// Multiplies by the scan's likelihood, normalizes, and returns the log evidence.
    fn correct(&mut self, laser: &Laser, scan: &Scan) -> f64 {
        let centres: Particles = (0..self.mass.len()).map(centre).collect();
        let mut hits = Hits::default();
        ROOM.cast(centres.as_poses(), laser.bearings(), laser.max_range(), &mut hits);
        let beams = hits.beams(centres.as_poses(), laser.bearings(), laser.max_range());
        let mut log_likelihood = vec![0.0; self.mass.len()];
        MODEL.log_likelihood(&scan.ranges, &beams, &mut Vec::new(), &mut log_likelihood);
        for (mass, l) in self.mass.iter_mut().zip(log_likelihood) {
            *mass *= l.exp();
        }
        self.normalize().ln()
    }

    /// Means of x, y and heading, their six covariances, and after these the given log evidence.
    fn summary(&self, log_evidence: f64) -> Vec<f64> {
        let mut mean = [0.0; 3];
        for (cell, m) in self.mass.iter().enumerate() {
            let pose = centre(cell);
            for (mean, v) in mean.iter_mut().zip([pose.x, pose.y, pose.theta]) {
                *mean += m * v;
            }
        }
        let mut covariance = [[0.0; 3]; 3];
        for (cell, m) in self.mass.iter().enumerate() {
            let pose = centre(cell);
            let d = [pose.x - mean[0], pose.y - mean[1], pose.theta - mean[2]];
            for i in 0..3 {
                for j in 0..3 {
                    covariance[i][j] += m * d[i] * d[j];
                }
            }
        }
        summary(mean, covariance, log_evidence)
    }
}

fn centre(cell: usize) -> Pose2 {
    let [_, ny, nt] = SIZE;
    let at = |axis: usize, index: usize| ORIGIN[axis] + (index as f64 + 0.5) * CELL;
    Pose2 { x: at(0, cell / (ny * nt)), y: at(1, cell / nt % ny), theta: at(2, cell % nt) }
}

fn splat(mass: &mut [f64], to: [f64; 3], amount: f64) {
    let mut first = [0; 3];
    let mut weights = [[0.0; 3]; 3];
    for axis in 0..3 {
        let position = (to[axis] - ORIGIN[axis]) / CELL - 0.5;
        let nearest = position.round();
        assert!(nearest >= 1.0 && (nearest as usize) < SIZE[axis] - 1, "the grid is too small");
        let f = position - nearest;
        first[axis] = nearest as usize - 1;
        weights[axis] = [f * (f - 1.0) / 2.0, 1.0 - f * f, f * (f + 1.0) / 2.0];
    }
    for (i, wx) in weights[0].iter().enumerate() {
        for (j, wy) in weights[1].iter().enumerate() {
            let row = ((first[0] + i) * SIZE[1] + first[1] + j) * SIZE[2] + first[2];
            for (m, wt) in mass[row..row + 3].iter_mut().zip(weights[2]) {
                *m += amount * wx * wy * wt;
            }
        }
    }
}

fn summary(mean: [f64; 3], c: [[f64; 3]; 3], log_evidence: f64) -> Vec<f64> {
    let mut all = mean.to_vec();
    all.extend([c[0][0], c[1][1], c[2][2], c[0][1], c[0][2], c[1][2], log_evidence]);
    all
}

/// Inputs of the filters and their exact results: one summary per step.
struct Reference {
    laser: Laser,
    scans: Vec<Scan>,
    exact: Vec<Vec<f64>>,
}

impl Reference {
    fn new() -> Self {
        let laser = laser(6);
        let path = INCREMENTS.iter().scan(START, |pose, increment| {
            *pose = pose.compose(increment);
            Some(*pose)
        });
        let scans: Vec<_> =
            path.enumerate().map(|(step, pose)| scan(&ROOM, &laser, &MODEL, pose, step as u32)).collect();
        let mut histogram = Histogram::start();
        let exact = INCREMENTS.iter().zip(&scans).map(|(increment, scan)| {
            histogram.predict(increment);
            let log_evidence = histogram.correct(&laser, scan);
            histogram.summary(log_evidence)
        });
        let exact = exact.collect();
        Self { laser, scans, exact }
    }
}

fn sampled(options: &FilterOptions, reference: &Reference, seed: u64) -> Vec<Vec<f64>> {
    let start = Start::Tracking { pose: START, spread: Spread { sigma_m: SIGMA, sigma_rad: SIGMA } };
    let mut filter = Filter::new(options.clone(), &start, &ROOM, seed).unwrap();
    INCREMENTS
        .iter()
        .zip(&reference.scans)
        .map(|(&odometry, scan)| {
            let input = StepInput { odometry, laser: &reference.laser, scan };
            let outcome = filter.step(&input, &ROOM, &MODEL).unwrap();
            let estimate = outcome.estimates.weighted_mean;
            let Pose2 { x, y, theta } = estimate.pose;
            summary([x, y, wrap_angle(theta)], estimate.covariance, outcome.log_evidence)
        })
        .collect()
}

/// The greatest |mean over runs - exact| over its bound, over all steps and quantities.
///
/// The runs are independent, so the mean's error over its estimated standard error has Student's distribution
/// with RUNS - 1 degrees of freedom, but for the O(1 / n) bias of a filter and the histogram's discretization.
/// For these two the bound has, beside the quantile for a false-alarm probability of 1e-6, an allowance of 0.2 %
/// of a standard deviation for means and of 0.5 % of the standard deviations' product for covariances, and
/// 0.002 for the log evidence.
fn worst(options: &FilterOptions, reference: &Reference) -> f64 {
    const RUNS: u64 = 16;
    let quantile = StudentsT::new(0.0, 1.0, (RUNS - 1) as f64).unwrap().inverse_cdf(1.0 - 0.5e-6);
    let runs: Vec<_> = (0..RUNS).map(|seed| sampled(options, reference, seed)).collect();
    let mut worst = 0.0_f64;
    for (step, exact) in reference.exact.iter().enumerate() {
        let deviation = |axis: usize| exact[3 + axis].sqrt();
        let covariance = |a: usize, b: usize| 0.005 * deviation(a) * deviation(b);
        let allowance = [
            0.002 * deviation(0),
            0.002 * deviation(1),
            0.002 * deviation(2),
            covariance(0, 0),
            covariance(1, 1),
            covariance(2, 2),
            covariance(0, 1),
            covariance(0, 2),
            covariance(1, 2),
            0.002,
        ];
        for (i, exact) in exact.iter().enumerate() {
            let n = RUNS as f64;
            let mean = runs.iter().map(|run| run[step][i]).sum::<f64>() / n;
            let variance = runs.iter().map(|run| (run[step][i] - mean).powi(2)).sum::<f64>() / (n - 1.0);
            let bound = quantile * (variance / n).sqrt() + allowance[i];
            worst = worst.max((mean - exact).abs() / bound);
        }
    }
    worst
}

fn with(alpha: [f64; 4], resampler: Arc<dyn Resampler>, trigger: ResampleTrigger) -> FilterOptions {
    let motion = Arc::new(OdometryMotion::new(alpha).unwrap());
    FilterOptions { motion, resampler, trigger, ..options(20_000) }
}

#[test]
fn the_filter_agrees_with_the_exact_one() {
    let each = ResampleTrigger::EachStep;
    let below_half = ResampleTrigger::EffectiveShareBelow(0.5);
    let cases: [(Arc<dyn Resampler>, _); 4] = [
        (Arc::new(Systematic), each),
        (Arc::new(Multinomial), each),
        (Arc::new(Stratified), below_half),
        (Arc::new(Residual), below_half),
    ];
    let reference = Reference::new();
    for (resampler, trigger) in cases {
        let options = with(ALPHA, resampler, trigger);
        let worst = worst(&options, &reference);
        assert!(worst < 1.0, "{:?}, {trigger:?}: {worst} times the bound", options.resampler);
    }
}

/// Negative control: a motion model that is a third noisier in translation, by variance, is found out.
#[test]
fn the_comparison_finds_a_wrong_motion_model() {
    let mut alpha = ALPHA;
    alpha[2] *= 4.0 / 3.0;
    let options = with(alpha, Arc::new(Systematic), ResampleTrigger::EachStep);
    let worst = worst(&options, &Reference::new());
    assert!(worst > 1.0, "{worst} times the bound");
}
