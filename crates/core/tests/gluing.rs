//! Glued spaces against matrix groups: where paths end, how space spreads along them, how often a point is seen.

mod support;

use geofan_core::{
    diagnostic::SourceText,
    geodesic::{End, Path, Ray, paths, sample},
    manifold::Manifold,
};
use glam::{DMat3, DVec3};
use std::f64::consts::TAU;
use support::{asset, manifold, pair, refusal, settings};

/// Follows the ray from `u` in the direction `d` (standard frame).
fn follow(manifold: &Manifold, u: DVec3, d: DVec3, length: f64) -> (Ray, Path) {
    let ray = Ray::new(manifold, u, d.normalize(), length);
    let path = paths(manifold, settings(1e-13, true), [ray]).remove(0);
    (ray, path)
}

#[test]
fn paths_end_where_matrices_take_them() {
    let (start, d) = (DVec3::new(0.1, -0.05, 0.2), DVec3::new(0.3, 0.8, -0.5));
    let cases = [
        (
            "half-turn",
            (DVec3::new(0.3, 0.2, -0.4), DVec3::new(0.5, 0.3, 0.8), 20.0),
            DVec3::new(0.40152544552, 0.26091526731, -0.23755928716),
            (16, false),
        ),
        (
            "poincare",
            (DVec3::new(0.05, -0.03, 0.02), d, 6.0),
            DVec3::new(0.00537716456, -0.14564469254, 0.09225229864),
            (12, false),
        ),
        (
            "seifert-weber",
            (start, d, 6.0),
            DVec3::new(-0.09478838637, 0.02413016849, 0.56072840831),
            (5, false),
        ),
        (
            "mirrored-dodecahedron",
            (start, d, 5.0),
            DVec3::new(-0.03715048029, 0.08201759694, 0.26066330372),
            (5, true),
        ),
    ];
    for (name, (u, d, length), end, (crossings, reversed)) in cases {
        let space = asset(name);
        let (ray, path) = follow(&space, u, d, length);
        let last = sample(&space, &ray, &path, length);
        let off = (last.u - end).length();
        println!("{name}: {off:.1e} off after {} crossings", last.crossings);
        assert_eq!(path.end, End::Length, "{name}");
        assert!(off < 2e-11, "{name}: {} is {off:e} off", last.u);
        assert_eq!(
            (last.crossings, last.reversed),
            (crossings, reversed),
            "{name}"
        );
    }
}

#[test]
fn areas_and_frames_are_those_of_the_cover() {
    for (name, length) in [
        ("poincare", 2.8),
        ("seifert-weber", 3.0),
        ("sol-cat", 3.0),
        ("mirrored-dodecahedron", 3.0),
    ] {
        let space = asset(name);
        let cover = space.cover();
        let (u, d) = (DVec3::new(0.05, -0.03, 0.12), DVec3::new(0.3, 0.8, -0.5));
        let (ray, path) = follow(&space, u, d, length);
        let (_, straight) = follow(&cover, u, d, length);
        for i in 1..=8 {
            let s = length * f64::from(i) / 8.0;
            let (here, there) = (
                sample(&space, &ray, &path, s),
                sample(&cover, &ray, &straight, s),
            );
            let (a, b) = (here.area.unwrap(), there.area.unwrap());
            assert!(
                (a - b).abs() < 1e-9 * b.max(1.0),
                "{name}: area {a} is not {b} at {s}"
            );
            let (u, v, word) = space.brought_in(there.u, there.v).unwrap();
            if (u - here.u).length() > 1e-9 {
                // On a face either side is right.
                continue;
            }
            assert!((v - here.v).length() < 1e-9, "{name}: tangent at {s}");
            let frame = space
                .gluing()
                .unwrap()
                .carried(&word, there.u, there.frame.unwrap());
            let off = (frame - here.frame.unwrap()).to_cols_array();
            assert!(
                off.iter().all(|x| x.abs() < 1e-8),
                "{name}: frame at {s}: {off:?}"
            );
        }
    }
}

