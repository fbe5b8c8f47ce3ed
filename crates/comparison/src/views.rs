use std::collections::HashSet;
use std::sync::Arc;

use glam::DVec2;
use locsim_world::effect::{BeamView, Description, Effect, Effects, Moves};
use locsim_world::raycast::{Unsure, unsure};
pub use locsim_world::simulation::ClutteredBeam as Beam;
use locsim_world::simulation::{
    BeamCaster, BlockIntegral, CastBeam, ClutterSurvival, Ray, Surface, WallPieces,
};
use rayon::prelude::*;

use crate::{ComparisonError, Nominal};
use locsim_core::Recorded;

/// Width of the bins of a survival among clutter \[m\]: a fraction of the depth of clutter.
const BIN_M: f64 = 0.05;
/// Clutter is integrated this far beyond a beam's end, or beyond the maximum range \[m\]: a beam that takes it over may be this
/// much longer.
const BEYOND_M: f64 = 0.3;
/// While an effect is fitted, beams of one scan and bearing share their clutter if their ends are this near to each other \[m\]:
/// half a typical block.
const SAME_END_M: f64 = 0.1;
/// The same for long beams, as seen from the laser \[rad\].
const SAME_TURN_RAD: f64 = 0.02;
/// An integral over more faces than this takes long: those of a grid's map, or of a hall with many columns.
const MANY_FACES: usize = 75;

/// All beams of a log from its reference poses, \[scan\]\[beam\].
#[derive(Clone)]
pub struct Views {
    /// The beams, \[scan\]\[beam\].
    pub beams: Vec<Beam>,
    /// Beams of a scan.
    pub per_scan: usize,
    /// The piece of a measured map's wall that each beam meets; empty of a map that is taken for exact.
    pub pieces: Vec<Option<PieceView>>,
    /// Why beams have no nominal range in a measured map; empty of a map that is taken for exact.
    pub unsure: Vec<Option<Unsure>>,
    /// The effects that they depend on.
    shaped_by: Vec<Effect>,
    /// The clutter that may be in their way.
    blocks: Option<Arc<BlockIntegral>>,
}

/// The piece of a measured map's wall that a beam meets.
#[derive(Clone, Copy, Debug)]
pub struct PieceView {
    /// Its number.
    pub piece: u32,
    /// Change of the beam's range with the piece's offset \[m/m\].
    pub lean: f64,
}

/// The effects that views depend on: those that change where beams come from or what stands in their way. All others act on the
/// distribution of a reading.
fn shaping(effects: &Effects) -> impl Iterator<Item = &Effect> {
    let hides_objects = !effects.objects().is_empty();
    effects.list().iter().filter(move |effect| {
        let Description { moves, needs, .. } = effect.kind.description();
        match moves {
            Moves::Scans | Moves::Objects | Moves::Clutter => true,
            Moves::Walls => hides_objects || needs.behind,
            Moves::Readings | Moves::Distribution | Moves::Odometry => needs.jump,
        }
    })
}

/// Whether the blocks are those of a map of many faces.
fn has_many_faces(blocks: &BlockIntegral) -> bool {
    blocks.model().face_count() > MANY_FACES
}

impl Views {
    /// Casts every beam from where the effects put the laser at the beam's own time.
    ///
    /// # Errors
    /// [`ComparisonError::Simulation`] for blocks that can't be.
    pub fn new(nominal: &Nominal, recorded: &Recorded, effects: &Effects) -> Result<Self, ComparisonError> {
        let blocks = nominal.integral_over(nominal.blocks_with(effects).as_ref())?;
        Ok(Self::cast(nominal, recorded, effects, blocks, None))
    }

    /// The same log's with other effects, as [`Views::new`] has them: beams that begin and end where they did have the same clutter in
    /// their way. These views are no quick ones.
    ///
    /// # Errors
    /// As [`Views::new`].
    pub fn anew(
        &self,
        nominal: &Nominal,
        recorded: &Recorded,
        effects: &Effects,
    ) -> Result<Self, ComparisonError> {
        let (blocks, is_same) = self.blocks_of(nominal, effects)?;
        let nearby = is_same.then_some(Nearby { views: self, sharing: Sharing::SameRays });
        Ok(Self::cast(nominal, recorded, effects, blocks, nearby))
    }

