//! What once brought a reader down, or cost more than it may, and must be refused or accepted as is said here.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

use ciborium::Value;
use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};
use tempfile::TempDir;

/// What an input may cost: bytes of memory and seconds of processor time.
type Most = (u64, f64);

/// Every input.
const INPUT: Most = (1_000_000_000, 10.0);
/// A YAML file.
const YAML: Most = (100_000_000, 1.0);

/// What becomes of an input.
enum Expect {
    Accepted,
    /// With a message that holds these words.
    Refused(&'static [&'static str]),
}

use Expect::{Accepted, Refused};

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// A seed of the corpus, or one that is too large for it and made anew.
fn seed(name: &str) -> Vec<u8> {
    static MADE: LazyLock<Vec<(&str, String, Vec<u8>)>> = LazyLock::new(locsim_fuzz::seeds);
    fs::read(folder("corpus").join(name)).unwrap_or_else(|_| {
        let made = MADE.iter().find(|(target, file, _)| format!("{target}/{file}") == name);
        made.unwrap_or_else(|| panic!("no seed {name}")).2.clone()
    })
}

/// Files that are run on their targets.
struct Cases {
    scratch: TempDir,
    failures: Vec<String>,
}

impl Cases {
    fn new() -> Self {
        Self { scratch: tempfile::tempdir().unwrap(), failures: Vec::new() }
    }

    fn check(&mut self, target: &str, name: &str, data: &[u8], most: Most, expect: &Expect) {
        let path = self.scratch.path().join(name);
        fs::write(&path, data).unwrap();
        self.check_file(target, &path, most, expect);
    }

    /// Runs a file on its target and remembers what isn't as expected.
    fn check_file(&mut self, target: &str, path: &Path, most: Most, expect: &Expect) {
        let call = Command::new(env!("CARGO_BIN_EXE_locsim-fuzz"))
            .args(["repeat", target])
            .arg(path)
            .args(["--most-bytes", &most.0.to_string(), "--most-seconds", &most.1.to_string()])
            .env("TMPDIR", self.scratch.path())
            .env_remove("LOCSIM_DATA")
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&call.stdout);
        let right = call.status.success()
            && match expect {
                Accepted => said.contains("\naccepted\n"),
                Refused(words) => {
                    said.contains("\nrefused: ") && words.iter().all(|word| said.contains(word))
                }
            };
        if !right {
            let wanted = match expect {
                Accepted => "accepted".to_owned(),
                Refused(words) => format!("refused with {words:?}"),
            };
            let said: String = said.chars().take(600).collect();
            let error: String = String::from_utf8_lossy(&call.stderr).chars().take(600).collect();
            let name = path.file_name().unwrap().display();
            self.failures.push(format!("{target} {name}: not {wanted}, but {}\n{said}{error}", call.status));
        }
    }
}

impl Drop for Cases {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            assert!(
                self.failures.is_empty(),
                "{} failures\n{}",
                self.failures.len(),
                self.failures.join("\n\n")
            );
        }
    }
}

/// A text with one part replaced, which must be there.
fn edited(text: &[u8], from: &str, to: &str) -> Vec<u8> {
    let text = std::str::from_utf8(text).unwrap();
    assert!(text.contains(from), "{from:?} is not in the text");
    text.replacen(from, to, 1).into_bytes()
}

/// Rotten seeds reach nothing.
#[test]
fn every_seed_is_accepted() {
    let mut cases = Cases::new();
    for target in fs::read_dir(folder("corpus")).unwrap().map(Result::unwrap) {
        for seed in fs::read_dir(target.path()).unwrap().map(Result::unwrap) {
            let target = target.file_name().into_string().unwrap();
            cases.check_file(&target, &seed.path(), INPUT, &Accepted);
        }
    }
}

