//! Materials (MTL) and the textures they name.
//!
//! In: the text of an MTL file. Out: [`Material`]s in linear light, and a warning for every line
//! that had to be dropped or mended. A damaged MTL never stops a mesh from loading.
//!
//! `tobj` parses the text, but panics on a colour of fewer than three numbers and gives up the
//! whole file at the first bad number; so each line is checked and mended before `tobj` sees it.

use crate::{
    Footprint,
    picture::{self, digest},
};
use ndarray::Array3;
use std::{
    collections::HashMap,
    fmt,
    path::{Path, PathBuf},
    sync::Arc,
};

/// How a surface reflects, lets through and gives off light.
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
    /// The illumination model's number (`illum`): 2 matt and glossy, 3 and 5 mirror, 4, 6, 7 and 9
    /// glass.
    pub illumination: u8,
    /// Texture that multiplies `kd` (`map_Kd`).
    pub map_kd: Option<Arc<Texture>>,
}

impl Default for Material {
    /// A matt light grey.
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
        }
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
        write!(
            f,
            "Texture({:?}, {})",
            pixels.dim(),
            digest(pixels.iter().copied())
        )
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

    /// Linear colour at `uv`, averaged over a footprint in texture widths.
    pub fn filtered(&self, [u, v]: [f32; 2], footprint: &Footprint) -> [f32; 3] {
        let taps = footprint.taps(0.0);
        let (height, columns, _) = self.levels[0].dim();
        let texels = taps.width * height.max(columns) as f32;
        let last = self.levels.len() - 1;
        let level = texels.max(1.0).log2().min(last as f32);
        let (low, way) = (level as usize, level.fract());
        let mut sum = [0.0; 3];
        for tap in taps.places() {
            let (u, v) = (f64::from(u + tap.x), f64::from(v + tap.y));
            let sharp = self.sample_level(low, u, v);
            let soft = self.sample_level((low + 1).min(last), u, v);
            for c in 0..3 {
                sum[c] += lerp(sharp[c], soft[c], way);
            }
        }
        sum.map(|x| x / taps.count)
    }

    /// Linear colour at `(u, v)`, bilinear and repeating; `v` grows upwards as OBJ has it.
    pub fn sample(&self, u: f64, v: f64) -> [f32; 3] {
        self.sample_level(0, u, v)
    }

    fn sample_level(&self, level: usize, u: f64, v: f64) -> [f32; 3] {
        let pixels = &self.levels[level];
        let (height, width, _) = pixels.dim();
        let (x0, x1, fx) = neighbours(u, width);
        let (y0, y1, fy) = neighbours(-v, height);
        std::array::from_fn(|c| {
            let top = lerp(pixels[[y0, x0, c]], pixels[[y0, x1, c]], fx);
            let bottom = lerp(pixels[[y1, x0, c]], pixels[[y1, x1, c]], fx);
            lerp(top, bottom, fy)
        })
    }
}

/// Half the size, by means of up to 2 × 2 pixels; `None` for a single pixel.
fn halved(pixels: &Array3<f32>) -> Option<Array3<f32>> {
    let (height, width, _) = pixels.dim();
    if height == 1 && width == 1 {
        return None;
    }
    let half = |n: usize| n.div_ceil(2);
    Some(Array3::from_shape_fn(
        (half(height), half(width), 3),
        |(y, x, c)| {
            let rows = 2 * y..(2 * y + 2).min(height);
            let columns = 2 * x..(2 * x + 2).min(width);
            let count = (rows.len() * columns.len()) as f32;
            let cells = rows.flat_map(|y| columns.clone().map(move |x| (y, x)));
            cells.map(|(y, x)| pixels[[y, x, c]]).sum::<f32>() / count
        },
    ))
}

/// The two pixel centres around the repeating coordinate `t`, and the way between them.
fn neighbours(t: f64, count: usize) -> (usize, usize, f32) {
    let at = t.rem_euclid(1.0) * count as f64 - 0.5;
    let low = at.floor();
    let first = (low + count as f64) as usize % count;
    (first, (first + 1) % count, (at - low) as f32)
}

fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

/// Mends the text of an MTL file so that `tobj` reads all of it; says what was dropped.
pub(super) fn mend_mtl(name: &str, text: &str, warnings: &mut Vec<String>) -> String {
    let mut mended = String::with_capacity(text.len());
    for (i, line) in text.lines().enumerate() {
        match mend_line(line) {
            Some(line) => mended.push_str(&line),
            None => warnings.push(format!("{name}:{}: ignored `{}`", i + 1, line.trim())),
        }
        mended.push('\n');
    }
    mended
}

