use serde::{Deserialize, Serialize};

use crate::error::{positive, query};
use crate::{Dataset, Error, Kernel};

/// Number of nearest states that share the weight where no state is within the kernel's support.
pub const FALLBACK_NEIGHBOURS: usize = 8;

/// Total Gaussian weight that may be left out per query by skipping far states. Small enough that a prediction
/// agrees with the dense product to better than 1e-12.
const NEGLIGIBLE: f64 = 5e-13;

/// Whether a query lies within the training data.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Support {
    /// At least one training state has a kernel weight.
    InData,
    /// All kernel weights vanish; the [`FALLBACK_NEIGHBOURS`] states nearest by bandwidth-scaled distance were
    /// used with equal weights.
    Nearest,
}

/// Nadaraya-Watson weights (eq. 7) over a fixed set of states, with one bandwidth per state coordinate.
///
/// The states are kept in bandwidth units, sorted along the coordinate that spans most bandwidths; a query
/// looks only at the states within the kernel's support along it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Parts", into = "Parts")]
pub struct Smoother {
    kernel: Kernel,
    bandwidths: Vec<f64>,
    /// The coordinate along which the states are sorted.
    axis: usize,
    /// State indices in sorted order.
    order: Vec<usize>,
    /// Sorted coordinate, in bandwidths.
    keys: Vec<f64>,
    /// States in sorted order, in bandwidths, n x dim.
    scaled: Vec<f64>,
    /// States as given, n x dim.
    states: Vec<f64>,
}

#[derive(Serialize, Deserialize)]
struct Parts {
    kernel: Kernel,
    bandwidths: Vec<f64>,
    states: Vec<f64>,
}

impl From<Smoother> for Parts {
    fn from(smoother: Smoother) -> Self {
        Self { kernel: smoother.kernel, bandwidths: smoother.bandwidths, states: smoother.states }
    }
}

impl TryFrom<Parts> for Smoother {
    type Error = Error;
    fn try_from(parts: Parts) -> Result<Self, Error> {
        Self::of_states(parts.states, parts.kernel, &parts.bandwidths)
    }
}

impl Smoother {
    /// Smoothing over the states of `data` with one bandwidth per state coordinate, in its units.
    ///
    /// # Errors
    /// If there are no states, or the bandwidths aren't `dim` positive numbers.
    pub fn new(data: &Dataset, kernel: Kernel, bandwidths: &[f64]) -> Result<Self, Error> {
        if bandwidths.len() != data.dim() {
            return Err(Error::Length {
                what: "number of state bandwidths",
                expected: data.dim(),
                found: bandwidths.len(),
            });
        }
        Self::of_states(data.states().to_vec(), kernel, bandwidths)
    }

