//! One frame: paths and what they meet, for any tracer.
//!
//! In: a world, a view and a tracer. Out: what every sample sees, and the work and times of
//! the steps. Shading is [`super::shade`]. All tracers share everything after the paths.

use super::{
    desk::{Desk, Desks},
    lattice::{Lattice, smallest_tile},
    local::trace_straight,
    outcome::{Seen, seen_along},
    starts::starts,
    tiles::{Found, Place, Samples, Tally},
    tracer::{ExactTracer, GridTracer},
    view::View,
    world::World,
};
use glam::DVec2;
use ndarray::{Array3, Axis};
use rayon::prelude::*;
use std::time::{Duration, Instant};

/// What the samples of a picture see, axes (row, column, sample).
pub type Outcomes = Array3<Seen>;

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

/// How the paths of a frame are made and what became of its samples.
#[derive(Debug, Clone, Copy, Default)]
pub struct Work {
    /// Steps of the threads.
    pub tally: Tally,
    /// Samples that the tracer could not give.
    pub pending: usize,
    /// Time for those, by the clock.
    pub pending_time: Duration,
}

impl std::ops::AddAssign for Work {
    fn add_assign(&mut self, other: Self) {
        self.tally += other.tally;
        self.pending += other.pending;
        self.pending_time += other.pending_time;
    }
}

/// The outcomes of samples, and the work that it took.
pub struct Traced {
    /// What each sample sees.
    pub outcomes: Outcomes,
    /// The samples that the tracer could not give and that were integrated exactly.
    pub flagged: Vec<Place>,
    /// The work.
    pub work: Work,
}

