//! numpy arrays in and out, and Python values as JSON. An array is copied once each way, but for views of memory that the crates
//! share and don't write to meanwhile.

use std::any::Any;
use std::sync::Arc;

use bytemuck::Pod;
use locsim_core::limits::COORDINATE;
use locsim_core::{Particles, Pose2};
use pyo3::buffer::{Element, PyBuffer};
use pyo3::prelude::*;
use pyo3::types::{PyByteArray, PyDict};
use serde::Serialize;
use serde_json::Value;

use crate::error::{Error, refused};

/// A number that arrays hold.
pub trait Number: Element + Pod {
    /// Its name in numpy.
    const DTYPE: &'static str;
}

impl Number for f32 {
    const DTYPE: &'static str = "f4";
}

impl Number for f64 {
    const DTYPE: &'static str = "f8";
}

impl Number for u32 {
    const DTYPE: &'static str = "u4";
}

impl Number for u8 {
    const DTYPE: &'static str = "u1";
}

/// An array in C order.
pub struct Array<T> {
    pub values: Vec<T>,
    pub shape: Vec<usize>,
}

impl<T: Number> Array<T> {
    /// Anything that `numpy.asarray` takes; `name` is the argument's.
    pub fn of(value: &Bound<'_, PyAny>, name: &str) -> Result<Self, Error> {
        let py = value.py();
        let read = || -> PyResult<Self> {
            let array = py.import("numpy")?.call_method1("asarray", (value, T::DTYPE))?;
            let shape = array.getattr("shape")?.extract()?;
            // A single number has no buffer with a shape.
            let values = PyBuffer::<T>::get(&array.call_method0("ravel")?)?.to_vec(py)?;
            Ok(Self { values, shape })
        };
        read().map_err(|error| refused(format!("{name}: {}", error.value(py))))
    }

    /// [`Array::of`] with `N` axes, whose names are for the error.
    pub fn with_axes<const N: usize>(
        value: &Bound<'_, PyAny>,
        name: &str,
        axes: [&str; N],
    ) -> Result<(Vec<T>, [usize; N]), Error> {
        let Self { values, shape } = Self::of(value, name)?;
        let shape = <[usize; N]>::try_from(shape.as_slice()).map_err(|_| wrong(name, &shape, &axes))?;
        Ok((values, shape))
    }
}

/// The error of an array of another shape.
pub fn wrong(name: &str, shape: &[usize], axes: &[&str]) -> Error {
    refused(format!("{name}: the shape {shape:?} is not allowed; [{}]", axes.join(", ")))
}

/// Poses \[n, 3\] as x \[m\], y \[m\] and heading \[rad\]; a single pose may have the shape \[3\].
pub fn poses(value: &Bound<'_, PyAny>, name: &str) -> Result<Particles, Error> {
    let Array { values, shape } = Array::<f64>::of(value, name)?;
    if !matches!(shape.as_slice(), [3] | [_, 3]) {
        return Err(wrong(name, &shape, &["poses", "3 (x, y, theta)"]));
    }
    if values.iter().any(|value| !(-COORDINATE..=COORDINATE).contains(value)) {
        return Err(refused(format!("{name}: a pose is not finite, or beyond {COORDINATE:e}")));
    }
    let (rows, _) = values.as_chunks();
    Ok(rows.iter().map(|&[x, y, theta]| Pose2::new(x, y, theta)).collect())
}

/// Bearings of beams \[rad\].
pub fn bearings(value: &Bound<'_, PyAny>) -> Result<Vec<f32>, Error> {
    let (bearings, _) = Array::<f32>::with_axes(value, "bearings", ["beams"])?;
    match bearings.iter().position(|bearing| !bearing.is_finite()) {
        Some(beam) => Err(refused(format!(
            "bearings: {} of beam {beam} is not allowed; finite numbers",
            bearings[beam]
        ))),
        None => Ok(bearings),
    }
}

/// A writable numpy array of its own.
pub fn numpy<'py, T: Number>(py: Python<'py>, values: &[T], shape: &[usize]) -> PyResult<Bound<'py, PyAny>> {
    let bytes = PyByteArray::new(py, bytemuck::cast_slice(values));
    let array = py.import("numpy")?.call_method1("frombuffer", (bytes, T::DTYPE))?;
    array.call_method1("reshape", (shape,))
}

/// Memory that numpy reads: its values stay where and as they are while this is held, which the array does.
#[pyclass(frozen, module = "locsim")]
struct View {
    _owner: Arc<dyn Any + Send + Sync>,
    address: usize,
    length: usize,
    kind: String,
}

#[pymethods]
impl View {
    /// numpy's array interface, version 3; `True` for memory that isn't to be written to.
    #[getter]
    fn __array_interface__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let interface = PyDict::new(py);
        interface.set_item("version", 3)?;
        interface.set_item("shape", (self.length,))?;
        interface.set_item("typestr", &self.kind)?;
        interface.set_item("data", (self.address, true))?;
        Ok(interface)
    }
}

/// A read-only numpy array \[n\] in the memory of `owner`, without a copy. The array keeps the owner. No one writes to what an [`Arc`]
/// shares, so that the values stay.
pub fn view<'py, O: Any + Send + Sync, T: Number>(
    py: Python<'py>,
    owner: &Arc<O>,
    values: fn(&O) -> &[T],
) -> PyResult<Bound<'py, PyAny>> {
    let values = values(owner);
    let order = if cfg!(target_endian = "big") { '>' } else { '<' };
    let view = View {
        _owner: Arc::<O>::clone(owner),
        address: values.as_ptr().expose_provenance(),
        length: values.len(),
        kind: format!("{order}{}", T::DTYPE),
    };
    py.import("numpy")?.call_method1("asarray", (view,))
}

/// A numpy array of booleans.
pub fn booleans<'py>(
    py: Python<'py>,
    values: impl IntoIterator<Item = bool>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyAny>> {
    let values: Vec<u8> = values.into_iter().map(u8::from).collect();
    numpy(py, &values, shape)?.call_method1("view", ("?",))
}

/// Poses as an array \[n, 3\].
pub fn pose_array(py: Python<'_>, poses: impl ExactSizeIterator<Item = Pose2>) -> PyResult<Bound<'_, PyAny>> {
    let shape = [poses.len(), 3];
    let values: Vec<f64> = poses.flat_map(|pose| [pose.x, pose.y, pose.theta]).collect();
    numpy(py, &values, &shape)
}

/// A value as Python's own dicts, lists and numbers.
pub fn python<'py>(py: Python<'py>, value: &impl Serialize) -> Result<Bound<'py, PyAny>, Error> {
    loads(py, &serde_json::to_string(value)?)
}

/// JSON as Python's own dicts, lists and numbers.
pub fn loads<'py>(py: Python<'py>, json: &str) -> Result<Bound<'py, PyAny>, Error> {
    Ok(py.import("json")?.call_method1("loads", (json,))?)
}

/// Python's dicts, lists and numbers, numpy's among them, as a tree.
pub fn tree(value: &Bound<'_, PyAny>) -> Result<Value, Error> {
    let text: String = value.py().import("locsim._support")?.call_method1("to_json", (value,))?.extract()?;
    Ok(serde_json::from_str(&text)?)
}
