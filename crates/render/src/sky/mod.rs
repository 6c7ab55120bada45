//! The skies beyond exits: a picture of the whole sphere, or a built-in pattern.
//!
//! In: a direction (x forward, y left, z up; any length) and a footprint, the angle in radians
//! over which to average, about one pixel of the final picture; 0 asks for a point sample.
//! Out: radiance, linear red, green, blue.
//!
//! Convention of pictures, as seen from the centre looking out: the middle of the picture is +x, the top edge
//! +z, the bottom edge −z. Longitude `φ = atan2(y, x)` grows to the *left*, so +y is a quarter of the width
//! left of the middle and −y a quarter right of it; −x is at both side edges. Then someone who looks along
//! +x with +z up sees the picture's right on the right.
//!
//! The patterns are made to judge a picture by eye: letters that read backwards show a mirrored
//! sky, coloured marks show which way is which, lines show distortion.

mod catalogue;
mod grid;
mod stars;

use crate::{
    filter::{Across, Footprint, LaneTaps},
    halving::{half, halved},
    lanes::{
        LANES, Mask, SingleLanes, SingleVectors, less, more, set_lane, single_lane, single_vector,
    },
    picture::digest,
    scene::{SceneFile, SkyEntry},
};
use geofan_core::{
    diagnostic::Diagnostic,
    error::{Error, Result},
    manifold::Manifold,
};
use geofan_expr::real::Real;
use glam::{DVec3, Vec2, Vec3};
use ndarray::Array3;
use stars::StarField;
use std::{
    f32::consts::{FRAC_PI_2, LOG2_E, PI, TAU},
    fmt,
    path::Path,
};

