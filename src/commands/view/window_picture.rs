//! The picture in a native window, and pictures that are saved from there.
//!
//! In: patches of a session. Out: the window's pixels, a smaller picture stretched to them; and PNG files.

use geofan_core::Result;
use geofan_render::picture::{Picture, srgb_decode, write_png};
use geofan_view::Patch;
use ndarray::Array3;
use std::path::PathBuf;

/// Pixels of a picture, row by row, as the window takes them: red, green and blue in the lowest bytes.
#[derive(Debug, Clone, Default)]
struct WindowPixels {
    size: (usize, usize),
    rgb: Vec<u32>,
    /// They are not blended.
    classes: bool,
}

/// The picture in the window.
#[derive(Debug, Default)]
pub struct WindowPicture {
    /// The last whole picture with what has come of the next one over it, if that has its size.
    shown: WindowPixels,
    /// A picture of another size, until it is whole.
    coming: WindowPixels,
    /// Linear light of a picture that is saved, as the screen shows it.
    saved: Vec<f32>,
}

impl WindowPicture {
    /// Takes a patch. Returns the file of a picture that is saved when it is whole with it.
    pub fn take(&mut self, patch: &Patch) -> Option<Result<String>> {
        if patch.capture {
            return self.save(patch);
        }
        let to = match patch.size == self.shown.size {
            true => &mut self.shown,
            false => &mut self.coming,
        };
        if to.size != patch.size {
            *to = WindowPixels {
                size: patch.size,
                rgb: vec![0; patch.size.0 * patch.size.1],
                classes: false,
            };
        }
        to.classes = patch.classes;
        let block = patch.block;
        let rows = patch.pixels.chunks_exact(4 * block.width.max(1));
        for (row, pixels) in rows.enumerate() {
            let start = (block.y + row) * to.size.0 + block.x;
            let line = &mut to.rgb[start..start + block.width];
            for (pixel, from) in line.iter_mut().zip(pixels.chunks_exact(4)) {
                *pixel = u32::from_be_bytes([0, from[0], from[1], from[2]]);
            }
        }
        if patch.last && self.coming.size == patch.size {
            self.shown = std::mem::take(&mut self.coming);
        }
        None
    }

    /// Draws the picture into a window of `size`.
    pub fn draw(&self, size: (usize, usize), window: &mut [u32]) {
        if self.shown.rgb.is_empty() {
            window.fill(0);
        } else if self.shown.size == size {
            window.copy_from_slice(&self.shown.rgb);
        } else {
            self.shown.stretch(size, window);
        }
    }

    /// Takes pixels of a picture that is saved.
    fn save(&mut self, patch: &Patch) -> Option<Result<String>> {
        let (width, height) = patch.size;
        self.saved.resize(3 * width * height, 0.0);
        let block = patch.block;
        let rows = patch.pixels.chunks_exact(4 * block.width.max(1));
        for (row, pixels) in rows.enumerate() {
            let start = 3 * ((block.y + row) * width + block.x);
            let line = &mut self.saved[start..start + 3 * block.width];
            for (light, codes) in line.chunks_exact_mut(3).zip(pixels.chunks_exact(4)) {
                for (to, code) in light.iter_mut().zip(codes) {
                    *to = srgb_decode(f32::from(*code) / 255.0);
                }
            }
        }
        if !patch.last {
            return None;
        }
        let light = std::mem::take(&mut self.saved);
        let picture = Array3::from_shape_vec((height, width, 3), light).ok()?;
        let name = free_name("geofan", "png");
        let written = write_png(&name, &Picture::new(picture));
        Some(written.map(|()| name.display().to_string()))
    }
}

/// Returns the first name with a number and this ending that no file has yet.
pub fn free_name(stem: &str, ending: &str) -> PathBuf {
    let name = |k: usize| PathBuf::from(format!("{stem}-{k:03}.{ending}"));
    (1..)
        .map(name)
        .find(|path| !path.exists())
        .unwrap_or_default()
}

impl WindowPixels {
    /// Draws the pixels into a window of another size, linearly between them; those of classes each as it is.
    fn stretch(&self, (width, height): (usize, usize), window: &mut [u32]) {
        let places = |count: usize, most: usize| -> Vec<(usize, usize, u32)> {
            let place = |i: usize| {
                let at = (i as f64 + 0.5) * most as f64 / count as f64 - 0.5;
                let at = at.clamp(0.0, (most - 1) as f64);
                let at = if self.classes { at.round() } else { at };
                let next = (at as usize + 1).min(most - 1);
                (at as usize, next, (256.0 * at.fract()) as u32)
            };
            (0..count).map(place).collect()
        };
        let columns = places(width, self.size.0);
        for (line, (top, bottom, down)) in window
            .chunks_exact_mut(width)
            .zip(places(height, self.size.1))
        {
            let row = |y: usize| &self.rgb[y * self.size.0..][..self.size.0];
            let (above, below) = (row(top), row(bottom));
            for (pixel, (left, right, across)) in line.iter_mut().zip(&columns) {
                let upper = mixed(above[*left], above[*right], *across);
                let lower = mixed(below[*left], below[*right], *across);
                *pixel = mixed(upper, lower, down);
            }
        }
    }
}

/// Mixes two pixels, with so many parts in 256 of the second.
fn mixed(a: u32, b: u32, part: u32) -> u32 {
    // Red and blue, which leave eight bits free between each other, at once.
    let mix = |mask: u32| ((a & mask) * (256 - part) + (b & mask) * part) >> 8 & mask;
    mix(0x00_00_ff) | mix(0x00_ff_00) | ((a >> 16) * (256 - part) + (b >> 16) * part) >> 8 << 16
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_view::Block;

    fn patch(size: (usize, usize), x: usize, grey: u8, last: bool) -> Patch {
        Patch {
            frame: 1,
            capture: false,
            size,
            block: Block {
                x,
                y: 0,
                width: 1,
                height: 1,
            },
            last,
            pixels: vec![grey, grey, grey, 255],
            light: false,
            classes: false,
        }
    }

    #[test]
    fn a_picture_of_another_size_is_shown_when_it_is_whole_and_stretched() {
        let mut picture = WindowPicture::default();
        picture.take(&patch((2, 1), 0, 10, false));
        let mut window = [7; 4];
        picture.draw((4, 1), &mut window);
        assert_eq!(window, [0; 4]);
        picture.take(&patch((2, 1), 1, 50, true));
        picture.draw((2, 1), &mut window[..2]);
        assert_eq!(window[..2], [0x0a_0a_0a, 0x32_32_32]);
        picture.draw((4, 1), &mut window);
        assert_eq!(window, [0x0a_0a_0a, 0x14_14_14, 0x28_28_28, 0x32_32_32]);
        picture.shown.classes = true;
        picture.draw((4, 1), &mut window);
        assert_eq!(window, [0x0a_0a_0a, 0x0a_0a_0a, 0x32_32_32, 0x32_32_32]);
        // One of the same size is shown block by block.
        picture.take(&patch((2, 1), 0, 90, false));
        picture.draw((2, 1), &mut window[..2]);
        assert_eq!(window[..2], [0x5a_5a_5a, 0x32_32_32]);
    }
}
