//! Paths that are long enough: the lengths of the catalogue, the shadow that a black hole has in a picture, the
//! shares of paths that end by their length, and what is said about them.

mod support;

use assert_cmd::{assert::Assert, cargo::cargo_bin_cmd};
use geofan_core::{
    geodesic::{End, Ray, Settings, UnfinishedPaths, ends_alone},
    random::Stream,
};
use geofan_render::{
    ExactTracer, Seen, Stage, View,
    frame::{Outcomes, Paths, offsets, trace},
    unfinished,
};
use glam::{DQuat, DVec3};
use serde_json::Value;
use std::{fs, path::Path};
use support::{asset, catalogue, random_point};
use tempfile::TempDir;

/// Spaces in which some paths stay for ever whatever their length: sideways along a rod, around a sphere,
/// around in a universe that rotates, and onto a horizon in coordinates that are smooth for what falls in.
const ENDLESS: [&str; 5] = [
    "grin-rod",
    "s2xr",
    "goedel",
    "kerr-ingoing",
    "schwarzschild-rain",
];

/// Finds what share of random paths over the camera region of `name` ends by length, and which would do.
fn over_region(name: &str, count: usize) -> Option<UnfinishedPaths> {
    let manifold = asset(name);
    if !manifold.domain.has_exits() {
        return None;
    }
    let length = manifold.length.expect("a length");
    let mut stream = Stream::new(&[17]);
    let rays = (0..count).map(|_| {
        let u = random_point(&manifold, &mut stream);
        Ray::new(&manifold, u, stream.direction(), length)
    });
    let rays: Vec<Ray> = rays.collect();
    let settings = Settings::bare(1e-7).with_events();
    let ends = |rays: &[Ray]| -> Vec<Option<f64>> {
        let ends = ends_alone(&manifold, settings, rays).into_iter();
        ends.map(|(end, s)| matches!(end, End::Exit(_)).then_some(s))
            .collect()
    };
    let short = rays
        .iter()
        .zip(ends(&rays))
        .filter(|(_, end)| end.is_none());
    let short: Vec<Ray> = short.map(|(ray, _)| *ray).collect();
    let found = UnfinishedPaths::counted(short.len(), 0, count);
    Some(found.followed(length, |length| {
        let farther = UnfinishedPaths::sample(&short).into_iter();
        let farther: Vec<Ray> = farther.map(|ray| Ray { length, ..ray }).collect();
        ends(&farther)
    }))
}

#[test]
fn paths_of_the_catalogue_are_long_enough_to_leave_if_any_length_is() {
    for name in catalogue() {
        let Some(found) = over_region(&name, 4000) else {
            continue;
        };
        println!("{name}: {found:?}");
        match ENDLESS.contains(&name.as_str()) {
            true => assert!(found.tried.is_some() && found.enough.is_none(), "{name}"),
            false => assert!(found.is_negligible(), "{name}: {found:?}"),
        }
    }
}

/// The half-angle of the shadow seen from areal radius 15M: sin α = 3√3 √(1 − 2/15)/15.
const SHADOW: f64 = 18.8140;

/// The angle of rays whose path to areal radius 45M is 80 long, from the elliptic integral
/// ∫ dr/(f √(1 − b² f/r²)), by quadrature.
const AT_80: f64 = SHADOW + 2.1207;

/// A camera at areal radius 15M off every plane of coordinates, which looks past the hole; with the direction
/// to the hole, in the standard frame as in the chart.
fn beside_the_hole(folder: &Path, sky: &str) -> (Stage, View, DVec3) {
    let tilt = DQuat::from_axis_angle(DVec3::new(0.3, -0.7, 0.4).normalize(), 1.1);
    let at = tilt * DVec3::X * ((15.0 - 1.0 + f64::sqrt(15.0 * 13.0)) / 2.0);
    let look = tilt * DVec3::new(-1.0, 0.12, -0.08);
    let [x, y, z] = at.to_array();
    let [a, b, c] = look.to_array();
    let assets = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/manifolds");
    let text = format!(
        "manifold = '{assets}/schwarzschild.toml'\n\
         camera = {{ at = [{x}, {y}, {z}], look = [{a}, {b}, {c}], up = [0, 0, 1], fov = 60 }}\n\
         [sky]\nsky = {{ color = [0, 0, 1] }}\n{sky}\n"
    );
    fs::write(folder.join("hole.toml"), text).unwrap();
    let stage = Stage::load(&folder.join("hole.toml"), &[]).unwrap();
    let view = stage.view(&stage.scene.camera, (96, 64)).unwrap();
    (stage, view, -at.normalize())
}

