use super::*;
use crate::{
    Graph, Tape,
    graph::FieldId,
    parse::{Binding, Scope, parse},
};
use std::sync::Arc;

/// A smooth function that no polynomial is.
fn truth([x, y, z]: [f64; 3]) -> f64 {
    (0.7 * x - 0.4 * y).sin() * (0.3 * z + 0.1 * x).exp()
}

fn axis(samples: usize, limits: [f64; 2]) -> SampledAxis {
    SampledAxis {
        samples,
        limits,
        periodic: false,
    }
}

/// The places of an axis's samples.
fn places(axis: SampledAxis) -> Vec<f64> {
    let [low, high] = axis.limits;
    let steps = (axis.samples - 1).max(1) as f64;
    (0..axis.samples)
        .map(|i| low + (high - low) * i as f64 / steps)
        .collect()
}

/// Samples `f` on a grid and puts a spline through them.
fn through(f: impl Fn([f64; 3]) -> f64, axes: [SampledAxis; 3], degree: usize) -> Spline {
    let [xs, ys, zs] = axes.map(places);
    let mut samples = Vec::new();
    for x in &xs {
        for y in &ys {
            samples.extend(zs.iter().map(|z| f([*x, *y, *z])));
        }
    }
    Spline::through(&samples, axes, degree, [7; 32]).unwrap()
}

fn grid() -> [SampledAxis; 3] {
    [
        axis(9, [-1.0, 1.0]),
        axis(8, [0.0, 2.0]),
        axis(11, [-0.5, 3.0]),
    ]
}

/// Points all over the grid, its edges among them.
fn points() -> Vec<[f64; 3]> {
    let mut points = vec![[-1.0, 0.0, -0.5], [1.0, 2.0, 3.0], [-1.0, 2.0, 0.3]];
    for i in 0..40 {
        let t = [0.754_877, 0.569_840, 0.324_717].map(|g| (0.5 + g * f64::from(i)).fract());
        points.push([-1.0 + 2.0 * t[0], 2.0 * t[1], -0.5 + 3.5 * t[2]]);
    }
    points
}

#[test]
fn a_spline_takes_the_values_of_its_samples() {
    for degree in DEGREES {
        let axes = grid();
        let spline = through(truth, axes, degree);
        let [xs, ys, zs] = axes.map(places);
        for x in &xs {
            for (y, z) in ys.iter().zip(&zs) {
                let at = [*x, *y, *z];
                let error = spline.derivative([0; 3], at) - truth(at);
                assert!(error.abs() < 1e-13, "{degree} {at:?} {error:e}");
            }
        }
    }
}

#[test]
fn polynomials_of_its_degree_come_back_exactly_up_to_the_edges_with_all_derivatives() {
    for degree in [3, 5] {
        let n = degree as i32;
        let power = |x: f64, n: i32| x.powi(n);
        let f = |[x, y, z]: [f64; 3]| {
            power(x - 0.3, n) + power(y - 0.5, n) * (z - x) - power(z, 2) * x + 1.0
        };
        let spline = through(f, grid(), degree);
        for at @ [x, y, z] in points() {
            let d = f64::from(n);
            let expected = [
                ([0, 0, 0], f(at)),
                (
                    [1, 0, 0],
                    d * power(x - 0.3, n - 1) - power(y - 0.5, n) - z * z,
                ),
                ([2, 0, 0], d * (d - 1.0) * power(x - 0.3, n - 2)),
                ([0, 1, 1], d * power(y - 0.5, n - 1)),
                ([0, 2, 1], d * (d - 1.0) * power(y - 0.5, n - 2)),
                ([1, 0, 2], -2.0),
                ([0, 0, 2], -2.0 * x),
            ];
            for (orders, value) in expected {
                let error = spline.derivative(orders, at) - value;
                assert!(
                    error.abs() < 1e-9,
                    "degree {degree}, {orders:?} at {at:?}: {error:e}"
                );
            }
        }
    }
}

