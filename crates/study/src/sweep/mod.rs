//! Accuracy against table size, for any manifolds.
//!
//! In: manifold files, and what is asked for ([`SweepOptions`]). Out, in a folder: `sweep.csv` (one row for each table
//! measured), figures, and a page. Tables are bundles at several promises and uniform grids of several sizes (`grid`);
//! all are measured on one set of fresh exact rays (`exact_rays`), beside an integrator that is as accurate
//! (`crate::comparison`). Points that were measured before are kept (`measurement`). Instead, the sampled fans can be written as
//! tensors for numpy (`npz`).
//!
//! Without the feature `sweep` there are the options alone, and [`run`] says that it is missing.

#[cfg(feature = "sweep")]
mod exact_rays;
#[cfg(feature = "sweep")]
pub mod grid;
#[cfg(feature = "sweep")]
mod manifold_sweep;
#[cfg(feature = "sweep")]
mod measurement;
#[cfg(feature = "sweep")]
pub mod npz;
#[cfg(feature = "sweep")]
mod report;
#[cfg(feature = "sweep")]
mod tables;

use geofan_core::{Error, Observer, Result};
use std::path::PathBuf;
#[cfg(feature = "sweep")]
use {
    geofan_core::{Progress, files::make_output_folder},
    manifold_sweep::{ManifoldResults, ManifoldSweep},
};

/// Says what a sweep measures, and where its results go.
#[derive(Debug, Clone)]
pub struct SweepOptions {
    /// The manifold files.
    pub manifolds: Vec<PathBuf>,
    /// The folder for the results; made if missing.
    pub out: PathBuf,
    /// Set if fewer and smaller tables are measured: minutes instead of hours.
    pub quick: bool,
    /// Promises of bundles, mrad; empty for the usual ones.
    pub max_error: Vec<f64>,
    /// Mean numbers of cells of grids, at most [`MOST_CELLS`]; empty for the usual ones.
    pub cells: Vec<f64>,
    /// Fresh rays on which tables are measured; `None` for the usual number.
    pub rays: Option<usize>,
    /// Set if the fans sampled for every grid are written as NPZ, too.
    pub export_npz: bool,
    /// Seed of the fresh rays.
    pub seed: u64,
    /// One tensor for each manifold instead of a sweep.
    pub tensor: Option<TensorOptions>,
    /// The command that repeats the sweep, for the page.
    pub command: String,
}

/// The most cells along an axis of a grid, on average.
pub const MOST_CELLS: f64 = 4096.0;

/// Says which nodes of a fan a tensor has.
#[derive(Debug, Clone)]
pub struct TensorOptions {
    /// Nodes along every camera parameter, every direction parameter and the arc length.
    pub nodes: [usize; 3],
    /// Placing of the nodes.
    pub spacing: Spacing,
    /// The only face of directions; all of them if `None`.
    pub face: Option<usize>,
    /// Set if slopes are written, which tell tangents and with them the transported frames.
    pub frames: bool,
    /// Errors for which to tell how many bytes the tensor takes as one quantised train, as in a bundle.
    pub trains: Vec<f64>,
}

/// Placing of the nodes of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Spacing {
    /// Equally spaced, both ends included.
    Uniform,
    /// At the roots of a Chebyshev polynomial, ends not included.
    Chebyshev,
}

/// Tells of a tensor in a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WrittenTensor {
    /// The file.
    pub path: PathBuf,
    /// Lines that say how many bytes it takes as a quantised train, one for each error asked for.
    pub trains: Vec<String>,
}

/// Counts what a sweep has done.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SweepSummary {
    /// The tensors that were written instead.
    pub tensors: Vec<WrittenTensor>,
    /// Number of points of the sweep.
    pub points: usize,
    /// Number of them that were measured; the others were skipped for their size or time.
    pub measured: usize,
}

/// Says that sweeps are missing.
///
/// # Errors
/// Always.
#[cfg(not(feature = "sweep"))]
pub fn run(_: &SweepOptions, _: &dyn Observer) -> Result<SweepSummary> {
    Err(Error::input(
        "sweep",
        "this program was built without plots and NPZ; build it with `--features sweep`",
    ))
}

/// Measures everything that is not yet measured, then writes the results.
///
/// # Errors
/// Bad input, an interruption, or a folder that cannot be written.
#[cfg(feature = "sweep")]
pub fn run(options: &SweepOptions, observer: &dyn Observer) -> Result<SweepSummary> {
    check_names(&options.manifolds)?;
    make_output_folder(&options.out)?;
    if let Some(tensor) = &options.tensor {
        return write_tensors(tensor, options, observer);
    }
    let load = |path| ManifoldSweep::load(path, options, observer);
    let paths = options.manifolds.iter().map(std::path::PathBuf::as_path);
    let sweeps: Vec<ManifoldSweep<'_>> = paths.map(load).collect::<Result<_>>()?;
    let all = measured(&sweeps, observer).map_err(|error| match error {
        // Wherever it was interrupted: points that were measured are kept.
        Error::Interrupted { .. } => tables::interrupted(),
        other => other,
    })?;
    report::write_csv(&options.out.join("sweep.csv"), &all)?;
    report::write(&options.out, &all, &options.command)?;
    let points = || all.iter().flat_map(|results| &results.points);
    Ok(SweepSummary {
        tensors: Vec::new(),
        points: points().count(),
        measured: points().filter(|p| p.measured().is_some()).count(),
    })
}

/// Writes a tensor for each manifold.
#[cfg(feature = "sweep")]
fn write_tensors(
    tensor: &TensorOptions,
    options: &SweepOptions,
    observer: &dyn Observer,
) -> Result<SweepSummary> {
    let write = |manifold: &PathBuf| tensor.write(manifold, &options.out, observer);
    Ok(SweepSummary {
        tensors: options.manifolds.iter().map(write).collect::<Result<_>>()?,
        points: 0,
        measured: 0,
    })
}

/// Refuses two manifolds that would share the names of their points, figures and tensors.
#[cfg(feature = "sweep")]
fn check_names(manifolds: &[PathBuf]) -> Result<()> {
    for (k, path) in manifolds.iter().enumerate() {
        let name = path.file_stem();
        if manifolds[..k].iter().any(|other| other.file_stem() == name) {
            let message = "two manifold files have this name: sweep them into folders of their own";
            let name = name.unwrap_or_default().to_string_lossy();
            return Err(Error::input(name, message));
        }
    }
    Ok(())
}

/// Measures all manifolds, one after the other.
#[cfg(feature = "sweep")]
fn measured(sweeps: &[ManifoldSweep<'_>], observer: &dyn Observer) -> Result<Vec<ManifoldResults>> {
    let total = sweeps.iter().map(ManifoldSweep::work).sum();
    let done = std::cell::Cell::new(0);
    let mut all = Vec::new();
    for sweep in sweeps {
        let name = sweep.name();
        all.push(sweep.measure(|work| {
            done.set(done.get() + 1);
            observer.progress(Progress {
                work: "measuring",
                done: done.get(),
                total,
                detail: &format!("{name}: {work}"),
            });
        })?);
    }
    Ok(all)
}
