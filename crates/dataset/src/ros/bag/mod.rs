//! The files of a bag and the messages in them.

mod folder;
mod mcap;
mod sqlite;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use locsim_core::limits::{Limits, quoted};

pub use folder::{counted_messages, files as folder_files, is_recording};

use crate::DatasetError;
use crate::log_files;
use crate::source::{Allowance, Content, Source, ZSTD, not_a_log, unpack_message};

/// Bytes of a record that is held in memory, at the most: of a message that is read, a channel, a schema. A scan of a
/// million beams has half of that.
pub const LARGEST_RECORD: u64 = 1 << 24;

/// Bytes of the name of a topic, a type, a frame or an encoding, at the most; DDS allows 256.
pub const LONGEST_NAME: usize = 1000;

/// Channels of a bag, at the most; robots have hundreds.
const MOST_CHANNELS: usize = 10_000;

/// Topic and type of a message.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Channel {
    pub topic: String,
    /// Name of the message's type; empty where the file doesn't tell.
    pub schema: String,
    /// How the message is serialized; `cdr` in a ROS 2 bag.
    pub encoding: String,
}

/// How the messages of a channel are defined, and what their recorder noted of them; empty where the file doesn't tell.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Definition {
    /// Language of the definition, such as `ros2msg`.
    pub encoding: String,
    pub text: Vec<u8>,
    /// Quality of service among other things.
    pub metadata: BTreeMap<String, String>,
}

/// What a file says of a message beside its bytes.
#[derive(Clone, Copy)]
pub struct Envelope<'a> {
    /// When it was recorded and when it was published (ns).
    pub logged: i64,
    pub published: i64,
    pub definition: &'a Definition,
}

/// The messages of a channel: how many, and when they were recorded.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tally {
    pub messages: usize,
    /// First and last time of recording (ns).
    pub logged: Option<[i64; 2]>,
    /// Longest time without a message (ns), by the order of the file.
    pub longest_gap: i64,
}

impl Tally {
    /// Takes in the next message.
    pub fn add(&mut self, logged: i64) {
        self.join(Self { messages: 1, logged: Some([logged; 2]), longest_gap: 0 });
    }

    /// Takes in the messages of a later file.
    pub fn join(&mut self, later: Self) {
        self.messages += later.messages;
        self.longest_gap = self.longest_gap.max(later.longest_gap);
        if let (Some([_, before]), Some([after, _])) = (self.logged, later.logged) {
            self.longest_gap = self.longest_gap.max(after.saturating_sub(before));
        }
        let all = self.logged.into_iter().chain(later.logged);
        self.logged = all.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
    }
}

/// A bag: one file, or the files of a folder in the order in which they were recorded.
pub struct Bag<'a> {
    files: Vec<BagFile>,
    limits: &'a Limits,
}

struct BagFile {
    path: PathBuf,
    storage: Storage,
}

enum Storage {
    Mcap,
    Sqlite(sqlite::Database),
}

impl<'a> Bag<'a> {
    /// Opens a bag.
    ///
    /// # Errors
    /// A file can't be opened or isn't a bag's, or the folder isn't one bag's.
    pub fn open(path: &Path, limits: &'a Limits) -> Result<Self, DatasetError> {
        let files = log_files(path)?.into_iter().map(|path| {
            let source = Source::open(&path, limits)?;
            if source.length == 0 {
                return Err(not_a_log(
                    &path,
                    "an empty file",
                    "a ROS 2 bag (a folder, MCAP or SQLite), without empty parts",
                ));
            }
            let storage = match source.content {
                Content::Mcap => Storage::Mcap,
                Content::Sqlite => Storage::Sqlite(sqlite::Database::open(&path, source)?),
                Content::Text | Content::BeesoftMap => {
                    return Err(not_a_log(&path, "a text file", "a ROS 2 bag (a folder, MCAP or SQLite)"));
                }
            };
            Ok(BagFile { path, storage })
        });
        Ok(Self { files: files.collect::<Result<_, _>>()?, limits })
    }

