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
use geofan_bundle::{Bundle, Fan};
use geofan_core::{Error, Result};
use geofan_render::{
    ExactTracer, Journey, Lookup, PicturePanel, PicturePanels, ShiftedTracer, Stage, View, World,
    drawing::{Drawing, draw},
    frame::{Paths, offsets},
    picture::{self, Format, Metadata, Picture},
    redshift::redshifts,
    scene::PoseFile,
    shade::{Footprints, area, with_layers},
};
use glam::DVec3;
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
    let panels = args.scene.panels(&stage)?;
    if args.tracer == Some(TracerKind::Path) {
        return path_traced::run(args, &stage, &panels, common);
    }
    let paths = PathSource::new(args, &stage, bundle.as_ref())?;
    light_up(args, &mut stage, bundle.as_ref(), common)?;
    let drawn = paths.picture(args, &stage.world, &panels)?;
    write(&stage, &panels, &paths, &drawn.picture, &args.output)?;
    print(args, paths.name(), (&drawn, panels.size), common)
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
    let paths = PathSource::new(args, &stage, bundle.as_ref())?;
    light_up(args, &mut stage, bundle.as_ref(), common)?;
    let journey = Journey::new(&stage.world.manifold, &PoseFile::load(poses)?)?;
    let camera = stage.camera(args.scene.view.as_deref())?;
    let animation = Animation {
        journey: &journey,
        frames,
        size: args.scene.picture_size(&camera.lens),
        crop: args.scene.crop.clone(),
        manifold: &stage.world.manifold,
        lens: camera.lens,
        fisheye: camera.fov_degrees,
    };
    let drawn = match &target {
        AnimationTarget::Frames(..) => animation.write_frames(&target, common, |panels, path| {
            let drawn = paths.picture(args, &stage.world, panels)?;
            write(&stage, panels, &paths, &drawn.picture, path)
        }),
        AnimationTarget::Video(path) => animation.write_video(path, common, |panels| {
            Ok(paths.picture(args, &stage.world, panels)?.picture)
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

/// Where paths come from.
enum PathSource<'b> {
    Table(Lookup<'b>),
    /// Integration over a length.
    Exact(f64),
    /// Straight lines of the chart over a length.
    Local(f64),
}

impl<'b> PathSource<'b> {
    /// Chooses it as the options say.
    fn new(args: &RenderArgs, stage: &Stage, bundle: Option<&'b Bundle>) -> Result<Self> {
        let length = || stage.world.manifold.length_or(args.length);
        match (args.tracer, bundle) {
            (Some(TracerKind::Table), None) => {
                let message = "`table` needs --bundle FILE; bake one with geofan-bake";
                Err(Error::input("--tracer", message))
            }
            (None | Some(TracerKind::Table), Some(bundle)) => {
                let promise = 1e-3 * bundle.header.plan.max_error;
                let lookup = Lookup::new(&bundle.table, promise, args.scene.tolerance);
                Ok(Self::Table(lookup))
            }
            (Some(TracerKind::Local), Some(bundle)) => Ok(Self::Local(bundle.table.length)),
            (Some(TracerKind::Local), None) => Ok(Self::Local(length()?)),
            _ => Ok(Self::Exact(length()?)),
        }
    }

    /// Names the tracer.
    fn name(&self) -> &'static str {
        match self {
            Self::Table(_) => "table",
            Self::Exact(_) => "exact",
            Self::Local(_) => "local",
        }
    }

    /// Draws the picture of all parts, with layers if the output is an EXR.
    fn picture(
        &self,
        args: &RenderArgs,
        world: &World,
        panels: &PicturePanels,
    ) -> Result<DrawnPanels> {
        let mut drawn = DrawnPanels::default();
        let (mut pictures, mut fan, mut samples) = (Vec::new(), None, 0);
        for PicturePanel { view, .. } in &panels.parts {
            let (drawing, contract) = self.draw(args, world, view, &mut fan)?;
            drawn.contract += contract;
            drawn.paths += drawing.paths.as_secs_f64();
            drawn.shade += drawing.shade.as_secs_f64();
            drawn.flagged += drawing.flagged.len() as f64;
            samples += drawing.outcomes.len();
            let mut picture = drawing.picture;
            if Format::of(&args.output) == Some(Format::Exr) {
                picture = with_layers(picture, world, drawing.outcomes.view(), &drawing.flagged);
                let area = area(world, view, drawing.outcomes.view(), args.scene.tolerance);
                picture = picture.with_float("area", area);
                if world.has_redshift(view) {
                    let offset = offsets(usize::from(args.scene.spp))[0];
                    let g = redshifts(world, view, &drawing.outcomes, offset);
                    picture = picture.with_float("g", g);
                }
            }
            pictures.push(picture);
        }
        drawn.flagged /= samples as f64;
        drawn.picture = panels.join(pictures);
        Ok(drawn)
    }

    /// Draws the picture of one part; returns it with the time that fixing the camera took. `kept` is the fan
    /// of the part before, and then of this one.
    fn draw(
        &self,
        args: &RenderArgs,
        world: &World,
        view: &View,
        kept: &mut Option<(DVec3, Fan)>,
    ) -> Result<(Drawing, f64)> {
        let samples = usize::from(args.scene.spp);
        let by = |paths: Paths<'_>| {
            draw(
                world,
                view,
                paths,
                samples,
                Footprints::Filtered,
                &geofan_study::clock,
            )
        };
        match self {
            Self::Table(lookup) if !view.is_central() => {
                // Of all places only the camera's own can be asked for; where a ray starts outside the
                // table's region it is integrated.
                lookup.table.space.place(view.u)?;
                let tracer = ShiftedTracer::new(lookup, view);
                let budget = 1e-3 * args.scene.error;
                Ok((by(Paths::Lattice(&tracer, budget)), 0.0))
            }
            Self::Table(lookup) => {
                let began = Instant::now();
                let fan = match kept.take() {
                    Some((u, fan)) if u == view.u => fan,
                    _ => lookup.table.fan(view.u)?,
                };
                let contract = began.elapsed().as_secs_f64();
                let budget = 1e-3 * args.scene.error;
                let drawing = by(Paths::Lattice(&lookup.tracer(&fan), budget));
                *kept = Some((view.u, fan));
                Ok((drawing, contract))
            }
            Self::Local(length) => Ok((by(Paths::Straight(*length)), 0.0)),
            Self::Exact(length) => {
                let tolerance = args.scene.tolerance;
                let tracer = ExactTracer::new(&world.manifold, view.u, *length, tolerance);
                Ok((by(Paths::Exact(&tracer)), 0.0))
            }
        }
    }
}

/// A picture of all parts, and what it took: the share of samples that the table gave up on, and seconds.
#[derive(Default)]
struct DrawnPanels {
    picture: Picture,
    flagged: f64,
    contract: f64,
    paths: f64,
    shade: f64,
}

/// Writes a picture into `output`.
fn write(
    stage: &Stage,
    panels: &PicturePanels,
    paths: &PathSource<'_>,
    picture: &Picture,
    output: &Path,
) -> Result<()> {
    picture::write(output, picture, &metadata(stage, panels, paths.name()))
}

/// Makes the notes for a picture's file.
pub(super) fn metadata(stage: &Stage, panels: &PicturePanels, tracer: &str) -> Metadata {
    let notes = Metadata::default()
        .with("command", terminal::command_line())
        .with("manifold", &stage.world.manifold.name)
        .with("tracer", tracer)
        .with("version", env!("CARGO_PKG_VERSION"));
    panels.described(notes)
}

/// Prints where the picture is and what it took; times are in seconds.
fn print(
    args: &RenderArgs,
    tracer: &str,
    (drawn, (width, height)): (&DrawnPanels, (usize, usize)),
    common: &CommonArgs,
) -> Result<Outcome> {
    let (output, spp) = (args.output.display(), args.scene.spp);
    let DrawnPanels {
        flagged,
        contract,
        paths,
        shade,
        ..
    } = drawn;
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
