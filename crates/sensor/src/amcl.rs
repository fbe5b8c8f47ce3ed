//! The laser models of AMCL, term by term as nav2 has them.
//!
//! Their weight of a scan is no product of densities: `beam` and `likelihood_field` add cubes of the beams' terms to 1, and the
//! Gaussian in a term has no factor 1 / (sqrt(2 pi) sigma). Parameters of a density, as expectation maximization finds them, mean
//! something else here.
//!
//! Sources: `beam_model.cpp`, `likelihood_field_model.cpp` and `likelihood_field_model_prob.cpp` of `nav2_amcl`, which go back to
//! Player's AMCL driver.

use std::fmt;
use std::sync::Arc;

use locsim_core::{Beams, DependsOn, DistanceMap, Draw, Poses, SensorModel, sin_cos};
use rand::RngExt;
use serde::{Deserialize, Serialize};
use strum::{VariantArray, VariantNames};

use crate::SensorError;
use crate::beam::{cdfs, log_densities, samples};
use crate::field::Profile;

/// A filter is gathered, and skips beams, where no particle is farther than this from the mean, along x as along y \[m\].
const GATHERED_M: f64 = 0.5;

/// The least density that a beam's logarithm is taken of: where all weights are 0, so is a term.
const LEAST_TERM: f64 = 1e-30;

/// AMCL's laser models, by the names that scenarios use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, VariantArray, VariantNames)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum AmclKind {
    /// Nominal ranges: hit, short, max and random.
    AmclBeam,
    /// Distances of the readings' ends to the nearest surface.
    AmclLikelihoodField,
    /// The same as a product, with beam skipping.
    AmclLikelihoodFieldProb,
}

impl AmclKind {
    /// Every kind, in the order of tables.
    pub const ALL: &[Self] = <Self as VariantArray>::VARIANTS;

    /// The name, for example `amcl_likelihood_field`.
    pub const fn as_str(self) -> &'static str {
        <Self as VariantNames>::VARIANTS[self as usize]
    }

    /// The value of AMCL's parameter `laser_model_type`.
    pub fn laser_model_type(self) -> &'static str {
        &self.as_str()["amcl_".len()..]
    }

    /// Description for reports and the schema of scenarios.
    pub const fn sentence(self) -> &'static str {
        match self {
            Self::AmclBeam => "AMCL's `beam` with nav2's parameters: 1 plus the sum of cubed terms",
            Self::AmclLikelihoodField => {
                "AMCL's `likelihood_field` with nav2's parameters: 1 plus the sum of cubed terms"
            }
            Self::AmclLikelihoodFieldProb => {
                "AMCL's `likelihood_field_prob` with nav2's parameters: a product, with beam skipping"
            }
        }
    }
}

impl fmt::Display for AmclKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

/// Parameters of AMCL's laser models, under AMCL's names.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AmclParameters {
    /// The model: AMCL's `laser_model_type`.
    pub kind: AmclKind,
    /// Weight of the Gaussian, which is 1 at its mean.
    pub z_hit: f64,
    /// Weight of short readings; `beam` alone.
    pub z_short: f64,
    /// Weight of readings at the maximum range; `beam` alone.
    pub z_max: f64,
    /// Weight of random readings.
    pub z_rand: f64,
    /// Standard deviation of the Gaussian \[m\].
    pub sigma_hit: f64,
    /// Rate of short readings \[1/m\]; `beam` alone.
    pub lambda_short: f64,
    /// Beams of a scan, about; at least 2.
    pub max_beams: usize,
    /// Larger distances from the nearest surface count as this \[m\]; the likelihood fields.
    pub laser_likelihood_max_dist: f64,
    /// Whether `likelihood_field_prob` skips beams.
    pub do_beamskip: bool,
    /// A reading that ends nearer to a surface agrees with a particle \[m\].
    pub beam_skip_distance: f64,
    /// A beam counts that agrees with more than this share of the particles.
    pub beam_skip_threshold: f64,
    /// If this share of `max_beams` is skipped, none is.
    pub beam_skip_error_threshold: f64,
}

