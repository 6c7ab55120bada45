//! Lamps and mirrors against unfolded space: what a mirror shows is a lamp behind it, however near to it a point is.

mod support;

use geofan_light::LightFan;
use glam::{DVec3, DVec4};

/// Distances from the mirror, x = 0, as shares of a place's distance from the origin.
const NEAR: [f64; 7] = [1.0, 0.3, 0.1, 0.03, 1e-2, 1e-3, 1e-4];

/// For points nearer and nearer to the mirror, up to the share `nearest`: there must be two ways from the lamp, as long as those to the point and to
/// its mirror image.
fn check(
    metric: &str,
    (from, length, nearest): (DVec3, f64, f64),
    distance: fn(DVec3, DVec3) -> f64,
) {
    let space = support::manifold(&format!(
        "metric = {{ conformal = '{metric}' }}\nglue = [{{ face = 'x', mirror = true }}]\n"
    ));
    let places = [DVec3::new(1.0, 0.0, -0.3), DVec3::new(1.0, 0.6, 0.5)].map(|place| 0.5 * place);
    let near = NEAR.iter().filter(|share| **share >= nearest);
    let points: Vec<DVec3> = near
        .flat_map(|share| places.map(|place| place * DVec3::new(*share, 1.0, 1.0)))
        .collect();
    let region = (DVec3::splat(-1.0), DVec3::splat(1.0));
    let (found, _) = LightFan::new(&space, from, length, region).connections(&points, 1e-10);
    for (i, point) in points.iter().enumerate() {
        let ways: Vec<f64> = found
            .iter()
            .filter(|(index, _)| *index == i)
            .map(|(_, connection)| connection.s)
            .collect();
        let image = *point * DVec3::new(-1.0, 1.0, 1.0);
        let known = [distance(from, *point), distance(from, image)];
        let right = ways.len() == 2 && ways.iter().zip(known).all(|(a, b)| (a - b).abs() < 1e-8);
        assert!(
            right,
            "{metric}: {from} to {point}: {ways:?}, not {known:?}"
        );
    }
}

/// A point of the stereographic chart of the sphere in R⁴.
fn on_sphere(u: DVec3) -> DVec4 {
    let r2 = u.length_squared();
    (2.0 * u / (1.0 + r2)).extend((1.0 - r2) / (1.0 + r2))
}

#[test]
fn a_lamp_and_its_mirror_image_both_shed_light_right_up_to_the_mirror() {
    // Light from near the mirror grazes it.
    for (from, nearest) in [
        (DVec3::new(0.8, 0.1, 0.4), 1e-4),
        (DVec3::new(0.1, -0.2, 0.9), 1e-3),
    ] {
        for length in [4.0, 60.0] {
            check("1", (from, length, nearest), DVec3::distance);
        }
        check("2/(1 + x^2 + y^2 + z^2)", (from, 3.0, nearest), |a, b| {
            let (p, q) = (on_sphere(a), on_sphere(b));
            2.0 * (p - q).length().atan2((p + q).length())
        });
        let from = 0.5 * from;
        check("2/(1 - x^2 - y^2 - z^2)", (from, 6.0, nearest), |a, b| {
            let share = (1.0 - a.length_squared()) * (1.0 - b.length_squared());
            2.0 * ((a - b).length_squared() / share).sqrt().asinh()
        });
    }
}
