//! Passes over a picture: those of all its parts, eyes or faces of a cube, and sums over them.
//!
//! In: a world and the parts of a picture. Out: passes over all of it, and the layers of what its cameras' rays meet
//! first ([`PanelTracers`]).
//!
//! In: passes, in order. Out: mean radiance of every pixel, and the variance of that mean ([`PassAccumulator`]).
//!
//! In: a [`PassAccumulator`]. Out: a file, a checkpoint from which the accumulation goes on. Little-endian: the magic, a key
//! (32 bytes) of everything that decides the passes, width, height and number of passes (8 bytes each), six f64 a
//! pixel (sums of radiance and of its squares, red, green, blue), and a checksum (XXH3, 8 bytes) of all before.

use super::{PathTracer, PathTracerSettings};
use geofan_render::{
    ExactTracer, PicturePanel, PicturePanels, World,
    frame::{Paths, offsets, trace},
    picture::Picture,
    shade::with_layers,
};
use glam::DVec3;
use ndarray::{Array2, Array3};

/// One tracer for each part of a picture.
pub struct PanelTracers<'a> {
    world: &'a World,
    panels: &'a PicturePanels,
    settings: PathTracerSettings,
    tracers: Vec<PathTracer<'a>>,
}

impl<'a> PanelTracers<'a> {
    /// Prepares the tracers of all parts.
    pub fn new(world: &'a World, panels: &'a PicturePanels, settings: PathTracerSettings) -> Self {
        let first = panels.parts.first();
        let first = first.map(|panel| PathTracer::new(world, &panel.view, settings));
        let parts = first.iter().flat_map(|first| {
            let part = |panel: &'a PicturePanel| first.through(&panel.view, panel.number);
            panels.parts.iter().map(part)
        });
        let tracers = parts.collect();
        Self {
            world,
            panels,
            settings,
            tracers,
        }
    }

    /// Returns the number of geodesics followed so far.
    pub fn rays(&self) -> u64 {
        self.tracers.first().map_or(0, PathTracer::rays)
    }

    /// Returns the share of rays from surfaces, so far, that ended by their length.
    pub fn cut_short(&self) -> f64 {
        self.tracers.first().map_or(0.0, PathTracer::cut_short)
    }

    /// Renders one sample of every pixel of the whole picture as radiance; `None` if `stop` said so.
    pub fn pass(&self, number: u64, stop: impl Fn() -> bool + Sync) -> Option<Vec<DVec3>> {
        let (width, height) = self.panels.size;
        let mut all = vec![DVec3::ZERO; width * height];
        for (tracer, PicturePanel { view, at, .. }) in self.tracers.iter().zip(&self.panels.parts) {
            let light = tracer.pass(number, &stop)?;
            for (row, line) in light.chunks_exact(view.size.0).enumerate() {
                let start = (at.1 + row) * width + at.0;
                all[start..start + line.len()].copy_from_slice(line);
            }
        }
        Some(all)
    }

    /// Adds the layers of what the cameras' rays meet first to a picture of all parts; its own layers, such as its
    /// variance, come first.
    pub fn layered(&self, picture: Picture) -> Picture {
        let PathTracerSettings {
            length, tolerance, ..
        } = self.settings;
        let layered = |(number, PicturePanel { view, .. }): (usize, &PicturePanel)| {
            let tracer = ExactTracer::new(&self.world.manifold, view.u, length, tolerance);
            let traced = trace(self.world, view, Paths::Exact(&tracer), &offsets(1));
            let part = self.panels.cut(&picture, number);
            with_layers(part, self.world, view, (&traced.outcomes, &[]), tolerance)
        };
        let parts = self.panels.parts.iter().enumerate().map(layered).collect();
        let mut whole = self.panels.join(parts);
        whole.layers.splice(0..0, picture.layers);
        whole
    }
}

/// Accumulates passes.
#[derive(Debug, Clone, PartialEq)]
pub struct PassAccumulator {
    pub(super) size: (usize, usize),
    /// Sum of radiance and of its squares of each pixel, row by row.
    pub(super) sums: Vec<[DVec3; 2]>,
    pub(super) passes: u64,
}

impl PassAccumulator {
    /// Begins without passes, of a width and height.
    pub fn new(size: (usize, usize)) -> Self {
        Self {
            size,
            sums: vec![[DVec3::ZERO; 2]; size.0 * size.1],
            passes: 0,
        }
    }

    /// Returns the number of passes taken.
    pub fn passes(&self) -> u64 {
        self.passes
    }

    /// Adds the next pass.
    pub fn add(&mut self, pass: &[DVec3]) {
        for (sums, light) in self.sums.iter_mut().zip(pass) {
            sums[0] += *light;
            sums[1] += *light * *light;
        }
        self.passes += 1;
    }

    /// Returns the mean radiance of a pixel, and the variance of that mean (infinite after a single pass).
    pub fn pixel(&self, x: usize, y: usize) -> (DVec3, DVec3) {
        let [sum, squares] = self.sums[y * self.size.0 + x];
        let n = self.passes.max(1) as f64;
        let mean = sum / n;
        let spread = (squares / n - mean * mean).max(DVec3::ZERO);
        let variance = match self.passes {
            0 | 1 => DVec3::INFINITY,
            _ => spread / (n - 1.0),
        };
        (mean, variance)
    }

