//! `geofan render --tracer path`: a picture by path tracing, pass after pass.
//!
//! In: a scene, and how long or how many samples. Out: a PNG, or an EXR with variance; a file
//! `PICTURE.passes` while the picture is not complete, from which `--resume` goes on.

use super::{
    render::{RenderArgs, metadata},
    scenery,
};
use crate::terminal::{self, CommonArgs, Outcome, ProgressDisplay, TerminalObserver, values};
use clap::Args;
use geofan_core::{Error, Observer, Result, geodesic::UnfinishedPaths};
use geofan_light::path_tracer::{Estimator, PanelTracers, PassAccumulator, PathTracerSettings};
use geofan_render::{
    ExactTracer, PicturePanels, Stage, View,
    frame::{Paths, offsets, trace},
    picture::{self, Metadata, PictureFormat, Precision, write_exr},
    unfinished,
};
use serde_json::json;
use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

/// Options of the path tracer.
#[derive(Debug, Args)]
pub struct PathArgs {
    /// Path tracer: another seed gives other noise [default: 0]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Path tracer: stop after this time although fewer than --spp samples are done
    #[arg(long, value_name = "SECONDS", value_parser = values::positive)]
    time: Option<f64>,
    /// Path tracer: go on with an interrupted picture, or add samples to one that --time ended; one that is
    /// finished is left alone
    #[arg(long)]
    resume: bool,
    /// Path tracer: leave out light that was reflected more often (1: direct light only)
    #[arg(long, value_name = "N")]
    bounces: Option<u32>,
}

