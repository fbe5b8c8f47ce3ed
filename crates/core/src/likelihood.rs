//! A sensor model as a table, so that a beam costs one read.

use wide::bytemuck::cast;
use wide::{f32x4, u32x4};

use crate::{Hits, Laser};

/// `ln p(z | r, alpha)` at the knots of a regular grid, for any sensor model whose density depends on the nominal range
/// r and the incidence angle alpha alone.
///
/// Rows belong to readings: one every `step_m` from 0 to the maximum range, and a last one for "no return". A row has
/// one entry for each nominal range, every `step_m` from 0 to the reach, and cosine of the incidence angle. A beam gets
/// the entry of its nearest knot. Entries are whole multiples of a small unit, so that a scan's sum is exact in any
/// order.
#[derive(Clone, Debug, PartialEq)]
pub struct LikelihoodTable {
    grid: LikelihoodGrid,
    ranges: usize,
    /// \[reading\]\[range\]\[cosine\], in units above the base; a last row of zeros for beams that don't count.
    entries: Vec<i16>,
    nats: Nats,
}

/// Log densities as whole numbers: nats = base + unit * entry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Nats {
    base: f64,
    unit: f64,
}

impl Nats {
    /// The entries of log densities; those more than [`SPAN_NATS`] below the greatest count as that far below.
    pub fn of(log_density: &[f32]) -> (Vec<i16>, Self) {
        let nats = Self::between(limits(log_density));
        (log_density.iter().map(|&l| nats.entry(l)).collect(), nats)
    }

    /// Those of log densities between these limits.
    fn between([lowest, highest]: [f32; 2]) -> Self {
        let highest = highest.max(f32::MIN);
        let span = (f64::from(highest) - f64::from(lowest.min(highest))).clamp(1e-3, SPAN_NATS);
        Self { base: f64::from(highest) - span / 2.0, unit: span / f64::from(u16::MAX) }
    }

    fn entry(self, log_density: f32) -> i16 {
        ((f64::from(log_density) - self.base) / self.unit).round() as i16
    }

    /// The same log densities times a factor.
    pub fn scaled(self, factor: f64) -> Self {
        Self { base: factor * self.base, unit: factor * self.unit }
    }

    /// The sum of `beams` log densities (nats) from that of their entries.
    #[inline]
    pub fn sum(self, beams: usize, entries: i32) -> f64 {
        self.base * beams as f64 + self.unit * f64::from(entries)
    }
}

/// The least and the greatest of some log densities.
fn limits(log_density: &[f32]) -> [f32; 2] {
    log_density.iter().fold([f32::INFINITY, f32::NEG_INFINITY], |[a, b], &l| [a.min(l), b.max(l)])
}

/// The knots of a [`LikelihoodTable`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LikelihoodGrid {
    /// Maximum range of the sensor \[m\]; a reading of it or above means "no return".
    pub max_range: f32,
    /// Nominal ranges go up to here \[m\]; a beam that reaches it meets nothing.
    pub reach: f32,
    /// Distance between knots, of readings as of nominal ranges \[m\].
    pub step_m: f32,
}

/// Knots over the cosine of the incidence angle: from 0, a beam along the wall, to 1, a beam at a right angle to it.
/// Cosines put them close where incidence matters, at grazing angles.
pub const INCIDENCE_KNOTS: usize = 16;

/// Entries lie within this many nats below the greatest; less likely readings get the lowest entry.
const SPAN_NATS: f64 = 64.0;

/// Adding this to a number from 0 to 2^22 leaves its nearest whole number in the low bits, without the checks for
/// overflow of a conversion.
const ROUND: f32 = 8_388_608.0;
const ROUND_MASK: u32 = (1 << 23) - 1;

impl LikelihoodGrid {
    /// Knots over readings, at the most: a table then has at most 94 MB.
    pub const MOST_READINGS: f32 = 1400.0;

    /// Knots fit for a laser: every 5 mm, or as many as there may be over a maximum range above 7 m.
    pub fn for_laser(laser: &Laser) -> Self {
        let (max_range, reach) = (laser.max_range(), laser.cast_range());
        Self { max_range, reach, step_m: (max_range / Self::MOST_READINGS).max(0.005) }
    }

    /// Number of knots over nominal range.
    pub fn ranges(&self) -> usize {
        (self.reach / self.step_m).ceil() as usize + 1
    }

    /// Number of rows: knots over readings below the maximum range, and one for "no return".
    pub fn rows(&self) -> usize {
        (self.max_range / self.step_m).ceil() as usize + 1
    }

