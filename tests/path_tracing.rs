//! The path tracer against what must come out whatever the space is.

mod support;

use geofan_light::{
    cache,
    path_tracer::{Estimator, PassAccumulator, PathTracer, PathTracerSettings},
};
use geofan_render::{
    ExactTracer, Stage, View,
    frame::{Paths, offsets, trace},
    picture::Picture,
    shade::{Footprints, shade},
};
use geofan_study::picture::psnr;
use glam::DVec3;
use ndarray::Axis;
use std::{
    f64::consts::{PI, TAU},
    path::Path,
};
use support::{film, mean};

const FLAT: &str = "metric = { conformal = '1' }";
const SPHERE: &str = "metric = { conformal = '2/(1 + x^2 + y^2 + z^2)' }";
const BUMP: &str = "embedding = ['x', 'y', 'z', 'exp(-(x^2 + y^2 + z^2)/2)']";

/// A cube of side 2 whose faces look outwards, of one material.
fn cube(material: &str) -> (String, String) {
    let mut text = String::from("mtllib cube.mtl\nusemtl m\ns off\n");
    for i in 0..8 {
        let sign = |bit: i32| if i >> bit & 1 == 1 { 1 } else { -1 };
        text += &format!("v {} {} {}\n", sign(0), sign(1), sign(2));
    }
    text += "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n";
    (text, format!("newmtl m\n{material}\n"))
}

/// A ball of radius 1 as a mesh, and its surface.
fn ball() -> (String, f64) {
    let (rows, columns) = (12, 24);
    let at = |i: i32, j: i32| {
        let (t, p) = (
            PI * f64::from(i) / f64::from(rows),
            TAU * f64::from(j) / f64::from(columns),
        );
        DVec3::new(t.sin() * p.cos(), t.sin() * p.sin(), t.cos())
    };
    let mut text = String::from("mtllib ball.mtl\nusemtl m\n");
    let (mut area, mut count) = (0.0, 0);
    for i in 0..rows {
        for j in 0..columns {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            for [p, q, r] in [[a, b, c], [a, c, d]] {
                let doubled = (q - p).cross(r - p).length();
                if doubled > 1e-9 {
                    for v in [p, q, r] {
                        text += &format!("v {} {} {}\n", v.x, v.y, v.z);
                    }
                    text += &format!("f {} {} {}\n", count + 1, count + 2, count + 3);
                    count += 3;
                    area += 0.5 * doubled;
                }
            }
        }
    }
    (text, area)
}

/// Writes a scene of `objects` (name, MTL text, scene entry) in a space; every mesh is a cube, but one
/// called `ball` is that.
fn stage(
    folder: &Path,
    metric: &str,
    camera: &str,
    objects: &[(&str, &str, &str)],
    rest: &str,
) -> Stage {
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).unwrap();
    write(
        "space.toml",
        &format!(
            "name = 'space'\ncoordinates = ['x', 'y', 'z']\n{metric}\n[cameras]\nlength = 8\n"
        ),
    );
    let mut scene = format!("manifold = 'space.toml'\n[camera]\n{camera}\n");
    for (name, material, entry) in objects {
        let (mesh, material) = cube(material);
        let mesh = if *name == "ball" { ball().0 } else { mesh };
        write(&format!("{name}.obj"), &mesh.replace("cube", name));
        write(&format!("{name}.mtl"), &material);
        scene += &format!("[[object]]\nmesh = '{name}.obj'\n{entry}\n");
    }
    write("scene.toml", &(scene + rest));
    Stage::load(&folder.join("scene.toml"), &[]).unwrap()
}

fn settings(estimator: Estimator) -> PathTracerSettings {
    PathTracerSettings {
        seed: 1,
        length: 8.0,
        tolerance: 1e-6,
        bounces: u32::MAX,
        estimator,
    }
}

fn view(stage: &Stage, size: (usize, usize)) -> View {
    stage.view(&stage.scene.camera, size).unwrap()
}

