//! Offsets of groups that are normal about zero, with a variance that is known of each and one that all have in common.
//!
//! What data say of an offset is normal, too: information and its product with the offset that fits them best. The common
//! variance is fitted to all groups (empirical Bayes).

use statrs::statistics::{Data, OrderStatistics};

/// What data say of the offset of a group.
#[derive(Clone, Copy, Debug, Default)]
pub struct GroupEvidence {
    /// Fisher information.
    pub information: f64,
    /// The information times the offset that fits the data best.
    pub vector: f64,
}

impl GroupEvidence {
    /// Most likely offset and its variance, by the variance that offsets of this group have.
    fn posterior(&self, variance: f64) -> [f64; 2] {
        let posterior = (self.information + variance.recip()).recip();
        [posterior * self.vector, posterior]
    }
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    Data::new(values.collect::<Vec<_>>()).median()
}

fn variances(sigmas: &[f64], common: f64) -> impl Iterator<Item = f64> {
    sigmas.iter().map(move |sigma| sigma * sigma + common * common)
}

/// The most likely offset of each group, by its own standard deviation and the common one.
pub fn most_likely(sigmas: &[f64], common: f64, data: &[GroupEvidence]) -> Vec<f64> {
    variances(sigmas, common).zip(data).map(|(variance, data)| data.posterior(variance)[0]).collect()
}

/// Offset and standard deviation of each group that has data, about the median of all.
pub fn posteriors(sigmas: &[f64], common: f64, data: &[GroupEvidence]) -> Vec<[f64; 2]> {
    let groups = variances(sigmas, common).zip(data).filter(|(_, data)| data.information > 0.0);
    let mut known: Vec<[f64; 2]> = groups.map(|(variance, data)| data.posterior(variance)).collect();
    let middle = median(known.iter().map(|[offset, _]| *offset));
    for [offset, variance] in &mut known {
        *offset -= middle;
        *variance = variance.sqrt();
    }
    known
}

/// Log density of each offset, with the volume of what it may be (Laplace's method).
pub fn log_priors(sigmas: &[f64], common: f64, data: &[GroupEvidence], offsets: &[f64]) -> Vec<f64> {
    let groups = variances(sigmas, common).zip(data).zip(offsets);
    groups
        .map(|((variance, data), offset)| {
            -0.5 * (offset * offset / variance + (data.information * variance).ln_1p())
        })
        .collect()
}

/// The common standard deviation of the offsets by expectation maximization, about their mean. Groups that are farther than `outlier`
/// from the median don't count.
pub fn common_deviation(
    sigmas: &[f64],
    start: f64,
    data: &[GroupEvidence],
    iterations: usize,
    outlier: f64,
) -> f64 {
    let mut common = start;
    for _ in 0..iterations {
        let mut groups: Vec<[f64; 3]> = variances(sigmas, common)
            .zip(data)
            .zip(sigmas)
            .filter(|((_, data), _)| data.information > 0.0)
            .map(|((variance, data), sigma)| {
                let [offset, posterior] = data.posterior(variance);
                [offset, posterior, sigma * sigma]
            })
            .collect();
        let middle = median(groups.iter().map(|[offset, ..]| *offset));
        groups.retain(|[offset, ..]| (offset - middle).abs() < outlier);
        let n = groups.len() as f64;
        if n < 2.0 {
            return common;
        }
        let mean = groups.iter().map(|[offset, ..]| offset).sum::<f64>() / n;
        let excess =
            groups.iter().map(|[offset, variance, known]| (offset - mean).powi(2) + variance - known);
        common = (excess.sum::<f64>() / n).max(0.0).sqrt();
    }
    common
}

#[cfg(test)]
mod tests {
    use rand_distr::{Distribution, StandardNormal};
    use rand_philox::Philox;

    use super::*;

    /// Two hundred groups with an offset of 2 (standard deviation), seen with an error of 1, one of which is far off: 2 within four standard
    /// errors, and an offset is drawn to zero by a fifth.
    #[test]
    fn the_common_deviation_of_offsets_is_found() {
        let mut rng = Philox::from_u64_seed(3);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let mut seen: Vec<f64> = (0..200).map(|_| 2.0 * normal() + normal()).collect();
        seen[7] = 80.0;
        let data: Vec<GroupEvidence> =
            seen.iter().map(|&vector| GroupEvidence { information: 1.0, vector }).collect();
        let sigmas = vec![0.0; 200];
        let common = common_deviation(&sigmas, 0.5, &data, 200, 20.0);
        assert!((common - 2.0).abs() < 0.5, "{common}");
        let offsets = most_likely(&sigmas, 2.0, &data);
        assert!((offsets[7] - 64.0).abs() < 1e-9);
        assert!((posteriors(&sigmas, 2.0, &data)[0][1] - 0.8_f64.sqrt()).abs() < 1e-9);
        let prior = log_priors(&sigmas, 2.0, &data, &offsets)[7];
        assert!((prior + 0.5 * (64.0 * 64.0 / 4.0 + 5.0_f64.ln())).abs() < 1e-9);
    }
}