    /// Whether the world looks the same with these effects.
    pub fn are_of(&self, effects: &Effects) -> bool {
        shaping(effects).eq(&self.shaped_by)
    }

    /// The same log's with other effects, quickly: what may be in the way of a beam that ends about where it did is taken over, as
    /// while numbers are fitted.
    ///
    /// # Errors
    /// As [`Views::new`].
    pub fn with(
        &self,
        nominal: &Nominal,
        recorded: &Recorded,
        effects: &Effects,
    ) -> Result<Self, ComparisonError> {
        let (blocks, is_same) = self.blocks_of(nominal, effects)?;
        // Of many faces an integral takes long: then every beam takes over what is known, and deeper blocks are these ones,
        // stretched away from their walls.
        let is_slow = blocks.as_ref().is_some_and(|blocks| has_many_faces(blocks));
        let nearby = (is_same || is_slow).then_some(Nearby { views: self, sharing: Sharing::SimilarRays });
        Ok(Self::cast(nominal, recorded, effects, blocks, nearby))
    }

    /// The clutter in a world with these effects, and whether it is that of these views.
    fn blocks_of(
        &self,
        nominal: &Nominal,
        effects: &Effects,
    ) -> Result<(Option<Arc<BlockIntegral>>, bool), ComparisonError> {
        let blocks = nominal.blocks_with(effects);
        let is_same = blocks.as_ref() == self.blocks.as_ref().map(|blocks| blocks.model().options());
        let blocks = if is_same { self.blocks.clone() } else { nominal.integral_over(blocks.as_ref())? };
        Ok((blocks, is_same))
    }

    fn cast(
        nominal: &Nominal,
        recorded: &Recorded,
        effects: &Effects,
        blocks: Option<Arc<BlockIntegral>>,
        nearby: Option<Nearby<'_>>,
    ) -> Self {
        let depth = |blocks: &Arc<BlockIntegral>| blocks.model().options().width_m[1];
        let before = nearby.and_then(|nearby| nearby.views.blocks.as_ref());
        let deeper = blocks.as_ref().zip(before).map_or(1.0, |(now, before)| depth(now) / depth(before));
        let directions = directions(recorded, effects);
        let caster = caster(nominal, recorded, effects, &directions);
        let casts = Casts { nominal, recorded, caster, blocks: blocks.as_deref(), nearby, deeper };
        let (beams, met): (Vec<Beam>, Vec<Option<Met>>) =
            (0..recorded.scans()).into_par_iter().flat_map_iter(|scan| casts.scan(scan)).unzip();
        let (mut pieces, mut unsure) = (Vec::new(), Vec::new());
        for Met { piece, unsure: why } in met.into_iter().flatten() {
            pieces.push(piece);
            unsure.push(why);
        }
        let shaped_by = shaping(effects).cloned().collect();
        Self { beams, per_scan: recorded.beams(), pieces, unsure, shaped_by, blocks }
    }

    /// The points of a lattice near which unmapped blocks may stand; see [`BlockIntegral::lattice_in_reach`].
    pub fn blocks_in_reach(&self, side: f64, half: f64) -> HashSet<[i32; 2]> {
        self.blocks.as_ref().map_or_else(HashSet::new, |blocks| blocks.lattice_in_reach(side, half))
    }

    /// Whether a beam has no nominal range, as far as the map says.
    pub fn is_unsure(&self, beam: usize) -> bool {
        matches!(self.unsure.get(beam), Some(Some(_)))
    }

    /// How many scans there are.
    pub fn scans(&self) -> usize {
        self.beams.len() / self.per_scan
    }

    /// The beams of a scan.
    pub fn scan(&self, scan: usize) -> &[Beam] {
        &self.beams[scan * self.per_scan..][..self.per_scan]
    }
}

/// Views of the same log, whose beams share what is in their way.
#[derive(Clone, Copy)]
struct Nearby<'a> {
    views: &'a Views,
    sharing: Sharing,
}

