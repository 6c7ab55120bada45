//! PNG files, and JPEG files to read.
//!
//! In: a picture. Out: 8-bit sRGB, rounded to the nearest code value without dither, so that equal
//! pictures give equal bytes. Reading turns both into linear light.
//!
//! Of JPEG files what is wrong with them is looked for first: decoders make the best of a damaged file, as
//! browsers do: they fill with grey what is missing, and say nothing.

use super::{MAX_PIXELS, Picture, bad_input, check_writable, srgb_decode, srgb_shown};
use geofan_core::{error::Result, files::write_atomically};
use image::{
    DynamicImage, ImageEncoder, ImageFormat, ImageReader, Limits, codecs::png::PngEncoder,
};
use ndarray::{Array2, Array3};
use std::{
    io::{Cursor, Write},
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
            decode(bytes, ImageFormat::Jpeg)
        }
        format => decode(bytes, format),
    }
}

impl Picture {
    /// The colours as 8-bit sRGB, row by row from the top, three bytes for each pixel.
    pub fn bytes(&self) -> Vec<u8> {
        self.rgb.iter().map(|&linear| to_byte(linear)).collect()
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

/// The picture in the bytes of a file of known format, or what is wrong with them.
fn decode(bytes: &[u8], format: ImageFormat) -> Result<Picture, String> {
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    limits.max_alloc = Some(12 * MAX_PIXELS as u64);
    reader.limits(limits);
    let (width, height) = (ImageReader::with_format(Cursor::new(bytes), format))
        .into_dimensions()
        .map_err(|e| e.to_string())?;
    if width as usize * height as usize > MAX_PIXELS {
        return Err(format!("{width}x{height} pixels are too many"));
    }
    let image = reader.decode().map_err(|e| e.to_string())?;
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

/// The nearest 8-bit sRGB code value.
fn to_byte(linear: f32) -> u8 {
    (255.0 * srgb_shown(linear)).round() as u8
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
        let back = decode(&encode(&ramp).unwrap(), ImageFormat::Png).unwrap();
        for (a, b) in ramp.rgb.iter().zip(&back.rgb) {
            assert_eq!(to_byte(*a), to_byte(*b));
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
}
