use std::f64::consts::TAU;

use clap::ValueEnum;
use glam::DVec2;
use locsim_core::{Draw, Pose2, Stage};
use locsim_gap::hidden::Regime;
use locsim_world::effect::{Effect, EffectKind};
use locsim_world::raycast::ExactRangeMap;
use rand::RngExt;
use serde::{Deserialize, Serialize};

use super::Setup;
use crate::hidden::{OtherForm, Outside};

/// Steps of the suite's seeds: the order of its cases, the search of a case, and its cases from the first on.
const ORDER: u32 = 99;
pub(super) const SEARCH: u32 = 200;
const FIRST_CASE: u32 = 100;

/// How much of the suite is run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Size {
    /// Minutes: logs with nothing hidden, each effect once, two other forms, one from outside of the library
    #[default]
    Small,
    // Of effects of information 100, which are nearly always named, half of the kinds; a seed that is even has those that an odd
    // one hasn't.
    /// Two hours on two cores: every row of the table
    Medium,
    /// A day: the logs that the intervals of the figures ask for
    Full,
}

/// Purposes of logs in the suite.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Group {
    /// Nothing is hidden.
    Null,
    /// One effect of the library, in the library's form.
    Same,
    /// One effect of the library, in another form.
    Other,
    /// One strong effect of the library, in the library's form.
    Strong,
    /// One strong effect of the library, in another form.
    StrongOther,
    /// Two effects.
    Pair,
    /// An effect that isn't in the library.
    Outside,
    /// An effect whose stage is taken out of the library.
    Removed,
    /// An effect strong enough to mislead a filter.
    Filter,
}

/// A hidden effect before its strength is set.
#[derive(Clone, Debug, PartialEq)]
pub enum Hidden {
    Library(Vec<(Effect, usize)>),
    /// One that is as strong as it is.
    Given(Effect),
    Other(OtherForm, Effect, usize),
    Outside(Outside, f64),
}

/// One log of the suite.
#[derive(Clone, Debug, PartialEq)]
pub struct Case {
    /// Names its files.
    pub id: String,
    pub group: Group,
    pub setup: Setup,
    pub lambda: f64,
    pub regime: usize,
    pub hidden: Hidden,
    pub without: Vec<EffectKind>,
    pub seed: u64,
}

/// The regimes, in the order of their numbers.
pub const REGIMES: [(&str, Regime); 4] = [
    ("resampled_exact", Regime { persistent_blocks: false, pose_error: None }),
    ("persistent_exact", Regime { persistent_blocks: true, pose_error: None }),
    ("resampled_autocorrelated", Regime { persistent_blocks: false, pose_error: Some(Regime::POSE_ERROR) }),
    ("persistent_autocorrelated", Regime { persistent_blocks: true, pose_error: Some(Regime::POSE_ERROR) }),
];

/// Kinds whose strength is set by information. Quantization has none: any step can be seen. The density of blocks is
/// a nuisance of every hypothesis.
const REGULAR: [EffectKind; 24] = [
    EffectKind::RangeBias,
    EffectKind::RangeScale,
    EffectKind::IncidenceBias,
    EffectKind::RangeNoise,
    EffectKind::IncidenceNoise,
    EffectKind::HeavyTail,
    EffectKind::IncidenceDropout,
    EffectKind::RangeDropout,
    EffectKind::MixedPixels,
    EffectKind::Glass,
    EffectKind::MovedWall,
    EffectKind::MissingObject,
    EffectKind::MountYaw,
    EffectKind::MountOffset,
    EffectKind::TimeOffset,
    EffectKind::MotionSkew,
    EffectKind::WarmupDrift,
    EffectKind::SectorOcclusion,
    EffectKind::Crosstalk,
    EffectKind::BlockDepth,
    EffectKind::OdomDistanceScale,
    EffectKind::OdomTurnScale,
    EffectKind::OdomImbalance,
    EffectKind::WheelSlip,
];

/// Informations of strong effects, one for each kind in turn.
const STRONG: [f64; 3] = [400.0, 2500.0, 10_000.0];
/// The index of the kind, and of the form, that the small suite has a strong effect of.
const STRONG_OF_SMALL: usize = 1;

