//! The findings in a few sentences: angles in degrees, numbers with their significant digits.

use locsim_core::{Estimate, Interval};
use locsim_gap::{
    Covariate, Deviation, Direction, Gap, Named, Outcome, PoseError, Region, ResidualStage, Verdict,
};
use locsim_world::effect::{Parameter, Site};

use super::covariate::span;
use super::{map_error, unnamed};
use locsim_report::text::fixed;
use locsim_scenario::effect::{in_file, unit};

/// The short answer: the verdict, what is named and how sure that is, how much of the gap it closes, what it does to a
/// filter.
pub fn answer(outcome: &Outcome) -> String {
    sentences(outcome).join("\n")
}

/// Dependences without a name in the answer; gap.json has all.
const SHOWN_UNNAMED: usize = 3;

pub(super) fn sentences(outcome: &Outcome) -> Vec<String> {
    let mut text: Vec<String> = outcome.effects.iter().map(told).collect();
    text.extend(outcome.effects.iter().filter_map(|named| doubt(named, &outcome.effects)));
    text.extend(outcome.unnamed.iter().filter_map(unnamed::form_sentence));
    let without_name = outcome.unnamed.iter().filter(|found| found.form_of.is_none());
    text.extend(without_name.take(SHOWN_UNNAMED).map(unnamed::sentence));
    let p = p_value(outcome.detection.p);
    match outcome.verdict {
        Verdict::None => text.push(match large_reference_error(outcome) {
            None => format!("Nothing is off: the log looks like the scenario's simulations (p = {p})."),
            Some(error) => format!(
                "Nothing is off beside the reference poses, which err by {error}, as fitted: the log looks like simulations with such a \
                 reference (p = {p}). A laser that was knocked on the way looks the same."
            ),
        }),
        Verdict::Underpowered => text.push(format!(
            "Nothing was found (p = {p}), but most effects of a typical strength would not have been found in this log \
             either: {}. More scans, or a path with more variety, would show them.",
            blind(outcome).join(", ")
        )),
        Verdict::Unnamed if outcome.unnamed.first().is_some_and(unnamed::is_of_frame) => text.push(format!(
            "No effect of the library does that (p = {p}): the log is more likely with its poses turned and shifted, three \
             numbers that were fitted to all of it, than with any effect.",
        )),
        Verdict::Unnamed => text.push(format!(
            "No effect of the library does that (p = {p}): it is what a free model of the readings finds on stretches of \
             the drive that it wasn't fitted to.",
        )),
        Verdict::Unexplained if let Some(direction) = only_of_odometry(outcome) => text.push(format!(
            "The odometry is off (p = {p}), as by `{}` ({:.1} standard deviations of simulated logs), but not as steadily as a name \
             needs: wheels whose errors come and go do that. Of the readings nothing stands out as much.",
            direction.name,
            direction.z.abs()
        )),
        Verdict::Unexplained => text.push(format!(
            "Something is off (p = {p}), and no effect of the library explains it{}.",
            worst(&outcome.regions, false)
        )),
        Verdict::PartlyExplained if outcome.gap.is_open_in_ranges() => text.push(format!(
            "That is not all: the simulated ranges are still far from the measured ones{}.",
            what_is_left(outcome)
        )),
        Verdict::PartlyExplained => text.push(format!(
            "That is not all: something else is still off (p = {}){}.",
            p_value(outcome.detection_after.p),
            what_is_left(outcome)
        )),
        Verdict::Named | Verdict::Ambiguous => {}
    }
    if !outcome.effects.is_empty() {
        text.push(gap(outcome));
    }
    text.extend(outcome.map.iter().flat_map(map_error::sentences));
    text.extend(outcome.residual.as_ref().map(|stage| residual(stage, outcome.gap.floor.w1_mm)));
    text.extend(filter(outcome));
    text
}

