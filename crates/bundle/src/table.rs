//! The table in memory: its chunks, where each is stored, and what is left of them at one camera.
//!
//! In: chunks of the table ([`Tree`]s) over the rays of a [`RaySpace`]; cells along each camera
//! parameter, blocks of directions (each face, or all of them together), and mirrors that carry some of
//! them into others. Out: [`Fan`]s, all paths from one camera position. Interpolation *is* the contraction
//! of the camera axes, so a camera anywhere in the region costs the same.

use crate::{
    MappedChebyshev,
    contraction::{ContractedTree, contract},
    decode::{DecodeBudget, DecodeError, LookupError},
    fan::{FaceFan, Fan},
    polynomial::Variables,
    rays::{Image, Located, Mirror, Place, RaySpace, cell_of},
    sections::{CodedTree, count_sections, filled},
    tree::{TensorShape, Tree},
};
use geofan_core::parallel::*;
use glam::DVec3;
use std::sync::{Arc, OnceLock};

/// A chunk, decoded when it is first used: a table of megabytes opens in milliseconds, and a camera
/// needs the chunks of one cell only, and of their sections those that hold its paths.
#[derive(Debug, Clone)]
pub struct Chunk {
    coded: CodedTree,
    /// Number of its sections.
    sections: usize,
    /// The chunk contracted, where a symmetry takes every camera to the same one.
    fixed: OnceLock<Arc<ContractedTree>>,
}

impl Chunk {
    /// Takes over the bytes that [`Tree::encode`] wrote.
    /// The chunks of a table share its `budget`.
    pub fn new(bytes: Vec<u8>, shape: TensorShape, budget: Arc<DecodeBudget>) -> Self {
        Self {
            sections: count_sections(&bytes),
            coded: CodedTree::of_chunk(bytes, shape, budget),
            fixed: OnceLock::new(),
        }
    }

    /// Returns the coded chunk.
    pub fn bytes(&self) -> &[u8] {
        self.coded.bytes()
    }

    /// Decodes the tree but for its sections, if nobody has yet.
    ///
    /// # Errors
    /// The bytes are not a tree.
    pub fn tree(&self) -> Result<&Tree, DecodeError> {
        self.coded.tree()
    }

    /// Lists its sections in order; none if it is damaged. Decodes the rest of the tree, if there are any.
    fn sections(&self) -> Vec<&Arc<CodedTree>> {
        self.divided_tree().map(Tree::sections).unwrap_or_default()
    }

    /// Returns the tree, decoded, if it has sections and is not damaged.
    fn divided_tree(&self) -> Option<&Tree> {
        (self.sections > 0).then(|| self.tree().ok()).flatten()
    }

    /// Contracts the chunk at the parameters `camera` (in [−1, 1]).
    ///
    /// # Errors
    /// The bytes are not a tree.
    fn contract(&self, camera: &[f64]) -> Result<Arc<ContractedTree>, DecodeError> {
        let tree = self.tree()?;
        let contracted = || Arc::new(contract(tree, camera));
        Ok(match camera.is_empty() {
            true => filled(&self.fixed, contracted).clone(),
            false => contracted(),
        })
    }
}

/// A baked table. Its clones share everything, so that fans and threads can each own one.
#[derive(Debug, Clone)]
pub struct Table {
    /// The rays it covers.
    pub space: Arc<RaySpace>,
    /// The cells and blocks of its chunks.
    pub division: Arc<Division>,
    /// Length of the paths.
    pub length: f64,
    /// Tangents keep the promise too, and with them transported frames.
    pub frames: bool,
    /// The chunks, in order.
    pub chunks: Arc<[Chunk]>,
}

impl Table {
    /// Returns the shape of the tensors of a table over `space`.
    pub fn tensor_shape(space: &RaySpace, mapping: MappedChebyshev) -> TensorShape {
        TensorShape {
            variables: Variables {
                cameras: space.cameras().len(),
                mapping,
                sphere: space.sphere().is_some(),
            },
            directions: space.directions(),
            channels: space.channels().len(),
        }
    }

    /// Returns the tree of a chunk, decoded if nobody has yet.
    ///
    /// # Errors
    /// The chunk is damaged.
    ///
    /// # Panics
    /// There are not so many chunks.
    pub fn tree(&self, chunk: usize) -> Result<&Tree, LookupError> {
        let tree = self.chunks[chunk].tree();
        tree.map_err(|damage| LookupError::Damaged { chunk, damage })
    }

