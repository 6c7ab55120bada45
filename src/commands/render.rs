//! `geofan render`: one picture of a scene.
//!
//! In: a scene file, perhaps a bundle. Out: a PNG or EXR file, and a line (or JSON) with times.

use super::scenery::{self, SceneArgs};
use clap::{Args, ValueEnum};
use geofan::{
    Error, Result,
    bundle::Bundle,
    render::{
        ExactTracer, Lookup, Stage, View,
        frame::{Outcomes, Paths, offsets, trace},
        picture::{self, Metadata},
        shade::{area, shade, with_layers},
    },
    terminal::{self, CommonArgs, Outcome, values},
};
use serde::Serialize;
use std::{path::PathBuf, time::Instant};

/// Options of `geofan render`.
#[derive(Debug, Args)]
pub struct RenderArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// The table to look paths up in
    #[arg(long, value_name = "FILE")]
    bundle: Option<PathBuf>,
    /// What follows the paths [default: table with --bundle, else exact]
    #[arg(long, value_enum)]
    tracer: Option<TracerKind>,
    /// How far to follow exact paths [default: the manifold's]
    #[arg(long, value_name = "L", allow_negative_numbers = true, value_parser = values::positive)]
    length: Option<f64>,
    /// The picture: .png or .exr (with layers)
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

/// Who follows the paths.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum TracerKind {
    /// Lookup in a bundle
    Table,
    /// Integration for every sample
    Exact,
}

/// What is printed.
#[derive(Serialize)]
struct Report {
    output: String,
    tracer: &'static str,
    width: usize,
    height: usize,
    spp: usize,
    flagged: f64,
    contract: f64,
    paths: f64,
    shade: f64,
}

/// Renders.
pub fn run(args: &RenderArgs, common: &CommonArgs) -> Result<Outcome> {
    scenery::check_output(&args.output)?;
    let bundle = args.bundle.as_deref().map(Bundle::read).transpose()?;
    let stage = args.scene.stage(bundle.as_ref())?;
    let view = args.scene.view(&stage)?;
    let (outcomes, mut report) = match (args.tracer, &bundle) {
        (Some(TracerKind::Table), None) => {
            let message = "`table` needs --bundle FILE; bake one with geofan-bake";
            return Err(Error::input("--tracer", message));
        }
        (None | Some(TracerKind::Table), Some(bundle)) => by_table(args, &stage, &view, bundle)?,
        _ => exactly(args, &stage, &view)?,
    };
    let began = Instant::now();
    let mut picture = shade(&stage.world, &view, outcomes.view());
    report.shade = began.elapsed().as_secs_f64();
    if args
        .output
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("exr"))
    {
        picture = with_layers(picture, &stage.world, outcomes.view());
        let area = area(&stage.world, &view, outcomes.view(), args.scene.tolerance);
        picture = picture.with_float("area", area);
    }
    picture::write(&args.output, &picture, &metadata(&stage, &report))?;
    print(&report, common)
}

fn metadata(stage: &Stage, report: &Report) -> Metadata {
    let command: Vec<String> = std::env::args().collect();
    Metadata::default()
        .with("command", command.join(" "))
        .with("manifold", &stage.world.manifold.name)
        .with("tracer", report.tracer)
        .with("version", env!("CARGO_PKG_VERSION"))
}

fn report(args: &RenderArgs, tracer: &'static str, outcomes: &Outcomes) -> Report {
    let flagged = outcomes.iter().filter(|o| o.flagged).count() as f64;
    Report {
        output: args.output.display().to_string(),
        tracer,
        width: args.scene.size.width,
        height: args.scene.size.height,
        spp: usize::from(args.scene.spp),
        flagged: flagged / outcomes.len() as f64,
        contract: 0.0,
        paths: 0.0,
        shade: 0.0,
    }
}

fn by_table(
    args: &RenderArgs,
    stage: &Stage,
    view: &View,
    bundle: &Bundle,
) -> Result<(Outcomes, Report)> {
    let promise = 1e-3 * bundle.header.plan.max_error;
    let lookup = Lookup::new(&bundle.table, promise, args.scene.tolerance);
    let began = Instant::now();
    let fan = bundle.table.fan(view.u)?;
    let contract = began.elapsed().as_secs_f64();
    let tracer = lookup.tracer(&fan);
    let (samples, budget) = (usize::from(args.scene.spp), 1e-3 * args.scene.error);
    let paths = Paths::Lattice(&tracer, budget);
    let outcomes = trace(&stage.world, view, paths, &offsets(samples)).outcomes;
    let mut report = report(args, "table", &outcomes);
    (report.contract, report.paths) = (contract, began.elapsed().as_secs_f64() - contract);
    Ok((outcomes, report))
}

fn exactly(args: &RenderArgs, stage: &Stage, view: &View) -> Result<(Outcomes, Report)> {
    let manifold = &stage.world.manifold;
    let length = manifold.length_or(args.length)?;
    let began = Instant::now();
    let tracer = ExactTracer::new(manifold, view.u, length, args.scene.tolerance);
    let offsets = offsets(usize::from(args.scene.spp));
    let outcomes = trace(&stage.world, view, Paths::Exact(&tracer), &offsets).outcomes;
    let mut report = report(args, "exact", &outcomes);
    report.paths = began.elapsed().as_secs_f64();
    Ok((outcomes, report))
}

fn print(report: &Report, common: &CommonArgs) -> Result<Outcome> {
    if common.json {
        terminal::print_json(report)?;
    } else if !common.quiet {
        terminal::print(&format!(
            "{}: {}x{}, {} spp, {} tracer; contract {:.1} ms, paths {:.1} ms, shade {:.1} ms; {:.2} % integrated after the table gave up\n",
            report.output,
            report.width,
            report.height,
            report.spp,
            report.tracer,
            1e3 * report.contract,
            1e3 * report.paths,
            1e3 * report.shade,
            1e2 * report.flagged,
        ))?;
    }
    Ok(Outcome::Done)
}
