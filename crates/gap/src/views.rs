use std::collections::HashSet;
use std::sync::Arc;

use glam::DVec2;
use locsim_core::{CAST_REACH, Pose2};
use locsim_world::effect::{BeamView, Effect, EffectKind, Effects, jump_at};
use locsim_world::simulation::BlockIntegral;
use rayon::prelude::*;

use crate::{GapError, Nominal, Recorded};

/// Distance between two ranges at which it is known how likely a beam gets so far among blocks \[m\].
const BIN_M: f64 = 0.05;
/// Blocks are looked for so far beyond what a beam ends at, or beyond the maximum range \[m\]: a beam that takes this over may be so
/// much shorter.
const BEYOND_M: f64 = 0.3;
/// While an effect is fitted, beams of one scan and bearing whose ends are as near to each other as this count as having the
/// same blocks in their way \[m\].
const SAME_END_M: f64 = 0.1;
/// The same for long beams, as seen from the laser \[rad\].
const SAME_TURN_RAD: f64 = 0.02;
/// A map of more faces than this is one of a grid's cells.
const MANY_FACES: usize = 500;
/// A ray is turned by this to see how its range changes with the heading \[rad\].
const TURN: f64 = 1e-5;
/// Beams more grazing than this count as this: the linear dependence on the pose ends there (cosine).
const GRAZING: f64 = 0.15;

/// A beam of the log with what the world has in front of it.
#[derive(Clone, Debug)]
pub(crate) struct Beam {
    /// What effects may depend on.
    pub view: BeamView,
    /// An object of the world in front of the wall, that the map doesn't know: its range \[m\].
    pub object: Option<f64>,
    /// Change of the range with the robot's pose in the map frame \[m/m, m/m, m/rad\].
    pub jacobian: [f64; 3],
    /// How far the beam gets among blocks.
    survival: Survival,
    /// Log probability that no block stands before the surface.
    pub log_clear: f64,
}

