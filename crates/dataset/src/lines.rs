use std::borrow::Cow;
use std::io::{BufRead, Read};
use std::path::Path;
use std::str::{FromStr, SplitAsciiWhitespace};

use locsim_core::Pose2;
use locsim_core::limits::{COORDINATE, Limits, STAMP_SECS, quoted};

use crate::DatasetError;

/// Maximum length of a line in bytes. A scan of 1000 beams takes about 10 kB.
const LONGEST_LINE: usize = 1 << 20;

/// Reads a text file line by line into one buffer.
pub struct Lines<'a, R> {
    path: &'a Path,
    /// Maximum number of lines.
    allowed: u64,
    reader: R,
    number: usize,
    buffer: Vec<u8>,
    /// The file ended inside line `number`.
    is_cut_off: bool,
}

impl<'a, R: BufRead> Lines<'a, R> {
    pub fn new(path: &'a Path, reader: R, limits: &Limits) -> Self {
        Self { path, allowed: limits.log_messages, reader, number: 0, buffer: Vec::new(), is_cut_off: false }
    }

    /// The next line that isn't blank; `None` at the end. A last line without a newline is left out, because its last number
    /// may be cut: see [`Lines::cut_off`].
    pub fn next(&mut self) -> Result<Option<Line<'_>>, DatasetError> {
        loop {
            self.number += 1;
            self.buffer.clear();
            self.reader.by_ref().take(LONGEST_LINE as u64).read_until(b'\n', &mut self.buffer).map_err(
                |source| DatasetError::Read { path: self.path.to_owned(), line: self.number, source },
            )?;
            if self.buffer.is_empty() {
                return Ok(None);
            }
            if self.number as u64 > self.allowed {
                let reason = Limits::refusal_above("log_messages", self.allowed);
                return Err(DatasetError::Refused {
                    path: self.path.to_owned(),
                    line: Some(self.number),
                    reason,
                });
            }
            if !self.buffer.ends_with(b"\n") && self.buffer.trim_ascii_end().contains(&b'\r') {
                return Err(DatasetError::Refused {
                    path: self.path.to_owned(),
                    line: Some(self.number),
                    reason: "lines end in carriage returns alone; allowed: a newline, or both".to_owned(),
                });
            }
            if self.buffer.len() == LONGEST_LINE && !self.buffer.ends_with(b"\n") {
                return Err(DatasetError::LongLine {
                    path: self.path.to_owned(),
                    line: self.number,
                    limit: LONGEST_LINE,
                });
            }
            if !self.buffer.trim_ascii().is_empty() {
                break;
            }
        }
        if !self.buffer.ends_with(b"\n") {
            self.is_cut_off = true;
            return Ok(None);
        }
        Ok(Some(self.line()))
    }

    /// After the last line: the error for a file that ends inside a line.
    pub fn cut_off(&self) -> Option<DatasetError> {
        self.is_cut_off.then(|| DatasetError::CutOff {
            path: self.path.to_owned(),
            line: self.number,
            keyword: quoted(self.line().fields().keyword).into(),
        })
    }

    fn line(&self) -> Line<'_> {
        Line { path: self.path, number: self.number, text: String::from_utf8_lossy(&self.buffer) }
    }
}

/// One line that isn't blank. Bytes that aren't UTF-8 have become replacement characters.
pub struct Line<'a> {
    path: &'a Path,
    number: usize,
    text: Cow<'a, str>,
}

impl Line<'_> {
    /// The line's fields, its first word taken as the keyword.
    pub fn fields(&self) -> Fields<'_> {
        let mut rest = self.text.split_ascii_whitespace();
        let keyword = rest.next().unwrap_or_default();
        Fields { path: self.path, line: self.number, keyword, rest }
    }

    /// The error for a line above the limit.
    pub fn refuse(&self, reason: String) -> DatasetError {
        DatasetError::Refused { path: self.path.to_owned(), line: Some(self.number), reason }
    }

    /// The line's fields where the format has no keywords; `name` stands for the keyword in errors.
    pub fn fields_of<'a>(&'a self, name: &'a str) -> Fields<'a> {
        Fields { path: self.path, line: self.number, keyword: name, rest: self.text.split_ascii_whitespace() }
    }
}

/// Takes the fields of a line one after the other; every error names file, line, keyword and value.
pub struct Fields<'a> {
    path: &'a Path,
    line: usize,
    pub keyword: &'a str,
    rest: SplitAsciiWhitespace<'a>,
}

impl<'a> Fields<'a> {
    /// Number of fields not yet taken.
    pub fn remaining(&self) -> usize {
        self.rest.clone().count()
    }

    /// Fails unless exactly `count` fields are left. `taken` fields were taken before, the keyword included; `why` gives
    /// the reason for the number.
    pub fn expect_remaining(&self, count: usize, taken: usize, why: &str) -> Result<(), DatasetError> {
        let remaining = self.remaining();
        if remaining == count {
            return Ok(());
        }
        Err(DatasetError::FieldCount {
            path: self.path.to_owned(),
            line: self.line,
            keyword: self.keyword.into(),
            found: taken.saturating_add(remaining),
            allowed: format!("{} {why}", taken.saturating_add(count)).into(),
        })
    }

    /// The next field; an empty string when there is none.
    pub fn word(&mut self) -> &'a str {
        self.rest.next().unwrap_or_default()
    }

    /// The next field as a value for which `accept` holds.
    pub fn value<T: FromStr + Copy>(
        &mut self,
        field: &str,
        allowed: &str,
        accept: impl Fn(T) -> bool,
    ) -> Result<T, DatasetError> {
        let word = self.word();
        match word.parse::<T>() {
            Ok(value) if accept(value) => Ok(value),
            _ => Err(self.refuse(field, word, allowed)),
        }
    }

    /// The next field as a finite number up to a bound, of either sign.
    fn number_up_to(&mut self, bound: f64, field: &str) -> Result<f64, DatasetError> {
        let word = self.word();
        match word.parse::<f64>() {
            Ok(value) if value.abs() <= bound => Ok(value),
            _ => Err(self.refuse(field, word, &format!("a finite number up to {bound:e}"))),
        }
    }

    /// The next field as a number within the bounds for safe arithmetic: a coordinate, an angle, a speed.
    pub fn number(&mut self, field: &str) -> Result<f64, DatasetError> {
        self.number_up_to(COORDINATE, field)
    }

    /// The next field as a time (s).
    pub fn stamp(&mut self, field: &str) -> Result<f64, DatasetError> {
        self.number_up_to(STAMP_SECS, field)
    }

    /// The next three fields as a pose (m, m, rad).
    pub fn pose(&mut self, of: &str) -> Result<Pose2, DatasetError> {
        let [x, y, theta] = ["x", "y", "theta"].map(|axis| self.number(&format!("{of} {axis}")));
        Ok(Pose2::new(x?, y?, theta?))
    }

    /// The error for a field whose value isn't allowed.
    pub fn refuse(&self, field: &str, value: &str, allowed: &str) -> DatasetError {
        DatasetError::Field {
            path: self.path.to_owned(),
            line: self.line,
            keyword: self.keyword.into(),
            field: field.into(),
            value: quoted(value).into(),
            allowed: allowed.into(),
        }
    }
}
