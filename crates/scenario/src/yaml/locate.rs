use super::tree::{Entry, Node, Value};

/// Where each key of a YAML text stands.
#[derive(Debug)]
pub struct Locations(Node);

impl Locations {
    pub(crate) fn new(root: Node) -> Self {
        Self(root)
    }

    /// The tree itself.
    pub(crate) fn root(&self) -> &Node {
        &self.0
    }

    /// Line of a key, or of the nearest key that contains it. Command-line options (`--trials`) have none.
    pub fn line(&self, key: &str) -> Option<usize> {
        if key.starts_with("--") {
            return None;
        }
        let (mut node, mut line, mut rest) = (&self.0, self.0.line, key);
        while let Some((next, at, after)) = step(node, rest) {
            (node, line, rest) = (next, at, after);
        }
        Some(line)
    }
}

/// Into the element or key that a path begins with: its value, its line and the rest of the path.
fn step<'a, 'p>(node: &'a Node, path: &'p str) -> Option<(&'a Node, usize, &'p str)> {
    match node.value() {
        Value::List(items) => {
            let (index, rest) = path.strip_prefix('[')?.split_once(']')?;
            let item = items.get(index.parse::<usize>().ok()?)?;
            Some((item, item.line, rest))
        }
        Value::Map(entries) => {
            let path = path.strip_prefix('.').unwrap_or(path);
            let within = |entry: &&Entry| {
                let rest = path.strip_prefix(&*entry.key);
                rest.is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
            };
            // Keys may hold dots: the longest that fits.
            let entry = entries.iter().filter(within).max_by_key(|entry| entry.key.len())?;
            Some((&entry.value, entry.line, &path[entry.key.len()..]))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use locsim_core::limits::Limits;

    use super::super::tree;
    use super::*;

    fn locations(text: &str) -> Locations {
        Locations(tree::read(text, &Limits::DEFAULT).unwrap().unwrap())
    }

    #[test]
    fn every_key_and_element_has_the_line_it_stands_on() {
        let text = "# comment\na: 1\nb:\n  c: [1,\n    2]\n  d:\n    - {e: &x 3}\n    -\n      e: *x\n'f g': |\n  h: 5\ni: 6\nb.c: 7\n";
        let locations = locations(text);
        for (key, line) in [
            ("", 2),
            ("a", 2),
            ("b", 3),
            ("b.c", 13),
            ("b.c[1]", 13),
            ("b.d", 6),
            ("b.d[0].e", 7),
            ("b.d[1].e", 9),
            ("f g", 10),
            ("i", 12),
        ] {
            assert_eq!(locations.line(key), Some(line), "{key}");
        }
        let locations = self::locations("b:\n  c: [1,\n    2]\n");
        assert_eq!((locations.line("b.c[0]"), locations.line("b.c[1]")), (Some(2), Some(3)));
    }

    #[test]
    fn a_key_that_is_not_there_has_the_line_of_the_map_it_belongs_in() {
        let locations = locations("a: 1\nb:\n  c:\n    - d: 2\n");
        assert_eq!(locations.line("b.c[0].missing"), Some(4));
        assert_eq!(locations.line("b.c[7]"), Some(3));
        assert_eq!(locations.line("b.x.y"), Some(2));
        assert_eq!(locations.line("x"), Some(1));
        assert_eq!(locations.line("--trials"), None);
    }
}
