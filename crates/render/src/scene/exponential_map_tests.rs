use super::*;
use crate::scene::{Placement, placement};
use geofan_core::{diagnostic::SourceText, random::Stream};

fn space(metric: &str) -> Manifold {
    let text = format!("name = 'a'\ncoordinates = ['x', 'y', 'z']\n{metric}");
    Manifold::from_source(SourceText::new("a", text), &[]).unwrap()
}

fn object() -> ObjectEntry {
    placement::tests::object(Placement::Exponential, 0.4)
}

/// As many points of a unit sphere as polynomials need.
fn points() -> Vec<DVec3> {
    let mut random = Stream::new(&[5]);
    (0..MANY + 1000).map(|_| random.direction()).collect()
}

/// Places points by polynomials; also how many of them have any, and where each is by its own geodesic.
fn placed(manifold: &Manifold, points: &[DVec3]) -> (Points, usize, Points) {
    let object = object();
    let map = ExponentialMap::new(manifold, &object, points);
    let (cube, cell) = map.cube.as_ref().unwrap();
    let served = points
        .iter()
        .filter(|x| cell.at(*cube, map.tangent(**x)).is_some());
    let served = served.count();
    let slow = ExponentialMap {
        cube: None,
        ..ExponentialMap::new(manifold, &object, &[])
    };
    let some: Vec<DVec3> = points.iter().step_by(7).copied().collect();
    (
        map.place(points, points).unwrap(),
        served,
        slow.place(&some, &some).unwrap(),
    )
}

#[test]
fn polynomials_place_the_points_of_a_large_mesh_where_geodesics_do() {
    let metrics = [
        "metric = { conformal = '2/(1 + x^2 + y^2 + z^2)' }",
        "embedding = ['x', 'y', 'z', '0.6*exp(-(x^2 + y^2 + (z - 0.2)^2)/4)']",
    ];
    for metric in metrics {
        let points = points();
        let (fast, served, slow) = placed(&space(metric), &points);
        assert!(served > points.len() * 9 / 10, "{served}");
        for (fast, slow) in fast.iter().step_by(7).zip(&slow) {
            assert!(
                (fast.0 - slow.0).length() < 3.0 * ERROR,
                "{fast:?} {slow:?}"
            );
            assert!((fast.1 - slow.1).length() < 1e-4 * slow.1.length());
        }
    }
}

#[test]
fn where_the_metric_has_a_kink_geodesics_are_followed() {
    let kinked = "metric = { conformal = 'if(x > 0.35, 1 + 0.5*(x - 0.35), 1)' }";
    let (fast, served, slow) = placed(&space(kinked), &points());
    assert!(served < points().len() * 9 / 10, "{served}");
    for (fast, slow) in fast.iter().step_by(7).zip(&slow) {
        assert!(
            (fast.0 - slow.0).length() < 3.0 * ERROR,
            "{fast:?} {slow:?}"
        );
    }
}

#[test]
fn points_in_one_place_come_to_an_end() {
    let flat = space("metric = { conformal = '1' }");
    let points = vec![DVec3::new(0.4, 0.1, -0.3); MANY];
    let (object, here) = (object(), DVec3::new(0.3, -0.2, 0.1));
    let map = ExponentialMap::new(&flat, &object, &points);
    let placed = map.place(&points[..3], &points[..3]).unwrap();
    for (u, _) in placed {
        assert!((u - here - map.tangent(points[0])).length() < 1e-9);
    }
}
