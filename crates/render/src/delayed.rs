//! Objects that move, as they are seen by light that takes time.
//!
//! In: the path of an object, its mesh, and the time t at the camera. Light that has come along an arc length s of a line of
//! sight left the object at t − s: arc length is time, in a stationary spacetime that of the chart. Out: intervals of s
//! ([`SeenInterval`]), so short that between their ends vertices move evenly as far as anyone can see.

use super::{
    accel::MovingTriangle,
    moving::ObjectPath,
    scene::{Cuts, Mesh, ObjectEntry, Points, place},
};
use geofan_core::{error::Result, manifold::Manifold};
use glam::DVec3;
use std::sync::Arc;

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
