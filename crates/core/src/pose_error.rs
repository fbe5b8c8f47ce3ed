//! Errors of the reference poses: a correction for each scan, smooth in time.
//!
//! Beams of one scan share the error of its pose, and neighbouring scans share some of it. The error of x, y (one
//! standard deviation for both) and of the heading is a first-order autoregressive process and white noise, in the map frame: a localizer's
//! estimate drifts, and wheels or a camera add something to each pose.

use glam::{DMat3, DVec2, DVec3};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::{Pose2, Track};

/// A first-order autoregressive process with white noise for the error of a pose.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct PoseError {
    /// Standard deviation of x and of y \[m\].
    pub sigma_m: f64,
    /// Standard deviation of the heading \[rad\].
    pub sigma_rad: f64,
    /// Time in which the correlation falls to 1/e \[s\].
    pub correlation_secs: f64,
    /// Standard deviation of the white noise of x and of y \[m\].
    pub white_m: f64,
    /// Standard deviation of the white noise of the heading \[rad\].
    pub white_rad: f64,
}

impl PoseError {
    /// Exact reference poses.
    pub const NONE: Self =
        Self { sigma_m: 0.0, sigma_rad: 0.0, correlation_secs: 1.0, white_m: 0.0, white_rad: 0.0 };

    /// No error to speak of.
    pub fn is_none(&self) -> bool {
        self.sigma_m <= 0.0 && self.sigma_rad <= 0.0
    }

    /// Covariance of the process: x, y, heading.
    pub fn covariance(&self) -> DMat3 {
        let (xy, heading) = (self.sigma_m.max(1e-6).powi(2), self.sigma_rad.max(1e-7).powi(2));
        DMat3::from_diagonal(DVec3::new(xy, xy, heading))
    }

    /// Correlation of two errors so far apart \[s\], below 1.
    pub fn correlation(&self, secs: f64) -> f64 {
        (-secs.max(0.0) / self.correlation_secs).exp().min(0.9999)
    }

    /// The log density of errors of poses at these times \[s\], scan by scan, with the volume of what they may be by what the scans say (Laplace's
    /// method), so that processes can be compared (nats).
    pub fn log_prior(&self, secs: &[f64], errors: &[DVec3], scans: &[PoseInformation]) -> Vec<f64> {
        if self.is_none() {
            return vec![0.0; scans.len()];
        }
        let mut log_prior = smooth_pose_errors(self, secs, scans).log_volume;
        let inverse = self.covariance().inverse();
        let white = self.white_information();
        // What is likeliest to be of the process.
        let errors = white.map_or_else(
            || errors.to_vec(),
            |matrix| {
                let known = |e: &DVec3| PoseInformation { matrix, vector: matrix * *e };
                let slow = smooth_process(self, secs, &errors.iter().map(known).collect::<Vec<_>>()).mean;
                for ((log_prior, e), slow) in log_prior.iter_mut().zip(errors).zip(&slow) {
                    *log_prior -= 0.5 * (*e - *slow).dot(matrix * (*e - *slow));
                }
                slow
            },
        );
        for i in 0..log_prior.len() {
            let (innovation, share) = if i == 0 {
                (errors[0], 1.0)
            } else {
                let phi = self.correlation(secs[i] - secs[i - 1]);
                (errors[i] - phi * errors[i - 1], 1.0 - phi * phi)
            };
            log_prior[i] -= 0.5 * innovation.dot(inverse * innovation) / share;
        }
        log_prior
    }

    /// Variance of the mean of `n` errors, `secs` apart, over that of an error.
    fn variance_of_mean(&self, secs: f64, n: usize) -> f64 {
        let (phi, n) = (self.correlation(secs), n as f64);
        ((1.0 + phi) / (1.0 - phi) - 2.0 * phi * (1.0 - phi.powf(n)) / (n * (1.0 - phi).powi(2))) / n
    }

    /// Simulated errors of poses at these times \[s\]; the error at pose `i` is drawn from `draw(i)`.
    pub fn simulate<R: Rng>(&self, secs: &[f64], draw: impl Fn(u32) -> R) -> Vec<DVec3> {
        let mut error = DVec3::ZERO;
        let errors = (0..secs.len()).map(|i| {
            if self.is_none() {
                return error;
            }
            let mut rng = draw(i as u32);
            let phi = if i == 0 { 0.0 } else { self.correlation(secs[i] - secs[i - 1]) };
            let sigma = DVec3::new(self.sigma_m, self.sigma_m, self.sigma_rad);
            error = phi * error + (1.0 - phi * phi).sqrt() * sigma * normals(&mut rng);
            error + DVec3::new(self.white_m, self.white_m, self.white_rad) * normals(&mut rng)
        });
        errors.collect()
    }

    /// Information of a pose's white noise; `None` where there is none to speak of.
    fn white_information(&self) -> Option<DMat3> {
        let [of_position, of_heading] =
            [self.white_m.max(1e-7), self.white_rad.max(1e-8)].map(|sigma| sigma.powi(-2));
        let information = DMat3::from_diagonal(DVec3::new(of_position, of_position, of_heading));
        (self.white_m > 1e-7 || self.white_rad > 1e-8).then_some(information)
    }

