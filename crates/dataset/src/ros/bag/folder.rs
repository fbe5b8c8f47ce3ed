use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::DatasetError;

/// How the files of a bag's folder end; compressed ones are preferred last.
const ENDINGS: [&str; 6] = [".mcap", ".db3", ".mcap.zstd", ".mcap.zst", ".db3.zstd", ".db3.zst"];

/// The files of a bag's folder in the order of their numbers: `NAME_0.mcap`, `NAME_1.mcap`, ...
///
/// `ros2 bag reindex` orders them so, too. `metadata.yaml` isn't needed: a recording that was killed has none.
pub fn files(folder: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    let failed = |source| DatasetError::Open { path: folder.to_owned(), source };
    let refuse = |reason: String| DatasetError::Folder { path: folder.to_owned(), reason };
    // By stem and number, so that files are found in order.
    let mut files = BTreeMap::<(String, Option<u64>), PathBuf>::new();
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let Some(name) = path.file_name().and_then(|name| name.to_str()) else { continue };
        let Some(stem) = ENDINGS.iter().find_map(|ending| name.strip_suffix(ending)) else { continue };
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
    match stems.find(|stem| *stem != first) {
        Some(other) => Err(refuse(format!("the folder holds several bags, `{first}` and `{other}`"))),
        None => Ok(files.into_values().collect()),
    }
}
