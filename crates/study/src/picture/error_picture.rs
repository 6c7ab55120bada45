//! Colours for numbers, and errors as a picture that can be read off.
//!
//! In: a number on the scale of the map. Out: sRGB code values in [0, 1] ([`Colormap`]).
//! Viridis is for magnitudes, magma for errors, diverging for signed values, cyclic for angles.
//!
//! In: an error per pixel with its unit, NaN where there is none. Out: a picture in magma on a
//! logarithmic scale, with a title, and on the right a colour bar with ticks at powers of ten.

use crate::picture::lettering::{self, INK, PAPER, lettering_scale};
use geofan_render::picture::{Picture, srgb_decode, srgb_encode};
use ndarray::Array2;
use std::f32::consts::TAU;

/// Linear light where there is no error to show: a mid grey, which magma does not pass through.
const MISSING: [f32; 3] = [0.3; 3];

/// More decades than this make a factor of ten a small step of colour.
const MOST_DECADES: i32 = 6;

/// Chooses the ends of a logarithmic scale, as powers of ten: the whole decades from the first
/// percentile of the positive errors to the largest one, or the highest six of them. The scale ends a
/// decade above the 99th percentile at the latest: one wild pixel must not darken all others, and the
/// largest error is written out anyway.
fn decades(errors: &Array2<f32>) -> [i32; 2] {
    let positive = |error: &f32| *error > 0.0 && error.is_finite();
    let mut sorted: Vec<f32> = errors.iter().copied().filter(positive).collect();
    sorted.sort_unstable_by(f32::total_cmp);
    if sorted.is_empty() {
        return [-3, 0];
    }
    let power = |percent: usize| sorted[(percent * sorted.len()).div_ceil(100) - 1].log10();
    let high = power(100).ceil().min(power(99).ceil() + 1.0) as i32;
    let low = (power(1).floor() as i32).clamp(high - MOST_DECADES, high - 1);
    [low, high]
}

/// Draws `errors` (not negative, in `unit`). Pixels without an error (NaN) are grey, and the legend
/// says so.
pub fn error_picture(errors: &Array2<f32>, unit: &str, title: &str) -> Picture {
    let legend = Legend::new(errors, unit);
    let (height, width) = errors.dim();
    let size = (
        width + legend.width(),
        legend.strip() + height.max(legend.least_height()),
    );
    let mut picture = Picture::filled(size.0, size.1, PAPER);
    let title = lettering::shortened(title, size.0 - 2 * legend.gap(), legend.scale);
    let (x, y) = (legend.gap(), legend.gap() + legend.scale);
    lettering::draw(&mut picture, x, y, &title, INK, legend.scale);
    picture.paste(0, legend.strip(), &legend.coloured(errors));
    legend.draw(&mut picture, width);
    picture
}

/// Returns a colour of magma in linear light.
fn magma(place: f32) -> [f32; 3] {
    Colormap::Magma.colour(place).map(srgb_decode)
}

/// Gives errors their colours, and explains them on the right: unit, bar with ticks, largest error,
/// missing pixels.
struct Legend {
    /// Errors of 10^low and less get the darkest colour, those of 10^high and more the brightest.
    low: i32,
    high: i32,
    unit: String,
    notes: Vec<String>,
    missing: bool,
    scale: usize,
}

impl Legend {
    fn new(errors: &Array2<f32>, unit: &str) -> Self {
        let [low, high] = decades(errors);
        let known = errors.iter().copied().filter(|error| !error.is_nan());
        let mut notes = Vec::new();
        if let Some(largest) = known.reduce(f32::max) {
            notes.push(format!("max {}", short_number(largest)));
        }
        Self {
            low,
            high,
            unit: unit.to_string(),
            notes,
            missing: errors.iter().any(|error| error.is_nan()),
            scale: lettering_scale(errors.nrows()),
        }
    }

    /// Tells where `error` lies between the ends: 0 at the low one, 1 at the high one.
    fn place(&self, error: f32) -> f32 {
        let place = (error.max(0.0).log10() - self.low as f32) / self.decades() as f32;
        place.clamp(0.0, 1.0)
    }

