//! Event location: how paths known at knots end.
//!
//! In: a [`PathView`], or points and tangents of sixteen paths side by side, where those of a patch end
//! ([`EventLocator::endings_between`]). Out: the [`Ending`] of each: the first event of the domain on the cubics between
//! the knots. An event counts where its value is positive and larger than before: a ray leaves where an exit's condition
//! *becomes* positive. Between two places its value is taken to be a parabola, whose root is found from values alone;
//! where the values at three bend as at a summit that may be positive, more are looked at.

use super::{
    curve::{Cubic, Ending, comes_to_a_stop},
    lanes::{self, LANES, Lanes, Mask, Vectors, any, each_vector, lane, more},
    path_batch::{PathView, ROWS},
    path_patch::{Bicubic, PER_PIECE, Vertex},
};
use geofan_core::{
    geodesic::{End, may_rise_between},
    manifold::Manifold,
};
use geofan_expr::{Registers, vectorised};
use glam::DVec3;

/// A place where a path meets an event of the domain.
#[derive(Debug, Clone, Copy)]
pub struct Event {
    /// Index of the domain's event.
    pub kind: usize,
    /// Arc length.
    pub s: f64,
    /// Chart point.
    pub u: DVec3,
    /// Tangent.
    pub v: DVec3,
}

/// Most times that an event is looked for between sixteen points of a piece: each time they are fifteen times nearer.
const CLOSER_LOOKS: usize = 3;

/// Most times that pieces on which an event may rise and fall again are looked at between sixteen points: each time
/// at least three times nearer.
const PASSING_LOOKS: usize = 2;

/// Most pairs of pieces, each a piece farther than the one before, that are looked at at once.
const PASSED_TOGETHER: usize = 3;

/// Samples a path at arc lengths into rows, as [`PathView::sample`], but returns how many points are known.
pub type Sampling<'a> = dyn Fn(&[f64], &mut [f64]) -> usize + 'a;

/// Sixteen points of a path, evenly spaced.
struct SixteenPoints {
    knots: [f64; LANES],
    rows: [f64; ROWS * LANES],
    known: usize,
}

impl SixteenPoints {
    /// Samples the path between two arc lengths.
    fn new([from, to]: [f64; 2], sample: &Sampling<'_>) -> Self {
        let share = |l: usize| l as f64 / (LANES - 1) as f64;
        let knots = std::array::from_fn(|l| from + share(l) * (to - from));
        let mut rows = [0.0; ROWS * LANES];
        let known = sample(&knots, &mut rows);
        Self { knots, rows, known }
    }

    /// Returns them as a view of `path`.
    fn view<'a>(&'a self, path: PathView<'a>) -> PathView<'a> {
        PathView {
            knots: &self.knots,
            rows: &self.rows,
            boxes: &[],
            known: self.known,
            ..path
        }
    }
}

/// Finds how paths end.
#[derive(Clone)]
pub struct EventLocator<'m> {
    manifold: &'m Manifold,
    registers: Registers<f64, LANES>,
    /// Set if events depend on the tangent: few domains end where a path runs in a certain direction.
    tangents: bool,
    /// The events' values at the knot before, and at the one before that.
    before: Vec<f64>,
    earlier: Vec<f64>,
    /// The first of each two pieces on which one may rise and fall again.
    passed: Vec<usize>,
    /// Their values at both ends of the piece on which the first event was found last, and at the knot
    /// after it.
    rise: Vec<[f64; 3]>,
    /// For the sky's direction at each exit.
    skies: Vec<Option<Registers<f64, 1>>>,
}

impl Event {
    /// Makes the event at the fraction `t` of a piece.
    fn on(piece: &Cubic, t: f64, kind: usize) -> Self {
        Self {
            kind,
            s: piece.arc(t),
            u: piece.position(t),
            v: piece.tangent(t),
        }
    }
}

impl<'m> EventLocator<'m> {
    /// Makes ready for paths in `manifold`.
    pub fn new(manifold: &'m Manifold) -> Self {
        let tape = manifold.domain.events();
        Self {
            manifold,
            registers: tape.registers(),
            tangents: (3..ROWS).any(|input| tape.reads(input)),
            before: vec![f64::NAN; manifold.domain.kinds.len()],
            earlier: vec![f64::NAN; manifold.domain.kinds.len()],
            passed: Vec::new(),
            rise: vec![[f64::NAN; 3]; manifold.domain.kinds.len()],
            skies: (0..manifold.exits.len())
                .map(|exit| manifold.sky_registers(Some(exit)))
                .collect(),
        }
    }

    /// Finds the ending on the cubics of the known part of `path`; `None` if there is no event.
    pub fn ending(&mut self, path: PathView<'_>) -> Option<Ending> {
        self.refined_ending(path, &|s, rows| {
            path.sample(s, rows);
            s.len()
        })
    }