/// `regressions/expected.txt` has a line for each file: `TARGET/NAME: accepted` or `TARGET/NAME: refused: WORDS`.
#[test]
fn what_failed_once_is_as_expected() {
    let expected = fs::read_to_string(folder("regressions/expected.txt")).unwrap();
    let expected: BTreeMap<&str, &str> = expected
        .lines()
        .filter(|line| !line.starts_with('#'))
        .filter_map(|line| line.split_once(": "))
        .collect();
    let mut cases = Cases::new();
    let mut found = 0;
    for target in fs::read_dir(folder("regressions")).unwrap().map(Result::unwrap) {
        let Ok(files) = fs::read_dir(target.path()) else { continue };
        for file in files.map(Result::unwrap) {
            found += 1;
            let target = target.file_name().into_string().unwrap();
            let name = format!("{target}/{}", file.file_name().to_str().unwrap());
            let expect = match expected.get(name.as_str()).map(|outcome| outcome.strip_prefix("refused: ")) {
                Some(Some(words)) => Refused(vec![words.to_owned().leak() as &str].leak()),
                Some(None) => Accepted,
                None => panic!("{name} isn't in expected.txt"),
            };
            cases.check_file(&target, &file.path(), INPUT, &expect);
        }
    }
    assert_eq!(found, expected.len(), "files of expected.txt");
}

#[test]
fn yaml_that_costs_the_machine_is_refused_at_once() {
    let mut cases = Cases::new();
    let kilobytes = |text: &str, kilobytes: usize| text.repeat(1000 * kilobytes / text.len());
    let scenario = String::from_utf8(seed("yaml/office.yaml")).unwrap();
    for size in [40, 80, 1000] {
        for (name, text) in [
            ("lists", kilobytes("[", size)),
            ("maps", kilobytes("{a: ", size)),
            ("block", kilobytes("- ", size)),
            ("keys", kilobytes("? ", size)),
            ("closed", kilobytes("[", size / 2) + &kilobytes("]", size / 2)),
        ] {
            let words: &'static [&'static str] = if name == "keys" { &["as a key"] } else { &["64"] };
            for target in ["yaml", "study", "vector_map"] {
                cases.check(target, &format!("{name}-{size}.yaml"), text.as_bytes(), YAML, &Refused(words));
            }
            let inside = format!("{scenario}expect: {text}\n");
            cases.check(
                "yaml",
                &format!("in-{name}-{size}.yaml"),
                inside.as_bytes(),
                YAML,
                // A block isn't read behind a key.
                &Refused(if text.starts_with(['-', '?']) { &["not readable as YAML"] } else { &["64"] }),
            );
        }
    }
    // A text of 100 kB that 100,000 aliases repeat.
    let text = format!("a: &a {}\nb: [{}]\n", "x".repeat(100_000), "*a, ".repeat(100_000));
    cases.check("yaml", "aliases.yaml", text.as_bytes(), YAML, &Refused(&["yaml_"]));
    let mut text = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n".to_owned();
    for i in 1..30 {
        let before = i - 1;
        text = format!("{text}a{i}: &a{i} [*a{before}, *a{before}, *a{before}, *a{before}, *a{before}]\n");
    }
    cases.check("yaml", "laughs.yaml", text.as_bytes(), YAML, &Refused(&["yaml_"]));
    cases.check(
        "yaml",
        "values.yaml",
        format!("a: [{}]", "1,".repeat(600_000)).as_bytes(),
        INPUT,
        &Refused(&["yaml_values"]),
    );
    let large = format!("{scenario}# {}\n", "x".repeat(9 << 20));
    cases.check("yaml", "large.yaml", large.as_bytes(), YAML, &Refused(&["yaml_bytes"]));
    // What people write is nested less.
    let nested = format!("{scenario}expect: {}", "{classic: ".repeat(3) + &"}".repeat(3));
    cases.check("yaml", "nested.yaml", nested.as_bytes(), YAML, &Refused(&["classic"]));
}

