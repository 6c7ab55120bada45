//! The extension module of the Python package `geofan`.
//!
//! In: numpy arrays, texts and paths from the package's Python files, which hold the documented classes. Out:
//! arrays, JSON texts and exceptions. No mathematics: every number comes from the library crates. Work runs
//! without the GIL, on threads of this process; it tells its progress and ends on Ctrl-C ([`work`]): between blocks of
//! points, rays or pixels. Comparisons of pictures and pages run to their end, and so does what one fan of geodesics takes
//! (`connect`): Ctrl-C takes effect after it.
//! Inputs are checked here, so that no input can make the libraries panic.

mod arrays;
mod bundles;
mod camera;
mod manifold;
mod paths;
mod picture_work;
mod pictures;
mod scene;
mod work;

use pyo3::{PyClass, prelude::*};

/// Refuses a class whose values need more than the alignment that Python's allocator gives to objects, where they
/// are kept: vector instructions fault on them. Such a class keeps them in a box.
const fn is_aligned<T: PyClass>() -> bool {
    align_of::<T>() <= 2 * size_of::<usize>()
}

const _: () = {
    assert!(is_aligned::<bundles::PyBundle>());
    assert!(is_aligned::<camera::PyCamera>());
    assert!(is_aligned::<manifold::PyManifold>());
    assert!(is_aligned::<scene::PyStage>());
};

/// Geodesics, tables and pictures of curved spaces, without the conveniences of the package around it.
#[pymodule]
mod _native {
    #[pymodule_export]
    use super::{
        bundles::{PyBundle, sweep},
        camera::{PyCamera, journey},
        manifold::PyManifold,
        pictures::{page, read_picture, write_picture},
        scene::PyStage,
        work::{pop_threads, push_threads, thread_count},
    };
    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
