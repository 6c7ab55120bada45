//! Rays per second of the library: exact ones, and those looked up in a table.
//!
//! `cargo run --release --example rates -- MANIFOLD BUNDLE A,B,C` prints JSON. Rays leave the chart point A,B,C in
//! directions spread evenly over the sphere. `python/tests/throughput.py` holds the Python package against it.

use geofan::{
    bundle::Bundle,
    geodesic::{Ray, Sample, Settings, paths, sample},
    manifold::{Carried, Manifold},
};
use glam::DVec3;
use rayon::prelude::*;
use std::{f64::consts::PI, hint::black_box, path::Path, time::Instant};

/// Rays followed exactly, and looked up.
const EXACT: usize = 100_000;
const TABLE: usize = 1_000_000;

/// Rays that a thread follows together.
const BLOCK: usize = 256;

/// Repetitions; the fastest counts.
const REPEATS: usize = 3;

/// Spreads directions evenly, along a spiral of the golden angle.
fn directions(count: usize) -> Vec<DVec3> {
    let golden = PI * (3.0 - 5.0_f64.sqrt());
    let direction = |i: usize| {
        let z = 1.0 - (2 * i + 1) as f64 / count as f64;
        let (sin, cos) = (golden * i as f64).sin_cos();
        let r = (1.0 - z * z).sqrt();
        DVec3::new(r * cos, r * sin, z)
    };
    (0..count).map(direction).collect()
}

/// Follows all rays exactly, with frames and areas, and samples both their ends.
fn exact(manifold: &Manifold, at: DVec3, directions: &[DVec3], length: f64) -> Vec<Vec<Sample>> {
    let carried = Carried {
        frame: true,
        deviation: true,
    };
    let settings = Settings {
        tolerance: 1e-8,
        carried,
        events: true,
    };
    let block = |directions: &[DVec3]| {
        let rays = directions
            .iter()
            .map(|d| Ray::new(manifold, at, *d, length));
        let rays: Vec<Ray> = rays.collect();
        let paths = paths(manifold, settings, rays.iter().copied());
        let both = rays.iter().zip(&paths);
        both.map(|(ray, path)| {
            [0.0, path.length]
                .map(|s| sample(manifold, ray, path, s))
                .into()
        })
        .collect::<Vec<_>>()
    };
    directions.par_chunks(BLOCK).flat_map_iter(block).collect()
}

/// Measures rays per second.
fn rate<T>(rays: usize, work: impl Fn() -> T) -> f64 {
    let once = |_| {
        let began = Instant::now();
        black_box(work());
        rays as f64 / began.elapsed().as_secs_f64()
    };
    (0..REPEATS).map(once).fold(0.0, f64::max)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [manifold, bundle, at] = arguments.as_slice() else {
        return Err("usage: rates MANIFOLD BUNDLE A,B,C".into());
    };
    let numbers: Vec<f64> = at.split(',').map(str::parse).collect::<Result<_, _>>()?;
    let at = DVec3::from_slice(&numbers);
    let manifold = Manifold::load(Path::new(manifold), &[])?;
    let bundle = Bundle::read(Path::new(bundle))?;
    let length = bundle.table.length;
    let few = directions(EXACT);
    let exact = rate(EXACT, || exact(&manifold, at, &few, length));
    let many = directions(TABLE);
    let s: Vec<f64> = (0..4).map(|i| length * f64::from(i) / 3.0).collect();
    let table = rate(TABLE, || {
        let fan = bundle.fan(at).expect("the camera is in the table's region");
        let path = |d: &DVec3| fan.path(*d).sample(&s);
        many.par_iter().map(path).collect::<Vec<_>>()
    });
    println!(r#"{{"exact": {exact}, "table": {table}}}"#);
    Ok(())
}
