//! A YAML text as a tree whose values know their lines, read within limits.
//!
//! The events of the parser are counted before anything is made of them: what an alias repeats is shared and never
//! expanded, but counted as if it were.

use std::collections::HashMap;
use std::rc::Rc;

use locsim_core::limits::{Limits, YAML_DEPTH, quoted};
use saphyr_parser::{Event, Marker, Parser, ScalarStyle, Tag};

use crate::Problem;
use crate::error::{LISTED, and_more};
use crate::key_path::join;

/// A value and where it begins.
#[derive(Debug, PartialEq)]
pub struct Node {
    /// Line, from 1.
    pub line: usize,
    pub value: Value,
}

/// A value in a text. Words in quotes are always text.
#[derive(Debug, PartialEq)]
pub enum Value {
    Null,
    Bool(bool),
    Unsigned(u64),
    Negative(i64),
    /// A number with a fraction or an exponent, or a whole number beyond the others, and how it is written.
    Float(f64, Box<str>),
    Text(Box<str>),
    List(Vec<Node>),
    Map(Vec<Entry>),
    /// A node with an anchor, shared by all of its aliases.
    Shared(Rc<Node>),
}

/// A key with its value.
#[derive(Debug, PartialEq)]
pub struct Entry {
    pub key: Box<str>,
    /// Line of the key, from 1.
    pub line: usize,
    pub value: Node,
}

impl Node {
    /// The value, whether it is shared or not.
    pub fn value(&self) -> &Value {
        match &self.value {
            Value::Shared(node) => node.value(),
            value => value,
        }
    }
}

/// Size of a part of a text with its aliases expanded.
#[derive(Clone, Copy, Debug, Default)]
struct Size {
    /// Keys and values.
    values: u64,
    /// Bytes of the scalars.
    bytes: u64,
    /// Collections within each other.
    height: usize,
}

/// A collection that is open while the text is read.
struct Open {
    anchor: usize,
    line: usize,
    /// The size read before.
    before: Size,
    /// Height of what is within so far.
    height: usize,
    content: Content,
}

enum Content {
    List(Vec<Node>),
    /// The second is the key whose value comes next; `None` where a key comes next.
    Map(Vec<Entry>, Option<(Box<str>, usize)>),
}

struct Reader<'a> {
    limits: &'a Limits,
    open: Vec<Open>,
    anchors: HashMap<usize, (Rc<Node>, Size)>,
    read: Size,
    root: Option<Node>,
    duplicates: Vec<Problem>,
    more_duplicates: usize,
}

/// The tree of a text; `None` for a text without a value.
///
/// # Errors
/// Problems with their lines: syntax, repeated keys, content above the limits.
pub fn read(text: &str, limits: &Limits) -> Result<Option<Node>, Vec<Problem>> {
    let bytes = text.len() as u64;
    if bytes > limits.yaml_bytes {
        return Err(vec![Problem::of_file(limits.refusal("yaml_bytes", bytes))]);
    }
    let mut reader = Reader {
        limits,
        open: Vec::new(),
        anchors: HashMap::new(),
        read: Size::default(),
        root: None,
        duplicates: Vec::new(),
        more_duplicates: 0,
    };
    let found = match control_character(text) {
        Some(problem) => Err(problem),
        None => reader.events(text),
    };
    let mut problems = reader.duplicates;
    problems.extend(and_more(reader.more_duplicates));
    problems.extend(found.err());
    if problems.is_empty() { Ok(reader.root) } else { Err(problems) }
}

fn too_deep(depth: impl std::fmt::Display) -> String {
    format!("{depth} collections within each other are not allowed; at most {YAML_DEPTH}")
}

/// YAML allows none but tabs and line ends, and the parser takes some for the end of the text.
fn control_character(text: &str) -> Option<Problem> {
    let allowed = |c: char| !c.is_control() || matches!(c, '\t' | '\n' | '\r' | '\u{85}');
    let (at, character) = text.char_indices().find(|(_, c)| !allowed(*c))?;
    let message = format!(
        "not readable as YAML: the control character {} is not allowed; text",
        character.escape_unicode()
    );
    Some(Problem { line: Some(line_at(text.as_bytes(), at)), key: String::new(), message })
}

