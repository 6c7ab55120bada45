//! Moving a camera through a space that may end, and staying where a table knows all paths.
//!
//! In: a camera, and a move in its own axes, a length in the metric. Out: a [`Movement`]: the camera
//! afterwards, its axes transported in parallel, and what stopped it. A camera stays inside the domain and on this
//! side of exits always. Where a table holds it, it stays in the table's region too: it goes up to the edge, or along the
//! region where that is a curve or a surface.

use geofan_bundle::Table;
use geofan_core::{
    geodesic::check_start,
    manifold::{EventKind, Gluing, Manifold},
};
use geofan_render::Camera;
use glam::DVec3;

/// A camera after a move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Movement {
    /// The camera where it is now.
    pub camera: Camera,
    /// The reason for which it came less far than was asked for.
    pub stop: Option<StopReason>,
}

/// Reasons for which a camera stops.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StopReason {
    /// The exit with this index in [`Manifold::exits`], or a limit of the chart.
    Exit(usize),
    /// The metric allows no further step.
    Metric,
    /// A mirror, or a face behind which right and left have changed places.
    Mirror,
    /// The edge of the region in which the table knows all paths.
    Region,
}

/// Share of the way to the end of the space that a camera goes: at the very end rounding decides on which
/// side it is.
const SHORT_OF_END: f64 = 0.99;

/// Halvings by which the edge of a region is found: to 1/4096 of one move, far below what a picture shows.
const HALVINGS: usize = 12;

/// Moves `camera` by `by`, held in the region of `table` if there is one and the camera is in it.
pub fn moved(manifold: &Manifold, table: Option<&Table>, camera: &Camera, by: DVec3) -> Movement {
    let free = within_domain(manifold, camera, by);
    let Some(table) = table.filter(|table| table.space.place(camera.u).is_ok()) else {
        return free;
    };
    if table.space.place(free.camera.u).is_ok() {
        return free;
    }
    let held = along_region(manifold, table, camera, free.camera.u);
    Movement {
        camera: held.unwrap_or_else(|| up_to_edge(manifold, table, camera, by)),
        stop: Some(StopReason::Region),
    }
}

/// Moves as far as the domain goes.
fn within_domain(manifold: &Manifold, camera: &Camera, by: DVec3) -> Movement {
    let stay = |stop| Movement {
        camera: *camera,
        stop,
    };
    let wanted = by.length();
    if !(wanted > 0.0 && wanted.is_finite()) {
        return stay(None);
    }
    let went = camera.moved(manifold, by);
    let ended = went.length < wanted * (1.0 - 1e-9);
    let (camera, stop) = match ended {
        false => (went.camera, None),
        true => {
            let short = by * (SHORT_OF_END * went.length / wanted);
            let stop = what_ended(manifold, went.camera.u);
            (camera.moved(manifold, short).camera, Some(stop))
        }
    };
    match check_start(manifold, "the camera", camera.u) {
        Ok(()) if camera.rotation.is_finite() => Movement { camera, stop },
        _ => stay(stop.or(Some(StopReason::Metric))),
    }
}

/// Finds what ended a move at `u`: a mirror, or the event of the domain whose value is nearest to its zero there.
fn what_ended(manifold: &Manifold, u: DVec3) -> StopReason {
    if manifold
        .gluing()
        .is_some_and(|gluing| is_on_mirror(gluing, u))
    {
        return StopReason::Mirror;
    }
    let values = manifold.domain.events().at(&[u.x, u.y, u.z, 0.0, 0.0, 0.0]);
    let kinds = manifold.domain.kinds.iter().zip(values);
    let nearest = kinds
        .filter(|(_, value)| value.is_finite())
        .min_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
    let named = |name: &str| {
        manifold
            .exit_named(name)
            .map_or(StopReason::Metric, StopReason::Exit)
    };
    match nearest {
        Some((EventKind::Exit(exit), _)) => StopReason::Exit(*exit),
        Some((EventKind::Limit, _)) => named("limit"),
        Some((EventKind::Inside, _)) => named("inside"),
        None => StopReason::Metric,
    }
}

/// Tells whether `u` is on a face that turns right into left.
fn is_on_mirror(gluing: &Gluing, u: DVec3) -> bool {
    let values = gluing.values().at(&u.to_array());
    let faces = gluing.faces().iter().zip(values).enumerate();
    faces.into_iter().any(|(k, (face, value))| {
        face.reverses() && value.abs() <= gluing.guard(k) && gluing.is_open(k, u)
    })
}

/// Moves to the place of the region that is nearest to `target`, where the region is given by its parameters
/// alone; `None` where a symmetry spreads it, or there is no way on.
fn along_region(
    manifold: &Manifold,
    table: &Table,
    camera: &Camera,
    target: DVec3,
) -> Option<Camera> {
    let region = manifold.cameras.as_ref()?;
    let here = table.space.place(camera.u).ok()?.parameters;
    let itself = here.len() == region.dimension()
        && (region.at(&here) - camera.u).length() <= 1e-6 * (1.0 + camera.u.length());
    let to = itself.then(|| region.at(&region.nearest(target, here)))?;
    table.space.place(to).ok()?;
    check_start(manifold, "the camera", to).ok()?;
    // The geodesic that begins towards that place ends beside it by the square of a small move.
    let by = camera.axes(manifold).inverse() * (to - camera.u);
    let carried = camera.moved(manifold, by).camera;
    Some(Camera { u: to, ..carried })
}

