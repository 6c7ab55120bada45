//! Tests of views: projections, their symmetries, eyes and crops.

use super::*;

/// A camera that looks along −x with +z up: +y is on its right.
fn camera() -> Camera {
    Camera::looking(DVec3::ZERO, -DVec3::X, DVec3::Z)
}

const SIZE: (usize, usize) = (80, 40);

fn all() -> [Optics; 4] {
    [
        Optics::Perspective { fov: 90.0 },
        Optics::Panorama,
        Optics::Fisheye { fov: 200.0 },
        Optics::Orthographic { width: 3.0 },
    ]
}

fn close(a: DVec3, b: DVec3) {
    assert!((a - b).length() < 1e-12, "{a} {b}");
}

#[test]
fn the_middle_of_every_picture_is_ahead_and_right_is_right() {
    for optics in all() {
        let view = View::through(&camera(), optics, SIZE);
        close(view.direction(40.0, 20.0), -DVec3::X);
        assert!(view.is_central() != matches!(optics, Optics::Orthographic { .. }));
        let (right, up) = (view.ray(45.0, 20.0), view.ray(40.0, 15.0));
        let seen = |ray: PictureRay| ray.direction + ray.offset;
        assert!(
            seen(right).y > 0.01 && seen(right).z.abs() < 1e-12,
            "{optics:?}"
        );
        assert!(seen(up).z > 0.01 && seen(up).y.abs() < 1e-12, "{optics:?}");
    }
}

#[test]
fn the_marks_of_each_projection_are_where_they_belong() {
    let view = |optics| View::through(&camera(), optics, SIZE);
    let plane = view(Optics::Perspective { fov: 90.0 });
    close(
        plane.direction(80.0, 20.0),
        DVec3::new(-1.0, 1.0, 0.0).normalize(),
    );
    close(
        plane.direction(40.0, 0.0),
        DVec3::new(-1.0, 0.0, 0.5).normalize(),
    );
    let panorama = view(Optics::Panorama);
    close(panorama.direction(60.0, 20.0), DVec3::Y);
    close(panorama.direction(20.0, 20.0), -DVec3::Y);
    close(panorama.direction(0.0, 20.0), DVec3::X);
    close(panorama.direction(17.0, 0.0), DVec3::Z);
    close(panorama.direction(17.0, 40.0), -DVec3::Z);
    let dome = view(Optics::Fisheye { fov: 180.0 });
    close(dome.direction(60.0, 20.0), DVec3::Y);
    close(dome.direction(40.0, 0.0), DVec3::Z);
    close(
        dome.direction(50.0, 20.0),
        DVec3::new(-1.0, 1.0, 0.0).normalize(),
    );
    assert!(dome.shows(59.9, 20.0) && !dome.shows(60.1, 20.0) && !dome.shows(55.0, 1.0));
    let parallel = view(Optics::Orthographic { width: 4.0 });
    close(parallel.ray(80.0, 20.0).offset, DVec3::Y * 2.0);
    close(parallel.ray(40.0, 40.0).offset, -DVec3::Z);
}

#[test]
fn pixels_of_a_plane_are_found_again_in_parts_and_by_eyes() {
    let view = View::through(&camera(), Optics::Perspective { fov: 70.0 }, SIZE);
    for view in [
        view.clone(),
        view.cropped(10..30, 5..25),
        view.converged(0.1, 2.0),
        view.converged(-0.1, 2.0).cropped(40..80, 0..7),
    ] {
        let (x, y) = view.pixel(view.direction(7.3, 2.1)).unwrap();
        assert!((x - 7.3).abs() < 1e-10 && (y - 2.1).abs() < 1e-10);
        assert_eq!(view.pixel(-view.look()), None);
    }
}

