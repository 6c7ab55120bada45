//! Sixteen chords against the tree at once.
//!
//! In: the chords' ends and the roots of subtrees in which they can hit anything
//! ([`Accelerator::roots`]). Out: [`PacketHits`]. Neighbouring chords visit nearly the same nodes,
//! so a node is fetched once for all of them and every test is one vector instruction for eight.
//!
//! The triangle test takes the signed volumes of chord and edge (Plücker's form of the watertight
//! test of one chord): two triangles that share an edge compute the same number for it with
//! opposite sign, so no chord slips between them.

use super::{Accelerator, Stack, chord::END_MARGIN};
use crate::render::lanes::{LANES, Lanes, Points, each, each_point, less, more, range};
use glam::{DVec3, Vec3A};
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
    /// The start and 1 over the way in tree coordinates.
    tree_start: Points,
    tree_inverse: Points,
}

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
        let mut stack = Stack::default();
        for root in roots {
            stack.push_if(true, (*root, 0.0));
        }
        while let Some((index, _)) = stack.pop() {
            let node: &Bvh2Node = &self.nodes[index as usize];
            if chords.enter(node.aabb(), &best).is_none() {
                continue;
            }
            if node.is_leaf() {
                for &triangle in self.leaf(node) {
                    if let Some(corners) = self.triangles.get(triangle as usize) {
                        chords.meet(corners, triangle, &mut best, &mut hits);
                    }
                }
                continue;
            }
            let children = [node.first_index, node.first_index + 1];
            let [left, right] = children.map(|i| {
                let nearest = chords.enter(self.nodes[i as usize].aabb(), &best)?;
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
        let inverse = 1.0 / self.scale;
        // A component that is zero would turn 0 · ∞ into NaN.
        let safe = |x: f64| if x.abs() < 1e-300 { 1e-300 } else { x };
        Chords {
            start: *a,
            tree_start: each_point(|c, l| (a[c][l] - self.centre[c]) * inverse),
            tree_inverse: each_point(|c, l| 1.0 / safe(way[c][l] * inverse)),
            way,
        }
    }
}

impl Chords {
    /// Where the first of the chords enters the box before its `best`; `None` if none does.
    #[inline(always)]
    fn enter(&self, b: &Aabb, best: &Lanes) -> Option<f64> {
        let (min, max) = (slab(b.min), slab(b.max));
        let mut first = [0.0; LANES];
        for l in 0..LANES {
            let (mut enter, mut leave) = (0.0, best[l]);
            for c in 0..3 {
                let from = (min[c] - self.tree_start[c][l]) * self.tree_inverse[c][l];
                let to = (max[c] - self.tree_start[c][l]) * self.tree_inverse[c][l];
                enter = more(less(from, to), enter);
                leave = less(more(from, to), leave);
            }
            first[l] = if enter <= leave { enter } else { f64::INFINITY };
        }
        let [nearest, _] = range(&first);
        (nearest < f64::INFINITY).then_some(nearest)
    }

    /// Keeps the triangle where it is nearer than what is known.
    #[inline(always)]
    fn meet(&self, corners: &[DVec3; 3], triangle: u32, best: &mut Lanes, hits: &mut PacketHits) {
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
            return;
        }
        for l in 0..LANES {
            if found[l] < f64::INFINITY {
                (best[l], hits.t[l]) = (found[l], found[l]);
                hits.triangle[l] = u64::from(triangle);
                (hits.weights[0][l], hits.weights[1][l]) = (weights[0][l], weights[1][l]);
            }
        }
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

/// A corner of a box; the tree's margin is in it already.
#[inline(always)]
fn slab(corner: Vec3A) -> [f64; 3] {
    corner.to_array().map(f64::from)
}