impl AmclParameters {
    /// nav2's defaults, with this model.
    pub const fn defaults(kind: AmclKind) -> Self {
        Self {
            kind,
            z_hit: 0.5,
            z_short: 0.05,
            z_max: 0.05,
            z_rand: 0.5,
            sigma_hit: 0.2,
            lambda_short: 0.1,
            max_beams: 60,
            laser_likelihood_max_dist: 2.0,
            do_beamskip: false,
            beam_skip_distance: 0.5,
            beam_skip_threshold: 0.3,
            beam_skip_error_threshold: 0.9,
        }
    }

    /// Whether AMCL takes them: weights and shares from 0 to 1, lengths and rates finite and positive, at least 2 beams.
    ///
    /// # Errors
    /// [`SensorError::Parameter`].
    pub fn check(&self) -> Result<(), SensorError> {
        let shares = [
            ("z_hit", self.z_hit),
            ("z_short", self.z_short),
            ("z_max", self.z_max),
            ("z_rand", self.z_rand),
            ("beam_skip_threshold", self.beam_skip_threshold),
            ("beam_skip_error_threshold", self.beam_skip_error_threshold),
        ];
        let positive = [
            ("sigma_hit", self.sigma_hit),
            ("lambda_short", self.lambda_short),
            ("laser_likelihood_max_dist", self.laser_likelihood_max_dist),
            ("beam_skip_distance", self.beam_skip_distance),
        ];
        let refuse = |what, allowed, value| Err(SensorError::Parameter { what, allowed, value });
        if let Some(&(what, value)) = shares.iter().find(|(_, value)| !(0.0..=1.0).contains(value)) {
            return refuse(what, "from 0 to 1", value);
        }
        if let Some(&(what, value)) = positive.iter().find(|(_, value)| !(*value > 0.0 && value.is_finite()))
        {
            return refuse(what, "positive and finite", value);
        }
        if self.max_beams < 2 {
            return refuse("max_beams", "at least 2", self.max_beams as f64);
        }
        Ok(())
    }

    /// AMCL takes every so manieth of `beams` beams, from the first on. The models round differently: `beam` and
    /// `likelihood_field` may take more than `max_beams`, up to twice as many.
    pub fn stride(&self, beams: usize) -> usize {
        let stride = match self.kind {
            AmclKind::AmclBeam | AmclKind::AmclLikelihoodField => {
                beams.saturating_sub(1) / (self.max_beams - 1)
            }
            AmclKind::AmclLikelihoodFieldProb => beams.div_ceil(self.max_beams),
        };
        stride.max(1)
    }
}

/// One of AMCL's laser models over a map.
///
/// The log likelihood of a scan is the logarithm of AMCL's factor on a particle's weight. The log density of a beam is the logarithm
/// of its term: a score, whose sum is the scan's only in `likelihood_field_prob`. `cdf` and `sample` use the term normalized along
/// the beam.
///
/// Readings are as AMCL has them: those that aren't usable (NaN) are below the minimum range, which AMCL takes for the maximum range.
/// The likelihood fields ignore these. Where AMCL writes past them while it skips beams (their terms are then those of an earlier scan),
/// they are ignored here, too.
pub struct Amcl {
    parameters: AmclParameters,
    map: Arc<dyn DistanceMap>,
}

impl Amcl {
    /// A model over the distances of `map`, which the beam model doesn't look at. A map's distances may saturate below
    /// `laser_likelihood_max_dist`.
    ///
    /// # Errors
    /// As [`AmclParameters::check`].
    pub fn new(parameters: AmclParameters, map: Arc<dyn DistanceMap>) -> Result<Self, SensorError> {
        parameters.check()?;
        Ok(Self { parameters, map })
    }

    /// The term of a beam in `beam`: reading and nominal range \[m\], both at most the maximum range.
    fn beam_term(&self, z: f64, nominal: f64, max_range: f64) -> f64 {
        let p = &self.parameters;
        let off = z - nominal;
        let hit = p.z_hit * (-off * off / (2.0 * p.sigma_hit * p.sigma_hit)).exp();
        let short = if off < 0.0 { p.z_short * p.lambda_short * (-p.lambda_short * z).exp() } else { 0.0 };
        hit + short + if z >= max_range { p.z_max } else { p.z_rand / max_range }
    }

