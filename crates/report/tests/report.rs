//! Reports of made-up results: what is written, that it's complete, and that it's the same every time.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::Arc;

use arrow::array::{Array, AsArray};
use arrow::datatypes::{DataType, Float64Type, UInt32Type, UInt64Type};
use locsim_core::{Draw, Drive, DriveStep, Laser, Pose2, Scan, Stage};
use locsim_report::results::{
    BeamProbe, DetailedModel, DetailedStep, DetailedTrial, Disagreement, ModelTrial, RunResults, StepRow,
    TrainingRow, Trial, USUAL_SCAN,
};
use locsim_report::store::{Folder, StoreError};
use locsim_report::summary::{Summary, SummaryError};
use locsim_report::{ReportContext, terminal_table, warnings, write};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;

/// Name, standard deviation of the errors [m], and the trial it loses, if any.
const MODELS: [(&str, f64, Option<u32>); 7] = [
    ("classic", 0.040, Some(17)),
    ("beam_mixture", 0.018, None),
    ("likelihood_field", 0.030, Some(4)),
    ("p_reg", 0.055, None),
    ("np_reg", 0.022, None),
    ("np_reg_registered", 0.0125, None),
    ("oracle", 0.012, None),
];
const STEPS: u32 = 60;

/// Nearly normal with variance 1: twelve uniforms less 6, the same on every platform.
fn noise(draw: Draw, item: u32) -> f64 {
    (0..12).map(|i| draw.seed(12 * item + i) as f64 / u64::MAX as f64).sum::<f64>() - 6.0
}

fn truth(step: u32) -> Pose2 {
    let t = f64::from(step) / f64::from(STEPS);
    Pose2::new(1.0 + 17.0 * t, 2.0 + 0.7 * (7.0 * t).sin(), 0.2 * (7.0 * t).cos())
}

fn model_trial(model: usize, trial: u32) -> ModelTrial {
    let (name, std, loses) = MODELS[model];
    let draw = Draw::new(u64::from(trial), Stage::Motion, model as u32);
    let bias = [noise(draw, 9000), noise(draw, 9001)];
    let steps = (0..STEPS).map(|step| {
        let drift = if loses == Some(trial) { 0.04 * f64::from(step.saturating_sub(20)) } else { 0.0 };
        let along = drift + std * (0.6 * bias[0] + 0.5 * noise(draw, 3 * step));
        let across = std * (0.4 * bias[1] + 0.4 * noise(draw, 3 * step + 1));
        let heading = 0.2 * std * noise(draw, 3 * step + 2);
        // Each trial has a drive of its own.
        let truth = truth(step);
        let truth = Pose2::new(truth.x, truth.y + 1e-3 * f64::from(trial), truth.theta);
        StepRow {
            step,
            stamp_secs: 100.0 + 0.2 * f64::from(step),
            truth,
            dead_reckoning: Pose2::new(truth.x + 0.01 * f64::from(step), truth.y, truth.theta),
            estimate: Pose2::new(truth.x + along, truth.y + across, truth.theta + heading),
            error_along_m: along,
            error_across_m: across,
            error_heading_rad: heading,
            effective_sample_size: 40.0 + 2000.0 * std + 5.0 * noise(draw, 5000 + step),
            likelihood_power: 1.0,
            particles: 400,
            log_evidence_nats: -30.0 + noise(draw, 7000 + step),
            scan_log_density_nats: 1.0,
            nees: 3.0 + f64::from(trial),
            nees_with_shared_errors: 2.0,
            resampled: step % 3 == 0,
        }
    });
    ModelTrial {
        model: name.to_owned(),
        steps: steps.collect(),
        lost: loses == Some(trial),
        step_ms: 1.5 + model as f64,
        events: if loses == Some(trial) { vec![(33, "recovery, \"kidnapped\"".to_owned())] } else { vec![] },
    }
}

