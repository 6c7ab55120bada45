//! Spaces written in textbook coordinates and pulled back to the chart, against the same spaces written in
//! the chart's own: paths over poles, starts on axes, winds, drifts and whole spacetimes.

mod support;

use geofan_core::{
    geodesic::{Path, Ray, Settings, elapsed, paths},
    manifold::Manifold,
    random::Stream,
};
use geofan_render::{Ending, ExactTracer, Stage};
use glam::{DMat3, DVec3};
use support::{asset, manifold, settings};

fn follow(space: &Manifold, u: DVec3, d: DVec3, length: f64) -> Path {
    let ray = Ray::new(space, u, d.normalize(), length);
    paths(space, settings(1e-13, false), [ray]).remove(0)
}

/// How far two spaces are from being one: end, tangent, frame and deviation of random paths between
/// the distances `from` and `to`.
#[track_caller]
fn assert_same(a: &Manifold, b: &Manifold, [from, to]: [f64; 2], length: f64, within: f64) {
    let mut stream = Stream::new(&[3]);
    for _ in 0..12 {
        let u = stream.direction() * stream.between(from, to);
        let d = (stream.direction() + u.normalize() * 1.5).normalize();
        let [one, two] = [a, b].map(|space| follow(space, u, d, length));
        assert_eq!((one.length, two.length), (length, length));
        let state = |path: &Path| {
            let step = path.steps.last().unwrap();
            let frame = DMat3::from_quat(step.rotation(length).unwrap());
            let [j, k] = step.deviation(length).unwrap();
            let mut all = vec![step.position(length), step.tangent(length), j, k];
            all.extend([frame.x_axis, frame.y_axis, frame.z_axis]);
            all
        };
        for (k, (x, y)) in state(&one).into_iter().zip(state(&two)).enumerate() {
            let off = (x - y).length() / (1.0 + y.length());
            assert!(
                off < within,
                "{u} {d}: number {k} is {off:.1e} off: {x} {y}"
            );
        }
    }
}

/// Spherical coordinates of the chart.
const SPHERICAL: &str = "
[pullback]
r = 'sqrt(x^2 + y^2 + z^2)'
th = 'atan2(sqrt(x^2 + y^2), z)'
ph = 'atan2(y, x)'
";

const FLAT: &str = "metric = { rr = '1', thth = 'r^2', phph = '(r*sin(th))^2' }\n";

#[test]
fn flat_space_in_spherical_coordinates_is_flat() {
    let spherical = manifold(&format!("{FLAT}{SPHERICAL}"));
    let flat = manifold("metric = { conformal = '1' }");
    assert_same(&spherical, &flat, [1.0, 4.0], 6.0, 1e-9);
}

#[test]
fn light_passes_over_a_pole_as_anywhere() {
    let text = std::fs::read_to_string(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/assets/manifolds/schwarzschild-polar.toml"
    ));
    let text = text.unwrap().replace("r - 45*M", "r - 50*M");
    let source = geofan_core::diagnostic::SourceText::new("polar", text);
    let hole = Manifold::from_source(source, &[]).unwrap();
    // Swept angles from r = 50 to r = 50, by quadrature; in meridians, which meet the poles, and aslant.
    for (b, angle) in [
        (6.0, 4.6204187268812),
        (10.0, 3.3293558649459),
        (20.0, 2.5554529686639),
    ] {
        for across in [DVec3::Z, DVec3::Y, DVec3::new(0.0, 0.6, -0.8)] {
            let u = DVec3::X * 50.0;
            // b = r sin θ/√(1 - 2/r)
            let sine = b / 50.0 * (1.0_f64 - 2.0 / 50.0).sqrt();
            let d = DVec3::NEG_X * (1.0 - sine * sine).sqrt() + across * sine;
            let ray = Ray::new(&hole, u, d, 400.0);
            let bare = Settings::bare(1e-12).with_events();
            let path = paths(&hole, bare, [ray]).remove(0);
            assert_eq!(path.end.name(&hole), "sky", "{b} {across}");
            assert!(path.tried < 3000, "{}", path.tried);
            let mut swept = 0.0;
            for step in &path.steps {
                let at = |k: u32| {
                    let v =
                        step.position(step.start + (step.end - step.start) * f64::from(k) / 8.0);
                    (v.x, v.dot(across))
                };
                for k in 0..8 {
                    let ((a, b), (c, d)) = (at(k), at(k + 1));
                    swept += (a * d - b * c).atan2(a * c + b * d);
                }
            }
            assert!(
                (swept - angle).abs() < 1e-9,
                "{b} {across}: {swept} {angle}"
            );
        }
    }
}

