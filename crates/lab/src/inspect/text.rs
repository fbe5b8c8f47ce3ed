use std::fmt::{self, Write as _};

use locsim_core::Pose2;
use locsim_dataset::{DriveQuality, LogFormat, OdometrySource, ReadingQuality, Scanner};
use locsim_report::text::{TextTable, listing};

use super::{DriveFacts, Inspection, Part, Role, Split};

/// Topics and pairs of frames that are listed, at the most.
const LISTED: usize = 40;
/// Blanks before a table.
const INDENT: usize = 2;

impl Inspection {
    /// In words, for a terminal of `width` columns; `None` where lines may be as long as their content.
    pub fn to_terminal(&self, width: Option<usize>) -> String {
        let mut text = String::new();
        // Writing to a string doesn't fail.
        _ = self.write(&mut text, width);
        text
    }

    fn write(&self, f: &mut String, width: Option<usize>) -> fmt::Result {
        let format = match self.contents.format {
            LogFormat::Bag => "ROS 2 bag",
            LogFormat::Carmen => "CARMEN log",
        };
        writeln!(f, "{}: {format}", self.file)?;
        self.topics(f, width)?;
        section(f, width, "Scanners", &self.scanners())?;
        if let Some(problem) = &self.problem {
            section(f, width, "Not readable as a drive", &[("reason", problem.clone())])?;
        }
        if let Some(drive) = &self.drive {
            drive.sections(f, width)?;
            if !self.reference_candidates.is_empty() {
                let named = self.reference_candidates.join(" or ");
                let text = format!(
                    "none; --reference-topic may name {named}: errors, a split, `map` and `gap` need one"
                );
                section(f, width, "Reference", &[("poses", text)])?;
            }
        }
        let lack = |lacks: &[String]| {
            if lacks.is_empty() { "ready".to_owned() } else { format!("needs {}", lacks.join("; ")) }
        };
        let lacks = &self.lacks;
        section(
            f,
            width,
            "Commands",
            &[("map", lack(&lacks.map)), ("run", self.run(lack(&lacks.run))), ("gap", lack(&lacks.gap))],
        )?;
        if let Some(split) = &self.split {
            writeln!(f, "\nProposed split")?;
            write!(f, "{}", indented(&split.table(), width))?;
            let keys = split.yaml().lines().fold(String::new(), |keys, line| format!("{keys}  {line}\n"));
            writeln!(f, "\n{keys}")?;
        }
        if !self.warnings.is_empty() {
            let warnings: Vec<_> = self.warnings.iter().map(|warning| ("-", warning.clone())).collect();
            section(f, width, "Warnings", &warnings)?;
        }
        Ok(())
    }

    fn topics(&self, f: &mut String, width: Option<usize>) -> fmt::Result {
        let contents = &self.contents;
        let rows = contents.topics.iter().take(LISTED).map(|topic| {
            [
                topic.name.clone(),
                topic.kind.clone(),
                topic.messages.to_string(),
                number(topic.rate_hz, 1),
                number(topic.longest_gap_secs, 2),
            ]
        });
        let header = ["topic", "type", "messages", "rate [Hz]", "longest gap [s]"];
        write!(f, "\n{}", indented(&TextTable::new(header, rows), width))?;
        more(f, contents.topics.len())?;
        if !contents.transforms.is_empty() {
            let rows = contents.transforms.iter().take(LISTED).map(|pair| {
                let source = if pair.is_static { "static" } else { "/tf" };
                [pair.frames.clone(), source.to_owned(), pair.messages.to_string(), number(pair.rate_hz, 1)]
            });
            let header = ["transform", "source", "messages", "rate [Hz]"];
            write!(f, "\n{}", indented(&TextTable::new(header, rows), width))?;
            more(f, contents.transforms.len())?;
        }
        Ok(())
    }

    fn scanners(&self) -> Vec<(&str, String)> {
        let line = |scanner: &Scanner| {
            let beams = scanner.beams.as_ref().map_or_else(String::new, |beams| {
                let row = beams_in_words(beams.count, beams.first_rad, beams.step_rad);
                format!("; {row}; {} to {} m; frame {}", beams.min_range_m, beams.max_range_m, beams.frame)
            });
            let read = self.drive.as_ref().is_some_and(|drive| drive.scan_source == scanner.source);
            format!("{} scans{}{beams}", scanner.scans, if read { ", read here" } else { "" })
        };
        self.contents.scanners.iter().map(|scanner| (scanner.source.as_str(), line(scanner))).collect()
    }

    /// The state of `locsim run`, which works without a reference on a map.
    fn run(&self, lack: String) -> String {
        let references = self.drive.as_ref().map_or(0, DriveFacts::references);
        if self.lacks.run.is_empty() && references == 0 {
            "ready with a map (`map:`), but without a reference it can't tell errors".to_owned()
        } else if self.lacks.run.is_empty() && self.split.is_none() {
            format!(
                "ready with a map (`map:`): {references} scans with a reference pose are too few to build one and train on others"
            )
        } else {
            lack
        }
    }
}

