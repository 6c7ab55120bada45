//! How coarsely coefficients are rounded, by their degree along the arc length.

use crate::expr::real::Real;
use ndarray::{Array2, ArrayD};

/// How much more coarsely coefficients of degree `k` along the arc length are rounded: by `(1 + k)^(5/8)`.
/// An error of that degree in the slope moves points by 1/k of it, but tangents by all of it. With powers
/// of 0.3, 0.4, 0.5, 0.6, 0.7 and 0.8 three bumps on a rail take 116, 112, 108, 106, 104 and 108 kB, on a
/// quarter of the floor 627, 590, 577, 565, 558 and 602; with 0.9 tangents exceed the promise.
fn coarseness(degree: usize) -> f64 {
    let root = ((1 + degree) as f64).sqrt();
    // Roots are the same on every machine.
    root * root.sqrt().sqrt()
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
