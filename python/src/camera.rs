//! Cameras: their place, their axes, how they move, and those on their way through key poses.

use crate::{
    arrays::{positive, room, zeros},
    manifold::PyManifold,
    work::{self, About, refuse},
};
use geofan_core::{
    Error, Result,
    diagnostic::{Diagnostic, SourceText},
    geodesic::check_start,
    manifold::Manifold,
};
use geofan_render::{
    Camera, Journey, Part, PicturePanels, View, camera_point,
    scene::{CameraEntry, CameraMotion, CameraProjection, Lens, PoseFile, SceneFile, USUAL_FOV},
};
use glam::{DMat3, DQuat, DVec3};
use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use rayon::prelude::*;
use std::{fmt::Write, path::Path, sync::Arc};

/// Directions of pixels, flattened, and the numbers of columns and rows of the picture.
type PixelDirections<'py> = (Bound<'py, PyArray1<f64>>, (usize, usize));

/// A camera in a manifold.
#[pyclass(frozen, name = "Camera", module = "geofan._native")]
#[derive(Clone)]
pub struct PyCamera {
    space: Arc<Manifold>,
    placed: Camera,
    /// Angle of view, degrees.
    fov: f64,
    /// Projection, eyes and crop.
    pub lens: Lens,
    motion: CameraMotion,
}

impl PyCamera {
    /// Takes a camera of a text, from which paths must be able to start.
    pub fn of_entry(
        space: &Arc<Manifold>,
        source: &Arc<SourceText>,
        entry: &CameraEntry,
    ) -> Result<Self> {
        let u = camera_point(space, source, entry)?;
        let complain =
            |fault: Error| Diagnostic::new(source, entry.position_span.clone(), fault.to_string());
        // The domain does not say where the metric breaks down.
        check_start(space, "the camera", u).map_err(complain)?;
        Ok(Self {
            space: space.clone(),
            placed: Camera::looking(u, entry.look, entry.up),
            fov: entry.fov_degrees,
            lens: entry.lens,
            motion: entry.motion,
        })
    }

    /// Takes a camera of a journey that moves with `velocity` (standard frame); it draws as `like` does.
    pub fn on_the_way(
        space: &Arc<Manifold>,
        (placed, fov): (Camera, f64),
        velocity: DVec3,
        like: Option<&Self>,
    ) -> Self {
        let lens = like.map_or(Lens::default(), |like| like.lens);
        Self {
            space: space.clone(),
            placed,
            // The angle of a fisheye is no pose's.
            fov: match (lens.projection, like) {
                (CameraProjection::Fisheye, Some(like)) => like.fov,
                _ => fov,
            },
            lens,
            motion: match velocity == DVec3::ZERO {
                true => CameraMotion::Normal,
                false => CameraMotion::Velocity(velocity),
            },
        }
    }

    /// Divides the picture that it draws; of `crop` alone, if there is one.
    pub fn panels(&self, size: (usize, usize), crop: Option<Part>) -> Result<PicturePanels> {
        let u = self.placed.u;
        let velocity = self.motion.velocity(&self.space, u).ok_or_else(|| {
            let message = format!("nothing can be at rest at {u}: it would be as fast as light");
            Error::input("rest", message)
        })?;
        let seen = (self.placed, self.fov);
        let panels = PicturePanels::through(&self.space, seen, self.lens, size, crop)?;
        Ok(panels.with_velocity(velocity))
    }

    /// Writes the lines of a scene file that tell how it draws and moves.
    fn manner(&self) -> String {
        let mut text = String::new();
        let projection = self.lens.projection;
        // Writing to a string does not fail.
        let _ = writeln!(text, "projection = {:?}", projection.name());
        let _ = match projection {
            CameraProjection::Orthographic { width } => writeln!(text, "width = {width:?}"),
            CameraProjection::Perspective | CameraProjection::Fisheye => {
                writeln!(text, "fov = {:?}", self.fov)
            }
            CameraProjection::Panorama | CameraProjection::Cube => Ok(()),
        };
        if let Some(stereo) = self.lens.stereo {
            let (separation, layout) = (stereo.separation, stereo.layout.name());
            let convergence = match stereo.convergence.is_finite() {
                true => format!(", convergence = {:?}", stereo.convergence),
                false => String::new(),
            };
            let _ = writeln!(
                text,
                "stereo = {{ separation = {separation:?}{convergence}, layout = {layout:?} }}"
            );
        }
        if let Some(crop) = self.lens.crop {
            let _ = writeln!(text, "crop = {crop:?}");
        }
        let _ = match self.motion {
            CameraMotion::Normal => Ok(()),
            CameraMotion::Static => writeln!(text, "rest = \"static\""),
            CameraMotion::Velocity(v) => writeln!(text, "velocity = {:?}", v.to_array()),
        };
        text
    }
}

#[pymethods]
impl PyCamera {
    /// Reads the text of a scene file that has nothing but a camera.
    #[staticmethod]
    fn read(py: Python<'_>, manifold: &PyManifold, text: String) -> PyResult<Self> {
        let source = SourceText::new("camera", text);
        let read = || {
            let scene = SceneFile::parse(source, Path::new(""))?;
            Self::of_entry(&manifold.space, &scene.source, &scene.camera)
        };
        read().map_err(|e| About::Input.raise(py, e))
    }