fn seen(stage: &Stage, view: &View, length: f64) -> Outcomes {
    let tracer = ExactTracer::new(&stage.world.manifold, view.u, length, 1e-9);
    trace(&stage.world, view, Paths::Exact(&tracer), &offsets(1)).outcomes
}

/// What is told of paths of this length.
fn told_of(stage: &Stage, view: &View, outcomes: &Outcomes, length: f64) -> UnfinishedPaths {
    let parts = [(view.clone(), outcomes.clone())];
    unfinished(&stage.world, &parts, (length, 1e-9))
}

/// The angles of all pixels from the hole, in degrees, with what they see.
fn by_angle(view: &View, outcomes: &Outcomes, hole: DVec3) -> Vec<(f64, Seen)> {
    let angle = |x: usize, y: usize| {
        let direction = view.direction(x as f64 + 0.5, y as f64 + 0.5);
        direction.angle_between(hole).to_degrees()
    };
    let pixels = outcomes.indexed_iter();
    pixels
        .map(|((y, x, _), seen)| (angle(x, y), *seen))
        .collect()
}

#[test]
fn black_in_a_picture_of_a_black_hole_is_its_shadow_and_nothing_else() {
    let folder = TempDir::new().unwrap();
    let (stage, view, hole) = beside_the_hole(folder.path(), "");
    let manifold = &stage.world.manifold;
    let outcomes = seen(&stage, &view, manifold.length.unwrap());
    let [horizon, sky] = ["horizon", "sky"].map(|name| manifold.exit_named(name).unwrap() as u32);
    let (mut inside, mut outside) = (0, 0);
    for (angle, seen) in by_angle(&view, &outcomes, hole) {
        // Closer to the edge than a fiftieth of a pixel light winds about the photon sphere.
        if (angle - SHADOW).abs() < 0.01 {
            continue;
        }
        let exit = match seen {
            Seen::Sky { exit, .. } => exit,
            other => panic!("{angle}° from the hole: {other:?}"),
        };
        assert_eq!(exit, if angle < SHADOW { horizon } else { sky }, "{angle}");
        inside += usize::from(exit == horizon);
        outside += usize::from(exit == sky);
    }
    assert!(inside > 1500 && outside > 1500, "{inside} {outside}");
}

#[test]
fn the_rim_that_ends_by_length_is_counted_and_the_length_that_is_named_would_do() {
    let folder = TempDir::new().unwrap();
    let (stage, view, hole) = beside_the_hole(folder.path(), "");
    let outcomes = seen(&stage, &view, 80.0);
    let pixels = by_angle(&view, &outcomes, hole);
    for (angle, seen) in &pixels {
        if (angle - SHADOW).abs() > 0.005 && (angle - AT_80).abs() > 0.005 {
            let rim = (SHADOW..AT_80).contains(angle);
            assert_eq!(
                *seen == Seen::Length,
                rim,
                "{angle}° from the hole: {seen:?}"
            );
        }
    }
    // The share of the picture, from angles alone.
    let rim = pixels.iter().filter(|(a, _)| (SHADOW..AT_80).contains(a));
    let share = rim.count() as f64 / pixels.len() as f64;
    let found = told_of(&stage, &view, &outcomes, 80.0);
    assert!(
        (found.length - share).abs() < 1e-3 && share > 0.05,
        "{found:?} {share}"
    );
    assert_eq!(found.singular, 0.0);
    // A rim of 0.02° is left of a thousandth of this picture: between 100 (0.043°) and 110 (0.006°).
    let enough = found.enough.unwrap();
    assert!((100.0..=110.0).contains(&enough), "{enough}");
    let longer = told_of(&stage, &view, &seen(&stage, &view, enough), enough);
    assert!(longer.length < 2e-3, "{longer:?}");
    // A sky for such paths is an answer too.
    let (stage, view, _) = beside_the_hole(folder.path(), "length = { color = [1, 0, 0] }");
    let told = told_of(&stage, &view, &outcomes, 80.0);
    assert_eq!(
        (told.length, told.enough, told.tried),
        (found.length, None, None)
    );
}

/// Flat space, seen from 6 beside the middle of a ball of radius 10, too large for paths of length 5: those at
/// an angle of more than acos 0.65 from straight outwards, (1 + 0.65)/2 of all, end by it. The longest is 16.
const BALL: &str = r#"
name = "ball"
coordinates = ["x", "y", "z"]
metric = { conformal = "1" }
[[exit]]
name = "sky"
when = "sqrt(x^2 + y^2 + z^2) - 10"
[symmetry]
rotation = "origin"
[cameras]
at = ["6", "0", "0"]
length = 5.0
"#;

