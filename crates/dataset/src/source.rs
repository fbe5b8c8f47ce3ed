//! Opens logs: recognises a file by its first bytes, unpacks it, and limits its unpacked size.

use std::borrow::BorrowMut;
use std::fs::File;
use std::io::{self, BufRead, BufReader, ErrorKind, Read};
use std::path::Path;

use flate2::bufread::MultiGzDecoder;
use locsim_core::input::is_pipe_or_device;
use locsim_core::limits::{Limits, UNPACKING_FACTOR};
use mcap::MAGIC as MCAP;
use ruzstd::decoding::{FrameDecoder, StreamingDecoder};

use crate::DatasetError;

/// Bytes of a file that are read at once.
pub const READ_AHEAD: usize = 1 << 16;

/// RFC 1952.
const GZIP: &[u8] = &[0x1f, 0x8b];

/// RFC 8878.
pub const ZSTD: &[u8] = &[0x28, 0xb5, 0x2f, 0xfd];

/// <https://www.sqlite.org/fileformat.html>.
const SQLITE: &[u8] = b"SQLite format 3\0";

/// A map of BeeSoft.
const BEESOFT: [&[u8]; 2] = [b"robot_specifications->", b"global_map[0]:"];

const BYTE_ORDER_MARK: &[u8] = "\u{feff}".as_bytes();

/// First bytes of files that hold no log, with the type of such files.
const FOREIGN: [(&[u8], &str); 12] = [
    (b"#ROSBAG V", "a bag of ROS 1, which `rosbags-convert` makes a bag of ROS 2 of"),
    (b"\x89PNG", "a PNG image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"P5", "a PGM image, perhaps a map"),
    (b"%PDF", "a PDF document"),
    (b"PK\x03\x04", "a zip archive"),
    (b"\x7fELF", "a program"),
    (b"\x89HDF", "an HDF5 file"),
    (b"RRF2", "a recording of Rerun"),
    (b"\xd4\xc3\xb2\xa1", "a capture of network packets"),
    (GZIP, "compressed twice"),
    (ZSTD, "compressed twice"),
];

/// Formats that are read.
pub const LOGS: &str =
    "a ROS 2 bag (a folder, MCAP or SQLite) or a CARMEN log, also compressed with gzip or zstd";

/// A map of BeeSoft where a log is wanted.
pub const BEESOFT_MAP: &str = "a map of BeeSoft, which `locsim convert` makes a ROS map of";

/// First bytes that tell what a file is, at the most.
const SIGNATURE: u64 = 64;

/// A text holds fewer control characters than one in this many; binary data hold more.
const TEXT: usize = 50;

/// Content of a file, by its first bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    Mcap,
    Sqlite,
    BeesoftMap,
    Text,
}

/// A file's content as a stream, unpacked where the file as a whole is compressed.
pub struct Source {
    pub content: Content,
    pub stream: Box<dyn BufRead>,
    /// The file as a whole is compressed.
    pub packed: bool,
    /// Length of the file as it is stored (bytes).
    pub length: u64,
}

impl Source {
    /// Opens a file.
    ///
    /// # Errors
    /// The file can't be opened or unpacked, or holds no log.
    pub fn open(path: &Path, limits: &Limits) -> Result<Self, DatasetError> {
        let failed = |source| DatasetError::Open { path: path.to_owned(), source };
        if is_pipe_or_device(path) {
            return Err(not_a_log(path, "a pipe or a device", "a file"));
        }
        let file = File::open(path).map_err(failed)?;
        let metadata = file.metadata().map_err(failed)?;
        if metadata.is_dir() {
            return Err(not_a_log(path, "a folder", "a file"));
        }
        let length = metadata.len();
        let mut file = BufReader::with_capacity(READ_AHEAD, file);
        let damaged = |source| DatasetError::Read { path: path.to_owned(), line: 1, source };
        let start = file.fill_buf().map_err(damaged)?;
        let (gzip, zstd) = (start.starts_with(GZIP), start.starts_with(ZSTD));
        let allowance = Allowance::of(length, limits);
        let mut stream: Box<dyn BufRead> = if gzip {
            let packed = MultiGzDecoder::new(file);
            Box::new(BufReader::with_capacity(READ_AHEAD, Counted { packed, allowance }))
        } else if zstd {
            let packed = ZstdFrames::new(file);
            Box::new(BufReader::with_capacity(READ_AHEAD, Counted { packed, allowance }))
        } else {
            Box::new(file)
        };
        let content = content(path, stream.fill_buf().map_err(damaged)?)?;
        Ok(Self { content, stream, packed: gzip || zstd, length })
    }
}

