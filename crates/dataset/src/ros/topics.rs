use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use locsim_core::limits::quoted;

use super::BagOptions;
use super::bag::{Bag, Channel, Tally};
use super::messages::{
    LaserScan, MULTI_ECHO_LASER_SCAN, Message, Odometry, POINT_CLOUD_2, POSE_STAMPED,
    POSE_WITH_COVARIANCE_STAMPED, TRANSFORM_STAMPED, TfMessage,
};
use super::poses::plain;
use crate::DatasetError;

/// Topics that an error lists, at the most.
const LISTED: usize = 20;

/// The frames of REP-105 that odometry and maps are in.
pub const ODOM: &str = "odom";
pub const MAP: &str = "map";

/// The channels of a bag and the messages of each.
pub struct Topics<'a> {
    path: &'a Path,
    tallies: BTreeMap<Channel, Tally>,
}

/// Where poses over time are found.
#[derive(Clone, Debug, PartialEq)]
pub enum PoseSource {
    /// Messages of their own.
    Topic(Channel),
    /// The transform `parent_from_child`, which transforms of `/tf` and `/tf_static` make up.
    Transform { parent: String, child: String },
}

/// The channels that a drive is read from.
pub struct Chosen {
    pub scan: Channel,
    /// `None`: the transform from a base to [`ODOM`], if there is one.
    pub odometry: Option<PoseSource>,
    /// `None`: the transform from the base to [`MAP`], if there is one, or else `localizer`.
    pub reference: Option<PoseSource>,
    /// Poses that a localizer published.
    pub localizer: Option<Channel>,
    /// Transforms that change.
    pub transforms: Option<Channel>,
    pub fixed_transforms: Option<Channel>,
    /// Choices that the user didn't make, in words.
    pub guessed: Vec<String>,
}

impl Chosen {
    /// The channels whose messages are needed.
    pub fn channels(&self) -> Vec<&Channel> {
        let mut channels = vec![&self.scan];
        for source in [&self.odometry, &self.reference] {
            if let Some(PoseSource::Topic(channel)) = source {
                channels.push(channel);
            }
        }
        channels.extend(&self.localizer);
        channels.extend(&self.transforms);
        channels.extend(&self.fixed_transforms);
        channels
    }
}

/// Use of a topic.
struct Role {
    name: &'static str,
    defaults: &'static [&'static str],
    types: &'static [&'static str],
}

const SCAN: Role =
    Role { name: "scan", defaults: &["/scan"], types: &[LaserScan::TYPE, MULTI_ECHO_LASER_SCAN] };
/// Clouds are asked where there are no scans: other sensors than lidars publish them, too.
const CLOUD: Role = Role { name: "scan", defaults: &[], types: &[POINT_CLOUD_2] };
const ODOMETRY: Role =
    Role { name: "odometry", defaults: &["/odom", "/odometry/filtered"], types: &[Odometry::TYPE] };
const REFERENCE: Role = Role {
    name: "reference",
    defaults: &["/reference", "/ground_truth", "/base_pose_ground_truth", "/ground_truth/state"],
    types: &[Odometry::TYPE, POSE_STAMPED, POSE_WITH_COVARIANCE_STAMPED, TRANSFORM_STAMPED],
};
const LOCALIZER: Role =
    Role { name: "localizer", defaults: &["/amcl_pose"], types: &[POSE_WITH_COVARIANCE_STAMPED] };
const TRANSFORMS: Role = Role { name: "transforms", defaults: &["/tf"], types: &[TfMessage::TYPE] };
const FIXED_TRANSFORMS: Role =
    Role { name: "fixed transforms", defaults: &["/tf_static"], types: &[TfMessage::TYPE] };

/// Two frames that are written `parent:child`, or `/tf:parent.child` as evo does; no topic's name has a colon.
fn frames(name: &str) -> Option<PoseSource> {
    let (parent, child) = match name.strip_prefix("/tf:") {
        Some(pair) => pair.split_once('.')?,
        None => name.split_once(':')?,
    };
    let [parent, child] = [parent, child].map(|frame| plain(frame).to_owned());
    // A frame in itself never moves.
    (!parent.is_empty() && !child.is_empty() && parent != child)
        .then_some(PoseSource::Transform { parent, child })
}

impl<'a> Topics<'a> {
    /// Counts the messages of a bag.
    pub fn of(path: &'a Path, bag: &Bag<'_>) -> Result<Self, DatasetError> {
        Ok(Self { path, tallies: bag.tallies()? })
    }

