//! How finely the directions of a lamp's light are divided.
//!
//! In: a [`LightFan`] whose arc lengths are chosen. Out: its rays, and the triangles between them: fine where rays diverge
//! or fold and come to where connections are asked for.

use crate::{
    light_fan::LightFan,
    ray_leg::{KNOTS_BEYOND, RayKnot, RayLeg, Region, common, holds, meet},
};
use glam::DVec3;
use std::collections::HashMap;

/// Halvings of the icosahedron's edges before rays are compared: 162 rays, 16° apart.
const FIRST_LEVEL: usize = 2;

/// Most halvings: directions 0.5° apart. Light that needs finer ones (that has circled a black hole)
/// has spread over so much area that nobody sees it.
const LAST_LEVEL: usize = 7;

/// Most halvings because rays fold or end at different places: directions 2° apart. Such halving has
/// no natural end, because the edges of caustics and shadows cross triangles of any size.
const LAST_EDGE_LEVEL: usize = 5;

/// Most halvings because rays meet different borders: directions 1° apart. Light that goes its own way between
/// narrower ones is faint.
const LAST_PARTED_LEVEL: usize = 6;

/// Most halvings where rays may come to the one point for which all geodesics are asked for: directions 0.005° apart.
const POINT_LEVEL: usize = 14;

/// How much wider than a triangle what may come to that point is looked for: near light that circles for ever, rays part faster
/// than their deviations tell.
const WIDER: f64 = 6.0;

/// Rays of one fan beyond which it is refined no further, for its memory: about 5 kB each.
const MOST_RAYS: usize = 12_000;
const POINT_RAYS: usize = 30_000;

/// A triangle of rays is fine enough if the ray through the middle of each edge lies within this
/// share of the edge from where interpolation puts it. Guesses are then so close that two or three
/// steps of Newton's method finish them; twice the share costs one step more, half of it four times
/// the rays.
pub(super) const BEND: f64 = 0.08;

impl LightFan<'_> {
    /// Traces rays over finer and finer triangles; returns the triangles by the numbers of their rays.
    pub(super) fn refine(&mut self) -> Vec<[usize; 3]> {
        let corners = icosahedron_corners();
        self.add(&corners);
        let mut open = icosahedron_faces(&corners);
        let mut middles: HashMap<[usize; 2], usize> = HashMap::new();
        let mut done = Vec::new();
        let (last_level, most_rays) = match self.target {
            Some(_) => (POINT_LEVEL, POINT_RAYS),
            None => (LAST_LEVEL, MOST_RAYS),
        };
        for level in 1..=last_level {
            self.trace_middles(&open, &mut middles);
            let full = self.rays.len() > most_rays;
            let mut next = Vec::new();
            for triangle in open {
                let children = children(triangle, &middles);
                let fine = level > FIRST_LEVEL && self.is_fine(triangle, &middles, level);
                let list = if fine || full || level == last_level {
                    &mut done
                } else {
                    &mut next
                };
                list.extend(children);
            }
            open = next;
        }
        done
    }

    /// Traces the rays in `directions`, and adds them to those there are.
    fn add(&mut self, directions: &[DVec3]) {
        for legs in self.trace(directions) {
            let start = self.legs.len();
            self.legs.extend(legs);
            self.rays.push(start..self.legs.len());
        }
    }

    /// Traces the middles of all edges that have none yet.
    fn trace_middles(
        &mut self,
        triangles: &[[usize; 3]],
        middles: &mut HashMap<[usize; 2], usize>,
    ) {
        let mut directions = Vec::new();
        for [a, b, c] in triangles {
            for (i, j) in [(*a, *b), (*b, *c), (*c, *a)] {
                middles.entry(edge(i, j)).or_insert_with(|| {
                    let middle = self.direction(i) + self.direction(j);
                    directions.push(middle.normalize());
                    self.rays.len() + directions.len() - 1
                });
            }
        }
        self.add(&directions);
    }

    /// Tells whether interpolation between the triangle's rays is close to the rays through the
    /// middles of its edges, as far as they are in the region.
    fn is_fine(
        &self,
        [a, b, c]: [usize; 3],
        middles: &HashMap<[usize; 2], usize>,
        level: usize,
    ) -> bool {
        [(a, b), (b, c), (c, a)].into_iter().all(|(i, j)| {
            let rays = [i, j, middles[&edge(i, j)]];
            let shared = self.shared(rays);
            let [p, q, m] = rays.map(|ray| self.legs_of(ray));
            let width = (self.direction(i) - self.direction(j)).length();
            // Finer than for lamps only towards the one point.
            let mut legs = [p, q, m].into_iter().flatten();
            let comes = self
                .target
                .is_some_and(|target| legs.any(|leg| self.may_come(leg, WIDER * width, target)));
            if level >= LAST_LEVEL && !comes {
                return true;
            }
            let mut parted = [p, q, m].into_iter().flat_map(|legs| &legs[shared..]);
            let parted = (level < LAST_PARTED_LEVEL || comes)
                && parted.any(|leg| self.is_of_interest(leg, width));
            let last = level >= LAST_EDGE_LEVEL && !comes;
            // Before that everywhere: what comes to the point may lie between rays that do not.
            let everywhere = self.target.is_some() && level < LAST_LEVEL;
            let even = |n| self.is_even([&p[n], &q[n], &m[n]], last, everywhere);
            !parted && (0..shared).all(even)
        })
    }

    /// Tells whether the middle of two legs lies close to the third, as far as they are in the region, or `everywhere`.
    /// Unless such rays are halved no more, they are to have the same orientation all along, and to begin and end together.
    fn is_even(&self, legs: [&RayLeg; 3], last: bool, everywhere: bool) -> bool {
        let [first, end] = common(legs);
        let [p, q, m] = legs;
        let holds_any =
            |k: &usize| everywhere || legs.iter().any(|leg| holds(self.region, leg.knot(*k).u));
        let mut inside = (first.max(1)..end).filter(holds_any);
        let late = legs.iter().map(|leg| first - leg.first).max().unwrap_or(0);
        let reach = legs
            .iter()
            .map(|leg| leg.numbers().end)
            .max()
            .unwrap_or(end);
        if late > KNOTS_BEYOND && self.begin_at_face(legs) {
            return false;
        }
        let apart = late.max(reach - end);
        let together = apart <= 4.max(reach / 10);
        let turned = |k: usize| p.knot(k).reversed != q.knot(k).reversed;
        (last || together && !inside.clone().any(turned))
            && inside.all(|k| {
                let [p, q, m] = [p, q, m].map(|leg| leg.knot(k).u);
                (0.5 * (p + q) - m).length() <= BEND * (p - q).length()
            })
    }

    /// Tells whether legs begin at a face where connections are asked for. What is between them and the face is bridged by the
    /// knots beyond it, if they begin together; those that graze it do so in narrow triangles alone.
    fn begin_at_face(&self, legs: [&RayLeg; 3]) -> bool {
        let first = |leg: &RayLeg| {
            leg.knots
                .first()
                .is_some_and(|knot| holds(self.region, knot.u))
        };
        legs.iter().all(|leg| leg.between[0].is_finite()) && legs.iter().any(|leg| first(leg))
    }

    /// Tells whether rays in directions within `angle` of a leg come to where connections are asked for, as far as its
    /// deviations tell.
    pub(super) fn is_of_interest(&self, leg: &RayLeg, angle: f64) -> bool {
        let mut around = leg.knots.iter().map(|knot| around(knot, angle));
        around.any(|around| meet(around, self.region))
    }

    /// Tells whether rays in directions within `angle` of a leg may come to the one point that is asked for.
    fn may_come(&self, leg: &RayLeg, angle: f64, target: Region) -> bool {
        leg.knots.windows(2).any(|pair| {
            let [(a, b), (c, d)] = [&pair[0], &pair[1]].map(|knot| around(knot, angle));
            meet((a.min(c), b.max(d)), target)
        })
    }
}

