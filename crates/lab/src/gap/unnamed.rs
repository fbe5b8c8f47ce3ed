//! Dependences without a name, in words.

use locsim_gap::{Covariate, CurvePoint, Deviation, Unnamed};

use super::covariate::{self, spot};
use locsim_report::text::{fixed, significant};

/// Noise that is this many times wider is no measurement: such readings are of something else.
const WIDEST: f64 = 20.0;

/// A dependence in words, with its size: "An unnamed bias depends on bearing: 6 waves around, 8.1 mm."
pub(super) fn sentence(found: &Unnamed) -> String {
    match (found.deviation, found.covariate) {
        (Deviation::Lag, _) if found.size < 0.0 => format!("The odometry leads by {}.", size(found)),
        (Deviation::Lag, _) => format!("The odometry lags by {}.", size(found)),
        (Deviation::Frame, _) => {
            format!("The reference's frame is turned by {} against the map's.", size(found))
        }
        (Deviation::Mean, Covariate::Neighbour) => {
            format!("Neighbours among the beams that are compared err alike: {}.", size(found))
        }
        _ if is_of_all_noise(found) => {
            format!("The noise of every beam is {} times the simulated one.", noise_factor(found))
        }
        (Deviation::Spread, Covariate::Scan) => {
            format!("Some scans are noisier than others: {}.", extent(found))
        }
        (_, Covariate::Everywhere) => format!("An unnamed {} of every beam: {}.", noun(found), size(found)),
        _ => format!(
            "An unnamed {} depends on {}: {}.",
            noun(found),
            covariate::noun(found.covariate),
            extent(found)
        ),
    }
}

/// The same of an effect whose form is another one than the library's.
pub(super) fn form_sentence(found: &Unnamed) -> Option<String> {
    let kind = found.form_of?;
    Some(format!(
        "{kind} is right, but its form isn't `{}`: a {} is left, {}.",
        kind.formula(),
        dependent(found),
        extent(found)
    ))
}

/// Whether it is the frame of the reference that is off, and not the readings.
pub(super) fn is_of_frame(found: &Unnamed) -> bool {
    found.deviation == Deviation::Frame
}

/// Whether it is the noise of every beam that is off.
pub(super) fn is_of_all_noise(found: &Unnamed) -> bool {
    (found.deviation, found.covariate) == (Deviation::Spread, Covariate::Everywhere)
}

/// The noise over the simulated one.
pub(super) fn noise_factor(found: &Unnamed) -> String {
    fixed(1.0 + found.size, 2)
}

/// The dependent quantity and what it depends on: "bias that depends on bearing".
pub(super) fn dependent(found: &Unnamed) -> String {
    match found.covariate {
        Covariate::Everywhere => format!("{} of every beam", noun(found)),
        covariate => format!("{} that depends on {}", noun(found), covariate::noun(covariate)),
    }
}

/// The dependent quantity of a reading, in words.
pub(super) fn noun(found: &Unnamed) -> &'static str {
    match found.deviation {
        Deviation::Mean => "bias",
        Deviation::Spread => "change of the noise",
        Deviation::Skew => "one-sided tail",
        Deviation::Short => "share of readings in front",
        Deviation::Long => "share of readings behind",
        Deviation::NoReturn => "share of missing returns",
        Deviation::Share => "share of readings",
        Deviation::Lag => "lag",
        Deviation::Frame => "turn of the reference's frame",
    }
}

/// How large it is.
pub(super) fn size(found: &Unnamed) -> String {
    match (found.deviation, found.covariate) {
        (Deviation::Lag, _) => format!("{} s", fixed(found.size.abs(), 2)),
        (Deviation::Frame, _) => format!("{} degrees", fixed(found.size.to_degrees(), 2)),
        (Deviation::Mean, Covariate::Neighbour) => format!("correlation {}", fixed(found.size, 2)),
        _ => value(found, found.size),
    }
}

fn value(found: &Unnamed, value: f64) -> String {
    match found.deviation {
        Deviation::Mean => format!("{} mm", significant(1e3 * value)),
        Deviation::Spread if 1.0 + value > WIDEST => format!("{WIDEST} times the noise and more"),
        Deviation::Spread => format!("{} times the noise", fixed(1.0 + value, 2)),
        Deviation::Skew => format!("skewness {}", fixed(value, 2)),
        _ if value < 0.0 => format!("{} % fewer", significant(-100.0 * value)),
        _ => format!("{} %", significant(100.0 * value)),
    }
}

/// A wave with its period, or the largest value with where it is.
pub(super) fn extent(found: &Unnamed) -> String {
    if matches!(found.covariate, Covariate::Neighbour | Covariate::Odometry | Covariate::Everywhere)
        || is_of_frame(found)
    {
        return size(found);
    }
    if let Some(wave) = &found.wave {
        let (period, count) = (wave.period, wave.count);
        let amplitude = match found.deviation {
            Deviation::Spread => format!("{} % of the noise", significant(100.0 * wave.amplitude)),
            _ => value(found, wave.amplitude),
        };
        return if found.covariate == Covariate::Bearing && 2.0 * count + 1.0 >= found.curve.len() as f64 {
            format!("one beam and the next among those that are compared differ, {amplitude}")
        } else if found.covariate == Covariate::Bearing {
            format!("{} waves around, {amplitude}", fixed(count, 0))
        } else {
            format!("period {} s, {amplitude}", significant(period))
        };
    }
    if found.covariate == Covariate::Scan {
        return format!("up to {}", size(found));
    }
    let at = found.curve.iter().find(|point| point.estimate.value == found.size);
    let place = |at: &CurvePoint| format!(" at {}", spot(found.covariate, at));
    format!("up to {}{}", value(found, found.size), at.map(place).unwrap_or_default())
}
