//! Metrics that are not smooth: one-sided derivatives at the kink, exact paths across it, and the jump
//! that their deviations take there.

mod support;

use geofan_core::{
    geodesic::{JacobiField, Path, Ray, exponential, paths},
    manifold::Manifold,
};
use glam::DVec3;
use support::{asset, manifold, settings};

/// `∂_x` of the conformal factor's square at the origin's plane, for n = 6 + f(x).
fn slope(f: &str, x: f64) -> f64 {
    let manifold = manifold(&format!("metric = {{ conformal = '6 + {f}' }}"));
    // g = n², so ∂g/∂x = 2 n n'.
    let found = manifold.curvature(DVec3::new(x, 0.2, -0.3)).unwrap();
    found.slopes[0][0][0] / (2.0 * found.metric.x_axis.x.sqrt())
}

#[test]
fn derivatives_at_a_kink_are_those_of_the_branch_taken_there() {
    let cases = [
        ("abs(x)", 1.0),
        ("abs(-x)", 1.0),
        ("min(x, 3*x)", 3.0),
        ("min(3*x, x)", 1.0),
        ("max(x, 3*x)", 1.0),
        ("max(3*x, x)", 3.0),
        ("if(x < 0, 2*x, 5*x)", 5.0),
        ("if(x <= 0, 2*x, 5*x)", 2.0),
        ("if(x > 0, 2*x, 5*x)", 5.0),
        ("if(x >= 0, 2*x, 5*x)", 2.0),
    ];
    for (f, expected) in cases {
        assert_eq!(slope(f, 0.0), expected, "{f}");
    }
}

#[test]
fn derivatives_beside_a_kink_are_those_of_their_side() {
    for (f, left, right) in [
        ("abs(x)", -1.0, 1.0),
        ("min(x, 3*x)", 3.0, 1.0),
        ("max(x, 3*x)", 1.0, 3.0),
        ("if(x < 0, 2*x, 5*x)", 2.0, 5.0),
    ] {
        assert!((slope(f, -1e-9) - left).abs() < 1e-12, "{f}");
        assert!((slope(f, 1e-9) - right).abs() < 1e-12, "{f}");
    }
}

#[test]
fn the_branch_that_is_not_taken_may_be_infinite() {
    assert_eq!(slope("if(x > 0, sqrt(x), x)", -0.5), 1.0);
    assert!((slope("if(x < 1, x, log(x - 2))", 0.5) - 1.0).abs() < 1e-14);
}

fn follow(manifold: &Manifold, ray: Ray, tolerance: f64) -> Path {
    paths(manifold, settings(tolerance, false), [ray]).remove(0)
}

fn area(manifold: &Manifold, path: &Path) -> f64 {
    let (step, s) = (path.steps.last().unwrap(), path.length);
    let inverse = manifold.standard_frame(step.position(s)).inverse();
    JacobiField::new(inverse, step.tangent(s), step.deviation(s).unwrap()).signed_area()
}

/// Metrics with kinks of each kind, all crossed by the ray of the tests below.
const KINKED: [&str; 5] = [
    "metric = { conformal = '1 + 0.5*abs(x - 0.3*y)' }",
    "metric = { conformal = 'min(1.2 + 0.1*z, 1.5 + 0.4*x)' }",
    "metric = { conformal = 'max(1, 1.5 - 0.4*x - 0.2*y)' }",
    "metric = { xx = 'if(x^2 + y^2 < 1, 2 - x^2 - y^2, 1)', yy = '1', zz = '1.5', xy = '0.2' }",
    "embedding = ['x', 'y', 'z', 'if(x < 0, x^2, -x^2)', 'abs(x + y)^3']",
];

fn ray(manifold: &Manifold) -> Ray {
    let d = DVec3::new(0.9, -0.2, 0.15).normalize();
    Ray::new(manifold, DVec3::new(-1.6, 0.4, -0.1), d, 4.0)
}

