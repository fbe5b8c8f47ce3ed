use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::Read as _;
use std::path::{Path, PathBuf};

use locsim_core::input::is_pipe_or_device;
use locsim_core::limits::quoted;

use crate::DatasetError;

/// How the files of a bag's folder end; compressed ones are preferred last.
const ENDINGS: [&str; 6] = [".mcap", ".db3", ".mcap.zstd", ".mcap.zst", ".db3.zstd", ".db3.zst"];

/// What rosbag2 writes beside the files.
const METADATA: &str = "metadata.yaml";

/// Whether a folder is that of a recording, by its `metadata.yaml`: another file there would be taken for a part of it.
pub fn is_recording(folder: &Path) -> bool {
    folder.join(METADATA).is_file() && files(folder).is_ok()
}

/// The files of a bag's folder in the order of their numbers: `NAME_0.mcap`, `NAME_1.mcap`, ...
///
/// `ros2 bag reindex` orders them so, too. `metadata.yaml` isn't needed: a recording that was killed has none. Where it is there, so are the files that it lists.
pub fn files(folder: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    let failed = |source| DatasetError::Open { path: folder.to_owned(), source };
    let refuse = |reason: String| DatasetError::Folder { path: folder.to_owned(), reason };
    // By stem and number, so that files are found in order.
    let mut files = BTreeMap::<(String, Option<u64>), PathBuf>::new();
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let Some(name) = path.file_name().and_then(|name| name.to_str()) else { continue };
        let Some(stem) = ENDINGS.iter().find_map(|ending| name.strip_suffix(ending)) else { continue };
        if is_pipe_or_device(&path) {
            return Err(refuse(format!("`{}` is a pipe or a device; allowed: files", quoted(name))));
        }
        let numbered = stem.rsplit_once('_').and_then(|(stem, number)| Some((stem, number.parse().ok()?)));
        let (stem, number) = numbered.map_or((stem, None), |(stem, number)| (stem, Some(number)));
        let key = (stem.to_owned(), number);
        if let Some(other) = files.get(&key) {
            let both = [other, &path].map(|path| path.file_name().unwrap_or_default().to_string_lossy());
            return Err(refuse(format!("`{}` and `{}` are both there", both[0], both[1])));
        }
        files.insert(key, path);
    }
    let mut stems = files.keys().map(|(stem, _)| stem);
    let Some(first) = stems.next() else {
        return Err(refuse("the folder holds no file of a bag (.mcap, .db3)".to_owned()));
    };
    if let Some(other) = stems.find(|stem| *stem != first) {
        return Err(refuse(format!("the folder holds several bags, `{first}` and `{other}`")));
    }
    complete(folder, &files)?;
    Ok(files.into_values().collect())
}

/// Bytes of `metadata.yaml` that are looked at.
const LONGEST_METADATA: u64 = 1 << 24;

/// What `metadata.yaml` of a bag's folder says, if it is there.
fn metadata(folder: &Path) -> Option<String> {
    let path = Some(folder.join(METADATA)).filter(|path| path.is_file())?;
    let mut text = String::new();
    File::open(path).ok()?.take(LONGEST_METADATA).read_to_string(&mut text).ok()?;
    Some(text)
}

/// How many messages `metadata.yaml` counts, if it is there. Those of each topic follow that of all.
pub fn counted_messages(folder: &Path) -> Option<usize> {
    metadata(folder)?.lines().find_map(|line| line.trim().strip_prefix("message_count:"))?.trim().parse().ok()
}

/// Whether the files are there that `metadata.yaml` lists under `relative_file_paths`, compressed or not.
///
/// Without that file, and where it isn't as rosbag2 writes it, nothing is said.
fn complete(folder: &Path, files: &BTreeMap<(String, Option<u64>), PathBuf>) -> Result<(), DatasetError> {
    let Some(text) = metadata(folder) else { return Ok(()) };
    let unpacked = |name: &str| {
        let ending = [".zstd", ".zst"].iter().find_map(|ending| name.strip_suffix(ending));
        ending.unwrap_or(name).to_owned()
    };
    let there: BTreeSet<String> =
        files.values().filter_map(|path| Some(unpacked(path.file_name()?.to_str()?))).collect();
    let lines = text.lines().skip_while(|line| line.trim() != "relative_file_paths:").skip(1);
    let listed = lines.map_while(|line| line.trim().strip_prefix("- "));
    for path in listed.map(|path| path.trim_matches(['"', '\''])) {
        let name = path.rsplit('/').next().unwrap_or(path);
        if !there.contains(&unpacked(name)) {
            return Err(DatasetError::Folder {
                path: folder.to_owned(),
                reason: format!(
                    "`{}` isn't there, which metadata.yaml lists; allowed: all files of the bag, or no metadata.yaml",
                    quoted(name)
                ),
            });
        }
    }
    Ok(())
}
