//! Quantised Chebyshev coefficients of one group of channels, as a tensor train.
//!
//! In: real cores and a step. Out: rounded cores, coded with those of the other patches of a chunk
//! ([`Tensor::encode`]), and the small table that remains when the camera is fixed
//! ([`Tensor::contract`]); the tensor itself is never unpacked.
//!
//! A tensor with axes (camera…, direction…, arc length, channel) is a product of cores
//! `C_1 D_1 C_2 D_2 … C_d`, each over one axis (the last over arc length and channel), in the order
//! that its [`Layout`] tells. The diagonal matrices `D_k` divide by the singular values of the bond, and the cores are multiplied by them:
//! `C_k` is then the centre of a train that is orthogonal to both sides, so that one step for all
//! cores makes each rounded integer cost the same error (I. V. Oseledets, *Tensor-train
//! decomposition*, SIAM J. Sci. Comput. 33 (2011)). [`Layout::Plain`] is the same with a single
//! core over all axes: where ranks explode it is smaller.

use super::{
    bytes::{Damage, Reader, Writer},
    chain::{Link, chained},
    chebyshev,
    coding::{self, Classes, Streams},
    contracted::Contracted,
    layout::Layout,
    matrix::{scaled, summed},
};
use crate::expr::{real::Real, vectorised};
use ndarray::{ArrayD, Axis, Slice};

/// The most coefficients along one axis.
pub const MOST_DEGREES: usize = 64;

/// The most integers of a core: far above any that a bake makes.
const MOST_INTEGERS: u64 = 1 << 24;

/// Largest rounded coefficient: sums of a few in 32 bits stay exact.
const LARGEST: f64 = (1 << 30) as f64;

/// Steps and scales are powers of `2^(1/4)`: 9 % of a step is not worth eight bytes.
const PER_OCTAVE: f64 = 4.0;

/// A number of the form `2^(k/4)`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Scale(i16);

impl Scale {
    /// The nearest to `x`, clamped to the range of 16 bits.
    pub fn near(x: f64) -> Self {
        Self((PER_OCTAVE * x.log2()).round() as i16)
    }

    /// The number.
    pub fn value(self) -> f64 {
        (f64::from(self.0) / PER_OCTAVE).exp2()
    }
}

/// A rounded core.
#[derive(Debug, Clone)]
struct Core {
    /// Left rank, lengths of its axes, right rank.
    shape: Vec<usize>,
    /// In storage order, in units of the step.
    values: Vec<i32>,
    /// By what the columns of each right index were multiplied; none after the last core.
    scales: Vec<Scale>,
}

/// Quantised coefficients of one group of channels.
#[derive(Debug, Clone)]
pub struct Tensor {
    layout: Layout,
    cameras: usize,
    step: Scale,
    cores: Vec<Core>,
}

/// A tensor train before rounding: cores scaled to the right by the singular values of their bonds.
#[derive(Debug, Clone)]
pub struct Train {
    /// How axes are shared out.
    pub layout: Layout,
    /// The number of camera axes.
    pub cameras: usize,
    /// Cores (left rank, axes…, right rank), the columns of all but the last multiplied by the
    /// values of their scales.
    pub cores: Vec<ArrayD<f64>>,
    /// Scales of each bond.
    pub scales: Vec<Vec<Scale>>,
}

impl Train {
    /// All coefficients as one core.
    pub fn plain(coefficients: &ArrayD<f64>, cameras: usize) -> Self {
        let core = graded(coefficients).insert_axis(Axis(0));
        let last = Axis(core.ndim());
        Self {
            layout: Layout::Plain,
            cameras,
            cores: vec![core.insert_axis(last)],
            scales: Vec::new(),
        }
    }

