//! The numbers of a comparison, as text and for JSON; and times of the table's frames from a moving camera, and of paths
//! alone.
//!
//! In: drawings with their times. Out: [`FrameTimes`], in seconds, and the [`ComparisonReport`].
//!
//! In: a world, a view, tracers. Out: medians, seconds for a frame ([`FrameTimes`]) and nanoseconds for
//! the path of a pixel ([`PathTimes`]), by the clock and on all threads.

use super::{CompareOptions, LatticeErrors};
use geofan_bundle::{Fan, Table};
use geofan_core::{
    error::Result,
    geodesic::{Ray, Settings, UnfinishedPaths, ends},
    quantiles::Quantiles,
};
use geofan_render::{
    drawing::{Drawing, draw},
    endings::EventLocator,
    frame::{FrameStatistics, Paths},
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
use serde::Serialize;
use std::{fmt, time::Instant};

/// Tells the times of one tracer's frame, seconds by the clock. `lattice`, `tiles` and `pixels` overlap on
/// several threads: they are the shares of the time for paths that threads spent on each.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct FrameTimes {
    /// Fixing the camera: contraction of the table; zero for integrators.
    pub contract: f64,
    /// Paths of the lattice, and dividing tiles.
    pub lattice: f64,
    /// Tubes and chords.
    pub tiles: f64,
    /// Samples: their paths, and what they meet.
    pub pixels: f64,
    /// Rays that the table gave up on, integrated.
    pub pending: f64,
    /// Colours and the pixel filter.
    pub shade: f64,
    /// All of it.
    pub frame: f64,
}

/// Splits the time of a drawing.
pub(super) fn times_of(drawing: &Drawing) -> FrameTimes {
    // Threads' times of the steps of paths, which overlap.
    let work = &drawing.work;
    let pending = work.pending_time.as_secs_f64();
    let paths = drawing.paths.as_secs_f64();
    let [lattice, tiles, pixels] = [work.lattice, work.tiles, work.pixels].map(|t| t.as_secs_f64());
    let threads = lattice + tiles + pixels;
    // Tracers without steps of their own spend all of it on samples.
    let share = |part: f64| match threads > 0.0 {
        true => (paths - pending) * part / threads,
        false => 0.0,
    };
    let shade = drawing.shade.as_secs_f64();
    FrameTimes {
        contract: 0.0,
        lattice: share(lattice),
        tiles: share(tiles),
        pixels: if threads > 0.0 { share(pixels) } else { paths },
        pending,
        shade,
        frame: paths + shade,
    }
}

/// Takes the median of each step's times; of the whole frame's too, so steps need not add up to it.
pub(super) fn median_times(all: impl Iterator<Item = FrameTimes>) -> FrameTimes {
    let all: Vec<FrameTimes> = all.collect();
    let middle = |pick: fn(&FrameTimes) -> f64| {
        let mut values: Vec<f64> = all.iter().map(pick).collect();
        Quantiles::of(&mut values).p50
    };
    FrameTimes {
        contract: middle(|t| t.contract),
        lattice: middle(|t| t.lattice),
        tiles: middle(|t| t.tiles),
        pixels: middle(|t| t.pixels),
        pending: middle(|t| t.pending),
        shade: middle(|t| t.shade),
        frame: middle(|t| t.frame),
    }
}

/// Describes equal-error exact.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct EqualErrorExact {
    /// Its steps; the most tried if none sufficed.
    pub steps: usize,
    /// Set if its error is no worse than the table's.
    pub equal: bool,
    /// Its screen error.
    pub screen_mrad: Quantiles,
    /// The times of its frame.
    pub times: FrameTimes,
    /// Those of its frame with the lattice, so with the lattice's error too.
    pub lattice_times: FrameTimes,
}

/// Tells the nanoseconds for the path of one pixel.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct PathTimes {
    /// A table's, with the lattice.
    pub table: f64,
    /// A table's, every pixel by itself.
    pub table_without_lattice: f64,
    /// Exact.
    pub exact: f64,
    /// Equal-error exact; `None` where there is no such rival.
    pub equal_error: Option<f64>,
    /// Equal-error exact with the lattice.
    pub equal_error_lattice: Option<f64>,
}

/// Tells the outcome of a comparison.
#[derive(Debug, Clone, Serialize)]
pub struct ComparisonReport {
    /// PSNR of the table's picture against the exact one, dB; `None` if they are equal.
    pub psnr: Option<f64>,
    /// Mean FLIP of the two.
    pub flip: f64,
    /// Error of the table's paths at the middle of every pixel, where its ray ends; `None` if the table gives up on all.
    pub mrad: Option<Quantiles>,
    /// Screen error of the table's paths.
    pub screen_mrad: Option<Quantiles>,
    /// What the lattice adds to the errors of the table's paths.
    #[serde(flatten)]
    pub lattice_errors: LatticeErrors,
    /// Angle between the directions in which the two pictures' samples look up the same sky; `None` if none does.
    pub sky_mrad: Option<Quantiles>,
    /// Share of pixels of which the error of the table's path is known.
    pub compared: f64,
    /// Share of samples that the table gave up on.
    pub flagged: f64,
    /// Paths of the exact picture that end by their length or where the metric ends.
    pub unfinished: UnfinishedPaths,
    /// The table's frame: medians over a moving camera.
    pub table: FrameTimes,
    /// The exact frame.
    pub exact: FrameTimes,
    /// Equal-error exact; `None` where no error of the table is known.
    pub equal_error: Option<EqualErrorExact>,
    /// Paths alone.
    pub paths_ns: PathTimes,
    /// The work of the lattice.
    pub lattice: FrameStatistics,
    /// Exact frame over table frame.
    pub speedup: f64,
    /// Equal-error frame over table frame; `None` where no rival is as exact as the table.
    pub speedup_equal_error: Option<f64>,
    /// Frame of equal-error exact with the lattice over table frame, likewise.
    pub speedup_equal_error_lattice: Option<f64>,
}

