//! Where the paths of a picture come from: a table, the integrator, or straight lines of the chart.
//!
//! In: a choice ([`PathSource`]) and [`DrawingOptions`]. Out: a [`Drawing`], and its picture with the
//! layers of an EXR file.

use super::{
    drawing::{Drawing, draw},
    frame::{Clock, Paths},
    lookup::Lookup,
    picture::Picture,
    shade::{Footprints, area, with_layers},
    tracer::ExactTracer,
    view::View,
    world::World,
};
use geofan_bundle::Bundle;
use geofan_core::error::Result;
use std::time::Duration;

/// Says how finely to draw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DrawingOptions {
    /// Samples for each pixel.
    pub samples: usize,
    /// Largest error of interpolation between looked-up paths, mrad.
    pub error: f64,
    /// Local tolerance of the exact tracer, radians.
    pub tolerance: f64,
}

/// Names where paths come from.
pub enum PathSource<'b> {
    /// A table.
    Table(Lookup<'b>),
    /// Integration over a length.
    Exact(f64),
    /// Straight lines of the chart over a length.
    Local(f64),
}

impl<'b> PathSource<'b> {
    /// Takes paths from `bundle`; those that it gives up on are integrated at `tolerance`.
    pub fn table(bundle: &'b Bundle, tolerance: f64) -> Self {
        let promise = 1e-3 * bundle.header.plan.max_error;
        Self::Table(Lookup::new(&bundle.table, promise, tolerance))
    }

    /// Names the tracer.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Table(_) => "table",
            Self::Exact(_) => "exact",
            Self::Local(_) => "local",
        }
    }

    /// Draws the picture; returns it with the time that fixing the camera took.
    ///
    /// # Errors
    /// The camera is not in the table's region.
    pub fn draw(
        &self,
        world: &World,
        view: &View,
        options: DrawingOptions,
        clock: Clock<'_>,
    ) -> Result<(Drawing, Duration)> {
        let samples = options.samples;
        let by = |paths: Paths<'_>| draw(world, view, paths, samples, Footprints::Filtered, clock);
        match self {
            Self::Table(lookup) => {
                let began = clock();
                let fan = lookup.table.fan(view.u)?;
                let contract = clock().saturating_sub(began);
                let tracer = lookup.tracer(&fan);
                let budget = 1e-3 * options.error;
                Ok((by(Paths::Lattice(&tracer, budget)), contract))
            }
            Self::Local(length) => Ok((by(Paths::Straight(*length)), Duration::ZERO)),
            Self::Exact(length) => {
                let tolerance = options.tolerance;
                let tracer = ExactTracer::new(&world.manifold, view.u, *length, tolerance);
                Ok((by(Paths::Exact(&tracer)), Duration::ZERO))
            }
        }
    }
}

impl Drawing {
    /// Adds the layers of an EXR file to the picture, `area` by exact paths at `tolerance`.
    pub fn layered(self, world: &World, view: &View, tolerance: f64) -> Picture {
        let outcomes = self.outcomes.view();
        let picture = with_layers(self.picture, world, outcomes, &self.flagged);
        let area = area(world, view, outcomes, tolerance);
        picture.with_float("area", area)
    }
}
