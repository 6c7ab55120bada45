//! Surfaces that are not solid: opacities, holes and what lies behind, in every tracer, against what
//! must come out of colours laid over each other.

use geofan_light::{
    Lamps, cache,
    path_tracer::{Estimator, PassAccumulator, PathTracer, PathTracerSettings},
};
use geofan_render::{
    ExactTracer, FixedTracer, Stage, SurfacePoint, View, drawing::draw, frame::Paths, no_clock,
    picture::Picture, shade::Footprints,
};
use glam::DVec3;
use std::path::Path;

const LENGTH: f64 = 8.0;

const SKY: [f32; 3] = [0.1, 0.2, 0.4];

/// Writes a scene in flat space: squares of side 2 across the x axis, each at its x with its material,
/// whose texture is open on the right. The camera looks along −x from 2.
fn stage(folder: &Path, squares: &[(f64, &str)], rest: &str) -> Stage {
    stage_in("1", folder, squares, rest)
}

/// Writes it in a space with this conformal factor.
fn stage_in(factor: &str, folder: &Path, squares: &[(f64, &str)], rest: &str) -> Stage {
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).unwrap();
    let leaf: Vec<u8> = (0..16)
        .flat_map(|x| [255, 255, 255, if x < 8 { 255 } else { 0 }])
        .collect();
    image::save_buffer(
        folder.join("leaf.png"),
        &leaf,
        16,
        1,
        image::ColorType::Rgba8,
    )
    .unwrap();
    let space = format!(
        "name = 'space'\ncoordinates = ['x', 'y', 'z']\nmetric = {{ conformal = '{factor}' }}\n\
         exit = [{{ name = 'sky', when = 'x^2 + y^2 + z^2 - 16' }}]\n[cameras]\nlength = 8\n",
    );
    write("space.toml", &space);
    let mut scene = String::from(
        "manifold = 'space.toml'\n[camera]\nat = [2, 0, 0]\nlook = [-1, 0, 0]\nup = [0, 0, 1]\nfov = 40\n",
    );
    for (i, (x, material)) in squares.iter().enumerate() {
        let obj = "v 0 -1 -1\nv 0 1 -1\nv 0 1 1\nv 0 -1 1\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3 4/4\n";
        write(&format!("{i}.obj"), &format!("mtllib {i}.mtl\n{obj}"));
        write(&format!("{i}.mtl"), &format!("newmtl m\n{material}\n"));
        scene += &format!("[[object]]\nmesh = '{i}.obj'\nat = [{x}, 0, 0]\n");
    }
    write("scene.toml", &(scene + rest));
    Stage::load(&folder.join("scene.toml"), &[]).unwrap_or_else(|e| panic!("{}", e.report(false)))
}

fn sky() -> String {
    format!("[sky]\nsky = {{ color = {SKY:?} }}\n")
}

/// The scene as each tracer shows it.
fn pictures(stage: &Stage) -> Vec<(&'static str, Picture)> {
    let (world, size) = (&stage.world, (16, 12));
    let view = &stage.view(&stage.scene.camera, size).unwrap();
    let exact = ExactTracer::new(&world.manifold, view.u, LENGTH, 1e-8);
    let fixed = FixedTracer::new(&world.manifold, view.u, LENGTH, 64);
    let by =
        |paths: Paths<'_>| draw(world, view, paths, 1, Footprints::Filtered, &no_clock).picture;
    vec![
        ("exact", by(Paths::Exact(&exact))),
        ("direct", by(Paths::Direct(&fixed))),
        ("lattice", by(Paths::Lattice(&fixed, 5e-4))),
        ("local", by(Paths::Straight(LENGTH))),
        ("path", path_traced(stage, view)),
    ]
}

fn path_traced(stage: &Stage, view: &View) -> Picture {
    let settings = PathTracerSettings {
        seed: 3,
        length: LENGTH,
        tolerance: 1e-6,
        bounces: 1,
        estimator: Estimator::Connected,
    };
    let tracer = PathTracer::new(&stage.world, view, settings);
    let mut sum = PassAccumulator::new(view.size);
    for pass in 0..1024 {
        sum.add(&tracer.pass(pass, || false).unwrap());
    }
    sum.picture()
}

/// Colours laid over each other from the front, each with its opacity, over the sky.
fn over(layers: &[([f32; 3], f32)]) -> [f32; 3] {
    let mix = |behind: [f32; 3], (colour, opacity): &([f32; 3], f32)| {
        [0, 1, 2].map(|k| colour[k] * opacity + behind[k] * (1.0 - opacity))
    };
    layers.iter().rev().fold(SKY, mix)
}

#[track_caller]
fn check(stage: &Stage, column: usize, known: [f32; 3]) {
    for (name, picture) in pictures(stage) {
        // Chance leaves the path tracer half the square root of a thousandth.
        let allowed = if name == "path" { 0.05 } else { 2e-3 };
        let found = picture.pixel(column, 6);
        let same = (0..3).all(|k| (found[k] - known[k]).abs() < allowed);
        assert!(same, "{name}: {found:?} is not {known:?}");
    }
}

const RED: &str = "Kd 0\nKe 1 0 0\nillum 1\n";
const GREEN: &str = "Kd 0\nKe 0 1 0\nillum 1\n";

