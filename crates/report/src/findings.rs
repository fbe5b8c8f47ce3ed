//! Findings: sentences that follow from the numbers alone.

use locsim_core::Interval;
use locsim_sensor::ModelKind;

use super::text::{code, escape, metres, metres_with, percent, significant, with_interval};
use crate::results::{ModelTrial, RunResults, StepRow, UNUSUAL_SCANS, USUAL_SCAN};
use crate::statistics::{quantile, share_interval};
use crate::summary::{CLASSIC, ModelSummary, ORACLE, Ratio, Summary};

/// The paper's nonparametric model, as published.
pub const NP_REG: &str = "np_reg";
/// The model whose aims the report checks.
pub const REGISTERED: &str = "np_reg_registered";

/// The paper's Table II: mean and standard deviation of the pose error (m).
pub const PAPER: [(&str, f64, f64); 2] = [(CLASSIC, 0.004, 0.041), (NP_REG, 0.002, 0.020)];

/// Largest ratio of deviations to `classic` that is aimed for: the paper's own, rounded.
const AIM_STD: f64 = 0.5;
/// Largest ratio of RMSE to `oracle` that is aimed for.
const AIM_RMSE: f64 = 1.1;

/// So few lost trials that a bootstrap over trials doesn't represent them well.
const FEW: u32 = 5;

/// A bound on a ratio, judged by its whole interval.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    Met,
    NotMet,
    Undecided,
}

/// Whether a ratio is at most `bound`.
fn judge(ratio: Ratio, bound: f64) -> Verdict {
    match ratio.interval() {
        Some(interval) if interval.hi <= bound => Verdict::Met,
        Some(interval) if interval.lo > bound => Verdict::NotMet,
        _ => Verdict::Undecided,
    }
}

fn ratio_text(ratio: Ratio) -> String {
    with_interval(ratio.value, ratio.interval(), 2)
}

/// Below this share of effective particles a posterior is a handful of poses.
const FEW_EFFECTIVE: f64 = 0.05;

/// Where the filter takes in more than this share of the scans by a power below 1, a remark is due.
const CUT_SHARE: f64 = 0.05;

/// An RMSE beyond this many times the median error is due to a few large errors: of a Gaussian error in the plane it is 1.2 times
/// the median, of one with twice the spread in a tenth of the steps 1.4 times.
const FAR_FROM_MEDIAN: f64 = 2.0;

/// Remarks to read before the figures: lost trials, scans that don't fit the map, an RMSE far from the median, few effective particles,
/// scans that were not taken in whole.
pub fn warnings(results: &RunResults) -> Vec<String> {
    let of_models = results.models.iter().enumerate().flat_map(|(i, model)| warnings_of(results, i, model));
    let together = [few_effective(results), cut_scans(results)].into_iter().flatten();
    left_out(results).into_iter().chain(off_map(results)).chain(of_models).chain(together).collect()
}

/// What `told` says of the steps of each model, one after another; `None` where it says nothing of any.
fn of_each(results: &RunResults, told: impl Fn(&[&StepRow]) -> Option<String>) -> Option<String> {
    let said = results.models.iter().enumerate().filter_map(|(index, model)| {
        let trials = results.trials.iter().map(|trial| &trial.models[index]);
        let taken_in: Vec<&StepRow> =
            trials.flat_map(|trial| &trial.steps).filter(|row| row.likelihood_power > 0.0).collect();
        told(&taken_in).map(|text| format!("{model} {text}"))
    });
    let said: Vec<String> = said.collect();
    (!said.is_empty()).then(|| said.join(", "))
}

/// A sentence on the models under which few particles are effective in most steps.
fn few_effective(results: &RunResults) -> Option<String> {
    let said = of_each(results, |rows| {
        let is_few = |row: &&&StepRow| row.effective_sample_size < FEW_EFFECTIVE * f64::from(row.particles);
        let few = rows.iter().filter(is_few).count() as f64 / rows.len().max(1) as f64;
        (few > 0.5).then(|| format!("{:.0} %", 100.0 * few))
    })?;
    Some(format!(
        "Fewer than {:.0} % of the particles were effective in most steps ({said}): more particles or smaller exponents may give another \
         result.",
        100.0 * FEW_EFFECTIVE
    ))
}

