//! Triangles that move while light is on its way.
//!
//! In: the corners of a triangle at two arc lengths of lines of sight, between which they move evenly (what is farther
//! away is seen earlier); a chord with the arc lengths at its ends. Out: where the chord meets the triangle as it was
//! when it sent the light that comes along the chord.

use super::{BoxTree, ChordHit, END_MARGIN, Holes, PacketHits, box_of};
use crate::{
    lanes::{BoxPacket, LANES, Mask, SingleLanes},
    path_patch::Offsets,
};
use glam::DVec3;

/// A triangle as it is seen at arc lengths of an interval.
#[derive(Debug, Clone)]
pub struct MovingTriangle {
    /// The ends of the interval; the second may be infinite where the corners are the same at both.
    pub s: [f64; 2],
    /// The corners at both.
    pub corners: [[DVec3; 3]; 2],
}

/// A chord with the arc lengths at its ends.
#[derive(Debug, Clone, Copy)]
pub struct TimedChord {
    /// Where it begins and ends.
    pub ends: [DVec3; 2],
    /// The arc lengths there.
    pub s: [f64; 2],
}

/// A place on a chord, and the weights of a triangle's second and third corner there.
pub type Meeting = (f64, (f64, f64));

/// Share of an interval by which hits may be outside of it: at its ends the triangles of two intervals are one, and
/// rounding must not let a hit fall out of both.
const INTERVAL_MARGIN: f64 = 1e-6;

/// Weights of corners that count as none. Two triangles with a common edge find the place of a hit on it each by itself,
/// so that between them chords could slip through gaps as wide as rounding.
const EDGE_MARGIN: f64 = 1e-9;

/// Most steps of Newton's method: a triangle that does not turn takes one.
const MOST_STEPS: usize = 12;

/// Change of the place on a chord below which it is known.
const STILL: f64 = 1e-13;

impl TimedChord {
    /// Returns the ends, as places on the chord, of what an interval of arc length leaves of it, and a little more; `None`
    /// for nothing.
    fn within(&self, interval: [f64; 2]) -> Option<[f64; 2]> {
        let (s, length) = (self.s[0], self.s[1] - self.s[0]);
        let margin = INTERVAL_MARGIN * (interval[1] - interval[0]).min(self.s[1]);
        let from = ((interval[0] - margin - s) / length).max(-END_MARGIN);
        let to = ((interval[1] + margin - s) / length).min(1.0 + END_MARGIN);
        // Without a length, no comparison holds.
        (from <= to).then_some([from, to])
    }
}

impl MovingTriangle {
    /// Returns the corners as they are seen at arc length `s`.
    pub fn corners_at(&self, s: f64) -> [DVec3; 3] {
        let share = (s - self.s[0]) / (self.s[1] - self.s[0]);
        let [from, to] = &self.corners;
        [0, 1, 2].map(|k| from[k] + (to[k] - from[k]) * share)
    }

    /// Returns the box around everything between.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        let [(low, high), (other_low, other_high)] = self.corners.each_ref().map(box_of);
        (low.min(other_low), high.max(other_high))
    }

    /// Finds where it is met by a chord. Corners and chord move evenly, so the volume between them is a cubic of the
    /// place on the chord; its root is found by Newton's method from the middle of what the interval leaves of the
    /// chord. Where a triangle turns so much that there are two, one is found.
    pub fn meet(&self, chord: &TimedChord) -> Option<Meeting> {
        let [a, b] = chord.ends;
        let (s, length) = (chord.s[0], chord.s[1] - chord.s[0]);
        let [from, to] = chord.within(self.s)?;
        let share = length / (self.s[1] - self.s[0]);
        let rates = [0, 1, 2].map(|k| (self.corners[1][k] - self.corners[0][k]) * share);
        let way = b - a - rates[0];
        let mut t = 0.5 * (from + to);
        for _ in 0..MOST_STEPS {
            let [p, q, r] = self.corners_at(s + t * length);
            let beside = a + (b - a) * t - p;
            let (e, f) = (q - p, r - p);
            let (e_rate, f_rate) = (rates[1] - rates[0], rates[2] - rates[0]);
            let normal = e.cross(f);
            let normal_rate = e_rate.cross(f) + e.cross(f_rate);
            let step = normal.dot(beside) / (normal.dot(way) + normal_rate.dot(beside));
            t -= step;
            if !(step.abs() > STILL) {
                let size = normal.length_squared();
                let weights = (
                    beside.cross(f).dot(normal) / size,
                    e.cross(beside).dot(normal) / size,
                );
                return self.inside(t, [from, to], weights);
            }
        }
        None
    }

    /// Keeps a place that is between those on the chord, if it is on the triangle; seen edge-on nothing is a number.
    fn inside(&self, t: f64, [from, to]: [f64; 2], weights: (f64, f64)) -> Option<Meeting> {
        let on_chord = (from..=to).contains(&t);
        let (v, w) = weights;
        let within = v >= -EDGE_MARGIN && w >= -EDGE_MARGIN && v + w <= 1.0 + EDGE_MARGIN;
        (on_chord && within).then(|| (t.clamp(0.0, 1.0), (v.clamp(0.0, 1.0), w.clamp(0.0, 1.0))))
    }
}

