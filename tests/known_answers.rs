//! Closed-form truths about manifolds written here, with exits, and with orbit planes tilted off every
//! coordinate plane.

mod support;

use geofan_core::{
    geodesic::{End, Path, Ray, Settings, paths},
    manifold::Manifold,
    random::Stream,
};
use glam::{DMat3, DQuat, DVec3};
use support::{asset, manifold, settings};

fn follow(manifold: &Manifold, u: DVec3, d: DVec3, length: f64) -> Path {
    let ray = Ray::new(manifold, u, d.normalize(), length);
    paths(manifold, settings(1e-11, true), [ray]).remove(0)
}

/// A tilt off every coordinate plane.
fn tilts() -> [DMat3; 2] {
    let axis = DVec3::new(0.3, -0.7, 0.4).normalize();
    [
        DMat3::IDENTITY,
        DMat3::from_quat(DQuat::from_axis_angle(axis, 1.1)),
    ]
}

/// The angle swept about the origin by a path, followed step by step.
fn swept(path: &Path) -> f64 {
    let mut points = vec![path.steps[0].position(0.0)];
    points.extend(path.steps.iter().map(|s| s.position(s.end)));
    points.windows(2).map(|w| w[0].angle_between(w[1])).sum()
}

/// Starts on the sphere of chart radius `rho`, inwards with sine `sine` to the radius, and ends
/// where the path comes back to it.
fn orbit(text: &str, rho: f64, sine: f64, tilt: DMat3) -> f64 {
    let manifold = manifold(text);
    let d = DVec3::new(-(1.0 - sine * sine).sqrt(), sine, 0.0);
    // Conformal charts: the standard frame is parallel to the coordinates, so tilting is plain.
    let path = follow(
        &manifold,
        tilt * DVec3::new(rho, 0.0, 0.0),
        tilt * d,
        1000.0,
    );
    assert!(matches!(path.end, End::Exit(0)));
    swept(&path)
}

#[test]
fn ellis_wormhole_sweeps_the_known_angle() {
    let text = r#"
metric = { conformal = "1 + 1/(4*rho^2)" }
[let]
rho = "sqrt(x^2 + y^2 + z^2)"
[[exit]]
name = "out"
when = "rho - 1/(4*rho) - 30"
"#;
    let rho = (30.0 + (30.0_f64 * 30.0 + 1.0).sqrt()) / 2.0;
    for tilt in tilts() {
        let angle = orbit(text, rho, 2.0 / 901.0_f64.sqrt(), tilt);
        assert!((angle - 3.238117894627).abs() < 1e-8, "{angle}");
    }
}

#[test]
fn schwarzschild_sweeps_the_known_angle() {
    let text = r#"
metric = { conformal = "(1 + 1/(2*rho))^3/(1 - 1/(2*rho))" }
[let]
rho = "sqrt(x^2 + y^2 + z^2)"
[domain]
inside = ["rho - 0.501"]
[[exit]]
name = "out"
when = "rho*(1 + 1/(2*rho))^2 - 50"
"#;
    let r: f64 = 50.0;
    let rho = (r - 1.0 + (r * r - 2.0 * r).sqrt()) / 2.0;
    // sin of the angle to the radius: b √(1 − 2/r) / r
    let sine = 6.0 * (1.0 - 2.0 / r).sqrt() / r;
    for tilt in tilts() {
        let angle = orbit(text, rho, sine, tilt);
        assert!((angle - 4.6204187268812).abs() < 1e-8, "{angle}");
    }
}

#[test]
fn sphere_paths_meet_at_the_antipode_and_close() {
    let manifold = asset("s3");
    let u = DVec3::new(0.3, -0.2, 0.4);
    let antipode = -u / u.length_squared();
    for d in [
        DVec3::X,
        DVec3::new(0.2, 0.5, -0.7),
        DVec3::new(-1.0, 0.3, 0.1),
    ] {
        let path = follow(&manifold, u, d, 2.0 * std::f64::consts::PI);
        let half = std::f64::consts::PI;
        let meet = path.step_at(half).unwrap().position(half);
        let close = path.steps.last().unwrap().position(path.length);
        assert!(
            (meet - antipode).length() < 1e-8,
            "{}",
            (meet - antipode).length()
        );
        assert!((close - u).length() < 1e-8);
    }
}

/// A ball of radius 0.05 of denser medium: space is exactly flat around it, so that no error estimate
/// tells of it before a stage lies inside.
#[test]
fn rays_through_a_small_lens_in_flat_space_do_not_leap_over_it() {
    let text = r#"
metric = { conformal = "if(r2 < 0.0025, (2 - r2/0.0025)^2, 1)" }
[let]
r2 = "(x - 0.3)^2 + (y + 0.2)^2 + (z - 0.1)^2"
"#;
    let manifold = manifold(text);
    let centre = DVec3::new(0.3, -0.2, 0.1);
    let length = 2.0;
    for k in 0..400 {
        let mut random = Stream::new(&[k]);
        let d = random.direction();
        let side = 0.035 * random.direction().cross(d).normalize();
        let from = random.between(0.2, 1.5);
        let u = centre + side - d * from;
        for tolerance in [1e-4, 1e-6, 1e-9] {
            let settings = Settings::bare(tolerance);
            let path = paths(&manifold, settings, [Ray::new(&manifold, u, d, length)]).remove(0);
            let out = path.steps.last().unwrap().tangent(path.length);
            assert!(
                out.angle_between(d) > 0.1,
                "ray {k} at {tolerance} went straight on"
            );
        }
    }
}
