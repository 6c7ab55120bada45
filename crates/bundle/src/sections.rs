//! Sections of a chunk: parts of its tree that are coded apart, each decoded when a camera first needs it.
//!
//! The integers of one code can only be read one after the other, by one thread, and a chunk of three camera parameters has
//! millions. Its large subtrees are coded each by itself: threads decode them at once, and a camera only those that hold its
//! paths. What is small stays together, where models learn from all of it.
//! In: the tree of a chunk. Out: its bytes, and back: [`Tree::encode`], [`Tree::decode`]; a [`CodedTree`].

use crate::{
    coder::{IntegerDecoder, IntegerEncoder},
    decode::{ByteReader, DecodeBudget, DecodeError, put_bytes},
    tensor::StoredTensor,
    tree::{TensorShape, Tree, halved},
};
use geofan_core::parallel::*;
use std::sync::{
    Arc, OnceLock,
    atomic::{AtomicBool, Ordering},
};

/// Integers of a subtree from which on it may be coded apart: its models have learnt what there is to learn.
const SMALLEST: usize = 1 << 17;

/// Integers from which on what is no single patch is divided: they are decoded in a tenth of a second or so.
const LARGEST: usize = 1 << 19;

/// A tree as the bytes of a chunk or a section, decoded when it is first used.
#[derive(Debug, Clone)]
pub struct CodedTree {
    bytes: Vec<u8>,
    shape: TensorShape,
    /// What all chunks of the table may ask for.
    budget: Arc<DecodeBudget>,
    /// Set for a section: it has none itself.
    is_section: bool,
    tree: OnceLock<Result<Tree, DecodeError>>,
    /// Set when a thread begins to decode it.
    begun: Arc<AtomicBool>,
}

impl CodedTree {
    /// Takes over the bytes of a chunk. The chunks of a table share its `budget`.
    pub(crate) fn of_chunk(bytes: Vec<u8>, shape: TensorShape, budget: Arc<DecodeBudget>) -> Self {
        Self {
            bytes,
            shape,
            budget,
            is_section: false,
            tree: OnceLock::new(),
            begun: Arc::default(),
        }
    }

    /// Returns the coded tree.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Tells whether somebody has decoded the tree, or has tried.
    pub fn is_decoded(&self) -> bool {
        self.tree.get().is_some()
    }

    /// Decodes the tree but for its sections, if nobody has yet.
    ///
    /// # Errors
    /// The bytes are not a tree.
    pub fn tree(&self) -> Result<&Tree, DecodeError> {
        let tree = filled(&self.tree, || {
            // Threads that come while another decodes it do the same, but the table is charged once.
            let again = self.begun.swap(true, Ordering::Relaxed);
            let own = again.then(|| self.budget.whole());
            let budget = own.as_ref().unwrap_or(&self.budget);
            let sections = (!self.is_section).then_some(&self.budget);
            Tree::read(
                &self.bytes,
                self.shape,
                (budget, sections),
                IntegerDecoder::new,
            )
        });
        tree.as_ref().map_err(|e| *e)
    }
}

/// Returns the content of `place`, made first if nothing is there. Not within `get_or_init`: the making
/// waits for other threads, and a thread that waits may take up work that needs the same place.
pub(crate) fn filled<T>(place: &OnceLock<T>, make: impl FnOnce() -> T) -> &T {
    match place.get() {
        Some(made) => made,
        None => {
            let made = make();
            place.get_or_init(|| made)
        }
    }
}

/// Counts the sections of a chunk without decoding anything; none in bytes that are not a chunk.
pub(crate) fn count_sections(chunk: &[u8]) -> usize {
    let mut input = ByteReader(chunk);
    let main = input.u32().and_then(|_| input.bytes());
    if main.and_then(|_| input.bytes()).is_err() {
        return 0;
    }
    std::iter::from_fn(|| input.bytes().ok()).count()
}

/// The bytes of a chunk being written: its boxes and shapes, its integers, its sections.
pub(crate) struct ChunkWriter {
    pub structure: Vec<u8>,
    pub integers: IntegerEncoder,
    sections: Vec<Vec<u8>>,
    /// Set if large subtrees become sections.
    divided: bool,
}

