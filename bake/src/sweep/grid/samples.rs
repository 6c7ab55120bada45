//! Exact fans at the nodes of a grid.
//!
//! In: rays of a space, [`Axes`] and what is to be [`Stored`]. Out: [`Samples`]: one number for each
//! node and channel, in single precision, axes (camera…, face, direction…, arc length, channel), the
//! last running fastest.

use super::axes::Axes;
use crate::sweep::clock::{Clock, Spent};
use geofan::fan::{DISPLACEMENT, FanSpace, sample};

/// Rays followed at once: enough to keep all threads busy, few enough that their samples in double
/// precision stay small beside the grid.
const BATCH: usize = 1 << 15;

/// What is kept of a path at a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stored {
    /// The slope of the departure, as bundles do: points are its integral.
    Slope,
    /// The displacement: points.
    Displacement,
    /// Both.
    Both,
}

impl Stored {
    /// Which channels of [`sample`] that is in `space`.
    pub fn channels(self, space: &FanSpace) -> Vec<usize> {
        let displacement = space.channels().iter().map(|c| DISPLACEMENT + c);
        let slope = space.channels().iter().copied();
        match self {
            Self::Slope => slope.collect(),
            Self::Displacement => displacement.collect(),
            Self::Both => displacement.chain(slope).collect(),
        }
    }
}

/// Sampled fans.
#[derive(Debug, Clone)]
pub struct Samples {
    /// The nodes.
    pub axes: Axes,
    /// Which channels of [`sample`] are kept.
    pub channels: Vec<usize>,
    /// The numbers.
    pub values: Vec<f32>,
    /// Time it took.
    pub spent: Spent,
}

impl Samples {
    /// Follows every ray of `axes` at a local tolerance and keeps what is to be `stored`; `None` if
    /// `stop` says so between batches.
    pub fn new(
        space: &FanSpace,
        axes: Axes,
        (tolerance, stored): (f64, Stored),
        stop: impl Fn() -> bool,
    ) -> Option<Self> {
        let clock = Clock::start();
        let channels = stored.channels(space);
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
            spent: clock.spent(),
        })
    }
}

/// Appends the samples of a batch of rays (chart point, direction in the standard frame).
fn append(
    space: &FanSpace,
    lengths: &[f64],
    tolerance: f64,
    batch: &[(glam::DVec3, glam::DVec3)],
    channels: &[usize],
    values: &mut Vec<f32>,
) {
    let manifold = space.manifold();
    let tangents = batch
        .iter()
        .map(|&(u, d)| (u, manifold.observer(u).tangent(d)));
    let rays: Vec<_> = tangents.collect();
    let starts = lengths.iter().take_while(|s| **s <= 0.0).count();
    let found = sample(space, tolerance, &rays, &lengths[starts..]);
    for path in found.outer_iter() {
        let mut put = |at: &dyn Fn(usize) -> f64| {
            // What cannot be sampled is left straight: one number that is none would spoil its line.
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
