//! Values with the times of their headers, in the order of time.

use std::collections::BTreeSet;

use locsim_core::{FASTEST, Pose2};

use super::messages::secs;

/// A topic's messages may be logged out of order by this much (ns); further back, the clock was set.
const OUT_OF_ORDER: i64 = 1_000_000_000;

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

/// So many messages of a topic in a row, and one in so many, may have a stamp that is far off those before and after.
const MOST_STRAY: usize = 3;
const STRAY_SHARE: usize = 10;

/// Stamps say less than the times of recording where there are so many messages to one stamp, at the least.
const ALIKE: usize = 2;
/// Fewer messages tell nothing of their stamps.
const LEAST_DELAYS: usize = 10;
const SECOND: i64 = 1_000_000_000;

/// Values with the times (ns) of their headers.
pub struct Stamped<T> {
    pub items: Vec<(i64, T)>,
    /// When each was recorded (ns), until they are sorted.
    logged: Vec<i64>,
    /// Values far behind the latest, with their times of recording, until it shows which of both are astray.
    behind: Vec<(i64, i64, T)>,
    latest: i64,
    /// Messages on end that are behind the latest.
    run: Run,
    /// Number of messages that were logged after a later one.
    pub late: usize,
    pub timing: Timing,
    /// The longest time between values that is no hole (ns).
    longest_step: i64,
}

/// What the stamps of a topic are worth.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Timing {
    /// Number of messages left out, as their stamps are seconds off those before and after.
    pub astray: usize,
    /// Whether the times of recording take the place of stamps that say less.
    pub is_of_recording: bool,
    /// Median time from stamp to recording (s); `None` of a few messages.
    pub delay_secs: Option<f64>,
    /// The stamp (s) after which stamps first go on from an earlier one, and by how much that is earlier (s), as where the clock was set
    /// back by less than what messages may be out of order.
    pub set_back: Option<[f64; 2]>,
}

/// Messages on end whose stamps are behind the latest and go up.
#[derive(Clone, Copy, Debug, Default)]
struct Run {
    /// The stamp before them (ns).
    before: i64,
    /// The first of them (ns).
    first: i64,
    count: usize,
    /// Number of those of few messages, as of ones that were delayed.
    short: usize,
}

impl Run {
    fn go_on(&mut self, before: i64, stamp: i64) {
        if stamp <= before {
            self.end();
        }
        if self.count == 0 {
            (self.before, self.first) = (before, stamp);
        }
        self.count += 1;
    }

    fn end(&mut self) {
        self.short += usize::from((1..=MOST_STRAY).contains(&self.count));
        self.count = 0;
    }

    fn set_back(&self) -> Option<[f64; 2]> {
        (self.count > MOST_STRAY).then(|| [secs(self.before), secs(self.before - self.first)])
    }
}

impl<T> Default for Stamped<T> {
    fn default() -> Self {
        Self {
            items: Vec::new(),
            logged: Vec::new(),
            behind: Vec::new(),
            latest: i64::MIN,
            run: Run::default(),
            late: 0,
            timing: Timing::default(),
            longest_step: i64::MAX,
        }
    }
}

impl<T> Stamped<T> {
    /// Values in the order of time.
    pub fn of(items: Vec<(i64, T)>) -> Self {
        Self { items, ..Self::default() }
    }

    /// Takes in a value with its stamp and its time of recording (ns), in the order of recording.
    ///
    /// # Errors
    /// The clock was set back, or many stamps are far off those before and after.
    pub fn push(&mut self, stamp: i64, logged: i64, value: T) -> Result<(), String> {
        if stamp < self.latest.saturating_sub(OUT_OF_ORDER) {
            self.behind.push((stamp, logged, value));
            return if self.behind.len() > MOST_STRAY { self.go_back(MOST_STRAY) } else { Ok(()) };
        }
        self.leave_behind();
        self.take_in(stamp, logged, value);
        Ok(())
    }

    fn take_in(&mut self, stamp: i64, logged: i64, value: T) {
        if stamp < self.latest {
            self.late += 1;
            self.run.go_on(self.items.last().map_or(stamp, |(before, _)| *before), stamp);
            self.timing.set_back = self.timing.set_back.or(self.run.set_back());
        } else {
            self.run.end();
        }
        self.latest = self.latest.max(stamp);
        self.items.push((stamp, value));
        self.logged.push(logged);
    }

    /// Takes those behind for astray.
    fn leave_behind(&mut self) {
        self.timing.astray += self.behind.len();
        self.behind.clear();
    }

    /// Takes those behind for right, and those that are later for astray, where there are no more than so many of these.
    fn go_back(&mut self, most: usize) -> Result<(), String> {
        let Some(&(first, ..)) = self.behind.first() else { return Ok(()) };
        let limit = first.saturating_add(OUT_OF_ORDER);
        let ahead = self.items.iter().rev().take_while(|(stamp, _)| *stamp > limit).count();
        if ahead == 0 {
            // Not far behind the one before, if behind the latest: messages come in another order than their stamps.
            for (stamp, logged, value) in std::mem::take(&mut self.behind) {
                self.take_in(stamp, logged, value);
            }
            return Ok(());
        }
        if ahead > most {
            return Err(self.too_far_back(first));
        }
        let kept = self.items.len() - ahead;
        self.items.truncate(kept);
        self.logged.truncate(kept);
        self.timing.astray += ahead;
        self.latest = self.items.iter().map(|(stamp, _)| *stamp).max().unwrap_or(i64::MIN);
        let behind = std::mem::take(&mut self.behind);
        behind.into_iter().try_for_each(|(stamp, logged, value)| self.push(stamp, logged, value))
    }

