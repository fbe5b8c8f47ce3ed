use std::path::Path;

use glam::DAffine3;
use locsim_core::limits::{COORDINATE, Limits, READINGS_PER_SCAN, quoted};
use locsim_core::{Drive, DriveStep, LaserError, Pose2, Scan, median};

use super::BagOptions;
use super::bag::{Bag, Channel};
use super::cloud::Clouds;
use super::messages::{
    MULTI_ECHO_LASER_SCAN, Message, MultiEchoLaserScan, Odometry, POINT_CLOUD_2,
    POSE_WITH_COVARIANCE_STAMPED, Pose, PoseStamped, PoseWithCovariance, PoseWithCovarianceStamped,
    TRANSFORM_STAMPED, TfMessage, TransformStamped, decode, secs,
};
use super::poses::{Poses, Transforms, affine, plain, planar};
use super::remarks::{Times, missing_messages};
use super::scans::{Convention, Scans};
use super::stamped::{Stamped, Timing};
use super::topics::{Chosen, MAP, ODOM, PoseSource, Topics};
use crate::laser::checked;
use crate::{DatasetError, LogKind, LogSummary, MountSource, OdometrySource};

/// A laser that scans in the plane has its axis this near to the vertical: the cosine of 10 degrees.
const UPRIGHT: f64 = 0.985;

/// So many scans, and one in so many, may lie before or after the odometry without a remark.
const FEW: usize = 3;
const FEW_SHARE: usize = 50;

/// Pairs of frames that an error lists, at the most.
const LISTED_PAIRS: usize = 20;

/// Frames that don't drift.
const FIXED_FRAMES: [&str; 2] = ["map", "world"];
/// Frames nearer to each other than this (m), as seen from above, are one.
const SAME_PLACE_M: f64 = 0.005;
/// The frames of a robot's base (REP-105, REP-120), after the odometry's own name for it.
const BASE_FRAMES: [&str; 2] = ["base_link", "base_footprint"];

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
    let (odometry, base) =
        if options.without_odometry { FoundOdometry::none() } else { motion.odometry(&chosen, &topics)? };
    let reference = motion.reference(&chosen, &topics, &odometry.poses, &base)?;
    let mount = motion
        .mount(options.base_from_laser, scans.frame(), &base)
        .map_err(|reason| of_first_scan(path, &chosen, reason))?;
    let laser = scans.laser(mount.base_from_laser, mount.mirrored, options);
    if let (Err(LaserError::Ranges { .. }), None) = (&laser, options.max_range_m) {
        let reason = why_no_ranges(&scans, options);
        return Err(of_first_scan(path, &chosen, reason));
    }
    let laser = checked(path, laser)?;

    let max = laser.max_range();
    let zero_is_no_return = scans.zero_is_no_return(max);
    let convention = Convention { min: laser.min_range(), max, zero_is_no_return };
    let laser_frame = scans.frame().to_owned();
    let laser_edge = motion.transforms.laser_edge(scans.frame(), &base);
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
    for guess in &chosen.guessed {
        evidence += "; ";
        evidence += guess;
    }
    if chosen.scan.schema == POINT_CLOUD_2 {
        evidence += "; clouds don't tell readings without return, nor the maximum range";
    }
    if zero_is_no_return {
        evidence += "; readings of 0 are taken for no return, as no other reading is without return";
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
    let odom = motion.odometry_frame(&chosen);
    let laser_edge =
        laser_edge.map(|(frame, parent, base_from_parent)| LaserEdge { frame, parent, base_from_parent });
    Ok((
        Drive { laser, steps: found.steps },
        summary,
        Layout { chosen, odom, laser: laser_edge, convention, resampled_scans, is_of_recording },
    ))
}

/// The scans of a drive with their poses, and what is counted on the way.
#[derive(Default)]
struct Steps {
    steps: Vec<DriveStep>,
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

/// The odometry of a drive.
struct FoundOdometry<'a> {
    poses: Poses<'a>,
    source: OdometrySource,
    messages: usize,
    /// Where it was found, in words.
    evidence: String,
}

impl FoundOdometry<'_> {
    /// No odometry, of a base of the usual name.
    fn none() -> (Self, String) {
        let odometry = Self {
            poses: Poses::Unknown,
            source: OdometrySource::Missing,
            messages: 0,
            evidence: "nowhere".to_owned(),
        };
        (odometry, BASE_FRAMES[0].to_owned())
    }
}

/// The reference of a drive.
struct FoundReference<'a> {
    poses: Option<Poses<'a>>,
    kind: LogKind,
    messages: usize,
    /// Where it was found, in words.
    evidence: String,
}

