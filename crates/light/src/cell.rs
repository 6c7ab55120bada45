//! A cell of a light's fan: three neighbouring rays between two knots.
//!
//! In: a chart point. Out: guesses of the direction and arc length at which the light reaches it,
//! by inverting the interpolated map (b, c, t) → u: see [`Prism`].

use crate::{fan::LightFan, prism::Prism, slanted::slanted};
use glam::{DMat3, DVec3, Mat3, Vec3};

/// How far outside its cell, in b, c and t, a point may lie and still be guessed from it: neighbours
/// agree about a point to a hundredth of a cell, except where rays fold. A wider margin only repeats
/// what they find.
const MARGIN: f64 = 0.1;
const FOLD_MARGIN: f64 = 0.2;

/// The map is nearly linear: a point that the slope in the cell's middle puts this far outside, in b,
/// c or t, is not in the cell. Most cells whose box holds a point end here; with twice the distance
/// nothing more is found.
const FAR: f32 = 0.5;

/// Steps of Newton's method for one guess.
const STEPS: usize = 10;

/// A guess is settled when the map misses the point by less than this share of the cell; exact
/// rays take it from there. The map itself is hardly better.
const SETTLED: f64 = 1e-4;

/// A step of Newton's method from where the map misses by this share of the cell, and nothing folds,
/// leaves about its square, so it settles the guess.
const LAST: f64 = 1e-2;

/// Where rays fold, a point that the interpolated map misses by this share of the cell may still be
/// met by the true one.
const NEAR_FOLD: f64 = 0.05;

/// Three rays between two knots.
pub(super) struct Cell {
    corners: [u32; 3],
    knot: u32,
    /// Whether the rays fold inside: then the point may be met more than once.
    folded: bool,
    /// Whether the rays' own maps tell anything about what is between them.
    smooth: bool,
    /// The cell's middle, and the inverse of the map's slope there; where rays fold, the map into the
    /// cube of [`slanted`].
    middle: Vec3,
    inverse: Mat3,
}

/// Guesses within this share of a cell where nothing folds are of the same geodesic; and a cell whose
/// linear map puts the point within the larger share of a guess has no other.
const ALIKE: f64 = 0.2;
const ROUGHLY_ALIKE: f64 = 0.4;

/// The middle in b, c and t.
const MIDDLE: DVec3 = DVec3::new(1.0 / 3.0, 1.0 / 3.0, 0.5);

/// Where a light's ray might reach a point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Guess {
    /// Unit vector in the standard frame at the light.
    pub direction: DVec3,
    /// Arc length.
    pub s: f64,
    /// How the point moves when the direction turns towards each of its perpendiculars, by the
    /// interpolated map.
    pub spread: [DVec3; 2],
    /// The cell's size, as an angle and as an arc length.
    angle: f64,
    width: f64,
    folded: bool,
}

impl Guess {
    /// Whether both are guesses of the same geodesic: close to each other where nothing folds.
    pub fn is_like(&self, other: &Self) -> bool {
        !other.folded && self.is_near(other.direction, other.s, ALIKE)
    }

    /// Whether nothing folds and a geodesic is within this share of the cell.
    fn is_near(&self, direction: DVec3, s: f64, share: f64) -> bool {
        let close = (self.direction - direction).length() < share * self.angle
            && (self.s - s).abs() < share * self.width;
        close && !self.folded
    }
}

impl Cell {
    /// The cell of three rays that starts at a knot.
    pub fn new(fan: &LightFan<'_>, corners: [usize; 3], knot: usize) -> Self {
        let reversed = |i: usize, k: usize| fan.rays[i].knots[k].reversed;
        let first = reversed(corners[0], knot + 1);
        // At the light itself all areas are zero and their signs mean nothing.
        let looked_at = [knot.max(1), knot + 1];
        let differs = |i: &usize| looked_at.iter().any(|k| reversed(*i, *k) != first);
        let folded = corners.iter().any(differs);
        let mut cell = Self {
            corners: corners.map(|i| i as u32),
            knot: knot as u32,
            folded,
            smooth: true,
            middle: Vec3::ZERO,
            inverse: Mat3::ZERO,
        };
        cell.smooth = cell.prism(fan).is_smooth();
        let (middle, inverse) = match folded {
            true => slanted(&cell.prism(fan), FOLD_MARGIN, NEAR_FOLD),
            false => {
                let (middle, slope) = cell.prism(fan).map(MIDDLE);
                (middle, slope.inverse())
            }
        };
        (cell.middle, cell.inverse) = (middle.as_vec3(), inverse.as_mat3());
        cell
    }

    fn prism<'f>(&self, fan: &'f LightFan<'_>) -> Prism<'f> {
        let rays = self.corners.map(|i| &fan.rays[i as usize]);
        Prism::new(rays, self.knot as usize, self.width(fan), self.smooth)
    }

    /// The arc length that it covers.
    fn width(&self, fan: &LightFan<'_>) -> f64 {
        let knot = self.knot as usize;
        fan.knots[knot + 2] - fan.knots[knot]
    }

