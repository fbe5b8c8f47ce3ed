use std::collections::BTreeSet;

use glam::DVec2;
use locsim_core::{Laser, Pose2};

use super::MovedWalls;
use crate::effect::{BeamView, Effects, jump_at};
use crate::raycast::ExactRangeMap;

/// Beams more grazing than this count as this in [`BeamCaster::range_gradient`] (cosine of 81 deg): a range depends linearly on
/// the pose only over distances that shrink with the cosine.
const GRAZING: f64 = 0.15;

/// Casts the beams of scans into a world with effects, before clutter and noise. The simulator draws readings from what it
/// finds, `locsim gap` asks for their density.
#[derive(Clone, Copy)]
pub struct BeamCaster<'a> {
    /// The map.
    pub map: &'a ExactRangeMap,
    /// Where the map's walls really stand, if elsewhere.
    pub moved: Option<&'a MovedWalls>,
    /// The effects of the world.
    pub effects: &'a Effects,
    /// The laser's beams, their times and its range.
    pub laser: &'a Laser,
    /// Where the laser really sits, `base_from_laser`; see [`Effects::laser_mount`].
    pub mount: Pose2,
    /// Unit direction of each beam in the robot's frame; see [`BeamCaster::directions`].
    pub directions: &'a [DVec2],
    /// Whether the first and the last beam are neighbours.
    pub is_closed: bool,
}

/// A beam in the map frame.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Its number in the scan.
    pub beam: usize,
    /// When it is really taken \[s\].
    pub secs: f64,
    /// `map_from_base` at that time.
    pub base: Pose2,
    /// Where the laser is \[m\].
    pub origin: DVec2,
    /// Unit vector.
    pub direction: DVec2,
}

/// A beam in a world with effects and without clutter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CastBeam {
    /// Covariates of effects. Of a beam that meets a missing object the incidence is that on the object.
    pub view: BeamView,
    /// Range of the surface \[m\], moved as effects have it; [`BeamView::range`] where no surface is met.
    pub range: f64,
    /// The surface.
    pub surface: Surface,
}

/// Surface that a beam meets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Surface {
    /// No surface in reach.
    None,
    /// Wall segment of the map with this number.
    Wall(usize),
    /// Missing object with this number in [`Effects::objects`].
    Object(usize),
}

impl CastBeam {
    /// Whether the surface isn't a missing object, which the map doesn't have.
    pub fn is_mapped(&self) -> bool {
        !matches!(self.surface, Surface::Object(_))
    }
}

impl<'a> BeamCaster<'a> {
    /// Unit direction of each beam of a laser in the robot's frame, for a laser with this `base_from_laser`.
    pub fn directions(laser: &Laser, mount: &Pose2) -> Vec<DVec2> {
        laser.bearings().iter().map(|&bearing| DVec2::from_angle(mount.theta + f64::from(bearing))).collect()
    }

    /// Rays of the beams `beams` of a scan that starts at `start_secs`, for a robot at `map_from_base_at(secs)`. Each beam
    /// starts where the laser is at the beam's own time, which effects may have shifted.
    pub fn rays(
        &self,
        beams: impl IntoIterator<Item = usize> + 'a,
        start_secs: f64,
        map_from_base_at: impl Fn(f64) -> Pose2,
    ) -> impl Iterator<Item = Ray> {
        let Self { effects, laser, mount, directions, .. } = *self;
        let mut now = f64::NAN;
        let (mut base, mut origin, mut map_from_base) = (Pose2::IDENTITY, DVec2::ZERO, DVec2::X);
        beams.into_iter().map(move |beam| {
            let mut secs = start_secs + f64::from(laser.beam_times_secs()[beam]);
            if !effects.is_empty() {
                secs = effects.beam_secs(f64::from(laser.bearings()[beam]), secs);
            }
            if secs != now {
                now = secs;
                base = map_from_base_at(secs);
                map_from_base = DVec2::from_angle(base.theta);
                origin = base.position() + map_from_base.rotate(mount.position());
            }
            Ray { beam, secs, base, origin, direction: map_from_base.rotate(directions[beam]) }
        })
    }

    /// Replaces `beams` by what these rays meet. [`BeamView::jump`] needs all beams of a scan; see
    /// [`BeamCaster::jump`].
    pub fn cast(&self, rays: &[Ray], beams: &mut Vec<CastBeam>) {
        beams.clear();
        beams.extend(rays.iter().map(|ray| self.cast_one(ray)));
    }

