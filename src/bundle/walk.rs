//! What stands around an integer of a tensor, before it in storage order.
//!
//! In: a shape, and place after place. Out: the class of each ([`Walk::class`]) by the mean size of its
//! neighbours and by how that compares with the mean size at the same place of the vectors before, and the
//! integers that tell its sign ([`Walk::beside`]).

use super::adaptive::{MOST_TREND, SIZES, TRENDS};

/// How much the neighbours before an integer count that are one and two places back: along the last
/// axis, and along any other. Two back as well: in even and odd functions every other coefficient is zero.
/// Fitted to the integers of Sol (where 4, 2, 3, 1 take 5 % more bytes), Schwarzschild and Ellis (1 %
/// fewer), the Gaussian lens and three bumps (the same).
const ALONG_LAST: [u32; 2] = [3, 3];
const ALONG_OTHERS: [u32; 2] = [3, 2];

/// An integer that comes before.
#[derive(Debug, Clone, Copy)]
struct Neighbour {
    axis: usize,
    /// How many places along it.
    back: usize,
    /// How far before in storage.
    offset: usize,
    weight: u32,
}

/// Another, by which signs are guessed.
#[derive(Debug, Clone, Copy)]
struct Beside {
    axis: usize,
    back: usize,
    /// How many places further along the last axis.
    shift: isize,
    offset: usize,
}

/// Walks a tensor in storage order and tells the class of each place from the values before it.
pub(super) struct Walk {
    /// Lengths of the axes that are longer than one.
    shape: Vec<usize>,
    index: Vec<usize>,
    neighbours: Vec<Neighbour>,
    /// Those that exist in the present row, but for its first columns.
    of_row: Vec<Neighbour>,
    beside: Vec<Beside>,
    history: History,
}

/// Mean sizes at each place of the vectors before: what has one index along the first axis is a vector.
struct History {
    /// In units of 1/[`PARTS`].
    means: Vec<i64>,
    place: usize,
    /// Complete vectors, as far as they count.
    vectors: i64,
}

/// Parts of one that means are counted in.
const PARTS: i64 = 16;

/// How many vectors a mean goes back. With twice as many up to 0.4 % more bytes.
const REMEMBERED: i64 = 8;

impl History {
    fn new(length: usize) -> Self {
        Self {
            means: vec![0; length],
            place: 0,
            vectors: 0,
        }
    }

    /// The mean at the present place; `None` in the first vector.
    fn mean(&self) -> Option<f64> {
        let mean = self.means[self.place] as f64 / PARTS as f64;
        (self.vectors > 0).then_some(mean)
    }

    /// Adds the value of the present place, and on to the next.
    fn add(&mut self, value: i32) {
        let off = PARTS * i64::from(value.unsigned_abs()) - self.means[self.place];
        self.means[self.place] += off / (self.vectors + 1);
        self.place += 1;
        if self.place == self.means.len() {
            self.place = 0;
            self.vectors = (self.vectors + 1).min(REMEMBERED - 1);
        }
    }
}

impl Walk {
    /// At the first place of a tensor of this shape.
    pub(super) fn new(shape: &[usize]) -> Self {
        let shape: Vec<usize> = shape.iter().copied().filter(|n| *n > 1).collect();
        let mut walk = Self {
            index: vec![0; shape.len()],
            neighbours: neighbours(&shape),
            of_row: Vec::new(),
            beside: beside(&shape),
            history: History::new(shape.iter().skip(1).product()),
            shape,
        };
        walk.start_row();
        walk
    }

    fn start_row(&mut self) {
        let (index, last) = (&self.index, self.shape.len().saturating_sub(1));
        let exists = |n: &&Neighbour| n.axis == last || index[n.axis] >= n.back;
        self.of_row.clear();
        self.of_row.extend(self.neighbours.iter().filter(exists));
    }

