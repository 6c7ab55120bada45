//! The numbers of a core in as few bytes as they need, in the order in which they are read.
//!
//! In: an array (before, along, after, column) in units of a step. Out: sums and products over the axis
//! `along`. To fix a camera all numbers of its patches are read, and that takes longer than to add them up.
//! So sixteen columns make a panel, whose rows follow each other along the axis: their sums stay in
//! registers. Most numbers are small: on the box of three bumps nine of ten fit 8 bits with three bits behind
//! the point. Large ones stand at the front of each axis, because ranks are sorted by their singular values
//! and degrees by themselves: so each panel begins with as many rows of 32 bits as it needs, goes on with
//! rows of 16 bits and ends with rows of 8. Rows of zeros behind the last are left out: in the largest cores
//! of that box they are a third to a half of all. Panels with as many rows of each kind follow each other,
//! because a processor foresees well what it has just done as often. Row by row across the axis, with a few
//! numbers of every kind in each row, a camera of that box took 1.3 times as long.

use crate::matrix::{product_of, product_of_first, scale};
use fearless_simd::{Level, Simd, SimdBase, dispatch};
use geofan_expr::{real::Real, vectorised};
use std::ops::Range;

/// Columns of a panel: the lanes of one of the widest vectors.
pub(crate) const LANES: usize = 16;

/// A row of a panel.
pub(crate) type Lane16<N> = [N; LANES];

/// The lengths of the axes of an array whose numbers are read along the second.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct PanelAxes {
    pub before: usize,
    pub along: usize,
    pub after: usize,
    pub columns: usize,
}

impl PanelAxes {
    /// Counts the panels side by side.
    fn panels_per_row(self) -> usize {
        self.columns.div_ceil(LANES)
    }

    /// Counts the rows without the axis along.
    fn rows(self) -> usize {
        self.before * self.after
    }

    /// Counts the numbers.
    fn numbers(self) -> usize {
        self.rows() * self.along * self.columns
    }

    /// Counts the numbers with those that fill its panels.
    pub(crate) fn padded(self) -> usize {
        self.rows() * self.along * self.panels_per_row() * LANES
    }

    /// Finds row and columns of a panel, in storage order without the axis along.
    fn place(self, panel: usize) -> (usize, Range<usize>) {
        let first = panel % self.panels_per_row() * LANES;
        let range = first..self.columns.min(first + LANES);
        (panel / self.panels_per_row(), range)
    }
}

/// The accuracy of packed numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Packing {
    /// In four bytes, within a thousandth of a step where they are not large: for tensors that are still
    /// compared.
    Close,
    /// In as few bytes as leave them within a sixteenth of a step. Together with the half step by which
    /// stored integers are rounded, that is 1.01 times as much.
    Small,
}

impl Packing {
    /// Returns the largest number of bits behind the point.
    fn fraction(self) -> i32 {
        match self {
            Self::Close => 10,
            Self::Small => 3,
        }
    }

    /// Decides the rows that are stored of a panel, and in how many bits.
    fn stored_rows(self, panel: &[Lane16<i32>]) -> StoredRows {
        // Behind the last that is too large.
        let end = |most: i32| {
            let fits = |x: &Lane16<i32>| x.iter().all(|x| x.unsigned_abs() <= most.unsigned_abs());
            let last = panel.iter().rposition(|x| !fits(x));
            last.map_or(0, |last| last + 1)
        };
        let all = end(0);
        let [end32, end16] = match self {
            Self::Close => [all; 2],
            Self::Small => [i16::MAX.into(), i8::MAX.into()].map(end),
        };
        StoredRows { all, end16, end32 }
    }
}

/// Number of rows stored in a panel, and the rows after which all remaining numbers fit in 8 and in 16 bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct StoredRows {
    all: usize,
    end16: usize,
    end32: usize,
}

impl StoredRows {
    /// Returns the rows of 32, 16 and 8 bits.
    #[inline(always)]
    fn ranges(self) -> [Range<usize>; 3] {
        [0..self.end32, self.end32..self.end16, self.end16..self.all]
    }

    /// Counts them.
    #[inline(always)]
    fn lengths(self) -> [usize; 3] {
        self.ranges().map(|range| range.len())
    }
}

/// The largest integer; a bit is spared for sums.
const LARGEST: f64 = (1 << 30) as f64;

