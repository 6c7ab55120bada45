//! Commands that write files, what they need, and what they leave: for tests that disturb them.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    process::{Command, ExitStatus},
};
use tempfile::TempDir;

/// Makes a test of each of [`CASES`] by its number, which calls `survives` of the file that names it.
macro_rules! cases {
    ($($test:ident: $number:literal;)*) => { $(
        #[test]
        fn $test() {
            survives(&CASES[$number]);
        }
    )* };
}

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

const SQUARE: &str = "v 0 -1 -1\nv 0 1 -1\nv 0 1 1\nv 0 -1 1\nf 1 2 3 4\n";

/// A command, and what it leaves.
pub struct Case {
    pub name: &'static str,
    /// Commands that make its inputs.
    pub before: &'static [&'static str],
    pub arguments: &'static str,
    /// What is added when the command is given again after a fault.
    pub again: &'static str,
    pub outputs: &'static [&'static str],
    /// Whether it replaces outputs that are there; others are left alone or refused.
    pub replaces: bool,
    /// Whether it takes so long that an ordinary run disturbs it seldom.
    pub slow: bool,
}

pub const CASES: [Case; 7] = [
    Case {
        name: "bake",
        before: &[],
        arguments: "bake space.toml -o b.fan --max-error 3 --certify-rays 100",
        again: " --resume",
        outputs: &["b.fan"],
        replaces: true,
        slow: false,
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
        replaces: true,
        slow: false,
    },
    Case {
        name: "sweep",
        before: &[],
        arguments: "sweep space.toml --quick --out out --max-error 3 --cells 8 --rays 320",
        again: "",
        outputs: &["out/sweep.csv", "out/bundles/space-patches-3.fan"],
        replaces: false,
        slow: true,
    },
    Case {
        name: "animation",
        before: &[],
        arguments: "render scene.toml --size 12x8 --camera-path way.toml --frames 3 -o f-%02d.png",
        again: "",
        outputs: &["f-00.png", "f-01.png", "f-02.png"],
        replaces: false,
        slow: false,
    },
    Case {
        name: "path tracing",
        before: &[],
        arguments: "render scene.toml --tracer path --size 12x8 --spp 4 -o p.png --resume",
        again: "",
        outputs: &["p.png"],
        replaces: false,
        slow: false,
    },
    Case {
        name: "page",
        before: &[],
        arguments: "view scene.toml --page out.html --wasm any.wasm",
        again: "",
        outputs: &["out.html"],
        replaces: true,
        slow: false,
    },
    Case {
        name: "cache of light",
        before: &["bake space.toml -o b.fan --max-error 3 --certify-rays 100"],
        arguments: "render scene.toml --size 12x8 --bundle b.fan -o l.png",
        again: "",
        outputs: &["b.fan.light", "l.png"],
        replaces: true,
        slow: false,
    },
];

/// A folder with all inputs of a case, made once and copied for every run.
pub struct Inputs(TempDir);

impl Inputs {
    /// Makes them.
    pub fn of(case: &Case) -> Self {
        let folder = TempDir::new().unwrap();
        let write = |name: &str, text: &[u8]| fs::write(folder.path().join(name), text).unwrap();
        write("space.toml", SPACE.as_bytes());
        write("scene.toml", SCENE.as_bytes());
        write("way.toml", POSES.as_bytes());
        write("square.obj", SQUARE.as_bytes());
        write("any.wasm", b"\0asm\x01\0\0\0");
        for before in case.before {
            let made = geofan(folder.path(), before).output().unwrap();
            assert!(done(made.status), "{made:?}");
        }
        Self(folder)
    }

    /// Copies them, with old files in place of the outputs if `old` and the case replaces them.
    pub fn copy(&self, case: &Case, old: bool) -> TempDir {
        let folder = TempDir::new().unwrap();
        for name in names(self.0.path()) {
            fs::copy(self.0.path().join(&name), folder.path().join(&name)).unwrap();
        }
        if old && case.replaces {
            for name in case.outputs {
                fs::write(folder.path().join(name), old_content(name)).unwrap();
            }
        }
        folder
    }
}

