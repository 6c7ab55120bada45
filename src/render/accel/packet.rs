//! Sixteen chords against the tree at once.
//!
//! In: the chords' ends and the roots of subtrees in which they can hit anything
//! ([`Accelerator::roots`]). Out: [`PacketHits`]. Neighbouring chords visit nearly the same nodes,
//! so a node is fetched once for all of them and every test is one vector instruction for sixteen
//! (boxes, in single precision) or eight (triangles).
//!
//! The triangle test takes the signed volumes of chord and edge (Plücker's form of the watertight
//! test of one chord): two triangles that share an edge compute the same number for it with
//! opposite sign, so no chord slips between them.

use super::{Accelerator, Stack, chord::END_MARGIN};
use crate::render::lanes::{
    LANES, Lanes, Points, SingleLanes, each, each_point, less, more, range,
};
use glam::DVec3;
use obvhs::{aabb::Aabb, bvh2::node::Bvh2Node};

/// Where the chords meet their first triangles.
#[derive(Debug, Clone)]
pub struct PacketHits {
    /// Place on the chord, 0 at its start and 1 at its end; infinite for a miss.
    pub t: Lanes,
    /// The triangle's number.
    pub triangle: [u64; LANES],
    /// Weights of the triangle's second and third corner.
    pub weights: [Lanes; 2],
}

/// Sixteen chords.
struct Chords {
    start: Points,
    way: Points,
    /// 1 over the way in tree coordinates, and the start times that.
    inverse: [SingleLanes; 3],
    start_ways: [SingleLanes; 3],
    /// By how much a place on the chord may be off in single precision.
    slack: [SingleLanes; 3],
}

/// What one slab test in single precision may move a point by, as a share of its distance from the
/// tree's centre plus 1: the six roundings that it takes, and two to spare.
const SLAB_ERROR: f32 = 8.0 * 0.5 * f32::EPSILON;

/// Most subtrees that [`Accelerator::roots`] names: enough to leave out what lies between two
/// objects; more would only be sorted by every packet again.
const MOST_ROOTS: usize = 12;

impl Accelerator {
    /// Appends the roots of a few subtrees that together hold every leaf whose box meets the given
    /// one; whether there are any.
    pub fn roots(&self, min: DVec3, max: DVec3, out: &mut Vec<u32>) -> bool {
        let Some(bounds) = self.bounds.filter(|b| super::boxes_meet(*b, (min, max))) else {
            return false;
        };
        let query = self.tree_box((min.max(bounds.0), max.min(bounds.1)));
        let first = out.len();
        let meets = |i: u32| self.nodes[i as usize].aabb().intersect_aabb(&query);
        if meets(0) {
            out.push(0);
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
            out.extend(
                [node.first_index, node.first_index + 1]
                    .into_iter()
                    .filter(|i| meets(*i)),
            );
        }
        out.len() > first
    }

    /// The first triangle on each chord from `a` to `b` at most at `limit` (negative: nothing is
    /// asked of this lane) below the nodes `roots`.
    #[inline(always)]
    pub fn first_hits(&self, roots: &[u32], a: &Points, b: &Points, limit: &Lanes) -> PacketHits {
        let chords = self.chords(a, b);
        let mut hits = PacketHits {
            t: [f64::INFINITY; LANES],
            triangle: [0; LANES],
            weights: [[0.0; LANES]; 2],
        };
        let mut best = *limit;
        let mut reach = rounded_up(&best);
        let mut stack = Stack::default();
        for root in roots {
            let entered = chords.enter(self.nodes[*root as usize].aabb(), &reach);
            stack.push_if(entered.is_some(), (*root, 0.0));
        }
        let mut met = false;
        while let Some((index, _)) = stack.pop() {
            let node: &Bvh2Node = &self.nodes[index as usize];
            // A node on the stack has been entered, if no nearer triangle has been met since.
            if met && chords.enter(node.aabb(), &reach).is_none() {
                continue;
            }
            if node.is_leaf() {
                for &triangle in self.leaf(node) {
                    if let Some(corners) = self.triangles.get(triangle as usize) {
                        met |= chords.meet(corners, triangle, &mut best, &mut hits);
                    }
                }
                reach = rounded_up(&best);
                continue;
            }
            let children = [node.first_index, node.first_index + 1];
            let [left, right] = children.map(|i| {
                let nearest = chords.enter(self.nodes[i as usize].aabb(), &reach)?;
                Some((nearest, i))
            });
            // The one that is met first is pushed last.
            let order = if left <= right {
                [right, left]
            } else {
                [left, right]
            };
            for (_, child) in order.into_iter().flatten() {
                stack.push_if(true, (child, 0.0));
            }
        }
        hits
    }

