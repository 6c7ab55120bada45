//! `geofan transport` and `geofan project` against closed forms.

mod support;

use assert_cmd::cargo::cargo_bin_cmd;
use geofan_core::{
    diagnostic::SourceText,
    geodesic::{Ray, paths},
    manifold::Manifold,
};
use geofan_light::LightFan;
use glam::DVec3;
use serde_json::Value;
use std::{
    f64::consts::{PI, TAU},
    fs,
};
use support::{asset, settings};

const ASSETS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/assets");

/// Runs the program and reads what it prints as JSON.
fn json(arguments: &[&str]) -> Value {
    let run = cargo_bin_cmd!("geofan")
        .args(arguments)
        .arg("--json")
        .assert()
        .success();
    serde_json::from_slice(&run.get_output().stdout).unwrap()
}

/// Runs the program, which must refuse; returns what it says.
fn refusal(arguments: &[&str]) -> String {
    let run = cargo_bin_cmd!("geofan").args(arguments).assert().code(2);
    String::from_utf8_lossy(&run.get_output().stderr).into_owned()
}

fn manifold(name: &str) -> String {
    format!("{ASSETS}/manifolds/{name}.toml")
}

fn numbers(value: &Value) -> Vec<f64> {
    value
        .as_array()
        .unwrap()
        .iter()
        .map(|x| x.as_f64().unwrap())
        .collect()
}

fn vector(value: &Value) -> DVec3 {
    DVec3::from_slice(&numbers(value))
}

/// The integral over a turn of a periodic function, to rounding.
fn round(f: impl Fn(f64) -> f64) -> f64 {
    let n = 400;
    (0..n)
        .map(|i| f(TAU * f64::from(i) / f64::from(n)))
        .sum::<f64>()
        * TAU
        / f64::from(n)
}

/// The difference of two rotations about one axis, by their angles.
fn off(angle: f64, expected: f64) -> f64 {
    let off = (angle - expected).rem_euclid(TAU);
    off.min(TAU - off)
}

#[test]
fn a_loop_in_the_three_sphere_turns_by_the_area_it_encloses_in_any_plane() {
    // A wavy loop about the chart's origin in a slanted plane, which is a sphere of radius 1 by the same chart.
    let e1 = DVec3::new(0.8, 0.36, -0.48);
    let e2 = DVec3::new(0.0, 0.8, 0.6);
    let component = |k: usize| {
        format!(
            "(0.5 + 0.15*sin(3*t))*(({:?})*cos(t) + ({:?})*sin(t))",
            e1[k], e2[k]
        )
    };
    let curve = [0, 1, 2].map(component).join(",");
    let found = json(&[
        "transport",
        &manifold("s3"),
        "--curve",
        &curve,
        "--from",
        "0",
        "--to",
        "2*pi",
    ]);
    assert_eq!(found["closed"], true);
    let area = round(|t| {
        let r2 = (0.5 + 0.15 * (3.0 * t).sin()).powi(2);
        2.0 * r2 / (1.0 + r2)
    });
    let axis = vector(&found["holonomy"]["axis"]);
    let angle = found["holonomy"]["angle"].as_f64().unwrap() * axis.dot(e1.cross(e2)).signum();
    assert!(off(angle, area) < 1e-9, "{angle} {area}");
    assert!(axis.cross(e1.cross(e2)).length() < 1e-9);
}

