//! What stands around an integer of a tensor, before it in storage order.
//!
//! In: a shape, and place after place. Out: the integers beside each, and the mean size at the same place of
//! the vectors before it.
//!
//! How large an integer is expected to be.
//!
//! In: what stands around it. Out: its class, of those that are coded alike. The expected size is a
//! weighted mean of the sizes around it, and how much each counts is learnt while coding, for each
//! number of axes: after every integer weights move a little towards those that came nearer (normalised
//! least mean squares: B. Widrow, M. E. Hoff, *Adaptive switching circuits*, IRE WESCON (1960)). Sums,
//! products and quotients round in the same way on every machine.
//!
//! How likely an integer is to be positive.
//!
//! In: its size, and the integers beside it. Out: a probability, learnt while coding. Coefficients of
//! smooth functions follow each other along every axis in waves and alternating rows, so each
//! neighbour pulls the sign its own way, by a weight that is learnt for its place: logistic regression, by
//! one small step down the slope after every sign. Sums, products, quotients and square roots round in the
//! same way on every machine.

use crate::coder::CLASSES;

/// An integer that comes before.
#[derive(Debug, Clone, Copy)]
struct Beside {
    axis: usize,
    /// How many places back along it.
    back: usize,
    /// How many places further along the last axis.
    shift: isize,
    /// How far before in storage.
    offset: usize,
    /// How much it counts at first.
    weight: f64,
}

/// How far back along the last axis integers are looked at, and how much they count at first. Two back as
/// much as one: in even and odd functions every other coefficient is zero.
const ALONG_LAST: [f64; 4] = [3.0, 3.0, 0.5, 0.5];

/// How far back along another axis, and how far on along the last, and how much these count at first.
const ALONG_OTHERS: [(usize, isize, f64); 6] = [
    (1, 0, 3.0),
    (2, 0, 2.0),
    (3, 0, 0.5),
    (1, -1, 0.5),
    (1, 1, 0.5),
    (1, 2, 0.5),
];

/// The farthest of them.
const FARTHEST_BACK: usize = 3;
const FARTHEST_ON: usize = 2;

/// How much the mean of the vectors before counts at first.
const BEFORE: f64 = 3.0;

/// Walks a tensor in storage order.
#[derive(Debug)]
pub(super) struct Walk {
    /// Lengths of the axes that are longer than one.
    shape: Vec<usize>,
    index: Vec<usize>,
    beside: Vec<Beside>,
    history: History,
    /// What stands around the present place, and one for each that does, zero for others: in an order that
    /// depends on the number of axes only, the mean of the vectors before last.
    around: Vec<f64>,
    present: Vec<f64>,
}

/// Mean sizes at each place of the vectors before: what has one index along the first axis is a vector.
#[derive(Debug)]
struct History {
    /// In units of 1/[`PARTS`].
    means: Vec<i64>,
    place: usize,
    /// Complete vectors, as far as they count.
    vectors: i64,
}

/// Parts of one that means are counted in.
const PARTS: i64 = 16;

