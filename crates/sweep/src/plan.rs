//! From axes to cells. A cell is a number; its values are computed from that number, so that a sweep of any size takes no memory.

use locsim_core::{Draw, Stage};
use locsim_report::trial_set::{AxisKind, plain};
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The most cells of a sweep. Cells have 32-bit numbers; workers count a little beyond the last.
pub const MOST_CELLS: u64 = 1 << 31;
/// The most combinations under conditions: each of them is looked at, which takes a second for this many.
pub const MOST_COMBINATIONS: u64 = 10_000_000;

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
}
