//! Exits behind which paths get rough: tables end paths there.
//!
//! In: the rays of a space. Out: for each exit whether it is one of them. Paths in a table go on past their exits, as
//! smooth as they are; behind a horizon that a wind carries them over they turn about a singularity within a moment,
//! and polynomials that followed them there would take all their degrees for what nobody sees.

use crate::plan::{PlanWatch, random_stored_rays};
use geofan_bundle::{
    PlanRecord,
    rays::{RaySpace, exit_met},
};
use geofan_core::{
    Result,
    geodesic::{End, Path, Ray, Settings, paths},
    manifold::Carried,
};

/// Random paths that are followed past their exits.
const PATHS: usize = 256;

/// Paths followed between two looks at the observer.
const BATCH: usize = 64;

/// Factor by which the least step of the integrator behind an exit must be smaller than that before it.
const ROUGHER: f64 = 4.0;

/// Tells of each exit of `space` whether most paths through it get rough behind it. None does where only the metric
/// bends light: there paths come to rest near a horizon by themselves.
///
/// # Errors
/// The observer ends it.
pub fn rough_exits(
    space: &RaySpace,
    plan: &PlanRecord,
    watch: &PlanWatch<'_>,
) -> Result<Vec<bool>> {
    let manifold = space.manifold();
    if !manifold.has_wind() || !manifold.domain.ends_rays() || !space.ends_alike() {
        return Ok(Vec::new());
    }
    let settings = Settings {
        tolerance: plan.tolerance,
        carried: Carried::default(),
        events: false,
    };
    // Paths through each exit, and those of them that get rough.
    let mut counts = vec![[0_usize; 2]; manifold.exits.len()];
    for batch in random_stored_rays(space, PATHS).chunks(BATCH) {
        watch.add(batch.len() as u64)?;
        let rays = batch
            .iter()
            .map(|&(u, d)| Ray::without_spread(u, manifold.local_frame(u).tangent(d), plan.length));
        for path in paths(manifold, settings, rays) {
            let Some((exit, place)) = exit_met(space, &path, path.length) else {
                continue;
            };
            if let Some(count) = counts.get_mut(exit) {
                count[0] += 1;
                count[1] += usize::from(is_rough_behind(&path, place));
            }
        }
    }
    Ok(counts.iter().map(|[all, rough]| 2 * rough > *all).collect())
}

/// Tells whether a path gets rough behind the arc length `place`: its end, or steps far shorter than all before.
fn is_rough_behind(path: &Path, place: f64) -> bool {
    // The last step is cut off at the length.
    let steps = path.steps.split_last().map_or(&[][..], |(_, steps)| steps);
    let least = |behind: bool| {
        let steps = steps.iter().filter(|step| (step.start >= place) == behind);
        steps
            .map(|step| step.end - step.start)
            .fold(f64::INFINITY, f64::min)
    };
    path.end == End::Singular || ROUGHER * least(true) < least(false)
}
