//! A warm filter step with a fixed number of particles allocates no memory.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use locsim_core::{Laser, Pose2, Scan};
use locsim_mcl::{
    Filter, FilterOptions, InjectionOptions, OdometryMotion, ParticleCount, PoseBins, Regularization,
    ResampleTrigger, Start, StepInput, Systematic,
};
use toy::{Gaussian, Room};

mod toy;

/// The system's allocator, counting.
struct Counting;

static ALLOCATIONS: AtomicUsize = AtomicUsize::new(0);

// Only an allocator of our own sees every allocation, and that trait is unsafe; each method hands its arguments
// to the system's allocator unchanged, so that its contract is kept.
#[allow(unsafe_code)]
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        unsafe { System.alloc(layout) }
    }

    unsafe fn realloc(&self, ptr: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        unsafe { System.realloc(ptr, layout, new_size) }
    }

    unsafe fn dealloc(&self, ptr: *mut u8, layout: Layout) {
        unsafe { System.dealloc(ptr, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Allocations of 20 steps after 10 to warm up, in a pool of two threads. All options are on but those that
/// change the number of particles or keep a history.
fn allocations(ancestry: bool) -> usize {
    let room = Room { width: 6.0, depth: 4.0 };
    let bearings = (0..12).map(|i| i as f32 * 0.5).collect();
    let laser = Laser::new(bearings, vec![0.0; 12], 0.0, 50.0, Pose2::IDENTITY).unwrap();
    let scan = Scan { ranges: vec![2.0; 12] };
    let options = FilterOptions {
        particles: ParticleCount::Fixed(2000),
        motion: Arc::new(OdometryMotion::new([0.02; 4]).unwrap()),
        resampler: Arc::new(Systematic),
        trigger: ResampleTrigger::EachStep,
        injection: Some(InjectionOptions { alpha_slow: 0.01, alpha_fast: 0.5 }),
        regularization: Some(Regularization { sigma_m: 0.01, sigma_rad: 0.01 }),
        // One bin: the number of occupied bins is not fixed, but here it is.
        clusters: Some(PoseBins::new(1000.0, 7.0).unwrap()),
        ancestry,
    };
    let start = Start::Tracking { pose: Pose2::new(3.0, 2.0, 0.0), sigma_m: 0.3, sigma_rad: 0.3 };
    let input = StepInput { odometry: Pose2::new(0.01, 0.0, 0.1), laser: &laser, scan: &scan };
    let model = Gaussian { sigma_m: 0.5 };
    rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap().install(|| {
        let mut filter = Filter::new(options, &start, &room, 1).unwrap();
        let mut steps = |n: usize| {
            for _ in 0..n {
                assert!(filter.step(&input, &room, &model).unwrap().resampled);
            }
        };
        steps(10);
        let before = ALLOCATIONS.load(Ordering::Relaxed);
        steps(20);
        ALLOCATIONS.load(Ordering::Relaxed) - before
    })
}

/// One test, so that no other thread allocates meanwhile; the history is the negative control.
#[test]
fn a_warm_step_allocates_nothing_unless_it_keeps_a_history() {
    assert_eq!(allocations(false), 0);
    assert!(allocations(true) >= 20);
}
