//! Where a run keeps what it has finished, so that an interruption loses one trial at most and earlier results
//! stay until new ones are complete.

use std::fs;
use std::path::{Path, PathBuf};

use super::RunError;
use crate::results::Trial;

/// Name of the file by which a results folder is known as ours.
const MARK: &str = "summary.json";

/// A folder beside the results folder that becomes it when the run is complete.
pub struct Store {
    out: PathBuf,
    partial: PathBuf,
}

impl Store {
    /// Opens the partial folder for results at `out`. With `resume`, finished trials of a run with the same
    /// `fingerprint` are kept; otherwise it starts empty.
    ///
    /// # Errors
    /// [`RunError::Foreign`] when `out` holds something that isn't a results folder, [`RunError::File`] when
    /// the folder can't be made.
    pub fn open(out: &Path, fingerprint: &str, resume: bool) -> Result<Self, RunError> {
        let in_use = fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_some());
        // A path such as `.` or `..` has no name to put a finished folder in the place of.
        let name = out.file_name().filter(|_| !out.is_file() && (!in_use || out.join(MARK).exists()));
        let mut name = name.ok_or_else(|| RunError::Foreign { path: out.to_owned() })?.to_owned();
        name.push(".partial");
        let store = Self { out: out.to_owned(), partial: out.with_file_name(name) };
        let same = fs::read_to_string(store.fingerprint()).is_ok_and(|found| found == fingerprint);
        if store.partial.exists() && !(resume && same) {
            fs::remove_dir_all(&store.partial).map_err(RunError::file(&store.partial))?;
        }
        let trials = store.trials();
        fs::create_dir_all(&trials).map_err(RunError::file(&trials))?;
        fs::write(store.fingerprint(), fingerprint).map_err(RunError::file(store.fingerprint()))?;
        Ok(store)
    }

    /// The folder that results are written to.
    pub fn folder(&self) -> &Path {
        &self.partial
    }

    fn fingerprint(&self) -> PathBuf {
        self.partial.join("fingerprint")
    }

    fn trials(&self) -> PathBuf {
        self.partial.join("unfinished")
    }

    fn trial_file(&self, trial: u32) -> PathBuf {
        self.trials().join(format!("{trial:06}.cbor"))
    }

    /// A finished trial of an earlier run; `None` if there is none or its file is damaged.
    pub fn load(&self, trial: u32) -> Option<Trial> {
        let bytes = fs::read(self.trial_file(trial)).ok()?;
        ciborium::from_reader(bytes.as_slice()).ok()
    }

    /// Keeps a finished trial.
    ///
    /// # Errors
    /// [`RunError::File`] when it can't be written.
    pub fn save(&self, trial: &Trial) -> Result<(), RunError> {
        let path = self.trial_file(trial.trial);
        let mut bytes = Vec::new();
        ciborium::into_writer(trial, &mut bytes)
            .map_err(|error| RunError::file(&path)(std::io::Error::other(error.to_string())))?;
        // Renamed when whole, so that a cut-off file is never taken for a trial.
        let temporary = path.with_extension("tmp");
        fs::write(&temporary, bytes).map_err(RunError::file(&temporary))?;
        fs::rename(&temporary, &path).map_err(RunError::file(&path))
    }

    /// Puts the complete results in the place of earlier ones.
    ///
    /// # Errors
    /// [`RunError::File`]; the earlier results are then still there, beside the new ones.
    pub fn finish(self) -> Result<(), RunError> {
        let trials = self.trials();
        fs::remove_dir_all(&trials).map_err(RunError::file(&trials))?;
        fs::remove_file(self.fingerprint()).map_err(RunError::file(self.fingerprint()))?;
        let mut name = self.out.file_name().unwrap_or_default().to_owned();
        name.push(".old");
        let old = self.out.with_file_name(name);
        if old.exists() {
            fs::remove_dir_all(&old).map_err(RunError::file(&old))?;
        }
        if self.out.exists() {
            fs::rename(&self.out, &old).map_err(RunError::file(&self.out))?;
        }
        fs::rename(&self.partial, &self.out).map_err(RunError::file(&self.out))?;
        if old.exists() {
            fs::remove_dir_all(&old).map_err(RunError::file(&old))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trial(number: u32) -> Trial {
        Trial { trial: number, seed: 7, models: Vec::new() }
    }

    #[test]
    fn finished_trials_survive_an_interruption_of_the_same_scenario_only() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("results");
        Store::open(&out, "a", false).unwrap().save(&trial(3)).unwrap();

        let resumed = Store::open(&out, "a", true).unwrap();
        assert_eq!(resumed.load(3), Some(trial(3)));
        assert_eq!(resumed.load(4), None);

        let other = Store::open(&out, "b", true).unwrap();
        assert_eq!(other.load(3), None, "another scenario's trials must not be taken over");
    }

    #[test]
    fn a_damaged_trial_is_run_again() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&folder.path().join("results"), "a", false).unwrap();
        store.save(&trial(0)).unwrap();
        let whole = fs::read(store.trial_file(0)).unwrap();
        fs::write(store.trial_file(0), &whole[..whole.len() / 2]).unwrap();
        assert_eq!(store.load(0), None);
    }

    #[test]
    fn earlier_results_stay_until_new_ones_are_complete() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("results");
        fs::create_dir(&out).unwrap();
        fs::write(out.join(MARK), "old").unwrap();
        let store = Store::open(&out, "a", false).unwrap();
        fs::write(store.folder().join(MARK), "new").unwrap();
        assert_eq!(fs::read_to_string(out.join(MARK)).unwrap(), "old");
        store.finish().unwrap();
        assert_eq!(fs::read_to_string(out.join(MARK)).unwrap(), "new");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is left beside the results");
    }

    #[test]
    fn a_folder_with_something_else_in_it_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("thesis.tex"), "precious").unwrap();
        assert!(matches!(Store::open(folder.path(), "a", false), Err(RunError::Foreign { .. })));
        assert!(matches!(Store::open(&folder.path().join(".."), "a", false), Err(RunError::Foreign { .. })));
    }
}
