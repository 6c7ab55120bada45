//! The path of one ray as the renderer sees it: cubic pieces between knots, and how it ends.
//!
//! In: chart points and tangents at knots. Out: pieces to intersect, and the [`Ending`]. Every
//! tracer hands out curves, so everything after the paths is the same for all.

use crate::{geodesic::End, manifold::Manifold};
use glam::DVec3;
use std::sync::Arc;

/// How a curve ends.
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
    /// Nowhere: the length is used up, or the metric ends.
    Nowhere,
}

impl Ending {
    /// The arc length beyond which nothing of the curve counts.
    pub fn limit(&self) -> f64 {
        match self {
            Ending::Exit { s, .. } => *s,
            Ending::Nowhere => f64::INFINITY,
        }
    }

    /// The index of the exit.
    pub fn exit(&self) -> Option<usize> {
        match self {
            Ending::Exit { exit, .. } => Some(*exit),
            Ending::Nowhere => None,
        }
    }
}

/// A path between knots.
#[derive(Debug, Clone)]
pub struct Curve {
    /// Arc lengths of the knots, ascending.
    pub s: Arc<[f64]>,
    /// Chart points.
    pub u: Vec<DVec3>,
    /// Tangents.
    pub v: Vec<DVec3>,
    /// How it ends.
    pub ending: Ending,
}

impl Curve {
    /// The pieces in order, up to the ending.
    pub fn pieces(&self) -> impl Iterator<Item = Piece> {
        let limit = self.ending.limit();
        (1..self.u.len())
            .take_while(move |k| self.s[k - 1] < limit)
            .map(|k| self.piece(k - 1))
    }

    /// The chart point and tangent at arc length `s`; `None` beyond the last knot.
    pub fn state(&self, s: f64) -> Option<(DVec3, DVec3)> {
        let next = self.s.partition_point(|knot| *knot < s).max(1);
        if next >= self.u.len() {
            return None;
        }
        let piece = self.piece(next - 1);
        let t = (s - piece.s[0]) / (piece.s[1] - piece.s[0]);
        Some((piece.position(t), piece.tangent(t)))
    }

    /// The piece from knot `k` to the next.
    pub fn piece(&self, k: usize) -> Piece {
        Piece {
            s: [self.s[k], self.s[k + 1]],
            u: [self.u[k], self.u[k + 1]],
            v: [self.v[k], self.v[k + 1]],
        }
    }
}

/// A cubic between two knots (Hermite's form).
#[derive(Debug, Clone, Copy)]
pub struct Piece {
    /// Arc lengths at the ends.
    pub s: [f64; 2],
    /// Chart points at the ends.
    pub u: [DVec3; 2],
    /// Tangents at the ends.
    pub v: [DVec3; 2],
}

impl Piece {
    fn width(&self) -> f64 {
        self.s[1] - self.s[0]
    }

    /// The chart point at the fraction `t`.
    pub fn position(&self, t: f64) -> DVec3 {
        let [c0, c1, c2, c3] = self.bezier();
        let r = 1.0 - t;
        c0 * (r * r * r) + c1 * (3.0 * r * r * t) + c2 * (3.0 * r * t * t) + c3 * (t * t * t)
    }

    /// The tangent at the fraction `t`.
    pub fn tangent(&self, t: f64) -> DVec3 {
        let [c0, c1, c2, c3] = self.bezier();
        let r = 1.0 - t;
        let slope = (c1 - c0) * (r * r) + (c2 - c1) * (2.0 * r * t) + (c3 - c2) * (t * t);
        slope * (3.0 / self.width())
    }

    /// The arc length at the fraction `t`.
    pub fn arc(&self, t: f64) -> f64 {
        self.s[0] + t * self.width()
    }

    /// The part beyond arc length `s`; `None` if there is none.
    pub fn after(&self, s: f64) -> Option<Self> {
        let t = (s - self.s[0]) / self.width();
        (t < 1.0).then(|| Self {
            s: [s, self.s[1]],
            u: [self.position(t), self.u[1]],
            v: [self.tangent(t), self.v[1]],
        })
    }

    /// The control points of Bézier's form; the curve lies in their hull.
    pub fn bezier(&self) -> [DVec3; 4] {
        let third = self.width() / 3.0;
        [
            self.u[0],
            self.u[0] + self.v[0] * third,
            self.u[1] - self.v[1] * third,
            self.u[1],
        ]
    }

    /// A box that holds the curve.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        let c = self.bezier();
        let fold = |f: fn(DVec3, DVec3) -> DVec3| c[1..].iter().fold(c[0], |a, b| f(a, *b));
        (fold(DVec3::min), fold(DVec3::max))
    }

    /// The largest distance of the curve from its chord, bounded by the second derivative.
    pub fn sagitta(&self) -> f64 {
        let [c0, c1, c2, c3] = self.bezier();
        let bend = (c0 - c1 * 2.0 + c2)
            .length()
            .max((c1 - c2 * 2.0 + c3).length());
        6.0 / 8.0 * bend
    }
}

/// The ending of a path that ended as `end` at arc length `s`, point `u`, tangent `v`.
pub fn ending_at(manifold: &Manifold, end: End, s: f64, u: DVec3, v: DVec3) -> Ending {
    match end {
        End::Exit(exit) => Ending::Exit {
            exit,
            s,
            sky: manifold.sky_direction(Some(exit), u, v),
        },
        End::Length | End::Singular => Ending::Nowhere,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_part_of_a_piece_lies_on_it() {
        let piece = Piece {
            s: [1.0, 3.0],
            u: [DVec3::ZERO, DVec3::new(2.0, 1.0, 0.0)],
            v: [DVec3::X, DVec3::new(0.5, 0.0, 1.0)],
        };
        let part = piece.after(1.5).unwrap();
        for s in [1.5, 2.0, 2.9] {
            let on = |p: &Piece| p.position((s - p.s[0]) / (p.s[1] - p.s[0]));
            assert!((on(&part) - on(&piece)).length() < 1e-14);
        }
        assert!(piece.after(3.0).is_none());
    }
}
