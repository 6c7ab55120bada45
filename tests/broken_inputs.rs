//! What `geofan render` says about files that cannot work: exit code 2, the file and the place in
//! it, no panic, and no picture.

use assert_cmd::{Command, cargo::cargo_bin_cmd};
use geofan_bundle::container::VERSION;
use std::{fs, path::Path};
use tempfile::TempDir;

const MANIFOLD: &str = r#"name = "flat"
coordinates = ["x", "y", "z"]
metric = { conformal = "1" }
[domain]
x = [-20, 20]
inside = ["100 - y^2"]
[[exit]]
name = "sky"
when = "x^2 + y^2 + z^2 - 100"
[cameras]
parameters = { c = [-1, 1] }
at = ["c", "0", "0"]
length = 14.0
"#;

const SCENE: &str = r#"manifold = "m.toml"
[camera]
at = [3.0, 0.0, 0.0]
look = [-1.0, 0.0, 0.0]
up = [0.0, 0.0, 1.0]
fov = 90.0
[[object]]
mesh = "mesh.obj"
at = [0.0, 0.0, 0.0]
[sky]
sky = { image = "sky.png" }
"#;

const MESH: &str = "v 0 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n";

/// A scene with its files, all of them in order, and the command that renders it.
struct Case {
    folder: TempDir,
    arguments: String,
}

impl Case {
    fn new() -> Self {
        let case = Self {
            folder: TempDir::new().unwrap(),
            arguments: String::from("render scene.toml -o out.png --size 32x18"),
        };
        let sky = image::RgbImage::from_fn(16, 8, |x, y| {
            image::Rgb([(16 * x) as u8, (32 * y) as u8, (x * y) as u8])
        });
        sky.save(case.path("sky.png")).unwrap();
        case.with("m.toml", MANIFOLD)
            .with("scene.toml", SCENE)
            .with("mesh.obj", MESH)
    }

    fn path(&self, name: &str) -> std::path::PathBuf {
        self.folder.path().join(name)
    }

    /// With another content of a file.
    fn with(self, name: &str, bytes: impl AsRef<[u8]>) -> Self {
        fs::write(self.path(name), bytes).unwrap();
        self
    }

    fn without(self, name: &str) -> Self {
        fs::remove_file(self.path(name)).unwrap();
        self
    }

    /// With something replaced in a text file, which must have it.
    fn replacing(self, name: &str, from: &str, to: &str) -> Self {
        let text = fs::read_to_string(self.path(name)).unwrap();
        assert!(text.contains(from), "{name} has no {from}");
        self.with(name, text.replacen(from, to, 1))
    }

    fn asked(mut self, from: &str, to: &str) -> Self {
        self.arguments = self.arguments.replace(from, to);
        self
    }

    /// The exit code and what is said on stderr; a picture may be there only after success.
    fn run(&self) -> (i32, String) {
        let before = names(self.folder.path());
        let mut command: Command = cargo_bin_cmd!("geofan");
        command
            .current_dir(self.folder.path())
            .env("NO_COLOR", "1")
            .env("RUST_BACKTRACE", "0");
        let output = command.args(self.arguments.split(' ')).output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        let code = output.status.code().unwrap();
        if code != 0 {
            assert_eq!(before, names(self.folder.path()), "files are left: {said}");
            assert!(output.stdout.is_empty());
        }
        (code, said)
    }

    /// Is refused in words that contain all of `words`.
    #[track_caller]
    fn refused(self, words: &[&str]) {
        let (code, said) = self.run();
        println!("{said}");
        assert!(!said.contains("panicked"), "{said}");
        // Names of types and fields tell those who wrote the decoder.
        assert!(
            !said.contains("ChunkType") && !said.contains("kind: "),
            "{said}"
        );
        assert_eq!(code, 2, "{said}");
        for word in words {
            assert!(said.contains(word), "no `{word}` in:\n{said}");
        }
    }

