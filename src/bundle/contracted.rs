//! What is left of a patch at a fixed camera: polynomials in the direction and the arc length.
//!
//! In: coefficients over (direction…, arc length, channel), each direction parameter p, q in
//! [−1, 1]. Out: for one direction, the coefficients in the arc length. With one direction
//! parameter the second axis has length 1.

use super::{chebyshev, patch::MOST_DEGREES};
use crate::expr::vectorised;

/// A patch at one camera.
#[derive(Debug, Clone)]
pub struct Contracted {
    /// Coefficients, axes (p, q, arc length, channel), the last running fastest.
    table: Vec<f64>,
    degrees: [usize; 2],
    lengths: usize,
    channels: usize,
}

impl Contracted {
    /// Coefficients with axes `shape` = (direction…, arc length, channel), the last running fastest.
    pub fn new(shape: &[usize], table: Vec<f64>) -> Self {
        let axis = |from_end: usize| shape.len().checked_sub(from_end).map_or(1, |i| shape[i]);
        let (channels, lengths) = (axis(1), axis(2));
        let degrees = match shape.len() {
            4.. => [axis(4), axis(3)],
            _ => [axis(3), 1],
        };
        Self {
            table,
            degrees,
            lengths,
            channels,
        }
    }

    /// (rows, channels) of what [`Contracted::direction`] appends.
    pub fn shape(&self) -> (usize, usize) {
        (self.lengths, self.channels)
    }

    /// The coefficients in the arc length, `lengths` rows of `channels`, at direction parameters
    /// (p, q), appended to `out`.
    pub fn direction(&self, p: f64, q: f64, out: &mut Vec<f64>) {
        let [np, nq] = self.degrees;
        let (mut tp, mut tq) = ([0.0; MOST_DEGREES], [0.0; MOST_DEGREES]);
        chebyshev::values(p, &mut tp[..np]);
        chebyshev::values(q, &mut tq[..nq]);
        let start = out.len();
        out.resize(start + self.lengths * self.channels, 0.0);
        let sum = &mut out[start..];
        vectorised(
            #[inline(always)]
            || weigh(&self.table, &tp[..np], &tq[..nq], sum),
        );
    }
}

/// Numbers summed at once: four of the widest registers, enough to hide the latency of a sum.
const BLOCK: usize = 32;

/// `sum += Σ p_i q_j line_ij` over the lines of `table`, each as long as `sum`.
#[inline(always)]
fn weigh(table: &[f64], p: &[f64], q: &[f64], sum: &mut [f64]) {
    let row = sum.len();
    let whole = row - row % BLOCK;
    for block in (0..whole).step_by(BLOCK) {
        let mut sums = [0.0; BLOCK];
        let mut start = block;
        for wp in p {
            for wq in q {
                let w = wp * wq;
                let line: &[f64; BLOCK] = part(table, start);
                for l in 0..BLOCK {
                    sums[l] += w * line[l];
                }
                start += row;
            }
        }
        sum[block..block + BLOCK].copy_from_slice(&sums);
    }
    let rest = &mut sum[whole..];
    let mut start = whole;
    for wp in p {
        for wq in q {
            let w = wp * wq;
            for (s, c) in rest.iter_mut().zip(&table[start..]) {
                *s += w * c;
            }
            start += row;
        }
    }
}

/// The `N` numbers from `start`.
#[inline(always)]
fn part<const N: usize>(table: &[f64], start: usize) -> &[f64; N] {
    match table[start..].first_chunk() {
        Some(part) => part,
        None => &[0.0; N],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_any_length_are_summed_like_one_by_one() {
        for (np, nq, lengths, channels) in [(3, 4, 17, 3), (5, 1, 2, 2), (1, 1, 32, 1)] {
            let count = np * nq * lengths * channels;
            let table: Vec<f64> = (0..count).map(|i| (i as f64 * 0.7).sin()).collect();
            let contracted = Contracted::new(&[np, nq, lengths, channels], table.clone());
            let (p, q) = (0.3, -0.8);
            let mut found = Vec::new();
            contracted.direction(p, q, &mut found);
            let row = lengths * channels;
            for at in 0..row {
                let mut expected = 0.0;
                for i in 0..np {
                    for j in 0..nq {
                        let (a, b) = ((i as f64) * p.acos(), (j as f64) * q.acos());
                        expected += a.cos() * b.cos() * table[(i * nq + j) * row + at];
                    }
                }
                assert!((found[at] - expected).abs() < 1e-13);
            }
        }
    }
}
