//! Fans on a uniform grid: the plain way to make a table, as a yardstick for patches.
//!
//! In: the rays of a space, numbers of cells; [`GridSamples`] on uniform nodes. Out: a [`Grid`] with
//! multilinear or cubic B-spline interpolation, in single precision or 16 bits; for a camera it gives a
//! [`GridFan`], and for a direction a [`GridPath`]: chart point, tangent and transported rotation at any
//! arc length. The axes are those of a bundle: camera parameters after symmetry, direction parameters on
//! faces, arc length; so are the channels, the slope of the departure, whose integral along the path gives
//! points. A row holds one stored ray: (arc length, channel).

mod nodes;

#[cfg(test)]
mod tests;

pub use nodes::{
    FEWEST, GridAxes, GridSamples, Interpolation, balanced, cells, displacement_channels, mean,
    slope_channels,
};

use crate::sweep::measurement::TimeSpent;
use geofan_bundle::rays::{LiftedStart, Located, Place, RaySpace};
use geofan_core::{Result, geodesic::carry, manifold::Manifold};
use glam::{DQuat, DVec3};
use nodes::{Stencil, cell, prefilter};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// A table of fans on equally spaced nodes.
#[derive(Debug, Clone)]
pub struct Grid {
    space: RaySpace,
    interpolation: Interpolation,
    /// Intervals of the camera parameters, none once the camera is fixed.
    cameras: Vec<[f64; 2]>,
    /// Nodes along camera…, face, direction….
    shape: Vec<usize>,
    /// Nodes along the arc length.
    arcs: usize,
    /// The integral over each cell of the arc length.
    cells: Vec<Stencil>,
    length: f64,
    channels: Vec<usize>,
    numbers: GridNumbers,
    /// Time for all of it, sampling included.
    pub spent: TimeSpent,
}

/// Rows and their weights.
type Rows = Vec<(usize, f32)>;

impl Grid {
    /// Takes samples of the slope on uniform nodes over `space` and `length`.
    pub fn new(
        space: &RaySpace,
        samples: &GridSamples,
        length: f64,
        (interpolation, format): (Interpolation, NumberFormat),
    ) -> Self {
        let began = TimeSpent::now();
        let axes = &samples.axes;
        let (shape, arcs) = (axes.ray_shape(), axes.lengths.len());
        let channels = samples.channels.clone();
        let mut values = samples.values.clone();
        if interpolation == Interpolation::Cubic {
            to_coefficients(
                &mut values,
                &shape,
                axes.cameras.len(),
                arcs,
                channels.len(),
            );
        }
        Self {
            space: space.clone(),
            interpolation,
            cameras: space.cameras().to_vec(),
            shape,
            arcs,
            cells: (0..arcs - 1)
                .map(|cell| interpolation.integral(arcs, cell, 1.0))
                .collect(),
            length,
            numbers: GridNumbers::new(values, channels.len(), format),
            channels,
            spent: samples.spent + TimeSpent::since(began),
        }
    }

    /// Counts the bytes, in a file as in memory: nothing is coded.
    pub fn bytes(&self) -> u64 {
        self.numbers.bytes()
    }

    fn row_length(&self) -> usize {
        self.arcs * self.channels.len()
    }

    /// Prepares all paths from the camera position `u`, read from the whole grid.
    ///
    /// # Errors
    /// `u` is not in the camera region.
    pub fn fan(&self, u: DVec3) -> Result<GridFan<'_>> {
        let place = self.space.place(u)?;
        let rows = self.camera_rows(&place);
        Ok(GridFan {
            grid: self,
            place,
            rows,
        })
    }

    /// Fixes the camera at `u`: returns the smaller grid that a renderer would read for a frame, and the
    /// camera's place.
    ///
    /// # Errors
    /// `u` is not in the camera region.
    pub fn contracted(&self, u: DVec3) -> Result<(Self, Place)> {
        let place = self.space.place(u)?;
        let rows = self.camera_rows(&place);
        let k = self.cameras.len();
        let rays: usize = self.shape[k..].iter().product();
        let length = self.row_length();
        let mut values = vec![0.0; rays * length];
        values
            .par_chunks_mut(length.max(1))
            .enumerate()
            .for_each(|(ray, row)| self.numbers.sum(&shifted(&rows, ray), row));
        let contracted = Self {
            space: self.space.clone(),
            cameras: Vec::new(),
            shape: self.shape[k..].to_vec(),
            numbers: GridNumbers::new(values, self.channels.len(), NumberFormat::F32),
            channels: self.channels.clone(),
            cells: self.cells.clone(),
            ..*self
        };
        Ok((contracted, place))
    }

    /// Prepares all paths from `place`, at which the camera has been fixed.
    pub fn fixed_fan(&self, place: Place) -> GridFan<'_> {
        GridFan {
            grid: self,
            place,
            rows: vec![(0, 1.0)],
        }
    }

    /// Returns the rows of the camera's neighbours, of the first ray each.
    fn camera_rows(&self, place: &Place) -> Rows {
        let mut rows = vec![(0, 1.0)];
        let intervals = self.cameras.iter().zip(&place.parameters);
        for ((&[low, high], p), &n) in intervals.zip(&self.shape) {
            let t = if high > low {
                (p - low) / (high - low)
            } else {
                0.0
            };
            rows = multiplied(&rows, n, &self.interpolation.stencil(n, t));
        }
        let rays: usize = self.shape[self.cameras.len()..].iter().product();
        shifted_each(rows, rays)
    }

    /// Returns the rows of the direction's neighbours on its face.
    fn direction_rows(&self, located: &Located) -> Rows {
        let mut rows = vec![(located.face, 1.0)];
        let counts = &self.shape[self.cameras.len() + 1..];
        for (p, &n) in located.direction.iter().zip(counts) {
            rows = multiplied(&rows, n, &self.interpolation.stencil(n, 0.5 * (p + 1.0)));
        }
        rows
    }
}

