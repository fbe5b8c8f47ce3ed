//! Bags that rosbag2 wrote to `SQLite`: tables `topics` and `messages`.
//!
//! A file may come from anywhere. Views, triggers and virtual tables are refused, so that nothing but rows is read, and
//! the work of the database engine is bounded by the file's length.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use locsim_core::limits::quoted;
use rusqlite::config::DbConfig;
use rusqlite::limits::Limit;
use rusqlite::{Connection, OpenFlags};
use tempfile::NamedTempFile;

use super::{Channel, Definition, Envelope, LARGEST_RECORD, LONGEST_NAME, MOST_CHANNELS, Tally};
use crate::DatasetError;
use crate::source::Source;

/// Instructions of the database engine between two looks at the budget.
const INSTRUCTIONS: u32 = 10_000;

/// Instructions for a byte of the file, at the most. A row takes ten to twenty and has at least ten bytes.
const INSTRUCTIONS_PER_BYTE: u64 = 20;

/// Instructions for a file of any length, at the most: those to read the schema, and more.
const INSTRUCTIONS_OF_A_FILE: u64 = 1_000_000;

/// A file that is open.
pub struct Database {
    connection: Connection,
    channels: BTreeMap<i64, Channel>,
    definitions: BTreeMap<i64, Definition>,
    length: u64,
    /// Looks at the budget that are left to the query under way.
    budget: Arc<AtomicU64>,
    /// Where a compressed file was unpacked to; removed with the value, after the connection is closed.
    _unpacked: Option<NamedTempFile>,
}

