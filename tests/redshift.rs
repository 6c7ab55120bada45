//! Cameras in motion and frequencies of light, against textbooks: aberration, the Doppler effect, the
//! shadow that observers at rest see, gravitational redshift, matter in orbit.

mod support;

use geofan_core::manifold::Manifold;
use geofan_render::{
    Ending, ExactTracer, Seen, Stage, View,
    drawing::draw,
    frame::{Paths, no_clock, offsets, trace},
    redshift::{blackbody, redshifts},
    shade::Footprints,
};
use glam::{DVec2, DVec3};
use support::Place;

const TOLERANCE: f64 = 1e-12;

/// A scene in a manifold of the catalogue, with a square mesh beside it: corners (±1, ±1, 0).
fn stage(manifold: &str, text: &str) -> Result<Stage, String> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/manifolds");
    let text = format!("manifold = \"{folder}/{manifold}.toml\"\n{text}");
    let square = "v 1 1 0\nv -1 1 0\nv -1 -1 0\nv 1 -1 0\nf 1 2 3\nf 1 3 4\n";
    let place = Place::with(&[("square.obj", square), ("scene.toml", &text)]);
    Stage::load(&place.path("scene.toml"), &[]).map_err(|e| e.report(false))
}

fn view(stage: &Stage, size: (usize, usize)) -> View {
    let camera = stage.camera(None).unwrap();
    stage.view(camera, size).unwrap()
}

/// g of every pixel's middle.
fn g(stage: &Stage, view: &View, length: f64) -> Vec<f64> {
    let tracer = ExactTracer::new(&stage.world.manifold, view.u, length, TOLERANCE);
    let traced = trace(&stage.world, view, Paths::Exact(&tracer), &offsets(1));
    let found = redshifts(&stage.world, view, &traced.outcomes, DVec2::splat(0.5));
    found.iter().map(|g| f64::from(*g)).collect()
}

#[test]
fn a_camera_in_motion_sees_the_sky_crowded_ahead_by_the_known_angles() {
    let stage = stage(
        "flat",
        "[camera]\nat = [0, 0, 0]\nlook = [0.3, 1, 0.2]\nup = [0, 0, 1]\nfov = 120\nvelocity = [0.36, 0.48, 0.0]",
    )
    .unwrap();
    let moving = view(&stage, (40, 30));
    let resting = moving.with_velocity(DVec3::ZERO);
    let along = DVec3::new(0.6, 0.8, 0.0);
    for (x, y) in [(0.5, 0.5), (13.2, 29.0), (39.5, 7.25)] {
        let (seen, there) = (resting.direction(x, y), moving.direction(x, y));
        // cos θ' = (cos θ + β)/(1 + β cos θ), in the plane of both.
        let cosine = there.dot(along);
        assert!((seen.dot(along) - (cosine + 0.6) / (1.0 + 0.6 * cosine)).abs() < 1e-14);
        assert!(along.cross(seen).dot(there).abs() < 1e-15);
        let doppler = (1.0 + 0.6 * cosine) / 0.8;
        assert!((moving.blueshift(there) - doppler).abs() < 1e-14);
        let (px, py) = moving.pixel(there).unwrap();
        assert!(
            (px - x).abs() < 1e-10 && (py - y).abs() < 1e-10,
            "{px} {py}"
        );
    }
}

/// The angle from straight down at which a camera's lines of sight just pass the hole.
fn shadow(manifold: &Manifold, view: &View) -> f64 {
    let tracer = ExactTracer::new(manifold, view.u, 200.0, TOLERANCE);
    let captured = |angle: f64| {
        let own = DVec3::new(-angle.cos(), angle.sin() * 0.6, angle.sin() * 0.8);
        // What the moving camera sees at `own`.
        let seen = view.with_velocity(-view.velocity()).in_camera(own);
        let curve = tracer.trace(&[seen]).remove(0);
        !matches!(curve.ending, Ending::Exit { exit: 1, .. })
    };
    let (mut low, mut high) = (0.0, 3.0);
    for _ in 0..45 {
        let middle = 0.5 * (low + high);
        match captured(middle) {
            true => low = middle,
            false => high = middle,
        }
    }
    low
}

