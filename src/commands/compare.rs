//! `geofan compare`: a view by table and by exact integration, with errors and times of one run.
//!
//! In: a scene and a bundle. Out: `table.png`, `exact.png`, `error.png` (FLIP) and `mrad.png`
//! (screen error of the table's paths) in a folder, and a report as text or JSON.

use super::scenery::SceneArgs;
use clap::Args;
use geofan::{
    Error, Result,
    bundle::Bundle,
    render::comparison::{Options, compare, write_pictures},
    terminal::{self, CommonArgs, Outcome},
};
use std::path::PathBuf;

/// Options of `geofan compare`.
#[derive(Debug, Args)]
pub struct CompareArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// The table
    #[arg(long, value_name = "FILE")]
    bundle: PathBuf,
    /// The folder for the pictures; made if missing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// From how many cameras, moving and turning, the table's frame is drawn; its times are medians
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u16).range(1..))]
    frames: u16,
}

/// Compares.
pub fn run(args: &CompareArgs, common: &CommonArgs) -> Result<Outcome> {
    std::fs::create_dir_all(&args.out).map_err(|e| Error::io(&args.out, e))?;
    let bundle = Bundle::read(&args.bundle)?;
    let stage = args.scene.stage(Some(&bundle))?;
    let view = args.scene.view(&stage)?;
    let options = Options {
        samples: usize::from(args.scene.spp),
        promise: bundle.header.plan.max_error,
        error: args.scene.error,
        tolerance: args.scene.tolerance,
        frames: usize::from(args.frames),
    };
    let comparison = compare(&stage.world, &view, &bundle.table, options)?;
    write_pictures(&comparison, &args.out, "")?;
    if common.json {
        terminal::print_json(&comparison.report)?;
    } else {
        terminal::print(&comparison.report.to_string())?;
    }
    Ok(Outcome::Done)
}
