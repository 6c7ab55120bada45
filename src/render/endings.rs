//! How paths known at knots end.
//!
//! In: a [`Strand`]. Out: its [`Ending`]: the first event on the cubics between its knots.

use super::{
    curve::{Ending, Piece, ending_at},
    lanes::{LANES, Lanes, more},
    strands::{ROWS, Strand},
};
use crate::{
    expr::{Registers, vectorised},
    geodesic::End,
    manifold::Manifold,
};
use glam::DVec3;

/// Sixteen fractions from 0 to 1.
static FRACTIONS: Lanes = {
    let mut t = [0.0; LANES];
    let mut l = 0;
    while l < LANES {
        t[l] = l as f64 / (LANES - 1) as f64;
        l += 1;
    }
    t
};

/// Finds how paths end.
#[derive(Clone)]
pub struct EndingFinder<'m> {
    manifold: &'m Manifold,
    registers: Registers<f64, LANES>,
    /// The events' values at the knot before.
    before: Vec<f64>,
    /// Their values at both ends of the piece on which the first event was found last.
    rise: Vec<[f64; 2]>,
}

impl<'m> EndingFinder<'m> {
    /// For paths in `manifold`.
    pub fn new(manifold: &'m Manifold) -> Self {
        Self {
            manifold,
            registers: manifold.domain.events().registers(),
            before: vec![f64::NAN; manifold.domain.kinds.len()],
            rise: vec![[f64::NAN; 2]; manifold.domain.kinds.len()],
        }
    }

    /// The first event on the known part of `strand`: positive and not before, or rising beyond
    /// zero (a ray leaves where an exit's condition *becomes* positive). `None` if there is none.
    pub fn ending(&mut self, strand: Strand<'_>) -> Option<Ending> {
        self.sharp_ending(strand, |s, rows| {
            strand.sample(s, rows);
            s.len()
        })
    }

    /// The same with the event found on the path itself, which `sample` knows better than the cubics
    /// (as [`Strand::sample`], but says how many are known): between two knots of the strand, then
    /// between two of sixteen points there, then between two of sixteen on the cubic there, which is
    /// so short that the event is linear on it.
    pub fn sharp_ending(
        &mut self,
        strand: Strand<'_>,
        sample: impl FnOnce(&[f64], &mut [f64]) -> usize,
    ) -> Option<Ending> {
        let piece = self.last_piece(strand)?;
        // At the very end of a piece rounding may hide the event from the points between.
        let piece = self.closer(piece, sample).unwrap_or(piece);
        let cubic = |_: &[f64], rows: &mut [f64]| {
            for (to, from) in rows
                .chunks_exact_mut(LANES)
                .zip(piece.at_lanes(&FRACTIONS).as_flattened())
            {
                to.copy_from_slice(from);
            }
            LANES
        };
        let piece = self.closer(piece, cubic).unwrap_or(piece);
        let (t, k) = self.first_on()?;
        Some(self.at(k, piece.arc(t), piece.position(t), piece.tangent(t)))
    }

    /// The piece on which the first event happens, of fifteen into which `sample` divides `piece`.
    fn closer(
        &mut self,
        piece: Piece,
        sample: impl FnOnce(&[f64], &mut [f64]) -> usize,
    ) -> Option<Piece> {
        let knots = FRACTIONS.map(|t| piece.arc(t));
        let mut rows = [0.0; ROWS * LANES];
        let known = sample(&knots, &mut rows);
        self.last_piece(Strand {
            knots: &knots,
            direction: DVec3::ZERO,
            rows: &rows,
            known,
            ending: None,
        })
    }

    /// The piece on which the first event happens; `None` if there is none.
    fn last_piece(&mut self, strand: Strand<'_>) -> Option<Piece> {
        if self.before.is_empty() {
            return None;
        }
        // Nothing rises beyond this: at the first knot no event counts.
        self.before.fill(f64::INFINITY);
        for first in (0..strand.known).step_by(LANES) {
            let count = LANES.min(strand.known - first);
            if let Some(lane) = self.rising(&strand, first, count) {
                return Some(strand.piece(first + lane - 1));
            }
        }
        None
    }

    /// The ending by event `k`.
    fn at(&self, k: usize, s: f64, u: DVec3, v: DVec3) -> Ending {
        let domain = &self.manifold.domain;
        let end = End::of_event(domain, domain.kinds[k]);
        ending_at(self.manifold, end, s, u, v)
    }

    /// The first of the `count` knots from `first` on at which an event counts, if any; `rise` is then
    /// what the events are there and at the knot before.
    fn rising(&mut self, strand: &Strand<'_>, first: usize, count: usize) -> Option<usize> {
        for c in 0..ROWS {
            let row = &strand.row(c)[first..first + count];
            let input = self.registers.input(c);
            match row.first_chunk() {
                Some(sixteen) => *input = *sixteen,
                None => {
                    input[..count].copy_from_slice(row);
                    // The last again, which does not rise.
                    input[count..].fill(row[count - 1]);
                }
            }
        }
        let tape = self.manifold.domain.events();
        let (registers, before) = (&mut self.registers, &self.before);
        let counts = vectorised(
            #[inline(always)]
            || {
                tape.run(registers);
                counting(registers, before)
            },
        );
        let lane = counts.iter().position(|counts| *counts);
        for (k, before) in self.before.iter_mut().enumerate() {
            let values = self.registers.output(k);
            match lane {
                Some(0) => self.rise[k] = [*before, values[0]],
                Some(lane) => self.rise[k] = [values[lane - 1], values[lane]],
                None => *before = values[count - 1],
            }
        }
        lane
    }

    /// The earliest of the events that count between the ends of the piece found last, each taken to
    /// be linear there: the fraction of the piece, and which.
    fn first_on(&self) -> Option<(f64, usize)> {
        let mut first: Option<(f64, usize)> = None;
        for (k, [before, after]) in self.rise.iter().enumerate() {
            if *after > before.max(0.0) {
                let below = before.min(0.0);
                let t = below / (below - after);
                if first.is_none_or(|(earlier, _)| t < earlier) {
                    first = Some((t, k));
                }
            }
        }
        first
    }
}

/// The lanes in which any event is positive and more than in the lane before it (`before` for the
/// first).
#[inline(always)]
fn counting(events: &Registers<f64, LANES>, before: &[f64]) -> [bool; LANES] {
    let mut counts = [false; LANES];
    for (k, before) in before.iter().enumerate() {
        let values = events.output(k);
        let mut earlier = [*before; LANES];
        earlier[1..].copy_from_slice(&values[..LANES - 1]);
        for l in 0..LANES {
            counts[l] |= values[l] > more(earlier[l], 0.0);
        }
    }
    counts
}
