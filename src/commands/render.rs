//! `geofan render`: one picture of a scene, or an animation.
//!
//! In: a scene file, perhaps a bundle, perhaps key poses. Out: PNG or EXR files or a video, and a line
//! (or JSON) with times.

use super::{
    animation::{Animation, AnimationTarget, add_file},
    path_traced::{self, PathArgs},
    scenery::{self, SceneArgs},
};
use crate::terminal::{self, CommonArgs, Outcome, values};
use clap::{Args, ValueEnum};
use geofan_bundle::Bundle;
use geofan_core::{
    Error, Result,
    files::{self, check_not_read},
    geodesic::UnfinishedPaths,
    reading::noting,
};
use geofan_render::{
    DrawingOptions, DrawnPanels, Journey, PathSource, PicturePanels, Seen, Stage, View,
    count_unfinished,
    frame::Outcomes,
    picture::{self, Metadata, Picture, PictureFormat},
    scene::PoseFile,
};
use glam::{DVec3, Vec3};
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
    /// The tracer of the paths [default: table with --bundle, else exact]
    #[arg(long, value_enum)]
    tracer: Option<TracerKind>,
    /// Arc length of exact paths, and of a table's in a glued space [default: the manifold's; the table's]
    #[arg(long, value_name = "L", value_parser = values::length)]
    pub(super) length: Option<f64>,
    /// An animation: the file of its key poses (`[[pose]]` tables with `time`, `at` or `parameters`, `look`, `up`, and
    /// perhaps `fov`, `rest` or `velocity`; all else is the scene's camera's)
    #[arg(
        long,
        value_name = "P.toml",
        requires = "frames",
        conflicts_with = "at_time"
    )]
    camera_path: Option<PathBuf>,
    /// The animation's frames; those that are there already are kept if they are of this animation
    #[arg(long, value_name = "N", requires = "camera_path", value_parser = clap::value_parser!(u32).range(2..))]
    frames: Option<u32>,
    /// The picture: .png or .exr (with layers); for an animation a pattern such as frame-%04d.png,
    /// or a video (.mp4, .mkv, .webm, .mov) if ffmpeg can be run
    #[arg(short, long, value_name = "FILE")]
    pub(super) output: PathBuf,
}

/// What to do where `--length` does nothing.
const LENGTH_OF_BUNDLE: &str = "the paths of a bundle are as long as its table says, never shorter, and only in a glued space can they be longer; leave it out, or give --tracer exact";

/// Names what follows the paths.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum TracerKind {
    /// Lookup in a bundle
    Table,
    /// Integration for every sample. Like `table`, it shades by lights alone: surfaces that glow or mirror show no
    /// light on others
    Exact,
    /// Straight lines of the chart: at once, and right near the camera
    Local,
    /// Light from surface to surface, by Monte Carlo along exact paths
    Path,
}

impl RenderArgs {
    /// Returns what follows the paths.
    fn kind(&self) -> TracerKind {
        self.tracer.unwrap_or(match self.bundle {
            Some(_) => TracerKind::Table,
            None => TracerKind::Exact,
        })
    }

    /// Refuses options that would do nothing.
    fn refuse_idle(&self) -> Result<()> {
        let kind = self.kind();
        let with_table = self.bundle.is_some() && kind != TracerKind::Exact;
        let of_path = "it is the path tracer's; give --tracer path, or leave it out";
        let mut options: Vec<(&str, bool, &str)> = (self.path.given().into_iter())
            .map(|(name, given)| (name, given && kind != TracerKind::Path, of_path))
            .collect();
        options.extend([
            (
                "--bundle",
                self.bundle.is_some() && kind == TracerKind::Path,
                "the path tracer follows every path exactly; leave it out",
            ),
            (
                "--length",
                self.length.is_some() && with_table && kind != TracerKind::Table,
                LENGTH_OF_BUNDLE,
            ),
            (
                "--error",
                self.scene.error.is_some() && kind != TracerKind::Table,
                "only between paths of a table is interpolated; leave it out, or give --bundle",
            ),
            (
                "--tolerance",
                self.scene.tolerance.is_some() && kind == TracerKind::Local,
                "straight lines of the chart are not integrated; leave it out",
            ),
        ]);
        scenery::refuse_idle(&options)
    }
}

