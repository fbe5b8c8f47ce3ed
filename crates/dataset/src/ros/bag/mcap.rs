//! MCAP files, read in a stream: <https://mcap.dev/spec>.

use std::collections::BTreeMap;
use std::io::{self, BufRead, BufReader, ErrorKind, Read};
use std::path::Path;

use crc32fast::Hasher;
use locsim_core::limits::{Limits, quoted};
use lz4_flex::frame::FrameDecoder;
use mcap::records::op;
use mcap::{MAGIC, McapError};
use ruzstd::decoding::StreamingDecoder;

use super::{Channel, Definition, Envelope, LARGEST_RECORD, LONGEST_NAME};
use crate::DatasetError;
use crate::source::{Allowance, Counted, READ_AHEAD, Source};

/// Bytes of a message before its content: channel, sequence number, two times.
const MESSAGE_HEADER: usize = 2 + 4 + 8 + 8;

/// The content of a message, not yet read.
pub struct Content<'a> {
    pub envelope: Envelope<'a>,
    stream: &'a mut dyn Read,
    length: u64,
    buffer: &'a mut Vec<u8>,
}

impl<'a> Content<'a> {
    /// The bytes.
    ///
    /// # Errors
    /// Why they can't be had.
    pub fn bytes(self) -> Result<&'a [u8], String> {
        held(self.stream, self.length, self.buffer).map_err(|stop| match stop {
            Stop::Damaged(reason) | Stop::Large(reason) => reason,
            Stop::Io(error) => error.to_string(),
            Stop::Refused(error) => error.to_string(),
        })
    }
}

/// Why a visit ends early.
enum Stop {
    /// The file can't be read on, or unpacks to too much.
    Io(io::Error),
    /// The file's content is wrong.
    Damaged(String),
    /// Something is larger than in any log.
    Large(String),
    /// The visitor doesn't want to go on.
    Refused(DatasetError),
}

impl From<io::Error> for Stop {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

impl From<McapError> for Stop {
    fn from(error: McapError) -> Self {
        Self::Damaged(error.to_string())
    }
}

impl Stop {
    fn damaged(reason: impl Into<String>) -> Self {
        Self::Damaged(reason.into())
    }

