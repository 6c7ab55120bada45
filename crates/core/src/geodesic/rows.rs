//! One number for every lane, and sums, products and choices in all lanes at once.

use geofan_expr::{Wide, real::Real};

/// Lanes: four of the widest vectors. With half of them the dispatch of a tape's instructions costs as
/// much as their arithmetic (a quarter more time for a lone bump); with twice as many, registers and
/// stages no longer stay in the first-level cache.
pub(super) const LANES: usize = 32;

/// One number for every lane.
pub(super) type Row = Wide<f64, LANES>;

/// Zero in every lane.
pub(super) const NIL: Row = Wide([0.0; LANES]);

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

/// One number for each lane.
#[inline(always)]
pub(super) fn each(f: impl Fn(usize) -> f64) -> Row {
    let mut row = NIL;
    for l in 0..LANES {
        row[l] = f(l);
    }
    row
}

/// `Σ wⱼ kⱼ` of one row of the stages' rates.
#[inline(always)]
pub(super) fn weighted(weights: &[f64], k: &[Vec<Row>], row: usize) -> Row {
    let mut sum = NIL;
    for (&w, k) in weights.iter().zip(k).filter(|(w, _)| **w != 0.0) {
        let k = &k[row];
        for l in 0..LANES {
            sum[l] += w * k[l];
        }
    }
    sum
}
