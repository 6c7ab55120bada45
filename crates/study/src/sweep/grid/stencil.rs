//! Interpolation along one axis of equally spaced nodes: weights, and the prefilter of samples.
//!
//! In: a number of nodes and a place among them. Out: a [`Stencil`]: the first node and the weights
//! of it and the next ones. Cubic B-splines interpolate after [`prefilter`], which turns the samples
//! along a line into coefficients. Their ends are *not-a-knot* (the third derivative is continuous at
//! the last node but one, de Boor, *A Practical Guide to Splines*, ch. 4), which keeps the fourth
//! order up to the edge: with mirrored ends the edges of every face and every path would be of second
//! order, and they hold most of a grid's cells.

use serde::{Deserialize, Serialize};

/// Says how a grid is read between its nodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Interpolation {
    /// Straight between neighbours.
    Multilinear,
    /// Cubic B-splines through the samples.
    Cubic,
}

/// The fewest nodes of an axis: a cubic needs four.
pub const FEWEST: usize = 4;

/// Weights of consecutive nodes.
#[derive(Debug, Clone, Copy)]
pub struct Stencil {
    /// The first node.
    pub start: usize,
    weights: [f64; 4],
    width: usize,
}

impl Stencil {
    /// Returns the weights.
    pub fn weights(&self) -> &[f64] {
        &self.weights[..self.width]
    }
}

impl Interpolation {
    /// Returns the stencil at `t`, in [0, 1] along an axis of `nodes` nodes (at least [`FEWEST`]).
    pub fn stencil(self, nodes: usize, t: f64) -> Stencil {
        let (cell, x) = cell(nodes, t);
        self.in_cell(nodes, cell, x)
    }

    /// Returns the stencil at the share `x` of the cell `cell`.
    fn in_cell(self, nodes: usize, cell: usize, x: f64) -> Stencil {
        match self {
            Self::Multilinear => Stencil {
                start: cell,
                weights: [1.0 - x, x, 0.0, 0.0],
                width: 2,
            },
            Self::Cubic => cubic(nodes, cell, x),
        }
    }

    /// Returns the stencil of the integral from the start of the cell `cell` to its share `x`, in cells: two
    /// Gauss points are exact for cubics.
    pub fn integral(self, nodes: usize, cell: usize, x: f64) -> Stencil {
        let offset = 0.5 / f64::sqrt(3.0);
        let [a, b] = [0.5 - offset, 0.5 + offset].map(|g| self.in_cell(nodes, cell, g * x));
        let weights = std::array::from_fn(|k| 0.5 * x * (a.weights[k] + b.weights[k]));
        Stencil { weights, ..a }
    }
}

/// Returns the cell of `t`, in [0, 1] along an axis of `nodes` nodes, and the share of it that lies before.
pub fn cell(nodes: usize, t: f64) -> (usize, f64) {
    let place = t.clamp(0.0, 1.0) * (nodes - 1) as f64;
    let cell = (place as usize).min(nodes - 2);
    (cell, place - cell as f64)
}

/// Weighs the coefficients `cell − 1 … cell + 2`. The coefficient beyond either end continues
/// the four next to it as a cubic, which not-a-knot means for B-splines: it is folded into
/// their weights.
fn cubic(nodes: usize, cell: usize, x: f64) -> Stencil {
    let r = 1.0 - x;
    let [a, b, c, d] = [
        r * r * r,
        3.0 * x * x * (x - 2.0) + 4.0,
        3.0 * r * r * (r - 2.0) + 4.0,
        x * x * x,
    ]
    .map(|w| w / 6.0);
    let (start, weights) = if cell == 0 {
        (0, [b + 4.0 * a, c - 6.0 * a, d + 4.0 * a, -a])
    } else if cell + 2 == nodes {
        (nodes - 4, [-d, a + 4.0 * d, b - 6.0 * d, c + 4.0 * d])
    } else {
        (cell - 1, [a, b, c, d])
    };
    Stencil {
        start,
        weights,
        width: 4,
    }
}

