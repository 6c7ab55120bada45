//! Tensor trains before rounding, and how they are rounded.
//!
//! In: real cores, scaled so that one step serves all. Out: a [`Tensor`].

use crate::parallel::*;
use crate::{
    householder::Side,
    packed_matrix::Packing,
    polynomial::{Polynomial, Variables},
    rdoq::{graded, nearest, rounded},
    tensor::{Layout, Tensor},
    train_core::{Along, Core, Scale, Step},
};
use ndarray::{ArrayD, Axis};
use std::sync::OnceLock;

/// A tensor train before rounding.
#[derive(Debug, Clone)]
pub struct Train {
    /// How axes are shared out.
    pub layout: Layout,
    /// Of cameras and directions.
    pub variables: Variables,
    /// Cores (left rank, axes…, right rank), each the centre of a train that is orthogonal to both sides:
    /// the columns of all but the last multiplied by the singular values of their bond.
    pub cores: Vec<ArrayD<f64>>,
    /// Singular values of each bond.
    pub singular: Vec<Vec<f64>>,
}

impl Train {
    /// All coefficients as one core.
    pub fn plain(polynomial: &Polynomial) -> Self {
        let core = graded(&polynomial.coefficients).insert_axis(Axis(0));
        let last = Axis(core.ndim());
        Self {
            layout: Layout::Plain,
            variables: polynomial.variables,
            cores: vec![core.insert_axis(last)],
            singular: Vec::new(),
        }
    }

    /// Rounded to multiples of `step` that are worth their bits: the fewest bytes for errors that hold for
    /// most values. What is zero at the ends of axes and bonds is left out. `None` if a coefficient is too
    /// large for the step.
    pub fn rounded(&self, step: Step) -> Option<Tensor> {
        self.rounded_by(step, rounded, WORTH_KEEPING)
    }

    /// The same rounded to the nearest multiples: the fewest bytes for errors that hold for all values.
    pub fn nearest(&self, step: Step) -> Option<Tensor> {
        self.rounded_by(step, nearest, 0.5)
    }

    /// Vectors and degrees without a number of `least` steps are left out.
    fn rounded_by(&self, step: Step, round: Round, least: f64) -> Option<Tensor> {
        let unit = step.value();
        let fits = |core: &ArrayD<f64>| core.iter().all(|x| x.abs() < LARGEST * unit);
        if !self.cores.iter().all(fits) {
            return None;
        }
        let counts = |x: &f64| x.abs() >= least * unit;
        let bonds = self.bonds(counts);
        let mut side = None;
        let cores = self.cores.iter().zip(bonds.windows(2)).enumerate();
        let cores = cores.map(|(k, (core, bonds))| {
            let core = between(core, &bonds[0], &bonds[1]);
            let core = shortened(core, k + 1 == self.cores.len(), counts) / unit;
            let before = side;
            let own = Side::behind(before, core.shape());
            side = Some(own);
            (core, (before, own), (&bonds[0], &bonds[1]))
        });
        let axes: usize = self.cores.iter().map(|core| core.ndim() - 2).sum();
        let axes = self.layout.cores(axes - 2);
        let cores: Vec<_> = cores.zip(axes).collect();
        let cores = cores.into_par_iter().map(|((core, sides, bonds), axes)| {
            let along = Along::of(&axes, self.variables.cameras);
            rounded_core((core, along), sides, bonds, round)
        });
        Some(Tensor {
            layout: self.layout.clone(),
            variables: self.variables,
            step,
            cores: cores.collect(),
            rows: OnceLock::new(),
        })
    }

    /// Before the first core, between each two and behind the last, with the indices at which a number
    /// `counts`.
    fn bonds(&self, counts: impl Fn(&f64) -> bool) -> Vec<Bond> {
        let kept = kept_ranks(&self.cores, counts).into_iter();
        let between = kept.zip(&self.singular);
        let between = between.map(|(kept, all)| Bond::new(kept, all));
        let end = || std::iter::once(Bond::none());
        end().chain(between).chain(end()).collect()
    }
}

/// Integers of the numbers of an array of this shape, vectors of this length.
type Round = fn(shape: &[usize], length: usize, values: &[f64]) -> Vec<i32>;

/// The fewest steps that are worth their bits in a vector or a degree that has nothing larger.
const WORTH_KEEPING: f64 = 1.2;