#[test]
fn points_inside_stay_and_points_outside_come_back_by_isometries() {
    for name in [
        "half-turn",
        "sol-cat",
        "poincare",
        "seifert-weber",
        "mirrored-dodecahedron",
    ] {
        let space = asset(name);
        let gluing = space.gluing().unwrap();
        assert_eq!(gluing.violated(gluing.inside()), None);
        assert!(
            gluing.faces().iter().all(|face| face.partner().is_some()),
            "{name}"
        );
        let u = gluing.inside() + DVec3::new(0.41, -0.35, 0.28) * gluing.size();
        let (v, word) = gluing.locate(u).unwrap();
        assert_eq!(gluing.violated(v), None);
        let mut deck = gluing.identity();
        for k in &word {
            deck = deck.then(gluing.faces()[*k].deck().unwrap());
        }
        assert!((deck.point(u) - v).length() < 1e-12, "{name}");
    }
}

/// A group of matrices gives the same space as its faces.
#[test]
fn a_quotient_by_matrices_is_the_space_of_its_faces() {
    let (s, c) = (0.8_f64, 0.6_f64);
    // The lens space L(4, 1): turns by a quarter in two planes at once.
    let text = "metric = { conformal = '2/(1 + r2)' }\n[let]\nr2 = 'x^2 + y^2 + z^2'\n[quotient]\nlift = ['2*x/(1 + r2)', '2*y/(1 + r2)', '2*z/(1 + r2)', '(1 - r2)/(1 + r2)']\ndrop = ['X/(1 + W)', 'Y/(1 + W)', 'Z/(1 + W)']\ngenerators = [[[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 0, -1], [0, 0, 1, 0]]]\ncentre = [0.1, -0.2, 0.15]\n";
    let space = manifold(text);
    let gluing = space.gluing().unwrap();
    assert_eq!(gluing.faces().len(), 2);
    let (ray, path) = follow(
        &space,
        DVec3::new(0.1, 0.0, 0.1),
        DVec3::new(0.0, s, c),
        TAU,
    );
    let last = sample(&space, &ray, &path, TAU);
    assert!(
        (last.u - ray.u).length() < 1e-9 && last.crossings == 4,
        "{last:?}"
    );
    // Flat space has no invariant form; the domain is that of distances.
    let text = "metric = { xx = '1', yy = '1', zz = '1' }\n[quotient]\nlift = ['x', 'y', 'z', '1']\ndrop = ['X', 'Y', 'Z']\ngenerators = [[[1,0,0,2],[0,1,0,0],[0,0,1,0],[0,0,0,1]], [[1,0,0,0],[0,1,0,2],[0,0,1,0],[0,0,0,1]], [[-1,0,0,0],[0,-1,0,0],[0,0,1,2],[0,0,0,1]]]\n";
    let space = manifold(text);
    let known = asset("half-turn");
    let (u, d) = (DVec3::new(0.3, 0.2, -0.4), DVec3::new(0.5, 0.3, 0.8));
    let (ray, path) = follow(&space, u, d, 20.0);
    let last = sample(&space, &ray, &path, 20.0);
    let (other, path) = follow(&known, u, d, 20.0);
    let end = sample(&known, &other, &path, 20.0);
    assert!((last.u - end.u).length() < 1e-10, "{} {}", last.u, end.u);
    assert_eq!(space.gluing().unwrap().faces().len(), 6);
}

/// Groups that take the default centre to the one point that the stereographic chart lacks.
#[test]
fn quotients_by_the_antipode_have_their_domain_about_the_origin() {
    let minus = "[[-1,0,0,0],[0,-1,0,0],[0,0,-1,0],[0,0,0,-1]]";
    let quarter = "[[0,-1,0,0],[1,0,0,0],[0,0,0,-1],[0,0,1,0]]";
    for (generator, faces, order) in [(minus, 1, 2), (quarter, 2, 4)] {
        let text = format!(
            "metric = {{ conformal = '2/(1 + r2)' }}\n[let]\nr2 = 'x^2 + y^2 + z^2'\n[quotient]\nlift = ['2*x/(1 + r2)', '2*y/(1 + r2)', '2*z/(1 + r2)', '(1 - r2)/(1 + r2)']\ndrop = ['X/(1 + W)', 'Y/(1 + W)', 'Z/(1 + W)']\ngenerators = [{generator}]\n"
        );
        let space = manifold(&text);
        assert_eq!(space.gluing().unwrap().faces().len(), faces, "{order}");
        // A geodesic closes after the circle's share; along the turns of the quarter every direction does.
        let length = TAU;
        let (u, d) = (DVec3::new(0.1, 0.05, 0.1), DVec3::new(0.2, 0.8, 0.6));
        let (ray, path) = follow(&space, u, d, length);
        let last = sample(&space, &ray, &path, length);
        assert!((last.u - ray.u).length() < 1e-9, "{order}: {last:?}");
        assert_eq!(last.crossings, order, "{last:?}");
    }
}