    /// What scans say of the process alone, with the covariance of each scan's white noise given the process.
    fn without_white(&self, scans: &[PoseInformation]) -> Option<(Vec<PoseInformation>, Vec<DMat3>)> {
        let white = self.white_information()?;
        let of_process = scans.iter().map(|scan| {
            let covariance = (white + scan.matrix).inverse();
            let less = |vector: DVec3| scan.matrix * (covariance * vector);
            let matrix = scan.matrix - scan.matrix * covariance * scan.matrix;
            (PoseInformation { matrix, vector: scan.vector - less(scan.vector) }, covariance)
        });
        Some(of_process.unzip())
    }

    /// The poses of a track, each with a simulated error of the process; the error at pose `i` is drawn from `draw(i)`.
    pub fn perturb<R: Rng>(&self, track: &Track, draw: impl Fn(u32) -> R) -> Vec<Pose2> {
        track.poses().iter().zip(self.simulate(track.secs(), draw)).map(|(pose, e)| pose.moved(e)).collect()
    }
}

/// Three draws of a standard normal variable.
fn normals(rng: &mut impl Rng) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| StandardNormal.sample(rng)))
}

/// A turn about the middle of all poses and a shift of them: what the errors of poses in a turned frame have in common.
#[derive(Clone, Copy, Debug)]
pub struct TurnedFrame {
    /// The middle \[m\].
    pub center: DVec2,
    /// The shift \[m\].
    pub shift: DVec2,
    /// Standard error of the shift along each axis, of errors that are as large and last as long as the process says \[m\].
    pub shift_error_m: f64,
    /// The turn \[rad\], positive counter-clockwise.
    pub turn: f64,
    /// Information of the turn \[1/rad^2\].
    pub information: f64,
    /// Share of the errors' squares, each over its variance, that turn and shift make.
    pub share: f64,
    /// Share that the turn makes of what the shift leaves.
    pub share_of_turn: f64,
    /// Share that the shift makes of what the turn leaves.
    pub share_of_shift: f64,
}

impl TurnedFrame {
    /// A pose of the turned frame, turned and shifted.
    pub fn put_right(&self, pose: &Pose2) -> Pose2 {
        let arm = pose.position() - self.center;
        let position = self.center + self.shift + DVec2::from_angle(self.turn).rotate(arm);
        Pose2::new(position.x, position.y, pose.theta + self.turn)
    }
}

impl PoseError {
    /// The turn and the shift that fit corrections of the poses of a track (x and y \[m\], heading \[rad\]) best.
    pub fn turned_frame(&self, track: &Track, corrections: &[DVec3]) -> TurnedFrame {
        let count = track.len() as f64;
        let center = track.poses().iter().map(Pose2::position).sum::<DVec2>() / count;
        let shift = corrections.iter().map(|c| c.truncate()).sum::<DVec2>() / count;
        let [of_position, of_heading] = [self.sigma_m, self.sigma_rad].map(|sigma| sigma.max(1e-6).powi(-2));
        let [mut turned, mut information, mut all] = [0.0; 3];
        for (pose, c) in track.poses().iter().zip(corrections) {
            let arm = pose.position() - center;
            turned += of_position * arm.perp_dot(c.truncate()) + of_heading * c.z;
            information += of_position * arm.length_squared() + of_heading;
            all += of_position * c.truncate().length_squared() + of_heading * c.z * c.z;
        }
        let turn = turned / information;
        let secs = track.secs().last().unwrap_or(&0.0) - track.secs().first().unwrap_or(&0.0);
        let (by_turn, by_shift) = (turn * turned, of_position * count * shift.length_squared());
        let share = |part: f64, of: f64| if of > 0.0 { part / of } else { 0.0 };
        TurnedFrame {
            center,
            shift,
            shift_error_m: self.sigma_m * self.variance_of_mean(secs / count, track.len()).sqrt(),
            turn,
            information,
            share: share(by_turn + by_shift, all),
            share_of_turn: share(by_turn, all - by_shift),
            share_of_shift: share(by_shift, all - by_turn),
        }
    }
}

/// Likelihood of the error of a scan's pose, from its beams: information matrix and vector about zero.
#[derive(Clone, Copy, Debug)]
pub struct PoseInformation {
    /// Information matrix.
    pub matrix: DMat3,
    /// Information vector.
    pub vector: DVec3,
}

impl Default for PoseInformation {
    fn default() -> Self {
        Self { matrix: DMat3::ZERO, vector: DVec3::ZERO }
    }
}

impl std::ops::Add for PoseInformation {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { matrix: self.matrix + other.matrix, vector: self.vector + other.vector }
    }
}

impl std::ops::Mul<f64> for PoseInformation {
    type Output = Self;

    fn mul(self, factor: f64) -> Self {
        Self { matrix: self.matrix * factor, vector: self.vector * factor }
    }
}

impl PoseInformation {
    /// Adds a beam of weight 1 / variance, whose error falls by its jacobian times that of the pose.
    pub fn add_beam(&mut self, weight: f64, jacobian: [f64; 3], error: f64) {
        let j = DVec3::from_array(jacobian);
        self.matrix += DMat3::from_cols(weight * j * j.x, weight * j * j.y, weight * j * j.z);
        self.vector += weight * error * j;
    }

