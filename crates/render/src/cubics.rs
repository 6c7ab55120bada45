//! Sixteen cubics side by side: a piece of sixteen paths between two knots.
//!
//! In: paths and the number of a knot. Out: how much the cubics bend, how fast they go, and boxes
//! around them where they are cut. All of it is inlined into kernels.

use super::{
    lanes::{LANES, Lanes, Points, each, each_point, less, more, range},
    strands::PathView,
};
use glam::DVec3;

/// The cubics by their control points in Bézier's form.
pub struct Cubics {
    /// The arc lengths of their ends.
    pub s: [f64; 2],
    control: [Points; 4],
}

impl Cubics {
    /// Between the knots numbered `k` and `k + 1`.
    #[inline(always)]
    pub fn new(strands: &[PathView<'_>; LANES], k: usize) -> Self {
        let knots = strands[0].knots;
        let s = [knots[k], knots[k + 1]];
        let third = (s[1] - s[0]) / 3.0;
        let at = |first: usize, k: usize| each_point(|c, l| strands[l].row(first + c)[k]);
        let (a, d, v, w) = (at(0, k), at(0, k + 1), at(3, k), at(3, k + 1));
        let b = each_point(|c, l| a[c][l] + v[c][l] * third);
        let c = each_point(|c, l| d[c][l] - w[c][l] * third);
        let control = [a, b, c, d];
        Self { s, control }
    }

    /// The largest distance of one from its chord, bounded by its second derivative, over its least speed
    /// at the ends: of each by itself, as neighbours may be in parts of the chart with other units.
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

    /// A speed that none exceeds.
    #[inline(always)]
    pub fn most_speed(&self) -> f64 {
        let most = |i: usize| range(&self.squared_speeds(i))[1];
        most(0).max(most(1)).max(most(2)).sqrt()
    }

    /// Squares of the second differences from control point `i` on.
    #[inline(always)]
    fn squared_bends(&self, i: usize) -> Lanes {
        let [a, b, c] = [&self.control[i], &self.control[i + 1], &self.control[i + 2]];
        squares(&each_point(
            #[inline(always)]
            |k, l| a[k][l] - 2.0 * b[k][l] + c[k][l],
        ))
    }

    /// Squares of the lengths from control point `i` to the next, as speeds.
    #[inline(always)]
    fn squared_speeds(&self, i: usize) -> Lanes {
        let per_length = 3.0 / (self.s[1] - self.s[0]);
        let (a, b) = (&self.control[i], &self.control[i + 1]);
        squares(&each_point(
            #[inline(always)]
            |k, l| (b[k][l] - a[k][l]) * per_length,
        ))
    }

    /// The box around them at the fraction `t`.
    #[inline(always)]
    pub fn bounds(&self, t: f64) -> (DVec3, DVec3) {
        let r = 1.0 - t;
        let [a, b, c, d] = [r * r * r, 3.0 * r * r * t, 3.0 * r * t * t, t * t * t];
        let [p, q, u, v] = &self.control;
        let mixed = each_point(
            #[inline(always)]
            |k, l| a * p[k][l] + b * q[k][l] + (c * u[k][l] + d * v[k][l]),
        );
        let [x, y, z] = [range(&mixed[0]), range(&mixed[1]), range(&mixed[2])];
        (DVec3::new(x[0], y[0], z[0]), DVec3::new(x[1], y[1], z[1]))
    }
}

#[inline(always)]
fn squares(v: &Points) -> Lanes {
    each(
        #[inline(always)]
        |l| v[0][l] * v[0][l] + v[1][l] * v[1][l] + v[2][l] * v[2][l],
    )
}
