//! The nodes of a grid: exact fans at them, numbers of cells that suit a space, and interpolation between nodes.
//!
//! In: the rays of a [`RaySpace`], a length and numbers of cells; channels of [`sample`]. Out:
//! [`GridAxes`]: node positions along every stored camera parameter, every direction parameter of a face,
//! and the arc length (nodes of different faces on their common edge are stored twice); and
//! [`GridSamples`]: one number for each node and channel, in single precision, axes (camera…, face,
//! direction…, arc length, channel), the last running fastest.
//!
//! [`balanced`] reads from a coarse sampled grid how many cells each axis should have beside the others.
//! Straight interpolation errs by an eighth of the second difference, so a given number of nodes serves
//! best where the second differences along all axes are equal. A grid with as many cells along every
//! axis would be a weaker rival than a table deserves.
//!
//! In: a number of equally spaced nodes and a place among them. Out: a [`Stencil`]: the first node and the weights
//! of it and the next ones. Cubic B-splines interpolate after [`prefilter`], which turns the samples
//! along a line into coefficients. Their ends are *not-a-knot* (the third derivative is continuous at
//! the last node but one, de Boor, *A Practical Guide to Splines*, ch. 4), which keeps the fourth
//! order up to the edge: with mirrored ends the edges of every face and every path would be of second
//! order, and they hold most of a grid's cells.

use crate::sweep::{Spacing, measurement::TimeSpent};
use geofan_bundle::{
    chebyshev,
    rays::{DISPLACEMENT, RaySpace, sample},
};
use glam::DVec3;
use serde::{Deserialize, Serialize};

impl Spacing {
    /// Places `count` nodes over [low, high].
    fn nodes(self, count: usize, [low, high]: [f64; 2]) -> Vec<f64> {
        let unit: Vec<f64> = match self {
            Self::Uniform => (0..count)
                .map(|i| 2.0 * i as f64 / (count.max(2) - 1) as f64 - 1.0)
                .collect(),
            Self::Chebyshev => chebyshev::nodes(count),
        };
        let at = |t: f64| 0.5 * ((high + low) + (high - low) * t);
        unit.into_iter().map(at).collect()
    }
}

/// Places the nodes of a grid of fans.
#[derive(Debug, Clone)]
pub struct GridAxes {
    /// Along each stored camera parameter.
    pub cameras: Vec<Vec<f64>>,
    /// Numbers of the faces.
    pub faces: Vec<usize>,
    /// Along each direction parameter, in [−1, 1], the same for every face.
    pub directions: Vec<Vec<f64>>,
    /// Arc lengths, ascending.
    pub lengths: Vec<f64>,
}

impl GridAxes {
    /// Places `counts` nodes along the axes (camera…, direction…, arc length) over all rays of `space`.
    pub fn new(space: &RaySpace, length: f64, counts: &[usize], spacing: Spacing) -> Self {
        let k = space.cameras().len();
        let cameras = space.cameras().iter().zip(counts);
        let directions = &counts[k..k + space.directions()];
        Self {
            cameras: cameras
                .map(|(interval, n)| spacing.nodes(*n, *interval))
                .collect(),
            faces: (0..space.faces()).collect(),
            directions: directions
                .iter()
                .map(|n| spacing.nodes(*n, [-1.0, 1.0]))
                .collect(),
            lengths: spacing.nodes(counts[counts.len() - 1], [0.0, length]),
        }
    }

    /// Counts the nodes along camera…, face, direction…, which number the rays, the last running
    /// fastest.
    pub fn ray_shape(&self) -> Vec<usize> {
        let cameras = self.cameras.iter().map(Vec::len);
        let directions = self.directions.iter().map(Vec::len);
        cameras
            .chain([self.faces.len()])
            .chain(directions)
            .collect()
    }

    /// Returns the number of rays.
    pub fn rays(&self) -> usize {
        self.ray_shape().iter().product()
    }

    /// Returns the stored ray numbered `ray`: chart point and direction in the standard frame.
    pub fn ray(&self, space: &RaySpace, ray: usize) -> (DVec3, DVec3) {
        let shape = self.ray_shape();
        let mut place = vec![0; shape.len()];
        let mut rest = ray;
        for (at, n) in place.iter_mut().zip(&shape).rev() {
            (*at, rest) = (rest % n, rest / n);
        }
        let k = self.cameras.len();
        let pick = |nodes: &[Vec<f64>], at: &[usize]| -> Vec<f64> {
            nodes.iter().zip(at).map(|(n, i)| n[*i]).collect()
        };
        let camera = pick(&self.cameras, &place[..k]);
        let direction = pick(&self.directions, &place[k + 1..]);
        space.ray(self.faces[place[k]], &camera, &direction)
    }
}

