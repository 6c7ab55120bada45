//! All paths from one camera position.
//!
//! In: the chunks of a table around a camera. Out: a [`Fan`]: the chunks contracted to polynomials in
//! direction and arc length, and from it single [`TablePath`]s. The contraction takes about a
//! millisecond, a path about a microsecond; turning the head needs no new fan.

use crate::{
    contracted::Contracted,
    path_coefficients::{Evaluate, PathCoefficients},
    rays::{FACES, Image, Located, Place, RaySpace},
    table::Table,
    table_path::TablePath,
    tree::{Tree, half},
};
use geofan_core::parallel::*;
use glam::DVec3;
use std::sync::Arc;

/// A chunk at one camera: only direction (axes 0, 1) and arc length (axis 2) are left.
pub(crate) type ContractedTree = Tree<Contracted>;

/// Contracts `tree` at these camera parameters in [−1, 1]; the patches of a camera at once.
pub(crate) fn contract(tree: &Tree, camera: &[f64]) -> ContractedTree {
    match tree {
        Tree::Flagged => Tree::Flagged,
        Tree::Leaf(tensor) => Tree::Leaf(tensor.contract(camera)),
        // Of a box halved along a camera axis one half holds the camera.
        Tree::Split { axis, halves } if *axis < camera.len() => {
            let mut camera = camera.to_vec();
            let (side, inner) = half(camera[*axis]);
            camera[*axis] = inner;
            contract(&halves[side], &camera)
        }
        Tree::Faces(faces) => {
            let mut contracted = [const { Tree::Flagged }; FACES];
            let pairs = contracted.par_iter_mut().zip(&**faces);
            pairs.for_each(|(to, face)| *to = contract(face, camera));
            Tree::Faces(Box::new(contracted))
        }
        Tree::Edge { place, parts } => {
            let [before, behind] = parts.each_ref();
            let part = |part| move || contract(part, camera);
            Tree::Edge {
                place: place.contract(camera),
                parts: Box::new(join(part(before), part(behind)).into()),
            }
        }
        // Both halves of others stay.
        Tree::Split { axis, halves } => {
            let [low, high] = halves.each_ref();
            let half = |half| move || contract(half, camera);
            Tree::Split {
                axis: axis - camera.len(),
                halves: Box::new(join(half(low), half(high)).into()),
            }
        }
    }
}

/// All paths from one camera position. It shares its table, so that it can be kept and given to
/// other threads.
#[derive(Debug, Clone)]
pub struct Fan {
    pub(crate) table: Table,
    /// The camera position.
    pub place: Place,
    faces: Vec<FaceFan>,
}

/// The paths in the directions of one face: the chunk that stores them, and the mirror that carries
/// them there.
#[derive(Debug, Clone)]
pub(crate) struct FaceFan {
    pub tree: Arc<ContractedTree>,
    pub image: Option<Image>,
}

impl Fan {
    /// Puts together the paths from `place`, where the chunks of its cell are contracted to `faces`.
    pub(crate) fn new(table: Table, place: Place, faces: Vec<FaceFan>) -> Self {
        Self {
            table,
            place,
            faces,
        }
    }

    /// Looks up the path in the direction `d` (standard frame, unit).
    pub fn path(&self, d: DVec3) -> TablePath<'_> {
        let mut coefficients = PathCoefficients::default();
        let number = self.follow(self.locate(d), &mut coefficients, Contracted::direction);
        TablePath::new(self, coefficients, number)
    }

    /// Appends the path of a located ray, one of many close together, and returns its number there. It is
    /// that of [`Fan::path`] but for what local expansions leave out (see [`Contracted::nearby`]).
    pub fn add(&self, located: Located, coefficients: &mut PathCoefficients) -> usize {
        self.follow(located, coefficients, Contracted::nearby)
    }

    /// Returns the path that [`Fan::add`] gave a number.
    pub fn among<'f>(
        &'f self,
        coefficients: &'f PathCoefficients,
        number: usize,
    ) -> TablePath<'f, &'f PathCoefficients> {
        TablePath::new(self, coefficients, number)
    }

    /// Returns the rays that the table knows.
    pub fn space(&self) -> &RaySpace {
        &self.table.space
    }

    /// Expresses the ray in the direction `d` in stored parameters.
    pub fn locate(&self, d: DVec3) -> Located {
        self.table.space.locate(&self.place, d)
    }

    /// Looks up the path at direction parameters of a face as it is stored, carried by no isometry.
    pub fn stored_path(&self, face: usize, direction: [f64; 2]) -> TablePath<'_> {
        let mut coefficients = PathCoefficients::default();
        let located = self.table.space.stored_ray(&self.place, face, direction);
        let number = self.follow(located, &mut coefficients, Contracted::direction);
        TablePath::new(self, coefficients, number)
    }

    fn follow(
        &self,
        located: Located,
        coefficients: &mut PathCoefficients,
        evaluate: Evaluate,
    ) -> usize {
        let face = &self.faces[located.face];
        let located = located.carried(face.image.as_ref());
        coefficients.add(&self.table, &face.tree, located, evaluate)
    }
}