    /// Returns the number of decades; at least one, so that no scale is empty.
    fn decades(&self) -> i32 {
        (self.high - self.low).max(1)
    }

    /// Draws the errors alone.
    fn coloured(&self, errors: &Array2<f32>) -> Picture {
        let (height, width) = errors.dim();
        Picture::from_fn(width, height, |x, y| {
            let error = errors[(y, x)];
            if error.is_nan() {
                return MISSING;
            }
            magma(self.place(error))
        })
    }

    fn gap(&self) -> usize {
        3 * self.scale
    }

    fn line(&self) -> usize {
        lettering::LINE_HEIGHT * self.scale
    }

    /// Returns the height of the title strip.
    fn strip(&self) -> usize {
        self.line() + 2 * self.gap()
    }

    /// Counts the lines under the bar.
    fn lines_below(&self) -> usize {
        self.notes.len() + usize::from(self.missing)
    }

    /// Returns the height that the unit, two ticks with labels and the lines below need.
    fn least_height(&self) -> usize {
        (self.lines_below() + 6) * self.line()
    }

    /// Returns the bar's left and right edge from the left edge of the legend.
    fn bar_columns(&self) -> (usize, usize) {
        (3 * self.gap(), 3 * self.gap() + 14 * self.scale)
    }

    /// Returns the column where tick labels start, from the left edge of the legend.
    fn label_column(&self) -> usize {
        self.bar_columns().1 + 6 * self.scale
    }

    fn width(&self) -> usize {
        let width = |text: &str| lettering::width(text, self.scale);
        let ticks = (self.low..=self.high).map(|power| width(&tick_label(power)));
        let labels = self.label_column() + ticks.max().unwrap_or(0);
        let below = self
            .notes
            .iter()
            .chain([&self.unit])
            .map(|text| width(text))
            .max();
        let missing = usize::from(self.missing) * (self.line() + width("no value"));
        let below = 3 * self.gap() + below.unwrap_or(0).max(missing);
        labels.max(below) + 2 * self.gap()
    }

    /// Draws the legend with its left edge at `left`, under the title strip.
    fn draw(&self, picture: &mut Picture, left: usize) {
        let text_column = left + self.bar_columns().0;
        let unit_row = self.strip() + self.scale;
        lettering::draw(picture, text_column, unit_row, &self.unit, INK, self.scale);
        let top = self.strip() + self.line() + 2 * self.gap();
        let below = picture.height() - self.lines_below() * self.line();
        self.draw_bar(picture, left, top, below - self.line());
        let mut row = below;
        for note in &self.notes {
            lettering::draw(picture, text_column, row, note, INK, self.scale);
            row += self.line();
        }
        if self.missing {
            let side = lettering::CAPITAL_HEIGHT * self.scale;
            picture.fill(text_column..text_column + side, row..row + side, MISSING);
            let text_column = text_column + self.line();
            lettering::draw(picture, text_column, row, "no value", INK, self.scale);
        }
    }

    /// Draws the bar between two rows, framed, with its ticks.
    fn draw_bar(&self, picture: &mut Picture, left: usize, top: usize, bottom: usize) {
        let (bar_left, bar_right) = (left + self.bar_columns().0, left + self.bar_columns().1);
        let frame = self.scale;
        let around = bar_left - frame..bar_right + frame;
        picture.fill(around, top - frame..bottom + frame, INK);
        let rows = bottom - top;
        for row in top..bottom {
            let place = (bottom - 1 - row) as f32 / (rows - 1).max(1) as f32;
            picture.fill(bar_left..bar_right, row..row + 1, magma(place));
        }
        let decades = self.decades();
        let every = self.label_step(rows);
        for decade in 0..=decades {
            let row = bottom - (rows - frame) * decade as usize / decades as usize - frame;
            let tick = bar_right..bar_right + 3 * self.scale;
            picture.fill(tick, row..row + frame, INK);
            if decade % every == 0 {
                let label = tick_label(self.low + decade);
                let row = row + frame / 2 - lettering::CAPITAL_HEIGHT * self.scale / 2;
                lettering::draw(
                    picture,
                    left + self.label_column(),
                    row,
                    &label,
                    INK,
                    self.scale,
                );
            }
        }
    }

