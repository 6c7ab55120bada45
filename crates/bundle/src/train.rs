//! Tensor trains before rounding, and how they are rounded: real coefficients → integers that are worth their bits.
//!
//! In: real cores, scaled so that one step serves all. Out: a [`Tensor`] of integers, in storage order. Two things decide how
//! coarsely numbers are rounded:
//!
//! - *Rate–distortion optimised quantisation.* The nearest integer is not always the best: between two, the
//!   smaller is taken where the larger would cost more bits than its error is worth. The number of bits
//!   depends on the integers before, so it is counted for each class of context in a first rounding, and
//!   turned into dead zones. Source: G. J. Sullivan, *Efficient scalar quantization of exponential and
//!   Laplacian random variables*, IEEE Trans. Inf. Theory 42 (1996), with the rates that were counted.
//! - *Weighting.* Coefficients of high degree along the arc length are divided by a weight before they are
//!   rounded, and multiplied by it when they are read.

use crate::{
    context::{CLASSES, Context, MagnitudeModel},
    householder::{Orthogonality, reduced},
    packed_matrix::Packing,
    polynomial::{Polynomial, Variables},
    tensor::{Layout, Tensor},
    train_core::{Core, Scale, StepSize, axis_along},
};
use geofan_core::{Stop, parallel::*};
use geofan_expr::real::Real;
use ndarray::{Array2, ArrayD, Axis};
use std::sync::OnceLock;

/// A tensor train before rounding.
#[derive(Debug, Clone)]
pub struct Train {
    /// The order of the axes.
    pub layout: Layout,
    /// The variables of cameras and directions.
    pub variables: Variables,
    /// Cores (left rank, axes…, right rank), each the centre of a train that is orthogonal to both sides:
    /// the columns of all but the last multiplied by the singular values of their bond.
    pub cores: Vec<ArrayD<f64>>,
    /// Singular values of each bond.
    pub singular: Vec<Vec<f64>>,
}

impl Train {
    /// Makes one core of all coefficients.
    pub fn plain(polynomial: &Polynomial) -> Self {
        let core = weighted(&polynomial.coefficients).insert_axis(Axis(0));
        let last = Axis(core.ndim());
        Self {
            layout: Layout::Plain,
            variables: polynomial.variables,
            cores: vec![core.insert_axis(last)],
            singular: Vec::new(),
        }
    }

    /// Rounds to multiples of `step` that are worth their bits: the fewest bytes for errors that hold for most
    /// values. Zeros at the ends of axes and bonds are left out. `None` if a coefficient is too large for the
    /// step.
    pub fn rounded(&self, step: StepSize) -> Option<Tensor> {
        self.rounded_while(step, &Stop::default())
    }

    /// Rounds like [`Train::rounded`], but gives up, and returns `None`, as soon as `stop` says so.
    pub fn rounded_while(&self, step: StepSize, stop: &Stop) -> Option<Tensor> {
        self.rounded_by(step, rounded, WORTH_KEEPING, stop)
    }

    /// Rounds to the nearest multiples: the fewest bytes for errors that hold for all values.
    pub fn nearest(&self, step: StepSize) -> Option<Tensor> {
        self.rounded_by(step, nearest, 0.5, &Stop::default())
    }

    /// Rounds by `round`; vectors and degrees without a number of `least` steps are left out.
    fn rounded_by(&self, step: StepSize, round: Round, least: f64, stop: &Stop) -> Option<Tensor> {
        let numbers = self.cores.iter().map(ArrayD::len).sum();
        if !stop.goes_on(numbers) {
            return None;
        }
        let unit = step.value();
        let fits = |core: &ArrayD<f64>| core.iter().all(|x| x.abs() < LARGEST * unit);
        if !self.cores.iter().all(fits) {
            return None;
        }
        // Cores without what does not count, and the vectors of each that are stored.
        let counts = |x: &f64| x.abs() >= least * unit;
        let bonds = self.bonds(counts);
        let mut last_kind = None;
        let cores = self.cores.iter().zip(bonds.windows(2)).enumerate();
        let cores = cores.map(|(k, (core, bonds))| {
            let core = between(core, &bonds[0], &bonds[1]);
            let core = shortened(core, k + 1 == self.cores.len(), counts) / unit;
            let before = last_kind;
            let own = Orthogonality::behind(before, core.shape());
            last_kind = Some(own);
            (core, (before, own), (&bonds[0], &bonds[1]))
        });
        // Their integers, all cores at once.
        let axes: usize = self.cores.iter().map(|core| core.ndim() - 2).sum();
        let axes = self.layout.cores(axes - 2);
        let cores: Vec<_> = cores.zip(axes).collect();
        let cores = cores.into_par_iter().map(|((core, kinds, bonds), axes)| {
            let along = axis_along(&axes, self.variables.cameras);
            rounded_core((core, along), kinds, bonds, (round, stop))
        });
        let cores: Option<Vec<Core>> = cores.collect();
        Some(Tensor {
            layout: self.layout.clone(),
            variables: self.variables,
            step,
            cores: cores?,
            rows: OnceLock::new(),
        })
    }

