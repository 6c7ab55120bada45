//! Context modelling: what the integers before one in storage order tell of it.
//!
//! In: a tensor of integers, place after place. Out: for each place its context ([`Context`]: the
//! integers beside it, and the mean magnitude at the same place of the vectors before); the class of its
//! magnitude ([`MagnitudeModel`]); how likely it is to be positive ([`SignModel`]). Both models learn while
//! coding, a decoder in step with its encoder. Only sums, products, quotients and square roots are used,
//! which round in the same way on every machine.

/// An integer that comes before another.
#[derive(Debug, Clone, Copy)]
struct Neighbour {
    axis: usize,
    /// Steps back along that axis.
    back: usize,
    /// Steps on along the last axis.
    shift: isize,
    /// Places between them in storage.
    offset: usize,
    /// Its weight at first.
    weight: f64,
}

/// Weights of the neighbours along the last axis, from one step back. Two back count as much as one: in
/// even and odd functions every other coefficient is zero.
const ALONG_LAST: [f64; 4] = [3.0, 3.0, 0.5, 0.5];

/// Neighbours along another axis: steps back, steps on along the last axis, weight.
const ALONG_OTHERS: [(usize, isize, f64); 6] = [
    (1, 0, 3.0),
    (2, 0, 2.0),
    (3, 0, 0.5),
    (1, -1, 0.5),
    (1, 1, 0.5),
    (1, 2, 0.5),
];

/// The most steps back and on among them.
const FARTHEST_BACK: usize = 3;
const FARTHEST_ON: usize = 2;

/// The weight of the mean of the vectors before, at first.
const MEAN_WEIGHT: f64 = 3.0;

/// Parts of one that means are counted in.
const PARTS: i64 = 16;

/// Number of vectors that a mean goes back.
const REMEMBERED: i64 = 8;

/// The integers around a place of a tensor, before it in storage order. What has one index along the
/// first axis is a vector.
#[derive(Debug)]
pub(crate) struct Context {
    /// Lengths of the axes that are longer than one.
    shape: Vec<usize>,
    /// Index of the present place.
    index: Vec<usize>,
    neighbours: Vec<Neighbour>,
    /// Mean magnitudes at each place of the vectors before, in units of 1/[`PARTS`].
    means: Vec<i64>,
    /// Present place in its vector.
    place: usize,
    /// Complete vectors, as far as they count.
    vectors: i64,
    /// The neighbours of the present place, and last the mean of the vectors before.
    values: Vec<f64>,
    /// 1 for each of them that exists, 0 for others.
    present: Vec<f64>,
}

impl Context {
    /// Begins before the first place of a tensor of this shape.
    pub fn new(shape: &[usize]) -> Self {
        let shape: Vec<usize> = shape.iter().copied().filter(|n| *n > 1).collect();
        let neighbours = neighbours(&shape);
        Self {
            index: vec![0; shape.len()],
            means: vec![0; shape.iter().skip(1).product()],
            place: 0,
            vectors: 0,
            values: vec![0.0; neighbours.len() + 1],
            present: vec![0.0; neighbours.len() + 1],
            neighbours,
            shape,
        }
    }

    /// Moves on to the place after the `integers`.
    pub fn advance(&mut self, integers: &[i32]) {
        let Some(last) = integers.last() else {
            return;
        };
        self.add_to_mean(*last);
        for axis in (0..self.shape.len()).rev() {
            self.index[axis] += 1;
            if self.index[axis] < self.shape[axis] {
                return;
            }
            self.index[axis] = 0;
        }
    }

    /// Adds the integer at the present place of its vector, and moves on to the next.
    fn add_to_mean(&mut self, integer: i32) {
        let off = PARTS * i64::from(integer.unsigned_abs()) - self.means[self.place];
        self.means[self.place] += off / (self.vectors + 1);
        self.place += 1;
        if self.place == self.means.len() {
            self.place = 0;
            self.vectors = (self.vectors + 1).min(REMEMBERED - 1);
        }
    }

