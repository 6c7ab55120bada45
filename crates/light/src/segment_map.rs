//! The map of a beam segment: (b, c, t) → u.
//!
//! In: three rays with their deviations between two arc lengths. Out: the chart point of the ray
//! between them, at the weights a = 1 − b − c, b, c of the three and the fraction t of the interval,
//! and the map's derivatives. Along the rays it is a cubic in t; between them
//!
//! `u(d) = Σ wᵢ (uᵢ + ½ Jᵢ (d − dᵢ))`, `d = Σ wᵢ dᵢ`:
//!
//! the mean of the linear interpolation and of that of the rays' own linear maps. These miss a
//! quadratic map by equal amounts in opposite directions, so `u` is right to second order.
//!
//! Where rays fold, a box along the chart's axes says too little about a segment;
//! [`SegmentMap::oriented_box`] gives one along the segment's own.

use crate::ray_leg::RayKnot;
use geofan_core::geodesic::perpendiculars;
use glam::{DMat2, DMat3, DVec2, DVec3};

/// The middle of a segment in b, c and t.
pub(super) const MIDDLE: DVec3 = DVec3::new(1.0 / 3.0, 1.0 / 3.0, 0.5);

/// Interpolates between three rays over one interval of arc length.
pub(super) struct SegmentMap<'f> {
    /// The rays' directions, and two perpendiculars of each.
    directions: [DVec3; 3],
    across: [[DVec3; 2]; 3],
    /// The rays at the interval's start, middle and end.
    rays: [&'f [RayKnot]; 3],
    /// The interval's arc length.
    width: f64,
    /// The share of the rays' own linear maps.
    share: f64,
}

/// Share of the largest side by which a ray's own map may miss another ray and still tell something
/// of what is between them. Where rays are fine it is a fifth; where it is more than the whole the
/// segment is larger than what bends the rays.
const BROKEN: f64 = 1.0;

/// See [`SegmentMap::is_uneven`].
const UNEVEN: f64 = 1.5;

/// Returns the weights of both ends and their tangents in a cubic at t.
fn cubic_weights(t: f64, width: f64) -> [f64; 4] {
    let r = 1.0 - t;
    let (out, back) = (width * r * r * t, -width * t * t * r);
    [r * r * (1.0 + 2.0 * t), out, t * t * (3.0 - 2.0 * t), back]
}

/// Returns their derivatives by t.
fn cubic_slopes(t: f64, width: f64) -> [f64; 4] {
    let r = 1.0 - t;
    let (out, back) = (width * r * (1.0 - 3.0 * t), width * t * (3.0 * t - 2.0));
    [-6.0 * t * r, out, 6.0 * t * r, back]
}

/// Returns the weights of start, middle and end in a parabola at t.
fn parabola_weights(t: f64) -> [f64; 3] {
    let r = 1.0 - t;
    [r * (1.0 - 2.0 * t), 4.0 * t * r, t * (2.0 * t - 1.0)]
}

/// Returns their derivatives by t.
fn parabola_slopes(t: f64) -> [f64; 3] {
    [4.0 * t - 3.0, 4.0 - 8.0 * t, 4.0 * t - 1.0]
}

/// Sums a ray's points and tangents at both ends.
#[inline(always)]
fn point([a, b, c, d]: [f64; 4], ray: &[RayKnot]) -> DVec3 {
    let (p, q) = (&ray[0], &ray[2]);
    p.u * a + p.v * b + q.u * c + q.v * d
}

/// Sums a ray's two deviations at its three knots.
#[inline(always)]
fn spread([a, b, c]: [f64; 3], ray: &[RayKnot]) -> [DVec3; 2] {
    let [x, y, z] = [0, 1, 2].map(|k| ray[k].spread);
    [
        x[0].as_dvec3() * a + y[0].as_dvec3() * b + z[0].as_dvec3() * c,
        x[1].as_dvec3() * a + y[1].as_dvec3() * b + z[1].as_dvec3() * c,
    ]
}

