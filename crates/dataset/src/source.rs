//! Opens logs: refuses files of other types, and limits the unpacked size of compressed ones.

use std::borrow::BorrowMut;
use std::fs::File;
use std::io::{self, BufRead, BufReader, ErrorKind, Read};
use std::path::Path;

use flate2::bufread::MultiGzDecoder;
use locsim_core::limits::{Limits, UNPACKING_FACTOR};
use mcap::MAGIC;

use crate::DatasetError;

/// Bytes of a file that are read at once.
pub const READ_AHEAD: usize = 1 << 16;

/// RFC 1952.
const GZIP: &[u8] = &[0x1f, 0x8b];

const BYTE_ORDER_MARK: &[u8] = "\u{feff}".as_bytes();

/// First bytes of files that are no logs, with their type and the allowed ones.
const FOREIGN: [(&[u8], &str); 3] = [
    (
        b"SQLite format 3\0",
        "a SQLite file, as rosbag2 writes them; allowed: MCAP, which `ros2 bag convert` makes of it",
    ),
    (b"#ROSBAG V", "a bag of ROS 1; allowed: MCAP, which `rosbags-convert` makes of it"),
    (&[0x28, 0xb5, 0x2f, 0xfd], "compressed with zstd; allowed: what `zstd -d` makes of it"),
];

/// A text holds fewer control characters than one in this many; binary data hold more.
const TEXT: usize = 50;

/// Opens a text file, decompressing it when it starts as gzip does.
pub fn open_text(path: &Path, limits: &Limits) -> Result<Box<dyn BufRead>, DatasetError> {
    let (mut file, length) = open(path)?;
    let failed = |source| DatasetError::Read { path: path.to_owned(), line: 1, source };
    let mut text: Box<dyn BufRead> = if file.fill_buf().map_err(failed)?.starts_with(GZIP) {
        let allowance = Allowance::of(length, limits);
        let unpacked = Counted { packed: MultiGzDecoder::new(file), allowance };
        Box::new(BufReader::with_capacity(READ_AHEAD, unpacked))
    } else {
        Box::new(file)
    };
    let start = text.fill_buf().map_err(failed)?;
    refuse_foreign(path, start)?;
    if start.starts_with(MAGIC) {
        return Err(not_a_log(
            path,
            "a bag in MCAP; allowed: one that isn't compressed as a whole, named `.mcap`",
        ));
    }
    let controls = start.iter().filter(|byte| byte.is_ascii_control() && !byte.is_ascii_whitespace()).count();
    if controls * TEXT > start.len() {
        return Err(not_a_log(path, "a binary file; allowed: a text log, or a bag named `.mcap`"));
    }
    if start.starts_with(BYTE_ORDER_MARK) {
        text.consume(BYTE_ORDER_MARK.len());
    }
    Ok(text)
}

/// Opens a bag; returns its length (bytes) too.
pub fn open_bag(path: &Path) -> Result<(BufReader<File>, u64), DatasetError> {
    let (mut file, length) = open(path)?;
    let start = file.fill_buf().map_err(|source| DatasetError::Open { path: path.to_owned(), source })?;
    refuse_foreign(path, start)?;
    if start.starts_with(GZIP) {
        return Err(not_a_log(path, "compressed with gzip; allowed for a bag: what `gunzip` makes of it"));
    }
    Ok((file, length))
}

fn open(path: &Path) -> Result<(BufReader<File>, u64), DatasetError> {
    let failed = |source| DatasetError::Open { path: path.to_owned(), source };
    let file = File::open(path).map_err(failed)?;
    let metadata = file.metadata().map_err(failed)?;
    if metadata.is_dir() {
        return Err(not_a_log(path, "a folder; allowed: a text log, or a bag in one MCAP file"));
    }
    Ok((BufReader::with_capacity(READ_AHEAD, file), metadata.len()))
}

fn refuse_foreign(path: &Path, start: &[u8]) -> Result<(), DatasetError> {
    match FOREIGN.iter().find(|(magic, _)| start.starts_with(magic)) {
        Some((_, found)) => Err(not_a_log(path, found)),
        None => Ok(()),
    }
}

fn not_a_log(path: &Path, found: &'static str) -> DatasetError {
    DatasetError::NotALog { path: path.to_owned(), found }
}

/// How many bytes the compressed parts of a file may still unpack to.
pub struct Allowance {
    allowed: u64,
    left: u64,
}

impl Allowance {
    /// The allowance of a file of `length` bytes.
    pub fn of(length: u64, limits: &Limits) -> Self {
        let allowed = limits.log_unpacked_bytes.max(length.saturating_mul(UNPACKING_FACTOR));
        Self { allowed, left: allowed }
    }
}

