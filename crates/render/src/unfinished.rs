//! Samples of a picture that see nothing because their paths were not followed far enough.
//!
//! In: what every sample sees. Out: [`UnfinishedPaths`], and, where the scene has no sky for them, the
//! length with which they would see something.

use super::{
    frame::{Outcomes, offsets},
    intersect::{Seen, first_seen},
    starts::starts,
    tiles::SamplePlace,
    view::View,
    world::World,
};
use geofan_core::geodesic::{Ray, UnfinishedPaths};
use glam::DVec2;
use rayon::prelude::*;

/// Counts the samples whose paths end by their length or where the metric ends.
pub fn count_unfinished(outcomes: &Outcomes) -> UnfinishedPaths {
    let count = |end: Seen| outcomes.iter().filter(|seen| **seen == end).count();
    let within = outcomes.len() - count(Seen::Outside);
    UnfinishedPaths::counted(count(Seen::Length), count(Seen::Singular), within)
}

/// Paths followed farther by one thread at a time: two fillings of the integrator's lanes.
const BLOCK: usize = 64;

/// Counts the samples likewise, and finds the length that would do by following some of them farther than
/// `length`, exactly at a local `tolerance`, if the scene has no sky for them. The outcomes are of the first
/// samples of each pixel, out of any number.
pub fn unfinished(
    world: &World,
    view: &View,
    outcomes: &Outcomes,
    (length, tolerance): (f64, f64),
) -> UnfinishedPaths {
    let counted = count_unfinished(outcomes);
    if world.has_length_sky() {
        return counted;
    }
    counted.followed(length, |length| {
        let by_length = outcomes.indexed_iter();
        let by_length = by_length.filter(|(_, seen)| **seen == Seen::Length);
        let by_length: Vec<SamplePlace> = by_length.map(|(place, _)| place).collect();
        let offsets = offsets(outcomes.dim().2);
        let sample = UnfinishedPaths::sample(&by_length).into_iter();
        let points = sample.map(|(y, x, k)| DVec2::new(x as f64, y as f64) + offsets[k]);
        let starts = starts(&world.manifold, view, points).into_iter().flatten();
        let rays = starts.map(|start| Ray::new(&world.manifold, start.u, start.direction, length));
        let rays: Vec<Ray> = rays.collect();
        let seen = rays
            .par_chunks(BLOCK)
            .flat_map_iter(|rays| first_seen(world, rays, tolerance));
        let end = |seen: Seen| match seen {
            Seen::Surface(hit) => Some(f64::from(hit.s)),
            Seen::Sky { s, .. } => Some(f64::from(s)),
            Seen::Length | Seen::Singular | Seen::Outside => None,
        };
        seen.map(end).collect()
    })
}
