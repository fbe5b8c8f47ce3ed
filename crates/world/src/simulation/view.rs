use std::f64::consts::PI;

use glam::DVec2;
use locsim_core::{Pose2, wrap_angle};

use super::LaserSimulator;
use super::blocks::Placement;
use crate::effect::{BeamView, Effects, jump_at};
use crate::raycast::ExactRangeMap;

/// The beams of one scan, cast into the map, before blocks and noise.
///
/// A block is looked for by those beams alone whose bearing may meet it: a circle holds the block, another one
/// all places of the laser during the sweep, and the tangents between them bound the bearings.
#[derive(Default)]
pub(super) struct View {
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
    /// Range of each beam without blocks \[m\]: in the map, at most the maximum range, or as effects have it.
    clear: Vec<f64>,
    /// What effects want to know; empty without any.
    pub beams: Vec<EffectView>,
    /// Nominal ranges, room to work in.
    nominal: Vec<f64>,
}

/// A beam as effects see it.
#[derive(Clone, Copy)]
pub(super) struct EffectView {
    /// What the map says, or of a missing object in front its incidence.
    pub view: BeamView,
    /// Range of what stands there without blocks \[m\]: as [`View::clear`].
    pub clear: f64,
    /// Whether that is a wall of the map.
    pub mapped: bool,
}

/// A beam in the map frame.
struct Ray {
    secs: f64,
    origin: DVec2,
    direction: DVec2,
}

impl View {
    /// The view of a laser whose robot is at `map_from_base_at(secs)`, for a scan that starts at `start_secs`. Each
    /// beam is cast at its own time, which effects may have shifted.
    pub fn update(
        &mut self,
        map: &ExactRangeMap,
        laser: &LaserSimulator,
        effects: &Effects,
        start_secs: f64,
        map_from_base_at: impl Fn(f64) -> Pose2,
    ) {
        let base_from_laser = laser.laser().base_from_laser();
        let max = f64::from(laser.laser().max_range());
        self.start_secs = start_secs;
        self.start = map_from_base_at(start_secs).compose(&base_from_laser);
        (self.moved_m, self.turned_rad, self.lasting_secs) = (0.0, 0.0, 0.0);
        self.rays.clear();
        self.clear.clear();
        let mut now = f64::NAN;
        let (mut origin, mut map_from_base) = (DVec2::ZERO, DVec2::X);
        let bearings = laser.laser().bearings();
        let beams = laser.directions().iter().zip(laser.laser().beam_times_secs()).zip(bearings);
        for ((&direction, &offset_secs), &bearing) in beams {
            let mut secs = start_secs + f64::from(offset_secs);
            if !effects.is_empty() {
                secs = effects.beam_secs(f64::from(bearing), secs);
            }
            if secs != now {
                now = secs;
                self.lasting_secs = self.lasting_secs.max((secs - start_secs).abs());
                let base = map_from_base_at(secs);
                map_from_base = DVec2::from_angle(base.theta);
                origin = base.position() + map_from_base.rotate(base_from_laser.position());
                let turned = wrap_angle(base.theta + base_from_laser.theta - self.start.theta).abs();
                self.moved_m = self.moved_m.max(origin.distance(self.start.position()));
                self.turned_rad = self.turned_rad.max(turned);
            }
            let direction = map_from_base.rotate(direction);
            self.rays.push(Ray { secs, origin, direction });
        }
        if effects.is_empty() {
            self.beams.clear();
            self.clear.extend(self.rays.iter().map(|&Ray { origin, direction, .. }| {
                map.cast_segment(origin, direction, max).map_or(max, |(_, range)| range)
            }));
        } else {
            self.look(map, laser, effects);
        }
    }

    /// Casts the rays as effects want to know them.
    fn look(&mut self, map: &ExactRangeMap, laser: &LaserSimulator, effects: &Effects) {
        let [reach, max] = [laser.laser().cast_range(), laser.laser().max_range()].map(f64::from);
        let needs = effects.needs();
        self.nominal.clear();
        self.beams.clear();
        for (ray, &bearing) in self.rays.iter().zip(laser.laser().bearings()) {
            let &Ray { secs, origin, direction } = ray;
            let hit = map.cast_ray(origin, direction, reach);
            let (range, incidence) = hit.map_or((reach, 0.0), |hit| (hit.range, hit.incidence));
            let behind = if needs.behind { map.cast_behind(origin, direction, range, max) } else { None };
            let endpoint = origin + range * direction;
            let bearing = f64::from(bearing);
            let view = BeamView { secs, bearing, range, incidence, endpoint, jump: None, behind };
            self.nominal.push(range);
            self.beams.push(EffectView { view, clear: effects.wall_range(&view), mapped: true });
        }
        for (i, (beam, &Ray { origin, direction, .. })) in self.beams.iter_mut().zip(&self.rays).enumerate() {
            if needs.jump {
                beam.view.jump = jump_at(&self.nominal, i, laser.is_closed());
            }
            for object in effects.objects() {
                if let Some(range) = object.first_hit(origin, direction, beam.clear) {
                    (beam.clear, beam.mapped) = (range, false);
                    beam.view.incidence = object.incidence(origin, direction);
                }
            }
        }
        self.clear.extend(self.beams.iter().map(|beam| beam.clear));
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
                let Ray { secs, origin, direction } = self.rays[beam];
                let block = if placement.speed_m_s() > 0.0 { placement.at(secs) } else { block };
                if let Some(range) = block.first_hit(origin, direction, ranges[beam]) {
                    ranges[beam] = range;
                }
            }
        }
    }
}
