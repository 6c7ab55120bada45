//! The numbers a tape runs in, and their elementary functions, written so that loops over them vectorise.
//!
//! In: one value of type `f64` (tracing, certificates) or `f32` (pictures). Out: the value of an
//! elementary function, computed in that type's own arithmetic, the same bits on every machine.
//!
//! The methods are written for plain loops over lanes: no branches, no tables, no library calls,
//! so a loop calling them inside a dispatched function becomes vector instructions. Only
//! `+ - * /`, square roots and operations on bits are used, never a fused multiply-add, which
//! would change the last bits between machines.
//!
//! Loop from a local array to a local array and store the result whole: where source and
//! destination might overlap in memory, short loops stay scalar.
//!
//! Call them through a type parameter `T: Real`. On a concrete `f64` the standard library's
//! methods of the same name win; write `Real::exp(x)` there.
//!
//! Every function is straight-line code: reduce the argument to a short interval, evaluate a
//! polynomial, undo the reduction, and repair special values with selects. The two types share
//! the algorithms and differ in their coefficients.
//!
//! The polynomials are minimax fits made with a Remez exchange in 200-bit arithmetic, rounded
//! coefficient by coefficient; the bound beside each is its error relative to the function,
//! rounded coefficients included. An ulp is 2^-52 (`f32`: 2^-23) at most.

mod exp_and_ln;
#[cfg(test)]
mod tests;
mod trigonometric;

use fearless_simd::{Simd, SimdFloat, SimdFloatElement, f32x16, f64x8};
use std::{
    fmt::Debug,
    ops::{Add, Div, Mul, Neg, Sub},
};

/// A floating-point number with elementary functions that vectorise.
///
/// NaN in gives NaN out, for every function. Errors are in units in the last place (ulp) of the
/// result, and hold near zero too: sinh, tanh, tan and their inverses keep relative accuracy.
pub trait Real:
    Copy
    + Default
    + Debug
    + PartialOrd
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + Send
    + Sync
    + SimdFloatElement
    + 'static
{
    /// 64 bytes of them.
    type Vector<S: Simd>: SimdFloat<S, Element = Self>;

    /// 0
    const ZERO: Self;
    /// 1
    const ONE: Self;
    /// Not a number: the value of a function outside its domain.
    const NAN: Self;

    /// The nearest number of this type.
    fn from_f64(x: f64) -> Self;
    /// The nearest number of this type.
    fn from_i32(x: i32) -> Self;
    /// Converts to double precision, exactly.
    fn to_f64(self) -> f64;
    /// `yes` where the mask holds, else `no`; both are computed.
    fn select(mask: bool, yes: Self, no: Self) -> Self;
    /// Neither infinite nor NaN.
    fn is_finite(self) -> bool;

    /// `self * factor + summand`, rounded once: an instruction where vectors have 256 bits, elsewhere a slow
    /// function. Tapes do without it.
    fn mul_add(self, factor: Self, summand: Self) -> Self;

    /// Absolute value.
    fn abs(self) -> Self;
    /// Square root, correctly rounded; NaN below zero.
    fn sqrt(self) -> Self;
    /// Largest integer not above `self`.
    fn floor(self) -> Self;
    /// `self` if it is less than `other`, else `other`: a NaN on either side gives `other`.
    fn min(self, other: Self) -> Self;
    /// `self` if it is greater than `other`, else `other`: a NaN on either side gives `other`.
    fn max(self, other: Self) -> Self;

    /// e^x; overflows to infinity, underflows gradually to zero.
    fn exp(self) -> Self;
    /// Natural logarithm; −∞ at zero, NaN below.
    fn ln(self) -> Self;
    /// `self` to a real power, 0^0 = 1.
    ///
    /// A negative base, −∞ included, has powers with integer exponents only, and NaN otherwise.
    /// Unlike [`f64::powf`], a NaN base or exponent always gives NaN.
    fn pow(self, exponent: Self) -> Self;

    /// Sine; for large arguments see [`Real::tan`].
    fn sin(self) -> Self;
    /// Cosine; for large arguments see [`Real::tan`].
    fn cos(self) -> Self;
    /// Tangent.
    ///
    /// Sine, cosine and tangent are accurate up to |x| = 1e6 (`f32`: 1e4). Beyond, they are
    /// those of an argument about an ulp away, and beyond 2^50 (`f32`: 2^21) they are NaN.
    fn tan(self) -> Self;
    /// Inverse sine in [−π/2, π/2]; NaN outside [−1, 1].
    fn asin(self) -> Self;
    /// Inverse cosine in [0, π]; NaN outside [−1, 1].
    fn acos(self) -> Self;
    /// Inverse tangent in [−π/2, π/2].
    fn atan(self) -> Self;
    /// Angle in [−π, π] of the point (`x`, `self`), on the axes and for signed zeros as IEEE 754.
    fn atan2(self, x: Self) -> Self;

    /// Hyperbolic sine.
    fn sinh(self) -> Self;
    /// Hyperbolic cosine.
    fn cosh(self) -> Self;
    /// Hyperbolic tangent.
    fn tanh(self) -> Self;
    /// Inverse hyperbolic sine.
    fn asinh(self) -> Self;
    /// Inverse hyperbolic cosine, not negative; NaN below 1.
    fn acosh(self) -> Self;
    /// Inverse hyperbolic tangent; ±∞ at ±1, NaN outside.
    fn atanh(self) -> Self;
}

