use std::path::PathBuf;
use std::sync::Arc;

use locsim_core::{Beams as View, Draw, Laser, Pose2, SensorModel as Density, Stage};
use locsim_lab::run::{ScanData, temper};
use locsim_sensor::{FitOptions, FittedModel, ModelKind, Tempering, TrainingSet, evaluate, fit};
use pyo3::prelude::*;

use crate::array::{Array, numpy, python, wrong};
use crate::error::{Error, refused};
use crate::map::{Beams, Map};
use crate::work::Work;

/// Share of the scans that decide about bandwidths where the caller doesn't say: that of scenarios.
const HELD_OUT_SHARE: f64 = 0.25;

/// A learnt observation density p(z | beam). All models have the same reference measure: a density per metre below the maximum
/// range, and a probability at it, which means "no return".
#[pyclass(frozen, module = "locsim")]
pub struct SensorModel {
    pub fitted: FittedModel,
    pub density: Arc<dyn Density>,
}

impl SensorModel {
    fn new(fitted: FittedModel, map: Option<&Map>) -> Result<Self, Error> {
        let distance = map.map(|map| Arc::clone(&map.exact.distance));
        Self::with_distance(fitted, distance)
    }

    fn with_distance(
        fitted: FittedModel,
        distance: Option<Arc<dyn locsim_core::DistanceMap>>,
    ) -> Result<Self, Error> {
        let density = fitted.clone().into_model(distance)?;
        Ok(Self { fitted, density })
    }

    /// Calls `ask(z, beams, out)` for readings \[beams\] of all poses, or \[poses, beams\] of each.
    fn each<'py>(
        &self,
        py: Python<'py>,
        readings: &Bound<'py, PyAny>,
        beams: &Beams,
        ask: impl Fn(&dyn Density, &[f32], &View<'_>, &mut [f32]) + Sync,
    ) -> Result<Bound<'py, PyAny>, Error> {
        let Array { values, shape } = Array::<f32>::of(readings, "readings")?;
        let view = beams.view();
        let k = view.per_pose();
        let one_scan = shape == [k];
        if !one_scan && shape != beams.shape {
            return Err(wrong("readings", &shape, &axes(beams)));
        }
        self.fits(beams)?;
        let mut out = vec![0.0; view.len()];
        py.detach(|| {
            if one_scan {
                ask(&*self.density, &values, &view, &mut out);
            } else {
                for (i, (z, out)) in values.chunks(k).zip(out.chunks_mut(k)).enumerate() {
                    ask(&*self.density, z, &view.slice_poses(i, i + 1), out);
                }
            }
        });
        Ok(numpy(py, &out, &beams.shape)?)
    }

    /// Beams of the sensor that the model was fitted to.
    fn fits(&self, beams: &Beams) -> Result<(), Error> {
        let (own, theirs) = (self.fitted.max_range(), beams.max_range);
        if own == theirs {
            return Ok(());
        }
        Err(Error::Sensor(format!(
            "a model of a sensor of {own} m maximum range, beams of one of {theirs} m"
        )))
    }
}

/// The axes of readings of these beams.
fn axes(beams: &Beams) -> Vec<&'static str> {
    if beams.shape.len() == 2 { vec!["poses", "beams"] } else { vec!["states"] }
}

/// States with their readings, which are of the shape of the beams, or several scans of it along a first axis. Beams of one pose
/// are one scan; states without poses are scans of their own.
fn training_set(readings: &Bound<'_, PyAny>, beams: &Beams) -> Result<TrainingSet, Error> {
    let Array { values, shape } = Array::<f32>::of(readings, "readings")?;
    let view = beams.view();
    if !shape.ends_with(&beams.shape) || shape.len() > beams.shape.len() + 1 {
        return Err(wrong("readings", &shape, &axes(beams)));
    }
    let mut set = TrainingSet::new(beams.max_range)?;
    let scans: Vec<&[f32]> = values.chunks(view.len().max(1)).collect();
    let per_scan = if beams.shape.len() == 2 { view.per_pose().max(1) } else { 1 };
    set.push_beams(&view, &scans, |beam| (beam / per_scan) as u32)?;
    Ok(set)
}

