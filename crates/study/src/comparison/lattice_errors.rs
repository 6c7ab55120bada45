//! The errors of the lattice: what interpolation between paths adds to those of the paths.
//!
//! In: a world, a view, a tracer and the lattice's budget. Out: [`LatticeErrors`]: angles at the camera by which a
//! pixel's path misses the one that the tracer has there, as seen. Pixels that see another exit or another object are left
//! out: an edge between pixels moves by less than a pixel there, and no angle tells by how much. Edges of one object
//! before itself, and places where light turns back, are told from errors by displacing the pixel: where the tracer's own picture
//! jumps as far within [`BEYOND`] budgets, the lattice has moved an edge, and by no more than that.

use geofan_core::quantiles::Quantiles;
use geofan_render::{
    TileScratch,
    frame::{Outcomes, Paths, offsets, trace},
    intersect::Seen,
    lattice::seen_angle,
    no_clock,
    tiles::{PixelSamples, SamplePlace, TileOutcomes},
    tracer::GridTracer,
    view::View,
    world::World,
};
use glam::{DVec2, DVec3};
use ndarray::Array2;
use rayon::prelude::*;

/// Number of budgets beyond which a pixel counts as missed: what fewer do is still less than two pixels of a usual picture.
const BEYOND: f64 = 4.0;

/// Share of an error that the picture must change by within [`BEYOND`] budgets to be an edge there. Where it changes evenly it does
/// so only for errors up to 4/3 of them.
const JUMP: f64 = 0.75;

/// Places around a pixel where its picture is looked at: so many at half of the distance, and as many at all of it.
const AROUND: usize = 8;

/// The errors of the lattice of a view.
pub(super) struct LatticeErrors {
    /// Of all pixels whose error is known, mrad.
    pub mrad: Quantiles,
    /// Share of those that are off by more than [`BEYOND`] budgets, but for edges.
    pub beyond: f64,
    /// Share of those that are off by more, at edges.
    pub edges: f64,
    /// The error of each pixel, mrad; NaN where it is not known.
    pub map: Array2<f32>,
}

/// Measures the errors of the lattice at the middle of every pixel.
pub(super) fn lattice_errors(
    world: &World,
    view: &View,
    tracer: &dyn GridTracer,
    budget: f64,
) -> LatticeErrors {
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
    let limit = BEYOND * budget;
    let missed = (0..all.len()).filter(|i| all[*i].is_some_and(|e| e > 1e3 * limit));
    let missed: Vec<(usize, usize)> = missed.map(|i| (i / width, i % width)).collect();
    let edges = both.edges(tracer, &missed, limit);
    let mut errors: Vec<f64> = all.into_iter().flatten().collect();
    let share = |count: usize| count as f64 / errors.len().max(1) as f64;
    LatticeErrors {
        beyond: share(missed.len() - edges),
        edges: share(edges),
        mrad: Quantiles::of(&mut errors),
        map,
    }
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
            along: DVec3::ZERO,
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
