//! Whether a geodesic can start at a point that a user asked for.
//!
//! In: a chart point, and a unit direction in the standard frame there. Out: a [`Ray`], or an
//! [`Error::Input`] that says what is wrong with the point.

use super::Ray;
use crate::{
    error::{Error, Result},
    manifold::{EventKind, Gluing, Manifold},
};
use glam::{DMat3, DVec3};

/// The ray from `u` in the direction `d` (standard frame, unit); `subject` names where the point
/// came from, for the complaint.
///
/// # Errors
/// As [`check_start`].
pub fn depart(manifold: &Manifold, subject: &str, u: DVec3, d: DVec3, length: f64) -> Result<Ray> {
    check_start(manifold, subject, u)?;
    Ok(Ray::new(manifold, u, d, length))
}

/// The tightest and the loosest local error of a step that the integrator is asked for: below the
/// first, rounding decides; above the second, steps skip over what they should see.
pub const TOLERANCES: std::ops::RangeInclusive<f64> = 1e-14..=1e-1;

/// Returns `v` at unit length; `None` if it is zero or not finite.
pub fn unit(v: DVec3) -> Option<DVec3> {
    // Scaled first, so that no square overflows or vanishes.
    let largest = v.abs().max_element();
    (v.is_finite() && largest > 0.0).then(|| (v / largest).normalize())
}

/// Refuses a point outside the domain, or where the metric is not finite and positive definite.
///
/// # Errors
/// [`Error::Input`] about `subject`.
pub fn check_point(manifold: &Manifold, subject: &str, u: DVec3) -> Result<()> {
    match fault(manifold, u) {
        None => Ok(()),
        Some(fault) => Err(Error::input(
            subject,
            format!("{}: {fault}", named(manifold, u)),
        )),
    }
}

/// Refuses a point from which no path can be seen: as [`check_point`], and beyond an exit.
///
/// # Errors
/// [`Error::Input`] about `subject`.
pub fn check_start(manifold: &Manifold, subject: &str, u: DVec3) -> Result<()> {
    check_point(manifold, subject, u)?;
    match beyond_exit(manifold, u) {
        None => Ok(()),
        Some(fault) => Err(Error::input(
            subject,
            format!("{}: {fault}; start on this side of it", named(manifold, u)),
        )),
    }
}

/// Says which exit a point lies beyond, and the value of its formula there; `None` if it lies beyond none.
pub fn beyond_exit(manifold: &Manifold, u: DVec3) -> Option<String> {
    let (exit, value) = manifold.domain.exit_beyond(u)?;
    let name = &manifold.exits[exit].name;
    Some(format!(
        "the point lies beyond the exit `{name}`, whose `when` is {value:.6} there (a path leaves where it becomes positive)"
    ))
}

fn fault(manifold: &Manifold, u: DVec3) -> Option<String> {
    if !u.is_finite() {
        return Some("the point is not finite".into());
    }
    match manifold.domain.violation(u) {
        Some(EventKind::Limit) => return Some(limit_fault(manifold, u)),
        Some(_) => return Some("the point violates a condition of `inside`".into()),
        None => {}
    }
    if let Some(gluing) = manifold.gluing() {
        match gluing.locate(u) {
            Some(_) => {}
            None => return Some(gluing_fault(gluing, u)),
        }
    }
    let (g, s) = manifold.metric_and_frame(u);
    let finite = |m: DMat3| m.to_cols_array().iter().all(|x| x.is_finite());
    if !finite(g) {
        return Some("the metric is not finite there".into());
    }
    let positive = finite(s) && (0..3).all(|k| s.col(k)[k] > 0.0);
    (!positive).then(|| "the metric is not positive definite there".into())
}

fn gluing_fault(gluing: &Gluing, u: DVec3) -> String {
    match gluing.behind_mirror(u) {
        Some(k) => format!("the point lies behind the mirror of face {}", k + 1),
        None => "the point cannot be brought into the glued domain".into(),
    }
}

fn limit_fault(manifold: &Manifold, u: DVec3) -> String {
    let domain = &manifold.domain;
    let beyond = (0..3).find_map(|k| {
        let [low, high] = domain.limits[k].filter(|_| !domain.periodic[k])?;
        let name = &manifold.coordinates[k];
        (!(low..=high).contains(&u[k]))
            .then(|| format!("`{name}` must lie in its limits [{low}, {high}]"))
    });
    beyond.unwrap_or_else(|| "the point is outside a coordinate limit".into())
}

fn named(manifold: &Manifold, u: DVec3) -> String {
    let [x, y, z] = &manifold.coordinates;
    format!("{x} = {}, {y} = {}, {z} = {}", u.x, u.y, u.z)
}
