//! sin, cos and tan.
//!
//! In: x in radians. Out: the function's value; below 1.5 ulp for sin and cos, 4 for tan, while
//! |x| ≤ 1e6 (`f32`: 1e4).
//!
//! Method: x = q·π/2 + y with |y| ≤ π/4 (Cody and Waite). π/2 is the sum of several parts, all
//! but the last so short that their products with q are exact for q < 2^20 (`f32`: 2^13); the
//! rounding errors of the subtractions are kept, so y is known in two parts even where x is the
//! closest number to a multiple of π/2. Polynomials give sin y and cos y; q mod 4 chooses.
//!
//! Beyond that range the products round, and the result is that of an argument about an ulp of
//! x away. Beyond 2^50 (`f32`: 2^21) q itself is lost: NaN, as for infinities.
//!
//! Coefficients: minimax, see the parent module.

use super::{Format, polynomial, two_sum};

/// Coefficients and limits of the trigonometric functions in one type.
pub trait Coefficients: Format {
    /// 2/π
    const TWO_OVER_PI: Self;
    /// Parts of π/2, all but the last short.
    const HALF_PI_PARTS: &'static [Self];
    /// (sin √z − √z) / z√z
    const SIN: &'static [Self];
    /// (cos √z − 1 + z/2) / z²
    const COS: &'static [Self];
    /// Above this the nearest multiple of π/2 is not known.
    const REDUCIBLE: Self;
}

impl Coefficients for f64 {
    const TWO_OVER_PI: f64 = std::f64::consts::FRAC_2_PI;
    /// Three times 33 bits, then 53.
    const HALF_PI_PARTS: &'static [f64] = &[
        1.5707963267341256,
        6.077100506303966e-11,
        2.0222662487111665e-21,
        8.4784276603689e-32,
    ];
    /// 2^-56.9
    const SIN: &'static [f64] = &[
        -0.16666666666666632,
        0.008333333333322372,
        -0.0001984126982977196,
        2.7557313678953364e-06,
        -2.505075600667671e-08,
        1.5896669097886218e-10,
    ];
    /// 2^-59.2
    const COS: &'static [f64] = &[
        0.0416666666666666,
        -0.0013888888888874066,
        2.4801587289444637e-05,
        -2.7557314340986065e-07,
        2.0875721667260407e-09,
        -1.1359561545059963e-11,
    ];
    const REDUCIBLE: f64 = 1_125_899_906_842_624.0;
}

impl Coefficients for f32 {
    const TWO_OVER_PI: f32 = std::f32::consts::FRAC_2_PI;
    /// Four times 11 bits, then 24.
    const HALF_PI_PARTS: &'static [f32] = &[
        1.5703125,
        0.0004837513,
        7.5495336e-08,
        2.563283e-12,
        6.123234e-17,
    ];
    /// 2^-27.3
    const SIN: &'static [f32] = &[-0.16666655, 0.008332176, -0.0001951698];
    /// 2^-30.5
    const COS: &'static [f32] = &[0.041666646, -0.0013887364, 2.4438119e-05];
    const REDUCIBLE: f32 = 2_097_152.0;
}

/// x = q·π/2 + y.
struct Reduced<F> {
    q: F,
    sin_y: F,
    cos_y: F,
}

#[inline(always)]
fn reduce<F: Coefficients>(x: F) -> Reduced<F> {
    let x = F::select(x.abs() <= F::REDUCIBLE, x, F::NAN);
    let q = (x * F::TWO_OVER_PI).nearest();
    let (short, last) = F::HALF_PI_PARTS.split_at(F::HALF_PI_PARTS.len() - 1);
    let (mut rest, mut low) = (x, F::ZERO);
    for &part in short {
        let (difference, lost) = two_sum(rest, -(q * part));
        (rest, low) = (difference, low + lost);
    }
    let low = low - q * last[0];
    let y = rest + low;
    let y_low = (rest - y) + low;
    Reduced {
        q,
        sin_y: sin_of_sum(y, y_low),
        cos_y: cos_of_sum(y, y_low),
    }
}

/// sin(y + low) for |y| ≤ π/4.
#[inline(always)]
fn sin_of_sum<F: Coefficients>(y: F, low: F) -> F {
    let z = y * y;
    y + (y * z * polynomial(z, F::SIN) + (low - F::HALF * z * low))
}

/// cos(y + low) for |y| ≤ π/4.
#[inline(always)]
fn cos_of_sum<F: Coefficients>(y: F, low: F) -> F {
    let z = y * y;
    let half = F::HALF * z;
    let start = F::ONE - half;
    let start_lost = (F::ONE - start) - half;
    start + (start_lost + (z * z * polynomial(z, F::COS) - y * low))
}

/// sin(q·π/2 + y)
#[inline(always)]
fn sin_in_quadrant<F: Format>(q: F, sin_y: F, cos_y: F) -> F {
    let (odd, negative) = q.low_bits();
    let value = F::select(odd, cos_y, sin_y);
    F::select(negative, -value, value)
}

/// Sine.
#[inline(always)]
pub fn sin<F: Coefficients>(x: F) -> F {
    let r = reduce(x);
    F::select(x == F::ZERO, x, sin_in_quadrant(r.q, r.sin_y, r.cos_y))
}

/// Cosine: a sine, one quadrant ahead.
#[inline(always)]
pub fn cos<F: Coefficients>(x: F) -> F {
    let r = reduce(x);
    sin_in_quadrant(r.q + F::ONE, r.sin_y, r.cos_y)
}

/// Tangent.
#[inline(always)]
pub fn tan<F: Coefficients>(x: F) -> F {
    let r = reduce(x);
    let (odd, _) = r.q.low_bits();
    let ratio = F::select(odd, -r.cos_y, r.sin_y) / F::select(odd, r.sin_y, r.cos_y);
    F::select(x == F::ZERO, x, ratio)
}
