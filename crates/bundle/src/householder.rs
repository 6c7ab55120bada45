//! What orthogonality leaves free of vectors.
//!
//! In: vectors that are orthogonal to each other, the longest first. Out: integers, and back: nearly
//! the same vectors. In a space turned so that the vectors before it lie along axes, a vector has nothing
//! along those axes: there its integers are zero and need not be kept. Both directions reflect by the
//! *rounded* vectors before, which a reader has too, so that errors of rounding do not add up. Source:
//! Householder's triangularisation, with blocks of reflections multiplied together (R. Schreiber, C. Van
//! Loan, *A storage-efficient WY representation for products of Householder transformations*, SIAM J.
//! Sci. Stat. Comput. 10 (1989)).
//!
//! Which vectors of a core are kept one after the other.
//!
//! The cores of a train, each as the centre of an orthogonal train, have columns that are orthogonal to
//! each other (those of all left indices and axes, one for each right index) and rows that are (those of
//! all axes and right indices, one for each left index). Of one kind [`super::reflections`] keeps what
//! orthogonality leaves free; of the more numerous kind that is least.

use crate::matrix::product;
use crate::parallel::*;
use std::cmp::Reverse;

/// Reflections that are multiplied together.
const BLOCK: usize = 32;

/// Vectors that one thread turns at once.
const TOGETHER: usize = 8;

/// The shortest vector, in steps, that tells its direction. A rounded vector is off by more the shorter it
/// is, and the next ones then have something along it that is lost. Three bumps on a quarter of the floor
/// take 466, 459 and 465 kB with 8, 20 and 40, and 523 without any.
const SHORTEST: f64 = 20.0;

/// Which way vectors are turned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Way {
    /// Those before come to lie along axes.
    There,
    Back,
}

/// `x − factor (normal · x) normal` for vectors `x`.
#[derive(Debug)]
struct Reflection {
    normal: Vec<f64>,
    factor: f64,
}

/// The axes along which nothing is left of the next vector.
#[derive(Debug)]
pub(super) struct Taken(Vec<bool>);

impl Taken {
    /// None yet, of vectors of this length.
    pub(super) fn none(length: usize) -> Self {
        Self(vec![false; length])
    }

    /// Whether the next vector has no number at this place.
    pub(super) fn holds(&self, place: usize) -> bool {
        self.0[place]
    }

    /// After `vector`, takes the axis that it is carried to: that of its largest number. `None` for one too
    /// short to tell its direction.
    pub(super) fn behind(&mut self, vector: &[i32]) -> Option<usize> {
        if square(vector) < SHORTEST * SHORTEST {
            return None;
        }
        let free = (0..vector.len()).filter(|place| !self.0[*place]);
        let axis = free.max_by_key(|place| (vector[*place].unsigned_abs(), Reverse(*place)))?;
        self.0[axis] = true;
        Some(axis)
    }
}

/// The sum of squares.
fn square(vector: &[i32]) -> f64 {
    vector.iter().map(|x| f64::from(*x).powi(2)).sum()
}

impl Reflection {
    /// That carries `vector` to a new axis.
    fn of(vector: &[i32], taken: &mut Taken) -> Option<Self> {
        taken.behind(vector).map(|axis| Self::to(axis, vector))
    }

    /// That carries `vector` to this axis.
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
struct Block {
    normals: Vec<f64>,
    columns: Vec<f64>,
    inner: [Vec<f64>; 2],
}

impl Block {
    fn new(reflections: &[Reflection]) -> Option<Self> {
        let count = reflections.len();
        let length = reflections.first()?.normal.len();
        let normals: Vec<f64> = reflections.iter().flat_map(|r| r.normal.clone()).collect();
        let columns = transposed(&normals, length);
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
        let back = transposed(&inner, count);
        Some(Self {
            normals,
            columns,
            inner: [inner, back],
        })
    }

    fn apply(&self, rows: &mut [f64], way: Way) {
        let inner = &self.inner[usize::from(way == Way::Back)];
        let count = inner.len().isqrt();
        let length = self.normals.len() / count;
        let along = product(rows, length, &self.columns);
        let along = product(&along, count, inner);
        let off = product(&along, count, &self.normals);
        rows.iter_mut().zip(off).for_each(|(x, off)| *x -= off);
    }
}

/// Applies blocks one after the other to vectors of this `length`.
fn turn<'a>(
    vectors: &mut [f64],
    length: usize,
    blocks: impl Iterator<Item = &'a Block> + Clone + Sync,
    way: Way,
) {
    vectors
        .par_chunks_mut(TOGETHER * length)
        .for_each(|vectors| blocks.clone().for_each(|block| block.apply(vectors, way)));
}

/// A matrix of rows of this `width`, transposed.
pub(super) fn transposed<T: Copy>(matrix: &[T], width: usize) -> Vec<T> {
    let column = |c: usize| matrix.iter().skip(c).step_by(width).copied();
    (0..width).flat_map(column).collect()
}

/// Integers of `vectors` (rows of `length` numbers). Those of each are made by `round`: it is told the
/// vector, which axes are taken, where they must be zero, and all integers before, to which it adds its own.
pub(super) fn reduced(
    vectors: &[f64],
    length: usize,
    mut round: impl FnMut(&[f64], &Taken, &mut Vec<i32>),
) -> Vec<i32> {
    let mut integers = Vec::with_capacity(vectors.len());
    let mut taken = Taken::none(length);
    let mut before: Vec<Block> = Vec::new();
    for vectors in vectors.chunks(BLOCK * length) {
        let mut turned = vectors.to_vec();
        turn(&mut turned, length, before.iter(), Way::There);
        let mut own: Vec<Reflection> = Vec::new();
        for vector in turned.chunks_exact_mut(length) {
            own.iter().for_each(|reflection| reflection.apply(vector));
            let first = integers.len();
            round(vector, &taken, &mut integers);
            own.extend(Reflection::of(&integers[first..], &mut taken));
        }
        before.extend(Block::new(&own));
    }
    integers
}

