use std::collections::BTreeMap;
use std::fmt::Write;

use locsim_gap::Verdict;
use serde::Serialize;

use super::library;
use super::plan::Group;
use super::score::{Score, Share, strength};

fn share(share: &Share) -> String {
    match (share.value, share.interval) {
        (Some(value), Some(interval)) => {
            format!("{value:.2} [{:.2}, {:.2}] ({} of {})", interval.lo, interval.hi, share.count, share.of)
        }
        _ => "-".to_owned(),
    }
}

fn number(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.2}"))
}

/// Four decimals, or three digits of what is too small for them.
fn digits(value: f64) -> String {
    if value != 0.0 && value.abs() < 0.01 { format!("{value:.2e}") } else { format!("{value:.4}") }
}

/// The suite's table, as Markdown: each figure beside what is excellent and what is good.
pub fn table(score: &Score) -> String {
    let mut rows: Vec<[String; 4]> = Vec::new();
    let mut row = |metric: String, value: String, excellent: &str, good: &str| {
        rows.push([metric, value, excellent.to_owned(), good.to_owned()]);
    };
    for (regime, alarms) in &score.false_alarm {
        row(
            format!("false alarms at 1 %, {}", regime.replace('_', " blocks, poses ")),
            share(alarms),
            "<= 0.02",
            "<= 0.04",
        );
    }
    for (lambda, forms) in &score.top1 {
        let (excellent, good) = match lambda.as_str() {
            "25" => ([".93", ".85"], [".85", ".70"]),
            "50" => ([".97", ".95"], [".90", ".85"]),
            _ => (["-", "-"], ["-", "-"]),
        };
        row(
            format!("first name right, lambda = {lambda}, same form"),
            share(&forms.same),
            excellent[0],
            good[0],
        );
        row(
            format!("first name right, lambda = {lambda}, other form"),
            share(&forms.other),
            excellent[1],
            good[1],
        );
    }
    for (lambda, (found, oracle)) in &score.found {
        row(
            format!("anything found, lambda = {lambda}, same form (oracle {oracle:.3})"),
            share(found),
            "-",
            "-",
        );
    }
    row(
        "truth within the reported set, where something is named".to_owned(),
        share(&score.in_set),
        ">= .98",
        ">= .93",
    );
    row("mean size of the set".to_owned(), number(score.set_size), "<= 1.3", "<= 2");
    row("95 % intervals cover the truth".to_owned(), share(&score.coverage), ".93 to .97", ".90 to .98");
    row("standard deviation over Cramer-Rao".to_owned(), number(score.sd_over_bound), "<= 1.15", "<= 1.5");
    row(
        "the same over strength / sqrt(lambda), objects, too".to_owned(),
        number(score.sd_over_strength),
        "-",
        "-",
    );
    row(
        "gap closed, mean lower bound, lambda = 100, same form".to_owned(),
        number(score.closed_lo.same),
        ">= .90",
        ">= .80",
    );
    row(
        "gap closed, mean lower bound, lambda = 100, other form".to_owned(),
        number(score.closed_lo.other),
        ">= .75",
        ">= .50",
    );
    row("two effects both named".to_owned(), share(&score.two_named), ">= .85", ">= .70");
    row("outside the library: flagged".to_owned(), share(&score.outside.flagged), ">= .90", ">= .75");
    row("outside the library: wrongly named".to_owned(), share(&score.outside.named), "<= .05", "<= .15");
    for [metric, value, excellent, good] in &yardstick(score) {
        row(metric.clone(), value.clone(), excellent, good);
    }
    row(
        "filter error caused by the effect, recovered".to_owned(),
        number(score.filter_recovered),
        ">= .80",
        ">= .50",
    );
    row(
        "time per log on one core [s] (asked for on two)".to_owned(),
        format!("{:.0}", score.seconds_per_log),
        "<= 60",
        "<= 600",
    );
    let mut text = "| metric | measured | excellent | good |\n| --- | --- | --- | --- |\n".to_owned();
    for [metric, value, excellent, good] in rows {
        let _ = writeln!(text, "| {metric} | {value} | {excellent} | {good} |");
    }
    text
}

