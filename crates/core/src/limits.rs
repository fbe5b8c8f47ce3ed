//! Limits on the cost of inputs. Every limit of locsim is here; `docs/LIMITS.md` lists them for users.
//!
//! A reader asks for its limit with [`Limits::current`] before it allocates, and refuses larger inputs with
//! [`Limits::refusal`], which names the option that raises the limit.

use std::fmt::{Display, LowerExp};
use std::str::FromStr;
use std::sync::OnceLock;

use thiserror::Error;

/// Collections of a YAML file may be nested this deep.
pub const YAML_DEPTH: usize = 64;

/// A log may always unpack to this many times its own size: scans as text shrink to a quarter or an eighth.
pub const UNPACKING_FACTOR: u64 = 20;

/// A scan's poses and times take as much memory as this many readings, which each scan of a log counts in addition.
pub const READINGS_PER_SCAN: u64 = 100;

/// No coordinate (m), angle (rad) or duration (s) that is read is larger; nothing on Earth needs more.
pub const COORDINATE: f64 = 1e9;

/// No laser reaches farther (m): tables over readings take memory for each millimetre.
pub const RANGE_M: f64 = 1e4;

/// The maximum range of a laser, at the least (m).
pub const LEAST_RANGE_M: f64 = 1e-3;

/// No time (s) that is read is larger: beyond it neighbouring times are too far apart.
pub const STAMP_SECS: f64 = 1e12;

/// The most particles of a filter.
pub const MOST_PARTICLES: u32 = 10_000_000;

/// The most trials of a run, and of each cell of a sweep.
pub const MOST_TRIALS: u32 = 1_000_000;

/// The most scans of a simulated drive.
pub const MOST_SCANS: u32 = 1_000_000;

/// The most repeats of a study.
pub const MOST_REPEATS: u32 = 100_000;

/// Maximum number of worker threads for each core of the machine.
pub const THREADS_PER_CORE: usize = 4;

/// Maximum number of characters of a value that an error quotes.
pub const QUOTED_CHARACTERS: usize = 80;

/// One row of [`Limits::TABLE`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limit {
    /// The name that `--limit NAME=VALUE` takes.
    pub name: &'static str,
    /// The value without that option.
    pub default: u64,
    /// The unit that is counted.
    pub what: &'static str,
}

macro_rules! limits {
    ($($(#[doc = $doc:literal])+ $name:ident = $default:expr, $what:literal;)+) => {
        /// Limits on inputs, which the command line can change: `--limit NAME=VALUE`.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub struct Limits {
            $($(#[doc = $doc])+ pub $name: u64,)+
        }

        impl Limits {
            /// The limits unless [`Limits::set`] was called.
            pub const DEFAULT: Self = Self { $($name: $default,)+ };

            /// Name, default and meaning of each limit.
            pub const TABLE: &'static [Limit] =
                &[$(Limit { name: stringify!($name), default: $default, what: $what },)+];

            fn slot(&mut self, name: &str) -> Option<&mut u64> {
                match name {
                    $(stringify!($name) => Some(&mut self.$name),)+
                    _ => None,
                }
            }
        }
    };
}

limits! {
    /// Bytes of a YAML file: a scenario, a study, a map. Its parser may need some 200 times as many.
    yaml_bytes = 2 << 20, "bytes of a YAML file and of what its aliases repeat";
    /// Keys and values in a YAML file, those that aliases repeat counted each time.
    yaml_values = 500_000, "keys and values of a YAML file and of what its aliases repeat";
    /// Pixels of a map's image, by its header before the pixels are read.
    map_pixels = 1 << 26, "pixels of a map's image";
    /// Wall segments of a map.
    map_segments = 500_000, "wall segments of a map";
    /// Corners of a vector map's outline and obstacles together, which decide what is free space.
    map_corners = 20_000, "corners of a vector map's outline and obstacles";
    /// Cells of a grid over a map, such as that of the distances to its walls.
    grid_cells = 100_000_000, "cells of a grid over a map";
    /// Bytes that a small compressed log may unpack to; a larger one may unpack to [`UNPACKING_FACTOR`] times its size.
    log_unpacked_bytes = 1 << 29, "bytes that a compressed log unpacks to";
    /// Readings of a log, all scans together, and [`READINGS_PER_SCAN`] for each scan; each takes 4 bytes.
    log_readings = 1 << 27, "range readings of a log (100 more for each scan)";
    /// Lines of a text log, and messages of a bag that are read; each takes up to 40 bytes.
    log_messages = 1 << 23, "lines of a text log or messages read from a bag";
    /// Blocks around the robot in all scans of a simulated drive together; each takes 80 bytes.
    drive_blocks = 5_000_000, "unmapped blocks in all scans of a simulated drive";
    /// Bytes of a file of a fitted sensor model.
    model_bytes = 1 << 26, "bytes of a sensor model's file";
    /// Bytes of a table of comma-separated values.
    table_bytes = 1 << 25, "bytes of a table of comma-separated values";
    /// Bytes of the folder in which range tables are kept; the ones not used for longest go first.
    cache_bytes = 1 << 30, "bytes of the cache of range tables";
    /// Bytes of memory that a run may need by its estimate; 0 for what the machine has.
    memory_bytes = 0, "bytes of memory that a run may need by its estimate, 0 for what the machine has";
}

static CURRENT: OnceLock<Limits> = OnceLock::new();

/// A `--limit` that isn't understood.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum LimitError {
    /// It isn't `NAME=VALUE` with a whole number.
    #[error("--limit: `{0}` is not allowed; NAME=VALUE with a whole number, such as map_pixels=400000000")]
    Form(String),
    /// There is no such limit.
    #[error("--limit: `{name}` is not a limit; allowed: {}", names())]
    Name {
        /// The name given.
        name: String,
    },
}

fn names() -> String {
    Limits::TABLE.iter().map(|limit| limit.name).collect::<Vec<_>>().join(", ")
}

impl Limits {
    /// The limits of this process.
    pub fn current() -> &'static Self {
        CURRENT.get().unwrap_or(&Self::DEFAULT)
    }

    /// Makes these the limits of this process. Only the first call has an effect; it belongs at a program's start.
    pub fn set(self) {
        // A second call changes nothing, so that no reader sees two limits.
        let _ = CURRENT.set(self);
    }

    /// These limits with the changes of a list of `NAME=VALUE`.
    ///
    /// # Errors
    /// [`LimitError`] for a name that is no limit and a value that is no whole number.
    pub fn with<'a>(mut self, changes: impl IntoIterator<Item = &'a str>) -> Result<Self, LimitError> {
        for change in changes {
            let form = || LimitError::Form(quoted(change));
            let (name, value) = change.split_once('=').ok_or_else(form)?;
            let value = u64::from_str(value).map_err(|_| form())?;
            *self.slot(name).ok_or_else(|| LimitError::Name { name: quoted(name) })? = value;
        }
        Ok(self)
    }

    /// The error text for an input above a limit: "found; at most N, `--limit NAME=VALUE` raises it".
    ///
    /// # Panics
    /// There is no limit of this name.
    pub fn refusal(&self, name: &str, found: u64) -> String {
        let limit = *self.clone().slot(name).expect("a name of the table");
        let what = Self::TABLE.iter().find(|row| row.name == name).map_or("", |row| row.what);
        format!("{found} {what} are not allowed; at most {limit} (`--limit {name}={found}` raises it)")
    }

    /// [`Limits::refusal`] where reading stops at the limit, so that the number of items is unknown.
    ///
    /// # Panics
    /// There is no limit of this name.
    pub fn refusal_above(name: &str, allowed: u64) -> String {
        let limit = Self::TABLE.iter().find(|row| row.name == name).expect("a name of the table");
        let (what, more) = (limit.what, allowed.saturating_mul(2));
        format!("more than {allowed} {what} are not allowed (`--limit {name}={more}` allows twice as many)")
    }
}