    /// Rounded to multiples of `step`; what is zero at the ends of axes and bonds is left out.
    /// `None` if a coefficient is too large for the step.
    pub fn rounded(&self, step: Scale) -> Option<Tensor> {
        let unit = step.value();
        let mut rounded = Vec::new();
        for core in &self.cores {
            rounded.push(integers(core, unit)?);
        }
        let ranks = kept_ranks(&rounded);
        let mut cores = Vec::new();
        for (k, core) in rounded.into_iter().enumerate() {
            let left = if k == 0 { &[0][..] } else { &ranks[k - 1] };
            let right = ranks.get(k).map_or(&[0][..], Vec::as_slice);
            let scales = self.scales.get(k);
            let scales = scales.map_or(Vec::new(), |s| right.iter().map(|&j| s[j]).collect());
            let last = k + 1 == self.cores.len();
            let core = selected(core, 0, left);
            let right_axis = core.ndim() - 1;
            let core = selected(core, right_axis, right);
            cores.push(Core::new(trimmed(core, last), scales));
        }
        Some(Tensor {
            layout: self.layout.clone(),
            cameras: self.cameras,
            step,
            cores,
        })
    }
}

/// Adding and subtracting this rounds numbers below 2⁵¹ to integers, in every lane of a register;
/// `round` is a call for each.
const TO_INTEGER: f64 = 6_755_399_441_055_744.0;

/// `core` in units of `unit`, rounded; `None` if a number is too large.
fn integers(core: &ArrayD<f64>, unit: f64) -> Option<ArrayD<i32>> {
    let inverse = 1.0 / unit;
    let core = core.as_standard_layout();
    let values = core.as_slice()?;
    let mut rounded = vec![0_i32; values.len()];
    let mut fits = true;
    vectorised(
        #[inline(always)]
        || {
            for (to, from) in rounded.iter_mut().zip(values) {
                let x = from * inverse;
                fits &= x.abs() < LARGEST;
                *to = ((x + TO_INTEGER) - TO_INTEGER) as i32;
            }
        },
    );
    let rounded = ArrayD::from_shape_vec(core.raw_dim(), rounded).ok()?;
    fits.then_some(rounded)
}

/// The entries of `core` at `kept` along `axis`.
fn selected(core: ArrayD<i32>, axis: usize, kept: &[usize]) -> ArrayD<i32> {
    match kept.len() == core.len_of(Axis(axis)) {
        true => core,
        false => core.select(Axis(axis), kept),
    }
}

/// For each bond the indices whose column and row are not zero; at least one.
fn kept_ranks(cores: &[ArrayD<i32>]) -> Vec<Vec<usize>> {
    let lives = |core: &ArrayD<i32>, axis: usize, j: usize| {
        core.index_axis(Axis(axis), j).iter().any(|c| *c != 0)
    };
    let pairs = cores.windows(2);
    let kept = pairs.map(|pair| {
        let axis = pair[0].ndim() - 1;
        let both = |j: &usize| lives(&pair[0], axis, *j) && lives(&pair[1], 0, *j);
        let kept: Vec<usize> = (0..pair[1].len_of(Axis(0))).filter(both).collect();
        if kept.is_empty() { vec![0] } else { kept }
    });
    kept.collect()
}

/// Without the degrees beyond the last that is not zero; the channels of the last core are kept.
fn trimmed(core: ArrayD<i32>, last: bool) -> ArrayD<i32> {
    let shape = core.shape().to_vec();
    let core = core.as_standard_layout();
    let mut kept = vec![1; shape.len()];
    let values = core.as_slice().unwrap_or_default();
    for (flat, _) in values.iter().enumerate().filter(|(_, value)| **value != 0) {
        let mut rest = flat;
        for (axis, n) in shape.iter().enumerate().rev() {
            kept[axis] = kept[axis].max(rest % n + 1);
            rest /= n;
        }
    }
    let (right, channel) = (shape.len() - 1, shape.len() - 2);
    let slice = core.slice_each_axis(|axis| {
        let a = axis.axis.index();
        match a == 0 || a == right || (last && a == channel) {
            true => Slice::from(..),
            false => Slice::from(..kept[a]),
        }
    });
    slice.to_owned()
}

