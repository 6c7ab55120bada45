//! Materials of surfaces, and their textures: pictures over the plane of texture coordinates.
//!
//! In: pixels, and how a material lays them on a surface ([`Mapping`]). Out: colours and opacities at
//! texture coordinates; colours averaged over what a sample stands for.

use crate::{
    Footprint,
    halving::{self, half},
    picture::{Pixels, digest},
};
use glam::Vec3;
use ndarray::{Array2, Array3};
use std::{fmt, sync::Arc};

/// The optical properties of a surface: reflection, transmission, emission.
#[derive(Debug, Clone)]
pub struct Material {
    /// Its name in the MTL file.
    pub name: String,
    /// Diffuse reflectance (`Kd`), linear.
    pub kd: [f32; 3],
    /// Specular reflectance (`Ks`), linear.
    pub ks: [f32; 3],
    /// Phong exponent of the specular part (`Ns`).
    pub ns: f32,
    /// Radiance given off (`Ke`), linear.
    pub ke: [f32; 3],
    /// Opacity (`d`): 1 solid, 0 not there.
    pub dissolve: f32,
    /// Index of refraction (`Ni`).
    pub ni: f32,
    /// The illumination model's number (`illum`): 2 matt and glossy, 3 to 5 mirror, 6 and 7 glass.
    pub illumination: u8,
    /// Texture that multiplies `kd` (`map_Kd`).
    pub map_kd: Option<TextureMap>,
    /// Opacity that multiplies `dissolve`: `map_d`, else what `map_Kd` has beside its colours.
    pub map_d: Option<OpacityMap>,
    /// Texture that multiplies `ke` (`map_Ke`).
    pub map_ke: Option<TextureMap>,
}

impl Default for Material {
    /// Returns a matt light grey.
    fn default() -> Self {
        Self {
            name: String::from("default grey"),
            kd: [0.7; 3],
            ks: [0.0; 3],
            ns: 10.0,
            ke: [0.0; 3],
            dissolve: 1.0,
            ni: 1.5,
            illumination: 2,
            map_kd: None,
            map_d: None,
            map_ke: None,
        }
    }
}

impl Material {
    /// Tells whether it may let light through unturned.
    pub fn is_clear(&self) -> bool {
        self.dissolve < 1.0 || self.map_d.is_some()
    }

    /// Tells whether a texture says what it looks like.
    pub fn is_textured(&self) -> bool {
        self.map_kd.is_some() || self.map_ke.is_some()
    }

    /// Tells whether it turns light that goes through it (`illum` 6 and 7).
    pub fn is_glass(&self) -> bool {
        matches!(self.illumination, 6 | 7)
    }

    /// Tells whether much of what is seen of it is what it reflects or lets through, which only following light from surface to
    /// surface shows: mirrors, glass, metal.
    pub fn shows_surroundings(&self) -> bool {
        let is_metal = self.kd == [0.0; 3] && self.map_kd.is_none() && self.gloss() != [0.0; 3];
        let is_mirror = matches!(self.illumination, 3 | 4 | 5 | 8);
        self.is_glass() || is_mirror || is_metal
    }

    /// Returns the reflectance of its gloss or mirror: none where it is matt.
    pub fn gloss(&self) -> [f32; 3] {
        match self.illumination {
            0 | 1 => [0.0; 3],
            _ => self.ks,
        }
    }

    /// Returns the most that it stops of the light that does not turn: glass says by `d` that it is clear, not
    /// that it is not there.
    pub fn solid(&self) -> f32 {
        if self.is_glass() { 1.0 } else { self.dissolve }
    }
}

/// A picture that repeats over the plane of texture coordinates.
#[derive(Clone)]
pub struct Texture {
    /// Rows from the top × columns × linear red, green, blue; then the same at half the size, a
    /// quarter, … down to one pixel.
    levels: Vec<Array3<f32>>,
}

/// Writes a digest in place of the pixels.
impl fmt::Debug for Texture {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let pixels = &self.levels[0];
        let digest = digest(pixels.iter().copied());
        write!(f, "Texture({:?}, {digest})", pixels.dim())
    }
}

impl Texture {
    /// Wraps rows from the top × columns × 3; `None` if there is no pixel.
    pub fn new(pixels: Array3<f32>) -> Option<Self> {
        let (height, width, channels) = pixels.dim();
        if height == 0 || width == 0 || channels != 3 {
            return None;
        }
        let mut levels = vec![pixels];
        while let Some(half) = levels.last().and_then(halved) {
            levels.push(half);
        }
        Some(Self { levels })
    }

