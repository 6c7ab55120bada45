//! `geofan render`: one picture of a scene.
//!
//! In: a scene file, perhaps a bundle. Out: a PNG or EXR file, and a line (or JSON) with times.

use super::{
    light,
    path_traced::{self, PathArgs},
    scenery::{self, SceneArgs},
};
use clap::{Args, ValueEnum};
use geofan::{
    Error, Result,
    bundle::Bundle,
    render::{
        ExactTracer, Stage, TableTracer, View,
        frame::{Outcomes, trace_all, trace_lattice},
        local::draw,
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
    pub(super) scene: SceneArgs,
    #[command(flatten)]
    pub(super) path: PathArgs,
    /// The table to look paths up in
    #[arg(long, value_name = "FILE")]
    bundle: Option<PathBuf>,
    /// What follows the paths [default: table with --bundle, else exact]
    #[arg(long, value_enum)]
    tracer: Option<TracerKind>,
    /// How far to follow exact paths [default: the manifold's]
    #[arg(long, value_name = "L", allow_negative_numbers = true, value_parser = values::positive)]
    pub(super) length: Option<f64>,
    /// The picture: .png or .exr (with layers)
    #[arg(short, long, value_name = "FILE")]
    pub(super) output: PathBuf,
}

/// Who follows the paths.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum TracerKind {
    /// Lookup in a bundle
    Table,
    /// Integration for every sample
    Exact,
    /// Straight lines of the chart: at once, and right near the camera
    Local,
    /// Light by Monte Carlo along exact paths
    Path,
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
    let mut stage = args.scene.stage(bundle.as_ref())?;
    let view = args.scene.view(&stage)?;
    if args.tracer == Some(TracerKind::Path) {
        return path_traced::run(args, &stage, &view, common);
    }
    let table_length = bundle.as_ref().map(|b| b.table.length);
    let length = table_length.map_or_else(|| stage.world.manifold.length_or(args.length), Ok)?;
    light::bake(&mut stage, args.bundle.as_deref(), length, common)?;
    let (outcomes, mut report) = match (args.tracer, &bundle) {
        (Some(TracerKind::Table), None) => {
            let message = "`table` needs --bundle FILE; bake one with geofan-bake";
            return Err(Error::input("--tracer", message));
        }
        (None | Some(TracerKind::Table), Some(bundle)) => by_table(args, &stage, &view, bundle)?,
        (Some(TracerKind::Local), _) => locally(args, &stage, &view, length),
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
    picture::write(&args.output, &picture, &metadata(&stage, report.tracer))?;
    print(&report, common)
}

/// Notes for a picture's file.
pub(super) fn metadata(stage: &Stage, tracer: &str) -> Metadata {
    let command: Vec<String> = std::env::args().collect();
    Metadata::default()
        .with("command", command.join(" "))
        .with("manifold", &stage.world.manifold.name)
        .with("tracer", tracer)
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
    let began = Instant::now();
    let fan = bundle.table.fan(view.u)?;
    let contract = began.elapsed().as_secs_f64();
    let manifold = &stage.world.manifold;
    let tracer = TableTracer::new(
        &fan,
        manifold,
        bundle.table.length,
        1e-3 * bundle.header.plan.max_error,
        args.scene.tolerance,
    );
    let (samples, budget) = (usize::from(args.scene.spp), 1e-3 * args.scene.error);
    let (outcomes, _) = trace_lattice(&stage.world, view, &tracer, samples, budget);
    let mut report = report(args, "table", &outcomes);
    (report.contract, report.paths) = (contract, began.elapsed().as_secs_f64() - contract);
    Ok((outcomes, report))
}

fn exactly(args: &RenderArgs, stage: &Stage, view: &View) -> Result<(Outcomes, Report)> {
    let manifold = &stage.world.manifold;
    let length = manifold.length_or(args.length)?;
    let began = Instant::now();
    let tracer = ExactTracer::new(manifold, view.u, length, args.scene.tolerance);
    let outcomes = trace_all(&stage.world, view, &tracer, usize::from(args.scene.spp));
    let mut report = report(args, "exact", &outcomes);
    report.paths = began.elapsed().as_secs_f64();
    Ok((outcomes, report))
}

fn locally(args: &RenderArgs, stage: &Stage, view: &View, length: f64) -> (Outcomes, Report) {
    let began = Instant::now();
    let outcomes = draw(&stage.world, view, usize::from(args.scene.spp), length);
    let mut report = report(args, "local", &outcomes);
    report.paths = began.elapsed().as_secs_f64();
    (outcomes, report)
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
