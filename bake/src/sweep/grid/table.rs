//! A grid of fans as a table: storage and lookup.
//!
//! In: [`Samples`] on uniform nodes. Out: a [`Grid`], which for a camera gives a [`GridFan`], and for
//! a direction a [`GridPath`]: chart point, tangent and transported rotation at any arc length. A row
//! is what one stored ray holds: (arc length, channel).

use super::{
    samples::Samples,
    stencil::{Interpolation, Stencil, cell, prefilter},
    storage::{Number, Storage},
};
use crate::sweep::clock::{Clock, Spent};
use geofan::{
    Result,
    fan::{FanSpace, Located, Place, Start},
    geodesic::carry,
};
use glam::{DQuat, DVec3};
use rayon::prelude::*;

/// A table of fans on equally spaced nodes.
#[derive(Debug, Clone)]
pub struct Grid {
    space: FanSpace,
    interpolation: Interpolation,
    /// Intervals of the camera parameters, none once the camera is fixed.
    cameras: Vec<[f64; 2]>,
    /// Nodes along camera…, face, direction….
    shape: Vec<usize>,
    /// Nodes along the arc length.
    arcs: usize,
    /// Of the integral over each cell of the arc length.
    cells: Vec<Stencil>,
    length: f64,
    channels: Vec<usize>,
    storage: Storage,
    /// Time for all of it, sampling included.
    pub spent: Spent,
}

/// Rows and their weights.
type Rows = Vec<(usize, f32)>;

impl Grid {
    /// From samples of the slope on uniform nodes over `space` and `length`.
    pub fn new(
        space: &FanSpace,
        samples: &Samples,
        length: f64,
        interpolation: Interpolation,
        number: Number,
    ) -> Self {
        let clock = Clock::start();
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
            storage: Storage::new(values, channels.len(), number),
            channels,
            spent: samples.spent + clock.spent(),
        }
    }

    /// Bytes, in a file as in memory: nothing is coded.
    pub fn bytes(&self) -> u64 {
        self.storage.bytes()
    }

    fn row_length(&self) -> usize {
        self.arcs * self.channels.len()
    }

    /// All paths from the camera position `u`, read from the whole grid.
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

    /// The grid with its camera fixed at `u`: what a renderer would read for a frame.
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
            .for_each(|(ray, row)| self.storage.sum(&shifted(&rows, ray), row));
        let contracted = Self {
            space: self.space.clone(),
            cameras: Vec::new(),
            shape: self.shape[k..].to_vec(),
            storage: Storage::new(values, self.channels.len(), Number::F32),
            channels: self.channels.clone(),
            cells: self.cells.clone(),
            ..*self
        };
        Ok((contracted, place))
    }

    /// All paths from `place`, at which the camera has been fixed.
    pub fn fixed_fan(&self, place: Place) -> GridFan<'_> {
        GridFan {
            grid: self,
            place,
            rows: vec![(0, 1.0)],
        }
    }

    /// The rows of the camera's neighbours, of the first ray each.
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

    /// The rows of the direction's neighbours on its face.
    fn direction_rows(&self, located: &Located) -> Rows {
        let mut rows = vec![(located.face, 1.0)];
        let counts = &self.shape[self.cameras.len() + 1..];
        for (p, &n) in located.direction.iter().zip(counts) {
            rows = multiplied(&rows, n, &self.interpolation.stencil(n, 0.5 * (p + 1.0)));
        }
        rows
    }
}

/// Rows numbered along one more axis of `n` nodes.
fn multiplied(rows: &Rows, n: usize, stencil: &Stencil) -> Rows {
    let along = |&(row, weight): &(usize, f32)| {
        let nodes = stencil.weights().iter().enumerate();
        nodes
            .map(|(i, w)| (row * n + stencil.start + i, weight * *w as f32))
            .collect::<Vec<_>>()
    };
    rows.iter().flat_map(along).collect()
}

fn shifted(rows: &Rows, by: usize) -> Rows {
    rows.iter().map(|(row, w)| (row + by, *w)).collect()
}

fn shifted_each(rows: Rows, rays: usize) -> Rows {
    rows.into_iter().map(|(row, w)| (row * rays, w)).collect()
}

/// Samples to B-spline coefficients along every axis but face and channel.
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
    /// The path in the direction `d` (standard frame, unit).
    pub fn path(&self, d: DVec3) -> GridPath<'_, 'g> {
        let grid = self.grid;
        let located = grid.space.locate(&self.place, d);
        let directions = grid.direction_rows(&located);
        let both = |&(camera, w): &(usize, f32)| {
            directions.iter().map(move |(row, v)| (camera + row, w * v))
        };
        let rows: Rows = self.rows.iter().flat_map(both).collect();
        let mut row = vec![0.0; grid.row_length()];
        grid.storage.sum(&rows, &mut row);
        GridPath {
            start: grid.space.lift().start(located.u, located.v),
            sums: grid.cell_sums(&row),
            fan: self,
            located,
            row,
        }
    }
}

/// The slope of a departure, or what it adds up to: four channels.
type Channels = [f64; 4];

/// The most that one step of a transport along a path may be off, radians.
const TRANSPORT_TOLERANCE: f64 = 1e-6;

/// One path of a grid.
#[derive(Debug, Clone)]
pub struct GridPath<'f, 'g> {
    fan: &'f GridFan<'g>,
    located: Located,
    start: Start,
    row: Vec<f32>,
    /// The departure at every node of the arc length, in cells.
    sums: Vec<Channels>,
}

impl Grid {
    /// The departures of the path with the slopes `row` at all nodes of the arc length, in cells.
    fn cell_sums(&self, row: &[f32]) -> Vec<Channels> {
        let mut sums = vec![[0.0; 4]];
        let mut sum = [0.0; 4];
        for stencil in &self.cells {
            self.add(row, stencil, &mut sum);
            sums.push(sum);
        }
        sums
    }

    /// Adds what `stencil` gives of the path with the slopes `row`.
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
    /// Departure and slope at arc length `s`.
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

    /// The chart point and the tangent at `s`.
    pub fn at(&self, s: f64) -> (DVec3, DVec3) {
        let space = &self.fan.grid.space;
        let [departure, slope] = self.values(s);
        let (u, v) = space.lift().state(&self.start, departure, slope, s);
        let (u, differential) = self.located.isometry.apply(u);
        (u, differential * v)
    }

    /// The transported rotation at `s` relative to the standard frames, by transport along the path as
    /// a bundle does it; `None` where the path leads out of the space.
    pub fn rotation(&self, s: f64) -> Option<DQuat> {
        let manifold = self.fan.grid.space.manifold();
        let carried = carry(manifold, |s| self.at(s), [0.0, s], TRANSPORT_TOLERANCE);
        Some(carried.ok()?.rotation)
    }
}