    /// Lists the bonds before the first core, between each two and behind the last, with the indices at
    /// which a number `counts`.
    fn bonds(&self, counts: impl Fn(&f64) -> bool) -> Vec<Bond> {
        let indices = stored_ranks(&self.cores, counts).into_iter();
        let between = indices.zip(&self.singular);
        let between = between.map(|(indices, all)| Bond::new(indices, all));
        let end = || std::iter::once(Bond::none());
        end().chain(between).chain(end()).collect()
    }
}

/// Makes integers of the numbers of an array of this shape, vectors of this length; `None` when it is stopped.
type Round = fn(shape: &[usize], length: usize, values: &[f64], stop: &Stop) -> Option<Vec<i32>>;

/// The fewest steps that are worth their bits in a vector or a degree that has nothing larger.
const WORTH_KEEPING: f64 = 1.2;

/// The indices between two cores, as far as they are stored.
struct Bond {
    /// Those that are stored.
    indices: Vec<usize>,
    scales: Vec<Scale>,
    /// The scales divided by the singular values.
    off: Vec<f64>,
}

impl Bond {
    /// Returns the bond before the first core and behind the last.
    fn none() -> Self {
        Self {
            indices: vec![0],
            scales: Vec::new(),
            off: vec![1.0],
        }
    }

    /// Takes these `indices` of a bond with all its singular values.
    fn new(indices: Vec<usize>, singular: &[f64]) -> Self {
        let singular: Vec<f64> = indices.iter().map(|j| singular[*j]).collect();
        let scales: Vec<Scale> = singular.iter().map(|x| Scale::near(*x)).collect();
        let off = scales
            .iter()
            .zip(&singular)
            .map(|(scale, x)| match *x > 0.0 {
                true => scale.value() / x,
                // Of a train that is zero.
                false => 1.0,
            });
        Self {
            indices,
            off: off.collect(),
            scales,
        }
    }
}

/// Rounds a core between these bonds, from the orthogonality of the core before and its own. The difference of
/// scales from singular values is made good where it leaves the vectors that are stored orthogonal. `None` when it is
/// stopped.
fn rounded_core(
    (mut core, along): (ArrayD<f64>, usize),
    (kind_before, kind): (Option<Orthogonality>, Orthogonality),
    (before, behind): (&Bond, &Bond),
    (round, stop): (Round, &Stop),
) -> Option<Core> {
    let shape = core.shape().to_vec();
    // Make the difference good.
    if kind_before == Some(Orthogonality::Rows) {
        multiply(&mut core, Axis(0), &before.off);
    }
    if kind == Orthogonality::Columns {
        multiply(&mut core, Axis(shape.len() - 1), &behind.off);
    }
    // Round.
    let vectors = kind.vectors(&shape, core.iter().copied().collect());
    let integers = round(&kind.shape(&shape), kind.length(&shape), &vectors, stop)?;
    let scales = behind.scales.clone();
    Some(Core::new(
        (shape, along),
        kind,
        integers,
        scales,
        Packing::Close,
    ))
}

/// Multiplies the parts of `core` at each index of `axis`.
fn multiply(core: &mut ArrayD<f64>, axis: Axis, factors: &[f64]) {
    for (mut part, factor) in core.axis_iter_mut(axis).zip(factors) {
        part *= *factor;
    }
}

/// Selects the entries of `core` at the indices of two bonds.
fn between(core: &ArrayD<f64>, before: &Bond, behind: &Bond) -> ArrayD<f64> {
    let right = Axis(core.ndim() - 1);
    core.select(Axis(0), &before.indices)
        .select(right, &behind.indices)
}

/// Largest rounded coefficient: sums of a few in 32 bits stay exact.
const LARGEST: f64 = (1 << 28) as f64;