/// Numbers rows along one more axis of `n` nodes.
fn multiplied(rows: &Rows, n: usize, stencil: &Stencil) -> Rows {
    let along = |&(row, weight): &(usize, f32)| {
        let nodes = stencil.weights().iter().enumerate();
        nodes
            .map(|(i, w)| (row * n + stencil.start + i, weight * *w as f32))
            .collect::<Vec<_>>()
    };
    rows.iter().flat_map(along).collect()
}

/// Adds `by` to the numbers of rows.
fn shifted(rows: &Rows, by: usize) -> Rows {
    rows.iter().map(|(row, w)| (row + by, *w)).collect()
}

/// Numbers rows by their first rays, `rays` to each.
fn shifted_each(rows: Rows, rays: usize) -> Rows {
    rows.into_iter().map(|(row, w)| (row * rays, w)).collect()
}

/// Turns samples into B-spline coefficients along every axis but face and channel.
fn to_coefficients(values: &mut [f32], shape: &[usize], face: usize, arcs: usize, channels: usize) {
    let all: Vec<usize> = shape.iter().copied().chain([arcs, channels]).collect();
    for axis in (0..all.len() - 1).filter(|axis| *axis != face) {
        let stride: usize = all[axis + 1..].iter().product();
        let block = stride * all[axis];
        values.par_chunks_mut(block).for_each(|block| {
            let mut line = vec![0.0; all[axis]];
            for offset in 0..stride {
                for (x, v) in line.iter_mut().zip(block[offset..].iter().step_by(stride)) {
                    *x = f64::from(*v);
                }
                prefilter(&mut line);
                for (x, v) in line.iter().zip(block[offset..].iter_mut().step_by(stride)) {
                    *v = *x as f32;
                }
            }
        });
    }
}

/// All paths from one camera position.
#[derive(Debug, Clone)]
pub struct GridFan<'g> {
    grid: &'g Grid,
    place: Place,
    rows: Rows,
}

impl<'g> GridFan<'g> {
    /// Looks up the path in the direction `d` (standard frame, unit).
    pub fn path(&self, d: DVec3) -> GridPath<'_, 'g> {
        let grid = self.grid;
        let located = grid.space.locate(&self.place, d);
        let directions = grid.direction_rows(&located);
        let both = |&(camera, w): &(usize, f32)| {
            directions.iter().map(move |(row, v)| (camera + row, w * v))
        };
        let rows: Rows = self.rows.iter().flat_map(both).collect();
        let mut row = vec![0.0; grid.row_length()];
        grid.numbers.sum(&rows, &mut row);
        GridPath {
            start: grid.space.chart_map().start(located.u, located.v),
            sums: grid.cell_sums(&row),
            fan: self,
            located,
            row,
        }
    }
}

/// The slope of a departure, or the departure: four channels.
type Channels = [f64; 4];

/// The most that one step of a transport along a path may be off, radians.
const TRANSPORT_TOLERANCE: f64 = 1e-6;

/// One path of a grid.
#[derive(Debug, Clone)]
pub struct GridPath<'f, 'g> {
    fan: &'f GridFan<'g>,
    located: Located,
    start: LiftedStart,
    row: Vec<f32>,
    /// The departure at every node of the arc length, in cells.
    sums: Vec<Channels>,
}

impl Grid {
    /// Returns the manifold whose paths it holds.
    pub fn manifold(&self) -> &Manifold {
        self.space.manifold()
    }

    /// Returns how far its paths go.
    pub fn length(&self) -> f64 {
        self.length
    }

    /// Computes the departures of the path with the slopes `row` at all nodes of the arc length, in cells.
    fn cell_sums(&self, row: &[f32]) -> Vec<Channels> {
        let mut sums = vec![[0.0; 4]];
        let mut sum = [0.0; 4];
        for stencil in &self.cells {
            self.add(row, stencil, &mut sum);
            sums.push(sum);
        }
        sums
    }