impl Beam {
    /// Probability that no block stands within `range` metres, and the density \[1/m\] of one there.
    #[inline]
    pub fn survival_at(&self, range: f64) -> (f64, f64) {
        let Survival { start_m, bin_m, probability } = &self.survival;
        let at = (range - start_m) / bin_m;
        if at < 0.0 {
            return (1.0, 0.0);
        }
        let i = at as usize;
        match probability.get(i..) {
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

/// How far a beam gets among unmapped blocks.
#[derive(Clone, Debug)]
struct Survival {
    /// Entry `i` of the probabilities is that no block stands within `start_m + i * bin_m`; it is 1 before the first, and the
    /// last holds beyond.
    start_m: f64,
    bin_m: f64,
    probability: Arc<[f32]>,
}

impl Survival {
    /// That of a ray up to `limit` metres for a robot at `robot`; `counts` is scratch memory.
    fn new(
        blocks: &BlockIntegral,
        origin: DVec2,
        direction: DVec2,
        robot: DVec2,
        limit: f64,
        counts: &mut Vec<f64>,
    ) -> Self {
        counts.clear();
        counts.resize((limit / BIN_M) as usize + 2, 0.0);
        blocks.count_by_range(origin, direction, robot, limit, BIN_M, counts);
        let Some(first) = counts.iter().position(|&count| count > 0.0) else { return Self::clear() };
        let last = counts.iter().rposition(|&count| count > 0.0).unwrap_or(first);
        let mut met = 0.0;
        let probability = std::iter::once(1.0).chain(counts[first..=last].iter().map(|count| {
            met += count;
            (-met).exp() as f32
        }));
        Self { start_m: first as f64 * BIN_M, bin_m: BIN_M, probability: probability.collect() }
    }

    /// That of a beam without blocks.
    fn clear() -> Self {
        Self { start_m: 0.0, bin_m: BIN_M, probability: Arc::new([]) }
    }

    /// That of a beam which ends nearby, at `to` metres instead of `from`, among blocks that are `deeper` times as deep: blocks
    /// stand by walls.
    fn moved(&self, from: f64, to: f64, deeper: f64) -> Self {
        let start_m = to - deeper * (from - self.start_m);
        Self { start_m, bin_m: deeper * self.bin_m, probability: Arc::clone(&self.probability) }
    }
}

/// All beams of a log from its reference poses, \[scan\]\[beam\].
#[derive(Clone)]
pub(crate) struct Views {
    pub beams: Vec<Beam>,
    pub per_scan: usize,
    /// The effects that shape them.
    shaped_by: Vec<Effect>,
    /// The blocks that may be in their way.
    blocks: Option<Arc<BlockIntegral>>,
}

/// Whether an effect changes where beams come from or what stands in their way, so that they are cast anew.
fn shapes_views(kind: EffectKind) -> bool {
    matches!(
        kind,
        EffectKind::MountYaw
            | EffectKind::MountOffset
            | EffectKind::TimeOffset
            | EffectKind::MotionSkew
            | EffectKind::MissingObject
            | EffectKind::Glass
            | EffectKind::MixedPixels
            | EffectKind::BlockDepth
            | EffectKind::BlockDensity
    )
}

/// Whether the blocks are those of a grid's map, whose faces are of a cell each.
fn has_many_faces(blocks: &BlockIntegral) -> bool {
    blocks.model().face_count() > MANY_FACES
}

impl Views {
    /// Casts every beam from where the effects put the laser at the beam's own time.
    ///
    /// # Errors
    /// [`GapError::Simulation`] for blocks that can't be.
    pub fn new(nominal: &Nominal, recorded: &Recorded, effects: &Effects) -> Result<Self, GapError> {
        let blocks = nominal.integral_over(nominal.blocks_with(effects).as_ref())?;
        Ok(Self::cast(nominal, recorded, effects, blocks, None))
    }

    /// Whether the world looks the same with these effects.
    pub fn are_of(&self, effects: &Effects) -> bool {
        effects.list().iter().filter(|effect| shapes_views(effect.kind)).eq(&self.shaped_by)
    }

    /// The same log's with other effects, quickly: what may be in the way of a beam that ends about where it did is taken over, as
    /// while numbers are fitted.
    ///
    /// # Errors
    /// As [`Views::new`].
    pub fn with(&self, nominal: &Nominal, recorded: &Recorded, effects: &Effects) -> Result<Self, GapError> {
        let blocks = nominal.blocks_with(effects);
        let same = blocks.as_ref() == self.blocks.as_ref().map(|blocks| blocks.model().options());
        let blocks = if same { self.blocks.clone() } else { nominal.integral_over(blocks.as_ref())? };
        // Of many faces an integral takes long: then every beam takes over what is known, and deeper blocks are these ones,
        // stretched away from their walls.
        let is_slow = blocks.as_ref().is_some_and(|blocks| has_many_faces(blocks));
        Ok(Self::cast(nominal, recorded, effects, blocks, (same || is_slow).then_some(self)))
    }

    fn cast(
        nominal: &Nominal,
        recorded: &Recorded,
        effects: &Effects,
        blocks: Option<Arc<BlockIntegral>>,
        nearby: Option<&Self>,
    ) -> Self {
        let mount = effects.laser_mount(recorded.laser.base_from_laser());
        let max = f64::from(recorded.laser.max_range());
        let depth = |list: &mut dyn Iterator<Item = &Effect>| -> f64 {
            list.filter(|effect| effect.kind == EffectKind::BlockDepth)
                .map(|effect| effect.values[0])
                .product()
        };
        let before = nearby.map_or(1.0, |views| depth(&mut views.shaped_by.iter()));
        let deeper = depth(&mut effects.list().iter()) / before;
        let caster = Caster { nominal, recorded, effects, mount, max, blocks: blocks.as_deref(), deeper };
        let beams = (0..recorded.scans())
            .into_par_iter()
            .flat_map_iter(|scan| caster.scan(scan, nearby.map(|views| views.scan(scan))))
            .collect();
        let shaped_by = effects.list().iter().filter(|effect| shapes_views(effect.kind)).cloned().collect();
        Self { beams, per_scan: recorded.beams(), shaped_by, blocks }
    }

    /// The points of a lattice near which unmapped blocks may stand; see [`locsim_world::simulation::BlockModel::lattice_in_reach`].
    pub fn blocks_in_reach(&self, side: f64, half: f64) -> HashSet<[i32; 2]> {
        self.blocks.as_ref().map_or_else(HashSet::new, |blocks| blocks.model().lattice_in_reach(side, half))
    }

    pub fn scans(&self) -> usize {
        self.beams.len() / self.per_scan
    }

    pub fn scan(&self, scan: usize) -> &[Beam] {
        &self.beams[scan * self.per_scan..][..self.per_scan]
    }
}

/// Casts a log's beams.
struct Caster<'a> {
    nominal: &'a Nominal,
    recorded: &'a Recorded,
    effects: &'a Effects,
    /// Pose of the laser on the robot.
    mount: Pose2,
    /// Maximum range \[m\].
    max: f64,
    blocks: Option<&'a BlockIntegral>,
    /// How much deeper blocks are than those that views nearby are of.
    deeper: f64,
}

impl Caster<'_> {
    fn scan(&self, scan: usize, nearby: Option<&[Beam]>) -> Vec<Beam> {
        let laser = &self.recorded.laser;
        let stamp = self.recorded.track.secs()[scan];
        let mut counts = Vec::new();
        let mut beams: Vec<Beam> = laser
            .bearings()
            .iter()
            .zip(laser.beam_times_secs())
            .enumerate()
            .map(|(i, (&bearing, &offset))| {
                let bearing = f64::from(bearing);
                let secs = self.effects.beam_secs(bearing, stamp + f64::from(offset));
                let base = if secs == stamp {
                    self.recorded.track.poses()[scan]
                } else {
                    self.recorded.track.pose_at(secs)
                };
                // Blocks keep away from where the robot is at the scan's stamp, as in the simulator.
                let robot = self.recorded.track.poses()[scan].position();
                self.beam(&base, robot, bearing, stamp, nearby.map(|beams| &beams[i]), &mut counts)
            })
            .collect();
        if self.effects.needs().jump {
            for (beam, jump) in beams.iter_mut().zip(jumps(self.nominal, self.recorded, scan)) {
                beam.view.jump = jump;
            }
        }
        beams
    }

    fn beam(
        &self,
        base: &Pose2,
        robot: DVec2,
        bearing: f64,
        secs: f64,
        nearby: Option<&Beam>,
        counts: &mut Vec<f64>,
    ) -> Beam {
        let (map, max) = (&self.nominal.map, self.max);
        let laser = base.compose(&self.mount);
        let (origin, heading) = (laser.position(), laser.theta + bearing);
        let direction = DVec2::from_angle(heading);
        let reach = f64::from(CAST_REACH) * max;
        let hit = map.cast_ray(origin, direction, reach);
        let range = hit.map_or(reach, |hit| hit.range);
        let mut incidence = hit.map_or(0.0, |hit| hit.incidence);
        let mut normal = hit.map(|hit| {
            // On which side of the normal the ray comes in: does it get longer when it turns left?
            let longer = map
                .cast_ray(origin, DVec2::from_angle(heading + TURN), reach)
                .is_some_and(|turned| turned.surface == hit.surface && turned.range > range);
            -DVec2::from_angle(heading - if longer { incidence } else { -incidence })
        });
        let mut object = None;
        for disc in self.effects.objects() {
            if let Some(nearer) = disc.first_hit(origin, direction, object.unwrap_or(range)) {
                object = Some(nearer);
                incidence = disc.incidence(origin, direction);
                normal = (origin + nearer * direction - disc.center).try_normalize();
            }
        }
        let jacobian = normal.map_or([0.0; 3], |normal| {
            let cosine = incidence.cos().max(GRAZING);
            let with_position = normal / cosine;
            let lever = DVec2::from_angle(base.theta).rotate(self.mount.position()).perp();
            let turned = object.unwrap_or(range) * normal.dot(direction.perp()) / cosine;
            [with_position.x, with_position.y, turned + with_position.dot(lever)]
        });
        let behind =
            if self.effects.needs().behind { map.cast_behind(origin, direction, range, max) } else { None };
        let endpoint = origin + range * direction;
        let is_near = |other: &&Beam| {
            let ends_near = other.view.endpoint.distance(endpoint) < SAME_END_M.max(SAME_TURN_RAD * range);
            let other_is_open = other.view.range >= reach;
            // An open beam has no wall to align the other's blocks at.
            if hit.is_none() || other_is_open {
                return hit.is_none() && other_is_open;
            }
            let is_slow = self.blocks.is_some_and(has_many_faces);
            is_slow || ends_near && (other.view.range - range).abs() < BEYOND_M
        };
        let survival = match (self.blocks, nearby.filter(is_near)) {
            (None, _) => Survival::clear(),
            (_, Some(other)) => other.survival.moved(other.view.range.min(reach), range, self.deeper),
            (Some(blocks), None) => {
                let limit = range.min(max) + BEYOND_M;
                Survival::new(blocks, origin, direction, robot, limit, counts)
            }
        };
        let view = BeamView { secs, bearing, range, incidence, endpoint, jump: None, behind };
        let mut beam = Beam { view, object, jacobian, survival, log_clear: 0.0 };
        beam.log_clear = beam.survival_at(beam.range().min(max)).0.max(1e-12).ln();
        beam
    }
}

/// The range jumps between neighbouring beams of the full scan, at the beams that are looked at.
pub(crate) fn jumps(nominal: &Nominal, recorded: &Recorded, scan: usize) -> Vec<Option<[f64; 2]>> {
    let laser = recorded.track.poses()[scan].compose(&recorded.laser.base_from_laser());
    let max = f64::from(recorded.laser.max_range());
    let ranges: Vec<f64> = recorded
        .all_bearings
        .iter()
        .map(|&bearing| {
            let direction = DVec2::from_angle(laser.theta + f64::from(bearing));
            nominal.map.cast_ray(laser.position(), direction, max).map_or(max, |hit| hit.range)
        })
        .collect();
    let closed = nominal.laser.is_closed();
    recorded.kept.iter().map(|&beam| jump_at(&ranges, beam, closed)).collect()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use locsim_world::map::{Polyline, VectorMap, Wall};
    use locsim_world::raycast::ExactRangeMap;
    use locsim_world::simulation::LaserOptions;

    use super::*;
    use crate::fixtures::{NOMINAL, TRUTH};
    use crate::hidden::{Regime, record_library};
    use crate::likelihood::Density;

    /// A laser that is a few centimetres off has about the same in its way, at the same distances from what it ends at: what a beam
    /// takes over is as good as what it has itself. A beam that comes to end elsewhere has its own.
    #[test]
    fn what_is_in_the_way_of_a_beam_nearby_is_in_its_way() {
        let drive = record_library(&NOMINAL, &TRUTH, &[], Regime::default(), 2).unwrap();
        let recorded = Recorded::new(&drive, 40, 72, |_| true).unwrap();
        let offset = |by: f64| {
            let offset = Effect::new(EffectKind::MountOffset, vec![by, by], Vec::new()).unwrap();
            NOMINAL.effects_with(&[offset]).unwrap()
        };
        let nominal = Views::new(&NOMINAL, &recorded, &NOMINAL.effects).unwrap();
        assert!(nominal.are_of(&NOMINAL.effects) && !nominal.are_of(&offset(0.01)));
        // Mean difference over beams and ranges of those taken over, and as if they weren't aligned; how many have their own.
        let compare = |by: f64| {
            let views = nominal.with(&NOMINAL, &recorded, &offset(by)).unwrap();
            let own = Views::new(&NOMINAL, &recorded, &offset(by)).unwrap();
            let (mut aligned, mut unaligned, mut compared, mut anew) = (0.0, 0.0, 0.0, 0);
            for ((one, own), nominal) in views.beams.iter().zip(&own.beams).zip(&nominal.beams) {
                assert_eq!(one.view, own.view);
                let is_taken_over = Arc::ptr_eq(&one.survival.probability, &nominal.survival.probability);
                anew += usize::from(!is_taken_over);
                for before_wall in [0.05, 0.15, 0.25, 0.35, 0.45] {
                    let range = own.view.range - before_wall;
                    let at = |beam: &Beam| beam.survival_at(range).0;
                    if !is_taken_over {
                        assert_eq!(at(one), at(own));
                    } else if own.survival_at(own.view.range).0 < 1.0 {
                        aligned += (at(one) - at(own)).abs();
                        unaligned += (at(nominal) - at(own)).abs();
                        compared += 1.0;
                    }
                }
            }
            (aligned / compared, unaligned / compared, anew)
        };
        let (aligned, unaligned, anew) = compare(0.05);
        assert!(aligned < 0.006 && aligned < 0.5 * unaligned && anew > 0, "{aligned} {unaligned} {anew}");
        let (_, _, more) = compare(0.3);
        assert!(more > anew, "{more} {anew}");
    }

    /// Readings almost without noise are likely where the search looks for them: at a disc's own slant, at the
    /// surface behind a pane that is more than a film away.
    #[test]
    fn beams_meet_what_the_simulator_lets_them_meet() {
        let board = |name: &str, y: f64| Wall { name: name.to_owned(), from_m: [2.0, y], to_m: [3.0, y] };
        let outline = Polyline {
            points_m: vec![[0.0, 0.0], [6.0, 0.0], [6.0, 4.0], [0.0, 4.0]],
            ..Polyline::default()
        };
        let walls = vec![board("pane", 0.4), board("film", 0.3995), board("board", 0.2)];
        let map = VectorMap { outline, obstacles: Vec::new(), walls };
        let map = Arc::new(ExactRangeMap::new(map.to_geometry().unwrap()));
        // Of a full circle for some, not for others.
        for field_of_view_rad in [TAU, TAU - 5e-7, TAU - 1e-10, 4.0] {
            let laser = LaserOptions { sigma_m: 1e-4, resolution_m: 0.0, field_of_view_rad, ..NOMINAL.laser };
            let nominal =
                Nominal::new(Arc::clone(&map), laser, None, NOMINAL.odometry, Effects::none()).unwrap();
            let pane = vec![[DVec2::new(2.0, 0.4), DVec2::new(3.0, 0.4)]];
            let effects = [
                (EffectKind::Glass, vec![0.9], pane),
                (EffectKind::MissingObject, vec![3.0, 2.2, 0.3], Vec::new()),
                (EffectKind::IncidenceBias, vec![0.01], Vec::new()),
                (EffectKind::MixedPixels, vec![0.5], Vec::new()),
            ]
            .map(|(kind, values, place)| Effect::new(kind, values, place).unwrap());
            let drive = record_library(&nominal, &TRUTH, &effects, Regime::default(), 3).unwrap();
            let recorded = Recorded::new(&drive, 60, 72, |_| true).unwrap();
            let effects = nominal.effects_with(&effects).unwrap();
            let views = Views::new(&nominal, &recorded, &effects).unwrap();
            let density = Density { laser: &nominal.laser, effects: &effects, blocks: 1.0 };
            let (mut behind, mut slanted) = (0, 0);
            for scan in 0..recorded.scans() {
                let readings = &recorded.readings[scan * recorded.beams()..];
                for (beam, &z) in views.scan(scan).iter().zip(readings) {
                    let floor = 2e-6 / nominal.laser.max_range_m;
                    let found = density.terms(beam, 0.0, f64::from(z)).density;
                    assert!(found > floor, "{z} is not expected of {beam:?}: {found}");
                    behind += u32::from(beam.view.behind.is_some_and(|at| (f64::from(z) - at).abs() < 1e-3));
                    slanted += u32::from(beam.object.is_some() && beam.view.incidence > 0.8);
                }
            }
            assert!(behind > 50 && slanted > 50, "{behind} {slanted}");
        }
    }

    /// A disc's range changes with the pose as the jacobian says.
    #[test]
    fn a_disc_gets_nearer_as_the_jacobian_says() {
        let disc = Effect::new(EffectKind::MissingObject, vec![3.0, 2.0, 0.4], Vec::new()).unwrap();
        let effects = NOMINAL.effects_with(&[disc]).unwrap();
        let drive = record_library(&NOMINAL, &TRUTH, &[], Regime::default(), 2).unwrap();
        let recorded = Recorded::new(&drive, 40, 72, |_| true).unwrap();
        let cast = |move_by: [f64; 3]| {
            let poses = recorded.track.poses().iter();
            let poses = poses.map(|p| Pose2::new(p.x + move_by[0], p.y + move_by[1], p.theta + move_by[2]));
            let track = recorded.track.with_poses(poses.collect());
            let moved = Recorded { track, ..recorded.clone() };
            Views::new(&NOMINAL, &moved, &effects).unwrap().beams
        };
        let still = cast([0.0; 3]);
        let mut compared = 0;
        for axis in 0..3 {
            let mut step = [0.0; 3];
            step[axis] = 1e-6;
            for (before, after) in still.iter().zip(cast(step)) {
                if let (Some(a), Some(b)) = (before.object, after.object)
                    && before.view.incidence < 1.2
                {
                    let change = (b - a) / 1e-6;
                    assert!((change - before.jacobian[axis]).abs() < 1e-3, "{axis} {change} {before:?}");
                    compared += 1;
                }
            }
        }
        assert!(compared > 100, "{compared}");
    }

    /// Entries are the exponential of minus what is expected up to their ranges, by an integral summed otherwise.
    #[test]
    fn survival_is_that_of_the_expected_blocks() {
        let blocks = NOMINAL.integral_over(NOMINAL.blocks_with(&NOMINAL.effects).as_ref()).unwrap().unwrap();
        let mut scratch = Vec::new();
        for i in 0..40 {
            let angle = 0.3 * f64::from(i);
            let (origin, direction) = (DVec2::new(1.0 + 0.1 * f64::from(i), 1.7), DVec2::from_angle(angle));
            let limit = 2.5 + 0.013 * f64::from(i);
            let survival = Survival::new(&blocks, origin, direction, origin, limit, &mut scratch);
            for (entry, &probability) in survival.probability.iter().enumerate() {
                let range = survival.start_m + entry as f64 * BIN_M;
                let mut expected = 0.0;
                blocks.stretches(origin, direction, origin, limit, |near, far, count| {
                    let share = if far > near {
                        (range - near) / (far - near)
                    } else {
                        f64::from(u8::from(range > near))
                    };
                    expected += count * share.clamp(0.0, 1.0);
                });
                let probability = f64::from(probability);
                assert!(
                    (probability - (-expected).exp()).abs() < 1e-6,
                    "{i} {entry} {probability} {expected}"
                );
            }
        }
    }

    /// What is half a metre before a wall at 3 m is a metre before one at 4 m, among blocks twice as deep.
    #[test]
    fn what_is_taken_over_is_aligned_at_the_wall_and_stretched_away_from_it() {
        let near = Survival { start_m: 2.5, bin_m: 0.25, probability: [1.0, 0.75, 0.5].into() };
        let far = near.moved(3.0, 4.0, 2.0);
        assert_eq!((far.start_m, far.bin_m), (3.0, 0.5));
        assert!(Arc::ptr_eq(&far.probability, &near.probability));
    }

    /// Blocks of a world in which they are deeper are looked for anew.
    #[test]
    fn deeper_blocks_are_in_the_way_of_more_beams() {
        let drive = record_library(&NOMINAL, &TRUTH, &[], Regime::default(), 2).unwrap();
        let recorded = Recorded::new(&drive, 40, 72, |_| true).unwrap();
        let deeper = Effect::new(EffectKind::BlockDepth, vec![2.0], Vec::new()).unwrap();
        let effects = NOMINAL.effects_with(&[deeper]).unwrap();
        let nominal = Views::new(&NOMINAL, &recorded, &NOMINAL.effects).unwrap();
        let views = nominal.with(&NOMINAL, &recorded, &effects).unwrap();
        let clear = |views: &Views| views.beams.iter().map(|beam| beam.log_clear).sum::<f64>();
        assert!(clear(&views) < 1.1 * clear(&nominal), "{} {}", clear(&views), clear(&nominal));
        // Nominal ones don't reach 0.7 m into the room.
        let far_out = |views: &Views| -> f64 {
            let straight = views.beams.iter().filter(|beam| beam.view.incidence < 0.3);
            straight.map(|beam| beam.survival_at(beam.view.range - 0.75).1).sum()
        };
        assert!(far_out(&views) > 10.0 * far_out(&nominal), "{} {}", far_out(&views), far_out(&nominal));
    }
}