    /// Collects what stands around the present place, after the `integers`.
    pub fn look(&mut self, integers: &[i32]) {
        match self.is_inside() {
            true => self.look_inside(integers),
            false => self.look_at_border(integers),
        }
        let exists = self.vectors > 0;
        let mean = match exists {
            true => self.means[self.place] as f64 / PARTS as f64,
            false => 0.0,
        };
        let last = self.neighbours.len();
        self.values[last] = mean;
        self.present[last] = f64::from(u8::from(exists));
    }

    /// Tells whether all neighbours exist.
    fn is_inside(&self) -> bool {
        let last = self.shape.len().saturating_sub(1);
        let (column, width) = match self.index.last() {
            Some(column) => (*column, self.shape[last]),
            None => return false,
        };
        let row = self.index[..last].iter().all(|i| *i >= FARTHEST_BACK);
        row && column >= ALONG_LAST.len() && column + FARTHEST_ON < width
    }

    fn look_inside(&mut self, integers: &[i32]) {
        for (value, neighbour) in self.values.iter_mut().zip(&self.neighbours) {
            *value = f64::from(integers[integers.len() - neighbour.offset]);
        }
        self.present.fill(1.0);
    }

    fn look_at_border(&mut self, integers: &[i32]) {
        let last = self.shape.len().saturating_sub(1);
        for (i, neighbour) in self.neighbours.iter().enumerate() {
            let column = self.index[last].wrapping_add_signed(neighbour.shift);
            let exists = self.index[neighbour.axis] >= neighbour.back && column < self.shape[last];
            let value = match exists {
                true => integers[integers.len() - neighbour.offset],
                false => 0,
            };
            self.values[i] = f64::from(value);
            self.present[i] = f64::from(u8::from(exists));
        }
    }

    /// Returns what stands around the present place (0 where nothing does), last the mean magnitude at
    /// this place of the vectors before, and 1 for each that exists, 0 for others. The order depends on
    /// the number of axes only.
    fn around(&self) -> (&[f64], &[f64]) {
        (&self.values, &self.present)
    }

    /// Returns the neighbours alone.
    fn beside(&self) -> (&[f64], &[f64]) {
        let count = self.neighbours.len();
        (&self.values[..count], &self.present[..count])
    }

    /// Returns the weights of all around before anything is learnt; their sum is one.
    fn first_weights(&self) -> Vec<f64> {
        let neighbours = self.neighbours.iter().map(|n| n.weight);
        let weights: Vec<f64> = neighbours.chain([MEAN_WEIGHT]).collect();
        let sum: f64 = weights.iter().sum();
        weights.iter().map(|w| w / sum).collect()
    }
}

/// Lists the neighbours of a place inside of a tensor of this shape.
fn neighbours(shape: &[usize]) -> Vec<Neighbour> {
    let mut all = Vec::new();
    for axis in (0..shape.len()).rev() {
        let stride: usize = shape[axis + 1..].iter().product();
        let along_last = (1..).zip(ALONG_LAST).map(|(back, w)| (back, 0, w));
        let steps: Vec<(usize, isize, f64)> = match axis + 1 == shape.len() {
            true => along_last.collect(),
            false => ALONG_OTHERS.to_vec(),
        };
        all.extend(steps.into_iter().map(|(back, shift, weight)| Neighbour {
            axis,
            back,
            shift,
            offset: (back * stride).saturating_add_signed(-shift),
            weight,
        }));
    }
    all
}

/// Returns the `weights` for the number of axes of `context`, as `first` gives them before anything is
/// learnt.
fn weights_for<'w>(
    weights: &'w mut Vec<Vec<f64>>,
    context: &Context,
    first: impl FnOnce() -> Vec<f64>,
) -> &'w mut [f64] {
    let axes = context.shape.len();
    if weights.len() <= axes {
        weights.resize(axes + 1, Vec::new());
    }
    let weights = &mut weights[axes];
    if weights.is_empty() {
        *weights = first();
    }
    weights
}

