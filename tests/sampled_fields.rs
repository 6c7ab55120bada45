//! Spaces given by samples, against the closed forms that they are samples of.

mod support;

use geofan_core::{
    geodesic::{Path, Ray, fixed_steps, paths},
    manifold::Manifold,
    random::Stream,
};
use glam::{DMat3, DVec3};
use ode_solvers::{Dopri5, OutputType, SVector, System};
use std::fmt::Write as _;
use support::{
    sampled::{BOX, LENS, Sampled, log_index},
    settings,
};

const TRUTH: &str = "metric = { conformal = \"exp(0.5*exp(-(x^2 + y^2 + z^2)/2))\" }";

/// 24 rays of length 4.5 through the lens.
fn rays(manifold: &Manifold) -> Vec<Ray> {
    let mut stream = Stream::new(&[39]);
    let ray = |_| {
        let way = stream.direction();
        let aside = [0; 3].map(|_| stream.between(-0.8, 0.8));
        let u = -2.0 * way + DVec3::from(aside);
        let d = (DVec3::from([0; 3].map(|_| stream.between(-0.8, 0.8))) - u).normalize();
        Ray::new(manifold, u, d, 4.5)
    };
    (0..24).map(ray).collect()
}

fn follow(manifold: &Manifold, tolerance: f64) -> Vec<Path> {
    let all = rays(manifold).into_iter();
    // Ends and starts must be those of one ray in both spaces: starts in the chart, unit speed in the metric.
    paths(
        manifold,
        settings(tolerance, false),
        all.collect::<Vec<_>>(),
    )
}

/// Transverse distances of ends over the length, mrad, sorted; and the steps that the rays took together.
fn errors(sampled: &Manifold, truth: &Manifold, tolerance: f64) -> (Vec<f64>, usize) {
    let (paths, exact) = (follow(sampled, tolerance), follow(truth, 1e-12));
    let error = |(path, exact): (&Path, &Path)| {
        let (step, right) = (path.steps.last().unwrap(), exact.steps.last().unwrap());
        let (u, v) = (right.position(4.5), right.tangent(4.5));
        let g = truth.metric(u);
        let off = step.position(4.5) - u;
        let across = off - v * off.dot(g * v);
        across.dot(g * across).sqrt() / 4.5 * 1e3
    };
    let mut errors: Vec<f64> = paths.iter().zip(&exact).map(error).collect();
    errors.sort_by(f64::total_cmp);
    (errors, paths.iter().map(|path| path.tried).sum())
}

fn median(errors: &[f64]) -> f64 {
    errors[errors.len() / 2]
}

fn truth() -> Manifold {
    support::manifold(TRUTH)
}

#[test]
fn rays_through_a_sampled_lens_end_where_those_of_the_formula_do() {
    let (lens, mut table) = (truth(), String::new());
    // Degree, samples an axis, the largest median and maximum, mrad.
    for (degree, n, most) in [
        (3, 33, [0.03, 0.11]),
        (3, 65, [0.0032, 0.01]),
        (5, 17, [0.043, 0.1]),
        (5, 33, [0.0004, 0.0015]),
    ] {
        let sampled = Sampled::new(n, |u| log_index(u, 0.0));
        let space = sampled.manifold(&format!("{BOX}\ndegree = {degree}"), LENS);
        let (errors, steps) = errors(&space, &lens, 1e-8);
        let (p50, max) = (median(&errors), errors[23]);
        writeln!(
            table,
            "degree {degree}, {n} samples: {p50:.5} / {max:.5} mrad, {steps} steps"
        )
        .unwrap();
        assert!(p50 < most[0] && max < most[1], "{table}");
    }
    let (_, steps) = errors(&lens, &lens, 1e-8);
    println!("{table}formula: {steps} steps");
}

#[test]
fn a_quintic_field_costs_no_step_more_than_the_formula_and_keeps_the_integrators_order() {
    let sampled = Sampled::new(33, |u| log_index(u, 0.0));
    let (space, lens) = (sampled.manifold(BOX, LENS), truth());
    let steps = |space: &Manifold, tolerance| -> usize {
        follow(space, tolerance).iter().map(|path| path.tried).sum()
    };
    for tolerance in [1e-6, 1e-8, 1e-10] {
        let (own, formula) = (steps(&space, tolerance), steps(&lens, tolerance));
        assert!(
            own <= formula + formula / 10,
            "{tolerance:e}: {own} and {formula} steps"
        );
    }
    // Equal steps of order four.
    let ray = rays(&space)[3];
    let end = |steps: usize| {
        let knots = fixed_steps::<f64>(&space, &[(ray.u, ray.v)], ray.length, steps);
        *knots[0].0.last().unwrap()
    };
    let truth = end(2048);
    let error = |steps| (end(steps) - truth).length();
    let rates = [32, 64].map(|steps| error(steps) / error(2 * steps));
    assert!(
        rates.iter().all(|rate| (11.0..23.0).contains(rate)),
        "{rates:?}"
    );
}

