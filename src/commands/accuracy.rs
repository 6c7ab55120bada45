//! `geofan check`, `geofan compare`, `geofan sweep` and `geofan demo`: how near tables come to exact paths.
//!
//! - `check` takes a bundle and gives quantiles of its errors on fresh random rays, and whether its promise holds on
//!   them too.
//! - `compare` takes a scene and a bundle, and gives a view by table and by exact integration, with errors and times of
//!   one run: `table.png`, `exact.png`, `error.png` (FLIP), `lattice.png` and `mrad.png` (screen error of the table's
//!   paths) in a folder, and a report as text or JSON. With `--tracer local` the local view takes the table's place; with
//!   `--lattice` only errors between the table's paths are measured.
//! - `sweep` takes manifold files and gives accuracy against table size, in a folder.
//! - `demo` takes the wormhole's manifold and scene from `assets/`, bakes it and compares each of the scene's views. A
//!   bundle that is already there is used again if nothing that it was baked from has changed; an interrupted bake is
//!   gone on with.

use super::{
    bake::{self, BakeArgs, promise},
    scenery::{self, LONGER_PATHS, LONGER_TABLE, SceneArgs, light_up, refuse_idle},
};
use crate::terminal::{
    self, CommonArgs, Outcome, ProgressDisplay, TerminalObserver, command_line, values,
};
use clap::Args;
use geofan_bake::{
    certify,
    plan::{plan, usual_tangents},
};
use geofan_bundle::{
    Bundle, Certificate, Checked, Contents, FAR, Outlier, PlanRecord, identity, rays::RaySpace,
};
use geofan_core::{
    Result, Unobserved,
    files::{check_not_read, make_output_folder},
    manifold::Manifold,
    reading::noting,
};
use geofan_render::{Stage, picture::write_png};
use geofan_study::{
    comparison::{
        self, CompareOptions, ComparisonReport, compare_lattice, compare_local, write_pictures,
    },
    sweep::{self, MOST_CELLS, Spacing, SweepOptions, SweepSummary, TensorOptions, WrittenTensor},
};
use serde::Serialize;
use serde_json::json;
use std::{
    fmt::Display,
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

/// Options of `geofan check`.
#[derive(Debug, clap::Args)]
pub struct CheckArgs {
    /// The bundle
    #[arg(value_name = "B.fan")]
    bundle: PathBuf,
    /// Number of random rays to compare
    #[arg(long, value_name = "N", default_value_t = 100_000,
          value_parser = clap::value_parser!(u64).range(1..=1_000_000_000))]
    rays: u64,
    /// Seed of the random rays; the bundle's own certificate has seed 1
    #[arg(long, value_name = "K", default_value_t = USUAL_SEED)]
    seed: u64,
}

/// Compares a bundle with exact paths and prints the errors.
pub fn check(args: &CheckArgs, common: &CommonArgs) -> Result<Outcome> {
    let (contents, bytes) = Contents::read_sized(&args.bundle)?;
    let bundle = Bundle::from_contents(contents).map_err(|e| e.about(&args.bundle))?;
    bake::warn_unused(&bundle.manifold);
    let plan = &bundle.header.plan;
    let progress = ProgressDisplay::new(common, "checking", args.rays);
    let rays = args.rays as usize;
    let found = certify(
        &bundle.table,
        rays,
        args.seed,
        plan.tolerance,
        plan.max_error,
        |count| {
            progress.inc(count);
            Ok(())
        },
    )?;
    progress.finish();
    print_errors(&found, (plan, &bundle.table.space), bytes, common)?;
    bake::warn_unfinished(&bundle.manifold, &found.unfinished);
    Ok(match plan.is_kept(&found.certificate) {
        true => Outcome::Done,
        false => Outcome::CheckFailed,
    })
}

