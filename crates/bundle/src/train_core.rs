//! The rounded cores of a tensor train, and products of chains of them.
//!
//! In: integers as they are stored ([`crate::householder`]). Out: [`Core`]s whose values can be summed,
//! coded integers and back; and the product of a chain of cores and matrices with open axes between their
//! ranks, in the order of the fewest multiplications ([`matrix_chain`]).

use crate::{
    coder::{IntegerDecoder, IntegerEncoder},
    decode::{ByteReader, CoreSizes, DecodeBudget, DecodeError},
    householder::{Orthogonality, restored},
    matrix::{product, summed},
    packed_matrix::{PackedMatrix, Packing, PaddedSums, PanelAxes},
};
use geofan_expr::{real::Real, vectorised};

/// The most coefficients along the arc length.
pub const MOST_DEGREES: usize = 64;

/// The most coefficients along another axis.
pub const MOST_TERMS: usize = 128;

/// The most integers of a core: far above any that a bake makes.
const MOST_CORE_INTEGERS: u64 = 1 << 24;

/// The largest exponent of two of a step or a scale: with those of charts in kilometres and promises of
/// nanoradians there is twice as much room as tables need.
const MOST_EXPONENT: f64 = 100.0;

/// The number `2^(k/N)`, in two bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Power<const N: i16>(pub(crate) i16);

/// The factor of a column of a core: any number near the singular value will do.
pub type Scale = Power<4>;

/// The unit that numbers are rounded to multiples of. As coarse as scales, steps would be on average
/// 9 % finer than they need to be; one step of 4 % was 2.3 % of the bytes of a patch of the floor.
pub type StepSize = Power<32>;

impl<const N: i16> Power<N> {
    /// Finds the power nearest to `x`, clamped to the range of 16 bits.
    pub fn near(x: f64) -> Self {
        Self((f64::from(N) * x.log2()).round() as i16)
    }

    /// Returns the power, if products of a few of its kind and sums of them are finite in single precision.
    ///
    /// # Errors
    /// It is not: no bake makes such a power.
    pub(crate) fn within_range(self, what: &'static str) -> Result<Self, DecodeError> {
        match (f64::from(self.0) / f64::from(N)).abs() <= MOST_EXPONENT {
            true => Ok(self),
            false => Err(DecodeError(what)),
        }
    }

    /// Returns the number.
    pub fn value(self) -> f64 {
        (f64::from(self.0) / f64::from(N)).exp2()
    }
}

impl StepSize {
    /// Returns the step coarser by `2^(times/32)`.
    pub fn coarser(self, times: i16) -> Self {
        Self(self.0.saturating_add(times))
    }

    /// Returns a scale of about this size.
    fn scale(self) -> Scale {
        Power(self.0.div_euclid(8))
    }
}

/// Returns the axis of a core over `axes` along which it is read, the one that is summed out first when a
/// camera is fixed: the left rank (0), or the first axis behind it (1) if that is a camera's.
pub(crate) fn axis_along(axes: &[usize], cameras: usize) -> usize {
    usize::from(axes[0] < cameras)
}

/// A rounded core.
#[derive(Debug, Clone)]
pub(crate) struct Core {
    /// Left rank, lengths of its axes, right rank.
    pub shape: Vec<usize>,
    /// The axis of the shape along which it is read.
    along: usize,
    /// The vectors that are stored.
    pub orthogonality: Orthogonality,
    /// In storage order, in units of the step.
    values: PackedMatrix,
    /// The integers that values are restored from, in the order of the file, in units of the step.
    integers: Vec<i32>,
    /// The factors of the columns of each right index; none after the last core.
    pub scales: Vec<Scale>,
    /// The factors that give all columns the same unit: powers of two whose exponents are no integers,
    /// which take 1 % of fixing a camera if they are worked out for each.
    factors: Vec<f64>,
    /// No sum of its numbers is larger, in units of the step.
    pub largest_sum: f64,
}

impl Core {
    /// Restores the core of the integers of its vectors, to be read along the axis `along`.
    pub fn new(
        (shape, along): (Vec<usize>, usize),
        orthogonality: Orthogonality,
        integers: Vec<i32>,
        scales: Vec<Scale>,
        packing: Packing,
    ) -> Self {
        let vectors = restored(&integers, orthogonality.length(&shape));
        let values = orthogonality.values(&shape, vectors);
        let factors = match scales.is_empty() {
            true => vec![1.0; row(&shape)],
            false => scales.iter().map(|scale| 1.0 / scale.value()).collect(),
        };
        let largest = largest_product(&values, &factors);
        let summed = shape[..shape.len() - 1].iter().product::<usize>();
        Self {
            largest_sum: largest * summed as f64,
            factors,
            values: PackedMatrix::new(&values, panel_axes(&shape, along), packing),
            shape,
            along,
            orthogonality,
            integers,
            scales,
        }
    }

