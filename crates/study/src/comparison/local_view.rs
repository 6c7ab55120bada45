//! The local view against the exact one: pictures, and the error by distance.
//!
//! In: a world and a view. Out: both pictures, their PSNR and FLIP, and by distance the angle between
//! where the local view puts a point and where it is seen.

use super::Comparison;
use crate::picture::{DEFAULT_PIXELS_PER_DEGREE, error_picture, flip, mean_flip, psnr};
use geofan_core::{
    error::{Error, Result},
    quantiles::Quantiles,
};
use geofan_render::{
    drawing::draw,
    frame::{Outcomes, Paths, offsets},
    intersect::Seen,
    local::projection,
    shade::Footprints,
    tracer::ExactTracer,
    view::View,
    world::World,
};
use serde::Serialize;
use std::{collections::BTreeMap, fmt};

/// Tells the errors of the local view at a distance.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct DistanceErrors {
    /// Arc lengths from this to twice this.
    pub from: f64,
    /// Number of pixels that show something there.
    pub pixels: usize,
    /// Angle between where the local view puts it and where it is seen, mrad.
    pub mrad: Quantiles,
    /// Median of that angle over the arc length: equal at all distances where the error is of first
    /// order.
    pub mrad_per_length: f64,
}

/// Tells the outcome of a comparison of the local view.
#[derive(Debug, Clone, Serialize)]
pub struct LocalReport {
    /// PSNR of the local picture against the exact one, dB; `None` if they are equal.
    pub psnr: Option<f64>,
    /// Mean FLIP of the two.
    pub flip: f64,
    /// Time of the local picture without shading, seconds.
    pub local: f64,
    /// Time of the exact one.
    pub exact: f64,
    /// The errors, nearest first.
    pub distances: Vec<DistanceErrors>,
}

/// Compares the local view with the exact one, light followed over `length`. The comparison has the
/// pictures `local`, `exact` and `error` (FLIP).
///
/// # Errors
/// Rays of the view start elsewhere than at its camera, so that nothing has one direction from there.
pub fn compare_local(
    world: &World,
    view: &View,
    samples: usize,
    length: f64,
    tolerance: f64,
) -> Result<Comparison<LocalReport>> {
    if !view.is_central() {
        let message = "errors are told as angles at the camera, and rays of an orthographic picture, or of an eye that sees all around, start elsewhere";
        return Err(Error::input("the camera", message));
    }
    let tracer = ExactTracer::new(&world.manifold, view.u, length, tolerance);
    let by = |paths: Paths<'_>| {
        draw(
            world,
            view,
            paths,
            samples,
            Footprints::Filtered,
            &crate::clock,
        )
    };
    let (local, exact) = (by(Paths::Straight(length)), by(Paths::Exact(&tracer)));
    let flip = flip(&exact.picture, &local.picture, DEFAULT_PIXELS_PER_DEGREE)?;
    let psnr = psnr(&exact.picture, &local.picture)?;
    let report = LocalReport {
        psnr: psnr.is_finite().then_some(psnr),
        flip: mean_flip(&flip),
        local: local.paths.as_secs_f64(),
        exact: exact.paths.as_secs_f64(),
        distances: distance_errors(world, view, samples, &exact.outcomes),
    };
    let error = error_picture(&flip, "FLIP", "local against exact");
    Ok(Comparison {
        report,
        flip,
        pictures: vec![
            ("local", local.picture),
            ("exact", exact.picture),
            ("error", error),
        ],
    })
}

/// Measures by distance how far the local view puts the points that the exact one shows from where
/// they are seen.
fn distance_errors(
    world: &World,
    view: &View,
    samples: usize,
    exact: &Outcomes,
) -> Vec<DistanceErrors> {
    // Angles and their rates, by the octave of the distance.
    let mut errors: BTreeMap<i32, Vec<(f64, f64)>> = BTreeMap::new();
    let offset = offsets(samples)[0];
    for ((y, x, k), seen) in exact.indexed_iter() {
        if let (0, Seen::Surface(hit)) = (k, *seen) {
            let p = projection(world, view, world.point(&hit));
            let seen = view.direction(x as f64 + offset.x, y as f64 + offset.y);
            let put = (view.camera().rotation * p).normalize_or_zero();
            let angle = 1e3 * seen.cross(put).length().atan2(seen.dot(put));
            let octave = hit.s.log2().floor() as i32;
            errors
                .entry(octave)
                .or_default()
                .push((angle, angle / f64::from(hit.s)));
        }
    }
    let at_distance = |(octave, errors): (i32, Vec<(f64, f64)>)| {
        let (mut angles, mut rates): (Vec<f64>, Vec<f64>) = errors.into_iter().unzip();
        DistanceErrors {
            from: 2.0_f64.powi(octave),
            pixels: angles.len(),
            mrad: Quantiles::of(&mut angles),
            mrad_per_length: Quantiles::of(&mut rates).p50,
        }
    };
    errors.into_iter().map(at_distance).collect()
}

impl fmt::Display for LocalReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.psnr {
            Some(psnr) => writeln!(f, "PSNR {psnr:.1} dB, FLIP {:.5}", self.flip)?,
            None => writeln!(f, "PSNR infinite: the pictures are equal")?,
        }
        writeln!(
            f,
            "local {:.1} ms, exact {:.1} ms",
            1e3 * self.local,
            1e3 * self.exact
        )?;
        writeln!(
            f,
            "distance          pixels  error, mrad (p50 / p99)  over distance"
        )?;
        for d in &self.distances {
            writeln!(
                f,
                "{:7.3} to {:7.3} {:7}  {:9.2} / {:9.2}    {:8.2}",
                d.from,
                2.0 * d.from,
                d.pixels,
                d.mrad.p50,
                d.mrad.p99,
                d.mrad_per_length
            )?;
        }
        Ok(())
    }
}