#[test]
fn in_a_furnace_everything_is_as_bright_as_the_series_says() {
    for metric in [FLAT, SPHERE, BUMP] {
        for albedo in [0.6] {
            let folder = tempfile::tempdir().unwrap();
            let stage = stage(
                folder.path(),
                metric,
                "at = [0.1, 0.2, -0.1]\nlook = [1, 0.2, 0.1]\nup = [0, 0, 1]\nfov = 120",
                &[(
                    "room",
                    &format!("Kd {albedo}\nKe 1\nillum 1"),
                    "at = [0.0, 0.1, 0.0]\nscale = 1.3",
                )],
                "",
            );
            let view = view(&stage, (12, 12));
            for estimator in [Estimator::Connected, Estimator::Scattered] {
                let film = film(&stage, &view, settings(estimator), 16);
                let (found, error) = mean(&film, 0..12, 0..12);
                let expected = 1.0 / (1.0 - albedo);
                assert!(
                    error < 0.02 * expected,
                    "{metric} {estimator:?}: error {error}"
                );
                assert!(
                    (found - expected).abs() < 4.0 * error + 1e-6,
                    "{metric} {albedo} {estimator:?}: {found} ± {error}, not {expected}"
                );
            }
        }
    }
}

#[test]
fn light_of_surfaces_comes_through_no_mirror_and_no_portal() {
    let disc = "opening = '25 - y^2 - z^2'\n";
    let mirror = format!(
        "{FLAT}\n[[glue]]\nface = '-x'\nmirror = true\n{disc}[[glue]]\nface = 'x'\nmirror = true\n{disc}"
    );
    let portal = format!("{FLAT}\n[[glue]]\nface = '-x'\nmap = ['x', 'y - 40', 'z']\n{disc}");
    for (metric, lit) in [(FLAT, true), (&mirror, false), (&portal, false)] {
        let folder = tempfile::tempdir().unwrap();
        let objects = [
            ("matt", "Kd 0.8\nillum 1", "at = [-2, 0, 0]\nscale = 0.3"),
            (
                "lamp",
                "Kd 0\nKe 50\nillum 1",
                "at = [2, 0, 0]\nscale = 0.3",
            ),
        ];
        let camera = "at = [-1, 0.8, 0.2]\nlook = [-1, -0.8, -0.2]\nup = [0, 0, 1]\nfov = 15";
        let stage = stage(folder.path(), metric, camera, &objects, "");
        let direct = PathTracerSettings {
            bounces: 1,
            ..settings(Estimator::Connected)
        };
        let film = film(&stage, &view(&stage, (8, 8)), direct, 8);
        let (light, _) = mean(&film, 0..8, 0..8);
        assert_eq!(light > 0.0, lit, "{metric}: {light}");
    }
}

/// A floor under a lamp in the space `metric`; `lamp` is what lights it.
fn floor(folder: &Path, metric: &str, objects: &[(&str, &str, &str)], rest: &str) -> Stage {
    let mut all = vec![(
        "floor",
        "Kd 0.6 0.7 0.5\nillum 1",
        "at = [0, 0, -1.0]\nscale = 0.5",
    )];
    all.extend_from_slice(objects);
    stage(
        folder,
        metric,
        "at = [-0.7, 0.1, 0.3]\nlook = [0.7, 0, -0.8]\nup = [0, 0, 1]\nfov = 40",
        &all,
        rest,
    )
}

#[test]
fn a_shrinking_area_light_becomes_a_point_light() {
    for metric in [FLAT, SPHERE, BUMP] {
        let folder = tempfile::tempdir().unwrap();
        let lamp = "[[light]]\nkind = 'point'\nat = [0.1, 0.2, 0.6]\nintensity = [1, 1, 1]\n";
        let stage = floor(folder.path(), metric, &[], lamp);
        let direct = |estimator| PathTracerSettings {
            bounces: 1,
            ..settings(estimator)
        };
        let of_point = film(
            &stage,
            &view(&stage, (12, 8)),
            direct(Estimator::Connected),
            4,
        );
        let (point, _) = mean(&of_point, 0..12, 0..8);
        assert!(point > 1e-3, "{metric}: {point}");
        let surface = ball().1;
        for (radius, allowed) in [(0.2, 0.2), (0.02, 0.012)] {
            // A round body's intensity is its radiance times a quarter of its surface.
            let radiance = 4.0 / (surface * radius * radius);
            let folder = tempfile::tempdir().unwrap();
            let material = format!("Kd 0\nKe {radiance}\nillum 1");
            let entry = format!("at = [0.1, 0.2, 0.6]\nscale = {radius}");
            let stage = floor(folder.path(), metric, &[("ball", &material, &entry)], "");
            // Only the floor is looked at, not the lamp.
            let of_area = film(
                &stage,
                &view(&stage, (12, 8)),
                direct(Estimator::Connected),
                120,
            );
            let (area, error) = mean(&of_area, 0..12, 0..8);
            assert!(error < 0.03 * area, "{error} of {area}");
            let off = (area / point - 1.0).abs();
            assert!(
                off < allowed + 4.0 * error / area,
                "{metric}, radius {radius}: {off}"
            );
        }
    }
}

