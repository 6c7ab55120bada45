//! The errors of a view: of the table's paths, of the lattice between them, and of the skies.

use crate::comparison::Options;
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
use rayon::prelude::*;

/// Angles between sky directions of samples that leave through the same exit, mrad.
pub(super) fn sky_errors(a: &Outcomes, b: &Outcomes) -> Quantiles {
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
        ) if exit == other => Some(1e3 * f64::from((direction - d).length())),
        _ => None,
    };
    let mut angles: Vec<f64> = a.iter().zip(b).filter_map(angle).collect();
    Quantiles::of(&mut angles)
}

/// Angles at the camera, mrad, by which the lattice at the middle of every pixel misses the path
/// that the table has there: of the sky's direction or of the point met. Pixels that see another
/// exit or another object are left out: an edge between pixels moves by less than a pixel there, and
/// no angle tells by how much.
pub(super) fn lattice_errors(
    world: &World,
    view: &View,
    tracer: &dyn GridTracer,
    budget: f64,
) -> Quantiles {
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
    Quantiles::of(&mut errors)
}

/// What a sample sees, as a vector that can be compared with another's.
struct Position {
    /// Sky by exit, or surface by object.
    kind: (bool, u32),
    at: DVec3,
    /// The direction in which displacements do not show.
    along: DVec3,
    /// What one radian moves it by in flat space.
    unit: f64,
}

fn position(world: &World, seen: &Seen) -> Option<Position> {
    match *seen {
        Seen::Sky {
            exit, direction, ..
        } => Some(Position {
            kind: (true, exit),
            at: direction.as_dvec3(),
            along: DVec3::ZERO,
            unit: 1.0,
        }),
        Seen::Surface(hit) => {
            let v = hit.v.as_dvec3();
            Some(Position {
                kind: (false, world.faces[hit.triangle as usize].object),
                at: world.point(&hit),
                along: v.normalize_or_zero(),
                unit: f64::from(hit.s) * v.length(),
            })
        }
        Seen::Nothing => None,
    }
}

/// The exact state where the ray through the middle of every pixel ends (surfaces left out: paths
/// go on behind them), row by row.
pub(super) fn probe_pixels(
    world: &World,
    view: &View,
    table: &Table,
    options: Options,
) -> Vec<Probed> {
    let (width, height) = view.size;
    let rows: Vec<Vec<Probed>> = (0..height)
        .into_par_iter()
        .map(|y| {
            let rays: Vec<(DVec3, DVec3)> =
                (0..width).map(|x| (view.u, middle(view, x, y))).collect();
            let tolerance = options.tolerance;
            probe(
                &world.manifold,
                settings(tolerance),
                table.length,
                &rays,
                |_, end| vec![end],
            )
        })
        .collect();
    rows.into_iter().flatten().collect()
}

pub(super) fn middle(view: &View, x: usize, y: usize) -> DVec3 {
    view.direction(x as f64 + 0.5, y as f64 + 0.5)
}

/// (mrad, screen mrad) of the table at every pixel; `None` where it gives up or nothing is known.
pub(super) fn table_errors(
    fan: &Fan<'_>,
    view: &View,
    probed: &[Probed],
) -> Vec<Option<(f64, f64)>> {
    let width = view.size.0;
    probed
        .par_iter()
        .enumerate()
        .map(|(i, probed)| {
            let probe = probed.probes.first()?;
            // As the renderer looks it up.
            let mut courses = PathCoefficients::default();
            let number = fan.add(fan.locate(middle(view, i % width, i / width)), &mut courses);
            let path = fan.among(&courses, number);
            if path.flagged_from() < probe.s {
                return None;
            }
            let deviation = probe.deviation(path.at(probe.s)?.0, None);
            Some((deviation.mrad, deviation.screen_mrad))
        })
        .collect()
}
