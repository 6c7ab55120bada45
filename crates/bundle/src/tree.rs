//! The tree of boxes over one chunk of the table.
//!
//! A chunk covers one cell of camera parameters, one face of directions or all of them, and all arc lengths, all in
//! [−1, 1]. [`Tree`] parts the sphere of directions into faces and halves boxes along one axis at a time down to
//! patches, divides paths where they meet edges of the metric, and parts rays along separatrices. Axes are numbered
//! camera…, direction…, arc length.
//! In: boxes. Out: the bytes of a chunk, and back. The same tree holds what is left of its patches at a fixed camera
//! ([`crate::Fan`]).

use crate::{
    decode::{DecodeBudget, DecodeError},
    polynomial::Variables,
    rays::FACES,
    sections::{ChunkReader, ChunkWriter, CodedTree},
    tensor::{StoredTensor, Tensor},
};
use geofan_core::parallel::*;
use std::sync::Arc;

/// A box of the table, divided or not; `P` is a patch, `S` a section of a chunk.
#[derive(Debug, Clone)]
pub enum Tree<P = Arc<Tensor>, S = Arc<CodedTree>> {
    /// Halved at the middle of `axis`.
    Split {
        /// The axis.
        axis: usize,
        /// The lower and the upper half.
        halves: Box<[Self; 2]>,
    },
    /// All directions parted into their faces.
    Faces(Box<[Self; FACES]>),
    /// Divided where its paths meet an edge, at an arc length that differs from path to path.
    Edge {
        /// A patch with one number for each path: that arc length.
        place: P,
        /// The parts of the paths before the edge and behind it.
        parts: Box<[Self; 2]>,
    },
    /// Parted along a separatrix: a surface among the rays on whose two sides paths have different fates.
    Separatrix {
        /// A patch with one number for each ray, which does not depend on the separatrix's axis: where it is along that,
        /// also beyond the box.
        place: P,
        /// The axis, and how far the boxes of both sides reach along it.
        reach: SideReach,
        /// The lower and the upper side.
        sides: Box<[Self; 2]>,
    },
    /// A patch: one polynomial for all its paths.
    Leaf(P),
    /// Given up: rays here are integrated exactly.
    Flagged,
    /// A section of the chunk, which is coded apart.
    Section(S),
}

/// How far the boxes on both sides of a separatrix reach from it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SideReach {
    /// The direction axis along which the separatrix is somewhere.
    pub axis: usize,
    /// The lengths of the lower and the upper side along it, in units of 1/32: the box that is divided is 64 long.
    units: [u8; 2],
}

/// The axes that the tensors of a chunk must have.
#[derive(Debug, Clone, Copy)]
pub struct TensorShape {
    /// The variables of cameras and directions.
    pub variables: Variables,
    /// Direction axes.
    pub directions: usize,
    /// Stored channels.
    pub channels: usize,
}

/// Deepest tree accepted from a file; bakes stop far earlier.
const DEEPEST: usize = 64;

/// Bytes that stand for boxes without halves; those with halves are told by their axis.
const FLAGGED: u8 = 255;
const PATCH: u8 = 254;
const OF_FACES: u8 = 253;
const EDGE: u8 = 252;
const SEPARATRIX: u8 = 251;
const SECTION: u8 = 250;

/// The least distance of an edge from both ends of a piece, as a share of it: neither part is empty.
const BESIDE_EDGE: f64 = 1e-9;

/// Finds the half of [−1, 1] that holds `x`, and the coordinate there, in [−1, 1] again.
pub(crate) fn half(x: f64) -> (usize, f64) {
    if x < 0.0 {
        (0, 2.0 * x + 1.0)
    } else {
        (1, 2.0 * x - 1.0)
    }
}

/// Finds the half of a box along `axis` that holds the parameters `x` of its first axes, and the parameters there.
pub(crate) fn halved(x: &[f64], axis: usize) -> (usize, Vec<f64>) {
    let mut inner = x.to_vec();
    let side;
    (side, inner[axis]) = half(x[axis]);
    (side, inner)
}

/// Units of the numbers of [`SideReach`] in the length 1.
const REACH_UNITS: f64 = 32.0;