    /// Counts the integers that are stored.
    pub fn integers(&self) -> usize {
        self.integers.len()
    }

    /// Sums out the axes that have `weights`: the core times `unit`, its columns divided by their scales, as
    /// a matrix (left rank, open axes × right rank).
    pub fn closed<T: Real>(&self, weights: &[Option<&[T]>], unit: f64) -> Vec<T> {
        let factors = self.factors(unit);
        let mut shape = self.shape.clone();
        // The first axis as it is stored, if it is to be summed out.
        let (mut values, mut weights) = match (self.along, weights) {
            (1, [Some(first), rest @ ..]) => {
                let length = shape.remove(1);
                (self.values.summed(&first[..length], &factors), rest)
            }
            _ => (self.values.real(&factors), weights),
        };
        // The others one after the other.
        let mut axis = 1;
        while let [first, rest @ ..] = weights {
            match first {
                None => axis += 1,
                Some(weights) => {
                    let left: usize = shape[..axis].iter().product();
                    let length = shape.remove(axis);
                    let right = values.len() / (left * length);
                    values = summed(&values, left, right, &weights[..length]);
                }
            }
            weights = rest;
        }
        values
    }

    /// Sums out the only axis of a core that is read along it; its columns are not divided yet.
    pub fn sums<T: Real>(&self, weights: &[T], unit: f64) -> PaddedSums<T> {
        let weights = &weights[..self.shape[1]];
        self.values.sums(weights, &self.factors(unit))
    }

    /// Multiplies a matrix of rows of the left rank and the core with all its axes, times `unit`, its
    /// columns divided by their scales. The core is one that is read along its left rank.
    pub fn behind<T: Real>(&self, a: &[T], unit: f64) -> Vec<T> {
        self.values.product(a, &self.factors(unit))
    }

    /// Returns the factors of the columns, times `unit`.
    fn factors(&self, unit: f64) -> Vec<f64> {
        self.factors.iter().map(|factor| unit * factor).collect()
    }

    /// Writes lengths of axes to `out` and all integers to `integers`.
    pub fn encode(&self, out: &mut Vec<u8>, integers: &mut IntegerEncoder, step: StepSize) {
        let lengths = self.shape[1..].iter();
        lengths.for_each(|n| out.extend((*n as u32).to_le_bytes()));
        let length = self.orthogonality.length(&self.shape);
        let shape = self.orthogonality.shape(&self.shape);
        integers.put(&shape, length, &self.integers);
        // Scales, each as its difference from the one before.
        let mut before = step.scale().0;
        let scales = self.scales.iter().map(|scale| {
            let difference = i32::from(scale.0) - i32::from(before);
            before = scale.0;
            difference
        });
        let scales: Vec<i32> = scales.collect();
        integers.put(&[scales.len()], scales.len(), &scales);
    }
}

/// A core as it is read, before its values are restored.
#[derive(Debug)]
pub(crate) struct StoredCore {
    shape: Vec<usize>,
    along: usize,
    orthogonality: Orthogonality,
    integers: Vec<i32>,
    scales: Vec<Scale>,
}

impl StoredCore {
    /// Reads what [`Core::encode`] wrote: a core with `axes` axes, read along the axis `along`, behind
    /// another, and whether it is the last.
    ///
    /// # Errors
    /// It is not one.
    pub fn decode(
        input: &mut ByteReader<'_>,
        integers: &mut IntegerDecoder,
        (before, last): (Option<(Orthogonality, usize)>, bool),
        (axes, along): (usize, usize),
        (step, budget): (StepSize, &DecodeBudget),
    ) -> Result<Self, DecodeError> {
        let left = before.map_or(1, |(_, ranks)| ranks);
        // The shape, and the vectors that are stored.
        let shape = decode_shape(input, left, axes, last)?;
        let orthogonality =
            Orthogonality::behind(before.map(|(orthogonality, _)| orthogonality), &shape);
        let length = orthogonality.length(&shape);
        budget.take_core(core_sizes(&shape, along, length))?;
        let stored = integers.take(&orthogonality.shape(&shape), length)?;
        // The scales, each by its difference from the one before.
        let ranks = if last { 0 } else { shape[axes + 1] };
        let mut before = i32::from(step.scale().0);
        let scales = integers
            .take(&[ranks], ranks)?
            .into_iter()
            .map(|difference| {
                before = before.saturating_add(difference);
                let scale = i16::try_from(before).map(Power);
                scale
                    .map_err(|_| DecodeError("scale of a rank"))?
                    .within_range("scale of a rank")
            });
        let scales = scales.collect::<Result<_, _>>()?;
        Ok(Self {
            shape,
            along,
            orthogonality,
            integers: stored,
            scales,
        })
    }

