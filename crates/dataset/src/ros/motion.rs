//! How the robot of a bag moved, by its odometry and its reference, and where its laser is mounted.

use locsim_core::Pose2;
use locsim_core::limits::{COORDINATE, quoted};

use super::bag::Channel;
use super::messages::{
    Message, Odometry, POSE_WITH_COVARIANCE_STAMPED, Pose, PoseStamped, PoseWithCovariance,
    PoseWithCovarianceStamped, TRANSFORM_STAMPED, TransformStamped, decode,
};
use super::poses::{Poses, Transforms, plain, planar};
use super::stamped::{Stamped, Timing};
use super::topics::{Chosen, MAP, ODOM, PoseSource, Topics};
use crate::{DatasetError, LogKind, MountSource, OdometrySource};

/// A laser that scans in the plane has its axis this near to the vertical: the cosine of 10 degrees.
pub const UPRIGHT: f64 = 0.985;

/// Pairs of frames that an error lists, at the most.
pub const LISTED_PAIRS: usize = 20;

/// Frames that don't drift.
const FIXED_FRAMES: [&str; 2] = ["map", "world"];
/// Frames nearer to each other than this (m), as seen from above, are one.
const SAME_PLACE_M: f64 = 0.005;
/// The frames of a robot's base (REP-105, REP-120), after the odometry's own name for it.
const BASE_FRAMES: [&str; 2] = ["base_link", "base_footprint"];

/// The namespaces that a frame is in, the innermost first, with their slashes; the last is none.
fn namespaces(frame: &str) -> impl Iterator<Item = &str> {
    frame.rmatch_indices('/').map(|(end, _)| &frame[..=end]).chain([""])
}

/// The odometry of a drive.
pub struct FoundOdometry<'a> {
    pub poses: Poses<'a>,
    /// The frame that it is in, and that of the base that it moves.
    pub frames: [String; 2],
    pub source: OdometrySource,
    pub messages: usize,
    /// Where it was found, in words.
    pub evidence: String,
}

impl FoundOdometry<'_> {
    /// No odometry, of a base of the usual name.
    pub fn none() -> Self {
        Self {
            poses: Poses::Unknown,
            frames: [ODOM, BASE_FRAMES[0]].map(str::to_owned),
            source: OdometrySource::Missing,
            messages: 0,
            evidence: "nowhere".to_owned(),
        }
    }
}

/// The reference of a drive.
pub struct FoundReference<'a> {
    pub poses: Option<Poses<'a>>,
    pub kind: LogKind,
    pub messages: usize,
    /// Where it was found, in words.
    pub evidence: String,
}

/// Where the laser is mounted.
pub struct Mount {
    pub base_from_laser: Pose2,
    /// The laser hangs upside down: its beams run the other way round.
    pub mirrored: bool,
    pub source: MountSource,
    /// How that is known, in words.
    pub evidence: String,
}

/// How the robot moved, and where its frames are.
#[derive(Default)]
pub struct Motion {
    pub odometry: Stamped<Pose2>,
    /// The odometry's own name of the base.
    pub base_frame: String,
    /// The frame that a topic's odometry is in.
    pub odometry_frame: String,
    /// What the reference's messages are poses of, and the frame that they are in; empty where they don't say.
    reference_frames: [String; 2],
    /// Poses of the reference, or of the localizer that stands in for it.
    pub reference: Stamped<Pose2>,
    /// Variances of x, y and heading of these poses (m^2, m^2, rad^2).
    variances: Vec<[f64; 3]>,
    pub transforms: Transforms,
    /// Messages of the odometry and of the reference whose pose is none.
    pub unusable: [Unusable; 2],
    /// Number of their poses that lie where no robot can be, and aren't kept.
    pub astray: [usize; 2],
    /// Number of poses of the reference whose z axis doesn't point up.
    pub tilted: usize,
}

/// Messages without a usable pose.
#[derive(Default)]
pub struct Unusable {
    pub count: usize,
    /// Why the first isn't.
    pub first: Option<String>,
}

impl Unusable {
    pub fn add(&mut self, reason: String) {
        self.count += 1;
        self.first.get_or_insert(reason);
    }
}

impl Motion {
    /// What is odd about the poses, in sentences.
    pub fn remarks(&self, chosen: &Chosen, laser_frame: &str) -> Vec<String> {
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
    pub fn reference_pose(&mut self, channel: &Channel, data: &[u8]) -> Result<(i64, Pose), String> {
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
    pub fn reference_timing<'a>(&'a self, found: &'a FoundReference<'_>) -> Option<&'a Timing> {
        let poses = found.poses.as_ref()?;
        // A localizer's poses are stamped as the scans that it took.
        if self.reference.items.is_empty() { poses.timing() } else { Some(&self.reference.timing) }
    }

