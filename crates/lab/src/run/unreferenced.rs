//! A run on a log without reference poses: what filters say of themselves, as there is nothing to hold them against.

use std::time::Duration;

use locsim_core::{Clock, Drive, Pose2, median};
use locsim_dataset::{StampedPose, write_tum};
use locsim_mcl::{Filter, StepInput};
use locsim_report::figures::Figure;
use locsim_report::figures::canvas::{DrawError, INK, Mark, WIDTH, figure, line, model_color};
use locsim_report::figures::geometry::{Point, Window, join};
use locsim_report::figures::map::{LEFT, MARGINS, MapPanel};
use locsim_report::results::UNUSUAL_SCANS;
use locsim_report::store::Folder;
use locsim_report::text::{TextTable, escape, fixed, sentence};
use locsim_report::{ReportError, page, write_figures};
use locsim_scenario::{ModelName, Scenario};
use locsim_sensor::ModelKind;
use minijinja::syntax::SyntaxConfig;
use minijinja::{Environment, context};
use rayon::prelude::*;
use serde::Serialize;

use super::RunOptions;
use super::filter::{self, options};
use super::laboratory::Laboratory;
use super::misfit::Misfit;
use super::rehearsal::scan_log_density;
use super::training::TrainedModel;
use super::trial::online_estimate;
use crate::LabError;

const MARKDOWN: &str = include_str!("templates/unreferenced.md.j2");

/// A filter is gathered once its positions have no more than this standard deviation \[m\].
const GATHERED_M: f64 = 0.5;
/// Trials agree where their last estimates are no farther apart than this \[m\].
const AGREEMENT_M: f64 = 1.0;
/// A filter whose effective sample size is below this share of its particles is about to lose them.
const DEPRIVED: f64 = 0.05;
/// Where more than this share of the scans isn't taken in whole, a remark is due.
const CUT_SHARE: f64 = 0.05;

/// The content of `summary.json` of a run without reference poses.
#[derive(Clone, Debug, Serialize)]
pub struct Unreferenced {
    /// The scenario's name.
    pub scenario: String,
    /// The seed.
    pub seed: u64,
    /// Number of trials.
    pub trials: u32,
    /// Number of scans.
    pub scans: usize,
    /// Always false: errors are not known.
    pub has_reference: bool,
    /// The models in the scenario's order.
    pub models: Vec<UnreferencedModel>,
    /// The conclusions that the numbers allow, and those that they don't, in words.
    pub findings: Vec<String>,
}

/// The filters under one sensor model.
#[derive(Clone, Debug, Serialize)]
pub struct UnreferencedModel {
    /// The model's label.
    pub model: String,
    /// Mean log evidence of a scan under the filter's own tempered model \[nats\]; `None` of a model that is no density of
    /// readings.
    pub log_evidence_nats: Option<f64>,
    /// Mean effective sample size over the number of particles.
    pub effective_share: f64,
    /// Share of the scans that were taken in by a power below 1 (`filter.least_effective_share`).
    pub cut_share: f64,
    /// Median over scans and trials of the standard deviation of the position \[m\].
    pub spread_median_m: f64,
    /// The same of the heading \[rad\].
    pub heading_spread_median_rad: f64,
    /// Median over trials of the position's standard deviation at the last scan \[m\].
    pub spread_last_m: f64,
    /// Share of the trials whose filter gathers.
    pub gathered_share: f64,
    /// Median over these of the time until it does \[s\].
    pub gathered_secs: Option<f64>,
    /// The largest distance between the last estimates of two trials \[m\].
    pub disagreement_m: f64,
    /// Number of scans of all trials that no particle could explain. The evidence is that of the others.
    pub recoveries: usize,
    /// How often filters of all trials started anywhere again, as their scans didn't fit.
    pub restarts: usize,
    /// Milliseconds of a step.
    pub step_ms: f64,
}

/// One trial under one model.
struct Track {
    estimates: Vec<Pose2>,
    /// Standard deviations of position \[m\] and heading \[rad\].
    spreads: Vec<[f64; 2]>,
    effective_shares: Vec<f64>,
    log_evidence: f64,
    cut: usize,
    recoveries: usize,
    restarts: usize,
    spent: Duration,
}

