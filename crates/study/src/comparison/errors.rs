//! The errors of a view: of the table's paths and of the skies.
//!
//! In: a world, a view, a table, and what was seen. Out: angles at the camera, mrad.

use crate::comparison::CompareOptions;
use geofan_bundle::{
    Fan, PathCoefficients, Table,
    measure::{Probed, probe, settings},
};
use geofan_core::quantiles::Quantiles;
use geofan_render::{frame::Outcomes, intersect::Seen, view::View, world::World};
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
