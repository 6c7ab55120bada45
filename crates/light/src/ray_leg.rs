//! Rays of a lamp, sampled at knots, in legs between the borders that they meet.
//!
//! In: the integrator's steps. Out: for each ray its [`RayLeg`]s. A border is a face of a glued space behind which paths go
//! on elsewhere, or an edge of the metric that refracts or reflects them: between rays that meet the same ones, all is
//! smooth leg by leg, and nothing can be said between others.

use geofan_core::{
    geodesic::{End, Sink, Step, perpendiculars, signed_area},
    manifold::{LocalFrame, Manifold},
};
use glam::{DVec3, Vec3};
use std::{
    hash::{DefaultHasher, Hash, Hasher},
    num::NonZeroU32,
    ops::Range,
};

/// A box of the chart, by its lowest and highest corner.
pub type Region = (DVec3, DVec3);

pub(super) fn holds((low, high): Region, u: DVec3) -> bool {
    u.cmpge(low).all() && u.cmple(high).all()
}

pub(super) fn meet(a: Region, b: Region) -> bool {
    a.0.cmple(b.1).all() && b.0.cmple(a.1).all()
}

/// Knots beyond the end of a ray, and on both sides of a border: of neighbours that are not much closer to it the last
/// segment reaches up to it.
const KNOTS_BEYOND_END: usize = 2;
pub(super) const KNOTS_BEYOND: usize = 4;

/// A ray at one arc length; all that a segment needs of it lies together in memory.
#[derive(Debug, Clone, Copy)]
pub(super) struct RayKnot {
    pub u: DVec3,
    pub v: DVec3,
    /// Derivative of `u` when the direction turns towards each of its perpendiculars.
    pub spread: [Vec3; 2],
    /// Set if the area is negative: the ray has passed an odd number of caustics.
    pub reversed: bool,
}

/// What a ray meets behind which neighbours may go on otherwise.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Border {
    /// A face of a glued space, by its number.
    Face(usize),
    /// An edge of the metric, where it is refracted or reflected (see [`Step::edge`]).
    Edge(NonZeroU32),
}

/// A ray of a lamp from one border to the next; all of it where it meets none.
#[derive(Debug, Clone)]
pub(super) struct RayLeg {
    /// The ray's direction at the lamp.
    pub direction: DVec3,
    /// What is between the end of the leg before and its beginning.
    pub borders: Vec<Border>,
    /// A hash of all the borders that the ray has met before it: legs with the same one lie behind the same.
    pub way: u64,
    /// The arc lengths of the faces between which it lies, endless where there are none.
    pub between: [f64; 2],
    /// The number of its first knot.
    pub first: usize,
    pub knots: Vec<RayKnot>,
    /// Arc length up to which it may be where connections are asked for; negative if it never is.
    pub inside: f64,
    /// Arc length at which the ray ends, if it ends on this leg.
    pub end: Option<f64>,
}

impl RayLeg {
    /// Returns the numbers of its knots.
    pub fn numbers(&self) -> Range<usize> {
        self.first..self.first + self.knots.len()
    }

    /// Returns the knot of this number.
    pub fn knot(&self, number: usize) -> &RayKnot {
        &self.knots[number - self.first]
    }

    /// Returns the three knots of the interval that begins at this one.
    pub fn interval(&self, number: usize) -> &[RayKnot] {
        let at = number - self.first;
        &self.knots[at..at + 3]
    }

    /// Returns by how much the cubic over the interval from knot `k` misses the ray in the middle, as a
    /// share of the interval's chord; `half` is half the interval's arc length.
    pub fn cubic_miss(&self, k: usize, half: f64) -> f64 {
        let [p, m, q] = [k, k + 1, k + 2].map(|k| self.knot(k));
        let cubic = 0.5 * (p.u + q.u) + (p.v - q.v) * (0.25 * half);
        (cubic - m.u).length() / (q.u - p.u).length()
    }

    /// Goes on straight to the next `count` knots.
    fn extend(&mut self, arc_lengths: &[f64], count: usize) {
        let at = self.numbers().end - 1;
        let last = self.knots[at - self.first];
        for s in arc_lengths.iter().skip(at + 1).take(count) {
            let u = last.u + last.v * (s - arc_lengths[at]);
            self.knots.push(RayKnot { u, ..last });
        }
    }

    /// Makes the leg of the ray in a direction nearby, by this one's deviations.
    pub fn beside(&self, direction: DVec3) -> Self {
        let [x, y] = perpendiculars(self.direction).map(|e| e.dot(direction - self.direction));
        let moved = |knot: &RayKnot| {
            let [jx, jy] = knot.spread.map(|j| j.as_dvec3());
            let u = knot.u + jx * x + jy * y;
            RayKnot { u, ..*knot }
        };
        Self {
            direction,
            borders: self.borders.clone(),
            way: self.way,
            between: self.between,
            first: self.first,
            knots: self.knots.iter().map(moved).collect(),
            inside: self.inside,
            end: self.end,
        }
    }
}

/// Returns the first knot that all of three legs have, and that behind their last.
pub(super) fn common(legs: [&RayLeg; 3]) -> [usize; 2] {
    let numbers = legs.map(RayLeg::numbers);
    let first = numbers.iter().map(|range| range.start).max();
    let end = numbers.iter().map(|range| range.end).min();
    [first.unwrap_or(0), end.unwrap_or(0)]
}

/// Samples the integrator's steps at knots.
pub(super) struct KnotSampler<'f> {
    manifold: &'f Manifold,
    arc_lengths: &'f [f64],
    /// Where connections are asked for.
    region: Region,
    rays: Vec<SampledRay>,
}

