//! The numbers of a core in as few bytes as they need.
//!
//! In: rows of numbers in units of a step. Out: sums and products of them. To fix a camera all numbers
//! of its patches are read from memory, and that takes longer than to add them up. Most are small: on the
//! box of three bumps nearly half stand in columns that fit bytes with three bits behind the point, nearly
//! all others in columns that fit two bytes. What is large stands in the first columns, because ranks are sorted
//! by their singular values, so columns with numbers of one size are kept side by side ([`Part`]).

use super::matrix::{product_of, scaled, summed};
use crate::expr::real::Real;

/// Rows of numbers.
#[derive(Debug, Clone)]
pub(super) struct Packed {
    parts: Vec<Part>,
    count: usize,
}

/// Columns side by side.
#[derive(Debug, Clone)]
struct Part {
    /// How many.
    width: usize,
    /// How many with those of zeros that make whole vectors of them.
    padded: usize,
    /// What one of its integers stands for.
    unit: f64,
    numbers: Numbers,
}

/// Integers of one size, row by row.
#[derive(Debug, Clone)]
enum Numbers {
    Bytes(Vec<i8>),
    Shorts(Vec<i16>),
    Longs(Vec<i32>),
}

/// How closely numbers are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Packing {
    /// Within a thousandth of a step where they are not large: for what is still compared.
    Close,
    /// In as few bytes as leave them within a sixteenth of a step. Together with the half step by which
    /// kept integers are rounded, that is 1.01 times as much.
    Small,
}

/// Bits behind the point that numbers have at most: their rounding adds nothing to that of the integers.
const MOST_FRACTION: i32 = 10;

/// And at least, where they are to be small.
const LEAST_FRACTION: i32 = 3;

/// Columns begin to be kept otherwise at whole multiples of this, so that few numbers are left beside
/// whole vectors.
const COLUMNS: usize = 16;

macro_rules! of_any_size {
    ($numbers:expr, $integers:ident => $work:expr) => {
        match $numbers {
            Numbers::Bytes($integers) => $work,
            Numbers::Shorts($integers) => $work,
            Numbers::Longs($integers) => $work,
        }
    };
}

impl Packed {
    /// Of rows of `row` numbers.
    pub fn new(values: &[f64], row: usize, packing: Packing) -> Self {
        let sizes = match packing {
            Packing::Close => vec![Size::Long],
            Packing::Small => sizes(values, row),
        };
        let mut parts = Vec::new();
        let mut first = 0;
        for (k, size) in sizes.iter().enumerate() {
            // Until the next is of another size.
            if sizes.get(k + 1) != Some(size) {
                let end = match k + 1 == sizes.len() {
                    true => row,
                    false => (k + 1) * COLUMNS,
                };
                parts.push(Part::new(values, row, first..end, *size));
                first = end;
            }
        }
        let count = values.len();
        Self { parts, count }
    }

    /// All of them, row by row, each times the factor of its column.
    pub fn real<T: Real>(&self, factors: &[f64]) -> Vec<T> {
        self.beside(
            factors,
            |part, factors| of_any_size!(&part.numbers, x => scaled(x, real, factors)),
        )
    }

    /// `Σ_i w_i x[a, i, b]` for an array (left, weights, right, column), times the factors of the columns.
    pub fn summed<T: Real>(&self, left: usize, weights: &[T], factors: &[f64]) -> Vec<T> {
        let right = self.count / (left * weights.len() * factors.len());
        self.beside(factors, |part, factors| {
            let right = right * part.padded;
            let sums: Vec<T> =
                of_any_size!(&part.numbers, x => summed(x, real, left, right, weights));
            scaled(&sums, |x| *x, factors)
        })
    }

    /// The product of a matrix of rows of `inner` and the numbers as a matrix of `inner` rows, times the factors
    /// of the columns.
    pub fn product<T: Real>(&self, a: &[T], inner: usize, factors: &[f64]) -> Vec<T> {
        if a.len() == inner {
            return self.summed(1, a, factors);
        }
        self.beside(factors, |part, factors| {
            let product: Vec<T> = of_any_size!(&part.numbers, x => product_of(a, inner, x, real));
            scaled(&product, |x| *x, factors)
        })
    }

    /// What `work` makes of each part, side by side; it is told what its integers are to be multiplied by.
    fn beside<T: Real>(&self, factors: &[f64], work: impl Fn(&Part, &[T]) -> Vec<T>) -> Vec<T> {
        let mut first = 0;
        let made = self.parts.iter().map(|part| {
            let factors = factors[first..first + part.width].iter();
            let mut factors: Vec<T> = factors.map(|f| T::from_f64(f * part.unit)).collect();
            factors.resize(part.padded, T::ZERO);
            first += part.width;
            work(part, &factors)
        });
        let mut made: Vec<Vec<T>> = made.collect();
        match &self.parts[..] {
            [part] if part.width == part.padded => made.swap_remove(0),
            parts => side_by_side(parts, &made),
        }
    }
}

