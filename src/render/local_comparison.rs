//! The local view against the exact one: pictures, and the error by distance.
//!
//! In: a world and a view. Out: both pictures, their PSNR and FLIP, and how far from where it should
//! be the local view puts the points that the exact one shows, by their distance.

use super::{
    drawing::draw,
    frame::{Paths, offsets},
    local::projection,
    outcome::Seen,
    picture::{Picture, flip, flip::DEFAULT_PIXELS_PER_DEGREE, psnr},
    shade::Footprints,
    tracer::ExactTracer,
    view::View,
    world::World,
};
use crate::{
    error::{Error, Result},
    quantiles::Quantiles,
};
use ndarray::Array2;
use serde::Serialize;
use std::{collections::BTreeMap, fmt};

/// Error of the local view of what is at a distance.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct AtDistance {
    /// Arc lengths from this to twice this.
    pub from: f64,
    /// How many pixels show something there.
    pub pixels: usize,
    /// Angle between where the local view puts it and where it is seen, mrad.
    pub mrad: Quantiles,
    /// Median of that angle over the arc length: the same at all distances where the error is of
    /// first order.
    pub mrad_per_length: f64,
}

/// The numbers.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// Of the local picture against the exact one, dB; `None` if they are equal.
    pub psnr: Option<f64>,
    /// Mean FLIP of the two.
    pub flip: f64,
    /// Time of the local picture without shading, seconds.
    pub local: f64,
    /// Time of the exact one.
    pub exact: f64,
    /// By distance, nearest first.
    pub distances: Vec<AtDistance>,
}

/// The numbers and the pictures.
pub struct LocalComparison {
    /// The numbers.
    pub report: Report,
    /// The local picture.
    pub local: Picture,
    /// The exact one.
    pub exact: Picture,
    /// FLIP of every pixel.
    pub flip: Array2<f32>,
}

/// Compares, light followed over `length`.
///
/// # Errors
/// Rays of the view start elsewhere than at its camera, so that nothing has one direction from there.
pub fn compare_local(
    world: &World,
    view: &View,
    samples: usize,
    length: f64,
    tolerance: f64,
) -> Result<LocalComparison> {
    if !view.is_central() {
        let message = "errors are told as angles at the camera, and rays of an orthographic picture, or of an eye that sees all around, start elsewhere";
        return Err(Error::input("the camera", message));
    }
    let tracer = ExactTracer::new(&world.manifold, view.u, length, tolerance);
    let by = |paths: Paths<'_>| draw(world, view, paths, samples, Footprints::Filtered);
    let (local, exact) = (by(Paths::Straight(length)), by(Paths::Exact(&tracer)));
    let flip = flip(&exact.picture, &local.picture, DEFAULT_PIXELS_PER_DEGREE)?;
    let psnr = psnr(&exact.picture, &local.picture)?;
    let mut errors: BTreeMap<i32, Vec<(f64, f64)>> = BTreeMap::new();
    let offset = offsets(samples)[0];
    for ((y, x, k), seen) in exact.outcomes.indexed_iter() {
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
        AtDistance {
            from: 2.0_f64.powi(octave),
            pixels: angles.len(),
            mrad: Quantiles::of(&mut angles),
            mrad_per_length: Quantiles::of(&mut rates).p50,
        }
    };
    Ok(LocalComparison {
        report: Report {
            psnr: psnr.is_finite().then_some(psnr),
            flip: flip.mean,
            local: local.paths.as_secs_f64(),
            exact: exact.paths.as_secs_f64(),
            distances: errors.into_iter().map(at_distance).collect(),
        },
        local: local.picture,
        exact: exact.picture,
        flip: flip.map,
    })
}

impl fmt::Display for Report {
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
