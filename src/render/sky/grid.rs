//! The "grid" sky: lines of latitude and longitude over a slowly varying tint, and a lettered disc
//! on each axis: +X red, −X cyan, +Y green, −Y magenta, +Z blue, −Z yellow.
//!
//! In: direction and footprint (radians). Out: linear radiance.
//!
//! Every edge is averaged over the footprint: a line thinner than that stays as wide as it and
//! gets fainter. Letters stand upright for someone who turns from +x without rolling: up is +z on
//! the horizon, and at ±z whatever tilting the head from +x brings to the top.

use super::{angles::longitude_latitude, glyph};
use glam::{Vec2, Vec3, Vec3A};
use std::f32::consts::PI;

/// Angle between lines.
const STEP: f32 = PI / 12.0;
/// Half the width of a line: two pixels of a 1920-wide view of 90° in all.
const THIN: f32 = 0.0009;
/// Half the width of the equator and the meridian through ±x and ±z.
const THICK: f32 = 0.0028;
/// Angular radius of a mark.
const MARK: f32 = 0.125;
/// A little less than the cosine of that angle.
const MARK_COSINE: f32 = 0.99;
/// Cosine of the latitude of the last circle, five steps up.
const POLAR_CIRCLE: f32 = 0.258_819;
/// Height of the letters and half the width of their strokes, in the tangent plane of the axis.
const LETTER: f32 = 0.11;
const PEN: f32 = 0.008;

/// The tint's mean and how it varies along each axis.
const TINT: Vec3A = Vec3A::new(0.085, 0.09, 0.115);
const TINT_SLOPE: Vec3A = Vec3A::new(0.055, 0.045, 0.06);
const LINE: Vec3A = Vec3A::new(0.62, 0.66, 0.7);
const EQUATOR: Vec3A = Vec3A::new(1.0, 0.62, 0.12);
const MERIDIAN: Vec3A = Vec3A::new(0.2, 0.85, 0.95);
const INK: Vec3A = Vec3A::new(1.0, 1.0, 1.0);
/// Colours of the marks: by axis, positive first.
const MARKS: [[Vec3A; 2]; 3] = [
    [Vec3A::new(0.75, 0.02, 0.02), Vec3A::new(0.0, 0.34, 0.4)],
    [Vec3A::new(0.02, 0.4, 0.03), Vec3A::new(0.5, 0.02, 0.42)],
    [Vec3A::new(0.03, 0.07, 0.8), Vec3A::new(0.42, 0.3, 0.0)],
];

/// The angle to average over, in radians, and its inverse.
#[derive(Clone, Copy)]
struct Footprint {
    width: f32,
    inverse: f32,
}

/// Linear light of the pattern from the unit vector `d`, averaged over about `footprint` radians.
pub(super) fn radiance(d: Vec3, footprint: f32) -> Vec3 {
    // Beyond one step a footprint holds several lines and all there is to see is their mean.
    let width = footprint.clamp(1e-5, STEP);
    let inverse = 1.0 / width;
    let footprint = Footprint { width, inverse };
    let lines = lines(d, footprint);
    // The footprint softens a mark's rim outwards too.
    if d.abs().max_element() > MARK_COSINE - width {
        with_mark(d, footprint, lines).into()
    } else {
        lines.into()
    }
}

/// Tint, chequers and lines.
fn lines(d: Vec3, footprint: Footprint) -> Vec3A {
    let across = (d.x * d.x + d.y * d.y).sqrt();
    let (longitude, latitude) = longitude_latitude(d);
    let (row, column) = (latitude * (1.0 / STEP), longitude * (1.0 / STEP));
    let (nearest_row, nearest_column) = (floor(row + 0.5), floor(column + 0.5));
    let from_row = (row - nearest_row as f32).abs() * STEP;
    // Half a step is small enough for the sine's first two terms.
    let turn = (column - nearest_column as f32).abs() * STEP;
    let from_column = (turn - turn * turn * turn * (1.0 / 6.0)) * across;

    // Chequers, faded out at their edges over the footprint and where they shrink at the poles.
    let odd = (floor(row) + floor(column)) & 1;
    let clear = |distance: f32| (2.0 * distance * footprint.inverse).min(1.0);
    let fade = clear(from_row) * clear(from_column) * clear(0.5 * across * STEP);
    let shade = 1.0 + 0.16 * fade * (1 - 2 * odd) as f32;
    let mut colour = (TINT + TINT_SLOPE * Vec3A::from(d)) * shade;

    // Only every sixth meridian goes on past the last circle, where all would run together.
    let drawn = nearest_column % 6 == 0 || across > POLAR_CIRCLE;
    let nearest = if drawn {
        from_row.min(from_column)
    } else {
        from_row
    };
    // Most of the sky is clear of lines.
    if nearest < THICK + footprint.width {
        colour = colour.lerp(LINE, coverage(nearest, THIN, footprint));
        colour = colour.lerp(MERIDIAN, coverage(d.y.abs(), THICK, footprint));
        colour = colour.lerp(EQUATOR, coverage(latitude.abs(), THICK, footprint));
    }
    colour
}

/// The whole number below `x`, for |x| < 1000: without SSE 4.1 `f32::floor` is a library call.
fn floor(x: f32) -> i32 {
    (x + 1024.0) as i32 - 1024
}

/// Part of a footprint that a line covers whose middle is `distance` away.
fn coverage(distance: f32, half_width: f32, footprint: Footprint) -> f32 {
    let half = 0.5 * footprint.width;
    let covered = (distance + half).min(half_width) - (distance - half).max(-half_width);
    (covered * footprint.inverse).clamp(0.0, 1.0)
}

/// `behind` with the nearest axis's mark laid over it.
fn with_mark(d: Vec3, footprint: Footprint, behind: Vec3A) -> Vec3A {
    let axis = d.abs().max_position();
    let positive = d[axis] > 0.0;
    let (right, up) = upright(axis, positive);
    // Gnomonic, so that straight strokes are geodesics.
    let p = Vec2::new(right.dot(d), up.dot(d)) / d[axis].abs();
    let inside = |depth: f32| (depth * footprint.inverse + 0.5).clamp(0.0, 1.0);
    let from_centre = p.length();
    let disc = inside(MARK - from_centre);
    if disc == 0.0 {
        return behind;
    }
    let from_stroke = glyph::distance(axis, positive, p / LETTER) * LETTER;
    let ink = coverage(from_stroke, PEN, footprint).max(coverage(
        MARK - 0.004 - from_centre,
        0.002,
        footprint,
    ));
    let face = MARKS[axis][usize::from(!positive)];
    behind.lerp(face.lerp(INK, ink), disc)
}

/// Right and up of the letters on an axis, as seen from the centre.
fn upright(axis: usize, positive: bool) -> (Vec3, Vec3) {
    let sign = if positive { 1.0 } else { -1.0 };
    match axis {
        0 => (Vec3::NEG_Y * sign, Vec3::Z),
        1 => (Vec3::X * sign, Vec3::Z),
        _ => (Vec3::NEG_Y, Vec3::NEG_X * sign),
    }
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
            let both = Footprint {
                width: footprint,
                inverse: footprint.recip(),
            };
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
