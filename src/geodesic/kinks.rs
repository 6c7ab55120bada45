//! Where the metric has a kink: steps end there, and the deviation of the path jumps.
//!
//! In: a trial [`Step`]. Out: the [`Meeting`] with a kink on it, and what the deviations gain by it
//! ([`Kinks::gains`]).
//!
//! At a surface `φ(u) = 0` across which the acceleration jumps from `a⁻` to `a⁺`, a neighbour that
//! arrives `−∇φ·δu / ∇φ·v` later bends later by as much: `δv` jumps by
//! `(a⁺ − a⁻) ∇φ·δu / ∇φ·v` (the saltation of a piecewise smooth flow: M. di Bernardo et al.,
//! *Piecewise-smooth Dynamical Systems* (2008), ch. 2.5). Position, tangent and frame stay continuous.

use super::{Step, crossing};
use crate::{
    expr::{Registers, Tape},
    manifold::{Carried, Manifold},
};
use glam::DVec3;

/// How near a kink a step ends, and half the length of a step that crosses one, as a share of the arc
/// length and of the distance from the chart's origin. Rounding in `φ` moves the crossing by 1e-16 to
/// 1e-15 of them, and both ends must not lie on one side of it; what the crossing step gets wrong is
/// this share of the jump.
const ASIDE: f64 = 1e-13;

/// A path that meets a surface at a smaller angle than this runs along it, and rounding decides on
/// which side; nothing can be said about a jump then, and no step is made shorter.
const GRAZING: f64 = 1e-7;

/// Finds kinks on the steps of single rays.
pub(super) struct Kinks<'m> {
    tape: &'m Tape,
    registers: Registers<f64, 1>,
    flow: &'m Tape,
    flow_registers: Registers<f64, 1>,
}

/// How a trial step meets a kink.
#[derive(Debug, Clone, Copy)]
pub(super) enum Meeting {
    /// The step is too long to cross it; it should have this length, which ends just before the kink
    /// or just crosses it.
    Ahead(f64),
    /// The step crosses it, and is short enough to.
    Here,
}

/// A surface `φ = 0` at a point.
#[derive(Debug, Clone, Copy)]
struct Surface {
    value: f64,
    gradient: DVec3,
}

impl<'m> Kinks<'m> {
    /// `None` for a smooth metric.
    pub fn new(manifold: &'m Manifold) -> Option<Self> {
        let tape = manifold.kinks()?;
        let flow = manifold.flow(Carried::default());
        Some(Self {
            tape,
            registers: tape.registers(),
            flow,
            flow_registers: flow.registers(),
        })
    }

    /// The first kink on the trial `step`, if there is one.
    pub fn meeting(&mut self, step: &Step) -> Option<Meeting> {
        let (at, _) = self.first(step)?;
        let aside = aside(step, at);
        let crosses = 2.0 * aside;
        let before = at - step.start - aside;
        Some(match step.end - step.start {
            // Rounding may make the crossing step a little longer.
            length if length <= 1.5 * crosses => Meeting::Here,
            _ if before > aside => Meeting::Ahead(before),
            _ => Meeting::Ahead(crosses),
        })
    }

    /// What the two deviations gain by the first kink on `step`: (δu, δv) at its end.
    pub fn gains(&mut self, step: &Step) -> Option<[(DVec3, DVec3); 2]> {
        let (at, surface) = self.first(step)?;
        let bend = self.jump(step, at);
        let v = step.tangent(at);
        let gain = |du: DVec3| {
            let dv = bend * (surface.gradient.dot(du) / surface.gradient.dot(v));
            (dv * (step.end - at), dv)
        };
        Some(step.deviation(at)?.map(gain))
    }

    /// The first arc length on `step` at which a surface is crossed, and the surface.
    fn first(&mut self, step: &Step) -> Option<(f64, Surface)> {
        let functions = self.tape.outputs() / 4;
        let crossed = (0..functions).filter_map(|k| Some((self.crossed(k, step)?, k)));
        let (at, k) = crossed.min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some((at, self.surface(k, step.position(at))))
    }

    /// Where surface `k` is crossed on `step`.
    fn crossed(&mut self, k: usize, step: &Step) -> Option<f64> {
        let before = self.surface(k, step.position(step.start));
        let after = self.surface(k, step.position(step.end));
        // The zero itself belongs to one side only, so that a kink at a step's end counts once.
        if (before.value > 0.0) == (after.value > 0.0) {
            return None;
        }
        let way = (step.position(step.end) - step.position(step.start)).length();
        let reach = way * after.gradient.length().max(before.gradient.length());
        if before.value.abs().max(after.value.abs()) < GRAZING * reach {
            return None;
        }
        let sign = if after.value > 0.0 { 1.0 } else { -1.0 };
        Some(crossing(step.start, step.end, |s| {
            sign * self.surface(k, step.position(s)).value
        }))
    }

    fn surface(&mut self, k: usize, u: DVec3) -> Surface {
        for c in 0..3 {
            *self.registers.input(c) = [u[c]];
        }
        self.tape.run(&mut self.registers);
        let output = |c: usize| self.registers.output(4 * k + c)[0];
        Surface {
            value: output(0),
            gradient: DVec3::new(output(1), output(2), output(3)),
        }
    }

    /// `a⁺ − a⁻` at `at`.
    fn jump(&mut self, step: &Step, at: f64) -> DVec3 {
        let v = step.tangent(at);
        let aside = aside(step, at);
        let before = self.acceleration(step.position(at - aside), v);
        self.acceleration(step.position(at + aside), v) - before
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
    ASIDE * (s + origin)
}