/// An array of numbers, packed in panels.
#[derive(Debug, Clone)]
pub(crate) struct PackedMatrix {
    axes: PanelAxes,
    /// The number that an integer 1 stands for.
    unit: f64,
    runs: Vec<Run>,
    /// The panels that there are, run by run; all numbers of others are zero.
    panels: Vec<u32>,
    rows32: Vec<Lane16<i32>>,
    rows16: Vec<Lane16<i16>>,
    rows8: Vec<Lane16<i8>>,
}

/// Panels with as many rows of each kind.
#[derive(Debug, Clone)]
struct Run {
    /// Their range among all panels that there are.
    panels: Range<usize>,
    stored: StoredRows,
    /// Number of rows of each kind before them.
    starts: [usize; 3],
}

/// The stored rows of a panel.
struct Panel<'p> {
    rows32: &'p [Lane16<i32>],
    rows16: &'p [Lane16<i16>],
    rows8: &'p [Lane16<i8>],
}

/// Arranges `values` as integers of `1/per_step`, sixteen columns for all of the axis along before the next
/// sixteen.
fn in_panels(values: &[f64], axes: PanelAxes, per_step: f64) -> Vec<Lane16<i32>> {
    let PanelAxes {
        along,
        after,
        columns,
        ..
    } = axes;
    let mut integers = vec![[0; LANES]; axes.rows() * axes.panels_per_row() * along];
    // Row by row, each to its place in all panels across it.
    vectorised(
        #[inline(always)]
        || {
            for (row, numbers) in values.chunks_exact(columns).enumerate() {
                let (before, k, after) = (row / after / along, row / after % along, row % after);
                let first = (before * axes.after + after) * axes.panels_per_row();
                for (panel, numbers) in numbers.chunks(LANES).enumerate() {
                    let to = &mut integers[(first + panel) * along + k];
                    let pairs = to.iter_mut().zip(numbers);
                    pairs.for_each(|(to, x)| *to = (x * per_step).round() as i32);
                }
            }
        },
    );
    integers
}

impl PackedMatrix {
    /// Packs `values` in storage order.
    pub fn new(values: &[f64], axes: PanelAxes, packing: Packing) -> Self {
        // As many bits behind the point as the largest leaves room for.
        let largest = values.iter().fold(1.0, |most: f64, x| most.max(x.abs()));
        let room = (LARGEST / largest).log2().floor() as i32;
        let per_step = f64::from(1 << room.clamp(0, packing.fraction()));
        let integers = in_panels(values, axes, per_step);
        // The panels that are not all zeros, those stored alike behind each other.
        let panels = integers.chunks_exact(axes.along);
        let panels = panels.map(|panel| packing.stored_rows(panel)).zip(0..);
        let mut panels: Vec<(StoredRows, u32)> = panels.filter(|(rows, _)| rows.all > 0).collect();
        panels.sort_unstable();
        // Not a byte more: numbers that lie close to each other are read faster.
        let lengths = panels.iter().map(|(rows, _)| rows.lengths());
        let [rows32, rows16, rows8] = lengths.fold([0; 3], |all, own| {
            [0, 1, 2].map(|kind| all[kind] + own[kind])
        });
        let mut packed = Self {
            axes,
            unit: 1.0 / per_step,
            runs: Vec::new(),
            panels: Vec::with_capacity(panels.len()),
            rows32: Vec::with_capacity(rows32),
            rows16: Vec::with_capacity(rows16),
            rows8: Vec::with_capacity(rows8),
        };
        for run in panels.chunk_by(|a, b| a.0 == b.0) {
            let numbers = run.iter().map(|(_, panel)| *panel);
            packed.push(run[0].0, numbers, &integers);
        }
        packed
    }

    /// Counts the bytes of its numbers.
    pub fn bytes(&self) -> usize {
        LANES * (4 * self.rows32.len() + 2 * self.rows16.len() + self.rows8.len())
    }

