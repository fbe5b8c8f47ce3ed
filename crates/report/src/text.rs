//! Tables and numbers as text, for the terminal and for Markdown.

use comfy_table::presets::{NOTHING, UTF8_HORIZONTAL_ONLY};
use comfy_table::{CellAlignment, ColumnConstraint, ContentArrangement, LineStyle, Table};
use locsim_core::Interval;
use locsim_core::limits::is_hidden;

use crate::statistics::share_interval;
use crate::summary::{Errors, ORACLE, Ratio, Summary};

/// Placeholder of a missing value.
pub const NONE: &str = "-";

/// Where cells of a table that is too wide are broken, and what stands there then: nowhere, then before units, intervals and
/// deviations, then within intervals and names of message types as well.
const BREAKS: [&[[&str; 2]]; 3] = [
    &[],
    &[[" [", "\n["], [" ±", "\n±"], [" /", "\n/"]],
    &[[" [", "\n["], [" ±", "\n±"], [" /", "\n/"], [", ", ",\n"], ["/msg/", "/msg/\n"]],
];

/// A table of text; the first column is aligned left, the others right.
#[derive(Clone, Debug, PartialEq)]
pub struct TextTable {
    /// Column titles with units.
    pub header: Vec<String>,
    /// Rows of as many cells.
    pub rows: Vec<Vec<String>>,
}

impl TextTable {
    /// A table with these column titles and rows.
    pub fn new<const N: usize>(header: [&str; N], rows: impl IntoIterator<Item = [String; N]>) -> Self {
        Self { header: header.map(str::to_owned).to_vec(), rows: rows.into_iter().map(Vec::from).collect() }
    }

    /// For a terminal of `width` columns; `None` where the table may be as wide as its content. In a table that is too wide,
    /// a cell's interval stands below its value. If that does not do, columns are left out from the right, and named.
    pub fn to_terminal(&self, width: Option<usize>) -> String {
        let fits =
            |text: &String| width.is_none_or(|width| text.lines().all(|line| line.chars().count() <= width));
        let broken = BREAKS.iter().map(|breaks| self.drawn(self.header.len(), breaks)).find(fits);
        broken.unwrap_or_else(|| {
            let narrower = (1..self.header.len()).rev().map(|columns| {
                let table = self.drawn(columns, BREAKS[BREAKS.len() - 1]);
                (fits(&table) || columns == 1)
                    .then(|| format!("{table}\nleft out: {}", self.header[columns..].join(", ")))
            });
            narrower.flatten().next().unwrap_or_default()
        })
    }

    /// The first columns of the table, with lines of cells broken at some places.
    fn drawn(&self, columns: usize, breaks: &[[&str; 2]]) -> String {
        let cells = |row: &[String]| -> Vec<String> {
            let broken = |cell: &String| {
                breaks.iter().fold(cell.clone(), |cell, [at, broken]| cell.replace(at, broken))
            };
            row.iter().take(columns).map(broken).collect()
        };
        let mut table = Table::new();
        let rows = self.rows.iter().map(|row| cells(row));
        table.load_style(UTF8_HORIZONTAL_ONLY).set_header(cells(&self.header)).add_rows(rows);
        // Rules between rows only cost lines.
        table.style_mut().row_separator = LineStyle::none();
        if !breaks.is_empty() {
            // Two blanks between columns, not three.
            table.column_iter_mut().for_each(|column| {
                column.set_padding((0, 1));
            });
        }
        for column in table.column_iter_mut().skip(1) {
            column.set_cell_alignment(CellAlignment::Right);
        }
        table.trim_fmt()
    }

    /// Leaves the last column out.
    pub fn drop_last_column(&mut self) {
        for row in self.rows.iter_mut().chain([&mut self.header]) {
            row.pop();
        }
    }

    /// Leaves the intervals of columns out whose title begins so.
    fn drop_intervals(&mut self, title: &str) {
        for column in
            (0..self.header.len()).filter(|i| self.header[*i].starts_with(title)).collect::<Vec<_>>()
        {
            for row in &mut self.rows {
                let value = row[column].find(" [").unwrap_or(row[column].len());
                row[column].truncate(value);
            }
        }
    }

    /// As a Markdown table (GitHub's extension).
    pub fn to_markdown(&self) -> String {
        let line = |cells: &mut dyn Iterator<Item = String>| {
            format!("| {} |\n", cells.collect::<Vec<_>>().join(" | "))
        };
        let rule = |i: usize| if i == 0 { ":--" } else { "--:" }.to_owned();
        let mut text = line(&mut self.header.iter().map(|c| escape(c)));
        text += &line(&mut (0..self.header.len()).map(rule));
        for row in &self.rows {
            text += &line(&mut row.iter().map(|c| escape(c)));
        }
        text
    }
}

