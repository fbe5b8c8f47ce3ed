//! The scans of a bag: one laser's, though spinning lidars give a beam more or less.

use locsim_core::limits::{COORDINATE, Limits, READINGS_PER_SCAN, number, quoted};
use locsim_core::{Laser, LaserError, Pose2, resampled, wrap_angle};

use super::BagOptions;
use super::messages::{LaserScan, secs};
use super::poses::plain;
use super::stamped::Stamped;

/// The angle from the first beam of a scan to the last, at the most (rad): a turn, with the rounding of some drivers.
const WIDEST_SCAN: f64 = 1.05 * std::f64::consts::TAU;

/// The least angle between beams (rad): no lidar has finer ones.
const LEAST_STEP: f64 = 1e-6;

/// The last beam may be off `angle_max` by so many beams, and by this share of the sector: drivers leave out or add one.
const OTHER_END: (f64, f64) = (2.5, 0.02);

/// The ends of a scan are this near to those of the first, at the most (rad), and its number of beams differs by no more than this share
/// of theirs: spinning lidars give as many as a turn happened to have.
const OTHER_SECTOR: f64 = 0.1;
const MOST_OTHER_BEAMS: f64 = 0.1;

/// A sweep takes no longer than this share of the time between scans.
const LONGEST_SWEEP: f64 = 1.1;

/// What stands for no return is at least so many times as frequent as readings at the maximum range,
const TIMES_AS_FREQUENT: usize = 100;
/// and NaN at least one reading of so many: a few are too near, or unusable for another reason.
const ONE_OF: usize = 1000;
/// A beam is hidden if it has no reading in so many scans. Fewer scans don't tell what NaN means.
const LEAST_HIDDEN: usize = 20;
/// Filters take out the readings of so many beams between two surfaces at the most, which are farther apart than this (m).
const LONGEST_VEIL: usize = 3;
const LEAST_JUMP_M: f32 = 0.2;

/// Scans of fewer beams may have the same readings by chance.
const LEAST_COPIED: usize = 16;
/// More scans with one stamp have it for another reason than being recorded several times.
const MOST_COPIES: usize = 3;

/// How a driver writes readings that are none.
#[derive(Clone, Copy)]
pub struct Convention {
    pub min: f32,
    pub max: f32,
    /// What stands for no return beside the maximum range.
    pub no_return: NoReturn,
}

/// What a driver writes where nothing came back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoReturn {
    /// Infinity, or a range that isn't below the maximum.
    Above,
    /// 0.
    Zero,
    /// NaN.
    NotANumber,
}

impl NoReturn {
    /// What is said of it; nothing of what REP-117 asks for.
    pub fn evidence(self) -> Option<&'static str> {
        match self {
            Self::Above => None,
            Self::Zero => {
                Some("readings of 0 are taken for no return, as hardly another reading is without return")
            }
            Self::NotANumber => {
                Some("readings of NaN are taken for no return, as hardly another reading is without return")
            }
        }
    }
}

impl Convention {
    /// The reading as a drive has it: the maximum range without return, NaN where it isn't usable.
    pub fn reading(self, range: f32) -> f32 {
        let is_none = match self.no_return {
            NoReturn::Above => false,
            NoReturn::Zero => range == 0.0,
            NoReturn::NotANumber => range.is_nan(),
        };
        if range >= self.max || is_none {
            self.max
        } else if range.is_nan() || range < self.min || range == 0.0 {
            f32::NAN
        } else {
            range
        }
    }

    /// A reading of a drive as the driver would write it.
    pub fn written(self, reading: f32) -> f32 {
        if reading != self.max {
            return reading;
        }
        match self.no_return {
            NoReturn::Above => f32::INFINITY,
            NoReturn::Zero => 0.0,
            NoReturn::NotANumber => f32::NAN,
        }
    }
}

/// The scans of a bag.
#[derive(Default)]
pub struct Scans {
    /// The first scan, without readings.
    pub first: Option<LaserScan>,
    pub stamped: Stamped<Vec<f32>>,
    /// Readings of the scans, as the limit counts them.
    readings: u64,
    time_increments_secs: f64,
    /// Number of scans without readings, which aren't kept.
    pub empty: usize,
    /// Number of scans whose beams aren't those of the first.
    pub resampled_scans: usize,
    /// Number of scans that were recorded twice, which are left out.
    copies: usize,
    /// Whether the driver writes NaN: a beam that another scan lacks is NaN as well.
    writes_nan: bool,
}

