//! Many geodesics at once: adaptive Dormand–Prince over lanes of rays.
//!
//! In: rays (chart point, unit tangent, length). Out: their [`Step`]s in order and how each ended,
//! given to a [`Sink`]. Every lane has its own step size; a lane whose ray has ended takes the next
//! ray at once, so no lane idles while rays are left. A ray's result does not depend on the lanes
//! beside it.
//!
//! State rows: u (3), v (3), then the transported quaternion q (x, y, z, w) if the frame is
//! carried, then (δu, δv) of two deviations if deviation is. Equations: DESIGN §2.

use super::{
    End, LANES, Ray, Row, Settings, Sink, Step,
    dormand_prince::{A, Dense, ERROR, Quintic, STAGES},
    events::Events,
};
use crate::{
    expr::{Registers, Tape, vectorised},
    manifold::Manifold,
};
use glam::DVec3;

/// Most steps of one ray; more than any honest path needs at the tightest tolerance, few enough that
/// a ray caught in rounding noise ends in a second.
const MOST_STEPS: usize = 200_000;

/// A step below this share of the arc length already followed cannot advance in double precision.
const SHORTEST_STEP: f64 = 1e-13;

/// No step is longer than this share of the ray. Where space is exactly flat (around a lens, far from
/// a bump) the estimate of the error is zero, and steps that only grow leap over what lies ahead
/// without a stage inside it: without a limit, rays missed the whole of a Luneburg lens. What can
/// still be missed is a chord of half a step. At a tolerance of 1e-8 this adds up to a tenth of the
/// steps on most files of `assets/manifolds`, a sixth for a black hole and a half for a lone bump;
/// 1/64 would more than double the steps of the last.
const LONGEST_STEP: f64 = 1.0 / 32.0;

/// A step that cannot be made shorter is taken all the same if its error is below this: that is a
/// kink of the metric, over which the tangent bends by a bounded rate times the step. Where the
/// metric ends, the error is of order one.
const KINK: f64 = 1e-9;

/// Follows all `rays`, telling `sink`.
pub fn follow(
    manifold: &Manifold,
    settings: Settings,
    rays: impl IntoIterator<Item = Ray>,
    sink: &mut impl Sink,
) {
    let mut lanes = Lanes::new(manifold, settings);
    let mut rays = rays.into_iter().enumerate();
    loop {
        lanes.refill(&mut rays, sink);
        if lanes.ray.iter().all(Option::is_none) {
            return;
        }
        vectorised(
            #[inline(always)]
            || lanes.attempt(),
        );
        for lane in 0..LANES {
            if lanes.ray[lane].is_some() {
                lanes.judge(lane, sink);
            }
        }
    }
}

/// Which ray a lane follows, and how far it is.
#[derive(Debug, Clone, Copy)]
struct Progress {
    index: usize,
    length: f64,
    steps: usize,
    rejected: bool,
}

struct Lanes<'m> {
    settings: Settings,
    flow: &'m Tape,
    registers: Registers<f64, LANES>,
    events: Option<Events<'m>>,
    ray: [Option<Progress>; LANES],
    s: Row,
    h: Row,
    /// The present state, the state tried, and the stages' rates.
    y: Vec<Row>,
    trial: Vec<Row>,
    k: [Vec<Row>; STAGES],
    /// Error of the trial relative to the tolerance, and vᵀGv there.
    error: Row,
    speed2: Row,
}

/// Rows of the state.
#[derive(Debug, Clone, Copy)]
struct Layout {
    turn: Option<usize>,
    deviation: Option<usize>,
    rows: usize,
}

impl Layout {
    fn of(settings: Settings) -> Self {
        let turn = settings.carried.frame.then_some(6);
        let after = if turn.is_some() { 10 } else { 6 };
        let deviation = settings.carried.deviation.then_some(after);
        let rows = after + if deviation.is_some() { 12 } else { 0 };
        Self {
            turn,
            deviation,
            rows,
        }
    }
}

impl<'m> Lanes<'m> {
    fn new(manifold: &'m Manifold, settings: Settings) -> Self {
        let flow = manifold.flow(settings.carried);
        let rows = Layout::of(settings).rows;
        Self {
            settings,
            flow,
            registers: flow.registers(),
            events: match settings.events {
                true => Events::new(&manifold.domain),
                false => None,
            },
            ray: [None; LANES],
            s: [0.0; LANES],
            h: [0.0; LANES],
            y: vec![[0.0; LANES]; rows],
            trial: vec![[0.0; LANES]; rows],
            k: std::array::from_fn(|_| vec![[0.0; LANES]; rows]),
            error: [0.0; LANES],
            speed2: [1.0; LANES],
        }
    }

