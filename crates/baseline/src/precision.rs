//! The numbers of a fit, and how sure they are.
//!
//! A likelihood of beams is rough: they come over edges one by one, and its maximum is that of some spike. A number is the maximum
//! of a parabola through points farther apart than that, of all smooth parameters at once. Its variance is that of the sandwich
//! (Godambe 1960) over stretches of today's log and over places, as readings of one scan share the error of its pose and those of
//! one wall that of the map (clusters in two ways: Cameron, Gelbach and Miller 2011), and of the jackknife over stretches of the
//! baseline, which is learnt anew without each of them. Both are inflated for the odometry: wheels err alike on stretches that follow each
//! other.

use std::collections::{BTreeMap, HashMap};

use distreg::matrix::invert;
use locsim_core::{Estimate, cell_at};
use locsim_gap::{GapError, Number};
use locsim_world::effect::{Effect, Moves, Parameter, Role};
use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::assignment::{Assignment, variance_inflation};
use super::fitting::{Change, Known, Search};
use super::given::Given;
use super::pool::Expected;

/// The first step of a number for the parabola, in strengths. It is halved until half of it changes the gain by a quarter or so: up
/// to half and more where beams over edges make the gain peaked.
const STEP: f64 = 0.15;
const HALVINGS: usize = 6;
const QUARTER: std::ops::Range<f64> = 0.15..0.6;
/// A number moves by no more than this many steps: farther off the gain is no parabola.
const MOST_STEPS: f64 = 1.0;
/// Side of the places whose readings share errors of the map \[m\].
const CLUSTER_M: f64 = 4.0;
/// The most that two parameters may stand for each other.
const MOST_CORRELATED: f64 = 0.98;

/// An effect with its numbers.
pub(super) struct Precise {
    pub effect: Effect,
    pub numbers: BTreeMap<&'static str, Number>,
    /// Whether the interval of some strength, the other parameters being as they are, leaves out that of nothing. Losses that set in
    /// late and strongly look like others that set in early: then no strength is known by itself.
    pub is_known: bool,
}

/// The maximum by the gains of some readings alone, relative to the fit, and how much they tell of it.
struct Cluster {
    shifts: Vec<f64>,
    information: Vec<f64>,
}

/// How a parameter moves from a fit to the maximum of the parabola about it.
struct Moved {
    /// Its index among the effect's parameters.
    index: usize,
    shift: f64,
    /// Of all parameters at once.
    variance: f64,
    /// The other parameters being as they are.
    variance_alone: f64,
}

/// Gains about a fit.
struct Around {
    /// Index and step of each smooth parameter.
    steps: Vec<(usize, f64)>,
    /// The fit, each parameter a step up and down, and each two up.
    changes: Vec<Change>,
    /// Rows that lead from slopes to the maximum: of all parameters at once (the inverse of the information), and of each by itself.
    rows: Vec<Vec<f64>>,
}

impl Around {
    fn new(steps: Vec<(usize, f64)>, changes: Vec<Change>, information: &[Vec<f64>]) -> Self {
        let mut rows = invert(information);
        for (n, row) in information.iter().enumerate() {
            let alone = |m: usize| if m == n { 1.0 / row[n] } else { 0.0 };
            rows.push((0..row.len()).map(alone).collect());
        }
        Self { steps, changes, rows }
    }

    /// How far each parameter is from the maximum, by gains of the changes: of all parameters, and then of each by itself.
    fn shifts(&self, gains: &[f64]) -> Vec<f64> {
        let slopes: Vec<f64> = self
            .steps
            .iter()
            .enumerate()
            .map(|(i, (_, step))| (gains[1 + 2 * i] - gains[2 + 2 * i]) / (2.0 * step))
            .collect();
        self.rows.iter().map(|row| row.iter().zip(&slopes).map(|(r, slope)| r * slope).sum()).collect()
    }

    /// The part of some readings in the shifts.
    fn cluster(&self, gains: &[f64]) -> Cluster {
        let bend = |i: usize| (2.0 * gains[0] - gains[1 + 2 * i] - gains[2 + 2 * i]).max(0.0);
        let information: Vec<f64> = (0..self.steps.len()).map(bend).collect();
        Cluster { shifts: self.shifts(gains), information: information.repeat(2) }
    }
}

