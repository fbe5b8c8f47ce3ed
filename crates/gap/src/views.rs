use std::f64::consts::TAU;

use glam::DVec2;
use locsim_core::{CAST_REACH, Pose2, Survival};
use locsim_world::effect::{BeamView, Disc, Effects, jump_at};
use rayon::prelude::*;

use crate::{Nominal, Recorded};

/// A ray is turned by this to see how its range changes with the heading \[rad\].
const TURN: f64 = 1e-5;
/// Beams more grazing than this count as this: the linear dependence on the pose ends there (cosine).
const GRAZING: f64 = 0.15;

/// A beam of the log with what the nominal world has in front of it.
#[derive(Clone, Debug)]
pub(crate) struct Beam {
    /// What effects may depend on.
    pub view: BeamView,
    /// An object of the world in front of the wall, that the map doesn't know: its range \[m\].
    pub object: Option<f64>,
    /// Change of the range with the robot's pose in the map frame \[m/m, m/m, m/rad\].
    pub jacobian: [f64; 3],
    /// How far the beam gets among blocks.
    survival: Reach,
    /// Log probability that no block stands before the surface.
    pub log_clear: f64,
}

impl Beam {
    /// Probability that no block stands within `range` metres, and the density \[1/m\] of one there, of nominal blocks.
    #[inline]
    pub fn survival_at(&self, range: f64) -> (f64, f64) {
        let Reach { start_m, bin_m, first, probability } = &self.survival;
        let at = ((range - start_m) / bin_m).max(0.0);
        let i = at as usize;
        if i < *first {
            return (1.0, 0.0);
        }
        match probability.get(i - first..) {
            Some(&[a, b, ..]) => {
                let (a, b) = (f64::from(a), f64::from(b));
                (a + (at - i as f64) * (b - a), (a - b) / bin_m)
            }
            _ => (probability.last().map_or(1.0, |&last| f64::from(last)), 0.0),
        }
    }

    /// Range of what stands there by the world's map and its objects \[m\].
    pub fn range(&self) -> f64 {
        self.object.map_or(self.view.range, |object| object.min(self.view.range))
    }
}

/// A ray's survival where it changes: a short copy, so that those of neighbouring beams lie side by side. In the world's
/// table each look at one is a look at memory that isn't in the cache.
#[derive(Clone, Debug)]
struct Reach {
    /// Entry `i` of the whole is the probability that no block stands within `start_m + i * bin_m`.
    start_m: f64,
    bin_m: f64,
    /// Entries up to this one are 1.
    first: usize,
    /// Those from there on; the last holds beyond.
    probability: Box<[f32]>,
}

impl Reach {
    fn new(survival: Survival<'_>, bin_m: f64) -> Self {
        let all = survival.probability;
        let first = all.iter().position(|&p| p < 1.0).unwrap_or(all.len()).saturating_sub(1);
        let last = all.last().copied().unwrap_or(1.0);
        // Never increasing: what follows the first of the last value is the same.
        let end = (all.iter().position(|&p| p == last).unwrap_or(0) + 1).max(first);
        Self { start_m: f64::from(survival.start_m), bin_m, first, probability: all[first..end].into() }
    }
}

/// All beams of a log from its reference poses, \[scan\]\[beam\].
#[derive(Clone)]
pub(crate) struct Views {
    pub beams: Vec<Beam>,
    pub per_scan: usize,
}

impl Views {
    /// Casts every beam from where the effects put the laser at the beam's own time.
    pub fn new(nominal: &Nominal, recorded: &Recorded, effects: &Effects) -> Self {
        let per_scan = recorded.beams();
        let beams = (0..recorded.scans())
            .into_par_iter()
            .flat_map_iter(|scan| scan_views(nominal, recorded, effects, scan))
            .collect();
        Self { beams, per_scan }
    }

    pub fn scans(&self) -> usize {
        self.beams.len() / self.per_scan
    }

    pub fn scan(&self, scan: usize) -> &[Beam] {
        &self.beams[scan * self.per_scan..][..self.per_scan]
    }
}

fn scan_views(nominal: &Nominal, recorded: &Recorded, effects: &Effects, scan: usize) -> Vec<Beam> {
    let laser = &recorded.laser;
    let mount = effects.laser_mount(laser.base_from_laser());
    let stamp = recorded.secs[scan];
    let needs = effects.needs();
    let max = f64::from(laser.max_range());
    let mut beams: Vec<Beam> = laser
        .bearings()
        .iter()
        .zip(laser.beam_times_secs())
        .map(|(&bearing, &offset)| {
            let bearing = f64::from(bearing);
            let secs = effects.beam_secs(bearing, stamp + f64::from(offset));
            let base = if secs == stamp { recorded.poses[scan] } else { recorded.pose_at(secs) };
            beam(nominal, &base, &mount, bearing, stamp, effects.objects(), needs.behind, max)
        })
        .collect();
    if needs.jump {
        for (beam, jump) in beams.iter_mut().zip(jumps(nominal, recorded, scan)) {
            beam.view.jump = jump;
        }
    }
    beams
}