impl<'f> SegmentMap<'f> {
    /// Takes three rays by their directions and their three knots, over the arc length `width`.
    /// `smooth` says whether the rays' own maps count: see [`SegmentMap::is_smooth`].
    pub fn new(directions: [DVec3; 3], rays: [&'f [RayKnot]; 3], width: f64, smooth: bool) -> Self {
        Self {
            directions,
            across: directions.map(perpendiculars),
            rays,
            width,
            share: if smooth { 0.5 } else { 0.0 },
        }
    }

    /// Returns the points of the rays at t.
    #[inline(always)]
    fn triangle(&self, t: f64) -> [DVec3; 3] {
        let weights = cubic_weights(t, self.width);
        self.rays.map(|ray| point(weights, ray))
    }

    /// Returns six times the volume between the rays at t and `x`, which has a sign.
    pub fn volume(&self, t: f64, x: DVec3) -> f64 {
        let [p, q, o] = self.triangle(t);
        (q - p).cross(o - p).dot(x - p)
    }

    /// Returns the weights of the second and third ray at t where `x` is, or is nearest to their plane.
    pub fn weights(&self, t: f64, x: DVec3) -> DVec2 {
        let [p, q, o] = self.triangle(t);
        let normal = (q - p).cross(o - p);
        let b = (x - p).cross(o - p).dot(normal);
        let c = (q - p).cross(x - p).dot(normal);
        DVec2::new(b, c) / normal.length_squared()
    }

    /// Returns the angle between two of the rays.
    pub fn angle(&self) -> f64 {
        (self.directions[1] - self.directions[0]).length()
    }

    /// Returns the direction `d` at (b, c, t), not normalised.
    pub fn direction(&self, at: DVec3) -> DVec3 {
        let [p, q, o] = self.directions;
        p * (1.0 - at.x - at.y) + q * at.x + o * at.y
    }

    /// Returns how the point moves when the direction at (b, c, t) turns towards each of its
    /// perpendiculars; `slope` is that of the map there.
    pub fn spread(&self, at: DVec3, slope: DMat3) -> [DVec3; 2] {
        let direction = self.direction(at);
        let across = perpendiculars(direction.normalize());
        let [p, q, o] = self.directions;
        let turn =
            |change: DVec3| DVec2::from_array(across.map(|e| e.dot(change))) / direction.length();
        let weights = DMat2::from_cols(turn(q - p), turn(o - p)).inverse();
        [weights.x_axis, weights.y_axis].map(|w| slope.x_axis * w.x + slope.y_axis * w.y)
    }

    /// Tells whether the rays' own linear maps say anything about the other rays.
    pub fn is_smooth(&self) -> bool {
        let (mut miss, mut side) = (0.0_f64, 0.0_f64);
        for i in 0..3 {
            let (a, across) = (&self.rays[i][2], self.across[i]);
            for j in 0..3 {
                let to_other = self.rays[j][2].u - a.u;
                let turn = self.directions[j] - self.directions[i];
                let [x, y] = across.map(|e| e.dot(turn));
                let [jx, jy] = a.spread.map(|j| j.as_dvec3());
                let own = jx * x + jy * y;
                miss = miss.max((own - to_other).length());
                side = side.max(to_other.length());
            }
        }
        miss <= BROKEN * side
    }

    /// Tells whether rays cross the chart at one place this many times as fast as at another, as they do towards its
    /// infinity: a linear map says little about such a segment, and neither do the distances of its corners.
    pub fn is_uneven(&self) -> bool {
        let knots = self.rays.iter().flat_map(|ray| &ray[..3]);
        let speeds = knots.map(|knot| knot.v.length());
        let (least, most) = speeds.fold((f64::INFINITY, 0.0_f64), |(a, b), speed| {
            (a.min(speed), b.max(speed))
        });
        most > UNEVEN * least
    }

    /// Returns by how much, in b, c, t or their sum across, a linear map misses the segment's corners, where it is that of
    /// its `middle` with this `inverse`.
    pub fn linear_miss(&self, middle: DVec3, inverse: DMat3) -> f64 {
        let across = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)];
        let corners = self.rays.iter().zip(across).flat_map(|(ray, (b, c))| {
            [(0, 0.0), (2, 1.0)].map(|(k, t)| (ray[k].u, DVec3::new(b, c, t)))
        });
        let misses = corners.map(|(u, at)| {
            let off = inverse * (u - middle) + MIDDLE - at;
            off.abs().max_element().max((off.x + off.y).abs())
        });
        misses.fold(0.0, f64::max)
    }

    /// Returns a box around the segment and `margin` of its size on all sides.
    pub fn bounds(&self, margin: f64) -> (DVec3, DVec3) {
        let (third, rays) = (self.width / 3.0, self.rays);
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        // A cubic lies between its Bézier points.
        for ray in rays {
            let (p, q) = (&ray[0], &ray[2]);
            for p in [p.u, q.u, p.u + p.v * third, q.u - q.v * third] {
                (low, high) = (low.min(p), high.max(p));
            }
        }
        // Sideways by the distance of the rays, lengthwise by that of the knots.
        let side = |i: usize, j: usize, k: usize| (rays[i][k].u - rays[j][k].u).abs();
        let sides = [(0, 1), (1, 2), (2, 0)].map(|(i, j)| side(i, j, 0).max(side(i, j, 2)));
        let along = (rays[0][2].u - rays[0][0].u).abs();
        let margin = (sides[0].max(sides[1]).max(sides[2]) + along) * margin;
        (low - margin, high + margin)
    }

    /// Returns the point at (b, c, t) and its derivatives by each.
    pub fn map(&self, at: DVec3) -> (DVec3, DMat3) {
        let weights = [1.0 - at.x - at.y, at.x, at.y];
        let (cubic, cubic_slope) = (
            cubic_weights(at.z, self.width),
            cubic_slopes(at.z, self.width),
        );
        let (parabola, parabola_slope) = (parabola_weights(at.z), parabola_slopes(at.z));
        let direction = self.direction(at);
        let [p, q, o] = self.directions;
        let mut points = [DVec3::ZERO; 3];
        let mut slope = DMat3::ZERO;
        for (i, ray) in self.rays.iter().enumerate() {
            // The point of each ray with half its own linear map.
            let (e, f) = (
                self.across[i][0] * self.share,
                self.across[i][1] * self.share,
            );
            let [j, k] = spread(parabola, ray);
            let [dj, dk] = spread(parabola_slope, ray);
            let turn = direction - self.directions[i];
            let (x, y) = (e.dot(turn), f.dot(turn));
            points[i] = point(cubic, ray) + j * x + k * y;
            // Its derivatives by the direction, which b and c move, and by t.
            let moved = point(cubic_slope, ray) + dj * x + dk * y;
            slope.x_axis += (j * e.dot(q - p) + k * f.dot(q - p)) * weights[i];
            slope.y_axis += (j * e.dot(o - p) + k * f.dot(o - p)) * weights[i];
            slope.z_axis += moved * weights[i];
        }
        slope.x_axis += points[1] - points[0];
        slope.y_axis += points[2] - points[0];
        let u = points[0] * weights[0] + points[1] * weights[1] + points[2] * weights[2];
        (u, slope)
    }
}

