//! Exits behind which paths get rough: tables end paths there.
//!
//! In: the rays of a space. Out: for each exit whether it is one of them, and how far behind it paths may end. Paths in a
//! table go on past their exits, as smooth as they are; behind a horizon that a wind carries them over they turn about a singularity within a moment,
//! and polynomials that followed them there would take all their degrees for what nobody sees.

use crate::plan::{PlanWatch, random_stored_rays};
use geofan_bundle::{
    PlanRecord,
    rays::{RaySpace, exit_met},
};
use geofan_core::{
    Result,
    geodesic::{End, Path, Ray, Settings, Step, paths},
};

/// Random paths that are followed past their exits: some are to meet a hole that takes a hundredth of the sky.
const PATHS: usize = 4096;

/// Paths followed between two looks at the observer.
const BATCH: usize = 64;

/// Factor by which the least step of the integrator behind an exit must be smaller than that before it.
const ROUGHER: f64 = 4.0;

/// The share of the way, from the exit to where paths get rough, after which they end: as far from both as errors of a
/// table and differences between neighbours allow. And the bounds of it as a share of the arc length up to the exit.
const PART: f64 = 0.4;
const BOUNDS: [f64; 2] = [1e-3, 2e-2];

/// The share of paths that may get rough sooner than is reckoned with.
const SOONER: f64 = 0.05;

/// Tells of each exit of `space` whether most paths through it get rough behind it: then, how far behind it they are to
/// end, as a share of the arc length. None does where only the metric bends light: there paths come to rest near a
/// horizon by themselves.
///
/// # Errors
/// The observer ends it.
pub fn rough_exits(
    space: &RaySpace,
    plan: &PlanRecord,
    watch: &PlanWatch<'_>,
) -> Result<Vec<Option<f64>>> {
    let manifold = space.manifold();
    if !manifold.has_wind() || !manifold.domain.ends_rays() || !space.ends_alike() {
        return Ok(Vec::new());
    }
    let settings = Settings::bare(plan.tolerance);
    // Paths through each exit, and how far behind it they get rough.
    let mut found = vec![(0, Vec::new()); manifold.exits.len()];
    for batch in random_stored_rays(space, PATHS).chunks(BATCH) {
        watch.add(batch.len() as u64)?;
        let rays = batch
            .iter()
            .map(|&(u, d)| Ray::without_spread(u, manifold.local_frame(u).tangent(d), plan.length));
        for path in paths(manifold, settings, rays) {
            let Some((exit, place)) = exit_met(space, &path, path.length) else {
                continue;
            };
            if let Some((count, ways)) = found.get_mut(exit) {
                *count += 1;
                ways.extend(smooth_way(&path, place));
            }
        }
    }
    let share = |(count, mut ways): (usize, Vec<f64>)| {
        ways.sort_by(f64::total_cmp);
        let way = ways.get((SOONER * ways.len() as f64) as usize)?;
        (2 * ways.len() > count).then_some((PART * way).clamp(BOUNDS[0], BOUNDS[1]))
    };
    Ok(found.into_iter().map(share).collect())
}

/// Returns how far a path goes on behind the arc length `place`, as a share of it, before it gets rough: by steps far
/// shorter than all before, or by its end.
fn smooth_way(path: &Path, place: f64) -> Option<f64> {
    // The last step is cut off at the length.
    let (last, steps) = path.steps.split_last()?;
    let behind = steps.partition_point(|step| step.start < place);
    let length = |step: &Step| step.end - step.start;
    let least = steps[..behind]
        .iter()
        .map(length)
        .fold(f64::INFINITY, f64::min);
    let rough = steps[behind..]
        .iter()
        .find(|step| ROUGHER * length(step) < least);
    let end = match (rough, path.end) {
        (Some(step), _) => step.start,
        (None, End::Singular) => last.end,
        (None, _) => return None,
    };
    Some(end / place - 1.0)
}
