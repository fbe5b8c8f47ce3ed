use std::sync::Arc;

use locsim_core::limits::{COORDINATE, MOST_PARTICLES};
use locsim_core::{
    DependsOn, Laser, LikelihoodGrid, Particles as Set, Pose2, Scan, SensorModel as Density, Weights,
};
use locsim_dataset::OdometryError;
use locsim_lab::run::MapSet;
use locsim_mcl::{
    self as mcl, AnnealingOptions, FilterOptions, InjectionOptions, KldOptions, Multinomial, OdometryMotion,
    ParticleCount, RandomWalk, ResampleTrigger, Resampler, Residual, Spread, Start, Stratified, Systematic,
};
use locsim_sensor::{Prepared, Tempered};
use pyo3::prelude::*;

use crate::array::{Array, numpy, pose_array, poses, view};
use crate::error::{Error, refused};
use crate::map::Map;
use crate::sensor::SensorModel;

/// Floor and exponent where the caller doesn't say: a floor that keeps a single odd reading from ruling a particle out, and the
/// beams as if they were independent.
const TEMPERING: (f64, f64) = (1e-3, 1.0);

/// Standard deviations of the start where the caller doesn't say \[m\] and \[rad\].
const START_SIGMA: (f64, f64) = (0.2, 0.1);

/// A particle filter that localizes a robot in a map (Probabilistic Robotics, table 8.2). All its random numbers derive from the
/// seed; the number of threads changes no bit.
///
/// `x`, `y`, `theta`, `weights` and `log_likelihood` are read-only views of the filter's own memory, without a copy. A view keeps the
/// values of its moment: after the next step ask for a new one. While a view is held, the filter goes on in other memory.
///
/// Args:
///     map: The map.
///     model: The sensor model.
///     bearings: Bearings of the beams in the frame of the laser [rad], [beams].
///     particles: Number of particles, 1000 by default, or a KldSampling that adapts it.
///     start: Pose of the robot (x, y, theta) around which the particles start; by default anywhere in the map.
///     start_sigma: Standard deviations of the start, of position [m] and heading [rad].
///     alpha: Noise of the odometry motion model (table 5.6 there).
///     random_walk: Standard deviation [m] of a random walk of the position beside it, after a metre of way or a radian of turning (a
///         scenario on a log has 0.04); by default none.
///     mount: Where the laser is on the robot (x, y, theta).
///     tempering: Floor and exponent of the density, as `SensorModel.choose_tempering` gives them.
///     resampler: systematic, stratified, multinomial or residual.
///     injection: Decay rates (alpha_slow, alpha_fast) of augmented MCL (table 8.3 there), which replaces particles by random ones
///         while scans are less likely than they used to be; by default none are.
///     regularization: Standard deviations of the jitter after a resampling, of position [m] and heading [rad]; by default none.
///     least_effective_share: A scan that would leave a smaller share of the particles effective is taken in by the largest power of its
///         likelihood that leaves as many (a scenario on a log has 0.02); by default all that aren't annealed
///         are taken in whole.
///     annealing: How scans are taken in while the particles are spread, for a start anywhere in the map; by default at once.
///     table: Whether ray casts and densities come from tables, which are prepared first.
///     seed: Everything random derives from it.
///
/// Raises:
///     FilterError, SensorError: A value is out of its range.
#[pyclass(module = "locsim")]
pub struct Filter {
    filter: mcl::Filter,
    laser: Laser,
    maps: Arc<MapSet>,
    model: Arc<dyn Density>,
}

/// A number of particles that adapts to their spread (KLD sampling; Fox, IJRR 22(12), 2003), chosen anew at each resampling: as many as
/// keep the Kullback-Leibler distance of their histogram from the posterior below a bound.
///
/// Args:
///     min, max: The least number of particles, and the greatest, which a filter starts with.
///     error: The bound on the distance [nats].
///     quantile: Probability with which it holds, from 0.5 to 1.
///     bin_m, bin_rad: Side of a bin of the histogram [m], and its width in heading [rad].
#[pyclass(frozen, module = "locsim")]
pub struct KldSampling(KldOptions);

#[pymethods]
impl KldSampling {
    #[new]
    #[pyo3(signature = (min, max, *, error = 0.05, quantile = 0.99, bin_m = 0.5, bin_rad = BIN_RAD))]
    fn new(min: usize, max: usize, error: f64, quantile: f64, bin_m: f64, bin_rad: f64) -> Self {
        Self(KldOptions { min, max, error, quantile, bin_m, bin_rad })
    }