/// Parts of each side of the lattice of samples of an oriented box. The map is quadratic across and
/// cubic along, so between samples it leaves their box by at most a 32nd of its bend: less than
/// [`SLACK`].
const PARTS: usize = 4;

/// The box around nothing.
const NOWHERE: (DVec3, DVec3) = (DVec3::INFINITY, DVec3::NEG_INFINITY);

/// Share of its extent by which an oriented box is widened.
const SLACK: f64 = 0.05;

impl SegmentMap<'_> {
    /// Returns the centre of a box along the segment's own axes, and the linear map that takes
    /// distances from it into the cube [-1, 1]³. The box holds all points up to `margin` outside the
    /// segment in b, c and t, and what is within the share `near` of its size from them.
    ///
    /// Where rays fold, a segment is a thin sheet on edge: a box along the chart's axes holds mostly
    /// points that the segment never reaches, and to learn that by Newton's method from several starts
    /// is what a search for light would spend most of its time on.
    pub fn oriented_box(&self, margin: f64, near: f64) -> (DVec3, DMat3) {
        let (_, slope) = self.map(MIDDLE);
        let axes = box_axes(slope);
        let (layers, size) = self.layers(axes, margin);
        let (low, high) = layers.into_iter().fold(NOWHERE, around);
        let half = (high - low) * (0.5 + SLACK) + near * size;
        let shrunk = DMat3::from_diagonal(half.max(DVec3::splat(f64::MIN_POSITIVE)).recip());
        (axes * (0.5 * (low + high)), shrunk * axes.transpose())
    }

    /// Returns boxes along the chart's axes, one behind the other along the rays, that together hold the same points.
    pub fn parts(&self, margin: f64, near: f64) -> [(DVec3, DVec3); PARTS] {
        let (layers, size) = self.layers(DMat3::IDENTITY, margin);
        let (low, high) = layers.into_iter().fold(NOWHERE, around);
        let slack = (high - low) * SLACK + near * size;
        std::array::from_fn(|k| {
            let (low, high) = around(layers[k], layers[k + 1]);
            (low - slack, high + slack)
        })
    }

    /// Returns boxes along `axes`, in these, around samples of the segment with `margin` around it, at one arc
    /// length each; and the segment's size.
    fn layers(&self, axes: DMat3, margin: f64) -> ([(DVec3, DVec3); PARTS + 1], f64) {
        let mut layers = [NOWHERE; PARTS + 1];
        let mut size = 0.0_f64;
        for (k, at) in lattice(margin) {
            let (u, slope) = self.map(at);
            let p = axes.transpose() * u;
            layers[k] = around(layers[k], (p, p));
            size = size.max(slope.x_axis.length().max(slope.y_axis.length()));
        }
        (layers, size)
    }
}

