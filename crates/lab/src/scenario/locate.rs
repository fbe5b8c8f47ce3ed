use std::collections::HashMap;

use saphyr_parser::{Event, Parser};

use super::Problem;

/// Where each key of a YAML text stands.
#[derive(Debug, Default)]
pub(crate) struct Locations {
    lines: HashMap<String, usize>,
    duplicates: Vec<Problem>,
}

/// A collection that is open while the text is read.
enum Open {
    Map {
        path: String,
        /// The key whose value comes next; `None` where a key comes next.
        key: Option<String>,
    },
    List {
        path: String,
        next: usize,
    },
}

impl Locations {
    /// Reads as far as the text is YAML; what follows a syntax error has no location.
    pub(crate) fn of(text: &str) -> Self {
        let mut locations = Self::default();
        let mut open: Vec<Open> = Vec::new();
        for (event, span) in Parser::new_from_str(text).map_while(Result::ok) {
            let line = span.start.line();
            match &event {
                Event::Scalar(word, ..) => _ = locations.node(&mut open, line, word),
                Event::Alias(_) => _ = locations.node(&mut open, line, "*"),
                Event::MappingStart(..) => {
                    let path = locations.node(&mut open, line, "{}");
                    open.push(Open::Map { path, key: None });
                }
                Event::SequenceStart(..) => {
                    let path = locations.node(&mut open, line, "[]");
                    open.push(Open::List { path, next: 0 });
                }
                Event::MappingEnd | Event::SequenceEnd => _ = open.pop(),
                // A second document isn't ours.
                Event::DocumentEnd => break,
                _ => {}
            }
        }
        locations
    }

    /// Takes note of one node; `word` is its text, in case it is a key. Returns its path.
    fn node(&mut self, open: &mut [Open], line: usize, word: &str) -> String {
        let path = match open.last_mut() {
            None => String::new(),
            Some(Open::List { path, next }) => {
                *next += 1;
                format!("{path}[{}]", *next - 1)
            }
            Some(Open::Map { path, key: key @ None }) => {
                let path = join(path, word);
                *key = Some(word.to_owned());
                if let Some(first) = self.lines.insert(path.clone(), line) {
                    self.duplicates.push(Problem {
                        line: Some(line),
                        key: path.clone(),
                        message: format!("the key stands twice, first at line {first}"),
                    });
                }
                return path;
            }
            // A value is located by its key.
            Some(Open::Map { path, key }) => return join(path, &key.take().unwrap_or_default()),
        };
        self.lines.insert(path.clone(), line);
        path
    }

    /// Line of a key, or of the nearest key that contains it. Command-line options (`--trials`) have none.
    pub(crate) fn line(&self, key: &str) -> Option<usize> {
        if key.starts_with("--") {
            return None;
        }
        let mut key = key;
        loop {
            if let Some(line) = self.lines.get(key) {
                return Some(*line);
            }
            if key.is_empty() {
                return None;
            }
            key = key.rfind(['.', '[']).map_or("", |end| &key[..end]);
        }
    }

    /// Whether the text has the key at this path.
    pub(crate) fn has(&self, key: &str) -> bool {
        self.lines.contains_key(key)
    }

    /// Keys that stand twice in one map.
    pub(crate) fn duplicates(&self) -> &[Problem] {
        &self.duplicates
    }
}

/// The path of a key inside the map at `path`.
pub(crate) fn join(path: &str, key: &str) -> String {
    if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_and_element_has_the_line_it_stands_on() {
        let text = "# comment\na: 1\nb:\n  c: [1,\n    2]\n  d:\n    - {e: &x 3}\n    -\n      e: *x\n'f g': |\n  h: 5\ni: 6\n";
        let locations = Locations::of(text);
        for (key, line) in [
            ("", 2),
            ("a", 2),
            ("b", 3),
            ("b.c", 4),
            ("b.c[0]", 4),
            ("b.c[1]", 5),
            ("b.d[0].e", 7),
            ("b.d[1].e", 9),
            ("f g", 10),
            ("i", 12),
        ] {
            assert_eq!(locations.line(key), Some(line), "{key}");
        }
    }

    #[test]
    fn a_key_that_is_not_there_has_the_line_of_the_map_it_belongs_in() {
        let locations = Locations::of("a: 1\nb:\n  c:\n    - d: 2\n");
        assert_eq!(locations.line("b.c[0].missing"), Some(4));
        assert_eq!(locations.line("b.x.y"), Some(2));
        assert_eq!(locations.line("x"), Some(1));
        assert_eq!(locations.line("--trials"), None);
        assert_eq!(Locations::of("").line("a"), None);
    }

    #[test]
    fn only_keys_of_the_same_map_can_be_duplicates() {
        let locations = Locations::of("a: {b: 1}\nc: {b: 1}\nd: [{b: 1}, {b: 1}]\n");
        assert_eq!(locations.duplicates(), []);
        let locations = Locations::of("a:\n  b: 1\n  c: 2\n  b: 3\n");
        assert_eq!(locations.duplicates().len(), 1);
        assert_eq!(locations.duplicates()[0].to_string(), "a.b: the key stands twice, first at line 2");
        assert_eq!(locations.duplicates()[0].line, Some(4));
    }
}
