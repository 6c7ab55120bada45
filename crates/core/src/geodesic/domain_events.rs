//! Events of the domain: the first arc length at which one becomes positive ends a ray.
//!
//! In: trial states of all lanes, then the accepted [`Step`] of one; or the events' values at the ends of a
//! stretch; or any curve s -> (u, v). Out: the [`End`] and its arc length, found on the curve to rounding,
//! not to the step. Events are looked at at the end of a step and at one or three places inside it, at most 1/64 of
//! the ray apart. One that comes and goes between two of them is found where the values bend as at a summit
//! ([`may_rise_between`]): those of a ball do, however small it is.
//!
//! An event counts where its value becomes positive; one that is positive already, because the ray starts
//! beyond it, counts as soon as its value rises. [`crossing`] is the root finder of all of them.

use super::{
    End, LANES, NIL, Row, Step, dormand_prince::Control, each, state::take_where, step::Curves,
};
use crate::manifold::{Domain, EventKind};
use geofan_expr::{Registers, Wide, real::Real};
use glam::DVec3;

/// Where events and faces are looked for, as fractions of a step; events of short steps only at every second place.
pub(super) const PLACES: [f64; 4] = [0.25, 0.5, 0.75, 1.0];

/// The number of the middle among them.
const MIDDLE: usize = 1;

/// Most halvings of a ray's length that are looked at for where a line meets an event, and halvings of what is left then.
const STRAIGHT_HALVINGS: usize = 48;
const STRAIGHT_REFINEMENTS: usize = 3;

/// Most looks for a place near its summit where an event is positive.
const SUMMIT_LOOKS: usize = 24;

/// Share of its change below which the value of an event is 0 where a ray has been moved to: faces may lie where events do.
const MOVED_SHARE: f64 = 1e-9;

/// Finds events on the steps of the rays in all lanes.
pub(super) struct Events<'m> {
    domain: &'m Domain,
    /// Set if the events depend on the tangent.
    tangent: bool,
    single: Registers<f64, 1>,
    /// The events' values at the end of the step before.
    before: Vec<Row>,
    /// Those at [`PLACES`] of the step tried.
    at: [Registers<f64, LANES>; 4],
    /// 1 where a step is looked at in all places, else 0.
    long: Row,
    /// The largest value of any event at any place.
    most: Row,
    /// 1 where an event may rise and fall again between places, else 0.
    summits: Row,
}

impl<'m> Events<'m> {
    /// `None` when the domain has no events.
    pub fn new(domain: &'m Domain) -> Option<Self> {
        let rows = vec![Wide([f64::NAN; LANES]); domain.kinds.len()];
        let tape = domain.events();
        (!rows.is_empty()).then(|| Self {
            domain,
            tangent: [3, 4, 5].into_iter().any(|input| tape.reads(input)),
            single: tape.registers(),
            before: rows,
            at: std::array::from_fn(|_| tape.registers()),
            long: NIL,
            most: NIL,
            summits: NIL,
        })
    }

    /// The values of all events for the states (u, v) of all lanes.
    pub fn values(&mut self, state: &[Row], values: &mut Vec<Row>) {
        values.resize(self.before.len(), NIL);
        self.look_at_state(state);
        for (k, row) in values.iter_mut().enumerate() {
            **row = *self.at[PLACES.len() - 1].output(k);
        }
    }

    /// Estimates in which arc length the lines from the states (u, v), straight in the chart, meet an event that is not
    /// positive among the `values` there, where that is at most a `share` of `lengths`; infinity elsewhere. At most a tenth
    /// too long.
    pub fn straight_ends(
        &mut self,
        (state, values): (&[Row], &[Row]),
        lengths: &Row,
        share: f64,
    ) -> Row {
        let mut ends = each(|_| f64::INFINITY);
        let mut way = each(|l| share * lengths[l]);
        for _ in 0..STRAIGHT_HALVINGS {
            let met = self.met_on_lines((state, values), &way);
            if met.iter().all(|met| *met == 0.0) {
                break;
            }
            ends = each(|l| if met[l] > 0.0 { way[l] } else { ends[l] });
            way = each(|l| 0.5 * way[l]);
        }
        // Where the event is not met yet, by halving what is between.
        let mut before = each(|l| 0.5 * ends[l]);
        if ends.iter().all(|end| end.is_infinite()) {
            return ends;
        }
        for _ in 0..STRAIGHT_REFINEMENTS {
            let middle = each(|l| 0.5 * (before[l] + ends[l]));
            let met = self.met_on_lines((state, values), &middle);
            before = each(|l| if met[l] > 0.0 { before[l] } else { middle[l] });
            ends = each(|l| if met[l] > 0.0 { middle[l] } else { ends[l] });
        }
        ends
    }

