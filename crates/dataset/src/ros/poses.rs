//! Poses over time: from a topic, from the tree of transforms, or from corrections of the odometry.

use std::collections::{BTreeMap, BTreeSet};

use glam::{DAffine3, DQuat, DVec3};
use locsim_core::limits::quoted;
use locsim_core::{FASTEST, Pose2};

use super::bag::LONGEST_NAME;
use super::messages::{Pose, TransformStamped, secs};

/// A topic's messages may be logged out of order by this much (ns); further back, the clock was set.
const OUT_OF_ORDER: i64 = 1_000_000_000;

/// Pairs of frames in the tree of transforms, at the most; robots have hundreds.
const MOST_PAIRS: usize = 10_000;

/// Poses farther apart than this (ns), and than this many usual intervals, have a hole between them: what the robot did in it isn't
/// known, unless it stood still.
const HOLE: i64 = 1_000_000_000;
const HOLE_INTERVALS: i64 = 10;
/// However seldom poses come, there is a hole between those that are farther apart than this (ns): a robot doesn't drive straight for so long.
const LONGEST_STEP: i64 = 15_000_000_000;
/// A robot that moved by no more than this (m, rad) stood still: where odometry is sent in motion alone, its first step is in the hole.
const STILL: (f64, f64) = (0.1, 0.1);

/// A step between poses is a leap beyond this (m) where no robot is so fast; so many poses may lie elsewhere before the next
/// is where a robot can be.
const LEAP_M: f64 = 0.5;
const MOST_ASTRAY: usize = 10;

/// Values with the times (ns) of their headers.
pub struct Stamped<T> {
    pub items: Vec<(i64, T)>,
    latest: i64,
    /// Number of messages that were logged after a later one.
    pub late: usize,
    /// The longest time between values that is no hole (ns).
    longest_step: i64,
}

impl<T> Default for Stamped<T> {
    fn default() -> Self {
        Self { items: Vec::new(), latest: i64::MIN, late: 0, longest_step: i64::MAX }
    }
}

impl<T> Stamped<T> {
    pub fn push(&mut self, stamp: i64, value: T) -> Result<(), String> {
        if stamp < self.latest.saturating_sub(OUT_OF_ORDER) {
            let (found, latest) = (secs(stamp), secs(self.latest));
            return Err(format!("stamp is {found} s after one of {latest} s; allowed: at most 1 s back"));
        }
        self.late += usize::from(stamp < self.latest);
        self.latest = self.latest.max(stamp);
        self.items.push((stamp, value));
        Ok(())
    }

    pub fn sort(&mut self) {
        self.items.sort_by_key(|(stamp, _)| *stamp);
    }
}

impl Stamped<Pose2> {
    fn has(&self, stamp: i64) -> bool {
        self.items.binary_search_by_key(&stamp, |(time, _)| *time).is_ok()
    }

    /// The first and the last time (ns) of sorted poses.
    fn span(&self) -> Option<[i64; 2]> {
        Some([self.items.first()?.0, self.items.last()?.0])
    }

    /// Median time between poses (ns); those of one time count as one.
    fn interval(&self) -> Option<i64> {
        let mut intervals: Vec<i64> = self.items.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
        if intervals.iter().any(|interval| *interval > 0) {
            intervals.retain(|interval| *interval > 0);
        }
        intervals.sort_unstable();
        intervals.get(intervals.len() / 2).copied()
    }

    /// Sorts the poses, leaves out those that lie where no robot can be between their neighbours, and finds out from when on there is a
    /// hole between two. Returns how many are left out.
    pub fn arrange(&mut self) -> usize {
        self.sort();
        let is_leap = |(from, a): &(i64, Pose2), (to, b): &(i64, Pose2)| {
            let distance = a.position().distance(b.position());
            distance > LEAP_M && distance > FASTEST.0 * secs(to - from)
        };
        let all = std::mem::take(&mut self.items);
        let count = all.len();
        let mut i = 0;
        while i < count {
            let astray = match self.items.last() {
                Some(last) if is_leap(last, &all[i]) => {
                    // Back soon: what lies between is astray. Else the poses go on elsewhere: a jump.
                    (1..=MOST_ASTRAY).find(|more| {
                        let back = all.get(i + more);
                        back.is_some_and(|back| is_leap(&all[i + more - 1], back) && !is_leap(last, back))
                    })
                }
                _ => None,
            };
            i += astray.unwrap_or(0);
            self.items.push(all[i]);
            i += 1;
        }
        self.find_holes();
        count - self.items.len()
    }

    fn find_holes(&mut self) {
        let usual = self.interval().map_or(HOLE, |usual| usual.saturating_mul(HOLE_INTERVALS));
        self.longest_step = usual.clamp(HOLE, LONGEST_STEP);
    }

    /// The pose at a time (ns), or the `nth` of several at that very time; `None` outside the span, and in a hole unless those are
    /// `bridged`.
    fn at(&self, stamp: i64, nth: usize, bridged: bool) -> Option<Pose2> {
        let from = self.items.partition_point(|(time, _)| *time < stamp);
        let same = self.items[from..].partition_point(|(time, _)| *time == stamp);
        if same > 0 {
            return Some(self.items[from + nth.min(same - 1)].1);
        }
        let ((before, a), (after, b)) = (self.items[..from].last()?, self.items.get(from)?);
        let step = b.relative_to(a);
        let is_still = step.position().length() < STILL.0 && step.theta.abs() < STILL.1;
        if !bridged && after - before > self.longest_step && !is_still {
            return None;
        }
        let share = (stamp - before) as f64 / (after - before) as f64;
        Some(a.interpolate(b, share))
    }
}

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
        Self::Corrected { corrections: Stamped { items, ..Stamped::default() }, odometry }
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

    /// Median time between poses (s): of the slowest transform where there are several.
    pub fn interval_secs(&self) -> Option<f64> {
        match self {
            Self::Topic(poses) => poses.interval().map(secs),
            Self::Transforms(edges) => edges
                .iter()
                .filter_map(|edge| match edge {
                    Edge::Fixed(_) => None,
                    Edge::Moving { poses, .. } => poses.interval().map(secs),
                })
                .max_by(f64::total_cmp),
            Self::Corrected { corrections, .. } => corrections.interval().map(secs),
            Self::Unknown => None,
        }
    }
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

    /// Takes in a transform of one time; one between the same frames that doesn't change comes first.
    pub fn push(&mut self, stamped: &TransformStamped) -> Result<(), String> {
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
                poses.push(stamped.header.stamp.nanos(), pose)
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
    pub fn arrange(&mut self) {
        for edge in self.edges.values_mut() {
            if let Edge::Moving { poses, .. } = edge {
                poses.sort();
                poses.find_holes();
            }
        }
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
