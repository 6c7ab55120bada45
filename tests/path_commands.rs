//! The commands that follow light: pictures by the path tracer and by the local view.

use assert_cmd::{Command, cargo::cargo_bin};
use std::{path::Path, process::Stdio, time::Duration};

/// Runs the program in `folder` with `arguments`, which are divided at spaces: its exit code, and what
/// was said.
fn geofan(folder: &Path, arguments: &str) -> (Option<i32>, String) {
    let output = Command::cargo_bin("geofan")
        .unwrap()
        .current_dir(folder)
        .args(["--quiet", "--json"])
        .args(arguments.split(' '))
        .output()
        .unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (
        output.status.code(),
        text(output.stdout) + &text(output.stderr),
    )
}

fn write_scene(folder: &Path) {
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).unwrap();
    write(
        "space.toml",
        "name = 'space'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1' }\n[cameras]\nlength = 5\n",
    );
    write(
        "square.obj",
        "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3 4\n",
    );
    write(
        "scene.toml",
        "manifold = 'space.toml'\n[camera]\nat = [0, -0.8, 0.4]\nlook = [0, 1, -0.6]\nup = [0, 0, 1]\n\
         [[object]]\nmesh = 'square.obj'\nat = [0, 0, 0]\nscale = 0.5\n\
         [[light]]\nkind = 'point'\nat = [0.1, 0, 0.4]\nintensity = [1, 1, 1]\n",
    );
}

#[test]
fn a_path_that_would_meet_a_pole_of_the_chart_is_turned_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let polar = "name = 'polar'\ncoordinates = ['r', 'th', 'ph']\n\
                 metric = { rr = '1', thth = 'r^2', phph = '(r*sin(th))^2' }\n\
                 domain = { r = [0, 100], th = [0, 3.141592653589793] }\n";
    std::fs::write(folder.path().join("polar.toml"), polar).unwrap();
    // Through the axis at (x, z) = (0, 2) from (2, 0): on the other side at (−1, 3).
    let toward =
        "trace polar.toml --at 2,1.5707963267948966,0.4 --dir=-1,-1,0 --length 4.242640687";
    let (code, said) = geofan(folder.path(), toward);
    assert_eq!(code, Some(0), "{said}");
    let trace: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert_eq!(trace["end"], "length", "{said}");
    assert_eq!(trace["turned"], 1e-7, "{said}");
    let u = trace["samples"][1]["u"].as_array().unwrap();
    let [r, th] = [0, 1].map(|k| u[k].as_f64().unwrap());
    assert!(
        (r * th.sin() - 1.0).abs() < 1e-6 && (r * th.cos() - 3.0).abs() < 1e-6,
        "{said}"
    );
    let (_, beside) = geofan(
        folder.path(),
        "trace polar.toml --at 2,1.5,0.4 --dir=0,1,1 --length 4",
    );
    assert!(!beside.contains("turned"), "{beside}");
}

#[test]
fn a_path_traced_picture_can_be_left_and_taken_up_again() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path());
    let render = |more: &str| {
        let arguments = format!("render scene.toml --tracer path --size 24x16 --spp 6 -o {more}");
        geofan(folder.path(), &arguments)
    };
    let read = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    let (code, said) = render("whole.png");
    assert_eq!(code, Some(0), "{said}");
    assert!(
        said.contains("\"spp\":6") && said.contains("exact_rays_per_second"),
        "{said}"
    );
    // No time at all: one pass is done and kept.
    let (code, said) = render("parts.png --time 1e-9");
    assert!(code == Some(0) && said.contains("\"spp\":1"), "{said}");
    assert!(folder.path().join("parts.png.passes").exists());
    let (code, said) = render("parts.png --seed 9 --resume");
    assert!(
        code == Some(2) && said.contains("another picture"),
        "{said}"
    );
    let (code, said) = render("parts.png --resume");
    assert!(code == Some(0) && said.contains("\"spp\":6"), "{said}");
    assert_eq!(read("whole.png"), read("parts.png"));
    assert!(!folder.path().join("parts.png.passes").exists());
}

/// Begins what takes minutes, and presses Ctrl-C after a while: the exit code (none if the
/// program was not yet ready for the signal) and what was said.
fn interrupted(folder: &Path, arguments: &str, after: Duration) -> (Option<i32>, String) {
    let child = std::process::Command::new(cargo_bin("geofan"))
        .current_dir(folder)
        .args("--quiet --threads 1".split(' '))
        .args(arguments.split(' '))
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    std::thread::sleep(after);
    let kill = std::process::Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status();
    assert!(kill.unwrap().success());
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    (output.status.code(), said)
}

