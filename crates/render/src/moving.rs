//! Objects that move: where they are at a time, and how what they carry is turned.
//!
//! In: an [`ObjectEntry`] with a path ([`ObjectPath`]), and a time. Out: the entry as it is then. Along a curve of the
//! chart the object's frame is carried by parallel transport, from the standard frame at the path's start on; a closed
//! path brings it back turned by the holonomy of the loop. Along key poses it goes as a camera does ([`Journey`]).

use super::{
    journey::Journey,
    scene::{Course, ObjectEntry, Trajectory},
};
use geofan_core::{
    diagnostic::{Diagnostic, SourceText},
    error::{Error, Result},
    geodesic::{check_point, transport},
    manifold::{ChartCurve, Manifold},
};
use glam::{DQuat, DVec3};
use std::{borrow::Cow, sync::Arc};

/// The number of places at which a path is looked at before anything moves along it.
const PROBES: usize = 256;

/// Error of a step of the transport, radians: of a thousand of them no picture shows anything.
const TOLERANCE: f64 = 1e-10;

/// Where an object is, where the manifold is known.
enum KnownCourse {
    Curve(ChartCurve),
    Journey(Box<Journey>),
}

/// The path of an object, where the manifold is known.
pub(super) struct ObjectPath<'o> {
    object: &'o ObjectEntry,
    trajectory: &'o Trajectory,
    manifold: &'o Manifold,
    source: &'o Arc<SourceText>,
    course: KnownCourse,
    /// An axis of the object's own, and the angle turned about it, degrees.
    turning: Option<(DVec3, ChartCurve)>,
}

/// Returns an object as it is at `time`: before and after its path, as at the path's ends.
///
/// # Errors
/// The path is no path of this manifold, or leaves its domain: where, in `source`.
pub(super) fn at_time<'o>(
    object: &'o ObjectEntry,
    path: Option<&ObjectPath<'_>>,
    time: f64,
) -> Result<Cow<'o, ObjectEntry>> {
    let Some(path) = path else {
        return Ok(Cow::Borrowed(object));
    };
    let mut object = path.at(time)?;
    object.at = path.manifold.domain.wrap(object.at);
    Ok(Cow::Owned(object))
}

impl<'o> ObjectPath<'o> {
    /// Prepares the path of an object, if it has one.
    ///
    /// # Errors
    /// The path is no path of this manifold, or leaves its domain: where, in `source`.
    pub fn of(
        object: &'o ObjectEntry,
        manifold: &'o Manifold,
        source: &'o Arc<SourceText>,
    ) -> Result<Option<Self>> {
        let Some(trajectory) = &object.path else {
            return Ok(None);
        };
        let course = match &trajectory.course {
            Course::Curve(formulas) => KnownCourse::Curve(formulas.curve(manifold, source)?),
            Course::Poses(poses) => KnownCourse::Journey(Box::new(Journey::new(manifold, poses)?)),
        };
        let turning = trajectory.turning.as_ref().map(|(axis, degrees)| {
            let curve = degrees.curve(manifold, source)?;
            Ok::<_, Error>((*axis, curve))
        });
        let path = Self {
            object,
            trajectory,
            manifold,
            source,
            course,
            turning: turning.transpose()?,
        };
        path.check_inside()?;
        Ok(Some(path))
    }

    /// Returns the first and the last time.
    pub fn during(&self) -> [f64; 2] {
        self.trajectory.during
    }

    /// Returns the object as it is at `time`, in the cover.
    ///
    /// # Errors
    /// Its frame cannot be carried there.
    pub fn at(&self, time: f64) -> Result<ObjectEntry> {
        let [from, to] = self.during();
        let time = time.clamp(from, to);
        let turned = self.turning_at(time)?;
        let (at, carried) = match &self.course {
            KnownCourse::Journey(journey) => {
                let camera = journey.pose_in_cover(time).0;
                (camera.u, camera.rotation)
            }
            KnownCourse::Curve(curve) => {
                let way = |t: f64| curve.at(t);
                let carried = transport(&self.manifold.still(), way, [from, time], TOLERANCE);
                let carried = carried.map_err(|e| self.complain(e.to_string()))?;
                (curve.at(time).0, carried.rotation)
            }
        };
        Ok(ObjectEntry {
            at,
            rotation: (carried * turned * self.object.rotation).normalize(),
            ..self.object.clone()
        })
    }

    /// Complains about the path.
    pub fn complain(&self, message: String) -> Diagnostic {
        Diagnostic::new(self.source, self.trajectory.span.clone(), message)
    }

    /// The object's own turn at a time.
    fn turning_at(&self, time: f64) -> Result<DQuat> {
        let Some((axis, degrees)) = &self.turning else {
            return Ok(DQuat::IDENTITY);
        };
        let angle = degrees.at(time).0.x;
        match angle.is_finite() {
            true => Ok(DQuat::from_axis_angle(*axis, angle.to_radians())),
            false => {
                let message = format!("the object's turning is not finite at t = {time}");
                Err(self.complain(message).into())
            }
        }
    }

    /// Refuses a path that leaves the domain, with the first place where it does.
    fn check_inside(&self) -> Result<()> {
        let [from, to] = self.during();
        for i in 0..=PROBES {
            let t = from + (to - from) * i as f64 / PROBES as f64;
            let u: DVec3 = match &self.course {
                KnownCourse::Curve(curve) => curve.at(t).0,
                KnownCourse::Journey(journey) => journey.pose_in_cover(t).0.u,
            };
            let name = format!("the object's path at t = {t}");
            if let Err(fault) = check_point(self.manifold, &name, u) {
                let hint =
                    "see [domain] in the manifold file; shorten `during`, or lead it elsewhere";
                return Err(self.complain(fault.to_string()).with_hint(hint).into());
            }
        }
        Ok(())
    }
}
