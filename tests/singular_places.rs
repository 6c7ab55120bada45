//! Objects where the chart is singular, or all but: refused at once, with the place in the scene.

use geofan_core::{
    Error,
    diagnostic::SourceText,
    geodesic::{End, Ray, Settings, paths},
    manifold::Manifold,
};
use geofan_render::Stage;
use glam::DVec3;
use std::{path::Path, time::Instant};

/// A triangle in flat space in spherical coordinates, at this colatitude.
fn refusal(folder: &Path, theta: &str, placement: &str) -> String {
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).unwrap();
    write(
        "space.toml",
        "name = 'space'\ncoordinates = ['r', 'theta', 'phi']\n\
         embedding = ['r*sin(theta)*cos(phi)', 'r*sin(theta)*sin(phi)', 'r*cos(theta)']\n\
         [domain]\nr = [0.001, 100]\ntheta = [0, 3.141592653589793]\nphi = [0, 6.283185307179586]\n\
         periodic = ['phi']\n[cameras]\nlength = 40\n",
    );
    write("triangle.obj", "v 0 -1 -1\nv 0 1 -1\nv 0 0 1\nf 1 2 3\n");
    let scene = format!(
        "manifold = 'space.toml'\n\
         camera = {{ at = [5, 0.6, 0.3], look = [-1, 0, 0], up = [0, -1, 0] }}\n\
         [[object]]\nmesh = 'triangle.obj'\nat = [1.5, {theta}, 0.0]\nscale = 0.3\nplacement = '{placement}'\n"
    );
    write("scene.toml", &scene);
    let began = Instant::now();
    let loaded = Stage::load(&folder.join("scene.toml"), &[]);
    assert!(began.elapsed().as_secs() < 20, "{theta}, {placement}");
    match loaded {
        Ok(_) => String::new(),
        Err(error @ Error::Source(_)) => error.report(false),
        Err(error) => panic!("{error} has no place"),
    }
}

/// A sphere with a fibre of no length: rounding leaves pivots of either sign.
#[test]
fn a_metric_without_a_direction_is_refused_whatever_rounding_leaves_of_it() {
    let at = |fibre: f64| {
        let text = format!(
            "name = 'Berger sphere'\ncoordinates = ['x', 'y', 'z']\nparameters = {{ e = {fibre} }}\n\
             let = {{ r2 = 'x^2 + y^2 + z^2', q = '2/(1 + r2)^2', k = '1 - e^2', a = 'q*(1 - r2 + 2*x*x)', \
             b = 'q*(2*x*y + 2*z)', c = 'q*(2*x*z - 2*y)' }}\n\
             [metric]\nxx = '4/(1 + r2)^2 - k*a^2'\nyy = '4/(1 + r2)^2 - k*b^2'\nzz = '4/(1 + r2)^2 - k*c^2'\n\
             xy = '-k*a*b'\nxz = '-k*a*c'\nyz = '-k*b*c'\n[cameras]\nat = ['0.2', '0.1', '-0.3']\nlength = 3\n"
        );
        Manifold::from_source(SourceText::new("berger.toml", text), &[])
    };
    assert!(at(1e-4).is_ok());
    let report = at(0.0).unwrap_err().report(false);
    assert!(report.contains("not positive definite"), "{report}");
}

#[test]
fn objects_at_the_poles_of_spherical_coordinates_are_refused_with_their_place() {
    let folder = tempfile::tempdir().unwrap();
    for placement in ["linear", "exponential"] {
        let report = refusal(folder.path(), "0", placement);
        assert!(report.contains("not positive definite"), "{report}");
        assert!(report.contains("scene.toml:5:6"), "{report}");
        // The other pole is missed by rounding.
        let report = refusal(folder.path(), "3.141592653589793", placement);
        assert!(report.contains("all but singular"), "{report}");
        assert!(report.contains("scene.toml:5:6"), "{report}");
    }
}