    /// Returns the tree of a chunk with all its sections decoded, if nobody has yet.
    ///
    /// # Errors
    /// The chunk is damaged.
    ///
    /// # Panics
    /// There are not so many chunks.
    pub fn whole_tree(&self, chunk: usize) -> Result<&Tree, LookupError> {
        let tree = self.tree(chunk)?;
        let decoded = tree.decode_sections();
        decoded.map_err(|damage| LookupError::Damaged { chunk, damage })?;
        Ok(tree)
    }

    /// Decodes all chunks: where many cameras are wanted at once, each chunk is then decoded once.
    ///
    /// # Errors
    /// A chunk is damaged.
    pub fn decode(&self) -> Result<(), LookupError> {
        let decoded = |chunk| self.whole_tree(chunk).map(|_| ());
        (0..self.chunks.len()).into_par_iter().try_for_each(decoded)
    }

    /// Counts patches and flagged boxes.
    ///
    /// # Errors
    /// A chunk is damaged.
    pub fn counts(&self) -> Result<(usize, usize), LookupError> {
        let mut sum = (0, 0);
        for chunk in 0..self.chunks.len() {
            let (patches, flagged) = self.whole_tree(chunk)?.count();
            sum = (sum.0 + patches, sum.1 + flagged);
        }
        Ok(sum)
    }

    /// Contracts the table to all paths from the camera position `u`.
    ///
    /// # Errors
    /// `u` is not in the camera region, or the patches there are damaged.
    pub fn fan(&self, u: DVec3) -> Result<Fan, LookupError> {
        let place = self.place(u)?;
        let faces = self.face_fans(&place)?;
        Ok(Fan::new(self.clone(), place, faces))
    }

    /// Lists the chunks that a fan from the camera position `u` is made of, in ascending order.
    ///
    /// # Errors
    /// `u` is not in the camera region.
    pub fn chunks_at(&self, u: DVec3) -> Result<Vec<usize>, LookupError> {
        Ok(chunks_of(&self.stored_faces(&self.place(u)?)))
    }

    fn stored_faces(&self, place: &Place) -> Vec<StoredFace> {
        let faces = 0..self.space.faces();
        faces.map(|face| self.stored_face(place, face)).collect()
    }

    /// Lists the numbers of all that is decoded by itself: of chunks, and of the first sections of all chunks that have one,
    /// the second, and so on. That of a section is its chunk's and so many times the number of chunks.
    pub fn sections(&self) -> Vec<usize> {
        let (count, mut numbers) = (self.chunks.len(), Vec::new());
        let most = self.chunks.iter().map(|chunk| chunk.sections).max();
        for k in 0..=most.unwrap_or(0) {
            let stored = (0..count).filter(|chunk| k <= self.chunks[*chunk].sections);
            numbers.extend(stored.map(|chunk| chunk + k * count));
        }
        numbers
    }

    /// Lists the numbers ([`Table::sections`]) of what the paths from the camera position `u` in these directions (standard
    /// frame, unit) are made of. Decodes the boxes of chunks that have sections.
    ///
    /// # Errors
    /// `u` is not in the camera region.
    pub fn sections_at(&self, u: DVec3, directions: &[DVec3]) -> Result<Vec<usize>, LookupError> {
        let place = self.place(u)?;
        let mut found = chunks_of(&self.stored_faces(&place));
        let sections = self.sections_towards(&place, directions);
        found.extend(sections.into_iter().map(|(number, _)| number));
        Ok(found)
    }

    /// Finds the sections that the paths from `place` in these directions are made of, with their numbers.
    pub(crate) fn sections_towards(
        &self,
        place: &Place,
        directions: &[DVec3],
    ) -> Vec<(usize, &Arc<CodedTree>)> {
        let stored = self.stored_faces(place);
        let divided = |face: &StoredFace| self.chunks[face.chunk].sections > 0;
        if !stored.iter().any(divided) {
            return Vec::new();
        }
        let mut along = Vec::new();
        for d in directions {
            let located = self.space.locate(place, *d);
            self.add_sections_along(&stored[located.face], located, &mut along);
        }
        let numbered = along.into_iter().filter_map(|(chunk, section)| {
            let all = self.chunks[chunk].sections();
            let k = all.iter().position(|other| Arc::ptr_eq(other, section))?;
            Some((chunk + (k + 1) * self.chunks.len(), section))
        });
        numbered.collect()
    }