#[test]
fn numbers_and_bytes_that_yaml_has_no_place_for_are_told() {
    let mut cases = Cases::new();
    let office = seed("yaml/office.yaml");
    let mut mark = "\u{feff}".as_bytes().to_vec();
    mark.extend(&office);
    // The mark is no part of the first key, whatever else is said of it.
    cases.check("yaml", "mark.yaml", &mark, YAML, &Accepted);
    for number in ["18446744073709551616", "-1", "1.5", "99999999999999999999999999999999999999", ".nan"] {
        let text = String::from_utf8(office.clone()).unwrap();
        let line = text.lines().find(|line| line.starts_with("seed:")).unwrap();
        let text = text.replace(line, &format!("seed: {number}"));
        cases.check(
            "yaml",
            &format!("seed{number}.yaml"),
            text.as_bytes(),
            YAML,
            &Refused(&["seed", "whole number"]),
        );
    }
    for bytes in [&b"\xff\xfe"[..], b"a: \x00", b"a: \xc3\x28"] {
        cases.check("yaml", "bytes.yaml", bytes, YAML, &Refused(&["input.yaml"]));
    }
}

/// Black pixels of one bit each, compressed.
fn png(width: u32, height: u32) -> Vec<u8> {
    let mut image = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut chunk = |kind: &[u8], content: &[u8]| {
        image.extend((content.len() as u32).to_be_bytes());
        let at = image.len();
        image.extend([kind, content].concat());
        image.extend(crc32fast::hash(&image[at..]).to_be_bytes());
    };
    let header = [&width.to_be_bytes()[..], &height.to_be_bytes(), &[1, 0, 0, 0, 0]].concat();
    chunk(b"IHDR", &header);
    let mut pixels = ZlibEncoder::new(Vec::new(), Compression::best());
    let row = vec![0; 1 + width.div_ceil(8) as usize];
    for _ in 0..height {
        pixels.write_all(&row).unwrap();
    }
    chunk(b"IDAT", &pixels.finish().unwrap());
    chunk(b"IEND", b"");
    image
}

#[test]
fn an_image_is_refused_by_its_header() {
    let mut cases = Cases::new();
    let large = png(20_000, 20_000);
    assert!(large.len() < 100_000, "{}", large.len());
    // Refused without unpacking it.
    cases.check("map_image", "large.png", &large, (100_000_000, 1.0), &Refused(&["map_pixels"]));
    for size in ["20000 20000", "4294967295 4294967295", "99999999999999999999 1"] {
        cases.check(
            "map_image",
            "lie.pgm",
            format!("P5\n{size}\n255\n").as_bytes(),
            YAML,
            &Refused(&["image"]),
        );
    }
    cases.check("map_image", "small.png", &png(200, 100), INPUT, &Accepted);
    // What the limits let through fits: its pixels are twice as wide as the cells of the distances to its walls.
    cases.check("map_image", "largest.png", &png(4900, 4900), INPUT, &Accepted);
    cases.check("map_image", "wide.png", &png(8000, 8000), INPUT, &Refused(&["grid_cells"]));
}

/// So much more than the limit on what a small log may unpack to.
const UNPACKED: usize = 600 << 20;

/// What `part` repeated becomes in a gzip file.
fn gzip(part: &[u8], times: usize) -> Vec<u8> {
    let mut file = GzEncoder::new(Vec::new(), Compression::fast());
    for _ in 0..times {
        file.write_all(part).unwrap();
    }
    file.finish().unwrap()
}

#[test]
fn a_log_that_unpacks_to_too_much_is_refused() {
    const PART: usize = 1 << 20;
    let mut cases = Cases::new();
    let comments = "# nothing\n".repeat(PART / 10);
    for (name, part) in
        [("zeros", vec![0; PART]), ("blanks", vec![b' '; PART]), ("comments", comments.into_bytes())]
    {
        let bomb = gzip(&part, UNPACKED / PART);
        cases.check(
            "carmen",
            &format!("{name}.log.gz"),
            &bomb,
            (300_000_000, 10.0),
            &Refused(&["input.log"]),
        );
        cases.check("tum", &format!("{name}.tum.gz"), &bomb, (300_000_000, 10.0), &Refused(&["input.tum"]));
    }
    let count = b"FLASER 4294967295 1 1 1\n";
    cases.check("carmen", "count.log", count, INPUT, &Refused(&["input.log:1"]));
}

/// An MCAP record.
fn record(kind: u8, content: &[u8]) -> Vec<u8> {
    [&[kind][..], &(content.len() as u64).to_le_bytes(), content].concat()
}