/// Which beams share what is in their way.
#[derive(Clone, Copy)]
enum Sharing {
    /// Those that begin and end where they did.
    SameRays,
    /// Those that end about where they did.
    SimilarRays,
}

/// What a beam meets in a measured map.
struct Met {
    piece: Option<PieceView>,
    unsure: Option<Unsure>,
}

/// What a ray meets in the map, if it is a measured one; nothing, where its beam isn't looked at.
fn met(nominal: &Nominal, ray: &Ray, beam: &CastBeam, max: f64, is_ignored: bool) -> Option<Met> {
    let pieces = nominal.pieces.as_ref()?;
    if is_ignored {
        return Some(Met { piece: None, unsure: None });
    }
    // What the map lacks is known by the effect.
    let Surface::Wall(segment) = beam.surface else {
        let unsure = (beam.surface == Surface::None).then_some(Unsure::Unknown);
        return Some(Met { piece: None, unsure });
    };
    let unsure =
        unsure(&nominal.map, ray.origin, ray.direction.to_angle(), Some((segment, beam.view.range)), max);
    let piece = pieces.at(segment, beam.view.endpoint).filter(|_| unsure.is_none());
    let lean = WallPieces::lean(beam.view.incidence);
    Some(Met { piece: piece.map(|piece| PieceView { piece: piece as u32, lean }), unsure })
}

/// Directions of all beams of the log's laser on the robot.
fn directions(recorded: &Recorded, effects: &Effects) -> Vec<DVec2> {
    let laser = &recorded.log_laser;
    BeamCaster::directions(laser, &effects.laser_mount(laser.base_from_laser()))
}

/// The caster of the log's beams in a world with these effects.
fn caster<'a>(
    nominal: &'a Nominal,
    recorded: &'a Recorded,
    effects: &'a Effects,
    directions: &'a [DVec2],
) -> BeamCaster<'a> {
    let laser = &recorded.log_laser;
    BeamCaster {
        map: &nominal.map,
        moved: None,
        effects,
        laser,
        mount: effects.laser_mount(laser.base_from_laser()),
        directions,
        is_closed: nominal.laser.is_closed(),
    }
}

/// Rays of some beams of a scan.
fn rays<'a>(
    recorded: &'a Recorded,
    caster: &BeamCaster<'a>,
    scan: usize,
    beams: impl IntoIterator<Item = usize> + 'a,
) -> impl Iterator<Item = Ray> {
    caster.rays(beams, recorded.track.secs()[scan], move |secs| recorded.pose_at(scan, secs))
}

/// Where each beam that is looked at begins \[m\], and its heading in the map frame \[rad\], in the nominal world.
pub fn beam_headings(nominal: &Nominal, recorded: &Recorded) -> Vec<(DVec2, f64)> {
    let directions = directions(recorded, &nominal.effects);
    let caster = caster(nominal, recorded, &nominal.effects, &directions);
    let of_scan = |scan| rays(recorded, &caster, scan, recorded.kept.iter().copied()).collect::<Vec<Ray>>();
    let all = (0..recorded.scans()).flat_map(of_scan);
    all.map(|ray| (ray.origin, ray.direction.to_angle())).collect()
}

/// Ranges of the surfaces that the beams that are looked at meet in a world with these effects, by scan and beam \[m\]. Clutter isn't
/// looked for.
pub fn surface_ranges(nominal: &Nominal, recorded: &Recorded, effects: &Effects) -> Vec<f64> {
    let directions = directions(recorded, effects);
    let caster = caster(nominal, recorded, effects, &directions);
    let of_scan = |scan| {
        let rays: Vec<Ray> = rays(recorded, &caster, scan, recorded.kept.iter().copied()).collect();
        let mut beams = Vec::new();
        caster.cast(&rays, &mut beams);
        beams.into_iter().map(|beam| beam.range).collect::<Vec<f64>>()
    };
    (0..recorded.scans()).into_par_iter().flat_map_iter(of_scan).collect()
}