fn results(models: &[usize], trials: u32) -> RunResults {
    let training = models.iter().map(|&m| TrainingRow {
        log_loss_nats: (MODELS[m].0 != "likelihood_field").then_some(2.5 + 10.0 * MODELS[m].1),
        histogram_match_m: Some(0.02 + MODELS[m].1),
        chosen: BTreeMap::from([("exponent".to_owned(), 0.25), ("floor".to_owned(), 0.01)]),
    });
    RunResults {
        scenario: "synthetic_corridor".to_owned(),
        description: "Made-up errors of known size.".to_owned(),
        seed: 7,
        seconds: 12.5,
        error_frame: "map: along is x, across is y".to_owned(),
        localized_within_m: None,
        estimate: "most likely trajectory".to_owned(),
        models: models.iter().map(|&m| MODELS[m].0.to_owned()).collect(),
        training: training.collect(),
        disagreements: Vec::new(),
        trials: (0..trials)
            .map(|trial| Trial {
                trial,
                seed: Draw::new(7, Stage::Trial, 0).seed(trial),
                models: models.iter().map(|&m| model_trial(m, trial)).collect(),
            })
            .collect(),
    }
}

const ALL: [usize; 7] = [0, 1, 2, 3, 4, 5, 6];

/// Distance from a pose to the walls of the corridor y = 0, y = 4, x = 0, x = 20 along a heading.
fn range(pose: Pose2, bearing: f64) -> f64 {
    let (sin, cos) = (pose.theta + bearing).sin_cos();
    let along = |p: f64, d: f64, hi: f64| {
        if d.abs() < 1e-9 { f64::INFINITY } else { (if d > 0.0 { hi - p } else { -p }) / d }
    };
    along(pose.x, cos, 20.0).min(along(pose.y, sin, 4.0))
}

fn detail(models: &[usize]) -> DetailedTrial {
    let bearings: Vec<f32> = (0..24).map(|i| (f64::from(i) * 0.2618 - 3.0) as f32).collect();
    let laser = Laser::new(bearings.clone(), vec![0.0; 24], 0.05, 4.5, Pose2::new(0.1, 0.0, 0.0)).unwrap();
    let steps = (0..STEPS).map(|step| {
        let at = truth(step).compose(&laser.base_from_laser());
        let ranges = bearings
            .iter()
            .enumerate()
            .map(|(i, &b)| {
                let range = range(at, f64::from(b)) as f32;
                if i == 6 { 0.4 * range } else { range }.min(4.5)
            })
            .collect();
        DriveStep {
            stamp_secs: 100.0 + 0.2 * f64::from(step),
            odometry: truth(step),
            reference: Some(truth(step)),
            scan: Scan { ranges },
        }
    });
    let corners =
        [[0.0, 0.0], [5.0, 0.0], [5.0, -0.4], [6.2, -0.4], [6.2, 0.0], [20.0, 0.0], [20.0, 4.0], [0.0, 4.0]];
    let walls = (0..corners.len()).map(|i| [corners[i], corners[(i + 1) % corners.len()]]).collect();
    let block = |x: f64, y: f64| [[x, y], [x + 0.4, y + 0.1], [x + 0.3, y + 0.4], [x - 0.1, y + 0.3]];
    let one = |&model: &usize| {
        let (name, std, _) = MODELS[model];
        let rows = model_trial(model, 3);
        let steps = rows.steps.iter().map(|row| {
            let draw = Draw::new(u64::from(row.step), Stage::Initial, model as u32);
            let offset = |i: u32| 2.0 * std * noise(draw, i);
            let particles = (0..400)
                .map(|i| Pose2::new(row.estimate.x + offset(3 * i), row.estimate.y + offset(3 * i + 1), 0.0))
                .collect();
            DetailedStep {
                particles,
                weights: (0..400).map(|i| f64::from(i + 1) / 80_200.0).collect(),
                estimate: row.estimate,
                position_covariance: [[std * std, 0.0], [0.0, std * std]],
                beam_log_density: vec![0.0; 24],
                effective_sample_size: row.effective_sample_size,
                log_evidence_nats: row.log_evidence_nats,
                events: vec![],
                probe: probe(model, row.step),
            }
        });
        DetailedModel {
            name: name.to_owned(),
            steps: steps.collect(),
            most_likely_trajectory: rows.steps.iter().map(|r| r.estimate).collect(),
        }
    };
    DetailedTrial {
        labels: models.iter().map(|&m| MODELS[m].0.to_owned()).collect(),
        drive: Drive { laser: laser.clone(), steps: steps.collect() },
        walls,
        blocks: (0..STEPS)
            .map(|s| {
                (0..12)
                    .map(|i| {
                        block(1.5 * f64::from(i) + 0.2 * f64::from(s % 5), if i % 2 == 0 { 0.1 } else { 3.4 })
                    })
                    .collect()
            })
            .collect(),
        dead_reckoning: (0..STEPS)
            .map(|s| {
                Pose2::new(
                    truth(s).x + 0.01 * f64::from(s),
                    truth(s).y - 0.006 * f64::from(s),
                    truth(s).theta,
                )
            })
            .collect(),
        models: models.iter().map(one).collect(),
    }
}

