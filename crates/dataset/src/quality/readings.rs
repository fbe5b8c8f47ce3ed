use locsim_core::{Drive, DriveStep, median, normal, quantile, wrap_angle};
use serde::Serialize;

/// Scans that the resolution is estimated from, at the most, evenly spread: some 100,000 readings.
const RESOLUTION_SCANS: usize = 500;
/// Fewer different readings don't show a step.
const LEAST_DIFFERENT: usize = 20;
/// Differences of quantized readings are whole steps to this share of a step.
const WHOLE: f64 = 0.1;
/// This share of the differences has to be whole steps; of readings that aren't quantized a fifth is, by chance.
const WHOLE_SHARE: f64 = 0.9;

/// The robot stands still while its odometry stays within this \[m\] and \[rad\] of where it was.
const STILL: (f64, f64) = (1e-3, 2e-3);
/// Scans of a stretch of standing still, at the most: in longer ones people come and go.
const MOST_STILL_SCANS: usize = 50;
/// Stretches that are looked at, at the most.
const STRETCHES: usize = 200;

/// Readings of a standing robot's beam that are off their median by more than so many standard deviations of the differences from scan to scan,
/// or steps, are of something that came or went.
const PASSING: f64 = 6.0;

/// Neighbours on a wall that are farther apart than this \[m\] have things between them, and the farther away the more of them: they don't tell
/// whether noise grows.
const NEIGHBOURS_M: f64 = 0.25;
/// Neighbouring readings that differ by more than this share aren't of one wall, or of a grazed one.
const ONE_WALL: f32 = 0.1;
/// Three neighbours on one wall: the middle one's residual has this many times the variance of a reading.
const RESIDUAL_VARIANCE: f64 = 1.5;
/// Bins of range that tell whether noise grows, the fewest of them, and the fewest deviations of one.
const BINS: usize = 8;
const LEAST_BINS: usize = 4;
const LEAST_OF_BIN: usize = 20;
/// Noise grows where it does by this share from the first bin to the last.
const LEAST_GROWTH: f64 = 0.3;
/// Readings in larger steps than this share of their noise don't tell whether it grows.
const FINE: f64 = 0.5;
/// Fewer residuals than this tell nothing.
const LEAST_RESIDUALS: usize = 500;
/// Readings that differ by no more than this share are about as long.
const AS_LONG: f32 = 0.01;
/// Fewer beams than this may read one number again and again.
const FEW_BEAMS: usize = 5;
/// A reading is behind the wall that its neighbours are of where it is longer by more than this \[m\].
const BEHIND_M: f32 = 0.5;

/// The laser's properties by the readings of a drive.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ReadingQuality {
    /// Share of readings without return.
    pub no_return_share: f64,
    /// Share of unusable readings (NaN).
    pub unusable_share: f64,
    /// Longest return \[m\].
    pub longest_return_m: Option<f64>,
    /// A far return \[m\] that most readings about as long are to the last digit, and their share of all readings: no returns, as a
    /// rule, below the maximum range that the log gives.
    pub repeated: Option<[f64; 2]>,
    /// Step of the readings \[m\]; `None` where they aren't quantized, or there are too few.
    pub resolution_m: Option<f64>,
    /// Number of scans in stretches in which the robot stood still.
    pub still_scans: usize,
    /// Standard deviation of a reading \[m\], without that of its rounding, from those stretches.
    pub still_noise_m: Option<f64>,
    /// Standard deviation of a reading \[m\] from neighbouring beams on flat walls, with that of its rounding: an upper
    /// bound, as walls aren't flat.
    pub flat_noise_m: Option<f64>,
    /// Constant part \[m\] of the standard deviation of a reading and its growth with range (m per m), by the same readings as
    /// [`noise_m`](Self::noise_m); `None` where it hardly grows.
    pub noise_by_range: Option<[f64; 2]>,
    /// Share of readings without return where both neighbours are of one wall: an upper bound of the share that any beam loses.
    pub lost_share: Option<f64>,
    /// Share of random readings, by those behind the wall that both neighbours are of, in the half of the room there that has fewer: an upper
    /// bound, as walls have gaps.
    pub random_share: Option<f64>,
}