    /// Distance of a reading's end from the nearest surface \[m\].
    fn distance(&self, laser: Poses<'_>, pose: usize, bearing: f32, z: f32) -> f32 {
        let (sin, cos) = sin_cos(laser.theta[pose] + f64::from(bearing));
        let z = f64::from(z);
        self.map.distance(laser.x[pose] + z * cos, laser.y[pose] + z * sin)
    }

    /// A distance as AMCL's map has it \[m\].
    fn cut(&self, distance: f32) -> f64 {
        f64::from(distance).min(self.parameters.laser_likelihood_max_dist)
    }

    /// The term of a reading in the likelihood fields, whose end is at this distance \[m\] from the nearest surface.
    fn field_term(&self, distance: f32, max_range: f32) -> f64 {
        let p = &self.parameters;
        let distance = self.cut(distance);
        p.z_hit * (-distance * distance / (2.0 * p.sigma_hit * p.sigma_hit)).exp()
            + p.z_rand / f64::from(max_range)
    }

    /// The readings that a likelihood field uses, with their beams.
    fn used<'a>(&self, z: &'a [f32], max_range: f32) -> impl Iterator<Item = (usize, f32)> + use<'a> {
        let all = z.iter().copied().enumerate().step_by(self.parameters.stride(z.len()));
        // False for NaN.
        all.filter(move |(_, z)| *z < max_range)
    }

    fn weigh_by_ranges(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f64]) {
        let (k, max_range) = (beams.per_pose(), beams.max_range);
        let stride = self.parameters.stride(k);
        for (out, nominal) in out.iter_mut().zip(beams.range.chunks(k)) {
            let cubes = z.iter().zip(nominal).step_by(stride).map(|(&z, &nominal)| {
                // The maximum range for NaN.
                let (z, nominal) = (z.min(max_range), nominal.min(max_range));
                self.beam_term(z.into(), nominal.into(), max_range.into()).powi(3)
            });
            *out = cubes.sum::<f64>().ln_1p();
        }
    }

    fn weigh_by_distances(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f64]) {
        let max_range = beams.max_range;
        let is_product = self.parameters.kind == AmclKind::AmclLikelihoodFieldProb;
        for (i, out) in out.iter_mut().enumerate() {
            let terms = self.used(z, max_range).map(|(j, z)| {
                self.field_term(self.distance(beams.laser, i, beams.bearings[j], z), max_range)
            });
            *out = if is_product {
                terms.map(|term| term.max(LEAST_TERM).ln()).sum()
            } else {
                terms.map(|term| term.powi(3)).sum::<f64>().ln_1p()
            };
        }
    }

    /// The product without the beams that disagree with too many particles; `distances` is room to work in.
    fn weigh_and_skip(&self, z: &[f32], beams: &Beams<'_>, distances: &mut Vec<f32>, out: &mut [f64]) {
        let p = &self.parameters;
        let (k, n, max_range) = (beams.per_pose(), out.len(), beams.max_range);
        distances.resize(n * k, 0.0);
        for (i, distances) in distances.chunks_mut(k).enumerate() {
            for (j, z) in self.used(z, max_range) {
                distances[j] = self.distance(beams.laser, i, beams.bearings[j], z);
            }
        }
        let of_beam = |j: usize| distances[j..].iter().step_by(k);
        let agrees = |j: usize| {
            let near = of_beam(j).filter(|d| self.cut(**d) < p.beam_skip_distance).count();
            near as f64 / n as f64 > p.beam_skip_threshold
        };
        let agreeing = self.used(z, max_range).filter(|(j, _)| agrees(*j)).count();
        let skipped = p.max_beams.saturating_sub(agreeing);
        let is_lost = skipped as f64 >= p.max_beams as f64 * p.beam_skip_error_threshold;
        out.fill(0.0);
        for (j, _) in self.used(z, max_range).filter(|(j, _)| is_lost || agrees(*j)) {
            for (out, distance) in out.iter_mut().zip(of_beam(j)) {
                *out += self.field_term(*distance, max_range).max(LEAST_TERM).ln();
            }
        }
    }

    /// The term of beam `i` along it, normalized.
    fn profile(&self, beams: &Beams<'_>, i: usize) -> Profile {
        let p = &self.parameters;
        let max_range = beams.max_range;
        let nominal = beams.range[i].min(max_range);
        match p.kind {
            AmclKind::AmclBeam => {
                let weights = p.z_hit + p.z_short + p.z_max + p.z_rand;
                let returns = if weights > 0.0 { 1.0 - p.z_max / weights } else { 1.0 };
                Profile::along(beams, i, returns as f32, |z, _, _| {
                    self.beam_term(z.into(), nominal.into(), max_range.into()).max(LEAST_TERM) as f32
                })
            }
            AmclKind::AmclLikelihoodField | AmclKind::AmclLikelihoodFieldProb => {
                Profile::along(beams, i, 1.0, |_, x, y| {
                    self.field_term(self.map.distance(x, y), max_range).max(LEAST_TERM) as f32
                })
            }
        }
    }
}