    /// Returns 1 where an event that is not positive among the `values` of the states is so a `way` along their lines, else 0.
    fn met_on_lines(&mut self, (state, values): (&[Row], &[Row]), way: &Row) -> Row {
        let mut on_line: Vec<Row> = state[..6].to_vec();
        for c in 0..3 {
            on_line[c] = each(|l| state[c][l] + way[l] * state[3 + c][l]);
        }
        self.look_at_state(&on_line);
        let mut met = NIL;
        for (k, before) in values.iter().enumerate() {
            let now = self.at[PLACES.len() - 1].output(k);
            met = each(|l| match before[l] <= 0.0 && now[l] > 0.0 {
                true => 1.0,
                false => met[l],
            });
        }
        met
    }

    /// Begins a ray in `lane`, where events have the values in `column` of `values`.
    pub fn start(&mut self, lane: usize, values: &[Row], column: usize) {
        for (before, value) in self.before.iter_mut().zip(values) {
            before[lane] = value[column];
        }
    }

    /// Begins anew in `lane`, whose ray has moved to the state (u, v). An event that has become positive by that is met
    /// there: the next step finds it at its start, because it counts as hardly positive before.
    pub fn restart(&mut self, lane: usize, state: [f64; 6]) {
        self.domain.events().run_at(&mut self.single, &state);
        for (k, before) in self.before.iter_mut().enumerate() {
            let (then, now) = (before[lane], self.single.output(k)[0]);
            let is_met = then <= 0.0 && now > MOVED_SHARE * (now - then);
            before[lane] = if is_met { f64::MIN_POSITIVE } else { now };
        }
    }

    /// Evaluates all events in all lanes on the steps tried, whose ends are the states (u, v).
    #[inline(always)]
    pub fn look(&mut self, curves: &Curves, control: &Control, ends: &[Row]) {
        self.most = NIL;
        self.long = each(|l| if control.is_long(l) { 1.0 } else { 0.0 });
        let inverse = each(|l| 1.0 / control.h[l]);
        let any_is_long = control.any_is_long();
        for place in 0..PLACES.len() - 1 {
            if any_is_long || place % 2 == 1 {
                self.look_inside(place, curves, &inverse);
                self.note(place);
            }
        }
        self.look_at_state(ends);
        self.note(PLACES.len() - 1);
        self.note_summits();
    }

    #[inline(always)]
    fn look_inside(&mut self, place: usize, curves: &Curves, inverse: &Row) {
        let (registers, t) = (&mut self.at[place], PLACES[place]);
        for c in 0..3 {
            *registers.input(c) = *curves.point(c, t);
            if self.tangent {
                *registers.input(3 + c) = *curves.tangent(c, inverse, t);
            }
        }
        self.domain.events().run(registers);
    }

    #[inline(always)]
    fn look_at_state(&mut self, state: &[Row]) {
        let registers = &mut self.at[PLACES.len() - 1];
        for k in 0..6 {
            *registers.input(k) = *state[k];
        }
        self.domain.events().run(registers);
    }

    #[inline(always)]
    fn note(&mut self, place: usize) {
        let mut most = self.most;
        for k in 0..self.before.len() {
            let now = self.at[place].output(k);
            most = each(|l| Real::max(now[l], most[l]));
        }
        self.most = most;
    }

    /// Marks the lanes in which an event may rise and fall again between its start, its middle and its end.
    #[inline(always)]
    fn note_summits(&mut self) {
        let mut summits = NIL;
        for (k, before) in self.before.iter().enumerate() {
            let [middle, end] = [MIDDLE, PLACES.len() - 1].map(|place| self.at[place].output(k));
            summits = each(|l| {
                let may_rise = may_rise_between([before[l], middle[l], end[l]]);
                if may_rise { 1.0 } else { summits[l] }
            });
        }
        self.summits = summits;
    }

    /// Returns whether an event may be met within the step tried in `lane`.
    pub fn may_be_met(&self, lane: usize) -> bool {
        self.most[lane] > 0.0 || self.summits[lane] > 0.0
    }

    /// Moves on where `accepted` is 1.
    #[inline(always)]
    pub fn commit(&mut self, accepted: &Row) {
        for (k, before) in self.before.iter_mut().enumerate() {
            let now = Wide(*self.at[PLACES.len() - 1].output(k));
            take_where(accepted, &[now], std::slice::from_mut(before));
        }
    }

