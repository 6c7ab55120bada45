//! Samples to pixels.
//!
//! In: colours of samples, pass by pass, and where in their pixels they lie. Out: a [`Picture`]. A
//! sample counts in all pixels whose filter reaches it: the four-term Blackman–Harris window (F. J.
//! Harris, 1978) three pixels wide, separable, which rings nowhere and has no edge. A single sample
//! for each pixel is not spread: there the footprints of skies and textures do the filtering.

use super::{picture::Picture, shade::Colours};
use geofan_expr::vectorised;
use glam::DVec2;
use ndarray::{Array3, Axis, s};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Half the width of the filter, pixels; its standard deviation is then 0.4155 pixels. Narrower is
/// sharper and leaves stairs, wider blurs. Chosen, not measured.
const RADIUS: f64 = 1.5;

/// A picture being exposed.
pub enum Film {
    /// One sample for each pixel: its colour, once it is there.
    Single(Picture),
    /// Sums over samples, axes (row, column, channel).
    Spread {
        /// Weighted colours.
        sums: Array3<f32>,
        /// The weights in a pixel of all samples of the pixels around it, by row and column.
        weights: [[f32; 3]; 3],
    },
}

impl Film {
    /// For a picture of `size` (across, down) with `samples` for each pixel.
    pub fn new((width, height): (usize, usize), samples: usize) -> Self {
        match samples {
            1 => Self::Single(Picture::new(Array3::zeros((0, 0, 3)))),
            _ => Self::Spread {
                sums: Array3::zeros((height, width, 3)),
                weights: [[0.0; 3]; 3],
            },
        }
    }

    /// Adds a pass of samples at `offsets` of every pixel.
    pub fn add(&mut self, colours: Colours, offsets: &[DVec2]) {
        match self {
            Self::Single(picture) => *picture = Picture::new(colours.index_axis_move(Axis(2), 0)),
            Self::Spread { sums, weights } => {
                let taps = taps(offsets);
                for (dy, row) in weights.iter_mut().enumerate() {
                    for (dx, weight) in row.iter_mut().enumerate() {
                        *weight += taps[dy].iter().map(|of_sample| of_sample[dx]).sum::<f32>();
                    }
                }
                spread(sums, &colours, &taps);
            }
        }
    }

    /// The picture.
    pub fn develop(self) -> Picture {
        match self {
            Self::Single(picture) => picture,
            Self::Spread { mut sums, weights } => {
                divide(&mut sums, &weights);
                Picture::new(sums)
            }
        }
    }
}

/// The weights in a pixel of one sample of the pixel before, the same, and the next.
type Across = [f32; 3];

/// How samples count in a pixel: those of the row above, the same, and the one below, by number.
fn taps(offsets: &[DVec2]) -> [Vec<Across>; 3] {
    let weight = |offset: &DVec2, dx: f64, dy: f64| {
        let at = *offset + DVec2::new(dx, dy) - 0.5;
        (window(at.x) * window(at.y)) as f32
    };
    [-1.0, 0.0, 1.0].map(|dy| {
        let across = |offset: &DVec2| [-1.0, 0.0, 1.0].map(|dx| weight(offset, dx, dy));
        offsets.iter().map(across).collect()
    })
}

/// Adds the colours of all samples to the sums of all pixels whose filter reaches them.
fn spread(sums: &mut Array3<f32>, colours: &Colours, taps: &[Vec<Across>; 3]) {
    let (height, width, _, _) = colours.dim();
    let rows = sums.axis_iter_mut(Axis(0)).into_par_iter();
    rows.enumerate().for_each_init(
        // One more pixel, black, on each side.
        || vec![0.0; 3 * width + 6],
        |samples, (y, mut row)| {
            let Some(row) = row.as_slice_mut() else {
                return;
            };
            for (y, taps) in (y..).zip(taps) {
                // Rows are counted from the one before the first.
                let Some(y) = y.checked_sub(1).filter(|y| *y < height) else {
                    continue;
                };
                for (k, across) in taps.iter().enumerate() {
                    let from = colours.slice(s![y, .., k, ..]);
                    for (to, from) in samples[3..].chunks_exact_mut(3).zip(from.rows()) {
                        to.copy_from_slice(&[from[0], from[1], from[2]]);
                    }
                    add_row(row, samples, across);
                }
            }
        },
    );
}

/// Adds one sample of every pixel of a row, its own and its neighbours', to the sums.
fn add_row(row: &mut [f32], samples: &[f32], across: &Across) {
    let [before, same, next] = [0, 3, 6].map(|start| &samples[start..start + row.len()]);
    vectorised(
        #[inline(always)]
        || {
            for (i, sum) in row.iter_mut().enumerate() {
                *sum += across[0] * before[i] + across[1] * same[i] + across[2] * next[i];
            }
        },
    );
}

/// Divides sums by the weights of the samples that there are: none outside the picture.
fn divide(sums: &mut Array3<f32>, weights: &[[f32; 3]; 3]) {
    let (height, width, _) = sums.dim();
    let inside = |at: usize, step: usize, size: usize| (1..=size).contains(&(at + step));
    let rows = sums.axis_iter_mut(Axis(0)).into_par_iter();
    rows.enumerate().for_each(|(y, mut row)| {
        let columns: Across = std::array::from_fn(|dx| {
            let rows = (0..3).filter(|dy| inside(y, *dy, height));
            rows.map(|dy| weights[dy][dx]).sum()
        });
        let all: f32 = columns.iter().sum();
        for (x, mut pixel) in row.rows_mut().into_iter().enumerate() {
            let weight = match x > 0 && x + 1 < width {
                true => all,
                false => (0..3)
                    .filter(|dx| inside(x, *dx, width))
                    .map(|dx| columns[dx])
                    .sum(),
            };
            pixel.mapv_inplace(|sum| sum / weight);
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
    use crate::{footprint::FILTER_DEVIATION, frame::offsets};

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
