//! Many geodesics by equal steps: the classical Runge–Kutta method of order four, in any precision.
//!
//! In: starts and a number of steps. Out: chart points and tangents at every step. It has no error
//! control and carries nothing: it is the quick integrator that a table must beat at equal error. Steps that
//! cross an edge of the metric are taken apart: up to it, refraction or reflection, and the rest.

use super::{
    crossing,
    refraction::{EdgeSide, deflect},
};
use crate::manifold::{Carried, Manifold};
use geofan_expr::{Registers, Tape, real::Real, vectorised};
use glam::DVec3;

/// Lanes: four of the widest vectors in single precision. With half of them the dispatch of
/// instructions costs as much as their arithmetic; with twice as many the registers of a tape no
/// longer stay in the first-level cache.
const LANES: usize = 64;

/// Knots of one path: points and tangents.
pub type Knots = (Vec<DVec3>, Vec<DVec3>);

/// Follows the rays (chart point, unit tangent) over `length` in `steps` steps, in the precision
/// `R`.
pub fn fixed_steps<R: Real>(
    manifold: &Manifold,
    rays: &[(DVec3, DVec3)],
    length: f64,
    steps: usize,
) -> Vec<Knots> {
    let flow = manifold.flow(Carried::default());
    let mut registers = flow.registers::<R, LANES>();
    let h = R::from_f64(length / steps as f64);
    let mut edges = Edges::new(manifold);
    let mut knots = Vec::with_capacity(rays.len());
    for block in rays.chunks(LANES) {
        let mut y = [[R::ZERO; LANES]; 6];
        for (lane, (u, v)) in block.iter().enumerate() {
            for k in 0..3 {
                y[k][lane] = R::from_f64(u[k]);
                y[3 + k][lane] = R::from_f64(v[k]);
            }
        }
        let first = knots.len();
        for (u, v) in block {
            let mut both = (Vec::with_capacity(steps + 1), Vec::with_capacity(steps + 1));
            both.0.push(*u);
            both.1.push(*v);
            knots.push(both);
        }
        for _ in 0..steps {
            let before = y;
            vectorised(
                #[inline(always)]
                || step(flow, &mut registers, &mut y, h),
            );
            if let Some(edges) = &mut edges {
                edges.mend(&before, &mut y, block.len(), h.to_f64());
            }
            for (lane, (u, v)) in knots[first..].iter_mut().enumerate() {
                let at = |k: usize| y[k][lane].to_f64();
                u.push(DVec3::new(at(0), at(1), at(2)));
                v.push(DVec3::new(at(3), at(4), at(5)));
            }
        }
    }
    knots
}

/// Chart points and tangents of `W` rays.
type LaneStates<R, const W: usize = LANES> = [[R; W]; 6];

/// One step of the classical method.
#[inline(always)]
fn step<R: Real, const W: usize>(
    flow: &Tape,
    registers: &mut Registers<R, W>,
    y: &mut LaneStates<R, W>,
    h: R,
) {
    let [half, third, sixth] = [0.5, 1.0 / 3.0, 1.0 / 6.0].map(|w| R::from_f64(w) * h);
    let k1 = rates(flow, registers, y);
    let k2 = rates(flow, registers, &moved(y, &k1, half));
    let k3 = rates(flow, registers, &moved(y, &k2, half));
    let k4 = rates(flow, registers, &moved(y, &k3, h));
    for row in 0..6 {
        for l in 0..W {
            let (outer, inner) = (k1[row][l] + k4[row][l], k2[row][l] + k3[row][l]);
            y[row][l] += outer * sixth + inner * third;
        }
    }
}

/// `y + h k`
#[inline(always)]
fn moved<R: Real, const W: usize>(
    y: &LaneStates<R, W>,
    k: &LaneStates<R, W>,
    h: R,
) -> LaneStates<R, W> {
    let mut moved = *y;
    for row in 0..6 {
        for l in 0..W {
            moved[row][l] = y[row][l] + h * k[row][l];
        }
    }
    moved
}

/// The rates of `y`.
#[inline(always)]
fn rates<R: Real, const W: usize>(
    flow: &Tape,
    registers: &mut Registers<R, W>,
    y: &LaneStates<R, W>,
) -> LaneStates<R, W> {
    for (k, row) in y.iter().enumerate() {
        *registers.input(k) = *row;
    }
    flow.run_first(registers);
    [
        y[3],
        y[4],
        y[5],
        *registers.output(0),
        *registers.output(1),
        *registers.output(2),
    ]
}

/// Edges of the metric, for steps that cross them.
struct Edges<'m, R> {
    manifold: &'m Manifold,
    /// Switching functions and their gradients, four outputs each.
    tape: &'m Tape,
    lanes: [Registers<R, LANES>; 2],
    single: Registers<f64, 1>,
    flow: Registers<f64, 1>,
}

/// Distance beside an edge at which its sides are looked at, as a share of the distance from the chart's origin
/// and of the step.
const ASIDE: f64 = 1e-12;

/// Share of the step towards an edge over which the tangent is continued: more than stages miss the path by.
const CONTINUED: f64 = 1e-3;

/// Most edges crossed in one step; what is beyond is left to the step.
const MOST_CROSSINGS: usize = 8;

