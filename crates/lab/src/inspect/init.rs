//! `locsim init`: a scenario from a recording.

use std::path::Path;

use locsim_dataset::{LogOptions, OdometryError, SICK_MAX_RANGE, decimal};
use locsim_scenario::edit::yaml_path;
use locsim_scenario::effect::quoted_text;
use locsim_scenario::{Overrides, Scenario};
use minijinja::syntax::SyntaxConfig;
use minijinja::{Environment, context};

use super::{DriveFacts, Inspection, Split};
use crate::LabError;
use locsim_report::ReportError;

const TEMPLATE: &str = include_str!("templates/scenario.yaml.j2");

/// Trials and particles: a report after some minutes on two cores.
const TRIALS: u32 = 5;
const PARTICLES: &str = "2000";
/// A global start needs particles everywhere at first.
const GLOBAL_PARTICLES: &str =
    "{kld: {min: 2000, max: 60000, error: 0.02, quantile: 0.99, bin_m: 0.2, bin_deg: 10}}";
/// Beams that models are trained on and that the filter uses, at the most: neighbours tell the same.
const TRAINING_BEAMS: usize = 90;
const FILTER_BEAMS: usize = 36;
/// The deviation of a reading where nothing is known of it \[m\]: that of most lidars.
const USUAL_SIGMA_M: f64 = 0.02;
/// Readings that differ by more than this are of different things \[m\].
const MOST_SIGMA_M: f64 = 0.3;
/// The shares of lost and of random readings where nothing is known of them, and the most that a scenario is given: what goes beyond is for
/// `locsim gap` to find.
const USUAL_SHARE: f64 = 0.01;
/// The least of them: none in some ten thousand readings doesn't say never.
const LEAST_SHARE: f64 = 1e-4;
/// A field of view that lacks less than this many beams of a full circle is one.
const FULL_CIRCLE_BEAMS: f64 = 1.5;
/// Rounding to f32 doesn't make -180 degrees 180 \[deg\].
const ROUNDING_DEG: f64 = 1e-4;
/// Without a proposed split, half of the log serves training and the other half localization.
const HALVES: [[f64; 2]; 2] = [[0.0, 0.5], [0.5, 1.0]];

/// The files that a new scenario names, and where it will stand.
#[derive(Clone, Debug)]
pub struct NewScenario<'a> {
    /// The log.
    pub log: &'a Path,
    /// The map; `None` to build one from the log.
    pub map: Option<&'a Path>,
    /// Side of the map's cells \[m\], if it has any.
    pub cell_m: Option<f64>,
    /// The scenario's file.
    pub out: &'a Path,
    /// How the log is read.
    pub options: LogOptions,
}