/// Prints quantiles and the worst rays.
fn print_errors(
    checked: &Checked,
    (plan, space): (&PlanRecord, &RaySpace),
    bytes: u64,
    common: &CommonArgs,
) -> Result<()> {
    let found = &checked.certificate;
    let worst: Vec<_> = checked
        .worst
        .iter()
        .map(|o| json!({"ray": o, "why": o.why()}))
        .collect();
    if common.json {
        return terminal::print_json(&json!({
            "mrad": found.mrad,
            "screen_mrad": found.screen_mrad,
            "sky_mrad": found.sky_mrad,
            "rotation_mrad": found.rotation_mrad,
            "flagged": found.flagged,
            "bytes": bytes,
            "rays": found.rays,
            "seed": found.seed,
            "promise": plan.max_error,
            "sky_promise": plan.tangents.mrad(plan.max_error),
            "kept": plan.is_kept(found),
            "sky_kept": plan.is_sky_kept(found),
            "beyond_20_promises": checked.far,
            "unfinished": checked.unfinished,
            "worst": worst,
        }));
    }
    terminal::print(&format!(
        "{}ends       {}\n{bytes} bytes\npromise: {}: {}\n",
        found.lines(),
        checked.unfinished,
        plan.promises(space),
        verdict(plan, found)
    ))?;
    outliers(checked)
}

/// Says whether a promise is kept, and by which errors.
fn verdict(plan: &PlanRecord, found: &Certificate) -> String {
    if found.flagged >= 1.0 && found.screen_mrad.max == 0.0 {
        return "nothing to compare: all rays are left to exact paths".into();
    }
    match (plan.is_kept(found), plan.sky_excess(found)) {
        (true, None) => "kept".into(),
        (true, Some(excess)) => format!("kept by screen errors; {excess}"),
        (false, _) => "NOT KEPT".into(),
    }
}

/// Prints the worst rays, and why they are.
fn outliers(checked: &Checked) -> Result<()> {
    if checked.far == 0 {
        return Ok(());
    }
    let mut text = format!(
        "{} rays beyond {FAR} times the promise; the worst:\n",
        checked.far
    );
    for outlier in &checked.worst {
        let Outlier { at, dir, s, .. } = outlier;
        let (error, patch, why) = (outlier.screen_mrad, &outlier.patch, outlier.why());
        text += &format!(
            "{error:>10.3} mrad: at {at:.6?} dir {dir:.6?} s {s:.4}; chunk {} box {:.4?}: {why}\n",
            patch.chunk, patch.intervals
        );
    }
    terminal::print(&text)
}

/// Options of `geofan compare`.
#[derive(Debug, Args)]
pub struct CompareArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// The table
    #[arg(long, value_name = "FILE", required_unless_present = "tracer")]
    bundle: Option<PathBuf>,
    /// Compare the local view, not a table, with exact paths
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
    /// From how many cameras, moving and turning, the table's frame is drawn; its times are medians [default: 20]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    frames: Option<u16>,
}

/// From how many cameras the table's frame is drawn, unless told.
const USUAL_FRAMES: u16 = 20;

/// The pictures of a comparison with a table, and with the local view.
const PICTURES: [&str; 5] = ["table", "exact", "error", "mrad", "lattice"];
const LOCAL_PICTURES: [&str; 3] = ["local", "exact", "error"];

/// Refuses a folder in which pictures would take the places of files that are read for them.
fn check_pictures(folder: &Path, names: &[&str], read: &[PathBuf]) -> Result<()> {
    let mut pictures = names.iter().map(|name| folder.join(format!("{name}.png")));
    pictures.try_for_each(|picture| check_not_read(&picture, read))
}

/// Compares the local view with the exact one, and writes pictures of both.
fn compare_with_local(args: &CompareArgs, common: &CommonArgs) -> Result<Outcome> {
    let remedy = "the local view interpolates between no paths; leave it out";
    let once = "the local view is drawn once; leave it out";
    refuse_idle(&[
        ("--error", args.scene.error.is_some(), remedy),
        ("--frames", args.frames.is_some(), once),
        ("--lattice", args.lattice, remedy),
    ])?;
    let (stage, read) = noting(|| args.scene.stage(None, args.length));
    let mut stage = stage?;
    check_pictures(&args.out, &LOCAL_PICTURES, &read)?;
    let view = args.scene.view(&stage)?;
    let length = stage.world.manifold.length_or(args.length)?;
    light_up(&mut stage, None, length, common);
    let samples = usize::from(args.scene.spp);
    make_output_folder(&args.out)?;
    let found = compare_local(&stage.world, &view, samples, length, args.scene.tolerance())?;
    write_pictures(&found, &args.out, "")?;
    scenery::warn_unfinished(&stage.world, &found.report.unfinished, LONGER_PATHS);
    print_comparison(&found.report, common)
}

