//! A patch at one camera, cut into cells on each of which few coefficients do.
//!
//! In: a [`Contracted`] with many coefficients in both direction parameters, which is dear to evaluate
//! for one path. Out: for the cell around a direction, made when it is first asked for, the same
//! polynomials in the cell's own parameters, without the coefficients that do not count there. The
//! cells' edges are `−cos(πi/n)`, so that a Chebyshev polynomial swings as often in each; on the whole
//! sphere they are evenly spaced.

use super::{chebyshev, contracted::Contracted, matrix::product, spherical};
use geofan_expr::real::Real;
use std::{f64::consts::PI, sync::OnceLock};

/// Nodes along each side of a cell. With 8, a third of the paths of a frame among three bumps found
/// that their cell would leave out too much, and took the whole patch; with 10 none does.
const NODES: usize = 10;

/// Patches with fewer coefficients in the direction are evaluated whole: cells keep some 40.
const FEWEST: usize = 128;

/// Coefficients of the whole patch for each cell along an axis: a polynomial of that degree swings once
/// in a cell, so that its coefficients there fall fast before the last of [`NODES`].
const PER_CELL: usize = 2;

/// What the coefficients that are left out may sum to, as a share of the largest: a few dozen roundings
/// of single precision, far below any promise that a table can make. Cells that would leave out more
/// are not used.
const LEFT_OUT: f32 = 4e-6;

/// The cells of a patch.
#[derive(Debug, Clone)]
pub(super) struct Cells {
    edges: [Vec<f64>; 2],
    /// The patch on the cells of each interval of the second parameter, whole in the first. A picture
    /// sees most azimuths if a pole is in it, but rarely all polar angles.
    bands: Box<[OnceLock<Vec<f32>>]>,
    /// `None` where a cell would leave out too much.
    cells: Box<[OnceLock<Option<Box<Contracted>>>]>,
}

impl Cells {
    /// Cells for `degrees` coefficients in both parameters; `None` if they would hardly be fewer in
    /// a cell.
    pub(super) fn new(degrees: [usize; 2], sphere: bool) -> Option<Self> {
        if degrees[0] * degrees[1] < FEWEST {
            return None;
        }
        let edges = degrees.map(|n| edges(n.div_ceil(PER_CELL), sphere));
        let count = edges.each_ref().map(|edges| edges.len() - 1);
        Some(Self {
            edges,
            bands: (0..count[1]).map(|_| OnceLock::new()).collect(),
            cells: (0..count[0] * count[1]).map(|_| OnceLock::new()).collect(),
        })
    }

    /// The cell of `patch` around (p, q), and where in it that is.
    pub(super) fn at(
        &self,
        patch: &Contracted,
        place: [f64; 2],
    ) -> Option<(&Contracted, [f64; 2])> {
        let [i, j] = [0, 1].map(|k| number(&self.edges[k], place[k]));
        let sides = [(0, i), (1, j)].map(|(k, i)| [self.edges[k][i], self.edges[k][i + 1]]);
        let cell = &self.cells[i * (self.edges[1].len() - 1) + j];
        let band = || self.bands[j].get_or_init(|| band(patch, sides[1]));
        let cell = cell.get_or_init(|| restricted(patch, band(), sides[0]).map(Box::new));
        let inner = [0, 1].map(|k| {
            let [low, high] = sides[k];
            2.0 * (place[k] - low) / (high - low) - 1.0
        });
        Some((cell.as_deref()?, inner))
    }
}

fn edges(cells: usize, even: bool) -> Vec<f64> {
    let edge = |i: usize| match even {
        true => 2.0 * i as f64 / cells as f64 - 1.0,
        false => -Real::cos(PI * i as f64 / cells as f64),
    };
    (0..=cells).map(edge).collect()
}

/// Which of the intervals between `edges` holds `x`.
fn number(edges: &[f64], x: f64) -> usize {
    edges[1..edges.len() - 1].partition_point(|edge| *edge <= x)
}

/// The coefficients of `patch` on an interval of its second parameter, axes (p, q, row).
fn band(patch: &Contracted, side: [f64; 2]) -> Vec<f32> {
    let nq = patch.degrees()[1];
    let matrices = match patch.is_sphere() {
        false => vec![restriction(nq, side, chebyshev::values)],
        true => [false, true]
            .map(|odd| {
                restriction(nq, side, |b, values| {
                    spherical::polar_values(b, odd, values)
                })
            })
            .into(),
    };
    let planes = patch.table().chunks_exact(nq * patch.width());
    let restricted = planes.enumerate().flat_map(|(i, plane)| {
        let odd = patch.is_sphere() && spherical::is_odd(i);
        product(&matrices[usize::from(odd)], nq, plane)
    });
    restricted.collect()
}

/// `patch` on a box of its parameters, from its `band` there; `None` if that leaves out too much.
fn restricted(patch: &Contracted, band: &[f32], side: [f64; 2]) -> Option<Contracted> {
    let np = patch.degrees()[0];
    let matrix = match patch.is_sphere() {
        false => restriction(np, side, chebyshev::values),
        true => restriction(np, side, spherical::azimuth_values),
    };
    let table = product(&matrix, np, band);
    let (row, scales) = (patch.width(), patch.scales());
    let sizes: Vec<f32> = table
        .chunks_exact(row)
        .map(|line| {
            let numbers = line.iter().zip(&scales);
            numbers
                .map(|(c, scale)| (c * scale).powi(2))
                .sum::<f32>()
                .sqrt()
        })
        .collect();
    let allowed = LEFT_OUT * sizes.iter().fold(0.0, |most: f32, size| size.max(most));
    let kept = [
        kept(|i| (0..NODES).map(|j| sizes[i * NODES + j]).sum(), allowed)?,
        kept(|j| (0..NODES).map(|i| sizes[i * NODES + j]).sum(), allowed)?,
    ];
    let lines = |i: usize| &table[i * NODES * row..][..kept[1] * row];
    let table = (0..kept[0])
        .flat_map(|i| lines(i).iter().copied())
        .collect();
    Some(patch.with_table(table, kept))
}

/// The matrix that takes the coefficients of `n` terms to [`NODES`] of the polynomial through their sum at
/// as many nodes of a part of [−1, 1]; `of` gives the values of the terms.
fn restriction(n: usize, [low, high]: [f64; 2], of: impl Fn(f64, &mut [f64])) -> Vec<f32> {
    let transform = chebyshev::transform(NODES);
    let mut values = vec![0.0; NODES * n];
    for (x, values) in chebyshev::nodes(NODES)
        .iter()
        .zip(values.chunks_exact_mut(n))
    {
        of(low + 0.5 * (x + 1.0) * (high - low), values);
    }
    product(&transform.into_raw_vec_and_offset().0, NODES, &values)
        .into_iter()
        .map(|x: f64| x as f32)
        .collect()
}

/// How many coefficients along an axis must be kept so that the rest, of sums `size`, is `allowed`;
/// `None` if all must: then more are missing.
fn kept(size: impl Fn(usize) -> f32, allowed: f32) -> Option<usize> {
    let mut left = 0.0;
    let mut kept = NODES;
    while kept > 1 {
        left += size(kept - 1);
        if !(left <= allowed) {
            break;
        }
        kept -= 1;
    }
    (kept < NODES).then_some(kept)
}
