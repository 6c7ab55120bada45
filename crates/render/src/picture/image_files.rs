//! PNG files, and JPEG and Radiance files to read, by the crate `image`.
//!
//! In: a picture. Out: 8-bit sRGB, rounded to the nearest code value without dither, so that equal
//! pictures give equal bytes. Reading turns all into linear light.
//!
//! Of JPEG files what is wrong with them is looked for first: decoders make the best of a damaged file, as
//! browsers do: they fill with grey what is missing, and say nothing.
//!
//! Of Radiance files (`.hdr` or `.pic`) the crate reads one kind:
//! `#?RADIANCE`, red, green and blue, from the upper left row by row. Others (`#?RGBE`, any other program's
//! name, XYZ, other orders of rows and columns) are given to it under a header of that kind and put right
//! afterwards. Format: G. Ward, *Real Pixels*, in Graphics Gems II, and `rgbe`'s manual page.

use super::{
    MAX_PIXELS, Picture, ToneTable, bad_input, check_writable, colour_space::Primaries, srgb_decode,
};
use geofan_core::{error::Result, files::write_atomically};
use glam::DVec3;
use image::{
    DynamicImage, ImageEncoder, ImageError, ImageFormat, ImageReader, Limits,
    codecs::{hdr::HdrDecoder, png::PngEncoder},
};
use ndarray::{Array2, Array3, Axis};
use std::{
    io::{Cursor, ErrorKind, Read, Write},
    path::Path,
};
use zune_jpeg::{
    JpegDecoder,
    errors::DecodeErrors,
    zune_core::{bytestream::ZCursor, options::DecoderOptions},
};

/// Writes the colours as an 8-bit sRGB PNG; layers and values beyond white are lost.
pub fn write_png(path: &Path, picture: &Picture) -> Result<()> {
    check_writable(path, picture)?;
    let bytes = encode(picture).map_err(|e| bad_input(path, e.to_string()))?;
    write_atomically(path, |out| out.write_all(&bytes))
}

/// The picture in the bytes of a PNG or JPEG file, or what is wrong with them.
pub(super) fn decode_any(bytes: &[u8]) -> Result<Picture, String> {
    let format = image::guess_format(bytes).ok();
    match format.ok_or("is not a PNG, JPEG, Radiance or OpenEXR file")? {
        ImageFormat::Jpeg => {
            check_jpeg(bytes)?;
            decode_as(bytes, ImageFormat::Jpeg)
        }
        format => decode_as(bytes, format),
    }
}

impl Picture {
    /// The colours as 8-bit sRGB, row by row from the top, three bytes for each pixel.
    pub fn bytes(&self) -> Vec<u8> {
        let table = ToneTable::shared();
        self.rgb.iter().map(|light| table.byte(*light)).collect()
    }
}

/// The bytes of a PNG file.
fn encode(picture: &Picture) -> image::ImageResult<Vec<u8>> {
    let codes = picture.bytes();
    let (width, height) = (picture.width() as u32, picture.height() as u32);
    let mut bytes = Vec::new();
    let encoder = PngEncoder::new(&mut bytes);
    encoder.write_image(&codes, width, height, image::ExtendedColorType::Rgb8)?;
    Ok(bytes)
}

/// Returns what a decoder says is wrong, without what only those who wrote it understand.
fn told(error: &ImageError) -> String {
    match error {
        ImageError::Limits(_) => "it is larger than pictures may be".into(),
        ImageError::IoError(error) if error.kind() == ErrorKind::UnexpectedEof => {
            "it ends before all of its pixels have come: copy it again".into()
        }
        error => {
            let text = error.to_string();
            let text = text.split("ChunkType {").next().unwrap_or_default();
            let text = text.trim_end().trim_end_matches("while decoding");
            format!("it is damaged: {}", text.trim_end_matches([' ', ':']))
        }
    }
}

