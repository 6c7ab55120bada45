//! The pixel filter: what a sample stands for, and in which pixels it counts.
//!
//! In: how a direction (or texture coordinates) changes to the next sample on the right and the next below
//! ([`Footprint`], of sixteen samples [`Across`]). Out: round or not too long footprints along the longer
//! axis that cover it ([`Taps`], of sixteen samples [`LaneTaps`]), and the mean of a sky over them. Without
//! branches, so that a loop over samples takes vector instructions.
//!
//! In: colours of samples, pass by pass, and where in their pixels they lie. Out: a [`Picture`] ([`Film`]).
//! A sample counts in all pixels whose filter reaches it: the four-term Blackman–Harris window (F. J.
//! Harris, 1978) three pixels wide, separable, which rings nowhere and has no edge. A single sample for
//! each pixel is not spread: there the footprints of skies and textures do the filtering.

use super::{
    lanes::{
        LANES, Mask, SingleLanes, SingleVectors, largest, less, limited, mask, more, nearest,
        set_lane, single, single_lane, single_vector,
    },
    picture::Picture,
    shade::Colours,
};
use geofan_core::parallel::*;
use geofan_expr::vectorised;
use glam::{DVec2, Vec3};
use ndarray::{Array3, Axis, s};
use std::f64::consts::TAU;

/// The change of a direction, or of texture coordinates, to the next samples.
#[derive(Debug, Clone, Copy)]
pub struct Footprint {
    /// To the right, and down.
    pub across: [Vec3; 2],
}

/// Standard deviation of the pixel filter in pixels: a footprint of one pixel is averaged over that.
pub const FILTER_DEVIATION: f32 = 0.4155;

/// Most footprints that stand for a long one: at eight round ones a footprint of one to eight is covered,
/// beyond it is averaged too widely across, which is soft but does not shimmer.
const MOST_TAPS: f32 = 8.0;

/// Widest footprint, radians (or texture widths): beyond it neighbours are no guide.
const WIDEST: f32 = 0.5;

impl Footprint {
    /// The footprint of a point sample.
    pub const POINT: Self = Self {
        across: [Vec3::ZERO; 2],
    };

    /// Makes one that is as wide in all directions across `d`.
    pub fn round(d: Vec3, width: f32) -> Self {
        let (right, down) = d.normalize_or(Vec3::X).any_orthonormal_pair();
        Self {
            across: [right * width, down * width],
        }
    }

    /// Scales the footprint.
    #[inline(always)]
    pub fn scaled(self, factor: f32) -> Self {
        let [right, down] = self.across;
        Self {
            across: [right * factor, down * factor],
        }
    }

    /// Covers this by footprints that are each round or no longer than `longest`.
    #[inline(always)]
    pub fn taps(&self, longest: f32) -> Taps {
        let (major, short) = self.axes();
        let long = major.length();
        let each = more(more(short, longest), 1e-12);
        let count = nearest(limited(long / each, 1.0, MOST_TAPS));
        let step = major * (1.0 / count);
        let length = long / count;
        // Their number is rounded, so they may be half as long again; beyond that there are not enough.
        let round = length > 1.5 * longest;
        Taps {
            first: step * (0.5 - 0.5 * count),
            step,
            count,
            width: less(if round { more(short, length) } else { short }, WIDEST),
        }
    }

    /// Computes the longer axis of the ellipse that the unit circle becomes, and the length of the shorter.
    #[inline(always)]
    fn axes(&self) -> (Vec3, f32) {
        let (a, b) = (shortened(self.across[0]), shortened(self.across[1]));
        let (aa, ab, bb) = (a.dot(a), a.dot(b), b.dot(b));
        let (mean, half) = (0.5 * (aa + bb), 0.5 * (aa - bb));
        let spread = (half * half + ab * ab).sqrt();
        let short = more(mean - spread, 0.0).sqrt();
        // The angle of the axis is half of that of (half, ab); its smaller side follows from the
        // larger, as a difference would lose digits. A circle has no axis: any will do.
        let larger = (0.5 * (1.0 + half.abs() / spread)).sqrt();
        let smaller = 0.5 * ab.abs() / (spread * larger);
        let (cosine, sine) = if half > 0.0 {
            (larger, smaller)
        } else {
            (smaller, larger)
        };
        let long = spread > 1e-3 * mean;
        let cosine = if long { cosine } else { 1.0 };
        let sine = if long { sine.copysign(ab) } else { 0.0 };
        (a * cosine + b * sine, short)
    }
}

/// Footprints evenly along a line, each as long as they are apart.
#[derive(Debug, Clone, Copy)]
pub struct Taps {
    /// Displacement of the first.
    pub first: Vec3,
    /// From each to the next.
    pub step: Vec3,
    /// Their number: a whole number from 1 to 8.
    pub count: f32,
    /// Width of each across the line.
    pub width: f32,
}

impl Taps {
    /// Returns the displacement of number `i`.
    #[inline(always)]
    pub fn at(&self, i: f32) -> Vec3 {
        self.first + self.step * i
    }

    /// Iterates over all displacements.
    #[inline]
    pub fn places(&self) -> impl Iterator<Item = Vec3> {
        (0..self.count as u32).map(|i| self.at(i as f32))
    }
}

/// Shortens a change to the widest footprint.
#[inline(always)]
fn shortened(x: Vec3) -> Vec3 {
    x * less(WIDEST / x.length(), 1.0)
}

/// The changes to the next sample on the right and the next below, in each lane.
pub type Across = [SingleVectors; 2];

/// [`Taps`] in each lane.
#[derive(Default)]
pub struct LaneTaps {
    /// The displacement of the first.
    first: SingleVectors,
    /// From each to the next: the longer axis of each.
    pub step: SingleVectors,
    /// Their number.
    count: SingleLanes,
    /// Width of each across `step`.
    pub width: SingleLanes,
}