/// Renders a picture or an animation.
pub fn run(args: &RenderArgs, common: &CommonArgs) -> Result<Outcome> {
    args.refuse_idle()?;
    if let (Some(poses), Some(frames)) = (&args.camera_path, args.frames) {
        return animate(args, poses, frames as usize, common);
    }
    scenery::check_output(&args.output)?;
    let bundle = args.bundle.as_deref().map(Bundle::read).transpose()?;
    let (stage, mut read) = noting(|| args.scene.stage(bundle.as_ref(), args.length));
    let mut stage = stage?;
    read.extend(args.bundle.clone());
    check_not_read(&args.output, &read)?;
    let panels = args.scene.panels(&stage)?;
    if args.tracer == Some(TracerKind::Path) {
        return path_traced::run(args, &stage, &panels, common);
    }
    tell_mirrors(&stage);
    let paths = path_source(args, &stage, bundle.as_ref())?;
    if let PathSource::Table(lookup) = &paths {
        let camera = stage.camera(args.scene.view.as_deref())?;
        let views = panels.parts.iter().map(|part| &part.view);
        stage.check_region(lookup.table, camera, views)?;
    }
    light_up(args, &mut stage, bundle.as_ref(), common)?;
    let drawn = draw_parts(args, &stage, &paths, &panels)?;
    if drawn.flagged >= 0.5 {
        tracing::warn!(
            "the table knows less than half of this picture's paths; the others, which it gave up, which start outside its camera region, or which portals, mirrors or exits of a glued space lead on, were integrated"
        );
    }
    if !drawn.shows {
        tracing::warn!(
            "nothing can be seen in this picture: no path meets an object, and none ends in a sky that the scene gives"
        );
    }
    tell_light(&stage, &drawn);
    tell_clocks(&stage, &drawn);
    let ends = tell_ends(args, &stage, &paths, &drawn.parts);
    write(&stage, &panels, &paths, &drawn.picture, &args.output)?;
    print(args, paths.name(), (&drawn, panels.size, &ends), common)
}

/// Tells that mirrors, glass and metal of meshes do not show what is around them.
fn tell_mirrors(stage: &Stage) {
    let materials = stage.world.materials.iter();
    let names: Vec<&str> = materials
        .filter(|material| material.shows_surroundings())
        .map(|material| material.name.as_str())
        .collect();
    if !names.is_empty() {
        tracing::warn!(
            "what mirrors, glass and metal reflect and let through is drawn by --tracer path only: {}",
            names.join(", ")
        );
    }
}

/// Tells that a picture is black although something is seen, or that skies are looked up in no direction.
fn tell_light(stage: &Stage, drawn: &DrawnPanels) {
    if drawn.shows && drawn.picture.rgb.iter().all(|light| *light == 0.0) {
        tracing::warn!("{}", scenery::BLACK);
    }
    let is_lost = |seen: &&Seen| match seen {
        Seen::Sky {
            exit, direction, ..
        } => *direction == Vec3::ZERO && !stage.world.has_one_colour(*exit as usize),
        _ => false,
    };
    let all = || drawn.parts.iter().flat_map(|(_, outcomes)| outcomes);
    let lost = all().filter(is_lost).count();
    if lost > 0 {
        let percent = 100.0 * lost as f64 / all().count() as f64;
        tracing::warn!(
            "{percent:.2} % of this picture's paths leave by exits whose `direction` is zero or no number there: their sky tells nothing"
        );
    }
}

/// Most surfaces of a picture whose clocks are looked at.
const MOST_CLOCKS: usize = 4096;

/// Tells that the lapse is not positive where surfaces are seen whose colours depend on frequencies.
fn tell_clocks(stage: &Stage, drawn: &DrawnPanels) {
    let world = &stage.world;
    if !(world.is_coloured_by_frequency() && world.manifold.has_redshift()) {
        return;
    }
    let seen = drawn.parts.iter().flat_map(|(_, outcomes)| outcomes);
    let places = seen.filter_map(|seen| match seen {
        Seen::Surface(hit) => Some((world.point(hit), hit.triangle)),
        _ => None,
    });
    let places: Vec<(DVec3, u32)> = places.collect();
    let stride = places.len().div_ceil(MOST_CLOCKS).max(1);
    let places: Vec<_> = places.into_iter().step_by(stride).collect();
    let states = world.surface_states(&places).unwrap_or_default();
    let goes = |lapse: f64| lapse > 0.0 && lapse.is_finite();
    let count = states.iter().filter(|state| !goes(state.lapse())).count();
    if count > 0 {
        let percent = 100.0 * count as f64 / states.len() as f64;
        tracing::warn!(
            "the lapse is not positive at {percent:.2} % of the surfaces in this picture: their frequencies and colours mean nothing"
        );
    }
}