/// Localizes on the log under every model and writes the results.
pub(super) fn write(
    laboratory: &Laboratory<'_>,
    drive: &Drive,
    folder: &Folder,
    options: &RunOptions<'_>,
) -> Result<Unreferenced, LabError> {
    let scenario = laboratory.scenario;
    options.control.progress.stage("trials", u64::from(scenario.trials));
    let trials: Vec<Vec<Track>> = (0..scenario.trials)
        .into_par_iter()
        .map(|number| {
            if options.control.is_interrupted() {
                return Err(LabError::Interrupted { finished: 0, trials: scenario.trials as usize });
            }
            let seed = laboratory.trial_seed(number);
            let tracks = laboratory
                .models
                .iter()
                .map(|model| localize(laboratory, model, drive, seed, options.control.clock));
            let tracks = tracks.collect::<Result<_, _>>()?;
            options.control.progress.advance(1);
            Ok(tracks)
        })
        .collect::<Result<_, LabError>>()?;
    let models = laboratory.models.iter().enumerate().map(|(i, model)| {
        let tracks: Vec<&Track> = trials.iter().map(|trial| &trial[i]).collect();
        summary(model, scenario, drive, &tracks)
    });
    let models: Vec<UnreferencedModel> = models.collect();
    let results = Unreferenced {
        scenario: scenario.name.clone(),
        seed: scenario.seed,
        trials: scenario.trials,
        scans: drive.steps.len(),
        has_reference: false,
        findings: findings(&models),
        models,
    };
    let json = serde_json::to_string_pretty(&results).map_err(ReportError::from)?;
    folder.write("summary.json", format!("{json}\n").as_bytes())?;
    let stamps = drive.steps.iter().map(|step| step.stamp_secs);
    let recorded = &trials[scenario.record.trial as usize];
    for (model, track) in laboratory.models.iter().zip(recorded) {
        let poses: Vec<StampedPose> = stamps
            .clone()
            .zip(&track.estimates)
            .map(|(stamp_secs, &pose)| StampedPose { stamp_secs, pose })
            .collect();
        write_tum(&folder.claim(&format!("trajectories/{}.tum", model.label))?, &poses)?;
    }
    let figures = [trajectories(laboratory, recorded)?];
    write_figures(folder, &figures)?;
    let markdown = markdown(&results, laboratory, &figures, &options.command)?;
    folder.write("report.md", markdown.as_bytes())?;
    folder.write("report.html", page::html(&scenario.name, &markdown, &figures)?.as_bytes())?;
    Ok(results)
}

fn localize(
    laboratory: &Laboratory<'_>,
    model: &TrainedModel,
    drive: &Drive,
    seed: u64,
    clock: Clock<'_>,
) -> Result<Track, LabError> {
    let settings = &laboratory.filter;
    let map = &*laboratory.maps.ranges;
    let start = filter::start(settings, None).ok_or_else(|| LabError::Log {
        path: laboratory.scenario.file.clone(),
        what: "filter.start.tracking begins at a reference pose, and the log has none; `global`, or `around` with a pose"
            .to_owned(),
    })?;
    let mut filter = Filter::new(options(settings, false)?, &start, map, seed)?;
    let count = drive.steps.len();
    let mut track = Track {
        estimates: Vec::with_capacity(count),
        spreads: Vec::with_capacity(count),
        effective_shares: Vec::with_capacity(count),
        log_evidence: 0.0,
        cut: 0,
        recoveries: 0,
        restarts: 0,
        spent: Duration::ZERO,
    };
    let mut misfit = Misfit::new(settings, model);
    for (i, step) in drive.steps.iter().enumerate() {
        let input =
            StepInput { odometry: drive.odometry_increment(i), laser: &drive.laser, scan: &step.scan };
        let before = clock();
        let outcome = filter.step(&input, map, &*model.tempered)?;
        track.spent += clock().saturating_sub(before);
        let covariance = outcome.estimates.weighted_mean.covariance;
        let [x, y, theta] = [0, 1, 2].map(|axis| covariance[axis][axis].max(0.0));
        track.estimates.push(online_estimate(settings.estimate, &outcome));
        track.spreads.push([(x + y).sqrt(), theta.sqrt()]);
        if outcome.likelihood_power > 0.0 {
            track.effective_shares.push(outcome.effective_sample_size / outcome.particle_count as f64);
        }
        if outcome.recovered.is_none() {
            track.log_evidence += outcome.log_evidence;
        }
        track.cut += usize::from(outcome.likelihood_power > 0.0 && outcome.likelihood_power < 1.0);
        track.recoveries += usize::from(outcome.recovered.is_some());
        let density = |pose| scan_log_density(&*model.floored, map, &drive.laser, &step.scan, pose);
        if misfit.is_lost(&outcome, density) {
            let before = clock();
            filter.restart(map)?;
            track.spent += clock().saturating_sub(before);
            track.restarts += 1;
        }
    }
    Ok(track)
}

