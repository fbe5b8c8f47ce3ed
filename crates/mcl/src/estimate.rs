use std::collections::HashMap;
use std::f64::consts::{FRAC_PI_4, PI};

use locsim_core::{Particles, Pose2, Weights, sin_cos, sin_cos_near_zero, wrap_angle};

use crate::bins::{BinKey, PoseBins};

/// A pose with its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// `map_from_base`.
    pub pose: Pose2,
    /// Covariance of (x, y, theta) in the map frame (m, m, rad); symmetric.
    pub covariance: [[f64; 3]; 3],
}

/// Weighted mean of position, weighted circular mean of heading, and the covariance about them, heading
/// differences wrapped. `None` for an empty set.
///
/// Where the headings cancel and have no mean, the heading is that of the greatest weight.
pub fn weighted_mean(particles: &Particles, weights: &Weights) -> Option<Estimate> {
    let reference = max_weight(particles, weights)?;
    Some(estimate(particles, weights.linear(), &reference))
}

/// The particle with the greatest weight, the first among equals. `None` for an empty set.
pub fn max_weight(particles: &Particles, weights: &Weights) -> Option<Pose2> {
    weights.argmax().map(|i| particles.get(i))
}

/// Mean and covariance of weighted poses, whose weights need not sum to 1. `reference` is the heaviest pose; its
/// heading is the mean's where the headings cancel.
fn estimate(particles: &Particles, weights: &[f64], reference: &Pose2) -> Estimate {
    let mut sums = Sums::about(reference, particles, weights);
    let mut offset = sums.mean();
    let mean = Pose2 {
        x: reference.x + offset.x,
        y: reference.y + offset.y,
        theta: wrap_angle(reference.theta + offset.theta),
    };
    if sums.widest + offset.theta.abs() >= PI {
        // Some heading differences wrap about the mean but not about the reference, or the other way round.
        sums = Sums::about(&mean, particles, weights);
        offset = Pose2 { theta: 0.0, ..sums.mean() };
    }
    Estimate { pose: mean, covariance: sums.covariance(&offset) }
}

/// Poses per batch; a batch's intermediate results stay in the first-level cache.
const BATCH: usize = 64;
/// Sums are kept as this many partial ones, which share a vector register.
const LANES: usize = 2;

type Batch = [f64; BATCH];

/// Weighted sums over poses, as offsets (x, y, theta) from a reference pose, heading offsets in (-pi, pi].
///
/// With a reference among the poses and a share w of the weight, no variance is below w times its squared offset
/// from the mean, so that taking the squared mean from the mean square costs no more than a factor 1 / w of the
/// relative precision. The reference of the greatest weight has w >= 1 / n.
#[derive(Clone, Debug, Default)]
struct Sums {
    /// Of 1, x, y, theta, and the products xx, xy, xt, yy, yt, tt.
    moments: [[f64; LANES]; 10],
    /// Of the sine and the cosine of theta.
    direction: [[f64; LANES]; 2],
    /// Greatest absolute heading offset (rad).
    widest: f64,
}

impl Sums {
    fn about(reference: &Pose2, particles: &Particles, weights: &[f64]) -> Self {
        let mut sums = Self::default();
        let (x, x_rest) = particles.x.as_chunks();
        let (y, y_rest) = particles.y.as_chunks();
        let (theta, theta_rest) = particles.theta.as_chunks();
        let (w, w_rest) = weights.as_chunks();
        for (((x, y), theta), w) in x.iter().zip(y).zip(theta).zip(w) {
            sums.add(reference, x, y, theta, w);
        }
        // The last batch is filled up with the reference at weight 0.
        let fill = |rest: &[f64], value: f64| {
            let mut batch = [value; BATCH];
            batch[..rest.len()].copy_from_slice(rest);
            batch
        };
        sums.add(
            reference,
            &fill(x_rest, reference.x),
            &fill(y_rest, reference.y),
            &fill(theta_rest, reference.theta),
            &fill(w_rest, 0.0),
        );
        sums
    }

