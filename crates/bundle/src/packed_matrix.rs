//! The numbers of a core in as few bytes as they need, in the order in which they are read.
//!
//! In: an array (before, along, after, column) in units of a step. Out: sums and products over the axis `along`.
//! To fix a camera all numbers of its patches are read, and that takes longer than to add them up. So sixteen
//! columns make a panel, whose numbers follow each other along the axis: their sums stay in registers. Most numbers
//! are small: on the box of three bumps nine of ten fit bytes with three bits behind the point. What is large stands
//! at the front of each axis, because ranks are sorted by their singular values and degrees by themselves: so each
//! panel begins with as many long numbers as it needs, goes on with shorter ones and ends with bytes. Zeros behind
//! the last are left out: in the largest cores of that box they are a third to a half of all. Panels that are as deep
//! follow each other, because a processor foresees well what it has just done as often. Row by row across the axis,
//! with a few numbers of every kind in each row, a camera of that box took 1.3 times as long.
//!
//! How the numbers of a core are cut into panels, and how many bytes they need.
//!
//! In: an array in units of a step, and along which axis it is read. Out: integers, sixteen columns for all of that
//! axis before the next sixteen, and for each such panel how many of its numbers are long, short and small.

use crate::matrix::{product_of, product_of_first, scale};
use fearless_simd::{Level, Simd, SimdBase, dispatch};
use geofan_expr::{real::Real, vectorised};
use std::ops::Range;

/// An array of numbers.
#[derive(Debug, Clone)]
pub(super) struct Packed {
    axes: Axes,
    /// What an integer stands for.
    unit: f64,
    /// Panels that are as deep.
    runs: Vec<Run>,
    /// Which panels there are, run by run; all numbers of others are zero.
    panels: Vec<u32>,
    longs: Vec<Beside<i32>>,
    shorts: Vec<Beside<i16>>,
    bytes: Vec<Beside<i8>>,
}

/// Panels that are as deep.
#[derive(Debug, Clone)]
struct Run {
    /// Which of all those that there are.
    panels: Range<usize>,
    depth: Depth,
    /// How many long, short and small numbers are before them.
    starts: [usize; 3],
}

/// The numbers of a panel that are kept.
struct Panel<'p> {
    longs: &'p [Beside<i32>],
    shorts: &'p [Beside<i16>],
    bytes: &'p [Beside<i8>],
}

impl Packed {
    /// Of `values` in storage order.
    pub fn new(values: &[f64], axes: Axes, packing: Packing) -> Self {
        let panels = Panels::new(values, axes, packing);
        let [longs, shorts, bytes] = panels.lengths();
        // Not a byte more: numbers that lie close to each other are read faster.
        let mut packed = Self {
            axes,
            unit: panels.unit,
            runs: Vec::new(),
            panels: Vec::with_capacity(panels.depths.len()),
            longs: Vec::with_capacity(longs),
            shorts: Vec::with_capacity(shorts),
            bytes: Vec::with_capacity(bytes),
        };
        for run in panels.depths.chunk_by(|a, b| a.0 == b.0) {
            let numbers = run.iter().map(|(_, panel)| *panel);
            packed.push(run[0].0, numbers, &panels.integers);
        }
        packed
    }

    /// Adds `panels` of these `integers` that are as deep.
    fn push(&mut self, depth: Depth, panels: impl Iterator<Item = u32>, integers: &[Beside<i32>]) {
        let first = self.panels.len();
        let starts = [self.longs.len(), self.shorts.len(), self.bytes.len()];
        for panel in panels {
            self.panels.push(panel);
            let numbers = &integers[panel as usize * self.axes.along..];
            let [longs, shorts, bytes] = depth.ranges().map(|range| numbers[range].iter());
            self.longs.extend(longs);
            self.shorts.extend(shorts.map(|x| x.map(|x| x as i16)));
            self.bytes.extend(bytes.map(|x| x.map(|x| x as i8)));
        }
        self.runs.push(Run {
            panels: first..self.panels.len(),
            depth,
            starts,
        });
    }

