//! Chebyshev polynomials on [−1, 1]: nodes, samples → coefficients, and values; and a change of variable
//! that spends their degrees evenly.
//!
//! In: samples at the first-kind nodes `cos(π(i+½)/n)`. Out: the coefficients of `f(x) = Σ c_k T_k(x)`, and
//! back. Source: L. N. Trefethen, *Approximation Theory and Approximation Practice*, chapters 2–4.
//!
//! Chebyshev polynomials resolve twice as finely near the ends of their interval as they need to, and
//! in the middle more coarsely than evenly spaced nodes would, by π/2. In the variable y of
//! `x = asin(α y)/asin(α)` ([`MappedChebyshev`]) they are more even, and functions that are equally rough
//! everywhere take fewer of them. Source: D. Kosloff, H. Tal-Ezer, *A modified Chebyshev pseudospectral
//! method with an O(N⁻¹) time step restriction*, J. Comput. Phys. 104 (1993). The cost: no polynomial
//! converges faster than `tⁿ`, with `t = (1 − √(1−α²))/α`.

use crate::matrix::product;
use geofan_core::parallel::*;
use geofan_expr::real::Real;
use ndarray::{Array2, ArrayD};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Returns the `n` nodes, ascending.
pub fn nodes(n: usize) -> Vec<f64> {
    (0..n)
        .map(|i| -(PI * (i as f64 + 0.5) / n as f64).cos())
        .collect()
}

/// Writes `T_0(x) … T_(n−1)(x)` into `values`.
pub fn values(x: f64, values: &mut [f64]) {
    for k in 0..values.len() {
        values[k] = match k {
            0 => 1.0,
            1 => x,
            _ => 2.0 * x * values[k - 1] - values[k - 2],
        };
    }
}

/// Returns `T_0(x) … T_(N−1)(x)` with their derivatives.
pub fn values_and_slopes<const N: usize>(x: f64) -> [(f64, f64); N] {
    let mut all = [(1.0, 0.0); N];
    for k in 1..N {
        all[k] = match k {
            1 => (x, 1.0),
            _ => {
                let ((t, dt), before) = (all[k - 1], all[k - 2]);
                (2.0 * x * t - before.0, 2.0 * (t + x * dt) - before.1)
            }
        };
    }
    all
}

/// Returns the matrix that takes `n` samples at [`nodes`] to coefficients.
pub fn transform(n: usize) -> Array2<f64> {
    let nodes = nodes(n);
    let mut t = vec![0.0; n];
    let mut matrix = Array2::zeros((n, n));
    for (i, &x) in nodes.iter().enumerate() {
        values(x, &mut t);
        for k in 0..n {
            let weight = if k == 0 { 1.0 } else { 2.0 };
            matrix[[k, i]] = weight * t[k] / n as f64;
        }
    }
    matrix
}

/// Returns the matrix that takes `n` coefficients to samples at [`nodes`].
pub fn inverse_transform(n: usize) -> Array2<f64> {
    at_nodes(&nodes(n), values)
}

/// Tabulates as many terms as there are nodes, one row for each node; `terms` writes their values at a node.
pub(crate) fn at_nodes(nodes: &[f64], terms: impl Fn(f64, &mut [f64])) -> Array2<f64> {
    let mut matrix = Array2::zeros((nodes.len(), nodes.len()));
    for (x, mut row) in nodes.iter().zip(matrix.outer_iter_mut()) {
        terms(*x, row.as_slice_mut().expect("contiguous"));
    }
    matrix
}

/// Transforms samples on a tensor grid of nodes to coefficients, along the first `axes` axes.
pub fn coefficients(samples: ArrayD<f64>, axes: usize) -> ArrayD<f64> {
    along_axes(samples, axes, transform)
}

/// Transforms coefficients to samples on the tensor grid of nodes, along the first `axes` axes.
pub fn samples(coefficients: ArrayD<f64>, axes: usize) -> ArrayD<f64> {
    along_axes(coefficients, axes, inverse_transform)
}

/// Applies to each of the first `axes` axes the square matrix that `of` makes for its length.
fn along_axes(array: ArrayD<f64>, axes: usize, of: impl Fn(usize) -> Array2<f64>) -> ArrayD<f64> {
    let mut array = match array.is_standard_layout() {
        true => array,
        false => array.as_standard_layout().into_owned(),
    };
    for axis in 0..axes {
        let matrix = of(array.shape()[axis]);
        along_axis(&mut array, axis, &matrix);
    }
    array
}

/// Columns that are transformed together: what one thread works on fits into a cache near it.
const TILE: usize = 128;

/// Applies the square `matrix` to `axis` of `array`, which has the standard layout.
pub fn along_axis(array: &mut ArrayD<f64>, axis: usize, matrix: &Array2<f64>) {
    let n = matrix.nrows();
    let inner: usize = array.shape()[axis + 1..].iter().product();
    let matrix: Vec<f64> = matrix.iter().copied().collect();
    let values = array.as_slice_mut().expect("standard layout");
    if inner < TILE {
        let group = TILE.div_ceil(inner) * n * inner;
        values
            .par_chunks_mut(group)
            .for_each(|blocks| short_blocks(blocks, inner, &matrix, n));
    } else {
        values
            .par_chunks_mut(n * inner)
            .for_each(|block| long_block(block, inner, &matrix, n));
    }
}