/// Whether the particles have gathered: all within [`GATHERED_M`] of their mean.
fn has_gathered(poses: Poses<'_>) -> bool {
    [poses.x, poses.y].into_iter().all(|values| {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        values.iter().all(|value| (value - mean).abs() <= GATHERED_M)
    })
}

impl SensorModel for Amcl {
    fn name(&self) -> &str {
        self.parameters.kind.as_str()
    }

    fn depends_on(&self) -> DependsOn {
        match self.parameters.kind {
            AmclKind::AmclBeam => DependsOn::State,
            AmclKind::AmclLikelihoodField | AmclKind::AmclLikelihoodFieldProb => DependsOn::Endpoint,
        }
    }

    fn log_density(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]) {
        let max_range = beams.max_range;
        log_densities(z, beams, out, |z, beam| {
            let term = match self.parameters.kind {
                AmclKind::AmclBeam => self.beam_term(z.into(), beam.range.into(), max_range.into()),
                // A reading that is ignored.
                _ if z >= max_range => 1.0,
                _ => {
                    let bearing = beams.bearings[beam.bearing];
                    self.field_term(self.distance(beams.laser, beam.pose, bearing, z), max_range)
                }
            };
            term.max(LEAST_TERM).ln() as f32
        });
    }

    fn cdf(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]) {
        // Many readings of one beam, as an evaluation asks for, share its profile.
        let mut profiled: Option<((usize, f32), Profile)> = None;
        cdfs(z, beams, out, |z, beam| {
            let key = (beam.pose, beams.bearings[beam.bearing]);
            if profiled.as_ref().is_none_or(|(profiled, _)| *profiled != key) {
                let i = beam.pose * beams.per_pose() + beam.bearing;
                profiled = Some((key, self.profile(beams, i)));
            }
            profiled.as_ref().map_or(0.0, |(_, profile)| profile.below(z / beam.max_range))
        });
    }

    fn sample(&self, beams: &Beams<'_>, draw: &Draw, out: &mut [f32]) {
        samples(beams, draw, out, |beam, rng| {
            let profile = self.profile(beams, beam.pose * beams.per_pose() + beam.bearing);
            profile.quantile(rng.random::<f32>()).map_or(beam.max_range, |share| share * beam.max_range)
        });
    }

    fn needs_all_particles(&self) -> bool {
        self.parameters.kind == AmclKind::AmclLikelihoodFieldProb && self.parameters.do_beamskip
    }

    fn log_likelihood(&self, z: &[f32], beams: &Beams<'_>, scratch: &mut Vec<f32>, out: &mut [f64]) {
        match self.parameters.kind {
            AmclKind::AmclBeam => self.weigh_by_ranges(z, beams, out),
            _ if self.needs_all_particles() && has_gathered(beams.laser) => {
                self.weigh_and_skip(z, beams, scratch, out);
            }
            _ => self.weigh_by_distances(z, beams, out),
        }
    }
}
