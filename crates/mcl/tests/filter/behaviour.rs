//! The promises of a filter, step by step.

use std::f64::consts::PI;
use std::sync::Arc;

use locsim_core::{Beams, Draw, Laser, Particles, Pose2, Scan, SensorModel, wrap_angle};
use locsim_mcl::{
    Filter, FilterError, FilterOptions, InjectionOptions, KldOptions, NO_PARENT, ParticleCount, PoseBins,
    Recovery, ResampleTrigger, Spread, Start, StepInput, StepOutcome, UpdateThreshold, weighted_mean,
};

use crate::toy::{Gaussian, Room};
use crate::{laser, options, scan};

const ROOM: Room = Room { width: 6.0, depth: 4.0 };
const MODEL: Gaussian = Gaussian { sigma_m: 0.1 };
const START: Pose2 = Pose2 { x: 2.0, y: 1.0, theta: 0.0 };
const INCREMENT: Pose2 = Pose2 { x: 0.1, y: 0.0, theta: 0.1 };

/// A model that gives every beam the same log density.
struct Constant(f32);

impl SensorModel for Constant {
    fn name(&self) -> &'static str {
        "constant"
    }

    fn log_density(&self, _: &[f32], _: &Beams<'_>, out: &mut [f32]) {
        out.fill(self.0);
    }

    fn cdf(&self, _: &[f32], _: &Beams<'_>, out: &mut [f32]) {
        out.fill(1.0);
    }

    fn sample(&self, _: &Beams<'_>, _: &Draw, out: &mut [f32]) {
        out.fill(0.0);
    }
}

fn tracking(sigma: f64) -> Start {
    Start::Tracking { pose: START, spread: Spread { sigma_m: sigma, sigma_rad: sigma } }
}

fn filter(options: FilterOptions, start: &Start) -> Filter {
    Filter::new(options, start, &ROOM, 1).unwrap()
}

/// Steps `filter` along the circle of [`INCREMENT`] from `from`; returns the robot's last pose and each outcome.
fn drive(filter: &mut Filter, from: Pose2, steps: u32) -> (Pose2, Vec<StepOutcome>) {
    let laser = laser(12);
    let mut truth = from;
    let outcomes = (0..steps)
        .map(|step| {
            truth = truth.compose(&INCREMENT);
            let scan = scan(&ROOM, &laser, &MODEL, truth, step);
            let input = StepInput { odometry: INCREMENT, laser: &laser, scan: &scan };
            filter.step(&input, &ROOM, &MODEL).unwrap()
        })
        .collect();
    (truth, outcomes)
}

/// One step without motion.
fn stand(filter: &mut Filter, model: &dyn SensorModel) -> Result<StepOutcome, FilterError> {
    let laser = laser(4);
    let scan = scan(&ROOM, &laser, &MODEL, START, 0);
    filter.step(&StepInput { odometry: Pose2::IDENTITY, laser: &laser, scan: &scan }, &ROOM, model)
}

fn distance(a: &Pose2, b: &Pose2) -> f64 {
    (a.x - b.x).hypot(a.y - b.y)
}

/// The room looks the same from a pose turned by half a turn about its centre.
fn distance_up_to_symmetry(a: &Pose2, b: &Pose2) -> f64 {
    let turned = Pose2::new(ROOM.width - b.x, ROOM.depth - b.y, b.theta + PI);
    distance(a, b).min(distance(a, &turned))
}

#[test]
fn tracking_removes_an_error_of_the_start() {
    let mut filter = filter(options(2000), &tracking(0.3));
    let from = Pose2::new(START.x + 0.3, START.y - 0.3, 0.2);
    let (truth, outcomes) = drive(&mut filter, from, 20);
    let estimate = outcomes[19].estimates.weighted_mean.pose;
    // 12 beams of 10 cm at each of 20 steps leave about 3 cm.
    assert!(distance(&estimate, &truth) < 0.1, "{estimate:?}, truth {truth:?}");
    assert!(wrap_angle(estimate.theta - truth.theta).abs() < 0.1);
}

