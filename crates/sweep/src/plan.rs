//! From axes to cells. A cell is a number; its values are computed from that number, so that a sweep of any size takes no memory.

use std::fmt;
use std::ops::Range;

use locsim_core::{Draw, Stage};
use locsim_report::trial_set::{AxisKind, plain};
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The most cells of a sweep. Cells have 32-bit numbers; workers count a little beyond the last.
pub const MOST_CELLS: u64 = 1 << 31;
/// The most combinations under conditions: each of them is looked at, which takes a second for this many.
pub const MOST_COMBINATIONS: u64 = 10_000_000;

/// The most shards of a sweep: each is a folder, and a file system has its limits, too.
pub const MOST_SHARDS: u32 = 100_000;

/// The axes of a sweep and how they are combined. Equal plans have equal cells.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Plan {
    /// The seed that the seed of each cell is derived from.
    pub seed: u64,
    /// Trials of each cell; `None` for the scenario's.
    pub trials: Option<u32>,
    /// The axes in the order of the file.
    pub axes: Vec<Axis>,
    /// Axes that vary together, by number; the last group varies fastest.
    pub groups: Vec<Vec<usize>>,
    /// The conditions that a cell must meet.
    pub conditions: Vec<Condition>,
}

/// A key of the scenario and its values.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Axis {
    /// The key's path.
    pub key: String,
    /// At least one value; no value twice.
    pub values: Vec<Value>,
}

impl Axis {
    /// Its column in the results; `seed` is the name of another.
    pub fn column(&self) -> String {
        if self.key == "seed" { "scenario.seed".to_owned() } else { self.key.clone() }
    }

    /// Whether all values are numbers.
    pub fn is_numeric(&self) -> bool {
        self.values.iter().all(Value::is_number)
    }
}

/// A comparison of an axis with another or with a value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Condition {
    /// The axis on the left, by number.
    pub left: usize,
    /// How they are compared.
    pub comparison: Comparison,
    /// The right side.
    pub right: Operand,
}

/// The right side of a comparison.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Operand {
    /// An axis, by number.
    Axis(usize),
    /// A value.
    Value(Value),
}

/// How two values are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Comparison {
    /// Equal.
    #[serde(rename = "==")]
    Equal,
    /// Not equal.
    #[serde(rename = "!=")]
    Unequal,
    /// Less.
    #[serde(rename = "<")]
    Less,
    /// Less or equal.
    #[serde(rename = "<=")]
    AtMost,
    /// Greater.
    #[serde(rename = ">")]
    Greater,
    /// Greater or equal.
    #[serde(rename = ">=")]
    AtLeast,
}

impl Comparison {
    /// The comparison that is written so.
    pub fn from_sign(sign: &str) -> Option<Self> {
        serde_json::from_value(Value::from(sign)).ok()
    }

    fn holds(self, left: &Value, right: &Value) -> bool {
        let numbers = left.as_f64().zip(right.as_f64());
        let is_equal = numbers.map_or_else(|| left == right, |(left, right)| left == right);
        let ordered =
            |compare: fn(&f64, &f64) -> bool| numbers.is_some_and(|(left, right)| compare(&left, &right));
        match self {
            Self::Equal => is_equal,
            Self::Unequal => !is_equal,
            Self::Less => ordered(f64::lt),
            Self::AtMost => ordered(f64::le),
            Self::Greater => ordered(f64::gt),
            Self::AtLeast => ordered(f64::ge),
        }
    }

    /// Whether it needs numbers.
    pub fn orders(self) -> bool {
        !matches!(self, Self::Equal | Self::Unequal)
    }
}

/// The cells of a plan, by number from 0.
#[derive(Clone, Debug)]
pub struct Cells {
    plan: Plan,
    /// The combinations that meet the conditions; `None` where all do.
    chosen: Option<Vec<u32>>,
    count: u32,
}

