//! Finished pictures: held in memory, written, read, compared and labelled.
//!
//! In: linear light per pixel and any number of further values per pixel (layers).
//! Out: PNG and OpenEXR files, and the numbers and pictures that say how two pictures differ.
//! Arrays are (row, column), row 0 at the top; colours are linear with Rec.709 primaries and a D65
//! white, 1 being the white of a screen, except where a name says sRGB.
//!
//! In few bytes, for pages, which bring no readers of other formats along: numbers row by row, so many channels a pixel,
//! as bytes that compress well ([`Pixels`]).
//!
//! Layout, little-endian: width and height (u32), channels (u8), the coding (u8), then for each byte of a value,
//! the highest first, that byte of all values. A value is a whole number: a code value of 8 bits in sRGB (coding 0)
//! or linear (1) where all numbers are such, which keeps them exactly; else (2) a single-precision number without
//! its last 12 bits, rounded: at most 2⁻¹² of itself off, if it is above 1e-38. Of each value what the Paeth predictor of PNG foretells is
//! taken away (W3C, *PNG Specification*, filter type 4).

#[cfg(feature = "formats")]
mod colour_space;
#[cfg(feature = "formats")]
pub mod exr;
#[cfg(feature = "formats")]
mod image_files;
mod tone_table;

use geofan_core::{
    error::{Error, Result},
    reading::{MOST_OF_A_FILE, read_one_of},
};
use ndarray::{Array2, Array3, s};
use std::{array, ops::Range, path::Path};

#[cfg(feature = "formats")]
pub use exr::{Precision, read_exr, write_exr};
#[cfg(feature = "formats")]
pub use image_files::write_png;
pub use tone_table::ToneTable;

/// The most pixels a file may have: a 16384 by 8192 sky. A damaged header can ask for any size, and
/// memory that is not there ends the process instead of giving a message.
pub const MAX_PIXELS: usize = 1 << 27;

/// A picture in linear light with its layers.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Picture {
    /// (height, width, 3): red, green and blue.
    pub rgb: Array3<f32>,
    /// Further values, each of the picture's size.
    pub layers: Vec<Layer>,
}

/// One more value per pixel, named as EXR readers expect: `Z`, `P.X`, `N.X`, `id`.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// The channel's name.
    pub name: String,
    /// (height, width) values.
    pub values: LayerValues,
}

/// The values of a layer.
#[derive(Debug, Clone, PartialEq)]
pub enum LayerValues {
    /// Measured quantities.
    Float(Array2<f32>),
    /// Numbers of objects or exits, and flags.
    Index(Array2<u32>),
}

impl LayerValues {
    /// Height and width.
    pub fn dim(&self) -> (usize, usize) {
        match self {
            Self::Float(values) => values.dim(),
            Self::Index(values) => values.dim(),
        }
    }
}

/// Goes with a picture into an EXR file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Metadata {
    /// Command line, manifold, version, camera.
    pub notes: Vec<(String, String)>,
    /// The picture that this is a part of, which becomes the display window.
    pub frame: Option<Frame>,
    /// Width of a picture in perspective at distance 1.
    pub screen_width: Option<f32>,
}

/// A picture of which only a part is there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame {
    /// Pixels across and down.
    pub size: (usize, usize),
    /// Where the part's upper left pixel is.
    pub corner: (usize, usize),
}

impl Metadata {
    /// Adds a note.
    pub fn with(mut self, key: impl Into<String>, text: impl Into<String>) -> Self {
        self.notes.push((key.into(), text.into()));
        self
    }

    /// Returns the last note of a key.
    pub fn note(&self, key: &str) -> Option<&str> {
        let mut notes = self.notes.iter().rev();
        notes.find_map(|(of, text)| (of == key).then_some(text.as_str()))
    }
}

impl Picture {
    /// A picture without layers from (height, width, 3) linear light.
    ///
    /// # Panics
    /// If the last dimension is not 3.
    pub fn new(rgb: Array3<f32>) -> Self {
        assert_eq!(rgb.dim().2, 3, "a picture has three colours");
        let layers = Vec::new();
        Self { rgb, layers }
    }

    /// A picture of one linear colour.
    pub fn filled(width: usize, height: usize, colour: [f32; 3]) -> Self {
        Self::from_fn(width, height, |_, _| colour)
    }

    /// A picture whose pixel in column `x` and row `y` is the linear colour `colour(x, y)`.
    pub fn from_fn(
        width: usize,
        height: usize,
        mut colour: impl FnMut(usize, usize) -> [f32; 3],
    ) -> Self {
        let mut rgb = Array3::zeros((height, width, 3));
        for (i, mut pixel) in rgb.rows_mut().into_iter().enumerate() {
            pixel.assign(&ndarray::arr1(&colour(i % width, i / width)));
        }
        Self::new(rgb)
    }