#[test]
fn a_global_start_finds_the_pose_and_its_mirror_image_and_needs_few_particles_then() {
    let bins = PoseBins::new(0.5, 10_f64.to_radians()).unwrap();
    let kld = KldOptions {
        min: 100,
        max: 20_000,
        error: 0.05,
        quantile: 0.99,
        bin_m: 0.5,
        bin_rad: 10_f64.to_radians(),
    };
    let options = FilterOptions { particles: ParticleCount::Kld(kld), clusters: Some(bins), ..options(1) };
    let mut filter = filter(options, &Start::Global);
    let (truth, outcomes) = drive(&mut filter, START, 15);
    assert_eq!(outcomes[0].particle_count, 20_000);
    let last = outcomes[14];
    assert!((100..2000).contains(&last.particle_count), "{}", last.particle_count);
    let cluster = last.estimates.densest_cluster.unwrap();
    assert!(distance_up_to_symmetry(&cluster.estimate.pose, &truth) < 0.1, "{cluster:?}, truth {truth:?}");
}

#[test]
fn random_particles_recover_a_kidnapped_robot_and_nothing_else_does() {
    let kidnapped = |injection, least_effective_share| {
        let clusters = Some(PoseBins::new(0.5, 10_f64.to_radians()).unwrap());
        let options = FilterOptions { injection, clusters, least_effective_share, ..options(3000) };
        let mut filter = filter(options, &tracking(0.1));
        drive(&mut filter, START, 20);
        let (truth, outcomes) = drive(&mut filter, Pose2::new(4.5, 2.0, 2.0), 40);
        let cluster = outcomes[39].estimates.densest_cluster.unwrap();
        let injected: usize = outcomes.iter().map(|outcome| outcome.injected).sum();
        (distance_up_to_symmetry(&cluster.estimate.pose, &truth), injected)
    };
    let injection = InjectionOptions { alpha_slow: 0.02, alpha_fast: 0.5 };
    // Scans that are taken in by a power show the loss as well.
    for least_effective_share in [None, Some(0.02)] {
        let (error, injected) = kidnapped(Some(injection), least_effective_share);
        assert!(error < 0.15 && injected > 0, "error {error} m after {injected} random particles");
    }
    let (error, injected) = kidnapped(None, None);
    assert!(error > 0.5 && injected == 0, "error {error} m without random particles");
}

/// A filter that starts again has no expectations: its new particles aren't replaced by random ones.
#[test]
fn a_restart_begins_without_random_particles() {
    let injection = Some(InjectionOptions { alpha_slow: 0.02, alpha_fast: 0.5 });
    let mut filter = filter(FilterOptions { injection, ..options(3000) }, &tracking(0.1));
    drive(&mut filter, START, 20);
    let (truth, lost) = drive(&mut filter, Pose2::new(4.5, 2.0, 2.0), 2);
    assert!(lost[1].injected > 300, "{}", lost[1].injected);
    filter.restart(&ROOM).unwrap();
    let (_, outcomes) = drive(&mut filter, truth, 1);
    assert_eq!(outcomes[0].injected, 0);
}

#[test]
fn impossible_observations_reset_the_weights_and_the_filter_goes_on() {
    let mut filter = filter(options(100), &tracking(0.1));
    stand(&mut filter, &MODEL).unwrap();
    let outcome = stand(&mut filter, &Constant(f32::NEG_INFINITY)).unwrap();
    assert_eq!(outcome.recovered, Some(Recovery::WeightsReset));
    assert_eq!(outcome.log_evidence, f64::NEG_INFINITY);
    assert_eq!((outcome.resampled, outcome.effective_sample_size), (false, 100.0));
    assert!(filter.weights().linear().iter().all(|w| *w == 0.01));
    assert!(outcome.estimates.weighted_mean.pose.is_finite());
    let outcome = stand(&mut filter, &MODEL).unwrap();
    assert_eq!(outcome.recovered, None);
    assert!(outcome.resampled && outcome.effective_sample_size < 100.0);
    assert_eq!(Recovery::WeightsReset.to_string(), "every particle had likelihood zero: weights made equal");
}

