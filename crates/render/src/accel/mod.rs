//! Finding the triangle that a piece of a path meets first.
//!
//! In: triangles in chart coordinates, then chords `a → b` of paths, or boxes around pieces of
//! curves. Out: the nearest triangle along the chord and where on it ([`ChordHit`]); or whether,
//! and which, triangles have their boxes near.
//!
//! Two precisions: a tree of boxes in single precision ([`BoxTree`]) throws out what is far, and each
//! surviving triangle is tested in double precision on its original vertices. A chord is cut to the
//! tree's box in double precision before it is rounded, so a far camera costs no accuracy. Sixteen
//! neighbouring chords are held against the tree together (`packet`). Triangles that move while light is on its
//! way ([`MovingTriangle`]) have trees of their own.
//!
//! Triangles have holes where the opacity of their material is zero ([`HoledTriangle`]). What is open is not met by
//! anything: not by paths of any tracer, and not by light on its way to a surface.

mod box_tree;
mod moving;
mod packet;

pub use box_tree::BoxTree;
pub use moving::{MovingTriangle, TimedChord};
pub use packet::PacketHits;

use crate::{
    lanes::{BoxPacket, Mask},
    scene::OpacityMap,
};
use box_tree::{MARGIN, Stack, boxes_meet, is_usable};
use glam::DVec3;
use moving::{Meeting, MovingTriangles};

/// A set of triangles, sorted for questions about what a chord or a box meets.
#[derive(Clone, Default)]
pub struct Accelerator {
    triangles: Vec<[DVec3; 3]>,
    tree: BoxTree<LeafTriangle>,
    /// How the last of the triangles move, which are not in the tree.
    moving: MovingTriangles,
    holes: Holes,
}

/// A triangle in a leaf of the tree.
#[derive(Debug, Clone, Copy, Default)]
struct LeafTriangle {
    corners: [DVec3; 3],
    /// Its number in the order given to [`Accelerator::build`].
    number: u32,
    /// Set if it may have holes.
    holed: bool,
}

