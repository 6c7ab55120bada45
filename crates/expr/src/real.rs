//! The numbers a tape runs in.
//!
//! In: one value of type `f64` (tracing, certificates) or `f32` (pictures). Out: the value of an
//! elementary function, the same bits on every machine.
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

use fearless_simd::{Simd, SimdFloat, SimdFloatElement, f32x16, f64x8};
use std::fmt::Debug;
use std::ops::{Add, Div, Mul, Neg, Sub};

use super::kernels::{exponential, trigonometric};

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
    ($float:ident, $vector:ident, from_f64: $from_f64:expr, to_f64: $to_f64:expr, kernels: $($file:ident { $($function:ident)* })*) => {
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
                exponential::pow(self, exponent)
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
            $float, $vector, from_f64: $from_f64, to_f64: $to_f64, kernels:
            exponential { exp sinh cosh tanh ln asinh acosh atanh }
            trigonometric { sin cos tan asin acos atan }
        }
    };
}

implement_real!(f64, f64x8, from_f64: std::convert::identity, to_f64: std::convert::identity);
implement_real!(f32, f32x16, from_f64: |x| x as f32, to_f64: f64::from);
