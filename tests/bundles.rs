//! `geofan check`, `info` and `trace --bundle` on a table made by hand.

use assert_cmd::{Command, assert::Assert, cargo::cargo_bin_cmd};
use geofan_bake::certify;
use geofan_bundle::{
    Bundle, Contents, MappedChebyshev, PlanRecord, Polynomial, StepSize, TangentPromise, Train,
    Tree, Variables, rays::RaySpace,
};
use geofan_core::{diagnostic::SourceText, manifold::Manifold};
use ndarray::{ArrayD, IxDyn};
use serde_json::Value;
use std::{fs, sync::Arc};
use tempfile::TempDir;

const FLAT: &str = r#"
name = "flat"
coordinates = ["x", "y", "z"]
metric = { conformal = "2" }
[domain]
z = [-3, 3]
[[exit]]
name = "sky"
when = "y - 1"
[symmetry]
translation = ["x"]
[cameras]
parameters = { c = [-0.5, 0.5] }
at = ["0", "c", "0"]
length = 8.0
"#;

fn leaf(wrong: f64) -> Tree {
    let slopes = vec![wrong, 0.0, 0.0];
    let samples = ArrayD::from_shape_vec(IxDyn(&[1, 1, 1, 1, 3]), slopes).unwrap();
    let polynomial = Polynomial {
        coefficients: samples,
        variables: Variables::of_face(1, MappedChebyshev::NONE),
    };
    let tensor = Train::plain(&polynomial).rounded(StepSize::near(1e-8));
    Tree::Leaf(Arc::new(tensor.unwrap()))
}

/// A folder with `b.fan`: flat, its displacement `wrong` everywhere; rays around −y are flagged,
/// those around −z in the second half of their length.
fn folder(wrong: f64) -> TempDir {
    let manifold = Manifold::from_source(SourceText::new("flat.toml", FLAT), &[]).unwrap();
    let space = RaySpace::new(Arc::new(manifold)).unwrap();
    let plan = PlanRecord {
        tangents: TangentPromise::AsPoints,
        ..PlanRecord::new(8.0, 0.5, vec![1], vec![1; 4])
    };
    let chunk = |face| match face {
        3 => Tree::Flagged,
        5 => Tree::Split {
            axis: 3,
            halves: Box::new([leaf(wrong), Tree::Flagged]),
        },
        _ => leaf(wrong),
    };
    let chunks = (0..6).map(|face| (face, chunk(face).encode()));
    let contents = Contents::new(space, plan, 0, chunks.collect()).unwrap();
    let bundle = Bundle::from_contents(contents).unwrap();
    let certificate = certify(&bundle.table, 200, 1, 1e-9, 0.5, |_| Ok(()));
    let certificate = certificate.unwrap().certificate;
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("b.fan");
    bundle.certified(certificate).write(&path).unwrap();
    folder
}

fn geofan(folder: &TempDir, arguments: &str) -> Assert {
    let mut command: Command = cargo_bin_cmd!("geofan");
    command.current_dir(folder.path()).env("NO_COLOR", "1");
    command.args(arguments.split(' ')).assert()
}

fn json(assert: &Assert) -> Value {
    serde_json::from_slice(&assert.get_output().stdout).unwrap()
}

fn stderr(assert: &Assert) -> String {
    String::from_utf8(assert.get_output().stderr.clone()).unwrap()
}

fn keys(value: &Value) -> Vec<&str> {
    let object = value.as_object().unwrap();
    object.keys().map(String::as_str).collect()
}

fn close(value: &Value, expected: [f64; 3]) {
    for (x, e) in value.as_array().unwrap().iter().zip(expected) {
        assert!((x.as_f64().unwrap() - e).abs() < 1e-8, "{value}");
    }
}

#[test]
fn a_good_bundle_passes_its_check_and_a_wrong_one_fails_it() {
    let good = json(&geofan(&folder(0.0), "check b.fan --rays 2000 --json").success());
    for key in ["mrad", "screen_mrad", "rotation_mrad"] {
        assert_eq!(keys(&good[key]), ["max", "p50", "p95", "p99"]);
        assert!(good[key]["p99"].as_f64().unwrap() < 1e-3);
    }
    let flagged = good["flagged"].as_f64().unwrap();
    assert!(flagged > 0.25 && flagged < 0.35, "{flagged}");
    assert!(good["bytes"].as_u64().unwrap() > 100);
    let wrong = folder(1e-3);
    let report = json(&geofan(&wrong, "check b.fan --rays 500 --json").code(1));
    // Wrong by 1e-3 in chart units of length 2.
    assert!((report["mrad"]["max"].as_f64().unwrap() - 2.0).abs() < 0.1);
    let text = geofan(&wrong, "check b.fan --rays 500").code(1);
    assert!(String::from_utf8_lossy(&text.get_output().stdout).contains("NOT KEPT"));
}

