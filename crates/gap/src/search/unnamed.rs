//! Dependences that no effect explains, for people.

use distreg::wave::{self, Wave};
use locsim_core::{Estimate, surely_largest};
use locsim_world::effect::Effect;

use super::judgement::{Dependence, Judgement, acts_on};
use crate::free_model::{Axis, is_share};
use crate::outcome::{CurvePoint, Evidence, Unnamed};
use crate::statistics::{Covariate, Deviation, Survey};

/// What beams share explains the noise of every beam where it gains at least this share of what the noise gains.
const IN_COMMON: f64 = 0.9;

/// A share of readings that changes by less is a trifle, however surely it does.
const LEAST_SHARE: f64 = 1e-3;

/// Puts what the beams of a scan share before the noise that it causes.
fn cause_first(all: &mut [Unnamed]) {
    let gain = |found: &Unnamed| found.evidence.gain_nats.value;
    if let Some(at) = all.iter().position(|found| found.covariate == Covariate::Neighbour)
        && all[0].deviation == Deviation::Spread
        && matches!(all[0].covariate, Covariate::Everywhere | Covariate::Scan)
        && gain(&all[at]) >= IN_COMMON * gain(&all[0])
    {
        all[..=at].rotate_right(1);
    }
}

/// The dependences of a log beyond a round's effects.
pub fn unnamed(judgement: &Judgement, effects: &[Effect], survey: &Survey<'_>, p: f64) -> Vec<Unnamed> {
    let scans = survey.comparison.views.scans() as f64;
    let told = |dependence: Dependence<'_>| {
        let form_of = effects
            .iter()
            .find(|effect| acts_on(effect, &dependence, &judgement.covariates, survey))
            .map(|effect| effect.kind);
        let gain_nats = Estimate::of_sum(&dependence.gains);
        let gain_nats_per_scan = gain_nats.value / scans;
        let evidence = Evidence { gain_nats, gain_nats_per_scan, score: None, p };
        let numbers = dependence.misalignment.iter().flat_map(|found| &found.estimates).zip(0..);
        let (curve, wave) = match dependence.component {
            None => (numbers.map(|(&number, axis)| point(f64::from(axis), None, number)).collect(), None),
            Some(component) => {
                let axis = &judgement.covariates.axes[component.axis];
                (points(axis, &component.curve), wave(axis, &component.curve))
            }
        };
        let unit = match (dependence.deviation, dependence.covariate) {
            (Deviation::Lag, _) => "s",
            (Deviation::FrameTurn, _) => "rad",
            (Deviation::FrameShift, _) => "m",
            (Deviation::Mean, covariate) if covariate != Covariate::Neighbour => "m",
            _ => "1",
        };
        let size = match (dependence.covariate, &wave) {
            (Covariate::Neighbour, _) => judgement.neighbour_correlation(),
            (_, Some(wave)) => wave.amplitude,
            _ if dependence.deviation == Deviation::FrameShift => {
                curve.iter().map(|along| along.estimate.value.powi(2)).sum::<f64>().sqrt()
            }
            _ => surely_largest(curve.iter().map(|point| point.estimate)),
        };
        let Dependence { deviation, covariate, .. } = dependence;
        Unnamed { deviation, covariate, form_of, evidence, unit, size, wave, curve }
    };
    let mut all: Vec<Unnamed> = judgement.dependences().into_iter().map(told).collect();
    all.retain(|found| !is_share(found.deviation) || found.size.abs() >= LEAST_SHARE);
    cause_first(&mut all);
    all
}

fn points(axis: &Axis, curve: &[Option<[f64; 2]>]) -> Vec<CurvePoint> {
    let levels = axis.levels.iter().zip(curve).enumerate();
    levels
        // The first cell is no place: it has the beams that end nowhere.
        .skip(usize::from(!axis.cells.is_empty()))
        .filter_map(|(i, (&at, point))| {
            let place = axis.cells.get(i).map(|&[x, y, side]| [x, y, x + side, y + side]);
            Some(self::point(at, place, (*point)?))
        })
        .collect()
}