#[test]
fn a_loop_in_the_product_of_sphere_and_line_turns_by_the_area_of_its_shadow() {
    // S² by its stereographic chart: conformal 2/(1 + x² + y²); along z it may go up and come back.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("s2xr.toml");
    let text = "name = \"s2xr\"\ncoordinates = [\"x\", \"y\", \"z\"]\n\
        metric = { xx = \"4/(1 + x^2 + y^2)^2\", yy = \"4/(1 + x^2 + y^2)^2\", zz = \"1\" }\n";
    fs::write(&path, text).unwrap();
    let path = path.display().to_string();
    let curve = "0.2 + 0.4*cos(t),-0.1 + 0.3*sin(t),0.7*sin(2*t) + 0.2";
    let found = json(&[
        "transport",
        &path,
        "--curve",
        curve,
        "--from",
        "-pi/2",
        "--to",
        "3*pi/2",
        "--vector",
        "0,0,2",
    ]);
    // ∮ (1 − cos θ) dφ = ∮ 2 (x dy − y dx)/(1 + x² + y²)
    let area = round(|t| {
        let (x, y) = (0.2 + 0.4 * t.cos(), -0.1 + 0.3 * t.sin());
        let (dx, dy) = (-0.4 * t.sin(), 0.3 * t.cos());
        2.0 * (x * dy - y * dx) / (1.0 + x * x + y * y)
    });
    let axis = vector(&found["holonomy"]["axis"]);
    let angle = found["holonomy"]["angle"].as_f64().unwrap() * axis.z.signum();
    assert!(off(angle, area) < 1e-9, "{angle} {area}");
    assert!(axis.z.abs() > 1.0 - 1e-12);
    let carried = vector(&found["vectors"][0]["to"]);
    assert!(
        (carried - 2.0 * DVec3::Z).length() < 1e-12,
        "the line's direction is parallel"
    );
}

#[test]
fn open_curves_have_no_holonomy_and_glued_ones_close() {
    let torus = manifold("flat-torus");
    let open = json(&[
        "transport",
        &torus,
        "--curve",
        "0.1*t,0,0",
        "--from",
        "0",
        "--to",
        "1",
        "--vector",
        "1,2,3",
    ]);
    assert_eq!(open["closed"], false);
    assert!(open["holonomy"].is_null());
    assert_eq!(numbers(&open["vectors"][0]["to"]), [1.0, 2.0, 3.0]);
    let limits = asset("flat-torus").domain.limits[0].unwrap();
    let way = format!("{:?} + {:?}*t,0.1,0.2", limits[0], limits[1] - limits[0]);
    let glued = json(&[
        "transport",
        &torus,
        "--curve",
        &way,
        "--from",
        "0",
        "--to",
        "1",
    ]);
    assert_eq!(glued["closed"], true);
    assert!(glued["holonomy"]["angle"].as_f64().unwrap() < 1e-12);
}

#[test]
fn curves_through_the_faces_of_a_glued_space_close() {
    let carried = |space: &str, curve: &str, to: &str| {
        json(&[
            "transport",
            space,
            "--curve",
            curve,
            "--from",
            "0",
            "--to",
            to,
        ])
    };
    // Up through the top of the cube and in from below, turned by half.
    let half_turn = manifold("half-turn");
    let once = carried(&half_turn, "0.3*cos(t),0.2*cos(t),-0.4 + 2*t/pi", "pi");
    assert_eq!(once["closed"], true);
    let angle = once["holonomy"]["angle"].as_f64().unwrap();
    assert!(off(angle, PI) < 1e-12, "{angle}");
    let axis = vector(&once["holonomy"]["axis"]);
    assert!(axis.cross(DVec3::Z).length() < 1e-12, "{axis}");
    let twice = carried(&half_turn, "0.3*cos(t),0.2*cos(t),-0.4 + 2*t/pi", "2*pi");
    assert!(twice["holonomy"]["angle"].as_f64().unwrap() < 1e-12);
    let not = carried(&half_turn, "0.3,0.2,-0.4 + 2*t", "1");
    assert_eq!(not["closed"], false);
    // From a face to the point of another that stands for the same.
    let along = carried(&half_turn, "2*t - 1,0.1,0.2", "1");
    assert_eq!(along["closed"], true);
    // A way that turns left into right: y is mirrored.
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("m.toml");
    let text = "name = 'm'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1' }\n[[glue]]\nface = '1 - x'\nmap = ['x - 2', '-y', 'z']\n[[glue]]\nface = '1 + x'\nmap = ['x + 2', '-y', 'z']\n";
    std::fs::write(&file, text).unwrap();
    let mirrored = carried(file.to_str().unwrap(), "2*t - 0.4,0,0.1", "1");
    assert_eq!(mirrored["holonomy"]["reflected"], true);
    let axis = vector(&mirrored["holonomy"]["axis"]);
    assert!(axis.cross(DVec3::Y).length() < 1e-12, "{axis}");
}

