//! Cameras: their place, their axes, and how they move.

use crate::{
    arrays::{positive, room},
    errors::{About, refuse},
    manifold::vectors,
    work,
};
use geofan_core::{
    geodesic::{check_point, unit},
    manifold::Manifold,
};
use geofan_render::{self as render, View};
use glam::{DMat3, DQuat, DVec3};
use numpy::PyArray2;
use pyo3::prelude::*;
use std::sync::Arc;

/// A camera in a manifold.
#[pyclass(frozen, module = "geofan._native")]
pub struct Camera {
    space: Arc<Manifold>,
    /// The library's.
    pub placed: render::Camera,
    /// Horizontal angle of view, degrees.
    pub fov: f64,
}

/// Below this sine of the angle between them, `up` and `look` do not say how a picture is turned.
const PARALLEL: f64 = 1e-6;

impl Camera {
    /// Returns a camera at `at` that looks along `look`.
    pub fn looking(
        py: Python<'_>,
        space: Arc<Manifold>,
        at: [f64; 3],
        look: [f64; 3],
        up: [f64; 3],
        fov: f64,
    ) -> PyResult<Self> {
        let u = DVec3::from_array(at);
        check_point(&space, "at", u).map_err(|e| About::Input.raise(py, e))?;
        let direction = |name: &str, v: [f64; 3]| {
            unit(v.into())
                .ok_or_else(|| refuse(py, name, "a direction must be finite and not be zero"))
        };
        let (look, up) = (direction("look", look)?, direction("up", up)?);
        if look.cross(up).length() < PARALLEL {
            return Err(refuse(py, "up", "is parallel to `look`"));
        }
        if !(fov > 0.0 && fov < 180.0) {
            return Err(refuse(
                py,
                "fov",
                format!("{fov} does not lie between 0 and 180"),
            ));
        }
        Ok(Self {
            placed: render::Camera::looking(u, look, up),
            space,
            fov,
        })
    }

    /// Takes a camera of a scene.
    pub fn placed(space: Arc<Manifold>, placed: render::Camera, fov: f64) -> Self {
        Self { space, placed, fov }
    }

    /// Returns what it sees on a picture of this size.
    pub fn view(&self, size: (usize, usize)) -> View {
        View::of_camera(&self.placed, self.fov, size)
    }
}

#[pymethods]
impl Camera {
    /// Returns the chart point.
    #[getter]
    fn at(&self) -> [f64; 3] {
        self.placed.u.to_array()
    }

    /// Returns the horizontal angle of view, degrees.
    #[getter(fov)]
    fn angle(&self) -> f64 {
        self.fov
    }

    /// Returns its axes (right, up, back) in the standard frame.
    #[getter]
    fn rotation(&self) -> [[f64; 3]; 3] {
        DMat3::from_quat(self.placed.rotation).to_cols_array_2d()
    }

    /// Returns its axes (right, up, back) in chart components.
    #[getter]
    fn axes(&self) -> [[f64; 3]; 3] {
        self.placed.axes(&self.space).to_cols_array_2d()
    }

    /// Returns the camera moved along a geodesic by lengths to the right, up and forward, and how far it came.
    fn moved(&self, py: Python<'_>, by: [f64; 3]) -> PyResult<(Self, f64)> {
        let [right, up, forward] = by;
        let by = DVec3::new(right, up, -forward);
        if !by.is_finite() {
            return Err(refuse(py, "moved", "lengths must be finite"));
        }
        let moved = work::run(py, About::Input, 1, |_| {
            Ok(self.placed.moved(&self.space, by))
        })?;
        Ok((self.with(moved.camera), moved.length))
    }

    /// Returns the camera turned by angles in degrees: to the right, up, and clockwise.
    fn turned(&self, py: Python<'_>, by: [f64; 3]) -> PyResult<Self> {
        if !by.iter().all(|angle| angle.is_finite()) {
            return Err(refuse(py, "turned", "angles must be finite"));
        }
        let [right, up, roll] = by.map(f64::to_radians);
        let turn = DQuat::from_rotation_y(-right)
            * DQuat::from_rotation_x(up)
            * DQuat::from_rotation_z(-roll);
        Ok(self.with(self.placed.turned(turn)))
    }

    /// Returns the camera with another angle of view.
    fn zoomed(&self, py: Python<'_>, fov: f64) -> PyResult<Self> {
        match positive(py, "fov", fov)? < 180.0 {
            true => Ok(Self {
                space: self.space.clone(),
                placed: self.placed,
                fov,
            }),
            false => Err(refuse(
                py,
                "fov",
                format!("{fov} does not lie between 0 and 180"),
            )),
        }
    }

    /// Returns the directions of pixels' middles, standard frame: rows of pixels, from the upper left.
    fn directions<'py>(
        &self,
        py: Python<'py>,
        size: (usize, usize),
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        room(py, "size", &[size.0, size.1, 3])?;
        let view = self.view(size);
        let middle = |i: usize| {
            let (x, y) = (i % size.0, i / size.0);
            view.direction(x as f64 + 0.5, y as f64 + 0.5)
        };
        vectors(py, (0..size.0 * size.1).map(middle))
    }
}

impl Camera {
    /// Puts it elsewhere.
    fn with(&self, placed: render::Camera) -> Self {
        Self {
            space: self.space.clone(),
            placed,
            fov: self.fov,
        }
    }
}
