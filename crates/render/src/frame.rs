//! One frame: paths and what they meet, for any tracer.
//!
//! In: a world, a view, a tracer and a clock. Out: what every sample sees, and the work and times of the
//! steps. Shading is [`super::shade`]. All tracers share everything after the paths.

use super::{
    intersect::{Seen, seen_from},
    lattice::{Lattice, smallest_tile},
    local::trace_straight,
    starts::starts,
    tiles::{PixelSamples, SamplePlace, TileOutcomes, TileScratch},
    tracer::{ExactTracer, GridTracer},
    view::View,
    world::World,
};
use geofan_core::parallel::*;
use glam::{DVec2, DVec3};
use ndarray::{Array3, Axis};
use serde::Serialize;
use std::time::Duration;

/// The ends of all lines of sight of a picture, axes (row, column, sample).
pub type Outcomes = Array3<Seen>;

/// A clock of the caller: the time since any moment of its choice. All threads read it.
pub type Clock<'c> = &'c (dyn Fn() -> Duration + Sync);

/// Stands still: the [`Clock`] of a caller that does not ask for times.
pub fn no_clock() -> Duration {
    Duration::ZERO
}

/// Is told how many more samples have been worked on, from any thread, and says whether to go on. If it does not, what has
/// not been begun is left out, and the picture is worth nothing.
pub type Watch<'w> = &'w (dyn Fn(usize) -> bool + Sync);

/// Lets work run to its end: the [`Watch`] of a caller that does not look at it.
pub fn unwatched(_: usize) -> bool {
    true
}

/// Returns the places in a pixel of its `n` samples: the middle for one, else the additive recurrence of the
/// plastic number (M. Roberts, *The Unreasonable Effectiveness of Quasirandom Sequences*, 2018), equal in
/// every pixel so that tracers can be compared sample by sample.
pub fn offsets(n: usize) -> Vec<DVec2> {
    const PLASTIC: f64 = 1.324_717_957_244_746;
    let step = DVec2::new(1.0 / PLASTIC, 1.0 / (PLASTIC * PLASTIC));
    (0..n)
        .map(|k| (DVec2::splat(0.5) + step * k as f64).fract())
        .collect()
}

/// Work done for a frame and time spent. Times are sums over threads, but for the samples that were put off; reports have
/// their own.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct FrameStatistics {
    /// Paths looked up or followed at common knots.
    pub paths: usize,
    /// Samples interpolated.
    pub interpolated: usize,
    /// Samples traced one by one.
    pub traced: usize,
    /// Samples that the tracer could not give.
    pub pending: usize,
    /// Time for paths and for dividing tiles.
    #[serde(skip)]
    pub lattice: Duration,
    /// Time for tubes and chords.
    #[serde(skip)]
    pub tiles: Duration,
    /// Time for samples.
    #[serde(skip)]
    pub pixels: Duration,
    /// Time for the samples that the tracer could not give, by the clock.
    #[serde(skip)]
    pub pending_time: Duration,
}

impl std::ops::AddAssign for FrameStatistics {
    fn add_assign(&mut self, other: Self) {
        self.paths += other.paths;
        self.interpolated += other.interpolated;
        self.traced += other.traced;
        self.pending += other.pending;
        self.lattice += other.lattice;
        self.tiles += other.tiles;
        self.pixels += other.pixels;
        self.pending_time += other.pending_time;
    }
}

/// Outcomes of samples, and the work that it took.
pub struct TracedSamples {
    /// The end of each sample's line of sight.
    pub outcomes: Outcomes,
    /// The samples that the tracer could not give and that were integrated exactly.
    pub flagged: Vec<SamplePlace>,
    /// The work.
    pub work: FrameStatistics,
}

/// The way in which the paths of samples are made.
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

