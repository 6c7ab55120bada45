//! Segments of the beams between three neighbouring rays of a lamp.
//!
//! A [`BeamSegment`] is the space between the rays over one interval of arc length. In: a chart point. Out: guesses of the
//! direction and arc length at which the light reaches it, by inverting the interpolated map (b, c, t) → u (see
//! [`SegmentMap`]) with Newton's method.

use crate::{
    light_fan::LightFan,
    segment_map::{MIDDLE, SegmentMap},
};
use glam::{DMat3, DVec3, Mat3};

/// Distance outside its segment, in b, c and t, up to which a point is still guessed from it:
/// neighbours agree about a point to a hundredth of a segment, except where rays fold. A wider margin
/// only repeats what they find.
const MARGIN: f64 = 0.1;
const FOLD_MARGIN: f64 = 0.2;

/// The map is nearly linear: a point that the slope in the segment's middle puts this far outside, in b, c or t, is not in
/// the segment, unless it puts a corner farther away. Most segments whose box holds a point end here.
const FAR: f64 = 0.5;

/// Steps from outside a segment before a point is given up: usually, where the linear map is poor, where rays fold.
const PATIENCE: [usize; 3] = [1, 4, 2];

/// Steps of Newton's method for one guess.
const STEPS: usize = 10;

/// A guess is settled when the map misses the point by less than this share of the segment; exact
/// rays take it from there. The map itself is hardly better.
const SETTLED: f64 = 1e-4;

/// A step of Newton's method from where the map misses by this share of the segment, and nothing
/// folds, leaves about its square, so it settles the guess.
const LAST: f64 = 1e-2;

/// Where rays fold, a point that the interpolated map misses by this share of the segment may still
/// be met by the true one.
const NEAR_FOLD: f64 = 0.05;

/// Guesses within this share of a segment where nothing folds are of one geodesic; and a segment whose
/// linear map puts the point within the larger share of a guess has no other.
const ALIKE: f64 = 0.2;
const ROUGHLY_ALIKE: f64 = 0.4;

/// How far from a face a search begins, as a share of the arc length: without, the image in a mirror is lost at points nearer
/// to it than guesses are exact; much more, and in curved space the search leads astray.
const CLEAR: f64 = 1e-2;

/// Parts of a segment in each of which a triangle of rays that are torn apart sweeps over a point once at most.
const SWEEPS: usize = 10;

/// Where a search starts if rays fold: the middle of one search may lie on the wrong side of the fold.
const STARTS: [DVec3; 5] = [
    DVec3::new(0.1, 0.1, 0.5),
    DVec3::new(0.8, 0.1, 0.5),
    DVec3::new(0.1, 0.8, 0.5),
    DVec3::new(0.33, 0.33, 0.05),
    DVec3::new(0.33, 0.33, 0.95),
];

/// Finds where a point lies between three rays over one interval.
pub(super) struct BeamSegment {
    /// The numbers of the rays' legs, and of the first knot.
    corners: [u32; 3],
    knot: u32,
    /// Set if the rays fold inside: then the point may be met more than once.
    folded: bool,
    /// Set if the rays' own linear maps say anything about what is between them.
    smooth: bool,
    /// The segment's middle, and the inverse of the map's slope there; where rays fold, the affine map
    /// of [`SegmentMap::oriented_box`].
    middle: DVec3,
    inverse: Mat3,
    /// How far outside, in b, c or t, the linear map may put a point that is inside: at least [`FAR`].
    far: f32,
    /// The affine map of [`SegmentMap::oriented_box`] as well, where the linear map lets in what is far away.
    cube: Option<Box<(DVec3, Mat3)>>,
}

/// Where a lamp's ray might reach a point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Guess {
    /// Unit vector in the standard frame at the lamp.
    pub direction: DVec3,
    /// Arc length, and that to begin with, clear of faces.
    pub s: f64,
    pub clear: f64,
    /// Change of the point when the direction turns towards each of its perpendiculars, by the
    /// interpolated map.
    pub spread: [DVec3; 2],
    /// The segment's size, as an angle and as an arc length.
    angle: f64,
    width: f64,
    folded: bool,
    /// Behind which borders the segment lies (see [`RayLeg::way`](crate::ray_leg::RayLeg::way)).
    way: u64,
}

