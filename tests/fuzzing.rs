//! Every reader on mutations of valid files: no panic, whatever the bytes. The seeds are the files of
//! `assets`, of `tests/golden`, `tests/data` and `tests/corpus`; mutations are the same in every run.
//!
//! `GEOFAN_FUZZ_RUNS=1000000 cargo test --release --workspace --test fuzzing -- --nocapture` runs longer, and
//! `GEOFAN_FUZZ_KEY=2` others; `docs/trust.sh mutations` does both in parts. `GEOFAN_FUZZ_ONE=16759` reads the input of
//! that number alone and says where it is written. With coverage: `cargo +nightly fuzz run bundle`, in this folder.

#[path = "../fuzz/targets.rs"]
mod targets;

use geofan::random::Stream;
use rayon::prelude::*;
use std::{
    fs,
    ops::Range,
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
    time::{Duration, Instant},
};
use targets::{TARGETS, Target, change};

/// Mutations of each target in an ordinary run: a few seconds each.
const RUNS: [(&str, u64); 10] = [
    ("bundle", 2000),
    ("resealed", 1500),
    ("hostile", 1500),
    ("manifold", 1500),
    ("scene", 3000),
    ("mesh", 3000),
    ("material", 2000),
    ("picture", 3000),
    ("camera_path", 3000),
    ("message", 20_000),
];

/// Lists the files below `folder` with one of these extensions, and no more than a reader of mutations wants.
fn files(folder: &str, extensions: &[&str]) -> Vec<Vec<u8>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let mut folders = vec![root];
    let mut found: Vec<PathBuf> = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).into_iter().flatten().flatten() {
            let path = entry.path();
            let extension = path.extension().unwrap_or_default().to_string_lossy();
            if path.is_dir() {
                folders.push(path);
            } else if extensions.contains(&&*extension) {
                found.push(path);
            }
        }
    }
    found.sort();
    let read = found.iter().filter_map(|path| fs::read(path).ok());
    read.filter(|bytes| bytes.len() <= 100_000).collect()
}

/// Returns valid inputs of a target.
fn seeds(name: &str) -> Vec<Vec<u8>> {
    let mut seeds = match name {
        "bundle" | "resealed" | "hostile" => files("tests/golden", &["fan"]),
        "manifold" => files("assets/manifolds", &["toml"]),
        "scene" | "camera_path" => files("assets/scenes", &["toml"]),
        "mesh" => files("tests/data", &["obj"]),
        "material" => files("tests/data", &["mtl"]),
        "picture" => files("tests/data/pictures", &["png", "jpg", "hdr", "exr"]),
        _ => Vec::new(),
    };
    let own = match name {
        "resealed" | "hostile" => "bundle",
        other => other,
    };
    seeds.extend(files(
        &format!("tests/corpus/{own}"),
        &["fan", "toml", "obj", "mtl", "json", "bin"],
    ));
    seeds
}

/// Seeds of more bytes are taken once in so many times by the targets that change what is below the checksums, because
/// their tables take a hundred times as long to decode and have the same parts as small ones, only more of them.
const LARGE: usize = 8000;
const SELDOM: u64 = 128;

/// Draws the seed of an input.
fn seed<'s>(name: &str, seeds: &'s [Vec<u8>], stream: &mut Stream) -> &'s [u8] {
    let below = ["resealed", "hostile"].contains(&name);
    let large = below && stream.bits().is_multiple_of(SELDOM);
    let fit = |seed: &&Vec<u8>| !below || (seed.len() > LARGE) == large;
    let fitting = seeds.iter().filter(fit);
    let place = stream.bits() % fitting.clone().count() as u64;
    fitting.clone().nth(place as usize).unwrap()
}

/// Makes the input with this number.
fn input(name: &str, seeds: &[Vec<u8>], number: u64) -> Vec<u8> {
    let mut stream = Stream::new(&[key(), name.len() as u64, number]);
    let mut bytes = seed(name, seeds, &mut stream).to_vec();
    match name {
        // These change what is below the checksums themselves.
        "resealed" => drop(bytes.splice(0..0, (0..9).map(|_| stream.bits() as u8))),
        "hostile" => drop(bytes.splice(0..0, (0..8).map(|_| stream.bits() as u8))),
        _ => (0..=stream.bits() % 8).for_each(|_| change(&mut bytes, &mut stream)),
    }
    bytes
}

/// Returns the key of this run's mutations.
fn key() -> u64 {
    let given = std::env::var("GEOFAN_FUZZ_KEY").ok();
    given.and_then(|key| key.parse().ok()).unwrap_or(1)
}

/// Returns the numbers of the mutations that a target gets.
fn numbers(name: &str) -> Range<u64> {
    let given = |variable: &str| std::env::var(variable).ok()?.parse::<u64>().ok();
    if let Some(one) = given("GEOFAN_FUZZ_ONE") {
        return one..one + 1;
    }
    let usual = RUNS.iter().find(|(target, _)| *target == name);
    0..given("GEOFAN_FUZZ_RUNS").unwrap_or_else(|| usual.unwrap().1)
}

/// Writes the only input of a run for whoever looks for what is in it.
fn keep(name: &str, number: u64, bytes: &[u8]) {
    let file = format!("geofan-{name}-{}-{number}", key());
    let path = std::env::temp_dir().join(file);
    fs::write(&path, bytes).unwrap();
    println!("{}", path.display());
}