    /// Finds the ending on the path itself, which `sample` knows better than the cubics.
    pub fn refined_ending(&mut self, path: PathView<'_>, sample: &Sampling<'_>) -> Option<Ending> {
        let event = self.refined_event(path, sample)?;
        Some(self.ending_of(&event))
    }

    /// Finds the event of [`EventLocator::refined_ending`]: between two knots of the path, then between two
    /// of sixteen points there.
    pub fn refined_event(&mut self, path: PathView<'_>, sample: &Sampling<'_>) -> Option<Event> {
        self.first_event(path, sample, PASSING_LOOKS)
    }

    /// Finds it, where pieces may be looked at so many times on which an event may rise and fall again.
    fn first_event(
        &mut self,
        path: PathView<'_>,
        sample: &Sampling<'_>,
        looks: usize,
    ) -> Option<Event> {
        let last = self.last_piece(path);
        let rise = last.and_then(|_| earliest(self.rise.iter().copied()));
        if looks > 0 && !self.passed.is_empty() {
            let passed = std::mem::take(&mut self.passed);
            let found = passed_together(&passed).find_map(|knots| {
                let points = SixteenPoints::new(knots.map(|k| path.knots[k]), sample);
                self.first_event(points.view(path), sample, looks - 1)
            });
            self.passed = passed;
            if found.is_some() {
                return found;
            }
        }
        let piece = path.piece(last?);
        // At the very end of the piece rounding may hide the event from the points between.
        self.event_between(piece, path, sample).or_else(|| {
            let (t, kind) = rise?;
            Some(Event::on(&piece, t, kind))
        })
    }

    /// Finds the first event between two of sixteen points of a piece of the path, and between sixteen of these two where the
    /// path comes to a stop between them: a table's paths do a little behind an exit, and a cubic across is none of the
    /// path.
    fn event_between(
        &mut self,
        mut piece: Cubic,
        path: PathView<'_>,
        sample: &Sampling<'_>,
    ) -> Option<Event> {
        for _ in 0..CLOSER_LOOKS {
            let points = SixteenPoints::new(piece.s, sample);
            let closer = points.view(path);
            piece = closer.piece(self.last_piece(closer)?);
            // A condition that is zero up to its event says no more than between which points it is.
            let mut rises = self.rise.iter();
            let flat = rises.any(|[before, here, _]| *before == 0.0 && *here > 0.0);
            if !(flat || comes_to_a_stop(piece.v)) {
                break;
            }
        }
        let (t, kind) = earliest(self.rise.iter().copied())?;
        Some(Event::on(&piece, t, kind))
    }

    /// Returns the ending that an event makes.
    pub fn ending_of(&mut self, event: &Event) -> Ending {
        let domain = &self.manifold.domain;
        let Event { s, u, v, .. } = *event;
        match End::of_event(domain, domain.kinds[event.kind]) {
            End::Exit(exit) => {
                let registers = self.skies[exit].as_mut();
                let sky = self.manifold.sky_direction_in(registers, Some(exit), u, v);
                Ending::Exit { exit, s, sky }
            }
            End::Length => Ending::Length,
            End::Singular => Ending::Singular,
        }
    }

    /// Finds the number of the piece at whose end the first event has risen; `None` if there is none. Lists those
    /// before it on which one may rise and fall again.
    fn last_piece(&mut self, path: PathView<'_>) -> Option<usize> {
        self.passed.clear();
        if self.before.is_empty() {
            return None;
        }
        // Nothing rises beyond this: at the first knot no event counts.
        self.before.fill(f64::INFINITY);
        self.earlier.fill(f64::INFINITY);
        for first in (0..path.known).step_by(LANES) {
            let count = LANES.min(path.known - first);
            if let Some(lane) = self.rising(&path, first, count) {
                return Some(first + lane - 1);
            }
        }
        None
    }

    /// Finds the first of the `count` knots from `first` on at which an event counts; `rise` then holds the
    /// events' values there, before and after.
    fn rising(&mut self, path: &PathView<'_>, first: usize, count: usize) -> Option<usize> {
        for c in 0..ROWS {
            let row = &path.row(c)[first..first + count];
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
        // The events of all knots at once, and the first knot at which one counts.
        let tape = self.manifold.domain.events();
        let (registers, before) = (&mut self.registers, &self.before);
        let earlier = &self.earlier;
        let (counts, summits) = vectorised(
            #[inline(always)]
            || {
                tape.run(registers);
                let counts = counting(registers, before, after);
                (counts, have_summits(registers, before, earlier))
            },
        );
        let lane = lanes::first(&counts);
        if summits {
            self.note_passed(first, lane.unwrap_or(count));
        }
        // Their values around it, or those at the last knot for the next sixteen.
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
                None => {
                    self.earlier[k] = if count > 1 {
                        values[count - 2]
                    } else {
                        *before
                    };
                    *before = values[count - 1];
                }
            }
        }
        lane
    }

    /// Lists where an event may rise and fall again about the knots up to the first `count` of sixteen, the first of which
    /// has this number.
    fn note_passed(&mut self, first: usize, count: usize) {
        for (kind, (before, earlier)) in self.before.iter().zip(&self.earlier).enumerate() {
            let values = self.registers.output(kind);
            let at = |l: usize| match l {
                0 => *earlier,
                1 => *before,
                _ => values[l - 2],
            };
            for l in 0..count {
                let three = [at(l), at(l + 1), at(l + 2)];
                if may_rise_between(three) {
                    // Between the knots l - 2, l - 1 and l of these.
                    self.passed.push(first + l - 2);
                }
            }
        }
        self.passed.sort_unstable();
        self.passed.dedup();
    }
}

