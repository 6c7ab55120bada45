//! Functions of three arguments given by samples on a regular grid: tensor-product B-splines.
//!
//! In: samples with the places of the first and the last along each axis. Out: a [`Spline`], which takes the
//! samples' values at their places and has continuous derivatives up to its degree less one, and its
//! derivatives at any point. [`SplineEvaluator`] is how a tape evaluates it: all derivatives wanted at once.
//!
//! On cell i of an axis, at `t` in [0, 1] from its first sample, the function is `Σ_m c[i + m] w_m(t)`, where
//! the weights of degree d follow from those of degree d − 1 (C. de Boor, *A Practical Guide to Splines*
//! (2001), ch. IX, for equal steps):
//!
//! ```text
//! w_m = ((t + d − m) w'_(m−1) + (1 + m − t) w'_m) / d,      dw_m/dt = w'_(m−1) − w'_m
//! ```
//!
//! Samples become coefficients along one axis at a time (`interpolated`). Inside the grid the spline takes the
//! samples' values. That leaves d − 1 numbers free; they make the polynomials of the outermost cells one ("not a
//! knot": de Boor, ch. IV), so that the spline is as accurate at the edge as in the middle. Mirrored samples, the
//! habit of image processing, would flatten the function there.

mod evaluator;

pub use evaluator::SplineEvaluator;

use crate::real::Real;
use std::{any::Any, sync::OnceLock};

/// The degrees that a [`Spline`] may have.
pub const DEGREES: [usize; 3] = [1, 3, 5];

/// An axis of the grid of samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SampledAxis {
    /// Number of samples; with one alone, nothing depends on this argument.
    pub samples: usize,
    /// Places of the first and the last sample.
    pub limits: [f64; 2],
    /// Set if the sample after the last is the first again.
    pub periodic: bool,
}

/// Too few samples for the degree.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{found} samples along axis {axis}, a spline of degree {degree} needs {needed}")]
pub struct TooFewSamples {
    /// The axis, from 1.
    pub axis: usize,
    /// Samples along it.
    pub found: usize,
    /// Samples that it needs.
    pub needed: usize,
    /// The degree.
    pub degree: usize,
}

/// An axis as the evaluation needs it.
#[derive(Debug, Clone, Copy)]
struct Cells {
    /// Place of the first sample.
    low: f64,
    /// Cells per unit of length; 0 where there is one sample.
    scale: f64,
    count: usize,
    periodic: bool,
    /// Coefficients along the axis.
    coefficients: usize,
}

impl Cells {
    /// The cell at `x` and the place in it, from 0 to 1; outside the grid, of the nearest cell.
    #[inline(always)]
    fn locate<R: Real>(&self, x: R) -> (usize, R) {
        let count = R::from_f64(self.count as f64);
        let mut place = (x - R::from_f64(self.low)) * R::from_f64(self.scale);
        if self.periodic {
            place = place - count * (place / count).floor();
        }
        // Conversion saturates: below the grid, and for NaN, the first cell.
        let cell = (place.to_f64() as usize).min(self.count - 1);
        (cell, place - R::from_f64(cell as f64))
    }
}

/// A function of three arguments through samples on a grid.
#[derive(Debug)]
pub struct Spline {
    degree: usize,
    axes: [SampledAxis; 3],
    cells: [Cells; 3],
    /// The last axis fastest; zeros follow, so that whole vectors can be read.
    coefficients: Vec<f64>,
    single: OnceLock<Vec<f32>>,
    /// Equal for equal functions.
    identity: [u8; 32],
}

/// Zeros behind the coefficients.
const PADDING: usize = 16;

