//! Whether anything changed: permutations of stretches, and the answer as a whole.

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use locsim_core::Progress;
use locsim_gap::{GapError, Named, Nominal, Purpose, Recorded};
use locsim_world::effect::{Effect, EffectKind};
use rand::seq::SliceRandom;
use rayon::prelude::*;

use super::assignment::Assignment;
use super::bearings::{self, LossesByBearing};
use super::directions;
use super::fitting::{Known, Search};
use super::given::{Given, is_of_place};
use super::increments::{Increments, is_of_odometry};
use super::learnt::{ERROR_BIN_M, ERROR_BINS, Learnt, bin_of};
use super::naming::{Round, SHARE_OF_PLACES, score_of_odometry};
use super::neighbours::{Neighbours, SURELY, is_noise};
use super::null::{Best, Null, Score, add};
use super::places;
use super::pool::{Expected, Pool};
use super::trials::{Trial, trials, usual};
use super::{BaselineOptions, ChangeVerdict, Changes, Tried};

/// Fewer of today's readings than this, at places that the baseline has seen, say nothing.
const LEAST_SHARED: usize = 1000;
/// Permutations after which a p-value that is surely too large is left as it is (Besag and Clifford 1991).
const SCREENING: u32 = 99;
const PLAUSIBLE: f64 = 0.1;
/// Permutations of logs that fewer leave in doubt, with a p-value of at most so much.
const IN_DOUBT: u32 = 399;
const DOUBTFUL: f64 = 0.05;
/// Finds what today's log has that the baseline hasn't.
///
/// # Errors
/// [`GapError`] for a log that isn't of the simulator's laser, and when `stop` is set.
pub fn find_changes(
    nominal: &Nominal,
    baseline: &Recorded,
    today: &Recorded,
    options: &BaselineOptions,
    progress: &dyn Progress,
    stop: &AtomicBool,
) -> Result<Changes, GapError> {
    nominal.check(baseline)?;
    nominal.check(today)?;
    // Clutter is learnt with the rest.
    let plain = nominal.without_blocks()?;
    progress.stage("casting both logs", 1);
    let pool = Pool::new(&plain, baseline, today)?;
    progress.advance(1);
    let mut changes = Changes {
        verdict: ChangeVerdict::Underpowered,
        effects: Vec::new(),
        losses_by_bearing: None,
        noise_of_every_beam_m: None,
        odometry_lag_secs: None,
        place: None,
        p: 1.0,
        permutations: 0,
        tried: Vec::new(),
        shared: pool.shared,
        reversed: directions::share_reversed(baseline.track.poses(), today.track.poses()),
        w1_mm: [0.0; 3],
        scans: [baseline.scans(), today.scans()],
        beams: today.beams(),
        notes: Vec::new(),
        seed: options.seed,
        seconds: 0.0,
    };
    if pool.at_shared_places().iter().filter(|reading| reading.log == 1).count() < LEAST_SHARED {
        changes.notes.push("The two logs have too few places in common to be compared.".to_owned());
        return Ok(changes);
    }
    let (increments, neighbours) = (Increments::new(&pool), Neighbours::new(&pool));
    let search = Search { increments, neighbours, pool: &pool, options, progress, stop };
    search.run(&mut changes)?;
    Ok(changes)
}