    fn add(&mut self, reference: &Pose2, x: &Batch, y: &Batch, theta: &Batch, w: &Batch) {
        let mut theta = theta.map(|theta| theta - reference.theta);
        let mut widest = greatest_absolute(&theta);
        if widest >= PI {
            theta = theta.map(wrap_angle);
            widest = greatest_absolute(&theta);
        }
        self.widest = self.widest.max(widest);
        if widest <= FRAC_PI_4 {
            self.add_directions(&theta, w, sin_cos_near_zero);
        } else {
            self.add_directions(&theta, w, sin_cos);
        }
        accumulate(&mut self.moments, |i| {
            let (w, x, y, theta) = (w[i], x[i] - reference.x, y[i] - reference.y, theta[i]);
            let (wx, wy, wt) = (w * x, w * y, w * theta);
            [w, wx, wy, wt, wx * x, wx * y, wx * theta, wy * y, wy * theta, wt * theta]
        });
    }

    fn add_directions(&mut self, theta: &Batch, w: &Batch, sin_cos: impl Fn(f64) -> (f64, f64)) {
        accumulate(&mut self.direction, |i| {
            let (sin, cos) = sin_cos(theta[i]);
            [w[i] * sin, w[i] * cos]
        });
    }

    /// The mean's offset from the reference; heading offset 0 if the headings cancel.
    fn mean(&self) -> Pose2 {
        let [weight, x, y, ..] = self.moments.map(total);
        let [sin, cos] = self.direction.map(|lanes| total(lanes) / weight);
        let theta = if sin * sin + cos * cos > 1e-24 { sin.atan2(cos) } else { 0.0 };
        Pose2 { x: x / weight, y: y / weight, theta }
    }

    /// Covariance about the pose at this offset, whose x and y are the mean's.
    fn covariance(&self, offset: &Pose2) -> [[f64; 3]; 3] {
        let weight = total(self.moments[0]);
        let [_, _, _, t, xx, xy, xt, yy, yt, tt] = self.moments.map(|lanes| total(lanes) / weight);
        let Pose2 { x, y, theta } = *offset;
        let (xx, xy, yy) = (xx - x * x, xy - x * y, yy - y * y);
        let (xt, yt, tt) = (xt - x * t, yt - y * t, tt - (2.0 * t - theta) * theta);
        [[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]]
    }
}

/// Adds the terms of all entries of a batch to the totals.
fn accumulate<const K: usize>(totals: &mut [[f64; LANES]; K], terms: impl Fn(usize) -> [f64; K]) {
    let mut sums = *totals;
    for start in (0..BATCH).step_by(LANES) {
        for lane in 0..LANES {
            for (sum, term) in sums.iter_mut().zip(terms(start + lane)) {
                sum[lane] += term;
            }
        }
    }
    *totals = sums;
}

fn total([a, b]: [f64; LANES]) -> f64 {
    a + b
}

fn greatest_absolute(values: &Batch) -> f64 {
    let mut greatest = [0.0; 4];
    for values in values.as_chunks::<4>().0 {
        for (greatest, value) in greatest.iter_mut().zip(values) {
            let value = value.abs();
            *greatest = if value > *greatest { value } else { *greatest };
        }
    }
    greatest.into_iter().fold(0.0, f64::max)
}

/// One mode of a particle set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cluster {
    /// Weighted mean and covariance of the cluster's particles.
    pub estimate: Estimate,
    /// The cluster's share of the total weight, above 0 and at most 1.
    pub weight: f64,
}