impl ReadingQuality {
    /// Fewer scans on end of a robot that stands still tell no noise.
    pub const LEAST_STILL_SCANS: usize = 10;

    pub(super) fn of(drive: &Drive, has_odometry: bool) -> Self {
        let max = drive.laser.max_range();
        let all = drive.steps.iter().flat_map(|step| &step.scan.ranges);
        let (mut count, mut no_return, mut unusable, mut longest) = (0_usize, 0_usize, 0_usize, None);
        for &range in all {
            count += 1;
            no_return += usize::from(range >= max);
            unusable += usize::from(range.is_nan());
            if range < max {
                longest = Some(range.max(longest.unwrap_or(range)));
            }
        }
        let share = |part: usize| part as f64 / count.max(1) as f64;
        let resolution_m = resolution(drive);
        let (still_scans, still) = if has_odometry { still_noise(drive, resolution_m) } else { (0, None) };
        let flat = flat_noise(drive, resolution_m);
        let [lost_share, random_share] = stray_shares(drive).map_or([None; 2], |shares| shares.map(Some));
        Self {
            no_return_share: share(no_return),
            unusable_share: share(unusable),
            longest_return_m: longest.map(f64::from),
            repeated: longest
                .and_then(|longest| repeated(drive, longest))
                .map(|[at, times]| [at, share(times as usize)]),
            resolution_m,
            still_scans,
            still_noise_m: still.map(|noise| noise.sigma_m),
            flat_noise_m: flat.map(|noise| noise.sigma_m),
            noise_by_range: still.or(flat).and_then(|noise| noise.by_range),
            lost_share,
            random_share,
        }
    }

    /// The best estimate of the standard deviation of a reading \[m\].
    pub fn noise_m(&self) -> Option<f64> {
        self.still_noise_m.or(self.flat_noise_m)
    }
}

/// The standard deviation of a reading.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Noise {
    /// Of a typical reading \[m\].
    sigma_m: f64,
    /// Of the shortest ones \[m\].
    nearest_m: f64,
    /// See [`ReadingQuality::noise_by_range`].
    by_range: Option<[f64; 2]>,
}

impl Noise {
    /// By deviations, of which `sigma_of` is the standard deviation, and by those `samples` with their ranges \[m\] that tell whether it grows.
    fn of(all: &mut [f64], mut samples: Vec<[f64; 2]>, sigma_of: impl Fn(&mut [f64]) -> f64) -> Self {
        samples.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let bins =
            samples.chunks(samples.len().div_ceil(BINS).max(1)).filter(|bin| bin.len() >= LEAST_OF_BIN);
        let points: Vec<[f64; 2]> = bins
            .map(|bin| {
                let mut deviations: Vec<f64> = bin.iter().map(|[_, deviation]| *deviation).collect();
                [bin[bin.len() / 2][0], sigma_of(&mut deviations)]
            })
            .collect();
        let sigma_m = sigma_of(all);
        let nearest_m = points.first().map_or(sigma_m, |[_, sigma]| *sigma);
        Self { sigma_m, nearest_m, by_range: line(&points) }
    }

    /// What neighbours on walls tell of the laser, where readings are in steps \[m\].
    fn of_walls(self, step_m: f64) -> Self {
        // Near walls most neighbours are of one step, and seem to have no noise at all. Rounding alone is more.
        let rounding = step_m / 12.0_f64.sqrt();
        let [sigma_m, nearest_m] = [self.sigma_m, self.nearest_m].map(|sigma| sigma.max(rounding));
        match self.by_range {
            // The median of a few steps is a step.
            _ if step_m > FINE * sigma_m => Self { sigma_m, nearest_m, by_range: None },
            // The distance of neighbours on a wall, and what stands between them, grow with range, too: without a constant part it is that.
            Some([0.0, _]) => Self { sigma_m: nearest_m, nearest_m, by_range: None },
            by_range => Self { sigma_m, nearest_m, by_range },
        }
    }
}