/// Moves to the edge of the region.
fn up_to_edge(manifold: &Manifold, table: &Table, camera: &Camera, by: DVec3) -> Camera {
    let (mut best, mut inside, mut outside) = (*camera, 0.0, 1.0);
    for _ in 0..HALVINGS {
        let share = 0.5 * (inside + outside);
        let there = within_domain(manifold, camera, by * share).camera;
        match table.space.place(there.u) {
            Ok(_) => (best, inside) = (there, share),
            Err(_) => outside = share,
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::tests::{bundle, manifold};
    use approx::assert_abs_diff_eq;

    const SPHERE: &str = "metric = { conformal = '2/(1 + x^2 + y^2 + z^2)' }";

    fn camera(u: DVec3) -> Camera {
        Camera::looking(u, DVec3::X, DVec3::Z)
    }

    #[test]
    fn around_a_great_circle_the_camera_comes_home_with_the_axes_it_left_with() {
        let sphere = manifold(SPHERE);
        let start = camera(DVec3::new(0.3, 0.1, -0.2));
        let mut now = start;
        let steps = 500;
        for _ in 0..steps {
            let by = DVec3::new(0.6, 0.0, -0.8) * (std::f64::consts::TAU / f64::from(steps));
            now = moved(&sphere, None, &now, by).camera;
        }
        assert_abs_diff_eq!((now.u - start.u).length(), 0.0, epsilon = 1e-8);
        assert!(now.rotation.angle_between(start.rotation) < 1e-7);
    }

    #[test]
    fn the_end_of_the_space_stops_the_camera_before_it_and_is_named() {
        let flat =
            manifold("metric = { conformal = '1' }\nexit = [{ name = 'out', when = 'x - 2' }]");
        let start = camera(DVec3::ZERO);
        let ahead = DVec3::NEG_Z;
        let end = moved(&flat, None, &start, ahead * 5.0);
        assert_eq!(
            end.stop,
            Some(StopReason::Exit(flat.exit_named("out").unwrap()))
        );
        assert!(end.camera.u.x > 1.9 && end.camera.u.x < 2.0);
        let mut stuck = end.camera;
        for _ in 0..50 {
            stuck = moved(&flat, None, &stuck, ahead * 0.3).camera;
        }
        assert!(stuck.u.x <= 2.0);
        let back = moved(&flat, None, &stuck, ahead * -1.0);
        assert!(back.stop.is_none() && back.camera.u.x < 1.5);
    }

    #[test]
    fn the_metric_s_end_is_never_entered() {
        let cone = manifold("metric = { conformal = '1/x' }\n[domain]\ninside = ['x - 0.01']");
        let mut now = camera(DVec3::new(1.0, 0.0, 0.0));
        for _ in 0..200 {
            let went = moved(&cone, None, &now, DVec3::Z * 0.1);
            now = went.camera;
            assert!(cone.domain.violation(now.u).is_none());
        }
    }

    #[test]
    fn a_mirror_stops_the_camera_before_it_and_lets_it_go_back() {
        let hall = manifold(
            "metric = { conformal = '1' }\nexit = [{ name = 'sky', when = 'x^2 + y^2 + z^2 - 36' }]\n[[glue]]\nface = '1 - x'\nmirror = true",
        );
        let mut now = camera(DVec3::new(0.5, 0.1, 0.2));
        for _ in 0..20 {
            let went = moved(&hall, None, &now, DVec3::NEG_Z * 0.3);
            now = went.camera;
            assert_eq!(went.stop.is_some(), now.u.x > 0.9);
            assert!(went.stop.is_none_or(|stop| stop == StopReason::Mirror));
        }
        assert!(now.u.x > 0.99 && now.u.x <= 1.0, "{}", now.u);
        let back = moved(&hall, None, &now, DVec3::Z);
        assert!(back.stop.is_none() && back.camera.u.x < 0.1);
    }

    #[test]
    fn a_rail_is_followed_whatever_direction_is_asked_for() {
        let bundle = bundle("three-bumps-rail");
        let region = bundle.manifold.cameras.clone().unwrap();
        let middle = region.at(&region.lerp(&[0.5; 3]));
        let mut now = camera(middle);
        let mut farthest = 0.0_f64;
        for k in 0..40 {
            let by = DVec3::new(0.05, 0.02, if k < 20 { -0.1 } else { 0.2 });
            now = moved(&bundle.manifold, Some(&bundle.table), &now, by).camera;
            assert!(
                bundle.table.space.place(now.u).is_ok(),
                "step {k} at {}",
                now.u
            );
            farthest = farthest.max((now.u - middle).length());
        }
        assert!(farthest > 0.1, "it moves at all: {farthest}");
    }

    #[test]
    fn under_a_symmetry_the_camera_goes_up_to_the_edge_and_no_further() {
        let bundle = bundle("s3");
        let region = bundle.manifold.cameras.clone().unwrap();
        let start = region.at(&region.lerp(&[0.5; 3]));
        let mut now = camera(start);
        let mut stopped = false;
        for _ in 0..400 {
            let went = moved(
                &bundle.manifold,
                Some(&bundle.table),
                &now,
                DVec3::NEG_Z * 0.02,
            );
            stopped |= went.stop == Some(StopReason::Region);
            now = went.camera;
            assert!(bundle.table.space.place(now.u).is_ok());
        }
        let edge = region.at(&[region.intervals[0][1]]);
        assert!(stopped);
        assert_abs_diff_eq!(
            now.u.length(),
            edge.length(),
            epsilon = 1e-3 * edge.length()
        );
    }
}