/// Lists for each bond the indices in whose column and row a number `counts`; at least one.
fn stored_ranks(cores: &[ArrayD<f64>], counts: impl Fn(&f64) -> bool) -> Vec<Vec<usize>> {
    let indices = cores.windows(2).map(|pair| {
        let (columns, rows) = (
            nonzero_columns(&pair[0], &counts),
            nonzero_rows(&pair[1], &counts),
        );
        let both = |j: &usize| columns[*j] && rows[*j];
        let both: Vec<usize> = (0..rows.len()).filter(both).collect();
        if both.is_empty() { vec![0] } else { both }
    });
    indices.collect()
}

/// Tells for each index of the first axis whether it has a number that counts.
fn nonzero_rows(core: &ArrayD<f64>, counts: impl Fn(&f64) -> bool) -> Vec<bool> {
    let rows = core.outer_iter();
    rows.map(|row| row.iter().any(&counts)).collect()
}

/// Tells so for each index of the last axis.
fn nonzero_columns(core: &ArrayD<f64>, counts: impl Fn(&f64) -> bool) -> Vec<bool> {
    let mut nonzero = vec![false; core.len_of(Axis(core.ndim() - 1))];
    for row in core.rows() {
        nonzero
            .iter_mut()
            .zip(row)
            .for_each(|(nonzero, x)| *nonzero |= counts(x));
    }
    nonzero
}

/// Cuts off the degrees beyond the last that counts; ranks and the channels of the last core stay.
fn shortened(mut core: ArrayD<f64>, last: bool, counts: impl Fn(&f64) -> bool) -> ArrayD<f64> {
    let ends = core.ndim() - if last { 2 } else { 1 };
    let shape = core.shape().to_vec();
    let mut lengths = shape.clone();
    lengths[1..ends].fill(1);
    // Numbers behind the axes that may be shortened, block by block.
    let (values, block) = (core.as_standard_layout(), shape[ends..].iter().product());
    let blocks = values.as_slice().expect("in standard layout");
    for (number, block) in blocks.chunks_exact(usize::max(block, 1)).enumerate() {
        if !block.iter().any(&counts) {
            continue;
        }
        let mut rest = number;
        for axis in (1..ends).rev() {
            lengths[axis] = lengths[axis].max(rest % shape[axis] + 1);
            rest /= shape[axis];
        }
    }
    drop(values);
    core.slice_each_axis_inplace(|axis| (..lengths[axis.axis.index()]).into());
    core
}

/// Squared error, in squared steps, that a bit is worth. Fine rounding has the slope `ln 2 / 6 =
/// 0.12`, and where most integers are zero it is larger. Three bumps on a rail and on a quarter of the
/// floor take 0.99, 0.97, 0.96 and 0.95 times as much with 0.08, 0.12, 0.16 and 0.2 as the nearest
/// integers that `FIRST` gives, and no less with 0.25 to 0.4.
const WORTH: f64 = 0.2;

/// Share of a step by which numbers are moved towards zero before they are rounded first.
const FIRST: f64 = 0.1;

/// Magnitudes that are counted one by one: 0, 1, 2, and all larger ones.
const COUNTED: usize = 4;

/// The most bits that one more in magnitude is believed to cost, from 0, 1 and 2 on.
const MOST_BITS: [f64; COUNTED - 1] = [12.0, 6.0, 1.5];

/// Shares of a step by which numbers between the magnitudes 0 and 1, 1 and 2, and larger ones are moved
/// towards zero.
type DeadZone = [f64; COUNTED - 1];

/// Makes the integers worth their bits of orthogonal vectors of this `length`, in units of the step, one
/// after the other as a core of `shape`, as [`restored`](crate::householder::restored) takes them; `None` when it is
/// stopped.
pub(crate) fn rounded(
    shape: &[usize],
    length: usize,
    vectors: &[f64],
    stop: &Stop,
) -> Option<Vec<i32>> {
    // First the dead zones, then each number outside of its own.
    let zones = dead_zones(shape, vectors);
    let (mut context, mut magnitudes) = (Context::new(shape), MagnitudeModel::default());
    reduced(vectors, length, stop, |vector, pivots, integers| {
        for (place, x) in vector.iter().enumerate() {
            context.advance(integers);
            integers.push(match pivots.contains(place) {
                true => 0,
                false => {
                    context.look(integers);
                    let zone = &zones[magnitudes.class(&context)];
                    let magnitude = rounded_magnitude(x.abs(), zone);
                    magnitudes.learn(&context, magnitude as u32);
                    with_sign(magnitude, *x)
                }
            });
        }
    })
}

