//! Objects that move: where they are at a time, how what they carry is turned, and as they are seen by light that takes
//! time.
//!
//! In: an [`ObjectEntry`] with a path ([`ObjectPath`]), and a time. Out: the entry as it is then. Along a curve of the
//! chart the object's frame is carried by parallel transport, from the standard frame at the path's start on; a closed
//! path brings it back turned by the holonomy of the loop. Along key poses it goes as a camera does ([`Journey`]).
//!
//! In: the path of an object, its mesh, and the time t at the camera. Light that has come along an arc length s of a line of
//! sight left the object at t − s: arc length is time, in a stationary spacetime that of the chart. Out: intervals of s
//! ([`SeenInterval`]), so short that between their ends vertices move evenly as far as anyone can see.

use super::{
    accel::MovingTriangle,
    journey::Journey,
    scene::{Course, Cuts, Mesh, ObjectEntry, Points, Trajectory, place},
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
const TRANSPORT_TOLERANCE: f64 = 1e-10;

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
                let carried = transport(
                    &self.manifold.still(),
                    way,
                    [from, time],
                    TRANSPORT_TOLERANCE,
                );
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

/// Angle (radians) as seen from arc length s by which a vertex may be beside where it is: a tenth of a pixel.
const TOLERANCE: f64 = 1e-4;

/// Cosine of the largest turn of a vertex's normal within an interval.
const TURN: f64 = 0.98;

/// Equal parts that are looked at of what a path takes, however even it seems.
const PARTS: usize = 16;

/// Share of an interval at which it is looked at beside its middle: no simple fraction.
const OTHER: f64 = 0.381_966_011_250_105;

/// Share of the whole below which intervals are not divided.
const LEAST: f64 = 1e-6;

/// Vertices of an interval whose speed is looked at, evenly chosen.
const LOOKED_AT: usize = 256;

/// Most triangles of all intervals of an object: more take gigabytes.
const MOST_TRIANGLES: usize = 4_000_000;

/// An object as it is seen at arc lengths of an interval.
pub(super) struct SeenInterval {
    /// Its ends; the second is infinite where the object has not begun to move.
    s: [f64; 2],
    /// Vertices at the ends.
    ends: [Arc<Points>; 2],
    /// Vertices in the middle.
    pub middle: Arc<Points>,
}

impl SeenInterval {
    /// Returns the triangle with these corners.
    pub fn triangle(&self, corners: [u32; 3]) -> MovingTriangle {
        let at = |points: &Arc<Points>| corners.map(|c| points[c as usize].0);
        MovingTriangle {
            s: self.s,
            corners: self.ends.each_ref().map(at),
        }
    }
}

/// Places an object where it is seen.
pub(super) struct DelayedObject<'a> {
    /// Its path.
    pub path: &'a ObjectPath<'a>,
    /// The manifold.
    pub manifold: &'a Manifold,
    /// Its mesh as loaded.
    pub mesh: &'a Mesh,
    /// How that is cut at all times.
    pub cuts: Arc<Cuts>,
    /// The number of triangles after that.
    pub triangles: usize,
    /// The time at the camera.
    pub time: f64,
}

/// The object where it is seen at an arc length.
#[derive(Clone)]
struct SeenAt {
    s: f64,
    at: DVec3,
    points: Arc<Points>,
}

