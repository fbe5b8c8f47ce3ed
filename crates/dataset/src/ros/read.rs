//! Reads the drive of a bag: scans, with the odometry and the reference at their times.

use std::path::Path;

use glam::DAffine3;
use locsim_core::limits::{Limits, READINGS_PER_SCAN, quoted};
use locsim_core::{Drive, DriveStep, LaserError, Pose2, Scan, median};

use super::BagOptions;
use super::bag::{Bag, Channel};
use super::cloud::Clouds;
use super::messages::{
    MULTI_ECHO_LASER_SCAN, MultiEchoLaserScan, Odometry, POINT_CLOUD_2, TfMessage, decode, secs,
};
use super::motion::{FoundOdometry, LISTED_PAIRS, Motion, UPRIGHT};
use super::poses::{Poses, affine};
use super::remarks::{Times, missing_messages};
use super::scans::{Convention, NoReturn, Scans};
use super::stamped::Stamped;
use super::topics::{Chosen, PoseSource, Topics};
use crate::laser::checked;
use crate::{DatasetError, LogSummary};

/// So many scans, and one in so many, may lie before or after the odometry without a remark.
const FEW: usize = 3;
const FEW_SHARE: usize = 50;

pub fn read(path: &Path, options: &BagOptions, limits: &Limits) -> Result<(Drive, LogSummary), DatasetError> {
    read_with_layout(path, options, limits).map(|(drive, summary, _)| (drive, summary))
}

/// Where a drive is found in a bag.
pub struct Layout {
    pub chosen: Chosen,
    /// Frame of the odometry.
    pub odom: String,
    /// The transform that mounts the laser; `None` where none does.
    pub laser: Option<LaserEdge>,
    pub convention: Convention,
    /// Number of scans whose beams aren't those of the first.
    pub resampled_scans: usize,
    /// Whether times of recording take the place of stamps.
    pub is_of_recording: bool,
}

/// The transform from a laser to its parent.
pub struct LaserEdge {
    pub frame: String,
    pub parent: String,
    pub base_from_parent: DAffine3,
}

pub fn read_with_layout(
    path: &Path,
    options: &BagOptions,
    limits: &Limits,
) -> Result<(Drive, LogSummary, Layout), DatasetError> {
    let bag = Bag::open(path, limits)?;
    let topics = Topics::of(path, &bag)?;
    let chosen = topics.choose(options)?;
    let (scans, motion) = messages(path, &bag, &chosen, limits)?;
    let odometry = if options.without_odometry {
        FoundOdometry::none()
    } else {
        motion.odometry(&chosen, &topics, scans.frame())?
    };
    let reference = motion.reference(&chosen, &topics, &odometry)?;
    let [odom, base] = &odometry.frames;
    let mount = motion
        .mount(options.base_from_laser, scans.frame(), base)
        .map_err(|reason| of_first_scan(path, &chosen, reason))?;
    let laser = scans.laser(mount.base_from_laser, mount.mirrored, options);
    if let Some(reason) = laser.as_ref().err().and_then(|error| why_no_laser(error, &scans, options)) {
        return Err(of_first_scan(path, &chosen, reason));
    }
    let laser = checked(path, laser)?;

    let max = laser.max_range();
    let is_cloud = chosen.scan.schema == POINT_CLOUD_2;
    let no_return = if is_cloud { NoReturn::Above } else { scans.no_return(max) };
    let convention = Convention { min: laser.min_range(), max, no_return };
    let laser_frame = scans.frame().to_owned();
    let laser_edge = motion.transforms.laser_edge(scans.frame(), base);
    let (empty, resampled_scans) = (scans.empty, scans.resampled_scans);
    let (scan_remarks, timing) = (scans.remarks(), scans.stamped.timing);
    let found = Steps::of(scans.stamped, convention, &odometry.poses, reference.poses.as_ref());
    if found.steps.is_empty() {
        return Err(DatasetError::NoOdometry {
            path: path.to_owned(),
            scans: found.scans,
            scan_secs: found.span_secs,
            odometry_secs: odometry.poses.span().map(|span| span.map(secs)),
        });
    }
    let readings = (found.steps.len() * laser.beam_count()) as f64;
    let mut evidence = format!(
        "scans from {}, odometry from {}, reference from {}; {}",
        topics.in_words(&chosen.scan),
        odometry.evidence,
        reference.evidence,
        mount.evidence
    );
    for guess in chosen.guessed.iter().map(String::as_str).chain(no_return.evidence()) {
        evidence += "; ";
        evidence += guess;
    }
    if is_cloud {
        evidence += "; clouds don't tell readings without return, nor the maximum range";
    }
    let mut remarks = motion.remarks(&chosen, &laser_frame);
    remarks.extend(missing_messages(path, topics.messages()));
    remarks.extend(scan_remarks);
    remarks.extend(found.remark());
    let times = Times {
        scans: timing,
        span_secs: found.span_secs,
        interval_secs: found.interval_secs(),
        odometry: &odometry.poses,
        reference: reference.poses.as_ref(),
        reference_timing: motion.reference_timing(&reference),
    };
    remarks.extend(times.remarks());
    let is_of_recording = times.are_of_recording();
    let summary = LogSummary {
        between: found.between,
        kind: reference.kind,
        odometry: odometry.source,
        evidence,
        odometry_messages: odometry.messages,
        odometry_interval_secs: odometry.poses.interval_secs(),
        reference_messages: reference.messages,
        reference_deviation: motion.deviation(),
        reference_interval_secs: reference.poses.as_ref().and_then(Poses::interval_secs),
        references_interpolated: found.interpolated,
        mount: mount.source,
        remarks,
        topics: topics.listed(),
        transforms: motion.transforms.pairs().take(LISTED_PAIRS).collect(),
        skipped: topics.skipped(&chosen),
        stamps_repaired: found.late,
        stamps_repeated: found.repeated,
        scans_dropped: found.scans - found.steps.len() + empty,
        intervals_without_odometry: 0,
        no_return_share: found.no_return as f64 / readings,
        unusable_share: found.unusable as f64 / readings,
        longest_return_m: found.longest,
        scan_source: quoted(&chosen.scan.topic),
    };
    let odom = odom.clone();
    let laser_edge =
        laser_edge.map(|(frame, parent, base_from_parent)| LaserEdge { frame, parent, base_from_parent });
    Ok((
        Drive { laser, steps: found.steps },
        summary,
        Layout { chosen, odom, laser: laser_edge, convention, resampled_scans, is_of_recording },
    ))
}

