//! A warm filter step with a fixed number of particles allocates no memory, and a filter takes no more memory than
//! its particles need.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use locsim_core::{
    Beams, Draw, Laser, LikelihoodGrid, LikelihoodTable, ModelTable, Pose2, Scan, SensorModel,
};
use locsim_mcl::{
    Filter, FilterOptions, InjectionOptions, OdometryMotion, ParticleCount, PoseBins, ResampleTrigger,
    Spread, Start, StepInput, Systematic,
};
use toy::{Gaussian, Room};

mod toy;

/// The system's allocator, counting.
struct Counting;

static ALLOCATIONS: AtomicUsize = AtomicUsize::new(0);
static BYTES_IN_USE: AtomicUsize = AtomicUsize::new(0);
static MOST_BYTES_IN_USE: AtomicUsize = AtomicUsize::new(0);

fn count(more_bytes: usize) {
    ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
    let bytes = BYTES_IN_USE.fetch_add(more_bytes, Ordering::Relaxed) + more_bytes;
    MOST_BYTES_IN_USE.fetch_max(bytes, Ordering::Relaxed);
}

// Only an allocator of our own sees every allocation, and that trait is unsafe; each method hands its arguments
// to the system's allocator unchanged, so that its contract is kept.
#[allow(unsafe_code)]
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size());
        unsafe { System.alloc(layout) }
    }

    unsafe fn realloc(&self, ptr: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        // Both may exist for a moment.
        count(new_size);
        BYTES_IN_USE.fetch_sub(layout.size(), Ordering::Relaxed);
        unsafe { System.realloc(ptr, layout, new_size) }
    }

    unsafe fn dealloc(&self, ptr: *mut u8, layout: Layout) {
        BYTES_IN_USE.fetch_sub(layout.size(), Ordering::Relaxed);
        unsafe { System.dealloc(ptr, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

const GAUSSIAN: Gaussian = Gaussian { sigma_m: 0.5 };

/// The toy model as a table, coarse and flat: its values don't matter here.
struct Tabled(Gaussian, LikelihoodTable);

impl Tabled {
    fn new(inner: Gaussian) -> Self {
        let grid = LikelihoodGrid { max_range: 50.0, reach: 75.0, step_m: 0.5 };
        let log_density = vec![-1.0; grid.rows() * grid.states().0.len()];
        Self(inner, LikelihoodTable::new(grid, &log_density))
    }
}

impl SensorModel for Tabled {
    fn name(&self) -> &str {
        self.0.name()
    }

    fn log_density(&self, _z: &[f32], _beams: &Beams<'_>, _out: &mut [f32]) {
        unreachable!("a filter asks the table alone");
    }

    fn cdf(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]) {
        self.0.cdf(z, beams, out);
    }

    fn sample(&self, beams: &Beams<'_>, draw: &Draw, out: &mut [f32]) {
        self.0.sample(beams, draw, out);
    }

    fn table(&self) -> Option<ModelTable<'_>> {
        Some(ModelTable::State(&self.1))
    }
}

/// All options but those that change the number of particles; a history if `ancestry`.
fn options(particles: usize, ancestry: bool) -> FilterOptions {
    FilterOptions {
        particles: ParticleCount::Fixed(particles),
        motion: Arc::new(OdometryMotion::new([0.02; 4]).unwrap()),
        resampler: Arc::new(Systematic),
        trigger: ResampleTrigger::EachStep,
        injection: Some(InjectionOptions { alpha_slow: 0.01, alpha_fast: 0.5 }),
        regularization: Some(Spread { sigma_m: 0.01, sigma_rad: 0.01 }),
        update: None,
        least_effective_share: Some(0.2),
        // One bin: the number of occupied bins is not fixed, but here it is.
        clusters: Some(PoseBins::new(1000.0, 7.0).unwrap()),
        annealing: None,
        ancestry,
    }
}

/// Runs `steps` in a pool of two threads with a function that does a number of steps of a filter.
fn with_filter<R: Send>(
    particles: usize,
    ancestry: bool,
    model: &dyn SensorModel,
    run: impl FnOnce(&mut dyn FnMut(usize)) -> R + Send,
) -> R {
    let room = Room { width: 6.0, depth: 4.0 };
    let bearings = (0..12).map(|i| i as f32 * 0.5).collect();
    let laser = Laser::new(bearings, vec![0.0; 12], 0.0, 50.0, Pose2::IDENTITY).unwrap();
    let scan = Scan { ranges: vec![2.0; 12] };
    let options = options(particles, ancestry);
    let start =
        Start::Tracking { pose: Pose2::new(3.0, 2.0, 0.0), spread: Spread { sigma_m: 0.3, sigma_rad: 0.3 } };
    let input = StepInput { odometry: Pose2::new(0.01, 0.0, 0.1), laser: &laser, scan: &scan };
    rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap().install(|| {
        let mut filter = Filter::new(options, &start, &room, 1).unwrap();
        run(&mut |steps| {
            for _ in 0..steps {
                assert!(filter.step(&input, &room, model).unwrap().resampled);
            }
        })
    })
}

/// Allocations of 20 steps after 10 to warm up.
fn allocations(ancestry: bool, model: &dyn SensorModel) -> usize {
    with_filter(2000, ancestry, model, |step| {
        step(10);
        let before = ALLOCATIONS.load(Ordering::Relaxed);
        step(20);
        ALLOCATIONS.load(Ordering::Relaxed) - before
    })
}

/// The most bytes that were in use at once while a filter was made and did three steps, more than before.
fn most_bytes(particles: usize, ancestry: bool) -> usize {
    let before = BYTES_IN_USE.load(Ordering::Relaxed);
    MOST_BYTES_IN_USE.store(before, Ordering::Relaxed);
    with_filter(particles, ancestry, &GAUSSIAN, |step| step(3));
    MOST_BYTES_IN_USE.load(Ordering::Relaxed) - before
}

/// The most bytes in use as above, of a filter that first resamples when it injects random particles.
fn most_bytes_of_injection(particles: usize) -> usize {
    let room = Room { width: 6.0, depth: 4.0 };
    let bearings = (0..12).map(|i| i as f32 * 0.5).collect();
    let laser = Laser::new(bearings, vec![0.0; 12], 0.0, 50.0, Pose2::IDENTITY).unwrap();
    let options = FilterOptions {
        trigger: ResampleTrigger::EffectiveShareBelow(0.0),
        // A fifth of the set is random.
        injection: Some(InjectionOptions { alpha_slow: 0.01, alpha_fast: 0.2 }),
        ..options(particles, false)
    };
    let start =
        Start::Tracking { pose: Pose2::new(3.0, 2.0, 0.0), spread: Spread { sigma_m: 0.3, sigma_rad: 0.3 } };
    rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap().install(|| {
        let before = BYTES_IN_USE.load(Ordering::Relaxed);
        MOST_BYTES_IN_USE.store(before, Ordering::Relaxed);
        let mut filter = Filter::new(options, &start, &room, 1).unwrap();
        let mut step = |range: f32| {
            let scan = Scan { ranges: vec![range; 12] };
            let input = StepInput { odometry: Pose2::IDENTITY, laser: &laser, scan: &scan };
            filter.step(&input, &room, &GAUSSIAN).unwrap()
        };
        assert!(!step(2.0).resampled);
        let injected = step(20.0).injected;
        assert!((particles / 6..particles / 4).contains(&injected), "{injected}");
        MOST_BYTES_IN_USE.load(Ordering::Relaxed) - before
    })
}

/// One test, so that no other thread allocates meanwhile; the history is the negative control.
#[test]
fn a_warm_step_allocates_nothing_and_a_particle_takes_100_bytes_unless_it_has_a_history() {
    assert_eq!(allocations(false, &GAUSSIAN), 0);
    assert_eq!(allocations(false, &Tabled::new(GAUSSIAN)), 0);
    assert!(allocations(true, &GAUSSIAN) >= 20);
    // Two sets of poses, logs and weights, likelihoods, ancestors, and the clusters' bins and weights: 76 + 12.
    let (few, many) = (50_000, 100_000);
    let per_particle = |ancestry| (most_bytes(many, ancestry) - most_bytes(few, ancestry)) / (many - few);
    let without = per_particle(false);
    assert!((76..=100).contains(&without), "{without} bytes");
    let injecting = (most_bytes_of_injection(many) - most_bytes_of_injection(few)) / (many - few);
    assert!((76..=100).contains(&injecting), "{injecting} bytes where random particles are injected");
    let with = per_particle(true);
    assert!(with > 150, "{with} bytes");
}