/// A sentence on the models of which many scans were taken in by a power of their likelihood.
fn cut_scans(results: &RunResults) -> Option<String> {
    let said = of_each(results, |rows| {
        let powers = rows.iter().map(|row| row.likelihood_power);
        let mut cut: Vec<f64> = powers.filter(|power| *power < 1.0).collect();
        cut.sort_by(f64::total_cmp);
        let share = cut.len() as f64 / rows.len().max(1) as f64;
        (share > CUT_SHARE).then(|| format!("{:.0} %, {}", 100.0 * share, significant(quantile(&cut, 0.5))))
    })?;
    Some(format!(
        "Scans that would have left fewer effective particles than `filter.least_effective_share` were taken in by a smaller power of their \
         likelihood (share of the scans and median power: {said}): there that key decides how sure the filter is, not the model's \
         exponent."
    ))
}

/// A sentence on the scans that weren't taken in, which are the same under each model.
fn left_out(results: &RunResults) -> Option<String> {
    let steps =
        || results.trials.iter().filter_map(|trial| trial.models.first()).flat_map(|model| &model.steps);
    let left_out = steps().filter(|row| row.likelihood_power == 0.0).count();
    (left_out > 0).then(|| {
        let of = steps().count();
        format!(
            "{left_out} of the {of} scans of all trials ({:.0} %) were not taken in, as the robot had hardly moved since the scan before \
             (`filter.update`).",
            100.0 * left_out as f64 / of as f64
        )
    })
}

/// A sentence on the stretches on which reference poses and map disagree, with the errors elsewhere.
fn off_map(results: &RunResults) -> Option<String> {
    let told: Vec<String> = results
        .disagreements
        .iter()
        .map(|found| {
            let apart = if found.most_m - found.least_m < 0.005 {
                format!("{:.2}", found.most_m)
            } else {
                format!("{:.2} to {:.2}", found.least_m, found.most_m)
            };
            format!(
                "scans {} to {} by {apart} m ({:.0} % of their returns end within {:.2} m of a mapped surface, {:.0} % from \
                 poses that far beside)",
                found.first_scan,
                found.last_scan,
                100.0 * found.near_share,
                found.near_m,
                100.0 * found.near_share_beside,
            )
        })
        .collect();
    if told.is_empty() {
        return None;
    }
    let elsewhere = results.models.iter().enumerate().filter_map(|(index, model)| {
        let rows = results.trials.iter().flat_map(|trial| &trial.models[index].steps);
        let outside = rows.filter(|row| !results.disagreements.iter().any(|found| found.has(row.step)));
        let squares: Vec<f64> = outside.map(|row| row.position_error_m().powi(2)).collect();
        let mean = squares.iter().sum::<f64>() / squares.len() as f64;
        (!squares.is_empty()).then(|| format!("{model} {} m", metres(mean.sqrt())))
    });
    let elsewhere: Vec<String> = elsewhere.collect();
    let rest = if elsewhere.is_empty() {
        String::new()
    } else {
        format!(" RMSE without these scans: {}.", elsewhere.join(", "))
    };
    Some(format!(
        "The reference poses and the map disagree in {}. A filter that is right in the map is wrong against the reference there.{rest}",
        told.join(", in ")
    ))
}

