use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use locsim_core::limits::MOST_PARTICLES;
use locsim_core::{CAST_REACH, DistanceMap, Hits, NO_SURFACE, Particles, Pose2, RangeMap};
use locsim_lab::run::{MapSet, free_poses};
use locsim_scenario::{RayCast, load_map};
use locsim_world::map::{Geometry, MapError, VectorMap};
use locsim_world::raycast::RangeTableOptions;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::array::{Array, bearings as bearings_of, booleans, numpy, pose_array, poses, tree, wrong};
use crate::error::{Error, refused};

/// A map of walls.
///
/// Args:
///     source: A map file, as [`Map.load`], or a dict `{"outline": {"points_m": [[x, y], ...]}, "obstacles": [...]}` of a
///         vector map (docs/MAPS.md).
///
/// Raises:
///     ScenarioError: The file is refused, with line and key.
///     LocsimError: The dict is refused.
#[pyclass(frozen, module = "locsim")]
pub struct Map {
    pub exact: MapSet,
    /// With ray casts from a table, for filters; made when the first one asks for it.
    fast: OnceLock<Arc<MapSet>>,
}

impl Map {
    fn of(geometry: Geometry) -> Result<Self, Error> {
        Ok(Self { exact: MapSet::new(geometry, RayCast::Exact, None, None, &())?, fast: OnceLock::new() })
    }

    fn geometry(&self) -> &Geometry {
        self.exact.exact.geometry()
    }

    /// The map as filters use it.
    pub fn fast(&self) -> Result<Arc<MapSet>, MapError> {
        if let Some(maps) = self.fast.get() {
            return Ok(Arc::clone(maps));
        }
        let RangeTableOptions { cell_m, most_bytes, .. } = RangeTableOptions::default();
        let table = RayCast::Table { cell_m, memory_mb: (most_bytes >> 20) as u32 };
        let cache = locsim::users_cache();
        let maps = MapSet::new(self.geometry().clone(), table, None, cache.as_deref(), &())?;
        Ok(Arc::clone(self.fast.get_or_init(|| Arc::new(maps))))
    }

    /// A length that no ray in the map exceeds \[m\].
    fn diagonal(&self) -> f32 {
        let [x0, y0, x1, y1] = self.exact.exact.bounds();
        (x1 - x0).hypot(y1 - y0).ceil() as f32
    }

    /// The points of an array \[..., 2\], and the shape without the last axis.
    fn points(points: &Bound<'_, PyAny>) -> Result<(Array<f64>, Vec<usize>), Error> {
        let array = Array::<f64>::of(points, "points")?;
        match array.shape.split_last() {
            Some((2, _)) if array.values.iter().any(|value| !value.is_finite()) => {
                Err(refused("points: a coordinate is not finite"))
            }
            Some((2, rest)) => {
                let rest = rest.to_vec();
                Ok((array, rest))
            }
            _ => Err(wrong("points", &array.shape, &["...", "2 (x, y)"])),
        }
    }
}

/// A range that rays are cast to.
fn positive(name: &str, range: f32) -> Result<f32, Error> {
    if range > 0.0 && range.is_finite() {
        return Ok(range);
    }
    Err(refused(format!("{name}: {range} is not allowed; a finite number above 0 (m)")))
}

#[pymethods]
impl Map {
    #[new]
    fn new(source: &Bound<'_, PyAny>) -> Result<Self, Error> {
        let Ok(keys) = source.cast::<PyDict>() else { return Self::load(source.extract()?) };
        let map: VectorMap = serde_json::from_value(tree(keys)?)?;
        Self::of(map.to_geometry()?)
    }

    /// Reads a map: YAML of a ROS `map_server`, a vector map, or walls that `locsim map` has written.
    ///
    /// Raises:
    ///     ScenarioError: The file is refused, with line and key.
    #[staticmethod]
    fn load(path: PathBuf) -> Result<Self, Error> {
        Self::of(load_map(&path)?.geometry)
    }

    /// Lower and upper corner [x0, y0, x1, y1] [m].
    #[getter]
    fn bounds(&self) -> [f64; 4] {
        self.exact.exact.bounds()
    }