fn summary(model: &TrainedModel, scenario: &Scenario, drive: &Drive, tracks: &[&Track]) -> UnreferencedModel {
    let scans = drive.steps.len() as f64;
    let count = tracks.len() as f64;
    // Scans that `filter.update` left out say nothing.
    let taken_in = tracks.iter().map(|track| track.effective_shares.len()).sum::<usize>() as f64 / count;
    let mean = |of: &dyn Fn(&Track) -> f64| tracks.iter().map(|track| of(track)).sum::<f64>() / count;
    let explained = taken_in - mean(&|track| track.recoveries as f64);
    let spread = |axis: usize| {
        let spreads = tracks.iter().flat_map(|track| &track.spreads);
        median(&mut spreads.map(|spread| spread[axis]).collect::<Vec<_>>())
    };
    let begin = drive.steps[0].stamp_secs;
    let mut gathered: Vec<f64> = tracks
        .iter()
        .filter_map(|track| {
            // From here on to the end.
            let apart = track.spreads.iter().rposition(|spread| spread[0] > GATHERED_M);
            let first = apart.map_or(0, |last| last + 1);
            Some(drive.steps.get(first)?.stamp_secs - begin)
        })
        .collect();
    let mut last_spreads: Vec<f64> =
        tracks.iter().filter_map(|track| track.spreads.last()).map(|spread| spread[0]).collect();
    let last: Vec<Pose2> = tracks.iter().filter_map(|track| track.estimates.last().copied()).collect();
    let apart = last.iter().flat_map(|a| last.iter().map(|b| a.position().distance(b.position())));
    // A likelihood field is no density of readings.
    let named = scenario.models.iter().find(|named| named.label == model.label);
    let is_density = named.is_some_and(|named| {
        !matches!(named.name, ModelName::Fitted(ModelKind::LikelihoodField) | ModelName::Amcl(_))
    });
    UnreferencedModel {
        model: model.label.clone(),
        log_evidence_nats: is_density.then(|| mean(&|track| track.log_evidence) / explained),
        effective_share: mean(&|track| track.effective_shares.iter().sum::<f64>()) / taken_in,
        cut_share: mean(&|track| track.cut as f64) / taken_in,
        spread_median_m: spread(0),
        heading_spread_median_rad: spread(1),
        spread_last_m: median(&mut last_spreads),
        gathered_share: gathered.len() as f64 / count,
        gathered_secs: (!gathered.is_empty()).then(|| median(&mut gathered)),
        disagreement_m: apart.fold(0.0, f64::max),
        recoveries: tracks.iter().map(|track| track.recoveries).sum(),
        restarts: tracks.iter().map(|track| track.restarts).sum(),
        step_ms: mean(&|track| track.spent.as_secs_f64()) * 1e3 / scans,
    }
}

fn findings(models: &[UnreferencedModel]) -> Vec<String> {
    let mut findings = vec![
        "The log has no reference poses, so no error is known. The spread is what a filter believes of its own error; a lost \
         filter may believe it is small."
            .to_owned(),
    ];
    for model in models {
        let name = &model.model;
        if model.gathered_share < 1.0 {
            findings.push(format!(
                "`{name}`: {:.0} % of the trials never gather to {GATHERED_M} m.",
                100.0 * (1.0 - model.gathered_share)
            ));
        }
        if model.recoveries > 0 {
            findings.push(format!(
                "`{name}`: no particle explains {} of the scans. The evidence leaves them out.",
                model.recoveries
            ));
        }
        if model.restarts > 0 {
            findings.push(format!(
                "`{name}`: filters started anywhere again {} times, as {UNUSUAL_SCANS} scans in a row didn't fit.",
                model.restarts
            ));
        }
        if model.disagreement_m > AGREEMENT_M {
            findings.push(format!(
                "`{name}`: trials end up to {:.1} m apart, so at least one of them is lost.",
                model.disagreement_m
            ));
        }
        if model.effective_share < DEPRIVED {
            findings.push(format!(
                "`{name}`: {:.1} % of the particles are effective on average; more particles may change the estimates.",
                100.0 * model.effective_share
            ));
        }
        if model.cut_share > CUT_SHARE {
            findings.push(format!(
                "`{name}`: {:.0} % of the scans would have left fewer effective particles than `filter.least_effective_share`, and \
                 were taken in by a smaller power of their likelihood.",
                100.0 * model.cut_share
            ));
        }
    }
    let mut ranked: Vec<(&str, f64)> =
        models.iter().filter_map(|m| Some((m.model.as_str(), m.log_evidence_nats?))).collect();
    ranked.sort_by(|a, b| b.1.total_cmp(&a.1));
    if let [(best, first), (second, next), ..] = ranked[..] {
        findings.push(format!(
            "`{best}` predicts the scans best, by {:.2} nats per scan over `{second}`. Evidence compares sensor models with the \
             exponents that they have; it doesn't say that a pose is right.",
            first - next
        ));
    }
    findings
}

