//! Times of the table's frames from a moving camera, and of paths alone.
//!
//! In: a world, a view, tracers. Out: medians, seconds for a frame ([`FrameTimes`]) and nanoseconds for
//! the path of a pixel ([`PathTimes`]), by the clock and on all threads.

use crate::comparison::{CompareOptions, FrameTimes, PathTimes, comparison_report};
use geofan_bundle::{Fan, Table};
use geofan_core::{
    error::Result,
    geodesic::{Ray, Settings, ends},
};
use geofan_render::{
    drawing::draw,
    endings::EventLocator,
    frame::Paths,
    lattice::{Ends, LARGEST_TILE, Lattice, Tile, smallest_tile},
    lookup::Lookup,
    path_batch::PathBatch,
    shade::Footprints,
    tiles::TileScratch,
    tracer::{ExactTracer, FixedTracer, GridTracer},
    view::View,
    world::World,
};
use glam::DVec3;
use rayon::prelude::*;
use std::time::Instant;

/// Distance by which the camera moves from frame to frame, as a share of the table's length of paths:
/// that of a pedestrian.
const STRIDE: f64 = 1e-3;

/// Angle by which it turns from frame to frame, radians.
const TURN: f64 = 0.01;

/// Lists the views of the frames of a camera that walks along its view and turns; where it would leave the table's region
/// it turns only.
pub(super) fn views(world: &World, view: &View, table: &Table, frames: usize) -> Vec<View> {
    let place = |i: usize| {
        let ahead = ahead(world, view, STRIDE * table.length * i as f64);
        let known = ahead.filter(|u| table.space.place(*u).is_ok());
        let u = known.unwrap_or(view.u);
        view.moved(u).turned(TURN * i as f64)
    };
    (0..frames.max(1)).map(place).collect()
}

/// Takes medians of the times of the table's frames of these views.
pub(super) fn moving(
    world: &World,
    views: &[View],
    lookup: &Lookup<'_>,
    options: CompareOptions,
) -> Result<FrameTimes> {
    let mut all = Vec::new();
    for here in views {
        // The camera is fixed anew for each frame.
        let began = Instant::now();
        let fan = lookup.table.fan(here.u)?;
        let contract = began.elapsed();
        let tracer = lookup.tracer(&fan);
        let paths = Paths::Lattice(&tracer, 1e-3 * options.error);
        let drawing = draw(
            world,
            here,
            paths,
            options.samples,
            Footprints::Filtered,
            &crate::clock,
        );
        let mut times = comparison_report::frame_times(&drawing);
        times.contract = contract.as_secs_f64();
        times.frame += times.contract;
        all.push(times);
    }
    Ok(comparison_report::median(all.into_iter()))
}

/// Returns the point `length` along the view's axis; `None` if the path ends before.
fn ahead(world: &World, view: &View, length: f64) -> Option<DVec3> {
    if length == 0.0 {
        return Some(view.u);
    }
    let settings = Settings::bare(1e-8);
    let ray = Ray::new(&world.manifold, view.u, view.look(), length);
    let end = ends(&world.manifold, settings, [ray]).pop()??;
    (end.1 >= length).then(|| end.0.position(length))
}