impl Guess {
    /// Tells whether `other` is of the same geodesic: close to this where nothing folds, and behind the same borders. Beside
    /// a mirror a point has two that are as close to each other as it is to the mirror.
    fn is_like(&self, other: &Self) -> bool {
        !other.folded && self.is_near((other.direction, other.s), other.way, ALIKE)
    }

    /// Adds it to what is `known`, unless that has one of the same geodesic.
    fn add_to(self, known: &mut Vec<Self>) {
        if !known.iter().any(|guess| guess.is_like(&self)) {
            known.push(self);
        }
    }

    /// Tells whether nothing folds and a geodesic, behind the borders of `way`, is within this share of the segment.
    fn is_near(&self, (direction, s): (DVec3, f64), way: u64, share: f64) -> bool {
        let close = (self.direction - direction).length() < share * self.angle
            && (self.s - s).abs() < share * self.width;
        close && !self.folded && self.way == way
    }
}

impl BeamSegment {
    /// Takes the segment between the rays numbered `corners` that starts at a knot.
    pub fn new(fan: &LightFan<'_>, corners: [usize; 3], knot: usize) -> Self {
        let reversed = |i: usize, k: usize| fan.legs[i].knot(k).reversed;
        let first = reversed(corners[0], knot + 1);
        // At the lamp itself all areas are zero and their signs mean nothing.
        let looked_at = [knot.max(1), knot + 1];
        let differs = |i: &usize| looked_at.iter().any(|k| reversed(*i, *k) != first);
        let folded = corners.iter().any(differs);
        let mut segment = Self {
            corners: corners.map(|i| i as u32),
            knot: knot as u32,
            folded,
            smooth: true,
            middle: DVec3::ZERO,
            inverse: Mat3::ZERO,
            far: FAR as f32,
            cube: None,
        };
        segment.smooth = segment.map(fan).is_smooth();
        let map = segment.map(fan);
        let (middle, inverse) = match folded {
            true => map.oriented_box(FOLD_MARGIN, NEAR_FOLD),
            false => {
                let (middle, slope) = map.map(MIDDLE);
                (middle, slope.inverse())
            }
        };
        (segment.middle, segment.inverse) = (middle, inverse.as_mat3());
        if !folded {
            segment.far = FAR.max(map.linear_miss(middle, inverse) + MARGIN) as f32;
        }
        if !folded && map.is_uneven() {
            let (middle, into_cube) = map.oriented_box(MARGIN, LAST);
            segment.cube = Some(Box::new((middle, into_cube.as_mat3())));
        }
        segment
    }

    /// Makes the segment's map from the fan's rays.
    fn map<'f>(&self, fan: &'f LightFan<'_>) -> SegmentMap<'f> {
        let knot = self.knot as usize;
        let directions = self.corners.map(|i| fan.legs[i as usize].direction);
        let rays = self.corners.map(|i| fan.legs[i as usize].interval(knot));
        SegmentMap::new(directions, rays, self.width(fan), self.smooth)
    }

    /// Returns the arc length that the segment covers.
    fn width(&self, fan: &LightFan<'_>) -> f64 {
        let knot = self.knot as usize;
        fan.arc_lengths[knot + 2] - fan.arc_lengths[knot]
    }

    /// Shows boxes that together hold everything that the segment may be asked about.
    pub fn bounds(&self, fan: &LightFan<'_>, mut show: impl FnMut((DVec3, DVec3))) {
        let map = self.map(fan);
        match self.cube {
            Some(_) => map.parts(MARGIN, LAST).into_iter().for_each(show),
            None => show(map.bounds(self.margin())),
        }
    }

    /// Tells whether the linear map says little about where a point is.
    fn is_bent(&self) -> bool {
        f64::from(self.far) > FAR
    }

    fn margin(&self) -> f64 {
        if self.folded { FOLD_MARGIN } else { MARGIN }
    }

