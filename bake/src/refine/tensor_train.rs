//! Tensor trains: the order of the axes of a box, and the decomposition of its coefficients.
//!
//! In: the coefficients of a box and a threshold. Out: the [`Layout`] whose cores are smallest
//! ([`best_layout`]), and a [`Train`] whose cores are multiplied by the singular values of their bonds, so
//! that all can be rounded with one step ([`decompose`]). Singular values below the threshold are left
//! out: what belongs to them would round to zero. Source: I. V. Oseledets, *Tensor-train decomposition*,
//! SIAM J. Sci. Comput. 33 (2011), algorithm 1; for large matrices the range is found from random
//! combinations of columns (`large_matrices`).

mod large_matrices;

use faer::{Mat, MatMut, MatRef, Side};
use geofan_bundle::{Layout, Polynomial, Train, weighted_in_order};
use geofan_core::{Stop, random::Stream};
use large_matrices::{gram, product, product_into, range, triangular_factor};
use ndarray::{ArrayD, Order};
use std::collections::{HashSet, VecDeque};

/// Rows and columns of the part of a matrix whose rank is looked at. Half as many cannot tell large ranks
/// apart.
const PART: usize = 160;

/// Fewest ray axes between which there is a choice worth a look: with two, either order has the same
/// bond in the middle.
const FEWEST: usize = 3;

/// Singular values below this share of the largest do not count for the order. Promises of 0.05 to 1 mrad
/// leave out those below 1e-5 to 1e-3; the orders found are the same.
const FLOOR: f64 = 1e-4;

/// Below this smaller side a matrix is decomposed as it is: random combinations save nothing.
const SMALL: usize = 1000;

/// Down to this share of the size of a matrix its singular values are found from its Gram matrix, to within
/// a hundredth; smaller ones drown in rounding errors there, and take a triangular factor.
const GRAM_LIMIT: f64 = 1e-7;

/// Operations for each number of a polynomial that is evaluated at the nodes of some twenty along each of its axes.
const SAMPLING: usize = 100;

/// Operations that the singular values or eigenvectors of a square matrix take, in units of its size cubed.
const DECOMPOSING: usize = 9;

/// Finds the order of the ray axes of a polynomial (axes camera…, direction…, arc length, channel) whose
/// cores are smallest.
///
/// A core holds as many numbers as its axis is long, times the ranks of the bonds on either side, and the
/// rank of a bond depends on nothing but which axes are on either side of it. Those ranks are estimated
/// from small random parts of the matrices in question. The best order is then a shortest way from no axis
/// to all. `None` when it is stopped.
pub fn best_layout(polynomial: &Polynomial, stop: &Stop) -> Option<Layout> {
    let rays = polynomial.coefficients.ndim() - 2;
    if rays < FEWEST {
        let cameras = polynomial.variables.cameras;
        return Some(Layout::paired(cameras, rays - cameras));
    }
    // The rank of the bond behind each set of axes.
    if !stop.goes_on(SAMPLING * polynomial.coefficients.len()) {
        return None;
    }
    let samples = polynomial.samples();
    let all = (1_usize << rays) - 1;
    let bond = |set| {
        stop.goes_on(DECOMPOSING * PART.pow(3))
            .then(|| bond_rank(&samples, rays, set))
    };
    let ranks: Vec<f64> = (0..=all).map(bond).collect::<Option<_>>()?;
    // For each set of axes the smallest cores over them, and the last of them.
    let mut best = vec![(0.0, 0); all + 1];
    for set in 1..=all {
        let ending = |axis: usize| {
            let before = set & !(1 << axis);
            let core = ranks[before] * samples.shape()[axis] as f64 * ranks[set];
            (best[before].0 + core, axis)
        };
        let axes = (0..rays).filter(|axis| set >> axis & 1 == 1);
        let smallest = axes.map(ending).min_by(|a, b| a.0.total_cmp(&b.0));
        best[set] = smallest.expect("a set with axes");
    }
    // From the last axis back to the first.
    let (mut order, mut set) = (Vec::new(), all);
    while set != 0 {
        let last = best[set].1;
        order.push(last);
        set &= !(1 << last);
    }
    order.reverse();
    Some(Layout::Train(order))
}