    fn __repr__(&self) -> String {
        let KldOptions { min, max, error, quantile, bin_m, bin_rad } = self.0;
        format!(
            "KldSampling({min}, {max}, error={error}, quantile={quantile}, bin_m={bin_m}, bin_rad={bin_rad})"
        )
    }
}

/// Scans taken in by small powers of their likelihood while the particles are spread (Del Moral, Doucet and Jasra, JRSS B 68(3), 2006):
/// particles climb to the peaks before the peaks are compared. Each such scan costs some ten updates. Until the particles have gathered,
/// there are as many as their spread asks for (a KldSampling, or bins of 0.5 m and 10 degrees up to 20,000 particles).
///
/// Args:
///     candidates: Particles of a start anywhere in the map, until a scan tells them apart.
///     effective_share: Each power is the largest that leaves this share of the particles effective, above 0 and below 1.
///     moves: Metropolis moves of each particle after each power.
///     sigma_m, sigma_rad: Standard deviations of the smallest moves [m] and [rad]; others are 3, 10 and 30 times as large, up to 0.3.
///     gathered_m: Scans are annealed until positions have this standard deviation [m], and again from five times it.
#[pyclass(frozen, module = "locsim")]
pub struct Annealing(AnnealingOptions);

#[pymethods]
impl Annealing {
    #[new]
    #[pyo3(signature = (
        *, candidates = 20_000, effective_share = 0.5, moves = 4, sigma_m = 0.01, sigma_rad = 0.005, gathered_m = 0.2,
    ))]
    fn new(
        candidates: usize,
        effective_share: f64,
        moves: usize,
        sigma_m: f64,
        sigma_rad: f64,
        gathered_m: f64,
    ) -> Self {
        let step = Spread { sigma_m, sigma_rad };
        Self(AnnealingOptions { candidates, effective_share, moves, step, gathered_m })
    }

    fn __repr__(&self) -> String {
        let AnnealingOptions { candidates, effective_share, moves, step, gathered_m } = self.0;
        let Spread { sigma_m, sigma_rad } = step;
        format!(
            "Annealing(candidates={candidates}, effective_share={effective_share}, moves={moves}, sigma_m={sigma_m}, \
             sigma_rad={sigma_rad}, gathered_m={gathered_m})"
        )
    }
}

/// A fixed number of particles, or one that adapts.
#[derive(FromPyObject)]
enum Particles {
    #[pyo3(annotation = "int")]
    Fixed(usize),
    #[pyo3(annotation = "KldSampling")]
    Kld(Py<KldSampling>),
}

/// The outcome of an update. `log_evidence` is ln p(z_t | z_1..t-1) [nats]. After a scan that no particle explains the weights are
/// made equal, and `recovered` is true.
#[pyclass(frozen, get_all, module = "locsim")]
pub struct Update {
    log_evidence: f64,
    recovered: bool,
}

/// Estimates from the weighted particles.
#[pyclass(frozen, module = "locsim")]
pub struct Estimate {
    mean: mcl::Estimate,
    max_weight: Pose2,
}

/// Width of a bin in heading where the caller doesn't say: AMCL's 10 degrees.
const BIN_RAD: f64 = 10.0 * std::f64::consts::PI / 180.0;

/// A pose \[3\].
fn pose(value: &Bound<'_, PyAny>, name: &str) -> Result<Pose2, Error> {
    let one = poses(value, name)?;
    if one.len() == 1 { Ok(one.get(0)) } else { Err(refused(format!("{name}: one pose is needed"))) }
}

fn resampler(name: &str) -> Result<Arc<dyn Resampler>, Error> {
    Ok(match name {
        "systematic" => Arc::new(Systematic),
        "stratified" => Arc::new(Stratified),
        "multinomial" => Arc::new(Multinomial),
        "residual" => Arc::new(Residual),
        _ => {
            return Err(refused(format!(
                "resampler: {name:?} is not allowed; systematic, stratified, multinomial, residual"
            )));
        }
    })
}

