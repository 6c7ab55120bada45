//! One frame: paths, intersection and shading, for any tracer.
//!
//! In: a world, a view and a tracer. Out: the [`Outcome`] of every sample and the times of the
//! steps. Shading is [`super::shade`]. Both tracers share everything after the paths.

use super::{
    curve::EndingFinder,
    lattice::{Found, LARGEST_TILE, Lattice, LatticeTally, Place, Tile},
    outcome::{Outcome, Seen, outcome},
    tracer::{GridTracer, Tracer},
    view::View,
    world::World,
};
use glam::{DVec2, DVec3};
use ndarray::{Array3, Axis};
use rayon::prelude::*;
use std::time::Instant;

/// Samples of a picture, axes (row, column, sample).
pub type Outcomes = Array3<Outcome>;

const NOTHING: Outcome = Outcome {
    seen: Seen::Nothing,
    flagged: false,
};

/// Where in a pixel its `n` samples lie: the middle for one, else the additive recurrence of the
/// plastic number (M. Roberts, *The Unreasonable Effectiveness of Quasirandom Sequences*, 2018),
/// the same in every pixel so that tracers can be compared sample by sample.
pub fn offsets(n: usize) -> Vec<DVec2> {
    const PLASTIC: f64 = 1.324_717_957_244_746;
    let step = DVec2::new(1.0 / PLASTIC, 1.0 / (PLASTIC * PLASTIC));
    (0..n)
        .map(|k| (DVec2::splat(0.5) + step * k as f64).fract())
        .collect()
}

/// Every sample traced by itself.
pub fn trace_all(world: &World, view: &View, tracer: &dyn Tracer, samples: usize) -> Outcomes {
    let (width, height) = view.size;
    let offsets = offsets(samples);
    let mut outcomes = Outcomes::from_elem((height, width, samples), NOTHING);
    outcomes
        .axis_iter_mut(Axis(0))
        .into_par_iter()
        .enumerate()
        .for_each(|(y, mut row)| {
            let directions: Vec<DVec3> = (0..width * samples)
                .map(|i| {
                    let at = DVec2::new((i / samples) as f64, y as f64) + offsets[i % samples];
                    view.direction(at.x, at.y)
                })
                .collect();
            for (slot, curve) in row.iter_mut().zip(tracer.trace(&directions)) {
                *slot = outcome(world, &curve);
            }
        });
    outcomes
}

/// Samples interpolated from a lattice of curves within `budget` (radians at the camera).
pub fn trace_lattice(
    world: &World,
    view: &View,
    tracer: &dyn GridTracer,
    samples: usize,
    budget: f64,
) -> (Outcomes, LatticeTally) {
    let offsets = offsets(samples);
    let lattice = Lattice {
        tracer,
        world,
        view,
        offsets: &offsets,
        budget,
    };
    let (width, height) = view.size;
    let mut outcomes = Outcomes::from_elem((height, width, samples), NOTHING);
    let mut tiles: Vec<Found<'_>> = Vec::new();
    for (row, band) in outcomes
        .axis_chunks_iter_mut(Axis(0), LARGEST_TILE)
        .enumerate()
    {
        // The views of a band are split off one after another: they do not overlap.
        let mut rest = band;
        let mut x = 0;
        while x < width {
            let (first, others) = rest.split_at(Axis(1), LARGEST_TILE.min(width - x));
            tiles.push(Found::new((row * LARGEST_TILE, x), first));
            (rest, x) = (others, x + LARGEST_TILE);
        }
    }
    tiles.par_iter_mut().for_each_init(
        || EndingFinder::new(&world.manifold),
        |endings, found| {
            let (y, x) = found.corner;
            let side = LARGEST_TILE;
            lattice.tile(Tile { x, y, side }, endings, found);
        },
    );
    let mut tally = LatticeTally::default();
    let mut pending = Vec::new();
    for found in tiles {
        tally = tally.plus(found.tally);
        pending.extend(found.pending);
    }
    let began = Instant::now();
    for (place, outcome) in trace_pending(world, tracer, &pending) {
        outcomes[place] = outcome;
    }
    tally.pending = began.elapsed();
    tally.traced = outcomes.len() - tally.interpolated;
    (outcomes, tally)
}

/// Rays given to one thread at once: enough to keep its lanes full.
const BLOCK: usize = 256;

/// Samples that were put off, in blocks.
fn trace_pending(
    world: &World,
    tracer: &dyn Tracer,
    pending: &[(Place, DVec3)],
) -> Vec<(Place, Outcome)> {
    let block = |rays: &[(Place, DVec3)]| -> Vec<(Place, Outcome)> {
        let directions: Vec<DVec3> = rays.iter().map(|(_, d)| *d).collect();
        let curves = tracer.trace(&directions);
        rays.iter()
            .zip(curves)
            .map(|((place, _), curve)| (*place, outcome(world, &curve)))
            .collect()
    };
    pending.par_chunks(BLOCK).flat_map(block).collect()
}