#[test]
fn the_light_of_a_sky_does_not_depend_on_the_pictures_size() {
    let folder = tempfile::tempdir().unwrap();
    // White within ten degrees of the zenith, else black.
    let spot = image::GrayImage::from_fn(360, 180, |_, y| image::Luma([255 * u8::from(y < 10)]));
    spot.save(folder.path().join("spot.png")).unwrap();
    let space = format!("{FLAT}\n[[exit]]\nname = 'far'\nwhen = 'x^2 + y^2 + z^2 - 16'");
    let sky = "[sky]\nfar = { image = 'spot.png' }\n";
    let stage = floor(folder.path(), &space, &[], sky);
    let expected = 0.7 * 10.0_f64.to_radians().sin().powi(2);
    for (size, samples) in [(8, 2304), (48, 64)] {
        let view = view(&stage, (size, size));
        let film = film(&stage, &view, settings(Estimator::Connected), samples);
        // Only the floor is in the middle.
        let middle = size / 4..3 * size / 4;
        let (found, error) = mean(&film, middle.clone(), middle);
        assert!(error < 0.06 * expected, "{error} of {expected}");
        assert!(
            (found - expected).abs() < 4.0 * error,
            "{size}: {found} ± {error}, not {expected}"
        );
    }
}

#[test]
fn connecting_to_lights_changes_the_noise_and_not_the_picture() {
    let glossy = "Kd 0.3 0.2 0.2\nKs 0.5\nNs 40\nillum 2";
    let lamp = (
        "lamp",
        "Kd 0\nKe 9 8 6\nillum 1",
        "at = [0.2, 0.3, 0.75]\nscale = 0.25",
    );
    let body = (
        "body",
        glossy,
        "at = [0.15, -0.35, -0.3]\nscale = 0.2\nrotate = { axis = [0, 0, 1], degrees = 25 }",
    );
    for metric in [FLAT, SPHERE, BUMP] {
        let folder = tempfile::tempdir().unwrap();
        let stage = floor(folder.path(), metric, &[lamp, body], "");
        let view = view(&stage, (32, 24));
        let connected = film(&stage, &view, settings(Estimator::Connected), 10);
        let scattered = film(&stage, &view, settings(Estimator::Scattered), 60);
        let (mut agree, mut blocks) = (0, 0);
        for y in (0..24).step_by(8) {
            for x in (0..32).step_by(8) {
                let (a, ea) = mean(&connected, x..x + 8, y..y + 8);
                let (b, eb) = mean(&scattered, x..x + 8, y..y + 8);
                blocks += 1;
                agree += i32::from((a - b).abs() <= 3.0 * ea.hypot(eb) + 1e-9);
            }
        }
        assert!(
            100 * agree >= 95 * blocks,
            "{metric}: {agree} of {blocks} blocks agree"
        );
    }
}

/// The mean of the middle of a picture of a body in a room that shines with radiance 1, and its error.
fn in_a_shining_room(metric: &str, material: &str) -> (f64, f64) {
    let folder = tempfile::tempdir().unwrap();
    let stage = stage(
        folder.path(),
        metric,
        "at = [-0.6, 0.05, 0.1]\nlook = [1, 0, 0]\nup = [0, 0, 1]\nfov = 60",
        &[
            ("room", "Kd 0\nKe 1\nillum 1", "at = [0, 0, 0]\nscale = 1.5"),
            (
                "body",
                material,
                "at = [0.1, 0, 0]\nscale = 0.3\nrotate = { axis = [1, 2, 0], degrees = 40 }",
            ),
        ],
        "",
    );
    let view = view(&stage, (16, 12));
    let film = film(&stage, &view, settings(Estimator::Connected), 16);
    mean(&film, 6..10, 4..8)
}