#[test]
fn a_model_that_returns_nan_is_named() {
    for bad in [f32::NAN, f32::INFINITY] {
        let mut filter = filter(options(100), &tracking(0.1));
        stand(&mut filter, &MODEL).unwrap();
        let error = stand(&mut filter, &Constant(bad)).unwrap_err();
        assert_eq!(
            error.to_string(),
            "step 1: sensor model `constant` gives particle 0 a log likelihood that is no number"
        );
    }
}

#[test]
fn a_blind_scan_tells_nothing() {
    let mut filter = filter(options(100), &tracking(0.1));
    let (laser, scan) = (laser(4), Scan { ranges: vec![f32::NAN; 4] });
    let input = StepInput { odometry: Pose2::IDENTITY, laser: &laser, scan: &scan };
    let outcome = filter.step(&input, &ROOM, &MODEL).unwrap();
    assert!(outcome.log_evidence.abs() < 1e-12);
    assert!((outcome.effective_sample_size - 100.0).abs() < 1e-9);
}

#[test]
fn the_set_shown_after_a_step_is_the_weighted_one() {
    let mut filter = filter(options(500), &tracking(0.2));
    let (_, outcomes) = drive(&mut filter, START, 3);
    assert!(outcomes[2].resampled);
    let mean = weighted_mean(filter.particles(), filter.weights()).unwrap();
    assert_eq!(mean, outcomes[2].estimates.weighted_mean);
    let best = filter.weights().argmax().unwrap();
    assert_eq!(filter.particles().get(best), outcomes[2].estimates.max_weight);
    assert_eq!(filter.weights().effective_sample_size(), outcomes[2].effective_sample_size);
    assert!(outcomes[2].effective_sample_size < 499.0);
    assert_eq!(filter.log_likelihood().len(), 500);
}

#[test]
fn the_trigger_decides_on_the_effective_sample_size() {
    for (share, resampled) in [(0.0, false), (0.05, false), (1.0, true)] {
        let trigger = ResampleTrigger::EffectiveShareBelow(share);
        let mut filter = filter(FilterOptions { trigger, ..options(500) }, &tracking(0.05));
        let outcome = stand(&mut filter, &MODEL).unwrap();
        assert!((25.0..499.0).contains(&outcome.effective_sample_size), "{outcome:?}");
        assert_eq!(outcome.resampled, resampled, "share {share}");
        assert_eq!(filter.ancestors().is_some(), resampled);
    }
}

/// Without resampling two scans weigh like both at once.
#[test]
fn weights_accumulate_until_resampling() {
    let trigger = ResampleTrigger::EffectiveShareBelow(0.0);
    let mut filter = filter(FilterOptions { trigger, ..options(200) }, &tracking(0.05));
    stand(&mut filter, &MODEL).unwrap();
    let once = filter.weights().log().collect::<Vec<_>>();
    stand(&mut filter, &MODEL).unwrap();
    let twice = filter.weights().log().collect::<Vec<_>>();
    for i in 1..200 {
        let (once, twice) = (once[i] - once[0], twice[i] - twice[0]);
        assert!((twice - 2.0 * once).abs() < 1e-9, "{twice}, {once}");
    }
}

/// What a caller keeps stays as it was, and changes nothing of what follows; without such a caller no memory is given up.
#[test]
fn kept_particles_stay_and_change_nothing() {
    let options = || FilterOptions {
        injection: Some(InjectionOptions { alpha_slow: 0.1, alpha_fast: 0.9 }),
        regularization: Some(Spread { sigma_m: 0.01, sigma_rad: 0.01 }),
        ..options(200)
    };
    let (mut kept, mut alone) = (filter(options(), &tracking(0.05)), filter(options(), &tracking(0.05)));
    let mut held = Vec::new();
    for _ in 0..10 {
        held.push((Arc::clone(kept.particles()), Particles::clone(kept.particles())));
        stand(&mut kept, &MODEL).unwrap();
        stand(&mut alone, &MODEL).unwrap();
        assert_eq!(kept.particles(), alone.particles());
        assert_eq!(kept.weights(), alone.weights());
        assert_eq!(kept.log_likelihood(), alone.log_likelihood());
    }
    assert!(held.iter().all(|(shared, copy)| **shared == *copy));
    let set = Arc::as_ptr(alone.particles());
    stand(&mut alone, &MODEL).unwrap();
    stand(&mut alone, &MODEL).unwrap();
    assert_eq!(Arc::as_ptr(alone.particles()), set, "two sets take turns");
}

