//! A log against an earlier one of the same robot: what changed since the baseline.

use locsim_baseline::{
    BaselineOptions, ChangeVerdict, Changes, LossAtBearings, LossesByBearing, find_changes,
};
use locsim_gap::Named;
use locsim_report::store::{Folder, Request};
use locsim_report::text::{self, TextTable, fixed};
use locsim_report::{ReportError, page};
use minijinja::syntax::SyntaxConfig;
use minijinja::{Environment, context};
use serde_json::{Value, json as json_of};

use super::{GapStudy, GapStudyOptions, answer, false_alarm, proposal};
use crate::LabError;
use locsim_core::{Control, Estimate, Interval};

const MARKDOWN: &str = include_str!("templates/baseline.md.j2");
/// Kinds of effect in the report's table; gap.json has all.
const SHOWN: usize = 10;
/// Share of today's readings at places that the baseline has seen, below which the answer says so.
const FEW_SHARED: f64 = 0.3;
/// A lag of the odometry that has changed by less is none: it comes and goes with the interpolation \[s\].
const LEAST_LAG_SECS: f64 = 0.05;

/// Holds the log against the baseline and writes the results folder, which is made beside its place and renamed when complete.
///
/// # Errors
/// [`LabError`]; earlier results at `options.out` are then untouched.
pub fn run(study: &GapStudy, options: &GapStudyOptions<'_>) -> Result<Changes, LabError> {
    let GapStudyOptions { out, force, .. } = options;
    let fingerprint = study.scenario.content_hash()?;
    let request = Request { out, kind: "gap", fingerprint: &fingerprint, resume: false, force: *force };
    let changes = request.fill(|store| {
        let changes = find(study, options.control)?;
        options.control.progress.stage("writing the report", 1);
        write(store.folder(), study, &changes, options)?;
        Ok::<_, LabError>(changes)
    })?;
    options.control.progress.finish();
    Ok(changes)
}

/// Holds the log against the baseline, and writes nothing.
///
/// # Errors
/// [`LabError`], also without a baseline.
pub fn find(study: &GapStudy, control: Control<'_>) -> Result<Changes, LabError> {
    let Some(baseline) = &study.baseline else {
        let what = "there is no baseline to hold it against".to_owned();
        return Err(LabError::Log { path: study.log.clone(), what });
    };
    let Control { clock, progress, interrupted } = control;
    let began = clock();
    let replicates = study.settings.replicates;
    let search = BaselineOptions {
        permutations: replicates,
        false_alarm: false_alarm(replicates),
        without: study.settings.without.clone(),
        seed: study.scenario.seed,
        ..BaselineOptions::default()
    };
    let nominal = study.nominal()?;
    study.warnings.iter().for_each(|warning| progress.warn(warning));
    let mut changes =
        find_changes(&nominal, &baseline.recorded, &study.recorded, &search, progress, interrupted)?;
    if changes.shared < FEW_SHARED {
        changes.notes.push(format!(
            "Only {} % of the log's readings are at places that the baseline has seen; the others are compared for objects and lost returns alone.",
            fixed(100.0 * changes.shared, 0)
        ));
    }
    let lags = [baseline.odometry_lag_secs, study.odometry_lag_secs];
    if (lags[1] - lags[0]).abs() >= LEAST_LAG_SECS {
        changes.odometry_lag_secs = Some(lags);
        if changes.verdict == ChangeVerdict::None {
            changes.verdict = ChangeVerdict::Unexplained;
        }
    }
    changes.notes.splice(0..0, study.remarks());
    changes.seconds = control.seconds_since(began);
    Ok(changes)
}

/// The findings as `gap.json` has them.
///
/// # Errors
/// [`LabError::Report`] for numbers that JSON can't have.
pub fn json(study: &GapStudy, changes: &Changes) -> Result<String, LabError> {
    let baseline = study.baseline.as_ref().map(|baseline| baseline.log.display().to_string());
    let mut section = serde_json::to_value(changes).map_err(ReportError::from)?;
    if let Value::Object(fields) = &mut section {
        fields.insert("log".to_owned(), json_of!(baseline));
    }
    let all = json_of!({
        "verdict": changes.verdict,
        "log": study.log.display().to_string(),
        "baseline": section,
    });
    Ok(serde_json::to_string_pretty(&all).map_err(ReportError::from)?)
}

fn write(
    folder: &Folder,
    study: &GapStudy,
    changes: &Changes,
    options: &GapStudyOptions<'_>,
) -> Result<(), LabError> {
    folder.write("gap.json", format!("{}\n", json(study, changes)?).as_bytes())?;
    let scenario = proposal::scenario_since(study, changes, &options.out)?;
    folder.write("scenario.yaml", scenario.as_bytes())?;
    let [old, new] = [study.scenario.file.clone(), options.out.join("scenario.yaml")];
    let diff = proposal::diff(
        &study.scenario.text,
        &scenario,
        &old.display().to_string(),
        &new.display().to_string(),
    );
    folder.write("scenario.diff", diff.as_bytes())?;
    let markdown = markdown(study, changes, &diff, &options.command)?;
    folder.write("report.md", markdown.as_bytes())?;
    Ok(folder.write("report.html", page::html(&title(study), &markdown, &[])?.as_bytes())?)
}

