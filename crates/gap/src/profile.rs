//! Profiles: a physical quantity over a covariate, in the measured log and in simulated ones. The profile of a named effect
//! shows what the effect does.

use glam::DVec2;
use locsim_comparison::{Comparison, Views};
use locsim_core::{Estimate, distance_to, equal_bins, increments, median, quantile};
use locsim_world::effect::{self, BeamState, EffectKind, Moves, Score};
use rayon::prelude::*;

use crate::Recorded;
use crate::outcome::{Named, Over, Profile, ProfileBin, Quantity};

/// Bins of a profile over a covariate, of as many readings each.
const BINS: usize = 12;
/// Fewer readings or increments in a bin show nothing.
const LEAST: usize = 30;
/// Bins of a distribution of errors, and the widest that it may be to either side \[m\].
const ERROR_BINS: usize = 24;
const WIDEST_M: f64 = 1.0;
/// A reading this many standard deviations, and this far \[m\], in front of the surface is of something else: errors of the
/// reference move readings by some centimetres.
const IN_FRONT: (f64, f64) = (5.0, 0.1);

/// A beam that should end this near to a place is one of the place \[m\]: errors of the reference are smaller.
const AT_WALL_M: f64 = 0.1;

/// The profile of each named effect.
pub(crate) fn profiles(
    named: &[Named],
    comparison: &Comparison<'_>,
    with_effects: &Comparison<'_>,
    [before, after]: [&[Recorded]; 2],
) -> Vec<Profile> {
    let source = Source {
        comparison,
        edges: &with_effects.views,
        increments: increments(comparison.recorded.track.poses()),
    };
    named.par_iter().map(|named| source.profile(named, before, after)).collect()
}

/// A bin before it has values.
struct Bin {
    at: f64,
    /// Beams, or increments, whose value it has.
    items: Vec<usize>,
    /// The errors that are counted \[m\], in a distribution of errors.
    interval: Option<[f64; 2]>,
}

/// The log and its views, which profiles are made from.
struct Source<'a> {
    comparison: &'a Comparison<'a>,
    /// Views that know jumps where an effect needs them.
    edges: &'a Views,
    /// Distance and turn between scans, by the reference.
    increments: Vec<[f64; 2]>,
}