    /// Returns its pixels.
    pub(super) fn pixels(&self) -> Pixels {
        let pixels = &self.levels[0];
        Pixels {
            shape: pixels.dim(),
            values: pixels.iter().copied().collect(),
        }
    }

    /// Returns linear colour at the place `(u, v)`, averaged over a footprint in texture widths; `mapping` says what is beside
    /// the picture and between its pixels.
    fn filtered(&self, [u, v]: [f32; 2], footprint: &Footprint, mapping: &Mapping) -> [f32; 3] {
        let taps = footprint.taps(0.0);
        let (height, columns, _) = self.levels[0].dim();
        let texels = taps.width * height.max(columns) as f32;
        let last = self.levels.len() - 1;
        let level = texels.max(1.0).log2().min(last as f32);
        let (low, way) = (level as usize, level.fract());
        let mut sum = [0.0; 3];
        for tap in taps.places() {
            let (u, v) = (f64::from(u + tap.x), f64::from(v + tap.y));
            let sharp = self.sample_level(low, u, v, mapping);
            let soft = self.sample_level((low + 1).min(last), u, v, mapping);
            for c in 0..3 {
                sum[c] += lerp(sharp[c], soft[c], way);
            }
        }
        sum.map(|x| x / taps.count)
    }

    /// Returns linear colour at `(u, v)`, bilinear and repeating; `v` grows upwards as OBJ has it.
    #[cfg(test)]
    pub(super) fn sample(&self, u: f64, v: f64) -> [f32; 3] {
        self.sample_level(0, u, v, &Mapping::default())
    }

    fn sample_level(&self, level: usize, u: f64, v: f64, mapping: &Mapping) -> [f32; 3] {
        let pixels = &self.levels[level];
        let (height, width, _) = pixels.dim();
        let [(x0, x1, fx), (y0, y1, fy)] = mapping.beside([u, v], [width, height], level == 0);
        std::array::from_fn(|c| {
            let top = lerp(pixels[[y0, x0, c]], pixels[[y0, x1, c]], fx);
            let bottom = lerp(pixels[[y1, x0, c]], pixels[[y1, x1, c]], fx);
            lerp(top, bottom, fy)
        })
    }
}

/// Reduces to half the size, odd sides to the half rounded down, by means of the pixels that each new one covers; `None` for
/// a single pixel.
fn halved(pixels: &Array3<f32>) -> Option<Array3<f32>> {
    let (height, width, _) = pixels.dim();
    if height == 1 && width == 1 {
        return None;
    }
    let pixel = |y: usize, x: usize| Vec3::from_array([0, 1, 2].map(|c| pixels[[y, x, c]]));
    let means = halving::halved([height, width], |y| y, pixel);
    let (height, width) = (half(height), half(width));
    Some(Array3::from_shape_fn((height, width, 3), |(y, x, c)| {
        means[y * width + x][c]
    }))
}

/// Says what is beside a picture, along one of its sides.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Wrap {
    /// The picture again.
    #[default]
    Repeat,
    /// Its edge.
    Clamp,
    /// Its mirror image, and then it again.
    Mirror,
}

/// Two pixels beside a place along a side, and the weight of the second.
type Beside = (usize, usize, f32);

impl Wrap {
    /// Returns the two pixels beside a place, of so many.
    fn beside(self, t: f64, count: usize) -> Beside {
        match self {
            Self::Repeat => repeating(t, count),
            Self::Clamp => clamped(t, count),
            Self::Mirror => {
                let t = t.rem_euclid(2.0);
                clamped(t.min(2.0 - t), count)
            }
        }
    }
}

/// Returns the two pixels beside a place and the weight of the second, where the picture repeats.
fn repeating(t: f64, count: usize) -> Beside {
    let at = t.rem_euclid(1.0) * count as f64 - 0.5;
    let low = at.floor();
    let first = (low + count as f64) as usize % count;
    (first, (first + 1) % count, (at - low) as f32)
}

/// Returns the two pixels beside a place and the weight of the second, where the edge of the picture goes on.
fn clamped(t: f64, count: usize) -> Beside {
    let last = (count - 1) as f64;
    // A coordinate that is no number takes the first pixel.
    let at = (t * count as f64 - 0.5).max(0.0).min(last);
    let first = at.floor();
    (
        first as usize,
        (first as usize + 1).min(count - 1),
        (at - first) as f32,
    )
}

fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