/// Triangles that move, by the intervals of arc length at which they are seen.
#[derive(Clone, Default)]
pub struct MovingTriangles {
    triangles: Vec<MovingTriangle>,
    /// The number of the first among all triangles.
    first: u32,
    groups: Vec<Group>,
    /// Their numbers, by the boxes around their ways.
    boxes: BoxTree<u32>,
}

/// Triangles of one interval.
#[derive(Clone)]
struct Group {
    s: [f64; 2],
    bounds: (DVec3, DVec3),
    /// Their numbers among those that move.
    tree: BoxTree<u32>,
}

/// Sixteen chords with the arc lengths at their ends.
pub struct PacketChords<'a> {
    pub ends: [&'a Offsets; 2],
    pub s: [f64; 2],
    /// What both ends are moved by.
    pub shift: DVec3,
}

impl MovingTriangles {
    /// Sorts triangles, of which those of an interval follow each other and the first has this number.
    pub fn new(triangles: Vec<MovingTriangle>, first: u32) -> Self {
        let mut groups = Vec::new();
        let mut begin = 0;
        for part in triangles.chunk_by(|a, b| a.s == b.s) {
            let numbers: Vec<u32> = (begin..begin + part.len() as u32).collect();
            let tree = BoxTree::build(&numbers, |k| triangles[*k as usize].bounds());
            begin += part.len() as u32;
            if let Some(bounds) = tree.bounds() {
                let s = part[0].s;
                groups.push(Group { s, bounds, tree });
            }
        }
        let numbers: Vec<u32> = (0..groups.len() as u32).collect();
        let boxes = BoxTree::build(&numbers, |k| groups[*k as usize].bounds);
        Self {
            triangles,
            first,
            groups,
            boxes,
        }
    }

    /// Tells whether there are any.
    #[inline(always)]
    pub fn any(&self) -> bool {
        !self.groups.is_empty()
    }

    /// Returns all.
    pub fn all(&self) -> &[MovingTriangle] {
        &self.triangles
    }

    /// Returns the triangle with this number among all, if it is one of these.
    pub fn get(&self, number: u32) -> Option<&MovingTriangle> {
        self.triangles.get(number.checked_sub(self.first)? as usize)
    }

