//! The rounded cores of a train.
//!
//! In: integers as they are kept ([`super::reflections`]). Out: a [`Core`] whose values can be summed,
//! coded integers, and back.
//!
//! Numbers of few bytes: steps, and scales of bonds.
//!
//! Both are powers of a root of two, kept as exponents of 16 bits.
//!
//! Products of chains of matrices.
//!
//! In: cores with open axes between their ranks. Out: their product, in the order of the fewest
//! multiplications.

use crate::{
    coder::{Coded, Integers},
    decode::{DecodeError, Reader, Writer},
    householder::{Side, restored},
    matrix::{product, summed},
    packed_matrix::{Axes, Packed, Packing, Sums},
};
use geofan_expr::real::Real;

/// The most coefficients along the arc length.
pub const MOST_DEGREES: usize = 64;

/// The most coefficients along another axis.
pub const MOST_TERMS: usize = 128;

/// The most integers of a core: far above any that a bake makes.
const MOST_INTEGERS: u64 = 1 << 24;

/// A rounded core.
#[derive(Debug, Clone)]
pub(super) struct Core {
    /// Left rank, lengths of its axes, right rank.
    pub shape: Vec<usize>,
    /// Along which axis it is read.
    along: Along,
    /// Which vectors are kept.
    pub side: Side,
    /// In storage order, in units of the step.
    values: Packed,
    /// What values are restored from, in the order of the file, in units of the step.
    kept: Vec<i32>,
    /// By what the columns of each right index were multiplied; none after the last core.
    pub scales: Vec<Scale>,
    /// What columns are to be multiplied by to have the same unit: powers of two whose exponents are no integers,
    /// which take 1 % of fixing a camera if they are worked out for each.
    factors: Vec<f64>,
}

impl Core {
    /// Of what is kept of the vectors of one `side`.
    pub fn new(
        (shape, along): (Vec<usize>, Along),
        side: Side,
        kept: Vec<i32>,
        scales: Vec<Scale>,
        packing: Packing,
    ) -> Self {
        let vectors = restored(&kept, side.length(&shape));
        let values = side.values(&shape, vectors);
        let factors = match scales.is_empty() {
            true => vec![1.0; row(&shape)],
            false => scales.iter().map(|scale| 1.0 / scale.value()).collect(),
        };
        Self {
            factors,
            values: Packed::new(&values, along.axes(&shape), packing),
            shape,
            along,
            side,
            kept,
            scales,
        }
    }

    /// How many integers are kept.
    pub fn integers(&self) -> usize {
        self.kept.len()
    }

    /// The core with the axes that have `weights` summed out, times `unit`, its columns divided by
    /// their scales: a matrix (left rank, open axes × right rank).
    pub fn closed<T: Real>(&self, weights: &[Option<&[T]>], unit: f64) -> Vec<T> {
        let factors = self.factors(unit);
        let mut shape = self.shape.clone();
        let (mut values, mut weights) = match (self.along, weights) {
            (Along::FirstAxis, [Some(first), rest @ ..]) => {
                let length = shape.remove(1);
                (self.values.summed(&first[..length], &factors), rest)
            }
            _ => (self.values.real(&factors), weights),
        };
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

    /// The same for the only axis of a core that is read along it, before columns are divided.
    pub fn sums<T: Real>(&self, weights: &[T], unit: f64) -> Sums<T> {
        let weights = &weights[..self.shape[1]];
        self.values.sums(weights, &self.factors(unit))
    }

    /// The product of a matrix of rows of the left rank and the core with all its axes, times `unit`, its
    /// columns divided by their scales. The core is one that is read along its left rank.
    pub fn behind<T: Real>(&self, a: &[T], unit: f64) -> Vec<T> {
        self.values.product(a, &self.factors(unit))
    }

    /// What the columns are to be multiplied by.
    fn factors(&self, unit: f64) -> Vec<f64> {
        self.factors.iter().map(|factor| unit * factor).collect()
    }

    /// Writes lengths of axes to `out` and all integers to `integers`.
    pub fn encode(&self, out: &mut Writer, integers: &mut Integers, step: Step) {
        self.shape[1..].iter().for_each(|n| out.u32(*n as u32));
        let length = self.side.length(&self.shape);
        integers.put(&self.side.shape(&self.shape), length, &self.kept);
        let mut before = step.scale().0;
        let scales = self.scales.iter().map(|scale| {
            let difference = i32::from(scale.0) - i32::from(before);
            before = scale.0;
            difference
        });
        let scales: Vec<i32> = scales.collect();
        integers.put(&[scales.len()], scales.len(), &scales);
    }

    /// Reads what [`Core::encode`] wrote: a core of so many `axes` behind another, and whether it is the
    /// last.
    ///
    /// # Errors
    /// It is not one.
    pub fn decode(
        input: &mut Reader<'_>,
        coded: &mut Coded,
        (before, last): (Option<&Self>, bool),
        (axes, along): (usize, Along),
        step: Step,
    ) -> Result<Self, DecodeError> {
        let left = before.map_or(1, |core| core.scales.len());
        let shape = decode_shape(input, left, axes, last)?;
        let side = Side::behind(before.map(|core| core.side), &shape);
        let kept = coded.take(&side.shape(&shape), side.length(&shape))?;
        let ranks = if last { 0 } else { shape[axes + 1] };
        let mut before = i32::from(step.scale().0);
        let scales = coded.take(&[ranks], ranks)?.into_iter().map(|difference| {
            before = before.saturating_add(difference);
            i16::try_from(before)
                .map(Power)
                .map_err(|_| DecodeError("scale of a rank"))
        });
        let scales = scales.collect::<Result<_, _>>()?;
        Ok(Self::new(
            (shape, along),
            side,
            kept,
            scales,
            Packing::Small,
        ))
    }
}

/// The axis along which a core is read: the one that is summed out first when a camera is fixed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Along {
    LeftRank,
    /// Of those between the ranks.
    FirstAxis,
}

