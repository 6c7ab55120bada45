//! How large an integer is expected to be.
//!
//! In: what stands around it. Out: its class, of those that are coded alike. The expected size is a
//! weighted mean of the sizes around it, and how much each counts is learnt while coding, for each
//! number of axes: after every integer weights move a little towards those that came nearer (normalised
//! least mean squares: B. Widrow, M. E. Hoff, *Adaptive switching circuits*, IRE WESCON (1960)). Sums,
//! products and quotients round in the same way on every machine.

use super::{
    adaptive::CLASSES,
    walk::{Walk, Weights},
};

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

#[cfg(test)]
mod tests {
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