/// All particles start at one point and are moved by the jitter alone, so that their variance is sigma^2, to within
/// 4.9 sqrt(2 / n) of it with a false-alarm probability of 1e-6.
#[test]
fn regularization_spreads_resampled_particles_as_told() {
    let n = 50_000;
    let regularization = Some(Spread { sigma_m: 0.02, sigma_rad: 0.03 });
    let mut filter = filter(FilterOptions { regularization, ..options(n) }, &tracking(0.0));
    stand(&mut filter, &MODEL).unwrap();
    assert!(filter.particles().iter().all(|pose| pose == START), "jitter comes with the next step");
    stand(&mut filter, &Constant(0.0)).unwrap();
    let covariance = weighted_mean(filter.particles(), filter.weights()).unwrap().covariance;
    for (axis, sigma) in [0.02_f64, 0.02, 0.03].into_iter().enumerate() {
        let relative = covariance[axis][axis] / sigma.powi(2) - 1.0;
        assert!(relative.abs() < 4.9 * (2.0 / n as f64).sqrt(), "axis {axis}: {relative}");
    }
}

/// The same scan a hundred times over says no more than once. Taken in each time it leaves copies of one particle.
#[test]
fn scans_of_a_robot_that_stands_are_taken_in_once() {
    let update = Some(UpdateThreshold { distance_m: 0.1, angle_rad: 0.1 });
    let stood = |update| {
        let mut filter = filter(FilterOptions { update, ancestry: true, ..options(2000) }, &tracking(0.2));
        let outcomes: Vec<StepOutcome> = (0..100).map(|_| stand(&mut filter, &MODEL).unwrap()).collect();
        (filter, outcomes)
    };
    let variance = |outcome: &StepOutcome| {
        let covariance = outcome.estimates.weighted_mean.covariance;
        covariance[0][0] + covariance[1][1]
    };
    let (_, all) = stood(None);
    assert!(variance(&all[99]) < 0.1 * variance(&all[0]), "{} {}", variance(&all[0]), variance(&all[99]));
    let (mut filter, once) = stood(update);
    assert_eq!(once[0], all[0]);
    for outcome in &once[1..] {
        let StepOutcome { log_evidence, likelihood_power, resampled, .. } = *outcome;
        assert_eq!((log_evidence, likelihood_power, resampled), (0.0, 0.0, false));
        assert!((variance(outcome) / variance(&once[0]) - 1.0).abs() < 0.3, "only resampling moved it");
    }
    // Each scan has its pose in the history, and none has moved.
    let trajectory = filter.ancestry().unwrap().most_likely_trajectory().unwrap();
    assert_eq!(trajectory.poses.len(), 100);
    assert!(trajectory.poses.iter().all(|pose| *pose == trajectory.poses[0]));

    // Six centimetres are too few, twelve are enough; so is a turn.
    let laser = laser(4);
    let mut with = |odometry: Pose2, scan: &Scan| {
        let input = StepInput { odometry, laser: &laser, scan };
        filter.step(&input, &ROOM, &MODEL).unwrap().likelihood_power
    };
    let seen = scan(&ROOM, &laser, &MODEL, START, 0);
    let mut step = |odometry: Pose2| with(odometry, &seen);
    let ahead = Pose2::new(0.06, 0.0, 0.0);
    assert_eq!([step(ahead), step(ahead), step(ahead)], [0.0, 1.0, 0.0]);
    assert_eq!([step(Pose2::new(0.0, 0.0, -0.2)), step(Pose2::IDENTITY)], [1.0, 0.0]);
    // A scan without a reading takes no place of one that has.
    let blind = Scan { ranges: vec![f32::NAN; 4] };
    assert_eq!(with(Pose2::new(0.2, 0.0, 0.0), &blind), 0.0);
    assert_eq!([with(Pose2::IDENTITY, &seen), with(Pose2::IDENTITY, &seen)], [1.0, 0.0]);
}

