//! Registered NP-REG and the likelihood field as one learnt density.

use std::collections::BTreeMap;
use std::f32::consts::FRAC_PI_2;
use std::sync::Arc;

use locsim_core::{Beams, CAST_REACH, DependsOn, DistanceMap, Draw, SensorModel};
use rand::RngExt;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::axis::Axis;
use crate::beam::{Beam, beam_at, cdfs, log_density, samples};
use crate::binned::kernel;
use crate::field::{Profile, end_of};
use crate::{ModelKind, SensorError, TrainingSet};

/// Bins of incidence, 30 degrees each.
const INCIDENCES: usize = 3;
/// Walls that beams hardly ever pass, and those that more than one beam in twenty passed when the map was made: glass, doors, what
/// stood there for a while.
const SOLIDITIES: usize = 2;
const SOLID_SHARE: f32 = 0.95;
/// Bins of nominal range: beyond the maximum range, then by halves of it; the last is below a 32nd.
const RANGES: usize = 7;
/// Classes of beams: those that meet a wall, those that leave what is known, those that meet nothing.
const WALLS: usize = RANGES * INCIDENCES * SOLIDITIES;
const CLASSES: usize = WALLS + RANGES + 1;
/// Where each group of classes begins and ends. The classes of a group lean on the group.
const GROUPS: [std::ops::Range<usize>; 3] = [0..WALLS, WALLS..WALLS + RANGES, WALLS + RANGES..CLASSES];

/// Bins of one centimetre, a fifth of the cells in which distances are computed, near nominal range and surface.
const QUANTUM_M: f32 = 0.01;
/// Distances that are told apart \[m\]: those of a distance grid saturate there.
const FARTHEST_M: f32 = 2.0;
/// Steps of the integral over a beam are at most this long \[m\]: a cell of the distances.
const STEP_M: f32 = 0.05;
/// The integral is taken over at most this many training beams, evenly chosen.
const MOST_BEAMS: usize = 16_000;

/// Directions of so many bearings are computed at once, for all poses.
const BEARINGS_AT_ONCE: usize = 64;

/// Logs of densities that a file may hold: their integral over a beam neither overflows nor vanishes.
const LOGS: std::ops::RangeInclusive<f32> = -80.0..=40.0;

/// Candidates for the bandwidth over offset and distance, in bins.
const BANDWIDTHS: [f32; 4] = [0.5, 1.0, 2.0, 4.0];
/// Candidates for the weight of the coarser density, in readings.
const PSEUDO_COUNTS: [f32; 4] = [1.0, 4.0, 16.0, 64.0];

/// Readings counted by their offset from the nominal range *and* by the distance of their end to the nearest surface, per
/// metre of beam that lies at this offset and distance.
///
/// With u = z - r and d the distance of the reading's end, p(z | beam) = lambda(class, u, d): a piecewise constant
/// intensity, readings over metres. Its integral along the beam, averaged over the training beams of a class, is the share
/// of returns; along a single beam it is not exactly that. `cdf` and `sample` are normalized along the beam by quadrature.
///
/// A class with few readings leans on the intensity of all classes of its group over (u, d), this one on the
/// intensity over d alone, which is a learnt likelihood field, and that on the mean intensity. Each is a
/// gamma-Poisson estimate (n + k) / (metres + k / coarser intensity).
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(try_from = "Parts")]
pub(crate) struct Intensity(Parts);

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Parts {
    /// Maximum range of the sensor \[m\].
    max_range: f32,
    /// Bins of z - r.
    offset: Axis,
    /// Bins of the distance to the nearest surface.
    distance: Axis,
    /// ln of readings per metre \[class\]\[offset\]\[distance\].
    log_density: Vec<f32>,
    /// ln of the share of beams without return \[class\].
    log_no_return: Vec<f32>,
}

impl TryFrom<Parts> for Intensity {
    type Error = String;

    fn try_from(parts: Parts) -> Result<Self, String> {
        let bins = [parts.offset.bins(), parts.distance.bins()];
        let expected = [CLASSES * bins[0] * bins[1], CLASSES];
        let found = [parts.log_density.len(), parts.log_no_return.len()];
        if found != expected {
            return Err(format!("tables of {found:?} values are not allowed; {expected:?}"));
        }
        let mut values = parts.log_density.iter().chain(&parts.log_no_return);
        if let Some(value) = values.find(|value| !LOGS.contains(*value)) {
            let (least, most) = LOGS.into_inner();
            return Err(format!("the log density {value} is not allowed; from {least} to {most}"));
        }
        if let Some(value) = parts.log_no_return.iter().find(|value| **value > 0.0) {
            return Err(format!("{value} is not allowed as the log of a share"));
        }
        Ok(Self(parts))
    }
}