/// Casts a log's beams.
struct Casts<'a> {
    nominal: &'a Nominal,
    recorded: &'a Recorded,
    caster: BeamCaster<'a>,
    blocks: Option<&'a BlockIntegral>,
    nearby: Option<Nearby<'a>>,
    /// How much deeper blocks are than those that views nearby are of.
    deeper: f64,
}

impl Casts<'_> {
    fn scan(&self, scan: usize) -> Vec<(Beam, Option<Met>)> {
        let Self { recorded, caster, .. } = self;
        let rays_of_kept: Vec<Ray> = rays(recorded, caster, scan, recorded.kept.iter().copied()).collect();
        let mut beams = Vec::new();
        caster.cast(&rays_of_kept, &mut beams);
        if caster.effects.needs().jump {
            for (beam, jump) in beams.iter_mut().zip(jumps_of(recorded, caster, scan)) {
                beam.view.jump = jump;
            }
        }
        // Clutter keeps away from where the robot is at the scan's stamp, as in the simulator.
        let robot = recorded.track.poses()[scan].position();
        let mut counts = Vec::new();
        let max = f64::from(recorded.log_laser.max_range());
        let all = rays_of_kept.iter().zip(&beams).enumerate();
        all.map(|(i, (ray, beam))| {
            let nearby = self.nearby.map(|nearby| (nearby.sharing, &nearby.views.scan(scan)[i]));
            let is_ignored = recorded.ignored.get(scan * recorded.beams() + i) == Some(&true);
            let survival = if is_ignored {
                ClutterSurvival::clear()
            } else {
                self.survival(ray, beam, robot, nearby, &mut counts)
            };
            let object = matches!(beam.surface, Surface::Object(_)).then_some(beam.range);
            let met = met(self.nominal, ray, beam, max, is_ignored);
            (Beam::new(beam.view, object, caster.range_gradient(ray, beam), survival, max), met)
        })
        .collect()
    }

    fn survival(
        &self,
        ray: &Ray,
        beam: &CastBeam,
        robot: DVec2,
        nearby: Option<(Sharing, &Beam)>,
        counts: &mut Vec<f64>,
    ) -> ClutterSurvival {
        let Some(blocks) = self.blocks else { return ClutterSurvival::clear() };
        let laser = &self.recorded.log_laser;
        let [reach, max] = [laser.cast_range(), laser.max_range()].map(f64::from);
        let (range, endpoint) = (beam.view.range, beam.view.endpoint);
        let is_same = |other: &Beam| {
            let of = |view: &BeamView| (view.secs, view.bearing, view.range, view.endpoint);
            of(&other.view) == of(&beam.view) && !other.survival.is_clear()
        };
        let is_near = |other: &Beam| {
            let ends_near = other.view.endpoint.distance(endpoint) < SAME_END_M.max(SAME_TURN_RAD * range);
            let [is_open, other_is_open] = [range, other.view.range].map(|range| range >= reach);
            // An open beam has no wall to align the other's clutter at.
            if is_open || other_is_open {
                return is_open && other_is_open;
            }
            has_many_faces(blocks) || ends_near && (other.view.range - range).abs() < BEYOND_M
        };
        match nearby {
            Some((Sharing::SameRays, other)) if is_same(other) => return other.survival.clone(),
            Some((Sharing::SimilarRays, other)) if is_near(other) => {
                return other.survival.moved(other.view.range, range, self.deeper);
            }
            _ => {}
        }
        let limit = range.min(max) + BEYOND_M;
        ClutterSurvival::new(blocks, [ray.origin, ray.direction], robot, limit, BIN_M, counts)
    }
}

/// The range jumps of a nominal scan at the beams that are looked at.
pub fn jumps(nominal: &Nominal, recorded: &Recorded, scan: usize) -> Vec<Option<[f64; 2]>> {
    let directions = directions(recorded, &nominal.effects);
    jumps_of(recorded, &caster(nominal, recorded, &nominal.effects, &directions), scan)
}

