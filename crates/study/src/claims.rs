//! The paper's statements beside the findings. Verdicts and their words follow from the numbers.

use std::fmt::Write;

use super::results::{Claim, ConditionResults, LossAgainstObservations, ModelRisk, Results, Verdict};
use super::{Kind, Model, Study};
use locsim_core::Interval;
use locsim_report::text::{fixed, percent, significant};

/// A number within this factor of the paper's is the paper's: its text says "near".
const NEAR: f64 = 1.5;
/// Beyond this factor it is another.
const FAR: f64 = 3.0;
/// A model has learnt little of the state where it takes less than this share of what there is to take.
const LITTLE: f64 = 0.5;
/// Exponent of N above which a falling risk is called flat.
const FLAT: f64 = -0.1;
/// A prediction resembles the truth where its risk is at most this many times that of measuring at the state itself.
const LIKE: f64 = 2.0;
/// Of Gaussians the test of level 1 % may find this share wanting, and of anything else it must find this share.
const MOSTLY: f64 = 0.1;

pub(super) fn claims(study: &Study, results: &Results) -> Vec<Claim> {
    let mut claims = Vec::new();
    let condition = |label: &str| results.conditions.iter().find(|c| c.condition == label);
    match study.kind {
        Kind::Laser => {
            claims.push(losses(results));
            if let Some(laser) = condition("laser") {
                claims.push(nearly_gaussian(laser));
                claims.extend(enough_observations(laser, "Fig. 7a", 70.0));
                claims.extend(parametric_first(laser, "Fig. 8a"));
                let paper = "Predictions of both procedures resemble what is observed at test states.";
                let both_like = |p, np| Verdict::of(p <= LIKE, np <= LIKE);
                claims.extend(samples(study, laser, "Fig. 9a", paper, both_like));
            }
        }
        Kind::FieldSensor => {
            if let (Some(still), Some(disturbed)) = (condition("still"), condition("disturbed")) {
                claims.push(metal_disturbs(still, disturbed));
                claims.extend(enough_observations(disturbed, "Fig. 7b", 300.0));
                claims.extend(nonparametric_wins(disturbed));
                let paper = "Near metal NP-REG's predictions resemble what is observed, a Gaussian's don't.";
                let one_like = |p, np| Verdict::of(np <= LIKE, p > LIKE);
                claims.extend(samples(study, disturbed, "Fig. 9b", paper, one_like));
            }
        }
        Kind::Grass => claims.extend(condition("grass").map(not_smooth)),
        Kind::StaticLidar => {
            if let Some(lidar) = condition("lidar") {
                claims.push(rays_are_gaussian(results, lidar));
                claims.extend(enough_observations(lidar, "Fig. 7a", 70.0));
                claims.extend(parametric_first(lidar, "Fig. 8a"));
            }
        }
        Kind::Table => {}
    }
    claims
}

fn of(condition: &ConditionResults, model: Model) -> Option<&ModelRisk> {
    condition.risks.iter().find(|r| r.model == model.as_str())
}

/// Both of the paper's procedures.
fn both(condition: &ConditionResults) -> Option<(&ModelRisk, &ModelRisk)> {
    Some((of(condition, Model::PReg)?, of(condition, Model::NpReg)?))
}

fn last(values: &[f64]) -> f64 {
    values.last().copied().unwrap_or(f64::NAN)
}

/// Exponent of N in a risk, over the last doublings of N (the upper half of the sizes).
fn exponent(model: &ModelRisk) -> f64 {
    let (n, risk) = (&model.risk.at, &model.risk.mean);
    let from = n.len() / 2 - usize::from(n.len() == 2);
    let from = from.min(n.len() - 1);
    (last(risk) / risk[from]).ln() / (last(n) / n[from]).ln()
}

/// Whether the middle 80 % of the repeats of `a` lie below those of `b`.
fn clearly_below(a: &ModelRisk, b: &ModelRisk, place: usize) -> bool {
    a.risk.hi[place] < b.risk.lo[place]
}

/// N from which on `a` has less risk than `b`: where the curves, straight between logarithms, cross for the last time.
/// `None` if `a` isn't the lower one at the largest N, or is at every N.
fn crossing(a: &ModelRisk, b: &ModelRisk) -> Option<f64> {
    let ahead = |place: usize| (b.risk.mean[place] / a.risk.mean[place]).ln();
    let after = (0..a.risk.at.len()).rev().take_while(|&place| ahead(place) > 0.0).last()?;
    let before = after.checked_sub(1)?;
    let (from, to) = (a.risk.at[before].ln(), a.risk.at[after].ln());
    Some((from + (to - from) * -ahead(before) / (ahead(after) - ahead(before))).exp())
}