impl Core {
    fn new(values: ArrayD<i32>, scales: Vec<Scale>) -> Self {
        Self {
            shape: values.shape().to_vec(),
            values: values.as_standard_layout().iter().copied().collect(),
            scales,
        }
    }

    /// The core with the axes that have `weights` summed out, times `unit`, its columns divided by
    /// their scales: a matrix (left rank, open axes × right rank).
    fn closed<T: Real>(&self, weights: &[Option<&[T]>], unit: f64) -> Vec<T> {
        let integer = |x: &i32| T::from_f64(f64::from(*x));
        let mut shape = self.shape.clone();
        let mut values: Option<Vec<T>> = None;
        let mut axis = 1;
        for weights in weights {
            let Some(weights) = weights else {
                axis += 1;
                continue;
            };
            let left: usize = shape[..axis].iter().product();
            let right: usize = shape[axis + 1..].iter().product();
            let weights = &weights[..shape[axis]];
            values = Some(match values {
                None => summed(&self.values, integer, left, right, weights),
                Some(values) => summed(&values, |x| *x, left, right, weights),
            });
            shape.remove(axis);
        }
        let divisors = self.scales.iter().map(|s| T::from_f64(unit / s.value()));
        let divisors: Vec<T> = match self.scales.is_empty() {
            true => vec![T::from_f64(unit)],
            false => divisors.collect(),
        };
        match values {
            Some(values) => scaled(&values, |x| *x, &divisors),
            None => scaled(&self.values, integer, &divisors),
        }
    }
}

impl Tensor {
    /// The number of axes: camera…, direction…, arc length, channel.
    fn axes(&self) -> usize {
        self.cores.iter().map(|core| core.shape.len() - 2).sum()
    }

    fn table_axes(&self) -> Vec<Vec<usize>> {
        self.layout.cores(self.axes() - 2)
    }

    /// The lengths of the axes (camera…, direction…, arc length, channel).
    pub fn shape(&self) -> Vec<usize> {
        let mut shape = vec![0; self.axes()];
        for (axes, core) in self.table_axes().iter().zip(&self.cores) {
            for (axis, n) in axes.iter().zip(&core.shape[1..]) {
                shape[*axis] = *n;
            }
        }
        shape
    }

    /// The ranks of the bonds; none in the plain layout.
    pub fn ranks(&self) -> Vec<usize> {
        let inner = &self.cores[..self.cores.len() - 1];
        inner.iter().map(|core| core.scales.len()).collect()
    }

    /// The coefficients that remain when the axes with `weights` are summed out, in table order.
    fn sum<T: Real>(&self, weights: &[Option<&[T]>]) -> Vec<T> {
        let table_axes = self.table_axes();
        let mut left = 1;
        let links = table_axes.iter().zip(&self.cores).map(|(axes, core)| {
            let weights: Vec<Option<&[T]>> = axes.iter().map(|a| weights[*a]).collect();
            let right = core.shape[core.shape.len() - 1];
            // The unit of the step belongs to every core.
            let mut values = core.closed(&weights, self.step.value());
            if axes.len() > 1 {
                ungrade(&mut values, &core.shape);
            }
            let link = Link {
                left,
                right,
                values,
            };
            left = right;
            link
        });
        let sums = chained(links.collect());
        let open = table_axes.concat();
        let open: Vec<usize> = open.into_iter().filter(|a| weights[*a].is_none()).collect();
        in_table_order(sums, &open, &self.shape())
    }

    /// The table over (direction 1, direction 2, arc length, channel) that remains at camera
    /// parameters `camera` in [−1, 1]; with one direction parameter the second axis has length 1.
    /// In single precision, as the table is kept: rounding adds 1e-7 or so of the largest
    /// coefficient.
    pub fn contract(&self, camera: &[f64]) -> Contracted {
        Contracted::new(&self.shape()[self.cameras..], &self.at_in::<f32>(camera))
    }

