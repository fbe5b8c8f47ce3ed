use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;

use crate::DatasetError;

/// Writes a whole file through `body`, compressed when the name ends in `.gz`.
///
/// The text goes to a neighbour named `<name>.partial`, which takes the file's place when it is complete: a
/// reader never sees half a file, and a failure leaves what was there before.
pub fn write_whole(
    path: &Path,
    body: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), DatasetError> {
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    let partial = Path::new(&partial);
    write_to(partial, path.extension().is_some_and(|e| e == "gz"), body)
        .and_then(|()| fs::rename(partial, path))
        .map_err(|source| {
            // Nothing may be there to remove; the first failure is the one to report.
            let _ = fs::remove_file(partial);
            DatasetError::Write { path: path.to_owned(), source }
        })
}

fn write_to(
    path: &Path,
    compress: bool,
    body: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    let file = BufWriter::new(File::create(path)?);
    let file = if compress {
        // Buffered on the outside too: the encoder works on blocks, the body writes words.
        let mut encoder = BufWriter::new(GzEncoder::new(file, Compression::default()));
        body(&mut encoder)?;
        encoder.into_inner()?.finish()?
    } else {
        let mut file = file;
        body(&mut file)?;
        file
    };
    file.into_inner()?.sync_all()
}