    /// Returns what the next core has to know: how this one is orthogonal, and the number of its ranks.
    pub fn before(&self) -> (Orthogonality, usize) {
        (self.orthogonality, self.scales.len())
    }

    /// Returns the length of an axis of the core.
    pub fn length(&self, axis: usize) -> usize {
        self.shape[1 + axis]
    }

    /// Restores the values.
    ///
    /// # Errors
    /// They need more memory than is left of the budget.
    pub fn restored(self, budget: &DecodeBudget) -> Result<Core, DecodeError> {
        let shape = (self.shape, self.along);
        let (kind, packing) = (self.orthogonality, Packing::Small);
        let core = Core::new(shape, kind, self.integers, self.scales, packing);
        budget.take_memory(core.values.bytes() as u64)?;
        Ok(core)
    }
}

/// Finds the largest magnitude of rows of `values` multiplied by `factors`.
fn largest_product(values: &[f64], factors: &[f64]) -> f64 {
    let mut largest = vec![0.0_f64; factors.len()];
    vectorised(
        #[inline(always)]
        || {
            for row in values.chunks_exact(factors.len()) {
                for ((largest, x), factor) in largest.iter_mut().zip(row).zip(factors) {
                    *largest = largest.max((x * factor).abs());
                }
            }
        },
    );
    largest.into_iter().fold(0.0, f64::max)
}

/// Returns the sizes of a core of this shape, its vectors of this `length`.
fn core_sizes(shape: &[usize], along: usize, length: usize) -> CoreSizes {
    let integers = shape.iter().product::<usize>();
    CoreSizes {
        integers: integers as u64,
        vectors: length.min(integers / length.max(1)) as u64,
        padded: panel_axes(shape, along).padded() as u64,
    }
}

/// Arranges the axes of a core of this shape as those of a packed matrix.
fn panel_axes(shape: &[usize], along: usize) -> PanelAxes {
    let columns = row(shape);
    let before = shape[..along].iter().product();
    let all: usize = shape.iter().product();
    PanelAxes {
        before,
        along: shape[along],
        after: all / (before * shape[along] * columns),
        columns,
    }
}

/// Returns the length of the rows in which the numbers of a core are stored: those of a right index each,
/// in the last core of arc length and channel.
fn row(shape: &[usize]) -> usize {
    let axes = if shape.len() > 3 { shape.len() - 3 } else { 2 };
    shape[axes..].iter().product()
}

/// Reads the shape of a core whose left rank is `left`.
fn decode_shape(
    input: &mut ByteReader<'_>,
    left: usize,
    axes: usize,
    last: bool,
) -> Result<Vec<usize>, DecodeError> {
    // Lengths, multiplied without overflow.
    let mut shape = vec![left];
    let mut count = left as u64;
    for _ in 0..=axes {
        let n = input.u32()?;
        count = count.saturating_mul(n.into());
        shape.push(n as usize);
    }
    // Within the limits of all kernels.
    let lengths = if last { shape[axes - 1] } else { 0 };
    let too_many = lengths > MOST_DEGREES || shape[1..=axes].iter().any(|n| *n > MOST_TERMS);
    if too_many || (last && shape[axes + 1] != 1) {
        return Err(DecodeError("number of degrees"));
    }
    if count == 0 || count > MOST_CORE_INTEGERS {
        return Err(DecodeError("number of coefficients"));
    }
    Ok(shape)
}

/// An array (left rank, open axes, right rank).
#[derive(Debug, Clone)]
pub(crate) struct OpenMatrix<T> {
    pub left: usize,
    pub right: usize,
    pub values: Vec<T>,
}

/// A factor of a matrix chain.
#[derive(Debug, Clone)]
pub(crate) enum Factor<'c, T> {
    /// A matrix whose numbers are known.
    Known(OpenMatrix<T>),
    /// A core all of whose axes are open, times a unit: packed it is read faster than it is restored.
    Packed(&'c Core, f64),
    /// A core whose only axis is summed out with weights, times a unit: not before it is multiplied, so that
    /// few sums are held at once.
    Summed(&'c Core, &'c [T], f64),
}

