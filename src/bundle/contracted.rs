//! What is left of a patch at a fixed camera: polynomials in the direction and the arc length.
//!
//! In: coefficients over (direction…, arc length, channel), each direction parameter p, q in
//! [−1, 1]. Out: for one direction, the coefficients in the arc length. With one direction
//! parameter the second axis has length 1.

use super::{chebyshev, tensor::MOST_DEGREES};
use crate::expr::vectorised;

/// A patch at one camera, in single precision: its rounding, 6e-8 of the largest coefficient, is far
/// below any promise that a table can make, and half the bytes take half the time.
#[derive(Debug, Clone)]
pub struct Contracted {
    /// Coefficients, axes (p, q, row): a row holds (arc length, channel), the last running fastest,
    /// and zeros up to a whole number of [`BLOCK`]s.
    table: Vec<f32>,
    degrees: [usize; 2],
    lengths: usize,
    channels: usize,
}

/// Numbers summed at once: one of the widest registers.
const BLOCK: usize = 16;

impl Contracted {
    /// Coefficients with axes `shape` = (direction…, arc length, channel), the last running fastest.
    pub fn new(shape: &[usize], coefficients: &[f32]) -> Self {
        let axis = |from_end: usize| shape.len().checked_sub(from_end).map_or(1, |i| shape[i]);
        let (channels, lengths) = (axis(1), axis(2));
        let row = (channels * lengths).max(1);
        let padded = row.next_multiple_of(BLOCK);
        let mut table = vec![0.0; coefficients.len() / row * padded];
        for (to, from) in table
            .chunks_exact_mut(padded)
            .zip(coefficients.chunks_exact(row))
        {
            to[..row].copy_from_slice(from);
        }
        Self {
            table,
            degrees: match shape.len() {
                4.. => [axis(4), axis(3)],
                _ => [axis(3), 1],
            },
            lengths,
            channels,
        }
    }

    /// Channels of what [`Contracted::direction`] gives.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// The coefficients in the arc length, `lengths` rows of `channels`, at direction parameters
    /// (p, q), written to the front of `row`; what is behind them there is undefined.
    pub fn direction<'r>(&self, p: f64, q: f64, row: &'r mut Row) -> &'r [f64] {
        let [np, nq] = self.degrees;
        let (mut tp, mut tq) = ([0.0; MOST_DEGREES], [0.0; MOST_DEGREES]);
        chebyshev::values(p, &mut tp[..np]);
        chebyshev::values(q, &mut tq[..nq]);
        let length = self.lengths * self.channels;
        let sum = &mut row[..length.next_multiple_of(BLOCK)];
        vectorised(
            #[inline(always)]
            || weigh(&self.table, &tp[..np], &tq[..nq], sum),
        );
        &row[..length]
    }
}

/// Room for what any patch stores for one path: every degree and the start, four channels, whole
/// [`BLOCK`]s.
pub type Row = [f64; (4 * (MOST_DEGREES + 1)).next_multiple_of(BLOCK)];

/// An empty one.
pub const EMPTY_ROW: Row = [0.0; (4 * (MOST_DEGREES + 1)).next_multiple_of(BLOCK)];

/// `sum = Σ p_i q_j line_ij` over the lines of `table`, each as long as `sum`.
#[inline(always)]
fn weigh(table: &[f32], p: &[f64], q: &[f64], sum: &mut [f64]) {
    let row = sum.len();
    let mut block = 0;
    while block < row {
        // Four sums at once hide the latency of one.
        let done = match row - block {
            left if left >= 4 * BLOCK => part::<{ 4 * BLOCK }>(table, p, q, (row, block), sum),
            left if left >= 2 * BLOCK => part::<{ 2 * BLOCK }>(table, p, q, (row, block), sum),
            _ => part::<BLOCK>(table, p, q, (row, block), sum),
        };
        block += done;
    }
}

/// The `N` sums from `block` on; `N`.
#[inline(always)]
fn part<const N: usize>(
    table: &[f32],
    p: &[f64],
    q: &[f64],
    (row, block): (usize, usize),
    sum: &mut [f64],
) -> usize {
    let mut sums = [0.0_f32; N];
    let mut start = block;
    for wp in p {
        for wq in q {
            let w = (wp * wq) as f32;
            if let Some(line) = table[start..].first_chunk::<N>() {
                for l in 0..N {
                    sums[l] += w * line[l];
                }
            }
            start += row;
        }
    }
    for (to, from) in sum[block..block + N].iter_mut().zip(sums) {
        *to = f64::from(from);
    }
    N
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_any_length_are_summed_like_one_by_one() {
        for (np, nq, lengths, channels) in [(3, 4, 17, 3), (5, 1, 2, 2), (1, 1, 32, 1)] {
            let count = np * nq * lengths * channels;
            let table: Vec<f32> = (0..count).map(|i| (i as f32 * 0.7).sin()).collect();
            let contracted = Contracted::new(&[np, nq, lengths, channels], &table);
            let (p, q) = (0.3, -0.8);
            let mut found = EMPTY_ROW;
            let found = contracted.direction(p, q, &mut found);
            let row = lengths * channels;
            for at in 0..row {
                let mut expected = 0.0;
                for i in 0..np {
                    for j in 0..nq {
                        let (a, b) = ((i as f64) * p.acos(), (j as f64) * q.acos());
                        expected += a.cos() * b.cos() * f64::from(table[(i * nq + j) * row + at]);
                    }
                }
                assert!((found[at] - expected).abs() < 1e-5);
            }
        }
    }
}
