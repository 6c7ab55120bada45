//! The `geofan` program as its users meet it: output, JSON keys, exit codes, closed pipes.

use assert_cmd::{Command, assert::Assert, cargo::cargo_bin_cmd};
use serde_json::Value;
use std::{
    f64::consts::PI,
    fs,
    io::Read,
    process::{self, Stdio},
};
use tempfile::TempDir;

const FLAT: &str = r#"
name = "flat"
coordinates = ["x", "y", "z"]
metric = { conformal = "n" }
[parameters]
n = 1.0
[domain]
x = [-20, 20]
inside = ["100 - y"]
[[exit]]
name = "sky"
when = "x - 10"
[cameras]
parameters = { c = [-1, 1] }
at = ["c", "0", "0"]
length = 5.0
"#;

const S3: &str = r#"
name = "three-sphere"
coordinates = ["x", "y", "z"]
metric = { conformal = "2/(1 + x^2 + y^2 + z^2)" }
[symmetry]
rotation = "origin"
"#;

const NIL: &str = r#"
name = "Nil"
coordinates = ["x", "y", "z"]
metric = { xx = "1 + y^2/4", yy = "1 + x^2/4", zz = "1", xy = "-x*y/4", xz = "y/2", yz = "-x/2" }
"#;

const TORUS: &str = r#"
name = "torus"
coordinates = ["x", "y", "z"]
metric = { conformal = "1" }
[domain]
x = [-1, 1]
y = [-1, 1]
z = [-1, 1]
periodic = ["x", "y", "z"]
"#;

/// A folder that holds the file `m.toml`.
fn folder(text: &str) -> TempDir {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("m.toml"), text).unwrap();
    folder
}

/// `geofan ARGUMENTS` (split at spaces) in a folder where `m.toml` has this text.
fn geofan(text: &str, arguments: &str) -> Assert {
    let folder = folder(text);
    let mut command: Command = cargo_bin_cmd!("geofan");
    command.current_dir(folder.path()).env("NO_COLOR", "1");
    command.args(arguments.split(' ')).assert()
}

fn stdout(assert: &Assert) -> String {
    String::from_utf8(assert.get_output().stdout.clone()).unwrap()
}

fn stderr(assert: &Assert) -> String {
    String::from_utf8(assert.get_output().stderr.clone()).unwrap()
}

/// The one JSON object on stdout of a command that succeeds.
fn json(text: &str, arguments: &str) -> Value {
    let assert = geofan(text, arguments).success();
    serde_json::from_str(&stdout(&assert)).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    let list = value.as_array().unwrap();
    list.iter().map(|x| x.as_f64().unwrap()).collect()
}

fn assert_close(found: &Value, expected: &[f64], tolerance: f64) {
    let found = numbers(found);
    assert_eq!(found.len(), expected.len());
    for (a, b) in found.iter().zip(expected) {
        assert!((a - b).abs() <= tolerance, "{found:?} is not {expected:?}");
    }
}

fn keys(value: &Value) -> Vec<&str> {
    let object = value.as_object().unwrap();
    let mut keys: Vec<_> = object.keys().map(String::as_str).collect();
    keys.sort_unstable();
    keys
}

#[test]
fn a_straight_line_in_flat_space_spreads_by_the_square_of_its_length() {
    let trace = json(
        FLAT,
        "trace m.toml --at -1,2,3 --dir 3,0,4 --length 4 --samples 5 --json",
    );
    assert_eq!(keys(&trace), ["conjugate", "end", "samples", "steps"]);
    let samples = trace["samples"].as_array().unwrap();
    assert_eq!(samples.len(), 5);
    for (i, sample) in samples.iter().enumerate() {
        let s = i as f64;
        assert_eq!(keys(sample), ["area", "frame", "s", "u", "v"]);
        assert_eq!(sample["s"], s);
        assert_close(&sample["u"], &[-1.0 + 0.6 * s, 2.0, 3.0 + 0.8 * s], 1e-12);
        assert_close(&sample["v"], &[0.6, 0.0, 0.8], 1e-12);
        assert_close(&sample["frame"][1], &[0.0, 1.0, 0.0], 1e-12);
        assert!((sample["area"].as_f64().unwrap() - s * s).abs() < 1e-11);
    }
    assert_eq!(trace["end"], "length");
    assert!(trace["steps"].as_u64().unwrap() > 0);
    assert_eq!(trace["conjugate"].as_array().unwrap().len(), 0);
}

