//! The tree of boxes over one chunk of the table.
//!
//! A chunk covers one cell of camera parameters, one face of directions or all of them, and all arc
//! lengths, all in [−1, 1]. [`Tree`] parts the sphere of directions into faces and halves boxes along one
//! axis at a time down to patches. Axes are numbered camera…, direction…, arc length.

use crate::{
    coder::{Coded, Integers},
    decode::{DecodeError, Reader, Writer},
    polynomial::Variables,
    rays::FACES,
    tensor::Tensor,
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
    /// All directions parted into their faces.
    Faces(Box<[Tree; FACES]>),
    /// A patch: one polynomial for all its paths.
    Leaf(Arc<Tensor>),
    /// Given up: rays here are integrated exactly.
    Flagged,
}

/// What a tree's tensors must look like.
#[derive(Debug, Clone, Copy)]
pub struct Shape {
    /// Of cameras and directions.
    pub variables: Variables,
    /// Direction axes.
    pub directions: usize,
    /// Stored channels.
    pub channels: usize,
}

/// Deepest tree accepted from a file; bakes stop far earlier.
const DEEPEST: usize = 64;

impl Tree {
    /// The bytes of a chunk.
    pub fn encode(&self) -> Vec<u8> {
        let (mut structure, mut integers) = (Writer::default(), Integers::new());
        self.put(&mut structure, &mut integers);
        let mut out = Writer::default();
        integers.encode(&mut out);
        out.bytes(&structure.0);
        out.0
    }

    fn put(&self, out: &mut Writer, integers: &mut Integers) {
        match self {
            Tree::Split { axis, halves } => {
                out.u8(*axis as u8);
                halves.iter().for_each(|half| half.put(out, integers));
            }
            Tree::Faces(faces) => {
                out.u8(PARTED);
                faces.iter().for_each(|face| face.put(out, integers));
            }
            Tree::Flagged => out.u8(FLAGGED),
            Tree::Leaf(tensor) => {
                out.u8(PATCH);
                tensor.encode(out, integers);
            }
        }
    }

    /// Reads what [`Tree::encode`] wrote.
    ///
    /// # Errors
    /// The bytes are not a chunk of tensors of this shape.
    pub fn decode(bytes: &[u8], shape: Shape) -> Result<Self, DecodeError> {
        Self::read(bytes, shape, Coded::decode)
    }

    /// The same with zeros for all numbers, which need not be decoded: what boxes there are.
    ///
    /// # Errors
    /// The bytes are not a chunk of tensors of this shape.
    pub fn outline(bytes: &[u8], shape: Shape) -> Result<Self, DecodeError> {
        Self::read(bytes, shape, Coded::zeros)
    }

    fn read(
        bytes: &[u8],
        shape: Shape,
        coded: fn(&mut Reader<'_>) -> Result<Coded, DecodeError>,
    ) -> Result<Self, DecodeError> {
        let mut input = Reader(bytes);
        let mut coded = coded(&mut input)?;
        let mut structure = Reader(input.bytes()?);
        input.finish()?;
        let tree = Self::take(&mut structure, &mut coded, shape, 0)?;
        structure.finish()?;
        coded.finish()?;
        Ok(tree)
    }

    fn take(
        input: &mut Reader<'_>,
        coded: &mut Coded,
        shape: Shape,
        depth: usize,
    ) -> Result<Self, DecodeError> {
        if depth > DEEPEST {
            return Err(DecodeError("depth of the tree"));
        }
        match input.u8()? {
            FLAGGED => Ok(Tree::Flagged),
            PATCH => {
                let tensor = Tensor::decode(input, coded, shape)?;
                Ok(Tree::Leaf(Arc::new(tensor)))
            }
            PARTED if shape.variables.sphere => {
                let shape = shape.of_a_face();
                let face = |_| Self::take(input, coded, shape, depth + 1);
                let faces: Result<Vec<Self>, DecodeError> = (0..FACES).map(face).collect();
                let faces = faces?.try_into();
                Ok(Tree::Faces(
                    faces.map_err(|_| DecodeError("number of faces"))?,
                ))
            }
            axis if shape.may_halve(usize::from(axis)) => {
                let low = Self::take(input, coded, shape, depth + 1)?;
                let high = Self::take(input, coded, shape, depth + 1)?;
                Ok(Tree::Split {
                    axis: usize::from(axis),
                    halves: Box::new([low, high]),
                })
            }
            _ => Err(DecodeError("kind of a box")),
        }
    }

    /// How many patches and flagged boxes there are.
    pub fn count(&self) -> (usize, usize) {
        match self {
            Tree::Leaf(_) => (1, 0),
            Tree::Flagged => (0, 1),
            Tree::Split { halves, .. } => counts(halves.as_slice()),
            Tree::Faces(faces) => counts(faces.as_slice()),
        }
    }
}

impl Shape {
    /// What the tensors of a single face must look like.
    fn of_a_face(mut self) -> Self {
        self.variables.sphere = false;
        self
    }

