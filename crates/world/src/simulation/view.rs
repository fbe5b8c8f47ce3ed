use std::f64::consts::PI;

use glam::DVec2;
use locsim_core::{Pose2, wrap_angle};

use super::LaserSimulator;
use super::blocks::Placement;
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
    rays: Vec<Ray>,
    /// Range of each beam in the map \[m\], at most the maximum range.
    nominal: Vec<f64>,
}

/// A beam in the map frame.
struct Ray {
    secs: f64,
    origin: DVec2,
    direction: DVec2,
}

impl View {
    /// The view of a laser whose robot is at `map_from_base_at(secs)`, for a scan that starts at `start_secs`. Each
    /// beam is cast at its own time.
    pub fn update(
        &mut self,
        map: &ExactRangeMap,
        laser: &LaserSimulator,
        start_secs: f64,
        map_from_base_at: impl Fn(f64) -> Pose2,
    ) {
        let base_from_laser = laser.laser().base_from_laser();
        let max = f64::from(laser.laser().max_range());
        self.start_secs = start_secs;
        self.start = map_from_base_at(start_secs).compose(&base_from_laser);
        (self.moved_m, self.turned_rad) = (0.0, 0.0);
        self.rays.clear();
        self.nominal.clear();
        let mut now = f64::NAN;
        let (mut origin, mut map_from_base) = (DVec2::ZERO, DVec2::X);
        for (&direction, &offset_secs) in laser.directions().iter().zip(laser.laser().beam_times_secs()) {
            let secs = start_secs + f64::from(offset_secs);
            if secs != now {
                now = secs;
                let base = map_from_base_at(secs);
                map_from_base = DVec2::from_angle(base.theta);
                origin = base.position() + map_from_base.rotate(base_from_laser.position());
                let turned = wrap_angle(base.theta + base_from_laser.theta - self.start.theta).abs();
                self.moved_m = self.moved_m.max(origin.distance(self.start.position()));
                self.turned_rad = self.turned_rad.max(turned);
            }
            let direction = map_from_base.rotate(direction);
            self.rays.push(Ray { secs, origin, direction });
            self.nominal.push(map.cast_segment(origin, direction, max).map_or(max, |(_, range)| range));
        }
    }

    /// Makes `ranges` the range of each beam \[m\] among blocks, at most the maximum range.
    pub fn ranges_among(&self, blocks: &[Placement], laser: &LaserSimulator, ranges: &mut Vec<f64>) {
        ranges.clone_from(&self.nominal);
        let max = f64::from(laser.laser().max_range());
        for placement in blocks {
            let block = placement.at(self.start_secs);
            let (center, radius) = block.circle();
            let reach = radius + self.moved_m + placement.speed_m_s() * laser.options().scan_secs;
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