#[test]
fn a_camera_on_the_axis_sees_what_its_neighbours_see() {
    let polar = asset("schwarzschild-polar");
    for u in [DVec3::Z * 10.0, DVec3::NEG_Z * 7.0] {
        // By symmetry the same as off the axis, turned.
        let turn = DMat3::from_rotation_x(0.7);
        for d in [DVec3::new(0.5, 0.2, -0.4), DVec3::new(-0.3, 0.9, 0.6)] {
            let d = d.normalize();
            let on = follow(&polar, u, d, 12.0);
            let frames = polar.standard_frame(turn * u).inverse() * turn * polar.standard_frame(u);
            let off = follow(&polar, turn * u, frames * d, 12.0);
            let end = |path: &Path| path.steps.last().unwrap().position(12.0);
            let miss = (turn * end(&on) - end(&off)).length();
            assert!(miss < 1e-6, "{u} {d}: {miss:.1e}");
            assert_eq!(on.length, 12.0);
        }
    }
}

#[test]
fn a_wind_is_pulled_back_as_a_vector() {
    let river = asset("schwarzschild-river");
    let wind = "wind = ['sqrt(2/r)', '0', '0']\n";
    let polar = manifold(&format!("{FLAT}{wind}{SPHERICAL}"));
    assert_same(&polar, &river, [4.0, 9.0], 7.0, 1e-9);
    // As the shift of slices it has the other sign, and runs in time that the lapse measures.
    let slices = "metric = { rr = '4', thth = '4*r^2', phph = '(2*r*sin(th))^2' }\n\
                  shift = ['-sqrt(2/r)', '0', '0']\nlapse = '2'\n";
    let slices = manifold(&format!("{slices}{SPHERICAL}"));
    assert_same(&slices, &river, [4.0, 9.0], 7.0, 1e-9);
    // Another turns about z: in angles it is constant.
    let turning = manifold("metric = { conformal = '1' }\nwind = ['-0.4*y', '0.4*x', '0.3*z']");
    let wind = "wind = ['0.3*r*cos(th)^2', '-0.3*cos(th)*sin(th)', '0.4']\n";
    let polar = manifold(&format!("{FLAT}{wind}{SPHERICAL}"));
    assert_same(&polar, &turning, [1.0, 4.0], 3.0, 1e-9);
}

#[test]
fn a_drift_is_pulled_back_as_a_covector() {
    let string = asset("spinning-string");
    let text = "
        metric = { dd = '1', hh = '0.64*d^2', zz_ = '1' }
        drift = ['0', '-0.4', '0']
        [pullback]\nd = 'sqrt(x^2 + y^2)'\nh = 'atan2(y, x)'\nz_ = 'z'";
    let text = text.replace("zz_ =", "z_z_ =");
    let cylinder = manifold(&text);
    assert_same(&cylinder, &string, [1.0, 4.0], 5.0, 1e-9);
    let (u, d) = (DVec3::new(1.2, 0.3, -0.4), DVec3::new(-0.8, 0.4, 0.2));
    let [a, b] = [&cylinder, &string].map(|s| elapsed(s, &follow(s, u, d, 5.0), 5.0));
    assert!((a - b).abs() < 1e-10 && (a - 5.0).abs() > 0.1, "{a} {b}");
}

#[test]
fn kerr_in_its_own_coordinates_is_kerr_in_the_charts() {
    let own = manifold(
        "[parameters]\na = 0.9
        [pullback]
        r = 'sqrt((x^2 + y^2 + z^2 - a^2 + sqrt((x^2 + y^2 + z^2 - a^2)^2 + 4*a^2*z^2))/2)'
        th = 'acos(z/r)'
        ph = 'atan2(y, x) - atan2(a, r)'
        [let]
        sigma = 'r^2 + (a*cos(th))^2'
        f = '2*r/sigma'
        s2 = 'sin(th)^2'
        [spacetime]
        tt = 'f - 1'
        tr = 'f'
        tph = '-f*a*s2'
        rr = '1 + f'
        rph = '-a*(1 + f)*s2'
        thth = 'sigma'
        phph = 's2*((r^2 + a^2)^2 - a^2*(r^2 - 2*r + a^2)*s2)/sigma'
        [domain]
        inside = ['r - 0.2']
        [cameras]
        at = ['10', '0', '1']",
    );
    let chart = asset("kerr-ingoing");
    assert_same(&own, &chart, [3.0, 9.0], 8.0, 1e-8);
    let path = follow(&own, DVec3::X * 10.0, DVec3::new(-0.95, -0.2, 0.1), 30.0);
    let end = path.steps.last().unwrap().position(30.0);
    let known = DVec3::new(-0.23741810473, 1.81191855534, 0.61057051529);
    assert!((end - known).length() < 1e-9, "{end}");
}

