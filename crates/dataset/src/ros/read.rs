use std::collections::BTreeMap;
use std::path::Path;

use glam::{DAffine3, DQuat, DVec3};
use locsim_core::limits::{COORDINATE, Limits, READINGS_PER_SCAN, quoted};
use locsim_core::{Drive, DriveStep, Laser, LaserError, Pose2, Scan};

use super::BagOptions;
use super::bag::{Bag, Channel, LONGEST_NAME};
use super::messages::{
    LaserScan, Message, Odometry, Pose, PoseStamped, TfMessage, TransformStamped, decode, secs,
};
use super::topics::{Chosen, Topics};
use crate::laser::checked;
use crate::{DatasetError, LogKind, LogSummary, OdometrySource};

/// A topic's messages may be logged out of order by this much (ns); further back, the clock was set.
const OUT_OF_ORDER: i64 = 1_000_000_000;

/// A laser that scans in the plane has its axis this near to the vertical: the cosine of 10 degrees.
const UPRIGHT: f64 = 0.985;

/// Frames that static transforms tell of, at the most; robots have hundreds.
const MOST_FRAMES: usize = 10_000;

/// What a drive's base is called, after the odometry's own name for it (REP-105).
const BASE_FRAMES: [&str; 2] = ["base_link", "base_footprint"];

pub fn read(path: &Path, options: &BagOptions, limits: &Limits) -> Result<(Drive, LogSummary), DatasetError> {
    let bag = Bag::open(path, limits)?;
    let topics = Topics::of(path, &bag)?;
    let chosen = topics.choose(&options.topics)?;
    let messages = Messages::read(&bag, &chosen, limits)?;
    let mount = messages.mount(options.base_from_laser).map_err(|reason| DatasetError::Message {
        path: path.to_owned(),
        topic: quoted(&chosen.scan.topic),
        number: 1,
        reason,
    })?;
    let laser = checked(path, messages.laser(&mount, options))?;

    let (max, min) = (laser.max_range(), laser.min_range());
    let scans = messages.scans.items.len();
    let mut steps: Vec<DriveStep> = Vec::with_capacity(scans);
    let (mut no_return, mut unusable, mut longest) = (0_usize, 0_usize, None);
    let (mut repeated, mut nth) = (0, 0);
    let mut previous = None;
    for (stamp, mut ranges) in messages.scans.items {
        // Which of the scans of this very time.
        nth = if previous == Some(stamp) { nth + 1 } else { 0 };
        previous = Some(stamp);
        let Some(odometry) = messages.odometry.at(stamp, nth) else { continue };
        for range in &mut ranges {
            if *range >= max {
                *range = max;
                no_return += 1;
            } else if range.is_nan() || *range < min || *range == 0.0 {
                *range = f32::NAN;
                unusable += 1;
            } else {
                longest = Some(range.max(longest.unwrap_or(0.0)));
            }
        }
        repeated += usize::from(nth > 0);
        steps.push(DriveStep {
            stamp_secs: secs(stamp),
            odometry,
            reference: messages.reference.at(stamp, nth),
            scan: Scan { ranges },
        });
    }
    if steps.is_empty() {
        return Err(DatasetError::NoOdometry { path: path.to_owned(), scans });
    }
    let readings = (steps.len() * laser.beam_count()) as f64;
    let summary = LogSummary {
        kind: if chosen.reference.is_some() { LogKind::Referenced } else { LogKind::Raw },
        odometry: OdometrySource::Topic,
        evidence: evidence(&chosen, &topics, &mount),
        odometry_messages: topics.count(&chosen.odometry),
        reference_messages: chosen.reference.as_ref().map_or(0, |channel| topics.count(channel)),
        skipped: topics.skipped(&chosen),
        stamps_repaired: messages.scans.late,
        stamps_repeated: repeated,
        scans_dropped: scans - steps.len(),
        intervals_without_odometry: 0,
        no_return_share: no_return as f64 / readings,
        unusable_share: unusable as f64 / readings,
        longest_return_m: longest,
        scan_source: quoted(&chosen.scan.topic),
    };
    Ok((Drive { laser, steps }, summary))
}

/// Where everything was found, in words.
fn evidence(chosen: &Chosen, topics: &Topics<'_>, mount: &Mount) -> String {
    let of = |channel: &Channel| format!("{} ({} messages)", quoted(&channel.topic), topics.count(channel));
    let reference = chosen.reference.as_ref().map_or("no topic".to_owned(), of);
    let mut evidence = format!(
        "scans from {}, odometry from {}, reference from {reference}; {}",
        of(&chosen.scan),
        of(&chosen.odometry),
        mount.evidence
    );
    for guess in &chosen.guessed {
        evidence += "; ";
        evidence += guess;
    }
    evidence
}

/// Where the laser is mounted.
struct Mount {
    base_from_laser: Pose2,
    /// The laser hangs upside down: its beams run the other way round.
    mirrored: bool,
    /// How that is known, in words.
    evidence: String,
}

