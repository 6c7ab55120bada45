//! Products of matrices with many more columns than rows.
//!
//! In: matrices. Out: their products, triangles and squares, each put together from the same parts
//! however many threads there are.

use faer::{
    Accum, Mat, MatMut, MatRef, Par,
    linalg::matmul::{
        matmul,
        triangular::{self, BlockStructure},
    },
};
use rayon::prelude::*;

/// Columns that one thread works on at once.
const COLUMNS: usize = 1024;

/// `a b`.
pub fn product(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> Mat<f64> {
    let mut all = Mat::zeros(a.nrows(), b.ncols());
    product_into(all.as_mut(), a, b);
    all
}

/// `to = a b`, by parts of its columns.
pub fn product_into(to: MatMut<'_, f64>, a: MatRef<'_, f64>, b: MatRef<'_, f64>) {
    let mut parts = Vec::new();
    let mut rest = to;
    for columns in parts_of(b, COLUMNS) {
        let (part, after) = rest.split_at_col_mut(columns.ncols());
        parts.push((part, columns));
        rest = after;
    }
    parts
        .into_par_iter()
        .for_each(|(to, b)| matmul(to, Accum::Replace, a, b, 1.0, Par::Seq));
}

/// `a` by parts of at most so many columns.
fn parts_of(a: MatRef<'_, f64>, most: usize) -> Vec<MatRef<'_, f64>> {
    let part = |first: usize| a.subcols(first, most.min(a.ncols() - first));
    (0..a.ncols()).step_by(most).map(part).collect()
}

/// The lower triangle of `A Aᵀ`.
pub fn square(a: MatRef<'_, f64>) -> Mat<f64> {
    let parts = parts_of(a, COLUMNS.max(8 * a.nrows()));
    let squares: Vec<Mat<f64>> = parts.into_par_iter().map(square_of_part).collect();
    let mut squares = squares.into_iter();
    let mut sum = squares
        .next()
        .unwrap_or_else(|| Mat::zeros(a.nrows(), a.nrows()));
    squares.for_each(|square| sum += square);
    sum
}

fn square_of_part(a: MatRef<'_, f64>) -> Mat<f64> {
    let mut square = Mat::zeros(a.nrows(), a.nrows());
    triangular::matmul(
        square.as_mut(),
        BlockStructure::TriangularLower,
        Accum::Replace,
        a,
        BlockStructure::Rectangular,
        a.transpose(),
        BlockStructure::Rectangular,
        1.0,
        Par::Seq,
    );
    square
}

/// The upper triangle R of Aᵀ = Q R: parts are made triangular one by one, and then all those
/// triangles together (J. Demmel and others, *Communication-optimal parallel and sequential QR and LU
/// factorizations*, SIAM J. Sci. Comput. 34 (2012)).
pub fn triangle(a: MatRef<'_, f64>) -> Mat<f64> {
    let triangles: Vec<Mat<f64>> = parts_of(a, COLUMNS.max(8 * a.nrows()))
        .into_par_iter()
        .map(|part| part.transpose().to_owned().qr().thin_R().to_owned())
        .collect();
    let rows = triangles.iter().map(|r| r.nrows()).sum();
    let mut stacked = Mat::zeros(rows, a.nrows());
    let mut first = 0;
    for triangle in &triangles {
        stacked
            .subrows_mut(first, triangle.nrows())
            .copy_from(triangle);
        first += triangle.nrows();
    }
    match triangles.len() {
        1 => stacked,
        _ => stacked.qr().thin_R().to_owned(),
    }
}