impl Search<'_> {
    /// The numbers of a fit of an effect beside the given ones. Positions, and steps of readings, stay as they were fitted.
    pub fn precise(
        &self,
        effect: &Effect,
        given: &Given,
        expected: &[Expected],
        assignment: &Assignment,
        known: &Known,
    ) -> Result<Precise, GapError> {
        let mut effect = effect.clone();
        let parameters = effect.kind.parameters();
        let is_smooth = |parameter: &Parameter| {
            matches!(parameter.role, Role::Strength | Role::Shape(_)) && !parameter.is_extra()
        };
        let smooth: Vec<usize> = (0..parameters.len()).filter(|&i| is_smooth(&parameters[i])).collect();
        let logs = self.log_densities(known, expected);
        let mut halves = vec![0.0; parameters.len()];
        let mut is_known = effect.kind.strengths().all(|i| parameters[i].role != Role::Strength);
        let around = self.around(&mut effect, &smooth, given, expected, &logs, assignment, known)?;
        if let Some(around) = around {
            let mut moved = self.moved(&around, expected, assignment, known, &logs);
            // How large an object is depends on where it stands, which stays as it was fitted.
            if effect.kind.moves() == Moves::Objects {
                let all: Vec<usize> = (0..parameters.len()).collect();
                let mut fitted = effect.clone();
                let around = self.around(&mut fitted, &all, given, expected, &logs, assignment, known)?;
                let wider = around.map(|around| self.moved(&around, expected, assignment, known, &logs));
                for beside_place in wider.into_iter().flatten() {
                    if let Some(own) = moved.iter_mut().find(|own| own.index == beside_place.index) {
                        own.variance = own.variance.max(beside_place.variance);
                    }
                }
            }
            let quantile = self.quantile();
            for Moved { index, shift, variance, variance_alone } in moved {
                let parameter = &parameters[index];
                effect.values[index] = (effect.values[index] + shift).clamp(parameter.lo, parameter.hi);
                halves[index] = quantile * variance.sqrt();
                is_known |= parameter.role == Role::Strength
                    && (effect.values[index] - parameter.neutral).abs() > quantile * variance_alone.sqrt();
            }
        }
        if let Some(lasting) = self.lasting(&effect, given, expected, &logs, assignment, known)?
            && let Some(i) = parameters.iter().position(|parameter| parameter.name == "share")
        {
            effect.values[i] = self.share_of_readings(&lasting);
        }
        let numbers = parameters.iter().zip(&effect.values).zip(halves);
        let numbers =
            numbers.filter(|((parameter, _), _)| !parameter.is_extra()).map(|((parameter, &value), half)| {
                let estimate =
                    Estimate::around(value, half).map(|value| value.clamp(parameter.lo, parameter.hi));
                (parameter.name, Number { estimate, unit: parameter.unit })
            });
        Ok(Precise { numbers: numbers.collect(), effect, is_known })
    }

    /// How the parameters move from a fit to the maximum of the parabola about it.
    fn moved(
        &self,
        around: &Around,
        expected: &[Expected],
        assignment: &Assignment,
        known: &Known,
        logs: &[Vec<f64>; 2],
    ) -> Vec<Moved> {
        let of_stretches: Vec<Vec<f64>> =
            around.changes.iter().map(|change| self.today(change, logs, assignment, known)).collect();
        let totals: Vec<f64> = of_stretches.iter().map(|gains| gains.iter().sum()).collect();
        let shifts = around.shifts(&totals);
        let variances = self.variances(around, &of_stretches, &shifts, expected, assignment, known, logs);
        let count = around.steps.len();
        let moved = |(n, &(index, step)): (usize, &(usize, f64))| {
            let most = MOST_STEPS * step;
            let shift = shifts[n].clamp(-most, most);
            Moved { index, shift, variance: variances[n], variance_alone: variances[n + count] }
        };
        around.steps.iter().enumerate().map(moved).collect()
    }

    /// The share of today's readings that bursts fall on, by the probability that they last in a reading's window. The likelihood of a share counts
    /// windows: where few beams of a window end at places that both logs have seen, any that is off looks like a burst.
    fn share_of_readings(&self, lasting: &HashMap<u32, f64>) -> f64 {
        let today = || self.pool.at_shared_places().iter().filter(|reading| reading.log == 1);
        let sum: f64 = today().map(|reading| lasting.get(&reading.window).unwrap_or(&0.0)).sum();
        sum / today().count().max(1) as f64
    }

    /// Gains about a fit, which is moved away from limits; `None` where some parameter gains on both sides.
    #[expect(clippy::too_many_arguments, reason = "what gains depend on")]
    fn around(
        &self,
        effect: &mut Effect,
        smooth: &[usize],
        given: &Given,
        expected: &[Expected],
        logs: &[Vec<f64>; 2],
        assignment: &Assignment,
        known: &Known,
    ) -> Result<Option<Around>, GapError> {
        let parameters = effect.kind.parameters();
        let moved = |effect: &Effect, by: &[(usize, f64)]| {
            let mut effect = effect.clone();
            for &(i, by) in by {
                effect.values[i] += by;
            }
            self.change(effect, given, expected)
        };
        let total = |change: &Change| self.today(change, logs, assignment, known).iter().sum::<f64>();
        let mut steps = Vec::new();
        for &i in smooth {
            let (parameter, value) = (&parameters[i], effect.values[i]);
            let typical = match parameter.role {
                Role::Position { first_step } => first_step,
                _ => parameter.typical_step(value),
            };
            let mut step = (STEP * typical).min(0.25 * (parameter.hi - parameter.lo));
            let mut sides = None;
            for _ in 0..=HALVINGS {
                // Away from the limits by more than rounding errors.
                let margin = 1.001 * step;
                effect.values[i] = value.clamp(parameter.lo + margin, parameter.hi - margin);
                let middle = total(&moved(effect, &[])?);
                let drop = |by: f64| -> Result<f64, GapError> {
                    Ok(2.0 * middle
                        - total(&moved(effect, &[(i, by)])?)
                        - total(&moved(effect, &[(i, -by)])?))
                };
                let [whole, half] = match sides {
                    None => [drop(step)?, drop(0.5 * step)?],
                    Some(whole) => [whole, drop(0.5 * step)?],
                };
                if whole > 0.0 && QUARTER.contains(&(half / whole)) {
                    break;
                }
                step *= 0.5;
                sides = (effect.values[i] == value).then_some(half);
            }
            steps.push((i, step));
        }
        let mut changes = vec![moved(effect, &[])?];
        for &(i, step) in &steps {
            changes.extend([moved(effect, &[(i, step)])?, moved(effect, &[(i, -step)])?]);
        }
        for (n, &a) in steps.iter().enumerate() {
            for &b in &steps[..n] {
                changes.push(moved(effect, &[a, b])?);
            }
        }
        let totals: Vec<f64> = changes.iter().map(total).collect();
        let information = information(&totals, &steps);
        Ok(information.map(|information| Around::new(steps, changes, &information)))
    }

    /// Variance of each number.
    #[expect(clippy::too_many_arguments, reason = "what gains depend on")]
    fn variances(
        &self,
        around: &Around,
        of_stretches: &[Vec<f64>],
        shifts: &[f64],
        expected: &[Expected],
        assignment: &Assignment,
        known: &Known,
        logs: &[Vec<f64>; 2],
    ) -> Vec<f64> {
        let stretches = self.pool.stretches[1];
        let today: Vec<Cluster> = (0..stretches)
            .filter(|&stretch| assignment.is_today[stretch])
            .map(|stretch| {
                around.cluster(&of_stretches.iter().map(|gains| gains[stretch]).collect::<Vec<_>>())
            })
            .collect();
        let without: Vec<Vec<f64>> = (0..stretches)
            .into_par_iter()
            .filter(|&stretch| assignment.is_baseline[stretch])
            .map(|stretch| {
                let mut rest = assignment.clone();
                rest.is_baseline[stretch] = false;
                let known = self.learn(&rest);
                let logs = self.log_densities(&known, expected);
                let total = |change: &Change| self.today(change, &logs, &rest, &known).iter().sum();
                around.shifts(&around.changes.iter().map(total).collect::<Vec<f64>>())
            })
            .collect();
        let [places, both] = self.of_places(around, assignment, known, logs);
        let is_of_odometry = matches!(around.changes[0], Change::Odometry { .. });
        (0..shifts.len())
            .map(|n| {
                let moves = |clusters: &[Cluster]| moves(clusters, n);
                let in_order = moves(&today);
                let [today, places, both] =
                    [variance(&in_order), variance(&moves(&places)), variance(&moves(&both))];
                let two_ways = (today + places - both).max(today).max(places);
                // Wheels err alike on stretches that follow each other.
                let inflation =
                    |moves: &[f64]| if is_of_odometry { variance_inflation(&[moves]) } else { 1.0 };
                let moves_of_baseline: Vec<f64> = without.iter().map(|own| own[n] - shifts[n]).collect();
                two_ways * inflation(&in_order)
                    + jackknife(&moves_of_baseline) * inflation(&moves_of_baseline)
            })
            .collect()
    }

    /// Shifts by the readings of each place of today's log, and by those of each place and stretch.
    fn of_places(
        &self,
        around: &Around,
        assignment: &Assignment,
        known: &Known,
        logs: &[Vec<f64>; 2],
    ) -> [Vec<Cluster>; 2] {
        let mut places: HashMap<[i32; 2], usize> = HashMap::new();
        let mut groups: BTreeMap<(usize, u32), Vec<f64>> = BTreeMap::new();
        // A reading outside of bursts says nothing of what they do.
        let lasting = match &around.changes[0] {
            Change::Readings { today, .. } => {
                today.burst_probabilities(self.pool, &known.learnt, &logs[1], &assignment.is_today)
            }
            Change::Odometry { .. } => None,
        };
        for (n, change) in around.changes.iter().enumerate() {
            let Change::Readings { today, .. } = change else { return [Vec::new(), Vec::new()] };
            for (index, gain) in today.reading_gains(self.pool, &known.learnt, &logs[1], &assignment.is_today)
            {
                let reading = &self.pool.readings[index as usize];
                let count = places.len();
                let cell = cell_at(self.pool.beam(reading).view.endpoint, CLUSTER_M);
                let place = *places.entry(cell).or_insert(count);
                let weight = lasting.as_ref().map_or(1.0, |of_window| of_window[&reading.window]);
                groups.entry((place, reading.stretch)).or_insert_with(|| vec![0.0; around.changes.len()])
                    [n] += weight * gain;
            }
        }
        let mut of_places = vec![vec![0.0; around.changes.len()]; places.len()];
        for ((place, _), gains) in &groups {
            of_places[*place].iter_mut().zip(gains).for_each(|(sum, gain)| *sum += gain);
        }
        [
            of_places.iter().map(|gains| around.cluster(gains)).collect(),
            groups.values().map(|gains| around.cluster(gains)).collect(),
        ]
    }

    /// The two-sided 95 % quantile of Student's distribution, by the stretches of the log that has fewer.
    fn quantile(&self) -> f64 {
        let [first, all] = self.pool.stretches;
        let degrees = (first.min(all - first) as f64 - 1.0).max(2.0);
        StudentsT::new(0.0, 1.0, degrees).map_or(f64::INFINITY, |student| student.inverse_cdf(0.975))
    }
}

