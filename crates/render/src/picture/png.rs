//! PNG files, and JPEG files to read.
//!
//! In: a picture. Out: 8-bit sRGB, rounded to the nearest code value without dither, so that equal
//! pictures give equal bytes. Reading turns both into linear light.

use super::{MAX_PIXELS, Picture, bad_input, check_writable, jpeg, srgb_decode, srgb_shown};
use geofan_core::{error::Result, files::write_atomically};
use image::{
    DynamicImage, ImageEncoder, ImageFormat, ImageReader, Limits, codecs::png::PngEncoder,
};
use ndarray::{Array2, Array3};
use std::{
    io::{Cursor, Write},
    path::Path,
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
            jpeg::check(bytes)?;
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

#[cfg(test)]
mod tests {
    use super::{super::tests::sample, *};

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
}
