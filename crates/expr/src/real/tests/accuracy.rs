//! Against the standard library, over whole ranges.

use super::{cases, samples, ulps_narrow, ulps_wide};
use crate::real::Real;

#[test]
fn every_f64_function_is_as_close_to_the_standard_library_as_promised() {
    for case in cases() {
        let (mut worst, mut at) = (0.0, 0.0);
        for x in samples(&case, case.logarithmic[0]) {
            let error = ulps_wide((case.wide)(x), (case.reference)(x));
            if error > worst || error.is_nan() {
                (worst, at) = (error, x);
            }
        }
        println!("{:6} f64 {worst:.2} ulp at {at:e}", case.name);
        assert!(
            worst <= case.bounds.0,
            "{} is {worst} ulp off at {at:e}",
            case.name
        );
    }
}

#[test]
fn every_f32_function_is_as_close_to_the_f64_value_as_promised() {
    for case in cases() {
        let (mut worst, mut at) = (0.0, 0.0);
        for x in samples(&case, case.logarithmic[1])
            .into_iter()
            .map(|x| x as f32)
        {
            let error = ulps_narrow((case.narrow)(x), (case.reference)(x.into()));
            if error > worst || error.is_nan() {
                (worst, at) = (error, x);
            }
        }
        println!("{:6} f32 {worst:.2} ulp at {at:e}", case.name);
        assert!(
            worst <= case.bounds.1,
            "{} is {worst} ulp off at {at:e}",
            case.name
        );
    }
}

#[test]
fn f32_functions_keep_their_promise_over_all_bit_patterns() {
    for case in cases() {
        let limit = if matches!(case.name, "sin" | "cos" | "tan") {
            1e4
        } else {
            f32::INFINITY
        };
        for x in (0..u32::MAX).step_by(40_009).map(f32::from_bits) {
            let (got, want) = ((case.narrow)(x), (case.reference)(x.into()));
            let overflows = f64::abs(want) > f32::MAX.into();
            let right = if overflows {
                f64::from(got) == f64::from(want as f32)
            } else {
                f32::abs(x) > limit
                    || want.is_nan() && got.is_nan()
                    || ulps_narrow(got, want) <= case.bounds.1
            };
            assert!(right, "{}({x:e}) is {got:e}, not {want:e}", case.name);
        }
    }
}

#[test]
fn results_underflow_gradually_and_overflow_only_where_they_must() {
    for x in [-708.5, -720.0, -740.0, -745.0, 709.78, 709.782_712_893_384] {
        assert!(ulps_wide(Real::exp(x), f64::exp(x)) <= 2.0, "exp({x})");
    }
    for x in [709.9, 710.2, 710.475_860_073_943] {
        assert!(ulps_wide(Real::sinh(x), f64::sinh(x)) <= 4.0, "sinh({x})");
        assert!(ulps_wide(Real::cosh(x), f64::cosh(x)) <= 4.0, "cosh({x})");
    }
    for x in [f64::MIN_POSITIVE, 5e-324, 1e-310, f64::MAX] {
        assert!(ulps_wide(Real::ln(x), f64::ln(x)) <= 2.0, "ln({x})");
        assert!(
            ulps_wide(Real::atan2(x, 1.0), f64::atan2(x, 1.0)) <= 2.0,
            "atan2({x}, 1)"
        );
    }
    for x in [f32::MIN_POSITIVE, 1e-45, f32::MAX] {
        assert!(
            ulps_narrow(Real::ln(x), f64::ln(x.into())) <= 1.5,
            "ln({x}) in f32"
        );
    }
}

#[test]
fn sine_and_cosine_stay_accurate_beside_every_multiple_of_a_right_angle() {
    for q in (1..636_619_u32).step_by(11) {
        let x = f64::from(q) * std::f64::consts::FRAC_PI_2;
        for x in [x.next_down(), x, x.next_up()] {
            assert!(ulps_wide(Real::sin(x), f64::sin(x)) <= 2.0, "sin({x:e})");
            assert!(ulps_wide(Real::cos(x), f64::cos(x)) <= 2.0, "cos({x:e})");
            assert!(ulps_wide(Real::tan(x), f64::tan(x)) <= 4.0, "tan({x:e})");
        }
    }
    for q in 1..6_366_u16 {
        let x = (f64::from(q) * std::f64::consts::FRAC_PI_2) as f32;
        assert!(
            ulps_narrow(Real::sin(x), f64::sin(x.into())) <= 1.5,
            "sin({x:e}) in f32"
        );
        assert!(
            ulps_narrow(Real::cos(x), f64::cos(x.into())) <= 1.5,
            "cos({x:e}) in f32"
        );
        assert!(
            ulps_narrow(Real::tan(x), f64::tan(x.into())) <= 3.0,
            "tan({x:e}) in f32"
        );
    }
}

/// Powers with |exponent·ln base| up to 50, bases near one and far from it.
fn powers() -> impl Iterator<Item = (f64, f64)> {
    (0..40_000).map(|i| {
        let (u, v) = (
            (f64::from(i) * 0.618_034).fract(),
            (f64::from(i) * 0.754_878).fract(),
        );
        let base = if i % 2 == 0 {
            0.6 + u
        } else {
            f64::exp(14.0 * (u - 0.5))
        };
        (base, ((100.0 * v - 50.0) / f64::ln(base)).clamp(-1e4, 1e4))
    })
}

#[test]
fn powers_are_as_accurate_as_promised() {
    for (base, exponent) in powers() {
        let error = ulps_wide(Real::pow(base, exponent), f64::powf(base, exponent));
        assert!(error <= 3.0, "{base} to {exponent} is {error} ulp off");
        let (base, exponent) = (base as f32, exponent as f32);
        let error = ulps_narrow(
            Real::pow(base, exponent),
            f64::powf(base.into(), exponent.into()),
        );
        assert!(
            error <= 3.0,
            "{base} to {exponent} is {error} ulp off in f32"
        );
    }
}

#[test]
fn angles_of_points_are_right_in_all_quadrants_and_on_the_axes() {
    let numbers = [
        0.0,
        5e-324,
        1e-300,
        0.3,
        1.0,
        1.01,
        17.0,
        1e300,
        f64::INFINITY,
    ];
    let signed = || numbers.iter().flat_map(|&x| [x, -x]);
    for y in signed() {
        for x in signed() {
            let (got, want) = (Real::atan2(y, x), f64::atan2(y, x));
            assert!(
                ulps_wide(got, want) <= 2.0,
                "atan2({y}, {x}) is {got}, not {want}"
            );
            assert_eq!(
                got.is_sign_negative(),
                want.is_sign_negative(),
                "atan2({y}, {x})"
            );
        }
        assert!(Real::atan2(y, f64::NAN).is_nan() && Real::atan2(f64::NAN, y).is_nan());
    }
    for i in 0..20_000 {
        let angle = f64::from(i) * std::f64::consts::TAU / 20_000.0;
        let (y, x) = (3.0 * f64::sin(angle), 0.1 * f64::cos(angle));
        assert!(
            ulps_wide(Real::atan2(y, x), f64::atan2(y, x)) <= 2.0,
            "atan2({y}, {x})"
        );
        let (y, x) = (y as f32, x as f32);
        assert!(
            ulps_narrow(Real::atan2(y, x), f64::atan2(y.into(), x.into())) <= 2.0,
            "atan2({y}, {x}) in f32"
        );
    }
}