    /// What beams as informative as these say of a pose that errs so, with noise of theirs.
    #[must_use]
    pub fn simulate(&self, error: DVec3, rng: &mut impl Rng) -> Self {
        // Beams along a corridor say nothing of one direction.
        let ridge = 1e-9 * (self.matrix.x_axis.x + self.matrix.y_axis.y + self.matrix.z_axis.z);
        let matrix = Matrix3::from(self.matrix.to_cols_array_2d()) + Matrix3::from_diagonal_element(ridge);
        let normal = Vector3::from(normals(rng).to_array());
        let noise = matrix.cholesky().map_or(Vector3::zeros(), |factor| factor.l() * normal);
        let noise = DVec3::from_array(noise.into());
        Self { matrix: self.matrix, vector: self.matrix * error + noise }
    }
}

/// Mean, covariance and covariance with the scan before of each scan's error, given all scans.
pub struct SmoothedPoseErrors {
    /// Mean of each scan's error.
    pub mean: Vec<DVec3>,
    /// Its covariance.
    pub covariance: Vec<DMat3>,
    with_previous: Vec<DMat3>,
    /// Log evidence of the scans (nats), up to what doesn't depend on the process.
    pub log_evidence: f64,
    /// Part of it that is the volume of each scan's errors after the scan in that before it (nats).
    pub log_volume: Vec<f64>,
}

/// Kalman filter and Rauch-Tung-Striebel smoother, and then the white noise of each pose.
pub fn smooth_pose_errors(
    process: &PoseError,
    secs: &[f64],
    scans: &[PoseInformation],
) -> SmoothedPoseErrors {
    let Some(((of_process, of_white), white)) = process.without_white(scans).zip(process.white_information())
    else {
        return smooth_process(process, secs, scans);
    };
    let mut smoothed = smooth_process(process, secs, &of_process);
    for (i, (scan, own)) in scans.iter().zip(of_white).enumerate() {
        let volume = 0.5 * (own.determinant() * white.determinant()).ln();
        smoothed.log_evidence += volume + 0.5 * scan.vector.dot(own * scan.vector);
        smoothed.log_volume[i] += volume;
        let kept = DMat3::IDENTITY - own * scan.matrix;
        smoothed.mean[i] = kept * smoothed.mean[i] + own * scan.vector;
        smoothed.covariance[i] = own + kept * smoothed.covariance[i] * kept.transpose();
    }
    smoothed
}

/// The errors of the process alone.
fn smooth_process(process: &PoseError, secs: &[f64], scans: &[PoseInformation]) -> SmoothedPoseErrors {
    let n = scans.len();
    let stationary = process.covariance();
    let (mut predicted_mean, mut predicted) = (vec![DVec3::ZERO; n], vec![stationary; n]);
    let (mut mean, mut covariance) = (vec![DVec3::ZERO; n], vec![stationary; n]);
    let (mut log_evidence, mut log_volume) = (0.0, vec![0.0; n]);
    for i in 0..n {
        if i > 0 {
            let phi = process.correlation(secs[i] - secs[i - 1]);
            predicted_mean[i] = phi * mean[i - 1];
            predicted[i] = covariance[i - 1] * (phi * phi) + stationary * (1.0 - phi * phi);
        }
        let prior = predicted[i].inverse();
        let posterior = prior + scans[i].matrix;
        covariance[i] = posterior.inverse();
        let vector = prior * predicted_mean[i] + scans[i].vector;
        mean[i] = covariance[i] * vector;
        log_volume[i] =
            0.5 * (covariance[i].determinant().max(1e-300) / predicted[i].determinant().max(1e-300)).ln();
        log_evidence +=
            log_volume[i] + 0.5 * (vector.dot(mean[i]) - predicted_mean[i].dot(prior * predicted_mean[i]));
    }
    let mut with_previous = vec![DMat3::ZERO; n];
    for i in (0..n.saturating_sub(1)).rev() {
        let phi = process.correlation(secs[i + 1] - secs[i]);
        let gain = covariance[i] * phi * predicted[i + 1].inverse();
        let (later_mean, later) = (mean[i + 1], covariance[i + 1]);
        with_previous[i + 1] = later * gain.transpose();
        mean[i] += gain * (later_mean - predicted_mean[i + 1]);
        covariance[i] += gain * (later - predicted[i + 1]) * gain.transpose();
    }
    SmoothedPoseErrors { mean, covariance, with_previous, log_evidence, log_volume }
}

/// How much likelier `scans` are with the errors that other beams of the same scans say they have (nats): an error of a pose is in all
/// beams of its scan, noise is not. Below 0 where it isn't.
pub fn predictive_gain(
    process: &PoseError,
    secs: &[f64],
    others: &[PoseInformation],
    scans: &[PoseInformation],
) -> f64 {
    let errors = smooth_pose_errors(process, secs, others).mean;
    scans.iter().zip(errors).map(|(scan, e)| scan.vector.dot(e) - 0.5 * e.dot(scan.matrix * e)).sum()
}

/// Whether scans tell errors of a process, by all beams and by two halves of them. Its three parameters have to earn their keep (nats); noise of
/// some beams gains, too, but not on the others.
pub fn are_errors(
    process: &PoseError,
    secs: &[f64],
    scans: &[PoseInformation],
    [a, b]: &[Vec<PoseInformation>; 2],
) -> bool {
    const LEAST_EVIDENCE: f64 = 6.0;
    smooth_pose_errors(process, secs, scans).log_evidence > LEAST_EVIDENCE
        && predictive_gain(process, secs, a, b) + predictive_gain(process, secs, b, a) > 0.0
}

/// Steps of expectation maximization are this many times as long, of a logarithm.
const OVERRELAXED: f64 = 1.7;

