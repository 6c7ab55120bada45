//! The numbers of a core in as few bytes as they need.
//!
//! In: rows of numbers in units of a step. Out: sums and products of them. To fix a camera all numbers
//! of its patches are read from memory, and that takes longer than to add them up. Most are small: on the
//! box of three bumps nine of ten fit bytes with three bits behind the point. What is large stands in
//! the first rows and columns, because ranks are sorted by their singular values and degrees by
//! themselves: so each row begins with as many long numbers as it needs, goes on with shorter ones and ends
//! with bytes. Zeros behind the last number are left out: in the largest cores of that box they are a third to
//! a half of all.

use super::matrix::{product_of, scale};
use crate::{
    expr::{real::Real, vectorised},
    prefetch::prefetch,
};

/// Numbers side by side that are kept alike: one of the widest vectors.
pub(super) const BESIDE: usize = 16;

/// So many of them.
type Beside<N> = [N; BESIDE];

/// Rows of numbers.
#[derive(Debug, Clone)]
pub(super) struct Packed {
    /// How many a row has, with the zeros at its end that are not kept.
    width: usize,
    /// What an integer stands for.
    unit: f64,
    /// For each row, and behind the last, how many long, short and small ones are before it.
    starts: Vec<[u32; 3]>,
    longs: Vec<Beside<i32>>,
    shorts: Vec<Beside<i16>>,
    bytes: Vec<Beside<i8>>,
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
}

/// How many rows before it is needed one is asked for: about as many as pass before it arrives. With four or
/// sixteen a camera of the box of three bumps took 1.05 times as long.
const AHEAD: usize = 8;

/// The largest integer; a bit is spared for sums.
const LARGEST: f64 = (1 << 30) as f64;

impl Packed {
    /// Of rows of `width` numbers.
    pub fn new(values: &[f64], width: usize, packing: Packing) -> Self {
        let largest = values.iter().fold(1.0, |most: f64, x| most.max(x.abs()));
        let room = (LARGEST / largest).log2().floor() as i32;
        let per_step = f64::from(1 << room.clamp(0, packing.fraction()));
        let mut packed = Self {
            width,
            unit: 1.0 / per_step,
            starts: vec![[0; 3]],
            longs: Vec::new(),
            shorts: Vec::new(),
            bytes: Vec::new(),
        };
        for row in values.chunks_exact(width) {
            let integers = row.chunks(BESIDE).map(|numbers| {
                let mut integers = [0; BESIDE];
                let pairs = integers.iter_mut().zip(numbers);
                pairs.for_each(|(to, x)| *to = (x * per_step).round() as i32);
                integers
            });
            packed.push(&integers.collect::<Vec<_>>(), packing);
        }
        packed
    }

    /// Adds a row.
    fn push(&mut self, row: &[Beside<i32>], packing: Packing) {
        // Behind the last that is too large.
        let end = |most: i32| {
            let fits = |x: &Beside<i32>| x.iter().all(|x| x.abs() <= most);
            row.iter()
                .rposition(|x| !fits(x))
                .map_or(0, |last| last + 1)
        };
        let row = &row[..end(0)];
        let (longs, shorts) = match packing {
            Packing::Close => (row.len(), row.len()),
            Packing::Small => (end(i16::MAX.into()), end(i8::MAX.into())),
        };
        self.longs.extend(&row[..longs]);
        let short = row[longs..shorts].iter().map(|x| x.map(|x| x as i16));
        self.shorts.extend(short);
        self.bytes
            .extend(row[shorts..].iter().map(|x| x.map(|x| x as i8)));
        let lengths = [self.longs.len(), self.shorts.len(), self.bytes.len()];
        self.starts.push(lengths.map(|n| n as u32));
    }

    fn rows(&self) -> usize {
        self.starts.len() - 1
    }

    /// How many times [`BESIDE`] numbers are kept of a row.
    fn kept(&self, row: usize) -> usize {
        let [from, to] = [self.starts[row], self.starts[row + 1]];
        (0..3).map(|size| (to[size] - from[size]) as usize).sum()
    }

    /// For each [`BESIDE`] columns of a matrix, of which row `k` is the row `numbers(k)` here, behind which of
    /// its `inner` rows there are zeros alone: later columns are no longer.
    fn depths(&self, inner: usize, numbers: impl Fn(usize) -> usize) -> Vec<usize> {
        let mut depths = Vec::with_capacity(self.width.div_ceil(BESIDE));
        for k in (0..inner).rev() {
            let kept = self.kept(numbers(k)).max(depths.len());
            depths.resize(kept, k + 1);
        }
        depths.resize(self.width.div_ceil(BESIDE), 0);
        depths
    }

    /// Gives `take` the numbers of a row, and how many times [`BESIDE`] are before them; asks for the row that
    /// will be wanted when `ahead` more have been.
    #[inline(always)]
    fn each<T: Real>(&self, row: usize, ahead: usize, mut take: impl FnMut(usize, Beside<T>)) {
        let [from, to] = [self.starts[row], self.starts[row + 1]];
        let next = self.starts[(row + ahead).min(self.rows())];
        let range = |size: usize| from[size] as usize..to[size] as usize;
        let mut place = 0;
        for (k, x) in self.longs[range(0)].iter().enumerate() {
            prefetch(&self.longs, next[0] as usize + k);
            take(place, real(x));
            place += 1;
        }
        for (k, x) in self.shorts[range(1)].iter().enumerate() {
            prefetch(&self.shorts, next[1] as usize + k);
            take(place, real(x));
            place += 1;
        }
        for (k, x) in self.bytes[range(2)].iter().enumerate() {
            prefetch(&self.bytes, next[2] as usize + k);
            take(place, real(x));
            place += 1;
        }
    }

