//! Samples of a picture that see nothing because their paths were not followed far enough.
//!
//! In: what every sample of its parts sees. Out: [`UnfinishedPaths`], and, where the scene has no sky for
//! them, the length with which they would see something.

use super::{
    frame::{Outcomes, offsets},
    intersect::{Seen, first_seen},
    starts::starts,
    view::View,
    world::World,
};
use geofan_core::geodesic::{Ray, UnfinishedPaths};
use geofan_core::parallel::*;
use glam::{DVec2, DVec3};

/// Counts the samples whose paths end by their length or where the metric ends; those without a path do not
/// count.
pub fn count_unfinished<'o>(outcomes: impl IntoIterator<Item = &'o Outcomes>) -> UnfinishedPaths {
    let (mut by_length, mut singular, mut all) = (0, 0, 0);
    for seen in outcomes.into_iter().flatten() {
        by_length += usize::from(*seen == Seen::Length);
        singular += usize::from(*seen == Seen::Singular);
        all += usize::from(*seen != Seen::Nothing);
    }
    UnfinishedPaths::counted(by_length, singular, all)
}

/// Paths followed farther by one thread at a time: two fillings of the integrator's lanes.
const BLOCK: usize = 64;

/// Counts the samples likewise, and finds the length that would do by following some of them farther than
/// `length`, exactly at a local `tolerance`, if the scene has no sky for them. The outcomes of each part of the
/// picture are of the first samples of each pixel, out of any number.
pub fn unfinished(
    world: &World,
    parts: &[(View, Outcomes)],
    (length, tolerance): (f64, f64),
) -> UnfinishedPaths {
    let counted = count_unfinished(parts.iter().map(|(_, outcomes)| outcomes));
    if world.has_length_sky() {
        return counted;
    }
    counted.followed(length, |length| {
        let ray = |(u, v): (DVec3, DVec3)| (Ray::without_spread(u, v, length), 0.0);
        let sampled = sampled_starts(world, parts).into_iter().map(ray);
        let rays: Vec<(Ray, f64)> = sampled.collect();
        let seen = rays
            .par_chunks(BLOCK)
            .flat_map_iter(|rays| first_seen(world, rays, tolerance));
        let end = |seen: Seen| match seen {
            Seen::Surface(hit) => Some(f64::from(hit.s)),
            Seen::Sky { s, .. } => Some(f64::from(s)),
            Seen::Nothing | Seen::Length | Seen::Singular => None,
        };
        seen.map(end).collect()
    })
}

/// Finds the starts (chart point, tangent) of some of the samples that end by length, evenly.
fn sampled_starts(world: &World, parts: &[(View, Outcomes)]) -> Vec<(DVec3, DVec3)> {
    let places = parts.iter().enumerate().flat_map(|(part, (_, outcomes))| {
        let by_length = outcomes.indexed_iter();
        let by_length = by_length.filter(|(_, seen)| **seen == Seen::Length);
        by_length.map(move |(place, _)| (part, place))
    });
    let places: Vec<_> = places.collect();
    let sample = UnfinishedPaths::sample(&places);
    let in_part = |(part, (view, outcomes)): (usize, &(View, Outcomes))| {
        let offsets = offsets(outcomes.dim().2);
        let own = sample.iter().filter(|(of, _)| *of == part);
        let points = own.map(|(_, (y, x, k))| DVec2::new(*x as f64, *y as f64) + offsets[*k]);
        starts(&world.manifold, view, points)
    };
    let found = parts.iter().enumerate().flat_map(in_part).flatten();
    found.map(|start| (start.u, start.v)).collect()
}
