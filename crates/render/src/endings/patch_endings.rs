//! How the sixteen paths of a sample of a patch end, side by side.
//!
//! In: the patch's paths at more vertices, where they end. Out: the [`Ending`] of each sample between them: the first event
//! on the cubics between its vertices.

use super::{Event, EventLocator, counting, earliest};
use crate::{
    curve::{Cubic, Ending},
    lanes::{LANES, Lanes, Vectors, any, lane},
    path_patch::{Bicubic, PathPatch, Vertex},
    tracer::GridTracer,
};
use geofan_core::geodesic::may_rise_between;
use std::ops::Range;

/// Intervals into which each of the last pieces of a patch is divided. Between two points the path is a
/// cubic, whose error falls with the fourth power of their distance: that between knots, some mrad, falls
/// to a few millionths.
const PER_PIECE: usize = 8;

/// Samples the paths of `patch` in the `pieces` in which they end, through whatever exit.
pub fn last_vertices(
    patch: &PathPatch<'_>,
    tracer: &dyn GridTracer,
    pieces: &Range<usize>,
) -> Vec<Vertex> {
    let knots = patch.knots();
    let mut s = vec![knots[pieces.start]];
    for k in pieces.clone() {
        let along = |j: usize| j as f64 / PER_PIECE as f64;
        s.extend((1..=PER_PIECE).map(|j| knots[k] + (knots[k + 1] - knots[k]) * along(j)));
    }
    let mut vertices = Vec::new();
    patch.vertices(tracer, &s, &mut vertices);
    vertices
}