/// Classes by the expected magnitude: of integers with nothing around them, with zeros around them, and
/// four for each doubling from 1/5 up.
pub(crate) const CLASSES: usize = 130;

/// The rate at which weights of magnitudes follow what they got wrong. With 0.001 and 0.003 the magnitudes
/// of three bumps take as many bits to 0.2 %, those of Ellis and Sol to 2 %.
const MAGNITUDE_RATE: f64 = 0.002;

/// Added to the magnitude that errors are measured by.
const LITTLE: f64 = 1.0;

/// The largest surprise, and the largest difference from the mean, in units of that.
const MOST_SURPRISE: f64 = 4.0;
const MOST_OFF: f64 = 2.0;

/// Number of integers after which the sum of weights is made one.
const NORMALISED_AFTER: u32 = 32;

/// Expects magnitudes. The expected one is a weighted mean of those around, and the weights are learnt for
/// each number of axes: after every integer they move a little towards those that came nearer (normalised
/// least mean squares: B. Widrow, M. E. Hoff, *Adaptive switching circuits*, IRE WESCON (1960)).
#[derive(Debug, Default)]
pub(crate) struct MagnitudeModel {
    /// For each number of axes; their sum is near one.
    weights: Vec<Vec<f64>>,
    /// The magnitude that the present integer is expected to have.
    expected: f64,
    /// Number of integers that weights were learnt from.
    learnt: u32,
}

impl MagnitudeModel {
    /// Finds the class of the integer at the present place.
    pub fn class(&mut self, context: &Context) -> usize {
        let weights = weights_for(&mut self.weights, context, || context.first_weights());
        let (around, present) = context.around();
        let (mut sum, mut all) = (0.0, 0.0);
        for ((weight, x), present) in weights.iter().zip(around).zip(present) {
            sum += weight * x.abs();
            all += weight * present;
        }
        self.expected = if all > 0.0 { sum / all } else { 0.0 };
        class(all > 0.0, self.expected)
    }

    /// Learns the magnitude of the integer.
    pub fn learn(&mut self, context: &Context, magnitude: u32) {
        // Where all around it is zero, weights do not matter.
        if self.expected <= 0.0 {
            return;
        }
        let unit = 1.0 / (self.expected + LITTLE);
        let surprise = (f64::from(magnitude) * unit).min(MOST_SURPRISE) - self.expected * unit;
        let (around, present) = context.around();
        let weights = weights_for(&mut self.weights, context, || context.first_weights());
        for ((weight, x), present) in weights.iter_mut().zip(around).zip(present) {
            let off = ((x.abs() - self.expected) * unit).clamp(-MOST_OFF, MOST_OFF);
            *weight = (*weight + MAGNITUDE_RATE * surprise * off * present).max(0.0);
        }
        self.learnt += 1;
        if self.learnt.is_multiple_of(NORMALISED_AFTER) {
            let factor = 1.0 / weights.iter().sum::<f64>();
            weights.iter_mut().for_each(|weight| *weight *= factor);
        }
    }
}

/// Finds the class of integers of this expected magnitude, if there is anything around them: four to each
/// doubling, from 1/5 up.
fn class(known: bool, expected: f64) -> usize {
    if expected <= 0.0 {
        return usize::from(known);
    }
    let square = (5.0 * expected) * (5.0 * expected);
    (2 + exponent(square * square).max(0) as usize).min(CLASSES - 1)
}

/// Returns the exponent of 2 of a positive number.
fn exponent(x: f64) -> i32 {
    (x.to_bits() >> (f64::MANTISSA_DIGITS - 1)) as i32 - (f64::MAX_EXP - 1)
}

/// The smallest mean magnitude of neighbours: among zeros one alone tells little.
const LEAST_MEAN: f64 = 0.3;

/// Magnitudes larger than this, in units of the mean, pull no more.
const MOST_PULL: f64 = 2.0;

/// The rate at which weights of signs follow what they got wrong. With 0.01 and 0.02 the signs of three
/// bumps take as many bits to 0.5 %, those of Ellis and Sol to 4 %.
const SIGN_RATE: f64 = 0.015;

