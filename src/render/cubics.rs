//! Sixteen cubics side by side: a piece of a sheaf between two knots.
//!
//! In: a sheaf and the number of a knot. Out: how much the cubics bend, how fast they go, and boxes
//! around them where they are cut.

use super::{
    lanes::{LANES, Points, each, each_point, less, more, range},
    sheaf::Sheaf,
};
use crate::expr::vectorised;
use glam::DVec3;

/// The cubics by their control points in Bézier's form.
pub struct Cubics {
    /// The arc lengths of their ends.
    pub s: [f64; 2],
    control: [Points; 4],
}

impl Cubics {
    /// Between the knots numbered `k` and `k + 1`.
    pub fn new(sheaf: &Sheaf<'_>, k: usize) -> Self {
        let (knots, strands) = (sheaf.knots(), sheaf.all());
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
    pub fn bend(&self) -> f64 {
        let [a, b, c, d] = &self.control;
        let bend = |a: &Points, b: &Points, c: &Points| {
            squares(&each_point(|k, l| a[k][l] - 2.0 * b[k][l] + c[k][l]))
        };
        let (bends, speeds) = (
            [bend(a, b, c), bend(b, c, d)],
            [self.squared_speeds(0), self.squared_speeds(2)],
        );
        let ratios = each(|l| {
            let least = less(speeds[0][l], speeds[1][l]);
            more(bends[0][l], bends[1][l]) / more(least, f64::MIN_POSITIVE)
        });
        0.75 * range(&ratios)[1].sqrt()
    }

    /// A speed that none exceeds.
    pub fn most_speed(&self) -> f64 {
        let most = [0, 1, 2].map(|i| range(&self.squared_speeds(i))[1]);
        most[0].max(most[1]).max(most[2]).sqrt()
    }

    /// Squares of the lengths from control point `i` to the next, as speeds.
    fn squared_speeds(&self, i: usize) -> [f64; LANES] {
        let third = (self.s[1] - self.s[0]) / 3.0;
        let (a, b) = (&self.control[i], &self.control[i + 1]);
        squares(&each_point(|k, l| (b[k][l] - a[k][l]) / third))
    }

    /// The box around them at the fraction `t`.
    pub fn bounds(&self, t: f64) -> (DVec3, DVec3) {
        let r = 1.0 - t;
        let [a, b, c, d] = [r * r * r, 3.0 * r * r * t, 3.0 * r * t * t, t * t * t];
        let [p, q, u, v] = &self.control;
        let [x, y, z] = vectorised(
            #[inline(always)]
            || {
                let mixed =
                    each_point(|k, l| a * p[k][l] + b * q[k][l] + (c * u[k][l] + d * v[k][l]));
                [range(&mixed[0]), range(&mixed[1]), range(&mixed[2])]
            },
        );
        (DVec3::new(x[0], y[0], z[0]), DVec3::new(x[1], y[1], z[1]))
    }
}

fn squares(v: &Points) -> [f64; LANES] {
    each(|l| v[0][l] * v[0][l] + v[1][l] * v[1][l] + v[2][l] * v[2][l])
}