macro_rules! implement_real {
    ($float:ident, $vector:ident, from_f64: $from_f64:expr, to_f64: $to_f64:expr, functions: $($file:ident { $($function:ident)* })*) => {
        impl Real for $float {
            type Vector<S: Simd> = $vector<S>;

            const ZERO: Self = 0.0;
            const ONE: Self = 1.0;
            const NAN: Self = $float::NAN;

            #[inline(always)]
            fn from_f64(x: f64) -> Self {
                $from_f64(x)
            }
            #[inline(always)]
            fn from_i32(x: i32) -> Self {
                x as Self
            }
            #[inline(always)]
            fn to_f64(self) -> f64 {
                $to_f64(self)
            }
            #[inline(always)]
            fn select(mask: bool, yes: Self, no: Self) -> Self {
                if mask { yes } else { no }
            }
            #[inline(always)]
            fn is_finite(self) -> bool {
                $float::is_finite(self)
            }
            #[inline(always)]
            fn mul_add(self, factor: Self, summand: Self) -> Self {
                $float::mul_add(self, factor, summand)
            }
            #[inline(always)]
            fn abs(self) -> Self {
                $float::abs(self)
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                $float::sqrt(self)
            }
            #[inline(always)]
            fn floor(self) -> Self {
                $float::floor(self)
            }
            #[inline(always)]
            fn min(self, other: Self) -> Self {
                if self < other { self } else { other }
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                if self > other { self } else { other }
            }
            #[inline(always)]
            fn pow(self, exponent: Self) -> Self {
                exp_and_ln::pow(self, exponent)
            }
            #[inline(always)]
            fn atan2(self, x: Self) -> Self {
                trigonometric::atan2(self, x)
            }
            $($(
                #[inline(always)]
                fn $function(self) -> Self {
                    $file::$function(self)
                }
            )*)*
        }
    };
    ($float:ident, $vector:ident, from_f64: $from_f64:expr, to_f64: $to_f64:expr) => {
        implement_real! {
            $float, $vector, from_f64: $from_f64, to_f64: $to_f64, functions:
            exp_and_ln { exp sinh cosh tanh ln asinh acosh atanh }
            trigonometric { sin cos tan asin acos atan }
        }
    };
}

implement_real!(f64, f64x8, from_f64: std::convert::identity, to_f64: std::convert::identity);
implement_real!(f32, f32x16, from_f64: |x| x as f32, to_f64: f64::from);

/// The layout of a binary floating-point type, and the operations on its bits.
trait FloatFormat: Real {
    /// Positive infinity.
    const INFINITY: Self;
    /// 1/2
    const HALF: Self;
    /// Largest n for which both 2^n and 2^-n are normal.
    const EXPONENT_LIMIT: Self;
    /// Leading part of ln 2, short enough that its product with any exponent is exact.
    const LN_2_HIGH: Self;
    /// ln 2 − `LN_2_HIGH`
    const LN_2_LOW: Self;

    /// Nearest integer, for |x| below a quarter of the largest mantissa.
    fn nearest(self) -> Self;
    /// Bits 0 and 1 of an integer in the range of [`FloatFormat::nearest`], in two's complement.
    fn low_bits(self) -> (bool, bool);
    /// 2^self for an integer within the normal exponents; 0 one below them.
    fn pow2(self) -> Self;
    /// (k, m) with x = 2^k·m and m in [√½, √2), for positive finite x; anything otherwise.
    fn split_exponent(self) -> (Self, Self);
    /// The leading half of the mantissa: products of two such heads are exact.
    fn head(self) -> Self;
    /// Magnitude of `self` with the sign of `sign`.
    fn with_sign_of(self, sign: Self) -> Self;
    /// Returns whether the sign bit is set, as in −0.
    fn has_sign_bit(self) -> bool;
}