/// Estimates the rank, weighted with the bits of its singular values, of the matrix whose rows are the
/// nodes of the axes in `set` and whose columns are all others: from values at random nodes of `samples`,
/// which has so many axes of `rays` first.
fn bond_rank(samples: &ArrayD<f64>, rays: usize, set: usize) -> f64 {
    if set == 0 {
        return 1.0;
    }
    let (sizes, rest) = samples.shape().split_at(rays);
    let numbers: usize = rest.iter().product();
    let others = ((1 << rays) - 1) & !set;
    let mut stream = Stream::new(&[set as u64]);
    let rows = distinct_places(|| random_place(sizes, numbers, set, &mut stream));
    let mut stream = Stream::new(&[set as u64, 1]);
    let columns = distinct_places(|| {
        // Every ray has few numbers that are not like their neighbours: one of them each.
        let place = random_place(sizes, numbers, others, &mut stream);
        place + ((stream.uniform() * numbers as f64) as usize).min(numbers - 1)
    });
    let values = samples.as_slice().expect("in standard layout");
    let part = Mat::from_fn(rows.len(), columns.len(), |i, j| {
        values[rows[i] + columns[j]]
    });
    rank_in_bits(&part)
}

/// Draws the place in memory of a random node of the axes in `set`, where each ray has so many `numbers`;
/// places of nodes of the other axes are added to it.
fn random_place(sizes: &[usize], numbers: usize, set: usize, stream: &mut Stream) -> usize {
    let (mut sum, mut stride) = (0, numbers);
    for (axis, n) in sizes.iter().enumerate().rev() {
        if set >> axis & 1 == 1 {
            sum += stride * ((stream.uniform() * *n as f64) as usize).min(n - 1);
        }
        stride *= n;
    }
    sum
}

/// Draws [`PART`] random places, each once: as many as are found.
fn distinct_places(mut place: impl FnMut() -> usize) -> Vec<usize> {
    let mut places: Vec<usize> = (0..2 * PART).map(|_| place()).collect();
    let mut seen = HashSet::new();
    places.retain(|place| seen.insert(*place));
    places.truncate(PART);
    places
}

/// Estimates the rank of a matrix, weighted with the bits of its singular values.
pub fn rank_in_bits(part: &Mat<f64>) -> f64 {
    let Ok(sizes) = part.singular_values() else {
        return f64::INFINITY;
    };
    let largest = sizes.iter().copied().fold(0.0, f64::max);
    let floor = FLOOR * largest;
    sizes.iter().map(|x| (1.0 + x / floor).log2()).sum()
}

