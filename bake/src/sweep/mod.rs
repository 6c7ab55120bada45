//! `geofan-bake sweep`: accuracy against table size, for any manifolds.
//!
//! In: manifold files. Out, in a folder: `sweep.csv` (one row for each table measured), figures, and a
//! page. Tables are bundles at several promises and uniform grids of several sizes ([`grid`]); all
//! are measured on the same fresh exact rays (`truth`), beside an integrator that is as accurate
//! (`rival`). Points that were measured before are kept (`point`).

mod clock;
mod effort;
mod frames;
pub mod grid;
mod maps;
pub mod npz;
mod npz_bytes;
mod patches;
mod point;
mod report;
mod rival;
mod speed;
mod subject;
mod table;
mod truth;

use crate::run::quoted;
use geofan::{
    Error, Result,
    terminal::{self, CommonArgs, Interrupt, Outcome, Progress},
};
use point::Store;
use serde_json::json;
use std::path::PathBuf;
use subject::{Results, Shared, Subject};

/// Options of `geofan-bake sweep`.
#[derive(Debug, clap::Args)]
pub struct SweepArgs {
    /// The manifold files
    #[arg(required = true, value_name = "MANIFOLD")]
    pub manifolds: Vec<PathBuf>,
    /// The folder for the results; made if missing
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Fewer and smaller tables: minutes instead of hours
    #[arg(long)]
    pub quick: bool,
    /// Promises of bundles, mrad, instead of the usual ones; may be repeated
    #[arg(long, value_name = "MRAD", value_parser = crate::args::promise)]
    pub max_error: Vec<f64>,
    /// Mean numbers of cells of grids, instead of the usual ones; may be repeated
    #[arg(long, value_name = "N", value_parser = cells)]
    pub cells: Vec<f64>,
    /// Fresh rays on which tables are measured [default: 20000, with --quick 4000]
    #[arg(long, value_name = "RAYS", value_parser = rays)]
    pub rays: Option<usize>,
    /// Also write the fans sampled for every grid as NPZ, for numpy
    #[arg(long)]
    pub export_npz: bool,
    /// Seed of the fresh rays on which tables are measured
    #[arg(long, value_name = "K", default_value_t = 2)]
    pub seed: u64,
    /// Tensors for numpy.
    #[command(flatten)]
    pub tensor: npz::TensorArgs,
}

/// The most cells along an axis, on average.
const MOST_CELLS: f64 = 4096.0;

fn cells(text: &str) -> Result<f64, String> {
    match geofan::terminal::values::positive(text)? {
        cells if cells <= MOST_CELLS => Ok(cells),
        _ => Err(format!(
            "a grid has at most {MOST_CELLS} cells along an axis"
        )),
    }
}

fn rays(text: &str) -> Result<usize, String> {
    match text.trim().parse() {
        Ok(rays) if (100..=10_000_000).contains(&rays) => Ok(rays),
        _ => Err(format!(
            "`{text}` is not a number of rays from 100 to 10000000"
        )),
    }
}

/// Measures everything that is not yet measured, then writes the results.
///
/// # Errors
/// Bad input, an interruption, or a folder that cannot be written.
pub fn run(args: &SweepArgs, common: &CommonArgs) -> Result<Outcome> {
    let interrupt = Interrupt::install()?;
    std::fs::create_dir_all(&args.out).map_err(|e| Error::io(&args.out, e))?;
    if let Some(nodes) = args.tensor.npz_nodes {
        for manifold in &args.manifolds {
            let path = args.tensor.write(manifold, nodes, &args.out, &interrupt)?;
            terminal::print(&format!("{}\n", path.display()))?;
        }
        return Ok(Outcome::Done);
    }
    let store = Store::open(&args.out)?;
    let shared = Shared {
        store: &store,
        interrupt: &interrupt,
        args,
    };
    let subjects = args
        .manifolds
        .iter()
        .map(|path| Subject::load(path, &shared));
    let subjects: Vec<Subject> = subjects.collect::<Result<_>>()?;
    names_differ(&subjects)?;
    let all = measured(&subjects, common)?;
    let csv = args.out.join("sweep.csv");
    table::write(&csv, &all)?;
    let words: Vec<String> = std::env::args().map(|word| quoted(&word)).collect();
    report::write(&args.out, &all, &words.join(" "))?;
    say(args, &all, common)
}

/// That no two manifolds would share the names of their points and figures.
fn names_differ(subjects: &[Subject<'_>]) -> Result<()> {
    for (k, subject) in subjects.iter().enumerate() {
        let name = subject.name();
        if subjects[..k].iter().any(|other| other.name() == name) {
            let message = "two manifold files have this name: sweep them into folders of their own";
            return Err(Error::input(name, message));
        }
    }
    Ok(())
}

fn measured(subjects: &[Subject<'_>], common: &CommonArgs) -> Result<Vec<Results>> {
    let total = subjects.iter().map(Subject::work).sum();
    let progress = Progress::new(common, "measuring", total);
    let mut all = Vec::new();
    for subject in subjects {
        let name = subject.name();
        all.push(subject.measure(|what| {
            progress.set_message(format!("{name}: {what}"));
            progress.inc(1);
        })?);
    }
    progress.finish();
    Ok(all)
}

fn say(args: &SweepArgs, all: &[Results], common: &CommonArgs) -> Result<Outcome> {
    let points = all.iter().flat_map(|results| &results.points);
    let (count, measured) = points.fold((0, 0), |(all, done), point| {
        (all + 1, done + usize::from(point.measured().is_some()))
    });
    let folder = args.out.display();
    if common.json {
        let folder = folder.to_string();
        terminal::print_json(&json!({
            "out": folder, "points": count, "measured": measured, "skipped": count - measured,
        }))?;
    } else if !common.quiet {
        terminal::print(&format!(
            "{folder}: {measured} tables measured, {} skipped for their size or time\n",
            count - measured
        ))?;
    }
    Ok(Outcome::Done)
}
