//! Makes `assets/fields/road.npy`: the refractive index of the air over a hot road, as a measurement on a grid
//! would give it. The manifold `assets/manifolds/road-mirage.toml` reads it.
//!
//! The logarithm of the index, much exaggerated: hot air lies on the road, thins out upwards, wavers along
//! the road, and every sample has an error of up to 3e-5. Equal on every machine.
//!
//! ```sh
//! cargo run --release --example make_mirage
//! ```

use geofan_core::random::Stream;
use geofan_expr::real::Real;
use std::{fs, io, path::Path};

/// Samples across the road, along it, and upwards.
const SHAPE: [usize; 3] = [17, 25, 41];

/// Places of the first and the last samples.
const LIMITS: [[f64; 2]; 3] = [[-4.0, 4.0], [-8.0, 8.0], [-0.5, 1.5]];

/// By how much the logarithm of the index is less on the road.
const DEPTH: f64 = 0.01;

/// Height up to which the air is hot, and over which it cools down.
const HEIGHT: f64 = 0.12;
const EDGE: f64 = 0.06;

/// Half the width of the hot strip.
const WIDTH: f64 = 1.8;

/// Largest error of a sample.
const NOISE: f64 = 3e-5;

fn log_index(x: f64, y: f64, z: f64) -> f64 {
    let waver = 0.03 * Real::sin(1.3 * y + 0.7 * x) + 0.02 * Real::sin(2.1 * y - 1.1 * x + 0.4);
    let hot = 1.0 / (1.0 + Real::exp((z - HEIGHT - waver) / EDGE));
    let strip = Real::exp(-(x / WIDTH).powi(4));
    -DEPTH * hot * strip
}

/// Returns an array of numpy with the axes x, y, z.
fn npy(values: &[f32]) -> Vec<u8> {
    let [x, y, z] = SHAPE;
    let mut head =
        format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({x}, {y}, {z}), }}");
    // The data begin at a multiple of 64 bytes.
    while (10 + head.len() + 1) % 64 != 0 {
        head.push(' ');
    }
    head.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((head.len() as u16).to_le_bytes());
    bytes.extend(head.as_bytes());
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

fn main() -> io::Result<()> {
    let place = |k: usize, i: usize| {
        let [low, high] = LIMITS[k];
        low + (high - low) * i as f64 / (SHAPE[k] - 1) as f64
    };
    let mut stream = Stream::new(&[1]);
    let mut values = Vec::new();
    for i in 0..SHAPE[0] {
        for j in 0..SHAPE[1] {
            for k in 0..SHAPE[2] {
                let true_value = log_index(place(0, i), place(1, j), place(2, k));
                values.push((true_value + stream.between(-NOISE, NOISE)) as f32);
            }
        }
    }
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/fields");
    fs::create_dir_all(&folder)?;
    fs::write(folder.join("road.npy"), npy(&values))
}