/// Where the laser is mounted.
struct Mount {
    base_from_laser: Pose2,
    /// The laser hangs upside down: its beams run the other way round.
    mirrored: bool,
    source: MountSource,
    /// How that is known, in words.
    evidence: String,
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
    scans.stamped.sort().map_err(|reason| refused(&chosen.scan.topic, reason))?;
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

/// Why the first scan's limits are no laser's.
fn why_no_ranges(scans: &Scans, options: &BagOptions) -> String {
    let [min, max] = scans.first.as_ref().map_or([f32::NAN; 2], |first| [first.range_min, first.range_max]);
    if options.min_range_m.is_none() && !(min >= 0.0 && min.is_finite()) {
        return format!("range_min is {min}; allowed: a finite number from 0");
    }
    format!(
        "range_max is {max}; allowed: a finite number above range_min, or `--max-range` (`log.max_range_m`); range_min is {min}"
    )
}

/// How the robot moved, and where its frames are.
#[derive(Default)]
struct Motion {
    odometry: Stamped<Pose2>,
    /// The odometry's own name of the base.
    base_frame: String,
    /// The frame that a topic's odometry is in.
    odometry_frame: String,
    /// What the reference's messages are poses of, and the frame that they are in; empty where they don't say.
    reference_frames: [String; 2],
    /// Poses of the reference, or of the localizer that stands in for it.
    reference: Stamped<Pose2>,
    /// Variances of x, y and heading of these poses (m^2, m^2, rad^2).
    variances: Vec<[f64; 3]>,
    transforms: Transforms,
    /// Messages of the odometry and of the reference whose pose is none.
    unusable: [Unusable; 2],
    /// Number of their poses that lie where no robot can be, and aren't kept.
    astray: [usize; 2],
    /// Number of poses of the reference whose z axis doesn't point up.
    tilted: usize,
}

/// Messages without a usable pose.
#[derive(Default)]
struct Unusable {
    count: usize,
    /// Why the first isn't.
    first: Option<String>,
}

impl Unusable {
    fn add(&mut self, reason: String) {
        self.count += 1;
        self.first.get_or_insert(reason);
    }
}

impl Motion {
    /// The frame that the odometry is in.
    fn odometry_frame(&self, chosen: &Chosen) -> String {
        match &chosen.odometry {
            Some(PoseSource::Topic(_)) => plain(&self.odometry_frame).to_owned(),
            Some(PoseSource::Transform { parent, .. }) => parent.clone(),
            None => ODOM.to_owned(),
        }
    }

    /// What is odd about the poses, in sentences.
    fn remarks(&self, chosen: &Chosen, laser_frame: &str) -> Vec<String> {
        let mut remarks = Vec::new();
        let topic = |source: &Option<PoseSource>| match source {
            Some(PoseSource::Topic(channel)) => Some(channel.clone()),
            _ => None,
        };
        let reference = topic(&chosen.reference).or_else(|| chosen.localizer.clone());
        let sources = [(topic(&chosen.odometry), "odometry"), (reference, "reference")];
        for (i, (channel, name)) in sources.into_iter().enumerate() {
            let Some(channel) = channel else { continue };
            let topic = quoted(&channel.topic);
            if let Unusable { count, first: Some(reason) } = &self.unusable[i] {
                remarks.push(format!(
                    "Messages of {topic} without a usable pose of the {name} are left out: {count} ({reason})."
                ));
            }
            if self.astray[i] > 0 {
                remarks.push(format!(
                    "Poses of {topic} that lie where no robot can be between their neighbours are left out: {}.",
                    self.astray[i]
                ));
            }
        }
        let [of, within] = self.reference_frames.each_ref().map(|frame| plain(frame));
        let [base, odometry] = [plain(&self.base_frame), plain(&self.odometry_frame)];
        // A base and its footprint differ by a height.
        let are_one = || {
            let between = self.transforms.fixed(of, base);
            between.is_some_and(|(between, _)| planar(&between).position().length() < SAME_PLACE_M)
        };
        if of != base && [of, base].contains(&laser_frame) && ![of, base].contains(&"") && !are_one() {
            remarks.push(format!(
                "The reference is the pose of `{}`, the odometry that of `{}`, and one of them is the laser's frame: both are taken for the \
                 robot's.",
                quoted(of),
                quoted(base)
            ));
        }
        if !within.is_empty() && within == odometry && !FIXED_FRAMES.contains(&within) {
            remarks.push(format!(
                "The reference is in the frame of the odometry, `{}`: it may be odometry, which drifts.",
                quoted(within)
            ));
        }
        if let Some(PoseSource::Topic(channel)) = &chosen.odometry
            && FIXED_FRAMES.contains(&odometry)
        {
            remarks.push(format!(
                "The odometry, {}, is in the frame `{odometry}`, which doesn't drift: it may be the true pose, which `--reference-topic` names.",
                quoted(&channel.topic)
            ));
        }
        if 2 * self.tilted > self.reference.items.len() {
            remarks.push(
                "Most poses of the reference are tilted by more than 10 degrees: its z axis doesn't point up, and its heading isn't the robot's."
                    .to_owned(),
            );
        }
        if !self.transforms.changed_static.is_empty() {
            let pairs: Vec<&str> =
                self.transforms.changed_static.iter().map(String::as_str).take(LISTED_PAIRS).collect();
            remarks.push(format!(
                "Static transforms change during the recording, or a frame has two parents ({}); the last ones are taken for all of it.",
                pairs.join(", ")
            ));
        }
        remarks
    }