/// Probabilities stay this far from 0 and 1.
const DOUBT: f64 = 0.005;

/// Expects signs. Coefficients of smooth functions follow each other along every axis in waves and
/// alternating rows, so each neighbour pulls the sign its own way, by a weight that is learnt for its
/// place: logistic regression, by one small step down the slope after every sign.
#[derive(Debug, Default)]
pub(crate) struct SignModel {
    /// For each number of axes.
    weights: Vec<Vec<f64>>,
    /// The pull of each neighbour on the present sign.
    pulls: Vec<f64>,
    /// The probability that it is positive.
    plus: f64,
}

impl SignModel {
    /// Computes the probability that the integer at the present place, of this `magnitude`, is positive.
    pub fn plus(&mut self, context: &Context, magnitude: u32) -> f64 {
        // Magnitudes in units of the mean around.
        let (beside, present) = context.beside();
        let sum: f64 = beside.iter().map(|x| x.abs()).sum();
        let count: f64 = present.iter().sum();
        let unit = 1.0 / f64::max(sum / count.max(1.0), LEAST_MEAN);
        let own = f64::min(f64::from(magnitude) * unit, MOST_PULL);
        // Pulls of the neighbours, and their weighted sum.
        let pull = |x: &f64| own * (x * unit).clamp(-MOST_PULL, MOST_PULL);
        self.pulls.clear();
        self.pulls.extend(beside.iter().map(pull));
        let weights = weights_for(&mut self.weights, context, || vec![0.0; beside.len()]);
        let pull: f64 = weights.iter().zip(&self.pulls).map(|(w, x)| w * x).sum();
        self.plus = probability(pull);
        self.plus
    }

    /// Learns the sign of the last integer.
    pub fn learn(&mut self, context: &Context, positive: bool) {
        let step = SIGN_RATE * (if positive { 1.0 } else { 0.0 } - self.plus);
        let count = self.pulls.len();
        let weights = weights_for(&mut self.weights, context, || vec![0.0; count]);
        for (weight, pull) in weights.iter_mut().zip(&self.pulls) {
            *weight += step * pull;
        }
    }
}

/// Computes the probability of yes where `x` speaks for it: nearly `1 / (1 + e^−x)`, without a power that
/// every machine rounds in its own way.
fn probability(x: f64) -> f64 {
    (0.5 + 0.5 * x / (4.0 + x * x).sqrt()).clamp(DOUBT, 1.0 - DOUBT)
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::random::Stream;

    /// Every third of a row is large, the others are small: nothing but the integer three back tells.
    #[test]
    fn weights_go_to_what_tells_magnitudes() {
        let row: Vec<i32> = (0..6000)
            .map(|i| if i % 3 == 0 { 900 } else { 9 })
            .collect();
        let (mut context, mut model) = (Context::new(&[row.len()]), MagnitudeModel::default());
        let mut classes = Vec::new();
        for (place, value) in row.iter().enumerate() {
            context.advance(&row[..place]);
            context.look(&row[..place]);
            classes.push(model.class(&context));
            model.learn(&context, value.unsigned_abs());
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
    fn four_classes_double_the_magnitude() {
        assert_eq!([class(false, 0.0), class(true, 0.0)], [0, 1]);
        assert_eq!(class(true, 0.01), 2);
        for size in [0.3, 1.0, 47.0, 1e6] {
            assert_eq!(class(true, 2.0 * size), class(true, size) + 4);
        }
        assert_eq!(class(true, 1e300), CLASSES - 1);
    }

    /// Counts the bits that the signs of a row of `values` take.
    fn bits(values: &[i32]) -> f64 {
        let (mut context, mut signs) = (Context::new(&[values.len()]), SignModel::default());
        let mut bits = 0.0;
        for (place, value) in values.iter().enumerate() {
            context.advance(&values[..place]);
            context.look(&values[..place]);
            let plus = signs.plus(&context, value.unsigned_abs());
            signs.learn(&context, *value > 0);
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