/// A laser that is a hundred times as precise as the start leaves a handful of particles. With a least share it leaves as many as
/// asked for, ranked as before; the power is known to 2^-30, which moves no count by a thousandth.
#[test]
fn a_scan_that_would_leave_few_particles_is_taken_in_by_a_power() {
    let sharp = Gaussian { sigma_m: 0.002 };
    let after = |least_effective_share, model: &Gaussian| {
        let mut filter = filter(FilterOptions { least_effective_share, ..options(2000) }, &tracking(0.2));
        let outcome = stand(&mut filter, model).unwrap();
        (outcome.effective_sample_size, filter.log_likelihood().to_vec(), outcome.log_evidence)
    };
    let (few, whole, log_evidence) = after(None, &sharp);
    assert!(few < 20.0, "{few} are effective");
    let (enough, scaled, of_cut_scan) = after(Some(0.05), &sharp);
    // Whatever is taken in, the scan was as likely.
    assert!((of_cut_scan - log_evidence).abs() < 1e-9 * log_evidence.abs(), "{of_cut_scan}, {log_evidence}");
    assert!((enough / 100.0 - 1.0).abs() < 1e-3, "{enough} are effective");
    let power = scaled[0] / whole[0];
    assert!((0.0..0.5).contains(&power), "power {power}");
    for (scaled, whole) in scaled.iter().zip(&whole) {
        assert!((scaled - power * whole).abs() <= 1e-9 * whole.abs(), "{scaled}, {whole}");
    }
    let options = FilterOptions { least_effective_share: Some(0.05), ..options(2000) };
    let outcome = stand(&mut filter(options, &tracking(0.2)), &Constant(f32::NEG_INFINITY)).unwrap();
    assert_eq!(outcome.recovered, Some(Recovery::WeightsReset), "impossible remains impossible");
    // A scan that leaves enough is taken in whole.
    let dull = Gaussian { sigma_m: 1.0 };
    assert_eq!(after(None, &dull), after(Some(0.05), &dull));
}

/// Where fewer are effective before the scan than it is to leave, it isn't ignored.
#[test]
fn a_set_with_few_effective_particles_still_takes_scans_in() {
    let mut filter = filter(
        FilterOptions {
            least_effective_share: Some(0.9),
            trigger: ResampleTrigger::EffectiveShareBelow(0.0),
            ..options(2000)
        },
        &tracking(0.2),
    );
    let sharp = Gaussian { sigma_m: 0.002 };
    let effective: Vec<f64> =
        (0..4).map(|_| stand(&mut filter, &sharp).unwrap().effective_sample_size).collect();
    for pair in effective.windows(2) {
        assert!((pair[1] / pair[0] - 0.5).abs() < 0.01, "{effective:?}");
    }
}

#[test]
fn beams_start_at_the_laser_and_not_at_the_base() {
    let mount = Pose2::new(0.3, -0.1, 0.7);
    let laser = Laser::new(vec![0.0, 1.0, 2.0], vec![0.0; 3], 0.0, 50.0, mount).unwrap();
    let mut filter = filter(options(1), &tracking(0.0));
    let exact = Gaussian { sigma_m: 1e-9 };
    let scan = scan(&ROOM, &laser, &exact, START, 0);
    let input = StepInput { odometry: Pose2::IDENTITY, laser: &laser, scan: &scan };
    let outcome = filter.step(&input, &ROOM, &MODEL).unwrap();
    let peak = -3.0 * (0.1 * (2.0 * PI).sqrt()).ln();
    assert!((outcome.log_evidence - peak).abs() < 1e-5, "{} is not {peak}", outcome.log_evidence);
}