impl<T: Real> Factor<'_, T> {
    fn left(&self) -> usize {
        match self {
            Self::Known(matrix) => matrix.left,
            Self::Packed(core, _) | Self::Summed(core, ..) => core.shape[0],
        }
    }

    fn right(&self) -> usize {
        match self {
            Self::Known(matrix) => matrix.right,
            Self::Packed(core, _) | Self::Summed(core, ..) => core.shape[core.shape.len() - 1],
        }
    }

    /// Multiplies the lengths of the open axes.
    fn open(&self) -> usize {
        match self {
            Self::Known(matrix) => matrix.values.len() / (matrix.left * matrix.right).max(1),
            Self::Packed(core, _) => core.shape[1..core.shape.len() - 1].iter().product(),
            Self::Summed(..) => 1,
        }
    }

    /// Computes the numbers.
    fn values(self) -> Vec<T> {
        match self {
            Self::Known(matrix) => matrix.values,
            Self::Packed(core, unit) => core.closed(&[], unit),
            Self::Summed(core, weights, unit) => core.sums(weights, unit).values(),
        }
    }

    /// Multiplies this and the next.
    fn times(self, next: &Self) -> Self {
        let (left, inner, right) = (self.left(), self.right(), next.right());
        let a = self.values();
        let values = match next {
            Self::Known(matrix) => product(&a, inner, &matrix.values),
            Self::Packed(core, unit) => core.behind(&a, *unit),
            Self::Summed(core, weights, unit) => core.sums(weights, *unit).behind(&a, inner),
        };
        Self::Known(OpenMatrix {
            left,
            right,
            values,
        })
    }
}

/// Multiplies `factors` whose ranks fit; the open axes of all stay in their order.
pub(crate) fn matrix_chain<T: Real>(mut factors: Vec<Factor<'_, T>>) -> Vec<T> {
    while factors.len() > 1 {
        let first = cheapest(&factors);
        let second = factors.remove(first + 1);
        let joined = factors.remove(first).times(&second);
        factors.insert(first, joined);
    }
    factors.pop().map_or(Vec::new(), Factor::values)
}

/// Finds the first of the two neighbours to be multiplied next: those that belong together in the order of
/// the fewest multiplications.
fn cheapest<T: Real>(factors: &[Factor<'_, T>]) -> usize {
    let n = factors.len();
    let open = |i: usize, j: usize| -> usize { factors[i..=j].iter().map(Factor::open).product() };
    // Fewest multiplications for the factors i to j, and the factor after which they are parted last.
    let mut best = vec![vec![(0_usize, 0_usize); n]; n];
    for length in 2..=n {
        for i in 0..=n - length {
            let j = i + length - 1;
            let joining = |k: usize| {
                let ends = factors[i].left() * open(i, j) * factors[j].right();
                let parts = best[i][k].0 + best[k + 1][j].0;
                (parts + ends * factors[k].right(), k)
            };
            best[i][j] = (i..j).map(joining).min().unwrap_or_default();
        }
    }
    // Down to a pair.
    let (mut i, mut j) = (0, n - 1);
    while j > i + 1 {
        let after = best[i][j].1;
        (i, j) = if after > i {
            (i, after)
        } else {
            (after + 1, j)
        };
    }
    i
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_and_scales_are_near_what_they_stand_for() {
        for x in [1e-9, 3e-4, 1.0, 7.0, 1e6] {
            assert!((StepSize::near(x).value() / x).log2().abs() <= 1.0 / 64.0 + 1e-12);
            assert!((Scale::near(x).value() / x).log2().abs() <= 1.0 / 8.0 + 1e-12);
            assert!((StepSize::near(x).scale().value() / x).log2().abs() <= 0.3);
            let twice = StepSize::near(x).coarser(32).value() / StepSize::near(x).value();
            assert!((twice - 2.0).abs() < 1e-12);
        }
    }

    #[test]
    fn chains_of_any_shape_are_multiplied() {
        // Ranks 1, 3, 5, 2, 1 with open axes 4, 1, 7, 3.
        let shapes = [(1, 4, 3), (3, 1, 5), (5, 7, 2), (2, 3, 1)];
        let number = |i: usize| ((i * 37 % 11) as f64) - 5.0;
        let matrices = |from: usize| {
            let matrices = shapes.iter().skip(from);
            let matrices = matrices.map(|&(left, open, right)| OpenMatrix {
                left,
                right,
                values: (0..left * open * right).map(number).collect(),
            });
            matrices.collect::<Vec<_>>()
        };
        let chain = |from| matrix_chain(matrices(from).into_iter().map(Factor::Known).collect());
        let mut expected = vec![1.0];
        let mut rank = 1;
        for matrix in matrices(0) {
            expected = product(&expected, rank, &matrix.values);
            rank = matrix.right;
        }
        assert_eq!(chain(0), expected);
        assert_eq!(chain(3), matrices(3)[0].values);
    }
}
