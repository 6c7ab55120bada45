//! Path tracing of a picture of several parts: eyes, faces of a cube.
//!
//! In: a world and the parts of a picture. Out: passes over all of it, and the layers of what its cameras' rays meet
//! first.

use super::{PathTracer, PathTracerSettings};
use geofan_render::{
    ExactTracer, PicturePanel, PicturePanels, World,
    frame::{Paths, offsets, trace},
    picture::Picture,
    shade::with_layers,
};
use glam::DVec3;

/// One tracer for each part of a picture.
pub struct PanelTracers<'a> {
    world: &'a World,
    panels: &'a PicturePanels,
    settings: PathTracerSettings,
    tracers: Vec<PathTracer<'a>>,
}

impl<'a> PanelTracers<'a> {
    /// Prepares the tracers of all parts.
    pub fn new(world: &'a World, panels: &'a PicturePanels, settings: PathTracerSettings) -> Self {
        let mut tracers: Vec<PathTracer<'a>> = Vec::new();
        let mut before = 0;
        for PicturePanel { view, .. } in &panels.parts {
            let tracer = match tracers.first() {
                Some(first) => first.through(view, before),
                None => PathTracer::new(world, view, settings),
            };
            before += (view.size.0 * view.size.1) as u64;
            tracers.push(tracer);
        }
        Self {
            world,
            panels,
            settings,
            tracers,
        }
    }

    /// Returns the number of geodesics followed so far.
    pub fn rays(&self) -> u64 {
        self.tracers.first().map_or(0, PathTracer::rays)
    }

    /// Renders one sample of every pixel of the whole picture as radiance; `None` if `stop` said so.
    pub fn pass(&self, number: u64, stop: impl Fn() -> bool + Sync) -> Option<Vec<DVec3>> {
        let (width, height) = self.panels.size;
        let mut all = vec![DVec3::ZERO; width * height];
        for (tracer, PicturePanel { view, at }) in self.tracers.iter().zip(&self.panels.parts) {
            let light = tracer.pass(number, &stop)?;
            for (row, line) in light.chunks_exact(view.size.0).enumerate() {
                let start = (at.1 + row) * width + at.0;
                all[start..start + line.len()].copy_from_slice(line);
            }
        }
        Some(all)
    }

    /// Adds the layers of what the cameras' rays meet first to a picture of all parts; its own layers, such as its
    /// variance, come first.
    pub fn layered(&self, picture: Picture) -> Picture {
        let PathTracerSettings {
            length, tolerance, ..
        } = self.settings;
        let layered = |(number, PicturePanel { view, .. }): (usize, &PicturePanel)| {
            let tracer = ExactTracer::new(&self.world.manifold, view.u, length, tolerance);
            let traced = trace(self.world, view, Paths::Exact(&tracer), &offsets(1));
            let part = self.panels.cut(&picture, number);
            with_layers(part, self.world, traced.outcomes.view(), &[])
        };
        let parts = self.panels.parts.iter().enumerate().map(layered).collect();
        let mut whole = self.panels.join(parts);
        whole.layers.splice(0..0, picture.layers);
        whole
    }
}
