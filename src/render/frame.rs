//! One frame: paths, intersection and shading, for any tracer.
//!
//! In: a world, a view and a tracer. Out: the [`Outcome`] of every sample and the times of the
//! steps. Shading is [`super::shade`]. Both tracers share everything after the paths.

use super::{
    curve::EndingFinder,
    lattice::{Found, Lattice, LatticeTally, Tile},
    outcome::{Outcome, Seen, outcome},
    tracer::{GridTracer, Tracer},
    view::View,
    world::World,
};
use glam::{DVec2, DVec3};
use ndarray::{Array3, Axis};
use rayon::prelude::*;

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
    let tiles = Tile::covering(view.size);
    let found: Vec<(Vec<Found>, LatticeTally)> = tiles
        .into_par_iter()
        .map_init(
            || EndingFinder::new(&world.manifold),
            |endings, tile| {
                let (mut found, mut tally) = (Vec::new(), LatticeTally::default());
                lattice.tile(tile, endings, &mut found, &mut tally);
                (found, tally)
            },
        )
        .collect();
    let (width, height) = view.size;
    let mut outcomes = Outcomes::from_elem((height, width, samples), NOTHING);
    let mut total = LatticeTally::default();
    for (found, tally) in found {
        total = total.plus(tally);
        for ((x, y, k), outcome) in found {
            outcomes[(y, x, k)] = outcome;
        }
    }
    (outcomes, total)
}
