//! The experiments: loss against M, risk against N, sample predictions, roughness.

use std::sync::atomic::Ordering;

use distreg::{
    Alignment, Dataset, Distribution, Grid, Selection, condense, euclidean, histogram, histogram_match,
    product, select,
};
use locsim_core::{Draw, Stage};
use rayon::prelude::*;

use super::model::folds;
use super::results::{
    ConditionResults, Curve, LossAgainstObservations, LossExample, ModelRisk, Results, Roughness, Thinning,
};
use super::sensor::{Condition, Sensor, Source};
use super::{Kind, Model, Study, StudyError, StudyOptions, claims, families};
use crate::statistics::{Bootstrap, quantile};

/// The paper's threshold of the loss, in bins.
const THRESHOLD: f64 = 0.5;
/// Predictions that are drawn.
const SAMPLES: usize = 3;
/// Pairs of states behind each distance of a roughness.
const PAIRS: u32 = 60;

/// What figures draw beside the results.
pub(super) struct Extra {
    /// Per condition.
    pub conditions: Vec<Samples>,
    /// Reference, near and far prediction of Fig. 5.
    pub loss_example: [Distribution; 3],
    /// Some rays of a static lidar, each with the families fitted to it; the state is the ray's number.
    pub rays: Samples,
    /// Grass: true distributions of neighbouring states, with the distance from the first.
    pub neighbours: Vec<(f64, Distribution)>,
}

/// Distributions at some test states.
pub(super) struct Samples {
    /// States with the truth and each model's prediction from the largest training set.
    pub states: Vec<Sample>,
    /// Training states of that set.
    pub training_states: usize,
}

/// One test state.
pub(super) struct Sample {
    /// The state.
    pub state: Vec<f64>,
    /// What was observed there, many times.
    pub truth: Distribution,
    /// What each model predicts.
    pub predicted: Vec<Distribution>,
}

/// What the draws of an experiment are for.
#[derive(Clone, Copy)]
enum Purpose {
    Training = 1,
    Test = 2,
    Folds = 3,
    Observations = 4,
    Roughness = 5,
    Own = 6,
    Thinning = 7,
}

/// A test state with its true distribution.
struct Test {
    state: Vec<f64>,
    truth: Distribution,
    /// The observations that the truth was made of, or a share of them.
    observed: Vec<f64>,
}

/// What one repeat finds; risks by model and size.
struct Repeat {
    risks: Vec<Vec<f64>>,
    crps: Vec<Vec<f64>>,
    bandwidths: Vec<Vec<Vec<f64>>>,
    pooled: Vec<f64>,
    /// By way of choosing and budget.
    thinned: [Vec<f64>; 3],
    own: Option<f64>,
    losses: Vec<f64>,
    coefficient_of_truth: f64,
    truth_observations: f64,
    not_gaussian: f64,
    samples: Option<Samples>,
}

/// Does every experiment of a study.
pub(super) fn run(study: &Study, options: &StudyOptions<'_>) -> Result<(Results, Extra), StudyError> {
    let mut conditions = Vec::new();
    let mut samples = Vec::new();
    for number in 0..study.setup.conditions.len() {
        let (results, drawn) = run_condition(study, number, options)?;
        conditions.push(results);
        samples.push(drawn);
    }
    options.progress.stage("figures and report", 1);
    let (losses, loss_example) = loss_example(study)?;
    let families = (study.kind == Kind::StaticLidar).then(|| families::compare(study)).transpose()?;
    let rays = families::shown(study)?;
    let neighbours = neighbours(study)?;
    let mut results = Results {
        study: study.name.clone(),
        sensor: study.kind.as_str(),
        seed: study.seed,
        repeats: study.repeats,
        quick: study.quick,
        bins: study.setup.outcomes.grid.bins,
        bin_width: study.setup.outcomes.grid.width,
        conditions,
        losses,
        families,
        claims: Vec::new(),
    };
    results.claims = claims::claims(study, &results);
    Ok((results, Extra { conditions: samples, loss_example, rays, neighbours }))
}

impl Study {
    /// The draws of one repeat of an experiment: the same for every condition, so that these see the same states.
    fn draw(&self, purpose: Purpose, repeat: u32) -> Draw {
        let seed = Draw::new(self.seed, Stage::Trial, purpose as u32).seed(0);
        Draw::new(seed, Stage::Training, repeat)
    }