#[test]
fn curves_that_cannot_be_are_refused_with_their_place() {
    let hole = manifold("schwarzschild");
    let refused = |curve: &str| {
        refusal(&[
            "transport",
            &hole,
            "--curve",
            curve,
            "--from",
            "0",
            "--to",
            "1",
        ])
    };
    assert!(refused("t,2").contains("three expressions"));
    let unknown = refused("5 + q,0,0");
    assert!(
        unknown.contains("unknown name `q`") && unknown.contains('^'),
        "{unknown}"
    );
    let inside = refused("5 - 5*t,0.1,0");
    assert!(inside.contains("--curve at t = 0.9"), "{inside}");
    let from = refusal(&[
        "transport",
        &hole,
        "--curve",
        "9,t,0",
        "--from",
        "x",
        "--to",
        "1",
    ]);
    assert!(from.contains("unknown name"), "{from}");
}

/// Writes a scene with a camera in a manifold of the catalogue.
fn scene(folder: &tempfile::TempDir, name: &str, at: DVec3, look: DVec3) -> String {
    let path = folder.path().join("scene.toml");
    let text = format!(
        "manifold = \"{}\"\n[camera]\nat = {:?}\nlook = {:?}\nup = [0.1, 0.2, 1.0]\nfov = 90\n",
        manifold(name),
        at.to_array(),
        look.to_array()
    );
    fs::write(&path, text).unwrap();
    path.display().to_string()
}

/// A point of S³ in R⁴, from its stereographic chart.
fn lifted(u: DVec3) -> [f64; 4] {
    let r2 = u.length_squared();
    let p = 2.0 * u / (1.0 + r2);
    [p.x, p.y, p.z, (1.0 - r2) / (1.0 + r2)]
}

#[test]
fn a_point_of_the_three_sphere_is_seen_twice_a_turn() {
    let folder = tempfile::tempdir().unwrap();
    let (camera, point) = (DVec3::new(0.3, -0.25, 0.1), DVec3::new(-0.35, 0.2, 0.6));
    let scene = scene(&folder, "s3", camera, DVec3::new(-0.6, 0.4, 0.5));
    let at = "-0.35,0.2,0.6";
    let found = json(&["project", &scene, "--point", at, "--length", "8"]);
    let dot: f64 = lifted(camera)
        .iter()
        .zip(lifted(point))
        .map(|(a, b)| a * b)
        .sum();
    let d = dot.acos();
    let images = found["images"].as_array().unwrap();
    let distances: Vec<f64> = images
        .iter()
        .map(|i| i["distance"].as_f64().unwrap())
        .collect();
    let expected = [d, TAU - d, TAU + d];
    assert_eq!(distances.len(), 3, "{distances:?}");
    for ((distance, expected), image) in distances.iter().zip(expected).zip(images) {
        assert!((distance - expected).abs() < 1e-8, "{distances:?}");
        let area = image["area"].as_f64().unwrap();
        assert!((area - d.sin().powi(2)).abs() < 1e-6, "{area}");
    }
    let [a, b] = [0, 1].map(|k| vector(&images[k]["direction"]));
    assert!((a + b).length() < 1e-7);
    // The pixel is that of the direction.
    let pixel = numbers(&images[0]["pixel"]);
    let stage = geofan_render::Stage::load(scene.as_ref(), &[]).unwrap();
    let view = stage.view_of(None, (1280, 720)).unwrap();
    assert!((view.direction(pixel[0], pixel[1]) - a).length() < 1e-9);
    assert!(images[1]["pixel"].is_null());
}

#[test]
fn a_point_behind_a_black_hole_has_an_image_on_either_side() {
    let folder = tempfile::tempdir().unwrap();
    let camera = DVec3::new(9.0, 2.0, -3.0);
    let point = DVec3::new(-8.0, -1.0, 3.5);
    let scene = scene(&folder, "schwarzschild", camera, -camera);
    let found = json(&["project", &scene, "--point", "-8,-1,3.5", "--length", "40"]);
    let images = found["images"].as_array().unwrap();
    assert!(images.len() >= 2, "{images:?}");
    let hole = asset("schwarzschild");
    let normal = camera.cross(point).normalize();
    let mut sides = Vec::new();
    for image in images {
        let d = vector(&image["direction"]);
        // In the plane of the orbit: the chart is conformal.
        assert!(d.dot(normal).abs() < 1e-7, "{d}");
        let distance = image["distance"].as_f64().unwrap();
        let ray = Ray::new(&hole, camera, d, distance);
        let path = paths(&hole, settings(1e-12, true), [ray]).remove(0);
        let end = path.steps.last().unwrap().position(distance);
        assert!((end - point).length() < 1e-6, "{end}");
        sides.push(d.cross(-camera).dot(normal) > 0.0);
    }
    assert_ne!(sides[0], sides[1]);
    assert_eq!(images[1]["mirrored"], true);
}