impl Spline {
    /// Puts a spline of `degree` through `samples` on the grid of `axes`, the last axis fastest. `identity` is
    /// a hash of all of this, by which tapes tell functions apart.
    ///
    /// # Errors
    /// There are too few samples along an axis.
    ///
    /// # Panics
    /// The degree is none of [`DEGREES`], an axis has no sample or no length, or the number of samples is not that of
    /// the grid.
    pub fn through(
        samples: &[f64],
        axes: [SampledAxis; 3],
        degree: usize,
        identity: [u8; 32],
    ) -> Result<Self, TooFewSamples> {
        assert!(DEGREES.contains(&degree), "a degree is one of {DEGREES:?}");
        let total: usize = axes.iter().map(|axis| axis.samples).product();
        assert!(total > 0 && samples.len() == total, "samples fill the grid");
        for (k, axis) in axes.iter().enumerate() {
            if (2..=degree).contains(&axis.samples) {
                return Err(TooFewSamples {
                    axis: k + 1,
                    found: axis.samples,
                    needed: degree + 1,
                    degree,
                });
            }
        }
        let cells = axes.map(|axis| cells(axis, degree));
        let mut coefficients = samples.to_vec();
        let mut shape = axes.map(|axis| axis.samples);
        for k in 0..3 {
            coefficients = interpolated(&coefficients, shape, k, axes[k].periodic, degree);
            shape[k] = cells[k].coefficients;
        }
        coefficients.resize(coefficients.len() + PADDING, 0.0);
        Ok(Self {
            degree,
            axes,
            cells,
            coefficients,
            single: OnceLock::new(),
            identity,
        })
    }

    /// Returns the degree of its polynomials.
    pub fn degree(&self) -> usize {
        self.degree
    }

    /// Returns the grid.
    pub fn axes(&self) -> &[SampledAxis; 3] {
        &self.axes
    }

    /// Returns the hash that tells it from other functions.
    pub fn identity(&self) -> &[u8; 32] {
        &self.identity
    }

    /// Returns whether all of it is finite: samples near the largest numbers have coefficients beyond them.
    pub fn is_finite(&self) -> bool {
        self.coefficients.iter().all(|c| c.is_finite())
    }

    /// Returns whether the derivative of these orders is zero everywhere.
    pub fn vanishes(&self, orders: [u8; 3]) -> bool {
        let along = |k: usize| {
            let most = match self.axes[k].samples {
                1 => 0,
                _ => self.degree,
            };
            usize::from(orders[k]) > most
        };
        (0..3).any(along)
    }

    /// Computes the derivative of `orders` along the axes at `at`, term by term.
    pub fn derivative<R: Real>(&self, orders: [u8; 3], at: [R; 3]) -> R {
        let mut places = [0; 3];
        let mut weights = [[R::ZERO; MOST_TAPS]; 3];
        for k in 0..3 {
            let (cell, t) = self.cells[k].locate(at[k]);
            places[k] = cell;
            weights[k] = self.weights(k, usize::from(orders[k]), t);
        }
        let coefficients = self.coefficients::<R>();
        let [_, rows, columns] = self.cells.map(|axis| axis.coefficients);
        let mut sum = R::ZERO;
        for x in 0..=self.degree {
            for y in 0..=self.degree {
                let start = ((places[0] + x) * rows + places[1] + y) * columns + places[2];
                for z in 0..=self.degree {
                    let weight = weights[0][x] * weights[1][y] * weights[2][z];
                    sum += weight * coefficients[start + z];
                }
            }
        }
        sum
    }

    /// The weights of the derivative of `order` along axis `k`, by the coordinate.
    fn weights<R: Real>(&self, k: usize, order: usize, t: R) -> [R; MOST_TAPS] {
        let mut weights = [R::ZERO; MOST_TAPS];
        if order > self.degree {
            return weights;
        }
        weights[0] = R::ONE;
        for degree in 1..=self.degree {
            let by_parts = degree <= self.degree - order;
            let old = weights;
            for m in 0..=degree {
                let before = if m > 0 { old[m - 1] } else { R::ZERO };
                weights[m] = match by_parts {
                    true => raised(degree, m, t, before, old[m]),
                    false => before - old[m],
                };
            }
        }
        let scale = R::from_f64(self.cells[k].scale);
        (0..order).fold(weights, |w, _| w.map(|w| w * scale))
    }