    fn too_far_back(&self, stamp: i64) -> String {
        format!(
            "the clock was set: a stamp is {} s after one of {} s; allowed: at most 1 s back, but for a few stray messages",
            secs(stamp),
            secs(self.latest)
        )
    }

    /// Sorts by time, after the last value.
    ///
    /// # Errors
    /// Many stamps are far off those before and after.
    pub fn sort(&mut self) -> Result<(), String> {
        let behind = self.behind.len();
        if self.go_back(behind).is_err() {
            self.leave_behind();
        }
        let Timing { astray, .. } = self.timing;
        if astray * STRAY_SHARE > self.items.len() {
            return Err(format!(
                "{astray} messages have stamps that are seconds off those before and after; allowed: one in {STRAY_SHARE}"
            ));
        }
        self.run.end();
        if self.run.short > MOST_STRAY {
            self.timing.set_back = None;
        }
        self.timing.delay_secs = self.delay().map(secs);
        if self.are_stamps_alike() {
            self.timing.is_of_recording = true;
            self.items.iter_mut().zip(&self.logged).for_each(|((stamp, _), logged)| *stamp = *logged);
        }
        self.logged = Vec::new();
        self.items.sort_by_key(|(stamp, _)| *stamp);
        Ok(())
    }

    /// Median time from stamp to recording (ns); `None` of few messages, and of messages that were recorded at one time.
    fn delay(&self) -> Option<i64> {
        let are_apart = ALIKE * distinct(self.logged.iter().copied()) > self.items.len();
        let pairs = self.items.iter().zip(&self.logged);
        let mut delays: Vec<i64> = pairs.map(|((stamp, _), logged)| logged.saturating_sub(*stamp)).collect();
        delays.sort_unstable();
        (delays.len() >= LEAST_DELAYS && are_apart).then(|| delays[delays.len() / 2])
    }

    /// Whether all stamps are whole seconds that several messages share, and the times of recording tell these apart.
    fn are_stamps_alike(&self) -> bool {
        let stamps = || self.items.iter().map(|(stamp, _)| *stamp);
        stamps().all(|stamp| stamp % SECOND == 0)
            && ALIKE * distinct(stamps()) <= self.items.len()
            && self.timing.delay_secs.is_some()
    }
}

fn distinct(times: impl Iterator<Item = i64>) -> usize {
    times.collect::<BTreeSet<_>>().len()
}

impl Stamped<Pose2> {
    pub fn has(&self, stamp: i64) -> bool {
        self.items.binary_search_by_key(&stamp, |(time, _)| *time).is_ok()
    }

    /// The first and the last time (ns) of sorted poses.
    pub fn span(&self) -> Option<[i64; 2]> {
        Some([self.items.first()?.0, self.items.last()?.0])
    }

    /// Median time between poses (ns); those of one time count as one.
    pub fn interval(&self) -> Option<i64> {
        let mut intervals: Vec<i64> =
            self.items.windows(2).map(|pair| pair[1].0.saturating_sub(pair[0].0)).collect();
        if intervals.iter().any(|interval| *interval > 0) {
            intervals.retain(|interval| *interval > 0);
        }
        intervals.sort_unstable();
        intervals.get(intervals.len() / 2).copied()
    }

    /// Sorts the poses, leaves out those that lie where no robot can be between their neighbours, and finds out from when on there is a
    /// hole between two. Returns how many are left out.
    ///
    /// # Errors
    /// Many stamps are far off those before and after.
    pub fn arrange(&mut self) -> Result<usize, String> {
        self.sort()?;
        let is_leap = |(from, a): &(i64, Pose2), (to, b): &(i64, Pose2)| {
            let distance = a.position().distance(b.position());
            distance > LEAP_M && distance > FASTEST.0 * secs(to.saturating_sub(*from))
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
        Ok(count - self.items.len())
    }

    pub fn find_holes(&mut self) {
        let usual = self.interval().map_or(HOLE, |usual| usual.saturating_mul(HOLE_INTERVALS));
        self.longest_step = usual.clamp(HOLE, LONGEST_STEP);
    }

    /// The pose at a time (ns), or the `nth` of several at that very time; `None` outside the span, and in a hole unless those are
    /// `bridged`.
    pub fn at(&self, stamp: i64, nth: usize, bridged: bool) -> Option<Pose2> {
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Times of recording may be anything in a database.
    #[test]
    fn times_at_both_ends_of_the_clock_are_borne() {
        let mut poses = Stamped::of([i64::MIN, 0, i64::MAX].map(|time| (time, Pose2::IDENTITY)).to_vec());
        assert_eq!(poses.interval(), Some(i64::MAX));
        assert_eq!(poses.arrange(), Ok(0));
    }
}