/// Information of the parameters by gains of the fit, each parameter a step up and down, each two up; `None` where there is no maximum.
fn information(totals: &[f64], steps: &[(usize, f64)]) -> Option<Vec<Vec<f64>>> {
    let mut information = vec![vec![0.0; steps.len()]; steps.len()];
    let mut both = 1 + 2 * steps.len();
    for (a, (_, step)) in steps.iter().enumerate() {
        information[a][a] = (2.0 * totals[0] - totals[1 + 2 * a] - totals[2 + 2 * a]) / (step * step);
        if information[a][a] <= 0.0 {
            return None;
        }
        for b in 0..a {
            let mixed = totals[both] - totals[1 + 2 * a] - totals[1 + 2 * b] + totals[0];
            let most = MOST_CORRELATED * (information[a][a] * information[b][b]).sqrt();
            information[a][b] = (-mixed / (step * steps[b].1)).clamp(-most, most);
            information[b][a] = information[a][b];
            both += 1;
        }
    }
    Some(information)
}

/// By how much each cluster moves a number: what it differs by from its share of the whole, as the fit may be off the maximum.
fn moves(clusters: &[Cluster], number: usize) -> Vec<f64> {
    let sum = |of: &dyn Fn(&Cluster) -> f64| clusters.iter().map(of).sum::<f64>();
    let (whole, information) =
        (sum(&|c| c.shifts[number]), sum(&|c| c.information[number]).max(f64::MIN_POSITIVE));
    clusters.iter().map(|c| c.shifts[number] - c.information[number] / information * whole).collect()
}

