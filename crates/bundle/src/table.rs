//! The table in memory, and what is left of it when the camera is fixed.
//!
//! In: chunks of the table ([`Tree`]s) over the rays of a [`RaySpace`]. Out: [`Fan`]s: all paths
//! from one camera position, and from those single [`TablePath`]s: position, tangent and transported
//! rotation at any arc length. Interpolation *is* the contraction of the camera axes, so a camera
//! anywhere in the region costs the same.
//!
//! How a table is divided into chunks, and which of them are stored.
//!
//! In: cells along each camera parameter, blocks of directions (each face, or all of them together), and
//! mirrors that carry some of them into others. Out: the chunks, one for each class of cells and blocks
//! that mirrors carry into each other, and for any cell and block the chunk that holds it
//! ([`Division::stored`]).

use crate::parallel::*;
use crate::{
    chebyshev::MappedChebyshev,
    decode::DecodeError,
    fan::{Facet, Fan, FanNode},
    polynomial::Variables,
    rays::{Image, Mirror, Place, RaySpace, cell},
    tree::{Shape, Tree},
};
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
        let decoded: Result<(), DecodeError> =
            chunks.map(|chunk| chunk.tree().map(|_| ())).collect();
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

/// How a table is divided into chunks.
#[derive(Debug, Clone, PartialEq)]
pub struct Division {
    /// Cells along each stored camera parameter.
    pub cells: Vec<usize>,
    /// Blocks of directions: the faces, or one.
    pub blocks: usize,
    /// Where each cell and block is stored; blocks run fastest, then the first parameter's cells.
    stored: Vec<Stored>,
    /// The cell and block of each chunk, in the same numbering.
    chunks: Vec<usize>,
}

/// Where a cell and block is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stored {
    /// The chunk.
    pub chunk: usize,
    /// The mirror that carries the cell and block to those of the chunk; `None` if they are its own.
    pub mirror: Option<usize>,
}

impl Division {
    /// With `cells` along each camera parameter. A cell and block that one of the `mirrors` carries to
    /// an earlier one is not stored.
    pub fn new(cells: Vec<usize>, blocks: usize, mirrors: &[Mirror]) -> Self {
        let all = cells.iter().product::<usize>() * blocks;
        let mut division = Self {
            cells,
            blocks,
            stored: Vec::with_capacity(all),
            chunks: Vec::new(),
        };
        for place in 0..all {
            let earlier = (0..mirrors.len()).find_map(|i| division.image(place, i, &mirrors[i]));
            let stored = earlier.unwrap_or(Stored {
                chunk: division.chunks.len(),
                mirror: None,
            });
            if stored.mirror.is_none() {
                division.chunks.push(place);
            }
            division.stored.push(stored);
        }
        division
    }

    /// Where `place` is stored if mirror number `i` carries it to a chunk.
    fn image(&self, place: usize, i: usize, mirror: &Mirror) -> Option<Stored> {
        let (cell, block) = self.split(place);
        let cell = mirror.cell(&cell, &self.cells)?;
        let block = match self.blocks {
            1 => 0,
            _ => mirror.face(block),
        };
        let image = self.place(&cell, block);
        let chunk = self.chunks.binary_search(&image).ok()?;
        Some(Stored {
            chunk,
            mirror: Some(i),
        })
    }

    /// The number of chunks.
    pub fn chunks(&self) -> usize {
        self.chunks.len()
    }

    /// The cell (along each parameter) and the block of a chunk.
    pub fn of(&self, chunk: usize) -> (Vec<usize>, usize) {
        self.split(self.chunks[chunk])
    }

    /// Where `block` of `cell` is stored.
    pub fn stored(&self, cell: &[usize], block: usize) -> Stored {
        self.stored[self.place(cell, block)]
    }

    fn split(&self, place: usize) -> (Vec<usize>, usize) {
        let mut rest = place / self.blocks;
        let cell = self.cells.iter().map(|n| {
            let c = rest % n;
            rest /= n;
            c
        });
        (cell.collect(), place % self.blocks)
    }

    fn place(&self, cell: &[usize], block: usize) -> usize {
        let cells = cell.iter().zip(&self.cells).rev();
        cells.fold(0, |sum, (c, n)| sum * n + c) * self.blocks + block
    }
}

#[cfg(test)]
mod division_tests {
    use super::*;

    #[test]
    fn without_mirrors_all_cells_and_faces_are_chunks() {
        let division = Division::new(vec![2, 3], 6, &[]);
        assert_eq!(division.chunks(), 36);
        for chunk in 0..36 {
            let (cell, face) = division.of(chunk);
            let stored = division.stored(&cell, face);
            assert_eq!((stored.chunk, stored.mirror), (chunk, None));
        }
        assert_eq!(division.of(7), (vec![1, 0], 1));
    }
}