impl LaneTaps {
    /// Covers what samples stand for that change so: no footprint longer than it is wide or than
    /// `longest` if it can be helped.
    #[inline(always)]
    pub fn of(across: &Across, longest: f32) -> Self {
        let mut to = Self::default();
        for l in 0..LANES {
            let across = [single_lane(&across[0], l), single_lane(&across[1], l)];
            let taps = Footprint { across }.taps(longest);
            set_lane(&mut to.first, l, taps.first);
            set_lane(&mut to.step, l, taps.step);
            to.count[l] = taps.count;
            to.width[l] = taps.width;
        }
        to
    }

    /// Returns the length of the longest of all footprints that are `wanted`.
    #[inline(always)]
    pub fn longest(&self, wanted: &Mask) -> f32 {
        largest(&single(
            #[inline(always)]
            |l| {
                let length = self.count[l] * single_lane(&self.step, l).length();
                if wanted[l] { length } else { 0.0 }
            },
        ))
    }

    /// Averages the `light` at the footprints around the directions `d`, in the lanes that are `wanted`;
    /// `light` is told which it is asked for.
    #[inline(always)]
    pub fn mean(
        &self,
        d: &SingleVectors,
        wanted: &Mask,
        light: impl Fn(&SingleVectors, &Mask) -> SingleVectors,
    ) -> SingleVectors {
        let counts = single(
            #[inline(always)]
            |l| if wanted[l] { self.count[l] } else { 0.0 },
        );
        let mut sum = SingleVectors::default();
        for i in 0..largest(&counts) as u32 {
            let i = i as f32;
            let places = single_vector(
                #[inline(always)]
                |l| {
                    let tap = single_lane(&self.first, l) + single_lane(&self.step, l) * i;
                    (single_lane(d, l) + tap).normalize_or(Vec3::X)
                },
            );
            let within = mask(
                #[inline(always)]
                |l| counts[l] > i,
            );
            add(&mut sum, &light(&places, &within), &within);
        }
        single_vector(
            #[inline(always)]
            |l| single_lane(&sum, l) / self.count[l],
        )
    }
}

/// Adds light in the lanes that are `wanted`.
#[inline(always)]
pub fn add(sum: &mut SingleVectors, light: &SingleVectors, wanted: &Mask) {
    for c in 0..3 {
        let old = sum[c];
        sum[c] = single(
            #[inline(always)]
            |l| old[l] + if wanted[l] { light[c][l] } else { 0.0 },
        );
    }
}

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
    /// Makes an empty one for a picture of `size` (across, down) with `samples` for each pixel.
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
                let of_samples = sample_weights(offsets);
                for (dy, row) in weights.iter_mut().enumerate() {
                    for (dx, weight) in row.iter_mut().enumerate() {
                        *weight += of_samples[dy].iter().map(|across| across[dx]).sum::<f32>();
                    }
                }
                spread(sums, &colours, &of_samples);
            }
        }
    }

    /// Returns the picture.
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
type RowWeights = [f32; 3];

/// Computes the weights with which samples count in a pixel: those of the row above, the same, and the
/// one below, by number.
fn sample_weights(offsets: &[DVec2]) -> [Vec<RowWeights>; 3] {
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
fn spread(sums: &mut Array3<f32>, colours: &Colours, weights: &[Vec<RowWeights>; 3]) {
    let (height, width, _, _) = colours.dim();
    let rows = sums.axis_iter_mut(Axis(0)).into_par_iter();
    rows.enumerate().for_each_init(
        // One more pixel, black, on each side.
        || vec![0.0; 3 * width + 6],
        |samples, (y, mut row)| {
            let Some(row) = row.as_slice_mut() else {
                return;
            };
            for (y, weights) in (y..).zip(weights) {
                // Rows are counted from the one before the first.
                let Some(y) = y.checked_sub(1).filter(|y| *y < height) else {
                    continue;
                };
                for (k, across) in weights.iter().enumerate() {
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
fn add_row(row: &mut [f32], samples: &[f32], across: &RowWeights) {
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
        let columns: RowWeights = std::array::from_fn(|dx| {
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

/// Returns the window at `x` pixels from its middle.
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
    use crate::frame::offsets;

    #[test]
    fn the_axes_are_the_singular_values() {
        let footprint = Footprint {
            across: [Vec3::new(0.03, 0.01, 0.0), Vec3::new(0.02, -0.02, 0.0)],
        };
        let (major, short) = footprint.axes();
        // Determinant and sum of squares of [[.03, .02], [.01, -.02]].
        assert!((major.length() * short - 8e-4).abs() < 1e-8);
        assert!((major.length_squared() + short * short - 1.8e-3).abs() < 1e-8);
    }

    #[test]
    fn taps_lie_evenly_along_the_longer_axis() {
        let footprint = Footprint {
            across: [Vec3::X * 0.04, Vec3::Y * 0.01],
        };
        let taps = footprint.taps(0.0);
        let places: Vec<f32> = taps.places().map(|t| t.x).collect();
        assert_eq!(places.len(), 4);
        assert!((taps.width - 0.01).abs() < 1e-7 && (places[0] + 0.015).abs() < 1e-7);
        assert_eq!(Footprint::POINT.taps(0.0).places().count(), 1);
        // Two that may be long are enough, and are as narrow as the whole.
        let taps = footprint.taps(0.02);
        assert_eq!(taps.places().count(), 2);
        assert!((taps.width - 0.01).abs() < 1e-7 && (taps.step.length() - 0.02).abs() < 1e-7);
    }

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
