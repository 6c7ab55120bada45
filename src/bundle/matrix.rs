//! Sums and products over the axes of dense arrays, in vectors.
//!
//! In: numbers in storage order, the last axis running fastest. Out: the same, with an axis scaled,
//! summed out or multiplied. Every number is summed in the order of the axis, whatever the blocks, so
//! that the bits are the same on every machine.

use crate::expr::vectorised;

/// The numbers of rows as long as `factors`, times these.
pub(super) fn scaled<T>(values: &[T], real: impl Fn(&T) -> f64, factors: &[f64]) -> Vec<f64> {
    let mut to = vec![0.0; values.len()];
    vectorised(
        #[inline(always)]
        || {
            let rows = values.chunks_exact(factors.len());
            for (to, row) in to.chunks_exact_mut(factors.len()).zip(rows) {
                for ((to, x), factor) in to.iter_mut().zip(row).zip(factors) {
                    *to = real(x) * factor;
                }
            }
        },
    );
    to
}

/// `Σ_i w_i x[a, i, b]` for an array (left, weights, right).
pub(super) fn summed<T>(
    values: &[T],
    real: impl Fn(&T) -> f64,
    left: usize,
    right: usize,
    weights: &[f64],
) -> Vec<f64> {
    let mut sums = vec![0.0; left * right];
    vectorised(
        #[inline(always)]
        || {
            let blocks = values.chunks_exact(weights.len() * right);
            for (sum, block) in sums.chunks_exact_mut(right).zip(blocks) {
                for (part, w) in block.chunks_exact(right).zip(weights) {
                    for (s, x) in sum.iter_mut().zip(part) {
                        *s += w * real(x);
                    }
                }
            }
        },
    );
    sums
}

/// The product of the matrices `a` (rows of `inner`) and `b` (`inner` rows), summed in the order of
/// the rows of `b`.
pub(super) fn product(a: &[f64], inner: usize, b: &[f64]) -> Vec<f64> {
    let width = b.len() / inner;
    let mut product = vec![0.0; a.len() / inner * width];
    vectorised(
        #[inline(always)]
        || {
            const ROWS: usize = 4;
            let bands = a.chunks(ROWS * inner).zip(product.chunks_mut(ROWS * width));
            for (rows, out) in bands {
                match rows.len() / inner {
                    ROWS => band::<ROWS>(rows, inner, b, out),
                    _ => {
                        let single = rows.chunks_exact(inner).zip(out.chunks_exact_mut(width));
                        single.for_each(|(row, out)| band::<1>(row, inner, b, out));
                    }
                }
            }
        },
    );
    product
}

/// `R` rows of a product, by blocks of columns whose sums stay in registers.
#[inline(always)]
fn band<const R: usize>(rows: &[f64], inner: usize, b: &[f64], out: &mut [f64]) {
    let width = out.len() / R;
    let mut column = 0;
    while column < width {
        column += match width - column {
            16.. => block::<R, 16>(rows, inner, b, (width, column), out),
            4.. => block::<R, 4>(rows, inner, b, (width, column), out),
            _ => block::<R, 1>(rows, inner, b, (width, column), out),
        };
    }
}

/// `C` columns of them from `column` on; `C`.
#[inline(always)]
fn block<const R: usize, const C: usize>(
    rows: &[f64],
    inner: usize,
    b: &[f64],
    (width, column): (usize, usize),
    out: &mut [f64],
) -> usize {
    let mut sums = [[0.0; C]; R];
    for (k, line) in b.chunks_exact(width).enumerate() {
        let Some(line) = line[column..].first_chunk::<C>() else {
            break;
        };
        for r in 0..R {
            let x = rows[r * inner + k];
            for c in 0..C {
                sums[r][c] += x * line[c];
            }
        }
    }
    for (row, sums) in out.chunks_exact_mut(width).zip(sums) {
        row[column..column + C].copy_from_slice(&sums);
    }
    C
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