#[test]
fn half_a_surface_lets_half_of_the_sky_through() {
    let folder = tempfile::tempdir().unwrap();
    let stage = stage(folder.path(), &[(0.0, &format!("{RED}d 0.5"))], &sky());
    check(&stage, 8, over(&[([1.0, 0.0, 0.0], 0.5)]));
}

#[test]
fn what_is_behind_half_a_surface_in_a_lens_is_the_same_by_interpolated_and_by_exact_paths() {
    let folder = tempfile::tempdir().unwrap();
    let lens = "1 + 0.8*exp(-(x^2 + y^2 + z^2)/2)";
    let squares = [(0.4, &*format!("{RED}d 0.5"))];
    let grid = "[sky]\nsky = { pattern = \"grid\" }\n";
    let stage = stage_in(lens, folder.path(), &squares, grid);
    let (world, size) = (&stage.world, (48, 36));
    let view = &stage.view(&stage.scene.camera, size).unwrap();
    let exact = ExactTracer::new(&world.manifold, view.u, LENGTH, 1e-8);
    let fixed = FixedTracer::new(&world.manifold, view.u, LENGTH, 64);
    let by = |paths| {
        draw(world, view, paths, 1, Footprints::Filtered, &no_clock)
            .picture
            .rgb
    };
    let [truth, found] = [Paths::Exact(&exact), Paths::Lattice(&fixed, 5e-4)].map(by);
    let off = |(a, b): &(&f32, &f32)| (**a - **b).abs() > 0.02;
    let off = truth.iter().zip(&found).filter(off).count();
    assert!(off * 50 < truth.len(), "{off} of {}", truth.len());
}

#[test]
fn surfaces_behind_each_other_are_laid_over_each_other() {
    let folder = tempfile::tempdir().unwrap();
    let squares = [
        (0.0, format!("{RED}d 0.5")),
        (-0.5, format!("{GREEN}Tr 0.75")),
        (-1.0, format!("{RED}d 0")),
        (-1.5, format!("{GREEN}d 0.5")),
    ];
    let squares = squares.each_ref().map(|(x, m)| (*x, m.as_str()));
    let stage = stage(folder.path(), &squares, &sky());
    let known = over(&[
        ([1.0, 0.0, 0.0], 0.5),
        ([0.0, 1.0, 0.0], 0.25),
        ([0.0, 1.0, 0.0], 0.5),
    ]);
    check(&stage, 8, known);
}

#[test]
fn a_surface_that_is_not_there_is_told_and_not_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let stage = stage(folder.path(), &[(0.0, &format!("{RED}d 0"))], &sky());
    let told = &stage.world.warnings;
    assert!(
        told.iter()
            .any(|w| w.contains("`m`") && w.contains("not there at all")),
        "{told:?}"
    );
    check(&stage, 8, SKY);
}

#[test]
fn the_alpha_of_a_texture_cuts_holes_whatever_the_tracer() {
    let folder = tempfile::tempdir().unwrap();
    let squares = [
        (0.0, format!("{RED}map_Kd leaf.png")),
        (-1.0, format!("{GREEN}d 0.5")),
    ];
    let squares = squares.each_ref().map(|(x, m)| (*x, m.as_str()));
    let stage = stage(folder.path(), &squares, &sky());
    // The square's texture runs to the right of the picture with y, which is on the right.
    check(&stage, 4, [1.0, 0.0, 0.0]);
    check(&stage, 11, over(&[([0.0, 1.0, 0.0], 0.5)]));
}

#[test]
fn light_comes_through_in_proportion_and_through_holes_whole() {
    let folder = tempfile::tempdir().unwrap();
    let lamp = "[[light]]\nkind = 'point'\nat = [1.5, 0, 0]\nintensity = [1, 1, 1]\n";
    let irradiance = |screen: &str, y: f64| {
        let squares = [(-1.0, "Kd 0.5"), (1.0, screen)];
        let stage = stage(folder.path(), &squares, lamp);
        let point = SurfacePoint {
            u: DVec3::new(-1.0, y, 0.1),
            normal: DVec3::X,
            triangle: 0,
        };
        let (incident, _) = Lamps::new(&stage.world, LENGTH, 1e-6).incident_light(&[point]);
        incident.iter().map(|(_, a)| a.irradiance[0]).sum::<f64>()
    };
    let free = |y: f64| 2.5 / (6.25 + y * y + 0.01_f64).powf(1.5);
    let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-6, "{a} is not {b}");
    // The first triangle has y > z.
    close(irradiance("d 0.25", 0.3), 0.75 * free(0.3));
    close(irradiance("d 1", 0.3), 0.0);
    close(irradiance("map_Kd leaf.png", 0.8), free(0.8));
    let closed = stage(folder.path(), &[(-1.0, "Kd 0.5"), (1.0, "d 1")], lamp);
    let open = stage(folder.path(), &[(-1.0, "Kd 0.5"), (1.0, "d 0.25")], lamp);
    let kept = folder.path().join("kept.light");
    let source = |stage: &Stage| cache::light(&stage.world, LENGTH, 1e-6, Some(&kept), |_, _| {}).1;
    assert_eq!(source(&closed), cache::LightmapSource::Computed);
    assert_eq!(source(&closed), cache::LightmapSource::File);
    assert_eq!(source(&open), cache::LightmapSource::Outdated);
}
