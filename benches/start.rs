//! What a scene with a mesh of a million triangles waits for: its file is read, it is placed, and its tree is built; and
//! when it starts again, with what was kept of that.
//!
//! `cargo bench --bench start`. A bumpy torus as OBJ stands in a wormhole, where it is placed by one matrix, and among three
//! bumps and in the three-sphere, where vertices are placed along geodesics.

use criterion::{Criterion, criterion_group, criterion_main};
use geofan_core::keeping::{ResultKey, ResultStore, with_store};
use geofan_render::{Stage, accel::Accelerator, scene::Mesh};
use std::{
    cell::RefCell,
    collections::HashMap,
    f64::consts::TAU,
    fmt::Write,
    hint::black_box,
    path::{Path, PathBuf},
    rc::Rc,
};

/// Quads around the torus, and around its tube.
const QUADS: [usize; 2] = [1000, 500];

/// Name, manifold, camera and object of the scenes.
const SCENES: [(&str, &str, &str, &str); 3] = [
    (
        "wormhole",
        "ellis-wormhole",
        "parameters = { c = 4.0 }\nlook = [-1, 0, 0]",
        "at = [1.9, 0.9, 0.2]\nscale = 0.55",
    ),
    (
        "bumps",
        "three-bumps",
        "at = [-2, 0.2, 0.3]\nlook = [1, -0.05, -0.1]",
        "at = [1.2, 0.4, 0.2]\nscale = 0.8\nplacement = 'exponential'",
    ),
    (
        "s3",
        "s3",
        "at = [-0.6587, 0, 0.6587]\nlook = [1, 0, -1]",
        "at = [0, 0, 0]\nscale = 0.5\nplacement = 'exponential'",
    ),
];

/// Keeps results in memory.
#[derive(Default)]
struct Memory(RefCell<HashMap<ResultKey, Vec<u8>>>);

impl ResultStore for Memory {
    fn get(&self, key: &ResultKey) -> Option<Vec<u8>> {
        self.0.borrow().get(key).cloned()
    }

    fn put(&self, key: &ResultKey, bytes: Vec<u8>) {
        self.0.borrow_mut().insert(*key, bytes);
    }
}

/// A torus with bumps, as OBJ.
fn torus() -> String {
    let mut text = String::new();
    let angle = |number: usize, of: usize| TAU * number as f64 / of as f64;
    for i in 0..QUADS[0] {
        for j in 0..QUADS[1] {
            let (a, b) = (angle(i, QUADS[0]), angle(j, QUADS[1]));
            let tube = 0.4 * (1.0 + 0.1 * (9.0 * a).sin() * (7.0 * b).sin());
            let ring = 1.0 + tube * b.cos();
            let [x, y, z] = [ring * a.cos(), ring * a.sin(), tube * b.sin()];
            writeln!(text, "v {x:.6} {y:.6} {z:.6}").expect("a text");
        }
    }
    for i in 0..QUADS[0] {
        for j in 0..QUADS[1] {
            let corner = |i: usize, j: usize| (i % QUADS[0]) * QUADS[1] + j % QUADS[1] + 1;
            let [p, q] = [corner(i, j), corner(i + 1, j)];
            let [r, s] = [corner(i + 1, j + 1), corner(i, j + 1)];
            writeln!(text, "f {p} {q} {r}\nf {p} {r} {s}").expect("a text");
        }
    }
    text
}

/// Writes a scene; returns its path.
fn scene(folder: &Path, name: &str, manifold: &str, camera: &str, object: &str) -> PathBuf {
    let manifolds = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/manifolds");
    let text = format!(
        "manifold = '{manifolds}/{manifold}.toml'\n[camera]\n{camera}\nup = [0, 0, 1]\nfov = 90\n\
         [[object]]\nmesh = 'torus.obj'\n{object}\n"
    );
    let path = folder.join(format!("{name}.toml"));
    std::fs::write(&path, text).expect("a folder for files");
    path
}

fn start(criterion: &mut Criterion) {
    let folder = tempfile::tempdir().expect("a folder for files");
    let mesh = folder.path().join("torus.obj");
    std::fs::write(&mesh, torus()).expect("a folder for files");

    let mut group = criterion.benchmark_group("start");
    group.sample_size(10);
    group.bench_function("read", |b| b.iter(|| black_box(Mesh::load(&mesh))));
    let read = Mesh::load(&mesh).expect("the torus");
    let corners = |t: &[u32; 3]| t.map(|corner| read.positions[corner as usize]);
    let triangles: Vec<_> = read.triangles.iter().map(corners).collect();
    group.bench_function("tree", |b| {
        b.iter(|| black_box(Accelerator::build(&triangles)));
    });
    for (name, manifold, camera, object) in SCENES {
        let scene = scene(folder.path(), name, manifold, camera, object);
        group.bench_function(name, |b| {
            b.iter(|| black_box(Stage::load(&scene, &[]).expect("a scene")));
        });
        let store = Rc::new(Memory::default());
        group.bench_function(format!("{name}, again"), |b| {
            let load = || Stage::load(&scene, &[]).expect("a scene");
            b.iter(|| black_box(with_store(store.clone(), load)));
        });
    }
    group.finish();
}

criterion_group!(benches, start);
criterion_main!(benches);
