//! The `v` lines of an OBJ text: positions, weights and colours.
//!
//! In: words. Out: positions, and colours in linear light.
//!
//! | numbers | meaning |
//! |---|---|
//! | 3 | position |
//! | 4 | position and weight: homogeneous coordinates, to be divided by the last |
//! | 6, 7 | position and red, green, blue, perhaps opacity |
//!
//! Colours are no part of the format's specification. MeshLab, Blender, Meshmixer and ZBrush write
//! them as a screen shows them (sRGB), in [0, 1] or as bytes; ZBrush in comments of its own, eight
//! hexadecimal digits a vertex: mask, red, green, blue.

use super::tally::Tally;
use crate::picture::srgb_decode;
use glam::DVec3;

/// Red, green and blue as a screen shows them, and opacity.
type Colour = [f32; 4];

const WHITE: Colour = [1.0; 4];

/// Vertices as they come.
#[derive(Default)]
pub(super) struct Vertices {
    positions: Vec<DVec3>,
    /// One a vertex as long as any has a colour; white where there is none.
    colours: Vec<Colour>,
    /// From comments of ZBrush.
    painted: Vec<Colour>,
}

impl Vertices {
    /// Adds the vertex with these words, which stand in line `line`.
    pub(super) fn add(
        &mut self,
        words: &str,
        line: usize,
        tally: &mut Tally,
    ) -> Result<(), String> {
        let (numbers, count) = numbers(words)?;
        let [x, y, z, w, ..] = numbers;
        let mut position = DVec3::new(x, y, z);
        let mut colour = None;
        match count {
            0..3 => return Err(String::from("a vertex needs three numbers")),
            3 => {}
            4 if w == 0.0 => return Err(String::from("a vertex of weight 0 lies nowhere")),
            4 => position /= w,
            6 | 7 => {
                colour = Some([3, 4, 5, 6].map(|i| if i < count { numbers[i] as f32 } else { 1.0 }))
            }
            _ => tally.odd_vertex(line),
        }
        self.positions.push(position);
        if colour.is_some() || !self.colours.is_empty() {
            self.colours.resize(self.positions.len() - 1, WHITE);
            self.colours.push(colour.unwrap_or(WHITE));
        }
        Ok(())
    }

    /// Adds the colours in a comment of ZBrush, after its `#MRGB`.
    pub(super) fn paint(&mut self, digits: &str) {
        let digits = digits.trim().as_bytes().chunks_exact(8);
        let byte = |two: &[u8]| {
            let two = std::str::from_utf8(two).ok();
            let two = two.filter(|two| !two.starts_with('+'));
            two.and_then(|two| u8::from_str_radix(two, 16).ok())
        };
        for eight in digits {
            let [red, green, blue] = [2, 4, 6].map(|i| byte(&eight[i..i + 2]).unwrap_or(255));
            let colour = [red, green, blue].map(|c| f32::from(c) / 255.0);
            self.painted.push([colour[0], colour[1], colour[2], 1.0]);
        }
    }

    /// Returns the position of the vertex `index`, counted from 1.
    pub(super) fn position(&self, index: u32) -> DVec3 {
        self.positions[index as usize - 1]
    }

    /// Returns linear red, green, blue and opacity of every vertex, if any has a colour.
    pub(super) fn colours(&self, tally: &mut Tally) -> Vec<[f32; 4]> {
        let mut colours = self.colours.clone();
        if colours.is_empty() && !self.painted.is_empty() {
            tally.unpainted = self.positions.len().saturating_sub(self.painted.len());
            colours.clone_from(&self.painted);
            colours.resize(self.positions.len(), WHITE);
        }
        let most = colours
            .iter()
            .flat_map(|c| &c[..3])
            .fold(0.0_f32, |a, b| a.max(*b));
        let full = if most > 1.0 { 255.0 } else { 1.0 };
        let opaque = colours.iter().fold(0.0_f32, |a, c| a.max(c[3]));
        let full_alpha = if opaque > 1.0 { 255.0 } else { 1.0 };
        let linear = |[r, g, b, a]: [f32; 4]| {
            let [r, g, b] = [r, g, b].map(|x| srgb_decode((x / full).clamp(0.0, 1.0)));
            [r, g, b, (a / full_alpha).clamp(0.0, 1.0)]
        };
        colours.into_iter().map(linear).collect()
    }
}

/// Reads up to eight numbers, and counts the words: eight if one after the third is no number.
fn numbers(words: &str) -> Result<([f64; 8], usize), String> {
    let mut numbers = [0.0; 8];
    let mut count = 0;
    for word in words.split_whitespace().take(8) {
        match finite_number(word) {
            Ok(x) => numbers[count] = x,
            Err(message) if count < 3 => return Err(message),
            Err(_) => return Ok((numbers, 8)),
        }
        count += 1;
    }
    Ok((numbers, count))
}

/// Returns the number that a word is.
pub(super) fn number(word: &str) -> Result<f64, String> {
    word.parse().map_err(|_| match word.contains(',') {
        true => format!("`{word}` is not a number; decimals are written with a point"),
        false => format!("`{word}` is not a number"),
    })
}

fn finite_number(word: &str) -> Result<f64, String> {
    let found = number(word)?;
    match found.is_finite() {
        true => Ok(found),
        false => Err(format!("`{word}` is not a finite number")),
    }
}
