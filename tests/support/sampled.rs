//! A Gaussian lens by samples of `log n`, `n = exp(exp(−r²/2)/2)`, on the cube [−4, 4]³.

use geofan_core::{diagnostic::SourceText, manifold::Manifold};
use glam::DVec3;
use std::{fs, path::Path};

/// A field's section with a file of samples beside the manifold.
pub struct Sampled {
    pub folder: tempfile::TempDir,
}

/// `log n` at a point, of a lens of this width.
pub fn log_index(u: DVec3, width: f64) -> f64 {
    // A Gaussian smoothed by another keeps its integral.
    let strength = 0.5 * (1.0 / (1.0 + width * width)).powf(1.5);
    strength * (-u.length_squared() / (2.0 * (1.0 + width * width))).exp()
}

/// Writes an array of numpy.
pub fn write_npy(path: &Path, shape: [usize; 3], values: &[f32]) {
    let [x, y, z] = shape;
    let head = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({x}, {y}, {z}), }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((head.len() as u16).to_le_bytes());
    bytes.extend(head.as_bytes());
    bytes.extend(values.iter().flat_map(|x| x.to_le_bytes()));
    fs::write(path, bytes).unwrap();
}

/// `n` samples an axis of `f` over [−4, 4]³.
pub fn cube(n: usize, f: impl Fn(DVec3) -> f64) -> Vec<f32> {
    let place = |i: usize| -4.0 + 8.0 * i as f64 / (n - 1) as f64;
    let mut values = Vec::new();
    for x in 0..n {
        for y in 0..n {
            let at = |z| DVec3::new(place(x), place(y), place(z));
            values.extend((0..n).map(|z| f(at(z)) as f32));
        }
    }
    values
}

impl Sampled {
    pub fn new(n: usize, f: impl Fn(DVec3) -> f64) -> Self {
        let folder = tempfile::tempdir().unwrap();
        write_npy(&folder.path().join("logn.npy"), [n; 3], &cube(n, f));
        Self { folder }
    }

    pub fn text(section: &str, rest: &str) -> String {
        format!(
            "name = \"sampled\"\ncoordinates = [\"x\", \"y\", \"z\"]\n{rest}\n[field.logn]\nfile = \"logn.npy\"\n{section}\n"
        )
    }

    /// Loads a manifold that has this in the field's section and the rest of the file.
    pub fn load(&self, section: &str, rest: &str) -> Result<Manifold, String> {
        let name = self.folder.path().join("m.toml").display().to_string();
        let source = SourceText::new(name, Self::text(section, rest));
        Manifold::from_source(source, &[]).map_err(|e| e.report(false))
    }

    pub fn manifold(&self, section: &str, rest: &str) -> Manifold {
        self.load(section, rest).unwrap_or_else(|e| panic!("{e}"))
    }
}

pub const BOX: &str = "box = { x = [-4, 4], y = [-4, 4], z = [-4, 4] }";
pub const LENS: &str = "metric = { conformal = \"exp(logn(x, y, z))\" }";
