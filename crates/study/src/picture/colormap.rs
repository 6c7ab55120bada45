//! Colours for numbers.
//!
//! In: a number on the scale of the map. Out: sRGB code values in [0, 1].
//! Viridis is for magnitudes, magma for errors, diverging for signed values, cyclic for angles.

use geofan_render::picture::srgb_encode;
use std::f32::consts::TAU;

/// Names a colour map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Colormap {
    /// Magnitudes: 0 is dark violet, 1 is yellow.
    Viridis,
    /// Errors: 0 is black, 1 is pale yellow.
    Magma,
    /// Signed values: -1 is blue, 0 is nearly white, 1 is red.
    Diverging,
    /// Angles in turns: all hues at one lightness, the same after every whole turn.
    Cyclic,
}

/// Every 15th of the 256 colours of matplotlib's viridis (Smith and van der Walt, CC0).
const VIRIDIS: [u32; 18] = [
    0x440154, 0x481769, 0x472A7A, 0x433D84, 0x3D4E8A, 0x355E8D, 0x2E6D8E, 0x297B8E, 0x23898E,
    0x1F978B, 0x21A585, 0x2EB37C, 0x46C06F, 0x65CB5E, 0x89D548, 0xB0DD2F, 0xD8E219, 0xFDE725,
];

/// Every 15th of the 256 colours of matplotlib's magma (Smith and van der Walt, CC0).
const MAGMA: [u32; 18] = [
    0x000004, 0x090720, 0x1A1042, 0x311165, 0x4A1079, 0x621980, 0x792282, 0x912B81, 0xAA337D,
    0xC23B75, 0xD9466B, 0xEC5860, 0xF7725C, 0xFC8E64, 0xFEAA74, 0xFEC68A, 0xFDE2A3, 0xFCFDBF,
];

impl Colormap {
    /// Returns the sRGB colour of `t`: between 0 and 1 for viridis and magma, -1 and 1 for the diverging
    /// map (values beyond get the end colours), any number of turns for the cyclic one. NaN is the
    /// caller's to mark; here it gets the colour of 0.
    pub fn colour(self, t: f32) -> [f32; 3] {
        let t = if t.is_nan() { 0.0 } else { t };
        match self {
            Self::Viridis => spline(&VIRIDIS, t),
            Self::Magma => spline(&MAGMA, t),
            Self::Diverging => diverging(t.clamp(-1.0, 1.0)),
            Self::Cyclic => cyclic(t),
        }
    }
}

/// Interpolates by a Catmull-Rom spline through equally spaced colours; at most 3/255 from the full tables.
fn spline(knots: &[u32; 18], t: f32) -> [f32; 3] {
    let last = knots.len() - 1;
    let place = t.clamp(0.0, 1.0) * last as f32;
    let start = (place as usize).min(last - 1);
    let u = place - start as f32;
    // Four neighbouring colours.
    let inner = |i: usize| [16, 8, 0].map(|shift| (knots[i] >> shift & 0xff) as f32 / 255.0);
    // Beyond the ends the curve goes on straight.
    let straight = |end: usize, next: usize| {
        let (end, next) = (inner(end), inner(next));
        [0, 1, 2].map(|k| 2.0 * end[k] - next[k])
    };
    let (b, c) = (inner(start), inner(start + 1));
    let a = if start == 0 {
        straight(0, 1)
    } else {
        inner(start - 1)
    };
    let d = if start + 1 == last {
        straight(last, last - 1)
    } else {
        inner(start + 2)
    };
    // The curve between the middle two.
    [0, 1, 2].map(|k| {
        let (linear, quadratic, cubic) = (
            c[k] - a[k],
            2.0 * a[k] - 5.0 * b[k] + 4.0 * c[k] - d[k],
            3.0 * (b[k] - c[k]) + d[k] - a[k],
        );
        let value = b[k] + 0.5 * u * (linear + u * (quadratic + u * cubic));
        value.clamp(0.0, 1.0)
    })
}

/// Goes from near-white to a blue and a red of equal lightness in Oklab, so that equal magnitudes of
/// both signs stand out equally. Chroma rises faster than lightness falls: with straight lines the
/// middle tones are greyish.
fn diverging(t: f32) -> [f32; 3] {
    const LIGHTNESS: (f32, f32) = (0.95, 0.42);
    const BLUE: [f32; 2] = [-0.02, -0.15];
    const RED: [f32; 2] = [0.15, 0.07];
    let (size, end) = (t.abs(), if t < 0.0 { BLUE } else { RED });
    let lightness = LIGHTNESS.0 + size * (LIGHTNESS.1 - LIGHTNESS.0);
    let chroma = size * (1.5 - 0.5 * size);
    srgb_of_oklab([lightness, chroma * end[0], chroma * end[1]])
}