/// How many vectors a mean goes back.
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
        (self.vectors > 0).then(|| self.means[self.place] as f64 / PARTS as f64)
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
    /// Before the first place of a tensor of this shape.
    pub(super) fn new(shape: &[usize]) -> Self {
        let shape: Vec<usize> = shape.iter().copied().filter(|n| *n > 1).collect();
        let beside = beside(&shape);
        Self {
            index: vec![0; shape.len()],
            history: History::new(shape.iter().skip(1).product()),
            around: vec![0.0; beside.len() + 1],
            present: vec![0.0; beside.len() + 1],
            beside,
            shape,
        }
    }

    /// On to the place after the `values`.
    pub(super) fn on(&mut self, values: &[i32]) {
        if let Some(last) = values.last() {
            self.history.add(*last);
            self.advance();
        }
    }

    /// Looks around at the present place, after the `values`.
    pub(super) fn look(&mut self, values: &[i32]) {
        match self.is_inside() {
            true => self.look_inside(values),
            false => self.look_at_border(values),
        }
        let (before, i) = (self.history.mean(), self.beside.len());
        self.around[i] = before.unwrap_or(0.0);
        self.present[i] = f64::from(u8::from(before.is_some()));
    }

    /// Whether all neighbours exist.
    fn is_inside(&self) -> bool {
        let last = self.shape.len().saturating_sub(1);
        let (column, width) = match self.index.last() {
            Some(column) => (*column, self.shape[last]),
            None => return false,
        };
        let row = self.index[..last].iter().all(|i| *i >= FARTHEST_BACK);
        row && column >= ALONG_LAST.len() && column + FARTHEST_ON < width
    }

    fn look_inside(&mut self, values: &[i32]) {
        for (around, beside) in self.around.iter_mut().zip(&self.beside) {
            *around = f64::from(values[values.len() - beside.offset]);
        }
        self.present.fill(1.0);
    }

    fn look_at_border(&mut self, values: &[i32]) {
        let last = self.shape.len().saturating_sub(1);
        for (i, beside) in self.beside.iter().enumerate() {
            let column = self.index[last].wrapping_add_signed(beside.shift);
            let exists = self.index[beside.axis] >= beside.back && column < self.shape[last];
            let value = if exists {
                values[values.len() - beside.offset]
            } else {
                0
            };
            self.around[i] = f64::from(value);
            self.present[i] = f64::from(u8::from(exists));
        }
    }

    /// How many axes are longer than one.
    fn axes(&self) -> usize {
        self.shape.len()
    }

    /// What stands around the present place (0 where nothing does), and one for each that does, zero for
    /// others. Last the mean size at this place of the vectors before.
    pub(super) fn around(&self) -> (&[f64], &[f64]) {
        (&self.around, &self.present)
    }

    /// The integers beside the present place, and for each whether there is one.
    pub(super) fn beside(&self) -> (&[f64], &[f64]) {
        let count = self.beside.len();
        (&self.around[..count], &self.present[..count])
    }

    /// How much each of those around counts before anything is known, all together one.
    pub(super) fn first_weights(&self) -> Vec<f64> {
        let beside = self.beside.iter().map(|b| b.weight);
        let weights: Vec<f64> = beside.chain([BEFORE]).collect();
        let sum: f64 = weights.iter().sum();
        weights.iter().map(|w| w / sum).collect()
    }

    fn advance(&mut self) {
        for axis in (0..self.shape.len()).rev() {
            self.index[axis] += 1;
            if self.index[axis] < self.shape[axis] {
                return;
            }
            self.index[axis] = 0;
        }
    }
}

/// Weights of what stands around a place, for each number of axes.
#[derive(Debug, Default)]
pub(super) struct Weights(Vec<Vec<f64>>);

impl Weights {
    /// Those for the axes of `walk`, as `first` gives them before anything is known.
    pub(super) fn of(&mut self, walk: &Walk, first: impl FnOnce() -> Vec<f64>) -> &mut [f64] {
        let axes = walk.axes();
        if self.0.len() <= axes {
            self.0.resize(axes + 1, Vec::new());
        }
        let weights = &mut self.0[axes];
        if weights.is_empty() {
            *weights = first();
        }
        weights
    }
}

/// All that a place inside of a tensor of this shape has.
fn beside(shape: &[usize]) -> Vec<Beside> {
    let mut all = Vec::new();
    for axis in (0..shape.len()).rev() {
        let stride: usize = shape[axis + 1..].iter().product();
        let along_last = (1..).zip(ALONG_LAST).map(|(back, w)| (back, 0, w));
        let ways: Vec<(usize, isize, f64)> = match axis + 1 == shape.len() {
            true => along_last.collect(),
            false => ALONG_OTHERS.to_vec(),
        };
        all.extend(ways.into_iter().map(|(back, shift, weight)| Beside {
            axis,
            back,
            shift,
            offset: (back * stride).saturating_add_signed(-shift),
            weight,
        }));
    }
    all
}

/// How far weights follow what they got wrong. With 0.001 and 0.003 the sizes of three bumps take the same to
/// 0.2 %, those of Ellis and Sol to 2 %.
const RATE: f64 = 0.002;

