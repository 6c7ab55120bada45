//! Pictures in few bytes, for pages, which bring no readers of other formats along.
//!
//! In: numbers row by row, so many channels a pixel. Out: bytes that compress well, and the numbers again.
//!
//! Layout, little-endian: width and height (u32), channels (u8), the coding (u8), then for each byte of a value,
//! the highest first, that byte of all values. A value is a whole number: a code value of 8 bits in sRGB (coding 0)
//! or linear (1) where all numbers are such, which keeps them exactly; else (2) a single-precision number without
//! its last 12 bits, rounded: at most 2⁻¹² of itself off, if it is above 1e-38. Of each value what the Paeth predictor of PNG foretells is
//! taken away (W3C, *PNG Specification*, filter type 4).

use super::srgb_decode;
use std::array;

/// Begins a picture's file.
pub const MAGIC: &[u8; 16] = b"geofan picture1\n";

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

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(value: impl Fn(usize) -> f32) -> Pixels {
        let shape = (5, 7, 3);
        Pixels {
            shape,
            values: (0..5 * 7 * 3).map(value).collect(),
        }
    }

    #[test]
    fn code_values_come_back_exactly_in_a_byte_each() {
        let srgb = picture(|i| srgb_decode((i * 37 % 256) as f32 / 255.0));
        let linear = picture(|i| (i * 91 % 256) as f32 / 255.0);
        for pixels in [srgb, linear] {
            let bytes = pixels.pack();
            assert_eq!(bytes.len(), 10 + pixels.values.len());
            assert_eq!(Pixels::unpack(&bytes), Some(pixels));
        }
    }

    #[test]
    fn light_comes_back_to_within_its_stated_error() {
        let values = [0.0, 1e-30, 0.3, 7.5, 65_000.0, 1e30, -2.0, f32::INFINITY];
        let pixels = picture(|i| values[i % values.len()] * (1.0 + 1e-3 * i as f32));
        let back = Pixels::unpack(&pixels.pack()).unwrap();
        for (a, b) in pixels.values.iter().zip(&back.values) {
            assert!(a == b || (a - b).abs() <= a.abs() / 4096.0, "{a} {b}");
        }
    }

    #[test]
    fn other_bytes_are_refused() {
        let bytes = picture(|i| i as f32).pack();
        for length in 0..bytes.len() {
            assert_eq!(Pixels::unpack(&bytes[..length]), None);
        }
        let mut odd = bytes.clone();
        odd[9] = 9;
        assert_eq!(Pixels::unpack(&odd), None);
    }
}
