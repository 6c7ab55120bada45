//! What takes long when a scene with large meshes starts, kept for its next start: meshes as they are read, where they
//! are placed along geodesics, and the trees of their triangles.
//!
//! In: what such a result depends on, and how to make it. Out: the result, made or as it was kept
//! ([`geofan_core::keeping`]). Each file has the bytes of one result, both ways; numbers are kept exactly.

#[cfg(feature = "formats")]
mod large_mesh;

#[cfg(feature = "formats")]
pub(crate) use large_mesh::mesh;

use crate::scene::{Cuts, Mesh, ObjectEntry, Points, pack_cuts, read_cuts, take_chunk};
use geofan_core::{
    keeping::{Keeping, ResultKey, kept},
    manifold::Manifold,
};
use glam::{DVec3, Vec3A};
use obvhs::{aabb::Aabb, bvh2::node::Bvh2Node};
use std::convert::Infallible;

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
    let count = usize::try_from(u64::from_le_bytes(take_chunk(bytes)?)).ok()?;
    Some(bytes.split_off(..count.checked_mul(W)?)?.as_chunks().0)
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

#[cfg(feature = "formats")]
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
    let count = u64::from_le_bytes(take_chunk(bytes)?);
    let text = |_| {
        let text = take::<1>(bytes)?.as_flattened().to_vec();
        String::from_utf8(text).ok()
    };
    (0..count).map(text).collect()
}

/// Fewest triangles of a mesh that is worth looking for: geodesics to fewer take a few milliseconds.
const FEWEST_PLACED: usize = 1_000;

/// How a mesh is cut, its vertices, and warnings about its placement.
pub(crate) type PlacedPoints = (Cuts, Points, Vec<String>);

/// Returns what `place` returns for `object` with its `mesh` in `manifold`, or what it returned before; `None` if it
/// cannot be placed.
pub(crate) fn placed(
    (manifold, object, mesh): (&Manifold, &ObjectEntry, &Mesh),
    place: impl FnOnce() -> Option<PlacedPoints>,
) -> Option<PlacedPoints> {
    if mesh.triangles.len() < FEWEST_PLACED {
        return place();
    }
    let keeping = Keeping {
        key: || placement_key(manifold, object, mesh),
        read: decode_placed,
        write: |placed: &PlacedPoints| Some(encode_placed(placed)),
    };
    kept(keeping, || place().ok_or(())).ok()
}

fn placement_key(manifold: &Manifold, object: &ObjectEntry, mesh: &Mesh) -> ResultKey {
    let mut bytes = b"placement".to_vec();
    bytes.extend(manifold.meaning_digest());
    // Warnings name it.
    put_texts(&mut bytes, &[object.mesh.display().to_string()]);
    put_vectors(&mut bytes, &[object.at]);
    let turn = object.rotation.to_array().into_iter().chain([object.scale]);
    bytes.extend(turn.flat_map(f64::to_le_bytes));
    put_vectors(&mut bytes, &mesh.positions);
    put_vectors(&mut bytes, &mesh.normals);
    put_triangles(&mut bytes, &mesh.triangles);
    // It decides how far away a mesh is cut off.
    bytes.extend(manifold.length.unwrap_or(f64::INFINITY).to_le_bytes());
    *blake3::hash(&bytes).as_bytes()
}

fn encode_placed((cuts, points, warnings): &PlacedPoints) -> Vec<u8> {
    let mut bytes = Vec::new();
    let cuts = pack_cuts(&[Some(cuts.clone())]);
    put(&mut bytes, cuts.iter().map(|byte| [*byte]));
    let both = |(u, n): &(_, _)| joined([vector_bytes(*u), vector_bytes(*n)]);
    put::<48>(&mut bytes, points.iter().map(both));
    put_texts(&mut bytes, warnings);
    bytes
}

/// Reads what [`encode_placed`] wrote.
fn decode_placed(mut bytes: &[u8]) -> Option<PlacedPoints> {
    let bytes = &mut bytes;
    let cuts = read_cuts(take::<1>(bytes)?.as_flattened(), 1)?.pop()??;
    let both = |word: &[u8; 48]| (vector(&part(word, 0)), vector(&part(word, 1)));
    let points = take(bytes)?.iter().map(both).collect();
    let warnings = take_texts(bytes)?;
    bytes.is_empty().then_some((cuts, points, warnings))
}

/// The nodes of a tree of boxes, and the numbers of the boxes in the order of its leaves.
pub(crate) type SortedBoxes = (Vec<Bvh2Node>, Vec<u32>);