impl Unreferenced {
    /// The models side by side.
    pub fn table(&self) -> TextTable {
        let row = |m: &UnreferencedModel| {
            [
                m.model.clone(),
                m.log_evidence_nats.map_or("-".to_owned(), |nats| fixed(nats, 2)),
                fixed(100.0 * m.effective_share, 1),
                fixed(m.spread_median_m, 3),
                fixed(m.heading_spread_median_rad.to_degrees(), 2),
                fixed(100.0 * m.gathered_share, 0),
                m.gathered_secs.map_or("-".to_owned(), |secs| fixed(secs, 1)),
                fixed(m.disagreement_m, 2),
            ]
        };
        TextTable::new(
            [
                "model",
                "evidence [nats/scan]",
                "effective [%]",
                "spread [m]",
                "heading [deg]",
                "gathered [%]",
                "after [s]",
                "ends apart [m]",
            ],
            self.models.iter().map(row),
        )
    }
}

fn markdown(
    results: &Unreferenced,
    laboratory: &Laboratory<'_>,
    figures: &[Figure],
    command: &str,
) -> Result<String, ReportError> {
    let mut environment = Environment::new();
    environment.set_syntax(SyntaxConfig::builder().trim_blocks(true).lstrip_blocks(true).build()?);
    environment.add_template("report.md", MARKDOWN)?;
    let link =
        |figure: &Figure| context! { name => figure.name, path => figure.path(), caption => &figure.caption };
    let (yaml, command) = (laboratory.scenario.text.trim_end(), command.trim());
    let page = context! {
        title => escape(&results.scenario),
        description => escape(&laboratory.scenario.description),
        scans => results.scans,
        trials => results.trials,
        seed => results.seed,
        gathered_m => GATHERED_M,
        table => results.table().to_markdown(),
        findings => &results.findings,
        figures => figures.iter().map(link).collect::<Vec<_>>(),
        notes => laboratory.notes.iter().map(|note| sentence(note)).collect::<Vec<_>>(),
        fence => page::fence(&[yaml, command]),
        command => command,
        yaml => yaml,
    };
    Ok(environment.get_template("report.md")?.render(page)?)
}

/// The estimates of the recorded trial on the map.
fn trajectories(laboratory: &Laboratory<'_>, tracks: &[Track]) -> Result<Figure, ReportError> {
    const NAME: &str = "trajectories";
    let models: Vec<String> = laboratory.models.iter().map(|model| model.label.clone()).collect();
    let walls = laboratory.maps.walls();
    let legend: Vec<(String, Mark)> =
        models.iter().map(|name| (name.clone(), Mark::Line(model_color(&models, name)))).collect();
    let bounds = Window::around(walls.iter().flatten());
    let (right, top, below) = MARGINS;
    let width = f64::from(WIDTH) - LEFT - right;
    let [x, y] = bounds.size();
    let height = (width * y / x.max(1e-3)).clamp(0.3 * width, 1.2 * width);
    let svg = figure("Estimates of the recorded trial", &legend, height + top + below, |area| {
        let mut panel = MapPanel::new(area, bounds.with_aspect(width / height), [10.0, height / 80.0])?;
        for wall in join(&walls) {
            panel.line(&wall, line(INK, 1.5))?;
        }
        for (track, name) in tracks.iter().zip(&models) {
            let points: Vec<Point> = track.estimates.iter().map(|pose| [pose.x, pose.y]).collect();
            panel.line(&points, line(model_color(&models, name), 1.5))?;
        }
        Ok(())
    })
    .map_err(|error: DrawError| ReportError::Figure { name: NAME, reason: error.to_string() })?;
    let caption = "The estimate of each model. There is no reference to hold them against.".to_owned();
    Ok(Figure { name: NAME, caption, svg })
}