#[test]
fn an_embedding_may_use_textbook_coordinates_too() {
    let bump = "embedding = ['x', 'y', 'z', 'exp(-r^2/2)']\n";
    let written = manifold(&format!("{bump}{SPHERICAL}"));
    assert_same(&written, &asset("gaussian-bump"), [0.5, 2.0], 3.0, 1e-9);
}

/// Flat space in textbook coordinates without `[pullback]`, seen from beside the axis, and a sky.
fn polar_scene(more: &str, camera: &str) -> Stage {
    let space = format!(
        "name = 'polar'\ncoordinates = ['r', 'th', 'ph']\nmetric = {{ rr = '1', thth = 'r^2', phph = '(r*sin(th))^2' }}\n[domain]\nr = [0.001, 100]\nth = [0, 3.141592653589793]\nph = [0, 6.283185307179586]\nperiodic = ['ph']\n[[exit]]\nname = 'sky'\nwhen = 'r - 20'\n{more}\n[cameras]\nlength = 40\n"
    );
    let scene =
        format!("manifold = 'm.toml'\n[camera]\n{camera}\n[sky]\nsky = {{ pattern = 'grid' }}\n");
    let place = support::Place::with(&[("m.toml", &space), ("s.toml", &scene)]);
    Stage::load(&place.path("s.toml"), &[]).unwrap_or_else(|e| panic!("{}", e.report(false)))
}

const BESIDE_AXIS: &str = "at = [5, 1.2, 0.3]\nlook = [-1, 0, 0]\nup = [0, -1, 0]";

#[test]
fn a_sky_in_polar_coordinates_is_told_with_a_direction_that_is_right() {
    let warned = polar_scene("", BESIDE_AXIS);
    let [warning] = &warned.world.warnings[..] else {
        panic!("{:?}", warned.world.warnings);
    };
    assert!(warning.contains("exit `sky`") && warning.contains("[pullback]"));
    // The recipe, taken by its word.
    let from = warning.find("direction = [").unwrap();
    let recipe = &warning[from..from + warning[from..].find(']').unwrap() + 1];
    let mended = polar_scene(recipe, BESIDE_AXIS);
    assert_eq!(mended.world.warnings, Vec::<String>::new());
    let manifold = &mended.world.manifold;
    let u = DVec3::new(5.0, 1.2, 0.3);
    let tracer = ExactTracer::new(manifold, u, 40.0, 1e-10);
    let directions = [DVec3::new(0.3, 0.5, -0.2), DVec3::new(-0.4, 0.1, 0.9)].map(DVec3::normalize);
    for (d, curve) in directions.iter().zip(tracer.trace(&directions)) {
        let Ending::Exit { sky, .. } = curve.ending else {
            panic!("{:?}", curve.ending);
        };
        // The standard frame is along r, th, ph.
        let (th, ph) = (u.y, u.z);
        let axes = DMat3::from_cols(
            DVec3::new(th.sin() * ph.cos(), th.sin() * ph.sin(), th.cos()),
            DVec3::new(th.cos() * ph.cos(), th.cos() * ph.sin(), -th.sin()),
            DVec3::new(-ph.sin(), ph.cos(), 0.0),
        );
        assert!((axes * *d - sky).length() < 1e-8, "{sky}");
    }
}

#[test]
fn rays_that_meet_a_pole_go_on_beside_it() {
    let stage = polar_scene("", BESIDE_AXIS);
    let view = stage.view(&stage.scene.camera, (5, 7)).unwrap();
    let tracer = ExactTracer::new(&stage.world.manifold, view.u, 40.0, 1e-8);
    // In the plane of the axis all of them meet it; the middle one ends at the radius where the chart does.
    let rows = [0, 1, 2, 4, 5, 6].into_iter();
    let column = rows.map(|y| view.direction(2.5, f64::from(y) + 0.5));
    for curve in tracer.trace(&column.collect::<Vec<_>>()) {
        let far = matches!(curve.ending, Ending::Exit { exit: 0, .. });
        assert!(far, "{:?} at {:?}", curve.ending, curve.u.last());
    }
}

/// The catalogue's black hole in textbook coordinates, whose chart is all but Cartesian where the sky is.
#[test]
fn a_camera_on_the_axis_of_textbook_coordinates_has_no_warning_of_the_sky() {
    let folder = tempfile::tempdir().unwrap();
    let space = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("assets/manifolds/schwarzschild-polar.toml");
    let scene = format!(
        "manifold = '{}'\n[camera]\nat = [0, 0, 10]\nlook = [0, 0, -1]\nup = [0, 1, 0]\n[sky]\nsky = {{ pattern = 'grid' }}\n",
        space.display()
    );
    let path = folder.path().join("s.toml");
    std::fs::write(&path, scene).unwrap();
    let stage = Stage::load(&path, &[]).unwrap_or_else(|e| panic!("{}", e.report(false)));
    assert_eq!(stage.world.warnings, Vec::<String>::new());
}
