//! Covariates and parts of them, in words.

use locsim_gap::{Covariate, CurvePoint};

use locsim_report::text::fixed;

/// A covariate in words.
pub(super) fn noun(covariate: Covariate) -> &'static str {
    match covariate {
        Covariate::Range => "range",
        Covariate::Incidence => "incidence",
        Covariate::Bearing | Covariate::BearingByTurnRate => "bearing",
        Covariate::Place => "place",
        Covariate::Time => "time",
        Covariate::Speed => "speed",
        Covariate::TurnRate => "turn rate",
        Covariate::Jump => "the range jump to a neighbour",
        Covariate::Everywhere => "nothing",
        Covariate::Neighbour => "the neighbouring beam's error",
        Covariate::Odometry => "the odometry",
        Covariate::Scan => "how noisy the scan's other beams are",
        Covariate::Losses => "how many returns the scan's other beams lose",
        Covariate::Pit | Covariate::Ratio => "the reading",
    }
}

/// A part of a covariate: "range 3.0 to 4.0 m".
pub(super) fn span(covariate: Covariate, lo: f64, hi: f64) -> String {
    let (name, unit, degrees) = match covariate {
        Covariate::Range => ("range", "m", false),
        Covariate::Incidence => ("incidence", "deg", true),
        Covariate::Bearing => ("bearing", "deg", true),
        Covariate::Place => ("place", "", false),
        Covariate::Time => ("time", "s", false),
        Covariate::Speed => ("speed", "m/s", false),
        Covariate::TurnRate => ("turn rate", "deg/s", true),
        Covariate::Jump => ("range jump to a neighbour", "m", false),
        Covariate::BearingByTurnRate => ("bearing in turns", "deg", true),
        Covariate::Everywhere => ("beam", "", false),
        Covariate::Odometry => ("odometry", "", false),
        Covariate::Neighbour => ("error of the neighbouring beam", "standard deviations", false),
        Covariate::Scan => ("scan", "", false),
        Covariate::Losses => ("share of the scan's other beams without return", "", false),
        Covariate::Pit => ("PIT", "", false),
        Covariate::Ratio => ("reading over nominal range", "", false),
    };
    let in_unit = |value: f64| if degrees { value.to_degrees() } else { value };
    let [lo, hi] = [lo, hi].map(in_unit);
    let largest =
        [lo, hi].into_iter().filter(|end| end.is_finite()).fold(0.0_f64, |most, end| most.max(end.abs()));
    let decimals = if largest >= 30.0 {
        0
    } else if (hi - lo).abs() > 0.3 {
        1
    } else {
        2
    };
    let shown = |value: f64| fixed(value, decimals);
    match (lo.is_finite(), hi.is_finite()) {
        (true, true) if shown(lo) == shown(hi) => format!("{name} about {} {unit}", shown(lo)),
        (true, true) => format!("{name} {} to {} {unit}", shown(lo), shown(hi)),
        (true, false) => format!("{name} above {} {unit}", shown(lo)),
        (false, true) => format!("{name} below {} {unit}", shown(hi)),
        (false, false) => format!("any {name}"),
    }
}

/// A point of a covariate: "range 3.2 m".
pub(super) fn spot(covariate: Covariate, point: &CurvePoint) -> String {
    match point.place {
        Some([x0, y0, x1, y1]) => format!("x {x0:.1} to {x1:.1} m, y {y0:.1} to {y1:.1} m"),
        None => span(covariate, point.at, point.at).replace(" about", ""),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_are_told_in_degrees() {
        assert_eq!(span(Covariate::Incidence, 1.0, f64::INFINITY), "incidence above 57 deg");
        assert_eq!(span(Covariate::Range, 3.0, 4.5), "range 3.0 to 4.5 m");
        assert_eq!(span(Covariate::Speed, 0.7, 0.7001), "speed about 0.70 m/s");
    }
}
