//! A tree of boxes, each with a payload.
//!
//! In: payloads with boxes in chart coordinates. Out: the payloads whose boxes may meet a box; which of
//! sixteen boxes meet any; and the nodes, for whoever holds rays against them.
//!
//! The tree lives in *tree coordinates*, the chart moved and scaled so that everything fits in [-1, 1]³: an
//! absolute margin then means the same for an object 1e-3 large as for one 100 large.

use crate::{
    kept::{self, SortedBoxes},
    lanes::{BoxPacket, LANES, Mask, SingleLanes, largest, less},
};
use geofan_core::parallel::*;
use glam::{DVec3, Vec3, Vec3A};
use obvhs::{
    BvhBuildParams,
    aabb::Aabb,
    bvh2::{leaf_collapser::collapse, node::Bvh2Node, reinsertion::ReinsertionOptimizer},
    ploc::PlocBuilder,
};

/// Margin of every box in tree coordinates. Rounding a point of [-1, 1]³ to single precision and one slab
/// test move it by at most 5e-7; a wider margin only lets more payloads through.
pub(super) const MARGIN: f32 = 2e-6;

/// Coordinates beyond this are treated like infinite ones, so that no product overflows.
const LARGEST: f64 = 1e100;

/// Most subtrees that [`BoxTree::roots`] names, if not more of the topmost ones are met: enough to leave out
/// what lies between two objects; more would only be sorted by every packet again. With 20 the wormhole
/// gallery's near half takes 5 % longer.
const MOST_ROOTS: usize = 6;

/// Payloads sorted by their boxes.
#[derive(Clone, Default)]
pub struct BoxTree<T> {
    /// The tree; its leaves name ranges of `leaves`.
    pub(super) nodes: Vec<Bvh2Node>,
    /// The payloads in the order of the leaves: getting those of a leaf from all over memory would take
    /// longer than to look at them.
    leaves: Vec<T>,
    /// At most sixteen nodes below the root that together hold everything, and their boxes. They are looked
    /// at together, because most boxes that are asked about meet none of them.
    topmost: Vec<u32>,
    topmost_boxes: BoxPacket,
    /// Corners of the box around all payloads.
    bounds: Option<(DVec3, DVec3)>,
    /// Tree coordinates are `(u - centre) / scale`.
    centre: DVec3,
    scale: f64,
}

impl<T: Clone + Default + Send + Sync> BoxTree<T> {
    /// Sorts payloads, of which `box_of` returns the boxes; one whose box is not finite is left out.
    pub fn build(payloads: &[T], box_of: impl Fn(&T) -> (DVec3, DVec3) + Sync) -> Self {
        let payload = |i: usize| payloads[i].clone();
        Self::of_boxes(payloads.len(), |i| box_of(&payloads[i]), payload)
    }
}

/// Boxes that one thread joins at a time.
const BLOCK: usize = 16_384;

impl<T: Default + Send + Sync> BoxTree<T> {
    /// Builds the tree over `count` boxes, given by number; one whose box is not finite is left out. Payloads are
    /// made where they belong, because a second list of them would take as much memory as the tree.
    pub(super) fn of_boxes(
        count: usize,
        box_of: impl Fn(usize) -> (DVec3, DVec3) + Sync,
        payload: impl Fn(usize) -> T + Sync,
    ) -> Self {
        // What there is, and the box around it.
        let finite = |i: &usize| {
            let (low, high) = box_of(*i);
            is_usable(low) && is_usable(high)
        };
        let all = (0..count).into_par_iter().filter(finite);
        let finite: Vec<u32> = all.map(|i| i as u32).collect();
        let joined =
            |(min, max): (DVec3, DVec3), (low, high): (DVec3, DVec3)| (low.min(min), high.max(max));
        let of_block = |block: &[u32]| block.iter().map(|i| box_of(*i as usize)).reduce(joined);
        let blocks: Vec<_> = finite.par_chunks(BLOCK).map(of_block).collect();
        let bounds = blocks.into_iter().flatten().reduce(joined);
        let Some((min, max)) = bounds else {
            return Self::default();
        };
        // Tree coordinates.
        let extent = (max - min).max_element() / 2.0;
        let mut built = Self {
            bounds,
            centre: (min + max) / 2.0,
            // A set without extent is a point; any scale does.
            scale: if extent > 0.0 { extent } else { 1.0 },
            ..Self::default()
        };
        // The tree in them.
        let tree_box = |i: &u32| built.tree_box(box_of(*i as usize));
        let boxes: Vec<Aabb> = finite.par_iter().map(tree_box).collect();
        let (nodes, order) = kept::tree(&boxes, || build_tree(&boxes));
        let payload = |slot: &u32| payload(finite[*slot as usize] as usize);
        built.leaves = order.par_iter().map(payload).collect();
        built.nodes = nodes;
        built.choose_topmost();
        built
    }
}

