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
    /// An hour on two cores: every row of the table
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

/// Of kinds and forms each of the other setups has one in so many, so that all of them together have each once.
const KINDS_PER_SETUP: usize = Setup::OTHERS.len();

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

/// The stretch of a wall, at most so long \[m\], around where a ray meets it.
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
    Some([a + lo * along, a + hi * along])
}

/// Draws what is hidden in a log.
type Hide<'a> = Box<dyn Fn(&Draw) -> Hidden + 'a>;

/// Purpose, name, information and regime of a log, and what is hidden in it.
type Planned<'a> = (Group, String, f64, usize, Hide<'a>);

/// What has come to the suite since its first seeds, in this order: strong effects, each kind and each form once, of one of the informations
/// in turn; more from outside of the library; courses; and more from outside again.
fn added_effects<'a>(
    size: Size,
    repeats: u32,
    seed: u64,
    map: &'a ExactRangeMap,
    poses: &'a [Pose2],
) -> Vec<Planned<'a>> {
    let strong = |i: usize| STRONG[(i + seed as usize) % STRONG.len()];
    let of_form = |group: Group, name: String, lambda: f64, form: OtherForm| {
        let hide: Hide<'a> = Box::new(move |draw| {
            let (effect, index) = typical(form.kind(), map, poses, draw);
            Hidden::Other(form, effect, index)
        });
        (group, name, lambda, 0, hide)
    };
    let mut all = Vec::new();
    let is_asked = |i: usize| size != Size::Small || i == STRONG_OF_SMALL;
    for repeat in 0..repeats as usize {
        for (i, kind) in REGULAR.into_iter().enumerate().filter(|(i, _)| is_asked(*i)) {
            let lambda = strong(i + repeat);
            let hide: Hide<'a> = Box::new(move |draw| Hidden::Library(vec![typical(kind, map, poses, draw)]));
            all.push((Group::Strong, format!("strong-{kind}-{lambda}"), lambda, 0, hide));
        }
        for (i, form) in OtherForm::ALL.into_iter().enumerate().filter(|(i, _)| is_asked(*i)) {
            let lambda = strong(i + repeat);
            let name = format!("strong-other-{}-{lambda}", form.kind());
            all.push(of_form(Group::StrongOther, name, lambda, form));
        }
    }
    if size == Size::Small {
        return all;
    }
    let outside = |&(kind, strength): &(Outside, f64)| -> Planned<'a> {
        let name = format!("outside-{}", kind.name());
        (Group::Outside, name, 100.0, 0, Box::new(move |_| Hidden::Outside(kind, strength)))
    };
    all.extend((0..repeats).flat_map(|_| &MORE_OUTSIDE).map(outside));
    for (i, form) in OtherForm::COURSES.into_iter().enumerate() {
        for (group, lambda) in [(Group::Other, 100.0), (Group::StrongOther, strong(i))] {
            all.push(of_form(group, format!("course-{}-{lambda}", form.kind()), lambda, form));
        }
    }
    all.extend(LAST_OUTSIDE.iter().map(outside));
    all
}