/// A hyperbolic surface of genus 2 times a circle, whose maps fix points of the ideal boundary alone.
#[test]
fn points_infinitely_far_out_are_no_cones() {
    // Opposite sides of the regular octagon with right angles of 45 degrees: translations along its four diameters.
    let half = 1.0 + 2.0_f64.sqrt();
    let (c, s) = (
        2.0 * half * half - 1.0,
        2.0 * half * (half * half - 1.0).sqrt(),
    );
    let translation = |k: usize| {
        let (y, x) = (std::f64::consts::FRAC_PI_4 * k as f64).sin_cos();
        let (xx, yy, xy) = (
            1.0 + (c - 1.0) * x * x,
            1.0 + (c - 1.0) * y * y,
            (c - 1.0) * x * y,
        );
        let (sx, sy) = (s * x, s * y);
        format!(
            "[[{xx},{xy},0,{sx},0],[{xy},{yy},0,{sy},0],[0,0,1,0,0],[{sx},{sy},0,{c},0],[0,0,0,0,1]]"
        )
    };
    let all: Vec<String> = (0..4).map(translation).collect();
    let text = format!(
        "metric = {{ xx = 's^2', yy = 's^2', zz = '1' }}\n[let]\nr2 = 'x^2 + y^2'\ns = '2/(1 - r2)'\n[quotient]\nlift = ['2*x/(1 - r2)', '2*y/(1 - r2)', 'z', '(1 + r2)/(1 - r2)', '1']\ndrop = ['X/(1 + W)', 'Y/(1 + W)', 'Z']\ngenerators = [{}, [[1,0,0,0,0],[0,1,0,0,0],[0,0,1,0,2],[0,0,0,1,0],[0,0,0,0,1]]]\n",
        all.join(", ")
    );
    // Eight sides and two ends, and what touches the domain at its corners.
    let space = manifold(&text);
    let gluing = space.gluing().unwrap();
    assert!(gluing.faces().len() >= 10);
    let (home, _) = gluing.locate(DVec3::new(0.1, -0.2, 7.3)).unwrap();
    assert!(home.distance(DVec3::new(0.1, -0.2, -0.7)) < 1e-9, "{home}");
}