impl NewScenario<'_> {
    /// The text of the scenario.
    ///
    /// # Errors
    /// [`LabError::Log`] for a log without scans, or without odometry, or without both a reference and a map, and for one of which no legal
    /// scenario comes: numbers that are out of range, a file that scenarios can't name.
    pub fn text(&self, inspection: &Inspection) -> Result<String, LabError> {
        let refuse = |what: String| LabError::Log { path: self.log.to_owned(), what };
        if let Some(problem) = &inspection.problem {
            return Err(refuse(problem.clone()));
        }
        let facts = inspection
            .drive
            .as_ref()
            .filter(|_| inspection.lacks.run.is_empty())
            .ok_or_else(|| refuse(format!("a scenario needs {}", inspection.lacks.run.join("; "))))?;
        let has_reference = facts.references() > 0;
        let split = inspection.split.as_ref();
        if self.map.is_none() && split.is_none() {
            return Err(refuse(if has_reference {
                format!(
                    "{} scans with a reference pose are too few for a map, for training and for the filter; --map names a \
                     map",
                    facts.references()
                )
            } else {
                format!(
                    "without reference poses no map can be built from the log; --map names a map, {}",
                    inspection.reference_in_words()
                )
            }));
        }
        let text = self.render(facts, split).map_err(ReportError::from)?;
        // A folder that isn't there is refused when the file is written; here no file would be found from it.
        if self.out.parent().is_none_or(|folder| folder.as_os_str().is_empty() || folder.is_dir()) {
            Scenario::of_text(self.out, &text, &Overrides::default()).map_err(|error| {
                refuse(format!(
                    "no scenario can be made of it; `locsim inspect` says what is odd about the log. {error}"
                ))
            })?;
        }
        Ok(text)
    }

    /// Where the maximum range is from.
    fn max_range_comment(&self, facts: &DriveFacts) -> &'static str {
        match self.options.max_range_m {
            Some(_) => "as --max-range says",
            None if facts.laser.max_range_m == decimal(SICK_MAX_RANGE) => {
                "that of a SICK LMS, where the log names none"
            }
            None => "as the log says",
        }
    }

    fn render(&self, facts: &DriveFacts, split: Option<&Split>) -> Result<String, minijinja::Error> {
        let has_reference = facts.references() > 0;
        let folder = self.out.parent().unwrap_or(Path::new(""));
        let shares = Shares::of(split, self.map.is_some(), has_reference);
        let error = facts.quality.odometry.as_ref().and_then(|odometry| odometry.error.as_ref());
        let (alpha, alpha_comment) = odometry_noise(error);
        let laser = Laser::of(facts);
        let readings = &facts.quality.readings;
        let (sigma_m, mut noise_comment) = match (readings.still_noise_m, readings.flat_noise_m) {
            (Some(sigma), _) if sigma > 0.0 && sigma < MOST_SIGMA_M => {
                (sigma, format!("estimated from {} scans standing still", readings.still_scans))
            }
            (_, Some(sigma)) if sigma > 0.0 && sigma < MOST_SIGMA_M => {
                (sigma, "estimated from neighbouring beams on flat walls, so at most this".to_owned())
            }
            _ => (USUAL_SIGMA_M, "a guess: the recording doesn't tell".to_owned()),
        };
        // Models that are trained on simulated scans take the map for exact; a grid's walls are no finer than its cells.
        let cell_m = self.cell_m.filter(|cell| !has_reference && *cell > sigma_m);
        if let Some(cell) = cell_m {
            noise_comment = format!(
                "a cell of the map, {cell} m, which simulated scans don't err by otherwise; the readings' own noise: {} m, {noise_comment}",
                rounded(sigma_m, 2)
            );
        }
        let (sigma_m, sigma_per_m) =
            match (cell_m, readings.noise_by_range.filter(|[sigma, _]| *sigma < MOST_SIGMA_M)) {
                (Some(cell), _) => (cell, None),
                (None, Some([sigma_m, growth])) => (sigma_m, Some(growth)),
                (None, None) => (sigma_m, None),
            };
        let (interval_secs, rate_comment) = interval(facts);
        // Models that are trained on simulated scans have to expect what the map lacks, too.
        let [lost, random] = [readings.lost_share, readings.random_share]
            .map(|share| stray_share(share.filter(|_| has_reference)));
        let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let mount = facts.laser.mount;
        let mut environment = Environment::new();
        environment.set_syntax(SyntaxConfig::builder().trim_blocks(true).lstrip_blocks(true).build()?);
        environment.add_template("scenario.yaml", TEMPLATE)?;
        let visible = |text: String| locsim_core::limits::quoted(&text);
        let page = context! {
            log_name => visible(name(self.log)),
            file_name => visible(self.out.display().to_string()),
            description => quoted_text(&format!("Localization on {}", name(self.log))),
            trials => TRIALS,
            has_reference => has_reference,
            map => self.map.map(|map| yaml_path(map, folder)),
            log => yaml_path(self.log, folder),
            split_map => self.map.is_none(),
            map_scans => list(&shares.map),
            train_scans => (!shares.train.is_empty()).then(|| list(&shares.train)),
            localize_scans => list(&shares.localize),
            split_comment => shares.comment,
            max_range_m => self.options.max_range_m.map(|max| max.to_string()),
            topics => self.topics(facts),
            training_beams => facts.laser.beams.min(TRAINING_BEAMS),
            filter_beams => facts.laser.beams.min(FILTER_BEAMS),
            beams => facts.laser.beams,
            laser_beams => laser.beams,
            beams_comment => laser.beams_comment,
            models => if has_reference { MODELS.to_vec() } else { SIMULATED_MODELS.to_vec() },
            particles => if has_reference { PARTICLES } else { GLOBAL_PARTICLES },
            usual_alpha => numbers(&OdometryError::USUAL_ALPHA),
            trained => if has_reference { "" } else { ", and what `locsim run` trains its models on" },
            alpha => numbers(&alpha),
            alpha_comment => alpha_comment,
            rate_hz => rounded(1.0 / interval_secs, 4),
            rate_comment => rate_comment,
            field_of_view_deg => laser.field_of_view_deg,
            first_beam_deg => laser.first_beam_deg,
            direction => laser.direction,
            min_range_m => rounded(facts.laser.min_range_m, 4),
            max_range => rounded(facts.laser.max_range_m, 6),
            max_range_comment => self.max_range_comment(facts),
            resolution_m => readings.resolution_m.map_or(0.0, |step| rounded(step, 3)),
            resolution_comment => if readings.resolution_m.is_some() {
                "estimated: differences of readings are multiples of it"
            } else {
                "estimated: the readings aren't quantized"
            },
            sigma_m => rounded(sigma_m.max(1e-5), 3),
            sigma_per_m => sigma_per_m.map(|growth| rounded(growth, 3)),
            noise_comment => noise_comment,
            lost => lost.0,
            lost_comment => lost.1,
            random => random.0,
            random_comment => random.1,
            mount_x => micro(mount.x),
            mount_y => micro(mount.y),
            mount_yaw => micro(mount.theta.to_degrees()),
            mount_comment => facts.laser.mount_source.to_string(),
            scan_secs => (laser.scan_secs > 0.0).then(|| rounded(laser.scan_secs, 4)),
        };
        Ok(environment.get_template("scenario.yaml")?.render(page)? + "\n")
    }

    /// The topics that were named.
    fn topics(&self, facts: &DriveFacts) -> Option<String> {
        let named = &self.options.topics;
        // One of several scanners is chosen; the choice is written down.
        let scan = named.scan.as_ref().or((facts.scan_source.starts_with('/')).then_some(&facts.scan_source));
        let all =
            [("scan", scan), ("odometry", named.odometry.as_ref()), ("reference", named.reference.as_ref())];
        let given: Vec<String> = all
            .into_iter()
            .filter_map(|(key, topic)| Some(format!("{key}: {}", quoted_text(topic?))))
            .collect();
        (!given.is_empty()).then(|| format!("{{{}}}", given.join(", ")))
    }
}