impl DelayedObject<'_> {
    /// Finds the intervals, in order.
    ///
    /// # Errors
    /// The object cannot be placed, is not slower than light, or moves so unevenly that there are too many.
    pub fn intervals(&self) -> Result<Vec<SeenInterval>> {
        let [begin, end] = self.path.during();
        let [stopped, begun] = [end, begin].map(|time| (self.time - time).max(0.0));
        let mut intervals = Vec::new();
        let mut last = self.seen_at(stopped)?;
        if stopped > 0.0 {
            intervals.push(standing([0.0, stopped], &last));
        }
        for part in 1..=PARTS {
            let share = part as f64 / PARTS as f64;
            let next = self.seen_at(stopped + (begun - stopped) * share)?;
            self.divide([last, next.clone()], begun - stopped, &mut intervals)?;
            last = next;
        }
        intervals.push(standing([begun, f64::INFINITY], &last));
        Ok(intervals)
    }

    /// Adds the intervals between two places, as many as it takes.
    fn divide(
        &self,
        [a, b]: [SeenAt; 2],
        whole: f64,
        intervals: &mut Vec<SeenInterval>,
    ) -> Result<()> {
        let middle = self.seen_at(0.5 * (a.s + b.s))?;
        if b.s - a.s > LEAST * whole && !self.is_even(&a, &middle, &b)? {
            self.divide([a, middle.clone()], whole, intervals)?;
            return self.divide([middle, b], whole, intervals);
        }
        self.check_speed(&a, &middle, &b)?;
        intervals.push(SeenInterval {
            s: [a.s, b.s],
            ends: [a.points, b.points],
            middle: middle.points,
        });
        if intervals.len() * self.triangles <= MOST_TRIANGLES {
            return Ok(());
        }
        let count = intervals.len();
        let message = format!(
            "light that takes time sees this object at {count} places and more, {MOST_TRIANGLES} triangles in all"
        );
        let hint = "shorten `during`, let it move or turn more evenly, or give it a simpler mesh";
        Err(self.path.complain(message).with_hint(hint).into())
    }

    /// Tells whether what is between two places is there also if everything moves evenly from one to the other: in the
    /// middle and, because what swings may be at one place all three times, at one more.
    fn is_even(&self, a: &SeenAt, middle: &SeenAt, b: &SeenAt) -> Result<bool> {
        Ok(self.is_between(a, middle, b) && {
            let other = self.seen_at(a.s + OTHER * (b.s - a.s))?;
            self.is_between(a, &other, b)
        })
    }

    fn is_between(&self, a: &SeenAt, seen: &SeenAt, b: &SeenAt) -> bool {
        let share = (seen.s - a.s) / (b.s - a.s);
        let metric = self.manifold.metric(seen.at);
        let most = TOLERANCE * b.s;
        let vertices = a.points.iter().zip(b.points.iter());
        let mut vertices = vertices.zip(seen.points.iter());
        vertices.all(|((a, b), seen)| {
            let off = a.0.lerp(b.0, share) - seen.0;
            let turn = a.1.dot(b.1) / (a.1.length() * b.1.length());
            off.dot(metric * off) <= most * most && !(turn < TURN)
        })
    }

    /// Refuses an object of which a part is not slower than light.
    fn check_speed(&self, a: &SeenAt, middle: &SeenAt, b: &SeenAt) -> Result<()> {
        let stride = a.points.len().div_ceil(LOOKED_AT).max(1);
        for k in (0..a.points.len()).step_by(stride) {
            // Seen farther away it is seen earlier.
            let velocity = (a.points[k].0 - b.points[k].0) / (b.s - a.s);
            let u = middle.points[k].0;
            if !self.manifold.is_slower_than_light(u, velocity) {
                let time = self.time - middle.s;
                let message = format!("the object is not slower than light at t = {time}");
                let hint = "with `delay`, light takes a time of its arc length from place to place; let the object take longer";
                return Err(self.path.complain(message).with_hint(hint).into());
            }
        }
        Ok(())
    }

    /// Places the object where it is seen at arc length `s`.
    fn seen_at(&self, s: f64) -> Result<SeenAt> {
        let time = self.time - s;
        let object = ObjectEntry {
            cuts: Some(self.cuts.clone()),
            vertices: None,
            ..self.path.at(time)?
        };
        let placed = place(self.manifold, &object, self.mesh);
        let placed = placed.filter(|placed| placed.mesh.triangles.len() == self.triangles);
        let Some(placed) = placed else {
            let message = format!("the object cannot be placed where it is at t = {time}");
            let hint = "make it smaller, or lead it away from the edge of the domain";
            return Err(self.path.complain(message).with_hint(hint).into());
        };
        Ok(SeenAt {
            s,
            at: object.at,
            points: Arc::new(placed.vertices),
        })
    }
}

/// Returns an interval in which the object stands still.
fn standing(s: [f64; 2], place: &SeenAt) -> SeenInterval {
    SeenInterval {
        s,
        ends: [place.points.clone(), place.points.clone()],
        middle: place.points.clone(),
    }
}