/// Makes the nearest integers of such vectors.
pub(crate) fn nearest(
    _: &[usize],
    length: usize,
    vectors: &[f64],
    stop: &Stop,
) -> Option<Vec<i32>> {
    reduced(vectors, length, stop, |vector, pivots, integers| {
        let nearest = |(place, x): (usize, &f64)| match pivots.contains(place) {
            true => 0,
            false => x.round() as i32,
        };
        integers.extend(vector.iter().enumerate().map(nearest));
    })
}

/// Computes the dead zone of each class from the magnitudes counted in a first rounding of numbers that
/// are not reduced.
fn dead_zones(shape: &[usize], values: &[f64]) -> [DeadZone; CLASSES] {
    let mut counts = [[1.0; COUNTED]; CLASSES];
    let (mut context, mut magnitudes) = (Context::new(shape), MagnitudeModel::default());
    let mut integers = Vec::with_capacity(values.len());
    for x in values {
        let magnitude = nearest_magnitude(x.abs() - FIRST);
        context.advance(&integers);
        context.look(&integers);
        counts[magnitudes.class(&context)][(magnitude as usize).min(COUNTED - 1)] += 1.0;
        magnitudes.learn(&context, magnitude as u32);
        integers.push(with_sign(magnitude, *x));
    }
    counts.map(|counts| dead_zone(&counts))
}

fn with_sign(magnitude: i32, x: f64) -> i32 {
    if x < 0.0 { -magnitude } else { magnitude }
}

/// Computes half of what the bits of one more in magnitude are worth, of a class in which magnitudes were
/// counted.
fn dead_zone(counts: &[f64; COUNTED]) -> DeadZone {
    std::array::from_fn(|magnitude| {
        // The sign comes with the first.
        let sign = if magnitude == 0 { 1.0 } else { 0.0 };
        let bits = (counts[magnitude] / counts[magnitude + 1]).log2() + sign;
        0.5 * WORTH * bits.clamp(0.0, MOST_BITS[magnitude])
    })
}

/// Rounds a number of size `x` outside of a dead zone.
fn rounded_magnitude(x: f64, zone: &DeadZone) -> i32 {
    if x < 0.5 + zone[0] {
        return 0;
    }
    if x < 1.5 + zone[1] {
        return 1;
    }
    nearest_magnitude(x - zone[2]).max(2)
}

/// Finds the integer nearest to `x`, not below zero.
fn nearest_magnitude(x: f64) -> i32 {
    (x + 0.5) as i32
}

/// Returns the weight of coefficients of this degree along the arc length: `(1 + k)^(5/8)`. An error of
/// degree `k` in the slope moves points by 1/k of it, but tangents by all of it. With powers of 0.3, 0.4,
/// 0.5, 0.6, 0.7 and 0.8 three bumps on a rail take 116, 112, 108, 106, 104 and 108 kB, on a quarter of the
/// floor 627, 590, 577, 565, 558 and 602; with 0.9 tangents exceed the promise.
fn weight(degree: usize) -> f64 {
    let root = ((1 + degree) as f64).sqrt();
    // Roots are the same on every machine.
    root * root.sqrt().sqrt()
}

/// Divides coefficients (…, arc length, channel) by the weights of their degrees.
pub fn weighted(coefficients: &ArrayD<f64>) -> ArrayD<f64> {
    by_degree(coefficients, |degree| 1.0 / weight(degree))
}

/// Multiplies coefficients by the weights of their degrees: the inverse of [`weighted`].
pub fn unweighted(coefficients: &ArrayD<f64>) -> ArrayD<f64> {
    by_degree(coefficients, weight)
}

/// Multiplies each coefficient by the factor of its degree along the arc length.
fn by_degree(coefficients: &ArrayD<f64>, factor: impl Fn(usize) -> f64) -> ArrayD<f64> {
    let [degrees, channels] = [2, 1].map(|i| coefficients.shape()[coefficients.ndim() - i]);
    coefficients * &Array2::from_shape_fn((degrees, channels), |(k, _)| factor(k))
}

/// Multiplies `values` of a core of `shape`, whose last axes are arc length and channel, by the weights.
pub(crate) fn unweight<T: Real>(values: &mut [T], shape: &[usize]) {
    let [degrees, channels] = [shape[shape.len() - 3], shape[shape.len() - 2]];
    let weights: Vec<T> = (0..degrees).map(|k| T::from_f64(weight(k))).collect();
    let rows = values.chunks_exact_mut(channels);
    for (row, weight) in rows.zip(weights.iter().cycle()) {
        row.iter_mut().for_each(|x| *x *= *weight);
    }
}