    #[inline(always)]
    fn chords(&self, a: &Points, b: &Points) -> Chords {
        let way = each_point(|c, l| b[c][l] - a[c][l]);
        let scale = 1.0 / self.scale;
        let mut inverse = [[0.0; LANES]; 3];
        let (mut start_ways, mut slack) = (inverse, inverse);
        for c in 0..3 {
            for l in 0..LANES {
                let start = ((a[c][l] - self.centre[c]) * scale) as f32;
                let way = (way[c][l] * scale) as f32;
                // A component that is zero would turn 0 · ∞ into NaN; one of 1e-25 moves nothing.
                let way = if way.abs() < 1e-25 { 1e-25 } else { way };
                inverse[c][l] = 1.0 / way;
                start_ways[c][l] = start * inverse[c][l];
                slack[c][l] = SLAB_ERROR * (1.0 + start.abs()) * inverse[c][l].abs();
            }
        }
        Chords {
            start: *a,
            way,
            inverse,
            start_ways,
            slack,
        }
    }
}

impl Chords {
    /// Where the first of the chords enters the box before its `reach`; `None` if none does. The
    /// tree's own margin is in the box already.
    #[inline(always)]
    fn enter(&self, b: &Aabb, reach: &SingleLanes) -> Option<f32> {
        let (min, max) = (b.min.to_array(), b.max.to_array());
        let mut first = [0.0; LANES];
        for l in 0..LANES {
            let (mut enter, mut leave) = (0.0, reach[l]);
            for c in 0..3 {
                let from = min[c] * self.inverse[c][l] - self.start_ways[c][l];
                let to = max[c] * self.inverse[c][l] - self.start_ways[c][l];
                enter = more(less(from, to) - self.slack[c][l], enter);
                leave = less(more(from, to) + self.slack[c][l], leave);
            }
            first[l] = if enter <= leave { enter } else { f32::INFINITY };
        }
        let [nearest, _] = range(&first);
        (nearest < f32::INFINITY).then_some(nearest)
    }

    /// Keeps the triangle where it is nearer than what is known; whether it is anywhere.
    #[inline(always)]
    fn meet(
        &self,
        corners: &[DVec3; 3],
        triangle: u32,
        best: &mut Lanes,
        hits: &mut PacketHits,
    ) -> bool {
        let [a, b, c] = corners.map(|p| each_point(|k, l| p[k] - self.start[k][l]));
        let edges = [
            self.volume(&c, &b),
            self.volume(&a, &c),
            self.volume(&b, &a),
        ];
        let [da, db, dc] = [self.along(&a), self.along(&b), self.along(&c)];
        let squared = self.along(&self.way);
        let mut found = [f64::INFINITY; LANES];
        let mut weights = [[0.0; LANES]; 2];
        for l in 0..LANES {
            let [x, y, z] = [edges[0][l], edges[1][l], edges[2][l]];
            let scale = 1.0 / (x + y + z);
            let (y, z, x) = (y * scale, z * scale, x * scale);
            let t = (x * da[l] + y * db[l] + z * dc[l]) / squared[l];
            // Seen edge-on the weights and `t` are not numbers, and no comparison holds.
            let inside = (x >= 0.0) & (y >= 0.0) & (z >= 0.0);
            let ahead = (t >= -END_MARGIN) & (t <= best[l] + END_MARGIN) & (t < hits.t[l]);
            found[l] = if inside & ahead {
                more(t, 0.0)
            } else {
                f64::INFINITY
            };
            (weights[0][l], weights[1][l]) = (y, z);
        }
        if range(&found)[0] == f64::INFINITY {
            return false;
        }
        for l in 0..LANES {
            if found[l] < f64::INFINITY {
                (best[l], hits.t[l]) = (found[l], found[l]);
                hits.triangle[l] = u64::from(triangle);
                (hits.weights[0][l], hits.weights[1][l]) = (weights[0][l], weights[1][l]);
            }
        }
        true
    }

    /// Six times the signed volume of the chord and the edge from `p` to `q`.
    #[inline(always)]
    fn volume(&self, p: &Points, q: &Points) -> Lanes {
        let [x, y, z] = &self.way;
        each(|l| {
            x[l] * (p[1][l] * q[2][l] - p[2][l] * q[1][l])
                + y[l] * (p[2][l] * q[0][l] - p[0][l] * q[2][l])
                + z[l] * (p[0][l] * q[1][l] - p[1][l] * q[0][l])
        })
    }

    /// The component along the chord times its length.
    #[inline(always)]
    fn along(&self, p: &Points) -> Lanes {
        let [x, y, z] = &self.way;
        each(|l| x[l] * p[0][l] + y[l] * p[1][l] + z[l] * p[2][l])
    }
}

/// Places on chords in single precision, none nearer than it is.
#[inline(always)]
fn rounded_up(places: &Lanes) -> SingleLanes {
    let mut up = [0.0; LANES];
    for l in 0..LANES {
        up[l] = (places[l] + f64::from(f32::EPSILON) * places[l].abs()) as f32;
    }
    up
}