    fn about(self, path: &Path) -> DatasetError {
        let path = path.to_owned();
        match self {
            Self::Io(error) if error.kind() == ErrorKind::FileTooLarge => {
                DatasetError::Refused { path, line: None, reason: error.to_string() }
            }
            Self::Io(error) if error.kind() == ErrorKind::UnexpectedEof => {
                DatasetError::Mcap { path, reason: McapError::UnexpectedEof.to_string() }
            }
            Self::Io(error) => DatasetError::Mcap { path, reason: error.to_string() },
            Self::Damaged(reason) => DatasetError::Mcap { path, reason },
            Self::Large(reason) => DatasetError::Refused { path, line: None, reason },
            Self::Refused(error) => error,
        }
    }
}

/// Hands every message of a file to `visit`, in the file's order, and skips what `visit` doesn't read. Channels are
/// announced with `None`, some of them more than once.
///
/// The file is read in a stream, and at most one of its records is in memory. Damage may show only after a message was
/// visited: what a message holds counts once the whole file was visited.
pub fn visit_messages(
    path: &Path,
    limits: &Limits,
    visit: impl FnMut(&Channel, Option<Content<'_>>) -> Result<(), DatasetError>,
) -> Result<(), DatasetError> {
    let Source { stream: file, length, .. } = Source::open(path, limits)?;
    let mut allowance = Allowance::of(length, limits);
    let mut visitor = Visitor { visit, channels: Channels::default(), buffer: Vec::new() };
    visitor.file(&mut Summed::new(file), &mut allowance).map_err(|stop| stop.about(path))
}

struct Visitor<F> {
    visit: F,
    /// The channels announced so far.
    channels: Channels,
    /// Holds one record at a time.
    buffer: Vec<u8>,
}

impl<F: FnMut(&Channel, Option<Content<'_>>) -> Result<(), DatasetError>> Visitor<F> {
    fn file(&mut self, file: &mut Summed<Box<dyn BufRead>>, allowance: &mut Allowance) -> Result<(), Stop> {
        magic(file)?;
        let mut complete = false;
        loop {
            let sum = file.sum.clone();
            let (opcode, length) = start_of_record(file)?;
            let mut body = file.take(length);
            match opcode {
                op::FOOTER if complete => {
                    skip(&mut body)?;
                    return magic(file);
                }
                op::FOOTER => return Err(Stop::damaged("the data have no end")),
                op::DATA_END => {
                    complete = true;
                    let [saved] = words(&mut body)?.map(u32::from_le_bytes);
                    let calculated = sum.finalize();
                    // Sum 0 is none.
                    if saved != 0 && saved != calculated {
                        return Err(McapError::BadDataCrc { saved, calculated }.into());
                    }
                }
                op::CHUNK => {
                    let visited = self.chunk(&mut body, allowance);
                    if matches!(visited, Err(Stop::Damaged(_))) && file.stream.fill_buf()?.is_empty() {
                        return Err(McapError::UnexpectedEof.into());
                    }
                    visited?;
                    continue;
                }
                _ => self.record(opcode, length, &mut body)?,
            }
            skip(&mut body)?;
        }
    }

    fn chunk(&mut self, chunk: &mut io::Take<impl Read>, allowance: &mut Allowance) -> Result<(), Stop> {
        // The times of the first and the last message come before it.
        let [_, _, size] = words(chunk)?.map(u64::from_le_bytes);
        let [sum, name] = words(chunk)?.map(u32::from_le_bytes);
        if name as usize > LONGEST_NAME {
            return Err(Stop::Damaged(format!(
                "the name of a compression has {name} bytes; allowed: {LONGEST_NAME}"
            )));
        }
        let mut compression = vec![0; name as usize];
        chunk.read_exact(&mut compression)?;
        let [packed] = words(chunk)?.map(u64::from_le_bytes);
        if packed > chunk.limit() {
            return Err(McapError::BadChunkLength { header: packed, available: chunk.limit() }.into());
        }
        let mut packed = chunk.take(packed);
        let unpackable = |error: io::Error| Stop::Damaged(format!("a chunk can't be unpacked: {error}"));
        let records: &mut dyn Read = match compression.as_slice() {
            b"" => &mut packed,
            b"lz4" => &mut Counted { packed: FrameDecoder::new(packed), allowance },
            b"zstd" => {
                let packed =
                    StreamingDecoder::new(packed).map_err(|error| unpackable(io::Error::other(error)))?;
                &mut Counted { packed, allowance }
            }
            other => {
                let other = quoted(&String::from_utf8_lossy(other));
                return Err(Stop::Damaged(format!(
                    "chunks compressed with `{other}`; allowed: lz4, zstd, none"
                )));
            }
        };
        let mut records = BufReader::with_capacity(READ_AHEAD, Summed::new(records));
        self.records(&mut records).map_err(|stop| match stop {
            Stop::Io(error) if error.kind() == ErrorKind::UnexpectedEof => {
                Stop::damaged("a record is longer than its chunk")
            }
            Stop::Io(error) if error.kind() != ErrorKind::FileTooLarge => unpackable(error),
            stop => stop,
        })?;
        let Summed { sum: calculated, length, .. } = records.into_inner();
        if length != size {
            return Err(Stop::Damaged(format!("a chunk of {size} bytes unpacks to another number of bytes")));
        }
        // Sum 0 is none.
        if sum != 0 && sum != calculated.finalize() {
            return Err(Stop::damaged("the check sum of a chunk is wrong"));
        }
        skip(chunk)
    }

    /// Visits the records of a chunk.
    fn records(&mut self, records: &mut impl BufRead) -> Result<(), Stop> {
        while !records.fill_buf()?.is_empty() {
            let (opcode, length) = start_of_record(records)?;
            let mut body = records.take(length);
            self.record(opcode, length, &mut body)?;
            skip(&mut body)?;
        }
        Ok(())
    }

    /// Visits a record that isn't one of the container's own; may leave some of it.
    fn record(&mut self, opcode: u8, length: u64, body: &mut dyn Read) -> Result<(), Stop> {
        let Self { visit, channels, buffer } = self;
        match opcode {
            op::SCHEMA | op::CHANNEL => match channels.take(opcode, held(body, length, buffer)?)? {
                Some(channel) => visit(channel, None).map_err(Stop::Refused),
                None => Ok(()),
            },
            op::MESSAGE => {
                let mut header = [0; MESSAGE_HEADER];
                body.read_exact(&mut header)?;
                let [id, ..] = [[header[0], header[1]]].map(u16::from_le_bytes);
                let [logged, published] = [6, 14].map(|at| {
                    let time = header[at..].first_chunk().map_or(0, |time| u64::from_le_bytes(*time));
                    i64::try_from(time).unwrap_or(i64::MAX)
                });
                let channel = channels.channels.get(&id);
                let (channel, definition) =
                    channel.ok_or_else(|| Stop::Damaged(format!("a message of unknown channel {id}")))?;
                let envelope = Envelope { logged, published, definition };
                let content =
                    Content { envelope, stream: body, length: length - MESSAGE_HEADER as u64, buffer };
                visit(channel, Some(content)).map_err(Stop::Refused)
            }
            _ => Ok(()),
        }
    }
}

fn magic(file: &mut impl Read) -> Result<(), Stop> {
    let mut magic = [0; MAGIC.len()];
    file.read_exact(&mut magic)?;
    if magic == MAGIC { Ok(()) } else { Err(McapError::BadMagic.into()) }
}

/// The next numbers, byte by byte.
fn words<const SIZE: usize, const N: usize>(stream: &mut impl Read) -> io::Result<[[u8; SIZE]; N]> {
    let mut words = [[0; SIZE]; N];
    stream.read_exact(words.as_flattened_mut())?;
    Ok(words)
}

/// Kind and length of the next record.
fn start_of_record(stream: &mut impl Read) -> io::Result<(u8, u64)> {
    let [[opcode]] = words(stream)?;
    let [length] = words(stream)?.map(u64::from_le_bytes);
    Ok((opcode, length))
}

/// Skips what is left of a record.
fn skip<R: Read>(body: &mut io::Take<R>) -> Result<(), Stop> {
    io::copy(body, &mut io::sink())?;
    if body.limit() == 0 { Ok(()) } else { Err(io::Error::from(ErrorKind::UnexpectedEof).into()) }
}

/// Reads a whole record into the buffer.
fn held<'a>(stream: &mut dyn Read, length: u64, buffer: &'a mut Vec<u8>) -> Result<&'a [u8], Stop> {
    if length > LARGEST_RECORD {
        return Err(Stop::Large(format!("a record has {length} bytes; allowed: at most {LARGEST_RECORD}")));
    }
    buffer.clear();
    stream.take(length).read_to_end(buffer)?;
    if buffer.len() as u64 == length {
        Ok(buffer)
    } else {
        Err(io::Error::from(ErrorKind::UnexpectedEof).into())
    }
}