impl ChunkWriter {
    fn new(divided: bool) -> Self {
        Self {
            structure: Vec::new(),
            integers: IntegerEncoder::new(),
            sections: Vec::new(),
            divided,
        }
    }

    /// Tells whether `tree` is to be a section.
    pub fn sets_apart(&self, tree: &Tree) -> bool {
        let is_patch = matches!(tree, Tree::Leaf(_));
        let integers = if self.divided { tree.integers() } else { 0 };
        integers >= SMALLEST && (is_patch || integers <= LARGEST)
    }

    /// Adds a section.
    pub fn put_section(&mut self, bytes: Vec<u8>) {
        self.sections.push(bytes);
    }

    fn finish(self) -> Vec<u8> {
        let mut out = Vec::new();
        self.integers.finish(&mut out);
        put_bytes(&mut out, &self.structure);
        self.sections.iter().for_each(|s| put_bytes(&mut out, s));
        out
    }
}

/// The bytes of a chunk being read.
pub(crate) struct ChunkReader<'b> {
    pub structure: ByteReader<'b>,
    pub integers: IntegerDecoder,
    /// Its sections, and the budget that they share; none within a section.
    sections: Option<(ByteReader<'b>, &'b Arc<DecodeBudget>)>,
}

impl ChunkReader<'_> {
    /// Takes the next tensor, of this `shape`.
    ///
    /// # Errors
    /// It is not one.
    pub fn tensor<'s>(
        &mut self,
        shape: TensorShape,
        restoring: (&TaskScope<'s>, &'s DecodeBudget),
    ) -> Result<StoredTensor, DecodeError> {
        StoredTensor::decode(&mut self.structure, &mut self.integers, shape, restoring)
    }

    /// Takes the next section, a tree of this `shape`.
    ///
    /// # Errors
    /// There is none.
    pub fn section(&mut self, shape: TensorShape) -> Result<Arc<CodedTree>, DecodeError> {
        let (input, budget) = self.sections.as_mut().ok_or(DecodeError("kind of a box"))?;
        let bytes = input.bytes()?.to_vec();
        Ok(Arc::new(CodedTree {
            is_section: true,
            ..CodedTree::of_chunk(bytes, shape, budget.clone())
        }))
    }

    fn finish(&self) -> Result<(), DecodeError> {
        self.structure.finish()?;
        self.integers.finish()?;
        let sections = self.sections.as_ref();
        sections.map_or(Ok(()), |(input, _)| input.finish())
    }
}

impl Tree {
    /// Writes the bytes of a chunk: all integers of its tensors together, then boxes and shapes, then the sections.
    pub fn encode(&self) -> Vec<u8> {
        // A tree that has been read keeps those that it has.
        let undivided = self.sections().is_empty() && !matches!(self, Tree::Leaf(_));
        self.encoded(undivided && self.integers() > LARGEST)
    }

    /// Writes a tree all of which is coded together.
    pub(crate) fn encode_section(&self) -> Vec<u8> {
        self.encoded(false)
    }

    fn encoded(&self, divided: bool) -> Vec<u8> {
        let mut chunk = ChunkWriter::new(divided);
        self.put(&mut chunk);
        chunk.finish()
    }

    /// Reads what [`Tree::encode`] wrote, all of it.
    ///
    /// # Errors
    /// The bytes are not a chunk of tensors of this shape, or ask for more than is left of the budget.
    pub fn decode(
        bytes: &[u8],
        shape: TensorShape,
        budget: &Arc<DecodeBudget>,
    ) -> Result<Self, DecodeError> {
        let tree = Self::read(bytes, shape, (budget, Some(budget)), IntegerDecoder::new)?;
        tree.decode_sections()?;
        tree.mapped(&Ok, &|section| section.tree().cloned())
    }

    /// Reads the boxes alone, with zeros for all integers, which need not be decoded.
    ///
    /// # Errors
    /// The bytes are not a chunk of tensors of this shape, or ask for more than is left of the budget.
    pub fn outline(
        bytes: &[u8],
        shape: TensorShape,
        budget: &Arc<DecodeBudget>,
    ) -> Result<Self, DecodeError> {
        let outline = |bytes: &[u8], shape, sections| {
            Self::read(bytes, shape, (budget, sections), IntegerDecoder::zeros)
        };
        let tree = outline(bytes, shape, Some(budget))?;
        tree.mapped(&Ok, &|section| outline(&section.bytes, section.shape, None))
    }