#[test]
fn in_flat_space_the_first_order_is_exact() {
    let folder = tempfile::tempdir().unwrap();
    let camera = DVec3::new(0.5, -0.2, 0.1);
    let scene = scene(&folder, "flat", camera, DVec3::new(1.0, 0.2, -0.1));
    let found = json(&[
        "project",
        &scene,
        "--point",
        "2.5,0.3,0.4",
        "--length",
        "9",
        "--size",
        "640x360",
    ]);
    let images = found["images"].as_array().unwrap();
    assert_eq!(images.len(), 1);
    let (local, exact) = (
        numbers(&found["local"]["pixel"]),
        numbers(&images[0]["pixel"]),
    );
    assert!((local[0] - exact[0]).abs() < 1e-6 && (local[1] - exact[1]).abs() < 1e-6);
    let distance = (DVec3::new(2.5, 0.3, 0.4) - camera).length();
    assert!((images[0]["distance"].as_f64().unwrap() - distance).abs() < 1e-9);
    assert!((vector(&found["local"]["p"]).length() - distance).abs() < 1e-12);
    assert!((images[0]["area"].as_f64().unwrap() - distance * distance).abs() < 1e-6);
    let nowhere = refusal(&["project", &scene, "--point", "1,2"]);
    assert!(nowhere.contains("three numbers"));
}

/// Light takes the Killing time s to go along a path of the parameter s, so that what it shows at the time t left at
/// t − s: through faces, and with and against the wind, as long as to the image that stands alone in the cover.
#[test]
fn light_of_every_image_in_a_glued_wind_has_been_under_way_as_long_as_the_lattice_says() {
    let (folder, wind, length) = (tempfile::tempdir().unwrap(), 0.4, 4.0);
    let glued = |face: &str, map: &str| format!("[[glue]]\nface = \"{face}\"\nmap = [{map}]\n");
    let faces = [
        glued("1 - z", "\"-x\", \"-y\", \"z - 2\""),
        glued("1 + z", "\"-x\", \"-y\", \"z + 2\""),
        glued("1 - x", "\"x - 2\", \"y\", \"z\""),
        glued("1 + x", "\"x + 2\", \"y\", \"z\""),
    ];
    let text = format!(
        "name = \"wind\"\ncoordinates = [\"x\", \"y\", \"z\"]\nmetric = {{ conformal = \"1\" }}\nwind = [\"0\", \"0\", \"{wind}\"]\n{}",
        faces.concat()
    );
    fs::write(folder.path().join("wind.toml"), text).unwrap();
    let (camera, point) = (DVec3::new(0.1, 0.1, 0.05), DVec3::new(0.2, 0.5, -0.3));
    let scene = folder.path().join("scene.toml");
    let text = "manifold = \"wind.toml\"\n[camera]\nat = [0.1, 0.1, 0.05]\nlook = [0, 1, 0]\nup = [0, 0, 1]\n";
    fs::write(&scene, text).unwrap();
    let found = json(&[
        "project",
        &scene.display().to_string(),
        "--point",
        "0.2,0.5,-0.3",
        "--length",
        "4",
    ]);
    // From each image q a straight way with the wind: |camera − q − W s| = s.
    let mut expected = Vec::new();
    for (k, m) in (-6..=6).flat_map(|k| (-6..=6).map(move |m| (k, m))) {
        let turned = if k % 2 == 0 { 1.0 } else { -1.0 };
        let image = point * DVec3::new(turned, turned, 1.0)
            + 2.0 * DVec3::new(f64::from(m), 0.0, f64::from(k));
        let (off, rest) = (image - camera, 1.0 - wind * wind);
        let along = wind * off.z;
        let s = (along + (along * along + rest * off.length_squared()).sqrt()) / rest;
        expected.push((s, (off + DVec3::Z * (wind * s)) / s));
    }
    expected.retain(|(s, _)| *s < length);
    expected.sort_by(|a, b| a.0.total_cmp(&b.0));
    let images = found["images"].as_array().unwrap();
    assert_eq!(images.len(), expected.len());
    assert_eq!(images.len(), 12);
    for (image, (s, direction)) in images.iter().zip(expected) {
        let own = image["distance"].as_f64().unwrap();
        assert!((own - s).abs() < 1e-9, "{own} {s}");
        assert!((vector(&image["direction"]) - direction).length() < 1e-9);
    }
}

