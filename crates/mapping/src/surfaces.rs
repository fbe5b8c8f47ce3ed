//! Hits become lines: region growing over small cells, then robust least squares (total least squares with Cauchy
//! weights) against all hits of each line, which is split where it bends.

use std::cmp::Reverse;
use std::collections::HashMap;

use glam::{DMat2, DVec2};
use locsim_core::{median, normal};

use crate::beams::Scan;
use crate::hits::{Hit, least_direction};
use crate::poses::correct_poses;
use crate::surface::{BIN_M, Surface};

/// Cells in which hits are gathered \[m\].
const CELL_M: f64 = 0.05;

/// Cells also tell normals apart, by sectors of 45 degrees: two faces of a thin wall fall into different ones.
const SECTORS: i32 = 8;

/// A cell belongs to a line when its mean is this near \[m\]: about three times the spread of the hits of one wall,
/// which is the laser's noise (1 to 2 cm) and the reference's (1 to 3 cm).
const NEAR_M: f64 = 0.06;

/// Cosine of the angle up to which normals are of one line: 30 degrees.
const SAME_NORMAL: f64 = 0.866;

/// A line is split where the hits, averaged over [`SPLIT_BINS`], are off by this much \[m\].
const SPLIT_M: f64 = 0.015;
const SPLIT_BINS: usize = 3;

/// The scale of Cauchy's weight in standard deviations: 95 % efficient at normal errors.
const CAUCHY: f64 = 2.385;

/// The scale of residuals is at least this \[m\], about that of a laser without the errors of its poses: the hits of a short
/// wall may agree by chance, and its weights would then leave out all but a few of them.
const LEAST_SCALE_M: f64 = 0.005;

/// Sums over points.
#[derive(Clone, Copy, Debug, Default)]
struct Moments {
    weight: f64,
    sum: DVec2,
    squares: DMat2,
    normals: DVec2,
}

impl Moments {
    fn add(&mut self, weight: f64, hit: &Hit) {
        self.weight += weight;
        self.sum += weight * hit.at;
        self.squares += weight * DMat2::from_cols(hit.at * hit.at.x, hit.at * hit.at.y);
        self.normals += weight * hit.normal;
    }

    fn merge(&mut self, other: &Self) {
        self.weight += other.weight;
        self.sum += other.sum;
        self.squares += other.squares;
        self.normals += other.normals;
    }

    fn mean(&self) -> DVec2 {
        self.sum / self.weight
    }

    /// The line through the points: total least squares where they are longer than wide, else by their normals.
    fn line(&self) -> (DVec2, f64) {
        let mean = self.mean();
        let scatter = (1.0 / self.weight) * self.squares - DMat2::from_cols(mean * mean.x, mean * mean.y);
        let fallback = self.normals.normalize_or(DVec2::X);
        let least = least_direction(scatter);
        let across = least.dot(scatter * least).max(0.0);
        let along = least.perp().dot(scatter * least.perp());
        let normal = if along > ELONGATED * ELONGATED * across.max(1e-6) { least } else { fallback };
        let normal = if normal.dot(fallback) < 0.0 { -normal } else { normal };
        (normal, normal.dot(mean))
    }
}

/// Points are fitted by a line of their own when they spread this many times farther along it than across.
const ELONGATED: f64 = 3.0;

type Key = [i32; 3];

fn key_of(hit: &Hit) -> Key {
    let [x, y] = (hit.at / CELL_M).floor().to_array();
    let turn = hit.normal.to_angle() / std::f64::consts::TAU;
    [x as i32, y as i32, ((turn * f64::from(SECTORS)).floor() as i32).rem_euclid(SECTORS)]
}

struct Cell {
    key: Key,
    hits: std::ops::Range<usize>,
    moments: Moments,
}

/// The lines of all hits, whose scans are moved so that their hits agree.
pub(crate) fn surfaces_of(scans: &mut [Scan], hits: &mut [Hit]) -> Vec<Surface> {
    let mut order: Vec<u32> = (0..hits.len() as u32).collect();
    let keys: Vec<Key> = hits.iter().map(key_of).collect();
    order.sort_by_key(|&i| keys[i as usize]);
    let mut cells: Vec<Cell> = Vec::new();
    for chunk in order.chunk_by(|&a, &b| keys[a as usize] == keys[b as usize]) {
        let mut moments = Moments::default();
        for &i in chunk {
            moments.add(1.0, &hits[i as usize]);
        }
        let start = cells.last().map_or(0, |cell| cell.hits.end);
        cells.push(Cell { key: keys[chunk[0] as usize], hits: start..start + chunk.len(), moments });
    }
    let index: HashMap<Key, usize> = cells.iter().enumerate().map(|(i, cell)| (cell.key, i)).collect();
    let mut surfaces = Vec::new();
    for members in grow(hits, &keys, &order, &cells, &index) {
        let mut members: Vec<u32> =
            members.iter().flat_map(|&cell| order[cells[cell].hits.clone()].iter().copied()).collect();
        members.sort_unstable();
        fit_and_split(hits, members, &mut surfaces);
    }
    for _ in 0..CORRECTIONS {
        correct_poses(scans, hits, surfaces.iter().map(|s| (s, s.hits.as_slice())));
        let groups = Nearest::new(&surfaces, hits).groups(hits);
        surfaces.clear();
        for members in groups {
            fit_and_split(hits, members, &mut surfaces);
        }
    }
    surfaces
}

