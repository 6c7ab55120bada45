//! exp, sinh, cosh and tanh.
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
//! Coefficients: minimax, see the parent module.

use super::{Format, polynomial};

/// Coefficients and limits of the exponential functions in one type.
pub trait Coefficients: Format {
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
}

impl Coefficients for f64 {
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
}

impl Coefficients for f32 {
    const LOG2_E: f32 = std::f32::consts::LOG2_E;
    /// 2^-26.1
    const SINH: &'static [f32] = &[0.16666543, 0.008366609];
    /// 2^-33.2 absolute
    const COSH: &'static [f32] = &[0.04166646, 0.0013935437];
    const EXP_MIN: f32 = -104.0;
    const EXP_MAX: f32 = 89.0;
    const SINH_MAX: f32 = 90.0;
    const TANH_MAX: f32 = 10.0;
}

/// x + tail = k·ln 2 + r.
struct Reduced<F> {
    /// k
    exponent: F,
    /// sinh r
    sinh: F,
    /// cosh r − 1
    cosh_less_one: F,
}

#[inline(always)]
fn reduce<F: Coefficients>(x: F, tail: F) -> Reduced<F> {
    let exponent = (x * F::LOG2_E).nearest();
    let r = (x - exponent * F::LN_2_HIGH) - (exponent * F::LN_2_LOW - tail);
    let z = r * r;
    Reduced {
        exponent,
        sinh: r + r * z * polynomial(z, F::SINH),
        cosh_less_one: z * (F::HALF + z * polynomial(z, F::COSH)),
    }
}

/// x·2^k in two steps, so that 2^k may lie outside the normal range while the result does not.
#[inline(always)]
fn scale<F: Format>(x: F, k: F) -> F {
    let half = (k * F::HALF).nearest();
    x * half.pow2() * (k - half).pow2()
}

/// e^(x + tail) for a tail below an ulp of x.
#[inline(always)]
pub(super) fn exp_of_sum<F: Coefficients>(x: F, tail: F) -> F {
    // The limit comes first in min and max: a NaN passes.
    let limited = F::EXP_MAX.min(F::EXP_MIN.max(x));
    let tail = F::select(limited == x, tail, F::ZERO);
    let r = reduce(limited, tail);
    scale(F::ONE + (r.sinh + r.cosh_less_one), r.exponent)
}

/// e^x.
#[inline(always)]
pub fn exp<F: Coefficients>(x: F) -> F {
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
fn hyperbolic<F: Coefficients>(x: F) -> Hyperbolic<F> {
    let r = reduce(x, F::ZERO);
    let w = (-F::EXPONENT_LIMIT.min(r.exponent + r.exponent)).pow2();
    let (difference, sum) = (F::ONE - w, F::ONE + w);
    Hyperbolic {
        exponent: r.exponent,
        sinh: difference + (difference * r.cosh_less_one + sum * r.sinh),
        cosh: sum + (sum * r.cosh_less_one + difference * r.sinh),
        decay: (w + w) * (F::ONE + (r.cosh_less_one - r.sinh)),
    }
}

/// Hyperbolic sine.
#[inline(always)]
pub fn sinh<F: Coefficients>(x: F) -> F {
    let h = hyperbolic(F::SINH_MAX.min(x.abs()));
    scale(h.sinh, h.exponent - F::ONE).with_sign_of(x)
}

/// Hyperbolic cosine.
#[inline(always)]
pub fn cosh<F: Coefficients>(x: F) -> F {
    let h = hyperbolic(F::SINH_MAX.min(x.abs()));
    scale(h.cosh, h.exponent - F::ONE)
}

/// Hyperbolic tangent: sinh x / cosh x, or 1 − e^-x / cosh x where that is close to one.
#[inline(always)]
pub fn tanh<F: Coefficients>(x: F) -> F {
    let h = hyperbolic(F::TANH_MAX.min(x.abs()));
    let near_one = h.exponent > F::ONE;
    let ratio = F::select(near_one, -h.decay, h.sinh) / h.cosh;
    (F::select(near_one, F::ONE, F::ZERO) + ratio).with_sign_of(x)
}
