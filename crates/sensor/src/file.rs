//! Model files: 8 bytes of magic, the format version (u32, little endian), the BLAKE3 hash of the rest, CBOR.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use ciborium::de::Error;
use locsim_core::limits::Limits;
use locsim_core::output::write_file;

use crate::{FittedModel, SensorError};

const MAGIC: &[u8; 8] = b"locsim\x1as";
/// Version of the format and of what its numbers mean: classes of beams, say. This program writes and reads no other.
const VERSION: u32 = 2;
const HEADER: usize = 8 + 4 + blake3::OUT_LEN;

impl FittedModel {
    /// The content of a model file.
    ///
    /// # Panics
    /// Never: every model has a form in CBOR, and memory takes every byte.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut body = Vec::new();
        ciborium::into_writer(self, &mut body).expect("memory takes every byte");
        let mut bytes = Vec::with_capacity(HEADER + body.len());
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&VERSION.to_le_bytes());
        bytes.extend_from_slice(blake3::hash(&body).as_bytes());
        bytes.append(&mut body);
        bytes
    }

    /// Writes the model to a file. The file appears whole or not at all.
    ///
    /// # Errors
    /// [`SensorError::Io`].
    pub fn save(&self, path: &Path) -> Result<(), SensorError> {
        let io = |source| SensorError::Io { path: path.to_owned(), source };
        write_file(path, |file| file.write_all(&self.to_bytes())).map_err(io)
    }

    /// Reads a model from a file that [`FittedModel::save`] wrote. The loaded model's densities equal the
    /// saved one's bit for bit.
    ///
    /// # Errors
    /// [`SensorError::Io`] if it can't be read, [`SensorError::TooLarge`] if it is larger than models are, otherwise as
    /// [`FittedModel::from_bytes`].
    pub fn load(path: &Path) -> Result<Self, SensorError> {
        let io = |source| SensorError::Io { path: path.to_owned(), source };
        let most = Limits::current().model_bytes;
        let mut bytes = Vec::new();
        let mut file = File::open(path).map_err(io)?;
        // Pipes and devices have no length to trust, so that one byte more than allowed is asked for.
        file.by_ref().take(most.saturating_add(1)).read_to_end(&mut bytes).map_err(io)?;
        if bytes.len() as u64 > most {
            let found = file.metadata().map_or(0, |metadata| metadata.len()).max(bytes.len() as u64);
            let refusal = Limits::current().refusal("model_bytes", found);
            return Err(SensorError::TooLarge { path: path.to_owned(), refusal });
        }
        Self::from_bytes(&bytes, path)
    }

    /// Reads a model from the content of a file; `path` is its name in errors.
    ///
    /// # Errors
    /// [`SensorError::Foreign`] if it is something else, [`SensorError::Version`] if its format is another one,
    /// [`SensorError::Damaged`] if it is cut short or altered, or holds no model that a fit could have given.
    pub fn from_bytes(bytes: &[u8], path: &Path) -> Result<Self, SensorError> {
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
        let Some((hash, mut body)) = rest.split_first_chunk::<{ blake3::OUT_LEN }>() else {
            return Err(damaged("it ends within its header".to_owned()));
        };
        if blake3::hash(body) != blake3::Hash::from_bytes(*hash) {
            return Err(damaged("it is cut short or altered: its hash doesn't match".to_owned()));
        }
        let model = ciborium::from_reader(&mut body).map_err(|error| damaged(describe(error)))?;
        match body.len() {
            0 => Ok(model),
            more => Err(damaged(format!("{more} bytes follow the model"))),
        }
    }
}

/// The error of a CBOR document in words, without the names of Rust types.
fn describe(error: Error<io::Error>) -> String {
    match error {
        Error::Semantic(_, what) => what,
        Error::Syntax(at) => format!("byte {at} of its content is no CBOR"),
        Error::Io(_) => "its content ends too early".to_owned(),
        Error::RecursionLimitExceeded => "its content is nested too deeply".to_owned(),
    }
}