#[test]
fn deviations_behind_a_kink_are_those_of_neighbouring_rays() {
    for text in KINKED {
        let manifold = manifold(text);
        let ray = ray(&manifold);
        let u = ray.u;
        let w = ray.v * ray.length;
        let at = |w: DVec3| exponential(&manifold, u, w, 1e-13).unwrap();
        let found = at(w).differential;
        for axis in DVec3::AXES {
            let central = |h: f64| (at(w + axis * h).point - at(w - axis * h).point) / (2.0 * h);
            let expected = (central(1e-3) * 4.0 - central(2e-3)) / 3.0;
            let off = (found * axis - expected).length() / expected.length();
            assert!(off < 1e-7, "{text}: {off}");
        }
    }
}

#[test]
fn errors_follow_the_tolerance_across_kinks() {
    for text in KINKED {
        let manifold = manifold(text);
        let ray = ray(&manifold);
        let truth = follow(&manifold, ray, 1e-13);
        let end = |path: &Path| path.steps.last().unwrap().position(path.length);
        for tolerance in [1e-6, 1e-8, 1e-10] {
            let path = follow(&manifold, ray, tolerance);
            let off = (end(&path) - end(&truth)).length() / path.length;
            assert!(off < 20.0 * tolerance, "{text} at {tolerance}: {off}");
            let areas = [area(&manifold, &path), area(&manifold, &truth)];
            let off = (areas[0] / areas[1] - 1.0).abs();
            assert!(off < 300.0 * tolerance, "{text} at {tolerance}: {off}");
        }
    }
}

#[test]
fn a_kink_costs_a_few_steps_only() {
    for tolerance in [1e-6, 1e-10] {
        let steps = |slope: &str| {
            let manifold = manifold(&format!(
                "metric = {{ conformal = '1.5 + 0.4*x^2 + {slope}' }}"
            ));
            follow(&manifold, ray(&manifold), tolerance).tried
        };
        let smooth = steps("0.1*x").max(steps("-0.1*x"));
        let kinked = steps("0.1*abs(x)");
        println!("{tolerance}: {kinked} steps, without a kink {smooth}");
        assert!(kinked < smooth + 12);
    }
}

#[test]
fn the_edges_of_lenses_cost_a_few_steps_only() {
    let d = DVec3::new(-1.0, -0.05, 0.06).normalize();
    for name in ["luneburg", "maxwell-fish-eye"] {
        let lens = asset(name);
        let ray = Ray::new(&lens, DVec3::new(2.5, 0.3, 0.2), d, 6.0);
        // 32 steps at the least; both edges together cost about 20.
        for (tolerance, most) in [(1e-6, 80), (1e-10, 160)] {
            let tried = follow(&lens, ray, tolerance).tried;
            println!("{name} {tolerance}: {tried}");
            assert!(tried < most, "{name}: {tried} steps");
        }
    }
}

#[test]
fn rays_along_a_kink_are_followed() {
    // In the plane x = 0 the metric is flat, and rounding decides on which side of it a ray is.
    let fold = manifold("metric = { conformal = '1 + x*abs(x)' }");
    for d in [
        [0.0, 0.6, 0.8],
        [1e-9, 0.6, 0.8],
        [1e-5, 0.6, 0.8],
        [1e-3, 0.6, 0.8],
    ] {
        let d = DVec3::from(d).normalize();
        let path = follow(&fold, Ray::new(&fold, DVec3::ZERO, d, 3.0), 1e-10);
        assert_eq!(path.length, 3.0);
        assert!(path.tried < 500, "{} steps", path.tried);
        let end = path.steps.last().unwrap().position(3.0);
        // Near the plane x'' = 2x, so x grows from a tilt to sinh(3√2)/√2 = 24.6 times as much.
        assert!((end - d * 3.0).length() < 25.0 * d.x + 1e-9, "{end}");
    }
}

