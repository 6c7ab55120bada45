//! The table in memory, and what is left of it when the camera is fixed.
//!
//! In: chunks of the table ([`Tree`]s) over the rays of a [`RaySpace`]. Out: [`Fan`]s: all paths
//! from one camera position, and from those single [`TablePath`]s: position, tangent and transported
//! rotation at any arc length. Interpolation *is* the contraction of the camera axes, so a camera
//! anywhere in the region costs the same.

use super::{
    bytes::DecodeError,
    division::Division,
    fan::{Facet, Fan, FanNode},
    stretch::MappedChebyshev,
    tree::{Shape, Tree},
    variables::Variables,
};
use crate::parallel::*;
use crate::rays::{Image, Place, RaySpace, cell};
use geofan_core::error::Result;
use glam::DVec3;
use std::sync::{Arc, OnceLock};

/// A chunk, decoded when it is first used: a table of megabytes opens in milliseconds, and a camera
/// needs the chunks of one cell only.
#[derive(Debug, Clone)]
pub struct Chunk {
    bytes: Vec<u8>,
    shape: Shape,
    tree: OnceLock<Result<Tree, DecodeError>>,
    /// The chunk contracted, where a symmetry takes every camera to the same one.
    fixed: OnceLock<Arc<FanNode>>,
}

impl Chunk {
    /// From what [`Tree::encode`] wrote.
    pub fn new(bytes: Vec<u8>, shape: Shape) -> Self {
        Self {
            bytes,
            shape,
            tree: OnceLock::new(),
            fixed: OnceLock::new(),
        }
    }

    /// The coded chunk.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// The tree.
    ///
    /// # Errors
    /// The bytes are not a tree.
    pub fn tree(&self) -> Result<&Tree, DecodeError> {
        let tree = filled(&self.tree, || Tree::decode(&self.bytes, self.shape));
        tree.as_ref().map_err(|e| *e)
    }

    /// What is left at the parameters `camera` (in [−1, 1]).
    ///
    /// # Errors
    /// The bytes are not a tree.
    fn contract(&self, camera: &[f64]) -> Result<Arc<FanNode>, DecodeError> {
        let tree = self.tree()?;
        let contract = || Arc::new(FanNode::contract(tree, camera));
        Ok(match camera.is_empty() {
            true => filled(&self.fixed, contract).clone(),
            false => contract(),
        })
    }
}

/// What is in `place`, made first if nothing is. Not within `get_or_init`: what is made waits for other
/// threads, and a thread that waits may take up work that needs the same place.
fn filled<T>(place: &OnceLock<T>, make: impl FnOnce() -> T) -> &T {
    match place.get() {
        Some(made) => made,
        None => {
            let made = make();
            place.get_or_init(|| made)
        }
    }
}

/// DecodeError that a user is told of.
pub fn in_bundle(damage: DecodeError) -> geofan_core::Error {
    geofan_core::Error::input("bundle", damage.to_string())
}

/// A baked table.
#[derive(Debug, Clone)]
pub struct Table {
    /// The rays it covers.
    pub space: RaySpace,
    /// How it is divided.
    pub division: Division,
    /// How far paths go.
    pub length: f64,
    /// Whether tangents keep the promise too, and with them transported frames.
    pub frames: bool,
    /// The chunks, in order.
    pub chunks: Vec<Chunk>,
}

impl Table {
    /// What the tensors of a table over `space` look like.
    pub fn shape(space: &RaySpace, stretch: MappedChebyshev) -> Shape {
        Shape {
            variables: Variables {
                cameras: space.cameras().len(),
                stretch,
                sphere: space.sphere().is_some(),
            },
            directions: space.directions(),
            channels: space.channels().len(),
        }
    }

    /// Decodes all chunks: where many cameras are wanted at once, each chunk is then decoded once.
    ///
    /// # Errors
    /// A chunk is damaged.
    pub fn decode(&self) -> Result<()> {
        let chunks = self.chunks.par_iter();
        let decoded = chunks.try_for_each(|chunk| chunk.tree().map(|_| ()));
        decoded.map_err(in_bundle)
    }

    /// How many patches and flagged boxes there are.
    ///
    /// # Errors
    /// A chunk is damaged.
    pub fn counts(&self) -> Result<(usize, usize), DecodeError> {
        let mut sum = (0, 0);
        for chunk in &self.chunks {
            let (patches, flagged) = chunk.tree()?.count();
            sum = (sum.0 + patches, sum.1 + flagged);
        }
        Ok(sum)
    }

    /// All paths from the camera position `u`.
    ///
    /// # Errors
    /// `u` is not in the camera region, or the patches there are damaged.
    pub fn fan(&self, u: DVec3) -> Result<Fan<'_>> {
        let place = self.space.place(u)?;
        let faces = self.facets(&place);
        let faces = faces.map_err(in_bundle)?;
        Ok(Fan::new(self, place, faces))
    }

    /// The directions of each face from `place`. A chunk that no camera has needed before is decoded now,
    /// which takes far longer than the contraction.
    fn facets(&self, place: &Place) -> Result<Vec<Facet>, DecodeError> {
        let kept = (0..self.space.faces()).map(|face| self.kept(place, face));
        let contract = |kept: &Kept| self.chunks[kept.chunk].contract(&kept.camera);
        let kept: Vec<Kept> = kept.collect();
        let nodes: Vec<Arc<FanNode>> = match self.space.sphere() {
            // All faces are in one chunk.
            Some(_) => vec![contract(&kept[0])?; kept.len()],
            None => kept.par_iter().map(contract).collect::<Result<_, _>>()?,
        };
        let facets = nodes.into_iter().zip(kept);
        let facet = |(node, kept): (_, Kept)| Facet {
            node,
            image: kept.image,
        };
        Ok(facets.map(facet).collect())
    }

    /// Where the table holds the rays from `place` in the directions of `face`.
    pub(super) fn kept(&self, place: &Place, face: usize) -> Kept {
        let cells = &self.division.cells;
        let (cell, camera) = cell::locate(cells, self.space.cameras(), &place.parameters);
        let stored = self.division.stored(&cell, self.space.block(face));
        let mirror = stored.mirror.map(|i| &self.space.mirrors()[i]);
        Kept {
            chunk: stored.chunk,
            camera: mirror.map_or_else(|| camera.clone(), |mirror| mirror.camera(&camera)),
            image: mirror.map(|mirror| mirror.image(&self.space, face)),
        }
    }
}

/// Where a table holds the rays from one camera in the directions of one face.
pub(super) struct Kept {
    pub(super) chunk: usize,
    /// The camera's parameters in the chunk, in [−1, 1].
    pub(super) camera: Vec<f64>,
    /// What carries the rays to those of the chunk; `None` if they are its own.
    pub(super) image: Option<Image>,
}
