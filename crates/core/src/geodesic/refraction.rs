//! Refraction and reflection where the metric itself jumps across a surface `φ(u) = 0`.
//!
//! In: both sides of the surface at a point, the gradient of `φ`, the tangent of a ray that arrives. Out: the
//! tangent with which it goes on, through the surface or back from it; the turn of its frame; how the
//! directions of its neighbours change.
//!
//! Only the part of the momentum along `dφ` changes, and energy is kept (Fermat's principle: Weierstrass and
//! Erdmann's corner condition). With the unit covector `q = G(v − W)` and energy `E = 1 + W·q`, the momentum
//! behind the surface is `p₂ = q + E (b₁ − b₂) + λ dφ` with `|p₂|_G₂ + W₂·p₂ = E`, which is a quadratic
//! equation for `λ`; without wind `W` and drift `b` that is Snell's law for any pair of metrics, isotropic or
//! not. Its root is the one that goes on in the sense of `dφ`; without a real one, the other root of the first
//! side's own equation reflects the ray.

use crate::manifold::Manifold;
use glam::{DMat3, DQuat, DVec3};

/// Relative difference of the metric (or difference of wind and drift) above which a surface is an edge.
/// Places on both sides are some 1e-13 of the chart's scale apart, up to 1e-9 for rays that run along the
/// surface; a jump as small as this bends a ray by less than any tolerance.
const LEAST_JUMP: f64 = 1e-8;

/// Share of the extent of a space or path by which neighbours are displaced for the derivative of the law: central
/// differences are then wrong by about 1e-11.
const DISPLACEMENT: f64 = 1e-5;

/// Neighbours that meet a surface with a normal this far from the ray's (radians) are on another face of it, behind an edge or
/// a rim: of a curved surface that would be a radius of less than 1e-4 of the path.
const BEND: f64 = 0.1;

/// Metric, wind and drift on one side of an edge, as the paths followed meet them.
#[derive(Debug, Clone, Copy)]
pub(super) struct EdgeSide {
    metric: DMat3,
    inverse: DMat3,
    frame: DMat3,
    wind: DVec3,
    drift: DVec3,
}

impl EdgeSide {
    /// Evaluates the geometry at `u`, a point beside the edge.
    pub fn at(manifold: &Manifold, u: DVec3) -> Self {
        let (metric, frame) = manifold.metric_and_frame(u);
        let drift = match manifold.has_drift() {
            true => manifold.drift(u),
            false => DVec3::ZERO,
        };
        Self {
            metric,
            inverse: metric.inverse(),
            frame,
            wind: manifold.wind(u).unwrap_or(DVec3::ZERO),
            drift,
        }
    }

    /// Returns whether the geometry jumps between the two sides. Where one of them is not finite there is no
    /// law: the path ends as it does anywhere.
    pub fn differs(&self, other: &Self) -> bool {
        if !(self.inverse.is_finite() && other.inverse.is_finite()) {
            return false;
        }
        metrics_differ(self.metric, other.metric)
            || (self.wind - other.wind).length() > LEAST_JUMP * (1.0 + self.wind.length())
            || (self.drift - other.drift).length() > LEAST_JUMP * (1.0 + self.drift.length())
    }

    /// Computes the unit direction, in the standard frame, in which a path with tangent `v` is seen.
    pub fn direction(&self, v: DVec3) -> DVec3 {
        (self.frame.inverse() * (v - self.wind)).normalize()
    }

    /// Finds the tangent of the momentum `start + λ gradient` of energy `energy` that crosses level surfaces of
    /// `φ` in the sense of `sense` (±1); `None` where there is none.
    fn tangent(&self, start: DVec3, gradient: DVec3, energy: f64, sense: f64) -> Option<DVec3> {
        // |p|² = (E − W·p)² as a λ² + 2 b λ + c = 0; at a root, b + a λ is the rate of φ times |p|.
        let (raised, along) = (self.inverse * gradient, self.wind.dot(gradient));
        let rest = energy - self.wind.dot(start);
        let a = gradient.dot(raised) - along * along;
        let b = start.dot(raised) + rest * along;
        let c = start.dot(self.inverse * start) - rest * rest;
        let root = (b * b - a * c).sqrt();
        // The form of the root in which nothing cancels.
        let lambda = match sense * b > 0.0 {
            true => -c / (b + sense * root),
            false => (sense * root - b) / a,
        };
        let (p, length) = (start + gradient * lambda, rest - lambda * along);
        let v = self.inverse * p / length + self.wind;
        (length > 0.0 && v.is_finite()).then_some(v)
    }
}

/// Returns whether the metric jumps from `a` to `b`, on both sides of a surface; not where one of them is not finite.
pub(super) fn metrics_differ(a: DMat3, b: DMat3) -> bool {
    let largest = |m: DMat3| {
        m.to_cols_array()
            .into_iter()
            .map(f64::abs)
            .fold(0.0, f64::max)
    };
    largest(a - b) > LEAST_JUMP * largest(a)
}

/// Refracts or reflects a ray that arrives with the tangent `v` at an edge between `near` and `far`: returns its tangent
/// behind it, chart components, and whether it is reflected. Where light goes neither way, as where a wind faster than light
/// carries it, that is no number.
pub(super) fn deflect(near: &EdgeSide, far: &EdgeSide, gradient: DVec3, v: DVec3) -> (DVec3, bool) {
    let n = v - near.wind;
    let q = near.metric * n;
    let q = q / n.dot(q).sqrt();
    let energy = 1.0 + near.wind.dot(q);
    let sense = gradient.dot(v).signum();
    let start = q + (near.drift - far.drift) * energy;
    let through = far.tangent(start, gradient, energy, sense);
    match through {
        Some(through) => (through, false),
        None => (
            near.tangent(q, gradient, energy, -sense)
                .unwrap_or(DVec3::NAN),
            true,
        ),
    }
}

