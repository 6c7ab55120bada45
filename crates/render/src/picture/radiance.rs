//! Radiance pictures.
//!
//! In: the bytes of a `.hdr` or `.pic` file. Out: linear light. The `image` crate reads one kind of them:
//! `#?RADIANCE`, red, green and blue, from the upper left row by row. Others (`#?RGBE`, any other program's
//! name, XYZ, other orders of rows and columns) are given to it under a header of that kind and put right
//! afterwards. Format: G. Ward, *Real Pixels*, in Graphics Gems II, and `rgbe`'s manual page.

use super::{MAX_PIXELS, colour_space::Primaries};
use glam::DVec3;
use image::{DynamicImage, codecs::hdr::HdrDecoder};
use ndarray::{Array3, Axis};
use std::io::{Cursor, Read};

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
pub(super) fn decode(bytes: &[u8]) -> Result<Array3<f32>, String> {
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
            let rgb = decode(&bytes).unwrap();
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
            let rgb = decode(&file("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n", size, pixel)).unwrap();
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
        let rgb = decode(&file(start, "-Y 2 +X 4", |_| [128, 128, 128, 129])).unwrap();
        assert_eq!(
            [rgb[(0, 0, 0)], rgb[(0, 0, 1)], rgb[(0, 0, 2)]],
            [0.125, 0.0625, 0.125]
        );
        // The white of a screen: D65.
        let start = "#?RADIANCE\nFORMAT=32-bit_rle_xyze\n";
        let white = decode(&file(start, "-Y 2 +X 4", |_| [122, 128, 139, 129])).unwrap();
        for x in white {
            assert!((x - 1.0).abs() < 0.015, "{x}");
        }
    }

    #[test]
    fn cut_files_and_unknown_formats_are_told() {
        let whole = file("#?RGBE\nFORMAT=32-bit_rle_rgbe\n", "-Y 2 +X 4", |_| [1; 4]);
        for length in 0..whole.len() {
            assert!(decode(&whole[..length]).is_err(), "{length}");
        }
        let other = decode(&file("#?RGBE\nFORMAT=64-bit\n", "-Y 2 +X 4", |_| [1; 4]));
        assert!(other.unwrap_err().contains("64-bit"));
        let size = decode(&file("#?RGBE\n", "-Y 2 +Y 4", |_| [1; 4]));
        assert!(size.unwrap_err().contains("-Y 2 +Y 4"));
        let dark = decode(&file("#?RGBE\nEXPOSURE=0\n", "-Y 2 +X 4", |_| [1; 4]));
        assert!(dark.unwrap_err().contains("exposure"));
    }
}
