//! Where the rays of a picture start.
//!
//! In: a view and points of its picture. Out: chart points and tangents. Most rays start at the camera;
//! others at the ends of short geodesics from it, along which their directions are carried.

use super::view::{PictureRay, View};
use geofan_core::{
    geodesic::{Ray, Settings, Step, ends},
    manifold::Manifold,
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
    let cover = manifold.cover();
    let still = cover.still();
    let settings = Settings::bare(TOLERANCE).with_frame().with_events();
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Camera, Optics};
    use geofan_core::diagnostic::SourceText;

    #[test]
    fn a_wind_carries_light_but_neither_eyes_nor_starts() {
        let text = |wind: &str| {
            let space =
                "name = 'flat'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1' }\n";
            let source = SourceText::new("flat", format!("{space}{wind}"));
            Manifold::from_source(source, &[]).unwrap_or_else(|e| panic!("{}", e.report(false)))
        };
        let windy = text("wind = ['0.3', '0.1*x', '-0.2']\n");
        assert!(windy.has_wind());
        let camera = Camera::looking(DVec3::new(0.5, 0.2, -0.1), DVec3::X, DVec3::Z);
        let view = View::through(&camera, Optics::Orthographic { width: 4.0 }, (8, 6));
        let points = [
            DVec2::new(0.5, 0.5),
            DVec2::new(6.5, 4.0),
            DVec2::new(4.0, 3.0),
        ];
        let found = starts(&windy, &view, points.into_iter());
        for (point, start) in points.iter().zip(found) {
            // Right is -y here, down is -z, and a pixel is half a unit.
            let offset = DVec3::new(0.0, 4.0 - point.x, 3.0 - point.y) * 0.5;
            let (start, u) = (start.unwrap(), camera.u + offset);
            assert!((start.u - u).length() < 1e-9, "{start:?} {u}");
            assert!((start.direction - DVec3::X).length() < 1e-9);
            assert!((start.v - windy.local_frame(u).tangent(DVec3::X)).length() < 1e-9);
        }
        let moved = camera.moved(&windy, DVec3::new(0.7, 0.0, 0.0)).camera;
        assert!((moved.u - camera.u - DVec3::new(0.0, -0.7, 0.0)).length() < 1e-9);
    }
}