    /// The coefficients in this type.
    fn coefficients<R: Real>(&self) -> &[R] {
        let double: &dyn Any = &self.coefficients;
        if let Some(double) = double.downcast_ref::<Vec<R>>() {
            return double;
        }
        let single: &dyn Any = self
            .single
            .get_or_init(|| self.coefficients.iter().map(|c| *c as f32).collect());
        single
            .downcast_ref::<Vec<R>>()
            .expect("numbers are of single or double precision")
    }
}

/// Most weights along an axis.
const MOST_TAPS: usize = 6;

/// A weight of `degree` from two of the degree below.
#[inline(always)]
fn raised<R: Real>(degree: usize, m: usize, t: R, before: R, same: R) -> R {
    let [degree, m] = [degree, m].map(|n| R::from_i32(n as i32));
    ((t + degree - m) * before + (R::ONE + m - t) * same) * (R::ONE / degree)
}

/// The cells of an axis.
fn cells(axis: SampledAxis, degree: usize) -> Cells {
    let steps = (axis.samples - 1).max(1);
    let length = axis.limits[1] - axis.limits[0];
    let count = if axis.periodic { axis.samples } else { steps };
    Cells {
        low: axis.limits[0],
        scale: if axis.samples > 1 {
            steps as f64 / length
        } else {
            0.0
        },
        count,
        periodic: axis.periodic,
        coefficients: count + degree,
    }
}

/// Replaces the samples along axis `k` of an array of `shape` (the last axis fastest) by coefficients.
fn interpolated(
    samples: &[f64],
    shape: [usize; 3],
    k: usize,
    periodic: bool,
    degree: usize,
) -> Vec<f64> {
    let (count, inner) = (shape[k], shape[k + 1..].iter().product::<usize>());
    let line = Line::new(count, periodic, degree);
    let outer = samples.len() / (count * inner);
    let mut out = vec![0.0; outer * line.coefficients * inner];
    let mut values = Vec::new();
    for first in 0..outer {
        for last in 0..inner {
            let sample = |i: usize| samples[(first * count + i) * inner + last];
            values.clear();
            values.extend((0..count).map(sample));
            for (i, c) in line.solve(&values).into_iter().enumerate() {
                out[(first * line.coefficients + i) * inner + last] = c;
            }
        }
    }
    out
}

/// Samples repeated on either side of a periodic line: what the ends do dies away by 0.43 a sample.
const MARGIN: usize = 48;

/// The equations of a line of samples.
struct Line {
    samples: usize,
    periodic: bool,
    coefficients: usize,
    /// Left out for one sample alone, and for degree 1.
    equations: Option<Banded>,
}

impl Line {
    fn new(samples: usize, periodic: bool, degree: usize) -> Self {
        let cells = if periodic {
            samples
        } else {
            (samples - 1).max(1)
        };
        let trivial = samples == 1 || degree == 1;
        let long = if periodic {
            samples + 2 * MARGIN
        } else {
            samples
        };
        Self {
            samples,
            periodic,
            coefficients: cells + degree,
            equations: (!trivial).then(|| Banded::interpolation(long, degree)),
        }
    }

    /// The coefficients of one line.
    fn solve(&self, samples: &[f64]) -> Vec<f64> {
        let around =
            |i: usize, before: usize| samples[(i + self.samples * before - before) % self.samples];
        match &self.equations {
            _ if self.samples == 1 => vec![samples[0]; self.coefficients],
            None if self.periodic => (0..self.coefficients).map(|i| around(i, 0)).collect(),
            None => samples.to_vec(),
            Some(equations) if self.periodic => {
                let long: Vec<f64> = (0..self.samples + 2 * MARGIN)
                    .map(|i| around(i, MARGIN))
                    .collect();
                equations.solve(&long)[MARGIN..MARGIN + self.coefficients].to_vec()
            }
            Some(equations) => equations.solve(samples),
        }
    }
}

/// A banded matrix, eliminated.
struct Banded {
    /// Conditions before the samples, and after.
    conditions: usize,
    /// For each column, the row that was exchanged for it, and the factors of those below.
    steps: Vec<(usize, Vec<f64>)>,
    /// Rows of the upper triangle, from the diagonal on.
    upper: Vec<Vec<f64>>,
}