#[test]
fn wrong_gluings_are_refused_with_the_face_and_the_place() {
    let back = pair("1 + x", ["x + 2", "y", "z"]);
    let y = pair("1 - y", ["x", "y - 2", "z"]) + &pair("1 + y", ["x", "y + 2", "z"]);
    let cases = [
        (
            "stretches",
            pair("1 - x", ["2*x - 3", "y", "z"]) + &back,
            "face 1: its map is no isometry: at x =",
        ),
        (
            "is not paired",
            pair("1 - x", ["x - 1.5", "y", "z"]) + &back,
            "no map leads back: x =",
        ),
        (
            "has another way back",
            pair("1 - x", ["x - 2", "-y", "-z"]) + &pair("1 + x", ["x + 2", "-z", "y"]),
            "no map leads back: x =",
        ),
        (
            "does not close",
            pair("1 - x", ["x - 2", "y + 0.7", "z"])
                + &pair("1 + x", ["x + 2", "y - 0.7", "z"])
                + &pair("1 - y", ["-x", "y - 2", "z"])
                + &pair("1 + y", ["-x", "y + 2", "z"]),
            "does not close",
        ),
        (
            "fixes an axis",
            pair("x", ["-x", "-y", "z"]) + &y,
            "its map fixes a point of the domain: x =",
        ),
        (
            "leads nowhere",
            pair("1 - x", ["x - 1.5", "y", "z"]) + &pair("1 + x", ["x + 1.5", "y", "z"]),
            "its map leads to no face: x =",
        ),
        (
            "meets a mirror that ends there",
            pair("1 - x", ["x - 2", "y", "z"])
                + &back
                + "[[glue]]\nface = '1 - y - 0.3*x'\nmirror = true\n",
            "a mirror: x =",
        ),
        (
            "has neither",
            "[[glue]]\nface = '1 - x'\n".into(),
            "a glued face needs `map`",
        ),
        (
            "has both",
            pair("1 - x", ["x", "y", "z"]) + "mirror = true\n",
            "a face has a map or is a mirror",
        ),
        (
            "goes farther out",
            pair("1 - x", ["x + 2", "y", "z"]) + &pair("1 + x", ["x - 2", "y", "z"]),
            "face",
        ),
        (
            "is periodic too",
            "[domain]\nx = [0, 1]\nperiodic = ['x']\n".to_string() + &back,
            "not possible together",
        ),
        (
            "has no value",
            pair("1 - x", ["x - 2 + sqrt(-1 - x^2)", "y", "z"]) + &back,
            "face 1: its map has no value at x =",
        ),
        (
            "has no inside",
            pair("-1 - x^2", ["x - 2", "y", "z"]),
            "face 1",
        ),
    ];
    for (what, text, told) in cases {
        let report = refusal(&text);
        println!("{what}:\n{report}\n");
        assert!(report.contains(told), "{what}:\n{report}");
    }
    let quotient = |m: &str| {
        format!(
            "[quotient]\nlift = ['x', 'y', 'z', '1']\ndrop = ['X', 'Y', 'Z']\ngenerators = [{m}]\n"
        )
    };
    let turned = refusal(&quotient("[[-1,0,0,0],[0,-1,0,0],[0,0,1,0],[0,0,0,1]]"));
    assert!(turned.contains("does not move the centre"), "{turned}");
    // A map that is none of the space has no group worth looking for: it is refused before.
    let stretches = refusal(&quotient("[[1,0,0,2],[0,1.001,0,0],[0,0,1,0],[0,0,0,1]]"));
    assert!(
        stretches.contains("generator 1 is no isometry"),
        "{stretches}"
    );
    let dense = refusal(&quotient(
        "[[1,0,0,2],[0,1,0,0],[0,0,1,0],[0,0,0,1]], [[1,0,0,1.4142135623],[0,1,0,0],[0,0,1,0],[0,0,0,1]]",
    ));
    assert!(
        dense.contains("their group discrete") && dense.contains("generators = "),
        "{dense}"
    );
    let many = vec!["[[1,0,0,2],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"; 65].join(",");
    let many = refusal(&quotient(&many));
    assert!(many.contains("65 generators are too many"), "{many}");
    let short = refusal(&quotient("[[1,0,0,2],[0,1,0,0],[0,0,1,0]]"));
    assert!(short.contains("a matrix of 4 rows is needed"), "{short}");
    let wrong = refusal(
        "[quotient]\nlift = ['x', 'y', '2*z', '1']\ndrop = ['X', 'Y', 'Z']\ngenerators = [[[1,0,0,2],[0,1,0,0],[0,0,1,0],[0,0,0,1]]]\n",
    );
    assert!(wrong.contains("`drop` does not undo `lift`"), "{wrong}");
}

/// The product of the sphere and the line, in the chart u = eᵗ n: distances in the chart find no nearest image, because
/// images gather at u = 0. A group of two matrices would be glued by the square of the first.
#[test]
fn groups_without_a_domain_of_nearest_points_are_refused() {
    let product = |generators: &str| {
        let text = format!(
            "name = 'q'\ncoordinates = ['x', 'y', 'z']\nmetric = {{ conformal = '1/sqrt(x^2 + y^2 + z^2)' }}\n[quotient]\n\
             lift = ['x', 'y', 'z']\ndrop = ['X', 'Y', 'Z']\ncentre = [1, 0, 0]\ngenerators = [{generators}]\n\
             [domain]\ninside = ['log(x^2 + y^2 + z^2) + 24', '24 - log(x^2 + y^2 + z^2)']\n"
        );
        let read = Manifold::from_source(SourceText::new("q.toml", text), &[]);
        read.expect_err("a subgroup").report(false)
    };
    for generators in [
        "[[-2.4596,0,0],[0,-2.4596,0],[0,0,-2.4596]]",
        "[[-3.6,0,0],[0,-3.6,0],[0,0,3.6]]",
    ] {
        let report = product(generators);
        assert!(report.contains("no nearest image to `centre`"), "{report}");
    }
    let identity = product("[[1,0,0],[0,1,0],[0,0,1]]");
    assert!(
        identity.contains("leave every point where it is"),
        "{identity}"
    );
}