/// Goes round a circle in Oklab. The lightness lets the chroma be large enough to tell hues apart and small
/// enough that every hue can be shown.
fn cyclic(turns: f32) -> [f32; 3] {
    const LIGHTNESS: f32 = 0.72;
    const CHROMA: f32 = 0.115;
    let fraction = if turns.is_finite() {
        turns - turns.floor()
    } else {
        0.0
    };
    let angle = TAU * fraction;
    srgb_of_oklab([LIGHTNESS, CHROMA * angle.cos(), CHROMA * angle.sin()])
}

/// Converts Oklab to sRGB (Ottosson 2020).
fn srgb_of_oklab([l, a, b]: [f32; 3]) -> [f32; 3] {
    let long = (l + 0.396_337_78 * a + 0.215_803_76 * b).powi(3);
    let medium = (l - 0.105_561_346 * a - 0.063_854_17 * b).powi(3);
    let short = (l - 0.089_484_18 * a - 1.291_485_5 * b).powi(3);
    let linear = [
        4.076_741_7 * long - 3.307_711_6 * medium + 0.230_969_94 * short,
        -1.268_438 * long + 2.609_757_4 * medium - 0.341_319_38 * short,
        -0.004_196_086_3 * long - 0.703_418_6 * medium + 1.707_614_7 * short,
    ];
    linear.map(|value| srgb_encode(value).clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The largest difference of a map's colour `index / 255` from the published one.
    fn distance(map: Colormap, index: usize, published: [u8; 3]) -> f32 {
        let colour = map.colour(index as f32 / 255.0);
        let difference = |k: usize| (255.0 * colour[k] - f32::from(published[k])).abs();
        [0, 1, 2].map(difference).into_iter().fold(0.0, f32::max)
    }

    #[test]
    fn magma_is_within_three_steps_of_the_published_table() {
        let table = nv_flip::magma_lut().to_vec();
        for (index, published) in table.chunks(3).enumerate() {
            let published = [published[0], published[1], published[2]];
            let off = distance(Colormap::Magma, index, published);
            assert!(off <= 3.0, "{index}: {off}");
        }
    }

    #[test]
    fn viridis_is_within_three_steps_of_published_colours() {
        let published = [
            (0, [0x44, 0x01, 0x54]),
            (8, [0x47, 0x0D, 0x60]),
            (40, [0x45, 0x37, 0x81]),
            (97, [0x2C, 0x73, 0x8E]),
            (128, [0x21, 0x91, 0x8C]),
            (202, [0x75, 0xD0, 0x54]),
            (247, [0xEA, 0xE5, 0x1A]),
            (255, [0xFD, 0xE7, 0x25]),
        ];
        for (index, colour) in published {
            let off = distance(Colormap::Viridis, index, colour);
            assert!(off <= 3.0, "{index}: {off}");
        }
    }

    #[test]
    fn the_cyclic_map_repeats_and_has_no_jump() {
        let at = |turns: f32| Colormap::Cyclic.colour(turns);
        assert_eq!(at(0.25), at(1.25));
        assert_eq!(at(0.75), at(-0.25));
        for step in 0..360 {
            let (a, b) = (at(step as f32 / 360.0), at((step + 1) as f32 / 360.0));
            let jump = (0..3).map(|k| (a[k] - b[k]).abs()).fold(0.0, f32::max);
            assert!((0.001..0.02).contains(&jump), "{step}: {jump}");
        }
    }

    #[test]
    fn no_colour_of_the_made_maps_needs_clamping() {
        for step in -100..=100 {
            let t = step as f32 / 100.0;
            for map in [Colormap::Diverging, Colormap::Cyclic] {
                let colour = map.colour(t);
                assert!(
                    colour.iter().all(|&v| v > 0.0 && v < 1.0),
                    "{map:?} {t} {colour:?}"
                );
            }
        }
    }

    #[test]
    fn the_diverging_map_is_grey_only_at_zero() {
        let spread = |t| {
            let [r, g, b] = Colormap::Diverging.colour(t);
            r.max(g).max(b) - r.min(g).min(b)
        };
        assert!(spread(0.0) < 0.01);
        assert!(spread(0.1) > 0.02 && spread(-0.1) > 0.02);
        let [r, _, b] = Colormap::Diverging.colour(1.0);
        assert!(r > b);
    }

    #[test]
    fn numbers_beyond_the_scale_get_the_end_colours() {
        for map in [Colormap::Viridis, Colormap::Magma, Colormap::Diverging] {
            assert_eq!(map.colour(7.0), map.colour(1.0));
            assert_eq!(map.colour(f32::INFINITY), map.colour(1.0));
            assert_eq!(map.colour(f32::NAN), map.colour(0.0));
        }
        assert!(
            Colormap::Cyclic
                .colour(f32::INFINITY)
                .iter()
                .all(|v| !v.is_nan())
        );
    }
}