/// The picture in the bytes of a file of known format, or what is wrong with them.
fn decode_as(bytes: &[u8], format: ImageFormat) -> Result<Picture, String> {
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    limits.max_alloc = Some(12 * MAX_PIXELS as u64);
    reader.limits(limits);
    let (width, height) = (ImageReader::with_format(Cursor::new(bytes), format))
        .into_dimensions()
        .map_err(|e| told(&e))?;
    if width as usize * height as usize > MAX_PIXELS {
        return Err(format!("{width}x{height} pixels are too many"));
    }
    let image = reader.decode().map_err(|e| told(&e))?;
    let alpha = image.color().has_alpha().then(|| alpha(&image));
    let shape = (height as usize, width as usize, 3);
    let values = image.into_rgb32f().into_raw();
    let mut rgb = Array3::from_shape_vec(shape, values).map_err(|e| e.to_string())?;
    rgb.mapv_inplace(srgb_decode);
    let picture = Picture::new(rgb);
    Ok(match alpha {
        Some(alpha) => picture.with_float("A", alpha),
        None => picture,
    })
}

/// The opacity of an image, rows from the top.
fn alpha(image: &DynamicImage) -> Array2<f32> {
    let (height, width) = (image.height() as usize, image.width() as usize);
    let rgba = image.to_rgba16();
    Array2::from_shape_fn((height, width), |(y, x)| {
        f32::from(rgba.get_pixel(x as u32, y as u32).0[3]) / f32::from(u16::MAX)
    })
}

const START: u8 = 0xd8;
const END: u8 = 0xd9;

/// Markers that stand alone: TEM, and RST0 to RST7.
const ALONE: [std::ops::RangeInclusive<u8>; 2] = [0x01..=0x01, 0xd0..=0xd7];

/// Refuses a file that was cut short or whose data cannot be decoded to their end. What decodes to a wrong
/// picture goes unnoticed, as such files have no checksums.
pub(super) fn check_jpeg(bytes: &[u8]) -> Result<(), String> {
    if !ends(bytes) {
        return Err("was cut short: the picture goes on where the file ends".into());
    }
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(usize::MAX)
        .set_max_height(usize::MAX);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    // Whatever is odd in headers takes nothing from the picture.
    if decoder.decode_headers().is_err() {
        return Ok(());
    }
    match decoder.decode() {
        Err(DecodeErrors::Unsupported(_)) | Ok(_) => Ok(()),
        Err(e) => Err(format!(
            "is damaged, and part of its picture is lost ({e:?})"
        )),
    }
}

/// Tells if the file has its end marker after all of its segments and scans.
fn ends(bytes: &[u8]) -> bool {
    let mut at = 0;
    while let Some((marker, next)) = next_marker(bytes, at) {
        match marker {
            END => return true,
            START => at = next,
            _ if ALONE.iter().any(|range| range.contains(&marker)) => at = next,
            _ => {
                let Some(&[high, low]) = bytes.get(next..next + 2) else {
                    return false;
                };
                at = next + usize::from(u16::from_be_bytes([high, low])).max(2);
            }
        }
    }
    false
}

/// Finds the first marker from `at` on, and what follows it; among the data of scans 0xff is followed by 0.
fn next_marker(bytes: &[u8], at: usize) -> Option<(u8, usize)> {
    let rest = bytes.get(at..)?;
    let pairs = rest
        .windows(2)
        .position(|pair| pair[0] == 0xff && !matches!(pair[1], 0 | 0xff))?;
    Some((rest[pairs + 1], at + pairs + 2))
}

/// Tells if a file begins as Radiance pictures do: `#?` and the name of a program.
pub(super) fn is_radiance(bytes: &[u8]) -> bool {
    bytes.starts_with(b"#?")
}

/// Holds what a header says.
#[derive(Debug, Clone, PartialEq)]
struct RadianceHeader {
    /// Rows or columns first: axis (0 down, 1 across), whether it runs upwards or to the left, length.
    major: (usize, bool, usize),
    minor: (usize, bool, usize),
    /// True if the numbers are CIE X, Y, Z.
    xyz: bool,
    /// Factors by which the numbers of each channel have been multiplied.
    gain: [f32; 3],
    /// Where the pixels begin.
    pixels: usize,
}