    /// Adds the value of `stencil` on the path with the slopes `row`.
    fn add(&self, row: &[f32], stencil: &Stencil, sum: &mut Channels) {
        let channels = self.channels.len();
        let rows = row[stencil.start * channels..].chunks_exact(channels);
        for (row, w) in rows.zip(stencil.weights()) {
            for (&c, x) in self.channels.iter().zip(row) {
                sum[c] += w * f64::from(*x);
            }
        }
    }
}

impl GridPath<'_, '_> {
    /// Returns departure and slope at arc length `s`.
    fn values(&self, s: f64) -> [Channels; 2] {
        let grid = self.fan.grid;
        let t = s / grid.length;
        let (cell, x) = cell(grid.arcs, t);
        let (mut departure, mut slope) = (self.sums[cell], [0.0; 4]);
        let (interpolation, arcs) = (grid.interpolation, grid.arcs);
        grid.add(
            &self.row,
            &interpolation.integral(arcs, cell, x),
            &mut departure,
        );
        grid.add(&self.row, &interpolation.stencil(arcs, t), &mut slope);
        let of_a_cell = grid.length / (arcs - 1) as f64;
        [departure.map(|d| d * of_a_cell), slope]
    }

    /// Returns the chart point and the tangent at `s`.
    pub fn at(&self, s: f64) -> (DVec3, DVec3) {
        let space = &self.fan.grid.space;
        let [departure, slope] = self.values(s);
        let (u, v) = space.chart_map().state(&self.start, departure, slope, s);
        let (u, differential) = self.located.isometry.apply(u);
        (u, differential * v)
    }

    /// Returns the transported rotation at `s` relative to the standard frames, by transport along the path as
    /// a bundle does it; `None` where the path leads out of the space.
    pub fn rotation(&self, s: f64) -> Option<DQuat> {
        let manifold = self.fan.grid.space.manifold();
        let carried = carry(manifold, |s| self.at(s), [0.0, s], TRANSPORT_TOLERANCE);
        Some(carried.ok()?.rotation)
    }
}

/// Says how a number is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NumberFormat {
    /// Single precision.
    F32,
    /// 16-bit integers between the least and the largest of their channel.
    U16,
}

/// Stores the numbers of a grid, the channel running fastest.
#[derive(Debug, Clone)]
pub enum GridNumbers {
    /// In single precision.
    F32(Vec<f32>),
    /// Rounded.
    U16 {
        /// Steps above the least number of the channel.
        steps: Vec<u16>,
        /// The least number and the step of each channel.
        scales: Vec<[f32; 2]>,
    },
}

impl GridNumbers {
    /// Stores `values` of so many `channels`; 16 bits have one scale for each channel.
    pub fn new(values: Vec<f32>, channels: usize, format: NumberFormat) -> Self {
        match format {
            NumberFormat::F32 => Self::F32(values),
            NumberFormat::U16 => {
                let scales: Vec<[f32; 2]> =
                    (0..channels).map(|c| scale(&values, c, channels)).collect();
                let steps = values.chunks_exact(channels).flat_map(|row| {
                    row.iter().zip(&scales).map(|(x, [least, step])| {
                        // Saturates, and a channel without width has only its least number.
                        ((x - least) / step).round() as u16
                    })
                });
                Self::U16 {
                    steps: steps.collect(),
                    scales,
                }
            }
        }
    }

    /// Counts the bytes taken.
    pub fn bytes(&self) -> u64 {
        let bytes = match self {
            Self::F32(values) => size_of_val(values.as_slice()),
            Self::U16 { steps, scales } => {
                size_of_val(steps.as_slice()) + size_of_val(scales.as_slice())
            }
        };
        bytes as u64
    }

    /// Computes the weighted sum of `rows`, each as long as `sum`; their weights add up to 1.
    pub fn sum(&self, rows: &[(usize, f32)], sum: &mut [f32]) {
        sum.fill(0.0);
        let n = sum.len();
        match self {
            Self::F32(values) => {
                for (row, w) in rows {
                    let row = &values[row * n..(row + 1) * n];
                    sum.iter_mut().zip(row).for_each(|(s, x)| *s += w * x);
                }
            }
            Self::U16 { steps, scales } => {
                for (row, w) in rows {
                    let row = &steps[row * n..(row + 1) * n];
                    sum.iter_mut()
                        .zip(row)
                        .for_each(|(s, x)| *s += w * f32::from(*x));
                }
                for values in sum.chunks_exact_mut(scales.len()) {
                    for (s, [least, step]) in values.iter_mut().zip(scales) {
                        *s = least + step * *s;
                    }
                }
            }
        }
    }
}

/// Returns the least number of channel `c` and the step to the largest in 65,535 parts.
fn scale(values: &[f32], c: usize, channels: usize) -> [f32; 2] {
    let channel = values.iter().skip(c).step_by(channels);
    let (least, most) = channel.fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), x| {
        (a.min(*x), b.max(*x))
    });
    [least, (most - least) / f32::from(u16::MAX)]
}
