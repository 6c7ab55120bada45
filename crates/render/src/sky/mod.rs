//! The skies beyond exits: a picture of the whole sphere, or a built-in pattern.
//!
//! In: a direction (x forward, y left, z up; any length) and a footprint, the angle in radians
//! over which to average, about one pixel of the final picture; 0 asks for a point sample.
//! Out: radiance, linear red, green, blue.
//!
//! The patterns are made to judge a picture by eye: letters that read backwards show a mirrored
//! sky, coloured marks show which way is which, lines show distortion.

mod catalogue;
mod equirectangular;
mod grid;
mod stars;

use crate::{
    filter::{Across, Footprint},
    lanes::{LANES, Mask, SingleVectors},
    scene::SkyEntry,
};
use equirectangular::Equirectangular;
use geofan_core::error::Result;
use glam::{DVec3, Vec3};
use ndarray::Array3;
use stars::StarField;
use std::{
    f32::consts::{FRAC_PI_2, PI},
    path::Path,
};

/// A built-in sky, as a scene file names it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pattern {
    /// Lines of latitude and longitude every 15°, with lettered marks on the six axes.
    Grid,
    /// A few thousand stars and a milky way.
    Stars,
    /// The same linear colour everywhere.
    Colour([f32; 3]),
}

/// A sky, ready to be looked at.
#[derive(Debug, Clone)]
pub enum Sky {
    /// A picture of the whole sphere.
    Equirectangular(Equirectangular),
    /// [`Pattern::Grid`].
    Grid,
    /// [`Pattern::Stars`].
    Stars(Box<StarField>),
    /// [`Pattern::Colour`].
    Colour([f32; 3]),
}

impl Sky {
    /// Loads the sky that a scene file asks for.
    pub fn load(entry: &SkyEntry) -> Result<Self> {
        match entry {
            SkyEntry::Image(path) => Self::load_image(path),
            SkyEntry::Pattern(pattern) => Ok(Self::from(*pattern)),
        }
    }

    /// Loads a picture of the whole sphere.
    fn load_image(path: &Path) -> Result<Self> {
        let pixels = crate::picture::read(path)?.rgb;
        let subject = path.display().to_string();
        Self::from_image(&subject, pixels)
    }

    /// Makes a sky of a picture: rows from the top × columns × 3 of linear light; `subject` is its name for a
    /// complaint. The middle of the picture is +x, its top +z, its left quarter +y.
    pub fn from_image(subject: &str, pixels: Array3<f32>) -> Result<Self> {
        Ok(Self::Equirectangular(Equirectangular::new(
            subject, &pixels,
        )?))
    }

    /// Returns linear light from `direction`, averaged over about `footprint` radians.
    #[inline]
    pub fn radiance(&self, direction: DVec3, footprint: f32) -> [f32; 3] {
        self.round(unit(direction), footprint).to_array()
    }

    /// Returns linear light from the unit vector `d`, averaged over a footprint of any shape: round ones
    /// along its longer axis.
    #[inline]
    pub fn filtered(&self, d: Vec3, footprint: &Footprint) -> [f32; 3] {
        if let Self::Colour(colour) = self {
            return *colour;
        }
        let taps = footprint.taps(0.0);
        let round = |tap: Vec3| self.round((d + tap).normalize_or(Vec3::X), taps.width);
        let sum: Vec3 = taps.places().map(round).sum();
        (sum / taps.count).to_array()
    }

    /// Returns linear light from the unit vectors `d`, averaged over what samples stand for that change
    /// `across`, in the lanes that are `wanted`.
    #[inline(always)]
    pub(super) fn lights(
        &self,
        d: &SingleVectors,
        across: &Across,
        wanted: &Mask,
    ) -> SingleVectors {
        match self {
            Self::Equirectangular(image) => image.lights(d, across, wanted),
            Self::Grid => grid::lights(d, across, wanted),
            Self::Stars(stars) => stars.lights(d, across, wanted),
            Self::Colour(colour) => colour.map(|x| [x; LANES]),
        }
    }

    /// Returns linear light from the unit vector `d` over a round footprint.
    #[inline]
    fn round(&self, d: Vec3, footprint: f32) -> Vec3 {
        // Written so that a footprint that is not a number asks for a point sample.
        let footprint = footprint.max(0.0);
        match self {
            Self::Equirectangular(image) => image.radiance(d, footprint),
            Self::Grid => grid::radiance(d, footprint),
            Self::Stars(stars) => stars.radiance(d, footprint),
            Self::Colour(colour) => Vec3::from(*colour),
        }
    }
}

/// Returns the direction at length one in single precision; +x for one that has no direction.
fn unit(direction: DVec3) -> Vec3 {
    let d = direction.as_vec3();
    let squared = d.length_squared();
    // Outside this range squares lose digits; then the slow way is right.
    if squared > 1e-20 && squared < 1e20 {
        return d / squared.sqrt();
    }
    let largest = direction.abs().max_element();
    (direction / largest).normalize_or(DVec3::X).as_vec3()
}

impl From<Pattern> for Sky {
    fn from(pattern: Pattern) -> Self {
        match pattern {
            Pattern::Grid => Self::Grid,
            Pattern::Stars => Self::Stars(Box::new(StarField::new())),
            Pattern::Colour(colour) => Self::Colour(colour),
        }
    }
}

/// Returns the longitude in (−π, π] and the latitude in [−π/2, π/2] of a unit vector, radians, to about 3e-7.
/// Without branches, so that a loop over directions takes vector instructions; the standard library's
/// `atan2` would be half the cost of a look-up, for digits nobody sees.
#[inline(always)]
fn longitude_latitude(d: Vec3) -> (f32, f32) {
    let across = (d.x * d.x + d.y * d.y).sqrt();
    // An arc tangent stays accurate at the poles, where an arc sine loses half its digits.
    (arc_tangent(d.y, d.x), arc_tangent(d.z, across))
}

/// Computes `atan2(y, x)` by the polynomial 4.4.49 of Abramowitz and Stegun on the smaller ratio.
#[inline(always)]
fn arc_tangent(y: f32, x: f32) -> f32 {
    // Coefficients of the odd powers from the third up.
    const C: [f32; 8] = [
        -0.333_331_45,
        0.199_935_51,
        -0.142_089,
        0.106_562_64,
        -0.075_289_64,
        0.042_909_614,
        -0.016_165_737,
        0.002_866_225_7,
    ];
    let (small, large) = (x.abs().min(y.abs()), x.abs().max(y.abs()));
    let ratio = small / large.max(f32::MIN_POSITIVE);
    let square = ratio * ratio;
    // In pairs and pairs of pairs: the processor works on them at once, a chain it must wait for.
    let fourth = square * square;
    let pair = |i: usize| C[i] + C[i + 1] * square;
    let low = pair(0) + pair(2) * fourth;
    let series = low + (pair(4) + pair(6) * fourth) * (fourth * fourth);
    let octant = ratio + ratio * square * series;
    let quadrant = if y.abs() > x.abs() {
        FRAC_PI_2 - octant
    } else {
        octant
    };
    let half = if x < 0.0 { PI - quadrant } else { quadrant };
    half.copysign(y)
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