/// Rays followed at once: enough to keep all threads busy, few enough that their samples in double
/// precision stay small beside the grid.
const BATCH: usize = 1 << 15;

/// Returns the channels of [`sample`] that are slopes of the departure in `space`, as bundles hold them:
/// points are their integral.
pub fn slope_channels(space: &RaySpace) -> Vec<usize> {
    space.channels().to_vec()
}

/// Returns the channels of [`sample`] that are displacements in `space`: points.
pub fn displacement_channels(space: &RaySpace) -> Vec<usize> {
    let displacements = space.channels().iter().map(|c| DISPLACEMENT + c);
    displacements.collect()
}

/// Holds sampled fans.
#[derive(Debug, Clone)]
pub struct GridSamples {
    /// The nodes.
    pub axes: GridAxes,
    /// The channels of [`sample`] that are kept.
    pub channels: Vec<usize>,
    /// The numbers.
    pub values: Vec<f32>,
    /// Time of the sampling.
    pub spent: TimeSpent,
}

impl GridSamples {
    /// Follows every ray of `axes` at a local tolerance and keeps `channels`; `None` if `stop` says so
    /// between batches.
    pub fn new(
        space: &RaySpace,
        axes: GridAxes,
        tolerance: f64,
        channels: Vec<usize>,
        stop: impl Fn() -> bool,
    ) -> Option<Self> {
        let began = TimeSpent::now();
        let (rays, arcs) = (axes.rays(), axes.lengths.len());
        let mut values = Vec::with_capacity(rays * arcs * channels.len());
        for first in (0..rays).step_by(BATCH) {
            if stop() {
                return None;
            }
            let batch = first..(first + BATCH).min(rays);
            let batch: Vec<_> = batch.map(|ray| axes.ray(space, ray)).collect();
            append(
                space,
                &axes.lengths,
                tolerance,
                &batch,
                &channels,
                &mut values,
            );
        }
        Some(Self {
            axes,
            channels,
            values,
            spent: TimeSpent::since(began),
        })
    }

    /// Returns the numbers of nodes along all axes, and of channels.
    pub fn shape(&self) -> Vec<usize> {
        let mut shape = self.axes.ray_shape();
        shape.extend([self.axes.lengths.len(), self.channels.len()]);
        shape
    }
}

/// Appends the samples of a batch of rays (chart point, direction in the standard frame).
fn append(
    space: &RaySpace,
    lengths: &[f64],
    tolerance: f64,
    batch: &[(DVec3, DVec3)],
    channels: &[usize],
    values: &mut Vec<f32>,
) {
    let manifold = space.manifold();
    let tangents = batch
        .iter()
        .map(|&(u, d)| (u, manifold.local_frame(u).tangent(d)));
    let rays: Vec<_> = tangents.collect();
    let starts = lengths.iter().take_while(|s| **s <= 0.0).count();
    let found = sample(space, tolerance, &rays, (&lengths[starts..], None));
    for path in found.outer_iter() {
        let mut put = |at: &dyn Fn(usize) -> f64| {
            // Places that cannot be sampled are left straight: one NaN would spoil its whole line.
            let values_of = channels.iter().map(|&c| match at(c) {
                x if x.is_finite() => x as f32,
                _ => 0.0,
            });
            values.extend(values_of);
        };
        // Where a path starts it is straight.
        (0..starts).for_each(|_| put(&|_| 0.0));
        path.outer_iter().for_each(|row| put(&|c| row[c]));
    }
}

/// The most by which the cells of an axis may differ from the even number, either way: beyond, the
/// coarse grid that they are read from says too little.
const MOST: f64 = 3.0;

/// The share of second differences below the one that is taken as typical of an axis.
const TYPICAL: f64 = 0.9;

/// Returns the relative numbers of cells along (camera…, direction…, arc length); their product is 1.
pub fn balanced(samples: &GridSamples) -> Vec<f64> {
    let shape = samples.shape();
    let face = samples.axes.cameras.len();
    let own = (0..shape.len() - 1).filter(|axis| *axis != face);
    let bends: Vec<f64> = own
        .map(|axis| {
            let cells = (shape[axis] - 1) as f64;
            cells * second_difference(samples, &shape, axis).sqrt()
        })
        .collect();
    // Shares whose product is 1, none far from the others.
    let logarithms: Vec<f64> = bends.iter().map(|b| b.max(1e-12).ln()).collect();
    let mean = logarithms.iter().sum::<f64>() / logarithms.len().max(1) as f64;
    let within = logarithms
        .iter()
        .map(|l| (l - mean).clamp(-MOST.ln(), MOST.ln()));
    let within: Vec<f64> = within.collect();
    let mean = within.iter().sum::<f64>() / within.len().max(1) as f64;
    within.iter().map(|l| (l - mean).exp()).collect()
}