    /// Chooses the topics of a drive.
    pub fn choose(&self, options: &BagOptions) -> Result<Chosen, DatasetError> {
        let wanted = &options.topics;
        let mut guessed = Vec::new();
        let scan = self.scan(wanted.scan.as_deref(), &mut guessed)?;
        let space = scan.topic.rsplit_once('/').map_or("", |(space, _)| space);
        let reference = match wanted.reference.as_deref() {
            Some(name) if frames(name).is_some() => frames(name),
            name => self.named(&REFERENCE, name, space)?.map(PoseSource::Topic),
        };
        let fixed_transforms = self.named(&FIXED_TRANSFORMS, None, space)?;
        let mut transforms = self.named(&TRANSFORMS, None, space)?;
        let others: Vec<_> =
            self.candidates(&SCAN).filter(|channel| **channel != scan).map(|c| self.in_words(c)).collect();
        if !others.is_empty() {
            guessed.push(format!("other scanners: {}", others.join(", ")));
        }
        let taken = match &reference {
            Some(PoseSource::Topic(channel)) => Some(channel),
            _ => None,
        };
        let alone = |channel: &Channel| Some(channel) != taken;
        let odometry = match wanted.odometry.as_deref() {
            Some(name) if frames(name).is_some() => frames(name),
            _ if options.without_odometry => None,
            // Without odometry of its own, a bag may have it as a transform.
            None if transforms.is_some() && !self.candidates(&ODOMETRY).any(alone) => None,
            name => {
                Some(PoseSource::Topic(self.named_or_only(&ODOMETRY, name, space, taken, &mut guessed)?))
            }
        };
        if let (Some(PoseSource::Topic(chosen)), None) = (&odometry, &wanted.odometry) {
            let others: Vec<_> =
                self.candidates(&ODOMETRY).filter(|channel| *channel != chosen && alone(channel)).collect();
            if !others.is_empty() {
                let others: Vec<_> = others.into_iter().map(|channel| self.in_words(channel)).collect();
                guessed.push(format!("other odometry: {}", others.join(", ")));
            }
        }
        let localizer = if reference.is_none() { self.named(&LOCALIZER, None, space)? } else { None };
        // They may as well be goals, or what a localizer found: whoever recorded them knows.
        let poses: Vec<_> = self
            .candidates(&REFERENCE)
            .filter(|channel| channel.schema != Odometry::TYPE && Some(*channel) != localizer.as_ref())
            .map(|channel| self.in_words(channel))
            .take(LISTED)
            .collect();
        if reference.is_none() && !poses.is_empty() {
            guessed.push(format!("poses that may be named as the reference: {}", poses.join(", ")));
        }
        let is_topic = |source: &Option<PoseSource>| matches!(source, Some(PoseSource::Topic(_)));
        // A laser's mount may be among the transforms where none is static.
        if is_topic(&odometry) && is_topic(&reference) && fixed_transforms.is_some() {
            transforms = None;
        }
        let mut chosen =
            Chosen { scan, odometry, reference, localizer, transforms, fixed_transforms, guessed };
        let shared = self.of_several_types(&chosen);
        chosen.guessed.extend(shared);
        Ok(chosen)
    }

    /// The channel of scans, or of clouds where there are none or where one is named.
    fn scan(&self, wanted: Option<&str>, guessed: &mut Vec<String>) -> Result<Channel, DatasetError> {
        let mut clouds = self.candidates(&CLOUD).map(|channel| channel.topic.clone());
        let cloud = match wanted {
            Some(name) => clouds.find(|topic| topic == name),
            None if self.candidates(&SCAN).next().is_some() => None,
            None => clouds.next().filter(|_| clouds.next().is_none()),
        };
        match cloud {
            Some(topic) => Ok(self.named(&CLOUD, Some(&topic), "")?.unwrap_or_default()),
            None => self.named_or_only(&SCAN, wanted, "", None, guessed),
        }
    }

    /// The names under which channels of several types stand, of which one is read, in words.
    fn of_several_types(&self, chosen: &Chosen) -> Vec<String> {
        let names: BTreeSet<&str> =
            chosen.channels().into_iter().map(|channel| channel.topic.as_str()).collect();
        let types = |name: &str| -> BTreeSet<String> {
            let channels = self.tallies.keys().filter(|channel| channel.topic == name);
            channels.map(|channel| quoted(&channel.schema)).collect()
        };
        let several = names.into_iter().map(|name| (name, types(name))).filter(|(_, types)| types.len() > 1);
        let in_words = |(name, types): (&str, BTreeSet<String>)| {
            let types: Vec<String> = types.into_iter().take(LISTED).collect();
            format!("{} has messages of several types, as no topic may: {}", quoted(name), types.join(", "))
        };
        several.map(in_words).collect()
    }

    /// Number of messages of all channels.
    pub fn messages(&self) -> usize {
        self.tallies.values().map(|tally| tally.messages).sum()
    }

    /// A channel with its number of messages.
    pub fn in_words(&self, channel: &Channel) -> String {
        format!("{} ({} messages)", quoted(&channel.topic), self.count(channel))
    }

    /// Number of messages of a channel.
    pub fn count(&self, channel: &Channel) -> usize {
        self.tallies.get(channel).map_or(0, |tally| tally.messages)
    }