/// Prints a report.
fn print_comparison(report: &(impl Serialize + Display), common: &CommonArgs) -> Result<Outcome> {
    match common.json {
        true => terminal::print_json(report)?,
        false => terminal::print(&report.to_string())?,
    }
    Ok(Outcome::Done)
}

/// Compares a view by table with the exact one, and writes pictures of both.
pub fn compare(args: &CompareArgs, common: &CommonArgs) -> Result<Outcome> {
    let Some(path) = &args.bundle else {
        return compare_with_local(args, common);
    };
    let remedy = "a table is compared over the length of its paths; leave it out";
    refuse_idle(&[("--length", args.length.is_some(), remedy)])?;
    let bundle = Bundle::read(path)?;
    let (stage, mut read) = noting(|| args.scene.stage(Some(&bundle), None));
    let mut stage = stage?;
    read.push(path.clone());
    check_pictures(&args.out, &PICTURES, &read)?;
    let view = args.scene.view(&stage)?;
    let camera = stage.camera(args.scene.view.as_deref())?;
    stage.check_region(&bundle.table, camera, [&view])?;
    // Before the work, which is lost if there is no place for it.
    make_output_folder(&args.out)?;
    if !args.lattice {
        light_up(&mut stage, Some(path), bundle.table.length, common);
    }
    let options = CompareOptions {
        samples: usize::from(args.scene.spp),
        promise: bundle.header.plan.max_error,
        error: args.scene.error(),
        tolerance: args.scene.tolerance(),
        frames: usize::from(args.frames.unwrap_or(USUAL_FRAMES)),
    };
    if args.lattice {
        let (errors, picture) = compare_lattice(&stage.world, &view, &bundle.table, options)?;
        write_png(&args.out.join("lattice.png"), &picture)?;
        return print_comparison(&errors, common);
    }
    let comparison = comparison::compare(&stage.world, &view, &bundle.table, options)?;
    write_pictures(&comparison, &args.out, "")?;
    scenery::warn_unfinished(&stage.world, &comparison.report.unfinished, LONGER_TABLE);
    print_comparison(&comparison.report, common)
}

/// Options of `geofan sweep`.
#[derive(Debug, clap::Args)]
pub struct SweepArgs {
    /// The manifold files
    #[arg(required = true, value_name = "MANIFOLD")]
    manifolds: Vec<PathBuf>,
    /// The folder for the results; made if missing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Fewer and smaller tables: minutes instead of hours
    #[arg(long)]
    quick: bool,
    /// Promises of bundles, mrad, instead of the usual ones; may be repeated
    #[arg(long, value_name = "MRAD", value_parser = promise)]
    max_error: Vec<f64>,
    /// Mean numbers of cells of grids, instead of the usual ones; may be repeated
    #[arg(long, value_name = "N", value_parser = cells)]
    cells: Vec<f64>,
    /// Fresh rays on which tables are measured [default: 20000, with --quick 4000]
    #[arg(long, value_name = "RAYS", value_parser = rays)]
    rays: Option<usize>,
    /// Also write the fans sampled for every grid as NPZ, for numpy
    #[arg(long)]
    export_npz: bool,
    /// Seed of the fresh rays on which tables are measured [default: 2]
    #[arg(long, value_name = "K")]
    seed: Option<u64>,
    /// Measure nothing, but write the fans on so many nodes along every camera parameter, direction
    /// parameter and the arc length as NPZ
    #[arg(long, value_name = "CAMERA,DIRECTION,ARC", value_parser = nodes)]
    npz_nodes: Option<[usize; 3]>,
    /// The placement of those nodes: equally spaced, both ends included, or at the roots of a Chebyshev
    /// polynomial
    #[arg(long, value_name = "uniform|chebyshev", value_parser = spacing, default_value = "uniform", requires = "npz_nodes")]
    npz_spacing: Spacing,
    /// One face of directions only, numbered from 0
    #[arg(long, value_name = "FACE", requires = "npz_nodes")]
    npz_face: Option<usize>,
    /// Without the slopes, which tell tangents and with them the transported frames
    #[arg(long, requires = "npz_nodes")]
    npz_no_frames: bool,
    /// Say how many bytes the tensor takes as one quantised train, as in a bundle, if no number may
    /// be off by more than this; may be repeated; needs --npz-spacing chebyshev
    #[arg(long, value_name = "E", requires = "npz_nodes", value_parser = values::positive)]
    npz_train: Vec<f64>,
}