/// Reflects the tangent `v` at a wall with the normal covector `gradient`; no number where a wind carries light through it.
pub(super) fn reflect(side: &EdgeSide, gradient: DVec3, v: DVec3) -> DVec3 {
    let n = v - side.wind;
    let q = side.metric * n;
    let q = q / n.dot(q).sqrt();
    let energy = 1.0 + side.wind.dot(q);
    let back = -gradient.dot(v).signum();
    side.tangent(q, gradient, energy, back)
        .unwrap_or(DVec3::NAN)
}

/// Returns the smallest rotation, in the standard frames of both sides, that takes the direction of the tangent
/// `before` to that of the tangent `after`.
pub(super) fn turn(
    (near, before): (&EdgeSide, DVec3),
    (behind, after): (&EdgeSide, DVec3),
) -> DQuat {
    DQuat::from_rotation_arc(near.direction(before), behind.direction(after))
}

/// Returns the rotation of the frame that a path carries over an edge, relative to the standard frames: from the
/// point and tangent `before` it to those `behind` it, both so near that nothing else turns it.
pub fn turn_at_edge(manifold: &Manifold, before: (DVec3, DVec3), behind: (DVec3, DVec3)) -> DQuat {
    let [near, far] = [before.0, behind.0].map(|u| EdgeSide::at(manifold, u));
    turn((&near, before.1), (&far, behind.1))
}

/// A ray at a surface that bends it sharply, for the neighbours that meet it with it.
pub(super) struct SurfaceMeeting {
    /// `∇φ` where the ray meets the surface.
    pub gradient: DVec3,
    /// Tangent and acceleration before and behind.
    pub before: [DVec3; 2],
    pub behind: [DVec3; 2],
    /// The extent of the space or of the path, in the chart.
    pub extent: f64,
}

impl SurfaceMeeting {
    /// Computes the deviation (δu, δv) behind the surface of a neighbour with (δu, δv) before it. The neighbour
    /// meets the surface later by `τ = −∇φ·δu / ∇φ·v`, at another point of it and with another tangent.
    /// `neighbour` gives the tangent behind of one that is displaced so along the surface, with a tangent that differs
    /// so; `None` if it does not go the same way.
    pub fn deviation(
        &self,
        [du, dv]: [DVec3; 2],
        mut neighbour: impl FnMut(DVec3, DVec3) -> Option<DVec3>,
    ) -> [DVec3; 2] {
        let ([v1, a1], [v2, a2]) = (self.before, self.behind);
        let late = -self.gradient.dot(du) / self.gradient.dot(v1);
        let (place, change) = (du + v1 * late, dv + a1 * late);
        let size = (place.length() / self.extent).max(change.length() / v1.length());
        let [ahead, back] = [1.0, -1.0].map(|sign| {
            let epsilon = sign * DISPLACEMENT / size;
            neighbour(place * epsilon, change * epsilon)
        });
        let unit = size / DISPLACEMENT;
        let slope = match (ahead, back) {
            _ if !(size > 0.0) => DVec3::ZERO,
            (Some(ahead), Some(back)) => (ahead - back) * (0.5 * unit),
            // Where the surface ends, or total reflection begins: by the side that goes on as this ray.
            (Some(ahead), None) => (ahead - v2) * unit,
            (None, Some(back)) => (v2 - back) * unit,
            (None, None) => DVec3::ZERO,
        };
        [place - v2 * late, slope - a2 * late]
    }
}

/// A ray at an edge, for the neighbours that cross it with it.
pub(super) struct EdgeCrossing<'a> {
    pub manifold: &'a Manifold,
    /// A point of the surface, and a distance beside it at which the sides are known.
    pub u: DVec3,
    pub aside: f64,
    pub reflected: bool,
}

impl EdgeCrossing<'_> {
    /// Deflects a neighbour of the ray of `meeting`: it is displaced
    /// along the surface by `place`, its tangent differs by `change`, and `value` gives `φ` and its gradient. Returns
    /// `None` if it does not go the same way, or meets another face of the surface.
    pub fn deflected(
        &self,
        meeting: &SurfaceMeeting,
        [place, change]: [DVec3; 2],
        mut value: impl FnMut(DVec3) -> (f64, DVec3),
    ) -> Option<DVec3> {
        let (mut u, v) = (self.u + place, meeting.before[0]);
        let mut gradient = meeting.gradient;
        // Newton's method, back to the surface.
        for _ in 0..4 {
            let (phi, slope) = value(u);
            gradient = slope;
            u -= slope * (phi / slope.length_squared());
        }
        let normal = gradient.normalize() * gradient.dot(v).signum();
        let places = [-1.0, 1.0].map(|side| u + normal * (side * self.aside));
        // Where another face is near, the method may have come to that, or to neither.
        let [near, far] = places.map(&mut value);
        let same_face = |(_, slope): (f64, DVec3)| slope.angle_between(meeting.gradient) < BEND;
        if (near.0 > 0.0) == (far.0 > 0.0) || !same_face(near) || !same_face(far) {
            return None;
        }
        let [near, far] = places.map(|u| EdgeSide::at(self.manifold, u));
        let (v, reflected) = deflect(&near, &far, gradient, v + change);
        (reflected == self.reflected).then_some(v)
    }
}
