//! Closed-form truths on the manifold files themselves, with orbit planes tilted off every coordinate
//! plane.

mod support;

use geofan_core::{
    geodesic::{End, JacobiField, Path, Ray, conjugate_points, paths},
    manifold::Manifold,
};
use glam::{DMat3, DQuat, DVec3};
use std::f64::consts::{FRAC_PI_2, PI};
use support::{asset, settings};

/// The path from `u` along the chart vector `v`, of any length, past all exits.
fn along(manifold: &Manifold, u: DVec3, v: DVec3, length: f64) -> Path {
    let d = manifold.standard_frame(u).inverse() * v;
    let ray = Ray::new(manifold, u, d.normalize(), length);
    let path = paths(manifold, settings(1e-12, false), [ray]).remove(0);
    assert_eq!(path.end, End::Length);
    path
}

fn end(path: &Path) -> DVec3 {
    path.steps.last().unwrap().position(path.length)
}

fn area(manifold: &Manifold, path: &Path, s: f64) -> f64 {
    let step = path.step_at(s).unwrap();
    let inverse = manifold.standard_frame(step.position(s)).inverse();
    JacobiField::new(inverse, step.tangent(s), step.deviation(s).unwrap())
        .signed_area()
        .abs()
}

/// Rotations that tilt the plane of x and y off every coordinate plane.
fn tilts() -> [DMat3; 2] {
    let tilt = |x: f64, y: f64, z: f64, angle: f64| {
        DMat3::from_quat(DQuat::from_axis_angle(
            DVec3::new(x, y, z).normalize(),
            angle,
        ))
    };
    [tilt(0.3, -0.7, 0.4, 1.1), tilt(-0.5, 0.2, 0.9, 2.3)]
}

/// The path from chart radius `rho` at an angle to the outward radius whose cosine is `cosine`.
fn orbit(manifold: &Manifold, tilt: DMat3, rho: f64, cosine: f64, length: f64) -> Path {
    let u = tilt * DVec3::new(rho, 0.0, 0.0);
    let g = manifold.metric(u);
    let unit = |v: DVec3| v / v.dot(g * v).sqrt();
    let v = unit(tilt * DVec3::X) * cosine + unit(tilt * DVec3::Y) * (1.0 - cosine * cosine).sqrt();
    along(manifold, u, v, length)
}

/// The angle swept about the origin.
fn swept(path: &Path) -> f64 {
    let mut points = vec![path.steps[0].position(0.0)];
    points.extend(path.steps.iter().map(|s| s.position(s.end)));
    points
        .windows(2)
        .map(|w| w[0].cross(w[1]).length().atan2(w[0].dot(w[1])))
        .sum()
}

/// So far out that what is left of the angle is b over the radius, to 1e-17.
const FAR: f64 = 1e6;

fn assert_close(what: &str, found: f64, expected: f64, bound: f64) {
    println!("{what}: off by {:.1e}", (found - expected).abs());
    assert!(
        (found - expected).abs() <= bound,
        "{what}: {found} instead of {expected}"
    );
}

#[test]
fn light_past_an_ellis_wormhole_is_deflected_by_the_known_angles() {
    let manifold = asset("ellis-wormhole");
    let known = [
        (2.0, 0.2299080560354),
        (1.1, 1.5022554199624),
        (5.0, 0.0321430413185),
    ];
    for tilt in tilts() {
        for (b, expected) in known {
            // From the closest point, where the areal radius is b.
            let l = f64::sqrt(b * b - 1.0);
            let angle = swept(&orbit(&manifold, tilt, (l + b) / 2.0, 0.0, FAR));
            let found = 2.0 * (angle + b / FAR) - PI;
            assert_close(&format!("b = {b}"), found, expected, 1e-9);
        }
    }
}

#[test]
fn light_through_wormholes_sweeps_the_known_angles() {
    let known = [
        ("ellis-wormhole", 1.6857503548126),
        ("interstellar-wormhole", 1.18137496623),
    ];
    for tilt in tilts() {
        for (name, expected) in known {
            // From the throat, of radius 1 at chart radius ½, with b = ½.
            let angle = swept(&orbit(&asset(name), tilt, 0.5, 0.75_f64.sqrt(), FAR));
            assert_close(name, 2.0 * (angle + 0.5 / FAR), expected, 1e-9);
        }
    }
}

/// The isotropic radius of an areal radius, M = 1.
fn isotropic(areal: f64) -> f64 {
    (areal - 1.0 + (areal * areal - 2.0 * areal).sqrt()) / 2.0
}

#[test]
fn light_past_a_black_hole_is_deflected_by_the_known_angles() {
    let manifold = asset("schwarzschild");
    let known = [
        (6.0, 1.7193883102302),
        (10.0, 0.5903957876058),
        (20.0, 0.2361359953885),
        (100.0, 0.0412225397493),
    ];
    for tilt in tilts() {
        for (b, expected) in known {
            // The closest areal radius is the larger root of r³ = b² (r − 2); Newton from above.
            let mut r: f64 = b;
            for _ in 0..60 {
                r -= (r * r * r - b * b * (r - 2.0)) / (3.0 * r * r - b * b);
            }
            let path = orbit(&manifold, tilt, isotropic(r), 0.0, FAR);
            let rho = end(&path).length();
            let areal = rho * (1.0 + 0.5 / rho).powi(2);
            let found = 2.0 * (swept(&path) + b / areal) - PI;
            assert_close(&format!("b = {b}"), found, expected, 1e-9);
        }
    }
}

