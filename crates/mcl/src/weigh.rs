use std::sync::{Mutex, PoisonError};

use locsim_core::{
    EndpointScan, Hits, Laser, ModelTable, Particles, Pose2, Poses, PreparedScan, RangeMap, Scan, SensorModel,
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
        self.make_room(laser.beam_count());
        let table = model.table();
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
        let runs = Mutex::new(out.chunks_mut(CHUNK).enumerate());
        self.lanes.par_iter_mut().with_max_len(1).for_each(|lane| {
            loop {
                let run = runs.lock().unwrap_or_else(PoisonError::into_inner).next();
                let Some((i, out)) = run else { return };
                let base = base.slice(i * CHUNK, i * CHUNK + out.len());
                let Lane { laser: poses, hits, log_density } = lane;
                let poses = laser_poses(base, laser.base_from_laser(), poses);
                match table {
                    Some(ModelTable::State(table)) => map.log_likelihood(poses, states, table, hits, out),
                    Some(ModelTable::Endpoint(table)) => table.log_likelihood(poses, endpoints, out),
                    None => {
                        map.cast(poses, laser.bearings(), laser.cast_range(), hits);
                        let beams = hits.beams(poses, laser.bearings(), laser.max_range());
                        model.log_likelihood(&scan.ranges, &beams, log_density, out);
                    }
                }
            }
        });
    }

    /// One lane for each thread, each with room for a whole run.
    fn make_room(&mut self, beams: usize) {
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
