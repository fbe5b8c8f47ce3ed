use std::collections::HashMap;

use locsim_core::{Particles, Pose2, Weights, circular_mean, wrap_angle};

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
    moments(weights.linear().iter().enumerate().map(|(i, &w)| (particles.get(i), w)))
}

/// The particle with the greatest weight, the first among equals. `None` for an empty set.
pub fn max_weight(particles: &Particles, weights: &Weights) -> Option<Pose2> {
    weights.argmax().map(|i| particles.get(i))
}

/// Mean and covariance of weighted poses, whose weights need not sum to 1.
fn moments(poses: impl Iterator<Item = (Pose2, f64)> + Clone) -> Option<Estimate> {
    poses.clone().next()?;
    let (mut total, mut x, mut y) = (0.0, 0.0, 0.0);
    for (pose, w) in poses.clone() {
        total += w;
        x += w * pose.x;
        y += w * pose.y;
    }
    let theta = match circular_mean(poses.clone().map(|(pose, w)| (pose.theta, w / total))) {
        Some(theta) => theta,
        None => poses.clone().reduce(|best, other| if other.1 > best.1 { other } else { best })?.0.theta,
    };
    let mean = Pose2 { x: x / total, y: y / total, theta };
    let mut covariance = [[0.0; 3]; 3];
    for (pose, w) in poses {
        let d = [pose.x - mean.x, pose.y - mean.y, wrap_angle(pose.theta - mean.theta)];
        for (row, a) in covariance.iter_mut().zip(d) {
            for (entry, b) in row.iter_mut().zip(d) {
                *entry += w * a * b / total;
            }
        }
    }
    Some(Estimate { pose: mean, covariance })
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
        Self { bins, cell_of_key: HashMap::new(), cells: Vec::new(), cell_of_particle: Vec::new() }
    }

    /// The cluster of the greatest weight, the one that has the first particle among equals. `None` for an
    /// empty set.
    pub fn heaviest(&mut self, particles: &Particles, weights: &Weights) -> Option<Cluster> {
        self.fill(particles, weights);
        self.link();
        for i in 0..self.cells.len() {
            let top = self.top(i as u32);
            self.cells[top as usize].cluster_weight += self.cells[i].weight;
        }
        let best = (0..self.cells.len()).reduce(|best, i| {
            if self.cells[i].cluster_weight > self.cells[best].cluster_weight { i } else { best }
        })?;
        let members = self.cell_of_particle.iter().enumerate();
        let estimate = moments(
            members
                .filter(|&(_, &cell)| self.top(cell) == best as u32)
                .map(|(i, _)| (particles.get(i), weights.linear()[i])),
        )?;
        Some(Cluster { estimate, weight: self.cells[best].cluster_weight })
    }

    /// Sums the weights of each bin; cells are in the order of their first particle.
    fn fill(&mut self, particles: &Particles, weights: &Weights) {
        self.cell_of_key.clear();
        self.cells.clear();
        self.cell_of_particle.clear();
        for (pose, &weight) in particles.iter().zip(weights.linear()) {
            let key = self.bins.key(&pose);
            let next = self.cells.len() as u32;
            let cell = *self.cell_of_key.entry(key).or_insert(next);
            if cell == next {
                self.cells.push(Cell { key, weight: 0.0, uphill: next, cluster_weight: 0.0 });
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

    /// The local maximum that a cell leads to. Ends, because each way leads from lighter to heavier.
    fn top(&self, mut cell: u32) -> u32 {
        loop {
            let uphill = self.cells[cell as usize].uphill;
            if uphill == cell {
                return cell;
            }
            cell = uphill;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

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