impl<T> BoxTree<T> {
    /// Chooses the topmost nodes.
    fn choose_topmost(&mut self) {
        let open = self.largest_nodes(LANES);
        for (k, index) in open.iter().enumerate() {
            let aabb = self.nodes[*index as usize].aabb();
            for c in 0..3 {
                self.topmost_boxes.low[c][k] = aabb.min[c];
                self.topmost_boxes.high[c][k] = aabb.max[c];
            }
        }
        self.topmost = open;
    }

    /// Lists at most so many nodes that together hold everything: again and again the largest gives way to its children.
    fn largest_nodes(&self, most: usize) -> Vec<u32> {
        let mut open = vec![0_u32];
        let area = |i: &u32| self.nodes[*i as usize].aabb().half_area();
        while open.len() < most {
            let inner = (0..open.len()).filter(|k| !self.nodes[open[*k] as usize].is_leaf());
            let Some(k) = inner.max_by(|a, b| area(&open[*a]).total_cmp(&area(&open[*b]))) else {
                break;
            };
            let first = self.nodes[open.swap_remove(k) as usize].first_index;
            open.extend([first, first + 1]);
        }
        open
    }

    /// Returns at most `most` boxes of the chart that together enclose all payloads; none if there are none.
    pub(super) fn parts(&self, most: usize) -> Vec<(DVec3, DVec3)> {
        if self.nodes.is_empty() {
            return Vec::new();
        }
        let place = |p: Vec3A| self.centre + p.as_dvec3() * self.scale;
        let part = |index: u32| {
            let aabb = self.nodes[index as usize].aabb();
            (place(aabb.min), place(aabb.max))
        };
        self.largest_nodes(most).into_iter().map(part).collect()
    }

