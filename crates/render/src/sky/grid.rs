//! The "grid" sky: lines of latitude and longitude over a slowly varying tint, and a lettered disc
//! on each axis: +X red, −X cyan, +Y green, −Y magenta, +Z blue, −Z yellow.
//!
//! In: direction and footprint (radians). Out: linear radiance.
//!
//! Every edge is averaged over the footprint across it: a line thinner than that stays as wide as it and
//! gets fainter. Letters stand upright for someone who turns from +x without rolling: up is +z on
//! the horizon, and at ±z whatever tilting the head from +x brings to the top.

use super::longitude_latitude;
use crate::{
    filter::{Across, LaneTaps},
    lanes::{
        LANES, Mask, SingleLanes, SingleVectors, first, floor, less, limited, mask, more, nearest,
        single, single_lane, single_vector,
    },
};
use glam::{Vec2, Vec3};
use std::f32::consts::PI;

/// Angle between lines.
const STEP: f32 = PI / 12.0;
/// Half the width of a line: two pixels of a 1920-wide view of 90° in all.
const THIN: f32 = 0.0009;
/// Half the width of the equator and the meridian through ±x and ±z.
const THICK: f32 = 0.0028;
/// Angular radius of a mark.
const MARK: f32 = 0.125;
/// Cosine of the latitude of the last circle, five steps up.
const POLAR_CIRCLE: f32 = 0.258_819;
/// Height of the letters and half the width of their strokes, in the tangent plane of the axis.
const LETTER: f32 = 0.11;
const PEN: f32 = 0.008;

/// The tint's mean and how it varies along each axis.
const TINT: Vec3 = Vec3::new(0.085, 0.09, 0.115);
const TINT_SLOPE: Vec3 = Vec3::new(0.055, 0.045, 0.06);
const LINE: Vec3 = Vec3::new(0.62, 0.66, 0.7);
const EQUATOR: Vec3 = Vec3::new(1.0, 0.62, 0.12);
const MERIDIAN: Vec3 = Vec3::new(0.2, 0.85, 0.95);
const INK: Vec3 = Vec3::new(1.0, 1.0, 1.0);
/// Colours of the marks: by axis, positive first.
const MARKS: [[Vec3; 2]; 3] = [
    [Vec3::new(0.75, 0.02, 0.02), Vec3::new(0.0, 0.34, 0.4)],
    [Vec3::new(0.02, 0.4, 0.03), Vec3::new(0.5, 0.02, 0.42)],
    [Vec3::new(0.03, 0.07, 0.8), Vec3::new(0.42, 0.3, 0.0)],
];

/// Limits a width to average over, radians. Beyond one step a footprint holds several lines and all there is
/// to see is their mean. A width that is no number asks for a point.
#[inline(always)]
fn averaged_width(width: f32) -> f32 {
    limited(width, 1e-5, STEP)
}

/// Angles over which to average, radians.
struct Reach {
    /// Across circles of latitude.
    rows: f32,
    /// Across meridians.
    columns: f32,
    /// Across the plane of ±x and ±z.
    side: f32,
}

impl Reach {
    /// Takes that of a round footprint.
    #[inline(always)]
    fn round(width: f32) -> Self {
        Self {
            rows: width,
            columns: width,
            side: width,
        }
    }

    /// Takes that of a footprint that is spanned by two changes of `d`: a box as wide as the deviation of its
    /// projection.
    #[inline(always)]
    fn of(d: Vec3, [a, b]: [Vec3; 2]) -> Self {
        let cosine = more((d.x * d.x + d.y * d.y).sqrt(), 1e-6);
        let longest = (a.length_squared() + b.length_squared()).sqrt();
        let north = Vec2::new(a.z, b.z).length() / cosine;
        let east = Vec2::new(d.x * a.y - d.y * a.x, d.x * b.y - d.y * b.x).length() / cosine;
        Self {
            rows: averaged_width(less(north, longest)),
            columns: averaged_width(less(east, longest)),
            side: averaged_width(Vec2::new(a.y, b.y).length()),
        }
    }
}