#[test]
fn at_rest_above_a_river_the_shadow_is_that_of_schwarzschild() {
    for (r, degrees) in [(6.0, 45.0), (10.0, 27.694_561_450_8)] {
        let camera = format!(
            "[camera]\nat = [{r}, 0, 0]\nlook = [-1, 0, 0]\nup = [0, 0, 1]\nrest = \"static\""
        );
        let stage = stage("schwarzschild-river", &camera).unwrap();
        let view = view(&stage, (4, 4));
        let beta = view.velocity();
        assert!((beta.length() - f64::sqrt(2.0 / r)).abs() < 1e-14);
        let found = shadow(&stage.world.manifold, &view).to_degrees();
        assert!((found - degrees).abs() < 1e-8, "{r}: {found}");
    }
}

#[test]
fn nothing_is_at_rest_inside_the_ergosphere_and_the_scene_says_where_it_was_asked_for() {
    let camera =
        "[camera]\nat = [1.95, 0, 0.1]\nlook = [-1, 0, 0]\nup = [0, 0, 1]\nrest = \"static\"";
    let stage = stage("kerr", camera).unwrap();
    let refused = stage.view(stage.camera(None).unwrap(), (4, 4)).unwrap_err();
    let report = refused.report(false);
    assert!(report.contains("nothing can be at rest at"), "{report}");
    assert!(report.contains("scene.toml:6:8"), "{report}");
}

/// A square of half-width `half` in the plane z = 0 of the chart, seen from `at`.
fn square(at: DVec3, middle: DVec3, half: f64, more: &str) -> String {
    let look = middle - at;
    format!(
        "redshift = true\n[camera]\nat = [{}, {}, {}]\nlook = [{}, {}, {}]\nup = [0.0, 0.1, 1]\nfov = 1\nrest = \"static\"\n[[object]]\nmesh = \"square.obj\"\nat = [{}, {}, {}]\nscale = {half}\nplacement = \"chart\"\n{more}",
        at.x, at.y, at.z, look.x, look.y, look.z, middle.x, middle.y, middle.z
    )
}

#[test]
fn between_observers_at_rest_light_is_redder_by_the_ratio_of_their_clocks() {
    // Straight up, so that the aim is known in every chart.
    let (low, high) = (DVec3::new(0.0, 0.0, 4.0), DVec3::new(0.0, 1e-4, 12.0));
    let expected = f64::sqrt((1.0 - 2.0 / 4.0) / (1.0 - 2.0 / 12.0));
    let stage = stage("schwarzschild-river", &square(high, low, 0.5, "")).unwrap();
    let view = view(&stage, (3, 3));
    let found = g(&stage, &view, 60.0)[4];
    assert!((found - expected).abs() < 1e-6, "{found} {expected}");
}