#[test]
fn errors_of_value_and_derivatives_fall_with_the_steps_as_the_degree_says() {
    for degree in [1, 3, 5] {
        let error = |cells: usize, orders: [u8; 3], value: &dyn Fn([f64; 3]) -> f64| {
            let spline = through(truth, [axis(cells + 1, [0.0, 2.0]); 3], degree);
            let inner = points()
                .into_iter()
                .map(|[x, y, z]| [x + 1.0, y, (z + 0.5) / 1.75]);
            let errors = inner.map(|at| (spline.derivative(orders, at) - value(at)).abs());
            errors.fold(0.0, f64::max)
        };
        let slope = |[x, y, z]: [f64; 3]| {
            let (sine, cosine) = (0.7 * x - 0.4 * y).sin_cos();
            (0.7 * cosine + 0.1 * sine) * (0.3 * z + 0.1 * x).exp()
        };
        let order = |orders, value: &dyn Fn([f64; 3]) -> f64| {
            (error(8, orders, value) / error(16, orders, value)).log2()
        };
        let (value, first) = (order([0; 3], &truth), order([1, 0, 0], &slope));
        let d = degree as f64;
        assert!(value > d + 0.6, "degree {degree}: order {value}");
        assert!(first > d - 0.4, "degree {degree}: order {first}");
    }
}

#[test]
fn derivatives_are_continuous_across_samples_up_to_the_degree_less_one() {
    for degree in [3, 5] {
        let spline = through(truth, grid(), degree);
        // Not beside the edge, where the outermost cells are one polynomial.
        let knot = -1.0 + 0.25 * 4.0;
        let jump = |order: u8| {
            let side = |x: f64| spline.derivative([order, 0, 0], [x, 0.77, 1.3]);
            (side(knot + 1e-9) - side(knot - 1e-9)).abs()
        };
        assert!(
            jump(degree as u8 - 1) < 1e-7,
            "{degree}: {:e}",
            jump(degree as u8 - 1)
        );
        assert!(
            jump(degree as u8) > 1e-6,
            "{degree}: {:e}",
            jump(degree as u8)
        );
    }
}

#[test]
fn a_periodic_axis_goes_on_as_one_period_before() {
    let turn = std::f64::consts::TAU;
    let n = 24;
    let round = SampledAxis {
        samples: n,
        limits: [-1.0, -1.0 + turn * (n - 1) as f64 / n as f64],
        periodic: true,
    };
    let f = |[x, _, _]: [f64; 3]| x.sin();
    let spline = through(f, [round, axis(1, [0.0, 1.0]), axis(1, [0.0, 1.0])], 5);
    for i in -30..60 {
        let x = 0.37 * f64::from(i);
        let at = [x, 5.0, -3.0];
        assert!((spline.derivative([0; 3], at) - x.sin()).abs() < 2e-6);
        assert!((spline.derivative([1, 0, 0], at) - x.cos()).abs() < 2e-5);
        assert!((spline.derivative([2, 0, 0], at) + x.sin()).abs() < 2e-3);
    }
}

#[test]
fn too_few_samples_are_refused_and_a_single_one_is_a_constant() {
    let few = Spline::through(
        &[0.0; 5],
        [
            axis(1, [0.0, 1.0]),
            axis(5, [0.0, 1.0]),
            axis(1, [0.0, 1.0]),
        ],
        5,
        [0; 32],
    );
    let few = few.unwrap_err();
    assert_eq!((few.axis, few.found, few.needed), (2, 5, 6));
    let constant = through(|_| 2.5, [axis(1, [0.0, 1.0]); 3], 5);
    let value = constant.derivative([0; 3], [3.0, -2.0, 7.0_f64]);
    assert!((value - 2.5).abs() < 1e-14, "{value}");
    assert!(constant.vanishes([0, 1, 0]));
}

