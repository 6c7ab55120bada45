use super::*;
use crate::random::Stream;

fn plan(limits: [f64; 2], degree: usize) -> FieldPlan {
    FieldPlan {
        limits: [limits; 3],
        degree,
        outside: [Outside::Clamp; 3],
        smooth: 0.0,
    }
}

/// Samples of a function on a cube of `n` samples an axis.
fn cube(n: usize, [low, high]: [f64; 2], f: impl Fn([f64; 3]) -> f64) -> Samples {
    let place = |i: usize| low + (high - low) * i as f64 / (n - 1) as f64;
    let mut values = Vec::new();
    for x in 0..n {
        for y in 0..n {
            values.extend((0..n).map(|z| f([x, y, z].map(place))));
        }
    }
    Samples::new([n; 3], values)
}

fn field(samples: Samples, plan: FieldPlan) -> Result<Field, SampleFault> {
    Field::new("f".into(), vec!["f.npy".into()], Arc::new(samples), plan)
}

#[test]
fn a_number_that_is_none_is_named_by_its_index() {
    let mut samples = cube(6, [0.0, 1.0], |[x, _, _]| x);
    samples.values[2 * 36 + 4 * 6 + 5] = f64::NAN;
    let fault = field(samples, plan([0.0, 1.0], 5)).unwrap_err();
    assert_eq!(fault.message, "sample [2, 4, 5] of `f` is NaN");
}

#[test]
fn too_few_samples_are_refused_by_their_axis_and_degree() {
    let fault = field(cube(5, [0.0, 1.0], |_| 0.0), plan([0.0, 1.0], 5)).unwrap_err();
    assert_eq!(fault.key, "degree");
    assert!(
        fault
            .message
            .contains("5 samples along x; degree 5 needs 6"),
        "{}",
        fault.message
    );
    assert!(field(cube(5, [0.0, 1.0], |_| 0.0), plan([0.0, 1.0], 3)).is_ok());
}

#[test]
fn smoothing_takes_noise_away_and_leaves_linear_functions_as_they_are() {
    let mut stream = Stream::new(&[5]);
    let mut smooth = plan([-1.0, 1.0], 5);
    smooth.smooth = 1.0;
    let linear = |[x, y, z]: [f64; 3]| 1.0 + x - 2.0 * y + 0.5 * z;
    let points: Vec<[f64; 3]> = (0..200)
        .map(|_| [0; 3].map(|_| stream.between(-1.0, 1.0)))
        .collect();
    let worst = |field: &Field, orders: [u8; 3], value: f64| {
        let off = points.iter().map(|at| {
            let wanted = if orders == [0; 3] { linear(*at) } else { value };
            (field.spline.derivative(orders, *at) - wanted).abs()
        });
        off.fold(0.0, f64::max)
    };
    let exact = field(cube(25, [-1.0, 1.0], linear), smooth).unwrap();
    assert!(worst(&exact, [0; 3], 0.0) < 1e-13);
    assert!(worst(&exact, [1, 0, 0], 1.0) < 1e-11);
    let noisy = |smooth: FieldPlan, stream: &mut Stream| {
        let mut samples = cube(25, [-1.0, 1.0], linear);
        samples
            .values
            .iter_mut()
            .for_each(|x| *x += stream.between(-1e-4, 1e-4));
        field(samples, smooth).unwrap()
    };
    let (rough, calm) = (
        noisy(plan([-1.0, 1.0], 5), &mut stream),
        noisy(smooth, &mut stream),
    );
    // Bends are what noise makes most of.
    let (before, after) = (worst(&rough, [2, 0, 0], 0.0), worst(&calm, [2, 0, 0], 0.0));
    assert!(after < 0.1 * before, "{after} of {before}");
}

#[test]
fn the_last_samples_of_a_period_may_be_the_first_again() {
    let turn = std::f64::consts::TAU;
    let wave = |[x, _, _]: [f64; 3]| x.sin();
    let mut periodic = plan([0.0, turn], 5);
    periodic.outside[0] = Outside::Periodic;
    let repeated = field(cube(25, [0.0, turn], wave), periodic).unwrap();
    let mut short = periodic;
    short.limits[0] = [0.0, turn * 23.0 / 24.0];
    let mut once = cube(25, [0.0, turn], wave);
    once.values.truncate(24 * 25 * 25);
    once.shape[0] = 24;
    let once = field(once, short).unwrap();
    for i in -20..20 {
        let at = [0.7 * f64::from(i), 1.0, 2.0];
        let [a, b] = [&repeated, &once].map(|f| f.spline.derivative([1, 0, 0], at));
        assert!(
            (a - at[0].cos()).abs() < 3e-5 && (a - b).abs() < 1e-12,
            "{a} {b}"
        );
    }
}

#[test]
fn a_field_is_known_by_its_samples_and_their_use() {
    let linear = |[x, y, z]: [f64; 3]| x + 2.0 * y - z;
    let first = field(cube(6, [0.0, 1.0], linear), plan([0.0, 1.0], 5)).unwrap();
    let same = field(cube(6, [0.0, 1.0], linear), plan([0.0, 1.0], 5)).unwrap();
    assert_eq!(first.spline.identity(), same.spline.identity());
    let mut changed = cube(6, [0.0, 1.0], linear);
    changed.values[7] += 1e-12;
    let moved = plan([0.0, 1.5], 5);
    for other in [
        field(changed, plan([0.0, 1.0], 5)).unwrap(),
        field(cube(6, [0.0, 1.0], linear), moved).unwrap(),
        field(cube(6, [0.0, 1.0], linear), plan([0.0, 1.0], 3)).unwrap(),
    ] {
        assert_ne!(first.spline.identity(), other.spline.identity());
    }
}