/// What is kept of the indices between two cores.
struct Bond {
    /// Which of them.
    kept: Vec<usize>,
    scales: Vec<Scale>,
    /// How many times larger scales are than singular values.
    off: Vec<f64>,
}

impl Bond {
    /// Before the first core and behind the last.
    fn none() -> Self {
        Self {
            kept: vec![0],
            scales: Vec::new(),
            off: vec![1.0],
        }
    }

    /// Of all its singular values those `kept`.
    fn new(kept: Vec<usize>, singular: &[f64]) -> Self {
        let singular: Vec<f64> = kept.iter().map(|j| singular[*j]).collect();
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
            kept,
            off: off.collect(),
            scales,
        }
    }
}

/// `core`, between these bonds and behind a core whose vectors of one side are kept, rounded. What scales are
/// off is made good where it leaves the vectors that are kept orthogonal.
fn rounded_core(
    (mut core, along): (ArrayD<f64>, Along),
    (side_before, side): (Option<Side>, Side),
    (before, behind): (&Bond, &Bond),
    round: Round,
) -> Core {
    let shape = core.shape().to_vec();
    if side_before == Some(Side::Rows) {
        multiply(&mut core, Axis(0), &before.off);
    }
    if side == Side::Columns {
        multiply(&mut core, Axis(shape.len() - 1), &behind.off);
    }
    let vectors = side.vectors(&shape, core.iter().copied().collect());
    let kept = round(&side.shape(&shape), side.length(&shape), &vectors);
    Core::new(
        (shape, along),
        side,
        kept,
        behind.scales.clone(),
        Packing::Close,
    )
}

/// Multiplies the parts of `core` at each index of `axis`.
fn multiply(core: &mut ArrayD<f64>, axis: Axis, factors: &[f64]) {
    for (mut part, factor) in core.axis_iter_mut(axis).zip(factors) {
        part *= *factor;
    }
}

/// The entries of `core` at the indices that two bonds keep.
fn between(core: &ArrayD<f64>, before: &Bond, behind: &Bond) -> ArrayD<f64> {
    let right = Axis(core.ndim() - 1);
    core.select(Axis(0), &before.kept)
        .select(right, &behind.kept)
}

/// Largest rounded coefficient: sums of a few in 32 bits stay exact.
const LARGEST: f64 = (1 << 28) as f64;

/// For each bond the indices in whose column and row a number `counts`; at least one.
fn kept_ranks(cores: &[ArrayD<f64>], counts: impl Fn(&f64) -> bool) -> Vec<Vec<usize>> {
    let kept = cores.windows(2).map(|pair| {
        let (columns, rows) = (
            living_columns(&pair[0], &counts),
            living_rows(&pair[1], &counts),
        );
        let both = |j: &usize| columns[*j] && rows[*j];
        let kept: Vec<usize> = (0..rows.len()).filter(both).collect();
        if kept.is_empty() { vec![0] } else { kept }
    });
    kept.collect()
}

/// Which indices of the first axis have a number that counts.
fn living_rows(core: &ArrayD<f64>, counts: impl Fn(&f64) -> bool) -> Vec<bool> {
    let rows = core.outer_iter();
    rows.map(|row| row.iter().any(&counts)).collect()
}

/// The same of the last axis.
fn living_columns(core: &ArrayD<f64>, counts: impl Fn(&f64) -> bool) -> Vec<bool> {
    let mut living = vec![false; core.len_of(Axis(core.ndim() - 1))];
    for row in core.rows() {
        living
            .iter_mut()
            .zip(row)
            .for_each(|(l, x)| *l |= counts(x));
    }
    living
}

/// `core` without the degrees beyond the last that counts; ranks and the channels of the last core are kept.
fn shortened(mut core: ArrayD<f64>, last: bool, counts: impl Fn(&f64) -> bool) -> ArrayD<f64> {
    let ends = core.ndim() - if last { 2 } else { 1 };
    let length = |axis: usize| {
        let all = core.len_of(Axis(axis));
        let lives = |i: &usize| core.index_axis(Axis(axis), *i).iter().any(&counts);
        match axis == 0 || axis >= ends {
            true => all,
            false => (0..all).rev().find(lives).map_or(1, |i| i + 1),
        }
    };
    let lengths: Vec<usize> = (0..core.ndim()).map(length).collect();
    core.slice_each_axis_inplace(|axis| (..lengths[axis.axis.index()]).into());
    core
}