/// Reads a spacing of nodes.
fn spacing(text: &str) -> Result<Spacing, String> {
    match text {
        "uniform" => Ok(Spacing::Uniform),
        "chebyshev" => Ok(Spacing::Chebyshev),
        _ => Err("nodes are spaced `uniform` or `chebyshev`".into()),
    }
}

/// Reads a mean number of cells of a grid.
fn cells(text: &str) -> Result<f64, String> {
    match values::positive(text)? {
        cells if cells <= MOST_CELLS => Ok(cells),
        _ => Err(format!(
            "a grid has at most {MOST_CELLS} cells along an axis"
        )),
    }
}

/// Reads a number of rays.
fn rays(text: &str) -> Result<usize, String> {
    match text.trim().parse() {
        Ok(rays) if (100..=10_000_000).contains(&rays) => Ok(rays),
        _ => Err(format!(
            "`{text}` is not a number of rays from 100 to 10000000"
        )),
    }
}

/// Reads numbers of nodes, `12,24,16`.
fn nodes(text: &str) -> Result<[usize; 3], String> {
    let wrong = || format!("`{text}` is not three numbers of nodes from 1 to 4096: write 12,24,16");
    let numbers = text
        .split(',')
        .map(|n| n.trim().parse().map_err(|_| wrong()));
    let numbers: Vec<usize> = numbers.collect::<Result<_, String>>()?;
    match <[usize; 3]>::try_from(numbers) {
        Ok(nodes) if nodes.iter().all(|n| (1..=4096).contains(n)) => Ok(nodes),
        _ => Err(wrong()),
    }
}

/// Seed of fresh rays, unless told: the bundle's own certificate has seed 1.
const USUAL_SEED: u64 = 2;

impl SweepArgs {
    /// Refuses options of measurements where fans are only written.
    fn refuse_idle(&self) -> Result<()> {
        let writes = self.npz_nodes.is_some();
        let options = [
            ("--quick", self.quick),
            ("--max-error", !self.max_error.is_empty()),
            ("--cells", !self.cells.is_empty()),
            ("--rays", self.rays.is_some()),
            ("--export-npz", self.export_npz),
            ("--seed", self.seed.is_some()),
        ];
        let remedy = "with --npz-nodes nothing is measured; leave it out";
        let options = options.map(|(name, given)| (name, given && writes, remedy));
        refuse_idle(&options)
    }

    /// Returns the options of the library.
    fn options(&self) -> SweepOptions {
        SweepOptions {
            manifolds: self.manifolds.clone(),
            out: self.out.clone(),
            quick: self.quick,
            max_error: self.max_error.clone(),
            cells: self.cells.clone(),
            rays: self.rays,
            export_npz: self.export_npz,
            seed: self.seed.unwrap_or(USUAL_SEED),
            tensor: self.npz_nodes.map(|nodes| TensorOptions {
                nodes,
                spacing: self.npz_spacing,
                face: self.npz_face,
                frames: !self.npz_no_frames,
                trains: self.npz_train.clone(),
            }),
            command: command_line(),
        }
    }
}

/// Measures tables and prints what was done.
pub fn sweep(args: &SweepArgs, common: &CommonArgs) -> Result<Outcome> {
    args.refuse_idle()?;
    let observer = TerminalObserver::new(common)?;
    let SweepSummary {
        tensors,
        points,
        measured,
    } = sweep::run(&args.options(), &observer)?;
    let (folder, skipped) = (args.out.display(), points - measured);
    if args.npz_nodes.is_some() {
        print_tensors(&tensors, common)?;
        return Ok(Outcome::Done);
    }
    if common.json {
        let folder = folder.to_string();
        terminal::print_json(&json!({
            "out": folder, "points": points, "measured": measured, "skipped": skipped,
        }))?;
    } else if !common.quiet {
        terminal::print(&format!(
            "{folder}: {measured} tables measured, {skipped} skipped for their size or time\n"
        ))?;
    }
    Ok(Outcome::Done)
}