/// An MCAP file with chunks that say that they unpack to `size` bytes.
fn bag(compression: &str, size: u64, chunk: &[u8], chunks: usize) -> Vec<u8> {
    let text = |text: &str| [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat();
    let content = [
        &[0; 16][..],
        &size.to_le_bytes(),
        &[0; 4],
        &text(compression),
        &(chunk.len() as u64).to_le_bytes(),
        chunk,
    ];
    let chunk = record(6, &content.concat());
    let header = record(1, &[text("ros2"), text("")].concat());
    let end = [record(15, &[0; 4]), record(2, &[0; 20])].concat();
    let magic = b"\x89MCAP0\r\n";
    [&magic[..], &header, &chunk.repeat(chunks), &end, magic].concat()
}

#[test]
fn a_bag_that_unpacks_to_too_much_is_refused() {
    let mut cases = Cases::new();
    // Records of a kind that nobody knows are skipped, so that only the unpacking costs.
    let part = record(200, &vec![0; (16 << 20) - 9]);
    let mut lz4 = lz4_flex::frame::FrameEncoder::new(Vec::new());
    lz4.write_all(&part).unwrap();
    let lz4 = lz4.finish().unwrap();
    let zstd =
        ruzstd::encoding::compress_to_vec(part.as_slice(), ruzstd::encoding::CompressionLevel::Fastest);
    for (compression, chunk) in [("lz4", &lz4), ("zstd", &zstd)] {
        let (size, chunks) = (part.len(), UNPACKED / part.len());
        let bomb = bag(compression, size as u64, chunk, chunks);
        cases.check(
            "mcap",
            &format!("{compression}.mcap"),
            &bomb,
            (300_000_000, 10.0),
            &Refused(&["input.mcap"]),
        );
        for size in [0, 1, 1 << 29, 1 << 40, u64::MAX] {
            let lie = bag(compression, size, chunk, 1);
            cases.check(
                "mcap",
                &format!("{compression}-{size}.mcap"),
                &lie,
                (100_000_000, 10.0),
                &Refused(&["input.mcap"]),
            );
        }
    }
}

/// A saved model with a part changed, which must be there; its hash is made right by the target.
fn model(kind: &str, path: &[&str], change: impl FnOnce(&mut Value)) -> Vec<u8> {
    const HEADER: usize = 12 + blake3::OUT_LEN;
    let bytes = seed(&format!("model/{kind}.model"));
    let mut tree: Value = ciborium::from_reader(&bytes[HEADER..]).unwrap();
    let mut node = &mut tree;
    for key in path {
        let map = node.as_map_mut().unwrap_or_else(|| panic!("{path:?} in {kind}"));
        let entry = map.iter_mut().find(|(name, _)| name.as_text() == Some(key));
        node = &mut entry.unwrap_or_else(|| panic!("{path:?} in {kind}")).1;
    }
    change(node);
    let mut changed = bytes[..HEADER].to_vec();
    ciborium::into_writer(&tree, &mut changed).unwrap();
    changed
}

#[test]
fn a_model_is_checked_field_by_field() {
    let mut cases = Cases::new();
    let number = |value: f64| move |node: &mut Value| *node = Value::Float(value);
    let whole = |value: u64| move |node: &mut Value| *node = Value::Integer(value.into());
    let every = |value: f64| move |node: &mut Value| node.as_array_mut().unwrap().fill(Value::Float(value));
    let longer = |times: usize| {
        move |node: &mut Value| {
            let list = node.as_array_mut().unwrap();
            *list = std::iter::repeat_n(list.clone(), times).flatten().collect();
        }
    };
    let mut refused = |name: &str, data: Vec<u8>| {
        cases.check("model", name, &data, INPUT, &Refused(&["input.model"]));
    };
    refused("no weights", model("beam_mixture", &["form", "Mixture", "weights"], every(0.0)));
    for value in [100.0, -1.0, f64::NAN, f64::INFINITY] {
        refused("weights", model("beam_mixture", &["form", "Mixture", "weights"], every(value)));
        refused("mass", model("np_reg", &["form", "Histogram", "mass"], every(value)));
        refused("z_hit", model("likelihood_field", &["form", "Field", "z_hit"], number(value)));
    }
    for value in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e30] {
        refused("max_range", model("np_reg", &["form", "Histogram", "max_range"], number(value)));
        refused("reach", model("p_reg", &["form", "Normal", "grid", "reach"], number(value)));
    }
    // A deviation of 1e30 m is a distribution, if not a sensible one.
    for value in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        refused(
            "quantum",
            model("np_reg_registered", &["form", "Histogram", "axis", "quantum"], number(value)),
        );
        refused("sigma", model("classic", &["form", "Mixture", "sigma_m"], number(value)));
        refused("field", model("likelihood_field", &["form", "Field", "sigma_m"], number(value)));
    }
    for value in [0, 1 << 32, 1 << 62, u64::MAX] {
        refused("ranges", model("p_reg", &["form", "Normal", "grid", "ranges"], whole(value)));
        refused("angles", model("np_reg", &["form", "Histogram", "grid", "incidences"], whole(value)));
        let last = move |node: &mut Value| {
            *node.as_array_mut().unwrap().last_mut().unwrap() = Value::Integer(value.into());
        };
        refused("ends", model("np_reg_registered", &["form", "Histogram", "axis", "ends"], last));
    }
    for times in [0, 2] {
        refused("masses", model("np_reg", &["form", "Histogram", "mass"], longer(times)));
        refused("cells", model("p_reg", &["form", "Normal", "cells"], longer(times)));
        refused("axis", model("np_reg", &["form", "Histogram", "axis", "ends"], longer(times)));
    }
    // What has no place in the file is no reason to take another model for it.
    for (kind, form) in [("classic", "np_reg"), ("p_reg", "beam_mixture"), ("np_reg", "np_reg_registered")] {
        refused("kind", model(kind, &["kind"], |node| *node = Value::Text(form.to_owned())));
    }
}

