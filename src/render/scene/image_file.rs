//! Reading a texture or sky picture as linear light.
//!
//! In: a PNG, JPEG, HDR or EXR file. Out: rows from the top × columns × red, green, blue in linear
//! light. Whole-number formats are taken to be sRGB, float formats to be linear; alpha is dropped.

use crate::error::{Error, Result};
use exr::prelude as exrs;
use image::{DynamicImage, ImageReader};
use ndarray::Array3;
use std::{io, path::Path};

/// Reads the picture at `path` as height × width × 3 values of linear light.
pub fn read_linear_rgb(path: impl AsRef<Path>) -> Result<Array3<f32>> {
    let path = path.as_ref();
    let extension = path.extension().map(|e| e.to_ascii_lowercase());
    if extension.is_some_and(|e| e == "exr") {
        read_exr(path)
    } else {
        read_image(path)
    }
}

/// As [`Error::io`]; but a file that ends too early or holds what decoders cannot follow is bad
/// input, not a fault of the machine.
fn io_error(path: &Path, error: io::Error) -> Error {
    match error.kind() {
        io::ErrorKind::UnexpectedEof => Error::input(
            path.display().to_string(),
            "is truncated: its end is missing",
        ),
        io::ErrorKind::InvalidData | io::ErrorKind::InvalidInput | io::ErrorKind::Other => {
            Error::input(path.display().to_string(), format!("is damaged: {error}"))
        }
        _ => Error::io(path, error),
    }
}

fn read_image(path: &Path) -> Result<Array3<f32>> {
    let reader = ImageReader::open(path).map_err(|e| Error::io(path, e))?;
    let reader = reader
        .with_guessed_format()
        .map_err(|e| Error::io(path, e))?;
    let decoded = reader.decode().map_err(|e| match e {
        image::ImageError::IoError(e) => io_error(path, e),
        other => Error::input(path.display().to_string(), other.to_string()),
    })?;
    let (height, width) = (decoded.height() as usize, decoded.width() as usize);
    let values = linear_values(decoded);
    Array3::from_shape_vec((height, width, 3), values)
        .map_err(|e| Error::input(path.display().to_string(), e.to_string()))
}

/// Interleaved linear red, green, blue of any decoded picture.
fn linear_values(decoded: DynamicImage) -> Vec<f32> {
    match decoded {
        DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_) => {
            decoded.into_rgb32f().into_raw()
        }
        DynamicImage::ImageLuma8(_)
        | DynamicImage::ImageLumaA8(_)
        | DynamicImage::ImageRgb8(_)
        | DynamicImage::ImageRgba8(_) => {
            let table: Vec<f32> = (0..256)
                .map(|i| linear_from_srgb(i as f32 / 255.0))
                .collect();
            let raw = decoded.into_rgb8().into_raw();
            raw.into_iter().map(|v| table[usize::from(v)]).collect()
        }
        _ => {
            let table: Vec<f32> = (0..65536)
                .map(|i| linear_from_srgb(i as f32 / 65535.0))
                .collect();
            let raw = decoded.into_rgb16().into_raw();
            raw.into_iter().map(|v| table[usize::from(v)]).collect()
        }
    }
}

/// The sRGB transfer curve (IEC 61966-2-1), encoded value to light.
fn linear_from_srgb(v: f32) -> f32 {
    if v <= 0.04045 {
        v / 12.92
    } else {
        ((v + 0.055) / 1.055).powf(2.4)
    }
}

fn read_exr(path: &Path) -> Result<Array3<f32>> {
    let blank = |size: exrs::Vec2<usize>, _: &_| Array3::<f32>::zeros((size.y(), size.x(), 3));
    let store =
        |pixels: &mut Array3<f32>, at: exrs::Vec2<usize>, (r, g, b, _): (f32, f32, f32, f32)| {
            for (channel, value) in [r, g, b].into_iter().enumerate() {
                pixels[[at.y(), at.x(), channel]] = value;
            }
        };
    let image = exrs::read_first_rgba_layer_from_file(path, blank, store).map_err(|e| match e {
        exrs::Error::Io(e) => io_error(path, e),
        other => Error::input(path.display().to_string(), other.to_string()),
    })?;
    Ok(image.layer_data.channel_data.pixels)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_8_bit_png_becomes_linear_light() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("two.png");
        let pixels = [255, 0, 188, 10, 127, 1];
        image::save_buffer(&path, &pixels, 2, 1, image::ColorType::Rgb8).unwrap();
        let read = read_linear_rgb(&path).unwrap();
        assert_eq!(read.dim(), (1, 2, 3));
        let expected = [1.0, 0.0, 0.50289, 0.0030353, 0.21223, 0.00030353];
        for (got, want) in read.iter().zip(expected) {
            assert!((got - want).abs() < 1e-5, "{got} {want}");
        }
    }

    #[test]
    fn an_exr_keeps_its_values() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("two.exr");
        exrs::write_rgb_file(&path, 2, 1, |x, _| (0.5 + x as f32, 7.0, 1e4)).unwrap();
        let read = read_linear_rgb(&path).unwrap();
        assert_eq!(
            read.into_raw_vec_and_offset().0,
            [0.5, 7.0, 1e4, 1.5, 7.0, 1e4]
        );
    }

    #[test]
    fn files_that_are_not_pictures_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.png", "a.exr", "a.hdr", "a.jpg", "a"] {
            let path = folder.path().join(name);
            assert!(
                matches!(read_linear_rgb(&path), Err(Error::Input { .. })),
                "{name}"
            );
            std::fs::write(&path, b"not a picture").unwrap();
            assert!(
                matches!(read_linear_rgb(&path), Err(Error::Input { .. })),
                "{name}"
            );
        }
    }
}
