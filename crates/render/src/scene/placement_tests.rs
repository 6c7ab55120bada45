use super::*;
use crate::scene::cutting::SAG;
use geofan_core::diagnostic::SourceText;
use glam::DQuat;

fn sphere() -> Manifold {
    let text = "name = 's3'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '2/(1 + x^2 + y^2 + z^2)' }";
    Manifold::from_source(SourceText::new("s3", text), &[]).unwrap()
}

/// An object off every axis.
pub(in crate::scene) fn object(placement: Placement, scale: f64) -> ObjectEntry {
    ObjectEntry {
        path: None,
        mesh: "square.obj".into(),
        mesh_span: 0..0,
        at: DVec3::new(0.3, -0.2, 0.1),
        at_span: 0..0,
        scale,
        rotation: DQuat::from_xyzw(0.1, -0.4, 0.2, 0.8).normalize(),
        placement,
        velocity: None,
        temperature: None,
        crease: 30.0,
        cuts: None,
        vertices: None,
        span: 0..0,
    }
}

/// A square with corners at distance √2 from its middle, and a corner in the middle.
fn square() -> Mesh {
    let text = "v 0 0 0\nv 1 1 0\nv -1 1 0\nv -1 -1 0\nv 1 -1 0\nvn 0 0 1\nf 1//1 2//1 3//1\nf 1//1 3//1 4//1\nf 1//1 4//1 5//1\nf 1//1 5//1 2//1\n";
    Mesh::parse("square.obj", text, std::path::Path::new("")).unwrap()
}

/// Distance on the three-sphere, from the chart.
fn distance(a: DVec3, b: DVec3) -> f64 {
    let ambient = |u: DVec3| {
        let r2 = u.length_squared();
        (2.0 * u / (1.0 + r2)).extend((r2 - 1.0) / (1.0 + r2))
    };
    2.0 * (0.5 * (ambient(a) - ambient(b)).length()).asin()
}

#[test]
fn a_mesh_that_is_cut_as_is_known_is_placed_like_one_whose_cuts_are_sought() {
    let (s3, mesh) = (sphere(), square());
    for placement in [Placement::Exponential, Placement::Linear, Placement::Chart] {
        let sought = object(placement, 0.7);
        let placed = place(&s3, &sought, &mesh).unwrap();
        let known = ObjectEntry {
            cuts: Some(placed.cuts.clone().into()),
            ..object(placement, 0.7)
        };
        let again = place(&s3, &known, &mesh).unwrap();
        assert_eq!(again.vertices, placed.vertices);
        assert_eq!(again.mesh.triangles, placed.mesh.triangles);
        assert_eq!(again.mesh.uvs, placed.mesh.uvs);
        assert!(again.warnings.is_empty());
    }
    // For one that is told where its vertices are, if they are those of such a mesh.
    let sought = object(Placement::Exponential, 0.7);
    let placed = place(&s3, &sought, &mesh).unwrap();
    assert_eq!(
        placed_once(&s3, &sought, &mesh),
        Some((placed.cuts.clone(), Some(placed.vertices.clone())))
    );
    let mut known = ObjectEntry {
        cuts: Some(placed.cuts.clone().into()),
        ..sought
    };
    known.vertices = Some(vec![(DVec3::X, DVec3::Y); placed.vertices.len()].into());
    let told = place(&s3, &known, &mesh).unwrap();
    assert_eq!(told.vertices[7], (DVec3::X, DVec3::Y));
    known.vertices = Some(vec![(DVec3::X, DVec3::Y)].into());
    assert_eq!(place(&s3, &known, &mesh).unwrap().vertices, placed.vertices);
    // Cuts of another mesh are no use: they are sought anew.
    let foreign = Cuts {
        within: f64::INFINITY,
        rounds: vec![vec![[0, 99]]],
    };
    let object = ObjectEntry {
        cuts: Some(foreign.into()),
        ..object(Placement::Exponential, 0.7)
    };
    let mesh = square();
    assert!(place(&s3, &object, &mesh).unwrap().mesh.triangles.len() > 16);
}

#[test]
fn exponential_placement_keeps_distances_from_the_middle_and_makes_edges_geodesic() {
    let (s3, mesh) = (sphere(), square());
    let object = object(Placement::Exponential, 0.7);
    let placed = place(&s3, &object, &mesh).unwrap();
    assert!(placed.warnings.is_empty());
    assert!(
        placed.mesh.triangles.len() > 16,
        "{}",
        placed.mesh.triangles.len()
    );
    for (x, (u, _)) in placed.mesh.positions.iter().zip(&placed.vertices) {
        assert!((distance(object.at, *u) - 0.7 * x.length()).abs() < 1e-8);
    }
    // The middle of a chart line lies no farther from the ends than half the geodesic, and its
    // sagitta: √(m² − (d/2)²) for distances m to the ends and d between them.
    let radius = 0.7 * 2.0_f64.sqrt();
    for triangle in &placed.mesh.triangles {
        for (j, k) in [(0, 1), (1, 2), (2, 0)] {
            let [a, b] = [j, k].map(|i: usize| placed.vertices[triangle[i] as usize].0);
            let (d, m) = (distance(a, b), distance(a, 0.5 * (a + b)));
            let other = distance(b, 0.5 * (a + b));
            // Spherical triangle with a foot on the geodesic: to this order plane geometry serves.
            let foot = (m * m - other * other + d * d) / (2.0 * d);
            let sagitta = (m * m - foot * foot).max(0.0).sqrt();
            assert!(sagitta <= 1.1 * SAG * radius, "{sagitta}");
        }
    }
}

