//! How exact the exact tracer must be for a promise.
//!
//! In: the rays of a space and a promise. Out: the loosest local tolerance at which the tracer's own
//! errors do not count. It is measured: where neighbouring paths part exponentially, a local error
//! of a billionth becomes a visible one, and polynomials cannot follow it because it differs from ray
//! to ray (Sol over length 5 at a tolerance a millionth of the promise: 2 % of rays flagged for it);
//! where they do not, a tight tolerance is time lost.

use crate::lift::random_rays;
use geofan_bundle::{
    PlanRecord,
    measure::{Probed, probe, stored_settings},
    rays::RaySpace,
};
use glam::DVec3;

/// Random rays compared.
const RAYS: usize = 256;

/// Share of the promise that the tracer's own error may take, as 99th percentile.
const SHARE: f64 = 0.02;

/// Tolerances tried, loosest first, in units of the promise in radians.
const TRIED: [f64; 6] = [1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7];

/// By what factor the tolerance of the reference is tighter.
const REFERENCE: f64 = 1e-3;

/// Bounds of a sensible tolerance: rounding errors below, wrong paths above.
const BOUNDS: [f64; 2] = [1e-13, 1e-6];

/// The tolerance for the promise of `plan`.
pub fn needed(space: &RaySpace, plan: &PlanRecord) -> f64 {
    let rays = random_rays(space, RAYS);
    let tolerances = TRIED.map(|share| (share * 1e-3 * plan.max_error).clamp(BOUNDS[0], BOUNDS[1]));
    let enough = |tolerance: &f64| error(space, plan, &rays, *tolerance) <= SHARE * plan.max_error;
    let found = tolerances.iter().find(|tolerance| enough(tolerance));
    found.copied().unwrap_or(BOUNDS[0])
}

/// The 99th percentile of the screen errors of the tracer, mrad, at `tolerance`.
fn error(space: &RaySpace, plan: &PlanRecord, rays: &[(DVec3, DVec3)], tolerance: f64) -> f64 {
    let follow = |tolerance: f64| -> Vec<Probed> {
        let settings = stored_settings(space, tolerance.max(BOUNDS[0]));
        let lengths = |ray: usize, end: f64| {
            // Every second ray at its end, where errors have grown most; the others on the way.
            let share = if ray.is_multiple_of(2) { 1.0 } else { 0.7 };
            vec![share * end.min(plan.length) * (1.0 - 1e-6)]
        };
        probe(space.manifold(), settings, plan.length, rays, lengths)
    };
    let (found, exact) = (follow(tolerance), follow(REFERENCE * tolerance));
    let pairs = found.iter().zip(&exact);
    let errors = pairs.flat_map(|(found, exact)| {
        let probes = found.probes.iter().zip(&exact.probes);
        // A ray whose end moved is compared at another place: that is no error of the path.
        let same = probes.filter(|(a, b)| (a.s - b.s).abs() <= 1e-9 * b.s);
        same.map(|(a, b)| b.screen_mrad(a.u - b.u))
            .collect::<Vec<_>>()
    });
    let mut errors: Vec<f64> = errors.collect();
    errors.sort_by(f64::total_cmp);
    errors.get(errors.len() * 99 / 100).map_or(0.0, |e| *e)
}