/// Reads the linear light in the bytes of a file.
pub(super) fn decode_radiance(bytes: &[u8]) -> Result<Array3<f32>, String> {
    let header = RadianceHeader::read(bytes)?;
    let (rows, columns) = (header.major.2, header.minor.2);
    if rows.saturating_mul(columns) > MAX_PIXELS {
        return Err(format!("{columns}x{rows} pixels are too many"));
    }
    if rows * columns == 0 {
        return Err("has no pixels".into());
    }
    let plain = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {rows} +X {columns}\n");
    let pixels = bytes.get(header.pixels..).unwrap_or_default();
    let file = Cursor::new(plain).chain(pixels);
    let decoder = HdrDecoder::new(file).map_err(|e| e.to_string())?;
    let image = DynamicImage::from_decoder(decoder).map_err(|e| e.to_string())?;
    let values = image.into_rgb32f().into_raw();
    let rgb = Array3::from_shape_vec((rows, columns, 3), values).map_err(|e| e.to_string())?;
    header.put_right(rgb)
}

impl RadianceHeader {
    fn read(bytes: &[u8]) -> Result<Self, String> {
        let mut at = 0;
        let mut line = || {
            let rest = bytes.get(at..)?;
            let length = rest.iter().position(|byte| *byte == b'\n')?;
            at += length + 1;
            let line = String::from_utf8_lossy(&rest[..length]);
            Some(line.trim_end_matches('\r').to_owned())
        };
        let (mut xyz, mut gain) = (false, [1.0; 3]);
        loop {
            let line = line().ok_or("ends before its pixels do")?;
            if line.is_empty() {
                break;
            }
            let Some((key, value)) = line.split_once('=') else {
                continue;
            };
            let numbers = || value.split_whitespace().map(str::parse::<f32>);
            match key.trim() {
                "FORMAT" => xyz = is_xyz(value.trim())?,
                "EXPOSURE" => {
                    let exposure = numbers().next().and_then(Result::ok).unwrap_or(1.0);
                    gain = gain.map(|x| x * exposure);
                }
                "COLORCORR" => {
                    for (gain, correction) in gain.iter_mut().zip(numbers()) {
                        *gain *= correction.unwrap_or(1.0);
                    }
                }
                _ => {}
            }
        }
        let size = line().ok_or("ends before its pixels do")?;
        let [major, minor] = sides(&size)
            .ok_or_else(|| format!("has the size {size:?}; it should look like -Y 512 +X 1024"))?;
        if !gain.iter().all(|x| x.is_normal() && *x > 0.0) {
            return Err("has an exposure that is no positive number".into());
        }
        Ok(Self {
            major,
            minor,
            xyz,
            gain,
            pixels: at,
        })
    }

    /// Makes the picture upright, in Rec.709, without exposure.
    fn put_right(&self, mut rgb: Array3<f32>) -> Result<Array3<f32>, String> {
        for (axis, (_, backwards, _)) in [self.major, self.minor].into_iter().enumerate() {
            // Rows run down and columns to the right; a sign says which way numbers grow.
            if backwards {
                rgb.invert_axis(Axis(axis));
            }
        }
        if self.major.0 == 1 {
            rgb.swap_axes(0, 1);
        }
        let to_rec709 = match self.xyz {
            true => Primaries::XYZ.to_rec709().ok_or("has no colours")?,
            false => glam::DMat3::IDENTITY,
        };
        let mut rgb = rgb.as_standard_layout().into_owned();
        if self.xyz || self.gain != [1.0; 3] {
            for mut pixel in rgb.rows_mut() {
                let colour = [0, 1, 2].map(|k| f64::from(pixel[k] / self.gain[k]));
                let colour = (to_rec709 * DVec3::from_array(colour)).as_vec3();
                pixel.assign(&ndarray::arr1(&colour.to_array()));
            }
        }
        Ok(rgb)
    }
}