/// Between walls that are mirrors a point has the images of a kaleidoscope: two parallel ones, and one across.
#[test]
fn images_in_mirrors_are_those_of_the_kaleidoscope() {
    let found_in = |faces: String| {
        let folder = tempfile::tempdir().unwrap();
        let text = format!(
            "name = \"room\"\ncoordinates = [\"x\", \"y\", \"z\"]\nmetric = {{ conformal = \"1\" }}\n{faces}"
        );
        fs::write(folder.path().join("room.toml"), text).unwrap();
        let scene = folder.path().join("scene.toml");
        let text = "manifold = \"room.toml\"\n[camera]\nat = [0.1, 0.3, 0.05]\nlook = [0, 1, 0]\nup = [0, 0, 1]\n";
        fs::write(&scene, text).unwrap();
        let scene = scene.display().to_string();
        json(&[
            "project",
            &scene,
            "--point",
            "0.2,0.5,-0.3",
            "--length",
            "9",
        ])
    };
    let faces = ["1 - x", "1.5 + x", "y + 0.8"];
    let mirror = |face: &str| format!("[[glue]]\nface = \"{face}\"\nmirror = true\n");
    let found = found_in(faces.map(mirror).concat());
    // The same by maps that are reflections, in the cover.
    let images = [
        "\"2 - x\", \"y\", \"z\"",
        "\"-3 - x\", \"y\", \"z\"",
        "\"x\", \"-1.6 - y\", \"z\"",
    ];
    let maps = faces.iter().zip(images);
    let maps = maps.map(|(face, map)| format!("[[glue]]\nface = \"{face}\"\nmap = [{map}]\n"));
    let by_maps = found_in(maps.collect());
    let sides = |found: &Value| {
        let images = found["images"].as_array().unwrap().iter();
        let image = |image: &Value| image["mirrored"].as_bool().unwrap();
        images.map(image).collect::<Vec<_>>()
    };
    assert_eq!(sides(&found), sides(&by_maps));
    let (camera, point) = (DVec3::new(0.1, 0.3, 0.05), DVec3::new(0.2, 0.5, -0.3));
    // Two walls 2.5 apart: shifts by 5, and the reflections in one of them; and in the third.
    let across = (-3..=3).flat_map(|k| {
        [
            (5.0 * f64::from(k) + point.x, 0),
            (5.0 * f64::from(k) + 2.0 - point.x, 1),
        ]
    });
    let images =
        across.flat_map(|(x, turns)| [(x, point.y, turns), (x, -1.6 - point.y, turns + 1)]);
    let mut expected: Vec<(DVec3, bool)> = images
        .map(|(x, y, turns)| (DVec3::new(x, y, point.z) - camera, turns % 2 == 1))
        .filter(|(way, _)| way.length() < 9.0)
        .collect();
    expected.sort_by(|a, b| a.0.length().total_cmp(&b.0.length()));
    let images = found["images"].as_array().unwrap();
    assert_eq!(images.len(), expected.len());
    assert!(images.len() > 12, "{}", images.len());
    for (image, (way, mirrored)) in images.iter().zip(expected) {
        let [distance, area] = ["distance", "area"].map(|name| image[name].as_f64().unwrap());
        assert!((distance - way.length()).abs() < 1e-9, "{distance} {way}");
        assert!(
            (area / way.length_squared() - 1.0).abs() < 1e-6,
            "{area} {way}"
        );
        assert_eq!(image["mirrored"], mirrored);
        assert!((vector(&image["direction"]) - way.normalize()).length() < 1e-9);
    }
}