    /// Returns the picture of the means, with layers `variance.R`, `variance.G`, `variance.B` of their variance.
    pub fn picture(&self) -> Picture {
        let (width, height) = self.size;
        let mean = |(y, x, k): (usize, usize, usize)| self.pixel(x, y).0[k] as f32;
        let picture = Picture::new(Array3::from_shape_fn((height, width, 3), mean));
        ["R", "G", "B"]
            .into_iter()
            .enumerate()
            .fold(picture, |picture, (k, name)| {
                let variance = |(y, x): (usize, usize)| self.pixel(x, y).1[k] as f32;
                picture.with_float(
                    format!("variance.{name}"),
                    Array2::from_shape_fn((height, width), variance),
                )
            })
    }
}

/// Keeps sums over passes in a file.
#[cfg(feature = "files")]
mod checkpoint {
    use super::PassAccumulator;
    use geofan_core::{
        error::{Error, Result},
        files::write_atomically,
        reading::read_file,
    };
    use glam::DVec3;
    use std::{io::Write, path::Path};
    use xxhash_rust::xxh3::xxh3_64;

    const MAGIC: &[u8; 16] = b"geofan passes1\r\n";
    const HEAD: usize = 16 + 32 + 24;

    impl PassAccumulator {
        /// Writes the checkpoint; `key` is everything that decides the passes.
        ///
        /// # Errors
        /// The file cannot be written.
        pub fn save(&self, path: &Path, key: &[u8; 32]) -> Result<()> {
            let mut bytes = MAGIC.to_vec();
            bytes.extend_from_slice(key);
            let head = [self.size.0 as u64, self.size.1 as u64, self.passes];
            bytes.extend(head.iter().flat_map(|n| n.to_le_bytes()));
            let numbers = self.sums.iter().flatten().flat_map(|v| v.to_array());
            bytes.extend(numbers.flat_map(f64::to_le_bytes));
            bytes.extend(xxh3_64(&bytes).to_le_bytes());
            write_atomically(path, |out| out.write_all(&bytes))
        }

        /// Reads the checkpoint of [`PassAccumulator::save`].
        ///
        /// # Errors
        /// It cannot be read, is damaged, or belongs to another picture.
        pub fn load(path: &Path, key: &[u8; 32], size: (usize, usize)) -> Result<Self> {
            let bytes = read_file(path, MAGIC, u64::MAX)?;
            let complain = |message: &str| Error::input(path.display().to_string(), message);
            let damaged = || complain("is damaged; remove it and start again");
            let (body, sum) = bytes.split_last_chunk::<8>().ok_or_else(damaged)?;
            let whole = u64::from_le_bytes(*sum) == xxh3_64(body) && body.starts_with(MAGIC);
            if !whole || body.len() < HEAD {
                return Err(damaged());
            }
            let word = |at: usize| -> [u8; 8] { std::array::from_fn(|i| body[at + i]) };
            let number = |at: usize| u64::from_le_bytes(word(at));
            if body[16..48] != key[..] || (number(48), number(56)) != (size.0 as u64, size.1 as u64)
            {
                return Err(complain(
                    "was begun for another picture: the scene, the camera, --size, --seed, --bounces, --length or --tolerance differ; give that one's, or leave out --resume, which begins anew",
                ));
            }
            if (body.len() - HEAD) as u64 != 48 * (size.0 * size.1) as u64 {
                return Err(damaged());
            }
            let vector =
                |at: usize| DVec3::from_array([0, 8, 16].map(|k| f64::from_le_bytes(word(at + k))));
            let pixel = |i: usize| [vector(HEAD + 48 * i), vector(HEAD + 48 * i + 24)];
            Ok(Self {
                size,
                sums: (0..size.0 * size.1).map(pixel).collect(),
                passes: number(64),
            })
        }
    }

    #[cfg(test)]
    mod tests {
        use super::super::tests::sums;
        use super::*;

        #[test]
        fn a_checkpoint_comes_back_and_no_other_or_damaged_one_does() {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("a.passes");
            sums().save(&path, &[1; 32]).unwrap();
            assert_eq!(
                PassAccumulator::load(&path, &[1; 32], (2, 1)).unwrap(),
                sums()
            );
            assert_eq!(
                PassAccumulator::load(&path, &[2; 32], (2, 1))
                    .unwrap_err()
                    .exit_code(),
                2
            );
            assert!(PassAccumulator::load(&path, &[1; 32], (1, 2)).is_err());
            let bytes = std::fs::read(&path).unwrap();
            for i in 0..bytes.len() {
                let mut damaged = bytes.clone();
                damaged[i] ^= 16;
                std::fs::write(&path, &damaged).unwrap();
                assert!(PassAccumulator::load(&path, &[1; 32], (2, 1)).is_err());
            }
            for length in 0..bytes.len() {
                std::fs::write(&path, &bytes[..length]).unwrap();
                assert!(PassAccumulator::load(&path, &[1; 32], (2, 1)).is_err());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(in crate::path_tracer) fn sums() -> PassAccumulator {
        let mut sums = PassAccumulator::new((2, 1));
        sums.add(&[DVec3::new(1.0, 2.0, 3.0), DVec3::ZERO]);
        sums.add(&[DVec3::new(3.0, 2.0, 1.0), DVec3::ONE]);
        sums
    }

    #[test]
    fn means_and_their_variance_are_those_of_the_passes() {
        let (mean, variance) = sums().pixel(0, 0);
        assert_eq!(mean, DVec3::splat(2.0));
        // Sample variance 2 over two samples.
        assert_eq!(variance, DVec3::new(1.0, 0.0, 1.0));
    }
}
