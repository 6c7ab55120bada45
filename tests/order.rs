//! The order of the integrators, not only their accuracy: a wrong coefficient hides behind step
//! control. Rays start off every symmetry plane; the truth is a much tighter run.

mod support;

use geofan_core::{
    geodesic::{Path, Ray, Settings, fixed_steps, paths},
    manifold::Manifold,
};
use glam::DVec3;
use support::{asset, settings};

/// The tolerance of the runs that count as the truth.
const TIGHTEST: f64 = 1e-13;

/// The ray from `u` along `d` in a manifold of the catalogue.
fn case(name: &str, u: [f64; 3], d: [f64; 3], length: f64) -> (Manifold, Ray) {
    let manifold = asset(name);
    let ray = Ray::new(&manifold, u.into(), DVec3::from(d).normalize(), length);
    (manifold, ray)
}

/// Rays through the most curved parts.
fn cases() -> Vec<(Manifold, Ray)> {
    vec![
        case("three-bumps", [-1.3, 0.4, 0.7], [0.8, -0.5, -0.3], 4.0),
        case("gaussian-lens", [1.1, -0.6, 0.4], [-0.7, 0.5, 0.3], 3.0),
        case("sl2r", [0.2, -0.1, 0.3], [0.5, 0.6, -0.4], 3.0),
        case("nil", [0.3, -0.2, 0.1], [0.6, 0.3, 0.5], 6.0),
        case("schwarzschild", [2.1, 3.3, -1.7], [-0.2, -0.9, 0.6], 12.0),
    ]
}

/// Rays so long, and bent so evenly, that the tolerance sets the length of their steps, not the
/// limit that a step is a small share of its ray.
fn long_cases() -> Vec<(Manifold, Ray)> {
    vec![
        case("s3", [0.7, 0.4, -0.5], [0.1, 0.7, 0.4], 20.0),
        case("nil", [0.3, -0.2, 0.1], [0.6, 0.3, 0.5], 40.0),
        case("grin-rod", [0.2, -0.3, 0.4], [0.3, 0.25, 0.9], 30.0),
        case("s2xr", [0.6, 0.5, -0.7], [0.2, -0.7, 0.4], 25.0),
    ]
}

fn follow(manifold: &Manifold, ray: Ray, tolerance: f64) -> Path {
    paths(manifold, settings(tolerance, false), [ray]).remove(0)
}

/// Position (over arc length) and tangent of `path` at `s` against `truth`, in the metric.
fn position_and_tangent_off(manifold: &Manifold, path: &Path, truth: &Path, s: f64) -> f64 {
    let (step, exact) = (path.step_at(s).unwrap(), truth.step_at(s).unwrap());
    let inverse = manifold.standard_frame(exact.position(s)).inverse();
    let length = |x: DVec3| (inverse * x).length();
    let position = length(step.position(s) - exact.position(s)) / s;
    position.max(length(step.tangent(s) - exact.tangent(s)))
}

/// Everything that a path carries, at `s`, against `truth`.
fn all_off(manifold: &Manifold, path: &Path, truth: &Path, s: f64) -> f64 {
    let (step, exact) = (path.step_at(s).unwrap(), truth.step_at(s).unwrap());
    let inverse = manifold.standard_frame(exact.position(s)).inverse();
    let (q, truly) = (step.rotation(s).unwrap(), exact.rotation(s).unwrap());
    let turn = 2.0 * (q.inverse() * truly).xyz().length();
    let (j, truly) = (step.deviation(s).unwrap(), exact.deviation(s).unwrap());
    let deviation = [0, 1].map(|k| {
        let (off, size) = (inverse * (j[k] - truly[k]), inverse * truly[k]);
        off.length() / size.length().max(s)
    });
    position_and_tangent_off(manifold, path, truth, s)
        .max(turn)
        .max(deviation[0])
        .max(deviation[1])
}

fn list(numbers: &[f64]) -> String {
    let short: Vec<String> = numbers.iter().map(|x| format!("{x:.1e}")).collect();
    short.join(" ")
}

#[test]
fn the_error_of_equal_steps_falls_sixteenfold_when_they_are_halved() {
    for (manifold, ray) in cases() {
        let truth = follow(&manifold, ray, TIGHTEST);
        let end = truth.steps.last().unwrap();
        let inverse = manifold.standard_frame(end.position(ray.length)).inverse();
        let error = |steps: usize| {
            let knots = fixed_steps::<f64>(&manifold, &[(ray.u, ray.v)], ray.length, steps);
            let u = *knots[0].0.last().unwrap();
            (inverse * (u - end.position(ray.length))).length()
        };
        let errors = [128, 256, 512].map(error);
        println!("{:20} {}", manifold.name, list(&errors));
        for pair in errors.windows(2) {
            let ratio = pair[0] / pair[1];
            assert!(
                (12.0..20.0).contains(&ratio),
                "{}: {errors:?} falls by {ratio}",
                manifold.name
            );
        }
    }
}

