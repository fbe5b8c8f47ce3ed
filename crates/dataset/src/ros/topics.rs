use std::collections::BTreeMap;
use std::path::Path;

use locsim_core::limits::quoted;

use super::BagTopics;
use super::bag::{Bag, Channel};
use super::messages::{LaserScan, Message, Odometry, TfMessage};
use crate::DatasetError;

/// The type of a reference topic that isn't odometry.
pub const POSE_STAMPED: &str = "geometry_msgs/msg/PoseStamped";

/// Topics that an error lists, at the most.
const LISTED: usize = 20;

/// Where the transforms are that don't change.
const TF_STATIC: &str = "/tf_static";

/// The channels of a bag and how many messages each has.
pub struct Topics<'a> {
    path: &'a Path,
    counts: BTreeMap<Channel, usize>,
}

/// The channels that a drive is read from.
pub struct Chosen {
    pub scan: Channel,
    pub odometry: Channel,
    pub reference: Option<Channel>,
    pub transforms: Option<Channel>,
    /// What was taken without being asked for, in words.
    pub guessed: Vec<String>,
}

/// What a topic is needed for.
struct Role {
    name: &'static str,
    defaults: &'static [&'static str],
    types: &'static [&'static str],
}

const SCAN: Role = Role { name: "scan", defaults: &["/scan"], types: &[LaserScan::TYPE] };
const ODOMETRY: Role = Role { name: "odometry", defaults: &["/odom"], types: &[Odometry::TYPE] };
const REFERENCE: Role = Role {
    name: "reference",
    defaults: &["/reference", "/ground_truth"],
    types: &[Odometry::TYPE, POSE_STAMPED],
};
const TRANSFORMS: Role = Role { name: "transforms", defaults: &[TF_STATIC], types: &[TfMessage::TYPE] };

impl<'a> Topics<'a> {
    /// Counts the messages of a bag.
    pub fn of(path: &'a Path, bag: &Bag<'_>) -> Result<Self, DatasetError> {
        Ok(Self { path, counts: bag.counts()? })
    }

    /// Chooses the topics of a drive.
    pub fn choose(&self, wanted: &BagTopics) -> Result<Chosen, DatasetError> {
        let mut guessed = Vec::new();
        let reference = self.named(&REFERENCE, wanted.reference.as_deref())?;
        let scan = self.named_or_only(&SCAN, wanted.scan.as_deref(), None, &mut guessed)?;
        let odometry =
            self.named_or_only(&ODOMETRY, wanted.odometry.as_deref(), reference.as_ref(), &mut guessed)?;
        let transforms = self.named(&TRANSFORMS, None)?;
        Ok(Chosen { scan, odometry, reference, transforms, guessed })
    }

    /// Number of messages of a channel.
    pub fn count(&self, channel: &Channel) -> usize {
        self.counts.get(channel).copied().unwrap_or_default()
    }

    /// Number of messages of every topic that isn't read.
    pub fn skipped(&self, chosen: &Chosen) -> BTreeMap<String, usize> {
        let read = [
            Some(&chosen.scan),
            Some(&chosen.odometry),
            chosen.reference.as_ref(),
            chosen.transforms.as_ref(),
        ];
        let mut skipped = BTreeMap::new();
        for (channel, count) in self.counts.iter().filter(|(channel, _)| !read.contains(&Some(channel))) {
            *skipped.entry(quoted(&channel.topic)).or_default() += count;
        }
        skipped
    }

    /// The channel of the name that is wanted, or else of a default name; `None` where neither is there and no name
    /// was wanted.
    fn named(&self, role: &Role, wanted: Option<&str>) -> Result<Option<Channel>, DatasetError> {
        let names = wanted.as_slice();
        let names = if names.is_empty() { role.defaults } else { names };
        let of_name = |name: &&str| self.candidates(role).find(|channel| channel.topic == **name);
        match names.iter().find_map(of_name) {
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
        taken: Option<&Channel>,
        guessed: &mut Vec<String>,
    ) -> Result<Channel, DatasetError> {
        if let Some(channel) = self.named(role, wanted)? {
            return Ok(channel);
        }
        let candidates: Vec<_> = self
            .candidates(role)
            .filter(|channel| Some(*channel) != taken)
            .map(|c| c.topic.as_str())
            .collect();
        let (name, default, types) = (role.name, role.defaults[0], role.types[0]);
        if let [topic] = candidates[..] {
            let quoted = quoted(topic);
            guessed.push(format!("{quoted} is taken for {name} as the only topic of its type"));
            return Ok(self.named(role, Some(topic))?.unwrap_or_default());
        }
        let among = if candidates.is_empty() { "no" } else { "no single" };
        Err(self.refuse(format!(
            "no topic `{default}` for {name}, and {among} other topic of type {types}; allowed: a topic that is named, \
             `{default}`, or one alone of its type"
        )))
    }

    /// The channels with messages of a type that will do.
    fn candidates(&self, role: &Role) -> impl Iterator<Item = &Channel> {
        let right = |channel: &Channel| role.types.contains(&channel.schema.as_str());
        self.counts
            .iter()
            .filter(move |(channel, count)| **count > 0 && right(channel))
            .map(|(channel, _)| channel)
    }

    fn refuse(&self, reason: String) -> DatasetError {
        let found = self.counts.iter().map(|(channel, count)| {
            format!("{} ({}, {count} messages)", quoted(&channel.topic), quoted(&channel.schema))
        });
        let mut found: Vec<_> = found.take(LISTED).collect();
        if self.counts.len() > LISTED {
            found.push(format!("{} more", self.counts.len() - LISTED));
        }
        let found = if found.is_empty() { "no topic".to_owned() } else { found.join(", ") };
        DatasetError::Topic { path: self.path.to_owned(), reason, found }
    }
}
