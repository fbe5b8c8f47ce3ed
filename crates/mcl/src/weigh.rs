use std::sync::{Mutex, PoisonError};

use locsim_core::{
    DependsOn, EndpointScan, Hits, Laser, ModelTable, Particles, Pose2, Poses, PreparedScan, RangeMap, Scan,
    SensorModel,
};
use rayon::prelude::*;

/// Particles are cast and weighted by runs of this many: small enough to balance a thousand particles over a few
/// threads and to keep a run's beams in the cache.
const CHUNK: usize = 128;

/// The buffers of one thread at work.
#[derive(Clone, Debug, Default)]
struct Lane {
    laser: Particles,
    hits: Hits,
    log_density: Vec<f32>,
}

/// Computes the log likelihood of a scan for every particle, in parallel; its buffers live on between steps.
#[derive(Clone, Debug, Default)]
pub(crate) struct Weigher {
    lanes: Vec<Lane>,
    states: PreparedScan,
    endpoints: EndpointScan,
}

impl Weigher {
    /// Fills `out` with ln p(scan | particle), one per particle of `base`.
    pub(crate) fn log_likelihoods(
        &mut self,
        base: Poses<'_>,
        laser: &Laser,
        scan: &Scan,
        map: &dyn RangeMap,
        model: &dyn SensorModel,
        out: &mut [f64],
    ) {
        let run = if model.needs_all_particles() { out.len().max(1) } else { CHUNK };
        self.make_room(run, laser.beam_count());
        let table = model.table();
        let is_cast = model.depends_on() != DependsOn::Endpoint;
        match table {
            Some(ModelTable::State(table)) => self.states.prepare(laser.bearings(), &scan.ranges, table),
            Some(ModelTable::Endpoint(table)) => {
                self.endpoints.prepare(laser.bearings(), &scan.ranges, table);
            }
            None => {}
        }
        let (states, endpoints) = (&self.states, &self.endpoints);
        // Each lane takes the next run when it has done one. Which lane takes which run is a matter of chance,
        // but no run's result depends on it.
        let runs = Mutex::new(out.chunks_mut(run).enumerate());
        self.lanes.par_iter_mut().with_max_len(1).for_each(|lane| {
            loop {
                let next = runs.lock().unwrap_or_else(PoisonError::into_inner).next();
                let Some((i, out)) = next else { return };
                let base = base.slice(i * run, i * run + out.len());
                let Lane { laser: poses, hits, log_density } = lane;
                let poses = laser_poses(base, laser.base_from_laser(), poses);
                match table {
                    Some(ModelTable::State(table)) => map.log_likelihood(poses, states, table, hits, out),
                    Some(ModelTable::Endpoint(table)) => table.log_likelihood(poses, endpoints, out),
                    None => {
                        if is_cast {
                            map.cast(poses, laser.bearings(), laser.cast_range(), hits);
                        } else {
                            hits.resize(poses.len() * laser.beam_count());
                        }
                        let beams = hits.beams(poses, laser.bearings(), laser.max_range());
                        model.log_likelihood(&scan.ranges, &beams, log_density, out);
                    }
                }
            }
        });
    }

    /// One lane for each thread, each with room for a whole run of so many particles.
    fn make_room(&mut self, run: usize, beams: usize) {
        let threads = rayon::current_num_threads();
        if self.lanes.len() < threads {
            self.lanes.resize_with(threads, Lane::default);
        }
        for lane in &mut self.lanes {
            if lane.log_density.capacity() < run * beams {
                lane.laser.resize(run);
                lane.hits.resize(run * beams);
                lane.log_density.resize(run * beams, 0.0);
            }
        }
    }
}

/// Where the laser is on each robot of `base`; `room` keeps the poses if they are others.
fn laser_poses<'a>(base: Poses<'a>, mount: Pose2, room: &'a mut Particles) -> Poses<'a> {
    if mount == Pose2::IDENTITY {
        return base;
    }
    room.resize(base.len());
    for i in 0..base.len() {
        room.set(i, base.get(i).compose(&mount));
    }
    room.as_poses()
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use locsim_core::{Beams, Draw};

    use super::*;

    /// Free space without end.
    struct Nothing;

    impl RangeMap for Nothing {
        fn cast(&self, laser: Poses<'_>, bearings: &[f32], max_range: f32, out: &mut Hits) {
            out.resize(laser.len() * bearings.len());
            out.range.fill(max_range);
        }

        fn is_free(&self, _x: f64, _y: f64) -> bool {
            true
        }

        fn bounds(&self) -> [f64; 4] {
            [0.0, 0.0, 1.0, 1.0]
        }
    }

    /// A model that counts how often it is asked, and answers how many particles it sees.
    struct Census {
        needs_all: bool,
        calls: AtomicUsize,
    }

    impl SensorModel for Census {
        fn name(&self) -> &'static str {
            "census"
        }

        fn log_density(&self, _z: &[f32], _beams: &Beams<'_>, _out: &mut [f32]) {}

        fn cdf(&self, _z: &[f32], _beams: &Beams<'_>, _out: &mut [f32]) {}

        fn sample(&self, _beams: &Beams<'_>, _draw: &Draw, _out: &mut [f32]) {}

        fn needs_all_particles(&self) -> bool {
            self.needs_all
        }

        fn log_likelihood(&self, _z: &[f32], beams: &Beams<'_>, _scratch: &mut Vec<f32>, out: &mut [f64]) {
            self.calls.fetch_add(1, Ordering::Relaxed);
            out.fill(beams.poses() as f64);
        }
    }

    #[test]
    fn a_model_that_needs_all_particles_gets_them_at_once() {
        let laser = Laser::new(vec![0.0; 3], vec![0.0; 3], 0.0, 5.0, Pose2::IDENTITY).unwrap();
        let scan = Scan { ranges: vec![1.0; 3] };
        let particles = Particles::zeros(3 * CHUNK + 7);
        let mut weigher = Weigher::default();
        for (needs_all, calls) in [(true, 1), (false, 4), (true, 1)] {
            let census = Census { needs_all, calls: AtomicUsize::new(0) };
            let mut out = vec![0.0; particles.len()];
            weigher.log_likelihoods(particles.as_poses(), &laser, &scan, &Nothing, &census, &mut out);
            assert_eq!(census.calls.into_inner(), calls);
            let seen = if needs_all { particles.len() } else { CHUNK };
            assert_eq!(out[0], seen as f64);
        }
    }
}
