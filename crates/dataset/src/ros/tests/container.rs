//! The container of a bag: chunks, check sums, damage, and what a file may cost.

use super::*;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    /// A changed byte in the data is always found out, by a check sum or before; elsewhere it is no obstacle.
    #[test]
    fn a_damaged_file_is_refused(place in any::<prop::sample::Index>(), change in 1..=255_u8) {
        let mut bytes = plain().bytes();
        let data_end = bytes.len() - summary_length(&bytes);
        let place = place.index(bytes.len());
        bytes[place] ^= change;
        let result = read_bytes(&bytes, &BagOptions::default());
        prop_assert!(place >= data_end || result.is_err(), "byte {place} of {data_end}");
    }

    /// Without check sums damage may go unnoticed, but nothing panics.
    #[test]
    fn no_bytes_make_the_reader_panic(
        places in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        packing in prop::sample::select(vec!["", "lz4", "zstd"]),
        inside in any::<bool>(),
    ) {
        let mut records = records_of(&plain().bytes());
        if inside {
            for (place, byte) in &places {
                let place = place.index(records.len());
                records[place] = *byte;
            }
        }
        let mut bytes = packed(&records, packing, false);
        if !inside {
            for (place, byte) in &places {
                let place = place.index(bytes.len());
                bytes[place] = *byte;
            }
        }
        let _ = read_bytes(&bytes, &BagOptions::default());
    }

    #[test]
    fn a_cut_file_is_refused(share in 0.0..1.0f64) {
        let bytes = plain().bytes();
        let cut = read_bytes(&bytes[..(share * bytes.len() as f64) as usize], &BagOptions::default());
        // Of the first bytes nobody can tell what they begin.
        let refused = matches!(cut, Err(DatasetError::Mcap { .. } | DatasetError::NotALog { .. }));
        prop_assert!(refused, "{cut:?}");
    }
}

/// From the end of the data section to the end of the file.
fn summary_length(bytes: &[u8]) -> usize {
    let footer = mcap::read::footer(bytes).unwrap();
    // The record that ends the data: kind, length, check sum; only its check sum matters to a reader.
    bytes.len() - footer.summary_start as usize + 1 + 8 + 4
}

#[test]
fn compressed_chunks_are_unpacked() {
    let bytes = plain().bytes();
    let (plain, _) = read_bytes(&bytes, &BagOptions::default()).unwrap();
    let records = records_of(&bytes);
    for compression in ["", "lz4", "zstd"] {
        for sums in [false, true] {
            let (drive, _) =
                read_bytes(&packed(&records, compression, sums), &BagOptions::default()).unwrap();
            assert_eq!(drive, plain, "{compression}");
        }
    }
    for compression in ["", "lz4", "zstd"] {
        // The chunk's unpacked size and check sum, behind the magic, the header, a record's start and two times.
        let size = MAGIC.len() + 9 + 8 + 9 + 16;
        for (place, part) in
            [(size, "unpacks to another number of bytes"), (size + 8, "check sum of a chunk is wrong")]
        {
            for change in [1, 2, 3] {
                let mut bytes = packed(&records, compression, true);
                bytes[place] ^= change;
                let message = read_bytes(&bytes, &BagOptions::default()).unwrap_err().to_string();
                assert!(message.contains(part), "{compression}: {message}");
            }
        }
    }
    let odd = read_bytes(&packed(&records, "xz", true), &BagOptions::default()).unwrap_err().to_string();
    assert!(odd.contains("chunks compressed with `xz`; allowed: lz4, zstd, none"), "{odd}");
}

#[test]
fn a_bag_unpacks_to_so_much_and_no_more() {
    let plain = plain();
    let mut records = records_of(&plain.bytes());
    // An attachment of zeros.
    records.push(op::ATTACHMENT);
    records.extend(1_000_000_u64.to_le_bytes());
    records.extend(vec![0; 1_000_000]);
    let size = records.len() as u64;
    for packing in ["lz4", "zstd"] {
        let bytes = packed(&records, packing, true);
        assert!(bytes.len() as u64 * UNPACKING_FACTOR < size);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("test.mcap");
        fs::write(&path, &bytes).unwrap();
        let limits = |log_unpacked_bytes| Limits { log_unpacked_bytes, ..Limits::DEFAULT };
        assert!(read(&path, &BagOptions::default(), &limits(size)).is_ok());
        let message = refused(&bytes, &limits(size - 1));
        let part = format!(
            "more than {} bytes that a compressed log unpacks to are not allowed (`--limit",
            size - 1
        );
        assert!(message.contains(&part), "{message}");
    }
    // Several chunks count together, and bytes that aren't compressed don't count.
    let chunk = |packing: &str| {
        let file = packed(&records, packing, true);
        let end = file.len() - (9 + 4) - (9 + 20) - MAGIC.len();
        (file[..end].to_vec(), file[end..].to_vec())
    };
    let limits = Limits { log_unpacked_bytes: size, ..Limits::DEFAULT };
    let ((mut twice, end), start) = (chunk("lz4"), MAGIC.len() + 9 + 8);
    twice.extend_from_within(start..);
    let message = refused(&[&twice[..], &end].concat(), &limits);
    assert!(message.contains("bytes that a compressed log unpacks to"), "{message}");
    let (plain, end) = chunk("");
    let message = refused(&[&plain[..], &plain[start..], &end].concat(), &limits);
    assert!(message.contains("/scan: 2 messages have stamps that are seconds off"), "{message}");
}

