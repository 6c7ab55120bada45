//! Values that are known: limits, special numbers, forty digits, identities.

use super::{assert_same, cases, ulps_wide};
use crate::real::Real;

#[test]
fn inverse_hyperbolic_functions_meet_values_computed_to_forty_digits() {
    let table: &[(&str, f64, f64)] = &[
        ("asinh", 1e-09, 1e-09),
        ("asinh", 0.01, 0.009999833340832888),
        ("asinh", 0.3, 0.29567304756342244),
        ("asinh", 1.0, 0.881373587019543),
        ("asinh", 7.5, 2.712465305184344),
        ("asinh", 1000000000.0, 21.416413017506358),
        ("asinh", 1e+300, 691.4686750787737),
        ("asinh", f64::MAX, 710.475860073944),
        ("acosh", f64::MAX, 710.475860073944),
        ("acosh", 1.0000000000000002, 2.1073424255447014e-08),
        ("acosh", 1.0000000009313226, 4.315837287180596e-05),
        ("acosh", 1.0001, 0.014142017775251545),
        ("acosh", 1.3, 0.7564329108569596),
        ("acosh", 2.0, 1.3169578969248168),
        ("acosh", 1000000000.0, 21.416413017506358),
        ("acosh", 1e+300, 691.4686750787737),
        ("atanh", 1e-09, 1e-09),
        ("atanh", 0.01, 0.010000333353334763),
        ("atanh", 0.3, 0.3095196042031117),
        ("atanh", 0.75, 0.9729550745276566),
        ("atanh", 0.99, 2.6466524123622457),
        ("atanh", 0.9999999990686774, 10.743781298446322),
        ("atanh", 0.9999999999999999, 18.714973875118524),
    ];
    for &(name, x, want) in table {
        let case = cases()
            .into_iter()
            .find(|case| case.name == name)
            .expect("a known function");
        let error = ulps_wide((case.wide)(x), want);
        assert!(error <= 2.0, "{name} is {error} ulp off at {x:e}");
    }
}

#[test]
fn special_values_are_those_of_the_limits() {
    const INF: f64 = f64::INFINITY;
    const NAN: f64 = f64::NAN;
    let half_pi = std::f64::consts::FRAC_PI_2;
    let table: &[(&str, &[(f64, f64)])] = &[
        (
            "exp",
            &[
                (0.0, 1.0),
                (-0.0, 1.0),
                (INF, INF),
                (-INF, 0.0),
                (1e30, INF),
                (-1e30, 0.0),
            ],
        ),
        (
            "ln",
            &[
                (1.0, 0.0),
                (0.0, -INF),
                (-0.0, -INF),
                (-1.0, NAN),
                (INF, INF),
                (-INF, NAN),
            ],
        ),
        (
            "sinh",
            &[
                (0.0, 0.0),
                (-0.0, -0.0),
                (INF, INF),
                (-INF, -INF),
                (-1e30, -INF),
            ],
        ),
        ("cosh", &[(0.0, 1.0), (INF, INF), (-INF, INF), (-1e30, INF)]),
        (
            "tanh",
            &[
                (0.0, 0.0),
                (-0.0, -0.0),
                (INF, 1.0),
                (-INF, -1.0),
                (1e30, 1.0),
            ],
        ),
        (
            "sin",
            &[
                (0.0, 0.0),
                (-0.0, -0.0),
                (INF, NAN),
                (-INF, NAN),
                (1e30, NAN),
            ],
        ),
        (
            "cos",
            &[
                (0.0, 1.0),
                (-0.0, 1.0),
                (INF, NAN),
                (-INF, NAN),
                (1e30, NAN),
            ],
        ),
        (
            "tan",
            &[
                (0.0, 0.0),
                (-0.0, -0.0),
                (INF, NAN),
                (-INF, NAN),
                (1e30, NAN),
            ],
        ),
        (
            "asin",
            &[
                (0.0, 0.0),
                (-0.0, -0.0),
                (1.0, half_pi),
                (-1.0, -half_pi),
                (1.1, NAN),
                (-INF, NAN),
            ],
        ),
        (
            "acos",
            &[
                (0.0, half_pi),
                (1.0, 0.0),
                (-1.0, 2.0 * half_pi),
                (1.1, NAN),
                (-1.1, NAN),
                (INF, NAN),
            ],
        ),
        (
            "atan",
            &[
                (0.0, 0.0),
                (-0.0, -0.0),
                (INF, half_pi),
                (-INF, -half_pi),
                (-1e30, -half_pi),
            ],
        ),
        (
            "asinh",
            &[(0.0, 0.0), (-0.0, -0.0), (INF, INF), (-INF, -INF)],
        ),
        (
            "acosh",
            &[(1.0, 0.0), (0.5, NAN), (-3.0, NAN), (INF, INF), (-INF, NAN)],
        ),
        (
            "atanh",
            &[
                (0.0, 0.0),
                (-0.0, -0.0),
                (1.0, INF),
                (-1.0, -INF),
                (1.5, NAN),
                (-INF, NAN),
            ],
        ),
    ];
    for case in cases() {
        assert!(
            (case.wide)(NAN).is_nan() && (case.narrow)(f32::NAN).is_nan(),
            "{}(NaN)",
            case.name
        );
        let (_, values) = table
            .iter()
            .find(|(name, _)| *name == case.name)
            .expect("every function is in the table");
        for &(x, want) in *values {
            assert_same(&format!("{}({x})", case.name), (case.wide)(x), want);
            let narrow = (case.narrow)(x as f32).into();
            assert_same(
                &format!("{}({x}) in f32", case.name),
                narrow,
                (want as f32).into(),
            );
        }
    }
}

