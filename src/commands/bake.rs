//! `geofan bake` and `geofan merge`: a manifold becomes a bundle, or a shard of one; shards become a bundle.
//!
//! In: a manifold file and a promise, or shards; which share of a bake this process is to make, from the text of
//! `--shard` and the variables in which engines tell a task its number. Out: the file, and its contents and errors on
//! stdout.

use super::accuracy::{DemoArgs, SweepArgs};
use crate::terminal::{
    self, CommonArgs, Outcome, TerminalObserver, command_line, has_option, values,
};
use geofan_bake::{BakeOptions, BakeResult, PROMISES, Share, bake};
use geofan_bundle::{Bundle, Certificate, Header, MOST_CERTIFY_RAYS, rays::RaySpace};
use geofan_core::{
    Error, Result, files::check_not_read, geodesic::UnfinishedPaths, manifold::Manifold,
    reading::noting,
};
use serde_json::{Value, json};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

/// Options of `geofan bake`, or one of the commands around bakes.
#[derive(Debug, clap::Args)]
#[command(subcommand_negates_reqs = true, arg_required_else_help = true)]
pub struct BakeCommand {
    #[command(subcommand)]
    command: Option<Companion>,
    #[command(flatten)]
    bake: Option<BakeArgs>,
}

/// Names the commands around bakes.
#[derive(Debug, clap::Subcommand)]
pub enum Companion {
    /// Join the shards of one bake into a bundle
    Merge(MergeArgs),
    /// Bake the wormhole, render it and compare
    Demo(DemoArgs),
    /// Measure accuracy against table size
    Sweep(SweepArgs),
}

impl BakeCommand {
    /// Runs the command.
    ///
    /// # Errors
    /// Any that the command meets.
    pub fn run(&self, common: &CommonArgs) -> Result<Outcome> {
        match (&self.command, &self.bake) {
            (Some(Companion::Merge(args)), _) => merge(args, common),
            (Some(Companion::Demo(args)), _) => super::accuracy::demo(args, common),
            (Some(Companion::Sweep(args)), _) => super::accuracy::sweep(args, common),
            (None, Some(args)) => run(args, common),
            (None, None) => Err(Error::input("MANIFOLD", "give a manifold to bake")),
        }
    }
}

/// Options of a bake.
#[derive(Debug, Clone, clap::Args)]
pub struct BakeArgs {
    /// The manifold file
    pub manifold: PathBuf,
    /// The bundle to write
    #[arg(long, short, value_name = "B.fan")]
    pub output: PathBuf,
    /// The promise: 99th percentile of the screen error, in mrad [default: 0.5]
    #[arg(long, value_name = "MRAD", value_parser = promise)]
    pub max_error: Option<f64>,
    /// Largest file, in bytes or as 512KiB, 4MB; the promise is loosened until the table fits, unless --max-error is given too
    #[arg(long, value_name = "SIZE", value_parser = values::bytes, conflicts_with = "shard")]
    pub max_size: Option<u64>,
    /// Arc length of the paths [default: the manifold file's]
    #[arg(long, value_name = "L", value_parser = values::length)]
    pub length: Option<f64>,
    /// Replace a parameter of the manifold; may be repeated
    #[arg(long, value_name = "NAME=VALUE", value_parser = values::setting)]
    pub set: Vec<(String, f64)>,
    /// The promise of directions: 99th percentile of the sky error, in mrad [default: --max-error where paths
    /// may end at an exit; four times that where they never do and directions only shade]
    #[arg(long, value_name = "MRAD", value_parser = promise, conflicts_with = "no_frames")]
    pub max_sky_error: Option<f64>,
    /// Promise points only, not tangents: smaller, but skies are less sharp and frames are not told
    #[arg(long)]
    pub no_frames: bool,
    /// Store every chunk, also those that reflections or exchanges of coordinates carry into others
    #[arg(long)]
    pub no_mirrors: bool,
    /// Cells along each camera parameter, each with chunks of its own [default: 2 or 4]: more are smaller chunks,
    /// for long bakes on many machines
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub cells: Option<u32>,
    /// Bake the share I of N only (I from 1 to N) and write it as a shard for `merge`; `auto` or `auto/N` takes
    /// the number from Slurm, GNU parallel, Kubernetes, Grid Engine, PBS or LSF
    #[arg(long, value_name = "I/N", value_parser = share)]
    pub shard: Option<Share>,
    /// Go on with what an interrupted bake left in B.fan.parts
    #[arg(long)]
    pub resume: bool,
    /// If another process bakes into the same file, wait until it has ended
    #[arg(long)]
    pub wait: bool,
    /// Stop halving boxes when those that are still open hold no more than this percentage of a chunk (of its cameras,
    /// directions and arc lengths together), and flag them: pictures follow flagged rays one by one. Less may be left,
    /// because all boxes of one size are decided together; and more rays may be flagged, because a ray is that has
    /// any part in such a box or in one that was given up before. Ends a long bake sooner, also one that goes on by
    /// --resume [default: 2 or 0.03 where edges or ends divide paths; else each box is halved until it is too small]
    #[arg(long, value_name = "PERCENT", value_parser = percent)]
    pub flagged: Option<f64>,
    /// Fresh random rays that the certificate takes
    #[arg(long, value_name = "RAYS", default_value_t = 20_000,
          value_parser = clap::value_parser!(u64).range(1..=MOST_CERTIFY_RAYS))]
    pub certify_rays: u64,
}

