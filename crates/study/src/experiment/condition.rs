//! One condition: its repeats, and the curves over them.

use rayon::prelude::*;

use super::budget::thinned_model;
use super::loss_against_observations::needed;
use super::repeat::{Repeat, ends, run_repeat};
use super::roughness::roughness;
use crate::results::{ConditionResults, Curve, ModelRisk, Samples, Thinning};
use crate::sensor::Source;
use crate::{Study, StudyError, StudyOptions};
use locsim_report::statistics::{Bootstrap, quantile};
use locsim_report::store::{Part, Parts};

/// Part numbers of a condition: repeats are fewer.
const PARTS_OF_A_CONDITION: u32 = 1_000_000;

/// A repeat that an interrupted study has kept, or a new one, which is kept.
fn kept_repeat(
    study: &Study,
    number: usize,
    repeat: u32,
    parts: &Parts,
    options: &StudyOptions<'_>,
) -> Result<Repeat, StudyError> {
    let part = number as u32 * PARTS_OF_A_CONDITION + repeat;
    match parts.load::<Repeat>(part) {
        Part::Whole(kept) => {
            options.control.progress.advance(study.states.len() as u64);
            return Ok(kept);
        }
        Part::Missing => {}
        Part::Damaged => options
            .control
            .progress
            .warn(&format!("repeat {repeat} was kept, but its file is damaged; it is done again")),
    }
    let done = run_repeat(study, number, repeat, options)?;
    parts.save(part, &done)?;
    Ok(done)
}

/// Does the experiments of one condition.
pub(super) fn run_condition(
    study: &Study,
    number: usize,
    parts: &Parts,
    options: &StudyOptions<'_>,
) -> Result<(ConditionResults, Samples), StudyError> {
    let condition = &study.setup.conditions[number];
    let steps = u64::from(study.repeats) * study.states.len() as u64;
    options.control.progress.stage(&format!("{}: {}", study.name, condition.label), steps);
    let repeats: Vec<Repeat> = (0..study.repeats)
        .into_par_iter()
        .map(|repeat| kept_repeat(study, number, repeat, parts, options))
        .collect::<Result<_, StudyError>>()?;
    let sizes: Vec<f64> = study.states.iter().map(|&n| n as f64).collect();
    let over = |at: &[f64], value: &dyn Fn(&Repeat, usize) -> f64| -> Curve {
        curve(at, |place| repeats.iter().map(|r| value(r, place)).collect())
    };
    let bootstrap = Bootstrap::new(study.seed, repeats.len());
    let risks = study
        .models
        .iter()
        .enumerate()
        .map(|(m, model)| {
            let ratio = |copies: &dyn Fn(usize) -> f64, place: usize| {
                let sum = |m: usize| -> f64 {
                    repeats.iter().enumerate().map(|(r, repeat)| copies(r) * repeat.risks[m][place]).sum()
                };
                sum(m) / sum(0)
            };
            let places = 0..sizes.len();
            ModelRisk {
                model: model.as_str(),
                risk: over(&sizes, &|r, place| r.risks[m][place]),
                crps: over(&sizes, &|r, place| r.crps[m][place]),
                bandwidths: places.clone().map(|place| median_bandwidths(&repeats, m, place)).collect(),
                at_end_share: places.clone().map(|place| at_end_share(study, &repeats, m, place)).collect(),
                ratio: places.clone().map(|place| ratio(&|_| 1.0, place)).collect(),
                ratio_intervals: places
                    .map(|place| {
                        let statistic = |copies: &[u32]| [ratio(&|r| f64::from(copies[r]), place)];
                        bootstrap.as_ref()?.intervals(statistic).map(|[interval]| interval)
                    })
                    .collect(),
            }
        })
        .collect();
    let mean = |value: &dyn Fn(&Repeat) -> f64| repeats.iter().map(value).sum::<f64>() / repeats.len() as f64;
    let loss_against_observations = (!study.counts.is_empty()).then(|| {
        let counts: Vec<f64> = study.counts.iter().map(|&m| m as f64).collect();
        let truth_observations = mean(&|r| r.truth_observations);
        let loss = over(&counts, &|r, place| r.losses[place]);
        needed(loss, truth_observations, mean(&|r| r.coefficient_of_truth))
    });
    let observed = match &condition.source {
        Source::Simulated(_) => study.truth_observations.min(1000) as f64,
        Source::Recorded(data) => {
            (0..data.len()).map(|i| data.observations(i).len()).sum::<usize>() as f64 / data.len() as f64
        }
    };
    let results = ConditionResults {
        condition: condition.label.clone(),
        not_gaussian_share: mean(&|r| r.not_gaussian),
        not_gaussian_observations: observed,
        gaussian_between: ends(repeats.iter().flat_map(|r| r.gaussian_at.iter().copied())),
        spans: (0..study.setup.coordinates.len()).map(|d| mean(&|r| r.spans[d])).collect(),
        loss_against_observations,
        risks,
        pooled_risk: over(&sizes, &|r, place| r.pooled[place]),
        own_histogram_risk: repeats[0].own.is_some().then(|| mean(&|r| r.own.unwrap_or(f64::NAN))),
        thinning: thinned_model(study).filter(|_| study.thinning).map(|m| Thinning {
            model: study.models[m].as_str(),
            random: over(&sizes, &|r, place| r.risks[m][place]),
            farthest_first: over(&sizes, &|r, place| r.thinned[0][place]),
            herding: over(&sizes, &|r, place| r.thinned[1][place]),
            condensed: over(&sizes, &|r, place| r.thinned[2][place]),
        }),
        roughness: roughness(study, condition)?,
    };
    let samples = repeats.into_iter().find_map(|r| r.samples);
    Ok((results, samples.unwrap_or(Samples { states: Vec::new(), training_states: 0 })))
}