impl DriveFacts {
    fn sections(&self, f: &mut String, width: Option<usize>) -> fmt::Result {
        let DriveQuality { readings, odometry, reference, clock } = &self.quality;
        let laser = &self.laser;
        let mut rows = vec![
            ("beams", beams_in_words(laser.beams, laser.first_rad, laser.step_rad)),
            ("range", format!("{} to {} m", laser.min_range_m, laser.max_range_m)),
            (
                "readings",
                format!(
                    "{:.1} % without return, {:.1} % unusable, longest return {} m",
                    100.0 * readings.no_return_share,
                    100.0 * readings.unusable_share,
                    number(readings.longest_return_m, 2)
                ),
            ),
            (
                "resolution",
                readings
                    .resolution_m
                    .map_or("not quantized".to_owned(), |step| format!("{:.2} mm", 1e3 * step)),
            ),
            ("noise", noise(self)),
            ("stray readings", stray_readings(readings)),
            ("mount", format!("{}, {}", pose(&laser.mount), laser.mount_source)),
        ];
        if laser.sweep_secs > 0.0 {
            rows.push(("sweep", format!("{:.1} ms from the first beam to the last", 1e3 * laser.sweep_secs)));
        }
        section(f, width, "Laser", &rows)?;

        let mut rows = vec![("found", self.evidence.clone())];
        if let Some(odometry) = odometry {
            rows.push((
                "odometry",
                format!(
                    "{:.1} m driven, {:.0} deg turned{}",
                    odometry.driven_m,
                    odometry.turned_rad.to_degrees(),
                    odometry.jumps.map_or_else(String::new, |jumps| format!(", {jumps} jumps"))
                ),
            ));
            rows.push(("its error", odometry_error(odometry)));
            rows.extend(odometry.calibration.map(|found| ("of that, systematic", found.to_string())));
        } else {
            rows.push(("odometry", "none".to_owned()));
        }
        rows.push(("reference", self.reference(reference.as_ref())));
        section(f, width, "Poses", &rows)?;

        let mut rows = vec![(
            "scans",
            format!(
                "{} in {:.1} s, every {} s; {} gaps, the longest {:.2} s",
                self.scans,
                clock.duration_secs,
                number(clock.interval_secs, 3),
                clock.gaps,
                clock.longest_gap_secs
            ),
        )];
        rows.push((
            "stamps",
            format!(
                "from {:.3} s; {} repaired, {} repeated, {} scans left out, empty or beside the odometry",
                clock.first_secs, clock.repaired, clock.repeated, clock.dropped
            ),
        ));
        let lag = clock.odometry_lag_secs.map_or("can't be told from this drive".to_owned(), |lag| {
            let side = if lag < 0.0 { "ahead of" } else { "behind" };
            let error = clock.odometry_lag_error_secs.unwrap_or_default();
            format!("odometry {:.0} ± {:.0} ms {side} the scans", 1e3 * lag.abs(), 1e3 * error)
        });
        rows.push(("lag", lag));
        section(f, width, "Clocks", &rows)
    }

    fn reference(&self, reference: Option<&locsim_dataset::ReferenceQuality>) -> String {
        let Some(reference) = reference else { return "none".to_owned() };
        let mut text = format!("{} of {} scans", reference.scans, self.scans);
        let mut add = |part: String| {
            _ = write!(text, ", {part}");
        };
        if let Some(secs) = self.reference_interval_secs.filter(|secs| *secs > 0.0) {
            add(format!("a pose every {secs:.3} s"));
        }
        let recorded = self.reference_interval_secs.is_some();
        if self.references_interpolated > 0 {
            add(format!("{} of them interpolated", self.references_interpolated));
        } else if recorded {
            add("none of them interpolated".to_owned());
        }
        if reference.longest_gap_secs > 0.0 {
            add(format!("longest gap {:.1} s", reference.longest_gap_secs));
        }
        add(format!("{} jumps", reference.jumps));
        if let Some([x, y, theta]) = self.reference_deviation {
            add(format!("sigma {x:.3} m, {y:.3} m, {:.2} deg by its covariance", theta.to_degrees()));
        }
        text
    }
}