/// Variance of a number by what clusters move it.
fn variance(moves: &[f64]) -> f64 {
    let n = moves.len() as f64;
    if n > 1.0 { n / (n - 1.0) * moves.iter().map(|by| by * by).sum::<f64>() } else { 0.0 }
}

/// Variance of a number by what leaving out each of some stretches moves it.
fn jackknife(moves: &[f64]) -> f64 {
    let n = moves.len() as f64;
    (n - 1.0) / n * moves.iter().map(|by| by * by).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Parabolas with their maxima at 1, 2, 6, the last of twice the weight: their mean is 3.75, with the variance that squares about it say.
    #[test]
    fn clusters_tell_the_variance_of_their_mean() {
        let gains =
            |at: f64, weight: f64| [0.0, 0.5, -0.5].map(|x: f64| -0.5 * weight * (x - at).powi(2)).to_vec();
        let all = [gains(1.0, 1.0), gains(2.0, 1.0), gains(6.0, 2.0)];
        let totals: Vec<f64> = (0..3).map(|i| all.iter().map(|gains| gains[i]).sum()).collect();
        let steps = vec![(0, 0.5)];
        let information = information(&totals, &steps).unwrap();
        let around = Around::new(steps, Vec::new(), &information);
        assert!((around.shifts(&totals)[0] - 3.75).abs() < 1e-12);
        let clusters: Vec<Cluster> = all.iter().map(|gains| around.cluster(gains)).collect();
        let off = [2.75_f64, 1.75, 4.5].map(|off| (off / 4.0).powi(2));
        assert!((variance(&moves(&clusters, 0)) - 1.5 * off.iter().sum::<f64>()).abs() < 1e-12);
    }

    /// A valley has no maximum.
    #[test]
    fn gains_on_both_sides_are_no_maximum() {
        assert!(information(&[0.0, 1.0, 1.0], &[(0, 0.5)]).is_none());
    }
}