/// Returns linear light of the pattern from the unit vector `d`, averaged over about `width` radians.
pub(super) fn radiance(d: Vec3, width: f32) -> Vec3 {
    let width = averaged_width(width);
    let behind = lines(d, &Reach::round(width));
    if !touches_mark(d, width) {
        return behind;
    }
    let mark = Mark::nearest(d);
    let p = mark.place(d);
    let distances = mark.strokes().map(|s| squared_distance(s, p / LETTER));
    let squared = distances.fold(f32::INFINITY, f32::min);
    mark.over(behind, p, squared, width)
}

/// Returns linear light from the unit vectors `d`, averaged over what samples stand for that change `across`,
/// in the lanes that are `wanted`.
#[inline(always)]
pub(super) fn lights(d: &SingleVectors, across: &Across, wanted: &Mask) -> SingleVectors {
    let [right, down] = across;
    let light = single_vector(
        #[inline(always)]
        |l| {
            let reach = Reach::of(
                single_lane(d, l),
                [single_lane(right, l), single_lane(down, l)],
            );
            lines(single_lane(d, l), &reach)
        },
    );
    let touched = mask(
        #[inline(always)]
        |l| {
            let length = single_lane(right, l).length() + single_lane(down, l).length();
            wanted[l] & touches_mark(single_lane(d, l), less(length, STEP))
        },
    );
    match first(&touched) {
        Some(_) => marked(light, d, &LaneTaps::of(across, 0.0), touched),
        None => light,
    }
}

/// Lays marks over `light` in the lanes that are `touched`, by round footprints.
#[inline(always)]
fn marked(
    mut light: SingleVectors,
    d: &SingleVectors,
    taps: &LaneTaps,
    mut touched: Mask,
) -> SingleVectors {
    while let Some(l) = first(&touched) {
        let mark = Mark::nearest(single_lane(d, l));
        let here = mask(
            #[inline(always)]
            // What is not a number is here, or it would be nowhere.
            |l| touched[l] & !(mark.height(single_lane(d, l)) <= 0.9),
        );
        let over = taps.mean(
            d,
            &here,
            #[inline(always)]
            |places, _| mark.over_lanes(&light, places, &taps.width),
        );
        light = single_vector(
            #[inline(always)]
            |l| single_lane(if here[l] { &over } else { &light }, l),
        );
        touched = mask(
            #[inline(always)]
            |l| touched[l] & !here[l],
        );
    }
    light
}

/// Tells whether the mark of the nearest axis reaches into the footprint.
#[inline(always)]
fn touches_mark(d: Vec3, width: f32) -> bool {
    let cosine = more(more(d.x.abs(), d.y.abs()), d.z.abs());
    let reach = MARK + 0.5 * width;
    // In the tangent plane; a little more than that, as the cosine is rounded.
    1.0 - cosine * cosine < cosine * cosine * reach * reach + 1e-5
}