fn jumps_of(recorded: &Recorded, caster: &BeamCaster<'_>, scan: usize) -> Vec<Option<[f64; 2]>> {
    caster.jumps(&recorded.kept, recorded.track.secs()[scan], |secs| recorded.pose_at(scan, secs))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use locsim_core::{Drive, Pose2};
    use locsim_world::effect::EffectKind;
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
                let is_taken_over = one.survival.is_shared_with(&nominal.survival);
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

    /// A thing in the room changes no beam's clutter, a laser that is elsewhere that of all beams.
    #[test]
    fn beams_that_stay_take_over_what_is_in_their_way() {
        let drive = record_library(&NOMINAL, &TRUTH, &[], Regime::default(), 2).unwrap();
        let recorded = Recorded::new(&drive, 40, 72, |_| true).unwrap();
        let nominal = Views::new(&NOMINAL, &recorded, &NOMINAL.effects).unwrap();
        let shared = |kind: EffectKind, values: &[f64]| {
            let effect = Effect::new(kind, values.to_vec(), Vec::new()).unwrap();
            let effects = NOMINAL.effects_with(&[effect]).unwrap();
            let anew = nominal.anew(&NOMINAL, &recorded, &effects).unwrap();
            let own = Views::new(&NOMINAL, &recorded, &effects).unwrap();
            for (one, own) in anew.beams.iter().zip(&own.beams) {
                assert_eq!(one.view, own.view);
                let ranges = (0..60).map(|i| 0.1 * f64::from(i));
                assert!(ranges.into_iter().all(|range| one.survival_at(range) == own.survival_at(range)));
            }
            let pairs = anew.beams.iter().zip(&nominal.beams);
            pairs.filter(|(one, nominal)| one.survival.is_shared_with(&nominal.survival)).count()
        };
        let in_room = shared(EffectKind::MissingObject, &[3.0, 2.0, 0.4]);
        assert!(2 * in_room > nominal.beams.len(), "{in_room} of {}", nominal.beams.len());
        assert_eq!(shared(EffectKind::MountOffset, &[0.01, 0.01]), 0);
        assert_eq!(shared(EffectKind::BlockDepth, &[2.0]), 0);
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
                (EffectKind::Glass, vec![0.9, 0.0], pane),
                (EffectKind::MissingObject, vec![3.0, 2.2, 0.3], Vec::new()),
                (EffectKind::IncidenceBias, vec![0.01], Vec::new()),
                (EffectKind::MixedPixels, vec![0.5], Vec::new()),
            ]
            .map(|(kind, values, place)| Effect::new(kind, values, place).unwrap());
            let drive = record_library(&nominal, &TRUTH, &effects, Regime::default(), 3).unwrap();
            let recorded = Recorded::new(&drive, 60, 72, |_| true).unwrap();
            let effects = nominal.effects_with(&effects).unwrap();
            let views = Views::new(&nominal, &recorded, &effects).unwrap();
            let density = Density::new(&nominal.laser, &effects, 1.0);
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

    /// Of every fourth scan, beams that are late are where those of the whole log are: on the path of the scans that are left out.
    #[test]
    fn late_beams_are_on_the_path_of_all_scans() {
        let drive = record_library(&NOMINAL, &TRUTH, &[], Regime::default(), 2).unwrap();
        let few =
            Drive { laser: drive.laser.clone(), steps: drive.steps.iter().step_by(4).cloned().collect() };
        let all = Recorded::new(&drive, 4000, 36, |_| true).unwrap();
        let few = Recorded::new(&few, 400, 36, |_| true).unwrap();
        let stamped = drive.steps.iter().filter_map(|step| Some((step.stamp_secs, step.reference?)));
        let along = few.clone().along(stamped);
        let late = Effect::new(EffectKind::TimeOffset, vec![0.5], Vec::new()).unwrap();
        let effects = NOMINAL.effects_with(&[late]).unwrap();
        let [all, few, along] = [&all, &few, &along].map(|log| Views::new(&NOMINAL, log, &effects).unwrap());
        let differ = |views: &Views| {
            let scans = 0..views.scans() - 1;
            scans.filter(|&scan| views.scan(scan)[0].view != all.scan(4 * scan)[0].view).count()
        };
        assert_eq!(differ(&along), 0);
        assert!(differ(&few) > 10, "{}", differ(&few));
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
