//! Fixed pieces of work on one thread, whose instructions `docs/counts.sh` counts.
//!
//! In: the name of a case. Nothing is timed or printed; the work itself is in [`counted`]. Bundles are the golden
//! ones, which stay as they are, so that other bytes of new bakes do not show in frames and decoding.

use anyhow::{Context, bail};
use geofan::{
    bake::{BakeOptions, bake},
    bundle::Bundle,
    geodesic::{Ray, Settings, ends},
    manifold::Manifold,
    observer::Unobserved,
    random::Stream,
    render::{
        Lookup, Stage, drawing::draw, frame::Paths, no_clock, scene::CameraPosition,
        shade::Footprints,
    },
};
use glam::DVec3;
use std::{
    hint::black_box,
    path::{Path, PathBuf},
    sync::Arc,
};

type Result = anyhow::Result<()>;

/// The rail among three bumps: two chunks of 40 kB, of which a camera needs one.
const RAIL: &str = "tests/golden/three-bumps-rail.fan";

/// A camera of the rail, and one from which more surfaces are seen than from most.
const CAMERA: DVec3 = DVec3::new(-1.5, 0.3, 0.2);

fn main() -> Result {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    // `cargo test` and `cargo bench` name no case.
    let [case] = &arguments[..] else {
        return Ok(());
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1);
    match case.as_str() {
        // Threads of its own give it work.
        "bake" => pool.build_global()?,
        // Threads that wait for each other count differently every time.
        _ => pool.use_current_thread().build_global()?,
    }
    match case.as_str() {
        "frame" => frames(),
        "decode" => decodes(),
        "bake" => bakes(),
        "rays" => rays(),
        other => bail!("there is no case {other}"),
    }
}

/// Does the work of a case. The name of this function tells what is counted; of a bake, whose work is on other threads,
/// all is.
#[inline(never)]
fn counted(work: impl FnOnce() -> Result) -> Result {
    work()
}

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// Draws the gallery of three bumps by table, from a camera that the table has seen before.
fn frames() -> Result {
    let mut stage = Stage::load(&file("assets/scenes/three-bumps-gallery.toml"), &[])?;
    stage.scene.camera.position = CameraPosition::Chart(CAMERA);
    let view = stage.view(&stage.scene.camera, (640, 360))?;
    let bundle = Bundle::read(&file(RAIL))?;
    let lookup = Lookup::new(&bundle.table, bundle.promise(), 1e-8);
    bundle.table.fan(CAMERA)?;
    counted(|| {
        let fan = bundle.table.fan(CAMERA)?;
        let tracer = lookup.tracer(&fan);
        let paths = Paths::Lattice(&tracer, 5e-4);
        black_box(draw(
            &stage.world,
            &view,
            paths,
            1,
            Footprints::Filtered,
            &no_clock,
        ));
        Ok(())
    })
}

/// Opens a bundle and fixes its first camera.
fn decodes() -> Result {
    let bytes = std::fs::read(file(RAIL))?;
    counted(|| {
        black_box(Bundle::from_bytes(&bytes)?.table.fan(CAMERA)?);
        Ok(())
    })
}

/// Bakes the three-sphere, with its certificate.
fn bakes() -> Result {
    let manifold = Arc::new(Manifold::load(&file("assets/manifolds/s3.toml"), &[])?);
    let folder = tempfile::tempdir()?;
    let options = BakeOptions {
        max_error: Some(0.5),
        certify_rays: 2_000,
        ..BakeOptions::default()
    };
    let output = folder.path().join("s3.fan");
    black_box(bake(manifold, &output, &options, &Unobserved)?);
    Ok(())
}

/// Follows a hundred thousand random rays over the bump to their ends.
fn rays() -> Result {
    let manifold = Manifold::load(&file("assets/manifolds/gaussian-bump.toml"), &[])?;
    let length = manifold
        .length
        .context("the file tells the length of paths")?;
    let mut random = Stream::new(&[1]);
    let mut ray = |_| {
        let u = [0; 3].map(|_| random.between(-2.0, 2.0));
        Ray::new(&manifold, u.into(), random.direction(), length)
    };
    let rays: Vec<Ray> = (0..100_000).map(&mut ray).collect();
    let settings = Settings::bare(1e-6).with_events();
    counted(|| {
        black_box(ends(&manifold, settings, rays.iter().copied()));
        Ok(())
    })
}
