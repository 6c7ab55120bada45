//! Sums and products over the axes of dense arrays, in vectors.
//!
//! In: numbers in storage order, the last axis running fastest. Out: the same, with an axis scaled,
//! summed out or multiplied. Every number is summed in the order of the axis, whatever the blocks, so
//! that the bits are the same however many threads there are, and on all machines that add products
//! without rounding them.

use crate::expr::{real::Real, vectorised};
use fearless_simd::{Level, Simd, SimdBase, SimdFloat, dispatch};
use std::array::from_fn;

/// The numbers of rows as long as `factors`, times these.
pub(super) fn scaled<N, T: Real>(values: &[N], real: impl Fn(&N) -> T, factors: &[T]) -> Vec<T> {
    let mut to = vec![T::ZERO; values.len()];
    vectorised(
        #[inline(always)]
        || {
            let rows = values.chunks_exact(factors.len());
            for (to, row) in to.chunks_exact_mut(factors.len()).zip(rows) {
                for ((to, x), factor) in to.iter_mut().zip(row).zip(factors) {
                    *to = real(x) * *factor;
                }
            }
        },
    );
    to
}

/// `Σ_i w_i x[a, i, b]` for an array (left, weights, right).
pub(super) fn summed<N, T: Real>(
    values: &[N],
    real: impl Fn(&N) -> T,
    left: usize,
    right: usize,
    weights: &[T],
) -> Vec<T> {
    let mut sums = vec![T::ZERO; left * right];
    vectorised(
        #[inline(always)]
        || {
            let blocks = values.chunks_exact(weights.len() * right);
            for (sum, block) in sums.chunks_exact_mut(right).zip(blocks) {
                match right <= NEAR {
                    true => add_columns(sum, block, &real, weights),
                    false => add_rows(sum, block, &real, weights),
                }
            }
        },
    );
    sums
}

/// Longest rows of which a few columns at a time are added up: those of longer rows lie too far apart.
const NEAR: usize = 1024;

/// Adds weighted rows, one after the other.
#[inline(always)]
fn add_rows<N, T: Real>(sum: &mut [T], rows: &[N], real: &impl Fn(&N) -> T, weights: &[T]) {
    for (row, w) in rows.chunks_exact(sum.len()).zip(weights) {
        for (s, x) in sum.iter_mut().zip(row) {
            *s += *w * real(x);
        }
    }
}

/// The same, a few columns after the other: their sums stay in registers.
#[inline(always)]
fn add_columns<N, T: Real>(sum: &mut [T], rows: &[N], real: &impl Fn(&N) -> T, weights: &[T]) {
    const MANY: usize = 64;
    const FEW: usize = 16;
    let mut first = 0;
    while first < sum.len() {
        first += match sum.len() - first {
            MANY.. => add_some::<N, T, MANY>(sum, first, rows, real, weights),
            FEW.. => add_some::<N, T, FEW>(sum, first, rows, real, weights),
            _ => add_some::<N, T, 1>(sum, first, rows, real, weights),
        };
    }
}

/// The sums of `C` columns from the `first` on; `C`.
#[inline(always)]
fn add_some<N, T: Real, const C: usize>(
    sum: &mut [T],
    first: usize,
    rows: &[N],
    real: &impl Fn(&N) -> T,
    weights: &[T],
) -> usize {
    let mut sums = [T::ZERO; C];
    for (row, w) in rows.chunks_exact(sum.len()).zip(weights) {
        if let Some(row) = row[first..].first_chunk::<C>() {
            for c in 0..C {
                sums[c] += *w * real(&row[c]);
            }
        }
    }
    sum[first..first + C].copy_from_slice(&sums);
    C
}

/// The sum of rows.
pub(super) fn added<T: Real>(rows: &[Vec<T>]) -> Vec<T> {
    let mut sum = rows[0].clone();
    for row in &rows[1..] {
        sum.iter_mut().zip(row).for_each(|(s, x)| *s += *x);
    }
    sum
}

