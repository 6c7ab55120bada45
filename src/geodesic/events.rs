//! Where a ray ends: the first arc length at which an event of the domain becomes positive.
//!
//! In: a [`Step`], or any curve. Out: the [`End`] and its arc length, found on the curve to rounding,
//! not to the step. A step is looked at in its middle and at its end, so an event that comes and goes
//! within half a step is missed; steps are short against the curvature of the path.
//!
//! A ray that starts beyond an event is not over if it is on its way back: the event counts as soon
//! as its value rises.

use super::{End, Step};
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
        let curve = |s: f64| (step.position(s), step.tangent(s));
        self.first_between(step.start, middle, curve)
            .or_else(|| self.first_between(middle, step.end, curve))
    }

    /// The first event on the curve s -> (u, v) for s from `from`, where the last look was, to `to`.
    fn first_between(
        &mut self,
        from: f64,
        to: f64,
        curve: impl Fn(f64) -> (DVec3, DVec3),
    ) -> Option<(End, f64)> {
        let (u, v) = curve(to);
        self.evaluate(u, v);
        let hit: Vec<usize> = (0..self.before.len()).filter(|&k| self.counts(k)).collect();
        let first = hit
            .into_iter()
            .map(|k| match self.before[k] > 0.0 {
                true => (from, k),
                false => (self.crossing(&curve, k, from, to), k),
            })
            .min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((s, k)) = first {
            return Some((End::of_event(self.domain, self.domain.kinds[k]), s));
        }
        self.remember();
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

    /// The arc length in `[low, high]` at which event `k` becomes positive, by the Illinois method.
    fn crossing(
        &mut self,
        curve: impl Fn(f64) -> (DVec3, DVec3),
        k: usize,
        low: f64,
        high: f64,
    ) -> f64 {
        let mut value = |s: f64| {
            let (u, v) = curve(s);
            self.evaluate(u, v);
            self.registers.output(k)[0]
        };
        let (mut low, mut high) = (low, high);
        let (mut below, mut above) = (value(low).min(-0.0), value(high));
        for round in 0..100 {
            if high - low <= 4.0 * f64::EPSILON * high {
                break;
            }
            // Every fourth round bisects: no shape of event can make it crawl.
            let share = if round % 4 == 3 {
                0.5
            } else {
                (below / (below - above)).clamp(0.0, 1.0)
            };
            let s = low + (high - low) * if share.is_finite() { share } else { 0.5 };
            let v = value(s);
            if v > 0.0 {
                (high, above) = (s, v);
                below *= 0.5;
            } else {
                (low, below) = (s, v.min(-0.0));
                above *= 0.5;
                if v == 0.0 {
                    return s;
                }
            }
        }
        0.5 * (low + high)
    }
}

/// How often a whole path is looked at for events: paths of tables bend over about a hundredth of
/// their length at the least.
const LOOKS: u32 = 256;

/// The first event on a curve s -> (u, v), chart components, for s from 0 to `length`.
pub fn first_event(
    domain: &Domain,
    length: f64,
    curve: impl Fn(f64) -> (DVec3, DVec3),
) -> Option<(End, f64)> {
    if domain.kinds.is_empty() {
        return None;
    }
    let mut finder = EventFinder::new(domain);
    let (u, v) = curve(0.0);
    finder.start(u, v);
    let place = |i: u32| length * f64::from(i) / f64::from(LOOKS);
    (0..LOOKS).find_map(|i| finder.first_between(place(i), place(i + 1), &curve))
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