#[test]
fn matter_in_orbit_about_kerrs_hole_is_seen_at_the_frequency_of_textbooks() {
    // Around (6, 0, 0) in Kerr and Schild's chart matter goes around the axis with dφ/dt = Ω of its radius.
    let a: f64 = 0.9;
    let velocity =
        "velocity = [\"-y/((x^2 + y^2 - a^2)^0.75 + a)\", \"x/((x^2 + y^2 - a^2)^0.75 + a)\", 0]";
    let (at, middle) = (DVec3::new(2.0, -3.0, 14.0), DVec3::new(6.0, 0.5, 0.0));
    let stage = stage("kerr", &square(at, middle, 5.0, velocity)).unwrap();
    let manifold = &stage.world.manifold;
    let view = view(&stage, (3, 2));
    let tracer = ExactTracer::new(manifold, view.u, 80.0, TOLERANCE);
    let traced = trace(&stage.world, &view, Paths::Exact(&tracer), &offsets(1));
    let found = redshifts(&stage.world, &view, &traced.outcomes, DVec2::splat(0.5));
    let mut seen = 0;
    for ((y, x), found) in found.indexed_iter() {
        let Seen::Surface(hit) = traced.outcomes[(y, x, 0)] else {
            continue;
        };
        let point = stage.world.point(&hit);
        let r = (point.length_squared() - a * a).sqrt();
        // The axial angular momentum of light of energy 1, conserved: from the camera.
        let d = view.direction(x as f64 + 0.5, y as f64 + 0.5);
        let n = manifold.standard_frame(view.u) * d;
        let p = manifold.metric(view.u) * n / manifold.share(view.u, n);
        let momentum = view.u.x * p.y - view.u.y * p.x;
        // Into the past light has minus the momentum that it has on its way.
        let xi = -momentum;
        let omega = 1.0 / (r.powf(1.5) + a);
        let u_t = (1.0 + a * r.powf(-1.5)) / (1.0 - 3.0 / r + 2.0 * a * r.powf(-1.5)).sqrt();
        // At rest: 1/√(−g_tt) = 1/√(1 − 2r/Σ).
        let rho2 = view.u.length_squared() - a * a;
        let r2 = 0.5 * (rho2 + (rho2 * rho2 + 4.0 * a * a * view.u.z * view.u.z).sqrt());
        let f = 2.0 * r2.powf(1.5) / (r2 * r2 + a * a * view.u.z * view.u.z);
        let expected = 1.0 / (1.0 - f).sqrt() / (u_t * (1.0 - omega * xi));
        // Tangents at hits are kept in single precision.
        assert!(
            (f64::from(*found) / expected - 1.0).abs() < 2e-6,
            "({x}, {y}), r = {r}: {found} {expected}"
        );
        seen += 1;
    }
    assert!(seen >= 4, "{seen}");
}

#[test]
fn glowing_bodies_have_the_colour_of_their_shifted_temperature_and_light_its_fourth_power() {
    let (low, high) = (DVec3::new(0.0, 0.0, 4.0), DVec3::new(0.0, 1e-4, 12.0));
    let factor = f64::sqrt((1.0 - 2.0 / 4.0) / (1.0 - 2.0 / 12.0));
    let colour = |more: &str, unshifted: bool| {
        let text = square(high, low, 0.5, more);
        let text = match unshifted {
            true => text.replace("redshift = true", ""),
            false => text,
        };
        let stage = stage("schwarzschild-river", &text).unwrap();
        let view = view(&stage, (1, 1));
        let tracer = ExactTracer::new(&stage.world.manifold, view.u, 60.0, TOLERANCE);
        let paths = Paths::Exact(&tracer);
        draw(&stage.world, &view, paths, 1, Footprints::Points, &no_clock)
            .picture
            .pixel(0, 0)
    };
    let same = |a: [f32; 3], b: [f32; 3]| {
        for (a, b) in a.into_iter().zip(b) {
            assert!((a / b - 1.0).abs() < 1e-4, "{a} {b}");
        }
    };
    let hot = "temperature = \"1500*(x^2 + y^2 + z^2)^0.5\"";
    same(colour(hot, false), blackbody(6000.0 * factor));
    same(colour(hot, true), blackbody(6000.0));
    let [shifted, plain] = [false, true].map(|unshifted| colour("", unshifted));
    same(shifted, plain.map(|light| light * factor.powi(4) as f32));
}

