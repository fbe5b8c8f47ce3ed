//! nav2's defaults against the exported parameters, on drives that the search hasn't seen.

use locsim_core::{Draw, Drive, Interval, Stage};
use locsim_report::TextTable;
use locsim_report::statistics::{Bootstrap, share_interval};
use locsim_report::text::{self, fixed, with_interval};
use rayon::prelude::*;

use super::amcl::{Errors, Localizer, Settings};
use super::search::{Found, Search};
use locsim_lab::LabError;

/// Under which name the rows stand, the first that the others are compared with.
const NAMES: [&str; 3] = ["nav2's defaults", "+ odometry's alphas", "exported"];

/// The noise of the odometry alone: twice what it is, as `locsim run` has it, and at least this.
const ODOMETRY: (f64, f64) = (2.0, 0.002);

/// The trials under each set of parameters.
pub(super) struct Comparison {
    rows: Vec<Row>,
}

/// The trials under one set of parameters.
struct Row {
    name: &'static str,
    trials: u32,
    lost: u32,
    /// Root mean squares of position \[m\] and heading \[rad\], and that of the position over those of the first row and of the row
    /// above (where that isn't the first), each with its interval.
    position_m: (f64, Option<Interval>),
    heading_rad: (f64, Option<Interval>),
    ratio: (f64, Option<Interval>),
    ratio_above: Option<(f64, Option<Interval>)>,
}

impl Comparison {
    /// Localizes on the drives of the trials under each set, with the same draws.
    ///
    /// # Errors
    /// [`LabError`] of a filter; an interruption.
    pub fn run(
        localizer: &Localizer,
        drives: &[Drive],
        found: &Found,
        search: &Search<'_>,
        trials: u32,
    ) -> Result<Self, LabError> {
        let (factor, least) = ODOMETRY;
        let odometry =
            Settings { alpha: search.alpha.map(|alpha| (factor * alpha).max(least)), ..Settings::DEFAULTS };
        let settings = [Settings::DEFAULTS, odometry, found.settings];
        search.control.progress.stage("trials", u64::from(trials));
        let seeds = Draw::new(search.seed, Stage::Trial, 0);
        let errors: Vec<Vec<Errors>> = (0..trials)
            .into_par_iter()
            .map(|trial| {
                if search.control.is_interrupted() {
                    return Err(LabError::Stopped);
                }
                let drive = &drives[trial as usize % drives.len()];
                let of = |settings| localizer.errors(settings, drive, seeds.seed(trial), f64::INFINITY);
                let errors = settings.iter().map(of).collect();
                search.control.progress.advance(1);
                errors
            })
            .collect::<Result<_, LabError>>()?;
        let bootstrap = Bootstrap::new(search.seed, errors.len());
        let rows = (0..NAMES.len()).map(|i| Row::of(i, &errors, bootstrap.as_ref())).collect();
        Ok(Self { rows })
    }

    /// The table of errors.
    pub fn table(&self) -> TextTable {
        TextTable::new(
            ["parameters", "RMSE [m]", "/ defaults", "/ row above", "RMSE [deg]", "lost [%]"],
            self.rows.iter().map(|row| {
                let degrees = |value: f64| value.to_degrees();
                let lost = share_interval(row.lost, row.trials);
                let lost_share = f64::from(row.lost) / f64::from(row.trials);
                [
                    row.name.to_owned(),
                    with_interval(
                        row.position_m.0,
                        row.position_m.1,
                        if row.position_m.0 < 10.0 { 3 } else { 2 },
                    ),
                    share(row.ratio),
                    row.ratio_above.map_or(text::NONE.to_owned(), share),
                    with_interval(
                        degrees(row.heading_rad.0),
                        row.heading_rad.1.map(|interval| interval.map(degrees)),
                        1,
                    ),
                    format!("{} [{}, {}]", percent(lost_share), percent(lost.lo), percent(lost.hi)),
                ]
            }),
        )
    }

    /// The result in a sentence.
    pub fn sentence(&self) -> String {
        let (defaults, exported) = (&self.rows[0], &self.rows[NAMES.len() - 1]);
        let lost = match (defaults.lost, exported.lost) {
            (0, 0) => String::new(),
            (before, after) => {
                format!(
                    " The defaults lose the robot in {before} of {} trials, these in {after}.",
                    exported.trials
                )
            }
        };
        Self::of_errors(exported) + &lost
    }

    fn of_errors(exported: &Row) -> String {
        let interval = exported.ratio.1;
        let ratio = share(exported.ratio);
        match interval {
            Some(Interval { hi, .. }) if hi < 1.0 => {
                format!("The exported parameters have {ratio} times the error of nav2's defaults.")
            }
            Some(Interval { lo, .. }) if lo > 1.0 => {
                format!(
                    "The exported parameters are worse here than nav2's defaults: {ratio} times their error."
                )
            }
            _ => format!("No difference from nav2's defaults: {ratio} times their error."),
        }
    }
}

/// A ratio, with more decimals where it is small.
fn share((value, interval): (f64, Option<Interval>)) -> String {
    with_interval(value, interval, if value < 0.1 { 3 } else { 2 })
}

fn percent(share: f64) -> String {
    fixed(100.0 * share, 0)
}

impl Row {
    fn of(i: usize, trials: &[Vec<Errors>], bootstrap: Option<&Bootstrap>) -> Self {
        let rms = |i: usize, axis: usize, copies: &[u32]| {
            let (mut squares, mut steps) = (0.0, 0.0);
            for (trial, &copies) in trials.iter().zip(copies) {
                squares += f64::from(copies) * trial[i].squares[axis];
                steps += f64::from(copies) * trial[i].steps as f64;
            }
            (squares / steps).sqrt()
        };
        let statistics = |copies: &[u32]| {
            let position = rms(i, 0, copies);
            let above = rms(i.saturating_sub(1), 0, copies);
            [position, rms(i, 1, copies), position / rms(0, 0, copies), position / above]
        };
        let [position, heading, ratio, ratio_above] = statistics(&vec![1; trials.len()]);
        let intervals = bootstrap.and_then(|bootstrap| bootstrap.intervals(statistics));
        let interval = |k: usize| intervals.map(|intervals| intervals[k]);
        Self {
            name: NAMES[i],
            trials: trials.len() as u32,
            lost: trials.iter().filter(|trial| trial[i].is_lost).count() as u32,
            position_m: (position, interval(0)),
            heading_rad: (heading, interval(1)),
            ratio: (ratio, interval(2).filter(|_| i > 0)),
            ratio_above: (i > 1).then(|| (ratio_above, interval(3))),
        }
    }
}
