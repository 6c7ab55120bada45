//! Faces with any number of corners to triangles.
//!
//! In: the corners of a face, in order. Out: triangles that cover it once and turn the same way, and whether that is
//! possible: not where a face crosses itself, so that its inside is not known. A convex face is cut from its first
//! corner; any other by clipping ears (crate `earcut`) in its own plane, which is across its Newell normal: half the
//! sum of `pᵢ × pᵢ₊₁` is the area vector whether or not the corners lie in a plane (M. Newell; see I. Sutherland, R.
//! Sproull, R. Schumacker, *A characterization of ten hidden-surface algorithms*, 1974).

use earcut::Earcut;
use glam::{DVec2, DVec3};
use std::collections::HashMap;

/// Corners of a triangle as numbers of the face's corners.
type Triangle = [u32; 3];

/// An area is none where it is below this share of the square of the face's size: rounding leaves
/// 1e-16 of that, and a sliver of 1e-9 of the width is nothing to be seen.
const FLAT: f64 = 1e-12;

/// The triangles' areas may add up to the face's but for this share, which is far more than rounding
/// and far less than any lobe that can be seen.
const AREA_ERROR: f64 = 1e-6;

/// Most corners of a face that is cut by its ears: the crate counts its memory in 32 bits.
const MOST_CORNERS: usize = 1 << 24;

/// Cuts faces; keeps its memory from one to the next.
#[derive(Default)]
pub(super) struct Cutter {
    ears: Earcut<f64>,
    plane: Vec<[f64; 2]>,
    found: Vec<u32>,
}

impl Cutter {
    /// Puts the triangles of the face with these corners into `triangles`, emptied first; tells whether they cover it once.
    pub(super) fn cut(&mut self, corners: &[DVec3], triangles: &mut Vec<Triangle>) -> bool {
        triangles.clear();
        if corners.len() == 3 {
            triangles.push([0, 1, 2]);
            return true;
        }
        let face = ScaledPolygon::new(corners);
        if face.doubled_area.length() <= FLAT || corners.len() > MOST_CORNERS {
            fan(corners.len(), triangles);
            return face.is_covered_by(triangles);
        }
        if face.is_convex() {
            fan(corners.len(), triangles);
            return true;
        }
        self.clip(&face, triangles);
        let covered = face.is_covered_by(triangles);
        if covered {
            insert_skipped(corners.len(), triangles);
        }
        covered
    }

    /// Clips the ears of a face.
    fn clip(&mut self, face: &ScaledPolygon, triangles: &mut Vec<Triangle>) {
        self.plane.clear();
        self.plane.extend(face.plane().map(|p| p.to_array()));
        let flat = self.plane.iter().copied();
        self.ears.earcut(flat, &[], &mut self.found);
        for corners in self.found.chunks_exact(3) {
            let [a, b, c] = [corners[0], corners[1], corners[2]];
            let at = [a, b, c].map(|i| DVec2::from_array(self.plane[i as usize]));
            let turned = (at[1] - at[0]).perp_dot(at[2] - at[0]) < 0.0;
            triangles.push(if turned { [a, c, b] } else { [a, b, c] });
        }
    }
}

/// Makes all triangles from the first corner.
fn fan(corners: usize, triangles: &mut Vec<Triangle>) {
    triangles.extend((2..corners as u32).map(|k| [0, k - 1, k]));
}

/// A face moved and scaled to be one unit large at its first corner.
struct ScaledPolygon {
    corners: Vec<DVec3>,
    /// The Newell normal: twice the area long.
    doubled_area: DVec3,
}

impl ScaledPolygon {
    fn new(corners: &[DVec3]) -> Self {
        let first = corners[0];
        let from_first = corners.iter().map(|p| (*p - first).abs().max_element());
        let size = from_first.fold(0.0, f64::max);
        // A size that is no number, or none, leaves nothing to cut.
        let size = if size > 0.0 { size } else { 1.0 };
        let corners: Vec<DVec3> = corners.iter().map(|p| (*p - first) / size).collect();
        let pairs = corners.iter().zip(corners.iter().skip(1));
        let doubled_area: DVec3 = pairs.map(|(p, q)| p.cross(*q)).sum();
        let usable = doubled_area.is_finite();
        Self {
            corners,
            doubled_area: if usable { doubled_area } else { DVec3::ZERO },
        }
    }