/// A robot that turns within a sweep is known this well \[s\].
const BETWEEN_SECS: f64 = 0.02;

/// A reference that comes more seldom than this \[s\] may move as the odometry between two of its poses, where that comes twice as often.
const SELDOM_SECS: f64 = 0.05;

/// Poses between scans with their times \[s\].
fn between(steps: &[DriveStep], poses: &Poses<'_>, odometry: &Poses<'_>) -> Vec<(f64, Pose2)> {
    let [of_reference, of_odometry] =
        [poses, odometry].map(|poses| poses.interval_secs().unwrap_or(f64::INFINITY));
    let is_seldom = of_reference > SELDOM_SECS.max(2.0 * of_odometry);
    let turn_error = if is_seldom { poses.turn_error(odometry) } else { f64::INFINITY };
    let pose_at = |stamp| poses.at_by_odometry(stamp, odometry, turn_error);
    let pairs = steps.array_windows().map(|[a, b]| [a.stamp_secs, b.stamp_secs]);
    let times = pairs.flat_map(|[from, to]| {
        // A pause tells nothing of a sweep.
        let parts = ((to - from).min(1.0) / BETWEEN_SECS).ceil() as u32;
        (1..parts).map(move |i| from + f64::from(i) * BETWEEN_SECS).filter(move |secs| *secs < to)
    });
    times.filter_map(|secs| Some((secs, pose_at((1e9 * secs) as i64)?))).collect()
}

/// The scans of a drive with their poses, and what is counted on the way.
#[derive(Default)]
struct Steps {
    steps: Vec<DriveStep>,
    /// Reference poses between them, with their times (s).
    between: Vec<(f64, Pose2)>,
    /// Number of scans with readings, and their first and last time (s).
    scans: usize,
    span_secs: [f64; 2],
    /// Number of scans without odometry, and of those within its time.
    outside: usize,
    in_holes: usize,
    /// Number of scans that were logged late, and of those with the time of the one before.
    late: usize,
    repeated: usize,
    /// Number of reference poses that aren't recorded at the scan's very time.
    interpolated: usize,
    no_return: usize,
    unusable: usize,
    /// The longest return (m).
    longest: Option<f32>,
}