#[test]
fn velocities_faster_than_light_and_formulas_that_mean_nothing_are_refused_at_their_places() {
    let (low, high) = (DVec3::new(0.0, 0.0, 4.0), DVec3::new(0.0, 1.0, 12.0));
    let report = |more: &str| {
        stage("schwarzschild-river", &square(high, low, 0.5, more))
            .err()
            .unwrap()
    };
    let fast = report("velocity = [\"0.9*x/x\", 0.5, 0]");
    assert!(fast.contains("not below that of light"), "{fast}");
    assert!(fast.contains("scene.toml:14:12"), "{fast}");
    for nothing in ["-5", "sqrt(-1)", "1/(z - z)"] {
        let cold = report(&format!("temperature = \"{nothing}\""));
        assert!(cold.contains("this is no temperature at"), "{cold}");
        assert!(cold.contains("scene.toml:14:"), "{cold}");
    }
    let unknown = report("temperature = \"1000*rr\"");
    assert!(unknown.contains("scene.toml:14:21"), "{unknown}");
    let short = report("velocity = [0.1, 0.2]");
    assert!(short.contains("three numbers or expressions"), "{short}");
    let camera = "[camera]\nat = [9, 0, 0]\nlook = [1, 0, 0]\nup = [0, 0, 1]\n";
    for (line, message) in [
        (
            "velocity = [0.8, 0.7, 0]",
            "`velocity` must be shorter than 1",
        ),
        ("rest = \"still\"", "unknown rest `still`"),
        (
            "rest = \"static\"\nvelocity = [0, 0, 0]",
            "a camera has both `rest` and `velocity`",
        ),
    ] {
        let report = stage("flat", &format!("{camera}{line}")).err().unwrap();
        assert!(report.contains(message), "{report}");
    }
}

/// A drift that is a gradient is another clock, t = s + 0.4 x: what moves with u by the one moves with u/(1 − 0.4 u_x) by
/// the other, and the surface that has the normal N at one t has N − (N·u) b at one s.
#[test]
fn surfaces_that_move_across_themselves_are_lit_the_same_by_any_clock() {
    let space = |drift: &str| {
        format!(
            "name = 'clock'\ncoordinates = ['x', 'y', 'z']\nmetric = {{ conformal = '1' }}\n{drift}\n\
             [[exit]]\nname = 'sky'\nwhen = 'x^2 + y^2 + z^2 - 144'\n[cameras]\nlength = 25\n"
        )
    };
    let square = |slope: f64| {
        format!(
            "mtllib white.mtl\nusemtl white\nv -2 -2 {0}\nv 2 -2 {1}\nv 2 2 {1}\nv -2 2 {0}\nf 1 2 3 4\n",
            -2.0 * slope,
            2.0 * slope
        )
    };
    let lit = |drift: &str, slope: f64, velocity: [f64; 3]| {
        let scene = format!(
            "manifold = 'space.toml'\n[camera]\nat = [1, -1, 6]\nlook = [-0.17, 0.17, -1]\nup = [0, 1, 0]\nfov = 20\n\
             [[object]]\nmesh = 'square.obj'\nat = [0, 0, 0]\nplacement = 'chart'\nvelocity = {velocity:?}\n\
             [[light]]\nkind = 'point'\nat = [3, 2, 4]\nintensity = [100, 100, 100]\n"
        );
        let place = Place::with(&[
            ("space.toml", &space(drift)),
            ("square.obj", &square(slope)),
            ("white.mtl", "newmtl white\nKd 0.8 0.8 0.8\n"),
            ("scene.toml", &scene),
        ]);
        let mut stage = Stage::load(&place.path("scene.toml"), &[]).unwrap();
        let view = view(&stage, (9, 9));
        let (light, _) = geofan_light::cache::light(&stage.world, 25.0, 1e-9, None, |_, _| {});
        stage.world.light = Some(light);
        let tracer = ExactTracer::new(&stage.world.manifold, view.u, 25.0, 1e-9);
        let paths = Paths::Exact(&tracer);
        let drawn = draw(&stage.world, &view, paths, 1, Footprints::Points, &no_clock);
        f64::from(drawn.picture.pixel(4, 4)[0])
    };
    let (drift, slower) = ("drift = ['0.4', '0', '0']", 1.0 - 0.4 * 0.3);
    let tilted = lit("", 0.16, [0.3 / slower, 0.0, 0.4 / slower]);
    let found = lit(drift, 0.0, [0.3, 0.0, 0.4]);
    assert!((found / tilted - 1.0).abs() < 2e-3, "{found} {tilted}");
    let flat = lit("", 0.0, [0.3 / slower, 0.0, 0.4 / slower]);
    assert!((found / flat - 1.0).abs() > 0.1, "{found} {flat}");
}
