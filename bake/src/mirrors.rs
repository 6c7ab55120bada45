//! Which discrete symmetries the rays of a table have.
//!
//! In: the rays of a space. Out: its [`Mirror`]s. No file claims them, so they are tested where
//! it matters: at points all along random paths.

use crate::lift::random_rays;
use geofan_bundle::{
    PlanRecord,
    measure::{Probed, probe, stored_settings},
    rays::{Mirror, RaySpace},
};

/// Random paths looked at. A part of the space that breaks a symmetry and that only one path in a
/// hundred comes near is met all but surely.
const PATHS: usize = 768;

/// Places along each.
const PLACES: usize = 24;

/// The mirrors of the rays of `plan`.
pub fn of(space: &RaySpace, plan: &PlanRecord) -> Vec<Mirror> {
    let rays = random_rays(space, PATHS);
    let along = |_: usize, length: f64| {
        let places = 0..PLACES;
        places
            .map(|k| length * k as f64 / (PLACES - 1) as f64)
            .collect()
    };
    let settings = stored_settings(space, plan.tolerance);
    let probed: Vec<Probed> = probe(space.manifold(), settings, plan.length, &rays, along);
    let probes = probed.iter().flat_map(|path| &path.probes);
    let states: Vec<_> = probes.map(|probe| (probe.u, probe.v)).collect();
    match states.is_empty() {
        true => Vec::new(),
        false => Mirror::find(space, &states),
    }
}
