//! The two-letter names of the axes as pen strokes, for marks on the sphere.
//!
//! In: a point of the plane of the mark, right and up, with letters one unit high around (0, 0).
//! Out: the strokes of a name, and the squared distance to each.

use glam::Vec2;

/// A straight stroke of a pen of no width.
pub(super) type Stroke = (Vec2, Vec2);

const fn stroke(x0: f32, y0: f32, x1: f32, y1: f32) -> Stroke {
    (Vec2::new(x0, y0), Vec2::new(x1, y1))
}

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

/// The name of the axis (0 x, 1 y, 2 z) with its sign.
pub(super) fn strokes(axis: usize, positive: bool) -> impl Iterator<Item = &'static Stroke> {
    let sign = if positive { &PLUS[..] } else { &MINUS[..] };
    let letter = [&X[..], &Y[..], &Z[..]][axis];
    sign.iter().chain(letter)
}

/// Square of the distance from `p` to a stroke.
#[inline(always)]
pub(super) fn squared_distance((start, end): &Stroke, p: Vec2) -> f32 {
    let way = *end - *start;
    let along = ((p - *start).dot(way) / way.length_squared()).clamp(0.0, 1.0);
    (*start + way * along).distance_squared(p)
}