/// Reads a promise, mrad.
///
/// # Errors
/// A message for the user.
pub fn promise(text: &str) -> Result<f64, String> {
    let value = values::positive(text)?;
    if PROMISES.contains(&value) {
        return Ok(value);
    }
    let (start, end) = (PROMISES.start(), PROMISES.end());
    Err(format!("a promise lies between {start} and {end} mrad"))
}

/// Reads a share of rays in percent.
///
/// # Errors
/// A message for the user.
fn percent(text: &str) -> Result<f64, String> {
    let value = values::positive(text)?;
    match value < 100.0 {
        true => Ok(value),
        false => Err("less than 100 percent can be left to flags".into()),
    }
}

/// Bakes a manifold and prints what was made.
pub fn run(args: &BakeArgs, common: &CommonArgs) -> Result<Outcome> {
    let started = Instant::now();
    let observer = TerminalObserver::new(common)?;
    let (manifold, read) = noting(|| Manifold::load(&args.manifold, &args.set));
    let manifold = manifold?;
    check_not_read(&args.output, &read)?;
    warn_unused(&manifold);
    let options = BakeOptions {
        max_error: args.max_error,
        max_size: args.max_size,
        length: args.length,
        frames: !args.no_frames,
        max_sky_error: args.max_sky_error,
        mirrors: !args.no_mirrors,
        cells: args.cells,
        share: args.shard,
        resume: args.resume,
        wait: args.wait,
        flagged: args.flagged.map(|percent| 0.01 * percent),
        certify_rays: args.certify_rays,
    };
    let baked = bake(Arc::new(manifold), &args.output, &options, &observer);
    match baked.map_err(resumable)? {
        BakeResult::Bundle {
            bundle,
            bytes,
            unfinished,
        } => {
            let made = MadeBundle::of(&bundle, (bytes, &unfinished), &args.output)?;
            report(&made, &args.output, started, common)
        }
        BakeResult::Shard {
            share,
            bytes,
            chunks,
        } => report_shard(share, bytes, chunks, &args.output, common),
        BakeResult::TooLarge { reason, advice } => refuse(&format!("{reason}; {advice}"), common),
    }
}

/// Adds the command that goes on to what an interrupted bake says.
fn resumable(error: Error) -> Error {
    let Error::Interrupted { resume } = error else {
        return error;
    };
    let flag = match has_option("--resume") {
        true => "",
        false => " --resume",
    };
    Error::Interrupted {
        resume: format!("{resume}; go on with: {}{flag}", command_line()),
    }
}

/// Says that the size limit and the promise exclude each other.
fn refuse(reason: &str, common: &CommonArgs) -> Result<Outcome> {
    terminal::line(&format!("error: {reason}"));
    if common.json {
        terminal::print_json(&json!({ "error": { "message": reason } }))?;
    }
    Ok(Outcome::CheckFailed)
}

/// Options of `geofan merge`.
#[derive(Debug, clap::Args)]
pub struct MergeArgs {
    /// The shards, all of one bake, in any order
    #[arg(required = true, value_name = "SHARD")]
    shards: Vec<PathBuf>,
    /// The bundle to write
    #[arg(long, short, value_name = "B.fan")]
    output: PathBuf,
    /// End with exit code 1 if the certificate misses the promise
    #[arg(long)]
    strict: bool,
}

/// Joins shards, measures the bundle and prints what was made.
pub fn merge(args: &MergeArgs, common: &CommonArgs) -> Result<Outcome> {
    let started = Instant::now();
    let observer = TerminalObserver::new(common)?;
    let merged = geofan_bake::merge(&args.shards, &args.output, &observer)?;
    let made = MadeBundle {
        header: &merged.header,
        space: &merged.space,
        bytes: merged.bytes,
        boxes: (merged.patches, merged.flagged_boxes),
        unfinished: &merged.unfinished,
    };
    let outcome = report(&made, &args.output, started, common)?;
    // The bundle is there: an engine must not take it for a task that failed.
    match args.strict {
        true => Ok(outcome),
        false => Ok(Outcome::Done),
    }
}

