//! The extension module of the Python package `geofan`.
//!
//! In: numpy arrays, texts and paths from the package's Python files, which hold the documented classes. Out:
//! arrays, JSON texts and exceptions. No mathematics: every number comes from the library crates. Work runs
//! without the GIL, on threads of this process ([`threads`]); long work tells its progress and ends on Ctrl-C
//! ([`work`]). Inputs are checked here, so that no input can make the libraries panic.

mod arrays;
mod bundle;
mod camera;
mod columns;
mod connect;
mod errors;
mod manifold;
mod pictures;
mod scene;
mod study;
mod threads;
mod trace;
mod work;

use pyo3::prelude::*;

/// Geodesics, tables and pictures of curved spaces, without the conveniences of the package around it.
#[pymodule]
mod _native {
    #[pymodule_export]
    use super::{
        bundle::Bundle,
        camera::Camera,
        manifold::Manifold,
        pictures::{read_picture, write_picture},
        scene::Stage,
        study::sweep,
        threads::{pop_threads, push_threads, thread_count},
    };
    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
