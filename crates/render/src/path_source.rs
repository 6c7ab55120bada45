//! Where the paths of a picture come from: a table, the integrator, or straight lines of the chart.
//!
//! In: a choice ([`PathSource`]) and [`DrawingOptions`]. Out: a [`Drawing`], its picture with the layers of an
//! EXR file, and the paths that were not followed far enough.

use super::{
    drawing::{Drawing, draw},
    frame::{Clock, Outcomes, Paths},
    lookup::Lookup,
    panels::{PicturePanel, PicturePanels},
    picture::Picture,
    shade::{Footprints, with_layers},
    shifted::ShiftedTracer,
    tracer::ExactTracer,
    unfinished::{count_unfinished, unfinished},
    view::View,
    world::World,
};
use geofan_bundle::{Bundle, Fan};
use geofan_core::{error::Result, geodesic::UnfinishedPaths};
use glam::DVec3;
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
    /// Set if the picture is to have the layers of an EXR file.
    pub layers: bool,
}

/// A picture of all parts, and what it took: the share of samples that the table gave up on, and seconds.
#[derive(Default)]
pub struct DrawnPanels {
    /// The picture, put together.
    pub picture: Picture,
    /// What the samples of each part see.
    pub parts: Vec<(View, Outcomes)>,
    /// True if there is anything at the end of any path.
    pub shows: bool,
    /// Share of the samples that the table gave up on.
    pub flagged: f64,
    /// Fixing the cameras.
    pub contract: f64,
    /// Paths and what they meet.
    pub paths: f64,
    /// Colours and pixels.
    pub shade: f64,
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
        Self::Table(Lookup::new(&bundle.table, bundle.promise(), tolerance))
    }

    /// Follows paths of a table in a glued space over `length`, by looking them up again where the table's end.
    #[must_use]
    pub fn continued(self, length: f64) -> Self {
        match self {
            Self::Table(lookup) => Self::Table(lookup.continued(length)),
            other => other,
        }
    }

    /// Names the tracer.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Table(_) => "table",
            Self::Exact(_) => "exact",
            Self::Local(_) => "local",
        }
    }

    /// Finds which of its paths end by their length, and which length would do; of straight lines only the
    /// first, as no length of theirs tells about light.
    pub fn ends(
        &self,
        world: &World,
        parts: &[(View, Outcomes)],
        tolerance: f64,
    ) -> UnfinishedPaths {
        let length = match self {
            Self::Table(lookup) => lookup.length(),
            Self::Exact(length) => *length,
            Self::Local(_) => return count_unfinished(parts.iter().map(|(_, seen)| seen)),
        };
        unfinished(world, parts, (length, tolerance))
    }

    /// Draws the picture of one view; returns it with the time that fixing the camera took. `kept` is the fan
    /// of the view before, if there is one, and then of this one.
    ///
    /// # Errors
    /// The camera is not in the table's region.
    pub fn draw(
        &self,
        world: &World,
        view: &View,
        options: DrawingOptions,
        (kept, clock): (&mut Option<(DVec3, Fan)>, Clock<'_>),
    ) -> Result<(Drawing, Duration)> {
        let (samples, budget) = (options.samples, 1e-3 * options.error);
        let by = |paths: Paths<'_>| draw(world, view, paths, samples, Footprints::Filtered, clock);
        match self {
            Self::Table(lookup) if !view.is_central() => {
                // Of all places only the camera's own can be asked for; where a ray starts outside the
                // table's region it is integrated.
                lookup.table.space.place(view.u)?;
                let tracer = ShiftedTracer::new(lookup, view);
                Ok((by(Paths::Lattice(&tracer, budget)), Duration::ZERO))
            }
            Self::Table(lookup) => {
                let began = clock();
                let fan = match kept.take() {
                    Some((u, fan)) if u == view.u => fan,
                    _ => lookup.table.fan(view.u)?,
                };
                let contract = clock().saturating_sub(began);
                let drawing = by(Paths::Lattice(&lookup.tracer(&fan), budget));
                *kept = Some((view.u, fan));
                Ok((drawing, contract))
            }
            Self::Local(length) => Ok((by(Paths::Straight(*length)), Duration::ZERO)),
            Self::Exact(length) => {
                let tolerance = options.tolerance;
                let tracer = ExactTracer::new(&world.manifold, view.u, *length, tolerance);
                Ok((by(Paths::Exact(&tracer)), Duration::ZERO))
            }
        }
    }

    /// Draws the picture of all parts.
    ///
    /// # Errors
    /// As of [`PathSource::draw`].
    pub fn draw_panels(
        &self,
        world: &World,
        panels: &PicturePanels,
        options: DrawingOptions,
        clock: Clock<'_>,
    ) -> Result<DrawnPanels> {
        let mut drawn = DrawnPanels::default();
        let (mut pictures, mut fan, mut samples) = (Vec::new(), None, 0);
        for PicturePanel { view, .. } in &panels.parts {
            let (drawing, contract) = self.draw(world, view, options, (&mut fan, clock))?;
            drawn.contract += contract.as_secs_f64();
            drawn.paths += drawing.paths.as_secs_f64();
            drawn.shade += drawing.shade.as_secs_f64();
            drawn.flagged += drawing.flagged.len() as f64;
            samples += drawing.outcomes.len();
            drawn.shows |= drawing.outcomes.iter().any(|seen| world.shows(seen));
            pictures.push(match options.layers {
                true => {
                    let seen = (&drawing.outcomes, &drawing.flagged[..]);
                    with_layers(drawing.picture, world, view, seen, options.tolerance)
                }
                false => drawing.picture,
            });
            drawn.parts.push((view.clone(), drawing.outcomes));
        }
        drawn.flagged /= samples as f64;
        drawn.picture = panels.join(pictures);
        Ok(drawn)
    }
}