/// The line as `tobj` can read it, or nothing if it makes no sense.
fn mend_line(line: &str) -> Option<String> {
    let line = line.trim();
    let (key, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
    let rest = rest.trim();
    let words = || rest.split_whitespace();
    match key {
        "Kd" | "Ks" | "Ke" => {
            let given: Option<Vec<f32>> = words().map(not_negative).collect();
            let [r, g, b] = match given?.as_slice() {
                [grey] => [*grey; 3],
                [r, g, b] => [*r, *g, *b],
                _ => return None,
            };
            Some(format!("{key} {r} {g} {b}"))
        }
        "Ns" | "Ni" => Some(format!("{key} {}", not_negative(words().next()?)?)),
        "illum" => Some(format!("illum {}", words().next()?.parse::<u8>().ok()?)),
        "d" => Some(format!("d {}", not_negative(words().last()?)?.min(1.0))),
        "Tr" => Some(format!(
            "d {}",
            1.0 - not_negative(words().next()?)?.min(1.0)
        )),
        "newmtl" | "map_Kd" => (!rest.is_empty()).then(|| format!("{key} {rest}")),
        // The renderer uses nothing else, so nothing else needs to reach the parser.
        _ => Some(String::new()),
    }
}

fn not_negative(word: &str) -> Option<f32> {
    word.parse()
        .ok()
        .filter(|x: &f32| x.is_finite() && *x >= 0.0)
}

/// Reads textures, each file once.
pub(super) struct TextureShelf<'a> {
    folder: &'a Path,
    loaded: HashMap<PathBuf, Option<Arc<Texture>>>,
}

impl<'a> TextureShelf<'a> {
    /// Texture names will be relative to `folder`.
    pub(super) fn new(folder: &'a Path) -> Self {
        Self {
            folder,
            loaded: HashMap::new(),
        }
    }

    /// The material with its texture; a texture that cannot be read leaves `Kd` alone.
    pub(super) fn material(
        &mut self,
        from: &tobj::Material,
        warnings: &mut Vec<String>,
    ) -> Material {
        let grey = Material::default();
        let map = from.diffuse_texture.as_deref();
        Material {
            name: from.name.clone(),
            kd: from.diffuse.unwrap_or(grey.kd),
            ks: from.specular.unwrap_or(grey.ks),
            ns: from.shininess.unwrap_or(grey.ns),
            ke: from.emissive.unwrap_or(grey.ke),
            dissolve: from.dissolve.unwrap_or(grey.dissolve),
            ni: from.optical_density.unwrap_or(grey.ni),
            illumination: from.illumination_model.unwrap_or(grey.illumination),
            map_kd: map.and_then(|map| self.texture(map, warnings)),
        }
    }

    fn texture(&mut self, map: &str, warnings: &mut Vec<String>) -> Option<Arc<Texture>> {
        let path = self.locate(map);
        if let Some(known) = self.loaded.get(&path) {
            return known.clone();
        }
        let texture = match picture::read(&path).map(|picture| picture.rgb) {
            Ok(pixels) => Texture::new(pixels).map(Arc::new),
            Err(error) => {
                warnings.push(format!("texture left out: {error}"));
                None
            }
        };
        self.loaded.insert(path, texture.clone());
        texture
    }

    /// The file that `map_Kd` means: names may hold spaces, backslashes, or options in front.
    fn locate(&self, map: &str) -> PathBuf {
        let map = map.replace('\\', "/");
        let whole = self.folder.join(&map);
        if whole.is_file() || !map.starts_with('-') {
            return whole;
        }
        let last = map.split_whitespace().last().unwrap_or_default();
        self.folder.join(last)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_that_would_stop_the_parser_are_mended_or_named() {
        let text =
            "newmtl a\nKd 0.5\nKs 1 2\nNs x\n\td -halo 0.3\nTr 0.25\nKe nan 0 0\nnewmtl\nillum\n";
        let mut warnings = Vec::new();
        let mended = mend_mtl("a.mtl", text, &mut warnings);
        assert_eq!(
            mended,
            "newmtl a\nKd 0.5 0.5 0.5\n\n\nd 0.3\nd 0.75\n\n\n\n"
        );
        let expected = ["a.mtl:3: ignored `Ks 1 2`", "a.mtl:4: ignored `Ns x`"];
        assert_eq!(warnings[..2], expected);
        assert_eq!(warnings.len(), 5);
    }

    #[test]
    fn a_texture_repeats_and_has_its_first_row_on_top() {
        let rows = vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0];
        let texture = Texture::new(Array3::from_shape_vec((2, 2, 3), rows).unwrap()).unwrap();
        assert_eq!(texture.sample(0.25, 0.75), [1.0, 0.0, 0.0]);
        assert_eq!(texture.sample(0.75, 0.75), [0.0, 1.0, 0.0]);
        assert_eq!(texture.sample(1.25, -0.75), [0.0, 0.0, 1.0]);
        assert_eq!(texture.sample(0.0, 0.5), [0.5, 0.5, 0.5]);
        assert!(texture.sample(f64::NAN, f64::INFINITY)[0].is_nan());
    }
}