#[test]
fn glass_and_mirrors_keep_the_furnace() {
    // Whatever is in the furnace, it cannot be told from its surroundings.
    for material in ["Kd 0\nNi 1.5\nillum 7", "Kd 0\nKs 1\nillum 3"] {
        let (found, error) = in_a_shining_room(SPHERE, material);
        assert!(
            (found - 1.0).abs() < 4.0 * error + 2e-3,
            "{material}: {found} ± {error}"
        );
    }
}

#[test]
fn a_half_transparent_body_in_the_furnace_is_as_bright_as_the_series_says() {
    // A wall of albedo a lets 1 − d through and reflects d a. Inside the convex body the radiance is
    // I = (1 − d) + d a I, and from outside one sees d a + (1 − d) I. In flat space light that leaves
    // it does not come back.
    let (d, a) = (0.4, 0.9);
    let inside = (1.0 - d) / (1.0 - d * a);
    let expected = d * a + (1.0 - d) * inside;
    assert!((expected - 0.9225_f64).abs() < 1e-12);
    let (found, error) = in_a_shining_room(FLAT, "Kd 0.9\nd 0.4\nillum 1");
    assert!(error < 0.03, "{error}");
    assert!(
        (found - expected).abs() < 4.0 * error + 2e-3,
        "{found} ± {error}, not {expected}"
    );
}

#[test]
fn the_same_picture_comes_from_one_thread_and_from_two_and_after_a_pause() {
    let folder = tempfile::tempdir().unwrap();
    let lamp = (
        "lamp",
        "Kd 0\nKe 9 8 6\nillum 1",
        "at = [0.2, 0.3, 0.75]\nscale = 0.25",
    );
    let stage = floor(folder.path(), BUMP, &[lamp], "");
    let view = view(&stage, (72, 60));
    let render = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| film(&stage, &view, settings(Estimator::Connected), 2))
    };
    let whole = render(1);
    assert_eq!(whole, render(2));
    let path = folder.path().join("a.passes");
    film(&stage, &view, settings(Estimator::Connected), 1)
        .save(&path, &[0; 32])
        .unwrap();
    let mut resumed = PassAccumulator::load(&path, &[0; 32], view.size).unwrap();
    let tracer = PathTracer::new(&stage.world, &view, settings(Estimator::Connected));
    resumed.add(&tracer.pass(resumed.passes(), || false).unwrap());
    assert_eq!(whole, resumed);
    assert!(tracer.pass(2, || true).is_none());
}

#[test]
fn baked_light_shows_what_the_path_tracer_does() {
    let folder = tempfile::tempdir().unwrap();
    let lamp = "[[light]]\nkind = 'point'\nat = [0.1, 0.3, 0.9]\nintensity = [2, 2, 2]\n";
    let body = (
        "body",
        "Kd 0.7 0.4 0.3\nillum 1",
        "at = [0.15, -0.2, -0.3]\nscale = 0.2\nrotate = { axis = [0, 0, 1], degrees = 25 }",
    );
    let mut stage = floor(folder.path(), BUMP, &[body], lamp);
    let view = view(&stage, (40, 30));
    let direct = PathTracerSettings {
        bounces: 1,
        ..settings(Estimator::Connected)
    };
    // As many samples as it takes for edges to be as smooth in both.
    let reference = film(&stage, &view, direct, 64).picture();
    let (light, _) = cache::light(&stage.world, 8.0, 1e-6, None, |_, _| {});
    stage.world.light = Some(light);
    let tracer = ExactTracer::new(&stage.world.manifold, view.u, 8.0, 1e-8);
    let outcomes = trace(&stage.world, &view, Paths::Exact(&tracer), &offsets(64)).outcomes;
    let colours = shade(
        &stage.world,
        &view,
        outcomes.view(),
        64,
        Footprints::Filtered,
    );
    // The mean of a pixel's own samples, as the path tracer takes it.
    let preview = Picture::new(colours.mean_axis(Axis(2)).unwrap());
    let found = psnr(&reference, &preview).unwrap();
    assert!(found >= 38.0, "{found} dB");
    assert!(
        reference
            .pixel(20, 20)
            .iter()
            .copied()
            .map(f64::from)
            .fold(0.0, f64::max)
            > 0.05
    );
}
