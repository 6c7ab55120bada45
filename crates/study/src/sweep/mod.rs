//! Accuracy against table size, for any manifolds.
//!
//! In: manifold files. Out, in a folder: `sweep.csv` (one row for each table measured), figures, and a
//! page. Tables are bundles at several promises and uniform grids of several sizes (`grid`); all
//! are measured on one set of fresh exact rays (`exact_rays`), beside an integrator that is as accurate
//! (`crate::rival`). Points that were measured before are kept (`point`). Instead, the sampled fans can
//! be written as tensors for numpy (`npz`).
//!
//! Without the feature `sweep` there are the options alone, and [`run`] says that it is missing.

#[cfg(feature = "sweep")]
mod bundles;
#[cfg(feature = "sweep")]
mod csv;
#[cfg(feature = "sweep")]
mod error_maps;
#[cfg(feature = "sweep")]
mod exact_rays;
#[cfg(feature = "sweep")]
pub mod grid;
#[cfg(feature = "sweep")]
mod grids;
#[cfg(feature = "sweep")]
mod manifold_sweep;
#[cfg(feature = "sweep")]
pub mod npz;
#[cfg(feature = "sweep")]
mod point;
#[cfg(feature = "sweep")]
mod report;
mod sweep_options;
#[cfg(feature = "sweep")]
mod timing;

pub use sweep_options::{MOST_CELLS, Spacing, SweepOptions, SweepSummary, TensorOptions};

use geofan_core::{Error, Observer, Result};
#[cfg(feature = "sweep")]
use {
    geofan_core::{Progress, files::make_output_folder},
    manifold_sweep::{ManifoldResults, ManifoldSweep},
};

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
    make_output_folder(&options.out)?;
    if let Some(tensor) = &options.tensor {
        return write_tensors(tensor, options, observer);
    }
    let load = |path| ManifoldSweep::load(path, options, observer);
    let paths = options.manifolds.iter().map(std::path::PathBuf::as_path);
    let sweeps: Vec<ManifoldSweep<'_>> = paths.map(load).collect::<Result<_>>()?;
    check_names(&sweeps)?;
    let all = measured(&sweeps, observer).map_err(|error| match error {
        // Wherever it was interrupted: points that were measured are kept.
        Error::Interrupted { .. } => bundles::interrupted(),
        other => other,
    })?;
    csv::write(&options.out.join("sweep.csv"), &all)?;
    report::write(&options.out, &all, &options.command)?;
    let points = || all.iter().flat_map(|results| &results.points);
    Ok(SweepSummary {
        lines: Vec::new(),
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
    let mut lines = Vec::new();
    for manifold in &options.manifolds {
        let path = tensor.write(manifold, &options.out, observer, &mut lines)?;
        lines.push(format!("{}\n", path.display()));
    }
    Ok(SweepSummary {
        lines,
        points: 0,
        measured: 0,
    })
}

/// Refuses two manifolds that would share the names of their points and figures.
#[cfg(feature = "sweep")]
fn check_names(sweeps: &[ManifoldSweep<'_>]) -> Result<()> {
    for (k, sweep) in sweeps.iter().enumerate() {
        let name = sweep.name();
        if sweeps[..k].iter().any(|other| other.name() == name) {
            let message = "two manifold files have this name: sweep them into folders of their own";
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