fn point(at: f64, place: Option<[f64; 4]>, [value, error]: [f64; 2]) -> CurvePoint {
    CurvePoint { at, place, estimate: Estimate::normal(value, error) }
}

/// The wave that a curve over bearing or time is, if it is one.
fn wave(axis: &Axis, curve: &[Option<[f64; 2]>]) -> Option<Wave> {
    matches!(axis.covariate, Covariate::Bearing | Covariate::Time).then(|| fit_wave(axis, curve)).flatten()
}

/// The wave that a curve over an ordered covariate is, if it is one.
pub fn fit_wave(axis: &Axis, curve: &[Option<[f64; 2]>]) -> Option<Wave> {
    let points: Vec<[f64; 3]> = axis
        .levels
        .iter()
        .zip(curve)
        .filter_map(|(&x, point)| point.map(|[y, error]| [x, y, error.max(1e-9).powi(-2)]))
        .collect();
    // Bearings come full circle; others don't.
    wave::fit(&points, axis.covariate == Covariate::Bearing)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    fn axis(covariate: Covariate, levels: Vec<f64>) -> Axis {
        Axis::of_levels(covariate, levels)
    }

    #[test]
    fn waves_are_counted_and_trends_are_none() {
        let bearings: Vec<f64> = (0..72).map(|i| TAU * (f64::from(i) / 72.0 - 0.5)).collect();
        let ripple = |x: f64| 0.003 + 0.008 * (6.0 * x + 0.4).sin();
        let curve: Vec<_> = bearings.iter().map(|&x| Some([ripple(x), 0.001])).collect();
        let found = wave(&axis(Covariate::Bearing, bearings), &curve).unwrap();
        assert!((found.count - 6.0).abs() < 1e-9 && (found.amplitude - 0.008).abs() < 1e-4, "{found:?}");

        let secs: Vec<f64> = (0..100).map(|i| 0.5 * f64::from(i)).collect();
        let of = |f: &dyn Fn(f64) -> f64| {
            let curve: Vec<_> = secs.iter().map(|&t| Some([f(t), 0.001])).collect();
            wave(&axis(Covariate::Time, secs.clone()), &curve)
        };
        let swing = of(&|t| 0.01 * (TAU * t / 17.0).cos()).unwrap();
        assert!((swing.period - 17.0).abs() < 0.5 && (swing.amplitude - 0.01).abs() < 5e-4, "{swing:?}");
        assert_eq!(of(&|t| 0.03 * (-t / 15.0).exp()), None);
        assert_eq!(of(&|t| 0.03 * (1.0 - t / 20.0).max(0.0)), None);
    }

    #[test]
    fn what_beams_share_is_told_before_the_noise_that_it_causes() {
        let found = |deviation, covariate, nats| Unnamed {
            deviation,
            covariate,
            form_of: None,
            evidence: Evidence {
                gain_nats: Estimate::normal(nats, 1.0),
                gain_nats_per_scan: 1.0,
                score: None,
                p: 0.01,
            },
            unit: "1",
            size: 0.0,
            wave: None,
            curve: Vec::new(),
        };
        let noise = || found(Deviation::Spread, Covariate::Everywhere, 480.0);
        let lag = || found(Deviation::Lag, Covariate::Odometry, 475.0);
        for (shared_nats, first) in [(470.0, Covariate::Neighbour), (300.0, Covariate::Everywhere)] {
            let mut all = vec![noise(), lag(), found(Deviation::Mean, Covariate::Neighbour, shared_nats)];
            cause_first(&mut all);
            assert_eq!((all[0].covariate, all.len()), (first, 3), "{shared_nats}");
        }
        // Noise over time has another cause.
        let mut all = vec![
            found(Deviation::Spread, Covariate::Time, 480.0),
            found(Deviation::Mean, Covariate::Neighbour, 470.0),
        ];
        cause_first(&mut all);
        assert_eq!(all[0].covariate, Covariate::Time);
    }
}
