//! The exact tracer on common knots, so that its paths can be interpolated.
//!
//! In: a manifold and a camera; no table. Out: a [`GridTracer`] whose paths are integrated adaptively and
//! then sampled at knots, fine enough that the cubics between them stay within [`KNOT_ERROR`] of the path.
//! A path that they do not follow that closely, or that ends early, is left to the exact tracer.

use super::{
    curve::{Curve, Ending},
    endings::EventLocator,
    lookup::{choose_knots, worst_middle},
    path_batch::{PathBatch, PathOrigin, PathView, put},
    tracer::{ExactTracer, GridTracer},
};
use geofan_core::manifold::Manifold;
use glam::DVec3;
use std::sync::Arc;

/// Most error of the cubics between knots, radians at the camera. Points come from the cubics, so it has to
/// be below what a picture shows: a third of a pixel of 1920 in 90°. Smaller takes more knots, and with them
/// more time for every path.
const KNOT_ERROR: f64 = 3e-4;

/// Integrates paths and hands them out at common knots.
#[derive(Debug, Clone)]
pub struct ExactGridTracer<'m> {
    exact: ExactTracer<'m>,
    knots: Arc<[f64]>,
}

impl<'m> ExactGridTracer<'m> {
    /// Chooses knots for paths of `length` from the camera region, or from `u` if the manifold has none.
    /// It integrates a sample of paths, which takes longer than a frame: once for each scene.
    pub fn choose_knots(manifold: &Manifold, u: DVec3, length: f64, tolerance: f64) -> Arc<[f64]> {
        choose_knots(manifold, u, [length, tolerance, KNOT_ERROR])
    }

    /// Makes the tracer of rays from `u` at `knots`, at a local tolerance.
    pub fn new(manifold: &'m Manifold, u: DVec3, knots: Arc<[f64]>, tolerance: f64) -> Self {
        let length = knots.last().copied().unwrap_or_default();
        Self {
            exact: ExactTracer::new(manifold, u, length, tolerance),
            knots,
        }
    }
}

impl GridTracer for ExactGridTracer<'_> {
    fn knots(&self) -> &Arc<[f64]> {
        &self.knots
    }

    fn add(&self, directions: &[DVec3], events: &mut EventLocator<'_>, batch: &mut PathBatch) {
        // On past exits: neighbours that leave later are interpolated with what is there.
        let curves = self.exact.curves(directions, false);
        for (direction, curve) in directions.iter().zip(curves) {
            let close = worst_middle(&curve, &self.knots) <= KNOT_ERROR;
            let source = (*direction, PathOrigin::Knots);
            batch.push(
                source,
                |knots, rows| fill(&curve, knots, rows),
                |path| {
                    let event = close.then(|| events.ending(path))?;
                    event.or((path.known == path.knots.len()).then_some(Ending::Length))
                },
            );
        }
    }

    fn refine(&self, path: PathView<'_>, s: &[f64], rows: &mut [f64]) {
        path.sample(s, rows);
    }

    fn slack(&self) -> f64 {
        KNOT_ERROR
    }

    fn fallback(&self) -> Option<&ExactTracer<'_>> {
        Some(&self.exact)
    }
}

/// Writes the states of `curve` at `knots` into six rows, and returns how many it has.
fn fill(curve: &Curve, knots: &[f64], rows: &mut [f64]) -> usize {
    for (k, s) in knots.iter().enumerate() {
        let Some(state) = curve.state(*s) else {
            return k;
        };
        put(rows, k, state);
    }
    knots.len()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Stage,
        frame::{Paths, offsets, trace},
        intersect::Seen,
    };
    use std::path::Path;

    #[test]
    fn the_lattice_of_exact_paths_sees_what_each_exact_path_sees() {
        let file = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../assets/scenes/wormhole-gallery.toml"
        );
        let stage = Stage::load(Path::new(file), &[]).unwrap();
        let view = stage.view(&stage.scene.camera, (64, 36)).unwrap();
        let (manifold, length) = (&stage.world.manifold, 24.0);
        let knots = ExactGridTracer::choose_knots(manifold, view.u, length, 1e-7);
        let grid = ExactGridTracer::new(manifold, view.u, knots, 1e-7);
        let exact = ExactTracer::new(manifold, view.u, length, 1e-8);
        let seen = |paths| trace(&stage.world, &view, paths, &offsets(1)).outcomes;
        let (fast, slow) = (
            seen(Paths::Lattice(&grid, 5e-4)),
            seen(Paths::Exact(&exact)),
        );
        let alike = |(a, b): (&Seen, &Seen)| match (a, b) {
            (
                Seen::Sky {
                    exit, direction, ..
                },
                Seen::Sky {
                    exit: other,
                    direction: known,
                    ..
                },
            ) => exit == other && direction.angle_between(*known) < 5e-3,
            (Seen::Surface(a), Seen::Surface(b)) => {
                let way = stage.world.point(a) - stage.world.point(b);
                way.length() < 1e-2
            }
            (a, b) => a == b,
        };
        let same = fast.iter().zip(&slow).filter(|pair| alike(*pair)).count();
        // Pixels at silhouettes and at the rim of the throat may fall either way.
        assert!(
            same as f64 > 0.98 * slow.len() as f64,
            "{same} of {}",
            slow.len()
        );
    }
}