/// Prints what a shard holds.
fn report_shard(
    Share { index, of }: Share,
    bytes: u64,
    chunks: usize,
    path: &Path,
    common: &CommonArgs,
) -> Result<Outcome> {
    let name = path.display().to_string();
    if common.json {
        terminal::print_json(&json!({
            "path": name, "bytes": bytes, "shard": index, "of": of, "chunks": chunks,
        }))?;
    } else if !common.quiet {
        terminal::print(&format!(
            "{name}: {bytes} bytes, shard {index} of {of} with {chunks} chunks\n"
        ))?;
    }
    Ok(Outcome::Done)
}

/// A bundle that has been written, to be reported.
struct MadeBundle<'a> {
    header: &'a Header,
    space: &'a RaySpace,
    bytes: u64,
    /// Patches and flagged boxes.
    boxes: (usize, usize),
    unfinished: &'a UnfinishedPaths,
}

impl<'a> MadeBundle<'a> {
    /// Takes one that is in memory, whose file `path` has so many bytes.
    fn of(
        bundle: &'a Bundle,
        (bytes, unfinished): (u64, &'a UnfinishedPaths),
        path: &Path,
    ) -> Result<Self> {
        let boxes = bundle.table.counts();
        Ok(Self {
            header: &bundle.header,
            space: &bundle.table.space,
            bytes,
            boxes: boxes.map_err(|e| Error::input(path.display().to_string(), e.to_string()))?,
            unfinished,
        })
    }

    fn as_json(&self, certificate: &Certificate, path: &Path, seconds: f64) -> Value {
        let plan = &self.header.plan;
        let (patches, given_up) = self.boxes;
        json!({
            "path": path.display().to_string(),
            "bytes": self.bytes,
            "promise": plan.max_error,
            "sky_promise": plan.tangents.mrad(plan.max_error),
            "kept": plan.is_kept(certificate),
            "sky_kept": plan.is_sky_kept(certificate),
            "mrad": certificate.mrad,
            "screen_mrad": certificate.screen_mrad,
            "sky_mrad": certificate.sky_mrad,
            "rotation_mrad": certificate.rotation_mrad,
            "flagged": certificate.flagged,
            "rays": certificate.rays,
            "seed": certificate.seed,
            "exact_rays": certificate.exact_rays_baked,
            "patches": patches,
            "flagged_boxes": given_up,
            "unfinished": self.unfinished,
            "seconds": seconds,
        })
    }

    fn as_text(&self, certificate: &Certificate, path: &Path, seconds: f64) -> String {
        let (path, lines) = (path.display(), certificate.lines());
        let promises = self.header.plan.promises(self.space);
        let (patches, given_up) = self.boxes;
        let (bytes, unfinished) = (self.bytes, self.unfinished);
        format!(
            "{path}: {bytes} bytes, {patches} patches, {given_up} flagged boxes\n\
             promise: {promises}\n{lines}ends       {unfinished}\n\
             {} rays integrated, {seconds:.1} s\n",
            certificate.exact_rays_baked
        )
    }
}

/// Prints what was made; the outcome says whether the promise holds.
fn report(
    made: &MadeBundle<'_>,
    path: &Path,
    started: Instant,
    common: &CommonArgs,
) -> Result<Outcome> {
    let plan = &made.header.plan;
    let missing = || Error::input(path.display().to_string(), "has no certificate");
    let certificate = made.header.certificate.as_ref().ok_or_else(missing)?;
    let seconds = started.elapsed().as_secs_f64();
    if common.json {
        terminal::print_json(&made.as_json(certificate, path, seconds))?;
    } else if !common.quiet {
        terminal::print(&made.as_text(certificate, path, seconds))?;
    }
    warn_unfinished(&made.space.manifold().glued(), made.unfinished);
    if plan.is_kept(certificate) {
        if let Some(excess) = plan.sky_excess(certificate) {
            tracing::warn!("{excess}");
        }
        return Ok(Outcome::Done);
    }
    let promises = plan.promises(made.space);
    let found = match (certificate.keeps(plan.max_error), certificate.sky_mrad) {
        (true, Some(sky)) => format!("{:.4} of directions", sky.p99),
        _ => format!("{:.4}", certificate.screen_mrad.p99),
    };
    terminal::line(&format!(
        "error: the promise is not kept ({promises}): the certificate found {found}"
    ));
    Ok(Outcome::CheckFailed)
}

/// Warns where a table is never looked up in, as in a space with mirrors or portals.
pub fn warn_unused(manifold: &Manifold) {
    if !manifold.follows_cover() {
        tracing::warn!(
            "`{}` has mirrors or portals, and tables do not know how paths go on there: all pictures of it are traced exactly, and its table, which is of the chart without them, is of no use",
            manifold.source.name
        );
    }
}

/// Warns where paths of a table of a space with exits are too short to get to them.
pub fn warn_unfinished(manifold: &Manifold, found: &UnfinishedPaths) {
    if manifold.follows_cover()
        && manifold.domain.has_exits()
        && let Some(warning) = found.warning(
            "paths end before they leave",
            "bake with --length, or change `length` under [cameras]",
        )
    {
        tracing::warn!("{warning}");
    }
}

/// The variables of an engine: the number of a task, of the first and of the last task of its array, and from one to the
/// next. Those that do not tell the last have no name for it and need `--shard auto/N`.
struct TaskVariables {
    number: &'static str,
    /// Where numbers begin, if the engine does not say.
    first: (&'static str, u32),
    last: &'static str,
    step: &'static str,
}

/// The engines that are known, the one that is most often inside another first.
const ENGINES: [TaskVariables; 6] = [
    // GNU parallel.
    TaskVariables {
        number: "PARALLEL_SEQ",
        first: ("", 1),
        last: "",
        step: "",
    },
    // Slurm: `sbatch --array`.
    TaskVariables {
        number: "SLURM_ARRAY_TASK_ID",
        first: ("SLURM_ARRAY_TASK_MIN", 1),
        last: "SLURM_ARRAY_TASK_MAX",
        step: "SLURM_ARRAY_TASK_STEP",
    },
    // Kubernetes: a job with `completionMode: Indexed`.
    TaskVariables {
        number: "JOB_COMPLETION_INDEX",
        first: ("", 0),
        last: "",
        step: "",
    },
    // Grid Engine: `qsub -t`.
    TaskVariables {
        number: "SGE_TASK_ID",
        first: ("SGE_TASK_FIRST", 1),
        last: "SGE_TASK_LAST",
        step: "SGE_TASK_STEPSIZE",
    },
    // PBS: `qsub -J`.
    TaskVariables {
        number: "PBS_ARRAY_INDEX",
        first: ("", 1),
        last: "",
        step: "",
    },
    // LSF: `bsub -J name[1-N]`.
    TaskVariables {
        number: "LSB_JOBINDEX",
        first: ("", 1),
        last: "LSB_JOBINDEX_END",
        step: "LSB_JOBINDEX_STEP",
    },
];

/// How many tasks Slurm's array has, which may be a list of numbers.
const COUNT: &str = "SLURM_ARRAY_TASK_COUNT";

/// Reads a share of the chunks: `1/4`, or `auto` and `auto/4` where an engine tells the number.
///
/// # Errors
/// A message for the user.
pub fn share(text: &str) -> Result<Share, String> {
    share_in(text, |name| std::env::var(name).ok())
}

/// Reads it where `variable` looks up the variables of the process.
fn share_in(text: &str, variable: impl Fn(&str) -> Option<String>) -> Result<Share, String> {
    let wrong = || format!("`{text}` is not a share: write 1/4 for the first of four, or auto");
    let number = |text: &str| text.trim().parse::<u32>().map_err(|_| wrong());
    let (index, of) = match text.split_once('/') {
        None if text == "auto" => task(None, variable)?,
        None => return Err(wrong()),
        Some(("auto", of)) => task(Some(number(of)?), variable)?,
        Some((index, of)) => (number(index)?, number(of)?),
    };
    match (1..=of).contains(&index) {
        true => Ok(Share { index, of }),
        false if of == 0 => Err(wrong()),
        false => Err(format!(
            "share {index} of {of}: shares are numbered from 1 to {of}"
        )),
    }
}

/// Finds the number of this task, from 1, and the number of tasks, if it is not given.
fn task(of: Option<u32>, variable: impl Fn(&str) -> Option<String>) -> Result<(u32, u32), String> {
    let number = |name: &str| variable(name).and_then(|text| text.trim().parse::<u32>().ok());
    let engine = ENGINES
        .iter()
        .find_map(|engine| Some((engine, number(engine.number)?)));
    let Some((engine, task)) = engine else {
        let names: Vec<&str> = ENGINES.iter().map(|engine| engine.number).collect();
        return Err(format!(
            "auto: none of the variables {} is set",
            names.join(", ")
        ));
    };
    let name = engine.number;
    let first = number(engine.first.0).unwrap_or(engine.first.1);
    let step = number(engine.step).unwrap_or(1).max(1);
    let above = task
        .checked_sub(first)
        .ok_or_else(|| format!("{name} is below {first}"))?;
    let last = number(engine.last);
    let known = last.and_then(|last| (last.checked_sub(first)? / step).checked_add(1));
    let of = of.or(known).ok_or_else(|| {
        format!("{name} tells the number of this task, nothing how many there are: write auto/N")
    })?;
    // A part of an array, started again, numbers its tasks as the whole did.
    let listed = name.starts_with("SLURM").then(|| number(COUNT)).flatten();
    let whole = [known, listed].into_iter().flatten().all(|n| n == of);
    if !whole || (first > 1 && last.is_some()) || !above.is_multiple_of(step) {
        return Err(format!(
            "{name} is {task}, in an array that is not all of the tasks from {} on, one after another: say which share this is, as {task}/N",
            first.min(1)
        ));
    }
    Ok((above / step + 1, of))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn promises_have_a_range() {
        assert_eq!(promise("0.5"), Ok(0.5));
        for wrong in ["0", "-1", "1e-9", "1e9", "inf", "x"] {
            assert!(promise(wrong).is_err(), "{wrong}");
        }
    }

    fn with(variables: &[(&str, &str)], text: &str) -> Result<(u32, u32), String> {
        let find = |name: &str| {
            let found = variables.iter().find(|(known, _)| *known == name);
            found.map(|(_, value)| value.to_string())
        };
        share_in(text, find).map(|share| (share.index, share.of))
    }

    #[test]
    fn shares_are_numbered_from_one() {
        assert_eq!(with(&[], "3/4"), Ok((3, 4)));
        for text in ["0/4", "5/4", "3", "x/4", "3/", "auto", "auto/0", ""] {
            assert!(with(&[], text).is_err(), "{text}");
        }
    }

    #[test]
    fn engines_tell_the_number_of_a_task() {
        let slurm = [
            ("SLURM_ARRAY_TASK_ID", "2"),
            ("SLURM_ARRAY_TASK_MIN", "0"),
            ("SLURM_ARRAY_TASK_MAX", "3"),
        ];
        assert_eq!(with(&slurm, "auto"), Ok((3, 4)));
        assert_eq!(with(&slurm, "auto/4"), Ok((3, 4)));
        let kubernetes = [("JOB_COMPLETION_INDEX", "0")];
        assert_eq!(with(&kubernetes, "auto/4"), Ok((1, 4)));
        assert!(with(&kubernetes, "auto").unwrap_err().contains("auto/N"));
        assert!(with(&kubernetes, "auto/0").is_err());
        let grid_engine = [
            ("SGE_TASK_ID", "2"),
            ("SGE_TASK_FIRST", "1"),
            ("SGE_TASK_LAST", "6"),
        ];
        assert_eq!(with(&grid_engine, "auto"), Ok((2, 6)));
        let every_second = [
            ("SGE_TASK_ID", "5"),
            ("SGE_TASK_FIRST", "1"),
            ("SGE_TASK_LAST", "8"),
            ("SGE_TASK_STEPSIZE", "2"),
        ];
        assert_eq!(with(&every_second, "auto"), Ok((3, 4)));
        assert_eq!(with(&[("PARALLEL_SEQ", "3")], "auto/3"), Ok((3, 3)));
        // Parts of an array, started again.
        let again = |id: &'static str, count: &'static str| {
            [
                ("SLURM_ARRAY_TASK_ID", id),
                ("SLURM_ARRAY_TASK_MIN", "1"),
                ("SLURM_ARRAY_TASK_MAX", "4"),
                ("SLURM_ARRAY_TASK_COUNT", count),
            ]
        };
        assert_eq!(with(&again("3", "4"), "auto"), Ok((3, 4)));
        for text in ["auto", "auto/4"] {
            assert!(with(&again("3", "2"), text).unwrap_err().contains("3/N"));
        }
        let alone = [
            ("SLURM_ARRAY_TASK_ID", "3"),
            ("SLURM_ARRAY_TASK_MIN", "3"),
            ("SLURM_ARRAY_TASK_MAX", "3"),
        ];
        assert!(with(&alone, "auto").is_err() && with(&alone, "auto/4").is_err());
        // What is no task of an array.
        assert!(with(&[("SGE_TASK_ID", "undefined")], "auto/3").is_err());
    }
}
