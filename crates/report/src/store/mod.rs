//! Where results are kept, so that an interruption loses one part of the work at most, earlier results stay until new
//! ones are complete, and nothing is deleted that locsim didn't write.
//!
//! Work goes into `OUT.partial` beside the results folder `OUT`:
//!
//! ```text
//! OUT.partial/manifest.json   what this is, and of which scenario
//! OUT.partial/lock            locked by the process that works in it
//! OUT.partial/parts/          finished parts: trials of a run, repeats of a study
//! OUT.partial/results/        becomes OUT when all of it is there; has a manifest.json of its own
//! ```
//!
//! Every folder carries a manifest. What a manifest doesn't list, or lists with another hash, is somebody else's.

mod error;
mod folder;
mod lock;
mod manifest;
mod parts;

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

pub use error::StoreError;
pub use folder::Folder;
pub use lock::Lock;
pub(crate) use manifest::Manifest;
pub use parts::{Part, Parts};

use error::at;
use manifest::{MANIFEST, State};

const LOCK: &str = "lock";
const PARTS: &str = "parts";
const RESULTS: &str = "results";
const PARTIAL: &str = ".partial";

/// How a results folder is opened.
#[derive(Clone, Copy, Debug)]
pub struct Request<'a> {
    /// The results folder.
    pub out: &'a Path,
    /// The command that writes the results: `run`, `study`, `gap`, `sweeps`.
    pub kind: &'a str,
    /// Hash of all that the results depend on. Parts of equal hashes may be taken over.
    pub fingerprint: &'a str,
    /// Whether to go on with interrupted work.
    pub resume: bool,
    /// Whether earlier results, and parts of other work, may be replaced.
    pub force: bool,
}

impl Request<'_> {
    /// Opens a store, lets `work` fill it, and puts the results in their place. After an error the finished parts are kept.
    ///
    /// # Errors
    /// Those of `work`, and as [`Store::open`] and [`Store::finish`].
    pub fn fill<T, E: From<StoreError>>(&self, work: impl FnOnce(&Store) -> Result<T, E>) -> Result<T, E> {
        let store = Store::open(self)?;
        match work(&store) {
            Ok(value) => {
                store.finish()?;
                Ok(value)
            }
            Err(error) => {
                store.discard_if_empty();
                Err(error)
            }
        }
    }
}

/// The folders of one piece of work, locked until it is dropped.
#[derive(Debug)]
pub struct Store {
    places: Places,
    parts: Parts,
    folder: Folder,
    lock: Lock,
}

/// Where everything is.
#[derive(Clone, Debug)]
struct Places {
    /// The results folder.
    out: PathBuf,
    /// `OUT.partial`, the work.
    partial: PathBuf,
    /// `OUT.old`, where earlier results are while new ones take their place.
    old: PathBuf,
}

impl Places {
    fn of(out: &Path) -> Result<Self, StoreError> {
        // A link's target is what is replaced; a folder that isn't there yet has none.
        let out = if out.is_symlink() {
            out.canonicalize().map_err(|error| match error.kind() {
                io::ErrorKind::NotFound => StoreError::DanglingLink { out: out.to_owned() },
                _ => at(out)(error),
            })?
        } else {
            out.to_owned()
        };
        // The folders above are made where they aren't there.
        if let Some(file) = out.ancestors().find(|place| place.exists()).filter(|place| !place.is_dir()) {
            return Err(StoreError::NoFolder { out: file.to_owned() });
        }
        // A path such as `.` or `..` has no name to put a finished folder in the place of.
        let Some(name) = out.file_name().map(ToOwned::to_owned) else {
            return Err(StoreError::NoName { out });
        };
        let [partial, old] = [PARTIAL, ".old"].map(|ending| {
            let mut name = name.clone();
            name.push(ending);
            out.with_file_name(name)
        });
        if fs::symlink_metadata(&partial).is_err_and(|error| error.kind() == io::ErrorKind::InvalidFilename) {
            return Err(StoreError::LongName { out });
        }
        Ok(Self { out, partial, old })
    }

