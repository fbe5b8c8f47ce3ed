//! Checks of single values, which remember every problem.

use std::fmt;
use std::path::{Path, PathBuf};

pub use locsim_core::limits::number;
use locsim_core::limits::{LEAST_RANGE_M, QUOTED_CHARACTERS, RANGE_M, quoted};
use locsim_dataset::log_files;

use super::error::{LISTED, and_more, shown};
use super::key_path::join;
use super::{Problem, ScenarioError};
use crate::yaml::Locations;

/// Looks up an environment variable; `None` where it isn't set.
pub type Environment<'a> = &'a dyn Fn(&str) -> Option<String>;

/// Checks values one after another and remembers every problem, so that a person mends a file in one go.
pub struct Checker<'a> {
    file: &'a Path,
    locations: &'a Locations,
    environment: Environment<'a>,
    /// The first ones.
    problems: Vec<Problem>,
    /// How many others there are.
    more: usize,
}

/// Which numbers are allowed; NaN and infinities never are.
#[derive(Clone, Copy, Debug)]
pub enum Allowed {
    /// Every number.
    Any,
    /// From the first to the second.
    Within(f64, f64),
    /// 0, or from the first to the second.
    ZeroOrWithin(f64, f64),
    /// More than the first, up to the second.
    AboveUpTo(f64, f64),
    /// From the first, less than the second.
    FromBelow(f64, f64),
    /// Strictly between.
    Between(f64, f64),
}

/// Intervals of a log's scans; they are held against each other.
const MOST_SHARES: usize = 1000;

/// A coordinate (m): nothing computed from it overflows.
pub const COORDINATE: Allowed = Allowed::Within(-1e6, 1e6);
/// A length that may be 0 (m).
pub const LENGTH: Allowed = Allowed::Within(0.0, 1e4);
/// A length that something is divided by (m).
pub const POSITIVE_LENGTH: Allowed = Allowed::Within(1e-3, 1e4);
/// A part of the robot's place on it (m).
pub const OFFSET: Allowed = Allowed::Within(-1e4, 1e4);
/// A maximum range (m).
pub const MAX_RANGE: Allowed = Allowed::Within(LEAST_RANGE_M, RANGE_M);
/// A step between values; 0 for none (m).
pub const STEP: Allowed = Allowed::ZeroOrWithin(1e-6, 1e4);
/// A standard deviation (m or deg), or another parameter of noise, that nothing is divided by.
pub const NOISE: Allowed = Allowed::Within(0.0, 1e3);
/// An angle, any number of turns (deg).
pub const ANGLE: Allowed = Allowed::Within(-1e6, 1e6);

impl Allowed {
    fn contains(self, value: f64) -> bool {
        value.is_finite()
            && match self {
                Self::Any => true,
                Self::Within(lo, hi) => (lo..=hi).contains(&value),
                Self::ZeroOrWithin(lo, hi) => value == 0.0 || (lo..=hi).contains(&value),
                Self::AboveUpTo(lo, hi) => value > lo && value <= hi,
                Self::FromBelow(lo, hi) => (lo..hi).contains(&value),
                Self::Between(lo, hi) => value > lo && value < hi,
            }
    }
}

impl fmt::Display for Allowed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Any => f.write_str("a finite number"),
            Self::Within(lo, hi) => write!(f, "a number from {} to {}", number(*lo), number(*hi)),
            Self::ZeroOrWithin(lo, hi) => write!(f, "0, or a number from {} to {}", number(*lo), number(*hi)),
            Self::AboveUpTo(lo, hi) => write!(f, "a number above {lo}, up to {hi}"),
            Self::FromBelow(lo, hi) => write!(f, "a number from {lo}, below {hi}"),
            Self::Between(lo, hi) => write!(f, "a number above {lo}, below {hi}"),
        }
    }
}

impl<'a> Checker<'a> {
    /// A check of the file at `file`, whose keys stand at `locations`.
    pub fn new(file: &'a Path, locations: &'a Locations, environment: Environment<'a>) -> Self {
        Self { file, locations, environment, problems: Vec::new(), more: 0 }
    }

    /// Remembers a problem with the value at `key`.
    pub fn problem(&mut self, key: &str, message: impl Into<String>) {
        self.refuse(true, key, || message.into());
    }

    /// Remembers a problem where `wrong`.
    pub fn refuse(&mut self, wrong: bool, key: &str, message: impl FnOnce() -> String) {
        if !wrong {
        } else if self.problems.len() < LISTED {
            let line = self.locations.line(key);
            self.problems.push(Problem { line, key: key.to_owned(), message: message() });
        } else {
            self.more += 1;
        }
    }

    /// No problem so far.
    pub fn is_clean(&self) -> bool {
        self.problems.is_empty()
    }

    /// The problems as an error, in the order of the file.
    pub fn into_error(mut self) -> ScenarioError {
        self.problems.sort_by_key(|problem| problem.line);
        self.problems.extend(and_more(self.more));
        ScenarioError::Invalid { file: self.file.to_owned(), problems: self.problems }
    }

    /// A number in range.
    pub fn number(&mut self, key: &str, value: f64, allowed: Allowed) -> f64 {
        self.refuse(!allowed.contains(value), key, || format!("{} is not allowed; {allowed}", number(value)));
        value
    }

    /// A number in range, in degrees; returns radians.
    pub fn degrees(&mut self, key: &str, value: f64, allowed: Allowed) -> f64 {
        self.number(key, value, allowed).to_radians()
    }

    /// A list of numbers in range.
    pub fn numbers(&mut self, key: &str, values: &[f64], allowed: Allowed) {
        for (i, value) in values.iter().enumerate() {
            self.number(&format!("{key}[{i}]"), *value, allowed);
        }
    }