/// Reads from a stream and keeps the check sum and the number of its bytes.
struct Summed<R> {
    stream: R,
    sum: Hasher,
    length: u64,
}

impl<R> Summed<R> {
    fn new(stream: R) -> Self {
        Self { stream, sum: Hasher::new(), length: 0 }
    }
}

impl<R: Read> Read for Summed<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.stream.read(buffer)?;
        self.sum.update(&buffer[..read]);
        self.length += read as u64;
        Ok(read)
    }
}

/// The channels announced so far.
#[derive(Default)]
struct Channels {
    /// Name of each type, and its definition.
    schemas: BTreeMap<u16, (String, Definition)>,
    channels: BTreeMap<u16, (Channel, Definition)>,
    /// Bytes of the definitions taken in.
    length: u64,
}

impl Channels {
    /// Takes in a schema or a channel; returns the channel.
    ///
    /// The library's way to read these records reserves memory for strings by their claimed lengths.
    fn take(&mut self, opcode: u8, mut body: &[u8]) -> Result<Option<&Channel>, Stop> {
        let body = &mut body;
        match opcode {
            op::SCHEMA => {
                let (id, name) = (number(body)?, name(body)?);
                self.schemas.insert(id, (name, definition(body).unwrap_or_default()));
                Ok(None)
            }
            op::CHANNEL => {
                let [id, schema] = [number(body)?, number(body)?];
                // Schema 0 is none.
                let (schema, definition) = self.schemas.get(&schema).cloned().unwrap_or_default();
                let (topic, encoding) = (name(body)?, name(body)?);
                let metadata = metadata(body).unwrap_or_default();
                let channel = (Channel { topic, schema, encoding }, Definition { metadata, ..definition });
                // Writers repeat their channels.
                if self.channels.get(&id) != Some(&channel) {
                    self.length += channel.1.text.len() as u64;
                    if self.length > LARGEST_RECORD {
                        return Err(Stop::Large(format!(
                            "the definitions of its channels have more than {LARGEST_RECORD} bytes; allowed: at most {LARGEST_RECORD}"
                        )));
                    }
                    self.channels.insert(id, channel);
                }
                Ok(self.channels.get(&id).map(|(channel, _)| channel))
            }
            _ => Ok(None),
        }
    }
}