    /// Adds `panels` of these `integers` that have the same stored rows.
    fn push(
        &mut self,
        stored: StoredRows,
        panels: impl Iterator<Item = u32>,
        integers: &[Lane16<i32>],
    ) {
        let first = self.panels.len();
        let starts = [self.rows32.len(), self.rows16.len(), self.rows8.len()];
        // Their rows, in as many bits as each kind has.
        for panel in panels {
            self.panels.push(panel);
            let numbers = &integers[panel as usize * self.axes.along..];
            let [rows32, rows16, rows8] = stored.ranges().map(|range| numbers[range].iter());
            self.rows32.extend(rows32);
            self.rows16.extend(rows16.map(|x| x.map(|x| x as i16)));
            self.rows8.extend(rows8.map(|x| x.map(|x| x as i8)));
        }
        self.runs.push(Run {
            panels: first..self.panels.len(),
            stored,
            starts,
        });
    }

    /// Iterates over the panels of a run, with their numbers.
    #[inline(always)]
    fn panels<'p>(&'p self, run: &Run) -> impl Iterator<Item = (usize, Panel<'p>)> + use<'p> {
        let lengths = run.stored.lengths();
        let mut rows32 = &self.rows32[run.starts[0]..];
        let mut rows16 = &self.rows16[run.starts[1]..];
        let mut rows8 = &self.rows8[run.starts[2]..];
        let panels = self.panels[run.panels.clone()].iter();
        panels.map(
            #[inline(always)]
            move |number| {
                let panel = Panel {
                    rows32: rows32.split_off(..lengths[0]).unwrap_or_default(),
                    rows16: rows16.split_off(..lengths[1]).unwrap_or_default(),
                    rows8: rows8.split_off(..lengths[2]).unwrap_or_default(),
                };
                (*number as usize, panel)
            },
        )
    }

    /// Returns the factors of the integers of columns that are to be multiplied by `factors`.
    fn units<T: Real>(&self, factors: &[f64]) -> Vec<T> {
        let units = factors.iter().map(|f| T::from_f64(f * self.unit));
        units.collect()
    }

    /// Unpacks all numbers in storage order, each times the factor of its column.
    pub fn real<T: Real>(&self, factors: &[f64]) -> Vec<T> {
        let PanelAxes {
            along,
            after,
            columns,
            ..
        } = self.axes;
        let mut all = vec![T::ZERO; self.axes.numbers()];
        let mut numbers = vec![[T::ZERO; LANES]; along];
        vectorised(
            #[inline(always)]
            || {
                for (number, panel) in self.runs.iter().flat_map(|run| self.panels(run)) {
                    panel.put(&mut numbers);
                    let (row, range) = self.axes.place(number);
                    let (before, row) = (row / after, row % after);
                    for (k, numbers) in numbers[..panel.rows()].iter().enumerate() {
                        let row = (before * along + k) * after + row;
                        let to = &mut all[row * columns..][range.clone()];
                        to.copy_from_slice(&numbers[..to.len()]);
                    }
                }
                scale(&mut all, &self.units(factors));
            },
        );
        all
    }

    /// Computes `Σ_k w_k x[a, k, b, c]`, times the factors of the columns.
    pub fn summed<T: Real>(&self, weights: &[T], factors: &[f64]) -> Vec<T> {
        self.sums(weights, factors).values()
    }

    /// Computes these sums before columns are multiplied.
    pub fn sums<T: Real>(&self, weights: &[T], factors: &[f64]) -> PaddedSums<T> {
        let rows = dispatch!(Level::new(), simd => simd.vectorize(
            #[inline(always)]
            || self.sum_panels(simd, weights),
        ));
        PaddedSums {
            rows,
            units: self.units(factors),
        }
    }

    #[inline(always)]
    fn sum_panels<S: Simd, T: Real>(&self, _: S, weights: &[T]) -> Vec<Lane16<T>> {
        let mut sums = vec![[T::ZERO; LANES]; self.axes.rows() * self.axes.panels_per_row()];
        for run in &self.runs {
            let [w32, w16, w8] = run.stored.ranges().map(|range| &weights[range]);
            let panels = &self.panels[run.panels.clone()];
            add_weighted::<S, _, _>(&self.rows32[run.starts[0]..], w32, panels, &mut sums);
            add_weighted::<S, _, _>(&self.rows16[run.starts[1]..], w16, panels, &mut sums);
            add_weighted::<S, _, _>(&self.rows8[run.starts[2]..], w8, panels, &mut sums);
        }
        sums
    }

    /// Multiplies a matrix of rows as long as the axis along and the numbers as a matrix of as many rows,
    /// times the factors of the columns. For arrays without an axis before.
    pub fn product<T: Real>(&self, a: &[T], factors: &[f64]) -> Vec<T> {
        let inner = self.axes.along;
        if a.len() == inner {
            return self.summed(a, factors);
        }
        // Panels are unpacked one by one as the product needs them.
        let mut panels = self.runs.iter().flat_map(|run| self.panels(run));
        let columns = |panel: usize| {
            let (row, range) = self.axes.place(panel);
            let first = row * self.axes.columns;
            first + range.start..first + range.end
        };
        let mut product = product_of(
            (a, inner),
            self.axes.rows() * self.axes.columns,
            #[inline(always)]
            |numbers: &mut [Lane16<T>]| {
                let (number, panel) = panels.next()?;
                panel.put(numbers);
                Some((columns(number), panel.rows()))
            },
        );
        scale(&mut product, &self.units(factors));
        product
    }
}

