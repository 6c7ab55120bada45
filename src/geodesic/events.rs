//! Where a ray ends: the first arc length at which an event of the domain becomes positive.
//!
//! In: a [`Step`]. Out: the [`End`] and its arc length, found on the step's curve to rounding, not
//! to the step. The curve is looked at in its middle and at its end, so an event that comes and goes
//! within half a step is missed; steps are short against the curvature of the path.
//!
//! A ray that starts beyond an event is not over if it is on its way back: the event counts as soon
//! as its value rises.

use super::{End, Step, crossing};
use crate::{
    expr::Registers,
    manifold::{Domain, EventKind},
};
use glam::DVec3;

/// Finds events on the steps of one ray after another.
#[derive(Clone)]
pub(super) struct EventFinder<'m> {
    domain: &'m Domain,
    registers: Registers<f64, 1>,
    /// The events' values at the end of the step before.
    before: Vec<f64>,
}

impl<'m> EventFinder<'m> {
    pub fn new(domain: &'m Domain) -> Self {
        Self {
            domain,
            registers: domain.events().registers(),
            before: vec![f64::NAN; domain.kinds.len()],
        }
    }

    /// Begins a ray at `u` with tangent `v`.
    pub fn start(&mut self, u: DVec3, v: DVec3) {
        self.evaluate(u, v);
        self.remember();
    }

    /// The first event on the next step of the ray, with its arc length.
    pub fn first_in(&mut self, step: &Step) -> Option<(End, f64)> {
        if self.domain.kinds.is_empty() {
            return None;
        }
        let middle = 0.5 * (step.start + step.end);
        for (from, to) in [(step.start, middle), (middle, step.end)] {
            self.evaluate(step.position(to), step.tangent(to));
            let hit: Vec<usize> = (0..self.before.len()).filter(|&k| self.counts(k)).collect();
            let first = hit
                .into_iter()
                .map(|k| match self.before[k] > 0.0 {
                    true => (from, k),
                    false => (self.crossing(step, k, from, to), k),
                })
                .min_by(|a, b| a.0.total_cmp(&b.0));
            if let Some((s, k)) = first {
                return Some((End::of_event(self.domain, self.domain.kinds[k]), s));
            }
            self.remember();
        }
        None
    }

    /// Whether event `k` is positive now and was not, or rises still.
    fn counts(&self, k: usize) -> bool {
        let now = self.registers.output(k)[0];
        now > self.before[k].max(0.0)
    }

    fn remember(&mut self) {
        for (k, value) in self.before.iter_mut().enumerate() {
            *value = self.registers.output(k)[0];
        }
    }

    fn evaluate(&mut self, u: DVec3, v: DVec3) {
        for k in 0..3 {
            *self.registers.input(k) = [u[k]];
            *self.registers.input(3 + k) = [v[k]];
        }
        self.domain.events().run(&mut self.registers);
    }

    /// The arc length in `[low, high]` at which event `k` becomes positive.
    fn crossing(&mut self, step: &Step, k: usize, low: f64, high: f64) -> f64 {
        crossing(low, high, |s| {
            self.evaluate(step.position(s), step.tangent(s));
            self.registers.output(k)[0]
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
