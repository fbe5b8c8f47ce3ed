//! Scans that are annealed while the robot may be anywhere.

use locsim_core::{Hits, Particles, Pose2, Poses, RangeMap, Scan, wrap_angle};
use locsim_mcl::{
    AnnealingOptions, Filter, FilterOptions, KldOptions, ParticleCount, Spread, Start, StepInput,
};

use super::toy::{Gaussian, Room};
use super::{laser, options, scan};

const ROOM: Room = Room { width: 10.0, depth: 6.0 };
/// A share that any set has: scans are taken in whole.
const WHOLE: Option<f64> = Some(1e-6);
const MODEL: Gaussian = Gaussian { sigma_m: 0.02 };

/// The weight near the true pose and near its mirror image in the rectangular room, after one scan.
fn weight_of_both_places(annealing: Option<AnnealingOptions>, seed: u64) -> [f64; 2] {
    let (truth, mirrored) = (Pose2::new(3.0, 2.0, 0.7), Pose2::new(7.0, 4.0, 0.7 - std::f64::consts::PI));
    let laser = laser(30);
    let options = FilterOptions { annealing, least_effective_share: WHOLE, ..options(2000) };
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

/// A robot that was taken to another corner is found again after a restart, and isn't without one. No trajectory leads through it.
#[test]
fn a_filter_that_starts_again_finds_the_robot_elsewhere() {
    let laser = laser(30);
    // The second room is wider.
    let rooms = Rooms { count: 2, wider_m: 3.0 };
    let annealing = Some(AnnealingOptions { candidates: 8000, ..AnnealingOptions::default() });
    let options = FilterOptions { annealing, ancestry: true, ..options(1000) };
    let error = |restarts: bool| {
        let here = Pose2::new(3.0, 2.0, 0.7);
        let start = Start::Tracking { pose: here, spread: Spread { sigma_m: 0.05, sigma_rad: 0.02 } };
        let mut filter = Filter::new(options.clone(), &start, &rooms, 3).unwrap();
        let step = |filter: &mut Filter, truth: Pose2, number: u32| {
            let scan = scan(&rooms, &laser, &MODEL, truth, number);
            let input = StepInput { odometry: Pose2::IDENTITY, laser: &laser, scan: &scan };
            filter.step(&input, &rooms, &MODEL).unwrap()
        };
        (0..3).for_each(|number| {
            step(&mut filter, here, number);
        });
        let there = Pose2::new(APART + 9.0, 4.5, -1.0);
        if restarts {
            filter.restart(&rooms).unwrap();
            assert!(filter.ancestors().unwrap().iter().all(|&parent| parent == locsim_mcl::NO_PARENT));
        }
        // An annealed scan is taken in by a small power, any other whole.
        let first = step(&mut filter, there, 3);
        assert_eq!(first.likelihood_power < 1.0, restarts, "{}", first.likelihood_power);
        let last = (4..6).map(|number| step(&mut filter, there, number)).last().unwrap();
        let last = last.estimates.weighted_mean.pose;
        let first_step = filter.ancestry().unwrap().most_likely_trajectory().unwrap().first_step;
        (last.position().distance(there.position()), first_step)
    };
    // The room is the same by half a turn: by one place or the other, or between them.
    let (with, first_step) = error(true);
    assert!(with < 8.0 && first_step == 3, "{with} {first_step}");
    assert!(error(false).0 > 12.0);
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

/// Rooms in a row, each as much wider than the one before, with nothing between them.
struct Rooms {
    count: u8,
    wider_m: f64,
}

/// From a room to the next (m).
const APART: f64 = 20.0;

impl Rooms {
    /// The room about a place, and where it begins.
    fn room_at(&self, x: f64) -> (Room, f64) {
        let number = (x / APART).floor().clamp(0.0, f64::from(self.count - 1));
        (Room { width: ROOM.width + self.wider_m * number, depth: ROOM.depth }, APART * number)
    }
}

impl RangeMap for Rooms {
    fn cast(&self, laser: Poses<'_>, bearings: &[f32], max_range: f32, out: &mut Hits) {
        out.resize(laser.len() * bearings.len());
        let mut hits = Hits::default();
        for i in 0..laser.len() {
            let (room, begin) = self.room_at(laser.x[i]);
            let pose = Particles::from_iter([Pose2 { x: laser.x[i] - begin, ..laser.get(i) }]);
            room.cast(pose.as_poses(), bearings, max_range, &mut hits);
            let beams = i * bearings.len()..(i + 1) * bearings.len();
            out.range[beams.clone()].copy_from_slice(&hits.range);
            out.incidence[beams.clone()].copy_from_slice(&hits.incidence);
            out.surface[beams].copy_from_slice(&hits.surface);
        }
    }

    fn is_free(&self, x: f64, y: f64) -> bool {
        let (room, begin) = self.room_at(x);
        room.is_free(x - begin, y)
    }

    fn bounds(&self) -> [f64; 4] {
        [0.0, 0.0, APART * f64::from(self.count), ROOM.depth]
    }
}

/// Ten rooms explain a scan equally well at two places each. The filter's 60 particles are three for each of them, and chance alone
/// would empty some. It has more until they have gathered.
#[test]
fn a_set_that_is_spread_has_enough_particles_for_every_place() {
    let rooms = Rooms { count: 10, wider_m: 0.0 };
    let (truth, laser) = (Pose2::new(3.0, 2.0, 0.7), laser(30));
    let annealing = Some(AnnealingOptions { candidates: 20_000, ..AnnealingOptions::default() });
    let options = FilterOptions { annealing, ..options(60) };
    let mut filter = Filter::new(options, &Start::Global, &rooms, 1).unwrap();
    let scan = scan(&ROOM, &laser, &MODEL, truth, 0);
    let input = StepInput { odometry: Pose2::IDENTITY, laser: &laser, scan: &scan };
    filter.step(&input, &rooms, &MODEL).unwrap();
    for room in 0..10 {
        let first = f64::from(room) * APART;
        let particles = filter.particles().iter().zip(filter.weights().linear());
        let weight: f64 = particles
            .filter(|(pose, _)| (0.0..=ROOM.width).contains(&(pose.x - first)))
            .map(|(_, w)| w)
            .sum();
        assert!((0.02..0.3).contains(&weight), "room {room} has {weight}");
    }
}

/// The first scan is as the wider of two rooms would give it, the others come from the other room. A scan that is taken in whole
/// leaves no doubt, and nothing comes back from the wrong room. One that has to leave particles effective, as without the option,
/// leaves doubt.
#[test]
fn a_first_scan_that_misleads_is_corrected_where_scans_leave_particles_effective() {
    let rooms = Rooms { count: 2, wider_m: 0.3 };
    let (wider, _) = rooms.room_at(APART);
    let laser = laser(30);
    let weight_of_right_room = |least_effective_share| {
        let annealing = Some(AnnealingOptions { candidates: 5000, ..AnnealingOptions::default() });
        let options = FilterOptions { annealing, least_effective_share, ..options(300) };
        let mut filter = Filter::new(options, &Start::Global, &rooms, 1).unwrap();
        for step in 0..5 {
            let room = if step == 0 { &wider } else { &ROOM };
            let scan = scan(room, &laser, &MODEL, Pose2::new(3.0, 2.0, 0.7), step);
            let input = StepInput { odometry: Pose2::IDENTITY, laser: &laser, scan: &scan };
            let outcome = filter.step(&input, &rooms, &MODEL).unwrap();
            assert!(step > 0 || (outcome.likelihood_power < 0.1) == least_effective_share.is_none());
        }
        let particles = filter.particles().iter().zip(filter.weights().linear());
        let weight: f64 = particles.filter(|(pose, _)| pose.x < APART).map(|(_, weight)| weight).sum();
        weight
    };
    assert!(weight_of_right_room(WHOLE) < 0.01, "the control is as good");
    let weight = weight_of_right_room(None);
    assert!(weight > 0.99, "{weight}");
}

/// A scan that tells nothing leaves what is known, but for the width of the density that a particle stands for: 0.1 m and 0.05 rad.
/// The set begins larger than its spread asks for, so that it is resampled and moved.
#[test]
fn moves_keep_what_is_known_from_before() {
    let laser = laser(4);
    let particles = ParticleCount::Kld(KldOptions {
        min: 2000,
        max: 5000,
        error: 0.05,
        quantile: 0.99,
        bin_m: 1.0,
        bin_rad: 1.0,
    });
    let options = FilterOptions { particles, annealing: Some(AnnealingOptions::default()), ..options(1) };
    let start = Start::Tracking {
        pose: Pose2::new(3.0, 2.0, 0.7),
        spread: Spread { sigma_m: 0.05, sigma_rad: 0.02 },
    };
    let mut filter = Filter::new(options, &start, &ROOM, 1).unwrap();
    // Any reading is as likely as any other.
    let flat = Gaussian { sigma_m: 1e6 };
    let scan = Scan { ranges: vec![1.0; 4] };
    let input = StepInput { odometry: Pose2::IDENTITY, laser: &laser, scan: &scan };
    let covariance = filter.step(&input, &ROOM, &flat).unwrap().estimates.weighted_mean.covariance;
    let [x, y, theta] = [0, 1, 2].map(|i| covariance[i][i].sqrt());
    // A deviation of 2,000 particles is known to 1.6 % (one standard deviation).
    for (deviation, expected) in
        [(x, 0.05_f64.hypot(0.1)), (y, 0.05_f64.hypot(0.1)), (theta, 0.02_f64.hypot(0.05))]
    {
        assert!((deviation / expected - 1.0).abs() < 0.06, "{deviation}, expected {expected}");
    }
}

/// A scan without a usable reading leaves a start anywhere as it is, candidate for candidate, with and without a least motion.
#[test]
fn a_blind_scan_uses_up_no_candidates() {
    let laser = laser(4);
    let annealing = Some(AnnealingOptions { candidates: 5000, ..AnnealingOptions::default() });
    let mut filter =
        Filter::new(FilterOptions { annealing, ..options(100) }, &Start::Global, &ROOM, 1).unwrap();
    let before = filter.particles().len();
    let blind = Scan { ranges: vec![f32::NAN; 4] };
    let input = StepInput { odometry: Pose2::IDENTITY, laser: &laser, scan: &blind };
    let outcome = filter.step(&input, &ROOM, &MODEL).unwrap();
    assert_eq!((outcome.likelihood_power, outcome.log_evidence, outcome.resampled), (0.0, 0.0, false));
    assert_eq!((before, filter.particles().len()), (5000, 5000));
    // The parts of a step, as Python calls them, likewise.
    filter.predict(&Pose2::IDENTITY).unwrap();
    filter.update(&laser, &blind, &ROOM, &MODEL).unwrap();
    assert_eq!(filter.particles().len(), 5000);
}

/// In a room whose second half is longer the robot gathers, and then the number of particles is the filter's own.
#[test]
fn a_set_that_has_gathered_has_the_number_of_the_options() {
    let laser = laser(30);
    let annealing = Some(AnnealingOptions { candidates: 5000, ..AnnealingOptions::default() });
    let options = FilterOptions { annealing, ..options(100) };
    let start =
        Start::Tracking { pose: Pose2::new(3.0, 2.0, 0.7), spread: Spread { sigma_m: 0.8, sigma_rad: 0.3 } };
    let mut filter = Filter::new(options, &start, &ROOM, 1).unwrap();
    let mut counts = Vec::new();
    for step in 0..4 {
        let scan = scan(&ROOM, &laser, &MODEL, Pose2::new(3.0, 2.0, 0.7), step);
        let input = StepInput { odometry: Pose2::IDENTITY, laser: &laser, scan: &scan };
        counts.push(filter.step(&input, &ROOM, &MODEL).unwrap().particle_count);
    }
    assert_eq!(counts[2..], [100, 100], "{counts:?}");
}

/// Few particles, and a likelihood so wide that few powers take it in: the moves have to be as wide to find its peaks.
#[test]
fn particles_climb_to_wide_peaks() {
    let (truth, mirrored) = (Pose2::new(3.0, 2.0, 0.7), Pose2::new(7.0, 4.0, 0.7 - std::f64::consts::PI));
    let (laser, wide) = (laser(30), Gaussian { sigma_m: 0.5 });
    let mean_distance = |seed| {
        let annealing = Some(AnnealingOptions { candidates: 200, ..AnnealingOptions::default() });
        let options = FilterOptions { annealing, least_effective_share: WHOLE, ..options(200) };
        let mut filter = Filter::new(options, &Start::Global, &ROOM, seed).unwrap();
        let scan = scan(&ROOM, &laser, &MODEL, truth, 0);
        let input = StepInput { odometry: Pose2::IDENTITY, laser: &laser, scan: &scan };
        filter.step(&input, &ROOM, &wide).unwrap();
        let distance = |pose: Pose2| {
            let [here, there] = [truth, mirrored].map(|place| pose.position().distance(place.position()));
            here.min(there)
        };
        let particles = filter.particles().iter().zip(filter.weights().linear());
        particles.map(|(pose, weight)| weight * distance(pose)).sum::<f64>()
    };
    for seed in 0..8 {
        let distance = mean_distance(seed);
        assert!(distance < 0.25, "seed {seed}: {distance}");
    }
}