/// The product of the matrices `a` (rows of `inner`) and `b` (`inner` rows), summed in the order of
/// the rows of `b`; where the machine can, terms are added without being rounded first.
pub fn product<T: Real>(a: &[T], inner: usize, b: &[T]) -> Vec<T> {
    dispatch!(Level::new(), simd => simd.vectorize(
        #[inline(always)]
        || panels(simd, a, inner, b),
    ))
}

/// Rows of a block, and of those for the rows that are left over. With the vectors that its sums are made of
/// it just fits sixteen registers of 32 bytes.
const ROWS: usize = 6;
const REST: usize = 2;

/// Rows of `b` for which the ends of slices are looked at once.
const STRIDE: usize = 8;

/// The same by as many columns at a time as a vector has: they stay in the cache for all rows.
#[inline(always)]
fn panels<S: Simd, T: Real>(simd: S, a: &[T], inner: usize, b: &[T]) -> Vec<T> {
    let (rows, width, lanes) = (a.len() / inner, b.len() / inner, T::Vector::<S>::LEN);
    let mut product = vec![T::ZERO; rows * width];
    let rest = rest(b, width, lanes);
    for column in (0..width).step_by(lanes) {
        let panel = match column + lanes <= width {
            true => (b, width, column),
            false => (&rest[..], lanes, 0),
        };
        down(simd, (a, inner), panel, (&mut product, width, column));
    }
    product
}

/// The same where `b` is of other numbers, of which `real` makes real ones: a few columns at a time, which
/// stay in the cache until they are multiplied.
pub(super) fn product_of<N, T: Real>(
    a: &[T],
    inner: usize,
    b: &[N],
    real: impl Fn(&N) -> T,
) -> Vec<T> {
    dispatch!(Level::new(), simd => simd.vectorize(
        #[inline(always)]
        || made(simd, a, inner, b, &real),
    ))
}

/// Columns made real at a time, a whole number of vectors.
const MADE: usize = 128;

#[inline(always)]
fn made<S: Simd, N, T: Real>(
    simd: S,
    a: &[T],
    inner: usize,
    b: &[N],
    real: impl Fn(&N) -> T,
) -> Vec<T> {
    let (rows, width, lanes) = (a.len() / inner, b.len() / inner, T::Vector::<S>::LEN);
    let mut product = vec![T::ZERO; rows * width];
    let stride = MADE.min(width.next_multiple_of(lanes));
    let mut columns = vec![T::ZERO; inner * stride];
    for first in (0..width).step_by(MADE) {
        let count = MADE.min(width - first);
        for (to, line) in columns.chunks_exact_mut(stride).zip(b.chunks_exact(width)) {
            for (to, x) in to.iter_mut().zip(&line[first..first + count]) {
                *to = real(x);
            }
        }
        for column in (0..count).step_by(lanes) {
            let panel = (&columns[..], stride, column);
            down(
                simd,
                (a, inner),
                panel,
                (&mut product, width, first + column),
            );
        }
    }
    product
}

/// All rows of a product in the columns of one vector.
#[inline(always)]
fn down<S: Simd, T: Real>(
    simd: S,
    (a, inner): (&[T], usize),
    panel: (&[T], usize, usize),
    (product, width, column): (&mut [T], usize, usize),
) {
    let rows = a.len() / inner;
    let mut row = 0;
    while row < rows {
        let (a, to) = (&a[row * inner..], &mut product[row * width..]);
        let to = (to, width, column);
        row += match rows - row {
            ROWS.. => block::<S, T, ROWS>(simd, (a, inner), panel, to),
            REST.. => block::<S, T, REST>(simd, (a, inner), panel, to),
            _ => block::<S, T, 1>(simd, (a, inner), panel, to),
        };
    }
}

/// The last columns of `b`, fewer than `lanes`, filled up with zeros.
fn rest<T: Real>(b: &[T], width: usize, lanes: usize) -> Vec<T> {
    let first = width - width % lanes;
    if first == width {
        return Vec::new();
    }
    let mut rest = vec![T::ZERO; b.len() / width * lanes];
    for (to, line) in rest.chunks_exact_mut(lanes).zip(b.chunks_exact(width)) {
        to[..width - first].copy_from_slice(&line[first..]);
    }
    rest
}