/// Rows of sums with zeros up to a whole number of [`LANES`], before their columns are multiplied.
#[derive(Debug, Clone)]
pub(crate) struct PaddedSums<T> {
    rows: Vec<Lane16<T>>,
    /// The factors of the columns.
    units: Vec<T>,
}

impl<T: Real> PaddedSums<T> {
    /// Multiplies columns and drops the padding, row by row.
    pub fn values(self) -> Vec<T> {
        let columns = self.units.len();
        let row = columns.div_ceil(LANES);
        let mut values = Vec::with_capacity(self.rows.len() / row * columns);
        vectorised(
            #[inline(always)]
            || {
                for row in self.rows.chunks_exact(row) {
                    let pairs = row.as_flattened().iter().zip(&self.units);
                    values.extend(pairs.map(|(x, unit)| *x * *unit));
                }
            },
        );
        values
    }

    /// Multiplies a matrix of rows of `inner` and these.
    pub fn behind(&self, a: &[T], inner: usize) -> Vec<T> {
        let rows = self.rows.as_flattened();
        let rows = (rows, rows.len() / inner);
        let mut product = product_of_first((a, inner), rows, self.units.len());
        scale(&mut product, &self.units);
        product
    }
}

impl Panel<'_> {
    /// Counts the stored rows.
    #[inline(always)]
    fn rows(&self) -> usize {
        self.rows32.len() + self.rows16.len() + self.rows8.len()
    }

    /// Writes them to the front of `to`.
    #[inline(always)]
    fn put<T: Real>(&self, to: &mut [Lane16<T>]) {
        let (first, to) = to.split_at_mut(self.rows32.len());
        let (second, third) = to.split_at_mut(self.rows16.len());
        put(self.rows32, first);
        put(self.rows16, second);
        put(self.rows8, third);
    }
}

/// Writes `rows` as real numbers to the front of `to`.
#[inline(always)]
fn put<T: Real, N: Copy + Into<i32>>(rows: &[Lane16<N>], to: &mut [Lane16<T>]) {
    for (x, to) in rows.iter().zip(to) {
        *to = real(x);
    }
}

/// Adds `rows`, as many for each of some `panels` as there are `weights`, times these to the sums of the
/// panels, without rounding products first where the machine can.
#[inline(always)]
fn add_weighted<S: Simd, T: Real, N: Copy + Into<i32>>(
    rows: &[Lane16<N>],
    weights: &[T],
    panels: &[u32],
    sums: &mut [Lane16<T>],
) {
    if weights.is_empty() {
        return;
    }
    // Elsewhere it would be a call of a function for each number.
    let fused = S::f32s::LEN >= 8;
    for (panel, rows) in panels.iter().zip(rows.chunks_exact(weights.len())) {
        let to = &mut sums[*panel as usize];
        let mut sum = *to;
        for (x, w) in rows.iter().zip(weights) {
            let x: Lane16<T> = real(x);
            for l in 0..LANES {
                sum[l] = match fused {
                    true => w.mul_add(x[l], sum[l]),
                    false => sum[l] + *w * x[l],
                };
            }
        }
        *to = sum;
    }
}

/// Converts integers.
#[inline(always)]
fn real<T: Real, N: Copy + Into<i32>>(integers: &Lane16<N>) -> Lane16<T> {
    let mut numbers = [T::ZERO; LANES];
    for l in 0..LANES {
        numbers[l] = T::from_i32(integers[l].into());
    }
    numbers
}