    /// Adds a layer of measured quantities; [`write()`] refuses a layer of another size.
    pub fn with_float(mut self, name: impl Into<String>, values: Array2<f32>) -> Self {
        let (name, values) = (name.into(), LayerValues::Float(values));
        self.layers.push(Layer { name, values });
        self
    }

    /// Adds a layer of whole numbers; [`write()`] refuses a layer of another size.
    pub fn with_index(mut self, name: impl Into<String>, values: Array2<u32>) -> Self {
        let (name, values) = (name.into(), LayerValues::Index(values));
        self.layers.push(Layer { name, values });
        self
    }

    /// The values of the layer called `name`.
    pub fn layer(&self, name: &str) -> Option<&LayerValues> {
        let layer = self.layers.iter().find(|layer| layer.name == name)?;
        Some(&layer.values)
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.rgb.dim().1
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.rgb.dim().0
    }

    /// The linear colour in column `x` and row `y`.
    ///
    /// # Panics
    /// Outside the picture.
    pub fn pixel(&self, x: usize, y: usize) -> [f32; 3] {
        [0, 1, 2].map(|channel| self.rgb[(y, x, channel)])
    }

    /// Fills the part of a rectangle that lies inside the picture with a linear colour.
    pub fn fill(&mut self, columns: Range<usize>, rows: Range<usize>, colour: [f32; 3]) {
        let (right, bottom) = (columns.end.min(self.width()), rows.end.min(self.height()));
        let (left, top) = (columns.start.min(right), rows.start.min(bottom));
        let colour = ndarray::arr1(&colour);
        let mut part = self.rgb.slice_mut(s![top..bottom, left..right, ..]);
        part.assign(&colour);
    }

    /// Copies the colours of `other` with its top left pixel at (`x`, `y`), clipped to the picture.
    pub fn paste(&mut self, x: usize, y: usize, other: &Picture) {
        let (left, top) = (x.min(self.width()), y.min(self.height()));
        let width = other.width().min(self.width() - left);
        let height = other.height().min(self.height() - top);
        let mut part = (self.rgb).slice_mut(s![top..top + height, left..left + width, ..]);
        part.assign(&other.rgb.slice(s![..height, ..width, ..]));
    }
}

/// The sRGB code value of linear light, for values below 0 and above 1 too.
pub fn srgb_encode(linear: f32) -> f32 {
    if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    }
}

/// The linear light of an sRGB code value; undoes [`srgb_encode`].
pub fn srgb_decode(code: f32) -> f32 {
    if code <= 0.040_45 {
        code / 12.92
    } else {
        ((code + 0.055) / 1.055).powf(2.4)
    }
}

/// The sRGB code value that a screen shows for linear light, within [0, 1].
pub fn srgb_shown(linear: f32) -> f32 {
    srgb_encode(displayable(linear))
}

/// Linear light within the reach of a screen; NaN becomes black.
pub fn displayable(linear: f32) -> f32 {
    linear.clamp(0.0, 1.0).max(0.0)
}

/// The formats that pictures are written in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PictureFormat {
    /// 8 bit sRGB, colours only.
    Png,
    /// Linear light, with layers.
    Exr,
}

impl PictureFormat {
    /// The format that the ending of a file's name asks for, in capitals or not.
    pub fn of(path: &Path) -> Option<Self> {
        match extension(path).as_str() {
            "png" => Some(Self::Png),
            "exr" => Some(Self::Exr),
            _ => None,
        }
    }
}

/// Writes a picture in the format of the file name's ending: `.png` (8 bit sRGB, colours only) or
/// `.exr` (colours in half floats, or in full ones where some are larger than these; all layers, `metadata`).
#[cfg(feature = "formats")]
pub fn write(path: &Path, picture: &Picture, metadata: &Metadata) -> Result<()> {
    match PictureFormat::of(path) {
        Some(PictureFormat::Png) => write_png(path, picture),
        Some(PictureFormat::Exr) => write_exr(path, picture, metadata, Precision::of(picture)),
        None => Err(bad_input(path, "a picture's name ends in .png or .exr")),
    }
}

/// Reads the linear light of a PNG, JPEG, Radiance or EXR file (whose layers come too), or of a packed picture; 8- and
/// 16-bit files are taken as sRGB, and their opacity, if they have any, is the layer `A`. What is inside counts,
/// not what the name says, because skies and textures from the net are often misnamed.
pub fn read(path: &Path) -> Result<Picture> {
    decoded(path, &read_named(path)?)
}

/// Reads a picture as [`read`] does, and tells whether its file has code values of sRGB, not light.
#[cfg(feature = "formats")]
pub(crate) fn read_with_coding(path: &Path) -> Result<(Picture, bool)> {
    let bytes = read_named(path)?;
    let is_coded = !(exr::is_exr(&bytes) || image_files::is_radiance(&bytes));
    Ok((decoded(path, &bytes)?, is_coded))
}