impl Paths<'_> {
    /// Returns how far paths are followed, and at what local tolerance those that are integrated.
    pub(super) fn reach(&self) -> (f64, f64) {
        let of = |tracer: &ExactTracer<'_>| (tracer.length(), tracer.tolerance());
        match self {
            Self::Exact(tracer) => of(tracer),
            Self::Direct(tracer) | Self::Lattice(tracer, _) => {
                let known = || tracer.knots().last().copied().unwrap_or_default();
                // Paths that are looked up again go on beyond the last knot.
                tracer.fallback().map_or_else(|| (known(), TOLERANCE), of)
            }
            Self::Straight(length) => (*length, TOLERANCE),
        }
    }

    /// Returns the tracer that integrates paths from `u` as far, in the space itself, glued as it is.
    pub(super) fn integrated<'w>(&self, world: &'w World, u: DVec3) -> ExactTracer<'w> {
        let (length, tolerance) = self.reach();
        ExactTracer::new(&world.manifold, u, length, tolerance)
    }
}

/// Local tolerance of exact paths in place of those of a tracer that has none.
const TOLERANCE: f64 = 1e-8;

/// Finds what the samples at `offsets` of every pixel see, without measuring times.
pub fn trace(world: &World, view: &View, paths: Paths<'_>, offsets: &[DVec2]) -> TracedSamples {
    trace_watched(world, view, paths, offsets, (&no_clock, &unwatched))
}

/// Finds what the samples at `offsets` of every pixel see, measures times by `clock` and tells `watch`.
pub fn trace_watched(
    world: &World,
    view: &View,
    paths: Paths<'_>,
    offsets: &[DVec2],
    (clock, watch): (Clock<'_>, Watch<'_>),
) -> TracedSamples {
    let samples = PixelSamples {
        world,
        view,
        offsets,
        clock,
    };
    // Paths of a covering space do not tell what portals, mirrors and exits of a glued one do with them.
    let is_cover = matches!(paths, Paths::Direct(_) | Paths::Lattice(..));
    if is_cover && world.manifold.needs_exact_paths() {
        let traced = trace_exact(&samples, &paths.integrated(world, view.u), watch);
        let all = traced.outcomes.indexed_iter();
        let flagged = all.map(|(place, _)| place).collect();
        return TracedSamples { flagged, ..traced };
    }
    match paths {
        Paths::Exact(tracer) => trace_exact(&samples, tracer, watch),
        Paths::Straight(length) => TracedSamples {
            outcomes: trace_straight(&samples, length),
            flagged: Vec::new(),
            work: FrameStatistics::default(),
        },
        Paths::Direct(tracer) => trace_tiles(&samples, tracer, watch, |scratch, tile| {
            let places = samples.places(tile.tile());
            samples.trace(&places, tracer, scratch, tile);
        }),
        Paths::Lattice(tracer, budget) => {
            let lattice = Lattice {
                tracer,
                world,
                view,
                budget,
                smallest: smallest_tile(offsets.len()),
            };
            trace_tiles(&samples, tracer, watch, |scratch, tile| {
                let mut undivided = lattice.undivided((tile.corner.1, tile.corner.0));
                while !undivided.is_empty() {
                    let began = clock();
                    let spare = scratch.paths.take();
                    let divided = lattice.refine(&mut undivided, spare, &mut scratch.events);
                    tile.work.lattice += clock().saturating_sub(began);
                    samples.interpolate(&divided, tracer, scratch, tile);
                    scratch.paths = divided.paths;
                }
            })
        }
    }
}

/// Makes outcomes of which nothing is known yet; written by all threads, as it is megabytes.
fn nothing((height, width, count): (usize, usize, usize)) -> Outcomes {
    let all = (0..height * width * count).into_par_iter();
    let all = all.map(|_| Seen::Nothing).collect();
    Array3::from_shape_vec((height, width, count), all).expect("one for each sample")
}

/// Integrates each sample's path.
fn trace_exact(
    samples: &PixelSamples<'_>,
    tracer: &ExactTracer<'_>,
    watch: Watch<'_>,
) -> TracedSamples {
    let (width, height) = samples.view.size;
    let count = samples.offsets.len();
    let mut outcomes = Outcomes::from_elem((height, width, count), Seen::Nothing);
    outcomes
        .axis_iter_mut(Axis(0))
        .into_par_iter()
        .enumerate()
        .for_each(|(y, mut row)| {
            if !watch(0) {
                return;
            }
            let places = (0..width * count).map(|i| (y, i / count, i % count));
            let places: Vec<SamplePlace> = places.filter(|p| samples.shows(*p)).collect();
            for ((_, x, k), seen) in trace_each(samples, tracer, &places) {
                row[(x, k)] = seen;
            }
            watch(width * count);
        });
    let work = FrameStatistics {
        traced: outcomes.len(),
        ..FrameStatistics::default()
    };
    TracedSamples {
        outcomes,
        flagged: Vec::new(),
        work,
    }
}