    /// The first event on the accepted step of `lane`, with its arc length.
    pub fn first_in(&mut self, lane: usize, step: &Step) -> Option<(End, f64)> {
        let between = self.first_at_places(lane, step);
        match self.summits[lane] > 0.0 {
            true => earlier(between, self.first_passed(lane, step)),
            false => between,
        }
    }

    /// The first event that has risen at one of [`PLACES`].
    fn first_at_places(&mut self, lane: usize, step: &Step) -> Option<(End, f64)> {
        let Self {
            domain,
            single,
            before,
            at,
            long,
            ..
        } = self;
        let mut from = (step.start, None);
        PLACES.into_iter().enumerate().find_map(|(place, t)| {
            if place % 2 == 0 && long[lane] == 0.0 {
                return None;
            }
            let to = step.start + t * step.h;
            let value = |place: Option<usize>, k: usize| match place {
                Some(place) => at[place].output(k)[lane],
                None => before[k][lane],
            };
            let ends = |k: usize| [value(from.1, k), value(Some(place), k)];
            let first = first_between(domain, [from.0, to], ends, |k, s| {
                value_on(domain, single, step, (k, s))
            });
            from = (to, Some(place));
            first
        })
    }

    /// The first event that rises and falls again between the step's start, its middle and its end.
    fn first_passed(&mut self, lane: usize, step: &Step) -> Option<(End, f64)> {
        let Self {
            domain,
            single,
            before,
            at,
            ..
        } = self;
        let known = |k: usize| {
            let [middle, end] = [MIDDLE, PLACES.len() - 1].map(|place| at[place].output(k)[lane]);
            [before[k][lane], middle, end]
        };
        first_passed(domain, [step.start, step.end], &known, &mut |k, s| {
            value_on(domain, single, step, (k, s))
        })
    }
}

/// The value of event `k` at the arc length `s` of a step.
fn value_on(
    domain: &Domain,
    registers: &mut Registers<f64, 1>,
    step: &Step,
    (k, s): (usize, f64),
) -> f64 {
    let (u, v) = (step.position(s), step.tangent(s));
    for c in 0..3 {
        *registers.input(c) = [u[c]];
        *registers.input(3 + c) = [v[c]];
    }
    domain.events().run(registers);
    registers.output(k)[0]
}

impl End {
    /// The end that an event of `kind` means: exits of the file come first, then `limit` and
    /// `inside`.
    pub fn of_event(domain: &Domain, kind: EventKind) -> Self {
        let named = domain
            .kinds
            .iter()
            .filter(|k| matches!(k, EventKind::Exit(_)))
            .count();
        match kind {
            EventKind::Exit(k) => Self::Exit(k),
            EventKind::Limit => Self::Exit(named),
            EventKind::Inside => Self::Exit(named + 1),
        }
    }
}

/// Number of intervals in which a whole path is searched for events: paths of tables bend over about a hundredth of
/// their length at the least.
const LOOKS: u32 = 256;

/// Returns whether an event with these values at two places is met between them. What has no value is not positive.
#[inline(always)]
fn is_met(before: f64, now: f64) -> bool {
    (now > 0.0) & ((now > before) | before.is_nan())
}

/// Tells whether an event with these values at three places, equally far apart and none positive, may be positive
/// between them. Outside two of its points a concave function lies below the line through them: so an event that
/// rises and falls once, as that of a ball or a cone, is found, however short the part is in which it is positive.
#[inline(always)]
pub fn may_rise_between([a, b, c]: [f64; 3]) -> bool {
    let none_positive = (a <= 0.0) & (b <= 0.0) & (c <= 0.0);
    none_positive & ((2.0 * b > a) | (2.0 * b > c))
}

/// The first event that rises and falls again between the arc lengths `from` and `to`; `known` gives the values of an
/// event at both and in the middle, `value` that of an event at an arc length between.
fn first_passed(
    domain: &Domain,
    [from, to]: [f64; 2],
    known: &dyn Fn(usize) -> [f64; 3],
    value: &mut dyn FnMut(usize, f64) -> f64,
) -> Option<(End, f64)> {
    earliest(domain, |k| {
        let values = known(k);
        let summit = may_rise_between(values)
            .then(|| summit([from, to], values, &mut |s| value(k, s)))??;
        Some(crossing(from, summit, |s| value(k, s)))
    })
}

