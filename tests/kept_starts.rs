//! Scenes with large meshes that start again: what was kept is taken, as long as all is the same, and the scene is the one
//! that it was.

use geofan_core::keeping::{ResultKey, ResultStore, with_store};
use geofan_render::Stage;
use std::{
    cell::{Cell, RefCell},
    collections::BTreeMap,
    fmt::Write,
    path::Path,
    rc::Rc,
};

/// Squares along each side of the sheet.
const SQUARES: usize = 170;

/// Keeps results in memory, and counts those that were found and those that were put.
#[derive(Default)]
struct Memory {
    results: RefCell<BTreeMap<ResultKey, Vec<u8>>>,
    found: Cell<usize>,
    put: Cell<usize>,
}

impl ResultStore for Memory {
    fn get(&self, key: &ResultKey) -> Option<Vec<u8>> {
        let result = self.results.borrow().get(key).cloned();
        self.found
            .set(self.found.get() + usize::from(result.is_some()));
        result
    }

    fn put(&self, key: &ResultKey, bytes: Vec<u8>) {
        self.put.set(self.put.get() + 1);
        self.results.borrow_mut().insert(*key, bytes);
    }
}

/// A wavy sheet of two triangles a square, of two materials.
fn sheet() -> String {
    let mut text = String::from("mtllib sheet.mtl\n");
    let place = |k: usize| k as f64 / SQUARES as f64 - 0.5;
    for i in 0..=SQUARES {
        for j in 0..=SQUARES {
            let (x, y) = (place(i), place(j));
            let z = 0.1 * (9.0 * x).sin() * (7.0 * y).cos();
            writeln!(text, "v {x:.6} {y:.6} {z:.6}\nvt {x:.6} {y:.6}").unwrap();
        }
    }
    for i in 0..SQUARES {
        if i % (SQUARES / 2) == 0 {
            let material = if i == 0 { "plain" } else { "painted" };
            writeln!(text, "usemtl {material}").unwrap();
        }
        for j in 0..SQUARES {
            let corner = |i: usize, j: usize| i * (SQUARES + 1) + j + 1;
            let [p, q] = [corner(i, j), corner(i + 1, j)];
            let [r, s] = [corner(i + 1, j + 1), corner(i, j + 1)];
            writeln!(text, "f {p}/{p} {q}/{q} {r}/{r}\nf {p}/{p} {r}/{r} {s}/{s}").unwrap();
        }
    }
    text
}

fn write(folder: &Path, name: &str, text: &str) {
    std::fs::write(folder.join(name), text).unwrap();
}

/// Writes the scene with the sheet at `at` and a material of this colour.
fn write_scene(folder: &Path, at: &str, kd: &str) {
    let picture = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/meshes/card.png");
    write(
        folder,
        "sheet.mtl",
        &format!("newmtl plain\nKd {kd}\nnewmtl painted\nKd 1 1 1\nmap_Kd {picture}\n"),
    );
    let space = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/manifolds/s3.toml");
    let scene = format!(
        "manifold = '{space}'\n[camera]\nat = [-0.6, 0, 0]\nlook = [1, 0, 0]\nup = [0, 0, 1]\nfov = 90\n\
         [[object]]\nmesh = 'sheet.obj'\nat = {at}\nplacement = 'exponential'\n"
    );
    write(folder, "scene.toml", &scene);
}

/// Starts the scene; returns all that shows of it, and how many results were found and put.
fn start(folder: &Path, store: &Rc<Memory>) -> (String, usize, usize) {
    let (found, put) = (store.found.take(), store.put.take());
    assert_eq!((found, put), (0, 0), "counted elsewhere");
    let load = || Stage::load(&folder.join("scene.toml"), &[]).unwrap();
    let world = with_store(store.clone(), load).world;
    let shows = format!(
        "{:?} {:?} {:?} {:?}",
        world.geometry_fingerprint(),
        world.materials,
        world.faces.iter().map(|face| face.material).sum::<u32>(),
        world.warnings,
    );
    (shows, store.found.take(), store.put.take())
}

#[test]
fn a_scene_that_starts_again_is_the_same_and_takes_what_was_kept() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path();
    let store = Rc::new(Memory::default());
    write(folder, "sheet.obj", &sheet());
    write_scene(folder, "[0, 0, 0]", "0.5 0.25 0.125");
    // The mesh, where its vertices are, and its tree.
    let (first, found, put) = start(folder, &store);
    assert_eq!((found, put), (0, 3));
    assert_eq!(start(folder, &store), (first.clone(), 3, 0));
    // Elsewhere: another placement and tree, and the first ones again.
    write_scene(folder, "[0.1, 0, 0]", "0.5 0.25 0.125");
    let (elsewhere, found, put) = start(folder, &store);
    assert_eq!((found, put), (1, 2));
    assert_ne!(elsewhere, first);
    write_scene(folder, "[0, 0, 0]", "0.5 0.25 0.125");
    assert_eq!(start(folder, &store), (first.clone(), 3, 0));
    // Another colour: found, but of a file that has changed.
    write_scene(folder, "[0, 0, 0]", "0.5 0.25 0.75");
    let (coloured, found, put) = start(folder, &store);
    assert_eq!((found, put), (3, 1));
    assert_ne!(coloured, first);
    assert!(coloured.contains("0.75"));
    // A library that is gone, and is there again.
    std::fs::remove_file(folder.join("sheet.mtl")).unwrap();
    assert!(start(folder, &store).0.contains("is not defined"));
    write_scene(folder, "[0, 0, 0]", "0.5 0.25 0.125");
    assert_eq!(start(folder, &store).0, first);
}

/// A mesh is cut off where no path gets to.
#[test]
fn a_placement_is_made_again_for_longer_paths() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path();
    let store = Rc::new(Memory::default());
    write(folder, "sheet.obj", &sheet());
    write_scene(folder, "[0, 0, 0]", "0.5 0.25 0.125");
    let space = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/manifolds/s3.toml");
    let scene = std::fs::read_to_string(folder.join("scene.toml")).unwrap();
    let scene = scene.replace(space, "space.toml");
    write(folder, "scene.toml", &scene);
    let text = std::fs::read_to_string(space).unwrap();
    let with_length = |length: &str| {
        let line = text
            .lines()
            .find(|line| line.starts_with("length"))
            .unwrap();
        write(
            folder,
            "space.toml",
            &text.replace(line, &format!("length = {length}")),
        );
        start(folder, &store)
    };
    let (short, ..) = with_length("0.1");
    let (long, found, _) = with_length("3");
    assert_eq!(found, 1, "the mesh itself");
    assert_ne!(short, long);
    let (again, _, put) = with_length("0.1");
    assert_eq!((again, put), (short, 0));
}

#[test]
fn results_that_are_something_else_are_made_again() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path();
    let store = Rc::new(Memory::default());
    write(folder, "sheet.obj", &sheet());
    write_scene(folder, "[0, 0, 0]", "0.5 0.25 0.125");
    let first = start(folder, &store).0;
    let results = store.results.borrow().clone();
    for (length, byte) in [(0, 0), (7, 0), (90, 0), (50_000, 0xff), (1 << 20, 0xff)] {
        for (key, result) in &results {
            let mut other = result.clone();
            other.truncate(length.max(1).min(result.len() - 1));
            other.fill(byte);
            store.results.borrow_mut().insert(*key, other);
        }
        assert_eq!(start(folder, &store), (first.clone(), 3, 3), "{length}");
    }
}