#[test]
fn a_path_traced_picture_goes_on_after_an_interruption_as_if_there_had_been_none() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path());
    let render = "render scene.toml --tracer path --size 160x120";
    let begun = format!("{render} --spp 4096 -o parts.png");
    let (code, said) = [300, 1000, 4000]
        .into_iter()
        .map(|ms| interrupted(folder.path(), &begun, Duration::from_millis(ms)))
        .find(|(code, _)| code.is_some())
        .unwrap();
    assert_eq!(code, Some(75), "{said}");
    assert!(said.contains("--resume"), "{said}");
    assert!(folder.path().join("parts.png.passes").exists());
    assert!(!folder.path().join("parts.png").exists());
    let (kept, _) = said.split_once(" of 4096 samples are kept").unwrap();
    let kept: u64 = kept.rsplit(' ').next().unwrap().parse().unwrap();
    let samples = kept + 2;
    for end in ["-o parts.png --resume", "-o whole.png"] {
        let arguments = format!("{render} --spp {samples} {end}");
        let (code, said) = geofan(folder.path(), &arguments);
        assert_eq!(code, Some(0), "{said}");
    }
    let read = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    assert_eq!(read("whole.png"), read("parts.png"));
}

#[test]
fn an_exr_of_the_path_tracer_has_its_variance() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path());
    let arguments = "render scene.toml --tracer path --size 8x6 --spp 3 -o a.exr";
    let (code, said) = geofan(folder.path(), arguments);
    assert_eq!(code, Some(0), "{said}");
    let (picture, _) = geofan_render::picture::read_exr(&folder.path().join("a.exr")).unwrap();
    for name in [
        "variance.R",
        "variance.G",
        "variance.B",
        "Z",
        "N.X",
        "id",
        "area",
    ] {
        assert!(picture.layer(name).is_some(), "no layer {name}");
    }
}

#[test]
fn the_local_view_is_drawn_and_compared() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path());
    let arguments = "render scene.toml --tracer local --size 24x16 -o local.png";
    let (code, said) = geofan(folder.path(), arguments);
    assert_eq!(code, Some(0), "{said}");
    let arguments = "compare scene.toml --tracer local --size 24x16 --out .";
    let (code, said) = geofan(folder.path(), arguments);
    assert!(
        code == Some(0) && said.contains("mrad_per_length"),
        "{said}"
    );
    assert!(folder.path().join("error.png").exists());
}

#[test]
fn requests_that_cannot_be_met_are_refused_as_such() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path());
    let scene = std::fs::read_to_string(folder.path().join("scene.toml")).unwrap();
    let write = |name: &str, from: &str, to: &str| {
        std::fs::write(folder.path().join(name), scene.replace(from, to)).unwrap();
    };
    write("nul.toml", "'space.toml'", "\"a\\u0000b.toml\"");
    let parallel = "up = [0, 0, 1]\nprojection = 'orthographic'\nwidth = 2";
    write("parallel.toml", "up = [0, 0, 1]", parallel);
    for (arguments, told) in [
        ("render nul.toml -o a.png", "NUL"),
        (
            "render scene.toml -o a.png --length 1e101",
            "no length between",
        ),
        ("project parallel.toml --point 0,0,0.1", "parallel rays"),
        ("render scene.toml -o a.png --tracer table", "`geofan bake`"),
        (
            "compare scene.toml --bundle no.fan --length 3 --out c",
            "--length: does nothing",
        ),
        (
            "compare scene.toml --tracer local --lattice --out c",
            "--lattice: does nothing",
        ),
    ] {
        let (code, said) = geofan(folder.path(), arguments);
        assert!(
            code == Some(2) && said.contains(told),
            "{arguments}: {said}"
        );
    }
}

#[test]
fn a_light_outside_the_space_is_underlined() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path());
    let path = folder.path().join("space.toml");
    let text =
        std::fs::read_to_string(&path).unwrap() + "[domain]\ninside = ['1 - x^2 - y^2 - 7*z^2']\n";
    std::fs::write(&path, text).unwrap();
    let arguments = "render scene.toml --size 8x8 -o a.png";
    let (code, said) = geofan(folder.path(), arguments);
    assert!(
        code == Some(2) && said.contains("scene.toml") && said.contains("^"),
        "{said}"
    );
}
