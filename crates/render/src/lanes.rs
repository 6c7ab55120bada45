//! Sixteen numbers side by side: the width in which tiles, samples and skies are worked on.
//!
//! In: a function of a lane's index. Out: [`Lanes`] in double or [`SingleLanes`] in single precision,
//! and three of each as [`Vectors`]: points, directions or colours.
//!
//! Loops over lanes become vector instructions where they are inlined under
//! [`geofan_expr::vectorised`] and their bodies have no branches. There numbers are compared by [`less`] and [`more`]: the
//! standard library's `min` and `max`, which look for what is not a number, stay scalar in WebAssembly. Results go to a local array first:
//! written where operands might overlap, the loops stay scalar. In such kernels arrays are not mapped:
//! a call to `map` is not always inlined, and is then compiled for the oldest processors.
//!
//! Structures that hold lanes in such kernels are `align(64)`, lanes first: a vector across the end of a
//! cache line takes two accesses. Tiles and samples take 1 to 2 % less time with it.

use glam::{DVec3, Vec3};
use std::ops::Neg;

/// Number of lanes.
pub const LANES: usize = 16;

/// One number in each lane.
pub type Lanes = [f64; LANES];

/// One number in each lane, in single precision: half as many instructions.
pub type SingleLanes = [f32; LANES];

/// The three components of one vector in each lane.
pub type Vectors = [Lanes; 3];

/// The three components of one vector in each lane, in single precision.
pub type SingleVectors = [SingleLanes; 3];

/// Marks on lanes.
pub type Mask = [bool; LANES];

/// Sixteen boxes; one that is inside out holds nothing.
#[derive(Debug, Clone, Copy, Default)]
#[repr(C, align(64))]
pub struct BoxPacket {
    /// The corners with the smallest coordinates.
    pub low: SingleVectors,
    /// The corners with the largest coordinates.
    pub high: SingleVectors,
}

/// Computes `f` in every lane.
#[inline(always)]
pub fn each(f: impl Fn(usize) -> f64) -> Lanes {
    let mut to = [0.0; LANES];
    for l in 0..LANES {
        to[l] = f(l);
    }
    to
}

/// Computes `f` in every lane, in single precision.
#[inline(always)]
pub fn single(f: impl Fn(usize) -> f32) -> SingleLanes {
    let mut to = [0.0; LANES];
    for l in 0..LANES {
        to[l] = f(l);
    }
    to
}

/// Computes `f` of every component and lane.
#[inline(always)]
pub fn each_vector(f: impl Fn(usize, usize) -> f64) -> Vectors {
    [each(|l| f(0, l)), each(|l| f(1, l)), each(|l| f(2, l))]
}

/// Computes the vector `f` in every lane, in single precision.
#[inline(always)]
pub fn single_vector(f: impl Fn(usize) -> Vec3) -> SingleVectors {
    let mut to = [[0.0; LANES]; 3];
    for l in 0..LANES {
        let v = f(l);
        to[0][l] = v.x;
        to[1][l] = v.y;
        to[2][l] = v.z;
    }
    to
}

/// Marks the lanes in which `f` holds.
#[inline(always)]
pub fn mask(f: impl Fn(usize) -> bool) -> Mask {
    let mut to = [false; LANES];
    for l in 0..LANES {
        to[l] = f(l);
    }
    to
}

/// Returns the vector in one lane.
#[inline(always)]
pub fn lane(vectors: &Vectors, l: usize) -> DVec3 {
    DVec3::new(vectors[0][l], vectors[1][l], vectors[2][l])
}

/// Returns the vector in one lane of single precision.
#[inline(always)]
pub fn single_lane(vectors: &SingleVectors, l: usize) -> Vec3 {
    Vec3::new(vectors[0][l], vectors[1][l], vectors[2][l])
}

/// Replaces the vector in one lane of single precision.
#[inline(always)]
pub fn set_lane(vectors: &mut SingleVectors, l: usize, v: Vec3) {
    vectors[0][l] = v.x;
    vectors[1][l] = v.y;
    vectors[2][l] = v.z;
}

/// Returns the smallest and the largest number, halves against halves so that it takes vector
/// instructions.
#[inline(always)]
pub fn range<T: Copy + PartialOrd + Neg<Output = T>>(x: &[T; LANES]) -> [T; 2] {
    let (mut low, mut high) = (*x, *x);
    let mut half = LANES / 2;
    while half > 0 {
        for l in 0..half {
            low[l] = less(low[l], low[l + half]);
            high[l] = -less(-high[l], -high[l + half]);
        }
        half /= 2;
    }
    [low[0], high[0]]
}

/// Returns the largest number, with half the work of [`range`].
#[inline(always)]
pub fn largest(x: &SingleLanes) -> f32 {
    let mut high = *x;
    let mut half = LANES / 2;
    while half > 0 {
        for l in 0..half {
            high[l] = more(high[l], high[l + half]);
        }
        half /= 2;
    }
    high[0]
}

/// Packs a mask into one byte for each lane, to be looked at together where a search would go from lane
/// to lane.
#[inline(always)]
fn bytes(mask: &Mask) -> u128 {
    let mut bytes = [0; LANES];
    for l in 0..LANES {
        bytes[l] = u8::from(mask[l]);
    }
    u128::from_le_bytes(bytes)
}

/// Tells whether any lane is marked.
#[inline(always)]
pub fn any(mask: &Mask) -> bool {
    bytes(mask) != 0
}

/// Returns the first lane that is marked.
#[inline(always)]
pub fn first(mask: &Mask) -> Option<usize> {
    match bytes(mask) {
        0 => None,
        marked => Some(marked.trailing_zeros() as usize / 8),
    }
}

/// Returns the smaller of two numbers; the second if one is not a number.
#[inline(always)]
pub fn less<T: PartialOrd>(a: T, b: T) -> T {
    if a < b { a } else { b }
}

/// Returns the larger of two numbers; the second if one is not a number.
#[inline(always)]
pub fn more<T: PartialOrd>(a: T, b: T) -> T {
    if a > b { a } else { b }
}

/// Returns the number between two limits that is nearest to `x`; the lower limit if that is not a number.
#[inline(always)]
pub fn limited<T: PartialOrd>(x: T, low: T, high: T) -> T {
    less(more(x, low), high)
}

/// Rounds to the nearest whole number, for |x| < 2²². The digits behind the point fall off the end of
/// the sum: the standard library's rounding is a call on some machines, which keeps loops scalar.
#[inline(always)]
pub fn nearest(x: f32) -> f32 {
    const SHIFT: f32 = 1.5 * (1 << 23) as f32;
    (x + SHIFT) - SHIFT
}

/// Rounds down to a whole number, for |x| < 2²².
#[inline(always)]
pub fn floor(x: f32) -> f32 {
    let near = nearest(x);
    if near > x { near - 1.0 } else { near }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_marked_lane_is_found() {
        assert!(first(&[false; LANES]).is_none() && !any(&[false; LANES]));
        for from in 0..LANES {
            let mask = std::array::from_fn(|l| l == from || l > from && l % 3 == 0);
            assert!(first(&mask) == Some(from) && any(&mask));
        }
    }
}
