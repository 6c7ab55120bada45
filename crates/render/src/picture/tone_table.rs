//! Code values of linear light: 8 bits in sRGB.
//!
//! In: linear light. Out: the nearest code value, that of the formula. A power for every channel would take longer than
//! drawing; so the least light of every code value is found once, and a value is held against one of those: of the
//! intervals that the first bits of a number tell apart none has two of them.

use super::{displayable, srgb_shown};
use std::sync::LazyLock;

/// Bits of a number behind those that tell its interval: an octave has 128 intervals. The widest, above 1/2, are 1/256
/// wide, and two code values are 1/168 apart at least there; downwards they come closer more slowly than the octaves.
const SHIFT: u32 = 16;

/// A power of two (2⁻¹³) that is shown as black, where the intervals begin.
const BLACK: f32 = 1.0 / 8192.0;

/// The least light of every code value.
#[derive(Debug)]
pub struct ToneTable {
    /// Of each interval the code value at its beginning, and the smallest number that is shown as more.
    intervals: Vec<(u8, f32)>,
}

/// Computes the nearest code value by the formula.
fn code(linear: f32) -> u8 {
    (255.0 * srgb_shown(linear)).round() as u8
}

/// Finds the smallest number shown as at least `wanted`, by halving among all numbers from 0 to 1: those of
/// one sign are in the order of their bits.
fn least_of(wanted: u8) -> f32 {
    let (mut below, mut enough) = (0_u32, 1.0_f32.to_bits());
    if wanted == 0 {
        return 0.0;
    }
    while enough - below > 1 {
        let middle = below + (enough - below) / 2;
        match code(f32::from_bits(middle)) >= wanted {
            true => enough = middle,
            false => below = middle,
        }
    }
    f32::from_bits(enough)
}

/// Returns the number of the interval that a number from [`BLACK`] to 1 is in.
fn interval(x: f32) -> usize {
    ((x.to_bits() - BLACK.to_bits()) >> SHIFT) as usize
}

impl ToneTable {
    /// Returns the one that all pictures share.
    pub fn shared() -> &'static Self {
        static SHARED: LazyLock<ToneTable> = LazyLock::new(ToneTable::new);
        &SHARED
    }

    fn new() -> Self {
        let least: Vec<f32> = (0..=255).map(least_of).collect();
        let at = |i: u32| {
            let first = code(f32::from_bits(BLACK.to_bits() + (i << SHIFT)));
            let more = least.get(usize::from(first) + 1);
            (first, more.copied().unwrap_or(f32::INFINITY))
        };
        Self {
            intervals: (0..=interval(1.0) as u32).map(at).collect(),
        }
    }

    /// Returns the code value of linear light.
    pub fn byte(&self, linear: f32) -> u8 {
        let x = displayable(linear).max(BLACK);
        let (first, more) = self.intervals[interval(x)];
        first + u8::from(x >= more)
    }

    /// Appends red, green, blue and full opacity of linear light `rgb`, each pixel's three numbers, times
    /// `gain`.
    pub fn append(&self, rgb: &[f32], gain: f32, bytes: &mut Vec<u8>) {
        let (pixels, _) = rgb.as_chunks::<3>();
        let before = bytes.len();
        bytes.resize(before + 4 * pixels.len(), 255);
        let (codes, _) = bytes[before..].as_chunks_mut::<4>();
        for (codes, pixel) in codes.iter_mut().zip(pixels) {
            for (code, light) in codes.iter_mut().zip(pixel) {
                *code = self.byte(gain * light);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn code_values_are_those_of_a_png() {
        let table = ToneTable::shared();
        for i in 0..200_000_u32 {
            let x = i as f32 / 180_000.0 - 0.02;
            assert_eq!(table.byte(x), code(x), "{x}");
        }
        for k in 1..=255 {
            let edge = least_of(k);
            assert_eq!(table.byte(edge), k);
            assert_eq!(table.byte(f32::from_bits(edge.to_bits() - 1)), k - 1);
        }
        for odd in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -0.0, 1e-40] {
            assert_eq!(table.byte(odd), code(odd), "{odd}");
        }
    }

    #[test]
    fn no_interval_has_two_edges() {
        let edges: Vec<usize> = (1..=255).map(|k| interval(least_of(k))).collect();
        assert!(edges.windows(2).all(|pair| pair[0] < pair[1]));
    }

    #[test]
    fn a_gain_of_two_is_one_stop() {
        let mut bytes = Vec::new();
        let table = ToneTable::shared();
        table.append(&[0.1, 0.2, 0.4], 2.0, &mut bytes);
        assert_eq!(bytes, [code(0.2), code(0.4), code(0.8), 255]);
    }
}