    fn manifest(&self) -> PathBuf {
        self.partial.join(MANIFEST)
    }

    fn parts(&self) -> PathBuf {
        self.partial.join(PARTS)
    }

    fn results(&self) -> PathBuf {
        self.partial.join(RESULTS)
    }

    fn foreign(&self, found: PathBuf) -> StoreError {
        StoreError::Foreign { out: self.out.clone(), found }
    }

    /// The state of an existing results folder, if `--force` may replace it.
    fn earlier(&self) -> Result<State, StoreError> {
        let state = Manifest::state(&self.out)?;
        match state {
            State::Foreign(found) => Err(self.foreign(found)),
            state => Ok(state),
        }
    }

    /// The work that is there: its manifest and the number of its parts. `None` where there is none.
    fn work(&self) -> Result<Option<(Manifest, usize)>, StoreError> {
        if !self.partial.exists() && !self.partial.is_symlink() {
            return Ok(None);
        }
        let known = [MANIFEST, LOCK, PARTS, RESULTS];
        let mut empty = true;
        for entry in fs::read_dir(&self.partial).map_err(|_| self.foreign(self.partial.clone()))? {
            let entry = entry.map_err(at(&self.partial))?;
            let name = entry.file_name();
            let ours = known.iter().any(|known| name == *known) || manifest::is_temporary(&name);
            if !ours {
                return Err(self.foreign(entry.path()));
            }
            empty &= name == LOCK || manifest::is_temporary(&name);
        }
        if empty {
            return Ok(None);
        }
        let manifest = Manifest::read(&self.manifest())?.ok_or_else(|| self.foreign(self.partial.clone()))?;
        if let State::Foreign(found) = Manifest::state(&self.results())? {
            return Err(self.foreign(found));
        }
        let parts = Parts::count(&self.parts())?.map_err(|found| self.foreign(found))?;
        Ok(Some((manifest, parts)))
    }

    /// Puts earlier results back that an interruption left beside their place, and removes what it left of replaced ones.
    fn recover(&self) -> Result<(), StoreError> {
        match Manifest::state(&self.old)? {
            State::Absent => return Ok(()),
            State::Foreign(found) => return Err(self.foreign(found)),
            State::Empty | State::Results(_) => {}
        }
        match Manifest::state(&self.out)? {
            State::Absent => fs::rename(&self.old, &self.out).map_err(at(&self.old)),
            _ => manifest::remove(&self.old),
        }
    }

    /// Removes the work, file by file: all of it was found to be ours.
    fn discard(&self) -> Result<(), StoreError> {
        manifest::remove(&self.results())?;
        Parts::remove(&self.parts())?;
        manifest::remove_temporary(&self.partial)?;
        manifest::remove_file(&self.manifest())
    }
}

impl Store {
    /// Opens the folders for results at `request.out`.
    ///
    /// Nothing is touched before it is known that all of it is ours, and that the user asked for it.
    ///
    /// # Errors
    /// [`StoreError`]: something there isn't ours, wasn't asked to be replaced, or is in use; the system's errors.
    pub fn open(request: &Request<'_>) -> Result<Self, StoreError> {
        let places = Places::of(request.out)?;
        // Of work under way nothing is to be judged by what it has just written.
        Lock::check(&places.partial.join(LOCK), request.out)?;
        allowed(&places, request)?;
        fs::create_dir_all(&places.partial).map_err(at(&places.partial))?;
        let lock = Lock::take(&places.partial.join(LOCK), request.out)?;
        match Self::begin(&places, request) {
            Ok((parts, folder)) => Ok(Self { places, parts, folder, lock }),
            Err(error) => {
                lock.remove()?;
                // Stays where there is something in it.
                let _ = fs::remove_dir(&places.partial);
                Err(error)
            }
        }
    }