/// What is added to the size that errors are measured by.
const LITTLE: f64 = 1.0;

/// The largest surprise, and the largest difference from the mean, in units of that.
const MOST_SURPRISE: f64 = 4.0;
const MOST_OFF: f64 = 2.0;

/// After how many integers the sum of weights is made one.
const OFTEN: u32 = 32;

/// What is known of sizes.
#[derive(Debug, Default)]
pub(super) struct Sizes {
    /// Their sum is near one.
    weights: Weights,
    /// The size that the present integer is expected to have.
    expected: f64,
    /// How many integers weights were learnt from.
    learnt: u32,
}

impl Sizes {
    /// The class of the integer at the present place.
    pub(super) fn class(&mut self, walk: &Walk) -> usize {
        let weights = self.weights.of(walk, || walk.first_weights());
        let (around, present) = walk.around();
        let (mut sum, mut all) = (0.0, 0.0);
        for ((weight, x), present) in weights.iter().zip(around).zip(present) {
            sum += weight * x.abs();
            all += weight * present;
        }
        self.expected = if all > 0.0 { sum / all } else { 0.0 };
        class(all > 0.0, self.expected)
    }

    /// What the size of the integer was.
    pub(super) fn learn(&mut self, walk: &Walk, size: u32) {
        // Where all around it is zero, weights do not matter.
        if self.expected <= 0.0 {
            return;
        }
        let unit = 1.0 / (self.expected + LITTLE);
        let surprise = (f64::from(size) * unit).min(MOST_SURPRISE) - self.expected * unit;
        let (around, present) = walk.around();
        let weights = self.weights.of(walk, || walk.first_weights());
        for ((weight, x), present) in weights.iter_mut().zip(around).zip(present) {
            let off = ((x.abs() - self.expected) * unit).clamp(-MOST_OFF, MOST_OFF);
            *weight = (*weight + RATE * surprise * off * present).max(0.0);
        }
        self.learnt += 1;
        if self.learnt.is_multiple_of(OFTEN) {
            let factor = 1.0 / weights.iter().sum::<f64>();
            weights.iter_mut().for_each(|weight| *weight *= factor);
        }
    }
}

/// The class of integers of this expected size, if there is anything around them: four to each doubling, from
/// 1/5 up.
fn class(known: bool, expected: f64) -> usize {
    if expected <= 0.0 {
        return usize::from(known);
    }
    let square = (5.0 * expected) * (5.0 * expected);
    (2 + exponent(square * square).max(0) as usize).min(CLASSES - 1)
}

/// The exponent of 2 of a positive number.
fn exponent(x: f64) -> i32 {
    (x.to_bits() >> (f64::MANTISSA_DIGITS - 1)) as i32 - (f64::MAX_EXP - 1)
}

/// The smallest mean size of neighbours: among zeros one alone tells little.
const LEAST: f64 = 0.3;

/// Sizes larger than this, in units of the mean, pull no more.
const MOST: f64 = 2.0;

/// How far weights follow what they got wrong. With 0.01 and 0.02 the signs of three bumps take the same to
/// 0.5 %, those of Ellis and Sol to 4 %.
const SIGN_RATE: f64 = 0.015;

/// Probabilities stay this far from 0 and 1.
const DOUBT: f64 = 0.005;

/// What is known of signs.
#[derive(Debug, Default)]
pub(super) struct Signs {
    weights: Weights,
    /// How each neighbour pulls the present sign.
    pulls: Vec<f64>,
    /// How likely it is to be positive.
    plus: f64,
}

impl Signs {
    /// The probability that the integer at the present place, of this `size`, is positive.
    pub(super) fn plus(&mut self, walk: &Walk, size: u32) -> f64 {
        let (beside, present) = walk.beside();
        let sum: f64 = beside.iter().map(|x| x.abs()).sum();
        let count: f64 = present.iter().sum();
        let unit = 1.0 / f64::max(sum / count.max(1.0), LEAST);
        let own = f64::min(f64::from(size) * unit, MOST);
        let pull = |x: &f64| own * (x * unit).clamp(-MOST, MOST);
        self.pulls.clear();
        self.pulls.extend(beside.iter().map(pull));
        let weights = self.weights.of(walk, || vec![0.0; beside.len()]);
        let pull: f64 = weights.iter().zip(&self.pulls).map(|(w, x)| w * x).sum();
        self.plus = chance(pull);
        self.plus
    }

