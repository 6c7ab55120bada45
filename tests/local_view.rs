//! The local view: its rasteriser against rays, and its error against distance.

use geofan_render::{
    Seen, Stage,
    accel::TimedChord,
    frame::{Paths, offsets, trace},
    local::projection,
    scene::CameraPosition,
};
use geofan_study::comparison::compare_local;
use glam::DVec3;
use std::path::Path;

fn stage(folder: &Path, metric: &str, objects: &str) -> Stage {
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).unwrap();
    write(
        "space.toml",
        &format!(
            "name = 'space'\ncoordinates = ['x', 'y', 'z']\n{metric}\n[cameras]\nlength = 6\n"
        ),
    );
    write(
        "square.obj",
        "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3 4\n",
    );
    write(
        "scene.toml",
        &format!(
            "manifold = 'space.toml'\n[camera]\nat = [0.1, -0.2, 0.3]\nlook = [1, 0.1, -0.1]\nup = [0, 0.2, 1]\nfov = 80\n{objects}"
        ),
    );
    Stage::load(&folder.join("scene.toml"), &[]).unwrap()
}

/// Many squares around and behind the camera, cut by each other and by the plane of the camera.
const CLUTTER: &str = "
[[object]]\nmesh = 'square.obj'\nat = [1.0, 0.2, 0.1]\nscale = 0.4\nrotate = { axis = [1, 1, 0], degrees = 70 }
[[object]]\nmesh = 'square.obj'\nat = [1.2, -0.3, 0.4]\nscale = 0.5\nrotate = { axis = [0, 1, 0], degrees = 80 }
[[object]]\nmesh = 'square.obj'\nat = [0.0, 0.0, -0.2]\nscale = 2.0
[[object]]\nmesh = 'square.obj'\nat = [-1.0, 0.0, 0.0]\nscale = 0.7\nrotate = { axis = [0, 1, 0], degrees = 90 }
";

#[test]
fn in_flat_space_the_local_view_is_the_exact_one() {
    let folder = tempfile::tempdir().unwrap();
    // A skewed chart of flat space, so that the frame matters.
    let metric =
        "metric = { xx = '1', yy = '1.49', zz = '1.09', xy = '0.7', xz = '0.3', yz = '0.21' }";
    let stage = stage(folder.path(), metric, CLUTTER);
    let view = stage.view(&stage.scene.camera, (90, 60)).unwrap();
    let found = compare_local(&stage.world, &view, 1, 6.0, 1e-9).unwrap();
    // An edge may fall on either side of the middle of a pixel.
    let wrong = found.flip.iter().filter(|e| **e > 0.01).count();
    assert!(wrong <= 5, "{wrong} pixels differ");
    for distance in &found.report.distances {
        assert!(distance.mrad.max < 1e-3, "{distance:?}");
    }
}

/// What is seen a period on, or behind a face, is as far away and lit from the side as it is seen there.
#[test]
fn in_flat_glued_spaces_the_local_view_is_the_exact_one() {
    let glue = |k: usize, high: &str, low: &str| {
        let moved = |sign: &str| {
            let mut map = ["x", "y", "z"].map(String::from);
            map[k] += sign;
            format!("['{}']", map.join("', '"))
        };
        let [on, back] = [" - 4", " + 4"].map(moved);
        format!("[[glue]]\nface = '{high}'\nmap = {on}\n[[glue]]\nface = '{low}'\nmap = {back}\n")
    };
    let flat = "metric = { conformal = '1' }\n";
    let periodic = "domain = { x = [-2, 2], y = [-2, 2], periodic = ['x', 'y'] }";
    let glued = glue(0, "2 - x", "x + 2") + &glue(1, "2 - y", "y + 2");
    for space in [periodic, &glued] {
        let folder = tempfile::tempdir().unwrap();
        let stage = stage(folder.path(), &format!("{flat}{space}"), CLUTTER);
        let view = stage.view(&stage.scene.camera, (90, 60)).unwrap();
        let found = compare_local(&stage.world, &view, 1, 3.0, 1e-9).unwrap();
        let wrong = found.flip.iter().filter(|e| **e > 0.01).count();
        assert!(wrong <= 10, "{wrong} pixels differ");
    }
}

#[test]
fn what_is_farther_than_paths_are_long_is_not_seen() {
    let folder = tempfile::tempdir().unwrap();
    let stage = stage(folder.path(), "metric = { conformal = '1' }", CLUTTER);
    let view = stage.view(&stage.scene.camera, (90, 60)).unwrap();
    let outcomes = trace(&stage.world, &view, Paths::Straight(0.9), &offsets(1)).outcomes;
    let length = |seen: &Seen| match seen {
        Seen::Surface(hit) => Some(hit.s),
        _ => None,
    };
    let lengths: Vec<f32> = outcomes.iter().filter_map(length).collect();
    assert!(lengths.len() > 100 && lengths.iter().all(|s| *s <= 0.9));
}

