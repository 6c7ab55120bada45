//! Spaces given by samples, against the closed forms that they are samples of.
//!
//! The samples are of `log n` of a Gaussian lens, `n = exp(exp(−r²/2)/2)`, on the cube [−4, 4]³.

mod support;

use geofan_bundle::{
    Bundle, Contents, PlanRecord, Polynomial, StepSize, Train, Tree, Variables, rays::RaySpace,
};
use geofan_core::{
    diagnostic::SourceText,
    geodesic::{Path, Ray, fixed_steps, paths},
    manifold::Manifold,
    random::Stream,
};
use glam::{DMat3, DVec3};
use ndarray::{ArrayD, IxDyn};
use ode_solvers::{Dopri5, OutputType, SVector, System};
use std::{fmt::Write as _, fs, path::Path as FilePath, sync::Arc};
use support::settings;

/// A field's section with a file of samples beside the manifold.
struct Sampled {
    folder: tempfile::TempDir,
}

/// `log n` at a point, of a lens of this width.
fn log_index(u: DVec3, width: f64) -> f64 {
    // A Gaussian smoothed by another keeps its integral.
    let strength = 0.5 * (1.0 / (1.0 + width * width)).powf(1.5);
    strength * (-u.length_squared() / (2.0 * (1.0 + width * width))).exp()
}

/// Writes an array of numpy.
fn write_npy(path: &FilePath, shape: [usize; 3], values: &[f32]) {
    let [x, y, z] = shape;
    let head = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({x}, {y}, {z}), }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((head.len() as u16).to_le_bytes());
    bytes.extend(head.as_bytes());
    bytes.extend(values.iter().flat_map(|x| x.to_le_bytes()));
    fs::write(path, bytes).unwrap();
}

/// `n` samples an axis of `f` over [−4, 4]³.
fn cube(n: usize, f: impl Fn(DVec3) -> f64) -> Vec<f32> {
    let place = |i: usize| -4.0 + 8.0 * i as f64 / (n - 1) as f64;
    let mut values = Vec::new();
    for x in 0..n {
        for y in 0..n {
            let at = |z| DVec3::new(place(x), place(y), place(z));
            values.extend((0..n).map(|z| f(at(z)) as f32));
        }
    }
    values
}

impl Sampled {
    fn new(n: usize, f: impl Fn(DVec3) -> f64) -> Self {
        let folder = tempfile::tempdir().unwrap();
        write_npy(&folder.path().join("logn.npy"), [n; 3], &cube(n, f));
        Self { folder }
    }

    fn text(section: &str, rest: &str) -> String {
        format!(
            "name = \"sampled\"\ncoordinates = [\"x\", \"y\", \"z\"]\n{rest}\n[field.logn]\nfile = \"logn.npy\"\n{section}\n"
        )
    }

    /// Loads a manifold that has this in the field's section and the rest of the file.
    fn load(&self, section: &str, rest: &str) -> Result<Manifold, String> {
        let name = self.folder.path().join("m.toml").display().to_string();
        let source = SourceText::new(name, Self::text(section, rest));
        Manifold::from_source(source, &[]).map_err(|e| e.report(false))
    }

    fn manifold(&self, section: &str, rest: &str) -> Manifold {
        self.load(section, rest).unwrap_or_else(|e| panic!("{e}"))
    }
}

const BOX: &str = "box = { x = [-4, 4], y = [-4, 4], z = [-4, 4] }";
const LENS: &str = "metric = { conformal = \"exp(logn(x, y, z))\" }";
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

#[test]
fn a_changed_sample_is_another_space_and_a_moved_file_is_not() {
    let first = Sampled::new(17, |u| log_index(u, 0.0));
    let again = Sampled::new(17, |u| log_index(u, 0.0));
    let changed = Sampled::new(17, |u| {
        log_index(u, 0.0) + if u.length() < 0.1 { 1e-6 } else { 0.0 }
    });
    let [a, b, c] = [&first, &again, &changed].map(|s| s.manifold(BOX, LENS));
    assert_eq!(a.differences(&b), [""; 0]);
    assert_eq!(a.fingerprint(), b.fingerprint());
    assert_ne!(a.fingerprint(), c.fingerprint());
    assert!(a.differences(&c)[0].contains("component xx of the metric differs"));
    // Elsewhere and under another name.
    fs::rename(
        first.folder.path().join("logn.npy"),
        first.folder.path().join("moved.npy"),
    )
    .unwrap();
    let text = Sampled::text(BOX, LENS).replace("logn.npy", "moved.npy");
    let name = first.folder.path().join("m.toml").display().to_string();
    let moved = Manifold::from_source(SourceText::new(name, text), &[]).unwrap();
    assert_eq!(a.differences(&moved), [""; 0]);
}