/// The map from texture coordinates to places of a texture, and from its values to those used: the
/// options of a map in an MTL file, or the sampler of a glTF texture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mapping {
    /// Coordinates times this (`-s`) …
    pub scale: [f32; 2],
    /// … plus the other one times this, not zero where the texture is turned …
    pub cross: [f32; 2],
    /// … plus this (`-o`) are the place.
    pub offset: [f32; 2],
    /// What is beside the texture along its rows, and along its columns (`-clamp on`: [`Wrap::Clamp`]).
    pub wrap: [Wrap; 2],
    /// Set if its pixels are squares of one colour where they are large in the picture, and not interpolated between.
    pub nearest: bool,
    /// Values times the second plus the first are used (`-mm`).
    pub range: [f32; 2],
}

impl Default for Mapping {
    fn default() -> Self {
        Self {
            scale: [1.0; 2],
            cross: [0.0; 2],
            offset: [0.0; 2],
            wrap: [Wrap::Repeat; 2],
            nearest: false,
            range: [0.0, 1.0],
        }
    }
}

impl Mapping {
    /// Returns how far the place moves when the coordinates change.
    fn change(&self, uv: [f32; 2]) -> [f32; 2] {
        [0, 1].map(|k| uv[k] * self.scale[k] + uv[1 - k] * self.cross[k])
    }

    fn place(&self, uv: [f32; 2]) -> [f32; 2] {
        let turned = self.change(uv);
        [0, 1].map(|k| {
            let place = turned[k] + self.offset[k];
            match self.wrap[k] {
                // A footprint at the edge is of the edge alone.
                Wrap::Clamp => place.clamp(0.0, 1.0),
                Wrap::Repeat | Wrap::Mirror => place,
            }
        })
    }

    /// Returns the pixels beside the place `(u, v)` of a picture with so many columns and rows, `v` upwards; `large` says
    /// that they are its own, not means of them.
    fn beside(&self, [u, v]: [f64; 2], [columns, rows]: [usize; 2], large: bool) -> [Beside; 2] {
        let along = self.wrap[0].beside(u, columns);
        let down = self.wrap[1].beside(1.0 - v, rows);
        match self.nearest && large {
            true => [along, down].map(|(first, second, way)| (first, second, way.round())),
            false => [along, down],
        }
    }

    fn value(&self, x: f32) -> f32 {
        self.range[0] + self.range[1] * x
    }
}

/// A texture as a material uses it.
#[derive(Debug, Clone)]
pub struct TextureMap {
    /// The texture.
    pub texture: Arc<Texture>,
    /// Its placement on the surface.
    pub mapping: Mapping,
}

impl TextureMap {
    /// Returns linear colour at texture coordinates, averaged over a footprint in them.
    pub fn filtered(&self, uv: [f32; 2], footprint: &Footprint) -> [f32; 3] {
        let mapping = &self.mapping;
        let across = footprint.across.map(|change| {
            let [u, v] = mapping.change([change.x, change.y]);
            Vec3::new(u, v, change.z)
        });
        let colour = self
            .texture
            .filtered(mapping.place(uv), &Footprint { across }, mapping);
        colour.map(|x| mapping.value(x).max(0.0))
    }
}

/// An opacity in [0, 1] that changes over a surface.
#[derive(Clone)]
pub struct OpacityMap {
    /// Rows from the top × columns.
    pub values: Arc<Array2<f32>>,
    /// Its placement on the surface.
    pub mapping: Mapping,
}

/// Writes a digest in place of the values.
impl fmt::Debug for OpacityMap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let digest = digest(self.values.iter().copied());
        let (size, mapping) = (self.values.dim(), self.mapping);
        write!(f, "OpacityMap({size:?}, {digest}, {mapping:?})")
    }
}

