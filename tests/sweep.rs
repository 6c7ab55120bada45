//! `geofan-bake sweep` on a tiny manifold: what it writes, and that it goes on where it was stopped.

mod support;

use assert_cmd::assert::Assert;
use ndarray::{ArrayD, Ix1};
use ndarray_npy::NpzReader;
use std::{
    collections::BTreeMap,
    fs::{self, File},
    time::SystemTime,
};
use support::Place;

/// A mild lens seen from anywhere on a shell: two axes and the arc length.
const LENS: &str = r#"
name = "a < mild > lens"
coordinates = ["x", "y", "z"]
metric = { conformal = "exp(h*exp(-(x^2 + y^2 + z^2)/2))" }
[parameters]
h = 0.1
[[exit]]
name = "sky of all"
when = "x^2 + y^2 + z^2 - 30"
[symmetry]
rotation = "origin"
[cameras]
parameters = { c = [1, 2] }
at = ["c", "0", "0"]
length = 3.0
"#;

/// Without symmetry: three camera parameters.
const BOX: &str = r#"
name = "box"
coordinates = ["x", "y", "z"]
metric = { conformal = "exp(0.1*exp(-(x^2 + y^2 + z^2)/2))" }
[cameras]
parameters = { a = [-1, 1], b = [-1, 1], c = [-1, 1] }
at = ["a", "b", "c"]
length = 3.0
"#;

fn place() -> Place {
    Place::with(&[("lens.toml", LENS), ("box.toml", BOX)])
}

fn sweep(place: &Place, arguments: &str) -> Assert {
    place.bake(&format!("sweep {arguments}"))
}

/// A sweep of few and small tables.
fn little(place: &Place) -> Assert {
    sweep(
        place,
        "lens.toml --quick --out out --max-error 3 --cells 8 --cells 16 --rays 320",
    )
}

/// When each point was written.
fn written(place: &Place) -> BTreeMap<String, SystemTime> {
    let entries = fs::read_dir(place.path("out/points")).unwrap();
    let file = |entry: std::io::Result<fs::DirEntry>| {
        let entry = entry.unwrap();
        let name = entry.file_name().into_string().unwrap();
        (name, entry.metadata().unwrap().modified().unwrap())
    };
    entries.map(file).collect()
}

fn rows(csv: &str) -> Vec<BTreeMap<String, String>> {
    let mut reader = csv::Reader::from_reader(csv.as_bytes());
    reader.deserialize().map(|row| row.unwrap()).collect()
}

#[test]
fn a_sweep_writes_a_row_for_every_table_and_a_page_that_stands_alone() {
    let place = place();
    little(&place).success();
    let rows = rows(&fs::read_to_string(place.path("out/sweep.csv")).unwrap());
    // One bundle, one undivided, and two grids in four readings.
    assert_eq!(rows.len(), 10);
    for row in &rows {
        assert_eq!(row["outcome"], "measured");
        let number = |name: &str| row[name].parse::<f64>().unwrap();
        assert!(number("screen_p50_mrad") <= number("screen_p99_mrad"));
        assert!(number("lookup_cpu_ns_per_path") > 0.0 && number("bake_wall_s") > 0.0);
        assert_eq!(row["seed"], "2");
        // Frames are transported along the paths of every table.
        assert!(number("rotation_p99_mrad") < 30.0);
    }
    let patches = rows
        .iter()
        .find(|r| r["representation"] == "patches")
        .unwrap();
    assert!(patches["screen_p99_mrad"].parse::<f64>().unwrap() <= 3.0);
    let file = place.bytes("out/bundles/lens-patches-3.fan");
    assert_eq!(patches["disk_bytes"], file.len().to_string());

    let page = fs::read_to_string(place.path("out/index.html")).unwrap();
    assert!(page.contains("--cells 8 --cells 16") && page.contains("a &lt; mild &gt; lens"));
    assert!(page.contains("<svg") && page.contains("data:image/png;base64,"));
    let elsewhere = page.replace("http://www.w3.org/", "");
    assert!(!elsewhere.contains("http://") && !elsewhere.contains("https://"));
    for figure in [
        "error-bytes.svg",
        "error-bytes.png",
        "map-camera-patches.png",
    ] {
        assert!(
            place.path(&format!("out/figures/lens-{figure}")).exists(),
            "{figure}"
        );
    }
}

