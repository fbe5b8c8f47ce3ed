//! Range tables kept on disk.

use std::fs::{self, DirEntry, File};
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use locsim_core::limits::Limits;
use tempfile::NamedTempFile;
use wide::bytemuck::{cast_slice, cast_slice_mut};

use super::build::{BinContents, Built, MOST_LISTED, rows_of};
use super::sight::{NOTHING, SightKey};
use super::{ExactRangeMap, RangeTableOptions};
use crate::map::CellFrame;

/// First bytes of a file; the number counts formats.
const MAGIC: &[u8; 24] = b"locsim range table v1\n\0\0";
/// Length of a hash \[bytes\].
const HASH: usize = blake3::OUT_LEN;
/// How the names of files begin and end, and how many digits of a hash are between.
const NAME: [&str; 2] = ["range-table-", ".bin"];
const DIGITS: usize = 32;

/// The file of one table: its name is the hash of all that the table follows from, so that no other table's content
/// can be taken for it.
pub(super) struct Cached {
    folder: PathBuf,
    path: PathBuf,
    key: [u8; HASH],
    /// The sizes of a table of this map.
    expected: Expected,
}

struct Expected {
    /// Row of each cell.
    rows: Vec<u32>,
    entries: usize,
    segments: usize,
}

impl Cached {
    /// The file in `folder` for the table of a map with these cells, `headings` entries for each in sight.
    pub fn new(
        folder: &Path,
        map: &ExactRangeMap,
        options: &RangeTableOptions,
        frame: &CellFrame,
        in_sight: &[bool],
        headings: usize,
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
        let [begin, end] = NAME;
        let path = folder.join(format!("{begin}{}{end}", &blake3::Hash::from_bytes(key).to_hex()[..DIGITS]));
        let entries = in_sight.iter().filter(|inside| **inside).count() * headings;
        let segments = map.geometry().segments().len();
        let expected = Expected { rows: rows_of(in_sight), entries, segments };
        Self { folder: folder.to_owned(), path, key, expected }
    }

    /// The table, unless there is none, or one that was cut short, altered, or written for something else. Marks its
    /// file as used.
    pub fn read(&self) -> Option<Built> {
        // Before it is opened: a pipe would be waited for.
        let bytes = fs::metadata(&self.path).ok().filter(fs::Metadata::is_file)?.len();
        if bytes > Limits::current().cache_bytes {
            return None;
        }
        let mut file = File::open(&self.path).ok()?;
        let mut content =
            Content { words: bytes / 4, file: BufReader::new(&mut file), hasher: blake3::Hasher::new() };
        let mut start = [0; MAGIC.len() + HASH];
        content.bytes(&mut start)?;
        if start != *[MAGIC.as_slice(), &self.key].concat() {
            return None;
        }
        let rows = content.part(|length| length == self.expected.rows.len())?;
        let entries = content.part(|length| length == self.expected.entries)?;
        // Each content occurs in at least one bin.
        let sights = content.part(|length| length % 3 == 0 && length / 3 <= entries.len())?;
        let lengths = content.part(|length| length <= entries.len())?;
        let walls = content.part(|length| length / MOST_LISTED <= lengths.len())?;
        let hash = content.hasher.finalize();
        let mut end = Vec::new();
        content.file.take(HASH as u64 + 1).read_to_end(&mut end).ok()?;
        if end != hash.as_bytes() {
            return None;
        }
        let sights =
            sights.as_chunks().0.iter().map(|&[a, b, corner]| SightKey { walls: [a, b], corner }).collect();
        let mut rest = walls.as_slice();
        let lists = lengths
            .iter()
            .map(|&length| {
                let (list, after) = rest.split_at_checked(length as usize)?;
                rest = after;
                Some(list.into())
            })
            .collect::<Option<_>>()?;
        let built = Built { rows, entries, contents: BinContents { sights, lists } };
        if !self.expected.allow(&built) {
            return None;
        }
        mark_as_used(&self.folder, &self.path);
        Some(built)
    }

    /// Stores a table, and removes the least recently used ones while the folder is above its limit. Errors are ignored:
    /// the table is then computed again next time.
    pub fn write(&self, built: &Built) {
        let most = Limits::current().cache_bytes;
        drop(self.write_below(built, most));
        make_room(&self.folder, &self.path, most);
    }

    fn write_below(&self, built: &Built, most: u64) -> io::Result<()> {
        let BinContents { sights, lists } = &built.contents;
        let sights: Vec<u32> =
            sights.iter().flat_map(|key| [key.walls[0], key.walls[1], key.corner]).collect();
        let lengths: Vec<u32> = lists.iter().map(|list| list.len() as u32).collect();
        let walls: Vec<u32> = lists.iter().flat_map(|list| list.iter().copied()).collect();
        let parts = [&built.rows, &built.entries, &sights, &lengths, &walls];
        let bytes = parts.iter().map(|part| 4 * (part.len() + 1)).sum::<usize>() + MAGIC.len() + 2 * HASH;
        if bytes as u64 > most || parts.iter().any(|part| u32::try_from(part.len()).is_err()) {
            return Ok(());
        }
        fs::create_dir_all(&self.folder)?;
        let mut file = BufWriter::new(NamedTempFile::new_in(&self.folder)?);
        let mut hasher = blake3::Hasher::new();
        let mut write = |bytes: &[u8]| {
            hasher.update(bytes);
            file.write_all(bytes)
        };
        write(MAGIC)?;
        write(&self.key)?;
        for part in parts {
            write(&(part.len() as u32).to_ne_bytes())?;
            write(cast_slice(part))?;
        }
        file.write_all(hasher.finalize().as_bytes())?;
        file.into_inner()?.persist(&self.path)?;
        Ok(())
    }
}