impl Intensity {
    /// Maximum range of the sensor \[m\].
    pub fn max_range(&self) -> f32 {
        self.0.max_range
    }

    #[inline]
    fn at(&self, class: usize, offset: f32, distance: f32) -> f32 {
        let Parts { offset: offsets, distance: distances, log_density, .. } = &self.0;
        let row = class * offsets.bins() + offsets.bin(offset);
        log_density[row * distances.bins() + distances.bin(distance)]
    }
}

/// What a beam's class depends on besides the beam: the map, and where bins of nominal range begin.
struct Classes<'a> {
    map: &'a dyn DistanceMap,
    /// Nominal ranges from here on meet nothing \[m\].
    open: f32,
    /// Upper ends of all bins of nominal range but the first \[m\].
    nearer: [f32; RANGES - 1],
}

impl<'a> Classes<'a> {
    fn new(max_range: f32, map: &'a dyn DistanceMap) -> Self {
        let nearer = std::array::from_fn(|i| max_range / (1_u32 << i) as f32);
        Self { map, open: CAST_REACH * max_range, nearer }
    }

    /// The class of a beam that meets `surface`.
    #[inline]
    fn of(&self, beam: &Beam, surface: u32) -> usize {
        if beam.nominal >= self.open {
            return CLASSES - 1;
        }
        let range = self.nearer.iter().map(|nearer| usize::from(beam.nominal < *nearer)).sum::<usize>();
        if self.map.is_unknown(surface) {
            return WALLS + range;
        }
        let incidence = (beam.incidence * (INCIDENCES as f32 / FRAC_PI_2)) as usize;
        let passed = usize::from(self.map.hit_share(surface) < SOLID_SHARE);
        (range * INCIDENCES + incidence.min(INCIDENCES - 1)) * SOLIDITIES + passed
    }
}

/// Fits the intensity. Bandwidth and weights of the coarser densities minimize the log loss on `held_out`.
pub(crate) fn fit(
    train: &TrainingSet,
    held_out: &TrainingSet,
    map: &dyn DistanceMap,
) -> Result<(Intensity, BTreeMap<String, f64>), SensorError> {
    let max_range = train.max_range();
    if !train.readings().any(|(z, _)| z < max_range) {
        let model = ModelKind::NpRegField;
        return Err(SensorError::TooFewData { model, what: "no reading below the maximum range" });
    }
    let axes = Axes {
        offset: Axis::around_zero(CAST_REACH * max_range, QUANTUM_M, max_range),
        distance: Axis::from_zero(FARTHEST_M, QUANTUM_M),
    };
    let tally = Tally::of(train, &axes, map);
    let places: Vec<(usize, Option<usize>)> = axes.places(held_out, map);
    let mut best: Option<(f64, Table, [f32; 3])> = None;
    for bandwidth in BANDWIDTHS {
        let smoothed = tally.smoothed(&axes, bandwidth);
        for group in PSEUDO_COUNTS {
            for class in PSEUDO_COUNTS {
                let table = smoothed.table(&tally, &axes, group, class);
                let loss = table.log_loss(&places);
                if best.as_ref().is_none_or(|(least, ..)| loss < *least) {
                    best = Some((loss, table, [bandwidth, group, class]));
                }
            }
        }
    }
    let (loss, table, [bandwidth, group, class]) = best.expect("there are candidates");
    let chosen = [
        ("bandwidth_bins", f64::from(bandwidth)),
        ("pseudo_count_group", f64::from(group)),
        ("pseudo_count_class", f64::from(class)),
        ("held_out_log_loss_nats", loss),
    ];
    let Axes { offset, distance } = axes;
    let Table { log_density, log_no_return } = table;
    let parts = Parts { max_range, offset, distance, log_density, log_no_return };
    let model = Intensity::try_from(parts).expect("intensities are positive");
    Ok((model, chosen.map(|(name, value)| (name.to_owned(), value)).into()))
}

struct Axes {
    offset: Axis,
    distance: Axis,
}

impl Axes {
    /// Bins of a class.
    fn bins(&self) -> usize {
        self.offset.bins() * self.distance.bins()
    }

