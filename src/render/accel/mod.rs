//! Finding the triangle that a piece of a path meets first.
//!
//! In: triangles in chart coordinates, then chords `a → b` of paths, or boxes around pieces of
//! curves. Out: the nearest triangle along the chord and where on it ([`ChordHit`]); or whether,
//! and which, triangles have their boxes near.
//!
//! Two precisions: a tree of boxes in single precision throws out what is far, and each surviving
//! triangle is tested in double precision on its original vertices. The tree lives in *tree
//! coordinates*, the chart moved and scaled so that all triangles fit in [-1, 1]³: an absolute
//! margin then means the same for an object 1e-3 large as for one 100 large. A chord is cut to the
//! tree's box in double precision before it is rounded, so a far camera costs no accuracy.

mod boxes;
mod chord;
mod holes;
mod packet;
mod stack;
mod top;

pub use holes::{Holed, OPEN};
pub use packet::PacketHits;

use chord::{Chord, is_usable};
use glam::{DVec3, Vec3, Vec3A};
use holes::Holes;
use obvhs::{
    BvhBuildParams,
    aabb::Aabb,
    bvh2::{Bvh2, leaf_collapser::collapse, node::Bvh2Node, reinsertion::ReinsertionOptimizer},
    ploc::PlocBuilder,
};
use stack::Stack;
use top::Top;

/// Margin of every box in tree coordinates. Rounding a point of [-1, 1]³ to single precision and
/// one slab test move it by at most 5e-7; a wider margin only lets more triangles through.
const MARGIN: f32 = 2e-6;

/// A set of triangles, sorted for questions about what a chord or a box meets.
#[derive(Clone, Default)]
pub struct Accelerator {
    triangles: Vec<[DVec3; 3]>,
    /// The tree; its leaves name ranges of `leaves`.
    nodes: Vec<Bvh2Node>,
    /// The triangles again, in the order of the leaves.
    leaves: Vec<Numbered>,
    holes: Holes,
    top: Top,
    /// Corners of the box around all triangles.
    bounds: Option<(DVec3, DVec3)>,
    /// Tree coordinates are `(u - centre) / scale`.
    centre: DVec3,
    scale: f64,
}

/// A triangle as it is found in a leaf. Those of a leaf lie side by side, because getting them from all
/// over memory took longer than to hold chords against them.
#[derive(Debug, Clone, Copy)]
struct Numbered {
    corners: [DVec3; 3],
    /// Its number in the order given to [`Accelerator::build`].
    number: u32,
    /// Whether it may have holes.
    holed: bool,
}

/// Where a chord meets a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChordHit {
    /// Place on the chord: 0 at its start, 1 at its end.
    pub t: f64,
    /// The triangle's number in the order given to [`Accelerator::build`].
    pub triangle: u32,
    /// Weights of the triangle's second and third corner; the first has `1 - u - v`.
    pub barycentric: (f64, f64),
}

impl Accelerator {
    /// Sorts the triangles; one with a coordinate that is not finite is never met.
    ///
    /// # Panics
    /// If there are more than `u32::MAX` triangles.
    pub fn build(triangles: &[[DVec3; 3]]) -> Self {
        assert!(
            u32::try_from(triangles.len()).is_ok(),
            "more than 2³² triangles"
        );
        let usable = |i: &u32| triangles[*i as usize].iter().all(|p| is_usable(*p));
        let usable: Vec<u32> = (0..triangles.len() as u32).filter(usable).collect();
        let corners = usable.iter().flat_map(|i| triangles[*i as usize]);
        let bounds = corners.fold(None, |bounds, p| match bounds {
            None => Some((p, p)),
            Some((min, max)) => Some((p.min(min), p.max(max))),
        });
        let Some((min, max)) = bounds else {
            return Self::default();
        };
        let extent = (max - min).max_element() / 2.0;
        let mut built = Self {
            triangles: triangles.to_vec(),
            bounds,
            centre: (min + max) / 2.0,
            // A set without extent is a point; any scale does.
            scale: if extent > 0.0 { extent } else { 1.0 },
            ..Self::default()
        };
        let boxes: Vec<Aabb> = usable
            .iter()
            .map(|i| built.tree_box(box_of(&triangles[*i as usize])))
            .collect();
        let tree = build_tree(&boxes);
        let numbered = |slot: u32| {
            let number = usable[slot as usize];
            let corners = triangles[number as usize];
            Numbered {
                corners,
                number,
                holed: false,
            }
        };
        built.leaves = tree.primitive_indices.into_iter().map(numbered).collect();
        built.nodes = tree.nodes;
        built.top = Top::of(&built.nodes);
        built
    }

