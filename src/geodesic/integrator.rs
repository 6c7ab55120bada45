//! Many geodesics at once: adaptive Dormand–Prince over lanes of rays.
//!
//! In: rays (chart point, unit tangent, length). Out: their [`Step`]s in order and how each ended,
//! given to a [`Sink`]. Every lane has its own step size; a lane whose ray has ended takes the next
//! ray at once, so no lane idles while rays are left. A ray's result does not depend on the lanes
//! beside it, and nothing is allocated once the lanes are set up.

use super::{
    End, LANES, NIL, Ray, Row, Settings, Sink, Step, Takes,
    control::Control,
    dormand_prince::{A, Dense, ERROR, Quintic, STAGES},
    events::Events,
    starts::{Start, Starts},
    state::{Layout, rates_at},
};
use crate::{
    expr::{Registers, Tape, vectorised},
    manifold::Manifold,
};
use glam::DVec3;

/// Follows all `rays`, telling `sink`.
pub fn follow<S: Sink>(
    manifold: &Manifold,
    settings: Settings,
    rays: impl IntoIterator<Item = Ray>,
    sink: &mut S,
) {
    let mut lanes = Lanes::new(manifold, settings);
    let mut rays = rays.into_iter().enumerate();
    loop {
        lanes.refill(&mut rays, sink);
        if lanes.ray.iter().all(Option::is_none) {
            return;
        }
        lanes.attempt();
        lanes.report(sink);
        lanes.commit();
    }
}

struct Lanes<'m> {
    layout: Layout,
    flow: &'m Tape,
    registers: Registers<f64, LANES>,
    events: Option<Events<'m>>,
    starts: Starts<'m>,
    /// The number of the ray that a lane follows.
    ray: [Option<usize>; LANES],
    control: Control,
    /// The present state, the state tried, and the stages' rates.
    y: Vec<Row>,
    trial: Vec<Row>,
    k: [Vec<Row>; STAGES],
}

impl<'m> Lanes<'m> {
    fn new(manifold: &'m Manifold, settings: Settings) -> Self {
        let flow = manifold.flow(settings.carried);
        let layout = Layout::of(settings);
        let rows = || vec![NIL; layout.rows];
        Self {
            layout,
            flow,
            registers: flow.registers(),
            events: match settings.events {
                true => Events::new(&manifold.domain),
                false => None,
            },
            starts: Starts::new(flow, settings),
            ray: [None; LANES],
            control: Control::new(settings.tolerance),
            y: rows(),
            trial: rows(),
            k: std::array::from_fn(|_| rows()),
        }
    }

    /// Gives every free lane a ray, if any are left.
    fn refill(&mut self, rays: &mut impl Iterator<Item = (usize, Ray)>, sink: &mut impl Sink) {
        for lane in 0..LANES {
            while self.ray[lane].is_none() {
                let Some(start) = self.starts.next(rays, self.events.as_mut()) else {
                    return;
                };
                match start.step {
                    _ if start.length <= 0.0 => sink.end(start.ray, End::Length, 0.0, 0),
                    None => sink.end(start.ray, End::Singular, 0.0, 0),
                    Some(step) => self.start(lane, &start, step),
                }
            }
        }
    }

    fn start(&mut self, lane: usize, start: &Start, step: f64) {
        self.ray[lane] = Some(start.ray);
        self.control.start(lane, start.length, step);
        for row in 0..self.layout.rows {
            self.y[row][lane] = self.starts.y[row][start.column];
            self.k[0][row][lane] = self.starts.rates[row][start.column];
        }
        if let Some(events) = &mut self.events {
            events.start(lane, &self.starts.events, start.column);
        }
    }

    /// One trial step of every lane: stages, new state, error, judgement. Lanes without a ray compute
    /// what is left in them; nobody looks at it.
    fn attempt(&mut self) {
        for stage in 1..STAGES {
            vectorised(
                #[inline(always)]
                || self.advance(stage),
            );
            let (_, k) = self.k.split_at_mut(stage);
            rates_at(
                self.flow,
                &mut self.registers,
                self.layout,
                &self.trial,
                &mut k[0],
            );
        }
        vectorised(
            #[inline(always)]
            || {
                self.measure();
                self.restore_speed();
                self.control.judge();
            },
        );
        if self.events.is_some() {
            vectorised(
                #[inline(always)]
                || self.look(),
            );
        }
    }

    /// The state at which stage `stage` is evaluated; that of the last is the trial's end.
    #[inline(always)]
    fn advance(&mut self, stage: usize) {
        let weights = &A[stage - 1][..stage];
        for row in 0..self.layout.rows {
            let mut sum = [0.0; LANES];
            for (w, k) in weights.iter().zip(&self.k) {
                for l in 0..LANES {
                    sum[l] += w * k[row][l];
                }
            }
            for l in 0..LANES {
                self.trial[row][l] = self.y[row][l] + self.control.h[l] * sum[l];
            }
        }
    }