/// Returns the typical size of second differences along `axis`.
fn second_difference(samples: &GridSamples, shape: &[usize], axis: usize) -> f64 {
    let stride: usize = shape[axis + 1..].iter().product();
    let n = shape[axis];
    let inner = |i: &usize| (1..n - 1).contains(&(i / stride % n));
    let values = &samples.values;
    let mut found: Vec<f32> = (0..values.len())
        .filter(inner)
        .map(|i| (values[i - stride] - 2.0 * values[i] + values[i + stride]).abs())
        .collect();
    let rank = (found.len() as f64 * TYPICAL) as usize;
    if rank >= found.len() {
        return 0.0;
    }
    f64::from(*found.select_nth_unstable_by(rank, f32::total_cmp).1)
}

/// Shares `even` cells along every axis out by the relative numbers of [`balanced`]; at least
/// `fewest`.
pub fn cells(even: f64, relative: &[f64], fewest: usize) -> Vec<usize> {
    let along = |r: &f64| ((even * r).round() as usize).max(fewest);
    relative.iter().map(along).collect()
}

/// Returns the geometric mean of numbers of cells: the reciprocal of the mean spacing.
pub fn mean(cells: &[usize]) -> f64 {
    let logarithms: f64 = cells.iter().map(|n| (*n as f64).ln()).sum();
    (logarithms / cells.len().max(1) as f64).exp()
}

/// Says how a grid is read between its nodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Interpolation {
    /// Straight between neighbours.
    Multilinear,
    /// Cubic B-splines through the samples.
    Cubic,
}

/// The fewest nodes of an axis: a cubic needs four.
pub const FEWEST: usize = 4;

/// Weights of consecutive nodes.
#[derive(Debug, Clone, Copy)]
pub struct Stencil {
    /// The first node.
    pub start: usize,
    weights: [f64; 4],
    width: usize,
}

impl Stencil {
    /// Returns the weights.
    pub fn weights(&self) -> &[f64] {
        &self.weights[..self.width]
    }
}

impl Interpolation {
    /// Returns the stencil at `t`, in [0, 1] along an axis of `nodes` nodes (at least [`FEWEST`]).
    pub fn stencil(self, nodes: usize, t: f64) -> Stencil {
        let (cell, x) = cell(nodes, t);
        self.in_cell(nodes, cell, x)
    }

    /// Returns the stencil at the share `x` of the cell `cell`.
    fn in_cell(self, nodes: usize, cell: usize, x: f64) -> Stencil {
        match self {
            Self::Multilinear => Stencil {
                start: cell,
                weights: [1.0 - x, x, 0.0, 0.0],
                width: 2,
            },
            Self::Cubic => cubic(nodes, cell, x),
        }
    }

    /// Returns the stencil of the integral from the start of the cell `cell` to its share `x`, in cells: two
    /// Gauss points are exact for cubics.
    pub fn integral(self, nodes: usize, cell: usize, x: f64) -> Stencil {
        let offset = 0.5 / f64::sqrt(3.0);
        let [a, b] = [0.5 - offset, 0.5 + offset].map(|g| self.in_cell(nodes, cell, g * x));
        let weights = std::array::from_fn(|k| 0.5 * x * (a.weights[k] + b.weights[k]));
        Stencil { weights, ..a }
    }
}

/// Returns the cell of `t`, in [0, 1] along an axis of `nodes` nodes, and the share of it that lies before.
pub fn cell(nodes: usize, t: f64) -> (usize, f64) {
    let place = t.clamp(0.0, 1.0) * (nodes - 1) as f64;
    let cell = (place as usize).min(nodes - 2);
    (cell, place - cell as f64)
}

/// Weighs the coefficients `cell − 1 … cell + 2`. The coefficient beyond either end continues
/// the four next to it as a cubic, which not-a-knot means for B-splines: it is folded into
/// their weights.
fn cubic(nodes: usize, cell: usize, x: f64) -> Stencil {
    let r = 1.0 - x;
    let [a, b, c, d] = [
        r * r * r,
        3.0 * x * x * (x - 2.0) + 4.0,
        3.0 * r * r * (r - 2.0) + 4.0,
        x * x * x,
    ]
    .map(|w| w / 6.0);
    let (start, weights) = if cell == 0 {
        (0, [b + 4.0 * a, c - 6.0 * a, d + 4.0 * a, -a])
    } else if cell + 2 == nodes {
        (nodes - 4, [-d, a + 4.0 * d, b - 6.0 * d, c + 4.0 * d])
    } else {
        (cell - 1, [a, b, c, d])
    };
    Stencil {
        start,
        weights,
        width: 4,
    }
}