/// Constant and slope of standard deviations over range, where they surely grow: by least squares of relative errors, neither below 0.
fn line(points: &[[f64; 2]]) -> Option<[f64; 2]> {
    let ([first, last], true) = ([points.first()?, points.last()?], points.len() >= LEAST_BINS) else {
        return None;
    };
    let sum = |of: &dyn Fn(f64, f64) -> f64| {
        points.iter().map(|[r, s]| of(*r, *s) / s.max(1e-6).powi(2)).sum::<f64>()
    };
    let (n, x, xx, y, xy) =
        (sum(&|_, _| 1.0), sum(&|r, _| r), sum(&|r, _| r * r), sum(&|_, s| s), sum(&|r, s| r * s));
    let slope = (n * xy - x * y) / (n * xx - x * x);
    let constant = (y - slope * x) / n;
    let [constant, slope] = if constant >= 0.0 { [constant, slope] } else { [0.0, xy / xx] };
    let grows = slope * (last[0] - first[0]) > LEAST_GROWTH * (constant + slope * first[0]);
    grows.then_some([constant, slope])
}

/// The return that most of those about as long are to the last digit, and how often it is read; none in the nearer half of the reach, and none
/// of a few beams alone, as of a robot that stands and a laser without noise.
fn repeated(drive: &Drive, longest: f32) -> Option<[f64; 2]> {
    let max = drive.laser.max_range();
    let all = drive.steps.iter().flat_map(|step| (0_u32..).zip(&step.scan.ranges));
    let far = all.filter(|(_, range)| **range < max && **range > 0.5 * longest);
    let mut far: Vec<(f32, u32)> = far.map(|(beam, range)| (*range, beam)).collect();
    far.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let most = far.chunk_by(|a, b| a.0 == b.0).max_by_key(|alike| alike.len())?;
    let at = most[0].0;
    let about = |factor: f32| far.partition_point(|(range, _)| *range < factor * at);
    let as_long = about(1.0 + AS_LONG) - about(1.0 - AS_LONG);
    let beams = most.chunk_by(|a, b| a.1 == b.1).count();
    (2 * most.len() > as_long && beams >= FEW_BEAMS).then(|| [f64::from(at), most.len() as f64])
}

/// The step that the differences of readings are multiples of.
fn resolution(drive: &Drive) -> Option<f64> {
    let max = drive.laser.max_range();
    let stride = drive.steps.len().div_ceil(RESOLUTION_SCANS).max(1);
    let mut readings: Vec<f32> = drive
        .steps
        .iter()
        .step_by(stride)
        .flat_map(|step| step.scan.ranges.iter().copied().filter(|range| *range < max))
        .collect();
    readings.sort_by(f32::total_cmp);
    readings.dedup();
    // Rounding to f32 is no difference.
    let rounding = |range: f32| 4.0 * f64::from(range * f32::EPSILON);
    let differences: Vec<(f64, f64)> = readings
        .windows(2)
        .map(|pair| (f64::from(pair[1]) - f64::from(pair[0]), rounding(pair[1])))
        .filter(|(difference, rounding)| difference > rounding)
        .collect();
    if differences.len() < LEAST_DIFFERENT {
        return None;
    }
    let mut lengths: Vec<f64> = differences.iter().map(|(difference, _)| *difference).collect();
    let rough = quantile(&mut lengths, 0.1);
    let single: Vec<f64> = lengths.into_iter().filter(|d| (d / rough - 1.0).abs() < WHOLE).collect();
    let step = single.iter().sum::<f64>() / single.len() as f64;
    let is_whole = |(difference, rounding): &&(f64, f64)| {
        (difference - (difference / step).round() * step).abs() <= (WHOLE * step).max(*rounding)
    };
    let whole = differences.iter().filter(is_whole).count();
    (whole as f64 >= WHOLE_SHARE * differences.len() as f64).then_some(step)
}