/// Works on all of the largest tiles, then on the samples that were put off.
fn trace_tiles(
    samples: &PixelSamples<'_>,
    tracer: &dyn GridTracer,
    watch: Watch<'_>,
    work_on: impl Fn(&mut TileScratch<'_>, &mut TileOutcomes<'_>) + Sync,
) -> TracedSamples {
    let (width, height) = samples.view.size;
    let mut outcomes = nothing((height, width, samples.offsets.len()));
    let mut tiles = TileOutcomes::split(&mut outcomes);
    // One by one: a few tiles take as long as many others, and they stand together. Those in the middle
    // first: there is most often what a camera looks at, and a slow tile at the end keeps one thread alone.
    let mut order: Vec<&mut TileOutcomes<'_>> = tiles
        .iter_mut()
        .filter(|tile| samples.shows_some(tile.tile()))
        .collect();
    order.sort_by_key(|tile| tile.tile().squared_distance((width / 2, height / 2)));
    order.into_iter().par_bridge().for_each_init(
        || TileScratch::new(&samples.world.manifold, tracer.knots()),
        |scratch, tile| {
            if watch(0) {
                work_on(scratch, tile);
                watch(tile.outcomes.len());
            }
        },
    );
    let mut work = FrameStatistics::default();
    let mut pending = Vec::new();
    for tile in tiles {
        work += tile.work;
        pending.extend(tile.pending);
    }
    // The samples that the tracer could not give, those among them whose paths it could not go on with.
    let began = (samples.clock)();
    let restarts = tracer.restarts();
    if let Some(restarts) = restarts {
        pending.extend(restarts.go_on(samples, tracer, &mut outcomes));
    }
    // Paths so long are integrated where they lie in the glued space, not far out in its cover.
    let glued = restarts.map(|restarts| {
        let (manifold, u) = (&samples.world.manifold, samples.view.u);
        let tolerance = tracer.fallback().map_or(TOLERANCE, ExactTracer::tolerance);
        ExactTracer::new(manifold, u, restarts.length(), tolerance)
    });
    work.pending = pending.len();
    let mut flagged = Vec::new();
    if let Some(tracer) = glued.as_ref().or(tracer.fallback()) {
        for (place, seen) in trace_pending(samples, tracer, watch, &pending) {
            outcomes[place] = seen;
            flagged.push(place);
        }
    }
    work.pending_time = (samples.clock)().saturating_sub(began);
    TracedSamples {
        outcomes,
        flagged,
        work,
    }
}

/// Rays given to one thread at once: enough to keep its lanes full.
const BLOCK: usize = 256;

/// Integrates the samples that were put off, in blocks.
fn trace_pending(
    samples: &PixelSamples<'_>,
    tracer: &ExactTracer<'_>,
    watch: Watch<'_>,
    pending: &[SamplePlace],
) -> Vec<(SamplePlace, Seen)> {
    let blocks = pending.par_chunks(BLOCK).filter(|_| watch(0));
    blocks
        .flat_map(|places| trace_each(samples, tracer, places))
        .collect()
}

/// Integrates the paths of samples from where they start; those that start nowhere are left out.
pub(super) fn trace_each(
    samples: &PixelSamples<'_>,
    tracer: &ExactTracer<'_>,
    places: &[SamplePlace],
) -> Vec<(SamplePlace, Seen)> {
    let world = samples.world;
    let points = places.iter().map(|place| samples.point(*place));
    let starts = starts(&world.manifold, samples.view, points);
    let known = places.iter().zip(starts);
    let (places, starts): (Vec<SamplePlace>, Vec<_>) = known
        .filter_map(|(place, start)| start.map(|start| (*place, (start.u, start.v))))
        .unzip();
    let seen = seen_from(world, tracer, &starts);
    places.into_iter().zip(seen).collect()
}
