//! The table's preview of a lit scene beside the path tracer.

use assert_cmd::cargo::cargo_bin_cmd;
use geofan_bundle::Bundle;
use geofan_light::{
    cache::{self, LightmapSource},
    path_tracer::{Estimator, PassAccumulator, PathTracer, PathTracerSettings},
};
use geofan_render::{
    ExactTracer, Lookup, Stage, View,
    frame::{Paths, offsets, trace},
    picture::Picture,
    shade::{Footprints, shade},
};
use geofan_study::picture::psnr;
use std::{fs, path::Path};

/// A lens seen from one point: light bends towards its middle.
const LENS: &str = r#"
name = "lens"
coordinates = ["x", "y", "z"]
metric = { conformal = "exp(0.5*exp(-(x^2 + y^2 + z^2)/2))" }
[symmetry]
rotation = "origin"
[cameras]
at = ["1.5", "0", "0"]
length = 6.0
"#;

/// The three-sphere from one point, as far as its antipode.
const SPHERE: &str = r#"
name = "sphere"
coordinates = ["x", "y", "z"]
metric = { conformal = "2/(1 + x^2 + y^2 + z^2)" }
[symmetry]
rotation = "origin"
[cameras]
at = ["0.6", "0", "0"]
length = 3.0
"#;

const MATT: &str = "Kd 0.6 0.5 0.4\nillum 1\n";
const GLOSSY: &str = "Kd 0.3 0.2 0.1\nKs 0.8 0.5 0.4\nNs 20\n";

/// A floor with a square above it that casts a shadow, of this material, under a black sky: light of the sky
/// would be direct light, too, and is not baked.
fn scene(folder: &Path, camera: f64, material: &str) -> Stage {
    let square = "mtllib s.mtl\nusemtl m\nv -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3 4\n";
    fs::write(folder.join("square.obj"), square).unwrap();
    fs::write(folder.join("s.mtl"), format!("newmtl m\n{material}")).unwrap();
    let text = format!(
        "manifold = 'space.toml'\n\
         [camera]\nat = [{camera}, 0, 0]\nlook = [-1, 0.1, -0.35]\nup = [0, 0, 1]\nfov = 60\n\
         [[object]]\nmesh = 'square.obj'\nat = [0, 0, -0.4]\nscale = 0.9\nplacement = 'exponential'\n\
         [[object]]\nmesh = 'square.obj'\nat = [0.1, 0.1, 0.0]\nscale = 0.12\n\
         [[light]]\nkind = 'point'\nat = [0.2, -0.1, 0.5]\nintensity = [1, 1, 0.9]\n"
    );
    fs::write(folder.join("scene.toml"), text).unwrap();
    Stage::load(&folder.join("scene.toml"), &[]).unwrap()
}

/// Samples of a pixel: edges must be as smooth in both pictures.
const SAMPLES: usize = 32;

fn path_traced(stage: &Stage, view: &View, length: f64) -> Picture {
    let settings = PathTracerSettings {
        seed: 1,
        length,
        tolerance: 1e-6,
        bounces: 1,
        estimator: Estimator::Connected,
    };
    let tracer = PathTracer::new(&stage.world, view, settings);
    let mut film = PassAccumulator::new(view.size);
    for pass in 0..SAMPLES as u64 {
        film.add(&tracer.pass(pass, || false).unwrap());
    }
    film.picture()
}

fn by_table(stage: &Stage, view: &View, bundle: &Bundle) -> Picture {
    let lookup = Lookup::new(&bundle.table, bundle.promise(), 1e-6);
    let fan = bundle.table.fan(view.u).unwrap();
    let tracer = lookup.tracer(&fan);
    drawn(stage, view, Paths::Lattice(&tracer, 0.5e-3))
}

fn drawn(stage: &Stage, view: &View, paths: Paths<'_>) -> Picture {
    let outcomes = trace(&stage.world, view, paths, &offsets(SAMPLES)).outcomes;
    let outcomes = outcomes.view();
    let colours = shade(&stage.world, view, outcomes, SAMPLES, Footprints::Filtered);
    // The mean of a pixel's own samples, as the path tracer takes it.
    Picture::new(colours.mean_axis(ndarray::Axis(2)).unwrap())
}

#[test]
fn a_table_with_baked_light_shows_what_the_path_tracer_does() {
    for (manifold, camera) in [(LENS, 1.5), (SPHERE, 0.6)] {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("space.toml"), manifold).unwrap();
        let mut command = cargo_bin_cmd!("geofan-bake");
        let words = [
            "space.toml",
            "-o",
            "b.fan",
            "--certify-rays",
            "400",
            "--quiet",
        ];
        command
            .current_dir(folder.path())
            .args(words)
            .assert()
            .success();
        let bundle = Bundle::read(&folder.path().join("b.fan")).unwrap();
        let mut stage = scene(folder.path(), camera, MATT);
        let view = stage.view(&stage.scene.camera, (48, 32)).unwrap();
        let length = bundle.table.length;
        let reference = path_traced(&stage, &view, length);
        let (light, _) = cache::light(&stage.world, length, 1e-6, None, |_, _| {});
        stage.world.light = Some(light);
        let found = psnr(&reference, &by_table(&stage, &view, &bundle)).unwrap();
        let pixels = (0..32).flat_map(|y| (0..48).map(move |x| (x, y)));
        let lit = pixels.filter(|(x, y)| reference.pixel(*x, *y).iter().sum::<f32>() > 0.05);
        let lit = lit.count();
        assert!(lit > 150, "{manifold}: only {lit} pixels are lit");
        assert!(found >= 38.0, "{manifold}: {found} dB");
    }
}

#[test]
fn gloss_shows_lamps_as_the_path_tracer_does() {
    for (manifold, camera, length) in [(LENS, 1.5, 6.0), (SPHERE, 0.6, 3.0)] {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("space.toml"), manifold).unwrap();
        let mut stage = scene(folder.path(), camera, GLOSSY);
        let view = stage.view(&stage.scene.camera, (48, 32)).unwrap();
        let reference = path_traced(&stage, &view, length);
        let file = folder.path().join("s.light");
        let bake = || cache::light(&stage.world, length, 1e-6, Some(&file), |_, _| {});
        let (light, _) = bake();
        assert_eq!(bake(), (light.clone(), LightmapSource::File));
        stage.world.light = Some(light);
        let tracer = ExactTracer::new(&stage.world.manifold, view.u, length, 1e-6);
        let picture = drawn(&stage, &view, Paths::Exact(&tracer));
        let found = psnr(&reference, &picture).unwrap();
        let brightest = reference.rgb.iter().fold(0.0_f32, |most, x| most.max(*x));
        println!("{found:.1} dB, up to {brightest}");
        assert!(found >= 38.0, "{manifold}: {found} dB");
    }
}