/// Reads the bytes of a file with a name that pictures have.
fn read_named(path: &Path) -> Result<Vec<u8>> {
    match READ.contains(&extension(path).as_str()) {
        true => read_bytes(path),
        false => {
            let message = "a picture to read is a .png, .jpg, .jpeg, .hdr, .pic or .exr file";
            Err(bad_input(path, message))
        }
    }
}

/// Decodes the bytes of the picture file `path`.
fn decoded(path: &Path, bytes: &[u8]) -> Result<Picture> {
    if let Some(bytes) = bytes.strip_prefix(MAGIC) {
        return unpacked(bytes).ok_or_else(|| bad_input(path, "is a damaged packed picture"));
    }
    decode(bytes).map_err(|e| bad_input(path, e))
}

/// Begins a picture's file.
const MAGIC: &[u8; 16] = b"geofan picture1\n";

/// Bits of a number that are left out.
const LEFT_OUT: u32 = 12;

/// Codings.
const SRGB: u8 = 0;
const LINEAR: u8 = 1;
const FLOAT: u8 = 2;

/// Numbers of a picture: rows, columns and channels, row by row.
#[derive(Debug, Clone, PartialEq)]
pub struct Pixels {
    /// Height, width, channels.
    pub shape: (usize, usize, usize),
    /// The numbers.
    pub values: Vec<f32>,
}

/// Returns the number that each code value of a coding stands for.
fn codes(coding: u8) -> [f32; 256] {
    array::from_fn(|code| match coding {
        SRGB => srgb_decode(code as f32 / 255.0),
        _ => code as f32 / 255.0,
    })
}

/// Returns the code values of `values`, if all of them are some.
fn coded(values: &[f32], coding: u8) -> Option<Vec<u32>> {
    let codes = codes(coding);
    let code = |x: &f32| {
        let code = codes.partition_point(|known| known < x);
        (codes.get(code) == Some(x)).then_some(code as u32)
    };
    values.iter().map(code).collect()
}

/// Returns a number's first bits.
fn rounded(x: f32) -> u32 {
    let bits = x.to_bits();
    let nearest = bits.saturating_add(1 << (LEFT_OUT - 1)) >> LEFT_OUT;
    // Infinities would become something else, and the largest numbers infinities.
    match x.is_finite() && f32::from_bits(nearest << LEFT_OUT).is_finite() {
        true => nearest,
        false => bits >> LEFT_OUT,
    }
}

/// Predicts a value from its left, upper and upper-left neighbours.
fn paeth(left: u32, above: u32, corner: u32) -> u32 {
    let [a, b, c] = [left, above, corner].map(i64::from);
    let guess = a + b - c;
    let [pa, pb, pc] = [a, b, c].map(|x| (guess - x).abs());
    match (pa <= pb && pa <= pc, pb <= pc) {
        (true, _) => left,
        (false, true) => above,
        _ => corner,
    }
}

/// Predicts value number `i` of `values` from those before it.
fn foretold(values: &[u32], i: usize, channels: usize, row: usize) -> u32 {
    let at = |back: usize| i.checked_sub(back).map_or(0, |k| values[k]);
    let left = if i % row < channels { 0 } else { at(channels) };
    let corner = if i % row < channels {
        0
    } else {
        at(row + channels)
    };
    paeth(left, at(row), corner)
}

impl Pixels {
    /// Tells whether all numbers are code values of 8 bits, which come back exactly.
    #[cfg(feature = "formats")]
    pub fn is_coded(&self) -> bool {
        let mut codings = [SRGB, LINEAR].into_iter();
        codings.any(|coding| coded(&self.values, coding).is_some())
    }

    /// Packs the numbers.
    pub fn pack(&self) -> Vec<u8> {
        let (height, width, channels) = self.shape;
        let coded = [SRGB, LINEAR]
            .into_iter()
            .find_map(|coding| Some((coding, coded(&self.values, coding)?)));
        let (coding, values) =
            coded.unwrap_or_else(|| (FLOAT, self.values.iter().map(|x| rounded(*x)).collect()));
        let mut bytes: Vec<u8> = [width as u32, height as u32]
            .into_iter()
            .flat_map(u32::to_le_bytes)
            .collect();
        bytes.extend([channels as u8, coding]);
        let left =
            |i: usize| values[i].wrapping_sub(foretold(&values, i, channels, width * channels));
        let left: Vec<u32> = (0..values.len()).map(left).collect();
        for k in (0..bytes_of(coding)).rev() {
            bytes.extend(left.iter().map(|x| (x >> (8 * k)) as u8));
        }
        bytes
    }

