//! What a full disk, a broken one, a killed process and lost power leave behind: the old file or the new one, and
//! nothing that keeps the same command from ending well afterwards.
//!
//! The program is run with `tests/faults/shim.rs` in front of the C library, which does this at one event: an
//! opening for writing, a write, a sync, a rename. An ordinary run takes a few events of each command;
//! `GEOFAN_FAULTS=all cargo test --release --workspace --test file_faults -- --nocapture` takes all.

#![cfg(all(target_os = "linux", target_env = "gnu"))]

use assert_cmd::cargo::cargo_bin;
use std::{
    collections::BTreeMap,
    fs,
    os::unix::process::ExitStatusExt,
    path::{Path, PathBuf},
    process::{Command, ExitStatus, Output},
    sync::OnceLock,
};
use tempfile::TempDir;

const SPACE: &str = r#"name = "space"
coordinates = ["x", "y", "z"]
metric = { conformal = "exp(0.1*exp(-(x^2 + y^2 + z^2)/2))" }
[[exit]]
name = "sky"
when = "x^2 + y^2 + z^2 - 30"
[symmetry]
rotation = "origin"
[cameras]
parameters = { c = [1, 2] }
at = ["c", "0", "0"]
length = 9.0
"#;

const SCENE: &str = r#"manifold = "space.toml"
[camera]
at = [1.5, 0, 0]
look = [-1, 0, 0]
up = [0, 0, 1]
[[object]]
mesh = "square.obj"
at = [0, 0, 0]
scale = 0.5
[[light]]
kind = "point"
at = [1.0, 0.3, 0.4]
intensity = [1, 1, 1]
[sky]
sky = { pattern = "grid" }
"#;

const POSES: &str = "[[pose]]\ntime = 0\nat = [1.5, 0, 0]\nlook = [-1, 0, 0]\nup = [0, 0, 1]\n\
                     [[pose]]\ntime = 1\nat = [1.2, 0, 0]\nlook = [-1, 0, 0]\nup = [0, 0, 1]\n";

/// A command, and what it leaves.
struct Case {
    name: &'static str,
    /// Commands that make its inputs.
    before: &'static [&'static str],
    arguments: &'static str,
    /// What is added when the command is given again after a fault.
    again: &'static str,
    outputs: &'static [&'static str],
    /// Whether its outputs are the same bytes in every run; times of work are not.
    steady: bool,
    /// Whether it replaces outputs that are there; others are left alone or refused.
    replaces: bool,
}

const CASES: [Case; 6] = [
    Case {
        name: "bake",
        before: &[],
        arguments: "bake space.toml -o b.fan --max-error 3 --certify-rays 100",
        again: " --resume",
        outputs: &["b.fan"],
        steady: true,
        replaces: true,
    },
    Case {
        name: "merge",
        before: &[
            "bake space.toml -o 1.fan --max-error 3 --certify-rays 100 --shard 1/2",
            "bake space.toml -o 2.fan --max-error 3 --certify-rays 100 --shard 2/2",
        ],
        arguments: "merge 1.fan 2.fan -o b.fan",
        again: "",
        outputs: &["b.fan"],
        steady: true,
        replaces: true,
    },
    Case {
        name: "sweep",
        before: &[],
        arguments: "sweep space.toml --quick --out out --max-error 3 --cells 8 --rays 320",
        again: "",
        outputs: &["out/sweep.csv"],
        steady: false,
        replaces: false,
    },
    Case {
        name: "animation",
        before: &[],
        arguments: "render scene.toml --size 12x8 --camera-path way.toml --frames 3 -o f-%02d.png",
        again: "",
        outputs: &["f-00.png", "f-01.png", "f-02.png"],
        steady: true,
        replaces: false,
    },
    Case {
        name: "path tracing",
        before: &[],
        arguments: "render scene.toml --tracer path --size 12x8 --spp 4 -o p.png --resume",
        again: "",
        outputs: &["p.png"],
        steady: true,
        replaces: false,
    },
    Case {
        name: "page",
        before: &[],
        arguments: "view scene.toml --page out.html --wasm any.wasm",
        again: "",
        outputs: &["out.html"],
        steady: true,
        replaces: true,
    },
];

/// Compiles the layer once.
fn shim() -> &'static Path {
    static SHIM: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    let compile = || {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("shim.so");
        let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/faults/shim.rs");
        let rustc = std::env::var("RUSTC").unwrap_or_else(|_| "rustc".into());
        let compiled = Command::new(rustc)
            .args([
                "--edition",
                "2024",
                "--crate-type",
                "cdylib",
                "-O",
                source,
                "-o",
            ])
            .arg(&path)
            .status();
        assert!(compiled.unwrap().success());
        (folder, path)
    };
    &SHIM.get_or_init(compile).1
}