    /// On to the place after the `values`, and its class.
    pub(super) fn class(&mut self, values: &[i32]) -> usize {
        if let Some(last) = values.last() {
            self.history.add(*last);
            self.advance();
        }
        let last = self.shape.len().saturating_sub(1);
        let column = self.index.last().copied().unwrap_or(0);
        let (mut sum, mut weight) = (0, 0);
        for neighbour in &self.of_row {
            if neighbour.axis < last || neighbour.back <= column {
                let value = values[values.len() - neighbour.offset];
                sum += u64::from(neighbour.weight) * u64::from(value.unsigned_abs());
                weight += neighbour.weight;
            }
        }
        let trend = self
            .history
            .mean()
            .map_or(0, |mean| trend(mean, sum, weight));
        TRENDS * class(sum, weight) + (trend + MOST_TREND) as usize
    }

    /// How many axes are longer than one.
    pub(super) fn axes(&self) -> usize {
        self.shape.len()
    }

    /// The integers beside the present place, after the `values`, in an order that only depends on the
    /// number of axes; `None` where there is none.
    pub(super) fn beside(&self, values: &[i32]) -> impl Iterator<Item = Option<i32>> {
        let last = self.shape.len().saturating_sub(1);
        self.beside.iter().map(move |b| {
            let column = self.index[last].checked_add_signed(b.shift)?;
            let exists = self.index[b.axis] >= b.back && column < self.shape[last];
            exists.then(|| values[values.len() - b.offset])
        })
    }

    fn advance(&mut self) {
        for axis in (0..self.shape.len()).rev() {
            self.index[axis] += 1;
            if self.index[axis] < self.shape[axis] {
                if axis + 1 < self.shape.len() {
                    self.start_row();
                }
                return;
            }
            self.index[axis] = 0;
        }
    }
}

/// All that a place inside of a tensor of this shape has.
fn neighbours(shape: &[usize]) -> Vec<Neighbour> {
    let mut all = Vec::new();
    for axis in 0..shape.len() {
        let weights = match axis + 1 == shape.len() {
            true => ALONG_LAST,
            false => ALONG_OTHERS,
        };
        let stride: usize = shape[axis + 1..].iter().product();
        for (back, weight) in (1..).zip(weights) {
            all.push(Neighbour {
                axis,
                back,
                offset: back * stride,
                weight,
            });
        }
    }
    all
}

/// All by which signs are guessed inside of a tensor of this shape: along the last axis four, along each
/// other two, and those on both sides of the first of them.
fn beside(shape: &[usize]) -> Vec<Beside> {
    let mut all = Vec::new();
    for axis in (0..shape.len()).rev() {
        let stride: usize = shape[axis + 1..].iter().product();
        let ways: &[(usize, isize)] = match axis + 1 == shape.len() {
            true => &[(1, 0), (2, 0), (3, 0), (4, 0)],
            false => &[(1, 0), (2, 0), (1, -1), (1, 1)],
        };
        all.extend(ways.iter().map(|&(back, shift)| Beside {
            axis,
            back,
            shift,
            offset: (back * stride).saturating_add_signed(-shift),
        }));
    }
    all
}

/// The class of integers whose neighbours, of total `weight`, sum up to `sum`.
fn class(sum: u64, weight: u32) -> usize {
    if weight == 0 || sum == 0 {
        return usize::from(weight > 0);
    }
    // Half powers of two of the mean, from 1/5 up: the exponent of (5 · mean)².
    let mean = 5.0 * sum as f64 / f64::from(weight);
    (2 + exponent(mean * mean).max(0) as usize).min(SIZES - 1)
}

/// How many times twice as large as its neighbours those before were: `mean`.
fn trend(mean: f64, sum: u64, weight: u32) -> i32 {
    let neighbours = sum as f64 / f64::from(weight.max(1));
    let ratio = (mean + LITTLE) / (neighbours + LITTLE);
    // The nearest power of two.
    let halves = exponent(2.0 * ratio * ratio);
    halves.div_euclid(2).clamp(-MOST_TREND, MOST_TREND)
}

/// Sizes much smaller than this are alike.
const LITTLE: f64 = 0.05;

/// The exponent of 2 of a positive number.
fn exponent(x: f64) -> i32 {
    (x.to_bits() >> (f64::MANTISSA_DIGITS - 1)) as i32 - (f64::MAX_EXP - 1)
}
