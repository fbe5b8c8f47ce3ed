//! Edits of a scenario's text: effects are added, files are named from another folder. Comments and order stay.

use std::fmt::Write;
use std::ops::Range;
use std::path::{Component, Path, PathBuf};

use locsim_world::effect::{Effect, EffectKind};
use saphyr_parser::{Event, Parser};

use crate::effect::{effect_yaml, quoted_text};
use crate::key_path::join;
use crate::{Overrides, Scenario};

/// An entry of the list `effects` or `residuals`, or the keys of `blocks`.
pub struct Entry {
    /// Comments above it, without `#`.
    pub comments: Vec<String>,
    /// Its lines of YAML, without indentation, as of [`effect_yaml`].
    pub lines: Vec<String>,
}

/// Another value of a number that a scenario states.
pub struct Change<'a> {
    /// Its key, such as `laser.noise.sigma_m`, or the name of the effect whose `p` it is.
    pub what: &'a str,
    /// What the scenario has.
    pub from: f64,
    /// What it gets.
    pub to: f64,
}

/// What a scenario gets.
#[derive(Default)]
pub struct Additions<'a> {
    /// Numbers that change where the text states them.
    pub changes: Vec<Change<'a>>,
    /// The first line of `laser`, for a scenario that lacks it.
    pub of_laser: Option<String>,
    /// The keys of `blocks`, for a scenario that has none.
    pub blocks: Option<Entry>,
    /// Entries at the end of `effects`.
    pub effects: Vec<Entry>,
    /// Entries at the end of `residuals`.
    pub residuals: Vec<Entry>,
}

impl Scenario {
    /// The text with what is added and a name of its own, for a file in the folder `folder`, an absolute path: files that are
    /// named relative to the scenario's folder are named relative to `folder`.
    pub fn with(&self, additions: &Additions<'_>, folder: &Path, name: &str) -> String {
        let changed = changed(&self.text, &additions.changes);
        let changed = additions.of_laser.iter().fold(changed, |text, line| begun(&text, "laser", line));
        // A mapping that isn't there is written as a list that isn't.
        let with_blocks = grown(&changed, "blocks", additions.blocks.as_slice());
        let grown =
            grown(&grown(&with_blocks, "effects", &additions.effects), "residuals", &additions.residuals);
        renamed(&moved(&grown, &self.file, folder), name)
    }

    /// The text for a file in the folder `folder`, an absolute path, as [`with`](Self::with) has it.
    pub fn text_in(&self, folder: &Path) -> String {
        moved(&self.text, &self.file, folder)
    }

    /// Whether the text states a key, such as `laser.mount`.
    pub fn has_key(&self, key: &str) -> bool {
        let mut is_there = false;
        walk(&self.text, &mut |path, _, _, _| is_there |= path == key);
        is_there
    }

    /// Whether [`with`](Self::with) gives a scenario with those effects.
    pub fn can_grow(&self) -> bool {
        let count = |text: &str| {
            let scenario = Self::of_text(&self.file, text, &Overrides::default()).ok()?;
            let simulator = scenario.simulator()?;
            Some([simulator.effects.len(), simulator.residuals.len()])
        };
        let neutral = Effect::neutral(EffectKind::RangeBias, Vec::new());
        let lines = vec![effect_yaml(&neutral, None)];
        let entry = || Entry { comments: vec!["a comment".to_owned()], lines: lines.clone() };
        let curve = || Entry { comments: Vec::new(), lines: vec!["- {bias_m: [0]}".to_owned()] };
        let grown = grown(&self.text, "effects", &[entry(), entry()]);
        let grown = self::grown(&grown, "residuals", &[curve()]);
        let more = |[effects, residuals]: [usize; 2]| [effects + 2, residuals + 1];
        matches!((count(&self.text), count(&grown)), (Some(before), Some(after)) if after == more(before))
    }
}

/// Where a list is in a text.
enum List {
    /// None.
    Absent,
    /// Entries on lines of their own, with this indentation; the last one ends before this byte.
    Block { indent: usize, end: usize },
    /// In brackets; the closing one is at this byte.
    Flow { close: usize, empty: bool },
}

