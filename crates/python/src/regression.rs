//! Distribution regression: learns p(z | x) from samples.

use distreg::{
    Alignment, ConditionalDistribution, Dataset, Degree, DensityEstimate, FrechetOptions, Kernel, Loss,
    NpRegOptions, Outcomes, PRegOptions, Predictions, Regressor, Support, Weighting, losses,
};
use pyo3::prelude::*;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::array::{Array, booleans, numpy, wrong};
use crate::error::{Error, refused};
use crate::work::Work;

/// Quantiles of a barycentre in Wasserstein space where the caller doesn't say.
const QUANTILES: usize = 200;
/// Fewer observations than this say little of a deviation.
const LEAST_OBSERVATIONS: usize = 10;

/// A fitted model of p(z | x).
#[pyclass(frozen, name = "Regression", module = "locsim.distreg")]
pub struct Regression {
    model: Box<dyn ConditionalDistribution>,
}

/// Predicted distributions at n queries.
#[pyclass(frozen, module = "locsim.distreg")]
pub struct Prediction {
    all: Predictions,
}

/// States \[n, dim\] with their observations: an array \[n, m\], whose NaN are left out, or a list of n arrays.
fn dataset(states: &Bound<'_, PyAny>, observations: &Bound<'_, PyAny>) -> Result<Dataset, Error> {
    let (states, [n, dim]) = Array::<f64>::with_axes(states, "states", ["states", "coordinates"])?;
    let mut data = Dataset::new(dim);
    let count = observations.len()?;
    if count != n {
        return Err(refused(format!("observations: {count} for {n} states")));
    }
    for (state, observed) in states.chunks(dim.max(1)).zip(observations.try_iter()?) {
        let mut observed = Array::<f64>::of(&observed?, "observations")?.values;
        observed.retain(|z| !z.is_nan());
        data.push(state, &observed)?;
    }
    Ok(data)
}

/// A word of distreg's own, such as the name of a kernel.
fn word<T: DeserializeOwned>(name: &str, word: &str) -> Result<T, Error> {
    serde_json::from_value(Value::from(word)).map_err(|error| refused(format!("{name}: {error}")))
}