/// Whether a character is invisible but changes how others are read: control characters, line ends, and marks of
/// direction and byte order.
pub fn is_hidden(character: char) -> bool {
    let lines_and_directions = matches!(character, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    character.is_control()
        || lines_and_directions
        || matches!(character, '\u{feff}' | '\u{fffe}' | '\u{ffff}')
}

/// The first `most` characters of a text, hidden ones by their numbers.
pub fn visible(text: &str, most: usize) -> String {
    let mut visible = String::new();
    for character in text.chars().take(most) {
        if is_hidden(character) {
            visible.extend(character.escape_default());
        } else {
            visible.push(character);
        }
    }
    visible
}

/// A value as an error quotes it: hidden characters escaped, cut after [`QUOTED_CHARACTERS`].
pub fn quoted(value: &str) -> String {
    let mut quoted = visible(value, QUOTED_CHARACTERS);
    if value.chars().nth(QUOTED_CHARACTERS).is_some() {
        quoted.push_str("..");
    }
    quoted
}

/// A number as people write it, and as an error quotes it: very large and very small ones with an exponent.
pub fn number<N: Copy + Into<f64> + Display + LowerExp>(value: N) -> String {
    let size = value.into().abs();
    if size == 0.0 || (1e-6..1e15).contains(&size) { format!("{value}") } else { format!("{value:e}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_is_changed_by_its_name() {
        let limits = Limits::DEFAULT.with(["map_pixels=7", "log_readings=9"]).unwrap();
        assert_eq!((limits.map_pixels, limits.log_readings), (7, 9));
        assert_eq!(limits.yaml_bytes, Limits::DEFAULT.yaml_bytes);
        assert_eq!(
            limits.refusal("map_pixels", 8),
            "8 pixels of a map's image are not allowed; at most 7 (`--limit map_pixels=8` raises it)"
        );
        assert_eq!(
            Limits::refusal_above("map_pixels", 7),
            "more than 7 pixels of a map's image are not allowed (`--limit map_pixels=14` allows twice as many)"
        );
    }

    #[test]
    fn what_is_no_limit_is_refused() {
        for form in ["map_pixels", "map_pixels=", "map_pixels=-1", "map_pixels=1e9"] {
            assert_eq!(Limits::DEFAULT.with([form]), Err(LimitError::Form(form.to_owned())));
        }
        let error = Limits::DEFAULT.with(["pixels=1"]).unwrap_err().to_string();
        assert!(error.contains("`pixels`") && error.contains("map_pixels, "), "{error}");
    }

    #[test]
    fn a_quoted_number_is_short() {
        for (value, quoted) in [
            (0.0, "0"),
            (-2.5, "-2.5"),
            (0.000_001, "0.000001"),
            (1.5e-7, "1.5e-7"),
            (-1e300, "-1e300"),
            (f64::NAN, "NaN"),
            (f64::INFINITY, "inf"),
        ] {
            assert_eq!(number(value), quoted);
        }
        assert_eq!([number(0.1_f32), number(f32::MAX)], ["0.1", "3.4028235e38"]);
    }

    #[test]
    fn a_quoted_value_is_short_and_on_one_line() {
        assert_eq!(quoted("a\nb\u{1b}\u{202e}\u{85}"), "a\\nb\\u{1b}\\u{202e}\\u{85}");
        assert_eq!(quoted(&"x".repeat(81)), format!("{}..", "x".repeat(80)));
    }
}
