//! The report of a search: what disagrees and where, why this effect and not another, what remains.

use locsim_dataset::LogKind;
use locsim_gap::{Outcome, Region, Verdict};
use minijinja::syntax::SyntaxConfig;
use minijinja::value::Serde;
use minijinja::{Environment, context};
use serde::Serialize;

use super::{GapStudy, answer, covariate, figures, map_error, next, unnamed};
use locsim_report::figures::Figure;
use locsim_report::store::Folder;
use locsim_report::text::{self, TextTable, fixed, significant};
use locsim_report::{ReportError, page, write_figures};
use locsim_scenario::effect::{in_file, unit};

const MARKDOWN: &str = include_str!("templates/gap.md.j2");

/// Regions in the table; gap.json has all.
const SHOWN_REGIONS: usize = 12;

/// A figure as the template names it.
#[derive(Serialize)]
struct FigureLink<'a> {
    name: &'a str,
    caption: &'a str,
    path: String,
}

/// An effect as the template names it.
#[derive(Serialize)]
struct NamedText<'a> {
    name: &'static str,
    sentence: &'static str,
    formula: &'static str,
    signature: &'static str,
    numbers: String,
    gain: String,
    p: String,
    others: Vec<&'static str>,
    split_by: Option<&'static str>,
    figure: Option<FigureLink<'a>>,
}

/// Writes `figures/`, `report.md` and `report.html` into `folder`. `diff` is between the scenario and the one with the
/// effects.
pub(super) fn write(
    folder: &Folder,
    study: &GapStudy,
    outcome: &Outcome,
    diff: &str,
    command: &str,
) -> Result<(), ReportError> {
    let figures = figures::all(study, outcome)?;
    write_figures(folder, &figures)?;
    let markdown = markdown(study, outcome, &figures, diff, command)?;
    folder.write("report.md", markdown.as_bytes())?;
    Ok(folder.write("report.html", page::html(&title(study), &markdown, &figures)?.as_bytes())?)
}

fn title(study: &GapStudy) -> String {
    let log = study.log.file_name().unwrap_or_default().to_string_lossy();
    format!("{log} against {}", study.scenario.name)
}