/// Returns tint, chequers and lines. Without branches, so that a loop over directions takes vector
/// instructions.
#[inline(always)]
fn lines(d: Vec3, reach: &Reach) -> Vec3 {
    let across = (d.x * d.x + d.y * d.y).sqrt();
    let (longitude, latitude) = longitude_latitude(d);
    let (row, column) = (latitude * (1.0 / STEP), longitude * (1.0 / STEP));
    let (nearest_row, nearest_column) = (nearest(row), nearest(column));
    let from_row = (row - nearest_row).abs() * STEP;
    // Half a step is small enough for the sine's first two terms.
    let turn = (column - nearest_column).abs() * STEP;
    let from_column = (turn - turn * turn * turn * (1.0 / 6.0)) * across;

    // Chequers, faded out at their edges over the footprint and where they shrink at the poles.
    let half = 0.5 * (floor(row) + floor(column));
    let sign = 1.0 - 4.0 * (half - floor(half));
    let fade = clear(from_row, reach.rows) * clear(from_column, reach.columns);
    let fade = fade * clear(0.5 * across * STEP, reach.columns);
    let tint = (TINT + TINT_SLOPE * d) * (1.0 + 0.16 * fade * sign);

    // Only every sixth meridian goes on past the last circle, where all would run together.
    let sixth = nearest_column * (1.0 / 6.0);
    let drawn = (across > POLAR_CIRCLE) | ((sixth - nearest(sixth)).abs() < 0.01);
    let row = coverage(from_row, THIN, reach.rows);
    let column = coverage(from_column, THIN, reach.columns);
    let line = tint.lerp(LINE, if drawn { more(row, column) } else { row });
    let line = line.lerp(MERIDIAN, coverage(d.y.abs(), THICK, reach.side));
    line.lerp(EQUATOR, coverage(latitude.abs(), THICK, reach.rows))
}

/// Returns the share of the chequers that is left at a distance from their edges.
#[inline(always)]
fn clear(distance: f32, width: f32) -> f32 {
    let inverse = 1.0 / width;
    less(2.0 * distance * inverse, 1.0)
}

/// Returns the part of a footprint that a line covers whose middle is `distance` away.
#[inline(always)]
fn coverage(distance: f32, half_width: f32, width: f32) -> f32 {
    let (half, inverse) = (0.5 * width, 1.0 / width);
    let covered = less(distance + half, half_width) - more(distance - half, -half_width);
    limited(covered * inverse, 0.0, 1.0)
}

/// The lettered disc on an axis.
#[derive(Clone, Copy)]
struct Mark {
    axis: usize,
    positive: bool,
    right: Vec3,
    up: Vec3,
    /// Along the axis, outwards.
    forward: Vec3,
}

impl Mark {
    /// Returns the mark of the axis nearest to `d`.
    fn nearest(d: Vec3) -> Self {
        let axis = d.abs().max_position();
        let positive = d[axis] > 0.0;
        let (right, up) = upright(axis, positive);
        let forward = Vec3::AXES[axis] * d[axis].signum();
        Self {
            axis,
            positive,
            right,
            up,
            forward,
        }
    }

    /// Iterates over the strokes of its letters.
    fn strokes(&self) -> impl Iterator<Item = &'static Stroke> {
        strokes(self.axis, self.positive)
    }

    /// Returns the cosine of the angle to the axis.
    #[inline(always)]
    fn height(&self, d: Vec3) -> f32 {
        self.forward.dot(d)
    }

    /// Returns the place in the tangent plane: gnomonic, so that straight strokes are geodesics.
    #[inline(always)]
    fn place(&self, d: Vec3) -> Vec2 {
        Vec2::new(self.right.dot(d), self.up.dot(d)) / self.height(d)
    }

    /// Lays the light of the disc over `behind`, at the place `p` whose distance from the strokes is the
    /// square root of `squared` letters.
    #[inline(always)]
    fn over(&self, behind: Vec3, p: Vec2, squared: f32, width: f32) -> Vec3 {
        let from_centre = p.length();
        let inside = (MARK - from_centre) * (1.0 / width) + 0.5;
        let disc = limited(inside, 0.0, 1.0);
        let pen = coverage(squared.sqrt() * LETTER, PEN, width);
        let rim = coverage(MARK - 0.004 - from_centre, 0.002, width);
        let face = MARKS[self.axis][usize::from(!self.positive)];
        behind.lerp(face.lerp(INK, more(pen, rim)), disc)
    }

    /// Computes [`Mark::over`] in all lanes.
    #[inline(always)]
    fn over_lanes(
        &self,
        behind: &SingleVectors,
        d: &SingleVectors,
        widths: &SingleLanes,
    ) -> SingleVectors {
        let places = single_vector(
            #[inline(always)]
            |l| self.place(single_lane(d, l)).extend(0.0),
        );
        let mut squared = [f32::INFINITY; LANES];
        for stroke in self.strokes() {
            let old = squared;
            squared = single(
                #[inline(always)]
                |l| {
                    let p = single_lane(&places, l).truncate() / LETTER;
                    less(squared_distance(stroke, p), old[l])
                },
            );
        }
        single_vector(
            #[inline(always)]
            |l| {
                let (behind, p) = (single_lane(behind, l), single_lane(&places, l).truncate());
                self.over(behind, p, squared[l], averaged_width(widths[l]))
            },
        )
    }
}

