//! Whether random readings fall behind walls as well as in front of them: what stands or walks before walls is in front alone.

use std::collections::HashMap;

use locsim_world::effect::Effect;

use super::pool::Pool;

/// A reading is behind a wall where it is farther than the map has it by so much \[m\].
const BEHIND_M: f64 = 0.2;
/// Today's log has at least this share of what an effect predicts there,
const LEAST_SHARE: f64 = 0.5;
/// where it predicts so many standard deviations more than the baseline has.
const CLEAR: f64 = 3.0;

/// Readings of beams that meet a wall.
#[derive(Clone, Copy, Default)]
struct Behind {
    /// All.
    count: f64,
    /// Those behind the wall.
    behind: f64,
    /// How many would be there if all were random.
    room: f64,
}

impl Behind {
    /// Whether today's readings behind walls are as many more than the baseline's as a share `p` of random ones makes.
    fn grew_by(self, today: Self, p: f64) -> bool {
        let usual = self.behind / self.count.max(1.0) * today.count;
        let predicted = p * today.room;
        let is_clear = predicted > CLEAR * (usual + predicted).sqrt();
        !is_clear || today.behind - usual >= LEAST_SHARE * predicted
    }
}

/// Whether today's log has the readings behind walls that an effect of random readings predicts; so where they are too few to tell. `lasting` are
/// the probabilities that bursts last in each window of time.
pub(super) fn are_behind_as_well(
    pool: &Pool<'_>,
    effect: &Effect,
    lasting: Option<&HashMap<u32, f64>>,
) -> bool {
    let bursts = effect.bursts();
    let while_they_last = bursts.map(|bursts| if lasting.is_some() { bursts.on } else { bursts.spread });
    let Some(p) = while_they_last.as_ref().unwrap_or(effect).value("p") else { return true };
    let max = pool.nominal.laser.max_range_m;
    let mut logs = [Behind::default(); 2];
    for reading in pool.at_shared_places() {
        let (from, z) = (f64::from(reading.expected.mean) + BEHIND_M, f64::from(reading.z));
        if from < max {
            let weight = match lasting {
                Some(of_window) if reading.log == 1 => of_window.get(&reading.window).copied().unwrap_or(0.0),
                _ => 1.0,
            };
            let of = &mut logs[reading.log];
            of.count += weight;
            of.behind += if z > from && z < max { weight } else { 0.0 };
            of.room += weight * (1.0 - from / max);
        }
    }
    let [baseline, today] = logs;
    baseline.grew_by(today, p)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 10,000 readings with half of the range behind walls: 5 % of random ones make 250 there. Two people who walk by make none.
    #[test]
    fn random_readings_are_behind_walls_as_well() {
        let log = |behind: f64| Behind { count: 10_000.0, behind, room: 5_000.0 };
        let baseline = log(20.0);
        assert!(baseline.grew_by(log(270.0), 0.05) && baseline.grew_by(log(150.0), 0.05));
        assert!(!baseline.grew_by(log(20.0), 0.05) && !baseline.grew_by(log(140.0), 0.05));
        // Ten readings more are no more than chance.
        assert!(baseline.grew_by(log(20.0), 0.002));
    }
}