/// The vectors that [`reduced`] made these integers of, nearly.
pub(super) fn restored(integers: &[i32], length: usize) -> Vec<f64> {
    let mut taken = Taken::none(length);
    let rows = integers.chunks_exact(length);
    let axes: Vec<Option<usize>> = rows.map(|row| taken.behind(row)).collect();
    let mut vectors: Vec<f64> = integers.iter().map(|x| f64::from(*x)).collect();
    let blocks: Vec<Option<Block>> = vectors
        .par_chunks_mut(BLOCK * length)
        .zip(integers.par_chunks(BLOCK * length))
        .zip(axes.par_chunks(BLOCK))
        .map(|((vectors, integers), axes)| turned_back(vectors, (integers, length), axes))
        .collect();
    vectors
        .par_chunks_mut(BLOCK * length)
        .enumerate()
        .for_each(|(k, vectors)| {
            let before = blocks[..k].iter().flatten().rev();
            turn(vectors, length, before, Way::Back);
        });
    vectors
}

/// Turns the `vectors` of these integers, of which each but those too short is carried to one of the
/// `axes`, back by the reflections of those before in the same block, which it gives.
fn turned_back(
    vectors: &mut [f64],
    (integers, length): (&[i32], usize),
    axes: &[Option<usize>],
) -> Option<Block> {
    let mut own: Vec<Reflection> = Vec::new();
    let rows = vectors.chunks_exact_mut(length);
    for ((vector, integers), axis) in rows.zip(integers.chunks_exact(length)).zip(axes) {
        own.iter().rev().for_each(|r| r.apply(vector));
        own.extend(axis.map(|axis| Reflection::to(axis, integers)));
    }
    Block::new(&own)
}

/// The kind of vectors that are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    /// One for each right index.
    Columns,
    /// One for each left index.
    Rows,
}

impl Side {
    /// Of a core of this shape (left rank, axes…, right rank) behind another. Bonds are divided by scales,
    /// which are only near their singular values. That is made good in the columns before the bond or
    /// in the rows behind it, and these are then no longer orthogonal to those of the other kind: once
    /// rows are kept, columns are not.
    pub(super) fn behind(before: Option<Self>, shape: &[usize]) -> Self {
        match before == Some(Self::Rows) || shape[0] > shape[shape.len() - 1] {
            true => Self::Rows,
            false => Self::Columns,
        }
    }

    /// How many vectors there are; all numbers are one where so many cannot be orthogonal.
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

    /// How long they are.
    pub(super) fn length(self, shape: &[usize]) -> usize {
        shape.iter().product::<usize>() / self.count(shape)
    }

    fn turns(self, shape: &[usize]) -> bool {
        self == Self::Columns && self.count(shape) > 1
    }

    /// The shape of a core of this shape as one vector after the other.
    pub(super) fn shape(self, shape: &[usize]) -> Vec<usize> {
        let mut turned = shape.to_vec();
        if self.turns(shape) {
            turned.rotate_right(1);
        }
        turned
    }

    /// One vector after the other of the values of a core in storage order.
    pub(super) fn vectors(self, shape: &[usize], values: Vec<f64>) -> Vec<f64> {
        match self.turns(shape) {
            true => transposed(&values, shape[shape.len() - 1]),
            false => values,
        }
    }

    /// What [`Side::vectors`] made these of.
    pub(super) fn values(self, shape: &[usize], vectors: Vec<f64>) -> Vec<f64> {
        match self.turns(shape) {
            true => transposed(&vectors, self.length(shape)),
            false => vectors,
        }
    }
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
        let integers = reduced(&flat, length, |vector, taken, integers| {
            let place = |(place, x): (usize, &f64)| match taken.holds(place) {
                true => 0,
                false => x.round() as i32,
            };
            integers.extend(vector.iter().enumerate().map(place));
        });
        let back = restored(&integers, length);
        let errors = flat.iter().zip(&back).map(|(a, b)| (a - b).abs());
        let square: f64 = errors.clone().map(|e| e * e).sum::<f64>() / flat.len() as f64;
        assert!(errors.fold(0.0, f64::max) < 3.0);
        assert!(square.sqrt() < 0.35, "{}", square.sqrt());
        let zeros = integers.iter().filter(|i| **i == 0).count();
        assert!(zeros > count * (count - 1) / 2);
    }
}

#[cfg(test)]
mod side_tests {
    use super::*;

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
            for side in [Side::Columns, Side::Rows] {
                let vectors = side.vectors(shape, values.clone());
                assert_eq!(side.values(shape, vectors), values);
                assert_eq!(side.shape(shape).iter().product::<usize>(), values.len());
                assert_eq!(values.len() % side.length(shape), 0);
            }
        }
        let columns = Side::Columns.vectors(&[1, 3, 2], vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
        assert_eq!(columns, [0.0, 2.0, 4.0, 1.0, 3.0, 5.0]);
    }

    #[test]
    fn columns_are_kept_while_ranks_grow_and_rows_from_then_on() {
        let mut before = None;
        let shapes = [[1, 9, 5], [5, 9, 30], [30, 9, 7], [7, 9, 8], [8, 9, 1]];
        let expected = [
            Side::Columns,
            Side::Columns,
            Side::Rows,
            Side::Rows,
            Side::Rows,
        ];
        for (shape, expected) in shapes.iter().zip(expected) {
            let side = Side::behind(before, shape);
            assert_eq!(side, expected, "{shape:?}");
            before = Some(side);
        }
    }
}
