//! `geofan render`: one picture of a scene, or an animation.
//!
//! In: a scene file, perhaps a bundle, perhaps key poses. Out: PNG or EXR files or a video, and a line
//! (or JSON) with times.

use super::{
    animation::{Animation, AnimationTarget},
    path_traced::{self, PathArgs},
    scenery::{self, SceneArgs},
};
use crate::terminal::{self, CommonArgs, Outcome, values};
use clap::{Args, ValueEnum};
use geofan_bundle::Bundle;
use geofan_core::{Error, Result};
use geofan_render::{
    Journey, PathSource, Stage, View,
    drawing::Drawing,
    picture::{self, Format, Metadata},
    scene::PoseFile,
};
use serde_json::json;
use std::{
    path::{Path, PathBuf},
    time::Instant,
};

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
    /// An animation: the file of its key poses (`[[pose]]` tables with `time` and what a scene's
    /// `[camera]` has)
    #[arg(long, value_name = "P.toml", requires = "frames")]
    camera_path: Option<PathBuf>,
    /// The animation's frames; those that are there already are kept
    #[arg(long, value_name = "N", requires = "camera_path", value_parser = clap::value_parser!(u32).range(2..))]
    frames: Option<u32>,
    /// The picture: .png or .exr (with layers); for an animation a pattern such as frame-%04d.png,
    /// or a video (.mp4) if ffmpeg can be run
    #[arg(short, long, value_name = "FILE")]
    pub(super) output: PathBuf,
}

/// Names what follows the paths.
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

/// Renders a picture or an animation.
pub fn run(args: &RenderArgs, common: &CommonArgs) -> Result<Outcome> {
    if let (Some(poses), Some(frames)) = (&args.camera_path, args.frames) {
        return animate(args, poses, frames as usize, common);
    }
    scenery::check_output(&args.output)?;
    let bundle = args.bundle.as_deref().map(Bundle::read).transpose()?;
    let mut stage = args.scene.stage(bundle.as_ref())?;
    let view = args.scene.view(&stage)?;
    if args.tracer == Some(TracerKind::Path) {
        return path_traced::run(args, &stage, &view, common);
    }
    let paths = path_source(args, &stage, bundle.as_ref())?;
    light_up(args, &mut stage, bundle.as_ref(), common)?;
    let options = args.scene.drawing();
    let (drawing, contract) = paths.draw(&stage.world, &view, options, &geofan_study::clock)?;
    let times = [contract, drawing.paths, drawing.shade];
    let [contract, paths_time, shade_time] = times.map(|time| time.as_secs_f64());
    let figures = [drawing.flagged_share(), contract, paths_time, shade_time];
    write(args, &stage, &view, &paths, drawing, &args.output)?;
    print(args, paths.name(), figures, common)
}

/// Renders an animation.
fn animate(args: &RenderArgs, poses: &Path, frames: usize, common: &CommonArgs) -> Result<Outcome> {
    if args.tracer == Some(TracerKind::Path) {
        let message = "`path` draws single pictures, not animations";
        return Err(Error::input("--tracer", message));
    }
    let target = AnimationTarget::of(&args.output)?;
    if let AnimationTarget::Frames(..) = target {
        scenery::check_output(&args.output)?;
    }
    let began = Instant::now();
    let bundle = args.bundle.as_deref().map(Bundle::read).transpose()?;
    let mut stage = args.scene.stage(bundle.as_ref())?;
    let paths = path_source(args, &stage, bundle.as_ref())?;
    light_up(args, &mut stage, bundle.as_ref(), common)?;
    let journey = Journey::new(&stage.world.manifold, &PoseFile::load(poses)?)?;
    let animation = Animation {
        journey: &journey,
        frames,
        size: args.scene.size,
    };
    let drawn = match &target {
        AnimationTarget::Frames(..) => animation.write_frames(&target, common, |view, path| {
            let (drawing, _) = paths.draw(
                &stage.world,
                view,
                args.scene.drawing(),
                &geofan_study::clock,
            )?;
            write(args, &stage, view, &paths, drawing, path)
        }),
        AnimationTarget::Video(path) => animation.write_video(path, common, |view| {
            Ok(paths
                .draw(
                    &stage.world,
                    view,
                    args.scene.drawing(),
                    &geofan_study::clock,
                )?
                .0
                .picture)
        }),
    }?;
    let (output, tracer, kept) = (args.output.display(), paths.name(), frames - drawn);
    let seconds = began.elapsed().as_secs_f64();
    if common.json {
        terminal::print_json(&json!({
            "output": output.to_string(), "tracer": tracer, "frames": frames,
            "drawn": drawn, "kept": kept, "seconds": seconds,
        }))?;
    } else if !common.quiet {
        terminal::print(&format!(
            "{output}: {frames} frames, {drawn} drawn, {kept} kept, {tracer} tracer; {seconds:.1} s\n"
        ))?;
    }
    Ok(Outcome::Done)
}