/// Learns p(z | x) from samples.
///
/// Args:
///     states: States x, [n, coordinates].
///     observations: Observations at each: [n, m], whose NaN are left out, or a list of n arrays.
///     method: np_reg (histograms smoothed over states), p_reg (regressed parameters of a family) or frechet (barycentres in
///         Wasserstein space).
///     values: First and last value that can be observed, and the resolution: the bins.
///     point_mass: A value with a probability of its own, such as a laser's maximum range.
///     bandwidths: Weights come from a kernel with one bandwidth for each coordinate, in its unit.
///     neighbours, scales: Or from this number of nearest states, with distances in these units.
///     kernel: gaussian, boxcar or epanechnikov.
///     shift_by, scale_by: The coordinate that observations follow, by their difference or their ratio to it.
///     degree: constant (weighted mean) or linear (plane); linear for p_reg by default.
///     smoothing: Bandwidth of a kernel density in place of histograms, in units of z; of np_reg.
///     family: gaussian, two_gaussians or gaussian_exponential; of p_reg.
///     least_observations: Least number that parameters are estimated from; of p_reg.
///     quantiles: Number of quantiles; of frechet.
///
/// Raises:
///     LocsimError: The data or a setting are refused.
#[pyfunction]
#[pyo3(signature = (
    states, observations, *, method = "np_reg", values, point_mass = None, bandwidths = None, neighbours = None,
    scales = None, kernel = "gaussian", shift_by = None, scale_by = None, degree = None, smoothing = None,
    family = "gaussian", least_observations = LEAST_OBSERVATIONS, quantiles = QUANTILES,
))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments")]
pub fn fit(
    py: Python<'_>,
    states: &Bound<'_, PyAny>,
    observations: &Bound<'_, PyAny>,
    method: &str,
    values: (f64, f64, f64),
    point_mass: Option<f64>,
    bandwidths: Option<Vec<f64>>,
    neighbours: Option<usize>,
    scales: Option<Vec<f64>>,
    kernel: &str,
    shift_by: Option<usize>,
    scale_by: Option<usize>,
    degree: Option<&str>,
    smoothing: Option<f64>,
    family: &str,
    least_observations: usize,
    quantiles: usize,
) -> Result<Regression, Error> {
    let data = dataset(states, observations)?;
    let (first, last, resolution) = values;
    let mut outcomes = Outcomes::of_values(first, last, resolution)?;
    outcomes.point_mass_at = point_mass;
    let kernel: Kernel = word("kernel", kernel)?;
    let weighting = match (bandwidths, neighbours, scales) {
        (Some(bandwidths), None, None) => Weighting::kernel(kernel, &bandwidths),
        (None, Some(count), Some(scales)) => Weighting::nearest_neighbours(count, &scales),
        _ => return Err(refused("weights come from `bandwidths`, or from `neighbours` and `scales`")),
    };
    let alignment = match (shift_by, scale_by) {
        (None, None) => Alignment::Identity,
        (Some(state_dim), None) => Alignment::Shift { state_dim },
        (None, Some(state_dim)) => Alignment::Scale { state_dim },
        (Some(_), Some(_)) => return Err(refused("shift_by and scale_by exclude each other")),
    };
    // P-REG as published regresses its parameters on planes, the others average.
    let degree = degree.unwrap_or(if method == "p_reg" { "linear" } else { "constant" });
    let degree: Degree = word("degree", degree)?;
    let density = smoothing
        .map_or(DensityEstimate::Histogram, |bandwidth| DensityEstimate::Kernel { kernel, bandwidth });
    match method {
        "np_reg" => fitted(py, &data, NpRegOptions { outcomes, alignment, density, weighting, degree }),
        "p_reg" => {
            let options = PRegOptions {
                outcomes,
                alignment,
                family: word("family", family)?,
                weighting,
                degree,
                // A reading that is rounded to the resolution has this deviation.
                smallest_sigma: resolution / 12.0_f64.sqrt(),
                least_observations,
            };
            fitted(py, &data, options)
        }
        "frechet" => fitted(py, &data, FrechetOptions { outcomes, alignment, quantiles, weighting, degree }),
        _ => Err(refused(format!("method: {method:?} is not allowed; np_reg, p_reg, frechet"))),
    }
}

fn fitted<R>(py: Python<'_>, data: &Dataset, options: R) -> Result<Regression, Error>
where
    R: Regressor + Send,
    R::Model: 'static,
{
    let work = Work::new(py, Some(false), None)?;
    let model = work.run(py, |_| Ok::<_, distreg::Error>(Box::new(options.fit(data)?)))?;
    Ok(Regression { model })
}

/// Mean of losses at held-out states with its 95 % bootstrap interval: (mean, lo, hi).
#[pyfunction]
#[pyo3(signature = (losses, *, seed = 0))]
pub fn risk(losses: &Bound<'_, PyAny>, seed: u64) -> Result<(f64, f64, f64), Error> {
    let (losses, _) = Array::<f64>::with_axes(losses, "losses", ["states"])?;
    let distreg::Risk { mean, lo, hi } = distreg::risk(&losses, seed)?;
    Ok((mean, lo, hi))
}

#[pymethods]
impl Regression {
    /// Predicted distributions at queries [n, coordinates].
    fn predict(&self, py: Python<'_>, queries: &Bound<'_, PyAny>) -> Result<Prediction, Error> {
        let (queries, [_, dim]) = Array::<f64>::with_axes(queries, "queries", ["queries", "coordinates"])?;
        if dim != self.model.dim() {
            return Err(distreg::Error::Dimension { expected: self.model.dim(), found: dim }.into());
        }
        Ok(Prediction { all: py.detach(|| self.model.predict_batch(&queries))? })
    }

    /// The loss at each held-out state, float64 [n]: crps, log_loss (with a floor under the density), histogram_match, wasserstein1 or
    /// euclidean.
    #[pyo3(signature = (states, observations, *, loss = "crps", floor = 1e-3))]
    fn losses<'py>(
        &self,
        py: Python<'py>,
        states: &Bound<'py, PyAny>,
        observations: &Bound<'py, PyAny>,
        loss: &str,
        floor: f64,
    ) -> Result<Bound<'py, PyAny>, Error> {
        let data = dataset(states, observations)?;
        let loss: Loss = match loss {
            "log_loss" => Loss::LogLoss { floor },
            other => word("loss", other)?,
        };
        let values = py.detach(|| losses(&*self.model, &data, loss))?;
        Ok(numpy(py, &values, &[values.len()])?)
    }

    fn __repr__(&self) -> String {
        format!("Regression({} coordinates, {} bins)", self.model.dim(), self.model.outcomes().grid.bins)
    }
}

