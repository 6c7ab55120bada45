//! Means of random samples, block by block.
//!
//! In: the light of blocks by path tracing, one sample of each pixel after another. Out: the mean of all samples of a
//! block so far, in linear light. Samples of another state of the session begin anew.

use crate::frame_plan::Block;

/// Means of the samples of one picture.
#[derive(Debug, Clone, Default)]
pub struct LightPasses {
    /// The state of the session that they show, and the size of the picture.
    about: Option<(u64, (usize, usize))>,
    mean: Vec<f32>,
    passes: u32,
}

impl LightPasses {
    /// Returns the number of samples of each pixel of the picture of this revision and size.
    pub fn count(&self, revision: u64, size: (usize, usize)) -> u32 {
        match self.about {
            Some(about) if about == (revision, size) => self.passes,
            _ => 0,
        }
    }

    /// Takes the light of a block of the next sample, three numbers a pixel, and returns the mean with it; `None` if it
    /// does not fit.
    pub fn add(
        &mut self,
        (revision, size): (u64, (usize, usize)),
        block: Block,
        light: &[f32],
    ) -> Option<Vec<f32>> {
        let inside = block.x + block.width <= size.0 && block.y + block.height <= size.1;
        if !inside || block.width == 0 || light.len() != 3 * block.width * block.height {
            return None;
        }
        if self.about != Some((revision, size)) {
            *self = Self {
                about: Some((revision, size)),
                mean: vec![0.0; 3 * size.0 * size.1],
                passes: 0,
            };
        }
        let weight = 1.0 / (self.passes + 1) as f32;
        let mut means = Vec::with_capacity(light.len());
        for (row, values) in light.chunks_exact(3 * block.width).enumerate() {
            let start = 3 * ((block.y + row) * size.0 + block.x);
            let known = &mut self.mean[start..start + values.len()];
            for (mean, value) in known.iter_mut().zip(values) {
                *mean += weight * (value - *mean);
            }
            means.extend_from_slice(known);
        }
        Some(means)
    }

    /// Takes note that the sample has come back for all pixels.
    pub fn finish(&mut self) {
        self.passes += 1;
    }

    /// Forgets all samples.
    pub fn forget(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_are_those_of_all_samples_and_another_picture_begins_anew() {
        let block = |x| Block {
            x,
            y: 0,
            width: 1,
            height: 1,
        };
        let mut passes = LightPasses::default();
        let about = (7, (2, 1));
        for light in [1.0, 2.0, 6.0] {
            passes.add(about, block(0), &[light; 3]).unwrap();
            let mean = passes.add(about, block(1), &[2.0 * light; 3]).unwrap();
            passes.finish();
            if light == 6.0 {
                assert_eq!(mean, [6.0; 3]);
            }
        }
        assert_eq!(passes.count(7, (2, 1)), 3);
        assert_eq!((passes.count(8, (2, 1)), passes.count(7, (1, 1))), (0, 0));
        assert!(passes.add(about, block(2), &[0.0; 3]).is_none());
        assert!(passes.add(about, block(0), &[0.0; 2]).is_none());
        let mean = passes.add((8, (2, 1)), block(0), &[0.5; 3]).unwrap();
        assert_eq!(mean, [0.5; 3]);
        assert_eq!(passes.count(8, (2, 1)), 0);
    }
}