impl Scans {
    /// Takes in a scan of the same laser as the first, recorded at this time (ns).
    pub fn push(&mut self, mut scan: LaserScan, logged: i64, limits: &Limits) -> Result<(), String> {
        let mut ranges = std::mem::take(&mut scan.ranges);
        ranges.shrink_to_fit();
        scan.intensities = Vec::new();
        self.readings += ranges.len() as u64 + READINGS_PER_SCAN;
        if self.readings > limits.log_readings {
            return Err(Limits::refusal_above("log_readings", limits.log_readings));
        }
        if ranges.is_empty() {
            self.empty += 1;
            return Ok(());
        }
        self.writes_nan |= ranges.iter().any(|range| range.is_nan());
        check_bearings(&scan, ranges.len())?;
        let beams = self.stamped.items.first().map_or(0, |(_, ranges)| ranges.len());
        let onto_first =
            self.first.as_ref().filter(|first| !are_same_beams(first, beams, &scan, ranges.len()));
        match onto_first.map(|first| on_beams_of(first, beams, &scan, &ranges)) {
            Some(Ok(moved)) => (ranges, self.resampled_scans) = (moved, self.resampled_scans + 1),
            // A first turn that isn't whole is no measure for the others.
            Some(Err(_)) if self.stamped.items.len() == 1 && ranges.len() > beams => {
                *self = Self { readings: self.readings, empty: self.empty + 1, ..Self::default() };
            }
            Some(Err(reason)) => return Err(reason),
            None => {}
        }
        if let Some(first) = &self.first {
            if scan.header.frame_id != first.header.frame_id {
                let (found, allowed) = (quoted(&scan.header.frame_id), quoted(&first.header.frame_id));
                return Err(format!("frame_id is `{found}`; allowed: `{allowed}`, as in the first"));
            }
            for (field, found, allowed) in [
                ("range_min", scan.range_min, first.range_min),
                ("range_max", scan.range_max, first.range_max),
            ] {
                // By bits: a NaN that stays is refused as a laser.
                if found.to_bits() != allowed.to_bits() {
                    let [found, allowed] = [found, allowed].map(number);
                    return Err(format!("{field} is {found}; allowed: {allowed}, as in the first"));
                }
            }
        }
        if !(0.0..=COORDINATE).contains(&f64::from(scan.time_increment.abs())) {
            let found = number(scan.time_increment);
            return Err(format!("time_increment is {found}; allowed: a finite number up to {COORDINATE:e}"));
        }
        self.time_increments_secs += f64::from(scan.time_increment);
        self.stamped.push(scan.header.stamp.nanos(), logged, ranges)?;
        self.first.get_or_insert(scan);
        Ok(())
    }

    /// Sorts by time, and leaves out copies where all scans of one time have the same readings.
    ///
    /// # Errors
    /// As [`Stamped::sort`].
    pub fn sort(&mut self) -> Result<(), String> {
        self.stamped.sort()?;
        let items = &mut self.stamped.items;
        let bits = |ranges: &[f32]| ranges.iter().map(|range| range.to_bits()).collect::<Vec<_>>();
        let of_one_time = || items.windows(2).filter(|pair| pair[0].0 == pair[1].0);
        let beams = items.first().map_or(0, |(_, ranges)| ranges.len());
        let are_few = items.windows(MOST_COPIES + 1).all(|run| run[0].0 < run[MOST_COPIES].0);
        let are_copies = |pair: &[(i64, Vec<f32>)]| bits(&pair[0].1) == bits(&pair[1].1);
        if beams >= LEAST_COPIED && are_few && of_one_time().all(are_copies) {
            let count = items.len();
            items.dedup_by_key(|(stamp, _)| *stamp);
            self.copies = count - items.len();
        }
        Ok(())
    }

    /// Mean time from a beam to the next (s).
    fn beam_interval(&self) -> f64 {
        self.time_increments_secs / (self.stamped.items.len() + self.copies).max(1) as f64
    }

