use std::f64::consts::TAU;
use std::sync::Arc;

use glam::DVec2;
use locsim_core::{Draw, Laser, Pose2, Stage};

use super::blocks::Placement;
use super::{BeamCaster, BlockModel, BlockOptions, CastBeam, LaserOptions, Ray, SimulationError, Surface};
use crate::effect::{
    BeamView, Effect, EffectKind, Effects, HitKind, Met, Moves, ReadingDistribution, burst, burst_window,
};
use crate::raycast::ExactRangeMap;

/// A reading is of the wall that the map has there if it ends this near to it \[m\], or within [`SURE`] standard deviations:
/// less than the depth of objects, no less than the errors of a measured map and its reference poses.
const ON_WALL_M: f64 = 0.05;
const SURE: f64 = 5.0;

/// The effects of a world applied to the scans of a recording, one after the other: one scan in, one scan out.
///
/// A recorded reading keeps its own noise. Effects shift it, add the noise that it lacks, or replace it, with the
/// [`ReadingDistribution`] of the simulator. A reading of a surface that effects put into the beam's way (an object, a wall that
/// moved, other clutter) is drawn anew. Readings that aren't usable (NaN) stay so.
///
/// - Effects that need the map ([`ScanFilter::needing_map`]) act on scans whose pose is known.
/// - Effects on clutter remove the recorded clutter (readings in front of the map's wall), and place the scenario's as the effects
///   have it.
/// - Effects on the laser's mount, on stamps and on odometry leave readings as they are: [`MountFilter`](super::MountFilter) and
///   [`OdometryFilter`](super::OdometryFilter) apply them.
///
/// Draws are keyed by the seed, the number of the scan and the beam: the same input gives the same output.
pub struct ScanFilter {
    laser: Laser,
    directions: Vec<DVec2>,
    is_closed: bool,
    /// Noise and step of the recorded readings, range limits of the recorded laser.
    options: LaserOptions,
    effects: Effects,
    /// Those of the effects that need no map.
    without_map: Effects,
    world: Option<World>,
    seed: u64,
    cast: Vec<CastBeam>,
    placements: Vec<Placement>,
}

/// The surroundings of a recorded robot.
struct World {
    map: Arc<ExactRangeMap>,
    /// Clutter, where effects change it.
    clutter: Option<BlockModel>,
}

/// A beam among effects.
struct Seen {
    view: BeamView,
    met: Met,
    /// The recording has no reading of it.
    is_new: bool,
}

impl ScanFilter {
    /// A filter of scans of `laser`, whose readings have the noise and the resolution of `options`.
    ///
    /// # Errors
    /// [`SimulationError::Effect`] for more effects than a world can have.
    pub fn new(
        effects: &[Effect],
        laser: Laser,
        options: LaserOptions,
        seed: u64,
    ) -> Result<Self, SimulationError> {
        let of_readings =
            |effect: &&Effect| !matches!(effect.kind.description().moves, Moves::Scans | Moves::Odometry);
        let list: Vec<Effect> = effects.iter().filter(of_readings).cloned().collect();
        let without_map =
            list.iter().filter(|effect| !effect.kind.description().needs.map).cloned().collect();
        let bearings = laser.bearings().iter().map(|&bearing| f64::from(bearing));
        let (lo, hi) = bearings.fold((f64::MAX, f64::MIN), |(lo, hi), b| (b.min(lo), b.max(hi)));
        let gap = (hi - lo) / (laser.beam_count() - 1).max(1) as f64;
        let options = LaserOptions {
            min_range_m: laser.min_range().into(),
            max_range_m: laser.max_range().into(),
            ..options
        };
        Ok(Self {
            directions: BeamCaster::directions(&laser, &laser.base_from_laser()),
            // The gap behind the last beam is no wider than those between beams.
            is_closed: hi - lo + 1.5 * gap > TAU,
            laser,
            options,
            effects: Effects::new(list)?,
            without_map: Effects::new(without_map)?,
            world: None,
            seed: Draw::new(seed, Stage::Recording, 0).seed(0),
            cast: Vec::new(),
            placements: Vec::new(),
        })
    }

    /// The same filter in a map, with the clutter that a nominal world would have.
    ///
    /// # Errors
    /// As [`BlockModel::new`].
    pub fn with_map(
        self,
        map: Arc<ExactRangeMap>,
        clutter: Option<BlockOptions>,
    ) -> Result<Self, SimulationError> {
        let changed = clutter.map(|nominal| (nominal, self.effects.blocks(nominal)));
        let changed = changed.filter(|(nominal, clutter)| clutter != nominal);
        let clutter = changed.map(|(_, clutter)| BlockModel::new(clutter, map.geometry())).transpose()?;
        Ok(Self { world: Some(World { map, clutter }), ..self })
    }

    /// The effects of a list that a filter can't apply without a map and the robot's poses.
    pub fn needing_map(effects: &[Effect]) -> impl Iterator<Item = EffectKind> {
        effects.iter().map(|effect| effect.kind).filter(|kind| kind.description().needs.map)
    }

