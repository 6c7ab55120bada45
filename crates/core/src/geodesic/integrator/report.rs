//! What becomes of trial steps: which are handed on, and where rays end.

use super::{
    super::{
        End, LANES, Sink, Step,
        dormand_prince::{Dense, Quintic},
    },
    RayLanes,
};
use geofan_expr::vectorised;
use glam::DVec3;

impl RayLanes<'_> {
    /// Hands on the accepted steps that `sink` wants, and ends rays.
    pub(super) fn report(&mut self, sink: &mut impl Sink) {
        let mut carried_made = false;
        for lane in 0..LANES {
            let Some(ray) = self.ray[lane] else {
                continue;
            };
            let accepted = self.control.accepted[lane] > 0.0;
            if accepted && self.control.try_before_exit(lane) {
                continue;
            }
            let complete = self.control.complete[lane] > 0.0;
            let over = complete || self.control.stuck[lane] > 0.0;
            let met = accepted && self.events.as_ref().is_some_and(|e| e.may_be_met(lane));
            let to = self.control.s[lane] + self.control.h[lane];
            let wanted = accepted && self.near[lane] > 0.0 && sink.wants(ray, to);
            let surfaces = self.surfaces.as_mut().filter(|_| accepted);
            let edge = surfaces.and_then(|surfaces| surfaces.take_edge(lane));
            if !(wanted || over || met) {
                continue;
            }
            let mut step = self.step_of(lane, (accepted, over || met), (sink, &mut carried_made));
            step.edge = edge;
            if let Some(faces) = &self.faces {
                faces.mark(lane, &mut step);
            }
            let event = match met {
                true => self.events.as_mut().and_then(|e| e.first_in(lane, &step)),
                false => None,
            };
            if let Some((_, s)) = event
                && self.control.try_nearer(lane, s)
            {
                if let Some(surfaces) = &mut self.surfaces {
                    surfaces.keep_edge(lane, edge);
                }
                continue;
            }
            let end = match event {
                Some(met) => Some(met),
                None => over.then(|| self.natural_end(lane, complete, &step)),
            };
            if let Some((_, s)) = end {
                step.end = s;
            }
            if end.is_some() && step.end > 0.0 || wanted && step.end > step.start {
                sink.step(ray, &step);
            }
            let given_up = || (!sink.wants_more(ray)).then_some((End::Length, step.end));
            if let Some((end, s)) = end.or_else(given_up) {
                sink.end(ray, end, s, self.control.steps[lane] as usize);
                self.ray[lane] = None;
                self.control.stop(lane);
            }
        }
    }

    /// Where a ray ends that meets no exit: at the length asked for, not a rounding error beside it, or
    /// where the metric does.
    #[inline(always)]
    fn natural_end(&self, lane: usize, complete: bool, step: &Step) -> (End, f64) {
        match complete {
            true => (End::Length, self.control.length[lane]),
            false => (End::Singular, step.end),
        }
    }

    /// The trial of a lane if it was `accepted`, with what it carries if `sink` wants that or the ray may
    /// end in it (`last`); else where the ray is.
    #[inline(always)]
    fn step_of(
        &mut self,
        lane: usize,
        (accepted, last): (bool, bool),
        (sink, carried_made): (&mut impl Sink, &mut bool),
    ) -> Step {
        match accepted {
            false => self.rest(lane),
            true if sink.wants_carried() => {
                if !*carried_made {
                    *carried_made = true;
                    self.make_carried();
                }
                let (s, h) = (self.control.s[lane], self.control.h[lane]);
                self.curves.step(lane, s, h)
            }
            true => self.lone_step(lane, last),
        }
    }

    /// Makes the curves of what all trials carry.
    fn make_carried(&mut self) {
        vectorised(
            #[inline(always)]
            || {
                let (curves, trial) = self.trial();
                curves.make_carried(trial);
            },
        );
    }

    /// The trial of one lane, with what it carries if that is `carried` for it alone.
    fn lone_step(&mut self, lane: usize, carried: bool) -> Step {
        let (s, h) = (self.control.s[lane], self.control.h[lane]);
        let (curves, trial) = self.trial();
        match carried {
            true => curves.lone_step(trial, lane, s),
            false => curves.path(lane, s, h),
        }
    }

    /// The present state as a step of no length.
    fn rest(&self, lane: usize) -> Step {
        let vector =
            |at: usize| DVec3::new(self.y[at][lane], self.y[at + 1][lane], self.y[at + 2][lane]);
        let still = |at: usize| Quintic::straight(vector(at), vector(at + 3));
        let s = self.control.s[lane];
        Step {
            start: s,
            end: s,
            edge: None,
            h: 1.0,
            curve: still(0),
            turn: self
                .layout
                .turn
                .map(|at| Dense::still(std::array::from_fn(|c| self.y[at + c][lane]))),
            deviation: self.layout.deviation.map(|at| [still(at), still(at + 6)]),
            crossings: 0,
            reversed: false,
        }
    }
}