/// The same product in its linear model: the antipode and a step along the line, told as [quotient].
#[test]
fn a_product_of_the_sphere_and_the_line_has_its_faces_in_its_linear_model() {
    let space = manifold(
        "metric = { conformal = '1/r' }\n[let]\nr = 'sqrt(x^2 + y^2 + z^2)'\n[quotient]\n\
         lift = ['x/r', 'y/r', 'z/r', 'log(r)', '1']\ndrop = ['X*exp(W)', 'Y*exp(W)', 'Z*exp(W)']\ncentre = [1, 0, 0]\n\
         generators = [[[-1,0,0,0,0],[0,-1,0,0,0],[0,0,-1,0,0],[0,0,0,1,0.9],[0,0,0,0,1]]]\n\
         [domain]\ninside = ['log(r) + 12', '12 - log(r)']\n[cameras]\nat = ['1', '0', '0']\n",
    );
    let gluing = space.gluing().unwrap();
    assert!(gluing.faces().iter().any(|face| face.reverses()));
    let u = DVec3::new(1.1, -0.2, 0.3);
    for (k, sign) in [(1, -1.0), (2, 1.0), (-3, -1.0)] {
        let image = sign * u * (0.9 * f64::from(k)).exp();
        let (home, word) = gluing.locate(image).unwrap();
        assert!(home.distance(u) < 1e-9, "{k}: {home}");
        assert_eq!(gluing.reverses(&word), k % 2 != 0);
    }
}

/// Two faces of this domain are triangles a fiftieth as large as the others.
#[test]
fn the_smallest_faces_have_partners() {
    let space = manifold(
        "metric = { conformal = '1' }\n[quotient]\nlift = ['x', 'y', 'z', '1']\ndrop = ['X', 'Y', 'Z']\n\
         centre = [0.23, 0.31, 0.17]\ngenerators = [[[1,0,0,0.85],[0,-1,0,0],[0,0,1,0],[0,0,0,1]],\n\
         [[-1,0,0,0],[0,-1,0,0.65],[0,0,1,0.45],[0,0,0,1]], [[1,0,0,0],[0,1,0,1.3],[0,0,1,0],[0,0,0,1]]]\n",
    );
    let gluing = space.gluing().unwrap();
    assert_eq!(gluing.faces().len(), 16);
    assert!(gluing.faces().iter().all(|face| face.partner().is_some()));
    // The same point by way of either.
    let u = DVec3::new(0.5, -0.91, 0.15);
    let copy = gluing.copy_of(u).unwrap().point(gluing.inside());
    assert!(
        copy.distance(gluing.inside() - DVec3::Y * 1.3) < 1e-9,
        "{copy}"
    );
}

/// Clocks that do not agree where space is glued would show as a jump of frequencies.
#[test]
fn a_lapse_must_be_that_of_the_place_to_which_a_face_leads() {
    let faces = pair("1 - x", ["x - 2", "y", "z"]) + &pair("1 + x", ["x + 2", "y", "z"]);
    let text = |lapse: &str| {
        format!(
            "name = 'q'\ncoordinates = ['x', 'y', 'z']\nmetric = {{ conformal = '1' }}\nlapse = '{lapse}'\n{faces}"
        )
    };
    let read = |lapse: &str| Manifold::from_source(SourceText::new("q.toml", text(lapse)), &[]);
    let report = read("2 + 0.1*x").expect_err("a jump").report(false);
    assert!(report.contains("clocks differ"), "{report}");
    assert!(read("2 + 0.1*cos(3.14159265358979324*x)").is_ok());
}