    pub(super) fn histogram(&self, observations: &[f64]) -> Result<Distribution, StudyError> {
        Ok(histogram(observations, &self.setup.outcomes)?)
    }
}

/// Training states of a repeat, the largest set; smaller ones are its beginnings, so that a curve over N compares like
/// with like. And the test states, which aren't among them.
fn data(study: &Study, number: usize, repeat: u32) -> Result<(Dataset, Vec<Test>), StudyError> {
    let most = study.states.last().copied().unwrap_or(0);
    let training = study.draw(Purpose::Training, repeat);
    match &study.setup.conditions[number].source {
        Source::Simulated(sensor) => {
            let count = study.observations.unwrap_or(1);
            let mut data = Dataset::new(study.setup.coordinates.len());
            for i in 0..most as u32 {
                let (state, observations) = observe(sensor.as_ref(), training, i, count);
                data.push(&state, &observations)?;
            }
            let test = study.draw(Purpose::Test, repeat);
            let tests = (0..study.test_states as u32)
                .map(|i| {
                    let (state, mut observed) = observe(sensor.as_ref(), test, i, study.truth_observations);
                    let truth = study.histogram(&observed)?;
                    observed.truncate(1000);
                    Ok(Test { state, truth, observed })
                })
                .collect::<Result<_, StudyError>>()?;
            Ok((data, tests))
        }
        Source::Recorded(recorded) => {
            let order = shuffled(recorded.len(), training, 0);
            let (tests, train) = order.split_at(study.test_states);
            let tests = tests
                .iter()
                .map(|&i| {
                    let observed = recorded.observations(i).to_vec();
                    Ok(Test {
                        state: recorded.state(i).to_vec(),
                        truth: study.histogram(&observed)?,
                        observed,
                    })
                })
                .collect::<Result<_, StudyError>>()?;
            let mut data = Dataset::new(recorded.dim());
            for &i in &train[..most] {
                let observations = recorded.observations(i);
                let count = study.observations.unwrap_or(usize::MAX).min(observations.len());
                let chosen = shuffled(observations.len(), training, i as u32 + 1);
                let observations: Vec<f64> = chosen[..count].iter().map(|&j| observations[j]).collect();
                data.push(recorded.state(i), &observations)?;
            }
            Ok((data, tests))
        }
    }
}

/// State number `i` of a draw, and `count` observations at it.
fn observe(sensor: &dyn Sensor, draw: Draw, i: u32, count: usize) -> (Vec<f64>, Vec<f64>) {
    let mut random = draw.item(i);
    let state = sensor.state(&mut random);
    let observations = (0..count).map(|_| sensor.observe(&state, &mut random)).collect();
    (state, observations)
}

/// 0..n in random order.
fn shuffled(n: usize, draw: Draw, item: u32) -> Vec<usize> {
    use rand::seq::SliceRandom;
    let mut order: Vec<usize> = (0..n).collect();
    order.shuffle(&mut draw.item(item));
    order
}

