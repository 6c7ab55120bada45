//! What a full disk, a broken one, a killed process, lost power, files that cannot be read and memory that is not there
//! leave behind: the old file or the new one, and nothing that keeps the same command from ending well afterwards.
//!
//! The program is run with `tests/faults/shim.rs` in front of the C library, which does this at one event: an
//! opening, a read, a write, a sync, a rename, a large allocation. An ordinary run takes a few events of each command;
//! `GEOFAN_FAULTS=all cargo test --release --workspace --test file_faults -- --nocapture` takes all of files (of the
//! sweep, which takes seconds, each by one action), and [`ALLOCATIONS`] of those of memory.

#![cfg(all(target_os = "linux", target_env = "gnu"))]

#[macro_use]
#[path = "faults/commands.rs"]
mod commands;

use commands::{CASES, Case, Inputs, Wanted, done, geofan};
use std::{
    fs,
    os::unix::process::ExitStatusExt,
    path::{Path, PathBuf},
    process::{Command, Output},
    sync::OnceLock,
};
use tempfile::TempDir;

/// What happens at an event, and which of the three counted kinds of events it is done to.
const ACTIONS: [(&str, usize); 8] = [
    ("full", 0),
    ("failing", 0),
    ("short", 0),
    ("killed", 0),
    ("power", 0),
    ("undone", 0),
    ("unreadable", 1),
    ("memory", 2),
];

const KINDS: [&str; 3] = ["writes, syncs and renames", "reads", "allocations"];

/// Failing allocations tried of each command, evenly over its run, where all events are asked for.
const ALLOCATIONS: u64 = 60;

/// The crate that panics where memory for the tree of a mesh is not there.
const UNWRAPS_MEMORY: &str = "bytemuck";

const SIGABRT: i32 = 6;
const SIGKILL: i32 = 9;

/// Compiles the layer once.
fn shim() -> &'static Path {
    static SHIM: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    let compile = || {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("shim.so");
        let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/faults/shim.rs");
        let rustc = std::env::var("RUSTC").unwrap_or_else(|_| "rustc".into());
        let compiled = Command::new(rustc)
            .args(["--edition", "2024", "--crate-type", "cdylib", "-O"])
            .args([source, "-o"])
            .arg(&path)
            .status();
        assert!(compiled.unwrap().success());
        (folder, path)
    };
    &SHIM.get_or_init(compile).1
}

/// Runs the program in `folder`, with a fault.
fn run(folder: &Path, arguments: &str, fault: &str) -> Output {
    let folder = folder.canonicalize().unwrap();
    let ran = geofan(&folder, arguments)
        .env("LD_PRELOAD", shim())
        .env("GEOFAN_FAULT_FOLDER", &folder)
        .env("GEOFAN_FAULT", fault)
        .env("GEOFAN_FAULT_COUNT", folder.with_extension("count"))
        .output();
    ran.unwrap()
}

/// Removes what the layer keeps beside `folder`.
fn sweep(folder: &Path) {
    let name = folder.file_name().unwrap().to_string_lossy().into_owned();
    for entry in fs::read_dir(folder.parent().unwrap()).unwrap().flatten() {
        let other = entry.file_name().to_string_lossy().into_owned();
        if other != name && other.starts_with(&name) {
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// Runs `case` with faults at some of its events, or at all.
fn survives(case: &Case) {
    // What it does where nothing fails.
    let inputs = Inputs::of(case);
    let calm = inputs.copy(case, false);
    let reference = run(calm.path(), case.arguments, "count");
    assert!(done(reference.status), "{}: {reference:?}", case.name);
    let count = fs::read_to_string(calm.path().with_extension("count")).unwrap();
    let events: Vec<u64> = count.split(' ').map(|n| n.parse().unwrap()).collect();
    sweep(calm.path());
    let enough = events.iter().all(|n| *n >= 3);
    assert!(enough, "{}: {events:?} events", case.name);
    let wanted = Wanted::of(case, calm.path());
    // The same with a fault, over old files and without.
    let mut faults = 0;
    for (k, (action, kind)) in ACTIONS.into_iter().enumerate() {
        let (first, step) = step(case, (k, kind), events[kind]);
        for number in (1..=events[kind]).rev().skip(first).step_by(step) {
            let old = (number + k as u64).is_multiple_of(2);
            fails_well(case, &inputs, (action, number, old), &wanted);
            faults += 1;
        }
    }
    let told: Vec<String> = events
        .iter()
        .zip(KINDS)
        .map(|(n, kind)| format!("{n} {kind}"))
        .collect();
    println!("{}: {}; {faults} faults", case.name, told.join(", "));
}

/// Every how-manieth of so many events of a kind is taken by an action, and from which one on, counted from the last. Where
/// all are asked for, a slow case has each of its writes once, by one action or another, and every other read.
fn step(case: &Case, (action, kind): (usize, usize), events: u64) -> (usize, usize) {
    let all = std::env::var("GEOFAN_FAULTS").is_ok_and(|which| which == "all");
    let actions = ACTIONS.iter().filter(|(_, of)| *of == 0).count();
    let some = match (all, kind) {
        (true, 0) if case.slow => return (action, actions),
        (true, 1) if case.slow => return (0, 2),
        (true, 2) if case.slow => ALLOCATIONS / 2,
        (true, 2) => ALLOCATIONS,
        (true, _) => events,
        (false, _) if case.slow => 1,
        (false, _) => 2,
    };
    (0, events.div_ceil(some) as usize)
}

/// Runs `case` with one fault, and again without.
fn fails_well(
    case: &Case,
    inputs: &Inputs,
    (action, number, old): (&str, u64, bool),
    wanted: &Wanted,
) {
    let about = format!("{} {number}:{action}", case.name);
    let folder = inputs.copy(case, old);
    let found = run(folder.path(), case.arguments, &format!("{number}:{action}"));
    let said = String::from_utf8_lossy(&found.stderr);
    // Rust ends a process whose allocation fails, or who asked for the memory panics.
    let unwraps = said.contains("panicked") && said.contains(UNWRAPS_MEMORY);
    let gone = match action {
        "memory" => unwraps || found.status.signal() == Some(SIGABRT),
        _ => found.status.signal() == Some(SIGKILL),
    };
    let done = done(found.status);
    assert!(
        gone || done || found.status.code() == Some(3),
        "{about}: {found:?}"
    );
    assert!(gone || done || said.contains("error"), "{about}: {said}");
    assert!(gone || !said.contains("panicked"), "{about}: {said}");
    wanted.check_left(case, folder.path(), (old, done), &about);
    wanted.check_again(case, folder.path(), &about);
    sweep(folder.path());
}

cases! {
    a_bake_leaves_old_or_new_and_can_be_resumed: 0;
    a_merge_leaves_old_or_new: 1;
    a_sweep_goes_on_after_every_fault: 2;
    an_animation_goes_on_after_every_fault: 3;
    a_path_traced_picture_goes_on_after_every_fault: 4;
    a_page_is_old_or_new: 5;
    a_cache_of_light_is_old_or_new: 6;
}