/// Values of a topic with the times (ns) of their headers.
struct Stamped<T> {
    items: Vec<(i64, T)>,
    latest: i64,
    /// Number of messages that were logged after a later one.
    late: usize,
}

impl<T> Default for Stamped<T> {
    fn default() -> Self {
        Self { items: Vec::new(), latest: i64::MIN, late: 0 }
    }
}

impl<T> Stamped<T> {
    fn push(&mut self, stamp: i64, value: T) -> Result<(), String> {
        if stamp < self.latest.saturating_sub(OUT_OF_ORDER) {
            let (found, latest) = (secs(stamp), secs(self.latest));
            return Err(format!("stamp is {found} s after one of {latest} s; allowed: at most 1 s back"));
        }
        self.late += usize::from(stamp < self.latest);
        self.latest = self.latest.max(stamp);
        self.items.push((stamp, value));
        Ok(())
    }

    fn sort(&mut self) {
        self.items.sort_by_key(|(stamp, _)| *stamp);
    }
}

impl Stamped<Pose2> {
    /// The pose at a time (ns), or the `nth` of several at that very time; `None` outside the span.
    fn at(&self, stamp: i64, nth: usize) -> Option<Pose2> {
        let from = self.items.partition_point(|(time, _)| *time < stamp);
        let same = self.items[from..].partition_point(|(time, _)| *time == stamp);
        if same > 0 {
            return Some(self.items[from + nth.min(same - 1)].1);
        }
        let ((before, a), (after, b)) = (self.items[..from].last()?, self.items.get(from)?);
        let share = (stamp - before) as f64 / (after - before) as f64;
        Some(a.interpolate(b, share))
    }
}

/// What the chosen topics of a bag hold.
#[derive(Default)]
struct Messages {
    /// The first scan, without readings.
    first: Option<LaserScan>,
    scans: Stamped<Vec<f32>>,
    /// What the scans take of the limit on readings.
    readings: u64,
    time_increments_secs: f64,
    odometry: Stamped<Pose2>,
    base_frame: String,
    reference: Stamped<Pose2>,
    /// Parent and transform `parent_from_child` of each child frame.
    transforms: BTreeMap<String, (String, DAffine3)>,
}

impl Messages {
    fn read(bag: &Bag<'_>, chosen: &Chosen, limits: &Limits) -> Result<Self, DatasetError> {
        let mut read = Self::default();
        let (reference, transforms) = (chosen.reference.as_ref(), chosen.transforms.as_ref());
        let mut wanted = vec![&chosen.scan, &chosen.odometry];
        wanted.extend(reference.into_iter().chain(transforms));
        bag.read(&wanted, |channel, data| {
            if *channel == chosen.scan {
                read.scan(decode(data)?, limits)?;
            }
            if *channel == chosen.odometry {
                let odometry: Odometry = decode(data)?;
                if read.odometry.items.is_empty() {
                    read.base_frame = odometry.child_frame_id;
                }
                read.odometry.push(odometry.header.stamp.nanos(), odometry.pose.pose.projected()?)?;
            }
            if Some(channel) == reference {
                let PoseStamped { header, pose } = if channel.schema == Odometry::TYPE {
                    let Odometry { header, pose, .. } = decode(data)?;
                    PoseStamped { header, pose: pose.pose }
                } else {
                    decode(data)?
                };
                read.reference.push(header.stamp.nanos(), pose.projected()?)?;
            }
            if Some(channel) == transforms {
                let TfMessage { transforms } = decode(data)?;
                for transform in transforms {
                    read.transform(transform)?;
                }
            }
            Ok(())
        })?;
        read.scans.sort();
        read.odometry.sort();
        read.reference.sort();
        Ok(read)
    }

    fn scan(&mut self, mut scan: LaserScan, limits: &Limits) -> Result<(), String> {
        let mut ranges = std::mem::take(&mut scan.ranges);
        ranges.shrink_to_fit();
        scan.intensities = Vec::new();
        self.readings += ranges.len() as u64 + READINGS_PER_SCAN;
        if self.readings > limits.log_readings {
            return Err(Limits::refusal_above("log_readings", limits.log_readings));
        }
        if ranges.is_empty() {
            return Err("the scan has no ranges; allowed: at least one".to_owned());
        }
        if let Some(first) = &self.first {
            let beams = self.scans.items.first().map_or(0, |(_, ranges)| ranges.len());
            if ranges.len() != beams {
                return Err(format!(
                    "the scan has {} ranges; allowed: {beams}, as in the first",
                    ranges.len()
                ));
            }
            if scan.header.frame_id != first.header.frame_id {
                let (found, allowed) = (quoted(&scan.header.frame_id), quoted(&first.header.frame_id));
                return Err(format!("frame_id is `{found}`; allowed: `{allowed}`, as in the first"));
            }
            for (field, found, allowed) in [
                ("angle_min", scan.angle_min, first.angle_min),
                ("angle_increment", scan.angle_increment, first.angle_increment),
                ("range_min", scan.range_min, first.range_min),
                ("range_max", scan.range_max, first.range_max),
            ] {
                // By bits: a NaN that stays is refused as a laser.
                if found.to_bits() != allowed.to_bits() {
                    return Err(format!("{field} is {found}; allowed: {allowed}, as in the first"));
                }
            }
        }
        if !(0.0..=COORDINATE).contains(&f64::from(scan.time_increment.abs())) {
            let found = scan.time_increment;
            return Err(format!("time_increment is {found}; allowed: a finite number up to {COORDINATE:e}"));
        }
        self.time_increments_secs += f64::from(scan.time_increment);
        self.scans.push(scan.header.stamp.nanos(), ranges)?;
        self.first.get_or_insert(scan);
        Ok(())
    }