/// How often poses are corrected and hits go to the nearest of all lines, which are fitted again.
const CORRECTIONS: usize = 4;

/// Cells of one line are at most this many cells apart.
const REACH: i32 = 2;

fn neighbours([x, y, sector]: Key) -> impl Iterator<Item = Key> {
    (-REACH..=REACH).flat_map(move |dx| {
        (-REACH..=REACH).flat_map(move |dy| {
            (-1..=1).map(move |turn| [x + dx, y + dy, (sector + turn).rem_euclid(SECTORS)])
        })
    })
}

/// Regions of neighbouring cells along a line, from the cells with most hits.
fn grow(
    hits: &[Hit],
    keys: &[Key],
    order: &[u32],
    cells: &[Cell],
    index: &HashMap<Key, usize>,
) -> Vec<Vec<usize>> {
    let mut seeds: Vec<usize> = (0..cells.len()).collect();
    seeds.sort_by(|&a, &b| cells[b].moments.weight.total_cmp(&cells[a].moments.weight));
    let mut taken = vec![false; cells.len()];
    let mut regions = Vec::new();
    for seed in seeds {
        if taken[seed] {
            continue;
        }
        taken[seed] = true;
        let mut region = vec![seed];
        let mut moments = cells[seed].moments;
        let (mut normal, mut offset) = moments.line();
        let mut next = 0;
        while next < region.len() {
            let key = cells[region[next]].key;
            next += 1;
            let linked = order[cells[region[next - 1]].hits.clone()].iter().flat_map(|&i| {
                let i = i as usize;
                let after = hits[i].linked.then(|| keys[i + 1]);
                let before = (i > 0 && hits[i - 1].linked).then(|| keys[i - 1]);
                [after, before].into_iter().flatten()
            });
            for cell in neighbours(key).chain(linked).filter_map(|key| index.get(&key).copied()) {
                if taken[cell] {
                    continue;
                }
                let candidate = &cells[cell].moments;
                let facing = candidate.normals.normalize_or_zero().dot(normal);
                if facing < SAME_NORMAL || (normal.dot(candidate.mean()) - offset).abs() > NEAR_M {
                    continue;
                }
                taken[cell] = true;
                moments.merge(candidate);
                (normal, offset) = moments.line();
                region.push(cell);
            }
        }
        regions.push(region);
    }
    regions
}

/// Fits a line to hits and splits it where it bends.
fn fit_and_split(hits: &[Hit], members: Vec<u32>, surfaces: &mut Vec<Surface>) {
    let mut stack = vec![members];
    while let Some(members) = stack.pop() {
        if members.is_empty() {
            continue;
        }
        let surface = fit(hits, members);
        match bend(hits, &surface) {
            Some(at) => {
                let (left, right) =
                    surface.hits.iter().partition(|&&i| surface.along(hits[i as usize].at) < at);
                stack.push(right);
                stack.push(left);
            }
            None => surfaces.push(surface),
        }
    }
}

/// Robust total least squares.
fn fit(hits: &[Hit], members: Vec<u32>) -> Surface {
    let points = || members.iter().map(|&i| &hits[i as usize]);
    let mut moments = Moments::default();
    points().for_each(|hit| moments.add(1.0, hit));
    let (mut normal, mut offset) = moments.line();
    let mut residuals: Vec<f64> = Vec::new();
    let mut scale = 0.0;
    for _ in 0..6 {
        residuals.clear();
        residuals.extend(points().map(|hit| (normal.dot(hit.at) - offset).abs()));
        scale = (normal::SIGMA_OVER_MAD * median(&mut residuals)).max(LEAST_SCALE_M);
        moments = Moments::default();
        for hit in points() {
            let share = (normal.dot(hit.at) - offset) / (CAUCHY * scale);
            moments.add(1.0 / (1.0 + share * share), hit);
        }
        (normal, offset) = moments.line();
    }
    let tangent = normal.perp();
    let (from, to) = points()
        .map(|hit| tangent.dot(hit.at))
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), t| (a.min(t), b.max(t)));
    // Readings of one scan share the error of its pose: scans, not readings, are independent.
    let mut by_scan: Vec<(u32, f64)> = points()
        .map(|hit| {
            let residual = normal.dot(hit.at) - offset;
            let share = residual / (CAUCHY * scale);
            (hit.scan, residual / (1.0 + share * share))
        })
        .collect();
    by_scan.sort_by_key(|(scan, _)| *scan);
    let mut variance = 0.0;
    let mut scans = 0.0;
    for chunk in by_scan.chunk_by(|a, b| a.0 == b.0) {
        variance += chunk.iter().map(|(_, residual)| residual).sum::<f64>().powi(2);
        scans += 1.0;
    }
    let sigma_m =
        if scans > 1.0 { (variance * scans / (scans - 1.0)).sqrt() / moments.weight } else { scale };
    Surface { normal, offset, sigma_m, from, to, hits: members }
}

