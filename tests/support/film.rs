//! Pictures by path tracing, and means of them.

use geofan_light::path_tracer::{PassAccumulator, PathTracer, PathTracerSettings};
use geofan_render::{Stage, View};
use std::ops::Range;

/// Renders so many passes.
pub fn film(
    stage: &Stage,
    view: &View,
    settings: PathTracerSettings,
    passes: u64,
) -> PassAccumulator {
    let tracer = PathTracer::new(&stage.world, view, settings);
    let mut film = PassAccumulator::new(view.size);
    for pass in 0..passes {
        film.add(&tracer.pass(pass, || false).unwrap());
    }
    film
}

/// Mean over a rectangle of pixels (green) and its standard error.
pub fn mean(film: &PassAccumulator, columns: Range<usize>, rows: Range<usize>) -> (f64, f64) {
    let (mut sum, mut variance, mut n) = (0.0, 0.0, 0.0);
    for y in rows {
        for x in columns.clone() {
            let (mean, of_mean) = film.pixel(x, y);
            (sum, variance, n) = (sum + mean.y, variance + of_mean.y, n + 1.0);
        }
    }
    (sum / n, f64::sqrt(variance) / n)
}