    /// Returns the corners of the box around all payloads; `None` if there are none.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        self.bounds
    }

    /// Shows the payloads of every leaf whose box meets the given one: all that meet it, and a few more.
    pub fn visit(&self, min: DVec3, max: DVec3, mut show: impl FnMut(&T)) {
        self.find_leaf(min, max, |payloads| {
            payloads.iter().for_each(&mut show);
            false
        });
    }

    /// Tells whether one of the payloads near the box, as [`Self::visit`] shows them, is what `holds` asks for.
    pub fn any(&self, min: DVec3, max: DVec3, mut holds: impl FnMut(&T) -> bool) -> bool {
        self.find_leaf(min, max, |payloads| payloads.iter().any(&mut holds))
    }

    /// Tells whether the box meets the box of any leaf. `false` is certain; `true` may be a near miss.
    #[inline(always)]
    pub fn touches(&self, min: DVec3, max: DVec3) -> bool {
        self.find_leaf(min, max, |_| true)
    }

    /// Shows the payloads of every leaf whose box meets the given one to `stop`, until that returns true;
    /// tells whether it did.
    #[inline(always)]
    fn find_leaf(&self, min: DVec3, max: DVec3, mut stop: impl FnMut(&[T]) -> bool) -> bool {
        let Some(query) = self.query(min, max) else {
            return false;
        };
        let mut stack = Stack::default();
        self.topmost_met(&query, |index| stack.push_if(true, (index, 0.0)));
        while let Some((index, _)) = stack.pop() {
            let node: &Bvh2Node = &self.nodes[index as usize];
            if node.aabb().intersect_aabb(&query) {
                if node.is_leaf() {
                    if stop(self.leaf(node)) {
                        return true;
                    }
                } else {
                    stack.push_if(true, (node.first_index + 1, 0.0));
                    stack.push_if(true, (node.first_index, 0.0));
                }
            }
        }
        false
    }

    /// Marks which of sixteen boxes meet the box of any leaf, as [`BoxTree::touches`] does for one: those of
    /// neighbouring paths visit nearly the same nodes.
    #[inline(always)]
    pub(crate) fn touched(&self, boxes: &BoxPacket) -> Mask {
        let mut touched = [false; LANES];
        let Some(mut boxes) = self.query_packet(boxes) else {
            return touched;
        };
        let mut stack = Stack::default();
        stack.push_if(true, (0, 0.0));
        while let Some((index, _)) = stack.pop() {
            let node: &Bvh2Node = &self.nodes[index as usize];
            let overlap = boxes.overlap(node.aabb());
            if largest(&overlap) < 0.0 {
                continue;
            }
            if node.is_leaf() {
                for l in 0..LANES {
                    let met = overlap[l] >= 0.0;
                    touched[l] |= met;
                    // Asks no more.
                    boxes.low[0][l] += if met { f32::INFINITY } else { 0.0 };
                }
            } else {
                stack.push_if(true, (node.first_index + 1, 0.0));
                stack.push_if(true, (node.first_index, 0.0));
            }
        }
        touched
    }

    /// Appends the roots of a few subtrees that together hold every leaf whose box meets the given one;
    /// tells whether there are any. Where it is a part of a box of which the roots are known, they are
    /// found below `those`.
    pub(super) fn roots(
        &self,
        (min, max): (DVec3, DVec3),
        those: Option<&[u32]>,
        out: &mut Vec<u32>,
    ) -> bool {
        let Some(query) = self.query(min, max) else {
            return false;
        };
        let first = out.len();
        let meets = |i: &u32| self.nodes[*i as usize].aabb().intersect_aabb(&query);
        match those {
            Some(those) => out.extend(those.iter().filter(|i| meets(i))),
            None => self.topmost_met(&query, |index| out.push(index)),
        }
        // Breadth first: the first that is no leaf gives way to its children that are met.
        let mut at = first;
        while at < out.len() && out.len() - first < MOST_ROOTS {
            let node: &Bvh2Node = &self.nodes[out[at] as usize];
            if node.is_leaf() {
                at += 1;
                continue;
            }
            out.swap_remove(at);
            for child in [node.first_index, node.first_index + 1] {
                if meets(&child) {
                    out.push(child);
                }
            }
        }
        out.len() > first
    }

    /// Shows those of the topmost nodes that meet `query`.
    #[inline(always)]
    fn topmost_met(&self, query: &Aabb, mut show: impl FnMut(u32)) {
        let overlap = self.topmost_boxes.overlap(query);
        let met = self.topmost.iter().zip(overlap);
        for (index, _) in met.filter(|(_, overlap)| *overlap >= 0.0) {
            show(*index);
        }
    }

    /// Shows the payloads of leaves along the chord from `a` to `b` to `leaf`, the nearer first, as far as the place on it
    /// that this returns: where the nearest of them so far is.
    pub(super) fn along_chord(
        &self,
        [a, b]: [DVec3; 2],
        mut leaf: impl FnMut(&[T]) -> Option<f64>,
    ) {
        let Some((start, end)) = self.cut(a, b) else {
            return;
        };
        let ray = TreeRay::new(
            self.tree_point(a.lerp(b, start)),
            self.tree_point(a.lerp(b, end)),
        );
        // The tree sees the cut chord, along which `tau` runs from 0 to 1.
        let length = (end - start).max(f64::MIN_POSITIVE);
        let tau = |t: f64| ((t - start) / length) as f32 + ray.slack;
        // The nearer child first; the far one only if nothing nearer has been met.
        let mut limit = 1.0 + ray.slack;
        let mut stack = Stack::default();
        let mut next = (ray.enter(self.nodes[0].aabb()) <= limit).then_some((0, 0.0));
        while let Some((index, entry)) = next {
            let node: &Bvh2Node = &self.nodes[index as usize];
            if entry <= limit && node.is_leaf() {
                limit = leaf(self.leaf(node)).map_or(limit, tau);
            } else if entry <= limit {
                let children = [node.first_index, node.first_index + 1];
                let [left, right] = children.map(|i| (i, ray.enter(self.nodes[i as usize].aabb())));
                let (near, far) = if left.1 <= right.1 {
                    (left, right)
                } else {
                    (right, left)
                };
                stack.push_if(far.1 <= limit, far);
                stack.push_if(near.1 <= limit, near);
            }
            next = stack.pop();
        }
    }

    /// Returns the payloads of a leaf.
    pub(super) fn leaf(&self, node: &Bvh2Node) -> &[T] {
        &self.leaves[node.first_index as usize..][..node.prim_count as usize]
    }

    /// Returns the part of the chord from `a` to `b` inside the bounds, as its two ends in [0, 1].
    pub(super) fn cut(&self, a: DVec3, b: DVec3) -> Option<(f64, f64)> {
        let (min, max) = self.bounds?;
        let margin = DVec3::splat(f64::from(MARGIN) * self.scale);
        let inverse = (b - a).recip();
        let (to_min, to_max) = ((min - margin - a) * inverse, (max + margin - a) * inverse);
        // A component of `b - a` that is zero gives infinities of unlike sign between the slab's
        // planes and of like sign outside. Exactly on a plane it gives NaN, and is taken to miss:
        // the margin keeps every payload off these planes.
        let (mut start, mut end) = (0.0_f64, 1.0_f64);
        for axis in 0..3 {
            start = start.max(to_min[axis].min(to_max[axis]));
            end = end.min(to_min[axis].max(to_max[axis]));
        }
        (start <= end).then_some((start, end))
    }

    /// Returns the middle of the tree in the chart.
    #[inline(always)]
    pub(super) fn centre(&self) -> DVec3 {
        self.centre
    }

    /// Returns a chart length in tree units.
    #[inline(always)]
    pub(super) fn unit(&self) -> f64 {
        1.0 / self.scale
    }

    /// Converts a chart point to tree coordinates.
    #[inline(always)]
    pub(super) fn tree_point(&self, p: DVec3) -> Vec3 {
        ((p - self.centre) * self.unit()).as_vec3()
    }

    /// Converts a box to tree coordinates, with the margin.
    #[inline(always)]
    fn tree_box(&self, (min, max): (DVec3, DVec3)) -> Aabb {
        let min = Vec3A::from(self.tree_point(min)) - MARGIN;
        Aabb::new(min, Vec3A::from(self.tree_point(max)) + MARGIN)
    }

    /// Returns the part of a box inside the bounds, in tree coordinates; `None` if there is none.
    #[inline(always)]
    fn query(&self, min: DVec3, max: DVec3) -> Option<Aabb> {
        let bounds = self.bounds.filter(|b| boxes_meet(*b, (min, max)))?;
        Some(self.tree_box((min.max(bounds.0), max.min(bounds.1))))
    }

    /// Returns the parts of sixteen boxes inside the bounds, in tree coordinates; `None` if the tree is
    /// empty.
    #[inline(always)]
    fn query_packet(&self, boxes: &BoxPacket) -> Option<BoxPacket> {
        let (least, most) = self.bounds?;
        let unit = self.unit();
        let mut inside = BoxPacket::default();
        for c in 0..3 {
            let (least, most, centre) = (least[c], most[c], self.centre[c]);
            for l in 0..LANES {
                let (low, high) = (f64::from(boxes.low[c][l]), f64::from(boxes.high[c][l]));
                let from = if low > least { low } else { least };
                let to = if high < most { high } else { most };
                let beside = (low > most) | (high < least);
                let inside_out = if beside { f32::INFINITY } else { 0.0 };
                inside.low[c][l] = ((from - centre) * unit) as f32 - MARGIN + inside_out;
                inside.high[c][l] = ((to - centre) * unit) as f32 + MARGIN;
            }
        }
        Some(inside)
    }
}

