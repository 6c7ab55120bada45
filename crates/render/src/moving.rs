//! Objects that move: where they are at a time, and how what they carry is turned.
//!
//! In: an [`ObjectEntry`] with a path, and a time. Out: the entry as it is then. Along a curve of the chart the
//! object's frame is carried by parallel transport, from the standard frame at the path's start on; a closed path
//! brings it back turned by the holonomy of the loop. Along key poses it goes as a camera does ([`Journey`]).

use super::{
    journey::Journey,
    scene::{Course, ObjectEntry, Trajectory},
};
use geofan_core::{
    diagnostic::{Diagnostic, SourceText},
    error::Result,
    geodesic::{check_point, transport},
    manifold::{ChartCurve, Manifold},
};
use glam::{DQuat, DVec3};
use std::{borrow::Cow, sync::Arc};

/// The number of places at which a path is looked at before anything moves along it.
const PROBES: usize = 256;

/// Error of a step of the transport, radians: of a thousand of them no picture shows anything.
const TOLERANCE: f64 = 1e-10;

/// A path, where the manifold is known.
enum KnownCourse {
    Curve(ChartCurve),
    Journey(Box<Journey>),
}

/// Returns an object as it is at `time`: before and after its path, as at the path's ends.
///
/// # Errors
/// The path is no path of this manifold, or leaves its domain: where, in `source`.
pub(super) fn at_time<'o>(
    object: &'o ObjectEntry,
    manifold: &Manifold,
    source: &Arc<SourceText>,
    time: f64,
) -> Result<Cow<'o, ObjectEntry>> {
    let Some(trajectory) = &object.path else {
        return Ok(Cow::Borrowed(object));
    };
    let [from, to] = trajectory.during;
    let time = time.clamp(from, to);
    let course = match &trajectory.course {
        Course::Curve(formulas) => KnownCourse::Curve(formulas.curve(manifold, source)?),
        Course::Poses(poses) => KnownCourse::Journey(Box::new(Journey::new(manifold, poses)?)),
    };
    check_inside(&course, trajectory, manifold, source)?;
    let turned = turning_at(trajectory, manifold, source, time)?;
    let (at, carried) = match &course {
        KnownCourse::Journey(journey) => {
            let camera = journey.pose_in_cover(time).0;
            (camera.u, camera.rotation)
        }
        KnownCourse::Curve(curve) => {
            let way = |t: f64| curve.at(t);
            let carried = transport(&manifold.still(), way, [from, time], TOLERANCE);
            let carried = carried.map_err(|e| complain(trajectory, source, e.to_string()))?;
            (curve.at(time).0, carried.rotation)
        }
    };
    Ok(Cow::Owned(ObjectEntry {
        at: manifold.domain.wrap(at),
        rotation: (carried * turned * object.rotation).normalize(),
        ..object.clone()
    }))
}

/// The object's own turn at a time.
fn turning_at(
    trajectory: &Trajectory,
    manifold: &Manifold,
    source: &Arc<SourceText>,
    time: f64,
) -> Result<DQuat> {
    let Some((axis, degrees)) = &trajectory.turning else {
        return Ok(DQuat::IDENTITY);
    };
    let angle = degrees.curve(manifold, source)?.at(time).0.x;
    match angle.is_finite() {
        true => Ok(DQuat::from_axis_angle(*axis, angle.to_radians())),
        false => {
            let message = format!("the object's turning is not finite at t = {time}");
            Err(complain(trajectory, source, message).into())
        }
    }
}

/// Refuses a path that leaves the domain, with the first place where it does.
fn check_inside(
    course: &KnownCourse,
    trajectory: &Trajectory,
    manifold: &Manifold,
    source: &Arc<SourceText>,
) -> Result<()> {
    let [from, to] = trajectory.during;
    for i in 0..=PROBES {
        let t = from + (to - from) * i as f64 / PROBES as f64;
        let u: DVec3 = match course {
            KnownCourse::Curve(curve) => curve.at(t).0,
            KnownCourse::Journey(journey) => journey.pose_in_cover(t).0.u,
        };
        if let Err(fault) = check_point(manifold, &format!("the object's path at t = {t}"), u) {
            let hint = "see [domain] in the manifold file; shorten `during`, or lead it elsewhere";
            return Err(complain(trajectory, source, fault.to_string())
                .with_hint(hint)
                .into());
        }
    }
    Ok(())
}

fn complain(trajectory: &Trajectory, source: &Arc<SourceText>, message: String) -> Diagnostic {
    Diagnostic::new(source, trajectory.span.clone(), message)
}