    /// Number of messages of every topic that isn't read.
    pub fn skipped(&self, chosen: &Chosen) -> BTreeMap<String, usize> {
        let read = chosen.channels();
        let mut skipped = BTreeMap::new();
        for (channel, tally) in self.tallies.iter().filter(|(channel, _)| !read.contains(channel)) {
            *skipped.entry(quoted(&channel.topic)).or_default() += tally.messages;
        }
        skipped
    }

    /// The channel of the name that is wanted, or else of a default name: as it is, in the namespace `space`, or in the
    /// only namespace that has it. `None` where none is there and no name was wanted.
    fn named(&self, role: &Role, wanted: Option<&str>, space: &str) -> Result<Option<Channel>, DatasetError> {
        let of_name = |name: &str| self.candidates(role).find(|channel| channel.topic == name);
        let in_a_namespace = |name: &&str| {
            let mut found = self.candidates(role).filter(|channel| channel.topic.ends_with(*name));
            found.next().filter(|_| found.next().is_none())
        };
        let found = match wanted {
            Some(name) => of_name(name),
            None => (role.defaults.iter().find_map(|name| of_name(name)))
                .or_else(|| role.defaults.iter().find_map(|name| of_name(&format!("{space}{name}"))))
                .or_else(|| role.defaults.iter().find_map(in_a_namespace)),
        };
        match found {
            Some(channel) if channel.encoding == "cdr" => Ok(Some(channel.clone())),
            Some(Channel { topic, encoding, .. }) => {
                let (topic, encoding) = (quoted(topic), quoted(encoding));
                Err(self.refuse(format!("messages of {topic} are encoded as `{encoding}`; allowed: `cdr`")))
            }
            None => wanted.map_or(Ok(None), |name| {
                let (role, name, types) = (role.name, quoted(name), role.types.join(" or "));
                Err(self.refuse(format!("{role} topic `{name}` isn't there with messages of type {types}")))
            }),
        }
    }

    /// [`Self::named`], or else the only channel of the right type beside `taken`.
    fn named_or_only(
        &self,
        role: &Role,
        wanted: Option<&str>,
        space: &str,
        taken: Option<&Channel>,
        guessed: &mut Vec<String>,
    ) -> Result<Channel, DatasetError> {
        if let Some(channel) = self.named(role, wanted, space)? {
            return Ok(channel);
        }
        let candidates: Vec<_> = self
            .candidates(role)
            .filter(|channel| Some(*channel) != taken)
            .map(|c| c.topic.as_str())
            .collect();
        let (name, default, types) = (role.name, role.defaults[0], role.types.join(" or "));
        if let [topic] = candidates[..] {
            let quoted = quoted(topic);
            guessed.push(format!("{quoted} is taken for {name} as the only topic of its type"));
            return Ok(self.named(role, Some(topic), "")?.unwrap_or_default());
        }
        let others = if candidates.is_empty() {
            format!("no other topic of type {types}")
        } else {
            let candidates: Vec<_> = candidates.into_iter().take(LISTED).map(quoted).collect();
            format!("no single other topic of type {types}, but {}", candidates.join(" and "))
        };
        Err(self.refuse(format!(
            "no topic `{default}` for {name}, and {others}; allowed: a topic that is named, `{default}`, or one alone of \
             its type"
        )))
    }

    /// The channels with messages of a type that will do.
    fn candidates(&self, role: &Role) -> impl Iterator<Item = &Channel> {
        let right = |channel: &Channel| role.types.contains(&channel.schema.as_str());
        self.tallies
            .iter()
            .filter(move |(channel, tally)| tally.messages > 0 && right(channel))
            .map(|(channel, _)| channel)
    }

    /// The error that something is missing; it lists what is there.
    pub fn refuse(&self, reason: String) -> DatasetError {
        let listed = self.listed();
        let is_of_ros_1 = self.tallies.keys().all(|channel| channel.encoding == "ros1");
        let reason = if is_of_ros_1 && !self.tallies.is_empty() {
            "messages are those of ROS 1; `rosbags-convert` makes a bag of ROS 2 of its .bag".to_owned()
        } else {
            reason
        };
        let found = if listed.is_empty() { "no topic".to_owned() } else { listed.join(", ") };
        DatasetError::Topic { path: self.path.to_owned(), reason, found }
    }

    /// The topics with types and numbers of messages.
    pub fn listed(&self) -> Vec<String> {
        let found = self.tallies.iter().map(|(channel, tally)| {
            let count = tally.messages;
            format!("{} ({}, {count} messages)", quoted(&channel.topic), quoted(&channel.schema))
        });
        let mut found: Vec<_> = found.take(LISTED).collect();
        if self.tallies.len() > LISTED {
            found.push(format!("{} more", self.tallies.len() - LISTED));
        }
        found
    }
}