impl Database {
    pub fn open(path: &Path, source: Source) -> Result<Self, DatasetError> {
        let Source { packed, mut stream, .. } = source;
        let mut unpacked = None;
        let mut stored = path.to_owned();
        if packed {
            let failed = |source: io::Error| match source.kind() {
                ErrorKind::FileTooLarge => {
                    DatasetError::Refused { path: path.to_owned(), line: None, reason: source.to_string() }
                }
                _ => damaged(path, source.to_string()),
            };
            let mut file = NamedTempFile::new().map_err(failed)?;
            io::copy(&mut stream, &mut file).map_err(failed)?;
            file.path().clone_into(&mut stored);
            unpacked = Some(file);
        }
        let unopened = |source| DatasetError::Open { path: path.to_owned(), source };
        let length = fs::metadata(&stored).map_err(unopened)?.len();
        // The file is opened as immutable: SQLite then takes no lock and writes nothing beside it, but doesn't read
        // what is still in the log of a database that wasn't closed.
        let log = PathBuf::from(format!("{}-wal", stored.display()));
        if fs::metadata(&log).is_ok_and(|metadata| metadata.len() > 0) {
            let reason = "the end of the recording is still in the file that ends in `-wal` \
                          (`sqlite3 FILE 'PRAGMA wal_checkpoint'` completes it)";
            return Err(damaged(path, reason.to_owned()));
        }
        let refuse = |error: rusqlite::Error| damaged(path, error.to_string());
        let flags =
            OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_URI | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let mut connection = Connection::open_with_flags(immutable(&stored), flags).map_err(refuse)?;
        for (setting, on) in [
            (DbConfig::SQLITE_DBCONFIG_DEFENSIVE, true),
            (DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA, false),
            (DbConfig::SQLITE_DBCONFIG_ENABLE_VIEW, false),
            (DbConfig::SQLITE_DBCONFIG_ENABLE_TRIGGER, false),
        ] {
            connection.set_db_config(setting, on).map_err(refuse)?;
        }
        // A row is a message and some numbers.
        connection.set_limit(Limit::SQLITE_LIMIT_LENGTH, LARGEST_RECORD as i32 + 1024).map_err(refuse)?;
        let budget = Arc::new(AtomicU64::new(0));
        let left = Arc::clone(&budget);
        let exhausted = move || {
            left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1)).is_err()
        };
        connection.progress_handler(INSTRUCTIONS as i32, Some(exhausted)).map_err(refuse)?;
        let mut database = Self {
            connection,
            channels: BTreeMap::new(),
            definitions: BTreeMap::new(),
            length,
            budget,
            _unpacked: unpacked,
        };
        database.channels = database.topics().map_err(|reason| damaged(path, reason))?;
        // A recorder of another version notes other things; messages are read all the same.
        database.definitions = database.definitions().unwrap_or_default();
        Ok(database)
    }

    /// Definitions of the channels' messages, which rosbag2 has noted since ROS Iron, and the quality of service.
    fn definitions(&self) -> rusqlite::Result<BTreeMap<i64, Definition>> {
        self.refill();
        let mut definitions = BTreeMap::<i64, Definition>::new();
        let mut of_topics = self.connection.prepare("SELECT id, offered_qos_profiles FROM topics")?;
        let mut rows = of_topics.query([])?;
        while let Some(row) = rows.next()? {
            let quality = ("offered_qos_profiles".to_owned(), row.get(1)?);
            definitions.entry(row.get(0)?).or_default().metadata.extend([quality]);
        }
        let query =
            "SELECT encoding, encoded_message_definition FROM message_definitions WHERE topic_type = ?";
        let Ok(mut of_type) = self.connection.prepare(query) else { return Ok(definitions) };
        for (id, channel) in &self.channels {
            let found =
                of_type.query_row([&channel.schema], |row| Ok((row.get(0)?, row.get::<_, String>(1)?)));
            if let Ok((encoding, text)) = found {
                let definition = definitions.entry(*id).or_default();
                (definition.encoding, definition.text) = (encoding, text.into_bytes());
            }
        }
        Ok(definitions)
    }

    /// The channels and their numbers.
    fn topics(&self) -> Result<BTreeMap<i64, Channel>, String> {
        self.refill();
        let tables = "SELECT count(*) FROM pragma_table_list \
                      WHERE schema = 'main' AND type = 'table' AND name IN ('topics', 'messages')";
        let tables = self.connection.query_row(tables, [], |row| row.get::<_, i64>(0)).map_err(in_words)?;
        if tables != 2 {
            return Err("it has no tables `topics` and `messages`".to_owned());
        }
        let query = "SELECT id, name, type, serialization_format FROM topics";
        let mut statement = self.connection.prepare(query).map_err(in_words)?;
        let mut rows = statement.query([]).map_err(in_words)?;
        let mut channels = BTreeMap::new();
        while let Some(row) = rows.next().map_err(in_words)? {
            if channels.len() == MOST_CHANNELS {
                return Err(format!("it has more than {MOST_CHANNELS} topics"));
            }
            let name = |column: usize| -> Result<String, String> {
                let name = row.get_ref(column).map_err(in_words)?;
                let name = name.as_str().map_err(|_| "the name of a topic isn't text".to_owned())?;
                if name.len() > LONGEST_NAME {
                    let (name, length) = (quoted(name), name.len());
                    return Err(format!("the name `{name}` has {length} bytes; at most {LONGEST_NAME}"));
                }
                Ok(name.to_owned())
            };
            let id = row.get(0).map_err(in_words)?;
            channels.insert(id, Channel { topic: name(1)?, schema: name(2)?, encoding: name(3)? });
        }
        Ok(channels)
    }

    /// The channels with the messages of each.
    pub fn tallies(&self, path: &Path) -> Result<BTreeMap<Channel, Tally>, DatasetError> {
        let count = || {
            self.refill();
            let mut tallies: BTreeMap<i64, Tally> =
                self.channels.keys().map(|id| (*id, Tally::default())).collect();
            let query = "SELECT topic_id, timestamp FROM messages";
            let mut statement = self.connection.prepare(query).map_err(in_words)?;
            let mut rows = statement.query([]).map_err(in_words)?;
            while let Some(row) = rows.next().map_err(in_words)? {
                let id: i64 = row.get(0).map_err(in_words)?;
                let tally = tallies.get_mut(&id).ok_or_else(|| format!("a message of unknown topic {id}"))?;
                tally.add(row.get(1).map_err(in_words)?);
            }
            Ok(tallies)
        };
        let tallies = count().map_err(|reason| damaged(path, reason))?;
        let mut by_channel = BTreeMap::<_, Tally>::new();
        for (id, tally) in tallies {
            by_channel.entry(self.channels[&id].clone()).or_default().join(tally);
        }
        Ok(by_channel)
    }

    /// Hands the messages of the wanted channels to `take`, in the order of their rows, which is that of recording.
    pub fn read(
        &self,
        path: &Path,
        wanted: &impl Fn(&Channel) -> bool,
        take: &mut impl FnMut(&Channel, Envelope<'_>, Result<&[u8], String>) -> Result<(), DatasetError>,
    ) -> Result<(), DatasetError> {
        self.refill();
        let fail = |error| damaged(path, in_words(error));
        let mut ids = String::new();
        for (id, _) in self.channels.iter().filter(|(_, channel)| wanted(channel)) {
            _ = write!(ids, "{}{id}", if ids.is_empty() { "" } else { ", " });
        }
        // `+` keeps an index from changing the order of the rows.
        let query = format!("SELECT topic_id, data, timestamp FROM messages WHERE +topic_id IN ({ids})");
        let mut statement = self.connection.prepare(&query).map_err(fail)?;
        let mut rows = statement.query([]).map_err(fail)?;
        let mut left = self.length;
        let unknown = Definition::default();
        while let Some(row) = rows.next().map_err(fail)? {
            let id: i64 = row.get(0).map_err(fail)?;
            let data = row.get_ref(1).map_err(fail)?;
            let data = data.as_blob().map_err(|_| damaged(path, "a message isn't bytes".to_owned()))?;
            // Rows of a damaged file may share their bytes.
            left = left
                .checked_sub(data.len() as u64)
                .ok_or_else(|| damaged(path, "the messages are longer than the file".to_owned()))?;
            let channel = self.channels.get(&id).ok_or_else(|| damaged(path, format!("no topic {id}")))?;
            let logged = row.get(2).map_err(fail)?;
            let definition = self.definitions.get(&id).unwrap_or(&unknown);
            take(channel, Envelope { logged, published: logged, definition }, Ok(data))?;
        }
        Ok(())
    }

    /// Gives the next query its budget.
    fn refill(&self) {
        let instructions =
            self.length.saturating_mul(INSTRUCTIONS_PER_BYTE).saturating_add(INSTRUCTIONS_OF_A_FILE);
        self.budget.store(instructions / u64::from(INSTRUCTIONS), Ordering::Relaxed);
    }
}

/// The words of an error of the library, with hidden characters escaped.
#[expect(clippy::needless_pass_by_value, reason = "the form that `map_err` takes")]
fn in_words(error: rusqlite::Error) -> String {
    match error.sqlite_error_code() {
        Some(rusqlite::ErrorCode::OperationInterrupted) => {
            "reading it takes more steps than any file of its length needs".to_owned()
        }
        _ => quoted(&error.to_string()),
    }
}

fn damaged(path: &Path, reason: String) -> DatasetError {
    DatasetError::Sqlite { path: path.to_owned(), reason }
}

/// The address under which `SQLite` opens a file that nobody changes.
fn immutable(path: &Path) -> String {
    let mut address = "file:".to_owned();
    for character in path.to_string_lossy().chars() {
        match character {
            '%' => address += "%25",
            '?' => address += "%3f",
            '#' => address += "%23",
            other => address.push(other),
        }
    }
    address + "?immutable=1"
}
