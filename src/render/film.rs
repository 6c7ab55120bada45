//! Samples to pixels.
//!
//! In: colours of samples, pass by pass, and where in their pixels they lie. Out: a [`Picture`]. A
//! sample counts in all pixels whose filter reaches it: the four-term Blackman–Harris window (F. J.
//! Harris, 1978) three pixels wide, separable, which rings nowhere and has no edge. A single sample
//! for each pixel is not spread: there the footprints of skies and textures do the filtering.

use super::{picture::Picture, shade::Colours};
use glam::DVec2;
use ndarray::{Array3, Axis};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Half the width of the filter, pixels; its standard deviation is then 0.4155 pixels. Narrower is
/// sharper and leaves stairs, wider blurs. Chosen, not measured.
const RADIUS: f64 = 1.5;

/// A picture being exposed.
pub enum Film {
    /// One sample for each pixel: its colour, once it is there.
    Single(Picture),
    /// Sums over samples, axes (row, column, channel); the fourth channel is the sum of weights.
    Spread(Array3<f32>),
}

impl Film {
    /// For a picture of `size` (across, down) with `samples` for each pixel.
    pub fn new((width, height): (usize, usize), samples: usize) -> Self {
        match samples {
            1 => Self::Single(Picture::new(Array3::zeros((0, 0, 3)))),
            _ => Self::Spread(Array3::zeros((height, width, 4))),
        }
    }

    /// Adds a pass of samples at `offsets` of every pixel.
    pub fn add(&mut self, colours: Colours, offsets: &[DVec2]) {
        match self {
            Self::Single(picture) => *picture = Picture::new(colours.index_axis_move(Axis(2), 0)),
            Self::Spread(sums) => spread(sums, &colours, offsets),
        }
    }

    /// The picture.
    pub fn develop(self) -> Picture {
        match self {
            Self::Single(picture) => picture,
            Self::Spread(sums) => {
                let (height, width, _) = sums.dim();
                Picture::new(Array3::from_shape_fn((height, width, 3), |(y, x, c)| {
                    sums[[y, x, c]] / sums[[y, x, 3]]
                }))
            }
        }
    }
}

/// A sample that counts in a pixel: rows and columns from it, number, weight.
type Tap = (isize, isize, usize, f32);

fn taps(offsets: &[DVec2]) -> Vec<Tap> {
    let mut taps = Vec::new();
    for dy in -1..=1 {
        for dx in -1..=1 {
            for (k, offset) in offsets.iter().enumerate() {
                let at = *offset + DVec2::new(dx as f64, dy as f64) - 0.5;
                taps.push((dy, dx, k, (window(at.x) * window(at.y)) as f32));
            }
        }
    }
    taps
}

/// Adds the colours of all samples to the sums of all pixels whose filter reaches them.
fn spread(sums: &mut Array3<f32>, colours: &Colours, offsets: &[DVec2]) {
    let (height, width, _, _) = colours.dim();
    let taps = taps(offsets);
    let rows = sums.axis_iter_mut(Axis(0)).into_par_iter();
    rows.enumerate().for_each(|(y, mut row)| {
        for x in 0..width {
            for &(dy, dx, k, weight) in &taps {
                let at = y.checked_add_signed(dy).zip(x.checked_add_signed(dx));
                let Some((y, x1)) = at.filter(|&(y, x)| y < height && x < width) else {
                    continue;
                };
                for c in 0..3 {
                    row[[x, c]] += weight * colours[[y, x1, k, c]];
                }
                row[[x, 3]] += weight;
            }
        }
    });
}

/// The window at `x` pixels from its middle.
fn window(x: f64) -> f64 {
    const TERMS: [f64; 4] = [0.358_75, 0.488_29, 0.141_28, 0.011_68];
    if x.abs() >= RADIUS {
        return 0.0;
    }
    let turn = TAU * x / (2.0 * RADIUS);
    let terms = TERMS.iter().enumerate();
    terms.map(|(k, a)| a * (k as f64 * turn).cos()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::{footprint::FILTER_DEVIATION, frame::offsets};

    #[test]
    fn the_window_has_the_deviation_that_footprints_assume() {
        let at = |i: i32| f64::from(i) * 1e-3;
        let sum = |f: &dyn Fn(f64) -> f64| (-1500..=1500).map(|i| f(at(i))).sum::<f64>();
        let variance = sum(&|x| x * x * window(x)) / sum(&window);
        assert!((variance.sqrt() - f64::from(FILTER_DEVIATION)).abs() < 1e-3);
        assert!(window(1.499).abs() < 1e-4);
    }

    #[test]
    fn an_even_picture_stays_even_to_its_edges() {
        let offsets = offsets(5);
        let mut film = Film::new((7, 4), 5);
        film.add(Colours::from_elem((4, 7, 5, 3), 0.25), &offsets);
        assert!(film.develop().rgb.iter().all(|x| (x - 0.25).abs() < 1e-6));
    }
}