fn at_sizes(a: &ModelRisk, b: &ModelRisk) -> String {
    let n = &a.risk.at;
    let end = n.len() - 1;
    let pair = |place: usize| {
        format!(
            "{} against {} bins at N = {}",
            significant(a.risk.mean[place]),
            significant(b.risk.mean[place]),
            n[place]
        )
    };
    if end == 0 { pair(0) } else { format!("{}, {}", pair(0), pair(end)) }
}

fn losses(results: &Results) -> Claim {
    let [near, far] = results.losses.histogram_match;
    let [near_euclidean, far_euclidean] = results.losses.euclidean;
    Claim {
        figure: "Fig. 5",
        ours: "losses",
        paper: "The histogram match orders predictions as the eye does, the Euclidean distance doesn't.",
        finding: format!(
            "Histogram match: {near:.1} bins for the near prediction, {far:.1} for the far one. Euclidean distance: \
             {near_euclidean:.3} and {far_euclidean:.3}."
        ),
        verdict: Verdict::of(near < far, far_euclidean < near_euclidean),
        reason:
            "Bins that don't overlap are equally wrong to the Euclidean distance, however far apart they are."
                .to_owned(),
    }
}

fn nearly_gaussian(condition: &ConditionResults) -> Claim {
    let share = condition.not_gaussian_share;
    Claim {
        figure: "experiment A",
        ours: "observations",
        paper: "The laser's distributions are nearly Gaussian.",
        finding: format!(
            "A test of level 1 % tells {} % of the test states from a Gaussian, by {:.0} observations each.",
            percent(share),
            condition.not_gaussian_observations
        ),
        verdict: if share <= MOSTLY { Verdict::Reproduced } else { Verdict::Not },
        reason: "That is how this laser is simulated; only a measured one can support or refute the statement (see the \
                 static lidar)."
            .to_owned(),
    }
}

fn enough_observations(condition: &ConditionResults, figure: &'static str, paper: f64) -> Option<Claim> {
    let loss: &LossAgainstObservations = condition.loss_against_observations.as_ref()?;
    let found = loss.needed_by_law;
    let ratio = (found / paper).max(paper / found);
    let verdict = match ratio {
        r if r <= NEAR => Verdict::Reproduced,
        r if r <= FAR => Verdict::Partly,
        _ => Verdict::Not,
    };
    let read_off = loss.needed.map_or_else(
        || "no M of the study reaches it".to_owned(),
        |needed| format!("the curve crosses it at M = {needed:.0}"),
    );
    let simulated = if condition.own_histogram_risk.is_some() {
        " The noise of the simulated sensor is ours, so that this checks its scale, not the paper."
    } else {
        " The truth is itself a histogram, of the other half of the scans, which the law takes out."
    };
    Some(Claim {
        figure,
        ours: "loss_against_observations",
        paper: if paper < 100.0 {
            "The loss falls below 0.5 bins near M = 70."
        } else {
            "Near the metal it takes about M = 300 observations for a loss of 0.5 bins."
        },
        finding: format!(
            "The loss follows {} / sqrt(M) bins, which is 0.5 at M = {found:.0}; {read_off}.",
            significant(loss.coefficient)
        ),
        verdict,
        reason: format!(
            "E[loss] = sqrt(2 / pi) sum sqrt(F (1 - F)) / sqrt(M) depends on the width of the distribution alone: a Gaussian \
             of {} bins has the same, the true distributions give {} / sqrt(M).{simulated}",
            significant(loss.equivalent_sigma),
            significant(loss.coefficient_of_truth)
        ),
    })
}

fn interval_of(interval: Option<Interval>) -> String {
    interval.map_or_else(String::new, |i| format!(" [{}, {}]", significant(i.lo), significant(i.hi)))
}

