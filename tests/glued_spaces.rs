//! Glued spaces from file to table: the table is that of the covering space, whatever is glued.

mod support;

use geofan_bundle::Bundle;
use geofan_core::manifold::Manifold;
use glam::DVec3;
use support::{Place, asset};

/// The three-sphere with a small camera region, and the same with the faces of a catalogue's file.
fn sphere_and_quotient() -> [String; 2] {
    let sphere = "name = 'sphere'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '2/(1 + r2)' }\n[let]\nr2 = 'x^2 + y^2 + z^2'\n[symmetry]\nrotation = 'origin'\n[cameras]\nparameters = { c = [0.0, 0.2] }\nat = ['c', '0', '0']\nlength = 2.5\n";
    let file = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/assets/manifolds/poincare.toml"
    );
    let text = std::fs::read_to_string(file).unwrap();
    let (from, to) = (
        text.find("[[glue]]").unwrap(),
        text.find("[domain]").unwrap(),
    );
    [sphere.to_string(), format!("{sphere}{}", &text[from..to])]
}

#[test]
fn the_table_of_a_quotient_is_that_of_its_cover() {
    let [sphere, quotient] = sphere_and_quotient();
    let place = Place::with(&[("sphere.toml", &sphere), ("quotient.toml", &quotient)]);
    place.bake("sphere.toml -o sphere.fan --quiet").success();
    place
        .bake("quotient.toml -o quotient.fan --quiet")
        .success();
    let [a, b] =
        ["sphere.fan", "quotient.fan"].map(|name| Bundle::read(&place.path(name)).unwrap());
    assert_eq!(a.contents().chunks, b.contents().chunks);
    assert_eq!(a.manifold.differences(&b.manifold.cover()), [""; 0]);
    assert!(!a.manifold.differences(&b.manifold).is_empty());
    assert!(b.manifold.gluing().is_some() && b.table.space.manifold().gluing().is_none());
    // Paths of the table end where exact ones do, inside the domain.
    let (u, d) = (
        DVec3::new(0.05, -0.03, 0.02),
        DVec3::new(0.3, 0.8, -0.5).normalize(),
    );
    let traced = geofan_bundle::trace(&b.table, u, d, 2.5, 6, 1e-10).unwrap();
    let space = asset("poincare");
    let ray = geofan_core::geodesic::Ray::new(&space, u, d, 2.5);
    let path =
        geofan_core::geodesic::paths(&space, support::settings(1e-12, true), [ray]).remove(0);
    for sample in &traced.samples {
        let exact = geofan_core::geodesic::sample(&space, &ray, &path, sample.s);
        assert!(
            (sample.u - exact.u).length() < 1e-3 * sample.s.max(0.1),
            "{sample:?} {exact:?}"
        );
        assert!((sample.v - exact.v).length() < 2e-3);
        let off = sample.frame.unwrap() - exact.frame.unwrap();
        assert!(off.to_cols_array().iter().all(|x| x.abs() < 3e-3));
        assert_eq!(sample.crossings, exact.crossings);
    }
    assert!(traced.samples.last().unwrap().crossings > 2);
}

/// A flat space by the motions that generate its group.
fn flat_quotient(generators: &str) -> Manifold {
    support::manifold(&format!(
        "metric = {{ conformal = '1' }}\n[quotient]\nlift = ['x', 'y', 'z', '1']\ndrop = ['X', 'Y', 'Z']\ngenerators = [{generators}]\n"
    ))
}

/// A point, the lamp, a length, and how many geodesics up to that length join them, with the sum of the light that
/// they bring (one over the area), and the shortest.
struct Known {
    name: &'static str,
    space: Manifold,
    points: [[f64; 3]; 2],
    length: f64,
    count: usize,
    light: f64,
    nearest: [f64; 2],
}

/// The point of the ball for the first three coordinates of a point of the hyperboloid.
fn ball(x: [f64; 3]) -> [f64; 3] {
    let x = DVec3::from(x);
    (x / (1.0 + (1.0 + x.length_squared()).sqrt())).to_array()
}

