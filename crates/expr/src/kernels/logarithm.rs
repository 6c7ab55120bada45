//! ln, asinh, acosh, atanh and pow.
//!
//! In: x, for pow also an exponent. Out: the function's value; below 1.5 ulp for ln, 4 for the
//! others. For pow that holds while |exponent·ln base| < 50, and the error grows to about 15
//! ulp towards overflow.
//!
//! Method: x = 2^k·m with m in [√½, √2); f = m − 1 and s = f/(2+f), so that
//!
//! ```text
//! ln m = 2 atanh s = 2s + s·z·L(z) = f − (f²/2 − s·(f²/2 + z·L(z)))        z = s²
//! ```
//!
//! where the last form leaves the exact f in front (fdlibm, e_log.c). For ln(1 + y) the part of
//! y lost in rounding 1 + y is put back into f; all inverse hyperbolic functions are logarithms
//! of that kind, accurate near zero. For pow the logarithm is carried in two parts: 2s with its
//! remainder, k·ln 2 in two parts, and the rest, which is small, in one.
//!
//! Coefficients: minimax, see the parent module.

use super::{Format, exponential, fast_two_sum, polynomial, two_product, two_sum};

/// Coefficients and limits of the logarithms in one type.
pub trait Coefficients: exponential::Coefficients {
    /// L(z) = (2 atanh √z − 2√z) / z√z
    const LN: &'static [Self];
    /// Above this x² ± 1 rounds to x², and x² is still finite.
    const LARGE: Self;
}

impl Coefficients for f64 {
    /// 2^-61.6
    const LN: &'static [f64] = &[
        0.6666666666666666,
        0.40000000000006286,
        0.28571428569072876,
        0.22222222648759474,
        0.18181775508059658,
        0.15387097663597613,
        0.13249961854714853,
        0.132527556790363,
    ];
    const LARGE: f64 = 268_435_456.0;
}

impl Coefficients for f32 {
    /// 2^-31.1
    const LN: &'static [f32] = &[0.6666666, 0.40000337, 0.28537238, 0.23583563];
    const LARGE: f32 = 16_384.0;
}

/// k·ln 2 + ln(1 + f)
#[inline(always)]
fn ln_of_parts<F: Coefficients>(k: F, f: F) -> F {
    let s = f / (F::ONE + F::ONE + f);
    let z = s * s;
    let half_square = F::HALF * f * f;
    let rest = s * (half_square + z * polynomial(z, F::LN)) + k * F::LN_2_LOW;
    k * F::LN_2_HIGH - ((half_square - rest) - f)
}

/// The logarithm of `x`, given what it is where x is positive and finite.
#[inline(always)]
fn complete_ln<F: Format>(x: F, inside: F) -> F {
    let finite = F::select(x == F::INFINITY, x, inside);
    let outside = F::select(x == F::ZERO, -F::INFINITY, F::NAN);
    F::select(x > F::ZERO, finite, outside)
}

/// Natural logarithm.
#[inline(always)]
pub fn ln<F: Coefficients>(x: F) -> F {
    let (k, m) = x.split_exponent();
    complete_ln(x, ln_of_parts(k, m - F::ONE))
}

/// ln(1 + y), for y near zero and everywhere else.
#[inline(always)]
fn ln_1p<F: Coefficients>(y: F) -> F {
    let (x, lost) = two_sum(F::ONE, y);
    let (k, m) = x.split_exponent();
    let scale = (-F::EXPONENT_LIMIT.min(k)).pow2();
    complete_ln(x, ln_of_parts(k, (m - F::ONE) + lost * scale))
}

/// ln(1 + y), or ln(2x) where x is large: there 1 + (x − 1) stands for x.
#[inline(always)]
fn ln_1p_or_double<F: Coefficients>(x: F, y: F) -> F {
    let large = x > F::LARGE;
    let ln_2 = F::LN_2_HIGH + F::LN_2_LOW;
    ln_1p(F::select(large, x - F::ONE, y)) + F::select(large, ln_2, F::ZERO)
}

/// Inverse hyperbolic sine: ln(1 + x + x²/(1 + √(x²+1))).
#[inline(always)]
pub fn asinh<F: Coefficients>(x: F) -> F {
    let a = x.abs();
    let square = a * a;
    let y = a + square / (F::ONE + (square + F::ONE).sqrt());
    ln_1p_or_double(a, y).with_sign_of(x)
}

/// Inverse hyperbolic cosine: ln(1 + t + √(t² + 2t)), t = x − 1.
#[inline(always)]
pub fn acosh<F: Coefficients>(x: F) -> F {
    let t = x - F::ONE;
    let y = t + (t * (x + F::ONE)).sqrt();
    F::select(x < F::ONE, F::NAN, ln_1p_or_double(x, y))
}

/// Inverse hyperbolic tangent: ½ ln(1 + 2x/(1−x)).
#[inline(always)]
pub fn atanh<F: Coefficients>(x: F) -> F {
    let a = x.abs();
    (F::HALF * ln_1p((a + a) / (F::ONE - a))).with_sign_of(x)
}

/// (h, l): h + l is the logarithm of a positive finite x, to about eight bits more than h alone.
#[inline(always)]
fn ln_in_two_parts<F: Coefficients>(x: F) -> (F, F) {
    let (k, m) = x.split_exponent();
    let f = m - F::ONE;

    // s = f/(2+f) with its remainder.
    let (d, d_low) = fast_two_sum(F::ONE + F::ONE, f);
    let inverse = F::ONE / d;
    let s = f * inverse;
    let (product, product_low) = two_product(s, d);
    let s_low = (((f - product) - product_low) - s * d_low) * inverse;

    // The derivative of 2 atanh s is 2/(1−z), close enough to 2 + 2z for the remainder.
    let z = s * s;
    let rest = s * z * polynomial(z, F::LN) + (s_low + s_low) * (F::ONE + z);
    let (high, low) = two_sum(k * F::LN_2_HIGH, s + s);
    fast_two_sum(high, low + (k * F::LN_2_LOW + rest))
}

/// `base` to the power `exponent`.
#[inline(always)]
pub fn pow<F: Coefficients>(base: F, exponent: F) -> F {
    // Magnitude. An exponent of ±2^64 already over- or underflows every base but 1.
    let limit = F::from_f64(18_446_744_073_709_551_616.0);
    let limited = limit.min((-limit).max(exponent));
    let a = base.abs();
    let (high, low) = ln_in_two_parts(a);
    let (product, product_low) = two_product(limited, high);
    let inside = exponential::exp_of_sum(product, product_low + limited * low);

    // Bases 0 and ∞.
    let vanishes = (a == F::ZERO) == (exponent > F::ZERO);
    let at_end = F::select(vanishes, F::ZERO, F::INFINITY);
    let is_end = (a == F::ZERO) | (a == F::INFINITY);
    let magnitude = F::select(is_end, at_end, inside);

    // Sign, and the powers that do not exist.
    let half = exponent * F::HALF;
    let is_integer = exponent.floor() == exponent;
    let is_odd = is_integer & (half.floor() != half);
    let value = F::select(base.has_sign_bit() & is_odd, -magnitude, magnitude);
    let value = F::select(exponent == F::ZERO, F::ONE, value);
    let undefined = ((base < F::ZERO) & !is_integer) | is_nan(base) | is_nan(exponent);
    F::select(undefined, F::NAN, value)
}

#[inline(always)]
fn is_nan<F: Format>(x: F) -> bool {
    x.partial_cmp(&x).is_none()
}
