//! Sixteen numbers side by side: the width in which tiles and samples are worked on.
//!
//! Loops over [`Lanes`] become vector instructions where they are inlined under
//! [`geofan_expr::vectorised`]. Results go to a local array first: written where operands might
//! overlap, the loops stay scalar. In such kernels arrays are not mapped: what `map` calls is not
//! always inlined, and then compiled for the oldest processors.
//!
//! Structures that hold lanes in such kernels are `align(64)`, lanes first: a vector across the end of a
//! line of memory takes two accesses. Tiles and samples take 0.98 to 0.99 of their time with it.

use glam::DVec3;
use std::ops::Neg;

/// How many.
pub const LANES: usize = 16;

/// One number in each lane.
pub type Lanes = [f64; LANES];

/// One number in each lane, in single precision: half as many instructions.
pub type SingleLanes = [f32; LANES];

/// x, y and z of one point in each lane.
pub type Points = [Lanes; 3];

/// The same in single precision.
pub type SinglePoints = [SingleLanes; 3];

/// `f` of every lane's number.
#[inline(always)]
pub fn each(f: impl Fn(usize) -> f64) -> Lanes {
    let mut to = [0.0; LANES];
    for l in 0..LANES {
        to[l] = f(l);
    }
    to
}

/// `f` of every lane's number, in single precision.
#[inline(always)]
pub fn single(f: impl Fn(usize) -> f32) -> SingleLanes {
    let mut to = [0.0; LANES];
    for l in 0..LANES {
        to[l] = f(l);
    }
    to
}

/// `f` of every component and lane.
#[inline(always)]
pub fn each_point(f: impl Fn(usize, usize) -> f64) -> Points {
    [each(|l| f(0, l)), each(|l| f(1, l)), each(|l| f(2, l))]
}

/// The point in one lane.
#[inline(always)]
pub fn lane(points: &Points, l: usize) -> DVec3 {
    DVec3::new(points[0][l], points[1][l], points[2][l])
}

/// The least and the largest number, halves against halves so that it takes vector instructions.
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

/// Which lanes are marked, one byte each: looked at together, where a search would go from lane to lane.
#[inline(always)]
fn bytes(mask: &[bool; LANES]) -> u128 {
    let mut bytes = [0; LANES];
    for l in 0..LANES {
        bytes[l] = u8::from(mask[l]);
    }
    u128::from_le_bytes(bytes)
}

/// Whether any lane is marked.
#[inline(always)]
pub fn any(mask: &[bool; LANES]) -> bool {
    bytes(mask) != 0
}

/// The first lane that is marked.
#[inline(always)]
pub fn first(mask: &[bool; LANES]) -> Option<usize> {
    match bytes(mask) {
        0 => None,
        marked => Some(marked.trailing_zeros() as usize / 8),
    }
}

/// The smaller of two; the second if one is not a number.
#[inline(always)]
pub fn less<T: PartialOrd>(a: T, b: T) -> T {
    if a < b { a } else { b }
}

/// The larger of two; the second if one is not a number.
#[inline(always)]
pub fn more<T: PartialOrd>(a: T, b: T) -> T {
    if a > b { a } else { b }
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
