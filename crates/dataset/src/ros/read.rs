use std::path::Path;

use glam::DAffine3;
use locsim_core::limits::{COORDINATE, Limits, READINGS_PER_SCAN, quoted};
use locsim_core::{Drive, DriveStep, Laser, LaserError, Pose2, Scan};

use super::BagOptions;
use super::bag::{Bag, Channel};
use super::cloud::Clouds;
use super::messages::{
    LaserScan, MULTI_ECHO_LASER_SCAN, Message, MultiEchoLaserScan, Odometry, POINT_CLOUD_2,
    POSE_WITH_COVARIANCE_STAMPED, Pose, PoseStamped, PoseWithCovariance, PoseWithCovarianceStamped,
    TRANSFORM_STAMPED, TfMessage, TransformStamped, decode, secs,
};
use super::poses::{Poses, Stamped, Transforms, affine, plain, planar};
use super::topics::{Chosen, MAP, ODOM, PoseSource, Topics};
use crate::laser::checked;
use crate::{DatasetError, LogKind, LogSummary, MountSource, OdometrySource};

/// A laser that scans in the plane has its axis this near to the vertical: the cosine of 10 degrees.
const UPRIGHT: f64 = 0.985;

/// The angle from the first beam of a scan to the last, at the most (rad): a turn, with the rounding of some drivers.
const WIDEST_SCAN: f64 = 1.05 * std::f64::consts::TAU;

/// The ends of a scan are this near to those of the first, at the most (rad), and its number of beams differs by no more than this share
/// of theirs: spinning lidars give as many as a turn happened to have.
const OTHER_SECTOR: f64 = 0.1;
const MOST_OTHER_BEAMS: f64 = 0.1;

/// A sweep takes no longer than this share of the time between scans.
const LONGEST_SWEEP: f64 = 1.1;

/// So many scans, and one in so many, may lie before or after the odometry without a remark.
const FEW: usize = 3;
const FEW_SHARE: usize = 50;

/// A reference that a localizer gives more seldom than this (s) follows the odometry for most of the time.
const SELDOM_SECS: f64 = 3.0;

/// Pairs of frames that an error lists, at the most.
const LISTED_PAIRS: usize = 20;

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
    pub moved_beams: usize,
}

/// The transform from a laser to its parent.
pub struct LaserEdge {
    pub frame: String,
    pub parent: String,
    pub base_from_parent: DAffine3,
}

/// How a driver writes readings that are none.
#[derive(Clone, Copy)]
pub struct Convention {
    pub min: f32,
    pub max: f32,
    /// 0 is no return.
    pub zero_is_no_return: bool,
}

impl Convention {
    /// The reading as a drive has it: the maximum range without return, NaN where it isn't usable.
    pub fn reading(self, range: f32) -> f32 {
        if range >= self.max || (range == 0.0 && self.zero_is_no_return) {
            self.max
        } else if range.is_nan() || range < self.min || range == 0.0 {
            f32::NAN
        } else {
            range
        }
    }

    /// A reading of a drive as the driver would write it.
    pub fn written(self, reading: f32) -> f32 {
        match reading {
            none if none == self.max && self.zero_is_no_return => 0.0,
            none if none == self.max => f32::INFINITY,
            reading => reading,
        }
    }
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
    let laser = scans.laser(&mount, options);
    if let (Err(LaserError::Ranges { .. }), None) = (&laser, options.max_range_m) {
        let range_max = scans.first.as_ref().map_or(f32::NAN, |first| first.range_max);
        let reason = format!(
            "range_max is {range_max}; allowed: a finite number above range_min, or `--max-range` (`log.max_range_m`)"
        );
        return Err(of_first_scan(path, &chosen, reason));
    }
    let laser = checked(path, laser)?;