impl PathArgs {
    /// Lists the options by name; true for those that are given.
    pub fn given(&self) -> [(&'static str, bool); 4] {
        [
            ("--seed", self.seed.is_some()),
            ("--time", self.time.is_some()),
            ("--resume", self.resume),
            ("--bounces", self.bounces.is_some()),
        ]
    }
}

/// Least and largest time between two checkpoints, which grows with the time that has passed: an interruption that comes
/// without a signal costs no more.
const BETWEEN_CHECKPOINTS: [Duration; 2] = [Duration::from_secs(5), Duration::from_secs(60)];

/// Longer side of the picture by which the exact tracer's speed is measured.
const MEASURED_SIDE: usize = 160;

/// Renders a picture by path tracing.
pub fn run(
    args: &RenderArgs,
    stage: &Stage,
    panels: &PicturePanels,
    common: &CommonArgs,
) -> Result<Outcome> {
    let length = stage.world.manifold.length_or(args.length)?;
    let settings = PathTracerSettings {
        seed: args.path.seed.unwrap_or(0),
        length,
        tolerance: args.scene.tolerance(),
        bounces: args.path.bounces.unwrap_or(u32::MAX),
        estimator: Estimator::Connected,
    };
    // The file of passes, and the key of the picture that it must belong to.
    let file = passes_file(&args.output);
    let key = key(args, stage, panels, settings);
    let begun = file.exists();
    if args.path.resume && !begun && args.output.exists() {
        return already_finished(args, panels, common);
    }
    if begun && !args.path.resume {
        tracing::warn!(
            "the samples in {} are discarded; --resume would go on from them",
            file.display()
        );
    }
    let mut film = match args.path.resume && begun {
        true => PassAccumulator::load(&file, &key, panels.size)?,
        false => PassAccumulator::new(panels.size),
    };
    if film.passes() > u64::from(args.scene.spp) {
        let (there, asked) = (film.passes(), args.scene.spp);
        tracing::warn!(
            "{there} samples are there already, more than --spp {asked}; the picture has them all"
        );
    }
    let tracers = PanelTracers::new(&stage.world, panels, settings);
    let view = &panels.parts[0].view;
    // Before and after, so that both rates are of the same machine under the same load.
    let (exact_before, ends) = exact_speed(args, stage, view, length);
    scenery::warn_unfinished(&stage.world, &ends, scenery::LONGER_PATHS);
    let began = Instant::now();
    let passes = u64::from(args.scene.spp);
    let complete = accumulate(args, &tracers, &mut film, passes, (&file, &key), common)?;
    let seconds = began.elapsed().as_secs_f64();
    warn_cut_short(stage, &tracers);
    // First, so that a picture that cannot be written loses no samples.
    film.save(&file, &key)?;
    write(args, stage, panels, (&tracers, &film))?;
    if complete {
        std::fs::remove_file(&file).map_err(|e| Error::io(&file, e))?;
    }
    let exact_speed = 0.5 * (exact_before + exact_speed(args, stage, view, length).0);
    let speeds = [tracers.rays() as f64 / seconds, exact_speed];
    print(
        args,
        (panels, &tracers, &film),
        (seconds, speeds, ends),
        common,
    )
}

/// Share of the rays from surfaces that may end by their length before it is told.
const CUT_SHORT: f64 = 1e-3;

/// Warns where rays between surfaces end by their length.
fn warn_cut_short(stage: &Stage, tracers: &PanelTracers<'_>) {
    let share = tracers.cut_short();
    if share > CUT_SHORT && !stage.world.has_length_sky() {
        tracing::warn!(
            "{:.1} % of the rays from surfaces end by their length, and light from farther away is left out ({}; or give the scene a `length` sky)",
            100.0 * share,
            scenery::LONGER_PATHS
        );
    }
}

/// Prints what came of a picture: the time, rays a second of this tracer and of the exact one, and how paths end.
fn print(
    args: &RenderArgs,
    (panels, tracers, film): (&PicturePanels, &PanelTracers<'_>, &PassAccumulator),
    (seconds, [speed, exact_speed], ends): (f64, [f64; 2], UnfinishedPaths),
    common: &CommonArgs,
) -> Result<Outcome> {
    let output = args.output.display().to_string();
    let (spp, rays, (width, height)) = (film.passes(), tracers.rays(), panels.size);
    if common.json {
        // Rays: geodesics from the camera, from surfaces, and all that were tried to find those that connect
        // to lights; for most connections two, the first without deviation.
        terminal::print_json(&json!({
            "output": output, "tracer": "path", "width": width, "height": height, "spp": spp,
            "seconds": seconds, "rays": rays, "rays_per_second": speed,
            "exact_rays_per_second": exact_speed, "unfinished": ends,
            "cut_short": tracers.cut_short(),
        }))?;
    } else if !common.quiet {
        let [speed, exact_speed] = [speed, exact_speed].map(|rate| 1e-3 * rate);
        terminal::print(&format!(
            "{output}: {width}x{height}, {spp} spp, path tracer; {seconds:.1} s, {speed:.0} thousand rays a second (exact tracer: {exact_speed:.0}); {ends}\n"
        ))?;
    }
    Ok(Outcome::Done)
}

/// Tells that there is nothing to go on with.
fn already_finished(
    args: &RenderArgs,
    panels: &PicturePanels,
    common: &CommonArgs,
) -> Result<Outcome> {
    let output = args.output.display().to_string();
    let (found, notes) = match PictureFormat::of(&args.output) {
        Some(PictureFormat::Exr) => picture::read_exr(&args.output)?,
        _ => (picture::read(&args.output)?, Metadata::default()),
    };
    let (height, width, _) = found.rgb.dim();
    if (width, height) != panels.size {
        let (wanted_width, wanted_height) = panels.size;
        let message = format!(
            "is another picture: it has {width}x{height} pixels, this one {wanted_width}x{wanted_height}; remove it, or name another output"
        );
        return Err(Error::input(output, message));
    }
    if let Some(tracer) = notes.note("tracer").filter(|tracer| *tracer != "path") {
        let message =
            format!("is a picture of the {tracer} tracer; remove it, or name another output");
        return Err(Error::input(output, message));
    }
    if common.json {
        let answer = json!({ "output": output, "tracer": "path", "finished": true });
        terminal::print_json(&answer)?;
    } else if !common.quiet {
        let unsure = match notes.note("tracer") {
            Some(_) => "",
            None => " (it does not say by which tracer)",
        };
        terminal::print(&format!(
            "{output} is there, with no samples to go on from: it is taken to be finished{unsure}, and left alone; remove it to draw it again, with more samples if wanted\n"
        ))?;
    }
    Ok(Outcome::Done)
}

/// Adds passes until there are enough (then true) or the time is up.
fn accumulate(
    args: &RenderArgs,
    tracers: &PanelTracers<'_>,
    film: &mut PassAccumulator,
    passes: u64,
    (file, key): (&Path, &[u8; 32]),
    common: &CommonArgs,
) -> Result<bool> {
    let observer = TerminalObserver::new(common)?;
    let progress = ProgressDisplay::new(common, "samples", passes.max(film.passes()));
    progress.inc(film.passes());
    let began = Instant::now();
    let mut saved = Instant::now();
    while film.passes() < passes {
        let pass = tracers.pass(film.passes(), || observer.cancelled());
        let Some(pass) = pass else {
            film.save(file, key)?;
            return Err(Error::Interrupted {
                resume: format!(
                    "{} of {passes} samples are kept; give the same command with --resume",
                    film.passes()
                ),
            });
        };
        film.add(&pass);
        progress.inc(1);
        let up = |seconds: f64| began.elapsed().as_secs_f64() >= seconds;
        if args.path.time.is_some_and(up) {
            break;
        }
        let [first, usual] = BETWEEN_CHECKPOINTS;
        if saved.elapsed() > (saved - began).clamp(first, usual) {
            film.save(file, key)?;
            saved = Instant::now();
        }
    }
    progress.finish();
    Ok(film.passes() >= passes)
}

/// Returns the name of the file of passes beside a picture.
fn passes_file(output: &Path) -> PathBuf {
    let mut name = output.as_os_str().to_owned();
    name.push(".passes");
    name.into()
}

/// Hashes everything that decides the passes.
fn key(
    args: &RenderArgs,
    stage: &Stage,
    panels: &PicturePanels,
    settings: PathTracerSettings,
) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    // Samples of two versions may be of different paths.
    hasher.update(env!("CARGO_PKG_VERSION").as_bytes());
    hasher.update(&stage.world.manifold.fingerprint());
    hasher.update(&stage.world.fingerprint());
    hasher.update(format!("{settings:?} {panels:?} {:?}", args.scene.view).as_bytes());
    *hasher.finalize().as_bytes()
}

/// Writes the picture.
fn write(
    args: &RenderArgs,
    stage: &Stage,
    panels: &PicturePanels,
    (tracers, film): (&PanelTracers<'_>, &PassAccumulator),
) -> Result<()> {
    let picture = film.picture();
    if picture.rgb.iter().all(|light| *light == 0.0) {
        tracing::warn!("{}", scenery::BLACK);
    }
    let notes = metadata(stage, panels, "path").with("samples", film.passes().to_string());
    if PictureFormat::of(&args.output) != Some(PictureFormat::Exr) {
        return picture::write(&args.output, &picture, &notes);
    }
    let layers = tracers.layered(picture);
    write_exr(&args.output, &layers, &notes, Precision::Float)
}

/// Measures the camera rays of the exact tracer for each second: of the same view and length, at the same
/// tolerance, intersected with the same scene, and as many in a batch as a whole picture has. Tells besides which
/// of them end by their length.
fn exact_speed(
    args: &RenderArgs,
    stage: &Stage,
    view: &View,
    length: f64,
) -> (f64, UnfinishedPaths) {
    let longer = view.size.0.max(view.size.1);
    let scaled = |n: usize| (n * MEASURED_SIDE / longer).clamp(1, n);
    let size = (scaled(view.size.0), scaled(view.size.1));
    let small = view.resized(size);
    let tracer = ExactTracer::new(
        &stage.world.manifold,
        view.u,
        length,
        args.scene.tolerance(),
    );
    let samples = offsets(view.size.0.div_ceil(size.0));
    let began = Instant::now();
    let traced = trace(&stage.world, &small, Paths::Exact(&tracer), &samples);
    let speed = traced.outcomes.len() as f64 / began.elapsed().as_secs_f64();
    let limits = (length, args.scene.tolerance());
    let parts = [(small, traced.outcomes)];
    (speed, unfinished(&stage.world, &parts, limits))
}
