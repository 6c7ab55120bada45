//! Chebyshev polynomials on [−1, 1]: nodes, samples → coefficients, and values.
//!
//! First-kind nodes `cos(π(i+½)/n)`; `f(x) = Σ c_k T_k(x)`. Source: L. N. Trefethen,
//! *Approximation Theory and Approximation Practice*, chapters 2–4.

use crate::expr::vectorised;
use ndarray::{Array2, ArrayD, IxDyn};
use std::f64::consts::PI;

/// The `n` nodes, ascending.
pub fn nodes(n: usize) -> Vec<f64> {
    (0..n)
        .map(|i| -(PI * (i as f64 + 0.5) / n as f64).cos())
        .collect()
}

/// `T_0(x) … T_(n−1)(x)` into `values`.
pub fn values(x: f64, values: &mut [f64]) {
    for k in 0..values.len() {
        values[k] = match k {
            0 => 1.0,
            1 => x,
            _ => 2.0 * x * values[k - 1] - values[k - 2],
        };
    }
}

/// The matrix that takes `n` samples at [`nodes`] to coefficients.
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

/// The matrix that takes `n` coefficients to samples at [`nodes`].
pub fn inverse_transform(n: usize) -> Array2<f64> {
    let mut matrix = Array2::zeros((n, n));
    for (x, mut row) in nodes(n).iter().zip(matrix.outer_iter_mut()) {
        values(*x, row.as_slice_mut().expect("contiguous"));
    }
    matrix
}

/// Samples on a tensor grid of nodes → coefficients, along the first `axes` axes.
pub fn coefficients(samples: ArrayD<f64>, axes: usize) -> ArrayD<f64> {
    along_axes(samples, axes, transform)
}

/// Coefficients → samples on the tensor grid of nodes, along the first `axes` axes.
pub fn samples(coefficients: ArrayD<f64>, axes: usize) -> ArrayD<f64> {
    along_axes(coefficients, axes, inverse_transform)
}

/// The square matrices that `of` gives for their lengths, applied to the first `axes` axes.
fn along_axes(array: ArrayD<f64>, axes: usize, of: impl Fn(usize) -> Array2<f64>) -> ArrayD<f64> {
    let shape = array.shape().to_vec();
    let mut values: Vec<f64> = array.as_standard_layout().iter().copied().collect();
    for axis in 0..axes {
        let matrix = of(shape[axis]);
        let block = shape[axis..].iter().product();
        let mut out = vec![0.0; values.len()];
        for (from, to) in values.chunks_exact(block).zip(out.chunks_exact_mut(block)) {
            transformed(&matrix, from, to);
        }
        values = out;
    }
    ArrayD::from_shape_vec(IxDyn(&shape), values).expect("as many as before")
}

/// `matrix` applied to the slowest axis of `from`.
fn transformed(matrix: &Array2<f64>, from: &[f64], to: &mut [f64]) {
    let row = from.len() / matrix.nrows();
    vectorised(
        #[inline(always)]
        || {
            for (weights, to) in matrix.outer_iter().zip(to.chunks_exact_mut(row)) {
                for (w, from) in weights.iter().zip(from.chunks_exact(row)) {
                    for (sum, x) in to.iter_mut().zip(from) {
                        *sum += w * x;
                    }
                }
            }
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