/// Looks between two places for one where `value` is positive, from its values at both and in the middle: at the summit
/// of the parabola through the three best places, or halfway in the wider part. `None` as soon as what bends one way is
/// negative everywhere.
fn summit(
    [from, to]: [f64; 2],
    values: [f64; 3],
    value: &mut dyn FnMut(f64) -> f64,
) -> Option<f64> {
    let middle = 0.5 * (from + to);
    let [mut low, mut best, mut high] = [(from, values[0]), (middle, values[1]), (to, values[2])];
    for look in 0..SUMMIT_LOOKS {
        let [before, behind] = [best.0 - low.0, high.0 - best.0];
        let (rise, fall) = (best.1 - low.1, best.1 - high.1);
        // The lines through the best and the one, at the other.
        let most = (best.1 + rise * behind / before).max(best.1 + fall * before / behind);
        if !(most > 0.0) {
            return None;
        }
        let [steep, flat] = [rise * behind, fall * before];
        let vertex = best.0 + 0.5 * (steep * behind - flat * before) / (steep + flat);
        let halfway = match before > behind {
            true => low.0 + 0.5 * before,
            false => best.0 + 0.5 * behind,
        };
        let inside = vertex > low.0 && vertex < high.0 && vertex != best.0;
        let s = match inside && look % 2 == 0 {
            true => vertex,
            false => halfway,
        };
        let now = (s, value(s));
        if now.1 > 0.0 {
            return Some(s);
        }
        let (left, right) = if s < best.0 { (now, best) } else { (best, now) };
        (low, best, high) = match left.1 > right.1 {
            true => (low, left, right),
            false => (left, right, high),
        };
    }
    None
}

/// The first event between the arc lengths `from` and `to`; `ends` gives the values of an event at
/// both, `value` that of an event at an arc length between.
fn first_between(
    domain: &Domain,
    [from, to]: [f64; 2],
    ends: impl Fn(usize) -> [f64; 2],
    mut value: impl FnMut(usize, f64) -> f64,
) -> Option<(End, f64)> {
    earliest(domain, |k| {
        let [before, now] = ends(k);
        is_met(before, now).then(|| match before > 0.0 {
            true => from,
            false => crossing(from, to, |s| value(k, s)),
        })
    })
}

/// The first of all events, each of which is met at an arc length, or not.
fn earliest(domain: &Domain, mut met: impl FnMut(usize) -> Option<f64>) -> Option<(End, f64)> {
    let places = (0..domain.kinds.len()).filter_map(|k| Some((met(k)?, k)));
    let first = places.min_by(|a, b| a.0.total_cmp(&b.0));
    first.map(|(s, k)| (End::of_event(domain, domain.kinds[k]), s))
}

/// The earlier of two ends, where there are any.
fn earlier(one: Option<(End, f64)>, other: Option<(End, f64)>) -> Option<(End, f64)> {
    let both = [one, other].into_iter().flatten();
    both.min_by(|a, b| a.1.total_cmp(&b.1))
}

/// The first event on a curve s -> (u, v), chart components, for s from 0 to `length`; none on one without end.
pub fn first_event(
    domain: &Domain,
    length: f64,
    curve: impl Fn(f64) -> (DVec3, DVec3),
) -> Option<(End, f64)> {
    if !domain.ends_rays() || !length.is_finite() {
        return None;
    }
    let values = |s: f64| {
        let (u, v) = curve(s);
        domain.events().at(&[u.x, u.y, u.z, v.x, v.y, v.z])
    };
    let place = |i: u32| length * f64::from(i) / f64::from(LOOKS);
    let (mut at_first, mut before) = (None::<Vec<f64>>, values(0.0));
    (0..LOOKS).find_map(|i| {
        let stretch = [place(i), place(i + 1)];
        let now = values(stretch[1]);
        let ends = |k: usize| [before[k], now[k]];
        let passed = at_first.take().and_then(|at_first| {
            let around = [place(i - 1), stretch[1]];
            let known = |k: usize| [at_first[k], before[k], now[k]];
            first_passed(domain, around, &known, &mut |k, s| values(s)[k])
        });
        let first = first_between(domain, stretch, ends, |k, s| values(s)[k]);
        at_first = Some(std::mem::replace(&mut before, now));
        earlier(passed, first)
    })
}

/// The `s` in `[low, high]` at which `value`, not positive at `low` and positive at `high`, becomes
/// positive, to rounding: the Illinois method (M. Dowell and P. Jarratt, BIT 11 (1971) 168–174), with
/// a bisection whenever three rounds did not halve the interval, so that no shape of function can make
/// it crawl. Smooth functions take about ten looks.
pub fn crossing(low: f64, high: f64, mut value: impl FnMut(f64) -> f64) -> f64 {
    // There is one copy of it.
    positive_from([low, high], &mut value)
}

