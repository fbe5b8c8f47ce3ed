use std::f64::consts::PI;

use locsim_core::{Pose2, wrap_angle};

use super::blocks::Placement;
use super::{BeamCaster, CastBeam, LaserSimulator, Ray};

/// The beams of one scan, cast into the world before clutter and noise.
///
/// A block is looked for by those beams alone whose bearing may meet it: a circle holds the block, another one
/// all places of the laser during the sweep, and the tangents between them bound the bearings.
#[derive(Default)]
pub(super) struct CastScan {
    /// When the sweep begins \[s\].
    start_secs: f64,
    /// `map_from_laser` then.
    start: Pose2,
    /// How far the laser gets from there \[m\], and how far it turns \[rad\], at most.
    moved_m: f64,
    turned_rad: f64,
    /// How long before or after `start_secs` a beam is taken \[s\], at most.
    lasting_secs: f64,
    rays: Vec<Ray>,
    /// Index of each of the laser's beams among those that are cast; [`NOT_CAST`] for others.
    index: Vec<u32>,
    /// Range of each beam without clutter \[m\]: in the map, at most the maximum range, or as effects have it.
    clear: Vec<f64>,
    /// Beams as effects see them; empty without effects.
    pub beams: Vec<CastBeam>,
    /// Nominal ranges, scratch memory.
    nominal: Vec<f64>,
}

const NOT_CAST: u32 = u32::MAX;

impl CastScan {
    /// Casts some beams of a laser whose robot is at `map_from_base_at(secs)`, for a scan that starts at `start_secs`.
    pub fn update(
        &mut self,
        caster: &BeamCaster<'_>,
        beams: &[usize],
        start_secs: f64,
        map_from_base_at: impl Fn(f64) -> Pose2,
    ) {
        self.start_secs = start_secs;
        self.start = map_from_base_at(start_secs).compose(&caster.mount);
        (self.moved_m, self.turned_rad, self.lasting_secs) = (0.0, 0.0, 0.0);
        self.rays.clear();
        self.index.clear();
        self.index.resize(caster.laser.beam_count(), NOT_CAST);
        let mut now = f64::NAN;
        for ray in caster.rays(beams.iter().copied(), start_secs, &map_from_base_at) {
            if ray.secs != now {
                now = ray.secs;
                let turned = wrap_angle(ray.base.theta + caster.mount.theta - self.start.theta).abs();
                self.lasting_secs = self.lasting_secs.max((ray.secs - start_secs).abs());
                self.moved_m = self.moved_m.max(ray.origin.distance(self.start.position()));
                self.turned_rad = self.turned_rad.max(turned);
            }
            self.index[ray.beam] = self.rays.len() as u32;
            self.rays.push(ray);
        }
        self.clear.clear();
        if caster.effects.is_empty() && caster.moved.is_none() {
            let max = f64::from(caster.laser.max_range());
            self.beams.clear();
            self.clear.extend(self.rays.iter().map(|&Ray { origin, direction, .. }| {
                caster.map.cast_segment(origin, direction, max).map_or(max, |(_, range)| range)
            }));
            return;
        }
        caster.cast(&self.rays, &mut self.beams);
        if caster.effects.needs().jump {
            if beams.len() == caster.laser.beam_count() {
                self.nominal.clear();
                self.nominal.extend(self.beams.iter().map(|beam| beam.view.range));
                for (i, beam) in self.beams.iter_mut().enumerate() {
                    beam.view.jump = caster.jump(&self.nominal, i);
                }
            } else {
                let jumps = caster.jumps(beams, start_secs, map_from_base_at);
                self.beams.iter_mut().zip(jumps).for_each(|(beam, jump)| beam.view.jump = jump);
            }
        }
        self.clear.extend(self.beams.iter().map(|beam| beam.range));
    }

    /// The number of each beam in the laser's scans.
    pub fn numbers(&self) -> impl Iterator<Item = u32> {
        self.rays.iter().map(|ray| ray.beam as u32)
    }

    /// Makes `ranges` the range of each beam \[m\] among blocks; without effects at most the maximum range.
    pub fn ranges_among(&self, blocks: &[Placement], laser: &LaserSimulator, ranges: &mut Vec<f64>) {
        ranges.clone_from(&self.clear);
        let max = f64::from(laser.laser().max_range());
        for placement in blocks {
            let block = placement.at(self.start_secs);
            let (center, radius) = block.circle();
            let reach = radius + self.moved_m + placement.speed_m_s() * self.lasting_secs;
            let to_center = center - self.start.position();
            let distance = to_center.length();
            if distance - reach >= max {
                continue;
            }
            let half_angle = if distance > reach { (reach / distance).asin() } else { PI };
            let bearing = wrap_angle(to_center.to_angle() - self.start.theta);
            for beam in laser.beams_within(bearing, half_angle + self.turned_rad) {
                let i = self.index[beam] as usize;
                let Some(&Ray { secs, origin, direction, .. }) = self.rays.get(i) else { continue };
                let block = if placement.speed_m_s() > 0.0 { placement.at(secs) } else { block };
                if let Some(range) = block.first_hit(origin, direction, ranges[i]) {
                    ranges[i] = range;
                }
            }
        }
    }
}
