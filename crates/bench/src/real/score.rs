//! How often edits are named.

use std::collections::BTreeMap;
use std::fmt::Write;

use locsim_report::text::{TextTable, fixed};
use serde::Serialize;

use super::{Case, EDITS, Edit, Found};
use crate::suite::Share;

/// All figures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RealScore {
    /// Share of edited logs whose edit is named first.
    pub named_first: Share,
    /// The same by edit, and by log.
    pub by_edit: BTreeMap<Edit, Share>,
    /// By log.
    pub by_log: BTreeMap<String, Share>,
    /// Share of logs that weren't edited in which something is named, by log and in all.
    pub false_alarm: Share,
    /// Share of 95 % intervals that hold the true strength, of edits that are named first.
    pub covered: Share,
    /// Median of Wasserstein-1 after over before, and the largest, of edits that are named first and whose ranges differ by more than twice what
    /// stretches of the logs do.
    pub w1_ratio: Option<[f64; 2]>,
    /// Share of edits that are named first, whatever the ranges differ by, with which these are farther off.
    pub farther: Share,
    /// Number of searches, and of those planned.
    pub runs: usize,
    /// Planned searches.
    pub planned: usize,
    /// Everything random derives from it.
    pub seed: u64,
    /// Permutations behind each p-value.
    pub permutations: u32,
    /// Every search.
    #[serde(skip)]
    pub all: Vec<(Case, Found)>,
}

fn is_named_first(found: &Found) -> bool {
    let effect = found.truth.as_ref().and_then(|truth| truth.effect.as_ref());
    effect.is_some() && found.effects.first() == effect
}

impl RealScore {
    pub(super) fn new(all: Vec<(Case, Found)>, planned: usize, seed: u64, permutations: u32) -> Self {
        let edited: Vec<&(Case, Found)> =
            all.iter().filter(|(case, found)| case.edit != Edit::None && found.truth.is_some()).collect();
        let of = |is_of: &dyn Fn(&Case) -> bool| {
            Share::of(edited.iter().filter(|(case, _)| is_of(case)).map(|(_, found)| is_named_first(found)))
        };
        let edits: Vec<Edit> =
            EDITS.into_iter().filter(|edit| edited.iter().any(|(case, _)| case.edit == *edit)).collect();
        let mut logs: Vec<String> = all.iter().map(|(case, _)| case.log.clone()).collect();
        logs.dedup();
        let right: Vec<&Found> =
            edited.iter().map(|(_, found)| found).filter(|found| is_named_first(found)).collect();
        let covered = right.iter().filter_map(|found| {
            let (_, truth) = found.truth.as_ref()?.strength.as_ref()?;
            let [_, lo, hi] = found.strength?;
            Some((lo..=hi).contains(truth))
        });
        let mut ratios: Vec<f64> = right
            .iter()
            .filter(|found| found.w1_mm[0] > 2.0 * found.w1_mm[2])
            .map(|found| found.w1_mm[1] / found.w1_mm[0])
            .collect();
        ratios.sort_by(f64::total_cmp);
        let farther = Share::of(right.iter().map(|found| found.w1_mm[1] > found.w1_mm[0]));
        Self {
            farther,
            named_first: of(&|_| true),
            by_edit: edits.into_iter().map(|edit| (edit, of(&|case| case.edit == edit))).collect(),
            by_log: logs.into_iter().map(|log| (log.clone(), of(&|case| case.log == log))).collect(),
            false_alarm: Share::of(
                all.iter()
                    .filter(|(case, _)| case.edit == Edit::None)
                    .map(|(_, found)| !found.effects.is_empty()),
            ),
            covered: Share::of(covered),
            w1_ratio: ratios.last().map(|most| [ratios[ratios.len() / 2], *most]),
            runs: all.len(),
            planned,
            seed,
            permutations,
            all,
        }
    }
}

fn share(share: &Share) -> String {
    match (share.value, share.interval) {
        (Some(value), Some(interval)) => {
            format!("{value:.2} [{:.2}, {:.2}], {} of {}", interval.lo, interval.hi, share.count, share.of)
        }
        _ => "-".to_owned(),
    }
}

/// The figures as a table.
pub fn table(score: &RealScore) -> String {
    let mut rows = vec![
        ["edit named first".to_owned(), share(&score.named_first), ">= .80".to_owned()],
        ["any name, nothing edited".to_owned(), share(&score.false_alarm), "<= .05".to_owned()],
        ["95 % intervals cover".to_owned(), share(&score.covered), String::new()],
    ];
    if let Some([median, most]) = score.w1_ratio {
        rows.push([
            "W1 after / before where it is above twice the floor, named first: median and most".to_owned(),
            format!("{median:.2}, {most:.2}"),
            "<= 0.5, never above 1".to_owned(),
        ]);
    }
    rows.push(["named first, and ranges farther off".to_owned(), share(&score.farther), "0".to_owned()]);
    let by = score.by_edit.iter().map(|(edit, of)| (word(*edit), of));
    let by_log = score.by_log.iter().map(|(log, of)| (log.clone(), of));
    rows.extend(by.chain(by_log).map(|(name, of)| [format!("  {name}"), share(of), String::new()]));
    TextTable::new(["", "share", "target"], rows).to_markdown()
}

fn word(edit: Edit) -> String {
    serde_json::to_value(edit).ok().and_then(|word| word.as_str().map(str::to_owned)).unwrap_or_default()
}

/// The whole report: table, every search.
pub(super) fn report(score: &RealScore) -> String {
    let mut text = format!(
        "# Measured logs with known edits\n\n{} of {} searches, {} permutations behind each p-value, seed {}. Shares with 95 % \
         intervals (Clopper and Pearson).\n\n{}\n## Every search\n\n| log | cut | edit | verdict | named | true | found | p | shared | W1 \
         before, after, floor [mm] | s |\n| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n",
        score.runs,
        score.planned,
        score.permutations,
        score.seed,
        table(score),
    );
    for (case, found) in &score.all {
        let strength = found.truth.as_ref().and_then(|truth| truth.strength.as_ref());
        let truth = strength.map_or_else(|| "-".to_owned(), |(name, value)| format!("{name} {value:.3}"));
        let number = |[value, lo, hi]: [f64; 3]| format!("{value:.3} [{lo:.3}, {hi:.3}]");
        let cut = serde_json::to_value(case.cut).ok();
        let cut = cut.as_ref().and_then(|cut| cut.as_str()).unwrap_or_default();
        let verdict = if found.truth.is_none() { "no room" } else { &found.verdict };
        let [before, after, floor] = found.w1_mm.map(|distance| fixed(distance, 1));
        let _ = writeln!(
            text,
            "| {} | {cut} | {} | {verdict} | {} | {truth} | {} | {:.3} | {:.2} | {before}, {after}, {floor} | {:.0} |",
            case.log,
            word(case.edit),
            found.effects.join(", "),
            found.strength.map_or_else(|| "-".to_owned(), number),
            found.p,
            found.shared,
            found.seconds,
        );
    }
    text
}
