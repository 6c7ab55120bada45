//! Exact fans at the nodes of a grid.
//!
//! In: rays of a space and [`Axes`]. Out: [`Samples`]: one number for each node and channel, in
//! single precision, axes (camera…, face, direction…, arc length, channel), the last running fastest.
//! Channels are those that a bundle stores: displacement, then transported rotation.

use super::axes::Axes;
use crate::sweep::clock::{Clock, Spent};
use geofan::fan::{CHANNELS, FanSpace, ROTATION, sample};

/// Rays followed at once: enough to keep all threads busy, few enough that their samples in double
/// precision stay small beside the grid.
const BATCH: usize = 1 << 15;

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

/// The channels of [`sample`] that a table of `space` stores, rotations only with `frames`.
pub fn stored_channels(space: &FanSpace, frames: bool) -> Vec<usize> {
    let displacement = space.displacement_channels().iter().copied();
    let rotation = space.rotation_channels().iter().map(|c| ROTATION + c);
    displacement.chain(rotation.filter(|_| frames)).collect()
}

impl Samples {
    /// Follows every ray of `axes` at a local tolerance, with or without transported `frames`; `None` if `stop` says so between batches.
    pub fn new(
        space: &FanSpace,
        axes: Axes,
        (tolerance, frames): (f64, bool),
        stop: impl Fn() -> bool,
    ) -> Option<Self> {
        let clock = Clock::start();
        let channels = stored_channels(space, frames);
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
        .map(|&(u, d)| (u, manifold.standard_frame(u) * d));
    let rays: Vec<_> = tangents.collect();
    let starts = lengths.iter().take_while(|s| **s <= 0.0).count();
    let frames = channels.iter().any(|c| *c >= ROTATION);
    let found = sample(space, tolerance, frames, &rays, &lengths[starts..]);
    for (path, (u, _)) in found.outer_iter().zip(batch) {
        let rest = at_rest(space, *u);
        let mut put = |at: &dyn Fn(usize) -> f64| {
            // What cannot be sampled is left straight: one number that is none would spoil its line.
            let values_of = channels.iter().map(|&c| match at(c) {
                x if x.is_finite() => x as f32,
                _ => rest[c] as f32,
            });
            values.extend(values_of);
        };
        (0..starts).for_each(|_| put(&|c| rest[c]));
        path.outer_iter().for_each(|row| put(&|c| row[c]));
    }
}

/// The channels at the start of a path, where the displacement over the arc length vanishes.
fn at_rest(space: &FanSpace, u: glam::DVec3) -> [f64; CHANNELS] {
    let mut rest = [0.0; CHANNELS];
    rest[ROTATION..].copy_from_slice(&space.lift().twist(u).to_array());
    rest
}
