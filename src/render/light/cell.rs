//! A cell of a light's fan: three neighbouring rays between two knots.
//!
//! In: a chart point. Out: guesses of the direction and arc length at which the light reaches it,
//! by inverting the interpolated map (b, c, t) → u: cubics in t along the three rays, weights
//! 1 − b − c, b, c between them.

use super::fan::{FanRay, LightFan};
use glam::{DMat3, DVec3};

/// How far outside its cell, in b, c and t, a point may lie and still be guessed from it. The
/// interpolated map is off by up to a tenth of a cell; a wider margin only repeats what neighbours
/// find.
const MARGIN: f64 = 0.3;

/// Where nothing folds, the map is nearly linear: a point that the first step of Newton's method puts
/// this many cells from the middle is not in the cell. Most cells whose box holds a point end here;
/// with twice the distance nothing more is found.
const FAR: f64 = 2.5;

/// Steps of Newton's method for one guess.
const STEPS: usize = 10;

/// A guess is settled when the map misses the point by less than this share of the cell; exact
/// rays take it from there.
const SETTLED: f64 = 1e-3;

/// Where rays fold, a point that the interpolated map misses by this share of the cell may still be
/// met by the true one.
const NEAR_FOLD: f64 = 0.3;

/// Three rays between two knots.
pub(super) struct Cell {
    corners: [u32; 3],
    knot: u32,
    /// Whether the rays fold inside: then the point may be met more than once.
    folded: bool,
}

/// Where a light's ray might reach a point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Guess {
    /// Unit vector in the standard frame at the light.
    pub direction: DVec3,
    /// Arc length.
    pub s: f64,
    /// The cell's size, as an angle and as an arc length.
    angle: f64,
    width: f64,
    folded: bool,
}

impl Guess {
    /// Whether both are guesses of the same geodesic: close to each other where nothing folds.
    pub fn is_like(&self, other: &Self) -> bool {
        let close = (self.direction - other.direction).length() < 0.2 * self.angle
            && (self.s - other.s).abs() < 0.2 * self.width;
        close && (!self.folded && !other.folded)
    }
}

impl Cell {
    /// The cell of three rays that starts at a knot.
    pub fn new(fan: &LightFan<'_>, corners: [usize; 3], knot: usize) -> Self {
        let signs = corners.map(|i| &fan.rays[i].reversed);
        let first = signs[0][knot + 1];
        // At the light itself all areas are zero and their signs mean nothing.
        let start = knot.max(1);
        let folded = signs
            .iter()
            .any(|s| s[start] != first || s[knot + 1] != first);
        Self {
            corners: corners.map(|i| i as u32),
            knot: knot as u32,
            folded,
        }
    }