    fn bin(&self, offset: f32, distance: f32) -> usize {
        self.offset.bin(offset) * self.distance.bins() + self.distance.bin(distance)
    }

    /// Class and bin of every reading; no bin without return.
    fn places(&self, data: &TrainingSet, map: &dyn DistanceMap) -> Vec<(usize, Option<usize>)> {
        let mut places = Vec::with_capacity(data.reading_count());
        let classes = Classes::new(data.max_range(), map);
        for i in 0..data.len() {
            let beam = data.beam(i);
            let class = classes.of(&beam, data.state(i).surface);
            let direction = data.heading(i).sin_cos();
            places.extend(data.observations(i).iter().map(|&z| {
                let bin = (z < beam.max_range).then(|| {
                    let [x, y] = end_of(data.pose(i), direction, z);
                    self.bin(z - beam.nominal, map.distance(x, y))
                });
                (class, bin)
            }));
        }
        places
    }
}

/// Readings and metres of beam, by class and bin.
struct Tally {
    counts: Vec<f32>,
    metres: Vec<f32>,
    /// Readings, and those without return, by class.
    readings: Vec<f32>,
    no_returns: Vec<f32>,
}

impl Tally {
    fn of(train: &TrainingSet, axes: &Axes, map: &dyn DistanceMap) -> Self {
        let size = CLASSES * axes.bins();
        let mut counts = vec![0.0; size];
        let (mut readings, mut no_returns) = (vec![0.0; CLASSES], vec![0.0; CLASSES]);
        for (class, bin) in axes.places(train, map) {
            readings[class] += 1.0;
            match bin {
                Some(bin) => counts[class * axes.bins() + bin] += 1.0,
                None => no_returns[class] += 1.0,
            }
        }
        // Beams are integrated over in a fixed number of parts, so that the sums don't depend on threads.
        let stride = train.len().div_ceil(MOST_BEAMS).max(1);
        let chosen: Vec<usize> = (0..train.len()).step_by(stride).collect();
        let parts: Vec<Vec<f32>> = chosen
            .par_chunks(chosen.len().div_ceil(8))
            .map(|beams| {
                let mut metres = vec![0.0; size];
                for &i in beams {
                    axes.add_metres(train, i, stride as f32, map, &mut metres);
                }
                metres
            })
            .collect();
        let mut metres = vec![0.0; size];
        for part in parts {
            metres.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
        }
        Self { counts, metres, readings, no_returns }
    }

    /// Counts and metres smoothed by the same Gaussian over offset and distance.
    fn smoothed(&self, axes: &Axes, bandwidth: f32) -> Self {
        let kernel = kernel(bandwidth);
        let smooth = |values: &[f32]| {
            let mut out = values.to_vec();
            out.par_chunks_mut(axes.bins()).for_each(|class| axes.smooth(&kernel, class));
            out
        };
        Self {
            counts: smooth(&self.counts),
            metres: smooth(&self.metres),
            readings: self.readings.clone(),
            no_returns: self.no_returns.clone(),
        }
    }
}

impl Axes {
    /// Adds the metres of a training beam, once for each of its readings and `weight` times.
    fn add_metres(
        &self,
        train: &TrainingSet,
        i: usize,
        weight: f32,
        map: &dyn DistanceMap,
        metres: &mut [f32],
    ) {
        let beam = train.beam(i);
        let class = Classes::new(train.max_range(), map).of(&beam, train.state(i).surface);
        let direction = train.heading(i).sin_cos();
        let weight = weight * train.observations(i).len() as f32;
        for u in 0..self.offset.bins() {
            let from = (self.offset.lower(u) + beam.nominal).max(0.0);
            let to = (self.offset.upper(u) + beam.nominal).min(beam.max_range);
            if to <= from {
                continue;
            }
            let steps = ((to - from) / STEP_M).ceil().max(1.0);
            let step = (to - from) / steps;
            for s in 0..steps as usize {
                let [x, y] = end_of(train.pose(i), direction, from + (s as f32 + 0.5) * step);
                let d = self.distance.bin(map.distance(x, y));
                metres[class * self.bins() + u * self.distance.bins() + d] += weight * step;
            }
        }
    }