/// Of the points that stand for one place, some in coordinates beyond the seam.
#[test]
fn a_camera_given_whole_periods_off_sees_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let torus = "metric = { conformal = '1' }\ndomain = { x = [-2, 2], periodic = ['x'] }";
    let stage = stage(folder.path(), torus, CLUTTER);
    let seen = |periods: f64| {
        let mut camera = stage.scene.camera.clone();
        camera.position = CameraPosition::Chart(DVec3::new(0.1 + 4.0 * periods, -0.2, 0.3));
        let view = stage.view(&camera, (60, 40)).unwrap();
        assert!((view.u - DVec3::new(0.1, -0.2, 0.3)).length() < 1e-14);
        let outcomes = trace(&stage.world, &view, Paths::Straight(6.0), &offsets(1)).outcomes;
        let hit = |seen: &Seen| match seen {
            Seen::Surface(hit) => Some(hit.triangle),
            _ => None,
        };
        outcomes.iter().map(hit).collect::<Vec<_>>()
    };
    let own = seen(0.0);
    assert!(own.iter().flatten().count() > 1000);
    for periods in [-3.0, 1.0, 2.0] {
        let off = seen(periods);
        // By rounding an edge may fall on either side of the middle of a pixel.
        let differ = off.iter().zip(&own).filter(|(a, b)| a != b).count();
        assert!(differ <= 2, "{periods}: {differ}");
    }
}

#[test]
fn depths_and_weights_are_those_of_the_straight_lines() {
    let folder = tempfile::tempdir().unwrap();
    let stage = stage(
        folder.path(),
        "metric = { conformal = '2/(1 + x^2 + y^2 + z^2)' }",
        CLUTTER,
    );
    let view = stage.view(&stage.scene.camera, (60, 40)).unwrap();
    let outcomes = trace(&stage.world, &view, Paths::Straight(6.0), &offsets(1)).outcomes;
    let mut hits = 0;
    for ((y, x, _), seen) in outcomes.indexed_iter() {
        let Seen::Surface(hit) = *seen else {
            continue;
        };
        hits += 1;
        let d = view.direction(x as f64 + 0.5, y as f64 + 0.5);
        let v = stage.world.manifold.standard_frame(view.u) * d;
        // Weights and arc lengths are in single precision.
        assert!((view.u + v * f64::from(hit.s) - stage.world.point(&hit)).length() < 1e-6);
        let chord = TimedChord {
            ends: [view.u, view.u + v * (f64::from(hit.s) * 1.001)],
            s: [0.0, f64::from(hit.s) * 1.001],
        };
        let nearer = stage.world.accelerator.first_hit_on_chord(&chord);
        let nearer = nearer.expect("the triangle is on the line");
        assert!((nearer.t * 1.001 - 1.0).abs() < 1e-7, "{x} {y}");
    }
    assert!(hits > 1000, "{hits}");
}

/// An object may be written at any of its images.
#[test]
fn objects_of_glued_spaces_are_near_wherever_they_were_put() {
    let seen = |at: [f64; 3]| {
        let folder = tempfile::tempdir().unwrap();
        let glued = |face: &str, map: &str| format!("[[glue]]\nface = '{face}'\nmap = [{map}]\n");
        let metric = "metric = { conformal = '1' }\n".to_owned()
            + &glued("1 - x", "'x - 2', 'y', 'z'")
            + &glued("1 + x", "'x + 2', 'y', 'z'")
            + &glued("1 - z", "'-x', '-y', 'z - 2'")
            + &glued("1 + z", "'-x', '-y', 'z + 2'");
        let object = format!(
            "[[object]]\nmesh = 'square.obj'\nat = {at:?}\nscale = 0.2\nrotate = {{ axis = [0, 1, 0], degrees = 80 }}\n"
        );
        let stage = stage(folder.path(), &metric, &object);
        let view = stage.view(&stage.scene.camera, (60, 40)).unwrap();
        let outcomes = trace(&stage.world, &view, Paths::Straight(6.0), &offsets(1)).outcomes;
        let surface = |seen: &&Seen| matches!(seen, Seen::Surface(_));
        outcomes.iter().filter(surface).count()
    };
    let near = seen([0.9, -0.1, 0.2]);
    assert!(near > 100, "{near}");
    // Three cells over and four up.
    assert_eq!(seen([0.9 + 6.0, -0.1, 0.2 + 8.0]), near);
}

#[test]
fn the_local_views_error_grows_in_proportion_to_the_distance() {
    let folder = tempfile::tempdir().unwrap();
    let bump = "embedding = ['x', 'y', 'z', 'exp(-(x^2 + y^2 + z^2)/2)']";
    let stage = stage(folder.path(), bump, "");
    let view = stage.view(&stage.scene.camera, (64, 64)).unwrap();
    let manifold = &stage.world.manifold;
    // Where a geodesic is after the length s, against the direction in which it left.
    let error = |d: DVec3, s: f64| {
        use geofan_core::geodesic::{Ray, Settings, ends};
        let settings = Settings::bare(1e-12);
        let (step, reached) = ends(manifold, settings, [Ray::new(manifold, view.u, d, s)])
            .remove(0)
            .unwrap();
        let p = view.camera().rotation * projection(&stage.world, &view, step.position(reached));
        p.normalize().cross(d).length()
    };
    for d in [
        DVec3::new(1.0, 0.3, -0.2),
        DVec3::new(0.2, -1.0, 0.7),
        DVec3::new(-0.4, 0.5, 0.6),
    ] {
        let d = d.normalize();
        for s in [0.1, 0.05, 0.025] {
            let ratio = error(d, s) / error(d, 0.5 * s);
            assert!((1.7..2.3).contains(&ratio), "{d} {s}: {ratio}");
        }
    }
}