impl SideReach {
    /// Takes the least that covers the box [−1, 1] where the place along `axis` is between `least` and `most`; none if that
    /// is too far.
    pub fn covering(axis: usize, [least, most]: [f64; 2]) -> Option<Self> {
        let units = |reach: f64| {
            let units = (REACH_UNITS * reach).ceil().max(1.0);
            (units <= f64::from(u8::MAX)).then_some(units as u8)
        };
        Some(Self {
            axis,
            units: [units(1.0 + most)?, units(1.0 - least)?],
        })
    }

    /// Returns the lengths of both sides.
    pub fn lengths(self) -> [f64; 2] {
        self.units.map(|units| f64::from(units) / REACH_UNITS)
    }

    /// Finds the side of the separatrix at `place` that holds the ray with the parameters `x`, and puts its coordinate
    /// there, in [−1, 1] again, in the place of that along the axis.
    pub(crate) fn enter(self, x: &mut [f64], place: f64) -> usize {
        let along = &mut x[self.axis];
        let side = usize::from(*along >= place);
        *along = self.inner((side, *along), place).clamp(-1.0, 1.0);
        side
    }

    /// Returns it where the axes of so many `cameras` are left out.
    pub(crate) fn without(self, cameras: usize) -> Self {
        Self {
            axis: self.axis - cameras,
            ..self
        }
    }

    /// Returns the coordinate on a `side` of the separatrix at `place`, in [−1, 1] of its box.
    pub fn inner(self, (side, x): (usize, f64), place: f64) -> f64 {
        let [low, high] = self.lengths();
        match side {
            0 => 1.0 + 2.0 * (x - place) / low,
            _ => 2.0 * (x - place) / high - 1.0,
        }
    }

    /// Returns the `x` of a coordinate on a `side` of the separatrix at `place`.
    pub fn outer(self, (side, inner): (usize, f64), place: f64) -> f64 {
        let [low, high] = self.lengths();
        match side {
            0 => place + 0.5 * (inner - 1.0) * low,
            _ => place + 0.5 * (inner + 1.0) * high,
        }
    }
}

/// Divides the arc lengths of a path into those before an edge at `place` and those behind it.
pub fn divided_at_edge([start, end]: [f64; 2], place: f64) -> [[f64; 2]; 2] {
    let least = BESIDE_EDGE * (end - start);
    let place = place.max(start + least).min(end - least);
    [[start, place], [place, end]]
}

impl<P, S> Tree<P, S> {
    /// Returns the boxes into which this one is divided.
    pub fn parts(&self) -> &[Self] {
        match self {
            Tree::Split { halves, .. } => halves.as_slice(),
            Tree::Faces(faces) => faces.as_slice(),
            Tree::Edge { parts, .. } => parts.as_slice(),
            Tree::Separatrix { sides, .. } => sides.as_slice(),
            Tree::Leaf(_) | Tree::Flagged | Tree::Section(_) => &[],
        }
    }

    /// Lists the sections, in order.
    pub(crate) fn sections(&self) -> Vec<&S> {
        let mut found = Vec::new();
        self.add_sections(&mut found);
        found
    }

    fn add_sections<'t>(&'t self, found: &mut Vec<&'t S>) {
        match self {
            Tree::Section(section) => found.push(section),
            _ => self
                .parts()
                .iter()
                .for_each(|part| part.add_sections(found)),
        }
    }

    /// Makes another patch of each, and another tree of each section.
    ///
    /// # Errors
    /// The first that `map` or `section` meets.
    pub(crate) fn mapped<Q, E>(
        self,
        map: &impl Fn(P) -> Result<Q, E>,
        section: &impl Fn(S) -> Result<Tree<Q, S>, E>,
    ) -> Result<Tree<Q, S>, E> {
        Ok(match self {
            Tree::Flagged => Tree::Flagged,
            Tree::Section(coded) => section(coded)?,
            Tree::Leaf(patch) => Tree::Leaf(map(patch)?),
            Tree::Split { axis, halves } => Tree::Split {
                axis,
                halves: all_mapped(*halves, map, section)?,
            },
            Tree::Faces(faces) => Tree::Faces(all_mapped(*faces, map, section)?),
            Tree::Edge { place, parts } => Tree::Edge {
                place: map(place)?,
                parts: all_mapped(*parts, map, section)?,
            },
            Tree::Separatrix {
                place,
                reach,
                sides,
            } => Tree::Separatrix {
                place: map(place)?,
                reach,
                sides: all_mapped(*sides, map, section)?,
            },
        })
    }
}

