//! The states of rays in lanes: rows of numbers, the rates of states, and rays about to be followed.
//!
//! In: an iterator of [`Ray`]s. Out: [`LaneStart`]s, one for each lane that becomes free, with the rates at
//! their starts computed for a block of rays at once; the rates of all lanes at any stage of a step. A [`Row`]
//! has one number for every lane; sums, products and choices work on all lanes at once.
//!
//! Rows of a state: u (3), v (3), then the transported quaternion q (x, y, z, w) if the frame is carried, then
//! (δu, δv) of two deviations if deviation is. Equations: the formulas of [`Manifold::flow`].

use super::{Ray, Settings, domain_events::Events, dormand_prince::FAR_BEYOND};
use crate::manifold::{Manifold, around};
use geofan_expr::{Registers, Tape, Wide, real::Real};
use glam::{DQuat, DVec3};

/// Lanes: four of the widest vectors. With half of them the dispatch of a tape's instructions costs as
/// much as their arithmetic (a quarter more time for a lone bump); with twice as many, registers and
/// stages no longer stay in the first-level cache.
pub(super) const LANES: usize = 32;

/// One number for every lane.
pub(super) type Row = Wide<f64, LANES>;

/// Zero in every lane.
pub(super) const NIL: Row = Wide([0.0; LANES]);

/// `row *= by`
#[inline(always)]
pub(super) fn multiply(row: &mut Row, by: &Row) {
    for l in 0..LANES {
        row[l] *= by[l];
    }
}

/// The three rows of the vector that begins at row `at`.
#[inline(always)]
pub(super) fn vector(rows: &[Row], at: usize) -> [&Row; 3] {
    [&rows[at], &rows[at + 1], &rows[at + 2]]
}

/// Returns the vector that begins at row `at`, in `lane`.
pub(super) fn vector_in<const W: usize>(rows: &[Wide<f64, W>], lane: usize, at: usize) -> DVec3 {
    DVec3::from_array([0, 1, 2].map(|c| rows[at + c][lane]))
}

/// Sets the vector that begins at row `at` of the rows of one ray.
pub(super) fn set_vector(rows: &mut [Wide<f64, 1>], at: usize, value: DVec3) {
    for c in 0..3 {
        rows[at + c][0] = value[c];
    }
}

/// Turns the quaternion that begins at row `at` of the rows of one ray.
pub(super) fn turn_by(rows: &mut [Wide<f64, 1>], at: usize, turn: impl Fn(DQuat) -> DQuat) {
    let carried = DQuat::from_array([0, 1, 2, 3].map(|c| rows[at + c][0]));
    for (c, value) in turn(carried).to_array().into_iter().enumerate() {
        rows[at + c][0] = value;
    }
}

/// `xᵀGx`; metric entries in the order xx, yy, zz, xy, xz, yz.
#[inline(always)]
pub(super) fn norm2(metric: [&[f64; LANES]; 6], [x, y, z]: [&Row; 3]) -> Row {
    let [xx, yy, zz, xy, xz, yz] = metric;
    each(|l| {
        let [a, b, c] = [x[l], y[l], z[l]];
        let mixed = a * b * xy[l] + a * c * xz[l] + b * c * yz[l];
        a * a * xx[l] + b * b * yy[l] + c * c * zz[l] + 2.0 * mixed
    })
}

/// The larger of two numbers; NaN wins, so that a broken estimate is never accepted.
#[inline(always)]
pub(super) fn larger(a: f64, b: f64) -> f64 {
    if (a < b) | b.is_nan() { b } else { a }
}

/// Copies the lanes of `from` where `mask` is 1.
// A vector at a time through local arrays, all of it read first: a choice between two places in
// memory would be a branch for each lane.
#[inline(always)]
pub(super) fn take_where(mask: &Row, from: &[Row], to: &mut [Row]) {
    let (masks, _) = mask.as_chunks::<8>();
    for (from, to) in from.iter().zip(to) {
        let ((from, _), (to, _)) = (from.as_chunks::<8>(), to.as_chunks_mut::<8>());
        for ((mask, new), to) in masks.iter().zip(from).zip(to) {
            let (mask, new, old) = (*mask, *new, *to);
            let mut chosen = old;
            for l in 0..8 {
                chosen[l] = f64::select(mask[l] > 0.0, new[l], old[l]);
            }
            *to = chosen;
        }
    }
}

/// One number for each lane.
#[inline(always)]
pub(super) fn each(f: impl Fn(usize) -> f64) -> Row {
    let mut row = NIL;
    for l in 0..LANES {
        row[l] = f(l);
    }
    row
}

/// `Σ wⱼ kⱼ` of one row of the stages' rates.
#[inline(always)]
pub(super) fn weighted(weights: &[f64], k: &[Vec<Row>], row: usize) -> Row {
    let mut sum = NIL;
    for (&w, k) in weights.iter().zip(k).filter(|(w, _)| **w != 0.0) {
        let k = &k[row];
        for l in 0..LANES {
            sum[l] += w * k[l];
        }
    }
    sum
}

