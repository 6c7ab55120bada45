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
pub(super) const DENSE: [f64; STAGES] = [
    -12715105075.0 / 11282082432.0,
    0.0,
    87487479700.0 / 32700410799.0,
    -10690763975.0 / 1880347072.0,
    701980252875.0 / 199316789632.0,
    -1453857185.0 / 822651844.0,
    69997945.0 / 29380423.0,
];

/// Fourth-order dense output of `N` components over one step: the terms of each are its start, its
/// rise, and three bends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Dense<const N: usize>(pub(super) [[f64; 5]; N]);

impl<const N: usize> Dense<N> {
    /// Makes a step that keeps these components all over.
    pub fn still(y: [f64; N]) -> Self {
        Self(y.map(|a| [a, 0.0, 0.0, 0.0, 0.0]))
    }

    /// The components at the fraction `t` of the step.
    pub fn at(&self, t: f64) -> [f64; N] {
        self.0
            .map(|[a, b, c, d, e]| a + t * (b + (1.0 - t) * (c + t * (d + (1.0 - t) * e))))
    }
}

/// A curve over one step that matches position, velocity and acceleration at both ends: error of
/// order h⁶ in the position, h⁵ in the velocity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quintic {
    /// The polynomial's coefficients in `t` in [0, 1].
    pub(super) coefficients: [DVec3; 6],
    /// The step's length.
    pub(super) h: f64,
}

impl Quintic {
    /// The straight line through `p` with velocity `v`, over a step of 1.
    pub fn straight(p: DVec3, v: DVec3) -> Self {
        let nil = DVec3::ZERO;
        Self {
            coefficients: [p, v, nil, nil, nil, nil],
            h: 1.0,
        }
    }

    /// The position at the fraction `t` of the step.
    pub fn position(&self, t: f64) -> DVec3 {
        let c = &self.coefficients;
        c[0] + (c[1] + (c[2] + (c[3] + (c[4] + c[5] * t) * t) * t) * t) * t
    }

    /// Corners of a box around all positions: every term beyond the first lies between zero and its
    /// coefficient.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        let [first, terms @ ..] = self.coefficients;
        let sum = |part: fn(DVec3, DVec3) -> DVec3| {
            let mut sum = first;
            for term in terms {
                sum += part(term, DVec3::ZERO);
            }
            sum
        };
        (sum(DVec3::min), sum(DVec3::max))
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
    fn weights_are_consistent() {
        let nodes = [0.2, 0.3, 0.8, 8.0 / 9.0, 1.0, 1.0];
        for (row, c) in A.iter().zip(nodes) {
            assert!((row.iter().sum::<f64>() - c).abs() < 1e-14);
        }
        assert!(ERROR.iter().sum::<f64>().abs() < 1e-15);
        assert!(DENSE.iter().sum::<f64>().abs() < 1e-12);
    }
}
