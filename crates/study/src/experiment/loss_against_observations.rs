//! Loss against the number M of observations, and the M that the threshold takes (Fig. 7).

use distreg::{Distribution, histogram_match};

use super::Purpose;
use super::data::{Test, shuffled};
use crate::results::{Curve, LossAgainstObservations};
use crate::sensor::Source;
use crate::{Study, StudyError};

/// The paper's threshold of the loss, in bins.
const THRESHOLD: f64 = 0.5;

/// c of a Gaussian with a deviation of one bin.
const GAUSSIAN_COEFFICIENT: f64 = 1.288;

/// Mean loss of histograms of M observations against the truth for each M of the study, over test states; the c that
/// follows from the truths; and the observations behind a truth.
pub(super) fn losses(
    study: &Study,
    number: usize,
    repeat: u32,
    tests: &[Test],
) -> Result<(Vec<f64>, f64, f64), StudyError> {
    let Some(&most) = study.counts.last() else { return Ok((Vec::new(), f64::NAN, f64::NAN)) };
    let draw = study.draw(Purpose::Observations, repeat);
    let mut losses = vec![0.0; study.counts.len()];
    let mut coefficient = 0.0;
    let mut truth_observations = 0.0;
    let mut used = 0.0;
    for (i, test) in tests.iter().enumerate() {
        let (drawn, truth): (Vec<f64>, Distribution) = match &study.setup.conditions[number].source {
            Source::Simulated(sensor) => {
                let mut random = draw.item(i as u32);
                truth_observations += study.truth_observations as f64;
                let drawn = (0..most).map(|_| sensor.observe(&test.state, &mut random)).collect();
                (drawn, test.truth.clone())
            }
            Source::Recorded(_) => {
                // One half is the truth of the other.
                let order = shuffled(test.observed.len(), draw, i as u32);
                let (mine, truth) = order.split_at(order.len() / 2);
                if mine.len() < most {
                    continue;
                }
                truth_observations += truth.len() as f64;
                let of = |part: &[usize]| part.iter().map(|&j| test.observed[j]).collect::<Vec<f64>>();
                (of(mine), study.histogram(&of(truth))?)
            }
        };
        used += 1.0;
        for (loss, &m) in losses.iter_mut().zip(&study.counts) {
            *loss += histogram_match(&study.histogram(&drawn[..m])?, &truth)?;
        }
        coefficient += coefficient_of(&truth);
    }
    for loss in &mut losses {
        *loss /= used;
    }
    Ok((losses, coefficient / used, truth_observations / used))
}

/// c of E\[loss\] = c / sqrt(M): the mean distance of the cumulative distributions is sqrt(2 / pi) sqrt(F (1 - F) / M) for each
/// bin, in the limit of many observations. For a Gaussian of s bins the sum over bins is 1.614 s, and c 1.288 s.
fn coefficient_of(truth: &Distribution) -> f64 {
    let mut f = 0.0;
    let sum: f64 = truth
        .mass()
        .iter()
        .map(|p| {
            f += p;
            (f * (1.0 - f)).max(0.0).sqrt()
        })
        .sum();
    (2.0 / std::f64::consts::PI).sqrt() * sum
}

/// Where the loss falls to the threshold.
pub(super) fn needed(
    loss: Curve,
    truth_observations: f64,
    coefficient_of_truth: f64,
) -> LossAgainstObservations {
    let first = loss.mean.iter().position(|l| *l <= THRESHOLD);
    let needed = first.and_then(|k| {
        let before = k.checked_sub(1)?;
        // The loss is a power of M: straight between logarithms.
        let [(m0, l0), (m1, l1)] = [before, k].map(|k| (loss.at[k].ln(), loss.mean[k].ln()));
        Some((m0 + (m1 - m0) * (THRESHOLD.ln() - l0) / (l1 - l0)).exp())
    });
    let law = |m: f64| (1.0 / m + 1.0 / truth_observations).sqrt();
    let coefficient =
        loss.at.iter().zip(&loss.mean).map(|(m, l)| l / law(*m)).sum::<f64>() / loss.at.len() as f64;
    LossAgainstObservations {
        loss,
        threshold: THRESHOLD,
        needed,
        coefficient,
        truth_observations,
        needed_by_law: (coefficient / THRESHOLD).powi(2),
        coefficient_of_truth,
        equivalent_sigma: coefficient / GAUSSIAN_COEFFICIENT,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use distreg::{Outcomes, histogram};
    use locsim_core::{Draw, Stage};
    use rand_distr::{Distribution as _, StandardNormal};

    /// The sum over bins of sqrt(F (1 - F)) of a Gaussian is 1.614 deviations, and E[loss] = 1.288 sigma / sqrt(M) bins.
    #[test]
    fn a_gaussians_loss_follows_the_law_of_its_width() {
        let outcomes = Outcomes::of_values(0.0, 0.2, 0.0001).unwrap();
        let (sigma, n) = (5.0, 200_000);
        let draw = Draw::new(1, Stage::Laser, 0);
        let sample = |i: u32| {
            let normal: f64 = StandardNormal.sample(&mut draw.item(i));
            ((1000.0 + sigma * normal).round() * 1e-4).max(0.0)
        };
        let all: Vec<f64> = (0..n).map(sample).collect();
        let truth = histogram(&all, &outcomes).unwrap();
        let expected = GAUSSIAN_COEFFICIENT * sigma;
        // Rounding adds 1/12 to the variance, 0.2 % to the deviation; the sampled tails lack about as much.
        assert!((coefficient_of(&truth) / expected - 1.0).abs() < 0.01, "{}", coefficient_of(&truth));

        // 1000 histograms of 200: the loss of one varies by 45 % (1 standard deviation), the mean by 1.4 %; 5 of them.
        let losses = all.chunks(200).map(|part| {
            histogram_match(&histogram(part, &outcomes).unwrap(), &truth).unwrap() * 200f64.sqrt()
        });
        let mean = losses.sum::<f64>() / f64::from(n / 200);
        assert!((mean / expected - 1.0).abs() < 0.07, "{mean} against {expected}");
    }

    #[test]
    fn the_number_needed_is_where_the_curve_crosses() {
        let at = [10.0, 40.0, 160.0];
        let curve = |c: f64| Curve {
            at: at.to_vec(),
            mean: at.iter().map(|m: &f64| c / m.sqrt()).collect(),
            ..Curve::default()
        };
        let found = needed(curve(4.0), f64::INFINITY, 4.0);
        assert!((found.needed.unwrap() - 64.0).abs() < 1e-9, "{:?}", found.needed);
        assert!((found.needed_by_law - 64.0).abs() < 1e-9);
        let unreached = needed(curve(40.0), f64::INFINITY, 40.0);
        assert_eq!(unreached.needed, None);
        assert!((unreached.needed_by_law - 6400.0).abs() < 1e-6);
    }
}