#[test]
fn numbers_beyond_reason_are_refused() {
    let mut cases = Cases::new();
    let work = seed("workload/workload.json");
    for (from, to) in [
        ("[1.0, 1.0, 0.2]", "[1e300, 1.0, 0.2]"),
        ("[1.0, 1.0, 0.2]", "[1.0, 1.0, -1e300]"),
        ("\"sensor_pose\": [0, 0, 0]", "\"sensor_pose\": [1e300, 0, 0]"),
        ("[0.05, 0.0, 0.0]", "[1e300, 0.0, 0.0]"),
        ("\"max_range_m\": 4.5", "\"max_range_m\": 1e300"),
        ("\"sigma_xy\": 0.1", "\"sigma_xy\": 1e300"),
        ("[0.05, 0.02, 0.05, 0.01]", "[1e300, 0.02, 0.05, 0.01]"),
        ("\"sigma_hit\": 0.1", "\"sigma_hit\": 1e300"),
        ("\"n_particles\": 50", "\"n_particles\": 1000000000000"),
    ] {
        let data = edited(&work, from, to);
        cases.check("workload", "pose", &data, INPUT, &Refused(&["workload.json"]));
    }
    let scenario = seed("yaml/everything.yaml");
    for (from, to) in [
        ("odometry_noise: {alpha: [0.05,", "odometry_noise: {alpha: [1e300,"),
        ("motion: {model: odometry, alpha: [0.1,", "motion: {model: odometry, alpha: [1e300,"),
        ("rate_hz: 5", "rate_hz: 1e300"),
        ("max_range_m: 4.5", "max_range_m: 1e300"),
        ("points_m: [[1, 2], [19, 2]", "points_m: [[1, 2], [1e300, 2]"),
    ] {
        cases.check("yaml", "number.yaml", &edited(&scenario, from, to), YAML, &Refused(&["is not allowed"]));
    }
    for (from, to) in [("[20, 0]", "[1e300, 0]"), ("[20, 4]", "[20, .inf]"), ("[5, 1]", "[-1e300, 1]")] {
        let data = edited(&seed("vector_map/named.yaml"), from, to);
        cases.check("vector_map", "far.yaml", &data, INPUT, &Refused(&["input.yaml"]));
    }
}
