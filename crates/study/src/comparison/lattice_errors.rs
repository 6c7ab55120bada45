//! The errors of the lattice: what interpolation between paths adds to those of the paths.
//!
//! In: a world, a view, a tracer and the lattice's budget. Out: [`LatticeErrors`]: angles at the camera by which a
//! pixel's path misses the one that the tracer has there, as seen. Pixels that see another exit or another object are left
//! out: an edge between pixels moves by less than a pixel there, and no angle tells by how much. Edges of one object
//! before itself, and places where light turns back, are told from errors by displacing the pixel: where the tracer's own picture
//! jumps as far within [`EDGE`] budgets, the lattice has moved an edge, and by no more than that.

use super::{CompareOptions, comparison_report::Row};
use crate::picture::error_picture;
use geofan_bundle::Table;
use geofan_core::{error::Result, quantiles::Quantiles};
use geofan_render::{
    Lookup, TileScratch,
    frame::{Outcomes, Paths, offsets, trace},
    intersect::Seen,
    lattice::seen_angle,
    no_clock,
    picture::Picture,
    tiles::{PixelSamples, SamplePlace, TileOutcomes},
    tracer::GridTracer,
    view::View,
    world::World,
};
use glam::{DVec2, DVec3};
use ndarray::Array2;
use rayon::prelude::*;
use serde::Serialize;
use std::fmt;

/// Number of budgets beyond which a pixel counts as missed: what fewer do is still less than two pixels of a usual picture.
const BEYOND: f64 = 4.0;

/// Number of budgets within which the picture must jump for an error to be one of an edge, and the share of the error that it
/// must jump by: where it changes evenly, an error of [`BEYOND`] budgets is twice as large as its changes there.
const EDGE: f64 = 2.0;
const JUMP: f64 = 0.75;

/// Places around a pixel where its picture is looked at: so many at half of the distance, and as many at all of it.
const AROUND: usize = 8;

/// Tells the errors that the lattice of a view adds to those of its paths.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct LatticeErrors {
    /// Of all pixels whose error is known, as seen.
    pub lattice_mrad: Quantiles,
    /// Share of those to whose error the lattice adds more than four times its budget, but for those at edges.
    pub lattice_beyond: f64,
    /// Share of those at edges: there the picture itself jumps as far within two budgets.
    pub lattice_edges: f64,
}

impl fmt::Display for LatticeErrors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "lattice adds, mrad   {}", Row(self.lattice_mrad))?;
        let [beyond, edges] = [self.lattice_beyond, self.lattice_edges].map(|share| 1e2 * share);
        writeln!(
            f,
            "lattice off by more  {beyond:.4} % of pixels, than four times its budget; beside edges {edges:.4} %"
        )
    }
}

/// Measures only the errors of the lattice of a view by a table; the picture shows them.
///
/// # Errors
/// As [`super::compare`].
pub fn compare_lattice(
    world: &World,
    view: &View,
    table: &Table,
    options: CompareOptions,
) -> Result<(LatticeErrors, Picture)> {
    super::refuse_many_positions(view)?;
    let lookup = Lookup::new(table, 1e-3 * options.promise, options.tolerance);
    let fan = table.fan(view.u)?;
    let (errors, map) = lattice_errors(world, view, &lookup.tracer(&fan), 1e-3 * options.error);
    Ok((errors, lattice_picture(&map)))
}

/// Draws the errors of the lattice.
pub(super) fn lattice_picture(map: &Array2<f32>) -> Picture {
    error_picture(map, "mrad", "error of the lattice")
}

/// Measures the errors of the lattice at the middle of every pixel; also that of each, mrad, not a number where it is not known.
pub(super) fn lattice_errors(
    world: &World,
    view: &View,
    tracer: &dyn GridTracer,
    budget: f64,
) -> (LatticeErrors, Array2<f32>) {
    // Both as they are seen at every pixel.
    let offsets = offsets(1);
    let by = |paths| trace(world, view, paths, &offsets).outcomes;
    let both = Both {
        world,
        view,
        direct: by(Paths::Direct(tracer)),
        lattice: by(Paths::Lattice(tracer, budget)),
    };
    let (width, height) = view.size;
    let all: Vec<Option<f64>> = (0..height * width)
        .into_par_iter()
        .map(|i| both.error((i / width, i % width)))
        .collect();
    let map = Array2::from_shape_fn((height, width), |(y, x)| {
        all[y * width + x].map_or(f32::NAN, |e| e as f32)
    });
    let missed = (0..all.len()).filter(|i| all[*i].is_some_and(|e| e > 1e3 * BEYOND * budget));
    let missed: Vec<(usize, usize)> = missed.map(|i| (i / width, i % width)).collect();
    let edges = both.edges(tracer, &missed, EDGE * budget);
    let mut errors: Vec<f64> = all.into_iter().flatten().collect();
    let share = |count: usize| count as f64 / errors.len().max(1) as f64;
    let found = LatticeErrors {
        lattice_beyond: share(missed.len() - edges),
        lattice_edges: share(edges),
        lattice_mrad: Quantiles::of(&mut errors),
    };
    (found, map)
}