/// Names and texts in two columns, indented by two blanks, for a terminal of `width` columns: texts are wrapped there, and
/// nowhere where it is `None`.
pub fn listing<N: AsRef<str>>(rows: &[(N, String)], width: Option<usize>) -> String {
    let mut table = Table::new();
    table.load_style(NOTHING).add_rows(rows.iter().map(|(name, text)| [name.as_ref(), text]));
    if let Some(width) = width.and_then(|width| u16::try_from(width).ok()) {
        table.set_content_arrangement(ContentArrangement::Dynamic).set_width(width);
    }
    if let Some(names) = table.column_mut(0) {
        names.set_padding((2, 1)).set_constraint(ColumnConstraint::ContentWidth);
    }
    table.trim_fmt() + "\n"
}

/// Text that Markdown shows as it is, in a line of its own or a table's cell: no link, picture, HTML or other markup comes
/// of it. Hidden characters are shown by their numbers, an end of a line as a space. Underscores within words and
/// brackets stay as they are: they mean nothing to Markdown.
pub fn escape(text: &str) -> String {
    let text = text.trim();
    let mut escaped = String::with_capacity(text.len());
    let mut before = ' ';
    let mut characters = text.chars().peekable();
    // Marks of headings, lists, quotes and rules count at the start alone.
    let mut at_start = true;
    while let Some(c) = characters.next() {
        let after = characters.peek().copied().unwrap_or(' ');
        let markup = match c {
            '\\' | '|' | '*' | '`' | '<' | '&' | '#' | '~' | '$' => true,
            // Of a link.
            '(' => before == ']',
            // Of a reference and of what it refers to.
            '[' => at_start || before == ']',
            '_' => !(before.is_alphanumeric() && after.is_alphanumeric()),
            // Numbers may be negative, and a dash alone stands for a value that is missing.
            '-' | '+' => at_start && !after.is_ascii_digit() && text != NONE,
            '=' | '>' => at_start,
            '.' | ')' => at_start && before.is_ascii_digit() && after.is_whitespace(),
            _ => false,
        };
        at_start &= c.is_ascii_digit();
        before = c;
        if c == '\n' {
            escaped.push(' ');
        } else if is_hidden(c) {
            // Its backslash needs another.
            escaped.push('\\');
            escaped.extend(c.escape_unicode());
        } else {
            escaped.extend(markup.then_some('\\'));
            escaped.push(c);
        }
    }
    escaped
}

/// A sentence of the program's own: as [`escape`], but a plain name between backticks is code.
pub fn sentence(text: &str) -> String {
    let escaped = escape(text);
    let parts: Vec<&str> = escaped.split("\\`").collect();
    let is_name = |c: char| c.is_ascii_alphanumeric() || "_-./:".contains(c);
    let is_code =
        |i: usize| i % 2 == 1 && i + 1 < parts.len() && !parts[i].is_empty() && parts[i].chars().all(is_name);
    let mut sentence = String::with_capacity(escaped.len());
    for (i, part) in parts.iter().enumerate() {
        if i > 0 {
            let is_mark = is_code(i) || is_code(i - 1);
            sentence += if is_mark { "`" } else { "\\`" };
        }
        sentence += part;
    }
    sentence
}

/// A name as code in Markdown.
pub fn code(name: &str) -> String {
    format!("`{}`", visible(name).replace('`', "'").replace('\n', " "))
}

/// Text with hidden characters shown by their numbers, but for ends of lines and tabs.
pub fn visible(text: &str) -> String {
    text.chars().fold(String::with_capacity(text.len()), |mut shown, c| {
        if is_hidden(c) && !matches!(c, '\n' | '\t') {
            shown.extend(c.escape_unicode());
        } else {
            shown.push(c);
        }
        shown
    })
}

/// A number with this many decimals; zero has no sign.
pub fn fixed(value: f64, decimals: usize) -> String {
    if value.is_nan() {
        return "-".to_owned();
    }
    let text = format!("{value:.decimals$}");
    if text.bytes().all(|b| matches!(b, b'-' | b'0' | b'.')) { text.replace('-', "") } else { text }
}

/// A number with three significant digits, as 1.00e-6 where it is small.
pub fn significant(value: f64) -> String {
    let magnitude = if value == 0.0 { 0.0 } else { value.abs().log10().floor() };
    if magnitude < -5.0 {
        return format!("{value:.2e}");
    }
    fixed(value, (2.0 - magnitude).clamp(0.0, 12.0) as usize)
}

