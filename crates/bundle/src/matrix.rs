//! Sums and products over the axes of dense arrays, in vectors.
//!
//! In: numbers in storage order, the last axis running fastest. Out: arrays with an axis scaled,
//! summed out or multiplied. Every number is summed in the order of the axis, whatever the blocks, so
//! that the bits are the same however many threads there are, and on all machines that add products
//! without rounding them.

use crate::packed_matrix::{LANES, Lane16};
use fearless_simd::{Level, Simd, SimdBase, SimdFloat, dispatch};
use geofan_expr::{real::Real, vectorised};
use std::{array::from_fn, ops::Range};

/// Multiplies the numbers of rows as long as `factors` by these.
pub(crate) fn scale<T: Real>(values: &mut [T], factors: &[T]) {
    vectorised(
        #[inline(always)]
        || {
            for row in values.chunks_exact_mut(factors.len()) {
                for (x, factor) in row.iter_mut().zip(factors) {
                    *x *= *factor;
                }
            }
        },
    );
}

/// Computes `Σ_i w_i x[a, i, b]` of an array (left, weights, right).
pub(crate) fn summed<T: Real>(values: &[T], left: usize, right: usize, weights: &[T]) -> Vec<T> {
    let mut sums = vec![T::ZERO; left * right];
    vectorised(
        #[inline(always)]
        || {
            let blocks = values.chunks_exact(weights.len() * right);
            for (sum, block) in sums.chunks_exact_mut(right).zip(blocks) {
                for (row, w) in block.chunks_exact(right).zip(weights) {
                    for (s, x) in sum.iter_mut().zip(row) {
                        *s += *w * *x;
                    }
                }
            }
        },
    );
    sums
}

/// Adds rows.
pub(crate) fn added<T: Real>(rows: &[Vec<T>]) -> Vec<T> {
    let mut sum = rows[0].clone();
    for row in &rows[1..] {
        sum.iter_mut().zip(row).for_each(|(s, x)| *s += *x);
    }
    sum
}

/// Multiplies the matrices `a` (rows of `inner`) and `b` (`inner` rows), summed in the order of the rows of
/// `b`; where the machine can, terms are added without being rounded first.
pub fn product<T: Real>(a: &[T], inner: usize, b: &[T]) -> Vec<T> {
    let width = b.len() / inner;
    product_of_first((a, inner), (b, width), width)
}

/// Multiplies the matrices `a` (rows of `inner`) and `b` (`inner` rows), for other crates: with the function for numbers of
/// any kind each would have a copy of all loops.
pub fn double_product(a: &[f64], inner: usize, b: &[f64]) -> Vec<f64> {
    product(a, inner, b)
}

/// Multiplies `a` and the first `width` columns of a `b` that has `stride` of them.
pub fn product_of_first<T: Real>(
    (a, inner): (&[T], usize),
    (b, stride): (&[T], usize),
    width: usize,
) -> Vec<T> {
    dispatch!(Level::new(), simd => simd.vectorize(
        #[inline(always)]
        || by_columns(simd, (a, inner), (b, stride), width),
    ))
}

/// The most rows of a block. With the vectors that its sums are made of it just fits sixteen registers of 32
/// bytes. Eight or twelve in the 32 registers of 64 bytes were no faster.
const ROWS: usize = 6;

/// Rows of `b` for which the ends of slices are checked once. In a page, which carries every copy of the loops along,
/// they are few.
const STRIDE: usize = if cfg!(target_family = "wasm") { 2 } else { 8 };

/// Columns of a product that are one vector wide, or its last.
struct ColumnBlock<'b, T> {
    /// The rows of `b`, each beginning with the vector that the columns are made of.
    numbers: &'b [T],
    /// Number of rows before zeros alone.
    depth: usize,
    columns: Range<usize>,
}

