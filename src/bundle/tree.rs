//! The tree of boxes over one chunk of the table.
//!
//! A chunk covers one cell of camera parameters, one face of directions and all arc lengths, all in
//! [−1, 1]. [`Tree`] halves boxes along one axis at a time down to patches. Axes are numbered
//! camera…, direction…, arc length.

use super::{
    bytes::{Damage, Reader, Writer},
    patch::{Patch, Tensor},
};
use std::sync::Arc;

/// A box of the table, divided or not.
#[derive(Debug, Clone)]
pub enum Tree {
    /// Halved at the middle of `axis`.
    Split {
        /// The axis.
        axis: usize,
        /// The lower and the upper half.
        halves: Box<[Tree; 2]>,
    },
    /// One polynomial.
    Leaf(Arc<Patch>),
    /// Given up: rays here are integrated exactly.
    Flagged,
}

/// What a tree's tensors must look like.
#[derive(Debug, Clone, Copy)]
pub struct Shape {
    /// Axes of boxes: camera…, direction…, arc length.
    pub axes: usize,
    /// Displacement channels.
    pub displacement: usize,
    /// Quaternion channels.
    pub rotation: usize,
}

/// Deepest tree accepted from a file; bakes stop far earlier.
const DEEPEST: usize = 64;

impl Tree {
    /// Writes the tree, patches included.
    pub fn encode(&self, out: &mut Writer) {
        match self {
            Tree::Split { axis, halves } => {
                out.u8(*axis as u8);
                halves.iter().for_each(|half| half.encode(out));
            }
            Tree::Flagged => out.u8(FLAGGED),
            Tree::Leaf(patch) => {
                out.u8(if patch.rotation.is_some() {
                    TURNING
                } else {
                    PLAIN
                });
                patch.displacement.encode(out);
                if let Some(rotation) = &patch.rotation {
                    rotation.encode(out);
                }
            }
        }
    }

    /// Reads what [`Tree::encode`] wrote.
    pub fn decode(input: &mut Reader<'_>, shape: Shape) -> Result<Self, Damage> {
        Self::decode_at(input, shape, 0)
    }

    fn decode_at(input: &mut Reader<'_>, shape: Shape, depth: usize) -> Result<Self, Damage> {
        let axes = shape.axes;
        if depth > DEEPEST {
            return Err(Damage("depth of the tree"));
        }
        match input.u8()? {
            FLAGGED => Ok(Tree::Flagged),
            kind @ (PLAIN | TURNING) => Ok(Tree::Leaf(Arc::new(Patch {
                displacement: Tensor::decode(input, axes + 1, shape.displacement)?,
                rotation: match kind {
                    TURNING => Some(Tensor::decode(input, axes + 1, shape.rotation)?),
                    _ => None,
                },
            }))),
            axis if usize::from(axis) < axes => {
                let low = Self::decode_at(input, shape, depth + 1)?;
                let high = Self::decode_at(input, shape, depth + 1)?;
                Ok(Tree::Split {
                    axis: usize::from(axis),
                    halves: Box::new([low, high]),
                })
            }
            _ => Err(Damage("kind of a box")),
        }
    }

    /// How many patches and flagged boxes there are.
    pub fn count(&self) -> (usize, usize) {
        match self {
            Tree::Leaf(_) => (1, 0),
            Tree::Flagged => (0, 1),
            Tree::Split { halves, .. } => {
                let [(a, b), (c, d)] = halves.each_ref().map(Tree::count);
                (a + c, b + d)
            }
        }
    }
}

const FLAGGED: u8 = 255;
const PLAIN: u8 = 254;
const TURNING: u8 = 253;
