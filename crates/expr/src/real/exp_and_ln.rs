//! Exponential functions, their inverses and powers: exp, sinh, cosh, tanh, ln, asinh, acosh, atanh, pow.
//!
//! # exp, sinh, cosh and tanh
//!
//! In: x. Out: the function's value; below 1.5 ulp for exp, 4 for the others.
//!
//! Method: x = k·ln 2 + r with |r| ≤ ½ ln 2, k·ln 2 in two parts (Cody and Waite). On r two
//! short polynomials give s = sinh r and c = cosh r − 1, both to full relative accuracy. Then
//!
//! ```text
//! e^x      = 2^k (1 + c + s)
//! 2 sinh x = 2^k ((1−w)(1+c) + (1+w) s)        w = 2^-2k
//! 2 cosh x = 2^k ((1+w)(1+c) + (1−w) s)
//! ```
//!
//! At k = 0 the first part of sinh vanishes and s alone is left: nothing cancels near zero, and
//! no separate e^x − 1 is needed.
//!
//! # ln, asinh, acosh, atanh and pow
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

use crate::real::{FloatFormat, fast_two_sum, polynomial, two_product, two_sum};

/// Coefficients and limits of these functions in one type.
pub trait ExponentialCoefficients: FloatFormat {
    /// 1/ln 2
    const LOG2_E: Self;
    /// (sinh √z − √z) / z√z
    const SINH: &'static [Self];
    /// (cosh √z − 1 − z/2) / z²
    const COSH: &'static [Self];
    /// Below this e^x rounds to zero.
    const EXP_MIN: Self;
    /// Above this e^x is infinite.
    const EXP_MAX: Self;
    /// Above this sinh x and cosh x are infinite.
    const SINH_MAX: Self;
    /// Above this tanh x rounds to one.
    const TANH_MAX: Self;
    /// L(z) = (2 atanh √z − 2√z) / z√z
    const LN: &'static [Self];
    /// Above this x² ± 1 rounds to x², and x² is still finite.
    const LARGE: Self;
}

impl ExponentialCoefficients for f64 {
    const LOG2_E: f64 = std::f64::consts::LOG2_E;
    /// 2^-60.8
    const SINH: &'static [f64] = &[
        0.16666666666666677,
        0.008333333333321577,
        0.00019841269886270043,
        2.7557244058284216e-06,
        2.510909160965834e-08,
    ];
    /// 2^-68 absolute
    const COSH: &'static [f64] = &[
        0.041666666666666685,
        0.0013888888888873411,
        2.4801587348909592e-05,
        2.755725209708518e-07,
        2.0921676928878237e-09,
    ];
    const EXP_MIN: f64 = -746.0;
    const EXP_MAX: f64 = 710.0;
    const SINH_MAX: f64 = 711.0;
    const TANH_MAX: f64 = 22.0;
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

impl ExponentialCoefficients for f32 {
    const LOG2_E: f32 = std::f32::consts::LOG2_E;
    /// 2^-26.1
    const SINH: &'static [f32] = &[0.16666543, 0.008366609];
    /// 2^-33.2 absolute
    const COSH: &'static [f32] = &[0.04166646, 0.0013935437];
    const EXP_MIN: f32 = -104.0;
    const EXP_MAX: f32 = 89.0;
    const SINH_MAX: f32 = 90.0;
    const TANH_MAX: f32 = 10.0;
    /// 2^-31.1
    const LN: &'static [f32] = &[0.6666666, 0.40000337, 0.28537238, 0.23583563];
    const LARGE: f32 = 16_384.0;
}

/// k, sinh r and cosh r − 1, where x + tail = k·ln 2 + r.
#[inline(always)]
fn reduce<F: ExponentialCoefficients>(x: F, tail: F) -> (F, F, F) {
    let exponent = (x * F::LOG2_E).nearest();
    let r = (x - exponent * F::LN_2_HIGH) - (exponent * F::LN_2_LOW - tail);
    let z = r * r;
    let sinh = r + r * z * polynomial(z, F::SINH);
    let cosh_less_one = z * (F::HALF + z * polynomial(z, F::COSH));
    (exponent, sinh, cosh_less_one)
}

/// x·2^k in two steps, so that 2^k may lie outside the normal range while the result does not.
#[inline(always)]
fn scale<F: FloatFormat>(x: F, k: F) -> F {
    let half = (k * F::HALF).nearest();
    x * half.pow2() * (k - half).pow2()
}

/// e^(x + tail) for a tail below an ulp of x.
#[inline(always)]
fn exp_of_sum<F: ExponentialCoefficients>(x: F, tail: F) -> F {
    // The limit comes first in min and max: a NaN passes.
    let limited = F::EXP_MAX.min(F::EXP_MIN.max(x));
    let tail = F::select(limited == x, tail, F::ZERO);
    let (k, sinh, cosh_less_one) = reduce(limited, tail);
    scale(F::ONE + (sinh + cosh_less_one), k)
}

/// e^x.
#[inline(always)]
pub fn exp<F: ExponentialCoefficients>(x: F) -> F {
    exp_of_sum(x, F::ZERO)
}

/// Hyperbolic functions of x ≥ 0, all times 2^(1−k) with x = k·ln 2 + r.
struct Hyperbolic<F> {
    /// k
    exponent: F,
    sinh: F,
    cosh: F,
    /// e^-x = cosh x − sinh x
    decay: F,
}