fn run_condition(
    study: &Study,
    number: usize,
    options: &StudyOptions<'_>,
) -> Result<(ConditionResults, Samples), StudyError> {
    let condition = &study.setup.conditions[number];
    let steps = u64::from(study.repeats) * study.states.len() as u64;
    options.progress.stage(&format!("{}: {}", study.name, condition.label), steps);
    let repeats: Vec<Repeat> = (0..study.repeats)
        .into_par_iter()
        .map(|repeat| run_repeat(study, number, repeat, options))
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

fn run_repeat(
    study: &Study,
    number: usize,
    repeat: u32,
    options: &StudyOptions<'_>,
) -> Result<Repeat, StudyError> {
    let (data, tests) = data(study, number, repeat)?;
    let queries: Vec<f64> = tests.iter().flat_map(|test| test.state.iter().copied()).collect();
    let axes: Vec<&[f64]> = study.bandwidths.iter().map(Vec::as_slice).collect();
    let candidates = product(&axes);
    let models = study.models.len();
    let mut risks = vec![Vec::new(); models];
    let mut scores = vec![Vec::new(); models];
    let mut bandwidths = vec![Vec::new(); models];
    let mut pooled = Vec::new();
    let mut samples = Vec::new();
    for (place, &n) in study.states.iter().enumerate() {
        if options.interrupted.load(Ordering::Relaxed) {
            return Err(StudyError::Interrupted);
        }
        let train = data.subset(&(0..n).collect::<Vec<_>>());
        let seed = study.draw(Purpose::Folds, repeat).seed(place as u32);
        let folds = folds(&study.setup, &train, study.folds, seed)?;
        for (m, model) in study.models.iter().enumerate() {
            let chosen = model.choose(&study.setup, &candidates, &folds, study.criterion)?;
            let predicted = model.predict(&study.setup, &train, &chosen, &queries)?;
            let (risk, score) = score(&predicted, &tests)?;
            risks[m].push(risk);
            scores[m].push(score);
            bandwidths[m].push(chosen);
            if repeat == 0 && place + 1 == study.states.len() {
                samples.push(predicted);
            }
        }
        let all: Vec<f64> = (0..n).flat_map(|i| train.observations(i).iter().copied()).collect();
        let all = study.histogram(&all)?;
        let loss = tests.iter().map(|test| histogram_match(&all, &test.truth)).sum::<Result<f64, _>>()?;
        pooled.push(loss / tests.len() as f64);
        options.progress.advance(1);
    }
    let thinned = thinned(study, repeat, &data, &tests, &queries, &candidates, &bandwidths)?;
    let (losses, coefficient_of_truth, truth_observations) = losses(study, number, repeat, &tests)?;
    let own = match &study.setup.conditions[number].source {
        Source::Simulated(sensor) => Some(own_risk(study, repeat, sensor.as_ref(), &tests)?),
        Source::Recorded(_) => None,
    };
    let not_gaussian = tests
        .iter()
        .filter(|test| families::is_not_gaussian(&test.observed, &study.setup.outcomes.grid))
        .count();
    Ok(Repeat {
        risks,
        crps: scores,
        bandwidths,
        pooled,
        thinned,
        own,
        losses,
        coefficient_of_truth,
        truth_observations,
        not_gaussian: not_gaussian as f64 / tests.len() as f64,
        samples: (repeat == 0)
            .then(|| pick_samples(&tests, &samples, study.states.last().copied().unwrap_or(0))),
    })
}

/// The model whose training set is thinned: the best of NP-REG's forms that the study has.
fn thinned_model(study: &Study) -> Option<usize> {
    let place = |model| study.models.iter().position(|m| *m == model);
    place(Model::NpRegRegistered).or_else(|| place(Model::NpReg))
}

/// Risk with training states chosen from the largest set within each size, by farthest-first traversal, by herding, and by
/// the first with all observations kept. Distances are in the bandwidths that the model chose for the largest set.
fn thinned(
    study: &Study,
    repeat: u32,
    data: &Dataset,
    tests: &[Test],
    queries: &[f64],
    candidates: &[Vec<f64>],
    bandwidths: &[Vec<Vec<f64>>],
) -> Result<[Vec<f64>; 3], StudyError> {
    let mut risks: [Vec<f64>; 3] = Default::default();
    let Some(place) = thinned_model(study).filter(|_| study.thinning) else { return Ok(risks) };
    let model = study.models[place];
    let Some(scales) = bandwidths[place].last() else { return Ok(risks) };
    let seed = study.draw(Purpose::Thinning, repeat).seed(0);
    let orders = [Selection::FarthestFirst, Selection::Herding]
        .map(|selection| select(data, data.len(), selection, scales, seed));
    let [farthest, herding] = orders;
    let (farthest, herding) = (farthest?, herding?);
    let alignment = match model {
        Model::NpRegRegistered => study.setup.alignment.unwrap_or_default(),
        _ => Alignment::Identity,
    };
    let point = study.setup.outcomes.point_mass_at;
    for &n in &study.states {
        let chosen = [
            data.subset(&farthest[..n]),
            data.subset(&herding[..n]),
            condense(data, &farthest[..n], alignment, point, scales)?,
        ];
        for (risks, train) in risks.iter_mut().zip(chosen) {
            let folds = folds(&study.setup, &train, study.folds, seed)?;
            let bandwidths = model.choose(&study.setup, candidates, &folds, study.criterion)?;
            let predicted = model.predict(&study.setup, &train, &bandwidths, queries)?;
            risks.push(score(&predicted, tests)?.0);
        }
    }
    Ok(risks)
}

/// Mean histogram match (bins) and mean CRPS (units of z) of predictions at the test states.
fn score(predicted: &[Distribution], tests: &[Test]) -> Result<(f64, f64), StudyError> {
    let (mut risk, mut crps) = (0.0, 0.0);
    for (predicted, test) in predicted.iter().zip(tests) {
        risk += histogram_match(predicted, &test.truth)?;
        crps += distreg::crps(predicted, &test.observed);
    }
    let n = tests.len() as f64;
    Ok((risk / n, crps / n))
}

/// Mean loss of histograms of M observations against the truth for each M of the study, over test states; the c that
/// follows from the truths; and the observations behind a truth.
fn losses(
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

/// c of E\[loss\] = c / sqrt(M): the mean distance of the cumulative distributions is sqrt(2 / pi) sqrt(F (1 - F) / M) for each bin, in the limit of
/// many observations. For a Gaussian of s bins the sum over bins is 1.614 s, and c 1.288 s.
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

/// c of a Gaussian with a deviation of one bin.
pub(super) const GAUSSIAN_COEFFICIENT: f64 = 1.288;

/// Where the loss falls to the threshold.
fn needed(loss: Curve, truth_observations: f64, coefficient_of_truth: f64) -> LossAgainstObservations {
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

/// Mean loss of a histogram of M observations at the test states themselves.
fn own_risk(study: &Study, repeat: u32, sensor: &dyn Sensor, tests: &[Test]) -> Result<f64, StudyError> {
    let draw = study.draw(Purpose::Own, repeat);
    let count = study.observations.unwrap_or(1);
    let mut sum = 0.0;
    for (i, test) in tests.iter().enumerate() {
        let mut random = draw.item(i as u32);
        let own: Vec<f64> = (0..count).map(|_| sensor.observe(&test.state, &mut random)).collect();
        sum += histogram_match(&study.histogram(&own)?, &test.truth)?;
    }
    Ok(sum / tests.len() as f64)
}

/// Test states spread over the first coordinate.
fn pick_samples(tests: &[Test], predicted: &[Vec<Distribution>], training_states: usize) -> Samples {
    let mut order: Vec<usize> = (0..tests.len()).collect();
    order.sort_by(|&a, &b| tests[a].state[0].total_cmp(&tests[b].state[0]));
    let states = (0..SAMPLES.min(tests.len()))
        .map(|k| {
            let i = order[(2 * k + 1) * tests.len() / (2 * SAMPLES)];
            let test = &tests[i];
            let predicted = predicted.iter().map(|of_model| of_model[i].clone()).collect();
            Sample { state: test.state.clone(), truth: test.truth.clone(), predicted }
        })
        .collect();
    Samples { states, training_states }
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

fn at_end_share(study: &Study, repeats: &[Repeat], model: usize, place: usize) -> f64 {
    let at_end = |r: &&Repeat| {
        r.bandwidths[model][place].iter().zip(&study.bandwidths).any(|(chosen, list)| {
            let (least, most) =
                list.iter().fold((f64::INFINITY, 0.0), |(a, b): (f64, f64), &h| (a.min(h), b.max(h)));
            *chosen == least || *chosen == most
        })
    };
    repeats.iter().filter(at_end).count() as f64 / repeats.len() as f64
}

/// Distances of neighbouring states, as shares of the span of a state coordinate.
const STEPS: [f64; 12] = [1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1, 0.2, 0.4];

/// How the distribution changes along a state of one coordinate; `None` for other studies.
fn roughness(study: &Study, condition: &Condition) -> Result<Option<Roughness>, StudyError> {
    let (Source::Simulated(sensor), 1) = (&condition.source, study.setup.coordinates.len()) else {
        return Ok(None);
    };
    let draw = study.draw(Purpose::Roughness, 0);
    let starts: Vec<f64> = (0..PAIRS).map(|i| sensor.state(&mut draw.item(i))[0]).collect();
    let (lo, hi) =
        starts.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), &x| (lo.min(x), hi.max(x)));
    let middle = 0.5 * (lo + hi);
    let truth = |x: f64, step: u32, i: u32| -> Result<Distribution, StudyError> {
        let mut random = draw.at(step).item(i);
        let observed: Vec<f64> =
            (0..study.truth_observations).map(|_| sensor.observe(&[x], &mut random)).collect();
        study.histogram(&observed)
    };
    let truths: Vec<Distribution> = starts
        .par_iter()
        .enumerate()
        .map(|(i, &x)| truth(x, 1, i as u32))
        .collect::<Result<_, StudyError>>()?;
    let mut roughness =
        Roughness { distance: Vec::new(), loss: Vec::new(), unrelated: 0.0, half_distance: f64::NAN };
    for (k, share) in STEPS.into_iter().enumerate() {
        let distance = share * (hi - lo);
        let losses = starts
            .par_iter()
            .enumerate()
            .map(|(i, &x)| {
                // Towards the middle, or the state would leave its span.
                let other = if x < middle { x + distance } else { x - distance };
                Ok(histogram_match(&truths[i], &truth(other, k as u32 + 2, i as u32)?)?)
            })
            .collect::<Result<Vec<f64>, StudyError>>()?;
        roughness.distance.push(distance);
        roughness.loss.push(losses.iter().sum::<f64>() / losses.len() as f64);
    }
    let pairs = truths.len() / 2;
    for i in 0..pairs {
        roughness.unrelated += histogram_match(&truths[i], &truths[i + pairs])? / pairs as f64;
    }
    let half = 0.5 * roughness.unrelated;
    if let Some(k) = roughness.loss.iter().position(|loss| *loss >= half) {
        roughness.half_distance = match k.checked_sub(1) {
            None => roughness.distance[0],
            Some(before) => {
                let share = (half - roughness.loss[before]) / (roughness.loss[k] - roughness.loss[before]);
                roughness.distance[before] + share * (roughness.distance[k] - roughness.distance[before])
            }
        };
    }
    Ok(Some(roughness))
}

/// The paper's Fig. 5: predictions of the same shape as the reference, one moved a little, one moved far. Neither overlaps
/// with it, so that the Euclidean distance can't tell them apart.
fn loss_example(study: &Study) -> Result<(LossExample, [Distribution; 3]), StudyError> {
    let grid = Grid { lo: 0.0, width: study.setup.outcomes.grid.width, bins: 60 };
    let bump = |from: usize| -> Result<Distribution, StudyError> {
        let mut mass = vec![0.0; grid.bins];
        for (b, share) in [1.0, 3.0, 5.0, 3.0, 1.0].into_iter().enumerate() {
            mass[from + b] = share;
        }
        Ok(Distribution::new(grid, mass, None)?)
    };
    // The far one is a little lower and wider, so that the Euclidean distance even prefers it.
    let mut far = vec![0.0; grid.bins];
    for (b, share) in [1.0, 2.0, 3.0, 3.0, 3.0, 2.0, 1.0].into_iter().enumerate() {
        far[45 + b] = share;
    }
    let three = [bump(10)?, bump(16)?, Distribution::new(grid, far, None)?];
    let [reference, near, far] = &three;
    let example = LossExample {
        histogram_match: [histogram_match(near, reference)?, histogram_match(far, reference)?],
        euclidean: [euclidean(near, reference)?, euclidean(far, reference)?],
    };
    Ok((example, three))
}

/// True distributions at neighbouring places of the grass.
fn neighbours(study: &Study) -> Result<Vec<(f64, Distribution)>, StudyError> {
    let (Kind::Grass, Source::Simulated(sensor)) = (study.kind, &study.setup.conditions[0].source) else {
        return Ok(Vec::new());
    };
    let draw = study.draw(Purpose::Roughness, 1);
    let start = sensor.state(&mut draw.item(0))[0];
    [0.0, 0.01, 0.02]
        .into_iter()
        .enumerate()
        .map(|(i, distance)| {
            let mut random = draw.item(i as u32 + 1);
            let observed: Vec<f64> = (0..study.truth_observations)
                .map(|_| sensor.observe(&[start + distance], &mut random))
                .collect();
            Ok((distance, study.histogram(&observed)?))
        })
        .collect()
}

impl Kind {
    /// As in a study's file.
    pub(super) fn as_str(self) -> &'static str {
        match self {
            Self::Laser => "laser",
            Self::FieldSensor => "field_sensor",
            Self::Grass => "grass",
            Self::StaticLidar => "static_lidar",
            Self::Table => "table",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use distreg::Outcomes;
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
