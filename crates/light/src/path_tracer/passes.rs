//! Sums over passes, their picture and variance.
//!
//! In: passes, in order. Out: mean radiance of every pixel, and the variance of that mean.

use geofan_render::picture::Picture;
use glam::DVec3;
use ndarray::{Array2, Array3};

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

#[cfg(test)]
pub(super) mod tests {
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
