//! Logs and maps with mutations that keep them plausible: numbers replaced by extremes, fields and records left out or repeated,
//! wrong lengths under correct check sums. For every mutation a reader returns a sound drive or an error.
//!
//! `LOCSIM_MUTATIONS` sets the number of files of each format; file i is the same in every run.

use std::fs;
use std::path::Path;
use std::sync::LazyLock;

use locsim_core::limits::{COORDINATE, Limits, READINGS_PER_SCAN};
use locsim_core::{Drive, DriveStep, Laser, Pose2, Scan};

use crate::log::read;
use crate::ros::tests::{packed, plain, records_of};
use crate::{BeesoftMap, DatasetError, LogOptions, encode_log, read_beesoft_map};

/// Small limits, so that mutations reach them.
const LIMITS: Limits =
    Limits { log_readings: 4000, log_messages: 200, log_unpacked_bytes: 1 << 16, ..Limits::DEFAULT };

/// Numbers for mutations, by the method of splitmix64.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    /// Below `bound`, and 0 where nothing is.
    fn below(&mut self, bound: usize) -> usize {
        (self.next() % bound.max(1) as u64) as usize
    }

    fn of<'a, T>(&mut self, choices: &'a [T]) -> &'a T {
        &choices[self.below(choices.len())]
    }
}

fn drive(numbers: &mut Numbers) -> Drive {
    let beams = 1 + numbers.below(6);
    let bearings = (0..beams).map(|i| i as f32 * 0.25 - 0.5).collect();
    let mount = Pose2::new(0.25, -0.125, 0.5);
    let times = (0..beams).map(|i| i as f32 * 0.001).collect();
    let laser = Laser::new(bearings, times, 0.125, 8.0, mount).unwrap();
    let known = numbers.below(2) == 0;
    let steps = (0..3 + numbers.below(20)).map(|i| {
        let t = i as f64 * 0.5;
        let pose = Pose2::new(0.5 * t, -0.25 * t, 0.125 * t);
        DriveStep {
            stamp_secs: 1e6 + t,
            odometry: pose,
            reference: known.then(|| Pose2::new(1.0, 2.0, 0.5).compose(&pose)),
            scan: Scan {
                ranges: (0..beams).map(|k| 1.0 + (k as f32 * 0.7 + t as f32 * 0.3) % 7.0).collect(),
            },
        }
    });
    Drive { laser, steps: steps.collect() }
}

fn bytes(name: &str, drive: &Drive) -> Vec<u8> {
    let mut bytes = Vec::new();
    encode_log(Path::new(name), drive, &mut bytes).unwrap();
    bytes
}

/// Fields of text logs that real logs never or rarely have.
const FIELDS: [&str; 22] = [
    "0",
    "-0",
    "1",
    "-1",
    "0.5",
    "1e9",
    "-1e9",
    "1.0001e9",
    "1e300",
    "-1e300",
    "1e-300",
    "1e39",
    "inf",
    "nan",
    "65536",
    "4294967296",
    "18446744073709551615",
    "-9223372036854775808",
    "",
    "\u{1b}[2J",
    "ROBOTLASER1",
    "\u{fffd}",
];

/// Words of messages or records that real bags never or rarely have.
const WORDS: [u64; 16] = [
    0,
    1,
    u64::MAX,
    u64::MAX / 2,
    1 << 32,
    (1 << 32) - 1,
    0x7f80_0000,           // infinity in f32
    0xff80_0000,           // minus infinity
    0x7fc0_0000,           // NaN
    0x7f7f_ffff,           // the largest f32
    0x7ff0_0000_0000_0000, // infinity in f64
    0x7ff8_0000_0000_0000, // NaN
    0x7fef_ffff_ffff_ffff, // the largest f64
    0x4197_d784_0000_0000, // 1e8
    0x4202_a05f_2000_0000, // 1e10
    0x8000_0000_8000_0000,
];

fn carmen(numbers: &mut Numbers) -> Vec<u8> {
    let mut text = String::from_utf8(bytes("seed.log", &drive(numbers))).unwrap();
    if numbers.below(3) == 0 {
        // As FLASER lines: without description, remissions and speeds.
        let lines = text.lines().map(|line| match line.strip_prefix("ROBOTLASER1 ") {
            Some(rest) => {
                let fields: Vec<_> = rest.split(' ').collect();
                let beams: usize = fields[7].parse().unwrap();
                let tail = &fields[fields.len() - 14..];
                let kept = [&fields[7..8 + beams], &tail[..6], &tail[11..]].concat();
                format!("FLASER {}\n", kept.join(" "))
            }
            None => format!("{line}\n"),
        });
        text = lines.collect();
    }
    if numbers.below(4) == 0 {
        text = centimetre_lines(numbers);
    }
    changed_lines(&text, numbers)
}

