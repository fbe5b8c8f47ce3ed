//! The report: Markdown from a template, and the same Markdown as a page that needs nothing else.

use locsim_core::limits::is_hidden;
use minijinja::syntax::SyntaxConfig;
use minijinja::value::Serde;
use minijinja::{Environment, context};
use pulldown_cmark::{CowStr, Event, Options, Parser, Tag, TagEnd, html as to_html};
use serde::Serialize;

use super::figures::Figure;
use super::findings::{self, NP_REG, PAPER};
use super::text::{self, TextTable};
use super::{ReportContext, ReportError};
use crate::results::RunResults;
use crate::summary::{CLASSIC, Kept, ORACLE, Summary};

const MARKDOWN: &str = include_str!("templates/report.md.j2");
const PAGE: &str = include_str!("templates/page.html.j2");

/// A figure as the template names it.
#[derive(Serialize)]
struct FigureLink<'a> {
    name: &'a str,
    caption: &'a str,
    path: String,
}

/// Figures of one trial come apart from those of all.
const OF_ONE_TRIAL: [&str; 3] = ["trajectories", "filter_snapshots", "predicted_densities"];

/// The report as Markdown; figures are linked as `figures/NAME.svg`.
pub(crate) fn markdown(
    results: &RunResults,
    summary: &Summary,
    figures: &[Figure],
    context: &ReportContext,
) -> Result<String, ReportError> {
    let mut environment = Environment::new();
    environment.set_syntax(SyntaxConfig::builder().trim_blocks(true).lstrip_blocks(true).build()?);
    environment.add_template("report.md", MARKDOWN)?;
    let [errors, others] = text::headline_tables(summary).map(|t| t.to_markdown());
    let pick = |of_one: bool| -> Vec<FigureLink<'_>> {
        figures
            .iter()
            .filter(|f| OF_ONE_TRIAL.contains(&f.name) == of_one)
            .map(|f| FigureLink { name: f.name, caption: &f.caption, path: f.path() })
            .collect()
    };
    let has = |name: &str| summary.models.contains_key(name);
    let with_paper = context.simulated && has(CLASSIC) && has(NP_REG);
    let descriptions: Vec<(String, &str)> = results
        .models
        .iter()
        .filter_map(|name| Some((text::escape(name), findings::describe(name)?)))
        .collect();
    let page = context! {
        title => text::escape(&results.scenario),
        description => text::escape(&results.description),
        seed => results.seed,
        trials => summary.trials,
        model_count => results.models.len(),
        seconds => format!("{:.1}", results.seconds),
        simulated => context.simulated,
        truth => if context.simulated { "true pose" } else { "reference pose" },
        error_frame => text::escape(&results.error_frame),
        estimate => text::escape(&results.estimate),
        errors_table => errors,
        others_table => others,
        has_classic => has(CLASSIC),
        has_oracle => has(ORACLE),
        comparisons => findings::comparisons(summary),
        paper_table => with_paper.then(|| paper_table(summary).to_markdown()),
        paper_findings => findings::beside_the_paper(summary),
        aims => findings::aims(summary),
        reasons => findings::reasons(summary),
        lost => findings::lost_trials(summary),
        any_lost => summary.models.values().any(|m| m.lost_share > 0.0),
        kept_table => kept_table(summary).to_markdown(),
        kept_ratios => kept_ratios(summary).to_markdown(),
        training_table => training_table(summary).to_markdown(),
        chosen => findings::chosen(summary),
        training => findings::training(summary),
        figures => Serde(pick(false)),
        trial_figures => Serde(pick(true)),
        descriptions => Serde(descriptions),
        replicates => crate::statistics::REPLICATES,
        warnings => context.warnings.iter().map(|warning| text::escape(warning)).collect::<Vec<_>>(),
        notes => context.notes.iter().map(|note| text::escape(note)).collect::<Vec<_>>(),
        command => context.command.trim(),
        scenario_yaml => context.scenario_yaml.trim_end(),
        fence => fence(&[&context.scenario_yaml, &context.command]),
    };
    Ok(environment.get_template("report.md")?.render(page)?)
}

/// The paper's Table II beside ours.
fn paper_table(summary: &Summary) -> TextTable {
    let rows = PAPER.iter().filter_map(|(name, mean, std)| {
        let errors = summary.models.get(*name)?.errors;
        Some([
            (*name).to_owned(),
            text::mean_std(*mean, *std, 3),
            text::mean_std(errors.along.mean_m, errors.along.std_m, 4),
            text::mean_std(errors.across.mean_m, errors.across.std_m, 4),
        ])
    });
    TextTable::new(["model", "paper, Table II [m]", "ours along [m]", "ours across [m]"], rows)
}

/// Errors of each model over the trials it kept.
fn kept_table(summary: &Summary) -> TextTable {
    let kept: Vec<(&str, &Kept)> =
        summary.models.iter().filter_map(|(name, m)| Some((name.as_str(), m.kept.as_ref()?))).collect();
    let mut table = text::errors_table(kept.iter().map(|(name, k)| (*name, &k.errors, k.intervals.as_ref())));
    table.header.insert(1, "trials kept".to_owned());
    for (row, (_, kept)) in table.rows.iter_mut().zip(kept) {
        row.insert(1, kept.trials.to_string());
    }
    table
}