/// Makes a folder with all inputs of `case`, and old files where it has `old` outputs.
fn folder(case: &Case, old: bool) -> TempDir {
    let folder = TempDir::new().unwrap();
    let write = |name: &str, text: &[u8]| fs::write(folder.path().join(name), text).unwrap();
    write("space.toml", SPACE.as_bytes());
    write("scene.toml", SCENE.as_bytes());
    write("way.toml", POSES.as_bytes());
    write(
        "square.obj",
        b"v 0 -1 -1\nv 0 1 -1\nv 0 1 1\nv 0 -1 1\nf 1 2 3 4\n",
    );
    write("any.wasm", b"\0asm\x01\0\0\0");
    for before in case.before {
        let made = run(folder.path(), before, None);
        assert!(matches!(made.status.code(), Some(0 | 1)), "{made:?}");
    }
    if old && case.replaces {
        case.outputs.iter().for_each(|name| write(name, b"old"));
    }
    folder
}

/// Runs the program in `folder`, with a fault.
fn run(folder: &Path, arguments: &str, fault: Option<&str>) -> Output {
    let mut command = Command::new(cargo_bin!("geofan"));
    command
        .current_dir(folder)
        .args(["--quiet", "--threads", "1"])
        .args(arguments.split(' '));
    if let Some(fault) = fault {
        command
            .env("LD_PRELOAD", shim())
            .env("GEOFAN_FAULT_FOLDER", folder.canonicalize().unwrap())
            .env("GEOFAN_FAULT", fault)
            .env("GEOFAN_FAULT_COUNT", folder.with_extension("count"));
    }
    command.output().unwrap()
}

/// Reads the outputs that are there.
fn outputs(case: &Case, folder: &Path) -> BTreeMap<&'static str, Vec<u8>> {
    let read = |name: &&'static str| Some((*name, fs::read(folder.join(name)).ok()?));
    case.outputs.iter().filter_map(read).collect()
}

/// Lists all files below `folder`.
fn names(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(&next).unwrap() {
            let path = entry.unwrap().path();
            match path.is_dir() {
                true => folders.push(path),
                false => found.push(path.strip_prefix(folder).unwrap().to_path_buf()),
            }
        }
    }
    found.sort();
    found
}

/// Tells whether a run ended as one that does its work.
fn done(status: ExitStatus) -> bool {
    // 1: the table is there, and its few rays miss the promise.
    matches!(status.code(), Some(0 | 1))
}

/// Runs `case` with faults at some of its events, or at all.
fn survives(case: &Case) {
    // What it does where nothing fails.
    let calm = folder(case, false);
    let reference = run(calm.path(), case.arguments, Some("count"));
    assert!(done(reference.status), "{}: {reference:?}", case.name);
    let count = fs::read_to_string(calm.path().with_extension("count")).unwrap();
    let events: u64 = count.parse().unwrap();
    assert!(events >= 3, "{}: {events} events", case.name);
    let wanted = outputs(case, calm.path());
    let files = names(calm.path());
    assert_eq!(wanted.len(), case.outputs.len());
    // The same with a fault, over old files and without.
    let all = std::env::var("GEOFAN_FAULTS").is_ok_and(|which| which == "all");
    let some = if case.steady { 3 } else { 1 };
    let step = if all { 1 } else { events.div_ceil(some) };
    for (k, action) in ["full", "failing", "short", "killed", "power"]
        .into_iter()
        .enumerate()
    {
        for number in (1..=events).rev().step_by(step as usize) {
            let old = (number + k as u64).is_multiple_of(2);
            fails_well(case, &format!("{number}:{action}"), old, (&wanted, &files));
        }
    }
    println!("{}: {events} events", case.name);
}

/// Runs `case` with one fault, and again without.
fn fails_well(
    case: &Case,
    fault: &str,
    old: bool,
    (wanted, files): (&BTreeMap<&str, Vec<u8>>, &[PathBuf]),
) {
    let about = format!("{} {fault}", case.name);
    let folder = folder(case, old);
    let found = run(folder.path(), case.arguments, Some(fault));
    let said = String::from_utf8_lossy(&found.stderr);
    let killed = found.status.signal() == Some(9);
    assert!(
        killed || done(found.status) || found.status.code() == Some(3),
        "{about}: {found:?}"
    );
    assert!(
        killed || done(found.status) || said.contains("error"),
        "{about}: {said}"
    );
    for (name, bytes) in outputs(case, folder.path()) {
        let new = !case.steady || bytes == wanted[name];
        let kept = old && case.replaces && bytes == b"old";
        assert!(new || kept, "{about}: {name} has {} bytes", bytes.len());
        assert!(!done(found.status) || !kept, "{about}: {name} is old");
    }
    // The same command again.
    let again = run(
        folder.path(),
        &format!("{}{}", case.arguments, case.again),
        None,
    );
    assert!(done(again.status), "{about}, then {again:?}");
    let ended = outputs(case, folder.path());
    assert!(!case.steady || ended == *wanted, "{about}: another result");
    assert_eq!(names(folder.path()), files, "{about}");
}

macro_rules! cases {
    ($($test:ident: $number:literal;)*) => { $(
        #[test]
        fn $test() {
            survives(&CASES[$number]);
        }
    )* };
}

cases! {
    a_bake_leaves_old_or_new_and_can_be_resumed: 0;
    a_merge_leaves_old_or_new: 1;
    a_sweep_goes_on_after_every_fault: 2;
    an_animation_goes_on_after_every_fault: 3;
    a_path_traced_picture_goes_on_after_every_fault: 4;
    a_page_is_old_or_new: 5;
}