    /// Smooths one class in place, over distance and over offset.
    fn smooth(&self, kernel: &[f32], class: &mut [f32]) {
        let distances = self.distance.bins();
        let mut line = Vec::new();
        for row in class.chunks_mut(distances) {
            smooth_line(kernel, row.iter_mut(), &mut line);
        }
        for d in 0..distances {
            smooth_line(kernel, class[d..].iter_mut().step_by(distances), &mut line);
        }
    }
}

fn smooth_line<'a>(kernel: &[f32], values: impl Iterator<Item = &'a mut f32>, line: &mut Vec<f32>) {
    let values: Vec<&mut f32> = values.collect();
    line.clear();
    line.extend(values.iter().map(|value| **value));
    if line.iter().all(|value| *value == 0.0) {
        return;
    }
    for (i, value) in values.into_iter().enumerate() {
        let near = i.saturating_sub(kernel.len() - 1)..(i + kernel.len()).min(line.len());
        *value = near.map(|j| kernel[i.abs_diff(j)] * line[j]).sum();
    }
}

/// ln of densities, as in [`Parts`].
struct Table {
    log_density: Vec<f32>,
    log_no_return: Vec<f32>,
}

impl Tally {
    /// Intensities of smoothed counts; `raw` has the same unsmoothed.
    fn table(&self, raw: &Self, axes: &Axes, group_count: f32, class_count: f32) -> Table {
        let (bins, distances) = (axes.bins(), axes.distance.bins());
        let mut log_density = vec![0.0; CLASSES * bins];
        let mut log_no_return = vec![0.0; CLASSES];
        let total = |values: &[f32]| values.iter().map(|v| f64::from(*v)).sum::<f64>() as f32;
        // One reading more, in as many metres as one beam has, so that nothing is impossible.
        let mean = (total(&self.counts) + 1.0) / (total(&self.metres) + 1.0);
        let mut field = vec![[0.0_f32; 2]; distances];
        for (i, (count, metres)) in self.counts.iter().zip(&self.metres).enumerate() {
            field[i % distances][0] += count;
            field[i % distances][1] += metres;
        }
        let shrunk = |[count, metres]: [f32; 2], k: f32, coarser: f32| (count + k) / (metres + k / coarser);
        let field: Vec<f32> = field.into_iter().map(|cell| shrunk(cell, group_count, mean)).collect();
        for group in GROUPS {
            let mut pooled = vec![[0.0_f32; 2]; bins];
            for class in group.clone() {
                let here = class * bins..(class + 1) * bins;
                for (cell, (count, metres)) in
                    pooled.iter_mut().zip(self.counts[here.clone()].iter().zip(&self.metres[here]))
                {
                    cell[0] += count;
                    cell[1] += metres;
                }
            }
            let pooled: Vec<f32> = pooled
                .into_iter()
                .enumerate()
                .map(|(bin, cell)| shrunk(cell, group_count, field[bin % distances]))
                .collect();
            let no_returns = total(&self.no_returns[group.clone()]);
            let share = (no_returns + 0.5) / (total(&self.readings[group.clone()]) + 1.0);
            for class in group {
                let here = class * bins..(class + 1) * bins;
                let readings = self.readings[class];
                let no_return = (self.no_returns[class] + class_count * share) / (readings + class_count);
                let mut expected = 0.0;
                for (bin, i) in here.clone().enumerate() {
                    let density = shrunk([self.counts[i], self.metres[i]], class_count, pooled[bin]);
                    expected += f64::from(density * raw.metres[i]);
                    log_density[i] = density;
                }
                // As many returns on average as there are.
                let returns = (1.0 - no_return) * readings;
                let scale = (returns + class_count) / (expected as f32 + class_count);
                for value in &mut log_density[here] {
                    *value = (*value * scale).ln();
                }
                log_no_return[class] = no_return.ln();
            }
        }
        Table { log_density, log_no_return }
    }
}

impl Table {
    /// Mean of -ln p \[nats\].
    fn log_loss(&self, places: &[(usize, Option<usize>)]) -> f64 {
        let bins = self.log_density.len() / CLASSES;
        let log = |&(class, bin): &(usize, Option<usize>)| match bin {
            Some(bin) => self.log_density[class * bins + bin],
            None => self.log_no_return[class],
        };
        -places.iter().map(|place| f64::from(log(place))).sum::<f64>() / places.len() as f64
    }
}

/// The model over a map.
pub(crate) struct NpRegField {
    pub intensity: Intensity,
    pub map: Arc<dyn DistanceMap>,
}