fn parametric_first(condition: &ConditionResults, figure: &'static str) -> Option<Claim> {
    let (p, np) = both(condition)?;
    let end = p.risk.at.len() - 1;
    let lower = clearly_below(p, np, 0);
    let gap = |place: usize| np.risk.mean[place] - p.risk.mean[place];
    let approaches = gap(0) > 0.0 && gap(end) < 0.5 * gap(0);
    let registered = of(condition, Model::NpRegRegistered).map_or_else(String::new, |registered| {
        let place = p.ratio.iter().position(|r| *r == 1.0).map_or(end, |_| end);
        format!(
            " Registered, NP-REG has {} bins at N = {}: {} times P-REG's.",
            significant(registered.risk.mean[place]),
            p.risk.at[place],
            significant(registered.risk.mean[place] / p.risk.mean[place])
        )
    });
    let verdict = Verdict::of(lower, approaches);
    let reason = match (lower, approaches) {
        (true, true) => {
            "NP-REG as published smooths histograms that lie at different ranges, and blurs them by the range bandwidth; with \
             more states it can do with a smaller one. A Gaussian needs two numbers, which a plane through a few states gives."
        }
        (true, false) => {
            "NP-REG as published smooths histograms that lie at different ranges; as long as states are sparse, it pays with \
             blur, and the gap doesn't close within the sizes of this study."
        }
        (false, _) => {
            "P-REG has no clear head start: with the fewest states the middle 80 % of the repeats overlap, or NP-REG is lower."
        }
    };
    Some(Claim {
        figure,
        ours: "risk",
        paper: "P-REG has the lower risk with few states, and NP-REG approaches it with more.",
        finding: format!(
            "P-REG {} for NP-REG; the gap goes from {} to {} bins.{registered}",
            at_sizes(p, np),
            significant(gap(0)),
            significant(gap(end))
        ),
        verdict,
        reason: reason.to_owned(),
    })
}

fn nonparametric_wins(condition: &ConditionResults) -> Option<Claim> {
    let (p, np) = both(condition)?;
    let end = p.risk.at.len() - 1;
    let lower = clearly_below(np, p, end);
    let (fall_p, fall_np) = (exponent(p), exponent(np));
    let shapes = fall_p > FLAT && fall_np < FLAT;
    let first = (0..=end).find(|&place| np.risk.mean[place] < p.risk.mean[place]);
    let lower_from = match first {
        Some(0) => "NP-REG is lower at every N".to_owned(),
        Some(place) => format!("NP-REG is lower from N = {} on", p.risk.at[place]),
        None => "P-REG is lower at every N".to_owned(),
    };
    let everywhere = np.risk.mean[0] < p.risk.mean[0];
    let verdict = if lower && shapes && !everywhere { Verdict::Partly } else { Verdict::of(lower, shapes) };
    let mut reason = "No Gaussian has two modes, so that P-REG stops at the distance between the truth and its best Gaussian; \
                      histograms have no such limit."
        .to_owned();
    if !everywhere {
        reason += " With few states the blur of smoothing over the probe's place outweighs that, which the paper's figure \
                   doesn't show: how many states are few depends on the length of the axis, which it doesn't give.";
        if let (Some(n), Some(span)) = (crossing(np, p), condition.spans.first()) {
            let (apart, fewest) = (1000.0 * span / n, p.risk.at[0]);
            let _ = write!(
                reason,
                " The curves cross at N = {n:.0}, where states are {} mm apart on an axis of {} mm; N = {fewest} states are as \
                 close on an axis of {} mm.",
                significant(apart),
                significant(1000.0 * span),
                significant(apart * fewest)
            );
        }
    }
    let place = np.risk.at.len() - 1;
    let registered = of(condition, Model::NpRegRegistered).map_or_else(String::new, |r| {
        format!(
            " Registered, it has {} bins at N = {} and {} at N = {}.",
            significant(r.risk.mean[0]),
            r.risk.at[0],
            significant(r.risk.mean[place]),
            r.risk.at[place]
        )
    });
    Some(Claim {
        figure: "Fig. 8b",
        ours: "risk",
        paper: "NP-REG has the lower risk and keeps improving with N; P-REG flattens early.",
        finding: format!(
            "NP-REG {} for P-REG; {lower_from}. Over the upper half of the sizes NP-REG falls as N^{}, P-REG as \
             N^{}.{registered}",
            at_sizes(np, p),
            fixed(fall_np, 2),
            fixed(fall_p, 2)
        ),
        verdict,
        reason,
    })
}

fn metal_disturbs(still: &ConditionResults, disturbed: &ConditionResults) -> Claim {
    let (quiet, noisy) = (still.not_gaussian_share, disturbed.not_gaussian_share);
    let mut reason =
        "The metal's induced dipole adds to the field by where the hand is. The hand rests at the ends of its sweep and is away \
         for a part of the time, and each makes a mode; far from the hand the modes merge in the noise."
            .to_owned();
    if let Some([from, to]) = disturbed.gaussian_between {
        let [from, to] = [from, to].map(|position| significant(1000.0 * position));
        let _ = write!(
            reason,
            " With the forceps, every state that passes as Gaussian lies {from} to {to} mm from the transmitter, where its own \
             field is strongest."
        );
    }
    Claim {
        figure: "Fig. 6",
        ours: "observations",
        paper: "Still surroundings give a Gaussian; metal waved nearby makes the distribution noisy and multimodal.",
        finding: format!(
            "A test of level 1 % tells {} % of the test states from a Gaussian in still surroundings, {} % with the forceps.",
            percent(quiet),
            percent(noisy)
        ),
        verdict: Verdict::of(quiet <= MOSTLY, noisy >= 1.0 - MOSTLY),
        reason,
    }
}