/// Measures the nanoseconds for the path of each pixel, without what it meets, on all threads. The table's tracer is
/// made anew for each lattice, as for each frame: it learns from the paths that it gives.
pub(super) fn paths(
    world: &World,
    view: &View,
    (lookup, fan, exact, rival): (&Lookup<'_>, &Fan, &ExactTracer<'_>, &FixedTracer<'_>),
    budget: f64,
) -> PathTimes {
    PathTimes {
        table: median(|| lattice_time(world, view, &lookup.tracer(fan), budget)),
        table_without_lattice: direct_time(world, view, &lookup.tracer(fan)),
        exact: row_time(
            view,
            |directions, _| {
                std::hint::black_box(exact.trace(directions));
            },
            world,
        ),
        equal_error: direct_time(world, view, rival),
        equal_error_lattice: median(|| lattice_time(world, view, rival, budget)),
    }
}

/// Rows left out between rows that are measured.
const ROWS: usize = 4;

/// Measures the nanoseconds for each path that a tracer gives by itself.
fn direct_time(world: &World, view: &View, tracer: &dyn GridTracer) -> f64 {
    row_time(
        view,
        |directions, endings| {
            let mut paths = PathBatch::new(tracer.knots().clone());
            tracer.add(directions, endings, &mut paths);
            std::hint::black_box(paths);
        },
        world,
    )
}

/// Measures the nanoseconds for each of the rays through the middles of some rows.
fn row_time(
    view: &View,
    follow: impl Fn(&[DVec3], &mut EventLocator<'_>) + Sync,
    world: &World,
) -> f64 {
    let (width, height) = view.size;
    let rows: Vec<usize> = (0..height).step_by(ROWS).collect();
    let began = Instant::now();
    rows.par_iter().for_each_init(
        || EventLocator::new(&world.manifold),
        |endings, y| {
            let row: Vec<DVec3> = (0..width)
                .map(|x| view.direction(x as f64 + 0.5, *y as f64 + 0.5))
                .collect();
            follow(&row, endings);
        },
    );
    1e9 * began.elapsed().as_secs_f64() / (rows.len() * width) as f64
}

/// Number of times that a lattice is timed: it takes milliseconds, and a single run shows other programs' work.
const REPEATS: usize = 9;

/// Takes the median of several runs.
fn median(time: impl Fn() -> f64) -> f64 {
    let mut times: [f64; REPEATS] = std::array::from_fn(|_| time());
    times.sort_by(f64::total_cmp);
    times[REPEATS / 2]
}

/// Measures the nanoseconds for each pixel of a lattice over the picture; pixels that it loses are traced too.
fn lattice_time(world: &World, view: &View, tracer: &dyn GridTracer, budget: f64) -> f64 {
    let (width, height) = view.size;
    let lattice = Lattice {
        tracer,
        world,
        view,
        budget,
        smallest: smallest_tile(1),
    };
    let corners: Vec<(usize, usize)> = (0..height)
        .step_by(LARGEST_TILE)
        .flat_map(|y| (0..width).step_by(LARGEST_TILE).map(move |x| (x, y)))
        .collect();
    let began = Instant::now();
    corners.iter().par_bridge().for_each_init(
        || TileScratch::new(&world.manifold, tracer.knots()),
        |scratch, corner| divide(&lattice, *corner, scratch),
    );
    1e9 * began.elapsed().as_secs_f64() / (width * height) as f64
}

/// Finds all paths of one of the largest tiles.
fn divide(lattice: &Lattice<'_>, corner: (usize, usize), scratch: &mut TileScratch<'_>) {
    let spare = scratch.paths.take();
    let divided = lattice.refine(corner, spare, &mut scratch.events);
    for tile in &divided.lost {
        scratch.singles.clear();
        let directions = directions(lattice.view, *tile);
        let (endings, singles) = (&mut scratch.events, &mut scratch.singles);
        lattice.tracer.add(&directions, endings, singles);
    }
    for leaf in divided.leaves.iter().filter(|l| l.ends == Ends::Each) {
        let directions = directions(lattice.view, leaf.tile);
        std::hint::black_box(lattice.tracer.endings(&directions, &mut scratch.events));
    }
    std::hint::black_box(&divided);
    scratch.paths = divided.paths;
}

/// Returns the directions through the middles of the pixels of a tile.
fn directions(view: &View, tile: Tile) -> Vec<DVec3> {
    let (rows, columns) = tile.extent(view.size);
    rows.flat_map(|y| columns.clone().map(move |x| (x, y)))
        .map(|(x, y)| view.direction(x as f64 + 0.5, y as f64 + 0.5))
        .collect()
}
