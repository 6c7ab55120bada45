//! The Dormand–Prince pair of orders 5 and 4, its dense output, and quintic Hermite interpolation.
//!
//! Coefficients: J. R. Dormand and P. J. Prince, J. Comput. Appl. Math. 6 (1980) 19–26; dense
//! output: E. Hairer, S. P. Nørsett, G. Wanner, *Solving Ordinary Differential Equations I*, II.6
//! (the program `dopri5`).

use glam::DVec3;

/// Stages; the last is the first of the next step.
pub(super) const STAGES: usize = 7;

/// Row `i` gives stage `i + 1` from the stages before it; the last row is the new point.
pub(super) const A: [[f64; 6]; 6] = [
    [1.0 / 5.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [3.0 / 40.0, 9.0 / 40.0, 0.0, 0.0, 0.0, 0.0],
    [44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0, 0.0, 0.0, 0.0],
    [
        19372.0 / 6561.0,
        -25360.0 / 2187.0,
        64448.0 / 6561.0,
        -212.0 / 729.0,
        0.0,
        0.0,
    ],
    [
        9017.0 / 3168.0,
        -355.0 / 33.0,
        46732.0 / 5247.0,
        49.0 / 176.0,
        -5103.0 / 18656.0,
        0.0,
    ],
    [
        35.0 / 384.0,
        0.0,
        500.0 / 1113.0,
        125.0 / 192.0,
        -2187.0 / 6784.0,
        11.0 / 84.0,
    ],
];

/// Fifth-order minus fourth-order weights.
pub(super) const ERROR: [f64; STAGES] = [
    71.0 / 57600.0,
    0.0,
    -71.0 / 16695.0,
    71.0 / 1920.0,
    -17253.0 / 339200.0,
    22.0 / 525.0,
    -1.0 / 40.0,
];

/// Weights of the fourth-order dense output's last term.
const DENSE: [f64; STAGES] = [
    -12715105075.0 / 11282082432.0,
    0.0,
    87487479700.0 / 32700410799.0,
    -10690763975.0 / 1880347072.0,
    701980252875.0 / 199316789632.0,
    -1453857185.0 / 822651844.0,
    69997945.0 / 29380423.0,
];

/// Fourth-order dense output of `N` components over one step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Dense<const N: usize>([[f64; 5]; N]);

impl<const N: usize> Dense<N> {
    /// From the values at both ends and the rates `k` at the stages, over a step `h`.
    pub fn new(y0: [f64; N], y1: [f64; N], h: f64, k: [[f64; N]; STAGES]) -> Self {
        Self(std::array::from_fn(|c| {
            let rise = y1[c] - y0[c];
            let bend = h * k[0][c] - rise;
            let last = (0..STAGES).map(|i| DENSE[i] * k[i][c]).sum::<f64>();
            [y0[c], rise, bend, rise - h * k[6][c] - bend, h * last]
        }))
    }

    /// The components at the fraction `t` of the step.
    pub fn at(&self, t: f64) -> [f64; N] {
        self.0
            .map(|[a, b, c, d, e]| a + t * (b + (1.0 - t) * (c + t * (d + (1.0 - t) * e))))
    }
}

/// What rounding of the positions at both ends leaves in the quintic's last coefficient, relative to
/// them: six times half a unit in the last place of each.
const ROUNDING: f64 = 6.0 * f64::EPSILON;

/// A curve over one step that matches position, velocity and acceleration at both ends: error of
/// order h⁶ in the position, h⁵ in the velocity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quintic {
    /// The polynomial's coefficients in `t` in [0, 1].
    coefficients: [DVec3; 6],
    h: f64,
}

impl Quintic {
    /// From (position, velocity, acceleration) at the start and at the end of a step `h`.
    pub fn new(start: [DVec3; 3], end: [DVec3; 3], h: f64) -> Self {
        let (p0, v0, a0) = (start[0], start[1] * h, start[2] * (0.5 * h * h));
        let (v1, a1) = (end[1] * h, end[2] * (0.5 * h * h));
        // What the end conditions still ask of the cubic to quintic terms.
        let rise = end[0] - p0 - v0 - a0;
        let slope = v1 - v0 - a0 * 2.0;
        let bend = a1 - a0;
        let c3 = rise * 10.0 - slope * 4.0 + bend;
        let c4 = rise * -15.0 + slope * 7.0 - bend * 2.0;
        let c5 = rise * 6.0 - slope * 3.0 + bend;
        // In a very short step the difference of the positions is rounding, and divided by `h` it
        // would spoil the velocity: there the velocities alone decide, and c5 is zero.
        let noise = ROUNDING * p0.abs().max(end[0].abs()).max_element();
        let (c3, c4, c5) = match c5.abs().max_element() > noise {
            true => (c3, c4, c5),
            false => (
                slope - bend * (2.0 / 3.0),
                (bend - slope) * 0.5,
                DVec3::ZERO,
            ),
        };
        Self {
            coefficients: [p0, v0, a0, c3, c4, c5],
            h,
        }
    }

    /// The position at the fraction `t` of the step.
    pub fn position(&self, t: f64) -> DVec3 {
        let c = &self.coefficients;
        c[0] + (c[1] + (c[2] + (c[3] + (c[4] + c[5] * t) * t) * t) * t) * t
    }

    /// The velocity (per unit of `h`'s unit) at the fraction `t` of the step.
    pub fn velocity(&self, t: f64) -> DVec3 {
        let c = &self.coefficients;
        (c[1] + (c[2] * 2.0 + (c[3] * 3.0 + (c[4] * 4.0 + c[5] * (5.0 * t)) * t) * t) * t) / self.h
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quintic_reproduces_a_quintic() {
        let p = |t: f64| DVec3::new(t.powi(5), 1.0 - t.powi(4), 2.0 * t.powi(3) + t);
        let v = |t: f64| DVec3::new(5.0 * t.powi(4), -4.0 * t.powi(3), 6.0 * t * t + 1.0);
        let a = |t: f64| DVec3::new(20.0 * t.powi(3), -12.0 * t * t, 12.0 * t);
        let (s0, h) = (0.3, 1.7);
        let s1 = s0 + h;
        let curve = Quintic::new([p(s0), v(s0), a(s0)], [p(s1), v(s1), a(s1)], h);
        for t in [0.0, 0.2, 0.5, 0.9, 1.0] {
            assert!((curve.position(t) - p(s0 + t * h)).length() < 1e-12);
            assert!((curve.velocity(t) - v(s0 + t * h)).length() < 1e-12);
        }
    }

    #[test]
    fn weights_are_consistent() {
        let nodes = [0.2, 0.3, 0.8, 8.0 / 9.0, 1.0, 1.0];
        for (row, c) in A.iter().zip(nodes) {
            assert!((row.iter().sum::<f64>() - c).abs() < 1e-14);
        }
        assert!(ERROR.iter().sum::<f64>().abs() < 1e-15);
        assert!(DENSE.iter().sum::<f64>().abs() < 1e-12);
    }
}
