//! The cubic between two knots of a path, and the end of a path.
//!
//! In: chart points `u` and tangents `v` at arc lengths `s`. Out: [`Cubic`]s to intersect, one by one
//! or of sixteen paths side by side ([`CubicPacket`]), and the [`Ending`]. Every tracer hands out
//! cubics, so everything after the paths is the same for all.

use super::{
    lanes::{LANES, Lanes, Vectors, each, each_vector, less, more, range},
    path_batch::PathView,
};
use geofan_core::{geodesic::End, manifold::Manifold};
use glam::DVec3;
use std::sync::Arc;

/// The end of a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Ending {
    /// Through an exit, at arc length `s`; `sky` is the direction by which its sky is looked up.
    Exit {
        /// Index in [`Manifold::exits`].
        exit: usize,
        /// Arc length.
        s: f64,
        /// Unit vector.
        sky: DVec3,
    },
    /// Where its length is used up: what it would meet farther on is not known.
    Length,
    /// Where the metric allows no further step.
    Singular,
}

impl Ending {
    /// Returns the arc length beyond which nothing of the path counts.
    pub fn limit(&self) -> f64 {
        match self {
            Ending::Exit { s, .. } => *s,
            Ending::Length | Ending::Singular => f64::INFINITY,
        }
    }

    /// Returns the ending of the same path with so much before it.
    pub fn farther(self, before: f64) -> Self {
        match self {
            Ending::Exit { exit, s, sky } => Ending::Exit {
                exit,
                s: before + s,
                sky,
            },
            other => other,
        }
    }

    /// Returns the index of the exit.
    pub fn exit(&self) -> Option<usize> {
        match self {
            Ending::Exit { exit, .. } => Some(*exit),
            Ending::Length | Ending::Singular => None,
        }
    }
}

/// Returns the ending of a path that the integrator ended by `end` at arc length `s`, point `u`, tangent
/// `v`.
pub fn ending_at(manifold: &Manifold, end: End, s: f64, u: DVec3, v: DVec3) -> Ending {
    match end {
        End::Exit(exit) => Ending::Exit {
            exit,
            s,
            sky: manifold.sky_direction(Some(exit), u, v),
        },
        End::Length => Ending::Length,
        End::Singular => Ending::Singular,
    }
}

/// The steps of an integrated path as cubics between knots of its own.
#[derive(Debug, Clone)]
pub struct Curve {
    /// Arc lengths of the knots, ascending.
    pub s: Arc<[f64]>,
    /// Chart points.
    pub u: Vec<DVec3>,
    /// Tangents.
    pub v: Vec<DVec3>,
    /// The end of the path.
    pub ending: Ending,
}

impl Curve {
    /// Returns the cubics in order, up to the ending.
    pub fn pieces(&self) -> impl Iterator<Item = Cubic> {
        let limit = self.ending.limit();
        (1..self.u.len())
            .take_while(move |k| self.s[k - 1] < limit)
            // Where a path of a glued space goes on elsewhere, two knots are at one arc length.
            .filter(|k| self.s[k - 1] < self.s[*k])
            .map(|k| self.piece(k - 1))
    }

    /// Returns the chart point and tangent at arc length `s`; `None` beyond the last knot.
    pub fn state(&self, s: f64) -> Option<(DVec3, DVec3)> {
        let next = self.s.partition_point(|knot| *knot < s).max(1);
        if next >= self.u.len() {
            return None;
        }
        let piece = self.piece(next - 1);
        let t = piece.fraction(s);
        Some((piece.position(t), piece.tangent(t)))
    }

    /// Returns the cubic from knot `k` to the next.
    pub fn piece(&self, k: usize) -> Cubic {
        Cubic {
            s: [self.s[k], self.s[k + 1]],
            u: [self.u[k], self.u[k + 1]],
            v: [self.v[k], self.v[k + 1]],
        }
    }
}

/// A cubic between two knots (Hermite's form).
#[derive(Debug, Clone, Copy)]
pub struct Cubic {
    /// Arc lengths at the ends.
    pub s: [f64; 2],
    /// Chart points at the ends.
    pub u: [DVec3; 2],
    /// Tangents at the ends.
    pub v: [DVec3; 2],
}

