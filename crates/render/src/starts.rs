//! Where the rays of a picture start.
//!
//! In: a view and points of its picture. Out: chart points and tangents. Most rays start at the camera;
//! others at the ends of short geodesics from it, along which their directions are carried.

use super::view::{PictureRay, View};
use geofan_core::{
    geodesic::{Ray, Settings, Step, ends},
    manifold::{Carried, Manifold},
};
use glam::{DQuat, DVec2, DVec3};

/// The start of a ray of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RayStart {
    /// Chart point.
    pub u: DVec3,
    /// Direction in the standard frame there, unit.
    pub direction: DVec3,
    /// Tangent, chart components: of unit length against the wind.
    pub v: DVec3,
}

/// Local tolerance of the geodesics to the starts: far below that of the rays, whose directions it turns.
const TOLERANCE: f64 = 1e-11;

/// Finds the starts of the rays through `points` of the picture; none where the space ends before.
pub fn starts(
    manifold: &Manifold,
    view: &View,
    points: impl Iterator<Item = DVec2>,
) -> Vec<Option<RayStart>> {
    let rays = points.map(|at| view.ray(at.x, at.y));
    if view.is_central() {
        let local = manifold.local_frame(view.u);
        let start = |direction: DVec3| RayStart {
            u: view.u,
            direction,
            v: local.tangent(direction),
        };
        return rays.map(|ray| Some(start(ray.direction))).collect();
    }
    let rays: Vec<PictureRay> = rays.collect();
    let reached = moved(manifold, view.u, &rays);
    let start = |(ray, end): (&PictureRay, Option<(DVec3, DQuat)>)| {
        let (u, turn) = end?;
        let direction = turn * ray.direction;
        let v = manifold.local_frame(u).tangent(direction);
        Some(RayStart { u, direction, v })
    };
    rays.iter().zip(reached).map(start).collect()
}

/// Moves from `u` along the offset of each ray: the point there, and the rotation of what is carried along.
fn moved(manifold: &Manifold, u: DVec3, rays: &[PictureRay]) -> Vec<Option<(DVec3, DQuat)>> {
    // A wind blows light, and no camera.
    let still = manifold.still();
    let settings = Settings {
        tolerance: TOLERANCE,
        carried: Carried {
            frame: true,
            deviation: false,
        },
        events: true,
    };
    let local = still.local_frame(u);
    let ways = rays.iter().map(|ray| {
        let d = ray.offset.try_normalize().unwrap_or(DVec3::X);
        Ray::seen_by(&local, u, d, ray.offset.length())
    });
    let mut reached = ends(&still, settings, ways);
    reached.resize(rays.len(), None);
    let arrival = |(ray, end): (&PictureRay, Option<(Step, f64)>)| {
        let wanted = ray.offset.length();
        match end {
            _ if wanted == 0.0 => Some((u, DQuat::IDENTITY)),
            Some((step, s)) if s >= wanted => {
                let rotation = step.rotation(wanted).unwrap_or(DQuat::IDENTITY);
                Some((manifold.domain.wrap(step.position(wanted)), rotation))
            }
            _ => None,
        }
    };
    rays.iter().zip(reached).map(arrival).collect()
}
