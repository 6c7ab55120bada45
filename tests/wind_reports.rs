//! What is said about winds, spacetimes and textbook coordinates that cannot be: where it stands, what is
//! wrong, what to do.

use geofan_core::{diagnostic::SourceText, manifold::Manifold};

/// The report on `text`, whose first line stands in line 3.
fn report(text: &str) -> String {
    let text = format!("name = \"test\"\ncoordinates = [\"x\", \"y\", \"z\"]\n{text}");
    match Manifold::from_source(SourceText::new("m.toml", &text), &[]) {
        Err(error) => error.report(false),
        Ok(_) => panic!("accepted:\n{text}"),
    }
}

/// Checks the place, the message and the help of the report on `text`.
#[track_caller]
fn refused(text: &str, place: &str, message: &str, help: &str) {
    let report = report(text);
    for part in [place, message, help] {
        assert!(report.contains(part), "`{part}` is not in\n{report}");
    }
}

/// Spherical coordinates.
const SPHERICAL: &str = "\
[pullback]
r = 'sqrt(x^2 + y^2 + z^2)'
th = 'atan2(sqrt(x^2 + y^2), z)'
ph = 'atan2(y, x)'
[metric]
rr = '1'
thth = 'r^2'
phph = '(r*sin(th))^2'
";

#[test]
fn a_wind_needs_a_metric_that_is_positive() {
    refused(
        "metric = { xx = '1', yy = '1', zz = 'x' }\nwind = ['1', '0', '0']\n[cameras]\nat = ['-1', '0', '0']",
        "m.toml:3:1",
        "the metric is not positive definite at x = -1.000000",
        "restrict the region",
    );
    refused(
        "metric = { conformal = '1' }\nwind = ['1/x', '0', '0']\n[cameras]\nat = ['0', '1', '0']",
        "m.toml:4:1",
        "wind or drift is not finite at x = 0.000000, y = 1.000000",
        "mend the expressions",
    );
    refused(
        "metric = { conformal = '1' }\nlapse = 'x'\n[cameras]\nat = ['-2', '0', '0']",
        "m.toml:4:1",
        "the lapse is -2 at x = -2.000000",
        "must be positive",
    );
}

#[test]
fn spacetimes_without_observers_are_refused() {
    let schwarzschild = |observers: &str, x: f64| {
        format!(
            "[let]\nf = '2/sqrt(x^2 + y^2 + z^2)'\n[spacetime]\nobservers = '{observers}'\ntt = 'f - 1'
tx = 'f*x*f/2'\nty = 'f*y*f/2'\ntz = 'f*z*f/2'
xx = '1 + f*(x*f/2)^2'\nyy = '1 + f*(y*f/2)^2'\nzz = '1 + f*(z*f/2)^2'
xy = 'f*x*y*f^2/4'\nxz = 'f*x*z*f^2/4'\nyz = 'f*y*z*f^2/4'\n[cameras]\nat = ['{x:?}', '0', '0']"
        )
    };
    assert!(
        Manifold::from_source(
            SourceText::new(
                "m.toml",
                format!(
                    "name = 't'\ncoordinates = ['x', 'y', 'z']\n{}",
                    schwarzschild("normal", 1.5)
                )
            ),
            &[]
        )
        .is_ok()
    );
    refused(
        &schwarzschild("static", 1.5),
        "m.toml:6:1",
        "no observer is at rest at x = 1.500000, y = 0.000000, z = 0.000000: g_tt is not negative there",
        "keep cameras out of the ergosphere, or take observers = \"normal\"",
    );
    refused(
        "[spacetime]\ntt = '1'\nxx = '1'\nyy = '1'\nzz = '1'\n[cameras]\nat = ['1', '0', '0']",
        "m.toml:3:1",
        "the slice t = const is not spacelike at x = 1.000000",
        "give `metric` and `drift`",
    );
    refused(
        &schwarzschild("free", 3.0),
        "m.toml:6:13",
        "observers cannot be `free`",
        "\"static\": in the coordinates",
    );
}

#[test]
fn light_that_reaches_the_ergosphere_of_observers_at_rest_ends_there() {
    let text = std::fs::read_to_string(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/assets/manifolds/kerr-ingoing.toml"
    ));
    let text = text
        .unwrap()
        .replace("[spacetime]\n", "[spacetime]\nobservers = \"static\"\n");
    let text = text.replace("r = [1.0, 12.0]", "r = [3.0, 12.0]");
    let hole = Manifold::from_source(SourceText::new("kerr", text), &[]).unwrap();
    use geofan_core::geodesic::{Ray, Settings, paths};
    let settings = Settings::bare(1e-9).with_events();
    let ray = |d: [f64; 3]| {
        let d = glam::DVec3::from(d).normalize();
        Ray::new(&hole, glam::DVec3::X * 8.0, d, 60.0)
    };
    let into = paths(
        &hole,
        settings,
        [ray([-1.0, 0.05, 0.02]), ray([-0.2, 0.9, 0.1])],
    );
    // Either where the condition fails, or where the metric allows no further step to it.
    assert!(["inside", "singular"].contains(&into[0].end.name(&hole)));
    assert_eq!(into[1].end.name(&hole), "sky");
    let end = into[0].steps.last().unwrap().position(into[0].length);
    // g_tt = 0 at r² + a² cos²θ = 2 r.
    let lapse = hole.normal_frequency(end, glam::DVec3::ZERO);
    assert!(lapse > 1e3, "{end} {lapse}");
}