    /// Gives every free lane a ray, if any are left.
    fn refill(&mut self, rays: &mut impl Iterator<Item = (usize, Ray)>, sink: &mut impl Sink) {
        for lane in 0..LANES {
            while self.ray[lane].is_none() {
                let Some((index, ray)) = rays.next() else {
                    break;
                };
                self.start(lane, index, &ray, sink);
            }
        }
    }

    fn start(&mut self, lane: usize, index: usize, ray: &Ray, sink: &mut impl Sink) {
        let layout = Layout::of(self.settings);
        let mut state = [0.0; 22];
        state[..3].copy_from_slice(&ray.u.to_array());
        state[3..6].copy_from_slice(&ray.v.to_array());
        if let Some(turn) = layout.turn {
            state[turn + 3] = 1.0;
        }
        if let Some(at) = layout.deviation {
            state[at + 3..at + 6].copy_from_slice(&ray.spread[0].to_array());
            state[at + 9..at + 12].copy_from_slice(&ray.spread[1].to_array());
        }
        for (row, value) in self.y.iter_mut().zip(state) {
            row[lane] = value;
        }
        if let Some(events) = &mut self.events {
            events.start(lane, ray.u, ray.v);
        }
        self.s[lane] = 0.0;
        let rates = self.first_rates(lane);
        let acceleration = DVec3::new(rates[3], rates[4], rates[5]);
        if !acceleration.is_finite() || !ray.v.is_finite() || ray.length <= 0.0 {
            let end = if ray.length <= 0.0 {
                End::Length
            } else {
                End::Singular
            };
            sink.end(index, end, 0.0, 0);
            return;
        }
        // Curvature of the chart line against the chart's unit; the controller corrects the guess.
        let bend = acceleration.length() / ray.v.length().max(f64::MIN_POSITIVE);
        let guess = 0.5 * self.settings.tolerance.powf(0.2) / bend.max(1.0 / ray.length);
        self.h[lane] = guess.min(LONGEST_STEP * ray.length);
        self.ray[lane] = Some(Progress {
            index,
            length: ray.length,
            steps: 0,
            rejected: false,
        });
    }

    /// Rates at the start of a lane's ray, computed for that lane alone.
    fn first_rates(&mut self, lane: usize) -> [f64; 22] {
        let mut single = self.flow.registers::<f64, 1>();
        let layout = Layout::of(self.settings);
        let state: Vec<[f64; 1]> = self.y.iter().map(|row| [row[lane]]).collect();
        let mut rates = vec![[0.0; 1]; layout.rows];
        rates_at(self.flow, &mut single, layout, &state, &mut rates);
        let mut found = [0.0; 22];
        for (row, (slot, rate)) in self.k[0].iter_mut().zip(found.iter_mut().zip(&rates)) {
            row[lane] = rate[0];
            *slot = rate[0];
        }
        found
    }

    /// One trial step of every lane: stages, new state, error estimate. Lanes without a ray compute
    /// what is left in them; nobody looks at it.
    #[inline(always)]
    fn attempt(&mut self) {
        let layout = Layout::of(self.settings);
        for (stage, weights) in A.iter().enumerate() {
            for row in 0..layout.rows {
                let mut sum = [0.0; LANES];
                for j in 0..=stage {
                    let (w, k) = (weights[j], &self.k[j][row]);
                    for l in 0..LANES {
                        sum[l] += w * k[l];
                    }
                }
                for l in 0..LANES {
                    self.trial[row][l] = self.y[row][l] + self.h[l] * sum[l];
                }
            }
            let (_, k) = self.k.split_at_mut(stage + 1);
            rates_at(
                self.flow,
                &mut self.registers,
                layout,
                &self.trial,
                &mut k[0],
            );
        }
        self.measure(layout);
        self.look();
    }

    /// Evaluates the events in the middle of the trial steps (on the quintic) and at their ends.
    #[inline(always)]
    fn look(&mut self) {
        let Some(events) = &mut self.events else {
            return;
        };
        let (y, k, last) = (&self.y, &self.k[0], &self.k[STAGES - 1]);
        let mut middle = [[0.0; LANES]; 6];
        for c in 0..3 {
            for l in 0..LANES {
                let h = self.h[l];
                let (u0, u1) = (y[c][l], self.trial[c][l]);
                let (v0, v1) = (y[3 + c][l], self.trial[3 + c][l]);
                let (a0, a1) = (k[3 + c][l], last[3 + c][l]);
                middle[c][l] =
                    0.5 * (u0 + u1) + h * ((v0 - v1) * (5.0 / 32.0) + h * (a0 + a1) / 64.0);
                middle[3 + c][l] =
                    (u1 - u0) / h * 1.875 - (v0 + v1) * 0.4375 + h * (a1 - a0) / 32.0;
            }
        }
        events.look(middle, std::array::from_fn(|c| self.trial[c]));
    }

