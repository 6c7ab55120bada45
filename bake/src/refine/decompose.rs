//! Coefficients → tensor train.
//!
//! In: the coefficients of a box and a threshold. Out: a [`Train`] whose cores are scaled by the
//! singular values of their bonds, so that all can be rounded with one step. Singular values below
//! the threshold are left out: what belongs to them would round to zero. Source: I. V. Oseledets,
//! *Tensor-train decomposition*, SIAM J. Sci. Comput. 33 (2011), algorithm 1; for large matrices the
//! range is found from random combinations of columns (N. Halko, P. G. Martinsson, J. A. Tropp,
//! *Finding structure with randomness*, SIAM Review 53 (2011), algorithm 4.3).

use faer::{Mat, MatRef};
use geofan::{
    bundle::{Layout, Scale, Train, graded},
    random::Stream,
};
use ndarray::{ArrayD, IxDyn};

/// Below this smaller side a matrix is decomposed as it is: random combinations save nothing.
const SMALL: usize = 96;

/// Columns that a random range has more than the rank it is to find.
const OVERSAMPLING: usize = 12;

/// The train of `coefficients` (axes camera…, direction…, arc length, channel) in the order of `layout`,
/// without singular values below `threshold`; `None` where a rank exceeds `most_rank`.
pub fn decompose(
    coefficients: &ArrayD<f64>,
    cameras: usize,
    layout: Layout,
    (threshold, most_rank): (f64, usize),
) -> Option<Train> {
    let axes = layout.cores(coefficients.ndim() - 2);
    let order: Vec<usize> = axes.iter().flatten().copied().collect();
    let graded = graded(coefficients);
    let permuted = graded.view().permuted_axes(IxDyn(&order));
    let permuted = permuted.as_standard_layout();
    let mut rest: Vec<f64> = permuted.iter().copied().collect();
    let sizes = axes.iter().map(|axes| {
        let sizes = axes.iter().map(|a| coefficients.shape()[*a]);
        sizes.collect::<Vec<usize>>()
    });
    let sizes: Vec<Vec<usize>> = sizes.collect();
    let (mut cores, mut scales, mut rank) = (Vec::new(), Vec::new(), 1);
    for core in &sizes[..sizes.len() - 1] {
        let rows = rank * core[0];
        let split = Split::new(&rest, rows, (threshold, most_rank))?;
        let bond: Vec<Scale> = split.singular.iter().map(|x| Scale::near(*x)).collect();
        let left = split.left.chunks_exact(bond.len());
        let scaled = left.flat_map(|row| row.iter().zip(&bond).map(|(x, s)| x * s.value()));
        let shape = IxDyn(&[rank, core[0], bond.len()]);
        cores.push(ArrayD::from_shape_vec(shape, scaled.collect()).ok()?);
        rank = bond.len();
        scales.push(bond);
        rest = split.right;
    }
    let last = &sizes[sizes.len() - 1];
    let shape = IxDyn(&[rank, last[0], last[1], 1]);
    cores.push(ArrayD::from_shape_vec(shape, rest).ok()?);
    Some(Train {
        layout,
        cameras,
        cores,
        scales,
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
    fn new(flat: &[f64], rows: usize, (threshold, most_rank): (f64, usize)) -> Option<Self> {
        let columns = flat.len() / rows;
        let a = MatRef::from_row_major_slice(flat, rows, columns);
        if rows.min(columns) <= SMALL {
            return Self::exact(a, None, threshold);
        }
        let mut rank = SMALL / 2;
        loop {
            let basis = range(a, rank + OVERSAMPLING);
            let split = Self::exact((basis.transpose() * a).as_ref(), Some(&basis), threshold)?;
            if split.singular.len() < rank {
                return Some(split);
            }
            rank *= 2;
            if rank > most_rank {
                return None;
            }
        }
    }

    /// The decomposition of `a`, or of `basis · a`.
    fn exact(a: MatRef<'_, f64>, basis: Option<&Mat<f64>>, threshold: f64) -> Option<Self> {
        let svd = a.thin_svd().ok()?;
        let sizes = svd.S().column_vector();
        let kept = sizes.iter().take_while(|x| **x > threshold).count().max(1);
        let u = svd.U().subcols(0, kept);
        let u = basis.map_or_else(|| u.to_owned(), |basis| basis * u);
        let v = svd.V();
        // The sign of a singular pair is arbitrary: the largest entry of each left vector is made
        // positive, so that a bake is reproducible.
        let sign = |j: usize| {
            let column = u.col(j).iter().copied();
            let largest = column.fold(0.0_f64, |a, b| if b.abs() > a.abs() { b } else { a });
            if largest < 0.0 { -1.0 } else { 1.0 }
        };
        let signs: Vec<f64> = (0..kept).map(sign).collect();
        let row = |i: usize| (0..kept).map(move |j| (i, j));
        let left = (0..u.nrows()).flat_map(row);
        let right = (0..kept).flat_map(|j| (0..v.nrows()).map(move |i| (i, j)));
        Some(Self {
            singular: (0..kept).map(|j| sizes[j]).collect(),
            left: left.map(|(i, j)| signs[j] * u[(i, j)]).collect(),
            right: right
                .map(|(i, j)| signs[j] * sizes[j] * v[(i, j)])
                .collect(),
        })
    }
}

/// An orthonormal basis (columns) of nearly all of the range of `a`.
fn range(a: MatRef<'_, f64>, width: usize) -> Mat<f64> {
    let width = width.min(a.nrows());
    let mut stream = Stream::new(&[a.nrows() as u64, a.ncols() as u64]);
    let random = Mat::from_fn(a.ncols(), width, |_, _| stream.between(-1.0, 1.0));
    let once = (a * random).qr().compute_thin_Q();
    // Once through AᵀA: singular values that fall off slowly are told apart better.
    let again = a.transpose() * once;
    (a * again).qr().compute_thin_Q()
}

#[cfg(test)]
mod tests {
    use super::*;

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

    #[test]
    fn a_rounded_train_is_the_polynomial_within_its_step() {
        for shape in [&[6, 7, 8, 9, 3][..], &[5, 6, 5, 6, 5, 8, 3], &[9, 8, 7, 3]] {
            let c = coefficients(shape);
            let cameras = shape.len() - 4;
            let cameras = if shape.len() == 4 { 1 } else { cameras };
            let step = Scale::near(1e-5);
            let layout = Layout::paired(cameras, shape.len() - 2 - cameras);
            let train = decompose(&c, cameras, layout, (0.3e-5, 500))
                .unwrap()
                .rounded(step)
                .unwrap();
            let plain = Train::plain(&c, cameras)
                .rounded(Scale::near(2e-6))
                .unwrap();
            let x = vec![0.3; shape.len() - 2];
            let (a, b) = (train.at(&x), plain.at(&x));
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