    /// Evaluates the events in the middle of the trial steps (on the quintic) and at their ends.
    #[inline(always)]
    fn look(&mut self) {
        let Some(events) = &mut self.events else {
            return;
        };
        let (y, k, last) = (&self.y, &self.k[0], &self.k[STAGES - 1]);
        let mut middle = [NIL; 6];
        for c in 0..3 {
            for l in 0..LANES {
                let h = self.control.h[l];
                let (u0, u1) = (y[c][l], self.trial[c][l]);
                let (v0, v1) = (y[3 + c][l], self.trial[3 + c][l]);
                let (a0, a1) = (k[3 + c][l], last[3 + c][l]);
                middle[c][l] =
                    0.5 * (u0 + u1) + h * ((v0 - v1) * (5.0 / 32.0) + h * (a0 + a1) / 64.0);
                middle[3 + c][l] =
                    (u1 - u0) / h * 1.875 - (v0 + v1) * 0.4375 + h * (a1 - a0) / 32.0;
            }
        }
        events.look(&middle, &self.trial[..6]);
    }

    /// The error of the trial in the metric at the trial's end: an angle for the tangent and the
    /// frame, position over arc length for the point, and the same relative to their size for
    /// deviations.
    #[inline(always)]
    fn measure(&mut self) {
        let metric = [3, 4, 5, 6, 7, 8].map(|i| self.registers.output(i));
        let h = self.control.h;
        let error = |row: usize| {
            let mut sum = NIL;
            for (w, k) in ERROR.iter().zip(&self.k) {
                for l in 0..LANES {
                    sum[l] += w * k[row][l];
                }
            }
            for l in 0..LANES {
                sum[l] *= h[l];
            }
            sum
        };
        let vector = |at: usize| [error(at), error(at + 1), error(at + 2)];
        let value = |at: usize| [self.trial[at], self.trial[at + 1], self.trial[at + 2]];
        let (point, tangent) = (norm2(metric, &vector(0)), norm2(metric, &vector(3)));
        let mut inverse2 = NIL;
        let mut worst = NIL;
        for l in 0..LANES {
            let inverse = 1.0 / (self.control.s[l] + h[l]);
            inverse2[l] = inverse * inverse;
            worst[l] = larger(point[l] * inverse2[l], tangent[l]);
        }
        if let Some(at) = self.layout.turn {
            for row in at..at + 4 {
                let e = error(row);
                for l in 0..LANES {
                    worst[l] = larger(worst[l], e[l] * e[l]);
                }
            }
        }
        if let Some(at) = self.layout.deviation {
            for column in [at, at + 6] {
                let (du, dv) = (
                    norm2(metric, &vector(column)),
                    norm2(metric, &vector(column + 3)),
                );
                let size = norm2(metric, &value(column + 3));
                for l in 0..LANES {
                    let e = larger(du[l] * inverse2[l], dv[l]);
                    worst[l] = larger(worst[l], e / larger(1.0, size[l]));
                }
            }
        }
        self.control.speed2 = norm2(metric, &value(3));
        self.control.error2 = worst;
    }

    /// Scales the new tangent to unit length; the acceleration is quadratic and the turning rate
    /// linear in it, so the rates at the new point follow without another evaluation.
    #[inline(always)]
    fn restore_speed(&mut self) {
        let rates = &mut self.k[STAGES - 1];
        let mut scale = NIL;
        for l in 0..LANES {
            scale[l] = 1.0 / self.control.speed2[l].sqrt();
        }
        for c in 0..3 {
            for l in 0..LANES {
                self.trial[3 + c][l] *= scale[l];
                rates[c][l] *= scale[l];
                rates[3 + c][l] *= scale[l] * scale[l];
            }
        }
        if let Some(turn) = self.layout.turn {
            let mut unit = NIL;
            for c in 0..4 {
                for l in 0..LANES {
                    unit[l] += self.trial[turn + c][l] * self.trial[turn + c][l];
                }
            }
            for l in 0..LANES {
                unit[l] = 1.0 / unit[l].sqrt();
            }
            for c in 0..4 {
                for l in 0..LANES {
                    self.trial[turn + c][l] *= unit[l];
                    rates[turn + c][l] *= unit[l] * scale[l];
                }
            }
        }
    }