    /// Ends of each wall [m], float64 [walls, 2, 2].
    #[getter]
    fn walls<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let walls = self.exact.walls();
        let values: Vec<f64> = walls.iter().flatten().flatten().copied().collect();
        numpy(py, &values, &[walls.len(), 2, 2])
    }

    /// Whether a robot can stand at each point. Points [..., 2] [m]; bool [...].
    fn is_free<'py>(&self, py: Python<'py>, points: &Bound<'py, PyAny>) -> Result<Bound<'py, PyAny>, Error> {
        let (points, shape) = Self::points(points)?;
        let (points, _) = points.values.as_chunks();
        Ok(booleans(py, points.iter().map(|&[x, y]| self.exact.exact.is_free(x, y)), &shape)?)
    }

    /// Distance of each point to the nearest wall [m], to a cell of 5 cm and at most 2 m. Points [..., 2] [m]; float32 [...].
    fn distance<'py>(&self, py: Python<'py>, points: &Bound<'py, PyAny>) -> Result<Bound<'py, PyAny>, Error> {
        let (points, shape) = Self::points(points)?;
        let (points, _) = points.values.as_chunks();
        let distances: Vec<f32> = points.iter().map(|&[x, y]| self.exact.distance.distance(x, y)).collect();
        Ok(numpy(py, &distances, &shape)?)
    }

    /// Random poses (x, y, theta) that keep 25 cm from the walls, float64 [count, 3]; fewer, where the map has next to no room.
    #[pyo3(signature = (count, *, seed = 0))]
    fn free_poses<'py>(&self, py: Python<'py>, count: u32, seed: u64) -> PyResult<Bound<'py, PyAny>> {
        if count > MOST_PARTICLES {
            return Err(refused(format!("count: {count} is not allowed; at most {MOST_PARTICLES}")).into());
        }
        let poses = py.detach(|| free_poses(&self.exact, count, seed));
        pose_array(py, poses.iter())
    }

    /// Nominal ranges: how far each beam gets in the map, exactly.
    ///
    /// Args:
    ///     poses: Poses of the laser [poses, 3].
    ///     bearings: Bearings of the beams [rad], [beams].
    ///     max_range: A beam that meets nothing has this range [m]; longer than any by default.
    ///
    /// Returns:
    ///     Ranges [m], float32 [poses, beams].
    #[pyo3(signature = (poses, bearings, *, max_range = None))]
    fn cast<'py>(
        &self,
        py: Python<'py>,
        poses: &Bound<'py, PyAny>,
        bearings: &Bound<'py, PyAny>,
        max_range: Option<f32>,
    ) -> Result<Bound<'py, PyAny>, Error> {
        let laser = self::poses(poses, "poses")?;
        let bearings = bearings_of(bearings)?;
        let reach = positive("max_range", max_range.unwrap_or(self.diagonal()))?;
        let hits = py.detach(|| {
            let mut hits = Hits::default();
            self.exact.exact.cast(laser.as_poses(), &bearings, reach, &mut hits);
            hits
        });
        Ok(numpy(py, &hits.range, &[laser.len(), bearings.len()])?)
    }

    /// The same with all that sensor models ask of a beam, cast to 1.5 times the sensor's maximum range [m]: objects stand in front
    /// of walls that are just beyond it.
    fn beams(
        &self,
        py: Python<'_>,
        poses: &Bound<'_, PyAny>,
        bearings: &Bound<'_, PyAny>,
        max_range: f32,
    ) -> Result<Beams, Error> {
        let laser = self::poses(poses, "poses")?;
        let bearings = bearings_of(bearings)?;
        let max_range = positive("max_range", max_range)?;
        let hits = py.detach(|| {
            let mut hits = Hits::default();
            self.exact.exact.cast(laser.as_poses(), &bearings, CAST_REACH * max_range, &mut hits);
            hits
        });
        let shape = vec![laser.len(), bearings.len()];
        let distance = Some(Arc::clone(&self.exact.distance));
        Ok(Beams { shape, laser, bearings, hits, max_range, distance })
    }

    fn __repr__(&self) -> String {
        let [x0, y0, x1, y1] = self.exact.exact.bounds();
        format!("Map({:.1} x {:.1} m, {} walls)", x1 - x0, y1 - y0, self.geometry().segments().len())
    }
}

/// Beams with their nominal ray casts: what sensor models are asked about. `Map.beams` casts them.
#[pyclass(frozen, module = "locsim")]
pub struct Beams {
    /// \[poses, beams\], or \[beams\] of states without poses.
    pub shape: Vec<usize>,
    pub laser: Particles,
    pub bearings: Vec<f32>,
    pub hits: Hits,
    pub max_range: f32,
    /// Of the map that they were cast into.
    pub distance: Option<Arc<dyn DistanceMap>>,
}

impl Beams {
    pub fn view(&self) -> locsim_core::Beams<'_> {
        self.hits.beams(self.laser.as_poses(), &self.bearings, self.max_range)
    }
}

#[pymethods]
impl Beams {
    /// Beams that are known by their state alone, without poses and map: enough for all models but the likelihood field and
    /// `np_reg_field`.
    ///
    /// Args:
    ///     ranges: Nominal range of each [m], at most 1.5 times the maximum range, [states].
    ///     incidences: Angle between the beam and the surface's normal [rad], 0 to pi/2, [states].
    ///     max_range: The sensor's maximum range [m].
    #[staticmethod]
    fn of_states(
        ranges: &Bound<'_, PyAny>,
        incidences: &Bound<'_, PyAny>,
        max_range: f32,
    ) -> Result<Self, Error> {
        let (range, shape) = Array::<f32>::with_axes(ranges, "ranges", ["states"])?;
        let (incidence, of_incidences) = Array::<f32>::with_axes(incidences, "incidences", ["states"])?;
        if shape != of_incidences {
            return Err(refused(format!("incidences: {} for {} ranges", of_incidences[0], shape[0])));
        }
        let max_range = positive("max_range", max_range)?;
        let n = range.len();
        let hits = Hits { range, incidence, surface: vec![NO_SURFACE; n] };
        let laser = [Pose2::IDENTITY].into_iter().collect();
        Ok(Self { shape: shape.to_vec(), laser, bearings: vec![0.0; n], hits, max_range, distance: None })
    }

    /// Nominal ranges [m], float32 of the shape of the beams.
    #[getter]
    fn ranges<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        numpy(py, &self.hits.range, &self.shape)
    }

    /// Angles between beam and surface's normal [rad], float32.
    #[getter]
    fn incidences<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        numpy(py, &self.hits.incidence, &self.shape)
    }

    /// Number of the surface that each beam meets, uint32; 2**32 - 1 for none.
    #[getter]
    fn surfaces<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        numpy(py, &self.hits.surface, &self.shape)
    }

    /// The sensor's maximum range [m].
    #[getter]
    fn max_range(&self) -> f32 {
        self.max_range
    }

    /// [poses, beams], or [states] without poses.
    #[getter]
    fn shape(&self) -> Vec<usize> {
        self.shape.clone()
    }

    fn __repr__(&self) -> String {
        format!("Beams({:?}, max_range={})", self.shape, self.max_range)
    }
}