    /// Applies the effects to the readings \[m\] of scan number `step`, one per beam, which begins `secs` after the first scan.
    /// `map_from_base_at` gives the robot's pose at such a time. `None`, or a filter without a map: effects that need the map
    /// are left out.
    ///
    /// # Panics
    /// If there is not one reading per beam.
    pub fn apply(
        &mut self,
        step: u32,
        secs: f64,
        map_from_base_at: Option<&dyn Fn(f64) -> Pose2>,
        readings: &mut [f32],
    ) {
        assert_eq!(readings.len(), self.laser.beam_count(), "one reading per beam");
        let noise = Draw::new(self.seed, Stage::Laser, step);
        let chance = Draw::new(self.seed, Stage::Effect, step);
        // Taken out, as casting changes the filter's buffers.
        let world = self.world.take();
        let place = world.as_ref().zip(map_from_base_at);
        let rays = match place {
            Some((world, map_from_base_at)) => self.look(world, step, secs, map_from_base_at),
            None => Vec::new(),
        };
        let effects = if place.is_some() { &self.effects } else { &self.without_map };
        for (beam, reading) in readings.iter_mut().enumerate().filter(|(_, reading)| !reading.is_nan()) {
            let seen = match place {
                Some((world, _)) => self.seen(world, &rays[beam], self.cast[beam], *reading),
                None => self.seen_without_map(beam, secs, *reading),
            };
            let Met { range, .. } = seen.met;
            let mut distribution = ReadingDistribution::nothing(&self.options);
            let burst = burst(self.seed, burst_window(seen.view.secs.max(0.0)));
            effects.fill(&mut distribution, &self.options, &seen.view, seen.met, burst);
            let (mut noise, mut chance) = (noise.item(beam as u32), chance.item(beam as u32));
            *reading = if seen.is_new {
                distribution.sample(&mut noise, &mut chance)
            } else {
                let read = (*reading, self.sigma(range), self.options.resolution_m);
                distribution.sample_again(read, &mut noise, &mut chance)
            };
        }
        self.world = world;
    }

    /// Casts the beams of a scan, and places the clutter around it.
    fn look(
        &mut self,
        world: &World,
        step: u32,
        secs: f64,
        map_from_base_at: &dyn Fn(f64) -> Pose2,
    ) -> Vec<Ray> {
        let caster = BeamCaster {
            map: &world.map,
            moved: None,
            effects: &self.effects,
            laser: &self.laser,
            mount: self.laser.base_from_laser(),
            directions: &self.directions,
            is_closed: self.is_closed,
        };
        let rays: Vec<Ray> = caster.rays(0..self.laser.beam_count(), secs, map_from_base_at).collect();
        caster.cast(&rays, &mut self.cast);
        if self.effects.needs().jump {
            let nominal: Vec<f64> = self.cast.iter().map(|cast| cast.view.range).collect();
            for (beam, cast) in self.cast.iter_mut().enumerate() {
                cast.view.jump = caster.jump(&nominal, beam);
            }
        }
        if let Some(clutter) = &world.clutter {
            let robot = map_from_base_at(secs).position();
            clutter.place_blocks(&clutter.draw(self.seed, step), secs, robot, &mut self.placements);
        }
        rays
    }

    /// What the beam of a recorded reading meets in the world of the effects.
    fn seen(&self, world: &World, ray: &Ray, cast: CastBeam, reading: f32) -> Seen {
        let view = cast.view;
        let reading = f64::from(reading);
        let max = f64::from(self.laser.max_range());
        let met = |kind, range, is_mapped| Met { kind, range, is_mapped };
        // Effects have moved the wall by this; of an object the place of the wall behind doesn't matter.
        let moved = if cast.is_mapped() { cast.range - view.range } else { 0.0 };
        let is_wall = reading < max && {
            let apart = (reading - view.range).abs();
            apart <= SURE * self.sigma(view.range) || apart * view.incidence.cos() <= ON_WALL_M
        };
        let is_clutter = reading < view.range;
        let (mut met, mut is_new) = if is_wall {
            (met(HitKind::Wall, (reading + moved).max(0.0), true), false)
        } else if reading >= max {
            // No return, as the map has it or not; a wall beyond the maximum range may have come nearer.
            let is_mapped = view.range >= max;
            let came = is_mapped && view.range + moved < max;
            (met(HitKind::Wall, if came { view.range + moved } else { reading }, is_mapped), came)
        } else if is_clutter && (world.clutter.is_some() || view.range + moved < reading) {
            (met(HitKind::Wall, view.range + moved, true), true)
        } else {
            (met(HitKind::Object, reading, false), false)
        };
        if matches!(cast.surface, Surface::Object(_)) && cast.range < met.range {
            (met, is_new) = (Met { kind: HitKind::Wall, range: cast.range, is_mapped: false }, true);
        }
        if world.clutter.is_some() {
            for placement in &self.placements {
                if let Some(range) = placement.at(ray.secs).first_hit(ray.origin, ray.direction, met.range) {
                    (met, is_new) = (Met { kind: HitKind::Object, range, is_mapped: false }, true);
                }
            }
        }
        Seen { view, met, is_new }
    }

    /// What the beam of a recorded reading meets, as far as the reading tells.
    fn seen_without_map(&self, beam: usize, secs: f64, reading: f32) -> Seen {
        let range = f64::from(reading);
        let view = BeamView {
            secs: secs + f64::from(self.laser.beam_times_secs()[beam]),
            bearing: self.laser.bearings()[beam].into(),
            range,
            incidence: 0.0,
            endpoint: DVec2::ZERO,
            direction: DVec2::X,
            normal: DVec2::ZERO,
            jump: None,
            behind: None,
        };
        Seen { view, met: Met { kind: HitKind::Object, range, is_mapped: false }, is_new: false }
    }

    /// Standard deviation of a recorded reading \[m\].
    fn sigma(&self, range: f64) -> f64 {
        self.options.sigma_m + self.options.sigma_per_m * range
    }
}