/// Beam 6 of a particle at the truth, met by a block a few centimetres nearer at each step.
fn probe(model: usize, step: u32) -> BeamProbe {
    let (nominal, reading) = (2.9, 1.4 - 0.002 * step as f32);
    let z: Vec<f32> = (0..450).map(|i| 0.01 * i as f32).collect();
    let bump = |z: f32, mean: f32, width: f32| (-0.5 * ((z - mean) / width).powi(2)).exp() / width / 2.5066;
    let width = MODELS[model].1 as f32;
    let density = z.iter().map(|&z| {
        let short = if model == 0 { 0.02 * (-0.4 * z).exp() } else { 0.2 * bump(z, 1.3, 4.0 * width) };
        if z > 3.3 { 1e-4 } else { short + 0.7 * bump(z, nominal, width) }
    });
    BeamProbe {
        beam: 6,
        pose: truth(step),
        nominal_m: nominal,
        reading_m: reading,
        density_per_m: density.collect(),
        z_m: z,
        max_range_probability: 0.02,
    }
}

fn context() -> ReportContext {
    ReportContext {
        scenario_yaml: "name: synthetic_corridor\nseed: 7\n# a ``` fence inside\n".to_owned(),
        command: "locsim run scenarios/synthetic.yaml --seed 7".to_owned(),
        simulated: true,
        warnings: vec!["The robot doesn't exist.".to_owned()],
        notes: vec!["The errors are made up.".to_owned()],
    }
}

fn full_report(dir: &Path) -> Summary {
    write(&Folder::new(dir).unwrap(), &results(&ALL, 30), Some(&detail(&ALL)), &context()).unwrap()
}

#[test]
fn the_report_of_a_full_run_reads_as_agreed() {
    let dir = tempfile::tempdir().unwrap();
    full_report(dir.path());
    insta::assert_snapshot!("full_report", fs::read_to_string(dir.path().join("report.md")).unwrap());
}

#[test]
fn text_from_outside_is_neither_a_link_nor_html_in_a_report() {
    let hostile = "[x](javascript:alert(1)) <img src=x onerror=alert(1)> ![p](http://example.com/p.png) <javascript:a> \
                   &lt;b&gt; `c` \u{202e}\n\n[r]: javascript:alert(2)\n\n<script>alert(3)</script> | [r]";
    let dir = tempfile::tempdir().unwrap();
    let mut results = results(&[1, 5], 1);
    results.description = hostile.to_owned();
    results.estimate = hostile.to_owned();
    let fenced = format!("{hostile}\n```\n````\n# heading\n");
    let context = ReportContext {
        warnings: vec![hostile.to_owned()],
        notes: vec![hostile.to_owned()],
        command: fenced.clone(),
        scenario_yaml: fenced,
        ..context()
    };
    write(&Folder::new(dir.path()).unwrap(), &results, None, &context).unwrap();
    let page = fs::read_to_string(dir.path().join("report.html")).unwrap();
    for tag in ["<a ", "<a>", "<img", "<script", "<b>", "href=", "\u{202e}"] {
        assert!(!page.contains(tag), "{tag}");
    }
    assert!(page.matches("[x](javascript:alert(1))").count() >= 5, "shown as it is");
    assert_eq!(page.matches("<h1>").count(), 1);
    let report = fs::read_to_string(dir.path().join("report.md")).unwrap();
    let (text, _) = report.split_once("## To reproduce").unwrap();
    assert!(
        !text.contains("](javascript")
            && !text.replace("\\<", "").contains("<script")
            && !text.contains("\u{202e}"),
        "{text}"
    );
}