impl<'m, R: Real> Edges<'m, R> {
    /// Prepares for a manifold; `None` if its metric is smooth.
    fn new(manifold: &'m Manifold) -> Option<Self> {
        let tape = manifold.switching_functions()?;
        Some(Self {
            manifold,
            tape,
            lanes: [tape.registers(), tape.registers()],
            single: tape.registers(),
            flow: manifold.flow(Carried::default()).registers(),
        })
    }

    /// Replaces the ends `after` of steps of length `h` from `before` that cross an edge; the first `count`
    /// lanes are rays.
    fn mend(&mut self, before: &LaneStates<R>, after: &mut LaneStates<R>, count: usize, h: f64) {
        for (registers, state) in self.lanes.iter_mut().zip([before, &*after]) {
            for c in 0..3 {
                *registers.input(c) = state[c];
            }
            self.tape.run(registers);
        }
        for lane in 0..count {
            let mut functions = (0..self.tape.outputs()).step_by(4);
            let changes = functions.any(|k| {
                let [a, b] = [0, 1].map(|place| self.lanes[place].output(k)[lane] > R::ZERO);
                a != b
            });
            if !changes {
                continue;
            }
            let start = std::array::from_fn(|row| before[row][lane].to_f64());
            if let Some(end) = self.across(start, h) {
                for (row, value) in after.iter_mut().zip(end) {
                    row[lane] = R::from_f64(value);
                }
            }
        }
    }

    /// Steps from `y` over `h` across edges; `None` if there is none on the way.
    fn across(&mut self, mut y: [f64; 6], h: f64) -> Option<[f64; 6]> {
        let (mut left, mut met) = (h, false);
        for _ in 0..MOST_CROSSINGS {
            let Some((part, k)) = self.first_edge(&y, left) else {
                break;
            };
            y = self.approached(&y, part);
            y = self.deflected(&y, k, h);
            (left, met) = (left - part, true);
        }
        met.then(|| self.stepped(&y, left))
    }

    /// Finds the length of the step from `y` that ends at the first edge within `h`, and its function.
    fn first_edge(&mut self, y: &[f64; 6], h: f64) -> Option<(f64, usize)> {
        let end = self.stepped(y, h);
        let mut first: Option<(f64, usize)> = None;
        for k in (0..self.tape.outputs()).step_by(4) {
            let [(a, _), (b, _)] = [self.value(k, y), self.value(k, &end)];
            if (a > 0.0) == (b > 0.0) || !a.is_finite() || !b.is_finite() {
                continue;
            }
            let sign = if b > 0.0 { 1.0 } else { -1.0 };
            let part = crossing(0.0, h, |part| {
                let there = self.stepped(y, part);
                sign * self.value(k, &there).0
            });
            let there = self.stepped(y, part);
            let [near, far] = self.sides(&there, k, h);
            if near.differs(&far) && first.is_none_or(|(earlier, _)| part < earlier) {
                first = Some((part, k));
            }
        }
        first
    }

    /// Returns the state at an edge a step of length `part` from `y`. The last stage of that step may lie behind
    /// the edge, which spoils its tangent: that is continued from shorter steps.
    fn approached(&mut self, y: &[f64; 6], part: f64) -> [f64; 6] {
        let mut there = self.stepped(y, part);
        let [far, near] = [2.0, 1.0].map(|k| self.stepped(y, part * (1.0 - k * CONTINUED)));
        for c in 3..6 {
            there[c] = 2.0 * near[c] - far[c];
        }
        there
    }

    /// Refracts or reflects the state `y` at an edge, and moves it clear of that.
    fn deflected(&mut self, y: &[f64; 6], k: usize, h: f64) -> [f64; 6] {
        let (u, v) = halves(y);
        let gradient = self.value(k, y).1;
        let [near, far] = self.sides(y, k, h);
        let (v, _) = deflect(&near, &far, gradient, v);
        let clear = u + v.normalize() * self.aside(u, h);
        let (u, v) = (clear.to_array(), v.to_array());
        [u[0], u[1], u[2], v[0], v[1], v[2]]
    }

    /// Evaluates the geometry before and behind the edge at `y`.
    fn sides(&mut self, y: &[f64; 6], k: usize, h: f64) -> [EdgeSide; 2] {
        let (u, v) = halves(y);
        let gradient = self.value(k, y).1;
        let normal = gradient.normalize() * gradient.dot(v).signum() * self.aside(u, h);
        [-1.0, 1.0].map(|side| EdgeSide::at(self.manifold, u + normal * side))
    }

    fn aside(&self, u: DVec3, h: f64) -> f64 {
        ASIDE * (u.length() + h)
    }

    /// Returns a switching function and its gradient at the point of `y`.
    fn value(&mut self, k: usize, y: &[f64; 6]) -> (f64, DVec3) {
        self.tape.run_at(&mut self.single, &y[..3]);
        let output = |c: usize| self.single.output(k + c)[0];
        (output(0), DVec3::new(output(1), output(2), output(3)))
    }

    /// Returns the state one step of length `h` after `y`.
    fn stepped(&mut self, y: &[f64; 6], h: f64) -> [f64; 6] {
        let mut state = y.map(|value| [value]);
        let flow = self.manifold.flow(Carried::default());
        step(flow, &mut self.flow, &mut state, h);
        state.map(|[value]| value)
    }
}

/// The chart point and the tangent of a state.
fn halves(y: &[f64; 6]) -> (DVec3, DVec3) {
    (DVec3::new(y[0], y[1], y[2]), DVec3::new(y[3], y[4], y[5]))
}