/// A graph with a field over the grid, called `f`.
fn graph(degree: usize) -> (Graph, Scope, FieldId) {
    let mut graph = Graph::new();
    let mut scope = Scope::default();
    for (index, name) in ["x", "y", "z"].into_iter().enumerate() {
        scope.bind(name, Binding::fixed(graph.input(index as u32)));
    }
    let field = graph
        .add_field(Arc::new(through(truth, grid(), degree)))
        .unwrap();
    scope.bind_field("f", field);
    (graph, scope, field)
}

/// `text` with its first, second and third derivatives along x and a mixed one.
fn tape(text: &str, degree: usize) -> Tape {
    use crate::Direction;
    let (mut graph, scope, _) = graph(degree);
    let value = parse(text, &scope, &mut graph).unwrap().node;
    let mut along = [0, 1, 2].map(|k| Direction::of_input(&mut graph, k));
    let mut outputs = vec![value];
    for _ in 0..3 {
        let last = outputs[outputs.len() - 1];
        outputs.push(graph.derivative(last, &mut along[0]));
    }
    let mixed = graph.derivative(outputs[1], &mut along[1]);
    outputs.push(graph.derivative(mixed, &mut along[2]));
    Tape::compile(&graph, &outputs, 3).unwrap()
}

/// Runs a tape at points, `W` lanes at a time.
fn lanes<R: Real, const W: usize>(tape: &Tape, points: &[[f64; 3]]) -> Vec<Vec<f64>> {
    let mut registers = tape.registers::<R, W>();
    let mut found = Vec::new();
    for chunk in points.chunks(W) {
        for (lane, point) in chunk.iter().enumerate() {
            for k in 0..3 {
                registers.input(k)[lane] = R::from_f64(point[k]);
            }
        }
        tape.run(&mut registers);
        for lane in 0..chunk.len() {
            let outputs = 0..tape.outputs();
            found.push(
                outputs
                    .map(|k| registers.output(k)[lane].to_f64())
                    .collect(),
            );
        }
    }
    found
}

#[test]
fn tapes_compute_what_the_spline_does_in_every_kind_of_number_and_width() {
    for degree in DEGREES {
        let tape = tape("f(x, y, z)", degree);
        let points = points();
        let spline = through(truth, grid(), degree);
        let all: [[u8; 3]; 5] = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [1, 1, 1]];
        let expected = |at: [f64; 3]| all.map(|orders| spline.derivative(orders, at));
        let one = lanes::<f64, 1>(&tape, &points);
        assert_eq!(one, lanes::<f64, 4>(&tape, &points));
        assert_eq!(one, lanes::<f64, 16>(&tape, &points));
        let single = lanes::<f32, 16>(&tape, &points);
        assert_eq!(single, lanes::<f32, 1>(&tape, &points));
        for ((at, one), single) in points.iter().zip(&one).zip(&single) {
            // Derivatives on a sample are those of one side or the other.
            for ((value, double), single) in expected(*at).iter().zip(one).zip(single) {
                assert!(
                    (value - double).abs() < 1e-10,
                    "degree {degree} at {at:?}: {value} {double}"
                );
                assert!(
                    (value - single).abs() < 2e-3,
                    "degree {degree} at {at:?}: {value} {single}"
                );
            }
        }
    }
}

#[test]
fn arguments_may_be_any_expressions() {
    use crate::Direction;
    let (mut graph, scope, _) = graph(5);
    let text = "x*f(0.5*sin(x + y), 1 + 0.5*z*z, exp(x)*0.3) + f(0.1, y, 1)";
    let value = parse(text, &scope, &mut graph).unwrap().node;
    let mut along = [0, 1, 2].map(|k| Direction::of_input(&mut graph, k));
    let slopes = along.each_mut().map(|along| graph.derivative(value, along));
    let tape = Tape::compile(&graph, &[value, slopes[0], slopes[1], slopes[2]], 3).unwrap();
    let at = [0.31, 0.52, 0.43];
    let found = tape.at(&at);
    for k in 0..3 {
        let moved = |h: f64| {
            let mut at = at;
            at[k] += h;
            tape.at(&at)[0]
        };
        let difference = (8.0 * (moved(1e-3) - moved(-1e-3)) - moved(2e-3) + moved(-2e-3)) / 12e-3;
        assert!(
            (found[1 + k] - difference).abs() < 1e-9,
            "{k}: {} {difference}",
            found[1 + k]
        );
    }
}

