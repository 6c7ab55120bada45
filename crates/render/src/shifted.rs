//! The table's tracer of pictures whose rays do not start at the camera.
//!
//! In: a table, and a view of which each point has a place of its own ([`View::is_central`]). Out:
//! [`PathBatch`], each path from a fan of its own. That takes a contraction of the table for every path, which only
//! a lattice makes few enough; the paths are kept on finer knots, because no fan is there any more when they
//! are refined.

use super::{
    endings::EventLocator,
    lookup::{Lookup, ending},
    path_batch::{PathBatch, PathOrigin, PathView},
    starts::starts,
    tracer::{ExactTracer, GridTracer, even_knots},
    view::View,
};
use glam::{DVec2, DVec3};
use std::sync::Arc;

/// Looks up each path from where it starts.
pub struct ShiftedTracer<'f, 't> {
    lookup: &'f Lookup<'t>,
    view: &'f View,
    knots: Arc<[f64]>,
    exact: ExactTracer<'f>,
}

/// Knots for each of those of a table's paths: cubics between them then miss by less than chords may, as
/// their error falls with the fourth power.
const FINER: usize = 4;

impl<'f, 't> ShiftedTracer<'f, 't> {
    /// Makes the tracer of one picture.
    pub fn new(lookup: &'f Lookup<'t>, view: &'f View) -> Self {
        let intervals = FINER * (lookup.knots().len() - 1);
        Self {
            lookup,
            view,
            knots: even_knots(lookup.table.length, intervals),
            exact: lookup.exact(view.u),
        }
    }
}

impl GridTracer for ShiftedTracer<'_, '_> {
    fn knots(&self) -> &Arc<[f64]> {
        &self.knots
    }

    /// Adds the paths of points of the picture (see [`View::address`]). Those that start outside the table's
    /// region, or outside the space, are not given.
    fn add(&self, addresses: &[DVec3], events: &mut EventLocator<'_>, batch: &mut PathBatch) {
        let table = self.lookup.table;
        let manifold = table.space.manifold();
        let points = addresses.iter().map(|at| DVec2::new(at.x, at.y));
        batch.reserve(addresses.len());
        for (address, start) in addresses.iter().zip(starts(manifold, self.view, points)) {
            let source = (*address, PathOrigin::Knots);
            let known = start.and_then(|start| Some((start, table.fan(start.u).ok()?)));
            match known {
                Some((start, fan)) => {
                    let path = fan.path(start.direction);
                    let fill = |knots: &[f64], rows: &mut [f64]| path.sample_into(knots, rows);
                    batch.push(source, fill, |view| ending(&path, view, events));
                }
                None => batch.push(source, |_, _| 0, |_| None),
            }
        }
    }

    fn refine(&self, path: PathView<'_>, s: &[f64], rows: &mut [f64]) {
        path.sample(s, rows);
    }

    fn slack(&self) -> f64 {
        self.lookup.slack() / FINER.pow(4) as f64
    }

    fn fallback(&self) -> Option<&ExactTracer<'_>> {
        Some(&self.exact)
    }
}