impl Search<'_> {
    fn run(&self, changes: &mut Changes) -> Result<(), GapError> {
        let options = self.options;
        self.progress.stage("trying effects", 1);
        let given = Given::none();
        let expected = usual(self.pool);
        let all = trials(self.pool, &given, &expected, &options.without);
        let (placed, tried): (Vec<Trial>, Vec<Trial>) =
            all.into_iter().partition(|trial| is_of_place(trial.effect.kind));
        self.progress.advance(1);
        let odometry = self.odometry_trials();
        let assignment = self.true_assignment();
        let known = self.learn(&assignment);
        let own = self.best(&tried, &odometry, &assignment, &known);
        let places = self.places(&placed, &assignment, &known)?;
        let places_of_baseline = self.places_of_baseline(&placed, &assignment)?;
        let standing = places::Best::all(&places, &places_of_baseline);
        let stretches = assignment.is_today.iter().filter(|is| **is).count();
        let screening = options.permutations.min(SCREENING);
        let (mut others, mut distances) = self.permute(&tried, &odometry, 0..screening)?;
        let mut null = Null::new(&own, &others, stretches);
        while let Some(permutations) =
            next_permutations(others.len() as u32, null.p(&own), null.is_clearly_off(&own), options)
        {
            let more = self.permute(&tried, &odometry, others.len() as u32..permutations)?;
            others.extend(more.0);
            distances.extend(more.1);
            null = Null::new(&own, &others, stretches);
        }
        changes.permutations = others.len() as u32;
        let p_of_places = standing.values().map(|best| best.p).fold(1.0, f64::min);
        changes.p = null.p(&own).min(p_of_places / SHARE_OF_PLACES);
        changes.tried = own
            .iter()
            .map(|(&name, score)| Tried { name, gain_nats: score.gain.max(0.0), z: null.z(name, score) })
            .collect();
        changes.tried.extend(standing.iter().map(|(&name, best)| Tried {
            name,
            gain_nats: best.place.gain.max(0.0),
            z: best.z,
        }));
        changes.tried.sort_by(|a, b| b.gain_nats.total_cmp(&a.gain_nats));
        let floor = locsim_core::median(&mut distances);
        let mut named = Vec::new();
        if changes.p <= options.false_alarm {
            let is_noisier = self.neighbours.contrast(&assignment).map(|errors| errors > SURELY);
            let is_found = |kind: &EffectKind, score: &Score| {
                is_noise(*kind) && null.weight(*kind, score) > -options.false_alarm.ln()
            };
            if is_noisier == Some(false) && own.iter().any(|(kind, score)| is_found(kind, score)) {
                changes.notes.push(NOISE_OF_SCANS.to_owned());
            }
            let first = Round { tried, own, places: standing, floor, is_noisier };
            named = self.name(&first, &odometry, &null, &assignment, &known, changes)?;
        }
        if changes.p <= options.false_alarm {
            changes.losses_by_bearing = self.losses_by_bearing(&mut named, &known)?;
        }
        let before = self.distance(&known.learnt, &expected, &assignment);
        let with = |named: &[Named]| {
            let effects: Vec<Effect> = named.iter().map(|named| named.effect.clone()).collect();
            Ok::<_, GapError>(self.distance(&known.learnt, &self.expected_with(&effects)?, &assignment))
        };
        let mut after = with(&named)?;
        if moves_away([before, after, floor]) {
            named.retain(|named| is_of_odometry(named.name));
            after = with(&named)?;
        }
        changes.verdict = match (changes.p <= options.false_alarm, named.is_empty()) {
            (true, false) => ChangeVerdict::Changed,
            (true, true) => ChangeVerdict::Unexplained,
            (false, _) => ChangeVerdict::None,
        };
        changes.w1_mm = [before, after, floor];
        changes.effects = named;
        Ok(())
    }

    /// Losses by bearing, where they explain more than the effect that was named for lost returns, which then is no name.
    fn losses_by_bearing(
        &self,
        named: &mut Vec<Named>,
        known: &Known,
    ) -> Result<Option<LossesByBearing>, GapError> {
        let loss = named.iter().position(|named| named.name.loses_returns());
        let others = named.iter().enumerate().filter(|(index, _)| Some(*index) != loss);
        let given = Given::of(self.pool, others.map(|(_, named)| named.effect.clone()).collect());
        let expected = self.expected_with(&given.effects)?;
        let mut rival = vec![0.0; self.pool.stretches[1]];
        if let Some(loss) = loss {
            let log = self.log_density(&known.learnt, &expected);
            let is_today = self.true_assignment().is_today;
            let given = given.of_these(|effect| !is_of_odometry(effect.kind));
            let trial = Trial::new(self.pool, &given, named[loss].effect.clone(), &expected, None)?;
            rival = trial.gains(self.pool, &known.learnt, &log, &is_today);
        }
        let found = bearings::find(self.pool, known, &expected, &rival);
        if let (Some(_), Some(loss)) = (&found, loss) {
            named.remove(loss);
        }
        Ok(found)
    }

    fn true_assignment(&self) -> Assignment {
        let [first, all] = self.pool.stretches;
        Assignment {
            is_baseline: (0..all).map(|stretch| stretch < first).collect(),
            is_today: (0..all).map(|stretch| stretch >= first).collect(),
        }
    }

    fn odometry_trials(&self) -> Vec<Effect> {
        let trials = Increments::trials().into_iter();
        trials.filter(|effect| !self.options.without.contains(&effect.kind)).collect()
    }

    /// The best trial of each kind.
    fn best(&self, tried: &[Trial], odometry: &[Effect], assignment: &Assignment, known: &Known) -> Best {
        let expected = usual(self.pool);
        let compared = &expected[..self.pool.at_shared_places().len()];
        let log = self.log_density(&known.learnt, compared);
        let used = assignment.used();
        let mut best = Best::new();
        // Noise is known by neighbouring beams.
        let noise = self.neighbours.contrast(assignment);
        for (index, trial) in tried.iter().enumerate() {
            let gains = trial.gains(self.pool, &known.learnt, &log, &used);
            let gain = assignment.net(&gains, &gains).iter().sum();
            let noise = noise.filter(|_| is_noise(trial.effect.kind));
            let contrast = noise.unwrap_or_else(|| assignment.contrast(&gains));
            add(&mut best, trial.effect.kind, Score { gain, contrast, index });
        }
        for (index, effect) in odometry.iter().enumerate() {
            let gains = self.increments.gains(&known.usual, &[], effect, &used);
            let gain: f64 = assignment.net(&gains, &gains).iter().sum();
            let contrast = self.increments.contrast(&known.usual, &[], effect.kind, assignment);
            add(&mut best, effect.kind, score_of_odometry(&contrast, gain, tried.len() + index));
        }
        best
    }

    /// The best gains, and the distance of range errors \[mm\], where stretches are permuted.
    fn permute(
        &self,
        tried: &[Trial],
        odometry: &[Effect],
        permutations: Range<u32>,
    ) -> Result<(Vec<Best>, Vec<f64>), GapError> {
        self.progress.stage("permuting stretches", u64::from(permutations.end - permutations.start));
        let draw = Purpose::Permutations.draw(self.options.seed);
        let expected = usual(self.pool);
        let all = permutations
            .into_par_iter()
            .map(|i| {
                if self.stop.load(Ordering::Relaxed) {
                    return Err(GapError::Interrupted);
                }
                let mut assignment = self.true_assignment();
                assignment.is_baseline.shuffle(&mut draw.item(i));
                assignment.is_today = assignment.is_baseline.iter().map(|is_baseline| !is_baseline).collect();
                let known = self.learn(&assignment);
                let best = self.best(tried, odometry, &assignment, &known);
                self.progress.advance(1);
                Ok((best, self.distance(&known.learnt, &expected, &assignment)))
            })
            .collect::<Result<Vec<_>, _>>()?;
        Ok(all.into_iter().unzip())
    }

    /// Wasserstein-1 distance between errors of today's readings and what they are expected to be \[mm\].
    pub fn distance(&self, learnt: &Learnt, expected: &[Expected], assignment: &Assignment) -> f64 {
        let mut simulated = vec![0.0; ERROR_BINS];
        let mut measured = vec![0.0; ERROR_BINS];
        let max = self.pool.nominal.laser.max_range_m as f32;
        let mut count = 0.0;
        for (reading, expected) in self.pool.at_shared_places().iter().zip(expected) {
            if !assignment.is_today[reading.stretch as usize] || !reading.expected.mean.is_finite() {
                continue;
            }
            count += 1.0;
            learnt.add_errors(expected, reading.expected.mean, &mut simulated);
            let lost = reading.z >= max;
            let error = if lost { f64::INFINITY } else { f64::from(reading.z - reading.expected.mean) };
            measured[bin_of(error, ERROR_BINS)] += 1.0;
        }
        let (mut sum, mut distance) = (0.0, 0.0);
        for (measured, simulated) in measured.iter().zip(&simulated) {
            sum += measured - simulated;
            distance += sum.abs();
        }
        1e3 * ERROR_BIN_M * distance / f64::max(count, 1.0)
    }
}