/// Returns the box around two boxes.
fn around(a: (DVec3, DVec3), b: (DVec3, DVec3)) -> (DVec3, DVec3) {
    (a.0.min(b.0), a.1.max(b.1))
}

/// Returns the direction of the rays, the longest axis across them, and the third.
fn box_axes(slope: DMat3) -> DMat3 {
    let along = slope.z_axis.normalize_or(DVec3::X);
    let [a, b] = [slope.x_axis, slope.y_axis].map(|x| x - along * along.dot(x));
    let (aa, ab, bb) = (a.dot(a), a.dot(b), b.dot(b));
    // The larger of the two eigenvectors of the Gram matrix of a and b.
    let angle = 0.5 * (2.0 * ab).atan2(aa - bb);
    let longest = a * angle.cos() + b * angle.sin();
    let across = longest.normalize_or(along.any_orthonormal_vector());
    DMat3::from_cols(along, across, along.cross(across))
}

/// Returns places (b, c, t) all over a segment with `margin` around it, with the number of each arc length.
fn lattice(margin: f64) -> impl Iterator<Item = (usize, DVec3)> {
    let part = |i: usize| i as f64 / PARTS as f64;
    let across = move |i: usize| part(i) * (1.0 + 3.0 * margin) - margin;
    let along = move |k: usize| part(k) * (1.0 + 2.0 * margin) - margin;
    let pairs = (0..=PARTS).flat_map(|i| (0..=PARTS - i).map(move |j| (i, j)));
    pairs.flat_map(move |(i, j)| {
        (0..=PARTS).map(move |k| (k, DVec3::new(across(i), across(j), along(k))))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A quadratic map of the direction, cubic along the rays, is met to rounding.
    #[test]
    fn a_map_quadratic_across_and_cubic_along_is_reproduced() {
        let d = |x: f64, y: f64| DVec3::new(x, y, 1.0).normalize();
        let directions = [d(0.1, 0.0), d(0.3, 0.05), d(0.15, 0.2)];
        // Across, the map is quadratic on the plane of the three directions.
        let normal = (directions[1] - directions[0])
            .cross(directions[2] - directions[0])
            .normalize();
        let height = normal.dot(directions[0]);
        let on_plane = |d: DVec3| d * (height / normal.dot(d));
        let u = |d: DVec3, s: f64| {
            let p = on_plane(d);
            let bend = DVec3::new(p.x * p.x, p.x * p.y, p.y * p.y) * 0.4;
            p * s + (bend + DVec3::Z * 0.1) * (s * s * 0.3) + DVec3::X * (0.05 * s * s * s)
        };
        let turned = |d: DVec3, across: DVec3, s: f64| {
            let h = 1e-5;
            (u(d + across * h, s) - u(d - across * h, s)) / (2.0 * h)
        };
        let knot = |d: DVec3, s: f64| RayKnot {
            u: u(d, s),
            v: (u(d, s + 1e-5) - u(d, s - 1e-5)) / 2e-5,
            spread: perpendiculars(d).map(|e| turned(d, e, s).as_vec3()),
            reversed: false,
        };
        let rays = directions.map(|d| [1.0, 1.3, 1.6].map(|s| knot(d, s)));
        let map = SegmentMap::new(directions, [&rays[0], &rays[1], &rays[2]], 0.6, true);
        assert!(map.is_smooth());
        for at in [[0.2, 0.3, 0.4], [0.0, 0.0, 0.0], [0.6, 0.3, 0.9]] {
            let at = DVec3::from_array(at);
            let (found, slope) = map.map(at);
            let direction = map.direction(at).normalize();
            let known = u(direction, 1.0 + 0.6 * at.z);
            // Single precision of the deviations.
            assert!((found - known).length() < 1e-6, "{found} {known}");
            for (axis, column) in
                DVec3::AXES
                    .into_iter()
                    .zip([slope.x_axis, slope.y_axis, slope.z_axis])
            {
                let rise = (map.map(at + axis * 1e-5).0 - map.map(at - axis * 1e-5).0) / 2e-5;
                assert!((column - rise).length() < 1e-6, "{column} {rise}");
            }
        }
    }

    #[test]
    fn an_oriented_box_holds_every_place_of_its_segment() {
        let directions = [
            DVec3::Z,
            DVec3::new(0.1, 0.0, 1.0),
            DVec3::new(0.0, 0.1, 1.0),
        ]
        .map(DVec3::normalize);
        // Beams that a lens along x folds over near the far end.
        let u = |d: DVec3, s: f64| DVec3::new(d.x * s * (1.0 - 0.45 * s), d.y * s, d.z * s);
        let knot = |d: DVec3, s: f64| RayKnot {
            u: u(d, s),
            v: DVec3::new(d.x * (1.0 - 0.9 * s), d.y, d.z),
            spread: perpendiculars(d).map(|e| u(e, s).as_vec3()),
            reversed: s > 1.0 / 0.45,
        };
        let rays = directions.map(|d| [2.0, 2.3, 2.6].map(|s| knot(d, s)));
        let map = SegmentMap::new(directions, [&rays[0], &rays[1], &rays[2]], 0.6, true);
        let (centre, into_cube) = map.oriented_box(0.0, 0.0);
        let fractions = (0..=20).map(|i| f64::from(i) / 20.0);
        for (b, t) in fractions
            .clone()
            .flat_map(|b| fractions.clone().map(move |t| (b, t)))
        {
            for c in [0.0, 0.5 * (1.0 - b), 1.0 - b] {
                let (u, _) = map.map(DVec3::new(b, c, t));
                let place = into_cube * (u - centre);
                assert!(place.abs().max_element() <= 1.0, "{place}");
            }
        }
    }
}