#[test]
fn info_says_what_is_inside() {
    let folder = folder(0.0);
    let info = json(&geofan(&folder, "info b.fan --json").success());
    assert_eq!(info["kind"], "bundle");
    assert_eq!(info["reduction"], "translation");
    assert_eq!(info["patches"], 5);
    assert_eq!(info["flagged_boxes"], 2);
    assert_eq!(info["certificate"]["rays"], 200);
    let text = geofan(&folder, "info b.fan").success();
    let text = String::from_utf8_lossy(&text.get_output().stdout).into_owned();
    assert!(
        text.contains("flat (flat.toml)") && text.contains("certificate"),
        "{text}"
    );
    geofan(&folder, "info b.fan --set a=1").code(2);
}

#[test]
fn a_path_from_the_table_ends_where_its_ray_leaves() {
    let folder = folder(0.0);
    let trace = "trace --bundle b.fan --at 7,0.25,0 --json --samples 3";
    let sky = json(&geofan(&folder, &format!("{trace} --dir 0,1,0")).success());
    assert_eq!(keys(&sky), ["end", "samples", "steps"]);
    assert_eq!(sky["end"], "sky");
    let last = &sky["samples"][2];
    assert_eq!(keys(last), ["frame", "s", "u", "v"]);
    assert!((last["s"].as_f64().unwrap() - 1.5).abs() < 1e-9);
    close(&last["u"], [7.0, 1.0, 0.0]);
    close(&last["v"], [0.0, 0.5, 0.0]);
    close(&last["frame"][0], [0.5, 0.0, 0.0]);
    let limit = json(&geofan(&folder, &format!("{trace} --dir 0,0,1")).success());
    assert_eq!(limit["end"], "limit");
    let length = json(&geofan(&folder, &format!("{trace} --dir 1,0,0 --length 4")).success());
    assert_eq!(length["end"], "length");
    close(&length["samples"][2]["u"], [9.0, 0.25, 0.0]);
}

#[test]
fn a_flagged_ray_is_followed_exactly_unless_it_ends_before() {
    let folder = folder(0.0);
    let trace = "trace --bundle b.fan --at 0,0,0 --json";
    let exact = json(&geofan(&folder, &format!("{trace} --dir 0,-1,0")).success());
    assert_eq!(exact["exact"], true);
    assert!(exact["steps"].as_u64().unwrap() > 0);
    close(&exact["samples"][1]["u"], [0.0, -4.0, 0.0]);
    let short = json(&geofan(&folder, &format!("{trace} --dir 0,0,-1 --length 3.9")).success());
    assert!(short.get("exact").is_none());
    let long = json(&geofan(&folder, &format!("{trace} --dir 0,0,-1")).success());
    assert_eq!(
        (&long["exact"], &long["end"]),
        (&Value::Bool(true), &Value::from("limit"))
    );
}

#[test]
fn wrong_requests_and_damaged_bundles_are_bad_input() {
    let folder = folder(0.0);
    let refused = |arguments: &str, say: &str| {
        let text = stderr(&geofan(&folder, arguments).code(2));
        assert!(text.contains(say), "{arguments}: {text}");
    };
    refused(
        "trace --bundle b.fan --at 0,0.7,0 --dir 1,0,0",
        "camera region",
    );
    refused("trace --bundle b.fan --at 0,0,9 --dir 1,0,0", "limits");
    refused(
        "trace --bundle b.fan --at 0,0,0 --dir 1,0,0 --length 9",
        "end at 8",
    );
    refused(
        "trace m.toml --bundle b.fan --at 0,0,0 --dir 1,0,0",
        "cannot be used",
    );
    refused("trace --at 0,0,0 --dir 1,0,0", "MANIFOLD");
    refused("check gone.fan", "no such file");
    let bytes = fs::read(folder.path().join("b.fan")).unwrap();
    fs::write(folder.path().join("cut.fan"), &bytes[..bytes.len() - 60]).unwrap();
    refused("check cut.fan", "truncated");
    refused("info cut.fan", "truncated");
    refused("trace --bundle cut.fan --at 0,0,0 --dir 1,0,0", "truncated");
}