    /// The coefficients that remain at parameters in [−1, 1] of the first axes, in table order. With
    /// camera and direction, for a single ray, that is cheaper than [`Tensor::contract`].
    pub fn at(&self, parameters: &[f64]) -> Vec<f64> {
        self.at_in(parameters)
    }

    fn at_in<T: Real>(&self, parameters: &[f64]) -> Vec<T> {
        let shape = self.shape();
        let weights = values_at(&shape, parameters);
        let mut all: Vec<Option<&[T]>> = weights.iter().map(|w| Some(w.as_slice())).collect();
        all.resize(shape.len(), None);
        self.sum(&all)
    }

    /// How many integers it holds, of 32 bits each.
    pub fn integers(&self) -> usize {
        self.cores.iter().map(|core| core.values.len()).sum()
    }

    /// About how many bytes it takes in a chunk.
    pub fn bytes(&self) -> f64 {
        let cores = self.cores.iter();
        let bits: f64 = cores.map(|c| coding::bits(&c.shape, &c.values)).sum();
        let scales: usize = self.ranks().iter().sum();
        4.0 + 4.0 * self.cores.len() as f64 + 0.6 * scales as f64 + bits / 8.0
    }

    /// Writes the tensor: its shape to `out`, its integers to `classes`.
    pub fn encode(&self, out: &mut Writer, classes: &mut Classes) {
        out.u8(self.layout.code());
        out.i16(self.step.0);
        for core in &self.cores {
            core.shape[1..].iter().for_each(|n| out.u32(*n as u32));
            classes.put(&core.shape, &core.values);
            let mut before = self.step.0;
            let scales = core.scales.iter().map(|scale| {
                let difference = i32::from(scale.0) - i32::from(before);
                before = scale.0;
                difference
            });
            classes.put(&[core.scales.len()], &scales.collect::<Vec<_>>());
        }
    }

    /// Reads what [`Tensor::encode`] wrote: a tensor of so many axes and `channels`.
    ///
    /// # Errors
    /// It is not one.
    pub fn decode(
        input: &mut Reader<'_>,
        streams: &mut Streams,
        [cameras, directions, channels]: [usize; 3],
    ) -> Result<Self, Damage> {
        let layout = Layout::of_code(input.u8()?, cameras + directions);
        let layout = layout.ok_or(Damage("layout of a tensor"))?;
        let step = Scale(input.i16()?);
        let mut cores: Vec<Core> = Vec::new();
        let axes = layout.cores(cameras + directions);
        for (k, axes_of_core) in axes.iter().enumerate() {
            let left = cores.last().map_or(1, |c| c.scales.len());
            let last = k + 1 == axes.len();
            let core = Core::decode(input, streams, left, axes_of_core.len(), (last, step))?;
            if last && core.shape[axes_of_core.len()] != channels {
                return Err(Damage("number of channels"));
            }
            cores.push(core);
        }
        Ok(Self {
            layout,
            cameras,
            step,
            cores,
        })
    }
}

impl Core {
    fn decode(
        input: &mut Reader<'_>,
        streams: &mut Streams,
        left: usize,
        axes: usize,
        (last, step): (bool, Scale),
    ) -> Result<Self, Damage> {
        let mut shape = vec![left];
        let mut count = left as u64;
        for _ in 0..=axes {
            let n = input.u32()?;
            count = count.saturating_mul(n.into());
            shape.push(n as usize);
        }
        let right = shape[axes + 1];
        if shape[1..=axes].iter().any(|n| *n > MOST_DEGREES) || (last && right != 1) {
            return Err(Damage("number of degrees"));
        }
        if count == 0 || count > MOST_INTEGERS {
            return Err(Damage("number of coefficients"));
        }
        let values = streams.take(&shape)?;
        let ranks = if last { 0 } else { right };
        let mut before = i32::from(step.0);
        let scales = streams.take(&[ranks])?.into_iter().map(|difference| {
            before = before.saturating_add(difference);
            i16::try_from(before)
                .map(Scale)
                .map_err(|_| Damage("scale of a rank"))
        });
        Ok(Self {
            shape,
            values,
            scales: scales.collect::<Result<_, _>>()?,
        })
    }
}