fn markdown(
    study: &GapStudy,
    outcome: &Outcome,
    figures: &[Figure],
    diff: &str,
    command: &str,
) -> Result<String, ReportError> {
    let mut environment = Environment::new();
    environment.set_syntax(SyntaxConfig::builder().trim_blocks(true).lstrip_blocks(true).build()?);
    environment.add_template("gap.md", MARKDOWN)?;
    let figure = |name: &str| {
        let figure = figures.iter().find(|figure| figure.name == name)?;
        Some(FigureLink { name: figure.name, caption: &figure.caption, path: figure.path() })
    };
    let link = |name: &str| figure(name).map(Serde);
    // Effects of one kind share a figure.
    let is_first = |i: usize| outcome.effects[..i].iter().all(|named| named.name != outcome.effects[i].name);
    let named = outcome
        .effects
        .iter()
        .enumerate()
        .map(|(i, named)| named_text(named, figure(named.name.name()).filter(|_| is_first(i))));
    let named: Vec<NamedText<'_>> = named.collect();
    let answers: Vec<String> = answer::sentences(outcome).iter().map(|line| text::sentence(line)).collect();
    let nuisances = &outcome.nuisances;
    let (regions, followed) = regions(outcome);
    let page = context! {
        title => text::escape(&title(study)),
        description => text::escape(&study.scenario.description),
        log => text::escape(&study.log.display().to_string()),
        scenario => text::escape(&study.scenario.file.display().to_string()),
        scans => outcome.scans,
        beams => outcome.beams,
        seed => outcome.seed,
        replicates => outcome.detection.replicates,
        seconds => fixed(outcome.seconds, 1),
        verdict => Serde(outcome.verdict),
        steps => next::steps(outcome),
        reference => study.is_localized.then_some(LogKind::LOCALIZED),
        answers => answers,
        named => Serde(named),
        still_off => matches!(outcome.verdict, Verdict::PartlyExplained | Verdict::Unexplained | Verdict::Unnamed),
        remaining => remaining(outcome),
        map => link("map"),
        pit => link("pit"),
        rivals => link("rivals"),
        map_errors => link("map-errors"),
        map_errors_table => outcome.map.as_ref().and_then(map_error::table).map(|table| table.to_markdown()),
        more_map_errors => outcome.map.as_ref().map_or(0, map_error::more),
        wall_mm => nuisances.wall_error_m.map(|error| fixed(1e3 * error, 1)),
        detection_table => detection_table(outcome).to_markdown(),
        regions_table => (!regions.is_empty()).then(|| regions_table(&regions).to_markdown()),
        more_regions => regions.len().saturating_sub(SHOWN_REGIONS),
        followed_table => (!followed.is_empty()).then(|| regions_table(&followed).to_markdown()),
        followed => followed.len(),
        more_followed => followed.len().saturating_sub(SHOWN_REGIONS),
        unnamed_curves => link("unnamed"),
        unnamed_places => link("unnamed-places"),
        unnamed_table => (!outcome.unnamed.is_empty()).then(|| unnamed_table(outcome).to_markdown()),
        rivals_table => (!outcome.rivals.is_empty()).then(|| rivals_table(outcome).to_markdown()),
        gap_table => gap_table(outcome).to_markdown(),
        closed => answer::closed(&outcome.gap),
        disagreement => answer::disagreement(outcome),
        false_alarm => significant(super::false_alarm(outcome.detection.replicates)),
        filter_table => filter_table(outcome).map(|table| table.to_markdown()),
        detectable_table => detectable_table(outcome).to_markdown(),
        blocks => fixed(nuisances.block_density, 2),
        pose_mm => fixed(1e3 * nuisances.pose_error.sigma_m, 1),
        pose_deg => fixed(nuisances.pose_error.sigma_rad.to_degrees(), 2),
        pose_secs => fixed(nuisances.pose_error.correlation_secs, 1),
        odometry_mm => fixed(1e3 * nuisances.odometry_error.sigma_m, 1),
        odometry_deg => fixed(nuisances.odometry_error.sigma_rad.to_degrees(), 2),
        odometry_alpha => nuisances.odometry_error.noise.alpha().map(significant).join(", "),
        warnings => study.warnings.iter().map(|warning| text::sentence(warning)).collect::<Vec<_>>(),
        notes => outcome.notes.iter().map(|note| text::sentence(note)).collect::<Vec<_>>(),
        command => command.trim(),
        diff => diff.trim_end(),
        fence => page::fence(&[diff, command]),
    };
    Ok(environment.get_template("gap.md")?.render(page)?)
}

fn named_text<'a>(named: &locsim_gap::Named, figure: Option<FigureLink<'a>>) -> NamedText<'a> {
    NamedText {
        name: named.name.name(),
        sentence: named.effect.sentence(),
        formula: named.name.formula(),
        signature: named.name.signature(),
        numbers: answer::numbers(named).join(", "),
        gain: answer::with_interval(&named.evidence.gain_nats),
        p: answer::p_value(named.evidence.p),
        others: answer::others(named).collect(),
        split_by: named.split_by,
        figure,
    }
}

/// Regions that are still off with the named effects.
fn remaining(outcome: &Outcome) -> Vec<String> {
    outcome.regions.iter().filter(|region| region.remains).map(answer::region_text).collect()
}

fn detection_table(outcome: &Outcome) -> TextTable {
    let row = |name: &str, detection: &locsim_gap::Detection| {
        [
            name.to_owned(),
            answer::p_value(detection.p_library),
            answer::p_value(detection.p_omnibus),
            answer::p_value(detection.p),
        ]
    };
    let mut rows = vec![row("scenario as it is", &outcome.detection)];
    if !outcome.effects.is_empty() {
        rows.push(row("with the named effects", &outcome.detection_after));
    }
    TextTable::new(["simulator", "p, effects of the library", "p, anything else", "p, both"], rows)
}

