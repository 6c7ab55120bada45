//! Sums, products and choices in all lanes at once.

use super::{LANES, Row, each};
use geofan_expr::real::Real;

/// `row *= by`
#[inline(always)]
pub(super) fn multiply(row: &mut Row, by: &Row) {
    for l in 0..LANES {
        row[l] *= by[l];
    }
}

/// The three rows of the vector that begins at row `at`.
#[inline(always)]
pub(super) fn vector(rows: &[Row], at: usize) -> [&Row; 3] {
    [&rows[at], &rows[at + 1], &rows[at + 2]]
}

/// `xᵀGx`; metric entries in the order xx, yy, zz, xy, xz, yz.
#[inline(always)]
pub(super) fn norm2(metric: [&[f64; LANES]; 6], [x, y, z]: [&Row; 3]) -> Row {
    let [xx, yy, zz, xy, xz, yz] = metric;
    each(|l| {
        let [a, b, c] = [x[l], y[l], z[l]];
        let mixed = a * b * xy[l] + a * c * xz[l] + b * c * yz[l];
        a * a * xx[l] + b * b * yy[l] + c * c * zz[l] + 2.0 * mixed
    })
}

/// The larger of two numbers; NaN wins, so that a broken estimate is never accepted.
#[inline(always)]
pub(super) fn larger(a: f64, b: f64) -> f64 {
    if (a < b) | b.is_nan() { b } else { a }
}

/// Copies the lanes of `from` where `mask` is 1.
// A vector at a time through local arrays, all of it read first: a choice between two places in
// memory would be a branch for each lane.
#[inline(always)]
pub(super) fn take_where(mask: &Row, from: &[Row], to: &mut [Row]) {
    let (masks, _) = mask.as_chunks::<8>();
    for (from, to) in from.iter().zip(to) {
        let ((from, _), (to, _)) = (from.as_chunks::<8>(), to.as_chunks_mut::<8>());
        for ((mask, new), to) in masks.iter().zip(from).zip(to) {
            let (mask, new, old) = (*mask, *new, *to);
            let mut chosen = old;
            for l in 0..8 {
                chosen[l] = f64::select(mask[l] > 0.0, new[l], old[l]);
            }
            *to = chosen;
        }
    }
}