impl OpacityMap {
    /// Returns the opacity at texture coordinates.
    pub fn at(&self, uv: [f32; 2]) -> f32 {
        let [u, v] = self.mapping.place(uv).map(f64::from);
        let (height, width) = self.values.dim();
        let [(x0, x1, fx), (y0, y1, fy)] = self.mapping.beside([u, v], [width, height], true);
        let row = |y: usize| lerp(self.values[[y, x0]], self.values[[y, x1]], fx);
        self.mapping
            .value(lerp(row(y0), row(y1), fy))
            .clamp(0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_that_differ_in_one_value_are_written_unlike() {
        let written = |last: f32| {
            let mut colours = Array3::from_elem((90, 80, 3), 0.5);
            let mut opacity = Array2::from_elem((90, 80), 0.5);
            (colours[[45, 40, 1]], opacity[[45, 40]]) = (last, last);
            let opacity = OpacityMap {
                values: Arc::new(opacity),
                mapping: Mapping::default(),
            };
            [
                format!("{:?}", Texture::new(colours).unwrap()),
                format!("{opacity:?}"),
            ]
        };
        assert_eq!(written(0.5), written(0.5));
        let [a, b] = [written(0.5), written(0.500_001)];
        assert!(a[0] != b[0] && a[1] != b[1], "{a:?} {b:?}");
        // A digest, not seven thousand numbers.
        assert!(a.iter().all(|text| text.len() < 500), "{a:?}");
    }

    fn four_colours() -> Texture {
        let rows = vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0];
        Texture::new(Array3::from_shape_vec((2, 2, 3), rows).unwrap()).unwrap()
    }

    #[test]
    fn reductions_of_any_size_keep_the_mean() {
        for (height, width) in [(257, 257), (300, 7), (1, 1025), (1000, 64)] {
            // All light is in the last column.
            let last = |(_, x, _)| f32::from(u8::from(x == width - 1));
            let texture = Texture::new(Array3::from_shape_fn((height, width, 3), last)).unwrap();
            for level in &texture.levels {
                let mean = level.mean().unwrap() * width as f32;
                assert!((mean - 1.0).abs() < 1e-3, "{:?}: {mean}", level.dim());
            }
            assert_eq!(texture.levels.last().unwrap().dim(), (1, 1, 3));
        }
    }

    #[test]
    fn a_texture_repeats_and_has_its_first_row_on_top() {
        let texture = four_colours();
        assert_eq!(texture.sample(0.25, 0.75), [1.0, 0.0, 0.0]);
        assert_eq!(texture.sample(0.75, 0.75), [0.0, 1.0, 0.0]);
        assert_eq!(texture.sample(1.25, -0.75), [0.0, 0.0, 1.0]);
        assert_eq!(texture.sample(0.0, 0.5), [0.5, 0.5, 0.5]);
        assert!(texture.sample(f64::NAN, f64::INFINITY)[0].is_nan());
    }

    #[test]
    fn a_mapping_scales_shifts_clamps_and_stretches_values() {
        let map = |mapping: Mapping| {
            let texture = Arc::new(four_colours());
            let map = TextureMap { texture, mapping };
            move |u: f32, v: f32| map.filtered([u, v], &Footprint::POINT)
        };
        let mapping = Mapping::default();
        let twice = map(Mapping {
            scale: [2.0, 1.0],
            ..mapping
        });
        assert_eq!(twice(0.375, 0.75), [0.0, 1.0, 0.0]);
        // A quarter turn: what lay to the right lies above.
        let turned = map(Mapping {
            scale: [0.0; 2],
            cross: [1.0, -1.0],
            offset: [0.0, 1.0],
            ..mapping
        });
        for (u, v) in [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)] {
            assert_eq!(turned(u, v), map(mapping)(v, 1.0 - u));
        }
        let moved = map(Mapping {
            offset: [0.5, 0.0],
            ..mapping
        });
        assert_eq!(moved(0.25, 0.75), [0.0, 1.0, 0.0]);
        let clamped = map(Mapping {
            wrap: [Wrap::Clamp; 2],
            ..mapping
        });
        assert_eq!(
            [clamped(7.0, 0.75), clamped(-7.0, 9.0)],
            [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]
        );
        let across = map(Mapping {
            wrap: [Wrap::Clamp, Wrap::Repeat],
            ..mapping
        });
        assert_eq!(
            [across(7.0, 1.75), across(7.0, -0.75)],
            [[0.0, 1.0, 0.0], [1.0; 3]]
        );
        let mirrored = map(Mapping {
            wrap: [Wrap::Mirror, Wrap::Repeat],
            ..mapping
        });
        // From left to right: red, green, green, red, red.
        let row = [0.25, 0.75, 1.25, 1.75, 2.25].map(|u| mirrored(u, 0.75)[1]);
        assert_eq!(row, [0.0, 1.0, 1.0, 0.0, 0.0]);
        assert_eq!(
            [mirrored(-0.25, 0.75)[1], mirrored(1.0, 0.75)[1]],
            [0.0, 1.0]
        );
        let squares = map(Mapping {
            nearest: true,
            ..mapping
        });
        assert_eq!(
            [squares(0.45, 0.75), squares(0.55, 0.75)],
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
        );
        let range = map(Mapping {
            range: [0.25, 0.5],
            ..mapping
        });
        assert_eq!(range(0.25, 0.75), [0.75, 0.25, 0.25]);
    }
}