impl fmt::Display for ComparisonReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.differences(f)?;
        self.frames(f)?;
        let p = &self.paths_ns;
        write!(
            f,
            "paths, ns a pixel    table {:.0} (without lattice {:.0}), exact {:.0}",
            p.table, p.table_without_lattice, p.exact
        )?;
        if let Some((each, lattice)) = p.equal_error.zip(p.equal_error_lattice) {
            write!(
                f,
                ", equal-error exact {each:.0} (with lattice {lattice:.0})"
            )?;
        }
        write!(
            f,
            "\nthe table's frame is {:.1} times faster than exact",
            self.speedup
        )?;
        let rival = self
            .speedup_equal_error
            .zip(self.speedup_equal_error_lattice);
        match rival {
            Some((each, lattice)) => writeln!(
                f,
                ", {each:.1} times than equal-error exact, {lattice:.1} times than that with a lattice"
            ),
            None if self.equal_error.is_some() => writeln!(
                f,
                "; no number of equal steps that was tried is as exact as the table"
            ),
            None => writeln!(f, "; the table holds no path of this view"),
        }
    }
}

impl ComparisonReport {
    /// Writes how far the pictures are apart.
    fn differences(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.psnr {
            Some(psnr) => writeln!(
                f,
                "PSNR                 {psnr:.1} dB, FLIP {:.5}",
                self.flip
            )?,
            None => writeln!(f, "PSNR                 infinite: the pictures are equal")?,
        }
        let rows = [
            ("error, mrad", self.mrad),
            ("screen error, mrad", self.screen_mrad),
            ("sky direction, mrad", self.sky_mrad),
        ];
        for (name, q) in rows {
            match q {
                Some(q) => writeln!(f, "{name:20} {}", Row(q))?,
                None => writeln!(f, "{name:20} nothing to compare")?,
            }
        }
        write!(f, "{}", self.lattice_errors)?;
        writeln!(
            f,
            "compared             {:.2} % of pixels",
            1e2 * self.compared
        )?;
        let flagged = 1e2 * self.flagged;
        writeln!(
            f,
            "given up by table    {flagged:.2} % of samples, integrated instead"
        )?;
        writeln!(f, "ends of paths        {}", self.unfinished)
    }

    /// Writes a line for each frame.
    fn frames(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let equal = |rival: EqualErrorExact| match rival.equal {
            true => "",
            false => ", still worse than the table",
        };
        let rival = self.equal_error.into_iter().flat_map(|rival| {
            let name = format!("equal-error exact ({} steps{})", rival.steps, equal(rival));
            let with_lattice = "the same with a lattice".to_string();
            [(name, rival.times), (with_lattice, rival.lattice_times)]
        });
        let rows = [
            ("table".to_string(), self.table),
            ("exact".to_string(), self.exact),
        ];
        let rows = rows.into_iter().chain(rival);
        for (name, t) in rows {
            let [frame, contract, lattice, tiles, pixels, pending, shade] = [
                t.frame, t.contract, t.lattice, t.tiles, t.pixels, t.pending, t.shade,
            ]
            .map(|s| 1e3 * s);
            writeln!(
                f,
                "frame {frame:8.1} ms  = contract {contract:.1} + lattice {lattice:.1} + tiles {tiles:.1} + pixels {pixels:.1} + given up {pending:.1} + shade {shade:.1}: {name}"
            )?;
        }
        Ok(())
    }
}

/// Writes quantiles in a row.
pub(super) struct Row(pub Quantiles);

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Quantiles { p50, p95, p99, max } = self.0;
        write!(
            f,
            "{p50:.3} / {p95:.3} / {p99:.3} / {max:.3} (p50 / p95 / p99 / max)"
        )
    }
}

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
        fan.prepare(&here.spread());
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
        let mut times = times_of(&drawing);
        times.contract = contract.as_secs_f64();
        times.frame += times.contract;
        all.push(times);
    }
    Ok(median_times(all.into_iter()))
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
    (lookup, fan, exact, rival): (
        &Lookup<'_>,
        &Fan,
        &ExactTracer<'_>,
        Option<&FixedTracer<'_>>,
    ),
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
        equal_error: rival.map(|rival| direct_time(world, view, rival)),
        equal_error_lattice: rival.map(|rival| median(|| lattice_time(world, view, rival, budget))),
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
    let mut undivided = lattice.undivided(corner);
    while !undivided.is_empty() {
        divide_some(lattice, &mut undivided, scratch);
    }
}

/// Finds the paths of tiles that are divided together.
fn divide_some(lattice: &Lattice<'_>, undivided: &mut Vec<Tile>, scratch: &mut TileScratch<'_>) {
    let spare = scratch.paths.take();
    let divided = lattice.refine(undivided, spare, &mut scratch.events);
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
