//! Why a file is refused.

use std::fmt::{self, Write};
use std::path::{Path, PathBuf};

use locsim_core::limits::{QUOTED_CHARACTERS, quoted, visible};
use thiserror::Error;

/// An error lists this many problems, at the most.
pub const LISTED: usize = 20;

/// This many of the words that are allowed.
const LISTED_WORDS: usize = 50;

/// The nearest word is looked for among at most this many, because it takes time.
const COMPARED_WORDS: usize = 200;

/// Why a scenario, or a map that it names, is refused.
#[derive(Debug, Error)]
pub enum ScenarioError {
    /// The file can't be read at all.
    #[error("{}: {source}", shown(path))]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The file's content is at fault.
    #[error("{}", render(file, problems))]
    Invalid {
        /// The file.
        file: PathBuf,
        /// At least one, in the order of the checks.
        problems: Vec<Problem>,
    },
}

impl ScenarioError {
    /// The same error without the lines of this file, which nobody has written.
    #[must_use]
    pub fn without_lines_of(mut self, written: &Path) -> Self {
        if let Self::Invalid { file, problems } = &mut self
            && file == written
        {
            for problem in problems {
                problem.line = None;
            }
        }
        self
    }
}

/// One thing wrong in a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// Line in the file, from 1; `None` where the fault isn't in the file (a command-line option).
    pub line: Option<usize>,
    /// Path of the key, such as `filter.particles` or `models[2].label`; empty for the file as a whole.
    pub key: String,
    /// The value and what is allowed instead.
    pub message: String,
}

impl Problem {
    /// With the file as a whole.
    pub fn of_file(message: impl Into<String>) -> Self {
        Self { line: None, key: String::new(), message: message.into() }
    }
}

/// A line that stands for `more` problems that aren't listed.
pub fn and_more(more: usize) -> Option<Problem> {
    (more > 0).then(|| Problem::of_file(format!("and {more} more")))
}

/// A file's name without hidden characters; longer than a system's names only where a file asks for such a one.
pub fn shown(path: &Path) -> String {
    visible(&path.to_string_lossy(), 1000)
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.key.is_empty() {
            write!(f, "{}: ", quoted(&self.key))?;
        }
        f.write_str(&self.message)
    }
}

/// One line per problem: `file:line: key: message`, as compilers do.
fn render(file: &Path, problems: &[Problem]) -> String {
    let mut text = String::new();
    for (i, problem) in problems.iter().enumerate() {
        if i > 0 {
            text.push('\n');
        }
        let _ = write!(text, "{}:", shown(file));
        if let Some(line) = problem.line {
            let _ = write!(text, "{line}:");
        }
        let _ = write!(text, " {problem}");
    }
    text
}

/// `name is not <what>; did you mean X?; one of a, b, c`: the sentence for a word that isn't in a list.
pub fn unknown_word(word: &str, what: &str, known: &[&str]) -> String {
    let mut text = format!("`{}` is not {what}; ", quoted(word));
    if let Some(near) = nearest(word, known) {
        let _ = write!(text, "did you mean `{}`? ", quoted(near));
    }
    match known {
        [] => text.push_str("none is allowed here"),
        known => {
            let listed: Vec<String> =
                known.iter().take(LISTED_WORDS).map(|word| visible(word, QUOTED_CHARACTERS)).collect();
            let _ = write!(text, "allowed: {}", listed.join(", "));
            if known.len() > LISTED_WORDS {
                let _ = write!(text, " and {} more", known.len() - LISTED_WORDS);
            }
        }
    }
    text
}

/// The known word that is near enough to be meant: a slip of the keyboard, or one begins with the other.
fn nearest<'a>(word: &str, known: &[&'a str]) -> Option<&'a str> {
    let short = |word: &str| word.len() <= QUOTED_CHARACTERS;
    if !short(word) || known.len() > COMPARED_WORDS {
        return None;
    }
    let known: Vec<&str> = known.iter().copied().filter(|known| short(known)).collect();
    let limit = (word.chars().count() / 3).max(1);
    let near = known.iter().map(|k| (edit_distance(word, k), *k)).min_by_key(|(distance, _)| *distance)?;
    if near.0 <= limit {
        return Some(near.1);
    }
    known
        .iter()
        .copied()
        .find(|k| word.len() >= 3 && k.len() >= 3 && (k.starts_with(word) || word.starts_with(k)))
}

/// Damerau-Levenshtein distance (optimal string alignment) in characters.
fn edit_distance(a: &str, b: &str) -> usize {
    let [a, b]: [Vec<char>; 2] = [a, b].map(|text| text.chars().collect());
    let mut distance = vec![vec![0; b.len() + 1]; a.len() + 1];
    for i in 0..=a.len() {
        for j in 0..=b.len() {
            distance[i][j] = if i == 0 || j == 0 {
                i + j
            } else {
                let replaced = distance[i - 1][j - 1] + usize::from(a[i - 1] != b[j - 1]);
                replaced.min(distance[i - 1][j] + 1).min(distance[i][j - 1] + 1)
            };
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                distance[i][j] = distance[i][j].min(distance[i - 2][j - 2] + 1);
            }
        }
    }
    distance[a.len()][b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edit_distances_count_insertions_deletions_replacements_and_swaps() {
        for (a, b, distance) in [
            ("kitten", "sitting", 3),
            ("", "abc", 3),
            ("abc", "", 3),
            ("beams", "beams", 0),
            ("baems", "beams", 1),
            ("ab", "ba", 1),
        ] {
            assert_eq!(edit_distance(a, b), distance, "{a} {b}");
        }
    }

    #[test]
    fn only_near_words_are_suggested() {
        let known = ["particles", "motion"];
        assert_eq!(nearest("partcles", &known), Some("particles"));
        assert_eq!(nearest("part", &known), Some("particles"));
        assert_eq!(nearest("motion_model", &known), Some("motion"));
        assert_eq!(nearest("colour", &known), None);
        assert_eq!(nearest("", &known), None);
    }
}