impl EventLocator<'_> {
    /// Finds how the paths of sixteen samples end. They come from the [`last_vertices`] of a patch as every
    /// other point of them does, so that an edge between two skies, or between a sky and paths that end
    /// nowhere, runs through the tile where it should.
    #[inline(always)]
    pub fn endings_between(&mut self, last: &[Vertex], mixing: &Bicubic) -> [Ending; LANES] {
        self.endings_of_sixteen(
            (last.len().saturating_sub(1) / PER_PIECE, PER_PIECE),
            #[inline(always)]
            |i| (last[i].s, mixing.mix_points(&last[i].point)),
            #[inline(always)]
            |i| mixing.mix_points(&last[i].tangent),
        )
    }

    /// Finds how sixteen paths side by side end: the first event of each on cubics between its points and
    /// tangents at the vertices. `point` and `tangent` give arc length and state of each by its number;
    /// between two of them the event is taken to change evenly. Each of the `pieces` has `per_piece`
    /// intervals, and those at whose end no path has ended are passed over.
    #[inline(always)]
    fn endings_of_sixteen(
        &mut self,
        (pieces, per_piece): (usize, usize),
        point: impl Fn(usize) -> (f64, Vectors),
        tangent: impl Fn(usize) -> Vectors,
    ) -> [Ending; LANES] {
        let path = (&point, &tangent);
        let ends = (0..pieces * per_piece + 1).step_by(per_piece);
        let suspected = self.suspected(ends, path);
        let mut endings = [Ending::Length; LANES];
        for piece in (0..pieces).filter(|piece| suspected[*piece]) {
            let inside = piece * per_piece..(piece + 1) * per_piece + 1;
            let events = self.first_of_sixteen(inside, path);
            for (ending, event) in endings.iter_mut().zip(events) {
                if let (Ending::Length, Some(event)) = (&ending, event) {
                    *ending = self.ending_of(&event);
                }
            }
            if endings.iter().all(|ending| *ending != Ending::Length) {
                break;
            }
        }
        endings
    }

    /// Marks the pieces between vertices with these numbers in which an event of one of sixteen paths has risen at the
    /// end, or may rise and fall again.
    #[inline(always)]
    fn suspected<P: Fn(usize) -> (f64, Vectors), V: Fn(usize) -> Vectors>(
        &mut self,
        numbers: impl ExactSizeIterator<Item = usize>,
        (point, tangent): (&P, &V),
    ) -> Vec<bool> {
        let nothing = vec![[f64::INFINITY; LANES]; self.before.len()];
        let (mut earlier, mut before) = (nothing.clone(), nothing);
        let mut suspected = vec![false; numbers.len().saturating_sub(1)];
        for (end, number) in numbers.enumerate() {
            self.run_at(&point(number).1, || tangent(number));
            if end > 0 {
                suspected[end - 1] |= any(&counting(&self.registers, &before, |before, _| *before));
            }
            for (k, (earlier, before)) in earlier.iter_mut().zip(&mut before).enumerate() {
                let now = self.registers.output(k);
                if end > 1 && (0..LANES).any(|l| may_rise_between([earlier[l], before[l], now[l]]))
                {
                    suspected[end - 2..end].fill(true);
                }
                (*earlier, *before) = (*before, *now);
            }
        }
        suspected
    }

    /// Finds the first event of each of sixteen paths on the cubics between vertices with these numbers.
    #[inline(always)]
    fn first_of_sixteen<P: Fn(usize) -> (f64, Vectors), V: Fn(usize) -> Vectors>(
        &mut self,
        numbers: impl Iterator<Item = usize>,
        (point, tangent): (&P, &V),
    ) -> [Option<Event>; LANES] {
        let mut events = [None; LANES];
        let mut before: Option<(usize, f64, Vectors)> = None;
        let mut earlier = vec![[f64::INFINITY; LANES]; self.before.len()];
        for number in numbers {
            // The events' values at this vertex.
            let (s, points) = point(number);
            self.run_at(&points, || tangent(number));
            // Those that count since the one before.
            let here = (number, s, points);
            if let Some(before) = &before {
                self.note([before, &here], tangent, &earlier, &mut events);
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
    /// known by its ends: vertex, arc length and points.
    #[inline(always)]
    fn note<V: Fn(usize) -> Vectors>(
        &self,
        [from, to]: [&(usize, f64, Vectors); 2],
        tangent: &V,
        earlier: &[Lanes],
        events: &mut [Option<Event>; LANES],
    ) {
        let mut counts = counting(&self.registers, earlier, |before, _| *before);
        for l in 0..LANES {
            counts[l] &= events[l].is_none();
        }
        if !any(&counts) {
            return;
        }
        let tangents = [tangent(from.0), tangent(to.0)];
        for l in (0..LANES).filter(|l| counts[*l]) {
            let rises = earlier.iter().enumerate().map(|(k, earlier)| {
                let (before, after) = (earlier[l], self.registers.output(k)[l]);
                [before, after, 2.0 * after - before]
            });
            if let Some((t, kind)) = earliest(rises) {
                let piece = Cubic {
                    s: [from.1, to.1],
                    u: [lane(&from.2, l), lane(&to.2, l)],
                    v: [lane(&tangents[0], l), lane(&tangents[1], l)],
                };
                events[l] = Some(Event::on(&piece, t, kind));
            }
        }
    }

    /// Computes the events' values at points of sixteen paths, whose tangents are asked for if these matter.
    #[inline(always)]
    fn run_at(&mut self, points: &Vectors, tangents: impl FnOnce() -> Vectors) {
        self.put(0, points);
        if self.tangents {
            self.put(3, &tangents());
        }
        self.manifold.domain.events().run(&mut self.registers);
    }

    /// Sets three inputs of the events from number `first` on.
    #[inline(always)]
    fn put(&mut self, first: usize, values: &Vectors) {
        for c in 0..3 {
            *self.registers.input(first + c) = values[c];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::each_vector;
    use geofan_core::{diagnostic::SourceText, manifold::Manifold};
    use glam::DVec3;

    #[test]
    fn sixteen_paths_end_as_each_by_itself() {
        let text = r#"
            name = "flat"
            coordinates = ["x", "y", "z"]
            metric = { conformal = "1" }
            [[exit]]
            name = "sky"
            when = "x^2 + y^2 + z^2 - 4"
        "#;
        let source = SourceText::new("flat.toml", text);
        let manifold = Manifold::from_source(source, &[]).expect("a manifold");
        let mut finder = EventLocator::new(&manifold);
        // From y = 0.1 l along x: the lower ones are still inside after 1.7.
        let start = |l: usize| DVec3::new(0.0, 0.1 * l as f64, 0.0);
        let knots: Vec<f64> = (0..=17).map(|k| 0.1 * f64::from(k)).collect();
        let point = |s: f64| {
            let point = each_vector(|c, l| start(l)[c] + if c == 0 { s } else { 0.0 });
            (s, point)
        };
        let tangent = |_| each_vector(|c, _| f64::from(c == 0));
        let together = finder.endings_of_sixteen((1, 17), |i| point(knots[i]), tangent);
        let parted = finder.endings_of_sixteen((17, 1), |i| point(knots[i]), tangent);
        assert_eq!(together, parted);
        for (l, ending) in together.into_iter().enumerate() {
            let s = (4.0 - start(l).length_squared()).sqrt();
            match ending {
                Ending::Exit { exit, s: at, sky } => {
                    assert_eq!((exit, sky), (0, DVec3::X));
                    assert!((at - s).abs() < 2e-3, "{at} {s}");
                }
                other => assert!(other == Ending::Length && s > 1.7),
            }
        }
    }
}
