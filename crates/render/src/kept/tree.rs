//! Trees of many boxes.

use super::{LARGE, joined, part, put, take};
use geofan_core::keeping::{Keeping, ResultKey, kept};
use glam::Vec3A;
use obvhs::{aabb::Aabb, bvh2::node::Bvh2Node};
use std::convert::Infallible;

/// The nodes of a tree of boxes, and the numbers of the boxes in the order of its leaves.
pub(crate) type SortedBoxes = (Vec<Bvh2Node>, Vec<u32>);

/// Returns the tree of `boxes` that `build` builds, or that it built before.
pub(crate) fn tree(boxes: &[Aabb], build: impl FnOnce() -> SortedBoxes) -> SortedBoxes {
    if boxes.len() < LARGE {
        return build();
    }
    let keeping = Keeping {
        key: || key(boxes),
        read: |bytes: &[u8]| decode(bytes, boxes.len()),
        write: |tree: &SortedBoxes| Some(encode(tree)),
    };
    let Ok(tree) = kept(keeping, || Ok::<_, Infallible>(build()));
    tree
}

fn key(boxes: &[Aabb]) -> ResultKey {
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

fn encode((nodes, order): &SortedBoxes) -> Vec<u8> {
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

/// Reads the tree of so many boxes that [`encode`] wrote; `None` if it is something else.
fn decode(mut bytes: &[u8], boxes: usize) -> Option<SortedBoxes> {
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
        let bytes = encode(&(nodes.clone(), vec![2, 0, 1]));
        let (back, order) = decode(&bytes, 3).unwrap();
        assert_eq!(order, [2, 0, 1]);
        assert!(nodes.iter().map(node_bytes).eq(back.iter().map(node_bytes)));
        assert!(decode(&bytes, 2).is_none() && decode(&bytes, 4).is_none());
        for length in 0..bytes.len() {
            assert!(decode(&bytes[..length], 3).is_none());
        }
        // Nodes that are not there, a parent that is its own child.
        for first in [0, 2, u32::MAX] {
            let root = Bvh2Node::new(aabb(0.25), 0, first);
            let nodes = vec![root, nodes[1], nodes[2]];
            assert!(decode(&encode(&(nodes, vec![2, 0, 1])), 3).is_none());
        }
    }
}