impl Along {
    /// Of a core over `axes` of a tensor with so many `cameras` axes.
    pub fn of(axes: &[usize], cameras: usize) -> Self {
        match axes[0] < cameras {
            true => Self::FirstAxis,
            false => Self::LeftRank,
        }
    }

    fn axes(self, shape: &[usize]) -> Axes {
        let along = match self {
            Self::LeftRank => 0,
            Self::FirstAxis => 1,
        };
        let columns = row(shape);
        let before = shape[..along].iter().product();
        let all: usize = shape.iter().product();
        Axes {
            before,
            along: shape[along],
            after: all / (before * shape[along] * columns),
            columns,
        }
    }
}

/// The length of the rows in which the numbers of a core are kept: those of a right index each, in the last
/// core of arc length and channel.
fn row(shape: &[usize]) -> usize {
    let axes = if shape.len() > 3 { shape.len() - 3 } else { 2 };
    shape[axes..].iter().product()
}

/// The shape of a core whose left rank is `left`.
fn decode_shape(
    input: &mut Reader<'_>,
    left: usize,
    axes: usize,
    last: bool,
) -> Result<Vec<usize>, DecodeError> {
    let mut shape = vec![left];
    let mut count = left as u64;
    for _ in 0..=axes {
        let n = input.u32()?;
        count = count.saturating_mul(n.into());
        shape.push(n as usize);
    }
    let lengths = if last { shape[axes - 1] } else { 0 };
    let too_many = lengths > MOST_DEGREES || shape[1..=axes].iter().any(|n| *n > MOST_TERMS);
    if too_many || (last && shape[axes + 1] != 1) {
        return Err(DecodeError("number of degrees"));
    }
    if count == 0 || count > MOST_INTEGERS {
        return Err(DecodeError("number of coefficients"));
    }
    Ok(shape)
}

/// `2^(k/N)`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Power<const N: i16>(pub(super) i16);

/// By what a column of a core is multiplied: any number near the singular value will do.
pub type Scale = Power<4>;

/// The unit that numbers are rounded to multiples of. As coarse as scales, steps would be on average
/// 9 % finer than they need to be; one step of 4 % was 2.3 % of the bytes of a patch of the floor.
pub type Step = Power<32>;

impl<const N: i16> Power<N> {
    /// The nearest to `x`, clamped to the range of 16 bits.
    pub fn near(x: f64) -> Self {
        Self((f64::from(N) * x.log2()).round() as i16)
    }

    /// The number.
    pub fn value(self) -> f64 {
        (f64::from(self.0) / f64::from(N)).exp2()
    }
}

impl Step {
    /// The step so many times coarser by `2^(1/32)`.
    pub fn coarser(self, times: i16) -> Self {
        Self(self.0.saturating_add(times))
    }

    /// A scale of about this size.
    pub(super) fn scale(self) -> Scale {
        Power(self.0.div_euclid(8))
    }
}

/// An array (left rank, open axes, right rank).
#[derive(Debug, Clone)]
pub(super) struct Link<T> {
    pub left: usize,
    pub right: usize,
    pub values: Vec<T>,
}

/// A factor of a chain.
#[derive(Debug, Clone)]
pub(super) enum Factor<'c, T> {
    /// Whose numbers are known.
    Known(Link<T>),
    /// A core all of whose axes are open, times a unit: as it is kept it is read faster than it is restored.
    Kept(&'c Core, f64),
    /// A core whose only axis is summed out with weights, times a unit: not before it is multiplied, so that few
    /// sums are held at once.
    Summed(&'c Core, &'c [T], f64),
}