/// A text with entries appended to its list of this key, or with such a list.
fn grown(text: &str, key: &str, entries: &[Entry]) -> String {
    if entries.is_empty() {
        return text.to_owned();
    }
    match find_list(text, key) {
        List::Absent => {
            let mut text = with_final_newline(text);
            let _ = writeln!(text, "{key}:");
            text + &block(entries, 2)
        }
        List::Block { indent, end } => {
            let (before, after) = text.split_at(end);
            let mut text = with_final_newline(before);
            text.push_str(&block(entries, indent));
            text + after
        }
        List::Flow { close, empty } => {
            let (before, after) = text.split_at(close);
            let mut text = before.trim_end().to_owned();
            if !empty && !text.ends_with(',') {
                text.push(',');
            }
            for entry in entries {
                for comment in &entry.comments {
                    let _ = write!(text, "\n  # {comment}");
                }
                for line in &entry.lines {
                    let _ = write!(text, "\n  {},", line.trim_start_matches("- "));
                }
            }
            text.pop();
            text + "\n" + after
        }
    }
}

/// A text whose mapping of this key begins with a line more.
fn begun(text: &str, key: &str, line: &str) -> String {
    let mut start = None;
    walk(text, &mut |path, event, bytes, _| {
        if path == key && matches!(event, Event::MappingStart(..)) {
            start = Some(bytes.start);
        }
    });
    let mut text = text.to_owned();
    if let Some(start) = start {
        if text[start..].starts_with('{') {
            text.insert_str(start + 1, &format!("{line}, "));
        } else {
            let indent = indent_at(&text, start);
            text.insert_str(start, &format!("{line}\n{:indent$}", ""));
        }
    }
    text
}

fn block(entries: &[Entry], indent: usize) -> String {
    let mut text = String::new();
    for entry in entries {
        for comment in &entry.comments {
            let _ = writeln!(text, "{:indent$}# {comment}", "");
        }
        for line in &entry.lines {
            let _ = writeln!(text, "{:indent$}{line}", "");
        }
    }
    text
}

fn with_final_newline(text: &str) -> String {
    let end = if text.is_empty() || text.ends_with('\n') { "" } else { "\n" };
    format!("{text}{end}")
}

/// Spaces before the line in which a byte stands: a list may be no deeper than its key, where its parser's column is that of the
/// first entry's content.
fn indent_at(text: &str, byte: usize) -> usize {
    let line = text[..byte].rfind('\n').map_or(0, |end| end + 1);
    text[line..].len() - text[line..].trim_start_matches(' ').len()
}

/// The nodes of a YAML text that are asked for, with the bytes where they stand.
fn find_list(text: &str, key: &str) -> List {
    let mut found = List::Absent;
    let mut end_of_last = 0;
    let mut inside = false;
    let mut count = 0;
    let mut start = 0;
    walk(text, &mut |path, event, bytes, _| match event {
        Event::SequenceStart(..) if path == key => {
            inside = true;
            start = bytes.start;
        }
        Event::SequenceEnd if path == key => {
            inside = false;
            found = if text[start..].starts_with('[') {
                List::Flow { close: text[..bytes.end].rfind(']').unwrap_or(bytes.end), empty: count == 0 }
            } else {
                List::Block { indent: indent_at(text, start), end: end_of_line(text, end_of_last) }
            };
        }
        _ if inside => {
            count += 1;
            if !matches!(event, Event::MappingEnd | Event::SequenceEnd) || bytes.start < bytes.end {
                end_of_last = end_of_last.max(bytes.end);
            }
        }
        _ => {}
    });
    found
}