/// Rows of the largest state.
pub(super) const MOST_ROWS: usize = 22;

/// Where the rows of a state are.
#[derive(Debug, Clone, Copy)]
pub(super) struct StateLayout {
    /// The quaternion's first row.
    pub turn: Option<usize>,
    /// The first row of the first deviation.
    pub deviation: Option<usize>,
    /// Number of rows.
    pub rows: usize,
}

impl StateLayout {
    /// The layout for what `settings` carry.
    pub fn of(settings: Settings) -> Self {
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

    /// The state at the start of `ray`; only the first [`StateLayout::rows`] count.
    pub fn start(self, ray: &Ray) -> [f64; MOST_ROWS] {
        let mut state = [0.0; MOST_ROWS];
        state[..3].copy_from_slice(&ray.u.to_array());
        state[3..6].copy_from_slice(&ray.v.to_array());
        if let Some(turn) = self.turn {
            state[turn + 3] = 1.0;
        }
        if let Some(at) = self.deviation {
            state[at + 3..at + 6].copy_from_slice(&ray.spread[0].to_array());
            state[at + 9..at + 12].copy_from_slice(&ray.spread[1].to_array());
        }
        state
    }
}

/// The rates of all rows of `y`.
#[inline(always)]
pub(super) fn rates_at<const W: usize>(
    flow: &Tape,
    registers: &mut Registers<f64, W>,
    layout: StateLayout,
    y: &[Wide<f64, W>],
    rates: &mut [Wide<f64, W>],
) {
    for k in 0..6 {
        *registers.input(k) = *y[k];
    }
    if let Some(at) = layout.deviation {
        for k in 0..12 {
            *registers.input(6 + k) = *y[at + k];
        }
    }
    flow.run_first(registers);
    for k in 0..3 {
        rates[k] = y[3 + k];
        *rates[3 + k] = *registers.output(k);
    }
    let mut output = 3;
    if let Some(at) = layout.turn {
        let turning = [3, 4, 5].map(|k| registers.output(k));
        turn_rates(turning, &y[at..at + 4], &mut rates[at..at + 4]);
        output = 6;
    }
    if let Some(at) = layout.deviation {
        for (column, first) in [(0, at), (1, at + 6)] {
            for k in 0..3 {
                rates[first + k] = y[first + 3 + k];
                *rates[first + 3 + k] = *registers.output(output + 3 * column + k);
            }
        }
    }
}

/// Places of a flow's outputs behind the accelerations.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rest {
    metric: usize,
    /// The first output of the wind, where there is one.
    wind: Option<usize>,
}

impl Rest {
    /// Finds them for the tape `flow` of `manifold`.
    pub fn of(manifold: &Manifold, flow: &Tape) -> Self {
        let end = flow.outputs();
        match manifold.has_wind() {
            true => Self {
                metric: end - 9,
                wind: Some(end - 3),
            },
            false => Self {
                metric: end - 6,
                wind: None,
            },
        }
    }

    /// The metric (xx, yy, zz, xy, xz, yz) for the inputs that all of the flow has been run on.
    #[inline(always)]
    pub fn metric<R: Real, const W: usize>(self, registers: &Registers<R, W>) -> [&[R; W]; 6] {
        [0, 1, 2, 3, 4, 5].map(|i| registers.output(self.metric + i))
    }

    /// Returns whether there is a wind.
    pub fn has_wind(self) -> bool {
        self.wind.is_some()
    }

    /// The wind there.
    #[inline(always)]
    pub fn wind<R: Real, const W: usize>(
        self,
        registers: &Registers<R, W>,
    ) -> Option<[&[R; W]; 3]> {
        let first = self.wind?;
        Some([0, 1, 2].map(|i| registers.output(first + i)))
    }
}

/// `q̇ = ½ (ω, 0) ⊗ q`, components x, y, z, w.
#[inline(always)]
fn turn_rates<const W: usize>(
    omega: [&[f64; W]; 3],
    q: &[Wide<f64, W>],
    rates: &mut [Wide<f64, W>],
) {
    let [a, b, c] = omega;
    let ([x, y, z, w], [dx, dy, dz, dw]) = (q, rates) else {
        return;
    };
    for l in 0..W {
        let [a, b, c] = [0.5 * a[l], 0.5 * b[l], 0.5 * c[l]];
        let [x, y, z, w] = [x[l], y[l], z[l], w[l]];
        dx[l] = a * w + b * z - c * y;
        dy[l] = b * w + c * x - a * z;
        dz[l] = c * w + a * y - b * x;
        dw[l] = -(a * x + b * y + c * z);
    }
}

/// A ray at its start.
#[derive(Debug, Clone, Copy)]
pub(super) struct LaneStart {
    /// Its number among all rays.
    pub ray: usize,
    /// Its column in the block's rows.
    pub column: usize,
    /// Arc length to follow it to.
    pub length: f64,
    /// The first step to try; `None` where the metric allows none.
    pub step: Option<f64>,
    /// Arc length in which it would meet an exit if it were straight in the chart, where that is much less.
    pub straight_end: f64,
}