#[pymethods]
impl SensorModel {
    /// The models that can be fitted.
    #[classattr]
    #[expect(non_snake_case, reason = "a constant of Python")]
    fn NAMES() -> Vec<&'static str> {
        ModelKind::NAMES.to_vec()
    }

    /// Fits a model.
    ///
    /// Args:
    ///     name: One of `SensorModel.NAMES`.
    ///     readings: Readings [m] of each beam, of the shape of the beams, or several scans of that shape along a first axis.
    ///         NaN are left out.
    ///     beams: The beams. Those of one pose are one scan, and are held out together.
    ///     held_out_share: Share of the scans that decide about bandwidths.
    ///     seed: Chooses these scans.
    ///
    /// Raises:
    ///     SensorError: An unknown name, data that are refused, or too few of them.
    #[staticmethod]
    #[pyo3(signature = (name, readings, beams, *, held_out_share = HELD_OUT_SHARE, seed = 0))]
    fn fit(
        py: Python<'_>,
        name: &str,
        readings: &Bound<'_, PyAny>,
        beams: &Beams,
        held_out_share: f64,
        seed: u64,
    ) -> Result<Self, Error> {
        let kind: ModelKind = name.parse()?;
        let set = training_set(readings, beams)?;
        let options = FitOptions { distance_map: beams.distance.clone() };
        let fitted = Work::new(py, Some(false), None)?.run(py, |_| {
            let (train, held_out) = set.split(held_out_share, seed)?;
            fit(kind, &train, &held_out, &options)
        })?;
        Self::with_distance(fitted, beams.distance.clone())
    }

    /// Reads a model that `save` or a run has written (`models/LABEL.model`).
    ///
    /// Args:
    ///     path: The file.
    ///     map: Needed by `likelihood_field` and `np_reg_field`, which score by the distance to the nearest wall.
    ///
    /// Raises:
    ///     SensorError: The file is no model, is damaged, or the map is missing.
    #[staticmethod]
    #[pyo3(signature = (path, map = None))]
    fn load(path: PathBuf, map: Option<&Map>) -> Result<Self, Error> {
        Self::new(FittedModel::load(&path)?, map)
    }

    /// Writes the model to a file.
    fn save(&self, path: PathBuf) -> Result<(), Error> {
        Ok(self.fitted.save(&path)?)
    }

    /// Name of the model.
    #[getter]
    fn name(&self) -> &'static str {
        self.fitted.kind().as_str()
    }

    /// Maximum range of the sensor [m].
    #[getter]
    fn max_range(&self) -> f32 {
        self.fitted.max_range()
    }

    /// Whether its density integrates to 1. Those of models that score where readings end don't.
    #[getter]
    fn is_normalized(&self) -> bool {
        self.fitted.kind().is_normalized()
    }

    /// The values that fitting chose, by names that end in their unit.
    #[getter]
    fn chosen<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>, Error> {
        python(py, self.fitted.chosen())
    }

    /// Natural logarithm of the density of each reading: per metre below the maximum range, of a probability at it; 0 where the
    /// reading is NaN.
    ///
    /// Args:
    ///     readings: Readings [m] of the shape of the beams, or one scan [beams] that is held against all poses.
    ///     beams: The beams.
    ///
    /// Returns:
    ///     Float32 of the shape of the beams.
    fn log_density<'py>(
        &self,
        py: Python<'py>,
        readings: &Bound<'py, PyAny>,
        beams: &Beams,
    ) -> Result<Bound<'py, PyAny>, Error> {
        self.each(py, readings, beams, |density, z, beams, out| density.log_density(z, beams, out))
    }

    /// P(Z <= reading) for each beam; 1 at the maximum range. Shapes as of `log_density`.
    fn cdf<'py>(
        &self,
        py: Python<'py>,
        readings: &Bound<'py, PyAny>,
        beams: &Beams,
    ) -> Result<Bound<'py, PyAny>, Error> {
        self.each(py, readings, beams, |density, z, beams, out| density.cdf(z, beams, out))
    }

    /// A random reading for each beam [m], float32 of the shape of the beams.
    #[pyo3(signature = (beams, *, seed = 0))]
    fn sample<'py>(&self, py: Python<'py>, beams: &Beams, seed: u64) -> Result<Bound<'py, PyAny>, Error> {
        self.fits(beams)?;
        let mut out = vec![0.0; beams.view().len()];
        py.detach(|| self.density.sample(&beams.view(), &Draw::new(seed, Stage::Laser, 0), &mut out));
        Ok(numpy(py, &out, &beams.shape)?)
    }

    /// Scores on readings that the model wasn't fitted to: mean negative log density [nats], and mean Wasserstein-1 distance between
    /// predicted and observed distribution [m].
    fn evaluate(
        &self,
        py: Python<'_>,
        readings: &Bound<'_, PyAny>,
        beams: &Beams,
    ) -> Result<(f64, f64), Error> {
        self.fits(beams)?;
        let set = training_set(readings, beams)?;
        let scores = py.detach(|| evaluate(&*self.density, &set));
        Ok((scores.log_loss_nats, scores.histogram_match_m))
    }

    /// Floor and exponent for a filter that uses these beams: those under which the pose that a scan was taken from is likeliest
    /// among poses around it. Beams are not independent, and an exponent below 1 makes up for it.
    ///
    /// Args:
    ///     readings: Readings [poses, beams] [m] that the model wasn't fitted to.
    ///     poses: Poses of the laser [poses, 3].
    ///     bearings: Bearings [rad], [beams].
    ///     map: The map.
    #[pyo3(signature = (readings, poses, bearings, map, *, seed = 0))]
    fn choose_tempering(
        &self,
        py: Python<'_>,
        readings: &Bound<'_, PyAny>,
        poses: &Bound<'_, PyAny>,
        bearings: &Bound<'_, PyAny>,
        map: &Map,
        seed: u64,
    ) -> Result<(f64, f64), Error> {
        let (bearings, [k]) = Array::<f32>::with_axes(bearings, "bearings", ["beams"])?;
        let poses = crate::array::poses(poses, "poses")?;
        let (values, [n, of_each]) = Array::<f32>::with_axes(readings, "readings", ["poses", "beams"])?;
        if (n, of_each) != (poses.len(), k) {
            return Err(refused(format!(
                "readings: the shape {:?} is not allowed; {:?}, poses and beams",
                [n, of_each],
                [poses.len(), k]
            )));
        }
        let laser = Laser::new(bearings, vec![0.0; k], 0.0, self.fitted.max_range(), Pose2::IDENTITY)?;
        let scans = values.chunks(k).map(|scan| vec![scan.to_vec()]).collect();
        let data = ScanData { laser, poses: poses.iter().collect(), scans, run: 1 };
        let chosen = Work::new(py, Some(false), None)?
            .run(py, |_| temper(&*self.density, &data, &*map.exact.exact, seed))?;
        let Tempering { floor, exponent, .. } = chosen;
        Ok((floor, exponent))
    }

    fn __repr__(&self) -> String {
        format!("SensorModel({:?}, max_range={})", self.name(), self.max_range())
    }
}
