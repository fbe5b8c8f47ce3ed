//! Opens logs: says what isn't one, and counts what a compressed one unpacks to.

use std::borrow::BorrowMut;
use std::fs::File;
use std::io::{self, BufRead, BufReader, ErrorKind, Read};
use std::path::Path;

use flate2::bufread::MultiGzDecoder;
use locsim_core::limits::{Limits, UNPACKING_FACTOR};
use mcap::MAGIC;

use crate::DatasetError;

/// So much of a file is read at once.
pub const READ_AHEAD: usize = 1 << 16;

/// RFC 1952.
const GZIP: &[u8] = &[0x1f, 0x8b];

const BYTE_ORDER_MARK: &[u8] = "\u{feff}".as_bytes();

/// How files begin that are no logs, what they are, and what is allowed instead.
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
    /// That of a file of so many bytes.
    pub fn of(length: u64, limits: &Limits) -> Self {
        let allowed = limits.log_unpacked_bytes.max(length.saturating_mul(UNPACKING_FACTOR));
        Self { allowed, left: allowed }
    }
}

/// Reads what a decompressor unpacks, up to the allowance; then fails with [`ErrorKind::FileTooLarge`].
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