/// A log of L and O lines.
fn centimetre_lines(numbers: &mut Numbers) -> String {
    let beams = 1 + numbers.below(6);
    let step = |i: usize| {
        let t = i as f64 * 0.5;
        let ranges: Vec<String> = (0..beams).map(|k| (60 + (7 * k + 3 * i) % 700).to_string()).collect();
        let ranges = ranges.join(" ");
        format!("O {i} {t} 0.{i} {t}\nL {i} {t} 0.{i} {} {t} 0.{i} {ranges} {t}\n", i + 25)
    };
    (0..3 + numbers.below(20)).map(step).collect()
}

/// A map of `BeeSoft`.
fn beesoft_map(numbers: &mut Numbers) -> Vec<u8> {
    let [width, height] = [1 + numbers.below(6), 1 + numbers.below(6)];
    let mut text = format!(
        "robot_specifications->global_mapsize_x {}\nrobot_specifications->resolution 10\n\nglobal_map[0]: {height} {width}\n",
        10 * width
    );
    for _ in 0..width {
        let cells: Vec<&str> =
            (0..height).map(|_| *numbers.of(&["-1.0", "0.000", "0.25", "1.000"])).collect();
        text += &(cells.join(" ") + "\n");
    }
    changed_lines(&text, numbers)
}

/// A text with some of its lines and fields changed.
fn changed_lines(text: &str, numbers: &mut Numbers) -> Vec<u8> {
    let mut lines: Vec<Vec<String>> =
        text.lines().map(|line| line.split(' ').map(str::to_owned).collect()).collect();
    for _ in 0..=numbers.below(4) {
        let at = numbers.below(lines.len());
        let change = numbers.below(8);
        let Some(line) = lines.get_mut(at) else { break };
        let field = numbers.below(line.len());
        match change {
            0..=2 => line[field] = (*numbers.of(&FIELDS)).to_owned(),
            3 if line.len() > 1 => drop(line.remove(field)),
            4 => {
                let copy = vec![line[field].clone(); 1 + numbers.below(2000)];
                line.splice(field..field, copy);
            }
            5 => drop(lines.remove(at)),
            6 => {
                let copy = vec![line.clone(); 1 + numbers.below(300)];
                lines.splice(at..at, copy);
            }
            _ => {
                let with = numbers.below(lines.len());
                lines.swap(at, with);
            }
        }
    }
    let mut text = lines.iter().map(|line| line.join(" ") + "\n").collect::<String>().into_bytes();
    if numbers.below(8) == 0 {
        change_byte(&mut text, numbers);
    }
    text
}

fn change_byte(bytes: &mut Vec<u8>, numbers: &mut Numbers) {
    let at = numbers.below(bytes.len());
    match numbers.below(3) {
        0 => bytes.truncate(at),
        1 => bytes.insert(at, numbers.next() as u8),
        _ => bytes[at] = numbers.next() as u8,
    }
}

/// Writes an extreme number over some of the bytes.
fn change_word(bytes: &mut [u8], numbers: &mut Numbers) {
    let word = numbers.of(&WORDS).to_le_bytes();
    let size = *numbers.of(&[2, 4, 8]);
    // Most numbers begin at a multiple of four; a message's content begins behind 22 bytes, a record's behind 9.
    let at = (numbers.below(bytes.len() / 4 + 1) * 4 + numbers.of(&[0, 1, 2, 3])).min(bytes.len());
    for (byte, extreme) in bytes[at..].iter_mut().zip(&word[..size]) {
        *byte = *extreme;
    }
}

fn mcap(numbers: &mut Numbers) -> Vec<u8> {
    let content = records_of(&bytes("seed.mcap", &drive(numbers)));
    let mut records = Vec::new();
    let mut rest = content.as_slice();
    while let Some((start, behind)) = rest.split_first_chunk::<9>() {
        let length = u64::from_le_bytes(start[1..].try_into().unwrap()) as usize;
        records.push((start[0], behind[..length].to_vec(), length as u64));
        rest = &behind[length..];
    }
    for _ in 0..=numbers.below(4) {
        let at = numbers.below(records.len());
        let change = numbers.below(8);
        let Some((opcode, body, length)) = records.get_mut(at) else { break };
        match change {
            0..=2 => change_word(body, numbers),
            3 => {
                change_byte(body, numbers);
                *length = body.len() as u64;
            }
            4 => *length = length.wrapping_add(*numbers.of(&WORDS)),
            5 => *opcode = numbers.below(17) as u8,
            6 => {
                let copy = vec![records[at].clone(); 1 + numbers.below(300)];
                records.splice(at..at, copy);
            }
            _ => drop(records.remove(at)),
        }
    }
    let mut content = Vec::new();
    for (opcode, body, length) in records {
        content.push(opcode);
        content.extend(length.to_le_bytes());
        content.extend(body);
    }
    let sums = numbers.below(2) == 0;
    let packing = *numbers.of(&["", "lz4", "zstd"]);
    let mut bytes = packed(&content, packing, sums);
    if numbers.below(4) == 0 {
        change_word(&mut bytes, numbers);
    }
    if numbers.below(4) == 0 {
        change_byte(&mut bytes, numbers);
    }
    bytes
}

