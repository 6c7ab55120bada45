//! Bundles of this format that are kept with their paths (`tests/golden/`, made by `make.py` there): what was
//! written once must be read for good, and give the same light.

use geofan::{
    bundle::{Bundle, Contents, Header, Table, Tree, trace},
    manifold::Manifold,
};
use glam::DVec3;
use serde::Deserialize;
use std::{
    fs,
    path::{Path, PathBuf},
};

/// Largest deviation of a position over the arc length, and of a tangent, both as lengths in the metric. Tables are
/// contracted in single precision, and the order of its sums depends on the width of the machine's vectors: some
/// hundred terms, each rounded by 6e-8 of the largest coefficient. The finest promise of the bundles, 0.05 mrad, is
/// five times as much.
const SINGLE: f64 = 1e-5;

/// Largest deviation at the start, which no table has a part in.
const DOUBLE: f64 = 1e-12;

#[derive(Deserialize)]
struct Golden {
    bundles: Vec<GoldenBundle>,
}

#[derive(Deserialize)]
struct GoldenBundle {
    file: String,
    paths: Vec<GoldenPath>,
}

#[derive(Deserialize)]
struct GoldenPath {
    at: DVec3,
    dir: DVec3,
    samples: Vec<GoldenSample>,
}

#[derive(Deserialize)]
struct GoldenSample {
    s: f64,
    u: DVec3,
    v: DVec3,
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden")
}

fn golden() -> Vec<GoldenBundle> {
    let text = fs::read_to_string(folder().join("paths.json")).unwrap();
    serde_json::from_str::<Golden>(&text).unwrap().bundles
}

/// The length in the metric of a vector at `u`.
fn length(manifold: &Manifold, u: DVec3, v: DVec3) -> f64 {
    let u = manifold.domain.wrap(u);
    v.dot(manifold.metric(u) * v).sqrt()
}

/// Finds the largest deviation of a path at its start, and behind it.
fn deviations(bundle: &Bundle, path: &GoldenPath) -> [f64; 2] {
    let manifold = &bundle.manifold;
    let (count, last) = (path.samples.len(), path.samples.last().unwrap().s);
    let direction = path.dir.normalize();
    let traced = trace(&bundle.table, path.at, direction, last, count, 1e-10).unwrap();
    assert!(!traced.exact && traced.samples.len() == count);
    let mut worst = [0.0_f64; 2];
    for (found, expected) in traced.samples.iter().zip(&path.samples) {
        assert!((found.s - expected.s).abs() <= 1e-14 * last);
        let off = |x: DVec3| length(manifold, expected.u, x);
        let position = off(found.u - expected.u) / expected.s.max(1.0);
        let own = &mut worst[usize::from(expected.s > 0.0)];
        *own = own.max(position).max(off(found.v - expected.v));
    }
    worst
}

#[test]
fn golden_bundles_give_the_paths_that_they_gave() {
    for golden in golden() {
        let bundle = Bundle::read(&folder().join(&golden.file)).unwrap();
        assert_eq!(golden.paths.len(), 10);
        for path in &golden.paths {
            let [start, behind] = deviations(&bundle, path);
            let about = format!("{} from {} along {}", golden.file, path.at, path.dir);
            assert!(start <= DOUBLE, "{about}: {start}");
            assert!(behind <= SINGLE, "{about}: {behind}");
        }
    }
}

#[test]
fn golden_bundles_come_back_byte_for_byte() {
    for golden in golden() {
        let path = folder().join(&golden.file);
        let bytes = fs::read(&path).unwrap();
        let contents = Contents::read(&path).unwrap();
        let header = contents.header.encode().unwrap();
        assert_eq!(Header::decode(&header).unwrap(), contents.header);
        let shape = Table::tensor_shape(&contents.space, contents.header.plan.mapping);
        let budget = contents.budget();
        for (number, chunk) in &contents.chunks {
            let tree = Tree::decode(chunk, shape, &budget).unwrap();
            assert!(tree.encode() == *chunk, "{} chunk {number}", golden.file);
        }
        assert!(contents.encode().unwrap() == bytes, "{}", golden.file);
        let bundle = Bundle::from_contents(contents).unwrap();
        assert!(bundle.contents().encode().unwrap() == bytes);
    }
}