/// The text with numbers changed where it states them.
fn changed(text: &str, changes: &[Change<'_>]) -> String {
    let mut places: Vec<(Range<usize>, f64)> = Vec::new();
    // The effect whose keys come.
    let mut effect = String::new();
    // Keys of an entry come in any order: `p` before `name`.
    let mut share: Option<(Range<usize>, f64)> = None;
    walk(text, &mut |path, event, bytes, _| {
        let in_list = path.strip_prefix("effects[").and_then(|rest| rest.split_once(']'));
        let key = in_list.map(|(_, key)| key);
        match event {
            Event::MappingStart(..) if key == Some("") => {
                effect.clear();
                share = None;
            }
            Event::Scalar(word, ..) if key == Some(".name") => effect = word.to_string(),
            Event::Scalar(word, ..) if key == Some(".p") => {
                share = word.parse().ok().map(|value| (bytes, value));
            }
            Event::MappingEnd if key == Some("") => {
                let Some((bytes, value)) = share.take() else { return };
                let change = changes.iter().find(|change| change.what == effect && change.from == value);
                places.extend(change.map(|change| (bytes, change.to)));
            }
            Event::Scalar(..) => {
                let change = changes.iter().find(|change| change.what == path);
                places.extend(change.map(|change| (bytes, change.to)));
            }
            _ => {}
        }
    });
    let mut text = text.to_owned();
    for (bytes, value) in places.into_iter().rev() {
        text.replace_range(bytes, &value.to_string());
    }
    text
}

/// The byte after the end of the line that holds a byte.
fn end_of_line(text: &str, byte: usize) -> usize {
    text[byte..].find('\n').map_or(text.len(), |line| byte + line + 1)
}

/// Tells every event of a text with the path of the node that it belongs to, its bytes and its column.
fn walk(text: &str, tell: &mut impl FnMut(&str, &Event<'_>, Range<usize>, usize)) {
    // Byte of each character, as the parser counts characters.
    let bytes: Vec<usize> = text.char_indices().map(|(byte, _)| byte).chain([text.len()]).collect();
    let byte = |index: usize| bytes[index.min(bytes.len() - 1)];
    // Open collections: path, the key whose value comes next, index of the next element.
    let mut open: Vec<(String, Option<Option<String>>, usize)> = Vec::new();
    for (event, span) in Parser::new_from_str(text).map_while(Result::ok) {
        let range = byte(span.start.index())..byte(span.end.index());
        let column = span.start.col();
        match &event {
            Event::MappingEnd | Event::SequenceEnd => {
                let path = open.pop().map(|(path, ..)| path).unwrap_or_default();
                tell(&path, &event, range, column);
            }
            Event::Scalar(..) | Event::Alias(_) | Event::MappingStart(..) | Event::SequenceStart(..) => {
                let path = match open.last_mut() {
                    None => String::new(),
                    Some((path, None, next)) => {
                        *next += 1;
                        format!("{path}[{}]", *next - 1)
                    }
                    Some((path, Some(key), _)) => {
                        let Some(name) = key.take() else {
                            if let Event::Scalar(word, ..) = &event {
                                *key = Some(word.to_string());
                            }
                            continue;
                        };
                        join(path, &name)
                    }
                };
                tell(&path, &event, range, column);
                match &event {
                    Event::MappingStart(..) => open.push((path, Some(None), 0)),
                    Event::SequenceStart(..) => open.push((path, None, 0)),
                    _ => {}
                }
            }
            Event::DocumentEnd => break,
            _ => {}
        }
    }
}

/// The text with the files that it names relative to `to` instead of to the folder of `file`.
fn moved(text: &str, file: &Path, to: &Path) -> String {
    let from = file.parent().unwrap_or(Path::new(""));
    let mut places: Vec<(Range<usize>, String)> = Vec::new();
    walk(text, &mut |path, event, bytes, _| {
        let Event::Scalar(word, ..) = event else { return };
        let is_file = ["map", "map.file", "log.file"].contains(&path)
            || (path.starts_with("models[") && path.ends_with("].file"));
        // An absolute path, or one from the environment, holds everywhere.
        if !is_file || word.starts_with("${") || Path::new(&**word).is_absolute() {
            return;
        }
        if let Ok(target) = from.join(&**word).canonicalize() {
            places.push((bytes, scalar(&relative(&target, to))));
        }
    });
    let mut text = text.to_owned();
    for (bytes, path) in places.into_iter().rev() {
        text.replace_range(bytes, &path);
    }
    text
}

/// The text with another name: the key `name` stands first where there was none.
fn renamed(text: &str, name: &str) -> String {
    let mut place = None;
    walk(text, &mut |path, event, bytes, _| {
        if path == "name" && matches!(event, Event::Scalar(..)) {
            place = Some(bytes);
        }
    });
    let mut text = text.to_owned();
    if let Some(bytes) = place {
        text.replace_range(bytes, name);
        return text;
    }
    let start = start_of_keys(&text);
    if text[start..].starts_with('{') {
        text.insert_str(start + 1, &format!("name: {name}, "));
    } else {
        text.insert_str(start, &format!("name: {name}\n"));
    }
    text
}

/// The start of the first line that is neither blank nor a comment nor the start of the document.
fn start_of_keys(text: &str) -> usize {
    let is_head = |line: &str| {
        let line = line.trim_start_matches('\u{feff}').trim();
        line.is_empty() || line.starts_with('#') || line.starts_with("---") || line.starts_with('%')
    };
    text.split_inclusive('\n').take_while(|line| is_head(line)).map(str::len).sum()
}

/// A file as a file of the folder `folder` names it, in YAML: relative, where they share a folder.
pub fn yaml_path(file: &Path, folder: &Path) -> String {
    let absolute = |path: &Path| {
        let path = if path.as_os_str().is_empty() { Path::new(".") } else { path };
        path.canonicalize().unwrap_or_else(|_| path.to_owned())
    };
    scalar(&relative(&absolute(file), &absolute(folder)))
}

/// A path in YAML, in quotes where it needs them.
fn scalar(path: &Path) -> String {
    let path = path.display().to_string();
    let plain = path.chars().all(|c| c.is_ascii_alphanumeric() || "-_/.".contains(c));
    if plain { path } else { quoted_text(&path) }
}

/// A path from the folder `from` to `target`, both absolute; `target` itself where they share no folder.
fn relative(target: &Path, from: &Path) -> PathBuf {
    let shared = target.components().zip(from.components()).take_while(|(a, b)| a == b).count();
    if shared <= 1 {
        return target.to_owned();
    }
    let up = from.components().skip(shared).map(|_| Component::ParentDir);
    up.chain(target.components().skip(shared)).collect()
}

#[cfg(test)]
mod tests {
    use locsim_core::limits::{is_hidden, quoted};

    use super::*;

    fn entries() -> Vec<Entry> {
        vec![Entry {
            comments: vec!["why".to_owned()],
            lines: vec!["- {name: heavy_tail, p: 0.1}".to_owned()],
        }]
    }

    #[test]
    fn a_scenario_gets_another_name() {
        for (text, expected) in [
            ("seed: 1\n", "name: n\nseed: 1\n"),
            ("# head\n\n---\nseed: 1\n", "# head\n\n---\nname: n\nseed: 1\n"),
            ("seed: 1\nname: old # why\n", "seed: 1\nname: n # why\n"),
            ("name: \"old one\"\nlog: {name: x}\n", "name: n\nlog: {name: x}\n"),
            ("{seed: 1}\n", "{name: n, seed: 1}\n"),
        ] {
            assert_eq!(renamed(text, "n"), expected);
        }
    }

    #[test]
    fn a_number_changes_where_it_stands() {
        let change = |what, from, to| Change { what, from, to };
        let changes = [change("laser.noise.sigma_m", 0.02, 0.008), change("crosstalk", 0.01, 0.002)];
        for (text, expected) in [
            ("laser: {noise: {sigma_m: 0.02}} # guess\n", "laser: {noise: {sigma_m: 0.008}} # guess\n"),
            ("laser:\n  noise:\n    sigma_m: 2e-2 # ä\n", "laser:\n  noise:\n    sigma_m: 0.008 # ä\n"),
            ("effects: [{p: 0.01, name: crosstalk}]\n", "effects: [{p: 0.002, name: crosstalk}]\n"),
            // Of two with one name, that with this value.
            (
                "effects:\n- {name: crosstalk, p: 0.3}\n- name: crosstalk\n  p: 0.01\n",
                "effects:\n- {name: crosstalk, p: 0.3}\n- name: crosstalk\n  p: 0.002\n",
            ),
            ("effects: [{name: glass, p: 0.01}]\n", "effects: [{name: glass, p: 0.01}]\n"),
            ("errors: {sigma_m: 0.02}\n", "errors: {sigma_m: 0.02}\n"),
        ] {
            assert_eq!(changed(text, &changes), expected);
        }
    }

    #[test]
    fn a_mapping_begins_with_a_line_more() {
        for (text, expected) in [
            ("laser: {beams: 3} # ä\n", "laser: {mount: {x_m: 1}, beams: 3} # ä\n"),
            (
                "a: ä\nlaser: # why\n    # how\n    beams: 3\nz: {laser: {}}\n",
                "a: ä\nlaser: # why\n    # how\n    mount: {x_m: 1}\n    beams: 3\nz: {laser: {}}\n",
            ),
            ("z: 1\n", "z: 1\n"),
        ] {
            assert_eq!(begun(text, "laser", "mount: {x_m: 1}"), expected);
        }
    }

    #[test]
    fn blocks_are_added_with_their_keys() {
        let keys = Entry { comments: vec!["why".to_owned()], lines: vec!["length_m: [0.1, 0.6]".to_owned()] };
        let text = grown("a: 1\n", "blocks", &[keys]);
        assert_eq!(text, "a: 1\nblocks:\n  # why\n  length_m: [0.1, 0.6]\n");
    }

    #[test]
    fn an_entry_is_appended_however_the_list_is_written() {
        for (text, expected) in [
            ("a: 1\n", "a: 1\neffects:\n  # why\n  - {name: heavy_tail, p: 0.1}\n"),
            ("a: 1 # end", "a: 1 # end\neffects:\n  # why\n  - {name: heavy_tail, p: 0.1}\n"),
            (
                "effects: # all\n- {b: 1} # first\n- c: 2\n  d: [3]\n# then\nz: 1\n",
                "effects: # all\n- {b: 1} # first\n- c: 2\n  d: [3]\n# why\n- {name: heavy_tail, p: 0.1}\n# then\nz: 1\n",
            ),
            (
                "effects:\n    - {b: 1}\n\nz: 1\n",
                "effects:\n    - {b: 1}\n    # why\n    - {name: heavy_tail, p: 0.1}\n\nz: 1\n",
            ),
            ("effects: []\nz: 1\n", "effects: [\n  # why\n  {name: heavy_tail, p: 0.1}\n]\nz: 1\n"),
            (
                "a: [ä]\neffects: [{b: 1}] # x\nz: 1\n",
                "a: [ä]\neffects: [{b: 1},\n  # why\n  {name: heavy_tail, p: 0.1}\n] # x\nz: 1\n",
            ),
        ] {
            assert_eq!(grown(text, "effects", &entries()), expected);
        }
    }

    #[test]
    fn a_path_leads_from_one_folder_to_another() {
        let path =
            |target: &str, from: &str| relative(Path::new(target), Path::new(from)).display().to_string();
        assert_eq!(path("/a/maps/m.yaml", "/a/b/found"), "../../maps/m.yaml");
        assert_eq!(path("/a/b/m.yaml", "/a/b"), "m.yaml");
        assert_eq!(path("/maps/m.yaml", "/a/b"), "/maps/m.yaml");
    }

    /// Names that would end a comment or a word in quotes, in YAML 1.2 or 1.1.
    fn hostile_names() -> Vec<String> {
        let endings = [
            "\n", "\r", "\r\n", "\u{85}", "\u{2028}", "\u{2029}", "\0", "\u{feff}", "\u{202e}", "\"\n", "'\n",
        ];
        let with = |end| format!("drive{end}seed: 99{end}trials: 7 # ");
        endings
            .into_iter()
            .map(with)
            .chain(["x".repeat(5_000_000), "\\".to_owned(), "\"".to_owned()])
            .collect()
    }

    #[test]
    fn a_name_adds_no_key_and_no_line_to_the_scenario() {
        let keys = |text: &str| {
            let (tree, _) = crate::yaml::parse::<serde_json::Value>(Path::new("s.yaml"), text).unwrap();
            tree.as_object().unwrap().keys().cloned().collect::<Vec<_>>()
        };
        for name in hostile_names() {
            for text in ["seed: 1\n", "seed: 1\neffects: [{name: glass}]\n"] {
                let comments = vec![format!("Found in {} by us", quoted(&name))];
                let grown = grown(text, "effects", &[Entry { comments, ..entries().remove(0) }]);
                assert_eq!(keys(&grown), ["effects", "seed"], "{grown:?}");
                assert!(grown.len() < 1000 && !grown.contains(|c| is_hidden(c) && c != '\n'), "{grown:?}");
            }
            let text = format!("seed: 1\nfile: {}\nend: 2\n", quoted_text(&name));
            assert_eq!(text.lines().count(), 3, "{text:?}");
            if name.len() < 1000 {
                let (tree, _) = crate::yaml::parse::<serde_json::Value>(Path::new("s.yaml"), &text).unwrap();
                assert_eq!(tree["file"], name.as_str());
                assert_eq!(tree["end"], 2);
            }
        }
    }
}