    /// Adds the sections in which the paths of a ray are, with their chunk, to those that are `found` already.
    fn add_sections_along<'t>(
        &'t self,
        stored: &StoredFace,
        located: Located,
        found: &mut Vec<(usize, &'t Arc<CodedTree>)>,
    ) {
        let Some(tree) = self.chunks[stored.chunk].divided_tree() else {
            return;
        };
        let carried = located.carried(stored.image.as_ref());
        let on_face = (carried.face, carried.direction);
        let direction = match self.space.sphere() {
            Some(sphere) => sphere.parameters(carried.aim()),
            None => carried.direction,
        };
        let ray = [&stored.camera, &direction[..self.space.directions()]].concat();
        let mut along = Vec::new();
        tree.sections_along(&ray, on_face, &mut along);
        for section in along {
            if !found.iter().any(|(_, other)| Arc::ptr_eq(other, section)) {
                found.push((stored.chunk, section));
            }
        }
    }

    /// Returns what has this number ([`Table::sections`]), as it is coded; `None` if there is nothing.
    pub fn section(&self, number: usize) -> Option<&CodedTree> {
        let count = self.chunks.len();
        let chunk = &self.chunks[number.checked_rem(count)?];
        match (number / count).checked_sub(1) {
            None => Some(&chunk.coded),
            Some(k) => chunk.sections().get(k).map(|section| &***section),
        }
    }

    fn place(&self, u: DVec3) -> Result<Place, LookupError> {
        let place = self.space.place(u);
        place.map_err(|_| LookupError::OutsideRegion {
            at: u.to_array(),
            region: self.space.describe(),
        })
    }

    /// Contracts the directions of each face from `place`. A chunk that no camera has needed before is
    /// decoded now, which takes far longer than the contraction.
    fn face_fans(&self, place: &Place) -> Result<Vec<FaceFan>, LookupError> {
        let stored = self.stored_faces(place);
        // Each chunk is decoded once, though mirrors carry several faces to it.
        let chunks = chunks_of(&stored);
        chunks
            .par_iter()
            .try_for_each(|chunk| self.tree(*chunk).map(|_| ()))?;
        // And contracted once for each camera, often one: with a sphere all faces are in one chunk.
        let (asked, numbers) = cameras_of(&stored);
        let contract = |(chunk, camera): &(usize, &[f64])| {
            let (chunk, tree) = (*chunk, self.chunks[*chunk].contract(camera));
            tree.map_err(|damage| LookupError::Damaged { chunk, damage })
        };
        let trees: Vec<Arc<ContractedTree>> =
            asked.par_iter().map(contract).collect::<Result<_, _>>()?;
        let faces = numbers.into_iter().zip(stored);
        let face = |(number, stored): (usize, StoredFace)| FaceFan {
            tree: trees[number].clone(),
            image: stored.image,
        };
        Ok(faces.map(face).collect())
    }

    /// Finds the chunk that holds the rays from `place` in the directions of `face`.
    pub(crate) fn stored_face(&self, place: &Place, face: usize) -> StoredFace {
        let cells = &self.division.cells;
        let (cell, camera) = cell_of(cells, self.space.cameras(), &place.parameters);
        let (chunk, mirror) = self.division.stored(&cell, self.space.block(face));
        let mirror = mirror.map(|i| &self.space.mirrors()[i]);
        StoredFace {
            chunk,
            camera: mirror.map_or_else(|| camera.clone(), |mirror| mirror.camera(&camera)),
            image: mirror.map(|mirror| mirror.image(&self.space, face)),
        }
    }
}

/// Lists the chunks of some faces, in ascending order.
fn chunks_of(faces: &[StoredFace]) -> Vec<usize> {
    let mut chunks: Vec<usize> = faces.iter().map(|face| face.chunk).collect();
    chunks.sort_unstable();
    chunks.dedup();
    chunks
}

/// Lists the chunks of some faces with the camera in each, without repetitions; and for each face which of them is its own.
fn cameras_of(faces: &[StoredFace]) -> (Vec<(usize, &[f64])>, Vec<usize>) {
    let mut cameras: Vec<(usize, &[f64])> = Vec::new();
    let mut numbers = Vec::with_capacity(faces.len());
    for face in faces {
        let own = (face.chunk, &face.camera[..]);
        let known = cameras.iter().position(|other| *other == own);
        numbers.push(known.unwrap_or(cameras.len()));
        if known.is_none() {
            cameras.push(own);
        }
    }
    (cameras, numbers)
}

/// The place in a table of the rays from one camera in the directions of one face.
pub(crate) struct StoredFace {
    pub chunk: usize,
    /// The camera's parameters in the chunk, in [−1, 1].
    pub camera: Vec<f64>,
    /// The map that carries the rays to those of the chunk; `None` if they are its own.
    pub image: Option<Image>,
}