/// The time between scans \[s\], and where it is from.
fn interval(facts: &DriveFacts) -> (f64, &'static str) {
    let clock = &facts.quality.clock;
    let mean = (facts.scans > 1).then(|| clock.duration_secs / (facts.scans - 1) as f64);
    let [median, mean] = [clock.interval_secs, mean].map(|secs| secs.filter(|secs| *secs > 0.0));
    match (median, mean) {
        (Some(median), _) => (median, "the median time between scans"),
        // Stamps of whole seconds are alike from scan to scan.
        (None, Some(mean)) => {
            (mean, "the mean time between scans, most of which have the stamp of the scan before")
        }
        (None, None) => (0.1, "a guess: the stamps don't tell"),
    }
}

/// A share of stray readings for the scenario, and where it is from.
fn stray_share(found: Option<f64>) -> (f64, &'static str) {
    match found {
        Some(share) if share < USUAL_SHARE => {
            (rounded(share.max(LEAST_SHARE), 2), "estimated between neighbours on one wall, so at most this")
        }
        _ => (USUAL_SHARE, "a guess"),
    }
}

/// Models of a log with a reference, and of one without, whose models are trained on simulated scans.
const MODELS: [&str; 5] = ["likelihood_field", "beam_mixture", "np_reg", "np_reg_registered", "np_reg_field"];
const SIMULATED_MODELS: [&str; 3] = ["likelihood_field", "beam_mixture", "np_reg_registered"];

/// The use of the scans.
struct Shares {
    map: Vec<[f64; 2]>,
    train: Vec<[f64; 2]>,
    localize: Vec<[f64; 2]>,
    comment: String,
}

