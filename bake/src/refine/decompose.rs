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

use faer::{Mat, MatMut, MatRef, Side};
use geofan_bundle::{Layout, Polynomial, Train, graded_in_order};
use ndarray::ArrayD;
use products::{product, product_into, square, triangle};
use range::range;
use std::collections::VecDeque;

/// Below this smaller side a matrix is decomposed as it is: random combinations save nothing.
const SMALL: usize = 1000;

/// Down to this share of the size of a matrix its singular values are found from its square, to within
/// a hundredth; smaller ones drown in rounding errors there, and take a triangle.
const SQUARES: f64 = 1e-7;

/// The train of `polynomial` (axes camera…, direction…, arc length, channel) in the order of `layout`, without
/// its singular values below `threshold`; `None` where a rank exceeds `most_rank`.
///
/// Cores are taken off from both ends, those with the fewest numbers in a row first: each narrows what is
/// left, and the largest matrices come last, when little is left of them. For boxes of five axes that takes
/// 0.82 of the time of going from one end to the other.
pub fn decompose(polynomial: &Polynomial, layout: Layout, limits: (f64, usize)) -> Option<Train> {
    let coefficients = &polynomial.coefficients;
    let axes = layout.cores(coefficients.ndim() - 2);
    let order: Vec<usize> = axes.iter().flatten().copied().collect();
    let mut rest = graded_in_order(coefficients, &order[..order.len() - 2]);
    let shape = |axes: &Vec<usize>| -> Vec<usize> {
        axes.iter().map(|a| coefficients.shape()[*a]).collect()
    };
    let mut middle: VecDeque<Vec<usize>> = axes.iter().map(shape).collect();
    let (mut left, mut right) = (End::default(), End::default());
    while middle.len() > 1 {
        let first: usize = middle[0].iter().product();
        let last: usize = middle[middle.len() - 1].iter().product();
        let rows = [left.rank() * first, last * right.rank()];
        if rows[0] <= rows[1] {
            let split = Split::new(&rest, rows[0], Way::Right, limits)?;
            rest = left.take(&middle.pop_front()?, split, Way::Right)?;
        } else {
            let split = Split::new(&rest, rows[1], Way::Left, limits)?;
            rest = right.take(&middle.pop_back()?, split, Way::Left)?;
        }
    }
    let shape = [&[left.rank()], &middle[0][..], &[right.rank()]].concat();
    left.cores.push(ArrayD::from_shape_vec(shape, rest).ok()?);
    left.cores.extend(right.cores.into_iter().rev());
    left.singular.extend(right.singular.into_iter().rev());
    Some(Train {
        layout,
        variables: polynomial.variables,
        cores: left.cores,
        singular: left.singular,
    })
}

/// Towards which end of the train the rest is, from a core that is taken off.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Way {
    Left,
    Right,
}

/// The cores taken off from one end of a train, the outermost first, and the singular values of the bonds
/// behind them.
#[derive(Default)]
struct End {
    cores: Vec<ArrayD<f64>>,
    singular: Vec<Vec<f64>>,
}

impl End {
    /// Of the last bond.
    fn rank(&self) -> usize {
        self.singular.last().map_or(1, Vec::len)
    }

    /// Takes over the core with these axes; the rest.
    fn take(&mut self, axes: &[usize], split: Split, way: Way) -> Option<Vec<f64>> {
        let core = split.core(way);
        let (before, behind) = ([self.rank()], [split.singular.len()]);
        let shape = match way {
            Way::Right => [&before, axes, &behind].concat(),
            Way::Left => [&behind, axes, &before].concat(),
        };
        self.cores.push(ArrayD::from_shape_vec(shape, core).ok()?);
        self.singular.push(split.singular);
        Some(split.rest)
    }
}

/// `A ≈ U (Σ Vᵀ)`.
struct Split {
    singular: Vec<f64>,
    /// U.
    vectors: Mat<f64>,
    /// What is left of the numbers of the train: Σ Vᵀ, row by row if it is to the right of U, else column
    /// by column.
    rest: Vec<f64>,
}

impl Split {
    /// Of the matrix that is `flat`, without singular values below `threshold`; `None` where more than
    /// `most_rank` are left. It has so many `rows`, and no fewer columns; they come one after the other if the rest
    /// is to the right, else its columns do.
    fn new(
        flat: &[f64],
        rows: usize,
        way: Way,
        (threshold, most_rank): (f64, usize),
    ) -> Option<Self> {
        let columns = flat.len() / rows;
        let a = match way {
            Way::Right => MatRef::from_row_major_slice(flat, rows, columns),
            Way::Left => MatRef::from_column_major_slice(flat, rows, columns),
        };
        if rows <= SMALL {
            return Self::exact(a, None, threshold, way);
        }
        let basis = range(a, (threshold, most_rank))?;
        let within = product(basis.transpose(), a);
        let split = Self::exact(within.as_ref(), Some(&basis), threshold, way)?;
        (split.singular.len() <= most_rank).then_some(split)
    }