/// Estimates the process by expectation maximization, about the mean of the errors: a constant error is no
/// fluctuation, and can't be told from a laser mounted otherwise.
pub fn fit_pose_error(
    start: PoseError,
    secs: &[f64],
    scans: &[PoseInformation],
    iterations: usize,
) -> PoseError {
    let n = scans.len() as f64;
    let step_secs = (secs.last().unwrap_or(&1.0) / (n - 1.0).max(1.0)).max(1e-6);
    // Steps of white noise are short where scans tell little of a single pose: they are made longer.
    let farther = |from: f64, to: f64| if from > 0.0 { to * (to / from).powf(OVERRELAXED - 1.0) } else { to };
    let mut process = start;
    for _ in 0..iterations {
        let (of_process, of_white) =
            process.without_white(scans).unwrap_or_else(|| (scans.to_vec(), vec![DMat3::ZERO; scans.len()]));
        let smoothed = smooth_process(&process, secs, &of_process);
        let center = smoothed.mean.iter().sum::<DVec3>() / n;
        let (mut square, mut product, mut white) = (DVec3::ZERO, DVec3::ZERO, DVec3::ZERO);
        for i in 0..scans.len() {
            let mean = smoothed.mean[i] - center;
            let diagonal = |m: &DMat3| DVec3::new(m.x_axis.x, m.y_axis.y, m.z_axis.z);
            let (own, scan) = (of_white[i], &scans[i]);
            let noise = own * (scan.vector - scan.matrix * smoothed.mean[i]);
            let shared = own * scan.matrix;
            white += noise * noise + diagonal(&(own + shared * smoothed.covariance[i] * shared.transpose()));
            square += mean * mean + diagonal(&smoothed.covariance[i]);
            if i > 0 {
                product += mean * (smoothed.mean[i - 1] - center) + diagonal(&smoothed.with_previous[i]);
            }
        }
        let prior = process.covariance();
        // The errors' own mean is off zero, too, by more in a short log.
        let of_mean = process.variance_of_mean(step_secs, scans.len())
            * DVec3::new(prior.x_axis.x, prior.y_axis.y, prior.z_axis.z);
        square += n * of_mean;
        product += (n - 1.0) * of_mean;
        // Each component counts by its own scale.
        let scaled = |v: DVec3| 0.5 * (v.x + v.y) / prior.x_axis.x + v.z / prior.z_axis.z;
        let phi = (scaled(product) / scaled(square) * n / (n - 1.0)).clamp(0.01, 0.999);
        process = PoseError {
            sigma_m: (0.5 * (square.x + square.y) / n).sqrt(),
            sigma_rad: (square.z / n).sqrt(),
            correlation_secs: -step_secs / phi.ln(),
            white_m: farther(process.white_m, (0.5 * (white.x + white.y) / n).sqrt()),
            white_rad: farther(process.white_rad, (white.z / n).sqrt()),
        };
    }
    process
}

/// Processes that are less likely than the best by up to this are as good (nats): of one number, one standard error and a half.
const AS_LIKELY_NATS: f64 = 1.0;
/// Each process that is tried lasts by this factor longer than the one before.
const LONGER: f64 = 1.25;

/// The process that lasts longest among those that explain scans about as well, each with the fluctuations from scan to scan of `process`, for
/// which the variance is proportional to the time. Constant errors of x and y, and errors in `patterns`, one error for each scan, may have any
/// size (restricted likelihood): a fit without these takes what hasn't ended within the log for one of them, and so finds errors that last too
/// short a time and are too small.
pub fn longest_lasting(
    process: PoseError,
    secs: &[f64],
    scans: &[PoseInformation],
    patterns: &[Vec<DVec3>],
) -> PoseError {
    let constants = [DVec3::X, DVec3::Y].map(|axis| vec![axis; scans.len()]);
    let patterns = [patterns, &constants].concat();
    let all_secs = secs.last().unwrap_or(&0.0) - secs.first().unwrap_or(&0.0);
    let of_process = process.without_white(scans).map_or_else(|| scans.to_vec(), |(scans, _)| scans);
    let mut best = f64::NEG_INFINITY;
    let mut longest = process;
    let mut next = process;
    while next.correlation_secs <= all_secs {
        let evidence = restricted_log_evidence(&next, secs, &of_process, &patterns);
        best = best.max(evidence);
        if evidence >= best - AS_LIKELY_NATS {
            longest = next;
        } else {
            break;
        }
        let larger = LONGER.sqrt();
        next = PoseError {
            sigma_m: larger * next.sigma_m,
            sigma_rad: larger * next.sigma_rad,
            correlation_secs: LONGER * next.correlation_secs,
            ..next
        };
    }
    longest
}

