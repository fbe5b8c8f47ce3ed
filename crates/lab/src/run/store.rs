//! Where a run keeps what it has finished, so that an interruption loses one trial at most and earlier results
//! stay until new ones are complete.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::RunError;
use crate::results::Trial;

/// Names of the files by which a results folder is known as ours: a run leaves the first, a study the second, a search
/// for what a simulation lacks the third.
const MARKS: [&str; 3] = ["summary.json", "results.json", "gap.json"];

/// Name of the file by which a partial folder is known as ours, and that says of which run it is.
const FINGERPRINT: &str = "fingerprint";

/// A folder beside the results folder that becomes it when the run is complete.
pub struct Store {
    out: PathBuf,
    /// `OUT.partial`, the folder.
    partial: PathBuf,
    /// `OUT.old`, where earlier results are while the new ones take their place.
    old: PathBuf,
}

/// Whether a folder may be replaced: there is none, it is empty, or it holds a file by which it is known as ours.
fn is_ours(folder: &Path, marks: &[&str]) -> bool {
    match fs::read_dir(folder) {
        Ok(mut entries) => entries.next().is_none() || marks.iter().any(|mark| folder.join(mark).is_file()),
        Err(error) => error.kind() == ErrorKind::NotFound,
    }
}

impl Store {
    /// Opens the partial folder for results at `out`. With `resume`, finished trials of a run with the same
    /// `fingerprint` are kept; otherwise it starts empty. Earlier results that an interruption left beside `out` are
    /// put back there.
    ///
    /// # Errors
    /// [`RunError::Foreign`] when `out`, or a folder that is needed beside it, holds something that isn't ours,
    /// [`RunError::File`] when the folder can't be made.
    pub fn open(out: &Path, fingerprint: &str, resume: bool) -> Result<Self, RunError> {
        let foreign = |found: &Path| RunError::Foreign { out: out.to_owned(), found: found.to_owned() };
        // A path such as `.` or `..` has no name to put a finished folder in the place of.
        let name = out.file_name().ok_or_else(|| foreign(out))?;
        let [partial, old] = [".partial", ".old"].map(|ending| {
            let mut name = name.to_owned();
            name.push(ending);
            out.with_file_name(name)
        });
        for (folder, marks) in [(out, &MARKS[..]), (&partial, &[FINGERPRINT]), (&old, &MARKS)] {
            if !is_ours(folder, marks) {
                return Err(foreign(folder));
            }
        }
        if !out.exists() && old.exists() {
            fs::rename(&old, out).map_err(RunError::file(&old))?;
        }
        let store = Self { out: out.to_owned(), partial, old };
        let same = fs::read_to_string(store.fingerprint()).is_ok_and(|found| found == fingerprint);
        if store.partial.exists() && !(resume && same) {
            fs::remove_dir_all(&store.partial).map_err(RunError::file(&store.partial))?;
        }
        fs::create_dir_all(&store.partial).map_err(RunError::file(&store.partial))?;
        // First of all, or after an interruption the folder wouldn't be known as ours.
        fs::write(store.fingerprint(), fingerprint).map_err(RunError::file(store.fingerprint()))?;
        let trials = store.trials();
        fs::create_dir_all(&trials).map_err(RunError::file(&trials))?;
        Ok(store)
    }

    /// The folder that results are written to.
    pub fn folder(&self) -> &Path {
        &self.partial
    }

    fn fingerprint(&self) -> PathBuf {
        self.partial.join(FINGERPRINT)
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

    /// Removes the partial folder unless a trial is kept in it. What can't be removed is left: the run has a failure
    /// of its own to tell.
    pub fn discard_if_empty(&self) {
        if fs::read_dir(self.trials()).is_ok_and(|mut entries| entries.next().is_none()) {
            let _ = fs::remove_dir_all(&self.partial);
        }
    }

    /// Puts the complete results in the place of earlier ones.
    ///
    /// # Errors
    /// [`RunError::File`]; the earlier results are then still there, beside the new ones.
    pub fn finish(self) -> Result<(), RunError> {
        let trials = self.trials();
        fs::remove_dir_all(&trials).map_err(RunError::file(&trials))?;
        if self.old.exists() {
            fs::remove_dir_all(&self.old).map_err(RunError::file(&self.old))?;
        }
        if self.out.exists() {
            fs::rename(&self.out, &self.old).map_err(RunError::file(&self.out))?;
        }
        fs::rename(&self.partial, &self.out).map_err(RunError::file(&self.out))?;
        let fingerprint = self.out.join(FINGERPRINT);
        fs::remove_file(&fingerprint).map_err(RunError::file(&fingerprint))?;
        if self.old.exists() {
            fs::remove_dir_all(&self.old).map_err(RunError::file(&self.old))?;
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
        fs::write(out.join(MARKS[0]), "old").unwrap();
        let store = Store::open(&out, "a", false).unwrap();
        fs::write(store.folder().join(MARKS[0]), "new").unwrap();
        assert_eq!(fs::read_to_string(out.join(MARKS[0])).unwrap(), "old");
        store.finish().unwrap();
        assert_eq!(fs::read_to_string(out.join(MARKS[0])).unwrap(), "new");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is left beside the results");
    }

    #[test]
    fn earlier_results_that_an_interruption_left_beside_their_place_are_put_back() {
        let folder = tempfile::tempdir().unwrap();
        let (out, old) = (folder.path().join("results"), folder.path().join("results.old"));
        fs::create_dir(&old).unwrap();
        fs::write(old.join(MARKS[0]), "old").unwrap();
        Store::open(&out, "a", false).unwrap();
        assert_eq!(fs::read_to_string(out.join(MARKS[0])).unwrap(), "old");
        assert!(!old.exists());
    }

    #[test]
    fn a_folder_of_someone_else_beside_the_results_is_refused_and_left() {
        for name in ["results.partial", "results.old"] {
            let folder = tempfile::tempdir().unwrap();
            let (out, beside) = (folder.path().join("results"), folder.path().join(name));
            fs::create_dir(&beside).unwrap();
            fs::write(beside.join("thesis.tex"), "precious").unwrap();
            let refused = Store::open(&out, "a", false).err();
            assert!(
                matches!(&refused, Some(RunError::Foreign { found, .. }) if *found == beside),
                "{refused:?}"
            );
            assert_eq!(fs::read_to_string(beside.join("thesis.tex")).unwrap(), "precious");
            assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);

            fs::remove_file(beside.join("thesis.tex")).unwrap();
            let store = Store::open(&out, "a", false).unwrap();
            store.finish().unwrap();
            assert!(out.exists() && !beside.exists(), "an empty folder is nobody's");
        }
    }

    #[test]
    fn a_run_that_kept_no_trial_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&folder.path().join("results"), "a", false).unwrap();
        store.discard_if_empty();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);

        let store = Store::open(&folder.path().join("results"), "a", false).unwrap();
        store.save(&trial(0)).unwrap();
        store.discard_if_empty();
        assert_eq!(store.load(0), Some(trial(0)));
    }

    #[test]
    fn a_folder_with_something_else_in_it_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("thesis.tex"), "precious").unwrap();
        assert!(matches!(Store::open(folder.path(), "a", false), Err(RunError::Foreign { .. })));
        assert!(matches!(Store::open(&folder.path().join(".."), "a", false), Err(RunError::Foreign { .. })));
    }
}