fn positive_from([mut low, mut high]: [f64; 2], value: &mut dyn FnMut(f64) -> f64) -> f64 {
    let (mut below, mut above) = (value(low).min(-0.0), value(high));
    let mut width = high - low;
    let mut was_above = None;
    // Set where the value is zero for a while before it becomes positive, of which a line through it says nothing.
    let mut flat = false;
    for round in 1..100 {
        // Never nearer to an end than this: once a side has come close, one look across the crossing
        // closes the interval.
        let least = 2.0 * f64::EPSILON * high.abs();
        if high - low <= 2.0 * least {
            break;
        }
        let crawls = round % 3 == 0 && high - low > 0.5 * width;
        if round % 3 == 0 {
            width = high - low;
        }
        let share = (below / (below - above)).clamp(0.0, 1.0);
        let share = if share.is_finite() && !crawls && !(flat && below == 0.0) {
            share
        } else {
            0.5
        };
        let s = (low + (high - low) * share).clamp(low + least, high - least);
        let v = value(s);
        if v > 0.0 {
            (high, above) = (s, v);
            below *= if was_above == Some(true) { 0.5 } else { 1.0 };
        } else {
            (low, below) = (s, v.min(-0.0));
            above *= if was_above == Some(false) { 0.5 } else { 1.0 };
            if v == 0.0 {
                // A root, unless the value stays zero.
                if value(s + least) > 0.0 {
                    return s;
                }
                flat = true;
            }
        }
        was_above = Some(v > 0.0);
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Balls and cones of any size that a line passes at any distance are met between places far apart.
    #[test]
    fn what_lies_between_places_is_found_at_its_summit() {
        for radius in [1e-4, 0.02, 0.3, 0.9] {
            for share in [0.0, 0.3, 0.99] {
                for middle in [0.01, 0.6, 1.3, 1.99] {
                    let r2 =
                        |s: f64| (s - middle) * (s - middle) + (share * radius) * (share * radius);
                    let ball = |s: f64| radius * radius - r2(s);
                    let cone = |s: f64| radius - r2(s).sqrt();
                    // Of a tiny cone not all is found within so many looks.
                    let cones = (radius > 0.01).then_some(&cone as &dyn Fn(f64) -> f64);
                    for value in [&ball as &dyn Fn(f64) -> f64].into_iter().chain(cones) {
                        let values = [0.0, 1.0, 2.0].map(value);
                        if values.iter().all(|value| *value <= 0.0) {
                            assert!(may_rise_between(values), "{radius} {share} {middle}");
                            let found =
                                summit([0.0, 2.0], values, &mut |s| value(s)).expect("a summit");
                            assert!(value(found) > 0.0);
                        }
                    }
                }
            }
        }
        assert!(!may_rise_between([-4.0, -3.0, -1.0]));
        assert!(!may_rise_between([-1.0, -2.0, -1.0]));
    }

    #[test]
    fn an_exit_without_a_value_before_it_is_met_where_it_is_positive_first() {
        let text = "name = 'edge'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1' }\n\
                    exit = [{ name = 'out', when = 'sqrt(x - 3)' }]\n";
        let source = crate::diagnostic::SourceText::new("edge", text);
        let manifold = crate::manifold::Manifold::from_source(source, &[]).unwrap();
        for length in [6.0, 60.0, 6000.0] {
            let ray = super::super::Ray::new(&manifold, -glam::DVec3::X, glam::DVec3::X, length);
            let settings = super::super::Settings::bare(1e-10).with_events();
            let path = super::super::paths(&manifold, settings, [ray]).remove(0);
            assert!(
                (path.length - 4.0).abs() < 1e-5,
                "{length}: {}",
                path.length
            );
        }
    }

    #[test]
    fn crossings_are_found_to_rounding() {
        let root = crossing(0.0, 3.0, |s| s * s - 2.0);
        assert!((root - 2.0_f64.sqrt()).abs() < 1e-14);
        let late = crossing(0.0, 1.0, |s| (s - 0.999).powi(9));
        assert!((late - 0.999).abs() < 1e-2);
        assert_eq!(crossing(0.0, 4.0, |s| s - 3.0), 3.0);
        // Zero for a while before.
        for at in [0.4, 3.0 / 7.0, 0.9] {
            let found = crossing(0.0, 1.0, |s| (s - at).max(0.0));
            assert!((found - at).abs() < 1e-14, "{found} {at}");
            let found = crossing(0.0, 1.0, |s| f64::from(s > at));
            assert!((found - at).abs() < 1e-14, "{found} {at}");
        }
        let mut looks = 0;
        let root = crossing(7.0, 7.8, |s| {
            looks += 1;
            s * s - 60.0
        });
        assert!(
            (root - 60.0_f64.sqrt()).abs() < 1e-14 && looks < 14,
            "{looks}"
        );
    }
}