/// Renders an animation.
fn animate(args: &RenderArgs, poses: &Path, frames: usize, common: &CommonArgs) -> Result<Outcome> {
    if args.tracer == Some(TracerKind::Path) {
        let message = "`path` draws single pictures, not animations";
        return Err(Error::input("--tracer", message));
    }
    let target = AnimationTarget::of(&args.output)?;
    match &target {
        AnimationTarget::Frames(..) => scenery::check_output(&args.output)?,
        AnimationTarget::Video(path) => files::check_output(path)?,
    }
    let began = Instant::now();
    let bundle = args.bundle.as_deref().map(Bundle::read).transpose()?;
    let mut stage = args.scene.stage(bundle.as_ref(), args.length)?;
    let paths = path_source(args, &stage, bundle.as_ref())?;
    light_up(args, &mut stage, bundle.as_ref(), common)?;
    let camera = stage.camera(args.scene.view.as_deref())?;
    let poses = PoseFile::load(poses, camera.fov_degrees)?;
    let journey = Journey::new(&stage.world.manifold, &poses)?;
    let manifold = stage.world.manifold.clone();
    let animation = Animation {
        journey: &journey,
        frames,
        size: args.scene.picture_size(&camera.lens),
        crop: args.scene.crop.clone(),
        manifold: &manifold,
        lens: camera.lens,
        fisheye: camera.fov_degrees,
        moves: stage.scene.moves(),
        key: key(args, &stage, &paths)?,
    };
    let mut worst = Vec::new();
    let go_to = |stage: &mut Stage, time| go_to(args, stage, bundle.as_ref(), time, common);
    let drawn = match &target {
        AnimationTarget::Frames(..) => {
            animation.write_frames(&target, common, |(panels, time), path| {
                go_to(&mut stage, time)?;
                let drawn = draw_parts(args, &stage, &paths, panels)?;
                write(&stage, panels, &paths, &drawn.picture, path)?;
                keep_worse(&mut worst, drawn.parts);
                Ok(())
            })
        }
        AnimationTarget::Video(path) => animation.write_video(path, common, |(panels, time)| {
            go_to(&mut stage, time)?;
            let drawn = draw_parts(args, &stage, &paths, panels)?;
            keep_worse(&mut worst, drawn.parts);
            Ok(drawn.picture)
        }),
    }?;
    let ends = (!worst.is_empty()).then(|| tell_ends(args, &stage, &paths, &worst));
    let seconds = began.elapsed().as_secs_f64();
    print_animation(args, paths.name(), ([frames, drawn], seconds, ends), common)
}

/// Puts objects where they are at the time of a frame, and computes the light that falls on them there.
fn go_to(
    args: &RenderArgs,
    stage: &mut Stage,
    bundle: Option<&Bundle>,
    time: f64,
    common: &CommonArgs,
) -> Result<()> {
    if !stage.scene.moves() {
        return Ok(());
    }
    stage.set_time(time)?;
    light_up(args, stage, bundle, common)
}

/// Keeps the parts of the frame with the most paths that end by their length; none if no path does.
fn keep_worse(worst: &mut Vec<(View, Outcomes)>, parts: Vec<(View, Outcomes)>) {
    let share = |parts: &[(View, Outcomes)]| {
        count_unfinished(parts.iter().map(|(_, outcomes)| outcomes)).length
    };
    if share(&parts) > share(worst) {
        *worst = parts;
    }
}

