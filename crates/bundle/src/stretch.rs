//! A change of variable that spends the degrees of polynomials evenly.
//!
//! Chebyshev polynomials resolve twice as finely near the ends of their interval as they need to, and
//! in the middle more coarsely than evenly spaced nodes would, by π/2. In the variable y of
//! `x = asin(α y)/asin(α)` they are more even, and functions that are equally rough everywhere take
//! fewer of them. Source: D. Kosloff, H. Tal-Ezer, *A modified Chebyshev pseudospectral method with an
//! O(N⁻¹) time step restriction*, J. Comput. Phys. 104 (1993). What that costs: no polynomial
//! converges faster than `tⁿ`, with `t = (1 − √(1−α²))/α`.

use geofan_expr::real::Real;
use serde::{Deserialize, Serialize};

/// α in [0, 1); 0 leaves the variable alone.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct MappedChebyshev(f64);

impl MappedChebyshev {
    /// None at all.
    pub const NONE: Self = Self(0.0);

    /// With a number in [0, 1).
    pub const fn new(alpha: f64) -> Self {
        Self(alpha)
    }

    /// Whether α is in its range.
    pub fn is_valid(self) -> bool {
        (0.0..1.0).contains(&self.0)
    }

    /// The place x in [−1, 1] of a variable y of the polynomials.
    pub fn place(self, y: f64) -> f64 {
        match self == Self::NONE {
            true => y,
            false => Real::asin(self.0 * y) / Real::asin(self.0),
        }
    }

    /// The variable of the polynomials at the place x: the inverse of [`MappedChebyshev::place`].
    pub fn variable(self, x: f64) -> f64 {
        match self == Self::NONE {
            true => x,
            false => Real::sin(x * Real::asin(self.0)) / self.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_come_back_and_ends_stay() {
        for alpha in [0.0, 0.3, 0.9, 0.99] {
            let stretch = MappedChebyshev::new(alpha);
            assert!(stretch.is_valid());
            for y in [-1.0, -0.7, 0.0, 0.2, 1.0] {
                let x = stretch.place(y);
                assert!((stretch.variable(x) - y).abs() < 1e-14);
                assert!(y.abs() < 1.0 || (x - y).abs() < 1e-15);
            }
        }
        assert!(
            [1.0, -0.1, f64::NAN]
                .iter()
                .all(|a| !MappedChebyshev::new(*a).is_valid())
        );
    }
}