    /// The same triangles, of which some have holes.
    pub fn with_holes(mut self, holed: Vec<Holed>) -> Self {
        self.holes = Holes::new(holed);
        for triangle in &mut self.leaves {
            triangle.holed = self.holes.of(triangle.number).is_some();
        }
        self
    }

    /// Whether a triangle is open where its second and third corner have these weights.
    pub fn is_open(&self, triangle: u32, weights: [f32; 2]) -> bool {
        self.holes.is_open(triangle, weights)
    }

    /// Corners of the box around all usable triangles; `None` if there are none.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        self.bounds
    }

    /// The triangles, in the order given to [`Self::build`]; empty if none was usable.
    pub fn triangles(&self) -> &[[DVec3; 3]] {
        &self.triangles
    }

    /// The first triangle on the chord from `a` to `b`, from either side. Of several at the same
    /// place, the one with the lowest number.
    pub fn first_hit_on_chord(&self, a: DVec3, b: DVec3) -> Option<ChordHit> {
        let chord = Chord::new(a, b)?;
        let (start, end) = self.cut(a, b)?;
        let ray = TreeRay::new(
            self.tree_point(a.lerp(b, start)),
            self.tree_point(a.lerp(b, end)),
        );
        // The tree sees the cut chord, along which `tau` runs from 0 to 1.
        let length = (end - start).max(f64::MIN_POSITIVE);
        let tau = |t: f64| ((t - start) / length) as f32 + ray.slack;
        let mut best: Option<ChordHit> = None;
        let mut limit = 1.0 + ray.slack;
        let mut stack = Stack::default();
        let mut next = (ray.enter(self.nodes[0].aabb()) <= limit).then_some((0, 0.0));
        while let Some((index, entry)) = next {
            let node: &Bvh2Node = &self.nodes[index as usize];
            if entry <= limit && node.is_leaf() {
                best = self.nearest(best, &chord, self.leaf(node).iter().copied());
                limit = best.map_or(limit, |hit| tau(hit.t));
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
        best
    }

    /// The same as [`Self::first_hit_on_chord`] among the triangles numbered in `candidates` only.
    pub fn first_hit_among(&self, candidates: &[u32], a: DVec3, b: DVec3) -> Option<ChordHit> {
        let numbered = |&number: &u32| {
            Some(Numbered {
                corners: *self.triangles.get(number as usize)?,
                number,
                holed: self.holes.of(number).is_some(),
            })
        };
        let candidates = candidates.iter().filter_map(numbered);
        self.nearest(None, &Chord::new(a, b)?, candidates)
    }

    /// Whether the box meets the box of any leaf. `false` is certain; `true` may be a near miss.
    #[inline(always)]
    pub fn touches(&self, min: DVec3, max: DVec3) -> bool {
        self.visit_leaves(min, max, |_| true)
    }

    /// Puts into `out`, emptied first, the numbers of all triangles whose boxes meet the box.
    pub fn candidates(&self, min: DVec3, max: DVec3, out: &mut Vec<u32>) {
        out.clear();
        self.visit_leaves(min, max, |node| {
            let meets = |t: &&Numbered| boxes_meet(box_of(&t.corners), (min, max));
            out.extend(self.leaf(node).iter().filter(meets).map(|t| t.number));
            false
        });
    }

    /// Shows every leaf whose box meets the given one to `stop`, until that says so; returns
    /// whether it did.
    #[inline(always)]
    fn visit_leaves(
        &self,
        min: DVec3,
        max: DVec3,
        mut stop: impl FnMut(&Bvh2Node) -> bool,
    ) -> bool {
        let Some(bounds) = self.bounds else {
            return false;
        };
        if !boxes_meet(bounds, (min, max)) {
            return false;
        }
        let query = self.tree_box((min.max(bounds.0), max.min(bounds.1)));
        let mut stack = Stack::default();
        self.top
            .met(&query, |index| stack.push_if(true, (index, 0.0)));
        let mut next = stack.pop();
        while let Some((index, _)) = next {
            let node: &Bvh2Node = &self.nodes[index as usize];
            if node.aabb().intersect_aabb(&query) {
                if node.is_leaf() {
                    if stop(node) {
                        return true;
                    }
                } else {
                    stack.push_if(true, (node.first_index + 1, 0.0));
                    stack.push_if(true, (node.first_index, 0.0));
                }
            }
            next = stack.pop();
        }
        false
    }

    /// The better of `best` and the nearest hit among the triangles.
    fn nearest(
        &self,
        mut best: Option<ChordHit>,
        chord: &Chord,
        triangles: impl Iterator<Item = Numbered>,
    ) -> Option<ChordHit> {
        for triangle in triangles {
            let Some((t, barycentric)) = chord.meet(&triangle.corners) else {
                continue;
            };
            let weights = || [barycentric.0 as f32, barycentric.1 as f32];
            if best.is_none_or(|b| (t, triangle.number) < (b.t, b.triangle))
                && !(triangle.holed && self.is_open(triangle.number, weights()))
            {
                best = Some(ChordHit {
                    t,
                    triangle: triangle.number,
                    barycentric,
                });
            }
        }
        best
    }

    fn leaf(&self, node: &Bvh2Node) -> &[Numbered] {
        &self.leaves[node.first_index as usize..][..node.prim_count as usize]
    }

    /// The part of the chord inside the bounds, as its two ends in [0, 1].
    fn cut(&self, a: DVec3, b: DVec3) -> Option<(f64, f64)> {
        let (min, max) = self.bounds?;
        let margin = DVec3::splat(f64::from(MARGIN) * self.scale);
        let inverse = (b - a).recip();
        let (to_min, to_max) = ((min - margin - a) * inverse, (max + margin - a) * inverse);
        // A component of `b - a` that is zero gives infinities of unlike sign between the slab's
        // planes and of like sign outside. Exactly on a plane it gives NaN, and is taken to miss:
        // the margin keeps every triangle off these planes.
        let (mut start, mut end) = (0.0_f64, 1.0_f64);
        for axis in 0..3 {
            start = start.max(to_min[axis].min(to_max[axis]));
            end = end.min(to_min[axis].max(to_max[axis]));
        }
        (start <= end).then_some((start, end))
    }

    /// A chart length in tree units.
    #[inline(always)]
    fn unit(&self) -> f64 {
        1.0 / self.scale
    }

    #[inline(always)]
    fn tree_point(&self, p: DVec3) -> Vec3 {
        ((p - self.centre) * self.unit()).as_vec3()
    }

    #[inline(always)]
    fn tree_box(&self, (min, max): (DVec3, DVec3)) -> Aabb {
        let min = Vec3A::from(self.tree_point(min)) - MARGIN;
        Aabb::new(min, Vec3A::from(self.tree_point(max)) + MARGIN)
    }
}

/// obvhs's medium build, step by step: its convenience function does the same but reads the clock.
fn build_tree(boxes: &[Aabb]) -> Bvh2 {
    let config = BvhBuildParams::medium_build();
    let mut tree = PlocBuilder::with_capacity(boxes.len()).build(
        config.ploc_search_distance,
        boxes,
        (0..boxes.len() as u32).collect(),
        config.sort_precision,
        config.search_depth_threshold,
    );
    let mut optimizer = ReinsertionOptimizer::default();
    optimizer.run(&mut tree, config.reinsertion_batch_ratio, None);
    collapse(
        &mut tree,
        config.max_prims_per_leaf,
        config.collapse_traversal_cost,
    );
    let again = config.post_collapse_reinsertion_batch_ratio_multiplier;
    optimizer.run(&mut tree, config.reinsertion_batch_ratio * again, None);
    tree
}

fn box_of([a, b, c]: &[DVec3; 3]) -> (DVec3, DVec3) {
    (a.min(*b).min(*c), a.max(*b).max(*c))
}

#[inline(always)]
fn boxes_meet(one: (DVec3, DVec3), other: (DVec3, DVec3)) -> bool {
    one.0.cmple(other.1).all() && other.0.cmple(one.1).all()
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

    /// Where the ray enters the box, 0 if it starts inside; infinite if it misses.
    fn enter(&self, b: &Aabb) -> f32 {
        let to_min = (b.min - self.start) * self.inverse;
        let to_max = (b.max - self.start) * self.inverse;
        let enter = to_min.min(to_max).max_element().max(0.0);
        let leave = to_min.max(to_max).min_element();
        if enter <= leave { enter } else { f32::INFINITY }
    }
}

#[cfg(test)]
mod tests;