/// Turns samples `f` along a line into B-spline coefficients, in place.
///
/// `(c[i−1] + 4 c[i] + c[i+1])/6 = f[i]`, and the fourth differences at both ends vanish. Both
/// together give `c[1] = (8 f[1] − f[0] − f[2])/6` and its mirror image outright; the rest between
/// them is tridiagonal.
pub fn prefilter(f: &mut [f64]) {
    // Both ends, outright.
    let n = f.len();
    let near_start = (8.0 * f[1] - f[0] - f[2]) / 6.0;
    let near_end = (8.0 * f[n - 2] - f[n - 1] - f[n - 3]) / 6.0;
    let (first, last) = (6.0 * f[1], 6.0 * f[n - 2]);
    f[1] = near_start;
    f[n - 2] = near_end;
    // Thomas's algorithm on rows 2 … n−3; `above` holds the remainder above the diagonal.
    let mut above = vec![0.0; n];
    for i in 2..n.saturating_sub(2) {
        let pivot = 4.0 - above[i - 1];
        f[i] = (6.0 * f[i] - f[i - 1]) / pivot;
        above[i] = 1.0 / pivot;
    }
    for i in (2..n.saturating_sub(2)).rev() {
        f[i] -= above[i] * f[i + 1];
    }
    f[0] = first - 4.0 * f[1] - f[2];
    f[n - 1] = last - 4.0 * f[n - 2] - f[n - 3];
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(interpolation: Interpolation, values: &[f64], t: f64) -> f64 {
        let stencil = interpolation.stencil(values.len(), t);
        let values = &values[stencil.start..];
        stencil
            .weights()
            .iter()
            .zip(values)
            .map(|(w, v)| w * v)
            .sum()
    }

    #[test]
    fn integrals_add_up_to_that_of_a_cubic() {
        let f = |t: f64| 1.0 - 2.0 * t + 3.0 * t * t - 4.0 * t * t * t;
        let integral = |t: f64| t - t * t + t * t * t - t * t * t * t;
        for n in [4, 5, 9] {
            let coefficients = spline(n, f);
            let sum = |end: usize, x: f64| {
                let stencil = Interpolation::Cubic.integral(n, end, x);
                let values = &coefficients[stencil.start..];
                let terms = stencil.weights().iter().zip(values).map(|(w, v)| w * v);
                terms.sum::<f64>() / (n - 1) as f64
            };
            for t in [0.05, 0.3, 0.5, 0.77, 1.0] {
                let (last, x) = cell(n, t);
                let whole: f64 = (0..last).map(|cell| sum(cell, 1.0)).sum();
                let found = whole + sum(last, x);
                assert!((found - integral(t)).abs() < 1e-12, "{n} {t} {found}");
            }
        }
    }

    fn spline(n: usize, f: impl Fn(f64) -> f64) -> Vec<f64> {
        let mut values: Vec<f64> = (0..n).map(|i| f(i as f64 / (n - 1) as f64)).collect();
        prefilter(&mut values);
        values
    }

    #[test]
    fn cubic_splines_reproduce_cubics_up_to_the_edge() {
        let f = |t: f64| 1.0 - 2.0 * t + 3.0 * t * t - 4.0 * t * t * t;
        for n in [4, 5, 6, 7, 20] {
            let coefficients = spline(n, f);
            for k in 0..=100 {
                let t = f64::from(k) / 100.0;
                let found = read(Interpolation::Cubic, &coefficients, t);
                assert!((found - f(t)).abs() < 1e-12, "{n} {t} {found}");
            }
        }
    }

    #[test]
    fn splines_go_through_their_samples() {
        let f = |t: f64| (9.0 * t).sin();
        let coefficients = spline(11, f);
        for k in 0..11 {
            let t = f64::from(k) / 10.0;
            let found = read(Interpolation::Cubic, &coefficients, t);
            assert!((found - f(t)).abs() < 1e-12);
        }
    }

    /// The worst error over the whole interval on `n` nodes.
    fn worst(interpolation: Interpolation, n: usize) -> f64 {
        let f = |t: f64| (5.0 * t + 0.3).sin();
        let values = match interpolation {
            Interpolation::Multilinear => (0..n).map(|i| f(i as f64 / (n - 1) as f64)).collect(),
            Interpolation::Cubic => spline(n, f),
        };
        let error = |k: u32| {
            let t = f64::from(k) / 5000.0;
            (read(interpolation, &values, t) - f(t)).abs()
        };
        (0..=5000).map(error).fold(0.0, f64::max)
    }

    #[test]
    fn the_orders_are_two_and_four_edges_included() {
        for (interpolation, order) in [
            (Interpolation::Multilinear, 2.0),
            (Interpolation::Cubic, 4.0),
        ] {
            let slope = (worst(interpolation, 41) / worst(interpolation, 81)).log2();
            assert!((slope - order).abs() < 0.3, "{interpolation:?} {slope}");
        }
    }
}