/// Pairs that have little to do with each other.
const PAIRS: [(EffectKind, EffectKind); 8] = [
    (EffectKind::RangeBias, EffectKind::IncidenceDropout),
    (EffectKind::MountYaw, EffectKind::HeavyTail),
    (EffectKind::TimeOffset, EffectKind::Glass),
    (EffectKind::RangeNoise, EffectKind::OdomDistanceScale),
    (EffectKind::SectorOcclusion, EffectKind::RangeScale),
    (EffectKind::MovedWall, EffectKind::Crosstalk),
    (EffectKind::RangeDropout, EffectKind::MountOffset),
    (EffectKind::MissingObject, EffectKind::IncidenceNoise),
];

/// Strengths of effects outside the library that can be seen well, in their own units.
const OUTSIDE: [(Outside, f64); 8] = [
    (Outside::PeriodicBias, 0.004),
    (Outside::BearingBias, 0.003),
    (Outside::BackgroundLight, 0.02),
    (Outside::SurfaceBias, 0.008),
    (Outside::SharedScanJitter, 0.006),
    (Outside::LogNormalNoise, 0.7),
    (Outside::DoubleReturn, 0.02),
    (Outside::FloorHit, 0.08),
];

/// More of them, which come last in the plan.
const MORE_OUTSIDE: [(Outside, f64); 6] = [
    (Outside::BearingRipple, 0.008),
    (Outside::Stripes, 0.015),
    (Outside::NeighbourNoise, 0.8),
    (Outside::SecondReflection, 0.3),
    (Outside::NearLoss, 0.3),
    (Outside::OdometryLag, 0.2),
];

/// More of them, which come after those and the courses.
const LAST_OUTSIDE: [(Outside, f64); 3] =
    [(Outside::ThermalWave, 0.01), (Outside::BentFloor, 0.08), (Outside::FrameTurned, 0.007)];

/// Effects that mislead a filter, with their strengths.
const MISLEADING: [(EffectKind, f64); 5] = [
    (EffectKind::RangeBias, 0.06),
    (EffectKind::MountYaw, 0.04),
    (EffectKind::MountOffset, 0.1),
    (EffectKind::TimeOffset, 0.15),
    (EffectKind::OdomImbalance, 0.15),
];

/// Kinds whose stage is taken out of the library.
const REMOVED: [EffectKind; 6] = [
    EffectKind::IncidenceDropout,
    EffectKind::Glass,
    EffectKind::SectorOcclusion,
    EffectKind::HeavyTail,
    EffectKind::MissingObject,
    EffectKind::OdomDistanceScale,
];

/// A typical effect of a kind, somewhere in the world, and which of its numbers is its strength.
fn typical(kind: EffectKind, map: &ExactRangeMap, poses: &[Pose2], draw: &Draw) -> (Effect, usize) {
    let mut rng = draw.item(0);
    let mut values: Vec<f64> = kind.parameters().iter().map(|parameter| parameter.start).collect();
    let mut place = Vec::new();
    let mut index = 0;
    match kind {
        EffectKind::IncidenceDropout => {
            (values[0], values[1], values[2]) = (0.05, 0.9 + 0.3 * rng.random::<f64>(), 0.08);
        }
        EffectKind::RangeDropout => (values[0], values[1]) = (0.05, 4.0),
        EffectKind::WarmupDrift => (values[0], values[1]) = (0.003, 15.0),
        EffectKind::SectorOcclusion => {
            let from = -3.0 + 5.0 * rng.random::<f64>();
            values = vec![from, from + 0.35, 0.3 + 0.4 * rng.random::<f64>(), 0.05];
            index = 3;
        }
        EffectKind::Crosstalk => values[0] = 0.05,
        EffectKind::WheelSlip => (values[0], values[1]) = (0.05, 0.5),
        EffectKind::MountOffset => (values[0], values[1]) = (0.003, 0.0),
        EffectKind::Glass | EffectKind::MovedWall => {
            // A stretch that the robot passes by.
            let pose = poses[(rng.random::<f64>() * poses.len() as f64) as usize % poses.len()];
            let side =
                DVec2::from_angle(if rng.random::<bool>() { 0.5 } else { -0.5 } * std::f64::consts::PI);
            if let Some(stretch) = wall_at(map, pose.position(), side, 2.0) {
                place.push(stretch);
            }
            if kind == EffectKind::MovedWall {
                values[0] = 0.005;
            }
        }
        EffectKind::MissingObject => {
            // Beside the path, in free space.
            for _ in 0..200 {
                let pose = poses[(rng.random::<f64>() * poses.len() as f64) as usize % poses.len()];
                let at = pose.position()
                    + (0.8 + 0.6 * rng.random::<f64>()) * DVec2::from_angle(TAU * rng.random::<f64>());
                let clear = poses.iter().all(|p| p.position().distance(at) > 0.6);
                if clear && map.geometry().is_free(at.x, at.y) {
                    (values[0], values[1]) = (at.x, at.y);
                    break;
                }
            }
            values[2] = 0.05;
            index = 2;
        }
        _ => {}
    }
    // Blocks can be many times deeper, but no flatter than nothing.
    let two_sided =
        kind != EffectKind::BlockDepth && kind.parameters()[index].lo < kind.parameters()[index].neutral;
    if two_sided && rng.random::<bool>() {
        values[index] = 2.0 * kind.parameters()[index].neutral - values[index];
    }
    (Effect { kind, values, place }, index)
}

