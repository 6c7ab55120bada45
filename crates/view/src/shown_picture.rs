//! The picture on the display, in linear light, and as the bytes of a screen.
//!
//! In: blocks of light as they are drawn, and an exposure in stops; or the light of blocks by path tracing, one sample of
//! each pixel after another. Out: [`Patch`]es in code values (8-bit sRGB with full opacity, the same as a PNG of the
//! render), and again with another exposure, without drawing anything again; for samples, the mean of all of a block so
//! far, in linear light, which begins anew with another state of the session. While a picture is not whole, the last
//! whole one lies beneath it.

use crate::{frame_plan::Block, protocol::Patch};
use geofan_render::picture::ToneTable;

/// Linear light of a picture, as far as it is drawn.
#[derive(Debug, Clone, Default)]
struct ShownLight {
    frame: u32,
    size: (usize, usize),
    rgb: Vec<f32>,
    done: Vec<Block>,
    whole: bool,
    /// Its colours stand for classes of errors: no exposure changes them.
    classes: bool,
}

/// The picture on the display.
#[derive(Debug, Default)]
pub struct ShownPicture {
    stops: f64,
    /// The last whole picture, and the one that is being drawn over it.
    base: ShownLight,
    current: ShownLight,
}

impl ShownPicture {
    /// Takes a block of frame `frame` of `size`; returns how it is shown. `last` tells that the frame is whole
    /// with it, `classes` that its colours stand for classes of errors.
    pub fn accept(
        &mut self,
        (frame, size): (u32, (usize, usize)),
        block: Block,
        rgb: &[f32],
        (last, classes): (bool, bool),
    ) -> Option<Patch> {
        if !block.is_within(size) || rgb.len() != 3 * block.width * block.height {
            return None;
        }
        if self.current.frame != frame || self.current.size != size {
            if self.current.whole {
                self.base = std::mem::take(&mut self.current);
            }
            self.current = ShownLight {
                frame,
                size,
                rgb: vec![0.0; 3 * size.0 * size.1],
                classes,
                ..ShownLight::default()
            };
        }
        let light = &mut self.current;
        for (y, values) in block.rows().zip(rgb.chunks_exact(3 * block.width)) {
            let start = 3 * (y * size.0 + block.x);
            light.rgb[start..start + values.len()].copy_from_slice(values);
        }
        light.done.push(block);
        light.whole = last;
        if last {
            // Nothing of it is to be seen any more.
            self.base = ShownLight::default();
        }
        Some(self.patch(&self.current, block, last))
    }

    /// Tells whether more than half of the last whole picture is black.
    pub fn is_dark(&self) -> bool {
        let rgb = self.current.rgb.as_chunks::<3>().0;
        let black = rgb.iter().filter(|rgb| **rgb == [0.0; 3]).count();
        self.current.whole && 2 * black > rgb.len()
    }

    /// Returns the exposure in stops.
    pub fn exposure(&self) -> f64 {
        self.stops
    }

    /// Changes the exposure; returns all that is shown again.
    pub fn expose(&mut self, stops: f64) -> Vec<Patch> {
        self.stops = stops;
        let mut patches = Vec::new();
        let layers = match self.current.whole {
            true => vec![&self.current],
            false => vec![&self.base, &self.current],
        };
        for light in layers {
            let count = light.done.len();
            let last = |i: usize| light.whole && i + 1 == count;
            let each = light.done.iter().enumerate();
            patches.extend(each.map(|(i, block)| self.patch(light, *block, last(i))));
        }
        patches
    }

    fn patch(&self, light: &ShownLight, block: Block, last: bool) -> Patch {
        let mut rgba = Vec::with_capacity(4 * block.width * block.height);
        let gain = match light.classes {
            true => 1.0,
            false => self.stops.exp2() as f32,
        };
        for y in block.rows() {
            let start = 3 * (y * light.size.0 + block.x);
            let row = &light.rgb[start..start + 3 * block.width];
            ToneTable::shared().append(row, gain, &mut rgba);
        }
        Patch {
            frame: light.frame,
            capture: false,
            size: light.size,
            block,
            last,
            pixels: rgba,
            light: false,
            classes: light.classes,
        }
    }