/// Nothing depends on the unit of length, nor on where the chart's origin is.
#[test]
fn images_do_not_depend_on_the_unit_of_length_or_on_the_origin() {
    let images = |unit: f64, shift: f64| {
        let folder = tempfile::tempdir().unwrap();
        let text = format!(
            "name = \"lens\"\ncoordinates = [\"x\", \"y\", \"z\"]\n\
             metric = {{ conformal = \"1 + 1.2*exp(-((x - {shift})^2 + y^2 + z^2)/{unit}^2)\" }}\n"
        );
        fs::write(folder.path().join("lens.toml"), text).unwrap();
        let scene = folder.path().join("scene.toml");
        let text = format!(
            "manifold = \"lens.toml\"\n[camera]\nat = [{}, {}, 0]\nlook = [-1, 0, 0]\nup = [0, 0, 1]\n",
            shift + 3.0 * unit,
            0.2 * unit
        );
        fs::write(&scene, text).unwrap();
        let point = format!("{},{},{}", shift - 3.0 * unit, -0.3 * unit, -0.1 * unit);
        let found = json(&[
            "project",
            &scene.display().to_string(),
            &format!("--point={point}"),
            &format!("--length={}", 12.0 * unit),
        ]);
        let images = found["images"].as_array().unwrap().iter();
        let image = |image: &Value| {
            (
                image["distance"].as_f64().unwrap() / unit,
                vector(&image["direction"]),
            )
        };
        images.map(image).collect::<Vec<_>>()
    };
    let plain = images(1.0, 0.0);
    assert!(plain.len() > 2, "{}", plain.len());
    for (unit, shift) in [(1e9, 0.0), (1e-9, 0.0), (1.0, 1e7)] {
        let other = images(unit, shift);
        assert_eq!(other.len(), plain.len(), "{unit} {shift}");
        for ((s, d), (other_s, other_d)) in plain.iter().zip(other) {
            assert!((s / other_s - 1.0).abs() < 1e-7, "{s} {other_s}");
            assert!((*d - other_d).length() < 1e-6, "{d} {other_d}");
        }
    }
}

/// The unit quaternions with the left-invariant metric Σ A² σ², stereographic: no caustic of it is a single point.
const BERGER: &str = r#"
name = "triaxial sphere"
coordinates = ["x", "y", "z"]
[let]
k = "2/(1 + x^2 + y^2 + z^2)"
s11 = "k*(k-1) + k^2*x*x"
s12 = "k^2*x*y + k^2*z"
s13 = "k^2*x*z - k^2*y"
s21 = "k^2*y*x - k^2*z"
s22 = "k*(k-1) + k^2*y*y"
s23 = "k^2*y*z + k^2*x"
s31 = "k^2*z*x + k^2*y"
s32 = "k^2*z*y - k^2*x"
s33 = "k*(k-1) + k^2*z*z"
[metric]
xx = "s11*s11 + 0.64*s21*s21 + 1.69*s31*s31"
xy = "s11*s12 + 0.64*s21*s22 + 1.69*s31*s32"
xz = "s11*s13 + 0.64*s21*s23 + 1.69*s31*s33"
yy = "s12*s12 + 0.64*s22*s22 + 1.69*s32*s32"
yz = "s12*s13 + 0.64*s22*s23 + 1.69*s32*s33"
zz = "s13*s13 + 0.64*s23*s23 + 1.69*s33*s33"
"#;

/// Images that Euler's equations of the spinning top give, too, by twelve thousand directions and Newton's method.
#[test]
fn images_beside_a_caustic_are_found_at_any_length() {
    let manifold = Manifold::from_source(SourceText::new("berger", BERGER), &[]).unwrap();
    let from = DVec3::new(0.15, -0.1, 0.12);
    let to = DVec3::new(0.7071747221936483, -0.4198378451508048, -2.174163261261156);
    let expected = [2.048289, 2.938374, 2.967906, 3.256381, 3.307331, 4.335753];
    for length in [4.5, 4.75, 5.0] {
        let margin = 0.25 * (to - from).length();
        let fan = LightFan::to_point(&manifold, from, length, (to, margin));
        let (found, _) = fan.connections(&[to], 1e-10);
        let distances = found.iter().map(|(_, image)| image.s);
        let distances: Vec<f64> = distances.filter(|s| *s < 4.4).collect();
        assert_eq!(distances.len(), expected.len(), "{length}: {distances:?}");
        for (s, expected) in distances.iter().zip(expected) {
            assert!((s - expected).abs() < 1e-6, "{length}: {distances:?}");
        }
    }
}
