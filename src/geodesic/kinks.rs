//! How the deviation of a path jumps where the metric has a kink.
//!
//! In: an accepted [`Step`]. Out: the jumps on it. At a surface `φ(u) = 0` across which the
//! acceleration jumps from `a⁻` to `a⁺`, a neighbour that arrives `−∇φ·δu / ∇φ·v` later bends later by
//! as much: `δv` jumps by `(a⁺ − a⁻) ∇φ·δu / ∇φ·v` (the saltation of a piecewise smooth flow:
//! M. di Bernardo et al., *Piecewise-smooth Dynamical Systems* (2008), ch. 2.5). Position, tangent and
//! frame stay continuous.
//!
//! The integrator makes its steps short where a jump of the acceleration is felt, so what a step does
//! not know of the jump inside it is small; where only higher derivatives jump, `a⁺ − a⁻` is zero.

use super::{Step, crossing};
use crate::{
    expr::{Registers, Tape},
    manifold::{Carried, Manifold},
};
use glam::DVec3;

/// How far on either side of a crossing, as a share of the step, the acceleration is taken: so near
/// that its smooth change between the two points counts for nothing.
const ASIDE: f64 = 1e-6;

/// ... and at least this, as a share of the arc length and of the distance from the chart's origin:
/// rounding in `φ` moves the crossing by 1e-16 to 1e-15 of them, and both points must not lie on one
/// side of it.
const LEAST_ASIDE: f64 = 1e-13;

/// Finds kinks on the steps of single rays.
pub(super) struct Kinks<'m> {
    tape: &'m Tape,
    registers: Registers<f64, 1>,
    flow: &'m Tape,
    flow_registers: Registers<f64, 1>,
}

/// A jump at arc length `at`: `δv` gains `bend (slope·δu)`.
#[derive(Debug, Clone, Copy)]
struct Jump {
    at: f64,
    bend: DVec3,
    slope: DVec3,
}

impl<'m> Kinks<'m> {
    /// `None` for a smooth metric, or when no deviation is carried.
    pub fn new(manifold: &'m Manifold, carried: Carried) -> Option<Self> {
        let tape = manifold.kinks().filter(|_| carried.deviation)?;
        let flow = manifold.flow(Carried::default());
        Some(Self {
            tape,
            registers: tape.registers(),
            flow,
            flow_registers: flow.registers(),
        })
    }

    /// What the two deviations gain by kinks on `step`: (δu, δv) at its end; `None` without kinks.
    pub fn gains(&mut self, step: &Step) -> Option<[(DVec3, DVec3); 2]> {
        let mut gains = [(DVec3::ZERO, DVec3::ZERO); 2];
        let jumps = self.jumps(step);
        for jump in &jumps {
            for (gain, du) in gains.iter_mut().zip(step.deviation(jump.at)?) {
                let bend = jump.bend * jump.slope.dot(du);
                gain.0 += bend * (step.end - jump.at);
                gain.1 += bend;
            }
        }
        (!jumps.is_empty()).then_some(gains)
    }

    /// The jumps on `step`, in order, each surface once.
    fn jumps(&mut self, step: &Step) -> Vec<Jump> {
        let functions = self.tape.outputs() / 4;
        let mut places: Vec<(f64, usize)> = (0..functions)
            .filter_map(|k| Some((self.crossed(k, step)?, k)))
            .collect();
        places.sort_by(|a, b| a.0.total_cmp(&b.0));
        // Two functions may vanish on one surface.
        places.dedup_by(|a, b| (a.0 - b.0).abs() <= 2.0 * aside(step, a.0));
        let jumps = places.into_iter().map(|(s, k)| self.jump(k, step, s));
        jumps
            .filter(|jump| jump.bend.is_finite() && jump.slope.is_finite())
            .collect()
    }

    /// Where function `k` changes its sign on `step`.
    fn crossed(&mut self, k: usize, step: &Step) -> Option<f64> {
        let before = self.value(k, step.position(step.start));
        let after = self.value(k, step.position(step.end));
        // The zero itself belongs to one side only, so that a kink at a step's end counts once.
        if (before > 0.0) == (after > 0.0) {
            return None;
        }
        let sign = if after > 0.0 { 1.0 } else { -1.0 };
        Some(crossing(step.start, step.end, |s| {
            sign * self.value(k, step.position(s))
        }))
    }

    fn value(&mut self, k: usize, u: DVec3) -> f64 {
        self.run(u);
        self.registers.output(4 * k)[0]
    }

    fn run(&mut self, u: DVec3) {
        for c in 0..3 {
            *self.registers.input(c) = [u[c]];
        }
        self.tape.run(&mut self.registers);
    }

    fn jump(&mut self, k: usize, step: &Step, s: f64) -> Jump {
        let (u, v) = (step.position(s), step.tangent(s));
        self.run(u);
        let gradient = [1, 2, 3].map(|c| self.registers.output(4 * k + c)[0]);
        let gradient = DVec3::from_array(gradient);
        let aside = aside(step, s);
        let before = self.acceleration(step.position(s - aside), v);
        let after = self.acceleration(step.position(s + aside), v);
        Jump {
            at: s,
            bend: after - before,
            slope: gradient / gradient.dot(v),
        }
    }

    fn acceleration(&mut self, u: DVec3, v: DVec3) -> DVec3 {
        for c in 0..3 {
            *self.flow_registers.input(c) = [u[c]];
            *self.flow_registers.input(3 + c) = [v[c]];
        }
        self.flow.run(&mut self.flow_registers);
        DVec3::from_array([0, 1, 2].map(|c| self.flow_registers.output(c)[0]))
    }
}

fn aside(step: &Step, s: f64) -> f64 {
    let origin = step.position(s).length() / step.tangent(s).length();
    (ASIDE * (step.end - step.start)).max(LEAST_ASIDE * (s + origin))
}