    /// Whether a scan's beams, by their times, are over when the next scan begins. Scans may be stamped in pairs: their mean interval counts.
    fn has_plausible_sweep(&self) -> bool {
        let items = &self.stamped.items;
        let sweep = self.beam_interval() * items.first().map_or(0, |(_, ranges)| ranges.len()) as f64;
        let intervals = items.windows(2).filter(|pair| pair[1].0 > pair[0].0).count();
        let whole = items
            .first()
            .zip(items.last())
            .map_or(0.0, |((from, _), (to, _))| secs(to.saturating_sub(*from)));
        intervals == 0 || sweep.abs() <= LONGEST_SWEEP * whole / intervals as f64
    }

    /// What is odd about the scans, in sentences.
    pub fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        if self.resampled_scans > 0 {
            remarks.push(format!(
                "{} of {} scans have other beams than the first; their readings are interpolated at its bearings.",
                self.resampled_scans,
                self.stamped.items.len()
            ));
        }
        if self.copies > 0 {
            remarks.push(format!(
                "{} scans are copies of another, with its stamp and its readings: they are left out.",
                self.copies
            ));
        }
        let beams = self.stamped.items.first().map_or(0, |(_, ranges)| ranges.len());
        remarks.extend(self.first.as_ref().and_then(|first| other_end(first, beams)));
        if !self.has_plausible_sweep() {
            remarks.push(format!(
                "time_increment is {:.3e} s, with which the beams of a scan aren't over when the next one begins: all \
                 beams of a scan are taken to be of its stamp.",
                self.beam_interval()
            ));
        }
        remarks
    }

    /// The frame that the scans are in.
    pub fn frame(&self) -> &str {
        self.first.as_ref().map_or("", |first| plain(&first.header.frame_id))
    }

    /// What the driver writes for no return: 0, or else NaN, where one reading in a thousand is so and hardly one is infinite or at the maximum. Beams
    /// that never have another reading are those that the robot itself hides, and don't count. Nor is NaN no return where most of it stands
    /// between a near surface and a far one: filters take such readings out.
    pub fn no_return(&self, max: f32) -> NoReturn {
        let scans: Vec<&[f32]> = self.stamped.items.iter().map(|(_, ranges)| ranges.as_slice()).collect();
        let above = scans.iter().flat_map(|ranges| ranges.iter()).filter(|range| **range >= max).count();
        let beams = scans.first().map_or(0, |ranges| ranges.len());
        let frequency = |of: &dyn Fn(f32) -> bool| {
            let counts = (0..beams).map(|beam| scans.iter().filter(|ranges| of(ranges[beam])).count());
            let some = counts.filter(|count| *count < scans.len() || scans.len() < LEAST_HIDDEN);
            some.sum::<usize>()
        };
        let [zeros, nans] = [frequency(&|range| range == 0.0), frequency(&f32::is_nan)];
        let is_frequent =
            |count: usize| count > TIMES_AS_FREQUENT * above && ONE_OF * count >= beams * scans.len();
        if is_frequent(zeros) {
            NoReturn::Zero
        } else if self.writes_nan
            && is_frequent(nans)
            && scans.len() >= LEAST_HIDDEN
            && !are_between_surfaces(&scans)
        {
            NoReturn::NotANumber
        } else {
            NoReturn::Above
        }
    }

    /// The laser that the scans describe; `mirrored` where it hangs upside down.
    pub fn laser(
        &self,
        base_from_laser: Pose2,
        mirrored: bool,
        options: &BagOptions,
    ) -> Result<Laser, LaserError> {
        let first = self.first.as_ref().ok_or(LaserError::NoBeams)?;
        let beams = self.stamped.items.first().map_or(0, |(_, ranges)| ranges.len());
        let side = if mirrored { -1.0 } else { 1.0 };
        let interval = if self.has_plausible_sweep() { self.beam_interval() } else { 0.0 };
        let row =
            |start: f32, step: f64| (0..beams).map(move |i| (f64::from(start) + i as f64 * step) as f32);
        Laser::new(
            row(first.angle_min, f64::from(first.angle_increment)).map(|bearing| side * bearing).collect(),
            row(0.0, interval).collect(),
            options.min_range_m.unwrap_or(first.range_min),
            options.max_range_m.unwrap_or(first.range_max),
            base_from_laser,
        )
    }
}

