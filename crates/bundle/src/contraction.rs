//! The trees of a table at one camera position.
//!
//! In: the tree of a chunk and the parameters of a camera in it, in [−1, 1]. Out: the same tree over directions and arc
//! lengths alone, its patches contracted ([`Contracted`]). Sections of the chunk are decoded and contracted when a path first
//! needs them: a picture sees few of the directions that a camera has.

use crate::{
    contracted::Contracted,
    rays::FACES,
    sections::{CodedTree, filled},
    tree::{Tree, halved},
};
use geofan_core::parallel::*;
use std::sync::{Arc, OnceLock};

/// A chunk at one camera: only direction (axes 0, 1) and arc length (axis 2) are left.
pub(crate) type ContractedTree = Tree<Contracted, Box<ContractedSection>>;

/// A section at one camera.
#[derive(Debug, Clone)]
pub(crate) struct ContractedSection {
    section: Arc<CodedTree>,
    camera: Vec<f64>,
    tree: OnceLock<ContractedTree>,
}

impl ContractedSection {
    /// Tells whether it is the section `coded`.
    pub fn is_of(&self, coded: &Arc<CodedTree>) -> bool {
        Arc::ptr_eq(&self.section, coded)
    }

    /// Returns the tree, decoded and contracted if no path has needed it yet; one that is damaged is given up, as where
    /// rays are flagged.
    pub fn tree(&self) -> &ContractedTree {
        filled(&self.tree, || match self.section.tree() {
            Ok(tree) => contract(tree, &self.camera),
            Err(_) => Tree::Flagged,
        })
    }
}

/// Contracts `tree` at these camera parameters in [−1, 1]; the patches of a camera at once.
pub(crate) fn contract(tree: &Tree, camera: &[f64]) -> ContractedTree {
    match tree {
        Tree::Flagged => Tree::Flagged,
        Tree::Leaf(tensor) => Tree::Leaf(tensor.contract(camera)),
        Tree::Section(section) => Tree::Section(Box::new(ContractedSection {
            section: section.clone(),
            camera: camera.to_vec(),
            tree: OnceLock::new(),
        })),
        // Of a box halved along a camera axis one half holds the camera.
        Tree::Split { axis, halves } if *axis < camera.len() => {
            let (side, camera) = halved(camera, *axis);
            contract(&halves[side], &camera)
        }
        Tree::Faces(faces) => {
            let mut contracted = [const { Tree::Flagged }; FACES];
            let pairs = contracted.par_iter_mut().zip(&**faces);
            pairs.for_each(|(to, face)| *to = contract(face, camera));
            Tree::Faces(Box::new(contracted))
        }
        Tree::Edge { place, parts } => Tree::Edge {
            place: place.contract(camera),
            parts: both(parts, camera),
        },
        Tree::Separatrix {
            place,
            reach,
            sides,
        } => Tree::Separatrix {
            place: place.contract(camera),
            reach: reach.without(camera.len()),
            sides: both(sides, camera),
        },
        // Both halves of others stay.
        Tree::Split { axis, halves } => Tree::Split {
            axis: axis - camera.len(),
            halves: both(halves, camera),
        },
    }
}

/// Contracts two trees at once.
fn both(trees: &[Tree; 2], camera: &[f64]) -> Box<[ContractedTree; 2]> {
    let [first, second] = trees.each_ref();
    Box::new(join(|| contract(first, camera), || contract(second, camera)).into())
}
