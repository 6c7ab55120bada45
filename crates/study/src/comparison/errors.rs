//! The errors of a view: of the table's paths, of the lattice between them, and of the skies.
//!
//! In: a world, a view, a table, and what was seen. Out: angles at the camera, mrad.

use crate::comparison::CompareOptions;
use geofan_bundle::{
    Fan, PathCoefficients, Table,
    measure::{Probed, probe, settings},
};
use geofan_core::quantiles::Quantiles;
use geofan_render::{
    frame::{Outcomes, Paths, offsets, trace},
    intersect::Seen,
    lattice::seen_angle,
    tracer::GridTracer,
    view::View,
    world::World,
};
use glam::DVec3;
use ndarray::Array2;
use rayon::prelude::*;

/// Measures the angles between sky directions of samples that leave through the same exit, mrad; of exits behind which
/// all directions show the same, as horizons do, there is nothing to measure.
pub(super) fn sky_errors(world: &World, a: &Outcomes, b: &Outcomes) -> Quantiles {
    let angle = |(a, b): (&Seen, &Seen)| match (*a, *b) {
        (
            Seen::Sky {
                exit, direction, ..
            },
            Seen::Sky {
                exit: other,
                direction: d,
                ..
            },
        ) if exit == other && !world.has_one_colour(exit as usize) => {
            Some(1e3 * f64::from((direction - d).length()))
        }
        _ => None,
    };
    let mut angles: Vec<f64> = a.iter().zip(b).filter_map(angle).collect();
    Quantiles::of(&mut angles)
}

/// Measures the angles at the camera, mrad, by which the lattice at the middle of every pixel misses the path
/// that the table has there: of the sky's direction or of the point met. Pixels that see another
/// exit or another object are left out: an edge between pixels moves by less than a pixel there, and
/// no angle tells by how much. Beside them, the share of those measured that are off by more than four budgets.
pub(super) fn lattice_errors(
    world: &World,
    view: &View,
    tracer: &dyn GridTracer,
    budget: f64,
) -> (Quantiles, f64) {
    // Both as they are seen at every pixel.
    let offsets = offsets(1);
    let by = |paths| trace(world, view, paths, &offsets).outcomes;
    let direct = by(Paths::Direct(tracer));
    let lattice = by(Paths::Lattice(tracer, budget));
    let (width, height) = view.size;
    let mut errors: Vec<f64> = (0..height * width)
        .into_par_iter()
        .filter_map(|i| {
            let (y, x) = (i / width, i % width);
            let here = position(world, &direct[(y, x, 0)])?;
            let found = position(world, &lattice[(y, x, 0)])?;
            // A step to the next pixel tells how a displacement shows.
            let change = |y: usize, x: usize, sign: f64| {
                let there = position(world, direct.get((y, x, 0))?)?;
                (there.kind == here.kind)
                    .then(|| (there.at - here.at) * (sign / view.pixel_angle()))
            };
            let right = change(y, x + 1, 1.0).or_else(|| change(y, x.checked_sub(1)?, -1.0))?;
            let down = change(y + 1, x, 1.0).or_else(|| change(y.checked_sub(1)?, x, -1.0))?;
            (found.kind == here.kind)
                .then(|| 1e3 * seen_angle(found.at - here.at, [right, down], here.along, here.unit))
        })
        .collect();
    let beyond = errors.iter().filter(|e| **e > BEYOND * 1e3 * budget);
    let beyond = beyond.count() as f64 / errors.len().max(1) as f64;
    (Quantiles::of(&mut errors), beyond)
}

/// Number of budgets beyond which a pixel counts as missed: what fewer do is still less than two pixels of a usual picture.
const BEYOND: f64 = 4.0;

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

/// Computes the exact state where the ray through the middle of every pixel ends (surfaces left out: paths
/// go on behind them), row by row.
pub(super) fn probe_pixels(
    world: &World,
    view: &View,
    table: &Table,
    options: CompareOptions,
) -> Vec<Probed> {
    let (width, height) = view.size;
    // A table holds the paths of the space that covers a glued one.
    let cover = &world.cover;
    let rows: Vec<Vec<Probed>> = (0..height)
        .into_par_iter()
        .map(|y| {
            let rays: Vec<(DVec3, DVec3)> =
                (0..width).map(|x| (view.u, middle(view, x, y))).collect();
            let tolerance = options.tolerance;
            probe(cover, settings(tolerance), table.length, &rays, |_, end| {
                vec![end]
            })
        })
        .collect();
    rows.into_iter().flatten().collect()
}

/// Returns the direction through the middle of a pixel.
pub(super) fn middle(view: &View, x: usize, y: usize) -> DVec3 {
    view.direction(x as f64 + 0.5, y as f64 + 0.5)
}

/// Measures the table's error at every pixel, (mrad, screen mrad); `None` where it gives up or nothing
/// is known.
pub(super) fn table_errors(fan: &Fan, view: &View, probed: &[Probed]) -> Vec<Option<(f64, f64)>> {
    let width = view.size.0;
    probed
        .par_iter()
        .enumerate()
        .map(|(i, probed)| {
            let probe = probed.probes.first()?;
            // As the renderer looks it up.
            let mut coefficients = PathCoefficients::default();
            let number = fan.add(
                fan.locate(middle(view, i % width, i / width)),
                &mut coefficients,
            );
            let path = fan.among(&coefficients, number);
            if path.flagged_from() < probe.s {
                return None;
            }
            let deviation = probe.deviation(path.at(probe.s)?.0, None);
            Some((deviation.mrad, deviation.screen_mrad))
        })
        .collect()
}

/// Returns the quantiles of both errors of [`table_errors`].
pub(super) fn quantiles(errors: &[Option<(f64, f64)>]) -> [Quantiles; 2] {
    let of = |pick: fn(&(f64, f64)) -> f64| {
        let mut all: Vec<f64> = errors.iter().flatten().map(pick).collect();
        Quantiles::of(&mut all)
    };
    [of(|e| e.0), of(|e| e.1)]
}

/// Arranges the screen errors as a picture; NaN where there is none.
pub(super) fn screen_map(view: &View, errors: &[Option<(f64, f64)>]) -> Array2<f32> {
    let (width, height) = view.size;
    Array2::from_shape_fn((height, width), |(y, x)| {
        errors[y * width + x].map_or(f32::NAN, |e| e.1 as f32)
    })
}
