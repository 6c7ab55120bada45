//! All geodesics between points.

use crate::{arrays::VectorRows, errors::About, manifold::vectors, work};
use geofan_core::{geodesic::check_point, manifold::Manifold};
use geofan_light::LightFan;
use glam::DVec3;
use numpy::PyArray1;
use pyo3::{prelude::*, types::PyDict};

/// Finds the geodesics from `p` to each of `q` up to `length`, at a local tolerance: by the number of the point,
/// and for each by ascending length.
pub fn connect<'py>(
    py: Python<'py>,
    manifold: &Manifold,
    p: DVec3,
    q: &VectorRows<'_>,
    length: f64,
    tolerance: f64,
) -> PyResult<Bound<'py, PyDict>> {
    let found = work::watch(py, About::Input, None, |_| {
        check_point(manifold, "p", p)?;
        let points = q.finite()?;
        for (row, u) in points.iter().enumerate() {
            check_point(manifold, &q.label(row), *u)?;
        }
        let none = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let region = points
            .iter()
            .fold(none, |(low, high), u| (low.min(*u), high.max(*u)));
        if points.is_empty() {
            return Ok(Vec::new());
        }
        let fan = LightFan::new(manifold, p, length, region);
        Ok(fan.connections(&points, tolerance).0)
    })?;
    let dict = PyDict::new(py);
    let index = found.iter().map(|(index, _)| *index as i64).collect();
    dict.set_item("index", PyArray1::<i64>::from_vec(py, index))?;
    let column = |of: fn(&geofan_light::Connection) -> f64| {
        PyArray1::from_vec(py, found.iter().map(|(_, c)| of(c)).collect())
    };
    dict.set_item("length", column(|c| c.s))?;
    dict.set_item("area", column(|c| c.area))?;
    dict.set_item(
        "direction",
        vectors(py, found.iter().map(|(_, c)| c.direction))?,
    )?;
    dict.set_item("u", vectors(py, found.iter().map(|(_, c)| c.u))?)?;
    dict.set_item("v", vectors(py, found.iter().map(|(_, c)| c.v))?)?;
    Ok(dict)
}
