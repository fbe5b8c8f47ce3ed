use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use locsim_core::limits::{MOST_TRIALS, quoted};
use locsim_lab::run::{CostEstimate, duration, size};
use locsim_report::trial_set::plain;
use locsim_scenario::check::Checker;
use locsim_scenario::error::unknown_word;
use locsim_scenario::{Overrides, Problem, Scenario, ScenarioError, Template, name, yaml};
use serde_json::{Number, Value};

use crate::plan::{Axis, Cells, Comparison, Condition, MOST_CELLS, MOST_COMBINATIONS, Operand, Plan};
use crate::raw::{RawAxis, RawRange, RawSweep};

/// The most values of an axis.
const MOST_VALUES: usize = 100_000;
/// Cells that are looked at for an estimate, evenly spread.
const SAMPLED_CELLS: u32 = 100;
/// Stands for the command of a shard in a template.
pub const COMMAND: &str = "{command}";
/// Stands for its arguments alone, where a container has the program elsewhere.
pub const ARGUMENTS: &str = "{arguments}";

/// A sweep that passed every check but those of its cells.
#[derive(Clone, Debug)]
pub struct Sweep {
    /// The file it was read from.
    pub file: PathBuf,
    /// Letters, digits, `-` and `_`.
    pub name: String,
    /// One line for people; may be empty.
    pub description: String,
    /// Lines around a shard's command on a cluster.
    pub template: Option<String>,
    scenario: Template,
    cells: Cells,
    /// Lines of the axes in the file.
    lines: Vec<Option<usize>>,
}

/// Settings that the command line overrides.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SweepOverrides {
    /// Number of trials.
    pub trials: Option<u32>,
    /// Seed.
    pub seed: Option<u64>,
}

impl Sweep {
    /// Reads and checks a sweep and its scenario.
    ///
    /// # Errors
    /// [`ScenarioError`] with everything that is wrong: file, line, key path, value and what is allowed.
    pub fn load(path: &Path, overrides: SweepOverrides) -> Result<Self, ScenarioError> {
        let (raw, locations) = yaml::parse::<RawSweep>(path, &yaml::read(path)?)?;
        let environment = |name: &str| std::env::var(name).ok();
        let mut check = Checker::new(path, &locations, &environment);
        let name = name(&mut check, raw.name.as_deref(), path);
        let file = check.file("scenario", &raw.scenario);
        let trials = match overrides.trials {
            Some(trials) => Some(check.count("--trials", trials.into(), 1, MOST_TRIALS)),
            None => raw.trials.map(|trials| check.count("trials", trials, 1, MOST_TRIALS)),
        };
        let axes: Vec<Axis> = raw
            .axes
            .iter()
            .map(|(key, axis)| Axis {
                key: key.clone(),
                values: values(&mut check, &format!("axes.{key}"), axis),
            })
            .collect();
        check.refuse(axes.is_empty(), "axes", || "no axes are not allowed; at least one".to_owned());
        overlaps(&mut check, &axes);
        check.refuse(trials.is_some() && axes.iter().any(|axis| axis.key == "trials"), "trials", || {
            "the key is not allowed here; `trials` is an axis".to_owned()
        });
        let groups = groups(&mut check, &axes, &raw.zip);
        let conditions = raw.conditions.iter().enumerate();
        let conditions = conditions
            .filter_map(|(i, text)| condition(&mut check, &format!("where[{i}]"), &axes, text))
            .collect();
        if let Some(template) = &raw.template {
            check.refuse(!template.contains(COMMAND) && !template.contains(ARGUMENTS), "template", || {
                format!("a text without {COMMAND} or {ARGUMENTS} is not allowed: the command of a shard, or its arguments alone")
            });
        }
        if !check.is_clean() {
            return Err(check.into_error());
        }
        let plan = Plan { seed: overrides.seed.unwrap_or(raw.seed), trials, axes, groups, conditions };
        let (sizes, combinations) = (plan.sizes(), plan.combinations());
        let Some(cells) = Cells::of(plan) else {
            match combinations {
                None => check.problem("axes", format!("{sizes} cells are not allowed; at most {MOST_CELLS}")),
                Some(n) => check.problem(
                    "where",
                    format!("each of {sizes} = {n} combinations would have to be looked at; at most {MOST_COMBINATIONS}"),
                ),
            }
            return Err(check.into_error());
        };
        if cells.count() == 0 {
            check.problem("where", "the conditions leave no cell");
            return Err(check.into_error());
        }
        let lines =
            cells.plan().axes.iter().map(|axis| locations.line(&format!("axes.{}", axis.key))).collect();
        Ok(Self {
            file: path.to_owned(),
            name,
            description: raw.description,
            template: raw.template,
            scenario: Template::load(&file)?,
            cells,
            lines,
        })
    }