/// A round mirror in flat space: the mirror equation, and what a reflection does to areas.
#[test]
fn a_curved_mirror_reflects_and_focuses_as_mirrors_do() {
    // Inside of a ball of radius 2: a path through the centre comes back, and neighbours meet in the centre.
    let space = manifold(
        "metric = { conformal = '1' }\n[[glue]]\nface = '4 - x^2 - y^2 - z^2'\nmirror = true\n",
    );
    let (ray, path) = follow(&space, DVec3::ZERO, DVec3::new(0.3, 0.5, -0.7), 6.0);
    let at = |s: f64| sample(&space, &ray, &path, s);
    let back = at(4.0);
    assert!(
        back.u.length() < 1e-9 && back.area.unwrap() < 1e-8,
        "{back:?}"
    );
    assert_eq!((back.crossings, back.reversed), (1, true));
    // From a point 1.2 before the mirror: 1/1.2 + 1/b = 1 for a focal length of half the radius.
    let (ray, path) = follow(&space, DVec3::new(0.8, 0.0, 0.0), DVec3::X, 1.2 + 3.5);
    let (image, focus) = (6.0, 1.2);
    let spread = |s: f64| focus * (1.0 - s / image) + 0.0 * s;
    for s in [0.5, 1.5, 3.0] {
        let area = sample(&space, &ray, &path, 1.2 + s).area.unwrap();
        assert!(
            (area - spread(s).powi(2)).abs() < 1e-8,
            "{s}: {area} {}",
            spread(s).powi(2)
        );
    }
    // Off the axis: reflections keep the distance of the chords from the centre, and the plane.
    let (ray, path) = follow(
        &space,
        DVec3::new(0.3, -0.4, 0.2),
        DVec3::new(0.4, 0.7, 0.3),
        30.0,
    );
    let moment = |s: f64| {
        sample(&space, &ray, &path, s)
            .u
            .cross(sample(&space, &ray, &path, s).v)
    };
    assert!((moment(0.1) - moment(29.9)).length() < 1e-9);
    let frame = sample(&space, &ray, &path, 29.9).frame.unwrap();
    let off = frame.transpose() * frame - DMat3::IDENTITY;
    assert!(off.to_cols_array().iter().all(|x| x.abs() < 1e-10));
}

/// Neighbouring rays by difference: areas behind a curved mirror off the axis.
#[test]
fn areas_behind_mirrors_are_those_of_neighbours() {
    let space = manifold(
        "metric = { conformal = '1 + 0.1*x^2' }\n[[glue]]\nface = '2 - x^2 - 0.5*y^2 - z^2'\nmirror = true\n",
    );
    let (u, d) = (
        DVec3::new(0.3, -0.4, 0.2),
        DVec3::new(0.4, 0.7, 0.3).normalize(),
    );
    let length = 3.3;
    let ray = Ray::new(&space, u, d, length);
    let path = paths(&space, settings(1e-13, true), [ray]).remove(0);
    let found = path.steps.last().unwrap().deviation(length).unwrap();
    let crossings = path.steps.last().unwrap().crossings;
    assert!(crossings >= 1);
    let frame = space.standard_frame(u);
    for (k, j) in found.into_iter().enumerate() {
        let e = frame.inverse() * ray.spread[k];
        let end = |epsilon: f64| {
            let (_, path) = follow(&space, u, d + e * epsilon, length);
            path.steps.last().unwrap().position(length)
        };
        let slope = (end(1e-5) - end(-1e-5)) / 2e-5;
        assert!((slope - j).length() < 1e-6 * j.length(), "{slope} {j}");
    }
}

/// Whoever goes through a portal of the catalogue and turns back comes back, from either side of both discs.
#[test]
fn ways_through_portals_lead_back() {
    let portal = asset("portal");
    let mut crossed = 0;
    for (u, d) in [
        ([2.5, 0.1, 0.2], [-1.0, 1e-4, 0.0]),
        ([0.0, 0.1, 0.2], [1.0, 1e-4, 0.0]),
        ([-1.0, 0.1, 0.2], [1.0, 0.05, 0.02]),
        ([-1.0, 0.1, 0.2], [-1.0, 0.05, 0.02]),
        ([-6.0, -0.4, 0.2], [0.9, 0.03, -0.07]),
        ([3.0, -0.4, 0.2], [-0.9, 0.01, -0.02]),
    ] {
        let (u, length) = (DVec3::from(u), 17.0);
        let (ray, there) = follow(&portal, u, DVec3::from(d), length);
        assert!(there.length == length && there.tried < 200, "{there:?}");
        let end = sample(&portal, &ray, &there, length);
        crossed += end.crossings;
        let (ray, back) = follow(&portal, end.u, -end.v, length);
        let home = sample(&portal, &ray, &back, length);
        assert!(home.u.distance(u) < 1e-9, "{u}: {}", home.u);
        assert_eq!(home.crossings, end.crossings);
    }
    assert!(crossed >= 8, "{crossed}");
}

