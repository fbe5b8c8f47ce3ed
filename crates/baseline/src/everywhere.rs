//! Whether an effect of all beams gains everywhere.
//!
//! A shelf that was moved puts some readings far off: a tail of all beams gains a lot there, and loses a little everywhere else.

use std::collections::HashMap;

use glam::DVec2;
use locsim_core::sum_error;

/// Places are cells of this side \[m\].
pub(super) const CELL_M: f64 = 1.0;
/// The most readings that are at the places where it gains, as a share: an effect in another form than the library's gains at more of them.
const FEW: f64 = 0.35;
/// Standard errors by which an effect has to lose elsewhere.
const SURELY: f64 = 2.0;

/// What an effect gains on one reading (nats).
pub(super) struct ReadingGain {
    pub stretch: usize,
    /// Where the beam ends \[m\].
    pub end: DVec2,
    pub gain: f64,
}

/// The place where an effect gains most, of one that gains at few and surely loses elsewhere; `None` of any other. Which places gain is known
/// from every other stretch, for the stretches between.
pub(super) fn only_place(gains: &[ReadingGain]) -> Option<DVec2> {
    let cell = |end: DVec2| (end / CELL_M).floor().as_ivec2();
    let mut cells: HashMap<_, [f64; 2]> = HashMap::new();
    for of in gains.iter().filter(|of| of.end.is_finite()) {
        cells.entry(cell(of.end)).or_default()[of.stretch % 2] += of.gain;
    }
    let last = gains.iter().map(|of| of.stretch + 1).max()?;
    let mut elsewhere = vec![0.0; last];
    let mut at_gaining = 0.0;
    for of in gains {
        let others = cells.get(&cell(of.end)).map_or(0.0, |halves| halves[1 - of.stretch % 2]);
        if others > 0.0 {
            at_gaining += 1.0;
        } else {
            elsewhere[of.stretch] += of.gain;
        }
    }
    let used: Vec<f64> = elsewhere.into_iter().filter(|gain| *gain != 0.0).collect();
    let loses = used.len() > 1 && used.iter().sum::<f64>() + SURELY * sum_error(&used) < 0.0;
    let are_few = at_gaining <= FEW * gains.len() as f64;
    let total = |of: &[f64; 2]| of[0] + of[1];
    let most = cells
        .iter()
        .max_by(|a, b| total(a.1).total_cmp(&total(b.1)).then(a.0.to_array().cmp(&b.0.to_array())))?;
    (loses && are_few).then(|| (most.0.as_dvec2() + 0.5) * CELL_M)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Twelve places along a wall, seen on each of eight stretches. What gains at one of them alone is of this place; what gains at each isn't, nor
    /// what does nothing at the others.
    #[test]
    fn what_loses_at_all_places_but_one_is_of_one_place() {
        let gains = |at_one: f64, elsewhere: f64| -> Vec<ReadingGain> {
            let of = |(stretch, place): (usize, usize)| ReadingGain {
                stretch,
                end: DVec2::new(place as f64 + 0.5, 4.2),
                gain: if place == 3 { at_one } else { elsewhere } + 0.01 * ((stretch + place) % 3) as f64,
            };
            (0..8).flat_map(|stretch| (0..12).map(move |place| (stretch, place))).map(of).collect()
        };
        assert_eq!(only_place(&gains(50.0, -1.0)), Some(DVec2::new(3.5, 4.5)));
        assert_eq!(only_place(&gains(5.0, 5.0)), None);
        assert_eq!(only_place(&gains(50.0, 0.0)), None);
        assert_eq!(only_place(&[]), None);
    }
}
