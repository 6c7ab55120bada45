//! One suite for all kernels: a table of functions, their ranges and their bounds.

use super::super::real::Real;

/// A function in both types, the standard library's version, and where to compare them.
struct Case {
    name: &'static str,
    wide: fn(f64) -> f64,
    narrow: fn(f32) -> f32,
    reference: fn(f64) -> f64,
    /// Largest admitted difference in ulp, `f64` and `f32`. The standard library's own error,
    /// up to one ulp, is part of the first.
    bounds: (f64, f64),
    /// Intervals sampled evenly, for both types.
    even: &'static [(f64, f64)],
    /// Intervals of positive numbers sampled evenly in the logarithm, in `f64` and in `f32`;
    /// functions defined below zero are sampled there as well.
    logarithmic: [(f64, f64); 2],
    signed: bool,
}

macro_rules! case {
    ($name:ident, $bounds:expr, $even:expr, $logarithmic:expr, signed: $signed:expr) => {
        Case {
            name: stringify!($name),
            wide: |x| Real::$name(x),
            narrow: |x| Real::$name(x),
            reference: f64::$name,
            bounds: $bounds,
            even: &$even,
            logarithmic: $logarithmic,
            signed: $signed,
        }
    };
}

const ALL: [(f64, f64); 2] = [(1e-307, 1e307), (1e-37, 1e37)];
const TO_ONE: [(f64, f64); 2] = [(1e-307, 1.0), (1e-37, 1.0)];
const TURNS: [(f64, f64); 2] = [(1e-307, 1e6), (1e-37, 1e4)];

fn cases() -> Vec<Case> {
    vec![
        case!(exp, (2.0, 1.5), [(-1.0, 1.0), (-86.0, 88.0)], [(1e-300, 708.0), (1e-37, 86.0)], signed: true),
        case!(ln, (2.0, 1.5), [(0.5, 2.0), (0.99, 1.01), (1.0, 1e3)], ALL, signed: false),
        case!(sinh, (4.0, 3.0), [(-2.0, 2.0), (-86.0, 86.0)], [(1e-300, 709.0), (1e-37, 88.0)], signed: true),
        case!(cosh, (4.0, 3.0), [(-2.0, 2.0), (-86.0, 86.0)], [(1e-300, 709.0), (1e-37, 88.0)], signed: true),
        case!(tanh, (4.0, 3.0), [(-1.0, 1.0), (-25.0, 25.0)], ALL, signed: true),
        case!(sin, (2.0, 1.5), [(-4.0, 4.0), (-1e4, 1e4)], TURNS, signed: true),
        case!(cos, (2.0, 1.5), [(-4.0, 4.0), (-1e4, 1e4)], TURNS, signed: true),
        case!(tan, (4.0, 3.0), [(-4.0, 4.0), (-1e4, 1e4)], TURNS, signed: true),
        case!(atan, (2.0, 1.5), [(-1.1, 1.1), (-10.0, 10.0)], ALL, signed: true),
        case!(asin, (4.0, 3.0), [(-1.0, 1.0), (0.999, 1.0), (0.49, 0.51)], TO_ONE, signed: true),
        case!(acos, (4.0, 3.0), [(-1.0, 1.0), (0.999, 1.0), (-1.0, -0.999)], TO_ONE, signed: true),
        // The standard library computes the inverse hyperbolic functions itself, to a few ulp
        // and without care near the ends: those ends are left to the tabulated values.
        case!(asinh, (6.0, 3.0), [(-2.0, 2.0), (-100.0, 100.0)], ALL, signed: true),
        case!(acosh, (6.0, 3.0), [(1.5, 3.0), (1.5, 100.0)], [(1.5, 1e150), (1.0001, 1e37)], signed: false),
        case!(atanh, (6.0, 3.0), [(-0.9, 0.9)], [(1e-300, 0.9), (1e-37, 0.99)], signed: true),
    ]
}

const POINTS: usize = 4000;

fn samples(case: &Case, logarithmic: (f64, f64)) -> Vec<f64> {
    let fraction = |i: usize| (i as f64 + 0.5) / POINTS as f64;
    let even = case
        .even
        .iter()
        .flat_map(|&(a, b)| (0..POINTS).map(move |i| a + (b - a) * fraction(i)));
    let (a, b) = logarithmic;
    let magnitudes = (0..POINTS).map(|i| (a.ln() + (b.ln() - a.ln()) * fraction(i)).exp().min(b));
    let mirrored = magnitudes.clone().filter(|_| case.signed).map(|x| -x);
    even.chain(magnitudes).chain(mirrored).collect()
}

/// Distance in units in the last place of `want`.
fn ulps_wide(got: f64, want: f64) -> f64 {
    let size = f64::abs(want);
    ulps(got, want, size.next_up() - size)
}

