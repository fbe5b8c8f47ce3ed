//! Range tables kept on disk.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;
use wide::bytemuck::{cast_slice, pod_collect_to_vec};

use super::build::{Built, Views};
use super::sight::SightKey;
use super::{ExactRangeMap, RangeTableOptions};
use crate::map::CellFrame;

/// First bytes of a file; the number counts formats.
const MAGIC: &[u8; 24] = b"locsim range table v1\n\0\0";
/// Length of a hash \[bytes\].
const HASH: usize = blake3::OUT_LEN;

/// The file of one table: its name is the hash of all that the table follows from, so that no other table's content
/// can be taken for it.
pub(super) struct Cached {
    path: PathBuf,
    key: [u8; HASH],
}

impl Cached {
    /// The file in `folder` for the table of a map with these cells.
    pub fn new(
        folder: &Path,
        map: &ExactRangeMap,
        options: &RangeTableOptions,
        frame: &CellFrame,
        in_sight: &[bool],
    ) -> Self {
        let mut hasher = blake3::Hasher::new();
        hasher.update(MAGIC).update(env!("CARGO_PKG_VERSION").as_bytes());
        // Distinguishes machines of another byte order, too.
        hasher.update(&1_u32.to_ne_bytes());
        let numbers =
            [frame.x0, frame.y0, frame.cell_m, frame.columns as f64, frame.rows as f64, options.tolerance_m];
        hasher.update(cast_slice(&numbers));
        for [a, b] in map.geometry().segments() {
            hasher.update(cast_slice(&[a.x, a.y, b.x, b.y]));
        }
        hasher.update(cast_slice(map.geometry().surfaces()));
        hasher.update(&in_sight.iter().map(|&inside| u8::from(inside)).collect::<Vec<_>>());
        let key = *hasher.finalize().as_bytes();
        let name = blake3::Hash::from_bytes(key).to_hex();
        Self { path: folder.join(format!("range-table-{}.bin", &name[..32])), key }
    }

    /// The table, unless there is none, or one that was cut short, altered, or written for something else.
    pub fn read(&self) -> Option<Built> {
        let bytes = fs::read(&self.path).ok()?;
        let (content, hash) = bytes.split_at_checked(bytes.len().checked_sub(HASH)?)?;
        if blake3::hash(content).as_bytes() != hash {
            return None;
        }
        let content = content.strip_prefix(MAGIC)?.strip_prefix(&self.key)?;
        let numbers: Vec<u32> = pod_collect_to_vec(content);
        let mut rest = numbers.as_slice();
        let mut take = || {
            let (length, after) = rest.split_first()?;
            let (taken, after) = after.split_at_checked(*length as usize)?;
            rest = after;
            Some(taken)
        };
        let rows = take()?.to_vec();
        let entries = take()?.to_vec();
        let sights =
            take()?.as_chunks().0.iter().map(|&[a, b, corner]| SightKey { walls: [a, b], corner }).collect();
        let lengths = take()?;
        let mut walls = take()?;
        let lists = lengths
            .iter()
            .map(|&length| {
                let (list, after) = walls.split_at_checked(length as usize)?;
                walls = after;
                Some(list.into())
            })
            .collect::<Option<_>>()?;
        Some(Built { rows, entries, views: Views { sights, lists } })
    }

    /// Keeps a table. A folder that can't be written to costs time, next time, and nothing else.
    pub fn write(&self, built: &Built) {
        let Views { sights, lists } = &built.views;
        let sights: Vec<u32> =
            sights.iter().flat_map(|key| [key.walls[0], key.walls[1], key.corner]).collect();
        let lengths: Vec<u32> = lists.iter().map(|list| list.len() as u32).collect();
        let walls: Vec<u32> = lists.iter().flat_map(|list| list.iter().copied()).collect();
        let mut content = [MAGIC.as_slice(), &self.key].concat();
        for part in [&built.rows, &built.entries, &sights, &lengths, &walls] {
            let Ok(length) = u32::try_from(part.len()) else { return };
            content.extend(length.to_ne_bytes());
            content.extend(cast_slice::<u32, u8>(part));
        }
        let hash = blake3::hash(&content);
        content.extend(hash.as_bytes());
        let folder = self.path.parent().unwrap_or(Path::new("."));
        let written = fs::create_dir_all(folder).and_then(|()| {
            let mut file = NamedTempFile::new_in(folder)?;
            file.write_all(&content)?;
            file.persist(&self.path).map_err(|error| error.error)
        });
        drop(written);
    }
}