/// The program with these arguments, on one thread. Rust's report of an allocation that fails waits for itself for ever
/// where it is to tell who called and has no memory for that either.
pub fn geofan(folder: &Path, arguments: &str) -> Command {
    let mut command = Command::new(assert_cmd::cargo::cargo_bin!("geofan"));
    command
        .current_dir(folder)
        .env_remove("RUST_BACKTRACE")
        .env_remove("RUST_LIB_BACKTRACE")
        .args(["--quiet", "--threads", "1"])
        .args(arguments.split(' '));
    command
}

/// Tells whether a run ended as one that does its work.
pub fn done(status: ExitStatus) -> bool {
    // 1: the table is there, and its few rays miss the promise.
    matches!(status.code(), Some(0 | 1))
}

/// Reads the outputs that are there, without what is different in every run.
pub fn outputs(case: &Case, folder: &Path) -> BTreeMap<&'static str, Vec<u8>> {
    let read = |name: &&'static str| {
        let bytes = fs::read(folder.join(name)).ok()?;
        match name.ends_with(".csv") {
            true => Some((*name, without_times(&bytes))),
            false => Some((*name, bytes)),
        }
    };
    case.outputs.iter().filter_map(read).collect()
}

/// Leaves the columns of times out, and that of the machine's load.
fn without_times(csv: &[u8]) -> Vec<u8> {
    let mut reader = csv::Reader::from_reader(csv);
    let names = reader.headers().unwrap().clone();
    let of_time = |name: &str| {
        let units = ["_s", "_ms", "_ns", "_ns_per_path", "load_1min"];
        units.iter().any(|unit| name.ends_with(unit))
    };
    let kept: Vec<usize> = (0..names.len()).filter(|k| !of_time(&names[*k])).collect();
    let mut text = String::new();
    for row in reader.records() {
        let row = row.unwrap();
        let cells: Vec<&str> = kept.iter().map(|k| &row[*k]).collect();
        text += &(cells.join(",") + "\n");
    }
    text.into_bytes()
}

/// Tells whether a run ends well without this output.
fn is_cache(name: &str) -> bool {
    name.ends_with(".light")
}

/// What an output holds before: of a cache, which takes no place of a file of another kind, a damaged one.
fn old_content(name: &str) -> &'static [u8] {
    if is_cache(name) {
        b"geofan light old"
    } else {
        b"old"
    }
}

/// Lists all files below `folder`.
pub fn names(folder: &Path) -> Vec<PathBuf> {
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

/// What a run that is not disturbed leaves: the outputs, and the names of all files.
pub struct Wanted {
    pub outputs: BTreeMap<&'static str, Vec<u8>>,
    pub names: Vec<PathBuf>,
}

impl Wanted {
    /// Takes it from the folder of such a run.
    pub fn of(case: &Case, folder: &Path) -> Self {
        let outputs = outputs(case, folder);
        assert_eq!(outputs.len(), case.outputs.len(), "{}", case.name);
        Self {
            outputs,
            names: names(folder),
        }
    }

    /// Checks what a disturbed run left: every output that is there is the new one, or the `old` one where the
    /// run did not end well.
    pub fn check_left(&self, case: &Case, folder: &Path, (old, done): (bool, bool), about: &str) {
        let found = outputs(case, folder);
        for name in case.outputs {
            // Without a cache the next run takes longer, that is all.
            let done = done && !is_cache(name);
            let Some(bytes) = found.get(name) else {
                assert!(!done, "{about}: {name} is missing");
                continue;
            };
            let kept = old && case.replaces && bytes == old_content(name);
            let new = *bytes == self.outputs[name];
            assert!(new || kept, "{about}: {name} has {} bytes", bytes.len());
            assert!(!done || !kept, "{about}: {name} is old");
        }
    }

    /// Gives the command again, undisturbed: the same outputs, and no other file.
    pub fn check_again(&self, case: &Case, folder: &Path, about: &str) {
        let arguments = format!("{}{}", case.arguments, case.again);
        let ended = geofan(folder, &arguments).output().unwrap();
        assert!(done(ended.status), "{about}, then {ended:?}");
        let same = outputs(case, folder) == self.outputs;
        assert!(same, "{about}: another result");
        assert_eq!(names(folder), self.names, "{about}");
    }
}