/// The word that a parser's marker is at.
fn word_at(text: &str, marker: &Marker) -> String {
    let line = text.lines().nth(marker.line().saturating_sub(1)).unwrap_or_default();
    line.chars().skip(marker.col()).take_while(|c| !c.is_whitespace() && !",[]{}".contains(*c)).collect()
}

/// The line of a byte, from 1.
pub(super) fn line_at(bytes: &[u8], at: usize) -> usize {
    bytes[..at].split(|byte| *byte == b'\n').count()
}

impl Reader<'_> {
    fn events(&mut self, text: &str) -> Result<(), Problem> {
        let mut documents = 0;
        for event in Parser::new_from_str(text) {
            let (event, span) = event.map_err(|error| Problem {
                line: Some(error.marker().line()),
                key: String::new(),
                message: match error.info() {
                    // The parser's own limit is wider, but it may meet it before it tells of the first value.
                    "recursion limit exceeded" => too_deep("more"),
                    "while parsing node, found unknown anchor" => {
                        let alias = word_at(text, error.marker());
                        format!(
                            "`{}` is not allowed; an alias of an anchor `&` that stands before it",
                            quoted(&alias)
                        )
                    }
                    info => format!("not readable as YAML: {}", quoted(info)),
                },
            })?;
            let line = span.start.line();
            match event {
                Event::Scalar(word, style, anchor, tag) => {
                    self.scalar(line, &word, style, anchor, tag.as_deref())?;
                }
                Event::Alias(anchor) => self.alias(line, anchor)?,
                Event::MappingStart(anchor, tag) => {
                    self.start(line, anchor, tag.as_deref(), Content::Map(Vec::new(), None))?;
                }
                Event::SequenceStart(anchor, tag) => {
                    self.start(line, anchor, tag.as_deref(), Content::List(Vec::new()))?;
                }
                Event::MappingEnd | Event::SequenceEnd => self.end(),
                Event::DocumentStart(_) => {
                    documents += 1;
                    if documents > 1 {
                        return Err(self.problem(line, "a second document is not allowed; one in each file"));
                    }
                }
                Event::DocumentEnd | Event::StreamStart | Event::StreamEnd | Event::Nothing => {}
            }
        }
        Ok(())
    }

    /// A problem with what comes next.
    fn problem(&self, line: usize, message: impl Into<String>) -> Problem {
        Problem { line: Some(line), key: self.path(), message: message.into() }
    }

    /// The path of the value that comes next, or of the map whose key comes next.
    fn path(&self) -> String {
        self.open.iter().fold(String::new(), |path, open| match &open.content {
            Content::List(items) => format!("{path}[{}]", items.len()),
            Content::Map(_, Some((key, _))) => join(&path, key),
            Content::Map(_, None) => path,
        })
    }

    fn key_comes_next(&self) -> bool {
        matches!(self.open.last(), Some(Open { content: Content::Map(_, None), .. }))
    }

    /// Takes note of what comes next, before it is kept.
    fn count(&mut self, line: usize, size: Size) -> Result<(), Problem> {
        self.read.values = self.read.values.saturating_add(size.values);
        self.read.bytes = self.read.bytes.saturating_add(size.bytes);
        let limits = self.limits;
        let depth = self.open.len() + size.height;
        if depth > YAML_DEPTH {
            return Err(self.problem(line, too_deep(depth)));
        }
        for (name, found, most) in [
            ("yaml_values", self.read.values, limits.yaml_values),
            ("yaml_bytes", self.read.bytes, limits.yaml_bytes),
        ] {
            if found > most {
                return Err(self.problem(line, limits.refusal(name, found)));
            }
        }
        Ok(())
    }

    fn scalar(
        &mut self,
        line: usize,
        word: &str,
        style: ScalarStyle,
        anchor: usize,
        tag: Option<&Tag>,
    ) -> Result<(), Problem> {
        let is_text = tag.is_some_and(|tag| tag.is_yaml_core_schema() && tag.suffix == "str");
        if !is_text {
            self.without_tag(line, tag)?;
        }
        let size = Size { values: 1, bytes: word.len() as u64, height: 0 };
        self.count(line, size)?;
        let plain = style == ScalarStyle::Plain && !is_text;
        let value = |word: &str| if plain { plain_scalar(word) } else { Value::Text(word.into()) };
        if self.key_comes_next() {
            if anchor > 0 {
                self.anchors.insert(anchor, (Rc::new(Node { line, value: value(word) }), size));
            }
            if let Some(Open { content: Content::Map(_, key), .. }) = self.open.last_mut() {
                *key = Some((word.into(), line));
            }
        } else {
            self.put(anchor, Node { line, value: value(word) }, size);
        }
        Ok(())
    }

    fn without_tag(&self, line: usize, tag: Option<&Tag>) -> Result<(), Problem> {
        let Some(tag) = tag else { return Ok(()) };
        let tag = quoted(&tag.to_string());
        Err(self.problem(line, format!("the YAML tag {tag} is not allowed; a value without a tag")))
    }

    fn alias(&mut self, line: usize, anchor: usize) -> Result<(), Problem> {
        if self.key_comes_next() {
            return Err(self.problem(line, "an alias as a key is not allowed; a word"));
        }
        let Some((node, size)) = self.anchors.get(&anchor) else {
            return Err(self.problem(line, "an alias within what it repeats is not allowed"));
        };
        let (node, size) = (Rc::clone(node), *size);
        self.count(line, size)?;
        self.put(0, Node { line, value: Value::Shared(node) }, size);
        Ok(())
    }

    fn start(
        &mut self,
        line: usize,
        anchor: usize,
        tag: Option<&Tag>,
        content: Content,
    ) -> Result<(), Problem> {
        self.without_tag(line, tag)?;
        if self.key_comes_next() {
            return Err(self.problem(line, "a map or list as a key is not allowed; a word"));
        }
        let before = self.read;
        self.count(line, Size { values: 1, bytes: 0, height: 1 })?;
        self.open.push(Open { anchor, line, before, height: 0, content });
        Ok(())
    }

    fn end(&mut self) {
        let Some(Open { anchor, line, before, height, content }) = self.open.pop() else { return };
        let size = Size {
            values: self.read.values - before.values,
            bytes: self.read.bytes - before.bytes,
            height: height + 1,
        };
        let value = match content {
            Content::List(items) => Value::List(items),
            Content::Map(entries, _) => {
                self.find_duplicates(&entries);
                Value::Map(entries)
            }
        };
        self.put(anchor, Node { line, value }, size);
    }

    /// Keeps a value that was counted.
    fn put(&mut self, anchor: usize, mut node: Node, size: Size) {
        if anchor > 0 {
            let line = node.line;
            let shared = Rc::new(node);
            self.anchors.insert(anchor, (Rc::clone(&shared), size));
            node = Node { line, value: Value::Shared(shared) };
        }
        match self.open.last_mut() {
            None => self.root = Some(node),
            Some(open) => {
                open.height = open.height.max(size.height);
                match &mut open.content {
                    Content::List(items) => items.push(node),
                    Content::Map(entries, key) => {
                        let (key, line) = key.take().expect("a key comes before its value");
                        entries.push(Entry { key, line, value: node });
                    }
                }
            }
        }
    }

    /// Keys that stand twice in the map that just ended.
    fn find_duplicates(&mut self, entries: &[Entry]) {
        let mut by_key: Vec<&Entry> = entries.iter().collect();
        // Stable, so that equal keys stay in the order of the text.
        by_key.sort_by(|a, b| a.key.cmp(&b.key));
        for group in by_key.chunk_by(|a, b| a.key == b.key) {
            for again in &group[1..] {
                if self.duplicates.len() < LISTED {
                    self.duplicates.push(Problem {
                        line: Some(again.line),
                        key: join(&self.path(), &again.key),
                        message: format!("the key stands twice, first at line {}", group[0].line),
                    });
                } else {
                    self.more_duplicates += 1;
                }
            }
        }
    }
}