/// To how many permutations the comparison goes on after so many; `None` where they are enough.
fn next_permutations(done: u32, p: f64, is_clearly_off: bool, options: &BaselineOptions) -> Option<u32> {
    let is_in_doubt = p <= DOUBTFUL && !is_clearly_off;
    match p {
        _ if p > PLAUSIBLE => None,
        _ if done < options.permutations => Some(options.permutations),
        _ if is_in_doubt && (SCREENING..IN_DOUBT).contains(&done) => Some(IN_DOUBT),
        _ => None,
    }
}

/// Whether ranges that are no farther off than those of stretches of the same log \[mm\] are so with effects.
fn moves_away([before, after, floor]: [f64; 3]) -> bool {
    /// The share of what stretches differ by that is much.
    const MUCH: f64 = 0.5;
    before <= floor && after > before + MUCH * floor
}

const NOISE_OF_SCANS: &str = "Readings are farther off than the baseline's, and neighbouring beams don't differ by more: whole scans are off, as \
                              where the reference errs by more. No noise is named for it.";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_permutations_are_made_where_they_can_change_the_answer() {
        let options = |permutations| BaselineOptions { permutations, ..BaselineOptions::default() };
        let next = |done, p, permutations| next_permutations(done, p, false, &options(permutations));
        // 399 are the default: the first 99 tell what is clear.
        assert_eq!((next(99, 0.05, 399), next(99, 0.2, 399)), (Some(399), None));
        assert_eq!(next(399, 0.02, 399), None);
        // Of 99 that were asked for none, or up to four, are beyond the log.
        assert_eq!(
            [0.01, 0.02, 0.05, 0.06].map(|p| next(99, p, 99)),
            [Some(399), Some(399), Some(399), None]
        );
        assert_eq!(next_permutations(99, 0.01, true, &options(99)), None);
        assert_eq!(next(999, 0.02, 999), None);
    }

    /// A laser that is said to be displaced by 1 cm, beside wheels that aren't alike; steps of 5 cm, which are right.
    #[test]
    fn ranges_move_away_where_they_were_near() {
        assert!(
            moves_away([6.9, 15.8, 8.9]) && !moves_away([10.3, 11.9, 8.8]) && !moves_away([6.9, 6.9, 8.9])
        );
    }
}