/// Prints where tensors have been written, and how many bytes they take as trains.
fn print_tensors(tensors: &[WrittenTensor], common: &CommonArgs) -> Result<()> {
    let told = |tensor: &WrittenTensor| json!({ "path": tensor.path, "trains": tensor.trains });
    if common.json {
        return terminal::print_json(&tensors.iter().map(told).collect::<Vec<_>>());
    }
    for tensor in tensors {
        let path = tensor.path.display().to_string();
        for line in tensor.trains.iter().chain([&path]) {
            terminal::print(&format!("{line}\n"))?;
        }
    }
    Ok(())
}

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
const DEMO_PROMISE: f64 = 0.15;

/// Largest error of the lattice, mrad.
const DEMO_ERROR: f64 = 0.25;

/// Local tolerance of the exact tracer, radians.
const DEMO_TOLERANCE: f64 = 1e-8;

/// From how many cameras the table's frame is drawn.
const DEMO_FRAMES: usize = 20;

/// Rays of the certificate.
const DEMO_RAYS: u64 = 20_000;

/// Runs the demonstration.
///
/// # Errors
/// The assets are not there, the folder cannot be written, or an interruption.
pub fn demo(args: &DemoArgs, common: &CommonArgs) -> Result<Outcome> {
    let began = Instant::now();
    make_output_folder(&args.out)?;
    let scene = asset("scenes/wormhole-gallery.toml");
    let stage = Stage::load(&scene, &[])?;
    let bundle = wormhole_bundle(&stage, &args.out, common)?;
    let names: Vec<&str> = stage
        .scene
        .views
        .iter()
        .filter_map(|v| v.name.as_deref())
        .collect();
    let progress = ProgressDisplay::new(common, "views", names.len() as u64);
    for name in names {
        let report = compare_view(&stage, &bundle, name, args)?;
        progress.inc(1);
        print_view(name, &report, common)?;
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
fn wormhole_bundle(stage: &Stage, folder: &Path, common: &CommonArgs) -> Result<Bundle> {
    let output = folder.join("ellis-wormhole.fan");
    if let Some(bundle) = up_to_date(&output, &stage.world.manifold)? {
        if !common.quiet {
            terminal::line(&format!("{} is up to date", output.display()));
        }
        return Ok(bundle);
    }
    let args = BakeArgs {
        manifold: stage.scene.manifold.clone(),
        output: output.clone(),
        max_error: Some(DEMO_PROMISE),
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
        flagged: None,
        certify_rays: DEMO_RAYS,
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
    let tangents = usual_tangents(&space, DEMO_PROMISE);
    let (_, plan) = plan(space, length, DEMO_PROMISE, tangents, &Unobserved)?;
    let id = identity(manifold, &plan).map_err(|e| e.about(path))?;
    let same = bundle.id == id && bundle.header.generator == env!("CARGO_PKG_VERSION");
    Ok(same.then_some(bundle))
}

/// Compares one view and writes its pictures.
fn compare_view(
    stage: &Stage,
    bundle: &Bundle,
    name: &str,
    args: &DemoArgs,
) -> Result<ComparisonReport> {
    let view = stage.view(stage.camera(Some(name))?, args.size)?;
    let options = CompareOptions {
        samples: usize::from(args.spp),
        promise: bundle.header.plan.max_error,
        error: DEMO_ERROR,
        tolerance: DEMO_TOLERANCE,
        frames: DEMO_FRAMES,
    };
    let comparison = comparison::compare(&stage.world, &view, &bundle.table, options)?;
    write_pictures(&comparison, &args.out, &format!("{name}-"))?;
    Ok(comparison.report)
}

/// Prints errors and times of one view.
fn print_view(view: &str, report: &ComparisonReport, common: &CommonArgs) -> Result<()> {
    if common.json {
        let mut line = json!(report);
        line["view"] = json!(view);
        return terminal::print_json(&line);
    }
    terminal::print(&format!("\n{view}\n{report}"))
}