/// The division of a table into chunks: one for each class of cells and blocks that mirrors carry into
/// each other.
#[derive(Debug, Clone, PartialEq)]
pub struct Division {
    /// Cells along each stored camera parameter.
    pub cells: Vec<usize>,
    /// Blocks of directions: the faces, or one.
    pub blocks: usize,
    /// For each cell and block its chunk, and the mirror that carries it there; blocks run fastest, then
    /// the first parameter's cells.
    stored: Vec<(usize, Option<usize>)>,
    /// The cell and block of each chunk, in the same numbering.
    chunks: Vec<usize>,
}

impl Division {
    /// Divides into `cells` along each camera parameter. A cell and block that one of the `mirrors` carries
    /// to an earlier one is not stored.
    pub fn new(cells: Vec<usize>, blocks: usize, mirrors: &[Mirror]) -> Self {
        let all = cells.iter().product::<usize>() * blocks;
        let mut division = Self {
            cells,
            blocks,
            stored: Vec::with_capacity(all),
            chunks: Vec::new(),
        };
        // A place is stored unless a mirror carries it to one that is.
        for place in 0..all {
            let earlier = (0..mirrors.len()).find_map(|i| {
                let chunk = division.image(place, &mirrors[i])?;
                Some((chunk, Some(i)))
            });
            let stored = earlier.unwrap_or((division.chunks.len(), None));
            if earlier.is_none() {
                division.chunks.push(place);
            }
            division.stored.push(stored);
        }
        division
    }

    /// Finds the chunk to which `mirror` carries `place`, if there is one.
    fn image(&self, place: usize, mirror: &Mirror) -> Option<usize> {
        let (cell, block) = self.split(place);
        let cell = mirror.cell(&cell, &self.cells)?;
        let block = match self.blocks {
            1 => 0,
            _ => mirror.face(block),
        };
        self.chunks.binary_search(&self.place(&cell, block)).ok()
    }

    /// Returns the number of chunks.
    pub fn chunks(&self) -> usize {
        self.chunks.len()
    }

    /// Returns the cell (along each parameter) and the block of a chunk.
    pub fn of(&self, chunk: usize) -> (Vec<usize>, usize) {
        self.split(self.chunks[chunk])
    }

    /// Finds the chunk that stores `block` of `cell`, and the mirror that carries them to those of the
    /// chunk; no mirror if they are its own.
    pub fn stored(&self, cell: &[usize], block: usize) -> (usize, Option<usize>) {
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
mod tests {
    use super::*;
    use crate::{Polynomial, StepSize, Train};
    use ndarray::{ArrayD, IxDyn};

    #[test]
    fn without_mirrors_all_cells_and_faces_are_chunks() {
        let division = Division::new(vec![2, 3], 6, &[]);
        assert_eq!(division.chunks(), 36);
        for chunk in 0..36 {
            let (cell, face) = division.of(chunk);
            assert_eq!(division.stored(&cell, face), (chunk, None));
        }
        assert_eq!(division.of(7), (vec![1, 0], 1));
    }

    #[test]
    fn threads_that_decode_one_chunk_at_once_charge_its_table_once() {
        let shape = TensorShape {
            variables: Variables {
                cameras: 0,
                mapping: MappedChebyshev::NONE,
                sphere: false,
            },
            directions: 2,
            channels: 3,
        };
        let samples = ArrayD::from_shape_vec(IxDyn(&[1, 1, 1, 3]), vec![0.1, 0.2, 0.3]);
        let polynomial = Polynomial {
            coefficients: samples.unwrap(),
            variables: Variables::of_face(0, MappedChebyshev::NONE),
        };
        let tensor = Train::plain(&polynomial).rounded(StepSize::near(1e-8));
        let bytes = Tree::Leaf(Arc::new(tensor.unwrap())).encode();
        let budget = Arc::new(DecodeBudget::for_bytes(0));
        let chunk = |budget| Chunk::new(bytes.clone(), shape, budget);
        let (first, late) = (chunk(budget.clone()), chunk(budget.clone()));
        let beside = first.clone();
        assert!(first.tree().is_ok());
        // When nothing is left, a thread that had begun with the first beside another still has it, but no other chunk.
        for k in 0..64 {
            while budget.take_memory(u64::MAX >> k).is_ok() {}
        }
        assert!(beside.tree().is_ok() && late.tree().is_err());
    }

    #[test]
    fn fans_and_tables_can_be_given_to_other_threads() {
        fn shareable<T: Send + Sync + 'static>() {}
        shareable::<Table>();
        shareable::<Fan>();
    }
}
