//! Matrices with many more columns than rows: products, Gram matrices, triangular factors, and an
//! orthonormal basis of the range.
//!
//! In: matrices. Out: results that are put together from equal parts for any number of threads. A basis
//! leaves out singular values below a threshold only. Its columns are random combinations of columns
//! (N. Halko, P. G. Martinsson, J. A. Tropp, *Finding structure with randomness*, SIAM Review 53 (2011),
//! algorithm 4.2), not of the matrix but of a [`sketch`] of it with far fewer columns, which grows as the
//! basis does.

use faer::{
    Accum, Mat, MatMut, MatRef, Par,
    linalg::matmul::{
        matmul,
        triangular::{self, BlockStructure},
    },
};
use geofan_core::{Stop, random::Stream};
use rayon::prelude::*;

/// Columns that one thread works on at once.
const COLUMNS: usize = 1024;

/// Columns that a sketch has for each of the basis, at least, and those it begins with for each that is
/// found at a time.
const SKETCH: usize = 3;
const FIRST: usize = 16;

/// Columns of a sketch that each column is added to: with one, two that are large and alike in no
/// way may fall on the same and cannot be told apart.
const PLACES: usize = 4;

/// Rows sketched at a time.
const ROWS: usize = 8;

/// Columns found at a time.
const STRIDE: usize = 64;

/// Largest part of random combinations that may be left outside a basis, in units of the threshold: they
/// add up many singular values that are all below it. With 1 bases are 1.6 times as wide as the
/// ranks that remain, with this 1.4 times.
const ENOUGH: f64 = 2.0;

/// Multiplies `a b`; `None` when it is stopped.
pub fn product(a: MatRef<'_, f64>, b: MatRef<'_, f64>, stop: &Stop) -> Option<Mat<f64>> {
    let mut all = Mat::zeros(a.nrows(), b.ncols());
    product_into(all.as_mut(), a, b, stop)?;
    Some(all)
}

/// Computes `to = a b`, by parts of its columns; `None` when it is stopped.
pub fn product_into(
    to: MatMut<'_, f64>,
    a: MatRef<'_, f64>,
    b: MatRef<'_, f64>,
    stop: &Stop,
) -> Option<()> {
    let mut parts = Vec::new();
    let mut rest = to;
    for columns in parts_of(b, COLUMNS) {
        let (part, after) = rest.split_at_col_mut(columns.ncols());
        parts.push((part, columns));
        rest = after;
    }
    parts
        .into_par_iter()
        .map(|(to, b)| {
            let goes_on = stop.goes_on(a.nrows() * a.ncols() * b.ncols());
            goes_on.then(|| matmul(to, Accum::Replace, a, b, 1.0, Par::Seq))
        })
        .collect()
}

/// Divides `a` into parts of at most so many columns.
fn parts_of(a: MatRef<'_, f64>, most: usize) -> Vec<MatRef<'_, f64>> {
    let part = |first: usize| a.subcols(first, most.min(a.ncols() - first));
    (0..a.ncols()).step_by(most).map(part).collect()
}

/// Computes the lower triangle of `A Aᵀ`; `None` when it is stopped.
pub fn gram(a: MatRef<'_, f64>, stop: &Stop) -> Option<Mat<f64>> {
    let parts = parts_of(a, COLUMNS.max(8 * a.nrows()));
    let of_part = |part: MatRef<'_, f64>| {
        let goes_on = stop.goes_on(part.ncols() * part.nrows().pow(2) / 2);
        goes_on.then(|| gram_of_part(part))
    };
    let grams: Option<Vec<Mat<f64>>> = parts.into_par_iter().map(of_part).collect();
    let mut grams = grams?.into_iter();
    let mut sum = grams
        .next()
        .unwrap_or_else(|| Mat::zeros(a.nrows(), a.nrows()));
    grams.for_each(|gram| sum += gram);
    Some(sum)
}

/// Computes the lower triangle of `A Aᵀ` on one thread.
fn gram_of_part(a: MatRef<'_, f64>) -> Mat<f64> {
    let mut gram = Mat::zeros(a.nrows(), a.nrows());
    triangular::matmul(
        gram.as_mut(),
        BlockStructure::TriangularLower,
        Accum::Replace,
        a,
        BlockStructure::Rectangular,
        a.transpose(),
        BlockStructure::Rectangular,
        1.0,
        Par::Seq,
    );
    gram
}

/// Computes the upper triangle R of Aᵀ = Q R: parts are made triangular one by one, and then all those
/// triangles together (J. Demmel and others, *Communication-optimal parallel and sequential QR and LU
/// factorizations*, SIAM J. Sci. Comput. 34 (2012)). `None` when it is stopped.
pub fn triangular_factor(a: MatRef<'_, f64>, stop: &Stop) -> Option<Mat<f64>> {
    let of_part = |part: MatRef<'_, f64>| {
        let goes_on = stop.goes_on(part.ncols() * part.nrows().pow(2));
        goes_on.then(|| part.transpose().to_owned().qr().thin_R().to_owned())
    };
    let triangles: Option<Vec<Mat<f64>>> = parts_of(a, COLUMNS.max(8 * a.nrows()))
        .into_par_iter()
        .map(of_part)
        .collect();
    let triangles = triangles?;
    let rows = triangles.iter().map(|r| r.nrows()).sum();
    let mut stacked = Mat::zeros(rows, a.nrows());
    let mut first = 0;
    for triangle in &triangles {
        stacked
            .subrows_mut(first, triangle.nrows())
            .copy_from(triangle);
        first += triangle.nrows();
    }
    let goes_on = stop.goes_on(rows * a.nrows().pow(2));
    goes_on.then(|| match triangles.len() {
        1 => stacked,
        _ => stacked.qr().thin_R().to_owned(),
    })
}