#[test]
fn two_samples_are_the_start_and_the_end() {
    let trace = json(FLAT, "--json trace m.toml --at 1,0,0 --dir 0,1,0");
    let samples = trace["samples"].as_array().unwrap();
    assert_eq!(samples.len(), 2);
    assert_eq!(samples[0]["area"], 0.0);
    assert_eq!(samples[1]["s"], 5.0, "the file's length is the default");
}

#[test]
fn a_path_ends_at_the_exit_it_meets_first() {
    let ends = |at: &str, dir: &str| {
        let arguments =
            format!("trace m.toml --at {at} --dir {dir} --length 300 --samples 3 --json");
        let trace = json(FLAT, &arguments);
        let s = trace["samples"][2]["s"].as_f64().unwrap();
        (trace["end"].as_str().unwrap().to_string(), s)
    };
    let close = |found: (String, f64), name: &str, s: f64| {
        assert_eq!(found.0, name);
        assert!((found.1 - s).abs() < 1e-12, "{found:?}");
    };
    close(ends("7,0,0", "1,0,0"), "sky", 3.0);
    close(ends("7,0,0", "-1,0,0"), "limit", 27.0);
    close(ends("7,0,0", "0,1,0"), "inside", 100.0);
}

#[test]
fn parameters_can_be_set() {
    let trace = json(
        FLAT,
        "trace m.toml --at 0,0,0 --dir 1,0,0 --length 3 --set n=2 --json",
    );
    assert_close(&trace["samples"][1]["u"], &[1.5, 0.0, 0.0], 1e-12);
    assert_close(&trace["samples"][1]["v"], &[0.5, 0.0, 0.0], 1e-12);
}

#[test]
fn great_circles_close_after_two_pi_and_focus_at_the_antipode() {
    let arguments = format!(
        "trace m.toml --at 0.3,-0.2,0.1 --dir 1,2,-0.5 --length {} --samples 9 --json",
        2.0 * PI
    );
    let trace = json(S3, &arguments);
    let samples = trace["samples"].as_array().unwrap();
    for sample in samples {
        let s = sample["s"].as_f64().unwrap();
        let area = sample["area"].as_f64().unwrap();
        assert!((area - s.sin().powi(2)).abs() < 1e-7, "{s}: {area}");
    }
    let (first, last) = (&samples[0], &samples[8]);
    assert_close(&last["u"], &numbers(&first["u"]), 1e-8);
    assert_close(&last["v"], &numbers(&first["v"]), 1e-8);
    for k in 0..3 {
        assert_close(&last["frame"][k], &numbers(&first["frame"][k]), 1e-8);
    }
    let conjugate = numbers(&trace["conjugate"]);
    assert!(conjugate.len() >= 2, "{conjugate:?}");
    assert!((conjugate[0] - PI).abs() < 1e-7 && (conjugate[1] - PI).abs() < 1e-7);
}

#[test]
fn nil_agrees_with_its_closed_form() {
    let (a, c, angle, s) = (0.6_f64, 0.8_f64, 0.7_f64, 4.0_f64);
    let arguments = format!(
        "trace m.toml --at 0,0,0 --dir {},{},{c} --length {s} --tolerance 1e-12 --json",
        a * angle.cos(),
        a * angle.sin()
    );
    let trace = json(NIL, &arguments);
    let radius = 2.0 * a / c * (c * s / 2.0).sin();
    let turn = c * s / 2.0 + angle;
    let z = c * s + a * a / (2.0 * c * c) * (c * s - (c * s).sin());
    let expected = [radius * turn.cos(), radius * turn.sin(), z];
    assert_close(&trace["samples"][1]["u"], &expected, 1e-9);
    let cs = c * s;
    let area = (2.0 - 2.0 * cs.cos() - cs * (1.0 - c * c) * cs.sin()) / c.powi(4);
    let found = trace["samples"][1]["area"].as_f64().unwrap();
    assert!((found - area.abs()).abs() < 1e-8, "{found} is not {area}");
}

#[test]
fn points_of_glued_coordinates_stay_inside_their_limits() {
    let trace = json(
        TORUS,
        "trace m.toml --at 0.5,0,0 --dir 1,0,0 --length 10 --samples 21 --json",
    );
    for sample in trace["samples"].as_array().unwrap() {
        let x = numbers(&sample["u"])[0];
        assert!((-1.0..=1.0).contains(&x), "{x}");
    }
    assert_close(&trace["samples"][1]["u"], &[-1.0, 0.0, 0.0], 1e-12);
}

