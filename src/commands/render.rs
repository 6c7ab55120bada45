//! `geofan render`: one picture of a scene.

use clap::{Args, ValueEnum};
use geofan::{
    Error, Result,
    render::{
        ExactTracer, Stage,
        frame::trace_all,
        picture::{self, Metadata},
        shade::{shade, with_layers},
    },
    terminal::{CommonArgs, Outcome, line, print_json, values},
};
use std::{path::PathBuf, time::Instant};

/// Arguments of `geofan render`.
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// The scene file
    scene: PathBuf,
    /// The table to look paths up in
    #[arg(long)]
    bundle: Option<PathBuf>,
    /// What follows the paths [default: table with --bundle, else exact]
    #[arg(long, value_enum)]
    tracer: Option<TracerKind>,
    /// Picture size
    #[arg(long, default_value = "1280x720", value_parser = values::picture_size)]
    size: values::PictureSize,
    /// Samples for each pixel
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=4096))]
    spp: u16,
    /// The camera: one of the scene's views
    #[arg(long)]
    view: Option<String>,
    /// Local tolerance of the exact tracer
    #[arg(long, default_value = "1e-8", value_parser = values::tolerance)]
    tolerance: f64,
    /// How far to follow paths [default: the manifold's]
    #[arg(long, value_parser = values::positive)]
    length: Option<f64>,
    /// A manifold parameter
    #[arg(long = "set", value_name = "NAME=VALUE", value_parser = values::setting)]
    settings: Vec<(String, f64)>,
    /// The picture: .png or .exr
    #[arg(short, long)]
    output: PathBuf,
}

/// Who follows the paths.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum TracerKind {
    /// Lookup in a bundle
    Table,
    /// Integration for every pixel
    Exact,
    /// The first-order local projection
    Local,
    /// Monte Carlo path tracing
    Path,
}

/// Renders.
pub fn run(args: &RenderArgs, common: &CommonArgs) -> Result<Outcome> {
    let stage = Stage::load(&args.scene, &args.settings)?;
    let camera = stage.camera(args.view.as_deref())?;
    let size = (args.size.width, args.size.height);
    let view = stage.view(camera, size)?;
    let world = &stage.world;
    let length = world.manifold.length_or(args.length)?;
    let t = Instant::now();
    let tracer = ExactTracer::new(&world.manifold, view.u, length, args.tolerance);
    let outcomes = trace_all(world, &view, &tracer, usize::from(args.spp));
    line(&format!("paths {:?}", t.elapsed()));
    let picture = shade(world, &view, outcomes.view());
    line(&format!("shaded {:?}", t.elapsed()));
    picture::write(
        &args.output,
        &with_layers(picture, world, outcomes.view()),
        &Metadata::default(),
    )?;
    Ok(Outcome::Done)
}