#[test]
fn what_cannot_be_a_field_is_refused_at_its_place() {
    let sampled = Sampled::new(17, |u| log_index(u, 0.0));
    let [small, single] = [5, 1].map(|n| Sampled::new(n, |_| 0.0));
    let mut values = cube(17, |u| log_index(u, 0.0));
    values[17 * 17 * 3 + 17 * 4 + 5] = f32::NAN;
    let broken = Sampled::new(17, |_| 0.0);
    write_npy(&broken.folder.path().join("logn.npy"), [17; 3], &values);
    let cases = [
        (
            &sampled,
            format!("{BOX}\ndegree = 1"),
            LENS,
            "degree = 1",
            "not smooth enough for a metric",
        ),
        (
            &sampled,
            format!("{BOX}\ndegree = 3"),
            "embedding = [\"x\", \"y\", \"z\", \"logn(x, y, z)\"]",
            "degree = 3",
            "not smooth enough for an embedding",
        ),
        (
            &sampled,
            format!("{BOX}\nendian = \"little\""),
            LENS,
            "endian = \"little\"",
            "for files without a head",
        ),
        (
            &single,
            BOX.into(),
            LENS,
            "box = ",
            "one sample has no places",
        ),
        (
            &sampled,
            format!("{BOX}\ndegree = 4"),
            LENS,
            "degree = 4",
            "degree 1, 3 or 5, not 4",
        ),
        (
            &sampled,
            "box = { x = [4, -4], y = [0, 1], z = [0, 1] }".into(),
            LENS,
            "box",
            "lower limit first",
        ),
        (&sampled, String::new(), LENS, "logn", "needs `box`"),
        (
            &sampled,
            format!("{BOX}\noutside = \"wrap\""),
            LENS,
            "wrap",
            "cannot be `wrap`",
        ),
        (
            &sampled,
            format!("{BOX}\narray = \"n\""),
            LENS,
            "array",
            "holds one array",
        ),
        (
            &sampled,
            format!("{BOX}\nsmooth = 40"),
            LENS,
            "smooth",
            "reaches over",
        ),
        (
            &sampled,
            format!("{BOX}\nshape = [3, 3, 3]"),
            LENS,
            "shape",
            "without a head",
        ),
        (
            &sampled,
            format!("{BOX}\ndegre = 3"),
            LENS,
            "degre",
            "unknown key `degre`",
        ),
        (
            &small,
            BOX.into(),
            LENS,
            "file",
            "5 samples along x; degree 5 needs 6",
        ),
        (
            &broken,
            BOX.into(),
            LENS,
            "file",
            "sample [3, 4, 5] of `logn` is NaN",
        ),
        (
            &sampled,
            BOX.into(),
            "metric = { conformal = \"exp(logn(x, y))\" }",
            "logn(x, y)",
            "takes 3 arguments",
        ),
        (
            &sampled,
            BOX.into(),
            "metric = { conformal = \"exp(lognn(x, y, z))\" }",
            "lognn",
            "did you mean `logn`?",
        ),
    ];
    for (files, section, rest, place, message) in cases {
        let report = files.load(&section, rest).expect_err(&section);
        assert!(report.contains(message), "{section}\n{report}");
        assert!(
            report.contains(place) && report.contains("^"),
            "{section}\n{report}"
        );
    }
    for (name, message) in [
        ("sin", "is a function"),
        ("x", "already a coordinate"),
        ("a b", "is not a name"),
    ] {
        let text = Sampled::text(BOX, LENS).replace("field.logn", &format!("field.\"{name}\""));
        let path = sampled.folder.path().join("m.toml").display().to_string();
        let error = Manifold::from_source(SourceText::new(path, text), &[]).unwrap_err();
        assert!(
            error.report(false).contains(message),
            "{}",
            error.report(false)
        );
    }
    let text = Sampled::text(BOX, LENS);
    let lost = Manifold::from_source(SourceText::new("nowhere/m.toml", text), &[]).unwrap_err();
    let report = lost.report(false);
    assert!(
        report.contains("no such file") && report.contains("relative to the manifold"),
        "{report}"
    );
}