    /// The part of [`Store::open`] under the lock.
    fn begin(places: &Places, request: &Request<'_>) -> Result<(Parts, Folder), StoreError> {
        places.recover()?;
        // Again: between the first look and the lock another process may have been at work.
        if !allowed(places, request)? {
            places.discard()?;
        }
        let header = Manifest::new(request.kind, request.fingerprint);
        header.write(&places.manifest())?;
        let parts = Parts::open(places.parts(), request.fingerprint)?;
        // The files of an interrupted report are written again.
        manifest::remove(&places.results())?;
        Ok((parts, Folder::create(&places.results(), header)?))
    }

    /// The folder that results are written to.
    pub fn folder(&self) -> &Folder {
        &self.folder
    }

    /// Finished parts of the work.
    pub fn parts(&self) -> &Parts {
        &self.parts
    }

    /// Removes the work unless a part is kept in it. What can't be removed is left: the work has a failure of its own to
    /// tell.
    pub fn discard_if_empty(self) {
        if matches!(Parts::count(&self.places.parts()), Ok(Ok(0))) {
            let _ = self.close();
        }
    }

    /// Puts the complete results in the place of earlier ones.
    ///
    /// # Errors
    /// [`StoreError`], also where something else has come into the results folder since; the earlier results are then
    /// still there, and the work with them, so that it can be resumed.
    pub fn finish(self) -> Result<(), StoreError> {
        self.folder.complete()?;
        let Places { out, old, .. } = &self.places;
        match self.places.earlier()? {
            State::Absent => {}
            State::Empty => {
                manifest::remove_temporary(out)?;
                fs::remove_dir(out).map_err(at(out))?;
            }
            _ => fs::rename(out, old).map_err(at(out))?,
        }
        let results = self.places.results();
        fs::rename(&results, out).map_err(at(&results))?;
        if old.exists() {
            manifest::remove(old)?;
        }
        self.close()
    }

    /// Removes what is left of the work, the lock last.
    fn close(self) -> Result<(), StoreError> {
        self.places.discard()?;
        self.lock.remove()?;
        fs::remove_dir(&self.places.partial).map_err(at(&self.places.partial))
    }
}

/// Whether the request may be granted, and if so, whether it goes on with work that is there.
fn allowed(places: &Places, request: &Request<'_>) -> Result<bool, StoreError> {
    let Request { kind, fingerprint, resume, force, .. } = *request;
    if let State::Foreign(found) = Manifest::state(&places.old)? {
        return Err(places.foreign(found));
    }
    let work = places.work()?;
    let fits = work.as_ref().is_some_and(|(work, _)| work.kind == kind && work.fingerprint == fingerprint);
    // Results that were in the way of interrupted work were allowed to be replaced when it began.
    let may_replace = force || (resume && fits);
    // A folder that an interruption left beside its place is moved there.
    let earlier = match Manifest::state(&places.out)? {
        State::Absent => Manifest::state(&places.old)?,
        state => state,
    };
    let earlier = match earlier {
        State::Absent | State::Empty => None,
        State::Results(manifest)
            if resume && !force && work.is_none() && manifest.fingerprint == fingerprint =>
        {
            return Err(StoreError::Complete { out: places.out.clone() });
        }
        _ if !may_replace => return Err(StoreError::NotEmpty { out: places.out.clone() }),
        State::Foreign(found) => return Err(places.foreign(found)),
        State::Results(manifest) => Some(manifest),
    };
    let Some((work, parts)) = work else { return Ok(false) };
    if resume && fits {
        return Ok(true);
    }
    // Only its clearing away was interrupted.
    let finished =
        !places.results().exists() && earlier.is_some_and(|earlier| earlier.fingerprint == work.fingerprint);
    if parts > 0 && !finished && !force {
        let partial = places.partial.clone();
        return Err(if resume {
            StoreError::Other { partial, parts }
        } else {
            StoreError::Kept { partial, parts }
        });
    }
    Ok(false)
}

/// The number of finished parts that interrupted work for results at `out` keeps.
///
/// # Errors
/// [`StoreError`] where the folder can't be read.
pub fn kept(out: &Path) -> Result<usize, StoreError> {
    let places = Places::of(out)?;
    Ok(Parts::count(&places.parts())?.unwrap_or(0))
}

#[cfg(test)]
mod tests;