    /// What columns that are to be multiplied by `factors` have their integers multiplied by.
    fn units<T: Real>(&self, factors: &[f64]) -> Vec<T> {
        let units = factors.iter().map(|f| T::from_f64(f * self.unit));
        units.collect()
    }

    /// All of them, row by row, each times the factor of its column.
    pub fn real<T: Real>(&self, factors: &[f64]) -> Vec<T> {
        self.summed(self.rows(), &[T::ONE], factors)
    }

    /// `Σ_i w_i x[a, i, b]` for an array (left, weights, right, column), times the factors of the columns.
    pub fn summed<T: Real>(&self, left: usize, weights: &[T], factors: &[f64]) -> Vec<T> {
        let right = self.rows() / (left * weights.len());
        let row = self.width.div_ceil(BESIDE);
        let mut all = Vec::with_capacity(left * right * self.width);
        let mut sums = vec![[T::ZERO; BESIDE]; right * row];
        vectorised(
            #[inline(always)]
            || {
                for a in 0..left {
                    sums.fill([T::ZERO; BESIDE]);
                    for (i, w) in weights.iter().enumerate() {
                        let first = (a * weights.len() + i) * right;
                        for (b, sums) in sums.chunks_exact_mut(row).enumerate() {
                            self.add(first + b, *w, sums);
                        }
                    }
                    let rows = sums.chunks_exact(row);
                    rows.for_each(|row| all.extend_from_slice(&row.as_flattened()[..self.width]));
                }
                scale(&mut all, &self.units(factors));
            },
        );
        all
    }

    /// Adds a row times `w` to `sums`.
    #[inline(always)]
    fn add<T: Real>(&self, row: usize, w: T, sums: &mut [Beside<T>]) {
        self.each(
            row,
            AHEAD,
            #[inline(always)]
            |place, numbers: Beside<T>| {
                let sums = &mut sums[place];
                for l in 0..BESIDE {
                    sums[l] += w * numbers[l];
                }
            },
        );
    }

    /// The product of a matrix of rows of `inner` and the numbers as a matrix of `inner` rows, times the factors
    /// of the columns.
    pub fn product<T: Real>(&self, a: &[T], inner: usize, factors: &[f64]) -> Vec<T> {
        if a.len() == inner {
            return self.summed(1, a, factors);
        }
        let strips = self.rows() / inner;
        let mut product = product_of(
            (a, inner),
            (strips, self.width),
            #[inline(always)]
            |strip, panels: &mut [Beside<T>]| {
                let depths = self.depths(inner, |k| k * strips + strip);
                for k in 0..inner {
                    let row = k * strips + strip;
                    self.each(
                        row,
                        // The next strip's.
                        1,
                        #[inline(always)]
                        |place, numbers| panels[place * inner + k] = numbers,
                    );
                    let missing = self.kept(row)..depths.len();
                    // Two columns may be multiplied together.
                    for place in missing.take_while(|place| k < depths[place & !1]) {
                        panels[place * inner + k] = [T::ZERO; BESIDE];
                    }
                }
                depths
            },
        );
        scale(&mut product, &self.units(factors));
        product
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

#[cfg(test)]
mod tests {
    use super::{super::matrix, *};

    /// Rows of 70 columns that fall from 5000 to below 1.
    fn rows(count: usize) -> Vec<f64> {
        let number = |i: usize| (i as f64 * 0.7).sin() * 5000.0 * (-0.13 * (i % 70) as f64).exp();
        (0..count * 70).map(number).collect()
    }

    #[test]
    fn small_numbers_take_few_bytes_and_stay_near() {
        let values = rows(30);
        let packed = Packed::new(&values, 70, Packing::Small);
        let lengths = [packed.longs.len(), packed.shorts.len(), packed.bytes.len()];
        assert!(lengths.iter().all(|n| *n > 0), "{lengths:?}");
        assert!(lengths[2] >= 30, "{lengths:?}");
        assert_eq!(lengths.iter().sum::<usize>(), 30 * 5);
        let factors = [1.0; 70];
        for (found, x) in packed.real::<f64>(&factors).iter().zip(&values) {
            assert!((found - x).abs() <= 0.0625 + 1e-12, "{found} {x}");
        }
        let close = Packed::new(&values, 70, Packing::Close);
        for (found, x) in close.real::<f64>(&factors).iter().zip(&values) {
            assert!((found - x).abs() <= 0.0005, "{found} {x}");
        }
    }

    #[test]
    fn sums_and_products_are_those_of_the_numbers() {
        let values = rows(30);
        let packed = Packed::new(&values, 70, Packing::Small);
        let factors: Vec<f64> = (0..70).map(|c| 1.0 + f64::from(c)).collect();
        let all = packed.real::<f64>(&factors);
        let close = |found: &[f64], expected: &[f64]| {
            assert_eq!(found.len(), expected.len());
            let pairs = found.iter().zip(expected);
            pairs.for_each(|(a, b)| assert!((a - b).abs() < 1e-9 * (1.0 + b.abs())));
        };
        // Axes (2, 5, 3, column), the second summed out.
        let weights = [0.3, -1.0, 0.0, 2.0, 0.7];
        let expected = matrix::summed(&all, 2, 3 * 70, &weights);
        close(&packed.summed(2, &weights, &factors), &expected);
        for rows in [1, 7] {
            let a: Vec<f64> = (0..rows * 10).map(|i| (i % 9) as f64 - 4.0).collect();
            let expected = matrix::product(&a, 10, &all);
            close(&packed.product(&a, 10, &factors), &expected);
        }
    }
}