/// Returns the tree of `boxes` that `build` builds, or that it built before.
pub(crate) fn tree(boxes: &[Aabb], build: impl FnOnce() -> SortedBoxes) -> SortedBoxes {
    if boxes.len() < LARGE {
        return build();
    }
    let keeping = Keeping {
        key: || tree_key(boxes),
        read: |bytes: &[u8]| decode_tree(bytes, boxes.len()),
        write: |tree: &SortedBoxes| Some(encode_tree(tree)),
    };
    let Ok(tree) = kept(keeping, || Ok::<_, Infallible>(build()));
    tree
}

fn tree_key(boxes: &[Aabb]) -> ResultKey {
    let mut bytes = b"tree".to_vec();
    let word = |aabb: &Aabb| joined(corners(aabb).map(f32::to_le_bytes));
    put::<24>(&mut bytes, boxes.iter().map(word));
    *blake3::hash(&bytes).as_bytes()
}

/// Returns the coordinates of the low corner, then those of the high one.
fn corners(aabb: &Aabb) -> [f32; 6] {
    let [low, high] = [aabb.min, aabb.max].map(|corner| corner.to_array());
    [low[0], low[1], low[2], high[0], high[1], high[2]]
}

fn encode_tree((nodes, order): &SortedBoxes) -> Vec<u8> {
    let mut bytes = Vec::new();
    put(&mut bytes, nodes.iter().map(node_bytes));
    put(&mut bytes, order.iter().map(|number| number.to_le_bytes()));
    bytes
}

/// Returns the bytes of a node: its box, the number of boxes in it (0 unless it is a leaf), and the first of those or of its
/// children.
fn node_bytes(node: &Bvh2Node) -> [u8; 32] {
    let [a, b, c, d, e, f] = corners(node.aabb()).map(f32::to_le_bytes);
    let [count, first] = [node.prim_count, node.first_index].map(u32::to_le_bytes);
    joined([a, b, c, d, e, f, count, first])
}

/// Reads what [`node_bytes`] returned.
fn node(bytes: &[u8; 32]) -> Bvh2Node {
    let number = |k| f32::from_le_bytes(part(bytes, k));
    let corner = |k| Vec3A::new(number(k), number(k + 1), number(k + 2));
    let [count, first] = [6, 7].map(|k| u32::from_le_bytes(part(bytes, k)));
    Bvh2Node::new(Aabb::new(corner(0), corner(3)), count, first)
}

/// Reads the tree of so many boxes that [`encode_tree`] wrote; `None` if it is something else.
fn decode_tree(mut bytes: &[u8], boxes: usize) -> Option<SortedBoxes> {
    let bytes = &mut bytes;
    let nodes: Vec<Bvh2Node> = take(bytes)?.iter().map(node).collect();
    let order = take(bytes)?.iter().map(|n| u32::from_le_bytes(*n));
    let order: Vec<u32> = order.collect();
    // Children are behind their parents' places or before, but never the root.
    let known = |node: &Bvh2Node| {
        let first = node.first_index as usize;
        match node.prim_count {
            0 => first > 0 && first + 1 < nodes.len(),
            count => first.saturating_add(count as usize) <= boxes,
        }
    };
    let fits = order.len() == boxes
        && order.iter().all(|number| (*number as usize) < boxes)
        && !nodes.is_empty()
        && nodes.iter().all(known);
    (fits && bytes.is_empty()).then_some((nodes, order))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tree_comes_back_and_other_bytes_are_refused() {
        let aabb = |x: f32| Aabb::new(Vec3A::splat(x), Vec3A::new(x + 1.0, 2.0 * x, 9.0));
        let nodes = vec![
            Bvh2Node::new(aabb(0.25), 0, 1),
            Bvh2Node::new(aabb(-1.5), 2, 0),
            Bvh2Node::new(aabb(3.0), 1, 2),
        ];
        let bytes = encode_tree(&(nodes.clone(), vec![2, 0, 1]));
        let (back, order) = decode_tree(&bytes, 3).unwrap();
        assert_eq!(order, [2, 0, 1]);
        assert!(nodes.iter().map(node_bytes).eq(back.iter().map(node_bytes)));
        assert!(decode_tree(&bytes, 2).is_none() && decode_tree(&bytes, 4).is_none());
        for length in 0..bytes.len() {
            assert!(decode_tree(&bytes[..length], 3).is_none());
        }
        // Nodes that are not there, a parent that is its own child.
        for first in [0, 2, u32::MAX] {
            let root = Bvh2Node::new(aabb(0.25), 0, first);
            let nodes = vec![root, nodes[1], nodes[2]];
            assert!(decode_tree(&encode_tree(&(nodes, vec![2, 0, 1])), 3).is_none());
        }
    }
}