    /// Median standard deviations of the reference (m, m, rad); `None` where it comes without covariances.
    pub fn deviation(&self) -> Option<[f64; 3]> {
        let median = |axis: usize| {
            let mut values: Vec<f64> = self.variances.iter().map(|variances| variances[axis]).collect();
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).map(|variance| variance.sqrt())
        };
        Some([median(0)?, median(1)?, median(2)?])
    }

    /// The odometry: of its topic, or of transforms in the namespace of the laser's frame, or in none.
    pub fn odometry(
        &self,
        chosen: &Chosen,
        topics: &Topics<'_>,
        laser_frame: &str,
    ) -> Result<FoundOdometry<'_>, DatasetError> {
        let pairs: Vec<[String; 2]> = match &chosen.odometry {
            Some(PoseSource::Topic(channel)) => {
                let odometry = FoundOdometry {
                    poses: Poses::Topic(&self.odometry),
                    frames: [&self.odometry_frame, &self.base_frame].map(|frame| plain(frame).to_owned()),
                    source: OdometrySource::Topic,
                    messages: topics.count(channel),
                    evidence: topics.in_words(channel),
                };
                return Ok(odometry);
            }
            Some(PoseSource::Transform { parent, child }) => vec![[parent.clone(), child.clone()]],
            None => (namespaces(laser_frame))
                .flat_map(|space| BASE_FRAMES.map(|base| [ODOM, base].map(|frame| format!("{space}{frame}"))))
                .collect(),
        };
        let chain = |[parent, base]: &[String; 2]| self.transforms.chain(base, parent);
        let Some((frames, edges)) = pairs.iter().find_map(|pair| Some((pair.clone(), chain(pair)?))) else {
            // The names without a namespace are the last.
            let [parent, base] = &pairs[pairs.len().saturating_sub(BASE_FRAMES.len())];
            return Err(self.no_transforms("odometry", parent, base, topics));
        };
        let evidence = format!("the transforms {}:{}", quoted(&frames[0]), quoted(&frames[1]));
        Ok(FoundOdometry {
            poses: Poses::Transforms(edges),
            frames,
            source: OdometrySource::Transforms,
            messages: chosen.transforms.as_ref().map_or(0, |channel| topics.count(channel)),
            evidence,
        })
    }

    pub fn reference<'a>(
        &'a self,
        chosen: &Chosen,
        topics: &Topics<'_>,
        odometry: &'a FoundOdometry<'a>,
    ) -> Result<FoundReference<'a>, DatasetError> {
        let [_, base] = &odometry.frames;
        let transforms = chosen.transforms.as_ref().map_or(0, |channel| topics.count(channel));
        let found = |poses, kind, messages, evidence| {
            Ok(FoundReference { poses: Some(poses), kind, messages, evidence })
        };
        match &chosen.reference {
            Some(PoseSource::Topic(channel)) => {
                let poses = if channel.schema == POSE_WITH_COVARIANCE_STAMPED {
                    Poses::corrected(&self.reference, &odometry.poses)
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
        let mut pairs = [base.as_str()]
            .into_iter()
            .chain(BASE_FRAMES)
            .flat_map(|base| namespaces(base).map(move |space| (format!("{space}{MAP}"), base)));
        let chain = |(map, base): (String, _)| Some((self.transforms.chain(base, &map)?, map, base));
        if let Some((edges, map, base)) = pairs.find_map(chain) {
            let evidence =
                format!("the transforms {}:{}, which a localizer found", quoted(&map), quoted(base));
            return found(Poses::Transforms(edges), LogKind::Localized, transforms, evidence);
        }
        if let Some(channel) = &chosen.localizer {
            let evidence = format!("{}, which a localizer found", topics.in_words(channel));
            let poses = Poses::corrected(&self.reference, &odometry.poses);
            return found(poses, LogKind::Localized, topics.count(channel), evidence);
        }
        let evidence = "no topic".to_owned();
        Ok(FoundReference { poses: None, kind: LogKind::Raw, messages: 0, evidence })
    }

    /// The error that no transforms lead from a frame to another; it lists those that are there.
    pub fn no_transforms(&self, role: &str, parent: &str, child: &str, topics: &Topics<'_>) -> DatasetError {
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
    pub fn mount(&self, wanted: Option<Pose2>, laser: &str, base: &str) -> Result<Mount, String> {
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
