//! Accuracy against table size, for any manifolds.
//!
//! In: manifold files. Out, in a folder: `sweep.csv` (one row for each table measured), figures, and a
//! page. Tables are bundles at several promises and uniform grids of several sizes (`grid`); all
//! are measured on the same fresh exact rays (`truth`), beside an integrator that is as accurate
//! (`rival`). Points that were measured before are kept (`point`).
//!
//! Without the feature `sweep` there are the options alone, and [`run`] says that it is missing.

#[cfg(feature = "sweep")]
mod clock;
#[cfg(feature = "sweep")]
mod effort;
#[cfg(feature = "sweep")]
mod frames;
#[cfg(feature = "sweep")]
pub mod grid;
#[cfg(feature = "sweep")]
mod maps;
#[cfg(feature = "sweep")]
mod measure;
#[cfg(feature = "sweep")]
pub mod npz;
#[cfg(feature = "sweep")]
mod npz_bytes;
mod options;
#[cfg(feature = "sweep")]
mod patches;
#[cfg(feature = "sweep")]
mod point;
#[cfg(feature = "sweep")]
mod report;
#[cfg(feature = "sweep")]
mod rival;
#[cfg(feature = "sweep")]
mod speed;
#[cfg(feature = "sweep")]
mod subject;
#[cfg(feature = "sweep")]
mod table;
#[cfg(feature = "sweep")]
mod truth;

pub use options::{MOST_CELLS, Spacing, SweepOptions, SweepSummary, TensorOptions};

#[cfg(feature = "sweep")]
pub use measure::run;

/// Says that sweeps are missing.
///
/// # Errors
/// Always.
#[cfg(not(feature = "sweep"))]
pub fn run(_: &SweepOptions, _: &dyn geofan_core::Observer) -> geofan_core::Result<SweepSummary> {
    Err(geofan_core::Error::input(
        "sweep",
        "this program was built without plots and NPZ; build it with `--features sweep`",
    ))
}