/// Rows of the table: effects that have no name or another form, and whether the closed share is honest.
fn yardstick(score: &Score) -> Vec<[String; 4]> {
    let exact = &score.strong.exact;
    let row = |metric: &str, value: String, excellent: &str, good: &str| {
        [metric.to_owned(), value, excellent.to_owned(), good.to_owned()]
    };
    vec![
        row(
            "outside the library: the right covariate told",
            share(&score.outside.covariate),
            ">= .90",
            ">= .70",
        ),
        row("strong, same form: exactly the right name", share(&exact.same), ">= .97", ">= .90"),
        row("strong, other form: exactly the right name", share(&exact.other), ">= .90", ">= .75"),
        row("time per strong log [s]", number(score.strong.seconds_per_log), "<= 30", "<= 60"),
        row("nine tenths closed, though ranges are open", share(&score.overstated), "0", "0"),
    ]
}

/// The whole report: table, how good directions and numbers are, filters, confusion matrix, every log.
pub fn report(score: &Score) -> String {
    format!(
        "# Hidden-effect suite\n\n{} of {} logs, {} simulated logs behind each p-value, seed {}. Shares with 95 % intervals \
         (Clopper and Pearson).\n\n{}\n{}{}{}{}{}{}",
        score.runs,
        score.planned,
        score.replicates,
        score.seed,
        table(score),
        setups(score),
        directions(score),
        numbers(score),
        filters(score),
        confusion(score),
        every_log(score),
    )
}

/// Each setup by itself.
fn setups(score: &Score) -> String {
    let mut text = "## Lasers and scenarios\n\nStrong effects with exactly the right name, effects from outside of the library with the right \
                    covariate, alarms in logs with nothing hidden, and time per strong log.\n\n| setup | strong, same form | strong, other form \
                    | outside: covariate | outside: wrongly named | false alarms | s |\n| --- | --- | --- | --- | --- | --- | --- |\n"
        .to_owned();
    for (setup, of) in &score.setups {
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {} | {} | {} |",
            setup.name(),
            share(&of.strong.exact.same),
            share(&of.strong.exact.other),
            share(&of.outside.covariate),
            share(&of.outside.named),
            share(&of.false_alarm),
            number(of.strong.seconds_per_log),
        );
    }
    text.push('\n');
    text
}

/// How far logs are off in the direction of what is hidden, for what the best test has there.
fn directions(score: &Score) -> String {
    let mut efficiency: BTreeMap<&str, [Vec<f64>; 2]> = BTreeMap::new();
    for (truth, found) in &score.all {
        let form = match truth.group {
            Group::Same => 0,
            Group::Other => 1,
            _ => continue,
        };
        if let Some(z) = found.directions.get(&truth.effects[0]) {
            efficiency.entry(&truth.effects[0]).or_default()[form].push(z.abs() / truth.lambda.sqrt());
        }
    }
    let mut text = "## Directions\n\nThat of an effect's own statistics which says most, in standard deviations of simulated logs, over \
                    sqrt(lambda): 1 is what the best test has, or more, where it is the most of several. Means, and numbers of \
                    logs.\n\n| effect | same form | other form |\n| --- | --- | --- |\n"
        .to_owned();
    let cell = |ratios: &Vec<f64>| match ratios.len() {
        0 => "-".to_owned(),
        n => format!("{:.2} ({n})", ratios.iter().sum::<f64>() / n as f64),
    };
    for (name, [same, other]) in efficiency {
        let _ = writeln!(text, "| {name} | {} | {} |", cell(&same), cell(&other));
    }
    text.push('\n');
    text
}

/// The strengths of effects in the library's form that were named, beside the true ones.
fn numbers(score: &Score) -> String {
    let mut text = "## Numbers\n\nStrengths of rightly named effects in the library's form; errors in units of the least \
                    possible one about the true strength, which is the bound of Cramer and Rao where that exists (error of Pitman's \
                    estimate, the mean of the likelihood, in simulated logs).\n\n| effect | lambda | true | found | bound | error / bound | covered |\n| --- | --- \
                    | --- | --- | --- | --- | --- |\n"
        .to_owned();
    for (truth, found) in &score.all {
        if truth.group != Group::Same || found.effects.first() != truth.effects.first() {
            continue;
        }
        let Some((value, [estimate, lo, hi])) = strength(truth, found) else { continue };
        let [bound, error] = match truth.least_error {
            Some(bound) => [digits(bound), format!("{:.1}", (estimate - value) / bound)],
            None => ["-", "-"].map(str::to_owned),
        };
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} [{}, {}] | {bound} | {error} | {} |",
            truth.effects[0],
            truth.lambda,
            digits(value),
            digits(estimate),
            digits(lo),
            digits(hi),
            if (lo..=hi).contains(&value) { "yes" } else { "no" },
        );
    }
    text.push('\n');
    text
}

