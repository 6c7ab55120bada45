//! How coarsely coefficients are rounded, by their degree along the arc length.

use crate::parallel::*;
use geofan_expr::real::Real;
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

/// The same in storage order, with the axes but the last two in this `order`: all at once, because large
/// polynomials are written as fast as memory takes them.
pub fn graded_in_order(coefficients: &ArrayD<f64>, order: &[usize]) -> Vec<f64> {
    let coefficients = coefficients.as_standard_layout();
    let shape = coefficients.shape();
    let channels = shape[order.len() + 1];
    let row: usize = shape[order.len()..].iter().product();
    let factors: Vec<f64> = (0..row).map(|i| 1.0 / coarseness(i / channels)).collect();
    let stride = |axis: &usize| -> usize { shape[axis + 1..].iter().product() };
    let axes = order.iter().rev().map(|axis| (shape[*axis], stride(axis)));
    let axes: Vec<(usize, usize)> = axes.collect();
    let values = coefficients.as_slice().unwrap_or_default();
    let mut graded = vec![0.0; values.len()];
    let rows = graded.par_chunks_exact_mut(row).enumerate();
    rows.with_min_len(ROWS).for_each(|(number, to)| {
        let (mut rest, mut first) = (number, 0);
        for (length, stride) in &axes {
            first += rest % length * stride;
            rest /= length;
        }
        let from = values[first..first + row].iter().zip(&factors);
        to.iter_mut().zip(from).for_each(|(to, (x, f))| *to = x * f);
    });
    graded
}

/// Rows of arc lengths and channels that one thread writes at least.
const ROWS: usize = 64;

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
        row.iter_mut().for_each(|x| *x *= *factor);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::IxDyn;

    #[test]
    fn axes_change_places_before_or_after_grading() {
        let shape = [3, 4, 2, 5, 3];
        let value = |i: IxDyn| (0..5).fold(0.0, |sum, a| 10.0 * sum + i[a] as f64);
        let coefficients = ArrayD::from_shape_fn(IxDyn(&shape), value);
        for order in [[0, 1, 2], [2, 0, 1], [1, 2, 0]] {
            let all = [&order[..], &[3, 4]].concat();
            let permuted = graded(&coefficients).permuted_axes(IxDyn(&all));
            let found = graded_in_order(&coefficients, &order);
            assert!(permuted.iter().eq(&found), "{order:?}");
        }
    }
}