impl Steps {
    fn of(
        scans: Stamped<Vec<f32>>,
        convention: Convention,
        odometry: &Poses<'_>,
        reference: Option<&Poses<'_>>,
    ) -> Self {
        let Stamped { items, late, .. } = scans;
        let span_secs = [items.first(), items.last()].map(|scan| scan.map_or(0.0, |(stamp, _)| secs(*stamp)));
        let mut found = Self { scans: items.len(), span_secs, late, ..Self::default() };
        let odometry_span = odometry.span();
        let (mut previous, mut nth) = (None, 0);
        for (stamp, mut ranges) in items {
            // Which of the scans of this very time.
            nth = if previous == Some(stamp) { nth + 1 } else { 0 };
            previous = Some(stamp);
            let Some(odometry) = odometry.at(stamp, nth) else {
                found.outside += 1;
                let is_within = odometry_span.is_some_and(|[from, to]| (from..=to).contains(&stamp));
                found.in_holes += usize::from(is_within);
                continue;
            };
            for range in &mut ranges {
                *range = convention.reading(*range);
                if *range == convention.max {
                    found.no_return += 1;
                } else if range.is_nan() {
                    found.unusable += 1;
                } else {
                    found.longest = Some(range.max(found.longest.unwrap_or(0.0)));
                }
            }
            found.repeated += usize::from(nth > 0);
            let pose = reference.and_then(|poses| poses.at(stamp, nth));
            let recorded = reference.is_some_and(|poses| poses.is_recorded(stamp));
            found.interpolated += usize::from(pose.is_some() && !recorded);
            let scan = Scan { ranges };
            found.steps.push(DriveStep { stamp_secs: secs(stamp), odometry, reference: pose, scan });
        }
        found.between = reference.map_or_else(Vec::new, |poses| between(&found.steps, poses, odometry));
        found
    }

    /// Median time between scans (s).
    fn interval_secs(&self) -> f64 {
        let stamps = self.steps.windows(2).map(|pair| pair[1].stamp_secs - pair[0].stamp_secs);
        median(&mut stamps.collect::<Vec<_>>())
    }

    /// A sentence on scans without odometry. Topics begin and end at different times: some scans are outside of every odometry.
    fn remark(&self) -> Option<String> {
        let Self { outside, scans, .. } = self;
        (self.in_holes > 0 || *outside > FEW.max(scans / FEW_SHARE)).then(|| {
            format!("{outside} of {scans} scans are left out: no odometry was recorded when they were taken.")
        })
    }
}

/// The error of what all scans have in common.
fn of_first_scan(path: &Path, chosen: &Chosen, reason: String) -> DatasetError {
    DatasetError::Message { path: path.to_owned(), topic: quoted(&chosen.scan.topic), number: 1, reason }
}

