use locsim_core::{Particles, Pose2};

/// The parent of a particle that was injected at random.
pub const NO_PARENT: u32 = u32::MAX;

/// A filter's whole history: each step's particles as they were weighted, and who descends from whom.
///
/// Takes memory in proportion to steps times particles (28 bytes each), so it is off by default.
#[derive(Clone, Debug, Default)]
pub struct Ancestry {
    generations: Vec<Generation>,
    /// Log likelihood of each current particle's path (nats).
    log_weight: Vec<f64>,
    /// Log evidence of all steps so far (nats).
    log_evidence: f64,
}

#[derive(Clone, Debug)]
struct Generation {
    particles: Particles,
    /// Index of each particle's parent in the generation before; `None` if each is its own continuation.
    parents: Option<Vec<u32>>,
}

/// The path of one particle through its ancestors.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    /// The step of the first pose: above 0 only if the path begins at an injected particle.
    pub first_step: usize,
    /// `map_from_base` at each step from `first_step` to the last.
    pub poses: Vec<Pose2>,
}

impl Ancestry {
    /// Appends one step. `parents` are the ancestors that the last step's resampling chose, if it resampled;
    /// `log_likelihood` is `None` where the step's weights were reset.
    pub(crate) fn record(
        &mut self,
        particles: &Particles,
        parents: Option<&[u32]>,
        log_likelihood: Option<(&[f64], f64)>,
    ) {
        if let Some(parents) = parents {
            // The past of an injected particle is unknown; the mean over all paths, the evidence, stands for it.
            self.log_weight = parents
                .iter()
                .map(|&p| if p == NO_PARENT { self.log_evidence } else { self.log_weight[p as usize] })
                .collect();
        }
        self.log_weight.resize(particles.len(), 0.0);
        if let Some((log_likelihood, log_evidence)) = log_likelihood {
            for (sum, l) in self.log_weight.iter_mut().zip(log_likelihood) {
                *sum += l;
            }
            self.log_evidence += log_evidence;
        } else {
            // With reset weights no path is likelier than another.
            self.log_weight.fill(self.log_evidence);
        }
        self.generations
            .push(Generation { particles: particles.clone(), parents: parents.map(<[u32]>::to_vec) });
    }

    /// Number of recorded steps.
    pub fn len(&self) -> usize {
        self.generations.len()
    }

    /// No step was recorded.
    pub fn is_empty(&self) -> bool {
        self.generations.is_empty()
    }

    /// Log likelihood (nats) of all observations along the path of each current particle: the sum over the steps
    /// of `ln p(z_t | x_t)` of its ancestor at t.
    ///
    /// A path that begins at an injected particle starts from the log evidence of the steps before it; when all
    /// weights are reset, all paths start anew from the log evidence.
    pub fn log_weights(&self) -> &[f64] {
        &self.log_weight
    }

    /// The path of the current particle whose accumulated log weight is highest, the first among equals: the
    /// filter's most likely trajectory, `GMapping`'s "best particle" (Grisetti, Stachniss and Burgard 2007).
    /// `None` before the first step.
    pub fn most_likely_trajectory(&self) -> Option<Trajectory> {
        let best = (0..self.log_weight.len())
            .reduce(|best, i| if self.log_weight[i] > self.log_weight[best] { i } else { best })?;
        self.trajectory(best)
    }

    /// The path of current particle `particle`; `None` if there is no such particle.
    pub fn trajectory(&self, particle: usize) -> Option<Trajectory> {
        if particle >= self.log_weight.len() {
            return None;
        }
        let mut poses = Vec::with_capacity(self.len());
        let mut at = particle as u32;
        for generation in self.generations.iter().rev() {
            poses.push(generation.particles.get(at as usize));
            if let Some(parents) = &generation.parents {
                at = parents[at as usize];
            }
            if at == NO_PARENT {
                break;
            }
        }
        poses.reverse();
        Some(Trajectory { first_step: self.len() - poses.len(), poses })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Particles at x = 10 * step + index.
    fn generation(step: u32, n: u32) -> Particles {
        (0..n).map(|i| Pose2::new(f64::from(10 * step + i), 0.0, 0.0)).collect()
    }

    fn xs(trajectory: &Trajectory) -> Vec<f64> {
        trajectory.poses.iter().map(|pose| pose.x).collect()
    }

    #[test]
    fn the_best_path_is_the_best_sum_and_not_the_best_last_step() {
        let mut ancestry = Ancestry::default();
        assert_eq!(ancestry.most_likely_trajectory(), None);
        ancestry.record(&generation(0, 3), None, Some((&[-1.0, -5.0, -9.0], -3.0)));
        ancestry.record(&generation(1, 3), Some(&[0, 1, 1]), Some((&[-4.0, -3.0, -2.0], -3.0)));
        ancestry.record(&generation(2, 3), None, Some((&[-1.0, -1.0, -1.0], -1.0)));
        assert_eq!(ancestry.log_weights(), [-6.0, -9.0, -8.0]);
        let best = ancestry.most_likely_trajectory().unwrap();
        assert_eq!((best.first_step, xs(&best)), (0, vec![0.0, 10.0, 20.0]));
        assert_eq!(xs(&ancestry.trajectory(2).unwrap()), [1.0, 12.0, 22.0]);
        assert_eq!(ancestry.trajectory(3), None);
    }

    #[test]
    fn an_injected_particle_starts_a_path_from_the_evidence() {
        let mut ancestry = Ancestry::default();
        ancestry.record(&generation(0, 2), None, Some((&[-1.0, -5.0], -2.0)));
        ancestry.record(&generation(1, 3), Some(&[0, 0, NO_PARENT]), Some((&[-9.0, -9.0, -1.0], -4.0)));
        assert_eq!(ancestry.log_weights(), [-10.0, -10.0, -3.0]);
        let best = ancestry.most_likely_trajectory().unwrap();
        assert_eq!((best.first_step, xs(&best)), (1, vec![12.0]));
    }

    #[test]
    fn a_reset_of_the_weights_makes_all_paths_equal() {
        let mut ancestry = Ancestry::default();
        ancestry.record(&generation(0, 2), None, Some((&[f64::NEG_INFINITY, -5.0], -2.0)));
        ancestry.record(&generation(1, 2), None, None);
        assert_eq!(ancestry.log_weights(), [-2.0, -2.0]);
        ancestry.record(&generation(2, 2), None, Some((&[-1.0, -2.0], -1.5)));
        assert_eq!(xs(&ancestry.most_likely_trajectory().unwrap()), [0.0, 10.0, 20.0]);
    }
}
