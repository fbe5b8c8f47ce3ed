use std::collections::BTreeMap;

use locsim_gap::Verdict;
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, Normal};

use super::plan::Group;
use super::{FoundFile, Setup, TruthFile};
use locsim_core::Interval;
use locsim_report::statistics::share_interval;

/// A share with its 95 % interval (Clopper and Pearson).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Share {
    /// Share; `None` of no logs.
    pub value: Option<f64>,
    /// How many.
    pub count: u32,
    /// Of how many.
    pub of: u32,
    /// Its interval.
    pub interval: Option<Interval>,
}

impl Share {
    pub(crate) fn of(hits: impl Iterator<Item = bool>) -> Self {
        let (mut count, mut of) = (0, 0);
        for hit in hits {
            count += u32::from(hit);
            of += 1;
        }
        let value = (of > 0).then(|| f64::from(count) / f64::from(of));
        Self { value, count, of, interval: (of > 0).then(|| share_interval(count, of)) }
    }
}

/// The same form and another one.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Forms<T> {
    /// The library's own form.
    pub same: T,
    /// Another form.
    pub other: T,
}

/// Effects outside of the library.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OutsideScore {
    /// Found, and not explained away: `unnamed`, `unexplained` or `partly_explained`.
    pub flagged: Share,
    /// A name of the library is given as the whole explanation.
    pub named: Share,
    /// Share of the effects from outside the library whose covariate is named.
    pub covariate: Share,
}

/// Strong effects of the library.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StrongScore {
    /// Share of logs in which it is named, and no other effect.
    pub exact: Forms<Share>,
    /// Mean time per log \[s\].
    pub seconds_per_log: Option<f64>,
}

/// Logs of one setup.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SetupScore {
    /// Share of logs without an effect in which something was found.
    pub false_alarm: Share,
    /// Effects outside of the library.
    pub outside: OutsideScore,
    /// Strong effects.
    pub strong: StrongScore,
}

impl SetupScore {
    fn of(all: &[&(TruthFile, FoundFile)]) -> Self {
        let nothing = all.iter().filter(|(truth, _)| truth.group == Group::Null);
        Self {
            false_alarm: Share::of(nothing.map(|(_, found)| is_found(found))),
            outside: OutsideScore::of(all),
            strong: StrongScore::of(all),
        }
    }
}

impl OutsideScore {
    fn of(all: &[&(TruthFile, FoundFile)]) -> Self {
        let outside =
            || all.iter().filter(|(truth, _)| matches!(truth.group, Group::Outside | Group::Removed));
        let of =
            |verdicts: &[Verdict]| Share::of(outside().map(|(_, found)| verdicts.contains(&found.verdict)));
        let unknown = all.iter().filter(|(truth, _)| truth.group == Group::Outside);
        Self {
            flagged: of(&[Verdict::Unnamed, Verdict::Unexplained, Verdict::PartlyExplained]),
            named: of(&[Verdict::Named, Verdict::Ambiguous]),
            covariate: Share::of(unknown.map(|(truth, found)| {
                found.unnamed.first().is_some_and(|first| truth.covariates.contains(&first.covariate))
            })),
        }
    }
}

impl StrongScore {
    fn of(all: &[&(TruthFile, FoundFile)]) -> Self {
        let of = |group: Group| all.iter().filter(move |(truth, _)| truth.group == group);
        let exact = |group| Share::of(of(group).map(|(truth, found)| found.effects == truth.effects));
        let both = of(Group::Strong).chain(of(Group::StrongOther));
        Self {
            exact: Forms { same: exact(Group::Strong), other: exact(Group::StrongOther) },
            seconds_per_log: mean(both.map(|(_, found)| found.seconds)),
        }
    }
}