/// Content of data that begin so.
fn content(path: &Path, start: &[u8]) -> Result<Content, DatasetError> {
    if let Some((_, found)) = FOREIGN.iter().find(|(magic, _)| start.starts_with(magic)) {
        return Err(not_a_log(path, found, LOGS));
    }
    if start.starts_with(MCAP) {
        return Ok(Content::Mcap);
    }
    if start.starts_with(SQLITE) {
        return Ok(Content::Sqlite);
    }
    if BEESOFT.iter().any(|begin| start.starts_with(begin)) {
        return Ok(Content::BeesoftMap);
    }
    let controls = start.iter().filter(|byte| byte.is_ascii_control() && !byte.is_ascii_whitespace()).count();
    if controls * TEXT > start.len() {
        return Err(not_a_log(path, "a binary file of an unknown format", LOGS));
    }
    if begins_with_a_key(start) {
        return Err(not_a_log(path, "a YAML file, perhaps a scenario or a map", LOGS));
    }
    Ok(Content::Text)
}

/// What a file is that isn't a text, by its first bytes, in words; `None` for a text, and where it can't be told.
pub fn not_a_text(path: &Path) -> Option<&'static str> {
    if is_pipe_or_device(path) {
        return None;
    }
    let file = File::open(path).ok()?;
    let mut start = Vec::new();
    file.take(SIGNATURE).read_to_end(&mut start).ok()?;
    let signatures = [
        (MCAP, "a ROS 2 bag (MCAP)"),
        (SQLITE, "a SQLite file, perhaps a ROS 2 bag"),
        (GZIP, "a file compressed with gzip, perhaps a log"),
        (ZSTD, "a file compressed with zstd, perhaps a log"),
    ];
    let found = signatures.into_iter().chain(FOREIGN).find(|(signature, _)| start.starts_with(signature));
    found.map(|(_, name)| name)
}

/// Whether a text begins like a YAML file: with a key at the start of its first line that is no comment.
fn begins_with_a_key(start: &[u8]) -> bool {
    let mut lines = start.split(|byte| *byte == b'\n').map(<[u8]>::trim_ascii_end);
    let first = lines.find(|line| !(line.is_empty() || line.starts_with(b"#") || *line == b"---"));
    first.and_then(|line| line.split(|byte| *byte == b':').next().map(|key| (line, key))).is_some_and(
        |(line, key)| {
            let is_word = |byte: &u8| byte.is_ascii_alphanumeric() || *byte == b'_';
            let after = &line[key.len()..];
            !key.is_empty() && key.iter().all(is_word) && (after == b":" || after.starts_with(b": "))
        },
    )
}

/// Opens a text file.
///
/// # Errors
/// Those of [`Source::open`]; the file holds a bag.
pub fn open_text(path: &Path, limits: &Limits) -> Result<Box<dyn BufRead>, DatasetError> {
    let Source { content, mut stream, .. } = Source::open(path, limits)?;
    match content {
        Content::Mcap => Err(not_a_log(path, "a ROS 2 bag (MCAP)", "a text file")),
        Content::Sqlite => Err(not_a_log(path, "a SQLite file, perhaps a ROS 2 bag", "a text file")),
        Content::BeesoftMap => Err(not_a_log(path, BEESOFT_MAP, "a text log or a trajectory")),
        Content::Text => {
            // The first bytes were read above.
            if stream.fill_buf().is_ok_and(|start| start.starts_with(BYTE_ORDER_MARK)) {
                stream.consume(BYTE_ORDER_MARK.len());
            }
            Ok(stream)
        }
    }
}

pub fn not_a_log(path: &Path, found: &'static str, allowed: &'static str) -> DatasetError {
    DatasetError::NotALog { path: path.to_owned(), found, allowed }
}

/// Reads data compressed with zstd: frames one after the other, their check sums compared.
struct ZstdFrames<R: Read> {
    state: ZstdState<R>,
}

enum ZstdState<R: Read> {
    /// Before a frame.
    Between(R),
    Within(Box<StreamingDecoder<R, FrameDecoder>>),
    End,
}

impl<R: Read> ZstdFrames<R> {
    fn new(stream: R) -> Self {
        Self { state: ZstdState::Between(stream) }
    }
}

