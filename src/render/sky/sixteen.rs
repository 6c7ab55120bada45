//! Sixteen directions or colours side by side, in single precision.
//!
//! Loops over the lanes of [`Vectors`] become vector instructions where they are inlined under
//! [`crate::expr::vectorised`] and their bodies have no branches.

use crate::render::lanes::LANES;
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

/// The first lane of those marked.
#[inline(always)]
pub fn first(mask: &Mask) -> Option<usize> {
    mask.iter().position(|m| *m)
}

/// The vector in one lane.
#[inline(always)]
pub fn lane(vectors: &Vectors, l: usize) -> Vec3 {
    Vec3::new(vectors[0][l], vectors[1][l], vectors[2][l])
}

/// Replaces the vector in one lane.
#[inline(always)]
pub fn put(vectors: &mut Vectors, l: usize, v: Vec3) {
    vectors[0][l] = v.x;
    vectors[1][l] = v.y;
    vectors[2][l] = v.z;
}
