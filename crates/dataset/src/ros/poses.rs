//! Poses over time: from a topic, from the tree of transforms, or from corrections of the odometry.

use std::collections::{BTreeMap, BTreeSet};

use glam::{DAffine3, DQuat, DVec3};
use locsim_core::limits::quoted;
use locsim_core::{Pose2, wrap_angle};

use super::bag::LONGEST_NAME;
use super::messages::{Pose, TransformStamped, secs};
use super::stamped::{Stamped, Timing};

/// Pairs of frames in the tree of transforms, at the most; robots have hundreds.
const MOST_PAIRS: usize = 10_000;

/// Poses over time.
pub enum Poses<'a> {
    /// Those of a topic.
    Topic(&'a Stamped<Pose2>),
    /// Products of transforms, the last frame's first.
    Transforms(Vec<&'a Edge>),
    /// Products of corrections and of the odometry that they correct.
    Corrected { corrections: Stamped<Pose2>, odometry: &'a Poses<'a> },
    /// The origin at all times: no poses are known.
    Unknown,
}

impl<'a> Poses<'a> {
    /// Irregular poses of a localizer, with the odometry between them: what is interpolated is the transform from the
    /// odometry's frame to the map's, which changes slowly.
    pub fn corrected(poses: &Stamped<Pose2>, odometry: &'a Poses<'a>) -> Self {
        let correction = |(stamp, pose): &(i64, Pose2)| {
            let odometry = odometry.at(*stamp, 0)?;
            Some((*stamp, pose.compose(&Pose2::IDENTITY.relative_to(&odometry))))
        };
        let items = poses.items.iter().filter_map(correction).collect();
        Self::Corrected { corrections: Stamped::of(items), odometry }
    }

    /// The pose at a time (ns), or the `nth` of several at that very time; `None` outside the span.
    pub fn at(&self, stamp: i64, nth: usize) -> Option<Pose2> {
        match self {
            Self::Topic(poses) => poses.at(stamp, nth, false),
            Self::Transforms(edges) => {
                // What moves nearest to the robot is its motion; above are corrections, which change slowly.
                let lowest = edges.iter().position(|edge| matches!(edge, Edge::Moving { .. }));
                edges.iter().enumerate().try_fold(Pose2::IDENTITY, |pose, (i, edge)| {
                    Some(edge.at(stamp, nth, Some(i) != lowest)?.compose(&pose))
                })
            }
            Self::Corrected { corrections, odometry } => {
                Some(corrections.at(stamp, nth, true)?.compose(&odometry.at(stamp, nth)?))
            }
            Self::Unknown => Some(Pose2::IDENTITY),
        }
    }

    /// How far the odometry's heading is off half-way between two poses of a topic (rad, root mean square): about a half of what it errs by
    /// from one to the next. Infinite for another source.
    pub fn turn_error(&self, odometry: &Poses<'_>) -> f64 {
        let Self::Topic(poses) = self else { return f64::INFINITY };
        let errors = poses.items.array_windows().filter_map(|[a, b]| {
            let [from, to] = [a, b].map(|(stamp, _)| odometry.at(*stamp, 0));
            Some(0.5 * wrap_angle(turn([&a.1, &b.1]) - turn([&from?, &to?])))
        });
        let (sum, count) = errors.fold((0.0, 0.0), |(sum, count), error| (sum + error * error, count + 1.0));
        if count > 0.0 { f64::sqrt(sum / count) } else { f64::INFINITY }
    }

    /// The pose at a time (ns) between two poses of a topic. Where turns begin or end, an even turn is off half-way by an eighth of what turns
    /// change by. Where that is more than the odometry's `turn_error` (rad), the pose moves as the odometry does, and what the two differ by
    /// comes evenly. Elsewhere, of another source, and without odometry, it is as [`Self::at`].
    pub fn at_by_odometry(&self, stamp: i64, odometry: &Poses<'_>, turn_error: f64) -> Option<Pose2> {
        let by_odometry = || {
            let Self::Topic(poses) = self else { return None };
            let next = poses.items.partition_point(|(time, _)| *time < stamp);
            let [(before, a), (after, b)] = [poses.items.get(next.checked_sub(1)?)?, poses.items.get(next)?];
            let nearby = &poses.items[next.saturating_sub(2)..(next + 2).min(poses.items.len())];
            let changes = nearby.array_windows().map(|[(_, a), (_, b), (_, c)]| turn([b, c]) - turn([a, b]));
            let change = changes.map(|change| wrap_angle(change).abs()).fold(0.0, f64::max);
            if 0.125 * change <= turn_error {
                return None;
            }
            let [from, now, to] = [*before, stamp, *after].map(|stamp| odometry.at(stamp, 0));
            let (moved, all) = (now?.relative_to(&from?), to?.relative_to(&from?));
            let rest = b.relative_to(&a.compose(&all));
            let share = (stamp - before) as f64 / (after - before) as f64;
            Some(a.compose(&moved).compose(&Pose2::IDENTITY.interpolate(&rest, share)))
        };
        let at = self.at(stamp, 0)?;
        Some(by_odometry().unwrap_or(at))
    }

    /// The first and the last time (ns) of which a pose is known; `None` where there is none.
    pub fn span(&self) -> Option<[i64; 2]> {
        let common = |a: [i64; 2], b: [i64; 2]| [a[0].max(b[0]), a[1].min(b[1])];
        match self {
            Self::Topic(poses) => poses.span(),
            Self::Transforms(edges) => edges
                .iter()
                .filter_map(|edge| match edge {
                    Edge::Fixed(_) => None,
                    Edge::Moving { poses, .. } => poses.span(),
                })
                .reduce(common),
            Self::Corrected { corrections, odometry } => Some(common(corrections.span()?, odometry.span()?)),
            Self::Unknown => None,
        }
    }

    /// Whether a pose of this very time (ns) was recorded; otherwise [`Self::at`] interpolates.
    pub fn is_recorded(&self, stamp: i64) -> bool {
        match self {
            Self::Topic(poses) => poses.has(stamp),
            Self::Transforms(edges) => edges.iter().all(|edge| match edge {
                Edge::Fixed(_) => true,
                Edge::Moving { poses, .. } => poses.has(stamp),
            }),
            Self::Corrected { corrections, .. } => corrections.has(stamp),
            Self::Unknown => false,
        }
    }

    /// What the stamps of the motion are worth.
    pub fn timing(&self) -> Option<&Timing> {
        match self {
            Self::Topic(poses) => Some(&poses.timing),
            Self::Transforms(edges) => edges.iter().find_map(|edge| match edge {
                Edge::Fixed(_) => None,
                Edge::Moving { poses, .. } => Some(&poses.timing),
            }),
            Self::Corrected { .. } | Self::Unknown => None,
        }
    }

    /// Median time between poses of the robot's motion (s), without what corrects it.
    pub fn motion_interval_secs(&self) -> Option<f64> {
        match self {
            Self::Transforms(edges) => edges.iter().find_map(|edge| edge.interval()).map(secs),
            Self::Corrected { odometry, .. } => odometry.motion_interval_secs(),
            Self::Topic(_) | Self::Unknown => self.interval_secs(),
        }
    }

    /// Median time between corrections of the motion (s); `None` where nothing corrects it.
    pub fn correction_interval_secs(&self) -> Option<f64> {
        match self {
            Self::Transforms(edges) => {
                edges.iter().filter_map(|edge| edge.interval()).skip(1).max().map(secs)
            }
            Self::Corrected { corrections, .. } => corrections.interval().map(secs),
            Self::Topic(_) | Self::Unknown => None,
        }
    }

    /// Median time between poses (s): of the slowest transform where there are several.
    pub fn interval_secs(&self) -> Option<f64> {
        match self {
            Self::Topic(poses) => poses.interval().map(secs),
            Self::Transforms(edges) => edges.iter().filter_map(|edge| edge.interval()).max().map(secs),
            Self::Corrected { corrections, .. } => corrections.interval().map(secs),
            Self::Unknown => None,
        }
    }
}

/// The turn from one pose to another (rad).
fn turn([from, to]: [&Pose2; 2]) -> f64 {
    wrap_angle(to.theta - from.theta)
}

/// The transform `parent_from_child` of two frames.
pub enum Edge {
    /// As `/tf_static` says.
    Fixed(DAffine3),
    /// As `/tf` says, in the plane.
    Moving {
        poses: Stamped<Pose2>,
        /// The first in space.
        first: DAffine3,
        /// All are equal to the first: the transform is fixed, and only its publisher isn't.
        constant: bool,
    },
}

/// Transforms that differ by less than this (m, and elements of the rotation) are the same: publishers compute some of
/// them anew.
const SAME_TRANSFORM: f64 = 1e-6;

impl Edge {
    /// Median time between its poses (ns); `None` where it doesn't move.
    fn interval(&self) -> Option<i64> {
        match self {
            Self::Fixed(_) => None,
            Self::Moving { poses, .. } => poses.interval(),
        }
    }

    fn at(&self, stamp: i64, nth: usize, bridged: bool) -> Option<Pose2> {
        match self {
            Self::Fixed(transform) => Some(planar(transform)),
            Self::Moving { poses, .. } => poses.at(stamp, nth, bridged),
        }
    }
}

/// The tree of transforms.
#[derive(Default)]
pub struct Transforms {
    /// By child and parent.
    edges: BTreeMap<(String, String), Edge>,
    /// Static transforms that were told otherwise later, as `parent:child`.
    pub changed_static: BTreeSet<String>,
}

impl Transforms {
    /// Takes in a transform that doesn't change. The last of a child counts.
    pub fn fix(&mut self, stamped: &TransformStamped) -> Result<(), String> {
        stamped.transform.projected()?;
        let (child, parent) = frames(stamped)?;
        // As tf2 does.
        if child == parent {
            return Ok(());
        }
        let new = affine(&stamped.transform);
        if let Some(Edge::Fixed(known)) = self.edges.get(&(child.clone(), parent.clone()))
            && !known.abs_diff_eq(new, SAME_TRANSFORM)
        {
            self.changed_static.insert(format!("{}:{}", quoted(&parent), quoted(&child)));
        }
        let others = self.edges.range((child.clone(), String::new())..).take_while(|((c, _), _)| *c == child);
        let fixed = others.filter(|(_, edge)| matches!(edge, Edge::Fixed(_))).map(|(key, _)| key.clone());
        for key in fixed.collect::<Vec<_>>() {
            if key.1 != parent {
                self.changed_static.insert(format!("{}:{}", quoted(&key.1), quoted(&child)));
            }
            self.edges.remove(&key);
        }
        self.room()?;
        self.edges.insert((child, parent), Edge::Fixed(new));
        Ok(())
    }

    /// Takes in a transform of one time, recorded at another (ns); one between the same frames that doesn't change comes first.
    pub fn push(&mut self, stamped: &TransformStamped, logged: i64) -> Result<(), String> {
        let pose = stamped.transform.projected()?;
        let key = frames(stamped)?;
        if !self.edges.contains_key(&key) {
            self.room()?;
        }
        let transform = affine(&stamped.transform);
        let new = || Edge::Moving { poses: Stamped::default(), first: transform, constant: true };
        match self.edges.entry(key).or_insert_with(new) {
            Edge::Fixed(_) => Ok(()),
            Edge::Moving { poses, first, constant } => {
                *constant &= first.abs_diff_eq(transform, SAME_TRANSFORM);
                poses.push(stamped.header.stamp.nanos(), logged, pose)
            }
        }
    }

    fn room(&self) -> Result<(), String> {
        if self.edges.len() < MOST_PAIRS {
            return Ok(());
        }
        Err(format!("more than {MOST_PAIRS} pairs of frames; allowed: at most {MOST_PAIRS}"))
    }

    /// Sorts all of them. None is left out: a small turn of the map's frame moves the odometry's, which is far away, by a lot.
    ///
    /// # Errors
    /// Many stamps of one of them are far off those before and after.
    pub fn arrange(&mut self) -> Result<(), String> {
        for ((child, parent), edge) in &mut self.edges {
            if let Edge::Moving { poses, .. } = edge {
                let of = |reason| format!("{}:{}: {reason}", quoted(parent), quoted(child));
                poses.sort().map_err(of)?;
                poses.find_holes();
            }
        }
        Ok(())
    }

    /// The transforms that lead from one frame up to another, the lower frame's first.
    pub fn chain(&self, child: &str, ancestor: &str) -> Option<Vec<&Edge>> {
        let mut chain = Vec::new();
        let mut seen = vec![child.to_owned()];
        self.climb(child, ancestor, &mut seen, &mut chain).then_some(chain)
    }

    fn climb<'a>(
        &'a self,
        child: &str,
        ancestor: &str,
        seen: &mut Vec<String>,
        chain: &mut Vec<&'a Edge>,
    ) -> bool {
        if child == ancestor {
            return true;
        }
        let from_child = self.edges.range((child.to_owned(), String::new())..);
        for ((_, parent), edge) in from_child.take_while(|((from, _), _)| from == child) {
            // A circle has no end, and a tower of frames no robot.
            if seen.contains(parent) || seen.len() == DEEPEST {
                continue;
            }
            seen.push(parent.clone());
            chain.push(edge);
            if self.climb(parent, ancestor, seen, chain) {
                return true;
            }
            chain.pop();
        }
        false
    }

    /// The transform from one frame up to another by transforms that don't change, and whether all of them are static.
    pub fn fixed(&self, child: &str, ancestor: &str) -> Option<(DAffine3, bool)> {
        let Some(chain) = self.chain(child, ancestor) else {
            // Some publish the laser as the parent.
            let (from_ancestor, all_static) = fixed_along(self.chain(ancestor, child)?)?;
            return Some((from_ancestor.inverse(), all_static));
        };
        fixed_along(chain)
    }

    /// A laser's frame, its parent on the fixed way up to a base, and `base_from_parent`.
    pub fn laser_edge(&self, laser: &str, base: &str) -> Option<(String, String, DAffine3)> {
        let edges = self.edges.range((laser.to_owned(), String::new())..);
        let mut parents = edges.take_while(|((child, _), _)| child == laser).map(|((_, parent), _)| parent);
        parents.find_map(|parent| {
            let (base_from_parent, _) = fixed_along(self.chain(parent, base)?)?;
            Some((laser.to_owned(), parent.clone(), base_from_parent))
        })
    }

    /// The pairs of frames, as `parent:child`.
    pub fn pairs(&self) -> impl Iterator<Item = String> {
        self.edges.keys().map(|(child, parent)| format!("{}:{}", quoted(parent), quoted(child)))
    }
}