/// A closed space without exits.
const TORUS: &str = r#"
name = "torus"
coordinates = ["x", "y", "z"]
metric = { conformal = "1" }
[domain]
x = [-1, 1]
y = [-1, 1]
z = [-1, 1]
periodic = ["x", "y", "z"]
[cameras]
at = ["0", "0", "0"]
length = 5.0
"#;

/// `geofan ARGUMENTS` in `folder`.
fn geofan(folder: &Path, arguments: &str) -> Assert {
    let mut command = cargo_bin_cmd!("geofan");
    command.current_dir(folder).env("NO_COLOR", "1");
    command.args(arguments.split(' ')).assert()
}

/// What a command that succeeds prints: JSON, and its log.
fn told(folder: &Path, arguments: &str) -> (Value, String) {
    let assert = geofan(folder, arguments).success();
    let output = assert.get_output();
    let json = serde_json::from_slice(&output.stdout).unwrap();
    (json, String::from_utf8(output.stderr.clone()).unwrap())
}

#[test]
fn bake_and_check_tell_the_share_of_the_region_and_the_length_that_would_do() {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("m.toml"), BALL).unwrap();
    for command in [
        "bake m.toml -o m.fan --json",
        "check m.fan --rays 20000 --json",
    ] {
        let (json, log) = told(folder.path(), command);
        let ends = &json["unfinished"];
        let share = ends["length"].as_f64().unwrap();
        assert!((share - 0.825).abs() < 0.01, "{command}: {ends}");
        assert_eq!(ends["enough"], 16.0, "{command}");
        assert!(log.contains("a length of 16 would do"), "{log}");
    }
    // Long enough, there is nothing to say.
    let (json, log) = told(folder.path(), "bake m.toml -o m.fan --length 17 --json");
    assert_eq!(json["unfinished"]["length"], 0.0);
    assert!(!log.contains("end by their length"), "{log}");
}

#[test]
fn render_and_compare_warn_of_black_parts_and_not_where_the_scene_has_a_sky_for_them() {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("m.toml"), BALL).unwrap();
    let scene = |sky: &str| {
        format!(
            "manifold = 'm.toml'\ncamera = {{ at = [6, 0, 0], look = [0, 1, 0], up = [0, 0, 1] }}\n\
             [sky]\nsky = {{ color = [0, 0, 1] }}\n{sky}\n"
        )
    };
    fs::write(folder.path().join("s.toml"), scene("")).unwrap();
    let with_sky = scene("length = { color = [1, 0, 0] }");
    fs::write(folder.path().join("sky.toml"), with_sky).unwrap();
    told(folder.path(), "bake m.toml -o m.fan --json");
    let commands = [
        ("render s.toml --size 40x30 -o a.png --json", "--length"),
        (
            "render s.toml --bundle m.fan --size 40x30 -o b.png --json",
            "bake with",
        ),
        (
            "compare s.toml --bundle m.fan --size 40x30 --frames 1 --out c --json",
            "bake with",
        ),
        (
            "render s.toml --tracer path --spp 1 --size 40x30 -o d.png --json",
            "--length",
        ),
    ];
    for (command, remedy) in commands {
        let (json, log) = told(folder.path(), command);
        let share = json["unfinished"]["length"].as_f64().unwrap();
        // Sideways the angle from outwards is 90° in the middle, and 45° at the edge: all but a corner.
        assert!((0.9..1.0).contains(&share), "{command}: {share}");
        assert!(
            log.contains("this view is black in parts"),
            "{command}: {log}"
        );
        assert!(
            log.contains(remedy) && log.contains("`length` sky"),
            "{log}"
        );
        let (json, log) = told(folder.path(), &command.replace("s.toml", "sky.toml"));
        assert_eq!(json["unfinished"]["length"], share, "{command}");
        assert!(!log.contains("black"), "{command}: {log}");
    }
}

#[test]
fn where_no_length_is_enough_that_is_said() {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("m.toml"), TORUS).unwrap();
    let scene =
        "manifold = 'm.toml'\ncamera = { at = [0, 0, 0], look = [0, 1, 0], up = [0, 0, 1] }\n";
    fs::write(folder.path().join("s.toml"), scene).unwrap();
    let (json, log) = told(folder.path(), "render s.toml --size 20x10 -o a.png --json");
    assert_eq!(json["unfinished"]["length"], 1.0);
    assert_eq!(json["unfinished"]["enough"], Value::Null);
    assert!(log.contains("even a length of 80 is not enough"), "{log}");
    // A bake of a space without exits has nothing to warn of.
    let (json, log) = told(folder.path(), "bake m.toml -o m.fan --json");
    assert_eq!(json["unfinished"]["length"], 1.0);
    assert!(!log.contains("length of"), "{log}");
}