/// Makes other patches of all `parts`, and other trees of their sections.
fn all_mapped<P, Q, S, E, const N: usize>(
    parts: [Tree<P, S>; N],
    map: &impl Fn(P) -> Result<Q, E>,
    section: &impl Fn(S) -> Result<Tree<Q, S>, E>,
) -> Result<Box<[Tree<Q, S>; N]>, E> {
    let mut all = [const { Tree::Flagged }; N];
    for (to, part) in all.iter_mut().zip(parts) {
        *to = part.mapped(map, section)?;
    }
    Ok(Box::new(all))
}

impl Tree {
    /// Counts patches and flagged boxes; none of sections that are damaged.
    pub fn count(&self) -> (usize, usize) {
        match self {
            Tree::Leaf(_) => (1, 0),
            Tree::Flagged => (0, 1),
            Tree::Section(section) => section.tree().map_or((0, 0), Tree::count),
            _ => {
                let counts = self.parts().iter().map(Self::count);
                counts.fold((0, 0), |(a, b), (c, d)| (a + c, b + d))
            }
        }
    }

    /// Adds the tree to a chunk.
    pub(crate) fn put(&self, chunk: &mut ChunkWriter) {
        if chunk.sets_apart(self) {
            chunk.structure.push(SECTION);
            return chunk.put_section(self.encode_section());
        }
        match self {
            Tree::Split { axis, .. } => chunk.structure.push(*axis as u8),
            Tree::Faces(_) => chunk.structure.push(OF_FACES),
            Tree::Edge { place, .. } => {
                chunk.structure.push(EDGE);
                place.encode(&mut chunk.structure, &mut chunk.integers);
            }
            Tree::Separatrix { place, reach, .. } => {
                chunk.structure.extend([SEPARATRIX, reach.axis as u8]);
                chunk.structure.extend(reach.units);
                place.encode(&mut chunk.structure, &mut chunk.integers);
            }
            Tree::Flagged => chunk.structure.push(FLAGGED),
            Tree::Leaf(tensor) => {
                chunk.structure.push(PATCH);
                tensor.encode(&mut chunk.structure, &mut chunk.integers);
            }
            Tree::Section(section) => {
                chunk.structure.push(SECTION);
                chunk.put_section(section.bytes().to_vec());
            }
        }
        self.parts().iter().for_each(|part| part.put(chunk));
    }
}