/// What the logs of another setup have: nothing, strong effects, and effects from outside of the library.
fn of_setup<'a>(
    number: usize,
    repeat: usize,
    seed: u64,
    map: &'a ExactRangeMap,
    poses: &'a [Pose2],
) -> Vec<Planned<'a>> {
    let mut all: Vec<Planned<'a>> = Vec::new();
    for regime in [0, 2] {
        let name = format!("null-{}", REGIMES[regime].0);
        all.push((Group::Null, name, 0.0, regime, Box::new(|_| Hidden::Library(Vec::new()))));
    }
    let is_asked = |i: &usize| (i + number + repeat + seed as usize).is_multiple_of(KINDS_PER_SETUP);
    let strong = |i: usize| STRONG[(i / KINDS_PER_SETUP + number + seed as usize) % STRONG.len()];
    for i in (0..REGULAR.len()).filter(is_asked) {
        let (kind, lambda) = (REGULAR[i], strong(i));
        let hide: Hide<'a> = Box::new(move |draw| Hidden::Library(vec![typical(kind, map, poses, draw)]));
        all.push((Group::Strong, format!("strong-{kind}-{lambda}"), lambda, 0, hide));
    }
    let forms: Vec<OtherForm> = OtherForm::ALL.into_iter().chain(OtherForm::COURSES).collect();
    for i in (0..forms.len()).filter(is_asked) {
        let (form, lambda) = (forms[i], strong(i));
        let hide: Hide<'a> = Box::new(move |draw| {
            let (effect, index) = typical(form.kind(), map, poses, draw);
            Hidden::Other(form, effect, index)
        });
        all.push((Group::StrongOther, format!("strong-other-{}-{lambda}", form.kind()), lambda, 0, hide));
    }
    let outside: Vec<&(Outside, f64)> = OUTSIDE.iter().chain(&MORE_OUTSIDE).chain(&LAST_OUTSIDE).collect();
    for i in (0..outside.len()).filter(is_asked) {
        let &(kind, strength) = outside[i];
        let hide: Hide<'a> = Box::new(move |_| Hidden::Outside(kind, strength));
        all.push((Group::Outside, format!("outside-{}", kind.name()), 100.0, 0, hide));
    }
    all
}

/// The logs of all other setups, which the small suite hasn't.
fn of_setups<'a>(
    size: Size,
    repeats: u32,
    seed: u64,
    map: &'a ExactRangeMap,
    poses: &'a [Pose2],
) -> Vec<(Setup, Planned<'a>)> {
    let setups = if size == Size::Small { &[] } else { &Setup::OTHERS[..] };
    let mut all = Vec::new();
    for (number, &setup) in setups.iter().enumerate() {
        for repeat in 0..repeats as usize {
            for (group, name, lambda, regime, hidden) in of_setup(number, repeat, seed, map, poses) {
                all.push((setup, (group, format!("{}-{name}", setup.name()), lambda, regime, hidden)));
            }
        }
    }
    all
}