    /// Reads a tree by this `decoder`; its sections, which may ask for what is left of a budget of their own, are left as
    /// they are.
    fn read(
        bytes: &[u8],
        shape: TensorShape,
        (budget, sections): (&DecodeBudget, Option<&Arc<DecodeBudget>>),
        decoder: fn(&mut ByteReader<'_>) -> Result<IntegerDecoder, DecodeError>,
    ) -> Result<Self, DecodeError> {
        let mut input = ByteReader(bytes);
        let integers = decoder(&mut input)?;
        let structure = ByteReader(input.bytes()?);
        if sections.is_none() {
            input.finish()?;
        }
        let mut chunk = ChunkReader {
            structure,
            integers,
            sections: sections.map(|budget| (input, budget)),
        };
        // Integers can only be read one after the other, by this thread: one of those that pictures wait for would be
        // gone for long. Those restore what has been read meanwhile.
        let tree = scope(|scope| Tree::take(&mut chunk, (shape, (scope, budget)), 0))?;
        let restored = |tensor: StoredTensor| Ok(Arc::new(tensor.restored(budget)?));
        let tree = tree.mapped(&restored, &|section| Ok(Tree::Section(section)))?;
        chunk.finish()?;
        Ok(tree)
    }

    /// Lists the sections that may hold paths of the ray with these parameters of camera and direction, all in [−1, 1]; where
    /// directions are parted into faces, it is in that `face` and has the direction parameters `on_face`.
    pub(crate) fn sections_along<'t>(
        &'t self,
        ray: &[f64],
        (face, on_face): (usize, [f64; 2]),
        found: &mut Vec<&'t Arc<CodedTree>>,
    ) {
        match self {
            Tree::Section(section) => found.push(section),
            Tree::Split { axis, halves } if *axis < ray.len() => {
                let (side, ray) = halved(ray, *axis);
                halves[side].sections_along(&ray, (face, on_face), found);
            }
            Tree::Faces(faces) => {
                let mut ray = ray.to_vec();
                let cameras = ray.len() - on_face.len();
                ray[cameras..].copy_from_slice(&on_face);
                faces[face].sections_along(&ray, (face, on_face), found);
            }
            // Where edges and separatrices are need not be known.
            _ => {
                let parts = self.parts().iter();
                parts.for_each(|part| part.sections_along(ray, (face, on_face), found));
            }
        }
    }

    /// Decodes all sections.
    ///
    /// # Errors
    /// One is damaged.
    pub(crate) fn decode_sections(&self) -> Result<(), DecodeError> {
        let sections = self.sections();
        decode_all(&sections);
        sections
            .iter()
            .try_for_each(|coded| coded.tree().map(|_| ()))
    }

    /// Counts the integers of its tensors; none of sections that are damaged.
    pub fn integers(&self) -> usize {
        let own = match self {
            Tree::Leaf(tensor) => tensor.integers(),
            Tree::Edge { place, .. } | Tree::Separatrix { place, .. } => place.integers(),
            Tree::Section(section) => section.tree().map_or(0, Tree::integers),
            Tree::Split { .. } | Tree::Faces(_) | Tree::Flagged => 0,
        };
        own + self.parts().iter().map(Tree::integers).sum::<usize>()
    }
}

