//! Glued spaces of any unit, and how paths end in them: checks and crossings do not depend on how large a domain is in the
//! chart, and what is met behind a face ends a path as it does anywhere.

mod support;

use geofan_core::{
    diagnostic::SourceText,
    geodesic::{End, Ray, check_start, paths, sample},
    manifold::Manifold,
};
use glam::DVec3;
use support::{manifold, settings};

/// Returns what is said about a file with this text and parameter `h`; `None` if it is accepted.
fn refusal(text: &str, h: f64) -> Option<String> {
    let text = format!(
        "name = 'test'\ncoordinates = ['x', 'y', 'z']\nparameters = {{ h = {h:e} }}\n{text}"
    );
    let read = Manifold::from_source(SourceText::new("test.toml", text), &[]);
    read.err().map(|error| error.report(false))
}

/// Faces at ±h across the axes, with these maps of the upper ones and the lower ones.
fn faces(maps: &[(&str, &str, &str)]) -> String {
    let face = |(axis, there, back): &(&str, &str, &str)| {
        format!(
            "[[glue]]\nface = 'h - {axis}'\nmap = {there}\n[[glue]]\nface = '{axis} + h'\nmap = {back}\n"
        )
    };
    maps.iter().map(face).collect()
}

const FLAT: &str = "metric = { conformal = '1' }\n";

#[test]
fn checks_look_at_all_of_a_domain_however_large_it_is() {
    let torus = faces(&[
        ("x", "['x - 2*h', 'y', 'z']", "['x + 2*h', 'y', 'z']"),
        ("y", "['x', 'y - 2*h', 'z']", "['x', 'y + 2*h', 'z']"),
        ("z", "['x', 'y', 'z - 2*h']", "['x', 'y', 'z + 2*h']"),
    ]);
    let lens = "metric = { conformal = '1 + 0.5*exp(-((x - 0.95*h)^2 + y^2 + z^2)/(0.1*h)^2)' }\n";
    let nowhere = faces(&[("x", "['x - 1.5*h', 'y', 'z']", "['x + 1.5*h', 'y', 'z']")]);
    let open = faces(&[
        ("x", "['x - 2*h', '-z', 'y']", "['x + 2*h', 'z', '-y']"),
        ("y", "['-x', 'y - 2*h', 'z']", "['-x', 'y + 2*h', 'z']"),
        ("z", "['x', 'y', 'z - 2*h']", "['x', 'y', 'z + 2*h']"),
    ]);
    for h in [1e-6, 0.01, 1.0, 7.0, 10.0, 1e3, 1e6] {
        let said = |text: String| refusal(&text, h);
        assert_eq!(said(FLAT.to_owned() + &torus), None, "{h}");
        for (text, complaint) in [
            (lens.to_owned() + &torus, "its map is no isometry"),
            (FLAT.to_owned() + &nowhere, "its map leads to no face"),
            (FLAT.to_owned() + &open, "does not close"),
        ] {
            let said = said(text).unwrap_or_default();
            assert!(said.contains(complaint), "h = {h}: {said}");
        }
    }
}

#[test]
fn portals_and_finite_mirrors_are_met_in_any_unit() {
    for unit in [1e-7, 1e-3, 1.0, 1e6] {
        let opening = "opening = 'h^2 - y^2 - z^2'\n";
        let portal = format!(
            "[[glue]]\nface = 'h - x'\nmap = ['x - 5*h', 'y', 'z']\n{opening}[[glue]]\nface = 'x + 4*h'\nmap = ['x + 5*h', 'y', 'z']\n{opening}"
        );
        let mirror = format!("[[glue]]\nface = 'h - x'\nmirror = true\n{opening}");
        for (faces, end) in [(portal, 0.0), (mirror, -3.0)] {
            let space = manifold(&format!("parameters = {{ h = {unit:e} }}\n{FLAT}{faces}"));
            let ray = Ray::new(&space, DVec3::ZERO, DVec3::X, 5.0 * unit);
            let path = paths(&space, settings(1e-10, true), [ray]).remove(0);
            let last = sample(&space, &ray, &path, path.length);
            assert_eq!(last.crossings, 1, "unit {unit}: {}", last.u / unit);
            assert!((last.u.x / unit - end).abs() < 1e-9, "{}", last.u / unit);
        }
    }
    // Glass at the one disc and none at the other.
    let apart = "metric = { conformal = '1 + 0.5*exp(-2*((x + 5)^2 + y^2 + z^2))' }\n[[glue]]\nface = '10*h - x'\nmap = ['x - 15', 'y', 'z']\nopening = '1 - y^2 - z^2'\n";
    let said = refusal(apart, 1.0).unwrap_or_default();
    assert!(said.contains("its map is no isometry"), "{said}");
}