impl Tree<StoredTensor> {
    /// Reads what [`Tree::put`] wrote.
    ///
    /// # Errors
    /// It is not a tree of tensors of this shape, or asks for more than is left of the budget.
    pub(crate) fn take<'s>(
        chunk: &mut ChunkReader<'_>,
        (shape, restoring): (TensorShape, (&TaskScope<'s>, &'s DecodeBudget)),
        depth: usize,
    ) -> Result<Self, DecodeError> {
        if depth > DEEPEST {
            return Err(DecodeError("depth of the tree"));
        }
        match chunk.structure.u8()? {
            FLAGGED => Ok(Tree::Flagged),
            SECTION => Ok(Tree::Section(chunk.section(shape)?)),
            PATCH => {
                let tensor = chunk.tensor(shape, restoring)?;
                Ok(Tree::Leaf(tensor))
            }
            // The sphere may be parted into faces once.
            OF_FACES if shape.variables.sphere => {
                let shape = shape.of_a_face();
                let face = |_| Self::take(chunk, (shape, restoring), depth + 1);
                let faces: Result<Vec<Self>, DecodeError> = (0..FACES).map(face).collect();
                let faces = faces?.try_into();
                Ok(Tree::Faces(
                    faces.map_err(|_| DecodeError("number of faces"))?,
                ))
            }
            // Where paths meet edges the directions of each face are apart.
            EDGE if !shape.variables.sphere => {
                let place = Self::take_place(chunk, (shape, restoring))?;
                let before = Self::take(chunk, (shape, restoring), depth + 1)?;
                let behind = Self::take(chunk, (shape, restoring), depth + 1)?;
                Ok(Tree::Edge {
                    place,
                    parts: Box::new([before, behind]),
                })
            }
            SEPARATRIX if !shape.variables.sphere => {
                let axis = usize::from(chunk.structure.u8()?);
                if !(shape.variables.cameras..shape.arc()).contains(&axis) {
                    return Err(DecodeError("axis of a separatrix"));
                }
                let units = [chunk.structure.u8()?, chunk.structure.u8()?];
                if units.contains(&0) {
                    return Err(DecodeError("reach of a separatrix"));
                }
                let place = Self::take_place(chunk, (shape, restoring))?;
                let low = Self::take(chunk, (shape, restoring), depth + 1)?;
                let high = Self::take(chunk, (shape, restoring), depth + 1)?;
                Ok(Tree::Separatrix {
                    place,
                    reach: SideReach { axis, units },
                    sides: Box::new([low, high]),
                })
            }
            axis if shape.may_halve(usize::from(axis)) => {
                let low = Self::take(chunk, (shape, restoring), depth + 1)?;
                let high = Self::take(chunk, (shape, restoring), depth + 1)?;
                Ok(Tree::Split {
                    axis: usize::from(axis),
                    halves: Box::new([low, high]),
                })
            }
            _ => Err(DecodeError("kind of a box")),
        }
    }

    /// Reads the tensor that tells where an edge or a separatrix is: one number for each ray.
    fn take_place<'s>(
        chunk: &mut ChunkReader<'_>,
        (shape, restoring): (TensorShape, (&TaskScope<'s>, &'s DecodeBudget)),
    ) -> Result<StoredTensor, DecodeError> {
        let place = chunk.tensor(shape.of_a_place(), restoring)?;
        match place.lengths() {
            1 => Ok(place),
            _ => Err(DecodeError("place of an edge or a separatrix")),
        }
    }
}

impl TensorShape {
    /// Returns the shape of the tensors of a single face.
    fn of_a_face(mut self) -> Self {
        self.variables.sphere = false;
        self
    }

    /// Returns the shape of the tensors that tell where an edge or a separatrix is.
    fn of_a_place(mut self) -> Self {
        self.channels = 1;
        self
    }

    /// Returns the index of the arc length among the axes.
    fn arc(&self) -> usize {
        self.variables.cameras + self.directions
    }

    /// Tells whether boxes can be halved along `axis`: the whole sphere has no halves.
    fn may_halve(&self, axis: usize) -> bool {
        let (cameras, arc) = (self.variables.cameras, self.arc());
        axis < cameras || axis == arc || (axis < arc && !self.variables.sphere)
    }
}