#[test]
fn the_shadow_of_a_black_hole_has_the_known_half_angle() {
    let manifold = asset("schwarzschild");
    for (tilt, (areal, degrees)) in tilts()
        .into_iter()
        .zip([(6.0, 45.0), (10.0, 27.6945614508)])
    {
        let u = tilt * DVec3::new(isotropic(areal), 0.0, 0.0);
        let captured = |angle: f64| {
            // Conformal: the standard frame is parallel to the coordinates.
            let d = tilt * DVec3::new(-angle.cos(), angle.sin(), 0.0);
            let ray = Ray::new(&manifold, u, d, 400.0);
            let end = paths(&manifold, settings(1e-11, true), [ray]).remove(0).end;
            match end.name(&manifold) {
                "sky" => false,
                "horizon" => true,
                other => panic!("{angle}: {other}"),
            }
        };
        let (mut inside, mut outside) = (0.1, 2.0);
        while outside - inside > 1e-11 {
            let middle = 0.5 * (inside + outside);
            match captured(middle) {
                true => inside = middle,
                false => outside = middle,
            }
        }
        assert_close(
            &format!("shadow from {areal}"),
            inside.to_degrees(),
            degrees,
            1e-8,
        );
    }
}

#[test]
fn a_gaussian_bump_deflects_by_the_known_angles() {
    let manifold = asset("gaussian-bump");
    let known = [
        (0.5, 0.3242617359016),
        (1.0, 0.3032443164935),
        (2.0, 0.03203006981698),
    ];
    for tilt in tilts() {
        for (b, expected) in known {
            let path = orbit(&manifold, tilt, b, 0.0, 1e3);
            let angle = swept(&path) + (b / end(&path).length()).asin();
            let found = (2.0 * angle - PI).abs();
            assert_close(&format!("b = {b}"), found, expected, 1e-9);
        }
    }
}

#[test]
fn solid_angles_spread_by_the_law_of_their_curvature() {
    let u = DVec3::new(0.2, -0.3, 0.45);
    /// Radius of the sphere of points at a distance.
    type Law = fn(f64) -> f64;
    let laws: [(&str, f64, Law); 6] = [
        ("s3", 2.8, f64::sin),
        ("s3-graph", 0.5, f64::sin),
        ("h3-ball", 4.0, f64::sinh),
        ("h3-half-space", 4.0, f64::sinh),
        ("flat", 7.0, |s| s),
        ("rolled-sheet", 7.0, |s| s),
    ];
    for (name, length, law) in laws {
        let manifold = asset(name);
        for v in [[0.3, 0.8, -0.5], [-0.6, 0.1, 0.4], [0.2, -0.4, -0.7]] {
            let path = along(&manifold, u, v.into(), length);
            for s in [0.1, 0.3, 0.55, 0.8, 1.0].map(|part| part * length) {
                let expected = law(s).powi(2);
                let found = area(&manifold, &path, s) / expected;
                assert!((found - 1.0).abs() < 1e-9, "{name} at {s}: {found}");
            }
        }
    }
}

#[test]
fn a_luneburg_lens_brings_parallel_rays_to_one_point() {
    let manifold = asset("luneburg");
    for tilt in tilts() {
        for distance in [1.5, 3.0, 20.0] {
            for i in 0..96 {
                let height = 0.01 * f64::from(i);
                let start = tilt * DVec3::new(-distance, height, 0.0);
                let path = along(&manifold, start, tilt * DVec3::X, distance + FRAC_PI_2);
                let off = (end(&path) - tilt * DVec3::X).length();
                assert!(off < 1e-8, "from {distance}, height {height}: {off}");
            }
        }
    }
}

#[test]
fn nil_geodesics_are_spirals_with_the_known_area() {
    let manifold = asset("nil");
    for d in [[0.5, -0.4, 0.6], [-0.7, 0.2, -0.3], [0.1, 0.9, 0.2]] {
        let d = DVec3::from(d).normalize();
        let (a, c, turn) = (d.x.hypot(d.y), d.z, d.y.atan2(d.x));
        let path = along(&manifold, DVec3::ZERO, d, 9.0);
        for s in [0.7, 2.9, 5.3, 9.0] {
            let w = c * s;
            let radius = 2.0 * a / c * (w / 2.0).sin();
            let angle = w / 2.0 + turn;
            let z = w + a * a / (2.0 * c * c) * (w - w.sin());
            let expected = DVec3::new(radius * angle.cos(), radius * angle.sin(), z);
            let found = path.step_at(s).unwrap().position(s);
            assert!((found - expected).length() < 1e-9, "{found} {expected}");
            let spread = 2.0 - 2.0 * w.cos() - w * (1.0 - c * c) * w.sin();
            let spread = spread.abs() / c.powi(4);
            let found = area(&manifold, &path, s);
            assert!((found - spread).abs() < 1e-9 * s * s, "{found} {spread}");
        }
    }
}