fn is_short(error: &DatasetError, of: &str) {
    let message = error.to_string();
    assert!(message.len() < 2000 && !message.contains(char::is_control), "{of}: {message:?}");
}

/// The promise of every reader for every log.
fn check(result: Result<Drive, DatasetError>, log: &str) {
    let drive = match result {
        Ok(drive) => drive,
        Err(error) => {
            is_short(&error, log);
            return;
        }
    };
    let laser = &drive.laser;
    let beams = laser.beam_count();
    assert!(drive.steps.len() as u64 * (beams as u64 + READINGS_PER_SCAN) <= LIMITS.log_readings, "{log}");
    let sound = |value: &f32| f64::from(value.abs()) <= COORDINATE;
    assert!(laser.bearings().iter().all(sound) && laser.beam_times_secs().iter().all(sound), "{log}");
    assert!(sound(&laser.max_range()) && laser.base_from_laser().is_finite(), "{log}");
    let mut latest = f64::NEG_INFINITY;
    for step in &drive.steps {
        assert!(step.stamp_secs.is_finite() && step.stamp_secs >= latest, "{log}");
        latest = step.stamp_secs;
        assert!(step.odometry.is_finite() && step.reference.is_none_or(|pose| pose.is_finite()), "{log}");
        assert_eq!(step.scan.ranges.len(), beams, "{log}");
        assert!(step.scan.ranges.iter().all(|range| range.is_nan() || *range <= laser.max_range()), "{log}");
    }
}

fn number_of_files() -> u64 {
    std::env::var("LOCSIM_MUTATIONS").map_or(3000, |count| count.parse().unwrap())
}

fn all_end_well(name: &str, log: fn(&mut Numbers) -> Vec<u8>) {
    let count = number_of_files();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    let mut read_well = 0;
    for i in 0..count {
        fs::write(&path, log(&mut Numbers(i))).unwrap();
        let result = read(&path, &LogOptions::default(), &LIMITS).map(|(drive, _)| drive);
        read_well += u64::from(result.is_ok());
        check(result, &format!("{name} {i}"));
    }
    println!("{name}: {read_well} of {count} are read");
    // Mutations that always give an error test little.
    assert!(10 * read_well > count && 10 * read_well < 9 * count, "{read_well} of {count}");
}

#[test]
fn changed_maps_end_well() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("changed.dat");
    let (count, mut read_well) = (number_of_files(), 0);
    for i in 0..count {
        fs::write(&path, beesoft_map(&mut Numbers(i))).unwrap();
        match read_beesoft_map(&path) {
            Ok(BeesoftMap { width, height, resolution_m, free }) => {
                read_well += 1;
                assert!(width > 0 && height > 0 && free.len() == width * height, "map {i}");
                assert!((1e-4..=1e3).contains(&resolution_m), "map {i}: {resolution_m}");
                let sound = |free: &Option<f32>| free.is_none_or(|free| (0.0..=1.0).contains(&free));
                assert!(free.iter().all(sound), "map {i}");
            }
            Err(error) => is_short(&error, &format!("map {i}")),
        }
    }
    assert!(10 * read_well > count && 10 * read_well < 9 * count, "{read_well} of {count}");
}

#[test]
fn changed_text_logs_end_well() {
    all_end_well("changed.log", carmen);
}

/// A bag in `SQLite`, whose pages hold lengths and numbers of other pages.
fn db3(numbers: &mut Numbers) -> Vec<u8> {
    static WHOLE: LazyLock<Vec<u8>> = LazyLock::new(|| plain().db3());
    let mut bytes = WHOLE.clone();
    for _ in 0..=numbers.below(4) {
        if numbers.below(3) == 0 {
            change_byte(&mut bytes, numbers);
        } else {
            change_word(&mut bytes, numbers);
        }
    }
    bytes
}

#[test]
fn changed_databases_end_well() {
    all_end_well("changed.db3", db3);
}

#[test]
fn changed_bags_end_well() {
    all_end_well("changed.mcap", mcap);
}