/// Numbers of group elements enumerated as matrices elsewhere.
fn known_images() -> Vec<Known> {
    let flat = [[0.3, 0.2, -0.4], [-0.1, 0.5, 0.6]];
    let sphere = [
        [0.05067406, 0.10134813, -0.02533703],
        [-0.07572246, 0.01514449, 0.06057797],
    ];
    let hyperbolic = [ball([0.2, -0.1, 0.3]), ball([-0.25, 0.15, 0.05])];
    let screws =
        "[[1,0,0,1],[0,-1,0,1],[0,0,-1,0],[0,0,0,1]], [[-1,0,0,0],[0,1,0,1],[0,0,-1,1],[0,0,0,1]]";
    let root = 3.0_f64.sqrt();
    let (s, c) = (0.5 * root, 0.5);
    let sixth = format!(
        "[[1,0,0,2],[0,1,0,0],[0,0,1,0],[0,0,0,1]], [[1,0,0,1],[0,1,0,{root:?}],[0,0,1,0],[0,0,0,1]], [[{c:?},-{s:?},0,0],[{s:?},{c:?},0,0],[0,0,1,2],[0,0,0,1]]"
    );
    let known = |name, space, points, (length, count, light), nearest| Known {
        name,
        space,
        points,
        length,
        count,
        light,
        nearest,
    };
    vec![
        known(
            "half turn",
            asset("half-turn"),
            flat,
            (6.0, 115, 8.475922896533),
            [1.118033989, 1.236931688],
        ),
        known(
            "sixth turn",
            flat_quotient(&sixth),
            flat,
            (6.0, 133, 9.928218461391),
            [1.012695099, 1.118033989],
        ),
        known(
            "Hantzsche and Wendt",
            flat_quotient(screws),
            flat,
            (5.0, 256, 28.22945806926),
            [0.7, 1.063014581],
        ),
        known(
            "Poincare",
            asset("poincare"),
            sphere,
            (2.0, 94, 141.5522098031),
            [0.348688220, 0.373430251],
        ),
        known(
            "L(5, 2)",
            asset("lens-space"),
            sphere,
            (3.0, 5, 16.19189699915),
            [0.348688220, 1.072857030],
        ),
        known(
            "Seifert and Weber",
            asset("seifert-weber"),
            hyperbolic,
            (3.0, 62, 4.6617693016),
            [0.564221380, 1.525097820],
        ),
        known(
            "mirrors",
            asset("mirrored-dodecahedron"),
            hyperbolic,
            (3.0, 132, 7.9234925757),
            [0.564221380, 1.440180390],
        ),
    ]
}

#[test]
fn a_lamp_has_as_many_images_as_the_group_says_and_all_its_light() {
    for known in known_images() {
        let (name, cover) = (known.name, known.space.cover().into_owned());
        let [to, from] = known.points.map(DVec3::from_array);
        let fan = geofan_light::LightFan::new(&cover, from, known.length, (to, to));
        let (found, _) = fan.connections(&[to], 1e-10);
        assert_eq!(found.len(), known.count, "{name}");
        for ((_, connection), s) in found.iter().zip(known.nearest) {
            assert!(
                (connection.s - s).abs() < 1e-6,
                "{name}: {} {s}",
                connection.s
            );
        }
        let light: f64 = found.iter().map(|(_, c)| 1.0 / c.area.abs()).sum();
        let off = (light / known.light - 1.0).abs();
        assert!(off < 1e-5, "{name}: {light} {}", known.light);
    }
}

/// The number of the faces of the space of Hantzsche and Wendt in units of a length, and where a ray ends, in that unit.
fn screws_in(unit: f64) -> (usize, DVec3, u32) {
    let generators = format!(
        "[[1,0,0,{unit:e}],[0,-1,0,{unit:e}],[0,0,-1,0],[0,0,0,1]], [[-1,0,0,0],[0,1,0,{unit:e}],[0,0,-1,{unit:e}],[0,0,0,1]]"
    );
    let space = flat_quotient(&generators);
    let (u, d) = (DVec3::new(0.1, 0.2, -0.15), DVec3::new(0.6, 0.64, 0.48));
    let ray = geofan_core::geodesic::Ray::new(&space, u * unit, d, 7.3 * unit);
    let path =
        geofan_core::geodesic::paths(&space, support::settings(1e-10, false), [ray]).remove(0);
    let end = geofan_core::geodesic::sample(&space, &ray, &path, 7.3 * unit);
    let faces = space.gluing().unwrap().faces().len();
    (faces, end.u / unit, end.crossings)
}

#[test]
fn a_quotient_is_the_same_in_every_unit() {
    let (faces, end, crossings) = screws_in(1.0);
    assert!(crossings > 3);
    for unit in [1e-9, 2e-6, 1e-3, 1e5] {
        let found = screws_in(unit);
        assert_eq!((found.0, found.2), (faces, crossings), "{unit:e}");
        assert!(
            (found.1 - end).length() < 1e-6,
            "{unit:e}: {} {end}",
            found.1
        );
    }
}

/// The number of images of `p` seen from `u` within `length`, and the light that they bring.
fn seen_images(space: &Manifold, [u, p]: [[f64; 3]; 2], length: f64) -> (usize, f64) {
    let cover = space.cover().into_owned();
    let [u, p] = [u, p].map(DVec3::from_array);
    let to = (p, 0.1 * (p - u).length());
    let fan = geofan_light::LightFan::to_point(&cover, u, length, to);
    let (found, _) = fan.connections(&[p], 1e-10);
    let light = found.iter().map(|(_, c)| 1.0 / c.area.abs()).sum();
    (found.len(), light)
}

#[test]
fn no_image_of_a_point_is_missed_in_hyperbolic_domains() {
    // Numbers of elements enumerated as matrices elsewhere; from corner to corner of the domain, too.
    let middle = [ball([-0.25, 0.15, 0.05]), ball([0.2, -0.1, 0.3])];
    let corners = [[0.4; 3], [-0.38, -0.38, 0.38]];
    let dodecahedron = asset("seifert-weber");
    let (count, light) = seen_images(&dodecahedron, middle, 4.0);
    assert_eq!(count, 401);
    assert!((light - 5.755_557_5).abs() < 1e-5, "{light}");
    assert_eq!(seen_images(&dodecahedron, corners, 3.0).0, 62);
    // With a cusp.
    let knot = [[0.1, 0.2, 0.15], [-0.1, 0.1, 0.3]];
    assert_eq!(seen_images(&asset("figure-eight"), knot, 3.0).0, 291);
}