/// Prints what came of an animation: its frames and those drawn now, the time, and how paths end in the worst frame.
fn print_animation(
    args: &RenderArgs,
    tracer: &str,
    ([frames, drawn], seconds, ends): ([usize; 2], f64, Option<UnfinishedPaths>),
    common: &CommonArgs,
) -> Result<Outcome> {
    let (output, kept) = (args.output.display(), frames - drawn);
    if common.json {
        terminal::print_json(&json!({
            "output": output.to_string(), "tracer": tracer, "frames": frames,
            "drawn": drawn, "kept": kept, "seconds": seconds, "unfinished": ends,
        }))?;
    } else if !common.quiet {
        terminal::print(&format!(
            "{output}: {frames} frames, {drawn} drawn, {kept} kept, {tracer} tracer; {seconds:.1} s{}\n",
            ends.map_or(String::new(), |ends| format!("; in the worst frame {ends}"))
        ))?;
    }
    Ok(Outcome::Done)
}

/// Hashes everything that decides the frames of an animation besides their cameras.
fn key(args: &RenderArgs, stage: &Stage, paths: &PathSource<'_>) -> Result<[u8; 32]> {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&stage.world.manifold.fingerprint());
    hasher.update(&stage.world.fingerprint());
    let length = stage.world.manifold.length_or(args.length).ok();
    let numbers = (args.scene.spp, args.scene.error(), args.scene.tolerance());
    let version = env!("CARGO_PKG_VERSION");
    hasher.update(format!("{version} {} {numbers:?} {length:?}", paths.name()).as_bytes());
    let light = (stage.world.light_points, stage.scene.delay.is_some());
    hasher.update(format!("{light:?}").as_bytes());
    for path in stage
        .scene
        .objects
        .iter()
        .filter_map(|object| object.path.as_ref())
    {
        hasher.update(path.told().as_bytes());
    }
    if let Some(bundle) = &args.bundle {
        add_file(&mut hasher, bundle)?;
    }
    Ok(*hasher.finalize().as_bytes())
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
    scenery::light_up(stage, args.bundle.as_deref(), length, common);
    Ok(())
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
            let message = "`table` needs --bundle FILE; bake one with `geofan bake`";
            Err(Error::input("--tracer", message))
        }
        (None | Some(TracerKind::Table), Some(bundle)) => {
            let paths = PathSource::table(bundle, args.scene.tolerance());
            let Some(length) = args.length else {
                return Ok(paths);
            };
            let known = bundle.table.length;
            if length < known || length > known && stage.world.manifold.gluing().is_none() {
                scenery::refuse_idle(&[("--length", true, LENGTH_OF_BUNDLE)])?;
            }
            Ok(paths.continued(length))
        }
        (Some(TracerKind::Local), Some(bundle)) => Ok(PathSource::Local(bundle.table.length)),
        (Some(TracerKind::Local), None) => Ok(PathSource::Local(length()?)),
        _ => Ok(PathSource::Exact(length()?)),
    }
}

/// Finds which paths of a picture end by their length, warns of it, and says what would do.
fn tell_ends(
    args: &RenderArgs,
    stage: &Stage,
    paths: &PathSource<'_>,
    parts: &[(View, Outcomes)],
) -> UnfinishedPaths {
    let longer = match paths {
        PathSource::Table(_) => scenery::LONGER_TABLE,
        PathSource::Exact(_) | PathSource::Local(_) => scenery::LONGER_PATHS,
    };
    let ends = paths.ends(&stage.world, parts, args.scene.tolerance());
    scenery::warn_unfinished(&stage.world, &ends, longer);
    ends
}

/// Draws the picture of all parts, with layers if the output is an EXR.
fn draw_parts(
    args: &RenderArgs,
    stage: &Stage,
    paths: &PathSource<'_>,
    panels: &PicturePanels,
) -> Result<DrawnPanels> {
    let options = DrawingOptions {
        layers: PictureFormat::of(&args.output) == Some(PictureFormat::Exr),
        ..args.scene.drawing()
    };
    paths.draw_panels(&stage.world, panels, options, &geofan_study::clock)
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
    (drawn, (width, height), ends): (&DrawnPanels, (usize, usize), &UnfinishedPaths),
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
            "unfinished": ends,
        }))?;
    } else if !common.quiet {
        let [contract, paths, shade] = [contract, paths, shade].map(|seconds| 1e3 * seconds);
        let flagged = 100.0 * flagged;
        terminal::print(&format!(
            "{output}: {width}x{height}, {spp} spp, {tracer} tracer; contract {contract:.1} ms, paths {paths:.1} ms, shade {shade:.1} ms; {flagged:.2} % integrated after the table gave up; {ends}\n"
        ))?;
    }
    Ok(Outcome::Done)
}
