//! The camera: pixels to directions.
//!
//! In: a camera entry of a scene and a picture size. Out: for any point of the picture the unit
//! direction in the standard frame at the camera. Pixel (0, 0) is the upper left one; its middle is
//! the point (0.5, 0.5). The picture is upright and not mirrored: right is `look × up`.

use super::{
    camera::Camera,
    scene::{CameraEntry, CameraPosition},
};
use geofan_core::{
    diagnostic::{Diagnostic, SourceText},
    error::Result,
    manifold::Manifold,
};
use glam::{DMat3, DQuat, DVec2, DVec3};
use std::{ops::Range, sync::Arc};

/// A camera with a picture plane.
#[derive(Debug, Clone)]
pub struct View {
    /// Chart point.
    pub u: DVec3,
    /// Pixels across and down.
    pub size: (usize, usize),
    look: DVec3,
    /// To the right and down by one pixel, on the plane at distance 1.
    right: DVec3,
    down: DVec3,
    /// The point of the picture in the direction of the look.
    middle: DVec2,
}

impl View {
    /// The view of `camera` from the chart point `u`.
    pub fn new(camera: &CameraEntry, u: DVec3, size: (usize, usize)) -> Self {
        let placed = Camera::looking(u, camera.look, camera.up);
        Self::of_camera(&placed, camera.fov_degrees, size)
    }

    /// What `camera` sees at a horizontal angle of view of `fov_degrees`.
    pub fn of_camera(camera: &Camera, fov_degrees: f64, size: (usize, usize)) -> Self {
        let pixel = 2.0 * (0.5 * fov_degrees.to_radians()).tan() / size.0 as f64;
        let axes = DMat3::from_quat(camera.rotation);
        Self {
            u: camera.u,
            size,
            look: -axes.z_axis,
            right: axes.x_axis * pixel,
            down: -axes.y_axis * pixel,
            middle: DVec2::new(0.5 * size.0 as f64, 0.5 * size.1 as f64),
        }
    }

    /// The camera that sees this.
    pub fn camera(&self) -> Camera {
        Camera::looking(self.u, self.look, -self.down)
    }

    /// The point of the picture in `direction` (standard frame): the inverse of
    /// [`View::direction`]; `None` behind the camera.
    pub fn pixel(&self, direction: DVec3) -> Option<(f64, f64)> {
        let depth = direction.dot(self.look);
        let along = |axis: DVec3| direction.dot(axis) / (depth * axis.length_squared());
        (depth > 0.0).then(|| {
            (
                along(self.right) + self.middle.x,
                along(self.down) + self.middle.y,
            )
        })
    }

    /// The direction of the middle of the picture.
    pub fn look(&self) -> DVec3 {
        self.look
    }

    /// The same view from `u`: the same components in the standard frame there.
    pub fn moved(&self, u: DVec3) -> Self {
        Self { u, ..self.clone() }
    }

    /// The view turned by `angle` (radians) to the right about the picture's upward direction.
    pub fn turned(&self, angle: f64) -> Self {
        let turn = DQuat::from_axis_angle(self.down.normalize(), angle);
        Self {
            look: turn * self.look,
            right: turn * self.right,
            ..self.clone()
        }
    }

    /// The part of the picture in these columns and rows, as a picture of its own by the same camera.
    pub fn part(&self, columns: Range<usize>, rows: Range<usize>) -> Self {
        let corner = DVec2::new(columns.start as f64, rows.start as f64);
        Self {
            size: (columns.len(), rows.len()),
            middle: self.middle - corner,
            ..self.clone()
        }
    }

    /// The direction of the point (x, y) of the picture.
    pub fn direction(&self, x: f64, y: f64) -> DVec3 {
        let (x, y) = (x - self.middle.x, y - self.middle.y);
        (self.look + self.right * x + self.down * y).normalize()
    }

    /// The angle of one pixel in the middle of the picture, radians: the largest there is.
    pub fn pixel_angle(&self) -> f64 {
        self.right.length()
    }
}

/// The chart point of a camera entry.
///
/// # Errors
/// Parameters that the manifold's region does not have, or a point outside the domain.
pub fn camera_point(
    manifold: &Manifold,
    source: &Arc<SourceText>,
    camera: &CameraEntry,
) -> Result<DVec3> {
    let complain = |message: String| Diagnostic::new(source, camera.position_span.clone(), message);
    let u = match &camera.position {
        CameraPosition::Chart(u) => *u,
        CameraPosition::Parameters(given) => by_parameters(manifold, given).map_err(complain)?,
    };
    match manifold.domain.violation(u) {
        None if u.is_finite() => Ok(u),
        _ => Err(
            complain("the camera is outside the manifold's domain".into())
                .with_hint("see [domain] in the manifold file")
                .into(),
        ),
    }
}

fn by_parameters(manifold: &Manifold, given: &[(String, f64)]) -> Result<DVec3, String> {
    let Some(region) = &manifold.cameras else {
        return Err("the manifold has no camera region, so no camera parameters".into());
    };
    if let Some((name, _)) = given.iter().find(|(n, _)| !region.names.contains(n)) {
        let known = region.names.join(", ");
        return Err(format!(
            "`{name}` is not a camera parameter; there are: {known}"
        ));
    }
    let mut values = Vec::new();
    for name in &region.names {
        match given.iter().find(|(n, _)| n == name) {
            Some((_, value)) => values.push(*value),
            None => return Err(format!("the camera parameter `{name}` is missing")),
        }
    }
    if !region.contains(&values) {
        return Err("the camera parameters are outside their intervals".into());
    }
    Ok(region.at(&values))
}