/// A meeting of a chord and a triangle.
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
        Self::build_all(triangles.to_vec(), Vec::new(), Vec::new())
    }

    /// Sorts the triangles, of which the last ones are `moving`, and some have holes.
    ///
    /// # Panics
    /// As [`Self::build`]; or if more are moving than there are.
    pub fn build_all(
        triangles: Vec<[DVec3; 3]>,
        moving: Vec<MovingTriangle>,
        holed: Vec<HoledTriangle>,
    ) -> Self {
        assert!(
            u32::try_from(triangles.len()).is_ok(),
            "more than 2³² triangles"
        );
        let holes = Holes::new(holed);
        let still = triangles.len() - moving.len();
        let bounds = |number: usize| match triangles[number].iter().all(|p| is_usable(*p)) {
            true => box_of(&triangles[number]),
            false => (DVec3::NAN, DVec3::NAN),
        };
        let leaf = |number: usize| LeafTriangle {
            corners: triangles[number],
            number: number as u32,
            holed: holes.of(number as u32).is_some(),
        };
        let tree = BoxTree::of_boxes(still, bounds, leaf);
        let moving = MovingTriangles::new(moving, still as u32);
        if tree.bounds().is_none() && !moving.any() {
            return Self::default();
        }
        Self {
            triangles,
            tree,
            moving,
            holes,
        }
    }

    /// Returns how a triangle moves, if it does.
    pub fn motion(&self, triangle: u32) -> Option<&MovingTriangle> {
        self.moving.get(triangle)
    }

    /// Tells whether anything moves.
    pub fn moves(&self) -> bool {
        self.moving.any()
    }

    /// Lists the corners of all triangles, of those that move also at both ends of their way.
    pub fn outlines(&self) -> impl Iterator<Item = [DVec3; 3]> {
        let ends = self.moving.all().iter().flat_map(|moving| moving.corners);
        self.triangles.iter().copied().chain(ends)
    }

    /// Returns the corners of a triangle as it is seen at arc length `s`.
    pub fn corners(&self, triangle: u32, s: f64) -> [DVec3; 3] {
        match self.motion(triangle) {
            Some(moving) => moving.corners_at(s),
            None => self.triangles[triangle as usize],
        }
    }

    /// Tells whether a triangle is open where its second and third corner have these weights.
    pub fn is_open(&self, triangle: u32, weights: [f32; 2]) -> bool {
        self.holes.is_open(triangle, weights)
    }

    /// Returns the corners of the box around all usable triangles; `None` if there are none.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        let both = [self.tree.bounds(), self.moving.bounds()];
        let both = both.into_iter().flatten();
        both.reduce(|(a, b), (low, high)| (a.min(low), b.max(high)))
    }

    /// Returns at most `most` boxes that together enclose all usable triangles, and one for each way of what moves.
    pub fn parts(&self, most: usize) -> Vec<(DVec3, DVec3)> {
        let mut parts = self.tree.parts(most);
        parts.extend(self.moving.parts());
        parts
    }

    /// Returns the triangles, in the order given to [`Self::build`], those that move as in the middle of their way;
    /// empty if none was usable.
    pub fn triangles(&self) -> &[[DVec3; 3]] {
        &self.triangles
    }

    /// Finds the first triangle on a chord, from either side. Of several at the same place, the one with the lowest
    /// number.
    pub fn first_hit_on_chord(&self, timed: &TimedChord) -> Option<ChordHit> {
        let [a, b] = timed.ends;
        let chord = Chord::new(a, b)?;
        let mut best: Option<ChordHit> = None;
        self.tree.along_chord([a, b], |leaf| {
            best = self.nearest(best, &chord, leaf.iter().copied());
            best.map(|hit| hit.t)
        });
        match self.moving.any() {
            true => self.moving.first_hit(timed, &self.holes, best),
            false => best,
        }
    }

    /// Tells whether the box meets the box of any leaf. `false` is certain; `true` may be a near miss.
    #[inline(always)]
    pub fn touches(&self, min: DVec3, max: DVec3) -> bool {
        self.tree.touches(min, max) || self.moving.touches(min, max)
    }

    /// Marks which of sixteen boxes meet the box of any leaf, as [`Accelerator::touches`] does for one.
    #[inline(always)]
    pub fn touched(&self, boxes: &BoxPacket) -> Mask {
        let touched = self.tree.touched(boxes);
        match self.moving.any() {
            true => self.moving.touched(boxes, touched),
            false => touched,
        }
    }

    /// Appends the roots of a few subtrees that together hold every leaf whose box meets the given one; tells whether
    /// there are any, or anything that moves is near. Where it is a part of a box of which the roots are known, they
    /// are found below `those`.
    pub fn roots(&self, bounds: (DVec3, DVec3), those: Option<&[u32]>, out: &mut Vec<u32>) -> bool {
        self.tree.roots(bounds, those, out) || self.moving.touches(bounds.0, bounds.1)
    }

    /// Puts into `out`, emptied first, the numbers of all triangles whose boxes meet the box.
    pub fn candidates(&self, min: DVec3, max: DVec3, out: &mut Vec<u32>) {
        out.clear();
        self.tree.visit(min, max, |triangle| {
            if boxes_meet(box_of(&triangle.corners), (min, max)) {
                out.push(triangle.number);
            }
        });
    }

    /// Returns the better of `best` and the nearest hit among the triangles.
    fn nearest(
        &self,
        mut best: Option<ChordHit>,
        chord: &Chord,
        triangles: impl Iterator<Item = LeafTriangle>,
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
}

/// Returns the box around a triangle.
fn box_of([a, b, c]: &[DVec3; 3]) -> (DVec3, DVec3) {
    (a.min(*b).min(*c), a.max(*b).max(*c))
}

/// Margin before its start and past its end, in its own length, in which a chord still hits. Consecutive
/// chords share an end, and rounding (1e-16 times the distance to the triangle) must not let a hit
/// there fall out of both.
const END_MARGIN: f64 = 1e-12;