/// Returns right and up of the letters on an axis, as seen from the centre.
fn upright(axis: usize, positive: bool) -> (Vec3, Vec3) {
    let sign = if positive { 1.0 } else { -1.0 };
    match axis {
        0 => (Vec3::NEG_Y * sign, Vec3::Z),
        1 => (Vec3::X * sign, Vec3::Z),
        _ => (Vec3::NEG_Y, Vec3::NEG_X * sign),
    }
}

/// A straight stroke of a pen of no width, in the plane of a mark: right and up, with letters one unit high
/// around (0, 0).
type Stroke = (Vec2, Vec2);

const fn stroke(x0: f32, y0: f32, x1: f32, y1: f32) -> Stroke {
    (Vec2::new(x0, y0), Vec2::new(x1, y1))
}

/// Strokes of the signs and letters.
const PLUS: [Stroke; 2] = [
    stroke(-0.75, 0.0, -0.2, 0.0),
    stroke(-0.475, -0.275, -0.475, 0.275),
];
const MINUS: [Stroke; 1] = [stroke(-0.75, 0.0, -0.2, 0.0)];
const X: [Stroke; 2] = [stroke(0.08, -0.5, 0.72, 0.5), stroke(0.08, 0.5, 0.72, -0.5)];
const Y: [Stroke; 3] = [
    stroke(0.08, 0.5, 0.4, 0.02),
    stroke(0.72, 0.5, 0.4, 0.02),
    stroke(0.4, 0.02, 0.4, -0.5),
];
const Z: [Stroke; 3] = [
    stroke(0.1, 0.5, 0.7, 0.5),
    stroke(0.7, 0.5, 0.1, -0.5),
    stroke(0.1, -0.5, 0.7, -0.5),
];

/// Iterates over the strokes of the name of an axis (0 x, 1 y, 2 z) with its sign.
fn strokes(axis: usize, positive: bool) -> impl Iterator<Item = &'static Stroke> {
    let sign = if positive { &PLUS[..] } else { &MINUS[..] };
    let letter = [&X[..], &Y[..], &Z[..]][axis];
    sign.iter().chain(letter)
}

/// Returns the square of the distance from `p` to a stroke.
#[inline(always)]
fn squared_distance((start, end): &Stroke, p: Vec2) -> f32 {
    let way = *end - *start;
    let along = limited((p - *start).dot(way) / way.length_squared(), 0.0, 1.0);
    (*start + way * along).distance_squared(p)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_are_upright_and_not_mirrored() {
        for axis in 0..3 {
            for positive in [true, false] {
                let (right, up) = upright(axis, positive);
                let forward = Vec3::AXES[axis] * if positive { 1.0 } else { -1.0 };
                assert_eq!(forward.cross(up), right);
            }
        }
    }

    #[test]
    fn coverage_conserves_a_line_however_wide_the_footprint() {
        for footprint in [1e-4_f32, 1e-3, 1e-2, 0.2] {
            let both = averaged_width(footprint);
            let step = footprint.min(THIN) / 50.0;
            let reach = THIN + footprint;
            let count = (reach / step) as i32;
            let sum: f32 = (-count..=count)
                .map(|i| coverage((i as f32 * step).abs(), THIN, both) * step)
                .sum();
            assert!(
                (sum / (2.0 * THIN) - 1.0).abs() < 0.02,
                "{footprint}: {sum}"
            );
        }
    }
}
