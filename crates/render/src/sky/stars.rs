//! The "stars" sky: a few thousand stars, brighter constellations among them, and a milky way.
//!
//! In: direction and footprint (radians). Out: linear radiance.
//!
//! The brightest stars are those of well-known constellations at their real places: declination is
//! latitude, right ascension longitude, so seen from the centre they are not mirrored. The rest
//! are scattered by a hash and are the same on every machine. A star is a disc with a soft edge
//! that widens with the footprint, across and along it, and keeps its light.
//!
//! Look-up goes through the cells of a cube: each lists the stars that reach into it, and its
//! corners hold the diffuse glow.

use super::{
    catalogue::{self, Star},
    cube::{CELLS, CubePlace, Places, cells_within, corner_directions, lowest_corner},
    sixteen::{Mask, Numbers, Vectors, each, each_vector, lane, largest, put},
    taps::{Across, LaneTaps, add},
};
use crate::{footprint::FILTER_DEVIATION, lanes::LANES};
use glam::Vec3;
use std::f32::consts::PI;

/// The widest disc; a wider one would reach into cells that do not list it.
const REACH: f32 = 0.012;

/// The radius of the disc (1 − r²/R²)² that is as wide as the pixel filter, in pixels.
const DISC_RADII: f32 = 2.828_427 * FILTER_DEVIATION;

/// The longest footprint whose discs are not cut short.
const LONGEST: f32 = REACH / DISC_RADII;

/// Footprints no longer than this, radians, see one value of what changes slowly over a sky: as far as
/// from one of the places where that is known to the next.
const EVEN: f32 = 0.03;

/// The stars and the glow between them, sorted for look-up.
#[derive(Debug, Clone)]
pub struct StarField {
    /// Where each cell's stars begin in `stars`; one entry more than cells.
    first: Vec<u32>,
    stars: Vec<Star>,
    /// Glow at the corners of the cells, `CELLS + 1` along each edge of each face.
    glow: Vec<Vec3>,
    /// The stars' light spread evenly over the sphere.
    even: Vec3,
}

impl StarField {
    /// Scatters the stars.
    pub(super) fn new() -> Self {
        let stars = catalogue::stars();
        let mut cells = vec![Vec::new(); 6 * CELLS * CELLS];
        for star in &stars {
            for cell in cells_within(star.direction, REACH) {
                cells[cell].push(*star);
            }
        }
        let mut first = vec![0];
        first.extend(cells.iter().scan(0, |sum, cell| {
            *sum += cell.len() as u32;
            Some(*sum)
        }));
        let glow = corner_directions().map(catalogue::glow);
        let total: Vec3 = stars.iter().map(|s| s.light).sum();
        Self {
            first,
            stars: cells.concat(),
            glow: glow.collect(),
            even: total / (4.0 * PI),
        }
    }

    /// Linear light from the unit vector `d`, averaged over about `footprint` radians.
    pub(super) fn radiance(&self, d: Vec3, footprint: f32) -> Vec3 {
        let place = CubePlace::of(d);
        let cell = place.cell() as usize;
        let corners = self.corners(lowest_corner(cell));
        let stars = self.stars_near(cell).iter();
        let round = Oval::of(Vec3::ZERO, footprint);
        let sharp: Vec3 = stars.map(|star| star.light * round.sees(star, d)).sum();
        between(&corners, place.x, place.y) + sharp.lerp(self.even, melt(footprint))
    }

    /// Linear light from the unit vectors `d`, averaged over what samples stand for that change `across`, in
    /// the lanes that are `wanted`. What is between stars is looked up once for each, if all are short.
    #[inline(always)]
    pub(super) fn lights(&self, d: &Vectors, across: &Across, wanted: &Mask) -> Vectors {
        let taps = LaneTaps::of(across, LONGEST);
        let ovals = Ovals::of(&taps);
        let short = taps.longest(wanted) <= EVEN;
        let mut mean = taps.mean(
            d,
            wanted,
            #[inline(always)]
            |places, within| {
                let mut light = self.sharp(places, (&ovals, &taps.width), within);
                if !short {
                    add(&mut light, &self.glow(places), within);
                }
                light
            },
        );
        if short {
            add(&mut mean, &self.glow(d), wanted);
        }
        mean
    }