/// A chord sheared so that it runs along the third axis from 0 to 1.
///
/// The test is the watertight one of Woop, Benthin and Wald (2013): two triangles that share an edge
/// compute the same number for it with opposite sign, so no chord slips between them.
struct Chord {
    start: DVec3,
    axes: [usize; 3],
    shear: DVec3,
}

impl Chord {
    /// Shears a chord; `None` for one without length or with an end that is not finite.
    fn new(a: DVec3, b: DVec3) -> Option<Self> {
        let way = b - a;
        if !is_usable(a) || !is_usable(b) || way == DVec3::ZERO {
            return None;
        }
        let z = way.abs().max_position();
        let axes = [(z + 1) % 3, (z + 2) % 3, z];
        let shear = DVec3::new(way[axes[0]], way[axes[1]], 1.0) / way[z];
        Some(Self {
            start: a,
            axes,
            shear,
        })
    }

    /// Finds where the chord meets the triangle: place on the chord, weights of corners two and three.
    fn meet(&self, corners: &[DVec3; 3]) -> Option<Meeting> {
        let [a, b, c] = corners.map(|p| self.sheared(p));
        let edges = DVec3::new(
            c.x * b.y - c.y * b.x,
            a.x * c.y - a.y * c.x,
            b.x * a.y - b.y * a.x,
        );
        if edges.min_element() < 0.0 && edges.max_element() > 0.0 {
            return None;
        }
        let sum = edges.x + edges.y + edges.z;
        let weights = edges / sum;
        let t = weights.dot(DVec3::new(a.z, b.z, c.z));
        // Seen edge-on the sum is zero and `t` not a number, which no range contains.
        let on_chord = (-END_MARGIN..=1.0 + END_MARGIN).contains(&t);
        on_chord.then(|| (t.clamp(0.0, 1.0), (weights.y, weights.z)))
    }

    fn sheared(&self, p: DVec3) -> DVec3 {
        let p = p - self.start;
        let [x, y, z] = self.axes.map(|axis| p[axis]);
        DVec3::new(x - self.shear.x * z, y - self.shear.y * z, self.shear.z * z)
    }
}

/// Opacities below this are none: half a step of a file with eight bits.
pub const OPEN: f32 = 0.5 / 255.0;

/// A triangle with an opacity map.
#[derive(Debug, Clone)]
pub struct HoledTriangle {
    /// The triangle's number.
    pub triangle: u32,
    /// Texture coordinates at its corners.
    pub uvs: [[f32; 2]; 3],
    /// Its opacity.
    pub map: OpacityMap,
}

impl HoledTriangle {
    /// Returns the opacity where the second and third corner have these weights.
    pub fn opacity(&self, [b, c]: [f32; 2]) -> f32 {
        let [p, q, r] = self.uvs;
        self.map
            .at([0, 1].map(|k| p[k] * (1.0 - b - c) + q[k] * b + r[k] * c))
    }
}

/// All triangles of a set that have opacity maps, by number.
#[derive(Debug, Clone, Default)]
struct Holes(Vec<HoledTriangle>);

impl Holes {
    /// Sorts them.
    fn new(mut all: Vec<HoledTriangle>) -> Self {
        all.sort_by_key(|holed| holed.triangle);
        Self(all)
    }

    /// Returns the opacity map of a triangle, if it has one.
    fn of(&self, triangle: u32) -> Option<&HoledTriangle> {
        let found = self.0.binary_search_by_key(&triangle, |h| h.triangle);
        found.ok().map(|i| &self.0[i])
    }

    /// Tells whether a triangle is open where its second and third corner have these weights.
    #[cold]
    fn is_open(&self, triangle: u32, weights: [f32; 2]) -> bool {
        let holed = self.of(triangle);
        holed.is_some_and(|holed| holed.opacity(weights) < OPEN)
    }
}

#[cfg(test)]
mod tests;