/// Finds the heaviest cluster of a particle set; its buffers live on between calls.
///
/// The particles are counted into bins by weight, as AMCL does. AMCL then joins all bins that touch, so that a
/// few stray particles between two modes make them one; here each bin instead belongs to its heaviest
/// neighbour, if that is heavier than itself, and by following these the bins fall into one cluster per local
/// maximum of the histogram (mode seeking: Koontz, Narendra and Fukunaga 1976).
#[derive(Clone, Debug)]
pub struct Clusters {
    bins: PoseBins,
    /// Looked up only, never iterated over: the hasher's random keys cannot show.
    cell_of_key: HashMap<BinKey, u32>,
    cells: Vec<Cell>,
    cell_of_particle: Vec<u32>,
    /// The weights of the heaviest cluster's particles, 0 for all others.
    member_weights: Vec<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Cell {
    key: BinKey,
    weight: f64,
    /// The heaviest heavier neighbour, the cell itself at a local maximum.
    uphill: u32,
    /// Weight of all cells that lead here; meant for local maxima only.
    cluster_weight: f64,
}

impl Clusters {
    /// Clusters over these bins.
    pub fn new(bins: PoseBins) -> Self {
        Self {
            bins,
            cell_of_key: HashMap::new(),
            cells: Vec::new(),
            cell_of_particle: Vec::new(),
            member_weights: Vec::new(),
        }
    }

    /// The cluster of the greatest weight, the one that has the first particle among equals. `None` for an
    /// empty set.
    pub fn heaviest(&mut self, particles: &Particles, weights: &Weights) -> Option<Cluster> {
        self.fill(particles, weights);
        self.link();
        let Self { cells, cell_of_particle, member_weights, .. } = self;
        for i in 0..cells.len() {
            let top = top(cells, i as u32);
            cells[top as usize].cluster_weight += cells[i].weight;
            // A shorter way for those that pass here, and one step for each particle below.
            cells[i].uphill = top;
        }
        let best = (0..cells.len())
            .reduce(|best, i| if cells[i].cluster_weight > cells[best].cluster_weight { i } else { best })?;
        member_weights.clear();
        let weight_of_cell = cell_of_particle.iter().zip(weights.linear());
        member_weights.extend(
            weight_of_cell
                .map(|(cell, w)| if cells[*cell as usize].uphill == best as u32 { *w } else { 0.0 }),
        );
        let heaviest = (0..member_weights.len())
            .reduce(|best, i| if member_weights[i] > member_weights[best] { i } else { best })?;
        Some(Cluster {
            estimate: estimate(particles, member_weights, &particles.get(heaviest)),
            weight: cells[best].cluster_weight,
        })
    }

    /// Sums the weights of each bin; cells are in the order of their first particle.
    fn fill(&mut self, particles: &Particles, weights: &Weights) {
        self.cell_of_key.clear();
        self.cells.clear();
        self.cell_of_particle.clear();
        let mut cell = 0;
        for (pose, &weight) in particles.iter().zip(weights.linear()) {
            let key = self.bins.key(&pose);
            // Copies of one ancestor are neighbours in the set, and mostly share a bin: no look-up for them.
            if self.cells.get(cell as usize).is_none_or(|cell| cell.key != key) {
                let next = self.cells.len() as u32;
                cell = *self.cell_of_key.entry(key).or_insert(next);
                if cell == next {
                    self.cells.push(Cell { key, weight: 0.0, uphill: next, cluster_weight: 0.0 });
                }
            }
            self.cells[cell as usize].weight += weight;
            self.cell_of_particle.push(cell);
        }
    }