#[expect(clippy::too_many_arguments, reason = "one call, and each is a thing of its own")]
fn beam(
    nominal: &Nominal,
    base: &Pose2,
    mount: &Pose2,
    bearing: f64,
    secs: f64,
    objects: &[Disc],
    behind: bool,
    max: f64,
) -> Beam {
    let map = &nominal.map;
    let laser = base.compose(mount);
    let (origin, heading) = (laser.position(), laser.theta + bearing);
    let direction = DVec2::from_angle(heading);
    let reach = f64::from(CAST_REACH) * max;
    let hit = map.cast_ray(origin, direction, reach);
    let range = hit.map_or(reach, |hit| hit.range);
    let incidence = hit.map_or(0.0, |hit| hit.incidence);
    let jacobian = hit.map_or([0.0; 3], |hit| {
        // On which side of the normal the ray comes in: does it get longer when it turns left?
        let longer = map
            .cast_ray(origin, DVec2::from_angle(heading + TURN), reach)
            .is_some_and(|turned| turned.surface == hit.surface && turned.range > range);
        let signed = if longer { incidence } else { -incidence };
        let normal = -DVec2::from_angle(heading - signed);
        let cosine = incidence.cos().max(GRAZING);
        let with_position = normal / cosine;
        let lever = DVec2::from_angle(base.theta).rotate(mount.position()).perp();
        let with_heading = range * signed.sin() / cosine + with_position.dot(lever);
        [with_position.x, with_position.y, with_heading]
    });
    let obstructions = nominal.obstructions();
    let survival = obstructions.survival(origin.x, origin.y, heading.rem_euclid(TAU), range as f32);
    let object = objects.iter().filter_map(|disc| disc.first_hit(origin, direction, range)).reduce(f64::min);
    let behind = if behind && hit.is_some() {
        let start = range + 1e-6;
        map.cast_ray(origin + start * direction, direction, max - start).map(|next| start + next.range)
    } else {
        None
    };
    let view = BeamView {
        secs,
        bearing,
        range,
        incidence,
        endpoint: origin + range * direction,
        jump: None,
        behind,
    };
    let mut beam = Beam {
        view,
        object,
        jacobian,
        survival: Reach::new(survival, f64::from(obstructions.bin_m())),
        log_clear: 0.0,
    };
    beam.log_clear = beam.survival_at(beam.range().min(max)).0.max(1e-12).ln();
    beam
}

/// The range jumps between neighbouring beams of the full scan, at the beams that are looked at.
pub(crate) fn jumps(nominal: &Nominal, recorded: &Recorded, scan: usize) -> Vec<Option<[f64; 2]>> {
    let laser = recorded.poses[scan].compose(&recorded.laser.base_from_laser());
    let max = f64::from(recorded.laser.max_range());
    let ranges: Vec<f64> = recorded
        .all_bearings
        .iter()
        .map(|&bearing| {
            let direction = DVec2::from_angle(laser.theta + f64::from(bearing));
            nominal.map.cast_ray(laser.position(), direction, max).map_or(max, |hit| hit.range)
        })
        .collect();
    let closed = nominal.laser.field_of_view_rad >= TAU - 1e-6;
    recorded.kept.iter().map(|&beam| jump_at(&ranges, beam, closed)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is kept of a ray's survival says the same as the whole, to the last bit.
    #[test]
    fn a_short_copy_says_the_same() {
        let whole = |p: &[f32], start_m: f64, bin_m: f64, range: f64| {
            let at = ((range - start_m) / bin_m).max(0.0);
            let i = at as usize;
            let p: Vec<f64> = p.iter().map(|&p| f64::from(p)).collect();
            match p.get(i..i + 2) {
                Some(&[a, b]) => (a + (at - i as f64) * (b - a), (a - b) / bin_m),
                _ => (p[p.len() - 1], 0.0),
            }
        };
        let rays: [&[f32]; 5] = [
            &[1.0, 1.0, 1.0, 0.9, 0.7, 0.7, 0.6, 0.6, 0.6],
            &[1.0; 6],
            &[1.0],
            &[1.0, 0.5, 0.5],
            &[0.8, 0.4, 0.3],
        ];
        for ray in rays {
            let survival = Survival { probability: ray, start_m: -0.03 };
            let view = BeamView {
                secs: 0.0,
                bearing: 0.0,
                range: 1.0,
                incidence: 0.0,
                endpoint: DVec2::ZERO,
                jump: None,
                behind: None,
            };
            let beam = Beam {
                view,
                object: None,
                jacobian: [0.0; 3],
                survival: Reach::new(survival, 0.1),
                log_clear: 0.0,
            };
            for i in -2..60 {
                let range = 0.02 * f64::from(i);
                let start_m = f64::from(survival.start_m);
                assert_eq!(beam.survival_at(range), whole(ray, start_m, 0.1, range), "{ray:?} {range}");
            }
        }
    }
}