/// A built-in sky, as a scene file names it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pattern {
    /// Lines of latitude and longitude every 15°, with lettered marks on the six axes.
    Grid,
    /// A few thousand stars and a milky way.
    Stars,
    /// One linear colour everywhere.
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

    /// Tells what the user should know of its picture.
    pub fn warnings(&self) -> &[String] {
        match self {
            Self::Equirectangular(image) => &image.warnings,
            _ => &[],
        }
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

/// Tells whether all directions see the same light: a colour, or the dark.
pub(super) fn has_one_colour(sky: &Option<Sky>) -> bool {
    matches!(sky, None | Some(Sky::Colour(_)))
}

/// Lists what the user should know of the skies by exit, the last of which is that of paths that end by their length.
pub(super) fn warnings(skies: &[Option<Sky>]) -> Vec<String> {
    let pictures = skies.iter().flatten().flat_map(Sky::warnings);
    let mut warnings: Vec<String> = pictures.cloned().collect();
    if !skies.last().is_some_and(has_one_colour) {
        let message = "the sky `length` is drawn in one colour, that of its top: paths that end by their length end anywhere, and have no direction in a sky; give it a `color`";
        warnings.push(message.into());
    }
    warnings
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

/// A picture of the whole sphere with its reductions to half, a quarter, … of the size, down to a side of one pixel.
#[derive(Debug, Clone)]
pub struct Equirectangular {
    levels: Vec<Level>,
    /// Told if it may be no picture of the whole sphere.
    warnings: Vec<String>,
}

/// One size of the picture, row by row from the top.
#[derive(Clone)]
struct Level {
    width: usize,
    height: usize,
    pixels: Vec<Vec3>,
}

/// Writes a digest in place of the pixels.
impl fmt::Debug for Level {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let values = self.pixels.iter().flat_map(|pixel| pixel.to_array());
        write!(
            f,
            "Level({}x{}, {})",
            self.width,
            self.height,
            digest(values)
        )
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

/// Light in place of what is infinite, as a sun is in a file of half precision: its largest number.
const BRIGHTEST: f32 = 65_504.0;

/// Tells of pixels whose light is no finite number.
fn light_warning(subject: &str, pixels: &Array3<f32>) -> Option<String> {
    let odd = pixels.iter().filter(|x| !x.is_finite());
    let (endless, missing) = odd.fold((0, 0), |(endless, missing), x| match *x {
        f32::INFINITY => (endless + 1, missing),
        _ => (endless, missing + 1),
    });
    (endless + missing > 0).then(|| {
        format!(
            "{subject}: {endless} infinite numbers are drawn as {BRIGHTEST}, {missing} that are none as 0"
        )
    })
}

impl Equirectangular {
    /// Takes rows from the top × columns × 3; `subject` is the picture's name for a complaint.
    fn new(subject: &str, pixels: &Array3<f32>) -> Result<Self> {
        let (height, width, channels) = pixels.dim();
        if channels != 3 || height == 0 || width == 0 {
            let message = "a sky picture needs at least one pixel of three channels";
            return Err(Error::input(subject, message));
        }
        // One bad pixel of a float picture would spread through every reduction.
        let light = |x: f32| match x {
            f32::INFINITY => BRIGHTEST,
            x if x.is_finite() => x.max(0.0),
            _ => 0.0,
        };
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
            warnings: [
                shape_warning(subject, width, height),
                light_warning(subject, pixels),
            ]
            .into_iter()
            .flatten()
            .collect(),
        })
    }

    /// Returns linear light from the unit vector `d`, averaged over about `footprint` radians.
    fn radiance(&self, d: Vec3, footprint: f32) -> Vec3 {
        let [texel, last] = self.texel_last();
        self.radiance_at(picture_place(d).extend(picture_level(footprint / texel, last)))
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
        let taps = LaneTaps::of(across, 0.0);
        taps.mean(
            d,
            wanted,
            #[inline(always)]
            |places, within| self.radiances(places, &taps.width, within),
        )
    }

    /// Computes [`Equirectangular::radiance`] in the lanes that are `wanted`.
    #[inline(always)]
    fn radiances(&self, d: &SingleVectors, widths: &SingleLanes, wanted: &Mask) -> SingleVectors {
        let [texel, last] = self.texel_last();
        let places = single_vector(
            #[inline(always)]
            |l| picture_place(single_lane(d, l)).extend(picture_level(widths[l] / texel, last)),
        );
        let mut light = [[0.0; LANES]; 3];
        for l in (0..LANES).filter(|l| wanted[*l]) {
            set_lane(&mut light, l, self.radiance_at(single_lane(&places, l)));
        }
        light
    }

    /// Returns the height of a pixel of the picture, radians, and the number of the smallest size.
    #[inline(always)]
    fn texel_last(&self) -> [f32; 2] {
        let texel = PI / self.levels[0].height as f32;
        [texel, (self.levels.len() - 1) as f32]
    }

    /// Returns the light at a place of the picture (x and y) on a level (z).
    fn radiance_at(&self, at: Vec3) -> Vec3 {
        let (low, way) = (at.z as usize, at.z.fract());
        let sharp = self.levels[low].bilinear(at.x, at.y);
        if way == 0.0 {
            return sharp;
        }
        sharp.lerp(self.levels[low + 1].bilinear(at.x, at.y), way)
    }
}

/// Returns the place of a direction in the picture, from the left and the top, both in [0, 1].
#[inline(always)]
fn picture_place(d: Vec3) -> Vec2 {
    let (longitude, latitude) = longitude_latitude(d);
    Vec2::new(0.5 - longitude / TAU, 0.5 - latitude / PI)
}

/// Returns the number of the size of the picture whose pixels are `texels` times as wide as those of the full
/// one, which has number 0; fractions are between two sizes.
#[inline(always)]
fn picture_level(texels: f32, last: f32) -> f32 {
    less(Real::ln(more(texels, 1.0)) * LOG2_E, last)
}

impl Level {
    /// Reduces to half the size, odd sides to the half rounded down, by means over the part of the sphere that each new
    /// pixel covers; `None` when a side is a single pixel.
    fn halved(&self) -> Option<Self> {
        if self.width == 1 || self.height == 1 {
            return None;
        }
        // The height of a zone of the unit sphere is its solid angle over 2π.
        let zone = |y: f32| (PI * y / self.height as f32).cos();
        let pixel = |y: usize, x: usize| self.pixels[y * self.width + x];
        Some(Self {
            width: half(self.width),
            height: half(self.height),
            pixels: halved([self.height, self.width], zone, pixel),
        })
    }

    /// Interpolates bilinearly at `u` from the left and `v` from the top, both in [0, 1]; `u` wraps
    /// around, and past a pole the row goes on half a turn away.
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

    /// Interpolates between the pixels at `column` and one further right, `column` counted around.
    fn between(&self, row: usize, column: usize, over_a_pole: bool, way: f32) -> Vec3 {
        let turned = column + if over_a_pole { self.width / 2 } else { 0 };
        let (left, right) = (turned % self.width, (turned + 1) % self.width);
        let start = row * self.width;
        self.pixels[start + left].lerp(self.pixels[start + right], way)
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
    let (small, large) = (less(x.abs(), y.abs()), more(x.abs(), y.abs()));
    let ratio = small / more(large, f32::MIN_POSITIVE);
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

/// The key under `[sky]` for paths that end by their length.
const LENGTH: &str = "length";

/// Loads the skies of `scene`: one for each exit, and last the one of paths that end by their length.
pub(super) fn load_skies(scene: &SceneFile, manifold: &Manifold) -> Result<Vec<Option<Sky>>> {
    let mut skies: Vec<Option<Sky>> = Vec::new();
    skies.resize_with(manifold.exits.len() + 1, || None);
    for (name, span, entry) in &scene.skies {
        let index = match name.as_str() {
            LENGTH => Some(manifold.exits.len()),
            name => manifold.exit_named(name),
        };
        let Some(index) = index else {
            let known: Vec<&str> = manifold.exits.iter().map(|e| e.name.as_str()).collect();
            let complaint = Diagnostic::new(
                &scene.source,
                span.clone(),
                format!("the manifold has no exit `{name}`"),
            );
            let known = known.join(", ");
            return Err(complaint
                .with_hint(format!("its exits: {known}, {LENGTH}"))
                .into());
        };
        skies[index] = Some(Sky::load(entry)?);
    }
    Ok(skies)
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
