//! How paths known at knots end.
//!
//! In: a [`Strand`]. Out: its [`Ending`]: the first event on the cubics between its knots.

use super::{
    curve::{Ending, Piece, ending_at},
    strands::{ROWS, Strand},
};
use crate::{
    expr::{Registers, vectorised},
    geodesic::{End, crossing},
    manifold::Manifold,
};
use glam::DVec3;

/// Lanes in which events are evaluated along a path.
const LANES: usize = 16;

/// Finds how paths end.
#[derive(Clone)]
pub struct EndingFinder<'m> {
    manifold: &'m Manifold,
    registers: Registers<f64, LANES>,
    single: Registers<f64, 1>,
    /// The events' values at the knot before.
    before: Vec<f64>,
}

impl<'m> EndingFinder<'m> {
    /// For paths in `manifold`.
    pub fn new(manifold: &'m Manifold) -> Self {
        Self {
            manifold,
            registers: manifold.domain.events().registers(),
            single: manifold.domain.events().registers(),
            before: vec![f64::NAN; manifold.domain.kinds.len()],
        }
    }

    /// The first event on the known part of `strand`: positive and not before, or rising beyond
    /// zero (a ray leaves where an exit's condition *becomes* positive). `None` if there is none.
    pub fn ending(&mut self, strand: Strand<'_>) -> Option<Ending> {
        let piece = self.last_piece(strand)?;
        Some(match self.first_on(&piece) {
            Some((t, k)) => self.at(k, piece.arc(t), piece.position(t), piece.tangent(t)),
            None => Ending::Nowhere,
        })
    }

    /// The same with the event found on the path itself, which `sample` knows better than the cubics
    /// (as [`Strand::sample`], but says how many are known): first between knots of the strand, then
    /// on cubics between sixteen points there, whose error is 1e-5 times as large.
    pub fn sharp_ending(
        &mut self,
        strand: Strand<'_>,
        sample: impl FnOnce(&[f64], &mut [f64]) -> usize,
    ) -> Option<Ending> {
        let piece = self.last_piece(strand)?;
        let knots: [f64; LANES] =
            std::array::from_fn(|l| piece.arc(l as f64 / (LANES - 1) as f64));
        let mut rows = [0.0; ROWS * LANES];
        let known = sample(&knots, &mut rows);
        let closer = Strand {
            knots: &knots,
            direction: strand.direction,
            rows: &rows,
            known,
            ending: None,
        };
        // At the very end of the piece rounding may hide the event from the points between.
        self.ending(closer).or_else(|| self.ending(strand))
    }

    /// The piece on which the first event happens; `None` if there is none.
    fn last_piece(&mut self, strand: Strand<'_>) -> Option<Piece> {
        if self.before.is_empty() {
            return None;
        }
        self.before.fill(f64::NAN);
        for first in (0..strand.known).step_by(LANES) {
            let count = LANES.min(strand.known - first);
            self.evaluate(&strand, first, count);
            if let Some(at) = self.rising(first, count) {
                return Some(strand.piece(at - 1));
            }
        }
        None
    }

    /// The value of event `k`.
    fn event(&mut self, k: usize, u: DVec3, v: DVec3) -> f64 {
        for c in 0..3 {
            *self.single.input(c) = [u[c]];
            *self.single.input(3 + c) = [v[c]];
        }
        self.manifold.domain.events().run(&mut self.single);
        self.single.output(k)[0]
    }

    /// The ending by event `k`.
    fn at(&self, k: usize, s: f64, u: DVec3, v: DVec3) -> Ending {
        let domain = &self.manifold.domain;
        let end = End::of_event(domain, domain.kinds[k]);
        ending_at(self.manifold, end, s, u, v)
    }

    /// The events at `count` knots from `first` on; lanes beyond repeat the last.
    fn evaluate(&mut self, strand: &Strand<'_>, first: usize, count: usize) {
        for c in 0..6 {
            let row = &strand.row(c)[first..first + count];
            let input = self.registers.input(c);
            input[..count].copy_from_slice(row);
            input[count..].fill(row[count - 1]);
        }
        let tape = self.manifold.domain.events();
        vectorised(
            #[inline(always)]
            || tape.run(&mut self.registers),
        );
    }

    /// The first of the knots just evaluated at which an event counts, if any; `before` is then
    /// what it was at the knot before.
    fn rising(&mut self, first: usize, count: usize) -> Option<usize> {
        let quiet = |k: usize| {
            let values = self.registers.output(k);
            values.iter().fold(true, |quiet, x| quiet & (*x <= 0.0))
        };
        if (0..self.before.len()).all(quiet) {
            for (k, value) in self.before.iter_mut().enumerate() {
                *value = self.registers.output(k)[count - 1];
            }
            return None;
        }
        for lane in 0..count {
            let counts = |k: usize| self.registers.output(k)[lane] > self.before[k].max(0.0);
            if first + lane > 0 && (0..self.before.len()).any(counts) {
                return Some(first + lane);
            }
            for (k, value) in self.before.iter_mut().enumerate() {
                *value = self.registers.output(k)[lane];
            }
        }
        None
    }

    /// The earliest of the events that count at the end of `piece`: where, and which.
    fn first_on(&mut self, piece: &Piece) -> Option<(f64, usize)> {
        let mut first: Option<(f64, usize)> = None;
        for k in 0..self.before.len() {
            let before = self.before[k];
            let mut value = |t: f64| self.event(k, piece.position(t), piece.tangent(t));
            if value(1.0) > before.max(0.0) {
                let t = match before > 0.0 {
                    true => 0.0,
                    false => crossing(0.0, 1.0, value),
                };
                if first.is_none_or(|(earlier, _)| t < earlier) {
                    first = Some((t, k));
                }
            }
        }
        first
    }
}