/// Reads the output of a decompressor up to the allowance, then fails with [`ErrorKind::FileTooLarge`].
pub struct Counted<R, A> {
    pub packed: R,
    pub allowance: A,
}

impl<R: Read, A: BorrowMut<Allowance>> Read for Counted<R, A> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.packed.read(buffer)?;
        let Allowance { allowed, left } = self.allowance.borrow_mut();
        *left = left.checked_sub(read as u64).ok_or_else(|| {
            io::Error::new(ErrorKind::FileTooLarge, Limits::refusal_above("log_unpacked_bytes", *allowed))
        })?;
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::io::Write;

    use flate2::Compression;
    use flate2::write::GzEncoder;

    use crate::{CarmenOptions, LogOptions, read_carmen, read_log};

    const SCAN: &str = "FLASER 1 1 0 0 0 0 0 0 1 h 1\n";

    fn zipped(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    }

    fn refused(name: &str, bytes: &[u8]) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        let error = read_log(&path, &LogOptions::default()).unwrap_err();
        assert!(matches!(error, DatasetError::NotALog { .. }), "{error}");
        error.to_string()
    }

    #[test]
    fn what_is_no_log_is_known_by_content() {
        let png = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\x03\x20\0\0\x02\x58\x08\x02\0\0\0";
        let wide: Vec<u8> = SCAN.encode_utf16().flat_map(u16::to_le_bytes).collect();
        for (name, bytes, part) in [
            (
                "bag.db3",
                &b"SQLite format 3\0\x10\0\x01\x01\0"[..],
                "a SQLite file, as rosbag2 writes them; allowed: MCAP",
            ),
            ("bag.mcap", b"SQLite format 3\0\x10\0\x01\x01\0", "a SQLite file"),
            ("old.bag", b"#ROSBAG V2.0\nE\0\0\0", "a bag of ROS 1"),
            ("bag.mcap.zstd", b"\x28\xb5\x2f\xfd\x04", "compressed with zstd; allowed: what `zstd -d`"),
            ("bag.mcap", b"\x28\xb5\x2f\xfd\x04", "compressed with zstd"),
            ("bag.mcap", &zipped(MAGIC), "compressed with gzip; allowed for a bag: what `gunzip`"),
            (
                "bag.mcap.gz",
                &zipped(MAGIC),
                "a bag in MCAP; allowed: one that isn't compressed as a whole, named `.mcap`",
            ),
            ("bag", MAGIC, "a bag in MCAP"),
            ("map.log", png, "a binary file; allowed: a text log"),
            ("map.log.gz", &zipped(png), "a binary file"),
            ("wide.log", &wide, "a binary file"),
        ] {
            let message = refused(name, bytes);
            assert!(message.contains(part) && !message.contains(char::is_control), "{name}: {message}");
        }
        let folder = tempfile::tempdir().unwrap();
        for path in [folder.path().to_owned(), folder.path().join("bag.mcap")] {
            fs::create_dir_all(&path).unwrap();
            let message = read_log(&path, &LogOptions::default()).unwrap_err().to_string();
            assert!(
                message.ends_with("this is a folder; allowed: a text log, or a bag in one MCAP file"),
                "{message}"
            );
        }
    }

    #[test]
    fn a_byte_order_mark_hides_no_scan() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.log");
        fs::write(&path, format!("\u{feff}{SCAN}")).unwrap();
        assert_eq!(read_carmen(&path, &CarmenOptions::default()).unwrap().0.steps.len(), 1);
    }

    /// A compressed log may unpack to the limit, or to twenty times its size; one that isn't compressed is never too large.
    #[test]
    fn a_log_unpacks_to_so_much_and_no_more() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.log");
        let read = |bytes: &[u8], limit: u64| {
            fs::write(&path, bytes).unwrap();
            let limits = Limits { log_unpacked_bytes: limit, ..Limits::DEFAULT };
            crate::log::read(&path, &LogOptions::default(), &limits).map(|(drive, _)| drive.steps.len())
        };
        let text = SCAN.repeat(5000);
        let (packed, length) = (zipped(text.as_bytes()), text.len() as u64);
        assert!(packed.len() as u64 * UNPACKING_FACTOR < length);
        assert_eq!(read(&packed, length).unwrap(), 5000);
        let message = read(&packed, length - 1).unwrap_err().to_string();
        for part in ["a.log:", "bytes that a compressed log unpacks to", "--limit log_unpacked_bytes="] {
            assert!(message.contains(part), "{message}");
        }
        assert_eq!(read(text.as_bytes(), 1).unwrap(), 5000);
        // Twelve scans shrink to a tenth or so.
        assert_eq!(read(&zipped(SCAN.repeat(12).as_bytes()), 1).unwrap(), 12);
    }
}