/// What a run of a target found.
#[derive(Default)]
struct Findings {
    inputs: u64,
    /// Number, bytes and time of the input that took longest.
    slowest: (u64, usize, Duration),
    /// Bytes of the longest input.
    longest: usize,
    /// Numbers of the inputs that panicked.
    fallen: Vec<u64>,
}

impl Findings {
    /// Adds one input: its number and bytes, whether the reader stayed calm, and how long it took.
    fn with(mut self, (number, bytes, calm, time): (u64, usize, bool, Duration)) -> Self {
        self.inputs += 1;
        self.longest = self.longest.max(bytes);
        if time > self.slowest.2 {
            self.slowest = (number, bytes, time);
        }
        self.fallen.extend((!calm).then_some(number));
        self
    }

    /// Adds those of other inputs.
    fn and(mut self, mut other: Self) -> Self {
        self.inputs += other.inputs;
        self.longest = self.longest.max(other.longest);
        if other.slowest.2 > self.slowest.2 {
            self.slowest = other.slowest;
        }
        self.fallen.append(&mut other.fallen);
        self
    }
}

/// Returns the most memory that this process has held so far, kB; 0 where the system does not tell.
fn most_memory() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let number = line.and_then(|line| line.split_whitespace().next()?.parse().ok());
    number.unwrap_or(0)
}

/// An input that takes longer is timed again, so many times.
const SLOW: Duration = Duration::from_millis(200);
const AGAIN: usize = 3;

/// Reads an input: whether the reader stays calm, and how long it takes.
fn timed(read: fn(&[u8]), bytes: &[u8]) -> (bool, Duration) {
    let began = Instant::now();
    let calm = catch_unwind(AssertUnwindSafe(|| read(bytes))).is_ok();
    (calm, began.elapsed())
}

/// Runs a target on all its inputs; panics are counted and told with the number of their input.
fn run((name, read): Target) {
    let seeds = seeds(name);
    assert!(!seeds.is_empty(), "{name} has no seeds");
    let before = most_memory();
    for (number, seed) in seeds.iter().enumerate() {
        let calm = catch_unwind(AssertUnwindSafe(|| read(seed))).is_ok();
        assert!(calm, "{name}: seed {number}");
    }
    let numbers = numbers(name);
    let alone = numbers.end - numbers.start == 1;
    let one = |number: u64| {
        let bytes = input(name, &seeds, number);
        if alone {
            keep(name, number, &bytes);
        }
        let (calm, mut time) = timed(read, &bytes);
        // The machine may have been busy.
        for _ in 0..AGAIN {
            if time > SLOW {
                time = time.min(timed(read, &bytes).1);
            }
        }
        (number, bytes.len(), calm, time)
    };
    let inputs = numbers.into_par_iter().map(one);
    let found = inputs
        .fold(Findings::default, Findings::with)
        .reduce(Findings::default, Findings::and);
    let (slowest, bytes, time) = found.slowest;
    println!(
        "{name}: key {}, {} inputs, longest {} bytes; slowest {slowest} ({bytes} bytes) {:.1} ms; \
         memory {before} kB before, {} kB at most",
        key(),
        found.inputs,
        found.longest,
        1e3 * time.as_secs_f64(),
        most_memory()
    );
    assert!(
        found.fallen.is_empty(),
        "{name}: inputs {:?} panic",
        found.fallen
    );
}

/// What a reader may take: 64 MB, and twenty times the file.
#[cfg(target_os = "linux")]
const MOST_MEMORY: u64 = 64_000 + 20 * 100;

/// Memory is that of a whole process, so each reader gets one of its own, and one thread.
#[test]
#[cfg(target_os = "linux")]
fn readers_of_changed_bundles_stay_within_their_memory() {
    for test in [
        "changed_bundles_do_not_panic",
        "bundles_changed_below_their_checksums_do_not_panic",
        "hostile_tables_do_not_panic",
    ] {
        let output = std::process::Command::new(std::env::current_exe().unwrap())
            .args(["--exact", test, "--nocapture", "--test-threads", "1"])
            .env("RAYON_NUM_THREADS", "1")
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stdout);
        let (_, memory) = said.split_once("memory ").unwrap();
        let kilobytes: Vec<u64> = memory
            .split_whitespace()
            .filter_map(|word| word.parse().ok())
            .collect();
        let took = kilobytes[1] - kilobytes[0];
        assert!(took < MOST_MEMORY, "{test}: {took} kB");
    }
}

macro_rules! targets {
    ($($test:ident: $number:literal;)*) => { $(
        #[test]
        fn $test() {
            run(TARGETS[$number]);
        }
    )* };
}

targets! {
    changed_bundles_do_not_panic: 0;
    bundles_changed_below_their_checksums_do_not_panic: 1;
    hostile_tables_do_not_panic: 2;
    changed_manifolds_do_not_panic: 3;
    changed_scenes_do_not_panic: 4;
    changed_meshes_do_not_panic: 5;
    changed_materials_do_not_panic: 6;
    changed_pictures_do_not_panic: 7;
    changed_camera_paths_do_not_panic: 8;
    changed_messages_do_not_panic: 9;
}
