//! The body of a page, from Markdown.

use locsim_core::limits::is_hidden;
use pulldown_cmark::{Alignment, CowStr, Event, Options, Parser, Tag, TagEnd};

use crate::figures::Figure;
use crate::text;

/// The Markdown's events with figures in place of images, tables whose cells know their column, no links, and no raw HTML
/// but a fold's. Ours has no links, so one that is there comes from outside.
pub(super) fn events<'a>(markdown: &'a str, figures: &'a [Figure]) -> Vec<Event<'a>> {
    let mut events = Vec::new();
    let mut in_image = false;
    let mut table = Columns::default();
    for event in Parser::new_ext(markdown, Options::ENABLE_TABLES) {
        match event {
            Event::Start(Tag::Image { dest_url, .. }) => {
                in_image = true;
                let figure = figures.iter().find(|f| *dest_url == *f.path());
                events.extend(figure.map(|f| Event::InlineHtml(CowStr::from(inline(f)))));
            }
            Event::End(TagEnd::Image) => in_image = false,
            _ if in_image => {}
            Event::Start(Tag::Link { .. }) | Event::End(TagEnd::Link) => {}
            Event::Html(text) => events.extend(fold(&text).unwrap_or_else(|| vec![Event::Text(shown(text))])),
            Event::InlineHtml(text) | Event::Text(text) => {
                let text = shown(text);
                table.add_to_title(&text);
                events.push(Event::Text(text));
            }
            Event::Code(code) => events.push(Event::Code(shown(code))),
            Event::Start(Tag::Table(alignments)) => {
                table = Columns { alignments: alignments.clone(), ..Columns::default() };
                events.push(Event::Html("<div class=\"wide\">".into()));
                events.push(Event::Start(Tag::Table(alignments)));
            }
            Event::End(TagEnd::Table) => {
                events.push(Event::End(TagEnd::Table));
                events.push(Event::Html("</div>\n".into()));
            }
            Event::Start(Tag::TableHead) => {
                table.in_head = true;
                events.push(event);
            }
            Event::End(TagEnd::TableHead) => {
                table.in_head = false;
                events.push(event);
            }
            Event::Start(Tag::TableRow) => {
                table.next = 0;
                events.push(event);
            }
            Event::Start(Tag::TableCell) if table.in_head => {
                table.titles.push(String::new());
                events.push(event);
            }
            Event::Start(Tag::TableCell) => events.push(Event::Html(table.cell().into())),
            Event::End(TagEnd::TableCell) if !table.in_head => events.push(Event::Html("</td>".into())),
            other => events.push(other),
        }
    }
    events
}

/// The columns of a table. On a narrow screen a row is a list, where each cell has its column's title beside it.
#[derive(Default)]
struct Columns {
    alignments: Vec<Alignment>,
    titles: Vec<String>,
    in_head: bool,
    /// Column of the next cell.
    next: usize,
}

impl Columns {
    fn add_to_title(&mut self, text: &str) {
        if let Some(title) = self.titles.last_mut().filter(|_| self.in_head) {
            title.push_str(text);
        }
    }

    /// The start tag of the next cell.
    fn cell(&mut self) -> String {
        let title = self.titles.get(self.next).map_or("", String::as_str);
        let title = title.replace('&', "&amp;").replace('"', "&quot;").replace('<', "&lt;");
        let is_right = self.alignments.get(self.next) == Some(&Alignment::Right);
        self.next += 1;
        let style = if is_right { " style=\"text-align: right\"" } else { "" };
        format!("<td data-column=\"{title}\"{style}>")
    }
}

/// The events of a line of HTML that starts or ends a fold, or is its summary.
fn fold(line: &str) -> Option<Vec<Event<'static>>> {
    let line = line.trim();
    let html = |tag: &'static str| Event::Html(tag.into());
    match line {
        "<details>" => Some(vec![html("<details>\n")]),
        "</details>" => Some(vec![html("</details>\n")]),
        _ => {
            let summary = line.strip_prefix("<summary>")?.strip_suffix("</summary>")?;
            let text = Event::Text(text::visible(summary).into());
            Some(vec![html("<summary>"), text, html("</summary>\n")])
        }
    }
}

/// Text on a page.
fn shown(text: CowStr<'_>) -> CowStr<'_> {
    if text.contains(is_hidden) { text::visible(&text).into() } else { text }
}

/// A figure as inline SVG, named for screen readers, in a box that scrolls where the figure would be too small.
fn inline(figure: &Figure) -> String {
    let label = format!("<svg role=\"img\" aria-label=\"{}\" ", figure.name.replace('_', " "));
    format!("<span class=\"wide\">{}</span>", figure.svg.trim_end().replacen("<svg ", &label, 1))
}