/// A cut chord in tree coordinates, for slab tests in single precision.
struct TreeRay {
    start: Vec3A,
    inverse: Vec3A,
    /// `MARGIN` as a part of the ray's length.
    slack: f32,
}

impl TreeRay {
    fn new(start: Vec3, end: Vec3) -> Self {
        let way = end - start;
        // A component that is zero would turn 0 · ∞ into NaN; one of 1e-30 moves nothing.
        let safe = |x: f32| {
            if x.abs() < 1e-30 {
                1e-30_f32.copysign(x)
            } else {
                x
            }
        };
        Self {
            start: start.into(),
            inverse: Vec3A::new(safe(way.x), safe(way.y), safe(way.z)).recip(),
            slack: MARGIN / way.length().max(MARGIN),
        }
    }

    /// Returns where the ray enters the box, 0 if it starts inside; infinite if it misses.
    fn enter(&self, b: &Aabb) -> f32 {
        let to_min = (b.min - self.start) * self.inverse;
        let to_max = (b.max - self.start) * self.inverse;
        let enter = to_min.min(to_max).max_element().max(0.0);
        let leave = to_min.max(to_max).min_element();
        if enter <= leave { enter } else { f32::INFINITY }
    }
}

impl BoxPacket {
    /// Computes how far each box and `other` overlap along the axis on which they do least: less than 0 where they do not
    /// meet. A mask would be made number by number in WebAssembly.
    #[inline(always)]
    fn overlap(&self, other: &Aabb) -> SingleLanes {
        let (min, max) = (other.min.to_array(), other.max.to_array());
        let mut overlap = [f32::INFINITY; LANES];
        for c in 0..3 {
            for l in 0..LANES {
                let along = less(max[c] - self.low[c][l], self.high[c][l] - min[c]);
                overlap[l] = less(along, overlap[l]);
            }
        }
        overlap
    }
}

