//! `geofan demo`: bakes the wormhole, renders it by table and exactly, and compares.
//!
//! In: the wormhole's manifold and scene from `assets/`. Out, in a folder: the bundle, and for each
//! of the scene's views the table picture, the exact picture, their difference and the table's
//! error; errors and times are printed. A bundle that is already there is used again if nothing
//! that it was baked from has changed; an interrupted bake is gone on with.

use super::bake::{self, BakeArgs};
use crate::terminal::{self, CommonArgs, Outcome, ProgressDisplay, values};
use geofan_bake::plan::{plan, usual_tangents};
use geofan_bundle::{Bundle, identity, rays::RaySpace};
use geofan_core::{Result, Unobserved, files::make_output_folder, manifold::Manifold};
use geofan_render::Stage;
use geofan_study::comparison::{CompareOptions, ComparisonReport, compare, write_pictures};
use serde_json::json;
use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

/// Options of `geofan demo`.
#[derive(Debug, clap::Args)]
pub struct DemoArgs {
    /// The folder for the results; made if missing
    #[arg(long, value_name = "DIR", default_value = "demo")]
    pub out: PathBuf,
    /// Picture size
    #[arg(long, value_name = "WxH", default_value = "640x360", value_parser = values::picture_size)]
    pub size: (usize, usize),
    /// Samples for each pixel
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u16).range(1..=64))]
    pub spp: u16,
}

/// The demonstration's promise, mrad: tight enough that pictures by table and by integration agree
/// to 45 dB.
const PROMISE: f64 = 0.15;

/// Largest error of the lattice, mrad.
const LATTICE_ERROR: f64 = 0.25;

/// Local tolerance of the exact tracer, radians.
const TOLERANCE: f64 = 1e-8;

/// From how many cameras the table's frame is drawn.
const FRAMES: usize = 20;

/// Rays of the certificate.
const CERTIFY_RAYS: u64 = 20_000;

/// Runs the demonstration.
///
/// # Errors
/// The assets are not there, the folder cannot be written, or an interruption.
pub fn run(args: &DemoArgs, common: &CommonArgs) -> Result<Outcome> {
    let began = Instant::now();
    make_output_folder(&args.out)?;
    let scene = asset("scenes/wormhole-gallery.toml");
    let stage = Stage::load(&scene, &[])?;
    let bundle = bundle(&stage, &args.out, common)?;
    let names: Vec<&str> = stage
        .scene
        .views
        .iter()
        .filter_map(|v| v.name.as_deref())
        .collect();
    let progress = ProgressDisplay::new(common, "views", names.len() as u64);
    for name in names {
        let report = view(&stage, &bundle, name, args)?;
        progress.inc(1);
        print(name, &report, common)?;
    }
    progress.finish();
    if !common.json && !common.quiet {
        terminal::print(&format!(
            "pictures and bundle are in {}; {:.0} s\n",
            args.out.display(),
            began.elapsed().as_secs_f64()
        ))?;
    }
    Ok(Outcome::Done)
}

/// Returns the path of a file of the source tree's assets.
fn asset(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("assets")
        .join(name)
}

/// Returns the wormhole's bundle: the one in the folder if it is up to date, else a new one.
fn bundle(stage: &Stage, folder: &Path, common: &CommonArgs) -> Result<Bundle> {
    let output = folder.join("ellis-wormhole.fan");
    if let Some(bundle) = up_to_date(&output, &stage.world.manifold)? {
        terminal::line(&format!("{} is up to date", output.display()));
        return Ok(bundle);
    }
    let args = BakeArgs {
        manifold: stage.scene.manifold.clone(),
        output: output.clone(),
        max_error: Some(PROMISE),
        max_size: None,
        length: None,
        set: Vec::new(),
        max_sky_error: None,
        no_frames: false,
        no_mirrors: false,
        cells: None,
        shard: None,
        resume: true,
        wait: false,
        certify_rays: CERTIFY_RAYS,
    };
    bake::run(&args, common)?;
    Bundle::read(&output)
}

/// Reads the bundle at `path`, if it can be read and is the one that a bake would make now.
fn up_to_date(path: &Path, manifold: &Arc<Manifold>) -> Result<Option<Bundle>> {
    let Ok(bundle) = Bundle::read(path) else {
        return Ok(None);
    };
    let space = RaySpace::new(manifold.clone())?;
    let length = manifold.length_or(None)?;
    let tangents = usual_tangents(&space, PROMISE);
    let (_, plan) = plan(space, length, PROMISE, tangents, &Unobserved)?;
    let id = identity(manifold, &plan).map_err(|e| e.about(path))?;
    let same = bundle.id == id && bundle.header.generator == env!("CARGO_PKG_VERSION");
    Ok(same.then_some(bundle))
}

/// Compares one view and writes its pictures.
fn view(stage: &Stage, bundle: &Bundle, name: &str, args: &DemoArgs) -> Result<ComparisonReport> {
    let view = stage.view(stage.camera(Some(name))?, args.size)?;
    let options = CompareOptions {
        samples: usize::from(args.spp),
        promise: bundle.header.plan.max_error,
        error: LATTICE_ERROR,
        tolerance: TOLERANCE,
        frames: FRAMES,
    };
    let comparison = compare(&stage.world, &view, &bundle.table, options)?;
    write_pictures(&comparison, &args.out, &format!("{name}-"))?;
    Ok(comparison.report)
}

/// Prints errors and times of one view.
fn print(view: &str, report: &ComparisonReport, common: &CommonArgs) -> Result<()> {
    if common.json {
        let mut line = json!(report);
        line["view"] = json!(view);
        return terminal::print_json(&line);
    }
    terminal::print(&format!("\n{view}\n{report}"))
}