    /// A pose with its time (ns); keeps its variances.
    fn reference_pose(&mut self, channel: &Channel, data: &[u8]) -> Result<(i64, Pose), String> {
        let mut known = |PoseWithCovariance { pose, covariance }: PoseWithCovariance| {
            let variances = [0, 1, 5].map(|axis| covariance[axis][axis]);
            if variances.iter().all(|variance| (0.0..COORDINATE).contains(variance)) && variances != [0.0; 3]
            {
                self.variances.push(variances);
            }
            pose
        };
        let mut child = String::new();
        let (header, pose) = match channel.schema.as_str() {
            Odometry::TYPE => {
                let Odometry { header, pose, child_frame_id, .. } = decode(data)?;
                child = child_frame_id;
                (header, known(pose))
            }
            POSE_WITH_COVARIANCE_STAMPED => {
                let PoseWithCovarianceStamped { header, pose } = decode(data)?;
                (header, known(pose))
            }
            TRANSFORM_STAMPED => {
                let TransformStamped { header, transform, child_frame_id } = decode(data)?;
                child = child_frame_id;
                (header, transform)
            }
            _ => {
                let PoseStamped { header, pose } = decode(data)?;
                (header, pose)
            }
        };
        let stamp = header.stamp.nanos();
        if self.reference.items.is_empty() {
            self.reference_frames = [child, header.frame_id];
        }
        Ok((stamp, pose))
    }