/// A ray on its way.
struct SampledRay {
    legs: Vec<RayLeg>,
    /// The number of the next knot.
    next: usize,
    /// What it has met since its last leg.
    borders: Vec<Border>,
}

impl SampledRay {
    fn leg(&mut self) -> &mut RayLeg {
        self.legs.last_mut().expect("a ray begins with a leg")
    }
}

impl<'f> KnotSampler<'f> {
    /// Begins rays in these directions from the lamp at `u`, an observer there, for connections in `region`.
    pub fn new(
        (manifold, arc_lengths, region): (&'f Manifold, &'f [f64], Region),
        (u, local): (DVec3, &LocalFrame),
        directions: &[DVec3],
    ) -> Self {
        let first = |direction: &DVec3| {
            let knot = RayKnot {
                u,
                v: local.tangent(*direction),
                spread: [Vec3::ZERO; 2],
                reversed: false,
            };
            let leg = RayLeg {
                direction: *direction,
                borders: Vec::new(),
                way: 0,
                between: [f64::NEG_INFINITY, f64::INFINITY],
                first: 0,
                knots: vec![knot],
                inside: f64::NEG_INFINITY,
                end: None,
            };
            SampledRay {
                legs: vec![leg],
                next: 1,
                borders: Vec::new(),
            }
        };
        Self {
            manifold,
            arc_lengths,
            region,
            rays: directions.iter().map(first).collect(),
        }
    }

    /// Returns the legs of each ray.
    pub fn into_legs(self) -> Vec<Vec<RayLeg>> {
        self.rays.into_iter().map(|ray| ray.legs).collect()
    }

    /// Makes the knot at an arc length of a step.
    fn knot(&self, step: &Step, s: f64) -> RayKnot {
        let (u, v) = (step.position(s), step.tangent(s));
        let local = self.manifold.local_frame(u);
        let spread = step.deviation(s).unwrap_or_default();
        RayKnot {
            u,
            v,
            spread: spread.map(|j| j.as_vec3()),
            reversed: signed_area(&local, v, spread) < 0.0,
        }
    }

    /// Ends the leg of `ray` at a border.
    fn meet(&mut self, ray: usize, border: Border) {
        let ray = &mut self.rays[ray];
        if ray.borders.is_empty() {
            ray.leg().extend(self.arc_lengths, KNOTS_BEYOND);
        }
        ray.borders.push(border);
    }

    /// Begins the leg of `ray` that `step`, behind borders, is the first of: with knots before it, straight back.
    fn begin_leg(&mut self, ray: usize, step: &Step) {
        let start = self.knot(step, step.start);
        let ray = &mut self.rays[ray];
        let first = ray.next.saturating_sub(KNOTS_BEYOND);
        let back = self.arc_lengths[first..ray.next].iter().map(|s| {
            let u = start.u + start.v * (s - step.start);
            RayKnot { u, ..start }
        });
        let borders = std::mem::take(&mut ray.borders);
        let mut between = [f64::NEG_INFINITY, f64::INFINITY];
        if borders.iter().any(|b| matches!(b, Border::Face(_))) {
            ray.leg().between[1] = step.start;
            between[0] = step.start;
        }
        let leg = RayLeg {
            direction: ray.leg().direction,
            way: way_behind(ray.leg().way, &borders),
            between,
            borders,
            first,
            knots: back.collect(),
            inside: f64::NEG_INFINITY,
            end: None,
        };
        ray.legs.push(leg);
    }
}

impl Sink for KnotSampler<'_> {
    fn step(&mut self, ray: usize, step: &Step) {
        if let Some(edge) = step.edge {
            self.meet(ray, Border::Edge(edge));
        }
        if !self.rays[ray].borders.is_empty() {
            self.begin_leg(ray, step);
        }
        if let Some(s) = last_inside(step, [step.start, step.end], self.region) {
            self.rays[ray].leg().inside = s;
        }
        while let Some(&s) = self.arc_lengths.get(self.rays[ray].next)
            && s <= step.end
        {
            let knot = self.knot(step, s);
            self.rays[ray].leg().knots.push(knot);
            self.rays[ray].next += 1;
        }
    }

    fn crossed(&mut self, ray: usize, face: usize) {
        self.meet(ray, Border::Face(face));
    }

    fn end(&mut self, ray: usize, _: End, s: f64, _: usize) {
        let ray = &mut self.rays[ray];
        ray.leg().end = Some(s);
        if ray.borders.is_empty() {
            ray.leg().extend(self.arc_lengths, KNOTS_BEYOND_END);
        }
    }
}

/// Returns an arc length between two of a step behind which it is not in `region`, before which it may be; `None` if it is not at all.
fn last_inside(step: &Step, [a, b]: [f64; 2], region: Region) -> Option<f64> {
    let [p, q] = [a, b].map(|s| step.position(s));
    let size = (q - p).abs().max_element();
    // A step bulges less than that beside its chord.
    let margin = DVec3::splat(0.25 * size);
    if !meet((p.min(q) - margin, p.max(q) + margin), region) {
        return None;
    }
    let middle = 0.5 * (a + b);
    let is_small = !(size > (region.1 - region.0).max_element());
    if is_small || !(a < middle && middle < b) {
        return Some(b);
    }
    let halves = [[middle, b], [a, middle]];
    halves
        .into_iter()
        .find_map(|half| last_inside(step, half, region))
}

/// Returns the way of a leg behind these borders, by that of the leg before them.
fn way_behind(before: u64, borders: &[Border]) -> u64 {
    let mut hasher = DefaultHasher::new();
    (before, borders).hash(&mut hasher);
    hasher.finish()
}