#[test]
fn the_error_of_adaptive_steps_follows_the_tolerance() {
    for (manifold, ray) in long_cases() {
        let truth = follow(&manifold, ray, TIGHTEST);
        let exponents = 5..=11;
        let tolerances: Vec<f64> = exponents.map(|e| 10.0_f64.powi(-e)).collect();
        let runs: Vec<Path> = tolerances
            .iter()
            .map(|t| follow(&manifold, ray, *t))
            .collect();
        let error = |path: &Path| position_and_tangent_off(&manifold, path, &truth, path.length);
        let errors: Vec<f64> = runs.iter().map(error).collect();
        let slope = slope(&tolerances, &errors);
        println!("{:20} slope {slope:.2} {}", manifold.name, list(&errors));
        for (error, tolerance) in errors.iter().zip(&tolerances) {
            // The tolerance is of one step; errors of about a hundred steps add up.
            assert!(
                *error <= 100.0 * tolerance,
                "{}: {errors:?} for {tolerances:?}",
                manifold.name
            );
        }
        assert!(
            (0.8..1.25).contains(&slope),
            "{}: slope {slope}, {errors:?}",
            manifold.name
        );
        // A method of order five takes 10^(4/5) times as many steps for 10⁻⁴ of the error.
        let growth = runs[6].tried as f64 / runs[2].tried as f64;
        assert!(
            (4.8..7.6).contains(&growth),
            "{}: steps grow by {growth}",
            manifold.name
        );
    }
}

/// The slope of the line of least squares through (log x, log y).
fn slope(x: &[f64], y: &[f64]) -> f64 {
    let points: Vec<(f64, f64)> = x.iter().zip(y).map(|(x, y)| (x.ln(), y.ln())).collect();
    let n = points.len() as f64;
    let middle = |f: fn(&(f64, f64)) -> f64| points.iter().map(f).sum::<f64>() / n;
    let (mx, my) = (middle(|p| p.0), middle(|p| p.1));
    let cross: f64 = points.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum();
    let square: f64 = points.iter().map(|p| (p.0 - mx).powi(2)).sum();
    cross / square
}

#[test]
fn paths_are_as_exact_inside_their_steps_as_at_the_ends() {
    for (manifold, ray) in cases().into_iter().chain(long_cases()) {
        let truth = follow(&manifold, ray, TIGHTEST);
        for tolerance in [1e-5, 1e-7, 1e-9] {
            let path = follow(&manifold, ray, tolerance);
            let worst = |fraction: f64| {
                let at = path
                    .steps
                    .iter()
                    .map(|step| step.start + fraction * (step.end - step.start));
                let off = at.map(|s| all_off(&manifold, &path, &truth, s));
                off.fold(0.0, f64::max)
            };
            let ends = worst(1.0);
            let inside = [0.1, 0.3, 0.5, 0.7, 0.9].map(worst);
            println!(
                "{:20} {tolerance:.0e}: ends {ends:.1e}, inside {}",
                manifold.name,
                list(&inside)
            );
            for inside in inside {
                assert!(
                    inside <= 3.0 * ends.max(tolerance),
                    "{} at {tolerance}: {inside} inside, {ends} at the ends",
                    manifold.name
                );
            }
        }
    }
}

/// Rays share the lanes of one integration; what a ray meets must not depend on its company.
#[test]
fn a_ray_followed_alone_is_the_ray_followed_among_others_to_the_last_bit() {
    for (manifold, ray) in cases() {
        let settings = Settings::bare(1e-7)
            .with_frame()
            .with_deviation()
            .with_events();
        let company = (1..=100).map(|k| Ray {
            length: ray.length * f64::from(k) / 100.0,
            ..Ray::new(
                &manifold,
                ray.u,
                DVec3::new(0.1 * f64::from(k), 1.0, -0.5).normalize(),
                1.0,
            )
        });
        let company: Vec<Ray> = company.collect();
        let together = paths(&manifold, settings, company.iter().copied());
        for k in [0, 17, 31, 32, 63, 64, 99] {
            let alone = paths(&manifold, settings, [company[k]]).remove(0);
            let (a, b) = (
                alone.steps.last().unwrap(),
                together[k].steps.last().unwrap(),
            );
            let s = alone.length;
            assert_eq!(alone.tried, together[k].tried);
            assert_eq!(s, together[k].length);
            assert_eq!(a.position(s), b.position(s));
            assert_eq!(a.rotation(s), b.rotation(s));
            assert_eq!(a.deviation(s), b.deviation(s));
        }
    }
}
