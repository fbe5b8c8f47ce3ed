//! The next steps for the reader, in three lines that follow from the verdict.

use locsim_gap::{Covariate, Deviation, Named, Outcome, Region, ResidualStage, Unnamed, Verdict};
use locsim_world::effect::{Description, Moves};

use super::answer::{change_in_words, large_reference_error, only_of_odometry, others, p_value, region_text};
use super::unnamed;

/// Typical effects that an underpowered log names at the most.
const SHOWN_BLIND: usize = 3;

/// Three steps, the most urgent first.
pub(super) fn steps(outcome: &Outcome) -> [String; 3] {
    match outcome.verdict {
        Verdict::None => [
            reference_first(outcome).unwrap_or_else(|| {
                "Keep the scenario: this log shows no difference from its simulations.".to_owned()
            }),
            "Read the detectable strengths below: a weaker effect would not have been found.".to_owned(),
            "Repeat the search on a log from other surroundings before you rely on the simulator there.".to_owned(),
        ],
        Verdict::Named => [
            remedy(&outcome.effects),
            use_in_filter(outcome),
            reference_first(outcome).unwrap_or_else(|| CONFIRM.to_owned()),
        ],
        Verdict::Ambiguous => [
            undecided(&outcome.effects),
            experiment(&outcome.effects),
            "Use `scenario.yaml` until then: its effect fits this log as well as its rivals do.".to_owned(),
        ],
        Verdict::PartlyExplained => {
            let (rest, remedy) = (rest(outcome), remedy(&outcome.effects));
            // What is named is the lesser part of the gap then.
            let [first, second] = if outcome.gap.is_open_in_ranges() { [rest, remedy] } else { [remedy, rest] };
            [first, second, meanwhile(outcome).unwrap_or_else(|| CHECK.to_owned())]
        }
        Verdict::Unnamed if outcome.unnamed.first().is_some_and(unnamed::is_of_frame) => [
            rest(outcome),
            "Repeat the search with these poses: what else is off shows then.".to_owned(),
            "Leave the simulator as it is until then.".to_owned(),
        ],
        Verdict::Unnamed => [
            rest(outcome),
            "Repeat the search on another log of this robot: a property of the sensor comes back, one of the place \
             does not."
                .to_owned(),
            meanwhile(outcome).unwrap_or_else(|| {
                "Do not rely on the simulator where this matters: `gap.json` (`unnamed`) has the curve with its band.".to_owned()
            }),
        ],
        Verdict::Unexplained if only_of_odometry(outcome).is_some() => [
            "Look at the wheels: load, tyre pressure, a floor that is slippery in places.".to_owned(),
            "Leave the laser's simulation as it is: nothing stands out in the readings.".to_owned(),
            "Raise `robot.odometry_noise` if the wheels always do that, and repeat the search.".to_owned(),
        ],
        Verdict::Unexplained => [
            rest(outcome),
            "Check the map, the reference poses and the scenario's laser: maximum range, mount, noise.".to_owned(),
            "Record a longer log, or search in more of it (`--scans`, `--beams`).".to_owned(),
        ],
        Verdict::Underpowered => [
            format!(
                "Do not take this for agreement (p = {}): the log is too short or too uniform.",
                p_value(outcome.detection.p)
            ),
            record_more(outcome),
            "Search in more of the log if it has more scans or beams than were looked at (`--scans`, `--beams`)."
                .to_owned(),
        ],
    }
}

/// A reference that is far off for long takes up what else is off.
fn reference_first(outcome: &Outcome) -> Option<String> {
    large_reference_error(outcome).map(|error| {
        format!(
            "Look at the reference poses: as fitted they err by {error}. A jump of them, an old map or a laser that was knocked on the way \
             does that, and it hides other effects."
        )
    })
}

const CONFIRM: &str =
    "Confirm it on another log: `locsim gap scenario.yaml --log OTHER --out FOLDER` should name nothing.";

const CHECK: &str = "Check the map and the reference poses: their errors look like effects of the laser.";

/// Who mends an effect.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Mends {
    /// Mount, odometry, stamps or drift are corrected on the robot.
    Robot,
    /// What stands otherwise than the map has it is drawn there.
    Map,
    /// A sensor model has to learn the others.
    Model,
}

impl Mends {
    fn of(named: &Named) -> Self {
        let Description { is_correctable, moves, replaces, .. } = named.name.description();
        match moves {
            _ if *is_correctable => Self::Robot,
            Moves::Walls | Moves::Objects if replaces.is_none() => Self::Map,
            _ => Self::Model,
        }
    }
}