    fn cast_one(&self, &Ray { beam, secs, origin, direction, .. }: &Ray) -> CastBeam {
        let [reach, max] = [self.laser.cast_range(), self.laser.max_range()].map(f64::from);
        let hit = self.map.cast_segment(origin, direction, reach);
        let mut view = BeamView {
            secs,
            bearing: f64::from(self.laser.bearings()[beam]),
            range: reach,
            incidence: 0.0,
            endpoint: origin + reach * direction,
            direction,
            normal: DVec2::ZERO,
            jump: None,
            behind: None,
        };
        let mut surface = Surface::None;
        if let Some((segment, range)) = hit {
            let [a, b] = self.map.geometry().segments()[segment];
            let normal = (b - a).perp().normalize_or_zero();
            view.range = range;
            view.incidence = self.map.hit((segment, range), direction.to_angle()).incidence;
            view.endpoint = origin + range * direction;
            view.normal = -normal * normal.dot(direction).signum();
            surface = Surface::Wall(segment);
        }
        if self.effects.needs().behind {
            view.behind = self.map.cast_behind(origin, direction, view.range, max);
        }
        let mut range = self.effects.wall_range(&view);
        if let (Some(moved), Surface::Wall(segment)) = (self.moved, surface) {
            range = (range + moved.change(segment, view.endpoint, view.incidence)).max(0.0);
        }
        for (number, object) in self.effects.objects().iter().enumerate() {
            if let Some(nearer) = object.first_hit(origin, direction, range) {
                (range, surface) = (nearer, Surface::Object(number));
                view.incidence = object.incidence(origin, direction);
            }
        }
        CastBeam { view, range, surface }
    }

    /// Replaces `ranges` by how far these rays get in the map \[m\].
    pub fn nominal_ranges(&self, rays: impl IntoIterator<Item = Ray>, ranges: &mut Vec<f64>) {
        let reach = f64::from(self.laser.cast_range());
        ranges.clear();
        ranges.extend(rays.into_iter().map(|Ray { origin, direction, .. }| {
            self.map.cast_segment(origin, direction, reach).map_or(reach, |(_, range)| range)
        }));
    }

    /// The range jump at a beam of a scan, where all beams of the scan have these nominal ranges \[m\]; see
    /// [`BeamView::jump`].
    pub fn jump(&self, nominal: &[f64], beam: usize) -> Option<[f64; 2]> {
        jump_at(nominal, beam, self.is_closed)
    }

    /// The range jumps at the beams `beams` of a scan that starts at `start_secs`, for a robot at `map_from_base_at(secs)`.
    pub fn jumps(
        &self,
        beams: &[usize],
        start_secs: f64,
        map_from_base_at: impl Fn(f64) -> Pose2,
    ) -> Vec<Option<[f64; 2]>> {
        let count = self.laser.beam_count();
        let beside = |&beam: &usize| [beam + count - 1, beam, beam + 1].map(|beam| beam % count);
        let cast: BTreeSet<usize> = beams.iter().flat_map(beside).collect();
        let mut of_cast = Vec::new();
        self.nominal_ranges(
            self.rays(cast.iter().copied().collect::<Vec<_>>(), start_secs, map_from_base_at),
            &mut of_cast,
        );
        let mut ranges = vec![f64::NAN; count];
        cast.into_iter().zip(of_cast).for_each(|(beam, range)| ranges[beam] = range);
        beams.iter().map(|&beam| self.jump(&ranges, beam)).collect()
    }

    /// Change of a beam's range with the robot's pose in the map frame \[m/m, m/m, m/rad\]; 0 where no surface is met.
    pub fn range_gradient(&self, ray: &Ray, cast: &CastBeam) -> [f64; 3] {
        let &Ray { origin, direction, base, .. } = ray;
        let (range, normal) = match cast.surface {
            Surface::None => return [0.0; 3],
            Surface::Wall(segment) => (cast.view.range, self.map.normal(segment, direction)),
            Surface::Object(number) => {
                let center = self.effects.objects()[number].center;
                (cast.range, (origin + cast.range * direction - center).normalize_or_zero())
            }
        };
        let cosine = (-normal.dot(direction)).max(GRAZING);
        let with_position = normal / cosine;
        let lever = (origin - base.position()).perp();
        let turned = range * normal.dot(direction.perp()) / cosine;
        [with_position.x, with_position.y, turned + with_position.dot(lever)]
    }
}