impl NpRegField {
    /// The running integral of the density along beam `i`, from 0 to the share of returns.
    fn profile(&self, beams: &Beams<'_>, i: usize, beam: &Beam) -> Profile {
        let class = Classes::new(beams.max_range, &*self.map).of(beam, beams.surface[i]);
        let no_return = self.intensity.0.log_no_return[class].exp();
        Profile::along(beams, i, 1.0 - no_return, |z, x, y| {
            self.intensity.at(class, z - beam.nominal, self.map.distance(x, y)).exp()
        })
    }
}

impl SensorModel for NpRegField {
    fn name(&self) -> &str {
        ModelKind::NpRegField.as_str()
    }

    fn depends_on(&self) -> DependsOn {
        DependsOn::Everything
    }

    fn log_density(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]) {
        let k = beams.per_pose();
        let classes = Classes::new(beams.max_range, &*self.map);
        let Intensity(Parts { log_no_return, .. }) = &self.intensity;
        let mut directions = [(0.0, 1.0); BEARINGS_AT_ONCE];
        for first in (0..k).step_by(BEARINGS_AT_ONCE) {
            let bearings = &beams.bearings[first..k.min(first + BEARINGS_AT_ONCE)];
            for (direction, bearing) in directions.iter_mut().zip(bearings) {
                *direction = locsim_core::sin_cos(f64::from(*bearing));
            }
            for pose in 0..beams.poses() {
                let laser = beams.laser.get(pose);
                let (sin, cos) = laser.theta.sin_cos();
                for (bearing, &(s, c)) in (first..).zip(&directions[..bearings.len()]) {
                    let i = pose * k + bearing;
                    out[i] = log_density(z[bearing], &beam_at(beams, pose, bearing), |z, beam| {
                        let class = classes.of(beam, beams.surface[i]);
                        if z >= beam.max_range {
                            return log_no_return[class];
                        }
                        let direction = (sin * c + cos * s, cos * c - sin * s);
                        let [x, y] = end_of(laser, direction, z);
                        self.intensity.at(class, z - beam.nominal, self.map.distance(x, y))
                    });
                }
            }
        }
    }

    fn cdf(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]) {
        let k = beams.per_pose();
        // Readings of one beam, as an evaluation asks for, share its profile.
        let mut profiled: Option<((usize, f32, f32), Profile)> = None;
        cdfs(z, beams, out, |z, beam| {
            let key = (beam.pose, beams.bearings[beam.bearing], beam.nominal);
            if profiled.as_ref().is_none_or(|(profiled, _)| *profiled != key) {
                profiled = Some((key, self.profile(beams, beam.pose * k + beam.bearing, &beam)));
            }
            profiled.as_ref().map_or(0.0, |(_, profile)| profile.below(z / beam.max_range))
        });
    }

    fn sample(&self, beams: &Beams<'_>, draw: &Draw, out: &mut [f32]) {
        let k = beams.per_pose();
        samples(beams, draw, out, |beam, rng| {
            let profile = self.profile(beams, beam.pose * k + beam.bearing, &beam);
            profile.quantile(rng.random::<f32>()).map_or(beam.max_range, |share| share * beam.max_range)
        });
    }
}

#[cfg(test)]
mod tests {
    use locsim_core::{Hits, Particles, Pose2, Stage};

    use super::*;
    use crate::BeamState;

    const MAX_RANGE: f32 = 8.0;
    const BORDER: u32 = 7;
    const GLASS: u32 = 3;

    /// A wall along x = 4 m; surface 3 is a pane in it, surface 7 the border of what is known.
    struct Wall;

    impl DistanceMap for Wall {
        fn distance(&self, x: f64, _y: f64) -> f32 {
            (x - 4.0).abs().min(2.0) as f32
        }

        fn is_unknown(&self, surface: u32) -> bool {
            surface == BORDER
        }

        fn hit_share(&self, surface: u32) -> f32 {
            if surface == GLASS { 0.6 } else { 1.0 }
        }
    }

