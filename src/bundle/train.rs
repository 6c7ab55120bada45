//! Tensor trains before rounding, and how they are rounded.
//!
//! In: real cores, scaled so that one step serves all. Out: a [`Tensor`].

use super::{
    grade::graded,
    layout::Layout,
    polynomial::Polynomial,
    rounding::{nearest, rounded},
    scale::{Scale, Step},
    tensor::{Core, Tensor},
    variables::Variables,
};
use ndarray::{ArrayD, Axis, Slice};

/// A tensor train before rounding: cores scaled to the right by the singular values of their bonds.
#[derive(Debug, Clone)]
pub struct Train {
    /// How axes are shared out.
    pub layout: Layout,
    /// Of cameras and directions.
    pub variables: Variables,
    /// Cores (left rank, axes…, right rank), the columns of all but the last multiplied by the
    /// values of their scales.
    pub cores: Vec<ArrayD<f64>>,
    /// Scales of each bond.
    pub scales: Vec<Vec<Scale>>,
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
            scales: Vec::new(),
        }
    }

    /// Rounded to multiples of `step` that are worth their bits: the fewest bytes for errors that hold for
    /// most values. What is zero at the ends of axes and bonds is left out. `None` if a coefficient is too
    /// large for the step.
    pub fn rounded(&self, step: Step) -> Option<Tensor> {
        self.rounded_by(step, rounded)
    }

    /// The same rounded to the nearest multiples: the fewest bytes for errors that hold for all values.
    pub fn nearest(&self, step: Step) -> Option<Tensor> {
        self.rounded_by(step, |_, values| nearest(values))
    }

    fn rounded_by(
        &self,
        step: Step,
        round: impl Fn(&[usize], &[f64]) -> Vec<i32>,
    ) -> Option<Tensor> {
        let unit = step.value();
        let mut rounded = Vec::new();
        for core in &self.cores {
            rounded.push(integers(core, unit, &round)?);
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
            variables: self.variables,
            step,
            cores,
        })
    }
}

/// Largest rounded coefficient: sums of a few in 32 bits stay exact.
const LARGEST: f64 = (1 << 30) as f64;

/// `core` in units of `unit`, made integers by `round`; `None` if a number is too large.
fn integers(
    core: &ArrayD<f64>,
    unit: f64,
    round: impl Fn(&[usize], &[f64]) -> Vec<i32>,
) -> Option<ArrayD<i32>> {
    let inverse = 1.0 / unit;
    let values: Vec<f64> = core.iter().map(|x| x * inverse).collect();
    let fits = values.iter().all(|x| x.abs() < LARGEST);
    let rounded = fits.then(|| round(core.shape(), &values))?;
    ArrayD::from_shape_vec(core.raw_dim(), rounded).ok()
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
    let kept = cores.windows(2).map(|pair| {
        let (columns, rows) = (living_columns(&pair[0]), living_rows(&pair[1]));
        let both = |j: &usize| columns[*j] && rows[*j];
        let kept: Vec<usize> = (0..rows.len()).filter(both).collect();
        if kept.is_empty() { vec![0] } else { kept }
    });
    kept.collect()
}

/// Which indices of the first axis have a number that is not zero.
fn living_rows(core: &ArrayD<i32>) -> Vec<bool> {
    let rows = core.outer_iter();
    rows.map(|row| row.iter().any(|x| *x != 0)).collect()
}

/// The same of the last axis.
fn living_columns(core: &ArrayD<i32>) -> Vec<bool> {
    let mut living = vec![false; core.len_of(Axis(core.ndim() - 1))];
    for row in core.rows() {
        living.iter_mut().zip(row).for_each(|(l, x)| *l |= *x != 0);
    }
    living
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