impl<R: BufRead> Read for ZstdFrames<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            self.state = match std::mem::replace(&mut self.state, ZstdState::End) {
                ZstdState::End => return Ok(0),
                ZstdState::Between(mut stream) => {
                    if stream.fill_buf()?.is_empty() {
                        return Ok(0);
                    }
                    ZstdState::Within(Box::new(StreamingDecoder::new(stream).map_err(|_| cut_off())?))
                }
                ZstdState::Within(mut frame) => {
                    let read = frame.read(buffer).map_err(|_| cut_off())?;
                    if read > 0 || buffer.is_empty() {
                        self.state = ZstdState::Within(frame);
                        return Ok(read);
                    }
                    let (stream, decoder) = frame.into_parts();
                    let stored = decoder.get_checksum_from_data();
                    if stored.is_some() && stored != decoder.get_calculated_checksum() {
                        return Err(io::Error::other("the check sum of the compressed data is wrong"));
                    }
                    ZstdState::Between(stream)
                }
            }
        }
    }
}

/// The error of the library names its own steps.
fn cut_off() -> io::Error {
    io::Error::other("the compressed data are damaged or cut off")
}

/// Unpacks a message of at most `largest` bytes that is compressed with zstd.
///
/// # Errors
/// The data are damaged or unpack to more than is allowed.
pub fn unpack_message(
    data: &[u8],
    largest: u64,
    allowance: &mut Allowance,
    into: &mut Vec<u8>,
) -> io::Result<()> {
    into.clear();
    let length = Counted { packed: ZstdFrames::new(data), allowance }.take(largest + 1).read_to_end(into)?;
    if length as u64 > largest {
        return Err(io::Error::other(format!("it has more than {largest} bytes")));
    }
    Ok(())
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
    use ruzstd::encoding::{CompressionLevel, compress_to_vec};

    use crate::{CarmenOptions, LogOptions, read_carmen, read_log, read_tum};

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
        let zstd = |bytes: &[u8]| compress_to_vec(bytes, CompressionLevel::Fastest);
        for (name, bytes, part) in [
            ("old.bag", b"#ROSBAG V2.0\nE\0\0\0".to_vec(), "a bag of ROS 1, which `rosbags-convert`"),
            ("my.yaml", b"# a scenario\n\nseed: 1\n".to_vec(), "a YAML file, perhaps a scenario or a map"),
            ("floor.yaml", b"image: floor.pgm\r\nmode: trinary\r\n".to_vec(), "a YAML file"),
            ("map.log", png.to_vec(), "a PNG image; allowed: a ROS 2 bag (a folder, MCAP or SQLite) or"),
            ("map.mcap", png.to_vec(), "a PNG image"),
            ("map.log.gz", zipped(png), "a PNG image"),
            ("map.db3.zst", zstd(png), "a PNG image"),
            ("twice.log.gz", zipped(&zipped(SCAN.as_bytes())), "compressed twice"),
            ("twice.mcap", zipped(&zstd(MCAP)), "compressed twice"),
            ("wide.log", wide, "a binary file of an unknown format"),
        ] {
            let message = refused(name, &bytes);
            assert!(message.contains(part) && !message.contains(char::is_control), "{name}: {message}");
        }
    }

    #[test]
    fn a_trajectory_is_a_text() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.tum");
        for (bytes, part) in [(MCAP, "a ROS 2 bag (MCAP); allowed: a text file"), (SQLITE, "a SQLite file")] {
            fs::write(&path, bytes).unwrap();
            let message = read_tum(&path).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
        let message = read_tum(folder.path()).unwrap_err().to_string();
        assert!(message.ends_with("this is a folder; allowed: a file"), "{message}");
    }

    #[test]
    fn a_text_log_may_be_packed_with_zstd() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.log");
        let frame = compress_to_vec(SCAN.as_bytes(), CompressionLevel::Fastest);
        // Two frames, one after the other, are one content.
        fs::write(&path, frame.repeat(2)).unwrap();
        assert_eq!(read_log(&path, &LogOptions::default()).unwrap().0.steps.len(), 2);
        // The check sum of the frame is its last four bytes.
        let mut damaged = frame.clone();
        *damaged.last_mut().unwrap() ^= 1;
        fs::write(&path, &damaged).unwrap();
        let message = read_log(&path, &LogOptions::default()).unwrap_err().to_string();
        assert!(message.contains("check sum of the compressed data is wrong"), "{message}");
        fs::write(&path, &frame[..frame.len() - 6]).unwrap();
        let message = read_log(&path, &LogOptions::default()).unwrap_err().to_string();
        assert!(message.ends_with("the compressed data are damaged or cut off"), "{message}");
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