fn warnings_of(results: &RunResults, index: usize, model: &str) -> Vec<String> {
    let trials: Vec<&ModelTrial> = results.trials.iter().map(|trial| &trial.models[index]).collect();
    let rows = || trials.iter().flat_map(|trial| &trial.steps);
    let steps = rows().count() as f64;
    let lost = trials.iter().filter(|trial| trial.lost).count();
    let mut errors: Vec<f64> = rows().map(StepRow::position_error_m).collect();
    errors.sort_by(f64::total_cmp);
    let median = quantile(&errors, 0.5);
    let rmse = (errors.iter().map(|error| error * error).sum::<f64>() / steps).sqrt();
    [
        (lost > 0).then(|| {
            let all = trials.len();
            let trials = if all == 1 { "its only trial".to_owned() } else { format!("{lost} of {all} trials") };
            format!("{model} lost {trials}: its errors say how far off it got, not how precise it is.")
        }),
        results.training[index].chosen.get(USUAL_SCAN).and_then(|usual| unusual_scans(model, &trials, *usual)),
        (rmse > FAR_FROM_MEDIAN * median).then(|| {
            format!(
                "Under {model}, the RMSE ({} m) is {} times the median error ({} m): a few large errors decide it.",
                metres(rmse),
                with_interval(rmse / median, None, 1),
                metres(median)
            )
        }),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// A sentence on trials with many scans in a row whose log density is below `usual`. It needs no reference pose: a robot that is
/// lost without anyone knowing shows it.
fn unusual_scans(model: &str, trials: &[&ModelTrial], usual: f64) -> Option<String> {
    // A scan that wasn't taken in shows what the one before did, and one without readings nothing.
    let says = |row: &StepRow| row.likelihood_power > 0.0 && !row.scan_log_density_nats.is_nan();
    let runs: Vec<(usize, usize)> = trials
        .iter()
        .map(|trial| {
            longest_run(&trial.steps, |row| Some(row.scan_log_density_nats < usual).filter(|_| says(row)))
        })
        .filter(|(count, _)| *count >= UNUSUAL_SCANS)
        .collect();
    let (longest, first) = runs.iter().rev().max_by_key(|(count, _)| *count)?;
    Some(format!(
        "Under {model}, the scans don't fit the map at the estimated pose in {} of {} trials: up to {} scans in a row, from scan \
         {} on, have a lower likelihood than 99 of 100 scans of the training drive. The filter has lost the robot there, or the map isn't \
         true.",
        runs.len(),
        trials.len(),
        longest,
        first
    ))
}

/// How many rows the longest run has in which something holds, and the index of its first row. Rows that don't say whether it does neither
/// count nor end a run.
fn longest_run(rows: &[StepRow], holds: impl Fn(&StepRow) -> Option<bool>) -> (usize, usize) {
    let (mut longest, mut count, mut first) = ((0, 0), 0, 0);
    for (i, row) in rows.iter().enumerate() {
        match holds(row) {
            None => continue,
            Some(false) => count = 0,
            Some(true) => {
                first = if count == 0 { i } else { first };
                count += 1;
            }
        }
        if count > longest.0 {
            longest = (count, first);
        }
    }
    longest
}

/// Which models did best and how each compares with the baseline.
pub fn comparisons(summary: &Summary) -> Vec<String> {
    let mut sentences = Vec::new();
    let mut ranked: Vec<(&str, &ModelSummary)> =
        summary.models.iter().map(|(name, model)| (name.as_str(), model)).collect();
    ranked.sort_by(|a, b| a.1.errors.position_rmse_m.total_cmp(&b.1.errors.position_rmse_m));
    let figure = |(name, model): (&str, &ModelSummary)| {
        let interval = model.intervals.map(|i| i.errors.position_rmse_m);
        format!("{} with {} m", code(name), metres_with(model.errors.position_rmse_m, interval))
    };
    if let [best, rest @ ..] = ranked.as_slice() {
        let next = rest.first().map_or_else(String::new, |next| {
            let ratio = summary.ratios.get(next.0).and_then(|ratios| ratios.rmse_vs_lowest);
            let ratio = ratio
                .map_or_else(String::new, |r| format!(", {} times that, {}", ratio_text(r), direction(r)));
            format!("; next {}{ratio}", figure(*next))
        });
        sentences.push(format!("Lowest position RMSE over all trials: {}{next}.", figure(*best)));
    }
    let median = |m: &ModelSummary| m.errors.position_median_m;
    if let Some((name, model)) = summary.models.iter().min_by(|a, b| median(a.1).total_cmp(&median(b.1)))
        && ranked.len() > 1
    {
        sentences.push(format!(
            "Lowest median position error: {} with {} m.",
            code(name),
            metres(median(model))
        ));
    }
    for ((name, all), kept) in summary.ratios.iter().zip(summary.ratios_kept.values()) {
        let (Some(ratio), true) = (all.rmse(), name != summary.baseline()) else { continue };
        let without_lost = kept.rmse().filter(|k| k.value != ratio.value).map_or_else(String::new, |k| {
            format!("; {} on the trials that neither lost, {}", ratio_text(k), direction(k))
        });
        sentences.push(format!(
            "{} against {}: {} times the RMSE, {}{without_lost}.",
            code(name),
            code(summary.baseline()),
            ratio_text(ratio),
            direction(ratio)
        ));
    }
    sentences
}

/// Which side of 1 a ratio is on.
fn direction(ratio: Ratio) -> &'static str {
    match ratio.interval() {
        None => "no interval: one drive, and a short one",
        Some(interval) if interval.hi < 1.0 => "lower",
        Some(interval) if interval.lo > 1.0 => "higher",
        Some(_) => "no difference that this run can show",
    }
}

/// Who lost how many trials.
pub fn lost_trials(summary: &Summary) -> Vec<String> {
    let lost: Vec<(&str, u32)> = summary
        .models
        .iter()
        .map(|(name, m)| (name.as_str(), (m.lost_share * f64::from(summary.trials)).round() as u32))
        .collect();
    let bound = |k| share_interval(k, summary.trials);
    if lost.iter().all(|(_, k)| *k == 0) {
        if summary.trials == 1 {
            return vec![
                "No model lost the trial; a single one says little of how often they would.".to_owned(),
            ];
        }
        return vec![format!(
            "No model lost any of the {} trials; the true share of lost trials is then below {} % (exact 95 % interval), \
             for each.",
            summary.trials,
            percent(bound(0).hi)
        )];
    }
    let mut sentences: Vec<String> = lost
        .iter()
        .map(|&(name, k)| {
            let interval = bound(k);
            format!(
                "{} lost {k} of {} trials: {} % [{}, {}].",
                code(name),
                summary.trials,
                percent(f64::from(k) / f64::from(summary.trials)),
                percent(interval.lo),
                percent(interval.hi)
            )
        })
        .collect();
    if lost.iter().any(|(_, k)| (1..=FEW).contains(k)) {
        sentences.push(
            "Where only a few trials were lost, means, deviations and RMSE over all trials hang on these few, and a \
             bootstrap can't know how far off the next one would be: read medians and the figures without lost \
             trials beside them."
                .to_owned(),
        );
    }
    sentences
}

/// Where our experiment agrees with the paper's Table II and where not; empty unless `classic` and `np_reg` ran.
pub fn beside_the_paper(summary: &Summary) -> Vec<String> {
    let [(_, _, paper_classic), (_, _, paper_np_reg)] = PAPER;
    let published = paper_np_reg / paper_classic;
    let mut sentences = Vec::new();
    let ratios = |kept: bool| {
        let all = if kept { &summary.ratios_kept } else { &summary.ratios };
        all.get(NP_REG).and_then(|r| r.position_std_vs_classic)
    };
    if let Some(ratio) = ratios(false) {
        let verdict = match ratio.interval() {
            None => "can't be told from a single trial".to_owned(),
            Some(i) if i.contains(published) => "agrees: the paper's ratio lies in our interval".to_owned(),
            Some(i) if i.hi < 1.0 && i.lo > published => {
                "agrees in direction only: less deviation, but not by as much as in the paper".to_owned()
            }
            Some(i) if i.hi < published => {
                "agrees in direction: even less deviation than in the paper".to_owned()
            }
            Some(i) if i.lo > 1.0 => "doesn't agree: more deviation, where the paper has less".to_owned(),
            Some(_) => "doesn't agree: no difference from 1 that these trials can show".to_owned(),
        };
        sentences.push(format!(
            "Deviation of NP-REG as published over that of the classic model: paper {published:.2} (one trajectory, no \
             interval), ours {}. This {verdict}.",
            ratio_text(ratio)
        ));
        if let Some(kept) = ratios(true).filter(|k| k.value != ratio.value) {
            sentences.push(format!(
                "On the trials that neither of the two lost the ratio is {}: what is left of the difference when \
                 divergence is taken out.",
                ratio_text(kept)
            ));
        }
    }
    for (name, mean, std) in PAPER {
        let Some(model) = summary.models.get(name) else { continue };
        let errors = &model.errors;
        let bias = |label: &str, ours: f64, interval: Option<Interval>| {
            let state = match interval {
                None => "no interval",
                Some(i) if i.contains(0.0) => "not to be told from zero",
                Some(_) => "different from zero",
            };
            format!("{label} {} m ({state})", metres_with(ours, interval))
        };
        sentences.push(format!(
            "{}: paper {mean:.3} ± {std:.3} m. Our deviation is {} times the paper's along the error axis and {} times \
             across it; our mean error is {} and {}.",
            code(name),
            with_interval(errors.along.std_m / std, None, 2),
            with_interval(errors.across.std_m / std, None, 2),
            bias("along", errors.along.mean_m, model.intervals.map(|i| i.errors.along.mean_m)),
            bias("across", errors.across.mean_m, model.intervals.map(|i| i.errors.across.mean_m)),
        ));
    }
    sentences
}

/// Whether registered NP-REG does what it was made for; empty unless it ran beside the `oracle`: the aims are of the paper's simulated
/// corridor.
pub fn aims(summary: &Summary) -> Vec<String> {
    if !summary.models.contains_key(ORACLE) {
        return Vec::new();
    }
    let Some(ratios) = summary.ratios.get(REGISTERED) else { return Vec::new() };
    let kept = summary.ratios_kept.get(REGISTERED).copied().unwrap_or_default();
    [
        ("Deviation", CLASSIC, AIM_STD, ratios.position_std_vs_classic, kept.position_std_vs_classic),
        ("RMSE", ORACLE, AIM_RMSE, ratios.rmse_vs_oracle, kept.rmse_vs_oracle),
    ]
    .into_iter()
    .filter_map(|(what, against, bound, ratio, kept)| {
        let ratio = ratio?;
        let verdict = match judge(ratio, bound) {
            Verdict::Met => "**met**",
            Verdict::NotMet => "**not met**",
            Verdict::Undecided if ratio.interval().is_none() => {
                "**undecided**: a single trial has no interval"
            }
            Verdict::Undecided => "**undecided** by the interval",
        };
        let without_lost = kept
            .filter(|k| k.value != ratio.value)
            .map_or_else(String::new, |k| format!(" ({} on the trials that neither lost)", ratio_text(k)));
        Some(format!(
            "{what} of {} at most {bound} times that of {}: {verdict}; it is {}{without_lost}.",
            code(REGISTERED),
            code(against),
            ratio_text(ratio)
        ))
    })
    .collect()
}

/// Why the models differ, as far as what was fitted and measured tells.
pub fn reasons(summary: &Summary) -> Vec<String> {
    let mut sentences = Vec::new();
    let sigma = |name| summary.models.get(name)?.train.chosen.get("sigma_m").copied();
    if let Some(sigma_m) = sigma(CLASSIC) {
        sentences.push(format!(
            "The Gaussian of {} was fitted with a deviation of {} m. Where that is many times the sensor's noise, it has \
             taken in the readings that unmapped objects in front of walls shortened: no exponential describes those. \
             The posterior is then as much too wide.",
            code(CLASSIC),
            significant(sigma_m)
        ));
    }
    let ratio = summary.ratios.get(REGISTERED).and_then(|ratios| ratios.rmse_vs_oracle);
    if let Some(ratio) = ratio.filter(|ratio| ratio.value > 1.0) {
        sentences.push(format!(
            "{} has {} times the RMSE of {}, which knows from each pose where objects may stand; nominal range and incidence \
             angle don't tell that apart. Fewer particles than a sharp density needs widen the gap.",
            code(REGISTERED),
            ratio_text(ratio),
            code(ORACLE)
        ));
    }
    if summary.ratios.get(CLASSIC).and_then(|r| r.rmse_vs_oracle).is_some_and(|r| r.value < 1.0) {
        sentences.push(format!(
            "{} bounds the density of single beams, not the filter: beams that meet the same object aren't independent, and \
             a model that learns nothing from such readings is then the safer one.",
            code(ORACLE)
        ));
    }
    sentences
}

/// Which model predicted held-out readings best; empty when none was measured.
pub fn training(summary: &Summary) -> Vec<String> {
    let best = |pick: fn(&ModelSummary) -> Option<f64>| {
        summary
            .models
            .iter()
            .filter_map(|(name, model)| Some((name, pick(model)?)))
            .min_by(|a, b| a.1.total_cmp(&b.1))
    };
    let mut sentences = Vec::new();
    if let Some((name, loss)) = best(|m| m.train.log_loss_nats) {
        sentences.push(format!("Lowest held-out log loss: {} with {loss:.3} nats a reading.", code(name)));
    }
    if let Some((name, distance)) = best(|m| m.train.histogram_match_m) {
        sentences.push(format!(
            "Closest held-out distributions: {} with {} m.",
            code(name),
            metres(distance)
        ));
    }
    sentences
}

/// Definition of a model that locsim ships, for the report; `None` for other names.
pub fn describe(model: &str) -> Option<&'static str> {
    if model == ORACLE {
        return Some(
            "the true density of one beam, from the blocks and the noise of the simulated world (no other effect), on \
             a lattice of cells and headings: about the best that a model of single beams can be",
        );
    }
    model.parse().map(ModelKind::sentence).ok()
}