fn ulps_narrow(got: f32, want: f64) -> f64 {
    let size = f32::abs(want as f32);
    ulps(got.into(), want, (size.next_up() - size).into())
}

fn ulps(got: f64, want: f64, unit: f64) -> f64 {
    let same = got == want || (got.is_nan() && want.is_nan());
    if same {
        0.0
    } else {
        f64::abs(got - want) / unit
    }
}

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

/// The same number or both NaN; zeros of different sign are different.
fn assert_same(what: &str, got: f64, want: f64) {
    assert!(
        got.to_bits() == want.to_bits() || (got.is_nan() && want.is_nan()),
        "{what} is {got}, not {want}"
    );
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

const LANES: usize = 16;

/// Applies `kernel` to blocks of lanes in vector instructions of the best kind this machine has.
macro_rules! dispatched {
    ($kernel:expr, $input:expr, $output:expr) => {{
        let (input, output) = (&$input[..], &mut $output[..]);
        fearless_simd::dispatch!(fearless_simd::Level::new(), simd => simd.vectorize(
            #[inline(always)]
            || {
                for (x, y) in input.iter().zip(output.iter_mut()) {
                    // Through locals: memory that might overlap keeps short loops scalar.
                    let (x, mut result) = (*x, [0.0; LANES]);
                    for i in 0..LANES {
                        result[i] = $kernel(x[i]);
                    }
                    *y = result;
                    // One block is one unit of work, as on a tape: no vectors across blocks.
                    std::hint::black_box(&mut *y);
                }
            }
        ))
    }};
}

#[test]
fn vector_instructions_give_the_same_bits_as_scalar_ones() {
    use fearless_simd::Simd;
    macro_rules! same_bits {
        ($float:ident: $($name:ident)*) => {$({
            let case = cases().into_iter().find(|case| case.name == stringify!($name)).expect("a known function");
            let all: Vec<$float> = samples(&case, case.logarithmic[1]).into_iter().map(|x| x as $float).collect();
            let (input, _) = all.as_chunks::<LANES>();
            let mut output = vec![[0.0; LANES]; input.len()];
            dispatched!(<$float as Real>::$name, input, output);
            for (x, y) in input.as_flattened().iter().zip(output.as_flattened()) {
                let scalar = std::hint::black_box(<$float as Real>::$name)(*x);
                assert!(y.to_bits() == scalar.to_bits() || (y.is_nan() && scalar.is_nan()), "{} at {x:e}", case.name);
            }
        })*};
    }
    same_bits!(f64: exp ln sinh cosh tanh sin cos tan asin acos atan asinh acosh atanh);
    same_bits!(f32: exp ln sinh cosh tanh sin cos tan asin acos atan asinh acosh atanh);
}

#[test]
#[ignore = "prints timings"]
fn nanoseconds_per_element() {
    use fearless_simd::Simd;
    macro_rules! time {
        ($float:ident: $($name:ident: $kernel:expr,)*) => {$({
            let input: Vec<[$float; LANES]> = (0..64).map(|i| std::array::from_fn(|j| (0.1 + 0.013 * i as $float + 0.01 * j as $float) as $float)).collect();
            let mut output = vec![[0.0; LANES]; input.len()];
            const ROUNDS: usize = 2_000;
            let best = (0..7).map(|_| {
                let start = std::time::Instant::now();
                for _ in 0..ROUNDS {
                    let input = std::hint::black_box(&input);
                    dispatched!($kernel, input, output);
                    std::hint::black_box(&output);
                }
                start.elapsed().as_secs_f64()
            }).fold(f64::INFINITY, f64::min);
            println!("{:7} {} {:6.3} ns", stringify!($name), stringify!($float), 1e9 * best / (ROUNDS * input.len() * LANES) as f64);
        })*};
    }
    macro_rules! time_all {
        ($($float:ident)*) => {$(
            time!($float:
                sqrt: <$float as Real>::sqrt, floor: <$float as Real>::floor, exp: <$float as Real>::exp,
                ln: <$float as Real>::ln, sin: <$float as Real>::sin, cos: <$float as Real>::cos,
                tan: <$float as Real>::tan, asin: <$float as Real>::asin, acos: <$float as Real>::acos,
                atan: <$float as Real>::atan, sinh: <$float as Real>::sinh, cosh: <$float as Real>::cosh,
                tanh: <$float as Real>::tanh, asinh: <$float as Real>::asinh, acosh: <$float as Real>::acosh,
                atanh: <$float as Real>::atanh,
                atan2: |x: $float| <$float as Real>::atan2(x, 0.7),
                pow: |x: $float| <$float as Real>::pow(x, 2.3 - x),
            );
        )*};
    }
    println!("{:?}", fearless_simd::Level::new());
    time_all!(f64 f32);
}