type State = SVector<f64, 6>;

/// `log n` and its gradient.
type Medium = dyn Fn([f64; 3]) -> [f64; 4];

/// Rays of an index by the arc length of its metric: a place and a Euclidean unit vector.
struct Eikonal<'m>(&'m Medium);

impl System<f64, State> for Eikonal<'_> {
    fn system(&self, _: f64, y: &State, dy: &mut State) {
        let [log_n, x, y_, z] = (self.0)([y[0], y[1], y[2]]);
        let (slope, way) = (DVec3::new(x, y_, z), DVec3::new(y[3], y[4], y[5]));
        let bend = slope - way * slope.dot(way);
        for k in 0..3 {
            dy[k] = way[k] * (-log_n).exp();
            dy[3 + k] = bend[k] * (-log_n).exp();
        }
    }
}

/// The end of a ray, its way there and the evaluations that it took, by an integrator of other people.
fn eikonal(medium: &Medium, ray: &Ray, tolerance: f64) -> (DVec3, DVec3, u32) {
    let way = ray.v.normalize();
    let start = State::from([ray.u.x, ray.u.y, ray.u.z, way.x, way.y, way.z]);
    let mut solver = Dopri5::from_param(
        Eikonal(medium),
        0.0,
        ray.length,
        ray.length,
        start,
        tolerance,
        tolerance,
        0.9,
        0.04,
        0.2,
        10.0,
        ray.length,
        0.0,
        1_000_000,
        1_000_000,
        OutputType::Sparse,
    );
    let told = solver.integrate().expect("the ray is followed");
    let end = solver.y_out().last().unwrap();
    let [u, way] = [0, 3].map(|k| DVec3::new(end[k], end[k + 1], end[k + 2]));
    (u, way.normalize(), told.num_eval)
}

#[test]
fn a_trilinear_field_would_be_far_off_and_dear_and_metrics_refuse_it_for_that() {
    // Where a path ends, a field of degree 1 will do; the same field is then taken as an index.
    let sampled = Sampled::new(129, |u| log_index(u, 0.0));
    let section = format!("{BOX}\ndegree = 1");
    let rest = format!("{TRUTH}\n[[exit]]\nname = \"thin\"\nwhen = \"0.02 - logn(x, y, z)\"");
    let space = sampled.manifold(&section, &rest);
    let spline = space.fields[0].spline.clone();
    let trilinear = move |u: [f64; 3]| {
        [[0; 3], [1, 0, 0], [0, 1, 0], [0, 0, 1]].map(|orders| spline.derivative(orders, u))
    };
    let formula = |u: [f64; 3]| {
        let u = DVec3::from(u);
        let value = log_index(u, 0.0);
        [value, -u.x * value, -u.y * value, -u.z * value]
    };
    let (mut errors, mut evaluations) = (Vec::new(), [0; 2]);
    for ray in rays(&space) {
        let [(end, _, dear), (right, way, cheap)] =
            [&trilinear as &Medium, &formula].map(|medium| eikonal(medium, &ray, 1e-8));
        let across = (end - right).reject_from_normalized(way);
        errors.push(across.length() * log_index(right, 0.0).exp() / ray.length * 1e3);
        evaluations[0] += dear / 24;
        evaluations[1] += cheap / 24;
    }
    errors.sort_by(f64::total_cmp);
    let (p50, max) = (median(&errors), errors[23]);
    println!("degree 1, 129 samples: {p50:.3} / {max:.3} mrad, {evaluations:?} evaluations");
    assert!((0.17..0.7).contains(&p50), "{p50}");
    assert!((0.6..5.4).contains(&max), "{max}");
    assert!(evaluations[0] > 30 * evaluations[1], "{evaluations:?}");
    // Three orders worse than a quintic of a quarter of the samples an axis.
    let quintic = Sampled::new(33, |u| log_index(u, 0.0)).manifold(BOX, LENS);
    let (fine, _) = self::errors(&quintic, &truth(), 1e-8);
    assert!(p50 > 500.0 * median(&fine), "{p50} {fine:?}");
    // The path ends where the trilinear field says.
    let ray = Ray::new(&space, DVec3::new(1.0, 0.4, 0.2), DVec3::X, 9.0);
    let path = paths(&space, settings(1e-9, true), [ray]).remove(0);
    assert_eq!(path.end.name(&space), "thin");
    let at = path.steps.last().unwrap().position(path.length);
    assert!((space.fields[0].spline.derivative([0; 3], at.to_array()) - 0.02).abs() < 1e-9);
}