/// The farthest direction of the odometry, where directions of the odometry are off, no others, and the PIT isn't.
pub(super) fn only_of_odometry(outcome: &Outcome) -> Option<&Direction> {
    let are_readings_usual = outcome.detection.p_omnibus > super::false_alarm(outcome.detection.replicates);
    farthest_of_odometry(&outcome.directions, outcome.threshold).filter(|_| are_readings_usual)
}

fn farthest_of_odometry(directions: &[Direction], threshold: f64) -> Option<&Direction> {
    let off = || directions.iter().filter(|direction| direction.z.abs() > threshold);
    let farthest = off().max_by(|a, b| a.z.abs().total_cmp(&b.z.abs()))?;
    off().all(|direction| direction.name.site() == Site::Odometry).then_some(farthest)
}

/// Where readings are farthest off, unless a sentence has told what is left: regions are of the log before anything was named.
fn what_is_left(outcome: &Outcome) -> String {
    if outcome.unnamed.is_empty() { worst(&outcome.regions, true) } else { String::new() }
}

/// An effect with its numbers: "Far surfaces often send nothing back: `range_dropout`, p = 0.42 [0.38, 0.46]."
pub(super) fn told(named: &Named) -> String {
    let sentence = named.effect.sentence().trim_end_matches('.');
    let place: Vec<String> = named
        .place
        .iter()
        .map(|[a, b]| format!(" between ({:.2}, {:.2}) and ({:.2}, {:.2}) m", a[0], a[1], b[0], b[1]))
        .collect();
    format!("{sentence}: {}{}, {}.", named.name, place.join(" and"), numbers(named).join(", "))
}

/// The numbers of an effect with their intervals.
pub(super) fn numbers(named: &Named) -> Vec<String> {
    let number = |parameter: &Parameter| {
        let number = named.params.get(parameter.name)?;
        let estimate = number.estimate.map(|value| in_file(parameter, value));
        let unit = unit(parameter).map(|unit| format!(" {unit}")).unwrap_or_default();
        Some(format!("{} = {}{unit}", label(parameter), with_interval(&estimate)))
    };
    named.name.parameters().iter().filter_map(number).collect()
}

/// The name of a parameter without its unit.
pub(super) fn label(parameter: &Parameter) -> String {
    let mut name = parameter.key;
    for suffix in ["_per_m", "_m", "_deg", "_secs"] {
        name = name.strip_suffix(suffix).unwrap_or(name);
    }
    name.replace('_', " ")
}

/// The rivals of an effect that have no name themselves, and the motion that would distinguish them.
pub(super) fn doubt(named: &Named, all: &[Named]) -> Option<String> {
    let is_named = |other: &&str| all.iter().any(|named| named.name.name() == *other);
    let others: Vec<_> = others(named).filter(|other| !is_named(other)).collect();
    if others.is_empty() {
        return None;
    }
    let split = named.split_by.map(|split| format!(" To tell: {split}.")).unwrap_or_default();
    Some(format!("Instead of {} it may as well be {}.{split}", named.name, others.join(" or ")))
}

/// Names of the candidates beside the one that is named.
pub(super) fn others(named: &Named) -> impl Iterator<Item = &'static str> {
    named.candidates.iter().filter(|other| **other != named.name).map(|other| other.name())
}

/// How far the gap closes. Its two ends are what all effects gain on held-out scans, and what is left to gain.
fn gap(outcome: &Outcome) -> String {
    let gap = &outcome.gap;
    format!(
        "Held-out gap {:.2} -> {:.2} nats per scan: {}. Range errors {:.1} -> {:.1} mm from the simulation's, floor \
         {:.1} mm.{}",
        gap.gained_nats_per_scan + gap.remaining_nats_per_scan,
        gap.remaining_nats_per_scan,
        closed(gap),
        gap.before.w1_mm,
        gap.after.w1_mm,
        gap.floor.w1_mm,
        disagreement(outcome)
    )
}