#[test]
fn pixels_of_panoramas_and_fisheyes_are_found_again() {
    for optics in [Optics::Panorama, Optics::Fisheye { fov: 200.0 }] {
        let view = View::through(&camera(), optics, SIZE);
        for view in [
            view.clone(),
            view.cropped(10..30, 5..25),
            view.converged(0.1, 2.0),
            view.with_velocity(DVec3::new(0.3, -0.2, 0.1)),
        ] {
            for at in [(37.3, 12.1), (41.0, 23.5), (22.0, 18.0)] {
                let (x, y) = view.pixel(view.direction(at.0, at.1)).unwrap();
                assert!(
                    (x - at.0).abs() < 1e-9 && (y - at.1).abs() < 1e-9,
                    "{at:?} {x} {y}"
                );
            }
        }
        assert_eq!(view.turning(DVec3::Z, 0.1, 2.0).pixel(DVec3::X), None);
    }
}

#[test]
fn a_part_of_a_picture_has_the_rays_of_the_whole() {
    for optics in all() {
        let view = View::through(&camera(), optics, SIZE);
        let part = view.cropped(11..31, 7..20).cropped(2..9, 1..5);
        assert_eq!(part.size, (7, 4));
        let (a, b) = (part.ray(1.5, 2.5), view.ray(14.5, 10.5));
        close(a.direction, b.direction);
        close(a.offset, b.offset);
        assert_eq!(part.shows(1.5, 2.5), view.shows(14.5, 10.5));
    }
}

#[test]
fn both_eyes_see_the_same_point_at_their_convergence() {
    for optics in [
        Optics::Perspective { fov: 90.0 },
        Optics::Fisheye { fov: 180.0 },
    ] {
        let view = View::through(&camera(), optics, SIZE);
        for (x, y) in [(40.0, 20.0), (47.0, 11.0), (33.0, 25.0)] {
            // In flat space, from eyes 0.2 apart; right is +y.
            let point = |right: f64| {
                let d = view.converged(right, 2.0).direction(x, y);
                let from = DVec3::Y * right;
                let along = match optics {
                    Optics::Perspective { .. } => 2.0 / d.dot(view.look()),
                    // Where it is 2 from the middle.
                    _ => -from.dot(d) + (from.dot(d).powi(2) - from.dot(from) + 4.0).sqrt(),
                };
                from + d * along
            };
            close(point(-0.1), point(0.1));
        }
    }
}

#[test]
fn turning_eyes_are_beside_every_direction_and_meet_at_their_convergence() {
    let view = View::through(&camera(), Optics::Panorama, SIZE);
    for (x, y) in [(40.0, 20.0), (3.0, 9.0), (60.0, 33.0)] {
        let d = view.direction(x, y);
        let point = |right: f64| {
            let ray = view.turning(DVec3::Z, right, 2.0).ray(x, y);
            let level = DVec3::new(d.x, d.y, 0.0);
            // To the right of the direction, seen from above, and nearer towards the poles.
            close(ray.offset, level.cross(DVec3::Z) * right);
            let along = -ray.offset.dot(ray.direction);
            let half = (along.powi(2) - ray.offset.length_squared() + 4.0).sqrt();
            ray.offset + ray.direction * (along + half)
        };
        close(point(-0.1), d * 2.0);
        close(point(0.1), d * 2.0);
    }
    let ahead = view.turning(DVec3::Z, 0.1, f64::INFINITY).ray(40.0, 20.0);
    close(ahead.offset, DVec3::Y * 0.1);
    close(ahead.direction, -DVec3::X);
}

#[test]
fn a_view_turned_and_resized_keeps_what_it_sees() {
    for optics in all() {
        let view = View::through(&camera(), optics, SIZE);
        let turned = view.turned(0.3);
        let expected = DVec3::new(-(0.3_f64).cos(), (0.3_f64).sin(), 0.0);
        close(turned.look(), expected);
        let small = view.cropped(20..60, 10..30).resized((20, 10));
        let large = view.cropped(20..60, 10..30);
        close(small.direction(5.0, 5.0), large.direction(10.0, 10.0));
    }
}