impl Plan {
    /// Number of combinations; `None` beyond [`MOST_CELLS`].
    pub fn combinations(&self) -> Option<u64> {
        let sizes = self.groups.iter().map(|group| self.size(group));
        sizes
            .into_iter()
            .try_fold(1_u64, |product, size| product.checked_mul(size as u64))
            .filter(|n| *n <= MOST_CELLS)
    }

    /// Whether every axis has values and varies once, with axes of its own length, and conditions are on axes that are there. A
    /// plan from a file may be anything.
    pub fn is_sound(&self) -> bool {
        let count = self.axes.len();
        let mut varied: Vec<usize> = self.groups.concat();
        varied.sort_unstable();
        let is_axis = |axis: usize| axis < count;
        varied == (0..count).collect::<Vec<_>>()
            && self.axes.iter().all(|axis| !axis.values.is_empty())
            && self
                .groups
                .iter()
                .all(|group| group.iter().all(|&axis| self.axes[axis].values.len() == self.size(group)))
            && self.conditions.iter().all(|condition| {
                let right = match condition.right {
                    Operand::Axis(axis) => is_axis(axis),
                    Operand::Value(_) => true,
                };
                is_axis(condition.left) && right
            })
    }

    fn size(&self, group: &[usize]) -> usize {
        group.first().map_or(1, |axis| self.axes[*axis].values.len())
    }

    /// `10 x 3 x 4`: the sizes behind the number of combinations.
    pub fn sizes(&self) -> String {
        self.groups.iter().map(|group| self.size(group).to_string()).collect::<Vec<_>>().join(" x ")
    }

    /// Index of the value of each axis in a combination.
    fn indices(&self, mut combination: u64) -> Vec<usize> {
        let mut indices = vec![0; self.axes.len()];
        for group in self.groups.iter().rev() {
            let size = self.size(group) as u64;
            for &axis in group {
                indices[axis] = (combination % size) as usize;
            }
            combination /= size;
        }
        indices
    }

    fn is_met(&self, indices: &[usize]) -> bool {
        let value = |axis: usize| &self.axes[axis].values[indices[axis]];
        self.conditions.iter().all(|condition| {
            let right = match &condition.right {
                Operand::Axis(axis) => value(*axis),
                Operand::Value(value) => value,
            };
            condition.comparison.holds(value(condition.left), right)
        })
    }

    /// Names and types of the columns of the axes.
    pub fn columns(&self) -> Vec<(String, AxisKind)> {
        self.axes.iter().map(|axis| (axis.column(), AxisKind::of(&axis.values))).collect()
    }

    /// The axis of a key.
    pub fn axis(&self, key: &str) -> Option<usize> {
        self.axes.iter().position(|axis| axis.key == key)
    }
}

impl Cells {
    /// The cells of a plan; `None` where there are too many combinations, or too many to look at.
    pub fn of(plan: Plan) -> Option<Self> {
        let combinations = plan.combinations()?;
        let chosen = if plan.conditions.is_empty() {
            None
        } else if combinations > MOST_COMBINATIONS {
            return None;
        } else {
            Some(
                (0..combinations as u32)
                    .filter(|c| plan.is_met(&plan.indices(u64::from(*c))))
                    .collect::<Vec<_>>(),
            )
        };
        let count = chosen.as_ref().map_or(combinations as u32, |chosen| chosen.len() as u32);
        Some(Self { plan, chosen, count })
    }

    /// The plan.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Number of cells.
    pub fn count(&self) -> u32 {
        self.count
    }

    /// Index of a cell's value on each axis.
    pub fn indices(&self, cell: u32) -> Vec<usize> {
        let combination = self.chosen.as_ref().map_or(cell, |chosen| chosen[cell as usize]);
        self.plan.indices(u64::from(combination))
    }

    /// A cell's value on each axis.
    pub fn values(&self, cell: u32) -> Vec<Value> {
        let axes = self.plan.axes.iter().zip(self.indices(cell));
        axes.map(|(axis, index)| axis.values[index].clone()).collect()
    }

