//! Orthogonal vectors as the numbers that orthogonality leaves free.
//!
//! In: vectors that are orthogonal to each other, the longest first. Out: integers, and back: nearly
//! the same vectors. In a space reflected so that the vectors before it lie along axes, a vector has nothing
//! along those axes: there its integers are zero and need not be stored. Both directions reflect by the
//! *rounded* vectors before, which a reader has too, so that errors of rounding do not add up. Source:
//! Householder's triangularisation, with blocks of reflections multiplied together (R. Schreiber, C. Van
//! Loan, *A storage-efficient WY representation for products of Householder transformations*, SIAM J.
//! Sci. Stat. Comput. 10 (1989)).
//!
//! The cores of a train, each as the centre of an orthogonal train, have columns that are orthogonal to
//! each other (those of all left indices and axes, one for each right index) and rows that are (those of
//! all axes and right indices, one for each left index). The more numerous kind is stored
//! ([`Orthogonality`]): of it the fewest numbers are free.

use crate::matrix::product;
use geofan_core::{Stop, parallel::*};
use std::cmp::Reverse;

/// Reflections that are multiplied together.
const BLOCK: usize = 32;

/// Operations as long as which it takes to round a number and to choose its model.
const ROUNDING: usize = 64;

/// Vectors that one thread reflects at once.
const TOGETHER: usize = 8;

/// The shortest vector, in steps, that tells its direction. A rounded vector is off by more the shorter it
/// is, and the next ones then have something along it that is lost. Three bumps on a quarter of the floor
/// take 466, 459 and 465 kB with 8, 20 and 40, and 523 without any.
const SHORTEST: f64 = 20.0;

/// The kind of vectors of a core that are stored as orthogonal to each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Orthogonality {
    /// One vector for each right index.
    Columns,
    /// One vector for each left index.
    Rows,
}

impl Orthogonality {
    /// Chooses for a core of this shape (left rank, axes…, right rank) behind another. Bonds are divided by
    /// scales, which are only near their singular values. That is made good in the columns before the bond
    /// or in the rows behind it, and these are then no longer orthogonal to those of the other kind: once
    /// rows are stored, columns are not.
    pub fn behind(before: Option<Self>, shape: &[usize]) -> Self {
        match before == Some(Self::Rows) || shape[0] > shape[shape.len() - 1] {
            true => Self::Rows,
            false => Self::Columns,
        }
    }

    /// Counts the vectors; all numbers are one where so many cannot be orthogonal.
    fn count(self, shape: &[usize]) -> usize {
        let count = match self {
            Self::Columns => shape[shape.len() - 1],
            Self::Rows => shape[0],
        };
        match count * count <= shape.iter().product() {
            true => count,
            false => 1,
        }
    }

    /// Returns the length of a vector.
    pub fn length(self, shape: &[usize]) -> usize {
        shape.iter().product::<usize>() / self.count(shape)
    }

    fn transposes(self, shape: &[usize]) -> bool {
        self == Self::Columns && self.count(shape) > 1
    }

    /// Returns the shape of a core of this shape when one vector follows the other.
    pub fn shape(self, shape: &[usize]) -> Vec<usize> {
        let mut vectors = shape.to_vec();
        if self.transposes(shape) {
            vectors.rotate_right(1);
        }
        vectors
    }

    /// Puts the values of a core in storage order one vector after the other.
    pub fn vectors(self, shape: &[usize], values: Vec<f64>) -> Vec<f64> {
        match self.transposes(shape) {
            true => transposed(&values, shape[shape.len() - 1]),
            false => values,
        }
    }

    /// Puts vectors in the storage order of a core: the inverse of [`Orthogonality::vectors`].
    pub fn values(self, shape: &[usize], vectors: Vec<f64>) -> Vec<f64> {
        match self.transposes(shape) {
            true => transposed(&vectors, self.length(shape)),
            false => vectors,
        }
    }
}