    /// An interval `[lo, hi]` of numbers in range, lo <= hi.
    pub fn interval(&mut self, key: &str, [lo, hi]: [f64; 2], allowed: Allowed) -> [f64; 2] {
        self.numbers(key, &[lo, hi], allowed);
        self.refuse(lo > hi, key, || {
            let [lo, hi] = [lo, hi].map(number);
            format!("[{lo}, {hi}] is not allowed; [lo, hi] with lo not above hi")
        });
        [lo, hi]
    }

    /// A whole number in range.
    pub fn count(&mut self, key: &str, value: u64, lo: u32, hi: u32) -> u32 {
        let range = u64::from(lo)..=u64::from(hi);
        self.refuse(!range.contains(&value), key, || {
            format!("{value} is not allowed; a whole number from {lo} to {hi}")
        });
        value.min(u64::from(u32::MAX)) as u32
    }

    /// A list that isn't longer than `most`.
    pub fn length<T>(&mut self, key: &str, list: &[T], most: usize) {
        let found = list.len();
        self.refuse(found > most, key, || format!("a list of length {found} is not allowed; at most {most}"));
    }

    /// Intervals `[from, to)` of a log: at least one, each with 0 <= from < to <= 1, in order.
    pub fn shares(&mut self, key: &str, shares: &[[f64; 2]]) -> Vec<[f64; 2]> {
        self.refuse(shares.is_empty(), key, || {
            "an empty list is not allowed; at least one interval [from, to]".to_owned()
        });
        self.length(key, shares, MOST_SHARES);
        let mut end = 0.0;
        for (i, [from, to]) in shares.iter().enumerate() {
            let legal = *from >= end && from < to && *to <= 1.0;
            self.refuse(!legal, &format!("{key}[{i}]"), || {
                let [from, to] = [*from, *to].map(number);
                format!(
                    "[{from}, {to}] is not allowed; [from, to] with 0 <= from < to <= 1, not before the end of \
                     the interval before it"
                )
            });
            end = *to;
        }
        shares.to_vec()
    }

    /// An existing file: `${VARIABLE}` is replaced, a relative path starts at the scenario's folder.
    pub fn file(&mut self, key: &str, text: &str) -> PathBuf {
        let Some(path) = self.path(key, text) else { return PathBuf::new() };
        self.is_file(key, text, &path);
        path
    }

    /// The path of a log that must exist: a file, or the folder of a bag.
    pub fn log(&mut self, key: &str, text: &str) -> PathBuf {
        let Some(path) = self.path(key, text) else { return PathBuf::new() };
        if !path.is_dir() {
            self.is_file(key, text, &path);
        } else if let Err(error) = log_files(&path) {
            self.problem(key, format!("`{}` is not allowed; {error}", quoted(text)));
        }
        path
    }

    fn is_file(&mut self, key: &str, text: &str, path: &Path) {
        self.refuse(!path.is_file(), key, || {
            let looked_up =
                if text.chars().count() > QUOTED_CHARACTERS { "of this name".into() } else { shown(path) };
            if path.exists() {
                return format!("`{}` is not allowed; {looked_up} isn't a regular file", quoted(text));
            }
            format!("`{}` is not allowed; there is no file {looked_up}", quoted(text))
        });
    }

    /// A path with its variables replaced, relative to the file that names it; to the current folder where it begins with a
    /// variable, as whoever sets that means it.
    fn path(&mut self, key: &str, text: &str) -> Option<PathBuf> {
        match expand(text, self.environment) {
            Ok(expanded) if text.starts_with("${") => Some(PathBuf::from(expanded)),
            Ok(expanded) => Some(self.file.parent().unwrap_or(Path::new("")).join(&expanded)),
            Err(message) => {
                self.problem(key, format!("`{}` is not allowed; {message}", quoted(text)));
                None
            }
        }
    }

    /// A key that goes only with another choice.
    pub fn absent<T>(&mut self, parent: &str, key: &str, value: Option<&T>, why: &str) {
        self.refuse(value.is_some(), &join(parent, key), || format!("the key is not allowed here; {why}"));
    }
}

/// Replaces each `${NAME}` by the environment variable of that name.
fn expand(text: &str, environment: Environment<'_>) -> Result<String, String> {
    let mut expanded = String::new();
    let mut rest = text;
    while let Some((before, after)) = rest.split_once("${") {
        let (name, after) = after.split_once('}').ok_or("`${` has no `}`")?;
        if name.is_empty() {
            return Err("`${}` names no environment variable".to_owned());
        }
        let value = environment(name).ok_or_else(|| {
            let name = quoted(name);
            format!("the environment variable {name} is not set (export {name}=...)")
        })?;
        expanded.push_str(before);
        expanded.push_str(&value);
        rest = after;
    }
    expanded.push_str(rest);
    Ok(expanded)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_variable_of_a_path_is_expanded_and_what_it_holds_is_not() {
        let environment = |name: &str| match name {
            "A" => Some("${B}".to_owned()),
            "B" => Some("b".to_owned()),
            _ => None,
        };
        assert_eq!(expand("x/${A}-${B}/$B", &environment).unwrap(), "x/${B}-b/$B");
        assert_eq!(expand("plain", &environment).unwrap(), "plain");
        assert!(expand("${C}", &environment).unwrap_err().contains("variable C is not set"));
        assert!(expand("${}", &environment).unwrap_err().contains("names no environment variable"));
        assert!(expand("${A", &environment).unwrap_err().contains("no `}`"));
    }
}