    fn transform(&mut self, stamped: TransformStamped) -> Result<(), String> {
        let TransformStamped { header, child_frame_id, transform } = stamped;
        for frame in [&header.frame_id, &child_frame_id] {
            if frame.len() > LONGEST_NAME {
                let (frame, length) = (quoted(frame), frame.len());
                return Err(format!("frame `{frame}` has {length} bytes; allowed: at most {LONGEST_NAME}"));
            }
        }
        if self.transforms.len() == MOST_FRAMES {
            return Err(format!("more than {MOST_FRAMES} frames; allowed: at most so many"));
        }
        transform.projected()?;
        let Pose { position: p, orientation: q } = transform;
        let rotation = DQuat::from_xyzw(q.x, q.y, q.z, q.w).normalize();
        let transform = DAffine3::from_rotation_translation(rotation, DVec3::new(p.x, p.y, p.z));
        self.transforms
            .insert(plain(&child_frame_id).to_owned(), (plain(&header.frame_id).to_owned(), transform));
        Ok(())
    }

    /// Where the laser is mounted: as wanted, or by the transforms.
    fn mount(&self, wanted: Option<Pose2>) -> Result<Mount, String> {
        let found = |base_from_laser, mirrored, evidence| Ok(Mount { base_from_laser, mirrored, evidence });
        if let Some(wanted) = wanted {
            return found(wanted, false, "the laser's mount is given".to_owned());
        }
        let laser = self.first.as_ref().map_or("", |first| plain(&first.header.frame_id));
        // The frames above the laser's, each with the transform that takes the laser's coordinates to it.
        let mut above = BTreeMap::from([(laser, DAffine3::IDENTITY)]);
        let (mut frame, mut from_laser) = (laser, DAffine3::IDENTITY);
        while let Some((parent, parent_from_frame)) = self.transforms.get(frame) {
            from_laser = *parent_from_frame * from_laser;
            frame = parent;
            // A circle has no end.
            if above.insert(frame, from_laser).is_some() {
                break;
            }
        }
        let [link, footprint] = BASE_FRAMES;
        let bases = [plain(&self.base_frame), link, footprint];
        let known = bases.iter().find_map(|base| Some((base, above.get(base)?)));
        let Some((base, base_from_laser)) = known.filter(|(base, _)| !base.is_empty()) else {
            let evidence = format!(
                "the laser is taken to be at the base's origin, as no static transform leads from `{}` to `{}`",
                quoted(laser),
                quoted(if bases[0].is_empty() { link } else { bases[0] })
            );
            return found(Pose2::IDENTITY, false, evidence);
        };
        let (laser, base) = (quoted(laser), quoted(base));
        let (forward, axis) = (base_from_laser.matrix3.x_axis, base_from_laser.matrix3.z_axis);
        if axis.z.abs() < UPRIGHT {
            let tilt = axis.z.acos().to_degrees();
            return Err(format!(
                "the laser `{laser}` is tilted by {tilt:.1} degrees on `{base}`; allowed: at most 10, upright or \
                 upside down"
            ));
        }
        let p = base_from_laser.translation;
        let pose = Pose2::new(p.x, p.y, forward.y.atan2(forward.x));
        found(
            pose,
            axis.z < 0.0,
            format!("the laser `{laser}` is mounted on `{base}` as static transforms say"),
        )
    }

    /// The laser that the scans describe.
    fn laser(&self, mount: &Mount, options: &BagOptions) -> Result<Laser, LaserError> {
        let first = self.first.as_ref().ok_or(LaserError::NoBeams)?;
        let beams = self.scans.items.first().map_or(0, |(_, ranges)| ranges.len());
        let side = if mount.mirrored { -1.0 } else { 1.0 };
        let interval = self.time_increments_secs / self.scans.items.len() as f64;
        let row =
            |start: f32, step: f64| (0..beams).map(move |i| (f64::from(start) + i as f64 * step) as f32);
        Laser::new(
            row(first.angle_min, f64::from(first.angle_increment)).map(|bearing| side * bearing).collect(),
            row(0.0, interval).collect(),
            options.min_range_m.unwrap_or(first.range_min),
            options.max_range_m.unwrap_or(first.range_max),
            mount.base_from_laser,
        )
    }
}

/// A frame's name without the slash that old names begin with.
fn plain(frame: &str) -> &str {
    frame.trim_start_matches('/')
}