    /// What the stamps of the reference are worth.
    fn reference_timing<'a>(&'a self, found: &'a FoundReference<'_>) -> Option<&'a Timing> {
        let poses = found.poses.as_ref()?;
        // A localizer's poses are stamped as the scans that it took.
        if self.reference.items.is_empty() { poses.timing() } else { Some(&self.reference.timing) }
    }

    /// Median standard deviations of the reference (m, m, rad); `None` where it comes without covariances.
    fn deviation(&self) -> Option<[f64; 3]> {
        let median = |axis: usize| {
            let mut values: Vec<f64> = self.variances.iter().map(|variances| variances[axis]).collect();
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).map(|variance| variance.sqrt())
        };
        Some([median(0)?, median(1)?, median(2)?])
    }

    /// The odometry, and the frame of the base that it moves.
    fn odometry(
        &self,
        chosen: &Chosen,
        topics: &Topics<'_>,
    ) -> Result<(FoundOdometry<'_>, String), DatasetError> {
        let (parent, bases) = match &chosen.odometry {
            Some(PoseSource::Topic(channel)) => {
                let odometry = FoundOdometry {
                    poses: Poses::Topic(&self.odometry),
                    source: OdometrySource::Topic,
                    messages: topics.count(channel),
                    evidence: topics.in_words(channel),
                };
                return Ok((odometry, plain(&self.base_frame).to_owned()));
            }
            Some(PoseSource::Transform { parent, child }) => (parent.as_str(), vec![child.as_str()]),
            None => (ODOM, BASE_FRAMES.to_vec()),
        };
        let found = bases.iter().find_map(|base| Some((base, self.transforms.chain(base, parent)?)));
        let Some((base, edges)) = found else {
            return Err(self.no_transforms("odometry", parent, bases[0], topics));
        };
        let odometry = FoundOdometry {
            poses: Poses::Transforms(edges),
            source: OdometrySource::Transforms,
            messages: chosen.transforms.as_ref().map_or(0, |channel| topics.count(channel)),
            evidence: format!("the transforms {}:{}", quoted(parent), quoted(base)),
        };
        Ok((odometry, (*base).to_owned()))
    }

    fn reference<'a>(
        &'a self,
        chosen: &Chosen,
        topics: &Topics<'_>,
        odometry: &'a Poses<'a>,
        base: &str,
    ) -> Result<FoundReference<'a>, DatasetError> {
        let transforms = chosen.transforms.as_ref().map_or(0, |channel| topics.count(channel));
        let found = |poses, kind, messages, evidence| {
            Ok(FoundReference { poses: Some(poses), kind, messages, evidence })
        };
        match &chosen.reference {
            Some(PoseSource::Topic(channel)) => {
                let poses = if channel.schema == POSE_WITH_COVARIANCE_STAMPED {
                    Poses::corrected(&self.reference, odometry)
                } else {
                    Poses::Topic(&self.reference)
                };
                return found(poses, LogKind::Referenced, topics.count(channel), topics.in_words(channel));
            }
            Some(PoseSource::Transform { parent, child }) => {
                let Some(edges) = self.transforms.chain(child, parent) else {
                    return Err(self.no_transforms("reference", parent, child, topics));
                };
                let evidence = format!("the transforms {}:{}", quoted(parent), quoted(child));
                return found(Poses::Transforms(edges), LogKind::Referenced, transforms, evidence);
            }
            None => {}
        }
        let mut bases = [base].into_iter().chain(BASE_FRAMES);
        if let Some((base, edges)) = bases.find_map(|base| Some((base, self.transforms.chain(base, MAP)?))) {
            let evidence = format!("the transforms {MAP}:{}, which a localizer found", quoted(base));
            return found(Poses::Transforms(edges), LogKind::Localized, transforms, evidence);
        }
        if let Some(channel) = &chosen.localizer {
            let evidence = format!("{}, which a localizer found", topics.in_words(channel));
            let poses = Poses::corrected(&self.reference, odometry);
            return found(poses, LogKind::Localized, topics.count(channel), evidence);
        }
        let evidence = "no topic".to_owned();
        Ok(FoundReference { poses: None, kind: LogKind::Raw, messages: 0, evidence })
    }

    /// The error that no transforms lead from a frame to another; it lists those that are there.
    fn no_transforms(&self, role: &str, parent: &str, child: &str, topics: &Topics<'_>) -> DatasetError {
        let pairs: Vec<_> = self.transforms.pairs().take(LISTED_PAIRS).collect();
        let pairs = if pairs.is_empty() { "none".to_owned() } else { pairs.join(", ") };
        topics.refuse(format!(
            "no topic of type {} for {role}, and no transforms lead from `{}` to `{}`; transforms: {pairs}",
            Odometry::TYPE,
            quoted(child),
            quoted(parent)
        ))
    }

    /// Where the laser is mounted: as wanted, or by the transforms that don't change.
    fn mount(&self, wanted: Option<Pose2>, laser: &str, base: &str) -> Result<Mount, String> {
        let found = |base_from_laser, mirrored, source, evidence| {
            Ok(Mount { base_from_laser, mirrored, source, evidence })
        };
        if let Some(wanted) = wanted {
            return found(wanted, false, MountSource::Given, "the laser's mount is given".to_owned());
        }
        let bases = [base].into_iter().chain(BASE_FRAMES).filter(|base| !base.is_empty());
        let known = bases.clone().find_map(|base| Some((base, self.transforms.fixed(laser, base)?)));
        let Some((base, (base_from_laser, all_static))) = known else {
            let evidence = format!(
                "the laser is taken to be at the base's origin, as no static transform leads from `{}` to `{}`",
                quoted(laser),
                quoted(bases.clone().next().unwrap_or_default())
            );
            return found(Pose2::IDENTITY, false, MountSource::Unknown, evidence);
        };
        let (laser, base) = (quoted(laser), quoted(base));
        let axis = base_from_laser.matrix3.z_axis;
        if axis.z.abs() < UPRIGHT {
            let tilt = axis.z.acos().to_degrees();
            return Err(format!(
                "the laser `{laser}` is tilted by {tilt:.1} degrees on `{base}`; allowed: at most 10, upright or \
                 upside down"
            ));
        }
        let (source, transforms) = if all_static {
            (MountSource::StaticTransforms, "static transforms say")
        } else {
            (MountSource::ConstantTransforms, "transforms say that never change")
        };
        let evidence = format!("the laser `{laser}` is mounted on `{base}` as {transforms}");
        found(planar(&base_from_laser), axis.z < 0.0, source, evidence)
    }
}