/// Applies `matrix` to the slowest axis of each of `blocks`, whose rows are shorter than a tile.
fn short_blocks(blocks: &mut [f64], inner: usize, matrix: &[f64], n: usize) {
    let count = blocks.len() / (n * inner);
    let mut rows = vec![0.0; blocks.len()];
    for (b, block) in blocks.chunks_exact(n * inner).enumerate() {
        for (i, row) in block.chunks_exact(inner).enumerate() {
            rows[(i * count + b) * inner..][..inner].copy_from_slice(row);
        }
    }
    let rows = product(matrix, n, &rows);
    for (b, block) in blocks.chunks_exact_mut(n * inner).enumerate() {
        for (i, row) in block.chunks_exact_mut(inner).enumerate() {
            row.copy_from_slice(&rows[(i * count + b) * inner..][..inner]);
        }
    }
}

/// Applies `matrix` to the slowest axis of `block`, whose rows are tiles side by side.
fn long_block(block: &mut [f64], inner: usize, matrix: &[f64], n: usize) {
    let mut tiles: Vec<Vec<&mut [f64]>> = Vec::new();
    tiles.resize_with(inner.div_ceil(TILE), || Vec::with_capacity(n));
    for row in block.chunks_exact_mut(inner) {
        for (tile, part) in tiles.iter_mut().zip(row.chunks_mut(TILE)) {
            tile.push(part);
        }
    }
    tiles.into_par_iter().for_each(|tile| {
        let rows = tile.iter().map(|row| &**row).collect::<Vec<_>>().concat();
        let rows = product(matrix, n, &rows);
        let width = rows.len() / n;
        for (to, from) in tile.into_iter().zip(rows.chunks_exact(width)) {
            to.copy_from_slice(from);
        }
    });
}

/// The map between places and variables of Chebyshev polynomials by Kosloff and Tal-Ezer, for α in [0, 1);
/// 0 leaves the variable alone.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct MappedChebyshev(f64);

impl MappedChebyshev {
    /// Leaves the variable alone.
    pub const NONE: Self = Self(0.0);

    /// Maps by `alpha` in [0, 1).
    pub const fn new(alpha: f64) -> Self {
        Self(alpha)
    }

    /// Tells whether α is in its range.
    pub fn is_valid(self) -> bool {
        (0.0..1.0).contains(&self.0)
    }

    /// Computes the place x in [−1, 1] of a variable y of the polynomials.
    pub fn place(self, y: f64) -> f64 {
        match self == Self::NONE {
            true => y,
            false => Real::asin(self.0 * y) / Real::asin(self.0),
        }
    }

    /// Computes the variable of the polynomials at the place x: the inverse of [`MappedChebyshev::place`].
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
    use ndarray::IxDyn;

    #[test]
    fn coefficients_reproduce_a_polynomial_of_two_variables() {
        let f = |x: f64, y: f64| 1.0 + x * x * y - 0.5 * y.powi(4) * x.powi(3);
        let (nx, ny) = (5, 6);
        let (xs, ys) = (nodes(nx), nodes(ny));
        let samples = ArrayD::from_shape_fn(IxDyn(&[nx, ny]), |i| f(xs[i[0]], ys[i[1]]));
        let c = coefficients(samples.clone(), 2);
        let back = super::samples(c.clone(), 2);
        assert!(
            back.iter()
                .zip(&samples)
                .all(|(a, b)| (a - b).abs() < 1e-14)
        );
        let (mut tx, mut ty) = (vec![0.0; nx], vec![0.0; ny]);
        for (x, y) in [(0.3, -0.9), (-1.0, 1.0), (0.11, 0.5)] {
            values(x, &mut tx);
            values(y, &mut ty);
            let sum: f64 = c.indexed_iter().map(|(i, c)| c * tx[i[0]] * ty[i[1]]).sum();
            assert!((sum - f(x, y)).abs() < 1e-13);
        }
    }

    #[test]
    fn slopes_are_those_of_cosines() {
        // T_k(cos a) = cos(k a), so its derivative is k sin(k a)/sin a.
        for a in [0.3_f64, 1.1, 2.9] {
            for (k, (t, slope)) in values_and_slopes::<8>(a.cos()).into_iter().enumerate() {
                let angle = k as f64 * a;
                assert!((t - angle.cos()).abs() < 1e-14);
                assert!((slope - k as f64 * angle.sin() / a.sin()).abs() < 1e-12);
            }
        }
    }
}

#[cfg(test)]
mod stretch_tests {
    use super::*;

    #[test]
    fn places_come_back_and_ends_stay() {
        for alpha in [0.0, 0.3, 0.9, 0.99] {
            let mapping = MappedChebyshev::new(alpha);
            assert!(mapping.is_valid());
            for y in [-1.0, -0.7, 0.0, 0.2, 1.0] {
                let x = mapping.place(y);
                assert!((mapping.variable(x) - y).abs() < 1e-14);
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