    /// Returns the b, c and t of `x`, as far as the linear map of the middle can tell, or the middle
    /// where rays fold; `None` if `x` is not in the segment.
    pub fn locate(&self, x: DVec3) -> Option<DVec3> {
        let offset = self.inverse * (x - self.middle).as_vec3();
        if self.folded {
            return (!(offset.abs().max_element() > 1.0)).then_some(MIDDLE);
        }
        if let Some(cube) = &self.cube
            && (cube.1 * (x - cube.0).as_vec3()).abs().max_element() > 1.0
        {
            return None;
        }
        let third = self.far + 1.0 / 3.0;
        let outside = offset.x.min(offset.y) < -third
            || offset.x + offset.y > third
            || offset.z.abs() > self.far + 0.5;
        (!outside).then(|| MIDDLE + offset.as_dvec3())
    }

    /// Returns how far outside the segment the point located at `at` lies; 1 where rays fold, which cannot tell.
    pub fn outside_by(&self, at: DVec3) -> f64 {
        if self.folded { 1.0 } else { outside(at) }
    }

    /// Adds where the light might reach `x`, located at `at`, through this segment, to what is `known` already.
    pub fn guesses(&self, fan: &LightFan<'_>, x: DVec3, at: DVec3, known: &mut Vec<Guess>) {
        // A neighbour has found the only geodesic there is.
        if !(self.folded || self.is_bent() || known.is_empty()) {
            let [p, q, o] = self.corners.map(|i| fan.legs[i as usize].direction);
            let direction = (p * (1.0 - at.x - at.y) + q * at.x + o * at.y).normalize();
            let here = (direction, self.arc_length(fan, at));
            let way = self.way(fan);
            if known.iter().any(|g| g.is_near(here, way, ROUGHLY_ALIKE)) {
                return;
            }
        }
        let map = self.map(fan);
        if self.folded && !self.smooth {
            for (at, slope) in self.crossings(&map, x) {
                self.guess(fan, &map, at, slope).add_to(known);
            }
            return;
        }
        // A poor place to start from may be where the map leads away.
        let starts: &[DVec3] = match self.folded {
            false => &[if self.is_bent() { MIDDLE } else { at }],
            true => &STARTS,
        };
        let mut found = [DVec3::INFINITY; STARTS.len()];
        for (i, start) in starts.iter().enumerate() {
            if let Some((at, slope)) = self.invert(&map, x, *start)
                && !found.iter().any(|other| (*other - at).length() < 0.05)
            {
                found[i] = at;
                self.guess(fan, &map, at, slope).add_to(known);
            }
        }
    }

    /// Finds where the map is `x`, or comes close, between rays whose own linear maps say nothing: it is linear between them
    /// then, so the triangle of the three sweeps over `x` where the volume between both changes its sign.
    fn crossings(&self, map: &SegmentMap<'_>, x: DVec3) -> impl Iterator<Item = (DVec3, DMat3)> {
        let (start, width) = (-FOLD_MARGIN, 1.0 + 2.0 * FOLD_MARGIN);
        let time = |k: usize| start + width * k as f64 / SWEEPS as f64;
        let volume = |t: f64| map.volume(t, x);
        let mut volumes = [0.0; SWEEPS + 1];
        for (k, v) in volumes.iter_mut().enumerate() {
            *v = volume(time(k));
        }
        let crossing = |k: usize| {
            let [low, high] = [volumes[k], volumes[k + 1]];
            if (low < 0.0) != (high < 0.0) {
                return Some(root(volume, [time(k), time(k + 1)], [low, high]));
            }
            // It comes near and turns back.
            let least = k > 0 && low.abs() < high.abs() && low.abs() < volumes[k - 1].abs();
            least.then(|| time(k))
        };
        let found: [Option<(DVec3, DMat3)>; SWEEPS] = std::array::from_fn(|k| {
            let t = crossing(k)?;
            let at = map.weights(t, x).extend(t);
            let (u, slope) = map.map(at);
            let size = slope.x_axis.length().max(slope.y_axis.length());
            let near = (x - u).length() <= NEAR_FOLD * size;
            (near && outside(at) <= self.margin()).then_some((at, slope))
        });
        found.into_iter().flatten()
    }