/// Risks of the largest training set in units of measuring at the test state itself.
fn samples(
    study: &Study,
    condition: &ConditionResults,
    figure: &'static str,
    paper: &'static str,
    verdict: impl Fn(f64, f64) -> Verdict,
) -> Option<Claim> {
    let own = condition.own_histogram_risk?;
    let (p, np) = both(condition)?;
    let relative = |model: &ModelRisk| last(&model.risk.mean) / own;
    let list: Vec<String> =
        condition.risks.iter().map(|r| format!("`{}` {}", r.model, significant(relative(r)))).collect();
    let falls = exponent(np);
    let needed = (relative(np) > LIKE && falls < FLAT).then(|| {
        format!(
            " NP-REG as published falls as N^{} and is that near where states are so dense that its blur is small: at this rate \
             not before N = {:.0}.",
            fixed(falls, 2),
            last(&np.risk.at) * (relative(np) / LIKE).powf(-1.0 / falls)
        )
    });
    Some(Claim {
        figure,
        ours: "predictions",
        paper,
        finding: format!(
            "At N = {} the risks, in units of that of a histogram of {} observations at the test state itself ({} bins): {}.",
            last(&np.risk.at),
            study.observations.unwrap_or(1),
            significant(own),
            list.join(", ")
        ),
        verdict: verdict(relative(p), relative(np)),
        reason: format!(
            "A prediction counts as like the observed where its risk is at most {LIKE} times that of measuring at the test \
             state itself. Below 1, smoothing over states saves observations.{}",
            needed.unwrap_or_default()
        ),
    })
}

fn not_smooth(condition: &ConditionResults) -> Claim {
    // Nobody predicts better than by measuring at the state itself.
    let floor = condition.own_histogram_risk.unwrap_or(0.0);
    let (sizes, pooled) = (&condition.pooled_risk.at, &condition.pooled_risk.mean);
    // Share of what a model can take off the pooled risk.
    let taken =
        |model: &ModelRisk, place: usize| (pooled[place] - model.risk.mean[place]) / (pooled[place] - floor);
    let (end, n) = (sizes.len() - 1, last(sizes));
    let list: Vec<String> =
        condition.risks.iter().map(|r| format!("`{}` {} %", r.model, percent(taken(r, end)))).collect();
    let little = |place: &usize| condition.risks.iter().all(|r| taken(r, *place) < LITTLE);
    let until = (0..=end)
        .rev()
        .find(little)
        .map_or_else(String::new, |place| format!(" Up to N = {} none of them takes half.", sizes[place]));
    let fails = |model: Model| of(condition, model).is_none_or(|r| taken(r, end) < LITTLE);
    let roughness = condition.roughness.as_ref().map_or_else(String::new, |r| {
        format!(
            " Places {} mm apart differ half as much as any two do, and training states are {} mm apart.",
            significant(1000.0 * r.half_distance),
            significant(1000.0 * last(&r.distance) / STEP_OF_LAST / n)
        )
    });
    Claim {
        figure: "Fig. 3",
        ours: "neighbours",
        paper: "In grass p(z given x) isn't smooth in x, and neither procedure works.",
        finding: format!(
            "Risks at N = {n}: {} bins for the histogram of all observations, {} for one measured at the test state itself. Of \
             what lies between, the models take: {}.{until}",
            significant(last(&condition.pooled_risk.mean)),
            significant(floor),
            list.join(", ")
        ),
        verdict: Verdict::of(fails(Model::PReg), fails(Model::NpReg)),
        reason: format!("Smoothing needs neighbours that resemble each other.{roughness}"),
    }
}

/// Share of the span that the last distance of a roughness is.
const STEP_OF_LAST: f64 = 0.4;