#[inline(always)]
fn hyperbolic<F: ExponentialCoefficients>(x: F) -> Hyperbolic<F> {
    let (exponent, sinh, cosh_less_one) = reduce(x, F::ZERO);
    let w = (-F::EXPONENT_LIMIT.min(exponent + exponent)).pow2();
    let (difference, sum) = (F::ONE - w, F::ONE + w);
    Hyperbolic {
        exponent,
        sinh: difference + (difference * cosh_less_one + sum * sinh),
        cosh: sum + (sum * cosh_less_one + difference * sinh),
        decay: (w + w) * (F::ONE + (cosh_less_one - sinh)),
    }
}

/// Hyperbolic sine.
#[inline(always)]
pub fn sinh<F: ExponentialCoefficients>(x: F) -> F {
    let h = hyperbolic(F::SINH_MAX.min(x.abs()));
    scale(h.sinh, h.exponent - F::ONE).with_sign_of(x)
}

/// Hyperbolic cosine.
#[inline(always)]
pub fn cosh<F: ExponentialCoefficients>(x: F) -> F {
    let h = hyperbolic(F::SINH_MAX.min(x.abs()));
    scale(h.cosh, h.exponent - F::ONE)
}

/// Hyperbolic tangent: sinh x / cosh x, or 1 − e^-x / cosh x where that is close to one.
#[inline(always)]
pub fn tanh<F: ExponentialCoefficients>(x: F) -> F {
    let h = hyperbolic(F::TANH_MAX.min(x.abs()));
    let near_one = h.exponent > F::ONE;
    let ratio = F::select(near_one, -h.decay, h.sinh) / h.cosh;
    (F::select(near_one, F::ONE, F::ZERO) + ratio).with_sign_of(x)
}

/// k·ln 2 + ln(1 + f)
#[inline(always)]
fn ln_of_parts<F: ExponentialCoefficients>(k: F, f: F) -> F {
    let s = f / (F::ONE + F::ONE + f);
    let z = s * s;
    let half_square = F::HALF * f * f;
    let rest = s * (half_square + z * polynomial(z, F::LN)) + k * F::LN_2_LOW;
    k * F::LN_2_HIGH - ((half_square - rest) - f)
}

/// The logarithm of `x`, given what it is where x is positive and finite.
#[inline(always)]
fn complete_ln<F: FloatFormat>(x: F, inside: F) -> F {
    let finite = F::select(x == F::INFINITY, x, inside);
    let outside = F::select(x == F::ZERO, -F::INFINITY, F::NAN);
    F::select(x > F::ZERO, finite, outside)
}

/// Natural logarithm.
#[inline(always)]
pub fn ln<F: ExponentialCoefficients>(x: F) -> F {
    let (k, m) = x.split_exponent();
    complete_ln(x, ln_of_parts(k, m - F::ONE))
}

/// ln(1 + y), for y near zero and everywhere else.
#[inline(always)]
fn ln_1p<F: ExponentialCoefficients>(y: F) -> F {
    let (x, lost) = two_sum(F::ONE, y);
    let (k, m) = x.split_exponent();
    let scale = (-F::EXPONENT_LIMIT.min(k)).pow2();
    complete_ln(x, ln_of_parts(k, (m - F::ONE) + lost * scale))
}

/// ln(1 + y), or ln(2x) where x is large: there 1 + (x − 1) stands for x.
#[inline(always)]
fn ln_1p_or_double<F: ExponentialCoefficients>(x: F, y: F) -> F {
    let large = x > F::LARGE;
    let ln_2 = F::LN_2_HIGH + F::LN_2_LOW;
    ln_1p(F::select(large, x - F::ONE, y)) + F::select(large, ln_2, F::ZERO)
}

/// Inverse hyperbolic sine: ln(1 + x + x²/(1 + √(x²+1))).
#[inline(always)]
pub fn asinh<F: ExponentialCoefficients>(x: F) -> F {
    let a = x.abs();
    let square = a * a;
    let y = a + square / (F::ONE + (square + F::ONE).sqrt());
    ln_1p_or_double(a, y).with_sign_of(x)
}

/// Inverse hyperbolic cosine: ln(1 + t + √(t² + 2t)), t = x − 1.
#[inline(always)]
pub fn acosh<F: ExponentialCoefficients>(x: F) -> F {
    let t = x - F::ONE;
    let y = t + (t * (x + F::ONE)).sqrt();
    F::select(x < F::ONE, F::NAN, ln_1p_or_double(x, y))
}

/// Inverse hyperbolic tangent: ½ ln(1 + 2x/(1−x)).
#[inline(always)]
pub fn atanh<F: ExponentialCoefficients>(x: F) -> F {
    let a = x.abs();
    (F::HALF * ln_1p((a + a) / (F::ONE - a))).with_sign_of(x)
}

/// (h, l): h + l is the logarithm of a positive finite x, to about eight bits more than h alone.
#[inline(always)]
fn ln_in_two_parts<F: ExponentialCoefficients>(x: F) -> (F, F) {
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
pub fn pow<F: ExponentialCoefficients>(base: F, exponent: F) -> F {
    // Magnitude. An exponent of ±2^64 already over- or underflows every base but 1.
    let limit = F::from_f64(18_446_744_073_709_551_616.0);
    let limited = limit.min((-limit).max(exponent));
    let a = base.abs();
    let (high, low) = ln_in_two_parts(a);
    let (product, product_low) = two_product(limited, high);
    let inside = exp_of_sum(product, product_low + limited * low);

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
fn is_nan<F: FloatFormat>(x: F) -> bool {
    x.partial_cmp(&x).is_none()
}
