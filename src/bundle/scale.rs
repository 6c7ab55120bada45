//! Numbers of few bytes: steps, and scales of bonds.
//!
//! Both are powers of a root of two, kept as exponents of 16 bits.

/// Scales are powers of `2^(1/4)`: any number near the singular value will do.
const SCALES_PER_OCTAVE: i16 = 4;

/// Steps are powers of `2^(1/16)`: with those of scales they are on average 9 % finer than they need to
/// be.
const STEPS_PER_OCTAVE: i16 = 16;

/// By what a column of a core is multiplied, `2^(k/4)`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Scale(pub(super) i16);

impl Scale {
    /// The nearest to `x`, clamped to the range of 16 bits.
    pub fn near(x: f64) -> Self {
        Self(nearest(x, SCALES_PER_OCTAVE))
    }

    /// The number.
    pub fn value(self) -> f64 {
        power(self.0, SCALES_PER_OCTAVE)
    }
}

/// The unit that numbers are rounded to multiples of, `2^(k/16)`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Step(pub(super) i16);

impl Step {
    /// The nearest to `x`, clamped to the range of 16 bits.
    pub fn near(x: f64) -> Self {
        Self(nearest(x, STEPS_PER_OCTAVE))
    }

    /// The number.
    pub fn value(self) -> f64 {
        power(self.0, STEPS_PER_OCTAVE)
    }

    /// The step so many times coarser by `2^(1/16)`.
    pub fn coarser(self, times: i16) -> Self {
        Self(self.0.saturating_add(times))
    }

    /// A scale of about this size.
    pub(super) fn scale(self) -> Scale {
        Scale(self.0.div_euclid(STEPS_PER_OCTAVE / SCALES_PER_OCTAVE))
    }
}

fn nearest(x: f64, per_octave: i16) -> i16 {
    (f64::from(per_octave) * x.log2()).round() as i16
}

fn power(exponent: i16, per_octave: i16) -> f64 {
    (f64::from(exponent) / f64::from(per_octave)).exp2()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_and_scales_are_near_what_they_stand_for() {
        for x in [1e-9, 3e-4, 1.0, 7.0, 1e6] {
            assert!((Step::near(x).value() / x).log2().abs() <= 1.0 / 32.0 + 1e-12);
            assert!((Scale::near(x).value() / x).log2().abs() <= 1.0 / 8.0 + 1e-12);
            assert!((Step::near(x).scale().value() / x).log2().abs() <= 0.3);
            assert!(
                (Step::near(x).coarser(16).value() / Step::near(x).value() - 2.0).abs() < 1e-12
            );
        }
    }
}