    /// Reads what [`Pixels::pack`] wrote; `None` if it is something else.
    pub fn unpack(bytes: &[u8]) -> Option<Self> {
        let (head, rest) = bytes.split_at_checked(10)?;
        let side = |at: usize| Some(u32::from_le_bytes(head[at..at + 4].try_into().ok()?) as usize);
        let (width, height, channels, coding) = (side(0)?, side(4)?, usize::from(head[8]), head[9]);
        let count = width.checked_mul(height)?.checked_mul(channels)?;
        let planes = bytes_of(coding);
        if coding > FLOAT || planes.checked_mul(count) != Some(rest.len()) {
            return None;
        }
        let (mask, row) = ((1_u64 << (8 * planes)) as u32, width * channels);
        let mut values = Vec::with_capacity(count);
        for i in 0..count {
            let part = |sum: u32, k: usize| sum << 8 | u32::from(rest[k * count + i]);
            let left = (0..planes).fold(0, part);
            let value = left.wrapping_add(foretold(&values, i, channels, row));
            values.push(value & mask.wrapping_sub(1));
        }
        let codes = codes(coding);
        let number = |x: u32| match coding {
            FLOAT => f32::from_bits(x << LEFT_OUT),
            _ => codes[x as usize & 255],
        };
        Some(Self {
            shape: (height, width, channels),
            values: values.into_iter().map(number).collect(),
        })
    }
}

/// Returns the bytes of a value.
fn bytes_of(coding: u8) -> usize {
    if coding == FLOAT { 3 } else { 1 }
}

/// Packs the colours of a picture, for a file of its own.
pub fn pack(picture: &Picture) -> Vec<u8> {
    let pixels = Pixels {
        shape: picture.rgb.dim(),
        values: picture.rgb.iter().copied().collect(),
    };
    [&MAGIC[..], &pixels.pack()].concat()
}

/// Reads what [`pack`] wrote, without its first bytes.
fn unpacked(bytes: &[u8]) -> Option<Picture> {
    let pixels = Pixels::unpack(bytes)?;
    let rgb = Array3::from_shape_vec(pixels.shape, pixels.values).ok()?;
    (rgb.dim().2 == 3 && rgb.len() / 3 <= MAX_PIXELS).then(|| Picture::new(rgb))
}

/// Decodes a picture in a format that other programs write, or says what is wrong with it.
#[cfg(not(feature = "formats"))]
pub(crate) fn decode(_: &[u8]) -> Result<Picture, String> {
    Err("this build reads packed pictures only".into())
}

/// Decodes a picture in a format that other programs write, or says what is wrong with it.
#[cfg(feature = "formats")]
pub(crate) fn decode(bytes: &[u8]) -> Result<Picture, String> {
    match bytes {
        bytes if exr::is_exr(bytes) => exr::decode(bytes).map(|(picture, _)| picture),
        bytes if image_files::is_radiance(bytes) => {
            image_files::decode_radiance(bytes).map(Picture::new)
        }
        bytes => image_files::decode_any(bytes),
    }
}

/// The endings of the names of pictures that are read.
const READ: [&str; 6] = ["png", "jpg", "jpeg", "hdr", "pic", "exr"];

/// The file name's ending in lower case; empty if there is none.
fn extension(path: &Path) -> String {
    let extension = path.extension().unwrap_or_default();
    extension.to_string_lossy().to_ascii_lowercase()
}

/// An error about the file `path`.
fn bad_input(path: &Path, message: impl Into<String>) -> Error {
    Error::input(path.display().to_string(), message)
}

/// The beginnings of the files that are read: PNG, JPEG, EXR, Radiance, packed.
const MAGICS: [&[u8]; 5] = [
    b"\x89PNG",
    b"\xff\xd8\xff",
    b"\x76\x2f\x31\x01",
    b"#?",
    MAGIC,
];

/// Reads the bytes of a picture file; of other files only the first.
fn read_bytes(path: &Path) -> Result<Vec<u8>> {
    read_one_of(path, &MAGICS, MOST_OF_A_FILE)
}

/// Hashes the numbers of a picture.
pub(crate) fn digest(values: impl Iterator<Item = f32>) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    for value in values {
        hasher.update(&value.to_le_bytes());
    }
    hasher.finalize()
}

/// Refuses pictures that no file format can hold.
#[cfg(feature = "formats")]
fn check_writable(path: &Path, picture: &Picture) -> Result<()> {
    let size = (picture.height(), picture.width());
    if size.0 * size.1 == 0 {
        return Err(bad_input(path, "the picture has no pixels"));
    }
    let odd = (picture.layers.iter()).find(|layer| layer.values.dim() != size);
    if let Some(Layer { name, values }) = odd {
        let ((h, w), (height, width)) = (values.dim(), size);
        let message = format!("layer {name} is {w}x{h}, the picture {width}x{height}");
        return Err(bad_input(path, message));
    }
    Ok(())
}

#[cfg(all(test, feature = "formats"))]
mod tests;