#[test]
fn a_trilinear_field_is_refused_wherever_it_would_be_differentiated() {
    let sampled = Sampled::new(17, |u| log_index(u, 0.0));
    let flat = "metric = { conformal = \"1\" }";
    let call = "0.3*logn(x, y, z)";
    let cases = [
        (
            "a metric",
            "[metric]\nxx = \"1 + logn(x, y, z)\"\nyy = \"1\"\nzz = \"1\"".into(),
        ),
        (
            "a metric",
            "metric = { conformal = \"n\" }\n[let]\nn = \"exp(logn(x, y, z))\"".into(),
        ),
        (
            "a metric",
            format!("{flat}\nlapse = \"exp({call})\"\nshift = [\"0\", \"0\", \"0\"]"),
        ),
        (
            "a metric",
            format!("[spacetime]\ntt = \"-exp({call})\"\nxx = \"1\"\nyy = \"1\"\nzz = \"1\""),
        ),
        (
            "an embedding",
            format!("embedding = [\"x\", \"y\", \"z\", \"{call}\"]"),
        ),
        (
            "a wind or a drift",
            format!("{flat}\nwind = [\"{call}\", \"0\", \"0\"]"),
        ),
        (
            "a wind or a drift",
            format!("{flat}\ndrift = [\"0\", \"{call}\", \"0\"]"),
        ),
        (
            "a mirror",
            format!("{flat}\n[[glue]]\nface = \"2 - z + {call}\"\nmirror = true"),
        ),
        (
            "the map of a face",
            format!("{flat}\n[[glue]]\nface = \"2 - z\"\nmap = [\"x\", \"y + {call}\", \"z - 4\"]"),
        ),
    ];
    for (what, rest) in cases {
        let report = sampled
            .load(&format!("{BOX}\ndegree = 1"), &rest)
            .expect_err(&rest);
        let told = format!("field `logn` of degree 1 is not smooth enough for {what}: ");
        assert!(report.contains(&told), "{rest}\n{report}");
        assert!(report.contains("degree = 1"), "{rest}\n{report}");
        assert!(report.contains("take degree"), "{rest}\n{report}");
    }
    // What is only evaluated may be as rough as it likes.
    let rest =
        format!("{flat}\nlapse = \"exp({call})\"\n[domain]\ninside = [\"1 - logn(x, y, z)\"]\n");
    sampled.manifold(&format!("{BOX}\ndegree = 1"), &rest);
}

#[test]
fn a_turned_box_gives_the_same_space() {
    // Samples on a grid turned by 30° about a slanted axis; the call turns its arguments back.
    let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 30_f64.to_radians());
    let aniso = |u: DVec3| 0.5 * (-(u.x * u.x + 0.6 * u.y * u.y + 1.4 * u.z * u.z) / 2.0).exp();
    let straight = Sampled::new(33, aniso);
    let turned = Sampled::new(33, |w| aniso(turn * w));
    let back = turn.transpose();
    let row = |k: usize| {
        let r = back.row(k);
        format!("({:?})*x + ({:?})*y + ({:?})*z", r.x, r.y, r.z)
    };
    let call = format!(
        "metric = {{ conformal = \"exp(logn({}, {}, {}))\" }}",
        row(0),
        row(1),
        row(2)
    );
    let (a, b) = (straight.manifold(BOX, LENS), turned.manifold(BOX, &call));
    let formula = support::manifold(
        "metric = { conformal = \"exp(0.5*exp(-(x^2 + 0.6*y^2 + 1.4*z^2)/2))\" }",
    );
    for space in [&a, &b] {
        let (errors, _) = errors(space, &formula, 1e-9);
        assert!(median(&errors) < 0.002 && errors[23] < 0.01, "{errors:?}");
    }
    let (errors, _) = errors(&b, &a, 1e-9);
    assert!(errors[23] < 0.01, "{errors:?}");
    // Areas need second derivatives, through the chain rule.
    let area = |space: &Manifold| {
        let ray = Ray::new(space, DVec3::new(-1.5, 0.3, 0.2), DVec3::X, 3.0);
        let path = paths(space, settings(1e-10, false), [ray]).remove(0);
        geofan_core::geodesic::sample(space, &ray, &path, 3.0)
            .area
            .unwrap()
    };
    let (own, right) = (area(&b), area(&formula));
    assert!((own - right).abs() < 1e-3 * right.abs(), "{own} {right}");
}