/// Computes the scene's light, followed as far as paths are in `bundle`.
fn light_up(
    args: &RenderArgs,
    stage: &mut Stage,
    bundle: Option<&Bundle>,
    common: &CommonArgs,
) -> Result<()> {
    let length = match bundle {
        Some(bundle) => bundle.table.length,
        None => stage.world.manifold.length_or(args.length)?,
    };
    scenery::light_up(stage, args.bundle.as_deref(), length, common)
}

/// Chooses where paths come from as the options say.
fn path_source<'b>(
    args: &RenderArgs,
    stage: &Stage,
    bundle: Option<&'b Bundle>,
) -> Result<PathSource<'b>> {
    let length = || stage.world.manifold.length_or(args.length);
    match (args.tracer, bundle) {
        (Some(TracerKind::Table), None) => {
            let message = "`table` needs --bundle FILE; bake one with geofan-bake";
            Err(Error::input("--tracer", message))
        }
        (None | Some(TracerKind::Table), Some(bundle)) => {
            Ok(PathSource::table(bundle, args.scene.tolerance))
        }
        (Some(TracerKind::Local), Some(bundle)) => Ok(PathSource::Local(bundle.table.length)),
        (Some(TracerKind::Local), None) => Ok(PathSource::Local(length()?)),
        _ => Ok(PathSource::Exact(length()?)),
    }
}

/// Writes a picture into `output`, with layers if it is an EXR.
fn write(
    args: &RenderArgs,
    stage: &Stage,
    view: &View,
    paths: &PathSource<'_>,
    drawing: Drawing,
    output: &Path,
) -> Result<()> {
    let picture = match Format::of(output) {
        Some(Format::Exr) => drawing.layered(&stage.world, view, args.scene.tolerance),
        _ => drawing.picture,
    };
    picture::write(output, &picture, &metadata(stage, paths.name()))
}

/// Makes the notes for a picture's file.
pub(super) fn metadata(stage: &Stage, tracer: &str) -> Metadata {
    Metadata::default()
        .with("command", terminal::command_line())
        .with("manifold", &stage.world.manifold.name)
        .with("tracer", tracer)
        .with("version", env!("CARGO_PKG_VERSION"))
}

/// Prints where the picture is and what it took; times are in seconds.
fn print(
    args: &RenderArgs,
    tracer: &str,
    [flagged, contract, paths, shade]: [f64; 4],
    common: &CommonArgs,
) -> Result<Outcome> {
    let (output, spp) = (args.output.display(), args.scene.spp);
    let (width, height) = args.scene.size;
    if common.json {
        terminal::print_json(&json!({
            "output": output.to_string(), "tracer": tracer, "width": width, "height": height,
            "spp": spp, "flagged": flagged, "contract": contract, "paths": paths, "shade": shade,
        }))?;
    } else if !common.quiet {
        let [contract, paths, shade] = [contract, paths, shade].map(|seconds| 1e3 * seconds);
        let flagged = 100.0 * flagged;
        terminal::print(&format!(
            "{output}: {width}x{height}, {spp} spp, {tracer} tracer; contract {contract:.1} ms, paths {paths:.1} ms, shade {shade:.1} ms; {flagged:.2} % integrated after the table gave up\n"
        ))?;
    }
    Ok(Outcome::Done)
}