/// How the paths of samples are made.
#[derive(Clone, Copy)]
pub enum Paths<'a> {
    /// Each integrated by itself.
    Exact(&'a ExactTracer<'a>),
    /// Each looked up, or followed at common knots, by itself.
    Direct(&'a dyn GridTracer),
    /// Interpolated from a lattice of paths, within a budget in radians at the camera.
    Lattice(&'a dyn GridTracer, f64),
    /// Straight lines of the chart over a length (see [`super::local`]).
    Straight(f64),
}

/// What the samples at `offsets` of every pixel see.
pub fn trace(world: &World, view: &View, paths: Paths<'_>, offsets: &[DVec2]) -> Traced {
    let samples = Samples {
        world,
        view,
        offsets,
    };
    match paths {
        Paths::Exact(tracer) => trace_exact(&samples, tracer),
        Paths::Straight(length) => Traced {
            outcomes: trace_straight(&samples, length),
            flagged: Vec::new(),
            work: Work::default(),
        },
        Paths::Direct(tracer) => trace_tiles(&samples, tracer, |desk, found| {
            let places = samples.places(found.tile());
            samples.trace(&places, tracer, desk, found);
        }),
        Paths::Lattice(tracer, budget) => {
            let lattice = Lattice {
                tracer,
                world,
                view,
                budget,
                smallest: smallest_tile(offsets.len()),
            };
            trace_tiles(&samples, tracer, |desk, found| {
                let began = Instant::now();
                let corner = (found.corner.1, found.corner.0);
                let spare = desk.strands.take();
                let divided = lattice.refine(corner, spare, &mut desk.endings);
                found.tally.lattice += began.elapsed();
                samples.interpolate(&divided, tracer, desk, found);
                desk.strands = divided.strands;
            })
        }
    }
}

/// What nothing has been found for yet; written by all threads, as it is megabytes.
fn nothing((height, width, count): (usize, usize, usize)) -> Outcomes {
    let all = rayon::iter::repeat_n(Seen::Nothing, height * width * count).collect();
    Array3::from_shape_vec((height, width, count), all).expect("one for each sample")
}

fn trace_exact(samples: &Samples<'_>, tracer: &ExactTracer<'_>) -> Traced {
    let (width, height) = samples.view.size;
    let count = samples.offsets.len();
    let mut outcomes = Outcomes::from_elem((height, width, count), Seen::Nothing);
    outcomes
        .axis_iter_mut(Axis(0))
        .into_par_iter()
        .enumerate()
        .for_each(|(y, mut row)| {
            let places = (0..width * count).map(|i| (y, i / count, i % count));
            let shown: Vec<usize> = (places.clone().enumerate())
                .filter(|(_, place)| samples.shows(*place))
                .map(|(i, _)| i)
                .collect();
            let points = places.filter(|place| samples.shows(*place));
            let points = points.map(|place| samples.point(place));
            let starts = starts(&samples.world.manifold, samples.view, points);
            let known = shown.into_iter().zip(starts);
            let (shown, starts): (Vec<usize>, Vec<_>) = known
                .filter_map(|(i, start)| start.map(|start| (i, (start.u, start.v))))
                .unzip();
            let mut slots: Vec<&mut Seen> = row.iter_mut().collect();
            for (i, curve) in shown.into_iter().zip(tracer.trace_from(&starts)) {
                *slots[i] = seen_along(samples.world, &curve);
            }
        });
    let mut work = Work::default();
    work.tally.traced = outcomes.len();
    let flagged = Vec::new();
    Traced {
        outcomes,
        flagged,
        work,
    }
}

/// Works on all of the largest tiles, then on what was put off.
fn trace_tiles(
    samples: &Samples<'_>,
    tracer: &dyn GridTracer,
    tile: impl Fn(&mut Desk<'_>, &mut Found<'_>) + Sync,
) -> Traced {
    let (width, height) = samples.view.size;
    let mut outcomes = nothing((height, width, samples.offsets.len()));
    let mut tiles = Found::split(&mut outcomes);
    let desks = Desks::new(&samples.world.manifold, tracer.knots());
    // One by one: a few tiles take as long as many others, and they stand together. Those in the middle
    // first: there is most often what a camera looks at, and a dear tile at the end keeps one thread alone.
    let mut order: Vec<&mut Found<'_>> = tiles
        .iter_mut()
        .filter(|found| samples.shows_some(found.tile()))
        .collect();
    order.sort_by_key(|found| found.tile().squared_distance((width / 2, height / 2)));
    order
        .into_iter()
        .par_bridge()
        .for_each(|found| desks.with(|desk| tile(desk, found)));
    let mut work = Work::default();
    let mut pending = Vec::new();
    for found in tiles {
        work.tally += found.tally;
        pending.extend(found.pending);
    }
    let began = Instant::now();
    work.pending = pending.len();
    let mut flagged = Vec::new();
    if let Some(tracer) = tracer.fallback() {
        for (place, seen) in trace_pending(samples, tracer, &pending) {
            outcomes[place] = seen;
            flagged.push(place);
        }
    }
    work.pending_time = began.elapsed();
    Traced {
        outcomes,
        flagged,
        work,
    }
}

/// Rays given to one thread at once: enough to keep its lanes full.
const BLOCK: usize = 256;

/// Samples that were put off, in blocks.
fn trace_pending(
    samples: &Samples<'_>,
    tracer: &ExactTracer<'_>,
    pending: &[Place],
) -> Vec<(Place, Seen)> {
    let world = samples.world;
    let block = |places: &[Place]| -> Vec<(Place, Seen)> {
        let points = places.iter().map(|place| samples.point(*place));
        let starts = starts(&world.manifold, samples.view, points);
        let known = places.iter().zip(starts);
        let (places, starts): (Vec<Place>, Vec<_>) = known
            .filter_map(|(place, start)| start.map(|start| (*place, (start.u, start.v))))
            .unzip();
        let seen = tracer.trace_from(&starts).into_iter();
        let seen = seen.map(|curve| seen_along(world, &curve));
        places.into_iter().zip(seen).collect()
    };
    pending.par_chunks(BLOCK).flat_map(block).collect()
}