/// Makes a bundle of `manifold` that has paths of zeros, with one camera parameter.
fn bundle_of(manifold: &Arc<Manifold>) -> Vec<u8> {
    let space = RaySpace::new(manifold.clone()).unwrap();
    let plan = PlanRecord::new(5.0, 0.5, vec![1], vec![1, 1, 1, 1]);
    let polynomial = Polynomial {
        coefficients: ArrayD::zeros(IxDyn(&[1, 1, 1, 1, 3])),
        variables: Variables::of_face(1, plan.mapping),
    };
    let tensor = Train::plain(&polynomial)
        .rounded(StepSize::near(1e-6))
        .unwrap();
    let chunk = Tree::Leaf(Arc::new(tensor)).encode();
    let chunks = (0..6).map(|face| (face, chunk.clone())).collect();
    let contents = Contents::new(space, plan, 0, chunks).unwrap();
    contents.encode().unwrap()
}

/// Checks that `bytes` alone are a bundle of `manifold`.
fn check_bundle(bytes: &[u8], manifold: &Manifold) {
    let bundle = Bundle::from_bytes(bytes).unwrap();
    assert_eq!(bundle.manifold.differences(manifold), [""; 0]);
    assert_eq!(bundle.contents().encode().unwrap(), bytes);
    let other = bundle.contents().manifold_with("b.fan", &[]).unwrap();
    assert_eq!(other.differences(manifold), [""; 0]);
}

const RAIL: &str =
    "[cameras]\nparameters = { c = [-1, 1] }\nat = [\"c\", \"0\", \"0\"]\nlength = 5.0\n";

#[test]
fn a_bundle_brings_its_samples_along() {
    let sampled = Sampled::new(17, |u| log_index(u, 0.0));
    let manifold = Arc::new(sampled.manifold(BOX, &format!("{LENS}\n{RAIL}")));
    let bytes = bundle_of(&manifold);
    assert!(bytes.len() < 17 * 17 * 17 * 4);
    // The reader has the bytes alone.
    drop(sampled);
    check_bundle(&bytes, &manifold);
}

#[test]
fn a_bundle_brings_the_places_along_that_only_an_image_tells() {
    let folder = tempfile::tempdir().unwrap();
    let numbers = cube(9, |u| log_index(u, 0.0));
    let numbers: Vec<String> = numbers.iter().map(f32::to_string).collect();
    let image = format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"ImageData\" byte_order=\"LittleEndian\">\n\
         <ImageData WholeExtent=\"0 8 0 8 0 8\" Origin=\"-4 -4 -5\" Spacing=\"1 1 1.25\">\n\
         <Piece Extent=\"0 8 0 8 0 8\">\n<PointData>\n<DataArray type=\"Float32\" Name=\"n\" format=\"ascii\">\n\
         {}\n</DataArray>\n</PointData>\n</Piece>\n</ImageData>\n</VTKFile>\n",
        numbers.join(" ")
    );
    fs::write(folder.path().join("n.vti"), image).unwrap();
    let load = |section: &str| {
        let name = folder.path().join("m.toml").display().to_string();
        let text = format!(
            "name = \"image\"\ncoordinates = [\"x\", \"y\", \"z\"]\n{LENS}\n[field.logn]\nfile = \"n.vti\"\n{section}\n{RAIL}"
        );
        Arc::new(Manifold::from_source(SourceText::new(name, text), &[]).unwrap())
    };
    let sections = ["", "box = { x = [-4, 4], y = [-4, 4], z = [-5, 5] }"];
    let [own, told] = sections.map(load);
    let bytes = [bundle_of(&own), bundle_of(&told)];
    drop(folder);
    check_bundle(&bytes[0], &own);
    check_bundle(&bytes[1], &told);
    // Both are the same space.
    let u = DVec3::new(0.3, -0.2, 0.7);
    assert_eq!(own.metric(u), told.metric(u));
}