    /// [`StarField::radiance`] without the glow in the lanes that are `wanted`, over ovals so wide. Lanes in
    /// one cell see its stars together.
    #[inline(always)]
    fn sharp(&self, d: &Vectors, (ovals, widths): (&Ovals, &Numbers), wanted: &Mask) -> Vectors {
        let places = Places::of(d);
        let mut stars = Vectors::default();
        // What is not asked for, sees no stars, or has its light, is in no cell.
        let mut rest = each(
            #[inline(always)]
            |l| {
                let sees = wanted[l] & (melt(widths[l]) < 1.0);
                if sees { places.cells[l] } else { -1.0 }
            },
        );
        loop {
            let cell = largest(&rest);
            if cell < 0.0 {
                break;
            }
            let here = each(
                #[inline(always)]
                |l| if rest[l] == cell { 1.0 } else { 0.0 },
            );
            for star in self.stars_near(cell as usize) {
                star.shine(d, ovals, &here, &mut stars);
            }
            let old = rest;
            rest = each(
                #[inline(always)]
                |l| if old[l] == cell { -1.0 } else { old[l] },
            );
        }
        each_vector(
            #[inline(always)]
            |l| lane(&stars, l).lerp(self.even, melt(widths[l])),
        )
    }

    /// The glow in all lanes.
    #[inline(always)]
    fn glow(&self, d: &Vectors) -> Vectors {
        let places = Places::of(d);
        let mut corners = [Vectors::default(); 4];
        for l in 0..LANES {
            let around = self.corners(lowest_corner(places.cells[l] as usize));
            for (corners, glow) in corners.iter_mut().zip(around) {
                put(corners, l, glow);
            }
        }
        each_vector(
            #[inline(always)]
            |l| {
                let [a, b, c, d] = &corners;
                let around = [lane(a, l), lane(b, l), lane(c, l), lane(d, l)];
                between(&around, places.x[l], places.y[l])
            },
        )
    }

    fn stars_near(&self, cell: usize) -> &[Star] {
        &self.stars[self.first[cell] as usize..self.first[cell + 1] as usize]
    }

    /// The glow at the corners of a cell, of which the lowest has number `low`.
    fn corners(&self, low: usize) -> [Vec3; 4] {
        let side = CELLS + 1;
        let glow = &self.glow[low..low + side + 2];
        [glow[0], glow[1], glow[side], glow[side + 1]]
    }
}

/// How far the stars have melted into their mean: past the reach, over one doubling of the footprint.
#[inline(always)]
fn melt(footprint: f32) -> f32 {
    (footprint * (1.0 / REACH) - 1.0).clamp(0.0, 1.0)
}

impl Star {
    /// Adds its light in the lanes that are `here` (1; 0 elsewhere), if any of those is in the disc.
    #[inline(always)]
    fn shine(&self, d: &Vectors, ovals: &Ovals, here: &Numbers, light: &mut Vectors) {
        let inside = each(
            #[inline(always)]
            |l| here[l] * ovals.lane(l).depth(self, lane(d, l))[0],
        );
        if largest(&inside) > 0.0 {
            let old = *light;
            *light = each_vector(
                #[inline(always)]
                |l| lane(&old, l) + self.light * (here[l] * ovals.lane(l).sees(self, lane(d, l))),
            );
        }
    }
}

/// By how much a footprint widens discs.
struct Oval {
    /// Along which it is longest: a unit vector, or zero if it is round.
    along: Vec3,
    /// Squares of what it adds to a disc's radius along that and across: deviations across a disc are its
    /// radius over √8, and variances add.
    squares: [f32; 2],
}

impl Oval {
    /// Of a footprint as long as `along`, at least as long as it is wide.
    #[inline(always)]
    fn of(along: Vec3, width: f32) -> Self {
        let length = along.length();
        let [long, short] = [DISC_RADII * length.max(width), DISC_RADII * width];
        Self {
            along: along / length.max(f32::MIN_POSITIVE),
            squares: [long * long, short * short],
        }
    }