/// The fitted and chosen parameters: one line per model of names and values.
pub fn chosen(summary: &Summary) -> Vec<String> {
    let models = summary.models.iter().filter(|(_, model)| !model.train.chosen.is_empty());
    models
        .map(|(name, model)| {
            let pairs = model.train.chosen.iter();
            let pairs = pairs.map(|(name, value)| format!("{} {}", escape(name), significant(*value)));
            format!("{}: {}.", code(name), pairs.collect::<Vec<_>>().join(", "))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ratio(value: f64, interval: Option<(f64, f64)>) -> Ratio {
        Ratio { value, lo: interval.map(|i| i.0), hi: interval.map(|i| i.1) }
    }

    #[test]
    fn a_bound_is_judged_by_the_whole_interval() {
        assert_eq!(judge(ratio(0.4, Some((0.3, 0.5))), 0.5), Verdict::Met);
        assert_eq!(judge(ratio(0.4, Some((0.3, 0.51))), 0.5), Verdict::Undecided);
        assert_eq!(judge(ratio(0.6, Some((0.51, 0.7))), 0.5), Verdict::NotMet);
        assert_eq!(judge(ratio(0.4, None), 0.5), Verdict::Undecided);
    }

    #[test]
    fn a_difference_needs_an_interval_clear_of_one() {
        assert_eq!(direction(ratio(0.8, Some((0.7, 0.9)))), "lower");
        assert_eq!(direction(ratio(1.2, Some((1.1, 1.3)))), "higher");
        assert!(direction(ratio(0.9, Some((0.7, 1.1)))).starts_with("no difference"));
    }

    /// 32 scans below the usual in a row are told, 29 aren't, and of several runs the longest is.
    #[test]
    fn scans_that_do_not_fit_the_map_are_told_where_they_last() {
        let trial = |runs: &[std::ops::Range<usize>]| {
            let row = |step: usize| StepRow {
                scan_log_density_nats: if runs.iter().any(|run| run.contains(&step)) { -3.0 } else { 0.0 },
                likelihood_power: 1.0,
                ..StepRow::default()
            };
            let steps = (0..90).map(row).collect();
            ModelTrial { model: "np_reg".to_owned(), steps, lost: false, step_ms: 0.0, events: Vec::new() }
        };
        let (lost, kept) = (trial(&[2..31, 40..72]), trial(&[2..31, 40..69]));
        let sentence = unusual_scans("np_reg", &[&kept, &lost], -1.0).unwrap();
        assert!(
            sentence.contains("in 1 of 2 trials: up to 32 scans in a row, from scan 40 on"),
            "{sentence}"
        );
        assert_eq!(unusual_scans("np_reg", &[&kept, &kept], -1.0), None);
        // A robot that stands, and one whose laser is covered for some scans.
        let mut standing = trial(std::slice::from_ref(&(2..60)));
        standing.steps[10..50].iter_mut().for_each(|row| row.likelihood_power = 0.0);
        assert_eq!(unusual_scans("np_reg", &[&standing], -1.0), None);
        let mut covered = trial(std::slice::from_ref(&(2..45)));
        covered.steps[20..30].iter_mut().for_each(|row| row.scan_log_density_nats = f64::NAN);
        let sentence = unusual_scans("np_reg", &[&covered], -1.0).unwrap();
        assert!(sentence.contains("up to 33 scans in a row, from scan 2 on"), "{sentence}");
    }
}