/// The axes along which nothing is left of the next vector.
#[derive(Debug)]
pub(crate) struct Pivots(Vec<bool>);

impl Pivots {
    /// Begins before the first vector of this length.
    pub fn none(length: usize) -> Self {
        Self(vec![false; length])
    }

    /// Tells whether the next vector has no number at this place.
    pub fn contains(&self, place: usize) -> bool {
        self.0[place]
    }

    /// Adds the axis that `vector` is carried to, that of its largest number, and returns it. `None` for a
    /// vector too short to tell its direction.
    pub fn add(&mut self, vector: &[i32]) -> Option<usize> {
        if square(vector) < SHORTEST * SHORTEST {
            return None;
        }
        let free = (0..vector.len()).filter(|place| !self.0[*place]);
        let axis = free.max_by_key(|place| (vector[*place].unsigned_abs(), Reverse(*place)))?;
        self.0[axis] = true;
        Some(axis)
    }
}

/// Sums the squares of integers.
fn square(vector: &[i32]) -> f64 {
    vector.iter().map(|x| f64::from(*x).powi(2)).sum()
}

/// The reflection `x − factor (normal · x) normal` of vectors `x`.
#[derive(Debug)]
struct Reflection {
    normal: Vec<f64>,
    factor: f64,
}

impl Reflection {
    /// Makes the reflection that carries `vector` to this axis.
    fn to(axis: usize, vector: &[i32]) -> Self {
        let length = square(vector).sqrt();
        let mut normal: Vec<f64> = vector.iter().map(|x| f64::from(*x) / length).collect();
        normal[axis] += if vector[axis] < 0 { -1.0 } else { 1.0 };
        let factor = 2.0 / dot(&normal, &normal);
        Self { normal, factor }
    }

    fn apply(&self, x: &mut [f64]) {
        let along = self.factor * dot(&self.normal, x);
        for (x, n) in x.iter_mut().zip(&self.normal) {
            *x -= along * n;
        }
    }
}

/// Computes the scalar product, eight sums side by side.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (a, rest_a) = a.as_chunks::<8>();
    let (b, rest_b) = b.as_chunks::<8>();
    let mut sums = [0.0; 8];
    for (a, b) in a.iter().zip(b) {
        for k in 0..8 {
            sums[k] += a[k] * b[k];
        }
    }
    let rest: f64 = rest_a.iter().zip(rest_b).map(|(a, b)| a * b).sum();
    sums.iter().sum::<f64>() + rest
}

/// Reflections one after the other: `1 − Nᵀ T N` on rows from the right, the rows of `N` their normals.
struct ReflectionBlock {
    /// `N`.
    normals: Vec<f64>,
    /// `Nᵀ`.
    columns: Vec<f64>,
    /// `T`.
    inner: Vec<f64>,
    /// `Tᵀ`: the same reflections in the opposite order.
    inner_back: Vec<f64>,
}

impl ReflectionBlock {
    /// Multiplies reflections together; `None` if there are none.
    fn new(reflections: &[Reflection]) -> Option<Self> {
        let count = reflections.len();
        let length = reflections.first()?.normal.len();
        let normals: Vec<f64> = reflections.iter().flat_map(|r| r.normal.clone()).collect();
        // T is upper triangular: each reflection adds a column.
        let mut inner = vec![0.0; count * count];
        for (i, last) in reflections.iter().enumerate() {
            let dots: Vec<f64> = reflections[..i]
                .iter()
                .map(|r| dot(&r.normal, &last.normal))
                .collect();
            for j in 0..i {
                let sum: f64 = (j..i).map(|k| inner[j * count + k] * dots[k]).sum();
                inner[j * count + i] = -last.factor * sum;
            }
            inner[i * count + i] = last.factor;
        }
        Some(Self {
            columns: transposed(&normals, length),
            normals,
            inner_back: transposed(&inner, count),
            inner,
        })
    }