/// The stretch of a wall, at most so long \[m\], around where a ray meets it; the ray comes from its right.
fn wall_at(map: &ExactRangeMap, from: DVec2, direction: DVec2, length: f64) -> Option<[DVec2; 2]> {
    let hit = map.cast_ray(from, direction, 50.0)?;
    let at = from + hit.range * direction;
    let near = |[a, b]: &[DVec2; 2]| {
        let along = (*b - *a).normalize();
        let t = (at - *a).dot(along).clamp(0.0, a.distance(*b));
        (*a + t * along).distance(at) < 1e-3
    };
    let [a, b] = *map.geometry().segments().iter().find(|segment| near(segment))?;
    let along = (b - a).normalize();
    let middle = (at - a).dot(along);
    let (lo, hi) = ((middle - 0.5 * length).max(0.0), (middle + 0.5 * length).min(a.distance(b)));
    let [from, to] = [lo, hi].map(|at| a + at * along);
    Some(if along.perp_dot(direction) > 0.0 { [from, to] } else { [to, from] })
}

/// Draws what is hidden in a log.
type Hide<'a> = Box<dyn Fn(&Draw) -> Hidden + 'a>;

/// A log before it has a number, by which everything random in it is drawn.
struct Planned<'a> {
    group: Group,
    setup: Setup,
    name: String,
    lambda: f64,
    regime: usize,
    without: Vec<EffectKind>,
    hide: Hide<'a>,
}

impl<'a> Planned<'a> {
    /// With the scenario's own setup, in the first regime, and the whole library.
    fn new(group: Group, name: String, lambda: f64, hide: impl Fn(&Draw) -> Hidden + 'a) -> Self {
        let (setup, without) = (Setup::default(), Vec::new());
        Self { group, setup, name, lambda, regime: 0, without, hide: Box::new(hide) }
    }

    /// Nothing is hidden.
    fn null(name: String, regime: usize) -> Self {
        Self { regime, ..Self::new(Group::Null, name, 0.0, |_| Hidden::Library(Vec::new())) }
    }

    /// An effect from outside of the library, with its strength.
    fn outside(&(kind, strength): &(Outside, f64)) -> Self {
        let name = format!("outside-{}", kind.name());
        Self::new(Group::Outside, name, 100.0, move |_| Hidden::Outside(kind, strength))
    }
}

/// The world that effects are put in.
#[derive(Clone, Copy)]
struct Site<'a> {
    map: &'a ExactRangeMap,
    poses: &'a [Pose2],
}

impl<'a> Site<'a> {
    fn typical(self, kind: EffectKind, draw: &Draw) -> (Effect, usize) {
        typical(kind, self.map, self.poses, draw)
    }