/// What every pixel sees by the tracer and by the lattice.
struct Both<'a> {
    world: &'a World,
    view: &'a View,
    direct: Outcomes,
    lattice: Outcomes,
}

impl Both<'_> {
    /// Returns the error at the pixel in row `y` and column `x`, mrad.
    fn error(&self, (y, x): (usize, usize)) -> Option<f64> {
        let [here, found] = self.seen((y, x))?;
        // A step to the next pixel tells how a displacement shows.
        let change = |y: usize, x: usize, sign: f64| {
            let there = position(self.world, self.direct.get((y, x, 0))?)?;
            (there.kind == here.kind)
                .then(|| (there.at - here.at) * (sign / self.view.pixel_angle()))
        };
        let right = change(y, x + 1, 1.0).or_else(|| change(y, x.checked_sub(1)?, -1.0))?;
        let down = change(y + 1, x, 1.0).or_else(|| change(y.checked_sub(1)?, x, -1.0))?;
        let angle = seen_angle(found.at - here.at, [right, down], here.along, here.unit);
        Some(1e3 * angle)
    }

    /// Returns what a pixel sees by the tracer and by the lattice, if both are of one kind.
    fn seen(&self, (y, x): (usize, usize)) -> Option<[SeenPlace; 2]> {
        let here = position(self.world, &self.direct[(y, x, 0)])?;
        let found = position(self.world, &self.lattice[(y, x, 0)])?;
        (found.kind == here.kind).then_some([here, found])
    }

    /// Counts those of the pixels within whose distance `limit`, radians, the tracer's picture jumps as far as the lattice is off.
    fn edges(&self, tracer: &dyn GridTracer, pixels: &[(usize, usize)], limit: f64) -> usize {
        let far = limit / self.view.pixel_angle();
        let around = (0..2 * AROUND).map(|k| {
            let angle = std::f64::consts::TAU * k as f64 / AROUND as f64;
            let distance = if k < AROUND { far } else { 0.5 * far };
            DVec2::splat(0.5) + distance * DVec2::from_angle(angle)
        });
        let around: Vec<DVec2> = around.collect();
        let samples = PixelSamples {
            world: self.world,
            view: self.view,
            offsets: &around,
            clock: &no_clock,
        };
        let mut scratch = TileScratch::new(&self.world.manifold, tracer.knots());
        let is_edge = |pixel: &&(usize, usize)| {
            let (y, x) = **pixel;
            let mut outcomes = Outcomes::default((1, 1, around.len()));
            let mut tile = TileOutcomes::new((y, x), outcomes.view_mut());
            let places: Vec<SamplePlace> = (0..around.len()).map(|k| (y, x, k)).collect();
            samples.trace(&places, tracer, &mut scratch, &mut tile);
            self.jumps((y, x), outcomes.iter())
        };
        pixels.iter().filter(is_edge).count()
    }

    /// Tells whether any of what is seen around a pixel is as far away as the lattice is off, and on that side.
    fn jumps<'s>(&self, pixel: (usize, usize), mut around: impl Iterator<Item = &'s Seen>) -> bool {
        let Some([here, found]) = self.seen(pixel) else {
            return false;
        };
        let error = found.at - here.at;
        let jump = |seen: &Seen| match position(self.world, seen) {
            Some(there) if there.kind == here.kind => {
                (there.at - here.at).dot(error) >= JUMP * error.length_squared()
            }
            _ => false,
        };
        around.any(jump)
    }
}

/// Gives what a sample sees as a vector that can be compared with another's.
struct SeenPlace {
    /// Sky by exit, or surface by object.
    kind: (bool, u32),
    at: DVec3,
    /// The direction in which displacements do not show.
    along: DVec3,
    /// The distance by which one radian moves it in flat space.
    unit: f64,
}

fn position(world: &World, seen: &Seen) -> Option<SeenPlace> {
    match *seen {
        Seen::Sky {
            exit, direction, ..
        } if !world.has_one_colour(exit as usize) => Some(SeenPlace {
            kind: (true, exit),
            at: direction.as_dvec3(),
            // The step to the next pixel is a chord: what it misses the sphere by does not show.
            along: direction.as_dvec3(),
            unit: 1.0,
        }),
        Seen::Surface(hit) => {
            let v = hit.v.as_dvec3();
            Some(SeenPlace {
                kind: (false, world.faces[hit.triangle as usize].object),
                at: world.point(&hit),
                along: v.normalize_or_zero(),
                unit: f64::from(hit.s) * v.length(),
            })
        }
        Seen::Sky { .. } | Seen::Nothing | Seen::Length | Seen::Singular => None,
    }
}
