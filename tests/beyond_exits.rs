//! What lies beyond an exit: cameras, poses, rays and camera regions are refused with their place, objects and
//! lamps told.

use assert_cmd::{assert::Assert, cargo::cargo_bin_cmd};
use std::{fs, path::Path};
use tempfile::TempDir;

/// Flat space with an exit at distance 5, and another where x is large for whoever moves that way.
const SPACE: &str = r#"
name = "space"
coordinates = ["x", "y", "z"]
metric = { conformal = "1" }
[[exit]]
name = "sky"
when = "sqrt(x^2 + y^2 + z^2) - 5"
[[exit]]
name = "door"
when = "x + 0.5*vx - 4"
[cameras]
REGION
length = 12.0
"#;

const SQUARE: &str = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3 4\n";

/// A folder with the space, whose cameras are given so, and a mesh.
fn folder(region: &str) -> TempDir {
    let folder = TempDir::new().unwrap();
    let text = SPACE.replace("REGION", region);
    fs::write(folder.path().join("m.toml"), text).unwrap();
    fs::write(folder.path().join("square.obj"), SQUARE).unwrap();
    folder
}

const WITHIN: &str = "parameters = { c = [-3, 3] }\nat = ['c', '0.1', '0.2']";

fn geofan(folder: &Path, arguments: &str) -> Assert {
    let mut command = cargo_bin_cmd!("geofan");
    command.current_dir(folder).env("NO_COLOR", "1");
    command.args(arguments.split(' ')).assert()
}

/// The log of a command that ends with this code.
fn log(folder: &Path, arguments: &str, code: i32) -> String {
    let assert = geofan(folder, arguments).code(code);
    String::from_utf8(assert.get_output().stderr.clone()).unwrap()
}

fn assert_all(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "{part:?} is not in {text}");
    }
}

/// Renders a scene of this camera and these things.
fn render(camera: &str, things: &str, code: i32) -> String {
    let folder = folder(WITHIN);
    let text = format!(
        "manifold = 'm.toml'\ncamera = {{ {camera}, look = [-1, 0, 0], up = [0, 0, 1] }}\n{things}\n\
         [sky]\nsky = {{ color = [0, 0, 1] }}\n"
    );
    fs::write(folder.path().join("s.toml"), text).unwrap();
    log(folder.path(), "render s.toml --size 16x12 -o a.png", code)
}

#[test]
fn a_camera_beyond_an_exit_is_refused_at_its_place() {
    let found = render("at = [6, 0, 0]", "", 2);
    assert_all(
        &found,
        &["beyond the exit `sky`", "`when` is 1.000000", "s.toml:2:"],
    );
    assert!(!render("at = [3, 0, 0]", "", 0).contains("beyond"));
}

#[test]
fn an_exit_for_one_direction_keeps_no_camera_out_that_may_look_another_way() {
    assert!(!render("at = [4.2, 0, 0]", "", 0).contains("beyond"));
    assert_all(
        &render("at = [4.6, 0, 0]", "", 2),
        &["beyond the exit `door`"],
    );
}

#[test]
fn a_pose_beyond_an_exit_is_refused_at_its_place() {
    let folder = folder(WITHIN);
    let scene =
        "manifold = 'm.toml'\ncamera = { at = [1, 0, 0], look = [0, 1, 0], up = [0, 0, 1] }\n";
    fs::write(folder.path().join("s.toml"), scene).unwrap();
    let pose = |t: f64, x: f64| {
        format!("[[pose]]\ntime = {t}\nat = [0, {x}, 0]\nlook = [0, 1, 0]\nup = [0, 0, 1]\n")
    };
    fs::write(
        folder.path().join("p.toml"),
        pose(0.0, 1.0) + &pose(1.0, 5.5),
    )
    .unwrap();
    let arguments = "render s.toml --camera-path p.toml --frames 2 --size 8x6 -o f-%d.png";
    let found = log(folder.path(), arguments, 2);
    assert_all(&found, &["beyond the exit `sky`", "0.500000", "p.toml:8"]);
}

#[test]
fn a_ray_that_starts_beyond_an_exit_is_refused_by_table_and_integrator() {
    let folder = folder(WITHIN);
    let found = log(folder.path(), "trace m.toml --at=0,7,0 --dir=0,-1,0", 2);
    assert_all(
        &found,
        &["--at", "beyond the exit `sky`", "2.000000", "this side"],
    );
    log(
        folder.path(),
        "bake m.toml -o m.fan --max-error 5 --certify-rays 200",
        0,
    );
    let found = log(
        folder.path(),
        "trace --bundle m.fan --at=0,7,0 --dir=0,-1,0",
        2,
    );
    assert_all(&found, &["--at", "beyond the exit `sky`"]);
    // The geometry of a point is there on either side.
    log(folder.path(), "info m.toml --at=0,7,0", 0);
}

#[test]
fn a_camera_region_beyond_an_exit_is_refused_where_the_file_gives_it() {
    let wrong = folder("parameters = { c = [2, 9] }\nat = ['0', 'c', '0']");
    let found = log(wrong.path(), "info m.toml", 2);
    assert_all(
        &found,
        &["reaches beyond the exit `sky`", "at = ['0', 'c', '0']"],
    );
    // Limits of coordinates are no cameras: those may reach beyond.
    let text = fs::read_to_string(wrong.path().join("m.toml")).unwrap();
    let limits = "[domain]\nx = [-20, 20]\ny = [-20, 20]\nz = [-20, 20]\n[cameras]";
    let text = text.replace("[cameras]", limits);
    let text = text.replace("parameters = { c = [2, 9] }\nat = ['0', 'c', '0']", "");
    fs::write(wrong.path().join("m.toml"), text).unwrap();
    log(wrong.path(), "info m.toml", 0);
}

#[test]
fn objects_and_lamps_beyond_an_exit_are_told_and_the_picture_is_drawn() {
    let object = |y: f64| format!("[[object]]\nmesh = 'square.obj'\nat = [0, {y}, 0]\nscale = 0.5");
    let whole = render("at = [3, 0, 0]", &object(8.0), 0);
    assert_all(
        &whole,
        &[
            "square.obj: every corner of it lies beyond the exit `sky`",
            "2.5",
        ],
    );
    let half = render("at = [3, 0, 0]", &object(4.9), 0);
    assert_all(&half, &["50.0 % of its corners lies beyond the exit `sky`"]);
    assert!(!render("at = [3, 0, 0]", &object(2.0), 0).contains("beyond"));
    // The floor goes through the world, and its corners are outside.
    let floor = "[[object]]\nmesh = 'square.obj'\nat = [0, 0, -1]\nscale = 1e4";
    assert!(!render("at = [3, 0, 0]", floor, 0).contains("beyond"));
    let far = "[[object]]\nmesh = 'square.obj'\nat = [0, 0, -6]\nscale = 1e200";
    let found = render("at = [3, 0, 0]", far, 0);
    assert_all(&found, &["every corner of it lies beyond", "e200"]);
    let lamp = "[[light]]\nkind = 'point'\nat = [0, 0, 6.25]\nintensity = [1, 1, 1]";
    let found = render("at = [3, 0, 0]", lamp, 0);
    assert_all(
        &found,
        &["light 1: it lies beyond the exit `sky`", "1.250000"],
    );
}