/// Matrices of the columns of `parts` as one.
fn side_by_side<T: Real>(parts: &[Part], matrices: &[Vec<T>]) -> Vec<T> {
    let row: usize = parts.iter().map(|part| part.width).sum();
    let mut all = vec![T::ZERO; matrices[0].len() / parts[0].padded * row];
    let mut first = 0;
    for (part, values) in parts.iter().zip(matrices) {
        let columns = first..first + part.width;
        let rows = all
            .chunks_exact_mut(row)
            .zip(values.chunks_exact(part.padded));
        rows.for_each(|(to, from)| to[columns.clone()].copy_from_slice(&from[..part.width]));
        first += part.width;
    }
    all
}

#[inline(always)]
fn real<T: Real, N: Copy + Into<i32>>(integer: &N) -> T {
    T::from_i32((*integer).into())
}

/// How large integers are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Size {
    Byte,
    Short,
    Long,
}

impl Size {
    /// The largest integer; of the longest a bit is spared for sums.
    fn most(self) -> i32 {
        match self {
            Size::Byte => i8::MAX.into(),
            Size::Short => i16::MAX.into(),
            Size::Long => 1 << 30,
        }
    }

    /// Bits behind the point of numbers up to `largest`.
    fn fraction(self, largest: f64) -> i32 {
        let room = f64::from(self.most()) / largest.max(1.0);
        (room.log2().floor() as i32).min(MOST_FRACTION)
    }

    /// The smallest for numbers up to `largest`.
    fn of(largest: f64) -> Self {
        let fits = |size: &Size| size.fraction(largest) >= LEAST_FRACTION;
        let mut sizes = [Size::Byte, Size::Short].into_iter();
        sizes.find(fits).unwrap_or(Size::Long)
    }
}

/// The size of each sixteen columns, none larger than those before.
fn sizes(values: &[f64], row: usize) -> Vec<Size> {
    let mut largest = vec![0.0_f64; row.div_ceil(COLUMNS)];
    for row in values.chunks_exact(row) {
        for (largest, x) in largest.iter_mut().zip(row.chunks(COLUMNS)) {
            *largest = x.iter().fold(*largest, |most, x| most.max(x.abs()));
        }
    }
    let mut most = Size::Byte;
    let mut sizes: Vec<Size> = largest
        .into_iter()
        .rev()
        .map(|largest| {
            most = most.max(Size::of(largest));
            most
        })
        .collect();
    sizes.reverse();
    sizes
}

impl Part {
    /// Of some columns of rows of `row` numbers.
    fn new(values: &[f64], row: usize, columns: std::ops::Range<usize>, size: Size) -> Self {
        let width = columns.len();
        let padded = match row < COLUMNS {
            true => width,
            false => width.next_multiple_of(COLUMNS),
        };
        let zeros = [0.0; COLUMNS];
        let own = values.chunks_exact(row);
        let own = own.flat_map(|row| row[columns.clone()].iter().chain(&zeros[..padded - width]));
        let own: Vec<f64> = own.copied().collect();
        let largest = own.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
        let fraction = size.fraction(largest).max(0);
        let unit = f64::from(1 << fraction);
        let integers = own.iter().map(|x| (x * unit).round());
        let numbers = match size {
            Size::Byte => Numbers::Bytes(integers.map(|x| x as i8).collect()),
            Size::Short => Numbers::Shorts(integers.map(|x| x as i16).collect()),
            Size::Long => Numbers::Longs(integers.map(|x| x as i32).collect()),
        };
        Self {
            width,
            padded,
            unit: 1.0 / unit,
            numbers,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows of 70 columns that fall from 3000 to below 1.
    fn rows(count: usize) -> Vec<f64> {
        let number = |i: usize| (i as f64 * 0.7).sin() * 3000.0 * (-0.13 * (i % 70) as f64).exp();
        (0..count * 70).map(number).collect()
    }

    #[test]
    fn small_numbers_take_few_bytes_and_stay_near() {
        let values = rows(30);
        let packed = Packed::new(&values, 70, Packing::Small);
        let widths: Vec<(usize, usize)> = packed
            .parts
            .iter()
            .map(|part| {
                (
                    part.width,
                    of_any_size!(&part.numbers, x => size_of_val(&x[0])),
                )
            })
            .collect();
        assert_eq!(widths, [(48, 2), (22, 1)]);
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
        let expected = summed(&all, |x| *x, 2, 3 * 70, &weights);
        close(&packed.summed(2, &weights, &factors), &expected);
        let a: Vec<f64> = (0..7 * 10).map(|i| f64::from(i % 9) - 4.0).collect();
        let expected = super::super::matrix::product(&a, 10, &all);
        close(&packed.product(&a, 10, &factors), &expected);
    }
}