impl Cubic {
    fn width(&self) -> f64 {
        self.s[1] - self.s[0]
    }

    /// Returns the fraction of the way at arc length `s`.
    pub fn fraction(&self, s: f64) -> f64 {
        (s - self.s[0]) / self.width()
    }

    /// Returns the arc length at the fraction `t`.
    pub fn arc(&self, t: f64) -> f64 {
        self.s[0] + t * self.width()
    }

    /// Returns the chart point at the fraction `t`.
    pub fn position(&self, t: f64) -> DVec3 {
        let [c0, c1, c2, c3] = self.bezier();
        let r = 1.0 - t;
        c0 * (r * r * r) + c1 * (3.0 * r * r * t) + c2 * (3.0 * r * t * t) + c3 * (t * t * t)
    }

    /// Returns the chart point at the middle.
    pub fn middle(&self) -> DVec3 {
        (self.u[0] + self.u[1]) * 0.5 + (self.v[0] - self.v[1]) * (self.width() / 8.0)
    }

    /// Returns the tangent at the fraction `t`.
    pub fn tangent(&self, t: f64) -> DVec3 {
        let [c0, c1, c2, c3] = self.bezier();
        let r = 1.0 - t;
        let slope = (c1 - c0) * (r * r) + (c2 - c1) * (2.0 * r * t) + (c3 - c2) * (t * t);
        slope * (3.0 / self.width())
    }

    /// Returns the part beyond arc length `s`; `None` if there is none.
    pub fn after(&self, s: f64) -> Option<Self> {
        let t = self.fraction(s);
        (t < 1.0).then(|| Self {
            s: [s, self.s[1]],
            u: [self.position(t), self.u[1]],
            v: [self.tangent(t), self.v[1]],
        })
    }

    /// Returns the part between two fractions of the way.
    pub fn between(&self, t: [f64; 2]) -> Self {
        Self {
            s: t.map(|t| self.arc(t)),
            u: t.map(|t| self.position(t)),
            v: t.map(|t| self.tangent(t)),
        }
    }

    /// Returns the control points of Bézier's form; the curve lies in their hull.
    pub fn bezier(&self) -> [DVec3; 4] {
        let third = self.width() / 3.0;
        [
            self.u[0],
            self.u[0] + self.v[0] * third,
            self.u[1] - self.v[1] * third,
            self.u[1],
        ]
    }

    /// Returns a box that holds the curve.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        let c = self.bezier();
        let fold = |f: fn(DVec3, DVec3) -> DVec3| c[1..].iter().fold(c[0], |a, b| f(a, *b));
        (fold(DVec3::min), fold(DVec3::max))
    }

    /// Returns the largest distance of the curve from its chord, bounded by the second derivative.
    pub fn sagitta(&self) -> f64 {
        let [c0, c1, c2, c3] = self.bezier();
        let bend = (c0 - c1 * 2.0 + c2)
            .length()
            .max((c1 - c2 * 2.0 + c3).length());
        6.0 / 8.0 * bend
    }
}

/// The cubics of sixteen paths between the same two knots, by their control points in Bézier's form.
/// Everything here is inlined into kernels.
pub struct CubicPacket {
    /// The arc lengths of their ends.
    pub s: [f64; 2],
    control: [Vectors; 4],
}