fn title(study: &GapStudy) -> String {
    let name = |path: &std::path::Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let baseline = study.baseline.as_ref().map_or_else(String::new, |baseline| name(&baseline.log));
    format!("{} since {baseline}", name(&study.log))
}

fn markdown(study: &GapStudy, changes: &Changes, diff: &str, command: &str) -> Result<String, ReportError> {
    let mut environment = Environment::new();
    environment.set_syntax(SyntaxConfig::builder().trim_blocks(true).lstrip_blocks(true).build()?);
    environment.add_template("baseline.md", MARKDOWN)?;
    let baseline = study.baseline.as_ref().map(|baseline| baseline.log.display().to_string());
    let page = context! {
        title => text::escape(&title(study)),
        steps => steps(changes),
        answers => sentences(changes).iter().map(|line| text::sentence(line)).collect::<Vec<_>>(),
        log => text::escape(&study.log.display().to_string()),
        baseline => text::escape(&baseline.unwrap_or_default()),
        scenario => text::escape(&study.scenario.file.display().to_string()),
        verdict => minijinja::value::Serde(changes.verdict),
        scans => changes.scans[1],
        baseline_scans => changes.scans[0],
        beams => changes.beams,
        shared => fixed(100.0 * changes.shared, 0),
        permutations => changes.permutations,
        seed => changes.seed,
        p => answer::p_value(changes.p),
        seconds => fixed(changes.seconds, 1),
        losses_table => changes.losses_by_bearing.as_ref().map(|losses| losses_table(losses).to_markdown()),
        tried_table => (!changes.tried.is_empty()).then(|| tried_table(changes).to_markdown()),
        warnings => study.warnings.iter().map(|warning| text::sentence(warning)).collect::<Vec<_>>(),
        notes => changes.notes.iter().map(|note| text::sentence(note)).collect::<Vec<_>>(),
        command => command.trim(),
        diff => (!changes.effects.is_empty()).then(|| diff.trim_end()),
        fence => page::fence(&[diff, command]),
    };
    Ok(environment.get_template("baseline.md")?.render(page)?)
}

fn losses_table(losses: &LossesByBearing) -> TextTable {
    let rows = losses.parts.iter().map(|LossAtBearings { bearings: [from, to], share }| {
        let degrees = |bearing: &f64| fixed(bearing.to_degrees(), 0);
        [format!("{} to {}", degrees(from), degrees(to)), percent(share)]
    });
    TextTable::new(["bearing [deg]", "lost [%]"], rows)
}

/// "55 [51, 59]".
fn percent(share: &Estimate) -> String {
    let Estimate { value, interval: Interval { lo, hi } } = share.map(|share| 100.0 * share.clamp(0.0, 1.0));
    format!("{} [{}, {}]", fixed(value, 0), fixed(lo, 0), fixed(hi, 0))
}

fn tried_table(changes: &Changes) -> TextTable {
    let rows = changes
        .tried
        .iter()
        .take(SHOWN)
        .map(|tried| [tried.name.name().to_owned(), fixed(tried.gain_nats, 1), fixed(tried.z, 1)]);
    TextTable::new(["effect", "gain [nats]", "z"], rows)
}

/// The next step where returns are lost at some bearings.
const WINDOW: &str = "Look at the laser's window, and at what the robot may have in front of it.";
/// The next step where every beam is noisier.
const NOISE: &str = "Look at the laser itself: its window, its supply, its temperature.";
/// The next step where the odometry lags.
const STAMPS: &str = "Look at what stamps the odometry, and at what filters it.";
/// Ranges are farther off with a name if they are so by this factor.
const FARTHER: f64 = 1.1;

/// The short answer.
pub fn answer_since(changes: &Changes) -> String {
    sentences(changes).join("\n")
}

/// Share of the common places at which a drive is the other way round.
const MANY_REVERSED: f64 = 0.5;

