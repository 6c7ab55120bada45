//! Real numbers → integers that are worth their bits.
//!
//! In: numbers in units of the step, in storage order. Out: integers. The nearest integer is not always
//! the best: between two, the smaller is taken where the larger would cost more bits than its error is
//! worth. How many bits that is depends on what stands before it, so it is counted for each class of
//! places ([`Sizes`]) in a first rounding. Source: G. J. Sullivan, *Efficient scalar quantization of
//! exponential and Laplacian random variables*, IEEE Trans. Inf. Theory 42 (1996), with the rates
//! that were counted.
//!
//! How coarsely coefficients are rounded, by their degree along the arc length.

use crate::parallel::*;
use crate::{
    coder::CLASSES,
    context::{Sizes, Walk},
    householder::reduced,
};
use geofan_expr::real::Real;
use ndarray::{Array2, ArrayD};

/// How much squared error, in squared steps, a bit is worth. Fine rounding has the slope `ln 2 / 6 =
/// 0.12`, and where most integers are zero it is larger. Three bumps on a rail and on a quarter of the
/// floor take 0.99, 0.97, 0.96 and 0.95 times as much with 0.08, 0.12, 0.16 and 0.2 as the nearest
/// integers that `FIRST` gives, and no less with 0.25 to 0.4.
const WORTH: f64 = 0.2;

/// By what share of a step numbers are moved towards zero before they are rounded first.
const FIRST: f64 = 0.1;

/// Sizes that are counted one by one: 0, 1, 2, and all larger ones.
const SIZES: usize = 4;

/// The most bits that one more in size is believed to cost, from 0, 1 and 2 on.
const MOST_BITS: [f64; SIZES - 1] = [12.0, 6.0, 1.5];

/// By what share of a step numbers between the sizes 0 and 1, 1 and 2, and larger ones are moved towards
/// zero.
type Dead = [f64; SIZES - 1];

/// Orthogonal vectors of this `length`, in units of the step, one after the other as a core of `shape`,
/// as integers that [`restored`](super::reflections::restored) makes them of.
pub(super) fn rounded(shape: &[usize], length: usize, vectors: &[f64]) -> Vec<i32> {
    let dead = dead_zones(shape, vectors);
    let (mut walk, mut sizes) = (Walk::new(shape), Sizes::default());
    reduced(vectors, length, |vector, taken, integers| {
        for (place, x) in vector.iter().enumerate() {
            walk.on(integers);
            integers.push(match taken.holds(place) {
                true => 0,
                false => {
                    walk.look(integers);
                    let size = size(x.abs(), &dead[sizes.class(&walk)]);
                    sizes.learn(&walk, size as u32);
                    with_sign(size, *x)
                }
            });
        }
    })
}

/// The same as the nearest integers.
pub(super) fn nearest(_: &[usize], length: usize, vectors: &[f64]) -> Vec<i32> {
    reduced(vectors, length, |vector, taken, integers| {
        let nearest = |(place, x): (usize, &f64)| match taken.holds(place) {
            true => 0,
            false => x.round() as i32,
        };
        integers.extend(vector.iter().enumerate().map(nearest));
    })
}

/// What is worth its bits in each class of places, as they are counted in a first rounding of numbers that
/// are not reduced.
fn dead_zones(shape: &[usize], values: &[f64]) -> [Dead; CLASSES] {
    let mut counts = [[1.0; SIZES]; CLASSES];
    let (mut walk, mut sizes) = (Walk::new(shape), Sizes::default());
    let mut integers = Vec::with_capacity(values.len());
    for x in values {
        let size = nearest_size(x.abs() - FIRST);
        walk.on(&integers);
        walk.look(&integers);
        counts[sizes.class(&walk)][(size as usize).min(SIZES - 1)] += 1.0;
        sizes.learn(&walk, size as u32);
        integers.push(with_sign(size, *x));
    }
    counts.map(|counts| dead(&counts))
}

fn with_sign(size: i32, x: f64) -> i32 {
    if x < 0.0 { -size } else { size }
}

/// Half of what the bits of one more in size are worth, of a class in which sizes were counted.
fn dead(counts: &[f64; SIZES]) -> Dead {
    std::array::from_fn(|size| {
        // The sign comes with the first.
        let sign = if size == 0 { 1.0 } else { 0.0 };
        let bits = (counts[size] / counts[size + 1]).log2() + sign;
        0.5 * WORTH * bits.clamp(0.0, MOST_BITS[size])
    })
}

/// The size that a number of size `x` is rounded to.
fn size(x: f64, dead: &Dead) -> i32 {
    if x < 0.5 + dead[0] {
        return 0;
    }
    if x < 1.5 + dead[1] {
        return 1;
    }
    nearest_size(x - dead[2]).max(2)
}

/// The integer nearest to `x`, not below zero.
fn nearest_size(x: f64) -> i32 {
    (x + 0.5) as i32
}

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
    let blocks = graded.par_chunks_mut(ROWS * row).enumerate();
    blocks.for_each(|(block, rows)| {
        for (number, to) in (ROWS * block..).zip(rows.chunks_exact_mut(row)) {
            let (mut rest, mut first) = (number, 0);
            for (length, stride) in &axes {
                first += rest % length * stride;
                rest /= length;
            }
            let from = values[first..first + row].iter().zip(&factors);
            to.iter_mut().zip(from).for_each(|(to, (x, f))| *to = x * f);
        }
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
    use geofan_core::random::Stream;

    #[test]
    fn numbers_are_rounded_to_one_of_their_neighbours_or_towards_zero() {
        let mut stream = Stream::new(&[3]);
        let shape = [20, 30, 40];
        let size = |i: usize| 300.0 * (-0.004 * (i % 1200) as f64).exp();
        let values: Vec<f64> = (0..shape.iter().product())
            .map(|i| size(i) * stream.between(-1.0, 1.0))
            .collect();
        let integers = rounded(&shape, values.len(), &values);
        let mut moved = 0;
        for (x, i) in values.iter().zip(&integers) {
            let (x, i) = (*x, f64::from(*i));
            assert!(
                (x - i).abs() <= 0.5
                    || (x.abs() > i.abs() && (x - i).abs() < 1.0 + MOST_BITS[0] * WORTH)
            );
            moved += usize::from((x - i).abs() > 0.5);
        }
        assert!(moved > 100 && moved < values.len() / 8, "{moved}");
    }

    /// A lone number that is hardly more than half a step is not worth its bits; among its like it is.
    #[test]
    fn what_is_expected_costs_little() {
        let alone = |i: usize| if i % 97 == 50 { 0.7 } else { 0.01 };
        let lone = rounded(&[4000], 4000, &(0..4000).map(alone).collect::<Vec<_>>());
        assert!(lone.iter().all(|i| *i == 0));
        let among = |i: usize| if i.is_multiple_of(3) { 0.7 } else { 2.3 };
        let common = rounded(&[4000], 4000, &(0..4000).map(among).collect::<Vec<_>>());
        assert!(common.iter().filter(|i| **i == 1).count() > 1000);
    }
}

#[cfg(test)]
mod grade_tests {
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
