//! How sixteen paths side by side end.
//!
//! In: points and tangents of all at some arc lengths. Out: the first event of each.

use super::{Event, EventLocator, counting, root};
use crate::{
    curve::{Ending, Piece},
    lanes::{LANES, Points, any, lane, more},
    strands::ROWS,
};

/// The points of sixteen paths at one arc length.
struct Abreast {
    /// Of the vertex.
    number: usize,
    s: f64,
    points: Points,
}

impl EventLocator<'_> {
    /// How sixteen paths side by side end: the first event of each on cubics between its points and
    /// tangents at the vertices. `point` and `tangent` give arc length and state of each by its number;
    /// between two of them the event is taken to change evenly. Each of the `pieces` has `per_piece`
    /// intervals, and those at whose end no path has ended are passed over.
    #[inline(always)]
    pub fn endings_of_sixteen(
        &mut self,
        (pieces, per_piece): (usize, usize),
        point: impl Fn(usize) -> (f64, Points),
        tangent: impl Fn(usize) -> Points,
    ) -> [Ending; LANES] {
        let path = (&point, &tangent);
        let ends = (0..=pieces * per_piece).step_by(per_piece);
        let roughly = self.first_of_sixteen(ends, path);
        let mut endings = [Ending::Nowhere; LANES];
        for piece in 0..pieces {
            if roughly.iter().flatten().all(|(k, _)| *k != piece) {
                continue;
            }
            let inside = piece * per_piece..(piece + 1) * per_piece + 1;
            let events = self.first_of_sixteen(inside, path);
            for (ending, event) in endings.iter_mut().zip(events) {
                if let (Ending::Nowhere, Some((_, event))) = (&ending, event) {
                    *ending = self.by(&event);
                }
            }
        }
        endings
    }

    /// The first event of each of sixteen paths on the cubics between vertices with these numbers, and the
    /// number of the interval between those.
    #[inline(always)]
    fn first_of_sixteen<P: Fn(usize) -> (f64, Points), V: Fn(usize) -> Points>(
        &mut self,
        numbers: impl Iterator<Item = usize>,
        (point, tangent): (&P, &V),
    ) -> [Option<(usize, Event)>; LANES] {
        let tape = self.manifold.domain.events();
        // Few domains end where a path runs in a certain direction, and tangents are half the work.
        let needs_tangents = (3..ROWS).any(|c| tape.reads(c));
        let mut events = [None; LANES];
        let mut before: Option<Abreast> = None;
        let mut earlier = vec![[f64::INFINITY; LANES]; self.before.len()];
        for (end, number) in numbers.enumerate() {
            let (s, points) = point(number);
            self.put(0, &points);
            if needs_tangents {
                self.put(3, &tangent(number));
            }
            tape.run(&mut self.registers);
            let here = Abreast { number, s, points };
            if let Some(before) = &before {
                let interval = (end - 1, [before, &here]);
                self.note(interval, tangent, &earlier, &mut events);
                if events.iter().all(Option::is_some) {
                    break;
                }
            }
            for (k, earlier) in earlier.iter_mut().enumerate() {
                *earlier = *self.registers.output(k);
            }
            before = Some(here);
        }
        events
    }

    /// Notes the events that count since they were `earlier` of the paths without one, where the interval is
    /// known by its number and its ends.
    #[inline(always)]
    fn note<V: Fn(usize) -> Points>(
        &self,
        (number, ends): (usize, [&Abreast; 2]),
        tangent: &V,
        earlier: &[[f64; LANES]],
        events: &mut [Option<(usize, Event)>; LANES],
    ) {
        let mut counts = counting(&self.registers, earlier, |before, _| *before);
        for l in 0..LANES {
            counts[l] &= events[l].is_none();
        }
        if !any(&counts) {
            return;
        }
        let ways = [tangent(ends[0].number), tangent(ends[1].number)];
        for l in (0..LANES).filter(|l| counts[*l]) {
            if let Some((t, kind)) = self.first_in_lane(l, earlier) {
                let piece = Piece {
                    s: [ends[0].s, ends[1].s],
                    u: [lane(&ends[0].points, l), lane(&ends[1].points, l)],
                    v: [lane(&ways[0], l), lane(&ways[1], l)],
                };
                events[l] = Some((number, Event::on(&piece, t, kind)));
            }
        }
    }

    /// Sets three inputs of the events from number `first` on.
    #[inline(always)]
    fn put(&mut self, first: usize, values: &Points) {
        for c in 0..3 {
            *self.registers.input(first + c) = values[c];
        }
    }

    /// The earliest of the events that count in lane `l` since they were `earlier`: the fraction of the
    /// way, and which.
    #[inline(always)]
    fn first_in_lane(&self, l: usize, earlier: &[[f64; LANES]]) -> Option<(f64, usize)> {
        let mut first: Option<(f64, usize)> = None;
        for (k, earlier) in earlier.iter().enumerate() {
            let (before, after) = (earlier[l], self.registers.output(k)[l]);
            if after > more(before, 0.0) {
                let t = root([before, after, 2.0 * after - before]);
                if first.is_none_or(|(earlier, _)| t < earlier) {
                    first = Some((t, k));
                }
            }
        }
        first
    }
}