#[test]
fn what_does_not_go_together_is_named() {
    let flat = "metric = { conformal = '1' }\n";
    refused(
        &format!("{flat}wind = ['1', '0', '0']\nshift = ['1', '0', '0']"),
        "m.toml:5:9",
        "both `wind` and `shift` are given",
        "the wind is -shift",
    );
    refused(
        "embedding = ['x', 'y', 'z']\nshift = ['1', '0', '0']",
        "m.toml:4:9",
        "`shift` belongs to a metric",
        "`wind`",
    );
    refused(
        "[spacetime]\ntt = '-1'\nxx = '1'\nyy = '1'\nzz = '1'\n[let]\na = '1'"
            .replace("[spacetime]", "lapse = '1'\n[spacetime]")
            .as_str(),
        "m.toml:3:9",
        "[spacetime] has wind, shift, lapse and drift of its own",
        "take this away",
    );
    refused(
        &format!("{flat}[spacetime]\ntt = '-1'\nxx = '1'\nyy = '1'\nzz = '1'"),
        "m.toml:4:1",
        "`spacetime` is given beside `embedding` or `metric`",
        "keep exactly one",
    );
    refused(
        "[spacetime]\ntt = '-1'\nxx = '1'\nyy = '1'",
        "m.toml:3:1",
        "`zz` is missing",
        "four diagonal entries",
    );
    refused(
        "[spacetime]\ntt = '-1'\ntx = '0.1'\nxt = '0.1'\nxx = '1'\nyy = '1'\nzz = '1'",
        "m.toml:6:6",
        "this entry of the symmetric metric is given twice",
        "give one of tx and xt",
    );
    refused(
        &format!("{flat}wind = ['1', '0']"),
        "m.toml:4:8",
        "3 components are needed here, 2 given",
        "",
    );
    refused(
        &format!("{flat}wind = ['vx', '0', '0']"),
        "m.toml:4:10",
        "the tangent may be used only in exits",
        "depend on the point alone",
    );
}

#[test]
fn false_claims_about_a_wind_are_refused_with_the_point() {
    let flat = "metric = { conformal = '1' }\n";
    refused(
        &format!("{flat}wind = ['0.1', '0', '0']\n[symmetry]\nrotation = 'origin'"),
        "m.toml:6:1",
        "this symmetry is not one of the wind: at x = ",
        "remove the claim, or mend the wind",
    );
    refused(
        &format!("{flat}wind = ['0.1*x', '0', '0']\n[symmetry]\ntranslation = ['x']"),
        "m.toml:6:1",
        "velocities differ by",
        "mend the wind",
    );
    refused(
        &format!("{flat}drift = ['0', 'x^2', '0']\n[symmetry]\nrotation = 'z'"),
        "m.toml:6:1",
        "this symmetry is not one of the wind",
        "mend the wind",
    );
    refused(
        &format!("{flat}wind = ['-y', 'x', 'x']\n[symmetry]\nrotation = 'z'"),
        "m.toml:6:1",
        "this symmetry is not one of the wind",
        "mend the wind",
    );
    // A drift that differs by a gradient is the same.
    let fine = format!(
        "name = 't'\ncoordinates = ['x', 'y', 'z']\n{flat}drift = ['0.3', '0.2', '0']\n[symmetry]\nrotation = 'z'"
    );
    assert!(Manifold::from_source(SourceText::new("m.toml", fine), &[]).is_ok());
    refused(
        &format!("{flat}[symmetry]\nrotation = 'w'"),
        "m.toml:5:12",
        "rotations about `w` are not known",
        "the coordinate along the axis: x, y, z",
    );
}

#[test]
fn textbook_coordinates_must_be_regular_where_cameras_are() {
    refused(
        &format!("{SPHERICAL}[cameras]\nat = ['0', '0', '0']"),
        "m.toml:3:1",
        "the coordinates of [pullback] are singular at a camera: x = 0.000000, y = 0.000000, z = 0.000000",
        "move the cameras",
    );
    refused(
        "[pullback]\nr = 'x'\ns = 'x*y'\nt = 'x'\n[metric]\nrr = '1'\nss = '1'\ntt = '1'",
        "m.toml:3:1",
        "not three independent coordinates",
        "dependent everywhere",
    );
    refused(
        "[pullback]\nr = 'x'\ns = 'y'\n[metric]\nrr = '1'",
        "m.toml:3:1",
        "3 coordinates are needed here, 2 given",
        "an expression of the chart's coordinates",
    );
    refused(
        "metric = { conformal = '1' }\n[pullback]\nr = '2*x'\ns = 'y'\nt = 'z'",
        "m.toml:3:24",
        "`conformal` is a factor of the chart's own coordinates",
        "give the entries in the coordinates named there",
    );
    refused(
        "metric = { xx = '1', yy = '1', zz = '1' }\n[pullback]\nr = '2*x'\ns = 'y'\nt = 'z'",
        "m.toml:3:12",
        "unknown key `xx`",
        "",
    );
}