    /// The seed of a cell. It depends on the sweep's seed and the cell's own values, not on its number, so that it stays when
    /// values are added to an axis.
    pub fn seed(&self, cell: u32) -> u64 {
        let values = self.values(cell);
        let mut pairs: Vec<(&str, String)> = self
            .plan
            .axes
            .iter()
            .zip(&values)
            .map(|(axis, value)| (axis.key.as_str(), value.to_string()))
            .collect();
        pairs.sort_unstable();
        let mut hasher = blake3::Hasher::new();
        for text in pairs.iter().flat_map(|(key, value)| [*key, value]) {
            hasher.update(&(text.len() as u64).to_le_bytes()).update(text.as_bytes());
        }
        let [a, b, c, d, e, f, g, h, ..] = *hasher.finalize().as_bytes();
        let (step, item) = (u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h]));
        Draw::new(self.plan.seed, Stage::Sweep, step).seed(item)
    }

    /// `laser.beams = 12, filter.particles = 100`.
    pub fn name(&self, cell: u32) -> String {
        let values = self.values(cell);
        let pairs = self
            .plan
            .axes
            .iter()
            .zip(&values)
            .map(|(axis, value)| format!("{} = {}", axis.key, plain(value)));
        pairs.collect::<Vec<_>>().join(", ")
    }
}

/// One of equal parts of a sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Shard {
    /// Number of parts.
    pub of: u32,
    /// Which one, from 1.
    pub number: u32,
}

impl Shard {
    /// Its cells: neighbours, so that the merge appends one shard after another.
    pub fn cells(self, count: u32) -> Range<u32> {
        let end = |number: u32| (u64::from(number) * u64::from(count) / u64::from(self.of)) as u32;
        end(self.number - 1)..end(self.number)
    }

    /// Name of its folder.
    pub fn folder(self) -> String {
        format!("shard-{:05}-of-{:05}", self.number, self.of)
    }

    /// Reads `I/N`.
    ///
    /// # Errors
    /// A sentence that says what is allowed.
    pub fn parse(text: &str) -> Result<Self, String> {
        let numbers = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        let (number, of) = numbers.ok_or("I/N is allowed, such as 3/50: shard 3 of 50")?;
        Self::new(number, of)
    }

    /// Shard `number` of `of`.
    ///
    /// # Errors
    /// A sentence that says what is allowed.
    pub fn new(number: u32, of: u32) -> Result<Self, String> {
        if of > MOST_SHARDS {
            Err(format!("{of} shards are not allowed; at most {MOST_SHARDS}"))
        } else if (1..=of).contains(&number) {
            Ok(Self { of, number })
        } else {
            Err(format!("shard {number} of {of} is not there; shards are numbered from 1 to their number"))
        }
    }

    /// The shard that a batch engine asks for: a task's number in `SLURM_ARRAY_TASK_ID`, `HQ_TASK_ID` or `PARALLEL_SEQ`, among
    /// `shards`. Slurm tells the number of tasks as well, the others don't. `None` outside of an engine.
    ///
    /// # Errors
    /// A sentence that says what is not allowed, and what is.
    pub fn from_environment(
        environment: &dyn Fn(&str) -> Option<String>,
        shards: Option<u32>,
    ) -> Result<Option<Self>, String> {
        let number = |name: &str| match environment(name).map(|text| (text.parse::<u32>(), text)) {
            None => Ok(None),
            Some((Ok(number), _)) => Ok(Some(number)),
            Some((Err(_), text)) => Err(format!("{name}: `{text}` is not a whole number")),
        };
        if let Some(of) = shards {
            for name in TASK_NUMBERS {
                if let Some(number) = number(name)? {
                    return Self::new(number, of).map(Some).map_err(|error| format!("{name}: {error}"));
                }
            }
            return Err(format!("--shards: no task number in the environment ({})", TASK_NUMBERS.join(", ")));
        }
        let [id, count, min, max] =
            ["ID", "COUNT", "MIN", "MAX"].map(|name| number(&format!("SLURM_ARRAY_TASK_{name}")));
        let (Some(id), Some(count), Some(min), Some(max)) = (id?, count?, min?, max?) else {
            return Ok(None);
        };
        if max.checked_sub(min).is_none_or(|span| span.checked_add(1) != Some(count))
            || !(min..=max).contains(&id)
        {
            return Err(format!(
                "the Slurm array has {count} tasks from {min} to {max}, which doesn't say how many shards there are; \
                 add --shards N"
            ));
        }
        Self::new(id - min + 1, count).map(Some)
    }
}

