//! Numbers of few bytes: steps, and scales of bonds.
//!
//! Both are powers of a root of two, kept as exponents of 16 bits.

/// `2^(k/N)`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Power<const N: i16>(pub(super) i16);

/// By what a column of a core is multiplied: any number near the singular value will do.
pub type Scale = Power<4>;

/// The unit that numbers are rounded to multiples of. As coarse as scales, steps would be on average
/// 9 % finer than they need to be; one step of 4 % was 2.3 % of the bytes of a patch of the floor.
pub type Step = Power<32>;

impl<const N: i16> Power<N> {
    /// The nearest to `x`, clamped to the range of 16 bits.
    pub fn near(x: f64) -> Self {
        Self((f64::from(N) * x.log2()).round() as i16)
    }

    /// The number.
    pub fn value(self) -> f64 {
        (f64::from(self.0) / f64::from(N)).exp2()
    }
}

impl Step {
    /// The step so many times coarser by `2^(1/32)`.
    pub fn coarser(self, times: i16) -> Self {
        Self(self.0.saturating_add(times))
    }

    /// A scale of about this size.
    pub(super) fn scale(self) -> Scale {
        Power(self.0.div_euclid(8))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_and_scales_are_near_what_they_stand_for() {
        for x in [1e-9, 3e-4, 1.0, 7.0, 1e6] {
            assert!((Step::near(x).value() / x).log2().abs() <= 1.0 / 64.0 + 1e-12);
            assert!((Scale::near(x).value() / x).log2().abs() <= 1.0 / 8.0 + 1e-12);
            assert!((Step::near(x).scale().value() / x).log2().abs() <= 0.3);
            assert!(
                (Step::near(x).coarser(32).value() / Step::near(x).value() - 2.0).abs() < 1e-12
            );
        }
    }
}