    /// The error of the trial in units of the tolerance, in the metric at the trial's end: an angle
    /// for the tangent and the frame, position over arc length for the point, and the same relative
    /// to their size for deviations.
    #[inline(always)]
    fn measure(&mut self, layout: Layout) {
        let metric: [Row; 6] = std::array::from_fn(|i| *self.registers.output(3 + i));
        let norm2 = |x: [Row; 3]| -> Row {
            std::array::from_fn(|l| {
                let [a, b, c] = [x[0][l], x[1][l], x[2][l]];
                a * a * metric[0][l]
                    + b * b * metric[1][l]
                    + c * c * metric[2][l]
                    + 2.0 * (a * b * metric[3][l] + a * c * metric[4][l] + b * c * metric[5][l])
            })
        };
        let error = |row: usize| -> Row {
            let mut sum = [0.0; LANES];
            for (w, k) in ERROR.iter().zip(&self.k) {
                for l in 0..LANES {
                    sum[l] += w * k[row][l];
                }
            }
            std::array::from_fn(|l| sum[l] * self.h[l])
        };
        let vector = |at: usize| [error(at), error(at + 1), error(at + 2)];
        let value = |at: usize| [self.trial[at], self.trial[at + 1], self.trial[at + 2]];
        let (point, tangent) = (norm2(vector(0)), norm2(vector(3)));
        self.speed2 = norm2(value(3));
        let scale: Row = std::array::from_fn(|l| 1.0 / (self.s[l] + self.h[l]));
        let mut worst: Row =
            std::array::from_fn(|l| larger(point[l] * scale[l] * scale[l], tangent[l]));
        if let Some(at) = layout.turn {
            for row in at..at + 4 {
                let e = error(row);
                worst = std::array::from_fn(|l| larger(worst[l], e[l] * e[l]));
            }
        }
        if let Some(at) = layout.deviation {
            for column in [at, at + 6] {
                let (du, dv) = (norm2(vector(column)), norm2(vector(column + 3)));
                let size = norm2(value(column + 3));
                for l in 0..LANES {
                    let e = larger(du[l] * scale[l] * scale[l], dv[l]);
                    worst[l] = larger(worst[l], e / larger(1.0, size[l]));
                }
            }
        }
        let tolerance = self.settings.tolerance;
        self.error = std::array::from_fn(|l| worst[l].sqrt() / tolerance);
    }

    /// Accepts or rejects the trial of `lane`, and chooses the next step.
    fn judge(&mut self, lane: usize, sink: &mut impl Sink) {
        let Some(mut progress) = self.ray[lane] else {
            return;
        };
        let (error, h) = (self.error[lane], self.h[lane]);
        progress.steps += 1;
        let shortest = h <= 8.0 * SHORTEST_STEP * self.s[lane];
        let kink = shortest && error * self.settings.tolerance <= KINK;
        let accepted = (error <= 1.0 || kink) && self.speed2[lane] > 0.0;
        let most = if progress.rejected { 1.0 } else { 5.0 };
        let factor = if error.is_finite() {
            (0.9 * error.max(1e-10).powf(-0.2)).clamp(0.2, most)
        } else {
            0.2
        };
        progress.rejected = !accepted;
        let mut end = None;
        if accepted {
            end = self.accept(lane, progress, sink);
        }
        let s = self.s[lane];
        let left = progress.length - s;
        let next = match accepted {
            // Past a kink the error tells nothing about the next step.
            true if kink => 5.0 * h,
            true => factor * h,
            false => factor.min(0.9) * h,
        };
        // What is left may be shorter than the shortest step, and is no sign of trouble.
        self.h[lane] = next.min(LONGEST_STEP * progress.length).min(left);
        if end.is_none()
            && (next <= SHORTEST_STEP * s
                || next < f64::MIN_POSITIVE
                || progress.steps >= MOST_STEPS)
        {
            end = Some((End::Singular, s));
        }
        self.ray[lane] = Some(progress);
        if let Some((end, s)) = end {
            sink.end(progress.index, end, s, progress.steps);
            self.ray[lane] = None;
        }
    }