#[test]
fn noise_is_smoothed_away() {
    let mut stream = Stream::new(&[40]);
    let noise: Vec<f64> = (0..33 * 33 * 33)
        .map(|_| stream.between(-1e-4, 1e-4))
        .collect();
    let mut next = noise.iter();
    let counter = std::cell::RefCell::new(&mut next);
    let sampled = Sampled::new(33, |u| {
        log_index(u, 0.0) + counter.borrow_mut().next().unwrap()
    });
    // Samples are a quarter apart: the smoothed lens is that of the Gaussian widened by as much.
    let width = 0.25;
    let strength = 0.5 * (1.0_f64 / (1.0 + width * width)).powf(1.5);
    let widened = support::manifold(&format!(
        "metric = {{ conformal = \"exp({strength:?}*exp(-(x^2 + y^2 + z^2)/{:?}))\" }}",
        2.0 * (1.0 + width * width)
    ));
    let smooth = sampled.manifold(&format!("{BOX}\nsmooth = 1"), LENS);
    let rough = sampled.manifold(BOX, LENS);
    let (smoothed, _) = errors(&smooth, &widened, 1e-8);
    let (left, _) = errors(&rough, &truth(), 1e-8);
    println!(
        "noise of 1e-4: {:.4} mrad smoothed, {:.4} not",
        median(&smoothed),
        median(&left)
    );
    assert!(
        median(&smoothed) < 0.3 * median(&left),
        "{smoothed:?} {left:?}"
    );
    assert!(median(&smoothed) < 0.05);
}

#[test]
fn an_embedding_may_be_sampled_and_its_areas_are_right() {
    let sampled = Sampled::new(49, |u| (-u.length_squared() / 2.0).exp());
    let bump = sampled.manifold(BOX, "embedding = [\"x\", \"y\", \"z\", \"logn(x, y, z)\"]");
    let truth =
        support::manifold("embedding = [\"x\", \"y\", \"z\", \"exp(-(x^2 + y^2 + z^2)/2)\"]");
    let end = |space: &Manifold| {
        let d = DVec3::new(0.9, 0.2, -0.1).normalize();
        let ray = Ray::new(space, DVec3::new(-2.0, 0.3, 0.2), d, 4.0);
        let path = paths(space, settings(1e-10, false), [ray]).remove(0);
        geofan_core::geodesic::sample(space, &ray, &path, 4.0)
    };
    let (own, right) = (end(&bump), end(&truth));
    assert!((own.u - right.u).length() < 1e-5, "{} {}", own.u, right.u);
    let (own, right) = (own.area.unwrap(), right.area.unwrap());
    assert!((own - right).abs() < 1e-3 * right.abs(), "{own} {right}");
    let scalar = |space: &Manifold| space.curvature(DVec3::new(0.4, -0.3, 0.5)).unwrap().scalar;
    assert!((scalar(&bump) - scalar(&truth)).abs() < 1e-3);
}

#[test]
fn paths_leave_through_the_field_where_it_says_so_and_run_on_where_it_is_clamped() {
    let sampled = Sampled::new(17, |u| log_index(u, 0.0));
    let end = |section: &str| {
        let space = sampled.manifold(&format!("{BOX}\n{section}"), LENS);
        let ray = Ray::new(&space, DVec3::new(2.0, 0.5, 0.3), DVec3::X, 9.0);
        let path = paths(&space, settings(1e-9, true), [ray]).remove(0);
        let at = path.steps.last().unwrap().position(path.length);
        (path.end.name(&space).to_string(), at)
    };
    let (name, at) = end("outside = \"exit\"");
    assert_eq!(name, "logn");
    assert!((at.x - 4.0).abs() < 1e-9, "{at}");
    let (name, at) = end("outside = \"clamp\"");
    assert_eq!(name, "length");
    assert!(at.x > 10.0);
}

#[test]
fn winds_domains_exits_and_lets_may_call_fields() {
    let sampled = Sampled::new(17, |u| log_index(u, 0.0));
    let rest = r#"
metric = { conformal = "1" }
wind = ["0.3*n0", "0", "0.1*logn(y, z, x)"]
[let]
n0 = "logn(x, y, z)"
[domain]
inside = ["0.45 - n0"]
[[exit]]
name = "far"
when = "0.01 - logn(x, y, z)"
"#;
    let space = sampled.manifold(BOX, rest);
    let ray = Ray::new(&space, DVec3::new(1.0, 0.4, 0.2), DVec3::X, 9.0);
    let path = paths(&space, settings(1e-9, true), [ray]).remove(0);
    assert_eq!(path.end.name(&space), "far");
    let at = path.steps.last().unwrap().position(path.length);
    assert!((log_index(at, 0.0) - 0.01).abs() < 2e-4);
    let inwards = Ray::new(&space, DVec3::new(2.0, 0.1, 0.1), DVec3::NEG_X, 9.0);
    let path = paths(&space, settings(1e-9, true), [inwards]).remove(0);
    assert_eq!(path.end.name(&space), "inside");
}
