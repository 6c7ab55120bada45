//! How paths known at knots end.
//!
//! In: a [`PathView`]. Out: its [`Ending`]: the first event on the cubics between its knots.

mod sixteen;

use super::{
    curve::{Ending, Piece},
    lanes::{self, LANES, more},
    strands::{PathView, ROWS},
};
use geofan_core::{geodesic::End, manifold::Manifold};
use geofan_expr::{Registers, vectorised};
use glam::DVec3;

/// What ends a path.
#[derive(Debug, Clone, Copy)]
pub struct Event {
    /// Which of the domain's events.
    pub kind: usize,
    /// Arc length.
    pub s: f64,
    /// Chart point.
    pub u: DVec3,
    /// Tangent.
    pub v: DVec3,
}

/// Finds how paths end.
#[derive(Clone)]
pub struct EventLocator<'m> {
    manifold: &'m Manifold,
    registers: Registers<f64, LANES>,
    /// The events' values at the knot before.
    before: Vec<f64>,
    /// Their values at both ends of the piece on which the first event was found last, and at the
    /// knot after it.
    rise: Vec<[f64; 3]>,
    /// For the sky's direction at each exit.
    skies: Vec<Option<Registers<f64, 1>>>,
}

impl Event {
    /// At the fraction `t` of a piece.
    fn on(piece: &Piece, t: f64, kind: usize) -> Self {
        Self {
            kind,
            s: piece.arc(t),
            u: piece.position(t),
            v: piece.tangent(t),
        }
    }
}

impl<'m> EventLocator<'m> {
    /// For paths in `manifold`.
    pub fn new(manifold: &'m Manifold) -> Self {
        Self {
            manifold,
            registers: manifold.domain.events().registers(),
            before: vec![f64::NAN; manifold.domain.kinds.len()],
            rise: vec![[f64::NAN; 3]; manifold.domain.kinds.len()],
            skies: (0..manifold.exits.len())
                .map(|exit| manifold.sky_registers(Some(exit)))
                .collect(),
        }
    }

    /// The first event on the known part of `strand`: positive and not before, or rising beyond
    /// zero (a ray leaves where an exit's condition *becomes* positive). `None` if there is none.
    pub fn ending(&mut self, strand: PathView<'_>) -> Option<Ending> {
        self.sharp_ending(strand, |s, rows| {
            strand.sample(s, rows);
            s.len()
        })
    }

    /// The same with the event found on the path itself, which `sample` knows better than the cubics
    /// (as [`PathView::sample`], but says how many are known): between two knots of the strand, then
    /// between two of sixteen points there, where it is taken to be a parabola.
    pub fn sharp_ending(
        &mut self,
        strand: PathView<'_>,
        sample: impl FnOnce(&[f64], &mut [f64]) -> usize,
    ) -> Option<Ending> {
        let event = self.sharp_event(strand, sample)?;
        Some(self.by(&event))
    }

    /// The event itself.
    pub fn sharp_event(
        &mut self,
        strand: PathView<'_>,
        sample: impl FnOnce(&[f64], &mut [f64]) -> usize,
    ) -> Option<Event> {
        let piece = self.last_piece(strand)?;
        let last = (LANES - 1) as f64;
        let knots: [f64; LANES] = std::array::from_fn(|l| piece.arc(l as f64 / last));
        let mut rows = [0.0; ROWS * LANES];
        let known = sample(&knots, &mut rows);
        let closer = self.last_piece(PathView {
            knots: &knots,
            rows: &rows,
            boxes: &[],
            known,
            ..strand
        });
        // At the very end of the piece rounding may hide the event from the points between.
        let piece = closer.unwrap_or(piece);
        let (t, kind) = self.first_on()?;
        Some(Event::on(&piece, t, kind))
    }