/// Rows of arc lengths and channels that one thread writes at once.
const ROWS: usize = 64;

/// Makes [`weighted`] coefficients in storage order, with the axes but the last two in this `order`: all at
/// once, because large polynomials are written as fast as memory takes them.
pub fn weighted_in_order(coefficients: &ArrayD<f64>, order: &[usize]) -> Vec<f64> {
    let coefficients = coefficients.as_standard_layout();
    let shape = coefficients.shape();
    let channels = shape[order.len() + 1];
    let row: usize = shape[order.len()..].iter().product();
    let factors: Vec<f64> = (0..row).map(|i| 1.0 / weight(i / channels)).collect();
    // Lengths and strides of the axes before, the fastest first.
    let stride = |axis: &usize| -> usize { shape[axis + 1..].iter().product() };
    let axes = order.iter().rev().map(|axis| (shape[*axis], stride(axis)));
    let axes: Vec<(usize, usize)> = axes.collect();
    // Row by row, each from its place among the coefficients.
    let values = coefficients.as_slice().unwrap_or_default();
    let mut weighted = vec![0.0; values.len()];
    let blocks = weighted.par_chunks_mut(ROWS * row).enumerate();
    blocks.for_each(|(block, rows)| {
        for (number, to) in (ROWS * block..).zip(rows.chunks_exact_mut(row)) {
            let (mut rest, mut first) = (number, 0);
            for (length, stride) in &axes {
                first += rest % length * stride;
                rest /= length;
            }
            let from = values[first..first + row].iter().zip(&factors);
            to.iter_mut().zip(from).for_each(|(to, (x, f))| *to = x * f);
        }
    });
    weighted
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::random::Stream;
    use ndarray::IxDyn;

    /// Rounds one vector of all values.
    fn rounded_all(shape: &[usize], values: &[f64]) -> Vec<i32> {
        rounded(shape, values.len(), values, &Stop::default()).unwrap()
    }

    #[test]
    fn numbers_are_rounded_to_one_of_their_neighbours_or_towards_zero() {
        let mut stream = Stream::new(&[3]);
        let shape = [20, 30, 40];
        let size = |i: usize| 300.0 * (-0.004 * (i % 1200) as f64).exp();
        let values: Vec<f64> = (0..shape.iter().product())
            .map(|i| size(i) * stream.between(-1.0, 1.0))
            .collect();
        let integers = rounded_all(&shape, &values);
        let mut moved = 0;
        for (x, i) in values.iter().zip(&integers) {
            let (x, i) = (*x, f64::from(*i));
            assert!(
                (x - i).abs() <= 0.5
                    || (x.abs() > i.abs() && (x - i).abs() < 1.0 + MOST_BITS[0] * WORTH)
            );
            moved += usize::from((x - i).abs() > 0.5);
        }
        assert!(moved > 100 && moved < values.len() / 8, "{moved}");
    }

    /// A lone number that is hardly more than half a step is not worth its bits; among its like it is.
    #[test]
    fn expected_numbers_cost_little() {
        let alone = |i: usize| if i % 97 == 50 { 0.7 } else { 0.01 };
        let lone = rounded_all(&[4000], &(0..4000).map(alone).collect::<Vec<_>>());
        assert!(lone.iter().all(|i| *i == 0));
        let among = |i: usize| if i.is_multiple_of(3) { 0.7 } else { 2.3 };
        let common = rounded_all(&[4000], &(0..4000).map(among).collect::<Vec<_>>());
        assert!(common.iter().filter(|i| **i == 1).count() > 1000);
    }

    #[test]
    fn axes_change_places_before_or_after_weighting() {
        let shape = [3, 4, 2, 5, 3];
        let value = |i: IxDyn| (0..5).fold(0.0, |sum, a| 10.0 * sum + i[a] as f64);
        let coefficients = ArrayD::from_shape_fn(IxDyn(&shape), value);
        for order in [[0, 1, 2], [2, 0, 1], [1, 2, 0]] {
            let all = [&order[..], &[3, 4]].concat();
            let permuted = weighted(&coefficients).permuted_axes(IxDyn(&all));
            let found = weighted_in_order(&coefficients, &order);
            assert!(permuted.iter().eq(&found), "{order:?}");
        }
        let back = unweighted(&weighted(&coefficients));
        assert!(
            back.iter()
                .zip(&coefficients)
                .all(|(a, b)| (a - b).abs() <= 1e-12 * b.abs())
        );
    }
}