/// All figures of the suite.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Score {
    /// Each setup by itself, the scenario's own among them. Figures of effects of information 25 to 100 and of alarms by regime are of
    /// the scenario's own setup; the others here are of all.
    pub setups: BTreeMap<Setup, SetupScore>,
    /// Share of logs without an effect in which something was found, by regime.
    pub false_alarm: BTreeMap<String, Share>,
    /// Share of logs whose first name is right, by information.
    pub top1: BTreeMap<String, Forms<Share>>,
    /// Share of logs in which anything was found, by information, with the oracle's power.
    pub found: BTreeMap<String, (Share, f64)>,
    /// Share of named logs whose truth is in the reported set.
    pub in_set: Share,
    /// Mean size of the set.
    pub set_size: Option<f64>,
    /// Share of 95 % intervals of strengths that cover the truth, of right names in the library's form.
    pub coverage: Share,
    /// Error of strengths (root of the mean square) over [`Strength::least_error`](locsim_gap::Strength::least_error), the bound of
    /// Cramer and Rao where that exists, of right names in the library's form.
    pub sd_over_bound: Option<f64>,
    /// The same over strength / sqrt(lambda), the bound of a shift.
    pub sd_over_strength: Option<f64>,
    /// Mean lower bound of the closed share at the greatest information; of the gained one where ranges can't say.
    pub closed_lo: Forms<Option<f64>>,
    /// Share of pairs both of whose effects were named.
    pub two_named: Share,
    /// Effects outside of the library, and those whose stage was taken out.
    pub outside: OutsideScore,
    /// Strong effects.
    pub strong: StrongScore,
    /// Share of all logs of which nine tenths of the gap or more count as closed although the Wasserstein distance fell by
    /// less than half of what is above its floor.
    pub overstated: Share,
    /// The filter's error that the effect caused and that went away, where it was measured.
    pub filter_recovered: Option<f64>,
    /// Mean time per log \[s\].
    pub seconds_per_log: f64,
    /// Number of logs.
    pub runs: usize,
    /// Number of logs that the suite has at this size.
    pub planned: usize,
    /// Simulated logs behind each p-value.
    pub replicates: u32,
    /// Everything random derives from it.
    pub seed: u64,
    /// Every log.
    #[serde(skip)]
    pub all: Vec<(TruthFile, FoundFile)>,
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let values: Vec<f64> = values.collect();
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// An effect that costs a filter less than this isn't harmful \[m\].
const LEAST_HARM_M: f64 = 0.002;

fn is_found(found: &FoundFile) -> bool {
    !matches!(found.verdict, Verdict::None | Verdict::Underpowered)
}

/// Whether a gap counts as closed whose ranges came less than half of the way.
fn is_overstated(found: &FoundFile) -> bool {
    let [before, after, floor] = found.w1_mm;
    found.closed.is_some_and(|[share, ..]| share >= 0.9) && before - after < 0.5 * (before - floor)
}

/// The first effect's strength, and what was found of it with its interval.
pub(super) fn strength(truth: &TruthFile, found: &FoundFile) -> Option<(f64, [f64; 3])> {
    let name = truth.strength.first()?;
    Some((*truth.values.first()?.get(name)?, *found.numbers.first()?.get(name)?))
}