/// Metres, to a tenth of a millimetre.
pub fn metres(value: f64) -> String {
    fixed(value, 4)
}

/// `value [lo, hi]` in metres.
pub fn metres_with(value: f64, interval: Option<Interval>) -> String {
    with_interval(value, interval, 4)
}

/// `value [lo, hi]`, the value alone without an interval.
pub fn with_interval(value: f64, interval: Option<Interval>, decimals: usize) -> String {
    let value = fixed(value, decimals);
    match interval {
        Some(Interval { lo, hi }) => format!("{value} [{}, {}]", fixed(lo, decimals), fixed(hi, decimals)),
        None => value,
    }
}

/// `mean ± std` with this many decimals.
pub fn mean_std(mean: f64, std: f64, decimals: usize) -> String {
    format!("{} ± {}", fixed(mean, decimals), fixed(std, decimals))
}

/// A ratio with its interval.
pub fn ratio(ratio: Option<Ratio>) -> String {
    ratio.map_or_else(|| NONE.to_owned(), |r| with_interval(r.value, r.interval(), 2))
}

/// A share in percent.
pub fn percent(share: f64) -> String {
    format!("{:.1}", 100.0 * share)
}

/// A value that may be missing.
pub fn optional(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(|| NONE.to_owned(), |v| fixed(v, decimals))
}

/// Errors of each model, one row per `(model, errors, intervals)`.
pub fn errors_table<'a>(
    rows: impl Iterator<Item = (&'a str, &'a Errors, Option<&'a Errors<Interval>>)>,
) -> TextTable {
    TextTable::new(
        ["model", "along [m]", "across [m]", "heading [deg]", "RMSE [m]", "p50 [m]", "p95 [m]"],
        rows.map(|(model, errors, intervals)| {
            [
                model.to_owned(),
                mean_std(errors.along.mean_m, errors.along.std_m, 4),
                mean_std(errors.across.mean_m, errors.across.std_m, 4),
                mean_std(errors.heading.mean_rad.to_degrees(), errors.heading.std_rad.to_degrees(), 2),
                metres_with(errors.position_rmse_m, intervals.map(|i| i.position_rmse_m)),
                metres(errors.position_median_m),
                metres(errors.position_p95_m),
            ]
        }),
    )
}

/// The two halves of the headline table: errors, then everything else.
pub fn headline_tables(summary: &Summary) -> [TextTable; 2] {
    let errors = errors_table(
        summary
            .models
            .iter()
            .map(|(name, m)| (name.as_str(), &m.errors, m.intervals.as_ref().map(|i| &i.errors))),
    );
    let [std, rmse] = ["std", "RMSE"].map(|figure| format!("{figure} / {}", summary.baseline()));
    let has_oracle = summary.models.contains_key(ORACLE);
    let last = if has_oracle { "RMSE / oracle" } else { "NEES, shared" };
    let mut others = TextTable::new(
        ["model", "lost [%]", "ESS", "NEES", "ms/step", &std, &rmse, last],
        summary.models.iter().zip(summary.ratios.values()).map(|((name, model), ratios)| {
            [
                name.to_owned(),
                percent(model.lost_share),
                format!("{:.1}", model.ess_mean),
                nees_text(model.nees_mean, model.nees_intervals.map(|i| i.nees_mean)),
                format!("{:.2}", model.step_ms),
                ratio(ratios.position_std()),
                ratio(ratios.rmse()),
                if has_oracle {
                    ratio(ratios.rmse_vs_oracle)
                } else {
                    let interval = model.nees_intervals.map(|i| i.nees_with_shared_errors_mean);
                    nees_text(model.nees_with_shared_errors_mean, interval)
                },
            ]
        }),
    );
    if !has_oracle && !summary.shares_errors() {
        others.drop_last_column();
    }
    [errors, others]
}

/// A mean NEES with its interval.
fn nees_text(mean: f64, interval: Option<Interval>) -> String {
    let interval = interval.map_or_else(String::new, |Interval { lo, hi }| {
        format!(" [{}, {}]", significant(lo), significant(hi))
    });
    format!("{}{interval}", significant(mean))
}