/// Finds an orthonormal basis (columns) of nearly all of the range of `a`, as wide as it takes to leave no
/// singular value above `threshold`; `None` where that is more than `most_rank` and two strides, or when it is stopped.
pub fn range(
    a: MatRef<'_, f64>,
    (threshold, most_rank): (f64, usize),
    stop: &Stop,
) -> Option<Mat<f64>> {
    let mut stream = Stream::new(&[a.nrows() as u64, a.ncols() as u64]);
    let mut count = FIRST * STRIDE;
    let mut sketched = sketch(a, count, &mut stream, stop);
    let mut basis: Mat<f64> = Mat::zeros(a.nrows(), 0);
    while basis.ncols() < a.nrows() {
        if sketched.is_some() && SKETCH * (basis.ncols() + STRIDE) > count {
            count *= 2;
            sketched = sketch(a, count, &mut stream, stop);
        }
        let from = sketched.as_ref().map_or(a, |s| s.as_ref());
        let width = STRIDE.min(a.nrows() - basis.ncols());
        // A stride makes of any vector one that is as long on average.
        let size = (3.0 / width as f64).sqrt();
        let random = Mat::from_fn(from.ncols(), width, |_, _| stream.between(-size, size));
        let columns = product(from, random.as_ref(), stop)?;
        if !stop.goes_on(4 * a.nrows() * width * (basis.ncols() + width)) {
            return None;
        }
        let (new, largest) = outside(&basis, columns)?;
        // One stride at least: no basis is empty.
        if largest <= ENOUGH * threshold && basis.ncols() > 0 {
            return Some(basis);
        }
        if basis.ncols() > most_rank + STRIDE {
            return None;
        }
        basis = side_by_side(&basis, &new);
    }
    Some(basis)
}

/// Finds an orthonormal basis of the part of `columns` that is outside `basis`, and the largest singular
/// value of that part.
fn outside(basis: &Mat<f64>, columns: Mat<f64>) -> Option<(Mat<f64>, f64)> {
    // Twice: once leaves rounding errors as large as what remains is small.
    let once = &columns - basis * (basis.transpose() * &columns);
    let once = once.qr();
    let largest = once.thin_R().singular_values().ok()?;
    let largest = largest.iter().copied().fold(0.0, f64::max);
    let once = once.compute_thin_Q();
    let twice = &once - basis * (basis.transpose() * &once);
    Some((twice.qr().compute_thin_Q(), largest))
}

/// Puts the columns of `b` behind those of `a`.
fn side_by_side(a: &Mat<f64>, b: &Mat<f64>) -> Mat<f64> {
    let mut both = Mat::zeros(a.nrows(), a.ncols() + b.ncols());
    both.subcols_mut(0, a.ncols()).copy_from(a);
    both.subcols_mut(a.ncols(), b.ncols()).copy_from(b);
    both
}

/// Makes a matrix of `count` columns and nearly the same range: sums of columns with random signs; `None`
/// where that is hardly fewer columns (D. P. Woodruff, *Sketching as a tool for numerical linear algebra*, 2014,
/// section 2.1; J. Nelson, H. L. Nguyễn, *OSNAP*, FOCS 2013).
fn sketch(a: MatRef<'_, f64>, count: usize, stream: &mut Stream, stop: &Stop) -> Option<Mat<f64>> {
    if a.ncols() < 2 * count || stop.told() {
        return None;
    }
    let size = 1.0 / (PLACES as f64).sqrt();
    let place = |_| {
        let bits = stream.bits();
        let sign = if bits & 1 == 0 { size } else { -size };
        ((bits >> 1) as usize % count, sign)
    };
    let places: Vec<(usize, f64)> = (0..PLACES * a.ncols()).map(place).collect();
    let bands: Vec<Vec<[f64; ROWS]>> = (0..a.nrows())
        .into_par_iter()
        .step_by(ROWS)
        .map(|first| {
            let rows = a.subrows(first, ROWS.min(a.nrows() - first));
            // What is left out of a sketch when it is stopped is not read.
            match stop.goes_on(PLACES * rows.nrows() * a.ncols()) {
                true => sketch_band(rows, &places, count),
                false => vec![[0.0; ROWS]; count],
            }
        })
        .collect();
    let at = |i: usize, j: usize| bands[i / ROWS][j][i % ROWS];
    Some(Mat::from_fn(a.nrows(), count, at))
}

/// Sketches at most [`ROWS`] rows, column by column: all are added up together, so that it matters little
/// whether rows or columns of `a` stand one after the other.
fn sketch_band(a: MatRef<'_, f64>, places: &[(usize, f64)], count: usize) -> Vec<[f64; ROWS]> {
    let mut sums = vec![[0.0; ROWS]; count];
    let mut column = [0.0; ROWS];
    for (j, places) in places.chunks_exact(PLACES).enumerate() {
        for i in 0..a.nrows() {
            column[i] = a[(i, j)];
        }
        for (place, sign) in places {
            for (sum, x) in sums[*place].iter_mut().zip(&column) {
                *sum += sign * x;
            }
        }
    }
    sums
}
