use glam::DVec2;
use locsim_core::{Hits, NO_SURFACE, Poses, wrap_angle};
use rayon::prelude::*;

use super::RayHit;

/// Poses per unit of parallel work.
const POSES_PER_CHUNK: usize = 64;
/// Beam directions are kept for this many beams at a time, on the stack.
const BEAMS_PER_BLOCK: usize = 64;
/// Fewer rays than this are cast on the calling thread.
const PARALLEL_RAYS: usize = 4096;

/// Casts every beam of every pose.
///
/// `from(origin)` prepares a pose and returns its caster, which takes a beam's unit direction in the map
/// frame and its heading in (-2 pi, 2 pi] \[rad\].
pub(super) fn cast_batch<From, Cast>(
    laser: Poses<'_>,
    bearings: &[f32],
    max_range: f32,
    out: &mut Hits,
    from: From,
) where
    From: Fn(DVec2) -> Cast + Sync,
    Cast: Fn(DVec2, f64) -> Option<RayHit>,
{
    let beams = bearings.len();
    out.resize(laser.len() * beams);
    if out.is_empty() {
        return;
    }
    for_each_chunk(out, beams, |first, range, incidence, surface| {
        let mut prepared = [(DVec2::X, 0.0); BEAMS_PER_BLOCK];
        for block in (0..beams).step_by(BEAMS_PER_BLOCK) {
            let bearings = &bearings[block..beams.min(block + BEAMS_PER_BLOCK)];
            for (beam, &bearing) in prepared.iter_mut().zip(bearings) {
                let bearing = f64::from(bearing);
                *beam = (DVec2::from_angle(bearing), wrap_angle(bearing));
            }
            for i in 0..range.len() / beams {
                let pose = first + i;
                let origin = DVec2::new(laser.x[pose], laser.y[pose]);
                let (theta, rotation) = (wrap_angle(laser.theta[pose]), DVec2::from_angle(laser.theta[pose]));
                let cast = from(origin);
                let here = i * beams + block..i * beams + block + bearings.len();
                let (range, incidence) = (&mut range[here.clone()], &mut incidence[here.clone()]);
                let outputs = range.iter_mut().zip(incidence).zip(&mut surface[here]);
                for (&(direction, bearing), ((range, incidence), surface)) in prepared.iter().zip(outputs) {
                    (*range, *incidence, *surface) = match cast(rotation.rotate(direction), theta + bearing) {
                        // Rounding to f32 may reach the maximum, which means "no return".
                        Some(hit) if (hit.range as f32) < max_range => {
                            (hit.range as f32, hit.incidence as f32, hit.surface)
                        }
                        _ => (max_range, 0.0, NO_SURFACE),
                    };
                }
            }
        }
    });
}

/// Calls `f(first pose, ranges, incidences, surfaces)` for runs of poses with k beams each, in parallel where it pays.
pub(super) fn for_each_chunk(
    out: &mut Hits,
    k: usize,
    f: impl Fn(usize, &mut [f32], &mut [f32], &mut [u32]) + Sync,
) {
    let rays = POSES_PER_CHUNK * k;
    let parallel = out.len() >= PARALLEL_RAYS;
    let Hits { range, incidence, surface } = out;
    if parallel {
        let chunks = range.par_chunks_mut(rays).zip(incidence.par_chunks_mut(rays));
        chunks.zip(surface.par_chunks_mut(rays)).enumerate().for_each(
            |(i, ((range, incidence), surface))| {
                f(i * POSES_PER_CHUNK, range, incidence, surface);
            },
        );
    } else {
        let chunks = range.chunks_mut(rays).zip(incidence.chunks_mut(rays));
        for (i, ((range, incidence), surface)) in chunks.zip(surface.chunks_mut(rays)).enumerate() {
            f(i * POSES_PER_CHUNK, range, incidence, surface);
        }
    }
}
