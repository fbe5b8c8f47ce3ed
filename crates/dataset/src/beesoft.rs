//! Maps of BeeSoft, the software of Carnegie Mellon University's robots before CARMEN.

use std::path::Path;

use locsim_core::limits::Limits;

use crate::DatasetError;
use crate::lines::Lines;
use crate::source::{Content, Source, not_a_log};

/// A line of keys, and that before the cells.
const SPECIFICATION: &str = "robot_specifications->";
const CELLS: &str = "global_map[0]:";

/// A map of BeeSoft: cells by the probability that they are free.
#[derive(Clone, Debug, PartialEq)]
pub struct BeesoftMap {
    /// Number of cells along x.
    pub width: usize,
    /// Number of cells along y.
    pub height: usize,
    /// Side of a cell (m).
    pub resolution_m: f64,
    /// Probability that a cell is free, row by row from the lower left; `None` where nothing is known.
    pub free: Vec<Option<f32>>,
}

/// Whether a file, packed or not, begins as a map of BeeSoft does.
pub fn is_beesoft_map(path: &Path) -> bool {
    Source::open(path, Limits::current()).is_ok_and(|source| source.content == Content::BeesoftMap)
}

/// Reads a map of BeeSoft, such as `wean.dat`: lines `robot_specifications->KEY VALUE`, of which `resolution` is the side of a
/// cell in centimetres; a line `global_map[0]: HEIGHT WIDTH`; a line of HEIGHT numbers along y for each of WIDTH places along x.
///
/// A number is the probability that the cell is free, or -1 where nothing is known. The instructions that come with `wean.dat` take
/// it for the probability that the cell is occupied; the halls in which the robot drives are 1. The file's other keys
/// place nothing: the lower left corner of the first cell is the origin.
///
/// # Errors
/// The file can't be read, is no such map, lacks cells or the resolution, has a number out of range, or costs more than the
/// [`Limits`] allow.
pub fn read_beesoft_map(path: &Path) -> Result<BeesoftMap, DatasetError> {
    let limits = Limits::current();
    let Source { content: Content::BeesoftMap, stream, .. } = Source::open(path, limits)? else {
        return Err(not_a_log(
            path,
            "another file",
            "a map of BeeSoft, which begins with `robot_specifications->`",
        ));
    };
    let mut lines = Lines::new(path, stream, limits);
    let (mut resolution_m, mut size) = (None, None);
    while size.is_none() {
        let Some(line) = lines.next()? else { break };
        let mut fields = line.fields();
        if fields.keyword == CELLS {
            let [height, width] = ["height", "width"]
                .map(|side| fields.value(side, "a number of cells, 1 or more", |cells: usize| cells > 0));
            let (height, width) = (height?, width?);
            let cells = (width as u64).saturating_mul(height as u64);
            if cells > limits.map_pixels {
                return Err(line.refuse(limits.refusal("map_pixels", cells)));
            }
            size = Some((width, height));
        } else if fields.keyword.strip_prefix(SPECIFICATION) == Some("resolution") {
            let side: f64 = fields.value("side of a cell", "a length in cm, 0.01 to 1e5", |side| {
                (0.01..=1e5).contains(&side)
            })?;
            resolution_m = Some(side / 100.0);
        }
    }
    let refuse = |reason: String| DatasetError::Refused { path: path.to_owned(), line: None, reason };
    let lacks = |key: &str| refuse(format!("`{key}` is missing; allowed: a complete map of BeeSoft"));
    let (width, height) = size.ok_or_else(|| lacks(CELLS))?;
    let resolution_m = resolution_m.ok_or_else(|| lacks("robot_specifications->resolution"))?;
    let mut free = vec![None; width * height];
    for x in 0..width {
        let Some(line) = lines.next()? else {
            return Err(refuse(format!("the map ends after {x} of its {width} lines of cells")));
        };
        let mut fields = line.fields_of("cells");
        fields.expect_remaining(height, 0, "for the height of the map")?;
        for y in 0..height {
            let cell = fields.value(
                &format!("cell {}", y + 1),
                "-1, or a probability from 0 to 1",
                |cell: f32| cell == -1.0 || (0.0..=1.0).contains(&cell),
            )?;
            free[y * width + x] = (cell >= 0.0).then_some(cell);
        }
    }
    Ok(BeesoftMap { width, height, resolution_m, free })
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::{LogOptions, read_log};

    const MAP: &str = "robot_specifications->global_mapsize_x   30\n\
                       robot_specifications->resolution   10\n\n\
                       global_map[0]: 3 2\n\
                       -1.000 0.250 1.000\n\
                       0.000 1.000 1.000\n";

    fn read(text: &str) -> Result<BeesoftMap, DatasetError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("wean.dat");
        fs::write(&path, text).unwrap();
        read_beesoft_map(&path)
    }

    #[test]
    fn lines_run_along_y() {
        let map = read(MAP).unwrap();
        assert_eq!((map.width, map.height, map.resolution_m), (2, 3, 0.1));
        assert_eq!(map.free, [None, Some(0.0), Some(0.25), Some(1.0), Some(1.0), Some(1.0)]);
    }

    #[test]
    fn it_is_known_by_its_content_and_is_no_log() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("wean.log");
        fs::write(&path, MAP).unwrap();
        assert!(is_beesoft_map(&path));
        let message = read_log(&path, &LogOptions::default()).unwrap_err().to_string();
        assert!(message.contains("a map of BeeSoft, which `locsim convert` makes a ROS map of"), "{message}");
        fs::write(&path, "FLASER 1 1 0 0 0 0 0 0 1 h 1\n").unwrap();
        assert!(!is_beesoft_map(&path));
        let message = read_beesoft_map(&path).unwrap_err().to_string();
        assert!(message.contains("begins with `robot_specifications->`"), "{message}");
    }

    #[test]
    fn errors_name_line_value_and_what_is_allowed() {
        for (text, part) in [
            (MAP.replace("0.250", "1.250"), ":5: cells: cell 2 is `1.250`; allowed: -1, or a probability"),
            (MAP.replace("0.250", "nan"), "cell 2 is `nan`"),
            (
                MAP.replace("0.000 1.000 1.000", "0.000 1.000"),
                ":6: cells: the line has 2 fields; allowed: 3 for",
            ),
            (MAP.replace("0.000 1.000 1.000\n", ""), "the map ends after 1 of its 2 lines of cells"),
            (MAP.replace("n   10", "n   0"), "side of a cell is `0`; allowed: a length in cm"),
            (MAP.replace(": 3 2", ": 3 0"), "width is `0`"),
            (MAP.replace(": 3 2", ": 3000000 2000000"), "map_pixels"),
            (MAP.replace("resolution", "length"), "`robot_specifications->resolution` is missing"),
            (MAP[..60].to_owned(), "`global_map[0]:` is missing"),
        ] {
            let message = read(&text).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
    }
}