    fn rays<'f>(&self, fan: &'f LightFan<'_>) -> [&'f FanRay; 3] {
        self.corners.map(|i| &fan.rays[i as usize])
    }

    fn width(&self, fan: &LightFan<'_>) -> f64 {
        let knot = self.knot as usize;
        fan.knots[knot + 2] - fan.knots[knot]
    }

    /// A box around everything that the cell may be asked about.
    pub fn bounds(&self, fan: &LightFan<'_>) -> (DVec3, DVec3) {
        let (k, third) = (self.knot as usize, self.width(fan) / 3.0);
        let rays = self.rays(fan);
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for ray in rays {
            let ends = [ray.u[k], ray.u[k + 2]];
            let controls = [ends[0] + ray.v[k] * third, ends[1] - ray.v[k + 2] * third];
            for p in ends.into_iter().chain(controls) {
                (low, high) = (low.min(p), high.max(p));
            }
        }
        // Sideways by the distance of the rays, lengthwise by that of the knots.
        let side = |i: usize, j: usize, k: usize| (rays[i].u[k] - rays[j].u[k]).abs();
        let sides = [(0, 1), (1, 2), (2, 0)].map(|(i, j)| side(i, j, k).max(side(i, j, k + 2)));
        let along = (rays[0].u[k + 2] - rays[0].u[k]).abs();
        let margin = (sides[0].max(sides[1]).max(sides[2]) + along) * MARGIN;
        (low - margin, high + margin)
    }

    /// The interpolated point and its derivatives by b, c, t.
    fn map(&self, rays: &[&FanRay; 3], width: f64, at: DVec3) -> (DVec3, DMat3) {
        let (k, t) = (self.knot as usize, at.z);
        let r = 1.0 - t;
        let curve = |ray: &FanRay| {
            let (u0, u1) = (ray.u[k], ray.u[k + 2]);
            let (w0, w1) = (ray.v[k] * width, ray.v[k + 2] * width);
            let u =
                u0 * (r * r * (1.0 + 2.0 * t)) + w0 * (r * r * t) + u1 * (t * t * (3.0 - 2.0 * t))
                    - w1 * (t * t * r);
            let slope =
                (u1 - u0) * (6.0 * t * r) + w0 * (r * (1.0 - 3.0 * t)) + w1 * (t * (3.0 * t - 2.0));
            (u, slope)
        };
        let [p, q, o] = [curve(rays[0]), curve(rays[1]), curve(rays[2])];
        let a = 1.0 - at.x - at.y;
        let u = p.0 * a + q.0 * at.x + o.0 * at.y;
        let slope = p.1 * a + q.1 * at.x + o.1 * at.y;
        (u, DMat3::from_cols(q.0 - p.0, o.0 - p.0, slope))
    }

    /// Where the light might reach `x` through this cell.
    pub fn guesses(&self, fan: &LightFan<'_>, x: DVec3) -> Vec<Guess> {
        let rays = self.rays(fan);
        let starts: &[DVec3] = match self.folded {
            false => &[DVec3::new(1.0 / 3.0, 1.0 / 3.0, 0.5)],
            true => &[
                DVec3::new(0.1, 0.1, 0.5),
                DVec3::new(0.8, 0.1, 0.5),
                DVec3::new(0.1, 0.8, 0.5),
                DVec3::new(0.33, 0.33, 0.05),
                DVec3::new(0.33, 0.33, 0.95),
            ],
        };
        let mut found: Vec<DVec3> = Vec::new();
        for start in starts {
            if let Some(at) = self.invert(fan, &rays, x, *start)
                && !found.iter().any(|other| (*other - at).length() < 0.05)
            {
                found.push(at);
            }
        }
        found
            .into_iter()
            .map(|at| self.guess(fan, &rays, at))
            .collect()
    }

    /// The (b, c, t) at which the map is `x`, or comes close where it folds; `None` outside.
    fn invert(
        &self,
        fan: &LightFan<'_>,
        rays: &[&FanRay; 3],
        x: DVec3,
        start: DVec3,
    ) -> Option<DVec3> {
        let width = self.width(fan);
        let allowed = if self.folded { NEAR_FOLD } else { SETTLED };
        let mut at = start;
        for step in 0..STEPS {
            let (u, slope) = self.map(rays, width, at);
            let size = slope.x_axis.length().max(slope.y_axis.length());
            let miss = (x - u).length();
            let outside = (at - 0.5).abs().max_element() > 0.5 + MARGIN;
            if miss <= SETTLED * size || step + 1 == STEPS || (outside && step > 3) {
                let inside = !outside && at.x + at.y <= 1.0 + MARGIN;
                return (miss <= allowed * size && inside).then_some(at);
            }
            let way = slope.inverse() * (x - u);
            if !way.is_finite() {
                return None;
            }
            let long = way.length();
            if step == 0 && long > FAR && !self.folded {
                return None;
            }
            at += if long > 0.5 { way * (0.5 / long) } else { way };
        }
        None
    }

    fn guess(&self, fan: &LightFan<'_>, rays: &[&FanRay; 3], at: DVec3) -> Guess {
        let [p, q, o] = rays.map(|r| r.direction);
        let width = self.width(fan);
        Guess {
            direction: (p * (1.0 - at.x - at.y) + q * at.x + o * at.y).normalize(),
            s: (fan.knots[self.knot as usize] + at.z * width).max(1e-3 * width),
            angle: (q - p).length(),
            width,
            folded: self.folded,
        }
    }
}