    /// Hands the accepted step on and makes its end the present state. Returns how and where the
    /// ray ended, if it did.
    fn accept(
        &mut self,
        lane: usize,
        progress: Progress,
        sink: &mut impl Sink,
    ) -> Option<(End, f64)> {
        self.restore_speed(lane);
        let mut step = self.step(lane);
        let end_of_step = step.end;
        let event = self.events.as_mut().and_then(|e| e.first_in(lane, &step));
        if let Some((_, s)) = event {
            step.end = s;
        }
        // The last step ends at the length asked for, not a rounding error beside it.
        let last = event.is_none() && end_of_step >= progress.length * (1.0 - 1e-15);
        if last {
            step.end = progress.length;
        }
        if step.end > step.start {
            sink.step(progress.index, &step);
        }
        for row in 0..self.y.len() {
            self.y[row][lane] = self.trial[row][lane];
            self.k[0][row][lane] = self.k[STAGES - 1][row][lane];
        }
        self.s[lane] = step.end.max(end_of_step);
        let given_up = || (!sink.wants_more(progress.index)).then_some((End::Length, step.end));
        event
            .or(last.then_some((End::Length, progress.length)))
            .or_else(given_up)
    }

    /// Scales the new tangent to unit length; the acceleration is quadratic and the turning rate
    /// linear in it, so the rates at the new point follow without another evaluation.
    fn restore_speed(&mut self, lane: usize) {
        let layout = Layout::of(self.settings);
        let scale = 1.0 / self.speed2[lane].sqrt();
        let rates = &mut self.k[STAGES - 1];
        for k in 0..3 {
            self.trial[3 + k][lane] *= scale;
            rates[k][lane] *= scale;
            rates[3 + k][lane] *= scale * scale;
        }
        if let Some(turn) = layout.turn {
            let q: [f64; 4] = std::array::from_fn(|c| self.trial[turn + c][lane]);
            let unit = 1.0 / q.iter().map(|x| x * x).sum::<f64>().sqrt();
            for c in 0..4 {
                self.trial[turn + c][lane] *= unit;
                rates[turn + c][lane] *= unit * scale;
            }
        }
    }

    /// The trial as a curve.
    fn step(&self, lane: usize) -> Step {
        let layout = Layout::of(self.settings);
        let h = self.h[lane];
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
        let turn = layout.turn.map(|at| {
            let four = |rows: &[Row]| std::array::from_fn(|c| rows[at + c][lane]);
            let k = std::array::from_fn(|i| four(&self.k[i]));
            Dense::new(four(&self.y), four(&self.trial), h, k)
        });
        Step {
            start: self.s[lane],
            end: self.s[lane] + h,
            h,
            curve: quintic(0),
            turn,
            deviation: layout.deviation.map(|at| [quintic(at), quintic(at + 6)]),
        }
    }
}

/// The larger of two numbers; NaN wins, so that a broken estimate is never accepted.
#[inline(always)]
fn larger(a: f64, b: f64) -> f64 {
    if a < b || b.is_nan() { b } else { a }
}

/// The rates of all rows of `y`.
#[inline(always)]
fn rates_at<const W: usize>(
    flow: &Tape,
    registers: &mut Registers<f64, W>,
    layout: Layout,
    y: &[[f64; W]],
    rates: &mut [[f64; W]],
) {
    for k in 0..6 {
        *registers.input(k) = y[k];
    }
    if let Some(at) = layout.deviation {
        for k in 0..12 {
            *registers.input(6 + k) = y[at + k];
        }
    }
    flow.run(registers);
    for k in 0..3 {
        rates[k] = y[3 + k];
        rates[3 + k] = *registers.output(k);
    }
    let mut output = 9;
    if let Some(at) = layout.turn {
        let turning = [9, 10, 11].map(|k| *registers.output(k));
        turn_rates(turning, &y[at..at + 4], &mut rates[at..at + 4]);
        output = 12;
    }
    if let Some(at) = layout.deviation {
        for (column, first) in [(0, at), (1, at + 6)] {
            for k in 0..3 {
                rates[first + k] = y[first + 3 + k];
                rates[first + 3 + k] = *registers.output(output + 3 * column + k);
            }
        }
    }
}

/// `q̇ = ½ (ω, 0) ⊗ q`, components x, y, z, w.
#[inline(always)]
fn turn_rates<const W: usize>(omega: [[f64; W]; 3], q: &[[f64; W]], rates: &mut [[f64; W]]) {
    for l in 0..W {
        let [a, b, c] = [0.5 * omega[0][l], 0.5 * omega[1][l], 0.5 * omega[2][l]];
        let [x, y, z, w] = [q[0][l], q[1][l], q[2][l], q[3][l]];
        rates[0][l] = a * w + b * z - c * y;
        rates[1][l] = b * w + c * x - a * z;
        rates[2][l] = c * w + a * y - b * x;
        rates[3][l] = -(a * x + b * y + c * z);
    }
}