impl Expected {
    /// Whether every index of a table is one of something there is.
    fn allow(&self, Built { rows, entries, contents: BinContents { sights, lists } }: &Built) -> bool {
        let is_wall = |wall: &u32| (*wall as usize) < self.segments;
        let is_sight =
            |key: &SightKey| key.corner < 4 && key.walls.iter().all(|wall| is_wall(wall) || *wall == NOTHING);
        let contents = sights.len() + lists.len();
        *rows == self.rows
            && entries.iter().all(|&entry| (entry as usize) < contents)
            && sights.iter().all(is_sight)
            && lists.iter().all(|list| list.iter().all(is_wall))
    }
}

/// A file's content as it is read.
struct Content<'a> {
    file: BufReader<&'a mut File>,
    hasher: blake3::Hasher,
    /// Numbers that the file has room for.
    words: u64,
}

impl Content<'_> {
    fn bytes(&mut self, out: &mut [u8]) -> Option<()> {
        self.file.read_exact(out).ok()?;
        self.hasher.update(out);
        Some(())
    }

    /// Numbers after their length, if that is allowed.
    fn part(&mut self, is_allowed: impl Fn(usize) -> bool) -> Option<Vec<u32>> {
        let mut length = [0; 4];
        self.bytes(&mut length)?;
        let length = u32::from_ne_bytes(length);
        if u64::from(length) > self.words || !is_allowed(length as usize) {
            return None;
        }
        let mut part = vec![0; length as usize];
        self.bytes(cast_slice_mut(&mut part))?;
        Some(part)
    }
}

/// Sets a file's time of change to now, which is that of a file just made: there is no clock here.
fn mark_as_used(folder: &Path, path: &Path) {
    let mark = || -> io::Result<()> {
        let now = NamedTempFile::new_in(folder)?.as_file().metadata()?.modified()?;
        File::options().write(true).open(path)?.set_modified(now)
    };
    // A folder that can't be written to has no order of use either.
    drop(mark());
}

/// Removes tables, the oldest changes first, until a folder holds at most `most` bytes of them; `newest` stays.
fn make_room(folder: &Path, newest: &Path, most: u64) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    // Files that vanish meanwhile were removed by another process.
    let mut tables: Vec<(SystemTime, u64, PathBuf)> = entries
        .flatten()
        .filter(is_table)
        .filter_map(|entry| {
            let metadata = entry.metadata().ok()?;
            Some((metadata.modified().ok()?, metadata.len(), entry.path()))
        })
        .collect();
    tables.sort();
    let mut bytes: u64 = tables.iter().map(|(_, bytes, _)| bytes).sum();
    for (_, size, path) in tables.iter().filter(|(_, _, path)| path != newest) {
        if bytes <= most {
            break;
        }
        drop(fs::remove_file(path));
        bytes -= size;
    }
}

/// Whether it is a file of ours, by its name.
fn is_table(entry: &DirEntry) -> bool {
    let name = entry.file_name();
    let [begin, end] = NAME;
    let digits = name.to_str().and_then(|name| name.strip_prefix(begin)?.strip_suffix(end));
    let is_digit = |c: u8| c.is_ascii_digit() || (b'a'..=b'f').contains(&c);
    digits.is_some_and(|digits| digits.len() == DIGITS && digits.bytes().all(is_digit))
        && entry.file_type().is_ok_and(|kind| kind.is_file())
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn table_name(i: u32) -> String {
        format!("range-table-{i:032x}.bin")
    }

    #[test]
    fn tables_not_used_for_longest_go_first_and_nothing_else_goes() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let begin = SystemTime::UNIX_EPOCH + Duration::from_secs(1_000_000);
        for i in 0..4 {
            let file = File::create(at(&table_name(i))).unwrap();
            file.set_len(100).unwrap();
            file.set_modified(begin + Duration::from_secs(u64::from(i))).unwrap();
        }
        let others = [
            "thesis.tex",
            "range-table-0.bin",
            "range-table-.bin",
            "range-table-0000000000000000000000000000000G.bin",
            ".locsim-1.tmp",
        ];
        for name in others {
            fs::write(at(name), vec![0; 1000]).unwrap();
        }
        fs::create_dir(at(&table_name(9))).unwrap();
        mark_as_used(folder.path(), &at(&table_name(0)));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 10, "no file is left over");
        make_room(folder.path(), &at(&table_name(3)), 250);
        let is_there = |i| at(&table_name(i)).exists();
        assert_eq!([0, 1, 2, 3, 9].map(is_there), [true, false, false, true, true]);
        make_room(folder.path(), &at(&table_name(3)), 0);
        assert_eq!([0, 3, 9].map(is_there), [false, true, true]);
        assert!(others.iter().all(|name| at(name).exists()));
        make_room(&at("missing"), &at("missing/file"), 0);
        mark_as_used(&at("missing"), &at("missing/file"));
    }
}
