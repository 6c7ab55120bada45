//! Coefficients → tensor train.
//!
//! In: the coefficients of a box and a threshold. Out: a [`Train`] whose cores are multiplied by
//! the singular values of their bonds, so that all can be rounded with one step. Singular values below
//! the threshold are left out: what belongs to them would round to zero. Source: I. V. Oseledets,
//! *Tensor-train decomposition*, SIAM J. Sci. Comput. 33 (2011), algorithm 1; for large matrices the
//! range is found from random combinations of columns (N. Halko, P. G. Martinsson, J. A. Tropp,
//! *Finding structure with randomness*, SIAM Review 53 (2011), algorithm 4.3).

use faer::{Accum, Mat, MatMut, MatRef, Par, diag::DiagRef, linalg::matmul::matmul};
use geofan::{
    bundle::{Layout, Polynomial, Train, graded},
    random::Stream,
};
use ndarray::{ArrayD, IxDyn};
use rayon::prelude::*;

/// Below this smaller side a matrix is decomposed as it is: random combinations save nothing.
const SMALL: usize = 96;

/// Columns that a random range has beyond those that belong to singular values worth keeping.
const OVERSAMPLING: usize = 12;

/// The train of `polynomial` (axes camera…, direction…, arc length, channel) in the order of `layout`, without
/// its singular values below `threshold`; `None` where a rank exceeds `most_rank`.
pub fn decompose(
    polynomial: &Polynomial,
    layout: Layout,
    (threshold, most_rank): (f64, usize),
) -> Option<Train> {
    let coefficients = &polynomial.coefficients;
    let axes = layout.cores(coefficients.ndim() - 2);
    let order: Vec<usize> = axes.iter().flatten().copied().collect();
    let permuted = graded(coefficients).permuted_axes(IxDyn(&order));
    let permuted = permuted.as_standard_layout().into_owned();
    let mut rest: Vec<f64> = permuted.into_raw_vec_and_offset().0;
    let sizes = axes.iter().map(|axes| {
        let sizes = axes.iter().map(|a| coefficients.shape()[*a]);
        sizes.collect::<Vec<usize>>()
    });
    let sizes: Vec<Vec<usize>> = sizes.collect();
    let (mut cores, mut singular, mut rank) = (Vec::new(), Vec::new(), 1);
    for core in &sizes[..sizes.len() - 1] {
        let rows = rank * core[0];
        let split = Split::new(&rest, rows, (threshold, most_rank))?;
        let bond = split.singular;
        let left = split.left.chunks_exact(bond.len());
        let scaled = left.flat_map(|row| row.iter().zip(&bond).map(|(x, s)| x * s));
        let shape = IxDyn(&[rank, core[0], bond.len()]);
        cores.push(ArrayD::from_shape_vec(shape, scaled.collect()).ok()?);
        rank = bond.len();
        singular.push(bond);
        rest = split.right;
    }
    let last = &sizes[sizes.len() - 1];
    let shape = IxDyn(&[rank, last[0], last[1], 1]);
    cores.push(ArrayD::from_shape_vec(shape, rest).ok()?);
    Some(Train {
        layout,
        variables: polynomial.variables,
        cores,
        singular,
    })
}

/// `A ≈ U (Σ Vᵀ)`.
struct Split {
    singular: Vec<f64>,
    /// U, row by row.
    left: Vec<f64>,
    /// Σ Vᵀ, row by row.
    right: Vec<f64>,
}

impl Split {
    /// Of the matrix of so many rows that is `flat` row by row, without singular values below
    /// `threshold`; `None` where more than `most_rank` are left.
    fn new(flat: &[f64], rows: usize, limits: (f64, usize)) -> Option<Self> {
        let columns = flat.len() / rows;
        let a = MatRef::from_row_major_slice(flat, rows, columns);
        if rows <= columns {
            return Self::wide(a, limits);
        }
        // The transpose: A = U Σ Vᵀ, Aᵀ = V Σ Uᵀ.
        let Self {
            singular,
            left: v,
            right: scaled_u,
        } = Self::wide(a.transpose(), limits)?;
        let scaled_u = MatRef::from_row_major_slice(&scaled_u, singular.len(), rows);
        let u = Mat::from_fn(rows, singular.len(), |i, j| scaled_u[(j, i)] / singular[j]);
        let v = MatRef::from_row_major_slice(&v, columns, singular.len());
        let signs = signs(u.as_ref());
        let scaled_v = Mat::from_fn(singular.len(), columns, |j, i| {
            signs[j] * singular[j] * v[(i, j)]
        });
        Some(Self {
            left: row_by_row(u.as_ref(), &signs),
            right: row_by_row(scaled_v.as_ref(), &vec![1.0; columns]),
            singular,
        })
    }

