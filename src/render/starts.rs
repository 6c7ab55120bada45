//! Where the rays of a picture start.
//!
//! In: a view and points of its picture. Out: chart points and tangents. Most rays start at the camera;
//! others at the ends of short geodesics from it, along which their directions are carried.

use super::view::View;
use crate::{
    geodesic::{Ray, Settings, ends},
    manifold::{Carried, Manifold},
};
use glam::{DQuat, DVec2, DVec3};

/// The start of a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Start {
    /// Chart point.
    pub u: DVec3,
    /// Its direction in the standard frame there, unit.
    pub direction: DVec3,
    /// Unit tangent, chart components.
    pub v: DVec3,
}

/// Local tolerance of the geodesics to the starts: far below that of the rays, whose directions it turns.
const TOLERANCE: f64 = 1e-11;

/// Starts of the rays through `points` of the picture; none where the space ends before.
pub fn starts(
    manifold: &Manifold,
    view: &View,
    points: impl Iterator<Item = DVec2>,
) -> Vec<Option<Start>> {
    let rays = points.map(|at| view.ray(at.x, at.y));
    if view.is_central() {
        let frame = manifold.standard_frame(view.u);
        let start = |direction: DVec3| Start {
            u: view.u,
            direction,
            v: frame * direction,
        };
        return rays.map(|ray| Some(start(ray.direction))).collect();
    }
    let rays: Vec<_> = rays.collect();
    let settings = Settings {
        tolerance: TOLERANCE,
        carried: Carried {
            frame: true,
            deviation: false,
        },
        events: true,
    };
    let frame = manifold.standard_frame(view.u);
    let ways = rays.iter().map(|ray| {
        let d = ray.offset.try_normalize().unwrap_or(DVec3::X);
        Ray::in_frame(frame, view.u, d, ray.offset.length())
    });
    let mut reached = ends(manifold, settings, ways);
    reached.resize(rays.len(), None);
    let start = |(ray, end): (
        &super::view::PictureRay,
        Option<(crate::geodesic::Step, f64)>,
    )| {
        let wanted = ray.offset.length();
        let (u, turn) = match end {
            _ if wanted == 0.0 => (view.u, DQuat::IDENTITY),
            Some((step, s)) if s >= wanted => {
                let u = manifold.domain.wrap(step.position(wanted));
                (u, step.rotation(wanted).unwrap_or(DQuat::IDENTITY))
            }
            _ => return None,
        };
        let direction = turn * ray.direction;
        let v = manifold.standard_frame(u) * direction;
        Some(Start { u, direction, v })
    };
    rays.iter().zip(reached).map(start).collect()
}