    /// Returns the box around the ways of all.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        self.boxes.bounds()
    }

    /// Returns boxes that together hold all ways.
    pub fn parts(&self) -> impl Iterator<Item = (DVec3, DVec3)> {
        self.groups.iter().map(|group| group.bounds)
    }

    /// Tells whether a box meets that of a way.
    #[inline(always)]
    pub fn touches(&self, min: DVec3, max: DVec3) -> bool {
        self.boxes.touches(min, max)
    }

    /// Adds the boxes that meet that of a way to those that are marked already.
    #[inline(always)]
    pub fn touched(&self, boxes: &BoxPacket, mut marked: Mask) -> Mask {
        let touched = self.boxes.touched(boxes);
        for l in 0..LANES {
            marked[l] |= touched[l];
        }
        marked
    }

    /// Shows the groups that chords inside a box may meet which have the arc lengths `s` at their ends.
    fn groups_near<'a>(
        &'a self,
        (low, high): (DVec3, DVec3),
        s: [f64; 2],
        mut show: impl FnMut(&'a Group),
    ) {
        self.boxes.visit(low, high, |k| {
            let group = &self.groups[*k as usize];
            if s[0] <= group.s[1] && group.s[0] <= s[1] {
                show(group);
            }
        });
    }

    /// Returns the better of `best` and the first hit on a chord.
    #[cold]
    pub fn first_hit(
        &self,
        chord: &TimedChord,
        holes: &Holes,
        mut best: Option<ChordHit>,
    ) -> Option<ChordHit> {
        let [a, b] = chord.ends;
        let around = (a.min(b), a.max(b));
        self.groups_near(around, chord.s, |group| {
            best = self.first_hit_of(group, chord, holes, best);
        });
        best
    }

    fn first_hit_of(
        &self,
        group: &Group,
        chord: &TimedChord,
        holes: &Holes,
        mut best: Option<ChordHit>,
    ) -> Option<ChordHit> {
        // The part of the chord that the interval leaves.
        let Some(part) = chord.within(group.s) else {
            return best;
        };
        let [from, to] = part.map(|t| chord.ends[0].lerp(chord.ends[1], t));
        group.tree.along_chord([from, to], |leaf| {
            for k in leaf {
                let number = self.first + k;
                let Some((t, barycentric)) = self.triangles[*k as usize].meet(chord) else {
                    continue;
                };
                let open = || holes.is_open(number, [barycentric.0 as f32, barycentric.1 as f32]);
                if best.is_none_or(|b| (t, number) < (b.t, b.triangle)) && !open() {
                    best = Some(ChordHit {
                        t,
                        triangle: number,
                        barycentric,
                    });
                }
            }
            // Of the part of the chord.
            best.map(|hit| (hit.t - part[0]) / (part[1] - part[0]).max(f64::MIN_POSITIVE))
        });
        best
    }

    /// Returns the better of `best` and the first hits on sixteen chords, at most at `limit` (negative: nothing is asked of
    /// this lane).
    #[cold]
    pub fn first_hits(
        &self,
        chords: &PacketChords<'_>,
        holes: &Holes,
        limit: &SingleLanes,
        best: Option<PacketHits>,
    ) -> Option<PacketHits> {
        let [a, b] = chords.ends.map(Offsets::bounds);
        let (low, high) = (a.0.min(b.0) + chords.shift, a.1.max(b.1) + chords.shift);
        let mut near: Vec<&Group> = Vec::new();
        self.groups_near((low, high), chords.s, |group| near.push(group));
        if near.is_empty() {
            return best;
        }
        let mut met = best.is_some();
        let mut hits = best.unwrap_or_default();
        for l in 0..LANES {
            if !(limit[l] >= 0.0) {
                continue;
            }
            let ends = chords.ends.map(|end| end.point(l) + chords.shift);
            let chord = TimedChord { ends, s: chords.s };
            let mut first = None;
            for group in &near {
                first = self.first_hit_of(group, &chord, holes, first);
            }
            let Some(first) = first else { continue };
            let t = first.t as f32;
            if t <= limit[l] && t < hits.t[l] {
                (hits.t[l], hits.triangle[l]) = (t, first.triangle);
                hits.weights[0][l] = first.barycentric.0 as f32;
                hits.weights[1][l] = first.barycentric.1 as f32;
                met = true;
            }
        }
        met.then_some(hits)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{
        Accelerator,
        tests::{Random, packet, sphere},
    };
    use super::*;
    use glam::DQuat;

    /// A sphere of radius 1/2 that flies and tumbles, between the arc lengths 3 and 4, and one that stands behind.
    fn spheres() -> (Vec<MovingTriangle>, Accelerator) {
        let pose = |s: f64, p: DVec3| {
            let turned = DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 0.3 * (s - 3.0));
            turned * p * 0.5 + DVec3::new(0.8, -0.5, 0.3) * (3.5 - s)
        };
        let still: Vec<[DVec3; 3]> = sphere(4).iter().map(|t| t.map(|p| p * 0.1 + 5.0)).collect();
        let moving: Vec<MovingTriangle> = sphere(12)
            .iter()
            .map(|corners| MovingTriangle {
                s: [3.0, 4.0],
                corners: [3.0, 4.0].map(|s| corners.map(|p| pose(s, p))),
            })
            .collect();
        let middle = moving.iter().map(|moving| moving.corners_at(3.5));
        let all = still.into_iter().chain(middle).collect();
        let accelerator = Accelerator::build_all(all, moving.clone(), Vec::new());
        (moving, accelerator)
    }

    /// Tells whether a point is inside the moving sphere as it is seen at arc length `s`: on the inner side of the
    /// triangle that it is seen through from the middle.
    fn is_inside(moving: &[MovingTriangle], u: DVec3, s: f64) -> bool {
        let middle = DVec3::new(0.8, -0.5, 0.3) * (3.5 - s);
        moving.iter().all(|triangle| {
            let [p, q, r] = triangle.corners_at(s);
            let outward = (q - p).cross(r - p);
            let outward = outward * outward.dot(p - middle).signum();
            outward.dot(u - p) <= 0.0
        })
    }

    #[test]
    fn chords_meet_a_moving_sphere_where_they_get_inside() {
        let (moving, accelerator) = spheres();
        let mut random = Random(11);
        let (mut hits, mut misses) = (0, 0);
        for _ in 0..3_000 {
            let (a, way) = (random.point() * 2.0, random.point() * 3.0);
            let s = [2.9 + random.next(), 3.2 + 0.9 * random.next()];
            if s[1] <= s[0] {
                continue;
            }
            let chord = TimedChord {
                ends: [a, a + way],
                s,
            };
            let at = |t: f64| (a + way * t, s[0] + (s[1] - s[0]) * t);
            let inside = |t: f64| {
                let (u, s) = at(t);
                (3.0..=4.0).contains(&s).then(|| is_inside(&moving, u, s))
            };
            let steps: Vec<Option<bool>> =
                (0..=2000).map(|i| inside(f64::from(i) / 2000.0)).collect();
            let crossing = steps.windows(2).position(|pair| match pair {
                [Some(before), Some(after)] => before != after,
                _ => false,
            });
            match (accelerator.first_hit_on_chord(&chord), crossing) {
                (Some(hit), Some(step)) => {
                    hits += 1;
                    let between = step as f64 / 2000.0;
                    assert!(
                        (between - 1e-9..=between + 0.0005 + 1e-9).contains(&hit.t),
                        "{hit:?} {between}"
                    );
                    let (u, s) = at(hit.t);
                    let [p, q, r] = accelerator.corners(hit.triangle, s);
                    let (v, w) = hit.barycentric;
                    assert!((p * (1.0 - v - w) + q * v + r * w - u).length() < 1e-9);
                }
                (None, None) => misses += 1,
                // A step may go over an edge.
                (Some(_), None) => misses += 1,
                (None, Some(step)) => panic!("{chord:?} {step}"),
            }
        }
        assert!(hits > 40 && misses > 60, "{hits} {misses}");
    }

    #[test]
    fn nothing_slips_out_of_a_moving_sphere() {
        let (moving, accelerator) = spheres();
        let mut random = Random(12);
        for round in 0..20_000 {
            let s = [3.0 + 0.5 * random.next(), 0.0];
            let s = [s[0], s[0] + 0.3 + 0.2 * random.next()];
            let a = DVec3::new(0.8, -0.5, 0.3) * (3.5 - s[0]) + random.point() * 0.15;
            // A third of the chords aim at a vertex or at the middle of an edge as these are on the way.
            let k = (random.next() * moving.len() as f64) as usize;
            let [p, q, _] = moving[k].corners_at(s[0] + 0.5 * (s[1] - s[0]));
            let aim = match round % 3 {
                0 => p,
                1 => (p + q) * 0.5,
                _ => a + random.point().normalize(),
            };
            // Twice as far, so that it gets there in the middle.
            let ends = [a, a + (aim - a) * 2.0];
            let out = !is_inside(&moving, ends[1], s[1]);
            let hit = accelerator.first_hit_on_chord(&TimedChord { ends, s });
            assert!(hit.is_some() || !out, "{ends:?} {s:?}");
        }
    }

    #[test]
    fn sixteen_chords_meet_what_moves_as_each_does_by_itself() {
        let (_, accelerator) = spheres();
        let mut random = Random(13);
        let mut hits = 0;
        for _ in 0..1_000 {
            let (start, way) = (random.point() * 2.0, random.point() * 3.0);
            let [a, b] = [start, start + way].map(|u| [0; 16].map(|_| u + random.point() * 0.05));
            let s = [2.9 + 0.3 * random.next(), 3.4 + 0.9 * random.next()];
            let found = packet(&accelerator, (&a, &b), s);
            for l in 0..16 {
                let ends = [a[l], b[l]];
                let alone = accelerator.first_hit_on_chord(&TimedChord { ends, s });
                let t = found.as_ref().map_or(f32::INFINITY, |found| found.t[l]);
                let expected = alone.map_or(f32::INFINITY, |hit| hit.t as f32);
                hits += usize::from(alone.is_some());
                assert!(
                    expected == t || (expected - t).abs() < 1e-4,
                    "{expected} {t}"
                );
            }
        }
        assert!(hits > 300, "{hits}");
    }
}
