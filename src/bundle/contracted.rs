//! A patch at one camera: small dense polynomials in the direction and the arc length.

use super::{chebyshev, tensor::MOST_DEGREES};
use ndarray::Array3;

/// A patch at one camera: polynomials in the direction and the arc length.
#[derive(Debug, Clone)]
pub struct Contracted {
    /// Coefficients (direction 1, direction 2, arc length × channel).
    table: Array3<f64>,
    lengths: usize,
    channels: usize,
}

impl Contracted {
    /// From coefficients (direction 1, direction 2, arc length, channel), flat.
    pub fn new(shape: [usize; 4], flat: Vec<f64>) -> Self {
        let [p, q, lengths, channels] = shape;
        let table = Array3::from_shape_vec((p, q, lengths * channels), flat);
        Self {
            table: table.expect("the axes multiply to the length"),
            lengths,
            channels,
        }
    }

    /// The coefficients in the arc length, `lengths` rows of `channels`, at direction parameters
    /// (p, q) in [−1, 1], appended to `out`.
    pub fn direction(&self, p: f64, q: f64, out: &mut Vec<f64>) {
        let (np, nq, row) = self.table.dim();
        let (mut tp, mut tq) = ([0.0; MOST_DEGREES], [0.0; MOST_DEGREES]);
        chebyshev::values(p, &mut tp[..np]);
        chebyshev::values(q, &mut tq[..nq]);
        let start = out.len();
        out.resize(start + row, 0.0);
        let sum = &mut out[start..];
        for (plane, wp) in self.table.outer_iter().zip(tp) {
            for (line, wq) in plane.outer_iter().zip(tq) {
                let w = wp * wq;
                if let Some(line) = line.as_slice() {
                    for (s, c) in sum.iter_mut().zip(line) {
                        *s += w * c;
                    }
                }
            }
        }
    }

    /// (rows, channels) of what [`Contracted::direction`] appends.
    pub fn shape(&self) -> (usize, usize) {
        (self.lengths, self.channels)
    }
}