/// An explanation where log score and ranges disagree, with a leading blank; empty where they agree.
pub(super) fn disagreement(outcome: &Outcome) -> String {
    let gap = &outcome.gap;
    let share = gap.gained_share.value;
    let percent = fixed(100.0 * share, 0);
    match gap.closed_in_ranges {
        None if gap.before.w1_mm.max(gap.after.w1_mm) > gap.w1_visible_mm => {
            " What is named is in the odometry and moves no ranges.".to_owned()
        }
        None => format!(
            " Ranges as a whole can't say whether this gap has closed: up to {} mm is what two simulations of this drive \
             differ by, and they are below that before and after.",
            fixed(gap.w1_visible_mm, 1)
        ),
        Some(ranges) if ranges >= share => String::new(),
        Some(ranges) if ranges <= 0.0 => format!(
            " The two disagree, and the gap counts as open: the log score gains {percent} % of what can be gained, but \
             the simulated ranges are no nearer to the measured ones. {}",
            if outcome.effects.iter().any(|named| named.name.lets_beams_through()) {
                "Where the map has nothing behind a wall that lets beams through, simulated ones end anywhere: ranges \
                 come nearer once the map has what stands there."
            } else {
                "Something else is missing, or the effect has another form."
            }
        ),
        Some(ranges) => format!(
            " The smaller share counts: the log score gains {percent} % of what can be gained, the simulated ranges \
             came {} % of the way to the measured ones.",
            fixed(100.0 * ranges, 0)
        ),
    }
}

/// "94 % closed [91, 97]"; "94 % gained [91, 97]" where the log score alone can tell; "not closed, 30 % [20, 40]" where the
/// simulated ranges came less than half of the way.
pub(super) fn closed(gap: &Gap) -> String {
    let percent = |Estimate { value, interval: Interval { lo, hi } }| {
        let [value, lo, hi] = [value, lo, hi].map(|share: f64| fixed(100.0 * share, 0));
        [format!("{value} %"), format!("[{lo}, {hi}]")]
    };
    match gap.closed.map(percent) {
        None => percent(gap.gained_share).join(" gained "),
        Some(closed) if gap.is_open_in_ranges() => format!("not closed, {}", closed.join(" ")),
        Some(closed) => closed.join(" closed "),
    }
}

/// Curves hardly help where ranges come less than this share of the way to their floor.
const HARDLY: f64 = 0.1;

/// What the curves without a name do as a part of the simulator.
fn residual(stage: &ResidualStage, floor_mm: f64) -> String {
    let change = format!(
        "range errors {:.1} -> {:.1} mm on stretches that they weren't learnt from, floor {floor_mm:.1} mm",
        stage.w1_without_mm, stage.w1_mm
    );
    if stage.is_nearer() {
        let share = (stage.w1_without_mm - stage.w1_mm) / (stage.w1_without_mm - floor_mm);
        let hardly = if share < HARDLY { "hardly " } else { "" };
        format!(
            "As a part of the simulation, learnt and without a cause, the curves {hardly}help: {change}. scenario.yaml has them."
        )
    } else {
        format!("As a part of the simulation the curves don't help: {change}. scenario.yaml leaves them out.")
    }
}

fn filter(outcome: &Outcome) -> Option<String> {
    let filter = outcome.filter.as_ref()?;
    let [before, after] = [filter.before, filter.after].map(|side| side.position_rmse_m);
    Some(format!(
        "Filter error {} -> {} m (position RMSE on the log): {}.",
        with_interval(&before),
        with_interval(&after),
        change_in_words(&filter.change_m)
    ))
}

/// A paired change of an error in metres: "-0.012 [-0.015, -0.009] m"; "no difference (...)" where its interval holds 0.
pub(super) fn change_in_words(change: &Estimate) -> String {
    let numbers = format!("{} m", with_interval(change));
    if change.interval.contains(0.0) { format!("no difference ({numbers})") } else { numbers }
}