    /// An effect in the library's form.
    fn of_library(self, group: Group, name: String, kind: EffectKind, lambda: f64) -> Planned<'a> {
        Planned::new(group, name, lambda, move |draw| Hidden::Library(vec![self.typical(kind, draw)]))
    }

    fn strong(self, kind: EffectKind, lambda: f64) -> Planned<'a> {
        self.of_library(Group::Strong, format!("strong-{kind}-{lambda}"), kind, lambda)
    }

    /// An effect in another form.
    fn of_form(self, group: Group, name: &str, form: OtherForm, lambda: f64) -> Planned<'a> {
        let name = format!("{name}-{}-{lambda}", form.kind());
        Planned::new(group, name, lambda, move |draw| {
            let (effect, index) = self.typical(form.kind(), draw);
            Hidden::Other(form, effect, index)
        })
    }

    fn pair(self, [a, b]: [EffectKind; 2]) -> Planned<'a> {
        Planned::new(Group::Pair, format!("pair-{a}-{b}"), 100.0, move |draw| {
            Hidden::Library(vec![self.typical(a, draw), self.typical(b, &draw.at(50_000))])
        })
    }

    /// An effect of this strength, whatever its information.
    fn misleading(self, kind: EffectKind, strength: f64) -> Planned<'a> {
        Planned::new(Group::Filter, format!("filter-{kind}"), 0.0, move |draw| {
            let (mut effect, index) = self.typical(kind, draw);
            let neutral = kind.parameters()[index].neutral;
            effect.values[index] = neutral + strength.copysign(effect.values[index] - neutral);
            Hidden::Given(effect)
        })
    }
}