    /// Tells whether all corners turn the same way, once around in all, and none is straight.
    fn is_convex(&self) -> bool {
        let n = self.corners.len();
        let normal = self.doubled_area.normalize();
        let side = |i: usize| self.corners[(i + 1) % n] - self.corners[i % n];
        let mut turn = 0.0;
        for i in 0..n {
            let (before, after) = (side(i), side(i + 1));
            let across = before.cross(after).dot(normal);
            if !(across > FLAT) {
                return false;
            }
            turn += across.atan2(before.dot(after));
        }
        // A star of five points turns twice around.
        turn < 1.5 * std::f64::consts::TAU
    }

    /// Returns the corners in the plane across the normal, which turn against the clock there.
    fn plane(&self) -> impl Iterator<Item = DVec2> {
        let (x, y) = self.doubled_area.normalize().any_orthonormal_pair();
        self.corners
            .iter()
            .map(move |p| DVec2::new(p.dot(x), p.dot(y)))
    }

    /// Tells whether the triangles have the area of the face, as they do if they cover it once.
    fn is_covered_by(&self, triangles: &[Triangle]) -> bool {
        let normal = self.doubled_area.normalize_or_zero();
        let doubled = |t: &Triangle| {
            let [a, b, c] = t.map(|i| self.corners[i as usize]);
            let across = (b - a).cross(c - a);
            match normal == DVec3::ZERO {
                true => across.length(),
                false => across.dot(normal).abs(),
            }
        };
        let covered: f64 = triangles.iter().map(doubled).sum();
        let area = self.doubled_area.length();
        (covered - area).abs() <= AREA_ERROR * area.max(AREA_ERROR)
    }
}

/// Puts back corners that are in no triangle because they lie on a straight side: the face beyond
/// that side may have them, and the two must not come apart where a side is bent.
fn insert_skipped(corners: usize, triangles: &mut Vec<Triangle>) {
    let mut used = vec![false; corners];
    for i in triangles.iter().flatten() {
        used[*i as usize] = true;
    }
    let Some(start) = used.iter().position(|used| *used) else {
        return;
    };
    let mut sides = HashMap::new();
    let mut from = start;
    for step in 1..=corners {
        let to = (start + step) % corners;
        if !used[to] {
            continue;
        }
        let skipped = (to + corners - from - 1) % corners;
        if skipped > 0 {
            if sides.is_empty() {
                sides = sides_of(triangles);
            }
            let between = (1..=skipped).map(|k| ((from + k) % corners) as u32);
            split_side([from as u32, to as u32], between, (triangles, &mut sides));
        }
        from = to;
    }
}

/// Triangles by their sides, each from one corner to the next.
type Sides = HashMap<[u32; 2], usize>;

fn sides_of(triangles: &[Triangle]) -> Sides {
    let numbered = triangles.iter().enumerate();
    let sides = numbered.flat_map(|(i, &[a, b, c])| [([a, b], i), ([b, c], i), ([c, a], i)]);
    sides.collect()
}

