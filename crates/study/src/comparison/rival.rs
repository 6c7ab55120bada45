//! Equal-error exact: the integrator that a table must beat.
//!
//! In: the table's error at every pixel. Out: the fewest equal steps in single precision with which
//! an integrator is as good, and its frames: every sample by itself, and with the lattice.

use crate::comparison::Times;
use crate::comparison::{Options, Rival, errors::middle, report};
use geofan_bundle::measure::Probed;
use geofan_core::{manifold::Manifold, quantiles::Quantiles};
use geofan_render::{
    drawing::draw,
    endings::EventLocator,
    frame::Paths,
    path_batch::{PathBatch, PathView},
    shade::Footprints,
    tracer::{FixedTracer, GridTracer},
    view::View,
    world::World,
};
use glam::DVec3;

/// Steps tried.
const STEPS: [usize; 17] = [
    8, 10, 12, 14, 16, 20, 24, 32, 40, 48, 64, 96, 128, 192, 256, 384, 512,
];

/// Pixels on which the steps are chosen: every so many along both sides.
const STRIDE: usize = 8;

/// What the rival must reach.
pub(super) struct Goal<'p> {
    directions: Vec<DVec3>,
    probed: Vec<&'p Probed>,
    /// The table's 99th percentile of screen error, mrad.
    error: f64,
    length: f64,
}

impl<'p> Goal<'p> {
    pub(super) fn new(
        view: &View,
        length: f64,
        probed: &'p [Probed],
        errors: &[Option<(f64, f64)>],
    ) -> Self {
        let (width, height) = view.size;
        let pixels: Vec<usize> = (0..height)
            .step_by(STRIDE)
            .flat_map(|y| (0..width).step_by(STRIDE).map(move |x| y * width + x))
            .filter(|&i| errors[i].is_some())
            .collect();
        let mut reached: Vec<f64> = pixels
            .iter()
            .filter_map(|&i| errors[i])
            .map(|e| e.1)
            .collect();
        Self {
            directions: pixels
                .iter()
                .map(|i| middle(view, i % width, i / width))
                .collect(),
            probed: pixels.iter().map(|&i| &probed[i]).collect(),
            error: Quantiles::of(&mut reached).p99,
            length,
        }
    }

    pub(super) fn tracer<'m>(
        &self,
        manifold: &'m Manifold,
        u: DVec3,
        steps: usize,
    ) -> FixedTracer<'m> {
        FixedTracer::new(manifold, u, self.length, steps)
    }

    /// The rival, and the times of its frame.
    pub(super) fn meet(&self, world: &World, view: &View, options: Options) -> (Rival, Times) {
        let mut chosen = (STEPS[STEPS.len() - 1], Quantiles::default());
        for steps in STEPS {
            chosen = (steps, self.measure(world, view, steps));
            if chosen.1.p99 <= self.error {
                break;
            }
        }
        let tracer = self.tracer(&world.manifold, view.u, chosen.0);
        let frame = |paths| {
            let drawn = draw(
                world,
                view,
                paths,
                options.samples,
                Footprints::Filtered,
                &crate::clock,
            );
            report::times(&drawn)
        };
        let times = report::median((0..REPEATS).map(|_| frame(Paths::Direct(&tracer))));
        let budget = 1e-3 * options.error;
        let lattice_times =
            report::median((0..REPEATS).map(|_| frame(Paths::Lattice(&tracer, budget))));
        let rival = Rival {
            steps: chosen.0,
            equal: chosen.1.p99 <= self.error,
            screen_mrad: chosen.1,
            times,
            lattice_times,
        };
        (rival, times)
    }

    /// The rival's screen errors with so many steps.
    fn measure(&self, world: &World, view: &View, steps: usize) -> Quantiles {
        let tracer = self.tracer(&world.manifold, view.u, steps);
        let mut strands = PathBatch::new(tracer.knots().clone());
        let mut endings = EventLocator::new(&world.manifold);
        tracer.add(&self.directions, &mut endings, &mut strands);
        let mut found: Vec<f64> = self
            .probed
            .iter()
            .enumerate()
            .map(|(i, probed)| strand_error(strands.path(i), probed))
            .collect();
        Quantiles::of(&mut found)
    }
}

/// How often the rival's frames are drawn.
const REPEATS: usize = 3;

fn strand_error(strand: PathView<'_>, probed: &Probed) -> f64 {
    let Some(probe) = probed.probes.first() else {
        return 0.0;
    };
    match strand.position(probe.s) {
        Some(u) => probe.screen_mrad(u - probe.u),
        None => f64::INFINITY,
    }
}
