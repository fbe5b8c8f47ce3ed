//! The report: Markdown from a template, and the same Markdown as a page that needs nothing else.

mod body;

use minijinja::syntax::SyntaxConfig;
use minijinja::value::Serde;
use minijinja::{Environment, context};
use pulldown_cmark::html as to_html;
use serde::Serialize;

use super::figures::Figure;
use super::findings::{self, NP_REG, PAPER};
use super::text::{self, TextTable};
use super::{ReportContext, ReportError};
use crate::results::{RunResults, USUAL_SCAN};
use crate::summary::{CLASSIC, Kept, ORACLE, Summary};

const MARKDOWN: &str = include_str!("../templates/report.md.j2");
const PAGE: &str = include_str!("../templates/page.html.j2");

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
        one_drive => summary.one_drive,
        rehearsed => summary.models.values().any(|model| model.train.chosen.contains_key(USUAL_SCAN)),
        truth => if context.simulated { "true pose" } else { "reference pose" },
        error_frame => text::escape(&results.error_frame),
        estimate => text::escape(&results.estimate),
        errors_table => errors,
        others_table => others,
        localized_table => text::localized_table(summary).map(|table| table.to_markdown()),
        localized_within => results.localized_within_m.map(text::significant),
        first => (!has(CLASSIC) && results.models.len() > 1).then(|| text::code(summary.baseline())),
        has_oracle => has(ORACLE),
        shares => !has(ORACLE) && summary.shares_errors(),
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
        warnings => context.warnings.iter().map(|warning| text::sentence(warning)).collect::<Vec<_>>(),
        notes => context.notes.iter().map(|note| text::sentence(note)).collect::<Vec<_>>(),
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
    let [std, rmse] = ["std", "RMSE"].map(|figure| format!("{figure} / {}", summary.baseline()));
    let mut table = TextTable::new(
        ["model", &std, &rmse, "RMSE / oracle"],
        summary.ratios_kept.iter().map(|(name, ratios)| {
            [
                name.to_owned(),
                text::ratio(ratios.position_std()),
                text::ratio(ratios.rmse()),
                text::ratio(ratios.rmse_vs_oracle),
            ]
        }),
    );
    if !summary.models.contains_key(ORACLE) {
        table.drop_last_column();
    }
    table
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
/// Markdown is shown as text, but for a fold's (`<details>`), and so are hidden characters.
///
/// # Errors
/// [`ReportError::Template`].
pub fn html(title: &str, markdown: &str, figures: &[Figure]) -> Result<String, ReportError> {
    let mut body = String::new();
    to_html::push_html(&mut body, body::events(markdown, figures).into_iter());
    let mut environment = Environment::new();
    environment.add_template("page.html", PAGE)?;
    Ok(environment.get_template("page.html")?.render(context! { title => text::visible(title), body })?)
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
    fn a_fold_is_the_only_html() {
        let fold = "<details>\n<summary>2 of <b>them</b></summary>\n\n| a |\n| :-- |\n| x |\n\n</details>\n";
        let page = html("t", fold, &[]).unwrap();
        let start = "<details>\n<summary>2 of &lt;b&gt;them&lt;/b&gt;</summary>\n";
        assert!(page.contains(start) && page.contains("</details>\n"), "{page}");
        for other in ["<details open>", "<details onclick=\"x\">", "<div>", "</div>", "<summary>"] {
            let page = html("t", &format!("{other}\n"), &[]).unwrap();
            let shown = other.replace('<', "&lt;").replace('>', "&gt;");
            assert!(page.contains(&shown) && !page.contains(&format!("\n{other}")), "{page}");
        }
    }

    #[test]
    fn a_cell_knows_its_column() {
        let header = ["model", "a \"b\" <c> & d"];
        let table = TextTable::new(header, [["classic".to_owned(), "0.1 [0.0, 0.2]".to_owned()]]);
        let page = html("t", &table.to_markdown(), &[]).unwrap();
        assert!(page.contains("<td data-column=\"model\">classic</td>"), "{page}");
        let cell = "<td data-column=\"a &quot;b&quot; &lt;c> &amp; d\" style=\"text-align: right\">0.1 [0.0, 0.2]</td>";
        assert!(page.contains(cell), "{page}");
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