#[test]
fn a_run_on_a_real_log_has_no_paper_and_no_ratios() {
    let dir = tempfile::tempdir().unwrap();
    let mut results = results(&[1, 5], 1);
    results.description.clear();
    for row in &mut results.training {
        row.chosen.insert(USUAL_SCAN.to_owned(), -1.0);
    }
    let context = ReportContext { simulated: false, warnings: vec![], notes: vec![], ..context() };
    write(&Folder::new(dir.path()).unwrap(), &results, None, &context).unwrap();
    let report = fs::read_to_string(dir.path().join("report.md")).unwrap();
    assert!(!report.contains("Beside the paper") && !report.contains("true pose"));
    insta::assert_snapshot!("real_log_report", report);
}

/// Trials of a filter that starts anywhere have a table of their own: in report, terminal and summary, and nowhere else.
#[test]
fn localization_from_an_unknown_start_is_told() {
    let known = results(&ALL, 5);
    let unknown = RunResults { localized_within_m: Some(0.05), ..known.clone() };
    let [known, unknown] = [known, unknown].map(|results| {
        let dir = tempfile::tempdir().unwrap();
        let summary = write(&Folder::new(dir.path()).unwrap(), &results, None, &context()).unwrap();
        let [report, json] =
            ["report.md", "summary.json"].map(|name| fs::read_to_string(dir.path().join(name)).unwrap());
        [report, terminal_table(&summary, None), json]
    });
    for (text, sign) in
        unknown.iter().zip(["## From an unknown start", "within 30 m [%]", "trials_after_30_m"])
    {
        assert!(text.contains(sign), "{text}");
    }
    assert!(known.iter().all(|text| !text.contains("30 m") && !text.contains("30_m")));
}

/// Where reference and map disagree is said, with the errors elsewhere; of a drive that is all so there are none.
#[test]
fn a_reference_beside_the_map_is_told() {
    let mut results = results(&[1, 5], 2);
    assert!(warnings(&results).iter().all(|warning| !warning.contains("disagree")));
    let off = |first_scan, last_scan| Disagreement {
        first_scan,
        last_scan,
        least_m: 0.152,
        most_m: 0.35,
        near_m: 0.05,
        near_share: 0.561,
        near_share_beside: 0.849,
    };
    let last = results.trials[0].models[0].steps.len() as u32 - 1;
    let rmse = |from: u32| {
        let rows = results.trials.iter().flat_map(|trial| &trial.models[0].steps);
        let squares: Vec<f64> =
            rows.filter(|row| row.step >= from).map(|row| row.position_error_m().powi(2)).collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    };
    let elsewhere = rmse(5);
    results.disagreements = vec![off(0, 4)];
    let said = warnings(&results).into_iter().find(|warning| warning.contains("disagree")).unwrap();
    let expected = format!(
        "The reference poses and the map disagree in scans 0 to 4 by 0.15 to 0.35 m (56 % of their returns end within 0.05 m of \
         a mapped surface, 85 % from poses that far beside). A filter that is right in the map is wrong against the reference there. \
         RMSE without these scans: {} {elsewhere:.4} m, ",
        results.models[0]
    );
    assert!(said.starts_with(&expected), "{said}\n{expected}");
    let drawn = |results: &RunResults| {
        let dir = tempfile::tempdir().unwrap();
        write(&Folder::new(dir.path()).unwrap(), results, None, &context()).unwrap();
        fs::read_to_string(dir.path().join("figures/error_over_time.svg")).unwrap()
    };
    assert!(drawn(&results).contains("reference and map disagree"));
    results.disagreements.clear();
    assert!(!drawn(&results).contains("disagree"));
    results.disagreements = vec![off(0, last)];
    let said = warnings(&results).into_iter().find(|warning| warning.contains("disagree")).unwrap();
    assert!(said.ends_with("against the reference there."), "{said}");
}