/// What the suite has had since its first seeds.
fn first_effects(size: Size, repeats: u32, seed: u64, site: Site<'_>) -> Vec<Planned<'_>> {
    let (nulls, lambdas): (u32, &[f64]) = match size {
        Size::Small => (1, &[100.0]),
        Size::Medium => (6, &[25.0, 50.0, 100.0]),
        Size::Full => (200, &[25.0, 50.0, 100.0]),
    };
    // Two kinds in turn, as regimes alternate from one kind to the next.
    let is_asked = |i: usize, lambda: f64| {
        size != Size::Medium || lambda < 100.0 || (i as u64 / 2 + seed).is_multiple_of(2)
    };
    let (regimes, forms, outside) = match size {
        Size::Small => (2, &[OtherForm::IncidenceBias, OtherForm::HeavyTail][..], &OUTSIDE[4..5]),
        Size::Medium | Size::Full => (REGIMES.len(), &OtherForm::ALL[..], &OUTSIDE[..]),
    };
    let mut all = Vec::new();
    for round in 0..nulls {
        for (regime, (name, _)) in REGIMES.iter().enumerate().take(regimes) {
            all.push(Planned::null(format!("null-{name}-{round}"), regime));
        }
    }
    for repeat in 0..repeats {
        // Regimes in turn, exact references more often.
        let regime = |i: usize| if size == Size::Small { 0 } else { [0, 2, 0, 1][(i + repeat as usize) % 4] };
        for (i, kind) in REGULAR.into_iter().enumerate() {
            for &lambda in lambdas.iter().filter(|lambda| is_asked(i, **lambda)) {
                let planned = site.of_library(Group::Same, format!("{kind}-{lambda}"), kind, lambda);
                all.push(Planned { regime: regime(i), ..planned });
            }
        }
        for (i, &form) in forms.iter().enumerate() {
            for &lambda in lambdas.iter().filter(|lambda| is_asked(i, **lambda)) {
                let planned = site.of_form(Group::Other, "other", form, lambda);
                all.push(Planned { regime: regime(i), ..planned });
            }
        }
        all.extend(outside.iter().map(Planned::outside));
        if size == Size::Small {
            continue;
        }
        all.extend(PAIRS.map(|(a, b)| site.pair([a, b])));
        all.extend(MISLEADING.map(|(kind, strength)| site.misleading(kind, strength)));
        all.extend(REMOVED.map(|kind| {
            let planned = site.of_library(Group::Removed, format!("removed-{kind}"), kind, 100.0);
            Planned { without: vec![kind], ..planned }
        }));
    }
    all
}

/// What has come to the suite since its first seeds, in this order: strong effects, each kind and each form once, of one of the informations
/// in turn; more from outside of the library; courses; and more from outside again.
fn added_effects(size: Size, repeats: u32, seed: u64, site: Site<'_>) -> Vec<Planned<'_>> {
    let strong = |i: usize| STRONG[(i + seed as usize) % STRONG.len()];
    let mut all = Vec::new();
    let is_asked = |i: usize| size != Size::Small || i == STRONG_OF_SMALL;
    for repeat in 0..repeats as usize {
        for (i, kind) in REGULAR.into_iter().enumerate().filter(|(i, _)| is_asked(*i)) {
            all.push(site.strong(kind, strong(i + repeat)));
        }
        for (i, form) in OtherForm::ALL.into_iter().enumerate().filter(|(i, _)| is_asked(*i)) {
            all.push(site.of_form(Group::StrongOther, "strong-other", form, strong(i + repeat)));
        }
    }
    if size == Size::Small {
        return all;
    }
    all.extend((0..repeats).flat_map(|_| &MORE_OUTSIDE).map(Planned::outside));
    for (i, form) in OtherForm::COURSES.into_iter().enumerate() {
        for (group, lambda) in [(Group::Other, 100.0), (Group::StrongOther, strong(i))] {
            all.push(site.of_form(group, "course", form, lambda));
        }
    }
    all.extend(LAST_OUTSIDE.iter().map(Planned::outside));
    all
}

/// The logs of the other setups, which the small suite hasn't: nothing, strong effects, and effects from outside of the library. Each setup
/// has its own part of the kinds, so that all of them together have each once.
fn other_setups(size: Size, repeats: u32, seed: u64, site: Site<'_>) -> Vec<Planned<'_>> {
    if size == Size::Small {
        return Vec::new();
    }
    let setups = Setup::OTHERS.len();
    let forms: Vec<OtherForm> = OtherForm::ALL.into_iter().chain(OtherForm::COURSES).collect();
    let nameless: Vec<&(Outside, f64)> = OUTSIDE.iter().chain(&MORE_OUTSIDE).chain(&LAST_OUTSIDE).collect();
    let mut all = Vec::new();
    for (number, setup) in Setup::OTHERS.into_iter().enumerate() {
        for repeat in 0..repeats as usize {
            let is_asked = |i: &usize| (i + number + repeat + seed as usize).is_multiple_of(setups);
            let strong = |i: usize| STRONG[(i / setups + number + seed as usize) % STRONG.len()];
            let of_form = |i: usize| site.of_form(Group::StrongOther, "strong-other", forms[i], strong(i));
            let nulls = [0, 2].map(|regime| Planned::null(format!("null-{}", REGIMES[regime].0), regime));
            let planned = nulls
                .into_iter()
                .chain((0..REGULAR.len()).filter(is_asked).map(|i| site.strong(REGULAR[i], strong(i))))
                .chain((0..forms.len()).filter(is_asked).map(of_form))
                .chain((0..nameless.len()).filter(is_asked).map(|i| Planned::outside(nameless[i])));
            all.extend(planned.map(|planned| {
                let name = format!("{}-{}", setup.name(), planned.name);
                Planned { setup, name, ..planned }
            }));
        }
    }
    all
}

/// All logs of a size, in an order of chance, so that a part of the suite is a sample of it.
pub fn plan(size: Size, seed: u64, map: &ExactRangeMap, poses: &[Pose2]) -> Vec<Case> {
    let (repeats, site) = (if size == Size::Full { 8 } else { 1 }, Site { map, poses });
    // What is newer comes later, so that the other logs are those of earlier suites.
    let mut planned = first_effects(size, repeats, seed, site);
    planned.extend(added_effects(size, repeats, seed, site));
    planned.extend(other_setups(size, repeats, seed, site));
    let cases = (0..).zip(planned).map(|(number, planned)| {
        let Planned { group, setup, name, lambda, regime, without, hide } = planned;
        let draw = Draw::new(seed, Stage::Trial, FIRST_CASE + number);
        let (id, hidden, seed) = (format!("{number:04}-{name}"), hide(&draw), draw.seed(1));
        Case { id, group, setup, lambda, regime, hidden, without, seed }
    });
    let draw = Draw::new(seed, Stage::Trial, ORDER);
    let mut order: Vec<(u64, Case)> = (0..).zip(cases).map(|(i, case)| (draw.seed(i), case)).collect();
    order.sort_by_key(|(key, _)| *key);
    order.into_iter().map(|(_, case)| case).collect()
}

#[cfg(test)]
mod tests {
    use locsim_world::map::{Polyline, VectorMap};

    use super::*;

    /// Size medium: all kinds at small informations, and between two seeds in a row each once at the greatest.
    #[test]
    fn two_seeds_have_each_kind_at_the_greatest_information() {
        let corners = [[0.0, 0.0], [6.0, 0.0], [6.0, 4.0], [0.0, 4.0]];
        let outline = Polyline { points_m: corners.to_vec(), ..Polyline::default() };
        let map = VectorMap { outline, obstacles: Vec::new(), walls: Vec::new() };
        let map = ExactRangeMap::new(map.to_geometry().unwrap());
        let poses = [Pose2::new(3.0, 2.0, 0.0)];
        let names = |seed: u64, group: Group, lambda: f64| -> Vec<String> {
            let cases = plan(Size::Medium, seed, &map, &poses).into_iter();
            let asked = cases
                .filter(|case| (case.setup, case.group, case.lambda) == (Setup::Scenario, group, lambda));
            let mut names: Vec<String> = asked.map(|case| case.id[5..].to_owned()).collect();
            names.sort();
            names
        };
        for (group, kinds) in [(Group::Same, REGULAR.len()), (Group::Other, OtherForm::ALL.len())] {
            assert_eq!(names(46, group, 25.0).len(), kinds);
            assert_eq!(names(46, group, 25.0), names(47, group, 25.0));
            let mut both = [names(46, group, 100.0), names(47, group, 100.0)].concat();
            both.sort();
            both.dedup();
            both.retain(|name| !name.starts_with("course"));
            assert_eq!(both.len(), kinds);
            let chosen = names(46, group, 100.0).into_iter().filter(|name| !name.starts_with("course"));
            assert_eq!(chosen.count(), kinds / 2);
        }
        assert_eq!(names(46, Group::Null, 0.0).len(), 24);
    }

    /// All other setups together have each kind once, and another seed has it elsewhere.
    #[test]
    fn the_other_setups_share_the_kinds_among_them() {
        let corners = [[0.0, 0.0], [6.0, 0.0], [6.0, 4.0], [0.0, 4.0]];
        let outline = Polyline { points_m: corners.to_vec(), ..Polyline::default() };
        let map = VectorMap { outline, obstacles: Vec::new(), walls: Vec::new() };
        let map = ExactRangeMap::new(map.to_geometry().unwrap());
        let setups_of = |seed: u64| -> Vec<(String, Setup)> {
            let cases = plan(Size::Medium, seed, &map, &[Pose2::new(3.0, 2.0, 0.0)]).into_iter();
            let others = cases.filter(|case| case.setup != Setup::Scenario && case.group == Group::Strong);
            let mut all: Vec<(String, Setup)> = others
                .map(|case| match &case.hidden {
                    Hidden::Library(list) => (list[0].0.kind.name().to_owned(), case.setup),
                    other => panic!("{other:?}"),
                })
                .collect();
            all.sort();
            all
        };
        let (one, next) = (setups_of(46), setups_of(47));
        let mut kinds: Vec<&str> = REGULAR.iter().map(|kind| kind.name()).collect();
        kinds.sort_unstable();
        assert_eq!(one.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>(), kinds);
        assert!(one.iter().zip(&next).all(|((a, here), (b, there))| a == b && here != there));
        for setup in Setup::OTHERS {
            assert_eq!(one.iter().filter(|(_, of)| *of == setup).count(), kinds.len() / Setup::OTHERS.len());
        }
    }
}
