//! `geofan compare`: a view by table and by exact integration, with errors and times of one run.
//!
//! In: a scene and a bundle. Out: `table.png`, `exact.png`, `error.png` (FLIP), `lattice.png` and `mrad.png`
//! (screen error of the table's paths) in a folder, and a report as text or JSON. With `--tracer
//! local` the local view takes the table's place; with `--lattice` only errors between the table's paths are measured.

use super::scenery::{
    LONGER_PATHS, LONGER_TABLE, SceneArgs, light_up, refuse_idle, warn_unfinished,
};
use crate::terminal::{self, CommonArgs, Outcome, values};
use clap::Args;
use geofan_bundle::Bundle;
use geofan_core::{Result, files::make_output_folder};
use geofan_render::picture::write_png;
use geofan_study::comparison::{
    CompareOptions, compare, compare_lattice, compare_local, write_pictures,
};
use serde::Serialize;
use std::{fmt::Display, path::PathBuf};

/// Options of `geofan compare`.
#[derive(Debug, Args)]
pub struct CompareArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// The table
    #[arg(long, value_name = "FILE", required_unless_present = "tracer")]
    bundle: Option<PathBuf>,
    /// Hold the local view, not the table, against exact paths
    #[arg(long, value_parser = ["local"], conflicts_with = "bundle")]
    tracer: Option<String>,
    /// Arc length of the paths of the local view [default: the manifold's]
    #[arg(long, value_name = "L", requires = "tracer", value_parser = values::length)]
    length: Option<f64>,
    /// Measure only what interpolation between the table's paths adds to their errors
    #[arg(long, requires = "bundle", conflicts_with_all = ["frames", "spp"])]
    lattice: bool,
    /// The folder for the pictures; made if missing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// From how many cameras, moving and turning, the table's frame is drawn; its times are medians
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u16).range(1..))]
    frames: u16,
}

/// Compares the local view with the exact one.
fn run_local(args: &CompareArgs, common: &CommonArgs) -> Result<Outcome> {
    let remedy = "the local view interpolates between no paths; leave it out";
    refuse_idle(&[("--error", args.scene.error.is_some(), remedy)])?;
    let mut stage = args.scene.stage(None)?;
    let view = args.scene.view(&stage)?;
    let length = stage.world.manifold.length_or(args.length)?;
    light_up(&mut stage, None, length, common)?;
    let samples = usize::from(args.scene.spp);
    let found = compare_local(&stage.world, &view, samples, length, args.scene.tolerance())?;
    write_pictures(&found, &args.out, "")?;
    warn_unfinished(&stage.world, &found.report.unfinished, LONGER_PATHS);
    print(&found.report, common)
}

/// Prints a report.
fn print(report: &(impl Serialize + Display), common: &CommonArgs) -> Result<Outcome> {
    match common.json {
        true => terminal::print_json(report)?,
        false => terminal::print(&report.to_string())?,
    }
    Ok(Outcome::Done)
}

/// Compares a view by table with the exact one, and writes pictures of both.
pub fn run(args: &CompareArgs, common: &CommonArgs) -> Result<Outcome> {
    make_output_folder(&args.out)?;
    let Some(path) = &args.bundle else {
        return run_local(args, common);
    };
    let bundle = Bundle::read(path)?;
    let mut stage = args.scene.stage(Some(&bundle))?;
    let view = args.scene.view(&stage)?;
    let camera = stage.camera(args.scene.view.as_deref())?;
    stage.check_region(&bundle.table, camera, [&view])?;
    if !args.lattice {
        light_up(&mut stage, Some(path), bundle.table.length, common)?;
    }
    let options = CompareOptions {
        samples: usize::from(args.scene.spp),
        promise: bundle.header.plan.max_error,
        error: args.scene.error(),
        tolerance: args.scene.tolerance(),
        frames: usize::from(args.frames),
    };
    if args.lattice {
        let (errors, picture) = compare_lattice(&stage.world, &view, &bundle.table, options)?;
        write_png(&args.out.join("lattice.png"), &picture)?;
        return print(&errors, common);
    }
    let comparison = compare(&stage.world, &view, &bundle.table, options)?;
    write_pictures(&comparison, &args.out, "")?;
    warn_unfinished(&stage.world, &comparison.report.unfinished, LONGER_TABLE);
    print(&comparison.report, common)
}