#[test]
fn both_kinds_of_lens_focus_with_the_area_of_their_closed_form() {
    // Inside the fish-eye the geometry is that of S³.
    let fish = asset("maxwell-fish-eye");
    let d = DVec3::new(0.3, -0.5, 0.6).normalize();
    let ray = Ray::new(&fish, DVec3::new(0.2, -0.1, 0.3), d, 0.6);
    let path = follow(&fish, ray, 1e-12);
    assert!((area(&fish, &path) - 0.6_f64.sin().powi(2)).abs() < 1e-10);
    // A point of the surface of Luneburg's lens becomes a parallel beam: the area stays the same.
    let lens = asset("luneburg");
    let start = DVec3::new(0.6, 0.0, 0.8);
    let inward = (-start + DVec3::new(0.1, 0.3, -0.2)).normalize();
    let beam = |length: f64| {
        area(
            &lens,
            &follow(&lens, Ray::new(&lens, start, inward, length), 1e-12),
        )
    };
    let (near, far) = (beam(4.0), beam(9.0));
    assert!((near / far - 1.0).abs() < 1e-9, "{near} {far}");
}

/// R. K. Luneburg, *Mathematical Theory of Optics* (1944), §29: light along `d` meets in the ball's point opposite.
#[test]
fn rays_from_far_away_and_long_ones_do_not_leap_over_a_ball() {
    let manifold = asset("luneburg");
    let d = DVec3::new(-3.0, 0.6, 0.1).normalize();
    for (length, tolerance) in [
        (9.0, 1e-8),
        (100.0, 1e-8),
        (300.0, 1e-10),
        (1000.0, 1e-6),
        (1000.0, 1e-8),
        (1e4, 1e-10),
        (1e7, 1e-8),
    ] {
        for beside in [0.05, 0.6, 0.9] {
            let u = beside * d.cross(DVec3::Z).normalize() - 3.0 * d;
            let ray = Ray::new(&manifold, u, d, length);
            let path = paths(&manifold, settings(tolerance, true), [ray]).remove(0);
            let (step, s) = (path.steps.last().unwrap(), path.length);
            let off = (step.position(s) - d).cross(step.tangent(s).normalize());
            let most = 1e3 * tolerance;
            assert!(off.length() < most, "{length} {tolerance} {beside}: {off}");
        }
    }
}

/// By scipy's DOP853 at a tolerance of 1e-11.
#[test]
fn long_rays_do_not_leap_over_what_lies_before_an_exit() {
    let gauss = "metric = { conformal = '1 + 0.5*exp(-(x^2 + 1.5*y^2 + 2*z^2)/2)' }\n\
                 exit = [{ name = 'sky', when = 'x^2 + y^2 + z^2 - 25' }]";
    let cubed = "metric = { conformal = '1 + 0.5*max(0, 1 - x^2 - y^2 - z^2)^3' }\n\
                 exit = [{ name = 'sky', when = 'x^2 + y^2 + z^2 - 3600' }]";
    let far = "metric = { conformal = '1 + 0.5*exp(-(x^2 + y^2 + z^2)/2)' }\n\
               exit = [{ name = 'sky', when = 'x^2 + y^2 + z^2 - 1e4' }]";
    let cases = [
        (
            gauss,
            DVec3::ZERO,
            DVec3::new(0.79, 0.13, -0.6),
            [7.0, 3000.0, 1e4, 1e8],
            DVec3::new(0.8780, 0.1216, -0.4629),
        ),
        (
            cubed,
            DVec3::X * 10.0,
            DVec3::new(-10.0, 0.7, 0.0),
            [80.0, 100.0, 300.0, 1e5],
            DVec3::new(-0.81721, -0.57634, 0.0),
        ),
        (
            far,
            DVec3::X * 60.0,
            DVec3::new(-60.0, 0.7, 0.2),
            [200.0, 1500.0, 1e5, 1e9],
            DVec3::new(-0.883646, -0.450143, -0.128612),
        ),
    ];
    for (text, u, d, lengths, behind) in cases {
        let manifold = manifold(text);
        for length in lengths {
            for tolerance in [1e-6, 1e-8, 1e-10] {
                let ray = Ray::new(&manifold, u, d.normalize(), length);
                let path = paths(&manifold, settings(tolerance, true), [ray]).remove(0);
                let v = path.steps.last().unwrap().tangent(path.length);
                assert!(v.abs_diff_eq(behind, 1e-4), "{length} {tolerance}: {v}");
            }
        }
    }
}