    /// Which panels a run has, and their numbers.
    #[inline(always)]
    fn panels<'p>(&'p self, run: &Run) -> impl Iterator<Item = (usize, Panel<'p>)> + use<'p> {
        let lengths = run.depth.lengths();
        let mut longs = &self.longs[run.starts[0]..];
        let mut shorts = &self.shorts[run.starts[1]..];
        let mut bytes = &self.bytes[run.starts[2]..];
        let panels = self.panels[run.panels.clone()].iter();
        panels.map(
            #[inline(always)]
            move |panel| {
                let kept = Panel {
                    longs: longs.split_off(..lengths[0]).unwrap_or_default(),
                    shorts: shorts.split_off(..lengths[1]).unwrap_or_default(),
                    bytes: bytes.split_off(..lengths[2]).unwrap_or_default(),
                };
                (*panel as usize, kept)
            },
        )
    }

    /// What columns that are to be multiplied by `factors` have their integers multiplied by.
    fn units<T: Real>(&self, factors: &[f64]) -> Vec<T> {
        let units = factors.iter().map(|f| T::from_f64(f * self.unit));
        units.collect()
    }

    /// All of them in storage order, each times the factor of its column.
    pub fn real<T: Real>(&self, factors: &[f64]) -> Vec<T> {
        let Axes {
            along,
            after,
            columns,
            ..
        } = self.axes;
        let mut all = vec![T::ZERO; self.axes.numbers()];
        let mut numbers = vec![[T::ZERO; BESIDE]; along];
        vectorised(
            #[inline(always)]
            || {
                for (panel, kept) in self.runs.iter().flat_map(|run| self.panels(run)) {
                    kept.put(&mut numbers);
                    let (row, range) = self.axes.place(panel);
                    let (before, row) = (row / after, row % after);
                    for (k, numbers) in numbers[..kept.depth()].iter().enumerate() {
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

    /// `Σ_k w_k x[a, k, b, c]`, times the factors of the columns.
    pub fn summed<T: Real>(&self, weights: &[T], factors: &[f64]) -> Vec<T> {
        self.sums(weights, factors).values()
    }

    /// The same before columns are multiplied.
    pub fn sums<T: Real>(&self, weights: &[T], factors: &[f64]) -> Sums<T> {
        let rows = dispatch!(Level::new(), simd => simd.vectorize(
            #[inline(always)]
            || self.rows(simd, weights),
        ));
        Sums {
            rows,
            units: self.units(factors),
        }
    }

    #[inline(always)]
    fn rows<S: Simd, T: Real>(&self, _: S, weights: &[T]) -> Vec<Beside<T>> {
        let mut sums = vec![[T::ZERO; BESIDE]; self.axes.rows() * self.axes.beside()];
        for run in &self.runs {
            let [longs, shorts, bytes] = run.depth.ranges().map(|range| &weights[range]);
            let panels = &self.panels[run.panels.clone()];
            add::<S, _, _>(&self.longs[run.starts[0]..], longs, panels, &mut sums);
            add::<S, _, _>(&self.shorts[run.starts[1]..], shorts, panels, &mut sums);
            add::<S, _, _>(&self.bytes[run.starts[2]..], bytes, panels, &mut sums);
        }
        sums
    }

    /// The product of a matrix of rows as long as the axis along and the numbers as a matrix of as many rows,
    /// times the factors of the columns. For arrays without an axis before.
    pub fn product<T: Real>(&self, a: &[T], factors: &[f64]) -> Vec<T> {
        let inner = self.axes.along;
        if a.len() == inner {
            return self.summed(a, factors);
        }
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
            |numbers: &mut [Beside<T>]| {
                let (panel, kept) = panels.next()?;
                kept.put(numbers);
                Some((columns(panel), kept.depth()))
            },
        );
        scale(&mut product, &self.units(factors));
        product
    }
}

/// Rows of sums with zeros up to a whole number of [`BESIDE`], before their columns are multiplied.
#[derive(Debug, Clone)]
pub(super) struct Sums<T> {
    rows: Vec<Beside<T>>,
    /// What the columns are to be multiplied by.
    units: Vec<T>,
}

impl<T: Real> Sums<T> {
    /// How many columns there are.
    pub fn columns(&self) -> usize {
        self.units.len()
    }

    /// Row by row.
    pub fn values(self) -> Vec<T> {
        let row = self.columns().div_ceil(BESIDE);
        let mut values = Vec::with_capacity(self.rows.len() / row * self.columns());
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

    /// The product of a matrix of rows of `inner` and these.
    pub fn behind(&self, a: &[T], inner: usize) -> Vec<T> {
        let rows = self.rows.as_flattened();
        let rows = (rows, rows.len() / inner);
        let mut product = product_of_first((a, inner), rows, self.columns());
        scale(&mut product, &self.units);
        product
    }
}

impl Panel<'_> {
    /// How many are kept.
    #[inline(always)]
    fn depth(&self) -> usize {
        self.longs.len() + self.shorts.len() + self.bytes.len()
    }

    /// Writes them to the front of `to`.
    #[inline(always)]
    fn put<T: Real>(&self, to: &mut [Beside<T>]) {
        let (longs, to) = to.split_at_mut(self.longs.len());
        let (shorts, to) = to.split_at_mut(self.shorts.len());
        put(self.longs, longs);
        put(self.shorts, shorts);
        put(self.bytes, to);
    }
}

/// Writes `numbers` to the front of `to`.
#[inline(always)]
fn put<T: Real, N: Copy + Into<i32>>(numbers: &[Beside<N>], to: &mut [Beside<T>]) {
    for (x, to) in numbers.iter().zip(to) {
        *to = real(x);
    }
}

/// Adds `numbers`, as many for each of some `panels` as there are `weights`, times these to the sums of the panels,
/// without rounding products first where the machine can.
#[inline(always)]
fn add<S: Simd, T: Real, N: Copy + Into<i32>>(
    numbers: &[Beside<N>],
    weights: &[T],
    panels: &[u32],
    sums: &mut [Beside<T>],
) {
    if weights.is_empty() {
        return;
    }
    // Elsewhere it would be a call of a function for each number.
    let fused = S::f32s::LEN >= 8;
    for (panel, numbers) in panels.iter().zip(numbers.chunks_exact(weights.len())) {
        let to = &mut sums[*panel as usize];
        let mut sum = *to;
        for (x, w) in numbers.iter().zip(weights) {
            let x: Beside<T> = real(x);
            for l in 0..BESIDE {
                sum[l] = match fused {
                    true => w.mul_add(x[l], sum[l]),
                    false => sum[l] + *w * x[l],
                };
            }
        }
        *to = sum;
    }
}

#[inline(always)]
fn real<T: Real, N: Copy + Into<i32>>(integers: &Beside<N>) -> Beside<T> {
    let mut numbers = [T::ZERO; BESIDE];
    for l in 0..BESIDE {
        numbers[l] = T::from_i32(integers[l].into());
    }
    numbers
}

/// Numbers side by side that are kept alike: one of the widest vectors.
pub(super) const BESIDE: usize = 16;

/// So many of them.
pub(super) type Beside<N> = [N; BESIDE];

/// The lengths of the axes of an array whose numbers are read along the second.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Axes {
    pub before: usize,
    pub along: usize,
    pub after: usize,
    pub columns: usize,
}

impl Axes {
    /// How many panels a row has.
    pub fn beside(self) -> usize {
        self.columns.div_ceil(BESIDE)
    }

    /// How many rows there are without the axis along.
    pub fn rows(self) -> usize {
        self.before * self.after
    }

    /// How many numbers there are.
    pub fn numbers(self) -> usize {
        self.rows() * self.along * self.columns
    }

    /// Of which row and columns a panel is, in storage order without the axis along.
    pub fn place(self, panel: usize) -> (usize, Range<usize>) {
        let first = panel % self.beside() * BESIDE;
        let range = first..self.columns.min(first + BESIDE);
        (panel / self.beside(), range)
    }
}

/// How closely numbers are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Packing {
    /// In four bytes, within a thousandth of a step where they are not large: for what is still compared.
    Close,
    /// In as few bytes as leave them within a sixteenth of a step. Together with the half step by which
    /// kept integers are rounded, that is 1.01 times as much.
    Small,
}

impl Packing {
    /// Bits behind the point that numbers have at most.
    fn fraction(self) -> i32 {
        match self {
            Self::Close => 10,
            Self::Small => 3,
        }
    }

    /// How many numbers of a panel are kept, and how.
    fn depth(self, panel: &[Beside<i32>]) -> Depth {
        // Behind the last that is too large.
        let end = |most: i32| {
            let fits = |x: &Beside<i32>| x.iter().all(|x| x.abs() <= most);
            let last = panel.iter().rposition(|x| !fits(x));
            last.map_or(0, |last| last + 1)
        };
        let kept = end(0);
        let [longs_end, shorts_end] = match self {
            Self::Close => [kept; 2],
            Self::Small => [i16::MAX.into(), i8::MAX.into()].map(end),
        };
        Depth {
            kept,
            shorts_end,
            longs_end,
        }
    }
}

/// How many numbers of a panel are kept, and behind which of them are none longer than bytes and than short ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Depth {
    kept: usize,
    shorts_end: usize,
    longs_end: usize,
}

impl Depth {
    /// Which numbers of a panel are long, short and small.
    #[inline(always)]
    pub fn ranges(self) -> [Range<usize>; 3] {
        let Self {
            kept,
            shorts_end,
            longs_end,
        } = self;
        [0..longs_end, longs_end..shorts_end, shorts_end..kept]
    }

    /// How many they are.
    #[inline(always)]
    pub fn lengths(self) -> [usize; 3] {
        self.ranges().map(|range| range.len())
    }
}

/// The largest integer; a bit is spared for sums.
const LARGEST: f64 = (1 << 30) as f64;

/// An array as integers, cut into panels.
pub(super) struct Panels {
    /// What an integer stands for.
    pub unit: f64,
    /// Sixteen columns for all of the axis along before the next sixteen.
    pub integers: Vec<Beside<i32>>,
    /// How the panels that are not all zeros are kept, and which they are; those kept alike behind each other.
    pub depths: Vec<(Depth, u32)>,
}

impl Panels {
    /// Of `values` in storage order.
    pub fn new(values: &[f64], axes: Axes, packing: Packing) -> Self {
        let largest = values.iter().fold(1.0, |most: f64, x| most.max(x.abs()));
        let room = (LARGEST / largest).log2().floor() as i32;
        let per_step = f64::from(1 << room.clamp(0, packing.fraction()));
        let integers = in_panels(values, axes, per_step);
        let panels = integers.chunks_exact(axes.along);
        let depths = panels.map(|panel| packing.depth(panel)).zip(0..);
        let mut depths: Vec<_> = depths.filter(|(depth, _)| depth.kept > 0).collect();
        depths.sort_unstable();
        Self {
            unit: 1.0 / per_step,
            integers,
            depths,
        }
    }

    /// How many numbers are long, short and small in all.
    pub fn lengths(&self) -> [usize; 3] {
        let lengths = self.depths.iter().map(|(depth, _)| depth.lengths());
        lengths.fold([0; 3], |all, own| {
            [0, 1, 2].map(|size| all[size] + own[size])
        })
    }
}

/// `values` as integers, each sixteen columns for all of the axis along before the next sixteen.
fn in_panels(values: &[f64], axes: Axes, per_step: f64) -> Vec<Beside<i32>> {
    let Axes {
        along,
        after,
        columns,
        ..
    } = axes;
    let mut integers = vec![[0; BESIDE]; axes.rows() * axes.beside() * along];
    for (row, numbers) in values.chunks_exact(columns).enumerate() {
        let (before, k, after) = (row / after / along, row / after % along, row % after);
        let first = (before * axes.after + after) * axes.beside();
        for (panel, numbers) in numbers.chunks(BESIDE).enumerate() {
            let to = &mut integers[(first + panel) * along + k];
            let pairs = to.iter_mut().zip(numbers);
            pairs.for_each(|(to, x)| *to = (x * per_step).round() as i32);
        }
    }
    integers
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix;

    /// Rows of 70 columns that fall from 5000 to below 1.
    fn rows(count: usize) -> Vec<f64> {
        let number = |i: usize| (i as f64 * 0.7).sin() * 5000.0 * (-0.13 * (i % 70) as f64).exp();
        (0..count * 70).map(number).collect()
    }

    const ROW: Axes = Axes {
        before: 1,
        along: 30,
        after: 1,
        columns: 70,
    };

    #[test]
    fn small_numbers_take_few_bytes_and_stay_near() {
        let values = rows(30);
        let packed = Packed::new(&values, ROW, Packing::Small);
        let lengths = [packed.longs.len(), packed.shorts.len(), packed.bytes.len()];
        assert!(lengths.iter().all(|n| *n > 0), "{lengths:?}");
        assert!(lengths[2] >= 30, "{lengths:?}");
        assert_eq!(lengths.iter().sum::<usize>(), 30 * 5);
        let factors = [1.0; 70];
        for (found, x) in packed.real::<f64>(&factors).iter().zip(&values) {
            assert!((found - x).abs() <= 0.0625 + 1e-12, "{found} {x}");
        }
        let close = Packed::new(&values, ROW, Packing::Close);
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
        let axes = |before, along| Axes {
            before,
            along,
            after: 3,
            columns: 70,
        };
        let packed = Packed::new(&values, axes(2, 5), Packing::Small);
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
        let packed = Packed::new(&values, axes(1, 10), Packing::Small);
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
