//! Bags as rosbag2 stores them: folders of split files, `SQLite`, compression of files and of messages.

use rusqlite::{Connection, params};

use super::*;
use crate::LogFormat;

/// The tables of rosbag2 in Humble.
const TABLES: &str = "
    CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
        serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);
    CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
        data BLOB NOT NULL);
    CREATE INDEX timestamp_idx ON messages (timestamp ASC);";

fn zstd(bytes: &[u8]) -> Vec<u8> {
    compress_to_vec(bytes, CompressionLevel::Fastest)
}

fn execute(path: &Path, statements: &str) {
    let settings = "PRAGMA journal_mode = MEMORY; PRAGMA synchronous = OFF;";
    Connection::open(path).unwrap().execute_batch(&format!("{settings} {statements}")).unwrap();
}

impl Bag {
    /// The bytes of a `.db3` file.
    pub fn db3(&self) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bag.db3");
        let connection = Connection::open(&path).unwrap();
        // As rosbag2 does; waiting for the disk takes seconds.
        connection.execute_batch("PRAGMA journal_mode = MEMORY; PRAGMA synchronous = OFF;").unwrap();
        connection.execute_batch(TABLES).unwrap();
        let mut topics = Vec::new();
        for (topic, schema, encoding, data) in &self.messages {
            let id = topics.iter().position(|known| known == topic).unwrap_or_else(|| {
                topics.push(topic.clone());
                let row = params![topics.len() as i64, topic, schema, encoding];
                connection.execute("INSERT INTO topics VALUES(?, ?, ?, ?, '')", row).unwrap();
                topics.len() - 1
            });
            let row = params![id as i64 + 1, data];
            connection
                .execute("INSERT INTO messages(topic_id, timestamp, data) VALUES(?, 0, ?)", row)
                .unwrap();
        }
        drop(connection);
        fs::read(path).unwrap()
    }

    /// The bag of some of the messages.
    fn part(&self, messages: std::ops::Range<usize>) -> Self {
        Self { messages: self.messages[messages].to_vec(), logged: Vec::new() }
    }
}

fn written(files: &[(&str, Vec<u8>)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in files {
        fs::write(folder.path().join(name), bytes).unwrap();
    }
    folder
}

fn log(path: &Path) -> Result<Drive, String> {
    read_log(path, &LogOptions::default()).map(|(drive, _)| drive).map_err(|error| error.to_string())
}

#[test]
fn a_file_is_known_by_its_first_bytes() {
    let whole = plain();
    let (expected, _) = whole.read(&BagOptions::default()).unwrap();
    let (mcap, db3) = (whole.bytes(), whole.db3());
    for (name, bytes) in [
        ("bag.mcap", mcap.clone()),
        ("bag.log", mcap.clone()),
        ("bag", mcap.clone()),
        ("bag.mcap.zstd", zstd(&mcap)),
        ("bag.db3", db3.clone()),
        ("bag.mcap", db3.clone()),
        ("a #1?&%20.db3", db3.clone()),
        ("bag.db3.zstd", zstd(&db3)),
    ] {
        let folder = written(&[(name, bytes)]);
        let path = folder.path().join(name);
        assert_eq!(LogFormat::of_content(&path).unwrap(), LogFormat::Bag, "{name}");
        assert_eq!(log(&path).as_ref(), Ok(&expected), "{name}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is written beside {name}");
    }
}

/// `tests/data/README.md` says what is in it.
#[test]
fn a_folder_of_other_programs_is_read() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/rosbags");
    let (drive, summary) = read_log(&path, &LogOptions::default()).unwrap();
    assert_eq!((drive.steps.len(), drive.laser.beam_count(), summary.kind), (5, 36, LogKind::Localized));
    assert!((f64::from(drive.laser.bearings()[0]) + PI).abs() < 1e-6);
    assert!(near(&drive.laser.base_from_laser(), &Pose2::new(0.2, 0.0, PI)));
    let map_from_odom = Pose2::new(10.0, 5.0, 0.5);
    for (i, step) in drive.steps.iter().enumerate() {
        let t = 0.1 * i as f64;
        assert!((step.stamp_secs - 1_700_000_000.0 - t).abs() < 1e-6);
        let odometry = Pose2::new(0.5 * t, 0.1 * t, 0.05 * t);
        assert!(near(&step.odometry, &odometry), "{i}: {:?}", step.odometry);
        assert!(near(&step.reference.unwrap(), &map_from_odom.compose(&odometry)), "{i}");
        let [first, zero, maximum, unknown, reading, ..] = step.scan.ranges[..] else { panic!() };
        assert_eq!((first, maximum), (12.0, 12.0));
        assert!(zero.is_nan() && unknown.is_nan());
        assert!((f64::from(reading) - 3.0 - 40_f64.to_radians().sin()).abs() < 1e-6);
    }
}

