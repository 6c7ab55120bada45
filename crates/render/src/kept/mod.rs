//! What takes long when a scene with large meshes starts, kept for its next start: meshes as they are read, where they
//! are placed along geodesics, and the trees of their triangles.
//!
//! In: what such a result depends on, and how to make it. Out: the result, made or as it was kept
//! ([`geofan_core::keeping`]). Each file has the bytes of one result, both ways; numbers are kept exactly.

#[cfg(feature = "formats")]
mod mesh;
mod placement;
mod tree;

#[cfg(feature = "formats")]
pub(crate) use mesh::mesh;
pub(crate) use placement::placed;
pub(crate) use tree::{SortedBoxes, tree};

use glam::DVec3;

/// Fewest triangles of meshes and trees that are kept: fewer are read and sorted in less than a tenth of a second.
const LARGE: usize = 50_000;

/// Appends the number of `words` (u64, little-endian) and then these.
fn put<const W: usize>(bytes: &mut Vec<u8>, words: impl ExactSizeIterator<Item = [u8; W]>) {
    bytes.extend((words.len() as u64).to_le_bytes());
    bytes.reserve(W * words.len());
    words.for_each(|word| bytes.extend_from_slice(&word));
}

/// Reads what [`put`] wrote.
fn take<'b, const W: usize>(bytes: &mut &'b [u8]) -> Option<&'b [[u8; W]]> {
    let (count, rest) = bytes.split_first_chunk::<8>()?;
    let count = usize::try_from(u64::from_le_bytes(*count)).ok()?;
    let (words, rest) = rest.split_at_checked(count.checked_mul(W)?)?;
    *bytes = rest;
    Some(words.as_chunks().0)
}

/// Returns the bytes of `N` numbers of `W` bytes together.
fn joined<const W: usize, const N: usize, const ALL: usize>(parts: [[u8; W]; N]) -> [u8; ALL] {
    let mut all = [0; ALL];
    for (to, part) in all.chunks_exact_mut(W).zip(parts) {
        to.copy_from_slice(&part);
    }
    all
}

/// Returns part `k` of such bytes.
fn part<const W: usize, const ALL: usize>(all: &[u8; ALL], k: usize) -> [u8; W] {
    all.as_chunks().0[k]
}

fn vector_bytes(v: DVec3) -> [u8; 24] {
    joined(v.to_array().map(f64::to_le_bytes))
}

fn vector(bytes: &[u8; 24]) -> DVec3 {
    DVec3::from_array([0, 1, 2].map(|k| f64::from_le_bytes(part(bytes, k))))
}

fn put_vectors(bytes: &mut Vec<u8>, vectors: &[DVec3]) {
    put(bytes, vectors.iter().map(|v| vector_bytes(*v)));
}

fn take_vectors(bytes: &mut &[u8]) -> Option<Vec<DVec3>> {
    Some(take(bytes)?.iter().map(vector).collect())
}

fn put_triangles(bytes: &mut Vec<u8>, triangles: &[[u32; 3]]) {
    let words = triangles.iter().map(|t| joined(t.map(u32::to_le_bytes)));
    put::<12>(bytes, words);
}

/// Reads triangles of so many vertices.
#[cfg(feature = "formats")]
fn take_triangles(bytes: &mut &[u8], vertices: usize) -> Option<Vec<[u32; 3]>> {
    let read = |word: &[u8; 12]| [0, 1, 2].map(|k| u32::from_le_bytes(part(word, k)));
    let triangles: Vec<[u32; 3]> = take(bytes)?.iter().map(read).collect();
    let corners = triangles.iter().flatten();
    let known = corners.copied().all(|corner| (corner as usize) < vertices);
    known.then_some(triangles)
}

fn put_texts(bytes: &mut Vec<u8>, texts: &[String]) {
    bytes.extend((texts.len() as u64).to_le_bytes());
    for text in texts {
        put(bytes, text.bytes().map(|byte| [byte]));
    }
}

fn take_texts(bytes: &mut &[u8]) -> Option<Vec<String>> {
    let (count, rest) = bytes.split_first_chunk::<8>()?;
    *bytes = rest;
    let text = |_| {
        let text = take::<1>(bytes)?.as_flattened().to_vec();
        String::from_utf8(text).ok()
    };
    (0..u64::from_le_bytes(*count)).map(text).collect()
}