macro_rules! implement_format {
    ($float:ident, $bits:ident, half_root_bits: $half_root:expr, ln_2: $ln_2:expr) => {
        impl FloatFormat for $float {
            const INFINITY: Self = $float::INFINITY;
            const HALF: Self = 0.5;
            const EXPONENT_LIMIT: Self = ($float::MAX_EXP - 2) as $float;
            const LN_2_HIGH: Self = $ln_2[0];
            const LN_2_LOW: Self = $ln_2[1];

            #[inline(always)]
            fn nearest(self) -> Self {
                (self + layout::$float::INTEGER) - layout::$float::INTEGER
            }

            #[inline(always)]
            fn low_bits(self) -> (bool, bool) {
                let bits = (self + layout::$float::INTEGER).to_bits();
                (bits & 1 != 0, bits & 2 != 0)
            }

            #[inline(always)]
            fn pow2(self) -> Self {
                let bits = (self + layout::$float::INTEGER).to_bits();
                $float::from_bits(
                    bits.wrapping_add(layout::$float::BIAS) << layout::$float::FRACTION_BITS,
                )
            }

            #[inline(always)]
            fn split_exponent(self) -> (Self, Self) {
                use layout::$float::{BIAS, FRACTION_BITS};
                const HALF_ROOT: $bits = $half_root;
                const LIFT: $float = ((1 as $bits) << (FRACTION_BITS + 1)) as $float;
                const WHOLE: $bits = (BIAS + FRACTION_BITS) << FRACTION_BITS;

                // Subnormal numbers are lifted into the normal range first.
                let subnormal = self < $float::MIN_POSITIVE;
                let lifted = Self::select(subnormal, self * LIFT, self);
                let shift = Self::select(subnormal, (FRACTION_BITS + 1) as $float, 0.0);

                // Counting from √½ instead of ½ moves the exponent's steps to √2·2^k.
                let bits = lifted
                    .to_bits()
                    .wrapping_add((BIAS << FRACTION_BITS) - HALF_ROOT);
                let biased = $float::from_bits(WHOLE | (bits >> FRACTION_BITS));
                let exponent = biased - ($float::from_bits(WHOLE) + BIAS as $float) - shift;
                let fraction = bits & ((1 << FRACTION_BITS) - 1);
                (exponent, $float::from_bits(fraction + HALF_ROOT))
            }

            #[inline(always)]
            fn head(self) -> Self {
                const LOW: $bits =
                    (1 << ($float::MANTISSA_DIGITS / 2 + $float::MANTISSA_DIGITS % 2)) - 1;
                $float::from_bits(self.to_bits() & !LOW)
            }

            #[inline(always)]
            fn with_sign_of(self, sign: Self) -> Self {
                $float::copysign(self, sign)
            }

            #[inline(always)]
            fn has_sign_bit(self) -> bool {
                $float::is_sign_negative(self)
            }
        }
    };
}

implement_format!(f64, u64, half_root_bits: 0x3fe6_a09e_0000_0000, ln_2: [0.693_147_180_369_123_8, 1.908_214_929_270_587_7e-10]);
implement_format!(f32, u32, half_root_bits: 0x3f35_04f3, ln_2: [0.693_145_75, 1.428_606_8e-6]);

/// Where the exponent and the fraction lie in each type.
mod layout {
    pub mod f64 {
        pub const FRACTION_BITS: u64 = 52;
        pub const BIAS: u64 = 1023;
        /// 1.5·2^52: added to a small number, it leaves its nearest integer in the low bits.
        pub const INTEGER: f64 = 6_755_399_441_055_744.0;
    }
    pub mod f32 {
        pub const FRACTION_BITS: u32 = 23;
        pub const BIAS: u32 = 127;
        /// 1.5·2^23: added to a small number, it leaves its nearest integer in the low bits.
        pub const INTEGER: f32 = 12_582_912.0;
    }
}

/// Σ cᵢ zⁱ: low and high powers apart, two short chains instead of a long one.
///
/// The split is at the power of two next to half the length; at least two coefficients are
/// needed. All loops have constant lengths and unroll.
#[inline(always)]
fn polynomial<F: FloatFormat>(z: F, coefficients: &[F]) -> F {
    let squarings = (coefficients.len() * 2 / 3).ilog2();
    let (low, high) = coefficients.split_at(1 << squarings);
    let mut power = z;
    for _ in 0..squarings {
        power = power * power;
    }
    horner(z, low) + power * horner(z, high)
}

#[inline(always)]
fn horner<F: FloatFormat>(z: F, coefficients: &[F]) -> F {
    let (&last, rest) = coefficients
        .split_last()
        .expect("a polynomial has coefficients");
    rest.iter().rev().fold(last, |sum, &c| c + sum * z)
}

/// (s, e) with s = a + b rounded and s + e = a + b exactly (Knuth).
#[inline(always)]
fn two_sum<F: FloatFormat>(a: F, b: F) -> (F, F) {
    let s = a + b;
    let t = s - a;
    (s, (a - (s - t)) + (b - t))
}

/// As [`two_sum`], for |a| ≥ |b| or a = 0 (Dekker).
#[inline(always)]
fn fast_two_sum<F: FloatFormat>(a: F, b: F) -> (F, F) {
    let s = a + b;
    (s, b - (s - a))
}

/// (p, e) with p = a·b rounded and p + e = a·b to twice the precision (Dekker).
#[inline(always)]
fn two_product<F: FloatFormat>(a: F, b: F) -> (F, F) {
    let p = a * b;
    let (ah, bh) = (a.head(), b.head());
    let (al, bl) = (a - ah, b - bh);
    (p, (((ah * bh - p) + ah * bl) + al * bh) + al * bl)
}