/// Whether most readings of NaN, in runs of three at most, are between two surfaces that are apart along the beam.
fn are_between_surfaces(scans: &[&[f32]]) -> bool {
    let [mut all, mut between] = [0, 0];
    for ranges in scans {
        let mut last: Option<usize> = None;
        for (beam, range) in ranges.iter().enumerate().filter(|(_, range)| !range.is_nan()) {
            let missing = last.map_or(beam, |last| beam - last - 1);
            let is_jump = last.is_some_and(|last| (ranges[last] - range).abs() > LEAST_JUMP_M);
            all += missing;
            between += if is_jump && missing <= LONGEST_VEIL { missing } else { 0 };
            last = Some(beam);
        }
        all += last.map_or(ranges.len(), |last| ranges.len() - last - 1);
    }
    2 * between > all
}

/// Whether a scan has the beams of the first, by bits.
fn are_same_beams(first: &LaserScan, beams: usize, scan: &LaserScan, count: usize) -> bool {
    count == beams
        && scan.angle_min.to_bits() == first.angle_min.to_bits()
        && scan.angle_increment.to_bits() == first.angle_increment.to_bits()
}

/// The readings of a scan on the beams of the first, by [`resampled`].
///
/// # Errors
/// The beams are of another sector, or much fewer or more.
fn on_beams_of(
    first: &LaserScan,
    beams: usize,
    scan: &LaserScan,
    ranges: &[f32],
) -> Result<Vec<f32>, String> {
    let ends = |scan: &LaserScan, count: usize| {
        let start = f64::from(scan.angle_min);
        [start, start + (count as f64 - 1.0) * f64::from(scan.angle_increment)]
    };
    let apart = ends(first, beams).into_iter().zip(ends(scan, ranges.len())).map(|(a, b)| (a - b).abs());
    let is_near = apart.fold(0.0, f64::max) <= OTHER_SECTOR;
    if !is_near || ranges.len().abs_diff(beams) as f64 > MOST_OTHER_BEAMS * beams as f64 {
        return Err(format!(
            "the scan has {} ranges from {} rad, every {} rad; allowed: about {beams} from {}, every {}, as in the first",
            ranges.len(),
            scan.angle_min,
            scan.angle_increment,
            first.angle_min,
            first.angle_increment
        ));
    }
    let bearings: Vec<f32> = (0..beams).map(|beam| bearing(first, beam) as f32).collect();
    let readings = ranges.iter().enumerate().map(|(beam, range)| (bearing(scan, beam), *range));
    let is_return = |range: f32| range > 0.0 && range < scan.range_max;
    Ok(resampled(readings, is_return, &bearings))
}

/// What is said of a scan whose `angle_max` isn't where its beams end.
fn other_end(scan: &LaserScan, beams: usize) -> Option<String> {
    let step = f64::from(scan.angle_increment);
    let end = bearing(scan, beams.saturating_sub(1));
    let apart = wrap_angle(f64::from(scan.angle_max) - end).abs();
    let sector = (end - f64::from(scan.angle_min)).abs();
    (beams > 1 && apart > (OTHER_END.0 * step.abs()).max(OTHER_END.1 * sector)).then(|| {
        format!(
            "angle_max is {:.4} rad, and {beams} ranges from angle_min {:.4} rad on, every angle_increment {step:.6} rad, end at {end:.4} rad. \
             The increment and the number of ranges are used. If the map comes out inconsistent, they are wrong.",
            scan.angle_max, scan.angle_min
        )
    })
}

/// Bearing of a beam (rad).
fn bearing(scan: &LaserScan, beam: usize) -> f64 {
    f64::from(scan.angle_min) + beam as f64 * f64::from(scan.angle_increment)
}

/// Refuses scans whose beams don't lie beside each other within a turn.
fn check_bearings(scan: &LaserScan, beams: usize) -> Result<(), String> {
    let step = f64::from(scan.angle_increment);
    let most = WIDEST_SCAN / (beams as f64 - 1.0);
    if beams > 1 && !(LEAST_STEP..=most).contains(&step.abs()) {
        return Err(format!(
            "angle_increment is {:?} rad; allowed: {LEAST_STEP} to {most:.6} either way, for {beams} ranges within a turn",
            scan.angle_increment
        ));
    }
    if !(-WIDEST_SCAN..=WIDEST_SCAN).contains(&f64::from(scan.angle_min)) {
        let found = scan.angle_min;
        return Err(format!("angle_min is {found} rad; allowed: up to {WIDEST_SCAN:.3} either way, a turn"));
    }
    Ok(())
}
