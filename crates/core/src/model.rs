use crate::{Beams, Draw, EndpointTable, Hits, LikelihoodTable, Poses, PreparedScan};

/// A map that answers ray casts.
pub trait RangeMap: Send + Sync {
    /// Casts `bearings.len()` rays from each of the laser poses and fills `out` (resized to n*k, pose-major).
    ///
    /// A ray that meets nothing within `max_range` \[m\] has range `max_range`, incidence 0 and no surface; a
    /// surface at exactly `max_range` counts as no return. A pose inside a wall or outside the map is legal:
    /// its rays hit whatever is in front of them.
    fn cast(&self, laser: Poses<'_>, bearings: &[f32], max_range: f32, out: &mut Hits);

    /// Log likelihood (nats) of a scan for each of the laser poses, by a prepared sensor model. `hits` is room to work
    /// in; a map that can do without it computes the same faster.
    fn log_likelihood(
        &self,
        laser: Poses<'_>,
        scan: &PreparedScan,
        table: &LikelihoodTable,
        hits: &mut Hits,
        out: &mut [f64],
    ) {
        self.cast(laser, &scan.bearings, table.grid().reach, hits);
        table.log_likelihood(scan, hits, out);
    }

    /// Whether a robot can stand at this point \[m\]: inside the map's free space. Used to draw the particles of
    /// a global localization.
    fn is_free(&self, x: f64, y: f64) -> bool;

    /// Lower and upper corner of the map \[x0, y0, x1, y1\] \[m\].
    fn bounds(&self) -> [f64; 4];
}

/// Distance to the nearest mapped surface, for the likelihood field (Probabilistic Robotics, table 6.3).
pub trait DistanceMap: Send + Sync {
    /// Distance \[m\] from a point of the map frame to the nearest surface, 0 on it, saturating at a bound of the
    /// map's choice; that bound outside the map.
    fn distance(&self, x: f64, y: f64) -> f32;

    /// Whether a surface is no wall but the border of what is known: a ray that meets it has no nominal range. `false` of
    /// maps that know everything.
    fn is_unknown(&self, surface: u32) -> bool {
        let _ = surface;
        false
    }

    /// Share of the beams reaching a surface that ended on it when the map was made; 1 in maps that weren't measured.
    fn hit_share(&self, surface: u32) -> f32 {
        let _ = surface;
        1.0
    }
}

/// A simulated world's knowledge of its own unmapped objects. Only the oracle may use it: it bounds the quality of any
/// model that scores beams one by one.
pub trait Obstructions: Send + Sync {
    /// Distance between the entries of [`Survival::probability`] \[m\].
    fn bin_m(&self) -> f32;

    /// How far the ray from (x, y) \[m\] in direction `heading` \[rad\] gets, whose nominal range is `range` \[m\].
    fn survival(&self, x: f64, y: f64, heading: f64, range: f32) -> Survival<'_>;
}

/// How far a ray gets before an unmapped object stops it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Survival<'a> {
    /// Entry `i` is the probability that no unmapped object stands within `start_m + i * bin_m()` metres. Starts at
    /// 1, never increases; the last entry holds beyond.
    pub probability: &'a [f32],
    /// Distance of the first entry from the ray's origin \[m\], possibly below 0. Objects stand by walls, so an
    /// answer computed for a neighbouring ray is aligned with this one at the wall, not at the origin.
    pub start_m: f32,
}

/// The inputs of a sensor model's density, besides the reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DependsOn {
    /// Nominal range and incidence of the beam.
    State,
    /// Where the reading ends, and whether it is a return.
    Endpoint,
    /// More than that.
    Everything,
}

/// A sensor model as a table.
#[derive(Clone, Copy, Debug)]
pub enum ModelTable<'a> {
    /// Over reading, nominal range and incidence.
    State(&'a LikelihoodTable),
    /// Over where the reading ends.
    Endpoint(&'a EndpointTable),
}

/// A learnt observation density p(z | beam): one object samples and scores.
///
/// The reference measure is the same for every model: Lebesgue (a density per metre) below the beam's maximum
/// range and a point mass of 1 at it, so that the log likelihoods of different models can be compared.
pub trait SensorModel: Send + Sync {
    /// The name a scenario calls this model by.
    fn name(&self) -> &str;

    /// Natural log of the density of reading `z[j]` for each beam `i * k + j`: per metre below the maximum
    /// range, a probability at it. `z` has k entries, shared by the n poses; `out` has n*k. A NaN reading gives
    /// 0 (no information). Never NaN, never plus infinity.
    fn log_density(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]);

    /// P(Z <= z\[j\]) for each beam; 1 at the maximum range. Shapes as in [`SensorModel::log_density`].
    fn cdf(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]);

    /// Draws one reading per beam (`out` has n*k entries); beam `i` uses `draw.item(i)`.
    fn sample(&self, beams: &Beams<'_>, draw: &Draw, out: &mut [f32]);

    /// The inputs of the density, which decide how the model can be prepared as a table.
    fn depends_on(&self) -> DependsOn {
        DependsOn::State
    }

    /// The model as a table, if it has been prepared as one; a filter then asks nothing else.
    fn table(&self) -> Option<ModelTable<'_>> {
        None
    }

    /// Whether the likelihood of a particle depends on where the others are: a filter then asks for all at once.
    fn needs_all_particles(&self) -> bool {
        false
    }

    /// Log likelihood of a whole scan for each pose: the sum over its k beams (nats), unless the model says otherwise. `scratch`
    /// is room to work in.
    fn log_likelihood(&self, z: &[f32], beams: &Beams<'_>, scratch: &mut Vec<f32>, out: &mut [f64]) {
        scratch.resize(beams.len(), 0.0);
        self.log_density(z, beams, scratch);
        for (out, beams) in out.iter_mut().zip(scratch.chunks(beams.per_pose())) {
            *out = beams.iter().map(|&l| f64::from(l)).sum();
        }
    }
}
