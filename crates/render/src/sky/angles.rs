//! From a direction to angles.
//!
//! In: a unit vector. Out: longitude `atan2(y, x)` and latitude, radians, to about 3e-7.
//!
//! Without branches, so that a loop over directions takes vector instructions. The standard library's `atan2` would be half the cost of a look-up, for digits nobody sees.

use glam::Vec3;
use std::f32::consts::{FRAC_PI_2, PI};

/// Longitude in (−π, π], latitude in [−π/2, π/2].
#[inline(always)]
pub(super) fn longitude_latitude(d: Vec3) -> (f32, f32) {
    let across = (d.x * d.x + d.y * d.y).sqrt();
    // An arc tangent stays accurate at the poles, where an arc sine loses half its digits.
    (arc_tangent(d.y, d.x), arc_tangent(d.z, across))
}

/// `atan2(y, x)`, by the polynomial 4.4.49 of Abramowitz and Stegun on the smaller ratio.
#[inline(always)]
fn arc_tangent(y: f32, x: f32) -> f32 {
    // Coefficients of the odd powers from the third up.
    const C: [f32; 8] = [
        -0.333_331_45,
        0.199_935_51,
        -0.142_089,
        0.106_562_64,
        -0.075_289_64,
        0.042_909_614,
        -0.016_165_737,
        0.002_866_225_7,
    ];
    let (small, large) = (x.abs().min(y.abs()), x.abs().max(y.abs()));
    let ratio = small / large.max(f32::MIN_POSITIVE);
    let square = ratio * ratio;
    // In pairs and pairs of pairs: the processor works on them at once, a chain it must wait for.
    let fourth = square * square;
    let pair = |i: usize| C[i] + C[i + 1] * square;
    let low = pair(0) + pair(2) * fourth;
    let series = low + (pair(4) + pair(6) * fourth) * (fourth * fourth);
    let octant = ratio + ratio * square * series;
    let quadrant = if y.abs() > x.abs() {
        FRAC_PI_2 - octant
    } else {
        octant
    };
    let half = if x < 0.0 { PI - quadrant } else { quadrant };
    half.copysign(y)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arc_tangent_agrees_with_the_standard_library() {
        for i in -400..=400 {
            let angle = PI * i as f32 / 400.0;
            let (y, x) = angle.sin_cos();
            let (got, want) = (arc_tangent(y, x), y.atan2(x));
            assert!((got - want).abs() < 5e-7, "{angle}: {got} {want}");
        }
        assert_eq!(arc_tangent(0.0, 0.0), 0.0);
        assert_eq!(longitude_latitude(Vec3::Z).1, FRAC_PI_2);
    }
}