fn sentences(changes: &Changes) -> Vec<String> {
    let p = answer::p_value(changes.p);
    let mut text: Vec<String> =
        changes.effects.iter().map(|named| format!("Since the baseline: {}", answer::told(named))).collect();
    text.extend(changes.effects.iter().filter_map(|named| answer::doubt(named, &changes.effects)));
    let losses = changes.losses_by_bearing.as_ref().and_then(losses_sentence);
    // What gains more is told first.
    let gain = changes.losses_by_bearing.as_ref().map_or(0.0, |losses| losses.gain_nats);
    let is_first = changes.effects.first().is_some_and(|named| named.evidence.gain_nats.value < gain);
    let at = if is_first { 0 } else { text.len() };
    text.splice(at..at, losses.clone());
    let noise = changes.noise_of_every_beam_m.map(noise_sentence);
    text.extend(noise.clone());
    let lag = changes.odometry_lag_secs.map(lag_sentence);
    text.extend(lag.clone());
    match changes.verdict {
        ChangeVerdict::None => text.push(format!("Nothing has changed since the baseline (p = {p}).")),
        ChangeVerdict::Unexplained if noise.is_some() => {
            text.push(format!("No effect of the library is noise of every beam (p = {p})."));
        }
        ChangeVerdict::Unexplained if lag.is_some() => {
            text.push(format!("No effect of the library is a lag of the odometry. Readings as different as these come by chance with p = {p}."));
        }
        ChangeVerdict::Unexplained if losses.is_some() => {
            text.push(format!("No effect of the library loses returns by bearing (p = {p})."));
        }
        ChangeVerdict::Unexplained => text.push(format!(
            "Something has changed since the baseline{} (p = {p}), and no effect of the library surely explains it.",
            changes.place.map_or_else(String::new, |place| format!(", {}", at_place(place))),
        )),
        ChangeVerdict::Underpowered => text.push(format!(
            "The log can't be compared with the baseline: {} % of its readings are at places that the baseline has seen.",
            fixed(100.0 * changes.shared, 0)
        )),
        ChangeVerdict::Changed => {
            let [before, after, floor] = changes.w1_mm.map(|distance| fixed(distance, 1));
            text.push(format!(
                "Range errors {before} -> {after} mm from the baseline's with what is named, {floor} mm between stretches of both \
                 logs (p = {p})."
            ));
            text.extend((changes.reversed > MANY_REVERSED).then(|| {
                format!(
                    "At {} % of the common places the robot drives the other way today. What map and reference err by doesn't cancel \
                     then, and looks like a laser that is displaced: compare drives in one direction.",
                    fixed(100.0 * changes.reversed, 0)
                )
            }));
            let [before, after, _] = changes.w1_mm;
            if after > FARTHER * before {
                text.push(
                    "Ranges are farther off with what is named: it is weaker than its number says, or something else has changed that \
                     works against it."
                        .to_owned(),
                );
            }
        }
    }
    text
}

/// "Since the baseline: Every beam is noisier: ..."
fn noise_sentence([baseline, today]: [f64; 2]) -> String {
    let mm = |sigma: f64| fixed(1e3 * sigma, 1);
    format!(
        "Since the baseline: Every beam is noisier: sigma {} mm, {} mm in the baseline, by what neighbouring beams on one wall differ by.",
        mm(today),
        mm(baseline)
    )
}

/// "Since the baseline: The odometry lags behind the reference: ..."
fn lag_sentence([baseline, today]: [f64; 2]) -> String {
    format!(
        "Since the baseline: The odometry lags behind the reference by {} s, {} s in the baseline: its stamps are late, or it is filtered.",
        fixed(today, 2),
        fixed(baseline, 2)
    )
}

/// "at x 5.0 to 6.0 m, y 4.0 to 5.0 m".
fn at_place([x0, y0, x1, y1]: [f64; 4]) -> String {
    let span = |from, to| format!("{} to {} m", fixed(from, 1), fixed(to, 1));
    format!("at x {}, y {}", span(x0, x1), span(y0, y1))
}

/// "Returns are lost at some bearings: -60 to -20 deg and 10 to 40 deg; of those at 20 to 30 deg 55 [51, 59] %."
fn losses_sentence(losses: &LossesByBearing) -> Option<String> {
    let most = losses.most()?;
    let span = |[from, to]: [f64; 2]| {
        format!("{} to {} deg", fixed(from.to_degrees(), 0), fixed(to.to_degrees(), 0))
    };
    let stretches: Vec<String> = losses.stretches().into_iter().map(span).collect();
    Some(format!(
        "Since the baseline: Returns are lost at some bearings: {}; of those at {} {} %. The window is dirty, scratched or covered there.",
        stretches.join(" and "),
        span(most.bearings),
        percent(&most.share),
    ))
}

/// The next steps for the reader.
fn steps(changes: &Changes) -> Vec<String> {
    let named = |named: &Named| format!("Look on the robot for this change: {}", answer::told(named));
    let window = changes.losses_by_bearing.is_some().then(|| WINDOW.to_owned());
    let window = window.or_else(|| changes.noise_of_every_beam_m.map(|_| NOISE.to_owned()));
    match changes.verdict {
        ChangeVerdict::None => vec!["Nothing: the robot is as it was on the baseline's drive.".to_owned()],
        ChangeVerdict::Underpowered => {
            vec!["Drive where the baseline drove, or take a baseline that has seen these places.".to_owned()]
        }
        ChangeVerdict::Unexplained if window.is_some() => window.into_iter().collect(),
        ChangeVerdict::Unexplained if changes.odometry_lag_secs.is_some() => vec![STAMPS.to_owned()],
        ChangeVerdict::Unexplained => match changes.place {
            Some(place) => vec![format!("Look {}, for what stands there now.", at_place(place))],
            None => vec![
                "Compare both logs by eye where the robot drove twice.".to_owned(),
                "Search each log by itself, without --baseline.".to_owned(),
            ],
        },
        ChangeVerdict::Changed => {
            let mut steps: Vec<String> = changes.effects.iter().map(named).chain(window).collect();
            steps.push("Repeat the drive when it is mended: nothing should be named then.".to_owned());
            steps
        }
    }
}