#[cfg(test)]
#[path = "hostile_tests.rs"]
pub(crate) mod hostile_tests;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        chebyshev::MappedChebyshev, polynomial::Polynomial, train::Train, train_core::StepSize,
    };
    use ndarray::{ArrayD, IxDyn};

    fn shape(sphere: bool) -> TensorShape {
        TensorShape {
            variables: Variables {
                cameras: 1,
                mapping: MappedChebyshev::new(0.5),
                sphere,
            },
            directions: 2,
            channels: 3,
        }
    }

    fn budget() -> Arc<DecodeBudget> {
        Arc::new(DecodeBudget::for_bytes(0))
    }

    fn leaf(sphere: bool) -> Tree {
        let polynomial = Polynomial {
            coefficients: ArrayD::from_elem(IxDyn(&[2, 3, 2, 4, 3]), 0.5),
            variables: shape(sphere).variables,
        };
        let tensor = Train::plain(&polynomial).rounded(StepSize::near(1e-3));
        Tree::Leaf(Arc::new(tensor.unwrap()))
    }

    #[test]
    fn both_sides_of_a_separatrix_cover_the_box() {
        let reach = SideReach::covering(1, [-1.3, 0.6]).unwrap();
        assert_eq!(reach.lengths(), [1.625, 2.3125]);
        for (x, place) in [
            (-1.0, 0.6),
            (0.59, 0.6),
            (0.6, 0.6),
            (-1.0, -1.3),
            (1.0, -1.3),
        ] {
            let mut ray = [7.0, x];
            let side = reach.enter(&mut ray, place);
            assert_eq!((side, ray[0]), (usize::from(x >= place), 7.0));
            assert!((-1.0..=1.0).contains(&ray[1]), "{ray:?}");
            assert!((reach.outer((side, ray[1]), place) - x).abs() < 1e-15);
        }
        assert_eq!(SideReach::covering(1, [-8.0, 0.0]), None);
    }

    #[test]
    fn separatrices_are_along_directions_and_have_boxes_beside_them() {
        let polynomial = Polynomial {
            coefficients: ArrayD::from_elem(IxDyn(&[2, 3, 1, 1, 1]), 0.5),
            variables: shape(false).variables,
        };
        let place = Train::plain(&polynomial).rounded(StepSize::near(1e-3));
        let place = Arc::new(place.unwrap());
        let parted = |axis: usize, units: [u8; 2]| Tree::Separatrix {
            place: place.clone(),
            reach: SideReach { axis, units },
            sides: Box::new([leaf(false), Tree::Flagged]),
        };
        let read = |tree: &Tree, sphere| Tree::decode(&tree.encode(), shape(sphere), &budget());
        let good = parted(2, [40, 255]);
        let back = read(&good, false).unwrap();
        assert_eq!((back.count(), back.encode()), ((1, 1), good.encode()));
        for (bad, sphere) in [
            (parted(0, [40, 255]), false),
            (parted(3, [40, 255]), false),
            (parted(2, [0, 255]), false),
            (parted(2, [40, 255]), true),
        ] {
            assert!(read(&bad, sphere).is_err());
        }
    }

    #[test]
    fn a_sphere_may_be_parted_into_faces_once_and_edges_divide_faces_alone() {
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
            let back = Tree::decode(&good.encode(), shape(true), &budget()).unwrap();
            let outline = Tree::outline(&good.encode(), shape(true), &budget()).unwrap();
            assert_eq!(back.count(), good.count());
            assert_eq!(outline.count(), good.count());
            assert_eq!(back.encode(), good.encode());
        }
        let parted = Tree::decode(&faces(|| leaf(false)).encode(), shape(true), &budget()).unwrap();
        let Tree::Faces(faces_of_it) = parted else {
            panic!("{parted:?}")
        };
        let Tree::Leaf(tensor) = &faces_of_it[2] else {
            panic!("{:?}", faces_of_it[2])
        };
        assert!(!tensor.variables.sphere);
        // An edge divides where directions are those of a face; its place is one number for each path.
        let place = |lengths: usize| {
            let polynomial = Polynomial {
                coefficients: ArrayD::from_elem(IxDyn(&[2, 3, 2, lengths, 1]), 0.5),
                variables: shape(false).variables,
            };
            let place = Train::plain(&polynomial).rounded(StepSize::near(1e-3));
            Tree::Edge {
                place: Arc::new(place.unwrap()),
                parts: Box::new([leaf(false), Tree::Flagged]),
            }
        };
        let back = Tree::decode(&place(1).encode(), shape(false), &budget()).unwrap();
        assert_eq!((back.count(), back.encode()), ((1, 1), place(1).encode()));
        assert!(Tree::decode(&place(2).encode(), shape(false), &budget()).is_err());
        assert!(Tree::decode(&place(1).encode(), shape(true), &budget()).is_err());
        // The sphere has no halves along directions, and a face no faces.
        assert!(Tree::decode(&half(1, true).encode(), shape(true), &budget()).is_err());
        assert!(Tree::decode(&half(1, false).encode(), shape(false), &budget()).is_ok());
        assert!(Tree::decode(&faces(|| leaf(false)).encode(), shape(false), &budget()).is_err());
        let twice = Tree::Faces(Box::new([(); FACES].map(|()| faces(|| leaf(false)))));
        assert!(Tree::decode(&twice.encode(), shape(true), &budget()).is_err());
    }
}
