//! The topmost subtrees, looked at together.
//!
//! In: a tree. Out: for a box those of them that it meets.

use obvhs::{aabb::Aabb, bvh2::node::Bvh2Node};

/// The subtrees below the root whose boxes are looked at together, because most boxes that are asked
/// about meet none of them.
#[derive(Clone, Default)]
pub(super) struct Top {
    count: usize,
    nodes: [u32; TOP],
    low: [[f32; TOP]; 3],
    high: [[f32; TOP]; 3],
}

/// How many.
const TOP: usize = 16;

impl Top {
    pub(super) fn of(nodes: &[Bvh2Node]) -> Self {
        let mut open = vec![0_u32];
        let area = |i: &u32| nodes[*i as usize].aabb().half_area();
        while open.len() < TOP {
            let inner = (0..open.len()).filter(|k| !nodes[open[*k] as usize].is_leaf());
            let Some(k) = inner.max_by(|a, b| area(&open[*a]).total_cmp(&area(&open[*b]))) else {
                break;
            };
            let first = nodes[open.swap_remove(k) as usize].first_index;
            open.extend([first, first + 1]);
        }
        let mut top = Self {
            count: open.len(),
            ..Self::default()
        };
        for (k, index) in open.into_iter().enumerate() {
            let aabb = nodes[index as usize].aabb();
            top.nodes[k] = index;
            for c in 0..3 {
                (top.low[c][k], top.high[c][k]) = (aabb.min[c], aabb.max[c]);
            }
        }
        top
    }

    /// Shows those that meet `query`.
    #[inline(always)]
    pub(super) fn met(&self, query: &Aabb, mut show: impl FnMut(u32)) {
        let mut meets = [true; TOP];
        for c in 0..3 {
            let (low, high) = (query.min[c], query.max[c]);
            for k in 0..TOP {
                meets[k] &= (self.low[c][k] <= high) & (self.high[c][k] >= low);
            }
        }
        for k in (0..self.count).filter(|k| meets[*k]) {
            show(self.nodes[k]);
        }
    }
}