#[test]
fn a_folder_is_read_in_the_order_of_its_numbers() {
    // Eleven files, so that order by name isn't order by number.
    let mut whole = plain();
    for i in 0..8 {
        whole = whole.add("/odom", &odometry(4.0 + f64::from(i), &Pose2::IDENTITY));
    }
    whole = whole.add("/scan", &scan(10.0, &[1.0; 5]));
    let (expected, _) = whole.read(&BagOptions::default()).unwrap();
    assert_eq!(expected.steps.len(), 4);
    let count = whole.messages.len();
    let split = |ending: &str, bytes: &dyn Fn(&Bag) -> Vec<u8>| {
        let files = (0..count).map(|i| (format!("drive_{i}{ending}"), bytes(&whole.part(i..i + 1))));
        let files: Vec<_> = files.collect();
        written(&files.iter().map(|(name, bytes)| (name.as_str(), bytes.clone())).collect::<Vec<_>>())
    };
    for folder in [
        split(".mcap", &Bag::bytes),
        split(".db3", &Bag::db3),
        split(".mcap.zstd", &|bag| zstd(&bag.bytes())),
        split(".db3.zstd", &|bag| zstd(&bag.db3())),
    ] {
        fs::write(folder.path().join("metadata.yaml"), "rosbag2_bagfile_information:\n").unwrap();
        assert_eq!(log(folder.path()).as_ref(), Ok(&expected));
    }
}

/// A database whose log of changes wasn't copied has lost messages, which `metadata.yaml` counts.
#[test]
fn messages_that_metadata_counts_are_missed() {
    let whole = plain();
    let folder = written(&[("bag_0.db3", whole.db3())]);
    let remarks = |counted: usize| {
        let text = format!("rosbag2_bagfile_information:\n  message_count: {counted}\n  topics: []\n");
        fs::write(folder.path().join("metadata.yaml"), text).unwrap();
        read_bag(folder.path(), &BagOptions::default()).unwrap().1.remarks
    };
    let count = whole.messages.len();
    let is_told = |remarks: &[String]| remarks.iter().any(|remark| remark.contains("metadata.yaml counts"));
    assert!(!is_told(&remarks(count)));
    let found = remarks(count + 3);
    assert!(is_told(&found), "{found:?}");
}

#[test]
fn messages_are_unpacked_one_by_one() {
    let whole = plain();
    let (expected, _) = whole.read(&BagOptions::default()).unwrap();
    let mut packed = plain();
    for message in &mut packed.messages {
        message.3 = zstd(&message.3);
    }
    assert_eq!(packed.read(&BagOptions::default()).unwrap().0, expected);
    let folder = written(&[("bag_0.db3", packed.db3())]);
    assert_eq!(log(folder.path()), Ok(expected));

    // A message that unpacks to more than any record, and one that is cut.
    packed.messages[1].3 = zstd(&vec![0; (1 << 24) + 1]);
    assert!(
        packed
            .message()
            .contains("/scan: message 1: the message can't be unpacked: it has more than 16777216")
    );
    packed.messages[1].3 = zstd(&whole.messages[1].3)[..30].to_vec();
    assert!(packed.message().contains("/scan: message 1: the message can't be unpacked"));
}