    /// Smoothing over `states`, row by row: n x `bandwidths.len()`.
    ///
    /// # Errors
    /// If there are no states or no bandwidths, the states aren't a whole number of finite rows, or a bandwidth
    /// isn't positive.
    pub fn of_states(states: Vec<f64>, kernel: Kernel, bandwidths: &[f64]) -> Result<Self, Error> {
        let dim = bandwidths.len();
        for &bandwidth in bandwidths {
            positive("a state bandwidth", bandwidth)?;
        }
        if states.is_empty() || dim == 0 {
            return Err(Error::Empty { what: "the training states" });
        }
        for state in states.chunks(dim) {
            query(dim, state)?;
        }
        let spans = (0..dim).map(|d| {
            let (lo, hi) = states.chunks(dim).fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), state| {
                (lo.min(state[d]), hi.max(state[d]))
            });
            (hi - lo) / bandwidths[d]
        });
        let axis = spans.enumerate().max_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(d, _)| d);
        let mut order: Vec<usize> = (0..states.len() / dim).collect();
        order.sort_by(|&a, &b| states[a * dim + axis].total_cmp(&states[b * dim + axis]));
        let scaled: Vec<f64> = order
            .iter()
            .flat_map(|&i| (0..dim).map(move |d| (i, d)))
            .map(|(i, d)| states[i * dim + d] / bandwidths[d])
            .collect();
        Ok(Self {
            kernel,
            bandwidths: bandwidths.to_vec(),
            axis,
            keys: scaled.iter().skip(axis).step_by(dim).copied().collect(),
            order,
            scaled,
            states,
        })
    }

    /// Coordinates of a state.
    pub fn dim(&self) -> usize {
        self.bandwidths.len()
    }

    /// Number of states.
    pub fn len(&self) -> usize {
        self.order.len()
    }

    /// Never true: a smoother has at least one state.
    pub fn is_empty(&self) -> bool {
        self.order.is_empty()
    }

    /// State `i` as given.
    ///
    /// # Panics
    /// If `i` is not below `len`.
    pub fn state(&self, i: usize) -> &[f64] {
        &self.states[i * self.dim()..(i + 1) * self.dim()]
    }

    /// One bandwidth per state coordinate, in its units.
    pub fn bandwidths(&self) -> &[f64] {
        &self.bandwidths
    }

    /// Fills `out` with (state index, weight) of the states that count at `query`; the weights are positive and
    /// sum to 1.
    ///
    /// # Errors
    /// If the query isn't `dim` finite numbers.
    pub fn weights(&self, query: &[f64], out: &mut Vec<(usize, f64)>) -> Result<Support, Error> {
        crate::error::query(self.dim(), query)?;
        out.clear();
        let key = query[self.axis] / self.bandwidths[self.axis];
        let nearest = self.nearest_squared(query, key);
        let support = self.kernel.support();
        // A Gaussian is taken relative to its value at the nearest state, which cancels in eq. 7 and cannot
        // underflow, and ends where the states left out cannot weigh more than NEGLIGIBLE together.
        let (base, limit) = match self.kernel {
            Kernel::Gaussian => {
                let reach = 2.0 * (self.len() as f64 / NEGLIGIBLE).ln();
                (nearest, nearest + reach)
            }
            Kernel::Boxcar | Kernel::Epanechnikov => (0.0, 1.0),
        };
        let mut total = 0.0;
        if nearest <= support * support {
            let reach = limit.sqrt();
            let first = self.keys.partition_point(|&k| k < key - reach);
            for (row, &k) in self.keys.iter().enumerate().skip(first) {
                if k > key + reach {
                    break;
                }
                let distance = self.squared_distance(row, query);
                if distance <= limit {
                    let weight = self.kernel.at_squared(distance - base);
                    if weight > 0.0 {
                        total += weight;
                        out.push((self.order[row], weight));
                    }
                }
            }
        }
        if total > 0.0 {
            for (_, weight) in out {
                *weight /= total;
            }
            Ok(Support::InData)
        } else {
            self.nearest_states(query, out);
            Ok(Support::Nearest)
        }
    }

    /// Squared bandwidth-scaled distance from the state in sorted row `row`.
    #[inline]
    fn squared_distance(&self, row: usize, query: &[f64]) -> f64 {
        let dim = self.bandwidths.len();
        self.scaled[row * dim..(row + 1) * dim]
            .iter()
            .zip(query.iter().zip(&self.bandwidths))
            .map(|(s, (x, h))| (s - x / h).powi(2))
            .sum()
    }

    /// Squared distance of the nearest state, searched outwards from the query along the sorted coordinate.
    fn nearest_squared(&self, query: &[f64], key: f64) -> f64 {
        let middle = self.keys.partition_point(|&k| k < key);
        let mut best = f64::INFINITY;
        for row in middle..self.len() {
            if (self.keys[row] - key).powi(2) > best {
                break;
            }
            best = best.min(self.squared_distance(row, query));
        }
        for row in (0..middle).rev() {
            if (self.keys[row] - key).powi(2) > best {
                break;
            }
            best = best.min(self.squared_distance(row, query));
        }
        best
    }

    /// Equal weights on the nearest states; ties go to the smaller sorted row.
    fn nearest_states(&self, query: &[f64], out: &mut Vec<(usize, f64)>) {
        let mut rows: Vec<(f64, usize)> =
            (0..self.len()).map(|row| (self.squared_distance(row, query), row)).collect();
        let count = FALLBACK_NEIGHBOURS.min(rows.len());
        rows.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        out.clear();
        out.extend(rows[..count].iter().map(|&(_, row)| (self.order[row], 1.0 / count as f64)));
    }
}