    /// The decomposition of `a`, or of `basis · a`: with its left singular vectors `Σ Vᵀ = Uᵀ A`.
    fn exact(
        a: MatRef<'_, f64>,
        basis: Option<&Mat<f64>>,
        threshold: f64,
        way: Way,
    ) -> Option<Self> {
        let (u, singular) = left_vectors(a, threshold)?;
        let all = basis.map_or_else(|| u.clone(), |basis| product(basis.as_ref(), u.as_ref()));
        let signs = signs(all.as_ref());
        let signed = |u: Mat<f64>| Mat::from_fn(u.nrows(), u.ncols(), |i, j| signs[j] * u[(i, j)]);
        let (rank, columns) = (singular.len(), a.ncols());
        let mut rest = vec![0.0; rank * columns];
        let to = match way {
            Way::Right => MatMut::from_row_major_slice_mut(&mut rest, rank, columns),
            Way::Left => MatMut::from_column_major_slice_mut(&mut rest, rank, columns),
        };
        product_into(to, signed(u).transpose(), a);
        Some(Self {
            singular,
            vectors: signed(all),
            rest,
        })
    }

    /// U Σ, row by row if the rest is to the right, else column by column.
    fn core(&self, way: Way) -> Vec<f64> {
        let (rows, rank) = (self.vectors.nrows(), self.singular.len());
        let at = |i: usize, j: usize| self.singular[j] * self.vectors[(i, j)];
        match way {
            Way::Right => (0..rows * rank).map(|k| at(k / rank, k % rank)).collect(),
            Way::Left => (0..rows * rank).map(|k| at(k % rows, k / rows)).collect(),
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_bundle::{MappedChebyshev, Shape, Step, Tensor, Tree, Variables};
    use geofan_core::random::Stream;
    use ndarray::IxDyn;
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

    /// The largest difference between numbers of one kind.
    fn farthest(a: &[f64], b: &[f64]) -> f64 {
        let apart = a.iter().zip(b).map(|(a, b)| (a - b).abs());
        apart.fold(0.0, f64::max)
    }

    #[test]
    fn a_rounded_train_is_the_polynomial_within_its_step() {
        for shape in [&[6, 7, 8, 9, 3][..], &[5, 6, 5, 6, 5, 8, 3], &[9, 8, 7, 3]] {
            let cameras = shape.len() - 4;
            let cameras = if shape.len() == 4 { 1 } else { cameras };
            let polynomial = Polynomial {
                coefficients: coefficients(shape),
                variables: Variables::of_face(cameras, MappedChebyshev::new(0.6)),
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
            let read = read_again(&train, &polynomial, shape).at(&x);
            let n = b.len().min(a.len());
            // A reader keeps an eighth of the half step by which integers are rounded.
            let (worst, reading) = (farthest(&a, &b), farthest(&a, &read));
            assert!(reading < 0.25 * worst, "{shape:?} {reading} {worst}");
            assert!(n > 0 && worst < 3e-4, "{shape:?} {worst}");
        }
    }

    #[test]
    fn large_matrices_are_split_as_small_ones_are() {
        let (rows, columns) = (SMALL + 40, SMALL + 300);
        let number = |i: usize, j: usize| -> f64 {
            let waves = (1..12_usize).map(|m| {
                let size = 0.5_f64.powi(m as i32);
                size * ((i * m) as f64).sin() * ((j * m) as f64 * 0.7).cos()
            });
            waves.sum()
        };
        let count = 0..rows * columns;
        let by_rows = count.clone().map(|k| number(k / columns, k % columns));
        let by_columns = count.map(|k| number(k % rows, k / rows));
        let flat = [by_rows.collect::<Vec<_>>(), by_columns.collect()];
        for (way, flat) in [Way::Right, Way::Left].into_iter().zip(&flat) {
            let split = Split::new(flat, rows, way, (1e-7, 100)).unwrap();
            let rank = split.singular.len();
            assert!(rank < 30);
            for (i, j) in [(0, 0), (17, 300), (149, 399), (80, 5)] {
                let rest = |r: usize| match way {
                    Way::Right => split.rest[r * columns + j],
                    Way::Left => split.rest[j * rank + r],
                };
                let sum: f64 = (0..rank).map(|r| split.vectors[(i, r)] * rest(r)).sum();
                assert!((sum - number(i, j)).abs() < 1e-6, "{way:?}");
            }
        }
    }
}