impl Source<'_> {
    fn profile(&self, named: &Named, before: &[Recorded], after: &[Recorded]) -> Profile {
        let (quantity, over) = shown_by(named.name, self.comparison.nominal.laser.max_range_m);
        let bins = if over == Over::Error {
            self.error_bins(named)
        } else {
            let bins = equal_bins(self.items(quantity, over), BINS, LEAST).into_iter();
            bins.map(|(at, items)| Bin { at, items, interval: None }).collect()
        };
        let bins = bins.into_iter().map(|Bin { at, items, interval }| {
            let value = |log: &Recorded| match interval {
                Some(interval) => self.share(log, &items, interval),
                None => self.value(log, quantity, &items),
            };
            ProfileBin {
                at,
                count: items.len(),
                measured: value(&self.comparison.recorded),
                before: Estimate::of_replicates(before.iter().map(value).collect()),
                after: Estimate::of_replicates(after.iter().map(value).collect()),
            }
        });
        Profile { name: named.name, quantity, over, bins: bins.filter(is_known).collect() }
    }

    /// Readings, or increments, each with its covariate.
    fn items(&self, quantity: Quantity, over: Over) -> Vec<(f64, usize)> {
        let Comparison { recorded, views, .. } = self.comparison;
        if matches!(quantity, Quantity::OdometryDistance | Quantity::OdometryTurn) {
            let axis = usize::from(over == Over::Turn);
            return self.increments.iter().map(|increment| increment[axis]).zip(0..).collect();
        }
        let max = self.comparison.nominal.laser.max_range_m;
        let covariate = |i: usize| {
            let beam = &views.beams[i];
            match over {
                Over::Incidence => beam.view.incidence,
                Over::Bearing => beam.view.bearing,
                Over::Time => recorded.track.secs()[i / views.per_scan],
                _ => beam.range(),
            }
        };
        // A beam that no surface is in reach of shows nothing of surfaces.
        let usable = |&i: &usize| !recorded.readings[i].is_nan() && views.beams[i].range() < max;
        (0..views.beams.len()).filter(usable).map(|i| (covariate(i), i)).collect()
    }

    /// Bins of the error of the readings that an effect acts on: at its walls, at edges, anywhere.
    fn error_bins(&self, named: &Named) -> Vec<Bin> {
        let at_edges = matches!(named.name.description().statistics.first(), Some(effect::Statistic::Edge));
        let acts_on = |&(_, i): &(f64, usize)| {
            let view = &self.comparison.views.beams[i].view;
            let is_at =
                |wall: &[[f64; 2]; 2]| distance_to(&wall.map(DVec2::from_array), view.endpoint) < AT_WALL_M;
            let at_wall = || named.place.iter().any(is_at);
            (!at_edges || self.edges.beams[i].view.jump.is_some()) && (named.place.is_empty() || at_wall())
        };
        let items: Vec<usize> =
            self.items(Quantity::Share, Over::Range).into_iter().filter(acts_on).map(|(_, i)| i).collect();
        let mut errors: Vec<f64> =
            items.iter().filter_map(|&i| self.error(&self.comparison.recorded, i)).map(f64::abs).collect();
        if errors.len() < LEAST {
            return Vec::new();
        }
        errors.sort_by(f64::total_cmp);
        // The few readings farther off than this lie in the outermost bins.
        let widest = errors[errors.len() * 98 / 100].clamp(0.05, WIDEST_M);
        let width = 2.0 * widest / ERROR_BINS as f64;
        let bin = |b: usize| {
            let lo = -widest + width * b as f64;
            let interval = [
                if b == 0 { f64::NEG_INFINITY } else { lo },
                if b + 1 == ERROR_BINS { f64::INFINITY } else { lo + width },
            ];
            Bin { at: lo + 0.5 * width, items: items.clone(), interval: Some(interval) }
        };
        (0..ERROR_BINS).map(bin).collect()
    }

    /// A returned reading less the nominal range \[m\].
    fn error(&self, log: &Recorded, i: usize) -> Option<f64> {
        let reading = log.readings[i];
        let returned = !reading.is_nan() && reading < log.laser.max_range();
        returned.then(|| f64::from(reading) - self.comparison.views.beams[i].range())
    }

    /// Share of the readings whose error is in an interval.
    fn share(&self, log: &Recorded, items: &[usize], [lo, hi]: [f64; 2]) -> f64 {
        let inside = |&&i: &&usize| self.error(log, i).is_some_and(|error| lo <= error && error < hi);
        items.iter().filter(inside).count() as f64 / items.len() as f64
    }

    fn value(&self, log: &Recorded, quantity: Quantity, items: &[usize]) -> f64 {
        let share = |holds: &dyn Fn(usize) -> bool| {
            items.iter().filter(|&&i| holds(i)).count() as f64 / items.len() as f64
        };
        let errors = || items.iter().filter_map(|&i| self.error(log, i)).collect::<Vec<f64>>();
        match quantity {
            Quantity::Error => median(&mut errors()),
            Quantity::Spread => {
                let mut errors = errors();
                // Of a normal distribution: one standard deviation.
                0.5 * (quantile(&mut errors, 0.841) - quantile(&mut errors, 0.159))
            }
            Quantity::NoReturn => share(&|i| log.readings[i] >= log.laser.max_range()),
            Quantity::InFront | Quantity::Share => {
                let laser = &self.comparison.nominal.laser;
                let (deviations, least) = IN_FRONT;
                share(&|i| {
                    let sigma = laser.sigma_m + laser.sigma_per_m * self.comparison.views.beams[i].range();
                    self.error(log, i).is_some_and(|error| error < -(deviations * sigma).max(least))
                })
            }
            Quantity::OdometryDistance | Quantity::OdometryTurn => {
                let axis = usize::from(quantity == Quantity::OdometryTurn);
                let read = |i: usize| increments(&log.odometry[i..i + 2])[0][axis];
                let errors = items.iter().map(|&i| read(i) - self.increments[i][axis]);
                errors.sum::<f64>() / items.len() as f64
            }
        }
    }
}

/// The quantity that shows an effect, and the covariate that it depends on, by the statistics that look for the effect.
fn shown_by(kind: EffectKind, max_range: f64) -> (Quantity, Over) {
    let description = kind.description();
    let distance = |axis| axis == effect::Axis::Distance;
    match description.statistics.first() {
        Some(effect::Statistic::Odometry { error, motion }) => (
            if distance(*error) { Quantity::OdometryDistance } else { Quantity::OdometryTurn },
            if distance(*motion) { Over::Distance } else { Over::Turn },
        ),
        Some(effect::Statistic::Slip { .. }) => (Quantity::OdometryDistance, Over::Distance),
        Some(effect::Statistic::Sector) => (Quantity::InFront, Over::Bearing),
        Some(effect::Statistic::ClutterDensity) => (Quantity::InFront, Over::Range),
        // A laser that points or stands elsewhere shifts readings to either side, as the walls lie.
        Some(_) if description.moves == Moves::Scans => (Quantity::Spread, Over::Bearing),
        Some(effect::Statistic::Score { score, weight, .. }) => {
            let values: Vec<f64> = kind.parameters().iter().map(|parameter| parameter.start).collect();
            let over = depends_on(|beam| weight(beam, &values), max_range);
            match score {
                Score::Location => (Quantity::Error, over),
                Score::Scale => (Quantity::Spread, over),
                Score::NoReturn => (Quantity::NoReturn, over),
                Score::Uniform => (Quantity::InFront, over),
                Score::Tail => (Quantity::Share, Over::Error),
            }
        }
        _ => (Quantity::Share, Over::Error),
    }
}