fn noise(facts: &DriveFacts) -> String {
    let readings = &facts.quality.readings;
    let still = match (facts.odometry_source, readings.still_noise_m) {
        (OdometrySource::Missing, _) => "no odometry tells when the robot stands still".to_owned(),
        (_, None) => {
            format!("the robot never stands still for {} scans on end", ReadingQuality::LEAST_STILL_SCANS)
        }
        (_, Some(sigma)) => {
            format!("sigma {:.1} mm from {} scans standing still", 1e3 * sigma, readings.still_scans)
        }
    };
    let flat = readings.flat_noise_m.map_or_else(String::new, |sigma| {
        format!("; {:.1} mm between neighbouring beams on flat walls, whose unevenness is in it", 1e3 * sigma)
    });
    let by_range = readings.noise_by_range.map_or_else(String::new, |[sigma, growth]| {
        format!("; by range {:.1} mm and {:.1} mm per metre", 1e3 * sigma, 1e3 * growth)
    });
    format!("{still}{flat}{by_range}")
}

/// What a scenario's `range_dropout` and `crosstalk` may have at the most.
fn stray_readings(readings: &ReadingQuality) -> String {
    let shares = [(readings.lost_share, "lost"), (readings.random_share, "random")];
    let told = shares.map(|(share, what)| Some(format!("{:.2} % {what}", 100.0 * share?)));
    let told: Vec<String> = told.into_iter().flatten().collect();
    if told.is_empty() {
        "too few readings between two others of one wall to tell".to_owned()
    } else {
        format!("at most {}, between others of one wall", told.join(" and "))
    }
}

fn odometry_error(odometry: &locsim_dataset::OdometryQuality) -> String {
    let Some(error) = &odometry.error else {
        return "no reference to compare it with over a few metres".to_owned();
    };
    let mut text = format!(
        "distance x {:.3}, position {:.1} cm per metre",
        error.distance_ratio,
        100.0 * error.position_per_m
    );
    if let Some(per_m) = error.heading_per_m {
        _ = write!(text, ", heading {:.2} deg per metre straight on", per_m.to_degrees());
    }
    if let Some(per_rad) = error.heading_per_rad {
        _ = write!(text, ", {:.1} % of each turn", 100.0 * per_rad);
    }
    if odometry.lag_secs != 0.0 {
        _ = write!(text, ", beside a lag of {:+.0} ms against the reference", 1e3 * odometry.lag_secs);
    }
    format!("{text} (over {} windows of about a metre)", error.windows)
}

/// `180 beams, the first at -90.00 deg, every +1.00 deg (counter-clockwise)`.
fn beams_in_words(count: usize, first_rad: f64, step_rad: f64) -> String {
    let direction = if step_rad < 0.0 { "clockwise" } else { "counter-clockwise" };
    let [first, step] = [first_rad, step_rad].map(f64::to_degrees);
    format!("{count} beams, the first at {first:.2} deg, every {step:+.3} deg ({direction})")
}

fn pose(pose: &Pose2) -> String {
    format!("x {:.3} m, y {:.3} m, yaw {:.2} deg", pose.x, pose.y, pose.theta.to_degrees())
}

fn number(value: Option<f64>, decimals: usize) -> String {
    value.map_or("-".to_owned(), |value| format!("{value:.decimals$}"))
}

fn section<N: AsRef<str>>(
    f: &mut String,
    width: Option<usize>,
    title: &str,
    rows: &[(N, String)],
) -> fmt::Result {
    let listed = if rows.is_empty() { "  none\n".to_owned() } else { listing(rows, width) };
    write!(f, "\n{title}\n{listed}")
}

fn more(f: &mut String, count: usize) -> fmt::Result {
    if count > LISTED { writeln!(f, "  and {} more", count - LISTED) } else { Ok(()) }
}

fn indented(table: &TextTable, width: Option<usize>) -> String {
    let text = table.to_terminal(width.map(|width| width.saturating_sub(INDENT)));
    text.lines().fold(String::new(), |text, line| format!("{text}{:INDENT$}{line}\n", ""))
}

impl Split {
    /// The parts of the drive, with what each is for and how much of it the map knows.
    pub fn table(&self) -> TextTable {
        let row = |part: &Part| {
            let [from, to] = part.scans;
            [
                format!("{from:.2} to {to:.2}"),
                format!("{:.0}", 100.0 * part.covered_by_others),
                format!("{:.0}", 100.0 * part.covered_by_map),
                match part.role {
                    Role::Map => "map",
                    Role::Train => "training",
                    Role::Localize => "localization",
                    Role::MapAndTrain => "map and training",
                }
                .to_owned(),
            ]
        };
        TextTable::new(
            ["share of the scans", "known to the others [%]", "known to the map [%]", "proposed for"],
            self.parts.iter().map(row),
        )
    }

    /// The keys of a scenario's `log` section.
    pub fn yaml(&self) -> String {
        let list = |shares: &[[f64; 2]]| {
            let shares: Vec<String> = shares.iter().map(|[from, to]| format!("[{from}, {to}]")).collect();
            format!("[{}]", shares.join(", "))
        };
        format!(
            "log:\n  map_scans: {}\n  train_scans: {}\n  localize_scans: {}\n",
            list(&self.map_scans),
            list(&self.train_scans),
            list(&[self.localize_scans])
        )
    }
}