/// The first `R` rows of a product in the columns of one vector, from column `first` of `b` on: sums that
/// stay in registers; `R`.
#[inline(always)]
fn block<S: Simd, T: Real, const R: usize>(
    simd: S,
    (a, inner): (&[T], usize),
    (b, stride, first): (&[T], usize, usize),
    (to, width, column): (&mut [T], usize, usize),
) -> usize {
    let lanes = T::Vector::<S>::LEN;
    let mut sums = [T::Vector::<S>::splat(simd, T::ZERO); R];
    let rows: [(&[[T; STRIDE]], &[T]); R] = from_fn(
        #[inline(always)]
        |r| a[r * inner..][..inner].as_chunks(),
    );
    let mut lines = b.chunks_exact(STRIDE * stride);
    for (k, lines) in lines.by_ref().take(inner / STRIDE).enumerate() {
        let x: [&[T; STRIDE]; R] = from_fn(
            #[inline(always)]
            |r| &rows[r].0[k],
        );
        for j in 0..STRIDE {
            add_line(simd, &mut sums, &lines[j * stride + first..], |r| x[r][j]);
        }
    }
    for (k, line) in lines.remainder().chunks_exact(stride).enumerate() {
        add_line(simd, &mut sums, &line[first..], |r| rows[r].1[k]);
    }
    for (row, sum) in to.chunks_mut(width).zip(&sums) {
        let to = &mut row[column..width.min(column + lanes)];
        match to.len() == lanes {
            true => sum.store_slice(to),
            false => to.copy_from_slice(&sum.as_slice()[..to.len()]),
        }
    }
    R
}

/// Adds the first numbers of a `line`, times the `factor` of each row, to the sums.
#[inline(always)]
fn add_line<S: Simd, T: Real, const R: usize>(
    simd: S,
    sums: &mut [T::Vector<S>; R],
    line: &[T],
    factor: impl Fn(usize) -> T,
) {
    let line = T::Vector::from_slice(simd, &line[..T::Vector::<S>::LEN]);
    for (r, sum) in sums.iter_mut().enumerate() {
        *sum = T::Vector::splat(simd, factor(r)).mul_add(line, *sum);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn test_product<T: Real>((rows, inner, width): (usize, usize, usize), accuracy: f64) {
        let number = |i: usize| T::from_f64(((i * 37 % 101) as f64 - 50.0) / 7.0);
        let a: Vec<T> = (0..rows * inner).map(number).collect();
        let b: Vec<T> = (0..inner * width).map(|i| number(i + 13)).collect();
        let found = product(&a, inner, &b);
        assert_eq!(found.len(), rows * width);
        for (place, found) in found.iter().enumerate() {
            let (r, c) = (place / width, place % width);
            let term = |k: usize| a[r * inner + k].to_f64() * b[k * width + c].to_f64();
            let sum: f64 = (0..inner).map(term).sum();
            let sizes: f64 = (0..inner).map(|k| term(k).abs()).sum();
            assert!((found.to_f64() - sum).abs() <= accuracy * inner as f64 * sizes);
        }
    }

    #[test]
    fn products_of_all_shapes_are_those_of_the_definition() {
        for shape in [
            (1, 1, 1),
            (3, 5, 7),
            (4, 8, 16),
            (9, 6, 37),
            (8, 31, 20),
            (19, 24, 33),
        ] {
            test_product::<f64>(shape, f64::EPSILON);
            test_product::<f32>(shape, f32::EPSILON.into());
        }
    }

    #[test]
    fn an_axis_is_summed_out_with_weights() {
        let values: Vec<i32> = (0..2 * 3 * 4).collect();
        let sums = summed(&values, |x| f64::from(*x), 2, 4, &[1.0, 0.0, -1.0]);
        assert_eq!(sums, [-8.0; 8]);
        assert_eq!(
            scaled(&[1.0, 2.0, 3.0, 4.0], |x| *x, &[1.0, 10.0]),
            [1.0, 20.0, 3.0, 40.0]
        );
    }
}