    /// Points each cell at its heaviest neighbour, if that is heavier; the earlier cell counts as the heavier of
    /// equals.
    fn link(&mut self) {
        for i in 0..self.cells.len() as u32 {
            let mut uphill = i;
            for key in self.bins.neighbours(self.cells[i as usize].key) {
                if let Some(&other) = self.cell_of_key.get(&key) {
                    let (weight, best) =
                        (self.cells[other as usize].weight, self.cells[uphill as usize].weight);
                    if weight > best || (weight == best && other < uphill) {
                        uphill = other;
                    }
                }
            }
            self.cells[i as usize].uphill = uphill;
        }
    }
}

/// The local maximum that a cell leads to. Ends, because each way leads from lighter to heavier.
fn top(cells: &[Cell], mut cell: u32) -> u32 {
    loop {
        let uphill = cells[cell as usize].uphill;
        if uphill == cell {
            return cell;
        }
        cell = uphill;
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use locsim_core::{Draw, Stage, circular_mean};
    use proptest::prelude::*;
    use rand::RngExt;

    use super::*;

    /// Weights proportional to `w`.
    fn weights(w: &[f64]) -> Weights {
        let mut weights = Weights::uniform(w.len());
        weights.update(&w.iter().map(|w| w.ln()).collect::<Vec<_>>()).unwrap();
        weights
    }

    fn near(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-12
    }

    /// The definitions, with the mean first and the deviations from it after.
    fn by_definition(particles: &Particles, weights: &[f64]) -> Estimate {
        let weighted = || particles.iter().zip(weights);
        let total: f64 = weights.iter().sum();
        let mean = |f: &dyn Fn(Pose2) -> f64| weighted().map(|(pose, w)| w * f(pose)).sum::<f64>() / total;
        let theta = circular_mean(weighted().map(|(pose, w)| (pose.theta, *w))).unwrap();
        let pose = Pose2 { x: mean(&|p| p.x), y: mean(&|p| p.y), theta };
        let deviations = |p: Pose2| [p.x - pose.x, p.y - pose.y, wrap_angle(p.theta - pose.theta)];
        let covariance = [0, 1, 2].map(|i| [0, 1, 2].map(|j| mean(&|p| deviations(p)[i] * deviations(p)[j])));
        Estimate { pose, covariance }
    }

    proptest! {
        #[test]
        fn estimates_are_those_of_the_definitions(
            n in 1..300usize, seed in 0..1000u64, centre in -PI..PI, spread in prop::sample::select(vec![1e-6, 0.1, 0.5, 1.5, PI]),
        ) {
            let draw = Draw::new(seed, Stage::Initial, 0);
            let mut particles = Particles::default();
            let mut w = Vec::new();
            for i in 0..n {
                let mut rng = draw.item(i as u32);
                let mut symmetric = || 2.0 * rng.random::<f64>() - 1.0;
                particles.push(Pose2::new(40.0 + symmetric(), -90.0 + 5.0 * symmetric(), centre + spread * symmetric()));
                // One in four has no weight.
                w.push((symmetric() + 0.5).max(0.0));
            }
            w[0] += 0.1;
            let weights = weights(&w);
            let got = weighted_mean(&particles, &weights).unwrap();
            let expected = by_definition(&particles, weights.linear());
            prop_assert!((got.pose.x - expected.pose.x).abs() < 1e-11 && (got.pose.y - expected.pose.y).abs() < 1e-11);
            prop_assert!(wrap_angle(got.pose.theta - expected.pose.theta).abs() < 1e-10);
            for (got, expected) in got.covariance.as_flattened().iter().zip(expected.covariance.as_flattened()) {
                prop_assert!((got - expected).abs() < 1e-9 , "{} {}", got, expected);
            }
        }
    }

    #[test]
    fn mean_and_covariance_of_three_particles_across_the_cut() {
        let particles: Particles =
            [Pose2::new(0.0, 1.0, PI - 0.1), Pose2::new(2.0, 1.0, -PI + 0.1), Pose2::new(4.0, 3.0, PI)]
                .into_iter()
                .collect();
        let Estimate { pose, covariance } = weighted_mean(&particles, &weights(&[1.0, 1.0, 2.0])).unwrap();
        assert!(near(pose.x, 2.5) && near(pose.y, 2.0) && near(pose.theta.abs(), PI));
        // Deviations (-2.5, -1, -0.1), (-0.5, -1, 0.1), (1.5, 1, 0) with weights 1/4, 1/4, 1/2.
        assert!(near(covariance[0][0], 2.75) && near(covariance[1][1], 1.0));
        assert!(near(covariance[0][1], 1.5) && near(covariance[2][2], 0.005));
        assert!(near(covariance[0][2], 0.05) && near(covariance[1][2], 0.0));
        let [[_, xy, xt], [yx, _, yt], [tx, ty, _]] = covariance;
        assert_eq!([xy, xt, yt], [yx, tx, ty]);
    }

    #[test]
    fn headings_that_cancel_give_the_heaviest_particles() {
        let particles: Particles =
            [0.5, 0.5 + PI, 0.5].map(|t| Pose2::new(0.0, 0.0, t)).into_iter().collect();
        let estimate = weighted_mean(&particles, &weights(&[1.0, 2.0, 1.0])).unwrap();
        assert_eq!(estimate.pose.theta, Pose2::new(0.0, 0.0, 0.5 + PI).theta);
    }

    #[test]
    fn an_empty_set_has_no_estimate() {
        let (particles, weights) = (Particles::default(), Weights::uniform(0));
        assert_eq!(weighted_mean(&particles, &weights), None);
        assert_eq!(max_weight(&particles, &weights), None);
        let bins = PoseBins::new(0.5, 0.2).unwrap();
        assert_eq!(Clusters::new(bins).heaviest(&particles, &weights), None);
    }

    #[test]
    fn the_greatest_weight_is_the_first_among_equals() {
        let particles: Particles = (0..4).map(|i| Pose2::new(f64::from(i), 0.0, 0.0)).collect();
        assert_eq!(max_weight(&particles, &weights(&[0.1, 0.4, 0.4, 0.1])).unwrap().x, 1.0);
    }

    /// Two hills joined by a bridge of single particles: joining all that touch would put the mean between them.
    #[test]
    fn the_heavier_of_two_hills_wins_though_a_bridge_joins_them() {
        let hill = |centre: f64, n: usize| {
            (0..n).map(move |i| Pose2::new(centre + 0.3 * (i as f64 / n as f64 - 0.5), 0.25, 0.1))
        };
        // Dense near the hills, sparse in the middle, no bin of 0.5 m empty.
        let bridge = (-20..=20).map(|i| {
            let offset = f64::from(i).signum() * 4.5 * (1.0 - (f64::from(i) / 20.0).powi(2));
            Pose2::new(4.75 + offset, 0.25, 0.1)
        });
        let particles: Particles = hill(0.25, 500).chain(hill(9.25, 400)).chain(bridge).collect();
        let weights = Weights::uniform(particles.len());
        let mut clusters = Clusters::new(PoseBins::new(0.5, 10_f64.to_radians()).unwrap());
        let cluster = clusters.heaviest(&particles, &weights).unwrap();
        assert!((cluster.estimate.pose.x - 0.25).abs() < 0.15, "{cluster:?}");
        assert!((0.5..0.6).contains(&cluster.weight), "{cluster:?}");
        assert!(cluster.estimate.covariance[0][0] < 0.5, "{cluster:?}");
        let mean = weighted_mean(&particles, &weights).unwrap();
        assert!(mean.pose.x > 3.0, "the mean lies where nobody is: {mean:?}");
        assert_eq!(clusters.heaviest(&particles, &weights).unwrap(), cluster, "buffers leave no trace");
    }

    #[test]
    fn a_hill_on_the_cut_is_one_cluster() {
        let particles: Particles =
            (0..100).map(|i| Pose2::new(0.1, 0.1, PI + 0.2 * ((f64::from(i) + 0.5) / 100.0 - 0.5))).collect();
        let mut clusters = Clusters::new(PoseBins::new(0.5, 10_f64.to_radians()).unwrap());
        let cluster = clusters.heaviest(&particles, &Weights::uniform(100)).unwrap();
        assert!(cluster.weight > 0.99, "{cluster:?}");
        assert!(cluster.estimate.pose.theta.abs() > PI - 0.02, "{cluster:?}");
    }
}