/// Regions to look at, and those that follow from the named effects: with them, nothing is off there.
fn regions(outcome: &Outcome) -> (Vec<&Region>, Vec<&Region>) {
    outcome.regions.iter().partition(|region| region.remains || outcome.effects.is_empty())
}

fn regions_table(regions: &[&Region]) -> TextTable {
    let rows = regions.iter().take(SHOWN_REGIONS).map(|region| {
        [
            answer::place_text(region),
            answer::deviation_text(region).to_owned(),
            fixed(region.z, 1),
            fixed(region.w1_mm, 1),
            fixed(region.nats, 1),
            answer::p_value(region.q),
        ]
    });
    TextTable::new(["where", "what is off", "z", "W1 [mm]", "nats", "q"], rows)
}

fn unnamed_table(outcome: &Outcome) -> TextTable {
    let rows = outcome.unnamed.iter().map(|found| {
        [
            unnamed::noun(found).to_owned(),
            covariate::noun(found.covariate).to_owned(),
            unnamed::extent(found),
            answer::with_interval(&found.evidence.gain_nats),
            found.form_of.map_or(text::NONE, |kind| kind.name()).to_owned(),
        ]
    });
    TextTable::new(["what", "depends on", "how", "gain [nats]", "form of"], rows)
}

fn rivals_table(outcome: &Outcome) -> TextTable {
    let rows = outcome.rivals.iter().map(|rival| {
        let values = rival.name.parameters().iter().filter_map(|parameter| {
            let number = rival.params.get(parameter.name)?;
            let unit = unit(parameter).map(|unit| format!(" {unit}")).unwrap_or_default();
            Some(format!(
                "{} {}{unit}",
                answer::label(parameter),
                significant(in_file(parameter, number.estimate.value))
            ))
        });
        [
            format!("{}. {}", rival.round, rival.name),
            values.collect::<Vec<_>>().join(", "),
            answer::with_interval(&rival.gain_nats),
            if rival.behind_nats.value == 0.0 {
                text::NONE.to_owned()
            } else {
                answer::with_interval(&rival.behind_nats)
            },
        ]
    });
    TextTable::new(["round and effect", "fitted", "gain [nats]", "behind the named one [nats]"], rows)
}

fn gap_table(outcome: &Outcome) -> TextTable {
    let gap = &outcome.gap;
    let row = |name: &str, side: &locsim_gap::Distance| {
        [name.to_owned(), fixed(side.log_score_nats_per_scan, 2), fixed(side.w1_mm, 2)]
    };
    let rows = [
        row("scenario as it is", &gap.before),
        row("with the named effects", &gap.after),
        row("simulation against simulation", &gap.floor),
    ];
    TextTable::new(["simulator", "log score [nats per scan]", "W1 of range errors [mm]"], rows)
}

fn filter_table(outcome: &Outcome) -> Option<TextTable> {
    let filter = outcome.filter.as_ref()?;
    let row = |name: &str, cell: String| [name.to_owned(), cell];
    let rows = [
        row("scenario as it is", answer::with_interval(&filter.before.position_rmse_m)),
        row("with the named effects", answer::with_interval(&filter.after.position_rmse_m)),
        row("change", answer::change_in_words(&filter.change_m)),
    ];
    Some(TextTable::new(["simulator", "position RMSE [m]"], rows))
}

fn detectable_table(outcome: &Outcome) -> TextTable {
    let rows = outcome.detectable.iter().map(|detectable| {
        let parameter =
            detectable.name.parameters().iter().find(|parameter| parameter.name == detectable.parameter);
        let shown = |value: f64| {
            let value = parameter.map_or(value, |parameter| in_file(parameter, value));
            let unit = parameter.and_then(unit).map(|unit| format!(" {unit}")).unwrap_or_default();
            format!("{}{unit}", significant(value))
        };
        [
            detectable.name.name().to_owned(),
            parameter.map_or(detectable.parameter, |parameter| parameter.key).to_owned(),
            shown(detectable.value),
            shown(detectable.typical),
        ]
    });
    TextTable::new(["effect", "number", "found in 9 of 10 logs", "typical"], rows)
}