    /// The channels of the bag with the messages of each.
    ///
    /// # Errors
    /// A file is damaged or costs more than the limits allow.
    pub fn tallies(&self) -> Result<BTreeMap<Channel, Tally>, DatasetError> {
        let mut tallies = BTreeMap::<Channel, Tally>::new();
        for file in &self.files {
            file.count(self.limits, |channel, tally| {
                let channels = tallies.len();
                match tallies.get_mut(channel) {
                    Some(earlier) => earlier.join(tally),
                    None if channels == MOST_CHANNELS => {
                        let reason =
                            format!("more than {MOST_CHANNELS} channels; allowed: at most {MOST_CHANNELS}");
                        return Err(DatasetError::Refused { path: file.path.clone(), line: None, reason });
                    }
                    None => _ = tallies.insert(channel.clone(), tally),
                }
                Ok(())
            })?;
        }
        Ok(tallies)
    }

    /// Hands the messages of the wanted channels to `take`, in the order in which they were recorded. Messages that are
    /// compressed one by one are unpacked.
    ///
    /// Damage may show only after a message was taken: what a message holds counts once the whole bag was read.
    ///
    /// # Errors
    /// A file is damaged or costs more than the limits allow, or `take` says why a message is refused.
    pub fn read(
        &self,
        wanted: &[&Channel],
        mut take: impl FnMut(&Channel, &[u8]) -> Result<(), String>,
    ) -> Result<(), DatasetError> {
        self.visit(|channel| wanted.contains(&channel), |channel, _, data| take(channel, data))
    }

    /// As [`Self::read`], with what the file says of each message.
    pub fn visit(
        &self,
        wanted: impl Fn(&Channel) -> bool,
        mut take: impl FnMut(&Channel, Envelope<'_>, &[u8]) -> Result<(), String>,
    ) -> Result<(), DatasetError> {
        let mut numbers = BTreeMap::<Channel, usize>::new();
        let mut messages = 0;
        let mut unpacked = Vec::new();
        for file in &self.files {
            let mut allowance = Allowance::of(file.length()?, self.limits);
            let mut take = |channel: &Channel, envelope: Envelope<'_>, data: Result<&[u8], String>| {
                let number = numbers.entry(channel.clone()).or_default();
                *number += 1;
                messages += 1;
                let taken = data.and_then(|data| {
                    if messages > self.limits.log_messages {
                        return Err(Limits::refusal_above("log_messages", self.limits.log_messages));
                    }
                    // No message in CDR begins so.
                    if data.starts_with(ZSTD) {
                        unpack_message(data, LARGEST_RECORD, &mut allowance, &mut unpacked)
                            .map_err(|error| format!("the message can't be unpacked: {error}"))?;
                        return take(channel, envelope, &unpacked);
                    }
                    take(channel, envelope, data)
                });
                taken.map_err(|reason| DatasetError::Message {
                    path: file.path.clone(),
                    topic: quoted(&channel.topic),
                    number: *number,
                    reason,
                })
            };
            match &file.storage {
                Storage::Mcap => mcap::visit_messages(&file.path, self.limits, |channel, content| {
                    match content.filter(|_| wanted(channel)) {
                        Some(content) => take(channel, content.envelope, content.bytes()),
                        None => Ok(()),
                    }
                })?,
                Storage::Sqlite(database) => database.read(&file.path, &wanted, &mut take)?,
            }
        }
        Ok(())
    }
}

impl BagFile {
    fn length(&self) -> Result<u64, DatasetError> {
        let metadata = self.path.metadata();
        metadata
            .map(|metadata| metadata.len())
            .map_err(|source| DatasetError::Open { path: self.path.clone(), source })
    }

    /// Hands every channel, some of them more than once, to `add` with the messages that it has more.
    fn count(
        &self,
        limits: &Limits,
        mut add: impl FnMut(&Channel, Tally) -> Result<(), DatasetError>,
    ) -> Result<(), DatasetError> {
        match &self.storage {
            Storage::Mcap => mcap::visit_messages(&self.path, limits, |channel, message| {
                let mut tally = Tally::default();
                if let Some(message) = message {
                    tally.add(message.envelope.logged);
                }
                add(channel, tally)
            }),
            Storage::Sqlite(database) => {
                database.tallies(&self.path)?.iter().try_for_each(|(channel, tally)| add(channel, *tally))
            }
        }
    }
}
