//! The map of a cell of a light's fan: (b, c, t) → u.
//!
//! In: three rays with their deviations between two knots. Out: the chart point of the ray between
//! them with weights a = 1 − b − c, b, c at the fraction t, and its slope. Along the rays cubics in
//! t; between them
//!
//! `u(d) = Σ wᵢ (uᵢ + ½ Jᵢ (d − dᵢ))`, `d = Σ wᵢ dᵢ`:
//!
//! the mean of the linear interpolation and of that of the rays' own linear maps. They miss a
//! quadratic map by the same in opposite directions, so `u` is right to second order.

use crate::fan::FanRay;
use geofan_core::geodesic::perpendiculars;
use glam::{DMat2, DMat3, DVec2, DVec3};

/// Three rays between two knots.
pub(super) struct Prism<'f> {
    rays: [&'f FanRay; 3],
    /// The perpendiculars of each ray.
    across: [[DVec3; 2]; 3],
    /// The first knot; the third is the last.
    knot: usize,
    /// Arc length between them.
    width: f64,
    /// The share of the rays' own maps.
    share: f64,
}

/// Share of the largest side by which a ray's own map may miss another ray and still tell something
/// of what is between them. Where rays are fine it is a fifth; where it is more than the whole the
/// cell is larger than what bends the rays.
const BROKEN: f64 = 1.0;

/// Weights of ends and tangents of a cubic, and of the three knots of a parabola, at t.
struct Weights {
    cubic: [f64; 4],
    parabola: [f64; 3],
}

impl Weights {
    fn at(t: f64, width: f64) -> Self {
        let r = 1.0 - t;
        let (out, back) = (width * r * r * t, -width * t * t * r);
        Self {
            cubic: [r * r * (1.0 + 2.0 * t), out, t * t * (3.0 - 2.0 * t), back],
            parabola: [r * (1.0 - 2.0 * t), 4.0 * t * r, t * (2.0 * t - 1.0)],
        }
    }

    /// Their derivatives by t.
    fn slopes_at(t: f64, width: f64) -> Self {
        let r = 1.0 - t;
        let (out, back) = (width * r * (1.0 - 3.0 * t), width * t * (3.0 * t - 2.0));
        Self {
            cubic: [-6.0 * t * r, out, 6.0 * t * r, back],
            parabola: [4.0 * t - 3.0, 4.0 - 8.0 * t, 4.0 * t - 1.0],
        }
    }

    #[inline(always)]
    fn point(&self, ray: &FanRay, k: usize) -> DVec3 {
        let [a, b, c, d] = self.cubic;
        let (p, q) = (&ray.knots[k], &ray.knots[k + 2]);
        p.u * a + p.v * b + q.u * c + q.v * d
    }

    #[inline(always)]
    fn spread(&self, ray: &FanRay, k: usize) -> [DVec3; 2] {
        let [a, b, c] = self.parabola;
        let [x, y, z] = [k, k + 1, k + 2].map(|k| ray.knots[k].spread);
        [
            x[0].as_dvec3() * a + y[0].as_dvec3() * b + z[0].as_dvec3() * c,
            x[1].as_dvec3() * a + y[1].as_dvec3() * b + z[1].as_dvec3() * c,
        ]
    }
}