    /// A box around everything that the cell may be asked about.
    pub fn bounds(&self, fan: &LightFan<'_>) -> (DVec3, DVec3) {
        self.prism(fan).bounds(self.margin())
    }

    fn margin(&self) -> f64 {
        if self.folded { FOLD_MARGIN } else { MARGIN }
    }

    /// The b, c and t of `x`, as far as the linear map of the middle can tell, or of any place where
    /// rays fold; `None` if `x` is not in the cell.
    pub fn place(&self, x: DVec3) -> Option<DVec3> {
        let way = self.inverse * (x.as_vec3() - self.middle);
        if self.folded {
            return (!(way.abs().max_element() > 1.0)).then_some(MIDDLE);
        }
        let third = FAR + 1.0 / 3.0;
        let outside =
            way.x < -third || way.y < -third || way.x + way.y > third || way.z.abs() > FAR + 0.5;
        (!outside).then(|| MIDDLE + way.as_dvec3())
    }

    /// How far from certain it is that the point at `place` is in the cell: rays that fold cannot tell.
    pub fn doubt(&self, place: DVec3) -> f64 {
        if self.folded { 1.0 } else { outside(place) }
    }

    /// Adds where the light might reach `x`, roughly at `place`, through this cell, to what is `known`
    /// already.
    pub fn guesses(&self, fan: &LightFan<'_>, x: DVec3, place: DVec3, known: &mut Vec<Guess>) {
        if !(self.folded || known.is_empty()) {
            let [p, q, o] = self.corners.map(|i| fan.directions[i as usize]);
            let direction = (p * (1.0 - place.x - place.y) + q * place.x + o * place.y).normalize();
            let s = self.arc(fan, place);
            if known.iter().any(|g| g.is_near(direction, s, ROUGHLY_ALIKE)) {
                return;
            }
        }
        let prism = self.prism(fan);
        let starts: &[DVec3] = match self.folded {
            false => &[place],
            true => &[
                DVec3::new(0.1, 0.1, 0.5),
                DVec3::new(0.8, 0.1, 0.5),
                DVec3::new(0.1, 0.8, 0.5),
                DVec3::new(0.33, 0.33, 0.05),
                DVec3::new(0.33, 0.33, 0.95),
            ],
        };
        let mut found = [DVec3::INFINITY; 5];
        for (i, start) in starts.iter().enumerate() {
            if let Some((at, slope)) = self.invert(&prism, x, *start)
                && !found.iter().any(|other| (*other - at).length() < 0.05)
            {
                found[i] = at;
                let guess = self.guess(fan, &prism, at, slope);
                if !known.iter().any(|g| g.is_like(&guess)) {
                    known.push(guess);
                }
            }
        }
    }

    /// The (b, c, t) at which the map is `x`, or comes close where it folds, with the slope there;
    /// `None` outside.
    fn invert(&self, prism: &Prism<'_>, x: DVec3, start: DVec3) -> Option<(DVec3, DMat3)> {
        let allowed = if self.folded { NEAR_FOLD } else { SETTLED };
        let patience = if self.folded { 2 } else { 1 };
        let mut at = start;
        for step in 0..STEPS {
            let (u, slope) = prism.map(at);
            let size = slope.x_axis.length().max(slope.y_axis.length());
            let miss = (x - u).length();
            let outside = outside(at) > self.margin();
            if miss <= SETTLED * size || step + 1 == STEPS || (outside && step >= patience) {
                return (miss <= allowed * size && !outside).then_some((at, slope));
            }
            let way = slope.inverse() * (x - u);
            if !way.is_finite() {
                return None;
            }
            let long = way.length();
            if !self.folded {
                let beyond = self::outside(at + way) - self.margin();
                if miss <= LAST * size {
                    return (beyond <= 0.0).then_some((at + way, slope));
                }
                // What a step leaves out is shorter than the step.
                if beyond > long {
                    return None;
                }
            }
            at += if long > 0.5 { way * (0.5 / long) } else { way };
        }
        None
    }

    fn guess(&self, fan: &LightFan<'_>, prism: &Prism<'_>, at: DVec3, slope: DMat3) -> Guess {
        Guess {
            direction: prism.toward(at).normalize(),
            spread: prism.spread(at, slope),
            s: self.arc(fan, at),
            angle: prism.angle(),
            width: self.width(fan),
            folded: self.folded,
        }
    }

    /// The arc length at (b, c, t); not zero.
    fn arc(&self, fan: &LightFan<'_>, at: DVec3) -> f64 {
        let width = self.width(fan);
        (fan.knots[self.knot as usize] + at.z * width).max(1e-3 * width)
    }
}

/// How far outside its cell a point lies, in b, c, t or 1 − b − c.
pub(super) fn outside(at: DVec3) -> f64 {
    let across = (at.truncate() - 0.5).abs().max_element() - 0.5;
    across.max((at.z - 0.5).abs() - 0.5).max(at.x + at.y - 1.0)
}