/// The region that is farthest off, as the end of a sentence.
fn worst(regions: &[Region], remaining: bool) -> String {
    let off = regions.iter().filter(|region| region.remains || !remaining);
    let worst = off.max_by(|a, b| a.z.abs().total_cmp(&b.z.abs()));
    worst.map(|region| format!("; farthest off: {}", region_text(region))).unwrap_or_default()
}

/// Typical effects that the log would not have shown.
fn blind(outcome: &Outcome) -> Vec<&'static str> {
    outcome.detectable.iter().filter(|d| d.value > d.typical).map(|d| d.name.name()).collect()
}

/// Where and how: "incidence 60 to 75 deg: too many missing returns".
pub(super) fn region_text(region: &Region) -> String {
    format!("{}: {}", place_text(region), deviation_text(region))
}

/// Where a region is.
pub(super) fn place_text(region: &Region) -> String {
    if let Some([x0, y0, x1, y1]) = region.place {
        return format!("walls at x {x0:.1} to {x1:.1} m, y {y0:.1} to {y1:.1} m");
    }
    match region.covariate {
        Covariate::Scan => "scans as a whole".to_owned(),
        Covariate::Odometry => "odometry".to_owned(),
        Covariate::Neighbour => "neighbouring beams".to_owned(),
        Covariate::Pit => format!("all beams, PIT {:.1} to {:.1}", region.lo, region.hi),
        covariate => span(covariate, region.lo, region.hi),
    }
}

/// The deviation in a region.
pub(super) fn deviation_text(region: &Region) -> &'static str {
    let more = region.z > 0.0;
    if region.covariate == Covariate::Neighbour {
        return if more { "they err too much alike" } else { "they err too little alike" };
    }
    if region.covariate == Covariate::Odometry {
        return if more { "late" } else { "early" };
    }
    if region.covariate == Covariate::Scan {
        return if more {
            "neighbouring scans differ too much"
        } else {
            "neighbouring scans differ too little"
        };
    }
    match (region.deviation, more) {
        (Deviation::Lag, _) => "late",
        (Deviation::FrameTurn, _) => "turned",
        (Deviation::FrameShift, _) => "shifted",
        (Deviation::Share, true) => "too many readings",
        (Deviation::Share, false) => "too few readings",
        (Deviation::Skew, true) => "errors with a tail to the long side",
        (Deviation::Skew, false) => "errors with a tail to the short side",
        (Deviation::Mean, true) => "readings too long",
        (Deviation::Mean, false) => "readings too short",
        (Deviation::Spread, true) => "readings spread too much",
        (Deviation::Spread, false) => "readings spread too little",
        (Deviation::Short, true) => "too many readings of something in front",
        (Deviation::Short, false) => "too few readings of something in front",
        (Deviation::Long, true) => "too many readings of something behind",
        (Deviation::Long, false) => "too few readings of something behind",
        (Deviation::NoReturn, true) => "too many missing returns",
        (Deviation::NoReturn, false) => "too few missing returns",
    }
}

/// "0.42 [0.38, 0.46]"; without an interval, as of a place that was only looked for, "0.420".
pub(super) fn with_interval(&Estimate { value, interval }: &Estimate) -> String {
    let decimals = decimals(interval);
    if interval.lo.to_bits() == interval.hi.to_bits() {
        return fixed(value, decimals);
    }
    let [value, lo, hi] = [value, interval.lo, interval.hi].map(|value| fixed(value, decimals));
    format!("{value} [{lo}, {hi}]")
}

/// Decimals with which an interval is 4 to 40 units of the last digit wide.
pub(super) fn decimals(Interval { lo, hi }: Interval) -> usize {
    let width = (hi - lo).abs();
    if width > 0.0 && width.is_finite() { (0.6 - width.log10()).ceil().clamp(0.0, 6.0) as usize } else { 3 }
}