/// Returns the knots at both ends of the pieces that are looked at at once, from the first of each two pieces on which an
/// event may rise and fall again.
fn passed_together(passed: &[usize]) -> impl Iterator<Item = [usize; 2]> {
    let runs = passed.chunk_by(|piece, next| piece + 1 == *next);
    let parts = runs.flat_map(|run| run.chunks(PASSED_TOGETHER));
    parts.map(|part| [part[0], part[part.len() - 1] + 2])
}

/// Returns the earliest of the events that count between two places, from the values of each before, there
/// and at the next place: the fraction of the way, and its index.
#[inline(always)]
fn earliest(rises: impl Iterator<Item = [f64; 3]>) -> Option<(f64, usize)> {
    let mut first: Option<(f64, usize)> = None;
    for (k, rise) in rises.enumerate() {
        if rise[1] > more(rise[0], 0.0) {
            let t = root(rise);
            if first.is_none_or(|(earlier, _)| t < earlier) {
                first = Some((t, k));
            }
        }
    }
    first
}

/// Returns where in [0, 1] the parabola through `before` at 0, `after` at 1 and `next` at 2 becomes positive:
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

/// Marks the lanes in which any event is positive and larger than it was, which `earlier` computes from what
/// is known of that event and its values.
#[inline(always)]
fn counting<T>(
    events: &Registers<f64, LANES>,
    known: &[T],
    earlier: impl Fn(&T, &Lanes) -> Lanes,
) -> Mask {
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

/// Tells whether an event may rise and fall again about one of sixteen knots, with its values at the two before.
#[inline(always)]
fn have_summits(events: &Registers<f64, LANES>, before: &[f64], earlier: &[f64]) -> bool {
    let mut any = false;
    for (k, (before, earlier)) in before.iter().zip(earlier).enumerate() {
        let values = events.output(k);
        let one = after(before, values);
        let two = after(earlier, &one);
        for l in 0..LANES {
            any |= may_rise_between([two[l], one[l], values[l]]);
        }
    }
    any
}

/// Returns the values one lane before: `before` for the first.
#[inline(always)]
fn after(before: &f64, values: &Lanes) -> Lanes {
    let mut earlier = [*before; LANES];
    earlier[1..].copy_from_slice(&values[..LANES - 1]);
    earlier
}

impl EventLocator<'_> {
    /// Finds how the paths of sixteen samples end. They come from the last vertices of a patch
    /// (`PathPatch::last_vertices`) as every other point of them does, so that an edge between two
    /// skies, or between a sky and paths that end nowhere, runs through the tile where it should.
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

    /// Finds how sixteen straight lines end that begin at `starts` with these `tangents`, over so many `pieces` of `length`,
    /// each looked at more closely at sixteen points.
    pub fn endings_of_lines(
        &mut self,
        (starts, tangents): (&Vectors, &Vectors),
        (length, pieces): (f64, usize),
    ) -> [Ending; LANES] {
        let step = length / (pieces * LANES) as f64;
        vectorised(
            #[inline(always)]
            || {
                self.endings_of_sixteen(
                    (pieces, LANES),
                    #[inline(always)]
                    |i| {
                        let s = step * i as f64;
                        let along = |c: usize, l: usize| starts[c][l] + tangents[c][l] * s;
                        (s, each_vector(along))
                    },
                    #[inline(always)]
                    |_| *tangents,
                )
            },
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
        let mut ended = [false; LANES];
        for (end, number) in numbers.enumerate() {
            self.run_at(&point(number).1, || tangent(number));
            if end > 0 {
                let counts = counting(&self.registers, &before, |before, _| *before);
                suspected[end - 1] |= any(&counts);
                for l in 0..LANES {
                    ended[l] |= counts[l];
                }
            }
            for (k, (earlier, before)) in earlier.iter_mut().zip(&mut before).enumerate() {
                let now = self.registers.output(k);
                if end > 1 && (0..LANES).any(|l| may_rise_between([earlier[l], before[l], now[l]]))
                {
                    suspected[end - 2..end].fill(true);
                }
                (*earlier, *before) = (*before, *now);
            }
            // What comes later is behind the ends of all.
            if ended == [true; LANES] {
                break;
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
#[path = "endings_tests.rs"]
mod tests;