    let (max, min) = (laser.max_range(), laser.min_range());
    let zero_is_no_return = scans.zero_is_no_return(max);
    let convention = Convention { min, max, zero_is_no_return };
    let laser_edge = motion.transforms.laser_edge(scans.frame(), &base);
    let (empty, moved_beams) = (scans.empty, scans.moved_beams);
    let scan_remarks = scans.remarks();
    let Stamped { items: scans, late, .. } = scans.stamped;
    let count = scans.len();
    let span = [scans.first(), scans.last()].map(|scan| scan.map_or(0.0, |(stamp, _)| secs(*stamp)));
    let mut steps: Vec<DriveStep> = Vec::with_capacity(count);
    let (mut no_return, mut unusable, mut longest) = (0_usize, 0_usize, None);
    let (mut repeated, mut nth, mut interpolated) = (0, 0, 0);
    let mut previous = None;
    let (mut outside, mut in_holes) = (0, 0);
    let odometry_span = odometry.poses.span();
    for (stamp, mut ranges) in scans {
        // Which of the scans of this very time.
        nth = if previous == Some(stamp) { nth + 1 } else { 0 };
        previous = Some(stamp);
        let Some(odometry) = odometry.poses.at(stamp, nth) else {
            outside += 1;
            in_holes += usize::from(odometry_span.is_some_and(|[from, to]| (from..=to).contains(&stamp)));
            continue;
        };
        for range in &mut ranges {
            *range = convention.reading(*range);
            if *range == max {
                no_return += 1;
            } else if range.is_nan() {
                unusable += 1;
            } else {
                longest = Some(range.max(longest.unwrap_or(0.0)));
            }
        }
        repeated += usize::from(nth > 0);
        let pose = reference.poses.as_ref().and_then(|poses| poses.at(stamp, nth));
        let recorded = reference.poses.as_ref().is_some_and(|poses| poses.is_recorded(stamp));
        interpolated += usize::from(pose.is_some() && !recorded);
        steps.push(DriveStep { stamp_secs: secs(stamp), odometry, reference: pose, scan: Scan { ranges } });
    }
    if steps.is_empty() {
        return Err(DatasetError::NoOdometry {
            path: path.to_owned(),
            scans: count,
            scan_secs: span,
            odometry_secs: odometry.poses.span().map(|span| span.map(secs)),
        });
    }
    let readings = (steps.len() * laser.beam_count()) as f64;
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
    let mut remarks = motion.remarks(&chosen);
    remarks.extend(scan_remarks);
    let interval = reference.poses.as_ref().and_then(Poses::interval_secs);
    if let Some(interval) = interval.filter(|secs| *secs > SELDOM_SECS)
        && matches!(reference.poses, Some(Poses::Corrected { .. }))
    {
        remarks.push(format!(
            "Reference poses come every {interval:.1} s. Between them they follow the odometry, whose error can't be told from them."
        ));
    }
    // Topics begin and end at different times: some scans lie outside of every odometry.
    if in_holes > 0 || outside > FEW.max(count / FEW_SHARE) {
        remarks.push(format!(
            "{outside} of {count} scans are left out: no odometry was recorded when they were taken."
        ));
    }
    let summary = LogSummary {
        kind: reference.kind,
        odometry: odometry.source,
        evidence,
        odometry_messages: odometry.messages,
        reference_messages: reference.messages,
        reference_deviation: motion.deviation(),
        reference_interval_secs: reference.poses.as_ref().and_then(Poses::interval_secs),
        references_interpolated: interpolated,
        mount: mount.source,
        remarks,
        topics: topics.listed(),
        transforms: motion.transforms.pairs().take(LISTED_PAIRS).collect(),
        skipped: topics.skipped(&chosen),
        stamps_repaired: late,
        stamps_repeated: repeated,
        scans_dropped: count - steps.len() + empty,
        intervals_without_odometry: 0,
        no_return_share: no_return as f64 / readings,
        unusable_share: unusable as f64 / readings,
        longest_return_m: longest,
        scan_source: quoted(&chosen.scan.topic),
    };
    let odom = motion.odometry_frame(&chosen);
    let laser_edge =
        laser_edge.map(|(frame, parent, base_from_parent)| LaserEdge { frame, parent, base_from_parent });
    Ok((Drive { laser, steps }, summary, Layout { chosen, odom, laser: laser_edge, convention, moved_beams }))
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
    bag.read(&chosen.channels(), |channel, data| {
        if *channel == chosen.scan {
            match channel.schema.as_str() {
                MULTI_ECHO_LASER_SCAN => {
                    scans.push(decode::<MultiEchoLaserScan>(data)?.into(), limits)?;
                }
                POINT_CLOUD_2 => {
                    points += clouds.push(decode(data)?)? as u64 + READINGS_PER_SCAN;
                    // A point takes four times what a reading takes.
                    if points > limits.log_readings / 4 {
                        return Err(Limits::refusal_above("log_readings", limits.log_readings));
                    }
                }
                _ => scans.push(decode(data)?, limits)?,
            }
        }
        if is_of(channel, chosen.odometry.as_ref()) {
            let odometry: Odometry = decode(data)?;
            if motion.odometry.items.is_empty() {
                motion.base_frame = odometry.child_frame_id;
                motion.odometry_frame = odometry.header.frame_id;
            }
            match odometry.pose.pose.projected() {
                Ok(pose) => motion.odometry.push(odometry.header.stamp.nanos(), pose)?,
                Err(reason) => motion.unusable[0].add(reason),
            }
        }
        if is_of(channel, chosen.reference.as_ref()) || Some(channel) == chosen.localizer.as_ref() {
            let (stamp, pose) = motion.reference_pose(channel, data)?;
            match pose.projected() {
                Ok(planar) => {
                    motion.tilted += usize::from(affine(&pose).matrix3.z_axis.z < UPRIGHT);
                    motion.reference.push(stamp, planar)?;
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
                    motion.transforms.push(transform)?;
                }
            }
        }
        Ok(())
    })?;
    if chosen.scan.schema == POINT_CLOUD_2 {
        let pushed = clouds
            .into_scans()
            .and_then(|mut cloud_scans| cloud_scans.try_for_each(|scan| scans.push(scan, limits)));
        pushed.map_err(|reason| of_first_scan(path, chosen, reason))?;
    }
    scans.stamped.sort();
    motion.astray = [motion.odometry.arrange(), motion.reference.arrange()];
    motion.transforms.arrange();
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

/// The scans of a bag.
#[derive(Default)]
struct Scans {
    /// The first scan, without readings.
    first: Option<LaserScan>,
    stamped: Stamped<Vec<f32>>,
    /// Readings of the scans, as the limit counts them.
    readings: u64,
    time_increments_secs: f64,
    /// Number of scans without readings, which aren't kept.
    empty: usize,
    /// Number of scans whose beams aren't those of the first.
    moved_beams: usize,
}

impl Scans {
    /// Takes in a scan of the same laser as the first.
    fn push(&mut self, mut scan: LaserScan, limits: &Limits) -> Result<(), String> {
        let mut ranges = std::mem::take(&mut scan.ranges);
        ranges.shrink_to_fit();
        scan.intensities = Vec::new();
        self.readings += ranges.len() as u64 + READINGS_PER_SCAN;
        if self.readings > limits.log_readings {
            return Err(Limits::refusal_above("log_readings", limits.log_readings));
        }
        if ranges.is_empty() {
            self.empty += 1;
            return Ok(());
        }
        check_bearings(&scan, ranges.len())?;
        let beams = self.stamped.items.first().map_or(0, |(_, ranges)| ranges.len());
        let onto_first =
            self.first.as_ref().filter(|first| !are_same_beams(first, beams, &scan, ranges.len()));
        match onto_first.map(|first| on_beams_of(first, beams, &scan, &ranges)) {
            Some(Ok(moved)) => (ranges, self.moved_beams) = (moved, self.moved_beams + 1),
            // A first turn that isn't whole is no measure for the others.
            Some(Err(_)) if self.stamped.items.len() == 1 && ranges.len() > beams => {
                *self = Self { readings: self.readings, empty: self.empty + 1, ..Self::default() };
            }
            Some(Err(reason)) => return Err(reason),
            None => {}
        }
        if let Some(first) = &self.first {
            if scan.header.frame_id != first.header.frame_id {
                let (found, allowed) = (quoted(&scan.header.frame_id), quoted(&first.header.frame_id));
                return Err(format!("frame_id is `{found}`; allowed: `{allowed}`, as in the first"));
            }
            for (field, found, allowed) in [
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
        self.stamped.push(scan.header.stamp.nanos(), ranges)?;
        self.first.get_or_insert(scan);
        Ok(())
    }

    /// Mean time from a beam to the next (s).
    fn beam_interval(&self) -> f64 {
        self.time_increments_secs / self.stamped.items.len().max(1) as f64
    }

    /// Whether a scan's beams, by their times, are over when the next scan begins. Scans may be stamped in pairs: their mean interval counts.
    fn has_plausible_sweep(&self) -> bool {
        let items = &self.stamped.items;
        let sweep = self.beam_interval() * items.first().map_or(0, |(_, ranges)| ranges.len()) as f64;
        let intervals = items.windows(2).filter(|pair| pair[1].0 > pair[0].0).count();
        let whole = items.first().zip(items.last()).map_or(0.0, |((from, _), (to, _))| secs(to - from));
        intervals == 0 || sweep.abs() <= LONGEST_SWEEP * whole / intervals as f64
    }

    /// What is odd about the scans, in sentences.
    fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        if self.moved_beams > 0 {
            remarks.push(format!(
                "{} of {} scans have other beams than the first; each of its beams has their nearest reading, up to half a beam off.",
                self.moved_beams,
                self.stamped.items.len()
            ));
        }
        if !self.has_plausible_sweep() {
            remarks.push(format!(
                "time_increment is {:.3e} s, with which the beams of a scan aren't over when the next one begins: all \
                 beams of a scan are taken to be of its stamp.",
                self.beam_interval()
            ));
        }
        remarks
    }

    /// The frame that the scans are in.
    fn frame(&self) -> &str {
        self.first.as_ref().map_or("", |first| plain(&first.header.frame_id))
    }

    /// Whether the driver writes 0 for no return: it does where some readings are 0 and none is infinite or at the
    /// maximum.
    fn zero_is_no_return(&self, max: f32) -> bool {
        let mut readings = self.stamped.items.iter().flat_map(|(_, ranges)| ranges);
        let zeros = readings.clone().any(|range| *range == 0.0);
        zeros && !readings.any(|range| *range >= max)
    }

    /// The laser that the scans describe.
    fn laser(&self, mount: &Mount, options: &BagOptions) -> Result<Laser, LaserError> {
        let first = self.first.as_ref().ok_or(LaserError::NoBeams)?;
        let beams = self.stamped.items.first().map_or(0, |(_, ranges)| ranges.len());
        let side = if mount.mirrored { -1.0 } else { 1.0 };
        let interval = if self.has_plausible_sweep() { self.beam_interval() } else { 0.0 };
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

/// Whether a scan has the beams of the first, by bits.
fn are_same_beams(first: &LaserScan, beams: usize, scan: &LaserScan, count: usize) -> bool {
    count == beams
        && scan.angle_min.to_bits() == first.angle_min.to_bits()
        && scan.angle_increment.to_bits() == first.angle_increment.to_bits()
}

/// The readings of a scan on the beams of the first: those nearest to them, NaN where none is within a beam.
///
/// # Errors
/// The beams are of another sector, or much fewer or more.
fn on_beams_of(
    first: &LaserScan,
    beams: usize,
    scan: &LaserScan,
    ranges: &[f32],
) -> Result<Vec<f32>, String> {
    let ends = |scan: &LaserScan, count: usize| {
        let start = f64::from(scan.angle_min);
        [start, start + (count as f64 - 1.0) * f64::from(scan.angle_increment)]
    };
    let apart = ends(first, beams).into_iter().zip(ends(scan, ranges.len())).map(|(a, b)| (a - b).abs());
    let is_near = apart.fold(0.0, f64::max) <= OTHER_SECTOR;
    if !is_near || ranges.len().abs_diff(beams) as f64 > MOST_OTHER_BEAMS * beams as f64 {
        return Err(format!(
            "the scan has {} ranges from {} rad, every {} rad; allowed: about {beams} from {}, every {}, as in the first",
            ranges.len(),
            scan.angle_min,
            scan.angle_increment,
            first.angle_min,
            first.angle_increment
        ));
    }
    let reading = |beam: usize| {
        let bearing = f64::from(first.angle_min) + beam as f64 * f64::from(first.angle_increment);
        let at = ((bearing - f64::from(scan.angle_min)) / f64::from(scan.angle_increment)).round();
        let is_there = (0.0..ranges.len() as f64).contains(&at);
        if is_there { ranges[at as usize] } else { f32::NAN }
    };
    Ok((0..beams).map(reading).collect())
}

/// Refuses scans whose beams don't lie beside each other within a turn.
fn check_bearings(scan: &LaserScan, beams: usize) -> Result<(), String> {
    let step = f64::from(scan.angle_increment);
    let most = WIDEST_SCAN / (beams as f64 - 1.0);
    if beams > 1 && !(step != 0.0 && step.abs() <= most) {
        return Err(format!(
            "angle_increment is {step} rad; allowed: not 0, at most {most:.6} for {beams} ranges within a turn"
        ));
    }
    Ok(())
}

/// How the robot moved, and where its frames are.
#[derive(Default)]
struct Motion {
    odometry: Stamped<Pose2>,
    /// The odometry's own name of the base.
    base_frame: String,
    /// The frame that a topic's odometry is in.
    odometry_frame: String,
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
    fn remarks(&self, chosen: &Chosen) -> Vec<String> {
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
                    "{count} messages of {topic} have no pose of the {name} and are left out ({reason})."
                ));
            }
            if self.astray[i] > 0 {
                remarks.push(format!(
                    "{} poses of {topic} lie where no robot can be between their neighbours, and are left out.",
                    self.astray[i]
                ));
            }
        }
        if 2 * self.tilted > self.reference.items.len() {
            remarks.push(
                "Most poses of the reference are tilted by more than 10 degrees: its z axis doesn't point up, and its heading isn't the robot's."
                    .to_owned(),
            );
        }
        if !self.transforms.told_anew.is_empty() {
            let pairs: Vec<&str> = self.transforms.told_anew.iter().map(String::as_str).collect();
            remarks.push(format!(
                "Static transforms change during the recording ({}); the last ones are taken for all of it.",
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
        let (header, pose) = match channel.schema.as_str() {
            Odometry::TYPE => {
                let Odometry { header, pose, .. } = decode(data)?;
                (header, known(pose))
            }
            POSE_WITH_COVARIANCE_STAMPED => {
                let PoseWithCovarianceStamped { header, pose } = decode(data)?;
                (header, known(pose))
            }
            TRANSFORM_STAMPED => {
                let TransformStamped { header, transform, .. } = decode(data)?;
                (header, transform)
            }
            _ => {
                let PoseStamped { header, pose } = decode(data)?;
                (header, pose)
            }
        };
        Ok((header.stamp.nanos(), pose))
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