/// The number that a record's content goes on with.
fn number(body: &mut &[u8]) -> Result<u16, Stop> {
    let (number, rest) = body.split_first_chunk().ok_or_else(short)?;
    *body = rest;
    Ok(u16::from_le_bytes(*number))
}

/// The name that a record's content goes on with.
fn name(body: &mut &[u8]) -> Result<String, Stop> {
    let text = text(body)?;
    let length = text.len();
    if length > LONGEST_NAME {
        return Err(Stop::Large(format!(
            "the name `{}` has {length} bytes; allowed: at most {LONGEST_NAME}",
            quoted(text)
        )));
    }
    Ok(text.to_owned())
}

/// The text that a record's content goes on with.
fn text<'a>(body: &mut &'a [u8]) -> Result<&'a str, Stop> {
    std::str::from_utf8(bytes(body)?).map_err(|error| Stop::Damaged(error.to_string()))
}

/// The bytes that a record's content goes on with, their number first.
fn bytes<'a>(body: &mut &'a [u8]) -> Result<&'a [u8], Stop> {
    let (length, rest) = body.split_first_chunk().ok_or_else(short)?;
    let (bytes, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize).ok_or_else(short)?;
    *body = rest;
    Ok(bytes)
}

/// The definition of a schema, after its name.
fn definition(body: &mut &[u8]) -> Result<Definition, Stop> {
    let (encoding, text) = (name(body)?, bytes(body)?.to_vec());
    Ok(Definition { encoding, text, metadata: BTreeMap::new() })
}

/// The metadata of a channel, at the end of its record.
fn metadata(body: &mut &[u8]) -> Result<BTreeMap<String, String>, Stop> {
    let mut pairs = bytes(body)?;
    let mut metadata = BTreeMap::new();
    while !pairs.is_empty() {
        metadata.insert(text(&mut pairs)?.to_owned(), text(&mut pairs)?.to_owned());
    }
    Ok(metadata)
}

fn short() -> Stop {
    Stop::damaged("a schema or a channel is longer than its record")
}