impl Prediction {
    /// A number of each predicted distribution.
    fn each(&self, of: impl Fn(&distreg::Distribution, usize) -> f64) -> Vec<f64> {
        (0..self.all.len()).map(|i| of(&self.all.distribution(i), i)).collect()
    }

    /// The same of values \[queries\].
    fn at<'py>(
        &self,
        py: Python<'py>,
        values: &Bound<'py, PyAny>,
        name: &str,
        of: impl Fn(&distreg::Distribution, f64) -> f64,
    ) -> Result<Bound<'py, PyAny>, Error> {
        let Array { values, shape } = Array::<f64>::of(values, name)?;
        let n = self.all.len();
        let value = |i: usize| if shape.is_empty() { values[0] } else { values[i] };
        if !shape.is_empty() && shape != [n] {
            return Err(wrong(name, &shape, &["queries"]));
        }
        Ok(numpy(py, &self.each(|distribution, i| of(distribution, value(i))), &[n])?)
    }
}

#[pymethods]
impl Prediction {
    /// Centres of the bins, float64 [bins].
    #[getter]
    fn centres<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let grid = self.all.outcomes().grid;
        let centres: Vec<f64> = (0..grid.bins).map(|bin| grid.centre(bin)).collect();
        numpy(py, &centres, &[grid.bins])
    }

    /// Probability of each bin, float64 [n, bins].
    #[getter]
    fn mass<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let (n, bins) = (self.all.len(), self.all.outcomes().grid.bins);
        let mass: Vec<f64> = (0..n).flat_map(|i| self.all.mass(i)).copied().collect();
        numpy(py, &mass, &[n, bins])
    }

    /// Probability of the point mass, float64 [n]; 0 where there is none.
    #[getter]
    fn point_mass<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        numpy(py, self.all.points(), &[self.all.len()])
    }

    /// Whether a query lies within the training data, bool [n].
    #[getter]
    fn in_data<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let inside = self.all.support().iter().map(|support| *support == Support::InData);
        booleans(py, inside, &[self.all.len()])
    }

    /// Density at z, a number or [n]; a probability at the point mass. Float64 [n].
    fn density<'py>(&self, py: Python<'py>, z: &Bound<'py, PyAny>) -> Result<Bound<'py, PyAny>, Error> {
        self.at(py, z, "z", distreg::Distribution::density)
    }

    /// P(Z <= z), z a number or [n]. Float64 [n].
    fn cdf<'py>(&self, py: Python<'py>, z: &Bound<'py, PyAny>) -> Result<Bound<'py, PyAny>, Error> {
        self.at(py, z, "z", distreg::Distribution::cdf)
    }

    /// The u quantile, u a number or [n]. Float64 [n].
    fn quantile<'py>(&self, py: Python<'py>, u: &Bound<'py, PyAny>) -> Result<Bound<'py, PyAny>, Error> {
        self.at(py, u, "u", distreg::Distribution::quantile)
    }

    /// Mean of each, float64 [n].
    fn mean<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let means = self.each(|distribution, _| distribution.mean());
        numpy(py, &means, &[means.len()])
    }

    fn __len__(&self) -> usize {
        self.all.len()
    }

    fn __repr__(&self) -> String {
        format!("Prediction({} queries, {} bins)", self.all.len(), self.all.outcomes().grid.bins)
    }
}