    /// Returns after how many ticks there is room for another label.
    fn label_step(&self, rows: usize) -> i32 {
        let between = rows / self.decades() as usize;
        self.line().div_ceil(between.max(1)) as i32
    }
}

/// Writes a power of ten as one would by hand.
fn tick_label(power: i32) -> String {
    match power {
        0..=4 => 10_i32.pow(power as u32).to_string(),
        -4..0 => format!("{:.*}", power.unsigned_abs() as usize, 10_f64.powi(power)),
        _ => format!("1e{power}"),
    }
}

/// Writes three significant digits.
fn short_number(value: f32) -> String {
    let power = value.abs().log10().floor();
    if (-3.0..4.0).contains(&power) {
        format!("{value:.*}", (2.0 - power).max(0.0) as usize)
    } else if value == 0.0 || !value.is_finite() {
        value.to_string()
    } else {
        format!("{value:.1e}")
    }
}

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

    fn ramp(width: usize, height: usize) -> Array2<f32> {
        Array2::from_shape_fn((height, width), |(_, x)| {
            10_f32.powf(-3.0 + 4.0 * x as f32 / width as f32)
        })
    }

    #[test]
    fn chosen_decades_hold_nearly_all_errors() {
        assert_eq!(decades(&ramp(400, 2)), [-3, 1]);
        let constant = Array2::from_elem((3, 3), 1.0);
        assert_eq!(decades(&constant), [-1, 0]);
        let mut outlier = ramp(400, 2);
        outlier[(0, 0)] = 1e9;
        assert_eq!(decades(&outlier), [-3, 2]);
        let wide = Array2::from_shape_fn((1, 40), |(_, x)| 10_f32.powi(x as i32 - 35));
        assert_eq!(decades(&wide), [-2, 4]);
    }

    #[test]
    fn errors_without_a_positive_number_have_a_scale_too() {
        for value in [0.0, f32::NAN, f32::INFINITY, -1.0] {
            let errors = Array2::from_elem((4, 4), value);
            assert_eq!(decades(&errors), [-3, 0]);
            error_picture(&errors, "mrad", "title");
        }
    }

    #[test]
    fn a_factor_of_ten_is_the_same_step_everywhere_on_the_scale() {
        let legend = Legend {
            low: -2,
            high: 2,
            ..Legend::new(&ramp(4, 4), "mrad")
        };
        for (error, place) in [(0.01, 0.0), (0.1, 0.25), (1.0, 0.5), (100.0, 1.0)] {
            approx::assert_abs_diff_eq!(legend.place(error), place, epsilon = 1e-6);
        }
        assert_eq!(legend.place(0.0), 0.0);
        assert_eq!(legend.place(f32::INFINITY), 1.0);
    }

    #[test]
    fn missing_errors_are_grey_and_all_others_magma() {
        let mut errors = ramp(50, 40);
        errors[(7, 9)] = f32::NAN;
        let picture = error_picture(&errors, "mrad", "wormhole");
        let top = Legend::new(&errors, "mrad").strip();
        assert_eq!(picture.pixel(9, top + 7), MISSING);
        assert_eq!(picture.pixel(0, top), magma(0.0));
        assert!((0..50).all(|x| picture.pixel(x, top + 8) != MISSING));
    }

    #[test]
    fn pictures_of_any_size_have_room_for_the_bar() {
        for (width, height) in [(0, 0), (1, 1), (5, 700), (700, 5)] {
            let picture = error_picture(&ramp(width, height), "mrad", "a long title");
            assert!(picture.height() > 40 && picture.width() > width + 20);
        }
        error_picture(&ramp(5, 5), "a long unit", "");
    }

    #[test]
    fn numbers_are_written_briefly() {
        let ticks = [-5, -3, 0, 2, 6].map(tick_label);
        assert_eq!(ticks, ["1e-5", "0.001", "1", "100", "1e6"]);
        let numbers =
            [0.0, 0.012_34, 1.234, 999.9, 12_345.0, 1e-7, f32::INFINITY].map(short_number);
        assert_eq!(
            numbers,
            ["0", "0.0123", "1.23", "1000", "1.2e4", "1.0e-7", "inf"]
        );
    }

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