/// The trajectory agrees with a history kept by hand, with resampling, injection and steps without either.
#[test]
fn the_most_likely_trajectory_is_the_path_of_the_best_sum() {
    let options = FilterOptions {
        trigger: ResampleTrigger::EffectiveShareBelow(0.3),
        injection: Some(InjectionOptions { alpha_slow: 0.01, alpha_fast: 0.9 }),
        ancestry: true,
        ..options(300)
    };
    let mut filter = filter(options, &tracking(0.1));
    let mut paths: Vec<(f64, Vec<Pose2>)> = vec![(0.0, Vec::new()); 300];
    let mut log_evidence = 0.0;
    let (mut resampled, mut injected) = (0, 0);
    let mut truth = START;
    for step in 0..12 {
        if step == 6 {
            // Carried away, so that random particles come in.
            truth = Pose2::new(4.0, 2.5, 2.0);
        }
        if let Some(ancestors) = filter.ancestors() {
            let random = (log_evidence, Vec::new());
            paths = ancestors
                .iter()
                .map(|&a| if a == NO_PARENT { random.clone() } else { paths[a as usize].clone() })
                .collect();
        }
        let (at, outcomes) = drive(&mut filter, truth, 1);
        truth = at;
        for (i, (sum, path)) in paths.iter_mut().enumerate() {
            *sum += filter.log_likelihood()[i];
            path.push(filter.particles().get(i));
        }
        log_evidence += outcomes[0].log_evidence;
        resampled += usize::from(outcomes[0].resampled);
        injected += outcomes[0].injected;
        assert_eq!(outcomes[0].particle_count, 300);
    }
    assert!((1..12).contains(&resampled) && injected > 0, "{resampled} resamplings, {injected} injected");
    let best = paths.iter().reduce(|best, path| if path.0 > best.0 { path } else { best }).unwrap();
    let ancestry = filter.ancestry().unwrap();
    assert_eq!(ancestry.len(), 12);
    let trajectory = ancestry.most_likely_trajectory().unwrap();
    assert_eq!(trajectory.poses, best.1);
    assert_eq!(trajectory.first_step, 12 - best.1.len());
}

#[test]
fn a_global_start_is_uniform_over_free_space_and_headings() {
    let n = 100_000;
    let filter = filter(options(n), &Start::Global);
    let particles = filter.particles();
    // Mean of n uniform numbers: standard deviation of its width / sqrt(12 n); 4.9 of it for 1e-6.
    let mean = |values: &[f64]| values.iter().sum::<f64>() / n as f64;
    for (values, middle, width) in
        [(&particles.x, 3.0, 6.0), (&particles.y, 2.0, 4.0), (&particles.theta, 0.0, 2.0 * PI)]
    {
        assert!((mean(values) - middle).abs() < 4.9 * width / (12.0 * n as f64).sqrt());
        assert!(values.iter().all(|v| (v - middle).abs() <= width / 2.0));
        assert!(values.iter().any(|v| v - middle > 0.49 * width));
        assert!(values.iter().any(|v| v - middle < -0.49 * width));
    }
}

#[test]
fn a_map_without_free_space_has_no_global_start() {
    let nowhere = Room { width: -1.0, depth: 1.0 };
    let error = Filter::new(options(10), &Start::Global, &nowhere, 1).unwrap_err();
    assert_eq!(error.to_string(), "no free space found in the map in 100000 random points of its bounds");
}

#[test]
fn input_that_makes_no_sense_is_refused_and_leaves_the_filter_alone() {
    let mut filter = filter(options(10), &tracking(0.1));
    let before = filter.particles().clone();
    let (laser, short) = (laser(4), Scan { ranges: vec![1.0; 3] });
    let input = StepInput { odometry: Pose2::IDENTITY, laser: &laser, scan: &short };
    let error = filter.step(&input, &ROOM, &MODEL).unwrap_err();
    assert_eq!(error, FilterError::ScanLength { step: 0, ranges: 3, beams: 4 });
    let scan = Scan { ranges: vec![1.0; 4] };
    let odometry = Pose2 { x: f64::NAN, y: 0.0, theta: 0.0 };
    let error = filter.step(&StepInput { odometry, laser: &laser, scan: &scan }, &ROOM, &MODEL).unwrap_err();
    assert_eq!(error, FilterError::Odometry { step: 0 });
    assert_eq!(filter.particles(), &before);
}