    /// Reflects rows so that the vectors of the block come to lie along axes.
    fn apply(&self, rows: &mut [f64]) {
        self.apply_with(rows, &self.inner);
    }

    /// Reflects rows back.
    fn apply_back(&self, rows: &mut [f64]) {
        self.apply_with(rows, &self.inner_back);
    }

    fn apply_with(&self, rows: &mut [f64], inner: &[f64]) {
        let count = inner.len().isqrt();
        let length = self.normals.len() / count;
        let along = product(rows, length, &self.columns);
        let along = product(&along, count, inner);
        let off = product(&along, count, &self.normals);
        rows.iter_mut().zip(off).for_each(|(x, off)| *x -= off);
    }
}

/// Transposes a matrix of rows of this `width`.
fn transposed<T: Copy>(matrix: &[T], width: usize) -> Vec<T> {
    let column = |c: usize| matrix.iter().skip(c).step_by(width).copied();
    (0..width).flat_map(column).collect()
}

/// Makes integers of `vectors` (rows of `length` numbers). Those of each are made by `round`: it is told the
/// vector, the pivots, where they must be zero, and all integers before, to which it adds its own. `None` when it is
/// stopped.
pub(crate) fn reduced(
    vectors: &[f64],
    length: usize,
    stop: &Stop,
    mut round: impl FnMut(&[f64], &Pivots, &mut Vec<i32>),
) -> Option<Vec<i32>> {
    let mut integers = Vec::with_capacity(vectors.len());
    let mut pivots = Pivots::none(length);
    let mut before: Vec<ReflectionBlock> = Vec::new();
    for vectors in vectors.chunks(BLOCK * length) {
        // Each vector takes two products with all of those before, and as long as some dozens to be rounded.
        if !stop.goes_on(2 * vectors.len() * (BLOCK * before.len() + ROUNDING)) {
            return None;
        }
        // By the blocks before, several vectors at once.
        let mut reflected = vectors.to_vec();
        reflected
            .par_chunks_mut(TOGETHER * length)
            .for_each(|rows| before.iter().for_each(|block| block.apply(rows)));
        // By the vectors before in the same block, one by one.
        let mut own: Vec<Reflection> = Vec::new();
        for vector in reflected.chunks_exact_mut(length) {
            own.iter().for_each(|reflection| reflection.apply(vector));
            let first = integers.len();
            round(vector, &pivots, &mut integers);
            let axis = pivots.add(&integers[first..]);
            own.extend(axis.map(|axis| Reflection::to(axis, &integers[first..])));
        }
        before.extend(ReflectionBlock::new(&own));
    }
    Some(integers)
}

/// Restores the vectors that [`reduced`] made these integers of, nearly.
pub(crate) fn restored(integers: &[i32], length: usize) -> Vec<f64> {
    let mut pivots = Pivots::none(length);
    let rows = integers.chunks_exact(length);
    let axes: Vec<Option<usize>> = rows.map(|row| pivots.add(row)).collect();
    let mut vectors: Vec<f64> = integers.iter().map(|x| f64::from(*x)).collect();
    // Back by the vectors before in the same block, which makes the blocks.
    let blocks: Vec<Option<ReflectionBlock>> = vectors
        .par_chunks_mut(BLOCK * length)
        .zip(integers.par_chunks(BLOCK * length))
        .zip(axes.par_chunks(BLOCK))
        .map(|((vectors, integers), axes)| reflect_back(vectors, (integers, length), axes))
        .collect();
    // Back by the blocks before, the nearest first.
    vectors
        .par_chunks_mut(BLOCK * length)
        .enumerate()
        .for_each(|(k, vectors)| {
            let before = blocks[..k].iter().flatten().rev();
            vectors
                .par_chunks_mut(TOGETHER * length)
                .for_each(|rows| before.clone().for_each(|block| block.apply_back(rows)));
        });
    vectors
}

