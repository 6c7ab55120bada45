//! What is left of the table when the camera is fixed.
//!
//! In: the chunks of a table around one camera position. Out: a [`Fan`], all paths from there, and
//! from it single [`TablePath`]s.

use crate::parallel::*;
use crate::{
    contracted::Contracted,
    path_coefficients::{Evaluate, PathCoefficients, TablePath},
    rays::{FACES, Image, Located, Place, RaySpace},
    table::Table,
    tree::Tree,
};
use glam::DVec3;
use std::sync::Arc;

/// A tree at one camera: only direction (axes 0, 1) and arc length (axis 2) are left.
#[derive(Debug, Clone)]
pub(super) enum FanNode {
    Split {
        axis: usize,
        halves: Box<[FanNode; 2]>,
    },
    /// The whole sphere of directions parted into its faces.
    Faces(Box<[FanNode; FACES]>),
    Leaf(Contracted),
    Flagged,
}

/// The local coordinate in the half that holds `x`, and which half it is.
pub fn half(x: f64) -> (usize, f64) {
    if x < 0.0 {
        (0, 2.0 * x + 1.0)
    } else {
        (1, 2.0 * x - 1.0)
    }
}

impl FanNode {
    /// Of `tree` at these camera parameters in [−1, 1]; the patches of a camera at once.
    pub(super) fn contract(tree: &Tree, camera: &[f64]) -> Self {
        match tree {
            Tree::Flagged => Self::Flagged,
            Tree::Leaf(tensor) => Self::Leaf(tensor.contract(camera)),
            Tree::Split { axis, halves } if *axis < camera.len() => {
                let mut camera = camera.to_vec();
                let (side, inner) = half(camera[*axis]);
                camera[*axis] = inner;
                Self::contract(&halves[side], &camera)
            }
            Tree::Faces(faces) => {
                let mut nodes = [const { Self::Flagged }; FACES];
                let pairs = nodes.par_iter_mut().zip(&**faces);
                pairs.for_each(|(node, face)| *node = Self::contract(face, camera));
                Self::Faces(Box::new(nodes))
            }
            Tree::Split { axis, halves } => {
                let [low, high] = halves.each_ref();
                let half = |half| move || Self::contract(half, camera);
                Self::Split {
                    axis: axis - camera.len(),
                    halves: Box::new(crate::parallel::join(half(low), half(high)).into()),
                }
            }
        }
    }
}

/// All paths from one camera position.
#[derive(Debug, Clone)]
pub struct Fan<'t> {
    pub(super) table: &'t Table,
    /// The camera position.
    pub place: Place,
    faces: Vec<Facet>,
}

/// The directions of one face: where they are stored, and the mirror that carries them there.
#[derive(Debug, Clone)]
pub(super) struct Facet {
    pub(super) node: Arc<FanNode>,
    pub(super) image: Option<Image>,
}

impl<'t> Fan<'t> {
    /// The paths from `place`, where the chunks of its cell are contracted to `faces`.
    pub(super) fn new(table: &'t Table, place: Place, faces: Vec<Facet>) -> Self {
        Self {
            table,
            place,
            faces,
        }
    }

    /// The path in the direction `d` (standard frame, unit).
    pub fn path(&self, d: DVec3) -> TablePath<'_, 't> {
        let mut courses = PathCoefficients::default();
        let number = self.follow(self.locate(d), &mut courses, Contracted::direction);
        TablePath::new(self, courses, number)
    }

    /// Appends the path of a located ray, one of many close together, to `courses`; its number there.
    /// It is that of [`Fan::path`] but for what cells of patches leave out (see
    /// [`Contracted::nearby`]).
    pub fn add(&self, located: Located, courses: &mut PathCoefficients) -> usize {
        self.follow(located, courses, Contracted::nearby)
    }

    /// The path that [`Fan::add`] gave a number.
    pub fn among<'c>(
        &self,
        courses: &'c PathCoefficients,
        number: usize,
    ) -> TablePath<'_, 't, &'c PathCoefficients> {
        TablePath::new(self, courses, number)
    }

    /// The rays that the table knows.
    pub fn space(&self) -> &RaySpace {
        &self.table.space
    }

    /// The ray in the direction `d` in stored parameters.
    pub fn locate(&self, d: DVec3) -> Located {
        self.table.space.locate(&self.place, d)
    }

    /// The path at direction parameters of a face as it is stored: what no isometry has carried.
    pub fn stored_path(&self, face: usize, direction: [f64; 2]) -> TablePath<'_, 't> {
        let mut courses = PathCoefficients::default();
        let located = self.table.space.stored_ray(&self.place, face, direction);
        let number = self.follow(located, &mut courses, Contracted::direction);
        TablePath::new(self, courses, number)
    }

    fn follow(
        &self,
        located: Located,
        courses: &mut PathCoefficients,
        evaluate: Evaluate,
    ) -> usize {
        let facet = &self.faces[located.face];
        let located = located.carried(facet.image.as_ref());
        courses.add(self.table, &facet.node, located, evaluate)
    }
}
