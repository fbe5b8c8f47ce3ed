use std::sync::OnceLock;

use kdtree::KdTree;
use kdtree::distance::squared_euclidean;
use serde::{Deserialize, Serialize};

use crate::error::{positive, query};
use crate::{Dataset, Error, Kernel};

/// Ridge on the slopes of a local plane, in squared bandwidths: the design of few or collinear states then has a
/// solution that tends to the weighted mean, while a design that spans a bandwidth keeps its slope to one in a
/// million.
const SLOPE_RIDGE: f64 = 1e-6;

/// Ridge on the tilt of balanced weights, in squared bandwidths. At the edge of the data, where no tilt moves
/// the states' mean to the query, it stops short of giving all weight to the outermost state.
const TILT_RIDGE: f64 = 0.01;

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

/// How much each training state counts at a query.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Weighting {
    /// By a kernel of the distance in bandwidths (Nadaraya-Watson, eq. 7).
    Kernel {
        /// Kernel over states.
        kernel: Kernel,
        /// One bandwidth per state coordinate, in its units: the diagonal of the paper's bandwidth matrix.
        bandwidths: Vec<f64>,
    },
    /// Equally, the k nearest states; all, where there are fewer. The nearest states always exist, so a query is
    /// never flagged as outside the data.
    NearestNeighbours {
        /// Number of states k, at least 1.
        count: usize,
        /// The unit of distance along each state coordinate, in the coordinate's units.
        scales: Vec<f64>,
    },
}

impl Weighting {
    /// Weights by `kernel` with one bandwidth per state coordinate, in its units.
    pub fn kernel(kernel: Kernel, bandwidths: &[f64]) -> Self {
        Self::Kernel { kernel, bandwidths: bandwidths.to_vec() }
    }

    /// Equal weights for the `count` nearest states, with distances measured in `scales`.
    pub fn nearest_neighbours(count: usize, scales: &[f64]) -> Self {
        Self::NearestNeighbours { count, scales: scales.to_vec() }
    }

    /// The unit of distance along each state coordinate, in the coordinate's units.
    pub fn scales(&self) -> &[f64] {
        match self {
            Self::Kernel { bandwidths, .. } => bandwidths,
            Self::NearestNeighbours { scales, .. } => scales,
        }
    }
}

/// The local fit to the states around a query.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Degree {
    /// Their weighted mean (Nadaraya-Watson). Biased where the states around the query lie to one side.
    #[default]
    Constant,
    /// A plane, which has no such bias to first order.
    Linear,
}

/// Weights over a fixed set of states: those of eq. 7, or of the k nearest.
///
/// The states are kept in bandwidth units, sorted along the coordinate that spans most bandwidths; a kernel
/// looks only at the states within its support along it. Nearest states come from a k-d tree.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(try_from = "Parts", into = "Parts")]
pub struct Smoother {
    weighting: Weighting,
    /// The bandwidths or scales.
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
    /// State indices by place in bandwidths; made when first asked.
    tree: OnceLock<KdTree<f64, usize, Box<[f64]>>>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Parts {
    weighting: Weighting,
    states: Vec<f64>,
}

impl From<Smoother> for Parts {
    fn from(smoother: Smoother) -> Self {
        Self { weighting: smoother.weighting, states: smoother.states }
    }
}

impl TryFrom<Parts> for Smoother {
    type Error = Error;
    fn try_from(parts: Parts) -> Result<Self, Error> {
        Self::of_states(parts.states, &parts.weighting)
    }
}

/// Everything else follows from these.
impl PartialEq for Smoother {
    fn eq(&self, other: &Self) -> bool {
        self.weighting == other.weighting && self.states == other.states
    }
}

impl Smoother {
    /// Smoothing over the states of `data`.
    ///
    /// # Errors
    /// If there are no states, or the bandwidths or scales aren't `dim` positive numbers.
    pub fn new(data: &Dataset, weighting: &Weighting) -> Result<Self, Error> {
        let found = weighting.scales().len();
        if found != data.dim() {
            return Err(Error::Length { what: "number of state bandwidths", expected: data.dim(), found });
        }
        Self::of_states(data.states().to_vec(), weighting)
    }