fn remedy(effects: &[Named]) -> String {
    let names = |who: Mends, what: &dyn Fn(&str) -> String| {
        let of_kind = effects.iter().filter(|named| Mends::of(named) == who);
        let names: Vec<&str> = of_kind.map(|named| named.name.name()).collect();
        (!names.is_empty()).then(|| what(&names.join(" and ")))
    };
    let all = [
        names(Mends::Robot, &|names| format!("correct {names} on the robot")),
        names(Mends::Map, &|names| format!("correct the map ({names})")),
        names(Mends::Model, &|names| format!("train sensor models with {names}")),
    ];
    let all: Vec<String> = all.into_iter().flatten().collect();
    if all.is_empty() {
        return "Add nothing to the scenario yet: no effect explains the log.".to_owned();
    }
    let text = all.join(", and ");
    let (first, others) = text.split_at(1);
    let it = if effects.len() > 1 { "them" } else { "it" };
    format!("{}{others}; `scenario.yaml` simulates {it}.", first.to_uppercase())
}

/// What is still off: the dependence without a name that gains most, or the region that is farthest off.
fn rest(outcome: &Outcome) -> String {
    let without_name = outcome.unnamed.iter().find(|found| found.form_of.is_none());
    match (without_name, outcome.unnamed.first()) {
        (Some(found), _) if unnamed::is_of_frame(found) => {
            "Put the reference's poses into the map's frame: they come from another map, or from an older one.".to_owned()
        }
        (Some(found), _) if unnamed::is_of_all_noise(found) => format!(
            "Multiply the scenario's `laser.noise` by {}, and repeat the search.",
            unnamed::noise_factor(found)
        ),
        (Some(found), _) => {
            // What depends on place isn't a property of the robot, and what is in front of walls is part of it at one bearing alone.
            let at = match (found.deviation, found.covariate) {
                (Deviation::Long, Covariate::Place) => "in the surroundings (a pane, an open door, a wall that is gone)",
                (Deviation::NoReturn, Covariate::Place) => "in the surroundings (a pane, a dark or polished wall)",
                (_, Covariate::Place) => "in the surroundings",
                (Deviation::Short, covariate) if covariate != Covariate::Bearing => {
                    "at what stands in front of walls or walks there, which the scenario's `blocks` should describe,"
                }
                _ => "on the robot",
            };
            format!("Look {at} for a {}: {}.", unnamed::dependent(found), unnamed::extent(found))
        }
        (None, Some(Unnamed { form_of: Some(kind), .. })) => {
            format!(
                "Look at the curve of what {kind} leaves, below: its cause isn't quite what the library's formula says."
            )
        }
        _ => look_at(outcome.regions.iter().filter(|region| region.remains || outcome.effects.is_empty())),
    }
}

/// What to simulate with until the cause is known, where the curves help.
fn meanwhile(outcome: &Outcome) -> Option<String> {
    outcome.residual.as_ref().is_some_and(ResidualStage::is_nearer).then(|| {
        "Use `scenario.yaml` until then: it has the curves as they were learnt, for drives like this one."
            .to_owned()
    })
}

fn use_in_filter(outcome: &Outcome) -> String {
    let Some(filter) = &outcome.filter else {
        return "Measure what a particle filter gains: repeat the search without `--no-filter`.".to_owned();
    };
    let change = change_in_words(&filter.change_m);
    if filter.change_m.interval.hi < 0.0 {
        format!("Use it in the filter: its position error on this log changes by {change}.")
    } else if filter.change_m.interval.lo > 0.0 {
        format!("Do not use it in the filter yet: its position error on this log changes by {change}.")
    } else {
        format!("Expect the same accuracy of the filter: {change}.")
    }
}

fn undecided(effects: &[Named]) -> String {
    let rivals = effects.iter().find(|named| others(named).next().is_some());
    rivals.map_or_else(
        || "Do not decide yet: several effects fit this log.".to_owned(),
        |named| {
            let rivals: Vec<_> = others(named).collect();
            format!("Do not decide yet: the log fits {} or {}.", named.name, rivals.join(" or "))
        },
    )
}

fn experiment(effects: &[Named]) -> String {
    let split = effects.iter().find_map(|named| named.split_by);
    split.map_or_else(
        || "Record another log, with other motions and in other surroundings.".to_owned(),
        |split| format!("Record another log: {split}."),
    )
}

/// The region that is farthest off.
fn look_at<'a>(regions: impl Iterator<Item = &'a Region>) -> String {
    regions.max_by(|a, b| a.z.abs().total_cmp(&b.z.abs())).map_or_else(
        || "Record a longer log: something is off as a whole, but in no single region for sure.".to_owned(),
        |region| format!("Look where the log is farthest off: {}.", region_text(region)),
    )
}

fn record_more(outcome: &Outcome) -> String {
    let blind: Vec<&str> =
        outcome.detectable.iter().filter(|d| d.value > d.typical).map(|d| d.name.name()).collect();
    let more = blind.len().saturating_sub(SHOWN_BLIND);
    let names = blind[..blind.len() - more].join(", ");
    let rest = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("Record more scans on a path with more variety, to see {names}{rest} of a typical strength.")
}