    /// Lasers that look at the wall from 1 m to 3 m away; 1 of 10 readings ends anywhere before it, 4 of 10 of those at the pane.
    /// One beam in five looks at the pane. One in five leaves what is known at the wall, and its readings end anywhere.
    fn training_set(seed: u64) -> TrainingSet {
        let mut set = TrainingSet::new(MAX_RANGE).unwrap();
        for i in 0..4000 {
            let mut rng = Draw::new(seed, Stage::Training, 9).item(i);
            let range = 1.0 + 2.0 * rng.random::<f32>();
            let laser = Pose2::new(4.0 - f64::from(range), 0.0, 0.0);
            let surface = [BORDER, GLASS, 0, 0, 0][i as usize % 5];
            let share = match surface {
                BORDER => 1.0,
                GLASS => 0.4,
                _ => 0.1,
            };
            let anywhere = rng.random::<f32>() < share;
            let z = if anywhere {
                range * rng.random::<f32>()
            } else {
                range + 0.02 * (rng.random::<f32>() - 0.5)
            };
            let state = BeamState { laser, bearing: 0.0, range, incidence: 0.0, surface, scan: i / 10 };
            assert!(set.push(state, &[z]).unwrap());
        }
        set
    }

    fn model() -> NpRegField {
        let (intensity, _) = fit(&training_set(1), &training_set(2), &Wall).unwrap();
        NpRegField { intensity, map: Arc::new(Wall) }
    }

    /// Log density of a reading `z` from x = 1 m, 3 m before the wall, with a nominal range that may be wrong.
    fn log_density(model: &NpRegField, z: f32, nominal: f32, surface: u32) -> f32 {
        let hits = Hits { range: vec![nominal], incidence: vec![0.0], surface: vec![surface] };
        let laser: Particles = std::iter::once(Pose2::new(1.0, 0.0, 0.0)).collect();
        let mut out = [0.0];
        model.log_density(&[z], &hits.beams(laser.as_poses(), &[0.0], MAX_RANGE), &mut out);
        out[0]
    }

    /// Readings 1 m behind a nominal range are rare in training. One that ends on the wall is still as likely as the field
    /// says, one that ends in free space isn't.
    #[test]
    fn a_reading_that_ends_on_a_wall_is_likely_whatever_its_nominal_range() {
        let model = model();
        let on_wall = log_density(&model, 3.0, 2.0, 0);
        let in_space = log_density(&model, 2.5, 1.5, 0);
        let at_nominal = log_density(&model, 3.0, 3.0, 0);
        assert!(on_wall > in_space + 2.0, "{on_wall} on the wall, {in_space} in free space");
        assert!(at_nominal > in_space + 5.0, "{at_nominal} at the nominal range");
    }

    /// Where knowledge ends, here at the wall, no reading is more likely than before.
    #[test]
    fn the_border_of_what_is_known_is_no_wall() {
        let model = model();
        let at = |z, surface| log_density(&model, z, 3.0, surface);
        let [before, there] = [2.6, 3.0].map(|z| at(z, BORDER));
        assert!(there < before + 1.0, "{there} at the border, {before} before");
        assert!(at(3.0, 0) > there + 2.0, "{} at a wall", at(3.0, 0));
    }

    /// Readings before the pane are four times as many as before the wall. The densities differ by less, as both lean on that of
    /// all walls.
    #[test]
    fn a_wall_that_beams_pass_has_a_density_of_its_own() {
        let model = model();
        let [wall, glass] = [0, GLASS].map(|surface| log_density(&model, 2.5, 3.0, surface));
        assert!(glass > wall + 0.3, "{glass} before the pane, {wall} before the wall");
    }

    /// Over the training beams of each group, the density integrates to 1 with the share of no returns. The quadrature
    /// and the shrinkage are off by some per cent.
    #[test]
    fn the_density_integrates_to_one_on_average() {
        let (model, set) = (model(), training_set(1));
        for unknown in [false, true] {
            let (mut sum, mut beams) = (0.0, 0.0);
            for i in (0..set.len()).filter(|&i| (set.state(i).surface == BORDER) == unknown) {
                let state = set.state(i);
                let class = Classes::new(MAX_RANGE, &Wall).of(&set.beam(i), state.surface);
                let steps = 4000_u16;
                let step = MAX_RANGE / f32::from(steps);
                let along: f32 = (0..steps)
                    .map(|s| {
                        let z = (f32::from(s) + 0.5) * step;
                        let d = Wall.distance(state.laser.x + f64::from(z), 0.0);
                        step * model.intensity.at(class, z - state.range, d).exp()
                    })
                    .sum();
                sum += f64::from(along + model.intensity.0.log_no_return[class].exp());
                beams += 1.0;
            }
            assert!((sum / beams - 1.0).abs() < 0.1, "unknown {unknown}: {}", sum / beams);
        }
    }
}