    /// Whether boxes can be halved along `axis`: the whole sphere has no halves.
    fn may_halve(&self, axis: usize) -> bool {
        let (cameras, arc) = (
            self.variables.cameras,
            self.variables.cameras + self.directions,
        );
        axis < cameras || axis == arc || (axis < arc && !self.variables.sphere)
    }
}

/// The patches and flagged boxes of all `parts`.
fn counts(parts: &[Tree]) -> (usize, usize) {
    let counts = parts.iter().map(Tree::count);
    counts.fold((0, 0), |(a, b), (c, d)| (a + c, b + d))
}

const FLAGGED: u8 = 255;
const PATCH: u8 = 254;
const PARTED: u8 = 253;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        chebyshev::MappedChebyshev, polynomial::Polynomial, train::Train, train_core::Step,
    };
    use ndarray::{ArrayD, IxDyn};

    fn shape(sphere: bool) -> Shape {
        Shape {
            variables: Variables {
                cameras: 1,
                stretch: MappedChebyshev::new(0.5),
                sphere,
            },
            directions: 2,
            channels: 3,
        }
    }

    fn leaf(sphere: bool) -> Tree {
        let polynomial = Polynomial {
            coefficients: ArrayD::from_elem(IxDyn(&[2, 3, 2, 4, 3]), 0.5),
            variables: shape(sphere).variables,
        };
        let tensor = Train::plain(&polynomial).rounded(Step::near(1e-3));
        Tree::Leaf(Arc::new(tensor.unwrap()))
    }

    #[test]
    fn a_sphere_may_be_parted_into_faces_once() {
        let faces = |inner: fn() -> Tree| Tree::Faces(Box::new([(); FACES].map(|()| inner())));
        let half = |axis: usize, sphere: bool| Tree::Split {
            axis,
            halves: Box::new([leaf(sphere), Tree::Flagged]),
        };
        for good in [
            leaf(true),
            faces(|| leaf(false)),
            half(0, true),
            half(3, true),
        ] {
            let back = Tree::decode(&good.encode(), shape(true)).unwrap();
            let outline = Tree::outline(&good.encode(), shape(true)).unwrap();
            assert_eq!(back.count(), good.count());
            assert_eq!(outline.count(), good.count());
            assert_eq!(back.encode(), good.encode());
        }
        let parted = Tree::decode(&faces(|| leaf(false)).encode(), shape(true)).unwrap();
        let Tree::Faces(faces_of_it) = parted else {
            panic!("{parted:?}")
        };
        let Tree::Leaf(tensor) = &faces_of_it[2] else {
            panic!("{:?}", faces_of_it[2])
        };
        assert!(!tensor.variables.sphere);
        // The sphere has no halves along directions, and a face no faces.
        assert!(Tree::decode(&half(1, true).encode(), shape(true)).is_err());
        assert!(Tree::decode(&half(1, false).encode(), shape(false)).is_ok());
        assert!(Tree::decode(&faces(|| leaf(false)).encode(), shape(false)).is_err());
        let twice = Tree::Faces(Box::new([(); FACES].map(|()| faces(|| leaf(false)))));
        assert!(Tree::decode(&twice.encode(), shape(true)).is_err());
    }
}
