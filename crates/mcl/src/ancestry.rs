use locsim_core::{Particles, Pose2};

/// The parent of a particle that was injected at random.
pub const NO_PARENT: u32 = u32::MAX;

/// After so many steps, particles from which no current one descends are given up.
pub const PRUNED_AFTER: usize = 256;

/// A filter's whole history: each step's particles as they were weighted, and who descends from whom.
///
/// Takes 28 bytes for each particle of the last [`PRUNED_AFTER`] steps, and for each earlier one from which a current one descends: soon
/// a few, as paths have common beginnings (Jacob, Murray and Rubenthaler, "Path storage in the particle filter", 2015).
#[derive(Clone, Debug, Default)]
pub struct Ancestry {
    generations: Vec<Generation>,
    /// Log likelihood of each current particle's path (nats).
    log_weight: Vec<f64>,
    /// Log evidence of all steps so far (nats).
    log_evidence: f64,
    /// Generations before this one hold ancestors of current particles alone, or did when last pruned.
    pruned: usize,
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
        if self.generations.len() - self.pruned > PRUNED_AFTER {
            self.prune();
        }
    }

    /// Gives up all particles of earlier generations from which no current one descends.
    fn prune(&mut self) {
        self.pruned = self.generations.len();
        let current = self.generations.last().map_or(0, |generation| generation.particles.len());
        // Of the younger generation those that stay, as they were numbered, in order.
        let mut staying: Vec<u32> = (0..current as u32).collect();
        for younger in (1..self.generations.len()).rev() {
            let (older, generation) = self.generations[..=younger].split_at_mut(younger);
            let (older, generation) = (&mut older[younger - 1], &mut generation[0]);
            let parent =
                |child: &u32| generation.parents.as_ref().map_or(*child, |parents| parents[*child as usize]);
            let parents: Vec<u32> = staying.iter().map(parent).collect();
            let mut number = vec![NO_PARENT; older.particles.len()];
            for parent in parents.iter().filter(|parent| **parent != NO_PARENT) {
                number[*parent as usize] = 0;
            }
            staying = (0..).zip(&number).filter(|(_, used)| **used == 0).map(|(i, _)| i).collect();
            for (new, old) in (0..).zip(&staying) {
                number[*old as usize] = new;
            }
            let renumbered =
                |parent: u32| if parent == NO_PARENT { NO_PARENT } else { number[parent as usize] };
            generation.parents = Some(parents.into_iter().map(renumbered).collect());
            let kept = staying.iter().map(|i| older.particles.get(*i as usize)).collect();
            older.particles = kept;
        }
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
    use locsim_core::{Draw, Stage};
    use rand::RngExt;

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

    /// A thousand steps, with injected particles now and then and sets of other sizes: paths and weights are those of a history that is kept
    /// whole, and most of it is given up.
    #[test]
    fn a_history_without_descendants_is_given_up() {
        let (mut pruned, mut whole) = (Ancestry::default(), Ancestry::default());
        let draw = Draw::new(3, Stage::Resample, 0);
        let mut count = 20;
        for step in 0..1000 {
            let mut rng = draw.item(step);
            let next: u32 = if step % 50 == 7 { rng.random_range(5..40) } else { count };
            let injects = step % 301 == 300;
            let resampled = next != count || injects || step % 3 != 0;
            let mut parent = |i: u32| if injects && i == 0 { NO_PARENT } else { rng.random_range(0..count) };
            let parents: Option<Vec<u32>> =
                (step > 0 && resampled).then(|| (0..next).map(&mut parent).collect());
            let log_likelihood: Vec<f64> = (0..next).map(|_| rng.random()).collect();
            for ancestry in [&mut pruned, &mut whole] {
                ancestry.record(&generation(step, next), parents.as_deref(), Some((&log_likelihood, 0.5)));
            }
            whole.pruned = whole.generations.len();
            count = next;
        }
        assert_eq!(pruned.log_weights(), whole.log_weights());
        for particle in 0..count as usize {
            assert_eq!(pruned.trajectory(particle), whole.trajectory(particle));
        }
        let kept =
            |ancestry: &Ancestry| ancestry.generations.iter().map(|g| g.particles.len()).sum::<usize>();
        assert!(2 * kept(&pruned) < kept(&whole), "{} of {}", kept(&pruned), kept(&whole));
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