#[test]
fn the_terminal_table_reads_as_agreed() {
    let table = terminal_table(&Summary::new(&results(&ALL, 30)).unwrap(), None);
    assert!(table.lines().all(|line| line.chars().count() <= 120), "wider than 120 columns");
    insta::assert_snapshot!("terminal_table", table);
}

#[test]
fn a_terminal_of_80_columns_has_every_figure() {
    let summary = Summary::new(&results(&ALL, 30)).unwrap();
    let table = terminal_table(&summary, Some(80));
    let drawn = table.lines().filter(|line| !line.starts_with("mean ±"));
    assert!(drawn.clone().all(|line| line.chars().count() <= 80), "wider than 80 columns:\n{table}");
    for figure in ["0.1402", "[0.0326,", "0.2382]", "± 0.1377", "0.0665", "[2.62,"] {
        assert!(table.contains(figure), "{figure} is not in\n{table}");
    }
}

#[test]
fn without_classic_the_first_model_is_the_baseline() {
    let summary = Summary::new(&results(&[5, 1], 30)).unwrap();
    let rmse = |name: &str| summary.models.get(name).unwrap().errors.position_rmse_m;
    let ratios = summary.ratios.get("beam_mixture").unwrap();
    let ratio = ratios.rmse_vs_first.unwrap();
    assert!((ratio.value - rmse("beam_mixture") / rmse("np_reg_registered")).abs() < 1e-12, "{ratio:?}");
    assert!(ratio.interval().unwrap().lo > 1.0 && ratios.rmse_vs_classic.is_none());
    assert!(terminal_table(&summary, None).contains("RMSE / np_reg_registered"));
    // With `classic`, or alone, a model has no other to be compared with.
    for models in [&[1, 0][..], &[5]] {
        let summary = Summary::new(&results(models, 30)).unwrap();
        assert!(summary.ratios.iter().all(|(_, ratios)| ratios.rmse_vs_first.is_none()));
    }
}

#[test]
fn lost_trials_large_errors_and_few_effective_particles_are_warned_of() {
    let of = |models: &[usize]| locsim_report::warnings(&results(models, 30));
    assert_eq!(of(&[1, 5]), Vec::<String>::new());
    let classic = of(&[0]);
    assert_eq!(classic.len(), 2, "{classic:?}");
    assert!(classic[0].starts_with("classic lost 1 of 30 trials"), "{classic:?}");
    assert!(
        classic[1].starts_with("Under classic, the RMSE (0.1402 m) is 4.8 times the median"),
        "{classic:?}"
    );
    let mut few = results(&[5], 2);
    let rows = few.trials.iter_mut().flat_map(|trial| &mut trial.models[0].steps);
    rows.for_each(|row| row.effective_sample_size = 0.04 * f64::from(row.particles));
    let few = locsim_report::warnings(&few);
    assert!(
        few.len() == 1
            && few[0].starts_with(
                "Fewer than 5 % of the particles were effective in most steps (np_reg_registered 100 %):"
            ),
        "{few:?}"
    );
}

#[test]
fn scans_that_were_not_taken_in_whole_are_warned_of() {
    let of = |every: u32| {
        let mut cut = results(&[5], 2);
        let rows = cut.trials.iter_mut().flat_map(|trial| &mut trial.models[0].steps);
        rows.filter(|row| row.step % every == 0).for_each(|row| row.likelihood_power = 0.25);
        locsim_report::warnings(&cut)
    };
    let [cut] = &of(4)[..] else { panic!("{:?}", of(4)) };
    assert!(cut.contains("median power: np_reg_registered 25 %, 0.250)"), "{cut}");
    assert_eq!(of(STEPS), Vec::<String>::new());

    let mut standing = results(&[1, 5], 2);
    let models = standing.trials.iter_mut().flat_map(|trial| &mut trial.models);
    let rows = models.flat_map(|model| &mut model.steps);
    rows.filter(|row| row.step < 3).for_each(|row| row.likelihood_power = 0.0);
    let standing = locsim_report::warnings(&standing);
    let expected = format!("6 of the {} scans of all trials", 2 * STEPS);
    assert!(standing.len() == 1 && standing[0].contains(&expected), "{standing:?}");
}