#[test]
fn powers_of_special_numbers_are_those_of_the_standard_library() {
    let numbers = [
        0.0,
        0.5,
        1.0,
        2.0,
        3.0,
        2.5,
        7.0,
        1e18,
        1e300,
        f64::INFINITY,
    ];
    let signed = || numbers.iter().flat_map(|&x| [x, -x]);
    for base in signed() {
        for exponent in signed() {
            let (got, mut want) = (Real::pow(base, exponent), f64::powf(base, exponent));
            if base == f64::NEG_INFINITY && exponent.fract() != 0.0 && exponent.is_finite() {
                want = f64::NAN;
            }
            let what = format!("{base} to {exponent}");
            if want == 0.0 || !want.is_finite() {
                assert_same(&what, got, want);
            }
            // Close to overflow the error grows; see the module.
            assert!(ulps_wide(got, want) <= 15.0, "{what} is {got}, not {want}");
            let narrow = f64::from(Real::pow(base as f32, exponent as f32));
            let want = f64::powf((base as f32).into(), (exponent as f32).into()) as f32;
            if base as f32 != f32::NEG_INFINITY && (want == 0.0 || !want.is_finite()) {
                assert_same(&format!("{what} in f32"), narrow, want.into());
            }
        }
        assert!(Real::pow(base, f64::NAN).is_nan() && Real::pow(f64::NAN, base).is_nan());
    }
}

#[test]
fn functions_undo_their_inverses_and_keep_their_identities() {
    let close = |what: &str, x: f64, got: f64, want: f64, tolerance: f64| {
        assert!(
            f64::abs(got - want) <= tolerance * f64::abs(want),
            "{what} at {x:e}: {got:e}, not {want:e}"
        );
    };
    const EPSILON: f64 = f64::EPSILON;
    for i in 1..20_000 {
        let x = 1e-3 * f64::from(i);
        close(
            "exp ln",
            x,
            Real::exp(Real::ln(x)),
            x,
            EPSILON * (2.0 + f64::abs(Real::ln(x))),
        );
        close(
            "sinh asinh",
            x,
            Real::sinh(Real::asinh(x)),
            x,
            8.0 * EPSILON,
        );
        close(
            "cosh acosh",
            x,
            Real::cosh(Real::acosh(1.0 + x)),
            1.0 + x,
            8.0 * EPSILON,
        );
        close(
            "tan atan",
            x,
            Real::tan(Real::atan(x)),
            x,
            EPSILON * (4.0 + 2.0 * x),
        );
        let (s, c) = (Real::sin(x), Real::cos(x));
        close("sin² + cos²", x, s * s + c * c, 1.0, 2.0 * EPSILON);
        close("sin / cos", x, s / c, Real::tan(x), 4.0 * EPSILON);
        let unit = x / 20.0;
        close(
            "tanh atanh",
            unit,
            Real::tanh(Real::atanh(unit)),
            unit,
            6.0 * EPSILON,
        );
        close(
            "asin + acos",
            unit,
            Real::asin(unit) + Real::acos(unit),
            std::f64::consts::FRAC_PI_2,
            4.0 * EPSILON,
        );
    }
}