    /// Is refused with a place in the scene file where a text is replaced.
    #[track_caller]
    fn scene_refused(self, from: &str, to: &str, words: &[&str]) {
        self.replacing("scene.toml", from, to).refused(words);
    }
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = entries
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

#[test]
fn the_scene_itself_is_fine() {
    let case = Case::new();
    let (code, said) = case.run();
    assert_eq!((code, said.as_str()), (0, ""));
    assert!(case.path("out.png").is_file());
}

#[test]
fn a_mesh_that_is_missing_or_a_folder_is_named() {
    let words = ["mesh.obj: no such file", "scene.toml:8:8"];
    Case::new().without("mesh.obj").refused(&words);
    let case = Case::new().without("mesh.obj");
    fs::create_dir(case.path("mesh.obj")).unwrap();
    case.refused(&["mesh.obj", "is a folder"]);
}

#[test]
fn a_broken_mesh_is_refused_at_its_line() {
    let broken = |mesh: &str, words: &[&str]| Case::new().with("mesh.obj", mesh).refused(words);
    broken("v 0 0 0\nv nan 1 0\nv 0 0 1\nf 1 2 3\n", &["mesh.obj:2"]);
    broken("v 0 0 0\nv 0 inf 0\nv 0 0 1\nf 1 2 3\n", &["mesh.obj:2"]);
    broken("v 0 0 0\nv 0 1 0\nv 0 0\nf 1 2 3\n", &["mesh.obj:3"]);
    broken("v 0 0 0\nv 0 1 0\nv 0 0 x\nf 1 2 3\n", &["mesh.obj:3"]);
    broken(&MESH.replace("1 2 3", "1 2 4"), &["mesh.obj:4", "index 4"]);
    broken(&MESH.replace("1 2 3", "1 2 -4"), &["mesh.obj:4"]);
    broken(&MESH.replace("1 2 3", "1 2 0"), &["mesh.obj:4"]);
    broken(&MESH.replace("1 2 3", "1 2 x"), &["mesh.obj:4"]);
    broken(
        &MESH.replace("1 2 3", "1/1 2/1 3/1"),
        &["mesh.obj:4", "texture"],
    );
    broken(&MESH.replace("f 1 2 3", "f"), &["mesh.obj:4"]);
    broken("", &["mesh.obj", "no triangle"]);
    broken("# nothing\n", &["mesh.obj", "no triangle"]);
    broken("v 0 0 0\nv 0 1 0\nv 0 2 0\nf 1 2 3\n", &["no triangle"]);
    Case::new()
        .with("mesh.obj", [0xff, 0x00, 0x9c, 0x0a].repeat(500))
        .refused(&["mesh.obj"]);
}

#[test]
fn a_sky_that_cannot_be_read_is_named() {
    let whole = fs::read(Case::new().path("sky.png")).unwrap();
    let missing = ["sky.png: no such file", "scene.toml:11:1"];
    Case::new().without("sky.png").refused(&missing);
    for length in [0, 1, 7, 8, 20, 33, 50, whole.len() / 2, whole.len() - 13] {
        let cut = &whole[..length];
        Case::new().with("sky.png", cut).refused(&["sky.png"]);
    }
    Case::new()
        .with("sky.png", "not a picture at all")
        .refused(&["sky.png"]);
    let mut damaged = whole.clone();
    damaged[45] ^= 0x40;
    Case::new().with("sky.png", damaged).refused(&["sky.png"]);
    let case = Case::new().without("sky.png");
    fs::create_dir(case.path("sky.png")).unwrap();
    case.refused(&["sky.png", "folder"]);
    for name in ["sky.exr", "sky.hdr", "sky.jpg"] {
        for bytes in [
            &b""[..],
            b"\x76\x2f\x31\x01\x02\x00\x00\x00chan",
            &whole[..30],
        ] {
            Case::new()
                .replacing("scene.toml", "sky.png", name)
                .with(name, bytes)
                .refused(&[name]);
        }
    }
}

#[test]
fn numbers_of_light_points_out_of_range_are_refused() {
    for points in ["0", "999", "2000.5", "nan", "5e6", "'many'"] {
        let points = format!("light_points = {points}\n[camera]");
        Case::new().scene_refused("[camera]", &points, &["scene.toml:", "light_points"]);
    }
}

#[test]
fn a_sky_of_no_exit_is_refused_where_it_stands() {
    Case::new().scene_refused(
        "sky = {",
        "far = {",
        &["scene.toml:11:1", "no exit `far`", "sky, limit, inside"],
    );
    let both = "sky = { pattern = \"grid\", ";
    Case::new().scene_refused("sky = {", both, &["scene.toml:11:7", "exactly one"]);
    let strange = "sky = { pattern = \"gird\" }";
    Case::new().scene_refused(
        "sky = { image = \"sky.png\" }",
        strange,
        &["scene.toml:11:", "did you mean `grid`?"],
    );
}

#[test]
fn a_camera_that_cannot_be_is_refused_where_it_stands() {
    let at = "at = [3.0, 0.0, 0.0]";
    let outside = ["scene.toml:3:6", "outside"];
    Case::new().scene_refused(at, "at = [21.0, 0.0, 0.0]", &outside);
    Case::new().scene_refused(at, "at = [0.0, 11.0, 0.0]", &outside);
    let unknown = ["scene.toml:3:", "`d` is not a camera parameter", "c"];
    Case::new().scene_refused(at, "parameters = { d = 0.5 }", &unknown);
    let missing = ["scene.toml:3:", "`c` is missing"];
    Case::new().scene_refused(at, "parameters = {}", &missing);
    let far = ["scene.toml:3:", "outside"];
    Case::new().scene_refused(at, "parameters = { c = 1.5 }", &far);
    let none = ["scene.toml:2:", "neither `at` nor `parameters`"];
    Case::new().scene_refused(at, "", &none);
    let twice = ["scene.toml:4:", "both `at` and `parameters`"];
    let both = format!("{at}\nparameters = {{ c = 0.0 }}");
    Case::new().scene_refused(at, &both, &twice);
    Case::new().scene_refused(
        "look = [-1.0, 0.0, 0.0]",
        "look = [0, 0, 0]",
        &["scene.toml:4:8", "zero vector"],
    );
    Case::new().scene_refused(
        "up = [0.0, 0.0, 1.0]",
        "up = [2.0, 0.0, 0.0]",
        &["scene.toml:5:6", "parallel"],
    );
    for fov in ["0", "180", "-3", "nan", "1e999"] {
        let fov = format!("fov = {fov}");
        Case::new().scene_refused("fov = 90.0", &fov, &["scene.toml:6:7"]);
    }
}

#[test]
fn a_camera_where_the_metric_breaks_down_is_refused() {
    let metric = r#"{ conformal = "1/sqrt(x^2 + y^2 + z^2)" }"#;
    let case = Case::new()
        .replacing("m.toml", r#"{ conformal = "1" }"#, metric)
        .replacing("m.toml", r#"["c", "0", "0"]"#, r#"["c", "1", "0"]"#);
    let zero = "at = [0.0, 0.0, 0.0]\nlook";
    case.replacing(
        "scene.toml",
        "at = [0.0, 0.0, 0.0]\n[sky]",
        "at = [1.0, 0.0, 0.0]\n[sky]",
    )
    .replacing("scene.toml", "at = [3.0, 0.0, 0.0]\nlook", zero)
    .refused(&["scene.toml:3:6"]);
}

#[test]
fn unknown_keys_and_wrong_types_are_underlined() {
    let misspelt = ["scene.toml:6:1", "unknown key `fow`", "did you mean `fov`?"];
    Case::new().scene_refused("fov", "fow", &misspelt);
    let key = ["scene.toml:7:3", "unknown key `objekt`", "`object`"];
    Case::new().scene_refused("object", "objekt", &key);
    let key = ["scene.toml:9:1", "unknown key `pos`"];
    let mesh = "mesh = \"mesh.obj\"\n";
    Case::new().scene_refused(&format!("{mesh}at"), &format!("{mesh}pos"), &key);
    let wrong = |from: &str, to: &str, place: &str| {
        let case = Case::new();
        case.scene_refused(from, to, &[&format!("scene.toml:{place}")]);
    };
    wrong("manifold = \"m.toml\"", "manifold = 3", "1:12");
    wrong("manifold = \"m.toml\"", "manifold = \"\"", "1:12");
    wrong("manifold = \"m.toml\"", "", "1:1");
    wrong("at = [3.0, 0.0, 0.0]", "at = 3", "3:6");
    wrong("at = [3.0, 0.0, 0.0]", "at = [3, 0]", "3:6");
    wrong("at = [3.0, 0.0, 0.0]", "at = [3, \"0\", 0]", "3:10");
    wrong("at = [3.0, 0.0, 0.0]", "at = [3, inf, 0]", "3:10");
    wrong("fov = 90.0", "fov = \"90\"", "6:7");
    wrong("fov = 90.0", "fov = ", "6:");
    wrong("fov = 90.0", "fov = 90\nfov = 80", "7:1");
    wrong("mesh = \"mesh.obj\"", "mesh = [\"mesh.obj\"]", "8:8");
    wrong(
        "mesh = \"mesh.obj\"",
        "mesh = \"mesh.obj\"\nscale = 0",
        "9:9",
    );
    let turn = "mesh = \"mesh.obj\"\nrotate = 30";
    wrong("mesh = \"mesh.obj\"", turn, "9:10");
    let placed = "mesh = \"mesh.obj\"\nplacement = \"liner\"";
    wrong("mesh = \"mesh.obj\"", placed, "9:13");
    wrong("[[object]]", "[object]", "7:");
    wrong("[camera]", "[[camera]]", "2:");
    wrong("sky = { image = \"sky.png\" }", "sky = \"sky.png\"", "11:7");
    wrong("image = \"sky.png\"", "image = 3", "11:");
    wrong("image = \"sky.png\"", "color = [0, -1, 0]", "11:");
    let outside = "mesh = \"mesh.obj\"\nat = [21.0, 0, 0]";
    wrong("mesh = \"mesh.obj\"\nat = [0.0, 0.0, 0.0]", outside, "9:6");
}

#[test]
fn a_manifold_that_cannot_work_is_shown_through_its_scene() {
    let missing = ["m.toml: no such file", "scene.toml:1:12"];
    Case::new().without("m.toml").refused(&missing);
    let broken = |from: &str, to: &str, words: &[&str]| {
        Case::new().replacing("m.toml", from, to).refused(words);
    };
    let name = ["m.toml:3:29", "unknown function `sine`"];
    broken("\"1\"", "\"2 + sine(x)\"", &name);
    broken("\"1\"", "\"1 + (x\"", &["m.toml:3:", "bracket"]);
    broken("\"1\"", "\"0\"", &["m.toml:3:", "not positive definite"]);
    broken("\"1\"", "1", &["m.toml:3:"]);
    broken("coordinates", "coordinate", &["m.toml:2:1"]);
    broken("\"c\", \"0\"", "\"c\", \"50\"", &["m.toml:12:"]);
    let case = Case::new().without("m.toml");
    fs::create_dir(case.path("m.toml")).unwrap();
    case.refused(&["m.toml", "is a folder"]);
    Case::new()
        .with("m.toml", [b'n', 0xff, 0xfe, b'\n'])
        .refused(&["m.toml", "UTF-8"]);
}

#[test]
fn a_scene_that_is_no_text_is_named() {
    let named = |bytes: &[u8], words: &[&str]| {
        Case::new().with("scene.toml", bytes).refused(words);
    };
    named(&[0xff, 0xfe, b'm', 0], &["scene.toml", "UTF-8"]);
    named(b"", &["scene.toml:1:1", "manifold"]);
    named(b"\x00\x01\x02", &["NUL bytes"]);
    named(b"manifold = \"m.toml", &["scene.toml:1:"]);
    named(
        "manifold = \"m.toml\"\n[camera\u{e4}]".as_bytes(),
        &["scene.toml:2:"],
    );
    let missing = Case::new().without("scene.toml");
    missing.refused(&["scene.toml: no such file"]);
    let folder = Case::new().asked("scene.toml", ".");
    folder.refused(&["is a folder"]);
}

#[test]
fn an_output_that_cannot_be_written_is_refused() {
    let output = |name: &str, words: &[&str]| Case::new().asked("out.png", name).refused(words);
    output("gone/out.png", &["gone/out.png", "folder does not exist"]);
    output("out.gif", &["out.gif", ".png or .exr"]);
    output("out", &["out", ".png or .exr"]);
    output("m.toml", &["m.toml", ".png or .exr"]);
    output("mesh.obj/out.png", &["mesh.obj/out.png", "folder"]);
    let case = Case::new().asked("out.png", "folder.png");
    fs::create_dir(case.path("folder.png")).unwrap();
    case.refused(&["folder.png", "is a folder"]);
}

#[test]
fn a_bundle_that_is_none_is_named() {
    let table = "32x18 --tracer table";
    let without = Case::new().asked("32x18", table);
    without.refused(&["--tracer", "--bundle"]);
    let asked = || Case::new().asked("32x18", "32x18 --bundle b.fan");
    asked().refused(&["b.fan: no such file"]);
    let named = |bytes: &[u8], word: &str| asked().with("b.fan", bytes).refused(&["b.fan", word]);
    let magic = b"GEOFAN\r\n\x1a\n";
    let start = [&magic[..], &VERSION.to_le_bytes()].concat();
    named(b"", "is not a bundle");
    named(b"GEO", "truncated");
    named(magic, "truncated");
    named(&start, "truncated");
    named(&[&start[..], &[0x5a; 400]].concat(), "b.fan");
    named(&[&start[..], &[0; 400]].concat(), "b.fan");
    named(&[&start[..], &[0xff; 400]].concat(), "b.fan");
    named(
        &[&magic[..], &(VERSION + 1).to_le_bytes()].concat(),
        "newer",
    );
    named(b"GEOFAN\n\x1a\n\x01\x00\x00\x00", "b.fan");
    named(&[0x5a; 4096], "is not a bundle");
    named(SCENE.as_bytes(), "is not a bundle");
    let png = fs::read(Case::new().path("sky.png")).unwrap();
    named(&png, "is not a bundle");
    Case::new()
        .asked("32x18", "32x18 --bundle .")
        .refused(&["is a folder"]);
}

#[test]
fn requests_that_make_no_sense_are_refused() {
    let asked = |what: &str, words: &[&str]| Case::new().asked("32x18", what).refused(words);
    asked("0x18", &["--size"]);
    asked("32", &["--size"]);
    asked("999999999x999999999", &["--size"]);
    asked("32x18 --spp 0", &["--spp"]);
    asked("32x18 --set q=1", &["--set", "no parameter `q`"]);
    asked("32x18 --view far", &["--view", "far"]);
    asked("32x18 --length -1", &["--length"]);
    asked("32x18 --tracer fast", &["--tracer"]);
}
