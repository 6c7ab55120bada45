//! The rounded cores of a train.
//!
//! In: integers as they are kept ([`super::reflections`]). Out: a [`Core`] whose values can be summed,
//! coded integers, and back.

use super::{
    bytes::{DecodeError, Reader, Writer},
    coding::{Coded, Integers},
    matrix::summed,
    packed::{Packed, Sums},
    packing::{Axes, Packing},
    reflections::restored,
    scale::{Power, Scale, Step},
    side::Side,
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