    /// The reading of a row \[m\].
    pub fn reading(&self, row: usize) -> f32 {
        if row + 1 == self.rows() { self.max_range } else { row as f32 * self.step_m }
    }

    /// Nominal range \[m\] and incidence angle \[rad\] of each entry of a row, in order. Incidence is 0 where nothing
    /// is met.
    pub fn states(&self) -> (Vec<f32>, Vec<f32>) {
        (0..self.ranges())
            .flat_map(|i| {
                let range = (i as f32 * self.step_m).min(self.reach);
                (0..INCIDENCE_KNOTS).map(move |j| {
                    let cosine = j as f32 / (INCIDENCE_KNOTS - 1) as f32;
                    (range, if range < self.reach { cosine.acos() } else { 0.0 })
                })
            })
            .unzip()
    }
}

impl LikelihoodTable {
    /// Makes a table of log densities (nats), row by row as [`LikelihoodGrid`] has them; none is NaN or plus infinity.
    ///
    /// # Panics
    /// If the number of log densities is not the grid's.
    pub fn new(grid: LikelihoodGrid, log_density: &[f32]) -> Self {
        let row = grid.ranges() * INCIDENCE_KNOTS;
        Self::of_rows(grid, limits(log_density), log_density.chunks(row))
    }

    /// The same of rows that come one after the other, so that all of them need not be held. The limits are the least and the greatest of
    /// all log densities.
    ///
    /// # Panics
    /// As [`LikelihoodTable::new`].
    pub fn of_rows<R: AsRef<[f32]>>(
        grid: LikelihoodGrid,
        limits: [f32; 2],
        rows: impl IntoIterator<Item = R>,
    ) -> Self {
        let ranges = grid.ranges();
        let count = grid.rows() * ranges * INCIDENCE_KNOTS;
        let nats = Nats::between(limits);
        let mut entries = Vec::with_capacity(count + ranges * INCIDENCE_KNOTS);
        for row in rows {
            entries.extend(row.as_ref().iter().map(|&l| nats.entry(l)));
        }
        assert_eq!(entries.len(), count, "log densities do not match the grid");
        entries.resize(count + ranges * INCIDENCE_KNOTS, 0);
        Self { grid, ranges, entries, nats }
    }

    /// The same log densities times a positive factor.
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        Self { nats: self.nats.scaled(factor), ..self }
    }

    /// Where the knots are.
    pub fn grid(&self) -> LikelihoodGrid {
        self.grid
    }

    /// Size in memory \[bytes\].
    pub fn bytes(&self) -> usize {
        size_of_val(&*self.entries)
    }

    /// Log density (nats) of one reading.
    pub fn log_density(&self, z: f32, range: f32, cosine: f32) -> f32 {
        let entry = self.scale().entry(f32x4::splat(range), f32x4::splat(cosine)).to_array()[0];
        let entry = self.entries[(self.row_start(z) + entry) as usize];
        self.nats.sum(1, entry.into()) as f32
    }

    /// Start of a row among the entries; the one after the last is the row of zeros.
    fn start(&self, row: usize) -> u32 {
        (row * self.ranges * INCIDENCE_KNOTS) as u32
    }

    /// Start of a reading's row.
    fn row_start(&self, z: f32) -> u32 {
        let last = self.grid.rows() - 1;
        let nearest = (z.max(0.0) / self.grid.step_m).round() as usize;
        self.start(if z >= self.grid.max_range { last } else { nearest.min(last.saturating_sub(1)) })
    }

    /// How a state becomes an entry.
    pub fn scale(&self) -> LikelihoodScale {
        LikelihoodScale { per_metre: 1.0 / self.grid.step_m, reach: self.grid.reach }
    }

    /// The log likelihood (nats) of a scan from the sum of its beams' entries.
    #[inline]
    pub fn nats(&self, beams: usize, sum: i32) -> f64 {
        self.nats.sum(beams, sum)
    }

    /// Log likelihood (nats) of a scan for each pose of `hits`, which were cast along the scan's bearings up to the
    /// grid's reach.
    pub fn log_likelihood(&self, scan: &PreparedScan, hits: &Hits, out: &mut [f64]) {
        let (k, scale) = (scan.bearings.len(), self.scale());
        if k == 0 {
            return out.fill(0.0);
        }
        let hits = hits.range.chunks(k).zip(hits.incidence.chunks(k));
        for (out, (range, incidence)) in out.iter_mut().zip(hits) {
            let mut sum = 0;
            let hits = range.chunks(BEAMS_PER_RUN).zip(incidence.chunks(BEAMS_PER_RUN));
            for (&(_, row_start), (range, incidence)) in scan.runs.iter().zip(hits) {
                let lanes = |values: &[f32]| {
                    f32x4::new(std::array::from_fn(|i| values.get(i).copied().unwrap_or(0.0)))
                };
                sum += self.sum(row_start + scale.entry(lanes(range), lanes(incidence).cos()));
            }
            *out = self.nats(k, sum);
        }
    }

    /// Sum of the entries at four places.
    #[inline]
    pub fn sum(&self, places: u32x4) -> i32 {
        places.to_array().into_iter().map(|place| i32::from(self.entries[place as usize])).sum()
    }
}