/// Cuts the triangle at a side by the points on it.
fn split_side(
    [from, to]: [u32; 2],
    between: impl Iterator<Item = u32>,
    (triangles, sides): (&mut Vec<Triangle>, &mut Sides),
) {
    let Some(&index) = sides.get(&[from, to]) else {
        return;
    };
    let Some(tip) = triangles[index]
        .into_iter()
        .find(|c| ![from, to].contains(c))
    else {
        return;
    };
    let mut last = from;
    for point in between {
        // The side of the first part that the triangle had.
        if last == from {
            sides.insert([tip, from], triangles.len());
        }
        triangles.push([tip, last, point]);
        last = point;
    }
    triangles[index] = [tip, last, to];
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cut(corners: &[DVec3]) -> (Vec<Triangle>, bool) {
        let mut triangles = Vec::new();
        let covered = Cutter::default().cut(corners, &mut triangles);
        (triangles, covered)
    }

    fn flat(corners: &[[f64; 2]]) -> Vec<DVec3> {
        // A plane that is along no axis.
        let (x, y) = (DVec3::new(0.8, 0.0, 0.6), DVec3::new(0.36, 0.8, -0.48));
        let place = |p: &[f64; 2]| DVec3::new(5.0, -3.0, 2.0) + x * p[0] + y * p[1];
        corners.iter().map(place).collect()
    }

    fn area(corners: &[DVec3], triangles: &[Triangle]) -> f64 {
        let doubled = |t: &Triangle| {
            let [a, b, c] = t.map(|i| corners[i as usize]);
            (b - a).cross(c - a).length()
        };
        0.5 * triangles.iter().map(doubled).sum::<f64>()
    }

    #[test]
    fn an_l_keeps_its_area_from_whichever_corner_it_begins_and_whichever_way_it_turns() {
        let l = [
            [-1.0, -1.0],
            [1.0, -1.0],
            [1.0, 1.0],
            [0.8, 1.0],
            [0.8, -0.8],
            [-1.0, -0.8],
        ];
        for first in 0..6 {
            for backwards in [false, true] {
                let mut turned = l;
                turned.rotate_left(first);
                if backwards {
                    turned.reverse();
                }
                let corners = flat(&turned);
                let (triangles, covered) = cut(&corners);
                assert!(covered);
                assert!((area(&corners, &triangles) - 0.76).abs() < 1e-12);
                let normal = ScaledPolygon::new(&corners).doubled_area;
                for t in triangles {
                    let [a, b, c] = t.map(|i| corners[i as usize]);
                    assert!((b - a).cross(c - a).dot(normal) > 0.0);
                }
            }
        }
    }

    #[test]
    fn a_comb_far_from_the_origin_keeps_its_area() {
        let teeth = 40;
        let mut outline = vec![[f64::from(teeth), -1.0], [f64::from(teeth), 0.0]];
        for k in (0..teeth).rev() {
            outline.push([f64::from(k) + 0.5, 3.0]);
            outline.push([f64::from(k), 0.0]);
        }
        outline.push([0.0, -1.0]);
        let corners: Vec<DVec3> = flat(&outline).iter().map(|p| *p + 4e6).collect();
        let (triangles, covered) = cut(&corners);
        assert!(covered);
        let known = f64::from(teeth) * (1.0 + 1.5);
        assert!((area(&corners, &triangles) / known - 1.0).abs() < 1e-8);
    }

    #[test]
    fn corners_on_straight_sides_stay_corners_of_triangles() {
        let corners = flat(&[
            [0.0, 0.0],
            [1.0, 0.0],
            [2.0, 0.0],
            [3.0, 0.0],
            [3.0, 1.0],
            [0.0, 1.0],
        ]);
        for first in 0..6 {
            let mut turned = corners.clone();
            turned.rotate_left(first);
            let (triangles, covered) = cut(&turned);
            assert_eq!((covered, triangles.len()), (true, 4));
            assert!((area(&turned, &triangles) - 3.0).abs() < 1e-12);
            assert!((0..6).all(|i| triangles.iter().flatten().any(|c| *c == i)));
        }
    }

    #[test]
    fn a_hole_on_a_bridge_is_left_open() {
        let ring = [
            [0.0, 0.0],
            [3.0, 0.0],
            [3.0, 3.0],
            [0.0, 3.0],
            [0.0, 0.0],
            [1.0, 1.0],
            [1.0, 2.0],
            [2.0, 2.0],
            [2.0, 1.0],
            [1.0, 1.0],
        ];
        let corners = flat(&ring);
        let (triangles, covered) = cut(&corners);
        assert!(covered);
        assert!((area(&corners, &triangles) - 8.0).abs() < 1e-12);
    }

    #[test]
    fn outlines_that_cross_themselves_are_noticed() {
        let star = |k: usize| {
            let angle = std::f64::consts::TAU * (2 * k) as f64 / 5.0;
            [angle.cos(), angle.sin()]
        };
        let bow_tie = [[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]];
        let uneven = [[0.0, 0.0], [2.0, 2.0], [2.0, 0.0], [0.0, 1.0]];
        let star = [star(0), star(1), star(2), star(3), star(4)];
        for corners in [&bow_tie[..], &uneven, &star] {
            assert!(!cut(&flat(corners)).1, "{corners:?}");
        }
    }

    #[test]
    fn faces_without_area_or_with_absurd_corners_do_not_stop_it() {
        let line = flat(&[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]]);
        assert!(cut(&line).1);
        assert_eq!(cut(&[DVec3::ONE; 5]).0.len(), 3);
        let far = [DVec3::MAX, DVec3::MIN, DVec3::X, DVec3::Y, DVec3::Z];
        let _ = cut(&far);
        let _ = cut(&[DVec3::ZERO, DVec3::X * 1e-320, DVec3::Y * 1e-310, DVec3::Z]);
    }
}