    /// Of a matrix with no more rows than columns.
    fn wide(a: MatRef<'_, f64>, (threshold, most_rank): (f64, usize)) -> Option<Self> {
        if a.nrows() <= SMALL {
            return Self::exact(a, None, threshold);
        }
        let basis = range(a, (threshold, most_rank))?;
        let within = product(basis.transpose(), a);
        let split = Self::exact(within.as_ref(), Some(&basis), threshold)?;
        (split.singular.len() <= most_rank).then_some(split)
    }

    /// The decomposition of `a`, or of `basis · a`. Its left singular vectors are those of its lower
    /// triangle (LQ), and with them `Σ Vᵀ = Uᵀ A`.
    fn exact(a: MatRef<'_, f64>, basis: Option<&Mat<f64>>, threshold: f64) -> Option<Self> {
        let lower = triangle(a);
        let svd = lower.transpose().thin_svd().ok()?;
        let kept = kept(svd.S(), threshold);
        let u = svd.U().subcols(0, kept.len());
        let all = basis.map_or_else(|| u.to_owned(), |basis| product(basis.as_ref(), u));
        let signs = signs(all.as_ref());
        let signed = Mat::from_fn(u.nrows(), kept.len(), |i, j| signs[j] * u[(i, j)]);
        Some(Self {
            left: row_by_row(all.as_ref(), &signs),
            right: flat_product(signed.transpose(), a),
            singular: kept,
        })
    }
}

/// The singular values above `threshold`, the largest at least.
fn kept(singular: DiagRef<'_, f64>, threshold: f64) -> Vec<f64> {
    let sizes = singular.column_vector();
    let kept = sizes.iter().take_while(|x| **x > threshold).count().max(1);
    sizes.iter().take(kept).copied().collect()
}

/// The sign of a singular pair is arbitrary: with these the largest entry of each left vector is
/// positive, so that a bake is reproducible.
fn signs(u: MatRef<'_, f64>) -> Vec<f64> {
    let sign = |j: usize| {
        let column = u.col(j).iter().copied();
        let largest = column.fold(0.0_f64, |a, b| if b.abs() > a.abs() { b } else { a });
        if largest < 0.0 { -1.0 } else { 1.0 }
    };
    (0..u.ncols()).map(sign).collect()
}

/// The entries of `a`, its columns multiplied by `factors`.
fn row_by_row(a: MatRef<'_, f64>, factors: &[f64]) -> Vec<f64> {
    let row = |i: usize| factors.iter().enumerate().map(move |(j, f)| f * a[(i, j)]);
    (0..a.nrows()).flat_map(row).collect()
}

/// Columns that one thread works on at once. Every product and every triangle is put together from
/// the same parts, however many threads there are.
const COLUMNS: usize = 1024;

