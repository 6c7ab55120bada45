//! Many geodesics by equal steps: the classical Runge–Kutta method of order four, in any precision.
//!
//! In: starts and a number of steps. Out: chart points and tangents at every step. It has no error
//! control and carries nothing: it is the quick integrator that a table must beat at equal error.

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
            vectorised(
                #[inline(always)]
                || step(flow, &mut registers, &mut y, h),
            );
            for (lane, (u, v)) in knots[first..].iter_mut().enumerate() {
                let at = |k: usize| y[k][lane].to_f64();
                u.push(DVec3::new(at(0), at(1), at(2)));
                v.push(DVec3::new(at(3), at(4), at(5)));
            }
        }
    }
    knots
}

type State<R> = [[R; LANES]; 6];

/// One step of the classical method.
#[inline(always)]
fn step<R: Real>(flow: &Tape, registers: &mut Registers<R, LANES>, y: &mut State<R>, h: R) {
    let [half, third, sixth] = [0.5, 1.0 / 3.0, 1.0 / 6.0].map(|w| R::from_f64(w) * h);
    let k1 = rates(flow, registers, y);
    let k2 = rates(flow, registers, &moved(y, &k1, half));
    let k3 = rates(flow, registers, &moved(y, &k2, half));
    let k4 = rates(flow, registers, &moved(y, &k3, h));
    for row in 0..6 {
        for l in 0..LANES {
            let (outer, inner) = (k1[row][l] + k4[row][l], k2[row][l] + k3[row][l]);
            y[row][l] += outer * sixth + inner * third;
        }
    }
}

/// `y + h k`
#[inline(always)]
fn moved<R: Real>(y: &State<R>, k: &State<R>, h: R) -> State<R> {
    let mut moved = *y;
    for row in 0..6 {
        for l in 0..LANES {
            moved[row][l] = y[row][l] + h * k[row][l];
        }
    }
    moved
}

/// The rates of `y`.
#[inline(always)]
fn rates<R: Real>(flow: &Tape, registers: &mut Registers<R, LANES>, y: &State<R>) -> State<R> {
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
