//! How coarsely coefficients are rounded, by their degree along the arc length.

use crate::expr::real::Real;
use ndarray::{Array2, ArrayD};

/// How much more coarsely coefficients of degree `k` along the arc length are rounded: an error of that
/// degree in the slope moves points by 1/k of it. With the degree itself instead of its root tangents
/// suffer (three bumps on a rail 318 kB, 281 kB with the root, 326 kB without).
fn coarseness(degree: usize) -> f64 {
    ((1 + degree) as f64).sqrt()
}

/// Coefficients (…, arc length, channel) as they are rounded.
pub fn graded(coefficients: &ArrayD<f64>) -> ArrayD<f64> {
    by_degree(coefficients, |degree| 1.0 / coarseness(degree))
}

/// What [`graded`] makes these `coefficients` of.
pub fn ungraded(coefficients: &ArrayD<f64>) -> ArrayD<f64> {
    by_degree(coefficients, coarseness)
}

/// Each coefficient times the factor of its degree along the arc length.
fn by_degree(coefficients: &ArrayD<f64>, factor: impl Fn(usize) -> f64) -> ArrayD<f64> {
    let [degrees, channels] = [2, 1].map(|i| coefficients.shape()[coefficients.ndim() - i]);
    coefficients * &Array2::from_shape_fn((degrees, channels), |(k, _)| factor(k))
}

/// What [`graded`] did to `values` of a core of `shape`, whose last axes are arc length and channel.
pub(super) fn ungrade<T: Real>(values: &mut [T], shape: &[usize]) {
    let [degrees, channels] = [shape[shape.len() - 3], shape[shape.len() - 2]];
    let factors: Vec<T> = (0..degrees).map(|k| T::from_f64(coarseness(k))).collect();
    let rows = values.chunks_exact_mut(channels);
    for (row, factor) in rows.zip(factors.iter().cycle()) {
        row.iter_mut().for_each(|x| *x = *x * *factor);
    }
}