/// The covariate with which a beam's weight varies most; range where it doesn't vary.
fn depends_on(weight: impl Fn(&BeamState) -> f64, max_range: f64) -> Over {
    let usual = BeamState {
        secs: 60.0,
        bearing: 0.5,
        range: 0.3 * max_range,
        incidence: 0.5,
        sigma: 0.01,
        max_range,
        jacobian: [0.0; 3],
        heading: 0.0,
        velocity: [0.0; 3],
    };
    let variation = |states: [BeamState; 2]| {
        let [a, b] = states.map(|state| weight(&state));
        (a - b).abs()
    };
    let candidates = [
        (Over::Range, variation([0.1, 0.8].map(|share| BeamState { range: share * max_range, ..usual }))),
        (Over::Incidence, variation([0.1, 1.2].map(|incidence| BeamState { incidence, ..usual }))),
        (Over::Time, variation([0.0, 300.0].map(|secs| BeamState { secs, ..usual }))),
    ];
    candidates.into_iter().reduce(|a, b| if b.1 > a.1 { b } else { a }).map_or(Over::Range, |(over, _)| over)
}

/// Whether every log has a value in a bin: without a return in it there is no error.
fn is_known(bin: &ProfileBin) -> bool {
    [bin.measured, bin.before.value, bin.after.value].iter().all(|value| value.is_finite())
}

#[cfg(test)]
mod tests {
    use locsim_core::Interval;

    use super::*;

    /// Each effect by what its definition says: losses over incidence, a scale over range, a drift over time.
    #[test]
    fn an_effect_is_shown_by_what_it_depends_on() {
        let shown = |kind: &str| shown_by(kind.parse().unwrap(), 8.0);
        for (kind, quantity, over) in [
            ("range_bias", Quantity::Error, Over::Range),
            ("range_scale", Quantity::Error, Over::Range),
            ("incidence_bias", Quantity::Error, Over::Incidence),
            ("warmup_drift", Quantity::Error, Over::Time),
            ("range_noise", Quantity::Spread, Over::Range),
            ("incidence_noise", Quantity::Spread, Over::Incidence),
            ("incidence_dropout", Quantity::NoReturn, Over::Incidence),
            ("range_dropout", Quantity::NoReturn, Over::Range),
            ("crosstalk", Quantity::InFront, Over::Range),
            ("sector_occlusion", Quantity::InFront, Over::Bearing),
            ("mount_yaw", Quantity::Spread, Over::Bearing),
            ("odom_distance_scale", Quantity::OdometryDistance, Over::Distance),
            ("odom_turn_scale", Quantity::OdometryTurn, Over::Turn),
            ("odom_imbalance", Quantity::OdometryTurn, Over::Distance),
            ("wheel_slip", Quantity::OdometryDistance, Over::Distance),
            ("glass", Quantity::Share, Over::Error),
            ("moved_wall", Quantity::Share, Over::Error),
            ("mixed_pixels", Quantity::Share, Over::Error),
            ("block_density", Quantity::InFront, Over::Range),
        ] {
            assert_eq!(shown(kind), (quantity, over), "{kind}");
        }
    }

    /// Of 0 to 40: 1, 20 and 39.
    #[test]
    fn a_band_holds_95_percent() {
        let values = (0..=40).rev().map(f64::from).collect();
        assert_eq!(
            Estimate::of_replicates(values),
            Estimate { value: 20.0, interval: Interval { lo: 1.0, hi: 39.0 } }
        );
    }

    #[test]
    fn a_bin_without_a_return_in_one_log_is_left_out() {
        let bin = |measured: f64, simulated: f64| {
            let before = Estimate::of_replicates(vec![1.0; 40]);
            let mut values = vec![1.0; 40];
            values[3] = simulated;
            ProfileBin { at: 1.0, count: 50, measured, before, after: Estimate::of_replicates(values) }
        };
        assert!(is_known(&bin(1.0, 2.0)));
        assert!(!is_known(&bin(f64::NAN, 2.0)) && !is_known(&bin(1.0, f64::NAN)));
    }
}
