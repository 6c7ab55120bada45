//! Integers of many tensors, coded together.
//!
//! In: tensors of rounded coefficients. Out: bytes, and back. Coefficients fall off along every
//! axis, so what stands just before an integer tells how large it will be: each has a class by the
//! mean size of its neighbours, and by how that compares with the mean size at the same place of the
//! vectors before; integers of one class are coded alike ([`adaptive`]). All tensors of a chunk share
//! what is learnt of the classes. By neighbours alone this takes 0.88 of the bytes of one pco stream for
//! each class (three bumps on a rail) and 0.6 of those of one for each tensor; the vectors before take off
//! another 1 to 4 % (Ellis, three bumps, the Gaussian lens).
//!
//! [`adaptive`]: super::adaptive

use super::{
    adaptive::{Coder, Decoder, MOST_TREND, SIZES, TRENDS},
    bytes::{Damage, Reader, Writer},
    reflections::Taken,
};

/// The most integers of a chunk: far above any that a bake makes, and small enough that a hostile
/// file cannot exhaust the memory.
const MOST_INTEGERS: usize = 1 << 26;

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

/// Walks a tensor in storage order and tells the class of each place from the values before it.
pub(super) struct Walk {
    /// Lengths of the axes that are longer than one.
    shape: Vec<usize>,
    index: Vec<usize>,
    neighbours: Vec<Neighbour>,
    /// Those that exist in the present row, but for its first columns.
    of_row: Vec<Neighbour>,
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

    /// The class of the place after the `values`, and on to the next place.
    pub(super) fn class(&mut self, values: &[i32]) -> usize {
        if let Some(last) = values.last() {
            self.history.add(*last);
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
        self.advance();
        let trend = self
            .history
            .mean()
            .map_or(0, |mean| trend(mean, sum, weight));
        TRENDS * class(sum, weight) + (trend + MOST_TREND) as usize
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

/// Integers on their way into a chunk.
#[derive(Debug)]
pub struct Integers {
    coder: Coder,
    count: u32,
}

impl Integers {
    /// None yet.
    pub fn new() -> Self {
        Self {
            coder: Coder::new(),
            count: 0,
        }
    }

    /// Adds the numbers of a tensor in storage order: [reduced](super::reflections::reduced) vectors of
    /// this `length`.
    pub fn put(&mut self, shape: &[usize], length: usize, values: &[i32]) {
        let mut walk = Walk::new(shape);
        let mut taken = Taken::none(length);
        for (flat, value) in values.iter().enumerate() {
            let class = walk.class(&values[..flat]);
            if !taken.holds(flat % length) {
                self.coder.put(class, *value);
            }
            taken.behind(&values[..=flat]);
        }
        self.count += values.len() as u32;
    }

    /// How many bytes they take.
    pub fn bytes(&self) -> usize {
        self.coder.bytes()
    }

    /// Writes them.
    pub fn encode(self, out: &mut Writer) {
        out.u32(self.count);
        out.bytes(&self.coder.finish());
    }
}

/// Integers on their way out of a chunk.
#[derive(Debug)]
pub struct Coded {
    decoder: Decoder,
    left: usize,
}

impl Coded {
    /// Begins to read what [`Integers::encode`] wrote.
    ///
    /// # Errors
    /// It is damaged.
    pub fn decode(input: &mut Reader<'_>) -> Result<Self, Damage> {
        let left = input.u32()? as usize;
        if left > MOST_INTEGERS {
            return Err(Damage("number of coefficients"));
        }
        Ok(Self {
            decoder: Decoder::new(input.bytes()?)?,
            left,
        })
    }

    /// Takes the numbers of the next tensor out, vectors of this `length`.
    ///
    /// # Errors
    /// There are fewer integers.
    pub fn take(&mut self, shape: &[usize], length: usize) -> Result<Vec<i32>, Damage> {
        let count = shape.iter().product();
        let left = self.left.checked_sub(count);
        self.left = left.ok_or(Damage("number of coefficients"))?;
        let mut values = Vec::with_capacity(count);
        let mut walk = Walk::new(shape);
        let mut taken = Taken::none(length);
        for flat in 0..count {
            let class = walk.class(&values);
            values.push(match taken.holds(flat % length) {
                true => 0,
                false => self.decoder.take(class)?,
            });
            taken.behind(&values);
        }
        Ok(values)
    }

    /// That nothing is left.
    ///
    /// # Errors
    /// Something is.
    pub fn finish(&self) -> Result<(), Damage> {
        match self.left == 0 && self.decoder.is_done() {
            true => Ok(()),
            false => Err(Damage("end")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;

    fn falling(shape: [usize; 3], seed: u64) -> Vec<i32> {
        let mut stream = Stream::new(&[seed]);
        let mut values = Vec::new();
        for i in 0..shape[0] {
            for j in 0..shape[1] {
                for k in 0..shape[2] {
                    let size = 3e5 * (-0.7 * (i + j) as f64 - 0.4 * k as f64).exp();
                    values.push((size * stream.between(-1.0, 1.0)).round() as i32);
                }
            }
        }
        values
    }

    #[test]
    fn tensors_come_back_in_order() {
        let shapes = [[9, 7, 12], [1, 1, 1], [3, 20, 2], [12, 12, 12]];
        let tensors: Vec<Vec<i32>> = (0..).zip(shapes).map(|(i, s)| falling(s, i)).collect();
        let mut integers = Integers::new();
        for (shape, tensor) in shapes.iter().zip(&tensors) {
            integers.put(shape, tensor.len(), tensor);
        }
        let mut out = Writer::default();
        integers.encode(&mut out);
        let mut coded = Coded::decode(&mut Reader(&out.0)).unwrap();
        for (shape, tensor) in shapes.iter().zip(&tensors) {
            assert!(coded.finish().is_err());
            assert_eq!(&coded.take(shape, tensor.len()).unwrap(), tensor);
        }
        assert_eq!(coded.finish(), Ok(()));
        assert!(coded.take(&[1], 1).is_err());
    }

    #[test]
    fn neighbours_tell_how_large_coefficients_are() {
        let shape = [12, 12, 40];
        let tensor = falling(shape, 7);
        let mut integers = Integers::new();
        integers.put(&shape, tensor.len(), &tensor);
        let mut shuffled = Integers::new();
        let mut stream = Stream::new(&[3]);
        let mut order: Vec<(u64, i32)> = tensor.iter().map(|x| (stream.bits(), *x)).collect();
        order.sort_unstable();
        let order: Vec<i32> = order.iter().map(|(_, x)| *x).collect();
        shuffled.put(&shape, order.len(), &order);
        assert!(2 * integers.bytes() < shuffled.bytes());
    }

    #[test]
    fn a_shorter_file_is_refused() {
        let shape = [9, 7, 12];
        let mut integers = Integers::new();
        integers.put(&shape, 9 * 7 * 12, &falling(shape, 3));
        let mut out = Writer::default();
        integers.encode(&mut out);
        for cut in 0..out.0.len() {
            assert!(Coded::decode(&mut Reader(&out.0[..cut])).is_err());
        }
    }
}