/// Returns the box around where rays in directions within `angle` are at a knot, as far as its deviations tell.
fn around(knot: &RayKnot, angle: f64) -> Region {
    let [x, y] = knot.spread.map(|j| f64::from(j.length()));
    let around = DVec3::splat(angle * x.max(y));
    (knot.u - around, knot.u + around)
}

/// Names the edge between two rays, the lower number first.
fn edge(i: usize, j: usize) -> [usize; 2] {
    [i.min(j), i.max(j)]
}

/// Divides a triangle into four by the middles of its edges.
fn children([a, b, c]: [usize; 3], middles: &HashMap<[usize; 2], usize>) -> [[usize; 3]; 4] {
    let [m, n, o] = [edge(a, b), edge(b, c), edge(c, a)].map(|e| middles[&e]);
    [[a, m, o], [m, b, n], [o, n, c], [m, n, o]]
}

/// Returns the corners of an icosahedron on the unit sphere: the most even coarse mesh of directions.
pub(super) fn icosahedron_corners() -> Vec<DVec3> {
    let golden = 0.5 * (1.0 + 5.0_f64.sqrt());
    let signs = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)];
    let around = |(a, b): (f64, f64)| {
        let (x, y) = (a, b * golden);
        [
            DVec3::new(0.0, x, y),
            DVec3::new(x, y, 0.0),
            DVec3::new(y, 0.0, x),
        ]
    };
    signs
        .into_iter()
        .flat_map(around)
        .map(DVec3::normalize)
        .collect()
}

/// Returns its faces: all triples of neighbouring corners.
fn icosahedron_faces(corners: &[DVec3]) -> Vec<[usize; 3]> {
    let near = |i: usize, j: usize| corners[i].dot(corners[j]) > 0.4;
    let mut faces = Vec::new();
    for i in 0..corners.len() {
        for j in i + 1..corners.len() {
            for k in j + 1..corners.len() {
                if near(i, j) && near(j, k) && near(k, i) {
                    faces.push([i, j, k]);
                }
            }
        }
    }
    faces
}

#[cfg(test)]
mod tests {
    #[test]
    fn an_icosahedron_has_twelve_corners_and_twenty_faces() {
        let corners = super::icosahedron_corners();
        let faces = super::icosahedron_faces(&corners);
        assert_eq!((corners.len(), faces.len()), (12, 20));
    }
}
