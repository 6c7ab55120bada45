//! Tensor trains before rounding, and how they are rounded.
//!
//! In: real cores, scaled so that one step serves all. Out: a [`Tensor`].

use crate::{
    householder::Orthogonality,
    packed_matrix::Packing,
    polynomial::{Polynomial, Variables},
    rdoq::{nearest, rounded, weighted},
    tensor::{Layout, Tensor},
    train_core::{Core, Scale, StepSize, axis_along},
};
use geofan_core::{Stop, parallel::*};
use ndarray::{ArrayD, Axis};
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