#[cfg(test)]
mod tests {
    use super::{super::matrix, *};

    /// Makes rows of 70 columns that fall from 5000 to below 1.
    fn rows(count: usize) -> Vec<f64> {
        let number = |i: usize| (i as f64 * 0.7).sin() * 5000.0 * (-0.13 * (i % 70) as f64).exp();
        (0..count * 70).map(number).collect()
    }

    const ROW: PanelAxes = PanelAxes {
        before: 1,
        along: 30,
        after: 1,
        columns: 70,
    };

    #[test]
    fn small_numbers_take_few_bytes_and_stay_near() {
        let values = rows(30);
        let packed = PackedMatrix::new(&values, ROW, Packing::Small);
        let lengths = [packed.rows32.len(), packed.rows16.len(), packed.rows8.len()];
        assert!(lengths.iter().all(|n| *n > 0), "{lengths:?}");
        assert!(lengths[2] >= 30, "{lengths:?}");
        assert_eq!(lengths.iter().sum::<usize>(), 30 * 5);
        let factors = [1.0; 70];
        for (found, x) in packed.real::<f64>(&factors).iter().zip(&values) {
            assert!((found - x).abs() <= 0.0625 + 1e-12, "{found} {x}");
        }
        let close = PackedMatrix::new(&values, ROW, Packing::Close);
        for (found, x) in close.real::<f64>(&factors).iter().zip(&values) {
            assert!((found - x).abs() <= 0.0005, "{found} {x}");
        }
    }

    /// The largest error where there should be a number, and the largest of all is another.
    type Bound = fn(f64, f64) -> f64;

    fn close<T: Real>(found: &[T], expected: &[f64], bound: Bound) {
        assert_eq!(found.len(), expected.len());
        let largest = expected.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
        for (found, x) in found.iter().zip(expected) {
            let error = (found.to_f64() - x).abs();
            assert!(error < bound(x.abs(), largest), "{found:?} {x}");
        }
    }

    fn test_sums_and_products<T: Real>(bound: Bound) {
        // Axes (2, 5, 3, 70), or (1, 10, 3, 70); all rows end by another number of zeros.
        let mut values = rows(30);
        for (row, numbers) in values.chunks_exact_mut(70).enumerate() {
            numbers[70 - row * 70 / 31..].fill(0.0);
        }
        let real = |values: &[f64]| values.iter().map(|x| T::from_f64(*x)).collect::<Vec<T>>();
        let axes = |before, along| PanelAxes {
            before,
            along,
            after: 3,
            columns: 70,
        };
        let packed = PackedMatrix::new(&values, axes(2, 5), Packing::Small);
        let factors: Vec<f64> = (0..70).map(|c| 1.0 + f64::from(c)).collect();
        let all = packed.real::<f64>(&factors);
        for (i, (found, x)) in all.iter().zip(&values).enumerate() {
            assert!((found / factors[i % 70] - x).abs() <= 0.0625 + 1e-12);
        }
        let weights = [0.3, -1.0, 0.0, 2.0, 0.7];
        let expected = matrix::summed(&all, 2, 3 * 70, &weights);
        close(&packed.summed(&real(&weights), &factors), &expected, bound);
        // The sums as a matrix of six rows.
        for rows in [1, 7] {
            let a: Vec<f64> = (0..rows * 6).map(|i| (i % 7) as f64 - 3.0).collect();
            let expected = matrix::product(&a, 6, &expected);
            let sums = packed.sums(&real(&weights), &factors);
            close(&sums.behind(&real(&a), 6), &expected, bound);
        }
        let packed = PackedMatrix::new(&values, axes(1, 10), Packing::Small);
        for rows in [1, 7, 13] {
            let a: Vec<f64> = (0..rows * 10).map(|i| (i % 9) as f64 - 4.0).collect();
            let expected = matrix::product(&a, 10, &all);
            close(&packed.product(&real(&a), &factors), &expected, bound);
        }
    }

    #[test]
    fn sums_and_products_are_those_of_the_numbers() {
        test_sums_and_products::<f64>(|x, _| 1e-9 * (1.0 + x));
        test_sums_and_products::<f32>(|_, largest| 1e-6 * largest);
    }
}