impl Score {
    pub(super) fn new(all: Vec<(TruthFile, FoundFile)>, planned: usize, replicates: u32, seed: u64) -> Self {
        let of = |group: Group| all.iter().filter(move |(truth, _)| truth.group == group);
        let first_is_right =
            |(truth, found): &(TruthFile, FoundFile)| found.effects.first() == truth.effects.first();
        let every: Vec<&(TruthFile, FoundFile)> = all.iter().collect();
        let mut setups: Vec<Setup> = all.iter().map(|(truth, _)| truth.setup).collect();
        setups.sort();
        setups.dedup();
        let of_setup = |setup: Setup| {
            let logs: Vec<_> = every.iter().filter(|(truth, _)| truth.setup == setup).copied().collect();
            (setup, SetupScore::of(&logs))
        };
        let setups = setups.into_iter().map(of_setup).collect();
        let nothing = || of(Group::Null).filter(|(truth, _)| truth.setup == Setup::Scenario);
        let mut regimes: Vec<String> = nothing().map(|(truth, _)| truth.regime.clone()).collect();
        regimes.sort();
        regimes.dedup();
        let false_alarm = regimes
            .into_iter()
            .map(|regime| {
                let share = Share::of(
                    nothing().filter(|(truth, _)| truth.regime == regime).map(|(_, found)| is_found(found)),
                );
                (regime, share)
            })
            .collect();
        let single = || all.iter().filter(|(truth, _)| matches!(truth.group, Group::Same | Group::Other));
        let mut lambdas: Vec<f64> = single().map(|(truth, _)| truth.lambda).collect();
        lambdas.sort_by(f64::total_cmp);
        lambdas.dedup();
        let at = |lambda: f64, group: Group| of(group).filter(move |(truth, _)| truth.lambda == lambda);
        let top1 = lambdas
            .iter()
            .map(|&lambda| {
                let share = |group| Share::of(at(lambda, group).map(first_is_right));
                (lambda.to_string(), Forms { same: share(Group::Same), other: share(Group::Other) })
            })
            .collect();
        let found = lambdas
            .iter()
            .map(|&lambda| {
                let share = Share::of(at(lambda, Group::Same).map(|(_, found)| is_found(found)));
                (lambda.to_string(), (share, oracle_power(lambda, 0.01)))
            })
            .collect();
        let named = || single().filter(|(_, found)| !found.effects.is_empty());
        let in_set = Share::of(named().map(|(truth, found)| found.candidates[0].contains(&truth.effects[0])));
        let set_size = mean(named().map(|(_, found)| found.candidates[0].len() as f64));
        let right = || of(Group::Same).filter(|run| first_is_right(run));
        let coverage = Share::of(
            right()
                .filter_map(|(truth, found)| strength(truth, found))
                .map(|(value, [_, lo, hi])| (lo..=hi).contains(&value)),
        );
        let squares = right().filter_map(|(truth, found)| {
            let (value, [estimate, ..]) = strength(truth, found)?;
            Some(((estimate - value) / truth.least_error?).powi(2))
        });
        let sd_over_bound = mean(squares).map(f64::sqrt);
        let of_strength = right().filter_map(|(truth, found)| {
            let (value, [estimate, ..]) = strength(truth, found)?;
            Some((estimate / value - 1.0).powi(2) * truth.lambda)
        });
        let sd_over_strength = mean(of_strength).map(f64::sqrt);
        let strongest = lambdas.last().copied().unwrap_or(0.0);
        let closed = |group: Group| {
            mean(at(strongest, group).map(|(_, found)| found.closed.unwrap_or(found.gained)[1]))
        };
        let two_named = Share::of(
            of(Group::Pair)
                .map(|(truth, found)| truth.effects.iter().all(|name| found.effects.contains(name))),
        );
        Self {
            setups,
            false_alarm,
            top1,
            found,
            in_set,
            set_size,
            coverage,
            sd_over_bound,
            sd_over_strength,
            closed_lo: Forms { same: closed(Group::Same), other: closed(Group::Other) },
            two_named,
            outside: OutsideScore::of(&every),
            strong: StrongScore::of(&every),
            overstated: Share::of(all.iter().map(|(_, found)| is_overstated(found))),
            filter_recovered: mean(all.iter().filter_map(|(_, found)| {
                let filter = found.filter?;
                let caused = filter.before_m - filter.with_truth_m;
                // Only an influence that exists can be removed.
                (caused > LEAST_HARM_M).then(|| (filter.before_m - filter.after_m) / caused)
            })),
            seconds_per_log: mean(all.iter().map(|(_, found)| found.seconds)).unwrap_or(0.0),
            runs: all.len(),
            planned,
            replicates,
            seed,
            all,
        }
    }
}

/// Power of the best test at a false-alarm rate, for an effect of this information.
fn oracle_power(lambda: f64, false_alarm: f64) -> f64 {
    let Ok(normal) = Normal::new(0.0, 1.0) else { return 0.0 };
    normal.cdf(lambda.max(0.0).sqrt() - normal.inverse_cdf(1.0 - false_alarm))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 3.61 standard deviations are 1.28, the 90 % quantile, beyond 2.33, the 99 % quantile.
    #[test]
    fn the_best_test_finds_an_information_of_13_in_nine_of_ten_logs() {
        assert!((oracle_power(13.03, 0.01) - 0.9).abs() < 0.003);
        assert!((oracle_power(0.0, 0.01) - 0.01).abs() < 1e-9);
    }
}
