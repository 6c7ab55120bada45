//! Samples -> coefficients of the spline through them, along one axis at a time.
//!
//! Inside the grid the spline takes the samples' values. That leaves d − 1 numbers free; they make the
//! polynomials of the outermost cells one ("not a knot": C. de Boor, *A Practical Guide to Splines* (2001),
//! ch. IV), so that the spline is as accurate at the edge as in the middle. Mirrored samples, the habit of image
//! processing, would flatten the function there.

use super::{MOST_TAPS, raised};

/// Replaces the samples along axis `k` of an array of `shape` (the last axis fastest) by coefficients.
pub fn interpolated(
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