#[test]
fn normals_stay_perpendicular_to_the_surface() {
    let (s3, mesh) = (sphere(), square());
    for placement in [Placement::Linear, Placement::Exponential] {
        let placed = place(&s3, &object(placement, 0.7), &mesh).unwrap();
        for triangle in &placed.mesh.triangles {
            let [a, b, c] = triangle.map(|i| placed.vertices[i as usize].0);
            // The square's tangent plane holds all its lines through the middle; triangles near
            // the edge are chords of it.
            for corner in triangle {
                let (_, n) = placed.vertices[*corner as usize];
                let cosine = |w: DVec3| n.dot(w) / (n.length() * w.length());
                assert!(cosine(b - a).abs() < 0.02 && cosine(c - a).abs() < 0.02);
                assert!(n.dot((b - a).cross(c - a)) > 0.0);
            }
        }
    }
}

#[test]
fn a_linear_placement_that_bends_lines_is_warned_about_with_the_angle() {
    let (s3, mesh) = (sphere(), square());
    let warnings = place(&s3, &object(Placement::Linear, 0.7), &mesh)
        .unwrap()
        .warnings;
    assert!(
        warnings.len() == 1
            && warnings[0].contains("bends edges by up to")
            && warnings[0].contains('°'),
        "{warnings:?}"
    );
    assert!(
        place(&s3, &object(Placement::Linear, 0.01), &mesh)
            .unwrap()
            .warnings
            .is_empty()
    );
}

#[test]
fn the_bend_of_a_chart_line_is_its_angle_against_great_circles() {
    // In the stereographic chart a line at distance p from the origin is a circle of the sphere;
    // its geodesic curvature is p (for the metric 4/(1+r²)²), so over the length ℓ it bends by p ℓ.
    let s3 = sphere();
    let (a, b) = (DVec3::new(-0.4, 0.5, 0.0), DVec3::new(0.7, 0.5, 0.0));
    let length = |x: f64| (x / 1.25_f64.sqrt()).atan() * 2.0 / 1.25_f64.sqrt();
    let expected = 0.5 * (length(0.7) + length(0.4));
    let found = bend(&s3, a, b, 64);
    assert!((found / expected - 1.0).abs() < 1e-3, "{found} {expected}");
}

fn farthest_light(space: &str, at: DVec3, most: f64) -> f64 {
    let text = format!("name = 'a'\ncoordinates = ['x', 'y', 'z']\n{space}");
    let manifold = Manifold::from_source(SourceText::new("a.toml", text), &[]).unwrap();
    reach(&manifold, at, most)
}

#[test]
fn light_gets_to_the_farthest_corner_of_a_box_and_not_much_farther() {
    let space = "metric = { conformal = '2' }\n\
                 domain = { x = [-1, 3], y = [-1, 3], z = [-2, 2] }\n";
    for at in [DVec3::ZERO, DVec3::new(-0.9, 2.5, 1.9), DVec3::ONE] {
        let farthest = (at - DVec3::new(1.0, 1.0, 0.0)).abs() + 2.0;
        let farthest = 2.0 * farthest.length();
        let found = farthest_light(space, at, 1e5);
        assert!(
            found >= farthest && found < 1.3 * farthest,
            "{found} {farthest}"
        );
    }
}

#[test]
fn without_an_end_the_length_of_paths_counts_and_never_more_than_is_asked_for() {
    let space = "metric = { conformal = '1' }\ncameras = { length = 3 }\n";
    assert_eq!(farthest_light(space, DVec3::ZERO, 1e5), 7.5);
    assert_eq!(farthest_light(space, DVec3::ZERO, 2.0), 2.0);
    let alone = "metric = { conformal = '2/(1 + x^2 + y^2 + z^2)' }\n";
    let far = farthest_light(alone, DVec3::new(0.3, 0.2, 0.1), 1e9);
    assert!(far < 1e5, "{far}");
}

#[test]
fn cuts_come_back_and_other_bytes_are_refused() {
    let known = Cuts {
        within: f64::INFINITY,
        rounds: vec![vec![[0, 1], [3, 70_000]], vec![], vec![[5, 2]]],
    };
    let all = vec![None, Some(known), None];
    let bytes = pack_cuts(&all);
    assert_eq!(read_cuts(&bytes, 3), Some(all));
    assert_eq!(read_cuts(&bytes, 2), None);
    assert_eq!(read_cuts(&bytes, 4), None);
    for length in 0..bytes.len() {
        assert_eq!(read_cuts(&bytes[..length], 3), None);
    }
}

#[test]
fn points_come_back_almost_as_they_were_and_other_bytes_are_refused() {
    let point = |i: usize| {
        let t = i as f64 * 0.37;
        (
            DVec3::new(t.sin(), 1e-3 * t, -4.0),
            DVec3::new(9.0, t.cos(), 1.0),
        )
    };
    let known: Points = (0..50).map(point).collect();
    let all = vec![None, Some(known.clone()), Some(vec![point(7)])];
    let bytes = pack_points(&all);
    let back = read_points(&bytes, 3).unwrap();
    assert!(back[0].is_none());
    assert_eq!(back[2], Some(vec![point(7)]));
    for ((u, n), (v, m)) in known.iter().zip(back[1].as_ref().unwrap()) {
        assert!((*u - *v).abs().max_element() <= 2.0 / (2.0 * STEPS));
        assert!((*n - *m).abs().max_element() <= 2.0 / (2.0 * COVECTOR_STEPS));
    }
    for length in 0..bytes.len() {
        assert!(read_points(&bytes[..length], 3).is_none());
    }
    assert!(read_points(&bytes, 2).is_none() && read_points(&bytes, 4).is_none());
}