/// A chance with two digits.
pub(super) fn p_value(p: f64) -> String {
    if p < 1e-6 {
        "below 1e-6".to_owned()
    } else if p < 0.001 {
        format!("{p:.1e}")
    } else if p < 0.0995 {
        format!("{p:.3}")
    } else {
        format!("{p:.2}")
    }
}

/// An error of the reference from which on it hides what else is off \[m\], \[rad\].
const LARGE_ERROR: (f64, f64) = (0.03, 0.01);

/// Errors that last longer than this \[s\] last as long as most logs, which don't say how long.
const LONGEST_SECS: f64 = 60.0;

/// How far the reference poses are off, if that is far.
pub(super) fn large_reference_error(outcome: &Outcome) -> Option<String> {
    let PoseError { sigma_m, sigma_rad, correlation_secs, .. } = outcome.nuisances_after.pose_error;
    (sigma_m > LARGE_ERROR.0 || sigma_rad > LARGE_ERROR.1).then(|| {
        let lasting = if correlation_secs > LONGEST_SECS {
            "minutes".to_owned()
        } else {
            format!("about {correlation_secs:.0} s")
        };
        format!("{:.0} mm and {:.1} degrees, for {lasting} on end", 1e3 * sigma_m, sigma_rad.to_degrees())
    })
}

#[cfg(test)]
mod tests {
    use locsim_world::effect::EffectKind;

    use super::*;

    #[test]
    fn numbers_have_the_digits_that_their_intervals_are_worth() {
        let shown =
            |value: f64, lo: f64, hi: f64| with_interval(&Estimate { value, interval: Interval { lo, hi } });
        assert_eq!(shown(0.4217, 0.3812, 0.4622), "0.42 [0.38, 0.46]");
        assert_eq!(shown(0.126, 0.016, 0.236), "0.13 [0.02, 0.24]");
        assert_eq!(shown(61.23, 58.9, 63.4), "61 [59, 63]");
        assert_eq!(shown(-0.000_1, -0.04, 0.04), "0.00 [-0.04, 0.04]");
        assert_eq!(shown(2.0, 2.0, 2.0), "2.000");
    }

    #[test]
    fn the_odometry_is_told_where_nothing_else_is_off() {
        let farthest = |z: [f64; 3]| {
            let kinds = [EffectKind::OdomTurnScale, EffectKind::OdomImbalance, EffectKind::MovedWall];
            let directions: Vec<Direction> =
                kinds.into_iter().zip(z).map(|(name, z)| Direction { name, z }).collect();
            farthest_of_odometry(&directions, 4.0).map(|direction| direction.name)
        };
        assert_eq!(farthest([4.5, -7.8, 3.9]), Some(EffectKind::OdomImbalance));
        assert_eq!(farthest([4.5, -7.8, -4.1]), None);
        assert_eq!(farthest([3.5, -3.8, 3.9]), None);
    }

    #[test]
    fn curves_help_as_far_as_ranges_come_nearer() {
        let told =
            |w1_mm: f64| residual(&ResidualStage { curves: Vec::new(), w1_without_mm: 100.0, w1_mm }, 20.0);
        assert!(told(60.0).contains("the curves help: range errors 100.0 -> 60.0 mm"));
        assert!(told(99.0).contains("the curves hardly help"));
        assert!(told(101.0).contains("the curves don't help"));
    }

    #[test]
    fn a_change_whose_interval_holds_zero_is_no_difference() {
        let told = |value: f64, lo: f64, hi: f64| {
            change_in_words(&Estimate { value, interval: Interval { lo, hi } })
        };
        assert_eq!(told(-0.02, -0.05, 0.01), "no difference (-0.02 [-0.05, 0.01] m)");
        assert_eq!(told(-0.04, -0.05, -0.03), "-0.040 [-0.050, -0.030] m");
        assert_eq!(told(0.04, 0.03, 0.05), "0.040 [0.030, 0.050] m");
        assert_eq!(told(0.0, 0.0, 0.0), "no difference (0.000 m)");
    }
}