/// Log evidence of scans for a process (nats), up to what doesn't depend on it, integrated over errors in these patterns.
fn restricted_log_evidence(
    process: &PoseError,
    secs: &[f64],
    scans: &[PoseInformation],
    patterns: &[Vec<DVec3>],
) -> f64 {
    // The data, then what each pattern would make of them.
    let count = patterns.len() + 1;
    let vectors = |i: usize| {
        let told = patterns.iter().map(move |pattern| scans[i].matrix * pattern[i]);
        std::iter::once(scans[i].vector).chain(told)
    };
    let stationary = process.covariance();
    let (mut covariance, mut means) = (stationary, vec![DVec3::ZERO; count]);
    let mut log_volume = 0.0;
    // What the process explains of the product of two of them.
    let mut explained = DMatrix::<f64>::zeros(count, count);
    for i in 0..scans.len() {
        let mut predicted = stationary;
        if i > 0 {
            let phi = process.correlation(secs[i] - secs[i - 1]);
            predicted = covariance * (phi * phi) + stationary * (1.0 - phi * phi);
            for mean in &mut means {
                *mean *= phi;
            }
        }
        let prior = predicted.inverse();
        covariance = (prior + scans[i].matrix).inverse();
        log_volume += 0.5 * (covariance.determinant().max(1e-300) / predicted.determinant().max(1e-300)).ln();
        let before: Vec<[DVec3; 2]> = means.iter().map(|mean| [*mean, prior * *mean]).collect();
        let sums: Vec<DVec3> = vectors(i).zip(&before).map(|(vector, [_, prior])| vector + *prior).collect();
        means = sums.iter().map(|sum| covariance * *sum).collect();
        for a in 0..count {
            for b in 0..=a {
                explained[(a, b)] += sums[a].dot(means[b]) - before[a][1].dot(before[b][0]);
            }
        }
    }
    let own = |a: usize, b: usize| -> f64 {
        (0..scans.len()).map(|i| patterns[a][i].dot(scans[i].matrix * patterns[b][i])).sum()
    };
    let data = |a: usize| -> f64 { (0..scans.len()).map(|i| patterns[a][i].dot(scans[i].vector)).sum() };
    // Each pattern in its own scale, with a little for those that scans can't tell apart.
    let scale: Vec<f64> = (0..count - 1).map(|a| own(a, a).max(f64::MIN_POSITIVE).sqrt().recip()).collect();
    let information = DMatrix::from_fn(count - 1, count - 1, |a, b| {
        let [more, less] = [a.max(b), a.min(b)];
        let ridge = if a == b { 1e-9 } else { 0.0 };
        scale[a] * scale[b] * (own(more, less) - explained[(more + 1, less + 1)]) + ridge
    });
    let vector = DVector::from_fn(count - 1, |a, _| scale[a] * (data(a) - explained[(a + 1, 0)]));
    let of_patterns = information.cholesky().map_or(0.0, |factor| {
        let log_determinant = 2.0 * factor.l_dirty().diagonal().iter().map(|x| x.ln()).sum::<f64>();
        0.5 * (vector.dot(&factor.solve(&vector)) - log_determinant)
    });
    log_volume + 0.5 * explained[(0, 0)] + of_patterns
}

/// Data of scans after the least-squares fit of errors in these patterns is subtracted. Each pattern has an error for each scan.
pub fn without_patterns(scans: &[PoseInformation], patterns: &[Vec<DVec3>]) -> Vec<PoseInformation> {
    let sum = |of: &dyn Fn(usize) -> f64| (0..scans.len()).map(of).sum::<f64>();
    let count = patterns.len();
    let normal = DMatrix::from_fn(count, count, |row, column| {
        sum(&|i| patterns[row][i].dot(scans[i].matrix * patterns[column][i]))
    });
    let data = DVector::from_fn(count, |row, _| sum(&|i| patterns[row][i].dot(scans[i].vector)));
    // Each in its own scale. Patterns that scans can't tell apart share what they have in common.
    let scale = DVector::from_fn(count, |i, _| normal[(i, i)].max(f64::MIN_POSITIVE).sqrt().recip());
    let scaled = DMatrix::from_fn(count, count, |i, j| normal[(i, j)] * scale[i] * scale[j]);
    let numbers = scaled.svd(true, true).solve(&data.component_mul(&scale), 1e-12);
    let numbers = numbers.map_or_else(|_| DVector::zeros(count), |numbers| numbers.component_mul(&scale));
    let shift = |i: usize| patterns.iter().zip(&numbers).map(|(p, number)| *number * p[i]).sum::<DVec3>();
    let left = scans.iter().enumerate().map(|(i, scan)| PoseInformation {
        matrix: scan.matrix,
        vector: scan.vector - scan.matrix * shift(i),
    });
    left.collect()
}

/// The greatest change of an error \[m\], a radian counting as 3 m.
pub fn most_change(a: &[DVec3], b: &[DVec3]) -> f64 {
    let changes = a.iter().zip(b).map(|(a, b)| ((*a - *b) * DVec3::new(1.0, 1.0, 3.0)).length());
    changes.fold(0.0, f64::max)
}