/// Number of scans that were taken standing still, and the median deviation of their readings.
fn still_noise(drive: &Drive, resolution_m: Option<f64>) -> (usize, Option<Noise>) {
    let stretches = still_stretches(&drive.steps);
    let scans = stretches.iter().map(|stretch| stretch.len()).sum();
    let max = drive.laser.max_range();
    let mut variances = Vec::new();
    let step_m = resolution_m.unwrap_or(0.0);
    let stride = stretches.len().div_ceil(STRETCHES).max(1);
    for stretch in stretches.iter().step_by(stride) {
        for beam in 0..drive.laser.beam_count() {
            let readings = stretch.iter().map(|step| step.scan.ranges[beam]);
            let returns: Vec<f64> = readings.filter(|range| *range < max).map(f64::from).collect();
            let of_surface = of_one_surface(&returns, step_m);
            if 2 * of_surface.len() > stretch.len() {
                let n = of_surface.len() as f64;
                let mean = of_surface.iter().sum::<f64>() / n;
                let squares: f64 = of_surface.iter().map(|range| (range - mean).powi(2)).sum();
                // The median of a sample's variance lies below the variance (Wilson and Hilferty).
                let of_median = (1.0 - 2.0 / (9.0 * (n - 1.0))).powi(3);
                variances.push([mean, squares / (n - 1.0) / of_median]);
            }
        }
    }
    if variances.is_empty() {
        return (scans, None);
    }
    let rounding = resolution_m.map_or(0.0, |step| step * step / 12.0);
    let mut all: Vec<f64> = variances.iter().map(|[_, variance]| *variance).collect();
    let sigma = |variances: &mut [f64]| (median(variances) - rounding).max(0.0).sqrt();
    (scans, Some(Noise::of(&mut all, variances, sigma)))
}

/// The returns of a standing robot's beam without those of what comes and goes, which are fewer than half.
fn of_one_surface(returns: &[f64], step_m: f64) -> Vec<f64> {
    let mut changes: Vec<f64> = returns.windows(2).map(|pair| (pair[1] - pair[0]).abs()).collect();
    if changes.is_empty() {
        return Vec::new();
    }
    let sigma = normal::SIGMA_OVER_MAD * median(&mut changes) / 2.0_f64.sqrt();
    let (middle, most) = (median(&mut returns.to_vec()), PASSING * sigma.max(step_m));
    returns.iter().copied().filter(|range| (range - middle).abs() <= most).collect()
}

/// Runs of scans during which the odometry doesn't change.
fn still_stretches(steps: &[DriveStep]) -> Vec<&[DriveStep]> {
    let (least, most) = (ReadingQuality::LEAST_STILL_SCANS, MOST_STILL_SCANS);
    let mut stretches = Vec::new();
    let mut from = 0;
    for to in 1..=steps.len() {
        let still = steps.get(to).is_some_and(|step| {
            let (here, there) = (step.odometry, steps[from].odometry);
            here.position().distance(there.position()) < STILL.0
                && wrap_angle(here.theta - there.theta).abs() < STILL.1
        });
        if !still || to - from == most {
            if to - from >= least {
                stretches.push(&steps[from..to]);
            }
            from = to;
        }
    }
    stretches
}