    /// The piece on which the first event happens; `None` if there is none.
    fn last_piece(&mut self, strand: PathView<'_>) -> Option<Piece> {
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

    /// The ending by an event.
    pub fn by(&mut self, event: &Event) -> Ending {
        let domain = &self.manifold.domain;
        let Event { s, u, v, .. } = *event;
        match End::of_event(domain, domain.kinds[event.kind]) {
            End::Exit(exit) => {
                let registers = self.skies[exit].as_mut();
                let sky = self.manifold.sky_direction_in(registers, Some(exit), u, v);
                Ending::Exit { exit, s, sky }
            }
            End::Length | End::Singular => Ending::Nowhere,
        }
    }

    /// The first of the `count` knots from `first` on at which an event counts, if any; `rise` is then
    /// what the events are there, before and after.
    fn rising(&mut self, strand: &PathView<'_>, first: usize, count: usize) -> Option<usize> {
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
                counting(registers, before, after)
            },
        );
        let lane = lanes::first(&counts);
        for (k, before) in self.before.iter_mut().enumerate() {
            let values = self.registers.output(k);
            match lane {
                Some(lane) => {
                    let earlier = if lane == 0 { *before } else { values[lane - 1] };
                    // Without a third value it is on the line.
                    let next = values.get(lane + 1).filter(|_| lane + 1 < count);
                    let line = 2.0 * values[lane] - earlier;
                    self.rise[k] = [earlier, values[lane], next.copied().unwrap_or(line)];
                }
                None => *before = values[count - 1],
            }
        }
        lane
    }

    /// The earliest of the events that count between the ends of the piece found last: the fraction
    /// of the piece, and which.
    fn first_on(&self) -> Option<(f64, usize)> {
        let mut first: Option<(f64, usize)> = None;
        for (k, rise) in self.rise.iter().enumerate() {
            if rise[1] > rise[0].max(0.0) {
                let t = root(*rise);
                if first.is_none_or(|(earlier, _)| t < earlier) {
                    first = Some((t, k));
                }
            }
        }
        first
    }
}

/// Where in [0, 1] the parabola through `before` at 0, `after` at 1 and `next` at 2 becomes positive:
/// one step of Newton from the chord. 0 if `before` is positive or no number.
fn root([before, after, next]: [f64; 3]) -> f64 {
    let before = before.min(0.0);
    let chord = before / (before - after);
    let bend = 0.5 * (next - 2.0 * after + before);
    let value = bend * chord * (chord - 1.0);
    let t = chord - value / (after - before + bend * (2.0 * chord - 1.0));
    match (0.0..=1.0).contains(&t) {
        true => t,
        false => chord,
    }
}

/// The lanes in which any event is positive and more than it was, which `earlier` tells from what is known
/// of that event and its values.
#[inline(always)]
fn counting<T>(
    events: &Registers<f64, LANES>,
    known: &[T],
    earlier: impl Fn(&T, &[f64; LANES]) -> [f64; LANES],
) -> [bool; LANES] {
    let mut counts = [false; LANES];
    for (k, known) in known.iter().enumerate() {
        let values = events.output(k);
        let earlier = earlier(known, values);
        for l in 0..LANES {
            counts[l] |= values[l] > more(earlier[l], 0.0);
        }
    }
    counts
}

/// The values in the lanes before: `before` for the first.
#[inline(always)]
fn after(before: &f64, values: &[f64; LANES]) -> [f64; LANES] {
    let mut earlier = [*before; LANES];
    earlier[1..].copy_from_slice(&values[..LANES - 1]);
    earlier
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::each_point;
    use geofan_core::diagnostic::SourceText;

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
            let point = each_point(|c, l| start(l)[c] + if c == 0 { s } else { 0.0 });
            (s, point)
        };
        let tangent = |_| each_point(|c, _| f64::from(c == 0));
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
                Ending::Nowhere => assert!(s > 1.7),
            }
        }
    }

    #[test]
    fn the_root_of_a_parabola_is_nearer_than_that_of_its_chord() {
        let f = |t: f64| (t - 0.3) * (t + 2.0);
        let t = root([f(0.0), f(1.0), f(2.0)]);
        assert!((t - 0.3).abs() < 0.005, "{t}");
        // A line is its own chord.
        assert_eq!(root([-1.0, 3.0, 7.0]), 0.25);
    }

    #[test]
    fn what_is_positive_already_or_no_number_begins_at_once() {
        assert_eq!(root([0.5, 1.0, 1.5]), 0.0);
        assert_eq!(root([f64::NAN, 1.0, 2.0]), 0.0);
    }
}