#[test]
fn objects_that_a_pole_winds_around_it_are_refused_and_others_are_not() {
    let folder = tempfile::tempdir().unwrap();
    let report = refusal(folder.path(), "1e-9", "linear");
    assert!(report.contains("times around in `phi`"), "{report}");
    let report = refusal(folder.path(), "1e-9", "exponential");
    assert!(report.contains("leave the manifold"), "{report}");
    for placement in ["linear", "exponential"] {
        assert_eq!(refusal(folder.path(), "1.2", placement), "");
    }
}

/// A light-guiding fibre whose index is written by the distance from its axis, which has no derivatives there.
#[test]
fn nothing_starts_where_the_metric_has_no_derivatives() {
    let text = "name = 'fibre'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1.5/cosh(0.4*sqrt(x^2 + y^2))' }\n";
    let fibre = Manifold::from_source(SourceText::new("fibre.toml", text), &[]).unwrap();
    let start =
        |x: f64| geofan_core::geodesic::check_start(&fibre, "--at", DVec3::new(x, 0.0, 1.0));
    let refused = start(0.0).unwrap_err().to_string();
    assert!(
        refused.contains("x = 0, y = 0, z = 1: the metric has no derivatives there"),
        "{refused}"
    );
    for x in [1e-9, 1e-3, 2.0] {
        assert!(start(x).is_ok(), "{x}");
    }
}

/// Flat space in coordinates that lose their digits beside the disc or strip between their foci.
fn confocal(pullback: [&str; 3], metric: [&str; 3]) -> Manifold {
    let [mu, nu, third] = pullback;
    let [a, b, c] = metric;
    let text = format!(
        "name = 'flat'\ncoordinates = ['x', 'y', 'z']\n\
         pullback = {{ mu = '{mu}', nu = '{nu}', third = '{third}' }}\n\
         metric = {{ mumu = '{a}', nunu = '{b}', thirdthird = '{c}' }}\n"
    );
    Manifold::from_source(SourceText::new("confocal", &text), &[]).unwrap()
}

/// Shorter steps see more of the rounding noise there; longer ones pass over it.
#[test]
fn rays_pass_over_rounding_noise_of_coordinates_or_end_soon() {
    let area = "sinh(mu)^2 + sin(nu)^2";
    let far = |x: &str, y: &str| {
        format!("acosh((sqrt(({x} + 1)^2 + {y}^2) + sqrt(({x} - 1)^2 + {y}^2))/2)")
    };
    let oblate = [
        far("sqrt(x^2 + y^2)", "z"),
        "asin(z/sinh(mu))".into(),
        "atan2(y, x)".into(),
    ];
    let oblate = confocal(
        oblate.each_ref().map(String::as_str),
        [area, area, "(cosh(mu)*cos(nu))^2"],
    );
    let strip = [
        far("x", "y"),
        "atan2(y/sinh(mu), x/cosh(mu))".into(),
        "z".into(),
    ];
    let strip = confocal(strip.each_ref().map(String::as_str), [area, area, "1"]);
    let follow = |space: &Manifold, u: DVec3, d: DVec3| {
        paths(space, Settings::bare(1e-10), [Ray::new(space, u, d, 3.0)]).remove(0)
    };
    // Through the middle of the disc.
    let u = DVec3::new(0.31, -0.74, 0.52);
    let path = follow(&oblate, u, DVec3::NEG_Z);
    assert_eq!(path.end, End::Length);
    let off = path.steps.last().unwrap().position(3.0) - (u - DVec3::Z * 3.0);
    assert!(off.length() < 1e-7, "{off}");
    // Against the strip, where no step passes.
    let u = DVec3::new(0.3, 0.7, -0.2);
    let v = DVec3::new(0.0, -1.0, 0.1).normalize();
    let path = follow(&strip, u, v);
    let steps = path.steps.len();
    assert!(
        path.end == End::Singular && steps < 5_000,
        "{:?} {steps}",
        path.end
    );
}