/// Ratios over the trials that neither model lost.
fn kept_ratios(summary: &Summary) -> TextTable {
    TextTable::new(
        ["model", "std / classic", "RMSE / classic", "RMSE / oracle"],
        summary.ratios_kept.iter().map(|(name, ratios)| {
            [
                name.to_owned(),
                text::ratio(ratios.position_std_vs_classic),
                text::ratio(ratios.rmse_vs_classic),
                text::ratio(ratios.rmse_vs_oracle),
            ]
        }),
    )
}

fn training_table(summary: &Summary) -> TextTable {
    TextTable::new(
        ["model", "log loss [nats]", "histogram match [m]"],
        summary.models.iter().map(|(name, model)| {
            [
                name.to_owned(),
                text::optional(model.train.log_loss_nats, 3),
                text::optional(model.train.histogram_match_m, 4),
            ]
        }),
    )
}

/// A code fence longer than any run of backticks in the texts.
pub fn fence(texts: &[&str]) -> String {
    let longest = texts.iter().flat_map(|t| t.split(|c| c != '`').map(str::len)).max().unwrap_or(0);
    "`".repeat(longest.max(2) + 1)
}

/// The Markdown as one self-contained page: figures inline, no script, no links, nothing loaded from elsewhere. HTML in the
/// Markdown is shown as text, and so are hidden characters.
///
/// # Errors
/// [`ReportError::Template`].
pub fn html(title: &str, markdown: &str, figures: &[Figure]) -> Result<String, ReportError> {
    let mut body = String::new();
    to_html::push_html(&mut body, page_events(markdown, figures).into_iter());
    let mut environment = Environment::new();
    environment.add_template("page.html", PAGE)?;
    Ok(environment.get_template("page.html")?.render(context! { title => text::visible(title), body })?)
}

/// The Markdown's events with figures in place of images, tables that scroll by themselves, no links and no raw HTML. Ours
/// has no links, so one that is there comes from outside.
fn page_events<'a>(markdown: &'a str, figures: &'a [Figure]) -> Vec<Event<'a>> {
    let mut events = Vec::new();
    let mut in_image = false;
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
            Event::Html(text) | Event::InlineHtml(text) | Event::Text(text) => {
                events.push(Event::Text(shown(text)));
            }
            Event::Code(code) => events.push(Event::Code(shown(code))),
            Event::Start(Tag::Table(alignments)) => {
                events.push(Event::Html("<div class=\"wide\">".into()));
                events.push(Event::Start(Tag::Table(alignments)));
            }
            Event::End(TagEnd::Table) => {
                events.push(Event::End(TagEnd::Table));
                events.push(Event::Html("</div>\n".into()));
            }
            other => events.push(other),
        }
    }
    events
}

/// Text on a page.
fn shown(text: CowStr<'_>) -> CowStr<'_> {
    if text.contains(is_hidden) { text::visible(&text).into() } else { text }
}

/// A figure as inline SVG, named for screen readers, in a box that scrolls on a narrow screen.
fn inline(figure: &Figure) -> String {
    let label = format!("<svg role=\"img\" aria-label=\"{}\" ", figure.name.replace('_', " "));
    format!("<span class=\"wide\">{}</span>", figure.svg.trim_end().replacen("<svg ", &label, 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fence_is_longer_than_what_it_holds() {
        assert_eq!(fence(&["plain"]), "```");
        assert_eq!(fence(&["a ```` b", "`"]), "`````");
    }

    #[test]
    fn nothing_from_outside_is_a_link_or_a_picture_or_html() {
        let hostile = [
            "[x](javascript:alert(1))",
            "[x](<javascript:alert(1)>)",
            "<javascript:alert(1)>",
            "<https://example.com/>",
            "<a href=\"javascript:alert(1)\">x</a>",
            "<img src=x onerror=alert(1)>",
            "![x](http://example.com/a.png)",
            "![x][y]",
            "[y]: javascript:alert(1) \"t\"",
            "[y]",
            "&#91;x&#93;&#40;javascript:alert(1)&#41;",
            "<svg onload=alert(1)>",
            "</pre></code><script>alert(1)</script>",
            "````\n<b>\n````",
            "a | b | <i>c",
            "\u{202e}gnp.exe",
            "x\r\n\r\n<script>alert(1)</script>",
            "\\[x](javascript:alert(1))",
            "\\\\[x](javascript:alert(1))",
            "!\\[x](javascript:alert(1))",
            "`[x](javascript:alert(1))",
        ];
        for text in hostile {
            // As foreign text stands on our pages, and as if somebody forgot to escape it.
            let table = TextTable::new([text, "b"], [[text.to_owned(), text.to_owned()]]);
            let escaped = format!("# {0}\n\n{0}\n\n- {0}\n\n{1}\n", text::escape(text), table.to_markdown());
            let fence = fence(&[text]);
            let raw = format!("{text}\n\n[y]: javascript:alert(1)\n\n{fence}sh\n{text}\n{fence}\n");
            for (markdown, is_escaped) in [(escaped, true), (raw, false)] {
                let page = html(text, &markdown, &[]).unwrap();
                let (_, body) = page.split_once("<title>").unwrap();
                for tag in ["<a", "<img", "<script", "<svg", "<b>", "<i>", "\u{202e}"] {
                    assert!(!body.contains(tag), "{tag} of {text}:\n{body}");
                }
                if is_escaped {
                    let heading = body.split_once("<h1>").unwrap().1.split_once("</h1>").unwrap().0;
                    let shown = text::visible(&text.replace('\n', " ")).replace('&', "&amp;");
                    let shown = shown.replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;");
                    assert_eq!(heading.replace('"', "&quot;"), shown);
                }
            }
        }
    }
}