/// How soon each model finds the robot from an unknown start, a row each; `None` where the start is known.
pub fn localized_table(summary: &Summary) -> Option<TextTable> {
    let share = |count: u32| {
        let interval = share_interval(count, summary.trials);
        let share = f64::from(count) / f64::from(summary.trials);
        format!("{} [{}, {}]", percent(share), percent(interval.lo), percent(interval.hi))
    };
    let rows: Option<Vec<[String; 4]>> = summary
        .models
        .iter()
        .map(|(name, model)| {
            let localized = model.localized?;
            let after = localized.after_m_median.map_or_else(|| "never".to_owned(), |after| fixed(after, 1));
            Some([name.clone(), share(localized.trials), share(localized.trials_after_30_m), after])
        })
        .collect();
    let header = ["model", "localized [%]", "within 30 m [%]", "distance until localized, p50 [m]"];
    rows.map(|rows| TextTable::new(header, rows))
}

/// The headline table for a terminal of `width` columns (`None`: of any), in two halves, with a line on how to read it.
pub fn terminal_table(summary: &Summary, width: Option<usize>) -> String {
    let [errors, mut others] = headline_tables(summary);
    // A terminal is narrow.
    others.drop_intervals("NEES");
    let localized =
        localized_table(summary).map_or_else(String::new, |table| format!("{}\n", table.to_terminal(width)));
    let of_ratios = if summary.one_drive { ", of ratios by the steps of the one drive" } else { "" };
    format!(
        "{}: {} trial{}, seed {}\n{}\n{}\n{localized}mean ± standard deviation of signed errors over all steps; [lo, hi]: 95 % \
         bootstrap over trials{of_ratios}\n",
        summary.scenario,
        summary.trials,
        if summary.trials == 1 { "" } else { "s" },
        summary.seed,
        errors.to_terminal(width),
        others.to_terminal(width)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_in_sentences_are_code_and_nothing_else_is() {
        for (text, shown) in [
            ("`blocks.wall_distance_m` up to 2.4", "`blocks.wall_distance_m` up to 2.4"),
            ("`a`, `<b>` and `c", "`a`, \\`\\<b>\\` and \\`c"),
            ("`` and `a b`", "\\`\\` and \\`a b\\`"),
            ("`a` *b*", "`a` \\*b\\*"),
        ] {
            assert_eq!(sentence(text), shown);
        }
    }

    #[test]
    fn text_from_outside_is_neither_markup_nor_a_link() {
        for (text, escaped) in [
            ("np_reg [m]", "np_reg [m]"),
            ("-0.42 [-0.38, 0.46]: two", "-0.42 [-0.38, 0.46]: two"),
            ("[x](http://a) | *b* <i>\n`c`", "\\[x]\\(http://a) \\| \\*b\\* \\<i> \\`c\\`"),
            ("[x]: javascript:a [x][x]", "\\[x]: javascript:a [x]\\[x]"),
            ("a &#40; _b_ c_d", "a \\&\\#40; \\_b\\_ c_d"),
            ("- a - b", "\\- a - b"),
            ("12. a 3. b", "12\\. a 3. b"),
            ("4.5 (a)", "4.5 (a)"),
            ("-", "-"),
            ("---", "\\---"),
            ("a\u{202e}b\u{0}\u{2028}c", "a\\\\u{202e}b\\\\u{0}\\\\u{2028}c"),
        ] {
            assert_eq!(escape(text), escaped);
        }
    }

    #[test]
    fn a_table_becomes_as_narrow_as_the_terminal() {
        let cells = ["np_reg", "0.0016 ± 0.0170", "0.0214 [0.0192, 0.0238]"].map(str::to_owned);
        let table = TextTable::new(["model", "along [m]", "RMSE [m]"], [cells]);
        let drawn = |width: Option<usize>| {
            let text = table.to_terminal(width);
            let widest = text.lines().map(|line| line.chars().count()).max().unwrap();
            assert!(width.is_none_or(|width| widest <= width), "{widest} columns:\n{text}");
            text
        };
        assert!(drawn(None).contains("0.0016 ± 0.0170   0.0214 [0.0192, 0.0238]"), "{}", drawn(None));
        assert_eq!(drawn(None), drawn(Some(60)));
        let [value, interval] = ["0.0016            0.0214", "± 0.0170  [0.0192, 0.0238]"];
        assert!(drawn(Some(40)).contains(value) && drawn(Some(40)).contains(interval), "{}", drawn(Some(40)));
        assert!(drawn(Some(30)).contains("[0.0192,\n"), "{}", drawn(Some(30)));
        assert!(drawn(Some(20)).ends_with("left out: RMSE [m]"), "{}", drawn(Some(20)));
    }

    #[test]
    fn a_rounded_zero_has_no_sign() {
        assert_eq!(fixed(-0.000_01, 4), "0.0000");
        assert_eq!(fixed(-0.000_06, 4), "-0.0001");
        assert_eq!(fixed(10.0, 0), "10");
    }
}
