//! What a sweep measures: promises, sizes of grids, limits.
//!
//! In: the number of axes and camera parameters of a space. Out: an [`Effort`].

use crate::sweep::patches::Limits;

/// What is measured of one manifold.
#[derive(Debug, Clone)]
pub struct Effort {
    /// Promises of bundles, mrad, loosest first.
    pub promises: Vec<f64>,
    /// Even numbers of cells of grids, coarsest first.
    pub cells: Vec<f64>,
    /// Cells along every axis of the grid from which it is learnt how to share them out.
    pub pilot: usize,
    /// Limits of one table.
    pub limits: Limits,
    /// Fresh rays.
    pub rays: usize,
}

/// How much is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Extent {
    /// Minutes.
    Quick,
    /// Up to hours.
    Full,
}

impl Effort {
    /// For a space with so many camera parameters and axes (arc length included).
    pub fn new(cameras: usize, axes: usize, extent: Extent) -> Self {
        // Two and three camera parameters make large files: a quick sweep asks for little of them.
        let promises: &[f64] = match (cameras, extent) {
            (0 | 1, Extent::Quick) => &[2.0, 0.5, 0.1],
            (0 | 1, Extent::Full) => &[2.0, 0.5, 0.2, 0.1, 0.03],
            (2, Extent::Quick) => &[10.0],
            (2, Extent::Full) => &[30.0, 10.0, 3.0, 1.0],
            (_, Extent::Quick) => &[60.0],
            (_, Extent::Full) => &[60.0, 30.0, 15.0, 4.0, 1.0],
        };
        // Spacings are halved where axes are few; with more, doubling all cells would leave two
        // sizes between nothing and too much. The largest end near the limit of bytes.
        let (first, ratio, count) = match (axes, extent) {
            (0..=2, _) => (16.0, 2.0, 5),
            (3, Extent::Quick) => (8.0, 2.0, 4),
            (3, Extent::Full) => (8.0, 2.0, 7),
            (4, Extent::Quick) => (6.0, std::f64::consts::SQRT_2, 5),
            (4, Extent::Full) => (6.0, std::f64::consts::SQRT_2, 7),
            (5, Extent::Quick) => (4.0, std::f64::consts::SQRT_2, 4),
            (5, Extent::Full) => (4.0, std::f64::consts::SQRT_2, 6),
            _ => (3.0, std::f64::consts::SQRT_2, 5),
        };
        Self {
            promises: promises.to_vec(),
            pilot: first as usize,
            cells: (0..count).map(|i| first * f64::powi(ratio, i)).collect(),
            limits: limits(extent),
            rays: match extent {
                Extent::Quick => 4_000,
                Extent::Full => 20_000,
            },
        }
    }

    /// The promise in the middle of the list: there errors are mapped, and one bundle is also made
    /// without halving.
    pub fn middle(&self) -> Option<f64> {
        self.promises.get(self.promises.len() / 2).copied()
    }
}

/// What one table may take.
fn limits(extent: Extent) -> Limits {
    Limits {
        seconds: match extent {
            Extent::Quick => 120.0,
            Extent::Full => 900.0,
        },
        grid_bytes: match extent {
            Extent::Quick => 128 << 20,
            Extent::Full => 5 << 28,
        },
    }
}
