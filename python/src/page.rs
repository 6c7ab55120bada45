//! Pages of scenes, for browsers and notebooks.

use crate::{errors::About, threads, work};
use geofan_view::{Page, SpaceSource};
use pyo3::prelude::*;
use std::path::PathBuf;

/// Makes the page of a scene or manifold file, as `geofan view --page` does. Returns the bytes of the files written
/// to `output`; without one, the HTML text.
#[pyfunction]
pub fn page(
    py: Python<'_>,
    file: PathBuf,
    bundle: Option<PathBuf>,
    length: Option<f64>,
    settings: Vec<(String, f64)>,
    wasm: PathBuf,
    output: Option<PathBuf>,
) -> PyResult<(usize, Option<String>)> {
    let source = SpaceSource {
        file,
        bundle,
        length,
    };
    // The files that a page reads are noted by its thread, which must not take up the work of others meanwhile.
    let own = threads::fresh(py)?;
    work::watch_in(py, About::Scene, None, &own, |_| {
        let page = Page::new(&source, &settings, &wasm)?;
        match output {
            Some(output) => Ok((page.write(&output)?, None)),
            None => {
                let html = page.html()?;
                Ok((html.len(), Some(html)))
            }
        }
    })
}
