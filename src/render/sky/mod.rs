//! What is seen through an exit: a picture of the whole sphere, or a built-in pattern.
//!
//! In: a direction (x forward, y left, z up; any length) and a footprint, the angle in radians
//! over which to average, about one pixel of the final picture; 0 asks for a point sample.
//! Out: radiance, linear red, green, blue.
//!
//! The patterns are made to judge a picture by eye: letters that read backwards show a mirrored
//! sky, coloured marks show which way is which, lines show distortion.

mod angles;
mod catalogue;
mod cube;
mod equirectangular;
mod glyph;
mod grid;
mod sixteen;
mod stars;
mod taps;

use crate::{
    error::Result,
    render::{footprint::Footprint, lanes::LANES, scene::SkyEntry},
};
use equirectangular::Equirectangular;
use glam::{DVec3, Vec3};
use ndarray::Array3;
pub(super) use sixteen::{Mask, Vectors, each_vector, first, lane, mask, nearest};
use stars::StarField;
use std::path::Path;
pub(super) use taps::Across;

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
    /// The sky that a scene file asks for; reads its picture.
    pub fn load(entry: &SkyEntry) -> Result<Self> {
        match entry {
            SkyEntry::Image(path) => Self::load_image(path),
            SkyEntry::Pattern(pattern) => Ok(Self::from(*pattern)),
        }
    }

    fn load_image(path: &Path) -> Result<Self> {
        let pixels = crate::render::picture::read(path)?.rgb;
        let subject = path.display().to_string();
        Self::from_image(&subject, pixels)
    }

    /// A picture as rows from the top × columns × 3 of linear light; `subject` is its name for a
    /// complaint. The middle of the picture is +x, its top +z, its left quarter +y.
    pub fn from_image(subject: &str, pixels: Array3<f32>) -> Result<Self> {
        Ok(Self::Equirectangular(Equirectangular::new(
            subject, &pixels,
        )?))
    }

    /// Tells what the user should know of its picture.
    pub fn warning(&self) -> Option<&str> {
        match self {
            Self::Equirectangular(image) => image.warning(),
            _ => None,
        }
    }

    /// Linear light from `direction`, averaged over about `footprint` radians.
    #[inline]
    pub fn radiance(&self, direction: DVec3, footprint: f32) -> [f32; 3] {
        self.round(unit(direction), footprint).to_array()
    }

    /// Linear light from the unit vector `d`, averaged over a footprint of any shape: round ones
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

    /// Linear light from the unit vectors `d`, averaged over what samples stand for that change `across`, in
    /// the lanes that are `wanted`.
    #[inline(always)]
    pub(super) fn lights(&self, d: &Vectors, across: &Across, wanted: &Mask) -> Vectors {
        match self {
            Self::Equirectangular(image) => image.lights(d, across, wanted),
            Self::Grid => grid::lights(d, across, wanted),
            Self::Stars(stars) => stars.lights(d, across, wanted),
            Self::Colour(colour) => colour.map(|x| [x; LANES]),
        }
    }

    /// Linear light from the unit vector `d` over a round footprint.
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

/// The direction at length one in single precision; +x for one that has no direction.
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

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
