use std::sync::{Mutex, PoisonError};

use locsim_core::{Hits, Laser, Particles, Poses, RangeMap, Scan, SensorModel};
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
        self.prepare(laser.beam_count());
        // Each lane takes the next run when it has done one. Which lane takes which run is a matter of chance,
        // but no run's result depends on it.
        let runs = Mutex::new(out.chunks_mut(CHUNK).enumerate());
        self.lanes.par_iter_mut().with_max_len(1).for_each(|lane| {
            loop {
                let run = runs.lock().unwrap_or_else(PoisonError::into_inner).next();
                let Some((i, out)) = run else { return };
                let base = base.slice(i * CHUNK, i * CHUNK + out.len());
                lane.log_likelihoods(base, laser, scan, map, model, out);
            }
        });
    }

    /// One lane for each thread, each with room for a whole run.
    fn prepare(&mut self, beams: usize) {
        let threads = rayon::current_num_threads();
        if self.lanes.len() < threads {
            self.lanes.resize_with(threads, Lane::default);
        }
        for lane in &mut self.lanes {
            if lane.log_density.capacity() < CHUNK * beams {
                lane.laser.resize(CHUNK);
                lane.hits.resize(CHUNK * beams);
                lane.log_density.resize(CHUNK * beams, 0.0);
            }
        }
    }
}

impl Lane {
    fn log_likelihoods(
        &mut self,
        base: Poses<'_>,
        laser: &Laser,
        scan: &Scan,
        map: &dyn RangeMap,
        model: &dyn SensorModel,
        out: &mut [f64],
    ) {
        let mount = laser.base_from_laser();
        self.laser.resize(base.len());
        for i in 0..base.len() {
            self.laser.set(i, base.get(i).compose(&mount));
        }
        map.cast(self.laser.view(), laser.bearings(), laser.cast_range(), &mut self.hits);
        let beams = self.hits.beams(self.laser.view(), laser.bearings(), laser.max_range());
        model.log_likelihood(&scan.ranges, &beams, &mut self.log_density, out);
    }
}
