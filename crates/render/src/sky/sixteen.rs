//! Sixteen directions or colours side by side, in single precision.
//!
//! Loops over the lanes of [`Vectors`] become vector instructions where they are inlined under
//! [`geofan_expr::vectorised`] and their bodies have no branches.

use crate::lanes::LANES;
pub use crate::lanes::first;
use glam::Vec3;

/// One number in each lane.
pub type Numbers = [f32; LANES];

/// The components of one vector, or red, green and blue, in each lane.
pub type Vectors = [Numbers; 3];

/// Which lanes are asked for.
pub type Mask = [bool; LANES];

/// `f` of every lane.
#[inline(always)]
pub fn each(f: impl Fn(usize) -> f32) -> Numbers {
    let mut to = [0.0; LANES];
    for l in 0..LANES {
        to[l] = f(l);
    }
    to
}

/// `f` of every lane.
#[inline(always)]
pub fn each_vector(f: impl Fn(usize) -> Vec3) -> Vectors {
    let mut to = [[0.0; LANES]; 3];
    for l in 0..LANES {
        let v = f(l);
        to[0][l] = v.x;
        to[1][l] = v.y;
        to[2][l] = v.z;
    }
    to
}

/// Whether `f` holds in each lane.
#[inline(always)]
pub fn mask(f: impl Fn(usize) -> bool) -> Mask {
    let mut to = [false; LANES];
    for l in 0..LANES {
        to[l] = f(l);
    }
    to
}

/// The largest number, halves against halves so that it takes vector instructions.
#[inline(always)]
pub fn largest(x: &Numbers) -> f32 {
    let mut high = *x;
    let mut half = LANES / 2;
    while half > 0 {
        for l in 0..half {
            let other = high[l + half];
            high[l] = if high[l] > other { high[l] } else { other };
        }
        half /= 2;
    }
    high[0]
}

/// The vector in one lane.
#[inline(always)]
pub fn lane(vectors: &Vectors, l: usize) -> Vec3 {
    Vec3::new(vectors[0][l], vectors[1][l], vectors[2][l])
}

/// The whole number nearest to `x`, for |x| < 2²². The digits behind the point fall off the end of
/// the sum: the standard library's rounding is a call on some machines, which keeps loops scalar.
#[inline(always)]
pub fn nearest(x: f32) -> f32 {
    const SHIFT: f32 = 1.5 * (1 << 23) as f32;
    (x + SHIFT) - SHIFT
}

/// The whole number not above `x`, for |x| < 2²².
#[inline(always)]
pub fn floor(x: f32) -> f32 {
    let near = nearest(x);
    if near > x { near - 1.0 } else { near }
}

/// Replaces the vector in one lane.
#[inline(always)]
pub fn put(vectors: &mut Vectors, l: usize, v: Vec3) {
    vectors[0][l] = v.x;
    vectors[1][l] = v.y;
    vectors[2][l] = v.z;
}