impl Shares {
    fn of(split: Option<&Split>, has_map: bool, has_reference: bool) -> Self {
        if !has_reference {
            let comment = "the whole log".to_owned();
            return Self { map: Vec::new(), train: Vec::new(), localize: vec![[0.0, 1.0]], comment };
        }
        let Some(split) = split else {
            let [train, localize] = HALVES.map(|half| vec![half]);
            return Self { map: Vec::new(), train, localize, comment: "the second half".to_owned() };
        };
        let localize = vec![split.localize_scans];
        if has_map {
            // All others train.
            let [from, to] = split.localize_scans;
            let train = [[0.0, from], [to, 1.0]].into_iter().filter(|[from, to]| from < to).collect();
            return Self { map: Vec::new(), train, localize, comment: "by `locsim inspect`".to_owned() };
        }
        Self {
            map: split.map_scans.clone(),
            train: split.train_scans.clone(),
            localize,
            comment: format!(
                "the map knows at least {:.0} % of the readings of each part of it (`locsim inspect`)",
                100.0 * split.least_localized
            ),
        }
    }
}

/// A laser in the keys of a scenario.
struct Laser {
    beams: usize,
    beams_comment: &'static str,
    field_of_view_deg: f64,
    first_beam_deg: f64,
    /// A comment on the direction of the beams.
    direction: &'static str,
    scan_secs: f64,
}

impl Laser {
    fn of(facts: &DriveFacts) -> Self {
        let laser = &facts.laser;
        let (count, step) = (laser.beams as f64, laser.step_rad.to_degrees());
        let all = step.abs() * (count - 1.0);
        // Many drivers have a beam at both ends of the circle; a scenario's circle has one there.
        let is_double = laser.beams > 2 && all > 360.0 - 0.5 * step.abs();
        let is_full = count > 1.0 && all > 360.0 - FULL_CIRCLE_BEAMS * step.abs();
        let first = laser.first_rad.to_degrees();
        let (first, direction) = if step < 0.0 {
            // A scenario's beams run counter-clockwise; gap matches them by their bearings.
            (first - all, " # the log's beams run clockwise; this is its last")
        } else {
            (first, "")
        };
        let first = (first + 180.0 + ROUNDING_DEG).rem_euclid(360.0) - 180.0 - ROUNDING_DEG;
        let period = facts.quality.clock.interval_secs.unwrap_or(0.0);
        // A scenario's sweep of a full circle ends where it began, one beam after the last.
        let turn = if is_full && !is_double { count / (count - 1.0) } else { 1.0 };
        Self {
            beams: laser.beams - usize::from(is_double),
            beams_comment: if is_double { " # the log's last beam points where its first does" } else { "" },
            field_of_view_deg: if is_full { 360.0 } else { rounded(all.max(1e-3), 7) },
            first_beam_deg: if first.abs() < ROUNDING_DEG { 0.0 } else { rounded(first, 7) },
            direction,
            scan_secs: (turn * laser.sweep_secs).clamp(0.0, 0.999 * period),
        }
    }
}

fn odometry_noise(error: Option<&OdometryError>) -> ([f64; 4], String) {
    match error {
        Some(error) => (
            error.alpha.map(|alpha| rounded(alpha, 2)),
            format!("estimated from {} windows of about a metre against the reference", error.windows),
        ),
        None => (
            OdometryError::USUAL_ALPHA,
            "a guess: there is no reference to compare the odometry with".to_owned(),
        ),
    }
}

/// A length or an angle to a millionth: the rest is rounding in messages.
fn micro(value: f64) -> f64 {
    // Not -0.
    (value * 1e6).round() / 1e6 + 0.0
}

/// A number with `digits` significant digits.
pub fn rounded(value: f64, digits: i32) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return 0.0;
    }
    let scale = 10_f64.powi(digits - 1 - value.abs().log10().floor() as i32);
    (value * scale).round() / scale
}

fn numbers(values: &[f64]) -> String {
    let values: Vec<String> = values.iter().map(|value| rounded(*value, 2).to_string()).collect();
    format!("[{}]", values.join(", "))
}

fn list(shares: &[[f64; 2]]) -> String {
    let shares: Vec<String> = shares.iter().map(|[from, to]| format!("[{from}, {to}]")).collect();
    format!("[{}]", shares.join(", "))
}