/// The block of rays that are next.
pub(super) struct Starts<'m> {
    layout: StateLayout,
    flow: &'m Tape,
    rest: Rest,
    pulled_back: bool,
    registers: Registers<f64, LANES>,
    /// (number, ray) of those in the block, and how many have been handed out.
    rays: Vec<(usize, Ray)>,
    taken: usize,
    /// States, their rates, and the events' values.
    pub y: Vec<Row>,
    pub rates: Vec<Row>,
    pub events: Vec<Row>,
    /// Arc lengths at which lines that are straight in the chart meet an exit far before the ray's length is over.
    straight_ends: Row,
    /// Half the tolerance's fifth root: the share of the radius of curvature that a first step is.
    reach: f64,
}

impl<'m> Starts<'m> {
    pub fn new(manifold: &'m Manifold, settings: Settings) -> Self {
        let layout = StateLayout::of(settings);
        let flow = manifold.flow(settings.carried);
        Self {
            layout,
            flow,
            rest: Rest::of(manifold, flow),
            pulled_back: manifold.is_pulled_back(),
            registers: flow.registers(),
            rays: Vec::with_capacity(LANES),
            taken: 0,
            y: vec![NIL; layout.rows],
            rates: vec![NIL; layout.rows],
            events: Vec::new(),
            straight_ends: each(|_| f64::INFINITY),
            reach: 0.5 * Real::pow(settings.tolerance, 0.2),
        }
    }

    /// The next ray; `None` when `rays` has no more.
    pub fn next(
        &mut self,
        rays: &mut impl Iterator<Item = (usize, Ray)>,
        events: Option<&mut Events<'_>>,
    ) -> Option<LaneStart> {
        if self.taken == self.rays.len() {
            self.refill(rays, events);
        }
        let (number, ray) = self.rays.get(self.taken)?;
        self.taken += 1;
        let column = self.taken - 1;
        Some(LaneStart {
            ray: *number,
            column,
            length: ray.length,
            step: self.first_step(column, ray),
            straight_end: self.straight_ends[column],
        })
    }

    fn refill(
        &mut self,
        rays: &mut impl Iterator<Item = (usize, Ray)>,
        events: Option<&mut Events<'_>>,
    ) {
        self.taken = 0;
        self.rays.clear();
        self.rays.extend(rays.take(LANES));
        for (column, (_, ray)) in self.rays.iter().enumerate() {
            for (row, value) in self.y.iter_mut().zip(self.layout.start(ray)) {
                row[column] = value;
            }
        }
        if self.rays.is_empty() {
            return;
        }
        rates_at(
            self.flow,
            &mut self.registers,
            self.layout,
            &self.y,
            &mut self.rates,
        );
        if self.pulled_back {
            self.mend();
        }
        if self.rest.has_wind() {
            self.flow.run_rest(&mut self.registers);
        }
        if let Some(events) = events {
            events.values(&self.y[..6], &mut self.events);
            let lengths = each(|l| self.rays.get(l).map_or(0.0, |(_, ray)| ray.length));
            let start = (&self.y[..6], &self.events[..]);
            self.straight_ends = events.straight_ends(start, &lengths, 1.0 / FAR_BEYOND);
        }
    }

    /// Gives rays that start on the axis of textbook coordinates the rates that those around it tend to.
    fn mend(&mut self) {
        for column in 0..self.rays.len() {
            if self.rates.iter().all(|row| row[column].is_finite()) {
                continue;
            }
            let mut y: Vec<Wide<f64, 1>> = self.y.iter().map(|row| Wide([row[column]])).collect();
            let mut registers = self.flow.registers();
            let mended = around(self.rays[column].1.u, |u| {
                let mut rates = vec![Wide([0.0]); y.len()];
                for k in 0..3 {
                    y[k][0] = u[k];
                }
                rates_at(self.flow, &mut registers, self.layout, &y, &mut rates);
                rates.iter().map(|rate| rate[0]).collect()
            });
            for (row, rate) in self.rates.iter_mut().zip(mended) {
                row[column] = rate;
            }
        }
    }

    fn first_step(&self, column: usize, ray: &Ray) -> Option<f64> {
        let acceleration = DVec3::from_array([3, 4, 5].map(|row| self.rates[row][column]));
        if !acceleration.is_finite() || !ray.v.is_finite() {
            return None;
        }
        // Curvature of the chart line against the chart's unit; the controller corrects the guess.
        let wind = self.rest.wind(&self.registers);
        let wind = wind.map(|wind| DVec3::from_array(wind.map(|w| w[column])));
        // On the axis of textbook coordinates the wind is no number.
        let wind = wind.filter(|wind| wind.is_finite()).unwrap_or_default();
        let speed = (ray.v - wind).length();
        let bend = acceleration.length() / speed.max(f64::MIN_POSITIVE);
        Some(self.reach / bend.max(1.0 / ray.length))
    }
}
