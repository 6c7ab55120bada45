//! Sixteen chords against the tree at once.
//!
//! In: the chords' ends and the roots of subtrees in which they can hit anything
//! ([`Accelerator::roots`]). Out: [`PacketHits`]. Neighbouring chords visit nearly the same nodes,
//! so a node is fetched once for all of them and every test is one vector instruction for sixteen, in
//! single precision. All is measured in tree units from a point beside the chords' starts, which
//! triangles are moved to in double precision: rounding then turns a chord by 1e-7, far less than
//! chords depart from paths.
//!
//! The triangle test takes the signed volumes of chord and edge (Plücker's form of the watertight
//! test of one chord): two triangles that share an edge compute the same number for it with
//! opposite sign, so no chord slips between them.

use super::{Accelerator, Holes, MARGIN, Stack, moving::PacketChords};
use crate::{
    lanes::{LANES, SingleLanes, SingleVectors, any, less, more, range, single},
    path_patch::Offsets,
};
use glam::{DVec3, Vec3A};
use obvhs::{aabb::Aabb, bvh2::node::Bvh2Node};

/// Places where sixteen chords meet their first triangles.
#[derive(Debug, Clone)]
#[repr(C, align(64))]
pub struct PacketHits {
    /// Place on the chord, 0 at its start and 1 at its end; infinite for a miss.
    pub t: SingleLanes,
    /// The triangle's number.
    pub triangle: [u32; LANES],
    /// Weights of the triangle's second and third corner.
    pub weights: [SingleLanes; 2],
}

impl Default for PacketHits {
    /// Nothing is met.
    fn default() -> Self {
        Self {
            t: [f32::INFINITY; LANES],
            triangle: [0; LANES],
            weights: [[0.0; LANES]; 2],
        }
    }
}

/// Sixteen chords in tree units.
#[repr(C, align(64))]
struct ChordPacket {
    start: SingleVectors,
    way: SingleVectors,
    /// The squared length of the way, and the margin before its start and past its end in which a hit
    /// counts, as a part of the way.
    squared: SingleLanes,
    margin: SingleLanes,
    /// 1 over the way, and the start in tree coordinates times that.
    inverse: SingleVectors,
    start_ways: SingleVectors,
    /// Bound of the error of a place on the chord in a slab test.
    slack: SingleVectors,
    /// The point that they are measured from, in the chart.
    origin: DVec3,
}

/// Bound of the error of one slab test in single precision, as a share of the point's distance from the
/// tree's centre plus 1: the eight roundings that it takes, and two to spare.
const SLAB_ERROR: f32 = 10.0 * 0.5 * f32::EPSILON;

/// Margin past its ends in which a chord still hits, as a share of its own length and of the tree's, because
/// single precision moves triangles: consecutive chords share an end, and a hit there must not fall out
/// of both. Sixteen roundings.
const END_MARGIN: f32 = 8.0 * f32::EPSILON;

impl Accelerator {
    /// Finds the first triangle on each chord from `a` to `b`, both moved by `shift`, where arc lengths are `s`, at
    /// most at `limit` (negative: nothing is asked of this lane) below the nodes `roots`, and of those that move;
    /// `None` if there are none.
    #[inline(always)]
    pub fn first_hits(
        &self,
        roots: &[u32],
        (ends, s): ([&Offsets; 2], [f64; 2]),
        shift: DVec3,
        limit: &SingleLanes,
    ) -> Option<PacketHits> {
        let still = self.first_still_hits(roots, ends, shift, limit);
        match self.moving.any() {
            true => {
                let chords = PacketChords { ends, s, shift };
                self.moving.first_hits(&chords, &self.holes, limit, still)
            }
            false => still,
        }
    }

    #[inline(always)]
    fn first_still_hits(
        &self,
        roots: &[u32],
        [a, b]: [&Offsets; 2],
        shift: DVec3,
        limit: &SingleLanes,
    ) -> Option<PacketHits> {
        let around = self.around(a, b, shift);
        let meets = |aabb: &Aabb| aabb.intersect_aabb(&around);
        if !roots
            .iter()
            .any(|root| meets(self.tree.nodes[*root as usize].aabb()))
        {
            return None;
        }
        let chords = self.chords(a, b, shift);
        let near = self.box_from(chords.origin, &around);
        let unit = self.tree.unit();
        let mut hits = PacketHits::default();
        let mut reach = *limit;
        let mut stack = Stack::default();
        for root in roots {
            let aabb = self.tree.nodes[*root as usize].aabb();
            let entered = meets(aabb) && chords.enter(aabb, &reach);
            stack.push_if(entered, (*root, 0.0));
        }
        let mut met = false;
        while let Some((index, _)) = stack.pop() {
            let node: &Bvh2Node = &self.tree.nodes[index as usize];
            // A node on the stack has been entered, if no nearer triangle has been met since.
            if met && !chords.enter(node.aabb(), &reach) {
                continue;
            }
            if node.is_leaf() {
                for triangle in self.tree.leaf(node) {
                    let corners = chords.seen_from(&triangle.corners, unit);
                    if near.intersect_aabb(&Aabb::from_points(&corners)) {
                        let holes = triangle.holed.then_some(&self.holes);
                        let number = triangle.number;
                        met |= chords.meet(&corners, number, holes, &mut reach, &mut hits);
                    }
                }
                continue;
            }
            let [left, right] = [node.first_index, node.first_index + 1];
            let boxes = [left, right].map(|i| self.tree.nodes[i as usize].aabb());
            // The one that is met first is pushed last.
            let order = if chords.run_from(boxes[0], boxes[1]) {
                [(right, boxes[1]), (left, boxes[0])]
            } else {
                [(left, boxes[0]), (right, boxes[1])]
            };
            for (child, aabb) in order {
                let entered = meets(aabb) && chords.enter(aabb, &reach);
                stack.push_if(entered, (child, 0.0));
            }
        }
        met.then_some(hits)
    }