/// How much more coarsely coefficients of degree `k` along the arc length are rounded: an error of that
/// degree in the slope moves points by 1/k of it. With the degree itself instead of its root tangents
/// suffer (three bumps on a rail 318 kB, 281 kB with the root, 326 kB without).
fn coarseness(degree: usize) -> f64 {
    ((1 + degree) as f64).sqrt()
}

/// Coefficients (…, arc length, channel) as they are rounded.
pub fn graded(coefficients: &ArrayD<f64>) -> ArrayD<f64> {
    by_degree(coefficients, |x, factor| x / factor)
}

/// What [`graded`] makes these `coefficients` of.
pub fn ungraded(coefficients: &ArrayD<f64>) -> ArrayD<f64> {
    by_degree(coefficients, |x, factor| x * factor)
}

/// Each coefficient with the [`coarseness`] of its degree.
fn by_degree(coefficients: &ArrayD<f64>, with: impl Fn(f64, f64) -> f64) -> ArrayD<f64> {
    let mut changed = coefficients.clone();
    let arc = Axis(changed.ndim() - 2);
    for (degree, mut rows) in changed.axis_iter_mut(arc).enumerate() {
        rows.mapv_inplace(|x| with(x, coarseness(degree)));
    }
    changed
}

/// What [`graded`] did to `values` of a core of `shape`, whose last axes are arc length and channel.
fn ungrade<T: Real>(values: &mut [T], shape: &[usize]) {
    let [degrees, channels] = [shape[shape.len() - 3], shape[shape.len() - 2]];
    let factors: Vec<T> = (0..degrees).map(|k| T::from_f64(coarseness(k))).collect();
    let rows = values.chunks_exact_mut(channels);
    for (row, factor) in rows.zip(factors.iter().cycle()) {
        row.iter_mut().for_each(|x| *x = *x * *factor);
    }
}

/// `values` over the axes `open` (the last two in their place), put in ascending order of axes.
fn in_table_order<T: Copy>(values: Vec<T>, open: &[usize], shape: &[usize]) -> Vec<T> {
    if open.is_sorted() {
        return values;
    }
    let rays = &open[..open.len() - 2];
    let row: usize = open[rays.len()..].iter().map(|a| shape[*a]).product();
    let mut ascending = rays.to_vec();
    ascending.sort_unstable();
    let stride = |axis: &usize| -> usize {
        let after = rays.iter().skip_while(|a| *a != axis).skip(1);
        after.map(|a| shape[*a]).product()
    };
    let mut firsts = vec![0];
    for axis in &ascending {
        let stride = stride(axis);
        let along = |first: &usize| (0..shape[*axis]).map(move |i| first + i * stride).collect();
        firsts = firsts
            .iter()
            .flat_map(|f| -> Vec<usize> { along(f) })
            .collect();
    }
    let rows = firsts.iter().flat_map(|f| &values[f * row..(f + 1) * row]);
    rows.copied().collect()
}

/// Chebyshev values at `parameters` along the first axes of `shape`.
pub(super) fn values_at<T: Real>(shape: &[usize], parameters: &[f64]) -> Vec<Vec<T>> {
    let along = |(x, n): (&f64, &usize)| {
        let mut values = vec![0.0; *n];
        chebyshev::values(*x, &mut values);
        values.into_iter().map(T::from_f64).collect()
    };
    parameters.iter().zip(shape).map(along).collect()
}