/// Mean and the middle 80 % over repeats at each place.
fn curve(at: &[f64], values: impl Fn(usize) -> Vec<f64>) -> Curve {
    let mut curve = Curve { at: at.to_vec(), ..Curve::default() };
    for place in 0..at.len() {
        let mut values = values(place);
        values.sort_by(f64::total_cmp);
        curve.mean.push(values.iter().sum::<f64>() / values.len() as f64);
        curve.lo.push(quantile(&values, 0.1));
        curve.hi.push(quantile(&values, 0.9));
    }
    curve
}

fn median_bandwidths(repeats: &[Repeat], model: usize, place: usize) -> Vec<f64> {
    let dim = repeats[0].bandwidths[model][place].len();
    (0..dim)
        .map(|d| {
            let mut values: Vec<f64> = repeats.iter().map(|r| r.bandwidths[model][place][d]).collect();
            values.sort_by(f64::total_cmp);
            quantile(&values, 0.5)
        })
        .collect()
}

/// Share of repeats in which the search might have gone on beyond a list. A last bandwidth of many spans of its coordinate
/// is no end: larger ones would give the same weights.
fn at_end_share(study: &Study, repeats: &[Repeat], model: usize, place: usize) -> f64 {
    let at_end = |r: &&Repeat| {
        r.bandwidths[model][place].iter().zip(&study.bandwidths).zip(&r.spans).any(
            |((chosen, list), span)| {
                let (least, most) =
                    list.iter().fold((f64::INFINITY, 0.0), |(a, b): (f64, f64), &h| (a.min(h), b.max(h)));
                list.len() > 1 && (*chosen == least || (*chosen == most && most < SPANS_THAT_ARE_ALL * span))
            },
        )
    };
    repeats.iter().filter(at_end).count() as f64 / repeats.len() as f64
}

/// With a bandwidth of this many spans of a coordinate, weights of a Gaussian kernel differ by at most 0.5 %.
const SPANS_THAT_ARE_ALL: f64 = 10.0;
