//! Points at which a glued space would have a cone are refused; corners between reflections are none.

mod support;

use geofan_core::{diagnostic::SourceText, manifold::Manifold};
use std::f64::consts::TAU;
use support::{manifold, pair, refusal};

/// A lens of the three-sphere between two great spheres, the upper glued to the lower after a fifth of a turn; a tenth
/// or another share of the full angle lies between them.
fn lens(share: f64) -> Result<Manifold, String> {
    let (turn, angle) = (TAU / 5.0, TAU * share);
    let map = |sign: f64| {
        let ((s, c), (t, d)) = ((sign * turn).sin_cos(), (sign * angle).sin_cos());
        let w = format!("(1 + ({t:?})*Z + ({d:?})*W)");
        [
            format!("(({c:?})*X - ({s:?})*Y)/{w}"),
            format!("(({s:?})*X + ({c:?})*Y)/{w}"),
            format!("(({d:?})*Z - ({t:?})*W)/{w}"),
        ]
    };
    let (s, c) = (0.5 * angle).sin_cos();
    let faces: String = [1.0, -1.0]
        .map(|sign| {
            let [x, y, z] = map(sign);
            pair(&format!("({s:?})*W - ({:?})*Z", sign * c), [&x, &y, &z])
        })
        .concat();
    let text = format!(
        "name = 'lens'\ncoordinates = ['x', 'y', 'z']\nmetric = {{ conformal = '2/(1 + r2)' }}\n[let]\nr2 = 'x^2 + y^2 + z^2'\n\
         X = '2*x/(1 + r2)'\nY = '2*y/(1 + r2)'\nZ = '2*z/(1 + r2)'\nW = '(1 - r2)/(1 + r2)'\n{faces}"
    );
    Manifold::from_source(SourceText::new("test.toml", text), &[]).map_err(|e| e.report(false))
}

/// Poincaré's condition: no map of these fixes a point, and every order of maps ends in the same point, but where the
/// angles round an edge are a part of the full one, space has a cone, where they are a multiple, cells overlap.
#[test]
fn edges_that_close_with_another_angle_than_the_full_one_are_refused() {
    assert!(lens(0.2).is_ok(), "the lens space L(5, 1)");
    for (share, angle) in [(0.1, "180"), (0.2 / 3.0, "120")] {
        let report = lens(share).expect_err("a cone");
        let told = format!(
            "face 1: space closes after {angle}.0 degrees round its edge with face 2, at x ="
        );
        assert!(report.contains(&told), "{report}");
        assert!(report.contains("space would have a cone there"), "{report}");
    }
    let other = lens(0.17).expect_err("no part of the full angle");
    assert!(other.contains("does not close"), "{other}");
    // A prism over a regular octagon, opposite sides glued: its eight edges are one, with three times the full angle.
    let faces: String = (0..8)
        .map(|k| {
            let (s, c) = (TAU * f64::from(k) / 8.0).sin_cos();
            pair(
                &format!("1 - ({c:?})*x - ({s:?})*y"),
                [
                    &format!("x - ({:?})", 2.0 * c),
                    &format!("y - ({:?})", 2.0 * s),
                    "z",
                ],
            )
        })
        .collect();
    let octagon = refusal(&faces);
    assert!(octagon.contains("does not close"), "{octagon}");
    // Corners between reflections are no cones: a room of mirrors, 45 degrees between two of its walls.
    let wedge = pair("y", ["x", "-y", "z"])
        + &pair("x - y", ["y", "x", "z"])
        + &pair("1 - x", ["2 - x", "y", "z"]);
    manifold(&format!("metric = {{ conformal = '1' }}\n{wedge}"));
}

/// The maps of these turn right into left and fix one point: a ball about it, its ends glued so, is a cone on the projective plane.
#[test]
fn maps_that_fix_one_point_and_turn_right_into_left_are_refused() {
    let flat = "metric = { conformal = '1' }\n";
    let sphere = "metric = { conformal = '2/(1 + r2)' }\nlet = { r2 = 'x^2 + y^2 + z^2' }\n";
    let quotient = |models: [&str; 2], centre: &str, generators: &str| {
        let [lift, drop] = models;
        format!(
            "[quotient]\nlift = [{lift}]\ndrop = [{drop}]\ncentre = [{centre}]\ngenerators = [{generators}]\n"
        )
    };
    let plain = ["'x', 'y', 'z', '1'", "'X/W', 'Y/W', 'Z/W'"];
    let round = [
        "'2*x/(1 + r2)', '2*y/(1 + r2)', '2*z/(1 + r2)', '(1 - r2)/(1 + r2)'",
        "'X/(1 + W)', 'Y/(1 + W)', 'Z/(1 + W)'",
    ];
    let inversion = "[[-1,0,0,0],[0,-1,0,0],[0,0,-1,0],[0,0,0,1]]";
    let step = |x: u8, y: u8, z: u8| format!("[[1,0,0,{x}],[0,1,0,{y}],[0,0,1,{z}],[0,0,0,1]]");
    let torus = [
        inversion.into(),
        step(2, 0, 0),
        step(0, 2, 0),
        step(0, 0, 2),
    ]
    .join(",");
    for text in [
        flat.to_owned()
            + &pair("1 - z", ["-x", "-y", "2 - z"])
            + &pair("1 + z", ["-x", "-y", "-2 - z"]),
        flat.to_owned() + &quotient(plain, "0, 0.1, 0.3", inversion),
        sphere.to_owned() + &quotient(round, "0, 0.1, 0.3", inversion),
        flat.to_owned() + &quotient(plain, "0.21, 0.13, 0.3", &torus),
    ] {
        let text = format!("name = 'test'\ncoordinates = ['x', 'y', 'z']\n{text}");
        let read = Manifold::from_source(SourceText::new("test.toml", text), &[]);
        let report = read.expect_err("a cone").report(false);
        assert!(
            report.contains("its map fixes a point of the domain"),
            "{report}"
        );
        assert!(report.contains("space would have a cone there"), "{report}");
    }
    // Reflections fix whole faces, and glides nothing.
    let mirrors = pair("1 - z", ["x", "y", "2 - z"]) + &pair("1 + z", ["x", "y", "-2 - z"]);
    let glides = pair("1 - z", ["-x", "y", "z - 2"]) + &pair("1 + z", ["-x", "y", "z + 2"]);
    for faces in [mirrors, glides] {
        manifold(&(flat.to_owned() + &faces));
    }
}
