//! Sums and products over the axes of dense arrays, in vectors.
//!
//! In: numbers in storage order, the last axis running fastest. Out: the same, with an axis scaled,
//! summed out or multiplied. Every number is summed in the order of the axis, whatever the blocks, so
//! that the bits are the same on every machine.

use crate::expr::{real::Real, vectorised};

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
                for (part, w) in block.chunks_exact(right).zip(weights) {
                    for (s, x) in sum.iter_mut().zip(part) {
                        *s = *s + *w * real(x);
                    }
                }
            }
        },
    );
    sums
}

/// The sum of rows.
pub(super) fn added<T: Real>(rows: &[Vec<T>]) -> Vec<T> {
    let mut sum = rows[0].clone();
    for row in &rows[1..] {
        sum.iter_mut().zip(row).for_each(|(s, x)| *s = *s + *x);
    }
    sum
}

/// The product of the matrices `a` (rows of `inner`) and `b` (`inner` rows), summed in the order of
/// the rows of `b`.
pub fn product<T: Real>(a: &[T], inner: usize, b: &[T]) -> Vec<T> {
    // Columns that are summed at once, two vectors of them: with six rows all sums and what they are
    // made of stay in 16 registers. Longer blocks the compiler turns into scalar code.
    match size_of::<T>() {
        8 => product_by::<T, 8>(a, inner, b),
        _ => product_by::<T, 16>(a, inner, b),
    }
}

/// The same by blocks of `C` columns.
fn product_by<T: Real, const C: usize>(a: &[T], inner: usize, b: &[T]) -> Vec<T> {
    let width = b.len() / inner;
    let rows = a.len() / inner;
    let mut product = vec![T::ZERO; rows * width];
    let whole = width - width % C;
    let rest = rest(b, width, whole, C);
    vectorised(
        #[inline(always)]
        || {
            let mut row = 0;
            while row < rows {
                let (a, out) = (&a[row * inner..], &mut product[row * width..]);
                let b = (b, &rest[..], width);
                row += match rows - row {
                    6.. => band::<T, 6, C>(a, inner, b, out),
                    4.. => band::<T, 4, C>(a, inner, b, out),
                    2.. => band::<T, 2, C>(a, inner, b, out),
                    _ => band::<T, 1, C>(a, inner, b, out),
                };
            }
        },
    );
    product
}

/// The columns of `b` from `first` on, filled up with zeros to so many `columns`.
fn rest<T: Real>(b: &[T], width: usize, first: usize, columns: usize) -> Vec<T> {
    if first == width {
        return Vec::new();
    }
    let mut rest = vec![T::ZERO; b.len() / width * columns];
    for (to, line) in rest.chunks_exact_mut(columns).zip(b.chunks_exact(width)) {
        to[..width - first].copy_from_slice(&line[first..]);
    }
    rest
}

/// The first `R` rows of a product with `b` (and the [`rest`] of its columns) of so many columns; `R`.
#[inline(always)]
fn band<T: Real, const R: usize, const C: usize>(
    rows: &[T],
    inner: usize,
    (b, rest, width): (&[T], &[T], usize),
    out: &mut [T],
) -> usize {
    let whole = width - width % C;
    for column in (0..whole).step_by(C) {
        let sums = block::<T, R, C>(rows, inner, b, (width, column));
        for (row, sums) in out.chunks_exact_mut(width).zip(sums) {
            row[column..column + C].copy_from_slice(&sums);
        }
    }
    if whole < width {
        let sums = block::<T, R, C>(rows, inner, rest, (C, 0));
        for (row, sums) in out.chunks_exact_mut(width).zip(sums) {
            row[whole..].copy_from_slice(&sums[..width - whole]);
        }
    }
    R
}

/// `C` columns of them from `column` on: sums that stay in registers.
#[inline(always)]
fn block<T: Real, const R: usize, const C: usize>(
    rows: &[T],
    inner: usize,
    b: &[T],
    (width, column): (usize, usize),
) -> [[T; C]; R] {
    let mut sums = [[T::ZERO; C]; R];
    for (k, line) in b.chunks_exact(width).enumerate() {
        let Some(line) = line[column..].first_chunk::<C>() else {
            break;
        };
        for r in 0..R {
            let x = rows[r * inner + k];
            for c in 0..C {
                sums[r][c] = sums[r][c] + x * line[c];
            }
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_of_all_shapes_are_those_of_the_definition() {
        for (rows, inner, width) in [(1, 1, 1), (3, 5, 7), (4, 2, 16), (9, 6, 37), (8, 3, 20)] {
            let number = |i: usize| ((i * 37 % 101) as f64 - 50.0) / 7.0;
            let a: Vec<f64> = (0..rows * inner).map(number).collect();
            let b: Vec<f64> = (0..inner * width).map(|i| number(i + 13)).collect();
            let found = product(&a, inner, &b);
            for r in 0..rows {
                for c in 0..width {
                    let terms = (0..inner).map(|k| a[r * inner + k] * b[k * width + c]);
                    assert_eq!(found[r * width + c], terms.fold(0.0, |sum, x| sum + x));
                }
            }
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
