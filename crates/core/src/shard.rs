//! Shares of long work, each run on its own.

use std::fmt;
use std::ops::Range;

use serde::{Deserialize, Serialize};

/// The most shards: each is a folder, and a file system has its limits, too.
pub const MOST_SHARDS: u32 = 100_000;

/// One of equal parts of the cells of a sweep, the trials of a run, the logs of a suite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Shard {
    /// Number of shards.
    pub of: u32,
    /// Which one, from 1.
    pub number: u32,
}

impl Shard {
    /// Its parts of the work, of so many: neighbours, so that the merge appends one shard after another.
    pub fn range(self, count: u32) -> Range<u32> {
        let end = |number: u32| (u64::from(number) * u64::from(count) / u64::from(self.of)) as u32;
        end(self.number - 1)..end(self.number)
    }

    /// Name of its folder.
    pub fn folder(self) -> String {
        format!("shard-{:05}-of-{:05}", self.number, self.of)
    }

    /// The shard of a folder's name.
    pub fn of_folder(name: &str) -> Option<Self> {
        let (number, of) = name.strip_prefix("shard-")?.split_once("-of-")?;
        Self::new(number.parse().ok()?, of.parse().ok()?).ok()
    }

    /// Reads `I/N`.
    ///
    /// # Errors
    /// A sentence that says what is allowed.
    pub fn parse(text: &str) -> Result<Self, String> {
        let numbers = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        let (number, of) = numbers.ok_or("I/N is allowed, such as 3/50: shard 3 of 50")?;
        Self::new(number, of)
    }

    /// Shard `number` of `of`.
    ///
    /// # Errors
    /// A sentence that says what is allowed.
    pub fn new(number: u32, of: u32) -> Result<Self, String> {
        if of > MOST_SHARDS {
            Err(format!("{of} shards are not allowed; at most {MOST_SHARDS}"))
        } else if (1..=of).contains(&number) {
            Ok(Self { of, number })
        } else {
            Err(format!("shard {number} of {of} is not there; shards are numbered from 1 to their number"))
        }
    }

    /// The shard that a batch engine asks for: a task's number in `SLURM_ARRAY_TASK_ID`, `HQ_TASK_ID` or `PARALLEL_SEQ`, among
    /// `shards`. Slurm tells the number of tasks as well, the others don't. `None` outside of an engine.
    ///
    /// # Errors
    /// A sentence that says what is not allowed, and what is.
    pub fn from_environment(
        environment: &dyn Fn(&str) -> Option<String>,
        shards: Option<u32>,
    ) -> Result<Option<Self>, String> {
        let number = |name: &str| match environment(name).map(|text| (text.parse::<u32>(), text)) {
            None => Ok(None),
            Some((Ok(number), _)) => Ok(Some(number)),
            Some((Err(_), text)) => Err(format!("{name}: `{text}` is not a whole number")),
        };
        if let Some(of) = shards {
            for name in TASK_NUMBERS {
                if let Some(number) = number(name)? {
                    return Self::new(number, of).map(Some).map_err(|error| format!("{name}: {error}"));
                }
            }
            return Err(format!("--shards: no task number in the environment ({})", TASK_NUMBERS.join(", ")));
        }
        let [id, count, min, max] =
            ["ID", "COUNT", "MIN", "MAX"].map(|name| number(&format!("SLURM_ARRAY_TASK_{name}")));
        let (Some(id), Some(count), Some(min), Some(max)) = (id?, count?, min?, max?) else {
            return Ok(None);
        };
        if max.checked_sub(min).is_none_or(|span| span.checked_add(1) != Some(count))
            || !(min..=max).contains(&id)
        {
            return Err(format!(
                "the Slurm array has {count} tasks from {min} to {max}, which doesn't say how many shards there are; \
                 add --shards N"
            ));
        }
        Self::new(id - min + 1, count).map(Some)
    }
}

/// Where engines tell a task its number.
pub const TASK_NUMBERS: [&str; 3] = ["SLURM_ARRAY_TASK_ID", "HQ_TASK_ID", "PARALLEL_SEQ"];

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "shard {} of {}", self.number, self.of)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_cover_every_part_once_and_differ_by_one_at_most() {
        for (count, of) in [(1, 1), (10, 3), (2000, 200), (7, 7), (1_000_000_007, 1000)] {
            let shards = (1..=of).map(|number| Shard { of, number }.range(count));
            let mut next = 0;
            for parts in shards {
                assert_eq!(parts.start, next);
                assert!((count / of..=count.div_ceil(of)).contains(&(parts.end - parts.start)));
                next = parts.end;
            }
            assert_eq!(next, count);
        }
    }

    #[test]
    fn a_shard_is_named_by_the_user_or_by_the_engine() {
        assert_eq!(Shard::parse("3/50"), Ok(Shard { number: 3, of: 50 }));
        for text in ["0/5", "6/5", "3", "a/b", "-1/5", "1/0"] {
            assert!(Shard::parse(text).is_err(), "{text}");
        }
        let shard = |variables: &[(&str, &str)], shards: Option<u32>| {
            let get = |name: &str| variables.iter().find(|v| v.0 == name).map(|v| v.1.to_owned());
            Shard::from_environment(&get, shards)
        };
        let slurm = |id, count, min, max| {
            [
                ("SLURM_ARRAY_TASK_ID", id),
                ("SLURM_ARRAY_TASK_COUNT", count),
                ("SLURM_ARRAY_TASK_MIN", min),
                ("SLURM_ARRAY_TASK_MAX", max),
            ]
        };
        assert_eq!(shard(&[], None), Ok(None));
        assert_eq!(shard(&slurm("4", "5", "0", "4"), None), Ok(Some(Shard { number: 5, of: 5 })));
        // Tasks 3 and 7 alone, run again.
        assert!(shard(&slurm("7", "2", "3", "7"), None).unwrap_err().contains("add --shards N"));
        assert_eq!(shard(&slurm("7", "2", "3", "7"), Some(9)), Ok(Some(Shard { number: 7, of: 9 })));
        assert_eq!(shard(&[("HQ_TASK_ID", "2")], Some(9)), Ok(Some(Shard { number: 2, of: 9 })));
        assert_eq!(shard(&[("PARALLEL_SEQ", "9")], Some(9)), Ok(Some(Shard { number: 9, of: 9 })));
        // HyperQueue and GNU parallel don't say how many there are.
        assert_eq!(shard(&[("HQ_TASK_ID", "2"), ("PARALLEL_SEQ", "2")], None), Ok(None));
        assert!(
            shard(&[("PARALLEL_SEQ", "10")], Some(9)).unwrap_err().contains("PARALLEL_SEQ: shard 10 of 9")
        );
        assert!(shard(&[], Some(9)).unwrap_err().contains("no task number"));
        assert!(shard(&[("HQ_TASK_ID", "x")], Some(9)).unwrap_err().contains("`x` is not a whole number"));
    }
}