#[test]
fn a_bag_costs_so_much_and_no_more() {
    let bytes = plain().bytes();
    // Three scans of five beams, each counting for a hundred readings more; five messages.
    for (limits, message) in [
        (
            Limits { log_readings: 314, ..Limits::DEFAULT },
            "/scan: message 3: more than 314 range readings of a log (100 more for each scan) are not allowed \
             (`--limit log_readings=628` allows twice as many)",
        ),
        (
            Limits { log_messages: 4, ..Limits::DEFAULT },
            "/scan: message 3: more than 4 lines of a text log or messages read from a bag are not allowed \
             (`--limit log_messages=8` allows twice as many)",
        ),
    ] {
        let found = refused(&bytes, &limits);
        assert!(found.ends_with(message), "{found}");
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("test.mcap");
    fs::write(&path, &bytes).unwrap();
    let limits = Limits { log_readings: 315, log_messages: 5, ..Limits::DEFAULT };
    assert!(read(&path, &BagOptions::default(), &limits).is_ok());
}

#[test]
fn names_channels_and_frames_are_limited() {
    let pose = transform("base_link", "x", [0.0; 3], [0.0, 0.0, 0.0, 1.0]);
    let mut frames = pose.clone();
    frames.transforms = (0..10_001)
        .map(|i| TransformStamped { child_frame_id: format!("frame{i}"), ..pose.transforms[0].clone() })
        .collect();
    let mut long = pose.clone();
    long.transforms[0].header.frame_id = "\u{1b}".repeat(1001);
    let channels = |count: usize| {
        (0..count).fold(plain(), |bag, i| bag.raw(&format!("/\u{1b}{i}"), "std_msgs/msg/String", "cdr", &[]))
    };
    for (bag, part) in [
        (plain().raw(&"\u{1b}".repeat(1001), "", "cdr", &[]), "..` has 1001 bytes; allowed: at most 1000"),
        (plain().raw("/a", &"\u{1b}".repeat(1001), "cdr", &[]), "has 1001 bytes; allowed: at most 1000"),
        (plain().add("/tf_static", &long), "/tf_static: message 1: frame `\\u{1b}"),
        (plain().add("/tf_static", &frames), "more than 10000 pairs of frames"),
        (channels(10_000), "more than 10000 channels"),
        (channels(30).without("/scan"), "/\\u{1b}1 (std_msgs/msg/String, 1 messages)"),
        (channels(30).without("/scan"), ", 11 more"),
    ] {
        let message = refused(&bag.bytes(), &Limits::DEFAULT);
        assert!(message.contains(part), "{message}");
    }
}

/// The mcap library reserves memory for a name by its claimed length before it looks whether it is there.
#[test]
fn a_name_longer_than_its_record_is_refused() {
    let bytes = plain().raw("/a", "some_msgs/msg/Name", "cdr", &[]).bytes();
    let name = b"some_msgs/msg/Name";
    let places = (4..bytes.len()).filter(|at| bytes[*at..].starts_with(name));
    // Each schema stands before its messages and again in the summary, which isn't read.
    let at = places.min().unwrap();
    for length in [19_u32, 1 << 31, u32::MAX] {
        let mut bytes = bytes.clone();
        bytes[at - 4..at].copy_from_slice(&length.to_le_bytes());
        let message = refused(&bytes, &Limits::DEFAULT);
        assert!(
            (length == 19) != message.contains("a schema or a channel is longer than its record"),
            "{length}: {message}"
        );
    }
}

#[test]
fn a_record_that_is_skipped_may_be_of_any_length() {
    let large = vec![0; (super::bag::LARGEST_RECORD + 1) as usize];
    let (expected, _) = plain().read(&BagOptions::default()).unwrap();
    let image = plain().raw("/image", "sensor_msgs/msg/Image", "cdr", &large);
    assert_eq!(image.read(&BagOptions::default()).unwrap().0, expected);
    let scan = plain().raw("/scan", LaserScan::TYPE, "cdr", &large);
    let message = refused(&scan.bytes(), &Limits::DEFAULT);
    assert!(
        message.ends_with("/scan: message 4: a record has 16777217 bytes; allowed: at most 16777216"),
        "{message}"
    );
}

#[test]
fn data_without_an_end_are_refused() {
    let bytes = packed(&records_of(&plain().bytes()), "", true);
    let end = bytes.len() - (9 + 4) - (9 + 20) - MAGIC.len();
    let message = refused(&[&bytes[..end], &bytes[end + 9 + 4..]].concat(), &Limits::DEFAULT);
    assert!(message.contains("not a complete MCAP file: the data have no end"), "{message}");
}
