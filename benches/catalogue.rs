//! Rays per second of every manifold of the catalogue, on one thread.
//!
//! `cargo bench --bench catalogue` prints a table: thousands of rays a second at a tolerance of 1e-6
//! and 1e-8, without and with the transported frame and the area. Rays start where the file's cameras
//! are and end at its exits or after its length. Without `--bench` it only runs a few rays of each.

use geofan_core::{
    geodesic::{Ray, Settings, ends},
    manifold::{Carried, Manifold},
    random::Stream,
};
use glam::DVec3;
use std::{hint::black_box, path::PathBuf, time::Instant};

/// Rays of one measurement, and how often it is repeated: the best counts.
const RAYS: usize = 2048;
const REPEATS: usize = 5;

/// Length of the paths where a file gives none.
const LENGTH: f64 = 10.0;

fn main() {
    let measuring = std::env::args().any(|a| a == "--bench");
    let (rays, repeats) = if measuring { (RAYS, REPEATS) } else { (8, 1) };
    println!("thousand rays a second, one thread");
    println!(
        "{:24}{:>12}{:>14}{:>12}{:>14}",
        "", "1e-6", "frame, area", "1e-8", "frame, area"
    );
    for file in files() {
        let manifold = Manifold::load(&file, &[]).unwrap_or_else(|e| panic!("{}", e.report(false)));
        let rays = random_rays(&manifold, rays);
        let rate = |tolerance: f64, all: bool| {
            let seconds = (0..repeats).map(|_| seconds(&manifold, tolerance, all, &rays));
            rays.len() as f64 / seconds.fold(f64::INFINITY, f64::min) / 1e3
        };
        let name = file.file_stem().unwrap_or_default().to_string_lossy();
        println!(
            "{name:24}{:>12.0}{:>14.0}{:>12.0}{:>14.0}",
            rate(1e-6, false),
            rate(1e-6, true),
            rate(1e-8, false),
            rate(1e-8, true)
        );
    }
}

fn files() -> Vec<PathBuf> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/manifolds");
    let entries = std::fs::read_dir(folder).expect("the catalogue is there");
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let mut files: Vec<PathBuf> = paths
        .filter(|path| path.extension().is_some_and(|e| e == "toml"))
        .collect();
    files.sort();
    files
}

/// Rays from random cameras of the region, in random directions.
fn random_rays(manifold: &Manifold, count: usize) -> Vec<Ray> {
    let mut random = Stream::new(&[3]);
    let length = manifold.length.unwrap_or(LENGTH);
    let mut ray = |_| {
        let u = match &manifold.cameras {
            Some(region) => {
                let shares = [0; 3].map(|_| random.uniform());
                region.at(&region.lerp(&shares[..region.dimension()]))
            }
            None => DVec3::ZERO,
        };
        Ray::new(manifold, u, random.direction(), length)
    };
    (0..count).map(&mut ray).collect()
}

/// How long the rays take, `all` with frame and area.
fn seconds(manifold: &Manifold, tolerance: f64, all: bool, rays: &[Ray]) -> f64 {
    let settings = Settings {
        tolerance,
        carried: Carried {
            frame: all,
            deviation: all,
        },
        events: true,
    };
    let start = Instant::now();
    black_box(ends(manifold, settings, rays.iter().copied()));
    start.elapsed().as_secs_f64()
}
