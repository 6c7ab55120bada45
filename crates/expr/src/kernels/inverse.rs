//! atan, atan2, asin and acos.
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

use super::{Format, fast_two_sum, polynomial};

/// Coefficients of the inverse trigonometric functions in one type.
pub trait Coefficients: Format {
    /// π/2 in two parts.
    const HALF_PI: [Self; 2];
    /// A(z) = (atan √z − √z) / z√z
    const ATAN: &'static [Self];
    /// S(z) = (asin √z − √z) / z√z
    const ASIN: &'static [Self];
}

impl Coefficients for f64 {
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

impl Coefficients for f32 {
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

/// `quarters`·π/2 + angle + rest, for |rest| < |angle| < π/2.
#[inline(always)]
fn unfold<F: Coefficients>(quarters: F, angle: F, rest: F) -> F {
    let (sum, lost) = fast_two_sum(quarters * F::HALF_PI[0], angle);
    sum + (lost + (rest + quarters * F::HALF_PI[1]))
}

/// `quarters`·π/2 ± atan t, for 0 ≤ t ≤ 1.
#[inline(always)]
fn unfold_atan<F: Coefficients>(quarters: F, minus: bool, t: F) -> F {
    let z = t * t;
    let t = F::select(minus, -t, t);
    unfold(quarters, t, t * z * polynomial(z, F::ATAN))
}

/// Inverse tangent.
#[inline(always)]
pub fn atan<F: Coefficients>(x: F) -> F {
    let a = x.abs();
    let steep = a > F::ONE;
    let ratio = F::select(steep, F::ONE, a) / F::select(steep, a, F::ONE);
    unfold_atan(F::select(steep, F::ONE, F::ZERO), steep, ratio).with_sign_of(x)
}

/// Angle of the point (x, y).
#[inline(always)]
pub fn atan2<F: Coefficients>(y: F, x: F) -> F {
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

/// Where |x| ≤ ½, t + rest = asin |x|; beyond, where `outer` holds, acos |x|.
struct Sine<F> {
    t: F,
    rest: F,
    outer: bool,
}

#[inline(always)]
fn reduce_sine<F: Coefficients>(x: F) -> Sine<F> {
    let a = x.abs();
    let outer = a > F::HALF;
    let half_distance = (F::ONE - a) * F::HALF;
    let z = F::select(outer, half_distance, a * a);
    let root = half_distance.sqrt();
    let t = F::select(outer, root + root, a);
    Sine {
        t,
        rest: t * z * polynomial(z, F::ASIN),
        outer,
    }
}

/// Inverse sine.
#[inline(always)]
pub fn asin<F: Coefficients>(x: F) -> F {
    let s = reduce_sine(x);
    let quarters = F::select(s.outer, F::ONE, F::ZERO);
    let sign = F::select(s.outer, -F::ONE, F::ONE);
    unfold(quarters, sign * s.t, sign * s.rest).with_sign_of(x)
}

/// Inverse cosine.
#[inline(always)]
pub fn acos<F: Coefficients>(x: F) -> F {
    let s = reduce_sine(x);
    let left = x.has_sign_bit();
    let end = F::select(left, F::ONE + F::ONE, F::ZERO);
    let quarters = F::select(s.outer, end, F::ONE);
    // π/2 − asin x inside; outside acos |x|, or π − acos |x| on the left.
    let sign = F::select(left == s.outer, -F::ONE, F::ONE);
    unfold(quarters, sign * s.t, sign * s.rest)
}
