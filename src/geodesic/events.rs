//! Where a ray ends: the first arc length at which an event of the domain becomes positive.
//!
//! In: trial states of all lanes, then the accepted [`Step`] of one. Out: the [`End`] and its arc
//! length, found on the step's curve to rounding, not to the step. Events are looked at in the
//! middle and at the end of a step, so one that comes and goes within half a step is missed; steps
//! are short against the curvature of the path.
//!
//! A ray that starts beyond an event is not over if it is on its way back: the event counts as soon
//! as its value rises.

use super::{End, LANES, Row, Step, crossing};
use crate::{
    expr::Registers,
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
}

impl<'m> Events<'m> {
    /// `None` when the domain has no events.
    pub fn new(domain: &'m Domain) -> Option<Self> {
        let rows = vec![[f64::NAN; LANES]; domain.kinds.len()];
        (!rows.is_empty()).then(|| Self {
            domain,
            lanes: domain.events().registers(),
            single: domain.events().registers(),
            before: rows.clone(),
            middle: rows.clone(),
            end: rows,
        })
    }

    /// Begins a ray at `u` with tangent `v` in `lane`.
    pub fn start(&mut self, lane: usize, u: DVec3, v: DVec3) {
        for k in 0..self.before.len() {
            self.before[k][lane] = self.value(k, u, v);
        }
    }

    /// Evaluates all events in all lanes for the middles and ends (u, v) of the steps tried.
    #[inline(always)]
    pub fn look(&mut self, middle: [Row; 6], end: [Row; 6]) {
        for (state, values) in [(middle, &mut self.middle), (end, &mut self.end)] {
            for (k, row) in state.into_iter().enumerate() {
                *self.lanes.input(k) = row;
            }
            self.domain.events().run(&mut self.lanes);
            for (k, row) in values.iter_mut().enumerate() {
                *row = *self.lanes.output(k);
            }
        }
    }

    /// The first event on the accepted step of `lane`, with its arc length.
    pub fn first_in(&mut self, lane: usize, step: &Step) -> Option<(End, f64)> {
        let middle = 0.5 * (step.start + step.end);
        let first = self.first_between(lane, step, [step.start, middle], false);
        let first = first.or_else(|| self.first_between(lane, step, [middle, step.end], true));
        for k in 0..self.before.len() {
            self.before[k][lane] = self.end[k][lane];
        }
        first
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