#[test]
fn options_out_of_range_are_named() {
    let refused = |options, start: &Start| Filter::new(options, start, &ROOM, 1).unwrap_err().to_string();
    assert_eq!(refused(options(0), &Start::Global), "particle count must be from 1 to 2^32 - 2, got 0");
    let trigger = ResampleTrigger::EffectiveShareBelow(1.5);
    assert_eq!(
        refused(FilterOptions { trigger, ..options(1) }, &Start::Global),
        "effective share must be from 0 to 1, got 1.5"
    );
    let least_effective_share = Some(1.0);
    assert_eq!(
        refused(FilterOptions { least_effective_share, ..options(1) }, &Start::Global),
        "least effective share must be above 0 and below 1, got 1"
    );
    let regularization = Some(Spread { sigma_m: -1.0, sigma_rad: 0.0 });
    assert_eq!(
        refused(FilterOptions { regularization, ..options(1) }, &Start::Global),
        "regularization sigma_m must be finite and at least 0, got -1"
    );
    assert_eq!(
        refused(options(1), &tracking(f64::NAN)),
        "start sigma_m must be finite and at least 0, got NaN"
    );
}

/// A caller who predicts, updates and resamples by the same rule gets the particles of [`Filter::step`], bit for bit.
#[test]
fn the_parts_of_a_step_are_a_step() {
    let options = FilterOptions {
        trigger: ResampleTrigger::EffectiveShareBelow(0.5),
        injection: Some(InjectionOptions { alpha_slow: 0.05, alpha_fast: 0.5 }),
        ..options(500)
    };
    let mut whole = filter(options.clone(), &tracking(0.3));
    let mut parts = filter(options, &tracking(0.3));
    let laser = laser(12);
    let (mut truth, mut resampled) = (START, 0);
    for step in 0..20 {
        truth = truth.compose(&INCREMENT);
        let scan = scan(&ROOM, &laser, &MODEL, truth, step);
        let input = StepInput { odometry: INCREMENT, laser: &laser, scan: &scan };
        let outcome = whole.step(&input, &ROOM, &MODEL).unwrap();
        parts.predict(&INCREMENT).unwrap();
        let update = parts.update(&laser, &scan, &ROOM, &MODEL).unwrap();
        assert_eq!(whole.particles(), parts.particles(), "step {step}");
        assert_eq!(whole.weights().linear(), parts.weights().linear(), "step {step}");
        assert_eq!((outcome.log_evidence, outcome.estimates), (update.log_evidence, update.estimates));
        let wanted = parts.weights().effective_sample_size() < 0.5 * parts.particles().len() as f64;
        let injected = parts.resample(wanted, &ROOM).unwrap();
        assert_eq!(injected, outcome.resampled.then_some(outcome.injected));
        if injected.is_some() {
            resampled += 1;
            assert_eq!(parts.weights().effective_sample_size(), parts.particles().len() as f64);
        }
    }
    assert!((3..20).contains(&resampled), "{resampled} of 20 steps resampled");
}

#[test]
fn predictions_and_resamplings_without_a_scan_between_them_draw_anew() {
    let mut moved = filter(options(200), &tracking(0.0));
    moved.predict(&INCREMENT).unwrap();
    let first = moved.particles().get(0).relative_to(&START);
    let before = moved.particles().get(0);
    moved.predict(&INCREMENT).unwrap();
    let second = moved.particles().get(0).relative_to(&before);
    assert!(distance(&first, &second) > 1e-6, "{first:?} {second:?}");

    // From equal weights each particle has one copy, which the jitter alone moves.
    let jitter = Some(Spread { sigma_m: 0.1, sigma_rad: 0.1 });
    let mut resampled = filter(FilterOptions { regularization: jitter, ..options(200) }, &tracking(0.3));
    let poses = [(); 3].map(|()| {
        let before = resampled.particles().get(0);
        resampled.resample(true, &ROOM).unwrap();
        resampled.particles().get(0).x - before.x
    });
    assert!(poses[0] != poses[1] && poses[1] != poses[2], "{poses:?}");
}