/// The deviation of readings from the line through their neighbours: on a flat wall, 1/r is linear in the sine and the cosine
/// of the bearing. Walls at an incidence of up to 45 degrees tell whether it grows: far ones are slanted, and their roughness shows.
fn flat_noise(drive: &Drive, resolution_m: Option<f64>) -> Option<Noise> {
    let max = drive.laser.max_range();
    let bearings = drive.laser.bearings();
    let stride = drive.steps.len().div_ceil(RESOLUTION_SCANS).max(1);
    let (mut residuals, mut facing) = (Vec::new(), Vec::new());
    for step in drive.steps.iter().step_by(stride) {
        for (ranges, bearings) in step.scan.ranges.windows(3).zip(bearings.windows(3)) {
            let &[left, middle, right] = ranges else { continue };
            let alike = |range: f32| (range - middle).abs() < ONE_WALL * middle;
            if middle > 0.0 && middle < max && alike(left) && alike(right) && left < max && right < max {
                let [left, middle, right] = [left, middle, right].map(f64::from);
                let apart = 0.5 * f64::from((bearings[2] - bearings[0]).abs());
                let on_line = 2.0 * apart.cos() / (1.0 / left + 1.0 / right);
                residuals.push((middle - on_line).abs());
                if (right - left).abs() <= 2.0 * apart * middle && apart * middle <= NEIGHBOURS_M {
                    facing.push([middle, (middle - on_line).abs()]);
                }
            }
        }
    }
    let sigma = |residuals: &mut [f64]| normal::SIGMA_OVER_MAD * median(residuals) / RESIDUAL_VARIANCE.sqrt();
    if residuals.len() < LEAST_RESIDUALS {
        return None;
    }
    // What stands before a wall is as long as the wall to a share of the range.
    let most = PASSING * sigma(&mut residuals);
    facing.retain(|[_, residual]| *residual <= most);
    Some(Noise::of(&mut residuals, facing, sigma).of_walls(resolution_m.unwrap_or(0.0)))
}

/// Shares of lost and of random readings between two neighbours on one wall that faces the laser (incidence up to 45 degrees). Random readings are
/// anywhere up to the maximum range. Those in front of a wall may be of things that stand there, and those behind it of what is seen through a
/// gap; that is as far as the next wall, so that of the nearer and the farther half of the room behind the one with fewer readings counts.
fn stray_shares(drive: &Drive) -> Option<[f64; 2]> {
    let max = drive.laser.max_range();
    let bearings = drive.laser.bearings();
    let (mut all, mut lost, mut behind, mut room) = (0_usize, 0_usize, [0_usize; 2], 0.0);
    for step in &drive.steps {
        for (ranges, bearings) in step.scan.ranges.windows(3).zip(bearings.windows(3)) {
            let &[left, middle, right] = ranges else { continue };
            let (nearer, farther) = (left.min(right), left.max(right));
            let apart = (bearings[2] - bearings[0]).abs();
            if nearer > 0.0
                && farther < max
                && !middle.is_nan()
                && farther - nearer <= (apart * farther).min(ONE_WALL * farther)
            {
                let beyond = farther + BEHIND_M;
                all += 1;
                lost += usize::from(middle >= max);
                if middle > beyond && middle < max {
                    behind[usize::from(middle > 0.5 * (beyond + max))] += 1;
                }
                room += f64::from((1.0 - beyond / max).max(0.0));
            }
        }
    }
    (all >= LEAST_RESIDUALS && room >= 1.0)
        .then(|| [lost as f64 / all as f64, (2.0 * behind[0].min(behind[1]) as f64 / room).min(1.0)])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Steps of 1 cm, which near neighbours are alike in: noise that seems to grow from nothing is that of the rounding.
    #[test]
    fn coarse_steps_are_noise_all_the_same() {
        let rounding = 0.01 / 12.0_f64.sqrt();
        let of = |sigma_m, nearest_m, by_range, step_m| {
            let Noise { sigma_m, by_range, .. } = Noise { sigma_m, nearest_m, by_range }.of_walls(step_m);
            (sigma_m, by_range)
        };
        assert_eq!(of(0.03, 0.0002, Some([0.0, 0.004]), 0.01), (rounding, None));
        assert_eq!(of(0.0002, 0.0002, None, 0.01), (rounding, None));
        // Fine steps tell noise and growth; a noise of two steps is the least that does.
        assert_eq!(of(0.03, 0.004, Some([0.0, 0.004]), 0.001), (0.004, None));
        assert_eq!(of(0.03, 0.004, Some([0.002, 0.004]), 0.001), (0.03, Some([0.002, 0.004])));
        assert_eq!(of(0.015, 0.004, Some([0.002, 0.004]), 0.01), (0.015, None));
    }
}
