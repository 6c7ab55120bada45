//! Where the camera of a scene is, and how it moves.
//!
//! In: a camera entry and a manifold. Out: its chart point ([`camera_point`]) and its velocity past the normal observer
//! there ([`camera_velocity`]); what cannot be is refused at its place in the file.

use crate::scene::{CameraEntry, CameraPosition};
use geofan_core::{
    diagnostic::{Diagnostic, SourceText},
    error::{Error, Result},
    geodesic::{beyond_exit, check_point},
    manifold::Manifold,
};
use glam::DVec3;
use std::sync::Arc;

/// Finds the velocity past the normal observer of a camera at `u`, standard frame.
///
/// # Errors
/// It is to be at rest where nothing can be.
pub fn camera_velocity(
    manifold: &Manifold,
    source: &Arc<SourceText>,
    camera: &CameraEntry,
    u: DVec3,
) -> Result<DVec3> {
    camera.motion.velocity(manifold, u).ok_or_else(|| {
        let message = format!("nothing can be at rest at {u}: it would be as fast as light");
        Diagnostic::new(source, camera.motion_span.clone(), message)
            .with_label("the camera is to be at rest in the chart")
            .with_hint("take it out of the ergosphere or horizon, or leave `rest` out")
            .into()
    })
}

/// Finds the chart point of a camera entry, within the limits of periodic coordinates.
///
/// # Errors
/// Parameters that the manifold's region does not have, or a point outside the domain or beyond an exit.
pub fn camera_point(
    manifold: &Manifold,
    source: &Arc<SourceText>,
    camera: &CameraEntry,
) -> Result<DVec3> {
    given_point(manifold, source, camera).map(|u| manifold.domain.wrap(u))
}

/// Finds the chart point of a camera entry as it is given, which may be whole periods off: on the way between two such points
/// that counts.
///
/// # Errors
/// As [`camera_point`].
pub fn given_point(
    manifold: &Manifold,
    source: &Arc<SourceText>,
    camera: &CameraEntry,
) -> Result<DVec3> {
    let complain = |message: String| Diagnostic::new(source, camera.position_span.clone(), message);
    let u = match &camera.position {
        CameraPosition::Chart(u) => *u,
        CameraPosition::Parameters(given) => by_parameters(manifold, given).map_err(complain)?,
    };
    if u.is_finite()
        && manifold.domain.violation(u).is_none()
        && let Some(fault) = beyond_exit(manifold, u)
    {
        let hint = "move the camera to this side of the exit, or the exit farther out";
        return Err(complain(format!("the camera sees nothing here: {fault}"))
            .with_hint(hint)
            .into());
    }
    match manifold.domain.violation(u) {
        None if u.is_finite() => Ok(u),
        _ => {
            let why = match check_point(manifold, "the camera", u) {
                Err(Error::Input { message, .. }) => format!(": {message}"),
                _ => String::new(),
            };
            Err(
                complain(format!("the camera is outside the manifold's domain{why}"))
                    .with_hint("see [domain] in the manifold file")
                    .into(),
            )
        }
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
        let mut parameters = region.names.iter().zip(&region.intervals).zip(&values);
        let outside = parameters.find(|((_, [low, high]), value)| !(low..=high).contains(value));
        return Err(match outside {
            Some(((name, [low, high]), value)) => format!(
                "the camera parameter `{name}` is {value}, outside its interval from {low} to {high}"
            ),
            None => "the camera parameters are outside their intervals".into(),
        });
    }
    Ok(region.at(&values))
}
