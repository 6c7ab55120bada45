//! Times of frames of a default view: no objects, a sky behind every exit.
//!
//! In: a manifold, and a bundle's table or a number of steps. Out: processor milliseconds of a
//! frame of [`WIDTH`] × [`HEIGHT`] pixels, one sample each, seen from the middle of the camera
//! region along the first axis of the standard frame, by the lattice that `geofan render` uses.

use crate::sweep::clock::Clock;
use geofan_bundle::Table;
use geofan_core::{Result, diagnostic::SourceText, manifold::Manifold};
use geofan_render::{
    Camera, FixedTracer, Lookup, View, World, drawing::draw, frame::Paths, no_clock,
    scene::SceneFile, shade::Footprints,
};
use glam::DVec3;
use std::{path::Path, sync::Arc};

/// Columns of a frame.
pub const WIDTH: usize = 640;

/// Rows of a frame.
pub const HEIGHT: usize = 360;

/// Largest error of the lattice, mrad.
const LATTICE_ERROR: f64 = 0.25;

/// Local tolerance of rays that a table gave up on.
const TOLERANCE: f64 = 1e-8;

/// Frames of which the quickest counts.
const FRAMES: usize = 3;

/// What is drawn.
pub struct Stage {
    world: World,
    view: View,
}

impl Stage {
    /// The default view of `manifold`; `None` without a camera region.
    ///
    /// # Errors
    /// The view cannot be made.
    pub fn new(manifold: &Arc<Manifold>) -> Result<Option<Self>> {
        let Some(region) = &manifold.cameras else {
            return Ok(None);
        };
        let u = region.at(&region.lerp(&[0.5; 3]));
        let camera = Camera::looking(u, -DVec3::X, DVec3::Z);
        let skies = manifold.exits.iter().map(|exit| {
            let name = serde_json::Value::from(exit.name.as_str());
            format!("{name} = {{ pattern = \"grid\" }}\n")
        });
        let skies: String = skies.collect();
        let text = format!(
            "manifold = \"-\"\n[camera]\nat = [0, 0, 0]\nlook = [-1, 0, 0]\nup = [0, 0, 1]\n[sky]\n{skies}"
        );
        let scene = SceneFile::parse(SourceText::new("default view", text), Path::new("."))?;
        Ok(Some(Self {
            world: World::new(&scene, manifold.clone())?,
            view: View::of_camera(&camera, 90.0, (WIDTH, HEIGHT)),
        }))
    }

    /// Processor milliseconds of a frame by `table`, whose promise is `promise` mrad.
    ///
    /// # Errors
    /// The view's camera is not in the table's region.
    pub fn by_table(&self, table: &Table, promise: f64) -> Result<f64> {
        let lookup = Lookup::new(table, 1e-3 * promise, TOLERANCE);
        let mut least = f64::INFINITY;
        for _ in 0..FRAMES {
            let clock = Clock::start();
            let fan = table.fan(self.view.u)?;
            let tracer = lookup.tracer(&fan);
            self.draw(Paths::Lattice(&tracer, 1e-3 * LATTICE_ERROR));
            least = least.min(1e3 * clock.spent().cpu_s);
        }
        Ok(least)
    }

    /// Processor milliseconds of a frame by `steps` equal steps over `length`, by the same lattice.
    pub fn by_steps(&self, length: f64, steps: usize) -> f64 {
        let tracer = FixedTracer::new(&self.world.manifold, self.view.u, length, steps);
        let frame = || {
            let clock = Clock::start();
            self.draw(Paths::Lattice(&tracer, 1e-3 * LATTICE_ERROR));
            1e3 * clock.spent().cpu_s
        };
        (0..FRAMES).map(|_| frame()).fold(f64::INFINITY, f64::min)
    }

    fn draw(&self, paths: Paths<'_>) {
        std::hint::black_box(draw(
            &self.world,
            &self.view,
            paths,
            1,
            Footprints::Filtered,
            &no_clock,
        ));
    }
}
