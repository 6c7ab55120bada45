//! A picture of the whole sphere by longitude and latitude.
//!
//! In: rows from the top × columns × 3 of linear light. Out: radiance by direction.
//!
//! Convention, as seen from the centre looking out: the middle of the picture is +x, the top edge
//! +z, the bottom edge −z. Longitude `φ = atan2(y, x)` grows to the *left*, so +y is a quarter of
//! the width left of the middle and −y a quarter right of it; −x is at both side edges. Then
//! someone who looks along +x with +z up sees the picture's right on the right.

use super::{
    angles::longitude_latitude,
    sixteen::{Mask, Numbers, Vectors, each_vector, lane, put},
    taps::{Across, LaneTaps},
};
use crate::{
    error::{Error, Result},
    expr::real::Real,
    render::lanes::LANES,
};
use glam::{Vec2, Vec3};
use ndarray::Array3;
use std::f32::consts::{LOG2_E, PI, TAU};

/// A picture of the whole sphere with its reductions to half, a quarter, … of the size.
#[derive(Debug, Clone)]
pub struct Equirectangular {
    levels: Vec<Level>,
    warning: Option<String>,
}

/// One size of the picture, row by row from the top.
#[derive(Debug, Clone)]
struct Level {
    width: usize,
    height: usize,
    pixels: Vec<Vec3>,
}

impl Equirectangular {
    /// Takes rows from the top × columns × 3; `subject` is the picture's name for a complaint.
    pub(super) fn new(subject: &str, pixels: &Array3<f32>) -> Result<Self> {
        let (height, width, channels) = pixels.dim();
        if channels != 3 || height == 0 || width == 0 {
            let message = "a sky picture needs at least one pixel of three channels";
            return Err(Error::input(subject, message));
        }
        // One bad pixel of a float picture would spread through every reduction.
        let light = |x: f32| if x.is_finite() { x.max(0.0) } else { 0.0 };
        let pixel = |p: ndarray::ArrayView1<f32>| Vec3::new(light(p[0]), light(p[1]), light(p[2]));
        let mut levels = vec![Level {
            width,
            height,
            pixels: pixels
                .lanes(ndarray::Axis(2))
                .into_iter()
                .map(pixel)
                .collect(),
        }];
        while let Some(half) = levels.last().and_then(Level::halved) {
            levels.push(half);
        }
        Ok(Self {
            levels,
            warning: shape_warning(subject, width, height),
        })
    }

    /// Tells what the user should know of the picture.
    pub(super) fn warning(&self) -> Option<&str> {
        self.warning.as_deref()
    }

    /// Linear light from the unit vector `d`, averaged over about `footprint` radians.
    pub(super) fn radiance(&self, d: Vec3, footprint: f32) -> Vec3 {
        let [texel, last] = self.texel_last();
        self.radiance_at(place(d).extend(level(footprint / texel, last)))
    }

    /// Linear light from the unit vectors `d`, averaged over what samples stand for that change `across`, in
    /// the lanes that are `wanted`.
    #[inline(always)]
    pub(super) fn lights(&self, d: &Vectors, across: &Across, wanted: &Mask) -> Vectors {
        let taps = LaneTaps::of(across, 0.0);
        taps.mean(
            d,
            wanted,
            #[inline(always)]
            |places, within| self.radiances(places, &taps.width, within),
        )
    }

    /// [`Equirectangular::radiance`] in the lanes that are `wanted`.
    #[inline(always)]
    fn radiances(&self, d: &Vectors, widths: &Numbers, wanted: &Mask) -> Vectors {
        let [texel, last] = self.texel_last();
        let places = each_vector(
            #[inline(always)]
            |l| place(lane(d, l)).extend(level(widths[l] / texel, last)),
        );
        let mut light = [[0.0; LANES]; 3];
        for l in (0..LANES).filter(|l| wanted[*l]) {
            put(&mut light, l, self.radiance_at(lane(&places, l)));
        }
        light
    }

    /// How high a pixel of the picture is, and the number of the least size.
    #[inline(always)]
    fn texel_last(&self) -> [f32; 2] {
        let texel = PI / self.levels[0].height as f32;
        [texel, (self.levels.len() - 1) as f32]
    }

    /// At a place of the picture (x and y) on a level (z).
    fn radiance_at(&self, at: Vec3) -> Vec3 {
        let (low, way) = (at.z as usize, at.z.fract());
        let sharp = self.levels[low].bilinear(at.x, at.y);
        if way == 0.0 {
            return sharp;
        }
        sharp.lerp(self.levels[low + 1].bilinear(at.x, at.y), way)
    }
}

/// Tells of a picture that is not twice as wide as high, as those of the whole sphere are; a row or a
/// column more or less is seen by nobody.
fn shape_warning(subject: &str, width: usize, height: usize) -> Option<String> {
    (width.abs_diff(2 * height) > 2).then(|| {
        format!(
            "{subject}: {width}x{height} is not twice as wide as high, so this may be no picture of the whole sphere; it is stretched over it, 360° from side to side and 180° from top to bottom"
        )
    })
}

/// The place in the picture, from the left and the top, both in [0, 1].
#[inline(always)]
fn place(d: Vec3) -> Vec2 {
    let (longitude, latitude) = longitude_latitude(d);
    Vec2::new(0.5 - longitude / TAU, 0.5 - latitude / PI)
}

/// Which size of the picture has pixels `texels` times as wide as the full one, counted from that;
/// fractions are between two sizes.
#[inline(always)]
fn level(texels: f32, last: f32) -> f32 {
    (Real::ln(texels.max(1.0)) * LOG2_E).min(last)
}

impl Level {
    /// Half the size, by means of 2 × 2 pixels; `None` when a side is odd.
    fn halved(&self) -> Option<Self> {
        let (width, height) = (self.width / 2, self.height / 2);
        if !self.width.is_multiple_of(2) || !self.height.is_multiple_of(2) {
            return None;
        }
        let mean = |i: usize| {
            let first = 2 * (i / width) * self.width + 2 * (i % width);
            let four = [first, first + 1, first + self.width, first + self.width + 1];
            0.25 * four.into_iter().map(|i| self.pixels[i]).sum::<Vec3>()
        };
        let pixels = (0..width * height).map(mean).collect();
        Some(Self {
            width,
            height,
            pixels,
        })
    }

    /// Bilinear at `u` from the left and `v` from the top, both in [0, 1]; `u` wraps around, and
    /// past a pole the row goes on half a turn away.
    fn bilinear(&self, u: f32, v: f32) -> Vec3 {
        // Half a pixel less, and one more so that a cast rounds down.
        let (x, y) = (u * self.width as f32 + 0.5, v * self.height as f32 + 0.5);
        let (column, row) = (x as usize, y as usize);
        let (fx, fy) = (x - column as f32, y - row as f32);
        let above = self.between(row.saturating_sub(1), column + self.width - 1, row == 0, fx);
        let under = row >= self.height;
        let below = self.between(row.min(self.height - 1), column + self.width - 1, under, fx);
        above.lerp(below, fy)
    }

    /// Between the pixels at `column` and one further right, `column` counted around.
    fn between(&self, row: usize, column: usize, over_a_pole: bool, way: f32) -> Vec3 {
        let turned = column + if over_a_pole { self.width / 2 } else { 0 };
        let (left, right) = (turned % self.width, (turned + 1) % self.width);
        let start = row * self.width;
        self.pixels[start + left].lerp(self.pixels[start + right], way)
    }
}