    /// Returns the lines of the `[camera]` of a scene file.
    #[getter]
    fn text(&self) -> String {
        let axes = DMat3::from_quat(self.placed.rotation);
        let [at, look, up] = [self.placed.u, -axes.z_axis, axes.y_axis].map(|v| v.to_array());
        format!(
            "at = {at:?}\nlook = {look:?}\nup = {up:?}\n{}",
            self.manner()
        )
    }

    /// Names the projection.
    #[getter]
    fn projection(&self) -> &'static str {
        self.lens.projection.name()
    }

    /// Returns the velocity past the normal observer, standard frame; `None` where nothing can move so.
    #[getter]
    fn velocity(&self) -> Option<[f64; 3]> {
        let velocity = self.motion.velocity(&self.space, self.placed.u)?;
        Some(velocity.to_array())
    }

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
        let moved = work::run(py, About::Input, |_| Ok(self.placed.moved(&self.space, by)))?;
        if moved.length == 0.0 && by != DVec3::ZERO {
            let message =
                "no step of the way can be followed: it is too long, or the space ends here";
            return Err(refuse(py, "moved", message));
        }
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
        positive(py, "fov", fov)?;
        let message = match self.lens.projection {
            CameraProjection::Perspective if fov < 180.0 => None,
            CameraProjection::Fisheye if fov <= 360.0 => None,
            CameraProjection::Perspective => Some("does not lie between 0 and 180"),
            CameraProjection::Fisheye => Some("is more than 360"),
            _ => Some("is given, but this projection has no angle of view"),
        };
        match message {
            None => Ok(Self {
                fov,
                ..self.clone()
            }),
            Some(message) => Err(refuse(py, "fov", format!("{fov} {message}"))),
        }
    }

    /// Returns the directions of pixels' middles, standard frame: rows of pixels, from the upper left; and how many
    /// columns and rows there are.
    fn directions<'py>(
        &self,
        py: Python<'py>,
        size: (usize, usize),
    ) -> PyResult<PixelDirections<'py>> {
        if size.0.max(size.1) > LONGEST_SIDE {
            let message = format!("no side of a picture is longer than {LONGEST_SIDE}");
            return Err(refuse(py, "size", message));
        }
        let view = self.panels(size, None).and_then(PicturePanels::single);
        let view = view.map_err(|e| About::Input.raise(py, e))?;
        if !view.is_central() {
            let message = "its rays start at different points; directions alone do not tell them";
            return Err(refuse(py, "camera", message));
        }
        let (width, height) = view.size;
        room(py, "size", &[width, height, 3])?;
        let found = zeros(py, 3 * width * height)?;
        pixel_directions(py, &view, found.readwrite().as_slice_mut()?)?;
        Ok((found, view.size))
    }
}

impl PyCamera {
    /// Puts it elsewhere.
    fn with(&self, placed: Camera) -> Self {
        Self {
            placed,
            ..self.clone()
        }
    }
}

/// Writes the directions of the middles of a picture's pixels.
fn pixel_directions(py: Python<'_>, view: &View, numbers: &mut [f64]) -> PyResult<()> {
    let rows = numbers.par_chunks_mut(3 * view.size.0.max(1)).enumerate();
    work::run(py, About::Input, |observer| {
        rows.try_for_each(|(y, row)| {
            work::go_on(observer)?;
            for (x, to) in row.chunks_exact_mut(3).enumerate() {
                let direction = view.direction(x as f64 + 0.5, y as f64 + 0.5);
                to.copy_from_slice(&direction.to_array());
            }
            Ok(())
        })
    })
}

/// The most columns or rows of a picture whose directions are told.
const LONGEST_SIDE: usize = 1 << 24;

/// The most frames of an animation.
const MOST_FRAMES: usize = 1_000_000;

/// Returns the cameras of so many frames, evenly in time, of the text of a file of key poses; `like` says how they
/// draw.
#[pyfunction]
pub fn journey(
    py: Python<'_>,
    manifold: &PyManifold,
    text: (String, String),
    frames: usize,
    like: Option<&PyCamera>,
) -> PyResult<Vec<PyCamera>> {
    if !(2..=MOST_FRAMES).contains(&frames) {
        let message = format!("{frames} is not between 2 and {MOST_FRAMES}");
        return Err(refuse(py, "frames", message));
    }
    let (name, text) = text;
    work::run(py, About::Scene, |observer| {
        let usual_fov = like.map_or(USUAL_FOV, |like| like.fov);
        let poses = PoseFile::parse(SourceText::new(name, text), usual_fov)?;
        let journey = Journey::new(&manifold.space, &poses)?;
        let [from, to] = journey.interval();
        let camera = |number: usize| {
            let share = number as f64 / (frames - 1) as f64;
            let time = from + (to - from) * share;
            work::go_on(observer)?;
            let (seen, velocity) = (journey.pose(time), journey.velocity(time));
            Ok(PyCamera::on_the_way(&manifold.space, seen, velocity, like))
        };
        (0..frames).map(camera).collect()
    })
}