#[test]
fn nil_geodesics_have_their_conjugate_points_where_the_area_vanishes() {
    let manifold = asset("nil");
    for d in [[0.5, -0.4, 0.6], [-0.7, 0.2, -0.3]] {
        let d = DVec3::from(d).normalize();
        let (c, length) = (d.z.abs(), 34.0);
        // sin(w/2) = 0, and tan(w/2) = (1 − c²) w/2 once in each branch of the tangent but the first.
        let mut expected = Vec::new();
        for branch in 1..10 {
            let (mut low, mut high) = (f64::from(branch) * PI, (f64::from(branch) + 0.5) * PI);
            expected.push(2.0 * low / c);
            for _ in 0..60 {
                let x = 0.5 * (low + high);
                match x.tan() < (1.0 - c * c) * x {
                    true => low = x,
                    false => high = x,
                }
            }
            expected.push(2.0 * low / c);
        }
        expected.retain(|s| *s < length);
        let ray = Ray::new(&manifold, DVec3::ZERO, d, length);
        let path = paths(&manifold, settings(1e-12, false), [ray]).remove(0);
        let found = conjugate_points(&manifold, &ray, &path);
        assert_eq!(found.len(), expected.len(), "{found:?} {expected:?}");
        for (a, b) in found.iter().zip(&expected) {
            assert!((a - b).abs() < 1e-8, "{found:?} {expected:?}");
        }
    }
}

#[test]
fn a_sol_geodesic_ends_at_the_known_point() {
    let d = DVec3::new(0.6, 0.5, 0.39_f64.sqrt());
    let found = end(&along(&asset("sol"), DVec3::ZERO, d, 5.0));
    let expected = DVec3::new(3.27790077, 4.09009073, -0.19595538);
    assert!((found - expected).abs().max_element() < 6e-9, "{found}");
}

#[test]
fn geodesics_of_a_rolled_sheet_are_straight_in_its_chart() {
    let manifold = asset("rolled-sheet");
    let u = DVec3::new(1.3, -0.4, 0.8);
    for v in [[0.3, 0.8, -0.5], [-0.9, 0.1, 0.2]] {
        let v = DVec3::from(v).normalize();
        let path = along(&manifold, u, v, 10.0);
        for s in [1.7, 6.1, 10.0] {
            let step = path.step_at(s).unwrap();
            assert!((step.position(s) - (u + v * s)).length() < 1e-13);
            assert!((step.tangent(s) - v).length() < 1e-14);
            assert!(step.rotation(s).unwrap().w.abs() > 1.0 - 1e-15);
        }
    }
}

#[test]
fn the_normal_of_an_orbit_plane_stays_parallel() {
    let orbits = [
        ("schwarzschild", 4.0, -0.3, 30.0),
        ("ellis-wormhole", 2.0, -0.9, 20.0),
        ("interstellar-wormhole", 2.0, -0.95, 20.0),
        ("gaussian-bump", 2.5, -0.9, 8.0),
        ("cone", 3.0, -0.8, 12.0),
    ];
    for tilt in tilts() {
        for (name, rho, cosine, length) in orbits {
            let manifold = asset(name);
            let path = orbit(&manifold, tilt, rho, cosine, length);
            // The unit normal at a point of the path, in the standard frame there.
            let normal =
                |u: DVec3| (manifold.standard_frame(u).inverse() * (tilt * DVec3::Z)).normalize();
            let start = normal(path.steps[0].position(0.0));
            for step in &path.steps {
                let s = step.end;
                let carried = step.rotation(s).unwrap() * start;
                let off = (carried - normal(step.position(s))).length();
                assert!(off < 1e-9, "{name} at {s}: {off}");
            }
        }
    }
}

#[test]
fn a_carried_frame_is_still_orthonormal_after_ten_thousand_steps() {
    let manifold = asset("s3");
    let turns = 90.0;
    let v = DVec3::new(0.1, 0.7, 0.4);
    let path = along(&manifold, DVec3::new(0.7, 0.4, -0.5), v, turns * 2.0 * PI);
    assert!(path.steps.len() >= 10_000, "{} steps", path.steps.len());
    for step in path.steps.iter().rev().step_by(997) {
        let r = DMat3::from_quat(step.rotation(step.end).unwrap());
        let off = r.transpose() * r - DMat3::IDENTITY;
        assert!(off.abs().to_cols_array().iter().all(|x| *x < 1e-13));
    }
    // A great circle brings its frame back unturned.
    let q = path.steps.last().unwrap().rotation(path.length).unwrap();
    let turn = 2.0 * q.xyz().length();
    println!("{} steps, turned by {turn:.1e}", path.steps.len());
    assert!(turn < 1e-9, "{turn}");
}
