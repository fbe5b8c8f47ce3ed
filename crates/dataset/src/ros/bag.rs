use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use lz4_flex::frame::FrameDecoder;
use mcap::parse_record;
use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use ruzstd::decoding::StreamingDecoder;

use crate::DatasetError;

/// So much of the file is read at once.
const READ_AHEAD: usize = 1 << 16;

/// No chunk unpacks to more than this; rosbag2 writes chunks of 1 MB.
const LARGEST_CHUNK: u64 = 1 << 30;

/// What a message belongs to.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Channel {
    pub topic: String,
    /// Name of the message's type; empty where the file doesn't tell.
    pub schema: String,
    /// How the message is serialized; `cdr` in a ROS 2 bag.
    pub encoding: String,
}

/// A channel with one of its messages, or announced without.
type Told<'a> = (&'a Channel, Option<&'a [u8]>);

/// Hands every message of a file to `visit`, in the file's order. Channels are announced with `None`, some of them
/// more than once.
///
/// Every length and check sum is looked at before it is relied on, so that a damaged file is refused.
pub fn visit_messages(
    path: &Path,
    mut visit: impl FnMut(&Channel, Option<&[u8]>) -> Result<(), DatasetError>,
) -> Result<(), DatasetError> {
    let open = |path: &Path| -> io::Result<(File, u64)> {
        let file = File::open(path)?;
        let length = file.metadata()?.len();
        Ok((file, length))
    };
    let (mut file, length) =
        open(path).map_err(|source| DatasetError::Open { path: path.to_owned(), source })?;
    let damaged = |reason: String| DatasetError::Mcap { path: path.to_owned(), reason };
    // Chunks are unpacked below: the library's way into them relies on lengths inside.
    let options = LinearReaderOptions::default()
        .with_emit_chunks(true)
        .with_validate_data_section_crc(true)
        .with_record_length_limit(length as usize);
    let mut reader = LinearReader::new_with_options(options);
    let mut channels = Channels::default();
    while let Some(event) = reader.next_event() {
        match event.map_err(|error| damaged(error.to_string()))? {
            LinearReadEvent::ReadRequest(needed) => {
                let read = file.read(reader.insert(needed.max(READ_AHEAD)));
                let read = read.map_err(|error| damaged(error.to_string()))?;
                reader.notify_read(read);
            }
            LinearReadEvent::Record { opcode: op::CHUNK, data } => {
                let records = unpacked(data).map_err(damaged)?;
                let mut rest = records.as_slice();
                while !rest.is_empty() {
                    let (opcode, body);
                    (opcode, body, rest) = first_record(rest)
                        .ok_or_else(|| damaged("a record is longer than its chunk".to_owned()))?;
                    if let Some((channel, message)) = channels.take(opcode, body).map_err(damaged)? {
                        visit(channel, message)?;
                    }
                }
            }
            LinearReadEvent::Record { opcode, data } => {
                if let Some((channel, message)) = channels.take(opcode, data).map_err(damaged)? {
                    visit(channel, message)?;
                }
            }
        }
    }
    Ok(())
}

/// The channels announced so far.
#[derive(Default)]
struct Channels {
    schemas: BTreeMap<u16, String>,
    channels: BTreeMap<u16, Channel>,
}

impl Channels {
    /// Takes in a record; returns what it is to be told of.
    fn take<'a>(&'a mut self, opcode: u8, body: &'a [u8]) -> Result<Option<Told<'a>>, String> {
        if ![op::SCHEMA, op::CHANNEL, op::MESSAGE].contains(&opcode) {
            return Ok(None);
        }
        match parse_record(opcode, body).map_err(|error| error.to_string())? {
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, header.name);
                Ok(None)
            }
            Record::Channel(record) => {
                // Schema 0 is none.
                let schema = self.schemas.get(&record.schema_id).cloned().unwrap_or_default();
                let channel = Channel { topic: record.topic, schema, encoding: record.message_encoding };
                self.channels.insert(record.id, channel);
                Ok(Some((&self.channels[&record.id], None)))
            }
            Record::Message { header, .. } => {
                let id = header.channel_id;
                let channel =
                    self.channels.get(&id).ok_or_else(|| format!("a message of unknown channel {id}"))?;
                // Behind channel, sequence number, and two times.
                Ok(Some((channel, body.get(2 + 4 + 8 + 8..))))
            }
            _ => Ok(None),
        }
    }
}

/// The records of a chunk, one behind the other.
fn unpacked(chunk: &[u8]) -> Result<Vec<u8>, String> {
    let Record::Chunk { header, data } = parse_record(op::CHUNK, chunk).map_err(|error| error.to_string())?
    else {
        return Err("a chunk that is none".to_owned());
    };
    let (size, packed) = (header.uncompressed_size, data.as_ref());
    if size > LARGEST_CHUNK {
        return Err(format!("a chunk of {size} bytes; allowed: {LARGEST_CHUNK}"));
    }
    // One byte more would be found out.
    let limit = size + 1;
    let mut records = Vec::new();
    let read = match header.compression.as_str() {
        "" => packed.take(limit).read_to_end(&mut records),
        "lz4" => FrameDecoder::new(packed).take(limit).read_to_end(&mut records),
        "zstd" => StreamingDecoder::new(packed)
            .map_err(io::Error::other)
            .and_then(|decoder| decoder.take(limit).read_to_end(&mut records)),
        other => return Err(format!("chunks compressed with `{other}`; allowed: lz4, zstd, none")),
    };
    read.map_err(|error| format!("a chunk can't be unpacked: {error}"))?;
    if records.len() as u64 != size {
        return Err(format!("a chunk of {size} bytes unpacks to another number of bytes"));
    }
    let sum = header.uncompressed_crc;
    // Sum 0 is none.
    if sum != 0 && sum != crc32fast::hash(&records) {
        return Err("the check sum of a chunk is wrong".to_owned());
    }
    Ok(records)
}

/// Splits off the first record: its kind, its content, and what follows. `None` where it isn't whole.
fn first_record(records: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (&opcode, rest) = records.split_first()?;
    let (length, rest) = rest.split_first_chunk()?;
    let (body, rest) = rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
    Some((opcode, body, rest))
}
