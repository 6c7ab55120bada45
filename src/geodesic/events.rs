//! Where a ray ends: the first arc length at which an event of the domain becomes positive.
//!
//! In: trial states of all lanes, then the accepted [`Step`] of one. Out: the [`End`] and its arc
//! length, found on the step's curve to rounding, not to the step. Events are looked at at the end of
//! a step and at one or three places inside it, so one that comes and goes between two of them is
//! missed: at most 1/64 of the ray lies between.
//!
//! A ray that starts beyond an event is not over if it is on its way back.

use super::{
    End, LANES, NIL, Row, Step,
    first_event::{first_between, is_met},
    integrator::take_where,
};
use crate::{
    expr::{Registers, Wide},
    manifold::{Domain, EventKind},
};

/// Where events are looked at, as fractions of a step.
const PLACES: [f64; 4] = [0.25, 0.5, 0.75, 1.0];

/// Finds events on the steps of the rays in all lanes.
pub(super) struct Events<'m> {
    domain: &'m Domain,
    lanes: Registers<f64, LANES>,
    single: Registers<f64, 1>,
    /// The events' values at the end of the step before, and at [`PLACES`] of the step tried.
    before: Vec<Row>,
    at: [Vec<Row>; 4],
    /// 1 where a lane looks at a place, else 0.
    looked: [Row; 4],
    /// 1 where an event is met within the step tried, else 0.
    met: Row,
}

impl<'m> Events<'m> {
    /// `None` when the domain has no events.
    pub fn new(domain: &'m Domain) -> Option<Self> {
        let rows = vec![Wide([f64::NAN; LANES]); domain.kinds.len()];
        (!rows.is_empty()).then(|| Self {
            domain,
            lanes: domain.events().registers(),
            single: domain.events().registers(),
            before: rows.clone(),
            at: std::array::from_fn(|_| rows.clone()),
            looked: [NIL; 4],
            met: NIL,
        })
    }

    /// The values of all events for the states (u, v) of all lanes.
    pub fn values(&mut self, state: &[Row], values: &mut Vec<Row>) {
        values.resize(self.before.len(), NIL);
        self.evaluate(state);
        for (k, row) in values.iter_mut().enumerate() {
            **row = *self.lanes.output(k);
        }
    }

    #[inline(always)]
    fn evaluate(&mut self, state: &[Row]) {
        for (k, row) in state.iter().enumerate() {
            *self.lanes.input(k) = **row;
        }
        self.domain.events().run(&mut self.lanes);
    }

    /// Begins a ray in `lane`, where events have the values in `column` of `values`.
    pub fn start(&mut self, lane: usize, values: &[Row], column: usize) {
        for (before, value) in self.before.iter_mut().zip(values) {
            before[lane] = value[column];
        }
    }

    /// Evaluates all events in all lanes for the states (u, v) at one of [`PLACES`] of the steps tried;
    /// where `looked` is 0 the values are those of the place before.
    #[inline(always)]
    pub fn look(&mut self, place: usize, state: &[Row], looked: &Row) {
        self.evaluate(state);
        self.looked[place] = *looked;
        if place == 0 {
            self.met = NIL;
        }
        for k in 0..self.before.len() {
            let now = self.lanes.output(k);
            let (earlier, later) = self.at.split_at_mut(place);
            let before = earlier.last().map_or(&self.before[k], |rows| &rows[k]);
            let (row, met) = (&mut later[0][k], &mut self.met);
            for l in 0..LANES {
                let value = if looked[l] > 0.0 { now[l] } else { before[l] };
                let rises = is_met(before[l], value);
                row[l] = value;
                met[l] = if rises { 1.0 } else { met[l] };
            }
        }
    }

    /// Leaves out a place: the values there are those of the place before.
    #[inline(always)]
    pub fn skip(&mut self, place: usize) {
        if place == 0 {
            self.met = NIL;
        }
        self.looked[place] = NIL;
        let (earlier, later) = self.at.split_at_mut(place);
        let before = earlier.last().unwrap_or(&self.before);
        later[0].copy_from_slice(before);
    }

    /// Whether an event is met within the step tried in `lane`.
    pub fn met(&self, lane: usize) -> bool {
        self.met[lane] > 0.0
    }

    /// Moves on where `accepted` is 1.
    #[inline(always)]
    pub fn commit(&mut self, accepted: &Row) {
        take_where(accepted, &self.at[PLACES.len() - 1], &mut self.before);
    }

    /// The first event on the accepted step of `lane`, with its arc length.
    pub fn first_in(&mut self, lane: usize, step: &Step) -> Option<(End, f64)> {
        let Self {
            domain,
            single,
            before,
            at,
            looked,
            ..
        } = self;
        let mut from = (step.start, &*before);
        PLACES.into_iter().enumerate().find_map(|(place, t)| {
            if looked[place][lane] == 0.0 {
                return None;
            }
            let to = (step.start + t * step.h, &at[place]);
            let ends = |k: usize| [from.1[k][lane], to.1[k][lane]];
            let first = first_between(domain, [from.0, to.0], ends, |k, s| {
                let (u, v) = (step.position(s), step.tangent(s));
                for c in 0..3 {
                    *single.input(c) = [u[c]];
                    *single.input(3 + c) = [v[c]];
                }
                domain.events().run(single);
                single.output(k)[0]
            });
            from = to;
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