#[test]
fn the_summary_has_every_documented_field_in_the_scenarios_order() {
    let summary = Summary::new(&results(&ALL, 30)).unwrap();
    let text = serde_json::to_string(&summary).unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    for path in ["/scenario", "/seed", "/trials", "/seconds"] {
        assert!(json.pointer(path).is_some(), "{path}");
    }
    for (name, _, _) in MODELS {
        for field in [
            "lost_share",
            "position_rmse_m",
            "position_median_m",
            "position_p95_m",
            "position_std_m",
            "along/mean_m",
            "along/std_m",
            "across/mean_m",
            "across/std_m",
            "heading/mean_rad",
            "heading/std_rad",
            "ess_mean",
            "step_ms",
            "intervals/position_rmse_m/lo",
            "intervals/along/std_m/hi",
            "intervals/lost_share/hi",
            "kept/trials",
            "kept/position_rmse_m",
            "kept/intervals/position_rmse_m/lo",
            "train/histogram_match_m",
        ] {
            let path = format!("/models/{name}/{field}");
            assert!(json.pointer(&path).is_some_and(serde_json::Value::is_number), "{path}");
        }
        assert!(json.pointer(&format!("/models/{name}/train/log_loss_nats")).is_some());
        for ratio in ["position_std_vs_classic", "rmse_vs_classic", "rmse_vs_oracle"] {
            for end in ["value", "lo", "hi"] {
                let path = format!("/ratios/{name}/{ratio}/{end}");
                assert!(json.pointer(&path).is_some_and(serde_json::Value::is_number), "{path}");
            }
        }
    }
    let places: Vec<usize> =
        MODELS.iter().map(|(n, _, _)| text.find(&format!("\"{n}\":{{\"lost")).unwrap()).collect();
    assert!(places.is_sorted());
    // Read back, the same up to the last bit, which serde_json's fast parser doesn't promise.
    let again: Summary = serde_json::from_str(&text).unwrap();
    for ((name, ours), (again, theirs)) in summary.models.iter().zip(again.models.iter()) {
        assert_eq!(name, again);
        assert!((ours.errors.position_rmse_m - theirs.errors.position_rmse_m).abs() < 1e-12);
        assert_eq!(ours.train.log_loss_nats.is_some(), theirs.train.log_loss_nats.is_some());
    }
}

#[test]
fn the_summary_is_what_plain_arithmetic_gives() {
    let results = results(&[0, 5], 30);
    let summary = Summary::new(&results).unwrap();
    let rows: Vec<&StepRow> = results.trials.iter().flat_map(|t| &t.models[0].steps).collect();
    let n = rows.len() as f64;
    let errors = summary.models.get("classic").unwrap().errors;
    let square = rows.iter().map(|r| r.error_along_m.powi(2) + r.error_across_m.powi(2)).sum::<f64>() / n;
    assert!((errors.position_rmse_m - square.sqrt()).abs() < 1e-12);
    let mean = rows.iter().map(|r| r.error_along_m).sum::<f64>() / n;
    assert!((errors.along.mean_m - mean).abs() < 1e-12);
    let spread = errors.along.std_m.hypot(errors.across.std_m);
    assert!((errors.position_std_m - spread).abs() < 1e-12);
    let bias = errors.along.mean_m.hypot(errors.across.mean_m);
    assert!((errors.position_rmse_m - spread.hypot(bias)).abs() < 1e-12);
    let mut distances: Vec<f64> = rows.iter().map(|r| r.position_error_m()).collect();
    distances.sort_by(f64::total_cmp);
    // 1800 steps: the median is halfway between the 900th and the 901st.
    assert!((errors.position_median_m - f64::midpoint(distances[899], distances[900])).abs() < 1e-12);

    let ratio = summary.ratios.get("np_reg_registered").unwrap().rmse_vs_classic.unwrap();
    let other = summary.models.get("np_reg_registered").unwrap().errors.position_rmse_m;
    assert!((ratio.value - other / errors.position_rmse_m).abs() < 1e-12);
    assert!(ratio.interval().unwrap().contains(ratio.value));
    assert_eq!(summary.ratios.get("classic").unwrap().rmse_vs_classic.unwrap().interval().unwrap().lo, 1.0);
    assert_eq!(summary.ratios.get("classic").unwrap().rmse_vs_oracle, None);
}