/// Multiplies by as many columns at a time as a vector or two have: they stay in the cache for all rows.
#[inline(always)]
fn by_columns<S: Simd, T: Real>(
    simd: S,
    (a, inner): (&[T], usize),
    (b, stride): (&[T], usize),
    width: usize,
) -> Vec<T> {
    let lanes = T::Vector::<S>::LEN;
    let mut product = vec![T::ZERO; a.len() / inner * width];
    if stride < lanes {
        let wide = widened(b, stride, lanes);
        let columns_of = |_| ColumnBlock {
            numbers: &wide,
            depth: inner,
            columns: 0..width,
        };
        let to = (&mut product[..], width);
        across(simd, (a, inner), (1, lanes, columns_of), to);
        return product;
    }
    let columns_of = |vector: usize| {
        // The last begins earlier if there are fewer columns left.
        let first = (vector * lanes).min(stride - lanes);
        ColumnBlock {
            numbers: &b[first..],
            depth: inner,
            columns: first..width.min(first + lanes),
        }
    };
    let to = (&mut product[..], width);
    across(
        simd,
        (a, inner),
        (width.div_ceil(lanes), stride, columns_of),
        to,
    );
    product
}

/// Multiplies `a` and a `b` of `width` columns that is made panel by panel: `next` writes the next sixteen
/// columns for all rows, and returns their range and the number of rows before zeros alone. So they stay in
/// the cache until they are multiplied. Panels that follow each other had better have as many rows.
pub fn product_of<T: Real>(
    (a, inner): (&[T], usize),
    width: usize,
    next: impl FnMut(&mut [Lane16<T>]) -> Option<(Range<usize>, usize)>,
) -> Vec<T> {
    dispatch!(Level::new(), simd => simd.vectorize(
        #[inline(always)]
        || by_made_panels(simd, (a, inner), width, next),
    ))
}

/// Multiplies by two panels at a time.
#[inline(always)]
fn by_made_panels<S: Simd, T: Real>(
    simd: S,
    (a, inner): (&[T], usize),
    width: usize,
    mut next: impl FnMut(&mut [Lane16<T>]) -> Option<(Range<usize>, usize)>,
) -> Vec<T> {
    let lanes = T::Vector::<S>::LEN;
    let mut product = vec![T::ZERO; a.len() / inner * width];
    let mut panels = vec![[T::ZERO; LANES]; 2 * inner];
    while let Some((first, depth)) = next(&mut panels[..inner]) {
        // The next panel beside it, both as deep, zeros where they are not.
        let second = next(&mut panels[inner..]);
        let count = 1 + usize::from(second.is_some());
        let (second, other) = second.unwrap_or((0..0, 0));
        let deepest = depth.max(other);
        panels[depth..deepest].fill([T::ZERO; LANES]);
        panels[inner + other..inner + deepest].fill([T::ZERO; LANES]);
        // The columns that each vector of the two stands for.
        let columns_of = |vector: usize| {
            let (panel, place) = (vector * lanes / LANES, vector * lanes % LANES);
            let columns = [&first, &second][panel];
            let start = columns.end.min(columns.start + place);
            ColumnBlock {
                numbers: &panels[panel * inner..].as_flattened()[place..],
                depth: deepest,
                columns: start..columns.end.min(start + lanes),
            }
        };
        let to = (&mut product[..], width);
        across(
            simd,
            (a, inner),
            (count * LANES / lanes, LANES, columns_of),
            to,
        );
    }
    product
}

/// Computes all rows of a product in `count` blocks of columns, which `columns_of` gives by their number; rows
/// of `b` are `stride` apart.
#[inline(always)]
fn across<'b, S: Simd, T: Real>(
    simd: S,
    (a, inner): (&[T], usize),
    (count, stride, columns_of): (usize, usize, impl Fn(usize) -> ColumnBlock<'b, T>),
    (product, width): (&mut [T], usize),
) {
    // Sums of one vector wait for each other where it is one register; two such fit 32 of them.
    let two = S::f32s::LEN >= 16;
    let mut vector = 0;
    while vector < count {
        let first = columns_of(vector);
        if two && vector + 1 < count {
            let second = columns_of(vector + 1);
            let depth = first.depth.max(second.depth);
            let lines = [first.numbers, second.numbers];
            let to = (&mut *product, width, [first.columns, second.columns]);
            down::<S, T, 2>(simd, (a, inner, depth), (lines, stride), to);
            vector += 2;
        } else {
            let to = (&mut *product, width, [first.columns]);
            down::<S, T, 1>(simd, (a, inner, first.depth), ([first.numbers], stride), to);
            vector += 1;
        }
    }
}

