//! Trigonometric functions and their inverses: sin, cos, tan, atan, atan2, asin, acos.
//!
//! # sin, cos and tan
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
//! # atan, atan2, asin and acos
//!
//! In: a ratio, the two sides of it, a sine or a cosine. Out: the angle in radians; below 1.5
//! ulp for atan, 4 for the others.
//!
//! Method: atan2 folds the plane into one octant, so that the ratio t of the shorter to the
//! longer side lies in [0, 1], where one polynomial serves: atan t = t + t·z·A(z), z = t². The
//! unfolding adds 0, π/2 or π, in two parts. atan is the same with sides x and 1. asin uses
//! t + t·z·S(z) for |x| ≤ ½, and beyond that asin x = π/2 − 2 asin √((1−x)/2), where 1 − x is
//! exact.
//!
//! Coefficients: minimax, see the parent module.

use crate::real::{FloatFormat, fast_two_sum, polynomial, two_sum};

/// Coefficients and limits of these functions in one type.
pub trait TrigonometricCoefficients: FloatFormat {
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
    /// π/2 in two parts.
    const HALF_PI: [Self; 2];
    /// A(z) = (atan √z − √z) / z√z
    const ATAN: &'static [Self];
    /// S(z) = (asin √z − √z) / z√z
    const ASIN: &'static [Self];
}

impl TrigonometricCoefficients for f64 {
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
    const HALF_PI: [f64; 2] = [std::f64::consts::FRAC_PI_2, 6.123233995736766e-17];
    /// 2^-58.6
    const ATAN: &'static [f64] = &[
        -0.33333333333333326,
        0.19999999999998289,
        -0.14285714285580278,
        0.11111111105732902,
        -0.090909089601594,
        0.07692305574220945,
        -0.06666642349756229,
        0.05882146447346286,
        -0.05261819923609345,
        0.047551332199052165,
        -0.04320568268404162,
        0.039114617895026495,
        -0.034688244545629104,
        0.029338164814581656,
        -0.022851544759019744,
        0.015759912926436772,
        -0.009235751895676096,
        0.004401721094801897,
        -0.0016201039547369051,
        0.00042870199589604394,
        -7.219176714141827e-05,
        5.789329299723874e-06,
    ];
    /// 2^-58.7
    const ASIN: &'static [f64] = &[
        0.16666666666666763,
        0.07499999999970265,
        0.04464285717511822,
        0.030381942683729644,
        0.022372215657379013,
        0.017351600140758185,
        0.013980960902298178,
        0.011397780211708952,
        0.010786506696908128,
        0.00368312215565838,
        0.021763312706596764,
        -0.021077038145853887,
        0.03267673553136307,
    ];
}

impl TrigonometricCoefficients for f32 {
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
    const HALF_PI: [f32; 2] = [std::f32::consts::FRAC_PI_2, -4.371_139e-8];
    /// 2^-27.5
    const ATAN: &'static [f32] = &[
        -0.33333302,
        0.19998638,
        -0.14265247,
        0.109575815,
        -0.084194794,
        0.058234964,
        -0.031456158,
        0.011064707,
        -0.0018272762,
    ];
    /// 2^-27.5
    const ASIN: &'static [f32] = &[0.16666754, 0.07495243, 0.045476947, 0.024148313, 0.04221739];
}

/// q, sin y and cos y, where x = q·π/2 + y.
#[inline(always)]
fn reduce<F: TrigonometricCoefficients>(x: F) -> (F, F, F) {
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
    (q, sin_of_sum(y, y_low), cos_of_sum(y, y_low))
}

/// sin(y + low) for |y| ≤ π/4.
#[inline(always)]
fn sin_of_sum<F: TrigonometricCoefficients>(y: F, low: F) -> F {
    let z = y * y;
    y + (y * z * polynomial(z, F::SIN) + (low - F::HALF * z * low))
}

/// cos(y + low) for |y| ≤ π/4.
#[inline(always)]
fn cos_of_sum<F: TrigonometricCoefficients>(y: F, low: F) -> F {
    let z = y * y;
    let half = F::HALF * z;
    let start = F::ONE - half;
    let start_lost = (F::ONE - start) - half;
    start + (start_lost + (z * z * polynomial(z, F::COS) - y * low))
}

/// sin(q·π/2 + y)
#[inline(always)]
fn sin_in_quadrant<F: FloatFormat>(q: F, sin_y: F, cos_y: F) -> F {
    let (odd, negative) = q.low_bits();
    let value = F::select(odd, cos_y, sin_y);
    F::select(negative, -value, value)
}