#[test]
fn lost_trials_are_in_the_main_figures_and_not_in_the_kept_ones() {
    let summary = Summary::new(&results(&ALL, 30)).unwrap();
    let classic = summary.models.get("classic").unwrap();
    let kept = classic.kept.unwrap();
    assert!((classic.lost_share - 1.0 / 30.0).abs() < 1e-12);
    assert_eq!(kept.trials, 29);
    assert!(classic.errors.position_rmse_m > 2.0 * kept.errors.position_rmse_m);
    let intact = summary.models.get("p_reg").unwrap();
    assert_eq!(intact.kept.unwrap().errors, intact.errors);
    let pick = |ratios: &indexmap::IndexMap<String, locsim_report::summary::Ratios>| {
        ratios.get("np_reg").unwrap().rmse_vs_classic.unwrap().value
    };
    assert!(pick(&summary.ratios) < 0.5 * pick(&summary.ratios_kept));
}

#[test]
fn one_trial_has_errors_without_intervals_and_ratios_by_its_steps() {
    let summary = Summary::new(&results(&[0, 5], 1)).unwrap();
    let model = summary.models.get("np_reg_registered").unwrap();
    assert_eq!(model.intervals, None);
    let ratio = summary.ratios.get("np_reg_registered").unwrap().rmse_vs_classic.unwrap();
    let rmse = |name: &str| summary.models.get(name).unwrap().errors.position_rmse_m;
    assert!((ratio.value - rmse("np_reg_registered") / rmse("classic")).abs() < 1e-12, "{}", ratio.value);
    let interval = ratio.interval().unwrap();
    assert!(interval.contains(ratio.value) && interval.hi > 1.1 * interval.lo, "{interval:?}");
    let table = terminal_table(&summary, None);
    assert!(table.contains("np_reg_registered") && table.contains("of ratios by the steps of the one drive"));
}

#[test]
fn results_that_make_no_sense_are_refused() {
    let refused = |change: fn(&mut RunResults)| {
        let mut results = results(&[0, 5], 2);
        change(&mut results);
        Summary::new(&results).unwrap_err()
    };
    assert_eq!(refused(|r| r.trials.clear()), SummaryError::Empty("trials"));
    assert!(matches!(refused(|r| r.models.clear()), SummaryError::Empty("models")));
    assert!(matches!(refused(|r| r.trials[1].models.reverse()), SummaryError::Models { trial: 1, .. }));
    assert!(matches!(refused(|r| r.training.truncate(1)), SummaryError::Training { rows: 1, models: 2 }));
    assert!(matches!(
        refused(|r| r.trials[0].models[1].steps.clear()),
        SummaryError::NoSteps { trial: 0, .. }
    ));
    let not_finite = refused(|r| r.trials[1].models[0].steps[5].error_along_m = f64::NAN);
    assert_eq!(not_finite, SummaryError::NotFinite { trial: 1, model: "classic".to_owned(), step: 5 });
}

