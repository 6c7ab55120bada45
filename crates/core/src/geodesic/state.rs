//! The state of rays, and its rates.
//!
//! Rows: u (3), v (3), then the transported quaternion q (x, y, z, w) if the frame is carried, then
//! (δu, δv) of two deviations if deviation is. Equations: the formulas of [`Manifold::flow`].
//!
//! [`Manifold::flow`]: crate::manifold::Manifold::flow

use super::{Ray, Settings};
use crate::manifold::Manifold;
use geofan_expr::{Registers, Tape, Wide, real::Real};

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