/// Where engines tell a task its number.
pub const TASK_NUMBERS: [&str; 3] = ["SLURM_ARRAY_TASK_ID", "HQ_TASK_ID", "PARALLEL_SEQ"];

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "shard {} of {}", self.number, self.of)
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn plan(axes: &[(&str, Value)], groups: &[&[usize]]) -> Plan {
        let axis = |(key, values): &(&str, Value)| Axis {
            key: (*key).to_owned(),
            values: values.as_array().unwrap().clone(),
        };
        Plan {
            seed: 5,
            trials: None,
            axes: axes.iter().map(axis).collect(),
            groups: groups.iter().map(|group| group.to_vec()).collect(),
            conditions: Vec::new(),
        }
    }

    #[test]
    fn the_last_axis_varies_fastest_and_zipped_axes_vary_together() {
        let axes = [("a", json!([1, 2])), ("b", json!(["x", "y"])), ("c", json!([0.1, 0.2, 0.3]))];
        let names = |groups: &[&[usize]]| {
            let cells = Cells::of(plan(&axes, groups)).unwrap();
            (0..cells.count()).map(|cell| cells.name(cell)).collect::<Vec<_>>()
        };
        let product = names(&[&[0], &[1], &[2]]);
        assert_eq!(product.len(), 12);
        assert_eq!(
            product[..4],
            [
                "a = 1, b = x, c = 0.1",
                "a = 1, b = x, c = 0.2",
                "a = 1, b = x, c = 0.3",
                "a = 1, b = y, c = 0.1"
            ]
        );
        let zipped = names(&[&[0, 1], &[2]]);
        assert_eq!(zipped.len(), 6);
        assert_eq!(zipped[3], "a = 2, b = y, c = 0.1");
    }

    #[test]
    fn conditions_leave_out_cells() {
        let axes = [("a", json!([1, 2, 3])), ("b", json!([1, 2.0, 3]))];
        let count = |comparison: &str, right: Operand| {
            let comparison = Comparison::from_sign(comparison).unwrap();
            let conditions = vec![Condition { left: 0, comparison, right }];
            Cells::of(Plan { conditions, ..plan(&axes, &[&[0], &[1]]) }).unwrap().count()
        };
        for (comparison, expected) in [("<", 3), ("<=", 6), ("==", 3), ("!=", 6), (">", 3), (">=", 6)] {
            assert_eq!(count(comparison, Operand::Axis(1)), expected, "{comparison}");
        }
        assert_eq!(count("<", Operand::Value(json!(2.5))), 6);
        assert_eq!(Comparison::from_sign("=<"), None);
    }

    /// Without a list of them.
    #[test]
    fn cells_beyond_all_bounds_are_counted() {
        let values = || Value::from((0..1000).collect::<Vec<_>>());
        let axes = [("a", values()), ("b", values()), ("c", values()), ("d", values())];
        let of = |groups: &[&[usize]]| plan(&axes, groups).combinations();
        assert_eq!(of(&[&[0], &[1], &[2]]), Some(1_000_000_000));
        assert_eq!(of(&[&[0], &[1], &[2], &[3]]), None);
        let many: Vec<[usize; 1]> = vec![[0]; 100];
        assert_eq!(of(&many.iter().map(<[usize; 1]>::as_slice).collect::<Vec<_>>()), None);
        let cells = Cells::of(plan(&axes, &[&[0], &[1], &[2]])).unwrap();
        assert_eq!(cells.name(999_999_999), "a = 999, b = 999, c = 999, d = 0");
    }

    #[test]
    fn a_cell_keeps_its_seed_when_others_come_and_go() {
        let cells = |a: Value, b: Value| Cells::of(plan(&[("a", a), ("b", b)], &[&[0], &[1]])).unwrap();
        let few = cells(json!([1, 2]), json!(["x"]));
        let many = cells(json!([0, 1, 2, 3]), json!(["w", "x"]));
        assert_eq!((few.name(1), few.seed(1)), (many.name(5), many.seed(5)));
        let mut seeds: Vec<u64> = (0..many.count()).map(|cell| many.seed(cell)).collect();
        seeds.sort_unstable();
        seeds.dedup();
        assert_eq!(seeds.len(), 8);
        let other = Cells::of(Plan { seed: 6, ..few.plan().clone() }).unwrap();
        assert_ne!(few.seed(1), other.seed(1));
    }

    #[test]
    fn shards_cover_every_cell_once_and_differ_by_one_at_most() {
        for (count, of) in [(1, 1), (10, 3), (2000, 200), (7, 7), (1_000_000_007, 1000)] {
            let shards = (1..=of).map(|number| Shard { of, number }.cells(count));
            let mut next = 0;
            for cells in shards {
                assert_eq!(cells.start, next);
                assert!((count / of..=count.div_ceil(of)).contains(&(cells.end - cells.start)));
                next = cells.end;
            }
            assert_eq!(next, count);
        }
    }

    #[test]
    fn a_shard_is_named_by_the_user_or_by_the_engine() {
        assert_eq!(Shard::parse("3/50"), Ok(Shard { number: 3, of: 50 }));
        for text in ["0/5", "6/5", "3", "a/b", "-1/5", "1/0"] {
            assert!(Shard::parse(text).is_err(), "{text}");
        }
        let shard = |variables: &[(&str, &str)], shards: Option<u32>| {
            let get = |name: &str| variables.iter().find(|v| v.0 == name).map(|v| v.1.to_owned());
            Shard::from_environment(&get, shards)
        };
        let slurm = |id, count, min, max| {
            [
                ("SLURM_ARRAY_TASK_ID", id),
                ("SLURM_ARRAY_TASK_COUNT", count),
                ("SLURM_ARRAY_TASK_MIN", min),
                ("SLURM_ARRAY_TASK_MAX", max),
            ]
        };
        assert_eq!(shard(&[], None), Ok(None));
        assert_eq!(shard(&slurm("4", "5", "0", "4"), None), Ok(Some(Shard { number: 5, of: 5 })));
        // Tasks 3 and 7 alone, run again.
        assert!(shard(&slurm("7", "2", "3", "7"), None).unwrap_err().contains("add --shards N"));
        assert_eq!(shard(&slurm("7", "2", "3", "7"), Some(9)), Ok(Some(Shard { number: 7, of: 9 })));
        assert_eq!(shard(&[("HQ_TASK_ID", "2")], Some(9)), Ok(Some(Shard { number: 2, of: 9 })));
        assert_eq!(shard(&[("PARALLEL_SEQ", "9")], Some(9)), Ok(Some(Shard { number: 9, of: 9 })));
        // HyperQueue and GNU parallel don't say how many there are.
        assert_eq!(shard(&[("HQ_TASK_ID", "2"), ("PARALLEL_SEQ", "2")], None), Ok(None));
        assert!(
            shard(&[("PARALLEL_SEQ", "10")], Some(9)).unwrap_err().contains("PARALLEL_SEQ: shard 10 of 9")
        );
        assert!(shard(&[], Some(9)).unwrap_err().contains("no task number"));
        assert!(shard(&[("HQ_TASK_ID", "x")], Some(9)).unwrap_err().contains("`x` is not a whole number"));
    }
}