/// Turns samples `f` along a line into B-spline coefficients, in place.
///
/// `(c[i−1] + 4 c[i] + c[i+1])/6 = f[i]`, and the fourth differences at both ends vanish. Both
/// together give `c[1] = (8 f[1] − f[0] − f[2])/6` and its mirror image outright; the rest between
/// them is tridiagonal.
pub fn prefilter(f: &mut [f64]) {
    // Both ends, outright.
    let n = f.len();
    let near_start = (8.0 * f[1] - f[0] - f[2]) / 6.0;
    let near_end = (8.0 * f[n - 2] - f[n - 1] - f[n - 3]) / 6.0;
    let (first, last) = (6.0 * f[1], 6.0 * f[n - 2]);
    f[1] = near_start;
    f[n - 2] = near_end;
    // Thomas's algorithm on rows 2 … n−3; `above` holds the remainder above the diagonal.
    let mut above = vec![0.0; n];
    for i in 2..n.saturating_sub(2) {
        let pivot = 4.0 - above[i - 1];
        f[i] = (6.0 * f[i] - f[i - 1]) / pivot;
        above[i] = 1.0 / pivot;
    }
    for i in (2..n.saturating_sub(2)).rev() {
        f[i] -= above[i] * f[i + 1];
    }
    f[0] = first - 4.0 * f[1] - f[2];
    f[n - 1] = last - 4.0 * f[n - 2] - f[n - 3];
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(interpolation: Interpolation, values: &[f64], t: f64) -> f64 {
        let stencil = interpolation.stencil(values.len(), t);
        let values = &values[stencil.start..];
        stencil
            .weights()
            .iter()
            .zip(values)
            .map(|(w, v)| w * v)
            .sum()
    }

    #[test]
    fn integrals_add_up_to_that_of_a_cubic() {
        let f = |t: f64| 1.0 - 2.0 * t + 3.0 * t * t - 4.0 * t * t * t;
        let integral = |t: f64| t - t * t + t * t * t - t * t * t * t;
        for n in [4, 5, 9] {
            let coefficients = spline(n, f);
            let sum = |end: usize, x: f64| {
                let stencil = Interpolation::Cubic.integral(n, end, x);
                let values = &coefficients[stencil.start..];
                let terms = stencil.weights().iter().zip(values).map(|(w, v)| w * v);
                terms.sum::<f64>() / (n - 1) as f64
            };
            for t in [0.05, 0.3, 0.5, 0.77, 1.0] {
                let (last, x) = cell(n, t);
                let whole: f64 = (0..last).map(|cell| sum(cell, 1.0)).sum();
                let found = whole + sum(last, x);
                assert!((found - integral(t)).abs() < 1e-12, "{n} {t} {found}");
            }
        }
    }

    fn spline(n: usize, f: impl Fn(f64) -> f64) -> Vec<f64> {
        let mut values: Vec<f64> = (0..n).map(|i| f(i as f64 / (n - 1) as f64)).collect();
        prefilter(&mut values);
        values
    }

    #[test]
    fn cubic_splines_reproduce_cubics_up_to_the_edge() {
        let f = |t: f64| 1.0 - 2.0 * t + 3.0 * t * t - 4.0 * t * t * t;
        for n in [4, 5, 6, 7, 20] {
            let coefficients = spline(n, f);
            for k in 0..=100 {
                let t = f64::from(k) / 100.0;
                let found = read(Interpolation::Cubic, &coefficients, t);
                assert!((found - f(t)).abs() < 1e-12, "{n} {t} {found}");
            }
        }
    }

    #[test]
    fn splines_go_through_their_samples() {
        let f = |t: f64| (9.0 * t).sin();
        let coefficients = spline(11, f);
        for k in 0..11 {
            let t = f64::from(k) / 10.0;
            let found = read(Interpolation::Cubic, &coefficients, t);
            assert!((found - f(t)).abs() < 1e-12);
        }
    }

    /// The worst error over the whole interval on `n` nodes.
    fn worst(interpolation: Interpolation, n: usize) -> f64 {
        let f = |t: f64| (5.0 * t + 0.3).sin();
        let values = match interpolation {
            Interpolation::Multilinear => (0..n).map(|i| f(i as f64 / (n - 1) as f64)).collect(),
            Interpolation::Cubic => spline(n, f),
        };
        let error = |k: u32| {
            let t = f64::from(k) / 5000.0;
            (read(interpolation, &values, t) - f(t)).abs()
        };
        (0..=5000).map(error).fold(0.0, f64::max)
    }

    #[test]
    fn the_orders_are_two_and_four_edges_included() {
        for (interpolation, order) in [
            (Interpolation::Multilinear, 2.0),
            (Interpolation::Cubic, 4.0),
        ] {
            let slope = (worst(interpolation, 41) / worst(interpolation, 81)).log2();
            assert!((slope - order).abs() < 0.3, "{interpolation:?} {slope}");
        }
    }
}