#[test]
fn the_table_ends_with_end_and_steps() {
    let assert = geofan(S3, "trace m.toml --at 0,0.5,0 --dir 1,0,0 --length 3.5").success();
    let text = stdout(&assert);
    let lines: Vec<_> = text.lines().collect();
    assert!(lines[0].contains("vx") && lines[0].contains("area"));
    assert!(lines[3].starts_with("conjugate points at s = 3.14159265"));
    assert!(lines[4].starts_with("end: length at s = 3.5, "));
    assert!(stderr(&assert).is_empty(), "nothing to say on stderr");
}

#[test]
fn bad_requests_end_with_code_2_and_a_word_about_the_fault() {
    let refused = |arguments: &str, word: &str| {
        let assert = geofan(FLAT, arguments).code(2);
        let text = stderr(&assert);
        assert!(text.contains(word), "`{arguments}` says: {text}");
        assert!(!text.contains("panicked"), "{text}");
    };
    let trace = |rest: &str| format!("trace m.toml --at 0,0,0 --dir 1,0,0 {rest}");
    refused(
        "trace gone.toml --at 0,0,0 --dir 1,0,0",
        "gone.toml: no such file",
    );
    refused("trace . --at 0,0,0 --dir 1,0,0", "is a folder");
    refused("info .", "is a folder");
    refused("info gone.toml", "no such file");
    refused("trace m.toml --at 0,0,0 --dir 0,0,0", "must not be zero");
    refused("trace m.toml --at 0,0,0 --dir 1,nan,0", "not finite");
    refused("trace m.toml --at 0,0 --dir 1,0,0", "three numbers");
    refused("trace m.toml --at 21,0,0 --dir 1,0,0", "limits [-20, 20]");
    refused("trace m.toml --at 0,101,0 --dir 1,0,0", "`inside`");
    refused("info m.toml --at 0,101,0", "`inside`");
    refused("trace m.toml --dir 1,0,0", "--at");
    refused(&trace("--length 0"), "above zero");
    refused(&trace("--length -1"), "above zero");
    refused(&trace("--samples 1"), "2..");
    refused(&trace("--tolerance 1e-20"), "between 1e-14 and 1e-1");
    refused(&trace("--set m=2"), "no parameter `m`");
    refused(&trace("--set n"), "name=value");
    refused(&trace("--set n=inf"), "not finite");
    refused(&trace("--set n=nan"), "not finite");
    refused(&trace("--set n=0"), "not positive definite");
    refused("frobnicate", "unrecognized subcommand");
}

#[test]
fn a_point_where_the_metric_breaks_down_is_no_start() {
    let text = r#"
name = "pole"
coordinates = ["x", "y", "z"]
metric = { conformal = "1/(x - 1.5)" }
[cameras]
at = ["1", "0", "0"]
"#;
    let assert = geofan(text, "trace m.toml --at 1.5,0,0 --dir 1,0,0 --length 1").code(2);
    assert!(
        stderr(&assert).contains("--at: x = 1.5, y = 0, z = 0: the metric is not finite there")
    );
}

#[test]
fn a_bad_expression_is_underlined_at_its_line_and_column() {
    let text = FLAT.replace("\"n\"", "\"n + sine(x)\"");
    let assert = geofan(&text, "trace m.toml --at 0,0,0 --dir 1,0,0").code(2);
    let report = stderr(&assert);
    assert!(report.contains("m.toml:4:29"), "{report}");
    assert!(report.contains("^^^^"), "{report}");
    assert!(report.contains("did you mean `sin`?"), "{report}");
    assert!(!report.contains('\u{1b}'), "no colours in a file: {report}");
    assert!(stdout(&assert).is_empty());
}