/// Where a line has to be split, if anywhere: where the hits' mean over a few bins is farthest from it.
fn bend(hits: &[Hit], surface: &Surface) -> Option<f64> {
    let bins = surface.bins();
    if bins < 2 * SPLIT_BINS {
        return None;
    }
    let mut sums = vec![(0.0, 0.0); bins];
    for &i in &surface.hits {
        let hit = &hits[i as usize];
        let residual = surface.distance(hit.at);
        // Readings of other surfaces don't bend the line.
        let weight = 1.0 / (1.0 + (residual / NEAR_M).powi(2));
        let sum = &mut sums[surface.bin(surface.along(hit.at))];
        *sum = (sum.0 + weight, sum.1 + weight * residual);
    }
    let (mut worst, mut most) = (0, SPLIT_M);
    for start in 0..=bins - SPLIT_BINS {
        let (weight, sum) =
            sums[start..start + SPLIT_BINS].iter().fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        // Its own standard error, about 2 cm for one hit, isn't a bend.
        let mean = (sum.abs() - 2.0 * 0.02 * weight.sqrt()) / weight.max(1e-9);
        if mean > most {
            (worst, most) = (start + SPLIT_BINS / 2, mean);
        }
    }
    if most <= SPLIT_M {
        return None;
    }
    // Within the middle, so that both parts have a length.
    let at = worst.clamp(SPLIT_BINS, bins - SPLIT_BINS);
    Some(surface.from + BIN_M * at as f64)
}

/// Finds the surface that a hit is of.
pub(crate) struct Nearest<'a> {
    surfaces: &'a [Surface],
    /// The surfaces with hits in each cell.
    cells: HashMap<[i32; 2], Vec<u32>>,
}

impl<'a> Nearest<'a> {
    /// `hits` are those that the surfaces are made of.
    pub fn new(surfaces: &'a [Surface], hits: &[Hit]) -> Self {
        let mut cells: HashMap<[i32; 2], Vec<u32>> = HashMap::new();
        for (number, surface) in surfaces.iter().enumerate() {
            for &i in &surface.hits {
                let [x, y, _] = key_of(&hits[i as usize]);
                let list = cells.entry([x, y]).or_default();
                if list.last() != Some(&(number as u32)) {
                    list.push(number as u32);
                }
            }
        }
        Self { surfaces, cells }
    }

    /// The number of the surface that a hit is of: one that faces as the hit does, the largest of those that are very near,
    /// or else the nearest. So a large surface takes over what small ones fitted to its noise and its corners.
    fn to(&self, hit: &Hit) -> Option<usize> {
        let [x, y, _] = key_of(hit);
        let around = (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| [x + dx, y + dy]));
        let candidates = around.filter_map(|cell| self.cells.get(&cell)).flatten();
        let best = candidates
            .filter_map(|&number| {
                let surface = &self.surfaces[number as usize];
                let along = surface.along(hit.at);
                let beyond = (surface.from - along).max(along - surface.to).max(0.0);
                let distance = surface.distance(hit.at).abs().hypot(beyond);
                let facing = if hit.has_normal { FACING } else { 0.0 };
                let is_of = hit.normal.dot(surface.normal) > facing && distance <= NEAR_M;
                let size = if distance <= VERY_NEAR_M { surface.hits.len() } else { 0 };
                is_of.then_some((Reverse(size), distance, number))
            })
            .min_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
        best.map(|(_, _, number)| number as usize)
    }

    /// The hits of each surface; those that no surface is near to are left out.
    pub fn groups(&self, hits: &[Hit]) -> Vec<Vec<u32>> {
        let mut groups = vec![Vec::new(); self.surfaces.len()];
        for (hit, i) in hits.iter().zip(0..) {
            if let Some(surface) = self.to(hit) {
                groups[surface].push(i);
            }
        }
        groups
    }
}

/// A hit this near to a surface \[m\], about twice a laser's noise, is no evidence for another.
const VERY_NEAR_M: f64 = 0.03;

/// A hit is of a surface when the cosine between their normals is above this: one scan alone gives a hit's normal roughly.
const FACING: f64 = 0.5;