fn rays_are_gaussian(results: &Results, condition: &ConditionResults) -> Claim {
    let (finding, share) = results.families.as_ref().map_or_else(
        || (String::new(), condition.not_gaussian_share),
        |f| {
            let best: Vec<String> =
                f.families.iter().map(|family| format!("`{}` {}", family.family, family.best)).collect();
            let share = f.not_gaussian as f64 / f.rays as f64;
            let text = format!(
                "A test of level 1 % tells {} of {} rays ({} %) from a Gaussian. On these a kernel density beats it by \
                 {}{} nats per held-out reading. Rays on which a family is the best: {}.",
                f.not_gaussian,
                f.rays,
                percent(share),
                significant(f.kernel_density_gain),
                interval_of(f.kernel_density_gain_interval),
                best.join(", ")
            );
            (text, share)
        },
    );
    Claim {
        figure: "experiment A",
        ours: "rays",
        paper: "The laser's distributions are nearly Gaussian.",
        finding,
        verdict: if share <= MOSTLY { Verdict::Reproduced } else { Verdict::Not },
        reason: "The readings have several modes, as if a ray alternated between neighbouring places: likely because the scanner \
                 samples at other angles from turn to turn and each file column is a whole degree. The paper's laser is another \
                 one."
            .to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::results::Curve;

    fn model(name: &'static str, risks: [f64; 3]) -> ModelRisk {
        let curve = |factor: f64| risks.iter().map(|r| factor * r).collect::<Vec<f64>>();
        let risk = Curve { at: vec![30.0, 120.0, 480.0], mean: curve(1.0), lo: curve(0.9), hi: curve(1.1) };
        ModelRisk {
            model: name,
            crps: risk.clone(),
            risk,
            bandwidths: vec![vec![1.0]; 3],
            at_end_share: vec![0.0; 3],
            ratio: vec![1.0; 3],
            ratio_intervals: vec![None; 3],
        }
    }

    fn condition(p_reg: [f64; 3], np_reg: [f64; 3]) -> ConditionResults {
        ConditionResults {
            condition: "disturbed".to_owned(),
            not_gaussian_share: 0.0,
            not_gaussian_observations: 1000.0,
            gaussian_between: None,
            spans: vec![0.1],
            loss_against_observations: None,
            risks: vec![model("p_reg", p_reg), model("np_reg", np_reg)],
            pooled_risk: Curve { at: vec![30.0, 120.0, 480.0], mean: vec![100.0; 3], ..Curve::default() },
            own_histogram_risk: Some(1.0),
            thinning: None,
            roughness: None,
        }
    }

    #[test]
    fn curves_cross_where_logarithms_do() {
        let model = |risks| model("np_reg", risks);
        let flat = model([2.0; 3]);
        assert!((crossing(&model([4.0, 1.0, 0.5]), &flat).unwrap() - 60.0).abs() < 1e-9);
        assert!((crossing(&model([1.0, 4.0, 1.0]), &flat).unwrap() - 240.0).abs() < 1e-9, "the last time");
        assert_eq!(crossing(&model([1.0; 3]), &flat), None, "lower everywhere");
        assert_eq!(crossing(&model([1.0, 1.0, 4.0]), &flat), None, "not lower in the end");
    }

    #[test]
    fn verdicts_follow_the_numbers() {
        let first = |p, np| parametric_first(&condition(p, np), "Fig. 8a").unwrap().verdict;
        assert_eq!(first([2.0, 1.5, 1.0], [20.0, 9.0, 4.0]), Verdict::Reproduced);
        assert_eq!(first([2.0, 1.5, 1.0], [20.0, 19.0, 18.0]), Verdict::Partly);
        assert_eq!(
            first([20.0, 20.0, 20.0], [2.0, 2.0, 2.0]),
            Verdict::Not,
            "NP-REG is lower from the first"
        );
        assert_eq!(first([2.0, 2.0, 2.0], [2.1, 4.0, 5.0]), Verdict::Not);

        let wins = |p, np| nonparametric_wins(&condition(p, np)).unwrap().verdict;
        assert_eq!(wins([9.0, 9.0, 9.0], [8.0, 5.0, 3.0]), Verdict::Reproduced);
        assert_eq!(wins([9.0, 9.0, 9.0], [20.0, 9.0, 3.0]), Verdict::Partly, "only with many states");
        assert_eq!(wins([9.0, 5.0, 2.0], [20.0, 20.0, 20.0]), Verdict::Not);

        let grass = |p, np| not_smooth(&condition(p, np)).verdict;
        assert_eq!(grass([100.0; 3], [99.0; 3]), Verdict::Reproduced);
        assert_eq!(grass([100.0; 3], [10.0; 3]), Verdict::Partly);
        assert_eq!(grass([10.0; 3], [10.0; 3]), Verdict::Not);
    }
}