/// Position errors of filters on logs with an effect that misleads them.
fn filters(score: &Score) -> String {
    let mut text = "## Filters\n\nPosition error of a filter (root mean square) whose models know the nominal simulator, the one \
                    with the named effects, and the one with the hidden effect.\n\n| effect | named | before [m] | with the named \
                    effects [m] | with the hidden effect [m] |\n| --- | --- | --- | --- | --- |\n"
        .to_owned();
    for (truth, found) in &score.all {
        if let Some(filter) = &found.filter {
            let _ = writeln!(
                text,
                "| {} | {} | {:.4} | {:.4} | {:.4} |",
                truth.effects.join(", "),
                found.effects.join(", "),
                filter.before_m,
                filter.after_m,
                filter.with_truth_m,
            );
        }
    }
    text.push('\n');
    text
}

/// Hidden effects against named ones.
fn confusion(score: &Score) -> String {
    let mut text = "## Confusion\n\nRows: what was hidden (one effect; same form and others together). Columns: the first name given. Numbers \
             of logs.\n\n"
        .to_owned();
    let mut matrix: BTreeMap<&str, BTreeMap<&str, u32>> = BTreeMap::new();
    for (truth, found) in &score.all {
        if matches!(truth.group, Group::Same | Group::Other) {
            let given = match (found.effects.first(), found.verdict) {
                (Some(name), _) => name.as_str(),
                (None, Verdict::Unexplained | Verdict::Unnamed) => "unexplained",
                _ => "nothing",
            };
            *matrix.entry(&truth.effects[0]).or_default().entry(given).or_default() += 1;
        }
    }
    let order = library();
    text += "| hidden | right | others |\n| --- | --- | --- |\n";
    for name in order {
        let Some(row) = matrix.get(name) else { continue };
        let total: u32 = row.values().sum();
        let right = row.get(name).copied().unwrap_or(0);
        let others: Vec<String> = row
            .iter()
            .filter(|(given, _)| **given != name)
            .map(|(given, n)| format!("{given} {n}"))
            .collect();
        let _ = writeln!(text, "| {name} | {right} of {total} | {} |", others.join(", "));
    }
    let worst = matrix
        .iter()
        .map(|(name, row)| {
            let total: u32 = row.values().sum();
            (*name, f64::from(row.get(name).copied().unwrap_or(0)) / f64::from(total))
        })
        .min_by(|a, b| a.1.total_cmp(&b.1));
    if let Some((name, share)) = worst {
        let _ = writeln!(
            text,
            "\nThe worst effect is `{name}`: named first in {:.0} % of its logs.",
            100.0 * share
        );
    }
    text.push('\n');
    text
}

/// A variant as files write it.
fn word(variant: impl Serialize) -> String {
    serde_json::to_value(variant).ok().and_then(|word| word.as_str().map(str::to_owned)).unwrap_or_default()
}

/// One row for each log.
fn every_log(score: &Score) -> String {
    let mut text = "## Every log\n\n| group | setup | regime | lambda | hidden | verdict | named | without a name | p | p after | gained | closed | W1 (floor) [mm] | s |\n\
                    | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n"
        .to_owned();
    for (truth, found) in &score.all {
        let hidden: Vec<String> = truth
            .effects
            .iter()
            .enumerate()
            .map(|(i, name)| match (truth.strength.get(i), truth.values.get(i)) {
                (Some(strength), Some(values)) => format!("{name} {strength} {}", digits(values[strength])),
                _ => name.clone(),
            })
            .collect();
        let named: Vec<String> = found.candidates.iter().map(|set| set.join("/")).collect();
        let told = found.unnamed.iter().map(|unnamed| match &unnamed.form_of {
            Some(name) => format!("form of {name}: {} over {}", unnamed.deviation, unnamed.covariate),
            None => format!("{} over {}", unnamed.deviation, unnamed.covariate),
        });
        let told: Vec<String> = told.collect();
        let closed = found
            .closed
            .map_or_else(|| "-".to_owned(), |[value, lo, hi]| format!("{value:.2} [{lo:.2}, {hi:.2}]"));
        let [before, after, floor] = found.w1_mm;
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {} | {} | {} | {} | {:.3} | {:.3} | {:.2} | {closed} | {before:.1} -> {after:.1} ({floor:.1}) | {:.0} |",
            word(truth.group),
            truth.setup.name(),
            truth.regime,
            truth.lambda,
            hidden.join(", "),
            word(found.verdict),
            named.join(", "),
            told.join(", "),
            found.p,
            found.p_after,
            found.gained[0],
            found.seconds,
        );
    }
    text
}
