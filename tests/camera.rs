//! The camera against what is known of parallel transport: holonomy is area times curvature.

mod support;

use geofan_core::{diagnostic::SourceText, manifold::Manifold};
use geofan_render::{Camera, Journey, scene::PoseFile};
use glam::{DQuat, DVec3};
use std::f64::consts::PI;

fn manifold(text: &str) -> Manifold {
    Manifold::from_source(SourceText::new("test.toml", text), &[]).unwrap()
}

fn sphere() -> Manifold {
    manifold(
        "name = 's3'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '2/(1 + x^2 + y^2 + z^2)' }",
    )
}

fn sphere_times_line() -> Manifold {
    manifold(
        "name = 's2xr'\ncoordinates = ['x', 'y', 'z']\nmetric = { xx = '4/(1 + x^2 + y^2)^2', yy = '4/(1 + x^2 + y^2)^2', zz = '1' }",
    )
}

/// A triangle of great arcs: sides b and c that enclose the angle A. Its third side, the other
/// angles (the one at the end of c first), and its area.
fn triangle(b: f64, c: f64, angle: f64) -> (f64, [f64; 2], f64) {
    let a = (b.cos() * c.cos() + b.sin() * c.sin() * angle.cos()).acos();
    let opposite =
        |x: f64, y: f64, z: f64| ((x.cos() - y.cos() * z.cos()) / (y.sin() * z.sin())).acos();
    let (at_c, at_b) = (opposite(b, a, c), opposite(c, a, b));
    (a, [at_c, at_b], angle + at_b + at_c - PI)
}

/// Walks around the triangle in the plane of `first` and the axis-right-angled `second`.
fn walked(
    manifold: &Manifold,
    start: Camera,
    [first, second]: [DVec3; 2],
    (b, c, angle): (f64, f64, f64),
) -> (Camera, f64) {
    let (a, [at_c, at_b], area) = triangle(b, c, angle);
    let normal = first.cross(second);
    let legs = [(c, 0.0), (a, PI - at_c), (b, PI - at_c + PI - at_b)];
    let end = legs.iter().fold(start, |camera, (length, turn)| {
        let moved = camera.moved(
            manifold,
            DQuat::from_axis_angle(normal, *turn) * first * *length,
        );
        assert!((moved.length - length).abs() < 1e-12);
        moved.camera
    });
    (end, area)
}

#[test]
fn a_loop_on_the_three_sphere_turns_the_camera_by_its_area() {
    let s3 = sphere();
    let start = Camera {
        u: DVec3::new(0.3, -0.2, 0.4),
        rotation: DQuat::from_xyzw(0.1, 0.7, -0.3, 0.5).normalize(),
    };
    for (b, c, angle) in [
        (0.3, 0.4, 0.9),
        (1.1, 0.7, 2.0),
        (PI / 2.0, PI / 2.0, PI / 2.0),
    ] {
        let plane = [
            DVec3::new(1.0, 2.0, 0.5).normalize(),
            DVec3::new(-2.0, 1.0, 0.0).normalize(),
        ];
        let (end, area) = walked(&s3, start, plane, (b, c, angle));
        assert!((end.u - start.u).length() < 1e-9, "{}", end.u);
        let holonomy = start.rotation.inverse() * end.rotation;
        let expected = DQuat::from_axis_angle(plane[0].cross(plane[1]), area);
        assert!(
            holonomy.dot(expected).abs() > 1.0 - 1e-14,
            "{holonomy} {expected}"
        );
        assert!(holonomy.angle_between(expected) < 1e-7);
    }
}

#[test]
fn a_loop_on_the_sphere_factor_turns_about_the_line_and_one_along_the_line_does_not() {
    let space = sphere_times_line();
    let start = Camera {
        u: DVec3::new(0.4, 0.1, 2.0),
        rotation: DQuat::from_rotation_z(0.3),
    };
    let (end, area) = walked(&space, start, [DVec3::X, DVec3::Y], (0.8, 1.2, 1.3));
    assert!((end.u - start.u).length() < 1e-9);
    let holonomy = start.rotation.inverse() * end.rotation;
    assert!(holonomy.angle_between(DQuat::from_rotation_z(area)) < 1e-7);
    let up_and_back = start
        .moved(&space, DVec3::Z * 1.5)
        .camera
        .moved(&space, DVec3::Z * -1.5)
        .camera;
    assert!(up_and_back.rotation.angle_between(start.rotation) < 1e-7);
}

#[test]
fn a_hundred_thousand_small_moves_do_not_drift() {
    // Round a great circle of the three-sphere 16 times: back at the start, not turned.
    let s3 = sphere();
    let start = Camera {
        u: DVec3::new(0.3, -0.2, 0.1),
        rotation: DQuat::from_rotation_y(0.4),
    };
    let moves = 100_000;
    let by = DVec3::new(0.2, 0.5, -0.4).normalize() * (32.0 * PI / f64::from(moves));
    let mut camera = start;
    for _ in 0..moves {
        camera = camera.moved(&s3, by).camera;
    }
    assert!(
        (camera.u - start.u).length() < 1e-7,
        "{}",
        camera.u - start.u
    );
    assert!((camera.rotation.length() - 1.0).abs() < 1e-15);
    assert!(camera.rotation.dot(start.rotation).abs() > 1.0 - 1e-14);
}