impl<T: Real> Factor<'_, T> {
    /// The left rank.
    fn left(&self) -> usize {
        match self {
            Self::Known(link) => link.left,
            Self::Kept(core, _) | Self::Summed(core, ..) => core.shape[0],
        }
    }

    fn right(&self) -> usize {
        match self {
            Self::Known(link) => link.right,
            Self::Kept(core, _) | Self::Summed(core, ..) => core.shape[core.shape.len() - 1],
        }
    }

    /// The product of the lengths of the open axes.
    fn open(&self) -> usize {
        match self {
            Self::Known(link) => link.values.len() / (link.left * link.right).max(1),
            Self::Kept(core, _) => core.shape[1..core.shape.len() - 1].iter().product(),
            Self::Summed(..) => 1,
        }
    }

    /// The numbers.
    fn values(self) -> Vec<T> {
        match self {
            Self::Known(link) => link.values,
            Self::Kept(core, unit) => core.closed(&[], unit),
            Self::Summed(core, weights, unit) => core.sums(weights, unit).values(),
        }
    }

    /// The product of this and the next.
    fn times(self, next: &Self) -> Self {
        let (left, inner, right) = (self.left(), self.right(), next.right());
        let a = self.values();
        let values = match next {
            Self::Known(link) => product(&a, inner, &link.values),
            Self::Kept(core, unit) => core.behind(&a, *unit),
            Self::Summed(core, weights, unit) => core.sums(weights, *unit).behind(&a, inner),
        };
        Self::Known(Link {
            left,
            right,
            values,
        })
    }
}

/// The product of `factors`, whose ranks fit: the open axes of all, in their order.
pub(super) fn chained<T: Real>(mut factors: Vec<Factor<'_, T>>) -> Vec<T> {
    while factors.len() > 1 {
        let first = cheapest(&factors);
        let second = factors.remove(first + 1);
        let joined = factors.remove(first).times(&second);
        factors.insert(first, joined);
    }
    factors.pop().map_or(Vec::new(), Factor::values)
}

/// The first of the two neighbours to be multiplied next: those that belong together in the order of
/// the fewest multiplications.
fn cheapest<T: Real>(factors: &[Factor<'_, T>]) -> usize {
    let n = factors.len();
    let open = |i: usize, j: usize| -> usize { factors[i..=j].iter().map(Factor::open).product() };
    // Fewest multiplications for the factors i to j, and after which of them they are parted last.
    let mut best = vec![vec![(0_usize, 0_usize); n]; n];
    for length in 2..=n {
        for i in 0..=n - length {
            let j = i + length - 1;
            let joining = |k: usize| {
                let ends = factors[i].left() * open(i, j) * factors[j].right();
                (
                    best[i][k].0 + best[k + 1][j].0 + ends * factors[k].right(),
                    k,
                )
            };
            best[i][j] = (i..j).map(joining).min().unwrap_or_default();
        }
    }
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
mod scale_tests {
    use super::*;

    #[test]
    fn steps_and_scales_are_near_what_they_stand_for() {
        for x in [1e-9, 3e-4, 1.0, 7.0, 1e6] {
            assert!((Step::near(x).value() / x).log2().abs() <= 1.0 / 64.0 + 1e-12);
            assert!((Scale::near(x).value() / x).log2().abs() <= 1.0 / 8.0 + 1e-12);
            assert!((Step::near(x).scale().value() / x).log2().abs() <= 0.3);
            assert!(
                (Step::near(x).coarser(32).value() / Step::near(x).value() - 2.0).abs() < 1e-12
            );
        }
    }
}

#[cfg(test)]
mod chain_tests {
    use super::*;

    #[test]
    fn chains_of_any_shape_are_multiplied() {
        // Ranks 1, 3, 5, 2, 1 with open axes 4, 1, 7, 3.
        let shapes = [(1, 4, 3), (3, 1, 5), (5, 7, 2), (2, 3, 1)];
        let number = |i: usize| ((i * 37 % 11) as f64) - 5.0;
        let links = |from: usize| {
            let links = shapes.iter().skip(from).map(|&(left, open, right)| Link {
                left,
                right,
                values: (0..left * open * right).map(number).collect(),
            });
            links.collect::<Vec<_>>()
        };
        let chained = |from| chained(links(from).into_iter().map(Factor::Known).collect());
        let mut expected = vec![1.0];
        let mut rank = 1;
        for link in links(0) {
            expected = product(&expected, rank, &link.values);
            rank = link.right;
        }
        assert_eq!(chained(0), expected);
        assert_eq!(chained(3), links(3)[0].values);
    }
}