    /// Returns a block of a captured picture, which is not kept: as the screen shows it at an exposure in stops, or
    /// its linear light if there is none.
    pub fn captured(
        &self,
        (frame, size): (u32, (usize, usize)),
        block: Block,
        rgb: &[f32],
        (last, stops): (bool, Option<f64>),
    ) -> Patch {
        let mut pixels = Vec::new();
        match stops {
            None => pixels.extend(rgb.iter().flat_map(|x| x.to_le_bytes())),
            Some(stops) => ToneTable::shared().append(rgb, stops.exp2() as f32, &mut pixels),
        }
        Patch {
            frame,
            capture: true,
            size,
            block,
            last,
            pixels,
            light: stops.is_none(),
            classes: false,
        }
    }
}

/// Means of the samples of one picture.
#[derive(Debug, Clone, Default)]
pub struct LightPasses {
    /// The state of the session that they show, and the size of the picture.
    about: Option<(u64, (usize, usize))>,
    mean: Vec<f32>,
    passes: u32,
    /// Some of them are on the display.
    shown: bool,
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
        if !block.is_within(size)
            || block.width == 0
            || light.len() != 3 * block.width * block.height
        {
            return None;
        }
        if self.about != Some((revision, size)) {
            *self = Self {
                about: Some((revision, size)),
                mean: vec![0.0; 3 * size.0 * size.1],
                ..Self::default()
            };
        }
        let weight = 1.0 / (self.passes + 1) as f32;
        let mut means = Vec::with_capacity(light.len());
        for (y, values) in block.rows().zip(light.chunks_exact(3 * block.width)) {
            let start = 3 * (y * size.0 + block.x);
            let known = &mut self.mean[start..start + values.len()];
            for (mean, value) in known.iter_mut().zip(values) {
                *mean += weight * (value - *mean);
            }
            means.extend_from_slice(known);
        }
        Some(means)
    }

    /// Takes note that they are put on the display.
    pub fn show(&mut self) {
        self.shown = true;
    }

    /// Tells whether samples of this revision are on the display.
    pub fn are_shown(&self, revision: u64) -> bool {
        self.shown && self.about.is_some_and(|(of, _)| of == revision)
    }

    /// Returns the means, if they are on the display in this size and of this revision.
    pub fn shown_mean(&self, revision: u64, size: (usize, usize)) -> Option<&[f32]> {
        let shown = self.shown && self.about == Some((revision, size));
        shown.then_some(&self.mean)
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
    fn another_exposure_shows_all_that_is_known_without_new_light() {
        let block = |x| Block {
            x,
            y: 0,
            width: 2,
            height: 1,
        };
        let mut shown = ShownPicture::default();
        let light = [0.1; 6];
        assert!(
            shown
                .accept((1, (4, 1)), block(0), &light, (false, false))
                .is_some()
        );
        assert!(
            shown
                .accept((1, (4, 1)), block(2), &light, (true, false))
                .unwrap()
                .last
        );
        // A second picture has begun over the first.
        shown.accept((2, (4, 1)), block(2), &[0.2; 6], (false, false));
        let patches = shown.expose(1.0);
        let frames: Vec<_> = patches
            .iter()
            .map(|p| (p.frame, p.block.x, p.last))
            .collect();
        // The second is not whole, whatever its exposure.
        assert_eq!(frames, [(1, 0, false), (1, 2, true), (2, 2, false)]);
        assert_eq!(patches[0].pixels[0], ToneTable::shared().byte(0.2));
        // Colours of classes stay those of the legend.
        shown.accept((3, (2, 1)), block(0), &light, (true, true));
        let classes = shown.expose(3.0).pop().unwrap();
        assert!(classes.classes);
        assert_eq!(classes.pixels[0], ToneTable::shared().byte(0.1));
    }

    #[test]
    fn blocks_that_do_not_fit_are_refused() {
        let mut shown = ShownPicture::default();
        let block = Block {
            x: 3,
            y: 0,
            width: 2,
            height: 1,
        };
        assert!(
            shown
                .accept((1, (4, 1)), block, &[0.0; 6], (true, false))
                .is_none()
        );
        let block = Block {
            x: 0,
            y: 0,
            width: 2,
            height: 1,
        };
        assert!(
            shown
                .accept((1, (4, 1)), block, &[0.0; 5], (true, false))
                .is_none()
        );
    }

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