/// Sine.
#[inline(always)]
pub fn sin<F: TrigonometricCoefficients>(x: F) -> F {
    let (q, sin_y, cos_y) = reduce(x);
    F::select(x == F::ZERO, x, sin_in_quadrant(q, sin_y, cos_y))
}

/// Cosine: a sine, one quadrant ahead.
#[inline(always)]
pub fn cos<F: TrigonometricCoefficients>(x: F) -> F {
    let (q, sin_y, cos_y) = reduce(x);
    sin_in_quadrant(q + F::ONE, sin_y, cos_y)
}

/// Tangent.
#[inline(always)]
pub fn tan<F: TrigonometricCoefficients>(x: F) -> F {
    let (q, sin_y, cos_y) = reduce(x);
    let (odd, _) = q.low_bits();
    let ratio = F::select(odd, -cos_y, sin_y) / F::select(odd, sin_y, cos_y);
    F::select(x == F::ZERO, x, ratio)
}

/// `quarters`·π/2 + angle + rest, for |rest| < |angle| < π/2.
#[inline(always)]
fn unfold<F: TrigonometricCoefficients>(quarters: F, angle: F, rest: F) -> F {
    let (sum, lost) = fast_two_sum(quarters * F::HALF_PI[0], angle);
    sum + (lost + (rest + quarters * F::HALF_PI[1]))
}

/// `quarters`·π/2 ± atan t, for 0 ≤ t ≤ 1.
#[inline(always)]
fn unfold_atan<F: TrigonometricCoefficients>(quarters: F, minus: bool, t: F) -> F {
    let z = t * t;
    let t = F::select(minus, -t, t);
    unfold(quarters, t, t * z * polynomial(z, F::ATAN))
}

/// Inverse tangent.
#[inline(always)]
pub fn atan<F: TrigonometricCoefficients>(x: F) -> F {
    let a = x.abs();
    let steep = a > F::ONE;
    let ratio = F::select(steep, F::ONE, a) / F::select(steep, a, F::ONE);
    unfold_atan(F::select(steep, F::ONE, F::ZERO), steep, ratio).with_sign_of(x)
}

/// Angle of the point (x, y).
#[inline(always)]
pub fn atan2<F: TrigonometricCoefficients>(y: F, x: F) -> F {
    // Fold into the octant between the x axis and the diagonal. Of two zeros or two infinities
    // IEEE 754 makes a point on the axis or on the diagonal.
    let (width, height) = (x.abs(), y.abs());
    let steep = height > width;
    let short = F::select(steep, width, height);
    let long = F::select(steep, height, width);
    let ratio = F::select(long == F::ZERO, short, short / long);
    let both_infinite = (short == F::INFINITY) & (long == F::INFINITY);
    let ratio = F::select(both_infinite, F::ONE, ratio);

    // Unfold: across the diagonal, across the y axis, across the x axis.
    let left = x.has_sign_bit();
    let straight = F::select(left, F::ONE + F::ONE, F::ZERO);
    let quarters = F::select(steep, F::ONE, straight);
    unfold_atan(quarters, left != steep, ratio).with_sign_of(y)
}

/// t, rest and whether |x| > ½: where it is not, t + rest = asin |x|; where it is, acos |x|.
#[inline(always)]
fn reduce_sine<F: TrigonometricCoefficients>(x: F) -> (F, F, bool) {
    let a = x.abs();
    let outer = a > F::HALF;
    let half_distance = (F::ONE - a) * F::HALF;
    let z = F::select(outer, half_distance, a * a);
    let root = half_distance.sqrt();
    let t = F::select(outer, root + root, a);
    (t, t * z * polynomial(z, F::ASIN), outer)
}

/// Inverse sine.
#[inline(always)]
pub fn asin<F: TrigonometricCoefficients>(x: F) -> F {
    let (t, rest, outer) = reduce_sine(x);
    let quarters = F::select(outer, F::ONE, F::ZERO);
    let sign = F::select(outer, -F::ONE, F::ONE);
    unfold(quarters, sign * t, sign * rest).with_sign_of(x)
}

/// Inverse cosine.
#[inline(always)]
pub fn acos<F: TrigonometricCoefficients>(x: F) -> F {
    let (t, rest, outer) = reduce_sine(x);
    let left = x.has_sign_bit();
    let end = F::select(left, F::ONE + F::ONE, F::ZERO);
    let quarters = F::select(outer, end, F::ONE);
    // π/2 − asin x inside; outside acos |x|, or π − acos |x| on the left.
    let sign = F::select(left == outer, -F::ONE, F::ONE);
    unfold(quarters, sign * t, sign * rest)
}
