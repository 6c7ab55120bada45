//! Options of a sweep.

use std::path::PathBuf;

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

/// Counts what a sweep has done.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SweepSummary {
    /// Lines about tensors that were written.
    pub lines: Vec<String>,
    /// Number of points of the sweep.
    pub points: usize,
    /// Number of them that were measured; the others were skipped for their size or time.
    pub measured: usize,
}