#[pymethods]
impl Filter {
    #[new]
    #[pyo3(signature = (
        map, model, bearings, *, particles = Particles::Fixed(1000), start = None, start_sigma = START_SIGMA,
        alpha = OdometryError::USUAL_ALPHA, random_walk = 0.0, mount = (0.0, 0.0, 0.0), tempering = TEMPERING,
        resampler = "systematic", injection = None, regularization = None, least_effective_share = None, annealing = None,
        table = true, seed = 0,
    ))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments")]
    fn new(
        py: Python<'_>,
        map: &Map,
        model: &SensorModel,
        bearings: &Bound<'_, PyAny>,
        particles: Particles,
        start: Option<&Bound<'_, PyAny>>,
        start_sigma: (f64, f64),
        alpha: [f64; 4],
        random_walk: f64,
        mount: (f64, f64, f64),
        tempering: (f64, f64),
        resampler: &str,
        injection: Option<(f64, f64)>,
        regularization: Option<(f64, f64)>,
        least_effective_share: Option<f64>,
        annealing: Option<&Annealing>,
        table: bool,
        seed: u64,
    ) -> Result<Self, Error> {
        let (bearings, [beams]) = Array::<f32>::with_axes(bearings, "bearings", ["beams"])?;
        let mount = Pose2::new(mount.0, mount.1, mount.2);
        let laser = Laser::new(bearings, vec![0.0; beams], 0.0, model.fitted.max_range(), mount)?;
        let (floor, exponent) = tempering;
        let start = match start {
            None => Start::Global,
            Some(start) => Start::Tracking {
                pose: pose(start, "start")?,
                spread: Spread { sigma_m: start_sigma.0, sigma_rad: start_sigma.1 },
            },
        };
        let count = match &particles {
            Particles::Fixed(count) => *count,
            Particles::Kld(kld) => kld.get().0.max,
        };
        if count as u64 > u64::from(MOST_PARTICLES) {
            return Err(refused(format!("particles: {count} is not allowed; at most {MOST_PARTICLES}")));
        }
        for (name, spread) in [("start_sigma", Some(start_sigma)), ("regularization", regularization)] {
            if let Some((sigma_m, sigma_rad)) = spread
                && ![sigma_m, sigma_rad].iter().all(|sigma| *sigma <= COORDINATE)
            {
                return Err(refused(format!(
                    "{name}: ({sigma_m}, {sigma_rad}) is not allowed; numbers from 0 to {COORDINATE:e} (m, rad)"
                )));
            }
        }
        let options = FilterOptions {
            particles: match particles {
                Particles::Fixed(count) => ParticleCount::Fixed(count),
                Particles::Kld(kld) => ParticleCount::Kld(kld.get().0),
            },
            motion: Arc::new(RandomWalk::new(Arc::new(OdometryMotion::new(alpha)?), random_walk)?),
            resampler: self::resampler(resampler)?,
            trigger: ResampleTrigger::EachStep,
            injection: injection.map(|(alpha_slow, alpha_fast)| InjectionOptions { alpha_slow, alpha_fast }),
            regularization: regularization.map(|(sigma_m, sigma_rad)| Spread { sigma_m, sigma_rad }),
            update: None,
            least_effective_share,
            clusters: None,
            annealing: annealing.map(|annealing| annealing.0),
            ancestry: false,
        };
        py.detach(|| {
            let bare = Arc::clone(&model.density);
            let mut model: Arc<dyn Density> = Arc::new(Tempered::new(bare, floor, exponent)?);
            let maps = if table { map.fast()? } else { Arc::new(map.exact.clone()) };
            if table && model.depends_on() != DependsOn::Everything {
                let states = LikelihoodGrid::for_laser(&laser);
                model = Arc::new(Prepared::new(model, states, &maps.endpoints())?);
            }
            let filter = mcl::Filter::new(options, &start, &*maps.ranges, seed)?;
            Ok(Self { filter, laser, maps, model })
        })
    }

    /// Moves the particles by draws from the motion model.
    ///
    /// Args:
    ///     odometry: Motion since the last prediction (x, y, theta), in the frame of the robot before it.
    fn predict(&mut self, py: Python<'_>, odometry: &Bound<'_, PyAny>) -> Result<(), Error> {
        let odometry = pose(odometry, "odometry")?;
        Ok(py.detach(|| self.filter.predict(&odometry))?)
    }

    /// Weights the particles by a scan.
    ///
    /// Args:
    ///     ranges: Readings [m], [beams]. The maximum range means "no return"; NaN are ignored.
    ///
    /// Raises:
    ///     FilterError: Another number of readings than of beams.
    fn update(&mut self, py: Python<'_>, ranges: &Bound<'_, PyAny>) -> Result<Update, Error> {
        let (ranges, _) = Array::<f32>::with_axes(ranges, "ranges", ["beams"])?;
        let Self { filter, laser, maps, model } = self;
        let scan = Scan { ranges };
        let update = py.detach(|| filter.update(laser, &scan, &*maps.ranges, &**model))?;
        Ok(Update { log_evidence: update.log_evidence, recovered: update.recovered.is_some() })
    }

    /// Resamples the particles, whose weights are then equal, and draws random ones among them where injection asks for them.
    ///
    /// Args:
    ///     below: Resamples only where the effective sample size is below this share of the number of particles, or where random
    ///         particles are due.
    ///
    /// Returns:
    ///     Whether it did.
    #[pyo3(signature = (*, below = None))]
    fn resample(&mut self, py: Python<'_>, below: Option<f64>) -> Result<bool, Error> {
        let count = self.filter.particles().len() as f64;
        let wanted = below.is_none_or(|share| self.effective_sample_size() < share * count);
        Ok(py.detach(|| self.filter.resample(wanted, &*self.maps.ranges))?.is_some())
    }

    /// Mean, covariance and the heaviest particle.
    fn estimate(&mut self, py: Python<'_>) -> Estimate {
        let estimates = py.detach(|| self.filter.estimates());
        Estimate { mean: estimates.weighted_mean, max_weight: estimates.max_weight }
    }

    /// x of the particles [m], float64 [particles]. A read-only view, which keeps these values when the filter goes on.
    #[getter]
    fn x<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        view(py, self.filter.particles(), |set: &Set| &set.x)
    }

    /// y of the particles [m], float64 [particles]. A read-only view, which keeps these values when the filter goes on.
    #[getter]
    fn y<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        view(py, self.filter.particles(), |set: &Set| &set.y)
    }

    /// Headings of the particles [rad], in (-pi, pi], float64 [particles]. A read-only view, which keeps these values when the filter
    /// goes on.
    #[getter]
    fn theta<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        view(py, self.filter.particles(), |set: &Set| &set.theta)
    }

    /// The particles (x, y, theta), float64 [particles, 3]. A copy that is yours to write to; `x`, `y` and `theta` come without one.
    #[getter]
    fn particles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        pose_array(py, self.filter.particles().iter())
    }

    /// Weights that sum to 1, float64 [particles]. A read-only view, which keeps these values when the filter goes on.
    #[getter]
    fn weights<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        view(py, self.filter.weights(), Weights::linear)
    }

    /// Log likelihood of the last scan for each particle [nats], float64 [particles]; empty before the first. A read-only view, which
    /// keeps these values when the filter goes on.
    #[getter]
    fn log_likelihood<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        view(py, self.filter.log_likelihood(), |values: &Vec<f64>| values)
    }

    /// 1 / sum of the squared weights.
    #[getter]
    fn effective_sample_size(&self) -> f64 {
        self.filter.weights().effective_sample_size()
    }

    fn __repr__(&self) -> String {
        format!("Filter({} particles, {} beams)", self.filter.particles().len(), self.laser.beam_count())
    }
}

#[pymethods]
impl Update {
    fn __repr__(&self) -> String {
        let recovered = if self.recovered { "True" } else { "False" };
        format!("Update(log_evidence={:.3}, recovered={recovered})", self.log_evidence)
    }
}

#[pymethods]
impl Estimate {
    /// Weighted mean (x, y, theta), circular for the heading, float64 [3].
    #[getter]
    fn pose<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let Pose2 { x, y, theta } = self.mean.pose;
        numpy(py, &[x, y, theta], &[3])
    }

    /// Covariance of (x, y, theta) [m, m, rad], float64 [3, 3].
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        numpy(py, self.mean.covariance.as_flattened(), &[3, 3])
    }

    /// The particle of the greatest weight (x, y, theta), float64 [3].
    #[getter]
    fn max_weight<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let Pose2 { x, y, theta } = self.max_weight;
        numpy(py, &[x, y, theta], &[3])
    }

    fn __repr__(&self) -> String {
        let Pose2 { x, y, theta } = self.mean.pose;
        format!("Estimate(x={x:.3}, y={y:.3}, theta={theta:.4})")
    }
}