    /// Returns the box around the chords in tree coordinates: most nodes are beside all of them, and a
    /// box is met or not by one comparison for sixteen slab tests.
    #[inline(always)]
    fn around(&self, a: &Offsets, b: &Offsets, shift: DVec3) -> Aabb {
        let unit = self.tree.unit();
        let start = (a.middle + shift - self.tree.centre()) * unit;
        let between = (b.middle - a.middle) * unit;
        let (mut min, mut max) = (Vec3A::ZERO, Vec3A::ZERO);
        for c in 0..3 {
            let (start, between, unit) = (start[c] as f32, between[c] as f32, unit as f32);
            let from = single(|l| a.differences[c][l] * unit);
            let to = single(|l| between + b.differences[c][l] * unit);
            let low = range(&single(|l| less(from[l], to[l])))[0];
            let high = range(&single(|l| more(from[l], to[l])))[1];
            (min[c], max[c]) = (start + low, start + high);
        }
        let slack = 2.0 * SLAB_ERROR * (Vec3A::ONE + min.abs().max(max.abs()));
        Aabb::new(min - slack, max + slack)
    }

    /// Measures a box in tree coordinates from the origin of chords, in tree units, with the margin that the
    /// tree's own boxes have.
    #[inline(always)]
    fn box_from(&self, origin: DVec3, around: &Aabb) -> Aabb {
        let base = Vec3A::from(self.tree.tree_point(origin));
        Aabb::new(around.min - base - MARGIN, around.max - base + MARGIN)
    }

    /// Measures the chords from a point beside their starts.
    #[inline(always)]
    fn chords(&self, a: &Offsets, b: &Offsets, shift: DVec3) -> ChordPacket {
        let unit = self.tree.unit();
        let origin = a.middle + shift;
        let (base, between) = (
            (origin - self.tree.centre()) * unit,
            (b.middle - a.middle) * unit,
        );
        let mut chords = ChordPacket {
            origin,
            start: [[0.0; LANES]; 3],
            way: [[0.0; LANES]; 3],
            squared: [0.0; LANES],
            margin: [0.0; LANES],
            inverse: [[0.0; LANES]; 3],
            start_ways: [[0.0; LANES]; 3],
            slack: [[0.0; LANES]; 3],
        };
        for c in 0..3 {
            let (base, between, unit) = (base[c] as f32, between[c] as f32, unit as f32);
            for l in 0..LANES {
                let start = a.differences[c][l] * unit;
                let way = between + (b.differences[c][l] * unit - start);
                // A component that is zero would turn 0 · ∞ into NaN; one of 1e-25 moves nothing.
                let safe = if way.abs() < 1e-25 { 1e-25 } else { way };
                let inverse = 1.0 / safe;
                chords.start[c][l] = start;
                chords.way[c][l] = way;
                chords.squared[l] += way * way;
                chords.inverse[c][l] = inverse;
                chords.start_ways[c][l] = (base + start) * inverse;
                chords.slack[c][l] = SLAB_ERROR * (1.0 + (base + start).abs()) * inverse.abs();
            }
        }
        for l in 0..LANES {
            // The tree is two units long.
            chords.margin[l] = END_MARGIN * (1.0 + 2.0 / chords.squared[l].sqrt());
        }
        chords
    }
}

impl ChordPacket {
    /// Tells whether any of the chords enters the box before its `reach`. The tree's own margin is in the box
    /// already.
    #[inline(always)]
    fn enter(&self, b: &Aabb, reach: &SingleLanes) -> bool {
        let (min, max) = (b.min.to_array(), b.max.to_array());
        let mut entered = [false; LANES];
        for l in 0..LANES {
            let (mut enter, mut leave) = (0.0, reach[l]);
            for c in 0..3 {
                let from = min[c] * self.inverse[c][l] - self.start_ways[c][l];
                let to = max[c] * self.inverse[c][l] - self.start_ways[c][l];
                enter = more(less(from, to) - self.slack[c][l], enter);
                leave = less(more(from, to) + self.slack[c][l], leave);
            }
            entered[l] = enter <= leave;
        }
        any(&entered)
    }

