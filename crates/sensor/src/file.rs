//! Model files: 8 bytes of magic, the format version (u32, little endian), the BLAKE3 hash of the rest, CBOR.

use std::fs;
use std::path::Path;

use crate::{FittedModel, SensorError};

const MAGIC: &[u8; 8] = b"locsim\x1as";
/// Version of the format that this program writes and reads.
const VERSION: u32 = 1;
const HEADER: usize = 8 + 4 + blake3::OUT_LEN;

impl FittedModel {
    /// Writes the model to a file. The file appears whole or not at all.
    ///
    /// # Errors
    /// [`SensorError::Io`].
    pub fn save(&self, path: &Path) -> Result<(), SensorError> {
        let io = |source| SensorError::Io { path: path.to_owned(), source };
        let mut body = Vec::new();
        ciborium::into_writer(self, &mut body).map_err(|e| io(std::io::Error::other(e)))?;
        let mut bytes = Vec::with_capacity(HEADER + body.len());
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&VERSION.to_le_bytes());
        bytes.extend_from_slice(blake3::hash(&body).as_bytes());
        bytes.append(&mut body);
        let mut unfinished = path.as_os_str().to_owned();
        unfinished.push(".part");
        fs::write(&unfinished, bytes).and_then(|()| fs::rename(&unfinished, path)).map_err(io)
    }

    /// Reads a model from a file that [`FittedModel::save`] wrote. The loaded model's densities equal the
    /// saved one's bit for bit.
    ///
    /// # Errors
    /// [`SensorError::Io`] if it can't be read, [`SensorError::Foreign`] if it is something else,
    /// [`SensorError::Version`] if its format is another one, [`SensorError::Damaged`] if it is cut short or
    /// altered.
    pub fn load(path: &Path) -> Result<Self, SensorError> {
        let bytes = fs::read(path).map_err(|source| SensorError::Io { path: path.to_owned(), source })?;
        let damaged = |what: String| SensorError::Damaged { path: path.to_owned(), what };
        let Some(rest) = bytes.strip_prefix(MAGIC) else {
            return Err(SensorError::Foreign(path.to_owned()));
        };
        let Some((version, rest)) = rest.split_first_chunk::<4>() else {
            return Err(damaged("it ends within its header".to_owned()));
        };
        let found = u32::from_le_bytes(*version);
        if found != VERSION {
            return Err(SensorError::Version { path: path.to_owned(), found, known: VERSION });
        }
        let Some((hash, body)) = rest.split_first_chunk::<{ blake3::OUT_LEN }>() else {
            return Err(damaged("it ends within its header".to_owned()));
        };
        if blake3::hash(body) != blake3::Hash::from_bytes(*hash) {
            return Err(damaged("it is cut short or altered: its hash doesn't match".to_owned()));
        }
        ciborium::from_reader(body).map_err(|e| damaged(e.to_string()))
    }
}
