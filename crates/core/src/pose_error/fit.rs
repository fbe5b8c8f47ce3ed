use glam::{DMat3, DVec3};
use nalgebra::{DMatrix, DVector};

use super::information::PoseInformation;
use super::process::PoseError;
use super::smoother::{predictive_gain, smooth_pose_errors, smooth_process};

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

/// Steps in which it is found: what scans don't tell of an error is as large as the process.
const STEPS: usize = 4;

/// The process that is no larger than what scans say the errors are (root mean square), with the same variance for each second: of errors that
/// last, the same changes from scan to scan. Errors that come and go smoothly hardly change from scan to scan. A fit takes them for a process that
/// outlasts the log by far, and is as large as it could become by then.
pub fn no_larger_than_told(process: PoseError, secs: &[f64], scans: &[PoseInformation]) -> PoseError {
    let mut process = process;
    for _ in 0..STEPS {
        let smoothed = smooth_pose_errors(&process, secs, scans);
        let squares = smoothed.mean.iter().zip(&smoothed.covariance).map(|(mean, covariance)| {
            *mean * *mean + DVec3::new(covariance.x_axis.x, covariance.y_axis.y, covariance.z_axis.z)
        });
        let square = squares.sum::<DVec3>() / scans.len() as f64;
        let of_position = 0.5 * (square.x + square.y) / process.sigma_m.powi(2);
        let of_heading = square.z / process.sigma_rad.powi(2);
        let share = of_position.max(of_heading).min(1.0);
        process = PoseError {
            sigma_m: share.sqrt() * process.sigma_m,
            sigma_rad: share.sqrt() * process.sigma_rad,
            correlation_secs: share * process.correlation_secs,
            ..process
        };
    }
    process
}

/// Log evidence of scans for a process (nats), up to what doesn't depend on it, integrated over errors in these patterns.
pub(super) fn restricted_log_evidence(
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