    /// Positive where `d` is inside the star's widened disc, and the square of the product of its radii, which
    /// the first is in the middle. No radius exceeds the reach.
    #[inline(always)]
    fn depth(&self, star: &Star, d: Vec3) -> [f32; 2] {
        let own = star.radius * star.radius;
        let long = (own + self.squares[0]).min(REACH * REACH);
        let short = (own + self.squares[1]).min(REACH * REACH);
        let off = star.direction - d;
        let along = off.dot(self.along);
        let along = along * along;
        let across = off.length_squared() - along;
        let area = long * short;
        [area - along * short - across * long, area]
    }

    /// The part of a star's light that is seen from `d` in each unit of solid angle: that of the disc
    /// (1 − r²/R²)², which holds πR²/3, stretched.
    #[inline(always)]
    fn sees(&self, star: &Star, d: Vec3) -> f32 {
        let [inside, area] = self.depth(star, d);
        let depth = inside.max(0.0) / area;
        depth * depth * 3.0 / (PI * area.sqrt())
    }
}

/// [`Oval`] in sixteen lanes.
#[derive(Default)]
struct Ovals {
    along: Vectors,
    squares: [Numbers; 2],
}

impl Ovals {
    /// Of each of the footprints that stand for a sample.
    #[inline(always)]
    fn of(taps: &LaneTaps) -> Self {
        let mut to = Self::default();
        for l in 0..LANES {
            let oval = Oval::of(lane(&taps.step, l), taps.width[l]);
            put(&mut to.along, l, oval.along);
            to.squares[0][l] = oval.squares[0];
            to.squares[1][l] = oval.squares[1];
        }
        to
    }

    #[inline(always)]
    fn lane(&self, l: usize) -> Oval {
        Oval {
            along: lane(&self.along, l),
            squares: [self.squares[0][l], self.squares[1][l]],
        }
    }
}

/// Bilinear between the four corners of a cell: below, then above.
#[inline(always)]
fn between(corners: &[Vec3; 4], x: f32, y: f32) -> Vec3 {
    let below = corners[0].lerp(corners[1], x);
    below.lerp(corners[2].lerp(corners[3], x), y)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wider_footprint_keeps_a_stars_light() {
        let field = StarField::new();
        // Sirius outshines whatever else is near.
        let sirius = catalogue::at(101.29, -16.72);
        let (right, up) = sirius.any_orthonormal_pair();
        let light = |footprint: f32| {
            let (step, n) = (2.5e-4, 48);
            let mut sum = 0.0;
            for i in -n..=n {
                for j in -n..=n {
                    let d = sirius + step * (right * i as f32 + up * j as f32);
                    let seen = field.radiance(d.normalize(), footprint).y;
                    sum += (seen - catalogue::glow(d.normalize()).y) * step * step;
                }
            }
            sum
        };
        let point = light(0.0);
        for footprint in [1e-3, 3e-3, 8e-3] {
            assert!((light(footprint) / point - 1.0).abs() < 0.15, "{footprint}");
        }
    }

    #[test]
    fn a_long_footprint_keeps_a_stars_light() {
        let field = StarField::new();
        let sirius = catalogue::at(101.29, -16.72);
        let (right, up) = sirius.any_orthonormal_pair();
        let sum = |long: f32| {
            let oval = Oval::of((right * 0.8 + up * 0.6) * long, 1e-3);
            let ovals = Ovals {
                along: oval.along.to_array().map(|x| [x; LANES]),
                squares: oval.squares.map(|x| [x; LANES]),
            };
            let (step, n) = (2.5e-4, 48);
            let mut sum = 0.0;
            for i in -n..=n {
                for first in (-n..=n).step_by(LANES) {
                    let mut d = Vectors::default();
                    for l in 0..LANES {
                        let j = (first + l as i32) as f32;
                        let place = sirius + step * (right * i as f32 + up * j);
                        put(&mut d, l, place.normalize());
                    }
                    let wanted = std::array::from_fn(|l| first + l as i32 <= n);
                    let light = field.sharp(&d, (&ovals, &[1e-3; LANES]), &wanted);
                    sum += (0..LANES)
                        .filter(|l| wanted[*l])
                        .map(|l| light[1][l])
                        .sum::<f32>();
                }
            }
            sum
        };
        let round = sum(1e-3);
        for long in [3e-3, 6e-3, LONGEST] {
            assert!((sum(long) / round - 1.0).abs() < 0.05, "{long}");
        }
    }
}