    /// Finds the (b, c, t) at which the map is `x`, or comes close where it folds, with the slope
    /// there; `None` outside.
    fn invert(&self, map: &SegmentMap<'_>, x: DVec3, start: DVec3) -> Option<(DVec3, DMat3)> {
        let allowed = if self.folded { NEAR_FOLD } else { SETTLED };
        let patience = PATIENCE[2 * usize::from(self.folded) + usize::from(self.is_bent())];
        let mut at = start;
        for number in 0..STEPS {
            let (u, slope) = map.map(at);
            let size = slope.x_axis.length().max(slope.y_axis.length());
            let miss = (x - u).length();
            let outside = outside(at) > self.margin();
            if miss <= SETTLED * size || number + 1 == STEPS || (outside && number >= patience) {
                return (miss <= allowed * size && !outside).then_some((at, slope));
            }
            let step = slope.inverse() * (x - u);
            if !step.is_finite() {
                return None;
            }
            let long = step.length();
            if !self.folded {
                let beyond = self::outside(at + step) - self.margin();
                if miss <= LAST * size {
                    return (beyond <= 0.0).then_some((at + step, slope));
                }
                // A step leaves out less than its own length.
                if beyond > long {
                    return None;
                }
            }
            // Half a segment at most: from farther away the slope says nothing.
            at += if long > 0.5 {
                step * (0.5 / long)
            } else {
                step
            };
        }
        None
    }

    fn guess(&self, fan: &LightFan<'_>, map: &SegmentMap<'_>, at: DVec3, slope: DMat3) -> Guess {
        Guess {
            direction: map.direction(at).normalize(),
            spread: map.spread(at, slope),
            s: self.arc_length(fan, at),
            clear: self.clear_of_faces(fan, at),
            angle: map.angle(),
            width: self.width(fan),
            folded: self.folded,
            way: self.way(fan),
        }
    }

    /// Returns the arc length at (b, c, t), moved away from the faces that the rays cross before and behind: a ray that ends on
    /// the wrong side of a mirror leads to the other of the two images. A plane n·u = h is met at h/(n·d).
    fn clear_of_faces(&self, fan: &LightFan<'_>, at: DVec3) -> f64 {
        let s = self.arc_length(fan, at);
        let legs = self.corners.map(|i| &fan.legs[i as usize]);
        let weights = [1.0 - at.x - at.y, at.x, at.y];
        let pairs = || legs.iter().zip(weights);
        let d: DVec3 = pairs().map(|(leg, w)| leg.direction * w).sum();
        let face = |end: usize| match legs[0].between[end] {
            s if s.is_finite() => {
                d.length() / pairs().map(|(leg, w)| w / leg.between[end]).sum::<f64>()
            }
            endless => endless,
        };
        let (low, high) = (face(0) + CLEAR * s, face(1) - CLEAR * s);
        if low < high { s.clamp(low, high) } else { s }
    }

    /// Tells behind which borders its rays are.
    fn way(&self, fan: &LightFan<'_>) -> u64 {
        fan.legs[self.corners[0] as usize].way
    }

    /// Returns the arc length at (b, c, t); not zero.
    fn arc_length(&self, fan: &LightFan<'_>, at: DVec3) -> f64 {
        let width = self.width(fan);
        (fan.arc_lengths[self.knot as usize] + at.z * width).max(1e-3 * width)
    }
}

/// Finds where `value` is zero between two places where its signs differ, to [`SETTLED`], by false position (with half the value at
/// an end that stays, the Illinois rule).
fn root(
    value: impl Fn(f64) -> f64,
    [mut a, mut b]: [f64; 2],
    [mut at_a, mut at_b]: [f64; 2],
) -> f64 {
    for _ in 0..STEPS {
        let t = (a * at_b - b * at_a) / (at_b - at_a);
        let here = value(t);
        if !((t - b).abs() > SETTLED) || here == 0.0 {
            return t;
        }
        match (here < 0.0) != (at_b < 0.0) {
            true => (a, at_a) = (b, at_b),
            false => at_a *= 0.5,
        }
        (b, at_b) = (t, here);
    }
    b
}

/// Returns how far outside its segment a place lies, in b, c, t or 1 − b − c.
fn outside(at: DVec3) -> f64 {
    let across = (at.truncate() - 0.5).abs().max_element() - 0.5;
    across.max((at.z - 0.5).abs() - 0.5).max(at.x + at.y - 1.0)
}
