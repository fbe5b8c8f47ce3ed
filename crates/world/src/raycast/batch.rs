use glam::DVec2;
use locsim_core::{Hits, NO_SURFACE, Poses};
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
/// `from(origin, theta)` prepares a pose and returns its caster, which takes a beam's unit direction in the map
/// frame and its bearing [rad].
pub(super) fn cast_batch<From, Cast>(
    laser: Poses<'_>,
    bearings: &[f32],
    max_range: f32,
    out: &mut Hits,
    from: From,
) where
    From: Fn(DVec2, f64) -> Cast + Sync,
    Cast: Fn(DVec2, f64) -> Option<RayHit>,
{
    let beams = bearings.len();
    out.resize(laser.len() * beams);
    if out.is_empty() {
        return;
    }
    let cast_chunk = |chunk: usize, range: &mut [f32], incidence: &mut [f32], surface: &mut [u32]| {
        let first = chunk * POSES_PER_CHUNK;
        let mut directions = [DVec2::X; BEAMS_PER_BLOCK];
        for block in (0..beams).step_by(BEAMS_PER_BLOCK) {
            let bearings = &bearings[block..beams.min(block + BEAMS_PER_BLOCK)];
            for (direction, &bearing) in directions.iter_mut().zip(bearings) {
                *direction = DVec2::from_angle(f64::from(bearing));
            }
            for i in 0..range.len() / beams {
                let pose = first + i;
                let origin = DVec2::new(laser.x[pose], laser.y[pose]);
                let heading = DVec2::from_angle(laser.theta[pose]);
                let cast = from(origin, laser.theta[pose]);
                let here = i * beams + block..i * beams + block + bearings.len();
                let out = range[here.clone()]
                    .iter_mut()
                    .zip(&mut incidence[here.clone()])
                    .zip(&mut surface[here])
                    .map(|((range, incidence), surface)| (range, incidence, surface));
                for ((direction, &bearing), (range, incidence, surface)) in
                    directions.iter().zip(bearings).zip(out)
                {
                    (*range, *incidence, *surface) =
                        match cast(heading.rotate(*direction), f64::from(bearing)) {
                            // Rounding to f32 may reach the maximum, which says "no return".
                            Some(hit) if (hit.range as f32) < max_range => {
                                (hit.range as f32, hit.incidence as f32, hit.surface)
                            }
                            _ => (max_range, 0.0, NO_SURFACE),
                        };
                }
            }
        }
    };
    let rays = POSES_PER_CHUNK * beams;
    if out.len() < PARALLEL_RAYS {
        let chunks = out.range.chunks_mut(rays).zip(out.incidence.chunks_mut(rays));
        for (i, ((range, incidence), surface)) in chunks.zip(out.surface.chunks_mut(rays)).enumerate() {
            cast_chunk(i, range, incidence, surface);
        }
    } else {
        let chunks = out.range.par_chunks_mut(rays).zip(out.incidence.par_chunks_mut(rays));
        chunks
            .zip(out.surface.par_chunks_mut(rays))
            .enumerate()
            .for_each(|(i, ((range, incidence), surface))| cast_chunk(i, range, incidence, surface));
    }
}
