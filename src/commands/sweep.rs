//! `geofan sweep`: accuracy against table size, for any manifolds.

use super::bake::promise;
use crate::terminal::{self, CommonArgs, Outcome, TerminalObserver, command_line, values};
use geofan_core::Result;
use geofan_study::sweep::{self, MOST_CELLS, Spacing, SweepOptions, SweepSummary, TensorOptions};
use serde_json::json;
use std::path::PathBuf;

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
    /// Seed of the fresh rays on which tables are measured
    #[arg(long, value_name = "K", default_value_t = 2)]
    seed: u64,
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
    let wrong = || format!("`{text}` is not three numbers of nodes: write 12,24,16");
    let numbers = text
        .split(',')
        .map(|n| n.trim().parse().map_err(|_| wrong()));
    let numbers: Vec<usize> = numbers.collect::<Result<_, String>>()?;
    match <[usize; 3]>::try_from(numbers) {
        Ok(nodes) if nodes.iter().all(|n| (1..=4096).contains(n)) => Ok(nodes),
        _ => Err(wrong()),
    }
}

impl SweepArgs {
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
            seed: self.seed,
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
pub fn run(args: &SweepArgs, common: &CommonArgs) -> Result<Outcome> {
    let observer = TerminalObserver::new(common)?;
    let SweepSummary {
        lines,
        points,
        measured,
    } = sweep::run(&args.options(), &observer)?;
    lines.iter().try_for_each(|line| terminal::print(line))?;
    let (folder, skipped) = (args.out.display(), points - measured);
    if args.npz_nodes.is_some() {
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