#[test]
fn points_already_measured_are_kept_and_changed_ones_measured_again() {
    let place = place();
    little(&place).success();
    let first = written(&place);
    fs::remove_file(place.path("out/points/lens-patches-3.json")).unwrap();
    fs::write(place.path("out/points/lens-exact.json"), "{ cut off").unwrap();
    little(&place).success();
    let second = written(&place);
    assert_eq!(first.len(), second.len());
    for (name, when) in &second {
        let again = ["lens-patches-3.json", "lens-exact.json"].contains(&name.as_str());
        assert_eq!(first[name] != *when, again, "{name}");
    }
    // Another manifold of the same name shares nothing.
    let other = LENS.replace("h = 0.1", "h = 0.11");
    fs::write(place.path("lens.toml"), other).unwrap();
    little(&place).success();
    let third = written(&place);
    assert!(
        third
            .iter()
            .filter(|(name, _)| second.contains_key(*name))
            .all(|(n, t)| second[n] != *t)
    );
}

#[test]
fn a_kept_bundle_is_mapped_once_it_stands_in_the_middle() {
    let place = place();
    let promises = |list: &str| {
        let arguments = format!("lens.toml --quick --out out {list} --cells 8 --rays 320");
        sweep(&place, &arguments).success();
        place.path("out/figures/lens-map-direction-patches.png")
    };
    // Of two the tighter one is mapped.
    let figure = promises("--max-error 6 --max-error 3");
    fs::remove_file(&figure).unwrap();
    promises("--max-error 6 --max-error 6");
    assert!(figure.exists());
    // What is asked for twice is measured once: a bundle, one that is not divided, and a grid in four readings.
    let csv = fs::read_to_string(place.path("out/sweep.csv")).unwrap();
    assert_eq!(rows(&csv).len(), 6);
}

#[test]
#[cfg(unix)]
fn an_interrupted_sweep_keeps_its_points_and_says_so() {
    let place = place();
    let kept = "out/points/lens-patches-3.json";
    let text = place.interrupted(
        "sweep lens.toml --out out --max-error 3 --max-error 0.0001 --threads 1",
        kept,
    );
    assert!(text.contains("run the same command again"), "{text}");
    assert!(place.path(kept).exists());
}

#[test]
fn a_tensor_of_one_face_has_its_axes_beside_it() {
    let place = place();
    sweep(
        &place,
        "box.toml --out out --npz-nodes 3,4,5 --npz-face 0 --npz-no-frames",
    )
    .success();
    let file = File::open(place.path("out/npz/box-3-4-5-uniform-face0.npz")).unwrap();
    let mut npz = NpzReader::new(file).unwrap();
    let tensor: ArrayD<f32> = npz.by_name("displacement").unwrap();
    assert_eq!(tensor.shape(), [3, 3, 3, 1, 4, 4, 5, 3]);
    assert!(tensor.iter().all(|x| x.is_finite()) && tensor.iter().any(|x| x.abs() > 1e-3));
    let mut axis = |name: &str| npz.by_name::<ndarray::OwnedRepr<f32>, Ix1>(name).unwrap();
    assert_eq!(axis("camera_2").to_vec(), [-1.0, 0.0, 1.0]);
    assert_eq!(axis("direction_0")[3], 1.0);
    assert_eq!(axis("arc_length").to_vec(), [0.0, 0.75, 1.5, 2.25, 3.0]);
    assert!(
        npz.by_name::<ndarray::OwnedRepr<f32>, ndarray::IxDyn>("slope")
            .is_err()
    );
}

#[test]
fn wrong_requests_are_refused() {
    let place = place();
    sweep(&place, "missing.toml --out out").code(2);
    sweep(&place, "lens.toml").code(2);
    sweep(&place, "lens.toml ./lens.toml --out out").code(2);
    sweep(&place, "lens.toml --out out --npz-nodes 3,4").code(2);
    sweep(&place, "lens.toml --out out --npz-nodes 3,4,5 --seed 9").code(2);
    sweep(&place, "lens.toml ./lens.toml --out out --npz-nodes 3,4,5").code(2);
    sweep(&place, "lens.toml --out out --npz-face 1").code(2);
    sweep(&place, "lens.toml --out out --cells 0").code(2);
    sweep(&place, "box.toml --out out --npz-nodes 200,200,200").code(2);
}
