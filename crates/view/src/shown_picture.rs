//! The picture on the display, in linear light.
//!
//! In: blocks of light as they are drawn. Out: [`Patch`]es in code values; and again with another exposure,
//! without drawing anything again. While a picture is not whole, the last whole one lies beneath it.

use crate::{frame_plan::Block, protocol::Patch, tone::ToneTable};

/// Linear light of a picture, as far as it is drawn.
#[derive(Debug, Clone, Default)]
struct ShownLight {
    frame: u32,
    size: (usize, usize),
    rgb: Vec<f32>,
    done: Vec<Block>,
    whole: bool,
}

/// The picture on the display.
#[derive(Debug, Default)]
pub struct ShownPicture {
    table: ToneTable,
    stops: f64,
    /// The last whole picture, and the one that is being drawn over it.
    base: ShownLight,
    current: ShownLight,
}

impl ShownPicture {
    /// Takes a block of frame `frame` of `size`; returns how it is shown. `last` tells that the frame is whole
    /// with it.
    pub fn accept(
        &mut self,
        (frame, size): (u32, (usize, usize)),
        block: Block,
        rgb: &[f32],
        last: bool,
    ) -> Option<Patch> {
        let inside = block.x + block.width <= size.0 && block.y + block.height <= size.1;
        if !inside || rgb.len() != 3 * block.width * block.height {
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
                ..ShownLight::default()
            };
        }
        let light = &mut self.current;
        for (row, values) in rgb.chunks_exact(3 * block.width).enumerate() {
            let start = 3 * ((block.y + row) * size.0 + block.x);
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
            let each = light.done.iter().enumerate();
            patches.extend(each.map(|(i, block)| self.patch(light, *block, i + 1 == count)));
        }
        patches
    }

    fn patch(&self, light: &ShownLight, block: Block, last: bool) -> Patch {
        let mut rgba = Vec::new();
        let gain = self.stops.exp2() as f32;
        for y in block.y..block.y + block.height {
            let start = 3 * (y * light.size.0 + block.x);
            let row = &light.rgb[start..start + 3 * block.width];
            self.table.append(row, gain, &mut rgba);
        }
        Patch {
            frame: light.frame,
            capture: false,
            size: light.size,
            block,
            last,
            pixels: rgba,
            light: false,
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
            Some(stops) => (self.table).append(rgb, stops.exp2() as f32, &mut pixels),
        }
        Patch {
            frame,
            capture: true,
            size,
            block,
            last,
            pixels,
            light: stops.is_none(),
        }
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
        assert!(shown.accept((1, (4, 1)), block(0), &light, false).is_some());
        assert!(
            shown
                .accept((1, (4, 1)), block(2), &light, true)
                .unwrap()
                .last
        );
        // A second picture has begun over the first.
        shown.accept((2, (4, 1)), block(2), &[0.2; 6], false);
        let patches = shown.expose(1.0);
        let frames: Vec<(u32, usize)> = patches.iter().map(|p| (p.frame, p.block.x)).collect();
        assert_eq!(frames, [(1, 0), (1, 2), (2, 2)]);
        assert_eq!(patches[0].pixels[0], ToneTable::default().byte(0.2));
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
        assert!(shown.accept((1, (4, 1)), block, &[0.0; 6], true).is_none());
        let block = Block {
            x: 0,
            y: 0,
            width: 2,
            height: 1,
        };
        assert!(shown.accept((1, (4, 1)), block, &[0.0; 5], true).is_none());
    }
}