    /// Tells whether the chords, of which one stands for all, run from one box to the other rather than back.
    #[inline(always)]
    fn run_from(&self, from: &Aabb, to: &Aabb) -> bool {
        let way = to.min + to.max - from.min - from.max;
        let along = |c: usize| way[c] * self.way[c][LANES / 2];
        along(0) + along(1) + along(2) >= 0.0
    }

    /// Measures a triangle's corners from the origin, in tree units.
    #[inline(always)]
    fn seen_from(&self, [a, b, c]: &[DVec3; 3], unit: f64) -> [Vec3A; 3] {
        let from_origin = |p: &DVec3| ((*p - self.origin) * unit).as_vec3a();
        [from_origin(a), from_origin(b), from_origin(c)]
    }

    /// Keeps the triangle where it is nearer than what is known; tells whether it is anywhere.
    #[inline(always)]
    fn meet(
        &self,
        [a, b, c]: &[Vec3A; 3],
        triangle: u32,
        holes: Option<&Holes>,
        best: &mut SingleLanes,
        hits: &mut PacketHits,
    ) -> bool {
        let (a, b, c) = (self.offsets(a), self.offsets(b), self.offsets(c));
        let edges = (
            self.volume(&c, &b),
            self.volume(&a, &c),
            self.volume(&b, &a),
        );
        let mut inside = [false; LANES];
        for l in 0..LANES {
            let (x, y, z) = (edges.0[l], edges.1[l], edges.2[l]);
            inside[l] = (less(less(x, y), z) >= 0.0) | (more(more(x, y), z) <= 0.0);
        }
        // Most triangles are beside all chords.
        if !any(&inside) {
            return false;
        }
        let ahead = (self.along(&a), self.along(&b), self.along(&c));
        let mut found = [f32::INFINITY; LANES];
        let mut weights = [[0.0; LANES]; 2];
        for l in 0..LANES {
            let (x, y, z) = (edges.0[l], edges.1[l], edges.2[l]);
            let scale = 1.0 / (x + y + z);
            let (y, z, x) = (y * scale, z * scale, x * scale);
            let t = (x * ahead.0[l] + y * ahead.1[l] + z * ahead.2[l]) / self.squared[l];
            // Seen edge-on the weights and `t` are not numbers, and no comparison holds.
            let within = (t >= -self.margin[l]) & (t <= best[l] + self.margin[l]);
            found[l] = if inside[l] & within & (t < hits.t[l]) {
                more(t, 0.0)
            } else {
                f32::INFINITY
            };
            (weights[0][l], weights[1][l]) = (y, z);
        }
        if let Some(holes) = holes {
            miss_holes(holes, triangle, &weights, &mut found);
        }
        if range(&found)[0] == f32::INFINITY {
            return false;
        }
        for l in 0..LANES {
            let nearer = found[l] < f32::INFINITY;
            best[l] = if nearer { found[l] } else { best[l] };
            hits.t[l] = if nearer { found[l] } else { hits.t[l] };
            hits.triangle[l] = if nearer { triangle } else { hits.triangle[l] };
            for k in 0..2 {
                hits.weights[k][l] = if nearer {
                    weights[k][l]
                } else {
                    hits.weights[k][l]
                };
            }
        }
        true
    }

    /// Returns a point's offsets from the chords' starts.
    #[inline(always)]
    fn offsets(&self, p: &Vec3A) -> SingleVectors {
        let p = p.to_array();
        let from = |c: usize| single(|l| p[c] - self.start[c][l]);
        [from(0), from(1), from(2)]
    }

    /// Returns six times the signed volume of the chord and the edge from `p` to `q`.
    #[inline(always)]
    fn volume(&self, p: &SingleVectors, q: &SingleVectors) -> SingleLanes {
        let [x, y, z] = &self.way;
        single(|l| {
            x[l] * (p[1][l] * q[2][l] - p[2][l] * q[1][l])
                + y[l] * (p[2][l] * q[0][l] - p[0][l] * q[2][l])
                + z[l] * (p[0][l] * q[1][l] - p[1][l] * q[0][l])
        })
    }

    /// Returns the component along the chord times its length.
    #[inline(always)]
    fn along(&self, p: &SingleVectors) -> SingleLanes {
        let [x, y, z] = &self.way;
        single(|l| x[l] * p[0][l] + y[l] * p[1][l] + z[l] * p[2][l])
    }
}

/// Takes back what was found where the triangle is open.
#[cold]
fn miss_holes(holes: &Holes, triangle: u32, weights: &[SingleLanes; 2], found: &mut SingleLanes) {
    for l in 0..LANES {
        if found[l] < f32::INFINITY && holes.is_open(triangle, [weights[0][l], weights[1][l]]) {
            found[l] = f32::INFINITY;
        }
    }
}