/// Decomposes `polynomial` (axes camera…, direction…, arc length, channel) into a train in the order of
/// `layout`, without its singular values below the threshold of `limits`; `None` where a rank exceeds their
/// second, or when it is stopped.
///
/// Cores are taken off from both ends, those with the fewest numbers in a row first: each narrows what is
/// left, and the largest matrices come last, when little is left of them. For boxes of five axes that takes
/// 0.82 of the time of going from one end to the other.
pub fn decompose(
    polynomial: &Polynomial,
    layout: Layout,
    limits: (f64, usize),
    stop: &Stop,
) -> Option<Train> {
    let coefficients = &polynomial.coefficients;
    let axes = layout.cores(coefficients.ndim() - 2);
    let order: Vec<usize> = axes.iter().flatten().copied().collect();
    let mut rest = weighted_in_order(coefficients, &order[..order.len() - 2]);
    let shape = |axes: &Vec<usize>| -> Vec<usize> {
        axes.iter().map(|a| coefficients.shape()[*a]).collect()
    };
    let mut middle: VecDeque<Vec<usize>> = axes.iter().map(shape).collect();
    let (mut left, mut right) = (TrainEnd::default(), TrainEnd::default());
    while middle.len() > 1 {
        if !stop.goes_on(rest.len()) {
            return None;
        }
        // The narrower of the two cores at the ends, with the bond behind it.
        let first: usize = middle[0].iter().product();
        let last: usize = middle[middle.len() - 1].iter().product();
        let rows = [left.rank() * first, last * right.rank()];
        if rows[0] <= rows[1] {
            let split = SingularSplit::new(&rest, (rows[0], Order::RowMajor), limits, stop)?;
            rest = left.take(&middle.pop_front()?, split, Order::RowMajor)?;
        } else {
            let split = SingularSplit::new(&rest, (rows[1], Order::ColumnMajor), limits, stop)?;
            rest = right.take(&middle.pop_back()?, split, Order::ColumnMajor)?;
        }
    }
    // The last core is what remains between both ends.
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

/// Cores taken off from one end of a train, the outermost first, and the singular values of the bonds
/// behind them.
#[derive(Default)]
struct TrainEnd {
    cores: Vec<ArrayD<f64>>,
    singular: Vec<Vec<f64>>,
}

impl TrainEnd {
    /// Returns the rank of the last bond.
    fn rank(&self) -> usize {
        self.singular.last().map_or(1, Vec::len)
    }

    /// Takes over the core with these axes, which was split off in this `order`; returns the rest.
    fn take(&mut self, axes: &[usize], split: SingularSplit, order: Order) -> Option<Vec<f64>> {
        let core = split.core(order);
        let (before, behind) = ([self.rank()], [split.singular.len()]);
        let shape = match order {
            Order::RowMajor => [&before, axes, &behind].concat(),
            _ => [&behind, axes, &before].concat(),
        };
        self.cores.push(ArrayD::from_shape_vec(shape, core).ok()?);
        self.singular.push(split.singular);
        Some(split.rest)
    }
}

/// The singular value decomposition `A ≈ U (Σ Vᵀ)` by which a core is split off the numbers of a train:
/// those of the first core are the rows of a row-major matrix, those of the last one the rows of a
/// column-major one.
struct SingularSplit {
    singular: Vec<f64>,
    /// U.
    vectors: Mat<f64>,
    /// The remaining numbers of the train, Σ Vᵀ, in the order of A.
    rest: Vec<f64>,
}

impl SingularSplit {
    /// Decomposes the matrix with so many `rows`, and no fewer columns, whose numbers in this `order` are
    /// `flat`, without singular values below `threshold`; `None` where more than `most_rank` are left.
    fn new(
        flat: &[f64],
        (rows, order): (usize, Order),
        (threshold, most_rank): (f64, usize),
        stop: &Stop,
    ) -> Option<Self> {
        let columns = flat.len() / rows;
        let a = match order {
            Order::RowMajor => MatRef::from_row_major_slice(flat, rows, columns),
            _ => MatRef::from_column_major_slice(flat, rows, columns),
        };
        if rows <= SMALL {
            return Self::exact(a, None, (threshold, order), stop);
        }
        let basis = range(a, (threshold, most_rank), stop)?;
        let within = product(basis.transpose(), a, stop)?;
        let split = Self::exact(within.as_ref(), Some(&basis), (threshold, order), stop)?;
        (split.singular.len() <= most_rank).then_some(split)
    }

    /// Decomposes `a`, or `basis · a`: with its left singular vectors `Σ Vᵀ = Uᵀ A`.
    fn exact(
        a: MatRef<'_, f64>,
        basis: Option<&Mat<f64>>,
        (threshold, order): (f64, Order),
        stop: &Stop,
    ) -> Option<Self> {
        let (u, singular) = left_vectors(a, threshold, stop)?;
        let all = match basis {
            Some(basis) => product(basis.as_ref(), u.as_ref(), stop)?,
            None => u.clone(),
        };
        let signs = signs(all.as_ref());
        let signed = |u: Mat<f64>| Mat::from_fn(u.nrows(), u.ncols(), |i, j| signs[j] * u[(i, j)]);
        let (rank, columns) = (singular.len(), a.ncols());
        let mut rest = vec![0.0; rank * columns];
        let to = match order {
            Order::RowMajor => MatMut::from_row_major_slice_mut(&mut rest, rank, columns),
            _ => MatMut::from_column_major_slice_mut(&mut rest, rank, columns),
        };
        product_into(to, signed(u).transpose(), a, stop)?;
        Some(Self {
            singular,
            vectors: signed(all),
            rest,
        })
    }

    /// Returns U Σ in this `order`.
    fn core(&self, order: Order) -> Vec<f64> {
        let (rows, rank) = (self.vectors.nrows(), self.singular.len());
        let at = |i: usize, j: usize| self.singular[j] * self.vectors[(i, j)];
        match order {
            Order::RowMajor => (0..rows * rank).map(|k| at(k / rank, k % rank)).collect(),
            _ => (0..rows * rank).map(|k| at(k % rows, k / rows)).collect(),
        }
    }
}

/// Finds the left singular vectors of `a` and their singular values, of those above `threshold`: from its
/// Gram matrix or, where that is not accurate enough, from its triangular factor (LQ).
fn left_vectors(a: MatRef<'_, f64>, threshold: f64, stop: &Stop) -> Option<(Mat<f64>, Vec<f64>)> {
    let gram = gram(a, stop)?;
    let size: f64 = (0..a.nrows()).map(|i| gram[(i, i)]).sum::<f64>().sqrt();
    if threshold < GRAM_LIMIT * size {
        let factor = triangular_factor(a, stop)?;
        if !stop.goes_on(DECOMPOSING * a.nrows().pow(3)) {
            return None;
        }
        let svd = factor.transpose().thin_svd().ok()?;
        let sizes = svd.S().column_vector().iter().copied();
        let large = above(sizes, threshold);
        return Some((svd.U().subcols(0, large.len()).to_owned(), large));
    }
    if !stop.goes_on(DECOMPOSING * a.nrows().pow(3)) {
        return None;
    }
    let found = gram.self_adjoint_eigen(Side::Lower).ok()?;
    let squares = found.S().column_vector().iter().rev();
    let large = above(squares.map(|x| x.max(0.0).sqrt()), threshold);
    let vectors = found.U().reverse_cols();
    Some((vectors.subcols(0, large.len()).to_owned(), large))
}

/// Returns the singular values above `threshold` of those in falling order, the largest at least.
fn above(sizes: impl Iterator<Item = f64>, threshold: f64) -> Vec<f64> {
    let mut all = sizes.peekable();
    let largest = all.peek().copied();
    let large: Vec<f64> = all.take_while(|x| *x > threshold).collect();
    if large.is_empty() {
        largest.into_iter().collect()
    } else {
        large
    }
}

/// Chooses the signs of singular pairs, which are arbitrary: with these the largest entry of each left
/// vector is positive, so that a bake is reproducible.
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
    use geofan_bundle::{
        DecodeBudget, MappedChebyshev, StepSize, Tensor, TensorShape, Tree, Variables,
    };
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

    /// Reads the bytes of `tensor` again.
    fn read_again(tensor: &Tensor, polynomial: &Polynomial, shape: &[usize]) -> Tensor {
        let cameras = polynomial.variables.cameras;
        let bytes = Tree::Leaf(Arc::new(tensor.clone())).encode();
        let shape = TensorShape {
            variables: polynomial.variables,
            directions: shape.len() - 2 - cameras,
            channels: shape[shape.len() - 1],
        };
        let Ok(Tree::Leaf(read)) = Tree::decode(
            &bytes,
            shape,
            &std::sync::Arc::new(DecodeBudget::for_bytes(bytes.len())),
        ) else {
            panic!("{shape:?}")
        };
        Arc::unwrap_or_clone(read)
    }

    /// Returns the largest difference.
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
            let step = StepSize::near(1e-5);
            let layout = Layout::paired(cameras, shape.len() - 2 - cameras);
            let train = decompose(&polynomial, layout, (0.3e-5, 500), &Stop::default())
                .unwrap()
                .rounded(step)
                .unwrap();
            let plain = Train::plain(&polynomial)
                .rounded(StepSize::near(2e-6))
                .unwrap();
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
        for (order, flat) in [Order::RowMajor, Order::ColumnMajor].into_iter().zip(&flat) {
            let stop = Stop::default();
            let split = SingularSplit::new(flat, (rows, order), (1e-7, 100), &stop).unwrap();
            let rank = split.singular.len();
            assert!(rank < 30);
            for (i, j) in [(0, 0), (17, 300), (149, 399), (80, 5)] {
                let rest = |r: usize| match order {
                    Order::RowMajor => split.rest[r * columns + j],
                    _ => split.rest[j * rank + r],
                };
                let sum: f64 = (0..rank).map(|r| split.vectors[(i, r)] * rest(r)).sum();
                assert!((sum - number(i, j)).abs() < 1e-6, "{order:?}");
            }
        }
    }
}
