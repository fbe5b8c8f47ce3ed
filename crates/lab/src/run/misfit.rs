//! Filters that have gathered at a wrong place, and start again.

use locsim_core::Pose2;
use locsim_mcl::StepOutcome;
use locsim_report::results::{UNUSUAL_SCANS, USUAL_SCAN};
use locsim_scenario as scenario;

use super::training::TrainedModel;

/// Counts scans that don't fit the map wherever the filter takes the robot to be, for a filter that starts anywhere.
pub(super) struct Misfit {
    /// What 99 of 100 scans of the training drive exceed \[nats per reading\]; `None` where a filter doesn't start again.
    usual: Option<f64>,
    /// Scans in a row that don't fit.
    scans: usize,
}

impl Misfit {
    pub fn new(filter: &scenario::Filter, model: &TrainedModel) -> Self {
        let is_anywhere = filter.start == scenario::Start::Global && filter.annealing.is_some();
        Self { usual: model.row.chosen.get(USUAL_SCAN).copied().filter(|_| is_anywhere), scans: 0 }
    }

    /// Whether the robot is lost by the scans up to this one, whose log density (nats per reading) at a pose is `log_density`, NaN
    /// without readings. Scans that aren't taken in, or have no readings, say nothing. Where two places are alike the mean is between
    /// them, and the likeliest particle is at one.
    pub fn is_lost(&mut self, outcome: &StepOutcome, log_density: impl Fn(Pose2) -> f64) -> bool {
        let Some(usual) = self.usual.filter(|_| outcome.likelihood_power > 0.0) else { return false };
        let estimates = &outcome.estimates;
        let at_mean = log_density(estimates.weighted_mean.pose);
        if at_mean.is_nan() {
            return false;
        }
        let fits = at_mean >= usual || log_density(estimates.max_weight) >= usual;
        self.scans = if fits { 0 } else { self.scans + 1 };
        let is_lost = self.scans >= UNUSUAL_SCANS;
        if is_lost {
            self.scans = 0;
        }
        is_lost
    }

    /// What is said of a filter that starts again.
    pub fn event() -> String {
        format!("{UNUSUAL_SCANS} scans in a row don't fit: starts anywhere again")
    }
}

#[cfg(test)]
mod tests {
    use locsim_mcl::{Estimate, Estimates};

    use super::*;

    /// A scan with its log density at the mean, and of the likeliest particle.
    struct Seen {
        at_mean: f64,
        likeliest: f64,
        power: f64,
    }

    const BAD: Seen = Seen { at_mean: -2.0, likeliest: -3.0, power: 1.0 };

    fn restarts(usual: Option<f64>, scans: &[Seen]) -> usize {
        let mut misfit = Misfit { usual, scans: 0 };
        let mean = Estimate { pose: Pose2::IDENTITY, covariance: [[0.0; 3]; 3] };
        let likeliest = Pose2::new(5.0, 0.0, 0.0);
        let outcome = |power: f64| StepOutcome {
            log_evidence: 0.0,
            effective_sample_size: 1.0,
            likelihood_power: power,
            particle_count: 1,
            resampled: false,
            injected: 0,
            recovered: None,
            estimates: Estimates { weighted_mean: mean, max_weight: likeliest, densest_cluster: None },
        };
        let is_lost = |seen: &&Seen| {
            let density = |pose: Pose2| if pose == likeliest { seen.likeliest } else { seen.at_mean };
            misfit.is_lost(&outcome(seen.power), density)
        };
        scans.iter().filter(is_lost).count()
    }

    /// Thirty scans in a row. One that fits begins anew; one that wasn't taken in or has no reading doesn't count.
    #[test]
    fn a_filter_starts_again_after_enough_scans_that_do_not_fit() {
        let bad = |count: usize| (0..count).map(|_| BAD).collect::<Vec<Seen>>();
        let between = |seen: Seen| {
            let mut scans = bad(UNUSUAL_SCANS - 1);
            scans.push(seen);
            scans.push(BAD);
            scans
        };
        assert_eq!(restarts(Some(-1.0), &bad(UNUSUAL_SCANS - 1)), 0);
        assert_eq!(restarts(Some(-1.0), &bad(UNUSUAL_SCANS)), 1);
        assert_eq!(restarts(Some(-1.0), &bad(2 * UNUSUAL_SCANS)), 2);
        assert_eq!(restarts(None, &bad(UNUSUAL_SCANS)), 0);
        assert_eq!(restarts(Some(-1.0), &between(Seen { power: 0.0, ..BAD })), 1);
        assert_eq!(restarts(Some(-1.0), &between(Seen { at_mean: f64::NAN, ..BAD })), 1);
        assert_eq!(restarts(Some(-1.0), &between(Seen { at_mean: 0.0, ..BAD })), 0);
        // Two places that are alike: the mean is at neither.
        assert_eq!(restarts(Some(-1.0), &between(Seen { likeliest: 0.0, ..BAD })), 0);
    }
}
