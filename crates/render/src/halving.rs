//! Pictures at half their size.
//!
//! In: the pixels of a picture. Out: those of one half as wide and high, each the mean of what it covers. Odd sides have no pixel
//! left over: every part of a picture counts as much as any other.

use std::ops::{AddAssign, Mul};

/// Returns half of a side, rounded down, but one pixel at least.
pub(crate) fn half(side: usize) -> usize {
    (side / 2).max(1)
}

/// Returns the pixels of a picture reduced to [`half`] its height and width, row by row: means of `pixel(row, column)` over
/// what each covers, by a `measure` that grows or falls from the top down.
pub(crate) fn halved<T: Copy + Default + AddAssign + Mul<f32, Output = T>>(
    [height, width]: [usize; 2],
    measure: impl Fn(f32) -> f32,
    pixel: impl Fn(usize, usize) -> T,
) -> Vec<T> {
    let (rows, columns) = (shares(height, measure), shares(width, |x| x));
    let mut means = Vec::with_capacity(rows.len() * columns.len());
    for row in &rows {
        for column in &columns {
            let mut sum = T::default();
            for (y, high) in row {
                for (x, wide) in column {
                    sum += pixel(*y, *x) * (high * wide);
                }
            }
            means.push(sum);
        }
    }
    means
}

/// Lists for each of half as many pixels which of a side it covers, and the share of each by `measure`.
fn shares(side: usize, measure: impl Fn(f32) -> f32) -> Vec<Vec<(usize, f32)>> {
    let border = |i: usize| ((i * side) as f64 / half(side) as f64) as f32;
    let covered = |i: usize| {
        let [from, to] = [border(i), border(i + 1)];
        let whole = measure(to) - measure(from);
        let share = |k: usize| {
            let [low, high] = [from.max(k as f32), to.min(k as f32 + 1.0)];
            // Rounding may end a row behind its last pixel.
            (k.min(side - 1), (measure(high) - measure(low)) / whole)
        };
        (from as usize..to.ceil() as usize).map(share).collect()
    };
    (0..half(side)).map(covered).collect()
}