/// All logs of a size, the ones that answer most first.
pub fn plan(size: Size, seed: u64, map: &ExactRangeMap, poses: &[Pose2]) -> Vec<Case> {
    let (nulls, repeats, lambdas): (u32, u32, &[f64]) = match size {
        Size::Small => (1, 1, &[100.0]),
        Size::Medium => (6, 1, &[25.0, 50.0, 100.0]),
        Size::Full => (200, 8, &[25.0, 50.0, 100.0]),
    };
    // Two kinds in turn, as regimes alternate from one kind to the next.
    let is_asked = |i: usize, lambda: f64| {
        size != Size::Medium || lambda < 100.0 || (i as u64 / 2 + seed).is_multiple_of(2)
    };
    let mut cases = Vec::new();
    let mut add_to = |setup: Setup,
                      group: Group,
                      name: String,
                      lambda: f64,
                      regime: usize,
                      hidden: &dyn Fn(&Draw) -> Hidden,
                      without: Vec<EffectKind>| {
        let number = cases.len() as u32;
        let draw = Draw::new(seed, Stage::Trial, FIRST_CASE + number);
        let id = format!("{number:04}-{name}");
        cases.push(Case {
            id,
            group,
            setup,
            lambda,
            regime,
            hidden: hidden(&draw),
            without,
            seed: draw.seed(1),
        });
    };
    let mut add = |group, name, lambda, regime, hidden: &dyn Fn(&Draw) -> Hidden, without| {
        add_to(Setup::Scenario, group, name, lambda, regime, hidden, without);
    };
    let regimes = if size == Size::Small { 2 } else { REGIMES.len() };
    for round in 0..nulls {
        for (regime, (regime_name, _)) in REGIMES.iter().enumerate().take(regimes) {
            let name = format!("null-{regime_name}-{round}");
            add(Group::Null, name, 0.0, regime, &|_| Hidden::Library(Vec::new()), Vec::new());
        }
    }
    for repeat in 0..repeats {
        for (i, kind) in REGULAR.into_iter().enumerate() {
            for &lambda in lambdas.iter().filter(|lambda| is_asked(i, **lambda)) {
                // Regimes in turn, exact references more often.
                let regime = if size == Size::Small { 0 } else { [0, 2, 0, 1][(i + repeat as usize) % 4] };
                let name = format!("{kind}-{lambda}");
                let hidden = |draw: &Draw| Hidden::Library(vec![typical(kind, map, poses, draw)]);
                add(Group::Same, name, lambda, regime, &hidden, Vec::new());
            }
        }
        let forms: &[OtherForm] = if size == Size::Small {
            &[OtherForm::IncidenceBias, OtherForm::HeavyTail]
        } else {
            &OtherForm::ALL
        };
        for (i, &form) in forms.iter().enumerate() {
            for &lambda in lambdas.iter().filter(|lambda| is_asked(i, **lambda)) {
                let regime = if size == Size::Small { 0 } else { [0, 2, 0, 1][(i + repeat as usize) % 4] };
                let name = format!("other-{}-{lambda}", form.kind());
                let hidden = |draw: &Draw| {
                    let (effect, index) = typical(form.kind(), map, poses, draw);
                    Hidden::Other(form, effect, index)
                };
                add(Group::Other, name, lambda, regime, &hidden, Vec::new());
            }
        }
        let outside = if size == Size::Small { &OUTSIDE[4..5] } else { &OUTSIDE[..] };
        for &(kind, strength) in outside {
            let name = format!("outside-{}", kind.name());
            add(Group::Outside, name, 100.0, 0, &|_| Hidden::Outside(kind, strength), Vec::new());
        }
        if size == Size::Small {
            continue;
        }
        for (a, b) in PAIRS {
            let hidden = |draw: &Draw| {
                Hidden::Library(vec![typical(a, map, poses, draw), typical(b, map, poses, &draw.at(50_000))])
            };
            add(Group::Pair, format!("pair-{a}-{b}"), 100.0, 0, &hidden, Vec::new());
        }
        for (kind, strength) in MISLEADING {
            let hidden = |draw: &Draw| {
                let (mut effect, index) = typical(kind, map, poses, draw);
                let neutral = kind.parameters()[index].neutral;
                effect.values[index] = neutral + strength.copysign(effect.values[index] - neutral);
                Hidden::Given(effect)
            };
            add(Group::Filter, format!("filter-{kind}"), 0.0, 0, &hidden, Vec::new());
        }
        for kind in REMOVED {
            let hidden = |draw: &Draw| Hidden::Library(vec![typical(kind, map, poses, draw)]);
            add(Group::Removed, format!("removed-{kind}"), 100.0, 0, &hidden, vec![kind]);
        }
    }
    // Last, so that the other logs are those of earlier suites.
    for (group, name, lambda, regime, hidden) in added_effects(size, repeats, seed, map, poses) {
        add(group, name, lambda, regime, &hidden, Vec::new());
    }
    for (setup, (group, name, lambda, regime, hidden)) in of_setups(size, repeats, seed, map, poses) {
        add_to(setup, group, name, lambda, regime, &hidden, Vec::new());
    }
    in_order_of_chance(cases, seed)
}

/// So that a part of the suite is a sample of it.
fn in_order_of_chance(cases: Vec<Case>, seed: u64) -> Vec<Case> {
    let draw = Draw::new(seed, Stage::Trial, ORDER);
    let mut order: Vec<(u64, Case)> =
        cases.into_iter().enumerate().map(|(i, case)| (draw.seed(i as u32), case)).collect();
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
            assert_eq!(one.iter().filter(|(_, of)| *of == setup).count(), kinds.len() / KINDS_PER_SETUP);
        }
    }
}