    /// The cells.
    pub fn cells(&self) -> &Cells {
        &self.cells
    }

    /// The scenario's file.
    pub fn scenario_file(&self) -> &Path {
        &self.scenario.file
    }

    /// The scenario of a cell.
    ///
    /// # Errors
    /// [`ScenarioError`] with the axis whose value the scenario refuses.
    pub fn scenario(&self, cell: u32) -> Result<Scenario, ScenarioError> {
        let plan = self.cells.plan();
        let values = self.cells.values(cell);
        let has_seed = plan.axis("seed").is_some();
        let seed = (!has_seed).then(|| self.cells.seed(cell));
        let overrides = Overrides { trials: plan.trials, seed, models: None };
        let pairs = plan.axes.iter().map(|axis| axis.key.as_str()).zip(&values);
        self.scenario.with(pairs, &overrides).map_err(|error| self.refused(cell, &values, error))
    }

    /// A cell's scenario is refused: says so of the axes at fault.
    fn refused(&self, cell: u32, values: &[Value], error: ScenarioError) -> ScenarioError {
        let ScenarioError::Invalid { file, problems } = error else { return error };
        if file != self.scenario.file {
            return ScenarioError::Invalid { file, problems };
        }
        let axes = &self.cells.plan().axes;
        let at_fault =
            |problem: Problem| match axes.iter().position(|axis| are_related(&axis.key, &problem.key)) {
                Some(i) if axes[i].key == problem.key => Problem {
                    line: self.lines[i],
                    key: format!("axes.{}", axes[i].key),
                    message: problem.message,
                },
                Some(i) => Problem {
                    line: self.lines[i],
                    key: format!("axes.{}", axes[i].key),
                    message: format!("{}: {problem}", quoted(&plain(&values[i]))),
                },
                None => Problem {
                    line: self.lines.first().copied().flatten(),
                    key: "axes".to_owned(),
                    message: format!("cell {cell} ({}): {problem}", self.cells.name(cell)),
                },
            };
        let problems = problems.into_iter().map(at_fault).collect();
        ScenarioError::Invalid { file: self.file.clone(), problems }
    }

    /// A hash (BLAKE3, hexadecimal) of the version of this program, the scenario's text and the plan. The content of maps, logs
    /// and model files is not part of it.
    ///
    /// # Panics
    /// Never: numbers and text can be written.
    pub fn digest(&self) -> String {
        let settings = serde_json::json!([env!("CARGO_PKG_VERSION"), self.scenario.tree, self.cells.plan()]);
        blake3::hash(settings.to_string().as_bytes()).to_hex().to_string()
    }

    /// Some cells, evenly spread over all.
    fn sample(&self) -> impl Iterator<Item = u32> {
        let count = self.cells.count();
        let sampled = count.min(SAMPLED_CELLS);
        (0..sampled).map(move |i| (u64::from(i) * u64::from(count) / u64::from(sampled)) as u32)
    }

    /// Time and memory that all cells need on this machine, from a sample of them.
    ///
    /// # Errors
    /// [`ScenarioError`] for a cell of the sample that is refused.
    pub fn estimate(&self, threads: usize) -> Result<SweepEstimate, ScenarioError> {
        let mut estimate =
            SweepEstimate { cells: self.cells.count(), threads, cpu_secs: Some(0.0), memory_bytes: 0.0 };
        let mut looked_at = 0;
        for cell in self.sample() {
            let cost = CostEstimate::of(&self.scenario(cell)?, 1);
            estimate.cpu_secs = estimate.cpu_secs.zip(cost.cpu_secs).map(|(sum, secs)| sum + secs);
            estimate.memory_bytes = estimate.memory_bytes.max(cost.memory_bytes);
            looked_at += 1;
        }
        let share = f64::from(self.cells.count()) / f64::from(looked_at.max(1));
        estimate.cpu_secs = estimate.cpu_secs.map(|secs| secs * share);
        estimate.memory_bytes *= threads.min(self.cells.count() as usize) as f64;
        Ok(estimate)
    }
}

