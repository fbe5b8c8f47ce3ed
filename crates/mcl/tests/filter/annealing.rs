//! Scans that are annealed while the robot may be anywhere.

use locsim_core::{Pose2, wrap_angle};
use locsim_mcl::{AnnealingOptions, Filter, FilterOptions, Spread, Start, StepInput};

use super::toy::{Gaussian, Room};
use super::{laser, options, scan};

const ROOM: Room = Room { width: 10.0, depth: 6.0 };
const MODEL: Gaussian = Gaussian { sigma_m: 0.02 };

/// The weight near the true pose and near its mirror image in the rectangular room, after one scan.
fn weight_of_both_places(annealing: Option<AnnealingOptions>, seed: u64) -> [f64; 2] {
    let (truth, mirrored) = (Pose2::new(3.0, 2.0, 0.7), Pose2::new(7.0, 4.0, 0.7 - std::f64::consts::PI));
    let laser = laser(30);
    let options = FilterOptions { annealing, ..options(2000) };
    let mut filter = Filter::new(options, &Start::Global, &ROOM, seed).unwrap();
    let scan = scan(&ROOM, &laser, &MODEL, truth, 0);
    let input = StepInput { odometry: Pose2::IDENTITY, laser: &laser, scan: &scan };
    let outcome = filter.step(&input, &ROOM, &MODEL).unwrap();
    assert_eq!(outcome.particle_count, 2000);
    assert!(outcome.log_evidence.is_finite());
    [truth, mirrored].map(|place| {
        let near = |pose: Pose2| {
            pose.position().distance(place.position()) < 0.1
                && wrap_angle(pose.theta - place.theta).abs() < 0.05
        };
        let particles = filter.particles().iter().zip(filter.weights().linear());
        particles.filter(|(pose, _)| near(*pose)).map(|(_, weight)| weight).sum()
    })
}

/// Both places explain the scan equally well, and all of the set is to end near them, about half near each. Without annealing
/// the one place wins that a particle happened to be closer to.
#[test]
fn places_that_look_alike_are_both_kept() {
    let annealing = Some(AnnealingOptions { candidates: 5000, ..AnnealingOptions::default() });
    for seed in 0..8 {
        let [here, there] = weight_of_both_places(annealing, seed);
        assert!(here + there > 0.95, "seed {seed}: {here} and {there}");
        assert!(here.min(there) > 0.15, "seed {seed}: {here} and {there}");
    }
    let balanced = |seed| {
        let [here, there] = weight_of_both_places(None, seed);
        here.min(there) > 0.15
    };
    assert!((0..8).filter(|&seed| balanced(seed)).count() <= 2, "the control is as good without annealing");
}

#[test]
fn annealing_keeps_the_history_whole() {
    let laser = laser(30);
    let annealing = Some(AnnealingOptions { candidates: 3000, ..AnnealingOptions::default() });
    let options = FilterOptions { annealing, ancestry: true, ..options(1000) };
    let mut filter = Filter::new(options, &Start::Global, &ROOM, 1).unwrap();
    let mut truth = Pose2::new(3.0, 2.0, 0.7);
    for step in 0..5 {
        let odometry = if step == 0 { Pose2::IDENTITY } else { Pose2::new(0.1, 0.0, 0.1) };
        truth = truth.compose(&odometry);
        let scan = scan(&ROOM, &laser, &MODEL, truth, step);
        filter.step(&StepInput { odometry, laser: &laser, scan: &scan }, &ROOM, &MODEL).unwrap();
    }
    let trajectory = filter.ancestry().unwrap().most_likely_trajectory().unwrap();
    assert_eq!((trajectory.first_step, trajectory.poses.len()), (0, 5));
    for pair in trajectory.poses.windows(2) {
        let moved = pair[0].position().distance(pair[1].position());
        assert!((0.02..0.3).contains(&moved), "a path without jumps, not {moved} m");
    }
}

#[test]
fn annealing_options_are_checked() {
    for annealing in [
        AnnealingOptions { effective_share: 1.0, ..AnnealingOptions::default() },
        AnnealingOptions { step: Spread { sigma_m: -1.0, sigma_rad: 0.0 }, ..AnnealingOptions::default() },
        AnnealingOptions { gathered_m: f64::NAN, ..AnnealingOptions::default() },
    ] {
        let options = FilterOptions { annealing: Some(annealing), ..options(10) };
        assert!(Filter::new(options, &Start::Global, &ROOM, 1).is_err(), "{annealing:?}");
    }
}