#[test]
fn a_folder_that_is_not_one_bag_is_refused() {
    let (mcap, db3) = (plain().bytes(), plain().db3());
    for (files, part) in [
        (
            &[("metadata.yaml", Vec::new())][..],
            "the folder holds no file of a bag (.mcap, .db3); allowed: the",
        ),
        (
            &[("a_0.mcap", mcap.clone()), ("b_0.mcap", mcap.clone())],
            "the folder holds several bags, `a` and `b`; allowed: the folder of one bag",
        ),
        (&[("a_0.mcap", mcap.clone()), ("a_0.db3", db3)], "are both there"),
        (&[("a_0.mcap", b"TEXT".to_vec())], "a_0.mcap: this is a text file; allowed: a ROS 2 bag"),
    ] {
        let message = log(written(files).path()).unwrap_err();
        assert!(message.contains(part), "{message}");
    }
    // The damaged file is named, not the folder.
    let folder = written(&[("a_0.mcap", mcap.clone()), ("a_1.mcap", mcap[..100].to_vec())]);
    assert!(log(folder.path()).unwrap_err().contains("a_1.mcap: not a complete MCAP file"));
}

#[test]
fn a_database_that_is_no_bag_is_refused() {
    let refused = |statements: &str, part: &str| {
        let folder = written(&[("bag.db3", plain().db3())]);
        let path = folder.path().join("bag.db3");
        execute(&path, statements);
        let message = log(&path).unwrap_err();
        assert!(
            message.contains("bag.db3: not a sound bag in SQLite: ") && message.contains(part),
            "{message}"
        );
    };
    refused("DROP TABLE messages", "it has no tables `topics` and `messages`");
    refused("ALTER TABLE messages RENAME COLUMN data TO content", "no such column: data");
    refused("UPDATE messages SET topic_id = 9 WHERE id = 2", "a message of unknown topic 9");
    refused("UPDATE messages SET data = 'text' WHERE id = 2", "a message isn't bytes");
    refused("UPDATE topics SET name = hex(zeroblob(501))", "has 1002 bytes; at most 1000");
    // Rows without an end.
    refused(
        "ALTER TABLE messages RENAME TO rows;
         CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)
             SELECT i AS id, 1 AS topic_id, 0 AS timestamp, zeroblob(1000000) AS data FROM n",
        "it has no tables",
    );
    refused(
        "DROP TABLE messages; CREATE VIRTUAL TABLE messages USING fts5(topic_id, timestamp, data)",
        "it has no tables",
    );
    // Work that the rows don't show.
    refused(
        "CREATE TABLE other(id, name, type, serialization_format AS (hex(zeroblob(8000000))));
         INSERT INTO other SELECT id, name, type FROM topics; DROP TABLE topics;
         ALTER TABLE other RENAME TO topics",
        "at most 1000",
    );
    // A recording that was killed.
    let folder = written(&[("bag.db3", plain().db3()), ("bag.db3-wal", vec![1])]);
    assert!(
        log(&folder.path().join("bag.db3")).unwrap_err().contains("still in the file that ends in `-wal`")
    );
    let whole = plain().db3();
    let folder = written(&[("cut.db3", whole[..whole.len() - 4096].to_vec())]);
    assert!(log(&folder.path().join("cut.db3")).unwrap_err().contains("not a sound bag in SQLite"));
}

/// A file that is written into a bag's folder would be taken for a part of it.
#[test]
fn no_log_is_written_into_a_bag() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("drive_0.mcap"), plain().bytes()).unwrap();
    let may = |name: &str, read: Option<&Path>| LogFormat::to_write(&at(name), read).is_ok();
    // Files of their own beside each other.
    assert!(may("worse.mcap", None) && may("worse.mcap", Some(&at("drive_0.mcap"))));
    assert!(!may("drive_1.mcap", Some(folder.path())));
    assert!(may("drive_1.log", Some(folder.path())));
    fs::write(at("metadata.yaml"), "rosbag2_bagfile_information: {}\n").unwrap();
    assert!(!may("worse.mcap", None) && may("worse.log.gz", None));
}

#[cfg(unix)]
#[test]
fn a_pipe_in_a_folder_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let made = std::process::Command::new("mkfifo").arg(folder.path().join("drive.mcap")).status();
    assert!(made.unwrap().success());
    let refused = read_bag(folder.path(), &BagOptions::default()).unwrap_err().to_string();
    assert!(refused.contains("`drive.mcap` is a pipe or a device"), "{refused}");
}