#[test]
fn beyond_the_grid_the_nearest_value_holds_and_a_nan_stays_one() {
    let tape = tape("f(x, y, z)", 5);
    let inside = tape.at(&[1.0, 0.7, 1.1]);
    let beyond = tape.at(&[1.5, 0.7, 1.1]);
    assert_eq!(beyond[0], inside[0]);
    assert_eq!(beyond[1..4], [0.0; 3]);
    assert!(
        inside[1] != 0.0,
        "on the edge the derivative is that inside"
    );
    assert!(tape.at(&[-1.0, 0.7, 1.1])[1] != 0.0);
    assert!(tape.at(&[f64::NAN, 0.7, 1.1])[0].is_nan());
}

#[test]
fn one_instruction_computes_a_field_at_a_point_however_many_derivatives_are_asked_for() {
    use crate::Direction;
    let (mut graph, scope, _) = graph(5);
    let value = parse("f(x, y, z)", &scope, &mut graph).unwrap().node;
    let alone = Tape::compile(&graph, &[value], 3).unwrap().operations().0;
    let mut along = [0, 1, 2].map(|k| Direction::of_input(&mut graph, k));
    let mut all = vec![value];
    for i in 0..3 {
        let slope = graph.derivative(value, &mut along[i]);
        all.push(slope);
        all.extend(
            (0..=i)
                .map(|k| graph.derivative(slope, &mut along[k]))
                .collect::<Vec<_>>(),
        );
    }
    let together = Tape::compile(&graph, &all, 3).unwrap();
    assert_eq!(together.outputs(), 10);
    let together = together.operations().0;
    assert!(
        together < 4 * alone,
        "{together} operations for ten derivatives, {alone} for one"
    );
}

#[test]
fn tapes_of_different_fields_have_different_digests_and_graphs_tell_what_is_used() {
    let hash = |bytes: &[u8]| {
        let mut state = [0_u8; 32];
        for (i, byte) in bytes.iter().enumerate() {
            let at = i % 32;
            state[at] = state[at]
                .wrapping_mul(31)
                .wrapping_add(*byte)
                .rotate_left(3);
        }
        state
    };
    let digest = |identity: u8| {
        let mut graph = Graph::new();
        let inputs = [0, 1, 2].map(|k| graph.input(k));
        let axes = [
            axis(1, [0.0, 1.0]),
            axis(1, [0.0, 1.0]),
            axis(6, [0.0, 1.0]),
        ];
        let spline = Spline::through(&[0.0, 1.0, 2.0, 3.0, 4.0, 9.0], axes, 5, [identity; 32]);
        let field = graph.add_field(Arc::new(spline.unwrap())).unwrap();
        let value = graph.sample(field, inputs);
        assert_eq!(graph.fields_below(&[value]), [(field, 0)]);
        assert_eq!(graph.calls_below(&[value]), [(field, inputs)]);
        assert_eq!(graph.calls_below(&[inputs[0]]), []);
        Tape::compile(&graph, &[value], 3).unwrap().digests(hash)[0]
    };
    assert_eq!(digest(1), digest(1));
    assert_ne!(digest(1), digest(2));
}

#[test]
fn a_call_with_the_wrong_number_of_arguments_and_a_bare_name_are_named() {
    let (mut graph, scope, _) = graph(5);
    let error = |text: &str, graph: &mut Graph| parse(text, &scope, graph).unwrap_err();
    let few = error("1 + f(x, y)", &mut graph);
    assert_eq!(
        (few.span, few.message.as_str()),
        (4..11, "`f` takes 3 arguments, 2 given")
    );
    let bare = error("2*f", &mut graph);
    assert_eq!(bare.hint.unwrap(), "`f` is a function: write f(…)");
}