/// How nominal range and cosine of the incidence angle become an entry's place in a row.
#[derive(Clone, Copy, Debug)]
pub struct LikelihoodScale {
    per_metre: f32,
    reach: f32,
}

impl LikelihoodScale {
    /// The entries of four states: nominal range \[m\], anything that is not from 0 to the reach counts as the reach;
    /// cosine of the incidence angle, 0 to 1 (a little above by rounding).
    #[inline]
    pub fn entry(self, range: f32x4, cosine: f32x4) -> u32x4 {
        let reach = f32x4::splat(self.reach);
        let met = range.simd_ge(f32x4::ZERO) & range.simd_lt(reach);
        let range = met.bitselect(range, reach);
        let round = |value: f32x4, mask: u32| cast::<_, u32x4>(value + ROUND) & u32x4::splat(mask);
        let i = round(range * self.per_metre, ROUND_MASK);
        let j = round(cosine * (INCIDENCE_KNOTS - 1) as f32, INCIDENCE_KNOTS as u32 - 1);
        (i << INCIDENCE_KNOTS.trailing_zeros()) + j
    }
}

/// Beams per run, as many as a vector register holds.
pub const BEAMS_PER_RUN: usize = 4;

/// Directions of a run of beams in the laser frame.
#[derive(Clone, Copy, Debug)]
pub struct BeamRun {
    /// Unit vector of each beam: x.
    pub cos: f32x4,
    /// Unit vector of each beam: y.
    pub sin: f32x4,
    /// Bearing of each beam in turns of 2^-32, which wraps by itself.
    pub turn: u32x4,
}

impl BeamRun {
    /// Beams of bearing 0.
    pub const AHEAD: Self = Self { cos: f32x4::ONE, sin: f32x4::ZERO, turn: u32x4::ZERO };

    /// The first beams at `bearings` \[rad\]; where there are fewer than a run's, the rest have bearing 0.
    pub fn new(bearings: &[f32]) -> Self {
        let mut run = Self::AHEAD;
        for (i, &bearing) in bearings.iter().take(BEAMS_PER_RUN).enumerate() {
            run.set(i, bearing);
        }
        run
    }

    pub(crate) fn set(&mut self, i: usize, bearing: f32) {
        let (sin, cos) = f64::from(bearing).sin_cos();
        self.cos.as_mut_array()[i] = cos as f32;
        self.sin.as_mut_array()[i] = sin as f32;
        self.turn.as_mut_array()[i] = turn(f64::from(bearing));
    }
}

/// The usable readings of a scan (not NaN), each with its direction and its row of a [`LikelihoodTable`]. Made once per
/// scan, used for every particle.
#[derive(Clone, Debug, Default)]
pub struct PreparedScan {
    /// Bearing of each beam in the laser frame \[rad\].
    pub bearings: Vec<f32>,
    /// The same beams in runs, each with the starts of its readings' rows. The last run is filled up with beams whose
    /// row is zero.
    pub runs: Vec<(BeamRun, u32x4)>,
}

impl PreparedScan {
    /// Takes the readings `z` \[m\] at `bearings` \[rad\]; keeps its buffers.
    pub fn prepare(&mut self, bearings: &[f32], z: &[f32], table: &LikelihoodTable) {
        let nothing = u32x4::splat(table.start(table.grid.rows()));
        self.bearings.clear();
        self.runs.clear();
        for (&bearing, &z) in bearings.iter().zip(z).filter(|(_, z)| !z.is_nan()) {
            let i = self.bearings.len() % BEAMS_PER_RUN;
            if i == 0 {
                self.runs.push((BeamRun::AHEAD, nothing));
            }
            self.bearings.push(bearing);
            if let Some((beams, row_start)) = self.runs.last_mut() {
                beams.set(i, bearing);
                row_start.as_mut_array()[i] = table.row_start(z);
            }
        }
    }
}

/// An angle \[rad\] in turns of 2^-32, wrapped.
#[inline]
pub fn turn(angle: f64) -> u32 {
    (angle * (4_294_967_296.0 / std::f64::consts::TAU)) as i64 as u32
}