/// Tells whether the point is finite, with room to multiply.
pub(super) fn is_usable(p: DVec3) -> bool {
    p.abs().cmple(DVec3::splat(LARGEST)).all()
}

/// Tells whether two boxes have a point in common.
#[inline(always)]
pub(super) fn boxes_meet(one: (DVec3, DVec3), other: (DVec3, DVec3)) -> bool {
    one.0.cmple(other.1).all() && other.0.cmple(one.1).all()
}

/// Most nodes, from the root on, that one pass puts into better places: large trees gain by those at the top. Without a limit
/// those of a million triangles take 0.3 s of a processor.
const MOST_MOVED: f32 = 10_000.0;

/// Builds obvhs's fast tree step by step: its convenience function does the same, but moves as many nodes as there are
/// and reads the clock. By its medium tree, which takes longer, frames have as many instructions (0.02 % fewer).
fn build_tree(boxes: &[Aabb]) -> SortedBoxes {
    let config = BvhBuildParams::fast_build();
    let mut tree = PlocBuilder::with_capacity(boxes.len()).build(
        config.ploc_search_distance,
        boxes,
        (0..boxes.len() as u32).collect(),
        config.sort_precision,
        config.search_depth_threshold,
    );
    let ratio = MOST_MOVED / tree.nodes.len().max(1) as f32;
    let ratio = config.reinsertion_batch_ratio.min(ratio);
    ReinsertionOptimizer::default().run(&mut tree, ratio, None);
    collapse(
        &mut tree,
        config.max_prims_per_leaf,
        config.collapse_traversal_cost,
    );
    (tree.nodes, tree.primitive_indices)
}

/// Number of nodes that fit the array of a [`Stack`], which is cleared for every question.
const STACK: usize = 32;

/// Nodes still to visit, with the place where the ray enters them. Trees are rarely deeper than the array;
/// the list takes the rest.
pub(super) struct Stack {
    array: [(u32, f32); STACK],
    count: usize,
    rest: Vec<(u32, f32)>,
}

impl Default for Stack {
    fn default() -> Self {
        Self {
            array: [(0, 0.0); STACK],
            count: 0,
            rest: Vec::new(),
        }
    }
}

impl Stack {
    #[inline(always)]
    pub(super) fn push_if(&mut self, wanted: bool, entry: (u32, f32)) {
        match self.array.get_mut(self.count) {
            _ if !wanted => {}
            Some(slot) => {
                *slot = entry;
                self.count += 1;
            }
            None => self.rest.push(entry),
        }
    }

    #[inline(always)]
    pub(super) fn pop(&mut self) -> Option<(u32, f32)> {
        if let Some(entry) = self.rest.pop() {
            return Some(entry);
        }
        self.count = self.count.checked_sub(1)?;
        Some(self.array[self.count])
    }
}
