//! Dependences without a name, in words.

use locsim_gap::{Covariate, CurvePoint, Deviation, Unnamed};

use super::covariate::{self, spot};
use locsim_report::text::{fixed, significant};

/// A curve goes up and down in turn where neighbouring points are correlated below this; fewer points than that say nothing.
const IN_TURN: f64 = -0.6;
const FEWEST_IN_TURN: usize = 8;
/// Noise that is this many times wider is no measurement: such readings are of something else.
const WIDEST: f64 = 20.0;

/// A dependence in words, with its size: "An unnamed bias depends on bearing: 6 waves around, 8.1 mm."
pub(super) fn sentence(found: &Unnamed) -> String {
    match (found.deviation, found.covariate) {
        (Deviation::Lag, _) if found.size < 0.0 => format!("The odometry leads by {}.", size(found)),
        (Deviation::Lag, _) => format!("The odometry lags by {}.", size(found)),
        (Deviation::FrameTurn, _) => {
            format!("The reference's frame is turned by {} against the map's.", size(found))
        }
        (Deviation::FrameShift, _) => {
            let along: Vec<String> =
                found.curve.iter().map(|along| value(found, along.estimate.value)).collect();
            format!(
                "The reference's frame is shifted by {} against the map's ({}).",
                size(found),
                along
                    .iter()
                    .zip(["x", "y"])
                    .map(|(by, axis)| format!("{by} along {axis}"))
                    .collect::<Vec<_>>()
                    .join(", ")
            )
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
        (_, Covariate::Losses) => format!("Some scans lose more returns than others: {}.", extent(found)),
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
    found.deviation.is_of_frame()
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
        Deviation::FrameTurn => "turn of the reference's frame",
        Deviation::FrameShift => "shift of the reference's frame",
    }
}

/// How large it is.
pub(super) fn size(found: &Unnamed) -> String {
    match (found.deviation, found.covariate) {
        (Deviation::Lag, _) => format!("{} s", fixed(found.size.abs(), 2)),
        (Deviation::FrameTurn, _) => format!("{} degrees", fixed(found.size.to_degrees(), 2)),
        (Deviation::Mean, Covariate::Neighbour) => format!("correlation {}", fixed(found.size, 2)),
        _ => value(found, found.size),
    }
}

fn value(found: &Unnamed, value: f64) -> String {
    match found.deviation {
        Deviation::Mean | Deviation::FrameShift => format!("{} mm", significant(1e3 * value)),
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
    let amount = |by: f64| match found.deviation {
        Deviation::Spread => format!("{} % of the noise", significant(100.0 * by)),
        _ => value(found, by),
    };
    let values: Vec<f64> = found.curve.iter().map(|point| point.estimate.value).collect();
    if let Some(by) = alternates(&values).filter(|_| found.covariate == Covariate::Bearing) {
        return format!("one beam and the next, of those that are compared, differ by {}", amount(by));
    }
    if let Some(wave) = &found.wave {
        let (period, count, amplitude) = (wave.period, wave.count, amount(wave.amplitude));
        return if found.covariate == Covariate::Bearing {
            format!("{} waves around, {amplitude}", fixed(count, 0))
        } else {
            format!("period {} s, {amplitude}", significant(period))
        };
    }
    if matches!(found.covariate, Covariate::Scan | Covariate::Losses) {
        return format!("up to {}", size(found));
    }
    let at = found.curve.iter().find(|point| point.estimate.value == found.size);
    let place = |at: &CurvePoint| format!(" at {}", spot(found.covariate, at));
    format!("up to {}{}", value(found, found.size), at.map(place).unwrap_or_default())
}

/// By how much the points of a curve differ from the next, where they go up and down in turn.
fn alternates(values: &[f64]) -> Option<f64> {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variation: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    let pairs = || values.windows(2).map(|pair| [pair[0], pair[1]]);
    let together: f64 = pairs().map(|[a, b]| (a - mean) * (b - mean)).sum();
    let is_alternating = values.len() >= FEWEST_IN_TURN && together < IN_TURN * variation;
    is_alternating.then(|| pairs().map(|[a, b]| (b - a).abs()).sum::<f64>() / (count - 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Beams of odd number are 15 mm longer; a wave and a step are none of that.
    #[test]
    fn beams_that_differ_in_turn_are_told_from_waves() {
        let of = |value: &dyn Fn(u32) -> f64| alternates(&(0..72).map(value).collect::<Vec<_>>());
        let noise = |i: u32| 0.002 * f64::from(i * i % 7) / 7.0;
        let by = of(&|i| 0.015 * f64::from(i % 2) + noise(i)).unwrap();
        assert!((by - 0.015).abs() < 0.001, "{by}");
        assert_eq!(of(&|i| 0.01 * (f64::from(i) * std::f64::consts::TAU / 9.0).sin() + noise(i)), None);
        assert_eq!(of(&|i| if i < 36 { 0.01 } else { 0.0 }), None);
        assert_eq!(alternates(&[0.0, 1.0, 0.0]), None);
    }
}
