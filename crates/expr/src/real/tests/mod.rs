//! One suite for all kernels: a table of functions, their ranges and their bounds.

mod accuracy;
mod known;
mod vectors;

use crate::real::Real;

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

/// The same number or both NaN; zeros of different sign are different.
fn assert_same(what: &str, got: f64, want: f64) {
    assert!(
        got.to_bits() == want.to_bits() || (got.is_nan() && want.is_nan()),
        "{what} is {got}, not {want}"
    );
}
