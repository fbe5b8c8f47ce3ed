//! The number of threads changes no bit of a result.

use locsim_core::{Laser, Particles, Pose2, Weights};
use locsim_mcl::{
    AnnealingOptions, Filter, FilterOptions, InjectionOptions, PoseBins, Spread, Start, StepInput,
    StepOutcome,
};

use crate::toy::{Gaussian, Room};
use crate::{laser, options, scan};

/// Everything that a filter computes over a few steps of every kind.
fn run(
    threads: usize,
    seed: u64,
    annealing: Option<AnnealingOptions>,
) -> (Vec<StepOutcome>, Particles, Weights, Vec<f64>) {
    let room = Room { width: 6.0, depth: 4.0 };
    let model = Gaussian { sigma_m: 0.2 };
    let laser: Laser = laser(12);
    let options = FilterOptions {
        injection: Some(InjectionOptions { alpha_slow: 0.1, alpha_fast: 0.9 }),
        regularization: Some(Spread { sigma_m: 0.01, sigma_rad: 0.01 }),
        clusters: Some(PoseBins::new(0.5, 0.2).unwrap()),
        ancestry: true,
        annealing,
        // Not a multiple of any chunk.
        ..options(10_007)
    };
    let odometry = Pose2::new(0.2, 0.0, 0.1);
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
        let mut filter = Filter::new(options, &Start::Global, &room, seed).unwrap();
        let mut truth = Pose2::new(1.0, 1.0, 0.0);
        let outcomes = (0..6)
            .map(|step| {
                // The robot is carried away at step 3, so that random particles are injected.
                truth = if step == 3 { Pose2::new(4.5, 2.5, 2.0) } else { truth.compose(&odometry) };
                let scan = scan(&room, &laser, &model, truth, step);
                filter.step(&StepInput { odometry, laser: &laser, scan: &scan }, &room, &model).unwrap()
            })
            .collect();
        let paths = filter.ancestry().unwrap().log_weights().to_vec();
        (outcomes, Particles::clone(filter.particles()), Weights::clone(filter.weights()), paths)
    })
}

#[test]
fn one_two_and_eight_threads_give_the_same_bits() {
    // The set counts as gathered from the second scan on, so that random particles may come.
    let annealed =
        AnnealingOptions { candidates: 20_011, moves: 2, gathered_m: 10.0, ..AnnealingOptions::default() };
    for annealing in [None, Some(annealed)] {
        let one = run(1, 7, annealing);
        assert!(one.0.iter().any(|outcome| outcome.injected > 0), "injection takes part in the comparison");
        assert_eq!(one.0[0].likelihood_power < 1.0, annealing.is_some(), "and so does annealing");
        assert_eq!(run(2, 7, annealing), one);
        assert_eq!(run(8, 7, annealing), one);
        assert_ne!(run(1, 8, annealing), one, "the seed does change them");
    }
}
