//! Where the metric has a kink: steps end there, the ray hops over it, and its deviation jumps.
//!
//! In: a trial [`Step`], and the state of the ray at its start. Out: the [`Meeting`] with the first
//! kink on the step, and what the deviations gain by crossing it ([`Surface::gain`]).
//!
//! At a surface `φ(u) = 0` across which the acceleration jumps from `a⁻` to `a⁺`, a neighbour that
//! arrives `−∇φ·δu / ∇φ·v` later bends later by as much: `δv` jumps by
//! `(a⁺ − a⁻) ∇φ·δu / ∇φ·v` (the saltation of a piecewise smooth flow: M. di Bernardo et al.,
//! *Piecewise-smooth Dynamical Systems* (2008), ch. 2.5). Position, tangent and frame stay continuous.

use super::{Step, crossing};
use crate::{
    expr::{Registers, Tape},
    manifold::Manifold,
};
use glam::DVec3;

/// How near a kink a step ends, and a hop beyond it, as a share of the arc length and of the distance
/// from the chart's origin. Rounding in `φ` moves the crossing by 1e-16 to 1e-15 of them, and both ends
/// of a hop must not lie on one side; the hop is an error of the position.
const ASIDE: f64 = 2e-14;

/// A path that meets a surface at a smaller angle than this runs along it, and rounding decides on
/// which side; nothing can be said about a jump then, and no step ends there.
const GRAZING: f64 = 1e-4;

/// Finds kinks on the steps of single rays.
pub(super) struct Kinks<'m> {
    tape: &'m Tape,
    registers: Registers<f64, 1>,
}

/// How a trial step meets a kink.
#[derive(Debug, Clone, Copy)]
pub(super) enum Meeting {
    /// It would end just before the kink with this length instead; see [`approach`].
    Ahead(f64),
    /// The kink is at the start of the step: moving this far along the tangent crosses it.
    Here(f64, Surface),
}

/// A surface `φ = 0` near a point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Surface {
    value: f64,
    gradient: DVec3,
}

impl Surface {
    /// What `δv` of a neighbour at `du` gains where the acceleration of a ray with tangent `v` jumps by
    /// `bend`; nothing for a ray along the surface.
    pub fn gain(&self, v: DVec3, bend: DVec3, du: DVec3) -> DVec3 {
        let late = self.gradient.dot(du) / self.gradient.dot(v);
        if late.is_finite() {
            bend * late
        } else {
            DVec3::ZERO
        }
    }
}

/// The step to take towards a kink at a distance of `length`, where steps of length `usual` are taken
/// otherwise: a little less than all of it, because stages of a step are less exact than its end, by
/// the cube of its length, and none of them may lie behind the kink. Without the margin every second
/// approach to a fish-eye's edge failed; the margin costs one more step.
pub(super) fn approach(length: f64, usual: f64) -> f64 {
    let share = (length / usual).min(1.0);
    length * (1.0 - 0.1 * share * share)
}

impl<'m> Kinks<'m> {
    /// `None` for a smooth metric.
    pub fn new(manifold: &'m Manifold) -> Option<Self> {
        let tape = manifold.kinks()?;
        let registers = tape.registers();
        Some(Self { tape, registers })
    }

    /// The first kink on the trial `step`, if there is one.
    pub fn meeting(&mut self, step: &Step) -> Option<Meeting> {
        let functions = self.tape.outputs() / 4;
        let crossed = (0..functions).filter_map(|k| Some((self.crossed(k, step)?, k)));
        let (at, k) = crossed.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let (u, v) = (step.position(step.start), step.tangent(step.start));
        let aside = ASIDE * (step.end + u.length() / v.length());
        let before = at - step.start - aside;
        Some(match before > aside {
            true => Meeting::Ahead(before),
            false => self.hop(k, u, v, before + 2.0 * aside),
        })
    }

    /// Moves at least `least` along the tangent: farther for a surface that is met at a small angle,
    /// where rounding in `φ` moves the crossing farther.
    fn hop(&mut self, k: usize, u: DVec3, v: DVec3, least: f64) -> Meeting {
        let surface = self.surface(k, u);
        let side = |surface: Surface| surface.value > 0.0;
        let mut way = least;
        // Up to where the angle is GRAZING.
        while way < least / GRAZING && side(self.surface(k, u + v * way)) == side(surface) {
            way *= 2.0;
        }
        Meeting::Here(way, surface)
    }

    /// Where surface `k` is first crossed on `step`; one that is crossed twice within half a step is
    /// left to the control of the error.
    fn crossed(&mut self, k: usize, step: &Step) -> Option<f64> {
        let middle = 0.5 * (step.start + step.end);
        let first = self.crossed_between(k, step, [step.start, middle]);
        first.or_else(|| self.crossed_between(k, step, [middle, step.end]))
    }

    fn crossed_between(&mut self, k: usize, step: &Step, [low, high]: [f64; 2]) -> Option<f64> {
        let [start, end] = [low, high].map(|s| step.position(s));
        let (before, after) = (self.surface(k, start), self.surface(k, end));
        let seen = before.value.is_finite() && after.value.is_finite();
        if !seen || (before.value > 0.0) == (after.value > 0.0) {
            return None;
        }
        let steepest = after.gradient.length().max(before.gradient.length());
        let reach = (end - start).length() * steepest;
        if before.value.abs().max(after.value.abs()) < GRAZING * reach {
            return None;
        }
        let sign = if after.value > 0.0 { 1.0 } else { -1.0 };
        Some(crossing(low, high, |s| {
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
}