#[test]
fn a_camera_stops_where_the_space_ends() {
    let cut = manifold(
        "name = 'cut'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '2' }\n[domain]\nx = [-1, 1]\ny = [0, 3]\nperiodic = ['y']",
    );
    let camera = Camera {
        u: DVec3::new(0.5, 1.0, 0.0),
        rotation: DQuat::IDENTITY,
    };
    let moved = camera.moved(&cut, DVec3::X * 10.0);
    assert!((moved.length - 1.0).abs() < 1e-9 && (moved.camera.u.x - 1.0).abs() < 1e-9);
    let round = camera.moved(&cut, DVec3::Y * 7.0);
    assert!((round.camera.u.y - 1.5).abs() < 1e-9, "{}", round.camera.u);
    let nowhere = camera.moved(&cut, DVec3::ZERO);
    assert_eq!(nowhere.camera, camera);
}

#[test]
fn turning_is_in_the_cameras_own_axes() {
    let camera = Camera::looking(DVec3::ZERO, DVec3::X, DVec3::Z);
    let axes = glam::DMat3::from_quat(camera.rotation);
    assert!(axes.x_axis.abs_diff_eq(-DVec3::Y, 1e-15) && axes.y_axis.abs_diff_eq(DVec3::Z, 1e-15));
    // A quarter turn to the left about its own upward axis: it now looks where its left was.
    let left = camera.turned(DQuat::from_rotation_y(PI / 2.0));
    assert!((left.rotation * -DVec3::Z).abs_diff_eq(DVec3::Y, 1e-15));
}

#[test]
fn a_camera_goes_through_a_portal_and_round_its_edge_past_it() {
    let space = support::asset("portal");
    let start = Camera::looking(DVec3::new(0.9, 0.1, 0.1), DVec3::X, DVec3::Z);
    let through = start.moved(&space, DVec3::NEG_Z * 0.215).camera;
    assert!(
        through.u.abs_diff_eq(DVec3::new(-3.885, 0.1, 0.1), 1e-9),
        "{}",
        through.u
    );
    assert!(through.rotation.angle_between(start.rotation) < 1e-9);
    let back = through.moved(&space, DVec3::Z * 0.215).camera;
    assert!(back.u.abs_diff_eq(start.u, 1e-9), "{}", back.u);
    let beside = Camera {
        u: DVec3::new(0.9, 1.1, 0.1),
        ..start
    };
    let past = beside.moved(&space, DVec3::NEG_Z * 0.215).camera;
    assert!(
        past.u.abs_diff_eq(DVec3::new(1.115, 1.1, 0.1), 1e-9),
        "{}",
        past.u
    );
}

#[test]
fn a_way_recorded_through_a_portal_leads_through_it_and_none_leads_through_the_disc() {
    let space = support::asset("portal");
    let pose = |time: f64, x: f64| {
        format!("[[pose]]\ntime = {time}\nat = [{x}, 0.1, 0.1]\nlook = [1, 0, 0]\nup = [0, 0, 1]\n")
    };
    let read = |text: String| PoseFile::parse(SourceText::new("way.toml", text), 90.0).unwrap();
    let way = read(
        [
            pose(0.0, 0.5),
            pose(1.0, 0.9),
            pose(2.0, -3.9),
            pose(3.0, -3.5),
        ]
        .concat(),
    );
    let journey = Journey::new(&space, &way).unwrap();
    let mut before = journey.pose(0.0).0.u.x;
    for k in 1..=60 {
        let x = journey.pose(f64::from(k) * 0.05).0.u.x;
        // Ahead, by small steps; at x = 1 on at x = −4.
        let jump = if before > 0.0 && x < 0.0 { 5.0 } else { 0.0 };
        assert!((0.0..0.1).contains(&(x + jump - before)), "{before} {x}");
        before = x;
    }
    assert!((before + 3.5).abs() < 1e-6);
    let behind = read(pose(0.0, 0.9) + &pose(1.0, 1.1));
    assert!(Journey::new(&space, &behind).is_err());
}

#[test]
fn a_journey_joined_as_time_goes_by_is_the_same_bit_for_bit() {
    let s3 = sphere();
    let pose = |k: i32| {
        let a = 0.4 * f64::from(k);
        format!(
            "[[pose]]\ntime = {k}\nat = [{}, {}, 0.1]\nlook = [{}, 1, 0]\nup = [0, 0, 1]\n",
            0.5 * a.cos(),
            0.5 * a.sin(),
            a.sin()
        )
    };
    let text: String = (0..12).map(pose).collect();
    let poses = PoseFile::parse(SourceText::new("way.toml", text), 90.0).unwrap();
    let whole = Journey::new(&s3, &poses).unwrap();
    let mut growing = Journey::begin(&s3, &poses).unwrap();
    for k in 0..=44 {
        let time = f64::from(k) * 0.25;
        growing.reach(time).unwrap();
        assert_eq!(growing.pose(time), whole.pose(time), "{time}");
    }
}
