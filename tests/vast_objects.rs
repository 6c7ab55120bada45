//! Objects that are far larger than their space: clipped to what light reaches, with a word, in any
//! placement and in no more triangles than anybody waits for.

use geofan_render::{ExactTracer, Seen, Stage, frame::Paths, frame::trace};
use glam::DVec2;
use std::path::Path;

/// Loads a scene with a square of side 2 across the x axis at x = −1, so many times as large.
fn stage(folder: &Path, space: &str, placement: &str, scale: f64) -> Result<Stage, String> {
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).unwrap();
    write(
        "space.toml",
        &format!("name = 'space'\ncoordinates = ['x', 'y', 'z']\n{space}"),
    );
    write(
        "square.obj",
        "v 0 -1 -1\nv 0 1 -1\nv 0 1 1\nv 0 -1 1\nf 1 2 3 4\n",
    );
    let scene = format!(
        "manifold = 'space.toml'\n\
         camera = {{ at = [1, 0, 0], look = [-1, 0, 0], up = [0, 0, 1], fov = 90 }}\n\
         [[object]]\nmesh = 'square.obj'\nat = [-1, 0.1, 0.2]\nscale = {scale}\nplacement = '{placement}'\n"
    );
    write("scene.toml", &scene);
    let loaded = Stage::load(&folder.join("scene.toml"), &[]);
    let stage = loaded.map_err(|error| error.report(false))?;
    // What takes long is to place triangles.
    let count = stage.world.faces.len();
    assert!(count < 200_000, "{space}, {placement}: {count}");
    Ok(stage)
}

/// The share of a small picture that sees the object, and its mean distance there.
fn seen(stage: &Stage) -> (f64, f64) {
    let world = &stage.world;
    let view = stage.view(&stage.scene.camera, (24, 18)).unwrap();
    let length = world.manifold.length.unwrap();
    let tracer = ExactTracer::new(&world.manifold, view.u, length, 1e-8);
    let traced = trace(world, &view, Paths::Exact(&tracer), &[DVec2::splat(0.5)]);
    let hits = traced.outcomes.iter().filter_map(|seen| match seen {
        Seen::Surface(hit) => Some(f64::from(hit.s)),
        _ => None,
    });
    let (count, sum) = hits.fold((0, 0.0), |(count, sum), s| (count + 1, sum + s));
    (
        f64::from(count) / traced.outcomes.len() as f64,
        sum / f64::from(count),
    )
}

const EXIT: &str =
    "exit = [{ name = 'sky', when = 'x^2 + y^2 + z^2 - 64' }]\n[cameras]\nlength = 18\n";

#[test]
fn a_vast_object_looks_like_one_that_just_fills_the_space() {
    let folder = tempfile::tempdir().unwrap();
    let bump = format!("embedding = ['x', 'y', 'z', 'exp(-(x^2 + y^2 + z^2)/2)']\n{EXIT}");
    let flat = format!("metric = {{ conformal = '1' }}\n{EXIT}");
    for space in [&flat, &bump] {
        for placement in ["linear", "exponential"] {
            let of = |scale: f64| stage(folder.path(), space, placement, scale).unwrap();
            let (fits, vast) = (of(12.0), of(1e5));
            let (a, b) = (seen(&fits), seen(&vast));
            assert!(a.0 > 0.5, "{a:?}");
            assert!((a.0 - b.0).abs() < 0.01, "{placement}: {a:?} {b:?}");
            assert!((a.1 / b.1 - 1.0).abs() < 2e-3, "{placement}: {a:?} {b:?}");
        }
    }
}

#[test]
fn clipping_is_told_and_what_fits_is_not_clipped() {
    let folder = tempfile::tempdir().unwrap();
    let space = format!("embedding = ['x', 'y', 'z', 'exp(-(x^2 + y^2 + z^2)/2)']\n{EXIT}");
    let told = |scale: f64| {
        let stage = stage(folder.path(), &space, "exponential", scale).unwrap();
        stage.world.warnings
    };
    assert!(told(5.0).is_empty(), "{:?}", told(5.0));
    let vast = told(1e5);
    assert!(
        vast.iter().any(|w| w.contains("far beyond the space")),
        "{vast:?}"
    );
}

#[test]
fn closed_spaces_do_not_hang_either() {
    let folder = tempfile::tempdir().unwrap();
    let sphere = "metric = { conformal = '2/(1 + x^2 + y^2 + z^2)' }\n\
                  domain = { inside = ['1e6 - x^2 - y^2 - z^2'] }\ncameras = { length = 3 }\n";
    for placement in ["linear", "exponential"] {
        let stage = stage(folder.path(), sphere, placement, 1e5).unwrap();
        assert!(!stage.world.warnings.is_empty());
    }
    let torus = "metric = { conformal = '1' }\n\
                 domain = { x = [0, 4], y = [0, 4], z = [0, 4], periodic = ['x', 'y', 'z'] }\n\
                 cameras = { length = 12 }\n";
    let refused = stage(folder.path(), torus, "linear", 1e5).err().unwrap();
    assert!(refused.contains("times around"), "{refused}");
}

#[test]
fn where_lengths_grow_exponentially_triangles_do_not() {
    let folder = tempfile::tempdir().unwrap();
    // Hyperbolic space, in the coordinates of the upper half with z shifted by 2.
    let half = "metric = { conformal = '1/(z + 2)' }\ndomain = { z = [-1.999, 1000] }\n\
                cameras = { length = 9 }\n";
    let stage = stage(folder.path(), half, "exponential", 1e5).unwrap();
    let told = &stage.world.warnings;
    assert!(told.iter().any(|w| w.contains("far beyond")), "{told:?}");
}