/// Long steps that meet a disc and, beside it, an exit are tried again shorter.
#[test]
fn paths_through_portals_do_not_depend_on_how_far_they_are_followed() {
    let portal = asset("portal");
    let ends = [60.0, 200.0, 300.0, 960.0].map(|length| {
        let (u, d) = (DVec3::new(-1.5, -0.4, 0.2), DVec3::new(1.0, 0.011, -0.004));
        let (ray, path) = follow(&portal, u, d, length);
        (sample(&portal, &ray, &path, 60.0), path.length)
    });
    for (at, length) in &ends[1..] {
        assert!(
            at.u.distance(ends[0].0.u) < 1e-9 && at.crossings == 12,
            "{at:?}"
        );
        assert!((length - ends[1].1).abs() < 1e-9, "{length}");
    }
}

/// A doorway: two discs in flat space, one glued to the other.
#[test]
fn a_portal_is_there_only_where_its_opening_is() {
    let space = manifold(
        "metric = { conformal = '1' }\n[[glue]]\nface = '1 - x'\nmap = ['x - 4', 'y', 'z']\nopening = '0.25 - y^2 - z^2'\n",
    );
    let end = |y: f64| {
        let (ray, path) = follow(&space, DVec3::new(0.0, y, 0.1), DVec3::X, 2.0);
        sample(&space, &ray, &path, 2.0)
    };
    assert!((end(0.1).u - DVec3::new(-2.0, 0.1, 0.1)).length() < 1e-12);
    assert!((end(0.6).u - DVec3::new(2.0, 0.6, 0.1)).length() < 1e-12);
    assert_eq!((end(0.1).crossings, end(0.6).crossings), (1, 0));
}

#[test]
fn rays_through_edges_and_corners_and_along_faces_go_on() {
    let space = asset("half-turn");
    let end = |u: DVec3, d: DVec3, length: f64| {
        let (ray, path) = follow(&space, u, d, length);
        assert_eq!(path.end, End::Length);
        sample(&space, &ray, &path, path.length).u
    };
    // Through edges: x and y at once.
    let t = 20.0 / 2.0_f64.sqrt() - 14.0;
    let found = end(DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0), 20.0);
    assert!((found - DVec3::new(t, t, 0.0)).length() < 1e-10, "{found}");
    // Through corners: six layers up, an even number of half turns.
    let t = 20.0 / 3.0_f64.sqrt() - 12.0;
    let found = end(DVec3::ZERO, DVec3::ONE, 20.0);
    assert!((found - DVec3::splat(t)).length() < 1e-10, "{found}");
    // Along a face, which rounding may put on either side.
    let found = end(DVec3::new(1.0, 0.1, 0.2), DVec3::Y, 4.0);
    assert!(
        (found.x.abs() - 1.0).abs() < 1e-9 && (found.y - 0.1).abs() < 1e-9,
        "{found}"
    );
}

#[test]
fn a_wind_blows_through_faces() {
    let faces = pair("1 - x", ["x - 2", "y", "z"]) + &pair("1 + x", ["x + 2", "y", "z"]);
    let space = manifold(&format!(
        "metric = {{ conformal = '1' }}\nwind = ['0.3', '0', '0.1']\n{faces}"
    ));
    let (u, d) = (DVec3::new(0.2, 0.1, 0.0), DVec3::new(0.5, 0.2, -0.3));
    let (ray, path) = follow(&space, u, d, 9.0);
    let last = sample(&space, &ray, &path, 9.0);
    // A line of sight runs into the past: against the wind.
    let mut end = u + (d.normalize() - DVec3::new(0.3, 0.0, 0.1)) * 9.0;
    end.x -= 2.0 * ((end.x + 1.0) / 2.0).floor();
    assert!((last.u - end).length() < 1e-10, "{} {end}", last.u);
    // A gluing that turns the wind round is refused.
    let turned = pair("1 - x", ["x - 2", "-y", "-z"]) + &pair("1 + x", ["x + 2", "-y", "-z"]);
    let text = format!(
        "name = 'test'\ncoordinates = ['x', 'y', 'z']\nmetric = {{ conformal = '1' }}\nwind = ['0.3', '0', '0.1']\n{turned}"
    );
    let error = Manifold::from_source(SourceText::new("test.toml", text), &[]).unwrap_err();
    assert!(
        error.report(false).contains("its map is no isometry"),
        "{}",
        error.report(false)
    );
}