/// Decodes trees at once, if nobody has yet.
pub(crate) fn decode_all(trees: &[&Arc<CodedTree>]) {
    trees.par_iter().for_each(|coded| {
        // What is damaged is told where it is looked into.
        let _ = coded.tree();
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Polynomial, StepSize, Train, tree::hostile_tests::SHAPE};
    use ndarray::{ArrayD, IxDyn};

    /// A patch of `n` times 3072 integers.
    fn leaf(n: usize) -> Tree {
        let number = |i: IxDyn| 0.5 + 0.01 * ((i[1] * i[1] + 3 * i[2] + i[0]) % 17) as f64;
        let polynomial = Polynomial {
            coefficients: ArrayD::from_shape_fn(IxDyn(&[2, n, 64, 8, 3]), number),
            variables: SHAPE.variables,
        };
        let tensor = Train::plain(&polynomial).rounded(StepSize::near(1e-2));
        Tree::Leaf(Arc::new(tensor.unwrap()))
    }

    fn split(axis: usize, halves: [Tree; 2]) -> Tree {
        let halves = Box::new(halves);
        Tree::Split { axis, halves }
    }

    /// A tree of which three patches are sections, and a small one is not.
    fn large() -> Tree {
        let behind = split(1, [leaf(128), leaf(64)]);
        split(0, [leaf(64), split(3, [leaf(4), behind])])
    }

    fn budget(bytes: &[u8]) -> Arc<DecodeBudget> {
        Arc::new(DecodeBudget::for_bytes(bytes.len()))
    }

    fn opened(bytes: &[u8]) -> CodedTree {
        CodedTree::of_chunk(bytes.to_vec(), SHAPE, budget(bytes))
    }

    #[test]
    fn large_patches_are_sections_that_are_decoded_where_rays_need_them() {
        let (tree, bytes) = (large(), large().encode());
        assert_eq!(count_sections(&bytes), 3);
        assert!(
            Tree::decode(&bytes, SHAPE, &budget(&bytes))
                .unwrap()
                .encode()
                == bytes
        );
        let outline = Tree::outline(&bytes, SHAPE, &budget(&bytes)).unwrap();
        assert_eq!(
            (outline.count(), outline.integers()),
            (tree.count(), tree.integers())
        );
        // Nothing but the small patch.
        let chunk = opened(&bytes);
        let boxes = chunk.tree().unwrap();
        let all = boxes.sections();
        assert!(all.len() == 3 && all.iter().all(|section| !section.is_decoded()));
        for (ray, expected) in [
            ([-0.5, 0.1, 0.9], vec![0]),
            ([0.5, -0.1, 0.9], vec![1]),
            ([0.5, 0.1, 0.9], vec![2]),
        ] {
            let mut found = Vec::new();
            boxes.sections_along(&ray, (0, [0.1, 0.9]), &mut found);
            let number = |s: &&Arc<CodedTree>| all.iter().position(|other| Arc::ptr_eq(other, s));
            let numbers: Vec<_> = found.iter().filter_map(number).collect();
            assert_eq!(numbers, expected);
        }
        assert_eq!(boxes.count(), tree.count());
        assert!(all.iter().all(|section| section.is_decoded()));
        // Written again as they are.
        assert!(boxes.encode() == bytes);
    }

    #[test]
    fn what_is_small_or_one_patch_has_no_sections() {
        for tree in [leaf(200), split(1, [leaf(64), leaf(64)]), Tree::Flagged] {
            let bytes = tree.encode();
            assert_eq!(count_sections(&bytes), 0);
            assert!(bytes == tree.encode_section());
        }
        assert_eq!(count_sections(&[1, 2, 3]), 0);
    }

    #[test]
    fn sections_in_sections_and_sections_that_no_box_or_no_byte_is_left_for_are_refused() {
        let bytes = large().encode();
        let refused = |bytes: &[u8]| {
            let (whole, boxes) = (Tree::decode(bytes, SHAPE, &budget(bytes)), opened(bytes));
            assert_eq!(whole.is_err(), boxes.tree().is_err());
            whole.unwrap_err().0
        };
        assert_eq!(
            refused(&[&bytes[..], &[4, 0, 0, 0, 1, 2, 3, 4]].concat()),
            "end"
        );
        assert_eq!(refused(&bytes[..bytes.len() - 1]), "length");
        let nothing = [0; 8];
        let apart = |section: &[u8]| {
            let mut chunk = nothing.to_vec();
            put_bytes(&mut chunk, &[250]);
            put_bytes(&mut chunk, section);
            chunk
        };
        let flagged = [&nothing[..], &[1, 0, 0, 0, 255]].concat();
        let chunk = apart(&flagged);
        let read = Tree::decode(&chunk, SHAPE, &budget(&chunk)).unwrap();
        assert_eq!(read.count(), (0, 1));
        let twice = apart(&apart(&flagged));
        assert!(Tree::decode(&twice, SHAPE, &budget(&twice)).is_err());
        // Where boxes are looked into alone, that section is given up.
        assert_eq!(opened(&twice).tree().unwrap().count(), (0, 0));
    }
}
