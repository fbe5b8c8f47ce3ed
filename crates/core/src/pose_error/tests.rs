use glam::{DMat3, DVec3};
use nalgebra::{DMatrix, DVector};

use super::fit::restricted_log_evidence;
use super::*;
use crate::{Pose2, Track};

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
        square +=
            DMat3::from_cols(noise * noise.x, noise * noise.y, noise * noise.z) * f64::from(count).recip();
    }
    for i in 0..3 {
        let variance = scan.matrix.col(i)[i];
        // Five standard errors.
        assert!(mean[i].abs() < 5.0 * (variance / f64::from(count)).sqrt(), "{mean}");
        for j in 0..3 {
            let scale = (variance * scan.matrix.col(j)[j]).sqrt();
            let off = square.col(i)[j] - scan.matrix.col(i)[j];
            assert!(off.abs() < 5.0 * scale * (2.0 / f64::from(count)).sqrt(), "{i} {j}: {off} of {scale}");
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
        let start = PoseError { sigma_m: 0.01, sigma_rad: 0.003, correlation_secs: 2.0, ..PoseError::NONE };
        let about_mean = fit_pose_error(start, &secs, &rest, 20);
        let longest = longest_lasting(about_mean, &secs, &scans, &patterns);
        let longest = no_larger_than_told(longest, &secs, &scans);
        let of_mean = |process: &PoseError| process.sigma_m * process.variance_of_mean(0.1, 300).sqrt();
        short_about_mean += usize::from(of_mean(&about_mean) < 0.7 * of_mean(&truth));
        short += usize::from(of_mean(&longest) < 0.7 * of_mean(&truth));
        // It isn't anything, either.
        assert!(of_mean(&longest) < 4.0 * of_mean(&truth), "{longest:?}");
    }
    assert!(short_about_mean > 12 && short < 4, "{short_about_mean} {short}");
}

/// Errors that come and go within three seconds, as smoothly as a localizer's: from scan to scan they hardly change, and a fit has them last for
/// minutes and be three times as large as they are.
#[test]
fn smooth_errors_are_no_larger_than_they_are() {
    let secs: Vec<f64> = (0..300).map(|i| 0.18 * f64::from(i)).collect();
    let sigmas = DVec3::new(0.02, 0.02, 0.005);
    let scan =
        PoseInformation { matrix: DMat3::from_diagonal(DVec3::new(2e6, 2e6, 2e7)), vector: DVec3::ZERO };
    for log in 0..8 {
        let draw = |item: u32| crate::Draw::new(log, crate::Stage::Path, item);
        // Waves of 8 to 30 s, each of a random phase.
        let phases =
            (0..24).map(|wave| super::information::normals(&mut draw(wave).item(2))).collect::<Vec<_>>();
        let error = |secs: f64| {
            let waves = phases.iter().zip(0..).map(|(phase, wave)| {
                let omega = 0.21 + 0.024 * f64::from(wave);
                let of_axis = |phase: f64| (omega * secs + 20.0 * phase).sin();
                DVec3::new(of_axis(phase.x), of_axis(phase.y), of_axis(phase.z))
            });
            sigmas * waves.sum::<DVec3>() / 12.0_f64.sqrt()
        };
        let errors: Vec<DVec3> = secs.iter().map(|secs| error(*secs)).collect();
        let told = errors.iter().zip(0..);
        let scans: Vec<PoseInformation> =
            told.map(|(e, i)| scan.simulate(*e, &mut draw(i).item(1))).collect();
        let start = PoseError { sigma_m: 0.01, sigma_rad: 0.003, correlation_secs: 2.0, ..PoseError::NONE };
        let fitted = longest_lasting(fit_pose_error(start, &secs, &scans, 20), &secs, &scans, &[]);
        let limited = no_larger_than_told(fitted, &secs, &scans);
        let square = errors.iter().map(|e| *e * *e).sum::<DVec3>() / 300.0;
        let rms = [(0.5 * (square.x + square.y)).sqrt(), square.z.sqrt()];
        let over = |process: &PoseError| [process.sigma_m / rms[0], process.sigma_rad / rms[1]];
        assert!(over(&fitted).iter().all(|over| *over > 1.5), "{:?} {fitted:?}", over(&fitted));
        assert!(
            over(&limited).iter().all(|over| (0.5..1.5).contains(over)),
            "{:?} {limited:?}",
            over(&limited)
        );
        // The same fluctuations from scan to scan.
        let per_sec = |process: &PoseError| process.sigma_m.powi(2) / process.correlation_secs;
        assert!((per_sec(&limited) / per_sec(&fitted) - 1.0).abs() < 1e-9);
    }
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
        let scans =
            errors.iter().map(|e| PoseInformation { matrix, vector: matrix * DVec3::new(e.x, e.y, e.theta) });
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

/// Nine scans of four beams each, with their times \[s\].
fn nine_scans() -> (Vec<f64>, Vec<PoseInformation>) {
    let scan = |i: u32| {
        let mut information = PoseInformation::default();
        for beam in 0..4 {
            let angle = f64::from(i) + 1.3 * f64::from(beam);
            let error = 0.01 * (3.0 * angle).sin();
            information.add_beam(1e4, [angle.cos(), angle.sin(), 2.0 * (2.0 * angle).cos()], error);
        }
        information
    };
    let secs = |i: u32| 0.1 * f64::from(i) + 0.02 * f64::from(i % 3);
    ((0..9).map(secs).collect(), (0..9).map(scan).collect())
}

/// The mean maximizes the joint log density of errors and scans: its gradient, written out, vanishes.
#[test]
fn the_smoothed_errors_are_the_most_likely_ones() {
    let process = PoseError { sigma_m: 0.02, sigma_rad: 0.005, correlation_secs: 0.7, ..PoseError::NONE };
    let (secs, scans) = nine_scans();
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
    let (secs, scans) = nine_scans();
    let (slow, white) = ([0.02, 0.02, 0.005_f64], [0.004, 0.004, 0.002_f64]);
    let prior = DMatrix::from_fn(27, 27, |a, b| {
        let (a, b, axis, other) = (a / 3, b / 3, a % 3, b % 3);
        let same = if axis == other { 1.0 } else { 0.0 };
        let phi: f64 =
            (a.min(b) + 1..=a.max(b)).map(|i| process.correlation(secs[i] - secs[i - 1])).product();
        same * (phi * slow[axis].powi(2) + if a == b { white[axis].powi(2) } else { 0.0 })
    });
    let told =
        DMatrix::from_fn(
            27,
            27,
            |a, b| {
                if a / 3 == b / 3 { scans[a / 3].matrix.col(b % 3)[a % 3] } else { 0.0 }
            },
        );
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
