//! Accuracy against table size.

use crate::work::{self, About, refuse};
use geofan_bake::PROMISES;
use geofan_study::sweep::{MOST_CELLS, SweepOptions, run};
use pyo3::prelude::*;
use std::path::PathBuf;

/// Measures tables of manifold files into a folder; returns how many points there are and how many were measured.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
pub fn sweep(
    py: Python<'_>,
    manifolds: Vec<PathBuf>,
    out: PathBuf,
    quick: bool,
    max_error: Vec<f64>,
    cells: Vec<f64>,
    rays: Option<usize>,
    seed: u64,
    progress: Option<Py<PyAny>>,
) -> PyResult<(usize, usize)> {
    if manifolds.is_empty() {
        return Err(refuse(py, "manifolds", "there is none"));
    }
    if let Some(promise) = max_error.iter().find(|promise| !PROMISES.contains(promise)) {
        let (start, end) = (PROMISES.start(), PROMISES.end());
        let message = format!("{promise} does not lie between {start} and {end} mrad");
        return Err(refuse(py, "max_error", message));
    }
    if let Some(cells) = cells
        .iter()
        .find(|cells| !(**cells > 0.0 && **cells <= MOST_CELLS))
    {
        let message = format!("{cells} is not above 0 and at most {MOST_CELLS}");
        return Err(refuse(py, "cells", message));
    }
    if let Some(rays) = rays.filter(|rays| !(100..=10_000_000).contains(rays)) {
        let message = format!("{rays} is not between 100 and 10000000");
        return Err(refuse(py, "rays", message));
    }
    let options = SweepOptions {
        manifolds,
        out,
        quick,
        max_error,
        cells,
        rays,
        export_npz: false,
        seed,
        tensor: None,
        command: "geofan.sweep(...)".into(),
    };
    let summary = work::watch(py, About::Manifold, progress.as_ref(), |observer| {
        run(&options, observer)
    })?;
    Ok((summary.points, summary.measured))
}