#[test]
fn errors_are_json_too_when_asked() {
    let error = |text: &str, arguments: &str| -> Value {
        let assert = geofan(text, arguments).code(2);
        let value: Value = serde_json::from_str(&stdout(&assert)).unwrap();
        assert!(
            !stderr(&assert).is_empty(),
            "the report stays on stderr too"
        );
        value["error"].clone()
    };
    let bad = FLAT.replace("\"n\"", "\"n + oops\"");
    let found = error(&bad, "info m.toml --json");
    assert_eq!(found["file"], "m.toml");
    assert_eq!((&found["line"], &found["column"]), (&4.into(), &29.into()));
    assert_eq!(found["message"], "unknown name `oops`");
    let found = error(FLAT, "--json info gone.toml");
    assert_eq!(found["file"], "gone.toml");
    let found = error(FLAT, "trace m.toml --json --at 0,0,0 --dir 0,0,0");
    let message = found["message"].as_str().unwrap();
    assert!(message.contains("--dir"), "{message}");
}

#[test]
fn info_describes_a_manifold() {
    let info = json(FLAT, "info m.toml --at 0,0,0 --set n=2 --json");
    assert_eq!(info["kind"], "manifold");
    assert_eq!(info["name"], "flat");
    assert_eq!(info["definition"], "metric");
    assert_eq!(info["parameters"]["n"], 2.0);
    assert_close(&info["limits"][0], &[-20.0, 20.0], 0.0);
    assert_eq!(info["exits"], serde_json::json!(["sky", "limit", "inside"]));
    assert_close(&info["cameras"]["c"], &[-1.0, 1.0], 0.0);
    assert_close(&info["at"]["metric"][0], &[4.0, 0.0, 0.0], 0.0);
    assert_close(&info["at"]["inverse"][0], &[0.25, 0.0, 0.0], 0.0);
    assert_close(&info["at"]["frame"][0], &[0.5, 0.0, 0.0], 0.0);
    let text = stdout(&geofan(S3, "info m.toml").success());
    assert!(text.contains("rotations about the origin (verified around cameras"));
}

#[test]
fn every_manifold_of_the_catalogue_is_described() {
    let catalogue = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/manifolds");
    for entry in fs::read_dir(catalogue).unwrap() {
        let path = entry.unwrap().path();
        let mut command: Command = cargo_bin_cmd!("geofan");
        command.arg("info").arg(&path).assert().success();
    }
}

#[test]
fn a_closed_pipe_ends_the_program_quietly() {
    let folder = folder(FLAT);
    let mut child = process::Command::new(assert_cmd::cargo::cargo_bin!("geofan"))
        .current_dir(folder.path())
        .args("trace m.toml --at 0,0,0 --dir 0,1,0 --samples 20000".split(' '))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let mut said = String::new();
    let mut pipe = child.stderr.take().unwrap();
    pipe.read_to_string(&mut said).unwrap();
    assert!(child.wait().unwrap().success());
    assert_eq!(said, "");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_the_environments_fault() {
    let folder = folder(FLAT);
    let full = fs::File::options().write(true).open("/dev/full").unwrap();
    let status = process::Command::new(assert_cmd::cargo::cargo_bin!("geofan"))
        .current_dir(folder.path())
        .args(["info", "m.toml"])
        .stdout(full)
        .stderr(Stdio::null())
        .status()
        .unwrap();
    assert_eq!(status.code(), Some(3));
}

#[test]
fn threads_are_taken_as_asked() {
    geofan(FLAT, "info m.toml --threads 2").success();
    geofan(FLAT, "info m.toml --threads many").code(2);
}

#[test]
#[cfg(unix)]
fn what_comes_through_a_pipe_is_described_as_the_file_is() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("flat.toml");
    fs::write(&file, FLAT).unwrap();
    let bundle = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/s3.fan");
    for file in [file.as_path(), bundle.as_ref()] {
        let told = |name: &std::path::Path, piped: Vec<u8>| {
            let mut command = cargo_bin_cmd!("geofan");
            let command = command.args(["info", "--json"]).arg(name);
            let output = command.write_stdin(piped).assert().success();
            output.get_output().stdout.clone()
        };
        let expected = told(file, Vec::new());
        let found = told("/dev/stdin".as_ref(), fs::read(file).unwrap());
        assert_eq!(found, expected, "{}", file.display());
    }
    let mut check = cargo_bin_cmd!("geofan");
    let check = check.args("check /dev/stdin --rays 100 --json".split(' '));
    let bytes = fs::read(bundle).unwrap();
    let (size, output) = (bytes.len(), check.write_stdin(bytes).assert().success());
    let told = String::from_utf8(output.get_output().stdout.clone()).unwrap();
    assert!(
        told.contains(&format!("\"bytes\": {size}")) || told.contains(&format!("\"bytes\":{size}")),
        "{told}"
    );
}