    /// Smoothing over `states`, row by row: n x the number of bandwidths.
    ///
    /// # Errors
    /// If there are no states or no bandwidths, the states aren't a whole number of finite rows, a bandwidth isn't
    /// positive, or no neighbours are asked for.
    pub fn of_states(states: Vec<f64>, weighting: &Weighting) -> Result<Self, Error> {
        let bandwidths = weighting.scales();
        let dim = bandwidths.len();
        for &bandwidth in bandwidths {
            positive("a state bandwidth", bandwidth)?;
        }
        if states.is_empty() || dim == 0 {
            return Err(Error::Empty { what: "the training states" });
        }
        if matches!(weighting, Weighting::NearestNeighbours { count: 0, .. }) {
            return Err(Error::Empty { what: "the nearest neighbours" });
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
            weighting: weighting.clone(),
            bandwidths: bandwidths.to_vec(),
            axis,
            keys: scaled.iter().skip(axis).step_by(dim).copied().collect(),
            order,
            scaled,
            states,
            tree: OnceLock::new(),
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

    /// How the states are weighted.
    pub fn weighting(&self) -> &Weighting {
        &self.weighting
    }

    /// Fills `out` with (state index, weight) of the states that count at `query`; the weights are positive and
    /// sum to 1.
    ///
    /// # Errors
    /// If the query isn't `dim` finite numbers.
    pub fn weights(&self, query: &[f64], out: &mut Vec<(usize, f64)>) -> Result<Support, Error> {
        crate::error::query(self.dim(), query)?;
        let kernel = match self.weighting {
            Weighting::Kernel { kernel, .. } => kernel,
            Weighting::NearestNeighbours { count, .. } => {
                self.nearest_states(query, count, out);
                return Ok(Support::InData);
            }
        };
        out.clear();
        let query_scaled: Vec<f64> = query.iter().zip(&self.bandwidths).map(|(x, h)| x / h).collect();
        let key = query_scaled[self.axis];
        // A Gaussian is taken relative to its value at the nearest state, which cancels in eq. 7 and cannot
        // underflow, and ends where the states left out cannot weigh more than NEGLIGIBLE together.
        let (base, limit) = match kernel {
            Kernel::Gaussian => {
                let nearest = self.nearest_squared(&query_scaled);
                let within = nearest <= kernel.support() * kernel.support();
                let reach = 2.0 * (self.len() as f64 / NEGLIGIBLE).ln();
                (nearest, if within { nearest + reach } else { -1.0 })
            }
            Kernel::Boxcar | Kernel::Epanechnikov => (0.0, 1.0),
        };
        let mut total = 0.0;
        if limit >= 0.0 {
            let reach = limit.sqrt();
            let first = self.keys.partition_point(|&k| k < key - reach);
            let last = first + self.keys[first..].partition_point(|&k| k <= key + reach);
            for row in first..last {
                let distance = self.squared_distance(row, &query_scaled);
                if distance <= limit {
                    let weight = kernel.at_squared(distance - base);
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
            self.nearest_states(query, FALLBACK_NEIGHBOURS, out);
            Ok(Support::Nearest)
        }
    }

    /// As [`Smoother::weights`], for a local fit of the given degree: the weighted sum of the states' values is
    /// the fit's value at the query. For a plane weights may be negative; they sum to 1. Outside the data
    /// ([`Support::Nearest`]) they are those of the mean: a plane is never extrapolated from there.
    ///
    /// # Errors
    /// If the query isn't `dim` finite numbers.
    pub fn regression_weights(
        &self,
        query: &[f64],
        degree: Degree,
        out: &mut Vec<(usize, f64)>,
    ) -> Result<Support, Error> {
        let support = self.weights(query, out)?;
        if degree == Degree::Constant || support == Support::Nearest {
            return Ok(support);
        }
        // Centred on the weighted mean of the states, the normal equations of the plane are C slope = sum w u t
        // with C = sum w u u^T and u = (x - mean x) / h. Its value at the query's offset v is the sum of
        // w (1 + u^T C^-1 v) t.
        let p = self.dim();
        let mut u = self.offsets(query, out);
        let w: Vec<f64> = out.iter().map(|w| w.1).collect();
        let mut tilt = vec![0.0; p];
        for (u, tilt) in u.chunks_mut(w.len()).zip(&mut tilt) {
            let centre = dot(&w, u);
            for u in u {
                *u -= centre;
            }
            *tilt = -centre;
        }
        let mut matrix = vec![0.0; p * p];
        second_moments(&w, &u, &mut matrix);
        for a in 0..p {
            matrix[a * p + a] += SLOPE_RIDGE;
        }
        solve_positive_definite(&mut matrix, SLOPE_RIDGE, &mut tilt);
        let mut factors = vec![1.0; w.len()];
        add_tilted(&tilt, &u, &mut factors);
        for ((_, w), factor) in out.iter_mut().zip(factors) {
            *w *= factor;
        }
        Ok(support)
    }

    /// As [`Smoother::weights`], for a local fit of the given degree to values that must stay positive, such as
    /// densities. For a plane the weights are those of eq. 7, tilted by exp(t x) so that the states' weighted mean is
    /// the query itself: what a plane through the states corrects is then zero. They are positive and sum to 1. This
    /// is the adjusted Nadaraya-Watson estimator of Hall, Wolff and Yao 1999, with weights by exponential tilting; it
    /// has the bias of a local plane, also, to the ridge, at the edges of the data.
    ///
    /// # Errors
    /// If the query isn't `dim` finite numbers.
    pub fn positive_weights(
        &self,
        query: &[f64],
        degree: Degree,
        out: &mut Vec<(usize, f64)>,
    ) -> Result<Support, Error> {
        let support = self.weights(query, out)?;
        if degree == Degree::Linear && support == Support::InData {
            self.balance(query, out);
        }
        Ok(support)
    }

    /// Tilts weights so that the states' weighted mean is the query: Newton's method on the strictly convex
    /// ln sum w exp(t^T u) + ridge t^T t / 2, whose gradient is that mean's offset and a ridge.
    fn balance(&self, query: &[f64], weights: &mut [(usize, f64)]) {
        let p = self.dim();
        let n = weights.len();
        let u = self.offsets(query, weights);
        let mut tilted: Vec<f64> = weights.iter().map(|w| w.1).collect();
        let mut tilt = vec![0.0; p];
        let (mut mean, mut step, mut matrix) = (vec![0.0; p], vec![0.0; p], vec![0.0; p * p]);
        for _ in 0..MOST_NEWTON_STEPS {
            for ((u, mean), (step, tilt)) in u.chunks(n).zip(&mut mean).zip(step.iter_mut().zip(&tilt)) {
                *mean = dot(&tilted, u);
                *step = -*mean - TILT_RIDGE * tilt;
            }
            let done = dot(&step, &step) < NEWTON_TOLERANCE;
            second_moments(&tilted, &u, &mut matrix);
            for a in 0..p {
                for b in 0..p {
                    matrix[a * p + b] -= mean[a] * mean[b];
                }
                matrix[a * p + a] += TILT_RIDGE;
            }
            solve_positive_definite(&mut matrix, TILT_RIDGE, &mut step);
            // A step of more than one per bandwidth is cut, as the quadratic model doesn't reach that far.
            let cut = 1.0 / dot(&step, &step).sqrt().max(1.0);
            for (t, step) in tilt.iter_mut().zip(&step) {
                *t += cut * step;
            }
            tilted.fill(0.0);
            add_tilted(&tilt, &u, &mut tilted);
            let largest = tilted.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let mut total = 0.0;
            for (tilted, &(_, w)) in tilted.iter_mut().zip(weights.iter()) {
                *tilted = w * (*tilted - largest).exp();
                total += *tilted;
            }
            for tilted in &mut tilted {
                *tilted /= total;
            }
            // Convergence is quadratic: the step just taken squares what was left.
            if done {
                break;
            }
        }
        for (weight, tilted) in weights.iter_mut().zip(tilted) {
            weight.1 = tilted;
        }
    }

    /// Offsets of the weighted states from the query, coordinate by coordinate, in bandwidths; among nearest
    /// neighbours the distance of the farthest is the bandwidth.
    fn offsets(&self, query: &[f64], weights: &[(usize, f64)]) -> Vec<f64> {
        let (p, n) = (self.dim(), weights.len());
        let mut offsets = Vec::with_capacity(n * p);
        for (d, (q, h)) in query.iter().zip(&self.bandwidths).enumerate() {
            offsets.extend(weights.iter().map(|&(i, _)| (self.states[i * p + d] - q) / h));
        }
        if matches!(self.weighting, Weighting::NearestNeighbours { .. }) {
            let squared = |k: usize| (0..p).map(|d| offsets[d * n + k].powi(2)).sum::<f64>();
            let radius = (0..n).map(squared).fold(0.0, f64::max).sqrt();
            if radius > 0.0 {
                for u in &mut offsets {
                    *u /= radius;
                }
            }
        }
        offsets
    }

    /// Squared distance of the state in sorted row `row` from a query, both in bandwidths.
    #[inline]
    fn squared_distance(&self, row: usize, query_scaled: &[f64]) -> f64 {
        let dim = query_scaled.len();
        let state = &self.scaled[row * dim..(row + 1) * dim];
        state.iter().zip(query_scaled).map(|(s, q)| (s - q) * (s - q)).sum()
    }

    /// Squared distance of the nearest state, searched outwards from the query along the sorted coordinate.
    fn nearest_squared(&self, query_scaled: &[f64]) -> f64 {
        let key = query_scaled[self.axis];
        let middle = self.keys.partition_point(|&k| k < key);
        let mut best = f64::INFINITY;
        let mut closer = |row: usize| {
            if (self.keys[row] - key).powi(2) > best {
                return false;
            }
            best = best.min(self.squared_distance(row, query_scaled));
            true
        };
        let _ = (middle..self.len()).all(&mut closer);
        let _ = (0..middle).rev().all(closer);
        best
    }

    /// Equal weights on the `count` nearest states, the nearest first.
    pub(crate) fn nearest_states(&self, query: &[f64], count: usize, out: &mut Vec<(usize, f64)>) {
        let tree = self.tree.get_or_init(|| {
            let mut tree = KdTree::new(self.dim());
            for (i, state) in self.states.chunks(self.dim()).enumerate() {
                tree.add(self.place(state), i).expect("a finite place of the tree's dimension");
            }
            tree
        });
        let count = count.min(self.len());
        let found = tree
            .nearest(&self.place(query), count, &squared_euclidean)
            .expect("a finite place of the tree's dimension");
        out.clear();
        out.extend(found.into_iter().map(|(_, &i)| (i, 1.0 / count as f64)));
    }

    /// A state in bandwidths, limited to where squared distances are finite.
    fn place(&self, state: &[f64]) -> Box<[f64]> {
        state.iter().zip(&self.bandwidths).map(|(x, h)| (x / h).clamp(-1e150, 1e150)).collect()
    }
}

/// Newton's method on a smooth convex function takes about four steps but for odd designs.
const MOST_NEWTON_STEPS: usize = 50;

/// Squared gradient (states' weighted mean from the query, in bandwidths) after which one step is left.
const NEWTON_TOLERANCE: f64 = 1e-12;

/// Sum of products, in four sums side by side: a processor adds them at once, always in the same order.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (a4, a_rest) = a.as_chunks::<4>();
    let (b4, b_rest) = b.as_chunks::<4>();
    let mut sums = [0.0; 4];
    for (a, b) in a4.iter().zip(b4) {
        for k in 0..4 {
            sums[k] += a[k] * b[k];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

/// Weighted second moments of offsets given coordinate by coordinate: a symmetric p x p matrix.
fn second_moments(w: &[f64], u: &[f64], matrix: &mut [f64]) {
    let n = w.len();
    let p = u.len() / n;
    let mut weighted = vec![0.0; n];
    for (a, ua) in u.chunks(n).enumerate() {
        for ((to, w), u) in weighted.iter_mut().zip(w).zip(ua) {
            *to = w * u;
        }
        for (b, ub) in u.chunks(n).enumerate().skip(a) {
            let moment = dot(&weighted, ub);
            matrix[a * p + b] = moment;
            matrix[b * p + a] = moment;
        }
    }
}

/// Adds t^T u to each element, with the offsets u coordinate by coordinate.
fn add_tilted(tilt: &[f64], u: &[f64], to: &mut [f64]) {
    for (t, u) in tilt.iter().zip(u.chunks(to.len())) {
        for (to, u) in to.iter_mut().zip(u) {
            *to += t * u;
        }
    }
}

/// Solves A x = b in place by Cholesky's factorization; A is p x p, symmetric and, but for rounding, above `ridge`
/// times the identity.
fn solve_positive_definite(a: &mut [f64], ridge: f64, b: &mut [f64]) {
    let p = b.len();
    for j in 0..p {
        for i in j..p {
            let dot: f64 = (0..j).map(|k| a[i * p + k] * a[j * p + k]).sum();
            let value = a[i * p + j] - dot;
            a[i * p + j] = if i == j { value.max(ridge).sqrt() } else { value / a[j * p + j] };
        }
    }
    for i in 0..p {
        let dot: f64 = (0..i).map(|k| a[i * p + k] * b[k]).sum();
        b[i] = (b[i] - dot) / a[i * p + i];
    }
    for i in (0..p).rev() {
        let dot: f64 = (i + 1..p).map(|k| a[k * p + i] * b[k]).sum();
        b[i] = (b[i] - dot) / a[i * p + i];
    }
}