    /// Hands on the accepted steps that `sink` takes, and ends rays.
    fn report<S: Sink>(&mut self, sink: &mut S) {
        for lane in 0..LANES {
            let Some(ray) = self.ray[lane] else {
                continue;
            };
            let accepted = self.control.accepted[lane] > 0.0;
            let complete = self.control.complete[lane] > 0.0;
            let over = complete || self.control.stuck[lane] > 0.0;
            let met = accepted && self.events.as_ref().is_some_and(|e| e.met(lane));
            let taken = accepted && S::TAKES == Takes::EveryStep;
            if !(taken || over || met) {
                continue;
            }
            let mut step = if accepted { self.step(lane) } else { self.rest(lane) };
            let event = match met {
                true => self.events.as_mut().and_then(|e| e.first_in(lane, &step)),
                false => None,
            };
            // The last step ends at the length asked for, not a rounding error beside it.
            let end = match event {
                Some((end, s)) => Some((end, s)),
                None if complete => Some((End::Length, self.control.length[lane])),
                None if over => Some((End::Singular, step.end)),
                None => None,
            };
            if let Some((_, s)) = end {
                step.end = s;
            }
            let last = end.is_some() && S::TAKES == Takes::LastStep && step.end > 0.0;
            if last || (taken && step.end > step.start) {
                sink.step(ray, &step);
            }
            if let Some((end, s)) = end {
                sink.end(ray, end, s, self.control.steps[lane] as usize);
                self.ray[lane] = None;
            }
        }
    }

    /// Makes the ends of accepted trials the present states.
    fn commit(&mut self) {
        vectorised(
            #[inline(always)]
            || {
                let accepted = &self.control.accepted;
                let (first, rest) = self.k.split_at_mut(1);
                take_where(accepted, &self.trial, &mut self.y);
                take_where(accepted, &rest[STAGES - 2], &mut first[0]);
                if let Some(events) = &mut self.events {
                    events.commit(accepted);
                }
                self.control.commit();
            },
        );
    }

    /// The trial as a curve.
    fn step(&self, lane: usize) -> Step {
        let h = self.control.h[lane];
        let vector = |rows: &[Row], at: usize| {
            DVec3::new(rows[at][lane], rows[at + 1][lane], rows[at + 2][lane])
        };
        let (first, last) = (&self.k[0], &self.k[STAGES - 1]);
        let quintic = |at: usize| {
            Quintic::new(
                [
                    vector(&self.y, at),
                    vector(&self.y, at + 3),
                    vector(first, at + 3),
                ],
                [
                    vector(&self.trial, at),
                    vector(&self.trial, at + 3),
                    vector(last, at + 3),
                ],
                h,
            )
        };
        let turn = self.layout.turn.map(|at| {
            let four = |rows: &[Row]| std::array::from_fn(|c| rows[at + c][lane]);
            let k = std::array::from_fn(|i| four(&self.k[i]));
            Dense::new(four(&self.y), four(&self.trial), h, k)
        });
        let start = self.control.s[lane];
        Step {
            start,
            end: start + h,
            h,
            curve: quintic(0),
            turn,
            deviation: self.layout.deviation.map(|at| [quintic(at), quintic(at + 6)]),
        }
    }

    /// The present state as a step of no length.
    fn rest(&self, lane: usize) -> Step {
        let vector = |at: usize| {
            DVec3::new(self.y[at][lane], self.y[at + 1][lane], self.y[at + 2][lane])
        };
        let still = |at: usize| Quintic::straight(vector(at), vector(at + 3));
        let s = self.control.s[lane];
        Step {
            start: s,
            end: s,
            h: 1.0,
            curve: still(0),
            turn: self
                .layout
                .turn
                .map(|at| Dense::still(std::array::from_fn(|c| self.y[at + c][lane]))),
            deviation: self.layout.deviation.map(|at| [still(at), still(at + 6)]),
        }
    }
}

/// `xᵀGx`; metric entries in the order xx, yy, zz, xy, xz, yz.
#[inline(always)]
fn norm2(metric: [&[f64; LANES]; 6], x: &[Row; 3]) -> Row {
    let mut norm2 = NIL;
    for l in 0..LANES {
        let [a, b, c] = [x[0][l], x[1][l], x[2][l]];
        let mixed = a * b * metric[3][l] + a * c * metric[4][l] + b * c * metric[5][l];
        norm2[l] = a * a * metric[0][l] + b * b * metric[1][l] + c * c * metric[2][l] + 2.0 * mixed;
    }
    norm2
}

/// The larger of two numbers; NaN wins, so that a broken estimate is never accepted.
#[inline(always)]
fn larger(a: f64, b: f64) -> f64 {
    if (a < b) | b.is_nan() { b } else { a }
}

/// Copies the lanes of `from` where `mask` is 1.
#[inline(always)]
pub(super) fn take_where(mask: &Row, from: &[Row], to: &mut [Row]) {
    for (from, to) in from.iter().zip(to) {
        for l in 0..LANES {
            to[l] = if mask[l] > 0.0 { from[l] } else { to[l] };
        }
    }
}