/// How surely the reference's poses are off along a known pattern, `pattern[scan]` times a constant, on top of errors of
/// the process: the score of that constant in its own standard deviations.
///
/// A displaced laser, a turned one and a late stamp all move whole scans; errors that are fitted first would take them in.
pub fn pattern_score(process: &PoseError, secs: &[f64], scans: &[PoseInformation], pattern: &[DVec3]) -> f64 {
    // The part of a vector of data that the process doesn't explain.
    let left = |vectors: &dyn Fn(usize) -> DVec3| -> Vec<DVec3> {
        let as_data: Vec<PoseInformation> = scans
            .iter()
            .enumerate()
            .map(|(i, s)| PoseInformation { matrix: s.matrix, vector: vectors(i) })
            .collect();
        if process.is_none() {
            return as_data.iter().map(|s| s.vector).collect();
        }
        let mean = smooth_pose_errors(process, secs, &as_data).mean;
        as_data.iter().zip(mean).map(|(s, mean)| s.vector - s.matrix * mean).collect()
    };
    let along = |left: Vec<DVec3>| pattern.iter().zip(left).map(|(p, l)| p.dot(l)).sum::<f64>();
    along(left(&|i| scans[i].vector)) / along(left(&|i| scans[i].matrix * pattern[i])).max(1e-300).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What simulated scans say of an error has its mean and their own spread, also where they say nothing of one direction.
    #[test]
    fn scans_tell_an_error_as_surely_as_their_beams_are_many() {
        let mut scan = PoseInformation::default();
        for (weight, jacobian) in [(1e4, [1.0, 0.5, -2.0]), (4e4, [1.0, 0.5, 1.0])] {
            scan.add_beam(weight, jacobian, 0.0);
        }
        let error = DVec3::new(0.01, -0.02, 0.003);
        let draw = crate::Draw::new(5, crate::Stage::Path, 0);
        let (mut mean, mut square) = (DVec3::ZERO, DMat3::ZERO);
        let count = 20_000;
        for i in 0..count {
            let told = scan.simulate(error, &mut draw.item(i));
            let noise = told.vector - scan.matrix * error;
            mean += noise / f64::from(count);
            square += DMat3::from_cols(noise * noise.x, noise * noise.y, noise * noise.z)
                * f64::from(count).recip();
        }
        for i in 0..3 {
            let variance = scan.matrix.col(i)[i];
            // Five standard errors.
            assert!(mean[i].abs() < 5.0 * (variance / f64::from(count)).sqrt(), "{mean}");
            for j in 0..3 {
                let scale = (variance * scan.matrix.col(j)[j]).sqrt();
                let off = square.col(i)[j] - scan.matrix.col(i)[j];
                assert!(
                    off.abs() < 5.0 * scale * (2.0 / f64::from(count)).sqrt(),
                    "{i} {j}: {off} of {scale}"
                );
            }
        }
        let nothing = PoseInformation::default().simulate(error, &mut draw.item(0));
        assert_eq!(nothing.vector, DVec3::ZERO);
    }

    /// Errors of three seconds that are seen for thirty look shorter without what looks like a constant. The process that lasts longest is hardly
    /// ever too short, with a constant error as well as without.
    #[test]
    fn errors_that_last_are_not_taken_for_constants() {
        let truth = PoseError { sigma_m: 0.02, sigma_rad: 0.003, correlation_secs: 3.0, ..PoseError::NONE };
        let secs: Vec<f64> = (0..300).map(|i| 0.1 * f64::from(i)).collect();
        let matrix = DMat3::from_diagonal(DVec3::new(2e5, 2e5, 2e6));
        // A robot that turns once and a quarter, with a laser that may be turned, or elsewhere on it, and a reference that may be shifted.
        let mut patterns: Vec<Vec<DVec3>> = vec![vec![DVec3::Z; 300]];
        let at_heading = |turn: f64| {
            let heading = |i: u32| glam::DVec2::from_angle(turn + f64::from(i) / 40.0).extend(0.0);
            (0..300).map(heading).collect()
        };
        patterns.extend([0.0, std::f64::consts::FRAC_PI_2].map(at_heading));
        let (mut short_about_mean, mut short) = (0, 0);
        for log in 0..60 {
            let draw = |item: u32| crate::Draw::new(log, crate::Stage::Path, item);
            let errors = truth.simulate(&secs, |scan| draw(scan).item(0));
            let constant = if log % 2 == 0 { DVec3::ZERO } else { DVec3::new(0.05, -0.03, 0.01) };
            let scan = PoseInformation { matrix, vector: DVec3::ZERO };
            let told = errors.iter().enumerate();
            let scans: Vec<PoseInformation> =
                told.map(|(i, e)| scan.simulate(*e + constant, &mut draw(i as u32).item(1))).collect();
            let constants = [DVec3::X, DVec3::Y].map(|axis| vec![axis; 300]);
            let rest = without_patterns(&scans, &[&patterns[..], &constants].concat());
            let start =
                PoseError { sigma_m: 0.01, sigma_rad: 0.003, correlation_secs: 2.0, ..PoseError::NONE };
            let about_mean = fit_pose_error(start, &secs, &rest, 20);
            let longest = longest_lasting(about_mean, &secs, &scans, &patterns);
            let of_mean = |process: &PoseError| process.sigma_m * process.variance_of_mean(0.1, 300).sqrt();
            short_about_mean += usize::from(of_mean(&about_mean) < 0.7 * of_mean(&truth));
            short += usize::from(of_mean(&longest) < 0.7 * of_mean(&truth));
            // It isn't anything, either.
            assert!(of_mean(&longest) < 4.0 * of_mean(&truth), "{longest:?}");
        }
        assert!(short_about_mean > 12 && short < 4, "{short_about_mean} {short}");
    }

    /// The restricted evidence is that of the scans integrated over a constant, by a sum.
    #[test]
    fn restricted_evidence_is_integrated_over_patterns() {
        let secs: Vec<f64> = (0..12).map(|i| 0.5 * f64::from(i)).collect();
        let draw = crate::Draw::new(3, crate::Stage::Path, 0);
        let mut scan = PoseInformation::default();
        for (weight, jacobian) in [(1e4, [1.0, 0.5, -0.2]), (4e4, [0.2, -1.0, 1.0]), (2e4, [0.0, 1.0, 2.0])] {
            scan.add_beam(weight, jacobian, 0.0);
        }
        let scans: Vec<PoseInformation> =
            (0..12).map(|i| scan.simulate(DVec3::new(0.02, 0.0, 0.01), &mut draw.item(i))).collect();
        let pattern: Vec<DVec3> = (0..12).map(|i| DVec3::new(1.0, 0.1 * f64::from(i), 0.3)).collect();
        let evidence = |process: &PoseError| {
            let step = 1e-4;
            // Of the shifted data, and of what the shift alone explains.
            let at = |size: f64| {
                let shifted = scans.iter().zip(&pattern).map(|(scan, p)| PoseInformation {
                    matrix: scan.matrix,
                    vector: scan.vector - scan.matrix * (size * *p),
                });
                let shifted: Vec<PoseInformation> = shifted.collect();
                let alone = scans
                    .iter()
                    .zip(&pattern)
                    .map(|(scan, p)| size * p.dot(scan.vector) - 0.5 * size * size * p.dot(scan.matrix * *p));
                smooth_pose_errors(process, &secs, &shifted).log_evidence + alone.sum::<f64>()
            };
            let sizes = (-3000..=3000).map(|i| f64::from(i) * step);
            let logs: Vec<f64> = sizes.map(at).collect();
            let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            most + logs.iter().map(|log| (log - most).exp()).sum::<f64>().ln()
        };
        let processes = [(0.01, 1.0), (0.02, 3.0)].map(|(sigma_m, correlation_secs)| PoseError {
            sigma_m,
            sigma_rad: 0.004,
            correlation_secs,
            ..PoseError::NONE
        });
        let [a, b] = processes.map(|process| evidence(&process));
        let patterns = std::slice::from_ref(&pattern);
        let [c, d] = processes.map(|process| restricted_log_evidence(&process, &secs, &scans, patterns));
        assert!(((a - b) - (c - d)).abs() < 1e-6, "{a} {b} {c} {d}");
    }

    /// Data along the patterns are subtracted to the last bit; data orthogonal to them stay.
    #[test]
    fn patterns_are_taken_off() {
        let matrix = DMat3::from_diagonal(DVec3::new(4.0, 9.0, 100.0));
        let pattern: Vec<DVec3> = (0..6).map(|i| DVec3::new(1.0, 0.5 * f64::from(i), 0.1)).collect();
        let other: Vec<DVec3> = (0..6).map(|i| DVec3::new(0.0, 0.0, f64::from(i % 2))).collect();
        let along = |i: usize| 0.03 * pattern[i] - 0.2 * other[i];
        let scans: Vec<PoseInformation> =
            (0..6).map(|i| PoseInformation { matrix, vector: matrix * along(i) }).collect();
        for rest in without_patterns(&scans, &[pattern.clone(), other.clone()]) {
            assert!(rest.vector.length() < 1e-9, "{}", rest.vector);
        }
        let rest = without_patterns(&scans, std::slice::from_ref(&pattern));
        let score: f64 = pattern.iter().zip(&rest).map(|(p, rest)| p.dot(rest.vector)).sum();
        assert!(score.abs() < 1e-9 && rest[1].vector.length() > 1.0, "{score}");
    }

    /// Logs of three correlation times, whose mean is taken off, have errors as large as they were drawn in the mean.
    #[test]
    fn errors_of_a_short_log_are_as_large_as_they_are() {
        let process = PoseError { sigma_m: 0.01, sigma_rad: 0.003, correlation_secs: 2.0, ..PoseError::NONE };
        let secs: Vec<f64> = (0..60).map(|i| 0.1 * f64::from(i)).collect();
        let track = Track::new(secs.iter().map(|&secs| (secs, Pose2::IDENTITY))).unwrap();
        let matrix = DMat3::from_diagonal(DVec3::new(1e7, 1e7, 1e8));
        let fitted = (0..300).map(|log| {
            let draw = |scan| crate::Draw::new(log, crate::Stage::Path, scan).item(0);
            let errors = process.perturb(&track, draw);
            let scans = errors
                .iter()
                .map(|e| PoseInformation { matrix, vector: matrix * DVec3::new(e.x, e.y, e.theta) });
            fit_pose_error(process, &secs, &scans.collect::<Vec<_>>(), 8)
        });
        let of =
            |fitted: &PoseError| [fitted.sigma_m / 0.01, fitted.sigma_rad / 0.003].map(|ratio| ratio * ratio);
        let ratios: Vec<[f64; 2]> = fitted.map(|fitted| of(&fitted)).collect();
        for axis in 0..2 {
            let mean = ratios.iter().map(|ratio| ratio[axis]).sum::<f64>() / ratios.len() as f64;
            assert!((0.8..1.2).contains(&mean), "{mean}");
        }
    }

    /// The mean maximizes the joint log density of errors and scans: its gradient, written out, vanishes.
    #[test]
    fn the_smoothed_errors_are_the_most_likely_ones() {
        let process = PoseError { sigma_m: 0.02, sigma_rad: 0.005, correlation_secs: 0.7, ..PoseError::NONE };
        let secs: Vec<f64> = (0..9).map(|i| 0.1 * f64::from(i) + 0.02 * f64::from(i % 3)).collect();
        let scans: Vec<PoseInformation> = (0..9)
            .map(|i| {
                let mut information = PoseInformation::default();
                for beam in 0..4 {
                    let angle = f64::from(i) + 1.3 * f64::from(beam);
                    let error = 0.01 * (3.0 * angle).sin();
                    information.add_beam(1e4, [angle.cos(), angle.sin(), 2.0 * (2.0 * angle).cos()], error);
                }
                information
            })
            .collect();
        let mean = smooth_pose_errors(&process, &secs, &scans).mean;
        let inverse = process.covariance().inverse();
        let phi = |i: usize| process.correlation(secs[i] - secs[i - 1]);
        let innovation = |i: usize| {
            if i == 0 { mean[0] } else { (mean[i] - phi(i) * mean[i - 1]) / (1.0 - phi(i) * phi(i)) }
        };
        for i in 0..scans.len() {
            let later = if i + 1 < scans.len() { phi(i + 1) * innovation(i + 1) } else { DVec3::ZERO };
            let data = scans[i].vector - scans[i].matrix * mean[i];
            let gradient = data - inverse * (innovation(i) - later);
            assert!(gradient.length() < 1e-6 * scans[i].vector.length(), "{i}: {gradient}");
        }
    }

    /// Mean, evidence and prior of a process with white noise are those of the normal distribution of all errors at once.
    #[test]
    fn a_process_with_white_noise_is_one_normal_distribution() {
        let process = PoseError {
            sigma_m: 0.02,
            sigma_rad: 0.005,
            correlation_secs: 0.7,
            white_m: 0.004,
            white_rad: 0.002,
        };
        let secs: Vec<f64> = (0..9).map(|i| 0.1 * f64::from(i) + 0.02 * f64::from(i % 3)).collect();
        let scan = |i: u32| {
            let mut information = PoseInformation::default();
            for beam in 0..4 {
                let angle = f64::from(i) + 1.3 * f64::from(beam);
                let error = 0.01 * (3.0 * angle).sin();
                information.add_beam(1e4, [angle.cos(), angle.sin(), 2.0 * (2.0 * angle).cos()], error);
            }
            information
        };
        let scans: Vec<PoseInformation> = (0..9).map(scan).collect();
        let (slow, white) = ([0.02, 0.02, 0.005_f64], [0.004, 0.004, 0.002_f64]);
        let prior = DMatrix::from_fn(27, 27, |a, b| {
            let (a, b, axis, other) = (a / 3, b / 3, a % 3, b % 3);
            let same = if axis == other { 1.0 } else { 0.0 };
            let phi: f64 =
                (a.min(b) + 1..=a.max(b)).map(|i| process.correlation(secs[i] - secs[i - 1])).product();
            same * (phi * slow[axis].powi(2) + if a == b { white[axis].powi(2) } else { 0.0 })
        });
        let told = DMatrix::from_fn(27, 27, |a, b| {
            if a / 3 == b / 3 { scans[a / 3].matrix.col(b % 3)[a % 3] } else { 0.0 }
        });
        let vector = DVector::from_fn(27, |a, _| scans[a / 3].vector[a % 3]);
        let inverse = prior.clone().try_inverse().unwrap();
        let mean = (&inverse + &told).try_inverse().unwrap() * &vector;
        let volume = -0.5 * (DMatrix::identity(27, 27) + &prior * &told).determinant().ln();
        let found = smooth_pose_errors(&process, &secs, &scans);
        for a in 0..27 {
            assert!((found.mean[a / 3][a % 3] - mean[a]).abs() < 1e-9);
        }
        assert!((found.log_evidence - volume - 0.5 * vector.dot(&mean)).abs() < 1e-6);
        let log_prior = process.log_prior(&secs, &found.mean, &scans).iter().sum::<f64>();
        assert!((log_prior - volume + 0.5 * mean.dot(&(inverse * &mean))).abs() < 1e-6);
    }

    /// Noise that each pose has beside a slow error is found, and doesn't make that look quick.
    #[test]
    fn white_noise_is_told_from_errors_that_last() {
        let slow = PoseError { sigma_m: 0.01, sigma_rad: 0.004, correlation_secs: 2.0, ..PoseError::NONE };
        let truth = PoseError { white_m: 0.002, white_rad: 0.001, ..slow };
        let secs: Vec<f64> = (0..300).map(|i| 0.1 * f64::from(i)).collect();
        let matrix = DMat3::from_diagonal(DVec3::new(2e6, 2e6, 1e7));
        let start = PoseError { white_m: 0.001, white_rad: 0.0005, ..slow };
        let (mut quick, mut of_white) = (0, [0.0; 2]);
        for log in 0..20 {
            let draw = |item: u32| crate::Draw::new(log, crate::Stage::Path, item);
            let errors = truth.simulate(&secs, |scan| draw(scan).item(0));
            let scan = PoseInformation { matrix, vector: DVec3::ZERO };
            let told = errors.iter().enumerate();
            let scans: Vec<PoseInformation> =
                told.map(|(i, e)| scan.simulate(*e, &mut draw(i as u32).item(1))).collect();
            let found = fit_pose_error(start, &secs, &scans, 80);
            quick += usize::from(found.correlation_secs < 0.7);
            of_white[0] += found.white_m / 20.0;
            of_white[1] += found.white_rad / 20.0;
            let without = fit_pose_error(slow, &secs, &scans, 80);
            assert!(without.correlation_secs < found.correlation_secs);
        }
        assert!(quick <= 2, "{quick}");
        assert!(
            (of_white[0] / 0.002 - 1.0).abs() < 0.15 && (of_white[1] / 0.001 - 1.0).abs() < 0.15,
            "{of_white:?}"
        );
    }
}
