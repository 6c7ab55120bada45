//! A polynomial of several variables, fitted to samples.

use super::chebyshev;
use ndarray::{ArrayD, ArrayViewD, Axis, Slice};

/// Chebyshev coefficients of one group of channels, in standard layout: axes camera…, direction…,
/// arc length, channel.
#[derive(Debug, Clone)]
pub struct Polynomial(pub ArrayD<f64>);

impl Polynomial {
    /// From samples at the tensor grid of Chebyshev nodes, with the same axes.
    pub fn fit(samples: ArrayViewD<'_, f64>) -> Self {
        let axes = samples.ndim() - 1;
        Self(chebyshev::coefficients(
            samples.as_standard_layout().into_owned(),
            axes,
        ))
    }

    /// The root of the sum of squares of the two highest coefficients along each axis: what
    /// splitting the axis would reduce most is largest.
    pub fn tails(&self) -> Vec<f64> {
        (0..self.0.ndim() - 1)
            .map(|axis| {
                let n = self.0.len_of(Axis(axis)) as isize;
                let tail = self
                    .0
                    .slice_axis(Axis(axis), Slice::from((n - 2).max(0)..n));
                tail.iter().map(|c| c * c).sum::<f64>().sqrt()
            })
            .collect()
    }

    /// Whether all coefficients are finite.
    pub fn is_finite(&self) -> bool {
        self.0.iter().all(|c| c.is_finite())
    }
}