/// Messages of the chosen topics of a bag.
fn messages(
    path: &Path,
    bag: &Bag<'_>,
    chosen: &Chosen,
    limits: &Limits,
) -> Result<(Scans, Motion), DatasetError> {
    let (mut scans, mut motion) = (Scans::default(), Motion::default());
    let (mut clouds, mut points) = (Clouds::default(), 0);
    let mut transforms_read = 0;
    let wanted = chosen.channels();
    bag.visit(
        |channel| wanted.contains(&channel),
        |channel, envelope, data| {
            let logged = envelope.logged;
            if *channel == chosen.scan {
                match channel.schema.as_str() {
                    MULTI_ECHO_LASER_SCAN => {
                        scans.push(decode::<MultiEchoLaserScan>(data)?.into(), logged, limits)?;
                    }
                    POINT_CLOUD_2 => {
                        points += clouds.push(decode(data)?, logged)? as u64 + READINGS_PER_SCAN;
                        // A point takes four times what a reading takes.
                        if points > limits.log_readings / 4 {
                            return Err(Limits::refusal_above("log_readings", limits.log_readings));
                        }
                    }
                    _ => scans.push(decode(data)?, logged, limits)?,
                }
            }
            if is_of(channel, chosen.odometry.as_ref()) {
                let odometry: Odometry = decode(data)?;
                if motion.odometry.items.is_empty() {
                    motion.base_frame = odometry.child_frame_id;
                    motion.odometry_frame = odometry.header.frame_id;
                }
                match odometry.pose.pose.projected() {
                    Ok(pose) => motion.odometry.push(odometry.header.stamp.nanos(), logged, pose)?,
                    Err(reason) => motion.unusable[0].add(reason),
                }
            }
            if is_of(channel, chosen.reference.as_ref()) || Some(channel) == chosen.localizer.as_ref() {
                let (stamp, pose) = motion.reference_pose(channel, data)?;
                match pose.projected() {
                    Ok(planar) => {
                        motion.tilted += usize::from(affine(&pose).matrix3.z_axis.z < UPRIGHT);
                        motion.reference.push(stamp, logged, planar)?;
                    }
                    Err(reason) => motion.unusable[1].add(reason),
                }
            }
            let fixed = Some(channel) == chosen.fixed_transforms.as_ref();
            if fixed || Some(channel) == chosen.transforms.as_ref() {
                let TfMessage { transforms } = decode(data)?;
                transforms_read += transforms.len() as u64;
                if transforms_read > limits.log_messages {
                    return Err(Limits::refusal_above("log_messages", limits.log_messages));
                }
                for transform in &transforms {
                    if fixed {
                        motion.transforms.fix(transform)?;
                    // Joints whose state isn't known have numbers that aren't finite; tf2 ignores them, too.
                    } else if transform.transform.projected().is_ok() {
                        motion.transforms.push(transform, logged)?;
                    }
                }
            }
            Ok(())
        },
    )?;
    if chosen.scan.schema == POINT_CLOUD_2 {
        let pushed = clouds.into_scans().and_then(|mut cloud_scans| {
            cloud_scans.try_for_each(|(scan, logged)| scans.push(scan, logged, limits))
        });
        pushed.map_err(|reason| of_first_scan(path, chosen, reason))?;
    }
    let refused = |topic: &str, reason: String| DatasetError::Refused {
        path: path.to_owned(),
        line: None,
        reason: format!("{}: {reason}", quoted(topic)),
    };
    let topic_of = |source: &Option<PoseSource>| match source {
        Some(PoseSource::Topic(channel)) => channel.topic.clone(),
        _ => String::new(),
    };
    scans.sort().map_err(|reason| refused(&chosen.scan.topic, reason))?;
    let arrange = |poses: &mut Stamped<Pose2>, source| {
        poses.arrange().map_err(|reason| refused(&topic_of(source), reason))
    };
    motion.astray = [
        arrange(&mut motion.odometry, &chosen.odometry)?,
        arrange(&mut motion.reference, &chosen.reference)?,
    ];
    motion.transforms.arrange().map_err(|reason| refused("transforms", reason))?;
    for (unusable, poses, source) in [
        (&motion.unusable[0], &motion.odometry, &chosen.odometry),
        (&motion.unusable[1], &motion.reference, &chosen.reference),
    ] {
        if let (Some(PoseSource::Topic(channel)), Some(reason), []) =
            (source, &unusable.first, &poses.items[..])
        {
            let (topic, reason) = (quoted(&channel.topic), reason.clone());
            return Err(DatasetError::Message { path: path.to_owned(), topic, number: 1, reason });
        }
    }
    Ok((scans, motion))
}

/// Whether poses are messages of this channel.
fn is_of(channel: &Channel, source: Option<&PoseSource>) -> bool {
    matches!(source, Some(PoseSource::Topic(topic)) if topic == channel)
}

/// Why the scans are of no laser, where it is for what the first one says.
fn why_no_laser(error: &LaserError, scans: &Scans, options: &BagOptions) -> Option<String> {
    match error {
        LaserError::Ranges { .. } => Some(why_no_ranges(scans, options)),
        LaserError::NoBeams => Some(format!(
            "ranges is empty, as it is in all {} scans; allowed: at least one reading",
            scans.empty
        )),
        _ => None,
    }
}

/// Why the first scan's limits are no laser's.
fn why_no_ranges(scans: &Scans, options: &BagOptions) -> String {
    let [min, max] = scans.first.as_ref().map_or([f32::NAN; 2], |first| [first.range_min, first.range_max]);
    if let Some(found) = options.max_range_m {
        return format!(
            "the maximum range is {found} m, of `log.max_range_m` or `--max-range`; allowed: above the laser's minimum of {min} m"
        );
    }
    if options.min_range_m.is_none() && !(min >= 0.0 && min.is_finite()) {
        return format!("range_min is {min}; allowed: a finite number from 0");
    }
    format!(
        "range_max is {max}; allowed: a finite number above range_min, or `--max-range` (`log.max_range_m`); range_min is {min}"
    )
}