/// A word without quotes, by the core schema of YAML 1.2.
fn plain_scalar(word: &str) -> Value {
    match word {
        "" | "~" | "null" | "Null" | "NULL" => return Value::Null,
        "true" | "True" | "TRUE" => return Value::Bool(true),
        "false" | "False" | "FALSE" => return Value::Bool(false),
        ".nan" | ".NaN" | ".NAN" => return Value::Float(f64::NAN, word.into()),
        _ => {}
    }
    let text = || Value::Text(word.into());
    let (negative, digits) = match word.strip_prefix('-') {
        Some(digits) => (true, digits),
        None => (false, word.strip_prefix('+').unwrap_or(word)),
    };
    if let ".inf" | ".Inf" | ".INF" = digits {
        let infinite = if negative { f64::NEG_INFINITY } else { f64::INFINITY };
        return Value::Float(infinite, word.into());
    }
    // The parsers of numbers would also read other words: `inf`, `--1`.
    if !digits.starts_with(|c: char| c.is_ascii_digit() || c == '.') {
        return text();
    }
    let radix = [("0x", 16), ("0o", 8), ("0b", 2)];
    let based = radix.into_iter().find_map(|(prefix, radix)| Some((digits.strip_prefix(prefix)?, radix)));
    let (whole, radix) = based.unwrap_or((digits, 10));
    // As in `007`, which is a name rather than a number.
    let zero_padded = based.is_none()
        && digits.len() > 1
        && digits.starts_with('0')
        && digits.bytes().all(|b| b.is_ascii_digit());
    if zero_padded || whole.starts_with(['+', '-']) {
        return text();
    }
    let signed = || i64::from_str_radix(&format!("-{whole}"), radix).ok().map(Value::Negative);
    let unsigned = || u64::from_str_radix(whole, radix).ok().map(Value::Unsigned);
    let number = if negative { signed() } else { unsigned() };
    number.unwrap_or_else(|| match format!("{}{digits}", if negative { "-" } else { "" }).parse() {
        Ok(value) if f64::is_finite(value) => Value::Float(value, word.into()),
        _ => text(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(text: &str) -> Value {
        read(text, &Limits::DEFAULT).unwrap().unwrap().value
    }

    fn refused(text: &str) -> String {
        let problems = read(text, &Limits::DEFAULT).unwrap_err();
        let line = |p: &Problem| p.line.map_or_else(String::new, |line| format!("{line}: "));
        problems.iter().map(|p| format!("{}{p}", line(p))).collect::<Vec<_>>().join("\n")
    }

    fn float(value: f64, written: &str) -> Value {
        Value::Float(value, written.into())
    }

    #[test]
    fn words_without_quotes_are_values_by_the_core_schema() {
        for (text, expected) in [
            ("~", Value::Null),
            ("True", Value::Bool(true)),
            ("'true'", Value::Text("true".into())),
            ("!!str 1", Value::Text("1".into())),
            ("yes", Value::Text("yes".into())),
            ("18446744073709551615", Value::Unsigned(u64::MAX)),
            ("18446744073709551616", float(18_446_744_073_709_551_616.0, "18446744073709551616")),
            ("-9223372036854775808", Value::Negative(i64::MIN)),
            ("-9223372036854775809", float(-9_223_372_036_854_775_809.0, "-9223372036854775809")),
            ("+7", Value::Unsigned(7)),
            ("0x1F", Value::Unsigned(31)),
            ("-0b11", Value::Negative(-3)),
            ("0x-1", Value::Text("0x-1".into())),
            ("007", Value::Text("007".into())),
            ("-0", Value::Negative(0)),
            ("-0.0", float(-0.0, "-0.0")),
            ("1e-3", float(1e-3, "1e-3")),
            (".5", float(0.5, ".5")),
            ("1e999", Value::Text("1e999".into())),
            ("-.inf", float(f64::NEG_INFINITY, "-.inf")),
            ("inf", Value::Text("inf".into())),
            ("nan", Value::Text("nan".into())),
            ("--1", Value::Text("--1".into())),
            ("1_000", Value::Text("1_000".into())),
            (".", Value::Text(".".into())),
        ] {
            assert_eq!(value(text), expected, "{text}");
        }
    }

    #[test]
    fn nesting_is_limited_with_aliases_counted() {
        let nested = |depth| format!("{}1{}", "[".repeat(depth), "]".repeat(depth));
        assert!(read(&nested(64), &Limits::DEFAULT).is_ok());
        assert_eq!(
            refused(&nested(65)),
            format!(
                "1: {}: 65 collections within each other are not allowed; at most 64",
                quoted(&"[0]".repeat(64))
            )
        );
        let aliased =
            |depth| format!("- &a {}\n- {}*a{}\n", nested(30), "[".repeat(depth), "]".repeat(depth));
        assert!(read(&aliased(33), &Limits::DEFAULT).is_ok());
        assert!(refused(&aliased(34)).contains("65 collections within each other"));
    }

    #[test]
    fn hostile_nesting_is_refused_whatever_it_is_made_of() {
        for part in ["[", "{", "- ", "? ", "{a: ", "[a: ", "!!!!", "&a ", "[[", "{[", ": "] {
            let text = part.repeat(100_000);
            assert!(read(&text, &Limits::DEFAULT).is_err(), "{part}");
        }
        let maps: Vec<String> = (0..300).map(|depth| format!("{}a:\n", " ".repeat(depth))).collect();
        assert!(refused(&maps.concat()).contains("at most 64"));
    }

    #[test]
    fn what_aliases_repeat_is_counted_and_not_expanded() {
        // Nine lists of nine each: 9^9 values from a few hundred bytes.
        let repeating = |i| format!("a{i}: &a{i} [{}]\n", vec![format!("*a{}", i - 1); 9].join(","));
        let lists: Vec<String> = (1..9).map(repeating).collect();
        let text = format!("a0: &a0 [x,x,x,x,x,x,x,x,x]\n{}", lists.concat());
        assert!(refused(&text).contains("values of a YAML file"), "{}", refused(&text));
        let long = format!("a: &a {}\nb: [{}]\n", "x".repeat(10_000), vec!["*a"; 2_000].join(","));
        assert!(refused(&long).contains("bytes of a YAML file"), "{}", refused(&long));
        assert_eq!(refused("a: &a [*a]\n"), "1: a[0]: an alias within what it repeats is not allowed");
    }

    #[test]
    fn what_no_file_of_ours_needs_is_refused() {
        for (text, message) in [
            ("a: !foo 1", "1: a: the YAML tag !foo is not allowed; a value without a tag"),
            ("a: 1\n---\nb: 2", "2: a second document is not allowed; one in each file"),
            ("a: 1\n[b]: 2", "2: a map or list as a key is not allowed; a word"),
            ("a: &x b\n*x : 2", "2: an alias as a key is not allowed; a word"),
            (
                "a: &x 1\nb: {c: *yes}",
                "2: `*yes` is not allowed; an alias of an anchor `&` that stands before it",
            ),
            ("a: 1\nb: \u{0}2", "2: not readable as YAML: the control character \\u{0} is not allowed; text"),
            ("b: 1\na: 2\nb: 3", "3: b: the key stands twice, first at line 1"),
        ] {
            assert_eq!(refused(text), message, "{text}");
        }
        let twice: Vec<String> = (0..100).map(|i| format!("a{i}: 1\na{i}: 2\n")).collect();
        let twice = twice.concat();
        assert_eq!(refused(&twice).lines().count(), LISTED + 1);
        assert!(refused(&twice).ends_with("and 80 more"), "{}", refused(&twice));
    }
}