/// The cost of a sweep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SweepEstimate {
    /// Number of cells.
    pub cells: u32,
    /// Threads that share the work.
    pub threads: usize,
    /// Processor time \[s\]; `None` on measured logs, whose length isn't known before they are read.
    pub cpu_secs: Option<f64>,
    /// Memory \[bytes\], at most.
    pub memory_bytes: f64,
}

impl std::fmt::Display for SweepEstimate {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { cells, threads, cpu_secs, memory_bytes } = *self;
        write!(f, "{cells} cells; ")?;
        if let Some(secs) = cpu_secs {
            write!(f, "about {} on {threads} threads, ", duration(secs / threads as f64))?;
        }
        write!(f, "at most {} of memory", size(memory_bytes))
    }
}

/// Whether one path leads to or through the place of the other.
fn are_related(a: &str, b: &str) -> bool {
    let (short, long) = if a.len() <= b.len() { (a, b) } else { (b, a) };
    !short.is_empty()
        && long.strip_prefix(short).is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
}

/// Axes whose values would overwrite each other.
fn overlaps(check: &mut Checker<'_>, axes: &[Axis]) {
    // In order, a path stands right before those within it, save for paths that go on otherwise.
    let mut keys: Vec<&str> = axes.iter().map(|axis| axis.key.as_str()).collect();
    keys.sort_unstable();
    for (i, key) in keys.iter().enumerate() {
        if let Some(within) = keys[i + 1..].iter().find(|other| are_related(key, other)) {
            check.problem(
                &format!("axes.{within}"),
                format!("the axis is not allowed beside `{}`", quoted(key)),
            );
        }
    }
}

/// The values of an axis.
fn values(check: &mut Checker<'_>, key: &str, axis: &RawAxis) -> Vec<Value> {
    let values = match axis {
        RawAxis::List(values) => values.clone(),
        RawAxis::Range(range) => range_values(check, key, range),
    };
    check.refuse(values.is_empty() && matches!(axis, RawAxis::List(_)), key, || {
        "an empty list is not allowed; at least one value".to_owned()
    });
    check.length(key, &values, MOST_VALUES);
    let mut seen = BTreeSet::new();
    for (i, value) in values.iter().enumerate() {
        // 1 and 1.0 are the same value.
        let text = value.as_f64().map_or_else(|| value.to_string(), |number| number.to_string());
        if !seen.insert(text) {
            check.problem(&format!("{key}[{i}]"), format!("{} stands twice", quoted(&plain(value))));
        }
    }
    values
}

fn range_values(check: &mut Checker<'_>, key: &str, range: &RawRange) -> Vec<Value> {
    let RawRange { from, to, step, count, log } = range;
    let number = |number: &Number| number.as_f64().unwrap_or(f64::NAN);
    let (lo, hi) = (number(from), number(to));
    let before = check.is_clean();
    check.refuse(!lo.is_finite(), &format!("{key}.from"), || {
        format!("{from} is not allowed; a finite number")
    });
    check.refuse(hi.is_nan() || hi <= lo, &format!("{key}.to"), || {
        format!("{to} is not allowed; a number above {from}")
    });
    check.refuse(step.is_some() == count.is_some(), key, || "either `step` or `count` is needed".to_owned());
    if let Some(step) = step {
        let step = number(step);
        check.refuse(step <= 0.0, &format!("{key}.step"), || {
            format!("{step} is not allowed; a number above 0")
        });
        check.refuse((hi - lo) / step >= MOST_VALUES as f64, &format!("{key}.step"), || {
            format!("{step} is not allowed; at most {MOST_VALUES} values from {from} to {to}")
        });
        check.refuse(*log, &format!("{key}.log"), || {
            "true is not allowed with `step`; `count` is needed".to_owned()
        });
    }
    let steps =
        count.map_or(1, |count| check.count(&format!("{key}.count"), count, 2, MOST_VALUES as u32)) - 1;
    check.refuse(*log && lo <= 0.0, &format!("{key}.from"), || {
        format!("{from} is not allowed with `log`; a number above 0")
    });
    if before != check.is_clean() {
        return Vec::new();
    }
    let is_whole = |number: &Number| number.is_i64() || number.is_u64();
    let whole = is_whole(from) && is_whole(to) && step.as_ref().is_none_or(is_whole);
    let value = |x: f64| if whole { Value::from(x.round() as i64) } else { Value::from(rounded(x)) };
    let mut values: Vec<Value> = match step.as_ref().map(number) {
        // The end counts where rounding alone keeps it out.
        Some(step) => {
            (0..=((hi - lo) / step + 1e-9) as u32).map(|i| value(lo + f64::from(i) * step)).collect()
        }
        None => (0..=steps)
            .map(|i| f64::from(i) / f64::from(steps))
            .map(|share| value(if *log { lo * (hi / lo).powf(share) } else { lo + (hi - lo) * share }))
            .collect(),
    };
    let count = values.len();
    values.dedup();
    check.refuse(values.len() < count, &format!("{key}.count"), || {
        format!("{count} is not allowed; there are fewer whole numbers so spaced (`{from}.0` asks for others as well)")
    });
    values
}

