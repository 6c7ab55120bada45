//! What is seen through surfaces that are not solid.
//!
//! In: what samples see first, and its colours as if it were solid. Out: for each sample the colours
//! of all that it sees, from front to back, each weighed by its opacity and by what those before it
//! let through (T. Porter, T. Duff, *Compositing digital images*, 1984). Behind a surface a table knows
//! no paths, so there they are integrated; straight lines stay straight.

use super::{
    frame::{Outcomes, Paths},
    intersect::{Hit, Seen, first_seen},
    local::straight_behind,
    redshift::shift_colours,
    shade::{Colours, Footprints, shade},
    tiles::{PixelSamples, SamplePlace},
};
use geofan_core::geodesic::Ray;
use geofan_core::parallel::*;
use ndarray::{Array3, ArrayView3, s};

/// Light below this share of a sample is not followed any farther: a quarter of the step of a file
/// with eight bits.
const FAINT: f32 = 1e-3;

/// Most surfaces behind each other: so many of equal opacity that together are not solid are as good
/// as not there.
const MOST_SURFACES: usize = 256;

/// Distance at which a path goes on beyond a surface, as a share of the arc length at which it was
/// met and of a hundredth of the whole: rounding is a thousand times smaller.
const OFFSET: f64 = 1e-6;

/// Rays given to one thread at once: enough to keep its lanes full.
const BLOCK: usize = 256;

/// Local tolerance behind paths of a tracer that has none.
const TOLERANCE: f64 = 1e-8;

/// Shows what lies behind surfaces.
pub(super) struct SeenBehind<'a> {
    /// The samples of one pass.
    pub samples: PixelSamples<'a>,
    /// The tracer of their paths.
    pub paths: Paths<'a>,
    /// Samples of a pixel in all passes.
    pub of_pixel: usize,
    /// Set if colours are averaged over footprints.
    pub footprints: Footprints,
}

/// A sample that sees through surfaces.
struct Through {
    place: SamplePlace,
    /// The last surface, and the arc length between it and what was before it.
    hit: Hit,
    way: f64,
    /// Number of surfaces passed.
    passed: usize,
    /// Share of light that they let through.
    share: f32,
}

impl Through {
    /// Returns the arc length from the camera.
    fn s(&self) -> f64 {
        self.hit.s.into()
    }
}

impl SeenBehind<'_> {
    /// Adds what lies behind the surfaces of `outcomes` to `colours`.
    pub(super) fn show(&self, outcomes: ArrayView3<'_, Seen>, colours: &mut Colours) {
        if !self.samples.world.clear {
            return;
        }
        let mut open = Vec::new();
        for (place, seen) in outcomes.indexed_iter() {
            let before = (place, 0.0, 0, 1.0);
            let share = self.pass(before, seen, &mut open);
            if share < 1.0 {
                add(colours, place, |_, own| own * share);
            }
        }
        while !open.is_empty() {
            let seen = self.seen(&open);
            let mut layer: Outcomes = Array3::from_elem(outcomes.dim(), Seen::Nothing);
            for (through, seen) in open.iter().zip(&seen) {
                layer[through.place] = *seen;
            }
            let PixelSamples { world, view, .. } = self.samples;
            let mut lit = shade(world, view, layer.view(), self.of_pixel, self.footprints);
            shift_colours(world, view, &layer, self.samples.offsets, &mut lit);
            let mut next = Vec::new();
            for (through, seen) in open.iter().zip(&seen) {
                let before = (through.place, through.s(), through.passed, through.share);
                let share = self.pass(before, seen, &mut next);
                let (y, x, k) = through.place;
                add(colours, through.place, |c, own| {
                    own + share * lit[(y, x, k, c)]
                });
            }
            open = next;
        }
    }

    /// Returns the share of a sample that comes from what it sees, after surfaces up to an arc length, so many,
    /// that let a share through. If something comes from behind it, that is put into `open`.
    fn pass(
        &self,
        (place, s, passed, share): (SamplePlace, f64, usize, f32),
        seen: &Seen,
        open: &mut Vec<Through>,
    ) -> f32 {
        let Seen::Surface(hit) = seen else {
            return share;
        };
        let opacity = self.samples.world.opacity(hit);
        let rest = share * (1.0 - opacity);
        if rest <= FAINT || passed == MOST_SURFACES {
            return share;
        }
        open.push(Through {
            place,
            hit: *hit,
            way: f64::from(hit.s) - s,
            passed: passed + 1,
            share: rest,
        });
        share * opacity
    }

    /// Finds what the samples see next.
    fn seen(&self, open: &[Through]) -> Vec<Seen> {
        let (length, tolerance) = match self.paths {
            Paths::Exact(tracer) => (tracer.length(), tracer.tolerance()),
            Paths::Direct(tracer) | Paths::Lattice(tracer, _) => {
                let length = tracer.knots().last().copied().unwrap_or(0.0);
                let exact = tracer.fallback();
                (length, exact.map_or(TOLERANCE, |tracer| tracer.tolerance()))
            }
            Paths::Straight(length) => {
                let passed = |through: &Through| (through.place, through.passed);
                let passed: Vec<_> = open.iter().map(passed).collect();
                return straight_behind(&self.samples, length, &passed);
            }
        };
        let world = self.samples.world;
        let ray = |through: &Through| {
            let v = through.hit.v.as_dvec3();
            let off = OFFSET * (through.way + 1e-2 * length);
            let u = world.point(&through.hit) + v * off;
            let s = through.s();
            (Ray::without_spread(u, v, length - s), s)
        };
        let block = |open: &[Through]| {
            let rays: Vec<(Ray, f64)> = open.iter().map(ray).collect();
            first_seen(world, &rays, tolerance)
        };
        open.par_chunks(BLOCK).flat_map(block).collect()
    }
}

/// Changes the colour of a sample.
fn add(colours: &mut Colours, (y, x, k): SamplePlace, change: impl Fn(usize, f32) -> f32) {
    let mut colour = colours.slice_mut(s![y, x, k, ..]);
    for (c, own) in colour.iter_mut().enumerate() {
        *own = change(c, *own);
    }
}