/// Reflects the `vectors` of these integers, of which each but those too short is carried to one of the
/// `axes`, back by those before in the same block, and returns the block.
fn reflect_back(
    vectors: &mut [f64],
    (integers, length): (&[i32], usize),
    axes: &[Option<usize>],
) -> Option<ReflectionBlock> {
    let mut own: Vec<Reflection> = Vec::new();
    let rows = vectors.chunks_exact_mut(length);
    for ((vector, integers), axis) in rows.zip(integers.chunks_exact(length)).zip(axes) {
        own.iter().rev().for_each(|r| r.apply(vector));
        own.extend(axis.map(|axis| Reflection::to(axis, integers)));
    }
    ReflectionBlock::new(&own)
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::random::Stream;

    #[test]
    fn orthogonal_vectors_come_back_within_rounding() {
        let (count, length) = (70, 150);
        let mut stream = Stream::new(&[5]);
        let mut vectors: Vec<Vec<f64>> = Vec::new();
        for j in 0..count {
            let mut x: Vec<f64> = (0..length).map(|_| stream.between(-1.0, 1.0)).collect();
            for _ in 0..2 {
                for y in &vectors {
                    let along = dot(&x, y) / dot(y, y);
                    x.iter_mut().zip(y).for_each(|(x, y)| *x -= along * y);
                }
            }
            let size = 1e4 * (-0.08 * j as f64).exp() / dot(&x, &x).sqrt();
            x.iter_mut().for_each(|x| *x *= size);
            vectors.push(x);
        }
        let flat = vectors.concat();
        let stop = Stop::default();
        let integers = reduced(&flat, length, &stop, |vector, pivots, integers| {
            let place = |(place, x): (usize, &f64)| match pivots.contains(place) {
                true => 0,
                false => x.round() as i32,
            };
            integers.extend(vector.iter().enumerate().map(place));
        })
        .unwrap();
        let back = restored(&integers, length);
        let errors = flat.iter().zip(&back).map(|(a, b)| (a - b).abs());
        let square: f64 = errors.clone().map(|e| e * e).sum::<f64>() / flat.len() as f64;
        assert!(errors.fold(0.0, f64::max) < 3.0);
        assert!(square.sqrt() < 0.35, "{}", square.sqrt());
        let zeros = integers.iter().filter(|i| **i == 0).count();
        assert!(zeros > count * (count - 1) / 2);
    }

    #[test]
    fn vectors_come_back_as_values() {
        for shape in [
            &[1, 7, 5][..],
            &[5, 6, 4],
            &[4, 3, 2, 1],
            &[2, 2, 9],
            &[1, 8, 1],
        ] {
            let values: Vec<f64> = (0..shape.iter().product::<usize>())
                .map(|i| i as f64)
                .collect();
            for kind in [Orthogonality::Columns, Orthogonality::Rows] {
                let vectors = kind.vectors(shape, values.clone());
                assert_eq!(kind.values(shape, vectors), values);
                assert_eq!(kind.shape(shape).iter().product::<usize>(), values.len());
                assert_eq!(values.len() % kind.length(shape), 0);
            }
        }
        let values = vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0];
        let columns = Orthogonality::Columns.vectors(&[1, 3, 2], values);
        assert_eq!(columns, [0.0, 2.0, 4.0, 1.0, 3.0, 5.0]);
    }

    #[test]
    fn columns_are_stored_while_ranks_grow_and_rows_from_then_on() {
        use Orthogonality::{Columns, Rows};
        let mut before = None;
        let shapes = [[1, 9, 5], [5, 9, 30], [30, 9, 7], [7, 9, 8], [8, 9, 1]];
        for (shape, expected) in shapes.iter().zip([Columns, Columns, Rows, Rows, Rows]) {
            let kind = Orthogonality::behind(before, shape);
            assert_eq!(kind, expected, "{shape:?}");
            before = Some(kind);
        }
    }
}