#[test]
fn what_is_met_behind_a_face_ends_a_path_there() {
    let torus = faces(&[("x", "['x - 2*h', 'y', 'z']", "['x + 2*h', 'y', 'z']")]);
    let exit = "[[exit]]\nname = 'sky'\nwhen = '-1.5 - x'\n";
    let condition = "[domain]\ninside = ['x + 1.5']\n";
    let periodic = "[domain]\nx = [-2, 2]\nperiodic = ['x']\n";
    for (text, end) in [
        (torus.clone() + exit, End::Exit(0)),
        (torus + condition, End::Exit(1)),
        (periodic.to_owned() + exit, End::Exit(0)),
    ] {
        let space = manifold(&format!("parameters = {{ h = 2 }}\n{FLAT}{text}"));
        let ray = Ray::new(&space, DVec3::new(0.0, 0.3, 0.0), DVec3::X, 6.0);
        let path = paths(&space, settings(1e-10, true), [ray]).remove(0);
        assert_eq!(path.end, end, "{text}");
        assert!((path.length - 2.0).abs() < 1e-9, "{}", path.length);
        assert!(
            check_start(&space, "here", DVec3::new(2.2, 0.0, 0.0)).is_err(),
            "{text}"
        );
    }
}

#[test]
fn a_path_ends_where_a_condition_has_no_value() {
    for (condition, end) in [
        ("sqrt(x)", 1.0),
        ("sqrt(x) - 0.1", 0.99),
        ("log(x) + 2", 1.0 - (-2.0_f64).exp()),
    ] {
        let space = manifold(&format!("{FLAT}domain = {{ inside = ['{condition}'] }}\n"));
        let ray = Ray::new(&space, DVec3::X, DVec3::NEG_X, 3.0);
        let path = paths(&space, settings(1e-10, true), [ray]).remove(0);
        assert_eq!(path.end, End::Exit(1), "{condition}");
        assert!(
            (path.length - end).abs() < 1e-9,
            "{condition}: {}",
            path.length
        );
    }
}

#[test]
fn light_that_a_wind_carries_through_a_mirror_ends_there() {
    let space = manifold(&format!(
        "{FLAT}wind = ['-1.5', '0', '0']\n[[glue]]\nface = '1 - x'\nmirror = true\n"
    ));
    // A line of sight runs into the past: with 1.5 to the right against the light that comes from there.
    let ray = Ray::new(
        &space,
        DVec3::ZERO,
        DVec3::new(1.0, 0.2, 0.0).normalize(),
        2.0,
    );
    let path = paths(&space, settings(1e-10, true), [ray]).remove(0);
    assert_eq!(path.end, End::Singular);
    let rate = 1.5 + 1.0 / 1.04_f64.sqrt();
    assert!((path.length - 1.0 / rate).abs() < 1e-9, "{}", path.length);
}

#[test]
fn a_drift_that_jumps_at_periodic_limits_is_refused() {
    let drift = "drift = ['0', '0.3*x', '0']\ndomain = { x = [0, 1], periodic = ['x'] }\n";
    let said = refusal(&(FLAT.to_owned() + drift), 1.0).unwrap_or_default();
    assert!(said.contains("the drift is not the same"), "{said}");
}

#[test]
fn a_metric_that_differs_at_periodic_limits_far_from_the_cameras_is_refused() {
    for (metric, wrong) in [
        ("1 + 0.3*if(z > 4, x, 0)", true),
        ("1 + 0.3*x*exp(-30*((y - 3)^2 + (z - 3.3)^2))", true),
        (
            "1 + 0.3*cos(3.14159265358979*x)*exp(-30*((y - 3)^2 + (z - 3.3)^2))",
            false,
        ),
        // Behind an exit, where nobody looks.
        ("1 + 0.3*if(z > 6, x, 0)", false),
    ] {
        let text = format!(
            "metric = {{ conformal = '{metric}' }}\nexit = [{{ name = 'sky', when = 'y^2 + z^2 - 25' }}]\n\
             domain = {{ x = [-1, 1], periodic = ['x'] }}\n[cameras]\nat = ['0', '0', '0']\nlength = 8\n"
        );
        let said = refusal(&text, 1.0).unwrap_or_default();
        assert_eq!(
            said.contains("is not the same at both glued limits"),
            wrong,
            "{metric}: {said}"
        );
    }
}

#[test]
fn cameras_behind_a_mirror_are_refused() {
    for (c, behind) in [("[-0.9, 0.9]", false), ("[-0.9, 1.1]", true)] {
        let text = format!(
            "metric = {{ conformal = '1' }}\nexit = [{{ name = 'sky', when = 'x^2 + y^2 + z^2 - 25' }}]\n\
             glue = [{{ face = '1 - x', mirror = true }}]\n[cameras]\nparameters = {{ c = {c} }}\nat = ['c', '0', '0']\n"
        );
        let said = refusal(&text, 1.0);
        let told = said
            .as_ref()
            .is_some_and(|said| said.contains("is behind a mirror"));
        assert_eq!((told, said.is_some()), (behind, behind), "{said:?}");
    }
}