fn is_xyz(format: &str) -> Result<bool, String> {
    match format {
        "32-bit_rle_rgbe" => Ok(false),
        "32-bit_rle_xyze" => Ok(true),
        other => Err(format!(
            "has the format {other:?}; 32-bit_rle_rgbe and 32-bit_rle_xyze are read"
        )),
    }
}

/// Reads both sides of a picture from its size line, such as `-Y 512 +X 1024`: `-Y` counts rows from the top, `+X`
/// columns from the left.
fn sides(line: &str) -> Option<[(usize, bool, usize); 2]> {
    let mut words = line.split_whitespace();
    let mut side = || {
        let (axis, backwards) = match words.next()? {
            "-Y" => (0, false),
            "+Y" => (0, true),
            "+X" => (1, false),
            "-X" => (1, true),
            _ => return None,
        };
        Some((axis, backwards, words.next()?.parse::<u32>().ok()? as usize))
    };
    let sides = [side()?, side()?];
    (sides[0].0 != sides[1].0).then_some(sides)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::tests::sample;

    #[test]
    fn every_code_value_survives_reading_and_writing_again() {
        let ramp = Picture::from_fn(256, 1, |x, _| {
            let codes = [x, 255 - x, x / 2];
            codes.map(|code| srgb_decode(code as f32 / 255.0))
        });
        let back = decode_as(&encode(&ramp).unwrap(), ImageFormat::Png).unwrap();
        assert_eq!(ramp.bytes(), back.bytes());
        for (a, b) in ramp.rgb.iter().zip(&back.rgb) {
            approx::assert_abs_diff_eq!(a, b, epsilon = 1e-6);
        }
    }

    #[test]
    fn equal_pictures_give_equal_bytes() {
        let picture = sample(40, 30);
        assert_eq!(encode(&picture).unwrap(), encode(&picture).unwrap());
    }

    /// A picture with noise, so that its data are long.
    fn jpeg() -> Vec<u8> {
        let pixel = |x: u32, y: u32| image::Rgb([(x * 37) as u8, (y * 91) as u8, (x * y) as u8]);
        let image = image::RgbImage::from_fn(64, 48, pixel);
        let mut bytes = std::io::Cursor::new(Vec::new());
        image
            .write_to(&mut bytes, image::ImageFormat::Jpeg)
            .unwrap();
        bytes.into_inner()
    }

    #[test]
    fn whole_files_pass_also_with_something_behind_them() {
        let mut bytes = jpeg();
        assert_eq!(check_jpeg(&bytes), Ok(()));
        bytes.extend([0, 0xff, 0, 1, 2]);
        assert_eq!(check_jpeg(&bytes), Ok(()));
    }

    #[test]
    fn files_cut_anywhere_are_refused() {
        let bytes = jpeg();
        for length in (0..bytes.len()).step_by(7) {
            assert!(
                check_jpeg(&bytes[..length])
                    .unwrap_err()
                    .contains("cut short"),
                "{length}"
            );
        }
    }

    #[test]
    fn a_picture_with_a_marker_among_its_data_is_refused() {
        let mut bytes = jpeg();
        let middle = bytes.len() * 3 / 4;
        bytes.splice(middle..middle + 2, [0xff, START]);
        assert!(check_jpeg(&bytes).unwrap_err().contains("damaged"));
    }

    /// A picture of 4 × 2 pixels, without run lengths: red tells the column, green the row.
    fn file(start: &str, size: &str, pixel: impl Fn(usize) -> [u8; 4]) -> Vec<u8> {
        let mut bytes = format!("{start}\n{size}\n").into_bytes();
        bytes.extend((0..8).flat_map(pixel));
        bytes
    }

    /// A number from 0 to 255 over 128.
    fn value(x: usize) -> u8 {
        (32 * x) as u8
    }

    #[test]
    fn every_program_may_sign_a_picture() {
        for name in ["RADIANCE", "RGBE", "AUTOPANO", ""] {
            let start = format!("#?{name}\n# a comment\nFORMAT=32-bit_rle_rgbe\nSOFTWARE=x\n");
            let bytes = file(&start, "-Y 2 +X 4", |i| {
                [value(i % 4), value(i / 4), 128, 129]
            });
            assert!(is_radiance(&bytes));
            let rgb = decode_radiance(&bytes).unwrap();
            assert_eq!(rgb.dim(), (2, 4, 3));
            for ((y, x, k), found) in rgb.indexed_iter() {
                let expected = [x as f32 / 4.0, y as f32 / 4.0, 1.0][k];
                assert_eq!(*found, expected, "{name} {y} {x} {k}");
            }
        }
    }

    #[test]
    fn rows_and_columns_may_come_in_any_order() {
        // The place of number i of the file, as the format says: rows downwards by -Y.
        type PlaceOf = fn(usize) -> (usize, usize);
        let orders: [(&str, PlaceOf); 8] = [
            ("-Y 2 +X 4", |i| (i / 4, i % 4)),
            ("+Y 2 +X 4", |i| (1 - i / 4, i % 4)),
            ("-Y 2 -X 4", |i| (i / 4, 3 - i % 4)),
            ("+Y 2 -X 4", |i| (1 - i / 4, 3 - i % 4)),
            ("+X 4 -Y 2", |i| (i % 2, i / 2)),
            ("-X 4 -Y 2", |i| (i % 2, 3 - i / 2)),
            ("+X 4 +Y 2", |i| (1 - i % 2, i / 2)),
            ("-X 4 +Y 2", |i| (1 - i % 2, 3 - i / 2)),
        ];
        for (size, place) in orders {
            let pixel = |i: usize| {
                let (row, column) = place(i);
                [value(column), value(row), 0, 129]
            };
            let rgb = decode_radiance(&file("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n", size, pixel))
                .unwrap();
            assert_eq!(rgb.dim(), (2, 4, 3), "{size}");
            for y in 0..2 {
                for x in 0..4 {
                    let found = [rgb[(y, x, 0)], rgb[(y, x, 1)]];
                    assert_eq!(found, [x as f32 / 4.0, y as f32 / 4.0], "{size}");
                }
            }
        }
    }

    #[test]
    fn exposures_are_undone_and_xyz_becomes_rec709() {
        let start =
            "#?RADIANCE\nEXPOSURE=2\nEXPOSURE= 4.0\nCOLORCORR=1 2 1\nFORMAT=32-bit_rle_rgbe\n";
        let rgb = decode_radiance(&file(start, "-Y 2 +X 4", |_| [128, 128, 128, 129])).unwrap();
        assert_eq!(
            [rgb[(0, 0, 0)], rgb[(0, 0, 1)], rgb[(0, 0, 2)]],
            [0.125, 0.0625, 0.125]
        );
        // The white of a screen: D65.
        let start = "#?RADIANCE\nFORMAT=32-bit_rle_xyze\n";
        let white = decode_radiance(&file(start, "-Y 2 +X 4", |_| [122, 128, 139, 129])).unwrap();
        for x in white {
            assert!((x - 1.0).abs() < 0.015, "{x}");
        }
    }

    #[test]
    fn cut_files_and_unknown_formats_are_told() {
        let whole = file("#?RGBE\nFORMAT=32-bit_rle_rgbe\n", "-Y 2 +X 4", |_| [1; 4]);
        for length in 0..whole.len() {
            assert!(decode_radiance(&whole[..length]).is_err(), "{length}");
        }
        let other = decode_radiance(&file("#?RGBE\nFORMAT=64-bit\n", "-Y 2 +X 4", |_| [1; 4]));
        assert!(other.unwrap_err().contains("64-bit"));
        let size = decode_radiance(&file("#?RGBE\n", "-Y 2 +Y 4", |_| [1; 4]));
        assert!(size.unwrap_err().contains("-Y 2 +Y 4"));
        let dark = decode_radiance(&file("#?RGBE\nEXPOSURE=0\n", "-Y 2 +X 4", |_| [1; 4]));
        assert!(dark.unwrap_err().contains("exposure"));
    }
}