/// A number as a person would have written it: 0.3 and not 0.30000000000000004.
fn rounded(x: f64) -> f64 {
    format!("{x:.11e}").parse().unwrap_or(x)
}

/// Axes that vary together, by number, in the order of the first of each.
fn groups(check: &mut Checker<'_>, axes: &[Axis], zip: &[Vec<String>]) -> Vec<Vec<usize>> {
    let keys: Vec<&str> = axes.iter().map(|axis| axis.key.as_str()).collect();
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (i, names) in zip.iter().enumerate() {
        let mut group = Vec::new();
        for (j, name) in names.iter().enumerate() {
            let key = format!("zip[{i}][{j}]");
            match keys.iter().position(|key| key == name) {
                None => check.problem(&key, unknown_word(name, "an axis", &keys)),
                Some(axis) if groups.iter().flatten().chain(&group).any(|other| *other == axis) => {
                    check.problem(&key, format!("`{}` stands twice", quoted(name)));
                }
                Some(axis) => group.push(axis),
            }
        }
        check.refuse(names.len() < 2, &format!("zip[{i}]"), || "at least two axes are needed".to_owned());
        let sizes: Vec<usize> = group.iter().map(|axis| axes[*axis].values.len()).collect();
        check.refuse(sizes.iter().any(|size| *size != sizes[0]), &format!("zip[{i}]"), || {
            let sizes = sizes.iter().map(usize::to_string).collect::<Vec<_>>().join(", ");
            format!("axes of different lengths ({sizes}) are not allowed; axes that vary together are equally long")
        });
        groups.push(group);
    }
    let alone = (0..axes.len()).filter(|axis| !groups.iter().flatten().any(|other| other == axis));
    let alone: Vec<Vec<usize>> = alone.map(|axis| vec![axis]).collect();
    groups.extend(alone);
    groups.sort_by_key(|group| group.iter().min().copied());
    groups
}

/// A condition in words, such as `filter.beams <= laser.beams`.
fn condition(check: &mut Checker<'_>, key: &str, axes: &[Axis], text: &str) -> Option<Condition> {
    let words: Vec<&str> = text.split_whitespace().collect();
    let signs = "==, !=, <, <=, >, >=";
    let form = || {
        format!(
            "`{}` is not allowed; AXIS SIGN AXIS-OR-VALUE with blanks between, signs: {signs}",
            quoted(text)
        )
    };
    let &[left, sign, right] = words.as_slice() else {
        check.problem(key, form());
        return None;
    };
    let Some(comparison) = Comparison::from_sign(sign) else {
        check.problem(key, form());
        return None;
    };
    let keys: Vec<&str> = axes.iter().map(|axis| axis.key.as_str()).collect();
    let Some(left) = keys.iter().position(|key| *key == left) else {
        check.problem(key, unknown_word(left, "an axis", &keys));
        return None;
    };
    let operand = match keys.iter().position(|key| *key == right) {
        Some(axis) => Operand::Axis(axis),
        // A number, true or false; otherwise a word.
        None => Operand::Value(serde_json::from_str(right).unwrap_or_else(|_| Value::from(right))),
    };
    if comparison.orders() {
        let right_is_number = match &operand {
            Operand::Axis(axis) => axes[*axis].is_numeric(),
            Operand::Value(value) => value.is_number(),
        };
        let both = [(axes[left].is_numeric(), keys[left]), (right_is_number, right)];
        if let Some((_, word)) = both.into_iter().find(|(is_number, _)| !is_number) {
            check.problem(
                key,
                format!(
                    "`{sign}` is not allowed; `{}` is neither a number nor an axis of numbers",
                    quoted(word)
                ),
            );
            return None;
        }
    }
    Some(Condition { left, comparison, right: operand })
}