impl Banded {
    /// The equations of a spline of `degree` through a line of samples.
    fn interpolation(samples: usize, degree: usize) -> Self {
        let conditions = (degree - 1) / 2;
        let size = samples + 2 * conditions;
        let smooth = differences(degree + 1);
        let values = at_samples(degree);
        let row = |i: usize| match i {
            _ if i < conditions => (i, &smooth),
            _ if i >= size - conditions => (i - degree - 1, &smooth),
            _ => (i - conditions, &values),
        };
        let mut rows: Vec<(usize, Vec<f64>)> = (0..size)
            .map(row)
            .map(|(first, row)| (first, row.clone()))
            .collect();
        // Elimination with exchange of rows; each row knows its first column.
        let mut banded = Self {
            conditions,
            steps: Vec::with_capacity(size),
            upper: Vec::with_capacity(size),
        };
        for column in 0..size {
            let last = (column + degree + 2).min(size);
            let entry = |rows: &[(usize, Vec<f64>)], i: usize| match rows[i].0 == column {
                true => rows[i].1[0],
                false => 0.0,
            };
            let pivot = (column..last).fold(column, |best, i| {
                match entry(&rows, i).abs() > entry(&rows, best).abs() {
                    true => i,
                    false => best,
                }
            });
            rows.swap(column, pivot);
            let top = rows[column].1.clone();
            let mut factors = Vec::new();
            for i in column + 1..last {
                let factor = entry(&rows, i) / top[0];
                factors.push(factor);
                if rows[i].0 == column {
                    rows[i] = (column + 1, less(&rows[i].1, &top, factor));
                }
            }
            banded.steps.push((pivot, factors));
            banded.upper.push(top);
        }
        banded
    }

    fn solve(&self, samples: &[f64]) -> Vec<f64> {
        let mut x = vec![0.0; self.upper.len()];
        x[self.conditions..self.conditions + samples.len()].copy_from_slice(samples);
        for (column, (pivot, factors)) in self.steps.iter().enumerate() {
            x.swap(column, *pivot);
            for (i, factor) in factors.iter().enumerate() {
                x[column + 1 + i] -= factor * x[column];
            }
        }
        for (i, row) in self.upper.iter().enumerate().rev() {
            let known = row
                .iter()
                .enumerate()
                .skip(1)
                .filter(|(k, _)| i + k < x.len());
            let sum: f64 = known.map(|(k, entry)| entry * x[i + k]).sum();
            x[i] = (x[i] - sum) / row[0];
        }
        x
    }
}

/// `row − factor · top` without the first entry, which vanishes.
fn less(row: &[f64], top: &[f64], factor: f64) -> Vec<f64> {
    let entry = |row: &[f64], k: usize| row.get(k).copied().unwrap_or(0.0);
    let length = row.len().max(top.len());
    (1..length)
        .map(|k| entry(row, k) - factor * entry(top, k))
        .collect()
}

/// The weights of n-th differences: binomial coefficients of changing sign.
fn differences(n: usize) -> Vec<f64> {
    let mut row = vec![1.0];
    for _ in 0..n {
        let next = |k: usize| {
            let (left, here) = (k.checked_sub(1).map(|k| row[k]), row.get(k));
            here.copied().unwrap_or(0.0) - left.unwrap_or(0.0)
        };
        row = (0..=row.len()).map(next).collect();
    }
    row
}

/// The weights of the coefficients at a sample, of which the last is zero and left out.
fn at_samples(degree: usize) -> Vec<f64> {
    let mut weights = [0.0; MOST_TAPS];
    weights[0] = 1.0;
    for d in 1..=degree {
        let old = weights;
        for m in 0..=d {
            let before = if m > 0 { old[m - 1] } else { 0.0 };
            weights[m] = raised(d, m, 0.0, before, old[m]);
        }
    }
    weights[..degree].to_vec()
}

#[cfg(test)]
mod tests;