#[test]
fn parquet_and_csv_hold_the_same_table() {
    let dir = tempfile::tempdir().unwrap();
    let results = results(&[0, 5], 3);
    write(&Folder::new(dir.path()).unwrap(), &results, None, &context()).unwrap();
    for (name, expected_rows) in [("steps", 2 * 3 * STEPS as usize), ("trials", 2 * 3)] {
        let file = fs::File::open(dir.path().join(format!("{name}.parquet"))).unwrap();
        let reader = ParquetRecordBatchReaderBuilder::try_new(file).unwrap();
        let schema = Arc::clone(reader.schema());
        let batches: Vec<_> = reader.build().unwrap().map(Result::unwrap).collect();
        let mut csv = csv::Reader::from_path(dir.path().join(format!("{name}.csv"))).unwrap();
        let names: Vec<_> = schema.fields().iter().map(|f| f.name().as_str()).collect();
        assert_eq!(csv.headers().unwrap().iter().collect::<Vec<_>>(), names);
        let mut records = csv.records().map(Result::unwrap);
        let mut rows = 0;
        for batch in batches {
            for row in 0..batch.num_rows() {
                let record = records.next().unwrap();
                for (column, cell) in batch.columns().iter().zip(record.iter()) {
                    match column.data_type() {
                        DataType::Float64 => {
                            assert_eq!(
                                column.as_primitive::<Float64Type>().value(row),
                                cell.parse::<f64>().unwrap()
                            );
                        }
                        DataType::UInt32 => {
                            assert_eq!(
                                column.as_primitive::<UInt32Type>().value(row),
                                cell.parse::<u32>().unwrap()
                            );
                        }
                        DataType::UInt64 => {
                            assert_eq!(
                                column.as_primitive::<UInt64Type>().value(row),
                                cell.parse::<u64>().unwrap()
                            );
                        }
                        DataType::Boolean => assert_eq!(column.as_boolean().value(row).to_string(), cell),
                        _ => assert_eq!(column.as_string::<i32>().value(row), cell),
                    }
                }
                rows += 1;
            }
        }
        assert_eq!(rows, expected_rows);
        assert!(records.next().is_none());
    }
}

/// Every file of a folder with its bytes, by path.
fn files(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    [dir.to_owned(), dir.join("figures")]
        .iter()
        .flat_map(|d| fs::read_dir(d).unwrap())
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.is_file())
        .map(|path| (path.strip_prefix(dir).unwrap().display().to_string(), fs::read(&path).unwrap()))
        .collect()
}

#[test]
fn a_full_run_leaves_every_file_and_the_same_bytes_each_time() {
    let [first, second] = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    full_report(first.path());
    full_report(second.path());
    let written = files(first.path());
    assert!(written == files(second.path()), "a second report differs");
    let mut expected: Vec<String> = [
        "report.html",
        "report.md",
        "steps.csv",
        "steps.parquet",
        "summary.json",
        "trials.csv",
        "manifest.json",
        "trials.parquet",
    ]
    .map(str::to_owned)
    .to_vec();
    for figure in [
        "effective_sample_size",
        "error_distribution",
        "error_over_time",
        "filter_snapshots",
        "predicted_densities",
        "rmse",
        "trajectories",
    ] {
        expected.extend([format!("figures/{figure}.png"), format!("figures/{figure}.svg")]);
    }
    expected.sort();
    assert_eq!(written.keys().cloned().collect::<Vec<_>>(), expected);

    let page = String::from_utf8(written["report.html"].clone()).unwrap();
    let outside = page.replace("http://www.w3.org/2000/svg", "");
    for forbidden in ["http://", "https://", "<script", "<link", "<img", "src=", "@import", "url("] {
        assert!(!outside.contains(forbidden), "the page has {forbidden}");
    }
    assert_eq!(page.matches("<svg ").count(), 7);
    for (path, bytes) in &written {
        if Path::new(path).extension().is_some_and(|e| e == "png") {
            assert!(is_drawn(bytes), "{path} is empty");
        }
    }
}

/// A PNG of a sensible size that compresses to more than a blank sheet would.
fn is_drawn(png: &[u8]) -> bool {
    let word = |at: usize| u32::from_be_bytes(png[at..at + 4].try_into().unwrap());
    png.starts_with(b"\x89PNG") && word(16) == 1920 && word(20) > 400 && png.len() > 20_000
}

#[test]
fn a_folder_that_cannot_be_written_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("taken");
    fs::write(&file, "").unwrap();
    let error = Folder::new(&file).unwrap_err();
    assert!(matches!(&error, StoreError::File { .. }) && error.to_string().contains("taken"), "{error}");
}
