//! docs/LIMITS.md says what holds.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use locsim_core::limits::{
    COORDINATE, LEAST_RANGE_M, Limits, MOST_SCANS, QUOTED_CHARACTERS, RANGE_M, READINGS_PER_SCAN, STAMP_SECS,
    THREADS_PER_CORE, UNPACKING_FACTOR, YAML_DEPTH,
};
use locsim_world::map::{FARTHEST_M, FINEST_M};

/// The number as the document writes it, with a blank between thousands.
fn spaced(number: u64) -> String {
    let digits = number.to_string();
    let groups: Vec<&str> =
        digits.as_bytes().rchunks(3).rev().map(|group| std::str::from_utf8(group).unwrap()).collect();
    groups.join(" ")
}

#[test]
fn the_document_names_every_limit_with_its_default() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/LIMITS.md");
    let text = fs::read_to_string(path).unwrap();
    let mut table = "| limit | default | what is counted |\n| --- | ---: | --- |\n".to_owned();
    for limit in Limits::TABLE {
        writeln!(table, "| `{}` | {} | {} |", limit.name, spaced(limit.default), limit.what).unwrap();
    }
    assert!(text.contains(&format!("{table}\n")), "docs/LIMITS.md needs this table:\n{table}");
    for (name, value) in [
        ("YAML_DEPTH", YAML_DEPTH.to_string()),
        ("UNPACKING_FACTOR", UNPACKING_FACTOR.to_string()),
        ("READINGS_PER_SCAN", READINGS_PER_SCAN.to_string()),
        ("COORDINATE", format!("{COORDINATE:e}")),
        ("RANGE_M", format!("{RANGE_M:e}")),
        ("STAMP_SECS", format!("{STAMP_SECS:e}")),
        ("LEAST_RANGE_M", format!("{LEAST_RANGE_M:e}")),
        ("MOST_SCANS", format!("{:e}", f64::from(MOST_SCANS))),
        ("FARTHEST_M", format!("{FARTHEST_M:e}")),
        ("FINEST_M", format!("{FINEST_M:e}")),
        ("THREADS_PER_CORE", THREADS_PER_CORE.to_string()),
        ("QUOTED_CHARACTERS", QUOTED_CHARACTERS.to_string()),
    ] {
        let row = format!("| `{name}` | {value} |");
        assert!(text.contains(&row), "docs/LIMITS.md needs the row {row}");
    }
}
