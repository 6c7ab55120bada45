//! Where a ray ends: the first arc length at which an event of the domain becomes positive.
//!
//! In: trial states of all lanes, then the accepted [`Step`] of one. Out: the [`End`] and its arc
//! length, found on the step's curve to rounding, not to the step. Events are looked at in the
//! middle and at the end of a step, so one that comes and goes within half a step is missed; steps
//! are short against the curvature of the path.
//!
//! A ray that starts beyond an event is not over if it is on its way back: the event counts as soon
//! as its value rises.

use super::{End, LANES, NIL, Row, Step, crossing, integrator::take_where};
use crate::{
    expr::{Registers, Wide},
    manifold::{Domain, EventKind},
};
use glam::DVec3;

/// Finds events on the steps of the rays in all lanes.
pub(super) struct Events<'m> {
    domain: &'m Domain,
    lanes: Registers<f64, LANES>,
    single: Registers<f64, 1>,
    /// The events' values at the end of the step before, and in the middle and at the end of the
    /// step tried.
    before: Vec<Row>,
    middle: Vec<Row>,
    end: Vec<Row>,
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
            middle: rows.clone(),
            end: rows,
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

    /// Evaluates all events in all lanes for the middles and ends (u, v) of the steps tried.
    #[inline(always)]
    pub fn look(&mut self, middle: &[Row], end: &[Row]) {
        self.evaluate(middle);
        for (k, row) in self.middle.iter_mut().enumerate() {
            **row = *self.lanes.output(k);
        }
        self.evaluate(end);
        self.met = NIL;
        for (k, row) in self.end.iter_mut().enumerate() {
            **row = *self.lanes.output(k);
            let (before, middle) = (&self.before[k], &self.middle[k]);
            for l in 0..LANES {
                let rises = (middle[l] > 0.0) & (middle[l] > before[l])
                    | (row[l] > 0.0) & (row[l] > middle[l]);
                self.met[l] = if rises { 1.0 } else { self.met[l] };
            }
        }
    }

    /// Whether an event is met within the step tried in `lane`.
    pub fn met(&self, lane: usize) -> bool {
        self.met[lane] > 0.0
    }

    /// Moves on where `accepted` is 1.
    #[inline(always)]
    pub fn commit(&mut self, accepted: &Row) {
        take_where(accepted, &self.end, &mut self.before);
    }

    /// The first event on the accepted step of `lane`, with its arc length.
    pub fn first_in(&mut self, lane: usize, step: &Step) -> Option<(End, f64)> {
        let middle = 0.5 * (step.start + step.end);
        let first = self.first_between(lane, step, [step.start, middle], false);
        first.or_else(|| self.first_between(lane, step, [middle, step.end], true))
    }

    fn first_between(
        &mut self,
        lane: usize,
        step: &Step,
        [from, to]: [f64; 2],
        second: bool,
    ) -> Option<(End, f64)> {
        let mut first: Option<(f64, usize)> = None;
        for k in 0..self.before.len() {
            let (before, now) = match second {
                false => (self.before[k][lane], self.middle[k][lane]),
                true => (self.middle[k][lane], self.end[k][lane]),
            };
            if now > before.max(0.0) {
                let s = match before > 0.0 {
                    true => from,
                    false => crossing(from, to, |s| {
                        self.value(k, step.position(s), step.tangent(s))
                    }),
                };
                if first.is_none_or(|(earlier, _)| s < earlier) {
                    first = Some((s, k));
                }
            }
        }
        first.map(|(s, k)| (End::of_event(self.domain, self.domain.kinds[k]), s))
    }

    fn value(&mut self, event: usize, u: DVec3, v: DVec3) -> f64 {
        for k in 0..3 {
            *self.single.input(k) = [u[k]];
            *self.single.input(3 + k) = [v[k]];
        }
        self.domain.events().run(&mut self.single);
        self.single.output(event)[0]
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
