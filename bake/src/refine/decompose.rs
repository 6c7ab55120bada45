//! Coefficients → tensor train.
//!
//! In: the coefficients of a box and a threshold. Out: a [`Train`] whose cores are multiplied by
//! the singular values of their bonds, so that all can be rounded with one step. Singular values below
//! the threshold are left out: what belongs to them would round to zero. Source: I. V. Oseledets,
//! *Tensor-train decomposition*, SIAM J. Sci. Comput. 33 (2011), algorithm 1; for large matrices the
//! range is found from random combinations of columns (N. Halko, P. G. Martinsson, J. A. Tropp,
//! *Finding structure with randomness*, SIAM Review 53 (2011), algorithm 4.2).

mod products;
mod range;

use faer::{Mat, MatRef, Side};
use geofan::bundle::{Layout, Polynomial, Train, graded};
use ndarray::{ArrayD, IxDyn};
use products::{flat_product, product, square, triangle};
use range::range;

/// Below this smaller side a matrix is decomposed as it is: random combinations save nothing.
const SMALL: usize = 192;

/// Down to this share of the size of a matrix its singular values are found from its square, to within
/// a hundredth; smaller ones drown in rounding errors there, and take a triangle.
const SQUARES: f64 = 1e-7;

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

    /// The decomposition of `a`, or of `basis · a`: with its left singular vectors `Σ Vᵀ = Uᵀ A`.
    fn exact(a: MatRef<'_, f64>, basis: Option<&Mat<f64>>, threshold: f64) -> Option<Self> {
        let (u, kept) = left_vectors(a, threshold)?;
        let all = basis.map_or_else(|| u.clone(), |basis| product(basis.as_ref(), u.as_ref()));
        let signs = signs(all.as_ref());
        let signed = Mat::from_fn(u.nrows(), kept.len(), |i, j| signs[j] * u[(i, j)]);
        Some(Self {
            left: row_by_row(all.as_ref(), &signs),
            right: flat_product(signed.transpose(), a),
            singular: kept,
        })
    }
}

/// The left singular vectors of `a` and their singular values, of those above `threshold`: of its square
/// or, where that is not accurate enough, of its lower triangle (LQ).
fn left_vectors(a: MatRef<'_, f64>, threshold: f64) -> Option<(Mat<f64>, Vec<f64>)> {
    let square = square(a);
    let size: f64 = (0..a.nrows()).map(|i| square[(i, i)]).sum::<f64>().sqrt();
    if threshold < SQUARES * size {
        let svd = triangle(a).transpose().thin_svd().ok()?;
        let sizes = svd.S().column_vector().iter().copied();
        let kept = kept(sizes, threshold);
        return Some((svd.U().subcols(0, kept.len()).to_owned(), kept));
    }
    let found = square.self_adjoint_eigen(Side::Lower).ok()?;
    let squares = found.S().column_vector().iter().rev();
    let kept = kept(squares.map(|x| x.max(0.0).sqrt()), threshold);
    let vectors = found.U().reverse_cols();
    Some((vectors.subcols(0, kept.len()).to_owned(), kept))
}

/// The singular values above `threshold` of those in falling order, the largest at least.
fn kept(sizes: impl Iterator<Item = f64>, threshold: f64) -> Vec<f64> {
    let mut all = sizes.peekable();
    let largest = all.peek().copied();
    let kept: Vec<f64> = all.take_while(|x| *x > threshold).collect();
    if kept.is_empty() {
        largest.into_iter().collect()
    } else {
        kept
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use geofan::{
        bundle::{Shape, Step, Stretch, Tensor, Tree, Variables},
        random::Stream,
    };
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
