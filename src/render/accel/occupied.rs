//! Which parts of the tree's box hold anything: most boxes that are asked about meet nothing, and this
//! tells so by eight numbers instead of a way down the tree.
//!
//! In: the boxes of leaves in tree coordinates. Out: [`Occupied`], which never denies a leaf.

use obvhs::aabb::Aabb;

/// Cells along each edge of the tree's cube. Chosen, not measured: with more the counts leave the
/// processor's nearer cache.
const CELLS: usize = 32;

/// Counts at the corners of cells, one more than cells along each edge.
const SIDE: usize = CELLS + 1;

/// The cells of a cube that leaves reach into.
#[derive(Clone, Default)]
pub(super) struct Occupied {
    /// How many there are below each corner along all three axes; at most 32³, so they fit.
    counts: Vec<u16>,
}

impl Occupied {
    /// By the boxes of all leaves.
    pub(super) fn by(leaves: impl Iterator<Item = Aabb>) -> Self {
        let mut counts = vec![0; SIDE * SIDE * SIDE];
        for leaf in leaves {
            let [x, y, z] = cells(&leaf);
            for i in x[0]..x[1] {
                for j in y[0]..y[1] {
                    counts[place([i + 1, j + 1, z[0] + 1])..place([i + 1, j + 1, z[1] + 1])]
                        .fill(1);
                }
            }
        }
        for stride in [1, SIDE, SIDE * SIDE] {
            for at in stride..counts.len() {
                // Where an axis begins nothing has been counted, so nothing is carried over its end.
                if at / stride % SIDE != 0 {
                    counts[at] += counts[at - stride];
                }
            }
        }
        Self { counts }
    }

    /// Whether a leaf may reach into the box.
    #[inline]
    pub(super) fn may_meet(&self, query: &Aabb) -> bool {
        let [x, y, z] = cells(query);
        let at = |i: usize, j: usize, k: usize| self.counts[place([x[i], y[j], z[k]])];
        let beside = |i: usize| {
            let (low, high) = (at(i, 0, 0).wrapping_sub(at(i, 0, 1)), at(i, 1, 1));
            low.wrapping_add(high).wrapping_sub(at(i, 1, 0))
        };
        beside(1) != beside(0)
    }
}

fn place([x, y, z]: [usize; 3]) -> usize {
    (x * SIDE + y) * SIDE + z
}

/// Along each axis the first cell that a box reaches into, and the one after the last. Cells beyond the
/// cube are those at its faces. Rounding keeps the order of numbers, so boxes that meet share a cell.
fn cells(aabb: &Aabb) -> [[usize; 2]; 3] {
    let cell = |x: f32| (((x + 1.0) * (0.5 * CELLS as f32)) as usize).min(CELLS - 1);
    [0, 1, 2].map(|c| [cell(aabb.min[c]), cell(aabb.max[c]) + 1])
}