impl<'f> Prism<'f> {
    /// Of `rays` from a knot on, over the arc length `width`. `smooth` says whether their own maps
    /// count: see [`Prism::is_smooth`].
    pub fn new(rays: [&'f FanRay; 3], knot: usize, width: f64, smooth: bool) -> Self {
        Self {
            rays,
            across: rays.map(|ray| perpendiculars(ray.direction)),
            knot,
            width,
            share: if smooth { 0.5 } else { 0.0 },
        }
    }

    /// The angle between two of the rays.
    pub fn angle(&self) -> f64 {
        (self.rays[1].direction - self.rays[0].direction).length()
    }

    /// The direction `d` at (b, c, t), not normalised.
    pub fn toward(&self, at: DVec3) -> DVec3 {
        let [p, q, o] = self.rays.map(|r| r.direction);
        p * (1.0 - at.x - at.y) + q * at.x + o * at.y
    }

    /// How the point moves when the direction at (b, c, t) turns towards each of its perpendiculars;
    /// `slope` is that of the map there.
    pub fn spread(&self, at: DVec3, slope: DMat3) -> [DVec3; 2] {
        let toward = self.toward(at);
        let across = perpendiculars(toward.normalize());
        let [p, q, o] = self.rays.map(|r| r.direction);
        let turn = |way: DVec3| DVec2::from_array(across.map(|e| e.dot(way))) / toward.length();
        let weights = DMat2::from_cols(turn(q - p), turn(o - p)).inverse();
        [weights.x_axis, weights.y_axis].map(|w| slope.x_axis * w.x + slope.y_axis * w.y)
    }

    /// Whether the rays' own maps tell anything about the other rays.
    pub fn is_smooth(&self) -> bool {
        let end = self.knot + 2;
        let (mut miss, mut side) = (0.0_f64, 0.0_f64);
        for (a, across) in self.rays.iter().zip(self.across) {
            for b in self.rays {
                let way = b.knots[end].u - a.knots[end].u;
                let turn = b.direction - a.direction;
                let [x, y] = across.map(|e| e.dot(turn));
                let [j, k] = a.knots[end].spread.map(|j| j.as_dvec3());
                let own = j * x + k * y;
                miss = miss.max((own - way).length());
                side = side.max(way.length());
            }
        }
        miss <= BROKEN * side
    }

    /// A box around the prism and `margin` of its size on all sides.
    pub fn bounds(&self, margin: f64) -> (DVec3, DVec3) {
        let (k, third, rays) = (self.knot, self.width / 3.0, self.rays);
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for ray in rays {
            let (p, q) = (&ray.knots[k], &ray.knots[k + 2]);
            for p in [p.u, q.u, p.u + p.v * third, q.u - q.v * third] {
                (low, high) = (low.min(p), high.max(p));
            }
        }
        // Sideways by the distance of the rays, lengthwise by that of the knots.
        let side = |i: usize, j: usize, k: usize| (rays[i].knots[k].u - rays[j].knots[k].u).abs();
        let sides = [(0, 1), (1, 2), (2, 0)].map(|(i, j)| side(i, j, k).max(side(i, j, k + 2)));
        let along = (rays[0].knots[k + 2].u - rays[0].knots[k].u).abs();
        let margin = (sides[0].max(sides[1]).max(sides[2]) + along) * margin;
        (low - margin, high + margin)
    }

    /// The point at (b, c, t) and its derivatives by each.
    pub fn map(&self, at: DVec3) -> (DVec3, DMat3) {
        let shares = [1.0 - at.x - at.y, at.x, at.y];
        let (here, along) = (
            Weights::at(at.z, self.width),
            Weights::slopes_at(at.z, self.width),
        );
        let toward = self.toward(at);
        let [p, q, o] = self.rays.map(|r| r.direction);
        let mut points = [DVec3::ZERO; 3];
        let mut slope = DMat3::ZERO;
        for (i, ray) in self.rays.iter().enumerate() {
            let (e, f) = (
                self.across[i][0] * self.share,
                self.across[i][1] * self.share,
            );
            let [j, k] = here.spread(ray, self.knot);
            let [dj, dk] = along.spread(ray, self.knot);
            let turn = toward - ray.direction;
            let (x, y) = (e.dot(turn), f.dot(turn));
            points[i] = here.point(ray, self.knot) + j * x + k * y;
            let moved = along.point(ray, self.knot) + dj * x + dk * y;
            slope.x_axis += (j * e.dot(q - p) + k * f.dot(q - p)) * shares[i];
            slope.y_axis += (j * e.dot(o - p) + k * f.dot(o - p)) * shares[i];
            slope.z_axis += moved * shares[i];
        }
        slope.x_axis += points[1] - points[0];
        slope.y_axis += points[2] - points[0];
        let u = points[0] * shares[0] + points[1] * shares[1] + points[2] * shares[2];
        (u, slope)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fan::Knot;

    /// A quadratic map of the direction, cubic along the rays, is met to rounding.
    #[test]
    fn what_is_quadratic_across_and_cubic_along_is_exact() {
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
        let turned = |d: DVec3, way: DVec3, s: f64| {
            let h = 1e-5;
            (u(d + way * h, s) - u(d - way * h, s)) / (2.0 * h)
        };
        let knot = |d: DVec3, s: f64| Knot {
            u: u(d, s),
            v: (u(d, s + 1e-5) - u(d, s - 1e-5)) / 2e-5,
            spread: perpendiculars(d).map(|e| turned(d, e, s).as_vec3()),
            reversed: false,
        };
        let ray = |d: DVec3| FanRay {
            direction: d,
            knots: [1.0, 1.3, 1.6].map(|s| knot(d, s)).to_vec(),
        };
        let rays = directions.map(ray);
        let prism = Prism::new([&rays[0], &rays[1], &rays[2]], 0, 0.6, true);
        assert!(prism.is_smooth());
        for at in [[0.2, 0.3, 0.4], [0.0, 0.0, 0.0], [0.6, 0.3, 0.9]] {
            let at = DVec3::from_array(at);
            let (found, slope) = prism.map(at);
            let direction = prism.toward(at).normalize();
            let known = u(direction, 1.0 + 0.6 * at.z);
            // Single precision of the deviations.
            assert!((found - known).length() < 1e-6, "{found} {known}");
            for (axis, column) in
                DVec3::AXES
                    .into_iter()
                    .zip([slope.x_axis, slope.y_axis, slope.z_axis])
            {
                let rise = (prism.map(at + axis * 1e-5).0 - prism.map(at - axis * 1e-5).0) / 2e-5;
                assert!((column - rise).length() < 1e-6, "{column} {rise}");
            }
        }
    }
}