/// `a b`, row by row.
fn flat_product(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> Vec<f64> {
    let mut flat = vec![0.0; a.nrows() * b.ncols()];
    into_parts(
        MatMut::from_row_major_slice_mut(&mut flat, a.nrows(), b.ncols()),
        a,
        b,
    );
    flat
}

/// `a b`.
fn product(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> Mat<f64> {
    let mut all = Mat::zeros(a.nrows(), b.ncols());
    into_parts(all.as_mut(), a, b);
    all
}

/// `to = a b`, by parts of its columns.
fn into_parts(to: MatMut<'_, f64>, a: MatRef<'_, f64>, b: MatRef<'_, f64>) {
    let mut parts = Vec::new();
    let mut rest = to;
    for columns in parts_of(b) {
        let (part, after) = rest.split_at_col_mut(columns.ncols());
        parts.push((part, columns));
        rest = after;
    }
    parts
        .into_par_iter()
        .for_each(|(to, b)| matmul(to, Accum::Replace, a, b, 1.0, Par::Seq));
}

/// `a` by parts of its columns.
fn parts_of(a: MatRef<'_, f64>) -> impl Iterator<Item = MatRef<'_, f64>> {
    let part = move |first: usize| a.subcols(first, COLUMNS.min(a.ncols() - first));
    (0..a.ncols()).step_by(COLUMNS).map(part)
}

/// The upper triangle R of Aᵀ = Q R: parts are made triangular one by one, and then all those
/// triangles together (J. Demmel and others, *Communication-optimal parallel and sequential QR and LU
/// factorizations*, SIAM J. Sci. Comput. 34 (2012)).
fn triangle(a: MatRef<'_, f64>) -> Mat<f64> {
    let parts: Vec<MatRef<'_, f64>> = parts_of(a).collect();
    let together = (COLUMNS * parts.len()).div_ceil(COLUMNS.max(8 * a.nrows()));
    let together = parts.len().div_ceil(together.max(1));
    let triangles: Vec<Mat<f64>> = (0..parts.len().div_ceil(together))
        .into_par_iter()
        .map(|k| {
            let first = k * together * COLUMNS;
            let count = (together * COLUMNS).min(a.ncols() - first);
            a.subcols(first, count)
                .transpose()
                .to_owned()
                .qr()
                .thin_R()
                .to_owned()
        })
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

/// Columns that stand for those of a matrix with many more, for each of the most ranks.
const SKETCH: usize = 4;

/// Columns found at a time.
const STRIDE: usize = 64;

/// An orthonormal basis (columns) of nearly all of the range of `a`, as wide as it takes to leave no
/// singular value above `threshold`; `None` where that is more than `most_rank`.
fn range(a: MatRef<'_, f64>, (threshold, most_rank): (f64, usize)) -> Option<Mat<f64>> {
    let mut stream = Stream::new(&[a.nrows() as u64, a.ncols() as u64]);
    let sketch = sketch(a, SKETCH * most_rank, &mut stream);
    let a = sketch.as_ref().map_or(a, |s| s.as_ref());
    let mut basis: Mat<f64> = Mat::zeros(a.nrows(), 0);
    while basis.ncols() < a.nrows() {
        let width = STRIDE.min(a.nrows() - basis.ncols());
        let random = Mat::from_fn(a.ncols(), width, |_, _| stream.between(-1.0, 1.0));
        let once = outside(&basis, a * random);
        // Once through AᵀA: singular values that fall off slowly are told apart better.
        let again = product(once.transpose(), a);
        let new = outside(&basis, a * again.transpose());
        let found = triangle(product(new.transpose(), a).as_ref());
        let sizes = found.singular_values().ok()?;
        let above = sizes.iter().filter(|x| **x > threshold).count();
        let wider = Mat::from_fn(a.nrows(), basis.ncols() + width, |i, j| {
            match j.checked_sub(basis.ncols()) {
                Some(j) => new[(i, j)],
                None => basis[(i, j)],
            }
        });
        if above + OVERSAMPLING <= width {
            return Some(wider);
        }
        if basis.ncols() + above > most_rank {
            return None;
        }
        basis = wider;
    }
    Some(basis)
}

/// An orthonormal basis of what `columns` have that `basis` has not.
fn outside(basis: &Mat<f64>, columns: Mat<f64>) -> Mat<f64> {
    // Twice: once leaves rounding errors as large as what remains is small.
    let once = &columns - basis * (basis.transpose() * &columns);
    let once = once.qr().compute_thin_Q();
    let twice = &once - basis * (basis.transpose() * &once);
    twice.qr().compute_thin_Q()
}

/// A matrix with far fewer columns and nearly the same range: sums of columns with random signs
/// (D. P. Woodruff, *Sketching as a tool for numerical linear algebra*, 2014, section 2.1).
fn sketch(a: MatRef<'_, f64>, count: usize, stream: &mut Stream) -> Option<Mat<f64>> {
    if a.ncols() < 2 * count {
        return None;
    }
    let places = (0..a.ncols()).map(|_| {
        let bits = stream.bits();
        let sign = if bits & 1 == 0 { 1.0 } else { -1.0 };
        ((bits >> 1) as usize % count, sign)
    });
    let places: Vec<(usize, f64)> = places.collect();
    let rows: Vec<Vec<f64>> = (0..a.nrows())
        .into_par_iter()
        .map(|i| {
            let mut sums = vec![0.0; count];
            for (x, (place, sign)) in a.row(i).iter().zip(&places) {
                sums[*place] += sign * x;
            }
            sums
        })
        .collect();
    Some(Mat::from_fn(a.nrows(), count, |i, j| rows[i][j]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan::bundle::{Shape, Step, Stretch, Tensor, Tree, Variables};
    use std::sync::Arc;

    fn coefficients(shape: &[usize]) -> ArrayD<f64> {
        let mut stream = Stream::new(&[5]);
        let waves: Vec<f64> = (0..4 * shape.len())
            .map(|_| stream.between(0.4, 1.3))
            .collect();
        ArrayD::from_shape_fn(IxDyn(shape), |index| {
            (0..4)
                .map(|w| {
                    let axes = 0..shape.len();
                    let sum: f64 = axes.map(|a| waves[4 * a + w] * index[a] as f64).sum();
                    (-sum).exp() * (1.0 + w as f64 + sum.sin())
                })
                .sum()
        })
    }

    /// What a reader makes of the bytes of `tensor`.
    fn read_again(tensor: &Tensor, polynomial: &Polynomial, shape: &[usize]) -> Tensor {
        let cameras = polynomial.variables.cameras;
        let bytes = Tree::Leaf(Arc::new(tensor.clone())).encode();
        let shape = Shape {
            variables: polynomial.variables,
            directions: shape.len() - 2 - cameras,
            channels: shape[shape.len() - 1],
        };
        let Ok(Tree::Leaf(read)) = Tree::decode(&bytes, shape) else {
            panic!("{shape:?}")
        };
        Arc::unwrap_or_clone(read)
    }

    #[test]
    fn a_rounded_train_is_the_polynomial_within_its_step() {
        for shape in [&[6, 7, 8, 9, 3][..], &[5, 6, 5, 6, 5, 8, 3], &[9, 8, 7, 3]] {
            let cameras = shape.len() - 4;
            let cameras = if shape.len() == 4 { 1 } else { cameras };
            let polynomial = Polynomial {
                coefficients: coefficients(shape),
                variables: Variables::of_face(cameras, Stretch::new(0.6)),
            };
            let step = Step::near(1e-5);
            let layout = Layout::paired(cameras, shape.len() - 2 - cameras);
            let train = decompose(&polynomial, layout, (0.3e-5, 500))
                .unwrap()
                .rounded(step)
                .unwrap();
            let plain = Train::plain(&polynomial).rounded(Step::near(2e-6)).unwrap();
            let x = vec![0.3; shape.len() - 2];
            let (a, b) = (train.at(&x), plain.at(&x));
            assert_eq!(read_again(&train, &polynomial, shape).at(&x), a);
            let n = b.len().min(a.len());
            let worst = a
                .iter()
                .zip(&b)
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f64::max);
            assert!(n > 0 && worst < 3e-4, "{shape:?} {worst}");
        }
    }

    #[test]
    fn large_matrices_are_split_as_small_ones_are() {
        let (rows, columns) = (150, 400);
        let flat: Vec<f64> = (0..rows * columns)
            .map(|k| {
                let (i, j) = (k / columns, k % columns);
                (1..30_usize)
                    .map(|m| {
                        0.5_f64.powi(m as i32)
                            * ((i * m) as f64).sin()
                            * ((j * m) as f64 * 0.7).cos()
                    })
                    .sum()
            })
            .collect();
        let split = Split::new(&flat, rows, (1e-7, 100)).unwrap();
        let rank = split.singular.len();
        assert!(rank < 30);
        for (i, j) in [(0, 0), (17, 300), (149, 399), (80, 5)] {
            let sum: f64 = (0..rank)
                .map(|r| split.left[i * rank + r] * split.right[r * columns + j])
                .sum();
            assert!((sum - flat[i * columns + j]).abs() < 1e-6);
        }
    }
}
