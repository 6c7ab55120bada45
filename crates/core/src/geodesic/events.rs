//! Where a ray ends: the first arc length at which an event of the domain becomes positive.
//!
//! In: trial states of all lanes, then the accepted [`Step`] of one. Out: the [`End`] and its arc
//! length, found on the step's curve to rounding, not to the step. Events are looked at at the end of
//! a step and at one or three places inside it, so one that comes and goes between two of them is
//! missed: at most 1/64 of the ray lies between.
//!
//! A ray that starts beyond an event is not over if it is on its way back.

use super::{
    End, LANES, NIL, Row, Step, control::Control, curves::Curves, each, first_event::first_between,
    rows::take_where,
};
use crate::manifold::{Domain, EventKind};
use geofan_expr::{Registers, Wide, real::Real};

/// Where events are looked at, as fractions of a step; short steps only at every second place.
const PLACES: [f64; 4] = [0.25, 0.5, 0.75, 1.0];

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

    /// Begins a ray in `lane`, where events have the values in `column` of `values`.
    pub fn start(&mut self, lane: usize, values: &[Row], column: usize) {
        for (before, value) in self.before.iter_mut().zip(values) {
            before[lane] = value[column];
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

    /// Returns whether an event may be met within the step tried in `lane`.
    pub fn may_be_met(&self, lane: usize) -> bool {
        self.most[lane] > 0.0
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
                let (u, v) = (step.position(s), step.tangent(s));
                for c in 0..3 {
                    *single.input(c) = [u[c]];
                    *single.input(3 + c) = [v[c]];
                }
                domain.events().run(single);
                single.output(k)[0]
            });
            from = (to, Some(place));
            first
        })
    }
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
