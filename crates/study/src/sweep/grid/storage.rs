//! The numbers of a grid in memory.
//!
//! In: single-precision numbers, the channel running fastest. Out: the same, or rounded to 16 bits
//! with one scale for each channel, and weighted sums of rows of them.

use serde::{Deserialize, Serialize};

/// How a number is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Number {
    /// Single precision.
    F32,
    /// 16-bit integers between the least and the largest of their channel.
    U16,
}

/// Numbers of a grid.
#[derive(Debug, Clone)]
pub enum Storage {
    /// In single precision.
    F32(Vec<f32>),
    /// Rounded.
    U16 {
        /// Steps above the least number of the channel.
        steps: Vec<u16>,
        /// The least number and the step of each channel.
        scales: Vec<[f32; 2]>,
    },
}

impl Storage {
    /// Stores `values` of so many `channels`.
    pub fn new(values: Vec<f32>, channels: usize, number: Number) -> Self {
        match number {
            Number::F32 => Self::F32(values),
            Number::U16 => {
                let scales: Vec<[f32; 2]> =
                    (0..channels).map(|c| scale(&values, c, channels)).collect();
                let steps = values.chunks_exact(channels).flat_map(|row| {
                    row.iter().zip(&scales).map(|(x, [least, step])| {
                        // Saturates, and a channel without width has only its least number.
                        ((x - least) / step).round() as u16
                    })
                });
                Self::U16 {
                    steps: steps.collect(),
                    scales,
                }
            }
        }
    }

    /// Bytes taken.
    pub fn bytes(&self) -> u64 {
        let bytes = match self {
            Self::F32(values) => size_of_val(values.as_slice()),
            Self::U16 { steps, scales } => {
                size_of_val(steps.as_slice()) + size_of_val(scales.as_slice())
            }
        };
        bytes as u64
    }

    /// The weighted sum of `rows`, each as long as `sum`; their weights add up to 1.
    pub fn sum(&self, rows: &[(usize, f32)], sum: &mut [f32]) {
        sum.fill(0.0);
        let n = sum.len();
        match self {
            Self::F32(values) => {
                for (row, w) in rows {
                    let row = &values[row * n..(row + 1) * n];
                    sum.iter_mut().zip(row).for_each(|(s, x)| *s += w * x);
                }
            }
            Self::U16 { steps, scales } => {
                for (row, w) in rows {
                    let row = &steps[row * n..(row + 1) * n];
                    sum.iter_mut()
                        .zip(row)
                        .for_each(|(s, x)| *s += w * f32::from(*x));
                }
                for values in sum.chunks_exact_mut(scales.len()) {
                    for (s, [least, step]) in values.iter_mut().zip(scales) {
                        *s = least + step * *s;
                    }
                }
            }
        }
    }
}

/// The least number of channel `c` and the step to the largest in 65,535 parts.
fn scale(values: &[f32], c: usize, channels: usize) -> [f32; 2] {
    let channel = values.iter().skip(c).step_by(channels);
    let (least, most) = channel.fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), x| {
        (a.min(*x), b.max(*x))
    });
    [least, (most - least) / f32::from(u16::MAX)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_to_16_bits_errs_by_at_most_half_a_step() {
        let values: Vec<f32> = (0..400)
            .map(|i| (i as f32 * 0.37).sin() * [1.0, 30.0][i % 2])
            .collect();
        let exact = Storage::new(values.clone(), 2, Number::F32);
        let rounded = Storage::new(values, 2, Number::U16);
        assert_eq!((exact.bytes(), rounded.bytes()), (1600, 816));
        let rows = [(3, 0.25), (40, 0.75)];
        let (mut a, mut b) = ([0.0; 4], [0.0; 4]);
        exact.sum(&rows, &mut a);
        rounded.sum(&rows, &mut b);
        for (c, (a, b)) in a.iter().zip(b).enumerate() {
            let step = [2.0, 60.0][c % 2] / 65535.0;
            assert!((a - b).abs() <= 0.51 * step, "{a} {b}");
        }
    }

    #[test]
    fn a_constant_channel_keeps_its_number() {
        let stored = Storage::new(vec![2.5; 6], 1, Number::U16);
        let mut sum = [0.0; 2];
        stored.sum(&[(0, 0.5), (2, 0.5)], &mut sum);
        assert_eq!(sum, [2.5; 2]);
    }
}
