//! How likely an integer is to be positive.
//!
//! In: its size, and the integers beside it. Out: a probability, learnt while coding. Coefficients of
//! smooth functions follow each other along every axis in waves and alternating rows, so each
//! neighbour pulls the sign its own way, by a weight that is learnt for its place: logistic regression, by
//! one small step down the slope after every sign. Sums, products, quotients and square roots round in the
//! same way on every machine.

use super::walk::{Walk, Weights};

/// The smallest mean size of neighbours: among zeros one alone tells little.
const LEAST: f64 = 0.3;

/// Sizes larger than this, in units of the mean, pull no more.
const MOST: f64 = 2.0;

/// How far weights follow what they got wrong. With 0.01 and 0.02 the signs of three bumps take the same to
/// 0.5 %, those of Ellis and Sol to 4 %.
const RATE: f64 = 0.015;

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
        let step = RATE * (if positive { 1.0 } else { 0.0 } - self.plus);
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
mod tests {
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