impl CubicPacket {
    /// Takes the cubics between the knots numbered `k` and `k + 1`.
    #[inline(always)]
    pub fn new(paths: &[PathView<'_>; LANES], k: usize) -> Self {
        let knots = paths[0].knots;
        let s = [knots[k], knots[k + 1]];
        let third = (s[1] - s[0]) / 3.0;
        let at = |first: usize, k: usize| each_vector(|c, l| paths[l].row(first + c)[k]);
        let (a, d, v, w) = (at(0, k), at(0, k + 1), at(3, k), at(3, k + 1));
        let b = each_vector(|c, l| a[c][l] + v[c][l] * third);
        let c = each_vector(|c, l| d[c][l] - w[c][l] * third);
        let control = [a, b, c, d];
        Self { s, control }
    }

    /// Returns the largest distance of one from its chord, bounded by its second derivative, over its
    /// smallest speed at the ends: of each by itself, as neighbours may be in parts of the chart with
    /// other units.
    #[inline(always)]
    pub fn bend(&self) -> f64 {
        let (bends, speeds) = (
            [self.squared_bends(0), self.squared_bends(1)],
            [self.squared_speeds(0), self.squared_speeds(2)],
        );
        let ratios = each(
            #[inline(always)]
            |l| {
                let least = less(speeds[0][l], speeds[1][l]);
                more(bends[0][l], bends[1][l]) / more(least, f64::MIN_POSITIVE)
            },
        );
        0.75 * range(&ratios)[1].sqrt()
    }

    /// Returns a speed that none exceeds.
    #[inline(always)]
    pub fn most_speed(&self) -> f64 {
        let most = |i: usize| range(&self.squared_speeds(i))[1];
        most(0).max(most(1)).max(most(2)).sqrt()
    }

    /// Returns the squares of the second differences from control point `i` on.
    #[inline(always)]
    fn squared_bends(&self, i: usize) -> Lanes {
        let [a, b, c] = [&self.control[i], &self.control[i + 1], &self.control[i + 2]];
        squares(&each_vector(
            #[inline(always)]
            |k, l| a[k][l] - 2.0 * b[k][l] + c[k][l],
        ))
    }

    /// Returns the squares of the lengths from control point `i` to the next, as speeds.
    #[inline(always)]
    fn squared_speeds(&self, i: usize) -> Lanes {
        let per_length = 3.0 / (self.s[1] - self.s[0]);
        let (a, b) = (&self.control[i], &self.control[i + 1]);
        squares(&each_vector(
            #[inline(always)]
            |k, l| (b[k][l] - a[k][l]) * per_length,
        ))
    }

    /// Returns the box around their points at the fraction `t`.
    #[inline(always)]
    pub fn bounds(&self, t: f64) -> (DVec3, DVec3) {
        let r = 1.0 - t;
        let [a, b, c, d] = [r * r * r, 3.0 * r * r * t, 3.0 * r * t * t, t * t * t];
        let [p, q, u, v] = &self.control;
        let mixed = each_vector(
            #[inline(always)]
            |k, l| a * p[k][l] + b * q[k][l] + (c * u[k][l] + d * v[k][l]),
        );
        let [x, y, z] = [range(&mixed[0]), range(&mixed[1]), range(&mixed[2])];
        (DVec3::new(x[0], y[0], z[0]), DVec3::new(x[1], y[1], z[1]))
    }
}

/// Returns the squared length of the vector in each lane.
#[inline(always)]
fn squares(v: &Vectors) -> Lanes {
    each(
        #[inline(always)]
        |l| v[0][l] * v[0][l] + v[1][l] * v[1][l] + v[2][l] * v[2][l],
    )
}

/// Share to which the tangent of a path shrinks from one point to the next where it comes to a stop.
const STOP: f64 = 0.3;

/// Tells whether a path with these tangents at two points near each other comes to a stop between them.
pub fn comes_to_a_stop([before, after]: [DVec3; 2]) -> bool {
    after.length_squared() < STOP * STOP * before.length_squared()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_part_of_a_cubic_lies_on_it() {
        let cubic = Cubic {
            s: [1.0, 3.0],
            u: [DVec3::ZERO, DVec3::new(2.0, 1.0, 0.0)],
            v: [DVec3::X, DVec3::new(0.5, 0.0, 1.0)],
        };
        let part = cubic.after(1.5).unwrap();
        for s in [1.5, 2.0, 2.9] {
            let on = |cubic: &Cubic| cubic.position(cubic.fraction(s));
            assert!((on(&part) - on(&cubic)).length() < 1e-14);
        }
        assert!(cubic.after(3.0).is_none());
    }
}