/// Computes all rows of a product in the columns of `V` vectors, of which `depth` rows are not zero.
#[inline(always)]
fn down<S: Simd, T: Real, const V: usize>(
    simd: S,
    (a, inner, depth): (&[T], usize, usize),
    lines: ([&[T]; V], usize),
    (product, width, columns): (&mut [T], usize, [Range<usize>; V]),
) {
    let rows = a.len() / inner;
    let mut row = 0;
    for left in (1..=rows.div_ceil(ROWS)).rev() {
        let (x, to) = (&a[row * inner..], &mut product[row * width..]);
        let (x, to) = ((x, inner, depth), (to, width, &columns));
        // Blocks are as high as each other: low ones read `b` for few products.
        row += match (rows - row).div_ceil(left) {
            ROWS.. => block::<S, T, ROWS, V>(simd, x, lines, to),
            5 => block::<S, T, 5, V>(simd, x, lines, to),
            4 => block::<S, T, 4, V>(simd, x, lines, to),
            3 => block::<S, T, 3, V>(simd, x, lines, to),
            2 => block::<S, T, 2, V>(simd, x, lines, to),
            _ => block::<S, T, 1, V>(simd, x, lines, to),
        };
    }
}

/// Widens rows of `width` numbers with zeros to `lanes`.
pub(crate) fn widened<T: Real>(b: &[T], width: usize, lanes: usize) -> Vec<T> {
    let mut wide = vec![T::ZERO; b.len() / width * lanes];
    for (to, line) in wide.chunks_exact_mut(lanes).zip(b.chunks_exact(width)) {
        to[..width].copy_from_slice(line);
    }
    wide
}

/// Computes the first `R` rows of a product in the first columns of some, `V` vectors of them or as many as
/// there are, and returns `R`: sums that stay in registers. Rows of `b` are `stride` apart.
#[inline(always)]
fn block<S: Simd, T: Real, const R: usize, const V: usize>(
    simd: S,
    (a, inner, depth): (&[T], usize, usize),
    (b, stride): ([&[T]; V], usize),
    (to, width, columns): (&mut [T], usize, &[Range<usize>; V]),
) -> usize {
    let lanes = T::Vector::<S>::LEN;
    let mut sums = [[T::Vector::<S>::splat(simd, T::ZERO); V]; R];
    let rows: [(&[[T; STRIDE]], &[T]); R] = from_fn(
        #[inline(always)]
        |r| a[r * inner..][..depth].as_chunks(),
    );
    let strides = depth / STRIDE;
    for k in 0..strides {
        let x: [&[T; STRIDE]; R] = from_fn(
            #[inline(always)]
            |r| &rows[r].0[k],
        );
        let lines = b.map(
            #[inline(always)]
            |b| &b[k * STRIDE * stride..],
        );
        for j in 0..STRIDE {
            add_line(simd, &mut sums, lines, j * stride, |r| x[r][j]);
        }
    }
    for k in 0..depth % STRIDE {
        let line = (strides * STRIDE + k) * stride;
        add_line(simd, &mut sums, b, line, |r| rows[r].1[k]);
    }
    for (row, sums) in to.chunks_mut(width).zip(&sums) {
        for (columns, sum) in columns.iter().zip(sums) {
            let to = &mut row[columns.clone()];
            match to.len() == lanes {
                true => sum.store_slice(to),
                false => to.copy_from_slice(&sum.as_slice()[..to.len()]),
            }
        }
    }
    R
}

/// Adds the row of `b` at the offset `line`, times the `factor` of each row of `a`, to the sums.
#[inline(always)]
fn add_line<S: Simd, T: Real, const R: usize, const V: usize>(
    simd: S,
    sums: &mut [[T::Vector<S>; V]; R],
    lines: [&[T]; V],
    line: usize,
    factor: impl Fn(usize) -> T,
) {
    let line = lines.map(
        #[inline(always)]
        |b| T::Vector::from_slice(simd, &b[line..line + T::Vector::<S>::LEN]),
    );
    for (r, sums) in sums.iter_mut().enumerate() {
        let factor = T::Vector::splat(simd, factor(r));
        for (sum, line) in sums.iter_mut().zip(line) {
            *sum = factor.mul_add(line, *sum);
        }
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
        let values: Vec<f64> = (0..2 * 3 * 4).map(f64::from).collect();
        let sums = summed(&values, 2, 4, &[1.0, 0.0, -1.0]);
        assert_eq!(sums, [-8.0; 8]);
        let mut values = [1.0, 2.0, 3.0, 4.0];
        scale(&mut values, &[1.0, 10.0]);
        assert_eq!(values, [1.0, 20.0, 3.0, 40.0]);
    }
}