/// The product of transforms that don't change, and whether all of them are static.
fn fixed_along(chain: Vec<&Edge>) -> Option<(DAffine3, bool)> {
    chain.into_iter().try_fold((DAffine3::IDENTITY, true), |(from_child, all), edge| match edge {
        Edge::Fixed(transform) => Some((*transform * from_child, all)),
        Edge::Moving { first, constant: true, .. } => Some((*first * from_child, false)),
        Edge::Moving { .. } => None,
    })
}

/// Frames on the way up from a laser or a base, at the most; robots have ten.
const DEEPEST: usize = 100;

/// Child and parent, without the slash that old names begin with.
fn frames(stamped: &TransformStamped) -> Result<(String, String), String> {
    for frame in [&stamped.child_frame_id, &stamped.header.frame_id] {
        if frame.len() > LONGEST_NAME {
            let (frame, length) = (quoted(frame), frame.len());
            return Err(format!("frame `{frame}` has {length} bytes; allowed: at most {LONGEST_NAME}"));
        }
    }
    Ok((plain(&stamped.child_frame_id).to_owned(), plain(&stamped.header.frame_id).to_owned()))
}

/// A frame's name without the slash that old names begin with.
pub fn plain(frame: &str) -> &str {
    frame.trim_start_matches('/')
}

pub fn affine(transform: &Pose) -> DAffine3 {
    let Pose { position: p, orientation: q } = transform;
    let rotation = DQuat::from_xyzw(q.x, q.y, q.z, q.w).normalize();
    DAffine3::from_rotation_translation(rotation, DVec3::new(p.x, p.y, p.z))
}

/// The pose that a transform has in the plane: its x axis seen from above.
pub fn planar(transform: &DAffine3) -> Pose2 {
    let (p, forward) = (transform.translation, transform.matrix3.x_axis);
    Pose2::new(p.x, p.y, forward.y.atan2(forward.x))
}
