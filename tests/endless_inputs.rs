//! Files without end, in place of every kind of file that is read: refused in a moment, within limits of memory.
#![cfg(target_os = "linux")]

mod support;

use std::{
    fs,
    io::Write,
    process::{Command, Stdio},
    time::{Duration, Instant},
};
use support::Place;

const FLAT: &str = "name = 'flat'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1' }\n\
                    [[exit]]\nname = 'sky'\nwhen = 'x^2 + y^2 + z^2 - 9'\n[cameras]\nat = ['0', '0', '0']\nlength = 8\n";

/// Kilobytes of address space: less than what a file over the limit would take.
const MEMORY: usize = 3 << 20;

/// Runs the program in `place` within the limit of memory: its exit code and what was said.
fn geofan(place: &Place, arguments: &str) -> (Option<i32>, String) {
    let program = env!("CARGO_BIN_EXE_geofan");
    let began = Instant::now();
    let output = Command::new("sh")
        .current_dir(place.path(""))
        .env("NO_COLOR", "1")
        .args([
            "-c",
            &format!("ulimit -v {MEMORY}; exec {program} --threads 2 {arguments}"),
        ])
        .output()
        .unwrap();
    assert!(began.elapsed() < Duration::from_secs(30), "{arguments}");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    (output.status.code(), said)
}

/// The kinds of files, each with the command that reads `@` as one.
const KINDS: [(&str, &str); 13] = [
    ("bundle", "info @"),
    (
        "bundle to render",
        "render scene.toml --size 8x8 -o a.png --bundle @",
    ),
    ("bundle to check", "check @"),
    ("manifold", "trace @ --at 0,0,0 --dir 1,0,0"),
    ("scene", "render @ --size 8x8 -o a.png"),
    (
        "camera path",
        "render scene.toml --size 8x8 -o f-%d.png --frames 2 --camera-path @",
    ),
    ("mesh", "render mesh.toml --size 8x8 -o a.png"),
    ("materials", "render materials.toml --size 8x8 -o a.png"),
    ("texture", "render texture.toml --size 8x8 -o a.png"),
    ("PLY mesh", "render ply.toml --size 8x8 -o a.png"),
    ("glTF mesh", "render gltf.toml --size 8x8 -o a.png"),
    ("binary glTF mesh", "render glb.toml --size 8x8 -o a.png"),
    ("sky", "render sky.toml --size 8x8 -o a.png"),
];

/// Scenes that name `endless` under every ending.
fn place() -> Place {
    let scene =
        "manifold = 'flat.toml'\n[camera]\nat = [0, 0, 0]\nlook = [1, 0, 0]\nup = [0, 0, 1]\n";
    let object =
        |mesh: &str| format!("{scene}[[object]]\nmesh = '{mesh}'\nat = [1, 0, 0]\nscale = 0.1\n");
    Place::with(&[
        ("flat.toml", FLAT),
        ("scene.toml", scene),
        ("mesh.toml", &object("endless.obj")),
        ("ply.toml", &object("endless.ply")),
        ("gltf.toml", &object("endless.gltf")),
        ("glb.toml", &object("endless.glb")),
        ("texture.toml", &object("painted.obj")),
        (
            "painted.obj",
            "mtllib painted.mtl\nv 0 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nusemtl a\nf 1/1 2/1 3/1\n",
        ),
        ("painted.mtl", "newmtl a\nmap_Kd endless.png\n"),
        ("materials.toml", &object("lit.obj")),
        (
            "lit.obj",
            "mtllib endless.mtl\nv 0 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n",
        ),
        (
            "sky.toml",
            &format!("{scene}[sky]\nsky = {{ image = 'endless.png' }}\n"),
        ),
    ])
}

/// The name under which a command of [`KINDS`] reads the file.
fn name(arguments: &str) -> &'static str {
    match arguments {
        a if a.contains("mesh.toml") => "endless.obj",
        a if a.contains("materials.toml") => "endless.mtl",
        a if a.contains("sky.toml") || a.contains("texture.toml") => "endless.png",
        a if a.contains("ply.toml") => "endless.ply",
        a if a.contains("gltf.toml") => "endless.gltf",
        a if a.contains("glb.toml") => "endless.glb",
        _ => "endless.toml",
    }
}

/// Materials and textures that cannot be read are left out with a warning.
fn expected_code(kind: &str) -> i32 {
    match kind {
        "materials" | "texture" => 0,
        _ => 2,
    }
}

/// Reads the file in every place; `make` makes it under a name.
fn refused_everywhere(make: impl Fn(&std::path::Path)) {
    for (kind, arguments) in KINDS {
        let place = place();
        make(&place.path(name(arguments)));
        let (code, said) = geofan(&place, &arguments.replace('@', "endless.toml"));
        assert!(!said.contains("panicked"), "{kind}: {said}");
        assert!(said.contains("endless"), "{kind}: {said}");
        let expected = expected_code(kind);
        assert_eq!(code, Some(expected), "{kind}: {said}");
    }
}

#[test]
fn a_device_without_end_is_refused_as_every_kind_of_file() {
    refused_everywhere(|path| std::os::unix::fs::symlink("/dev/zero", path).unwrap());
}

#[test]
fn a_file_over_the_limit_is_refused_as_every_kind_of_file() {
    // Holes take no room on the disk.
    refused_everywhere(|path| fs::File::create(path).unwrap().set_len(1 << 40).unwrap());
}

#[test]
fn a_pipe_that_never_ends_is_refused_as_every_kind_of_file() {
    for (kind, arguments) in KINDS {
        let place = place();
        let path = place.path(name(arguments));
        let made = Command::new("mkfifo").arg(&path).status();
        if made.is_err() {
            return;
        }
        // A comment that goes on and on, until nobody reads any more; `info` reads twice.
        let mut writer = Command::new("sh")
            .args(["-c", "while :; do yes '# and so on' > \"$0\"; done"])
            .arg(&path)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let (code, said) = geofan(&place, &arguments.replace('@', "endless.toml"));
        writer.kill().unwrap();
        writer.wait().unwrap();
        // Let go of whoever still waits for a reader.
        drop(fs::OpenOptions::new().read(true).write(true).open(&path));
        let expected = expected_code(kind);
        assert_eq!(code, Some(expected), "{kind}: {said}");
        assert!(said.contains("endless"), "{kind}: {said}");
    }
}

#[test]
fn a_picture_that_begins_well_and_never_ends_is_refused() {
    let place = place();
    let mut file = fs::File::create(place.path("endless.png")).unwrap();
    file.write_all(b"\x89PNG\r\n\x1a\n").unwrap();
    file.set_len(1 << 40).unwrap();
    let (code, said) = geofan(&place, "render sky.toml --size 8x8 -o a.png");
    assert!(
        code == Some(2) && said.contains("is longer than 4294967296 bytes"),
        "{said}"
    );
}