    /// What the sign of the last integer was.
    pub(super) fn learn(&mut self, walk: &Walk, positive: bool) {
        let step = SIGN_RATE * (if positive { 1.0 } else { 0.0 } - self.plus);
        let weights = self.weights.of(walk, || vec![0.0; self.pulls.len()]);
        for (weight, pull) in weights.iter_mut().zip(&self.pulls) {
            *weight += step * pull;
        }
    }
}

/// The probability of yes where so much speaks for it: nearly `1 / (1 + e^−x)`, without a power that every
/// machine rounds in its own way.
fn chance(x: f64) -> f64 {
    (0.5 + 0.5 * x / (4.0 + x * x).sqrt()).clamp(DOUBT, 1.0 - DOUBT)
}

#[cfg(test)]
mod sizes_tests {
    use super::*;

    /// Every third of a row is large, the others are small: nothing but what is three back tells.
    #[test]
    fn weights_go_to_what_tells_sizes() {
        let row: Vec<i32> = (0..6000)
            .map(|i| if i % 3 == 0 { 900 } else { 9 })
            .collect();
        let (mut walk, mut sizes) = (Walk::new(&[row.len()]), Sizes::default());
        let mut classes = Vec::new();
        for (place, value) in row.iter().enumerate() {
            walk.on(&row[..place]);
            walk.look(&row[..place]);
            classes.push(sizes.class(&walk));
            sizes.learn(&walk, value.unsigned_abs());
        }
        let last = &classes[row.len() - 30..];
        let large: Vec<usize> = last.iter().copied().step_by(3).collect();
        let small = last.iter().skip(1).step_by(3);
        assert!(
            large.iter().zip(small).all(|(a, b)| *a >= b + 12),
            "{last:?}"
        );
    }

    #[test]
    fn four_classes_double_the_size() {
        assert_eq!([class(false, 0.0), class(true, 0.0)], [0, 1]);
        assert_eq!(class(true, 0.01), 2);
        for size in [0.3, 1.0, 47.0, 1e6] {
            assert_eq!(class(true, 2.0 * size), class(true, size) + 4);
        }
        assert_eq!(class(true, 1e300), CLASSES - 1);
    }
}

#[cfg(test)]
mod signs_tests {
    use super::*;
    use geofan_core::random::Stream;

    /// The bits that the signs of a row of `values` take.
    fn bits(values: &[i32]) -> f64 {
        let (mut walk, mut signs) = (Walk::new(&[values.len()]), Signs::default());
        let mut bits = 0.0;
        for (place, value) in values.iter().enumerate() {
            walk.on(&values[..place]);
            walk.look(&values[..place]);
            let plus = signs.plus(&walk, value.unsigned_abs());
            signs.learn(&walk, *value > 0);
            bits -= if *value > 0 { plus } else { 1.0 - plus }.log2();
        }
        bits
    }

    #[test]
    fn waves_take_few_signs_and_noise_one_bit_each() {
        let mut stream = Stream::new(&[2]);
        let mut size = || 1 + (20.0 * stream.uniform()) as i32;
        let even: Vec<i32> = (0..4000)
            .map(|i| if i % 2 == 0 { size() } else { -size() })
            .collect();
        assert!(bits(&even) < 600.0, "{}", bits(&even));
        let pairs: Vec<i32> = (0..4000)
            .map(|i| if i % 4 < 2 { size() } else { -size() })
            .collect();
        assert!(bits(&pairs) < 1000.0, "{}", bits(&pairs));
        let noise: Vec<i32> = (0..4000)
            .map(|_| stream.between(-20.0, 20.0) as i32)
            .map(|x| if x == 0 { 1 } else { x })
            .collect();
        assert!(bits(&noise) < 4060.0, "{}", bits(&noise));
    }
}
