//! The path of one ray as the renderer sees it: cubic pieces between knots, and how it ends.
//!
//! In: chart points and tangents at knots. Out: pieces to intersect, and the [`Ending`]. Every
//! tracer hands out curves, so everything after the paths is the same for all.

use crate::{
    expr::{Registers, vectorised},
    geodesic::{End, crossing},
    manifold::Manifold,
};
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
    /// Whether a table gave up on this ray, so that it was integrated exactly.
    pub flagged: bool,
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

/// Lanes in which events are evaluated along a curve.
pub const LANES: usize = 16;

/// Finds how curves end from their knots.
#[derive(Clone)]
pub struct EndingFinder<'m> {
    manifold: &'m Manifold,
    registers: Registers<f64, LANES>,
    single: Registers<f64, 1>,
    /// The events' values at the knot before.
    before: Vec<f64>,
}

impl<'m> EndingFinder<'m> {
    /// For curves in `manifold`.
    pub fn new(manifold: &'m Manifold) -> Self {
        Self {
            manifold,
            registers: manifold.domain.events().registers(),
            single: manifold.domain.events().registers(),
            before: vec![f64::NAN; manifold.domain.kinds.len()],
        }
    }

    /// The first event on the curve through the knots (`s`, `u`, `v`): positive and not before, or
    /// rising beyond zero (DESIGN §3: the ray leaves where it *becomes* positive).
    pub fn ending(&mut self, s: &[f64], u: &[DVec3], v: &[DVec3]) -> Ending {
        self.start();
        let mut first = 0;
        while first < u.len() {
            let last = (first + LANES).min(u.len());
            if let Some(ending) = self.ending_between(s, u, v, first..last) {
                return ending;
            }
            first = last;
        }
        Ending::Nowhere
    }

    /// Begins a new curve.
    pub fn start(&mut self) {
        self.before.fill(f64::NAN);
    }

    /// The ending at the knots of `range`, at most `LANES` of them, those before it looked at
    /// already.
    pub fn ending_between(
        &mut self,
        s: &[f64],
        u: &[DVec3],
        v: &[DVec3],
        range: std::ops::Range<usize>,
    ) -> Option<Ending> {
        if self.before.is_empty() {
            return None;
        }
        self.evaluate(&u[range.clone()], &v[range.clone()]);
        let count = range.len();
        let quiet = |k: usize| {
            let values = &self.registers.output(k)[..count];
            values.iter().fold(true, |quiet, x| quiet & (*x <= 0.0))
        };
        if (0..self.before.len()).all(quiet) {
            for (k, value) in self.before.iter_mut().enumerate() {
                *value = self.registers.output(k)[count - 1];
            }
            return None;
        }
        for (lane, at) in range.enumerate() {
            let counts = |k: usize| self.registers.output(k)[lane] > self.before[k].max(0.0);
            if at > 0 && (0..self.before.len()).any(counts) {
                let piece = Piece {
                    s: [s[at - 1], s[at]],
                    u: [u[at - 1], u[at]],
                    v: [v[at - 1], v[at]],
                };
                return Some(self.first_on(&piece));
            }
            for (k, value) in self.before.iter_mut().enumerate() {
                *value = self.registers.output(k)[lane];
            }
        }
        None
    }

    fn evaluate(&mut self, u: &[DVec3], v: &[DVec3]) {
        for (lane, (u, v)) in u.iter().zip(v).enumerate() {
            for k in 0..3 {
                self.registers.input(k)[lane] = u[k];
                self.registers.input(3 + k)[lane] = v[k];
            }
        }
        let tape = self.manifold.domain.events();
        vectorised(
            #[inline(always)]
            || tape.run(&mut self.registers),
        );
    }

    /// The earliest of the events that count at the end of `piece`.
    fn first_on(&mut self, piece: &Piece) -> Ending {
        let domain = &self.manifold.domain;
        let mut value = |t: f64, k: usize| {
            let (u, v) = (piece.position(t), piece.tangent(t));
            for c in 0..3 {
                *self.single.input(c) = [u[c]];
                *self.single.input(3 + c) = [v[c]];
            }
            domain.events().run(&mut self.single);
            self.single.output(k)[0]
        };
        let mut first: Option<(f64, usize)> = None;
        for (k, before) in self.before.iter().enumerate() {
            if value(1.0, k) > before.max(0.0) {
                let t = match *before > 0.0 {
                    true => 0.0,
                    false => crossing(0.0, 1.0, |t| value(t, k)),
                };
                if first.is_none_or(|(earlier, _)| t < earlier) {
                    first = Some((t, k));
                }
            }
        }
        match first {
            Some((t, k)) => {
                let end = End::of_event(domain, domain.kinds[k]);
                let (u, v) = (piece.position(t), piece.tangent(t));
                ending_at(self.manifold, end, piece.arc(t), u, v)
            }
            None => Ending::Nowhere,
        }
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
